"""RINEX navigation files 2, 3 and 4 as `BroadcastRecords`."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from starwise.constants import MESSAGE_NAMES, SYS_C, SYS_E, SYS_J, SYS_R, SYS_S, SYSTEMS
from starwise.errors import StarwiseError
from starwise.gnsstime import label_to_gpst, leap_seconds
from starwise.io.files import read_bytes
from starwise.io.lines import line_starts
from starwise.io.nav_header import NavHeader, ionosphere, parse_header
from starwise.io.nav_merge import concatenate, merge, take
from starwise.io.nav_records import Fault, Records, keplerian, tabulated
from starwise.kernels.rinex_nav import (
    C_KIND,
    C_LABEL,
    C_MSG,
    C_PRN,
    C_STATE,
    C_SYS,
    KIND_EPH,
    KIND_ION,
    KIND_STO,
    N_COLUMNS,
    N_VALUES,
    REC_OK,
    parse_records,
)
from starwise.types import F8, I8, BroadcastRecords, Problem

_STATE_TEXT: Final = {
    1: "satellite not readable",
    2: "epoch not readable",
    3: "lines missing",
    4: "lines too many",
    5: "message not supported",
    6: "text that is no record",
    7: "text out of its columns",
}
_FIRST_LABEL: Final = b"RINEX VERSION / TYPE"
Sent = tuple[int, str, tuple[float, ...]]


class _Reading:
    """What is gathered while files are read."""

    def __init__(self) -> None:
        self.parts: list[Records] = []
        self.headers: list[NavHeader] = []
        self.sent: list[Sent] = []
        self.problems: dict[tuple[str, str], Problem] = {}
        self.counts: Counter[str] = Counter()
        self.files: list[str] = []

    def problem(self, what: str, lines: I8, *, count_as: str | None = None) -> None:
        """Note a problem of the current file that occurs at some lines."""
        if len(lines) == 0:
            return
        key = (self.files[-1], what)
        found = Problem(self.files[-1], int(lines.min()), what, len(lines))
        if key in self.problems:
            old = self.problems[key]
            found = replace(old, count=old.count + found.count)
        self.problems[key] = found
        if count_as is not None:
            self.counts[count_as] += len(lines)


def read_nav(*paths: str | Path) -> BroadcastRecords:
    """Broadcast navigation records of all systems out of one or more RINEX navigation files.

    RINEX 2.x (one system a file), 3.0x and 4.0x, plain or compressed. Several files are merged: identical
    records are kept once, of contradictory ones one version (see `starwise.io.nav_merge.merge`). Records
    that are damaged or make no orbit are left out. All of it is counted in ``counts`` and, with file and
    line, in ``problems``.

    ``counts`` has ``records`` (of every kind), ``STO``, ``EOP`` and ``ION`` records, ephemerides by system and
    message (``E FNAV``), those left out as ``corrupt``, ``unsupported``, ``duplicate`` or ``contradictory``, and the
    ones ``kept``.

    What is decided where files are ambiguous:

    * toe is the instant nearest to toc with the given seconds of week: week numbers of the wrong count (GPS weeks
      for BeiDou, weeks modulo 1024, week of transmission) do no harm. A record whose week cannot be meant is left
      out, unless most of its system are like that: then the writer has a habit, which is noted.
    * A transmission time more than a day from toe (one hour, GLONASS and SBAS) is not one: toe is taken.
    * ``health`` is the broadcast word: GPS and QZSS 6 bits (QZSS: bit 5 is the L1 health that counts, bit 4 L1C/A,
      3 L2C, 2 L5, 1 L1C, 0 L1C/B), Galileo DVS and HS of E1-B, E5a and E5b (RINEX 3.05 table A8), BeiDou SatH1;
      CNAV: bit 2 L1, 1 L2, 0 L5; BDS CNV1 to 3: HS.
      0 is healthy everywhere. GLONASS: B_n, plus 8 for l_n and 16 for an unhealthy almanac flag.
    * ``accuracy_m``: URA in metres as written, 0 read as index 0 (2 m), above 6144 m as inf; SISA, negative as inf.
      CNAV indices by IS-GPS-200N 30.3.3.1.1.4. GLONASS: F_T where given. BDS-3 CNV1 to 3: NaN.
    * ``iode`` of GLONASS is t_b, the number of the quarter hour of the Moscow day.

    Raises
    ------
    StarwiseError
        A file cannot be read, is no navigation file, or holds no usable record.
    """
    if not paths:
        raise StarwiseError("no navigation file given")
    reading = _Reading()
    for path in paths:
        _read_file(path, reading)
    records = concatenate(reading.parts) if reading.parts else None
    if records is None:
        raise StarwiseError("no ephemeris in the navigation files", file=str(paths[0]))
    merged, duplicates, losers = merge(records)
    for file in np.unique(records.file[losers]):
        lines = records.line[losers][records.file[losers] == file]
        what = "copies of a record contradict each other: one version kept, these left out"
        found = Problem(reading.files[file], int(lines.min()), what, len(lines))
        reading.problems[reading.files[file], what] = found
    reading.counts["duplicate"] = duplicates
    reading.counts["contradictory"] = len(losers)
    reading.counts["kept"] = len(merged.sv)
    leaps = [h.leap_s for h in reading.headers if h.leap_s is not None]
    return BroadcastRecords(
        sv=merged.sv,
        message=merged.message,
        toc_ns=merged.toc_ns,
        toe_ns=merged.toe_ns,
        t_tx_ns=merged.t_tx_ns,
        par=merged.par,
        tgd=merged.tgd,
        accuracy_m=merged.accuracy_m,
        health=merged.health,
        iode=merged.iode,
        iodc=merged.iodc,
        fit_s=merged.fit_s,
        source=merged.source,
        ionosphere=ionosphere(reading.headers, reading.sent),
        leap_s=leaps[-1] if leaps else None,
        counts=dict(reading.counts),
        problems=tuple(reading.problems.values()),
    )


def _read_file(path: str | Path, reading: _Reading) -> None:
    file = str(path)
    data = read_bytes(Path(path))
    reading.files.append(file)
    if not data[:4096].strip() and not data.strip():
        raise StarwiseError("the file is empty", file=file, wanted="a RINEX navigation file")
    starts = _header_starts(data)
    before = len(reading.parts), len(reading.sent)
    line = 1
    for start, end in zip(starts, [*starts[1:], len(data)], strict=True):
        section = data[:end] if end < len(data) else data
        header = parse_header(section, start, line, file)
        reading.headers.append(header)
        for problem in header.problems:
            reading.problems.setdefault((file, problem.what), problem)
        lines = _read_section(section, header, reading)
        line = header.first_line + lines
    if (len(reading.parts), len(reading.sent)) == before:
        first = next((p for (f, _), p in reading.problems.items() if f == file and "left out" in p.what), None)
        why = f": {first.what}" if first else ""
        raise StarwiseError(f"no usable navigation record{why}", file=file, line=first.line if first else None)


def _header_starts(data: bytes) -> list[int]:
    """Bytes where a header starts: one, unless files were joined end to end."""
    starts = [0]
    at = data.find(_FIRST_LABEL, 100)
    while at >= 0:
        start = data.rfind(b"\n", 0, at) + 1
        if at - start == 60 and start > starts[-1]:
            starts.append(start)
        at = data.find(_FIRST_LABEL, at + 1)
    return starts


def _read_section(data: bytes, header: NavHeader, reading: _Reading) -> int:
    """Read the records after one header; returns the number of lines."""
    buf = np.frombuffer(data, dtype=np.uint8)[header.body :]
    lines, first = line_starts(buf)
    if header.version == 4:
        starting = first == ord(">")
    elif header.version == 3:
        starting = first > ord(" ")
    else:
        second = np.where(lines[:-1] + 1 < lines[1:] - 1, buf[np.minimum(lines[:-1] + 1, len(buf) - 1)], 32)
        starting = (first > ord(" ")) | ((second > ord(" ")) & (first == ord(" ")))
    records = np.append(np.flatnonzero(starting), len(first)).astype(np.int64)
    n = len(records) - 1
    if n and records[0] > 0 and (first[: records[0]] > 32).any():
        reading.problem("text before the first record", np.array([header.first_line]))
    table = np.zeros((n, N_COLUMNS), dtype=np.int64)
    values = np.empty((n, N_VALUES))
    parse_records(buf, lines, records, header.version, header.system, table, values)
    at_line = header.first_line + records[:-1]
    _note_states(table, at_line, reading)
    good = table[:, C_STATE] == REC_OK
    _assemble(table, values, at_line, good & (table[:, C_KIND] == KIND_EPH), reading)
    _check_leap(header, table[good], reading)
    for row in np.flatnonzero(good & (table[:, C_KIND] == KIND_ION)):
        _ion_record(table[row], values[row], at_line[row : row + 1], reading)
    return len(first)


def _note_states(table: I8, at_line: I8, reading: _Reading) -> None:
    """Count records by kind and note those that could not be parsed."""
    reading.counts["records"] += len(table)
    for kind, name in ((1, "STO"), (2, "EOP"), (3, "ION")):
        number = int((table[:, C_KIND] == kind).sum())
        if number:
            reading.counts[name] += number
    unreadable = (table[:, C_STATE] != REC_OK) & ((table[:, C_KIND] <= KIND_EPH) | (table[:, C_KIND] > KIND_STO))
    for state, text in _STATE_TEXT.items():
        rows = unreadable & (table[:, C_STATE] == state)
        count_as = "unsupported" if state == 5 else "corrupt"
        reading.problem(f"{text}: record left out", at_line[rows], count_as=count_as)


def _assemble(table: I8, values: F8, at_line: I8, rows: np.ndarray, reading: _Reading) -> None:
    """Turn parsed ephemerides into columns, one system and message after another."""
    key = np.where(rows, table[:, C_SYS] * 256 + table[:, C_MSG], -1)
    for code in np.unique(key[rows]):
        system, message = divmod(int(code), 256)
        at = np.flatnonzero(key == code)
        convert = tabulated if system in (SYS_R, SYS_S) else None
        args = (table[at, C_PRN], table[at, C_LABEL], at_line[at], values[at])
        records, faults = convert(system, *args) if convert else keplerian(system, message, *args)
        for m, number in zip(*np.unique(records.message, return_counts=True), strict=True):
            reading.counts[f"{SYSTEMS[system]} {MESSAGE_NAMES[m]}"] += int(number)
        good = _sound(records, faults, SYSTEMS[system], reading)
        if good.any():
            part = take(records, good)
            part.file[:] = len(reading.files) - 1
            reading.parts.append(part)


def _sound(records: Records, faults: list[Fault], letter: str, reading: _Reading) -> np.ndarray:
    """Records without a fault; the others are noted with the first fault found."""
    good = np.ones(len(records.sv), dtype=bool)
    for what, bad in faults:
        reading.problem(f"{what}: record left out", records.line[good & bad], count_as="corrupt")
        good &= ~bad
    off = records.week_off & good
    if off.sum() * 2 > good.sum():
        reading.problem(f"week numbers of {letter} in an unknown count: not used", records.line[off])
    elif off.any():
        reading.problem("week contradicts the epoch: record left out", records.line[off], count_as="corrupt")
        good &= ~off
    return good


def _check_leap(header: NavHeader, table: I8, reading: _Reading) -> None:
    """Note leap seconds in the header that are not those of the first record's day."""
    if header.leap_s is None or len(table) == 0:
        return
    label = int(table[0, C_LABEL])
    if abs(header.leap_s - leap_seconds(label)) > 1:  # one off: announced for a day soon after, or old
        what = f"leap seconds {header.leap_s} in the header, {leap_seconds(label)} by the table: the table is used"
        reading.problem(what, np.array([header.first_line]))


def _ion_record(row: I8, v: F8, line: I8, reading: _Reading) -> None:
    """Ionosphere coefficients of a RINEX 4 ION record (RINEX 4.01 tables A32 to A34)."""
    system = int(row[C_SYS])
    name = int(row[C_MSG]).to_bytes(4, "big").lstrip(b"\0").decode("latin-1")
    scale = "BDT" if system == SYS_C else "UTC" if system == SYS_R else "GPS"
    t_ns = label_to_gpst(int(row[C_LABEL]), scale)
    letter = SYSTEMS[system]
    if system == SYS_E:
        values = v[:3]
    elif system == SYS_C and name == "CNVX":
        letter, values = "B", v[:9]
    else:
        values = v[:8]
        if system == SYS_J and v[8] == 1.0:  # QZSS: coefficients for the Japan area, not for everywhere
            return
    if not np.isfinite(values).all():
        reading.problem("ION record not readable: left out", line, count_as="corrupt")
        return
    reading.sent.append((t_ns, letter, tuple(float(x) for x in values)))
