"""Inertial readings made into what the filter takes: intervals, noise, rest; and its state out of a configuration."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from starwise.config_inertial import InertialConfig
from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.kernels.ins_run import Readings
from starwise.kernels.ins_state import At
from starwise.models.process import Clocks
from starwise.physics.earth import STANDARD_GRAVITY
from starwise.types import F8, I8, Inertial, Layout

DPH = math.pi / 180.0 / 3600.0
"""1 deg/h in rad/s."""
UG = 1e-6 * STANDARD_GRAVITY
"""1 micro-g in m/s^2."""

WINDOW_S = 0.5
"""Window of the vibration and of the detector of rest, s, ending at the reading: nothing is taken from the future."""
REST_ACCEL_SD = 0.2
"""Scatter of the specific force at rest with a running engine, m/s^2, at most."""
REST_YAW_SD = 0.02
"""Scatter of the rate about the vertical at rest, rad/s, at most."""
REST_RATE = 0.01
"""Mean rate at rest beyond the bias, rad/s, at most (a slow turn)."""
SHORTEST_S = 10.0
"""Stretches of readings shorter than this between two long gaps are left out, s."""
GAP_RATE_SD = 0.2
"""What may have happened in a gap: angular rate, rad/s ..."""
GAP_ACCEL_SD = 2.0
"""... and acceleration, m/s^2, as white noise over 1 s."""


@dataclass(frozen=True)
class Intervals:
    """Inertial readings as consecutive intervals without holes.

    Attributes
    ----------
    t_ns : (n + 1,) int64
        Ends of the intervals, GPST ns.
    read : Readings
        Increments and noise; its ``t`` is in seconds since ``t_ns[0]``.
    bridged : (n,) bool
        Made up where readings are missing.
    rest_t : (k,) float64
        Ends of windows that look like rest, s since ``t_ns[0]``.
    rest_gyro, rest_accel : (k, 3) float64
        Their mean readings, rad/s and m/s^2.
    notes : tuple of str
    """

    t_ns: I8
    read: Readings
    bridged: NDArray[np.bool_]
    rest_t: F8
    rest_gyro: F8
    rest_accel: F8
    notes: tuple[str, ...]


def increments(inertial: Inertial) -> tuple[I8, F8, F8, F8]:
    """Ends of intervals (n + 1,), their lengths (n,), angle and velocity increments (n, 3), gaps left as they are.

    Rates become increments by the trapezoidal rule; the terms of second order are those of the mechanisation. A length
    shorter than the step of the ends is a gap before the reading.
    """
    t, dt = inertial.t_ns, inertial.dt_s
    if inertial.increments:
        ends = np.concatenate([[t[0] - round(float(dt[0]) * NS)], t])
        return ends, dt, inertial.gyro, inertial.accel
    step = np.diff(t) * 1e-9
    short = np.minimum(step, dt[1:])
    whole = (short > 0.999 * step)[:, None]
    # after a gap there is no reading to go from
    gyro = np.where(whole, 0.5 * (inertial.gyro[1:] + inertial.gyro[:-1]), inertial.gyro[1:]) * short[:, None]
    accel = np.where(whole, 0.5 * (inertial.accel[1:] + inertial.accel[:-1]), inertial.accel[1:]) * short[:, None]
    return t, short, gyro, accel


def stretches(inertial: Inertial, config: InertialConfig) -> list[Inertial]:
    """Readings cut at gaps longer than ``config.max_gap_s``: attitude is lost there, a filter has to begin again."""
    t = inertial.t_ns
    gap = np.flatnonzero(np.diff(t) * 1e-9 - inertial.dt_s[1:] > config.max_gap_s)
    edges = [0, *(gap + 1).tolist(), len(t)]
    return [
        Inertial(t[a:b], inertial.dt_s[a:b], inertial.gyro[a:b], inertial.accel[a:b], inertial.increments)
        for a, b in itertools.pairwise(edges)
        if len(edges) == 2 or (b - a > 2 and (t[b - 1] - t[a]) > SHORTEST_S * NS)
    ] or [inertial]


def intervals(inertial: Inertial, config: InertialConfig) -> Intervals:
    """Readings without holes, with the noise of every interval and the windows of rest.

    Raises
    ------
    StarwiseError
        Fewer than two seconds of readings; not numbers; times that do not increase; no gravity in the readings.
    """
    _check(inertial)
    ends, dt, dtheta, dv = increments(inertial)
    period = float(np.median(dt))
    bridged = np.zeros(len(dt), dtype=bool)
    notes: list[str] = []
    missing = np.diff(ends) * 1e-9 - dt
    gaps = np.flatnonzero(missing > 0.5 * period)
    if len(gaps):
        ends, dt, dtheta, dv, bridged = _bridge(ends, dt, dtheta, dv, gaps, period)
        notes.append(
            f"{len(gaps)} gaps of the inertial readings, {missing[gaps].sum():.2f} s in all, the longest "
            f"{missing[gaps].max():.2f} s: bridged with the rates around them, their noise widened"
        )
    dt = np.diff(ends) * 1e-9
    gyro, accel = dtheta / dt[:, None], dv / dt[:, None]
    scatter_g, scatter_a = _scatter(gyro, period), _scatter(accel, period)
    g, a = config.gyro, config.accel
    base_g, base_a = math.radians(g.white_dprh) / 60.0, a.white_mpsrh / 60.0
    gyro_psd = base_g**2 + (g.vibration * scatter_g) ** 2 * period
    accel_psd = base_a**2 + (a.vibration * scatter_a) ** 2 * period
    gyro_psd[bridged] += GAP_RATE_SD**2
    accel_psd[bridged] += GAP_ACCEL_SD**2
    t = (ends - ends[0]) * 1e-9
    read = Readings(
        t, np.ascontiguousarray(dtheta), np.ascontiguousarray(dv),
        np.ascontiguousarray(gyro_psd), np.ascontiguousarray(accel_psd),
    )  # fmt: skip
    at, rest_gyro, rest_accel = _rest(t, gyro, accel, bridged, period, config.vehicle.interval_s)
    return Intervals(ends, read, bridged, at, rest_gyro, rest_accel, tuple(notes))


def _check(inertial: Inertial) -> None:
    t = inertial.t_ns
    if len(t) < 3 or (t[-1] - t[0]) < 2 * NS:
        raise StarwiseError("too few inertial readings", found=f"{len(t)}", wanted="two seconds of them")
    back = np.flatnonzero(np.diff(t) <= 0)
    if len(back):
        raise StarwiseError("times of inertial readings do not increase", found=f"reading {back[0] + 2}")
    for name, values in (("gyro", inertial.gyro), ("accelerometer", inertial.accel)):
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(bad):
            raise StarwiseError(
                f"{name} readings are not numbers",
                found=f"{len(bad)}, the first at reading {bad[0] + 1}",
                wanted="leave such readings out: gaps are bridged",
            )
    force = inertial.accel / inertial.dt_s[:, None] if inertial.increments else inertial.accel
    mean = np.median(force, axis=0)
    if not 8.0 < float(np.linalg.norm(mean)) < 12.0:
        raise StarwiseError(
            "the specific force is not that of gravity",
            found=f"median {np.linalg.norm(mean):.3f} m/s^2",
            wanted="about 9.8: units of the accelerometers?",
        )
    if mean[2] > -4.0:
        raise StarwiseError(
            "the third axis does not point down",
            found=f"median specific force {mean[0]:.1f} {mean[1]:.1f} {mean[2]:.1f} m/s^2",
            wanted="forward, right, down: about 0 0 -9.8",
        )


def _bridge(
    ends: I8, dt: F8, dtheta: F8, dv: F8, gaps: NDArray[np.intp], period: float
) -> tuple[I8, F8, F8, F8, NDArray[np.bool_]]:
    """Intervals of the usual length where readings are missing, with rates between those on either side."""
    t_parts, d_parts, v_parts, made = [], [], [], []
    at = 0
    for k in gaps:
        t_parts.append(ends[at + 1 : k + 1] if at else ends[: k + 1])
        d_parts.append(dtheta[at:k])
        v_parts.append(dv[at:k])
        made.append(np.zeros(k - at, dtype=bool))
        start, stop = int(ends[k]), int(ends[k + 1]) - round(float(dt[k]) * NS)
        n = max(1, round((stop - start) * 1e-9 / period))
        edges = start + np.rint(np.arange(1, n + 1) * ((stop - start) / n)).astype(np.int64)
        part = ((np.arange(n) + 0.5) / n)[:, None]
        width = (stop - start) * 1e-9 / n
        for values, out in ((dtheta, d_parts), (dv, v_parts)):
            after = values[k] / dt[k]
            before = values[k - 1] / dt[k - 1] if k else after
            out.append((before + part * (after - before)) * width)
        t_parts.append(edges)
        made.append(np.ones(n, dtype=bool))
        at = k
    t_parts.append(ends[at + 1 :])
    d_parts.append(dtheta[at:])
    v_parts.append(dv[at:])
    made.append(np.zeros(len(dtheta) - at, dtype=bool))
    ends = np.concatenate(t_parts)
    return ends, np.diff(ends) * 1e-9, np.concatenate(d_parts), np.concatenate(v_parts), np.concatenate(made)


def _moving(values: F8, n: int) -> F8:
    """Mean of the last n rows (fewer at the start)."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    low = np.maximum(np.arange(len(values)) + 1 - n, 0)
    high = np.arange(len(values)) + 1
    return np.asarray((total[high] - total[low]) / (high - low)[:, None])


