"""Lines of SP3 orbit and RINEX clock files out of bytes."""

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.rinex_nav import calendar_label, system_index, trimmed
from starwise.kernels.text import parse_float, parse_int

U1 = NDArray[np.uint8]
I8 = NDArray[np.int64]
F8 = NDArray[np.float64]

ROW_OK, ROW_BAD_SV, ROW_BAD_NUMBER, ROW_SHORT, ROW_BAD_EPOCH = 0, 1, 2, 3, 4
FLAG_CLOCK_PREDICTED, FLAG_ORBIT_PREDICTED, FLAG_CLOCK_EVENT, FLAG_MANEUVER = 1, 2, 4, 8


@njit
def parse_sp3(
    buf: U1, lines: I8, epoch_lines: I8, pos_lines: I8, has_flags: bool,
    labels: I8, sv: I8, state: I8, numbers: F8, flags: I8,
) -> None:  # fmt: skip
    """Parse epoch and position lines of an SP3 file (SP3-d format description, 2016).

    Parameters
    ----------
    buf : (n,) uint8
        The file.
    lines : (n_lines + 1,) int64
        Start of every line, as `starwise.io.lines.line_starts` gives it.
    epoch_lines, pos_lines : (n_epochs,), (n,) int64
        Indices of the lines that start with ``*`` and ``P``.
    has_flags : bool
        SP3-c and d: standard deviations and flags after the clock.
    labels : (n_epochs,) int64, out
        Epoch, ns since 1980-01-06 in the file's scale; -1 if not readable.
    sv, state : (n,) int64, out
        Satellite (index in SYSTEMS << 8 | number), ``ROW_*``.
    numbers : (n, 8) float64, out
        x, y, z in km, clock in microseconds, exponents of their standard deviations; NaN where blank.
    flags : (n,) int64, out
        Sum of ``FLAG_*``.
    """
    for i in range(len(epoch_lines)):
        at = lines[epoch_lines[i]]
        end = trimmed(buf, at, lines[epoch_lines[i] + 1] - 1)
        labels[i] = -1
        if end < at + 24:
            continue
        year, ok0 = parse_int(buf, at + 3, at + 7)
        month, ok1 = parse_int(buf, at + 7, at + 10)
        day, ok2 = parse_int(buf, at + 10, at + 13)
        hour, ok3 = parse_int(buf, at + 13, at + 16)
        minute, ok4 = parse_int(buf, at + 16, at + 19)
        second, ok5 = parse_float(buf, at + 19, min(at + 31, end))
        if ok0 and ok1 and ok2 and ok3 and ok4 and ok5:
            label, ok = calendar_label(year, month, day, hour, minute, second)
            if ok:
                labels[i] = label
    for r in range(len(pos_lines)):
        at = lines[pos_lines[r]]
        end = trimmed(buf, at, lines[pos_lines[r] + 1] - 1)
        numbers[r, :] = np.nan
        flags[r] = 0
        sv[r] = -1
        if end < at + 46:
            state[r] = ROW_SHORT
            continue
        system = 0 if buf[at + 1] == 32 else system_index(buf[at + 1])
        number, ok = parse_int(buf, at + 2, at + 4)
        if system < 0 or not ok or number < 1:
            state[r] = ROW_BAD_SV
            continue
        sv[r] = system << 8 | number
        state[r] = ROW_OK
        for k in range(4):
            a = at + 4 + 14 * k
            if k == 3 and end <= a:
                continue
            if end < a + 14 or buf[a + 7] != 46:  # F14.6: a point in any other place means shifted text
                state[r] = ROW_BAD_NUMBER
                break
            value, ok = parse_float(buf, a, a + 14)
            if not ok:
                state[r] = ROW_BAD_NUMBER
                break
            numbers[r, k] = value
        if not has_flags or state[r] != ROW_OK:
            continue
        for k in range(4):
            a = at + 61 + 3 * k
            b = a + 2 if k < 3 else a + 3
            if end >= b:
                exponent, ok = parse_int(buf, a, b)
                if ok:
                    numbers[r, 4 + k] = exponent
        if end > at + 74 and buf[at + 74] == 69:
            flags[r] |= FLAG_CLOCK_EVENT
        if end > at + 75 and buf[at + 75] == 80:
            flags[r] |= FLAG_CLOCK_PREDICTED
        if end > at + 78 and buf[at + 78] == 77:
            flags[r] |= FLAG_MANEUVER
        if end > at + 79 and buf[at + 79] == 80:
            flags[r] |= FLAG_ORBIT_PREDICTED


@njit
def _token(buf: U1, i: int, end: int) -> tuple[int, int]:
    """Start and end of the next word at or after byte ``i``; both ``end`` if there is none."""
    while i < end and buf[i] <= 32:
        i += 1
    j = i
    while j < end and buf[j] > 32:
        j += 1
    return i, j


@njit
def parse_clk(buf: U1, lines: I8, rows: I8, labels: I8, sv: I8, state: I8, numbers: F8) -> None:
    """Parse ``AS`` lines of a RINEX clock file (RINEX clock 3.04 table A2), whatever their column layout.

    Versions before 3.04 keep four columns for the name and 3.04 nine, so words are read, not columns.

    Parameters
    ----------
    buf, lines : as in `parse_sp3`
    rows : (n,) int64
        Indices of the lines.
    labels, sv, state : (n,) int64, out
        Epoch (ns since 1980-01-06 in the file's scale), satellite, ``ROW_*``.
    numbers : (n, 2) float64, out
        Clock bias and its standard deviation, s; NaN where absent.
    """
    parts = np.zeros(5, dtype=np.int64)
    for r in range(len(rows)):
        at = lines[rows[r]]
        end = trimmed(buf, at, lines[rows[r] + 1] - 1)
        labels[r] = 0
        sv[r] = -1
        numbers[r, 0] = np.nan
        numbers[r, 1] = np.nan
        a, b = _token(buf, at + 2, end)
        system = system_index(buf[a]) if b > a else -1
        number, ok = parse_int(buf, a + 1, b)
        if not ok and b == a + 1:  # "G 1"
            a, b = _token(buf, b, end)
            number, ok = parse_int(buf, a, b)
        if system < 0 or not ok or number < 1 or number > 99:
            state[r] = ROW_BAD_SV
            continue
        sv[r] = system << 8 | number
        good = True
        for k in range(5):
            a, b = _token(buf, b, end)
            parts[k], ok = parse_int(buf, a, b)
            good = good and ok
        a, b = _token(buf, b, end)
        second, ok = parse_float(buf, a, b)
        good = good and ok
        label, ok = calendar_label(parts[0], parts[1], parts[2], parts[3], parts[4], second)
        if not good or not ok:
            state[r] = ROW_BAD_EPOCH
            continue
        labels[r] = label
        a, b = _token(buf, b, end)
        count, ok = parse_int(buf, a, b)
        if not ok or count < 1 or count > 6:
            state[r] = ROW_BAD_NUMBER
            continue
        state[r] = ROW_OK
        for k in range(min(count, 2)):
            a, b = _token(buf, b, end)
            value, ok = parse_float(buf, a, b)
            if not ok or a == b:
                state[r] = ROW_BAD_NUMBER if a < b else ROW_SHORT
                break
            numbers[r, k] = value
