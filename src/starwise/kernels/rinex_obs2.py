"""Bodies of RINEX observation files, version 2: bytes in, rows out.

Columns follow RINEX 2.11 table A2, counted from 0. Nothing marks an epoch record but its own pattern, and a lost or
doubled line shifts every satellite after it: an epoch whose lines do not end where the next record starts is dropped.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.rinex_records import (
    AT,
    BAD_EPOCH,
    BAD_NAME,
    BAD_VALUE,
    CUT_LINE,
    DONE,
    EPOCHS,
    EVENT,
    FLAG,
    FULL,
    LOST_EPOCH,
    MAX_LINES,
    NEED,
    POS,
    ROWS,
    SLIP_RECORDS,
    SPLICE,
    TO,
    UNDECLARED,
    WANTED,
    Layout,
    Output,
    Scratch,
    is_version_line,
    label_ns,
    line_feed,
    note,
    read_records,
    satellite,
    sort_satellites,
    text_end,
)
from starwise.kernels.text import parse_float, parse_int


@njit
def epoch_record2(buf: NDArray[np.uint8], pos: int, end: int) -> tuple[int, int, int]:
    """Epoch record of version 2: label ns, flag, number of satellites or lines; flag -1 if this is none.

    No line of values can pass for one: their decimal points stand in columns of digits here. The date of an event
    (flags 2 to 5) may be blank.
    """
    if end - pos < 29 or buf[pos] != 32 or buf[pos + 27] != 32:
        return 0, -1, -1
    flag: Any = np.int64(0) if buf[pos + 28] == 32 else np.int64(buf[pos + 28]) - 48
    if not 0 <= flag <= 6:
        return 0, -1, -1
    count, ok = parse_int(buf, pos + 29, min(pos + 32, end))
    if not ok or count < 0:
        count = -1
    if 2 <= flag <= 5:
        blank = True
        for i in range(pos, pos + 27):
            blank &= buf[i] == 32
        if blank:
            return 0, flag, count
    year, ok1 = parse_int(buf, pos + 1, pos + 3)
    month, ok2 = parse_int(buf, pos + 4, pos + 6)
    day, ok3 = parse_int(buf, pos + 7, pos + 9)
    hour, ok4 = parse_int(buf, pos + 10, pos + 12)
    minute, ok5 = parse_int(buf, pos + 13, pos + 15)
    if not (ok1 and ok2 and ok3 and ok4 and ok5 and year >= 0):
        return 0, -1, -1
    year += 1900 if year >= 80 else 2000
    label, valid = label_ns(buf, year, month, day, hour, minute, pos + 15)
    if not valid or (count <= 0 and flag < 2):
        return 0, -1, -1
    return label, flag, count


@njit
def next_record2(buf: NDArray[np.uint8], pos: int, n: int) -> int:
    """Start of the first line from ``pos`` on that opens an epoch or a header; ``n`` if none does."""
    while pos < n:
        eol = line_feed(buf, pos, n)
        end = text_end(buf, pos, eol)
        if epoch_record2(buf, pos, end)[1] >= 0 or is_version_line(buf, pos, end):
            return pos
        pos = eol + 1
    return n


@njit
def satellite_list(
    buf: NDArray[np.uint8], pos: int, count: int, layout: Layout, scratch: Scratch, problems: NDArray[np.int64]
) -> int:
    """Names of an epoch's satellites, 12 a line, into ``scratch.sv`` (-1: unreadable).

    Returns the position after the last line of the list, or -1 if the list is cut short.
    """
    n = len(buf)
    eol = line_feed(buf, pos, n)
    end = text_end(buf, pos, eol)
    for i in range(count):
        if i > 0 and i % 12 == 0:
            pos = eol + 1
            eol = line_feed(buf, pos, n)
            end = text_end(buf, pos, eol)
            for k in range(pos, min(pos + 32, end)):
                if buf[k] != 32:
                    return -1
        at = pos + 32 + 3 * (i % 12)
        if at + 3 > end:
            return -1
        scratch.sv[i] = satellite(buf, at, layout.system)
        if scratch.sv[i] < 0:
            note(problems, BAD_NAME, at)
        elif layout.n_slots[scratch.sv[i] >> 8] == 0:
            note(problems, UNDECLARED, at)
            scratch.sv[i] = -1
    return eol + 1


@njit
def is_value_line(buf: NDArray[np.uint8], start: int, end: int) -> bool:
    """Whether a line is blank or has the decimal point of an F14.3 field: no epoch record, not even a damaged one."""
    for k in range(start + 10, min(end, start + 68), 16):
        if buf[k] == 46:
            return True
    return end == start


@njit
def satellite_lines(buf: NDArray[np.uint8], pos: int, count: int, per: int, scratch: Scratch) -> tuple[int, int, int]:
    """Where each satellite's lines start: satellites whole, position after them, 0 good / 1 cut / 2 shifted."""
    n = len(buf)
    for i in range(count):
        for j in range(per):
            if pos >= n:
                return i, n, 2 if buf[n - 1] == 10 else 1
            eol = line_feed(buf, pos, n)
            end = text_end(buf, pos, eol)
            if epoch_record2(buf, pos, end)[1] >= 0 or is_version_line(buf, pos, end):
                return i, pos, 2
            if eol == n and (i < count - 1 or j < per - 1):
                return i, n, 1
            scratch.start[i * per + j], scratch.end[i * per + j] = pos, min(end, pos + 80)
            pos = eol + 1
    rest = pos
    while rest < n and (buf[rest] == 32 or buf[rest] == 10 or buf[rest] == 13):
        rest += 1
    if rest >= n:
        return count, n, 0
    eol = line_feed(buf, pos, n)
    end = text_end(buf, pos, eol)
    if epoch_record2(buf, pos, end)[1] >= 0 or not is_value_line(buf, pos, end):
        return count, pos, 0
    return count, pos, 2


