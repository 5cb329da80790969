"""Damaged observation files: an error of one line or flagged problems, never a crash, a hang or nonsense.

STARWISE_FUZZ_OBS sets the number of mutations (default 4000).
"""

import bz2
import datetime as dt
import gzip
import os
import random
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from obs_twin import epoch2, epoch3, head, header2, header3
from starwise.errors import StarwiseError
from starwise.gnsstime import from_calendar
from starwise.io.files import unpack
from starwise.io.rinex_obs import parse_obs, read_obs
from starwise.types import Observations

COUNT = int(os.environ.get("STARWISE_FUZZ_OBS", "4000"))
T0 = dt.datetime(2024, 2, 28, 23, 59)


def sample3() -> bytes:
    codes = {"G": ["C1C", "L1C", "D1C", "S1C", "C2W", "L2W"], "R": ["C1C", "L1C"], "C": ["C2I", "L2I", "S2I"]}
    extra = [head("  2 R01  1 R02 -4", "GLONASS SLOT / FRQ #"), head("G  100  1 C1C", "SYS / SCALE FACTOR")]
    lines = header3(codes, extra=extra)
    for i in range(6):
        rows: dict[str, list[float | None]] = {
            "G05": [2.1e9 + i, 1.1e8, -123.5, 45.5, 2e7, None],
            "G12": [2.3e9, None, 0.0, 31.0, None, 9e7],
            "R01": [2.0e7, 1.2e8],
            "C01": [3.6e7, 1.9e8] if i > 3 else [3.6e7, 1.9e8, 40.0],
        }
        lines += epoch3(T0 + dt.timedelta(seconds=30 * i), rows)
        if i == 3:
            new = [head("C    2 C6I L6I", "SYS / # / OBS TYPES"), head("hello", "COMMENT")]
            lines += [">                              4  2", *new]
    return ("\n".join(lines) + "\n").encode()


def sample2() -> bytes:
    lines = header2(["C1", "L1", "D1", "S1", "P2", "L2", "P1"])
    for i in range(5):
        rows: dict[str, list[float | None]] = {
            f"{s}{n:02d}": [2e7 + n, 1e8, -500.0, 40.0, 2.1e7, 8e7, None]
            for s, n in zip("GGGGGGGRRRRES", range(1, 14), strict=False)
        }
        lines += epoch2(T0 + dt.timedelta(seconds=30 * i), rows)
        if i == 2:
            lines += [" " * 28 + "4  1", head("hello", "COMMENT")]
    return ("\n".join(lines) + "\n").encode()


SAMPLES = [sample3(), sample2(), sample3().replace(b"\n", b"\r\n"), sample2().replace(b"\n", b"\r\n")]


