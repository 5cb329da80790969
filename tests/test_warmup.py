"""Kernels compiled ahead: when, by whom, that nothing is left to compile afterwards, and that failures are harmless."""

import os
import subprocess
import sys
import threading
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

import starwise
from starwise import warmup
from starwise.kernels import _jit, linalg
from starwise.terminal import Progress

DATA = Path(str(resources.files("starwise.demo"))) / "data"
OBS, NAV = DATA / "demo_MO.rnx.gz", DATA / "demo_MN.rnx.gz"


@pytest.fixture
def cold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """An empty cache, two cores, and a compilation that only takes notes; returns them."""
    calls: list[tuple[str, ...]] = []

    def compile_nothing(parts: tuple[str, ...]) -> list[str]:
        calls.append(parts)
        warmup.marker().write_text("")
        return []

    monkeypatch.delenv("STARWISE_NO_WARMUP", raising=False)
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    monkeypatch.setattr(warmup, "_cores", lambda: 2)
    monkeypatch.setattr(_jit, "cache_roots", lambda: (tmp_path,))
    monkeypatch.setattr(warmup, "compile_kernels", compile_nothing)
    return calls


def test_once_and_announced(cold: list[tuple[str, ...]]) -> None:
    told: list[int] = []
    for _ in range(3):
        warmup.ensure_warm(lambda: told.append(1))
    assert cold == [warmup.PARTS]
    assert told == [1]


