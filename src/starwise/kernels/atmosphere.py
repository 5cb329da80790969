"""Delays of the ionosphere (Klobuchar, GPS and BeiDou form) and the troposphere (Saastamoinen, Niell), m.

Scalar functions for use inside other kernels. All are finite for every finite argument and continuous in
elevation and height: below the horizon they give the value at the lowest elevation the model serves,
and where there is no air (or no sense: a cold start at the Earth's centre) they
fade to zero. NaN in gives NaN out.
"""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.constants import C_LIGHT
from starwise.kernels._jit import njit

F8 = NDArray[np.float64]

_BDS_SHELL = 6378.0 / (6378.0 + 375.0)  # R / (R + h), km: BDS-SIS-ICD-B1I-3.0 5.2.4.7

# Niell (1996) table 3: hydrostatic average a b c, amplitude a b c; table 4: wet a b c; at 15 30 45 60 75 deg.
_NMF = np.array(
    [
        [1.2769934e-3, 1.2683230e-3, 1.2465397e-3, 1.2196049e-3, 1.2045996e-3],
        [2.9153695e-3, 2.9152299e-3, 2.9288445e-3, 2.9022565e-3, 2.9024912e-3],
        [62.610505e-3, 62.837393e-3, 63.721774e-3, 63.824265e-3, 64.258455e-3],
        [0.0, 1.2709626e-5, 2.6523662e-5, 3.4000452e-5, 4.1202191e-5],
        [0.0, 2.1414979e-5, 3.0160779e-5, 7.2562722e-5, 11.723375e-5],
        [0.0, 9.0128400e-5, 4.3497037e-5, 84.795348e-5, 170.37206e-5],
        [5.8021897e-4, 5.6794847e-4, 5.8118019e-4, 5.9727542e-4, 6.1641693e-4],
        [1.4275268e-3, 1.5138625e-3, 1.4572752e-3, 1.5007428e-3, 1.7599082e-3],
        [4.3472961e-2, 4.6729510e-2, 4.3908931e-2, 4.4626982e-2, 5.4736038e-2],
    ]
)
_NMF_HEIGHT = (2.53e-5, 5.49e-3, 1.14e-3)  # Niell (1996) table 3, height correction per km

# RTCA DO-229E table A-2: average, then seasonal variation, of pressure (hPa), temperature (K), water vapour pressure
# (hPa), temperature lapse rate (K/m) and water vapour lapse rate, at 15 30 45 60 75 deg.
_MOPS = np.array(
    [
        [1013.25, 1017.25, 1015.75, 1011.75, 1013.00],
        [299.65, 294.15, 283.15, 272.15, 263.65],
        [26.31, 21.79, 11.66, 6.78, 4.11],
        [6.30e-3, 6.05e-3, 5.58e-3, 5.39e-3, 4.53e-3],
        [2.77, 3.15, 2.57, 1.81, 1.55],
        [0.00, -3.75, -2.25, -1.75, -0.50],
        [0.00, 7.00, 11.00, 15.00, 14.50],
        [0.00, 8.85, 7.24, 5.36, 3.39],
        [0.00e-3, 0.25e-3, 0.32e-3, 0.81e-3, 0.62e-3],
        [0.00, 0.33, 0.46, 0.74, 0.30],
    ]
)

MIN_EL_SAASTAMOINEN = math.radians(2.0)
"""Below this elevation 1 / sin(el) is no mapping function any more (57 at 1 deg; the atmosphere has 27)."""


