"""The federated Kalman filters over receivers' fixes as Sun, Wu, Zhao, Liu (2009) write them, eq. 1-23.

State of an axis: x, v, a, eps (first-order Markov error of the fix); measurement x + eps. Every local filter has its
own constants; the fading factor is common to the three axes of a local filter. Deviations from the text are switched:
see `Literal`. The master's inverse of eq. 21 does not exist while P is singular (P(0) = 0 with Q of eq. 8 leaves the
position certain for two steps); `FLOOR` is added to its diagonal. With R of 1e-4 m beside 1e3 m of uncertainty the
local covariances are singular to rounding; fused whole, they are therefore written in information, P_i^-1 =
P_i(k+1/k)^-1 + H' R^-1 H, and in the states x + eps, v, a, eps, where nothing cancels.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.adapt import Rule, adapt, memory_size
from starwise.kernels.linalg import cholesky, cholesky_inverse
from starwise.kernels.maneuver import CURRENT, axis_motion, current_variance, markov

F8 = NDArray[np.float64]

FLOOR = 1e-9
"""m^2 (and in the units of the other states): keeps eq. 21 possible."""
BETA_NONE, BETA_POSITION, BETA_ACCELERATION = 0, 1, 2


class Literal(NamedTuple):
    """Constants of the paper, and switches for what is done differently (the first named is the paper's)."""

    tau_a: F8  # (K,) s
    sigma_a: F8  # (K,) m/s^2
    tau: F8  # (K,) s
    sigma: F8  # (K,) m
    R: F8  # (K,) m, standard deviation
    share: F8  # (K,)
    adaptive_variance: bool  # sigma_a^2 from a_max, or constant
    a_max: float  # m/s^2, not given by the paper
    eta: float  # of beta
    beta: int  # state whose change makes beta: BETA_*
    discretised: bool  # False: Q of eq. 8 as it stands; True: exact over the period
    fuse_eps: bool  # True: the whole state is fused; False: x, v, a only, eps stays with its local filter
    share_noise: bool  # False: P alone is shared; True: Q, too
    p0: F8  # (4,) initial variances; zero


@njit
def literal_run(options: Literal, rule: Rule, dt: float, z: F8, x_out: F8, P_out: F8, fading_out: F8) -> None:
    """Fused x, v, a of every epoch.

    Parameters
    ----------
    options : Literal
    rule : Rule
        `starwise.kernels.adapt.PAPER` for the adaptive filter, NONE for the plain one.
    dt : float
        Period, s.
    z : (n, K, 3)
        Fixes, m.
    x_out : (n, 3, 3)
        Axis, (position, velocity, acceleration).
    P_out : (n, 3, 3, 3)
        Covariance per axis.
    fading_out : (n, K)
    """
    n, K = z.shape[0], z.shape[1]
    m = 4 if options.fuse_eps else 3
    x, P = np.zeros((K, 3, 4)), np.zeros((K, 3, 4, 4))
    Phi, Phi_1, G = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    F, F1, Q, M = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((3, 4, 4)), np.zeros((4, 4))
    A, B = np.zeros((4, 4)), np.zeros((4, 4))
    memory = np.zeros((K, memory_size(rule.window)))
    v, p, q, r, r_use = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    J, rhs = np.zeros((3, 4, 4)), np.zeros((3, 4))
    x_g, P_g, y, x1 = np.zeros((3, 4)), np.zeros((3, 4, 4)), np.zeros(4), np.zeros(4)
    for k in range(K):
        for a in range(3):
            x[k, a, 0] = z[0, k, a]
            for i in range(4):
                P[k, a, i, i] = options.p0[i]
    for e in range(n):
        for a in range(3):
            for i in range(4):
                rhs[a, i] = 0.0
                for j in range(4):
                    J[a, i, j] = 0.0
        if e > 0:
            for k in range(K):
                beta = options.share[k]
                axis_motion(CURRENT, dt, options.tau_a[k], Phi, Phi_1, G)
                decay, gained = markov(dt, options.tau[k])
                for i in range(3):
                    for j in range(3):
                        F[i, j], F1[i, j] = Phi[i, j], Phi_1[i, j]
                F[3, 3] = F1[3, 3] = decay
                eta_term = 0.0
                for a in range(3):
                    var = options.sigma_a[k] ** 2
                    if options.adaptive_variance:
                        var = current_variance(x[k, a, 2], options.a_max)
                    for i in range(4):
                        for j in range(4):
                            Q[a, i, j] = 0.0
                    if options.discretised:
                        for i in range(3):
                            for j in range(3):
                                Q[a, i, j] = var * G[i, j]
                        Q[a, 3, 3] = options.sigma[k] ** 2 * gained
                    else:
                        Q[a, 2, 2], Q[a, 3, 3] = var, options.sigma[k] ** 2
                    if options.share_noise:
                        for i in range(4):
                            for j in range(4):
                                Q[a, i, j] /= beta
                    # eq. 3 and Phi P Phi'
                    for i in range(4):
                        x1[i] = 0.0
                        for j in range(4):
                            x1[i] += F1[i, j] * x[k, a, j]
                            s = 0.0
                            for c in range(4):
                                s += F[i, c] * P[k, a, c, j]
                            M[i, j] = s
                    if options.beta == BETA_POSITION:
                        eta_term += (x1[0] - x[k, a, 0]) ** 2 * options.eta
                    elif options.beta == BETA_ACCELERATION:
                        # the prediction leaves the acceleration where it is: the change is what the gain would make
                        eta_term += ((z[e, k, a] - x1[0] - x1[3]) / (0.5 * dt * dt)) ** 2 * options.eta
                    for i in range(4):
                        x[k, a, i] = x1[i]
                        for j in range(4):
                            s = 0.0
                            for c in range(4):
                                s += M[i, c] * F[j, c]
                            P[k, a, i, j] = s
                    v[a] = z[e, k, a] - x[k, a, 0] - x[k, a, 3]
                    p[a] = P[k, a, 0, 0] + 2.0 * P[k, a, 0, 3] + P[k, a, 3, 3]
                    q[a] = Q[a, 0, 0] + 2.0 * Q[a, 0, 3] + Q[a, 3, 3]
                    r[a] = options.R[k] ** 2
                factors = adapt(rule, memory[k], v, p, q, r, eta_term, r_use)
                fading_out[e, k] = factors.fading
                for a in range(3):
                    for i in range(4):
                        for j in range(4):
                            P[k, a, i, j] = factors.fading * P[k, a, i, j] + factors.q_factor * Q[a, i, j]
                    if m == 4:
                        _inform(x[k, a], P[k, a], z[e, k, a], z[e, 0, a], r_use[a], J[a], rhs[a], A, B)
                    _update(x[k, a], P[k, a], v[a], r_use[a], y)
        else:
            fading_out[e] = 1.0
        for a in range(3):
            if m == 4 and e > 0:
                _whole(J[a], rhs[a], z[e, 0, a], x_g[a], P_g[a], A, B)
            else:
                _master(x[:, a], P[:, a], m, x_g[a], P_g[a], A, B, y)
            for k in range(K):
                for i in range(m):
                    x[k, a, i] = x_g[a, i]
                    for j in range(m):
                        P[k, a, i, j] = P_g[a, i, j] / options.share[k]
                if m == 3:
                    # eps stays with its filter, uncorrelated with the fused motion
                    for i in range(3):
                        P[k, a, i, 3] = P[k, a, 3, i] = 0.0
            for i in range(3):
                x_out[e, a, i] = x_g[a, i]
                for j in range(3):
                    P_out[e, a, i, j] = P_g[a, i, j]


@njit
def _update(x: F8, P: F8, v: float, r: float, w: F8) -> None:
    """Eq. 5-7 of one axis with H = [1 0 0 1], in place."""
    s = P[0, 0] + 2.0 * P[0, 3] + P[3, 3] + r
    for i in range(4):
        w[i] = P[i, 0] + P[i, 3]
    for i in range(4):
        x[i] += w[i] * v / s
        for j in range(4):
            P[i, j] -= w[i] * w[j] / s
    for i in range(4):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@njit
def _master(x: F8, P: F8, m: int, x_g: F8, P_g: F8, A: F8, B: F8, y: F8) -> None:
    """Eq. 21 and 22 of one axis, in deviations from the first local filter."""
    base = x[0]
    for i in range(m):
        y[i] = 0.0
        for j in range(m):
            P_g[i, j] = 0.0
    for k in range(len(x)):
        for i in range(m):
            for j in range(m):
                A[i, j] = P[k, i, j]
            A[i, i] += FLOOR
        if not cholesky(A, m):
            continue
        cholesky_inverse(A, B, m)
        for i in range(m):
            for j in range(m):
                P_g[i, j] += B[i, j]
                y[i] += B[i, j] * (x[k, j] - base[j])
    if not cholesky(P_g, m):
        for i in range(m):
            x_g[i] = math.nan
        return
    cholesky_inverse(P_g, A, m)
    for i in range(m):
        s = base[i]
        for j in range(m):
            s += A[i, j] * y[j]
        x_g[i] = s
    for i in range(m):
        for j in range(m):
            P_g[i, j] = A[i, j]


@njit
def _inform(x: F8, P: F8, z: float, base: float, r: float, J: F8, rhs: F8, A: F8, B: F8) -> None:
    """Add a local filter's information, prediction x, P and fix z, about (u - base, v, a, eps), u = x + eps."""
    for i in range(4):
        for j in range(4):
            A[i, j] = P[i, j]
        A[i, i] += FLOOR
    if not cholesky(A, 4):
        return
    cholesky_inverse(A, B, 4)
    # x = u - eps: columns and rows of the information
    for i in range(4):
        B[i, 3] -= B[i, 0]
    for j in range(4):
        B[3, j] -= B[0, j]
    u = x[0] + x[3] - base
    for i in range(4):
        for j in range(4):
            J[i, j] += B[i, j]
        rhs[i] += B[i, 0] * u + B[i, 1] * x[1] + B[i, 2] * x[2] + B[i, 3] * x[3]
    J[0, 0] += 1.0 / r
    rhs[0] += (z - base) / r


@njit
def _whole(J: F8, rhs: F8, base: float, x_g: F8, P_g: F8, A: F8, B: F8) -> None:
    """Eq. 21 and 22 of one axis out of summed information about (u - base, v, a, eps)."""
    for i in range(4):
        for j in range(4):
            A[i, j] = J[i, j]
    if not cholesky(A, 4):
        for i in range(4):
            x_g[i] = math.nan
        return
    cholesky_inverse(A, B, 4)
    for i in range(4):
        s = 0.0
        for j in range(4):
            s += B[i, j] * rhs[j]
        x_g[i] = s
    x_g[0] += base - x_g[3]
    for i in range(4):
        for j in range(4):
            P_g[i, j] = B[i, j]
    for i in range(4):
        P_g[i, 0] -= P_g[i, 3]
    for j in range(4):
        P_g[0, j] -= P_g[3, j]
