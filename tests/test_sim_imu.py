"""Inertial sensors: without errors they give the trajectory back; with errors they have the stated statistics."""

import itertools
from typing import Any

import numpy as np
import pytest

from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.physics.earth import OMEGA_IE, STANDARD_GRAVITY, gravity_e
from starwise.sim.imu import DPH, GRADES, UG, errors_of, perfect_imu, simulate_imu
from starwise.sim.scenario import load_scenario
from starwise.sim.sections import Fault, Imu, Vehicle
from starwise.sim.seeds import streams
from starwise.sim.trajectory import Trajectory, from_segments

T0_NS = 1_400_000_000 * NS
OMEGA = np.array([0.0, 0.0, OMEGA_IE])


def flight(*, smooth: bool) -> Trajectory:
    """60 s of an aircraft; smooth: angular rate and specific force are continuous and their kinks fall on whole s."""
    turn = {"kind": "turn", "rate_dps": 5.0, "angle_deg": 65.0, "roll_in_s": 3.0}  # 3 + 10 + 3 s
    brake = {"kind": "straight", "speed_mps": 120.0, "duration_s": 10.0, "smooth": True}
    climb = {"kind": "climb", "pitch_deg": 15.0, "radius_m": 2000.0, "height_m": 600.0}
    ways = [{"kind": "straight", "duration_s": 4.0}, turn, brake, *([] if smooth else [climb]), {"kind": "straight"}]
    given = {
        "kind": "aircraft",
        "start": [-33.0, 151.0, 800.0],
        "heading_deg": 70.0,
        "speed_mps": 200.0,
        "segments": ways,
    }
    return from_segments(Vehicle.from_dict(given), T0_NS, 60.0)


def at_rest(duration_s: float = 3600.0) -> Trajectory:
    given = {"start": [30.0, 110.0, 50.0], "heading_deg": 25.0, "segments": [{"kind": "static"}]}
    return from_segments(Vehicle.from_dict(given), T0_NS, duration_s)


def grid(duration_s: float, rate_hz: float) -> Any:
    return T0_NS + np.rint(np.arange(round(duration_s * rate_hz) + 1) * (NS / rate_hz)).astype(np.int64)


def skew(w: Any) -> Any:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def turned(angle: Any) -> Any:
    """Rotation matrix of a rotation vector (Rodrigues)."""
    size = np.linalg.norm(angle)
    K = skew(angle / size) if size > 0.0 else np.zeros((3, 3))
    return np.eye(3) + np.sin(size) * K + (1.0 - np.cos(size)) * K @ K


@pytest.mark.laws
def test_perfect_rates_integrate_to_the_trajectory() -> None:
    # Runge-Kutta of order 4 on dC/dt, dv/dt, dp/dt in ECEF (Groves 5.25-5.38), steps of 20 ms
    flown, h = flight(smooth=True), 0.02
    read = perfect_imu(flown, grid(60.0, 100.0), increments=False)
    ends = flown.states(T0_NS + np.array([0, 60]) * NS)
    start, end = ends.pos_e[0], ends.pos_e[1]
    C, v, p = ends.C_eb[0].copy(), ends.vel_e[0].copy(), np.zeros(3)

    def rates(C: Any, v: Any, p: Any, k: int) -> tuple[Any, Any, Any]:
        dv = C @ read.accel[k] + gravity_e(start + p) - 2.0 * np.cross(OMEGA, v)
        return C @ skew(read.gyro[k]) - skew(OMEGA) @ C, dv, v

    for k in range(0, 6000, 2):
        a = rates(C, v, p, k)
        b = rates(*(x + 0.5 * h * d for x, d in zip((C, v, p), a, strict=True)), k + 1)  # type: ignore[misc]
        c = rates(*(x + 0.5 * h * d for x, d in zip((C, v, p), b, strict=True)), k + 1)  # type: ignore[misc]
        d = rates(*(x + h * d for x, d in zip((C, v, p), c, strict=True)), k + 2)  # type: ignore[misc]
        C, v, p = (
            x + h / 6.0 * (i + 2.0 * j + 2.0 * m + n) for x, i, j, m, n in zip((C, v, p), a, b, c, d, strict=True)
        )
    np.testing.assert_allclose(C, ends.C_eb[1], atol=1e-9)  # rad
    np.testing.assert_allclose(v, ends.vel_e[1], atol=1e-7)  # m/s: h^4 / 2880 times derivatives while rolling
    np.testing.assert_allclose(p, end - start, atol=3e-6)  # m after 10 km


