"""Files of inertial readings: what is declared is what is read, and mistakes are called by their names."""

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.gnsstime import from_week_tow, parse_time
from starwise.io.imu import read_imu
from starwise.io.imu_check import check_imu
from starwise.io.imu_config import ImuFile, layout_names, load_imu_config
from starwise.sim.imu import simulate_imu
from starwise.sim.sections import Imu, Vehicle
from starwise.sim.seeds import streams
from starwise.sim.trajectory import from_segments
from starwise.sim.writers import write_imu
from starwise.types import Inertial

T0_NS = from_week_tow(2300, 1000.0)
G = 9.80665
BASE: dict[str, Any] = {
    "readings": "rates",
    "rate_hz": 10.0,
    "axes": "FRD",
    "time": {"scale": "gpst_tow", "column": 1, "week": 2300},
    "gyro": {"columns": [2, 3, 4], "unit": "rad/s"},
    "accel": {"columns": [5, 6, 7], "unit": "m/s^2"},
}


def described(**changes: Any) -> ImuFile:
    data = {k: dict(v) if isinstance(v, dict) else v for k, v in BASE.items()}
    for key, value in changes.items():
        if isinstance(value, dict):
            data[key] = {**data[key], **value}
        else:
            data[key] = value
    return ImuFile.from_dict({k: v for k, v in data.items() if v is not None})


def table(n: int = 40) -> Any:
    """Columns: time, gyro, accel; a body at rest with a little noise."""
    rng = np.random.default_rng(1)
    t = 1000.0 + 0.1 * np.arange(n)
    gyro = 1e-3 * rng.standard_normal((n, 3))
    accel = np.array([0.1, -0.2, -9.8]) + 0.01 * rng.standard_normal((n, 3))
    return np.column_stack([t, gyro, accel])


def written(folder: Path, rows: Any, delimiter: str = ",") -> Path:
    file = folder / "imu.csv"
    file.write_text("\n".join(delimiter.join(f"{v:.9f}" for v in row) for row in rows) + "\n")
    return file


def drive(duration_s: float = 120.0, *, increments: bool = False) -> Inertial:
    """A car in curves, with the errors of an industrial sensor."""
    turn = {"kind": "turn", "rate_dps": 12.0, "angle_deg": 90.0}
    back = {**turn, "angle_deg": -90.0}
    ways = [{"kind": "straight", "duration_s": 8.0}, turn, back, turn, turn, back] * 3
    given = {"kind": "car", "start": [48.0, 11.0, 500.0], "heading_deg": 30.0, "speed_mps": 12.0, "segments": ways}
    path = from_segments(Vehicle.from_dict(given), T0_NS, duration_s)
    section = Imu(grade="industrial", rate_hz=100.0, output="increments" if increments else "rates")
    return simulate_imu(path, section, T0_NS, T0_NS + round(duration_s) * NS, streams(7, 0)).measured


@pytest.mark.laws
def test_layouts_of_the_package_are_readable() -> None:
    assert {"kf-gins", "starwise-rates", "starwise-increments"} <= set(layout_names())
    for name in layout_names():
        options = {"time": {"week": 2300}} if name in ("kf-gins", "seconds-of-week-rates") else {}
        assert load_imu_config(name, options).rate_hz > 0.0


@pytest.mark.laws
@pytest.mark.parametrize("increments", [False, True])
def test_a_simulation_comes_back_as_it_was_written(tmp_path: Path, increments: bool) -> None:
    inertial = drive(20.0, increments=increments)
    write_imu(inertial, tmp_path / "imu.csv")
    read = read_imu(tmp_path / "imu.csv", "starwise-increments" if increments else "starwise-rates")
    assert read.increments == increments
    assert not read.problems
    np.testing.assert_array_equal(read.t_ns, inertial.t_ns)
    np.testing.assert_array_equal(read.gyro, inertial.gyro)
    np.testing.assert_array_equal(read.accel, inertial.accel)
    np.testing.assert_allclose(read.dt_s, inertial.dt_s, rtol=0, atol=1e-12)  # s: rounding of a period


AXES = {
    "FRD": lambda v: v,
    "FLU": lambda v: v * [1.0, -1.0, -1.0],
    "RFU": lambda v: v[:, [1, 0, 2]] * [1.0, 1.0, -1.0],
    "BRU": lambda v: v * [-1.0, 1.0, -1.0],
}


