"""The vehicle: consistent kinematics, continuity, geometry on the ellipsoid, and segments that cannot be flown."""

from typing import Any

import numpy as np
import pytest

from starwise.constants import NS, WGS84_A, WGS84_E2
from starwise.errors import StarwiseError
from starwise.frames import ecef_from_geodetic, geodetic_from_ecef
from starwise.sim.flight import MARGIN_S
from starwise.sim.scenario import load_scenario, shipped
from starwise.sim.sections import Vehicle
from starwise.sim.trajectory import Trajectory, from_points, from_segments, read_recorded

T0_NS = 1_400_000_000 * NS


def fly(segments: list[dict[str, Any]], duration_s: float, **vehicle: Any) -> Trajectory:
    given = {"start": [48.0, 11.0, 500.0], "segments": segments, **vehicle}
    return from_segments(Vehicle.from_dict(given, prefix="vehicle."), T0_NS, duration_s)


def s(kind: str, **keys: Any) -> dict[str, Any]:
    return {"kind": kind, **keys}


def recorded() -> Trajectory:
    """A drive sampled at 2 Hz with a halt of 20 s, without attitude."""
    t = np.arange(0.0, 120.0, 0.5)
    speed = np.clip(np.abs(t - 50.0) / 5.0 - 2.0, 0.0, 1.0)  # halts from 40 to 60 s
    speed = speed * speed * (3.0 - 2.0 * speed)
    going = np.cumsum(speed) * 0.5
    lat = np.radians(48.0) + 1e-5 * np.sin(going / 15.0)
    llh = np.stack([lat, np.radians(11.0) + 3e-6 * going, 500.0 + 0.1 * going], axis=1)
    return from_points(T0_NS + (t * NS).astype(np.int64), llh)


def flights() -> dict[str, Trajectory]:
    """Every kind of segment, cars and aircraft, the pole, all shipped scenarios."""
    aircraft = {"kind": "aircraft", "speed_mps": 300.0}
    made = {
        "roll_in": fly(
            [
                s("straight", duration_s=20.0),
                s("turn", radius_m=3000.0, angle_deg=-120.0, roll_in_s=3.0),
                s("straight", speed_mps=150.0, duration_s=30.0, smooth=True),
                s("straight"),
            ],
            200.0,
            **aircraft,
        ),
        "climbing_turn": fly(
            [
                s("pitch", pitch_deg=20.0, radius_m=2000.0),
                s("turn", rate_dps=3.0, angle_deg=720.0, roll_in_s=2.0),
                s("pitch", pitch_deg=0.0, radius_m=2000.0),
                s("straight"),
            ],
            300.0,
            kind="aircraft",
            speed_mps=200.0,
        ),
        "waypoints": fly(
            [
                s(
                    "waypoints",
                    points=[[48.1, 11.1], [48.1, 11.3, 2500.0], [48.0, 11.0], [48.0, 11.05]],
                    radius_m=800.0,
                    roll_in_s=2.0,
                )
            ],
            500.0,
            kind="aircraft",
            speed_mps=100.0,
            heading_deg=200.0,
        ),
        "spline": fly(
            [
                s("straight", duration_s=10.0),
                s(
                    "spline",
                    points=[
                        [20.0, 48.02, 11.02, 700.0],
                        [40.0, 48.05, 11.0, 900.0],
                        [70.0, 48.07, 11.05, 800.0],
                    ],
                ),
                s("straight"),
            ],
            120.0,
            kind="aircraft",
            speed_mps=100.0,
            heading_deg=30.0,
        ),
        "over_the_pole": fly([s("straight")], 200.0, start=[89.99, 11.0, 500.0], speed_mps=300.0),
        "recorded": recorded(),
    }
    return made | {name: load_scenario(name).trajectory for name in shipped()}


FLIGHTS = flights()


