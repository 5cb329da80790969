"""Measurement updates of a satellite filter: one satellite at a time, and all satellites at once.

Both take the same rows: satellite k gives a pseudorange, and a pseudorange rate unless its variance is not finite,

    code  h = -u' pos + clk                 four non-zeros, at 0..2 and ``ic[k]``
    rate  h =  g' pos - u' vel + drift      seven, at 0..2, 3..5 and ``idr[k]``; no velocity for a static receiver

with errors that are independent between satellites (R block-diagonal: the condition of sequential processing). Both
decide row by row, in the order given, on the innovation *conditioned on the satellites accepted before*:

    nis_k = [v_c v_r] S_k^-1 [v_c v_r]'    against a chi-square threshold with 2 degrees of freedom.

In the sequential form that is the innovation at hand; in the batch form it is the block of L^-1 v that belongs to the
satellite, where L is the Cholesky factor of S grown satellite by satellite (a rejected one is never appended).
So they take the same decisions and give the same x, P and sum of NIS.

If the pair fails together, the rate is tried alone, then the code alone (1 degree of freedom): multipath spoils the
code of a satellite far more often than its Doppler shift.

P is stored in full and leaves every update exactly symmetric.

Sources: Groves (2013) 3.2.2 and 3.2.7 (sequential processing), 17.3 (innovation filtering); Bierman (1977)
"Factorization methods for discrete sequential estimation", ch. II.
"""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]

USED_NONE = 0
USED_CODE = 1
USED_RATE = 2
USED_BOTH = 3


@njit
def update_satellite(
    x: F8, P: F8, n: int, moving: bool, ic: int, idr: int, ux: float, uy: float, uz: float,
    gx: float, gy: float, gz: float, v1: float, v2: float, r1: float, r2: float,
    gate1: float, gate2: float, a: F8, b: F8,
) -> tuple[int, float, float, float]:  # fmt: skip
    """Update of state and covariance with one satellite (eq. 5c of the S3EKF paper), in place.

    The lower triangle of P is what counts; call `mirror` after the last satellite of an epoch (inside an epoch both
    triangles are carried, equal to the last bit or two).

    Parameters
    ----------
    x : (>= n,)
        State, in place.
    P : (>= n, >= n)
        Its covariance, in place.
    n : int
        Number of states.
    moving : bool
        The state has velocities at 3..5.
    ic, idr : int
        Index of the clock bias and drift of the satellite's system.
    ux, uy, uz : float
        Unit vector from receiver to satellite.
    gx, gy, gz : float
        Gradient of the rate with respect to the position, 1/s.
    v1, v2 : float
        Innovations of code (m) and rate (m/s) at ``x``.
    r1, r2 : float
        Variances; the rate is ignored if r2 is inf.
    gate1, gate2 : float
        Chi-square thresholds for 1 and 2 degrees of freedom; inf: no gate.
    a, b : (>= n,)
        Work space.

    Returns
    -------
    used : int
        ``USED_*``.
    nis : float
        Of the rows used.
    s11, s22 : float
        Innovation variances; s22 is NaN without a rate.
    """
    paired = r2 < np.inf
    if moving:
        for i in range(n):
            a[i] = P[ic, i] - ux * P[0, i] - uy * P[1, i] - uz * P[2, i]  # P h, code
            b[i] = (P[idr, i] + gx * P[0, i] + gy * P[1, i] + gz * P[2, i]) - (
                ux * P[3, i] + uy * P[4, i] + uz * P[5, i]
            )  # P h, rate
        s21 = -ux * a[3] - uy * a[4] - uz * a[5]
        s22 = r2 - ux * b[3] - uy * b[4] - uz * b[5]
    else:
        for i in range(n):
            a[i] = P[ic, i] - ux * P[0, i] - uy * P[1, i] - uz * P[2, i]
            b[i] = P[idr, i] + gx * P[0, i] + gy * P[1, i] + gz * P[2, i]
        s21, s22 = 0.0, r2
    s21 += a[idr] + gx * a[0] + gy * a[1] + gz * a[2]
    s22 += b[idr] + gx * b[0] + gy * b[1] + gz * b[2]
    s11 = a[ic] - ux * a[0] - uy * a[1] - uz * a[2] + r1
    # M = S^-1, y = M v; a row that is not used has zeros in M.
    m11, m21, m22 = 1.0 / s11, 0.0, 0.0
    if paired:
        det = s11 * s22 - s21 * s21
        m11, m21, m22 = s22 / det, -s21 / det, s11 / det
        y1, y2 = m11 * v1 + m21 * v2, m21 * v1 + m22 * v2
        nis = v1 * y1 + v2 * y2
        used = USED_BOTH
        if not (det > 0.0 and s11 > 0.0 and nis <= gate2):
            y1, m11, m21 = 0.0, 0.0, 0.0
            m22 = 1.0 / s22
            y2 = m22 * v2
            nis = y2 * v2
            used = USED_RATE
            if not (s22 > 0.0 and nis <= gate1):
                y2, m22 = 0.0, 0.0
                m11 = 1.0 / s11
                y1 = m11 * v1
                nis = y1 * v1
                used = USED_CODE
    else:
        s22 = np.nan
        y1, y2 = m11 * v1, 0.0
        nis = y1 * v1
        used = USED_CODE
    if used == USED_CODE and not (s11 > 0.0 and nis <= gate1):
        return USED_NONE, 0.0, s11, s22
    for i in range(n):
        ai, bi = a[i], b[i]
        x[i] += ai * y1 + bi * y2
        ka = m11 * ai + m21 * bi  # the gain: column i of K'
        kb = m21 * ai + m22 * bi
        for j in range(n):
            P[i, j] -= ka * a[j] + kb * b[j]
    return used, nis, s11, s22


