"""The compressed measurement update: all rows reduced to the observed dimensions first, then one small update.

The rows of `starwise.kernels.update` see position, velocity, clock biases and drifts: k = 6 + 2 n_clocks of the n
states (a static receiver: no velocities), however many satellites there are. All that they say of the state is

    Lambda = H' R^-1 H   and   y = H' R^-1 v        (k x k and k: a few products per satellite)

With Lambda = L L' the m satellites are as good as k uncorrelated measurements with rows L' of unit variance and
innovations z = L^-1 y (Golub and Van Loan 2013, 4.2 and 5.3: normal equations and their factor; Bierman 1977, ch. V:
packets of rows reduced before they meet the covariance). These are processed in pairs, one after another:

    NIS = (v' R^-1 v - z' z) + sum of the NIS of the k pseudo-measurements

Law: equal to `update_batch` and, for rows linear in the state, `update_sequential`, both without gates. It cannot
test satellites one by one (rows are mixed before anything is decided), nor evaluate h and H at the state that the
satellite before has left.
"""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.update import mirror

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

NO_INFORMATION = 1e-13
"""A pivot below this part of its diagonal element is rounding: nothing is known of that direction."""


@njit
def normal_rows(
    x: F8, n: int, nk: int, moving: bool, ic: I8, idr: I8, u: F8, g: F8, v: F8, r: F8, m: int, N: F8, y: F8,
) -> tuple[float, int]:  # fmt: skip
    """Normal matrix N = H' R^-1 H (lower triangle) and y = H' R^-1 v of m satellites, at the observed states.

    Observed states in order: position, velocity (if moving), everything from ``nk`` on. Arguments as
    `update_compressed`.

    Returns
    -------
    square : float
        v' R^-1 v.
    rows : int
        Number of rows.
    """
    shift = nk - 6 if moving else nk - 3
    k = n - shift
    for i in range(k):
        y[i] = 0.0
        for j in range(k):
            N[i, j] = 0.0
    square, rows = 0.0, 0
    for s in range(m):
        c, d = ic[s] - shift, idr[s] - shift
        ux, uy, uz = u[s, 0], u[s, 1], u[s, 2]
        v1 = v[s, 0] - (x[ic[s]] - ux * x[0] - uy * x[1] - uz * x[2])
        w = 1.0 / r[s, 0]
        wv = w * v1
        square += wv * v1
        rows += 1
        wx, wy, wz = w * ux, w * uy, w * uz
        N[0, 0] += wx * ux
        N[1, 0] += wy * ux
        N[1, 1] += wy * uy
        N[2, 0] += wz * ux
        N[2, 1] += wz * uy
        N[2, 2] += wz * uz
        N[c, 0] -= wx
        N[c, 1] -= wy
        N[c, 2] -= wz
        N[c, c] += w
        y[0] -= ux * wv
        y[1] -= uy * wv
        y[2] -= uz * wv
        y[c] += wv
        if not r[s, 1] < np.inf:
            continue
        gx, gy, gz = g[s, 0], g[s, 1], g[s, 2]
        v2 = v[s, 1] - (x[idr[s]] + gx * x[0] + gy * x[1] + gz * x[2])
        w = 1.0 / r[s, 1]
        qx, qy, qz = w * gx, w * gy, w * gz
        N[0, 0] += qx * gx
        N[1, 0] += qy * gx
        N[1, 1] += qy * gy
        N[2, 0] += qz * gx
        N[2, 1] += qz * gy
        N[2, 2] += qz * gz
        N[d, 0] += qx
        N[d, 1] += qy
        N[d, 2] += qz
        N[d, d] += w
        if moving:
            v2 += ux * x[3] + uy * x[4] + uz * x[5]
            wx, wy, wz = w * ux, w * uy, w * uz
            N[3, 3] += wx * ux
            N[4, 3] += wy * ux
            N[4, 4] += wy * uy
            N[5, 3] += wz * ux
            N[5, 4] += wz * uy
            N[5, 5] += wz * uz
            N[3, 0] -= wx * gx
            N[3, 1] -= wx * gy
            N[3, 2] -= wx * gz
            N[4, 0] -= wy * gx
            N[4, 1] -= wy * gy
            N[4, 2] -= wy * gz
            N[5, 0] -= wz * gx
            N[5, 1] -= wz * gy
            N[5, 2] -= wz * gz
            N[d, 3] -= wx
            N[d, 4] -= wy
            N[d, 5] -= wz
        wv = w * v2
        square += wv * v2
        rows += 1
        y[0] += gx * wv
        y[1] += gy * wv
        y[2] += gz * wv
        if moving:
            y[3] -= ux * wv
            y[4] -= uy * wv
            y[5] -= uz * wv
        y[d] += wv
    return square, rows


