"""Which local filter is at fault: separation of solutions, innovations, and clocks that leave each other."""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.federated import Locals, Options
from starwise.kernels.linalg import cholesky, cholesky_inverse, cholesky_solve

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]


@njit
def separations(x: F8, P: F8, use: Bool, tested: Bool, n: int, m: int, out: F8) -> None:
    """Squared distance of local filters from the fusion of the others in use, over both covariances.

    Parameters
    ----------
    x, P : (K, >= n), (K, >= n, >= n)
    use, tested : (K,) bool
        Those that the fusion is made of; those to be tested, in use or not.
    n, m : int
        Common states; leading ones of them that are tested.
    out : (K,)
        Chi-square with m degrees of freedom; NaN where not tested or nothing to compare with.
    """
    K = len(use)
    J, y = np.zeros((K, n, n)), np.zeros((K, n))
    A, B, J_o, y_o = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    count = 0
    for k in range(K):
        out[k] = math.nan
        if use[k]:
            for i in range(n):
                for j in range(n):
                    A[i, j] = P[k, i, j]
            if not cholesky(A, n):
                return
            cholesky_inverse(A, J[k], n)
            count += 1
            for i in range(n):
                for j in range(n):
                    y[k, i] += J[k, i, j] * (x[k, j] - x[0, j])
    for k in range(K):
        if not tested[k] or count - (1 if use[k] else 0) < 1:
            continue
        for i in range(n):
            y_o[i] = 0.0
            for j in range(n):
                J_o[i, j] = 0.0
        for other in range(K):
            if use[other] and other != k:
                for i in range(n):
                    y_o[i] += y[other, i]
                    for j in range(n):
                        J_o[i, j] += J[other, i, j]
        if not cholesky(J_o, n):
            continue
        cholesky_solve(J_o, y_o, n)
        cholesky_inverse(J_o, B, n)
        for i in range(m):
            y_o[i] = x[k, i] - x[0, i] - y_o[i]
            for j in range(m):
                A[i, j] = P[k, i, j] + B[i, j]
        if not cholesky(A, m):
            continue
        total = 0.0
        for i in range(m):  # L^-1 d, then its square
            for j in range(i):
                y_o[i] -= A[i, j] * y_o[j]
            y_o[i] /= A[i, i]
            total += y_o[i] * y_o[i]
        out[k] = total


@njit
def watch_clocks(options: Options, locals_: Locals, use: Bool, level: F8, suspect: Bool) -> None:
    """Mark the local filter whose clock leaves all others' by more than clocks do.

    Parameters
    ----------
    options, locals_
    use : (K,) bool
    level : (K, K, 2)
        Estimate and variance of the difference of two clocks (variance 0: not known yet), brought up to date.
    suspect : (K,) bool
        Result: its differences to at least two other clocks have left their levels, and no other difference has.
    """
    K, c = len(use), options.clock
    bad = np.zeros(K, dtype=np.int64)
    pairs = 0
    for i in range(K):
        for j in range(i):
            if not (use[i] and use[j]):
                continue
            d = locals_.x[i, c] - locals_.x[j, c]
            s = locals_.P[i, c, c] + locals_.P[j, c, c]
            if level[i, j, 1] == 0.0:
                level[i, j, 0], level[i, j, 1] = d, s
                continue
            level[i, j, 1] += options.clock_psd
            v = d - level[i, j, 0]
            if v * v > options.clock_gate * (s + level[i, j, 1]):
                bad[i] += 1
                bad[j] += 1
                pairs += 1
                continue
            # a clock estimate is a filter's: its errors stay for tens of epochs, and count once in so many
            k = level[i, j, 1] / (level[i, j, 1] + 30.0 * s)
            level[i, j, 0] += k * v
            level[i, j, 1] *= 1.0 - k
    for i in range(K):
        suspect[i] = bad[i] >= 2 and bad[i] == pairs


@njit
def isolate(
    options: Options,
    locals_: Locals,
    present: Bool,
    use: Bool,
    suspect: Bool,
    level: F8,
    failed: I8,
    agreed: I8,
    out_of: Bool,
    statistic: F8,
) -> None:
    """Take the worst failing local filter out of ``use``, and bring back those that agree again."""
    K = len(use)
    clock, tested = np.zeros(K, dtype=np.bool_), np.zeros(K, dtype=np.bool_)
    if options.clock >= 0:
        watch_clocks(options, locals_, use, level, clock)
    count = 0
    for k in range(K):
        count += 1 if use[k] else 0
        tested[k] = use[k] or (out_of[k] and present[k])
    separations(locals_.x, locals_.P, use, tested, options.nc, options.test_states, statistic)
    worst, most = -1, 0.0
    for k in range(K):
        if not tested[k]:
            continue
        s = statistic[k]
        apart = s > options.separation_gate
        if out_of[k]:
            agreed[k] = 0 if apart or suspect[k] or math.isnan(s) else agreed[k] + 1
            continue
        failed[k] = failed[k] + 1 if (apart and count >= 3) or clock[k] or (suspect[k] and present[k]) else 0
        weight = max(0.0 if math.isnan(s) else s, 1e9 if clock[k] else 0.0, 1e-9)
        if failed[k] >= options.patience and weight > most and count >= 2:
            worst, most = k, weight
    if worst >= 0:
        out_of[worst], use[worst] = True, False
        failed[worst] = 0
        agreed[worst] = -1  # to be started anew once the master knows where
        for k in range(K):
            failed[k] = 0  # their fusion of the others was with the bad one
            level[worst, k, 1] = level[k, worst, 1] = 0.0
    for k in range(K):
        if out_of[k] and agreed[k] >= options.probation:
            out_of[k], failed[k], agreed[k] = False, 0, 0
            use[k] = present[k]
