"""Scenario files: what is shipped, what is refused and how, and random streams by name."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from starwise.errors import StarwiseError
from starwise.gnsstime import iso
from starwise.sim.scenario import Scenario, load_scenario, shipped
from starwise.sim.seeds import streams

PAPER = ("s3ekf-1-static", "s3ekf-2-steps", "s3ekf-3-turn", "s3ekf-4-climb-dive")

GOOD = """\
seed = 7

[time]
start = "2024-03-30T12:00:00"
duration_s = 60.0
interval_s = 0.5

[vehicle]
start = [48.0, 11.0, 500.0]
speed_mps = 10.0

[[vehicle.segments]]
kind = "straight"
duration_s = 30.0

[[vehicle.segments]]
kind = "turn"
radius_m = 50.0
angle_deg = 90.0

[[vehicle.segments]]
kind = "straight"

[sky]
constellations = ["gps"]

[receiver]
azimuth_masks_deg = [[10.0, 60.0, 40.0]]

[receiver.noise]
code_m = 1.0

[imu]
grade = "industrial"

[[faults]]
kind = "outage"
satellites = ["G05"]
start_s = 10.0
duration_s = 5.0

[[faults]]
kind = "step"
size = 100.0
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "test.toml"
    path.write_text(text)
    return path


def test_good_scenario(tmp_path: Path) -> None:
    made = load_scenario(written(tmp_path, GOOD))
    assert made.name == "test"
    assert len(made.t_ns) == 121
    assert iso(int(made.t_ns[-1])) == "2024-03-30T12:01:00.000"
    assert made.imu is not None
    assert made.imu.grade == "industrial"
    assert [fault.kind for fault in made.faults] == ["outage", "step"]
    np.testing.assert_array_equal(made.faults[0].active(np.array([9.9, 10.0, 14.9, 15.0])), [False, True, True, False])
    assert Scenario.from_dict(made.to_dict()) == made


def test_options_override(tmp_path: Path) -> None:
    made = load_scenario(written(tmp_path, GOOD), {"receiver.mask_deg": 15.0, "seed": 8, "time.duration_s": 30.0})
    assert (made.receiver.mask_deg, made.seed, made.time.duration_s) == (15.0, 8, 30.0)
    with pytest.raises(StarwiseError, match=r"unknown configuration key; found 'receiver\.mask'"):
        load_scenario(written(tmp_path, GOOD), {"receiver.mask": 15.0})


@pytest.mark.parametrize("name", PAPER)
def test_scenarios_of_the_paper(name: str) -> None:
    made = load_scenario(name)
    assert made.name == name
    assert made.sky.constellations == ("gps", "beidou2")
    assert (made.receiver.mask_deg, made.time.interval_s) == (5.0, 1.0)
    noise = made.receiver.noise
    assert (noise.model, noise.code_m, noise.rate_mps) == ("fixed", 6.0, 0.1)
    speed = np.linalg.norm(made.trajectory.states(made.t_ns).vel_e, axis=1)
    assert speed.max() == pytest.approx(0.0 if "static" in name else 300.0, abs=1e-9)
    if name == "s3ekf-2-steps":
        acceleration = np.linalg.norm(made.trajectory.states(made.t_ns).acc_e, axis=1)
        assert acceleration.max() == pytest.approx(20.0, abs=1e-3)  # m/s^2; following the Earth adds in square


def test_shipped_scenarios_all_load() -> None:
    assert set(PAPER) <= set(shipped())
    for name in shipped():
        load_scenario(name)
    with pytest.raises(StarwiseError, match=r"no such scenario; found 's3ekf'; wanted a file, or one of .*s3ekf-1"):
        load_scenario("s3ekf")


