"""Alignment: where an inertial filter starts, with which attitude, and how well it knows it."""

import math
from dataclasses import dataclass

import numpy as np

from starwise.config_inertial import InertialConfig
from starwise.errors import StarwiseError
from starwise.models.inertial import DPH, UG, InertialState, Intervals
from starwise.physics.earth import OMEGA_IE, curvature_radii, normal_gravity
from starwise.types import F8

LEVEL_SIGMA = math.radians(1.0)
"""Roll and pitch from the specific force of one second in a moving vehicle, beside the accelerometers' bias, rad."""
COURSE_SIGMA = math.radians(2.0)
"""Direction of motion as heading of the vehicle, beside the noise of the velocity, rad."""
REST_BIAS_SIGMA = 100.0 * DPH
"""Bias of vibrating gyroscopes from their mean reading at rest, rad/s, at most as good as this."""
REST_SPEED = 0.15
"""Speed of fixes at rest, at most, m/s."""
LEVEL_S = 1.0
"""Time over which the acceleration of fixes is compared with the specific force, s."""
GYROCOMPASS_S = 120.0
"""Time at rest that gyrocompassing takes, at most: afterwards the filter does better, s."""
NEAR_S = 2.5
"""Fixes farther apart than this are not interpolated, s."""


@dataclass(frozen=True)
class FixTable:
    """Fixes in the units of the filter, times in seconds since the first reading, sorted; none is NaN.

    Attributes
    ----------
    t, llh, cov : (p,), (p, 3), (p, 3, 3)
        Positions: latitude, longitude (rad), height (m); covariance north, east, down, m^2.
    tv, vel, vel_cov : (q,), (q, 3), (q, 3, 3)
        Velocities, north, east, down, at the time that they are valid for.
    """

    t: F8
    llh: F8
    cov: F8
    tv: F8
    vel: F8
    vel_cov: F8


@dataclass(frozen=True)
class Start:
    """Beginning of a filter.

    Attributes
    ----------
    t_s : float
        s since the first reading.
    nav : (10,) float64
    est : (n,) float64
    P : (n, n) float64
    """

    t_s: float
    nav: F8
    est: F8
    P: F8


def rotation(axis: int, angle: float) -> F8:
    """Rotation (3, 3) by an angle (rad) about axis 0, 1 or 2."""
    c, s = math.cos(angle), math.sin(angle)
    C = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    C[i, i] = C[j, j] = c
    C[i, j], C[j, i] = -s, s
    return C


def quaternion(C: F8) -> F8:
    """Quaternion (4,), scalar first, of a rotation matrix. Groves (2.35)."""
    q = np.array([
        1.0 + C[0, 0] + C[1, 1] + C[2, 2], 1.0 + C[0, 0] - C[1, 1] - C[2, 2],
        1.0 - C[0, 0] + C[1, 1] - C[2, 2], 1.0 - C[0, 0] - C[1, 1] + C[2, 2],
    ])  # fmt: skip
    k = int(np.argmax(q))
    s = 0.5 / math.sqrt(q[k])
    a, b, c = C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]
    d, e, f = C[1, 0] + C[0, 1], C[2, 0] + C[0, 2], C[2, 1] + C[1, 2]
    table = ([q[0], a, b, c], [a, q[1], d, e], [b, d, q[2], f], [c, e, f, q[3]])
    return s * np.array(table[k])


def roll_pitch_yaw(C: F8) -> F8:
    """Roll, pitch, yaw (..., 3), rad, of rotations C_nb (..., 3, 3). Groves (2.23)."""
    return np.stack(
        [
            np.arctan2(C[..., 2, 1], C[..., 2, 2]),
            np.arcsin(np.clip(-C[..., 2, 0], -1.0, 1.0)),
            np.arctan2(C[..., 1, 0], C[..., 0, 0]),
        ],
        axis=-1,
    )


def mount_rotation(pitch: float, yaw: float) -> F8:
    """C_vb (3, 3): body axes to those of the vehicle."""
    return rotation(1, pitch) @ rotation(2, yaw)


def level(force: F8, wanted: F8) -> tuple[float, float]:
    """Roll and pitch, rad, that turn a specific force (3,), any yaw, into its components forward and right ``wanted``.

    Parameters
    ----------
    force : (3,)
        In axes to be levelled, m/s^2.
    wanted : (2,)
        Acceleration in the level axes ahead and to the right, m/s^2; zero at rest.
    """
    side = math.hypot(force[1], force[2])
    roll = math.asin(max(-1.0, min(1.0, wanted[1] / side))) - math.atan2(force[1], -force[2])
    down = force[1] * math.sin(roll) + force[2] * math.cos(roll)
    along = math.hypot(force[0], down)
    pitch = math.atan2(force[0], -down) - math.asin(max(-1.0, min(1.0, wanted[0] / along)))
    return roll, pitch


