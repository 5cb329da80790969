"""All events of an inertial run in the order of time: predict to each at the rate of the sensors, then aid.

Events fall between readings; an interval is split there, its increments in proportion. What an event does is its kind.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.ins_rows import (
    barometer_row,
    constraint_rows,
    odometer_row,
    position_rows,
    rest_rate_rows,
    rest_rows,
    velocity_rows,
)
from starwise.kernels.ins_smooth import Records, record_node, record_transition, record_update
from starwise.kernels.ins_state import At, Motion, absorb, predict, reset_transition, update
from starwise.kernels.strapdown import dcm

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

EVENT_NODE = 0
EVENT_POSITION = 1
EVENT_VELOCITY = 2
EVENT_CONSTRAINT = 3
EVENT_REST = 4
EVENT_BARO = 5
EVENT_ODO = 6
EVENT_EPOCH = 7


class Readings(NamedTuple):
    """Inertial readings as intervals."""

    t: F8  # (k + 1,) ends of the intervals, s
    dtheta: F8  # (k, 3) rad
    dv: F8  # (k, 3) m/s
    gyro_psd: F8  # (k, 3) rad^2/s
    accel_psd: F8  # (k, 3) m^2/s^3


class Events(NamedTuple):
    """What happens when, in the order of time."""

    t: F8  # (e,) s
    kind: I8  # (e,)
    row: I8  # (e,) row of the table of its kind


class Aiding(NamedTuple):
    """Measurements by kind."""

    position: F8  # (p, 3) latitude, longitude (rad), height (m) of the antenna
    position_cov: F8  # (p, 3, 3) north, east, down, m^2
    velocity: F8  # (q, 3) north, east, down, m/s
    velocity_cov: F8  # (q, 3, 3)
    rest: F8  # (s, 3) mean gyro readings of windows that look like rest, rad/s
    baro: F8  # (b, 2) height, m, and its variance
    odo: F8  # (o, 2) speed, m/s, and its variance


class Options(NamedTuple):
    """Numbers of the updates."""

    arm: F8  # (3,) antenna lever arm, body axes, m
    gate: F8  # (4,) chi-square thresholds by degrees of freedom
    patience: int  # fixes in a row outside the gate after which the filter doubts itself
    constraint_var: F8  # (2,) right, down, m^2/s^2
    constraint_speed: float  # m/s: slower, the constraint is not used
    rest_var: float  # m^2/s^2
    rest_rate_var: float  # rad^2/s^2
    rest_rate_max: float  # rad/s: mean rate beyond the bias that can be rest
    keep: bool  # records for smoothing


class Out(NamedTuple):
    """What comes out: a row per node, and per measurement."""

    nav: F8  # (k, 10)
    est: F8  # (k, n)
    P: F8  # (k, n, n), or (0, n, n) if not asked for
    var: F8  # (k, n) diagonal of P
    omega: F8  # (k, 3) angular rate, body axes, rad/s
    att_cov: F8  # (k, 3, 3) navigation axes, rad^2
    pos_cov: F8  # (k, 3, 3) of the antenna, north, east, down, m^2
    vel_cov: F8  # (k, 3, 3) m^2/s^2
    pos_v: F8  # (p, 3) innovations, m
    pos_nis: F8  # (p,)
    pos_weight: F8  # (p,) 1, or less outside the gate
    vel_v: F8  # (q, 3)
    vel_nis: F8  # (q,)
    vel_weight: F8  # (q,)
    pseudo: F8  # (4, 2) number and sum of NIS of constraint, rest, barometer, odometer
    pseudo_v: F8  # (c, 3) innovations of constraints by node of their own: right, down, speed


class Belief(NamedTuple):
    """The filter's state."""

    nav: F8  # (10,)
    est: F8  # (n,)
    P: F8  # (n, n)
    rate: F8  # (n,)
    walk: F8  # (n,)


