"""The 15-state inertial navigator of Lin, Meng, He: error states without height, feedback, spreading of covariance.

Truth minus estimate, as in ``starwise.kernels.ins_error`` without vertical velocity and height::

     0..2   phi_N phi_E phi_D      rad          7..9    constant part of gyro biases, body axes, rad/s
     3..4   dv_N dv_E              m/s          10..12  Markov part of gyro biases, rad/s
     5..6   position N E           m            13..14  Markov biases of accelerometers x, y, m/s^2
     15..   what a filter adds: clones, a delay; constant

The height channel is left out: height and vertical velocity are held at what the height source says.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.ins_error import dynamics, transition
from starwise.kernels.strapdown import NAV, advance, dcm, radii, rotate_left

F8 = NDArray[np.float64]

N0 = 15
NS = 8
"""Sensor states: gyro constants and Markov parts, accelerometer Markov parts."""


class SinsModel(NamedTuple):
    """What the filter believes of its sensors, SI.

    Attributes
    ----------
    dt : float
        Interval of the increments, s.
    every : int
        Intervals in a step of the covariance.
    gyro_psd, accel_psd : float
        White noise, rad^2/s and m^2/s^3.
    sigma_g, tau_g, sigma_a, tau_a : float
        Markov biases: standard deviation and correlation time.
    height : float
        Ellipsoidal, m.
    """

    dt: float
    every: int
    gyro_psd: float
    accel_psd: float
    sigma_g: float
    tau_g: float
    sigma_a: float
    tau_a: float
    height: float


class Mind(NamedTuple):
    """Everything a filter remembers; arrays, changed in place."""

    nav: F8
    last: F8
    bias: F8
    P: F8
    s: F8
    """Response of the estimate to a delay of 1 s."""


@njit
def new_mind(N: int) -> Mind:
    """Empty memory of a filter with N states."""
    return Mind(np.zeros(NAV), np.zeros(7), np.zeros(NS), np.zeros((N, N)), np.zeros(N))


@njit
def keep_mind(a: Mind, b: Mind) -> None:
    """Copy a to b."""
    for i in range(NAV):
        b.nav[i] = a.nav[i]
    for i in range(7):
        b.last[i] = a.last[i]
    for i in range(NS):
        b.bias[i] = a.bias[i]
    for i in range(len(a.s)):
        b.s[i] = a.s[i]
        for j in range(len(a.s)):
            b.P[i, j] = a.P[i, j]


@njit
def left_product(F: F8, decay: F8, B: F8, N: int, W: F8) -> None:
    """W = F B: seven dense rows of F (7, 15), decays below, what is behind 15 unchanged."""
    for i in range(7):
        for j in range(N):
            t = 0.0
            for k in range(N0):
                t += F[i, k] * B[k, j]
            W[i, j] = t
    for i in range(7, N):
        d = decay[i - 7] if i < N0 else 1.0
        for j in range(N):
            W[i, j] = d * B[i, j]


@njit
def spread(P: F8, F: F8, decay: F8, N: int, white_g: float, white_a: float, driven: F8, W: F8) -> None:
    """P = F P F' + Q, in place, symmetric; white noise half before and half after the transition."""
    for i in range(3):
        P[i, i] += 0.5 * white_g
    for i in range(3, 5):
        P[i, i] += 0.5 * white_a
    left_product(F, decay, P, N, W)
    for i in range(N):
        for j in range(i + 1):
            t = 0.0
            if j < 7:
                for k in range(N0):
                    t += W[i, k] * F[j, k]
            else:
                t = W[i, j] * (decay[j - 7] if j < N0 else 1.0)
            P[i, j] = t
            P[j, i] = t
    for i in range(3):
        P[i, i] += 0.5 * white_g
    for i in range(3, 5):
        P[i, i] += 0.5 * white_a
    for i in range(NS):
        P[7 + i, 7 + i] += driven[i]


