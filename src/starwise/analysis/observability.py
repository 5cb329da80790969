"""Observability: which combinations of states a window of measurements sees, how well, and which not at all.

The measurements of a window in units of their noise, as functions of the state x at its beginning:

    O = [ L_1^-1 H_1 Phi_1 ;  L_2^-1 H_2 Phi_2 Phi_1 ; ... ],   R_k = L_k L_k',      Gramian  W = O' O = sum

W is the information that the window alone has about x (no process noise, no prior). Metres and radians do not
compare: states are scaled first, by their prior sigmas where these are known (an eigenvalue of 1 is then a direction
that the window knows as well as the prior did), else so that every column of O has length 1. Ranks and null spaces
come from the singular values of O itself: W has their squares, and loses half of the digits.

Sources: Kalman (1960); Jazwinski (1970) 7.5; Gao, Tan (2007) eq. 8-12; Tichavsky, Muravchik, Nehorai (1998) (the
Cramer-Rao bound of a filter).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from starwise.analysis.stability_system import LinearSystem
from starwise.types import F8, Layout

TOLERANCE: Final = 1e-6
"""Directions seen less than this part of the best seen one (both scaled) count as not seen: noise times a million."""
SHOWN: Final = 0.05
"""Part of the largest component, scaled, below which a state is left out of a direction's name."""
Observable = Literal["observable", "weakly observable", "not observable"]


@dataclass(frozen=True)
class Direction:
    """A combination of states.

    Attributes
    ----------
    vector : (n,) float64
        In the units of the states; the leading one has coefficient 1.
    name : str
        Like ``clk.G + 0.64 pos.u``.
    strength : float
        Singular value of the scaled observability (or controllability) matrix along it; 0: not seen at all.
    """

    vector: F8
    name: str
    strength: float


@dataclass(frozen=True)
class WindowObservability:
    """What a window of measurements says about the state at its beginning.

    Laws: W is symmetric, not negative, and adds over windows; ranks and directions do not depend on units.

    Attributes
    ----------
    layout : Layout
    first, count : int
        The window's first step and its number of steps.
    gramian : (n, n) float64
        W, in the units of the states.
    scale : (n,) float64
        Unit of each state: its prior sigma, or what makes columns comparable.
    singular : (n,) float64
        Singular values of the scaled O, falling.
    rank : int
        How many of them exceed ``tolerance`` times the first.
    condition : float
        First over last; infinite if the last is 0.
    unobservable : tuple of Direction
        A basis, as sparse as elimination makes it, of what is not seen.
    weakest : Direction
        The direction seen least, whether seen or not.
    prior : bool
        ``scale`` is the prior.
    sigma_ratio : (n,) float64
        sigma of each state after the window over before it, by prior and W alone (without prior: NaN).
    """

    layout: Layout
    first: int
    count: int
    gramian: F8
    scale: F8
    singular: F8
    rank: int
    tolerance: float
    condition: float
    unobservable: tuple[Direction, ...]
    weakest: Direction
    prior: bool
    sigma_ratio: F8

    @property
    def informative(self) -> int:
        """Number of directions about which the window says more than the prior; with no prior the rank."""
        return int((self.singular >= 1.0).sum()) if self.prior else self.rank

    @property
    def verdict(self) -> Observable:
        """Weakly: of full rank, but a direction remains about which the window says less than the prior did."""
        if self.rank < len(self.layout):
            return "not observable"
        return "observable" if self.informative == len(self.layout) else "weakly observable"

    def explain(self) -> str:
        """Verdict, reason and what would help, in words."""
        n = len(self.layout)
        if self.unobservable:
            what = "; ".join(d.name for d in self.unobservable)
            return (
                f"not observable: rank {self.rank} of {n} over {self.count} steps. A shift of the state along {what} "
                "changes no measurement of the window: the filter cannot correct it, and its sigma there is the "
                "prior's. Another satellite or sensor that sees it is needed, or motion over a longer window."
            )
        text = f"{self.verdict}: rank {n} of {n} over {self.count} steps, condition {self.condition:.2g}"
        if self.verdict == "weakly observable":
            text += (
                f". The window adds to {self.informative} directions; about {self.weakest.name} it says "
                f"{self.weakest.strength:.2g} of what the prior did"
            )
        return text + f"; seen least: {self.weakest.name}."


def observability_matrix(system: LinearSystem) -> F8:
    """Matrix O of a system's steps, rows in units of their noise, (sum of m, n)."""
    blocks, M = [], np.eye(system.n)
    for s in system.steps:
        M = s.Phi @ M
        blocks.append(s.whitened() @ M)
    return np.concatenate(blocks)


def gramian(system: LinearSystem) -> F8:
    """Observability Gramian W = O' O of a system's steps, (n, n)."""
    O = observability_matrix(system)  # noqa: E741 - its name in every textbook
    return np.asarray(O.T @ O)


