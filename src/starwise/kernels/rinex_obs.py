"""Bodies of RINEX observation files, versions 3 and 4: bytes in, rows out.

Columns follow RINEX 3.05 tables A2 and A3, counted from 0 here. Nothing in the text is trusted: every index
is checked against the length of the buffer or the capacity of the outputs before it is used.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.constants import N_SYSTEMS, SYSTEMS
from starwise.kernels._jit import njit
from starwise.kernels.text import parse_float, parse_int

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
N_PROBLEMS = 11

MAX_LINES = 1024  # satellite lines of one epoch: 7 systems x 99 numbers fit
KIND_C, KIND_L, KIND_D, KIND_S = 0, 1, 2, 3

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
    kind : (7, F) int8
        0 code, 1 phase, 2 Doppler, 3 signal strength, -1 not kept.
    slot : (7, F) int16
        Signal of the field, an index into ``sig``.
    divisor : (7, F) float64
        1000 times the scale factor: fields are integers of thousandths.
    n_slots : (7,) int64
        Signals declared.
    sig : (7, S) int16
        Signal identifiers in file order.
    other : (7, S) int16
        Signal that takes over phase, Doppler and strength when its own code is blank (RINEX 2), -1 for none.
    system : int
        System index meant by a blank system letter, -1 if none is.
    picoseconds : int
        1 if the epoch record may carry them (RINEX 4.02 and later).
    """

    n_fields: NDArray[np.int64]
    kind: NDArray[np.int8]
    slot: NDArray[np.int16]
    divisor: NDArray[np.float64]
    n_slots: NDArray[np.int64]
    sig: NDArray[np.int16]
    other: NDArray[np.int16]
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
    """Work space of one epoch and one satellite record."""

    sv: NDArray[np.int64]
    start: NDArray[np.int64]
    end: NDArray[np.int64]
    value: NDArray[np.float64]
    """(S, 4) by signal and kind."""
    have: NDArray[np.uint8]
    """(S,) bit per kind."""
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
    whole = 0
    if i == sec + 3:
        return 0, False
    while i < sec + 3:
        if not 48 <= buf[i] <= 57:
            return 0, False
        whole = whole * 10 + (buf[i] - 48)
        i += 1
    if buf[i] != 46 or whole > 60:
        return 0, False
    ns = 0
    for k in range(1, 8):
        c = buf[i + k]
        if c == 32:
            c = np.uint8(48)
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
    system = _SYSTEM_OF_LETTER[buf[pos]]
    if buf[pos] == 32:
        system = blank_system
    a, b = buf[pos + 1], buf[pos + 2]
    if a == 32:
        a = np.uint8(48)
    if system < 0 or not (48 <= a <= 57 and 48 <= b <= 57):
        return -1
    number = (a - 48) * 10 + (b - 48)
    if number == 0:
        return -1
    return system << 8 | number


@njit
def read_fields(
    buf: NDArray[np.uint8],
    start: int,
    end: int,
    system: int,
    first: int,
    last: int,
    layout: Layout,
    scratch: Scratch,
    problems: NDArray[np.int64],
) -> None:
    """Fields ``first:last`` of a record (F14.3, LLI, SSI: 16 columns each) from the text ``buf[start:end]``.

    A zero is a missing value (RINEX 3.05 section 6.7: "missing observations are written as 0.0 or blanks"),
    for a Doppler as well: one of 10 million is exactly 0, while receivers without Doppler write it on every
    line. A field that the end of the line cuts short is not a value.
    """
    p = start
    for f in range(first, last):
        if p >= end:
            break
        kind = layout.kind[system, f]
        if kind >= 0:
            slot = layout.slot[system, f]
            value = 0.0
            ok = False
            if p + 14 <= end and buf[p + 10] == 46:
                i = p
                stop = p + 10
                while i < stop and buf[i] == 32:
                    i += 1
                negative = i < stop and buf[i] == 45
                if negative:
                    i += 1
                whole = 0
                ok = True
                while i < stop:
                    digit = np.int64(buf[i]) - 48
                    ok &= 0 <= digit <= 9
                    whole = whole * 10 + digit
                    i += 1
                for i in range(p + 11, p + 14):
                    digit = np.int64(buf[i]) - 48
                    ok &= 0 <= digit <= 9
                    whole = whole * 10 + digit
                value = whole / layout.divisor[system, f]
                if negative:
                    value = -value
            if not ok:
                stop = min(p + 14, end)
                value, ok = parse_float(buf, p, stop)
                blank = ok and value != value
                if blank or (ok and stop == p + 14):
                    value = 0.0 if blank else value * 1000.0 / layout.divisor[system, f]
                else:
                    note(problems, BAD_VALUE, p)
                    value = 0.0
            if value != 0.0:
                scratch.value[slot, kind] = value
                scratch.have[slot] |= 1 << kind
                if kind <= KIND_L and p + 15 < end:
                    ssi = buf[p + 15]
                    if 49 <= ssi <= 57 and (kind == KIND_L or scratch.ssi[slot] == 0):
                        scratch.ssi[slot] = ssi - 48
            if kind == KIND_L and p + 14 < end:
                lli = buf[p + 14]
                if 48 <= lli <= 55:
                    scratch.lli[slot] = lli - 48
                elif lli != 32 and not 56 <= lli <= 57:
                    note(problems, BAD_VALUE, p)
        p += 16