class Space(NamedTuple):
    """Work space of the updates."""

    H: F8
    J: F8
    PH: F8
    K: F8
    S: F8
    R: F8
    v: F8
    u: F8
    x: F8


@njit
def covariances(
    nav: F8, est: F8, P: F8, n: int, at: At, C: F8, arm: F8, omega: F8, space: Space, pos: F8, vel: F8
) -> None:
    """Covariances (3, 3) of position and velocity of the antenna, north, east, down."""
    H = space.H
    for which in range(2):
        out = pos if which == 0 else vel
        if which == 0:
            position_rows(nav, est, n, at, C, arm, nav, H, space.v)
        else:
            velocity_rows(nav, est, n, at, C, arm, omega, omega, nav, H, space.v)
        for a in range(3):
            if at.tau >= 0:  # of the antenna now, not of the tag
                H[a, at.tau] = 0.0
                if which == 0:
                    H[a, 3 + a] = 0.0
            for j in range(n):
                t = 0.0
                for k in range(n):
                    h = H[a, k]
                    if h != 0.0:
                        t += h * P[k, j]
                space.PH[a, j] = t
        for a in range(3):
            for b in range(3):
                t = 0.0
                for j in range(n):
                    t += space.PH[a, j] * H[b, j]
                out[a, b] = t


@njit
def _store(belief: Belief, n: int, at: At, mo: Motion, options: Options, space: Space, out: Out, k: int) -> None:
    """Node k."""
    for j in range(10):
        out.nav[k, j] = belief.nav[j]
    for j in range(n):
        out.est[k, j] = belief.est[j]
        out.var[k, j] = belief.P[j, j]
    for j in range(3):
        out.omega[k, j] = mo.omega[j]
        for i in range(3):
            out.att_cov[k, i, j] = belief.P[i, j]
    covariances(
        belief.nav, belief.est, belief.P, n, at, mo.C, options.arm, mo.omega, space, out.pos_cov[k], out.vel_cov[k]
    )
    if options.keep:
        for i in range(n):
            for j in range(n):
                out.P[k, i, j] = belief.P[i, j]


@njit
def apply(
    belief: Belief, n: int, m: int, gate: float, mo: Motion, keep: bool, space: Space, rec: Records
) -> tuple[float, float]:
    """Update with the m rows in the work space, its record, feedback. NIS and weight."""
    if keep:
        record_transition(n, mo, rec)
        reset_transition(n, mo)
    nis, weight = update(belief.P, n, space.H, space.v, space.R, m, gate, space.x, space.PH, space.K, space.S)
    if weight > 0.0:
        if keep:
            record_update(n, m, space.H, space.K, space.S, space.v, rec)
        absorb(space.x, n, belief.nav, belief.est, mo.C)
    return nis, weight


@njit
def diagonal(R: F8, a: float, b: float, c: float) -> None:
    """Diagonal (3, 3) matrix of three variances."""
    for i in range(3):
        for j in range(3):
            R[i, j] = 0.0
    R[0, 0], R[1, 1], R[2, 2] = a, b, c


@njit
def _fix(
    kind: int, i: int, belief: Belief, n: int, at: At, mo: Motion, aid: Aiding, options: Options, failed: int,
    space: Space, out: Out, rec: Records,
) -> int:  # fmt: skip
    """Position or velocity; returns the number of positions in a row outside the gate."""
    nav, P = belief.nav, belief.P
    cov = aid.position_cov[i] if kind == EVENT_POSITION else aid.velocity_cov[i]
    for a in range(3):
        for b in range(3):
            space.R[a, b] = cov[a, b]
    if kind == EVENT_POSITION:
        position_rows(nav, belief.est, n, at, mo.C, options.arm, aid.position[i], space.H, space.v)
        for k in range(3):
            out.pos_v[i, k] = space.v[k]
        if failed >= options.patience:
            for k in range(3):
                P[6 + k, 6 + k] += space.v[k] * space.v[k]
                P[3 + k, 3 + k] += min(1.0, 0.01 * space.v[k] * space.v[k])
            failed = 0
        nis, weight = apply(belief, n, 3, options.gate[3], mo, options.keep, space, rec)
        out.pos_nis[i], out.pos_weight[i] = nis, weight
        return failed + 1 if weight < 1.0 else 0
    velocity_rows(nav, belief.est, n, at, mo.C, options.arm, mo.omega, mo.force, aid.velocity[i], space.H, space.v)
    for k in range(3):
        out.vel_v[i, k] = space.v[k]
    nis, weight = apply(belief, n, 3, options.gate[3], mo, options.keep, space, rec)
    out.vel_nis[i], out.vel_weight[i] = nis, weight
    return failed


