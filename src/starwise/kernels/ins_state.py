"""State of an inertial filter: where its elements stand, its prediction at the rate of the sensors, its update.

The state begins with the 15 elements of `starwise.kernels.ins_error`; what a configuration adds stands behind them, in
any order, at the indices of `At`. ``est`` holds the estimates of all elements from 9 on, at the same indices as their
errors in x and P; those of attitude, velocity and position are in ``nav``. After every update the error state is fed
back and is zero again.

Every element from 9 on is a first-order Markov process or a random walk of its own: x' = -rate x + w, spectral density
``walk``. Receiver clocks are integrals of their drifts. So the transition has nine full rows, a diagonal, and the clocks.
"""  # noqa: E501

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.ins_error import dynamics, feed_back, transition
from starwise.kernels.linalg import cholesky, cholesky_inverse
from starwise.kernels.strapdown import advance, dcm

F8 = NDArray[np.float64]


class At(NamedTuple):
    """Index of the first element of each optional part of the state, -1 where it is absent."""

    bgc: int  # 3: constant part of the gyro biases, rad/s
    bac: int  # 3: constant part of the accelerometer biases, m/s^2
    sg: int  # 3: gyro scale factors
    sa: int  # 3: accelerometer scale factors
    mount: int  # 2: pitch and yaw of the body axes in the vehicle, rad
    axle: int  # 1: distance of the axle that does not steer ahead of the sensor, m
    steer: int  # 2: sideslip per lateral, squat per longitudinal acceleration, rad/(m/s^2)
    slip: int  # 2: lateral and vertical velocity error of the constraint, m/s
    arm: int  # 3: antenna lever arm, body axes, m
    tau: int  # 1: time offset of fixes: a tag t is of t + tau, s
    baro: int  # 1: error of the barometric height, m
    odo: int  # 1: scale error of the odometer
    clk: int  # 2: receiver clock of the first system, m, and its drift, m/s
    isb: int  # others: clocks of further systems against the first, m


class Motion(NamedTuple):
    """Work space and memory of the prediction."""

    last: F8  # (7,) of `advance`
    C: F8  # (3, 3) C_nb now
    M: F8  # (9, 9)
    A: F8  # (9, 9)
    gain: F8  # (9, 6)
    T: F8  # (9, n) rows of the transition of one step
    W: F8  # (9, n)
    top: F8  # (9, n) rows of the transition since the last record
    diag: F8  # (n,) diagonal of it
    since: F8  # (1,) s of it
    omega: F8  # (3,) angular rate against inertial space (the Earth's: 0.07 mm/s per m of arm), body axes, low-passed
    force: F8  # (3,) acceleration, navigation axes, low-passed


SMOOTH_S = 0.1  # time constant of what constraints and lever arms take as angular rate and acceleration


@njit
def reset_transition(n: int, mo: Motion) -> None:
    """Begin a new transition: identity."""
    mo.since[0] = 0.0
    for j in range(n):
        mo.diag[j] = 1.0
        for i in range(9):
            mo.top[i, j] = 1.0 if i == j else 0.0


@njit
def _columns(n: int, at: At, w: F8, f: F8, dt: float, mo: Motion) -> None:
    """Rows of the transition of one step: M and the gain of all sensor errors, at angular rate w and force f."""
    for i in range(9):
        for j in range(9):
            mo.T[i, j] = mo.M[i, j]
        for j in range(6):
            mo.T[i, 9 + j] = mo.gain[i, j]
        for k in range(3):
            if at.bgc >= 0:
                mo.T[i, at.bgc + k] = mo.gain[i, k]
            if at.bac >= 0:
                mo.T[i, at.bac + k] = mo.gain[i, 3 + k]
            if at.sg >= 0:
                mo.T[i, at.sg + k] = mo.gain[i, k] * w[k]
            if at.sa >= 0:
                mo.T[i, at.sa + k] = mo.gain[i, 3 + k] * f[k]


