"""The flight, the satellites and the filters of the stability paper (Gao, Tan 2007), as linear systems."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from starwise.analysis.stability_system import LinearSystem, Step
from starwise.constants import C_LIGHT
from starwise.frames import C_ne_enu, ecef_from_geodetic
from starwise.kernels.process import SINGER, motion
from starwise.physics.earth import curvature_radii
from starwise.physics.rdss import GEO_RADIUS_M
from starwise.types import F8, Layout

PERIOD_S: Final = 0.25
DURATION_S: Final = 600.0
SATELLITES: Final = {3: (80.0, 140.0, 110.5), 2: (80.0, 140.0)}
"""Longitudes, deg E, of the geostationary satellites in use."""
NAMES: Final = (*(f"{kind}.{axis}" for kind in ("pos", "vel", "acc") for axis in "xyz"), "clk", "drift")
CLK: Final = 9
PLACE: Final = (40.0, 116.0, 10_000.0)
SPEED_MPS: Final = 1000.0 / 3.6
HEADING_DEG: Final = 45.0


@dataclass(frozen=True)
class Numbers:
    """Numbers of the filters: those of the paper, and those that it leaves open, chosen before any result was seen.

    Attributes
    ----------
    range_m, height_m, stability : float
        The paper's: pseudorange and height errors, clock stability (sigma of the drift over c).
    acceleration_mps2, tau_s : float
        Singer model, an airliner in cruise. Open.
    drift_tau_s : float
        Correlation time of the drift. Open.
    rate_mps, ins_mps2 : float
        Improved model: pseudorange rate and acceleration by inertial sensors. Open.
    sigma0 : tuple of float
        Standard deviations at the start: position, velocity, acceleration, clock bias (m). Open. The drift starts
        with its stationary sigma.
    """

    range_m: float = 10.0
    height_m: float = 40.0
    stability: float = 1e-10
    acceleration_mps2: float = 1.0
    tau_s: float = 20.0
    drift_tau_s: float = 3600.0
    rate_mps: float = 0.1
    ins_mps2: float = 0.02
    sigma0: tuple[float, float, float, float] = (100.0, 10.0, 1.0, 100.0)

    @property
    def drift_mps(self) -> float:
        """Stationary sigma of the clock drift, m/s."""
        return self.stability * C_LIGHT


@dataclass(frozen=True)
class Model:
    """A filter of the paper.

    Attributes
    ----------
    satellites : int
        2 or 3.
    improved : bool
        With pseudorange rates and accelerations of the inertial sensors.
    clock : bool
        The clock is estimated. Else the measurements have no clock error, and its two states stay in the state
        with a gain of zero, as in the paper.
    reduced : bool
        Those two states are taken out: 9 states.
    """

    satellites: int
    improved: bool = False
    clock: bool = True
    reduced: bool = False

    @property
    def name(self) -> str:
        """``plain``, ``plain_no_clock``, ``plain_9_states``, ``improved`` ..."""
        kind = "improved" if self.improved else "plain"
        return kind + ("" if self.clock else "_9_states" if self.reduced else "_no_clock")

    @property
    def layout(self) -> Layout:
        """Names of the states."""
        return Layout(NAMES[:CLK] if self.reduced else NAMES)


MODELS: Final = (Model(3), Model(2, clock=False), Model(3, improved=True), Model(2, improved=True))
"""The paper's four."""
BESIDE: Final = (Model(2, clock=False, reduced=True), Model(2))