def align(iv: Intervals, fixes: FixTable, state: InertialState, config: InertialConfig) -> Start:
    """Start of the filter: levelled, heading by the direction of motion or by the Earth's rotation.

    Raises
    ------
    StarwiseError
        Nothing to align with, and what is missing.
    """
    if config.alignment == "gyrocompass":
        return _gyrocompass(iv, fixes, state, config)
    tv, vel = (fixes.tv, fixes.vel) if len(fixes.tv) > 1 else _differences(fixes)
    speed = np.hypot(vel[:, 0], vel[:, 1]) if len(vel) else np.zeros(0)
    for k in np.flatnonzero(speed >= config.alignment_speed_mps):
        t = float(tv[k])
        i = int(np.searchsorted(fixes.t, t + 1e-9))
        inside = t > LEVEL_S and t < iv.read.t[-1]
        if not inside or i == 0 or (i == len(fixes.t) and t - fixes.t[-1] > 1e-6):
            continue
        near = fixes.t[min(i, len(fixes.t) - 1)] - fixes.t[i - 1] <= NEAR_S
        if near and t - fixes.t[i - 1] <= NEAR_S:
            return _moving_start(iv, fixes, tv, vel, int(k), state, config)
    raise StarwiseError(
        "no heading: no fix among the inertial readings moves fast enough",
        found=f"at most {speed.max():.1f} m/s" if len(speed) else "no velocities",
        wanted=f"{config.alignment_speed_mps:g} m/s (inertial.alignment_speed_mps)",
    )


def _differences(fixes: FixTable) -> tuple[F8, F8]:
    """Velocities (north, east, down) by differences of positions, at the time of the later one."""
    step = np.diff(fixes.t)
    good = step <= NEAR_S
    R_M, R_N = curvature_radii(fixes.llh[:-1, 0])
    scale = np.stack(
        [R_M + fixes.llh[:-1, 2], (R_N + fixes.llh[:-1, 2]) * np.cos(fixes.llh[:-1, 0]), -np.ones(len(R_M))], 1
    )
    return fixes.t[1:][good], (np.diff(fixes.llh, axis=0) * scale / step[:, None])[good]


def _mean_force(iv: Intervals, t0: float, t1: float) -> F8:
    """Mean specific force between two times, body axes, m/s^2."""
    t = iv.read.t
    a, b = np.searchsorted(t, t0), np.searchsorted(t, t1)
    b = max(b, a + 1)
    return np.asarray(iv.read.dv[a:b].sum(axis=0) / (t[b] - t[a]))


def _moving_start(
    iv: Intervals, fixes: FixTable, tv: F8, vel: F8, k: int, state: InertialState, config: InertialConfig
) -> Start:
    t = float(tv[k])
    v = vel[k]
    llh = np.array([np.interp(t, fixes.t, fixes.llh[:, j]) for j in range(3)])
    before = np.array([np.interp(t - LEVEL_S, tv, vel[:, j]) for j in range(3)])
    a = (v - before) / LEVEL_S
    course = math.atan2(v[1], v[0])
    C_vb = mount_rotation(math.radians(config.vehicle.mount_pitch_deg), math.radians(config.vehicle.mount_yaw_deg))
    force = C_vb @ _mean_force(iv, t - LEVEL_S, t)
    wanted = rotation(2, -course) @ a
    roll, pitch = level(force, wanted[:2])
    C = rotation(2, course) @ rotation(1, pitch) @ rotation(0, roll) @ C_vb
    P = _covariance(state, config, fixes, t)
    speed2 = float(v[0] ** 2 + v[1] ** 2)
    at_v = min(int(np.searchsorted(fixes.tv, t)), len(fixes.tv) - 1)
    noise = float(np.trace(fixes.vel_cov[at_v, :2, :2])) if len(fixes.tv) else 1.0
    P[2, 2] = COURSE_SIGMA**2 + noise / speed2
    mount = math.radians(config.vehicle.mount_sigma_deg)
    P[2, 2] += mount**2
    if state.at.mount >= 0:
        # heading of the body = course + mount yaw: one error
        P[2, state.at.mount + 1] = P[state.at.mount + 1, 2] = mount**2
    P[3:6, 3:6] = (fixes.vel_cov[at_v] if len(fixes.tv) else np.eye(3)) + 0.1 * np.eye(3)
    return _started(iv, fixes, t, llh, v, C, P, state, config)


