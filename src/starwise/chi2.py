"""Points of the chi-square distribution for whole degrees of freedom: without scipy, whose import takes 0.2 s."""

import math

import numpy as np
from numpy.typing import NDArray


def chi_square_points(false_alarm: float, size: int) -> NDArray[np.float64]:
    """Values that a chi-square variable exceeds with a probability, by degrees of freedom.

    The survival function is a finite sum for whole degrees of freedom k (Abramowitz & Stegun 26.4.4 and 26.4.5):

        Q(x) = [k odd: erfc(sqrt(x / 2))] + sum over a of exp(-x / 2) (x / 2)^a / Gamma(a + 1)

    with a = 0, 1 .. k / 2 - 1 (k even) or 1 / 2, 3 / 2 .. k / 2 - 1 (k odd). It is inverted by Newton's method on
    log Q, begun at the bound k + 2 sqrt(k L) + 2 L with L = -log(false_alarm) (Laurent & Massart, Ann. Statist. 28,
    2000, lemma 1), from where the steps do not overshoot.

    Parameters
    ----------
    false_alarm : float
        Probability, 0 < false_alarm <= 1.
    size : int
        Points are given for 0 .. size - 1 degrees of freedom; the first is that of one.

    Returns
    -------
    (size,) float64
    """
    k = np.maximum(np.arange(size, dtype=np.float64), 1.0)
    if false_alarm >= 1.0:
        return np.zeros(size)
    log_p = math.log(false_alarm)
    odd = k % 2.0 == 1.0
    a = np.arange((size + 1) // 2) + np.where(odd, 0.5, 0.0)[:, None]  # (size, terms)
    missing = a > k[:, None] / 2.0 - 0.75
    log_gamma = _log_gamma(size)[(2.0 * a).astype(np.intp)]
    log_gamma_half = _log_gamma(size)[k.astype(np.intp) - 2]  # Gamma(k / 2); k = 1 is set below
    log_gamma_half[k == 1.0] = 0.5 * math.log(math.pi)
    x = k + 2.0 * np.sqrt(-k * log_p) - 2.0 * log_p
    for _ in range(60):
        log_half = np.log(x / 2.0)
        terms = np.exp(a * log_half[:, None] - x[:, None] / 2.0 - log_gamma)
        q = np.where(missing, 0.0, terms).sum(axis=1)
        q[odd] += [math.erfc(math.sqrt(value / 2.0)) for value in x[odd]]
        log_density = (k / 2.0 - 1.0) * log_half - x / 2.0 - log_gamma_half - math.log(2.0)
        step = (np.log(q) - log_p) * q / np.exp(log_density)
        x = np.maximum(x + step, x / 10.0)
        if (np.abs(step) <= 1e-13 * x).all():
            break
    return x


def _log_gamma(size: int) -> NDArray[np.float64]:
    """Log of Gamma(a + 1) for a = 0, 1/2, 1 .. (size + 1) / 2, by the index 2 a."""
    return np.array([math.lgamma(i / 2.0 + 1.0) for i in range(size + 3)])
