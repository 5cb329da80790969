"""``solve --imu`` from files to files: fixes (loose), satellites (loose, tight), and options that do not fit."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from starwise.cli import run
from starwise.errors import StarwiseError
from starwise.io.results import read_solution
from starwise.sim.scenario import Scenario

TURN = {"kind": "turn", "radius_m": 15.0, "angle_deg": 90.0, "roll_in_s": 1.0}
FILTER = """
[inertial]
lever_arm_m = [0.5, 0.0, -1.0]
gyro = {white_dprh = 0.3, bias_dph = 360.0, in_run_dph = 6.0, vibration = 0.0}
accel = {white_mpsrh = 0.05, bias_ug = 1000.0, in_run_ug = 20.0, vibration = 0.0}
"""


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of a simulated drive of 80 s."""
    from starwise.sim.run import simulate
    from starwise.sim.writers import write_files

    folder = tmp_path_factory.mktemp("drive")
    start = {"kind": "straight", "speed_mps": 9.0, "duration_s": 8.0, "smooth": True}
    block = {"kind": "straight", "distance_m": 60.0}
    ways = [{"kind": "static", "duration_s": 6.0}, start, block, TURN, block, {**TURN, "angle_deg": -90.0}, block]
    scenario = Scenario.from_dict(
        {
            "name": "drive", "time": {"start": "2024-03-30T12:00:00", "duration_s": 80.0},
            "vehicle": {"start": [48.1, 11.5, 560.0], "heading_deg": 40.0, "segments": [*ways, {"kind": "straight"}]},
            "receiver": {"lever_arm_m": [0.5, 0.0, -1.0]},
            "imu": {"grade": "industrial", "rate_hz": 50.0},
            "output": {"truth": "csv"},
        }
    )  # fmt: skip
    write_files(simulate(scenario), folder)
    (folder / "imu.toml").write_text('like = "starwise-increments"\nrate_hz = 50.0\n' + FILTER)
    return folder


def files(drive: Path) -> dict[str, Path]:
    named = {"obs": next(p for p in drive.glob("*.rnx") if "MO" in p.name)}
    named["nav"] = next(p for p in drive.glob("*.rnx") if "MN" in p.name)
    named["imu"] = next(p for p in drive.glob("*imu*.csv"))
    return named


def solved(drive: Path, out: Path, *options: str) -> Any:
    f = files(drive)
    code = run(
        ["solve", *options, "--imu", str(f["imu"]), "--imu-config", str(drive / "imu.toml"), "-o", str(out), "-q"]
    )
    assert code == 0
    return read_solution(out)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["loose", "tight"])
def test_satellites_and_readings_give_attitude(drive: Path, tmp_path: Path, method: str) -> None:
    f = files(drive)
    solution = solved(drive, tmp_path / method, str(f["obs"]), str(f["nav"]), "--method", method)
    assert solution.n_epochs > 50
    assert np.isfinite(solution.extra["yaw_deg"]).all()
    assert solution.extra["sigma_yaw_deg"][-1] < 2.0  # deg
    assert solution.extra["sigma_gyro_bias_z_dph"][-1] < 300.0
    record = json.loads((tmp_path / method / "run.json").read_text())
    assert record["config"]["method"] == method
    assert record["config"]["inertial"]["lever_arm_m"] == [0.5, 0.0, -1.0]
    assert record["summary"]["final"]["yaw_deg"] == pytest.approx(solution.extra["yaw_deg"][-1], abs=1e-5)
    if method == "tight":
        assert (solution.n_used[1:] > 5).all()
        assert solution.clock_names[0] == "G"
        assert (solution.ledger["status"] == 0).sum() > 1000
    # fixes of another solution
    again = solved(drive, tmp_path / "fixes", "--fixes", str(tmp_path / method / "solution.pos"))
    apart = np.linalg.norm(again.pos_e[-10:] - solution.pos_e[-10:], axis=1)
    assert apart.max() < 2.0  # m: filtered once more


def test_options_that_do_not_fit_are_one_line(drive: Path, tmp_path: Path) -> None:
    f = files(drive)
    imu = ["--imu", str(f["imu"])]
    described = [*imu, "--imu-config", str(drive / "imu.toml")]
    out = ["-o", str(tmp_path / "out")]
    for given, message in (
        ([*imu, *out, "--fixes", "x.pos"], "--imu wants --imu-config"),
        (["--fixes", "x.pos", *out], "want --imu"),
        ([*described, *out], "want something to aid them"),
        ([*described, *out, "--fixes", str(tmp_path / "none.pos")], "no such file"),
        ([*described, *out, "--fixes", str(f["imu"]), "--method", "tight"], "tight coupling wants satellites"),
        ([*described, *out, "--fixes", str(f["imu"]), "--method", "ekf"], "'method' has no such choice"),
        ([*described, *out, "--fixes", str(f["imu"]), "--mask", "5"], "fixes have no use for"),
        ([*described, *out, "--fixes", str(f["imu"]), "--set", "inertial.lever=1"], "unknown configuration key"),
        (out, "no files to solve"),
    ):
        with pytest.raises(StarwiseError, match=message) as caught:
            run(["solve", *given])
        assert "\n" not in str(caught.value)


def test_an_error_in_the_inertial_table_has_its_line(drive: Path, tmp_path: Path) -> None:
    text = (drive / "imu.toml").read_text() + "\n[inertial.vehicle]\naxle_sigma = 3.0\n"
    (tmp_path / "bad.toml").write_text(text)
    f = files(drive)
    with pytest.raises(StarwiseError, match=r"bad.toml:\d+: unknown configuration key.*axle_sigma_m"):
        run(["solve", "--imu", str(f["imu"]), "--imu-config", str(tmp_path / "bad.toml"), "--fixes", "x", "-o", "y"])