@njit
def klobuchar(coef: F8, lat: float, lon: float, az: float, el: float, tow_s: float) -> float:
    """Ionospheric delay of GPS L1 (1575.42 MHz), m, by the broadcast model. Others scale by (f1 / f)^2.

    Parameters
    ----------
    coef : (8,) float64
        alpha_0..3 (s, s/semicircle ...) and beta_0..3.
    lat, lon : float
        Geodetic position of the receiver, rad.
    az, el : float
        Direction of the satellite, rad; el < 0 counts as 0.
    tow_s : float
        GPS time of week (or of day), s.

    References
    ----------
    IS-GPS-200N 20.3.3.5.2.5 and figure 20-4.
    """
    E = max(el, 0.0) / math.pi  # semicircles
    psi = 0.0137 / (E + 0.11) - 0.022
    phi_i = lat / math.pi + psi * math.cos(az)
    phi_i = min(max(phi_i, -0.416), 0.416)
    lam_i = lon / math.pi + psi * math.sin(az) / math.cos(phi_i * math.pi)
    phi_m = phi_i + 0.064 * math.cos((lam_i - 1.617) * math.pi)
    t = 43200.0 * lam_i + tow_s
    t %= 86400.0
    F = 1.0 + 16.0 * (0.53 - E) ** 3
    amp: float = coef[0] + phi_m * (coef[1] + phi_m * (coef[2] + phi_m * coef[3]))
    per: float = coef[4] + phi_m * (coef[5] + phi_m * (coef[6] + phi_m * coef[7]))
    amp = max(amp, 0.0)
    per = max(per, 72000.0)
    x = 2.0 * math.pi * (t - 50400.0) / per
    if abs(x) < 1.57:
        T_iono = F * (5e-9 + amp * (1.0 - x * x / 2.0 + x * x * x * x / 24.0))
    else:
        T_iono = F * 5e-9
    return C_LIGHT * T_iono + 0.0 * (lat + lon + az + el + tow_s)


@njit
def klobuchar_bds(coef: F8, lat: float, lon: float, az: float, el: float, tow_bdt_s: float) -> float:
    """Ionospheric delay of BeiDou B1I (1561.098 MHz), m, by the BDS form of the model (8 coefficients).

    Parameters
    ----------
    coef : (8,) float64
        alpha_0..3 (s, s/semicircle ...) and beta_0..3 of D1 or D2.
    lat, lon : float
        Geographic position of the receiver, rad.
    az, el : float
        Direction of the satellite, rad; el < 0 counts as 0.
    tow_bdt_s : float
        Time of week (or of day) in **BDT**, s.

    References
    ----------
    BDS-SIS-ICD-B1I-3.0, 5.2.4.7: R = 6378 km, h = 375 km.
    """
    E = max(el, 0.0)
    sin_zp = _BDS_SHELL * math.cos(E)
    psi = math.pi / 2.0 - E - math.asin(sin_zp)
    sin_phi = math.sin(lat) * math.cos(psi) + math.cos(lat) * math.sin(psi) * math.cos(az)
    phi_m = math.asin(min(max(sin_phi, -1.0), 1.0))
    sin_dl = math.sin(psi) * math.sin(az) / max(math.cos(phi_m), 1e-9)
    lam_m = lon + math.asin(min(max(sin_dl, -1.0), 1.0))
    p = abs(phi_m / math.pi)
    A2: float = coef[0] + p * (coef[1] + p * (coef[2] + p * coef[3]))
    A4: float = coef[4] + p * (coef[5] + p * (coef[6] + p * coef[7]))
    A2 = max(A2, 0.0)
    A4 = min(max(A4, 72000.0), 172800.0)
    t = tow_bdt_s + lam_m * 43200.0 / math.pi
    t %= 86400.0
    I_z = 5e-9
    if abs(t - 50400.0) < A4 / 4.0:
        I_z += A2 * math.cos(2.0 * math.pi * (t - 50400.0) / A4)
    return C_LIGHT * I_z / math.sqrt(1.0 - sin_zp * sin_zp) + 0.0 * (lat + lon + az + el + tow_bdt_s)


