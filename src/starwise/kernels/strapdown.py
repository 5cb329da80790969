"""Strapdown mechanisation in the navigation frame (local level north-east-down).

A navigation state is one array ``nav`` of `NAV` elements::

    nav[0:4]  q_nb   attitude quaternion, scalar first: v_n = C(q_nb) v_b, body axes forward-right-down
    nav[4:7]  v_n    velocity against the Earth, north, east, down, m/s
    nav[7:10] L, lambda, h   geodetic latitude and longitude (rad), ellipsoidal height (m), WGS 84

One `advance` takes the increments of one interval, dtheta and dv in the turning body axes, and the increments of the
interval before it, from which follow the terms of second order: coning (rotation vector), sculling (velocity) and the
like for position. With angular rate and specific force linear in time over two intervals they are exact to third
order in dt, so that the error of a smooth motion falls with dt^3 or faster; jumps leave dt^2.

Sources: Savage (1998) "Strapdown inertial navigation integration algorithm design" parts 1 and 2; Groves (2013)
5.4 and 5.5; Shin (2005) "Estimation techniques for low-cost inertial navigation" ch. 2. Latitudes beyond 89.9 deg are
outside the range of this frame.
"""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.constants import WGS84_A, WGS84_E2, WGS84_F
from starwise.kernels._jit import njit

F8 = NDArray[np.float64]

NAV = 10
LAST = 7

OMEGA_IE = 7.292115e-5  # rad/s, NGA.STND.0036 table 3.1
_GAMMA_E = 9.7803253359  # m/s^2, NGA.STND.0036 table 3.7
_K = (1.0 - WGS84_F) * 9.8321849379 / _GAMMA_E - 1.0  # Somigliana's constant, GAMMA_P of the same table
_M = OMEGA_IE**2 * WGS84_A**3 * (1.0 - WGS84_F) / 3.986004418e14  # centrifugal over gravitational, equator

_G1 = 2.0 / WGS84_A * (1.0 + WGS84_F + _M)
_G2 = 4.0 / WGS84_A * WGS84_F
_G3 = 3.0 / WGS84_A**2


@njit
def radii(s2: float) -> tuple[float, float]:
    """Meridian and prime vertical radii R_M, R_N, m, of sin^2 of the latitude. Groves (2.105), (2.106)."""
    w2 = 1.0 - WGS84_E2 * s2
    R_N = WGS84_A / math.sqrt(w2)
    return R_N * (1.0 - WGS84_E2) / w2, R_N


@njit
def gravity_down(s2: float, h: float) -> float:
    """Downward normal gravity, m/s^2, of sin^2 of the latitude: Somigliana, second order in height.

    NGA.STND.0036 eq. (4-1), (4-3); 1e-7 m/s^2 on the ground, 1e-5 at 20 km.
    """
    g0 = _GAMMA_E * (1.0 + _K * s2) / math.sqrt(1.0 - WGS84_E2 * s2)
    return g0 * (1.0 - (_G1 - _G2 * s2) * h + _G3 * h * h)


@njit
def dcm(q: F8, C: F8) -> None:
    """Rotation matrix C (3, 3) of a quaternion in the first four elements of ``q``, scalar first. Groves (2.34)."""
    a, b, c, d = q[0], q[1], q[2], q[3]
    C[0, 0] = a * a + b * b - c * c - d * d
    C[0, 1] = 2.0 * (b * c - a * d)
    C[0, 2] = 2.0 * (b * d + a * c)
    C[1, 0] = 2.0 * (b * c + a * d)
    C[1, 1] = a * a - b * b + c * c - d * d
    C[1, 2] = 2.0 * (c * d - a * b)
    C[2, 0] = 2.0 * (b * d - a * c)
    C[2, 1] = 2.0 * (c * d + a * b)
    C[2, 2] = a * a - b * b - c * c + d * d


@njit
def _half(x: float, y: float, z: float) -> tuple[float, float]:
    """Cosine of half the length of a rotation vector, and the sine of it over the length."""
    t = 0.25 * (x * x + y * y + z * z)
    if t < 0.01:
        c = 1.0 - t / 2.0 * (1.0 - t / 12.0 * (1.0 - t / 30.0 * (1.0 - t / 56.0)))
        s = 0.5 * (1.0 - t / 6.0 * (1.0 - t / 20.0 * (1.0 - t / 42.0 * (1.0 - t / 72.0))))
        return c, s
    half = math.sqrt(t)
    return math.cos(half), 0.5 * math.sin(half) / half


