"""Mechanisation against analytic solutions and simulated trajectories; error dynamics against differences of it."""

import math
from typing import Any

import numpy as np
import pytest

from starwise.constants import NS
from starwise.estimators.ins_align import quaternion
from starwise.frames import C_ne_ned, ecef_from_geodetic, geodetic_from_ecef
from starwise.kernels.ins_error import difference, dynamics, feed_back, phi_q15, transition
from starwise.kernels.strapdown import advance, dcm, gravity_down, mechanise, radii, rotate_left, rotate_right
from starwise.physics.earth import OMEGA_IE, curvature_radii, gravity_e, normal_gravity
from starwise.sim.imu import perfect_imu
from starwise.sim.sections import Vehicle
from starwise.sim.trajectory import Trajectory, from_segments

T0_NS = 1_400_000_000 * NS


def flight(*, smooth: bool = True) -> Trajectory:
    """60 s of an aircraft with a turn and braking; with jumps of acceleration and pitch rate unless smooth."""
    turn = {"kind": "turn", "rate_dps": 5.0, "angle_deg": 65.0, "roll_in_s": 3.0}
    brake = {"kind": "straight", "speed_mps": 120.0, "duration_s": 10.0, "smooth": True}
    climb = {"kind": "climb", "pitch_deg": 15.0, "radius_m": 2000.0, "height_m": 600.0}
    ways = [{"kind": "straight", "duration_s": 4.0}, turn, brake, *([] if smooth else [climb]), {"kind": "straight"}]
    given = {
        "kind": "aircraft", "start": [-33.0, 151.0, 800.0], "heading_deg": 70.0, "speed_mps": 200.0, "segments": ways,
    }  # fmt: skip
    return from_segments(Vehicle.from_dict(given), T0_NS, 60.0)


def nav_of(states: Any, i: int) -> Any:
    llh = geodetic_from_ecef(states.pos_e[i])
    C = C_ne_ned(llh[0], llh[1])
    return np.concatenate([quaternion(C @ states.C_eb[i]), C @ states.vel_e[i], llh])


def flown(rate_hz: float, *, smooth: bool) -> Any:
    """Error (9,) after the flight: attitude rad, velocity m/s, position m."""
    way = flight(smooth=smooth)
    t = T0_NS + np.rint(np.arange(round(60.0 * rate_hz) + 1) * (NS / rate_hz)).astype(np.int64)
    read = perfect_imu(way, t, increments=True)
    ends = way.states(T0_NS + np.array([0, 60]) * NS)
    nav, out, x = nav_of(ends, 0), np.empty((len(read.dt_s), 10)), np.empty(9)
    mechanise(nav, read.gyro, read.accel, read.dt_s, np.zeros(7), out)
    np.testing.assert_array_equal(out[-1], nav)
    difference(nav, nav_of(ends, 1), x)
    return x


@pytest.mark.laws
def test_a_flight_is_followed_and_errors_fall_with_the_third_power_of_the_step() -> None:
    coarse, fine = flown(12.5, smooth=True), flown(50.0, smooth=True)
    assert np.abs(fine[:3]).max() < 1e-9  # rad
    assert np.abs(fine[6:8]).max() < 2e-4  # m after 10 km
    # order 4 in attitude (256), 3 in velocity and position (64); vertical errors end at the series of gravity, 1e-7
    assert np.linalg.norm(coarse[:3]) / np.linalg.norm(fine[:3]) > 150.0
    assert np.linalg.norm(coarse[3:5]) / np.linalg.norm(fine[3:5]) > 35.0
    assert np.linalg.norm(coarse[6:8]) / np.linalg.norm(fine[6:8]) > 35.0


@pytest.mark.laws
def test_jumps_of_acceleration_leave_millimetres() -> None:
    error = flown(100.0, smooth=False)
    assert np.abs(error[6:]).max() < 5e-4  # m after 10 km: h^2 / 12 times jumps of some m/s^2


def at_rest(lat: float, height: float, dt: float) -> tuple[Any, Any, Any]:
    """State at rest, body axes north-east-down, and the increments that hold it there."""
    nav = np.zeros(10)
    nav[0] = 1.0
    nav[7], nav[9] = lat, height
    rate = OMEGA_IE * np.array([math.cos(lat), 0.0, -math.sin(lat)])
    force = -C_ne_ned(lat, 0.0) @ gravity_e(ecef_from_geodetic([lat, 0.0, height]))
    return nav, rate * dt, force * dt


