"""Normalised innovations squared over windows, with the region that an honest filter keeps to."""

from typing import Any, Final

import numpy as np

from starwise.analysis.consistency import nis_region, nis_test
from starwise.report.html.encode import packed
from starwise.types import Solution

WINDOWS: Final = 60
"""At most; of at least ten epochs each."""


def nis_payload(solution: Solution) -> dict[str, Any] | None:
    """NIS per degree of freedom in windows, each with its 95 % region, and of the whole run; None without any."""
    told = np.flatnonzero(np.isfinite(solution.nis) & (solution.dof > 0))
    if len(told) < 10:
        return None
    n = min(WINDOWS, max(1, len(told) // 10))
    parts = np.array_split(told, n)
    rows = []
    for part in parts:
        dof = int(solution.dof[part].sum())
        low, high = nis_region(dof)
        rows.append((int(part[0]), int(part[-1]), float(solution.nis[part].sum()) / dof, low, high))
    whole = nis_test(solution.nis[told], solution.dof[told])
    table = np.array(rows)
    return {
        "first": packed(table[:, 0], "u4"),
        "last": packed(table[:, 1], "u4"),
        "mean": table[:, 2].tolist(),
        "low": table[:, 3].tolist(),
        "high": table[:, 4].tolist(),
        "all": {"mean": whole.per_dof, "low": whole.low, "high": whole.high, "dof": whole.dof},
        "inside": float(((table[:, 2] >= table[:, 3]) & (table[:, 2] <= table[:, 4])).mean()),
    }
