"""Ionosphere and troposphere against published numbers, an independent implementation and plain sense."""

import math

import numpy as np
import pytest

from starwise.kernels.atmosphere import (
    klobuchar,
    klobuchar_bds,
    niell,
    saastamoinen,
    troposphere,
    zenith_delays,
    zenith_delays_mops,
)

ALPHA_BETA = np.array([0.382e-7, 0.149e-7, -0.179e-6, 0.0, 0.143e6, 0.0, -0.328e6, 0.113e6])
QUIET = np.array([1.1e-8, 2.2e-8, -6e-8, -1.2e-7, 9.0e4, 1.3e5, -6.5e4, -3.9e5])
DEG = math.pi / 180


@pytest.mark.golden
def test_klobuchar_published_example():
    # The example that circulates with MATLAB Central implementations of the model: 40 N 260 E, azimuth 210,
    # elevation 20 deg, 593100 s of the week: 23.784 m.
    alpha_beta = np.array([3.82e-8, 1.49e-8, -1.79e-7, 0.0, 1.43e5, 0.0, -3.28e5, 1.13e5])
    delay = klobuchar(alpha_beta, 40 * DEG, 260 * DEG, 210 * DEG, 20 * DEG, 593100.0)
    assert delay == pytest.approx(23.784, abs=0.001)  # m: printed to 1 mm


@pytest.mark.golden
def test_klobuchar_equals_rtklib():
    oracle = pytest.importorskip("rtklib_oracle")
    rtk, array = oracle.rtk, oracle.array
    rng = np.random.default_rng(1)
    for _ in range(300):
        lat, lon = rng.uniform(-math.pi / 2, math.pi / 2), rng.uniform(-math.pi, math.pi)
        az, el, tow = rng.uniform(0, 2 * math.pi), rng.uniform(0.01, math.pi / 2), rng.uniform(0, 604800)
        want = rtk.ionmodel(rtk.gpst2time(2000, tow), array(ALPHA_BETA), array([lat, lon, 100.0]), array([az, el]))
        # 1 um: the same formula, other order of operations
        assert klobuchar(ALPHA_BETA, lat, lon, az, el, tow) == pytest.approx(want, abs=1e-6)


def _klobuchar_bds_by_book(c, lat, lon, az, el, t):
    """Twin: BDS-SIS-ICD-B1I-3.0 5.2.4.7 with vectors instead of spherical formulas for the pierce point."""
    up = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
    east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    north = np.cross(up, east)
    look = math.cos(el) * (math.sin(az) * east + math.cos(az) * north) + math.sin(el) * up
    p = 6378.0 * up
    b = p @ look
    m = p + look * (-b + math.sqrt(b * b - p @ p + 6753.0**2))
    phi, lam = math.asin(m[2] / 6753.0), math.atan2(m[1], m[0])
    x = abs(phi / math.pi) ** np.arange(4)
    a2, a4 = max(c[:4] @ x, 0), min(max(c[4:] @ x, 72000), 172800)
    t = (t + lam * 43200 / math.pi) % 86400
    z = 5e-9 + (a2 * math.cos(2 * math.pi * (t - 50400) / a4) if abs(t - 50400) < a4 / 4 else 0)
    return 299792458.0 * z / (m @ look / 6753.0)


def test_klobuchar_bds_equals_twin():
    rng = np.random.default_rng(2)
    for _ in range(300):
        lat, lon = rng.uniform(-1.5, 1.5), rng.uniform(-math.pi, math.pi)
        az, el, tow = rng.uniform(0, 2 * math.pi), rng.uniform(0.0, 1.57), rng.uniform(0, 604800)
        if abs(lat) > 1.2 and el < 0.5:
            continue  # over the pole the ICD's arcsine takes the short way; a vector does not
        got = klobuchar_bds(QUIET, lat, lon, az, el, tow)
        assert got == pytest.approx(_klobuchar_bds_by_book(QUIET, lat, lon, az, el, tow), abs=1e-6)  # 1 um


@pytest.mark.golden
def test_saastamoinen_equals_rtklib():
    oracle = pytest.importorskip("rtklib_oracle")
    rtk, array = oracle.rtk, oracle.array
    when = rtk.gpst2time(2000, 0.0)
    for lat in (-60, 0, 45, 80):
        for h in (0.0, 100.0, 2500.0, 9000.0):
            for el in (5, 15, 45, 90):
                for humidity in (0.0, 0.7):
                    want = rtk.tropmodel(when, array([lat * DEG, 0.0, h]), array([0.0, el * DEG]), humidity)
                    # 1 um: the same formula
                    assert saastamoinen(lat * DEG, h, el * DEG, humidity) == pytest.approx(want, abs=1e-6)


