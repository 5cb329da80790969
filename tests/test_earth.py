"""Normal gravity and curvature against published values and the laws of a gravity field."""

import numpy as np
import pytest

from starwise.constants import WGS84_A, WGS84_F
from starwise.frames import C_ne_ned, ecef_from_geodetic
from starwise.physics.earth import GAMMA_E, GAMMA_P, OMEGA_IE, curvature_radii, gravity_e, normal_gravity


@pytest.mark.golden
@pytest.mark.parametrize("lat_deg", [0.0, 20.0, 45.0, 70.0, 90.0])
def test_gravity_on_the_ellipsoid_is_somiglianas(lat_deg: float) -> None:
    lat = np.radians(lat_deg)
    ned = C_ne_ned(lat, 0.7) @ gravity_e(ecef_from_geodetic([lat, 0.7, 0.0]))
    # 1e-10 m/s^2: digits of the published gravity at equator and pole
    np.testing.assert_allclose(ned, [0.0, 0.0, normal_gravity(lat, 0.0)], atol=1e-10)


@pytest.mark.golden
def test_published_values() -> None:
    # NGA.STND.0036 table 3.7
    assert normal_gravity(0.0, 0.0) == pytest.approx(GAMMA_E, abs=1e-12)
    assert normal_gravity(np.pi / 2.0, 0.0) == pytest.approx(GAMMA_P, abs=1e-12)
    R_M, R_N = curvature_radii([0.0, np.pi / 2.0])
    b = WGS84_A * (1.0 - WGS84_F)
    np.testing.assert_allclose(R_M, [b * b / WGS84_A, WGS84_A**2 / b], atol=1e-8)
    np.testing.assert_allclose(R_N, [WGS84_A, WGS84_A**2 / b], atol=1e-8)


@pytest.mark.laws
@pytest.mark.parametrize("height", [-1000.0, 0.0, 20_000.0, 2e7])
def test_field_is_a_potential_of_empty_space(height: float) -> None:
    p, d = ecef_from_geodetic([0.7, 0.3, height]), 100.0
    J = np.array([(gravity_e(p + d * e) - gravity_e(p - d * e)) / (2.0 * d) for e in np.eye(3)])
    # 1/s^2; gradients are 3e-6, rounding of 9.8 m/s^2 over 200 m is 1e-17
    np.testing.assert_allclose(J, J.T, atol=1e-15)
    assert np.trace(J) == pytest.approx(2.0 * OMEGA_IE**2, abs=1e-14)


def test_expansion_in_height_agrees() -> None:
    for height in (100.0, 3000.0, 10_000.0):
        down = (C_ne_ned(0.8, 0.0) @ gravity_e(ecef_from_geodetic([0.8, 0.0, height])))[2]
        assert normal_gravity(0.8, height) == pytest.approx(down, abs=1e-6)  # m/s^2; the expansion's own error


def test_many_positions_at_once_and_the_poles() -> None:
    p = ecef_from_geodetic([[0.1, 0.2, 3.0], [-1.5, 2.0, 4000.0]])
    np.testing.assert_array_equal(gravity_e(p)[1], gravity_e(p[1]))
    b = WGS84_A * (1.0 - WGS84_F)
    np.testing.assert_allclose(gravity_e([0.0, 0.0, -b]), [0.0, 0.0, GAMMA_P], atol=1e-9)
