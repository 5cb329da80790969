"""Late measurements in a linear system on a grid of steps: five ways to put them where they belong, or not.

A measurement f is valid at step ``valid[f]`` and there at step ``there[f]``. Every way produces, at every step, a
belief that uses only what is there by then:

* `IGNORED`: used as if it were valid when it arrives.
* `OPTIMAL_PREDICTION`: the filter lives one delay behind; its belief at the step of the last measurement is updated
  when the answer arrives and predicted to the present (Lin, Meng, He).
* `REPLAY`: beliefs of past steps are kept; a late measurement is put in at its step and all later ones are done again.
  Equal to a filter that had everything in order, whatever the delays.
* `CLONING`: what the measurement will see is copied into the state when it is taken and stays there, correlated, until
  the answer arrives (Roumeliotis, Burdick 2002). Equal to replay.
* `ESTIMATED`: the delay is not known: it is a state, and the measurement sees the past through the inverse transition.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

IGNORED = 0
OPTIMAL_PREDICTION = 1
REPLAY = 2
CLONING = 3
ESTIMATED = 4


class LateRows(NamedTuple):
    """Measurements in the order of their arrival: ``y = nominal + H x + noise`` at step ``valid``.

    Attributes
    ----------
    valid, there : (F,) int64
        Steps; ``there`` ascending and not before ``valid``.
    y : (F, m) float64
        NaN: no such row.
    H : (F, m, n) float64
    r : (F, m) float64
        Variances of rows with independent errors.
    """

    valid: I8
    there: I8
    y: F8
    H: F8
    r: F8


class LateSystem(NamedTuple):
    """Linear system with a nominal trajectory around which x is the error.

    Attributes
    ----------
    Phi, Q : (T, n, n) float64
        From step j to j + 1.
    nominal : (T + 1, m) float64
        What a measurement would be on the nominal trajectory, by step; zeros if x is the whole state.
    step_s : float
        Length of a step, s.
    """

    Phi: F8
    Q: F8
    nominal: F8
    step_s: float


class LateDelay(NamedTuple):
    """Prior of an unknown delay, s, its random walk (s^2 per step) and the longest one that can be handled."""

    mean: float
    sigma: float
    walk: float
    longest: float


class LateOut(NamedTuple):
    """Beliefs of steps 0..T; innovations, their covariances and the estimated delay with its sigma by measurement."""

    x: F8
    P: F8
    v: F8
    S: F8
    delay: F8


@njit
def predict_step(x: F8, P: F8, n: int, Phi: F8, Q: F8, W: F8) -> None:
    """Prediction x = Phi x, P = Phi P Phi' + Q of the first n elements; what is behind them stays, correlated."""
    N = len(x)
    for i in range(n):
        s = 0.0
        for k in range(n):
            s += Phi[i, k] * x[k]
        W[i, 0] = s
    for i in range(n):
        x[i] = W[i, 0]
    for i in range(n):
        for j in range(N):
            s = 0.0
            for k in range(n):
                s += Phi[i, k] * P[k, j]
            W[i, j] = s
    for i in range(n):
        for j in range(n, N):
            P[i, j] = W[i, j]
            P[j, i] = W[i, j]
        for j in range(i + 1):
            s = 0.5 * (Q[i, j] + Q[j, i])
            for k in range(n):
                s += W[i, k] * Phi[j, k]
            P[i, j] = s
            P[j, i] = s


@njit
def update_rows(x: F8, P: F8, y: F8, offset: F8, H: F8, r: F8, v: F8, S: F8) -> None:
    """Belief after rows with independent errors, one at a time; v and S are those before the first of them.

    Parameters
    ----------
    y, offset : (m,)
        Measured, and what is subtracted from it; NaN in ``y``: no such row (its v is NaN).
    H : (m, >= N)
    r : (m,)
    v : (m,), S : (m, m)
        Out.
    """
    m, N = len(y), len(x)
    PH = np.empty(N)
    for a in range(m):
        v[a] = y[a] - offset[a]
        for k in range(N):
            v[a] -= H[a, k] * x[k]
        for i in range(N):
            s = 0.0
            for k in range(N):
                s += P[i, k] * H[a, k]
            PH[i] = s
        for b in range(m):
            s = 0.0
            for k in range(N):
                s += H[b, k] * PH[k]
            S[b, a] = s
        S[a, a] += r[a]
    for a in range(m):
        e = y[a] - offset[a]
        if math.isnan(e):
            continue
        s = r[a]
        for k in range(N):
            e -= H[a, k] * x[k]
        for i in range(N):
            t = 0.0
            for k in range(N):
                t += P[i, k] * H[a, k]
            PH[i] = t
            s += H[a, i] * t
        for i in range(N):
            x[i] += PH[i] * e / s
            for j in range(i + 1):
                P[i, j] -= PH[i] * PH[j] / s
                P[j, i] = P[i, j]


