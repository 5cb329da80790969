"""Sorting files by what is in them, without unpacking them whole."""

import bz2
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from starwise.errors import StarwiseError
from starwise.io.files import FileKind, detect, read_bytes

_HEAD: Final = 1 << 16
_BZ2_BLOCK: Final = 1_000_000  # bzip2 yields nothing before its first block, at most 900 kB, is complete


@dataclass(frozen=True)
class Inputs:
    """Files of a run by kind, in the order given."""

    obs: tuple[Path, ...] = ()
    nav: tuple[Path, ...] = ()
    sp3: tuple[Path, ...] = ()
    clk: tuple[Path, ...] = ()

    @property
    def all(self) -> tuple[tuple[str, Path], ...]:
        """Kind and path of every file."""
        kinds = (("observations", self.obs), ("navigation", self.nav), ("orbits", self.sp3), ("clocks", self.clk))
        return tuple((kind, path) for kind, paths in kinds for path in paths)


def peek(path: str | Path) -> FileKind:
    """What a file is, by its first line under whatever it is packed with.

    Raises
    ------
    StarwiseError
        The file cannot be read or its packing is damaged.
    """
    kind = detect(head_of(path))
    return FileKind("rinex_obs", kind.version) if kind.kind == "crinex" else kind


def head_of(path: str | Path) -> bytes:
    """Beginning of a file's content under whatever it is packed with; of compact RINEX, as it stands.

    Raises
    ------
    StarwiseError
        The file cannot be read or its packing is damaged.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            head = _unpacked_head(file.read(_HEAD), path)
    except OSError as error:
        raise StarwiseError(f"cannot be read: {error.strerror or error}", file=path) from None
    return read_bytes(path)[:_HEAD] if head is None else head


def _unpacked_head(head: bytes, path: Path) -> bytes | None:
    """Beginning of the content; None if only the whole file can tell."""
    try:
        if head[:2] == b"\x1f\x8b":
            head = zlib.decompressobj(31).decompress(head, _HEAD)
        elif head[:3] == b"BZh":
            with open(path, "rb") as file:
                head = bz2.BZ2Decompressor().decompress(file.read(_BZ2_BLOCK), _HEAD)
        elif head[:4] == b"PK\x03\x04":
            with zipfile.ZipFile(path) as archive:
                members = [m for m in archive.infolist() if not m.is_dir()]
                if len(members) != 1:
                    return None
                with archive.open(members[0]) as member:
                    head = member.read(_HEAD)
    except (OSError, EOFError, ValueError, RuntimeError, NotImplementedError, zlib.error, zipfile.BadZipFile):
        return None
    packed = head[:2] in (b"\x1f\x8b", b"\x1f\x9d") or head[:3] == b"BZh" or head[:4] == b"PK\x03\x04"
    return None if packed or not head else head


def sort_inputs(paths: tuple[str | Path, ...]) -> Inputs:
    """Files sorted into observations, navigation, orbits and clocks by their content.

    Raises
    ------
    StarwiseError
        A file is of a kind that a run cannot use.
    """
    found: dict[str, list[Path]] = {"rinex_obs": [], "rinex_nav": [], "sp3": [], "clk": []}
    for path in map(Path, paths):
        kind = peek(path)
        if kind.kind not in found:
            raise StarwiseError(
                "not a file that a solution can be made from",
                file=path,
                found=kind.kind,
                wanted="RINEX observations or navigation, SP3 or CLK",
            )
        if path not in found[kind.kind]:
            found[kind.kind].append(path)
    return Inputs(*(tuple(found[kind]) for kind in ("rinex_obs", "rinex_nav", "sp3", "clk")))