REFUSED = [
    ("seed = 7", "sed = 7", ":1: unknown configuration key; found 'sed'; wanted 'seed'?"),
    ("seed = 7", "seed = -7", ":1: 'seed' is outside its limits; found '-7'; wanted a number from 0"),
    ("seed = 7", "seed = 7.5", ":1: 'seed' has the wrong type; found '7.5'; wanted a whole number"),
    ("[sky]", "[skies]", ":24: unknown configuration key; found 'skies'; wanted 'sky'?"),
    ("duration_s = 60.0", "", ":3: 'time.duration_s' is missing"),
    ("duration_s = 60.0", "duration_s = 0", ":5: 'time.duration_s' is outside its limits"),
    ('"2024-03-30T12:00:00"', '"yesterday"', ":4: 'time.start' is not a time; found 'yesterday'"),
    ("radius_m = 50.0", "radius_m = -50.0", ":18: 'vehicle.segments[2].radius_m' is outside its limits; found '-50.0'"),
    ("radius_m = 50.0", "radios_m = 50.0", ":18: unknown configuration key; found 'vehicle.segments[2].radios_m'"),
    ('kind = "turn"', 'kind = "loop"', ":17: 'vehicle.segments[2].kind' has no such choice; found 'loop'"),
    ('kind = "turn"', "", ":16: 'vehicle.segments[2].kind' is missing; wanted static | straight | turn"),
    ("angle_deg = 90.0", "", ":16: 'vehicle.segments[2].angle_deg' is missing"),
    ("angle_deg = 90.0", "angle_deg = 0", ":19: 'vehicle.segments[2].angle_deg' turns by nothing"),
    ("speed_mps = 10.0", "", ":16: 'vehicle.segments[2]' needs speed and the vehicle stands still"),
    ("[48.0, 11.0, 500.0]", "[98.0, 11.0, 500.0]", ":9: 'vehicle.start' is not a place"),
    ("code_m = 1.0", "code_m = -1.0", ":31: 'receiver.noise.code_m' is outside its limits; found '-1.0'"),
    ('["gps"]', '["gbs"]', ":25: 'sky.constellations' has no such choice; found 'gbs'; wanted gps | glonass"),
    ('["gps"]', "[]", ":25: 'sky.constellations' is empty"),
    ("[[10.0, 60.0, 40.0]]", "[[10.0, 60.0]]", ":28: 'receiver.azimuth_masks_deg' has one that is none"),
    ('"industrial"', '"cheap"', ":34: 'imu.grade' has no such choice; found 'cheap'"),
    ('["G05"]', '["X05"]', ":38: 'faults[1].satellites' is not a satellite; found 'X05'"),
    ("size = 100.0", "", ":42: 'faults[2].size' of a step is missing"),
    ("size = 100.0", 'kind = "twice"', ":44: not TOML: Cannot overwrite a value"),
    ("duration_s = 5.0", "duration_s = -5.0", ":40: 'faults[1].duration_s' is outside its limits"),
]


@pytest.mark.parametrize(("old", "new", "message"), REFUSED)
def test_bad_scenarios_get_one_clear_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert GOOD.count(old) == 1 or old == 'kind = "turn"'
    path = written(tmp_path, GOOD.replace(old, new))
    with pytest.raises(StarwiseError) as caught:
        load_scenario(path)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}{message}"), text


def test_recorded_vehicle(tmp_path: Path) -> None:
    rows = [f"{t},48.0,{11.0 + 1e-5 * t},500.0" for t in range(0, 70)]
    (tmp_path / "drive.csv").write_text("\n".join(["t_s,lat_deg,lon_deg,height_m", *rows]))
    start, end = GOOD.index("start = [48"), GOOD.index("[sky]")
    text = GOOD[:start] + 'recorded = "drive.csv"\n\n' + GOOD[end:]
    made = load_scenario(written(tmp_path, text))
    speed = np.linalg.norm(made.trajectory.states(made.t_ns).vel_e, axis=1)
    np.testing.assert_allclose(speed, speed[0], atol=1e-5)
    with pytest.raises(
        StarwiseError, match=r":9: 'vehicle.recorded' does not cover .*; found '0 to 69 s'; wanted 0 to 70 s"
    ):
        load_scenario(written(tmp_path, text.replace("duration_s = 60.0", "duration_s = 70.0")))


def draws(name: str, seed: int = 1, run: int = 0) -> Any:
    return streams(seed, run)(name).standard_normal(100_000)


@pytest.mark.laws
def test_streams_are_independent_and_repeatable() -> None:
    np.testing.assert_array_equal(draws("clock"), draws("clock"))
    one = draws("clock")
    for other in (draws("code/G05/1C"), draws("clock", seed=2), draws("clock", run=1), draws("clock ")):
        assert abs(np.corrcoef(one, other)[0, 1]) < 5.0 / np.sqrt(100_000)
    with pytest.raises(ValueError, match="must not be negative"):
        streams(-1)


def test_streams_are_the_same_in_another_process() -> None:
    code = "from starwise.sim.seeds import streams; print(streams(3, 2)['code/G05/1C'].integers(1 << 62))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert int(out) == streams(3, 2)["code/G05/1C"].integers(1 << 62)
