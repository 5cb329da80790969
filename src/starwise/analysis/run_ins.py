"""Linear systems of a finished inertial run: its 15 error states, out of the solution's own attitude and motion.

The readings are not in a result; what their errors do to the navigation is. Attitude is that of the solution, specific
force follows from its velocities, f = dv/dt + 2 omega_ie x v - g, and both with the numbers of the sensors in
``run.json`` make Phi and Q (`starwise.kernels.ins_error.phi_q15`). States, north, east, down: attitude, velocity,
position, biases of gyroscopes and accelerometers in the declared axes; with satellites (tight) also clocks.

Measurements are those of the ledger (tight), or positions and velocities of the fixes (loose) with the sigmas that they
claim; and, where it was on, the constraint of the unsteered axle. Left out: vibration (noise that follows the
readings), states of the mount, the lever arm, scale factors and of constant parts of the biases, zero velocity at rest,
and smoothing: the system is that of the filter that goes forward.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.analysis.run_table import RunTable, run_table
from starwise.analysis.run_window import CODE, OTHER, RATE, RunStep, RunWindow
from starwise.config import RunConfig
from starwise.config_inertial import InertialConfig
from starwise.constants import EPOCH_OK, OMEGA_E_GPS
from starwise.errors import StarwiseError
from starwise.frames import C_ne_enu, geodetic_from_ecef, rotations_ne_enu
from starwise.models.process import Clocks, Motion, clocks_from, matrices
from starwise.physics.earth import gravity_e
from starwise.types import F8, Fixes, Layout, Solution

DPH: Final = math.radians(1.0) / 3600.0
UG: Final = 9.80665e-6
STEP_S: Final = 0.25
"""Longest step of the series that makes Phi, s."""
START_POSITION_M: Final = 100.0
START_VELOCITY_MPS: Final = 10.0
NED: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""North, east, down from east, north, up."""
NAMES: Final = tuple(
    [f"{s}.{a}" for s in ("att", "vel", "pos") for a in "ned"] + [f"{s}.{a}" for s in ("bg", "ba") for a in "xyz"]
)
ATT, VEL, POS = slice(0, 3), slice(3, 6), slice(6, 9)