@pytest.mark.laws
@pytest.mark.parametrize("axes", list(AXES))
@pytest.mark.parametrize(("gyro", "accel"), [("rad/s", "m/s^2"), ("deg/s", "g"), ("deg/h", "mg")])
def test_units_and_axes_are_as_declared(tmp_path: Path, axes: str, gyro: str, accel: str) -> None:
    rows = table()
    g = {"rad/s": 1.0, "deg/s": 180.0 / np.pi, "deg/h": 180.0 / np.pi * 3600.0}[gyro]
    a = {"m/s^2": 1.0, "g": 1.0 / G, "mg": 1000.0 / G}[accel]
    turned: Callable[[Any], Any] = AXES[axes]
    file = written(tmp_path, np.column_stack([rows[:, 0], turned(rows[:, 1:4]) * g, turned(rows[:, 4:]) * a]))
    read = read_imu(file, described(axes=axes, gyro={"unit": gyro}, accel={"unit": accel}))
    np.testing.assert_allclose(read.gyro, rows[:, 1:4], rtol=0, atol=2e-9 / g * 2 + 1e-9)  # 9 decimals in the file
    np.testing.assert_allclose(read.accel, rows[:, 4:], rtol=0, atol=2e-8)  # 9 decimals, times 9.8 for g
    np.testing.assert_array_equal(read.t_ns, T0_NS + np.arange(40) * NS // 10)


def test_a_rotation_in_place_of_axes(tmp_path: Path) -> None:
    file = written(tmp_path, table())
    direct = read_imu(file, described())
    C = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    read = read_imu(file, described(axes=None, rotation=C.tolist()))
    np.testing.assert_allclose(read.accel, direct.accel @ C.T, atol=1e-12)  # m/s^2: rounding
    with pytest.raises(StarwiseError, match="'rotation' is not a rotation"):
        described(axes=None, rotation=np.diag([1.0, 1.0, -1.0]).tolist())


def test_time_scales_give_the_same_instants(tmp_path: Path) -> None:
    t_ns = T0_NS + np.arange(40) * NS // 10
    rest = table()[:, 1:]
    unix = (t_ns // NS + 315_964_800 - 18) + (t_ns % NS) / NS  # 18 leap seconds in 2024
    for times, form, time in (
        (1000.0 + 0.1 * np.arange(40), ".3f", {"scale": "gpst_tow", "week": 2300}),
        (unix, ".3f", {"scale": "unix"}),
        (t_ns, "d", {"scale": "gps_seconds", "unit": "ns"}),
        (100 * np.arange(40), "d", {"scale": "seconds", "unit": "ms", "origin": "2300:1000"}),
        (777.7 + 0.1 * np.arange(40), ".3f", {"scale": "seconds", "origin": "2300:1000", "origin_at": "first"}),
        (999.5 + 0.1 * np.arange(40), ".3f", {"scale": "gpst_tow", "week": 2300, "offset_s": 0.5}),
    ):
        lines = [",".join([format(t, form), *(f"{v:.9f}" for v in row)]) for t, row in zip(times, rest, strict=True)]
        (tmp_path / "imu.csv").write_text("\n".join(lines))
        description = ImuFile.from_dict({**BASE, "time": {"column": 1, **time}})
        read = read_imu(tmp_path / "imu.csv", description)
        slack = 120 if time["scale"] == "unix" else 0  # ns: half a step of a float64 of seconds since 1970
        np.testing.assert_allclose(read.t_ns - t_ns, 0, rtol=0, atol=slack, err_msg=str(time))
    labels = [f"2024-02-04T00:16:{40 + k // 10:02d}.{k % 10}" for k in range(40)]
    assert parse_time(labels[0]) == T0_NS
    lines = [",".join([label, *(f"{v:.9f}" for v in row)]) for label, row in zip(labels, rest, strict=True)]
    (tmp_path / "imu.csv").write_text("\n".join(lines))
    read = read_imu(tmp_path / "imu.csv", ImuFile.from_dict({**BASE, "time": {"column": 1, "scale": "gpst"}}))
    np.testing.assert_array_equal(read.t_ns, t_ns)
    read = read_imu(tmp_path / "imu.csv", ImuFile.from_dict({**BASE, "time": {"column": 1, "scale": "utc"}}))
    np.testing.assert_array_equal(read.t_ns, t_ns + 18 * NS)


def test_the_week_goes_on_at_saturday_midnight(tmp_path: Path) -> None:
    rows = table()
    rows[:, 0] = (604_798.0 + 0.1 * np.arange(40)) % 604_800.0
    read = read_imu(written(tmp_path, rows), described())
    np.testing.assert_array_equal(np.diff(read.t_ns), NS // 10)
    assert read.t_ns[-1] == from_week_tow(2301, 1.9)


def test_coarse_tags_of_an_even_sensor_become_even(tmp_path: Path) -> None:
    rows = table(200)
    true = 1000.0 + 0.1 * np.arange(200) + 0.0004
    rows[:, 0] = np.floor(true * 100.0) / 100.0 + 0.02 * (np.arange(200) % 3 == 0)
    read = read_imu(written(tmp_path, rows), described(time={"tags": "uniform"}))
    step = np.diff(read.t_ns)
    assert step.max() - step.min() <= 1  # ns: rounding
    assert abs(step.mean() - NS / 10) < 3e4  # ns: slope of a line through 200 tags of 20 ms


def test_gaps_repeated_rows_and_damage_are_dealt_with_and_told(tmp_path: Path) -> None:
    rows = np.delete(table(400), slice(100, 110), axis=0)
    text = written(tmp_path, rows).read_text().splitlines()
    text[20] = text[19]  # one row twice, in place of the next
    text[50] = text[50][:25]  # cut
    text[70] = text[70].replace(text[70].split(",")[2], "nan")
    file = tmp_path / "imu.csv.gz"
    file.write_bytes(gzip.compress("\n".join(text).encode()))
    read = read_imu(file, described())
    said = {problem.what.split(":")[0].split(" of")[0]: problem for problem in read.problems}
    assert set(said) == {"row not readable", "not numbers", "time repeated", "gap"}
    assert (said["row not readable"].line, said["not numbers"].line, said["time repeated"].line) == (51, 71, 21)
    assert said["gap"].count == 4
    assert "longest 1.100 s" in said["gap"].what
    assert len(read.t_ns) == 387
    step = np.diff(read.t_ns) / NS
    np.testing.assert_allclose(read.dt_s[1:][step > 0.15], 0.1, atol=1e-9)  # s: one period, the gap is seen beside it
    assert np.isfinite(read.gyro).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"accel": {"unit": "g"}}, r"unit m/s\^2, read as g"),
        ({"accel": {"factor": 1.0 / G}}, r"unit g, read as m/s\^2"),
        ({"accel": {"inverted": True}}, "gravity has the wrong sign"),
        ({"axes": "FLU"}, "z points up"),
        ({"axes": "DRB"}, "gravity is on the x axis: columns or axes swapped"),
        ({"rate_hz": 100.0}, "rate is not as declared"),
        ({"time": {"unit": "ms"}}, "rate is not as declared"),
        ({"gyro": {"unit": "deg/h"}}, "quieter than the Earth's rotation"),
        ({"gyro": {"columns": [1, 2, 3]}}, "used twice"),
        ({"gyro": {"columns": ["a", "b", "c"]}}, "columns have names but the file no header"),
        ({"accel": {"unit": "m/s"}}, "'accel.unit' is not a unit of rates; found 'm/s'; wanted m/s"),
        ({"axes": "FRU"}, "'axes' is not a rotation"),
        ({"axes": "ABC"}, "'axes' are not three directions"),
        ({"time": {"week": None}}, "week' or 'week_column' is needed"),
        ({"accel": {"columns": [5, 6, 9]}}, "imu.csv:1: row not readable"),
        ({"delimiter": "whitespace"}, "imu.csv:1: row not readable"),
    ],
)
def test_a_wrong_description_is_named(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(StarwiseError, match=message) as caught:
        read_imu(written(tmp_path, table()), described(**change))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("\n\n", "no readings in the file"),
        ("\0\0\0\0", "not a text file"),
        ("1,2\n3,4\n", "row not readable"),
        ("1000.0,0,0,0.001,0,0,-9.8\n", "only one reading"),
        ("-5,0,0,0.001,0,0,-9.8\n" * 3, "not a time of week"),
        ("1e300,0,0,0.001,0,0,-9.8\n" * 3, "time out of range"),
        ("nan,0,0,0.001,0,0,-9.8\n" * 3, "time is not a number|row not readable"),
        ("1000.0,0,0,nan,0,0,-9.8\n" * 3, "no reading is a number"),
        ("1000.0,0,0,0.001,0,0,-9.8\n" * 9, "times repeated in many rows"),
        ("".join(f"{1000 - k},0,0,0.001,0,0,-9.8\n" for k in range(9)), "time runs back"),
    ],
)
def test_a_bad_file_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "imu.csv").write_text(text)
    with pytest.raises(StarwiseError, match=message) as caught:
        read_imu(tmp_path / "imu.csv", described())
    assert "\n" not in str(caught.value)
    assert "imu.csv" in str(caught.value)


