"""Small symmetric systems and medians by hand: LAPACK calls inside a kernel cost four times the compile time."""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit

F8 = NDArray[np.float64]


@njit
def cholesky(A: F8, n: int) -> bool:
    """Lower Cholesky factor of the leading n x n block of A, in place; the upper part is left alone.

    Returns
    -------
    bool
        False if a pivot is not safely positive (below 1e-12 of its diagonal element): singular for this purpose.
    """
    for j in range(n):
        d = A[j, j]
        limit = 1e-12 * abs(d)
        for k in range(j):
            d -= A[j, k] * A[j, k]
        if not d > limit:
            return False
        d = math.sqrt(d)
        A[j, j] = d
        for i in range(j + 1, n):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = s / d
    return True


@njit
def cholesky_solve(L: F8, b: F8, n: int) -> None:
    """Solve L L' x = b in place for the leading n elements of b."""
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= L[i, k] * b[k]
        b[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = b[i]
        for k in range(i + 1, n):
            s -= L[k, i] * b[k]
        b[i] = s / L[i, i]


@njit
def cholesky_inverse(L: F8, out: F8, n: int) -> None:
    """Inverse of L L' (leading n x n block) into ``out``, symmetric."""
    column = np.zeros(n)
    for j in range(n):
        for i in range(n):
            column[i] = 0.0
        column[j] = 1.0
        cholesky_solve(L, column, n)
        for i in range(j + 1):
            out[i, j] = column[i]
            out[j, i] = column[i]


@njit
def median(values: F8, n: int) -> float:
    """Median of the first n values, which are sorted in place (few)."""
    for i in range(1, n):
        v = values[i]
        j = i - 1
        while j >= 0 and values[j] > v:
            values[j + 1] = values[j]
            j -= 1
        values[j + 1] = v
    return float(0.5 * (values[(n - 1) // 2] + values[n // 2]))