@njit
def transition15(nav: F8, C: F8, fn: float, fe: float, fd: float, span: float, A: F8, M: F8, gain: F8, F: F8) -> None:
    """Rows of the first seven states in the transition matrix of the 15, over a time ``span``, s.

    Parameters
    ----------
    nav : (10,), C : (3, 3), fn, fe, fd : float
        Navigation state, C_nb at mid-interval and mean specific force, navigation axes, m/s^2.
    A : (9, 9), M : (9, 9), gain : (9, 6)
        Room.
    F : (7, 15)
        Out.
    """
    dynamics(nav, fn, fe, fd, A)
    transition(A, C, span, M, gain)
    for i in range(7):
        to = i if i < 5 else i + 1
        for k in range(7):
            F[i, k] = M[to, k if k < 5 else k + 1]
        for k in range(3):
            F[i, 7 + k] = gain[to, k]
            F[i, 10 + k] = gain[to, k]
        F[i, 13], F[i, 14] = gain[to, 3], gain[to, 4]


@njit
def roll(mind: Mind, dtheta: F8, dv: F8, a: int, b: int, model: SinsModel, Psi: F8, track: F8, use_Psi: bool) -> None:
    """Navigate from step a to step b and spread the covariance.

    Parameters
    ----------
    mind : Mind
        In place.
    dtheta, dv : (n, 3)
        Increments, rad and m/s.
    a, b : int
    model : SinsModel
    Psi : (15, 15)
        Multiplied from the left by the transitions, in place, if ``use_Psi``.
    track : (n + 1, 4)
        Out: latitude, longitude, v_N, v_E by step.
    """
    N = len(mind.s)
    A, C, M, gain = np.empty((9, 9)), np.empty((3, 3)), np.empty((9, 9)), np.empty((9, 6))
    F, W, column = np.zeros((7, N0)), np.empty((max(N, N0), max(N, N0))), np.empty((N, 1))
    decay, driven = np.ones(NS), np.zeros(NS)
    nav, bias, dt = mind.nav, mind.bias, model.dt
    j = a
    while j < b:
        e = min(j + model.every, b)
        fn, fe, fd = 0.0, 0.0, 0.0
        mid = j + (e - j) // 2
        for i in range(j, e):
            if i == mid:
                dcm(nav, C)
            gx = dtheta[i, 0] - dt * (bias[0] + bias[3])
            gy = dtheta[i, 1] - dt * (bias[1] + bias[4])
            gz = dtheta[i, 2] - dt * (bias[2] + bias[5])
            cn, ce, cd = advance(
                nav, gx, gy, gz, dv[i, 0] - dt * bias[6], dv[i, 1] - dt * bias[7], dv[i, 2], dt, mind.last
            )
            nav[6], nav[9] = 0.0, model.height
            fn, fe, fd = fn + cn, fe + ce, fd + cd
            track[i + 1, 0], track[i + 1, 1], track[i + 1, 2], track[i + 1, 3] = nav[7], nav[8], nav[4], nav[5]
        span = dt * (e - j)
        transition15(nav, C, fn / span, fe / span, fd / span, span, A, M, gain, F)
        dg, da = math.exp(-span / model.tau_g), math.exp(-span / model.tau_a)
        for k in range(3, NS):
            decay[k] = dg if k < 6 else da
            sigma = model.sigma_g if k < 6 else model.sigma_a
            driven[k] = sigma * sigma * (1.0 - decay[k] * decay[k])
            bias[k] *= decay[k]
        spread(mind.P, F, decay, N, model.gyro_psd * span, model.accel_psd * span, driven, W)
        for i in range(N):
            column[i, 0] = mind.s[i]
        for i in range(7):
            t = 0.0
            for k in range(N0):
                t += F[i, k] * column[k, 0]
            mind.s[i] = t
        for i in range(3, NS):
            mind.s[7 + i] *= decay[i]
        if use_Psi:
            left_product(F, decay, Psi, N0, W)
            for i in range(N0):
                for k in range(N0):
                    Psi[i, k] = W[i, k]
        j = e