@njit
def _noise(C: F8, g: F8, a: F8, i: int, half: float, P: F8) -> None:
    """White noise of half an interval; ``g``, ``a`` are (k, 3) tables of spectral densities, row i."""
    for r in range(3):
        for s in range(r + 1):
            q, p = 0.0, 0.0
            for k in range(3):
                q += C[r, k] * g[i, k] * C[s, k]
                p += C[r, k] * a[i, k] * C[s, k]
            P[r, s] += half * q
            P[3 + r, 3 + s] += half * p
            if r != s:
                P[s, r] += half * q
                P[3 + s, 3 + r] += half * p


@njit
def predict(
    nav: F8, est: F8, P: F8, n: int, at: At, dtheta: F8, dv: F8, i: int, part: float, dt: float,
    gyro_psd: F8, accel_psd: F8, rate: F8, walk: F8, keep: bool, mo: Motion,
) -> None:  # fmt: skip
    """State and covariance after a part of interval i, in place.

    Parameters
    ----------
    nav, est, P
        Navigation state, other estimates, covariance (n, n).
    n : int
    at : At
    dtheta, dv : (k, 3)
        Increments of the intervals, readings.
    i : int
    part, dt : float
        Fraction of the interval, and its length, s.
    gyro_psd, accel_psd : (k, 3)
        White noise per interval, rad^2/s and m^2/s^3.
    rate, walk : (n,)
        Markov rates 1/s and spectral densities of elements from 9 on.
    keep : bool
        Accumulate the transition for smoothing.
    mo : Motion
    """
    w, f = np.empty(3), np.empty(3)
    for k in range(3):
        bg, ba, sg, sa = est[9 + k], est[12 + k], 1.0, 1.0
        if at.bgc >= 0:
            bg += est[at.bgc + k]
        if at.bac >= 0:
            ba += est[at.bac + k]
        if at.sg >= 0:
            sg += est[at.sg + k]
        if at.sa >= 0:
            sa += est[at.sa + k]
        w[k] = (part * dtheta[i, k] - bg * dt) / sg
        f[k] = (part * dv[i, k] - ba * dt) / sa
    C, A = mo.C, mo.A
    _noise(C, gyro_psd, accel_psd, i, 0.5 * dt, P)
    down0 = nav[6]
    fn, fe, fd = advance(nav, w[0], w[1], w[2], f[0], f[1], f[2], dt, mo.last)
    before = mo.W  # C of the start, for a moment
    for r in range(3):
        for s in range(3):
            before[r, s] = C[r, s]
    dcm(nav, C)
    for r in range(3):
        for s in range(3):
            before[r, s] = 0.5 * (before[r, s] + C[r, s])
    dynamics(nav, fn / dt, fe / dt, fd / dt, A)
    transition(A, before, dt, mo.M, mo.gain)
    low = dt / (SMOOTH_S + dt)
    g = (nav[6] - down0 - fd) / dt  # gravity as felt, to Coriolis
    for k in range(3):
        w[k] /= dt
        f[k] /= dt
        mo.omega[k] += low * (w[k] - mo.omega[k])
    mo.force[0] += low * (fn / dt - mo.force[0])
    mo.force[1] += low * (fe / dt - mo.force[1])
    mo.force[2] += low * (fd / dt + g - mo.force[2])
    _columns(n, at, w, f, dt, mo)
    W, T = mo.W, mo.T
    for r in range(9):
        for j in range(n):
            W[r, j] = 0.0
        for k in range(n):
            t = T[r, k]
            if t != 0.0:
                for j in range(n):
                    W[r, j] += t * P[k, j]
    for r in range(9):
        for s in range(r + 1):
            t = 0.0
            for k in range(n):
                t += W[r, k] * T[s, k]
            P[r, s] = t
            P[s, r] = t
    for k in range(9, n):
        d = 1.0 - dt * rate[k] * (1.0 - 0.5 * dt * rate[k])
        if rate[k] > 0.0:
            est[k] *= d
            for j in range(9, n):
                P[k, j] *= d
                P[j, k] *= d
            for r in range(9):
                W[r, k] *= d
        P[k, k] += 0.5 * dt * walk[k] * (1.0 + d * d)
    if at.clk >= 0:
        c, p = at.clk, dt * dt * walk[at.clk + 1]
        est[c] += dt * est[c + 1]
        for j in range(9, n):
            P[c, j] += dt * P[c + 1, j]
        for j in range(9, n):
            P[j, c] += dt * P[j, c + 1]
        for r in range(9):
            W[r, c] += dt * W[r, c + 1]
        P[c, c] += dt * p / 3.0
        P[c, c + 1] += 0.5 * p
        P[c + 1, c] += 0.5 * p
    for r in range(9):
        for j in range(9, n):
            P[r, j] = W[r, j]
            P[j, r] = W[r, j]
    _noise(C, gyro_psd, accel_psd, i, 0.5 * dt, P)
    if keep:
        for j in range(n):
            for r in range(9):
                t = T[r, j] * mo.diag[j] if j >= 9 else 0.0
                for k in range(9):
                    t += T[r, k] * mo.top[k, j]
                W[r, j] = t
        for j in range(n):
            for r in range(9):
                mo.top[r, j] = W[r, j]
            mo.diag[j] *= 1.0 - dt * rate[j] * (1.0 - 0.5 * dt * rate[j])
        mo.since[0] += dt