@njit
def rotate_left(q: F8, x: float, y: float, z: float) -> None:
    """Quaternion q(rotation vector) q, in place: C becomes C(x, y, z) C. The vector is in the outer frame."""
    w, s = _half(x, y, z)
    x, y, z = s * x, s * y, s * z
    a, b, c, d = q[0], q[1], q[2], q[3]
    q[0] = w * a - x * b - y * c - z * d
    q[1] = w * b + x * a + y * d - z * c
    q[2] = w * c - x * d + y * a + z * b
    q[3] = w * d + x * c - y * b + z * a


@njit
def rotate_right(q: F8, x: float, y: float, z: float) -> None:
    """Quaternion q q(rotation vector), in place: C becomes C C(x, y, z). The vector is in the inner frame."""
    w, s = _half(x, y, z)
    x, y, z = s * x, s * y, s * z
    a, b, c, d = q[0], q[1], q[2], q[3]
    q[0] = a * w - b * x - c * y - d * z
    q[1] = b * w + a * x + c * z - d * y
    q[2] = c * w + a * y + d * x - b * z
    q[3] = d * w + a * z + b * y - c * x


@njit
def advance(
    nav: F8, ax: float, ay: float, az: float, ux: float, uy: float, uz: float, dt: float, last: F8
) -> tuple[float, float, float]:
    """Navigation state one interval later, in place.

    Parameters
    ----------
    nav : (10,)
        q_nb, v_n, latitude, longitude, height.
    ax, ay, az : float
        Integral of the angular rate against inertial space over the interval, body axes, rad, biases removed.
    ux, uy, uz : float
        Integral of the specific force over the interval, in the turning body axes, m/s, biases removed.
    dt : float
        Length of the interval, s.
    last : (7,)
        Increments (angle, velocity) and length of the interval before, in place: on return those of this one.
        Length 0: there is none, or it is too old to tell anything.

    Returns
    -------
    tuple of float
        Velocity change by specific force over the interval, m/s, navigation axes (mean specific force times dt).
    """
    # The interval before, scaled to the length of this one
    k = 1.0
    if dt != last[6]:
        k = dt / last[6] if dt < 3.0 * last[6] else 0.0
    if k > 0.0:
        bx, by, bz = k * last[0], k * last[1], k * last[2]
        wx, wy, wz = k * last[3], k * last[4], k * last[5]
    else:
        bx, by, bz, wx, wy, wz = ax, ay, az, ux, uy, uz
    last[0], last[1], last[2], last[3], last[4], last[5], last[6] = ax, ay, az, ux, uy, uz, dt
    # Rotation vector with coning; velocity increment in the body axes of the start, with rotation and sculling
    px = ax + (by * az - bz * ay) / 12.0
    py = ay + (bz * ax - bx * az) / 12.0
    pz = az + (bx * ay - by * ax) / 12.0
    # a x u / 2 + (b x u + w x a) / 12, and a x (a x u) / 6: the next term of a steady rotation
    cx, cy, cz = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
    sx = ux + 0.5 * cx + (by * uz - bz * uy + wy * az - wz * ay) / 12.0 + (ay * cz - az * cy) / 6.0
    sy = uy + 0.5 * cy + (bz * ux - bx * uz + wz * ax - wx * az) / 12.0 + (az * cx - ax * cz) / 6.0
    sz = uz + 0.5 * cz + (bx * uy - by * ux + wx * ay - wy * ax) / 12.0 + (ax * cy - ay * cx) / 6.0
    # Change of the velocity increment from the interval before, in the body axes of the start: its part in position
    # (f linear: the mean of the velocity over the interval is v + dv / 2 - (dv - dv_before) / 12), and the rotation's
    jx = (sx - wx + 0.5 * (by * wz - bz * wy)) / 12.0
    jy = (sy - wy + 0.5 * (bz * wx - bx * wz)) / 12.0
    jz = (sz - wz + 0.5 * (bx * wy - by * wx)) / 12.0
    # Into the navigation frame of the start
    q0, q1, q2, q3 = nav[0], nav[1], nav[2], nav[3]
    C00, C01, C02 = q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3, 2.0 * (q1 * q2 - q0 * q3), 2.0 * (q1 * q3 + q0 * q2)
    C10, C11, C12 = 2.0 * (q1 * q2 + q0 * q3), q0 * q0 - q1 * q1 + q2 * q2 - q3 * q3, 2.0 * (q2 * q3 - q0 * q1)
    C20, C21, C22 = 2.0 * (q1 * q3 - q0 * q2), 2.0 * (q2 * q3 + q0 * q1), q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3
    fn = C00 * sx + C01 * sy + C02 * sz
    fe = C10 * sx + C11 * sy + C12 * sz
    fd = C20 * sx + C21 * sy + C22 * sz
    # The Earth at mid-interval: what `radii` and `gravity_down` say, with one root and few divisions
    vn, ve, vd = nav[4], nav[5], nav[6]
    s, c = math.sin(nav[7]), math.cos(nav[7])
    h = nav[9] - 0.5 * dt * (vd + 0.25 * (fd + dt * 9.8))
    dL = 0.5 * dt * (vn + 0.25 * fn) * (1.0 / WGS84_A)  # to 0.5 %, of a shift that is below 1e-5
    s, c = s + c * dL, c - s * dL
    s2 = s * s
    w = 1.0 / math.sqrt(1.0 - WGS84_E2 * s2)
    R_N = WGS84_A * w
    R_M = R_N * (1.0 - WGS84_E2) * w * w
    g = _GAMMA_E * (1.0 + _K * s2) * w * (1.0 - (_G1 - _G2 * s2) * h + _G3 * h * h)
    g_n = -1.628e-8 * h * s * c  # normal gravity at height leans: h times its change with latitude
    c1 = 1.0 / c
    t = s * c1
    wie_n, wie_d = OMEGA_IE * c, -OMEGA_IE * s
    rm, rn = 1.0 / (R_M + h), 1.0 / (R_N + h)
    # Velocity at mid-interval, with the transport rate of the start, then everything with it
    en_n, en_e, en_d = ve * rn, -vn * rm, -ve * t * rn
    on, oe, od = 2.0 * wie_n + en_n, en_e, 2.0 * wie_d + en_d
    mn = vn + 0.5 * (fn + dt * (g_n - (oe * vd - od * ve)))
    me = ve + 0.5 * (fe - dt * (od * vn - on * vd))
    md = vd + 0.5 * (fd + dt * (g - (on * ve - oe * vn)))
    en_n, en_e, en_d = me * rn, -mn * rm, -me * t * rn
    zn, ze, zd = dt * (wie_n + en_n), dt * en_e, dt * (wie_d + en_d)
    on, oe, od = 2.0 * wie_n + en_n, en_e, 2.0 * wie_d + en_d
    fn, fe, fd = fn - 0.5 * (ze * fd - zd * fe), fe - 0.5 * (zd * fn - zn * fd), fd - 0.5 * (zn * fe - ze * fn)
    dn = fn + dt * (g_n - (oe * md - od * me))
    de = fe - dt * (od * mn - on * md)
    dd = fd + dt * (g - (on * me - oe * mn))
    rn_n = dt * (vn + 0.5 * dn - (C00 * jx + C01 * jy + C02 * jz))
    rn_e = dt * (ve + 0.5 * de - (C10 * jx + C11 * jy + C12 * jz))
    rn_d = dt * (vd + 0.5 * dd - (C20 * jx + C21 * jy + C22 * jz))
    nav[4], nav[5], nav[6] = vn + dn, ve + de, vd + dd
    nav[7] += rn_n * rm
    nav[8] += rn_e * rn * c1
    nav[9] -= rn_d
    rotate_right(nav, px, py, pz)
    rotate_left(nav, -zn, -ze, -zd)
    scale = 1.5 - 0.5 * (nav[0] * nav[0] + nav[1] * nav[1] + nav[2] * nav[2] + nav[3] * nav[3])
    nav[0] *= scale
    nav[1] *= scale
    nav[2] *= scale
    nav[3] *= scale
    return fn, fe, fd


@njit
def mechanise(nav: F8, dtheta: F8, dv: F8, dt: F8, last: F8, out: F8) -> None:
    """Navigation states after every interval: `advance` over a file.

    Parameters
    ----------
    nav : (10,)
        State at the start, in place: on return that of the end.
    dtheta, dv : (n, 3)
        Increments, rad and m/s, body axes.
    dt : (n,)
        Intervals, s.
    last : (7,)
        See `advance`; zeros to begin with.
    out : (n, 10)
        Out.
    """
    for i in range(len(dt)):
        advance(nav, dtheta[i, 0], dtheta[i, 1], dtheta[i, 2], dv[i, 0], dv[i, 1], dv[i, 2], dt[i], last)
        for j in range(NAV):
            out[i, j] = nav[j]
