"""Normalised innovations squared over time: of epochs and of windows, with the degrees of freedom that were there."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.analysis.consistency import PROBABILITY
from starwise.analysis.lab.innovations import Innovations
from starwise.analysis.lab.moments import row_moments
from starwise.analysis.lab.plain import plain
from starwise.types import F8, I8


@dataclass(frozen=True)
class Windows:
    """NIS of windows of epochs.

    Attributes
    ----------
    t_ns : (k,) int64
        Middle of the window, GPST ns.
    per_dof : (k,) float64
        NIS over its expectation: 1 where the filter is right; NaN: no row.
    dof : (k,) float64
        Degrees of freedom: rows used (residuals: as the fit says).
    low, high : (k,) float64
        Region that holds 95 % of windows of a right filter.
    """

    t_ns: I8
    per_dof: F8
    dof: F8
    low: F8
    high: F8

    def to_dict(self) -> dict[str, Any]:
        """Plain lists."""
        return {
            "t_gpst_ns": self.t_ns.tolist(),
            **{name: plain(getattr(self, name)) for name in ("per_dof", "dof", "low", "high")},
        }


def windows(table: Innovations, epochs: int) -> Windows:
    """NIS of successive windows of so many epochs.

    A row processed by itself has one degree of freedom, whatever satellites come and go; the region is that of a gamma
    distribution with the moments of rows inside the gate.
    """
    from scipy.special import gammaincinv

    m = len(table.t_ns)
    window = np.arange(m) // epochs
    k = int(window[-1]) + 1 if m else 0
    if table.residuals and len(table.nis) == m:
        known = np.isfinite(table.nis) & (table.dof > 0)
        value: NDArray[Any] = np.bincount(window[known], weights=table.nis[known], minlength=k)
        dof: NDArray[Any] = np.asarray(
            np.bincount(window[known], weights=table.dof[known], minlength=k), dtype=np.float64
        )
        mean: NDArray[Any] = dof
        var: NDArray[Any] = 2.0 * dof
    else:
        rows = np.flatnonzero(table.used)
        at = window[table.epoch[rows]]
        two, four = row_moments(table.gate[rows], table.gate_probability)
        value = np.bincount(at, weights=table.z[rows] ** 2, minlength=k)
        dof = np.bincount(at, minlength=k).astype(np.float64)
        mean = np.bincount(at, weights=two, minlength=k)
        var = np.bincount(at, weights=four - two * two, minlength=k)
    tail = 0.5 * (1.0 - PROBABILITY)
    with np.errstate(divide="ignore", invalid="ignore"):
        shape = mean * mean / var
        low, high = (gammaincinv(shape, p) / shape for p in (tail, 1.0 - tail))
        per_dof = value / mean
    first = np.searchsorted(window, np.arange(k))
    last = np.searchsorted(window, np.arange(k), side="right") - 1
    middle = table.t_ns[first] + (table.t_ns[last] - table.t_ns[first]) // 2
    return Windows(middle, per_dof, dof, low, high)
