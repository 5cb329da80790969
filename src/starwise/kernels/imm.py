"""Manoeuvre and cruise as hypotheses over fixes of several receivers, each hypothesis a federated filter with reset.

Hypotheses: `M` manoeuvre modes (Singer, interacting: IMM of Blom, Bar-Shalom 1988), and cruise at constant velocity as
*branches*, one for every time at which the manoeuvre may have ended. Branches are never mixed with anything: mixing
leaks the covariance of the manoeuvre into the cruise model at every step and costs half of its accuracy. Weights
follow Bayes' rule on a Markov chain in continuous time; where all places are taken the lightest branch makes room.

Each hypothesis is predicted with its process noise, split over the receivers (P and Q over the share), updated there
with the receiver's fix, and fused by adding information about the common prediction. The weight of a hypothesis needs
the likelihood of all fixes together; the master has it from what the locals report:

    Lambda_i = P_i^-1 - beta_i P^-1,  lambda_i = P_i^-1 dx_i      (dx_i: deviation from the common prediction)
    c_i      = v_i' R_i^-1 v_i                                     (v_i: fix minus common prediction)
    log L = -1/2 (log det P + log det(P^-1 + sum Lambda_i) + sum c_i - dx' (P^-1 + sum Lambda_i) dx) + const

dx being the fused deviation. What the fixes say about each other is common to all hypotheses, and gives the scale of
their noise instead: differences of receivers contain no motion.

Axes share the hypotheses and are otherwise independent.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.imm_screen import combine, combine_kept, remember_refusals, screen
from starwise.kernels.process import SINGER, VELOCITY, motion

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


DEAD_BAND = 2.0
"""Correlation below this many of its standard deviations for white errors is taken as none."""
NEGLIGIBLE = 1e-9
"""Weight below which a cruise branch gives its place away."""
SCALE_KNOWN = 60.0
"""Degrees of freedom after which the scale of the noise is good to 20 %."""


class Bank(NamedTuple):
    """Numbers of a bank of hypotheses."""

    cruise_psd: float  # white acceleration of the cruise branches, m^2/s^3
    tau_s: F8  # (M,) correlation time of the acceleration of each manoeuvre mode
    sigma: F8  # (M,) its standard deviation, m/s^2
    start_rate: float  # cruise to manoeuvre, 1/s
    end_rate: float  # manoeuvre to cruise, 1/s
    switch_rate: float  # from one manoeuvre mode to another, 1/s
    branches: int  # places for cruise branches
    velocity_sigma0: float  # at the start, m/s
    scale_window: float  # epochs over which the noise scale is averaged; 0: the nominal noise is believed
    scale_prior: float  # weight of the nominal noise in it, epochs
    most_inflation: float  # limit of the factor on variances that makes up for correlated errors; 1: errors are white
    gate: float  # chi-square threshold (3 dof) of a receiver against the others; inf: all are believed


class BankOut(NamedTuple):
    """Results per epoch."""

    x: F8  # (n, 3, 3) axis, (position, velocity, acceleration)
    cov_pos: F8  # (n, 3, 3)
    cov_vel: F8  # (n, 3, 3)
    cruise: F8  # (n,) probability of cruise
    scale: F8  # (n,) factor on the standard deviations of the fixes
    correlation: F8  # (n,) of the fixes' errors from epoch to epoch
    nis: F8  # (n,) of the fused fix against the prediction, mixture's moments; chi-square with 3 dof
    used: NDArray[np.bool_]  # (n, receivers) took part; False: no fix, or refused


@njit
def invert(A: F8, n: int, out: F8) -> float:
    """Inverse of the leading symmetric n x n block (n = 2 or 3) into ``out``; its determinant."""
    det: float
    if n == 2:
        det = A[0, 0] * A[1, 1] - A[0, 1] * A[0, 1]
        out[0, 0], out[1, 1] = A[1, 1] / det, A[0, 0] / det
        out[0, 1] = out[1, 0] = -A[0, 1] / det
        return det
    c0 = A[1, 1] * A[2, 2] - A[1, 2] * A[1, 2]
    c1 = A[1, 2] * A[0, 2] - A[0, 1] * A[2, 2]
    c2 = A[0, 1] * A[1, 2] - A[1, 1] * A[0, 2]
    det = A[0, 0] * c0 + A[0, 1] * c1 + A[0, 2] * c2
    out[0, 0] = c0 / det
    out[0, 1] = out[1, 0] = c1 / det
    out[0, 2] = out[2, 0] = c2 / det
    out[1, 1] = (A[0, 0] * A[2, 2] - A[0, 2] * A[0, 2]) / det
    out[1, 2] = out[2, 1] = (A[0, 1] * A[0, 2] - A[0, 0] * A[1, 2]) / det
    out[2, 2] = (A[0, 0] * A[1, 1] - A[0, 1] * A[0, 1]) / det
    return det


@njit
def fuse_axis(x: F8, P: F8, n: int, z: F8, r: F8, share: F8, work: F8) -> float:
    """One axis of one hypothesis, in place: locals updated with their fixes, fused, log likelihood (+ constant).

    Parameters
    ----------
    x, P : (3,), (3, 3)
        Common prediction; the fused estimate on return.
    n : int
        States in use: 2 or 3.
    z, r, share : (receivers,)
        Fix (NaN: none), its variance, information share of each local filter (sum 1 over those that have a fix).
    work : (5, 3, 3)
    """
    Pinv, Pi, Pi_inv, total, fused = work[0], work[1], work[2], work[3], work[4]
    det = invert(P, n, Pinv)
    for i in range(n):
        for j in range(n):
            total[i, j] = Pinv[i, j]
    y0, y1, y2, distance = 0.0, 0.0, 0.0, 0.0
    for k in range(len(z)):
        if math.isnan(z[k]):
            continue
        beta = share[k]
        v = z[k] - x[0]
        distance += v * v / r[k]
        s = P[0, 0] / beta + r[k]
        for i in range(n):
            for j in range(n):
                Pi[i, j] = (P[i, j] - P[i, 0] * P[0, j] / (beta * s)) / beta
        invert(Pi, n, Pi_inv)
        d0, d1 = P[0, 0] / beta * v / s, P[1, 0] / beta * v / s
        d2 = P[2, 0] / beta * v / s if n == 3 else 0.0
        # what the local filter knows beyond its share of the prediction; deviations from the common prediction
        y0 += Pi_inv[0, 0] * d0 + Pi_inv[0, 1] * d1 + (Pi_inv[0, 2] * d2 if n == 3 else 0.0)
        y1 += Pi_inv[1, 0] * d0 + Pi_inv[1, 1] * d1 + (Pi_inv[1, 2] * d2 if n == 3 else 0.0)
        if n == 3:
            y2 += Pi_inv[2, 0] * d0 + Pi_inv[2, 1] * d1 + Pi_inv[2, 2] * d2
        for i in range(n):
            for j in range(n):
                total[i, j] += Pi_inv[i, j] - beta * Pinv[i, j]
    det_total = invert(total, n, fused)
    d0 = fused[0, 0] * y0 + fused[0, 1] * y1 + (fused[0, 2] * y2 if n == 3 else 0.0)
    d1 = fused[1, 0] * y0 + fused[1, 1] * y1 + (fused[1, 2] * y2 if n == 3 else 0.0)
    d2 = fused[2, 0] * y0 + fused[2, 1] * y1 + fused[2, 2] * y2 if n == 3 else 0.0
    quadratic = y0 * d0 + y1 * d1 + y2 * d2
    x[0] += d0
    x[1] += d1
    x[2] += d2
    for i in range(n):
        for j in range(i + 1):
            P[i, j] = P[j, i] = 0.5 * (fused[i, j] + fused[j, i])
    log_likelihood: float = -0.5 * (math.log(det) + math.log(det_total) + distance - quadratic)
    return log_likelihood


@njit
def predict_axis(x: F8, P: F8, n: int, F: F8, G: F8, q: float, work: F8) -> None:
    """One axis of one hypothesis, in place: x = F x, P = F P F' + q G."""
    for i in range(n):
        s = 0.0
        for j in range(n):
            s += F[i, j] * x[j]
        work[0, 0, i] = s
    for i in range(n):
        x[i] = work[0, 0, i]
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += F[i, k] * P[k, j]
            work[1, i, j] = s
    for i in range(n):
        for j in range(i + 1):
            s = q * G[i, j]
            for k in range(n):
                s += work[1, i, k] * F[j, k]
            P[i, j] = P[j, i] = s