@njit
def mirror(P: F8, n: int) -> None:
    """Copy the lower triangle of the leading n x n block to the upper: exact symmetry."""
    for i in range(1, n):
        for j in range(i):
            P[j, i] = P[i, j]


@njit
def decide(v1: float, v2: float, s11: float, s21: float, s22: float, paired: bool, gate1: float, gate2: float) -> int:
    """Which rows of a satellite `update_satellite` would use: ``USED_*``; the same rule for the batch form.

    Variances that rounding has left without a positive determinant decide nothing: the rows are tried alone.
    """
    if paired:
        det = s11 * s22 - s21 * s21
        nis_det = v1 * v1 * s22 - 2.0 * v1 * v2 * s21 + v2 * v2 * s11
        if det > 0.0 and s11 > 0.0 and nis_det <= gate2 * det:
            return USED_BOTH
        if s22 > 0.0 and v2 * v2 <= gate1 * s22:
            return USED_RATE
    return USED_CODE if s11 > 0.0 and v1 * v1 <= gate1 * s11 else USED_NONE


@njit
def update_sequential(
    x: F8, P: F8, n: int, moving: bool, ic: I8, idr: I8, u: F8, g: F8, v: F8, r: F8, m: int, gate1: float, gate2: float,
    v_out: F8, s_out: F8, used: U1,
) -> tuple[float, int]:  # fmt: skip
    """Update with m satellites one after another, rows linear in the state; x and P in place.

    Parameters
    ----------
    x : (>= n,)
        Deviation from the state at which the rows were linearised: zeros, usually.
    P : (>= n, >= n)
        Covariance.
    n, moving
        See `update_satellite`.
    ic, idr : (>= m,) int64
    u : (>= m, 3)
        Unit vectors receiver to satellite.
    g : (>= m, 3)
        Gradients of the rates with respect to the position, 1/s.
    v, r : (>= m, 2)
        Innovations at x = 0 and variances, code and rate (r = inf: no rate).
    m : int
        Number of satellites.
    gate1, gate2 : float
        See `decide`.
    v_out, s_out : (>= m, 2)
        Out: innovations and their variances at the moment when the satellite was processed.
    used : (>= m,) uint8
        Out: ``USED_*``.

    Returns
    -------
    nis : float
        Sum over the used rows.
    dof : int
        Their number.
    """
    work = np.empty((2, n))
    a, b = work[0], work[1]
    nis, dof = 0.0, 0
    for k in range(m):
        c, d = ic[k], idr[k]
        ux, uy, uz = u[k, 0], u[k, 1], u[k, 2]
        v1 = v[k, 0] - (x[c] - ux * x[0] - uy * x[1] - uz * x[2])
        gx, gy, gz = g[k, 0], g[k, 1], g[k, 2]
        v2 = v[k, 1] - (x[d] + gx * x[0] + gy * x[1] + gz * x[2])
        if moving:
            v2 += ux * x[3] + uy * x[4] + uz * x[5]
        bits, q, s11, s22 = update_satellite(
            x, P, n, moving, c, d, ux, uy, uz, gx, gy, gz, v1, v2, r[k, 0], r[k, 1], gate1, gate2, a, b
        )
        v_out[k, 0], v_out[k, 1] = v1, v2 if r[k, 1] < np.inf else np.nan
        s_out[k, 0], s_out[k, 1] = s11, s22
        used[k] = bits
        nis += q
        dof += (bits & 1) + (bits >> 1)
    mirror(P, n)
    return nis, dof


@njit
def _grow(L: F8, y: F8, k: int, others: int, v: float, s: float) -> tuple[float, float]:
    """Row k of the factor L of S, from S[k, :others] that stands there; innovation and variance given rows before.

    L[k, i] = (S[k, i] - L[k, :i] . L[i, :i]) / L[i, i], with 1 / L[i, i] kept on the diagonal.
    """
    for i in range(others):
        t = L[k, i]
        for j in range(i):
            t -= L[k, j] * L[i, j]
        t *= L[i, i]
        L[k, i] = t
        v -= t * y[i]
        s -= t * t
    return v, s


