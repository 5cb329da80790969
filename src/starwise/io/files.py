"""Files as they lie on disk: what is in them, and their plain content, whatever they were packed with.

Archives are not trusted. Unpacking is streamed against a stated limit, so that a small file that unpacks to
gigabytes is refused before it fills the memory; nothing is ever written under a name found in an archive.
"""

import hashlib
import os
import stat
import zlib
from dataclasses import dataclass
from io import BytesIO, RawIOBase
from pathlib import Path
from typing import IO, Any, Final, Literal

from starwise.errors import StarwiseError

DEFAULT_LIMIT: Final = 4 * 1024**3
"""Largest size to unpack to, bytes, unless the argument or STARWISE_MAX_UNPACKED_BYTES says otherwise."""
LAYERS: Final = 4
"""Deepest nesting of packings (``.crx.gz`` in a zip has three)."""
_CHUNK: Final = 1 << 20

FileType = Literal["rinex_obs", "crinex", "rinex_nav", "rinex_met", "clk", "sp3", "antex", "ionex", "bias", "unknown"]


@dataclass(frozen=True)
class FileKind:
    """What a file is, told by its first line.

    Attributes
    ----------
    kind : str
        ``rinex_obs``, ``crinex`` (compact RINEX observations), ``rinex_nav``, ``rinex_met``, ``clk``,
        ``sp3``, ``antex``, ``ionex``, ``bias`` or ``unknown``.
    version : str
        As the file writes it (``2.11``, ``3.04``, ``d``), empty if unknown.
    system : str
        The letter by which RINEX says whose data it has (``G``, ``M`` ...); of a navigation file of version 2
        the system its type stands for (``N`` is G, ``G`` is R, ``H`` is S). Empty if it does not say.
    """

    kind: FileType
    version: str = ""
    system: str = ""


@dataclass(frozen=True)
class Unpacked:
    """Plain content of a file.

    Attributes
    ----------
    data : bytes
        The content, every packing taken off.
    layers : tuple of str
        Packings taken off, outermost first: ``zip``, ``gzip``, ``bzip2``, ``compress``, ``crinex``.
    warnings : tuple of str
        What the unpacking had to say about the content.
    """

    data: bytes
    layers: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def unpacked_limit(limit: int | None = None) -> int:
    """Largest size, bytes, that a file may unpack to.

    Parameters
    ----------
    limit : int, optional
        Taken if given; else the environment variable STARWISE_MAX_UNPACKED_BYTES, else `DEFAULT_LIMIT`.
    """
    if limit is not None:
        return limit
    text = os.environ.get("STARWISE_MAX_UNPACKED_BYTES", "")
    if not text:
        return DEFAULT_LIMIT
    if not text.isdecimal() or int(text) == 0:
        raise StarwiseError("STARWISE_MAX_UNPACKED_BYTES is not a size", found=text, wanted="a number of bytes")
    return int(text)


def read_bytes(path: str | Path, limit: int | None = None) -> bytes:
    """Plain content of a file, packed or not; see `unpack`."""
    return unpack(path, limit).data


def unpack(path: str | Path, limit: int | None = None) -> Unpacked:
    """Plain content of a file: gzip, compress (.Z), zip, bzip2 and compact RINEX taken off, told by content.

    Parameters
    ----------
    path : path-like
        The file; its name does not matter.
    limit : int, optional
        Largest size of any layer, bytes; see `unpacked_limit`.

    Raises
    ------
    StarwiseError
        The file is missing, a folder, empty, larger than the limit, damaged, or an archive of several files.
    """
    limit = unpacked_limit(limit)
    data = _read_plain(path, limit)
    layers: list[str] = []
    warnings: list[str] = []
    while (packing := _packing(data)) is not None:
        if len(layers) == LAYERS:
            raise StarwiseError(f"more than {LAYERS} packings inside each other", file=path)
        data = _take_off(packing, data, path, limit, warnings)
        layers.append(packing)
        if not data:
            raise StarwiseError(f"nothing in the {packing} data", file=path)
    return Unpacked(data, tuple(layers), tuple(warnings))


def sha256(path: str | Path) -> str:
    """SHA-256 of a file as it lies on disk, hexadecimal."""
    digest = hashlib.sha256()
    with _open(path) as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def detect(data: bytes) -> FileKind:
    """What plain content (see `read_bytes`) is, by its first line.

    A reader that was given the wrong kind of file says what it found: ``detect(data).kind``.
    """
    first = data[:200].split(b"\n", 1)[0].decode("latin-1").removeprefix("\xef\xbb\xbf").rstrip()
    label = first[60:80].strip().upper()
    version, letter = first[:9].strip(), first[20:21].upper()
    system = first[40:41].upper().strip()
    if label == "RINEX VERSION / TYPE":
        old_nav = {"N": "G", "G": "R", "H": "S", "L": "E", "E": "E"}
        if letter == "O":
            return FileKind("rinex_obs", version, system)
        if letter in old_nav:
            return FileKind("rinex_nav", version, system or old_nav[letter])
        if letter == "M":
            return FileKind("rinex_met", version)
        if letter == "C":
            return FileKind("clk", version, system)
    kinds: dict[str, FileType] = {
        "CRINEX VERS   / TYPE": "crinex",
        "ANTEX VERSION / SYST": "antex",
        "IONEX VERSION / TYPE": "ionex",
    }
    if label in kinds:
        return FileKind(kinds[label], version)
    if len(first) > 2 and first[0] == "#" and first[1] in "abcd" and first[2] in "PV":
        return FileKind("sp3", first[1])
    if first.startswith("%=BIA"):
        return FileKind("bias", first[5:10].strip())
    if "RINEX VERSION / TYPE" in first and first[20:23].strip() == "C":
        # CLK 3.04 moved its labels to column 66, the type to 22 and the system to 43 (RINEX clock 3.04 table 1).
        return FileKind("clk", version, first[42:43].strip())
    return FileKind("unknown")


