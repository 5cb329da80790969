"""Motion of one axis for filters over position fixes: constant velocity and acceleration, Singer, "current" model.

State of an axis: position, velocity, acceleration, and where it is wanted a first-order Markov error eps of the fix.
The exact Phi and Q of the first three are those of `starwise.kernels.process.motion`. The "current" statistical model
(Zhou, Kumar 1984, J. Guidance 7(5), "A 'current' statistical model and adaptive algorithm for estimating maneuvering
targets") is Singer's with a mean:

    a' = -(a - a_mean) / tau + w,     w white with 2 sigma_a^2 / tau

    a_mean        = the predicted acceleration a_hat, so that the *state* is predicted with the constant-acceleration
                    Phi_1: Phi x + U a_mean = Phi_1 x when a_mean = a_hat
    sigma_a^2     = (4 - pi) / pi (a_max - |a_hat|)^2, the variance of a Rayleigh density between a_hat and a_max

The *covariance* is predicted with Singer's Phi and Q, Q scaled by the adaptive variance.
"""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.process import ACCELERATION, CURRENT, SINGER, STATIC, VELOCITY, motion

F8 = NDArray[np.float64]

__all__ = ["ACCELERATION", "CURRENT", "SINGER", "STATIC", "VELOCITY"]


@njit
def axis_motion(kind: int, dt: float, tau: float, Phi: F8, Phi_1: F8, G: F8) -> None:
    """Transition of the covariance Phi, of the state Phi_1, and unit noise G, (3, 3) each, of one axis over ``dt`` s.

    They differ for the "current" model only: Phi_1 is then that of constant acceleration. G is for unit spectral
    density of the driving noise; Singer and "current": for unit variance of the acceleration.
    """
    motion(kind, dt, tau, Phi, G)
    for i in range(3):
        for j in range(3):
            Phi_1[i, j] = Phi[i, j]
    if kind == CURRENT:
        Phi_1[0, 1] = Phi_1[1, 2] = dt
        Phi_1[0, 2] = 0.5 * dt * dt
        Phi_1[2, 2] = 1.0


@njit
def current_variance(a_hat: float, a_max: float) -> float:
    """Adaptive variance of the acceleration, m^2/s^4: (4 - pi) / pi (a_max - |a_hat|)^2.

    Beyond a_max the square would grow again; it stays zero there, as the density has no room left.
    """
    room = a_max - abs(a_hat)
    return 0.0 if room <= 0.0 else (4.0 - math.pi) / math.pi * room * room


@njit
def mean_input(dt: float, tau: float, U: F8) -> None:
    """Response U (3,) of position, velocity and acceleration to a unit mean acceleration over ``dt`` s.

    Law: Phi x + U a_hat = Phi_1 x, for x = (p, v, a_hat).
    """
    z = dt / tau
    e = -math.expm1(-z)
    # dt^2 / 2 - tau^2 (z - 1 + e^-z) and its derivatives; series where the terms cancel
    if z > 0.3:
        U[0] = 0.5 * dt * dt - tau * tau * (z - e)
        U[1] = dt - tau * e
    else:
        term, first, second = dt * z / 2.0, 0.0, 0.0
        for k in range(2, 18):
            first += term
            second += term * dt / (k + 1.0)
            term *= -z / (k + 1.0)
        U[0], U[1] = second, first
    U[2] = e


@njit
def markov(dt: float, tau: float) -> tuple[float, float]:
    """Transition e^(-dt / tau) of a first-order Markov error, and the variance that a unit process gains over dt."""
    return math.exp(-dt / tau), -math.expm1(-2.0 * dt / tau)
