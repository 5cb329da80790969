"""Worlds in which a filter is right, or wrong in one known way: what the laboratory must find, and must not.

**Car.** A car of the vehicle preset (Singer acceleration, drawn from the very process model) under GPS and Galileo, 1
Hz, five minutes; codes with white noise of 1 m, rates of 0.1 m/s; the package's compiled white filter (S3EKF, its
gate on), started from least squares. Cases change the world, or what the filter is told, by one thing.

**Fixes.** A vehicle in the plane that steers and brakes, an accelerometer as input, position fixes once a second of 1
m: a Kalman filter of eight lines, all runs at a time. The fixes may be late.

Nothing here depends on what the laboratory does; sizes were chosen before it had seen a run.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from starwise.analysis.lab import Cause, Consistency
from starwise.config import RunConfig
from starwise.constants import C_LIGHT, OMEGA_E_GPS, ROW_GATED, ROW_USED
from starwise.estimators.filter import filter_rows
from starwise.frames import geodetic_from_ecef, rotations_ne_enu
from starwise.kernels.rangemodel import Epochs, ModelOptions, RowModel, Rows
from starwise.kernels.spp import EpochOut
from starwise.models.process import PRESETS, Clocks, clocks_from, matrices
from starwise.models.pseudorange import model_options
from starwise.signals import sv_name
from starwise.sim.run import Simulator
from starwise.sim.scenario import Scenario
from starwise.studies.scene import ALL_SEEN
from starwise.types import F8, I8, IonosphereModel, Solution, Truth

CODE_M: Final = 1.0
RATE_MPS: Final = 0.1


@dataclass(frozen=True)
class Wrong:
    """What is wrong, and what it is called.

    Attributes
    ----------
    name : str
    causes : tuple of Cause
        Names that are right for it; empty: nothing is wrong.
    code_var, rate_var : float
        True over assumed variance of codes and rates.
    process : float
        True over assumed driving noise of the motion.
    lasting_s : float
        Correlation time of half of the code variance; 0: none.
    bias_m : float
        Of one satellite's codes.
    delay_s : float
        Time by which codes are late against rates (car), or fixes (plane).
    outliers : float
        Share of codes whose noise is six times as large.
    """

    name: str
    causes: tuple[Cause, ...] = ()
    code_var: float = 1.0
    rate_var: float = 1.0
    process: float = 1.0
    lasting_s: float = 0.0
    bias_m: float = 0.0
    delay_s: float = 0.0
    outliers: float = 0.0


CASES: Final = (
    Wrong("right"),
    Wrong("R of codes 2 x too small", (Cause.R_TOO_SMALL,), code_var=2.0),
    Wrong("R of codes 2 x too large", (Cause.R_TOO_LARGE,), code_var=0.5),
    Wrong("R of rates 2 x too small", (Cause.R_TOO_SMALL,), rate_var=2.0),
    Wrong("R of rates 2 x too large", (Cause.R_TOO_LARGE,), rate_var=0.5),
    Wrong("Q 4 x too small", (Cause.Q_TOO_SMALL,), process=4.0),
    Wrong("Q 4 x too large", (Cause.Q_TOO_LARGE,), process=0.25),
    Wrong("correlated codes, 30 s", (Cause.CORRELATED,), lasting_s=30.0),
    Wrong("correlated codes, 180 s", (Cause.CORRELATED,), lasting_s=180.0),
    Wrong("a satellite biased by 2 m", (Cause.BIAS,), bias_m=2.0),
    Wrong("codes late by 0.5 s", (Cause.DELAY,), delay_s=0.5),
    Wrong("2 % of codes six times as noisy", (Cause.HEAVY_TAILS,), outliers=0.02),
)
FIX_CASES: Final = (
    Wrong("right"),
    Wrong("R of fixes 2 x too small", (Cause.R_TOO_SMALL,), code_var=2.0),
    Wrong("R of fixes 2 x too large", (Cause.R_TOO_LARGE,), code_var=0.5),
    Wrong("fixes late by 0.5 s", (Cause.DELAY,), delay_s=0.5),
)


@dataclass(frozen=True)
class Judged:
    """How often a case was found, and what it was called.

    ``named``: the first finding is a right name (nothing wrong: part of runs that passed).
    """

    case: str
    runs: int
    detected: float
    named: float
    names: dict[str, int]


def judge(run: Callable[[int], Consistency], wrong: Wrong, numbers: range) -> Judged:
    """Runs of a case judged one by one."""
    detected, named = 0, 0
    names: Counter[str] = Counter()
    for number in numbers:
        made = run(number)
        detected += made.passed is False
        first = str(made.findings[0].cause) if made.findings else "nothing"
        names[first] += 1
        named += made.findings[0].cause in wrong.causes if made.findings and wrong.causes else made.passed is True
    n = len(numbers)
    return Judged(wrong.name, n, detected / n, named / n, dict(names.most_common()))


class CarWorld:
    """Runs of the car over one sky.

    Parameters
    ----------
    duration_s : float
    constellations : tuple of str
    start : str
    place : (float, float, float)
        Latitude deg, longitude deg, height m.
    """

    def __init__(
        self,
        duration_s: float = 300.0,
        constellations: tuple[str, ...] = ("gps", "galileo"),
        start: str = "2024-03-30T10:00:00",
        place: tuple[float, float, float] = (47.0, 8.0, 500.0),
    ) -> None:
        self.scenario = Scenario.from_dict(
            {
                "name": "laboratory",
                "time": {"start": start, "duration_s": duration_s, "interval_s": 1.0},
                "vehicle": {"start": list(place), "segments": [{"kind": "static"}]},
                "sky": {"constellations": list(constellations)},
                "receiver": {"mask_deg": 10.0, "phase": False, "clock": {"grade": "perfect"}},
            }
        )
        self.config = RunConfig(
            method="s3ekf", error_model="white", dynamics="vehicle", ionosphere="none", troposphere="none"
        )

    @cached_property
    def _sky(self) -> tuple[Epochs, Rows, ModelOptions, I8, F8]:
        """Epochs, rows without measurements, model, satellites, home."""
        truth = Simulator(self.scenario, 0).run(0).truth
        paths = truth.paths
        n = len(paths.sv)
        offsets = np.searchsorted(paths.epoch, np.arange(len(truth.t_ns) + 1)).astype(np.int64)
        system = (paths.sv >> 8).astype(np.int64)
        _, clock = np.unique(system, return_inverse=True)
        rows = Rows(
            sat_pos=np.ascontiguousarray(paths.sat_pos_e),
            sat_vel=np.ascontiguousarray(paths.sat_vel_e),
            clock_m=np.zeros(n),
            drift_mps=np.zeros(n),
            code_m=np.full(n, np.nan),
            rate_mps=np.full(n, np.nan),
            cn0_dbhz=np.full(n, np.nan),
            freq_hz=np.full(n, np.inf),
            sigma_sat_m=np.zeros(n),
            noise_factor=np.ones(n),
            system=system,
            clock=clock.astype(np.int64),
            status=np.full(n, ROW_USED, dtype=np.uint8),
        )
        model = model_options(self.config, IonosphereModel())[0]
        model = model._replace(mask_rad=ALL_SEEN, fixed_code_sigma_m=CODE_M, fixed_rate_sigma_mps=RATE_MPS)
        return Epochs(truth.t_ns, offsets), rows, model, paths.sv.astype(np.int64), truth.pos_e[0]

    def run(self, number: int, wrong: Wrong = CASES[0]) -> Consistency:
        """Consistency of run ``number``, whose random numbers depend on it and on nothing else."""
        rng = np.random.default_rng([77, number])
        epochs, rows, model, sv, home = self._sky
        n_clocks = int(rows.clock.max()) + 1
        clocks = clocks_from(self.config)
        x = self._motion(epochs.t_ns, home, n_clocks, clocks, wrong, rng)
        e = np.repeat(np.arange(len(epochs.t_ns)), np.diff(epochs.offsets))
        code = _ranges(x[:, :3] - wrong.delay_s * x[:, 3:6], rows, e) + x[e, 9 + rows.clock]
        rate = _rates(x, rows, e) + x[e, 9 + n_clocks + rows.clock]
        rows = rows._replace(
            code_m=code + self._code_errors(epochs, sv, e, wrong, rng),
            rate_mps=rate + np.sqrt(wrong.rate_var) * RATE_MPS * rng.standard_normal(len(e)),
        )
        ep, out = filter_rows(epochs, rows, model, n_clocks, self.config)
        return judged(epochs, ep, out, sv, e, self.config.gate_probability, x[:, :3])

    def _motion(self, t_ns: I8, home: F8, n_clocks: int, clocks: Clocks, wrong: Wrong, rng: np.random.Generator) -> F8:
        """True states (m, 9 + 2 n_clocks)."""
        motion = PRESETS["vehicle"]
        true = replace(motion, horizontal=motion.horizontal * wrong.process, vertical=motion.vertical * wrong.process)
        n = 9 + 2 * n_clocks
        up = home / np.linalg.norm(home)
        axes = motion.horizontal * np.eye(3) + (motion.vertical - motion.horizontal) * np.outer(up, up)
        P0 = np.zeros((n, n))
        P0[:3, :3], P0[3:6, 3:6], P0[6:9, 6:9] = np.eye(3), 0.25 * np.eye(3), axes
        P0[9 : 9 + n_clocks, 9 : 9 + n_clocks] = 1.0 + np.eye(n_clocks)
        P0[9 + n_clocks :, 9 + n_clocks :] = 0.01 + 1e-4 * np.eye(n_clocks)
        x = np.zeros((len(t_ns), n))
        east = np.cross([0.0, 0.0, 1.0], up)
        x0 = np.concatenate([home, 10.0 * east / np.linalg.norm(east), np.zeros(3), np.zeros(2 * n_clocks)])
        scale = np.ones(n)
        scale[6:9] = np.sqrt(wrong.process)
        x[0] = x0 + scale * (np.linalg.cholesky(P0 + 1e-12 * np.eye(n)) @ rng.standard_normal(n))
        Phi, Q = matrices(true, clocks, n_clocks, 1.0, up)
        values, vectors = np.linalg.eigh(Q)
        noise = rng.standard_normal((len(t_ns) - 1, n)) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
        for k in range(len(t_ns) - 1):
            x[k + 1] = Phi @ x[k] + noise[k]
        return x

    def _code_errors(self, epochs: Epochs, sv: I8, e: I8, wrong: Wrong, rng: np.random.Generator) -> F8:
        present, which = np.unique(sv, return_inverse=True)
        white = rng.standard_normal(len(e))
        lasting = np.zeros((len(epochs.t_ns), len(present)))
        drive = rng.standard_normal(lasting.shape)
        share = 0.0
        if wrong.lasting_s > 0.0:
            share, keep = 0.5, np.exp(-1.0 / wrong.lasting_s)
            lasting[0] = drive[0]
            for k in range(1, len(lasting)):
                lasting[k] = keep * lasting[k - 1] + np.sqrt(1.0 - keep * keep) * drive[k]
        error = CODE_M * np.sqrt(wrong.code_var) * (np.sqrt(1.0 - share) * white + np.sqrt(share) * lasting[e, which])
        wild = rng.random(len(e)) < wrong.outliers
        error[wild] *= 6.0
        counts = np.bincount(which)
        whole = np.flatnonzero(counts == counts.max())
        error[which == whole[int(rng.integers(len(whole)))]] += wrong.bias_m
        return np.asarray(error)


class FixWorld:
    """Position fixes once a second in a navigator with an accelerometer, in the plane.

    True accelerations are those of a car (Markov, 1.5 m/s^2, 5 s). The accelerometer's white noise, 0.05 m/s^2 sqrt(s)
    per axis, is all that the filter's Q has to cover: p' = v, v' = a + w. Errors of fixes that last are left out: with
    one sensor nothing tells them from motion.

    Parameters
    ----------
    duration_s : int
    fix_m : float
        Noise of a fix, per axis.
    """

    STEPS: Final = 10

    def __init__(self, duration_s: int = 600, fix_m: float = 1.0, accel_noise: float = 0.05) -> None:
        self.fixes, self.fix_m, self.accel_noise = duration_s, fix_m, accel_noise

    def run(self, number: int, wrong: Wrong = FIX_CASES[0], *, noise_known: bool = True) -> Consistency:
        """Consistency of run ``number``; ``noise_known`` false: only v and s are told, as of another program."""
        rng = np.random.default_rng([78, number])
        h, m = 1.0 / self.STEPS, self.fixes * self.STEPS
        keep = np.exp(-h / 5.0)
        a = np.zeros((m + 1, 2))
        drive = 1.5 * np.sqrt(1.0 - keep * keep) * rng.standard_normal((m + 1, 2))
        a[0] = 1.5 * rng.standard_normal(2)
        for k in range(m):
            a[k + 1] = keep * a[k] + drive[k]
        v = np.array([10.0, 0.0]) + np.vstack([np.zeros((1, 2)), np.cumsum(a[:-1] * h, axis=0)])
        p = np.vstack([np.zeros((1, 2)), np.cumsum(v[:-1] * h + 0.5 * a[:-1] * h * h, axis=0)])
        sensed = a + np.sqrt(wrong.process) * self.accel_noise / np.sqrt(h) * rng.standard_normal(a.shape)
        late = np.interp(np.arange(m + 1) * h - wrong.delay_s, np.arange(m + 1) * h, np.arange(m + 1))
        whole = late.astype(np.int64)
        part = (late - whole)[:, None]
        seen = p[whole] * (1.0 - part) + p[np.minimum(whole + 1, m)] * part
        seen = seen[:: self.STEPS] + self._fix_errors(wrong, rng)
        return self._filtered(seen, sensed, h, noise_known, rng.standard_normal(2))

    def _fix_errors(self, wrong: Wrong, rng: np.random.Generator) -> F8:
        white, drive = rng.standard_normal((2, self.fixes + 1, 2))
        lasting, share = np.zeros_like(white), 0.0
        if wrong.lasting_s > 0.0:
            share, keep = 0.5, np.exp(-1.0 / wrong.lasting_s)
            lasting[0] = drive[0]
            for k in range(1, len(lasting)):
                lasting[k] = keep * lasting[k - 1] + np.sqrt(1.0 - keep * keep) * drive[k]
        error = np.sqrt(1.0 - share) * white + np.sqrt(share) * lasting
        return np.asarray(self.fix_m * np.sqrt(wrong.code_var) * error)

    def _filtered(self, seen: F8, sensed: F8, h: float, noise_known: bool, start: F8) -> Consistency:
        x = np.array([seen[0], [10.0, 0.0] + 2.0 * start])
        P = np.diag([self.fix_m**2, 4.0])
        q, r = self.accel_noise**2, self.fix_m**2
        n = len(seen) - 1
        v, s, velocity = np.zeros((n, 2)), np.zeros(n), np.zeros((n, 3))
        F = np.array([[1.0, 1.0], [0.0, 1.0]])
        Q = q * np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]])
        for k in range(n):
            for j in range(self.STEPS):
                u = sensed[k * self.STEPS + j]
                x = np.array([x[0] + h * x[1] + 0.5 * h * h * u, x[1] + h * u])
            P = F @ P @ F.T + Q
            v[k], s[k] = seen[k + 1] - x[0], P[0, 0] + r
            gain = P[:, 0] / s[k]
            x = x + gain[:, None] * v[k]
            P = P - np.outer(gain, P[0])
            velocity[k, :2] = x[1]
        t = np.arange(1, n + 1) * 1_000_000_000
        axes = np.repeat(np.eye(3)[:2], n, axis=0)
        return Consistency.from_innovations(
            np.tile(t, 2), v.T.ravel(), np.tile(s, 2), signal=np.repeat(["x", "y"], n), kind="position",
            noise_var=np.full(2 * n, r) if noise_known else None, direction=axes, velocity_t_ns=t, velocity=velocity,
        )  # fmt: skip


def judged(
    epochs: Epochs, ep: EpochOut, out: RowModel, sv: I8, e: I8, gate_probability: float, pos_e: F8
) -> Consistency:
    """Consistency of the rows of a white filter, and of its positions against the true ones."""
    llh = geodetic_from_ecef(ep.pos)
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])[e]
    enu = np.stack(
        [
            np.cos(out.elevation) * np.sin(out.azimuth),
            np.cos(out.elevation) * np.cos(out.azimuth),
            np.sin(out.elevation),
        ],
        axis=1,
    )
    los = np.einsum("nji,nj->ni", C, enu)
    satellites, which = np.unique(sv, return_inverse=True)
    names = np.array([sv_name(int(s)) for s in satellites])[which]
    taken = out.status == ROW_USED
    known = (taken | (out.status == ROW_GATED)) & (e > 0)  # the first epoch is least squares
    both = taken & (out.rate_used == 1)
    gate = np.where(both, 2, 1)
    t = epochs.t_ns[e]
    two = np.concatenate
    return Consistency.from_innovations(
        two([t, t]),
        two([np.where(known, out.v_code, np.nan), np.where(known, out.v_rate, np.nan)]),
        two([np.where(known, out.s_code, np.nan), out.s_rate]),
        sv=two([names, names]),
        signal="1",
        kind=np.repeat(["code", "rate"], len(e)),
        used=two([taken, out.rate_used == 1]),
        noise_var=two([out.code_var, out.rate_var]),
        direction=two([-los, np.full_like(los, np.nan)]),
        gate=two([gate, gate]),
        gate_probability=gate_probability,
        velocity_t_ns=epochs.t_ns,
        velocity=ep.vel,
        solution=solution_of(epochs, ep),
        truth=Truth(pos_e, epochs.t_ns),
    )


def solution_of(epochs: Epochs, ep: EpochOut) -> Solution:
    """Positions of a run as the noun."""
    return Solution(
        t_ns=epochs.t_ns, status=ep.status, pos_e=ep.pos, vel_e=ep.vel, cov_pos=ep.cov_pos, cov_vel=ep.cov_vel,
        clock_m=ep.clock, drift_mps=ep.drift, clock_sigma_m=np.sqrt(ep.clock_var), clock_names=(), n_used=ep.n_used,
        dop=ep.dop, nis=ep.nis, dof=ep.dof,
    )  # fmt: skip


def _ranges(pos: F8, rows: Rows, e: I8) -> F8:
    p, s = pos[e], rows.sat_pos
    sagnac = OMEGA_E_GPS / C_LIGHT * (s[:, 0] * p[:, 1] - s[:, 1] * p[:, 0])
    return np.asarray(np.linalg.norm(s - p, axis=1) + sagnac)


def _rates(x: F8, rows: Rows, e: I8) -> F8:
    p, v, s, w = x[e, :3], x[e, 3:6], rows.sat_pos, rows.sat_vel
    u = s - p
    u /= np.linalg.norm(u, axis=1)[:, None]
    sagnac = w[:, 0] * p[:, 1] + s[:, 0] * v[:, 1] - w[:, 1] * p[:, 0] - s[:, 1] * v[:, 0]
    return np.asarray(np.einsum("ij,ij->i", u, w - v) + OMEGA_E_GPS / C_LIGHT * sagnac)