def mechanised(flown: Trajectory, rate_hz: float) -> float:
    """Error of the position, m, after 60 s of the simplest strapdown integration of increments, in inertial axes."""
    read = perfect_imu(flown, grid(60.0, rate_hz), increments=True)
    ends = flown.states(T0_NS + np.array([0, 60]) * NS)
    C, p = ends.C_eb[0], ends.pos_e[0]
    v = ends.vel_e[0] + np.cross(OMEGA, p)
    for k, dt in enumerate(read.dt_s):
        half = turned(0.5 * read.gyro[k])
        force = C @ half @ read.accel[k]  # velocity increment, from the body axes of mid-interval

        def gravitation(p: Any) -> Any:
            return gravity_e(p) + np.cross(OMEGA, np.cross(OMEGA, p))

        middle = p + 0.5 * dt * v + 0.125 * dt * force
        dv = force + dt * gravitation(middle)
        p = p + dt * (v + 0.5 * dv)
        v = v + dv
        C = C @ half @ half
    earth = turned(-OMEGA * 60.0)
    return float(np.linalg.norm(earth @ p - ends.pos_e[1]))


@pytest.mark.laws
def test_increments_converge_to_the_trajectory_across_jumps_of_acceleration() -> None:
    # pitch rate and acceleration jump within intervals here: exact increments leave an error of order h^2 all the same
    flown = flight(smooth=False)
    coarse, fine = mechanised(flown, 25.0), mechanised(flown, 100.0)
    assert fine < 0.02  # m after 9 km, without coning and sculling terms
    assert coarse / fine == pytest.approx(16.0, rel=0.35)


@pytest.mark.laws
def test_increments_are_integrals_of_the_rates() -> None:
    flown = flight(smooth=False)
    t = grid(60.0, 10.0)
    whole = perfect_imu(flown, t, increments=True)
    knots = flown.knots_s
    x, w = np.polynomial.legendre.leggauss(24)
    for k in [5, 41, 75, 180, 299, 300, 301, 420, 599]:
        a, b = (t[k] - T0_NS) * 1e-9, (t[k + 1] - T0_NS) * 1e-9
        cuts = np.concatenate([[a], knots[(knots > a) & (knots < b)], [b]])
        total = np.zeros(6)
        for lo, hi in itertools.pairwise(cuts):
            states = flown.states_s(0.5 * (lo + hi) + 0.5 * (hi - lo) * x)
            total += 0.5 * (hi - lo) * w @ np.hstack([states.omega_ib_b, states.f_ib_b])
        np.testing.assert_allclose(whole.gyro[k], total[:3], atol=1e-14)
        np.testing.assert_allclose(whole.accel[k], total[3:], atol=2e-12)


@pytest.mark.laws
def test_finer_increments_add_up() -> None:
    flown = flight(smooth=False)
    fine, coarse = (perfect_imu(flown, grid(60.0, rate), increments=True) for rate in (100.0, 10.0))
    np.testing.assert_allclose(fine.gyro.reshape(-1, 10, 3).sum(axis=1), coarse.gyro, atol=1e-14)
    np.testing.assert_allclose(fine.accel.reshape(-1, 10, 3).sum(axis=1), coarse.accel, atol=2e-12)


def test_rates_are_those_of_the_trajectory() -> None:
    flown = flight(smooth=False)
    t = grid(60.0, 100.0)
    read, states = perfect_imu(flown, t, increments=False), flown.states(t)
    np.testing.assert_allclose(read.gyro, states.omega_ib_b, atol=1e-12)
    np.testing.assert_allclose(read.accel, states.f_ib_b, atol=1e-10)


