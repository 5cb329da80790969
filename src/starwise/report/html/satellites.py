"""The ledger as a page shows it: a cell per epoch and satellite, and exact stretches of what became of each."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    ROW_COMBINED,
    ROW_EPOCH_UNSOLVED,
    ROW_EXCLUDED,
    ROW_GATED,
    ROW_NOT_SELECTED,
    ROW_STATUS_NAMES,
    ROW_USED,
)
from starwise.report.html.encode import packed, thinned
from starwise.signals import sv_name
from starwise.types import Solution

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

MAX_CELLS: Final = 80_000
"""Cells with all their numbers; of more, extremes of the residuals are kept. Eighteen bytes each."""
MAX_RUNS: Final = 60_000
LAGS: Final = 20
"""Lags of the autocorrelation."""


@dataclass(frozen=True)
class Cells:
    """What became of each satellite at each epoch: the row that carries the model, else the one that came furthest.

    Sorted by satellite, then epoch. All arrays (n,).

    Attributes
    ----------
    sv : int64
        Satellite identifier.
    epoch : int64
        Index of the epoch in the solution.
    row : int64
        Row of the ledger.
    status : uint8
        ``ROW_*``.
    """

    sv: I8
    epoch: I8
    row: I8
    status: NDArray[np.uint8]

    @property
    def n(self) -> int:
        """Number of cells."""
        return len(self.sv)


def cells_of(solution: Solution) -> Cells | None:
    """Cells of a solution's ledger; None where it has none of satellites."""
    ledger = solution.ledger
    if "sv" not in ledger or "status" not in ledger or not len(ledger["sv"]) or not solution.n_epochs:
        return None
    t, sv = ledger["t_ns"], ledger["sv"].astype(np.int64)
    status = ledger["status"].astype(np.int64)
    rank = _ranks()[status]
    terms = ledger.get("innovation_m")
    if terms is not None:
        rank = rank + (np.isnan(terms) & (status == ROW_USED))
    start = np.flatnonzero(np.r_[True, (t[1:] != t[:-1]) | (sv[1:] != sv[:-1])])
    best = np.minimum.reduceat(rank * len(sv) + np.arange(len(sv)), start) % len(sv)
    epoch = np.searchsorted(solution.t_ns, t[best])
    known = (epoch < solution.n_epochs) & (solution.t_ns[np.minimum(epoch, solution.n_epochs - 1)] == t[best])
    best, epoch = best[known], epoch[known]
    if not len(best):
        return None
    order = np.argsort(sv[best] * np.int64(solution.n_epochs + 1) + epoch, kind="stable")
    best, epoch = best[order], epoch[order]
    return Cells(sv[best], epoch, best, ledger["status"][best].astype(np.uint8))


def _ranks() -> I8:
    """Which of a satellite's rows speaks for it: used first, then those that came furthest before they were refused."""
    rank = 10 + np.arange(len(ROW_STATUS_NAMES), dtype=np.int64) * 2
    rank[[ROW_USED, ROW_GATED, ROW_EXCLUDED, ROW_EPOCH_UNSOLVED]] = (0, 2, 4, 6)
    rank[[ROW_COMBINED, ROW_NOT_SELECTED]] = (1000, 1002)
    return rank


def column(solution: Solution, name: str, rows: I8) -> F8 | None:
    """A column of the ledger at rows, float64; None where there is none such."""
    values = solution.ledger.get(name)
    return None if values is None else np.asarray(values[rows], dtype=np.float64)


def normalised(solution: Solution, rows: I8) -> F8 | None:
    """Innovation (least squares: residual) over its sigma, no unit; NaN where it has none."""
    v, s = column(solution, "innovation_m", rows), column(solution, "innovation_var_m2", rows)
    if v is None or s is None:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(s > 0.0, v / np.sqrt(s), np.nan)