@njit
def _pseudo(
    kind: int, i: int, belief: Belief, n: int, at: At, mo: Motion, aid: Aiding, options: Options, space: Space,
    out: Out, rec: Records,
) -> None:  # fmt: skip
    """Constraint, rest, barometer or odometer."""
    nav, est, H, v = belief.nav, belief.est, space.H, space.v
    speed2 = nav[4] ** 2 + nav[5] ** 2 + nav[6] ** 2
    if kind == EVENT_CONSTRAINT:
        speed = constraint_rows(nav, est, n, at, mo.C, mo.omega, mo.force, space.J, space.u, H, v)
        out.pseudo_v[i, 0], out.pseudo_v[i, 1], out.pseudo_v[i, 2] = v[0], v[1], speed
        if abs(speed) < options.constraint_speed:
            return
        diagonal(space.R, options.constraint_var[0], options.constraint_var[1], 0.0)
        nis, _ = apply(belief, n, 2, options.gate[2], mo, options.keep, space, rec)
    elif kind == EVENT_REST:
        for k in range(3):
            bias, var = est[9 + k], belief.P[9 + k, 9 + k]
            if at.bgc >= 0:
                bias += est[at.bgc + k]
                var += belief.P[at.bgc + k, at.bgc + k]
            if abs(aid.rest[i, k] - bias) > options.rest_rate_max + 3.0 * np.sqrt(var):
                return
        if speed2 > 9.0 * (belief.P[3, 3] + belief.P[4, 4] + belief.P[5, 5]) + 0.04:
            return
        rest_rate_rows(nav, est, n, at, mo.C, aid.rest, i, H, v)
        diagonal(space.R, options.rest_rate_var, options.rest_rate_var, options.rest_rate_var)
        apply(belief, n, 3, options.gate[3], mo, options.keep, space, rec)
        rest_rows(nav, n, H, v)
        diagonal(space.R, options.rest_var, options.rest_var, options.rest_var)
        nis, _ = apply(belief, n, 3, options.gate[3], mo, options.keep, space, rec)
    elif kind == EVENT_BARO:
        barometer_row(nav, est, n, at, aid.baro[i, 0], H, v)
        diagonal(space.R, aid.baro[i, 1], 0.0, 0.0)
        nis, _ = apply(belief, n, 1, options.gate[1], mo, options.keep, space, rec)
    else:
        odometer_row(nav, est, n, at, mo.C, mo.omega, mo.force, aid.odo[i, 0], space.J, space.u, H, v)
        diagonal(space.R, aid.odo[i, 1], 0.0, 0.0)
        nis, _ = apply(belief, n, 1, options.gate[1], mo, options.keep, space, rec)
    if nis == nis:
        out.pseudo[kind - EVENT_CONSTRAINT, 0] += 1.0
        out.pseudo[kind - EVENT_CONSTRAINT, 1] += nis


