"""An adaptive filter over fixes of several receivers: any motion, any rule, rows one at a time."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.adapt import Rule, adapt, memory_size
from starwise.kernels.maneuver import CURRENT, axis_motion, current_variance

F8 = NDArray[np.float64]


class Motion(NamedTuple):
    """Motion of every axis; see `starwise.models.maneuver.AxisMotion`."""

    kind: int
    strength: float
    tau_s: float
    a_max: float
    velocity_sigma0: float
    acceleration_sigma0: float


@njit
def adaptive_run(motion: Motion, rule: Rule, dt: float, z: F8, r: F8, x_out: F8, P_out: F8, factors_out: F8) -> None:
    """Position, velocity, acceleration of every epoch.

    Parameters
    ----------
    motion : Motion
    rule : Rule
    dt : float
        Period, s.
    z, r : (n, receivers, 3)
        Fixes, m (NaN: none), variances, m^2.
    x_out, P_out : (n, 3, 3), (n, 3, 3, 3)
        Axis first.
    factors_out : (n, 3)
        Fading, factor on Q, factor on R.
    """
    n, K = z.shape[0], z.shape[1]
    x, P, Q = np.zeros((3, 3)), np.zeros((3, 3, 3)), np.zeros((3, 3, 3))
    Phi, Phi_1, G, M, x1 = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    v, p, q, rr, use = np.zeros(3 * K), np.zeros(3 * K), np.zeros(3 * K), np.zeros(3 * K), np.zeros(3 * K)
    memory = np.zeros(memory_size(rule.window))
    axis_motion(motion.kind, dt, motion.tau_s, Phi, Phi_1, G)
    for e in range(n):
        for a in range(3):
            for k in range(K):
                rr[3 * k + a] = use[3 * k + a] = r[e, k, a]
        factors_out[e] = 1.0
        if e == 0:
            for a in range(3):
                # the first receiver starts the filter; the others' fixes are used like any
                x[a, 0] = z[0, 0, a]
                P[a, 0, 0] = r[0, 0, a]
                P[a, 1, 1] = motion.velocity_sigma0**2
                P[a, 2, 2] = motion.acceleration_sigma0**2
        else:
            for a in range(3):
                s2 = motion.strength
                if motion.kind == CURRENT and motion.a_max > 0.0:
                    s2 = current_variance(x[a, 2], motion.a_max)
                for i in range(3):
                    x1[i] = 0.0
                    for j in range(3):
                        x1[i] += Phi_1[i, j] * x[a, j]
                        s = 0.0
                        for c in range(3):
                            s += Phi[i, c] * P[a, c, j]
                        M[i, j] = s
                for i in range(3):
                    x[a, i] = x1[i]
                    for j in range(3):
                        s = 0.0
                        for c in range(3):
                            s += M[i, c] * Phi[j, c]
                        P[a, i, j] = s
                        Q[a, i, j] = s2 * G[i, j]
                for k in range(K):
                    v[3 * k + a] = z[e, k, a] - x[a, 0]
                    p[3 * k + a], q[3 * k + a] = P[a, 0, 0], Q[a, 0, 0]
            found = adapt(rule, memory, v, p, q, rr, 0.0, use)
            factors_out[e, 0], factors_out[e, 1], factors_out[e, 2] = found.fading, found.q_factor, found.r_factor
            for a in range(3):
                for i in range(3):
                    for j in range(3):
                        P[a, i, j] = found.fading * P[a, i, j] + found.q_factor * Q[a, i, j]
        for a in range(3):
            for k in range(1 if e == 0 else 0, K):
                d = z[e, k, a] - x[a, 0]
                if math.isnan(d):
                    continue
                s = P[a, 0, 0] + use[3 * k + a]
                for i in range(3):
                    x1[i] = P[a, i, 0]
                for i in range(3):
                    x[a, i] += x1[i] * d / s
                    for j in range(i + 1):
                        # one triangle, copied: a fading factor makes rounding of the two grow apart
                        P[a, i, j] -= x1[i] * x1[j] / s
                        P[a, j, i] = P[a, i, j]
            for i in range(3):
                x_out[e, a, i] = x[a, i]
                for j in range(3):
                    P_out[e, a, i, j] = P[a, i, j]
