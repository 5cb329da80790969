"""Commands simulate and reproduce: files, JSON and nothing else, one line for bad scenarios."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import starwise
from starwise.__main__ import main
from starwise.io.rinex_obs import read_obs

SCENARIO = """
seed = 4

[time]
start = "2024-03-30T12:00:00"
duration_s = 20.0

[vehicle]
start = [48.0, 11.0, 500.0]
speed_mps = 10.0

[[vehicle.segments]]
kind = "straight"

[sky]
constellations = ["gps", "galileo"]

[receiver]
signals = { G = ["1C"], E = ["1C"] }

[receiver.noise]
model = "fixed"
code_m = 1.0
rate_mps = 0.1
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "drive.toml"
    path.write_text(SCENARIO)
    return path


def test_files_of_a_run(scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["simulate", str(scenario), "-o", str(out), "--json"]) == 0
    printed = capsys.readouterr()
    record = json.loads(printed.out)
    assert printed.err == ""
    assert json.loads((out / "run.json").read_text()) == record
    assert record["seed"] == 4
    assert record["epochs"] == 21
    for name in record["files"].values():
        assert (out / name).stat().st_size > 0
    assert read_obs(out / record["files"]["observations"]).n_epochs == 21
    solution = starwise.solve(
        out / record["files"]["observations"], out / record["files"]["navigation"], method="lsq",
        error_model="white", ionosphere="none", troposphere="none",
    )  # fmt: skip
    truth = pl.read_parquet(out / record["files"]["truth"])
    off = np.linalg.norm(solution.pos_e - truth.select("pos_x_m", "pos_y_m", "pos_z_m").to_numpy(), axis=1)
    assert off.max() < 10.0  # m: noise of 1 m, worst of 21 epochs, 20 satellites


def test_seed_and_runs(scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["simulate", str(scenario), "--runs", "3", "--method", "all", "--workers", "1", "--json"]
    assert main([*arguments, "-o", str(tmp_path / "a"), "--seed", "7"]) == 0
    assert main([*arguments, "-o", str(tmp_path / "b"), "--seed", "7"]) == 0
    assert main([*arguments, "-o", str(tmp_path / "c"), "--seed", "8"]) == 0
    a, b, c = (pl.read_parquet(tmp_path / name / "montecarlo.parquet") for name in "abc")
    assert a.equals(b)
    assert not a.equals(c)
    assert len(a) == 9
    first = (tmp_path / "a" / "drive_MO.rnx").read_bytes()
    assert first.splitlines()[5:] == (tmp_path / "b" / "drive_MO.rnx").read_bytes().splitlines()[5:]
    assert first.splitlines()[-1] != (tmp_path / "c" / "drive_MO.rnx").read_bytes().splitlines()[-1]
    assert "montecarlo" in capsys.readouterr().out


def test_text_for_people(scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", str(scenario), "-o", str(tmp_path / "out"), "--runs", "2", "--workers", "1"]) == 0
    out = capsys.readouterr().out
    assert "drive_MO.rnx" in out
    assert "2RMS" in out


BAD = [
    ("seed = 4", "sed = 4", "sed"),
    ("code_m = 1.0", "code_m = -1.0", "code_m"),
    ('kind = "straight"', 'kind = "straight"\nradius_m = 3.0\nacceleration_mps2 = -5.0\nspeed_mps = 20.0', "segments"),
    ("signals = {", "mask_deg = 89.9\nsignals = {", "no satellite"),
    ('start = "2024-03-30T12:00:00"', 'start = "yesterday"', "start"),
    ("[sky]", "[sky", "TOML"),
]


@pytest.mark.parametrize(("old", "new", "word"), BAD)
def test_bad_scenarios_are_one_line_and_2(
    old: str, new: str, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(SCENARIO.replace(old, new, 1))
    assert main(["simulate", str(path), "-o", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert word in printed.err


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", "no-such", "-o", "x"],
        ["simulate", "s3ekf-3-turn"],
        ["simulate", "s3ekf-3-turn", "-o", "x", "--runs", "0"],
        ["simulate", "s3ekf-3-turn", "-o", "x", "--seed", "-1"],
        ["simulate", "s3ekf-3-turn", "-o", "x", "--method", "best"],
        ["reproduce", "other"],
        ["reproduce"],
        ["reproduce", "s3ekf", "--data", "/no/such/folder"],
        ["reproduce", "s3ekf", "--seed", "-3"],
    ],
)
def test_bad_arguments(arguments: list[str], capsys: pytest.CaptureFixture[str], monkeypatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1


def test_folder_that_cannot_be_made(scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["simulate", str(scenario), "-o", str(tmp_path / "file")]) == 2
    assert main(["reproduce", "s3ekf", "-o", str(tmp_path / "file" / "x"), "--runs", "1"]) == 2
    assert capsys.readouterr().err.count("\n") == 2


def test_reproduce_prints_one_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["reproduce", "s3ekf", "-o", str(tmp_path), "--runs", "2", "--seed", "3", "--workers", "1"]
    assert main([*arguments, "--json", "--data", str(tmp_path)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["settings"]["seeds"] == [3, 3, 3, 3]
    assert result == json.loads((tmp_path / "reproduce.json").read_text())