@njit
def _copy(x: F8, P: F8, n: int, x2: F8, P2: F8) -> None:
    for i in range(n):
        x2[i] = x[i]
        for j in range(n):
            P2[i, j] = P[i, j]


@njit
def late_run(
    method: int, system: LateSystem, rows: LateRows, x0: F8, P0: F8, slots: int, delay: LateDelay, out: LateOut
) -> None:
    """Beliefs of all steps with late measurements treated in one way.

    Parameters
    ----------
    method : int
        `IGNORED` .. `ESTIMATED`. ``rows.valid`` is what the filter believes; `IGNORED` and `ESTIMATED` do not look at
        it, `OPTIMAL_PREDICTION` takes one that is valid before the last used as valid with it.
    system, rows
    x0 : (n,), P0 : (n, n)
        Belief at step 0.
    slots : int
        `CLONING`: most measurements that are taken but not there.
    delay : LateDelay
        `ESTIMATED`.
    out : LateOut
        Out.
    """
    T, n = system.Phi.shape[0], len(x0)
    F, m = rows.y.shape
    N = n
    if method == CLONING:
        N = n + slots * m
    if method == ESTIMATED:
        N = n + 1
    x, P, W, H = np.zeros(N), np.zeros((N, N)), np.empty((N, N)), np.zeros((m, N))
    _copy(x0, P0, n, x, P)
    anchor, xa, Pa = 0, x0.copy(), P0.copy()
    past = T + 1 if method == REPLAY else 1
    X, PP = np.empty((past, n)), np.empty((past, n, n))
    _copy(x, P, n, X[0], PP[0])
    head, tail, after = np.full(T + 1, -1), np.full(T + 1, -1), np.full(F, -1)
    owner = np.full(max(slots, 1), -1)
    if method == ESTIMATED:
        x[n], P[n, n] = delay.mean, delay.sigma * delay.sigma
    first, request = 0, 0
    order = np.argsort(rows.valid)
    for j in range(T + 1):
        if j > 0:
            predict_step(x, P, n, system.Phi[j - 1], system.Q[j - 1], W)
            if method == ESTIMATED:
                P[n, n] += delay.walk
            if method == REPLAY:
                _copy(x, P, n, X[j], PP[j])
        while method == CLONING and request < F and rows.valid[order[request]] <= j:
            f = order[request]
            request += 1
            if rows.there[f] > j:
                _clone(x, P, n, m, rows.H[f], f, owner)
        while first < F and rows.there[first] <= j:
            f = first
            first += 1
            if method == REPLAY:
                s = rows.valid[f]
                if tail[s] >= 0:
                    after[tail[s]] = f
                else:
                    head[s] = f
                tail[s] = f
                _replay(s, j, f, system, rows, x0, P0, X, PP, head, after, W, out)
                _copy(X[j], PP[j], n, x, P)
            elif method == OPTIMAL_PREDICTION:
                s = max(rows.valid[f], anchor)
                for i in range(anchor, s):
                    predict_step(xa, Pa, n, system.Phi[i], system.Q[i], W)
                anchor = s
                update_rows(xa, Pa, rows.y[f], system.nominal[s], rows.H[f], rows.r[f], out.v[f], out.S[f])
                _copy(xa, Pa, n, x, P)
                for i in range(s, j):
                    predict_step(x, P, n, system.Phi[i], system.Q[i], W)
            elif method == CLONING and rows.valid[f] < j:
                _answer(x, P, n, m, f, rows, system.nominal[rows.valid[f]], owner, H, out)
            elif method == ESTIMATED:
                _update_delayed(x, P, n, f, j, system, rows, delay, H, out)
            else:
                for a in range(m):
                    for k in range(N):
                        H[a, k] = rows.H[f, a, k] if k < n else 0.0
                update_rows(x, P, rows.y[f], system.nominal[j], H, rows.r[f], out.v[f], out.S[f])
        _copy(x, P, n, out.x[j], out.P[j])


@njit
def _replay(
    s: int, j: int, new: int, system: LateSystem, rows: LateRows, x0: F8, P0: F8, X: F8, PP: F8, head: I8, after: I8,
    W: F8, out: LateOut,
) -> None:  # fmt: skip
    """Beliefs X, PP of steps s..j again, with all measurements that are known there, in order."""
    n, m = len(x0), rows.y.shape[1]
    v, S = np.empty(m), np.empty((m, m))
    x, P = X[s], PP[s]
    if s == 0:
        _copy(x0, P0, n, x, P)
    for i in range(s, j + 1):
        x, P = X[i], PP[i]
        if i > 0:
            _copy(X[i - 1], PP[i - 1], n, x, P)
            predict_step(x, P, n, system.Phi[i - 1], system.Q[i - 1], W)
        f = head[i]
        while f >= 0:
            update_rows(x, P, rows.y[f], system.nominal[i], rows.H[f], rows.r[f], v, S)
            if f == new:
                for a in range(m):
                    out.v[f, a] = v[a]
                    for b in range(m):
                        out.S[f, a, b] = S[a, b]
            f = after[f]