@njit
def factor(N: F8, y: F8, k: int) -> None:
    """Cholesky factor L of N (lower triangle, in place) and z = L^-1 y; columns without information become zero."""
    for j in range(k):
        d = N[j, j]
        floor = NO_INFORMATION * d
        for i in range(j):
            d -= N[j, i] * N[j, i]
        if not d > floor:
            for i in range(j, k):
                N[i, j] = 0.0
            y[j] = 0.0
            continue
        d = 1.0 / math.sqrt(d)
        t = y[j]
        for i in range(j):
            t -= N[j, i] * y[i]
        y[j] = t * d
        for i in range(j, k):
            t = N[i, j]
            for a in range(j):
                t -= N[i, a] * N[j, a]
            N[i, j] = t * d


@njit
def update_compressed(
    x: F8, P: F8, n: int, nk: int, moving: bool, ic: I8, idr: I8, u: F8, g: F8, v: F8, r: F8, m: int,
) -> tuple[float, int]:  # fmt: skip
    """Update with m satellites, their rows reduced to the observed states first; x and P in place; no gates.

    Parameters
    ----------
    x : (>= n,)
        Deviation from the state at which the rows were linearised: zeros, usually.
    P : (>= n, >= n)
        Covariance.
    n : int
        Number of states.
    nk : int
        Kinematic states: 3, 6 or 9; the clocks follow.
    moving : bool
        The state has velocities at 3..5.
    ic, idr : (>= m,) int64
        Index of the clock bias and drift of each satellite's system.
    u, g : (>= m, 3)
        Unit vectors receiver to satellite; gradients of the rates with respect to the position, 1/s.
    v, r : (>= m, 2)
        Innovations at x = 0 and variances, code and rate (r = inf: no rate).
    m : int
        Number of satellites.

    Returns
    -------
    nis : float
        Normalised innovation squared of all rows.
    dof : int
        Their number.
    """
    shift = nk - 6 if moving else nk - 3
    k = n - shift
    head = k - (n - nk)  # observed kinematic states; the rest stands at nk and behind
    work = np.empty((k + 3, n))
    N, z, a, b = work[:k], work[k], work[k + 1], work[k + 2]
    nis, rows = normal_rows(x, n, nk, moving, ic, idr, u, g, v, r, m, N, z)
    factor(N, z, k)
    for i in range(k):
        nis -= z[i] * z[i]
    # The rows are those of L'; z holds innovations at the deviation x = 0 of this moment, so the change is kept apart.
    dx = np.zeros(n)
    for p in range(0, k, 2):
        for i in range(n):
            a[i], b[i] = 0.0, 0.0
        v1, v2 = z[p], z[p + 1] if p + 1 < k else 0.0
        for i in range(p, k):
            row = i if i < head else i + shift
            h1, h2 = N[i, p], N[i, p + 1] if p < i and p + 1 < k else 0.0
            v1 -= h1 * dx[row]
            v2 -= h2 * dx[row]
            for j in range(n):
                t = P[row, j]
                a[j] += h1 * t
                b[j] += h2 * t
        s11, s21, s22 = 1.0, 0.0, 1.0
        for i in range(p, k):
            row = i if i < head else i + shift
            s11 += N[i, p] * a[row]
            if p < i and p + 1 < k:
                s21 += N[i, p + 1] * a[row]
                s22 += N[i, p + 1] * b[row]
        det = 1.0 / (s11 * s22 - s21 * s21)
        m11, m21, m22 = s22 * det, -s21 * det, s11 * det
        y1, y2 = m11 * v1 + m21 * v2, m21 * v1 + m22 * v2
        nis += v1 * y1 + v2 * y2
        for i in range(n):
            ai, bi = a[i], b[i]
            dx[i] += ai * y1 + bi * y2
            ka, kb = m11 * ai + m21 * bi, m21 * ai + m22 * bi
            for j in range(n):
                P[i, j] -= ka * a[j] + kb * b[j]
    for i in range(n):
        x[i] += dx[i]
    mirror(P, n)
    return nis, rows