def _open(path: str | Path) -> IO[bytes]:
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISDIR(mode):
            raise StarwiseError("is a folder, not a file", file=path)
        if not stat.S_ISREG(mode):
            raise StarwiseError("is not a regular file", file=path)
        return open(path, "rb")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise StarwiseError(f"cannot be read: {reason}", file=path) from None


def _read_plain(path: str | Path, limit: int) -> bytes:
    with _open(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > limit:
            raise StarwiseError(f"larger than the limit of {limit} bytes", file=path, found=f"{size} bytes")
        try:
            data = file.read(limit + 1)
        except OSError as error:
            raise StarwiseError(f"cannot be read: {error.strerror}", file=path) from None
    if not data:
        raise StarwiseError("the file is empty", file=path)
    return data


def _packing(data: bytes) -> str | None:
    if data[:2] == b"\x1f\x8b":
        return "gzip"
    if data[:2] == b"\x1f\x9d":
        return "compress"
    if data[:4] in (b"PK\x03\x04", b"PK\x05\x06"):
        return "zip"
    if data[:3] == b"BZh" and data[4:10] in (b"1AY&SY", b"\x17rE8P\x90"):
        return "bzip2"
    return "crinex" if detect(data[:200]).kind == "crinex" else None


class _TooBigError(Exception):
    pass


class _Sink(RawIOBase):
    """Keeps what is written to it, up to a limit."""

    def __init__(self, limit: int) -> None:
        self.room = limit
        self.chunks: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, chunk: Any, /) -> int:
        self.room -= len(chunk)
        if self.room < 0:
            raise _TooBigError
        self.chunks.append(bytes(chunk))
        return len(chunk)

    def drain(self, file: Any) -> None:
        while chunk := file.read(_CHUNK):
            self.write(chunk)


def _take_off(packing: str, data: bytes, path: str | Path, limit: int, warnings: list[str]) -> bytes:
    """Content of one layer, never more than ``limit`` bytes; any failure of the packing becomes one error."""
    import lzma
    import zipfile

    sink = _Sink(limit)
    try:
        if packing == "crinex":
            _crinex(data, sink, warnings)
        else:
            {"gzip": _gzip, "bzip2": _bzip2, "zip": _zip, "compress": _compress}[packing](data, sink)
    except _TooBigError:
        raise StarwiseError(
            f"unpacks to more than the limit of {limit} bytes (STARWISE_MAX_UNPACKED_BYTES)", file=path
        ) from None
    except (
        OSError,
        EOFError,
        ValueError,
        RuntimeError,
        zlib.error,
        lzma.LZMAError,
        zipfile.BadZipFile,
    ) as error:
        raise StarwiseError(f"damaged or unsupported {packing} data: {str(error)[:200]}", file=path) from None
    return b"".join(sink.chunks)


def _gzip(data: bytes, sink: _Sink) -> None:
    import gzip

    with gzip.GzipFile(fileobj=BytesIO(data)) as file:
        sink.drain(file)


def _bzip2(data: bytes, sink: _Sink) -> None:
    import bz2

    with bz2.BZ2File(BytesIO(data)) as file:
        sink.drain(file)


def _zip(data: bytes, sink: _Sink) -> None:
    import zipfile

    with zipfile.ZipFile(BytesIO(data)) as archive:
        members = [m for m in archive.infolist() if not m.is_dir()]
        if len(members) != 1:
            raise ValueError(f"{len(members)} files in the archive, wanted exactly one")
        with archive.open(members[0]) as file:
            sink.drain(file)


def _compress(data: bytes, sink: _Sink) -> None:
    import ncompress  # type: ignore[import-untyped]

    ncompress.decompress(data, sink)


def _crinex(data: bytes, sink: _Sink, warnings: list[str]) -> None:
    """Run the reference decoder (Hatanaka's CRX2RNX, from the package ``hatanaka``) on a stream of bytes.

    Input and messages go through anonymous temporary files, so that no pipe can fill up; the output is
    stopped at the sink's limit. Exit codes: 0 good, 1 error, 2 warnings.
    """
    import subprocess
    import tempfile

    from hatanaka.hatanaka import executables

    program = str(executables.joinpath("crx2rnx.exe" if os.name == "nt" else "crx2rnx"))
    with tempfile.TemporaryFile() as given, tempfile.TemporaryFile() as said:
        given.write(data)
        given.seek(0)
        with subprocess.Popen([program, "-"], stdin=given, stdout=subprocess.PIPE, stderr=said) as process:
            try:
                assert process.stdout is not None
                sink.drain(process.stdout)
            except BaseException:
                process.kill()
                raise
        said.seek(0)
        words = " ".join(said.read(2000).decode("latin-1").split())
    if process.returncode not in (0, 2):
        raise ValueError(words or f"the decoder ended with {process.returncode}")
    if words:
        warnings.append(words)