def observability(
    system: LinearSystem,
    first: int = 0,
    count: int | None = None,
    *,
    prior: F8 | None = None,
    scale: F8 | None = None,
    tolerance: float = TOLERANCE,
) -> WindowObservability:
    """Observability over the window of ``count`` steps from ``first`` on; default: from ``first`` to the end.

    Parameters
    ----------
    system : LinearSystem
    first, count : int
    prior : (n, n) array, optional
        Covariance of the state before the window: scale, and what the window is compared with.
    scale : (n,) array, optional
        Units of the states in place of the prior sigmas.
    tolerance : float
        Of the rank, on singular values, against the largest.
    """
    window = system.part(first, len(system) if count is None else count)
    return seen_by(
        observability_matrix(window), system.layout, first, len(window), prior=prior, scale=scale, tolerance=tolerance
    )


def seen_by(
    O: F8,  # noqa: E741 - its name in every textbook
    layout: Layout,
    first: int,
    count: int,
    *,
    prior: F8 | None = None,
    scale: F8 | None = None,
    tolerance: float = TOLERANCE,
) -> WindowObservability:
    """Observability by a matrix O (m, n) whose rows have independent errors of unit variance; as `observability`."""
    n = len(layout)
    W = np.asarray(O.T @ O)
    if len(O) > n:
        O = _compressed(O)  # noqa: E741 - the same information in n rows
    if scale is not None:
        units = np.asarray(scale, dtype=np.float64)
    elif prior is not None:
        units = np.sqrt(np.diag(prior))
    else:
        length = np.linalg.norm(O, axis=0)
        units = 1.0 / np.where(length > 0.0, length, 1.0)
    # The rank is judged with columns of length 1: a large prior of one state must not hide another.
    singular, V = _singular(O * units)
    length = np.linalg.norm(O, axis=0)
    even = 1.0 / np.where(length > 0.0, length, 1.0)
    s_even, V_even = _singular(O * even)
    rank = int((s_even > tolerance * s_even[0]).sum()) if s_even[0] > 0.0 else 0
    lost = V_even[rank:].T * even[:, None] if rank < n else np.empty((n, 0))
    ratio = np.full(n, np.nan)
    if prior is not None:
        ratio = np.sqrt(np.diag(_updated(np.asarray(prior), O)) / np.diag(prior))
    return WindowObservability(
        layout=layout,
        first=first,
        count=count,
        gramian=W,
        scale=units,
        singular=singular,
        rank=rank,
        tolerance=tolerance,
        condition=float(s_even[0] / s_even[-1]) if s_even[-1] > 0.0 else math.inf,
        unobservable=sparse_directions(lost, layout, units, [0.0] * lost.shape[1]),
        weakest=direction(V[-1] * units, layout, units, float(singular[-1])),
        prior=prior is not None and scale is None,
        sigma_ratio=ratio,
    )


def observability_over(
    system: LinearSystem,
    count: int,
    every: int = 1,
    *,
    prior: F8 | None = None,
    scale: F8 | None = None,
    tolerance: float = TOLERANCE,
) -> list[WindowObservability]:
    """Observability of all whole windows of ``count`` steps, begun at every ``every``-th step."""
    last = len(system) - count
    return [
        observability(system, k, count, prior=prior, scale=scale, tolerance=tolerance)
        for k in range(0, max(last, 0) + 1, every)
    ]


def degree_by_covariance(P: F8, P0: F8) -> F8:
    """Degree of observability of each state, 1 - sigma / sigma_0: 0 nothing learned, 1 all known; (..., n).

    P0 is the covariance before, or what it would be now without measurements (`LinearSystem.free`).
    """
    sigma = np.sqrt(np.diagonal(P, axis1=-2, axis2=-1))
    return np.asarray(1.0 - sigma / np.sqrt(np.diagonal(P0, axis1=-2, axis2=-1)))


def degree_by_solution(W: F8, b: F8) -> F8:
    """Degree of observability as the paper defines it, s = |U' |lambda / (U b)|| (eq. 8-12), (n,).

    Parameters
    ----------
    W : (n, n) float64
        Gramian O' O, of the paper's O without weights; eigen-decomposition U W U' = Lambda.
    b : (n,) float64
        O' z. Without noise z = O x_0, so b = W x_0, U b = Lambda U x_0 and s = |U' |1 / (U x_0)||: the reciprocal of
        the initial state in the eigenvectors' axes. W enters by its eigenvectors only and the eigenvalues, that is
        how well anything is seen, cancel. It depends on the units as well. Given for comparison with the paper.

    References
    ----------
    Gao, Tan (2007), eq. (8)-(12).
    """
    lam, V = np.linalg.eigh(W)
    rotated = V.T @ b
    with np.errstate(divide="ignore", invalid="ignore"):
        each = np.abs(np.where(rotated == 0.0, 0.0, lam / rotated))
    return np.asarray(np.abs(V @ each))


