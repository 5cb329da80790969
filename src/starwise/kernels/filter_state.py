"""Belief of a satellite filter between epochs, and the exact operations on it: clocks that enter, leave and jump."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.adapt import Rule

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]


class FilterOptions(NamedTuple):
    """Numbers of the filter."""

    sequential: bool  # S3EKF; else all at once
    gate1: float  # chi-square thresholds of the gate, 1 and 2 degrees of freedom
    gate2: float
    chi2: F8  # (k,) thresholds of the whole-epoch test by degrees of freedom; the last serves all above
    patience: int  # consecutive epochs that may fail before the filter is declared lost
    weak_patience: int  # the same in which codes were gated and the rest was too few to check itself
    velocity_sigma0: float  # start without Doppler, m/s
    acceleration_sigma0: float  # m/s^2
    drift_sigma0: float  # m/s
    intersystem_sigma0: float  # a new system's clock against the known ones, m
    intersystem_drift_sigma0: float  # m/s
    clock_loose_m: float  # clock sigma above which the clocks are aligned to the measurements before the gate
    lost_sigma_m: float  # position sigma above which the filter prefers a fresh start
    absent_s: float  # a system not seen for so long leaves the state
    memoryless: bool  # every epoch starts anew: least squares with the full covariance of the errors
    rule: Rule  # adaptation


class Belief(NamedTuple):
    """The filter's state between epochs, all preallocated; leading n = nk + 2 nc elements are in use."""

    x: F8  # (nk + 2 n_clocks,)
    P: F8
    at: I8  # (n_clocks,) position of each clock among the active ones, -1: not in the state
    seen_ns: I8  # (n_clocks,) when a row of it was last used
    missed: I8  # (n_clocks,) consecutive epochs in which all its codes were refused


class Work(NamedTuple):
    """Work space of an epoch."""

    order: I8
    ic: I8
    idr: I8
    u: F8
    g: F8
    v: F8
    r: F8
    vo: F8
    so: F8
    used: U1
    a: F8
    b: F8
    dx: F8
    sorted: F8
    lasting: F8  # (n_rows,) predicted sum of the lasting errors of each code, m; zeros where errors are white


@njit
def move_state(x: F8, P: F8, nk: int, tail: int, at: I8, new_at: I8, x2: F8, P2: F8) -> None:
    """State re-ordered to another set of active clocks; those that leave are marginalised out, exactly.

    ``at`` is overwritten by ``new_at``; elements of clocks that are new hold zeros, for `enter_clock` to fill. The
    ``tail`` elements behind the clocks move along as they are.
    """
    nc, nc2 = 0, 0
    for k in range(len(at)):
        nc = max(nc, at[k] + 1)
        nc2 = max(nc2, new_at[k] + 1)
    n2 = nk + 2 * nc2 + tail
    source = np.full(n2, -1, np.int64)
    for i in range(tail):
        source[nk + 2 * nc2 + i] = nk + 2 * nc + i
    for i in range(nk):
        source[i] = i
    for k in range(len(at)):
        if new_at[k] >= 0 and at[k] >= 0:
            source[nk + new_at[k]] = nk + at[k]
            source[nk + nc2 + new_at[k]] = nk + nc + at[k]
    for i in range(n2):
        x2[i] = x[source[i]] if source[i] >= 0 else 0.0
        for j in range(n2):
            P2[i, j] = P[source[i], source[j]] if source[i] >= 0 and source[j] >= 0 else 0.0
    for i in range(n2):
        x[i] = x2[i]
        for j in range(n2):
            P[i, j] = P2[i, j]
    for k in range(len(at)):
        at[k] = new_at[k]


@njit
def _copy_element(x: F8, P: F8, n: int, to: int, source: int, var: float) -> None:
    """Element ``to`` := element ``source`` + an independent error of variance ``var``."""
    x[to] = x[source]
    for j in range(n):
        P[to, j] = P[source, j]
    P[to, to] = P[source, source]
    for j in range(n):
        P[j, to] = P[to, j]
    P[to, to] += var


@njit
def enter_clock(x: F8, P: F8, nk: int, nc: int, tail: int, k: int, ref: int, var: float, drift_var: float) -> None:
    """Active clock k starts as the active clock ``ref`` plus an independent offset: the oscillator is the same."""
    n = nk + 2 * nc + tail
    _copy_element(x, P, n, nk + k, nk + ref, var)
    _copy_element(x, P, n, nk + nc + k, nk + nc + ref, drift_var)


@njit
def forget_common_clock(x: F8, P: F8, nk: int, nc: int, tail: int, shift: float, var: float) -> None:
    """Shift all clocks by ``shift`` and forget what was known of their common part; differences stay as known.

    With c_k = c_0 + d_k: c_0 is marginalised out and put back with variance ``var``, independent of all else.
    """
    n = nk + 2 * nc + tail
    for k in range(1, nc):
        for j in range(n):
            P[nk + k, j] -= P[nk, j]
        for j in range(n):
            P[j, nk + k] -= P[j, nk]
    for j in range(n):
        P[nk, j] = 0.0
        P[j, nk] = 0.0
    P[nk, nk] = var
    for k in range(1, nc):
        for j in range(n):
            P[nk + k, j] += P[nk, j]
        for j in range(n):
            P[j, nk + k] += P[j, nk]
    for k in range(nc):
        x[nk + k] += shift


@njit
def start_filter(
    options: FilterOptions, nk: int, t_ns: int, xs: F8, Ps: F8, vel: F8, Pv: F8, scale: float, belief: Belief
) -> int:
    """Belief from a least-squares solution (see `spp_epoch`); variances times ``scale``. The number of clocks."""
    x, P, at = belief.x, belief.P, belief.at
    nc = 0
    for k in range(len(at)):
        at[k] = -1
        belief.missed[k] = 0
        if xs[3 + k] == xs[3 + k]:
            at[k] = nc
            belief.seen_ns[k] = t_ns
            nc += 1
    n = nk + 2 * nc
    for i in range(n):
        x[i] = 0.0
        for j in range(n):
            P[i, j] = 0.0
    for i in range(3):
        x[i] = xs[i]
        for j in range(3):
            P[i, j] = scale * Ps[i, j]
    for k in range(len(at)):
        if at[k] < 0:
            continue
        c = nk + at[k]
        x[c] = xs[3 + k]
        for i in range(3):
            P[c, i] = scale * Ps[3 + k, i]
            P[i, c] = P[c, i]
        for j in range(len(at)):
            if at[j] >= 0:
                P[c, nk + at[j]] = scale * Ps[3 + k, 3 + j]
    known = vel[0] == vel[0] and nk > 3
    for i in range(nk - 3):
        if i >= 3:
            P[3 + i, 3 + i] = options.acceleration_sigma0**2
        elif known:
            x[3 + i] = vel[i]
            for j in range(3):
                P[3 + i, 3 + j] = scale * Pv[i, j]
        else:
            P[3 + i, 3 + i] = options.velocity_sigma0**2
    d0 = nk + nc
    drift_known = vel[3] == vel[3]
    for k in range(nc):
        for j in range(nc):
            P[d0 + k, d0 + j] = scale * Pv[3, 3] if drift_known else options.drift_sigma0**2
        P[d0 + k, d0 + k] += options.intersystem_drift_sigma0**2
        if drift_known:
            x[d0 + k] = vel[3]
        if known:
            for i in range(3):
                P[d0 + k, 3 + i] = scale * Pv[3, i]
                P[3 + i, d0 + k] = P[d0 + k, 3 + i]
    return nc