@pytest.mark.laws
@pytest.mark.parametrize("name", FLIGHTS)
def test_velocity_acceleration_and_angular_rate_are_derivatives(name: str) -> None:
    flown = FLIGHTS[name]
    t = np.random.default_rng(1).uniform(flown.begin_s + 0.1, flown.end_s - 0.1, 3000)
    t = t[np.abs(t[:, None] - flown.knots_s).min(axis=1) > 0.045]
    states = flown.states_s(t)

    def rate(quantity: str, h: float) -> Any:
        f = {k: getattr(flown.states_s(t + k * h), quantity) for k in (-2, -1, 1, 2)}
        return (8.0 * (f[1] - f[-1]) - (f[2] - f[-2])) / (12.0 * h)

    # rounding of a 6.4e6 m coordinate (1e-9 m) over 0.02 s; the formula's own error is far smaller
    np.testing.assert_allclose(rate("pos_e", 0.02), states.vel_e, rtol=0, atol=3e-7)
    # h^4 / 30 times the fifth derivative, greatest where an aircraft rolls: 1e-9; rounding 1e-13 over 5 ms
    np.testing.assert_allclose(rate("vel_e", 0.005), states.acc_e, rtol=0, atol=1e-8)
    spin = np.einsum("nji,njk->nik", states.C_eb, rate("C_eb", 0.005))
    omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
    np.testing.assert_allclose(omega, states.omega_eb_b, rtol=0, atol=2e-8)
    np.testing.assert_allclose(spin + np.swapaxes(spin, 1, 2), 0.0, atol=2e-8)


@pytest.mark.laws
@pytest.mark.parametrize("name", FLIGHTS)
def test_position_and_velocity_are_continuous(name: str) -> None:
    flown = FLIGHTS[name]
    for knot in flown.knots_s[1:-1]:
        before, after = flown.states_s(np.array([knot - 1e-9])), flown.states_s(np.array([knot]))
        # 1 ns of flight, and the rounding of a coordinate
        np.testing.assert_allclose(after.pos_e, before.pos_e + 1e-9 * before.vel_e, rtol=0, atol=3e-9)
        np.testing.assert_allclose(after.vel_e, before.vel_e, rtol=0, atol=1e-6)


@pytest.mark.laws
@pytest.mark.parametrize("name", [name for name in FLIGHTS if name != "recorded"])
def test_nose_points_along_the_path_and_axes_are_orthonormal(name: str) -> None:
    flown = FLIGHTS[name]
    states = flown.states_s(np.linspace(flown.begin_s, flown.end_s, 999))
    C = states.C_eb
    np.testing.assert_allclose(np.einsum("nji,njk->nik", C, C), np.broadcast_to(np.eye(3), C.shape), atol=1e-13)
    np.testing.assert_allclose(np.linalg.det(C), 1.0, atol=1e-13)
    speed = np.linalg.norm(states.vel_e, axis=1)
    np.testing.assert_allclose(states.vel_e, speed[:, None] * C[:, :, 0], atol=1e-11)


def test_times_in_any_order_and_outside() -> None:
    flown = FLIGHTS["roll_in"]
    t = T0_NS + np.array([150, 3, 77, -1, 201]) * NS
    mixed, ordered = flown.states(t), flown.states(np.sort(t))
    np.testing.assert_array_equal(mixed.pos_e[np.argsort(t)], ordered.pos_e)
    with pytest.raises(StarwiseError, match=r"no trajectory at this time; found '202.000 s'; wanted -1 to 201 s"):
        flown.states(T0_NS + 202 * NS)


def test_level_flight_keeps_height_and_speed() -> None:
    flown = fly(
        [s("straight", duration_s=600.0), s("turn", radius_m=3000.0, angle_deg=300.0), s("straight")],
        1800.0,
        speed_mps=300.0,
    )
    states = flown.states_s(np.linspace(0.0, 1800.0, 500))
    np.testing.assert_allclose(states.llh[:, 2], 500.0, atol=1e-7)  # m; formula of geodetic height: 1e-9
    np.testing.assert_allclose(np.linalg.norm(states.vel_e, axis=1), 300.0, atol=1e-10)
    np.testing.assert_allclose(states.vel_ned[:, 2], 0.0, atol=1e-10)


