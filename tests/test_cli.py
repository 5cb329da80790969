"""Command line: exit codes, one-line errors, JSON and nothing else, and the whole job on the data of the demo."""

import json
import os
import subprocess
import sys
import time
from importlib import resources
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import starwise
from handmade import HERE, handmade_solution
from starwise import cli
from starwise.__main__ import main
from starwise.io.results import RESULT_FILES, write_results

DATA = Path(str(resources.files("starwise.demo"))) / "data"
OBS, NAV, TRUTH = DATA / "demo_MO.rnx.gz", DATA / "demo_MN.rnx.gz", DATA / "demo_truth.csv"
SHORT = ["--end", "2026-03-21T12:21:30", "--method", "lsq"]


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "starwise", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("solved") / "out"
    assert main(["solve", str(OBS), str(NAV), "-o", str(folder), "-q", *SHORT]) == 0
    return folder


def test_version_is_quick() -> None:
    times = []
    for _ in range(3):
        began = time.perf_counter()
        done = run("--version")
        times.append(time.perf_counter() - began)
        assert done.returncode == 0
        assert done.stdout == f"starwise {starwise.__version__}\n"
    assert min(times) < 0.3, times


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; from starwise.__main__ import main; main(['solve', '--help']); "
        "print([m for m in ('numpy', 'numba', 'polars', 'scipy', 'hatanaka') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "--ephemeris" in done.stdout
    assert done.stdout.strip().endswith("[]")


def test_import_is_lazy_and_complete() -> None:
    code = "import sys, starwise; print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
    for name in starwise.__all__:
        assert getattr(starwise, name) is not None
    with pytest.raises(AttributeError):
        starwise.nothing  # noqa: B018


