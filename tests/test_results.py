"""Result files: what is written is what is read; nothing half-written, nothing foreign overwritten."""

import json
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from handmade import handmade_solution
from starwise.errors import StarwiseError
from starwise.io import results
from starwise.io.results import RESULT_FILES, ledger_table, read_solution, solution_table, write_results
from starwise.types import Solution


def assert_same(a: Solution, b: Solution) -> None:
    for item in fields(Solution):
        left, right = getattr(a, item.name), getattr(b, item.name)
        if isinstance(left, np.ndarray):
            np.testing.assert_allclose(left, right, rtol=1e-15, atol=0, err_msg=item.name)
            assert left.dtype == right.dtype, item.name
        elif item.name == "ledger":
            assert left.keys() == right.keys()
            for key in left:
                assert left[key].dtype == right[key].dtype, key
                np.testing.assert_allclose(left[key], right[key], rtol=1e-15, atol=0, err_msg=key)
        else:
            assert left == right, item.name


def test_round_trip(tmp_path: Path) -> None:
    solution = handmade_solution()
    paths = write_results(solution, tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted(RESULT_FILES)
    assert set(paths) == set(RESULT_FILES)
    assert_same(solution, read_solution(tmp_path / "out"))
    alone = read_solution(tmp_path / "out" / "solution.parquet")
    np.testing.assert_array_equal(alone.pos_e, solution.pos_e)
    from_pos = read_solution(tmp_path / "out" / "solution.pos")
    assert from_pos.n_epochs == solution.n_epochs - 1  # the epoch without a position is not in a .pos file


def test_tables_have_names_and_nulls() -> None:
    solution = handmade_solution()
    table = solution_table(solution)
    assert table["status"].to_list()[2:7] == ["ok", "none", "coasted", "suspect", "reset"]
    assert table["x_m"].null_count() == 1
    assert table["x_m"].is_nan().sum() == 0
    assert str(table["gpst"][0]) == "2022-01-05 00:00:00"
    ledger = ledger_table(solution.ledger)
    assert ledger["sv"].to_list()[:4] == ["G05", "G31", "E07", "C60"]
    assert ledger["signal"].to_list()[:4] == ["1C", "1W", "1X", "2I"]
    assert ledger["signal2"].to_list()[:2] == ["--", "2W"]
    assert ledger["status"].to_list()[:4] == ["used", "used", "not_selected", "gated"]
    assert ledger["elevation_deg"].max() > 2.0


def test_enu_sigmas_are_those_of_the_covariance() -> None:
    solution = handmade_solution()
    table = solution_table(solution).filter(pl.col("x_m").is_not_null())
    total = sum(table[f"sigma_{a}_m"].to_numpy() ** 2 for a in "enu")
    trace = np.trace(solution.cov_pos[solution.has_position], axis1=1, axis2=2)
    np.testing.assert_allclose(total, trace, rtol=1e-12)  # a rotation keeps the trace


def test_run_json_is_complete_and_strict(tmp_path: Path) -> None:
    write_results(handmade_solution(), tmp_path)
    record = json.loads((tmp_path / "run.json").read_text())
    assert record["complete"] is True
    assert record["starwise"] == "0.0"
    with pytest.raises(ValueError, match="JSON"):
        write_results(replace(handmade_solution(), provenance={"x": float("nan")}), tmp_path / "b")
    assert list((tmp_path / "b").iterdir()) == []


def test_own_results_are_replaced_foreign_ones_are_not(tmp_path: Path) -> None:
    write_results(handmade_solution(30), tmp_path)
    write_results(handmade_solution(20), tmp_path)
    assert read_solution(tmp_path).n_epochs == 20
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "solution.pos").write_text("mine")
    with pytest.raises(StarwiseError, match=r"solution\.pos that starwise did not write"):
        write_results(handmade_solution(), foreign)
    assert (foreign / "solution.pos").read_text() == "mine"


def test_output_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(StarwiseError, match="is a file"):
        write_results(handmade_solution(), tmp_path / "out")


def test_interrupted_writing_leaves_the_old_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_results(handmade_solution(30), tmp_path)

    def fail(*_: object, **__: object) -> bytes:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(results, "write_pos", fail)
    with pytest.raises(StarwiseError, match="No space left"):
        write_results(handmade_solution(20), tmp_path)
    assert read_solution(tmp_path).n_epochs == 30
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(RESULT_FILES)


def test_unfinished_result_is_refused(tmp_path: Path) -> None:
    write_results(handmade_solution(30), tmp_path)
    record = json.loads((tmp_path / "run.json").read_text())
    (tmp_path / "run.json").write_text(json.dumps({**record, "complete": False}))
    with pytest.raises(StarwiseError, match="unfinished"):
        read_solution(tmp_path)


@pytest.mark.parametrize("content", [b"PAR1nonsense", b"PAR1", b"", b"\x00\xff" * 50, b"hello\n"])
def test_garbage_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "solution.parquet"
    path.write_bytes(content)
    with pytest.raises(StarwiseError):
        read_solution(path)
    with pytest.raises(StarwiseError):
        read_solution(tmp_path)
    with pytest.raises(StarwiseError, match="no such file"):
        read_solution(tmp_path / "nothing")


def test_foreign_parquet_is_refused(tmp_path: Path) -> None:
    pl.DataFrame({"a": [1, 2]}).write_parquet(tmp_path / "x.parquet")
    with pytest.raises(StarwiseError, match="not a solution table"):
        read_solution(tmp_path / "x.parquet")


def test_empty_solution(tmp_path: Path) -> None:
    empty = handmade_solution(0)
    write_results(empty, tmp_path)
    assert read_solution(tmp_path).n_epochs == 0


def test_a_day_is_written_quickly(tmp_path: Path) -> None:
    n, rows = 2880, 250_000
    rng = np.random.default_rng(3)
    day = handmade_solution(n, step_ns=30_000_000_000)
    ledger = {key: np.resize(values, rows) for key, values in day.ledger.items()}
    for i in range(14):
        ledger[f"term{i}_m"] = np.where(rng.random(rows) < 0.7, np.nan, rng.normal(size=rows))
    day = replace(day, ledger=ledger)
    write_results(day, tmp_path / "warm")
    times = []
    for i in range(3):
        t0 = time.perf_counter()
        write_results(day, tmp_path / f"run{i}")
        times.append(time.perf_counter() - t0)
    # 0.12 s alone on a 2-core machine; the bound leaves room for a busy one.
    assert min(times) < 1.0, times
