"""Several receivers' fixes of one epoch: their combination, their differences, and the one that contradicts the rest.

Differences of receivers contain no motion: their size tells the scale of the noise, their correlation from epoch to
epoch how long errors last, and a receiver far from the others is at fault, however the vehicle moves.
"""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit

F8 = NDArray[np.float64]


@njit
def screen(z: F8, r: F8, scale2: float, expected: F8, gate: float, keep: NDArray[np.bool_]) -> None:
    """Refuse fixes that contradict the others, the worst first, until the rest agree.

    Each fix is tested against the combination of the others. Of two that disagree the one farther from ``expected``
    goes, because nothing else can tell; one alone is believed.

    Parameters
    ----------
    z, r : (receivers, 3)
    scale2 : float
        On the variances.
    expected : (3,)
        Where the last estimate leads; NaN: nowhere.
    gate : float
    keep : (receivers,)
        Fixes to be tested; False on return for those refused.
    """
    K = len(z)
    for _ in range(K):
        count = 0
        for k in range(K):
            count += 1 if keep[k] else 0
        if count < 2:
            return
        worst, most = -1, gate
        for k in range(K):
            if not keep[k]:
                continue
            s, far = 0.0, 0.0
            for a in range(3):
                weight, total = 0.0, 0.0
                for j in range(K):
                    if keep[j] and j != k:
                        weight += 1.0 / r[j, a]
                        total += z[j, a] / r[j, a]
                s += (z[k, a] - total / weight) ** 2 / (scale2 * (r[k, a] + 1.0 / weight))
                far += (z[k, a] - expected[a]) ** 2 / r[k, a]
            if count == 2 and s > gate:
                if math.isnan(far):
                    return
                s = gate + far  # the statistic is the same for both
            if s > most:
                worst, most = k, s
        if worst < 0:
            return
        keep[worst] = False


@njit
def combine(z: F8, r: F8, zc: F8, rc: F8, deviation: F8) -> tuple[float, float, int]:
    """Inverse-variance combination of fixes z, r (receivers, 3) into zc, rc (3,); statistics of their differences.

    ``deviation`` (receivers, 3) holds the normalised deviations from the combination of the epoch before (NaN: none),
    and of this one on return.

    Returns
    -------
    float, float, int
        Sum of the squared deviations, sum of their products with those of the epoch before, degrees of freedom.
    """
    chi2, product, dof = 0.0, 0.0, 0
    for a in range(3):
        weight, total = 0.0, 0.0
        count = 0
        for k in range(len(z)):
            if not math.isnan(z[k, a]):
                weight += 1.0 / r[k, a]
                total += z[k, a] / r[k, a]
                count += 1
        zc[a] = total / weight if count else math.nan
        rc[a] = 1.0 / weight if count else math.nan
        for k in range(len(z)):
            d = (z[k, a] - zc[a]) / math.sqrt(r[k, a])  # NaN where there is no fix
            if not math.isnan(d):
                chi2 += d * d
                if not math.isnan(deviation[k, a]):
                    product += d * deviation[k, a]
            deviation[k, a] = d
        dof += max(count - 1, 0)
    return chi2, product, dof


@njit
def combine_kept(z: F8, r: F8, keep: NDArray[np.bool_], zc: F8, rc: F8) -> None:
    """Inverse-variance combination of the fixes that are kept."""
    for a in range(3):
        weight, total = 0.0, 0.0
        for k in range(len(z)):
            if keep[k]:
                weight += 1.0 / r[k, a]
                total += z[k, a] / r[k, a]
        zc[a] = total / weight if weight > 0.0 else math.nan
        rc[a] = 1.0 / weight if weight > 0.0 else math.nan


@njit
def remember_refusals(z: F8, keep: NDArray[np.bool_], rate: F8) -> None:
    """How often each receiver has been refused of late, mean over some 10 epochs."""
    for k in range(len(z)):
        if not math.isnan(z[k, 0]):
            rate[k] += 0.1 * ((0.0 if keep[k] else 1.0) - rate[k])
