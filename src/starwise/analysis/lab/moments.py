"""What a gate leaves of a normal distribution: moments of innovations that were accepted, and shares inside regions.

Under H0 an innovation over its sigma is standard normal. A gate at probability p keeps what lies inside; the mean
square of the rest is below one, and a test that ignored it would call every gated filter too modest. Two gates occur:
a row by itself (|z| <= c with P = 1 - p), and two rows of a satellite together (z1^2 + z2^2 <= c^2, chi-square with 2
degrees).
"""

import math
from functools import lru_cache
from typing import Final

import numpy as np

from starwise.types import F8

NOMINAL: Final = (0.50, 0.68, 0.95, 0.99)
"""Shares of which the calibration curve is made."""


@lru_cache(maxsize=64)
def truncated_moments(gate: int, probability: float) -> tuple[float, float]:
    """Second and fourth moment of an accepted innovation: 1 and 3 without a gate.

    Parameters
    ----------
    gate : int
        0 none, 1 by itself, 2 in a pair.
    probability : float
        Chance that a sound row (or pair) is refused.

    Notes
    -----
    By itself: m2 = P(chi2_3 <= c^2) / P(chi2_1 <= c^2), m4 = 3 P(chi2_5 <= c^2) / P(chi2_1 <= c^2); in a pair of k = 2
    the same with 4, 6 and 2 degrees of freedom, and m4 = 3 as before (Johnson, Kotz, Balakrishnan 1994, section
    13.10.1).
    """
    if gate == 0 or not 0.0 < probability < 1.0:
        return 1.0, 3.0
    from scipy.special import chdtr, chdtri

    limit = float(chdtri(gate, probability))
    inside = float(chdtr(gate, limit))
    return float(chdtr(gate + 2, limit)) / inside, 3.0 * float(chdtr(gate + 4, limit)) / inside


@lru_cache(maxsize=64)
def kurtosis_moments(gate: int, probability: float) -> tuple[float, float]:
    """Kurtosis of an accepted innovation, and n times the variance of a sample's: 3 and 24 without a gate.

    n var(b2) = mu8 - 4 mu4 mu6 + 4 mu4^3 - mu4^2 for a symmetric distribution of unit variance (delta method; Kendall,
    Stuart, vol. 1, 10.15).
    """
    if gate == 0 or not 0.0 < probability < 1.0:
        return 3.0, 24.0
    from scipy.special import chdtr, chdtri

    limit = float(chdtri(gate, probability))
    inside = float(chdtr(gate, limit))
    two, four, six, eight = (
        factor * float(chdtr(gate + k, limit)) / inside for factor, k in ((1.0, 2), (3.0, 4), (15.0, 6), (105.0, 8))
    )
    four, six, eight = four / two**2, six / two**3, eight / two**4
    return four, eight - 4.0 * four * six + 4.0 * four**3 - four**2


def before_gate(ratio: float, probability: float) -> float:
    """Mean square of all innovations, over its expectation, out of that of those inside the gate (one by itself).

    At most twice as much: innovations that fill the gate evenly (mean square a third of its edge squared) tell no more.
    """
    if not 0.0 < probability < 1.0 or ratio <= 1.0:
        return ratio
    from scipy.special import chdtr, chdtri

    limit = float(chdtri(1, probability))
    modelled, true = truncated_moments(1, probability)[0], ratio
    for _ in range(50):
        kept = float(chdtr(3, limit / true)) / float(chdtr(1, limit / true))
        true = min(ratio * modelled / max(kept, 0.05), 2.0 * ratio)
    return true


def row_moments(gate: np.ndarray, probability: float) -> tuple[F8, F8]:
    """`truncated_moments` of every row, (n,) each."""
    two, four = np.array([truncated_moments(k, probability) for k in range(3)]).T
    return two[gate], four[gate]


def normal_quantile(share: float) -> float:
    """Half-width, in sigmas, of the interval that holds a share of a standard normal."""
    from scipy.special import ndtri

    return float(ndtri(0.5 * (1.0 + share)))


def two_sided(z: F8) -> F8:
    """Chance of a standard normal at least as far from zero, elementwise; NaN stays."""
    from scipy.special import erfc

    return np.asarray(erfc(np.abs(z) / math.sqrt(2.0)))


def gamma_p(value: F8, mean: F8, var: F8) -> tuple[F8, F8]:
    """Two-sided chance of sums of squares that are as far from their mean, by a gamma distribution with its moments.

    Exact for sums of squares of independent normals. The sign (second) says on which side the value lies.
    """
    from scipy.special import gammainc, gammaincc

    shape, scale = mean * mean / var, var / mean
    low, high = gammainc(shape, value / scale), gammaincc(shape, value / scale)
    return np.minimum(1.0, 2.0 * np.minimum(low, high)), np.where(value < mean, -1.0, 1.0)


def correlation_p(rho: F8, pairs: F8) -> F8:
    """Two-sided chance of a correlation of independent normals as far from zero, ``pairs`` products each.

    rho^2 is Beta(1/2, (pairs - 1) / 2), see `starwise.analysis.consistency.whiteness_bound`.
    """
    from scipy.special import betainc

    n = np.maximum(pairs, 2.0)
    return np.asarray(1.0 - betainc(0.5, 0.5 * (n - 1.0), np.minimum(1.0, rho * rho)))


def sidak(p: F8 | float, count: int) -> F8:
    """P-value of the smallest of ``count`` independent ones: 1 - (1 - p)^count, without cancellation."""
    return np.asarray(-np.expm1(count * np.log1p(-np.minimum(np.asarray(p, dtype=np.float64), 1.0 - 1e-16))))


def holm(p: F8) -> F8:
    """Adjusted p-values by Holm's step-down with Sidak's steps; NaN stays NaN and does not count.

    Holm (1979), "A simple sequentially rejective multiple test procedure", Scand. J. Statist. 6.
    """
    out = np.full(len(p), np.nan)
    there = np.flatnonzero(np.isfinite(p))
    order = there[np.argsort(p[there], kind="stable")]
    if len(order):
        steps = np.array([float(sidak(p[k], len(order) - i)) for i, k in enumerate(order)])
        out[order] = np.maximum.accumulate(steps)
    return out


def whiteness_bounds(pairs: F8) -> F8:
    """Bound that one autocorrelation of a white series keeps with 95 %, by the number of its products; NaN below 3."""
    from scipy.special import betaincinv

    n = np.where(pairs >= 3.0, pairs, np.nan)
    return np.asarray(np.sqrt(betaincinv(0.5, 0.5 * (n - 1.0), 0.95)))