@pytest.mark.golden
def test_niell_equals_rtklib():
    oracle = pytest.importorskip("rtklib_oracle")
    rtk, array = oracle.rtk, oracle.array
    for lat in (-50, 0, 20, 45, 80):
        for doy in (28, 120, 300):
            for el in (3, 10, 60):
                for h in (0.0, 1500.0):
                    wet = rtk.Arr1Ddouble(1)
                    when = rtk.timeadd(rtk.epoch2time(array([2023, 1, 1, 0, 0, 0])), (doy - 1) * 86400.0)
                    dry = rtk.tropmapf(when, array([lat * DEG, 0.1, h]), array([0.0, el * DEG]), wet)
                    got = niell(lat * DEG, h, el * DEG, float(doy))
                    # RTKLIB takes the geoid's height (up to 100 m): 4e-5 per km and up to 15 at 3 deg
                    assert got[0] == pytest.approx(dry, abs=2e-3)
                    assert got[1] == pytest.approx(wet[0], abs=1e-9)


def test_zenith_total_is_plausible():
    zhd, zwd = zenith_delays(45 * DEG, 0.0, 0.7)
    assert 2.29 < zhd < 2.32  # m: 1013 hPa (Davis et al. 1985 have 2.307 m)
    assert 0.08 < zwd < 0.16  # m: 12 hPa of vapour
    seasonal = zenith_delays_mops(45 * DEG, 0.0, 100.0)
    assert sum(troposphere(45 * DEG, 0.0, math.pi / 2, 100.0)) == pytest.approx(sum(seasonal), abs=1e-12)
    assert seasonal[0] == pytest.approx(zhd, abs=0.03)  # m: the mean pressures differ by a few hPa


@pytest.mark.golden
@pytest.mark.parametrize(
    ("lat_deg", "doy", "zhd", "zwd"),
    [
        # Worked outside the package from table A-2 and the formulas of DO-229E A.4.2.4 at sea level.
        (15.0, 28.0, 2.3070, 0.2745),
        (45.0, 28.0, 2.3178, 0.0616),
        (75.0, 211.0, 2.3053, 0.1120),
    ],
)
def test_seasonal_zenith_delays(lat_deg, doy, zhd, zwd):
    got = zenith_delays_mops(lat_deg * DEG, 0.0, doy)
    assert got[0] == pytest.approx(zhd, abs=5e-4)
    assert got[1] == pytest.approx(zwd, abs=5e-4)
    # The southern winter is half a year later.
    assert zenith_delays_mops(-lat_deg * DEG, 0.0, 211.0) == pytest.approx(
        zenith_delays_mops(lat_deg * DEG, 0.0, 28.0), abs=1e-4
    )


@pytest.mark.laws
def test_finite_and_continuous_everywhere():
    """No elevation, height or place makes a jump above 1 % of the largest delay, or an infinity."""
    heights = np.concatenate([[-6378137.0], np.linspace(-3000.0, 60000.0, 6301), [2e7]])
    for el in (-1.0, 0.0, 0.1, 1.0):
        total = np.array([saastamoinen(0.8, h, el) for h in heights])
        mapped = np.array([sum(troposphere(0.8, h, el, 10.0)) for h in heights])
        for values in (total, mapped):
            assert np.isfinite(values).all()
            assert np.abs(np.diff(values)).max() < 0.02 * values.max()  # 10 m of height
        assert total[0] == total[-1] == 0.0
    els = np.linspace(-math.pi / 2, math.pi / 2, 20001)
    for f in (
        lambda e: saastamoinen(0.8, 0.0, e),
        lambda e: sum(troposphere(0.8, 0.0, e, 10.0)),
        lambda e: klobuchar(ALPHA_BETA, 0.8, 0.1, 1.0, e, 50400.0),
        lambda e: klobuchar_bds(QUIET, 0.8, 0.1, 1.0, e, 50400.0),
    ):
        values = np.array([f(e) for e in els])
        assert np.isfinite(values).all()
        assert np.abs(np.diff(values)).max() < 0.01 * values.max()


@pytest.mark.laws
def test_nan_stays_nan():
    nan = float("nan")
    for arg in range(5):
        a = [0.8, 0.1, 1.0, 0.5, 50400.0]
        a[arg] = nan
        assert math.isnan(klobuchar(ALPHA_BETA, *a))
        assert math.isnan(klobuchar_bds(QUIET, *a))
    for arg in range(3):
        b = [0.8, 100.0, 0.5]
        b[arg] = nan
        assert math.isnan(saastamoinen(*b))
        assert math.isnan(sum(troposphere(*b, 100.0)))
