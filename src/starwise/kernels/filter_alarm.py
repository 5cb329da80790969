"""Signs that a filter is lost although most of an epoch agrees with it, or nothing of it is used.

A wrong position that is not wrong enough for most codes to contradict it is explained away: some codes stay outside the
gate, and the states of lasting errors take what they never have. From a place that is very wrong all satellites are
below the horizon. None of these makes an epoch fail, and a filter with such a position kept it for hours. They are
looked at over epochs; what they raise is only a suspicion, and least squares decides (`contradicted`): a street, or a
storm in the ionosphere, raises it as well.
"""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.constants import ROW_EXCLUDED, ROW_USED
from starwise.kernels._jit import njit
from starwise.kernels.error_states import ErrorModel, Slots, n_errors
from starwise.kernels.filter_state import Work
from starwise.kernels.rangemodel import RowModel, Rows
from starwise.kernels.update import USED_CODE

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

FEWEST_CODES = 6  # codes from which on a part of them says something
FEWEST_IN_VIEW = 4
REFUSED_USUAL = 0.15  # part of the codes outside the gate that a faulty satellite, or a street, explains
REFUSED_ALARM = 0.5  # sum over epochs of what exceeds it
STRAIN = 2.0  # sum of squares over the most that the model allows from which on lasting errors are strained
STRAIN_SIGMAS = 4.0  # above its mean, if the model holds
CONTRADICTION = 36.0  # squared distance from least squares (whose covariance takes errors for white), in variances


@njit
def refused_part(rows: Rows, m: int, at: I8, work: Work) -> float:
    """Part of the codes of an epoch outside the gate; a system of which all are is one whose clock stepped."""
    count, refused = 0, 0
    for c in range(len(at)):
        own, used = 0, 0
        for k in range(m):
            if rows.clock[work.order[k]] == c:
                own += 1
                used += 1 if work.used[k] & USED_CODE else 0
        if used > 0:
            count += own
            refused += own - used
    return refused / count if count >= FEWEST_CODES else 0.0


@njit
def are_strained(errors: ErrorModel, slots: Slots, x: F8, P: F8, base: int) -> bool:
    """Whether the estimates of lasting errors are far larger than their prior allows.

    If the model holds, the sum of their squares has the mean sum of 1 - P, and is spread like a chi-square of as many
    degrees of freedom.
    """
    total, allowed = 0.0, 0.0
    for i in range(base, base + n_errors(errors, slots)):
        total += x[i] * x[i]
        allowed += 1.0 - P[i, i]
    allowed = max(allowed, 1.0)
    return total > STRAIN * (allowed + STRAIN_SIGMAS * math.sqrt(2.0 * allowed))


@njit
def contradicted(xs: F8, Ps: F8, x: F8, P: F8) -> bool:
    """Whether a position of least squares ``xs`` (with covariance) is farther from the filter's than both allow."""
    gone2, var = 0.0, 0.0
    for i in range(3):
        gone2 += (xs[i] - x[i]) ** 2
        var += Ps[i, i] + P[i, i]
    return gone2 > CONTRADICTION * var


@njit
def can_judge(out: RowModel, start: int, end: int, redundancy: int) -> bool:
    """Whether least squares has codes enough to contradict a filter, and refuses few of them.

    With fewer redundant codes than unknowns, or many left out, reflections agree with each other on a wrong place:
    there it is the filter, with its memory, that knows better.
    """
    used, excluded = 0, 0
    for i in range(start, end):
        used += 1 if out.status[i] == ROW_USED else 0
        excluded += 1 if out.status[i] == ROW_EXCLUDED else 0
    return 2 * redundancy >= used and excluded <= REFUSED_USUAL * (used + excluded)


@njit
def in_view(rows: Rows, start: int, end: int) -> int:
    """Codes of an epoch that only the elevation mask, seen from a wrong place, can keep away."""
    count = 0
    for i in range(start, end):
        count += 1 if rows.status[i] == ROW_USED else 0
    return count
