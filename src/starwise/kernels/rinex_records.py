"""What the bodies of all RINEX observation files share: lines, time labels, names, and the fields of satellites.

Columns are counted from 0. Nothing in the text is trusted: every index is checked against the length of the buffer
or the capacity of the outputs before it is used.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.constants import SYSTEMS
from starwise.kernels._jit import njit
from starwise.kernels.text import parse_float

# What a call ended with.
DONE = 0
FULL = 1  # the outputs are too small: `state[NEED]` rows or one epoch more, then call again
EVENT = 2  # special records (flags 2-5) between state[AT] and state[TO]
SPLICE = 3  # a second header starts at state[POS]

# The state that travels between calls.
POS, EPOCHS, ROWS, AT, TO, FLAG, NEED, WANTED = 0, 1, 2, 3, 4, 5, 6, 7
N_STATE = 8

# Things dealt with: a count and the byte position of the first case each.
BAD_EPOCH = 0
SAT_COUNT = 1
JUNK_LINE = 2
UNDECLARED = 3
BAD_VALUE = 4
SAT_TWICE = 5
CUT_LINE = 6
SLIP_RECORDS = 7
LOST_EPOCH = 8
TOO_MANY = 9
BAD_NAME = 10
EXTRA = 11
N_PROBLEMS = 12

MAX_LINES = 1024  # satellite lines of one epoch: 7 systems x 99 numbers fit
KIND_L = 1

_SYSTEM_OF_LETTER = np.full(256, -1, dtype=np.int64)
for _i, _letter in enumerate(SYSTEMS):
    _SYSTEM_OF_LETTER[ord(_letter)] = _i
_VERSION_LABEL = np.frombuffer(b"RINEX VERSION / TYPE", dtype=np.uint8).copy()
_DAYS = np.array([31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31])
_DAYS_BEFORE = np.array([0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334])


class Layout(NamedTuple):
    """Where each field of a satellite's record goes, by system index.

    Attributes
    ----------
    n_fields : (7,) int64
        Fields declared.
    place : (7, F) int64
        4 x signal + kind (0 code, 1 phase, 2 Doppler, 3 strength), signal an index into ``sig``; -1 not kept.
    divisor : (7, F) float64
        1000 times the scale factor: fields are integers of thousandths.
    lli, ssi : (7, F) int64
        Signal whose loss of lock indicator this field has, and whose strength its digit has to stand in for; -1.
    n_slots : (7,) int64
        Signals declared.
    sig : (7, S) int16
        Signal identifiers in file order.
    other : (7, S) int64
        Signal that takes over phase, Doppler and strength when its own code is blank (RINEX 2), -1 for none.
    per_line : int
        Fields on a line.
    system : int
        System index meant by a blank system letter, -1 if none.
    picoseconds : int
        1 if the epoch record may carry them (RINEX 4.02 and later).
    """

    n_fields: NDArray[np.int64]
    place: NDArray[np.int64]
    divisor: NDArray[np.float64]
    lli: NDArray[np.int64]
    ssi: NDArray[np.int64]
    n_slots: NDArray[np.int64]
    sig: NDArray[np.int16]
    other: NDArray[np.int64]
    per_line: int
    system: int
    picoseconds: int


class Output(NamedTuple):
    """Preallocated outputs: epochs (t, flag, clock, at, offsets) and rows (sv, sig, values by kind, lli)."""

    t: NDArray[np.int64]
    """Label of the epoch in the file's time system, ns since 1980-01-06."""
    flag: NDArray[np.uint8]
    clock: NDArray[np.float64]
    at: NDArray[np.int64]
    """Byte position of the epoch record."""
    offsets: NDArray[np.int64]
    sv: NDArray[np.int16]
    sig: NDArray[np.int16]
    values: NDArray[np.float64]
    """(4, rows) by kind."""
    lli: NDArray[np.uint8]


class Scratch(NamedTuple):
    """Work space of one epoch: satellites, their order, where their lines start and end; then one record."""

    sv: NDArray[np.int64]
    order: NDArray[np.int64]
    start: NDArray[np.int64]
    """Line j of satellite i at ``i * lines + j``."""
    end: NDArray[np.int64]
    value: NDArray[np.float64]
    """By place, NaN where blank."""
    lli: NDArray[np.uint8]
    ssi: NDArray[np.uint8]


@njit
def note(problems: NDArray[np.int64], what: int, pos: int) -> None:
    """Count a problem and keep where it happened first."""
    if problems[what, 0] == 0:
        problems[what, 1] = pos
    problems[what, 0] += 1


@njit
def line_feed(buf: NDArray[np.uint8], pos: int, n: int) -> int:
    """Position of the next line feed, or ``n``."""
    while pos < n and buf[pos] != 10:
        pos += 1
    return pos


