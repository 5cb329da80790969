"""Active positioning: what goes round comes back, and the covariance is what the scatter is."""

import numpy as np
import pytest

from starwise.errors import StarwiseError
from starwise.frames import C_ne_enu, ecef_from_geodetic, geodetic_from_ecef
from starwise.physics.earth import GM, OMEGA_IE
from starwise.physics.rdss import (
    GEO_RADIUS_M,
    RdssNoise,
    RdssProtocol,
    geostationary,
    latency_ns,
    rdss_fixes,
    rdss_geometry,
    round_trips,
    solve_rdss,
)


def users(n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(1)
    lat, lon = np.radians(rng.uniform(5.0, 55.0, n)), np.radians(rng.uniform(70.0, 145.0, n))
    return ecef_from_geodetic(np.column_stack([lat, lon, rng.uniform(-50.0, 12_000.0, n)]))


@pytest.mark.golden
def test_radius_of_the_geostationary_orbit() -> None:
    assert pytest.approx((GM / OMEGA_IE**2) ** (1.0 / 3.0), abs=10.0) == GEO_RADIUS_M  # m: rounded constant


@pytest.mark.laws
@pytest.mark.parametrize("south", [False, True])
def test_a_position_comes_back_from_its_round_trips(south: bool) -> None:
    sats, pos = geostationary(), users() * ([1.0, 1.0, -1.0] if south else [1.0, 1.0, 1.0])
    llh = geodetic_from_ecef(pos)
    found = solve_rdss(round_trips(pos, sats), llh[:, 2], sats, (-30.0 if south else 30.0, 110.0))
    np.testing.assert_allclose(found, pos, rtol=0, atol=1e-5)  # m: the last step of the iteration is below 1e-6 m


def test_where_there_is_no_fix_there_is_none() -> None:
    sats = geostationary()
    pos = ecef_from_geodetic(np.radians([[30.0, 110.0, 0.0]]))
    trips = round_trips(pos, sats)
    assert np.isnan(solve_rdss(trips * 2.0, np.zeros(1), sats, (30.0, 110.0))).all()
    assert np.isnan(solve_rdss(trips * 0.5, np.zeros(1), sats, (30.0, 110.0))).all()
    assert np.isnan(solve_rdss(trips * np.nan, np.zeros(1), sats, (30.0, 110.0))).all()
    equator = ecef_from_geodetic(np.radians([[0.0005, 110.0, 0.0]]))
    assert np.isnan(solve_rdss(round_trips(equator, sats), np.zeros(1), sats, (30.0, 110.0))).all()
    with pytest.raises(StarwiseError, match="north or south"):
        solve_rdss(trips, np.zeros(1), sats, (0.0, 110.0))
    with pytest.raises(StarwiseError, match="no position from these satellites"):
        rdss_geometry(ecef_from_geodetic(np.radians([0.0, 110.0, 0.0])), sats)


@pytest.mark.laws
def test_scatter_is_what_the_geometry_says() -> None:
    sats = geostationary()
    pos = ecef_from_geodetic([np.radians(40.0), np.radians(116.0), 100.0])
    n = 4000
    fixes = rdss_fixes(np.tile(pos, (n, 1)), np.arange(n), np.arange(n), np.random.default_rng(2))
    geometry = rdss_geometry(pos, sats)
    C = C_ne_enu(np.radians(40.0), np.radians(116.0))
    enu = (fixes.pos_e - pos) @ C.T
    np.testing.assert_allclose(enu.T @ enu / n, geometry.cov_enu, rtol=0, atol=0.12 * 400.0)  # m^2: 5 sigma of 4000
    np.testing.assert_allclose(C @ fixes.cov_pos[0] @ C.T, geometry.cov_enu, rtol=0, atol=1e-9)
    assert np.abs(enu.mean(axis=0)).max() < 5.0 * 20.0 / n**0.5  # m


@pytest.mark.golden
def test_position_errors_of_the_paper() -> None:
    # "about 30 m" out of 8 m, 13 m and 10 m; Beijing
    s = rdss_geometry(ecef_from_geodetic([np.radians(40.0), np.radians(116.0), 0.0]), geostationary()).sigmas
    assert 25.0 < np.hypot(s["ew"], s["ns"]) < 32.0
    assert s["ns"] ** 2 == pytest.approx(s["ns_distance"] ** 2 + s["ns_height"] ** 2)
    assert s["ew"] ** 2 == pytest.approx(s["ew_distance"] ** 2 + s["ew_height"] ** 2)
    south = rdss_geometry(ecef_from_geodetic([np.radians(20.0), np.radians(116.0), 0.0]), geostationary()).sigmas
    assert south["ns"] > 1.7 * s["ns"]  # north-south is lost towards the equator
    quiet = rdss_geometry(users()[0], geostationary(), RdssNoise(0.0, 0.0, 10.0))
    assert np.abs(quiet.from_distance).max() == 0.0


@pytest.mark.laws
def test_answers_follow_requests_and_requests_answers() -> None:
    asked, answered = RdssProtocol().schedule(1560.0)
    np.testing.assert_allclose(answered - asked, 1.5, atol=1e-9)
    np.testing.assert_array_equal(asked[1:], answered[:-1])
    assert asked[0] == 1.5  # after the pre-request
    assert answered[-1] <= 1560.0
    asked, answered = RdssProtocol(latency_s=0.6, jitter_s=0.3).schedule(100.0, np.random.default_rng(3))
    assert (answered - asked).min() >= 0.5
    assert latency_ns(asked, 10)[0] == 600_000_010
    with pytest.raises(StarwiseError, match="shorter than light takes"):
        RdssProtocol(latency_s=0.3).schedule(10.0)
    with pytest.raises(StarwiseError, match="needs random numbers"):
        RdssProtocol(jitter_s=0.3).schedule(10.0)