@njit
def update(P: F8, n: int, H: F8, v: F8, R: F8, m: int, gate: float, x: F8, PH: F8, K: F8, S: F8) -> tuple[float, float]:
    """Update with m rows at once, m at most 3: error state x (zero before) and P in place.

    Rows whose NIS passes the gate are not thrown away but taken with that much less weight: S is multiplied by
    NIS / gate, as if R had been larger. One wild row moves little; a filter that is wrong comes back.

    Parameters
    ----------
    P : (n, n)
    n, m : int
    H : (3, n)
        Jacobian; zeros are cheap.
    v : (3,)
        Innovations.
    R : (3, 3)
        Covariance of their errors.
    gate : float
        Chi-square threshold for m degrees of freedom; inf: none.
    x : (n,)
        Out: error state.
    PH, K : (3, n)
        Out: H P, and the gain, transposed.
    S : (3, 3)
        Out: inverse of the covariance of the innovations, as used.

    Returns
    -------
    nis : float
        Normalised innovation squared, before any change of weight; NaN if S is singular: nothing was done.
    weight : float
        1, or gate / NIS.
    """
    L = np.empty((3, 3))
    for a in range(m):
        for j in range(n):
            PH[a, j] = 0.0
        for k in range(n):
            h = H[a, k]
            if h != 0.0:
                for j in range(n):
                    PH[a, j] += h * P[k, j]
    for a in range(m):
        for b in range(m):
            t = R[a, b]
            for k in range(n):
                t += PH[a, k] * H[b, k]
            L[a, b] = t
    if not cholesky(L, m):
        return np.nan, 0.0
    cholesky_inverse(L, S, m)
    nis = 0.0
    for a in range(m):
        for b in range(m):
            nis += v[a] * S[a, b] * v[b]
    weight = 1.0
    if nis > gate:
        weight = gate / nis
        for a in range(m):
            for b in range(m):
                S[a, b] *= weight
    for a in range(m):
        for j in range(n):
            t = 0.0
            for b in range(m):
                t += S[a, b] * PH[b, j]
            K[a, j] = t
    for j in range(n):
        t = 0.0
        for a in range(m):
            t += K[a, j] * v[a]
        x[j] = t
        for k in range(j + 1):
            t = P[j, k]
            for a in range(m):
                t -= K[a, j] * PH[a, k]
            P[j, k] = t
            P[k, j] = t
    return nis, weight


@njit
def absorb(x: F8, n: int, nav: F8, est: F8, C: F8) -> None:
    """Error state into the estimates (`feed_back`); x becomes zero, C is C_nb again."""
    bias = est[9:15]
    feed_back(x, nav, bias)
    for k in range(15, n):
        est[k] += x[k]
        x[k] = 0.0
    dcm(nav, C)
