"""Consecutive epochs of a run as a linear system with two kinds of states, and its filter.

Navigation states x and errors e of the measurements that last:

    x_k = Phi_k x_{k-1} + w_k,   w ~ (0, Q_k);       e_k = phi_k e_{k-1} + u_k,   u ~ (0, 1 - phi_k^2), diagonal
    z_k = H_k x_k + E_k e_k + v_k,   v ~ (0, diag r_k)

The errors are *kept as states, all of them*, with their unit prior: nothing is approximated, and a satellite that
appears finds its states as they are before anything is known. Observability concerns x alone: e is noise there,
correlated in time, and `whitened` takes it out exactly, by the filter of e alone. Where the filter itself is followed
(covariance, stability), x and e are filtered together, as in the run.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from starwise.analysis.stability_system import LinearSystem, Step
from starwise.types import F8, I8, Layout

CODE, CODE2, RATE, OTHER = 0, 1, 2, 3
"""Kinds of measurements."""


@dataclass(frozen=True)
class RunStep:
    """One epoch of a run as a linear system; see the module.

    Attributes
    ----------
    t_ns : int
    Phi, Q : (n, n) float64
    phi : (n_e,) float64
    H, E : (m, n), (m, n_e) float64
    r : (m,) float64
        Variances that the filter worked with.
    widened : (m,) float64
        Part of them that robust weights added.
    kind : (m,) int64
        `CODE` ...
    sv : (m,) int16
        Satellite, -1: none.
    """

    t_ns: int
    Phi: F8
    Q: F8
    phi: F8
    H: F8
    E: F8
    r: F8
    widened: F8
    kind: I8
    sv: NDArray[np.int16]


@dataclass(frozen=True)
class RunWindow:
    """Consecutive epochs of a run as a linear system that begins with a filter's start.

    Attributes
    ----------
    layout : Layout
        Navigation states.
    error_names : tuple of str
        The lasting errors behind them.
    prior : (n, n) float64
        Covariance of the navigation states before the first epoch: that of a start about which nothing is known.
    steps : tuple of RunStep
    first : int
        Epoch of the run.
    """

    layout: Layout
    error_names: tuple[str, ...]
    prior: F8
    steps: tuple[RunStep, ...]
    first: int = 0

    @property
    def duration_s(self) -> float:
        """From the first to the last epoch, s."""
        return (self.steps[-1].t_ns - self.steps[0].t_ns) * 1e-9

    @property
    def period_s(self) -> float:
        """Mean time between epochs, s."""
        return self.duration_s / max(len(self.steps) - 1, 1) or 1.0

    @property
    def n(self) -> int:
        """Number of navigation states."""
        return len(self.layout)

    def system(self) -> LinearSystem:
        """The same as dense matrices with all states, for the analyses of any linear system."""
        names = Layout((*self.layout.names, *self.error_names))
        steps = []
        for s in self.steps:
            n, k = self.n, len(s.phi)
            Phi, Q = np.zeros((n + k, n + k)), np.zeros((n + k, n + k))
            Phi[:n, :n], Q[:n, :n] = s.Phi, s.Q
            Phi[range(n, n + k), range(n, n + k)] = s.phi
            Q[range(n, n + k), range(n, n + k)] = 1.0 - s.phi**2
            steps.append(Step(Phi, Q, np.concatenate([s.H, s.E], axis=1), s.r))
        return LinearSystem(names, tuple(steps), self.period_s)

    def without_unseen(self) -> "RunWindow":
        """The same without navigation states of which no measurement says anything: for estimators without memory."""
        seen = np.any([s.H.any(axis=0) for s in self.steps], axis=0)
        keep = np.flatnonzero(seen)
        square = np.ix_(keep, keep)
        steps = tuple(replace(s, Phi=s.Phi[square], Q=s.Q[square], H=s.H[:, keep]) for s in self.steps)
        names = tuple(self.layout.names[k] for k in keep)
        return replace(self, layout=Layout(names), prior=self.prior[square], steps=steps)

    def prior_of_all(self) -> F8:
        """Covariance of all states before the first epoch."""
        n, k = self.n, len(self.error_names)
        P = np.eye(n + k)
        P[:n, :n] = self.prior
        return P

    def navigation(self) -> LinearSystem:
        """The navigation states alone, lasting errors as white noise: for what does not depend on their memory."""
        steps = [Step(s.Phi, s.Q, s.H, s.r + (s.E**2).sum(axis=1)) for s in self.steps]
        return LinearSystem(self.layout, tuple(steps), self.period_s)


@dataclass(frozen=True)
class Belief:
    """What a filter knows after the measurements of an epoch, and its error dynamics.

    Attributes
    ----------
    P : (n, n) float64
        Covariance of all states.
    Psi : (n, n) float64
        (I - K H) Phi.
    """

    P: F8
    Psi: F8


def filtered(window: RunWindow, *, widened: bool = True, dynamics: bool = False) -> Iterator[Belief]:
    """Covariances of all states after every epoch of a window, as the filter of the run has them.

    Parameters
    ----------
    window : RunWindow
    widened : bool
        With the variance that robust weights added; without it this is the Cramer-Rao bound of the model.
    dynamics : bool
        Also Psi of every epoch (else it is empty).
    """
    n, P = window.n, window.prior_of_all()
    for s in window.steps:
        P[:n] = s.Phi @ P[:n]
        P[:, :n] = P[:, :n] @ s.Phi.T
        P[n:] *= s.phi[:, None]
        P[:, n:] *= s.phi
        P[:n, :n] += s.Q
        P[range(n, len(P)), range(n, len(P))] += 1.0 - s.phi**2
        A = None
        if len(s.r):
            H = np.concatenate([s.H, s.E], axis=1)
            W = H @ P
            S = W @ H.T
            S[range(len(S)), range(len(S))] += s.r if widened else s.r - s.widened
            K = np.linalg.solve(S, W).T
            P = P - K @ W
            P = 0.5 * (P + P.T)
            A = K @ H if dynamics else None
        Psi = np.empty((0, 0))
        if dynamics:
            Psi = np.eye(len(P)) if A is None else np.eye(len(P)) - A
            Psi[:, :n] = Psi[:, :n] @ s.Phi
            Psi[:, n:] = Psi[:, n:] * s.phi
        yield Belief(P, Psi)
        P = P.copy()


def whitened(window: RunWindow) -> F8:
    """Observability matrix of the navigation states at the window's beginning, (sum of m, n), in units of the noise.

    Rows are H_k Phi_k .. Phi_1 less what the errors before and beside them say of their error: the innovations of the
    filter of e alone, to which the rows are data, one column each, divided by their root covariance. Without lasting
    errors the rows of `starwise.analysis.observability.observability_matrix`. Process noise of x is left out, as in the
    definition of the Gramian.
    """
    n, ne = window.n, len(window.error_names)
    M, P, X = np.eye(n), np.eye(ne), np.zeros((ne, n))
    blocks = []
    for s in window.steps:
        M = s.Phi @ M
        P = P * np.outer(s.phi, s.phi)
        P[range(ne), range(ne)] += 1.0 - s.phi**2
        X = s.phi[:, None] * X
        if not len(s.r):
            continue
        data = s.H @ M - s.E @ X
        if not s.E.any():
            blocks.append(data / np.sqrt(s.r)[:, None])
            continue
        W = s.E @ P
        S = W @ s.E.T
        S[range(len(S)), range(len(S))] += s.r
        L = np.linalg.cholesky(S)
        white = np.linalg.solve(L, np.concatenate([data, W], axis=1))
        blocks.append(white[:, :n])
        X = X + white[:, n:].T @ white[:, :n]
        P = P - white[:, n:].T @ white[:, n:]
    return np.concatenate(blocks) if blocks else np.zeros((0, n))
