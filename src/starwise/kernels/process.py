"""Time update of a satellite filter: motion of the user and its receiver clocks, discretised exactly.

State order: position (3), velocity (3, if the model has it), acceleration (3, likewise), clock bias of every active
system, clock drift of every active system. Every axis moves by the same scalar model F(dt), so Phi = F kron I3, and
the driving noise may differ between the horizontal and the vertical: Q = G(dt) kron M with M = h I + (v - h) up up'.

Clocks of several systems are one oscillator seen through different receiver channels and system times: its noise is
common to all of them, and each has a small random walk of its own (the inter-system bias). With no common noise they
are the independent clocks of the S3EKF paper.

The "current" statistical model (Zhou, Kumar 1984) is Singer's about a mean, the predicted acceleration: its state
moves with constant acceleration, its covariance as Singer's, and the variance of each axis (east, north, up) is that of
a Rayleigh density between the estimated acceleration and the largest one,

    sigma_a^2 = (4 - pi) / pi (a_max - |a|)^2 = sigma_0^2 (1 - |a| / a_max)^2.

Sources: Groves (2013) 9.4.2 (clock and motion models), Bar-Shalom, Li, Kirubarajan (2001) 6.2 (white noise
acceleration and jerk), Singer (1970) "Estimating optimal tracking filter performance for manned maneuvering
targets", Van Dierendonck, McGraw, Brown (1984) (two-state clock).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.constants import WGS84_E2
from starwise.kernels._jit import njit

F8 = NDArray[np.float64]

STATIC = 0
VELOCITY = 1
ACCELERATION = 2
SINGER = 3
CURRENT = 4
LEAST_ROOM = 0.1
"""Part of a_max that is always left to the "current" model: without noise it would never let go of an acceleration."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
# Nodes and weights on 0..1. Eight points integrate products of exp(-s) and polynomials over s <= 1 to rounding.
_NODES = 0.5 * (_NODES + 1.0)
_WEIGHTS = 0.5 * _WEIGHTS


class Process(NamedTuple):
    """Numbers of a process model."""

    kind: int  # STATIC, VELOCITY, ACCELERATION, SINGER, CURRENT
    nk: int  # kinematic states: 3, 6, 9, 9, 9
    horizontal: float  # PSD of the driving noise per horizontal axis (Singer: variance of the acceleration,
    # "current": that of an acceleration estimated as zero)
    vertical: float  # the same, vertical
    tau_s: float  # Singer, "current": correlation time
    bias_psd: float  # common clock: white frequency noise, m^2/s
    drift_psd: float  # common clock: random walk of the frequency, m^2/s^3
    system_bias_psd: float  # each clock by itself: random walk of the bias, m^2/s
    system_drift_psd: float  # random walk of the drift, m^2/s^3
    a_max: float = 0.0  # "current": largest horizontal acceleration, m/s^2; vertical: in proportion of the sigmas


@njit
def _lag(s: float) -> float:
    """Evaluate s - 1 + exp(-s) without cancellation, s >= 0."""
    if s > 0.3:
        return s - 1.0 + math.exp(-s)
    term, total = 0.5 * s * s, 0.0
    for k in range(3, 16):
        total += term
        term *= -s / k
    return total + term


@njit
def motion(kind: int, dt: float, tau: float, F: F8, G: F8) -> None:
    """Transition F and unit process noise G (3, 3) of one axis over ``dt`` s: rows position, velocity, acceleration.

    G is for unit spectral density of the driving noise; Singer and "current": for unit variance of the acceleration.
    F is that of the covariance: the state of the "current" model moves with constant acceleration (`predict`). Rows
    beyond the model's states are left as identity and zero.
    """
    for i in range(3):
        for j in range(3):
            F[i, j] = 1.0 if i == j else 0.0
            G[i, j] = 0.0
    if kind == STATIC:
        G[0, 0] = dt
        return
    if kind == VELOCITY:
        F[0, 1] = dt
        G[0, 0] = dt**3 / 3.0
        G[0, 1] = dt**2 / 2.0
        G[1, 1] = dt
    elif kind == ACCELERATION:
        F[0, 1] = F[1, 2] = dt
        F[0, 2] = dt**2 / 2.0
        G[0, 0] = dt**5 / 20.0
        G[0, 1] = dt**4 / 8.0
        G[0, 2] = dt**3 / 6.0
        G[1, 1] = dt**3 / 3.0
        G[1, 2] = dt**2 / 2.0
        G[2, 2] = dt
    else:
        # Singer: a' = -a / tau + w. With z = dt / tau: responses of x, v, a to w after s = t / tau are
        # tau^2 (s - 1 + e^-s), tau (1 - e^-s), e^-s, and G = 2 int_0^z of their products (in powers of tau).
        z = dt / tau
        F[0, 1] = dt
        F[0, 2] = tau * tau * _lag(z)
        F[1, 2] = -tau * math.expm1(-z)
        F[2, 2] = math.exp(-z)
        if z <= 1.0:
            for k in range(len(_NODES)):
                s = z * _NODES[k]
                w = 2.0 * z * _WEIGHTS[k]
                f0, f1, f2 = tau * tau * _lag(s), -tau * math.expm1(-s), math.exp(-s)
                G[0, 0] += w * f0 * f0
                G[0, 1] += w * f0 * f1
                G[0, 2] += w * f0 * f2
                G[1, 1] += w * f1 * f1
                G[1, 2] += w * f1 * f2
                G[2, 2] += w * f2 * f2
        else:
            e, e2 = math.exp(-z), math.exp(-2.0 * z)
            G[0, 0] = tau**4 * (1.0 - e2 + 2.0 * z + 2.0 * z**3 / 3.0 - 2.0 * z * z - 4.0 * z * e)
            G[0, 1] = tau**3 * (e2 + 1.0 - 2.0 * e + 2.0 * z * e - 2.0 * z + z * z)
            G[0, 2] = tau**2 * (1.0 - e2 - 2.0 * z * e)
            G[1, 1] = tau**2 * (4.0 * e - 3.0 - e2 + 2.0 * z)
            G[1, 2] = tau * (e2 + 1.0 - 2.0 * e)
            G[2, 2] = 1.0 - e2
    G[1, 0], G[2, 0], G[2, 1] = G[0, 1], G[0, 2], G[1, 2]


