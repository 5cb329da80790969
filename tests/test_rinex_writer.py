"""RINEX files of a simulation: read back they are the same nouns, and other people's programs position from them."""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from starwise.config import RunConfig
from starwise.constants import NS, SYS_C, SYS_R, SYSTEMS
from starwise.errors import StarwiseError
from starwise.estimators.run import solve_run
from starwise.frames import ecef_from_geodetic, enu_from_ecef
from starwise.gnsstime import parse_time
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import read_obs
from starwise.kernels.sim_format import observation_lines
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.signals import signal_id, sv_id
from starwise.sim.receiver import Motion, receive
from starwise.sim.rinex_writer import write_nav, write_obs
from starwise.sim.run import Simulator, simulate
from starwise.sim.scenario import Scenario, load_scenario
from starwise.sim.sections import Fault, Ionosphere, Noise, Receiver, Sky, Troposphere
from starwise.sim.seeds import streams
from starwise.sim.sky import build_sky
from starwise.sim.writers import write_files, write_imu, write_truth
from starwise.types import Observations

T0 = parse_time("2024-03-30T23:59:00")
PLACE = ecef_from_geodetic([np.radians(30.5), np.radians(114.3), 50.0])
ALL = ("gps", "glonass", "galileo", "beidou2", "beidou3", "qzss")


@pytest.fixture(scope="module")
def simulated():
    sky = build_sky(Sky(constellations=ALL), T0, T0 + 120 * NS, streams(1))
    receiver = Receiver(
        noise=Noise(model="elevation", code_m=0.3),
        ionosphere=Ionosphere(model="broadcast", scale=1.0),
        troposphere=Troposphere(model="saastamoinen"),
    )
    faults = (Fault(kind="outage", satellites=("G",), start_s=30.0, duration_s=10.0),)
    t_ns = T0 + np.arange(120) * NS
    obs, truth = receive(receiver, faults, sky, Motion.at_rest(t_ns, PLACE), streams(1), "WUHN")
    return obs, sky.records, truth


@pytest.fixture(scope="module")
def files(simulated, tmp_path_factory):
    folder = tmp_path_factory.mktemp("rinex")
    write_obs(simulated[0], folder / "a.rnx")
    write_nav(simulated[1], folder / "a.nav")
    return folder / "a.rnx", folder / "a.nav"


# -- what is read back ------------------------------------------------------------------------------------------------
@pytest.mark.laws
def test_observations_read_back_are_those_written(simulated, files):
    obs, back = simulated[0], read_obs(files[0])
    assert back.problems == ()
    for name in ("t_ns", "offsets", "flag", "sv", "sig", "lli"):
        assert np.array_equal(getattr(obs, name), getattr(back, name)), name
    # half of the last printed digit, and rounding of 4e8 cycles
    for name in ("code_m", "phase_cyc", "doppler_hz", "cn0_dbhz"):
        assert np.abs(getattr(obs, name) - getattr(back, name)).max() < 5.001e-4, name
    assert back.channels == obs.channels
    assert back.header.marker == "WUHN"
    assert back.header.signals == obs.header.signals
    assert back.header.interval_s == 1.0
    assert back.header.approx_pos_e == pytest.approx(PLACE, abs=6e-5)
    assert back.header.version == "3.05"


@pytest.mark.laws
def test_records_read_back_are_those_written(simulated, files):
    records, back = simulated[1], read_nav(files[1])
    assert back.problems == ()
    assert back.n == records.n
    a = np.lexsort((records.message, records.toe_ns, records.sv))
    b = np.lexsort((back.message, back.toe_ns, back.sv))
    for name in ("sv", "message", "toc_ns", "toe_ns", "t_tx_ns", "health", "iode", "iodc", "source"):
        assert np.array_equal(getattr(records, name)[a], getattr(back, name)[b]), name
    for name in ("accuracy_m", "fit_s"):
        assert np.array_equal(getattr(records, name)[a], getattr(back, name)[b], equal_nan=True), name
    for name in ("par", "tgd"):
        x, y = getattr(records, name)[a], getattr(back, name)[b]
        assert np.array_equal(np.isnan(x), np.isnan(y)), name
        # 13 significant digits
        assert (np.abs(x - y)[~np.isnan(x)] <= 5.1e-13 * np.abs(x[~np.isnan(x)])).all(), name
    assert np.allclose(back.ionosphere.klobuchar["G"], records.ionosphere.klobuchar["G"], rtol=5e-5)
    assert back.leap_s == 18


