"""Bodies of RINEX observation files, versions 3 and 4: bytes in, rows out (RINEX 3.05 table A3, columns from 0)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.rinex_records import (
    AT,
    BAD_EPOCH,
    BAD_VALUE,
    CUT_LINE,
    DONE,
    EPOCHS,
    EVENT,
    FLAG,
    FULL,
    JUNK_LINE,
    MAX_LINES,
    NEED,
    POS,
    ROWS,
    SAT_COUNT,
    SLIP_RECORDS,
    SPLICE,
    TO,
    TOO_MANY,
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
def epoch_record(buf: NDArray[np.uint8], pos: int, end: int, layout: Layout) -> tuple[int, bool, int, int, float, bool]:
    """Epoch record of version 3: label ns, its validity, flag and satellites (-1 bad), clock s, its validity."""
    if end - pos < 32:
        return 0, False, -1, -1, np.nan, True
    flag: Any = np.int64(0) if buf[pos + 31] == 32 else np.int64(buf[pos + 31]) - 48
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
                    scratch.sv[n_sat], scratch.start[n_sat], scratch.end[n_sat] = sv, line + 3, end
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
        sort_satellites(n_sat, scratch)
        row = read_records(buf, n_sat, row, layout, scratch, problems, out)
        out.t[epoch], out.flag[epoch], out.clock[epoch], out.at[epoch] = label, flag, clock, pos
        out.offsets[epoch + 1] = row
        state[EPOCHS], state[ROWS] = epoch + 1, row
        pos = line
    state[POS] = n
    return DONE
