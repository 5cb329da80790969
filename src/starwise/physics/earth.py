"""The Earth as inertial navigation sees it: curvature, rotation, normal gravity (WGS 84).

Gravity is exact normal gravity: the field of the rotating equipotential ellipsoid in closed form, at any height, equal
to Somigliana's formula on the ellipsoid. The usual expansions in height (`normal_gravity`) are for comparison.
"""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from starwise.constants import WGS84_A, WGS84_E2, WGS84_F

F8 = NDArray[np.float64]

OMEGA_IE: Final = 7.292115e-5
"""Rotation rate of the Earth, rad/s (NGA.STND.0036 table 3.1)."""
GM: Final = 3.986004418e14
"""Geocentric gravitational constant with the atmosphere, m^3/s^2 (NGA.STND.0036 table 3.1)."""
GAMMA_E: Final = 9.7803253359
"""Normal gravity at the equator, m/s^2 (NGA.STND.0036 table 3.7)."""
GAMMA_P: Final = 9.8321849379
"""Normal gravity at the poles, m/s^2 (NGA.STND.0036 table 3.7)."""
STANDARD_GRAVITY: Final = 9.80665
"""The g of "9.80665 m/s^2 = 1 g", exact (CGPM 1901); unit of micro-g and of bank angles."""

_B: Final = WGS84_A * (1.0 - WGS84_F)
_E2LIN: Final = WGS84_A * WGS84_A - _B * _B  # linear eccentricity squared, m^2
_SERIES: Final = tuple((-1.0) ** (n + 1) / ((2 * n + 1) * (2 * n + 3)) for n in range(1, 10))


def curvature_radii(lat: ArrayLike) -> tuple[F8, F8]:
    """Meridian and prime vertical radii of curvature R_M, R_N (m) of WGS 84 at latitudes (rad). Groves (2.105-6)."""
    s2 = np.sin(np.asarray(lat, dtype=np.float64)) ** 2
    w2 = 1.0 - WGS84_E2 * s2
    R_N = WGS84_A / np.sqrt(w2)
    return R_N * (1.0 - WGS84_E2) / w2, R_N


def normal_gravity(lat: ArrayLike, height: ArrayLike) -> F8:
    """Downward normal gravity, m/s^2: Somigliana's formula, continued in height to second order.

    Parameters
    ----------
    lat, height : array_like
        Geodetic latitude (rad) and ellipsoidal height (m). Good to 1e-7 m/s^2 on the ground, 1e-5 at 20 km.

    References
    ----------
    NGA.STND.0036 eq. (4-1), (4-3); Heiskanen & Moritz (1967) eq. (2-124).
    """
    s2 = np.sin(np.asarray(lat, dtype=np.float64)) ** 2
    h = np.asarray(height, dtype=np.float64)
    k = _B * GAMMA_P / (WGS84_A * GAMMA_E) - 1.0
    g0 = GAMMA_E * (1.0 + k * s2) / np.sqrt(1.0 - WGS84_E2 * s2)
    m = OMEGA_IE**2 * WGS84_A**2 * _B / GM
    first = 2.0 / WGS84_A * (1.0 + WGS84_F + m - 2.0 * WGS84_F * s2)
    return np.asarray(g0 * (1.0 - first * h + 3.0 * h * h / WGS84_A**2))


def gravity_e(pos_e: ArrayLike) -> F8:
    """Normal gravity (gravitation and centrifugal acceleration), ECEF, m/s^2, of the WGS 84 ellipsoid.

    Closed form in ellipsoidal coordinates (u, beta), exact outside the ellipsoid and continued a few km inside.

    Parameters
    ----------
    pos_e : (..., 3) array_like
        ECEF position, m.

    Returns
    -------
    (..., 3) ndarray

    References
    ----------
    Heiskanen & Moritz (1967) eq. (2-58), (2-66), (6-6); NGA.STND.0036 eq. (4-5).
    """
    p = np.asarray(pos_e, dtype=np.float64)
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    rho = np.hypot(x, y)
    d = rho * rho + z * z - _E2LIN
    u2 = 0.5 * (d + np.sqrt(d * d + 4.0 * _E2LIN * z * z))
    u, v = np.sqrt(u2), np.sqrt(u2 + _E2LIN)
    beta = np.arctan2(z * v, u * rho)
    sb, cb = np.sin(beta), np.cos(beta)
    w = np.sqrt((u2 + _E2LIN * sb * sb) / (u2 + _E2LIN))
    q, q_prime = _q_functions(_E2LIN / u2, np.sqrt(_E2LIN) / u)
    q0, _ = _q_functions(np.asarray(_E2LIN / (_B * _B)), np.asarray(np.sqrt(_E2LIN) / _B))
    a2w2 = (OMEGA_IE * WGS84_A) ** 2
    gamma_u = -(GM / (v * v) + a2w2 * np.sqrt(_E2LIN) / (v * v) * q_prime / q0 * (0.5 * sb * sb - 1.0 / 6.0))
    gamma_b = a2w2 / v * q / q0 * sb * cb
    # gravitation along (rho, z); the unit vectors of u and beta carry 1/w each
    g_rho = (gamma_u * u / v * cb - gamma_b * sb) / (w * w)
    g_z = (gamma_u * sb + gamma_b * u / v * cb) / (w * w)
    scale = g_rho / np.where(rho > 0.0, rho, 1.0) + OMEGA_IE**2
    return np.stack([scale * x, scale * y, g_z], axis=-1)


def _q_functions(ratio2: F8, ratio: F8) -> tuple[F8, F8]:
    """Functions q and q' of Heiskanen & Moritz (2-58), (2-67) for E/u: series, free of the closed forms' loss."""
    q, q_prime = np.zeros_like(ratio), np.zeros_like(ratio)
    power = np.ones_like(ratio)
    for n, a in enumerate(_SERIES, 1):
        power = power * ratio2
        q = q + 2.0 * n * a * power * ratio
        q_prime = q_prime + 6.0 * a * power
    return q, q_prime
