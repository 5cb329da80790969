"""The model of a pseudorange and of its rate, one row at a time: shared by least squares and every filter.

    code = rho + sagnac + c dt_r - c dt_s + group delay + troposphere + ionosphere + error
    rate = u . (v_s - v_r) + sagnac rate + c (drift_r - drift_s) + error

with u the unit vector from receiver to satellite and satellite quantities in ECEF at transmission. Section numbers
below are Groves (2013).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    C_LIGHT,
    OMEGA_E_GPS,
    ROW_LOW_CN0,
    ROW_LOW_ELEVATION,
    ROW_USED,
    WGS84_A,
    WGS84_E2,
    WGS84_F,
)
from starwise.kernels._jit import njit
from starwise.kernels.atmosphere import (
    klobuchar,
    klobuchar_bds,
    niell_coefficients,
    niell_mapping,
    saastamoinen,
    zenith_delays_mops,
)

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]

F_L1 = 1575.42e6  # Hz, carrier for which Klobuchar's delay is defined (IS-GPS-200N 20.3.3.5.2.5)
BDT_OFFSET_S = 14.0  # BeiDou time is behind GPS time by 14 s (BDS-SIS-ICD-B1I-3.0 3.3)
F_B1I = 1561.098e6  # Hz, the same for BeiDou (BDS-SIS-ICD-B1I-3.0 5.2.4.7)

IONO_NONE = 0
IONO_GPS = 1
IONO_BDS = 2

TROPO_NONE = 0
TROPO_SEASONAL = 1  # mean weather of latitude and season, Niell's mapping
TROPO_SAASTAMOINEN = 2  # standard atmosphere, 1 / sin(el)


class Rows(NamedTuple):
    """Inputs per (epoch, satellite), independent of the receiver: n rows sorted by epoch."""

    sat_pos: F8  # (n, 3) m, ECEF at transmission
    sat_vel: F8  # (n, 3) m/s
    clock_m: F8  # (n,) c * satellite clock - group delay, m
    drift_mps: F8  # (n,) c * satellite clock drift, m/s
    code_m: F8  # (n,)
    rate_mps: F8  # (n,), NaN without Doppler
    cn0_dbhz: F8  # (n,), NaN if not given
    freq_hz: F8  # (n,), inf for an ionosphere-free combination
    sigma_sat_m: F8  # (n,) 1-sigma accuracy of the ephemeris
    noise_factor: F8  # (n,) amplification of code noise by a combination
    system: I8  # (n,) index in SYSTEMS
    clock: I8  # (n,) index of the receiver clock that this row sees
    status: U1  # (n,) ROW_USED or the reason why not


class Epochs(NamedTuple):
    """Epochs of a run."""

    t_ns: I8  # (m,) GPST
    offsets: I8  # (m + 1,) rows of epoch i are offsets[i]:offsets[i + 1]


class ModelOptions(NamedTuple):
    """Numbers of the measurement model."""

    mask_rad: float
    cn0_min_dbhz: float
    iono_model: I8  # (7,) IONO_* per system
    iono_coef: F8  # (7, 8) Klobuchar alpha, beta per system
    troposphere: int  # TROPO_*
    code_sigma: F8  # (7,) code noise at the zenith and 45 dB-Hz, m, per system
    rate_sigma: float  # pseudorange-rate noise at the zenith and 45 dB-Hz, m/s
    fixed_code_sigma_m: float  # > 0 replaces the whole code variance (simulation with known noise)
    fixed_rate_sigma_mps: float


class RowModel(NamedTuple):
    """What the model says of each row at the receiver position last used: outputs, row-aligned with `Rows`."""

    elevation: F8  # rad
    azimuth: F8  # rad
    geometric: F8  # m
    sagnac: F8  # m
    troposphere: F8  # m
    ionosphere: F8  # m
    code_var: F8  # m^2
    rate_var: F8  # m^2/s^2
    v_code: F8  # innovation (filters) or residual (least squares), m
    s_code: F8  # its variance, m^2
    v_rate: F8  # m/s
    s_rate: F8  # m^2/s^2
    status: U1
    rate_used: U1  # 1 if the Doppler row was used


@njit
def range_los(
    px: float, py: float, pz: float, sx: float, sy: float, sz: float
) -> tuple[float, float, float, float, float]:
    """Geometric range (m), Sagnac term (m) and unit vector receiver to satellite, ECEF of transmission time.

    Closed form, below 0.1 mm against the iterated light time (Groves 8.36 with 8.33).
    """
    dx, dy, dz = sx - px, sy - py, sz - pz
    rho = math.sqrt(dx * dx + dy * dy + dz * dz)
    sagnac = OMEGA_E_GPS / C_LIGHT * (sx * py - sy * px)
    return rho, sagnac, dx / rho, dy / rho, dz / rho


@njit
def range_rate(
    px: float, py: float, vx: float, vy: float, vz: float,
    ux: float, uy: float, uz: float, sat_pos: F8, sat_vel: F8, i: int,
) -> float:  # fmt: skip
    """Range rate, m/s, of row i, the Sagnac rate included (Groves 9.162)."""
    rate: float = ux * (sat_vel[i, 0] - vx) + uy * (sat_vel[i, 1] - vy) + uz * (sat_vel[i, 2] - vz)
    rate += OMEGA_E_GPS / C_LIGHT * (sat_vel[i, 0] * py + sat_pos[i, 0] * vy - sat_vel[i, 1] * px - sat_pos[i, 1] * vx)
    return rate


@njit
def geodetic(px: float, py: float, pz: float) -> tuple[float, float, float]:
    """Latitude, longitude (rad) and height (m) on WGS 84 of an ECEF position (see `starwise.frames`)."""
    b = WGS84_A * (1.0 - WGS84_F)
    ep2 = WGS84_E2 / (1.0 - WGS84_E2)
    rho = math.sqrt(px * px + py * py)
    r = math.sqrt(rho * rho + pz * pz)
    if r < 1e-3:
        return 0.0, 0.0, -WGS84_A
    beta = math.atan2(pz * (1.0 - WGS84_F) * (1.0 + ep2 * b / r), rho)
    lat = 0.0
    for _ in range(2):
        sb, cb = math.sin(beta), math.cos(beta)
        lat = math.atan2(pz + ep2 * b * sb * sb * sb, rho - WGS84_E2 * WGS84_A * cb * cb * cb)
        beta = math.atan2((1.0 - WGS84_F) * math.sin(lat), math.cos(lat))
    s, c = math.sin(lat), math.cos(lat)
    n = WGS84_A / math.sqrt(1.0 - WGS84_E2 * s * s)
    return lat, math.atan2(py, px), rho * c + pz * s - n * (1.0 - WGS84_E2 * s * s)


@njit
def ionosphere_delay(
    options: ModelOptions,
    system: int,
    freq_hz: float,
    lat: float,
    lon: float,
    az: float,
    el: float,
    tow: float,
) -> float:
    """Slant ionosphere delay of a code on ``freq_hz``, m, by the broadcast model chosen for the system."""
    model = options.iono_model[system]
    if model == IONO_GPS:
        return float(klobuchar(options.iono_coef[system], lat, lon, az, el, tow) * (F_L1 / freq_hz) ** 2)
    if model == IONO_BDS:
        return float(
            klobuchar_bds(options.iono_coef[system], lat, lon, az, el, tow - BDT_OFFSET_S) * (F_B1I / freq_hz) ** 2
        )
    return 0.0


@njit
def variances(
    options: ModelOptions, system: int, el: float, cn0: float, sigma_sat: float, factor: float,
    iono: float, freq_hz: float,
) -> tuple[float, float]:  # fmt: skip
    """Variance of a pseudorange (m^2) and of its rate (m^2/s^2).

    Independent contributions are added: receiver noise and multipath, growing towards the horizon and, where the
    receiver says so, with falling C/N0; ephemeris; half of the broadcast ionosphere (IS-GPS-200N 20.3.3.5.2.5 says
    that the model removes at least 50 % of the RMS error); the troposphere model's remainder.
    """
    s = max(math.sin(el), 0.05)
    low = 1.0
    if cn0 == cn0 and cn0 < 45.0:
        # Thermal noise of a code loop: sigma^2 proportional to 10^(-C/N0 / 10) (Groves 9.6.1).
        low = 10.0 ** ((45.0 - max(cn0, 10.0)) / 10.0)
    a = options.code_sigma[system] * factor
    noise = a * a * (0.5 * low + 0.5 / (s * s))
    if cn0 == cn0 and cn0 < 45.0:
        # Reflected and diffracted signals are weak, and late by the size of streets: 2 m at 40 dB-Hz, 10 m at 33,
        # 20 m at 30, 60 m at 25.
        nlos = 10.0 ** ((43.0 - max(cn0, 15.0)) / 10.0)
        noise += nlos * nlos
    iono_sigma = 0.0
    if freq_hz < 1e12:
        # Where no model is applied the whole delay is an error: 5 m at the zenith on L1, mapped.
        iono_sigma = 0.5 * iono if iono > 0.0 else 5.0 / s * (F_L1 / freq_hz) ** 2
    tropo_sigma = 0.3 / (s + 0.1) if options.troposphere != TROPO_NONE else 2.5 / s
    code = noise + sigma_sat * sigma_sat + iono_sigma * iono_sigma + tropo_sigma * tropo_sigma
    b = options.rate_sigma
    rate = b * b * (0.5 * low + 0.5 / (s * s))
    if options.fixed_code_sigma_m > 0.0:
        code = options.fixed_code_sigma_m**2
    if options.fixed_rate_sigma_mps > 0.0:
        rate = options.fixed_rate_sigma_mps**2
    return code, rate


@njit
def _clear(out: RowModel, i: int) -> None:
    """Forget what was modelled for row i at an earlier position; its direction stays."""
    out.geometric[i], out.sagnac[i] = np.nan, np.nan
    out.troposphere[i], out.ionosphere[i] = np.nan, np.nan
    out.v_code[i], out.s_code[i] = np.nan, np.nan
    out.v_rate[i], out.s_rate[i] = np.nan, np.nan
    out.rate_used[i] = 0


@njit
def epoch_corrections(
    options: ModelOptions, t_ns: int, rows: Rows, start: int, end: int,
    px: float, py: float, pz: float, known: bool, out: RowModel,
) -> int:  # fmt: skip
    """Elevation, azimuth, corrections, variances and status of the rows of one epoch, seen from a position.

    Parameters
    ----------
    options : ModelOptions
    t_ns : int
        Epoch, GPST ns.
    rows : Rows
    start, end : int
        Rows of the epoch.
    px, py, pz : float
        Receiver position, ECEF m.
    known : bool
        False while the position is only a first guess: no mask, no atmosphere, equal weights.
    out : RowModel
        Written for the rows of the epoch; rows refused here keep only their direction, the rest is NaN.

    Returns
    -------
    int
        Number of rows that can be used.
    """
    lat, lon, h = geodetic(px, py, pz)
    sl, cl, so, co = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    seconds = t_ns // 1_000_000_000
    tow = float(seconds % 604_800)
    doy = (seconds // 86_400 + 5.0) % 365.25 + 1.0  # 1980-01-06 is day 6; to a day, for the seasonal term
    # Of the place and the day only, not of the satellite: once per epoch (`atmosphere.troposphere` says it in one).
    zhd, zwd = zenith_delays_mops(lat, h, doy)
    mapping = niell_coefficients(lat, doy)
    usable = 0
    for i in range(start, end):
        out.status[i] = rows.status[i]
        if rows.status[i] != ROW_USED:
            continue
        rho, sagnac, ux, uy, uz = range_los(px, py, pz, rows.sat_pos[i, 0], rows.sat_pos[i, 1], rows.sat_pos[i, 2])
        out.geometric[i] = rho
        out.sagnac[i] = sagnac
        if not known:
            out.elevation[i], out.azimuth[i] = np.nan, np.nan
            out.troposphere[i], out.ionosphere[i] = 0.0, 0.0
            out.code_var[i], out.rate_var[i] = 100.0, 1.0
            usable += 1
            continue
        e = -so * ux + co * uy
        n = -sl * co * ux - sl * so * uy + cl * uz
        u = cl * co * ux + cl * so * uy + sl * uz
        el = math.asin(min(max(u, -1.0), 1.0))
        az = math.atan2(e, n)
        if az < 0.0:
            az += 2.0 * math.pi
        out.elevation[i], out.azimuth[i] = el, az
        if el < options.mask_rad:
            out.status[i] = ROW_LOW_ELEVATION
            _clear(out, i)
            continue
        if rows.cn0_dbhz[i] < options.cn0_min_dbhz:
            out.status[i] = ROW_LOW_CN0
            _clear(out, i)
            continue
        # Below the horizon, where a mask may reach, the models stay at what they are there.
        tropo, iono = 0.0, 0.0
        if options.troposphere == TROPO_SEASONAL:
            dry, wet = niell_mapping(mapping, h, el)
            tropo = zhd * dry + zwd * wet
        elif options.troposphere == TROPO_SAASTAMOINEN:
            tropo = saastamoinen(lat, h, el)
        if rows.freq_hz[i] < 1e12:
            iono = ionosphere_delay(options, rows.system[i], rows.freq_hz[i], lat, lon, az, el, tow)
        out.troposphere[i], out.ionosphere[i] = tropo, iono
        out.code_var[i], out.rate_var[i] = variances(
            options, rows.system[i], el, rows.cn0_dbhz[i], rows.sigma_sat_m[i], rows.noise_factor[i],
            iono, rows.freq_hz[i],
        )  # fmt: skip
        usable += 1
    return usable