@njit
def _mix(x: F8, P: F8, w: F8, n: int, x_out: F8, P_out: F8) -> None:
    """Mean and covariance (n leading states) of a mixture of one axis: x (H, 3), P (H, 3, 3), weights w (H,)."""
    total = 0.0
    for h in range(len(w)):
        total += w[h]
    for i in range(3):
        x_out[i] = 0.0
        for j in range(3):
            P_out[i, j] = 0.0
    for h in range(len(w)):
        if w[h] > 0.0:
            for i in range(n):
                x_out[i] += w[h] / total * x[h, i]
    for h in range(len(w)):
        if w[h] > 0.0:
            for i in range(n):
                for j in range(n):
                    P_out[i, j] += w[h] / total * (P[h, i, j] + (x[h, i] - x_out[i]) * (x[h, j] - x_out[j]))


@njit
def interact(bank: Bank, dt: float, x: F8, P: F8, w: F8, x1: F8, P1: F8, w1: F8) -> None:
    """What may change between two epochs: manoeuvre modes mixed, one new cruise branch, weights of the chain.

    Hypotheses 0 .. M - 1 are manoeuvre modes, the others cruise branches (weight 0: a free place).

    Parameters
    ----------
    bank : Bank
    dt : float
        s.
    x, P, w : (H, 3, 3), (H, 3, 3, 3), (H,)
        Hypothesis, axis, states; weights, sum 1. Overwritten.
    x1, P1, w1
        Work space of the same shapes.
    """
    H, M = len(w), len(bank.tau_s)
    p_start = -math.expm1(-bank.start_rate * dt)
    p_end = -math.expm1(-bank.end_rate * dt)
    p_switch = -math.expm1(-bank.switch_rate * dt) if M > 1 else 0.0
    cruise = 0.0
    for h in range(M, H):
        cruise += w[h]
    # the new branch takes the place of the lightest
    worst = M
    for h in range(M, H):
        if w[h] < w[worst]:
            worst = h
    begun = 0.0
    for m in range(M):
        begun += w[m] * p_end
    for m in range(M):
        # into mode m: from every mode, and from cruise, whose acceleration is then any that the mode may have
        for h in range(H):
            w1[h] = 0.0
        for k in range(M):
            w1[k] = w[k] * (1.0 - p_end) * ((1.0 - p_switch) if k == m else p_switch / max(M - 1, 1))
        for h in range(M, H):
            w1[h] = w[h] * p_start / M
        for a in range(3):
            for h in range(M, H):
                x[h, a, 2] = 0.0
                P[h, a, 2, 2] = bank.sigma[m] ** 2
            _mix(x[:, a], P[:, a], w1, 3, x1[m, a], P1[m, a])
    for h in range(M, H):
        for a in range(3):
            P[h, a, 2, 2] = 0.0
    for a in range(3):
        _mix(x[:M, a], P[:M, a], w[:M], 2, x1[M, a], P1[M, a])
    for m in range(M):
        into = cruise * p_start / M
        for k in range(M):
            into += w[k] * (1.0 - p_end) * ((1.0 - p_switch) if k == m else p_switch / max(M - 1, 1))
        w1[m] = into
    for h in range(M, H):
        w[h] *= 1.0 - p_start
    if begun > w[worst]:
        w[worst] = begun
        for a in range(3):
            for i in range(3):
                x[worst, a, i] = x1[M, a, i]
                for j in range(3):
                    P[worst, a, i, j] = P1[M, a, i, j]
    for m in range(M):
        w[m] = w1[m]
        for a in range(3):
            for i in range(3):
                x[m, a, i] = x1[m, a, i]
                for j in range(3):
                    P[m, a, i, j] = P1[m, a, i, j]
    total = 0.0
    for h in range(H):
        total += w[h]
    for h in range(H):
        w[h] /= total  # a new branch that found no place is lost


