"""Velocity of one epoch by weighted least squares on pseudorange rates, tested and with exclusion."""

import numpy as np
from numpy.typing import NDArray

from starwise.constants import ROW_USED
from starwise.kernels._jit import njit
from starwise.kernels.linalg import cholesky, cholesky_inverse, cholesky_solve
from starwise.kernels.rangemodel import RowModel, Rows, range_los, range_rate

F8 = NDArray[np.float64]

RATES_NONE = 0  # too few rates for a velocity
RATES_UNCHECKED = 1  # exactly four: a velocity that nothing checks
RATES_CHECKED = 2  # a velocity whose rates agree
RATES_FAILED = 3  # rates that contradict each other, and no exclusion that helps
UNCHECKED_VARIANCE = 100.0  # factor on the covariance of a velocity that nothing checks: sigma times ten


@njit
def fill(values: F8, value: float) -> None:
    """Set all elements (a loop compiles faster than a slice)."""
    for i in range(len(values)):
        values[i] = value


@njit
def threshold(table: F8, dof: int) -> float:
    """Threshold for ``dof`` degrees of freedom (or rows) out of a table by that number."""
    return float(table[min(dof, len(table) - 1)])


@njit
def predicted_variance(ux: float, uy: float, uz: float, Q: F8, c: int) -> float:
    """Variance h Q h' of a pseudorange predicted by the solution; its clock is element c."""
    return float(
        ux * (Q[0, 0] * ux + 2.0 * (Q[0, 1] * uy + Q[0, 2] * uz - Q[0, c]))
        + uy * (Q[1, 1] * uy + 2.0 * (Q[1, 2] * uz - Q[1, c]))
        + uz * (Q[2, 2] * uz - 2.0 * Q[2, c])
        + Q[c, c]
    )


@njit
def _rate_equations(
    rows: Rows, start: int, end: int, px: float, py: float, pz: float, vel: F8, N: F8, g: F8, out: RowModel
) -> float:
    """Normal equations of velocity and drift, residuals of all rates of used satellites, weighted sum of squares."""
    h = np.empty(4)
    for a in range(4):
        g[a] = 0.0
        for b in range(4):
            N[a, b] = 0.0
    sse = 0.0
    for i in range(start, end):
        if out.status[i] != ROW_USED or rows.rate_mps[i] != rows.rate_mps[i]:
            continue
        _, _, ux, uy, uz = range_los(px, py, pz, rows.sat_pos[i, 0], rows.sat_pos[i, 1], rows.sat_pos[i, 2])
        model = range_rate(px, py, vel[0], vel[1], vel[2], ux, uy, uz, rows.sat_pos, rows.sat_vel, i)
        v = rows.rate_mps[i] - (model + vel[3] - rows.drift_mps[i])
        out.v_rate[i] = v
        if out.rate_used[i] == 0:
            continue
        w = 1.0 / out.rate_var[i]
        h[0], h[1], h[2], h[3] = -ux, -uy, -uz, 1.0
        for a in range(4):
            g[a] += w * h[a] * v
            for b in range(a + 1):
                N[a, b] += w * h[a] * h[b]
        sse += w * v * v
    return sse


@njit
def _worst_rate(rows: Rows, start: int, end: int, px: float, py: float, pz: float, Pv: F8, out: RowModel) -> int:
    """Rate with the largest normalised residual, -1 if none is redundant; writes ``s_rate``."""
    worst, worst_w2 = -1, 0.0
    for i in range(start, end):
        if out.rate_used[i] == 0:
            continue
        _, _, ux, uy, uz = range_los(px, py, pz, rows.sat_pos[i, 0], rows.sat_pos[i, 1], rows.sat_pos[i, 2])
        s = out.rate_var[i] - predicted_variance(ux, uy, uz, Pv, 3)
        out.s_rate[i] = max(s, 0.0)
        if s < 1e-6 * out.rate_var[i]:
            continue
        w2 = out.v_rate[i] * out.v_rate[i] / s
        if w2 > worst_w2:
            worst, worst_w2 = i, w2
    return worst


@njit
def spp_velocity(
    fde: bool, chi2: F8, max_excluded: float, rows: Rows, start: int, end: int, px: float, py: float, pz: float,
    vel: F8, Pv: F8, out: RowModel,
) -> int:  # fmt: skip
    """Velocity and one clock drift from the Doppler rows of the used satellites of an epoch.

    Five or more rates have to pass a chi-square test; with two or more to spare the one with the largest normalised
    residual goes first, and the next, up to the fraction ``max_excluded`` of them. Without that there is no velocity.
    Four rates give a velocity that nothing checks: its covariance is `UNCHECKED_VARIANCE` times the formal one.

    Parameters
    ----------
    vel : (4,)
        Out: velocity (m/s, ECEF) and clock drift (m/s); NaN without a solution.
    Pv : (4, 4)
        Out: its covariance.

    Returns
    -------
    int
        ``RATES_*``.
    """
    N = np.empty((4, 4))
    g = np.empty(4)
    fill(vel, 0.0)
    n = 0
    for i in range(start, end):
        ok = out.status[i] == ROW_USED and rows.rate_mps[i] == rows.rate_mps[i]
        out.rate_used[i] = 1 if ok else 0
        out.v_rate[i], out.s_rate[i] = np.nan, np.nan
        n += 1 if ok else 0
    n_all = n
    result = RATES_NONE
    while n >= 4:
        solved, sse = False, 0.0
        for _ in range(2):  # linear but for the tiny Sagnac rate
            sse = _rate_equations(rows, start, end, px, py, pz, vel, N, g, out)
            solved = cholesky(N, 4)
            if not solved:
                break
            cholesky_solve(N, g, 4)
            for a in range(4):
                vel[a] += g[a]
        if not solved:
            result = RATES_NONE if n == n_all else RATES_FAILED
            break
        _rate_equations(rows, start, end, px, py, pz, vel, N, g, out)
        cholesky(N, 4)
        cholesky_inverse(N, Pv, 4)
        worst = _worst_rate(rows, start, end, px, py, pz, Pv, out)
        if n == 4:
            for a in range(4):
                for b in range(4):
                    Pv[a, b] *= UNCHECKED_VARIANCE
            return RATES_UNCHECKED
        if sse <= threshold(chi2, n - 4):
            return RATES_CHECKED
        if not fde or n < 6 or worst < 0 or n_all - n + 1 > max_excluded * n_all:
            result = RATES_FAILED
            break
        out.rate_used[worst] = 0
        n -= 1
    fill(vel, np.nan)
    for i in range(start, end):
        out.rate_used[i] = 0
        out.v_rate[i], out.s_rate[i] = np.nan, np.nan
    return result