def test_at_rest_gravity_and_the_earths_rotation_are_felt() -> None:
    read = perfect_imu(at_rest(60.0), grid(60.0, 1.0), increments=False)
    lat, heading = np.radians(30.0), np.radians(25.0)
    north = OMEGA_IE * np.cos(lat)
    rate = [north * np.cos(heading), -north * np.sin(heading), -OMEGA_IE * np.sin(lat)]
    np.testing.assert_allclose(read.gyro, np.broadcast_to(rate, read.gyro.shape), atol=1e-15)
    np.testing.assert_allclose(read.accel[:, 2], -9.79309, atol=2e-5)  # m/s^2, Somigliana at 30 deg less 50 m
    np.testing.assert_allclose(read.accel[:, :2], 0.0, atol=1e-6)  # plumb line and normal part by 5e-8 rad


@pytest.mark.laws
@pytest.mark.parametrize("output", ["rates", "increments"])
def test_white_noise_has_its_random_walk(output: Any) -> None:
    section = Imu(grade="perfect", output=output, rate_hz=50.0, gyro_arw_dprh=0.3, accel_vrw_mpsrh=0.05)
    made = simulate_imu(at_rest(), section, T0_NS, T0_NS + 3600 * NS, streams(4))
    dt = made.measured.dt_s[:, None] if output == "rates" else 1.0
    angle = ((made.measured.gyro - made.perfect.gyro) * dt).reshape(-1, 3)[: 3600 * 50]
    speed = ((made.measured.accel - made.perfect.accel) * dt).reshape(-1, 3)[: 3600 * 50]
    for walk, wanted in ((angle, np.radians(0.3) / 60.0), (speed, 0.05 / 60.0)):
        second = walk.reshape(3600, 50, 3).sum(axis=1)
        assert second.std() == pytest.approx(wanted, rel=4.0 / np.sqrt(2.0 * 3 * 3600))  # 4 sigma


@pytest.mark.laws
def test_markov_bias_has_its_sigma_and_time() -> None:
    section = Imu(grade="perfect", rate_hz=1.0, gyro_markov_dph=2.0, gyro_markov_tau_s=20.0)
    sums = []
    for run in range(20):
        made = simulate_imu(at_rest(), section, T0_NS, T0_NS + 3600 * NS, streams(4, run))
        b = made.gyro_bias / (2.0 * DPH)
        sums.append([np.mean(b**2), np.mean(b[20:] * b[:-20])])
        np.testing.assert_allclose(made.measured.gyro - made.perfect.gyro, made.gyro_bias, atol=1e-18)
    variance, later = np.mean(sums, axis=0)
    # 20 runs x 3 axes x 3600 / 20 independent values, at most: 5 % is 4 sigma of a correlated square
    assert variance == pytest.approx(1.0, abs=0.06)
    assert later == pytest.approx(np.exp(-1.0), abs=0.06)


def test_bias_scale_and_misalignment_over_runs() -> None:
    section = Imu(
        grade="perfect", rate_hz=1.0, accel_bias_ug=500.0, accel_scale_ppm=300.0, accel_misalignment_urad=200.0
    )
    made = [simulate_imu(at_rest(10.0), section, T0_NS, T0_NS + 10 * NS, streams(6, run)) for run in range(400)]
    bias = np.array([one.accel_bias[0] for one in made]) / UG
    M = np.array([one.M_accel for one in made]) * 1e6
    beside = M[:, ~np.eye(3, dtype=bool)]
    for values, sigma in ((bias, 500.0), (np.diagonal(M, axis1=1, axis2=2), 300.0), (beside, 200.0)):
        assert values.std() == pytest.approx(sigma, rel=4.0 / np.sqrt(2.0 * values.size))  # 4 sigma
    one = made[0]
    wanted = one.perfect.accel @ (np.eye(3) + one.M_accel).T + one.accel_bias * one.perfect.dt_s[:, None]
    np.testing.assert_allclose(one.measured.accel, wanted, atol=1e-14)


def test_quantised_increments_lose_nothing() -> None:
    section = Imu(grade="perfect", gyro_quantum_rad=1e-5, accel_quantum_mps=1e-3)
    made = simulate_imu(flight(smooth=False), section, T0_NS, T0_NS + 60 * NS, streams(1))
    counts = made.measured.gyro / 1e-5
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    lost = np.cumsum(made.measured.accel - made.perfect.accel, axis=0)
    assert np.abs(lost).max() <= 0.5e-3 + 1e-12
    rates = simulate_imu(
        flight(smooth=False), Imu(**{**section.to_dict(), "output": "rates"}), T0_NS, T0_NS + 60 * NS, streams(1)
    )
    assert np.abs(rates.measured.gyro - rates.perfect.gyro).max() <= 0.5e-3 + 1e-12