def satellites_payload(solution: Solution, cells: Cells) -> dict[str, Any]:
    """Cells, stretches and statistics per satellite, packed."""
    names, index = np.unique(cells.sv, return_inverse=True)
    norm = normalised(solution, cells.row)
    kept = _kept(cells, norm)
    row = cells.row[kept]
    out: dict[str, Any] = {
        "names": [sv_name(int(i)) for i in names],
        "ptr": np.searchsorted(index[kept], np.arange(len(names) + 1)).tolist(),
        "epoch": packed(cells.epoch[kept], "u4"),
        "status": packed(cells.status[kept], "u1"),
        "statuses": list(ROW_STATUS_NAMES),
        "all": len(kept) == cells.n,
        "runs": _runs(cells, index, kept),
        "table": _table(cells, index, len(names), norm, column(solution, "innovation_m", cells.row)),
    }
    for key, name, scale in (("el", "elevation_rad", 100.0), ("az", "azimuth_rad", 100.0)):
        values = column(solution, name, row)
        if values is not None:
            degrees = np.degrees(values) % 360.0 if key == "az" else np.degrees(values)
            out[key] = packed(np.where(np.isnan(degrees), -327.68, np.where(degrees > 327.0, degrees - 360.0, degrees))
                              * scale, "i2")  # fmt: skip
    cn0 = column(solution, "cn0_dbhz", row)
    if cn0 is not None and np.isfinite(cn0).any():
        out["cn0"] = packed(np.nan_to_num(cn0) * 4.0, "u1")
    if norm is not None:
        out["v"] = packed(_of(solution, "innovation_m", row), "f4")
        out["vn"] = packed(np.where(np.isnan(norm[kept]), -327.68, norm[kept]) * 100.0, "i2")
    rate = column(solution, "rate_innovation_mps", row)
    if rate is not None and np.isfinite(rate).any():
        out["rate"] = packed(rate, "f4")
    return out


def _of(solution: Solution, name: str, rows: I8) -> F8:
    values = column(solution, name, rows)
    assert values is not None
    return values


def _kept(cells: Cells, norm: F8 | None) -> I8:
    """Cells to be sent: all, or of each satellite's stretches the extremes."""
    if cells.n <= MAX_CELLS:
        return np.arange(cells.n)
    series = [norm] if norm is not None else []
    return thinned([*series, cells.status.astype(np.float64)], MAX_CELLS)


def _runs(cells: Cells, index: I8, kept: I8) -> dict[str, Any]:
    """Stretches of unbroken epochs of a satellite with the same status: satellite, status, first and last epoch."""
    for which in (np.arange(cells.n), kept):
        sv, epoch, status = index[which], cells.epoch[which], cells.status[which]
        new = (sv[1:] != sv[:-1]) | (status[1:] != status[:-1])
        if len(which) == cells.n:
            new |= epoch[1:] != epoch[:-1] + 1
        first = np.flatnonzero(np.r_[True, new])
        if len(first) <= MAX_RUNS:
            break
    last = np.r_[first[1:] - 1, len(sv) - 1]
    return {
        "sv": packed(sv[first], "u2"),
        "status": packed(status[first], "u1"),
        "first": packed(epoch[first], "u4"),
        "last": packed(epoch[last], "u4"),
    }


def _table(cells: Cells, index: I8, n: int, norm: F8 | None, v: F8 | None) -> dict[str, Any]:
    """Per satellite: epochs seen, used, and root mean square and mean of the used innovations, m and normalised."""
    used = cells.status == ROW_USED
    out: dict[str, Any] = {
        "seen": np.bincount(index, minlength=n).tolist(),
        "used": np.bincount(index[used], minlength=n).tolist(),
    }
    for key, values in (("m", v), ("n", norm)):
        if values is None:
            continue
        there = used & np.isfinite(values)
        count = np.bincount(index[there], minlength=n)
        with np.errstate(invalid="ignore", divide="ignore"):
            out[f"mean_{key}"] = (np.bincount(index[there], values[there], n) / count).round(4).tolist()
            out[f"rms_{key}"] = np.sqrt(np.bincount(index[there], values[there] ** 2, n) / count).round(4).tolist()
    return out


def autocorrelation_payload(solution: Solution, cells: Cells) -> dict[str, Any] | None:
    """Autocorrelation of each satellite's normalised innovations, over all satellites together, at lags in epochs.

    The bounds hold 95 % of the lags of a white series, each by itself and all together.
    """
    from starwise.analysis.consistency import whiteness_bound

    norm = normalised(solution, cells.row)
    if norm is None:
        return None
    there = (cells.status == ROW_USED) & np.isfinite(norm)
    if not there.any():
        return None
    key, v = cells.sv[there] * np.int64(solution.n_epochs + LAGS + 1) + cells.epoch[there], np.clip(norm[there], -6, 6)
    rho, pairs = [], []
    for lag in range(1, LAGS + 1):
        later = np.minimum(np.searchsorted(key, key + lag), len(key) - 1)
        same = key[later] == key + lag
        a, b = v[same], v[later[same]]
        size = float(np.sqrt((a * a).sum() * (b * b).sum()))
        if len(a) < 20 or size == 0.0:
            break
        rho.append(float((a * b).sum()) / size)
        pairs.append(len(a))
    if len(rho) < 2:
        return None
    K = min(pairs)
    return {"rho": rho, "pairs": pairs, "each": whiteness_bound(K), "all": whiteness_bound(K, 1, len(rho))}