@dataclass(frozen=True)
class InertialSystem:
    """A finished inertial run as a source of linear systems; used like `starwise.analysis.run_system.RunSystem`.

    Attributes
    ----------
    solution : Solution
    run : RunConfig
    config : InertialConfig
    table : RunTable or None
        Satellites (tight).
    fixes : Fixes or None
        Fixes (loose).
    notes : tuple of str
    """

    solution: Solution
    run: RunConfig
    config: InertialConfig
    table: RunTable | None
    fixes: Fixes | None
    notes: tuple[str, ...] = field(default=())
    memoryless: bool = False
    moving: bool = True

    @classmethod
    def of(cls, solution: Solution, fixes: Fixes | None = None) -> "InertialSystem":
        """System of an inertial run.

        Parameters
        ----------
        solution : Solution
        fixes : Fixes, optional
            Of a run with fixes: their sigmas are not in the result.

        Raises
        ------
        StarwiseError
            What was measured is not known.
        """
        given: dict[str, Any] = dict(solution.provenance["config"])
        inertial = given.pop("inertial")
        method = given.pop("method", "loose")
        chosen = InertialConfig.from_dict(inertial, prefix="inertial.")
        run = RunConfig.from_dict({k: v for k, v in given.items() if v is not None})
        if not {"roll_deg", "pitch_deg", "yaw_deg"} <= set(solution.extra) or solution.n_epochs < 3:
            raise StarwiseError("no attitude in this solution", wanted="the result of solve --imu")
        notes = ["inertial: vibration, mount, lever arm and scale states and rest are left out"]
        notes += ["smoothed: the system is that of the forward filter"] if chosen.smooth else []
        table = None
        if method == "tight":
            table = run_table(solution, run.with_options({"error_model": "white", "combination": _combination(run)}))
        elif fixes is None:
            sigma = chosen.fix_sigma_m
            if not sigma > 0.0:
                raise StarwiseError(
                    "an inertial run with fixes whose sigmas are not known here",
                    wanted="the fixes where run.json says they are, or inertial.fix_sigma_m",
                )
            fixes = _claimed(solution, sigma, chosen.velocity_sigma_mps)
        return cls(solution, run, chosen, table, fixes, tuple(notes))

    @cached_property
    def measured(self) -> NDArray[np.intp]:
        """Epochs at which something aided."""
        return np.flatnonzero((self.solution.status == EPOCH_OK) & self.solution.has_position)

    @property
    def systems(self) -> str:
        """Letters of the systems of which satellites were used (tight)."""
        return "" if self.table is None else "".join(self.table.clock_names)

    def longest_stretch(self) -> tuple[int, int]:
        """First aided epoch and the number of epochs from there on."""
        if not len(self.measured):
            raise StarwiseError("no epoch of the run was aided")
        first = int(self.measured[0])
        return first, self.solution.n_epochs - first

    def window(self, first: int, count: int) -> RunWindow:
        """Epochs from ``first`` on as a linear system that begins anew."""
        return self.changed(first, count)

    def changed(self, first: int, count: int, *, rates: bool | None = None, without: str = "") -> RunWindow:
        """The same with or without Doppler (velocities of fixes), and without some systems (letters)."""
        s = self.solution
        last = min(first + count, s.n_epochs)
        letters = list(self.table.clock_names) if self.table is not None else []
        letters = [x for x in letters if x not in without]
        steps = []
        for k in range(first, last):
            Phi, Q = self._transition(max(k - 1, first), k, len(letters))
            H, r, kind, sv = self._rows(k, letters, rates)
            none = np.zeros((len(r), 0))
            steps.append(RunStep(int(s.t_ns[k]), Phi, Q, np.zeros(0), H, none, r, np.zeros(len(r)), kind, sv))
        clocks = [f"{'clk' if i == 0 else 'isb'}.{x}" for i, x in enumerate(letters)]
        drifts = [f"{'drift' if i == 0 else 'isd'}.{x}" for i, x in enumerate(letters)]
        return RunWindow(Layout((*NAMES, *clocks, *drifts)), (), self._prior(first, len(letters)), tuple(steps), first)

    @cached_property
    def _geometry(self) -> tuple[F8, F8, F8, F8]:
        """Latitude, longitude, height (n, 3); velocity (n, 3) NED; specific force (n, 3) NED; C_nb (n, 3, 3)."""
        s = self.solution
        llh = geodetic_from_ecef(s.pos_e)
        turn = NED @ rotations_ne_enu(llh[:, 0], llh[:, 1])
        t = (s.t_ns - s.t_ns[0]) * 1e-9
        coriolis = 2.0 * np.cross([0.0, 0.0, OMEGA_E_GPS], s.vel_e)
        force = np.gradient(s.vel_e, t, axis=0) + coriolis - gravity_e(s.pos_e)
        v, f = (turn @ s.vel_e[:, :, None])[:, :, 0], (turn @ force[:, :, None])[:, :, 0]
        e = s.extra
        rpy = np.radians(np.stack([e["roll_deg"], e["pitch_deg"], e["yaw_deg"]], axis=1))
        return llh, v, f, _dcm(rpy)

    def _transition(self, before: int, k: int, nc: int) -> tuple[F8, F8]:
        """Phi and Q from one epoch to the next, all states."""
        from starwise.kernels.ins_error import phi_q15

        llh, v, force, C = self._geometry
        n = 15 + 2 * nc
        Phi, Q = np.eye(n), np.zeros((n, n))
        dt = (int(self.solution.t_ns[k]) - int(self.solution.t_ns[before])) * 1e-9
        if not dt > 0.0:
            return Phi, Q
        g, a = self.config.gyro, self.config.accel
        nav = np.zeros(10)
        nav[4:7], nav[7:10] = 0.5 * (v[before] + v[k]), 0.5 * (llh[before] + llh[k])
        f = 0.5 * (force[before] + force[k])
        gyro = np.full(3, (math.radians(g.white_dprh) / 60.0) ** 2)
        accel = np.full(3, (a.white_mpsrh / 60.0) ** 2)
        pieces = max(1, math.ceil(dt / STEP_S))
        A, B = np.empty((15, 15)), np.empty((15, 15))
        phi_q15(
            nav, f[0], f[1], f[2], np.ascontiguousarray(C[k]), dt / pieces, gyro, accel, g.in_run_tau_s,
            a.in_run_tau_s, np.full(3, g.in_run_dph * DPH), np.full(3, a.in_run_ug * UG), A, B,
        )  # fmt: skip
        P15, Q15 = np.eye(15), np.zeros((15, 15))
        for _ in range(pieces):
            P15, Q15 = A @ P15, A @ Q15 @ A.T + B
        Phi[:15, :15], Q[:15, :15] = P15, Q15
        if nc:
            F, W = matrices(Motion("static", 0.0, 0.0), self._clocks, nc, dt)
            T = _differences(nc)
            Phi[15:, 15:], Q[15:, 15:] = F[3:, 3:], T @ W[3:, 3:] @ T.T
        return Phi, Q

    @cached_property
    def _clocks(self) -> Clocks:
        return clocks_from(self.run)

    def _rows(
        self, k: int, letters: list[str], rates: bool | None
    ) -> tuple[F8, F8, NDArray[np.int64], NDArray[np.int16]]:
        """Measurement matrix, variances, kinds and satellites of an epoch."""
        llh, v, _, C = self._geometry
        n, nc = 15 + 2 * len(letters), len(letters)
        arm = C[k] @ np.asarray(self.config.lever_arm_m)
        H: list[F8] = []
        r: list[float] = []
        kind: list[int] = []
        sv: list[int] = []
        if self.table is not None:
            table = self.table
            for i in range(table.offsets[k], table.offsets[k + 1]):
                letter = table.clock_names[table.clock[i]] if table.clock[i] >= 0 else ""
                if letter not in letters or not table.used[i, 0]:
                    continue
                at, u = letters.index(letter), NED @ table.direction[i]
                row = np.zeros(n)
                row[POS], row[ATT] = -u, -u @ -_cross(arm)
                row[15] = row[15 + at] = 1.0
                H, r, kind, sv = [*H, row], [*r, table.white[i, 0]], [*kind, CODE], [*sv, table.sv[i]]
                if table.used[i, 2] if rates is None else rates:
                    row = np.zeros(n)
                    row[VEL] = -u
                    row[15 + nc] = row[15 + nc + at] = 1.0
                    H, r, kind, sv = [*H, row], [*r, table.white[i, 2]], [*kind, RATE], [*sv, table.sv[i]]
        elif self.fixes is not None and self.solution.status[k] == EPOCH_OK:
            fix = int(np.abs(self.fixes.t_ns - self.solution.t_ns[k]).argmin())
            turn = NED @ C_ne_enu(llh[k, 0], llh[k, 1])
            position = np.diag(turn @ self.fixes.cov_pos[fix] @ turn.T)
            for axis in range(3):
                row = np.zeros(n)
                row[POS.start + axis], row[ATT] = 1.0, -_cross(arm)[axis]
                H, r, kind, sv = [*H, row], [*r, max(position[axis], 1e-4)], [*kind, OTHER], [*sv, -1]
            known = self.fixes.cov_vel is not None and bool(np.isfinite(self.fixes.cov_vel[fix]).all())
            if (known and self.config.use_velocity) if rates is None else rates:
                velocity = np.full(3, 0.1**2)
                if known and self.fixes.cov_vel is not None:
                    velocity = np.diag(turn @ self.fixes.cov_vel[fix] @ turn.T)
                for axis in range(3):
                    row = np.zeros(n)
                    row[VEL.start + axis] = 1.0
                    H, r, kind, sv = [*H, row], [*r, max(velocity[axis], 4e-4)], [*kind, RATE], [*sv, -1]
        if self.config.vehicle.constraint:
            to_body, turned = C[k].T, C[k].T @ _cross(v[k])
            spread = math.sqrt(max(1.0, self.config.vehicle.interval_s / max(self._interval_s, 1e-3)))
            for axis, sigma in ((1, self.config.vehicle.slip_sigma_mps), (2, self.config.vehicle.bounce_sigma_mps)):
                row = np.zeros(n)
                row[VEL], row[ATT] = to_body[axis], turned[axis]
                H, r, kind, sv = [*H, row], [*r, (sigma * spread) ** 2], [*kind, OTHER], [*sv, -1]
        return (
            np.array(H).reshape(-1, n), np.array(r, dtype=np.float64), np.array(kind, dtype=np.int64),
            np.array(sv, dtype=np.int16),
        )  # fmt: skip

    @cached_property
    def _interval_s(self) -> float:
        return float(np.median(np.diff(self.solution.t_ns))) * 1e-9

    def _prior(self, first: int, nc: int) -> F8:
        """Covariance of a start: attitude as the alignment had it, sensors as declared."""
        e = self.solution.extra
        start = int(np.flatnonzero(self.solution.has_position)[0])
        tilt = [float(np.radians(e[f"sigma_{name}_deg"][start])) for name in ("roll", "pitch", "yaw")]
        d = np.empty(15)
        d[ATT] = np.maximum(np.nan_to_num(tilt, nan=0.1), 1e-4)
        d[VEL], d[POS] = START_VELOCITY_MPS, START_POSITION_M
        d[9:12], d[12:15] = self.config.gyro.bias_dph * DPH, self.config.accel.bias_ug * UG
        for axis in range(3):  # what rest before the start has told
            for place, name, unit in ((9, "gyro_bias_{}_dph", DPH), (12, "accel_bias_{}_mps2", 1.0)):
                known = e.get("sigma_" + name.format("xyz"[axis]))
                if known is not None and np.isfinite(known[start]):
                    d[place + axis] = known[start] * unit
        P = np.zeros((15 + 2 * nc, 15 + 2 * nc))
        P[range(15), range(15)] = d**2
        if nc:
            c, own, T = self._clocks, np.eye(nc), _differences(nc)
            W = np.zeros((2 * nc, 2 * nc))
            W[:nc, :nc] = 1e6 + c.intersystem_sigma0**2 * own
            W[nc:, nc:] = c.drift_sigma0**2 + c.intersystem_drift_sigma0**2 * own
            P[15:, 15:] = T @ W @ T.T
        return P