@njit
def clear_record(n: int, scratch: Scratch) -> None:
    """Empty the record's scratch."""
    for s in range(n):
        scratch.have[s] = 0
        scratch.lli[s] = 0
        scratch.ssi[s] = 0


@njit
def emit_record(sv: int, system: int, row: int, layout: Layout, scratch: Scratch, out: Output) -> int:
    """Write the rows of one satellite; returns the next row.

    Signals without any value are left out; a satellite without any keeps one row of its system's first
    signal. The caller has made sure that there is room for all signals of the system.
    """
    n = layout.n_slots[system]
    first = row
    for s in range(n):
        to = layout.other[system, s]
        if to >= 0 and not scratch.have[s] & 1 and scratch.have[to] & 1 and not scratch.have[to] & 14:
            scratch.have[to] |= scratch.have[s]
            for kind in range(1, 4):
                scratch.value[to, kind] = scratch.value[s, kind]
            scratch.lli[to] = scratch.lli[s]
            if scratch.ssi[s] > 0:
                scratch.ssi[to] = scratch.ssi[s]
            scratch.have[s] = 0
            scratch.lli[s] = 0
    for s in range(n):
        have = scratch.have[s]
        if have == 0 and not (row == first and s == n - 1):
            continue
        at = s if have else 0
        out.sv[row] = sv
        out.sig[row] = layout.sig[system, at]
        for kind in range(4):
            out.values[kind, row] = scratch.value[s, kind] if have & (1 << kind) else np.nan
        if not have & 8 and have & 3 and scratch.ssi[s] > 0:
            out.values[KIND_S, row] = 6.0 * scratch.ssi[s] + 3.0  # middle of its 6 dB-Hz class, RINEX 3.05 table 7
        out.lli[row] = scratch.lli[s]
        row += 1
    return row


@njit
def sort_lines(n: int, scratch: Scratch) -> None:
    """Sort the epoch's lines by satellite (insertion, stable: they mostly are)."""
    for i in range(1, n):
        sv, start, end = scratch.sv[i], scratch.start[i], scratch.end[i]
        j = i - 1
        while j >= 0 and scratch.sv[j] > sv:
            scratch.sv[j + 1] = scratch.sv[j]
            scratch.start[j + 1] = scratch.start[j]
            scratch.end[j + 1] = scratch.end[j]
            j -= 1
        scratch.sv[j + 1], scratch.start[j + 1], scratch.end[j + 1] = sv, start, end


@njit
def epoch_record(buf: NDArray[np.uint8], pos: int, end: int, layout: Layout) -> tuple[int, bool, int, int, float, bool]:
    """Epoch record of version 3: label ns, its validity, flag and satellites (-1 bad), clock s, its validity."""
    if end - pos < 32:
        return 0, False, -1, -1, np.nan, True
    flag = 0 if buf[pos + 31] == 32 else np.int64(buf[pos + 31]) - 48
    if not 0 <= flag <= 6:
        flag = -1
    count, ok = parse_int(buf, pos + 32, min(pos + 35, end))
    if not ok or count < 0:
        count = -1
    year, ok1 = parse_int(buf, pos + 2, pos + 6)
    month, ok2 = parse_int(buf, pos + 7, pos + 9)
    day, ok3 = parse_int(buf, pos + 10, pos + 12)
    hour, ok4 = parse_int(buf, pos + 13, pos + 15)
    minute, ok5 = parse_int(buf, pos + 16, pos + 18)
    label, valid = label_ns(buf, year, month, day, hour, minute, pos + 18)
    valid = valid and ok1 and ok2 and ok3 and ok4 and ok5
    clock, clock_ok = np.nan, True
    if end > pos + 41:
        clock, clock_ok = parse_float(buf, pos + 41, min(pos + 56, end))
    if layout.picoseconds and end >= pos + 41:
        pico, ok = parse_int(buf, pos + 36, pos + 41)
        if ok and pico >= 0:
            label += (pico + 500) // 1000
    return label, valid, flag, count, clock, clock_ok