@njit
def zenith_delays(lat: float, h: float, humidity: float) -> tuple[float, float]:
    """Hydrostatic and wet zenith delay, m, of Saastamoinen's model in the standard atmosphere.

    Sea level 1013.25 hPa and 15 deg C, lapse 6.5 K/km, isothermal and drying out above 11 km; pressure
    reaches zero at 44.3 km. From -1 km downwards both fade, to zero at -2 km.

    Parameters
    ----------
    lat : float
        Geodetic latitude, rad.
    h : float
        Height, m (ellipsoidal will do: 50 m of geoid are 0.6 % of the hydrostatic delay, 14 mm at zenith).
    humidity : float
        Relative humidity, 0..1.

    References
    ----------
    J. Saastamoinen (1972); Groves (2013) section 9.3.2; Hofmann-Wellenhof et al. (2008) section 5.3.
    """
    depth = min(max((h + 2000.0) / 1000.0, 0.0), 1.0)
    h = max(h, -1000.0)
    pres = 1013.25 * max(1.0 - 2.2557e-5 * h, 0.0) ** 5.2568
    temp = 273.16 + 15.0 - 6.5e-3 * min(h, 11000.0)
    e = 6.108 * humidity * math.exp((17.15 * temp - 4684.0) / (temp - 38.45))
    if h > 11000.0:
        e *= pres / (1013.25 * (1.0 - 2.2557e-5 * 11000.0) ** 5.2568)
    zhd = 0.0022768 * pres / (1.0 - 0.00266 * math.cos(2.0 * lat) - 0.00028 * min(h, 1e5) / 1e3)
    zwd = 0.002277 * (1255.0 / temp + 0.05) * e
    return zhd * depth + 0.0 * h, zwd * depth + 0.0 * (lat + h)


@njit
def saastamoinen(lat: float, h: float, el: float, humidity: float = 0.7) -> float:
    """Tropospheric slant delay, m: Saastamoinen's zenith delays divided by sin(el). Fit for el > 5 deg.

    Parameters
    ----------
    lat, h : float
        Geodetic latitude, rad, and height, m, of the receiver.
    el : float
        Elevation, rad; below 2 deg the value at 2 deg is returned.
    humidity : float
        Relative humidity, 0..1.
    """
    zhd, zwd = zenith_delays(lat, h, humidity)
    return (zhd + zwd) / math.sin(max(el, MIN_EL_SAASTAMOINEN)) + 0.0 * el


@njit
def _marini(sin_el: float, a: float, b: float, c: float) -> float:
    """Marini's continued fraction, 1 at the zenith. Niell (1996) eq. 4."""
    top = 1.0 + a / (1.0 + b / (1.0 + c))
    return top / (sin_el + a / (sin_el + b / (sin_el + c)))


@njit
def niell_coefficients(lat: float, doy: float) -> tuple[float, float, float, float, float, float]:
    """Coefficients a b c, hydrostatic then wet, of Niell's functions for a latitude (rad) and a day of year."""
    phase = (doy - 28.0) / 365.25 + (0.5 if lat < 0.0 else 0.0)
    season = math.cos(2.0 * math.pi * phase)
    x = min(max(abs(lat) * (180.0 / math.pi) / 15.0 - 1.0, 0.0), 4.0)
    i = min(int(x), 3) if x == x else 0
    w = x - i
    nan = 0.0 * lat
    ah = (1.0 - w) * (_NMF[0, i] - season * _NMF[3, i]) + w * (_NMF[0, i + 1] - season * _NMF[3, i + 1])
    bh = (1.0 - w) * (_NMF[1, i] - season * _NMF[4, i]) + w * (_NMF[1, i + 1] - season * _NMF[4, i + 1])
    ch = (1.0 - w) * (_NMF[2, i] - season * _NMF[5, i]) + w * (_NMF[2, i + 1] - season * _NMF[5, i + 1])
    aw = (1.0 - w) * _NMF[6, i] + w * _NMF[6, i + 1]
    bw = (1.0 - w) * _NMF[7, i] + w * _NMF[7, i + 1]
    cw = (1.0 - w) * _NMF[8, i] + w * _NMF[8, i + 1]
    return ah + nan, bh, ch, aw + nan, bw, cw


