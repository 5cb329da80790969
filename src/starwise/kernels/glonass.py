"""GLONASS orbits: equations of motion integrated forwards and backwards; SBAS orbits by a parabola."""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.constants import AE_GLO, J2_GLO, MU_GLO, OMEGA_E_GLO, R_AX, R_VX, R_X
from starwise.kernels._jit import njit

F8 = NDArray[np.float64]
I4 = NDArray[np.int32]
Six = tuple[float, float, float, float, float, float]

STEP_S = 60.0
"""Step of integration, s: costs less than 1 mm in a quarter of an hour, 2 mm in half an hour."""
N_NODES = 32
"""Nodes kept on each side of the reference time: 32 min, more than any record may be used for."""


@njit
def motion(s: Six, ax: float, ay: float, az: float) -> Six:
    """Time derivative of a GLONASS state in PZ-90 (rotating), m/s, m/s^2. GLONASS ICD L1/L2 5.1, A.3.1.2."""
    x, y, z, vx, vy, vz = s
    r2 = x * x + y * y + z * z
    r3 = r2 * math.sqrt(r2)
    w = OMEGA_E_GLO
    a = 1.5 * J2_GLO * MU_GLO * AE_GLO * AE_GLO / (r2 * r3)
    b = 5.0 * z * z / r2
    c = -MU_GLO / r3 - a * (1.0 - b)
    return (
        vx,
        vy,
        vz,
        (c + w * w) * x + 2.0 * w * vy + ax,
        (c + w * w) * y - 2.0 * w * vx + ay,
        (c - 2.0 * a) * z + az,
    )


@njit
def _moved(s: Six, d: Six, h: float) -> Six:
    return (
        s[0] + h * d[0],
        s[1] + h * d[1],
        s[2] + h * d[2],
        s[3] + h * d[3],
        s[4] + h * d[4],
        s[5] + h * d[5],
    )


@njit
def runge_kutta(s: Six, ax: float, ay: float, az: float, h: float) -> Six:
    """State after ``h`` seconds (either sign) by one step of the classical fourth-order method."""
    k1 = motion(s, ax, ay, az)
    k2 = motion(_moved(s, k1, 0.5 * h), ax, ay, az)
    k3 = motion(_moved(s, k2, 0.5 * h), ax, ay, az)
    k4 = motion(_moved(s, k3, h), ax, ay, az)
    h6 = h / 6.0
    return (
        s[0] + h6 * (k1[0] + 2.0 * k2[0] + 2.0 * k3[0] + k4[0]),
        s[1] + h6 * (k1[1] + 2.0 * k2[1] + 2.0 * k3[1] + k4[1]),
        s[2] + h6 * (k1[2] + 2.0 * k2[2] + 2.0 * k3[2] + k4[2]),
        s[3] + h6 * (k1[3] + 2.0 * k2[3] + 2.0 * k3[3] + k4[3]),
        s[4] + h6 * (k1[4] + 2.0 * k2[4] + 2.0 * k3[4] + k4[4]),
        s[5] + h6 * (k1[5] + 2.0 * k2[5] + 2.0 * k3[5] + k4[5]),
    )


@njit
def glonass(p: F8, t_k: float, nodes: F8, reach: I4) -> Six:
    """Position and velocity, PZ-90 ECEF of the instant, m and m/s, of a GLONASS record.

    Whole steps are remembered, so the result does not depend on what was asked before, only the time does.

    Parameters
    ----------
    p : (N_EPH_PAR,) float64
        Columns ``R_*``; luni-solar accelerations are held constant.
    t_k : float
        Time since the record's reference time, s, either sign; NaN outside +-32 min.
    nodes : (2, N_NODES, 6) float64
        Memory of the record: states after whole steps, backwards and forwards. Node 0 is the record itself.
    reach : (2,) int32
        How many of them are filled; zero at first.

    References
    ----------
    GLONASS ICD L1/L2 5.1, A.3.1.2; RTKLIB 2.4.3 manual E.4 (step of 60 s).
    """
    side = 1 if t_k >= 0.0 else 0
    h = STEP_S if t_k >= 0.0 else -STEP_S
    if not abs(t_k) < STEP_S * N_NODES:
        return np.nan, np.nan, np.nan, np.nan, np.nan, np.nan
    n = int(abs(t_k) / STEP_S)
    ax, ay, az = p[R_AX], p[R_AX + 1], p[R_AX + 2]
    memory = nodes[side]
    if reach[side] == 0:
        for i in range(3):
            memory[0, i] = p[R_X + i]
            memory[0, 3 + i] = p[R_VX + i]
        reach[side] = 1
    while reach[side] <= n:
        last = memory[reach[side] - 1]
        step = runge_kutta((last[0], last[1], last[2], last[3], last[4], last[5]), ax, ay, az, h)
        to = memory[reach[side]]
        to[0], to[1], to[2], to[3], to[4], to[5] = step
        reach[side] += 1
    s = memory[n]
    return runge_kutta((s[0], s[1], s[2], s[3], s[4], s[5]), ax, ay, az, t_k - n * h)


@njit
def parabola(p: F8, t_k: float) -> Six:
    """Position and velocity, ECEF, m and m/s, ``t_k`` seconds after an SBAS record. RTCA DO-229E A.4.4.11."""
    h = 0.5 * t_k * t_k
    return (
        p[R_X] + p[R_VX] * t_k + p[R_AX] * h,
        p[R_X + 1] + p[R_VX + 1] * t_k + p[R_AX + 1] * h,
        p[R_X + 2] + p[R_VX + 2] * t_k + p[R_AX + 2] * h,
        p[R_VX] + p[R_AX] * t_k,
        p[R_VX + 1] + p[R_AX + 1] * t_k,
        p[R_VX + 2] + p[R_AX + 2] * t_k,
    )