@njit
def _begin(bank: Bank, zc: F8, rc: F8, scale2: float, x: F8, P: F8, w: F8) -> None:
    """Every manoeuvre mode and one cruise branch, about the first combined fix."""
    M = len(bank.tau_s)
    for h in range(M + 1):
        w[h] = 1.0 / (M + 1)
        for a in range(3):
            x[h, a, 0] = zc[a]
            P[h, a, 0, 0] = scale2 * rc[a]
            P[h, a, 1, 1] = bank.velocity_sigma0**2
            if h < M:
                P[h, a, 2, 2] = bank.sigma[h] ** 2


@njit
def bank_run(bank: Bank, t: F8, z: F8, r: F8, share: F8, out: BankOut) -> None:
    """Fused position, velocity, acceleration of every epoch, and how probable cruise is.

    Parameters
    ----------
    bank : Bank
    t : (n,)
        s, increasing.
    z, r : (n, receivers, 3)
        Fixes on three axes in which cruise is straight, m (NaN on all axes: none), and their variances, m^2.
    share : (receivers,)
        Information shares; they do not change the result.
    out : BankOut
    """
    n, K = z.shape[0], z.shape[1]
    M = len(bank.tau_s)
    H = M + bank.branches
    x, P, w = np.zeros((H, 3, 3)), np.zeros((H, 3, 3, 3)), np.zeros(H)
    x1, P1, w1 = np.zeros((H, 3, 3)), np.zeros((H, 3, 3, 3)), np.zeros(H)
    work, log_w = np.zeros((5, 3, 3)), np.zeros(H)
    zc, rc, zk, rk, sk = np.zeros(3), np.zeros(3), np.zeros(K), np.zeros(K), np.zeros(K)
    F, G = np.zeros((M + 1, 3, 3)), np.zeros((M + 1, 3, 3))
    begun = False
    deviation = np.full((K, 3), math.nan)
    keep, rate, expected, zs = np.zeros(K, dtype=np.bool_), np.zeros(K), np.zeros(3), np.zeros((K, 3))
    chi_sum, product_sum, dof_sum = 0.0, 0.0, 0.0
    scale2, bare2, rho = 1.0, 1.0, 0.0
    t_last, dt_last = 0.0, -1.0
    for e in range(n):
        for k in range(K):
            keep[k] = not math.isnan(z[e, k, 0])
        if bank.gate < math.inf:
            for a in range(3):
                expected[a] = math.nan
                if begun:
                    expected[a] = out.x[e - 1, a, 0] + out.x[e - 1, a, 1] * (t[e] - t_last)
            # while the scale is being found out nothing is refused
            if dof_sum > SCALE_KNOWN or bank.scale_window == 0.0:
                screen(z[e], r[e], bare2, expected, bank.gate, keep)
            remember_refusals(z[e], keep, rate)
        for k in range(K):
            # a receiver that is refused most of the time says nothing about the noise of the others
            for a in range(3):
                zs[k, a] = math.nan if rate[k] > 0.5 else z[e, k, a]
        chi2, product, dof = combine(zs, r[e], zc, rc, deviation)
        if bank.gate < math.inf:
            # nor does one epoch decide: an outlier counts as three sigmas
            chi2 = min(chi2, 9.0 * bare2 * max(dof, 1))
            combine_kept(z[e], r[e], keep, zc, rc)
        if bank.scale_window > 0.0 and dof > 0:
            # the scale in use is of the epochs before and of this one; the nominal noise counts as a few epochs
            memory = 1.0 - 1.0 / bank.scale_window
            product_sum = memory * product_sum + product
            chi_sum = memory * chi_sum + chi2
            dof_sum = memory * dof_sum + dof
            prior = bank.scale_prior * 3.0
            bare2 = (chi_sum + prior) / (dof_sum + prior)
            # of white errors the estimate is within 2 / sqrt(dof) of zero: no correlation is seen there
            rho = max(product_sum / max(chi_sum, 1e-300) - DEAD_BAND / math.sqrt(max(dof_sum, 1.0)), 0.0)
            rho = min(rho, 0.999) if dof_sum > 10.0 else 0.0
        out.scale[e] = math.sqrt(bare2)
        out.correlation[e] = rho
        # a mean over many epochs of errors rho^k is as uncertain as one of white errors of this variance
        scale2 = bare2 * min((1.0 + rho) / (1.0 - rho), bank.most_inflation)
        got = not math.isnan(zc[0])
        total = 0.0
        for k in range(K):
            out.used[e, k] = keep[k]
            if out.used[e, k]:
                total += share[k]
        for k in range(K):
            sk[k] = share[k] / total if total > 0.0 else 0.0
        if not begun:
            if got:
                begun = True
                _begin(bank, zc, rc, scale2, x, P, w)
                t_last = t[e]
            else:
                out.x[e] = math.nan
                out.cov_pos[e] = math.nan
                out.cov_vel[e] = math.nan
                out.cruise[e] = math.nan
                out.nis[e] = math.nan
                continue
        else:
            dt = t[e] - t_last
            t_last = t[e]
            if abs(dt - dt_last) > 1e-9:
                dt_last = dt
                for m in range(M):
                    motion(SINGER, dt, bank.tau_s[m], F[m], G[m])
                motion(VELOCITY, dt, 1.0, F[M], G[M])
            interact(bank, dt, x, P, w, x1, P1, w1)
            for h in range(H):
                if w[h] > 0.0:
                    m = min(h, M)
                    q = bank.sigma[m] ** 2 if m < M else bank.cruise_psd
                    for a in range(3):
                        predict_axis(x[h, a], P[h, a], 3 if m < M else 2, F[m], G[m], q, work)
            out.nis[e] = math.nan
            if got:
                nis = 0.0
                for a in range(3):
                    _mix(x[:, a], P[:, a], w, 1, x1[0, 0], P1[0, 0])
                    nis += (zc[a] - x1[0, 0, 0]) ** 2 / (P1[0, 0, 0, 0] + scale2 * rc[a])
                out.nis[e] = nis
                top = -math.inf
                for h in range(H):
                    log_w[h] = -math.inf
                    if w[h] > 0.0:
                        log_w[h] = math.log(w[h])
                        for a in range(3):
                            for k in range(K):
                                zk[k] = z[e, k, a] if keep[k] else math.nan
                                rk[k] = scale2 * r[e, k, a]
                            log_w[h] += fuse_axis(x[h, a], P[h, a], 3 if h < M else 2, zk, rk, sk, work)
                        top = max(top, log_w[h])
                s = 0.0
                for h in range(H):
                    w[h] = math.exp(log_w[h] - top)
                    s += w[h]
                for h in range(H):
                    w[h] /= s
                    if h >= M and w[h] < NEGLIGIBLE:
                        w[h] = 0.0
        _report(x, P, w, M, e, x1, P1, out)


@njit
def _report(x: F8, P: F8, w: F8, M: int, e: int, x1: F8, P1: F8, out: BankOut) -> None:
    """Moments of the mixture into the results of epoch e."""
    H = len(w)
    total = 0.0
    for h in range(M, H):
        total += w[h]
    out.cruise[e] = total
    for a in range(3):
        _mix(x[:, a], P[:, a], w, 3, x1[0, a], P1[0, a])
    for a in range(3):
        for b in range(3):
            out.x[e, a, b] = x1[0, a, b]
            if a == b:
                out.cov_pos[e, a, a], out.cov_vel[e, a, a] = P1[0, a, 0, 0], P1[0, a, 1, 1]
                continue
            sp, sv = 0.0, 0.0
            for h in range(H):
                sp += w[h] * (x[h, a, 0] - x1[0, a, 0]) * (x[h, b, 0] - x1[0, b, 0])
                sv += w[h] * (x[h, a, 1] - x1[0, a, 1]) * (x[h, b, 1] - x1[0, b, 1])
            out.cov_pos[e, a, b], out.cov_vel[e, a, b] = sp, sv
