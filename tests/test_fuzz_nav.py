"""Damaged navigation, orbit and clock files: an error in one line or fewer records, never a crash or nonsense."""

import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import test_clk
import test_sp3
from nav_text import GLONASS_CLOCK, GPS_CLOCK, SOW, glonass, header, kepler, record
from starwise.constants import K_E, K_SQRT_A, MSG_FDMA, NS
from starwise.errors import StarwiseError
from starwise.io.clk import read_clk
from starwise.io.rinex_nav import read_nav
from starwise.io.sp3 import read_sp3

N_JIT = 700
"""Mutations of every sample; ten times as many were run once."""
N_PLAIN = 40
"""Mutations with the compiler off, where an index out of bounds is an error."""


def _sbas() -> list[list[float | None]]:
    return [[-33_893.9, 1e-3, 0.0, 0.0], [25_080.2, 0.0, 0.0, 4.0], [12.5, 0.0, 0.0, 77.0]]


def _cnav() -> list[list[float | None]]:
    rows = kepler()
    rows[0][0], rows[4], rows[5] = 0.01, [1.1e-10, 2e-14, -6.0, 2.0], [-1.0, 0.0, 4.7e-9, 7.0]
    return [*rows[:6], [-3e-10, -2e-9, 7e-9, 6e-9], [SOW - 5400.0, 2307.0]]


def _nav3() -> str:
    galileo = kepler(5440.6, t_tx=SOW + 700.0)
    galileo[4][1] = 517.0
    return header(extra=(f"{'GPSA   1.1176D-08 -1.4901D-08 -5.9605D-08  1.1921D-07':<60}IONOSPHERIC CORR",)) + "".join(
        [
            record("G07", GPS_CLOCK, kepler()),
            record("R05", GLONASS_CLOCK, glonass(fourth=True)),
            record("E11", GPS_CLOCK, galileo),
            record("C23", GPS_CLOCK, kepler(5282.6, week=951.0)),
            record("J02", GPS_CLOCK, kepler(6493.0)),
            record("S22", [0.0, 0.0, SOW], _sbas()),
            record("R06", GLONASS_CLOCK, glonass()),
        ]
    )


def _nav4() -> str:
    ion = "> ION G12 LNAV\n    2024 03 30 12 00 00" + " 1.000000000000e-08" * 3 + "\n"
    ion += ("    " + " 1.000000000000e+05" * 4 + "\n") * 2
    return header("4.00") + "".join(
        [
            "> EPH G07 LNAV\n" + record("G07", GPS_CLOCK, kepler()),
            "> EPH G07 CNAV\n" + record("G07", GPS_CLOCK, _cnav()),
            ion,
            "> STO G23 LNAV\n    2024 03 30 16 51 12 GPUT\n    " + " 1.000000000000e+00" * 2 + "\n",
            "> EPH R05 FDMA\n" + record("R05", GLONASS_CLOCK, glonass(fourth=True)),
            "> EPH S22 SBAS\n" + record("S22", [0.0, 0.0, SOW], _sbas()),
        ]
    )


def _nav2() -> str:
    return header("2.11") + "".join(record(f"G{n:02d}", GPS_CLOCK, kepler(), version=2) for n in (1, 12, 30))


SAMPLES: dict[str, tuple[Callable[[], str], Callable[[Path], object]]] = {
    "nav2": (_nav2, read_nav),
    "nav3": (_nav3, read_nav),
    "nav4": (_nav4, read_nav),
    "sp3": (lambda: test_sp3.made(epochs=6), read_sp3),
    "clk": (lambda: test_clk.header() + test_clk.body(), read_clk),
}


def mutate(data: bytes, rng: random.Random) -> bytes:
    """One to four injuries: bits, bytes, lines, sections."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not data:
            return data
        a, b = sorted(rng.randrange(len(data) + 1) for _ in range(2))
        lines = data.split(b"\n")
        k, m = rng.randrange(len(lines)), rng.randrange(len(lines))
        kind = rng.randrange(10)
        if kind <= 2:
            i = rng.randrange(len(data))
            data = data[:i] + bytes([data[i] ^ 1 << rng.randrange(8)]) + data[i + 1 :]
        elif kind == 3:
            data = data[:a]
        elif kind == 4:
            data = data[:a] + data[min(b, a + 100) :]
        elif kind == 5:
            data = b"\n".join([*lines[:k], lines[k], *lines[k:]])
        elif kind == 6:
            lines[k], lines[m] = lines[m], lines[k]
            data = b"\n".join(lines)
        elif kind == 7:
            lo, hi = sorted((k, m))
            data = b"\n".join([*lines[hi:], *lines[lo:hi], *lines[:lo]])
        elif kind == 8:
            data = data[:a] + bytes(rng.randrange(256) for _ in range(rng.randrange(1, 30))) + data[a:]
        else:
            data = data[:a] + data[a:b].replace(b"0", b"9", 3) + data[b:]
    return data


def check(result: object) -> None:
    """What holds for every result, whatever the file looked like."""
    t_ns = result.t_ns if hasattr(result, "t_ns") else result.toe_ns  # type: ignore[attr-defined]
    assert len(t_ns) > 0
    assert (np.abs(t_ns) < 2**62).all()
    if hasattr(result, "pos_e"):
        assert (np.diff(t_ns) > 0).all()
        radius = np.sqrt((result.pos_e**2).sum(axis=2))
        assert (np.isnan(radius) | ((radius > 6e6) & (radius < 1.1e8))).all()
    elif hasattr(result, "par"):
        kepler_rows = result.message < MSG_FDMA  # type: ignore[attr-defined]
        assert np.isfinite(result.par[kepler_rows]).all()
        assert (result.par[kepler_rows, K_E] < 0.5).all()
        assert (result.par[kepler_rows, K_SQRT_A] > 4000.0).all()
        assert (np.abs(result.t_tx_ns - t_ns) <= 86_400 * NS).all()  # type: ignore[attr-defined]
    else:
        assert (np.abs(result.clock_s) < 1.0).all()  # type: ignore[attr-defined]


def run(name: str, n: int, folder: Path, seed: int = 20240330) -> tuple[int, int]:
    """Read ``n`` mutations of a sample; how many were read and how many refused."""
    make, read = SAMPLES[name]
    whole = make().encode("latin-1")
    rng = random.Random(f"{name} {seed}")
    path = folder / f"{name}.txt"
    good = refused = 0
    for k in range(n):
        path.write_bytes(mutate(whole, rng))
        start = time.monotonic()
        try:
            check(read(path))
            good += 1
        except StarwiseError as error:
            refused += 1
            if "\n" in str(error):
                raise AssertionError(f"mutation {k}: {error}") from error
        except Exception as error:
            raise AssertionError(f"{name}: mutation {k} of seed {seed}") from error
        if time.monotonic() - start > 20.0:
            raise AssertionError(f"{name}: mutation {k} took too long")
    return good, refused


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", SAMPLES)
def test_mutations(name: str, tmp_path: Path) -> None:
    good, refused = run(name, N_JIT, tmp_path)
    assert good + refused == N_JIT
    assert good > N_JIT // 4  # most injuries cost a record, not the file


@pytest.mark.slow
def test_mutations_with_the_compiler_off(tmp_path: Path) -> None:
    """Uncompiled kernels check their indices; compiled ones do not."""
    here = Path(__file__).parent
    runs = f"[f.run(n, {N_PLAIN}, pathlib.Path({str(tmp_path)!r}), 7) for n in f.SAMPLES]"
    command = [sys.executable, "-c", f"import pathlib; import test_fuzz_nav as f; {runs}"]
    env = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(here)}
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
