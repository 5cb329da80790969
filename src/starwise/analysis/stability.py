"""Stability of a filter: what becomes of an error of its start, or of a disturbance of its state.

An error e of the state, without noise, goes through  Psi_k = (I - K_k H_k) Phi_k  (Gao, Tan 2007, eq. 13-15):

    e_k = Psi_k Psi_{k-1} .. Psi_1 e_0

* The spectral radius of each Psi_k is what the paper judges by (lemma 1). It is neither necessary nor sufficient for
  a time-varying filter: products of matrices with radii below 1 can grow, and those above 1 shrink.
* The verdict comes from the products, and the Lyapunov exponents from them: mean rates at which errors grow.
* With optimal gains V = e' P^-1 e never grows (Deyst, Price 1968). So the norm of the product in units of P is at most
  1 and falls; where it stays 1, something is never corrected. Growth in metres happens inside of V <= 1, where P is
  large, and is reported by itself.

Where Phi, Q, H, R do not change, the gain goes to that of the discrete algebraic Riccati equation (DARE), and the
spectral radius of *that* Psi decides.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from starwise.analysis.stability_dare import SteadyState, spectral_radii, steady_state
from starwise.analysis.stability_system import LinearSystem
from starwise.types import F8, Layout

Verdict = Literal["asymptotically stable", "stable", "not stable"]
UNIT: Final = 1e-9
"""Spectral radii this near to 1 count as 1: eigenvalues of a double root are no better than 1e-8, single ones 1e-13."""


@dataclass(frozen=True)
class Growth:
    """What a unit error of some states becomes, at worst, in those states.

    Attributes
    ----------
    states : str
        Like ``pos``.
    factor : float
        Largest ||block of the product||_2, over all starts tried and all later steps; at least 1.
    start_s, after_s : float
        When the error entered, and how long it took to become so large.
    last : float
        The factor at the end of the run, of the same start.
    """

    states: str
    factor: float
    start_s: float
    after_s: float
    last: float


@dataclass(frozen=True)
class ErrorDynamics:
    """Error dynamics of a filter over a run.

    Attributes
    ----------
    layout : Layout
    period_s : float
    spectral_radius : (N,) float64
        Of Psi_k.
    norm : (N,) float64
        ||Psi_k||_2, states in units of ``scale``.
    scale : (n,) float64
    product_norm : (N,) float64
        ||Psi_k .. Psi_1||_2, scaled.
    product_norm_P : (N,) float64
        The same in units of P: ||P_k^-1/2 Psi_k .. Psi_1 P_0^1/2||_2; NaN without covariances.
    window : int
        Steps of the windows of ``window_norm`` and ``window_radius``.
    window_norm, window_radius : (N // window,) float64
        Of the products over consecutive windows.
    exponents_per_s : (n,) float64
        Lyapunov exponents over the second half of the run, falling, 1/s; in units of P where there are covariances.
    growth : tuple of Growth
        Transient growth by groups of states.
    steady : SteadyState or None
        Where the system is time-invariant, with optimal gains, and has one.
    limit_radius : float or None
        Spectral radius that holds for ever: of the steady state, or of Psi where it never changes.
    """

    layout: Layout
    period_s: float
    spectral_radius: F8
    norm: F8
    scale: F8
    product_norm: F8
    product_norm_P: F8
    window: int
    window_norm: F8
    window_radius: F8
    exponents_per_s: F8
    growth: tuple[Growth, ...]
    steady: SteadyState | None
    limit_radius: float | None

    @property
    def duration_s(self) -> float:
        """Length of the run, s."""
        return len(self.spectral_radius) * self.period_s

    @property
    def exponent_per_s(self) -> float:
        """Largest Lyapunov exponent, 1/s."""
        return float(self.exponents_per_s[0])

    @property
    def verdict(self) -> Verdict:
        """Judged by what the run shows.

        Time-invariant: the spectral radius, unless it is 1. Else by the product over the whole run: asymptotically
        stable if it leaves 1/e or less of every error; not stable if an error is e times as large at the end and
        still growing: 1.5 times what it ever was in the first half. Else stable.
        """
        if self.limit_radius is not None and abs(self.limit_radius - 1.0) > UNIT:
            return "asymptotically stable" if self.limit_radius < 1.0 else "not stable"
        if self.contraction <= np.exp(-1.0):
            return "asymptotically stable"
        norm = self.product_norm
        growing = norm[-1] > np.e and norm[-1] > 1.5 * norm[: (len(norm) + 1) // 2].max()
        return "not stable" if growing else "stable"

    @property
    def contraction(self) -> float:
        """What the run leaves of the worst error of its start: in units of ``scale``, and in units of P, the larger.

        P alone would call a constant that nobody sees corrected, because its sigma grows for ever.
        """
        return float(np.nanmax([self.product_norm[-1], self.product_norm_P[-1]]))

    @property
    def lemma1(self) -> Verdict:
        """What the paper's lemma 1 says, by the radii alone: the second half of the run decides.

        A radius counts as 1 if even its N-th power is within 1 % of 1.
        """
        late = self.spectral_radius[len(self.spectral_radius) // 2 :]
        unit = 0.01 / len(self.spectral_radius)
        if (late < 1.0 - unit).all():
            return "asymptotically stable"
        return "stable" if (late <= 1.0 + unit).all() else "not stable"

    @property
    def worst_growth(self) -> Growth | None:
        """Group of states with the largest transient growth."""
        return max(self.growth, key=lambda g: g.factor, default=None)

    def explain(self) -> str:
        """Verdict, reason and warning, in words."""
        rho = self.spectral_radius
        late = float(rho[len(rho) // 2 :].max())
        lead = self.exponent_per_s
        if self.limit_radius is not None:
            text = f"{self.verdict}: spectral radius {_radius(self.limit_radius)} for ever"
        else:
            text = f"{self.verdict}: the run leaves {self.contraction:.2g} of the worst error of its start"
            if lead * self.duration_s < -0.1:
                text += f" (late: 1/e in {-1.0 / lead:.0f} s)"
            text += f"; spectral radius up to {_radius(float(rho.max()))}, late {_radius(late)}"
        worst = self.worst_growth
        if worst is not None and worst.factor > 2.0:
            text += (
                f". Before that an error of {worst.states} grows {worst.factor:.0f}-fold within {worst.after_s:.0f} s: "
                "the spectral radius does not show this"
            )
        if self.lemma1 != self.verdict:
            text += f". By spectral radii alone it would be called {self.lemma1}"
        return text + "."


def stability(
    system: LinearSystem,
    P0: F8 | None = None,
    *,
    scale: F8 | None = None,
    window: int | None = None,
    starts: int = 8,
    groups: tuple[str, ...] | None = None,
) -> ErrorDynamics:
    """Error dynamics of a filter.

    Parameters
    ----------
    system : LinearSystem
        With the gains of the filter, or without: then P0 gives the optimal ones.
    P0 : (n, n) array, optional
        Covariance before the first transition.
    scale : (n,) array, optional
        Units of the states for norms: default the root mean square of the sigmas of the run's second half, or 1
        without P0.
    window : int, optional
        Steps of the windows for products: default a tenth of the run.
    starts : int
        Instants, evenly spread, at which a disturbance enters for the transient growth.
    groups : tuple of str, optional
        Groups of states for the growth, by the part of their names before the dot; default: all of them.

    Raises
    ------
    ValueError
        Neither gains nor P0.
    """
    filtered = None if P0 is None else system.filtered(P0)
    if filtered is not None:
        gains = filtered.K
    else:
        gains = tuple(s.K for s in system.steps if s.K is not None)
        if len(gains) < len(system):
            raise ValueError("steps without gains need a covariance P0 to begin with")
    n, N = system.n, len(system)
    Psi = np.stack([(np.eye(n) - K @ s.H) @ s.Phi for K, s in zip(gains, system.steps, strict=True)])
    if scale is None:
        units = np.ones(n) if filtered is None else np.sqrt((filtered.sigma[N // 2 :] ** 2).mean(axis=0))
        units = np.where(units > 0.0, units, 1.0)
    else:
        units = np.asarray(scale, dtype=np.float64)
    scaled = Psi * units / units[:, None]
    length = max(1, N // 10) if window is None else window
    product = _product_norms(scaled)
    in_P = None if filtered is None or P0 is None else _in_units_of_P(scaled, units, filtered.P, P0)
    window_norm, window_radius = _windows(scaled, length)
    steady, limit = _steady_or_none(system), None
    if steady is not None:
        limit = steady.spectral_radius
    elif (Psi == Psi[0]).all():
        limit = float(spectral_radii(Psi[0]))
    return ErrorDynamics(
        layout=system.layout,
        period_s=system.period_s,
        spectral_radius=spectral_radii(Psi),
        norm=np.asarray(np.linalg.norm(scaled, 2, axis=(1, 2))),
        scale=units,
        product_norm=product,
        product_norm_P=np.full(N, np.nan) if in_P is None else _product_norms(in_P),
        window=length,
        window_norm=window_norm,
        window_radius=window_radius,
        exponents_per_s=lyapunov_exponents((scaled if in_P is None else in_P)[N // 2 :]) / system.period_s,
        growth=transient_growth(Psi, system.layout, system.period_s, starts, groups),
        steady=steady,
        limit_radius=limit,
    )


def lyapunov_exponents(Psi: F8) -> F8:
    """Lyapunov exponents per step of a sequence of matrices (N, n, n), falling, (n,).

    By QR decompositions along the way (Benettin et al. 1980). A direction that is taken to exactly 0 has -inf. A first
    pass backwards with the transposes finds the axes in their order; without it slow directions that couple weakly
    hide behind fast ones for the whole of a run. The first tenth of the second pass does not count.
    """
    n = Psi.shape[-1]
    Q, total, counted = np.eye(n), np.zeros(n), 0
    for A in Psi[::-1]:
        Q, _ = np.linalg.qr(A.T @ Q)
    for k, A in enumerate(Psi):
        Q, R = np.linalg.qr(A @ Q)
        if k >= len(Psi) // 10:
            with np.errstate(divide="ignore"):
                total += np.log(np.abs(np.diag(R)))
            counted += 1
    return np.sort(total / max(counted, 1))[::-1]


def transient_growth(
    Psi: F8, layout: Layout, period_s: float, starts: int = 8, groups: tuple[str, ...] | None = None
) -> tuple[Growth, ...]:
    """Largest factor by which an error of a group of states grows in these states, for each group.

    A disturbance enters after step k, for ``starts`` values of k evenly spread over the run, and all later steps are
    looked at.
    """
    stems = [name.partition(".")[0] for name in layout.names]
    names = tuple(dict.fromkeys(stems)) if groups is None else groups
    members = {g: np.flatnonzero([s == g for s in stems]) for g in names}
    best = {g: Growth(g, 1.0, 0.0, 0.0, 1.0) for g in names}
    begin = np.unique(len(Psi) * np.arange(starts) // starts)
    M = np.broadcast_to(np.eye(len(layout)), (len(begin), len(layout), len(layout))).copy()
    last = {g: np.ones(len(begin)) for g in names}
    top = dict.fromkeys(names, (1.0, 0, 0))
    for k, A in enumerate(Psi):
        on = int(np.searchsorted(begin, k, side="right"))
        M[:on] = A @ M[:on]
        for g, at in members.items():
            B = M[:on][:, at][:, :, at]
            size = np.abs(B[:, 0, 0]) if len(at) == 1 else np.linalg.norm(B, 2, axis=(1, 2))
            last[g][:on] = size
            j = int(size.argmax())
            if size[j] > top[g][0]:
                top[g] = (float(size[j]), j, k)
    for g, (factor, j, k) in top.items():
        if factor > 1.0:
            first = int(begin[j])
            best[g] = Growth(g, factor, first * period_s, (k + 1 - first) * period_s, float(last[g][j]))
    return tuple(best.values())


def _radius(rho: float) -> str:
    """Radius with the digits that show how far from 1 it is."""
    if abs(rho - 1.0) <= UNIT:
        return "1"
    return f"1 {'-' if rho < 1.0 else '+'} {abs(rho - 1.0):.1e}" if abs(rho - 1.0) < 0.01 else f"{rho:.3f}"


def _steady_or_none(system: LinearSystem) -> SteadyState | None:
    """Steady state of a time-invariant system with optimal gains, if there is one."""
    if not system.invariant or any(s.K is not None for s in system.steps):
        return None
    try:
        return steady_state(system.steps[0])
    except ValueError:
        return None


def _product_norms(A: F8) -> F8:
    """Norms of the products from the first matrix to each."""
    out, M = np.empty(len(A)), np.eye(A.shape[-1])
    for k in range(len(A)):
        M = A[k] @ M
        out[k] = np.linalg.norm(M, 2)
    return out


def _in_units_of_P(scaled: F8, units: F8, P: F8, P0: F8) -> F8 | None:
    """Matrices P_k^-1/2 Psi_k P_{k-1}^1/2 (Cholesky factors), or None where a P is singular to rounding."""
    out, D = np.empty_like(scaled), np.outer(units, units)
    L0 = _factor(P0 / D)
    for k, A in enumerate(scaled):
        L = _factor(P[k] / D)
        if L is None or L0 is None:
            return None
        out[k] = np.linalg.solve(L, A @ L0)
        L0 = L
    return out


def _factor(P: F8) -> F8 | None:
    """Cholesky factor, or None where P is singular to rounding."""
    try:
        return np.asarray(np.linalg.cholesky(P))
    except np.linalg.LinAlgError:
        return None


def _windows(scaled: F8, length: int) -> tuple[F8, F8]:
    """Norm and spectral radius of the products over consecutive windows."""
    norms, radii = [], []
    for first in range(0, len(scaled) - length + 1, length):
        M = np.eye(scaled.shape[-1])
        for A in scaled[first : first + length]:
            M = A @ M
        norms.append(float(np.linalg.norm(M, 2)))
        radii.append(float(spectral_radii(M)))
    return np.array(norms), np.array(radii)
