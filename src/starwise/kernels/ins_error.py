"""Errors of inertial navigation: how they grow, as a linear system, and how they are taken out.

The error state is *what must be added to the estimate*, truth minus estimate, in this order (`N_ERROR` elements)::

     0..2  att  rotation vector phi, navigation axes, rad:   C_nb = (I + [phi x]) C_nb(estimate)
     3..5  vel  velocity, north, east, down, m/s
     6..8  pos  position, north, east, down, *metres*:       dL = dN / (R_M + h), d lambda = dE / ((R_N + h) cos L), dh = -dD
     9..11 bg   bias of the gyroscopes, body axes, rad/s:     true rate = reading - bias
    12..14 ba   bias of the accelerometers, body axes, m/s^2: true force = reading - bias

so that an innovation is measured minus predicted, its Jacobian that of the prediction, and `feed_back` adds. Biases are
first-order Markov, bias' = -bias / tau + w, or random walks with tau = inf.

The first nine obey (phi-angle model, Groves 14.2, Shin 2005 ch. 2, with the signs above)::

    phi' = -omega_in x phi - d omega_in(vel, pos) - C_nb bg_error - C_nb n_g
    vel' = -f_n x phi - (2 omega_ie + omega_en) x vel - (2 d omega_ie + d omega_en) x v_n + (0, 0, 2 g / R) D - C_nb (ba_error + n_a)
    pos' = vel + terms of the turning navigation axes

where bg_error and ba_error are the errors of the bias estimates. Sensor errors enter through `gain` only, so that a filter
with more sensor states (scale factors, constant beside Markov parts) needs nothing new.
"""  # noqa: E501

import math

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.strapdown import OMEGA_IE, gravity_down, radii, rotate_left

F8 = NDArray[np.float64]

N_ERROR = 15
ATT = 0
VEL = 3
POS = 6
BG = 9
BA = 12


@njit
def dynamics(nav: F8, fn: float, fe: float, fd: float, A: F8) -> None:
    """System matrix A (9, 9) of attitude, velocity and position errors; 1/s and mixed units.

    Parameters
    ----------
    nav : (10,)
        Navigation state, see `starwise.kernels.strapdown`.
    fn, fe, fd : float
        Specific force, navigation axes, m/s^2.
    A : (9, 9)
        Out.
    """
    vn, ve, vd, h = nav[4], nav[5], nav[6], nav[9]
    s, c = math.sin(nav[7]), math.cos(nav[7])
    R_M, R_N = radii(s * s)
    rm, rn, t = 1.0 / (R_M + h), 1.0 / (R_N + h), s / c
    wie_n, wie_d = OMEGA_IE * c, -OMEGA_IE * s
    en_n, en_e, en_d = ve * rn, -vn * rm, -ve * t * rn
    zn, ze, zd = wie_n + en_n, en_e, wie_d + en_d
    on, oe, od = wie_n + zn, en_e, wie_d + zd
    for i in range(9):
        for j in range(9):
            A[i, j] = 0.0
    # d omega_in: of velocity, and of position (north, down)
    w_ne, w_en, w_de = rn, -rm, -t * rn
    w_nn, w_nd = wie_d * rm, ve * rn * rn  # d(omega_ie cos L) = -omega_ie sin L dL
    w_ed = -vn * rm * rm
    w_dn, w_dd = -wie_n * rm - ve * rn * rm / (c * c), -ve * t * rn * rn
    A[0, 1], A[0, 2], A[1, 0], A[1, 2], A[2, 0], A[2, 1] = zd, -ze, -zd, zn, ze, -zn
    A[0, 4], A[1, 3], A[2, 4] = -w_ne, -w_en, -w_de
    A[0, 6], A[0, 8], A[1, 8], A[2, 6], A[2, 8] = -w_nn, -w_nd, -w_ed, -w_dn, -w_dd
    # -f x phi
    A[3, 1], A[3, 2], A[4, 0], A[4, 2], A[5, 0], A[5, 1] = fd, -fe, -fd, fn, fe, -fn
    # -(2 omega_ie + omega_en) x vel
    A[3, 4], A[3, 5], A[4, 3], A[4, 5], A[5, 3], A[5, 4] = od, -oe, -od, on, oe, -on
    # -(d o) x v with d o of velocity: (rn ve, -rm vn, -t rn ve), and of position
    A[3, 3] -= w_en * vd
    A[3, 4] += w_de * ve
    A[4, 4] -= w_de * vn - w_ne * vd
    A[5, 4] -= w_ne * ve
    A[5, 3] += w_en * vn
    p_nn, p_dn = 2.0 * wie_d * rm, -2.0 * wie_n * rm - ve * rn * rm / (c * c)
    A[3, 6], A[3, 8] = p_dn * ve, w_dd * ve - w_ed * vd
    A[4, 6], A[4, 8] = p_nn * vd - p_dn * vn, w_nd * vd - w_dd * vn
    A[5, 6], A[5, 8] = -p_nn * ve, w_ed * vn - w_nd * ve
    A[5, 8] += 2.0 * gravity_down(s * s, h) / (math.sqrt(R_M * R_N) + h)
    A[6, 3] = A[7, 4] = A[8, 5] = 1.0
    A[6, 6], A[6, 8] = -vd * rm, vn * rm
    A[7, 6], A[7, 7], A[7, 8] = ve * t * rm, -vd * rn - vn * t * rm, ve * rn


