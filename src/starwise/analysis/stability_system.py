"""Linear systems as a filter saw them, step by step: what observability and stability are computed from.

Step k of a system with the state of a `Layout`:

    x_k = Phi_k x_{k-1} + w_k,  w_k ~ (0, Q_k);      z_k = H_k x_k + v_k,  v_k ~ (0, R_k)

Dimensions of z_k may change from step to step (satellites come and go), that of x may not.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from starwise.types import F8, Layout


@dataclass(frozen=True)
class Step:
    """One step of a filter.

    Attributes
    ----------
    Phi : (n, n) float64
        Transition from the step before.
    Q : (n, n) float64
        Covariance of the noise that it adds.
    H : (m, n) float64
        Measurement matrix.
    R : (m, m) float64
        Covariance of the measurement noise; (m,): its diagonal.
    K : (n, m) float64, optional
        Gain that the filter used; without it the optimal one is computed.
    """

    Phi: F8
    Q: F8
    H: F8
    R: F8
    K: F8 | None = None

    @property
    def R_full(self) -> F8:
        """Covariance of the measurement noise, (m, m)."""
        return np.diag(self.R) if self.R.ndim == 1 else self.R

    def whitened(self) -> F8:
        """Rows of H in units of their noise: L^-1 H with R = L L', (m, n)."""
        if self.R.ndim == 1:
            return np.asarray(self.H / np.sqrt(self.R)[:, None])
        if not len(self.H):
            return self.H
        return np.asarray(np.linalg.solve(np.linalg.cholesky(self.R), self.H))


@dataclass(frozen=True)
class Filtered:
    """Covariances and gains of a run.

    Attributes
    ----------
    before, P : (N, n, n) float64
        Covariance before and after the measurements of each step.
    K : tuple of (n, m) float64
        Gains.
    """

    before: F8
    P: F8
    K: tuple[F8, ...]

    @property
    def sigma(self) -> F8:
        """Standard deviations after each step, (N, n)."""
        return np.sqrt(np.diagonal(self.P, axis1=1, axis2=2))