def test_straight_is_a_geodesic() -> None:
    # Clairaut: the distance from the axis times the sine of the azimuth is constant along a geodesic
    flown = fly([s("straight")], 7200.0, start=[20.0, 0.0, 0.0], heading_deg=40.0, speed_mps=300.0)
    states = flown.states_s(np.linspace(0.0, 7200.0, 200))
    axis = np.hypot(states.pos_e[:, 0], states.pos_e[:, 1])
    constant = axis * np.sin(states.euler[:, 2])
    np.testing.assert_allclose(constant, constant[0], atol=1e-5)  # m of 4e6: rounding of an azimuth


@pytest.mark.golden
def test_around_the_world() -> None:
    # WGS 84 meridian: 40 007 862.917 m (Rapp, Geometric Geodesy I); equator: 2 pi a
    for heading, length in ((0.0, 40_007_862.917), (90.0, 2.0 * np.pi * WGS84_A)):
        flown = fly([s("straight")], length / 4000.0, start=[0.0, 0.0, 0.0], heading_deg=heading, speed_mps=4000.0)
        ends = flown.states_s(np.array([0.0, length / 4000.0])).pos_e
        np.testing.assert_allclose(ends[1], ends[0], atol=1e-3)  # m: digits of the published length


def test_turn_has_its_radius() -> None:
    flown = load_scenario("s3ekf-3-turn").trajectory
    t = 60.0 + np.linspace(0.1, 31.3, 50)
    states = flown.states_s(t)
    across = states.acc_e - np.einsum("ni,ni->n", states.acc_e, states.C_eb[:, :, 0])[:, None] * states.C_eb[:, :, 0]
    level = np.linalg.norm(across, axis=1)
    np.testing.assert_allclose(np.hypot(30.0, 300.0**2 / 6.37e6), level, atol=1e-4)  # m/s^2; radius of the Earth
    ends = flown.states_s(60.0 + np.array([0.0, np.pi * 10.0])).pos_e
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(6000.0, abs=0.01)  # m; curvature takes 1.5 mm


def test_aircraft_banks_and_car_does_not() -> None:
    turn = [s("turn", radius_m=3000.0, angle_deg=180.0, roll_in_s=3.0), s("straight")]
    for kind, bank in (("aircraft", np.arctan(30.0 / 9.80665)), ("car", 0.0)):
        states = fly(turn, 100.0, kind=kind, speed_mps=300.0).states_s(np.array([20.0]))
        assert states.euler[0, 0] == pytest.approx(bank, abs=1e-9)  # rad, right wing down in a right turn
    banked = fly(turn, 100.0, kind="aircraft", speed_mps=300.0).states_s(np.linspace(0.0, 40.0, 400))
    assert np.abs(banked.f_ib_b[:, 1]).max() < 0.06  # m/s^2: Coriolis, and gravity that is not 9.80665


def test_climb_and_dive_of_the_paper() -> None:
    flown = load_scenario("s3ekf-4-climb-dive").trajectory
    states = flown.states_s(np.linspace(0.0, 300.0, 3001))
    pitch, height = np.degrees(states.euler[:, 1]), states.llh[:, 2]
    assert pitch.max() == pytest.approx(60.0, abs=1e-9)
    assert pitch.min() == pytest.approx(-60.0, abs=1e-9)
    assert height[0] == pytest.approx(1000.0, abs=1e-6)
    assert height.max() == pytest.approx(10_000.0, abs=1e-6)
    assert height[-1] == pytest.approx(1000.0, abs=1e-6)
    # arcs: v^2 / R across the path, besides following the Earth (0.014 m/s^2)
    turning = np.linalg.norm(states.acc_e, axis=1)
    assert turning.max() == pytest.approx(30.0, abs=0.015)


