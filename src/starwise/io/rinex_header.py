"""Headers of RINEX observation files, versions 2 to 4, and the header lines that events bring into the body."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Final

from starwise.constants import SYSTEMS
from starwise.errors import StarwiseError
from starwise.io.files import detect
from starwise.signals import sv_id
from starwise.types import ObservationHeader, Problem

MAX_HEADER_LINES: Final = 20_000
"""A header longer than this is none: 999 satellites with all their counts stay below."""

MAX_KINDS: Final = 100
"""Different problems of a file that are kept apart."""
_DEFAULT_TIME: Final = {"R": "GLO", "E": "GAL", "C": "BDT", "J": "QZS", "I": "IRN"}
"""Time system of a pure file that does not name one (RINEX 3.05 table A2, TIME OF FIRST OBS); others GPS."""
_SLOT: Final = re.compile(r"R *(\d{1,2}) *([+-]?\d{1,2})(?!\d)")
_TIME_ALIAS: Final = {"BDS": "BDT", "GLN": "GLO"}


class Problems:
    """Collects what was dealt with in one file: a count and the first line by kind."""

    def __init__(self, file: str) -> None:
        self.file = file
        self._found: dict[str, Problem] = {}

    def add(self, line: int, what: str, count: int = 1) -> None:
        """Count a case of ``what``; the first line given stays."""
        if what not in self._found and len(self._found) >= MAX_KINDS:
            what = "further problems"
        known = self._found.get(what)
        if known is None:
            self._found[what] = Problem(self.file, line, what, count)
        else:
            self._found[what] = replace(known, count=known.count + count)

    def all(self) -> tuple[Problem, ...]:
        """Everything found, in file order."""
        return tuple(sorted(self._found.values(), key=lambda p: p.line))


@dataclass
class Header:
    """A header while it is being read, and as events change it.

    Attributes
    ----------
    version : float
    system : str
        Letter of the file, ``M`` for mixed.
    codes : dict
        Observation codes as written, by system letter; version 2: under ``""``.
    scale : dict
        Scale factor by (system letter, code); code ``""`` stands for all of them.
    channels : dict
        GLONASS channel by satellite identifier.
    """

    version: float = 0.0
    version_text: str = ""
    system: str = "G"
    codes: dict[str, list[str]] = field(default_factory=dict)
    scale: dict[tuple[str, str], float] = field(default_factory=dict)
    channels: dict[int, int] = field(default_factory=dict)
    marker: str = ""
    receiver: str = ""
    antenna: str = ""
    approx_pos_e: tuple[float, float, float] | None = None
    antenna_hen: tuple[float, float, float] = (0.0, 0.0, 0.0)
    interval_s: float | None = None
    time_system: str = ""
    cn0_unit: str = ""
    clock_applied: bool = False

    def public(self, signals: dict[str, tuple[str, ...]]) -> ObservationHeader:
        """The noun, with the signals' RINEX 3 names by system letter."""
        return ObservationHeader(
            version=self.version_text,
            marker=self.marker,
            receiver=self.receiver,
            antenna=self.antenna,
            approx_pos_e=self.approx_pos_e,
            antenna_hen=self.antenna_hen,
            interval_s=self.interval_s,
            time_system=self.time_system,
            cn0_unit=self.cn0_unit,
            clock_applied=self.clock_applied,
            signals=signals,
        )


def read_header(data: bytes, start: int, line: int, problems: Problems) -> tuple[Header, int, int]:
    """Header of an observation file.

    Parameters
    ----------
    data : bytes
        The plain file.
    start, line : int
        Byte position and line number (from 1) of the header's first line.
    problems : Problems
        Receives what was dealt with.

    Returns
    -------
    header : Header
    body : int
        Byte position of the first line after the header.
    body_line : int
        Its line number.

    Raises
    ------
    StarwiseError
        Not an observation file, no END OF HEADER, or the observation codes cannot be told.
    """
    file = problems.file
    kind = detect(data[start : start + 200])
    first = data[start : start + 80].split(b"\n", 1)[0].decode("latin-1").rstrip()
    if kind.kind != "rinex_obs":
        found = kind.kind if kind.kind != "unknown" else first
        raise StarwiseError(
            "not an observation file", file=file, line=line, found=found, wanted="RINEX observation data"
        )
    header = Header(version_text=kind.version, system=kind.system or "G")
    try:
        header.version = float(kind.version)
    except ValueError:
        header.version = 0.0
    if not 2.0 <= header.version < 5.0:
        raise StarwiseError("unknown RINEX version", file=file, line=line, found=kind.version, wanted="2.00 to 4.99")
    lines: list[str] = []
    pos = start
    while True:
        if pos >= len(data) or len(lines) > MAX_HEADER_LINES or data[pos : pos + 1] == b">":
            raise StarwiseError("the header has no END OF HEADER", file=file, line=line + len(lines))
        eol = data.find(b"\n", pos, pos + 10_000)
        if eol < 0:
            eol = min(len(data), pos + 10_000)
        text = data[pos:eol].decode("latin-1").rstrip()
        pos = eol + 1
        lines.append(text)
        if text[60:80].strip().upper() == "END OF HEADER" or text.strip().upper() == "END OF HEADER":
            break
    apply_lines(header, lines, line, problems)
    if not any(header.codes.values()):
        wanted = "# / TYPES OF OBSERV" if header.version < 3 else "SYS / # / OBS TYPES"
        raise StarwiseError("the header declares no observations", file=file, line=line, wanted=wanted)
    _settle_time_system(header, line, problems)
    return header, min(pos, len(data)), line + len(lines)


