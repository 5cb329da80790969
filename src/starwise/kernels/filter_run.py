"""All epochs of a run through the EKF (all satellites at once) or the S3EKF (satellite by satellite).

An epoch: predict; model the rows at the predicted position; align the clocks if they jumped or are unknown; take
satellites in or out of the state; update with the gate inside; judge the epoch as a whole; start again from least
squares if the filter is lost.

The satellites of an epoch are taken in the order of their measurement variance, the best first, so that the first
decisions of the gate rest on the best measurements, and the order of rows in a file has no influence.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    C_LIGHT,
    EPOCH_COASTED,
    EPOCH_NO_SOLUTION,
    EPOCH_OK,
    EPOCH_RESET,
    EPOCH_SUSPECT,
    OMEGA_E_GPS,
    ROW_GATED,
    ROW_USED,
)
from starwise.kernels._jit import njit
from starwise.kernels.process import Process, motion, noise_shape, predict
from starwise.kernels.rangemodel import (
    Epochs,
    ModelOptions,
    RowModel,
    Rows,
    epoch_corrections,
    range_los,
    range_rate,
)
from starwise.kernels.spp import EpochOut, SppOptions, dops, spp_epoch, threshold
from starwise.kernels.update import USED_CODE, USED_RATE, mirror, update_batch, update_satellite, update_sequential

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]

SAGNAC = OMEGA_E_GPS / C_LIGHT


class FilterOptions(NamedTuple):
    """Numbers of the filter."""

    sequential: bool  # S3EKF; else all at once
    gate1: float  # chi-square thresholds of the gate, 1 and 2 degrees of freedom
    gate2: float
    chi2: F8  # (k,) thresholds of the whole-epoch test by degrees of freedom; the last serves all above
    patience: int  # consecutive epochs that may fail before the filter is declared lost
    velocity_sigma0: float  # start without Doppler, m/s
    acceleration_sigma0: float  # m/s^2
    drift_sigma0: float  # m/s
    intersystem_sigma0: float  # a new system's clock against the known ones, m
    intersystem_drift_sigma0: float  # m/s
    clock_loose_m: float  # clock sigma above which the clocks are aligned to the measurements before the gate
    lost_sigma_m: float  # position sigma above which the filter prefers a fresh start
    absent_s: float  # a system not seen for so long leaves the state


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


@njit
def move_state(x: F8, P: F8, nk: int, at: I8, new_at: I8, x2: F8, P2: F8) -> None:
    """State re-ordered to another set of active clocks; those that leave are marginalised out, exactly.

    ``at`` is overwritten by ``new_at``; elements of clocks that are new hold zeros, for `enter_clock` to fill.
    """
    nc, nc2 = 0, 0
    for k in range(len(at)):
        nc = max(nc, at[k] + 1)
        nc2 = max(nc2, new_at[k] + 1)
    n2 = nk + 2 * nc2
    source = np.full(n2, -1, np.int64)
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
def enter_clock(x: F8, P: F8, nk: int, nc: int, k: int, ref: int, var: float, drift_var: float) -> None:
    """Active clock k starts as the active clock ``ref`` plus an independent offset: the oscillator is the same."""
    n = nk + 2 * nc
    _copy_element(x, P, n, nk + k, nk + ref, var)
    _copy_element(x, P, n, nk + nc + k, nk + nc + ref, drift_var)


@njit
def forget_common_clock(x: F8, P: F8, nk: int, nc: int, shift: float, var: float) -> None:
    """Shift all clocks by ``shift`` and forget what was known of their common part; differences stay as known.

    With c_k = c_0 + d_k: c_0 is marginalised out and put back with variance ``var``, independent of all else.
    """
    n = nk + 2 * nc
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
def median(values: F8, n: int) -> float:
    """Median of the first n values, which are sorted in place (few)."""
    for i in range(1, n):
        v = values[i]
        j = i - 1
        while j >= 0 and values[j] > v:
            values[j + 1] = values[j]
            j -= 1
        values[j + 1] = v
    return float(0.5 * (values[(n - 1) // 2] + values[n // 2]))


@njit
def _code_innovation(rows: Rows, out: RowModel, i: int, x: F8, c: int) -> float:
    """Innovation of the code of row i at state x, clock at element c; m."""
    rho, sagnac, _, _, _ = range_los(x[0], x[1], x[2], rows.sat_pos[i, 0], rows.sat_pos[i, 1], rows.sat_pos[i, 2])
    return float(rows.code_m[i] - (rho + sagnac + x[c] - rows.clock_m[i] + out.troposphere[i] + out.ionosphere[i]))


@njit
def _linearise(
    rows: Rows, out: RowModel, i: int, x: F8, moving: bool, c: int, d: int
) -> tuple[float, float, float, float, float, float, float, float]:
    """Innovations of code and rate of row i at state x, and the Jacobian of both.

    Returns v_code, v_rate; -d code / d pos = -d rate / d vel (the unit vector plus the Sagnac term's gradient);
    d rate / d pos = -(v_rel - (u . v_rel) u) / rho + its Sagnac part. Groves (2013) 9.162 differentiated.
    """
    sx, sy = rows.sat_pos[i, 0], rows.sat_pos[i, 1]
    wx, wy, wz = rows.sat_vel[i, 0], rows.sat_vel[i, 1], rows.sat_vel[i, 2]
    rho, sagnac, ux, uy, uz = range_los(x[0], x[1], x[2], sx, sy, rows.sat_pos[i, 2])
    out.geometric[i], out.sagnac[i] = rho, sagnac
    v1 = rows.code_m[i] - (rho + sagnac + x[c] - rows.clock_m[i] + out.troposphere[i] + out.ionosphere[i])
    vx, vy, vz = 0.0, 0.0, 0.0
    if moving:
        vx, vy, vz = x[3], x[4], x[5]
    rate = range_rate(x[0], x[1], vx, vy, vz, ux, uy, uz, rows.sat_pos, rows.sat_vel, i)
    v2 = rows.rate_mps[i] - (rate + x[d] - rows.drift_mps[i])
    along = ux * (wx - vx) + uy * (wy - vy) + uz * (wz - vz)
    gx = (along * ux - (wx - vx)) / rho - SAGNAC * wy
    gy = (along * uy - (wy - vy)) / rho + SAGNAC * wx
    gz = (along * uz - (wz - vz)) / rho
    return v1, v2, ux + SAGNAC * sy, uy - SAGNAC * sx, uz, gx, gy, gz


@njit
def _arrange(rows: Rows, out: RowModel, start: int, end: int, work: Work) -> int:
    """Usable rows of an epoch, the smallest code variance first, into ``work.order``; their number."""
    m = 0
    for i in range(start, end):
        out.rate_used[i] = 0
        out.v_code[i], out.s_code[i], out.v_rate[i], out.s_rate[i] = np.nan, np.nan, np.nan, np.nan
        if out.status[i] != ROW_USED:
            continue
        j = m - 1
        while j >= 0 and out.code_var[work.order[j]] > out.code_var[i]:
            work.order[j + 1] = work.order[j]
            j -= 1
        work.order[j + 1] = i
        m += 1
    return m


@njit
def _update_linear(
    options: FilterOptions, rows: Rows, out: RowModel, m: int, x: F8, P: F8, nk: int, nc: int, at: I8,
    x1: F8, work: Work,
) -> tuple[float, int]:  # fmt: skip
    """Update of x, P with rows linearised at another state x1: v = z - h(x1) - H (x - x1). NIS and its degrees."""
    n, moving = nk + 2 * nc, nk > 3
    for j in range(n):
        work.dx[j] = x[j] - x1[j]
    for k in range(m):
        i = work.order[k]
        work.ic[k] = nk + at[rows.clock[i]]
        work.idr[k] = work.ic[k] + nc
        v1, v2, ux, uy, uz, gx, gy, gz = _linearise(rows, out, i, x1, moving, work.ic[k], work.idr[k])
        work.u[k, 0], work.u[k, 1], work.u[k, 2] = ux, uy, uz
        work.g[k, 0], work.g[k, 1], work.g[k, 2] = gx, gy, gz
        work.v[k, 0], work.v[k, 1] = v1, v2
        work.r[k, 0] = out.code_var[i]
        work.r[k, 1] = out.rate_var[i] if v2 == v2 else np.inf
    if options.sequential:
        nis, dof = update_sequential(
            work.dx, P, n, moving, work.ic, work.idr, work.u, work.g, work.v, work.r, m,
            options.gate1, options.gate2, work.vo, work.so, work.used,
        )  # fmt: skip
    else:
        nis, dof = update_batch(
            work.dx, P, n, moving, work.ic, work.idr, work.u, work.g, work.v, work.r, m,
            options.gate1, options.gate2, work.vo, work.so, work.used,
        )  # fmt: skip
    for j in range(n):
        x[j] = x1[j] + work.dx[j]
    return nis, dof


@njit
def _update_satellites(
    options: FilterOptions, rows: Rows, out: RowModel, m: int, x: F8, P: F8, nk: int, nc: int, at: I8, work: Work
) -> tuple[float, int]:
    """Eq. 5c for all satellites: h and H at the state that the satellite before has left. NIS and its degrees."""
    n, moving = nk + 2 * nc, nk > 3
    nis, dof = 0.0, 0
    for k in range(m):
        i = work.order[k]
        c = nk + at[rows.clock[i]]
        d = c + nc
        v1, v2, ux, uy, uz, gx, gy, gz = _linearise(rows, out, i, x, moving, c, d)
        r2 = out.rate_var[i] if v2 == v2 else np.inf
        bits, q, s1, s2 = update_satellite(
            x, P, n, moving, c, d, ux, uy, uz, gx, gy, gz, v1, v2, out.code_var[i], r2,
            options.gate1, options.gate2, work.a, work.b,
        )  # fmt: skip
        work.used[k] = bits
        work.vo[k, 0], work.vo[k, 1], work.so[k, 0], work.so[k, 1] = v1, v2, s1, s2
        nis += q
        dof += (bits & 1) + (bits >> 1)
    mirror(P, n)
    return nis, dof


@njit
def update_epoch(
    options: FilterOptions, rows: Rows, out: RowModel, m: int, x: F8, P: F8, nk: int, nc: int, at: I8,
    x2: F8, P2: F8, work: Work,
) -> tuple[float, int, int, bool]:  # fmt: skip
    """Measurement update of one epoch with the rows in ``work.order``; x and P in place, row outputs written.

    If it moves the position by more than 20 m, it is done once more from the prediction with the rows linearised at
    its result (iterated EKF, Groves 3.4.1): what the curvature of the ranges leaves, 20^2 / (2 rho), is 0.01 mm.

    Returns
    -------
    nis : float
        Sum over the used rows.
    dof : int
        Their number.
    n_used : int
        Satellites whose code was used.
    agreed : bool
        At least half of the codes were used, and of the rates where there are four or more (a receiver that moves
        under a static model shows in its rates first).
    """
    n = nk + 2 * nc
    for i in range(n):
        x2[i] = x[i]
        for j in range(n):
            P2[i, j] = P[i, j]
    if options.sequential:
        nis, dof = _update_satellites(options, rows, out, m, x, P, nk, nc, at, work)
    else:
        nis, dof = _update_linear(options, rows, out, m, x, P, nk, nc, at, x2, work)
    dx, dy, dz = x[0] - x2[0], x[1] - x2[1], x[2] - x2[2]
    if dx * dx + dy * dy + dz * dz > 400.0:
        for i in range(n):
            x[i], x2[i] = x2[i], x[i]
            for j in range(n):
                P[i, j] = P2[i, j]
        nis, dof = _update_linear(options, rows, out, m, x, P, nk, nc, at, x2, work)
    n_used, n_rates, n_rates_used = 0, 0, 0
    for k in range(m):
        i = work.order[k]
        n_rates += 1 if work.so[k, 1] == work.so[k, 1] else 0
        n_rates_used += 1 if work.used[k] & USED_RATE else 0
        out.v_code[i], out.v_rate[i] = work.vo[k, 0], work.vo[k, 1]
        out.s_code[i], out.s_rate[i] = work.so[k, 0], work.so[k, 1]
        out.rate_used[i] = 1 if work.used[k] & USED_RATE else 0
        if work.used[k] & USED_CODE:
            out.status[i] = ROW_USED
            n_used += 1
        else:
            out.status[i] = ROW_GATED
    return nis, dof, n_used, 2 * n_used >= m and (n_rates < 4 or 2 * n_rates_used >= n_rates)


@njit
def align_clocks(
    options: FilterOptions, rows: Rows, out: RowModel, m: int, x: F8, P: F8, nk: int, nc: int, at: I8, work: Work
) -> bool:
    """Absorb a step common to all clocks: a reset of the receiver's clock, or a clock unknown after a gap.

    The median of the code innovations of all systems is robust against bad satellites and blind to inter-system
    offsets, which are known. It is a step if it is far outside what the prediction allows while at least 60 % of the
    satellites (three or more) agree on it within their own uncertainty. Then the common clock is forgotten and
    starts again at the median with a variance far above the median's own, so that the measurements are not counted
    twice to any effect. Doppler knows nothing of steps: the drifts stay.
    """
    if m == 0:
        return False
    s_clk = P[nk, nk]
    for k in range(1, nc):
        s_clk = min(s_clk, P[nk + k, nk + k])
    s_pos = P[0, 0] + P[1, 1] + P[2, 2]
    loose = s_clk > options.clock_loose_m**2
    count = 0
    for k in range(m):
        i = work.order[k]
        if at[rows.clock[i]] < 0:
            continue
        c = nk + at[rows.clock[i]]
        v1 = _code_innovation(rows, out, i, x, c)
        work.v[k, 0] = v1
        work.sorted[count] = v1
        count += 1
    if count == 0 or (count < 3 and not loose):
        return False
    middle = median(work.sorted, count)
    if not loose and middle * middle < 36.0 * (s_clk + s_pos):
        return False
    agree, spread2 = 0, 0.0
    for k in range(m):
        i = work.order[k]
        if at[rows.clock[i]] < 0:
            continue
        e2 = (work.v[k, 0] - middle) ** 2
        if e2 < 16.0 * (out.code_var[i] + s_pos):
            agree += 1
            spread2 += e2 + out.code_var[i]
    if agree < max(3, math.ceil(0.6 * count)):
        if not loose or agree == 0:
            return False
        spread2 = max(spread2, s_clk)  # too few to be sure: as loose as before
    else:
        spread2 = 25.0 * spread2 / agree
    forget_common_clock(x, P, nk, nc, middle, spread2)
    return True


@njit
def activate_clocks(
    options: FilterOptions, rows: Rows, out: RowModel, m: int, t_ns: int, nk: int, nc: int, belief: Belief,
    x2: F8, P2: F8, work: Work,
) -> int:  # fmt: skip
    """Take clocks of systems that appear into the state and those absent for long out of it; the new number.

    A system whose codes were all refused for `patience` epochs has stepped against the others: it enters anew.
    """
    at = belief.at
    n_all = len(at)
    want = np.zeros(n_all, np.bool_)
    fresh = np.zeros(n_all, np.bool_)
    for k in range(m):
        want[rows.clock[work.order[k]]] = True
    change = False
    refs = 0
    for k in range(n_all):
        if at[k] >= 0:
            again = want[k] and belief.missed[k] >= options.patience and nc > 1
            stale = not want[k] and (t_ns - belief.seen_ns[k]) * 1e-9 > options.absent_s
            if again:
                fresh[k] = True
                change = True
            elif stale:
                change = True
            else:
                want[k] = True
                refs += 1
        elif want[k]:
            fresh[k] = True
            change = True
    if not change:
        return nc
    if refs == 0:
        # Everything known would go: keep the clock seen last as the bridge to the oscillator.
        keep = -1
        for k in range(n_all):
            if at[k] >= 0 and (keep < 0 or belief.seen_ns[k] > belief.seen_ns[keep]):
                keep = k
        want[keep] = True
        fresh[keep] = False
    new_at = np.full(n_all, -1, np.int64)
    count, ref, best = 0, -1, np.inf
    for k in range(n_all):
        if want[k]:
            new_at[k] = count
            count += 1
            if not fresh[k]:
                p = belief.P[nk + at[k], nk + at[k]]
                if p < best:
                    ref, best = k, p
    old_at = at.copy()
    move_state(belief.x, belief.P, nk, at, new_at, x2, P2)
    for k in range(n_all):
        if not fresh[k]:
            continue
        wide = 1e3 if old_at[k] >= 0 else 1.0  # a system that stepped: anything up to a millisecond
        sigma = wide * options.intersystem_sigma0
        enter_clock(
            belief.x, belief.P, nk, count, new_at[k], new_at[ref], sigma * sigma, options.intersystem_drift_sigma0**2
        )
        belief.missed[k] = 0
        belief.seen_ns[k] = t_ns
        # Several satellites of it: start at the median of what they say.
        c = nk + new_at[k]
        n_sat, var = 0, 0.0
        for j in range(m):
            i = work.order[j]
            if rows.clock[i] == k:
                v1 = _code_innovation(rows, out, i, belief.x, c)
                work.sorted[n_sat] = v1
                var += out.code_var[i]
                n_sat += 1
        if n_sat >= 3:
            middle = median(work.sorted, n_sat)
            spread = 0.0
            for j in range(n_sat):
                work.sorted[j] = abs(work.sorted[j] - middle)
            spread = 1.5 * median(work.sorted, n_sat)
            belief.x[c] += middle
            own = 25.0 * (spread * spread + var / n_sat)
            if own < sigma * sigma:
                belief.P[c, c] += own - sigma * sigma
    return count


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


@njit
def _write(e: int, nk: int, nc: int, belief: Belief, ep: EpochOut) -> None:
    """State of epoch e into the outputs."""
    x, P = belief.x, belief.P
    for i in range(3):
        ep.pos[e, i] = x[i]
        ep.vel[e, i] = x[3 + i] if nk > 3 else 0.0
        for j in range(3):
            ep.cov_pos[e, i, j] = P[i, j]
            ep.cov_vel[e, i, j] = P[3 + i, 3 + j] if nk > 3 else 0.0
    for k in range(len(belief.at)):
        c = belief.at[k]
        if c >= 0:
            ep.clock[e, k] = x[nk + c]
            ep.clock_var[e, k] = P[nk + c, nk + c]
            ep.drift[e, k] = x[nk + nc + c]


@njit
def _count_missed(rows: Rows, m: int, t_ns: int, belief: Belief, work: Work) -> None:
    """Per clock: when a code of it was last used, and for how many epochs all were refused."""
    for k in range(len(belief.at)):
        seen, used = False, False
        for j in range(m):
            if rows.clock[work.order[j]] == k:
                seen = True
                if work.used[j] & USED_CODE:
                    used = True
        if used:
            belief.seen_ns[k] = t_ns
            belief.missed[k] = 0
        elif seen:
            belief.missed[k] += 1


@njit
def filter_run(
    model: ModelOptions, spp: SppOptions, process: Process, options: FilterOptions, epochs: Epochs, rows: Rows,
    x0: F8, P0: F8, ep: EpochOut, out: RowModel,
) -> None:  # fmt: skip
    """Filter all epochs of a run; arguments as `starwise.kernels.spp.spp_run`, and a start.

    Parameters
    ----------
    model : ModelOptions
    spp : SppOptions
        Least squares, which starts the filter.
    process : Process
    options : FilterOptions
    epochs : Epochs
    rows : Rows
    x0, P0 : (nk + 2 n_clocks,), (n, n)
        Belief at the first epoch, all clocks in the state; x0[0] NaN: start from least squares.
    ep : EpochOut
        Out: per epoch.
    out : RowModel
        Out: per row. At an epoch that (re)starts the filter, those of least squares.
    """
    n_all, nk = ep.clock.shape[1], process.nk
    m_max = 1
    for e in range(len(epochs.t_ns)):
        m_max = max(m_max, epochs.offsets[e + 1] - epochs.offsets[e])
    ints, pairs, size = np.zeros((3, m_max), np.int64), np.zeros((4, m_max, 2)), nk + 2 * n_all
    los, vectors = np.zeros((2, m_max, 3)), np.zeros((4, size))
    work = Work(
        ints[0], ints[1], ints[2], los[0], los[1], pairs[0], pairs[1], pairs[2], pairs[3],
        np.zeros(m_max, np.uint8), vectors[0], vectors[1], vectors[2], np.zeros(m_max),
    )  # fmt: skip
    belief = Belief(
        np.zeros(size), np.zeros((size, size)), np.full(n_all, -1, np.int64), np.zeros(n_all, np.int64),
        np.zeros(n_all, np.int64),
    )  # fmt: skip
    x, P, at = belief.x, belief.P, belief.at
    x2, P2 = np.zeros(size), np.zeros((size, size))
    xs, Ps, vel, Pv, numbers = (
        np.zeros(3 + n_all),
        np.zeros((3 + n_all, 3 + n_all)),
        np.zeros(4),
        np.zeros((4, 4)),
        np.zeros(3),
    )
    tie, tie_var = np.full(n_all, np.nan), np.full(n_all, np.nan)
    F, G, M = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    running, nc, failed, t_last, dt_known = False, 0, 0, 0, -1.0
    if x0[0] == x0[0]:
        running, nc, t_last = True, n_all, epochs.t_ns[0]
        for i in range(size):
            x[i] = x0[i]
            for j in range(size):
                P[i, j] = P0[i, j]
        for k in range(n_all):
            at[k] = k
            belief.seen_ns[k] = t_last
    for e in range(len(epochs.t_ns)):
        t_ns, start, end = epochs.t_ns[e], epochs.offsets[e], epochs.offsets[e + 1]
        lost = not running
        m = 0
        if running:
            dt = (t_ns - t_last) * 1e-9
            if dt != dt_known:
                motion(process.kind, dt, process.tau_s, F, G)
                dt_known = dt
            noise_shape(process, x[0], x[1], x[2], M)
            predict(x, P, nk, nc, dt, process, F, G, M)
            lost = not P[0, 0] + P[1, 1] + P[2, 2] < options.lost_sigma_m**2 or failed >= options.patience
        t_last = t_ns
        if lost:
            for k in range(n_all):
                tie[k], tie_var[k] = np.nan, np.nan
                if running and at[k] >= 0:
                    c = nk + at[k]
                    tie[k] = x[c] - x[nk]
                    tie_var[k] = P[c, c] + P[nk, nk] - 2.0 * P[c, nk]
            xs[:] = 0.0
            status = spp_epoch(model, spp, t_ns, rows, start, end, tie, tie_var, xs, Ps, vel, Pv, numbers, out)
            if status == EPOCH_OK or (status == EPOCH_SUSPECT and not running):
                # A solution that nothing checks, or that failed its test, starts the filter with that much more doubt.
                excess = numbers[2] / numbers[1] if numbers[1] > 0.0 else 4.0
                nc = start_filter(
                    options, nk, t_ns, xs, Ps, vel, Pv, max(1.0, excess) if status == EPOCH_SUSPECT else 1.0, belief
                )
                _write(e, nk, nc, belief, ep)
                dops(out, start, end, ep.dop[e])
                ep.status[e] = EPOCH_RESET if running and status == EPOCH_OK else status
                ep.n_used[e], ep.dof[e], ep.nis[e] = int(numbers[0]), int(numbers[1]), numbers[2]
                running, failed = True, 0
                continue
            if not running:
                ep.status[e] = EPOCH_NO_SOLUTION
                continue
            if failed >= options.patience:
                # Lost, and this epoch cannot be solved by itself: go on with more doubt.
                n = nk + 2 * nc
                for i in range(n):
                    for j in range(n):
                        P[i, j] *= 4.0
            if P[0, 0] + P[1, 1] + P[2, 2] > 1e12:
                running = False
                ep.status[e] = EPOCH_NO_SOLUTION
                continue
        epoch_corrections(model, t_ns, rows, start, end, x[0], x[1], x[2], True, out)
        m = _arrange(rows, out, start, end, work)
        if m > 0:
            align_clocks(options, rows, out, m, x, P, nk, nc, at, work)
            nc = activate_clocks(options, rows, out, m, t_ns, nk, nc, belief, x2, P2, work)
        nis, dof, n_used, agreed = update_epoch(options, rows, out, m, x, P, nk, nc, at, x2, P2, work)
        _count_missed(rows, m, t_ns, belief, work)
        _write(e, nk, nc, belief, ep)
        dops(out, start, end, ep.dop[e])
        ep.n_used[e], ep.dof[e], ep.nis[e] = n_used, dof, nis
        if m == 0:
            ep.status[e] = EPOCH_COASTED
        elif not agreed or nis > threshold(options.chi2, dof):
            failed += 1
            ep.status[e] = EPOCH_SUSPECT
        else:
            failed = 0
            ep.status[e] = EPOCH_OK