@njit
def next_record(buf: NDArray[np.uint8], pos: int, n: int) -> int:
    """Start of the first line from ``pos`` on that opens an epoch or a header; ``n`` if none does."""
    while pos < n:
        eol = line_feed(buf, pos, n)
        if buf[pos] == 62 or is_version_line(buf, pos, eol):
            return pos
        pos = eol + 1
    return n


@njit
def read_body(
    buf: NDArray[np.uint8],
    layout: Layout,
    state: NDArray[np.int64],
    problems: NDArray[np.int64],
    scratch: Scratch,
    out: Output,
) -> int:
    """Epochs of a RINEX 3 or 4 body from ``state[POS]`` on, until something needs the caller.

    Everything up to the next ``>`` belongs to an epoch, whatever number of satellites its record states: a
    missing, doubled or damaged line costs itself only.

    Parameters
    ----------
    buf : (n,) uint8
        The file.
    layout, state, problems, scratch
        See the classes and names above; changed in place, except the layout.
    out : Output
        Filled from ``state[EPOCHS]`` and ``state[ROWS]`` on.

    Returns
    -------
    int
        `DONE`, `FULL`, `EVENT` or `SPLICE`.
    """
    n = len(buf)
    pos = state[POS]
    while pos < n:
        eol = line_feed(buf, pos, n)
        end = text_end(buf, pos, eol)
        if end == pos or buf[pos] != 62:
            if is_version_line(buf, pos, end):
                state[POS] = pos
                return SPLICE
            if end > pos:
                note(problems, JUNK_LINE, pos)
            pos = eol + 1
            continue
        label, valid, flag, count, clock, clock_ok = epoch_record(buf, pos, end, layout)
        if flag >= 2 or flag < 0 or not valid:
            after = next_record(buf, eol + 1, n)
            if 2 <= flag <= 5:
                state[AT], state[TO], state[FLAG], state[WANTED] = eol + 1, after, flag, count
                state[POS] = after
                return EVENT
            note(problems, SLIP_RECORDS if flag == 6 else BAD_EPOCH, pos)
            pos = after
            continue

        # the satellite lines, then their order
        n_sat, listed, need = 0, 0, 0
        line = eol + 1
        while line < n and buf[line] != 62:
            eol = line_feed(buf, line, n)
            end = text_end(buf, line, eol)
            sv = satellite(buf, line, layout.system) if end - line >= 3 else -1
            if sv < 0:
                if is_version_line(buf, line, end):
                    break
                if end > line:
                    note(problems, JUNK_LINE, line)
            elif eol == n and count >= 0 and listed + 1 < count:
                note(problems, CUT_LINE, line)  # the file ends within the line and within the epoch
            elif n_sat == MAX_LINES:
                note(problems, TOO_MANY, line)
            else:
                listed += 1
                if layout.n_slots[sv >> 8] == 0:
                    note(problems, UNDECLARED, line)
                else:
                    scratch.sv[n_sat], scratch.start[n_sat], scratch.end[n_sat] = sv, line, end
                    need += layout.n_slots[sv >> 8]
                    n_sat += 1
            line = eol + 1
        row = state[ROWS]
        epoch = state[EPOCHS]
        if epoch >= len(out.t) or row + need > len(out.sv):
            state[POS], state[NEED] = pos, need
            return FULL
        if listed != count:
            note(problems, SAT_COUNT, pos)
        if not clock_ok:
            note(problems, BAD_VALUE, pos)
        sort_lines(n_sat, scratch)
        for i in range(n_sat):
            sv = scratch.sv[i]
            if i > 0 and sv == scratch.sv[i - 1]:
                note(problems, SAT_TWICE, scratch.start[i])
                continue
            system = sv >> 8
            clear_record(layout.n_slots[system], scratch)
            read_fields(
                buf,
                scratch.start[i] + 3,
                scratch.end[i],
                system,
                0,
                layout.n_fields[system],
                layout,
                scratch,
                problems,
            )
            row = emit_record(sv, system, row, layout, scratch, out)
        out.t[epoch], out.flag[epoch], out.clock[epoch], out.at[epoch] = label, flag, clock, pos
        out.offsets[epoch + 1] = row
        state[EPOCHS], state[ROWS] = epoch + 1, row
        pos = line
    state[POS] = n
    return DONE


def new_scratch(n_slots: int) -> Scratch:
    """Work space for records of at most ``n_slots`` signals."""
    lines: tuple[Any, ...] = tuple(np.zeros(MAX_LINES, dtype=np.int64) for _ in range(3))
    small: tuple[Any, ...] = tuple(np.zeros(n_slots, dtype=np.uint8) for _ in range(3))
    return Scratch(*lines, np.zeros((n_slots, 4)), *small)


assert len(SYSTEMS) == N_SYSTEMS
