"""Tight coupling: pseudoranges and Doppler into the inertial filter, satellite by satellite.

The rule is that of the S3EKF: one satellite at a time, its rows evaluated at the state that the satellite before has
left, code and rate together, alone or not at all (`starwise.kernels.update.decide`). With u the unit vector to the
satellite (with the Sagnac term), g the rate's gradient, E = C_en and H_p, H_v the rows of antenna position and velocity
in the error state,

    code   -u' E H_p + clock,      rate   g' E H_p - u' E H_v + drift.

The first system's clock and drift are states; the clocks of other systems are constants against it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.constants import ROW_GATED, ROW_USED, WGS84_E2
from starwise.kernels._jit import njit
from starwise.kernels.filter_epoch import linearise
from starwise.kernels.ins_rows import position_rows, velocity_rows
from starwise.kernels.ins_run import (
    EVENT_EPOCH,
    Aiding,
    Belief,
    Events,
    Options,
    Out,
    Readings,
    Space,
    advance_to,
    apply,
    diagonal,
    happen,
    new_motion,
    new_space,
)
from starwise.kernels.ins_smooth import Records
from starwise.kernels.ins_state import At, Motion, reset_transition
from starwise.kernels.linalg import median
from starwise.kernels.rangemodel import Epochs, ModelOptions, RowModel, Rows, epoch_corrections
from starwise.kernels.strapdown import dcm, radii
from starwise.kernels.update import USED_BOTH, USED_CODE, USED_NONE, USED_RATE, decide

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

JUMP_M = 3e4  # common change of all codes that only a receiver's clock can make (0.1 ms)
CLOCK_SIGMA0_M = 100.0  # clock from the middle of the innovations
DRIFT_SIGMA0_MPS = 10.0
SYSTEM_SIGMA0_M = 300.0  # clocks of systems against each other, likewise


class Sky(NamedTuple):
    """Satellite measurements of a run."""

    epochs: Epochs
    rows: Rows
    model: ModelOptions
    gate1: float
    gate2: float


class Seen(NamedTuple):
    """Outputs of the satellite epochs."""

    row: RowModel
    n_used: I8  # (e,)
    dof: I8  # (e,)
    nis: F8  # (e,)


@njit
def antenna(nav: F8, C: F8, arm: F8, omega: F8, E: F8, x: F8) -> None:
    """ECEF position and velocity of the antenna into x (0..5), and C_en, from north-east-down, into E (3, 3)."""
    sl, cl, so, co = math.sin(nav[7]), math.cos(nav[7]), math.sin(nav[8]), math.cos(nav[8])
    E[0, 0], E[0, 1], E[0, 2] = -sl * co, -so, -cl * co
    E[1, 0], E[1, 1], E[1, 2] = -sl * so, co, -cl * so
    E[2, 0], E[2, 1], E[2, 2] = cl, 0.0, -sl
    R_M, R_N = radii(sl * sl)
    x[0], x[1] = (R_N + nav[9]) * cl * co, (R_N + nav[9]) * cl * so
    x[2] = (R_M * (1.0 - WGS84_E2 * sl * sl) + nav[9]) * sl  # R_N (1 - e^2) = R_M (1 - e^2 s^2)
    p = omega[1] * arm[2] - omega[2] * arm[1]
    q = omega[2] * arm[0] - omega[0] * arm[2]
    r = omega[0] * arm[1] - omega[1] * arm[0]
    for k in range(3):
        x[3 + k] = 0.0
    for j in range(3):
        a = C[j, 0] * arm[0] + C[j, 1] * arm[1] + C[j, 2] * arm[2]
        v = nav[4 + j] + C[j, 0] * p + C[j, 1] * q + C[j, 2] * r
        for k in range(3):
            x[k] += E[k, j] * a
            x[3 + k] += E[k, j] * v


@njit
def _isb(est: F8, at: At, c: int) -> float:
    """Clock of system c against the first, m."""
    if c > 0:
        return float(est[at.isb + c - 1])
    return 0.0


@njit
def _forget(P: F8, n: int, k: int, sigma: float) -> None:
    """Make element k uncorrelated, with a standard deviation."""
    for j in range(n):
        P[k, j] = 0.0
        P[j, k] = 0.0
    P[k, k] = sigma * sigma


@njit
def _innovations(c: int, rate: bool, sky: Sky, start: int, end: int, est: F8, at: At, x: F8, seen: Seen, v: F8) -> int:
    """Innovations of codes (or rates) of clock c (-1: of all) into v; their number."""
    m = 0
    for i in range(start, end):
        if seen.row.status[i] != ROW_USED or (c >= 0 and sky.rows.clock[i] != c):
            continue
        x[6], x[7] = est[at.clk] + _isb(est, at, sky.rows.clock[i]), est[at.clk + 1]
        v1, v2, _, _, _, _, _, _ = linearise(sky.rows, seen.row, i, x, True, 6, 7)
        v[m] = v2 if rate else v1
        if v[m] == v[m]:
            m += 1
    return m


@njit
def align_clock(sky: Sky, start: int, end: int, belief: Belief, n: int, at: At, x: F8, seen: Seen, known: I8) -> None:
    """Clock, drift and inter-system biases from the middle of the innovations, where unknown or after a jump.

    ``known`` (n_clocks + 1,) says which clocks, and last whether the drift, have been found; in place.
    """
    est, P = belief.est, belief.P
    v = np.empty(end - start)
    last = len(known) - 1
    m = _innovations(-1, False, sky, start, end, est, at, x, seen, v)
    if known[0] == 1:
        middle = median(v, m)
        if m >= 3 and abs(middle) > JUMP_M:
            est[at.clk] += middle
            _forget(P, n, at.clk, CLOCK_SIGMA0_M)
    else:
        own = _innovations(0, False, sky, start, end, est, at, x, seen, v)
        if own == 0:
            own = _innovations(-1, False, sky, start, end, est, at, x, seen, v)
        est[at.clk] += median(v, own)
        _forget(P, n, at.clk, CLOCK_SIGMA0_M)
        known[0] = 1
    for c in range(1, last):
        if known[c] == 0:
            m = _innovations(c, False, sky, start, end, est, at, x, seen, v)
            if m > 0:
                est[at.isb + c - 1] += median(v, m)
                _forget(P, n, at.isb + c - 1, SYSTEM_SIGMA0_M)
                known[c] = 1
    if known[last] == 0:
        m = _innovations(-1, True, sky, start, end, est, at, x, seen, v)
        if m > 0:
            est[at.clk + 1] += median(v, m)
        _forget(P, n, at.clk + 1, DRIFT_SIGMA0_MPS if m > 0 else 1000.0)
        known[last] = 1


@njit
def _satellite(
    i: int, sky: Sky, belief: Belief, n: int, at: At, mo: Motion, keep: bool, E: F8, Hp: F8, Hv: F8, x: F8,
    space: Space, seen: Seen, rec: Records,
) -> tuple[int, float]:  # fmt: skip
    """One satellite: rows, decision, update. What was used (``USED_*``) and its NIS."""
    out, rows, est, H, v = seen.row, sky.rows, belief.est, space.H, space.v
    isb = _isb(est, at, rows.clock[i])
    x[6], x[7] = est[at.clk] + isb, est[at.clk + 1]
    v1, v2, ux, uy, uz, gx, gy, gz = linearise(rows, out, i, x, True, 6, 7)
    u, g = np.empty(3), np.empty(3)
    for j in range(3):
        u[j] = ux * E[0, j] + uy * E[1, j] + uz * E[2, j]
        g[j] = gx * E[0, j] + gy * E[1, j] + gz * E[2, j]
    for j in range(n):
        H[0, j] = -(u[0] * Hp[0, j] + u[1] * Hp[1, j] + u[2] * Hp[2, j])
        H[1, j] = g[0] * Hp[0, j] + g[1] * Hp[1, j] + g[2] * Hp[2, j]
        H[1, j] -= u[0] * Hv[0, j] + u[1] * Hv[1, j] + u[2] * Hv[2, j]
    H[0, at.clk] = 1.0
    H[1, at.clk + 1] = 1.0
    if rows.clock[i] > 0:
        H[0, at.isb + rows.clock[i] - 1] = 1.0
    s11, s21, s22 = out.code_var[i], 0.0, out.rate_var[i]
    for k in range(n):
        h, w = H[0, k], H[1, k]
        if h != 0.0 or w != 0.0:
            a, b = 0.0, 0.0
            for j in range(n):
                a += belief.P[k, j] * H[0, j]
                b += belief.P[k, j] * H[1, j]
            s11 += h * a
            s21 += w * a
            s22 += w * b
    paired = v2 == v2
    used = decide(v1, v2, s11, s21, s22, paired, sky.gate1, sky.gate2)
    out.v_code[i], out.s_code[i] = v1, s11
    out.v_rate[i], out.s_rate[i] = v2, s22 if paired else np.nan
    out.rate_used[i] = 1 if used in (USED_RATE, USED_BOTH) else 0
    if used not in (USED_CODE, USED_BOTH):
        out.status[i] = ROW_GATED
    if used == USED_NONE:
        return used, 0.0
    v[0], v[1] = v1, v2
    if used == USED_RATE:
        v[0] = v2
        for j in range(n):
            H[0, j] = H[1, j]
        diagonal(space.R, out.rate_var[i], 0.0, 0.0)
    else:
        diagonal(space.R, out.code_var[i], out.rate_var[i], 0.0)
    nis, _ = apply(belief, n, 2 if used == USED_BOTH else 1, np.inf, mo, keep, space, rec)
    return used, nis


@njit
def satellite_epoch(
    e: int, sky: Sky, belief: Belief, n: int, at: At, mo: Motion, options: Options, lost: int, known: I8,
    space: Space, seen: Seen, rec: Records,
) -> int:  # fmt: skip
    """All satellites of epoch e, the best first; returns the number of epochs in a row that mostly disagreed."""
    start, end, out = sky.epochs.offsets[e], sky.epochs.offsets[e + 1], seen.row
    x, E, arm = np.empty(8), np.empty((3, 3)), np.empty(3)
    Hp, Hv, order = np.empty((3, n)), np.empty((3, n)), np.empty(end - start, np.int64)
    for k in range(3):
        arm[k] = belief.est[at.arm + k] if at.arm >= 0 else options.arm[k]
    antenna(belief.nav, mo.C, arm, mo.omega, E, x)
    epoch_corrections(sky.model, sky.epochs.t_ns[e], sky.rows, start, end, x[0], x[1], x[2], True, out)
    m = 0
    for i in range(start, end):
        out.rate_used[i] = 0
        if out.status[i] == ROW_USED:
            j = m - 1
            while j >= 0 and out.code_var[order[j]] > out.code_var[i]:
                order[j + 1] = order[j]
                j -= 1
            order[j + 1] = i
            m += 1
    if m == 0:
        return lost
    align_clock(sky, start, end, belief, n, at, x, seen, known)
    if lost >= 3:
        # most satellites have disagreed for some epochs: the filter doubts itself, not them
        for k in range(3):
            belief.P[3 + k, 3 + k] += 1.0
            belief.P[6 + k, 6 + k] += 2500.0
        belief.P[at.clk, at.clk] += 2500.0
        lost = 0
    codes = 0
    for k in range(m):
        position_rows(belief.nav, belief.est, n, at, mo.C, options.arm, belief.nav, Hp, space.v)
        velocity_rows(belief.nav, belief.est, n, at, mo.C, options.arm, mo.omega, mo.force, belief.nav, Hv, space.v)
        antenna(belief.nav, mo.C, arm, mo.omega, E, x)
        used, nis = _satellite(order[k], sky, belief, n, at, mo, options.keep, E, Hp, Hv, x, space, seen, rec)
        if used != USED_NONE:
            seen.nis[e] = nis if seen.nis[e] != seen.nis[e] else seen.nis[e] + nis
            seen.dof[e] += 2 if used == USED_BOTH else 1
            seen.n_used[e] += 1
        codes += 1 if used in (USED_CODE, USED_BOTH) else 0
    return lost + 1 if m >= 4 and 2 * codes < m else 0


@njit
def tight_run(
    read: Readings, first: int, events: Events, aid: Aiding, sky: Sky, options: Options, at: At, belief: Belief,
    out: Out, seen: Seen, rec: Records,
) -> None:  # fmt: skip
    """All events, satellite epochs among them; otherwise as `starwise.kernels.ins_run.ins_run`."""
    n = len(belief.est)
    mo, space = new_motion(n), new_space(n)
    dcm(belief.nav, mo.C)
    reset_transition(n, mo)
    i, now, failed, lost = first, read.t[first], 0, 0
    known = np.zeros(2 + (n - at.isb if at.isb >= 0 else 0), np.int64)
    for e in range(len(events.t)):
        i, now = advance_to(events.t[e], i, now, read, belief, n, at, options.keep, mo)
        kind, k = events.kind[e], events.row[e]
        if kind == EVENT_EPOCH:
            lost = satellite_epoch(k, sky, belief, n, at, mo, options, lost, known, space, seen, rec)
        else:
            failed = happen(kind, k, belief, n, at, mo, aid, options, failed, space, out, rec)
