"""Frames: ECEF, geodetic (WGS 84), local level ENU and NED, azimuth and elevation.

``C_ab`` maps coordinates of frame b to frame a (Groves 2013, section 2.2). Angles are radians; degrees exist
only in files and on the command line.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from starwise.constants import WGS84_A, WGS84_E2

FloatArray = NDArray[np.float64]


def geodetic_from_ecef(pos_e: ArrayLike) -> FloatArray:
    """Latitude, longitude (rad) and ellipsoidal height (m) on WGS 84 of ECEF positions.

    Bowring's start followed by two exact corrections of the parametric latitude: below 1e-9 m from -10 km to
    50 000 km, poles and equator included. The Earth's centre gives latitude 0 and height -a.

    Parameters
    ----------
    pos_e : (..., 3) array_like
        ECEF position, m.

    Returns
    -------
    (..., 3) ndarray
        Latitude, longitude, height.

    References
    ----------
    B. R. Bowring, "Transformation from spatial to geographical coordinates", Survey Review 181 (1976);
    Groves (2013), eq. (2.113) and appendix C.
    """
    p = np.asarray(pos_e, dtype=np.float64)
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    b = WGS84_A * np.sqrt(1.0 - WGS84_E2)
    ep2 = WGS84_E2 / (1.0 - WGS84_E2)
    rho = np.hypot(x, y)
    r = np.hypot(rho, z)
    tiny = r < 1e-3
    beta = np.arctan2(z * (b / WGS84_A) * (1.0 + ep2 * b / np.where(tiny, 1.0, r)), rho)
    lat = np.zeros_like(rho)
    for _ in range(3):
        lat = np.arctan2(z + ep2 * b * np.sin(beta) ** 3, rho - WGS84_E2 * WGS84_A * np.cos(beta) ** 3)
        beta = np.arctan2((b / WGS84_A) * np.sin(lat), np.cos(lat))
    s, c = np.sin(lat), np.cos(lat)
    n = WGS84_A / np.sqrt(1.0 - WGS84_E2 * s * s)
    # Stable everywhere, the poles included: projection on the normal instead of rho / cos(lat).
    h = rho * c + z * s - n * (1.0 - WGS84_E2 * s * s)
    lat = np.where(tiny, 0.0, lat)
    h = np.where(tiny, -WGS84_A, h)
    return np.stack([lat, np.arctan2(y, x), h], axis=-1)


def ecef_from_geodetic(llh: ArrayLike) -> FloatArray:
    """ECEF position, m, of (..., 3) latitude, longitude (rad) and ellipsoidal height (m). Groves (2.112)."""
    g = np.asarray(llh, dtype=np.float64)
    lat, lon, h = g[..., 0], g[..., 1], g[..., 2]
    s, c = np.sin(lat), np.cos(lat)
    n = WGS84_A / np.sqrt(1.0 - WGS84_E2 * s * s)
    return np.stack([(n + h) * c * np.cos(lon), (n + h) * c * np.sin(lon), (n * (1.0 - WGS84_E2) + h) * s], axis=-1)


def C_ne_enu(lat: float, lon: float) -> FloatArray:
    """Rotation (3, 3) from ECEF to local east-north-up at a geodetic latitude and longitude (rad)."""
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    return np.array([[-so, co, 0.0], [-sl * co, -sl * so, cl], [cl * co, cl * so, sl]])


def rotations_ne_enu(lat: ArrayLike, lon: ArrayLike) -> FloatArray:
    """Rotations (n, 3, 3) from ECEF to local east-north-up at n latitudes and longitudes (rad)."""
    sl, cl = np.sin(np.asarray(lat)), np.cos(np.asarray(lat))
    so, co = np.sin(np.asarray(lon)), np.cos(np.asarray(lon))
    C = np.zeros((*np.shape(sl), 3, 3))
    C[..., 0, 0], C[..., 0, 1] = -so, co
    C[..., 1, 0], C[..., 1, 1], C[..., 1, 2] = -sl * co, -sl * so, cl
    C[..., 2, 0], C[..., 2, 1], C[..., 2, 2] = cl * co, cl * so, sl
    return C


def C_ne_ned(lat: float, lon: float) -> FloatArray:
    """Rotation (3, 3) from ECEF to local north-east-down (Groves 2.150) at a latitude and longitude (rad)."""
    enu = C_ne_enu(lat, lon)
    return np.stack([enu[1], enu[0], -enu[2]])


def enu_from_ecef(pos_e: ArrayLike, origin_e: ArrayLike) -> FloatArray:
    """East, north, up (m) of (..., 3) ECEF positions about one ECEF origin (3,)."""
    lat, lon, _ = geodetic_from_ecef(origin_e)
    return np.asarray((np.asarray(pos_e) - np.asarray(origin_e)) @ C_ne_enu(lat, lon).T)


def azimuth_elevation(pos_e: ArrayLike, sat_e: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Azimuth (0..2 pi, clockwise from north) and elevation, rad, of satellites seen from one receiver.

    Parameters
    ----------
    pos_e : (3,) array_like
        Receiver, ECEF, m.
    sat_e : (..., 3) array_like
        Satellites, ECEF at the time of reception, m.
    """
    enu = enu_from_ecef(sat_e, pos_e)
    az = np.mod(np.arctan2(enu[..., 0], enu[..., 1]), 2.0 * np.pi)
    return az, np.arctan2(enu[..., 2], np.hypot(enu[..., 0], enu[..., 1]))
