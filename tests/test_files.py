"""Unpacking: what is accepted, what is refused, and that nothing grows beyond its limit."""

import bz2
import gzip
import io
import os
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import ncompress
import pytest

from obs_twin import epoch3, header3
from starwise.errors import StarwiseError
from starwise.io.files import detect, read_bytes, sha256, unpack, unpacked_limit

HEAD = "     3.04           OBSERVATION DATA    M                   RINEX VERSION / TYPE\n"
TEXT = (HEAD + "some lines\n" * 500).encode()


def zipped(*members: tuple[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members:
            archive.writestr(name, data)
    return out.getvalue()


PACKED = {
    "plain": TEXT,
    "gzip": gzip.compress(TEXT),
    "two gzip members": gzip.compress(TEXT[:100]) + gzip.compress(TEXT[100:]),
    "bzip2": bz2.compress(TEXT),
    "compress": ncompress.compress(TEXT),
    "zip": zipped(("a.rnx", TEXT)),
    "zip with a folder": zipped(("folder/", b""), ("folder/a.rnx", TEXT)),
    "gzip in zip": zipped(("a.rnx.gz", gzip.compress(TEXT))),
}


@pytest.mark.parametrize("how", PACKED)
def test_content_is_told_by_content(tmp_path: Path, how: str) -> None:
    path = tmp_path / "any.name"
    path.write_bytes(PACKED[how])
    assert read_bytes(path) == TEXT


def test_layers_are_named_outermost_first(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(PACKED["gzip in zip"])
    assert unpack(path).layers == ("zip", "gzip")


def refused(path: Path, *words: str, limit: int | None = None) -> None:
    with pytest.raises(StarwiseError) as caught:
        read_bytes(path, limit)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    for word in words:
        assert word in text, text


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    refused(tmp_path / "absent", "No such file")
    refused(tmp_path, "folder")
    (tmp_path / "empty").touch()
    refused(tmp_path / "empty", "empty")
    os.mkfifo(tmp_path / "pipe")
    refused(tmp_path / "pipe", "regular")


@pytest.mark.parametrize("how", [h for h in PACKED if h not in ("plain", "compress")])
def test_cut_archives_are_refused(tmp_path: Path, how: str) -> None:
    # compress has no checksum and no length: a cut cannot be seen in it, only in the text
    path = tmp_path / "cut"
    for n in (3, len(PACKED[how]) // 2, len(PACKED[how]) - 3):
        path.write_bytes(PACKED[how][:n])
        try:
            assert read_bytes(path) == PACKED[how][:n]  # too short to be recognised: garbage as it lies there
        except StarwiseError as error:
            assert "\n" not in str(error)
        else:
            assert n == 3


@pytest.mark.parametrize("how", ["gzip", "bzip2", "zip"])
def test_damaged_archives_are_refused(tmp_path: Path, how: str) -> None:
    path = tmp_path / "damaged"
    data = bytearray(PACKED[how])
    data[len(data) // 2] ^= 0x55
    path.write_bytes(bytes(data))
    refused(path, how)


def test_archives_of_several_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "two.zip"
    path.write_bytes(zipped(("a", TEXT), ("b", TEXT)))
    refused(path, "2 files")
    path.write_bytes(zipped())
    refused(path, "0 files")


def test_names_in_archives_never_become_paths(tmp_path: Path) -> None:
    box = tmp_path / "box"
    box.mkdir()
    path = box / "evil.zip"
    path.write_bytes(zipped(("../evil", TEXT)))
    before = sorted(tmp_path.rglob("*"))
    assert read_bytes(path) == TEXT
    assert sorted(tmp_path.rglob("*")) == before


def test_nested_bombs_end(tmp_path: Path) -> None:
    data = TEXT
    for _ in range(6):
        data = gzip.compress(data)
    path = tmp_path / "nested.gz"
    path.write_bytes(data)
    refused(path, "packings")


SIZE = 64 * 1024**2
LIMIT = 4 * 1024**2


@pytest.mark.parametrize("how", ["gzip", "bzip2", "compress", "zip"])
def test_bombs_are_refused_before_they_fill_the_memory(tmp_path: Path, how: str) -> None:
    pack: dict[str, Callable[[bytes], bytes]] = {
        "gzip": gzip.compress,
        "bzip2": bz2.compress,
        "compress": ncompress.compress,
        "zip": lambda data: zipped(("a", data)),
    }
    bomb = pack[how](bytes(SIZE))
    path = tmp_path / "bomb"
    path.write_bytes(bomb)
    tracemalloc.start()
    refused(path, "limit", limit=LIMIT)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3 * LIMIT, "bytes: the limit, a chunk and the archive"


def crinex_bomb(epochs: int) -> bytes:
    """Compact RINEX whose satellites repeat: two bytes a line expand to hundreds."""
    hatanaka = pytest.importorskip("hatanaka")
    import datetime as dt

    codes = [k + b + a for b in "125" for a in "CLSXQ" for k in "CLDS"][:50]
    lines = header3({"G": codes})
    start = dt.datetime(2024, 1, 1)
    for i in range(epochs):
        values: list[float | None] = [2e7] * len(codes)
        lines += epoch3(start + dt.timedelta(seconds=i), {f"G{n:02d}": values for n in range(1, 41)})
    packed: bytes = hatanaka.rnx2crx(("\n".join(lines) + "\n").encode())
    return packed


def test_compact_rinex_bomb_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.crx"
    path.write_bytes(crinex_bomb(60))
    whole = len(read_bytes(path))
    small = path.stat().st_size
    assert whole > 5 * small
    refused(path, "limit", limit=2 * small)


def test_a_plain_file_above_the_limit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "large"
    path.write_bytes(TEXT)
    refused(path, "limit", limit=len(TEXT) - 1)
    assert read_bytes(path, limit=len(TEXT)) == TEXT


def test_limit_from_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("STARWISE_MAX_UNPACKED_BYTES", "1000")
    path = tmp_path / "x.gz"
    path.write_bytes(PACKED["gzip"])
    refused(path, "1000")
    assert unpacked_limit(5) == 5
    monkeypatch.setenv("STARWISE_MAX_UNPACKED_BYTES", "lots")
    with pytest.raises(StarwiseError, match="number of bytes"):
        unpacked_limit()


def test_damaged_compact_rinex_is_refused(tmp_path: Path) -> None:
    packed = crinex_bomb(3)
    path = tmp_path / "x.crx"
    path.write_bytes(packed[: len(packed) // 2].rsplit(b"\n", 1)[0] + b"\n>x\n\n")
    refused(path, "crinex")
    path.write_bytes(packed[:150])
    refused(path, "crinex")


def test_sha256_is_that_of_the_file_on_disk(tmp_path: Path) -> None:
    path = tmp_path / "abc"
    path.write_bytes(b"abc")
    # FIPS 180-2 appendix B.1
    assert sha256(path) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


@pytest.mark.parametrize(
    ("first", "kind", "version", "system"),
    [
        (HEAD, "rinex_obs", "3.04", "M"),
        ("     2.11           N: GPS NAV DATA                         RINEX VERSION / TYPE", "rinex_nav", "2.11", "G"),
        ("     2.10           GLONASS NAV DATA                        RINEX VERSION / TYPE", "rinex_nav", "2.10", "R"),
        ("     4.00           NAVIGATION DATA     M                   RINEX VERSION / TYPE", "rinex_nav", "4.00", "M"),
        ("     2.11           METEOROLOGICAL DATA                     RINEX VERSION / TYPE", "rinex_met", "2.11", ""),
        ("     3.00           C                                       RINEX VERSION / TYPE", "clk", "3.00", ""),
        ("3.04                 C                    M                      RINEX VERSION / TYPE", "clk", "3.04", "M"),
        ("3.0                 COMPACT RINEX FORMAT                    CRINEX VERS   / TYPE", "crinex", "3.0", ""),
        ("#dP2024  3 30  0  0  0.00000000     288 d+D   IGS20 FIT AIUB", "sp3", "d", ""),
        ("#cV2001  8  8  0  0  0.00000000", "sp3", "c", ""),
        ("%=BIA 1.00 COD 2024:100", "bias", "1.00", ""),
        ("\x00\x01\x02binary", "unknown", "", ""),
        ("", "unknown", "", ""),
    ],
)
def test_kinds(first: str, kind: str, version: str, system: str) -> None:
    found = detect(first.encode("latin-1") + b"\nmore\n")
    assert (found.kind, found.version, found.system) == (kind, version, system)