@njit
def niell_mapping(
    coefficients: tuple[float, float, float, float, float, float], h: float, el: float
) -> tuple[float, float]:
    """Hydrostatic and wet mapping function out of `niell_coefficients` at a height (m) and elevation (rad)."""
    ah, bh, ch, aw, bw, cw = coefficients
    sin_el = math.sin(max(el, 0.0)) + 0.0 * el
    # Height correction (eq. 6): for real heights; below 1 deg that of 1 deg, for both terms grow without bounds.
    km = min(max(h, -1000.0), 44300.0) / 1000.0 + 0.0 * h
    s = max(sin_el, 0.0175)
    dm = 1.0 / s - _marini(s, _NMF_HEIGHT[0], _NMF_HEIGHT[1], _NMF_HEIGHT[2])
    return _marini(sin_el, ah, bh, ch) + dm * km, _marini(sin_el, aw, bw, cw)


@njit
def niell(lat: float, h: float, el: float, doy: float) -> tuple[float, float]:
    """Hydrostatic and wet mapping function (slant / zenith) of Niell's model. Fit for el > 3 deg.

    Parameters
    ----------
    lat, h : float
        Geodetic latitude, rad, and height, m, of the receiver.
    el : float
        Elevation, rad; el < 0 counts as 0.
    doy : float
        Day of year (1 January 0 h = 1.0, fraction welcome).

    References
    ----------
    A. E. Niell, "Global mapping functions for the atmosphere delay at radio wavelengths", JGR 101 B2 (1996),
    eq. 4-6, tables 3 and 4.
    """
    return niell_mapping(niell_coefficients(lat, doy), h, el)


@njit
def zenith_delays_mops(lat: float, h: float, doy: float) -> tuple[float, float]:
    """Hydrostatic and wet zenith delay, m, from the mean weather of latitude and season.

    The standard atmosphere of `zenith_delays` is that of a mild day at mid-latitudes everywhere: too wet by
    0.1 m of zenith delay in an Arctic winter, too dry by as much in the tropics. Heights as in `zenith_delays`.

    Parameters
    ----------
    lat, h : float
        Geodetic latitude, rad, and height, m.
    doy : float
        Day of year.

    References
    ----------
    RTCA DO-229E A.4.2.4 (the model of UNB3: Collins and Langley 1997), 5 cm rms at the zenith.
    """
    a = abs(math.degrees(lat))
    position = min(max((a - 15.0) / 15.0, 0.0), 4.0)
    k = min(int(position), 3) if position == position else 0
    w = position - k
    day_min = 28.0 if lat >= 0.0 else 211.0
    season = math.cos(2.0 * math.pi * (doy - day_min) / 365.25)
    met = np.empty(5)
    for i in range(5):
        mean = _MOPS[i, k] + w * (_MOPS[i, k + 1] - _MOPS[i, k])
        amplitude = _MOPS[5 + i, k] + w * (_MOPS[5 + i, k + 1] - _MOPS[5 + i, k])
        met[i] = mean - amplitude * season
    P, T, e, beta, lam = met[0], met[1], met[2], met[3], met[4]
    g, gm, Rd, k1, k2 = 9.80665, 9.784, 287.054, 77.604, 382000.0
    below = min(max((h + 2000.0) / 1000.0, 0.0), 1.0) if h == h else h  # no air in the Earth
    base = max(1.0 - beta * max(h, -1000.0) / T, 0.0) if h == h else h
    zhd = 1e-6 * k1 * Rd * P / gm * base ** (g / (Rd * beta))
    zwd = 1e-6 * k2 * Rd / (gm * (lam + 1.0) - beta * Rd) * e / T * base ** ((lam + 1.0) * g / (Rd * beta) - 1.0)
    return zhd * below, zwd * below


@njit
def troposphere(lat: float, h: float, el: float, doy: float) -> tuple[float, float]:
    """Hydrostatic and wet slant delay, m: zenith delays of the season mapped by Niell's functions.

    Parameters as in `zenith_delays_mops` and `niell`.
    """
    zhd, zwd = zenith_delays_mops(lat, h, doy)
    mh, mw = niell(lat, h, el, doy)
    return zhd * mh, zwd * mw