@pytest.mark.laws
def test_one_error_source_does_not_change_another() -> None:
    both = simulate_imu(at_rest(60.0), Imu(grade="tactical"), T0_NS, T0_NS + 60 * NS, streams(2))
    less = Imu(grade="tactical", accel_vrw_mpsrh=0.0, gyro_markov_dph=0.0, gyro_quantum_rad=0.0, accel_quantum_mps=0.0)
    without = simulate_imu(at_rest(60.0), less, T0_NS, T0_NS + 60 * NS, streams(2))
    np.testing.assert_array_equal(both.accel_bias, without.accel_bias)
    np.testing.assert_array_equal(both.M_gyro, without.M_gyro)
    same = simulate_imu(at_rest(60.0), Imu(grade="tactical"), T0_NS, T0_NS + 60 * NS, streams(2))
    np.testing.assert_array_equal(both.measured.gyro, same.measured.gyro)
    drawn = [
        np.diag(M) / errors.scale for M, errors in zip((both.M_gyro, both.M_accel), GRADES["tactical"], strict=True)
    ]
    assert (np.abs(drawn[0] - drawn[1]) > 1e-6).all()  # nor do gyroscopes and accelerometers share their draws
    other = simulate_imu(at_rest(60.0), Imu(grade="tactical"), T0_NS, T0_NS + 60 * NS, streams(2, 1))
    assert (other.measured.gyro != both.measured.gyro).any()


def test_grades_are_ordered_and_can_be_overridden() -> None:
    order = ["perfect", "navigation", "tactical", "industrial", "consumer"]
    assert list(GRADES) == order
    walks = [GRADES[grade][0].random_walk for grade in order]
    assert walks == sorted(walks)
    gyro, accel = errors_of(Imu(grade="industrial", gyro_bias_dph=5.0))
    assert gyro.bias == pytest.approx(5.0 * np.pi / 648_000.0)
    assert accel == GRADES["industrial"][1]
    assert GRADES["tactical"][1].bias == pytest.approx(1e-3 * STANDARD_GRAVITY)


def test_faults_of_inertial_sensors() -> None:
    faults = (
        Fault(kind="outage", sensor="gyro", start_s=10.0, duration_s=5.0),
        Fault(kind="step", sensor="accelerometer", axes=("y",), start_s=20.0, duration_s=10.0, size=0.1),
        Fault(kind="ramp", sensor="gyro", axes=("x",), start_s=40.0, size=1e-3),
        Fault(kind="step", observable="code", start_s=0.0, size=100.0),
    )
    section = Imu(grade="perfect", rate_hz=10.0, output="rates")
    made = simulate_imu(at_rest(60.0), section, T0_NS, T0_NS + 60 * NS, streams(1), faults)
    t = (made.measured.t_ns - T0_NS) * 1e-9
    assert not ((t >= 10.0) & (t < 15.0)).any()
    assert len(t) == 601 - 50
    added = made.measured.accel - made.perfect.accel
    np.testing.assert_allclose(added[:, 1], np.where((t >= 20.0) & (t < 30.0), 0.1, 0.0), atol=1e-14)
    np.testing.assert_array_equal(added[:, [0, 2]], 0.0)
    turned_by = made.measured.gyro - made.perfect.gyro
    np.testing.assert_allclose(turned_by[:, 0], 1e-3 * np.clip(t - 40.0, 0.0, None), atol=1e-14)


def test_jump_of_attitude_is_refused() -> None:
    scenario = load_scenario("s3ekf-3-turn")
    with pytest.raises(StarwiseError, match=r"the attitude jumps .*; found '71.9 deg at 60.000 s'; wanted .*roll_in_s"):
        simulate_imu(scenario.trajectory, Imu(), scenario.time.start_ns, scenario.time.end_ns, streams(1))