@njit
def gain_and_update(mind: Mind, H: F8, v: F8, R: F8, D: F8, S: F8, dx: F8, g: F8) -> None:
    """Correction dx (N,) of an innovation v (2,), covariance and delay response after it.

    Parameters
    ----------
    H : (2, N), R : (2, 2), D : (2,)
        Jacobian, noise, and what a delay of 1 s adds to the measurement.
    S : (2, 2), dx : (N,), g : (2,)
        Out; g is what a delay of 1 s adds to the innovation.
    """
    P, N = mind.P, len(mind.s)
    PH = np.empty((N, 2))
    for i in range(N):
        for a in range(2):
            t = 0.0
            for k in range(N):
                t += P[i, k] * H[a, k]
            PH[i, a] = t
    for a in range(2):
        g[a] = D[a]
        for k in range(N):
            g[a] -= H[a, k] * mind.s[k]
        for b in range(2):
            t = R[a, b]
            for k in range(N):
                t += H[a, k] * PH[k, b]
            S[a, b] = t
    det = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    for i in range(N):
        k0 = (PH[i, 0] * S[1, 1] - PH[i, 1] * S[0, 1]) / det
        k1 = (PH[i, 1] * S[0, 0] - PH[i, 0] * S[1, 0]) / det
        dx[i] = k0 * v[0] + k1 * v[1]
        mind.s[i] += k0 * g[0] + k1 * g[1]
        for j in range(i + 1):
            P[i, j] -= k0 * PH[j, 0] + k1 * PH[j, 1]
            P[j, i] = P[i, j]


@njit
def feed_back(mind: Mind, dx: F8, h: float) -> None:
    """Put a correction into navigation state and biases."""
    nav = mind.nav
    s2 = math.sin(nav[7]) ** 2
    R_M, R_N = radii(s2)
    rotate_left(nav, dx[0], dx[1], dx[2])
    nav[4] += dx[3]
    nav[5] += dx[4]
    nav[8] += dx[6] / ((R_N + h) * math.cos(nav[7]))
    nav[7] += dx[5] / (R_M + h)
    for i in range(NS):
        mind.bias[i] += dx[7 + i]


@njit
def linear_model(dtheta: F8, dv: F8, nav0: F8, model: SinsModel, nav: F8, Phi: F8, Q: F8) -> None:
    """Transition matrices and noise of the 15 states along a trajectory that is flown without errors.

    Parameters
    ----------
    dtheta, dv : (n, 3)
        True increments.
    nav0 : (10,)
        True start.
    model : SinsModel
        ``every`` increments make a step.
    nav : (n // every + 1, 10)
        Out: navigation states by step.
    Phi, Q : (n // every, 15, 15)
        Out.
    """
    A, C, M, gain, F = np.empty((9, 9)), np.empty((3, 3)), np.empty((9, 9)), np.empty((9, 6)), np.zeros((7, N0))
    now, last, W = nav0.copy(), np.zeros(7), np.empty((N0, N0))
    span = model.every * model.dt
    decay, driven, zero = np.ones(NS), np.zeros(NS), np.zeros((N0, N0))
    for k in range(3, NS):
        decay[k] = math.exp(-span / (model.tau_g if k < 6 else model.tau_a))
        sigma = model.sigma_g if k < 6 else model.sigma_a
        driven[k] = sigma * sigma * (1.0 - decay[k] * decay[k])
    for i in range(NAV):
        nav[0, i] = now[i]
    for j in range(len(Phi)):
        fn, fe, fd = 0.0, 0.0, 0.0
        for i in range(j * model.every, (j + 1) * model.every):
            if i == j * model.every + model.every // 2:
                dcm(now, C)
            cn, ce, cd = advance(
                now, dtheta[i, 0], dtheta[i, 1], dtheta[i, 2], dv[i, 0], dv[i, 1], dv[i, 2], model.dt, last
            )
            fn, fe, fd = fn + cn, fe + ce, fd + cd
        transition15(now, C, fn / span, fe / span, fd / span, span, A, M, gain, F)
        for i in range(N0):
            for k in range(N0):
                Phi[j, i, k] = 1.0 if i == k else 0.0
                zero[i, k] = 0.0
        left_product(F, decay, Phi[j], N0, W)
        for i in range(N0):
            for k in range(N0):
                Phi[j, i, k] = W[i, k]
        spread(zero, F, decay, N0, model.gyro_psd * span, model.accel_psd * span, driven, W)
        for i in range(N0):
            for k in range(N0):
                Q[j, i, k] = zero[i, k]
        for i in range(NAV):
            nav[j + 1, i] = now[i]