def _covariance(state: InertialState, config: InertialConfig, fixes: FixTable, t: float) -> F8:
    P = np.diag(state.sigma**2)
    P[0, 0] = P[1, 1] = LEVEL_SIGMA**2 + (config.accel.bias_ug * UG / 9.8) ** 2
    near = int(np.argmin(np.abs(fixes.t - t)))
    P[6:9, 6:9] = fixes.cov[near] + 0.5**2 * np.eye(3)
    return P


def _started(
    iv: Intervals, fixes: FixTable, t: float, llh: F8, v: F8, C: F8, P: F8, state: InertialState,
    config: InertialConfig, biases: bool = True,
) -> Start:  # fmt: skip
    """Antenna to sensor; gyro biases from rest before the start, if asked for and if there was any."""
    est = state.mean.copy()
    rest = _at_rest(iv, fixes, t) if biases else np.zeros((0, 3))
    if len(rest):
        at = state.at.bgc if state.at.bgc >= 0 else 9
        est[at : at + 3] = np.median(rest, axis=0)
        sigma = max(REST_BIAS_SIGMA if config.gyro.vibration > 0.0 else 0.0, OMEGA_IE)
        for j in range(at, at + 3):
            P[j, j] = min(P[j, j], sigma**2)
    arm = C @ np.array(config.lever_arm_m)
    R_M, R_N = curvature_radii(llh[0])
    scale = np.array([1.0 / (R_M + llh[2]), 1.0 / ((R_N + llh[2]) * math.cos(llh[0])), -1.0])
    nav = np.concatenate([quaternion(C), v, llh - arm * scale])
    return Start(t, nav, est, P)


def _at_rest(iv: Intervals, fixes: FixTable, t: float) -> F8:
    """Mean gyro readings of windows of rest before t: quiet, and no fix that moves (a slow curve is quiet, too)."""
    tv, vel = (fixes.tv, fixes.vel) if len(fixes.tv) > 1 else _differences(fixes)
    if len(tv) == 0:
        return np.zeros((0, 3))
    speed = np.interp(iv.rest_t, tv, np.hypot(vel[:, 0], vel[:, 1]))
    known = (iv.rest_t >= tv[0]) & (iv.rest_t <= t) & (speed < REST_SPEED)
    return np.asarray(iv.rest_gyro[known])


def _gyrocompass(iv: Intervals, fixes: FixTable, state: InertialState, config: InertialConfig) -> Start:
    """Attitude at rest from gravity and the Earth's rotation (triad), for gyroscopes much better than 15 deg/h."""
    if len(iv.rest_t) < 20 or iv.rest_t[0] > 5.0:
        raise StarwiseError(
            "gyrocompassing needs rest at the start", found=f"{len(iv.rest_t)} quiet windows", wanted="20"
        )
    every = config.vehicle.interval_s
    length = 1 + int(np.argmax(np.append(np.diff(iv.rest_t) > 1.5 * every, True)))
    length = min(length, int(np.searchsorted(iv.rest_t, GYROCOMPASS_S)) + 1)
    t = float(iv.rest_t[length - 1])
    i = int(np.argmin(np.abs(fixes.t - t)))
    llh = fixes.llh[i]
    n = int(np.searchsorted(iv.read.t, t))
    f_b = iv.read.dv[:n].sum(axis=0) / t
    w_b = iv.read.dtheta[:n].sum(axis=0) / t
    down = np.array([0.0, 0.0, 1.0])
    north = np.array([math.cos(llh[0]), 0.0, -math.sin(llh[0])])
    C = _triad(down, north) @ _triad(-f_b, w_b).T
    P = _covariance(state, config, fixes, t)
    across = OMEGA_IE * math.cos(llh[0])
    white = math.radians(config.gyro.white_dprh) / 60.0 / math.sqrt(t)
    heading = math.hypot(config.gyro.bias_dph * DPH, white) / across
    if heading > 0.2:
        raise StarwiseError(
            "gyroscopes are not good enough for gyrocompassing",
            found=f"heading to {math.degrees(heading):.0f} deg", wanted="10 deg: alignment = velocity",
        )  # fmt: skip
    tilt = config.accel.bias_ug * UG / float(normal_gravity(llh[0], llh[2]))
    P[0, 0] = P[1, 1] = tilt**2 + (1e-5) ** 2
    P[2, 2] = heading**2
    P[3:6, 3:6] = 0.01 * np.eye(3)
    return _started(iv, fixes, t, llh, np.zeros(3), C, P, state, config, biases=False)


def _triad(first: F8, second: F8) -> F8:
    """Orthonormal axes (columns) along the first vector and in the plane with the second. Groves (6.12)."""
    a = first / np.linalg.norm(first)
    b = np.cross(a, second)
    b = b / np.linalg.norm(b)
    return np.stack([a, b, np.cross(a, b)], axis=1)
