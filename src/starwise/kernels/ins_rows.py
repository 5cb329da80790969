"""Measurement models of an inertial filter: innovations and their Jacobians in the error state.

Every function writes innovations v (measured minus predicted) and rows of H (the derivative of the prediction in the
error state of `starwise.kernels.ins_error`, all of it linearised at the current estimate), and leaves the covariance to
its caller. l is the antenna's lever arm in body axes, C = C_nb, phi the attitude error::

    position    p + C l + tau v                     d/d phi = -[C l x],  d/d v = tau
    velocity    v + C (omega x l) + tau a           d/d phi = -[C (omega x l) x],  d/d bg = C [l x]
    constraint  C_vb (C' v) + omega_v x (axle, 0, 0) + slip terms: its components right and down are zero
    rest        v = 0;  omega = 0
    odometer    forward component of the velocity of the axle, times 1 + its scale error
    barometer   h + its error

C_vb = R_y(pitch) R_z(yaw) turns body axes into those of the vehicle (forward, right, down): the sensor is turned to the
right by yaw, then up by pitch. Roll in the vehicle does not show: rolled or not, it goes straight ahead. Groves (2013)
14.3, 15.3; sideslip and squat grow with lateral and longitudinal acceleration: Rajamani (2012) "Vehicle dynamics and
control" 2.3, 4.
"""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.ins_state import At
from starwise.kernels.strapdown import OMEGA_IE, radii

F8 = NDArray[np.float64]


@njit
def clear(H: F8, m: int, n: int) -> None:
    """Zero the first m rows of H."""
    for a in range(m):
        for j in range(n):
            H[a, j] = 0.0


@njit
def _cross_rows(x: float, y: float, z: float, sign: float, H: F8, column: int) -> None:
    """Write sign [(x, y, z) x] into three rows of H from a column on."""
    H[0, column + 1], H[0, column + 2] = -sign * z, sign * y
    H[1, column], H[1, column + 2] = sign * z, -sign * x
    H[2, column], H[2, column + 1] = -sign * y, sign * x


@njit
def lever(est: F8, at: At, arm: F8, k: int) -> float:
    """Component k of the antenna lever arm, body axes, m: estimated or given."""
    return float(est[at.arm + k]) if at.arm >= 0 else float(arm[k])


@njit
def position_rows(nav: F8, est: F8, n: int, at: At, C: F8, arm: F8, fix: F8, H: F8, v: F8) -> None:
    """Three rows, north, east, down, m, of a position: ``fix`` is latitude, longitude (rad), height (m)."""
    clear(H, 3, n)
    s, c = math.sin(nav[7]), math.cos(nav[7])
    R_M, R_N = radii(s * s)
    v[0] = (fix[0] - nav[7]) * (R_M + nav[9])
    v[1] = (fix[1] - nav[8]) * (R_N + nav[9]) * c
    v[2] = nav[9] - fix[2]
    a, b, d = lever(est, at, arm, 0), lever(est, at, arm, 1), lever(est, at, arm, 2)
    x = C[0, 0] * a + C[0, 1] * b + C[0, 2] * d
    y = C[1, 0] * a + C[1, 1] * b + C[1, 2] * d
    z = C[2, 0] * a + C[2, 1] * b + C[2, 2] * d
    v[0] -= x
    v[1] -= y
    v[2] -= z
    _cross_rows(x, y, z, -1.0, H, 0)
    for k in range(3):
        H[k, 6 + k] = 1.0
        if at.arm >= 0:
            for j in range(3):
                H[k, at.arm + j] = C[k, j]
        if at.tau >= 0:
            H[k, at.tau] = nav[4 + k]
            H[k, 3 + k] = est[at.tau]
            v[k] -= est[at.tau] * nav[4 + k]