def test_messages_that_were_read_can_be_written_again(files, tmp_path):
    once = read_nav(files[1])
    write_nav(once, tmp_path / "b.nav")
    assert (tmp_path / "b.nav").read_bytes() == files[1].read_bytes()


@pytest.mark.laws
@settings(max_examples=200, deadline=None)
@given(value=st.one_of(st.floats(-9_999_999_99.0, 9_999_999_999.0), st.just(float("nan"))))
def test_numbers_are_printed_as_python_prints_them(value):
    out = np.zeros(200, dtype=np.uint8)
    used = observation_lines(
        np.array([0, 1]), np.frombuffer(b"> epoch\n", dtype=np.uint8), np.array([0, 8]), np.array([5], dtype=np.int16),
        np.array([0]), np.arange(4), np.full(7, 4, dtype=np.int64), np.frombuffer(SYSTEMS.encode(), dtype=np.uint8),
        np.array([[value, np.nan, -value if value > 0 else np.nan, np.nan]]), np.zeros(1, dtype=np.uint8), out,
    )  # fmt: skip
    text = out[:used].tobytes().decode()
    assert text.startswith("> epoch\nG05")
    field = text[8 + 3 : 8 + 17].rstrip("\n")
    if value != value:
        assert field.strip() == ""
    else:
        # the value times 1000 rounds to the nearest; halves away from zero, where Python has halves to even
        assert abs(float(field) - value) <= 5.0001e-4 + 1e-15 * abs(value)
        assert field.strip() in {f"{value:.3f}", f"{float(field):.3f}"}
        assert len(field) == 14


def hand_made(**changes):
    base = {
        "t_ns": np.array([T0, T0 + NS]),
        "offsets": np.array([0, 2, 2]),
        "flag": np.zeros(2, dtype=np.uint8),
        "clock_offset_s": np.array([np.nan, -1.25e-4]),
        "sv": np.array([sv_id("G05"), sv_id("G05")], dtype=np.int16),
        "sig": np.array([signal_id("1C"), signal_id("5Q")], dtype=np.int16),
        "code_m": np.array([20_000_000.1234, np.nan]),
        "phase_cyc": np.array([-1_234.5678, 100_000_000.0]),
        "doppler_hz": np.array([-0.0004, np.nan]),
        "cn0_dbhz": np.array([47.3, np.nan]),
        "lli": np.array([1, 0], dtype=np.uint8),
    }
    return Observations(**{**base, **changes})


def test_lines_stand_in_their_columns(tmp_path):
    write_obs(hand_made(), tmp_path / "a.rnx")
    lines = (tmp_path / "a.rnx").read_text().splitlines()
    body = lines[lines.index(f"{'':60}END OF HEADER") + 1 :]
    assert all(len(line) <= 80 for line in lines[: len(lines) - len(body)])
    assert body == [
        "> 2024 03 30 23 59  0.0000000  0  1",
        "G05  20000000.123 7     -1234.56817        -0.000          47.300" + " " * 18 + " 100000000.000",
        "> 2024 03 30 23 59  1.0000000  0  0      -0.000125000000",
    ]


def test_kinds_that_never_occur_get_no_column(tmp_path):
    write_obs(hand_made(phase_cyc=np.full(2, np.nan), doppler_hz=np.full(2, np.nan)), tmp_path / "a.rnx")
    text = (tmp_path / "a.rnx").read_text()
    assert "G    4 C1C S1C C5Q S5Q      " in text
    back = read_obs(tmp_path / "a.rnx")
    assert back.code_m[0] == 20_000_000.123
    assert back.cn0_dbhz[0] == 47.3
    assert np.isnan(back.phase_cyc).all()


def test_what_does_not_fit_is_refused(tmp_path):
    with pytest.raises(StarwiseError, match="does not fit into a RINEX file"):
        write_obs(hand_made(code_m=np.array([1e11, 1.0])), tmp_path / "a.rnx")
    with pytest.raises(StarwiseError, match="cannot be written"):
        write_obs(hand_made(), tmp_path / "no" / "a.rnx")
    empty = hand_made(
        t_ns=np.empty(0, dtype=np.int64), offsets=np.zeros(1, dtype=np.int64), flag=np.empty(0, dtype=np.uint8),
        clock_offset_s=np.empty(0),
    )  # fmt: skip
    with pytest.raises(StarwiseError, match="no epoch"):
        write_obs(empty, tmp_path / "a.rnx")