def test_waypoints_are_met() -> None:
    flown = FLIGHTS["waypoints"]
    for point in ([48.1, 11.1, 500.0], [48.1, 11.3, 2500.0], [48.0, 11.0, 2500.0], [48.0, 11.05, 2500.0]):
        there = ecef_from_geodetic([*np.radians(point[:2]), point[2]])
        gaps = [np.linalg.norm(flown.states_s(np.array([t])).pos_e[0] - there) for t in flown.knots_s]
        assert min(gaps) < 1e-5  # m; solved to 1e-6 in each direction


def test_spline_meets_its_points() -> None:
    states = FLIGHTS["spline"].states_s(np.array([10.0, 30.0, 50.0, 80.0]))
    llh = geodetic_from_ecef(states.pos_e)[1:]
    wanted = [[48.02, 11.02, 700.0], [48.05, 11.0, 900.0], [48.07, 11.05, 800.0]]
    np.testing.assert_allclose(np.degrees(llh[:, :2]), np.array(wanted)[:, :2], atol=1e-12)
    np.testing.assert_allclose(llh[:, 2], np.array(wanted)[:, 2], atol=1e-7)


def test_recorded_flown_again(tmp_path: Any) -> None:
    flown = recorded()
    t = np.arange(0.0, 119.0, 0.5)
    states = flown.states_s(t)
    euler = np.degrees(states.euler[:, ::-1])
    lines = ["t_s,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg"]
    for k, row in enumerate(states.llh):
        lines.append(
            f"{t[k]},{np.degrees(row[0]):.12f},{np.degrees(row[1]):.12f},{row[2]:.6f},"
            + ",".join(f"{a:.9f}" for a in euler[k])
        )
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(lines))
    again = read_recorded(path, T0_NS).states_s(t)
    np.testing.assert_allclose(again.pos_e, states.pos_e, atol=2e-6)  # m; digits of the file
    np.testing.assert_allclose(again.C_eb, states.C_eb, atol=1e-9)
    path.write_text("\n".join([*lines[:5], "1,2,x,4,5,6,7"]))
    with pytest.raises(StarwiseError, match=r"drive.csv:6: not numbers; found '1,2,x,4,5,6,7'"):
        read_recorded(path, T0_NS)
    path.write_text(lines[0].replace("lat_deg", "latitude"))
    with pytest.raises(StarwiseError, match="columns are missing"):
        read_recorded(path, T0_NS)


@pytest.mark.laws
def test_lever_arm_moves_with_the_body() -> None:
    flown, h, arm = FLIGHTS["roll_in"], 0.002, [1.0, -2.0, -0.5]
    t = np.linspace(21.0, 50.0, 40)
    t = t[np.abs(t[:, None] - flown.knots_s).min(axis=1) > 2.0 * h]
    (before, _), (after, _) = (flown.states_s(t + k * h).at_lever_arm(arm) for k in (-1, 1))
    _, vel = flown.states_s(t).at_lever_arm(arm)
    np.testing.assert_allclose((after - before) / (2.0 * h), vel, atol=2e-5)  # m/s; h^2 / 6 times the jerk


def test_quaternion_is_the_rotation() -> None:
    states = FLIGHTS["climbing_turn"].states_s(np.linspace(0.0, 200.0, 50))
    w, v = states.q_eb[:, 0], states.q_eb[:, 1:]
    nose = 2.0 * (v[:, :1] * v + w[:, None] * np.cross(v, [1.0, 0.0, 0.0])) + (2.0 * w[:, None] ** 2 - 1.0) * [
        1.0,
        0.0,
        0.0,
    ]
    np.testing.assert_allclose(nose, states.C_eb[:, :, 0], atol=1e-14)


