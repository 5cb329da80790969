"""Position from round trips to two geostationary satellites and the height, as BeiDou-1 did it."""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.constants import WGS84_A, WGS84_E2
from starwise.kernels._jit import njit

F8 = NDArray[np.float64]


@njit
def geodetic_to_ecef(lat: float, lon: float, h: float, out: F8) -> None:
    """ECEF position, m, of latitude, longitude (rad) and ellipsoidal height (m). Groves (2.112)."""
    s, c = math.sin(lat), math.cos(lat)
    R_N = WGS84_A / math.sqrt(1.0 - WGS84_E2 * s * s)
    out[0] = (R_N + h) * c * math.cos(lon)
    out[1] = (R_N + h) * c * math.sin(lon)
    out[2] = (R_N * (1.0 - WGS84_E2) + h) * s


@njit
def fix_two_satellites(trip1: float, trip2: float, h: float, sats_e: F8, start: F8, out: F8) -> int:
    """Latitude and longitude from two round trips and a height: Newton's method on the ellipsoid.

    The unknowns are latitude and longitude; the surface of height h is kept at every iteration, so that the height
    holds exactly.

    Parameters
    ----------
    trip1, trip2 : float
        Twice the distance between user and satellite, m.
    h : float
        Ellipsoidal height, m.
    sats_e : (2, 3)
        Satellites, ECEF, m.
    start : (2,)
        Latitude and longitude to begin with, rad; its hemisphere decides between the two solutions.
    out : (2,)
        Out: latitude and longitude, rad; NaN without a solution.

    Returns
    -------
    int
        Iterations, 0 without a solution: ranges that do not meet, or a user near the equator, where both
        satellites see north and south alike.
    """
    lat, lon = start[0], start[1]
    p, east, north = np.empty(3), np.empty(3), np.empty(3)
    out[0], out[1] = math.nan, math.nan
    for iteration in range(1, 31):
        geodetic_to_ecef(lat, lon, h, p)
        s, c, so, co = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
        w2 = 1.0 - WGS84_E2 * s * s
        R_N = WGS84_A / math.sqrt(w2)
        R_M = R_N * (1.0 - WGS84_E2) / w2
        east[0], east[1], east[2] = -so, co, 0.0
        north[0], north[1], north[2] = -s * co, -s * so, c
        g00, g01, r0 = _row(p, sats_e[0], trip1, north, east)
        g10, g11, r1 = _row(p, sats_e[1], trip2, north, east)
        det = g00 * g11 - g01 * g10
        if not abs(det) > 1e-4:
            return 0
        dn = (r0 * g11 - r1 * g01) / det
        de = (g00 * r1 - g10 * r0) / det
        if not (abs(dn) < 2e7 and abs(de) < 2e7):
            return 0
        step = math.sqrt(dn * dn + de * de)
        scale = min(1.0, 1e6 / step) if step > 0.0 else 1.0
        lat += scale * dn / (R_M + h)
        lon += scale * de / ((R_N + h) * c)
        if abs(lat) > 1.56 or lat * start[0] < 0.0:
            return 0
        if step < 1e-6:
            out[0], out[1] = lat, lon
            return iteration
    return 0


@njit
def _row(p: F8, sat: F8, trip: float, north: F8, east: F8) -> tuple[float, float, float]:
    """Derivatives of the distance along north and east, and its residual, m."""
    dx, dy, dz = p[0] - sat[0], p[1] - sat[1], p[2] - sat[2]
    r = math.sqrt(dx * dx + dy * dy + dz * dz)
    g_n = (dx * north[0] + dy * north[1] + dz * north[2]) / r
    g_e = (dx * east[0] + dy * east[1] + dz * east[2]) / r
    return g_n, g_e, 0.5 * trip - r


@njit
def fix_many(trips: F8, h: F8, sats_e: F8, start: F8, out: F8, iterations: NDArray[np.int64]) -> None:
    """`fix_two_satellites` of many measurements.

    Parameters
    ----------
    trips : (n, 2), h : (n,), sats_e : (2, 3), start : (2,)
    out : (n, 2), iterations : (n,)
        Out.
    """
    for i in range(len(h)):
        iterations[i] = fix_two_satellites(trips[i, 0], trips[i, 1], h[i], sats_e, start, out[i])
