"""Page that puts several solutions beside each other."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.constants import EPOCH_NO_SOLUTION
from starwise.report.html.accuracy import compared, distribution, errors_by_epoch
from starwise.report.html.encode import packed
from starwise.report.html.epochs import Local, epochs_payload, localised, shown_epochs
from starwise.report.html.page import rendered
from starwise.report.html.run import span
from starwise.report.html.tables import input_row
from starwise.report.html.words import method_of, number
from starwise.types import Solution, Truth

F8 = NDArray[np.float64]


@dataclass(frozen=True)
class Compared:
    """A solution with its name and what `starwise.api.assess` says of it (against the truth or its own median)."""

    name: str
    solution: Solution
    stats: Mapping[str, Any]


def compare_page(items: Sequence[Compared], truth: Truth | None = None) -> bytes:
    """Several solutions as one HTML file.

    Parameters
    ----------
    items : sequence of Compared
        Two or more; differences are taken from the first where there is no truth.
    truth : Truth, optional
        Of the antenna.
    """
    first = localised(items[0].solution)
    reference = truth if truth is not None else _as_truth(items[0].solution)
    entries: list[dict[str, Any]] = []
    longest = max(range(len(items)), key=lambda i: items[i].solution.n_epochs)
    for item in items:
        local = localised(item.solution, first.origin_e)
        matched = compared(item.solution, reference)
        errors = None if matched is None else errors_by_epoch(item.solution, matched)
        entries.append(_entry(item, local, errors, None if matched is None else distribution(matched.error_n)))
    base = items[longest].solution
    local = localised(base, first.origin_e)
    data = {
        "kind": "compare",
        "epochs": epochs_payload(base, local, shown_epochs(base, local)),
        "sats": None,
        "truth": None,
        "nis": None,
        "rho": None,
        "solutions": entries,
        "reference": "truth" if truth is not None else items[0].name,
        "word": "error" if truth is not None else "difference",
        "reasons": {},
        "kinds": {},
    }
    return rendered(
        "compare.html",
        data,
        title=f"{len(items)} solutions compared",
        span=span(base),
        truth=None if truth is None else truth.source,
        reference=items[0].name,
        word=data["word"],
        rows=[_row(item) for item in items],
        inputs=[[input_row(entry) for entry in item.solution.provenance.get("inputs", ())] for item in items],
    )


def _as_truth(solution: Solution) -> Truth:
    there = solution.has_position & (solution.status != EPOCH_NO_SOLUTION)
    return Truth(solution.pos_e[there], solution.t_ns[there], "the first solution")


def _entry(item: Compared, local: Local, errors: F8 | None, cdf: dict[str, Any] | None) -> dict[str, Any]:
    solution = item.solution
    shown = shown_epochs(solution, local, errors)
    first = int(solution.t_ns[0]) if solution.n_epochs else 0
    sigma = np.sqrt((local.sigma**2).sum(axis=1))
    return {
        "name": item.name,
        "t0_ms": first // 1_000_000 + 315_964_800_000,
        "t_ms": packed((solution.t_ns[shown] - first) / 1e6, "f8"),
        "enu": [packed(local.enu[shown, k]) for k in range(3)],
        "h": packed(local.height[shown], "f8"),
        "sigma": packed(sigma[shown]) if np.isfinite(sigma).any() else None,
        "errors": None if errors is None else [packed(errors[shown, k]) for k in range(3)],
        "n_used": packed(solution.n_used[shown], "u2"),
        "cdf": cdf,
    }


def _row(item: Compared) -> dict[str, str]:
    s = item.stats
    coverage = s.get("coverage_95")
    return {
        "name": item.name,
        "method": method_of(item.solution.provenance) if item.solution.provenance.get("config") else "position file",
        "solved": f"{s['epochs_solved']} / {s['epochs']}",
        "compared": str(s["epochs_compared"]),
        "rms_2d": number(s.get("rms_2d_m")),
        "rms_3d": number(s.get("rms_3d_m")),
        "p95_3d": number(s.get("p95_3d_m")),
        "sigma": number(s.get("sigma_3d_mean_m")),
        "coverage": "–" if coverage is None else f"{100 * coverage:.1f} %",
        "nees": number(s.get("nees_mean")),
        "flagged": str(s.get("epochs_flagged", "–")),
    }