@pytest.mark.parametrize("variable", ["STARWISE_NO_WARMUP", "NUMBA_DISABLE_JIT"])
def test_switched_off(cold: list[tuple[str, ...]], variable: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(variable, "1")
    warmup.ensure_warm()
    assert cold == []


def test_not_on_one_core(cold: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warmup, "_cores", lambda: 1)
    warmup.ensure_warm()
    assert cold == []


@pytest.mark.parametrize("executable", ["", "/opt/game/engine"])
def test_a_program_that_embeds_python_is_not_started(
    cold: list[tuple[str, ...]], executable: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", executable)
    warmup.ensure_warm()
    assert cold == []


def test_marker_follows_the_sources(cold: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch) -> None:
    before = warmup.marker()
    monkeypatch.setattr(_jit, "cache_name", lambda module: f"{module}-edited")
    assert warmup.marker() != before
    assert warmup.marker().parent == before.parent


def test_every_kernel_of_a_solution_is_in_the_marker() -> None:
    """The modules that name the marker reach all that solutions load, and nothing else: others may change at will."""
    reached, waiting = {"_jit"}, list(warmup._MAIN)
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            text = (Path(_jit.__file__).parent / f"{name}.py").read_bytes()
            waiting.extend(found.decode() for found in _jit._IMPORT.findall(text))
    code = (
        "import sys, starwise\n"
        "for method in ('lsq', 'ekf', 's3ekf'):\n"
        f"    starwise.solve({str(OBS)!r}, {str(NAV)!r}, method=method, end='2026-03-21T12:20:05')\n"
        "print(*(name for name in sys.modules if name.startswith('starwise.kernels.')))"
    )
    environment = {**os.environ, "STARWISE_NO_WARMUP": "1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    loaded = {name.rpartition(".")[2] for name in done.stdout.split()}
    assert loaded - {"_cache"} == reached


def test_the_second_of_two_waits_for_the_first(cold: list[tuple[str, ...]]) -> None:
    with warmup._alone():
        second = threading.Thread(target=warmup.ensure_warm, daemon=True)
        second.start()
        second.join(0.3)
        assert second.is_alive()
        warmup.marker().write_text("")
    second.join(5.0)
    assert not second.is_alive()
    assert cold == []


def test_a_cache_that_cannot_be_written_is_no_error(
    cold: list[tuple[str, ...]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_jit, "cache_roots", lambda: (tmp_path / "absent",))
    warmup.ensure_warm()
    assert cold == []


def test_failures_are_told_and_not_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_jit, "cache_roots", lambda: (tmp_path,))
    failed = warmup.compile_kernels(("nonsense",))
    assert failed == ["nonsense: KeyError: 'nonsense'"]
    assert warmup.marker().exists()


def test_announced_in_one_line_unless_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    for quiet in (True, False):
        with Progress(True, quiet) as say:
            say(warmup.COMPILING, 0.0)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == f"starwise: compiling kernels once, about {warmup.ABOUT_S} s\n"


def test_solve_warms_up_after_it_has_checked_its_input(cold: list[tuple[str, ...]]) -> None:
    with pytest.raises(starwise.StarwiseError, match="no ephemeris"):
        starwise.solve(OBS)
    assert cold == []
    said: list[str] = []
    starwise.solve(OBS, NAV, method="lsq", end="2026-03-21T12:20:10", progress=lambda what, _: said.append(what))
    assert cold == [warmup.PARTS]
    assert said[0] == warmup.COMPILING


def _compiled(cache: Path) -> set[str]:
    return {path.name for path in cache.rglob("*.nb[ci]")}


@pytest.mark.slow
def test_nothing_is_left_to_compile(tmp_path: Path) -> None:
    """Both processes for real into an empty cache; then solutions of every method add no compiled function."""
    environment = {**os.environ, "STARWISE_CACHE_DIR": str(tmp_path / "cache"), "STARWISE_NO_WARMUP": "1"}
    environment.pop("NUMBA_DISABLE_JIT", None)

    def run(code: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment, timeout=600
        )
        return done.stdout.strip()

    assert run("from starwise.warmup import compile_kernels; print(compile_kernels())") == "[]"
    compiled = _compiled(tmp_path / "cache")
    assert len(compiled) > 100
    run(
        "import starwise\n"
        f"for method in ('lsq', 'ekf', 's3ekf'):\n    starwise.solve({str(OBS)!r}, {str(NAV)!r}, method=method)"
    )
    assert _compiled(tmp_path / "cache") == compiled


def test_a_shared_cache_that_cannot_be_written_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shared, own = tmp_path / "shared", tmp_path / "own"
    shared.mkdir()
    monkeypatch.setenv("STARWISE_CACHE_DIR", str(shared))
    monkeypatch.setenv("XDG_CACHE_HOME", str(own))
    monkeypatch.setattr(_jit, "_writable", lambda path: path != shared)  # root may write anywhere
    monkeypatch.setattr(_jit, "cache_roots", _jit.cache_roots.__wrapped__)
    assert _jit.cache_roots()[1:] == (shared,)
    assert own in _jit.cache_root().parents
    assert not warmup.is_warm()
    (shared / warmup._marker_name()).write_text("")
    assert warmup.is_warm()


SHARED = """
import sys
from pathlib import Path
from starwise.kernels import _jit
_jit.cache_roots = lambda: tuple(Path(root) for root in sys.argv[1:])
import numpy as np
from starwise.kernels.linalg import median
assert median(np.array([3.0, 1.0, 2.0]), 3) == 2.0
print(sum(median.stats.cache_hits.values()), sum(median.stats.cache_misses.values()))
"""


def test_compiled_kernels_are_found_in_a_shared_cache(tmp_path: Path) -> None:
    """Compiled once into one directory; a process that may only read it loads from there and writes nothing."""
    first, second, nowhere = tmp_path / "first", tmp_path / "second", tmp_path / "none" / "below-a-file"
    (tmp_path / "none").write_text("a directory cannot be made here")

    def run(*roots: Path) -> str:
        command = [sys.executable, "-c", SHARED, *map(str, roots)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    first.mkdir()
    second.mkdir()
    assert run(first) == "0 1"
    assert run(first) == "1 0"
    assert run(second, first) == "1 0"
    assert not list(second.rglob("*.nbc"))
    assert run(nowhere, first) == "1 0"
    assert run(nowhere) == "0 1"  # neither found nor kept, and no error


def test_a_kernel_loads_without_numbas_tables(tmp_path: Path) -> None:
    """What numba needs only to compile is not set up for a kernel that has been compiled: 0.2 s of every start."""
    code = SHARED + "print('numba.typed.typeddict' in sys.modules)"
    for expected in ("0 1\nTrue", "1 0\nFalse"):
        done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True)
        assert done.stdout.strip() == expected


def test_another_numba_takes_its_own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    # numba's machinery is not promised to stay: kernels compile and are kept all the same
    monkeypatch.setattr(_jit, "_kernel_cache", lambda: None)
    monkeypatch.setattr(_jit, "cache_roots", lambda: (tmp_path,))
    median = _jit.njit(linalg.median.py_func)  # type: ignore[attr-defined]
    assert median(np.array([3.0, 1.0, 2.0]), 3) == 2.0
    assert list(tmp_path.rglob("*.nbc"))


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_a_damaged_cache_is_made_anew(tmp_path: Path, suffix: str) -> None:
    """Empty files are what a computer may leave that loses its power."""
    arguments = [sys.executable, "-c", SHARED, str(tmp_path)]
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_DISABLE_JIT"}
    subprocess.run(arguments, check=True, env=environment)
    harmed = next(tmp_path.rglob(f"linalg.median-*.{suffix}"))
    harmed.write_bytes(b"")
    for hits in ("0 1", "1 0"):
        done = subprocess.run(arguments, check=True, env=environment, capture_output=True, text=True)
        assert done.stdout.strip() == hits


def test_two_processes_do_not_give_a_file_to_two_signatures(tmp_path: Path) -> None:
    """A writer waits while another one is between the index and the files of a directory."""
    cache = pytest.importorskip("starwise.kernels._cache")
    pytest.importorskip("fcntl")
    with cache._turn(tmp_path / "kernel-1"):
        second = threading.Thread(target=lambda: cache._turn(tmp_path / "kernel-1").__enter__(), daemon=True)
        second.start()
        second.join(0.3)
        assert second.is_alive()
    second.join(5.0)
    assert not second.is_alive()