@dataclass(frozen=True)
class LinearSystem:
    """A sequence of steps with named states.

    Attributes
    ----------
    layout : Layout
        Names of the n states.
    steps : tuple of Step
    period_s : float
        Time between steps, s; the mean one where they are uneven.
    """

    layout: Layout
    steps: tuple[Step, ...]
    period_s: float = 1.0

    def __post_init__(self) -> None:
        n = len(self.layout)
        if not self.steps:
            raise ValueError("a system without steps")
        for k, s in enumerate(self.steps):
            m = len(s.H)
            wrong = (
                s.Phi.shape != (n, n)
                or s.Q.shape != (n, n)
                or s.H.shape != (m, n)
                or s.R.shape not in ((m,), (m, m))
                or (s.K is not None and s.K.shape != (n, m))
            )
            if wrong:
                raise ValueError(f"step {k}: matrices do not fit a state of {n} and {m} measurements")

    @classmethod
    def of(
        cls, layout: Layout | Sequence[str], steps: Iterable[Sequence[ArrayLike]], period_s: float = 1.0
    ) -> "LinearSystem":
        """System from tuples (Phi, Q, H, R) or (Phi, Q, H, R, K) of anything like arrays."""
        names = layout if isinstance(layout, Layout) else Layout(tuple(layout))
        return cls(names, tuple(Step(*(np.asarray(a, dtype=np.float64) for a in step)) for step in steps), period_s)

    @classmethod
    def constant(
        cls, layout: Layout | Sequence[str], step: Sequence[ArrayLike], count: int, period_s: float = 1.0
    ) -> "LinearSystem":
        """System of ``count`` equal steps."""
        return cls.of(layout, [step] * count, period_s)

    def __len__(self) -> int:
        return len(self.steps)

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.layout)

    def part(self, first: int, count: int) -> "LinearSystem":
        """Window of ``count`` steps from step ``first`` on (fewer at the end)."""
        return replace(self, steps=self.steps[first : first + count])

    def with_gains(self, K: Sequence[F8]) -> "LinearSystem":
        """The same with the gains of a filter."""
        return replace(self, steps=tuple(replace(s, K=k) for s, k in zip(self.steps, K, strict=True)))

    def transformed(self, T: F8, layout: Layout) -> "LinearSystem":
        """System in the states y = T x with names of their own; T invertible.

        What is only the rounding of a zero becomes zero: it would look like a very weak observation.
        """
        B: F8 = np.asarray(np.linalg.inv(T))
        steps = tuple(
            Step(_product(T, s.Phi, B), _product(T, s.Q, T.T), _product(s.H, B), s.R, None if s.K is None else T @ s.K)
            for s in self.steps
        )
        return replace(self, layout=layout, steps=steps)

    def in_enu(self, C_ne: F8) -> "LinearSystem":
        """System with every triple ``*.x, *.y, *.z`` (ECEF) as ``*.e, *.n, *.u``: directions that people can read.

        Parameters
        ----------
        C_ne : (3, 3) float64
            Rotation from ECEF to east, north, up (`starwise.frames.C_ne_enu`).
        """
        T, names = enu_transform(self.layout, C_ne)
        return self.transformed(T, names)

    @property
    def invariant(self) -> bool:
        """All steps have equal Phi, Q, H and R, bit for bit."""
        a = self.steps[0]
        return all(
            s is a
            or (
                np.array_equal(s.Phi, a.Phi)
                and np.array_equal(s.Q, a.Q)
                and np.array_equal(s.H, a.H)
                and np.array_equal(s.R, a.R)
            )
            for s in self.steps
        )

    def filtered(self, P0: F8) -> Filtered:
        """Covariances of a filter that begins with P0 before the first transition, with its gains or optimal ones.

        P by Joseph's form, which holds for any gain (Groves 2013, 3.2.3).
        """
        n, P = self.n, np.array(P0, dtype=np.float64)
        if P.shape != (n, n):
            raise ValueError(f"P0 {P.shape} does not fit a state of {n}")
        before, after, gains = np.empty((len(self), n, n)), np.empty((len(self), n, n)), []
        for k, s in enumerate(self.steps):
            P = s.Phi @ P @ s.Phi.T + s.Q
            before[k] = P = 0.5 * (P + P.T)
            R = s.R_full
            if s.K is not None:
                K = s.K
            elif len(R):
                K = np.asarray(np.linalg.solve(s.H @ P @ s.H.T + R, s.H @ P).T)
            else:
                K = np.zeros((n, 0))
            A = np.eye(n) - K @ s.H
            P = A @ P @ A.T + K @ R @ K.T
            after[k] = P = 0.5 * (P + P.T)
            gains.append(K)
        return Filtered(before, after, tuple(gains))

    def free(self, P0: F8) -> F8:
        """Covariance after all steps without any measurement, (n, n)."""
        P = np.array(P0, dtype=np.float64)
        for s in self.steps:
            P = s.Phi @ P @ s.Phi.T + s.Q
        return P


def _product(*factors: F8) -> F8:
    """Product of matrices, 0 where it is below the rounding of its terms."""
    out: F8 = factors[0]
    size: F8 = np.asarray(np.abs(factors[0]))
    for A in factors[1:]:
        out, size = np.asarray(out @ A), np.asarray(size @ np.asarray(np.abs(A)))
    return np.asarray(np.where(np.abs(out) <= 16.0 * np.finfo(np.float64).eps * size, 0.0, out))


def enu_transform(layout: Layout, C_ne: F8) -> tuple[F8, Layout]:
    """Matrix T (n, n) that rotates every triple ``*.x, *.y, *.z`` to east, north, up, and the new names."""
    T, names = np.eye(len(layout)), list(layout.names)
    for name in layout.names:
        stem, _, axis = name.rpartition(".")
        triple = [f"{stem}.{a}" for a in "xyz"]
        if axis != "x" or not all(t in layout for t in triple):
            continue
        at = layout.indices(triple)
        T[np.ix_(at, at)] = C_ne
        for i, a in zip(at, "enu", strict=True):
            names[i] = f"{stem}.{a}"
    return T, Layout(tuple(names))