def test_two_increments_with_one_time_are_refused(tmp_path: Path) -> None:
    rows = table()
    rows[:, 1:] *= 0.1
    rows[7, 0] = rows[6, 0]
    change = {"readings": "increments", "gyro": {"unit": "rad"}, "accel": {"unit": "m/s"}}
    with pytest.raises(StarwiseError, match=r"imu\.csv:8: two increments with one time"):
        read_imu(written(tmp_path, rows), described(**change))


@pytest.mark.parametrize("increments", [False, True])
def test_a_good_drive_has_no_findings(increments: bool) -> None:
    assert check_imu(drive(increments=increments), 100.0) == []


@pytest.mark.parametrize(
    ("change", "mistake"),
    [
        (lambda g, a: (g * 180.0 / np.pi, a), "gyro_unit"),
        (lambda g, a: (g * np.pi / 180.0, a), "gyro_unit"),
        (lambda g, a: (g, -a), "accel_sign"),
        (lambda g, a: (-g, a), "gyro_sign"),
        (lambda g, a: (g, a / G), "accel_unit"),
        (lambda g, a: (g * 0.01, a * 0.01), "accel_unit"),
        (lambda g, a: (g[:, [2, 1, 0]], a), "axes_order"),
        (lambda g, a: (g, a[:, [2, 1, 0]]), "gravity_axis"),
        (lambda g, a: (0.0 * g, a), "constant"),
        (lambda g, a: (np.repeat(g[::4], 4, axis=0)[: len(g)], np.repeat(a[::4], 4, axis=0)[: len(a)]), "repeated"),
    ],
)
def test_mistakes_in_a_drive_are_named(change: Callable[[Any, Any], tuple[Any, Any]], mistake: str) -> None:
    good = drive()
    gyro, accel = change(good.gyro, good.accel)
    findings = check_imu(Inertial(good.t_ns, good.dt_s, gyro, accel, False), 100.0)
    assert mistake in [finding.mistake for finding in findings]


