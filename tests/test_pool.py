"""Pooled sessions: every session counts the same, filters start anew, and the command line says what was found."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import starwise
import starwise.demo
from handmade import HERE, T0, handmade_solution
from starwise.__main__ import main
from starwise.analysis.pool import Run, pool
from starwise.config import RunConfig
from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.estimators.sessions import joined
from starwise.frames import C_ne_enu, geodetic_from_ecef
from starwise.gnsstime import parse_duration, session_numbers
from starwise.io.results import write_results
from starwise.report.text import pool_text
from starwise.types import Solution, Truth

DATA = Path(starwise.demo.__file__).parent / "data"
FILES = (DATA / "demo_MO.rnx.gz", DATA / "demo_MN.rnx.gz")


def off_by(error_enu: tuple[float, float, float], n: int, step_s: int = 1) -> Solution:
    """A solution with one error, m, in all epochs, and the covariance of 1 m^2 per axis."""
    lat, lon, _ = geodetic_from_ecef(HERE)
    base = handmade_solution(max(n, 1), step_ns=step_s * NS)
    return replace(
        base,
        status=np.zeros(n, dtype=np.uint8),
        pos_e=HERE + np.tile(error_enu, (n, 1)) @ C_ne_enu(lat, lon),
        cov_pos=np.tile(np.eye(3), (n, 1, 1)),
    )


@pytest.mark.parametrize(
    ("seconds", "wanted"),
    [
        ([0, 30, 60, 90, 119], [0, 0, 1, 1, 1]),
        ([0, 30, 60, 61, 89], [0, 0, 0, 0, 0]),  # a rest of less than half a session is no session
        ([0, 30, 60, 90], [0, 0, 1, 1]),
        ([7, 67, 187, 277], [0, 1, 3, 4]),  # from the first epoch on; an empty one in the middle
        ([5], [0]),
        ([], []),
    ],
)
def test_sessions_of_a_minute(seconds: list[int], wanted: list[int]) -> None:
    t_ns = T0 + np.array(seconds, dtype=np.int64) * NS
    assert session_numbers(t_ns, 60.0).tolist() == wanted


@pytest.mark.parametrize(
    ("text", "seconds"), [("2h", 7200), ("90min", 5400), ("1.5 h", 5400), ("30", 30), ("1d", 86400)]
)
def test_durations(text: str, seconds: float) -> None:
    assert parse_duration(text) == seconds


@pytest.mark.parametrize("text", ["", "h", "0", "-2h", "2 hours", "nan", "1e9999"])
def test_what_is_no_duration(text: str) -> None:
    with pytest.raises(StarwiseError, match="not a length of time"):
        parse_duration(text)


def test_sessions_count_the_same_whatever_their_rate() -> None:
    """A good hour of 3600 epochs and a bad one of 120: half of the pooled sample is bad."""
    record = pool(
        [Run("good", off_by((0.1, 0.0, 0.0), 3600), Truth(HERE)), Run("bad", off_by((0, 6.0, 0), 120, 30), Truth(HERE))]
    )
    assert (record["sessions"], record["epochs_compared"]) == (2, 3720)
    assert [record[f"coverage_{p}"] for p in (50, 68, 95)] == [0.5, 0.5, 0.5]
    # 0.01 and 36 m^2 over 1 m^2 per axis, divided by 3 degrees of freedom; ECEF numbers round at 1e-9 m
    assert record["nees_mean"] == pytest.approx((0.01 / 3 + 36 / 3) / 2, abs=1e-6)
    assert record["rms_3d_m"] == pytest.approx(np.sqrt((0.01 + 36) / 2), abs=1e-6)
    assert record["sigma_3d_mean_m"] == pytest.approx(np.sqrt(3.0))
    assert record["calibration"]["vertical"] == [1.0, 1.0, 1.0]
    assert record["calibration"]["horizontal"] == [0.5, 0.5, 0.5]
    assert [run["coverage_95"] for run in record["runs"]] == [1.0, 0.0]
    text = pool_text(record)
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "all sessions" in text


def test_a_run_has_the_sessions_that_it_was_made_with() -> None:
    solution = off_by((0.0, 0.0, 0.0), 600)
    made = replace(solution, provenance={"config": RunConfig(session_s=100.0).to_dict()})
    assert pool([Run("", made, Truth(HERE))])["sessions"] == 6
    assert pool([Run("", solution, Truth(HERE))])["sessions"] == 1
    assert pool([Run("", solution, Truth(HERE))], session_s=200.0)["sessions"] == 3


def test_heights_that_are_not_comparable_count_horizontally() -> None:
    record = pool([Run("", off_by((0.0, 0.0, 40.0), 10), Truth(HERE), vertical=False)])
    assert record["coverage_95"] is None
    assert record["rms_3d_m"] is None
    assert record["calibration"]["horizontal"] == [1.0, 1.0, 1.0]
    assert "-" in pool_text(record)


def test_nothing_to_pool_is_an_error() -> None:
    with pytest.raises(StarwiseError, match="nothing to pool"):
        pool([])
    late = Truth(HERE[None], np.array([T0 + 10**6 * NS]))
    with pytest.raises(StarwiseError, match="no epoch with both"):
        pool([Run("a", off_by((0, 0, 0), 5), late)])
    with pytest.raises(StarwiseError, match="pooling needs the truth"):
        starwise.pool(off_by((0, 0, 0), 5))


@pytest.mark.laws
def test_a_session_is_the_run_of_its_time() -> None:
    """Sessions have nothing in common: each is bit for bit the run of its own epochs."""
    config = RunConfig(method="s3ekf", dynamics="vehicle", interval_s=10.0)
    whole = starwise.solve(*FILES, config=config)
    cut = starwise.solve(*FILES, config=config.with_options({"session_s": 300.0}))
    assert (cut.t_ns == whole.t_ns).all()
    assert len(cut.ledger["t_ns"]) == len(whole.ledger["t_ns"])
    number = session_numbers(cut.t_ns, 300.0)
    assert number[-1] >= 1
    assert any("sessions of 300 s" in note for note in cut.provenance["notes"])
    first = number == 0
    np.testing.assert_array_equal(cut.pos_e[first], whole.pos_e[first])
    assert np.abs(cut.pos_e[~first] - whole.pos_e[~first]).max() > 1e-6  # m: the filter was started anew
    second = obs_of_second(config, cut, number)
    np.testing.assert_array_equal(cut.pos_e[number == 1], second.pos_e)


def obs_of_second(config: RunConfig, cut: Solution, number: np.ndarray) -> Solution:
    from starwise.estimators.run import solve_run
    from starwise.io.rinex_nav import read_nav
    from starwise.io.rinex_obs import read_obs
    from starwise.physics.broadcast import BroadcastEphemeris

    obs, nav = read_obs(FILES[0]), read_nav(FILES[1])
    t = cut.t_ns[number == 1]
    mine = obs.between(int(t[0]), int(t[-1]), config.interval_s)
    return solve_run(mine, BroadcastEphemeris(nav), nav.ionosphere, config.with_options({"interval_s": None}))


def test_clocks_of_sessions_are_joined_by_name() -> None:
    a, b = off_by((0, 0, 0), 3), replace(off_by((0, 0, 0), 2), clock_names=("E", "R"))
    whole = joined([a, b])
    assert whole.clock_names == ("G", "E", "R")
    np.testing.assert_array_equal(whole.clock_m[:3, :2], a.clock_m)
    np.testing.assert_array_equal(whole.clock_m[3:, 1:], b.clock_m)
    assert np.isnan(whole.clock_m[:3, 2]).all()
    assert np.isnan(whole.clock_m[3:, 0]).all()


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here = ",".join(f"{v:.4f}" for v in HERE)
    there = ",".join(f"{v:.4f}" for v in HERE + 500.0)
    for name in ("one", "two=2"):
        write_results(off_by((0.0, 0.0, 0.0), 20), tmp_path / name)
    arguments = ["assess", "--pool", str(tmp_path / "one"), str(tmp_path / "two=2"), "--truth", here]
    assert main([*arguments, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["sessions"], record["coverage_95"]) == (2, 1.0)
    assert main([*arguments[:2], f"{tmp_path / 'one'}={there}", *arguments[3:], "--json", "--sessions", "10s"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert [run["coverage_95"] for run in record["runs"]] == [0.0, 1.0]
    assert record["sessions"] == 4
    assert main(arguments) == 0
    assert "nominal" in capsys.readouterr().out
    assert main(["assess", str(tmp_path / "one"), "--pool"]) == 2
    assert "DIR=TRUTH" in capsys.readouterr().err
    assert main(["assess", str(tmp_path / "one"), "--sessions", "2h"]) == 2
    assert "--pool" in capsys.readouterr().err
    assert main(["solve", *map(str, FILES), "-o", str(tmp_path / "x"), "--sessions", "2 fortnights"]) == 2
    assert "length of time" in capsys.readouterr().err