@njit
def new_motion(n: int) -> Motion:
    """Fresh memory of the prediction."""
    return Motion(
        np.zeros(7), np.zeros((3, 3)), np.zeros((9, 9)), np.zeros((9, 9)), np.zeros((9, 6)), np.zeros((9, n)),
        np.zeros((9, n)), np.zeros((9, n)), np.zeros(n), np.zeros(1), np.zeros(3), np.zeros(3),
    )  # fmt: skip


@njit
def new_space(n: int) -> Space:
    """Fresh work space."""
    return Space(
        np.zeros((3, n)), np.zeros((3, n)), np.zeros((3, n)), np.zeros((3, n)), np.zeros((3, 3)), np.zeros((3, 3)),
        np.zeros(3), np.zeros(3), np.zeros(n),
    )  # fmt: skip


@njit
def advance_to(
    t: float, i: int, now: float, read: Readings, belief: Belief, n: int, at: At, keep: bool, mo: Motion
) -> tuple[int, float]:
    """Predict from ``now``, in interval i, to time t. Returns interval and time, t or the end of the readings."""
    while i < len(read.dtheta) and t - now > 1e-6:
        end = read.t[i + 1]
        stop = end if t > end - 1e-6 else t
        part = (stop - now) / (end - read.t[i])
        predict(
            belief.nav, belief.est, belief.P, n, at, read.dtheta, read.dv, i, part, stop - now,
            read.gyro_psd, read.accel_psd, belief.rate, belief.walk, keep, mo,
        )  # fmt: skip
        now = stop
        if stop == end:
            i += 1
    return i, now


@njit
def happen(
    kind: int, k: int, belief: Belief, n: int, at: At, mo: Motion, aid: Aiding, options: Options, failed: int,
    space: Space, out: Out, rec: Records,
) -> int:  # fmt: skip
    """Node or measurement number k of a kind, satellites excepted; returns the positions in a row outside the gate."""
    if kind == EVENT_NODE:
        _store(belief, n, at, mo, options, space, out, k)
        if options.keep:
            record_transition(n, mo, rec)
            reset_transition(n, mo)
            record_node(k, rec)
    elif kind in (EVENT_POSITION, EVENT_VELOCITY):
        return _fix(kind, k, belief, n, at, mo, aid, options, failed, space, out, rec)
    else:
        _pseudo(kind, k, belief, n, at, mo, aid, options, space, out, rec)
    return failed


@njit
def ins_run(
    read: Readings, first: int, events: Events, aid: Aiding, options: Options, at: At, belief: Belief, out: Out,
    rec: Records,
) -> None:  # fmt: skip
    """Run from the end of reading ``first - 1`` (time ``read.t[first]``) over all events; belief in place.

    Parameters
    ----------
    read : Readings
    first : int
        Interval to begin with.
    events : Events
        None before ``read.t[first]``, none after the last reading.
    aid : Aiding
    options : Options
    at : At
    belief : Belief
    out : Out
    rec : Records
    """
    n = len(belief.est)
    mo, space = new_motion(n), new_space(n)
    dcm(belief.nav, mo.C)
    reset_transition(n, mo)
    i, now, failed = first, read.t[first], 0
    for e in range(len(events.t)):
        i, now = advance_to(events.t[e], i, now, read, belief, n, at, options.keep, mo)
        failed = happen(events.kind[e], events.row[e], belief, n, at, mo, aid, options, failed, space, out, rec)


@njit
def smoothed_outputs(at: At, arm: F8, out: Out) -> None:
    """Variances and antenna covariances of nodes after smoothing, from their P."""
    n = out.est.shape[1]
    space, C = new_space(n), np.zeros((3, 3))
    for k in range(len(out.nav)):
        dcm(out.nav[k], C)
        for j in range(n):
            out.var[k, j] = out.P[k, j, j]
        for i in range(3):
            for j in range(3):
                out.att_cov[k, i, j] = out.P[k, i, j]
        covariances(
            out.nav[k], out.est[k], out.P[k], n, at, C, arm, out.omega[k], space, out.pos_cov[k], out.vel_cov[k]
        )
