"""Damaged text files at the edge: an error in one line, or a result; never a crash."""

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from handmade import HERE, handmade_solution
from starwise.analysis.accuracy import assess
from starwise.config import load_config
from starwise.errors import StarwiseError
from starwise.io.pos import parse_pos, write_pos
from starwise.io.truth import read_truth
from starwise.types import Truth
from test_accuracy import TABLES

POS = write_pos(handmade_solution(12))
DMS = (
    b"%  UTC   latitude(d'\")   longitude(d'\")  height(m)   Q  ns   sdn(m)\n"
    b"2021/12/31 23:59:42.000   43 33 38.53114    1 28 51.20838   157.2370   5  21   1.7997   1.2343   3.1678   0.1\n"
) * 2
NMEA = (
    b"$GPRMC,235959.00,A,4807.038,N,01131.000,E,022.4,084.4,311221,003.1,W\n"
    b"$GPGGA,000000.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,\n"
) * 3
TOML = b'method = "ekf"\nmask_deg = 7\nexclude = ["R04"]\nstart = 2024-01-01T12:00:00\n[process]\nmodel = "singer"\n'
INSERTED = (b"nan", b"-", b"1e999", b"1e-999", b"\n", b" ", b"%", b"9" * 25, b"e5", b"\x00", b"/", b":", b'"', b"\xff")


def mutated(raw: bytes, rng: random.Random) -> bytes:
    data = bytearray(raw)
    for _ in range(rng.randint(1, 6)):
        if not data:
            break
        at = rng.randrange(len(data))
        lines = bytes(data).splitlines(keepends=True)
        match rng.randint(0, 5):
            case 0:
                data[at] ^= 1 << rng.randint(0, 7)
            case 1:
                del data[at : at + rng.randint(1, 200)]
            case 2:
                data[at:at] = rng.choice(INSERTED)
            case 3:
                rng.shuffle(lines)
                data = bytearray(b"".join(lines))
            case 4:
                del data[at:]
            case _:
                line = rng.randrange(len(lines))
                data = bytearray(b"".join([*lines[:line], *lines[line : line + 1] * 3, *lines[line:]]))
    return bytes(data)


def try_pos(raw: bytes, _: Path) -> None:
    assess(parse_pos(raw, "x.pos"), Truth(HERE))


def try_truth(raw: bytes, folder: Path) -> None:
    (folder / "t.csv").write_bytes(raw)
    read_truth(str(folder / "t.csv"))


def try_config(raw: bytes, folder: Path) -> None:
    (folder / "t.toml").write_bytes(raw)
    load_config(folder / "t.toml")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("attempt", "originals"),
    [(try_pos, [POS, DMS, NMEA]), (try_truth, [text.encode() for text in TABLES.values()]), (try_config, [TOML])],
)
def test_mutations(attempt: Callable[[bytes, Path], None], originals: list[bytes], tmp_path: Path) -> None:
    rng = random.Random(11)
    refused = 0
    for original in originals:
        attempt(original, tmp_path)
    for _ in range(1500):
        raw = mutated(rng.choice(originals), rng)
        try:
            attempt(raw, tmp_path)
        except StarwiseError as error:
            assert "\n" not in str(error), raw
            refused += 1
    assert 100 < refused < 1500