def _combination(run: RunConfig) -> str:
    return "single" if run.combination in ("uncombined", "auto") else run.combination


def _differences(nc: int) -> F8:
    T = np.eye(2 * nc)
    T[1:nc, 0] = -1.0
    T[nc + 1 :, nc] = -1.0
    return T


def _cross(v: F8) -> F8:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _dcm(rpy: F8) -> F8:
    """C_nb (n, 3, 3) of roll, pitch, yaw (n, 3), rad (Groves 2.22)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy).T, np.cos(rpy).T
    return np.stack(
        [
            np.stack([cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy], axis=-1),
            np.stack([cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy], axis=-1),
            np.stack([-sp, sr * cp, cr * cp], axis=-1),
        ],
        axis=-2,
    )


def _claimed(solution: Solution, sigma_m: float, sigma_mps: float) -> Fixes:
    """Fixes at the aided epochs with the sigmas of the configuration."""
    at = solution.status == EPOCH_OK
    t = solution.t_ns[at]
    cov = np.broadcast_to(sigma_m**2 * np.eye(3), (len(t), 3, 3))
    velocity = np.broadcast_to(sigma_mps**2 * np.eye(3), (len(t), 3, 3)) if sigma_mps > 0.0 else None
    return Fixes(t, t, solution.pos_e[at], cov, solution.vel_e[at], velocity)