def apply_lines(header: Header, lines: Iterable[str], line: int, problems: Problems) -> None:
    """Take header lines into account, those of a file's head or of an event in its body.

    Parameters
    ----------
    header : Header
        Changed in place.
    lines : iterable of str
        The lines, without their ends.
    line : int
        Number of the first.
    problems : Problems
        Receives lines that could not be used.

    Raises
    ------
    StarwiseError
        Observation codes whose number differs from the one stated, or an unknown time system.
    """
    block = _Block(problems.file)
    for number, text in enumerate(lines, line):
        label = text[60:80].strip().upper()
        try:
            if label in ("SYS / # / OBS TYPES", "# / TYPES OF OBSERV"):
                if label.startswith("#") != (header.version < 3.0):
                    raise ValueError("of another version")
                block.observation_types(text, number, label)
            elif label == "SYS / SCALE FACTOR":
                block.scale_factor(text, header)
            else:
                _simple_line(header, label, text)
        except ValueError:
            problems.add(number, f"header line that cannot be read: {label}")
    header.codes.update(block.finish())


class _Block:
    """Observation codes and scale factors, which run over several lines."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.codes: dict[str, list[str]] = {}
        self.stated: dict[str, tuple[int, int]] = {}
        self.system: str | None = None
        self.scaled: tuple[str, float] | None = None

    def observation_types(self, text: str, line: int, label: str) -> None:
        old = label.startswith("#")
        if text[:6].strip():
            self.system = "" if old else text[0]
            count = text[:6] if old else text[3:6]
            self.codes[self.system] = []
            self.stated[self.system] = (_integer(count, self.file, line, label), line)
        if self.system is None:
            raise ValueError("continuation of nothing")
        step, width = (6, 60) if old else (4, 58)
        found = [text[i : i + step].strip() for i in range(6, width, step)]
        self.codes[self.system] += [code for code in found if code]

    def scale_factor(self, text: str, header: Header) -> None:
        if text[0] != " ":
            system, factor = text[0], float(text[2:6])
            if not 0.0 < factor < 1e7:
                raise ValueError("not a factor")
            self.scaled = (system, factor)
            if not text[8:10].strip() or int(text[8:10]) == 0:
                header.scale[system, ""] = factor
        if self.scaled is None:
            raise ValueError("continuation of nothing")
        for code in text[10:58].split():
            header.scale[self.scaled[0], code] = self.scaled[1]

    def finish(self) -> dict[str, list[str]]:
        for system, (count, line) in self.stated.items():
            found = len(self.codes[system])
            if found != count:
                raise StarwiseError(
                    "the number of observation types is not what the header lists",
                    file=self.file,
                    line=line,
                    found=f"{count} stated, {found} listed",
                )
        return self.codes


def _integer(text: str, file: str, line: int, label: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise StarwiseError(f"{label}: not a number", file=file, line=line, found=text) from None


def _simple_line(header: Header, label: str, text: str) -> None:
    """One-line records; ValueError if the content is not what the label promises."""
    if label == "MARKER NAME":
        header.marker = text[:60].strip()
    elif label == "REC # / TYPE / VERS":
        header.receiver = text[20:40].strip()
    elif label == "ANT # / TYPE":
        header.antenna = text[20:40].strip()
    elif label == "APPROX POSITION XYZ":
        x, y, z = _three(text)
        header.approx_pos_e = (x, y, z) if x * x + y * y + z * z > 1.0 else None
    elif label == "ANTENNA: DELTA H/E/N":
        header.antenna_hen = _three(text)
    elif label == "INTERVAL":
        interval = float(text[:10])
        header.interval_s = interval if 0.0 < interval < 1e6 else None
    elif label == "TIME OF FIRST OBS":
        header.time_system = text[43:60].strip(" 0123456789.").upper()
    elif label == "SIGNAL STRENGTH UNIT":
        header.cn0_unit = text[:20].strip()
    elif label == "RCV CLOCK OFFS APPL":
        header.clock_applied = text[:6].strip() == "1"
    elif label == "GLONASS SLOT / FRQ #":
        left = _SLOT.sub("", text[3:60])
        if left.strip():
            raise ValueError("not all of the line is slots and channels")
        for number, channel in _SLOT.findall(text[3:60]):
            if not -7 <= int(channel) <= 13:  # -7..6 today, up to 13 before 2005
                raise ValueError("not a channel")
            header.channels[sv_id(f"R{number.strip()}")] = int(channel)


def _three(text: str) -> tuple[float, float, float]:
    words = text[:60].split()
    if len(words) != 3:  # large numbers fill their columns
        words = [text[i : i + 14] for i in (0, 14, 28)]
    x, y, z = (float(word) for word in words)
    if not all(abs(v) < 1e9 for v in (x, y, z)):
        raise ValueError("not finite")
    return x, y, z


def _settle_time_system(header: Header, line: int, problems: Problems) -> None:
    name = _TIME_ALIAS.get(header.time_system, header.time_system)
    if not name:
        name = _DEFAULT_TIME.get(header.system, "GPS")
        if header.system not in SYSTEMS:
            problems.add(line, "mixed file that does not name its time system: GPS taken")
    if name not in ("GPS", "GLO", "GAL", "QZS", "BDT", "IRN", "UTC"):
        wanted = "GPS, GLO, GAL, QZS, BDT or IRN"
        raise StarwiseError("unknown time system", file=problems.file, line=line, found=name, wanted=wanted)
    header.time_system = name
