"""The experiments of the RDSS/SINS paper, simulated: truth, inertial increments with errors, late fixes, filters.

What the paper gives is taken from it; what it does not give stands here, once for all experiments, chosen before any
result was looked at.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np

from starwise.constants import NS
from starwise.estimators.late import METHODS
from starwise.frames import geodetic_from_ecef, rotations_ne_enu
from starwise.gnsstime import from_week_tow
from starwise.kernels.rdss_sins import FREE, SinsFixes, SinsOut, sins_run
from starwise.kernels.sins15 import SinsModel
from starwise.physics.earth import curvature_radii
from starwise.physics.rdss import RdssNoise, RdssProtocol, geostationary, rdss_covariances, round_trips, solve_rdss
from starwise.sim.imu import DPH, DPRH, UG, perfect_imu
from starwise.sim.sections import Vehicle
from starwise.sim.seeds import Streams, streams
from starwise.sim.trajectory import Trajectory, from_segments
from starwise.types import F8

T0_NS: Final = from_week_tow(2300, 0.0)
DURATION_S: Final = 26 * 60.0
RATE_HZ: Final = 20
PERIOD_S: Final = 1.5
"""From request to answer, and from answer to answer (paper: about 1.5 s)."""
PERIOD: Final = round(PERIOD_S * RATE_HZ)
"""The same in steps."""
EVERY: Final = 5
"""Steps of increments in a step of the covariance (0.25 s)."""
START: Final = (40.0, 116.0, 1000.0)
"""Latitude, longitude (deg), height (m) of the start."""
DELAY_SIGMA_S: Final = 1.0
"""What is thought possible of an unknown delay: 0.5 +- 1 s to begin an estimate with."""

Way = Literal["free", "ignored", "optimal_prediction", "replay", "cloning", "estimated"]


@dataclass(frozen=True)
class SinsErrors:
    """Errors of the inertial navigator, 1 sigma; the filter believes the same.

    From the paper: attitude 30", velocity 0.1 m/s, position 100 m, gyro drift 1 deg/h with a Markov time of 3600 s. Its
    gyro drift is taken as 1 deg/h of the constant part and 1 deg/h of the Markov part. Not given: accelerometers
    (1e-4 g, the grade that goes with such gyroscopes, with the same Markov time) and white noise (a fiftieth of the
    drift per sqrt(h), 10 micro-g/sqrt(Hz)). The accelerometer z has the same errors; the paper's state leaves them out.
    """

    attitude_rad: float = 30.0 / 3600.0 * np.pi / 180.0
    velocity_mps: float = 0.1
    position_m: float = 100.0
    gyro_constant: float = 1.0 * DPH
    gyro_markov: float = 1.0 * DPH
    gyro_white: float = 0.02 * DPRH
    accel_markov: float = 100.0 * UG
    accel_white: float = 10.0 * UG
    tau_s: float = 3600.0

    def P0(self) -> F8:
        """Covariance of the 15 states at the start."""
        sigma = [self.attitude_rad] * 3 + [self.velocity_mps] * 2 + [self.position_m] * 2
        sigma += [self.gyro_constant] * 3 + [self.gyro_markov] * 3 + [self.accel_markov] * 2
        return np.diag(np.square(sigma))


@dataclass(frozen=True)
class Experiment:
    """A trajectory with fixes.

    Attributes
    ----------
    name : str
    speed_mps : float
        0: at rest.
    turns : bool
        90 deg at 2 deg/s every 85 s (bank 12 deg at 60 m/s); else straight.
    jitter_s : float
        Standard deviation of the instant that a fix is valid for, about the request.
    known_jitter : bool
        Whether the filter is told.
    fix_correlation : float
        First-order correlation of successive errors of fixes.
    constant_height_error : bool
        The height error is one for the whole run, as that of a map, in place of a new one for every fix.
    R_factor : float
        What the filter believes of the variance of fixes, over the truth.
    turn_deg : float
        Size of the turns.
    duration_s : float
    """

    name: str
    speed_mps: float
    turns: bool = True
    jitter_s: float = 0.0
    known_jitter: bool = False
    fix_correlation: float = 0.0
    constant_height_error: bool = False
    R_factor: float = 1.0
    turn_deg: float = 90.0
    duration_s: float = DURATION_S
    errors: SinsErrors = field(default_factory=SinsErrors)
    noise: RdssNoise = field(default_factory=RdssNoise)

    def trajectory(self) -> Trajectory:
        """True motion, at a constant height."""
        if self.speed_mps == 0.0:
            given: dict[str, Any] = {"kind": "car", "segments": [{"kind": "static"}]}
        else:
            ways: list[dict[str, Any]] = []
            for k in range(20 if self.turns else 0):
                side = 1.0 if k % 4 < 2 else -1.0
                turn = {"rate_dps": 2.0, "angle_deg": side * self.turn_deg, "roll_in_s": 3.0}
                if self.turn_deg < 15.0:
                    turn |= {"rate_dps": 0.5, "roll_in_s": 1.0}
                ways += [{"kind": "straight", "duration_s": 40.0}, {"kind": "turn", **turn}]
            given = {"kind": "aircraft", "speed_mps": self.speed_mps, "segments": [*ways, {"kind": "straight"}]}
        return from_segments(
            Vehicle.from_dict({"start": list(START), "heading_deg": 30.0, **given}), T0_NS, self.duration_s
        )


@dataclass(frozen=True)
class SinsRun:
    """One run of one method.

    Attributes
    ----------
    t_s : (F,)
        Times of answers since the start.
    position_error, velocity_error : (F, 2)
        Estimate minus truth at that moment, north and east, m and m/s.
    P : (F, 4, 4)
        Of velocity and position.
    v : (F, 2), S : (F, 2, 2), nis : (F,)
    tau : (F, 2)
    signature, effect : (F, 2)
    """

    t_s: F8
    position_error: F8
    velocity_error: F8
    P: F8
    v: F8
    S: F8
    nis: F8
    tau: F8
    signature: F8
    effect: F8


@dataclass(frozen=True)
class _Named:
    """Streams of an experiment: those at rest and those in motion are independent, variants of them share theirs."""

    of: Streams
    name: str

    def __call__(self, name: str) -> np.random.Generator:
        return self.of(f"{self.name}/{name}")


class Scene:
    """What is common to all runs of an experiment, computed once."""

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        path = experiment.trajectory()
        n = round(experiment.duration_s * RATE_HZ)
        t_ns = T0_NS + np.arange(n + 1, dtype=np.int64) * (NS // RATE_HZ)
        self.perfect = perfect_imu(path, t_ns, increments=True)
        states = path.states(t_ns)
        self.llh = geodetic_from_ecef(states.pos_e)
        C = rotations_ne_enu(self.llh[:, 0], self.llh[:, 1])[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])[:, None]
        self.vel_n = np.einsum("kij,kj->ki", C, states.vel_e)
        self.C_nb0 = C[0] @ states.C_eb[0]
        self.pos_e = states.pos_e
        self.sats = geostationary()
        asked, _ = RdssProtocol(latency_s=PERIOD_S).schedule(experiment.duration_s)
        self.asked = np.rint(asked * RATE_HZ).astype(np.int64)

    @cached_property
    def R(self) -> F8:
        """Covariance of every fix, north and east, (F, 2, 2), m^2."""
        enu = rdss_covariances(self.pos_e[self.asked], self.sats, self.experiment.noise)
        return np.ascontiguousarray(enu[:, [1, 0]][:, :, [1, 0]])

    def simulate(self, run: int, seed: int) -> "Measured":
        """Readings and fixes of a run."""
        rng = _Named(streams(seed, run), "rest" if self.experiment.speed_mps == 0.0 else "moving")
        e, n = self.experiment.errors, len(self.perfect.dt_s)
        dtheta = self.perfect.gyro + _sensor(n, e.gyro_constant, e.gyro_markov, e.tau_s, e.gyro_white, rng, "gyro")
        dv = self.perfect.accel + _sensor(n, 0.0, e.accel_markov, e.tau_s, e.accel_white, rng, "accel")
        return Measured(dtheta, dv, self._start(rng), self._fixes(rng))

    def nav0(self, phi: F8 | None = None, d_vel: F8 | None = None, d_pos: F8 | None = None) -> F8:
        """Navigation state (10,) at the start: true, or off by a rotation vector, m/s and m (north, east)."""
        from scipy.spatial.transform import Rotation

        C_nb = self.C_nb0 if phi is None else Rotation.from_rotvec(-phi).as_matrix() @ self.C_nb0
        x, y, z, w = Rotation.from_matrix(C_nb).as_quat()
        lat, lon, h = self.llh[0]
        R_M, R_N = curvature_radii(lat)
        vel = self.vel_n[0].copy()
        if d_vel is not None:
            vel[:2] += d_vel
        if d_pos is not None:
            lat, lon = lat + d_pos[0] / (R_M + h), lon + d_pos[1] / ((R_N + h) * np.cos(lat))
        return np.array([w, x, y, z, *vel, lat, lon, h])

    def _start(self, rng: _Named) -> F8:
        e, draw = self.experiment.errors, rng("start").standard_normal(7)
        return self.nav0(e.attitude_rad * draw[:3], e.velocity_mps * draw[3:5], e.position_m * draw[5:])

    def _fixes(self, rng: _Named) -> SinsFixes:
        x, asked = self.experiment, self.asked
        n = len(asked)
        valid = asked.copy()
        if x.jitter_s > 0.0:
            late = np.rint(RATE_HZ * x.jitter_s * rng("jitter").standard_normal(n)).astype(np.int64)
            valid = np.clip(valid + np.clip(late, -PERIOD // 2, PERIOD // 2), 0, None)
        white = rng("ranging").standard_normal((n, 3))
        if x.fix_correlation > 0.0:
            for k in range(1, n):
                white[k] = x.fix_correlation * white[k - 1] + np.sqrt(1.0 - x.fix_correlation**2) * white[k]
        if x.constant_height_error:
            white[:, 2] = white[0, 2]
        trips = round_trips(self.pos_e[valid], self.sats) + 2.0 * x.noise.distance_m * white[:, :2]
        h = self.llh[valid, 2] + x.noise.height_m * white[:, 2]
        llh = geodetic_from_ecef(solve_rdss(trips, h, self.sats, (START[0], START[1])))
        believed = valid if x.known_jitter else asked
        return SinsFixes(
            np.ascontiguousarray(llh[:, 0]), np.ascontiguousarray(llh[:, 1]), x.R_factor * self.R, believed,
            asked + PERIOD,
        )  # fmt: skip

    def model(self) -> SinsModel:
        """What the filter believes."""
        e = self.experiment.errors
        return SinsModel(
            1.0 / RATE_HZ, EVERY, e.gyro_white**2, e.accel_white**2, e.gyro_markov, e.tau_s, e.accel_markov, e.tau_s,
            START[2],
        )  # fmt: skip

    def filtered(self, measured: "Measured", way: Way) -> SinsRun:
        """A run of one way."""
        F = len(self.asked)
        out = SinsOut(
            np.empty((F, 10)), np.empty((F, 4, 4)), np.full((F, 2), np.nan), np.empty((F, 2, 2)),
            np.full((F, 2), np.nan), np.zeros((F, 2)), np.zeros((F, 2)),
        )  # fmt: skip
        method = FREE if way == "free" else METHODS[way]
        sins_run(
            method, self.model(), measured.dtheta, measured.dv, measured.nav0, self.experiment.errors.P0(),
            measured.fixes, 0.5, DELAY_SIGMA_S, out,
        )  # fmt: skip
        there = measured.fixes.there
        R_M, R_N = curvature_radii(self.llh[there, 0])
        h = self.llh[there, 2]
        error = np.stack(
            [
                (out.nav[:, 7] - self.llh[there, 0]) * (R_M + h),
                (out.nav[:, 8] - self.llh[there, 1]) * (R_N + h) * np.cos(self.llh[there, 0]),
            ],
            axis=1,
        )
        velocity = out.nav[:, 4:6] - self.vel_n[there, :2]
        nis = np.full(F, np.nan) if way == "free" else _nis(out.v, out.S)
        return SinsRun(there / RATE_HZ, error, velocity, out.P, out.v, out.S, nis, out.tau, out.signature, out.effect)


@dataclass(frozen=True)
class Measured:
    """Increments (n, 3) with errors, navigation state at the start, fixes."""

    dtheta: F8
    dv: F8
    nav0: F8
    fixes: SinsFixes


def _nis(v: F8, S: F8) -> F8:
    return np.asarray((v * np.linalg.solve(S, v[:, :, None])[:, :, 0]).sum(axis=1))


def _sensor(n: int, constant: float, markov: float, tau_s: float, white: float, rng: _Named, name: str) -> F8:
    """Errors of increments, (n, 3): constant, first-order Markov (stationary from the start), white."""
    from scipy.signal import lfilter

    dt = 1.0 / RATE_HZ
    keep = np.exp(-dt / tau_s)
    draw = rng(f"{name}/markov").standard_normal((n, 3)) * markov
    first = draw[0].copy()
    draw *= np.sqrt(-np.expm1(-2.0 * dt / tau_s))
    draw[0] = first
    rate = lfilter([1.0], [1.0, -keep], draw, axis=0) + constant * rng(f"{name}/constant").standard_normal(3)
    return np.asarray(dt * rate + np.sqrt(dt) * white * rng(f"{name}/white").standard_normal((n, 3)))


EXPERIMENTS: Final = {
    "static": Experiment("static", 0.0),
    "dynamic": Experiment("dynamic", 60.0),
}


def variant(**changes: Any) -> Experiment:
    """The dynamic experiment with changes."""
    return replace(EXPERIMENTS["dynamic"], **changes)