def _scatter(values: F8, period: float) -> F8:
    """RMS of first differences over the last window, (n, 3)."""
    steps = np.diff(values, axis=0, prepend=values[:1])
    return np.sqrt(np.maximum(_moving(steps * steps, max(2, round(WINDOW_S / period))), 0.0))


def _rest(t: F8, gyro: F8, accel: F8, bridged: NDArray[np.bool_], period: float, every_s: float) -> tuple[F8, F8, F8]:
    """Windows whose readings are as quiet as at rest: their ends, mean angular rates and specific forces."""
    n = max(2, round(WINDOW_S / period))
    mean_a, mean_g = _moving(accel - accel[0], n), _moving(gyro, n)
    var_a = _moving((accel - accel[0]) ** 2, n) - mean_a**2
    var_g = _moving(gyro**2, n) - mean_g**2
    quiet = (var_a < REST_ACCEL_SD**2).all(axis=1) & (var_g[:, 2] < REST_YAW_SD**2)
    quiet &= (_moving(bridged[:, None].astype(np.float64), n) == 0.0)[:, 0]
    quiet[:n] = False
    slot = np.floor(t[1:] / every_s).astype(np.int64)
    last = np.flatnonzero(np.diff(slot, append=slot[-1] + 1) > 0)
    pick = last[quiet[last]]
    return t[pick + 1], np.ascontiguousarray(mean_g[pick]), np.ascontiguousarray(mean_a[pick] + accel[0])