@njit
def transition(A: F8, C: F8, dt: float, M: F8, gain: F8) -> None:
    """Transition of attitude, velocity and position errors over ``dt``, to second order, and the gain of sensor errors.

    Parameters
    ----------
    A : (9, 9)
        From `dynamics`, at mid-interval.
    C : (3, 3)
        C_nb at mid-interval.
    dt : float
        s.
    M : (9, 9)
        Out: I + A dt + (A dt)^2 / 2.
    gain : (9, 6)
        Out: what a constant error of the biases (bg, ba) does to the nine: integral of exp(A t) [-C 0; 0 -C; 0 0].
    """
    for i in range(9):
        for j in range(9):
            s = 0.0
            for k in range(9):
                s += A[i, k] * A[k, j]
            M[i, j] = dt * (A[i, j] + 0.5 * dt * s)
        M[i, i] += 1.0
    for i in range(9):
        for j in range(3):
            g, a = 0.0, 0.0
            for k in range(3):
                g -= A[i, k] * C[k, j]
                a -= A[i, 3 + k] * C[k, j]
            gain[i, j] = 0.5 * dt * dt * g
            gain[i, 3 + j] = 0.5 * dt * dt * a
    for i in range(3):
        for j in range(3):
            gain[i, j] -= dt * C[i, j]
            gain[3 + i, 3 + j] -= dt * C[i, j]


@njit
def white_noise(C: F8, gyro_psd: F8, accel_psd: F8, dt: float, P: F8) -> None:
    """Add white sensor noise of an interval ``dt`` to the attitude and velocity blocks of a covariance, in place.

    Parameters
    ----------
    C : (3, 3)
        C_nb.
    gyro_psd, accel_psd : (3,)
        Spectral densities, body axes, rad^2/s and m^2/s^3.
    dt : float
        s. Half of an interval before and half after the transition makes the correlations right to second order.
    P : (>= 6, >= 6)
    """
    for i in range(3):
        for j in range(3):
            g, a = 0.0, 0.0
            for k in range(3):
                g += C[i, k] * gyro_psd[k] * C[j, k]
                a += C[i, k] * accel_psd[k] * C[j, k]
            P[i, j] += dt * g
            P[3 + i, 3 + j] += dt * a