@njit
def velocity_rows(
    nav: F8, est: F8, n: int, at: At, C: F8, arm: F8, omega: F8, force: F8, fix: F8, H: F8, v: F8
) -> None:
    """Three rows of a velocity of the antenna, north, east, down, m/s.

    ``omega`` (3,) is the angular rate, body axes, rad/s; ``force`` (3,) the acceleration, navigation axes, m/s^2.
    """
    clear(H, 3, n)
    a, b, d = lever(est, at, arm, 0), lever(est, at, arm, 1), lever(est, at, arm, 2)
    p, q, r = omega[1] * d - omega[2] * b, omega[2] * a - omega[0] * d, omega[0] * b - omega[1] * a
    x = C[0, 0] * p + C[0, 1] * q + C[0, 2] * r
    y = C[1, 0] * p + C[1, 1] * q + C[1, 2] * r
    z = C[2, 0] * p + C[2, 1] * q + C[2, 2] * r
    v[0] = fix[0] - nav[4] - x
    v[1] = fix[1] - nav[5] - y
    v[2] = fix[2] - nav[6] - z
    _cross_rows(x, y, z, -1.0, H, 0)
    for k in range(3):
        H[k, 3 + k] = 1.0
        # C [l x]
        H[k, 9] = C[k, 1] * d - C[k, 2] * b
        H[k, 10] = C[k, 2] * a - C[k, 0] * d
        H[k, 11] = C[k, 0] * b - C[k, 1] * a
        if at.bgc >= 0:
            for j in range(3):
                H[k, at.bgc + j] = H[k, 9 + j]
        if at.arm >= 0:  # C [omega x]
            H[k, at.arm] = C[k, 1] * omega[2] - C[k, 2] * omega[1]
            H[k, at.arm + 1] = C[k, 2] * omega[0] - C[k, 0] * omega[2]
            H[k, at.arm + 2] = C[k, 0] * omega[1] - C[k, 1] * omega[0]
        if at.tau >= 0:
            H[k, at.tau] = force[k]
            v[k] -= est[at.tau] * force[k]


@njit
def axle_rows(nav: F8, est: F8, n: int, at: At, C: F8, omega: F8, force: F8, J: F8, u: F8) -> None:
    """Velocity u (3,) of the unsteered axle, vehicle axes, m/s, and its Jacobian J (3, n); what slips is not in it."""
    clear(J, 3, n)
    pitch, yaw, axle = 0.0, 0.0, 0.0
    if at.mount >= 0:
        pitch, yaw = est[at.mount], est[at.mount + 1]
    if at.axle >= 0:
        axle = est[at.axle]
    sp, cp, sy, cy = math.sin(pitch), math.cos(pitch), math.sin(yaw), math.cos(yaw)
    B = np.empty((3, 3))  # C_vb
    B[0, 0], B[0, 1], B[0, 2] = cp * cy, -cp * sy, sp
    B[1, 0], B[1, 1], B[1, 2] = sy, cy, 0.0
    B[2, 0], B[2, 1], B[2, 2] = -sp * cy, sp * sy, cp
    b, o = np.empty(3), np.empty(3)  # velocity in body axes, rate in vehicle axes
    for k in range(3):
        b[k] = C[0, k] * nav[4] + C[1, k] * nav[5] + C[2, k] * nav[6]
        o[k] = B[k, 0] * omega[0] + B[k, 1] * omega[1] + B[k, 2] * omega[2]
    for k in range(3):
        u[k] = B[k, 0] * b[0] + B[k, 1] * b[1] + B[k, 2] * b[2]
        for j in range(3):
            J[k, 3 + j] = B[k, 0] * C[j, 0] + B[k, 1] * C[j, 1] + B[k, 2] * C[j, 2]
        # C_vn [v x]
        J[k, 0] = J[k, 4] * nav[6] - J[k, 5] * nav[5]
        J[k, 1] = J[k, 5] * nav[4] - J[k, 3] * nav[6]
        J[k, 2] = J[k, 3] * nav[5] - J[k, 4] * nav[4]
        if at.axle >= 0:  # (0, o_z, -o_y) axle; d omega = -d bg
            for j in range(3):
                if k == 1:
                    J[k, 9 + j] = -B[2, j] * axle
                elif k == 2:
                    J[k, 9 + j] = B[1, j] * axle
                if at.bgc >= 0:
                    J[k, at.bgc + j] = J[k, 9 + j]
    if at.axle >= 0:
        J[1, at.axle], J[2, at.axle] = o[2], -o[1]
    if at.mount >= 0:
        # d/d pitch = [e_y x] C_vb, d/d yaw = C_vb [e_z x], of the velocity and of the rate
        p = np.empty(3)
        for k in range(3):
            J[k, at.mount + 1] = B[k, 1] * b[0] - B[k, 0] * b[1]
            p[k] = B[k, 1] * omega[0] - B[k, 0] * omega[1]
        J[0, at.mount], J[1, at.mount], J[2, at.mount] = u[2], -axle * o[0], -u[0]
        J[1, at.mount + 1] += axle * p[2]
        J[2, at.mount + 1] -= axle * p[1]
    u[1] += axle * o[2]
    u[2] -= axle * o[1]