@dataclass(frozen=True)
class InertialState:
    """Elements of the state: names, where they are, how uncertain at the start, how they change.

    Attributes
    ----------
    layout : Layout
        ``att.n``, ``vel.n``, ``pos.n``, ``bg.x``, ``ba.x`` ... then what the configuration adds.
    at : At
    mean, sigma : (n,) float64
        At the start; of the first nine 0, alignment knows better.
    rate, walk : (n,) float64
        Markov rate, 1/s, and spectral density of the driving noise.
    """

    layout: Layout
    at: At
    mean: F8
    sigma: F8
    rate: F8
    walk: F8


def inertial_state(
    config: InertialConfig,
    *,
    baro: bool = False,
    odometer: bool = False,
    clocks: tuple[str, ...] = (),
    noise: Clocks | None = None,
) -> InertialState:
    """State of a configuration; what follows says which measurements will come.

    ``clocks`` are the letters of the systems whose pseudoranges will come: one receiver clock with its drift, and
    the further systems' clocks against it.
    """
    g, a, car = config.gyro, config.accel, config.vehicle
    names = [f"{kind}.{axis}" for kind in ("att", "vel", "pos") for axis in "ned"]
    rows: list[tuple[float, float, float, float]] = [(0.0, 0.0, 0.0, 0.0)] * 9
    where: dict[str, int] = {}

    def add(part: str, members: list[str], *numbers: tuple[float, float, float, float]) -> None:
        where[part] = len(names)
        names.extend(members)
        rows.extend(numbers if len(numbers) == len(members) else numbers * len(members))

    def markov(sigma: float, tau_s: float, start: float) -> tuple[float, float, float, float]:
        return 0.0, start, 1.0 / tau_s, 2.0 * sigma * sigma / tau_s

    def constant(mean: float, sigma: float, walk: float = 0.0) -> tuple[float, float, float, float]:
        return mean, sigma, 0.0, walk * walk

    gb, ab = g.bias_dph * DPH, a.bias_ug * UG
    gi, ai = g.in_run_dph * DPH, a.in_run_ug * UG
    apart = config.constant_bias
    # Without parts of their own, constant and changing parts are one random walk of the in-run size over its time.
    walk_g, walk_a = gi * math.sqrt(2.0 / g.in_run_tau_s), ai * math.sqrt(2.0 / a.in_run_tau_s)
    add("bg", ["bg.x", "bg.y", "bg.z"], markov(gi, g.in_run_tau_s, gi) if apart else constant(0.0, gb, walk_g))
    add("ba", ["ba.x", "ba.y", "ba.z"], markov(ai, a.in_run_tau_s, ai) if apart else constant(0.0, ab, walk_a))
    if apart:
        add("bgc", ["bgc.x", "bgc.y", "bgc.z"], constant(0.0, gb))
        add("bac", ["bac.x", "bac.y", "bac.z"], constant(0.0, ab))
    if g.scale_ppm > 0.0:
        add("sg", ["sg.x", "sg.y", "sg.z"], constant(0.0, g.scale_ppm * 1e-6))
    if a.scale_ppm > 0.0:
        add("sa", ["sa.x", "sa.y", "sa.z"], constant(0.0, a.scale_ppm * 1e-6))
    if car.constraint or odometer:
        sigma = math.radians(car.mount_sigma_deg)
        add(
            "mount", ["mount.pitch", "mount.yaw"],
            constant(math.radians(car.mount_pitch_deg), sigma, MOUNT_WALK),
            constant(math.radians(car.mount_yaw_deg), sigma, MOUNT_WALK),
        )  # fmt: skip
        add("axle", ["axle.x"], constant(car.axle_m, car.axle_sigma_m))
        if car.steer_sigma > 0.0:
            add("steer", ["steer.slip", "steer.squat"], constant(0.0, car.steer_sigma))
    if config.lever_arm_sigma_m > 0.0:
        add("arm", ["arm.x", "arm.y", "arm.z"], *(constant(x, config.lever_arm_sigma_m) for x in config.lever_arm_m))
    if config.time_offset_sigma_s > 0.0:
        add("tau", ["tau"], constant(0.0, config.time_offset_sigma_s))
    if baro:
        add("baro", ["baro"], markov(config.baro_sigma_m, BARO_TAU_S, config.baro_sigma_m))
    if odometer and config.odometer_scale_sigma > 0.0:
        add("odo", ["odo"], constant(0.0, config.odometer_scale_sigma))
    if clocks:
        if noise is None:
            raise ValueError("clocks want their noise")
        add("clk", [f"clk.{clocks[0]}", "drift"], (0.0, 0.0, 0.0, noise.bias_psd), (0.0, 0.0, 0.0, noise.drift_psd))
        if len(clocks) > 1:
            add("isb", [f"isb.{name}" for name in clocks[1:]], (0.0, 0.0, 0.0, noise.system_bias_psd))
    numbers = np.array(rows)
    at = At(**{name: where.get(name, -1) for name in At._fields})
    return InertialState(Layout(tuple(names)), at, *(numbers[:, k].copy() for k in range(4)))


MOUNT_WALK = 2e-4
"""Random walk of the mount angles, rad/sqrt(s): load and suspension, 0.1 deg in a minute."""
BARO_TAU_S = 600.0
"""Correlation time of the weather's and the ventilation's part in a barometric height, s."""
