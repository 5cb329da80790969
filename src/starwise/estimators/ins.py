"""Inertial navigation aided by fixes (loose coupling): readings and fixes in, trajectory, attitude and biases out."""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from starwise.chi2 import chi_square_points
from starwise.config_inertial import InertialConfig
from starwise.errors import StarwiseError
from starwise.estimators.ins_align import FixTable, Start, align
from starwise.estimators.ins_check import NIS_ALARM, lag_note, mean_nis, shifted, start_note, what_if
from starwise.estimators.ins_output import Aids, InertialRun, empty_out, empty_records, join_runs, packed
from starwise.frames import geodetic_from_ecef, rotations_ne_enu
from starwise.kernels.ins_run import (
    EVENT_BARO,
    EVENT_CONSTRAINT,
    EVENT_EPOCH,
    EVENT_NODE,
    EVENT_ODO,
    EVENT_POSITION,
    EVENT_REST,
    EVENT_VELOCITY,
    Aiding,
    Belief,
    Events,
    Options,
    Readings,
    ins_run,
    smoothed_outputs,
)
from starwise.kernels.ins_smooth import smooth
from starwise.models.inertial import REST_RATE, InertialState, Intervals, inertial_state, intervals, stretches
from starwise.types import F8, I8, Fixes, Inertial

if TYPE_CHECKING:
    from starwise.kernels.ins_tight import Seen, Sky

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
LEAST_SIGMA_M = 0.005
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


def fix_table(fixes: Fixes, t0_ns: int, end_s: float, config: InertialConfig) -> tuple[FixTable, list[str]]:
    """Fixes in the units of the filter, those outside the readings left out, and notes on what was changed.

    Raises
    ------
    StarwiseError
        No fix within the readings, or none that says how good it is.
    """
    notes: list[str] = []
    t = (fixes.t_ns - t0_ns) * 1e-9
    order = np.argsort(t, kind="stable")
    cov_pos, cov_vel = _claimed(fixes, config, notes)
    good = np.asarray(np.isfinite(fixes.pos_e).all(axis=1))
    bare = good & ~np.isfinite(cov_pos).all(axis=(1, 2))
    if bare.any() and bare.sum() == good.sum():
        raise StarwiseError(
            "fixes that claim no sigmas", file=fixes.source or None, found=f"{fixes.n} fixes",
            wanted="their sigmas, or one for all: inertial.fix_sigma_m",
        )  # fmt: skip
    if bare.any():
        notes.append(f"{int(bare.sum())} fixes claim no sigmas: not used (inertial.fix_sigma_m)")
    good &= ~bare
    inside = (t >= 0.0) & (t <= end_s)
    if not (good & inside).any():
        raise StarwiseError(
            "no fix within the inertial readings",
            file=fixes.source or None,
            found=f"{fixes.n} fixes from {t.min():.1f} to {t.max():.1f} s" if fixes.n else "no fixes",
            wanted=f"0 to {end_s:.1f} s after the first reading: time scales, offsets?",
        )
    if (good & ~inside).any():
        notes.append(f"{int((good & ~inside).sum())} fixes before or after the inertial readings: not used")
    llh = geodetic_from_ecef(np.where(good[:, None], fixes.pos_e, 1e7))
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])[:, None]
    cov = C @ cov_pos @ C.transpose(0, 2, 1)
    use = order[(good & inside)[order]]
    pos = use[np.concatenate([[True], np.diff(t[use]) > 1e-6])]
    if len(pos) < len(use):
        notes.append(f"{len(use) - len(pos)} fixes with the time of the one before: not used")
    cov_p, changed = _floored(cov[pos], LEAST_SIGMA_M)
    if changed:
        notes.append(f"{changed} fixes claim sigmas below {LEAST_SIGMA_M} m: taken as that")
    tv, vel, cov_v = np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3))
    if fixes.vel_e is not None and cov_vel is not None:
        t_vel = t - config.velocity_lag_s
        has = np.asarray(good & np.isfinite(fixes.vel_e).all(axis=1) & (t_vel >= 0.0) & (t_vel <= end_s))
        bare = has & ~np.isfinite(cov_vel).all(axis=(1, 2))
        if bare.any():
            notes.append(f"{int(bare.sum())} velocities claim no sigmas: not used (inertial.velocity_sigma_mps)")
        has &= ~bare
        k = pos[has[pos]]
        vel_n = (C[k] @ fixes.vel_e[k, :, None])[:, :, 0]
        cov_v, changed = _floored(C[k] @ cov_vel[k] @ C[k].transpose(0, 2, 1), LEAST_SIGMA_MPS)
        if changed:
            notes.append(f"{changed} velocities claim sigmas below {LEAST_SIGMA_MPS} m/s: taken as that")
        tv, vel = t_vel[k], vel_n
    return FixTable(t[pos], llh[pos], cov_p, tv, np.ascontiguousarray(vel), cov_v), notes