def cramer_rao(system: LinearSystem, P0: F8 | None = None) -> F8:
    """Cramer-Rao bound of the sigmas along a trajectory, (N, n); infinite where nothing is known.

        J <- (I + M Q)^-1 M + H' R^-1 H,   M = Phi^-T J Phi^-1

    For the matrices of the true trajectory no unbiased estimator is better (Tichavsky et al. 1998, eq. 21). With a
    prior it is the Kalman filter's P; without one (J = 0) it tells what measurements alone can give.
    """
    n = system.n
    J = np.zeros((n, n)) if P0 is None else np.linalg.inv(P0)
    out = np.empty((len(system), n))
    for k, s in enumerate(system.steps):
        B = np.linalg.inv(s.Phi)
        M = B.T @ J @ B
        J = np.linalg.solve(np.eye(n) + M @ s.Q, M)
        A = s.whitened()
        J = 0.5 * (J + J.T) + A.T @ A
        out[k] = _bounds(J)
    return out


def _bounds(J: F8) -> F8:
    """Square roots of the diagonal of J^-1; infinite for states with a part in the null space of J."""
    d = np.sqrt(np.maximum(np.diag(J), 0.0))
    d[d == 0.0] = 1.0
    lam, V = np.linalg.eigh(J / np.outer(d, d))
    seen = lam > 1e-13 * max(lam[-1], 0.0) * len(J)  # rounding of an eigenvalue that is 0
    with np.errstate(divide="ignore"):
        var = (V[:, seen] ** 2 / lam[seen]).sum(axis=1)
    hidden = (V[:, ~seen] ** 2).sum(axis=1) > 1e-9
    return np.asarray(np.where(hidden, np.inf, np.sqrt(var) / d))


def _compressed(A: F8) -> F8:
    """Triangle R (n, n) with R' R = A' A, A (m, n): block by block, too small for BLAS to wake its threads."""
    n = A.shape[1]
    R = A[:n]
    for first in range(n, len(A), 4 * n):
        R = np.asarray(np.linalg.qr(np.concatenate([R, A[first : first + 4 * n]]), mode="r"))
    return R


def _singular(A: F8) -> tuple[F8, F8]:
    """All n singular values of A (m, n), m <= n, padded with 0, and all n right singular vectors as rows."""
    n = A.shape[1]
    _, s, V = np.linalg.svd(A, full_matrices=True)
    return np.concatenate([s, np.zeros(n - len(s))]), V


def _updated(P0: F8, O: F8) -> F8:  # noqa: E741
    """Covariance P0 with the information O' O added; works for a prior that is not of full rank."""
    S = O @ P0 @ O.T + np.eye(len(O))
    return np.asarray(P0 - P0 @ O.T @ np.linalg.solve(S, O @ P0))


def sparse_directions(basis: F8, layout: Layout, scale: F8, strengths: Sequence[float]) -> tuple[Direction, ...]:
    """Directions that span the columns of ``basis`` (n, r), each with a 1 where all others have a 0.

    Gauss-Jordan elimination with the largest scaled element as pivot: of the many bases of a subspace this one has
    names that people recognise.
    """
    B = basis / scale[:, None]
    r = B.shape[1]
    free = np.ones(len(B), dtype=bool)
    for j in range(r):
        at = np.abs(B) * free[:, None]
        i, k = divmod(int(at[:, j:].argmax()), r - j)
        k += j
        B[:, [j, k]] = B[:, [k, j]]
        B[:, j] /= B[i, j]
        for other in range(r):
            if other != j:
                B[:, other] -= B[i, other] * B[:, j]
        free[i] = False
    return tuple(direction(B[:, j] * scale, layout, scale, strengths[j]) for j in range(r))


def direction(vector: F8, layout: Layout, scale: F8, strength: float) -> Direction:
    """A direction with its name: states by size (scaled), the leading one with coefficient 1, small ones left out."""
    size = np.abs(vector / scale)
    lead = int(size.argmax())
    if not size[lead] > 0.0:
        return Direction(vector, "nothing", strength)
    v = vector / vector[lead]
    # Rounding must not decide which of two equal states comes first.
    order = sorted(np.flatnonzero(size >= SHOWN * size[lead]), key=lambda i: (-round(size[i] / size[lead], 2), i))
    if order[0] != lead:
        v = vector / vector[order[0]]
    text = ""
    for i in order:
        c = float(v[i])
        number = "" if abs(abs(c) - 1.0) < 0.05 else f"{abs(c):.2g} "
        sign = ("- " if c < 0.0 else "+ ") if text else ("-" if c < 0.0 else "")
        text += f"{' ' if text else ''}{sign}{number}{layout.names[i]}"
    return Direction(v, text, strength)
