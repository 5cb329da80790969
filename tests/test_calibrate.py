"""Command ``calibrate``: judges a list of measurements, and says in one line what is wrong with it."""

import json
from pathlib import Path

import pytest

import starwise.demo
from starwise.__main__ import main

DATA = Path(starwise.demo.__file__).parent / "data"
SET = f"""[[set]]
name = "demo"
observations = "{(DATA / "demo_MO.rnx.gz").as_posix()}"
navigation = ["{(DATA / "demo_MN.rnx.gz").as_posix()}"]
truth = "{(DATA / "demo_truth.csv").as_posix()}"
dynamics = ["vehicle"]
combination = ["single"]
"""


def run(tmp_path: Path, text: str, *options: str) -> int:
    path = tmp_path / "sets.toml"
    path.write_text(text, encoding="utf-8")
    return main(["calibrate", str(path), "--rounds", "0", "--no-folds", *options])


def test_a_set_is_judged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "errors.toml"
    assert run(tmp_path, SET, "--json", "-o", str(output)) == 0
    result = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in result["sets"]] == ["demo, L1"]
    assert result["changed"] == {}
    assert result["score_after"] == result["score_before"]
    assert result["pooled"]["rms_3d_m"] == pytest.approx(result["sets"][0]["rms_3d_m"], rel=1e-12)
    assert "slow_tau_s = 3600.0" in output.read_text(encoding="utf-8")
    assert run(tmp_path, SET) == 0
    text = capsys.readouterr().out
    assert ", as before" in text
    assert all(len(line) <= 80 for line in text.splitlines())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no measurements to calibrate on; wanted [[set]] tables"),
        (SET.replace("dynamics", "motion"), "unknown configuration key; found 'set[1].motion'"),
        (SET.replace("demo_MO", "none"), "cannot be read"),
        (SET.replace("truth =", "#"), "'set[1].truth' is missing"),
        (SET.replace("demo_truth", "none"), "no such truth"),
        (SET.replace((DATA / "demo_truth.csv").as_posix(), "0.0,0.0,6356752.0"), "the truth is not where"),
        (SET.replace('["vehicle"]', "[]"), "'set[1].dynamics' of set 'demo' is empty"),
        (SET.replace('["vehicle"]', '"vehicle"'), "'set[1].dynamics' is a list; found 'vehicle'; wanted ['vehicle']?"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    assert run(tmp_path, text) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_where_nothing_can_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, SET, "-o", str(tmp_path / "none" / "errors.toml")) == 2
    assert "no such folder" in capsys.readouterr().err