def _claimed(fixes: Fixes, config: InertialConfig, notes: list[str]) -> tuple[F8, F8 | None]:
    """Covariances of positions and velocities, with the configured sigma where fixes claim none or zero."""
    told: list[F8 | None] = []
    kinds = (
        ("fixes", fixes.cov_pos, config.fix_sigma_m, "m"),
        ("velocities", fixes.cov_vel, config.velocity_sigma_mps, "m/s"),
    )
    for what, cov, sigma, unit in kinds:
        if cov is None or sigma <= 0.0:
            told.append(cov)
            continue
        none = np.asarray(~(np.isfinite(cov).all(axis=(1, 2)) & (np.einsum("kii->k", cov) > 0.0)))
        if none.any():
            notes.append(f"{int(none.sum())} {what} claim no sigmas: taken as {sigma:g} {unit}")
        told.append(np.where(none[:, None, None], sigma**2 * np.eye(3), cov))
    assert told[0] is not None
    return told[0], told[1]


def _floored(cov: F8, least: float) -> tuple[F8, int]:
    """Covariances with standard deviations of at least ``least``, and how many had less."""
    diagonal = np.einsum("kii->ki", cov)
    low = (diagonal < least**2).any(axis=1)
    add = np.maximum(least**2 - diagonal, 0.0)
    return np.ascontiguousarray(cov + add[:, :, None] * np.eye(3)), int(low.sum())


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
    return join_runs(lambda part: _loose(fixes, part, config, epochs_ns, baro, odometer), stretches(inertial, config))


def _loose(
    fixes: Fixes,
    inertial: Inertial,
    config: InertialConfig,
    epochs_ns: I8 | None,
    baro: Scalars | None,
    odometer: Scalars | None,
) -> InertialRun:
    """One stretch of readings without long gaps."""
    iv = intervals(inertial, config)
    t0, end = int(iv.t_ns[0]), float(iv.read.t[-1])
    plain, notes = fix_table(fixes, t0, end, replace(config, velocity_lag_s=0.0))
    table, _ = fix_table(fixes, t0, end, config)
    state = inertial_state(config, baro=baro is not None, odometer=odometer is not None)
    extra = np.zeros(0)
    if epochs_ns is not None:
        extra = np.asarray((epochs_ns - t0) * 1e-9, dtype=np.float64)
    start = align(iv, table, state, config)
    run = run_filter(iv, table, start, state, config, extra, baro, odometer)
    told = [*iv.notes, *notes, *start_note(table.t, start.t_s), *lag_note(plain, config)]
    nis, worse = _both_nis(run, config), _worse_nis(run, config)
    if worse > NIS_ALARM:
        told.append(_contradiction(iv, table, state, config, worse))
    run.solution.provenance["notes"] = told
    run.solution.provenance["nis_per_dof"] = nis if math.isfinite(nis) else None
    return run


def _both_nis(run: InertialRun, config: InertialConfig) -> float:
    """Mean NIS per degree of freedom of positions and velocities."""
    parts = [run.fixes["nis"]] + ([run.fixes["velocity_nis"]] if config.use_velocity else [])
    return mean_nis(np.concatenate(parts))


def _worse_nis(run: InertialRun, config: InertialConfig) -> float:
    """The larger one of the mean NIS of positions and of velocities; neither can hide the other."""
    of = [run.fixes["nis"]] + ([run.fixes["velocity_nis"]] if config.use_velocity else [])
    return float(np.fmax.reduce([mean_nis(values) for values in of]))


def _contradiction(iv: Intervals, table: FixTable, state: InertialState, config: InertialConfig, nis: float) -> str:
    """What is to be said of fixes that contradict the readings; other time tags are tried."""
    end = float(iv.read.t[-1])
    plain = replace(config, smooth=False, output_rate_hz=0.0)

    def nis_of(shift_s: float) -> float:
        moved = shifted(table, shift_s, end)
        run = run_filter(iv, moved, align(iv, moved, state, plain), state, plain, np.zeros(0))
        return _worse_nis(run, plain)

    base = f"fixes and inertial readings contradict each other: NIS of positions or velocities {nis:.1f}, 1 as claimed"
    best, there = what_if(nis_of)
    if there < 0.5 * nis and abs(best) > 0.02:
        way = "earlier" if best < 0.0 else "later"
        return f"{base}; taken {abs(best):.2f} s {way} they agree ({there:.1f}): a delay that is not declared?"
    return f"{base}; no other time tags within 1.5 s explain it: sigmas, axes, lever arm?"


def _scalar_table(scalars: Scalars | None, t0_ns: int) -> tuple[F8, F8]:
    if scalars is None:
        return np.zeros(0), np.zeros((0, 2))
    return np.asarray((scalars.t_ns - t0_ns) * 1e-9, dtype=np.float64), np.stack(
        [scalars.value, scalars.variance], axis=1
    )


