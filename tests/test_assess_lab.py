"""``assess``: the laboratory in one command, its files, and what it says when something is missing."""

import json
import shutil
from pathlib import Path

import pytest

import starwise
import starwise.demo
from starwise.__main__ import main
from starwise.api_assess import PARTS
from starwise.config import load_config

DATA = Path(starwise.demo.__file__).parent / "data"
FILES = (DATA / "demo_MO.rnx.gz", DATA / "demo_MN.rnx.gz")
TRUTH = str(DATA / "demo_truth.csv")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab") / "run"
    starwise.solve(*FILES, dynamics="vehicle", error_model="white", output=folder, report=False)
    return folder


@pytest.fixture
def run(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "run"))


def assess(*options: str) -> int:
    return main(["assess", "--no-report", *options])


def test_all_of_it_on_one_screen_and_in_one_file(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert assess(str(run), "--truth", TRUTH, "--what-if", "altimeter,-doppler,second_antenna") == 0
    text = capsys.readouterr().out
    assert all(len(line) <= 80 for line in text.splitlines())
    for word in ("RMS 3D", "consistency", "observability", "stability", "what if", "altimeter", "now observable: head"):
        assert word in text
    record = json.loads((run / "assess.json").read_text(encoding="utf-8"))
    assert record["reference"] == "truth"
    for name in (*PARTS, "what_if"):
        assert record[name]["verdict"]
    assert record["stability"]["growth_max"] >= 1.0
    assert (
        record["observability"]["windows"][0]["degree_paper"].keys()
        == record["observability"]["windows"][0]["degree"].keys()
    )
    assert [o["change"] for o in record["what_if"]["outcomes"]][:2] == ["altimeter", "-doppler"]
    assert not list(run.glob(".*"))


def test_json_is_what_is_written(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert assess(str(run), "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown == json.loads((run / "assess.json").read_text(encoding="utf-8"))
    assert shown["what_if"] is None
    assert set(PARTS) <= set(shown)


def test_parts_can_be_left_out(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert assess(str(run), "--without", "consistency,stability", "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["consistency"] is None
    assert shown["stability"] is None
    assert shown["observability"]["verdict"]
    (run / "assess.json").unlink()
    assert assess(str(run), "--without", "all") == 0
    assert "observability" not in capsys.readouterr().out


def test_details_elsewhere(run: Path, tmp_path: Path) -> None:
    assert assess(str(run), "-o", str(tmp_path / "there")) == 0
    assert (tmp_path / "there" / "assess.json").is_file()
    assert assess(str(run), "-o", str(tmp_path / "named.json")) == 0
    assert (tmp_path / "named.json").is_file()
    assert not (run / "assess.json").exists()


def test_position_files_have_no_system(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert assess(str(run / "solution.pos"), "--truth", TRUTH, "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["observability"]["verdict"] == "not judged"
    assert "does not say how it was made" in shown["stability"]["explain"]
    assert shown["consistency"]["verdict"]
    assert not list(run.glob("solution.json"))


def test_suggestion_is_a_configuration(tmp_path: Path) -> None:
    """A run that was told noise ten times too large gets a file that solve takes."""
    folder = tmp_path / "loud"
    starwise.solve(
        *FILES, dynamics="vehicle", error_model="white", output=folder, report=False,
        **{"noise.code_m": 40.0, "noise.rate_mps": 10.0},
    )  # fmt: skip
    assert assess(str(folder), "--truth", TRUTH) == 0
    suggestion = folder / "suggested.toml"
    assert suggestion.is_file()
    found = load_config(suggestion)
    assert found.noise.code_m < 40.0
    starwise.solve(*FILES, config=found, report=False)
    named = tmp_path / "mine.toml"
    assert assess(str(folder), "--truth", TRUTH, "--suggest", str(named)) == 0
    assert load_config(named) == load_config(suggestion)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--without", "accuracy"], "--without"),
        (["--what-if", "barometer"], "not a measurement"),
        (["--what-if", "constellation=I"], "satellite"),
        (["-o", "no/such/x.json", "--truth", "none.csv"], "none.csv"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(
    run: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    assert assess(str(run), *options) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (run / "assess.json").exists()


def test_one_solution_at_a_time_for_files(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert assess(str(run), str(run), "-o", "x") == 2
    assert "one at a time" in capsys.readouterr().err


def test_python_api_is_the_same(run: Path) -> None:
    report = starwise.assess(run, TRUTH)
    solution = starwise.read_solution(run)
    assert report["observability"]["verdict"] == starwise.Observability.of(solution).verdict
    assert report["stability"]["verdict"] == starwise.Stability.of(solution).verdict
    assert "explain" in dir(starwise.Consistency)
    assert "consistency" in starwise.assess(solution, parts=())
    assert not (run / "assess.json").exists()
