"""Adaptation rules of Kalman filters as one interface: an epoch's innovations in, three factors out.

Every rule looks at the innovations v of an epoch *before* the update and at three variances of each row, all at the
prediction: p (H Phi P Phi' H', the part of the state), q (H Q H', the part of the process noise) and r (the
measurement noise). It answers with

    fading    >= 1, multiplies Phi P Phi'
    q_factor  > 0, multiplies Q
    r         per row, the measurement variance to use instead

so that any filter can use any rule, whether it takes its rows at once (EKF) or one by one (S3EKF, local filters): the
variances are known before the first row is processed. Q and R stay positive definite because they are only scaled.

Rules (`kind`), with d the trace of v v', and sums over the rows that are not NaN. In all but PAPER, rows count in units
of their own r: a noisy sensor must not drown a good one in a trace.

PAPER          C_0 = d / 2 at first, then lambda d / (1 + lambda) with the lambda of the epoch before
               N = weight C_0 - sum q - sum r + beta,  M = sum p,  fading = max(1, alpha N / M)    (eq. 12-20)
               weight = d_0 where d >= U, else 1; beta is the caller's (change of a state)^2 eta
STRONG         the same with V = d at first, then (rho V + d) / (1 + rho), N = V - sum q - softening sum r
               (Zhou, Frank 1996, "Strong tracking filtering of nonlinear time-varying stochastic systems")
IAE_R, IAE_Q   C = mean of d over the last `window` epochs; r_factor = (C - sum p - sum q) / sum r, or
               q_factor = (C - sum p - sum r) / sum q  (Mohamed, Schwarz 1999, "Adaptive Kalman filtering for INS/GPS")
SAGE_HUSA      the same two quantities as recursive means with weight d_k = (1 - b) / (1 - b^k) (Sage, Husa 1969),
               R from innovations; one factor at a time, chosen by `noise`
HUBER          r / w with w = 1 for |v| / s <= c, else c s / |v|
IGG3           w = 1 for u = |v| / s <= c, c / u ((c1 - u) / (c1 - c))^2 up to c1, beyond it the row is rejected
               (Yang, Song, Xu 2002, J. Geodesy 76, "Robust estimator for correlated observations ...")

HUBER and IGG3 stop weighting while more than a fifth of the rows is far off for a third epoch running: it is then the
prediction that is wrong, and a filter that refuses its measurements never learns so.

All factors are kept within `least` and `most`.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit

F8 = NDArray[np.float64]

NONE, PAPER, STRONG, IAE_R, IAE_Q, SAGE_HUSA, HUBER, IGG3 = range(8)
ON_R, ON_Q = 0, 1
REJECTED = 1e12
"""Factor of the variance of a row that is as good as left out."""
FAR_SHARE = 0.2
FAR_EPOCHS = 3
FAR_SIGMAS = 3.0


class Rule(NamedTuple):
    """Numbers of an adaptation rule; those that a kind does not use are ignored."""

    kind: int
    alpha: float  # PAPER: adjustment coefficient
    weight: float  # PAPER: d_0
    limit: float  # PAPER: U, of the squared innovation
    memory: float  # STRONG: rho; SAGE_HUSA: b, the forgetting factor
    softening: float  # STRONG: factor on sum r
    window: int  # IAE: epochs
    noise: int  # SAGE_HUSA: ON_R or ON_Q
    c: float  # HUBER, IGG3: where rows begin to lose weight, sigmas
    c1: float  # IGG3: where they are rejected
    least: float  # limits of the factors
    most: float


class Factors(NamedTuple):
    """What a rule answers."""

    fading: float
    q_factor: float
    r_factor: float  # common to all rows; already in `r`


@njit
def memory_size(window: int) -> int:
    """Elements of the memory of a rule: epochs seen, fading, recursive values, and a ring of `window` epochs."""
    return 4 + 4 * max(window, 1)


@njit
def adapt(rule: Rule, memory: F8, v: F8, p: F8, q: F8, r: F8, beta: float, r_out: F8) -> Factors:
    """Factors of an epoch, before its update.

    Parameters
    ----------
    rule : Rule
    memory : (memory_size(window),)
        Zero before the first epoch; brought up to date. It travels with the belief.
    v : (m,)
        Innovations against the prediction; NaN rows are not counted.
    p, q, r : (m,)
        Variances: H Phi P Phi' H', H Q H' and R, each row.
    beta : float
        PAPER: adaptive term of eq. 20, zero without.
    r_out : (m,)
        Result: variances to use.
    """
    d, sp, sq, sr, m = 0.0, 0.0, 0.0, 0.0, 0
    for i in range(len(v)):
        r_out[i] = r[i]
        if not math.isnan(v[i]):
            unit = 1.0 if rule.kind == PAPER else r[i]
            d += v[i] * v[i] / unit
            sp += p[i] / unit
            sq += q[i] / unit
            sr += r[i] / unit
            m += 1
    fading, q_factor, r_factor = 1.0, 1.0, 1.0
    if m == 0 or rule.kind == NONE:
        return Factors(fading, q_factor, r_factor)
    first = memory[0] == 0.0
    memory[0] += 1.0
    if rule.kind == PAPER:
        last = memory[1]
        C0 = 0.5 * d if first else last * d / (1.0 + last)
        N = (rule.weight if d >= rule.limit else 1.0) * C0 - sq - sr + beta
        # sum p = 0 (a start that is believed to be exact): nothing there to fade
        fading = _within(rule.alpha * N / sp, 1.0, rule.most) if sp > 0.0 else 1.0
        memory[1] = fading
    elif rule.kind == STRONG:
        memory[1] = d if first else (rule.memory * memory[1] + d) / (1.0 + rule.memory)
        N = memory[1] - sq - rule.softening * sr
        fading = _within(N / sp, 1.0, rule.most) if sp > 0.0 else 1.0
    elif rule.kind == IAE_R or rule.kind == IAE_Q:
        _remember(memory, rule.window, d, sp, sq, sr)
        n = min(int(memory[0]), rule.window)
        if n == rule.window:
            md, mp, mq, mr = _means(memory, rule.window)
            if rule.kind == IAE_R:
                r_factor = _within((md - mp - mq) / mr, rule.least, rule.most)
            elif mq > 0.0:
                q_factor = _within((md - mp - mr) / mq, rule.least, rule.most)
    elif rule.kind == SAGE_HUSA:
        k = memory[0]
        weight = (1.0 - rule.memory) / (1.0 - rule.memory**k) if rule.memory < 1.0 else 1.0 / k
        if first:
            memory[1] = 1.0
        seen = (d - sp - sq) / sr if rule.noise == ON_R else (d - sp - sr) / max(sq, 1e-300)
        # bounded before it is averaged: one wild epoch, or a negative estimate, cannot carry the mean away
        memory[1] = (1.0 - weight) * memory[1] + weight * _within(seen, -10.0 * rule.most, 10.0 * rule.most)
        value = _within(memory[1], rule.least, rule.most)
        if rule.noise == ON_R:
            r_factor = value
        else:
            q_factor = value
    elif rule.kind == HUBER or rule.kind == IGG3:
        far = 0
        for i in range(len(v)):
            if not math.isnan(v[i]) and v[i] * v[i] > FAR_SIGMAS**2 * (p[i] + q[i] + r[i]):
                far += 1
        memory[2] = memory[2] + 1.0 if far > FAR_SHARE * m else 0.0
        if memory[2] < FAR_EPOCHS:
            for i in range(len(v)):
                if not math.isnan(v[i]):
                    u = abs(v[i]) / math.sqrt(p[i] + q[i] + r[i])
                    r_out[i] = r[i] / max(robust_weight(rule, u), 1.0 / REJECTED)
    if r_factor != 1.0:
        for i in range(len(v)):
            r_out[i] *= r_factor
    return Factors(fading, q_factor, r_factor)


@njit
def robust_weight(rule: Rule, u: float) -> float:
    """Weight, 0..1, of a row whose innovation is ``u`` of its standard deviations."""
    if u <= rule.c:
        return 1.0
    if rule.kind == HUBER:
        return rule.c / u
    if u >= rule.c1:
        return 0.0
    return rule.c / u * ((rule.c1 - u) / (rule.c1 - rule.c)) ** 2


@njit
def _within(value: float, least: float, most: float) -> float:
    return min(max(value, least), most)


@njit
def _remember(memory: F8, window: int, d: float, sp: float, sq: float, sr: float) -> None:
    """Put an epoch into the ring."""
    at = 4 + 4 * ((int(memory[0]) - 1) % window)
    memory[at], memory[at + 1], memory[at + 2], memory[at + 3] = d, sp, sq, sr


@njit
def _means(memory: F8, window: int) -> tuple[float, float, float, float]:
    """Means over the ring."""
    a, b, c, e = 0.0, 0.0, 0.0, 0.0
    for k in range(window):
        at = 4 + 4 * k
        a += memory[at]
        b += memory[at + 1]
        c += memory[at + 2]
        e += memory[at + 3]
    return a / window, b / window, c / window, e / window