def test_a_second_is_added_at_both_ends() -> None:
    begin, end = FLIGHTS["roll_in"].t_span_ns
    assert (begin, end) == (T0_NS - round(MARGIN_S * NS), T0_NS + 200 * NS + round(MARGIN_S * NS))


def test_attitude_jumps_are_known() -> None:
    (into, out) = load_scenario("s3ekf-3-turn").trajectory.jumps
    assert (into.t_s, out.t_s) == pytest.approx((60.0, 60.0 + 10.0 * np.pi), abs=1e-6)
    assert into.angle_rad == pytest.approx(np.arctan(30.0 / 9.80665), abs=1e-9)
    assert FLIGHTS["roll_in"].jumps == ()


IMPOSSIBLE = [
    ([s("static")], r"[1]' is at rest but the vehicle moves; found '10 m/s'"),
    (
        [s("straight", acceleration_mps2=-3.0, duration_s=5.0)],
        "[1].acceleration_mps2' brakes below zero speed; found '-5 m/s after 5 s'; wanted at least -2 m/s^2",
    ),
    ([s("straight", duration_s=5.0)], "[1]' is the last, and the scenario is longer; found '5.000 s'"),
    ([s("straight"), s("straight")], "[1]' lasts until the end but is not the last"),
    (
        [s("straight", speed_mps=0.0, acceleration_mps2=1.0), s("turn", radius_m=9.0, angle_deg=9.0)],
        "[2]' needs speed and the vehicle stands still",
    ),
    ([s("straight", duration_s=5.0, distance_m=5.0)], "[1]' is given too much or too little"),
    ([s("straight", speed_mps=10.0, acceleration_mps2=1.0)], "[1]' changes no speed"),
    ([s("turn", angle_deg=9.0)], "[1]' is given both or none of radius_m and rate_dps"),
    ([s("turn", radius_m=50.0, angle_deg=0.0)], "[1].angle_deg' turns by nothing"),
    (
        [s("turn", radius_m=50.0, angle_deg=9.0, roll_in_s=2.0)],
        "[1].roll_in_s' has no time for its roll_in_s; found '2 s'; wanted at most 0.785 s",
    ),
    (
        [s("climb", pitch_deg=60.0, radius_m=3000.0, height_m=2999.0)],
        "[1].height_m' has transition arcs that do not fit; found '2999 m'; wanted at least 3000.0 m",
    ),
    (
        [s("pitch", pitch_deg=5.0, radius_m=9.0), s("climb", pitch_deg=60.0, radius_m=1.0, height_m=99.0)],
        "[2]' starts from level flight; found 'a path pitched by 5.0 deg'",
    ),
    (
        [s("waypoints", points=[[48.0, 11.0001]], radius_m=500.0)],
        "[1].points' waypoint 1 lies inside the turning circle",
    ),
    ([s("waypoints", points=[[48.01, 11.0, 9000.0]], radius_m=50.0)], "[1].points' waypoint 1 is too steep"),
    (
        [s("spline", points=[[60.0, 48.0, 11.00001, 500.0], [90.0, 48.1, 11.0, 500.0]])],
        "[1].points' nearly stands still",
    ),
]


@pytest.mark.parametrize(("segments", "message"), IMPOSSIBLE)
def test_impossible_segments_get_one_line(segments: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(StarwiseError) as caught:
        fly(segments, 80.0, speed_mps=10.0)
    assert str(caught.value).startswith("'vehicle.segments" + message)
    assert "\n" not in str(caught.value)


def test_axis_of_the_ellipsoid() -> None:
    # the meridian quadrant from the pole: straight over the pole is nothing special
    flown = FLIGHTS["over_the_pole"]
    states = flown.states_s(np.linspace(0.0, 200.0, 101))
    assert np.degrees(states.llh[:, 0]).max() > 89.999
    b = WGS84_A * np.sqrt(1.0 - WGS84_E2)
    assert states.pos_e[:, 2].max() == pytest.approx(b + 500.0, abs=1e-2)  # m; nearest sample within 300 m of the pole