@dataclass(frozen=True)
class Scene:
    """Level flight with a constant heading from a place, and everything that filters need to know along it.

    Attributes
    ----------
    latitude_deg : float
        Of the start; longitude, height, speed and heading are the paper's.
    numbers : Numbers
    duration_s : float
    """

    latitude_deg: float = PLACE[0]
    numbers: Numbers = Numbers()
    duration_s: float = DURATION_S

    @cached_property
    def t_s(self) -> F8:
        """Times of the filter's steps, s: the first one period after the start."""
        return np.asarray(PERIOD_S * np.arange(1, round(self.duration_s / PERIOD_S) + 1))

    @cached_property
    def llh(self) -> F8:
        """Latitude, longitude (rad) and height (m), from the start on: (N + 1, 3)."""
        h, heading = PLACE[2], math.radians(HEADING_DEG)
        out = np.empty((len(self.t_s) + 1, 3))
        lat, lon = math.radians(self.latitude_deg), math.radians(PLACE[1])
        for k in range(len(out)):
            out[k] = lat, lon, h
            # midpoint rule: 1e-6 m per step
            middle = lat + 0.5 * PERIOD_S * SPEED_MPS * math.cos(heading) / (float(curvature_radii(lat)[0]) + h)
            R_M, R_N = (float(r) for r in curvature_radii(middle))
            lat += PERIOD_S * SPEED_MPS * math.cos(heading) / (R_M + h)
            lon += PERIOD_S * SPEED_MPS * math.sin(heading) / ((R_N + h) * math.cos(middle))
        return out

    @cached_property
    def kinematics(self) -> tuple[F8, F8, F8]:
        """Position, velocity and acceleration, ECEF, (N, 3) each, at `t_s`; the last two by a spline."""
        from scipy.interpolate import CubicSpline

        pos = ecef_from_geodetic(self.llh)
        # about its middle: the numbers of a spline through 6e6 m would lose digits
        middle = pos[len(pos) // 2]
        curve = CubicSpline(np.concatenate([[0.0], self.t_s]), pos - middle)
        return np.asarray(pos[1:]), np.asarray(curve(self.t_s, 1)), np.asarray(curve(self.t_s, 2))

    def satellites(self, count: int) -> F8:
        """ECEF positions of the satellites, (count, 3), at rest."""
        lon = np.radians(SATELLITES[count])
        return np.asarray(GEO_RADIUS_M * np.stack([np.cos(lon), np.sin(lon), np.zeros(count)], axis=1))

    def transition(self, model: Model) -> tuple[F8, F8]:
        """Phi and Q of a model."""
        p, n = self.numbers, len(NAMES)
        F, G = np.empty((3, 3)), np.empty((3, 3))
        Phi, Q = np.zeros((n, n)), np.zeros((n, n))
        motion(SINGER, PERIOD_S, p.tau_s, F, G)
        Phi[:CLK, :CLK], Q[:CLK, :CLK] = np.kron(F, np.eye(3)), np.kron(G * p.acceleration_mps2**2, np.eye(3))
        # The drift is to the bias what a Singer acceleration is to the velocity.
        motion(SINGER, PERIOD_S, p.drift_tau_s, F, G)
        Phi[CLK:, CLK:], Q[CLK:, CLK:] = F[1:, 1:], G[1:, 1:] * p.drift_mps**2
        m = len(model.layout)
        return Phi[:m, :m], Q[:m, :m]

    def rows(self, model: Model) -> tuple[F8, F8]:
        """H (N, m, n) at the truth and the variances (m,) of pseudoranges, height, rates, accelerations."""
        p, (pos, vel, _) = self.numbers, self.kinematics
        s = self.satellites(model.satellites)
        N, k, n = len(pos), model.satellites, len(NAMES)
        line = s - pos[:, None]
        rho = np.linalg.norm(line, axis=2, keepdims=True)
        u = line / rho
        m = k + 1 + ((k + 3) if model.improved else 0)
        H = np.zeros((N, m, n))
        H[:, :k, 0:3] = -u
        lat, lon = self.llh[1:, 0], self.llh[1:, 1]
        H[:, k, 0:3] = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
        variances = [p.range_m**2] * k + [p.height_m**2]
        if model.clock:
            H[:, :k, CLK] = 1.0
        if model.improved:
            along = (u * vel[:, None]).sum(axis=2, keepdims=True)
            H[:, k + 1 : 2 * k + 1, 0:3] = (vel[:, None] - u * along) / rho
            H[:, k + 1 : 2 * k + 1, 3:6] = -u
            if model.clock:
                H[:, k + 1 : 2 * k + 1, CLK + 1] = 1.0
            H[:, 2 * k + 1 :, 6:9] = np.eye(3)
            variances += [p.rate_mps**2] * k + [p.ins_mps2**2] * 3
        return H[:, :, : len(model.layout)], np.array(variances)

    def P0(self, model: Model) -> F8:
        """Covariance at the start."""
        pos, vel, acc, clk = self.numbers.sigma0
        sigma = np.array([pos] * 3 + [vel] * 3 + [acc] * 3 + [clk, self.numbers.drift_mps])
        return np.diag(sigma[: len(model.layout)] ** 2)

    def system(self, model: Model) -> LinearSystem:
        """The model's matrices along the true flight."""
        Phi, Q = self.transition(model)
        H, R = self.rows(model)
        return LinearSystem(model.layout, tuple(Step(Phi, Q, h, R) for h in H), PERIOD_S)

    @property
    def C_ne(self) -> F8:
        """Rotation from ECEF to east, north, up at the start."""
        return C_ne_enu(float(self.llh[0, 0]), float(self.llh[0, 1]))