def _schedule(parts: list[tuple[int, F8, I8]], start_s: float, end_s: float) -> Events:
    """Events in the order of time; at equal times in the order of ``parts``: (kind, times, rows)."""
    t = np.concatenate([p[1] for p in parts])
    kind = np.concatenate([np.full(len(p[1]), p[0], dtype=np.int64) for p in parts])
    row = np.concatenate([p[2] for p in parts]).astype(np.int64)
    keep = (t > start_s + 1e-6) & (t <= end_s)
    order = np.argsort(t[keep], kind="stable")
    return Events(t[keep][order], kind[keep][order], row[keep][order])


@dataclass(frozen=True)
class SkyTable:
    """Satellite epochs for the filter: their times, s since the first reading, and what the kernel takes."""

    t: F8
    sky: "Sky"
    seen: "Seen"


def run_filter(
    iv: Intervals,
    table: FixTable,
    start: Start,
    state: InertialState,
    config: InertialConfig,
    extra_s: F8,
    baro: Scalars | None = None,
    odometer: Scalars | None = None,
    sky: SkyTable | None = None,
) -> InertialRun:
    """Filter, and smoother if asked for, from a start; epochs at the fixes and at ``extra_s`` (s since reading 0).

    With ``sky``, satellites aid in place of the fixes.
    """
    t0, end = int(iv.t_ns[0]), float(iv.read.t[-1])
    grid: F8 = np.zeros(0)
    if config.output_rate_hz > 0.0:
        step = 1.0 / config.output_rate_hz
        grid = np.asarray(np.arange(math.ceil(start.t_s / step), math.floor(end / step) + 1) * step)
    aided = table.t if sky is None else sky.t
    nodes = np.concatenate([aided, extra_s, grid])
    nodes = nodes[(nodes > start.t_s + 1e-6) & (nodes <= end)]
    # One epoch per microsecond, at the very time of the measurement if there is one: an earlier one would not have it.
    nodes = nodes[np.unique(np.rint(nodes * 1e6), return_index=True)[1]]
    car = config.vehicle
    marks = np.arange(start.t_s, end, car.interval_s)[1:] if car.constraint else np.zeros(0)
    baro_t, baro_z = _scalar_table(baro, t0)
    odo_t, odo_z = _scalar_table(odometer, t0)
    loosely = sky is None
    parts = [
        (EVENT_EPOCH, np.zeros(0) if sky is None else sky.t),
        (EVENT_POSITION, table.t if loosely else table.t[:0]),
        (EVENT_VELOCITY, table.tv if loosely and config.use_velocity else table.tv[:0]),
        (EVENT_CONSTRAINT, marks),
        (EVENT_REST, iv.rest_t if car.rest else iv.rest_t[:0]),
        (EVENT_BARO, baro_t),
        (EVENT_ODO, odo_t),
        (EVENT_NODE, nodes),
    ]
    events = _schedule([(kind, t, np.arange(len(t))) for kind, t in parts], start.t_s, end)
    aid = Aiding(table.llh, table.cov, table.vel, table.vel_cov, iv.rest_gyro, baro_z, odo_z)
    options = _options(config)
    first = int(np.searchsorted(iv.read.t, start.t_s + 1e-9)) - 1
    read, first = _from(iv, start.t_s, first)
    n = len(state.layout)
    out = empty_out(n, len(nodes), len(table.t), len(table.tv), len(marks), config.smooth)
    rows = 3 * len(events.t) + 4 + (0 if sky is None else 2 * len(sky.sky.rows.code_m))
    rec = empty_records(n, rows if config.smooth else 0)
    belief = Belief(start.nav.copy(), start.est.copy(), start.P.copy(), state.rate, state.walk)
    if sky is None:
        ins_run(read, first, events, aid, options, state.at, belief, out, rec)
    else:
        from starwise.kernels.ins_tight import tight_run

        tight_run(read, first, events, aid, sky.sky, options, state.at, belief, out, sky.seen, rec)
    if config.smooth:
        smooth(rec, n, state.at, out.nav, out.est, out.P)
        smoothed_outputs(state.at, options.arm, out)
    if sky is None:
        aids = Aids(table.t, out.pos_nis, np.full(len(table.t), 3), np.zeros(len(table.t)))
    else:
        aids = Aids(sky.t, sky.seen.nis, sky.seen.dof, sky.seen.n_used)
    return packed(iv, nodes, aids, marks, table, start, state, config, out)


def _options(config: InertialConfig) -> Options:
    """Numbers of the updates."""
    car = config.vehicle
    return Options(
        arm=np.array(config.lever_arm_m),
        gate=np.concatenate([[0.0], chi_square_points(GATE, 4)[1:]]),
        patience=PATIENCE,
        constraint_var=np.array([car.slip_sigma_mps**2, car.bounce_sigma_mps**2]),
        constraint_speed=CONSTRAINT_SPEED,
        rest_var=REST_SIGMA**2,
        rest_rate_var=REST_RATE_SIGMA**2,
        rest_rate_max=REST_RATE,
        keep=config.smooth,
    )


def _from(iv: Intervals, start_s: float, first: int) -> tuple[Readings, int]:
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
