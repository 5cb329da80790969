"""Federated filter: local filters, a master that fuses, information sharing, fault isolation.

State of local filter i: `nc` common states, the same for all, then private ones (a satellite system's own receiver
clock). The master fuses the common states (Carlson 1990, "Federated square root filter for decentralized parallel
processes", IEEE Trans. AES 26(3)); all information is about deviations from a common base, never about 6e6 m numbers:

    P_g^-1 = sum P_i^-1,     x_g = base + P_g sum P_i^-1 (x_i - base)

Sharing: P_i = P_g / beta_i, x_i = x_g and Q_i = Q / beta_i with sum beta_i = 1. A private state keeps what the local
filter knows of it given the common ones: with G = P_pc P_cc^-1, x_p += G (x_g - x_c), P_pp += G (P_g / beta - P_cc) G'.

With reset (sharing at every epoch) and no private states the fused estimate is the centralised filter's. Without
reset every local filter stays itself: a fault in one never reaches another, and the master is clean as soon as it
leaves that one out. Private states carried through common process noise make the fused covariance an upper bound.

Innovations that fail their test together, and pass it once the private states are forgotten, are a clock that jumped:
it is absorbed, and named. A local filter is taken out when its solution separates from the fusion of the others by more
than both covariances allow, or its innovations fail their test, for `patience` epochs; it then starts anew from the
master's position with its own covariance, and comes back when it has agreed with the others for `probation` epochs.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.linalg import cholesky, cholesky_inverse, cholesky_solve

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]

LOCAL_ABSENT = 0
"""Not asked in this epoch: it has been switched off."""
LOCAL_USED = 1
LOCAL_OUT = 2
"""Taken out by a test, on probation."""
LOCAL_JUMPED = 3
"""Used, its private states (a clock that jumped) being learnt anew."""


class Options(NamedTuple):
    """Numbers of a federated filter."""

    nc: int  # common states
    reset: bool  # share the master's estimate at every epoch
    auto_share: bool  # shares from the covariances of the locals instead of fixed ones
    least_share: float  # auto: no share below this part of an equal one
    share: F8  # (K,) fixed shares, sum 1
    test_states: int  # leading common states whose separation is tested; 0: no isolation
    separation_gate: float  # chi-square threshold for `test_states` degrees of freedom
    innovation_gate: F8  # chi-square thresholds by degrees of freedom; the last one serves all above
    patience: int  # epochs that a test must fail in a row
    probation: int  # epochs of agreement before a local filter is used again
    clock: int  # index of the private clock bias whose differences between locals are watched; -1: none
    clock_psd: float  # random walk of a clock difference, m^2/s
    clock_gate: float  # chi-square threshold, 1 degree of freedom


class Locals(NamedTuple):
    """Local filters: beliefs that a run changes, and their models."""

    n: I8  # (K,) states of each
    x: F8  # (K, n_max)
    P: F8  # (K, n_max, n_max)
    Phi: F8  # (K, n_max, n_max) over one epoch
    Q: F8  # (K, n_max, n_max), not yet divided by the share
    x0: F8  # (K, n_max) and
    P0: F8  # (K, n_max, n_max): belief of a filter that starts anew, about the master's common states


@njit
def fuse(x: F8, P: F8, use: Bool, skip: int, n: int, base: F8, x_g: F8, P_g: F8, A: F8, B: F8) -> bool:
    """Fused estimate of the leading n states of local filters; False if no information or a singular covariance.

    Parameters
    ----------
    x, P : (K, >= n), (K, >= n, >= n)
    use : (K,) bool
    skip : int
        A local filter left out, whatever ``use`` says; -1: none.
    n : int
    base : (n,)
        Point from which deviations count; may be ``x_g``.
    x_g, P_g : (n,), (n, n)
        Result.
    A, B : (>= n, >= n)
        Work space.
    """
    y = np.zeros(n)
    start = np.zeros(n)
    any_used = False
    for i in range(n):
        start[i] = base[i]
        for j in range(n):
            P_g[i, j] = 0.0
    for k in range(len(use)):
        if not use[k] or k == skip:
            continue
        any_used = True
        for i in range(n):
            for j in range(n):
                A[i, j] = P[k, i, j]
        if not cholesky(A, n):
            return False
        cholesky_inverse(A, B, n)
        for i in range(n):
            for j in range(n):
                y[i] += B[i, j] * (x[k, j] - start[j])
                P_g[i, j] += B[i, j]
    if not any_used or not cholesky(P_g, n):
        return False
    cholesky_solve(P_g, y, n)
    cholesky_inverse(P_g, A, n)
    for i in range(n):
        x_g[i] = start[i] + y[i]
        for j in range(n):
            P_g[i, j] = A[i, j]
    return True


@njit
def share_out(x: F8, P: F8, n: int, nc: int, x_g: F8, P_g: F8, beta: float, A: F8, B: F8) -> bool:
    """Give a local filter (x, P, n states) the master's common states with covariance P_g / beta, in place.

    Private states keep their regression on the common ones. False: the local covariance is singular; nothing changed.
    """
    if n > nc:
        for i in range(nc):
            for j in range(nc):
                A[i, j] = P[i, j]
        if not cholesky(A, nc):
            return False
        cholesky_inverse(A, B, nc)
        G = np.zeros((n - nc, nc))
        D = np.zeros((n - nc, nc))
        for p in range(n - nc):
            for i in range(nc):
                s = 0.0
                for j in range(nc):
                    s += P[nc + p, j] * B[j, i]
                G[p, i] = s
        for p in range(n - nc):
            for i in range(nc):
                x[nc + p] += G[p, i] * (x_g[i] - x[i])
                s = 0.0
                for j in range(nc):
                    s += G[p, j] * (P_g[j, i] / beta - P[j, i])
                D[p, i] = s
        for p in range(n - nc):
            for q in range(n - nc):
                s = 0.0
                for i in range(nc):
                    s += D[p, i] * G[q, i]
                P[nc + p, nc + q] += s
            for i in range(nc):
                s = 0.0
                for j in range(nc):
                    s += G[p, j] * P_g[j, i] / beta
                P[nc + p, i] = P[i, nc + p] = s
    for i in range(nc):
        x[i] = x_g[i]
        for j in range(nc):
            P[i, j] = P_g[i, j] / beta
    return True


@njit
def forget_private(x: F8, P: F8, n: int, nc: int, P0: F8) -> None:
    """Private states of a local filter as uncertain as at its start, and independent of the common ones, in place."""
    for i in range(nc, n):
        for j in range(n):
            P[i, j] = P[j, i] = P0[i, j] if j >= nc else 0.0


@njit
def predict_local(x: F8, P: F8, n: int, nc: int, Phi: F8, Q: F8, beta: float, A: F8) -> None:
    """One local filter, one step, in place: x = Phi x, P = Phi P Phi' + Q, the common block of Q over its share."""
    for i in range(n):
        s = 0.0
        for j in range(n):
            s += Phi[i, j] * x[j]
            t = 0.0
            for k in range(n):
                t += Phi[i, k] * P[k, j]
            A[i, j] = t
        A[i, n] = s
    for i in range(n):
        x[i] = A[i, n]
        for j in range(i + 1):
            s = Q[i, j] / beta if i < nc and j < nc else Q[i, j]
            for k in range(n):
                s += A[i, k] * Phi[j, k]
            P[i, j] = P[j, i] = s


@njit
def update_row(x: F8, P: F8, n: int, H: F8, z: float, r: float, w: F8) -> float:
    """One scalar row, in place; returns its normalised innovation squared."""
    s = r
    v = z
    for i in range(n):
        t = 0.0
        for j in range(n):
            t += P[i, j] * H[j]
        w[i] = t
        s += H[i] * t
        v -= H[i] * x[i]
    for i in range(n):
        x[i] += w[i] * v / s
        for j in range(i + 1):
            P[i, j] -= w[i] * w[j] / s
            P[j, i] = P[i, j]
    return v * v / s


@njit
def auto_shares(P: F8, use: Bool, least: float, share: F8) -> None:
    """Shares proportional to the information 1 / trace(P) of each local's first three states, none below ``least``."""
    K = len(use)
    count, total = 0, 0.0
    for k in range(K):
        share[k] = 0.0
        if use[k]:
            count += 1
            share[k] = 1.0 / (P[k, 0, 0] + P[k, 1, 1] + P[k, 2, 2])
            total += share[k]
    s = 0.0
    for k in range(K):
        if use[k]:
            share[k] = max(share[k] / total, least / count)
            s += share[k]
    for k in range(K):
        share[k] /= max(s, 1e-300)