@njit
def text_end(buf: NDArray[np.uint8], start: int, eol: int) -> int:
    """End of the line's text: without carriage return and trailing blanks."""
    while eol > start and (buf[eol - 1] == 32 or buf[eol - 1] == 13):
        eol -= 1
    return eol


@njit
def is_version_line(buf: NDArray[np.uint8], start: int, end: int) -> bool:
    """Whether this is the first line of a header (label in columns 60-79)."""
    if end - start < 60 + len(_VERSION_LABEL):
        return False
    for i in range(len(_VERSION_LABEL)):  # noqa: SIM110 (kernel)
        if buf[start + 60 + i] != _VERSION_LABEL[i]:
            return False
    return True


@njit
def label_ns(
    buf: NDArray[np.uint8], year: int, month: int, day: int, hour: int, minute: int, sec: int
) -> tuple[int, bool]:
    """Calendar label as ns since 1980-01-06, and whether it is one.

    The integers are read already; ``sec`` is the position of the F11.7 field of seconds, read digit by digit
    so that no nanosecond is lost.
    """
    leap = (year % 4 == 0 and year % 100 != 0) or year % 400 == 0
    if not (1980 <= year < 2200 and 1 <= month <= 12 and 0 <= hour <= 24 and 0 <= minute <= 60):
        return 0, False
    last = _DAYS[month - 1] + (1 if leap and month == 2 else 0)
    if not 1 <= day <= last:
        return 0, False
    i = sec
    while i < sec + 3 and buf[i] == 32:
        i += 1
    whole: Any = 0
    if i == sec + 3:
        return 0, False
    while i < sec + 3:
        if not 48 <= buf[i] <= 57:
            return 0, False
        whole = whole * 10 + (np.int64(buf[i]) - 48)
        i += 1
    if buf[i] != 46 or whole > 60:
        return 0, False
    ns: Any = 0
    for k in range(1, 8):
        c = np.int64(buf[i + k])
        if c == 32:
            c = np.int64(48)
        if not 48 <= c <= 57:
            return 0, False
        ns = ns * 10 + (c - 48)
    years = year - 1980
    leaps = (years + 3) // 4 - (1 if year > 2100 else 0)
    days = years * 365 + leaps + _DAYS_BEFORE[month - 1] + (1 if leap and month > 2 else 0) + day - 1 - 5
    return ((days * 86400 + hour * 3600 + minute * 60 + whole) * 10_000_000 + ns) * 100, days >= 0


@njit
def satellite(buf: NDArray[np.uint8], pos: int, blank_system: int) -> int:
    """Satellite identifier of the three bytes at ``pos`` (``G05``, ``G 5``, `` 5``), -1 if it is none."""
    system = int(_SYSTEM_OF_LETTER[buf[pos]])
    if buf[pos] == 32:
        system = blank_system
    a: Any = np.int64(buf[pos + 1])
    b: Any = np.int64(buf[pos + 2])
    if a == 32:
        a = np.int64(48)
    if system < 0 or not (48 <= a <= 57 and 48 <= b <= 57):
        return -1
    number: int = (a - 48) * 10 + (b - 48)
    if number == 0:
        return -1
    return system << 8 | number


@njit
def take_over(s: int, to: int, value: NDArray[np.float64], lli: NDArray[np.uint8], ssi: NDArray[np.uint8]) -> None:
    """Move phase, Doppler and strength from signal ``s`` to ``to`` if only the latter has a code."""
    s4, to4 = 4 * s, 4 * to
    if not np.isnan(value[s4]) or np.isnan(value[to4]) or not np.isnan(value[to4 + 1]):
        return
    for kind in range(1, 4):
        value[to4 + kind] = value[s4 + kind]
        value[s4 + kind] = np.nan
    lli[to] = lli[s]
    ssi[to] = max(ssi[s], ssi[to])
    ssi[s] = 0