@pytest.mark.laws
def test_rest_stays_rest() -> None:
    nav, dtheta, dv = at_rest(0.8, 500.0, 0.01)
    n = 6000
    out = np.empty((n, 10))
    mechanise(nav, np.tile(dtheta, (n, 1)), np.tile(dv, (n, 1)), np.full(n, 0.01), np.zeros(7), out)
    assert np.abs(nav[4:7]).max() < 6e-6  # m/s in 60 s: 1e-7 m/s^2 of gravity's series
    assert np.abs(out[:, 0] - 1.0).max() < 1e-10
    assert np.abs(nav[1:4]).max() < 1e-10  # rad / 2: not even a microgon of drift against the turning Earth


@pytest.mark.laws
def test_schuler_oscillation() -> None:
    # An initial velocity error v comes back as v / omega_s sin(omega_s t), turned by Foucault's rate (Groves 5.7.2)
    lat, dt, n, v = 0.5, 1.0, 5064, 0.1
    nav, dtheta, dv = at_rest(lat, 0.0, dt)
    nav[4] = v
    out = np.empty((n, 10))
    mechanise(nav, np.tile(dtheta, (n, 1)), np.tile(dv, (n, 1)), np.full(n, dt), np.zeros(7), out)
    R_M, _ = curvature_radii(lat)
    schuler = math.sqrt(float(normal_gravity(lat, 0.0)) / float(R_M))
    t = dt * np.arange(1, n + 1)
    north = (out[:, 7] - lat) * float(R_M)
    wanted = v / schuler * np.sin(schuler * t) * np.cos(OMEGA_IE * math.sin(lat) * t)
    # m, of an amplitude of 80: the ellipsoid's other radius and the Earth's rotation itself are not in the formula
    assert np.abs(north - wanted).max() < 1.5


@pytest.mark.laws
def test_coning_is_integrated() -> None:
    # rotation vector a (0, cos wt, sin wt): the body's rate about x is a constant that no axis rotates by
    a, w, dt, n = 0.05, 2.0 * math.pi * 2.0, 0.01, 1000

    def C_at(t: float) -> Any:
        q = np.array([1.0, 0.0, 0.0, 0.0])
        C = np.empty((3, 3))
        rotate_right(q, 0.0, a * math.cos(w * t), a * math.sin(w * t))
        dcm(q, C)
        return C

    nodes, weights = np.polynomial.legendre.leggauss(8)
    nav, _, _ = at_rest(0.3, 0.0, dt)
    C = C_at(0.0)
    nav[:4] = quaternion(C)
    last = np.zeros(7)
    earth = OMEGA_IE * np.array([math.cos(0.3), 0.0, -math.sin(0.3)])
    for k in range(n):
        total = np.zeros(3)
        for x, weight in zip(nodes, weights, strict=True):
            t = (k + 0.5 + 0.5 * x) * dt
            W = C_at(t).T @ (C_at(t + 1e-5) - C_at(t - 1e-5)) / 2e-5
            total += 0.5 * dt * weight * (np.array([W[2, 1], W[0, 2], W[1, 0]]) + C_at(t).T @ earth)
        C_mid = C_at((k + 0.5) * dt)
        dv = C_mid.T @ np.array([0.0, 0.0, -gravity_down(math.sin(0.3) ** 2, 0.0)]) * dt
        advance(nav, *total, *dv, dt, last)
    got = np.empty((3, 3))
    dcm(nav, got)
    # rad in 10 s; without the coning term it drifts by a^2 w (w dt)^2 / 12 * 10 s = 4e-4
    assert np.abs(got - C_at(n * dt)).max() < 3e-6


@pytest.mark.laws
def test_an_interval_can_be_split() -> None:
    rate, force = np.array([0.2, -0.5, 1.0]), np.array([3.0, 1.0, -9.0])
    ends = []
    for parts in (np.full(20, 0.01), np.tile([0.003, 0.007], 20)):
        nav, last = at_rest(0.6, 100.0, 0.01)[0], np.zeros(7)
        nav[4:7] = [20.0, -10.0, 1.0]
        # constant rate in the body: increments in proportion
        for dt in parts:
            advance(nav, *(rate * dt), *(force * dt), dt, last)
        ends.append(nav)
    x = np.empty(9)
    difference(ends[0], ends[1], x)
    assert np.abs(x[:3]).max() < 1e-12  # rad
    assert np.abs(x[3:]).max() < 2e-6  # m/s, m: (omega h)^3 f / 24 per step


def test_gravity_and_radii_are_those_of_the_earth_module() -> None:
    for lat in (-1.2, 0.0, 0.7):
        s2 = math.sin(lat) ** 2
        assert gravity_down(s2, 3000.0) == pytest.approx(float(normal_gravity(lat, 3000.0)), abs=1e-14)
        assert radii(s2) == pytest.approx([float(r) for r in curvature_radii(lat)], abs=1e-8)


