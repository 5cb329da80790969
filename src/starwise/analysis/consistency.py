"""Consistency of a filter: whether its innovations are as small and as independent as its covariance says.

Under the hypothesis H0 that filter and system agree, innovations v_k of dimension m are white, zero-mean, with
covariance S_k (Bar-Shalom, Li, Kirubarajan 2001, section 5.4). Three tests:

* **size**: sum of v' S^-1 v over a window is chi-square with the sum of dimensions as degrees of freedom;
* **whiteness**: time-average autocorrelation at lags 1..L, all lags judged *together*;
* **known fault**: what a given fault (a delay, a bias) would have added to the innovations, fitted to them. It sees
  what the first two cannot: an error that the filter absorbs into its state leaves innovations small and white.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from starwise.types import F8

Verdict = Literal["confirmed", "wrong", "unverifiable"]
PROBABILITY: Final = 0.95
"""Of the regions of acceptance."""


@dataclass(frozen=True)
class NisTest:
    """Normalised innovation squared of a window, per degree of freedom, with its region of acceptance.

    Attributes
    ----------
    per_dof, low, high : float
    dof : int
        Degrees of freedom of the whole window.
    passed : bool
    """

    per_dof: float
    low: float
    high: float
    dof: int
    passed: bool


@dataclass(frozen=True)
class WhitenessTest:
    """Autocorrelation of innovations at lags 1..L, with its region of acceptance.

    Attributes
    ----------
    rho : (L,) float64
    bound : float
        All L lags of a white series lie inside +-bound with the probability of the test.
    bound_each : float
        One lag of a white series does.
    outside : tuple of int
        Lags outside ``bound``.
    passed : bool
    """

    rho: F8
    bound: float
    bound_each: float
    outside: tuple[int, ...]
    passed: bool


@dataclass(frozen=True)
class FaultEstimate:
    """Size of a fault with a known signature in the innovations, by weighted least squares.

    Attributes
    ----------
    size, sigma : float
        Estimate and its standard deviation, in units of the signature's fault; infinite sigma: not seen at all.
    p_value : float
        Chance of an estimate so far from zero without the fault.
    """

    size: float
    sigma: float
    p_value: float


@dataclass(frozen=True)
class DelayCheck:
    """Whether the delay that a filter assumes is the true one, and whether its innovations can tell.

    Attributes
    ----------
    delay_s, sigma_s : float
        Delay that the filter has not accounted for, from the innovations alone.
    p_value : float
    hidden_m : float
        Position error (root mean square) by the delays that innovations and prior knowledge together leave possible.
    claimed_m : float
        Position sigma that the filter claims.
    verdict : {"confirmed", "wrong", "unverifiable"}
        ``wrong``: there is a delay. ``unverifiable``: ``hidden_m`` exceeds ``claimed_m``: however good NIS and
        whiteness look, the covariance is not certified.
    """

    delay_s: float
    sigma_s: float
    p_value: float
    hidden_m: float
    claimed_m: float
    verdict: Verdict


def nis_region(dof: int, probability: float = PROBABILITY) -> tuple[float, float]:
    """Region of acceptance of an average NIS per degree of freedom, two-sided, with ``dof`` degrees in all."""
    from scipy.special import chdtri

    tail = 0.5 * (1.0 - probability)
    return float(chdtri(dof, 1.0 - tail)) / dof, float(chdtri(dof, tail)) / dof


def nis_test(nis: ArrayLike, dof: ArrayLike, probability: float = PROBABILITY) -> NisTest:
    """Size of the innovations of a window.

    Parameters
    ----------
    nis : (n,) array_like
        v' S^-1 v of each epoch; NaN: no measurement.
    dof : (n,) array_like or int
        Dimension of each innovation.
    probability : float
        Of acceptance under H0.

    References
    ----------
    Bar-Shalom et al. (2001) eq. (5.4.2-13); Lin, Meng, He, eq. (6), (7).
    """
    values = np.asarray(nis, dtype=np.float64)
    dofs = np.broadcast_to(np.asarray(dof, dtype=np.int64), values.shape)
    there = np.isfinite(values) & (dofs > 0)
    total = int(dofs[there].sum())
    if total == 0:
        return NisTest(math.nan, math.nan, math.nan, 0, False)
    low, high = nis_region(total, probability)
    mean = float(values[there].sum()) / total
    return NisTest(mean, low, high, total, low <= mean <= high)


def autocorrelation(v: ArrayLike, lags: int, K: int | None = None) -> F8:
    """Time-average autocorrelation rho(1..lags) of a vector series by inner products.

        rho(l) = sum_k v_k' v_{k+l} / sqrt(sum_k v_k' v_k  sum_k v_{k+l}' v_{k+l}),   k = 1..K

    Parameters
    ----------
    v : (n,) or (n, m) array_like
    lags : int
    K : int, optional
        Terms at every lag; default n - lags, and n must be at least K + lags.

    References
    ----------
    Bar-Shalom et al. (2001) eq. (5.4.2-16); Lin, Meng, He, eq. (8).
    """
    series = np.asarray(v, dtype=np.float64)
    series = series[:, None] if series.ndim == 1 else series
    K = len(series) - lags if K is None else K
    if lags < 1 or K < 2 or len(series) < K + lags:
        raise ValueError(f"{len(series)} innovations are too few for {K} terms at {lags} lags")
    head = series[:K]
    out = np.empty(lags)
    for lag in range(1, lags + 1):
        tail = series[lag : lag + K]
        size = math.sqrt(float((head * head).sum()) * float((tail * tail).sum()))
        out[lag - 1] = float((head * tail).sum()) / size if size > 0.0 else 0.0
    return out


def whiteness_bound(K: int, m: int = 1, lags: int = 1, probability: float = PROBABILITY) -> float:
    """Bound that ``lags`` autocorrelations of a white series of dimension m keep together.

    Normalised inner products of independent Gaussian vectors of mK elements: rho^2 is Beta(1/2, (mK - 1) / 2), close to
    N(0, 1 / (mK)). Lags are taken as independent (Sidak). For a scalar series, K = 50 and a single lag this is 0.273,
    the 0.277 = 1.96 / sqrt(50) of textbooks; but all of eight lags keep inside that in two white series of three only.
    """
    from scipy.special import betaincinv

    each = probability ** (1.0 / lags)
    return math.sqrt(float(betaincinv(0.5, 0.5 * (m * K - 1), each)))


def judge_autocorrelation(
    rho: Sequence[float] | F8, K: int, m: int = 1, probability: float = PROBABILITY
) -> WhitenessTest:
    """Verdict on autocorrelations at lags 1..L of a series of dimension m, K terms each: computed, or published."""
    values = np.asarray(rho, dtype=np.float64)
    bound = whiteness_bound(K, m, len(values), probability)
    outside = tuple(int(lag) + 1 for lag in np.flatnonzero(~(np.abs(values) <= bound)))
    return WhitenessTest(values, bound, whiteness_bound(K, m, 1, probability), outside, not outside)


def lag_p_value(rho: float, K: int, m: int = 1) -> float:
    """Chance that one lag of a white series has an autocorrelation as far from zero as ``rho``, two-sided."""
    from scipy.special import betainc

    return 1.0 - float(betainc(0.5, 0.5 * (m * K - 1), min(1.0, rho * rho)))


def whitened(v: ArrayLike, S: ArrayLike) -> F8:
    """Innovations (n, m) divided by the Cholesky factors of their covariances (n, m, m): unit variance, same order."""
    L = np.linalg.cholesky(np.asarray(S, dtype=np.float64))
    return np.asarray(np.linalg.solve(L, np.asarray(v, dtype=np.float64)[..., None])[..., 0])


def whiteness_test(
    v: ArrayLike, S: ArrayLike | None = None, lags: int = 8, K: int | None = None, probability: float = PROBABILITY
) -> WhitenessTest:
    """Independence of successive innovations.

    Parameters
    ----------
    v : (n,) or (n, m) array_like
    S : (n, m, m) array_like, optional
        Their covariances. With them the series is normalised first: components of different size would count
        as fewer than m (the paper's eq. 8 does without).
    lags, K
        See `autocorrelation`.
    probability : float
        That a white series passes at all lags together.
    """
    series = np.asarray(v, dtype=np.float64)
    series = series[:, None] if series.ndim == 1 else series
    if S is not None:
        series = whitened(series, S)
    K = len(series) - lags if K is None else K
    return judge_autocorrelation(autocorrelation(series, lags, K), K, series.shape[1], probability)


def known_fault(v: ArrayLike, S: ArrayLike, signature: ArrayLike) -> FaultEstimate:
    """Size of a fault out of innovations, given what a fault of size 1 adds to them.

        size = sum g' S^-1 v / sum g' S^-1 g,   sigma^2 = 1 / sum g' S^-1 g

    The same as estimating the fault as a constant state of the filter with an infinite prior (Friedland 1969), but
    without touching the filter; a generalised likelihood ratio test (Willsky, Jones 1976).

    Parameters
    ----------
    v, signature : (n, m) array_like
    S : (n, m, m) array_like
    """
    u, g = whitened(v, S), whitened(signature, S)
    there = np.isfinite(u).all(axis=1) & np.isfinite(g).all(axis=1)
    information = float((g[there] ** 2).sum())
    if not information > 0.0:
        return FaultEstimate(0.0, math.inf, 1.0)
    size = float((g[there] * u[there]).sum()) / information
    sigma = 1.0 / math.sqrt(information)
    return FaultEstimate(size, sigma, math.erfc(abs(size) / sigma / math.sqrt(2.0)))


def delay_check(
    v: ArrayLike,
    S: ArrayLike,
    signature: ArrayLike,
    effect: ArrayLike,
    claimed_m: float,
    plausible_s: float,
    false_alarm: float = 1e-3,
) -> DelayCheck:
    """Delay in position fixes that a filter has not accounted for: found, excluded, or impossible to tell.

    In straight, steady motion a delay is a constant position error v T, which the filter takes for its own: innovations
    stay small and white. Only changes of velocity show it, through the signature.

    Parameters
    ----------
    v, signature : (n, m) array_like
        Innovations, m, and what a delay of 1 s adds to them (see `starwise.estimators.late.delay_response`).
    S : (n, m, m) array_like
    effect : (m,) array_like
        What a delay of 1 s does to the position of the latest belief, m.
    claimed_m : float
        Position sigma that the filter claims.
    plausible_s : float
        Prior knowledge: standard deviation of delays that are thought possible, s.
    false_alarm : float
        Chance of ``wrong`` without a delay.
    """
    fault = known_fault(v, S, signature)
    variance = 1.0 / (1.0 / fault.sigma**2 + 1.0 / plausible_s**2)
    mean = fault.size * variance / fault.sigma**2
    hidden = float(np.linalg.norm(np.asarray(effect, dtype=np.float64))) * math.sqrt(variance + mean * mean)
    verdict: Verdict = "confirmed"
    if fault.p_value < false_alarm:
        verdict = "wrong"
    elif hidden > claimed_m:
        verdict = "unverifiable"
    return DelayCheck(fault.size, fault.sigma, fault.p_value, hidden, claimed_m, verdict)


def coverage(error: ArrayLike, covariance: ArrayLike, probability: float = PROBABILITY) -> float:
    """Part of the errors (n, m) inside the ellipsoids of their covariances (n, m, m) that should hold ``probability``.

    NaN where there is no error at all.
    """
    from scipy.special import chdtri

    e = whitened(error, covariance)
    there = np.isfinite(e).all(axis=1)
    if not there.any():
        return math.nan
    return float(((e[there] ** 2).sum(axis=1) <= chdtri(e.shape[1], 1.0 - probability)).mean())


def pass_region(runs: int, expected: float = PROBABILITY, probability: float = 0.999) -> tuple[float, float]:
    """Region in which the part of passed tests of independent runs lies with a probability (binomial)."""
    from scipy.special import bdtr

    tail = 0.5 * (1.0 - probability)
    counts: NDArray[np.int64] = np.arange(runs + 1)
    below = bdtr(counts.astype(np.float64), runs, expected)  # P(X <= k)
    low = int(np.searchsorted(below, tail))
    high = int(np.searchsorted(below, 1.0 - tail))
    return low / runs, min(high, runs) / runs
