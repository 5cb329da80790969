"""True delays of the simulator's atmosphere along light paths, and correlated noise."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.constants import NS, WGS84_A, WGS84_E2
from starwise.kernels._jit import njit
from starwise.kernels.atmosphere import klobuchar, niell, troposphere

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

IONO_NONE = 0
IONO_BROADCAST = 1
IONO_LAYER = 2
TROPO_NONE = 0
TROPO_MODEL = 1

_M_PER_TECU = 40.308e16 / 1575.42e6**2
"""L1 delay of one TECU, m (Klobuchar 1996; IERS Conventions 2010, 9.4.1.1)."""
_SHELL_M = 400_000.0
_EARTH_M = 6_371_000.0


class Air(NamedTuple):
    """The true atmosphere of a run."""

    iono: int  # IONO_*
    iono_coef: F8  # (8,) Klobuchar coefficients, or content and gradients of the layer
    iono_scale: float  # times the broadcast model
    tropo: int  # TROPO_*
    tropo_offset: F8  # (m,) zenith delay beyond the model by epoch, m
    tropo_rate: F8  # (m,) its rate, m/s


@njit
def _layer(coef: F8, lat: float, lon: float, az: float, el: float, day_s: float) -> float:
    """Slant L1 delay, m, of a thin layer with a daily course.

    ``coef``: content above the user at 14 h, TECU; its gradients north and east, TECU/deg. The night keeps 0.15 of
    the maximum; the day is a squared cosine, 14 h +- 10 h, of the local time at the piercing point.
    """
    sin_zp = _EARTH_M / (_EARTH_M + _SHELL_M) * math.cos(max(el, 0.0))
    psi = math.pi / 2.0 - max(el, 0.0) - math.asin(sin_zp)
    north, east = psi * math.cos(az), psi * math.sin(az)
    lon_p = lon + east / max(math.cos(lat), 0.1)
    hour = day_s / 3600.0 + math.degrees(lon_p) / 15.0
    off = hour - 14.0 - 24.0 * math.floor((hour - 14.0) / 24.0 + 0.5)
    day = math.cos(0.5 * math.pi * off / 10.0) ** 2 if abs(off) < 10.0 else 0.0
    content: float = coef[0] + coef[1] * math.degrees(north) + coef[2] * math.degrees(east)
    vertical: float = _M_PER_TECU * max(content, 0.0) * (0.15 + 0.85 * day)
    return vertical / math.sqrt(1.0 - sin_zp * sin_zp)


@njit
def iono_mapping(el: float) -> float:
    """Slant over vertical delay of the thin layer."""
    s = _EARTH_M / (_EARTH_M + _SHELL_M) * math.cos(max(el, 0.0))
    return 1.0 / math.sqrt(1.0 - s * s)


@njit
def _place(px: float, py: float, pz: float) -> tuple[float, float, float]:
    """Latitude, longitude, height of a position (to 1e-9 rad near the Earth)."""
    rho = math.sqrt(px * px + py * py)
    lat = math.atan2(pz, rho * (1.0 - WGS84_E2))
    n = WGS84_A
    for _ in range(4):
        s = math.sin(lat)
        n = WGS84_A / math.sqrt(1.0 - WGS84_E2 * s * s)
        lat = math.atan2(pz + WGS84_E2 * n * s, rho)
    s, c = math.sin(lat), math.cos(lat)
    return lat, math.atan2(py, px), rho * c + pz * s - n * (1.0 - WGS84_E2 * s * s)


@njit
def _slant(
    air: Air, vertical: float, offset: float, lat: float, lon: float, h: float, az: float, el: float, day_s: float,
    doy: float,
) -> tuple[float, float]:  # fmt: skip
    """L1 ionosphere and troposphere, slant, m, with what comes on top of the models, vertical."""
    i, t = 0.0, 0.0
    if air.iono == IONO_BROADCAST:
        i = air.iono_scale * klobuchar(air.iono_coef, lat, lon, az, el, day_s)
    elif air.iono == IONO_LAYER:
        i = _layer(air.iono_coef, lat, lon, az, el, day_s)
    if vertical != 0.0:
        i += vertical * iono_mapping(el)
    if air.tropo == TROPO_MODEL:
        dry, wet = troposphere(lat, h, el, doy)
        t = dry + wet
        if offset != 0.0:
            t += offset * niell(lat, h, el, doy)[1]
    return i, t


@njit
def _seen(px: float, py: float, pz: float, sx: float, sy: float, sz: float) -> tuple[float, float, float, float, float]:
    """Latitude, longitude, height of the receiver; azimuth, elevation of the satellite."""
    lat, lon, h = _place(px, py, pz)
    sl, cl, so, co = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    dx, dy, dz = sx - px, sy - py, sz - pz
    e = -so * dx + co * dy
    n = -sl * co * dx - sl * so * dy + cl * dz
    u = cl * co * dx + cl * so * dy + sl * dz
    return lat, lon, h, math.atan2(e, n), math.atan2(u, math.sqrt(e * e + n * n))


@njit
def delays(
    air: Air, tag_ns: I8, epoch: I8, pos_e: F8, vel_e: F8, sat_pos: F8, sat_vel: F8, azimuth: F8, elevation: F8,
    vertical: F8, vertical_rate: F8, out: F8,
) -> None:  # fmt: skip
    """Atmospheric delays of light paths and their rates.

    Parameters
    ----------
    air : Air
    tag_ns : (m,) int64
    epoch : (n,) int64
        Epoch of each path.
    pos_e, vel_e : (m, 3) float64
        Receiver.
    sat_pos, sat_vel : (n, 3) float64
    azimuth, elevation : (n,) float64
    vertical, vertical_rate : (n,) float64
        Vertical L1 delay beyond the model, m, and its rate, m/s.
    out : (n, 4) float64
        L1 ionosphere m, its rate m/s, troposphere m, its rate m/s (rates by a difference over 1 s).
    """
    for i in range(len(epoch)):
        m = epoch[i]
        seconds = tag_ns[m] // NS
        day_s = float(seconds % 604_800)
        doy = (seconds // 86_400 + 5.0) % 365.25 + 1.0
        lat, lon, h = _place(pos_e[m, 0], pos_e[m, 1], pos_e[m, 2])
        el = elevation[i]
        iono, tropo = _slant(
            air, vertical[i], air.tropo_offset[m], lat, lon, h, azimuth[i], el, day_s, doy
        )  # fmt: skip
        iono_rate = vertical_rate[i] * iono_mapping(el) if vertical_rate[i] != 0.0 else 0.0
        tropo_rate = 0.0
        if air.tropo_rate[m] != 0.0:
            tropo_rate = air.tropo_rate[m] * niell(lat, h, el, doy)[1]
        for side in (-0.5, 0.5):
            lat, lon, h, az, el = _seen(
                pos_e[m, 0] + side * vel_e[m, 0], pos_e[m, 1] + side * vel_e[m, 1], pos_e[m, 2] + side * vel_e[m, 2],
                sat_pos[i, 0] + side * sat_vel[i, 0], sat_pos[i, 1] + side * sat_vel[i, 1],
                sat_pos[i, 2] + side * sat_vel[i, 2],
            )  # fmt: skip
            a, b = _slant(air, vertical[i], air.tropo_offset[m], lat, lon, h, az, el, day_s + side, doy)
            iono_rate += 2.0 * side * a
            tropo_rate += 2.0 * side * b
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = iono, iono_rate, tropo, tropo_rate


@njit
def markov(unit: F8, rho: F8, out: F8) -> None:
    """First-order Markov sequence of unit variance: ``unit`` white, ``rho[k]`` correlation from k - 1 to k."""
    x = 0.0
    for k in range(len(unit)):
        x = unit[k] if k == 0 else rho[k] * x + math.sqrt(max(1.0 - rho[k] * rho[k], 0.0)) * unit[k]
        out[k] = x