# -- other people's program -------------------------------------------------------------------------------------------
CONF = """pos1-posmode =single
pos1-frequency =l1
pos1-elmask =12
pos1-ionoopt =brdc
pos1-tropopt =saas
pos1-sateph =brdc
pos1-navsys ={navsys}
out-solformat =xyz
out-outopt =off
out-timesys =gpst
out-timeform =tow
"""
NAVSYS = {"G": 1, "R": 4, "E": 8, "J": 16, "C": 32}


def rtklib(files, tmp_path, systems="GRECJ"):
    """Positions (n, 3) and satellites used by RTKLIB's single point positioning."""
    program = shutil.which("rnx2rtkp")
    if program is None:
        pytest.skip("RTKLIB's rnx2rtkp is not installed")
    conf, out = tmp_path / "spp.conf", tmp_path / "out.pos"
    conf.write_text(CONF.format(navsys=sum(NAVSYS[s] for s in systems)))
    command = [program, "-k", str(conf), "-o", str(out), *(str(f) for f in files)]
    subprocess.run(command, check=True, capture_output=True, timeout=100)
    rows = [line.split() for line in out.read_text().splitlines() if line and not line.startswith("%")]
    return np.array([[float(v) for v in row[2:5]] for row in rows]), np.array([int(row[6]) for row in rows])


@pytest.mark.golden
def test_rtklib_positions_from_the_files(simulated, files, tmp_path):
    positions, used = rtklib(files, tmp_path)
    off = enu_from_ecef(positions, PLACE)
    assert len(positions) == 120
    # most of the 53 in view stand above 12 deg; GPS is out for 10 s
    assert used[0] >= 40
    assert used.min() >= 28
    # m: 0.3 m / sin(el) of code noise, 50 satellites; RTKLIB weighs and models the troposphere in its own way
    assert np.abs(off.mean(axis=0)).max() < 0.15
    assert off.std(axis=0).max() < 0.6


@pytest.mark.golden
@pytest.mark.parametrize("systems", ["G", "R", "E", "C"])
def test_rtklib_positions_from_each_system(systems, tmp_path):
    """Without noise RTKLIB is off by its own troposphere only: orbits, clocks, group delays and times are right."""
    names = {"G": ("gps",), "R": ("glonass",), "E": ("galileo",), "C": ("beidou2", "beidou3")}[systems]
    sky = build_sky(Sky(constellations=names), T0, T0 + 40 * NS, streams(2))
    noise = Noise(model="fixed", code_m=0.0, phase_m=0.0, rate_mps=0.0)
    receiver = Receiver(
        noise=noise, mask_deg=12.0, ionosphere=Ionosphere(model="broadcast", scale=1.0),
        troposphere=Troposphere(model="saastamoinen"),
    )  # fmt: skip
    obs, _ = receive(receiver, (), sky, Motion.at_rest(T0 + np.arange(0, 40, 10) * NS, PLACE), streams(2))
    write_obs(obs, tmp_path / "a.rnx")
    write_nav(sky.records, tmp_path / "a.nav")
    positions, _ = rtklib((tmp_path / "a.rnx", tmp_path / "a.nav"), tmp_path, systems)
    assert len(positions) == 4
    # m: Saastamoinen with 1 / sin(el) in RTKLIB against Niell's mapping above 12 deg, times VDOP
    assert np.linalg.norm(positions - PLACE, axis=1).max() < 0.25


def test_starwise_positions_from_the_files(files):
    obs, nav = read_obs(files[0]), read_nav(files[1])
    config = RunConfig.from_dict({"method": "lsq", "error_model": "white", "systems": "GRECJ", "mask_deg": 5.0})
    solution = solve_run(obs, BroadcastEphemeris(nav), nav.ionosphere, config)
    off = enu_from_ecef(solution.pos_e, PLACE)
    assert np.abs(off.mean(axis=0)).max() < 0.1  # m: 50 satellites, 120 epochs
    assert off.std(axis=0).max() < 0.6


# -- all files of a run ------------------------------------------------------------------------------------------------
def small(**sections):
    data = {
        "name": "drive",
        "time": {"start": "2024-03-30T11:00:00", "duration_s": 10.0},
        "vehicle": {
            "start": [30.5, 114.3, 50.0],
            "speed_mps": 20.0,
            "segments": [{"kind": "straight"}],
        },
        **sections,
    }
    return Scenario.from_dict(data)


