"""The benchmarks' scaffolding, and the C twin of the sequential update: the same answer as the kernel."""

import importlib
import shutil
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("_bench")


def test_turns_alternate_and_are_counted(bench: ModuleType) -> None:
    told: list[str] = []
    calls = {name: (lambda name=name: told.append(name)) for name in "ab"}
    took = bench.alternate(calls, 3)
    assert "".join(told) == "abababab"  # one turn to warm up
    assert set(took) == {"a", "b"}
    assert took["a"].least <= took["a"].low <= took["a"].median <= took["a"].high


def test_memory_of_a_command_is_not_its_parents(bench: ModuleType) -> None:
    held = np.ones(25_000_000)  # 200 MB in this process
    _, peak = bench.process([sys.executable, "-S", "-c", "pass"])
    assert 1.0 < peak < 100.0
    assert held.all()


def test_a_failing_command_is_an_error(bench: ModuleType) -> None:
    with pytest.raises(SystemExit, match="failed"):
        bench.process([sys.executable, "-c", "raise SystemExit(3)"])


def test_slope_is_the_exponent(bench: ModuleType) -> None:
    assert bench.slope([1.0, 10.0, 100.0], [3.0, 30.0, 300.0]) == pytest.approx(1.0, abs=1e-12)  # rounding


def test_tables_as_text_markdown_and_json(bench: ModuleType) -> None:
    rows = [{"what": "a", "s": bench.Spread(1.0, 0.9, 1.1, 0.8)}, {"what": "b", "s": None, "x": 0.01234}]
    table = bench.Table("name", "Title", rows, ["note"])
    assert "1.00 (0.900-1.10)" in table.text()
    assert "| b |  | 0.0123 |" in table.markdown()
    assert table.plain()["rows"][0]["s"]["median"] == 1.0


def test_every_group_of_the_suite_exists(bench: ModuleType) -> None:
    suite = importlib.import_module("suite")
    for module, function in suite.SUITE.values():
        assert f"def {function}(quick: bool)" in (FOLDER / f"{module}.py").read_text(encoding="utf-8")


@pytest.mark.laws
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("clocks", [1, 3])
def test_c_twin_gives_the_kernels_answer(bench: ModuleType, tmp_path: Path, clocks: int) -> None:
    update = importlib.import_module("update")
    from starwise.kernels.update import update_sequential

    p = update.make_problem(12, clocks, np.random.default_rng(clocks))
    p.v[3, 0] += 1e3  # a code that the gate refuses
    p.v[5] += 1e3  # and both rows of a satellite
    x, P = p.x.copy(), p.P.copy()
    update_sequential(x, P, p.n, True, *p.rows, *update.GATES, p.v_out, p.s_out, p.used)
    used = p.used.copy()
    assert used[3] == 2
    assert used[5] == 0
    twin = update.c_twin(tmp_path)
    update.c_call(twin, p)(1)
    assert np.array_equal(used, p.used)
    # states of metres: rounding in another order
    assert np.abs(p.x - x).max() < 1e-9
    assert np.abs(p.P - P).max() < 1e-8