@njit
def noise_shape(process: Process, px: float, py: float, pz: float, M: F8) -> None:
    """Shape M (3, 3, ECEF) of the driving noise at a place: h across, v along the normal of the ellipsoid."""
    z = pz / (1.0 - WGS84_E2)  # the normal of the ellipsoid at its surface; within 0.01 mrad below 10 km
    r2 = px * px + py * py + z * z
    d = process.vertical - process.horizontal
    if r2 < 1.0:
        d = 0.0
        r2 = 1.0
    up = (px, py, z)
    for i in range(3):
        for j in range(3):
            M[i, j] = d * up[i] * up[j] / r2
        M[i, i] += process.horizontal


@njit
def current_shape(process: Process, x: F8, M: F8) -> None:
    """Shape M (3, 3, ECEF) of the noise of the "current" model at state x: a variance per axis east, north, up."""
    z = x[2] / (1.0 - WGS84_E2)
    flat = math.sqrt(x[0] * x[0] + x[1] * x[1])
    r = math.sqrt(flat * flat + z * z)
    if r < 1.0:
        return
    cos_lon, sin_lon = (x[0] / flat, x[1] / flat) if flat > 0.0 else (1.0, 0.0)
    s, c = z / r, flat / r
    for k in range(3):
        var, most = process.horizontal, process.a_max
        if k == 0:
            axis = (-sin_lon, cos_lon, 0.0)
        elif k == 1:
            axis = (-s * cos_lon, -s * sin_lon, c)
        else:
            axis = (c * cos_lon, c * sin_lon, s)
            var, most = process.vertical, process.a_max * math.sqrt(process.vertical / process.horizontal)
        a = abs(axis[0] * x[6] + axis[1] * x[7] + axis[2] * x[8])
        room = max(1.0 - a / most, LEAST_ROOM) if most > 0.0 else 1.0
        for i in range(3):
            for j in range(3):
                M[i, j] = var * room * room * axis[i] * axis[j] + (M[i, j] if k > 0 else 0.0)


@njit
def add_noise(P: F8, nk: int, nc: int, dt: float, process: Process, G: F8, M: F8) -> None:
    """Process noise of ``dt`` s onto the leading nk + 2 nc rows and columns of P; arguments as `predict`."""
    orders = nk // 3
    for a in range(orders):
        for b in range(orders):
            for i in range(3):
                for j in range(3):
                    P[3 * a + i, 3 * b + j] += G[a, b] * M[i, j]
    for k in range(nc):
        for m in range(nc):
            s_b, s_d = process.bias_psd, process.drift_psd
            if k == m:
                s_b += process.system_bias_psd
                s_d += process.system_drift_psd
            P[nk + k, nk + m] += s_b * dt + s_d * dt**3 / 3.0
            P[nk + k, nk + nc + m] += s_d * dt * dt / 2.0
            P[nk + nc + k, nk + m] += s_d * dt * dt / 2.0
            P[nk + nc + k, nk + nc + m] += s_d * dt


@njit
def predict(x: F8, P: F8, nk: int, nc: int, dt: float, process: Process, F: F8, G: F8, M: F8) -> None:
    """State and covariance ``dt`` s later, in place: x = Phi x, P = Phi P Phi' + Q.

    "current" model: x = Phi x + U a, a the acceleration before, which is x = Phi_1 x, that of constant acceleration.

    Parameters
    ----------
    x, P : (>= n,), (>= n, >= n)
        n = nk + 2 nc; P symmetric, and again on return.
    nk, nc : int
        Kinematic states; active clocks.
    dt : float
        s.
    process : Process
    F, G : (3, 3)
        From `motion` for this dt.
    M : (3, 3)
        From `noise_shape` or `current_shape`.
    """
    n = nk + 2 * nc
    orders = nk // 3
    # Rows, then columns, of Phi P Phi'. Row i of Phi has entries at i, i + 3, i + 6 only, so going down is in place.
    for i in range(3):
        for a in range(orders):
            r = 3 * a + i
            for j in range(n):
                s = F[a, a] * P[r, j]
                for b in range(a + 1, orders):
                    s += F[a, b] * P[3 * b + i, j]
                P[r, j] = s
            t = F[a, a] * x[r]
            for b in range(a + 1, orders):
                t += F[a, b] * x[3 * b + i]
            if process.kind == CURRENT:
                constant = 0.5 * dt * dt if a == 0 else (dt if a == 1 else 1.0)
                t += (constant - F[a, 2]) * x[6 + i]
            x[r] = t
    for k in range(nc):
        r = nk + k
        for j in range(n):
            P[r, j] += dt * P[r + nc, j]
        x[r] += dt * x[r + nc]
    for j in range(n):
        for i in range(3):
            for a in range(orders):
                r = 3 * a + i
                s = F[a, a] * P[j, r]
                for b in range(a + 1, orders):
                    s += F[a, b] * P[j, 3 * b + i]
                P[j, r] = s
        for k in range(nc):
            r = nk + k
            P[j, r] += dt * P[j, r + nc]
    add_noise(P, nk, nc, dt, process, G, M)
    for i in range(n):
        for j in range(i):
            s = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = s
            P[j, i] = s