def test_run_writes_all_files_and_the_truth_is_the_truth(tmp_path):
    scenario = small(imu={"grade": "tactical", "rate_hz": 50.0}, output={"truth": "csv"})
    simulation = simulate(scenario)
    paths = write_files(simulation, tmp_path / "deep" / "out")
    assert set(paths) == {"observations", "navigation", "truth", "terms", "scenario", "imu"}
    truth = pl.read_csv(paths["truth"])
    assert truth.height == 11
    position = truth.select("pos_x_m", "pos_y_m", "pos_z_m").to_numpy()
    assert np.abs(position - simulation.truth.pos_e).max() < 1e-8
    from starwise.io.truth import read_truth

    read = read_truth(str(paths["truth"]))
    assert np.abs(read.pos_e - simulation.truth.pos_e).max() < 1e-6
    assert np.array_equal(read.t_ns, simulation.truth.t_ns)
    imu = pl.read_csv(paths["imu"])
    assert imu.columns[:3] == ["t_gpst_ns", "dt_s", "dtheta_x_rad"]
    assert imu.height == 500
    terms = pl.read_parquet(paths["terms"])
    assert terms.height == simulation.observations.n_rows
    assert read_obs(paths["observations"]).n_epochs == 11
    effective = json.loads(paths["scenario"].read_text())
    assert effective.pop("run") == 0
    assert Scenario.from_dict(effective) == scenario


def test_truth_has_two_formats_only(tmp_path):
    simulation = simulate(small())
    write_truth(simulation.truth, tmp_path / "a.parquet")
    assert pl.read_parquet(tmp_path / "a.parquet").height == 11
    with pytest.raises(StarwiseError, match="Parquet or CSV"):
        write_truth(simulation.truth, tmp_path / "a.txt")
    imu = simulate(small(imu={"output": "rates"})).imu
    with pytest.raises(StarwiseError, match="cannot be written"):
        write_imu(imu.measured, tmp_path / "no" / "a.csv")


@pytest.mark.laws
def test_runs_do_not_depend_on_what_ran_before():
    scenario = load_scenario("s3ekf-3-turn")
    one = Simulator(scenario)
    for number in (0, 3):
        one.run(number)
    again, fresh = one.run(2), Simulator(scenario).run(2)
    assert np.array_equal(again.observations.code_m, fresh.observations.code_m)
    assert np.array_equal(again.truth.pos_e, fresh.truth.pos_e)
    other = Simulator(scenario, seed=5).run(2)
    assert not np.array_equal(other.observations.code_m, fresh.observations.code_m)


@pytest.mark.laws
def test_path_between_tag_and_reception_is_followed():
    """The antenna is where it was at the tag minus the clock: a parabola over short offsets is as good as the path."""
    scenario = load_scenario("s3ekf-3-turn")
    run = Simulator(scenario).run(1)
    received = run.truth.t_ns - np.rint(run.truth.clock_s * NS).astype(np.int64)
    pos, vel = scenario.trajectory.states(received).at_lever_arm(scenario.receiver.lever_arm_m)
    assert np.abs(pos - run.truth.pos_e).max() < 1e-6  # m: half a nanosecond of 300 m/s
    assert np.abs(vel - run.truth.vel_e).max() < 1e-6


@pytest.mark.parametrize("name", ["s3ekf-1-static", "s3ekf-2-steps", "s3ekf-3-turn", "s3ekf-4-climb-dive"])
def test_shipped_scenarios_run(name):
    run = Simulator(load_scenario(name)).run()
    assert run.truth.visible.min() >= 12
    assert set((run.observations.sv >> 8).tolist()) == {0, SYS_C}
    assert SYS_R not in run.observations.sv >> 8


def test_bad_skies_get_one_line(tmp_path):
    with pytest.raises(StarwiseError, match="no satellite is visible"):
        simulate(small(vehicle={"start": [-60.0, -70.0, 0.0], "segments": [{"kind": "static"}]},
                       sky={"constellations": ["beidou1"]}))  # fmt: skip
    with pytest.raises(StarwiseError, match="cannot be read"):
        simulate(small(sky={"source": "tle", "files": ["no.tle"]}))
    with pytest.raises(StarwiseError, match="needs its records"):
        simulate(small(sky={"source": "nav", "files": ["no.nav"]}))