def test_descriptions_build_on_layouts(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('like = "kf-gins"\nrate_hz = 50.0\ntime.week = 2017\n')
    config = load_imu_config(file)
    assert (config.rate_hz, config.time.week, config.gyro.unit) == (50.0, 2017, "rad")
    file.write_text('like = "kf-gins"\ntime.week = 2017\nrotation = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]\n')
    assert load_imu_config(file).axes is None
    for text, message in (
        ('like = "nothing"', "'like': no such layout"),
        ('like = "kf-gins"', "week' or 'week_column' is needed"),
        ('like = "kf-gins"\ntime.week = 2017\nrate_hx = 3.0', "unknown configuration key; found 'rate_hx'"),
        ('like = "kf-gins"\n[time]\nweek = 2017\nscale = "gps"', "no such choice"),
    ):
        file.write_text(text)
        with pytest.raises(StarwiseError, match=message):
            load_imu_config(file)
    with pytest.raises(StarwiseError, match="no such description"):
        load_imu_config("kf-ginz")


@pytest.mark.real
def test_real_recordings(shared_data: Path) -> None:
    car = read_imu(shared_data / "imu" / "rtklibexplorer_drive_0708" / "imu_1934.csv", "rtklibexplorer-drive")
    assert len(car.t_ns) == 54860
    assert abs(car.accel.mean(axis=0)[2] + G) < 0.1  # m/s^2: scale of a cheap sensor, and a slope
    assert not car.problems
    for name in ("urban-mixed-turns-nominal-001", "parking-lot-figure8-nominal-001"):
        taxi = read_imu(shared_data / "imu" / name / "imu.csv.gz", "generic-replay")
        assert abs(np.linalg.norm(taxi.accel.mean(axis=0)) - G) < 0.2  # m/s^2, likewise
        assert taxi.t_ns[0] < parse_time("2026-01-01T00:00:00")
    still = load_imu_config("seconds-of-week-rates", {"time": {"week": 2200}})
    rest = read_imu(shared_data / "imu" / "toronto_static" / "IMU.txt", still)
    assert (np.diff(rest.t_ns) > 0).all()
    assert [problem.count for problem in rest.problems] == [1]  # one row is tagged before the row above it
