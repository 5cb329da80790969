"""Header of a RINEX navigation file: version, ionosphere coefficients, leap seconds."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from starwise.constants import SYS_C, SYS_E, SYS_G, SYS_I, SYS_J, SYS_R, SYS_S
from starwise.errors import StarwiseError
from starwise.gnsstime import BDT_OFFSET_S
from starwise.types import IonosphereModel, Problem

LABEL: Final = 60
"""Column where the label of a header line starts."""
_RINEX2_TYPE: Final = {
    # RINEX 2.12 table A1 and older habits: letter in column 21
    "N": SYS_G, "G": SYS_R, "H": SYS_S, "E": SYS_E, "L": SYS_E, "J": SYS_J, "Q": SYS_J, "C": SYS_C, "I": SYS_I,
}  # fmt: skip
_ION_SYSTEM: Final = {"GPS": "G", "QZS": "J", "BDS": "C", "IRN": "I"}
_MAX_HEADER_LINES: Final = 20_000


@dataclass
class NavHeader:
    """What the header says, and where the records start."""

    version: int
    system: int
    """Of a RINEX 2 file; -1 where every record names its own."""
    first_line: int = 0
    """Line (from 1) after END OF HEADER."""
    body: int = 0
    """Byte after END OF HEADER."""
    leap_s: int | None = None
    klobuchar: dict[str, list[tuple[str, tuple[float, ...]]]] = field(default_factory=dict)
    """By system letter: (``A`` or ``B`` and time mark and satellite, four values) in file order."""
    nequick: tuple[float, ...] | None = None
    problems: list[Problem] = field(default_factory=list)


def parse_header(data: bytes, start: int, line: int, file: str) -> NavHeader:
    """Parse the header that starts at byte ``start``, line ``line``.

    Raises
    ------
    StarwiseError
        Not a navigation file of RINEX 2, 3 or 4, or the header does not end.
    """
    text, after = _next_line(data, start)
    header = _first_line(text, line, file)
    for _ in range(_MAX_HEADER_LINES):
        if after >= len(data):
            break
        line += 1
        text, after = _next_line(data, after)
        label = text[LABEL:].strip()
        try:
            if label == "END OF HEADER" or text.strip() == "END OF HEADER":
                header.first_line, header.body = line + 1, after
                return header
            _header_line(header, label, text)
        except ValueError:
            header.problems.append(Problem(file, line, f"{label} is not readable: left out"))
    raise StarwiseError("the header does not end", file=file, line=line, wanted="END OF HEADER")


def _next_line(data: bytes, start: int) -> tuple[str, int]:
    end = data.find(b"\n", start, start + 4096)
    if end < 0:
        end = min(len(data), start + 4096)
    return data[start:end].decode("latin-1").rstrip("\r"), end + 1


def _first_line(text: str, line: int, file: str) -> NavHeader:
    if "RINEX VERSION / TYPE" not in text:
        raise StarwiseError(
            "not a RINEX navigation file", file=file, line=line, found=text.strip(), wanted="RINEX VERSION / TYPE"
        )
    try:
        version = int(float(text[:20]))
    except (ValueError, OverflowError):
        version = 0
    kind = text[20:21]
    if version not in (2, 3, 4):
        raise StarwiseError(
            "RINEX version not supported", file=file, line=line, found=text[:20].strip(), wanted="2.x, 3.x or 4.x"
        )
    if kind not in _RINEX2_TYPE or (version > 2 and kind not in "NGE"):
        raise StarwiseError(
            "not a RINEX navigation file", file=file, line=line, found=text[20:40].strip(), wanted="type N"
        )
    return NavHeader(version=version, system=_RINEX2_TYPE[kind] if version == 2 else -1)


def _real(text: str) -> float:
    value = float(text.replace("D", "E").replace("d", "e"))
    if not np.isfinite(value):
        raise ValueError(text)
    return value


def _header_line(header: NavHeader, label: str, text: str) -> None:
    if label == "IONOSPHERIC CORR":
        name = text[:4].strip()
        if name == "GAL":
            header.nequick = tuple(_real(text[5 + 12 * k : 17 + 12 * k]) for k in range(3))
        elif name[:3] in _ION_SYSTEM and name[3:] in ("A", "B"):
            values = tuple(_real(text[5 + 12 * k : 17 + 12 * k]) for k in range(4))
            mark = name[3] + "".join(text[53:60].split())
            header.klobuchar.setdefault(_ION_SYSTEM[name[:3]], []).append((mark, values))
        else:
            raise ValueError(name)
    elif label in ("ION ALPHA", "ION BETA"):
        if header.system == SYS_E:  # RINEX 2.12: ai0, ai1, ai2
            if label == "ION ALPHA":
                header.nequick = tuple(_real(text[2 + 12 * k : 14 + 12 * k]) for k in range(3))
            return
        values = tuple(_real(text[2 + 12 * k : 14 + 12 * k]) for k in range(4))
        letter = {SYS_J: "J", SYS_C: "C", SYS_I: "I"}.get(header.system, "G")
        header.klobuchar.setdefault(letter, []).append((label[4:5], values))
    elif label == "LEAP SECONDS":
        leap = int(text[:6])
        bdt = text[24:27] == "BDS" or leap < 10  # no file after 1996 counts fewer than 10 from 1980
        header.leap_s = leap + BDT_OFFSET_S if bdt else leap


def ionosphere(headers: list[NavHeader], sent: list[tuple[int, str, tuple[float, ...]]]) -> IonosphereModel:
    """Broadcast ionosphere coefficients of several headers and of ION records.

    Where a source gives several sets (BeiDou: one an hour and satellite) the model holds the most frequent pair of
    alpha and beta, the first among equals; a set that occurs once in a day is more likely damaged than new.
    ``history`` holds all of the ION records in time order: letters as in RINEX, ``E`` for NeQuick-G (3 values),
    ``B`` for BDGIM (9 values).

    Parameters
    ----------
    headers : list of NavHeader
    sent : list of (GPST ns, letter, values)
        From ION records.
    """
    pairs: dict[str, Counter[tuple[float, ...]]] = {}
    nequick: Counter[tuple[float, ...]] = Counter()
    for header in headers:
        for letter, entries in header.klobuchar.items():
            alphas = {mark[1:]: values for mark, values in reversed(entries) if mark[0] == "A"}
            betas = {mark[1:]: values for mark, values in reversed(entries) if mark[0] == "B"}
            both = [alphas[m] + betas[m] for m in sorted(alphas) if m in betas]
            if not both and alphas and betas:  # marks that do not agree: the first of each
                first = {mark[0]: values for mark, values in reversed(entries)}
                both = [first["A"] + first["B"]]
            pairs.setdefault(letter, Counter()).update(both)
        if header.nequick is not None:
            nequick[header.nequick] += 1
    for _, letter, values in sent:
        if letter == "E":
            nequick[values] += 1
        elif letter != "B":
            pairs.setdefault(letter, Counter())[values] += 1
    return IonosphereModel(
        klobuchar={k: np.array(c.most_common(1)[0][0]) for k, c in sorted(pairs.items()) if c},
        nequick=np.array(nequick.most_common(1)[0][0]) if nequick else None,
        history=tuple(sorted(sent, key=lambda entry: entry[0])),
    )