def test_whole_job(solved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sorted(p.name for p in solved.iterdir()) == sorted([*RESULT_FILES, "report.html"])
    record = json.loads((solved / "run.json").read_text())
    assert record["config"]["method"] == "lsq"
    assert record["effective"]["process"]["model"] == "singer"
    assert record["effective"]["signals"]["G"][0] == "1C"
    assert {item["kind"] for item in record["inputs"]} == {"observations", "navigation"}
    assert all(len(item["sha256"]) == 64 for item in record["inputs"])
    assert record["summary"]["epochs_solved"] == record["summary"]["epochs"] == 90
    table = pl.read_parquet(solved / "solution.parquet")
    assert table.height == 90
    ledger = pl.read_parquet(solved / "ledger.parquet")
    assert set(ledger["status"].unique()) >= {"used", "low_elevation"}
    assert capsys.readouterr().out == ""
    assert main(["assess", str(solved), "--truth", str(TRUTH), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["epochs_compared"] == 90
    assert report["rms_3d_m"] < 5.0  # ionosphere wrong by a quarter, code noise below 1 m


def test_ledger_terms_open_every_used_row(solved: Path) -> None:
    rows = pl.read_parquet(solved / "ledger.parquet").filter(pl.col("status") == "used")
    model = (
        rows["geometric_m"]
        + rows["sagnac_m"]
        + rows["receiver_clock_m"]
        - rows["satellite_clock_m"]
        + rows["group_delay_m"].fill_null(0.0)
        + rows["troposphere_m"]
        + rows["ionosphere_m"]
        + rows["innovation_m"]
    )
    # numbers of 3e7 m: rounding of each term is 4e-9 m
    assert float((rows["code_m"] - model).abs().max()) < 1e-7


def test_api_is_the_same_job(solved: Path) -> None:
    solution = starwise.solve(OBS, NAV, method="lsq", end="2026-03-21T12:21:30")
    written = starwise.read_solution(solved)
    np.testing.assert_array_equal(solution.pos_e, written.pos_e)
    assert solution.provenance["summary"] == written.provenance["summary"]


def test_order_of_files_does_not_matter(solved: Path, tmp_path: Path) -> None:
    assert main(["solve", str(NAV), str(OBS), "-o", str(tmp_path), "-q", *SHORT]) == 0
    for name in ("solution.pos", "solution.parquet"):
        assert (tmp_path / name).read_bytes() == (solved / name).read_bytes()


def test_screen_is_80_columns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", str(OBS), str(NAV), "-o", str(tmp_path / "o"), *SHORT]) == 0
    assert main(["assess", str(tmp_path / "o"), "--truth", str(TRUTH)]) == 0
    assert main(["info", str(OBS), str(NAV), str(tmp_path / "o")]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "GPS" in out
    for line in out.splitlines():
        assert len(line) <= 80 or str(tmp_path) in line or str(DATA) in line, line


def test_json_is_one_object_and_nothing_else(tmp_path: Path) -> None:
    done = run("solve", OBS, NAV, "-o", tmp_path, "--json", *SHORT)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["summary"]["epochs"] == 90
    assert done.stderr == ""
    done = run("info", OBS, "--json")
    assert json.loads(done.stdout)["kind"] == "rinex_obs"
    done = run("info", OBS, NAV, "--json")
    assert set(json.loads(done.stdout)) == {str(OBS), str(NAV)}


def test_options_override_the_file(tmp_path: Path) -> None:
    toml = tmp_path / "run.toml"
    toml.write_text('method = "ekf"\nmask_deg = 25\nsystems = "G"\n')
    out = tmp_path / "out"
    code = main(
        ["solve", str(OBS), str(NAV), "-o", str(out), "-q", "--config", str(toml), "--set", "fde=false", *SHORT]
    )
    assert code == 0
    config = json.loads((out / "run.json").read_text())["config"]
    assert (config["method"], config["mask_deg"], config["systems"], config["fde"]) == ("lsq", 25.0, "G", False)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["solv"], "solve"),
        (["solve"], "Missing"),
        (["solve", OBS, NAV, "-o", "out", "--mehod", "lsq"], "--method"),
        (["solve", OBS, NAV, "-o", "out", "--mask", "high"], "mask"),
        (["solve", OBS, NAV, "-o", "out", "--mask", "99"], "-5 to 90"),
        (["solve", OBS, NAV, "-o", "out", "--method", "best"], "lsq | ekf | s3ekf"),
        (["solve", OBS, NAV, "-o", "out", "--set", "mask=3"], "'mask_deg'?"),
        (["solve", OBS, NAV, "-o", "out", "--start", "2020-01-01T00:00:00Z", "--end", "2020-01-02"], ""),
        (["solve", OBS, "-o", "out"], "no ephemeris"),
        (["solve", NAV, "-o", "out"], "no observations"),
        (["solve", OBS, NAV, "-o", "out", "--ephemeris", NAV], "SP3"),
        (["solve", "nowhere.rnx", NAV, "-o", "out"], "nowhere.rnx: cannot be read"),
        (["solve", TRUTH, NAV, "-o", "out"], "not a file that a solution can be made from"),
        (["solve", OBS, NAV, "-o", "out", "--config", "nowhere.toml"], "nowhere.toml: cannot be read"),
        (["assess", "nowhere"], "nowhere: no such file"),
        (["assess", OBS], "demo_MO.rnx.gz"),
        (["info", TRUTH], "not a known kind"),
        (["demo", "--fast"], "--fast"),
    ],
)
def test_bad_arguments_are_one_line_and_2(
    arguments: list[object],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    code = main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    assert code == 2
    assert out == ""
    assert err.startswith("starwise: error: ")
    assert err.count("\n") == 1, err
    assert words in err
    assert not (tmp_path / "out" / "run.json").exists()


def test_control_characters_do_not_reach_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.pos"
    path.write_bytes(b"2190 518400.000 \x1b[31mred\x07 1 2 3\n")
    assert main(["assess", str(path)]) == 2
    err = capsys.readouterr().err
    assert "\x1b" not in err
    assert "\x07" not in err


def test_defect_is_told_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr("starwise.api.info", broken)
    monkeypatch.delenv("STARWISE_DEBUG", raising=False)
    assert main(["info", "x"]) == 1
    err = capsys.readouterr().err
    assert "ZeroDivisionError" in err
    assert "Traceback" not in err
    monkeypatch.setenv("STARWISE_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        main(["info", "x"])


def test_interrupt(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(*_: object, **__: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "run", interrupted)
    assert main(["info", "x"]) == 130


@pytest.mark.skipif(os.name == "nt", reason="pipes of another kind")
def test_reader_that_goes_away(tmp_path: Path) -> None:
    write_results(handmade_solution(50), tmp_path)
    command = f"{sys.executable} -m starwise info {tmp_path} --json | true"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.stderr == ""


def test_assess_of_typed_truth_with_a_leading_minus(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_results(handmade_solution(50, centre=-HERE), tmp_path)
    where = ",".join(str(v) for v in -HERE)
    assert main(["assess", str(tmp_path), "--truth", where, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rms_3d_m"] < 20.0


@pytest.mark.slow
def test_demo(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    done = run("demo", "-o", folder)
    assert done.returncode == 0, done.stderr
    assert "report.html" in done.stdout
    assert max(len(line) for line in done.stdout.splitlines() if str(tmp_path) not in line) <= 80
    assert (folder / "report.html").stat().st_size > 100_000  # bytes: nothing is fetched, so all of it is inside
    truth = folder / "simulated" / "urban-drive_truth.csv"
    lsq, filtered = (starwise.assess(folder / method, truth) for method in ("lsq", "s3ekf"))
    # 601 epochs, 24 of them in the tunnel: least squares has nothing there, the filter coasts and says so.
    assert lsq["epochs_solved"] == 577
    assert filtered["epochs_solved"] == 601
    assert filtered["epochs_flagged"] >= 24
    # In the canyon a reflection of 35 m is believed by least squares (23 m over all) and refused by the filter (2.4 m);
    # the limit leaves the filter twice that.
    assert filtered["rms_3d_m"] < min(5.0, lsq["rms_3d_m"])
    # E01 drifts away at 0.5 m/s from 230 to 350 s; 30 s later the error is 15 m, and the filter uses it no more.
    ledger = pl.read_parquet(folder / "s3ekf" / "ledger.parquet")
    since_s = (pl.col("t_gpst_ns") - ledger["t_gpst_ns"].min()) / 1e9
    lying = ledger.filter(pl.col("sv").cast(pl.String) == "E01", since_s.is_between(260.0, 349.0))
    assert len(lying) > 0
    assert not (lying["status"].cast(pl.String) == "used").any()
