"""Motion of one axis for filters over position fixes, and banks of such motions: what they believe, and why.

The same classes of motion serve any filter that takes Phi and Q (`starwise.estimators.ekf.predict`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from starwise.errors import StarwiseError
from starwise.kernels.imm import Bank
from starwise.kernels.maneuver import (
    ACCELERATION,
    CURRENT,
    SINGER,
    VELOCITY,
    axis_motion,
    current_variance,
    markov,
)
from starwise.types import F8

KINDS: Final = {"velocity": VELOCITY, "acceleration": ACCELERATION, "singer": SINGER, "current": CURRENT}


@dataclass(frozen=True)
class AxisMotion:
    """Motion of one axis, x' = v and one of these models.

        velocity      v' = w                                  w: `strength`, m^2/s^3
        acceleration  v' = a, a' = w                          w: `strength`, m^2/s^5
        singer        v' = a, a' = -a / tau + w               `strength`: variance of a, m^2/s^4
        current       v' = a, a' = -(a - a_mean) / tau + w    a_mean: predicted; variance (4 - pi)/pi (a_max - |a|)^2

    and, if it has one, a first-order Markov error eps of the fix: eps' = -eps / eps_tau + w.

    Laws: Phi(c, b) Phi(b, a) = Phi(c, a), Q(c, a) = Phi(c, b) Q(b, a) Phi(c, b)' + Q(c, b); the state of the "current"
    model is predicted with constant acceleration, Phi x + U a_hat = Phi_1 x.

    Attributes
    ----------
    model : str
        A key of `KINDS`.
    strength : float
        Units above; "current": variance while `a_max` is zero.
    tau_s : float
        Correlation time of the acceleration, s.
    a_max : float
        "current": largest acceleration, m/s^2; zero: the variance is `strength`.
    eps_sigma, eps_tau_s : float
        Markov error: standard deviation, m (zero: none), and correlation time, s.
    """

    model: str
    strength: float
    tau_s: float = 1.0
    a_max: float = 0.0
    eps_sigma: float = 0.0
    eps_tau_s: float = 1.0

    def __post_init__(self) -> None:
        if self.model not in KINDS:
            raise StarwiseError("no such model of motion", found=self.model, wanted=" | ".join(KINDS))
        if self.strength < 0.0 or self.tau_s <= 0.0 or self.eps_tau_s <= 0.0 or self.eps_sigma < 0.0:
            raise StarwiseError("a time or a strength of the motion is negative", found=repr(self))

    @property
    def order(self) -> int:
        """Kinematic states: 2 or 3."""
        return 2 if self.model == "velocity" else 3

    @property
    def n(self) -> int:
        """States: position, velocity [, acceleration] [, eps]."""
        return self.order + (self.eps_sigma > 0.0)

    def noise_strength(self, a_hat: float = 0.0) -> float:
        """Strength of the driving noise where the acceleration is estimated as ``a_hat``, m/s^2."""
        if self.model == "current" and self.a_max > 0.0:
            return current_variance(a_hat, self.a_max)
        return self.strength

    def matrices(self, dt_s: float, a_hat: float = 0.0) -> tuple[F8, F8, F8]:
        """Phi of the covariance, Phi_1 of the state and Q over ``dt_s``, (n, n) each, exact.

        Parameters
        ----------
        dt_s : float
            s, not negative.
        a_hat : float
            Estimated acceleration ("current" with `a_max`), m/s^2.
        """
        F, F1, G = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
        axis_motion(KINDS[self.model], dt_s, self.tau_s, F, F1, G)
        n, k = self.n, self.order
        Phi, Phi_1, Q = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
        Phi[:k, :k], Phi_1[:k, :k] = F[:k, :k], F1[:k, :k]
        Q[:k, :k] = self.noise_strength(a_hat) * G[:k, :k]
        if n > k:
            decay, gained = markov(dt_s, self.eps_tau_s)
            Phi[k, k] = Phi_1[k, k] = decay
            Q[k, k] = self.eps_sigma**2 * gained
        return Phi, Phi_1, Q

    def driving(self, a_hat: float = 0.0) -> tuple[F8, F8]:
        """The continuous model about its mean: x' = A x + w with spectral density W, (n, n) each."""
        n, k = self.n, self.order
        A, W = np.zeros((n, n)), np.zeros((n, n))
        A[np.arange(k - 1), np.arange(1, k)] = 1.0
        W[k - 1, k - 1] = self.noise_strength(a_hat)
        if self.model in ("singer", "current"):
            A[k - 1, k - 1] = -1.0 / self.tau_s
            W[k - 1, k - 1] *= 2.0 / self.tau_s
        if n > k:
            A[k, k] = -1.0 / self.eps_tau_s
            W[k, k] = 2.0 * self.eps_sigma**2 / self.eps_tau_s
        return A, W