@njit
def _clone(x: F8, P: F8, n: int, m: int, H: F8, f: int, owner: I8) -> None:
    """Copy H x of a measurement that is being taken into a free slot behind the state."""
    slot = 0
    while owner[slot] >= 0:
        slot += 1
    owner[slot] = f
    N = len(x)
    for a in range(m):
        c = n + slot * m + a
        s = 0.0
        for k in range(n):
            s += H[a, k] * x[k]
        x[c] = s
        for j in range(N):
            P[c, j] = 0.0
            P[j, c] = 0.0
        for j in range(N):
            if j != c:
                s = 0.0
                for k in range(n):
                    s += H[a, k] * P[k, j]
                P[c, j] = s
                P[j, c] = s
        s = 0.0
        for k in range(n):
            s += H[a, k] * P[k, c]
        P[c, c] = s


@njit
def _answer(
    x: F8, P: F8, n: int, m: int, f: int, rows: LateRows, nominal: F8, owner: I8, H: F8, out: LateOut
) -> None:  # fmt: skip
    """Update with a measurement whose clone is in the state; the slot becomes free."""
    slot = 0
    while owner[slot] != f:
        slot += 1
    owner[slot] = -1
    N = len(x)
    for a in range(m):
        for k in range(N):
            H[a, k] = 0.0
        H[a, n + slot * m + a] = 1.0
    update_rows(x, P, rows.y[f], nominal, H, rows.r[f], out.v[f], out.S[f])
    for a in range(m):
        c = n + slot * m + a
        x[c] = 0.0
        for j in range(N):
            P[c, j] = 0.0
            P[j, c] = 0.0


@njit
def _update_delayed(
    x: F8, P: F8, n: int, f: int, j: int, system: LateSystem, rows: LateRows, delay: LateDelay, H: F8, out: LateOut
) -> None:  # fmt: skip
    """Update with a measurement of the past at an estimated distance: y = (nominal + H x)(t - tau)."""
    m = rows.y.shape[1]
    tau = min(max(x[n], 0.0), delay.longest)
    back = min(tau / system.step_s, float(j))
    s = int(j - math.floor(back))  # the grid point after the instant, at most j
    part = back - math.floor(back)
    before = max(s - 1, 0)
    Psi, B = np.eye(n), np.empty((n, n))
    for i in range(s, j):
        for a in range(n):
            for b in range(n):
                t = 0.0
                for k in range(n):
                    t += system.Phi[i, a, k] * Psi[k, b]
                B[a, b] = t
        for a in range(n):
            for b in range(n):
                Psi[a, b] = B[a, b]
    offset = np.empty(m)
    Hs = np.empty((m, n))
    for a in range(m):
        for k in range(n):
            Hs[a, k] = rows.H[f, a, k]
    if before < s and part > 0.0:  # half of the way back to the grid point before: first order in the step
        Phi = system.Phi[before]
        for a in range(m):
            for k in range(n):
                t = 2.0 * rows.H[f, a, k]
                for i in range(n):
                    t -= rows.H[f, a, i] * Phi[i, k]
                Hs[a, k] = (1.0 - part) * rows.H[f, a, k] + part * t
    solve_right(Hs, Psi)
    for a in range(m):
        rate = (system.nominal[s, a] - system.nominal[before, a]) / system.step_s if before < s else 0.0
        offset[a] = system.nominal[s, a] - rate * part * system.step_s
        for k in range(n):
            H[a, k] = Hs[a, k]
        H[a, n] = -rate
        # linearised at tau: h = h(tau) - rate (x[n] - tau)
        offset[a] += rate * tau
    update_rows(x, P, rows.y[f], offset, H, rows.r[f], out.v[f], out.S[f])
    out.delay[f, 0] = x[n]
    out.delay[f, 1] = math.sqrt(P[n, n])


@njit
def solve_right(H: F8, A: F8) -> None:
    """H (m, n) := H A^-1 in place, by Gaussian elimination with pivots on A' (which is destroyed)."""
    m, n = H.shape
    for c in range(n):  # columns of A' are rows of A: solve A' Z' = H'
        p = c
        for i in range(c + 1, n):
            if abs(A[c, i]) > abs(A[c, p]):
                p = i
        if p != c:
            for k in range(n):
                A[k, c], A[k, p] = A[k, p], A[k, c]
            for a in range(m):
                H[a, c], H[a, p] = H[a, p], H[a, c]
        for i in range(c + 1, n):
            t = A[c, i] / A[c, c]
            if t != 0.0:
                for k in range(c, n):
                    A[k, i] -= t * A[k, c]
                for a in range(m):
                    H[a, i] -= t * H[a, c]
    for a in range(m):
        for c in range(n - 1, -1, -1):
            t = H[a, c]
            for k in range(c + 1, n):
                t -= A[k, c] * H[a, k]
            H[a, c] = t / A[c, c]
