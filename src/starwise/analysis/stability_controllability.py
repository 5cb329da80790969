"""Controllability by noise, and bounds of both Gramians over windows: the conditions of a stable Kalman filter.

Stochastic controllability asks whether process noise reaches every state: what it does not reach, the filter comes to
believe without limit and stops correcting. Over steps 1..N

    C = [ Phi_N .. Phi_2 Gamma_1 Q_1^1/2 ... Gamma_N Q_N^1/2 ],     Gramian  Y = C C'

Uniform complete observability and controllability (Kalman 1960; Jazwinski 1970, 7.5): for one window length and all
windows, a_1 I <= W <= a_2 I and b_1 I <= Y <= b_2 I with a_1, b_1 > 0. Then the filter is uniformly asymptotically
stable.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from starwise.analysis.observability import TOLERANCE, Direction, gramian, sparse_directions
from starwise.analysis.stability_system import LinearSystem
from starwise.types import F8, Layout


@dataclass(frozen=True)
class Controllability:
    """What the process noise of a window reaches.

    Attributes
    ----------
    layout : Layout
    first, count : int
    gramian : (n, n) float64
        Y, in the units of the states.
    singular : (n,) float64
        Singular values of C with rows of length 1, falling.
    rank : int
    tolerance, condition : float
    uncontrollable : tuple of Direction
        Combinations of states that no noise ever moves, as rows: their value is known for good once known.
    """

    layout: Layout
    first: int
    count: int
    gramian: F8
    singular: F8
    rank: int
    tolerance: float
    condition: float
    uncontrollable: tuple[Direction, ...]

    @property
    def controllable(self) -> bool:
        """Noise reaches every direction."""
        return self.rank == len(self.layout)

    @property
    def verdict(self) -> str:
        """``controllable`` or ``not controllable``."""
        return "controllable" if self.controllable else "not controllable"

    def explain(self) -> str:
        """Verdict and what it means, in words."""
        n = len(self.layout)
        if self.controllable:
            return f"controllable: noise of {self.count} steps reaches all {n} states, condition {self.condition:.2g}."
        what = "; ".join(d.name for d in self.uncontrollable)
        return (
            f"not controllable: rank {self.rank} of {n} over {self.count} steps. No process noise reaches {what}: the "
            f"filter's gain for it goes to zero, and an error of the model there is never corrected."
        )


@dataclass(frozen=True)
class UniformBounds:
    """Smallest and largest eigenvalue of a scaled Gramian over all windows of a length.

    Attributes
    ----------
    count : int
        Steps in a window.
    low, high : float
        a_1 and a_2 (b_1 and b_2).
    windows : int
    holds : bool
        ``low`` exceeds ``tolerance``^2 times ``high``.
    """

    count: int
    low: float
    high: float
    windows: int
    holds: bool


def controllability_matrix(system: LinearSystem) -> F8:
    """Matrix C of a system's steps (n, sum of ranks of Q): eq. 6 of the paper where Phi is constant."""
    blocks, M = [], np.eye(system.n)
    for s in reversed(system.steps):
        blocks.append(M @ _root(s.Q))
        M = M @ s.Phi
    return np.concatenate(blocks, axis=1)


def controllability(
    system: LinearSystem, first: int = 0, count: int | None = None, tolerance: float = TOLERANCE
) -> Controllability:
    """Stochastic controllability over ``count`` steps from ``first`` on; default: as many steps as states (eq. 6)."""
    n = system.n
    window = system.part(first, n if count is None else count)
    C = controllability_matrix(window)
    length = np.linalg.norm(C, axis=1)
    scale = np.where(length > 0.0, length, 1.0)
    U, s, _ = np.linalg.svd(C / scale[:, None], full_matrices=True)
    s = np.concatenate([s, np.zeros(n - len(s))])
    rank = int((s > tolerance * s[0]).sum()) if s[0] > 0.0 else 0
    # Rows y' with y' C = 0: combinations y' x; their coefficients scale inversely to the states.
    lost = U[:, rank:] / scale[:, None]
    return Controllability(
        layout=system.layout,
        first=first,
        count=len(window),
        gramian=np.asarray(C @ C.T),
        singular=s,
        rank=rank,
        tolerance=tolerance,
        condition=float(s[0] / s[-1]) if s[-1] > 0.0 else np.inf,
        uncontrollable=sparse_directions(lost, system.layout, 1.0 / scale, [0.0] * (n - rank)),
    )


def uniform_observability(
    system: LinearSystem, count: int, scale: F8, every: int = 1, tolerance: float = TOLERANCE
) -> UniformBounds:
    """Bounds a_1, a_2 of W, states in units of ``scale`` (n,), over all windows of ``count`` steps."""
    D = np.outer(scale, scale)
    return _bounds(
        (gramian(system.part(k, count)) * D for k in range(0, len(system) - count + 1, every)), count, tolerance
    )


def uniform_controllability(
    system: LinearSystem, count: int, scale: F8, every: int = 1, tolerance: float = TOLERANCE
) -> UniformBounds:
    """Bounds b_1, b_2 of Y, states in units of ``scale`` (n,), over all windows of ``count`` steps."""
    D = np.outer(scale, scale)

    def each() -> Iterable[F8]:
        for k in range(0, len(system) - count + 1, every):
            C = controllability_matrix(system.part(k, count))
            yield C @ C.T / D

    return _bounds(each(), count, tolerance)


def _bounds(gramians: Iterable[F8], count: int, tolerance: float) -> UniformBounds:
    values = [np.linalg.eigvalsh(G)[[0, -1]] for G in gramians]
    if not values:
        raise ValueError(f"the system has fewer than {count} steps")
    low, high = max(0.0, float(min(v[0] for v in values))), float(max(v[1] for v in values))
    return UniformBounds(count, low, high, len(values), low > tolerance**2 * high)


def _root(Q: F8) -> F8:
    """Factor G with G G' = Q for Q not negative, of rank Q's; scaled by the diagonal first."""
    d = np.sqrt(np.diag(Q))
    there = d > 0.0
    if not there.any():
        return np.zeros((len(Q), 1))
    d = np.where(there, d, 1.0)
    lam, V = np.linalg.eigh(Q / np.outer(d, d))
    keep = lam > 1e-14 * lam[-1]
    return np.asarray(d[:, None] * V[:, keep] * np.sqrt(lam[keep]))