@dataclass(frozen=True)
class Maneuvers:
    """Bank of hypotheses: cruise at constant velocity, or one of several manoeuvre modes (Singer).

    Chosen for aircraft by what they do, then checked to be insensitive: half as much again in any number changes the
    steady error of the reproduced flight by a tenth at most.

    Attributes
    ----------
    cruise_psd : float
        White acceleration of cruise, m^2/s^3: what moves the velocity by 0.1 m/s in 1000 s.
    tau_s, sigma_mps2 : tuple of float
        Manoeuvre modes: a change of speed or a shallow turn (3 m/s^2), a hard turn (15 m/s^2, 3 g at two sigma).
    cruise_s, maneuver_s, mode_s : float
        Mean durations of a cruise, of a manoeuvre, and of a mode within it, s.
    branches : int
        Cruise branches: times at which the manoeuvre may have ended.
    velocity_sigma0 : float
        m/s, at the start.
    scale_window : float
        Epochs over which the noise of the fixes is scaled from the differences of the receivers; 0: never.
    most_inflation : float
        Limit of the factor on variances that makes up for errors correlated in time; 1: taken as white.
    gate : float
        Chi-square threshold (3 dof) by which a receiver must not contradict the others; infinite: all are believed.
    """

    cruise_psd: float = 1e-5
    tau_s: tuple[float, ...] = (30.0, 10.0)
    sigma_mps2: tuple[float, ...] = (3.0, 15.0)
    cruise_s: float = 20.0
    maneuver_s: float = 33.0
    mode_s: float = 33.0
    branches: int = 4
    velocity_sigma0: float = 300.0
    scale_window: float = 100.0
    most_inflation: float = 20.0
    gate: float = np.inf

    def __post_init__(self) -> None:
        if not self.tau_s or len(self.tau_s) != len(self.sigma_mps2) or self.branches < 1:
            raise StarwiseError("a bank has one or more manoeuvre modes and cruise branches", found=repr(self))

    def numbers(self) -> Bank:
        """The same as plain numbers for kernels."""
        return Bank(
            cruise_psd=self.cruise_psd,
            tau_s=np.array(self.tau_s, dtype=np.float64),
            sigma=np.array(self.sigma_mps2, dtype=np.float64),
            start_rate=1.0 / self.cruise_s,
            end_rate=1.0 / self.maneuver_s,
            switch_rate=1.0 / self.mode_s,
            branches=self.branches,
            velocity_sigma0=self.velocity_sigma0,
            scale_window=self.scale_window,
            scale_prior=5.0,
            most_inflation=self.most_inflation,
            gate=self.gate,
        )


BANKS: Final[dict[str, Maneuvers]] = {
    "aircraft": Maneuvers(),
    # Cars: straight or at rest for tens of seconds; braking and cornering around 1 m/s^2, seldom 4, for some seconds.
    "vehicle": Maneuvers(
        cruise_psd=1e-3, tau_s=(5.0, 3.0), sigma_mps2=(0.7, 3.0), cruise_s=15.0, maneuver_s=8.0, mode_s=8.0,
        velocity_sigma0=30.0,
    ),
    # Walking: turning back (2.8 m/s) takes about 2 s.
    "pedestrian": Maneuvers(
        cruise_psd=1e-3, tau_s=(3.0, 1.0), sigma_mps2=(0.2, 1.0), cruise_s=15.0, maneuver_s=8.0, mode_s=8.0,
        velocity_sigma0=2.0,
    ),
    # At rest: the fixes' errors wander, and nothing else does.
    "static": Maneuvers(
        cruise_psd=1e-10, tau_s=(100.0,), sigma_mps2=(1e-3,), cruise_s=3600.0, maneuver_s=100.0, branches=3,
        velocity_sigma0=1e-2,
    ),
}  # fmt: skip
"""Banks by the word of `RunConfig.dynamics`."""
