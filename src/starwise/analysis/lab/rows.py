"""Tables of statistics: by channel, satellite, signal, system and sensor, and autocorrelations with their bounds."""

import math
from typing import Any

import numpy as np

from starwise.analysis.lab.checks_series import ljung_box, pooled_correlation
from starwise.analysis.lab.innovations import Innovations
from starwise.analysis.lab.moments import NOMINAL, whiteness_bounds
from starwise.analysis.lab.series import Series, correlation_time
from starwise.types import F8


def autocorrelations(innovations: Innovations, stats: Series) -> dict[str, dict[str, Any]]:
    """Autocorrelations by sensor and by channel, with the bound that each lag of a white series keeps with 95 %."""
    lag_s = stats.lags * innovations.interval_s
    out: dict[str, dict[str, Any]] = {}
    for kind in dict.fromkeys(c.kind for c in innovations.channels):
        members = [i for i, c in enumerate(innovations.channels) if c.kind == kind and stats.n[i] > 0]
        rho, pairs = pooled_correlation(stats, members)
        out[kind] = {"lag_s": lag_s, "rho": rho, "bound": whiteness_bounds(pairs), "kind": kind, "sv": ""}
    for i, c in enumerate(innovations.channels):
        if stats.n[i] > 0:
            bound = whiteness_bounds(stats.pairs[i])
            out[c.label] = {"lag_s": lag_s, "rho": stats.rho[i], "bound": bound, "kind": c.kind, "sv": c.sv}
    return out


def channel_rows(innovations: Innovations, stats: Series) -> list[dict[str, Any]]:
    """A row for every channel."""
    from scipy.special import chdtrc

    q, dof = ljung_box(stats)
    p = chdtrc(np.maximum(dof, 1), q)
    rows = []
    for i, c in enumerate(innovations.channels):
        row = group_row(c.label, stats, [i], innovations.interval_s)
        rows.append(
            {"sv": c.sv, "signal": c.signal, "kind": c.kind, **row, "ljung_box_p": p[i] if dof[i] else math.nan}
        )
    return rows


def group_row(name: str, stats: Series, members: list[int], interval_s: float) -> dict[str, Any]:
    """Statistics of some channels together."""
    n = stats.n[members].astype(np.float64)
    total = float(n.sum())
    rho, pairs = pooled_correlation(stats, members)
    mean = float(stats.square_mean[members].sum())

    def average(values: F8) -> float:
        known = np.isfinite(values) & (n > 0)
        return float(np.average(values[known], weights=n[known])) if known.any() else math.nan

    return {
        "name": name,
        "used": int(total),
        "refused": int(stats.refused[members].sum()),
        "nis": float(stats.square[members].sum()) / mean if mean > 0.0 else math.nan,
        "bias": average(stats.bias[members]) if len(members) == 1 else math.nan,
        "mean_z": average(stats.mean_z[members]),
        "rho_1": float(rho[0]),
        "correlation_s": correlation_time(rho, pairs, stats.lags, interval_s) if total > 0 else math.nan,
        "kurtosis": average(stats.kurtosis[members]),
        "skew": average(stats.skew[members]),
        "inside": [average(stats.inside[members][:, k]) for k in range(len(NOMINAL))],
    }
