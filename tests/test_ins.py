"""The inertial filter on simulated drives: honest errors, gaps, smoothing, bad inputs; and on a real car."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from starwise.config_inertial import InertialConfig
from starwise.constants import EPOCH_COASTED, EPOCH_OK, NS
from starwise.errors import StarwiseError
from starwise.estimators.ins import Scalars, loose
from starwise.estimators.ins_align import level, quaternion, rotation
from starwise.estimators.ins_check import velocity_lag
from starwise.frames import geodetic_from_ecef, rotations_ne_enu
from starwise.sim.imu import simulate_imu
from starwise.sim.sections import Imu, Vehicle
from starwise.sim.seeds import streams
from starwise.sim.trajectory import Trajectory, from_segments
from starwise.types import Fixes, Inertial

T0_NS = 1_400_000_000 * NS
ARM = np.array([0.5, 0.2, -1.0])
CONFIG: dict[str, Any] = {
    "lever_arm_m": ARM.tolist(),
    "gyro": {"white_dprh": 0.3, "bias_dph": 360.0, "in_run_dph": 6.0, "scale_ppm": 1000.0, "vibration": 0.0},
    "accel": {"white_mpsrh": 0.05, "bias_ug": 1000.0, "in_run_ug": 20.0, "scale_ppm": 1000.0, "vibration": 0.0},
}


@cache
def drive() -> Trajectory:
    """120 s of a car: rest, then blocks with turns to either side."""
    block = {"kind": "straight", "distance_m": 60.0}
    turn = {"kind": "turn", "radius_m": 15.0, "angle_deg": 90.0, "roll_in_s": 1.0}
    back = {**turn, "angle_deg": -90.0}
    start = {"kind": "straight", "speed_mps": 9.0, "duration_s": 8.0, "smooth": True}
    ways = [{"kind": "static", "duration_s": 8.0}, start, *[block, turn, block, back] * 3, {"kind": "straight"}]
    given = {"start": [48.1, 11.5, 560.0], "heading_deg": 40.0, "segments": ways}
    return from_segments(Vehicle.from_dict(given), T0_NS, 120.0)


@cache
def readings(seed: int = 1) -> Inertial:
    section = Imu.from_dict({"grade": "industrial", "rate_hz": 50.0})
    return simulate_imu(drive(), section, T0_NS, T0_NS + 120 * NS, streams(seed)).measured


def at(t_ns: Any) -> tuple[Any, Any, Any]:
    """Antenna position and velocity, ECEF, and rotations C_eb at times."""
    states = drive().states(np.asarray(t_ns))
    pos, vel = states.at_lever_arm(tuple(ARM))
    return pos, vel, states.C_eb


def fixes(seed: int = 1, sigma: float = 0.3, sigma_v: float = 0.05, every_s: float = 0.5) -> Fixes:
    rng = np.random.default_rng(seed)
    t = T0_NS + np.arange(int(0.25 * NS), 119 * NS, int(every_s * NS))
    pos, vel, _ = at(t)
    n = len(t)
    return Fixes(
        t, t, pos + sigma * rng.normal(size=(n, 3)), np.tile(sigma**2 * np.eye(3), (n, 1, 1)),
        vel + sigma_v * rng.normal(size=(n, 3)), np.tile(sigma_v**2 * np.eye(3), (n, 1, 1)),
    )  # fmt: skip


def part(given: Fixes, keep: Any) -> Fixes:
    assert given.vel_e is not None
    assert given.cov_vel is not None
    return Fixes(
        given.t_ns[keep], given.available_ns[keep], given.pos_e[keep], given.cov_pos[keep], given.vel_e[keep],
        given.cov_vel[keep],
    )  # fmt: skip


def config(**changes: Any) -> InertialConfig:
    return InertialConfig.from_dict(CONFIG).with_options(changes)


def errors(run: Any) -> tuple[Any, Any]:
    """Position errors (n, 3), north, east, down, m, and yaw errors, deg."""
    pos, _, C_eb = at(run.solution.t_ns)
    llh = geodetic_from_ecef(pos)
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])[:, None]
    C_nb = C @ C_eb
    yaw = np.degrees(np.arctan2(C_nb[:, 1, 0], C_nb[:, 0, 0]))
    return (C @ (run.solution.pos_e - pos)[:, :, None])[:, :, 0], (
        run.solution.extra["yaw_deg"] - yaw + 180
    ) % 360 - 180


@pytest.mark.laws
def test_covariance_holds_the_truth() -> None:
    nees, yaw_nees = [], []
    for seed in range(6):
        run = loose(fixes(seed), readings(seed), config())
        e, yaw = errors(run)
        late = run.solution.t_ns > T0_NS + 40 * NS
        nees.append(np.einsum("ki,kij,kj->k", e, np.linalg.inv(run.pos_cov), e)[late].mean() / 3.0)
        yaw_nees.append((yaw[late] / run.solution.extra["sigma_yaw_deg"][late]).std())
        assert 0.8 < run.solution.provenance["nis_per_dof"] < 1.2
    # correlated over time: some 20 independent epochs a run, 6 runs: 1 +- 0.08 (1 sigma); misalignment is not modelled
    assert 0.7 < np.mean(nees) < 1.4
    assert np.mean(yaw_nees) < 1.6


def test_gap_is_coasted_and_smoothed() -> None:
    given = fixes()
    t = (given.t_ns - T0_NS) * 1e-9
    gap = (t > 70.0) & (t < 85.0)
    worst = {}
    for name, changes in {
        "free": {},
        "smoothed": {"smooth": True},
        "constraint": {"vehicle.constraint": True, "vehicle.mount_sigma_deg": 2.0},
    }.items():
        run = loose(part(given, ~gap), readings(), config(**changes), epochs_ns=given.t_ns[gap])
        e, _ = errors(run)
        inside = np.isin(run.solution.t_ns, given.t_ns[gap])
        assert (run.solution.status[inside] == EPOCH_COASTED).all()
        assert (run.solution.status[~inside][1:] == EPOCH_OK).all()
        worst[name] = np.hypot(e[inside, 0], e[inside, 1]).max()
        sigma = np.sqrt(np.trace(run.pos_cov[inside][:, :2, :2], axis1=1, axis2=2))
        assert worst[name] < 3.0 * sigma.max()
    assert worst["free"] < 6.0  # m after 15 s: 0.02 m/s, 3 mrad of yaw at 9 m/s
    assert worst["smoothed"] < 0.5 * worst["free"] + 0.2
    assert worst["constraint"] < worst["free"] + 0.5


def test_readings_gap_is_bridged_and_told() -> None:
    given, read = fixes(), readings()
    t = (read.t_ns - T0_NS) * 1e-9
    keep = ~((t > 60.0) & (t < 60.6))
    holed = Inertial(read.t_ns[keep], read.dt_s[keep], read.gyro[keep], read.accel[keep], True)
    run = loose(given, holed, config())
    assert "1 gaps of the inertial readings, 0.60 s in all" in run.solution.provenance["notes"][0]
    e, _ = errors(run)
    late = run.solution.t_ns > T0_NS + 62 * NS
    assert np.hypot(e[late, 0], e[late, 1]).max() < 1.0  # m: as without a gap, two seconds later


def test_after_a_long_gap_the_filter_begins_anew() -> None:
    given, read = fixes(), readings()
    t = (read.t_ns - T0_NS) * 1e-9
    keep = ~((t > 50.0) & (t < 56.0))
    holed = Inertial(read.t_ns[keep], read.dt_s[keep], read.gyro[keep], read.accel[keep], True)
    run = loose(given, holed, config())
    assert "2 stretches of readings" in run.solution.provenance["notes"][0]
    at_s = (run.solution.t_ns - T0_NS) * 1e-9
    assert not ((at_s > 50.1) & (at_s < 55.9)).any()
    e, _ = errors(run)
    assert np.hypot(e[:, 0], e[:, 1])[(at_s > 30.0) & ((at_s < 50.0) | (at_s > 70.0))].max() < 1.0  # m
    assert len(run.nav) == run.solution.n_epochs == len(run.sigma)


def test_rates_and_increments_agree() -> None:
    section = Imu.from_dict({"grade": "perfect", "rate_hz": 100.0, "output": "rates"})
    rates = simulate_imu(drive(), section, T0_NS, T0_NS + 120 * NS, streams(0)).measured
    section = Imu.from_dict({"grade": "perfect", "rate_hz": 100.0, "output": "increments"})
    steps = simulate_imu(drive(), section, T0_NS, T0_NS + 120 * NS, streams(0)).measured
    one, other = loose(fixes(), rates, config()), loose(fixes(), steps, config())
    assert np.abs(one.solution.pos_e - other.solution.pos_e).max() < 2e-3  # m: trapezoids of rates at 100 Hz
    assert one.solution.t_ns.tolist() == other.solution.t_ns.tolist()


def test_height_and_speed_aid() -> None:
    given = fixes()
    t = np.arange(T0_NS + NS, T0_NS + 119 * NS, NS // 2)
    pos, vel, C_eb = at(t)
    height = geodetic_from_ecef(pos)[:, 2] + ARM[2]
    ahead = np.einsum("ki,ki->k", C_eb[:, :, 0], vel)
    gap = (given.t_ns > T0_NS + 60 * NS) & (given.t_ns < T0_NS + 100 * NS)
    alone = loose(part(given, ~gap), readings(), config(), epochs_ns=given.t_ns[gap])
    aided = loose(
        part(given, ~gap), readings(), config(**{"vehicle.mount_sigma_deg": 0.5}), epochs_ns=given.t_ns[gap],
        baro=Scalars(t, height + 2.0, np.full(len(t), 0.1)), odometer=Scalars(t, ahead, np.full(len(t), 0.01)),
    )  # fmt: skip
    inside = np.isin(alone.solution.t_ns, given.t_ns[gap])
    free, held = np.abs(errors(alone)[0][inside]), np.abs(errors(aided)[0][inside])
    assert held[:, 2].max() < 1.0  # m, while the barometer is 2 m off for good
    assert aided.est[-1, aided.layout.index("baro")] == pytest.approx(2.0, abs=0.5)
    assert np.hypot(held[:, 0], held[:, 1]).max() < np.hypot(free[:, 0], free[:, 1]).max()


def test_late_fixes_are_told_of() -> None:
    given = fixes()
    late = replace(given, t_ns=given.t_ns + NS // 2, available_ns=given.t_ns + NS // 2)
    notes = loose(late, readings(), config()).solution.provenance["notes"]
    assert any("taken 0.50 s earlier they agree" in note for note in notes)
    assert not any("agree" in note for note in loose(given, readings(), config()).solution.provenance["notes"])


def test_late_velocities_are_told_of() -> None:
    given = fixes(sigma=0.02)
    _, vel, _ = at(given.t_ns - NS // 5)
    lagging = replace(given, vel_e=vel)
    notes = loose(lagging, readings(), config()).solution.provenance["notes"]
    assert any("lag their positions by 0.2" in note and "velocity_lag_s" in note for note in notes)
    notes = loose(lagging, readings(), config(velocity_lag_s=0.2)).solution.provenance["notes"]
    assert not any("lag" in note for note in notes)
    assert np.isnan(velocity_lag(_table(given))[0])


def _table(given: Fixes) -> Any:
    from starwise.estimators.ins import fix_table

    return fix_table(part(given, slice(0, 10)), T0_NS, 120.0, config())[0]


def test_a_lever_arm_is_found() -> None:
    run = loose(fixes(sigma=0.02), readings(), config(lever_arm_m=[0.0, 0.0, -1.0], lever_arm_sigma_m=1.0))
    assert run.solution.extra["lever_arm_x_m"][-1] == pytest.approx(ARM[0], abs=0.05)
    assert run.solution.extra["lever_arm_y_m"][-1] == pytest.approx(ARM[1], abs=0.05)


def spoiled(what: str) -> tuple[Fixes, Inertial]:
    given, read = fixes(), readings()
    if what == "swapped axes":
        return given, replace(read, gyro=read.gyro[:, [0, 2, 1]].copy(), accel=read.accel[:, [0, 2, 1]].copy())
    if what == "g for m/s^2":
        return given, replace(read, accel=read.accel / 9.8)
    if what == "NaN":
        gyro = read.gyro.copy()
        gyro[100] = np.nan
        return given, replace(read, gyro=gyro)
    if what == "repeated times":
        t_ns = read.t_ns.copy()
        t_ns[100] = t_ns[99]
        return given, replace(read, t_ns=t_ns)
    if what == "other week":
        return replace(given, t_ns=given.t_ns + 604_800 * NS), read
    if what == "never moves":
        return part(given, given.t_ns < T0_NS + 8 * NS), read
    return given, replace(read, t_ns=read.t_ns[:2], dt_s=read.dt_s[:2], gyro=read.gyro[:2], accel=read.accel[:2])


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("swapped axes", "third axis does not point down"),
        ("g for m/s^2", "not that of gravity"),
        ("NaN", "gyro readings are not numbers"),
        ("repeated times", "do not increase"),
        ("other week", "no fix within the inertial readings"),
        ("never moves", "no heading"),
        ("two readings", "too few"),
    ],
)
def test_bad_inputs_are_one_line(what: str, message: str) -> None:
    with pytest.raises(StarwiseError, match=message) as caught:
        loose(*spoiled(what), config())
    assert "\n" not in str(caught.value)


def test_doubtful_fixes_are_used_and_told_of() -> None:
    given = fixes()
    cov = given.cov_pos.copy()
    cov[50] = 0.0
    before = replace(given, t_ns=given.t_ns - 5 * NS)
    notes = loose(replace(given, cov_pos=cov), readings(), config()).solution.provenance["notes"]
    assert any("1 fixes claim sigmas below" in note for note in notes)
    assert loose(part(given, slice(2, None)), readings(), config()).solution.n_epochs > 100
    with_early = replace(given, t_ns=np.concatenate([before.t_ns[:10], given.t_ns[10:]]))
    notes = loose(with_early, readings(), config()).solution.provenance["notes"]
    assert any("before or after the inertial readings" in note for note in notes)


def test_epochs_are_those_of_the_fixes_to_the_nanosecond() -> None:
    given, read = fixes(sigma=0.02), readings()
    odd = replace(given, t_ns=given.t_ns + 123_456, available_ns=given.t_ns + 123_456)
    run = loose(odd, replace(read, t_ns=read.t_ns + 123_777), config())
    assert set(run.solution.t_ns.tolist()) <= set(odd.t_ns.tolist())
    # an epoch that came before its fix would have the variance of the prediction, twice that of the fix or more
    k = np.isin(odd.t_ns, run.solution.t_ns)
    with_fix = np.trace(run.pos_cov, axis1=1, axis2=2) < np.trace(odd.cov_pos[k], axis1=1, axis2=2)
    assert with_fix[20:].all()


def test_fixes_without_sigmas_are_not_given_any() -> None:
    given = fixes()
    assert given.cov_vel is not None
    none = np.full_like(given.cov_pos, np.nan)
    with pytest.raises(StarwiseError, match="claim no sigmas"):
        loose(replace(given, cov_pos=none), readings(), config())
    notes = loose(replace(given, cov_vel=none), readings(), config()).solution.provenance["notes"]
    assert any("velocities claim no sigmas: not used" in note for note in notes)
    some = given.cov_pos.copy()
    some[40:50] = np.nan
    run = loose(replace(given, cov_pos=some), readings(), config())
    assert any("10 fixes claim no sigmas: not used" in note for note in run.solution.provenance["notes"])
    told = config(fix_sigma_m=0.3, velocity_sigma_mps=0.05)
    run = loose(replace(given, cov_pos=none, cov_vel=0.0 * given.cov_vel), readings(), told)
    assert run.solution.provenance["nis_per_dof"] == pytest.approx(1.0, abs=0.2)  # the sigmas they have


def test_wrong_positions_are_not_hidden_by_good_velocities() -> None:
    given = fixes()
    rng = np.random.default_rng(3)
    wild = replace(given, pos_e=given.pos_e + 0.7 * rng.normal(size=given.pos_e.shape))  # claimed: 0.3 m
    notes = loose(wild, readings(), config()).solution.provenance["notes"]
    assert any("contradict each other" in note for note in notes)


def test_a_wild_fix_moves_little() -> None:
    given = fixes()
    pos = given.pos_e.copy()
    pos[150] += 200.0
    run = loose(replace(given, pos_e=pos), readings(), config())
    e, _ = errors(run)
    assert np.linalg.norm(e, axis=1)[run.solution.t_ns > T0_NS + 30 * NS].max() < 3.0  # m
    assert run.fixes["weight"][150] < 0.01


def test_levelling() -> None:
    C = rotation(2, 0.0) @ rotation(1, 0.1) @ rotation(0, -0.2)
    wanted = np.array([1.0, -2.0, -9.8])
    roll, pitch = level(C.T @ wanted, wanted[:2])
    assert (roll, pitch) == pytest.approx((-0.2, 0.1), abs=1e-12)
    q = quaternion(C)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-14)


def test_gyrocompassing() -> None:
    given = {"start": [48.0, 11.0, 500.0], "heading_deg": 123.0, "segments": [{"kind": "static"}]}
    rest = from_segments(Vehicle.from_dict(given), T0_NS, 300.0)
    read = simulate_imu(
        rest, Imu.from_dict({"grade": "navigation", "rate_hz": 50.0}), T0_NS, T0_NS + 300 * NS, streams(4)
    ).measured
    t = T0_NS + np.arange(0, 300) * NS
    pos = rest.states(t).pos_e
    still = Fixes(
        t, t, pos, np.tile(np.eye(3), (300, 1, 1)), np.zeros((300, 3)), np.tile(1e-4 * np.eye(3), (300, 1, 1))
    )
    sensor = {
        "gyro": {"white_dprh": 0.002, "bias_dph": 0.001, "in_run_dph": 0.001, "vibration": 0.0},
        "accel": {"white_mpsrh": 0.012, "bias_ug": 35.0, "in_run_ug": 5.0, "vibration": 0.0},
        "alignment": "gyrocompass",
    }
    run = loose(still, read, InertialConfig.from_dict(sensor))
    yaw = run.solution.extra["yaw_deg"][-1]
    # 0.002 deg/rt(h) over 300 s: 0.007 deg/h of 10 deg/h across: 0.04 deg
    assert (yaw - 123.0 + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.15)
    with pytest.raises(StarwiseError, match="not good enough"):
        loose(still, read, InertialConfig.from_dict({"alignment": "gyrocompass"}))


@pytest.mark.real
def test_real_car_coasts_and_finds_its_mount(shared_data: Path) -> None:
    from starwise.estimators.ins_tight import fixes_of
    from starwise.io.imu import read_imu
    from starwise.io.pos import read_pos

    folder = shared_data / "imu" / "rtklibexplorer_drive_0708"
    read = read_imu(folder / "imu_1934.csv", "rtklibexplorer-drive")
    given = fixes_of(read_pos(folder / "gnss_1934_sf.pos"))
    t = (given.t_ns - read.t_ns[0]) * 1e-9
    base = {"lever_arm_m": [0.0, -0.05, 0.0], "velocity_lag_s": 0.135}
    ends: dict[str, list[float]] = {"free": [], "constraint": [], "smoothed": []}
    for name in ends:
        car = {} if name == "free" else {"vehicle": {"constraint": True, "rest": True}}
        chosen = InertialConfig.from_dict({**base, **car, "smooth": name == "smoothed"})
        gap = (t - 10.0) % 40.0 < 15.0
        run = loose(part(given, ~gap), read, chosen, epochs_ns=given.t_ns[gap])
        k = np.searchsorted(given.t_ns, run.solution.t_ns - 1_000_000)  # tags of the run are whole microseconds
        h = np.linalg.norm(run.solution.pos_e - given.pos_e[np.clip(k, 0, given.n - 1)], axis=1)
        at_s = (run.solution.t_ns - read.t_ns[0]) * 1e-9
        for begin in np.arange(90.0, 500.0, 40.0):
            inside = (at_s >= begin) & (at_s < begin + 15.0)
            ends[name].append(float(h[inside].max() if name == "smoothed" else h[inside][-1]))
        if name == "constraint":
            # deg: the author's calibration, -6.79 and 5.35
            assert run.solution.extra["mount_pitch_deg"][-1] == pytest.approx(-6.8, abs=0.3)
            assert run.solution.extra["mount_yaw_deg"][-1] == pytest.approx(5.1, abs=0.4)
    # m, 3D, eleven gaps of one phase: a coarse net; the benchmark has all phases
    assert np.median(ends["free"]) < 6.0
    assert np.median(ends["constraint"]) < 1.8
    assert np.median(ends["smoothed"]) < 0.3