@njit
def constraint_rows(nav: F8, est: F8, n: int, at: At, C: F8, omega: F8, force: F8, J: F8, u: F8, H: F8, v: F8) -> float:
    """Two rows, right and down, m/s: the unsteered axle goes where it points. Returns the forward speed, m/s.

    ``J`` (3, n) and ``u`` (3,) are work space.
    """
    axle_rows(nav, est, n, at, C, omega, force, J, u)
    for j in range(n):
        H[0, j], H[1, j] = J[1, j], J[2, j]
    v[0], v[1] = -u[1], -u[2]
    if at.steer >= 0:
        # acceleration in vehicle axes; its own dependence on the state is of second order
        ax = J[0, 3] * force[0] + J[0, 4] * force[1] + J[0, 5] * force[2]
        ay = J[1, 3] * force[0] + J[1, 4] * force[1] + J[1, 5] * force[2]
        H[0, at.steer], H[1, at.steer + 1] = u[0] * ay, u[0] * ax
        v[0] -= est[at.steer] * u[0] * ay
        v[1] -= est[at.steer + 1] * u[0] * ax
    if at.slip >= 0:
        for k in range(2):
            H[k, at.slip + k] = 1.0
            v[k] -= est[at.slip + k]
    return float(u[0])


@njit
def odometer_row(
    nav: F8, est: F8, n: int, at: At, C: F8, omega: F8, force: F8, speed: float, J: F8, u: F8, H: F8, v: F8
) -> None:
    """One row of the odometer's speed, m/s, forward positive."""
    axle_rows(nav, est, n, at, C, omega, force, J, u)
    scale = 1.0
    if at.odo >= 0:
        scale += est[at.odo]
    for j in range(n):
        H[0, j] = scale * J[0, j]
    if at.odo >= 0:
        H[0, at.odo] = u[0]
    v[0] = speed - scale * u[0]


@njit
def barometer_row(nav: F8, est: F8, n: int, at: At, height: float, H: F8, v: F8) -> None:
    """One row of a barometric height, m."""
    clear(H, 1, n)
    H[0, 8] = -1.0
    v[0] = height - nav[9]
    if at.baro >= 0:
        H[0, at.baro] = 1.0
        v[0] -= est[at.baro]


@njit
def rest_rows(nav: F8, n: int, H: F8, v: F8) -> None:
    """Three rows of zero velocity, m/s."""
    clear(H, 3, n)
    for k in range(3):
        H[k, 3 + k] = 1.0
        v[k] = -nav[4 + k]


@njit
def rest_rate_rows(nav: F8, est: F8, n: int, at: At, C: F8, mean: F8, i: int, H: F8, v: F8) -> None:
    """Three rows of zero angular rate, rad/s: mean readings are the bias and the Earth's rotation."""
    clear(H, 3, n)
    x, z = OMEGA_IE * math.cos(nav[7]), -OMEGA_IE * math.sin(nav[7])
    for k in range(3):
        v[k] = mean[i, k] - est[9 + k] - C[0, k] * x - C[2, k] * z
        H[k, 9 + k] = 1.0
        if at.bgc >= 0:
            v[k] -= est[at.bgc + k]
            H[k, at.bgc + k] = 1.0
        # C' omega_ie: d/d phi = C' [omega_ie x]
        H[k, 0] = C[1, k] * z
        H[k, 1] = C[2, k] * x - C[0, k] * z
        H[k, 2] = -C[1, k] * x