@njit
def read_body2(
    buf: NDArray[np.uint8],
    layout: Layout,
    state: NDArray[np.int64],
    problems: NDArray[np.int64],
    scratch: Scratch,
    out: Output,
) -> int:
    """Epochs of a RINEX 2 body; parameters and result as for `starwise.kernels.rinex_obs.read_body`."""
    n = len(buf)
    pos = state[POS]
    per: Any = (np.max(layout.n_fields) + layout.per_line - 1) // layout.per_line
    while pos < n:
        eol = line_feed(buf, pos, n)
        end = text_end(buf, pos, eol)
        label, flag, count = epoch_record2(buf, pos, end)
        if flag < 0:
            if is_version_line(buf, pos, end):
                state[POS] = pos
                return SPLICE
            if end > pos:
                note(problems, BAD_EPOCH, pos)
                pos = next_record2(buf, eol + 1, n)
            else:
                pos = eol + 1
            continue
        if 2 <= flag <= 5:
            after, lines = eol + 1, 0
            while after < n and lines != count:
                eol = line_feed(buf, after, n)
                end = text_end(buf, after, eol)
                if epoch_record2(buf, after, end)[1] >= 0:
                    break
                after = eol + 1
                lines += 1
            after = min(after, n)
            state[AT], state[TO], state[FLAG], state[WANTED] = min(line_feed(buf, pos, n) + 1, n), after, flag, count
            state[POS] = after
            return EVENT
        if flag == 6:
            note(problems, SLIP_RECORDS, pos)
            pos = next_record2(buf, eol + 1, n)
            continue
        row = state[ROWS]
        epoch = state[EPOCHS]
        need = count * np.max(layout.n_slots)
        if count <= MAX_LINES and (epoch >= len(out.t) or row + need > len(out.sv)):
            state[POS], state[NEED] = pos, need
            return FULL
        lines_at = satellite_list(buf, pos, count, layout, scratch, problems) if count <= MAX_LINES else -1
        if lines_at < 0:
            note(problems, LOST_EPOCH, pos)
            pos = next_record2(buf, eol + 1, n)
            continue
        whole, after, fit = satellite_lines(buf, lines_at, count, per, scratch)
        if fit == 2 or whole == 0:
            note(problems, LOST_EPOCH, pos)
            pos = next_record2(buf, lines_at, n)
            continue
        if fit == 1:
            note(problems, CUT_LINE, pos)
        clock = np.nan
        if end > pos + 68:
            clock, ok = parse_float(buf, pos + 68, min(pos + 80, end))
            if not ok:
                note(problems, BAD_VALUE, pos)
        sort_satellites(whole, scratch)
        row = read_records(buf, whole, row, layout, scratch, problems, out)
        out.t[epoch], out.flag[epoch], out.clock[epoch], out.at[epoch] = label, flag, clock, pos
        out.offsets[epoch + 1] = row
        state[EPOCHS], state[ROWS] = epoch + 1, row
        pos = after
    state[POS] = n
    return DONE