@pytest.mark.laws
def test_feedback_and_difference_are_inverse() -> None:
    rng = np.random.default_rng(5)
    nav = at_rest(-0.9, 2000.0, 0.01)[0]
    q = rng.normal(size=4)
    nav[:4] = q / np.linalg.norm(q)
    for size in (1e-6, 0.3):
        x = np.zeros(15)
        x[:] = rng.normal(size=15) * size
        wanted, moved, bias, back = x.copy(), nav.copy(), np.zeros(6), np.zeros(9)
        feed_back(x, moved, bias)
        difference(moved, nav, back)
        np.testing.assert_allclose(back, wanted[:9], atol=1e-8 * size + 1e-9)  # rad; m/s; m (1e-16 of the radius)
        np.testing.assert_array_equal(bias, wanted[9:])
        assert not x.any()


def moving() -> Any:
    nav = at_rest(0.8, 3000.0, 0.01)[0]
    rotate_left(nav, 0.3, -0.8, 1.9)
    nav[4:7] = [150.0, -80.0, 12.0]
    return nav


@pytest.mark.laws
def test_error_dynamics_are_the_derivative_of_the_mechanisation() -> None:
    dt, force = 0.05, np.array([1.0, 2.0, -9.0])

    def step(x: Any) -> tuple[Any, Any]:
        nav, bias, whole = moving(), np.zeros(6), x.copy()
        feed_back(whole, nav, bias)
        a, u = -bias[:3] * dt, (force - bias[3:]) * dt
        f_n = advance(nav, *a, *u, dt, np.array([*a, *u, dt]))
        return nav, np.array(f_n) / dt

    base, f_n = step(np.zeros(15))
    middle = moving()
    advance(middle, 0.0, 0.0, 0.0, *(force * dt / 2), dt / 2, np.zeros(7))
    A, M, gain, C = np.empty((9, 9)), np.empty((9, 9)), np.empty((9, 6)), np.empty((3, 3))
    dcm(middle, C)
    dynamics(middle, *f_n, A)
    transition(A, C, dt, M, gain)
    steps = np.array([1e-3] * 3 + [1.0] * 3 + [1000.0] * 3 + [1e-3] * 3 + [0.1] * 3)
    numeric = np.empty((9, 15))
    for j in range(15):
        x, up, down = np.zeros(15), np.empty(9), np.empty(9)
        x[j] = steps[j]
        difference(step(x)[0], base, up)
        difference(step(-x)[0], base, down)
        numeric[:, j] = (up - down) / (2.0 * steps[j])
    # per second; the smallest terms in A are 1e-13, those left out (change of the radii) 1e-7 of a velocity or position
    difference_rate = np.abs(numeric - np.hstack([M, gain])) / dt
    assert difference_rate[:3, :9].max() < 1e-11
    assert difference_rate[3:6, :9].max() < 5e-6  # force turned by the Earth's rotation within the step
    assert difference_rate[6:, :9].max() < 1e-5
    assert difference_rate[:, 9:].max() < 5e-3  # third order: dt^2 f / 6


@pytest.mark.laws
def test_transitions_and_noise_compose() -> None:
    nav, C = moving(), np.empty((3, 3))
    dcm(nav, C)
    gyro, accel = np.array([1e-6, 2e-6, 3e-6]), np.array([1e-4, 2e-4, 3e-4])
    sigma_g, sigma_a = np.full(3, 1e-4), np.full(3, 1e-2)

    def over(dt: float) -> tuple[Any, Any]:
        Phi, Q = np.empty((15, 15)), np.empty((15, 15))
        phi_q15(nav, 1.0, -3.0, -9.0, C, dt, gyro, accel, 300.0, np.inf, sigma_g, sigma_a, Phi, Q)
        return Phi, Q

    (whole, Q), (half, Q_half) = over(0.02), over(0.01)
    np.testing.assert_allclose(half @ half, whole, atol=2e-5)  # third order: 0.02^3 * 9 / 4
    total = half @ Q_half @ half.T + Q_half
    scale = np.sqrt(np.outer(np.diag(total), np.diag(total)))
    np.testing.assert_allclose(total[:6, :6] / scale[:6, :6], Q[:6, :6] / scale[:6, :6], atol=1e-3)
    np.testing.assert_allclose(np.diag(total)[9:], np.diag(Q)[9:], rtol=1e-9)
    assert np.linalg.eigvalsh(Q).min() > -1e-18