@njit
def phi_q15(
    nav: F8, fn: float, fe: float, fd: float, C: F8, dt: float, gyro_psd: F8, accel_psd: F8,
    tau_g: float, tau_a: float, sigma_g: F8, sigma_a: F8, Phi: F8, Q: F8,
) -> None:  # fmt: skip
    """Discrete Phi and Q (15, 15) of the error state over ``dt``.

    Parameters
    ----------
    nav, fn, fe, fd
        See `dynamics`; at mid-interval.
    C : (3, 3)
        C_nb at mid-interval.
    dt : float
        s; the series is of second order: 1 s and less (for longer, multiply several).
    gyro_psd, accel_psd : (3,)
        White noise, rad^2/s and m^2/s^3.
    tau_g, tau_a : float
        Correlation times of the biases, s; inf: random walk or constant.
    sigma_g, sigma_a : (3,)
        Markov biases: standard deviation, rad/s and m/s^2. With tau = inf: root spectral density of the random walk,
        rad/s/sqrt(s) and m/s^2/sqrt(s); 0 for a constant.
    Phi, Q : (15, 15)
        Out.
    """
    A, M, gain = np.empty((9, 9)), np.empty((9, 9)), np.empty((9, 6))
    dynamics(nav, fn, fe, fd, A)
    transition(A, C, dt, M, gain)
    for i in range(15):
        for j in range(15):
            Phi[i, j] = 0.0
            Q[i, j] = 0.0
    for i in range(9):
        for j in range(9):
            Phi[i, j] = M[i, j]
        for j in range(6):
            Phi[i, 9 + j] = gain[i, j]
    for k in range(6):
        tau = tau_g if k < 3 else tau_a
        sigma = sigma_g[k] if k < 3 else sigma_a[k - 3]
        Phi[9 + k, 9 + k] = math.exp(-dt / tau)
        if tau < np.inf:
            Q[9 + k, 9 + k] = -sigma * sigma * math.expm1(-2.0 * dt / tau)
        else:
            Q[9 + k, 9 + k] = sigma * sigma * dt
    # White noise: (Phi N Phi' + N) dt / 2. That of the biases reaches the others in the next step only.
    N, T = np.zeros((6, 6)), np.zeros((9, 6))
    white_noise(C, gyro_psd, accel_psd, 0.5 * dt, N)
    for i in range(9):
        for j in range(6):
            s = 0.0
            for k in range(6):
                s += M[i, k] * N[k, j]
            T[i, j] = s
    for i in range(9):
        for j in range(9):
            s = 0.0
            for k in range(6):
                s += T[i, k] * M[j, k]
            Q[i, j] += s
    for i in range(6):
        for j in range(6):
            Q[i, j] += N[i, j]


@njit
def feed_back(x: F8, nav: F8, bias: F8) -> None:
    """Error state into the estimate; its first 15 elements become zero.

    Parameters
    ----------
    x : (>= 15,)
        Error state, in place.
    nav : (10,)
        Navigation state, in place.
    bias : (6,)
        Biases of gyroscopes and accelerometers, in place.
    """
    rotate_left(nav, x[0], x[1], x[2])
    s, c = math.sin(nav[7]), math.cos(nav[7])
    R_M, R_N = radii(s * s)
    for i in range(3):
        nav[4 + i] += x[3 + i]
    nav[7] += x[6] / (R_M + nav[9])
    nav[8] += x[7] / ((R_N + nav[9]) * c)
    nav[9] -= x[8]
    for i in range(6):
        bias[i] += x[9 + i]
    for i in range(15):
        x[i] = 0.0
    scale = 1.5 - 0.5 * (nav[0] * nav[0] + nav[1] * nav[1] + nav[2] * nav[2] + nav[3] * nav[3])
    for i in range(4):
        nav[i] *= scale


@njit
def difference(nav: F8, other: F8, x: F8) -> None:
    """Error state (first nine elements) that takes ``other`` to ``nav``: nav minus other.

    Parameters
    ----------
    nav, other : (10,)
    x : (>= 9,)
        Out: attitude (rotation vector), velocity, position in metres.
    """
    # q = nav * conj(other)
    a, b, c, d = nav[0], nav[1], nav[2], nav[3]
    e, f, g, h = other[0], -other[1], -other[2], -other[3]
    w = a * e - b * f - c * g - d * h
    i = a * f + b * e + c * h - d * g
    j = a * g - b * h + c * e + d * f
    k = a * h + b * g - c * f + d * e
    if w < 0.0:
        w, i, j, k = -w, -i, -j, -k
    n = math.sqrt(i * i + j * j + k * k)
    scale = 2.0 * math.atan2(n, w) / n if n > 1e-12 else 2.0
    x[0], x[1], x[2] = scale * i, scale * j, scale * k
    s, cl = math.sin(other[7]), math.cos(other[7])
    R_M, R_N = radii(s * s)
    for m in range(3):
        x[3 + m] = nav[4 + m] - other[4 + m]
    x[6] = (nav[7] - other[7]) * (R_M + other[9])
    x[7] = (nav[8] - other[8]) * (R_N + other[9]) * cl
    x[8] = other[9] - nav[9]
