"""Fixed-interval smoothing of an inertial run: the Rauch-Tung-Striebel estimate in Bierman's form.

The filter leaves a record of every transition and every update. Backwards over them run

    update      lambda = (I - K H)' lambda + H' S^-1 v,     Lambda = (I - K H)' Lambda (I - K H) + H' S^-1 H
    transition  lambda = Phi' lambda,                       Lambda = Phi' Lambda Phi

and at any node in between, where the filter had the estimate x and covariance P,

    smoothed    x + P lambda,                               P - P Lambda P.

No covariance is inverted, so states that are known exactly do no harm. The filter is closed-loop: x is the estimate at the
node itself, and v the innovations at the predicted one, which is what the recursion wants.

Source: Bierman (1977) "Factorization methods for discrete sequential estimation", ch. X; the same as Rauch, Tung,
Striebel (1965) for the same model.
"""  # noqa: E501

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.ins_error import feed_back
from starwise.kernels.ins_state import At, Motion

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

TRANSITION = 0
NODE = 4  # 1, 2, 3: update with so many rows


class Records(NamedTuple):
    """What smoothing needs, in the order of time; a row per transition, update and node."""

    kind: I8  # (k,)
    node: I8  # (k,) index of a node
    data: F8  # (k, 10 n + 12)
    used: I8  # (1,) rows written


@njit
def record_transition(n: int, mo: Motion, rec: Records) -> None:
    """Append the transition since the last record, if time has passed."""
    if not mo.since[0] > 0.0:
        return
    r = rec.used[0]
    rec.kind[r] = TRANSITION
    for j in range(n):
        for i in range(9):
            rec.data[r, i * n + j] = mo.top[i, j]
        rec.data[r, 9 * n + j] = mo.diag[j]
    rec.data[r, 10 * n] = mo.since[0]
    rec.used[0] = r + 1


@njit
def record_update(n: int, m: int, H: F8, K: F8, S: F8, v: F8, rec: Records) -> None:
    """Append an update with m rows: its Jacobian, gain, inverse innovation covariance and innovations."""
    r = rec.used[0]
    rec.kind[r] = m
    for a in range(m):
        for j in range(n):
            rec.data[r, a * n + j] = H[a, j]
            rec.data[r, (3 + a) * n + j] = K[a, j]
        for b in range(m):
            rec.data[r, 6 * n + 3 * a + b] = S[a, b]
        rec.data[r, 6 * n + 9 + a] = v[a]
    rec.used[0] = r + 1


@njit
def record_node(k: int, rec: Records) -> None:
    """Append a node."""
    r = rec.used[0]
    rec.kind[r] = NODE
    rec.node[r] = k
    rec.used[0] = r + 1


@njit
def _back_update(d: F8, n: int, m: int, lam: F8, L: F8, G: F8, LK: F8) -> None:
    """Over an update: Lambda - H'(K' Lambda) - (Lambda K) H + H' (K' Lambda K + S^-1) H."""
    for a in range(m):
        t = 0.0
        for j in range(n):
            t += d[(3 + a) * n + j] * lam[j]
        g = -t
        for b in range(m):
            g += d[6 * n + 3 * a + b] * d[6 * n + 9 + b]
        G[a, 3] = g  # S^-1 v - K' lambda
        for i in range(n):
            t = 0.0
            for j in range(n):
                t += L[i, j] * d[(3 + a) * n + j]
            LK[a, i] = t
    for a in range(m):
        for b in range(m):
            t = d[6 * n + 3 * a + b]
            for j in range(n):
                t += d[(3 + a) * n + j] * LK[b, j]
            G[a, b] = t
    for a in range(m):
        for j in range(n):
            lam[j] += d[a * n + j] * G[a, 3]
        for i in range(n):
            h = d[a * n + i]
            w = -LK[a, i]
            for b in range(m):
                w += 0.5 * G[a, b] * d[b * n + i]
            if h != 0.0 or w != 0.0:
                for j in range(n):
                    L[i, j] += w * d[a * n + j]
                    L[j, i] += w * d[a * n + j]


@njit
def _back_transition(d: F8, n: int, at: At, lam: F8, L: F8, Y: F8) -> None:
    """Over a transition: Phi' lambda, Phi' Lambda Phi."""
    clk, since = at.clk, d[10 * n]
    for i in range(n):
        for j in range(n):
            Y[i, j] = L[i, j] * d[9 * n + j] if j >= 9 else 0.0
        if clk >= 0:
            Y[i, clk + 1] += since * L[i, clk]
        for k in range(9):
            t = L[i, k]
            if t != 0.0:
                for j in range(n):
                    Y[i, j] += t * d[k * n + j]
    for i in range(n):
        for j in range(n):
            L[i, j] = Y[i, j] * d[9 * n + i] if i >= 9 else 0.0
    if clk >= 0:
        for j in range(n):
            L[clk + 1, j] += since * Y[clk, j]
    for k in range(9):
        for i in range(n):
            t = d[k * n + i]
            if t != 0.0:
                for j in range(n):
                    L[i, j] += t * Y[k, j]
    for i in range(n):
        for j in range(i):
            t = 0.5 * (L[i, j] + L[j, i])
            L[i, j] = t
            L[j, i] = t
    for j in range(n):
        Y[0, j] = lam[j] * d[9 * n + j] if j >= 9 else 0.0
    if clk >= 0:
        Y[0, clk + 1] += since * lam[clk]
    for k in range(9):
        for j in range(n):
            Y[0, j] += d[k * n + j] * lam[k]
    for j in range(n):
        lam[j] = Y[0, j]


@njit
def smooth(rec: Records, n: int, at: At, nav: F8, est: F8, P: F8) -> None:
    """Smoothed states and covariances at the nodes, in place of the filter's.

    Parameters
    ----------
    rec : Records
    n : int
    at : At
    nav : (k, 10)
    est : (k, n)
    P : (k, n, n)
    """
    lam, L, Y, Z = np.zeros(n), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    G, LK, x = np.zeros((3, 4)), np.zeros((3, n)), np.zeros(n)
    for r in range(rec.used[0] - 1, -1, -1):
        kind = rec.kind[r]
        if kind == TRANSITION:
            _back_transition(rec.data[r], n, at, lam, L, Y)
        elif kind != NODE:
            _back_update(rec.data[r], n, kind, lam, L, G, LK)
        else:
            k = rec.node[r]
            p = P[k]
            for i in range(n):
                x[i] = 0.0
                for j in range(n):
                    x[i] += p[i, j] * lam[j]
                    Y[i, j] = 0.0
                    Z[i, j] = 0.0
                for m in range(n):
                    for j in range(n):
                        Y[i, j] += p[i, m] * L[m, j]
            for i in range(n):
                for m in range(n):
                    for j in range(n):
                        Z[i, j] += Y[i, m] * p[m, j]
            for i in range(n):
                for j in range(n):
                    p[i, j] -= 0.5 * (Z[i, j] + Z[j, i])
            bias = est[k, 9:15]
            feed_back(x, nav[k], bias)
            for j in range(15, n):
                est[k, j] += x[j]
                x[j] = 0.0
