"""Steady state of a time-invariant Kalman filter: the discrete algebraic Riccati equation (DARE).

Sources: Anderson, Moore (1979) "Optimal filtering", 4.4; Bar-Shalom, Li, Kirubarajan (2001) 5.2.5.
"""

from dataclasses import dataclass

import numpy as np

from starwise.analysis.stability_system import Step
from starwise.types import F8


@dataclass(frozen=True)
class SteadyState:
    """Where a time-invariant filter goes.

    Attributes
    ----------
    before, P : (n, n) float64
        Covariance before and after the measurements.
    K : (n, m) float64
    Psi : (n, n) float64
    spectral_radius : float
        Of Psi.
    """

    before: F8
    P: F8
    K: F8
    Psi: F8
    spectral_radius: float


def spectral_radii(A: F8) -> F8:
    """Largest absolute eigenvalue of each matrix (..., n, n)."""
    return np.asarray(np.abs(np.linalg.eigvals(A)).max(axis=-1))


def dare(step: Step) -> F8:
    """Steady-state covariance *before* the measurements, (n, n): the stabilising solution of the DARE.

        P = Phi (P - P H' (H P H' + R)^-1 H P) Phi' + Q

    Raises
    ------
    ValueError
        There is none: an unstable or constant part is not observable, or one on the unit circle has no noise.
    """
    from scipy.linalg import solve_discrete_are

    try:
        P = solve_discrete_are(step.Phi.T, step.H.T, step.Q, step.R_full)
    except np.linalg.LinAlgError as error:
        raise ValueError(f"no steady state: {error}") from None
    for _ in range(3):  # the last digits
        P = _riccati(step, P)
    K = _gain(step, P)
    Psi = (np.eye(len(P)) - K @ step.H) @ step.Phi
    if not float(spectral_radii(Psi)) < 1.0:
        raise ValueError("no steady state: its filter is not asymptotically stable")
    return np.asarray(P)


def steady_state(step: Step) -> SteadyState:
    """Steady state of a time-invariant filter, by the DARE.

    Raises
    ------
    ValueError
        There is none.
    """
    before = dare(step)
    K = _gain(step, before)
    A = np.eye(len(before)) - K @ step.H
    P = A @ before @ A.T + K @ step.R_full @ K.T
    return SteadyState(before, 0.5 * (P + P.T), K, A @ step.Phi, float(spectral_radii(A @ step.Phi)))


def _gain(step: Step, before: F8) -> F8:
    return np.asarray(np.linalg.solve(step.H @ before @ step.H.T + step.R_full, step.H @ before).T)


def _riccati(step: Step, before: F8) -> F8:
    K = _gain(step, before)
    A = np.eye(len(before)) - K @ step.H
    P = step.Phi @ (A @ before @ A.T + K @ step.R_full @ K.T) @ step.Phi.T + step.Q
    return np.asarray(0.5 * (P + P.T))
