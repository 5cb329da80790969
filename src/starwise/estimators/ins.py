"""Inertial navigation aided by fixes (loose coupling): readings and fixes in, trajectory, attitude and biases out."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.chi2 import chi_square_points
from starwise.config_inertial import InertialConfig
from starwise.constants import EPOCH_COASTED, EPOCH_OK, EPOCH_RESET, NS
from starwise.errors import StarwiseError
from starwise.estimators.ins_align import FixTable, Start, align, roll_pitch_yaw
from starwise.frames import ecef_from_geodetic, geodetic_from_ecef, rotations_ne_enu
from starwise.kernels.ins_run import (
    EVENT_BARO,
    EVENT_CONSTRAINT,
    EVENT_NODE,
    EVENT_ODO,
    EVENT_POSITION,
    EVENT_REST,
    EVENT_VELOCITY,
    Aiding,
    Belief,
    Events,
    Options,
    Out,
    ins_run,
    smoothed_outputs,
)
from starwise.kernels.ins_smooth import Records, smooth
from starwise.models.inertial import InertialState, Intervals, inertial_state, intervals
from starwise.types import F8, I8, Fixes, Inertial, Layout, Solution

GATE = 1e-4
"""Chance that an aiding measurement whose errors are as modelled loses weight."""
PATIENCE = 12
"""Fixes in a row outside the gate after which the filter doubts itself: 3 s at 4 Hz."""
REST_SIGMA = 0.04
"""Velocity of a body at rest on its springs, m/s."""
REST_RATE_SIGMA = math.radians(0.1)
"""Its mean rate over half a second, vibration folded down included, rad/s."""
CONSTRAINT_SPEED = 1.5
"""Slower than this the constraint says less than it costs, m/s."""
LEAST_SIGMA_M = 0.01
"""Fixes that claim less are taken as this good, m."""
LEAST_SIGMA_MPS = 0.02
"""The same for velocities, m/s."""


@dataclass(frozen=True)
class Scalars:
    """A scalar sensor: barometric heights (m) or speeds of an odometer (m/s, forward positive), with variances.

    Attributes
    ----------
    t_ns : (n,) int64
    value, variance : (n,) float64
    """

    t_ns: I8
    value: F8
    variance: F8


@dataclass(frozen=True)
class InertialRun:
    """What an inertial filter says at its epochs.

    Attributes
    ----------
    solution : Solution
        Of the antenna; ``extra`` holds attitude, biases and what else was estimated, with sigmas.
    nav : (n, 10) float64
        Of the sensor: quaternion, velocity (north, east, down), latitude, longitude, height.
    est, sigma : (n, m) float64
        Estimates (first nine: 0) and their standard deviations, by ``layout``.
    layout : Layout
    pos_cov, vel_cov : (n, 3, 3) float64
        Of the antenna, north, east, down.
    fixes : dict of arrays
        Per position: ``t_ns``, ``innovation_m`` (north, east, down), ``nis``, ``weight`` (below 1: outside the gate);
        ``velocity_t_ns`` ... likewise per velocity.
    constraints : dict
        Number and mean NIS of constraint, rest, barometer, odometer; ``innovations`` (k, 4): time (s), right, down, speed.
    start_ns : int
    """

    solution: Solution
    nav: F8
    est: F8
    sigma: F8
    layout: Layout
    pos_cov: F8
    vel_cov: F8
    fixes: dict[str, NDArray[Any]] = field(default_factory=dict)
    constraints: dict[str, Any] = field(default_factory=dict)
    start_ns: int = 0


def fix_table(fixes: Fixes, t0_ns: int, end_s: float, config: InertialConfig) -> tuple[FixTable, list[str]]:
    """Fixes in the units of the filter, those outside the readings left out, and notes on what was changed.

    Raises
    ------
    StarwiseError
        No fix within the readings.
    """
    notes = []
    t = (fixes.t_ns - t0_ns) * 1e-9
    order = np.argsort(t, kind="stable")
    good = np.isfinite(fixes.pos_e).all(axis=1)
    inside = (t >= 0.0) & (t <= end_s)
    if not (good & inside).any():
        raise StarwiseError(
            "no fix within the inertial readings",
            found=f"{fixes.n} fixes from {t.min():.1f} to {t.max():.1f} s" if fixes.n else "no fixes",
            wanted=f"0 to {end_s:.1f} s after the first reading: time scales, offsets?",
        )
    if (good & ~inside).any():
        notes.append(f"{int((good & ~inside).sum())} fixes before or after the inertial readings: not used")
    llh = geodetic_from_ecef(np.where(good[:, None], fixes.pos_e, 1e7))
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])[:, None]
    cov = C @ fixes.cov_pos @ C.transpose(0, 2, 1)
    use = order[(good & inside)[order]]
    pos = use[np.concatenate([[True], np.diff(t[use]) > 1e-6])]
    if len(pos) < len(use):
        notes.append(f"{len(use) - len(pos)} fixes with the time of the one before: not used")
    cov_p, changed = _floored(cov[pos], LEAST_SIGMA_M)
    if changed:
        notes.append(f"{changed} fixes claim sigmas below {LEAST_SIGMA_M} m or none: taken as that")
    tv, vel, cov_v = np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3))
    if fixes.vel_e is not None and fixes.cov_vel is not None:
        t_vel = t - config.velocity_lag_s
        has = good & np.isfinite(fixes.vel_e).all(axis=1) & (t_vel >= 0.0) & (t_vel <= end_s)
        k = pos[has[pos]]
        vel_n = (C[k] @ fixes.vel_e[k, :, None])[:, :, 0]
        cov_v, changed = _floored(C[k] @ fixes.cov_vel[k] @ C[k].transpose(0, 2, 1), LEAST_SIGMA_MPS)
        if changed:
            notes.append(f"{changed} velocities claim sigmas below {LEAST_SIGMA_MPS} m/s or none: taken as that")
        tv, vel = t_vel[k], vel_n
    return FixTable(t[pos], llh[pos], cov_p, tv, np.ascontiguousarray(vel), cov_v), notes


def _floored(cov: F8, least: float) -> tuple[F8, int]:
    """Covariances with standard deviations of at least ``least``; what is not finite becomes that."""
    bad = ~np.isfinite(cov).all(axis=(1, 2))
    cov = np.where(bad[:, None, None], 0.0, cov)
    diagonal = np.einsum("kii->ki", cov)
    low = (diagonal < least**2).any(axis=1)
    add = np.maximum(least**2 - diagonal, 0.0)
    return np.ascontiguousarray(cov + add[:, :, None] * np.eye(3)), int((low | bad).sum())


def loose(
    fixes: Fixes,
    inertial: Inertial,
    config: InertialConfig,
    *,
    epochs_ns: I8 | None = None,
    baro: Scalars | None = None,
    odometer: Scalars | None = None,
) -> InertialRun:
    """Inertial navigation aided by positions and velocities, each at the time that it is valid for.

    Parameters
    ----------
    fixes : Fixes
        Of the antenna. Taken in the order of their validity: what an in-order filter would do.
    inertial : Inertial
    config : InertialConfig
    epochs_ns : (k,) int64, optional
        Epochs of the output beside those of the fixes, GPST ns.
    baro, odometer : Scalars, optional

    Raises
    ------
    StarwiseError
        Readings or fixes that cannot be used, or nothing to align with.
    """
    iv = intervals(inertial, config)
    t0, end = int(iv.t_ns[0]), float(iv.read.t[-1])
    table, notes = fix_table(fixes, t0, end, config)
    state = inertial_state(config, baro=baro is not None, odometer=odometer is not None)
    start = align(iv, table, state, config)
    extra = np.zeros(0) if epochs_ns is None else (np.asarray(epochs_ns) - t0) * 1e-9
    run = run_filter(iv, table, start, state, config, extra, baro, odometer)
    run.solution.provenance["notes"] = [*iv.notes, *notes]
    return run


def _scalar_table(scalars: Scalars | None, t0_ns: int) -> tuple[F8, F8]:
    if scalars is None:
        return np.zeros(0), np.zeros((0, 2))
    return (scalars.t_ns - t0_ns) * 1e-9, np.stack([scalars.value, scalars.variance], axis=1)


def _schedule(parts: list[tuple[int, F8, I8]], start_s: float, end_s: float) -> Events:
    """Events in the order of time; at equal times in the order of ``parts``: (kind, times, rows)."""
    t = np.concatenate([p[1] for p in parts])
    kind = np.concatenate([np.full(len(p[1]), p[0], dtype=np.int64) for p in parts])
    row = np.concatenate([p[2] for p in parts]).astype(np.int64)
    keep = (t > start_s + 1e-6) & (t <= end_s)
    order = np.argsort(t[keep], kind="stable")
    return Events(t[keep][order], kind[keep][order], row[keep][order])


def run_filter(
    iv: Intervals,
    table: FixTable,
    start: Start,
    state: InertialState,
    config: InertialConfig,
    extra_s: F8,
    baro: Scalars | None = None,
    odometer: Scalars | None = None,
) -> InertialRun:
    """Filter, and smoother if asked for, from a start; epochs at the fixes and at ``extra_s`` (s since reading 0)."""
    car, t0, end = config.vehicle, int(iv.t_ns[0]), float(iv.read.t[-1])
    grid = np.zeros(0)
    if config.output_rate_hz > 0.0:
        step = 1.0 / config.output_rate_hz
        grid = np.arange(math.ceil(start.t_s / step), math.floor(end / step) + 1) * step
    nodes = np.concatenate([table.t, extra_s, grid])
    nodes = np.unique(np.rint(nodes[(nodes > start.t_s + 1e-6) & (nodes <= end)] * 1e6)) * 1e-6
    marks = np.arange(start.t_s, end, car.interval_s)[1:] if car.constraint else np.zeros(0)
    baro_t, baro_z = _scalar_table(baro, t0)
    odo_t, odo_z = _scalar_table(odometer, t0)
    parts = [
        (EVENT_POSITION, table.t, np.arange(len(table.t))),
        (EVENT_VELOCITY, table.tv if config.use_velocity else table.tv[:0], np.arange(len(table.tv))),
        (EVENT_CONSTRAINT, marks, np.arange(len(marks))),
        (EVENT_REST, iv.rest_t if car.rest else iv.rest_t[:0], np.arange(len(iv.rest_t))),
        (EVENT_BARO, baro_t, np.arange(len(baro_t))),
        (EVENT_ODO, odo_t, np.arange(len(odo_t))),
        (EVENT_NODE, nodes, np.arange(len(nodes))),
    ]
    parts = [(kind, t, rows[: len(t)]) for kind, t, rows in parts]
    events = _schedule(parts, start.t_s, end)
    aid = Aiding(table.llh, table.cov, table.vel, table.vel_cov, iv.rest_gyro, baro_z, odo_z)
    options = Options(
        arm=np.array(config.lever_arm_m),
        gate=chi_square_points(GATE, 4),
        patience=PATIENCE,
        constraint_var=np.array([car.slip_sigma_mps**2, car.bounce_sigma_mps**2]),
        constraint_speed=CONSTRAINT_SPEED,
        rest_var=REST_SIGMA**2,
        rest_rate_var=REST_RATE_SIGMA**2,
        rest_rate_max=0.01,
        keep=config.smooth,
    )
    first = int(np.searchsorted(iv.read.t, start.t_s + 1e-9)) - 1
    read, first = _from(iv, start.t_s, first)
    n, k = len(state.layout), len(nodes)
    out = _empty_out(n, k, len(table.t), len(table.tv), len(marks), config.smooth)
    rec = _empty_records(n, 3 * len(events.t) + 4 if config.smooth else 0)
    belief = Belief(start.nav.copy(), start.est.copy(), start.P.copy(), state.rate, state.walk)
    ins_run(read, first, events, aid, options, state.at, belief, out, rec)
    if config.smooth:
        smooth(rec, n, state.at, out.nav, out.est, out.P)
        smoothed_outputs(state.at, options.arm, out)
    used = np.isin(np.rint(nodes * 1e6).astype(np.int64), np.rint(table.t * 1e6).astype(np.int64))
    return _packed(iv, nodes, used, marks, table, start, state, config, out)


def _from(iv: Intervals, start_s: float, first: int) -> tuple[Any, int]:
    """Readings with the first interval cut at the start."""
    t = iv.read.t
    if start_s - t[first] < 1e-6:
        return iv.read, first
    part = (t[first + 1] - start_s) / (t[first + 1] - t[first])
    t, dtheta, dv = t.copy(), iv.read.dtheta.copy(), iv.read.dv.copy()
    t[first] = start_s
    dtheta[first] *= part
    dv[first] *= part
    return iv.read._replace(t=t, dtheta=dtheta, dv=dv), first


def _empty_out(n: int, k: int, p: int, q: int, c: int, keep: bool) -> Out:
    nan = np.nan
    return Out(
        nav=np.full((k, 10), nan), est=np.full((k, n), nan), P=np.zeros((k if keep else 0, n, n)),
        var=np.full((k, n), nan), omega=np.zeros((k, 3)), att_cov=np.full((k, 3, 3), nan),
        pos_cov=np.full((k, 3, 3), nan), vel_cov=np.full((k, 3, 3), nan),
        pos_v=np.full((p, 3), nan), pos_nis=np.full(p, nan), pos_weight=np.full(p, nan),
        vel_v=np.full((q, 3), nan), vel_nis=np.full(q, nan), vel_weight=np.full(q, nan),
        pseudo=np.zeros((4, 2)), pseudo_v=np.full((c, 3), nan),
    )  # fmt: skip


def _empty_records(n: int, k: int) -> Records:
    return Records(np.zeros(k, np.int64), np.zeros(k, np.int64), np.zeros((k, 10 * n + 12)), np.zeros(1, np.int64))


def quaternions_to_dcm(q: F8) -> F8:
    """Rotations C_nb (n, 3, 3) of quaternions (n, 4), scalar first."""
    a, b, c, d = q.T
    C = np.empty((len(q), 3, 3))
    C[:, 0, 0], C[:, 1, 1] = a * a + b * b - c * c - d * d, a * a - b * b + c * c - d * d
    C[:, 2, 2] = a * a - b * b - c * c + d * d
    C[:, 0, 1], C[:, 1, 0] = 2.0 * (b * c - a * d), 2.0 * (b * c + a * d)
    C[:, 0, 2], C[:, 2, 0] = 2.0 * (b * d + a * c), 2.0 * (b * d - a * c)
    C[:, 1, 2], C[:, 2, 1] = 2.0 * (c * d - a * b), 2.0 * (c * d + a * b)
    return C


def _packed(
    iv: Intervals, nodes: F8, used: NDArray[np.bool_], marks: F8, table: FixTable, start: Start,
    state: InertialState, config: InertialConfig, out: Out,
) -> InertialRun:  # fmt: skip
    """Outputs of the kernel as nouns."""
    t0, at = int(iv.t_ns[0]), state.at
    C = quaternions_to_dcm(out.nav[:, :4])
    arm = out.est[:, at.arm : at.arm + 3] if at.arm >= 0 else np.broadcast_to(config.lever_arm_m, (len(nodes), 3))
    llh = out.nav[:, 7:10]
    C_en = rotations_ne_enu(llh[:, 0], llh[:, 1])[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])[:, None]
    C_ne = C_en.transpose(0, 2, 1)
    arm_n = (C @ arm[:, :, None])[:, :, 0]
    vel_n = out.nav[:, 4:7] + (C @ np.cross(out.omega, arm)[:, :, None])[:, :, 0]
    k = len(nodes)
    status = np.where(used, EPOCH_OK, EPOCH_COASTED).astype(np.uint8)
    if k:
        status[0] = EPOCH_RESET if used[0] else status[0]
    nis, dof = np.full(k, np.nan), np.zeros(k, dtype=np.int32)
    where = np.searchsorted(np.rint(table.t * 1e6), np.rint(nodes[used] * 1e6))
    nis[used] = out.pos_nis[where]
    dof[used] = 3
    solution = Solution(
        t_ns=t0 + np.rint(nodes * NS).astype(np.int64),
        status=status,
        pos_e=ecef_from_geodetic(llh) + (C_ne @ arm_n[:, :, None])[:, :, 0],
        vel_e=(C_ne @ vel_n[:, :, None])[:, :, 0],
        cov_pos=C_ne @ out.pos_cov @ C_en,
        cov_vel=C_ne @ out.vel_cov @ C_en,
        clock_m=np.empty((k, 0)), drift_mps=np.empty((k, 0)), clock_sigma_m=np.empty((k, 0)), clock_names=(),
        n_used=np.zeros(k, dtype=np.int32),
        dop=np.full((k, 4), np.nan),
        nis=nis,
        dof=dof,
        extra=_extra(C, out, state),
    )  # fmt: skip
    kinds = ("constraint", "rest", "barometer", "odometer")
    constraints: dict[str, Any] = {
        name: {"count": int(out.pseudo[i, 0]), "mean_nis": float(out.pseudo[i, 1] / max(out.pseudo[i, 0], 1.0))}
        for i, name in enumerate(kinds)
    }
    constraints["innovations"] = np.column_stack([marks, out.pseudo_v])
    return InertialRun(
        solution, out.nav, out.est, np.sqrt(np.maximum(out.var, 0.0)), state.layout, out.pos_cov, out.vel_cov,
        fixes={
            "t_ns": t0 + np.rint(table.t * NS).astype(np.int64), "innovation_m": out.pos_v, "nis": out.pos_nis,
            "weight": out.pos_weight, "velocity_t_ns": t0 + np.rint(table.tv * NS).astype(np.int64),
            "velocity_innovation_mps": out.vel_v, "velocity_nis": out.vel_nis, "velocity_weight": out.vel_weight,
        },
        constraints=constraints,
        start_ns=t0 + round(start.t_s * NS),
    )  # fmt: skip


_UNITS: dict[str, tuple[str, float]] = {
    "bg": ("gyro_bias_{}_dph", math.degrees(3600.0)), "bgc": ("gyro_constant_{}_dph", math.degrees(3600.0)),
    "ba": ("accel_bias_{}_mps2", 1.0), "bac": ("accel_constant_{}_mps2", 1.0),
    "sg": ("gyro_scale_{}_ppm", 1e6), "sa": ("accel_scale_{}_ppm", 1e6),
    "mount": ("mount_{}_deg", math.degrees(1.0)), "axle": ("axle_{}_m", 1.0), "steer": ("steer_{}", 1.0),
    "arm": ("lever_arm_{}_m", 1.0), "tau": ("time_offset_s", 1.0), "baro": ("baro_error_m", 1.0),
    "odo": ("odometer_scale", 1.0),
}  # fmt: skip


def _extra(C: F8, out: Out, state: InertialState) -> dict[str, F8]:
    """Columns beside position and velocity: attitude and every other estimate, each with its sigma."""
    rpy = roll_pitch_yaw(C)
    columns: dict[str, F8] = {}
    cos, sin = np.cos(rpy[:, 2]), np.sin(rpy[:, 2])
    cov = out.att_cov
    ahead = cov[:, 0, 0] * cos**2 + 2.0 * cov[:, 0, 1] * cos * sin + cov[:, 1, 1] * sin**2
    across = cov[:, 0, 0] * sin**2 - 2.0 * cov[:, 0, 1] * cos * sin + cov[:, 1, 1] * cos**2
    for i, (name, var) in enumerate((("roll", ahead), ("pitch", across), ("yaw", cov[:, 2, 2]))):
        columns[f"{name}_deg"] = np.degrees(rpy[:, i])
        columns[f"sigma_{name}_deg"] = np.degrees(np.sqrt(np.maximum(var, 0.0)))
    for j, full in enumerate(state.layout.names):
        if j < 9:
            continue
        part, _, member = full.partition(".")
        pattern, scale = _UNITS[part]
        name = pattern.format(member)
        columns[name] = scale * out.est[:, j]
        columns[f"sigma_{name}"] = scale * np.sqrt(np.maximum(out.var[:, j], 0.0))
    return columns
