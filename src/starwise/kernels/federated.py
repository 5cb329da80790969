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

A local filter is taken out when its solution separates from the fusion of the others by more than both covariances
allow, or its innovations fail their test, for `patience` epochs; it then starts anew from the master's position with
its own covariance, and comes back when it has agreed with the others for `probation` epochs.
"""

import math
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


class Measured(NamedTuple):
    """Linear rows by epoch and local filter: rows offsets[e, i] : offsets[e, i + 1], uncorrelated."""

    offsets: I8  # (n_epochs, K + 1)
    present: Bool  # (n_epochs, K) False: the local filter is switched off in that epoch
    z: F8  # (m,)
    r: F8  # (m,)
    H: F8  # (m, n_max)


class FederatedOut(NamedTuple):
    """Results per epoch."""

    x: F8  # (n_epochs, nc)
    P: F8  # (n_epochs, nc, nc)
    status: I8  # (n_epochs, K) LOCAL_*
    separation: F8  # (n_epochs, K) statistic, chi-square with `test_states` degrees of freedom; NaN: not tested
    nis: F8  # (n_epochs, K)
    share: F8  # (n_epochs, K)


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
def separation(x: F8, P: F8, use: Bool, k: int, n: int, m: int, A: F8, B: F8) -> float:
    """Squared distance of local k from the fusion of the others, over both covariances: chi-square, m dof; or NaN."""
    x_o, P_o = np.zeros(n), np.zeros((n, n))
    if not fuse(x, P, use, k, n, x[k], x_o, P_o, A, B):
        return math.nan
    d = np.zeros(m)
    for i in range(m):
        d[i] = x[k, i] - x_o[i]
        for j in range(m):
            A[i, j] = P[k, i, j] + P_o[i, j]
    if not cholesky(A, m):
        return math.nan
    # L^-1 d, then its square
    total = 0.0
    for i in range(m):
        for j in range(i):
            d[i] -= A[i, j] * d[j]
        d[i] /= A[i, i]
        total += d[i] * d[i]
    return total


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


@njit
def _shares(options: Options, P: F8, active: Bool, share: F8) -> None:
    """Shares of the active local filters, sum 1."""
    if options.auto_share:
        auto_shares(P, active, options.least_share, share)
        return
    total = 0.0
    for k in range(len(active)):
        share[k] = options.share[k] if active[k] else 0.0
        total += share[k]
    for k in range(len(active)):
        share[k] /= max(total, 1e-300)


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
def federated_run(options: Options, locals_: Locals, rows: Measured, out: FederatedOut) -> None:
    """Fused common states of every epoch.

    Parameters
    ----------
    options : Options
    locals_ : Locals
        Beliefs at the epoch before the first; the last epoch's on return.
    rows : Measured
    out : FederatedOut
    """
    x, P, nc = locals_.x, locals_.P, options.nc
    K, width = x.shape[0], x.shape[1]
    A, B = np.zeros((width, width + 1)), np.zeros((width, width))
    w, x_g, P_g = np.zeros(width), np.zeros(nc), np.zeros((nc, nc))
    share = np.zeros(K)
    active, use = np.zeros(K, dtype=np.bool_), np.zeros(K, dtype=np.bool_)
    out_of, suspect = np.zeros(K, dtype=np.bool_), np.zeros(K, dtype=np.bool_)
    failed, agreed = np.zeros(K, dtype=np.int64), np.zeros(K, dtype=np.int64)
    level = np.zeros((K, K, 2))
    known = False
    gates = len(options.innovation_gate)
    for e in range(rows.offsets.shape[0]):
        for k in range(K):
            active[k] = rows.present[e, k] and not out_of[k]
        _shares(options, P, active, share)
        for k in range(K):
            out.share[e, k] = share[k]
            out.nis[e, k] = out.separation[e, k] = math.nan
            suspect[k] = False
            if options.reset and known and active[k]:
                share_out(x[k], P[k], locals_.n[k], nc, x_g, P_g, share[k], A, B)
            # one that is not asked, or on probation, is predicted by itself, with the noise of an equal share
            beta = share[k] if share[k] > 0.0 else 1.0 / K
            predict_local(x[k], P[k], locals_.n[k], nc, locals_.Phi[k], locals_.Q[k], beta, A)
            if not rows.present[e, k]:
                continue
            nis, m = 0.0, 0
            for i in range(rows.offsets[e, k], rows.offsets[e, k + 1]):
                nis += update_row(x[k], P[k], locals_.n[k], rows.H[i], rows.z[i], rows.r[i], w)
                m += 1
            out.nis[e, k] = nis
            suspect[k] = m > 0 and nis > options.innovation_gate[min(m, gates - 1)]
        for k in range(K):
            use[k] = active[k] if options.reset else not out_of[k] and (rows.present[e, k] or known)
        if options.test_states > 0:
            _isolate(options, locals_, rows.present[e], use, suspect, level, failed, agreed, out_of, out.separation[e])
        if fuse(x, P, use, -1, nc, x_g, x_g, P_g, A, B):
            known = True
        for k in range(K):
            out.status[e, k] = LOCAL_OUT if out_of[k] else (LOCAL_USED if rows.present[e, k] else LOCAL_ABSENT)
        for i in range(nc):
            out.x[e, i] = x_g[i]
            for j in range(nc):
                out.P[e, i, j] = P_g[i, j]
        for k in range(K):
            # a filter that has just been taken out starts anew, about where the master is without it
            if out_of[k] and agreed[k] < 0:
                agreed[k] = 0
                for i in range(locals_.n[k]):
                    x[k, i] = x_g[i] if i < nc else locals_.x0[k, i]
                    for j in range(locals_.n[k]):
                        P[k, i, j] = locals_.P0[k, i, j]


@njit
def _isolate(
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
    K, nc, m = len(use), options.nc, options.test_states
    width = locals_.x.shape[1]
    A, B = np.zeros((width, width)), np.zeros((width, width))
    clock = np.zeros(K, dtype=np.bool_)
    if options.clock >= 0:
        watch_clocks(options, locals_, use, level, clock)
    count = 0
    for k in range(K):
        count += 1 if use[k] else 0
    worst, most = -1, 0.0
    for k in range(K):
        if not (use[k] or (out_of[k] and present[k])):
            continue
        s = separation(locals_.x, locals_.P, use, k, nc, m, A, B)
        statistic[k] = s
        apart = s > options.separation_gate
        if out_of[k]:
            agreed[k] = 0 if apart or suspect[k] or math.isnan(s) else agreed[k] + 1
            continue
        failed[k] = failed[k] + 1 if (apart and count >= 3) or clock[k] or (suspect[k] and present[k]) else 0
        weight = max(s, 1e9 if clock[k] else 0.0)
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