@njit
def update_batch(
    x: F8, P: F8, n: int, moving: bool, ic: I8, idr: I8, u: F8, g: F8, v: F8, r: F8, m: int, gate1: float, gate2: float,
    v_out: F8, s_out: F8, used: U1,
) -> tuple[float, int]:  # fmt: skip
    """Update with m satellites at once by the Cholesky factor of S = H P H' + R; arguments as `update_sequential`.

    K = P H' S^-1 is never formed: with S = L L', W = L^-1 H P and y = L^-1 v,  x += W' y  and  P -= W' W.
    """
    size = 2 * m
    PH = np.empty((size, n))
    L = np.empty((size, size))
    y = np.empty(size)
    rows, nis = 0, 0.0
    for k in range(m):
        c, d, e = ic[k], idr[k], rows + 1
        ux, uy, uz = u[k, 0], u[k, 1], u[k, 2]
        gx, gy, gz = g[k, 0], g[k, 1], g[k, 2]
        paired = r[k, 1] < np.inf
        v1 = v[k, 0] - (x[c] - ux * x[0] - uy * x[1] - uz * x[2])
        v2 = v[k, 1] - (x[d] + gx * x[0] + gy * x[1] + gz * x[2])
        # Rows of H P, and of S against the rows accepted before.
        for i in range(n):
            PH[rows, i] = P[c, i] - ux * P[0, i] - uy * P[1, i] - uz * P[2, i]
        for i in range(rows):
            L[rows, i] = PH[i, c] - ux * PH[i, 0] - uy * PH[i, 1] - uz * PH[i, 2]
        s11 = r[k, 0] + PH[rows, c] - ux * PH[rows, 0] - uy * PH[rows, 1] - uz * PH[rows, 2]
        v1, s11 = _grow(L, y, rows, rows, v1, s11)
        s22, s21 = np.nan, 0.0
        if paired:
            for i in range(n):
                PH[e, i] = P[d, i] + gx * P[0, i] + gy * P[1, i] + gz * P[2, i]
            for i in range(rows):
                L[e, i] = PH[i, d] + gx * PH[i, 0] + gy * PH[i, 1] + gz * PH[i, 2]
            if moving:
                v2 += ux * x[3] + uy * x[4] + uz * x[5]
                for i in range(n):
                    PH[e, i] -= ux * P[3, i] + uy * P[4, i] + uz * P[5, i]
                for i in range(rows):
                    L[e, i] -= ux * PH[i, 3] + uy * PH[i, 4] + uz * PH[i, 5]
                s21 = -ux * PH[rows, 3] - uy * PH[rows, 4] - uz * PH[rows, 5]
                s22 = -ux * PH[e, 3] - uy * PH[e, 4] - uz * PH[e, 5]
            else:
                s22 = 0.0
            s21 += PH[rows, d] + gx * PH[rows, 0] + gy * PH[rows, 1] + gz * PH[rows, 2]
            s22 += r[k, 1] + PH[e, d] + gx * PH[e, 0] + gy * PH[e, 1] + gz * PH[e, 2]
            v2, s22 = _grow(L, y, e, rows, v2, s22)
            for i in range(rows):
                s21 -= L[rows, i] * L[e, i]
        else:
            v2 = np.nan
        v_out[k, 0], v_out[k, 1] = v1, v2
        s_out[k, 0], s_out[k, 1] = s11, s22
        bits = decide(v1, v2, s11, s21, s22, paired, gate1, gate2)
        used[k] = bits
        if bits == USED_NONE:
            continue
        if bits == USED_RATE:
            for i in range(n):
                PH[rows, i] = PH[e, i]
            for i in range(rows):
                L[rows, i] = L[e, i]
            s11, v1 = s22, v2
        i1 = 1.0 / math.sqrt(s11)
        L[rows, rows] = i1
        y[rows] = v1 * i1
        if bits == USED_BOTH:
            l21 = s21 * i1
            i2 = 1.0 / math.sqrt(s22 - l21 * l21)
            L[e, rows] = l21
            L[e, e] = i2
            y[e] = (v2 - l21 * y[rows]) * i2
            rows += 1
        rows += 1
    # W = L^-1 (H P), row by row in place.
    for k in range(rows):
        for j in range(k):
            t = L[k, j]
            for i in range(n):
                PH[k, i] -= t * PH[j, i]
        t, yk = L[k, k], y[k]
        nis += yk * yk
        for i in range(n):
            PH[k, i] *= t
            x[i] += PH[k, i] * yk
    if rows % 2 == 1:
        for i in range(n):
            PH[rows, i] = 0.0
    for k in range(0, rows, 2):
        for i in range(n):
            ai, bi = PH[k, i], PH[k + 1, i]
            for j in range(n):
                P[i, j] -= ai * PH[k, j] + bi * PH[k + 1, j]
    mirror(P, n)
    return nis, rows