def mutated(data: bytes, rng: random.Random) -> bytes:
    """One to four of: bit flips, other bytes, cuts, lines doubled, dropped or swapped, sections swapped."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        kind = rng.randrange(9)
        if len(data) < 4:
            return data
        a, b = sorted((rng.randrange(len(data)), rng.randrange(len(data))))
        if kind == 0:
            flipped = bytearray(data)
            for _ in range(rng.choice((1, 3, 30))):
                flipped[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            data = bytes(flipped)
        elif kind == 1:
            data = data[:b]
        elif kind == 2:
            data = data[:a] + data[b:]
        elif kind == 3:
            data = data[:b] + data[a:b] + data[b:]
        elif kind == 4:
            data = (
                data[:a] + bytes(rng.choice(b" \n\r\x00>-.0129GXE\xff") for _ in range(rng.randrange(1, 40))) + data[a:]
            )
        else:
            lines = data.split(b"\n")
            i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
            if kind == 5:
                lines.insert(i, lines[j])
            elif kind == 6:
                del lines[i]
            elif kind == 7:
                lines[i], lines[j] = lines[j], lines[i]
            else:
                middle = rng.randrange(len(lines))
                lines = lines[middle:] + lines[:middle]
            data = b"\n".join(lines)
    return data


FIRST, LAST = from_calendar(1980, 1, 6), from_calendar(2199, 12, 31, 23, 59, 60) + 20 * 10**9


def sane(obs: Observations) -> None:
    """What holds for anything the reader returns."""
    n, m = obs.n_epochs, obs.n_rows
    assert obs.offsets[0] == 0
    assert obs.offsets[-1] == m
    assert (np.diff(obs.offsets) >= 0).all()
    assert len(obs.flag) == len(obs.clock_offset_s) == n
    assert (np.diff(obs.t_ns) > 0).all()
    assert ((obs.t_ns >= FIRST) & (obs.t_ns <= LAST)).all()
    for name in ("code_m", "phase_cyc", "doppler_hz", "cn0_dbhz"):
        values = getattr(obs, name)
        assert len(values) == m
        assert not np.isinf(values).any()
    assert ((obs.sv >> 8) < 7).all()
    assert ((obs.sv & 255) > 0).all()
    assert (obs.lli <= 7).all()
    key = obs.epoch_of_row() * 2000 + obs.sv
    assert (np.diff(key) >= 0).all()
    for problem in obs.problems:
        assert problem.count > 0
        assert problem.line > 0
        assert "\n" not in problem.what


def attempt(data: bytes) -> bool:
    """Whether it was read."""
    try:
        obs = parse_obs(data, "fuzz")
    except StarwiseError as error:
        assert "\n" not in str(error)
        assert str(error).isprintable()
        return False
    sane(obs)
    return True


def test_samples_are_good() -> None:
    for data in SAMPLES:
        assert parse_obs(data).problems == ()


def test_mutated_text() -> None:
    rng = random.Random(int(os.environ.get("STARWISE_FUZZ_SEED", "20240229")))
    done = sum(attempt(mutated(rng.choice(SAMPLES), rng)) for _ in range(COUNT))
    assert 0.3 * COUNT < done < COUNT  # both ways out are really taken


@given(st.data())
@settings(max_examples=300, deadline=None)
def test_text_with_any_piece_replaced(data: st.DataObject) -> None:
    text = data.draw(st.sampled_from(SAMPLES))
    a = data.draw(st.integers(0, len(text)))
    b = data.draw(st.integers(a, min(len(text), a + 200)))
    piece = data.draw(st.one_of(st.binary(max_size=100), st.text("0123456789 .->GRE\n", max_size=100).map(str.encode)))
    attempt(text[:a] + piece + text[b:])


@given(st.binary(max_size=400))
@settings(max_examples=200, deadline=None)
def test_anything_after_a_good_header(body: bytes) -> None:
    for sample in SAMPLES[:2]:
        attempt(sample[: sample.index(b"END OF HEADER") + 14] + body)


def test_one_bit_flipped_changes_at_most_what_it_touches() -> None:
    # a flip can turn one digit into another (nothing can see that) or a name into another; nothing beyond it changes
    rng = random.Random(7)
    for sample in SAMPLES[:2]:
        want = parse_obs(sample)
        known = set(want.code_m[np.isfinite(want.code_m)])
        body = sample.index(b"END OF HEADER") + 14
        for _ in range(COUNT // 8):
            flipped = bytearray(sample)
            flipped[rng.randrange(body, len(sample))] ^= 1 << rng.randrange(8)
            try:
                obs = parse_obs(bytes(flipped))
            except StarwiseError:  # in the header lines of an event: what follows cannot be told apart
                continue
            sane(obs)
            new = set(obs.code_m[np.isfinite(obs.code_m)]) - known
            assert len(new) <= 1 or obs.problems


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, zlib.compress], ids=["gzip", "bzip2", "zlib"])
def test_mutated_archives(tmp_path_factory: pytest.TempPathFactory, pack) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path_factory.mktemp("fuzz") / "x"
    rng = random.Random(3)
    packed = pack(SAMPLES[0])
    for _ in range(max(20, COUNT // 20)):
        path.write_bytes(mutated(packed, rng) or b"x")
        try:
            sane(read_obs(path, limit=10_000_000))
        except StarwiseError as error:
            assert "\n" not in str(error)


@pytest.mark.parametrize("which", [0, 1])
def test_mutated_compact_rinex_and_compress(tmp_path_factory: pytest.TempPathFactory, which: int) -> None:
    import hatanaka
    import ncompress

    path = tmp_path_factory.mktemp("fuzz") / "x"
    rng = random.Random(4)
    packed = hatanaka.rnx2crx(SAMPLES[which])
    for k in range(max(20, COUNT // 40)):
        data = mutated(packed, rng) if k % 2 else mutated(ncompress.compress(SAMPLES[which]), rng)
        path.write_bytes(data or b"x")
        try:
            sane(parse_obs(unpack(path, limit=10_000_000).data))
        except StarwiseError as error:
            assert "\n" not in str(error)