@njit
def read_records(
    buf: NDArray[np.uint8],
    n_sat: int,
    row: int,
    layout: Layout,
    scratch: Scratch,
    problems: NDArray[np.int64],
    out: Output,
) -> int:
    """Rows of an epoch's satellites, in their order, from their lines; returns the next row.

    A field is F14.3, LLI and SSI: 16 columns. A zero is a missing value (RINEX 3.05 section 6.7: "missing
    observations are written as 0.0 or blanks"), for a Doppler as well: one of 10 million is exactly 0, while
    receivers without Doppler write it on every line. A field that the end of the line cuts short is not a value.

    Signals without any value are left out; a satellite without any keeps one row of its system's first signal. The
    caller has made sure that there is room for all signals.
    """
    value, lli, ssi, starts, ends = scratch.value, scratch.lli, scratch.ssi, scratch.start, scratch.end
    values, place, divisor, lli_of, ssi_of = out.values, layout.place, layout.divisor, layout.lli, layout.ssi
    out_sv, out_sig, out_lli, sig, other = out.sv, out.sig, out.lli, layout.sig, layout.other
    per_line = layout.per_line
    lines = (np.max(layout.n_fields) + per_line - 1) // per_line
    last_sv = -1
    for i in range(n_sat):
        at = scratch.order[i]
        sv = scratch.sv[at]
        if sv < 0:
            continue
        if sv == last_sv:
            note(problems, SAT_TWICE, starts[at * lines])
            continue
        last_sv = sv
        system = sv >> 8
        fields, slots = layout.n_fields[system], layout.n_slots[system]
        for s in range(slots):
            lli[s] = 0
            ssi[s] = 0
        for k in range(4 * slots):
            value[k] = np.nan
        for line in range(lines):
            p, end = starts[at * lines + line], ends[at * lines + line]
            stop_field = min((line + 1) * per_line, fields)
            if end - p > 16 * (stop_field - line * per_line):
                note(problems, EXTRA, p)
            for f in range(line * per_line, stop_field):
                if p >= end:
                    break
                to = place[system, f]
                if to >= 0:
                    whole, v = np.int64(0), np.nan
                    ok: Any = False
                    if p + 14 <= end and buf[p + 10] == 46:
                        i0 = p
                        dot = p + 10
                        while i0 < dot and buf[i0] == 32:
                            i0 += 1
                        negative = i0 < dot and buf[i0] == 45
                        if negative:
                            i0 += 1
                        ok = True
                        while i0 < dot:
                            digit = np.int64(buf[i0]) - 48
                            ok &= 0 <= digit <= 9
                            whole = whole * 10 + digit
                            i0 += 1
                        for k in range(p + 11, p + 14):
                            digit = np.int64(buf[k]) - 48
                            ok &= 0 <= digit <= 9
                            whole = whole * 10 + digit
                        if ok and whole != 0:
                            v = (-whole if negative else whole) / divisor[system, f]
                    if not ok:
                        stop = min(p + 14, end)
                        v, ok = parse_float(buf, p, stop)
                        if not ok or (stop < p + 14 and not np.isnan(v)):
                            note(problems, BAD_VALUE, p)
                            v = np.nan
                        v = v * 1000.0 / divisor[system, f] if v != 0.0 else np.nan
                    value[to] = v
                    s = lli_of[system, f]
                    if s >= 0 and p + 14 < end:
                        c = buf[p + 14]
                        if 48 <= c <= 55:
                            lli[s] = c - 48
                        elif c != 32 and not 56 <= c <= 57:
                            note(problems, BAD_VALUE, p)
                    s = ssi_of[system, f]
                    use = s >= 0 and v == v and p + 15 < end and (to & 3 == KIND_L or ssi[s] == 0)
                    if use and 49 <= buf[p + 15] <= 57:
                        ssi[s] = buf[p + 15] - 48
                p += 16
        first = row
        for s in range(slots):
            if other[system, s] >= 0:
                take_over(s, other[system, s], value, lli, ssi)
        for s in range(slots):
            code, phase, doppler, cn0 = value[4 * s], value[4 * s + 1], value[4 * s + 2], value[4 * s + 3]
            if code != code and phase != phase and doppler != doppler and cn0 != cn0:
                continue
            if ssi[s] > 0 and cn0 != cn0:
                cn0 = 6.0 * ssi[s] + 3.0  # middle of its class, RINEX 3.05 section 5.7
            out_sv[row], out_sig[row], out_lli[row] = sv, sig[system, s], lli[s]
            values[0, row], values[1, row], values[2, row], values[3, row] = code, phase, doppler, cn0
            row += 1
        if row == first:
            out_sv[row], out_sig[row], out_lli[row] = sv, sig[system, 0], 0
            for k in range(4):
                values[k, row] = np.nan
            row += 1
    return row


@njit
def sort_satellites(n: int, scratch: Scratch) -> None:
    """Order of the epoch's satellites by identifier (insertion, stable: they mostly are in order)."""
    sv, order = scratch.sv, scratch.order
    for i in range(n):
        j = i - 1
        while j >= 0 and sv[order[j]] > sv[i]:
            order[j + 1] = order[j]
            j -= 1
        order[j + 1] = i


def new_scratch(n_slots: int, lines: int) -> Scratch:
    """Work space for records of at most ``n_slots`` signals on ``lines`` lines."""
    sv, order = np.zeros(MAX_LINES, dtype=np.int64), np.zeros(MAX_LINES, dtype=np.int64)
    start, end = np.zeros(MAX_LINES * lines, dtype=np.int64), np.zeros(MAX_LINES * lines, dtype=np.int64)
    lli, ssi = np.zeros(n_slots, dtype=np.uint8), np.zeros(n_slots, dtype=np.uint8)
    return Scratch(sv, order, start, end, np.zeros(4 * n_slots), lli, ssi)
