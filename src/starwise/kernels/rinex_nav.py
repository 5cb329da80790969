"""Records of a RINEX navigation file: satellite, epoch and numbers out of the bytes, record after record."""

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    DAY_S,
    MSG_CNAV,
    MSG_CNV1,
    MSG_CNV2,
    MSG_CNV3,
    MSG_D1,
    MSG_D2,
    MSG_FDMA,
    MSG_FNAV,
    MSG_INAV,
    MSG_LNAV,
    MSG_SBAS,
    MSG_UNKNOWN,
    NS,
    SYS_C,
    SYS_E,
    SYS_G,
    SYS_I,
    SYS_J,
    SYS_R,
    SYS_S,
)
from starwise.kernels._jit import njit
from starwise.kernels.text import parse_float, parse_int

U1 = NDArray[np.uint8]
I8 = NDArray[np.int64]
F8 = NDArray[np.float64]

_POW10 = 10.0 ** np.arange(23)  # exact in float64

N_VALUES = 3 + 9 * 4
"""Three clock numbers of the first line, then four on each of at most nine orbit lines."""

KIND_EPH, KIND_STO, KIND_EOP, KIND_ION, KIND_OTHER = 0, 1, 2, 3, 4
REC_OK, REC_BAD_SV, REC_BAD_EPOCH, REC_SHORT, REC_LONG, REC_UNSUPPORTED, REC_STRAY, REC_MISPLACED = (
    0, 1, 2, 3, 4, 5, 6, 7,
)  # fmt: skip
# columns of the integer table that `parse_records` fills
C_KIND, C_STATE, C_SYS, C_PRN, C_MSG, C_LABEL, C_ORBITS = 0, 1, 2, 3, 4, 5, 6
N_COLUMNS = 7


@njit
def system_index(letter: int) -> int:
    """Index of a system letter (bytes G R E C J I S), -1 if it is none."""
    if letter == 71:
        return SYS_G
    if letter == 82:
        return SYS_R
    if letter == 69:
        return SYS_E
    if letter == 67:
        return SYS_C
    if letter == 74:
        return SYS_J
    if letter == 73:
        return SYS_I
    if letter == 83:
        return SYS_S
    return -1


@njit
def _word(buf: U1, start: int, end: int) -> int:
    """Up to four bytes of a word as one integer, blanks after it left out."""
    word = 0
    for i in range(start, min(end, start + 4)):
        if buf[i] <= 32:
            break
        word = word << 8 | int(buf[i])
    return word


@njit
def _message(word: int) -> int:
    """Message code of a RINEX 4 message name (table 13 of RINEX 4.01) packed by `_word`."""
    if word == 0x4C4E4156:  # LNAV
        return MSG_LNAV
    if word == 0x434E4156:  # CNAV
        return MSG_CNAV
    if word == 0x434E5631:  # CNV1
        return MSG_CNV1
    if word == 0x434E5632:  # CNV2
        return MSG_CNV2
    if word == 0x434E5633:  # CNV3
        return MSG_CNV3
    if word == 0x494E4156:  # INAV
        return MSG_INAV
    if word == 0x464E4156:  # FNAV
        return MSG_FNAV
    if word == 0x4431:  # D1
        return MSG_D1
    if word == 0x4432:  # D2
        return MSG_D2
    if word == 0x46444D41:  # FDMA
        return MSG_FDMA
    if word == 0x53424153:  # SBAS
        return MSG_SBAS
    return MSG_UNKNOWN


@njit
def _legacy_message(system: int, prn: int) -> int:
    """Message of a RINEX 2 or 3 record. Galileo: told apart later, from its data sources."""
    if system == SYS_R:
        return MSG_FDMA
    if system == SYS_S:
        return MSG_SBAS
    if system == SYS_E:
        return MSG_INAV
    if system == SYS_C:
        return MSG_D2 if prn <= 5 or 59 <= prn <= 63 else MSG_D1
    return MSG_LNAV


@njit
def _orbit_lines(system: int, message: int) -> int:
    """Orbit lines of a record (RINEX 4.01 tables A9 to A31), 0 if the system has no such message."""
    if message == MSG_FDMA:
        return 3 if system == SYS_R else 0  # or 4: RINEX 3.05 added one, merged files have both
    if message == MSG_SBAS:
        return 3 if system == SYS_S else 0
    if message in (MSG_INAV, MSG_FNAV):
        return 7 if system == SYS_E else 0
    if message in (MSG_D1, MSG_D2):
        return 7 if system == SYS_C else 0
    if message == MSG_LNAV:
        return 7 if system in (SYS_G, SYS_J, SYS_I) else 0
    if message == MSG_CNAV:
        return 8 if system in (SYS_G, SYS_J) else 0
    if message == MSG_CNV2:
        return 9 if system in (SYS_G, SYS_J, SYS_C) else 0
    if message == MSG_CNV1:
        return 9 if system == SYS_C else 0
    if message == MSG_CNV3:
        return 8 if system == SYS_C else 0
    return 0


@njit
def calendar_label(year: int, month: int, day: int, hour: int, minute: int, second: float) -> tuple[int, bool]:
    """Nanoseconds since 1980-01-06 00:00 of a calendar label, and whether it is one (1980 to 2199)."""
    if year < 1980 or year > 2199 or month < 1 or month > 12 or day < 1:
        return 0, False
    days_in = 31
    if month == 4 or month == 6 or month == 9 or month == 11:
        days_in = 30
    elif month == 2:
        days_in = 29 if year % 4 == 0 and (year % 100 != 0 or year % 400 == 0) else 28
    if day > days_in or hour < 0 or hour > 23 or minute < 0 or minute > 59 or not 0.0 <= second < 60.0:
        return 0, False
    y = year - 1 if month <= 2 else year  # days from the civil calendar, years starting in March
    m = month + 9 if month <= 2 else month - 3
    days = 365 * y + y // 4 - y // 100 + y // 400 + (153 * m + 2) // 5 + day - 1 - 723125
    milliseconds = int(np.floor(second * 1000.0 + 0.5))
    return (days * DAY_S + hour * 3600 + minute * 60) * NS + milliseconds * 1_000_000, True


@njit
def parse_epoch(buf: U1, at: int, end: int, version: int) -> tuple[int, bool]:
    """Label of the epoch of a line that starts at byte ``at``: ns since 1980-01-06, ok."""
    if version == 2:  # columns I2,1X,I2.2,1X,I2,1X,I2,1X,I2,1X,I2,F5.1
        if end < at + 22:
            return 0, False
        year, ok0 = parse_int(buf, at + 3, at + 5)
        year += 1900 if year >= 80 else 2000
        rest, width = at + 6, 5
    else:  # A1,I2.2,1X,I4,5(1X,I2.2)
        if end < at + 23:
            return 0, False
        year, ok0 = parse_int(buf, at + 4, at + 8)
        rest, width = at + 9, 2
    month, ok1 = parse_int(buf, rest, rest + 2)
    day, ok2 = parse_int(buf, rest + 3, rest + 5)
    hour, ok3 = parse_int(buf, rest + 6, rest + 8)
    minute, ok4 = parse_int(buf, rest + 9, rest + 11)
    a = rest + 11 if version == 2 else rest + 12
    second, ok5 = parse_float(buf, a, a + width)
    if not (ok0 and ok1 and ok2 and ok3 and ok4 and ok5):
        return 0, False
    return calendar_label(year, month, day, hour, minute, second)


@njit
def trimmed(buf: U1, start: int, end: int) -> int:
    """End of a line without the blanks and carriage returns at its end; ``start`` if nothing is left."""
    while end > start and buf[end - 1] <= 32:
        end -= 1
    return end


@njit
def _aligned(buf: U1, start: int, end: int, first_column: int) -> bool:
    """Whether an orbit line keeps to its columns: nothing before its first field or after its fourth."""
    if end > start + first_column + 76:
        return False
    blank = True
    for j in range(start, start + first_column):
        blank = blank and buf[j] == 32
    return blank


@njit
def _number_e19(buf: U1, a: int) -> tuple[float, bool]:
    """A number written as E19.12 at byte ``a``, the way nearly all are: sign, digit, point, 12 digits, exponent.

    Anything else is not ok and left to `parse_float`. 13 digits and powers of ten to 22 are exact in a float64, so
    that the one division or multiplication rounds correctly.
    """
    sign, mark, exponent_sign = buf[a], buf[a + 15], buf[a + 16]
    if (sign != 32 and sign != 45) or buf[a + 2] != 46 or (mark | 32 != 101 and mark | 32 != 100):
        return 0.0, False
    mantissa = np.int64(buf[a + 1]) - 48
    good = bool(0 <= mantissa <= 9)
    for i in range(a + 3, a + 15):
        digit = np.int64(buf[i]) - 48
        good = good and bool(0 <= digit <= 9)
        mantissa = mantissa * 10 + digit
    tens, ones = np.int64(buf[a + 17]) - 48, np.int64(buf[a + 18]) - 48
    good = good and bool(0 <= tens <= 9) and bool(0 <= ones <= 9)
    scale = 10 * tens + ones
    if exponent_sign == 45:
        scale = -scale
    elif exponent_sign != 43:
        good = False
    scale -= 12
    if not good or scale < -22 or scale > 22:
        return 0.0, False
    value = float(mantissa)
    value = value * _POW10[scale] if scale >= 0 else value / _POW10[-scale]
    return (-value if sign == 45 else value), True


@njit
def _numbers(buf: U1, at: int, end: int, first: int, out: F8) -> None:
    """Fields of 19 columns from byte ``first``: NaN where blank, inf where they are not numbers."""
    for k in range(len(out)):
        a = first + 19 * k
        if a >= end:
            return
        if a + 19 <= end:
            value, ok = _number_e19(buf, a)
            if ok:
                out[k] = value
                continue
        value, ok = parse_float(buf, a, min(a + 19, end))
        out[k] = value if ok else np.inf


@njit
def parse_records(buf: U1, lines: I8, records: I8, version: int, default_system: int, table: I8, values: F8) -> None:
    """Parse every record of a navigation file.

    Parameters
    ----------
    buf : (n,) uint8
        The file.
    lines : (n_lines + 1,) int64
        Byte where each line starts; the last entry is one past the final line break.
    records : (n_records + 1,) int64
        Index in ``lines`` where each record starts; the last entry is n_lines.
    version : int
        2, 3 or 4.
    default_system : int
        System of a RINEX 2 file.
    table : (n_records, N_COLUMNS) int64, out
        Kind, state, system, number, message, epoch (ns since 1980-01-06 in the scale of the system),
        orbit lines present.
    values : (n_records, N_VALUES) float64, out
        Written (NaN first) only where the state is ``REC_OK``.
    """
    first_column = 3 if version == 2 else 4
    for r in range(len(records) - 1):
        line, stop = records[r], records[r + 1]
        at = lines[line]
        end = trimmed(buf, at, lines[line + 1] - 1)
        table[r, :] = 0
        table[r, C_STATE] = REC_STRAY
        table[r, C_KIND] = KIND_EPH
        message = MSG_UNKNOWN
        if version == 4:
            # "> EPH G01 LNAV"
            kind = KIND_OTHER
            if end >= at + 10 and buf[at] == 62:
                name = _word(buf, at + 2, at + 6)
                if name == 0x455048:
                    kind = KIND_EPH
                elif name == 0x53544F:
                    kind = KIND_STO
                elif name == 0x454F50:
                    kind = KIND_EOP
                elif name == 0x494F4E:
                    kind = KIND_ION
            table[r, C_KIND] = kind
            if kind == KIND_OTHER:
                continue
            system = system_index(buf[at + 6])
            prn, ok = parse_int(buf, at + 7, min(at + 9, end))
            word = _word(buf, at + 10, end)
            message = _message(word)
            line += 1
            if line >= stop:
                table[r, C_STATE] = REC_SHORT
                continue
            again = lines[line]
            again_end = trimmed(buf, again, lines[line + 1] - 1)
            if kind == KIND_EPH:
                prn2, ok2 = parse_int(buf, again + 1, min(again + 3, again_end))
                ok = ok and ok2 and prn2 == prn and system_index(buf[again]) == system
            else:
                message = word  # LNAV, D1D2, IFNV, CNVX: the reader knows them by name
            at, end = again, again_end
        elif version == 3:
            system = system_index(buf[at])
            prn, ok = parse_int(buf, at + 1, min(at + 3, end))
        else:
            system = default_system
            prn, ok = parse_int(buf, at, min(at + 2, end))
        table[r, C_SYS] = system
        table[r, C_PRN] = prn
        if system < 0 or not ok or prn < 1 or prn > 99:
            table[r, C_STATE] = REC_BAD_SV
            continue
        kind = table[r, C_KIND]
        if version < 4:
            message = _legacy_message(system, prn)
        table[r, C_MSG] = message
        wanted = 2
        if kind == KIND_EPH:
            wanted = _orbit_lines(system, message)
            if wanted == 0:
                table[r, C_STATE] = REC_UNSUPPORTED
                continue
        label, ok = parse_epoch(buf, at, end, version)
        if not ok:
            table[r, C_STATE] = REC_BAD_EPOCH
            continue
        table[r, C_LABEL] = label
        # lines of the record that hold anything, and whether a blank one ends it
        filled, blank_tail, aligned = 0, 0, end <= at + first_column + 76
        for i in range(line + 1, stop):
            b = trimmed(buf, lines[i], lines[i + 1] - 1)
            if b == lines[i]:
                blank_tail = 1
                continue
            aligned = aligned and _aligned(buf, lines[i], b, first_column)
            filled += 1
            blank_tail = 0
        table[r, C_ORBITS] = filled
        most = wanted + (message == MSG_FDMA) if kind == KIND_EPH else 3
        if not aligned:
            table[r, C_STATE] = REC_MISPLACED
        elif kind == KIND_EPH and filled + blank_tail < wanted:
            table[r, C_STATE] = REC_SHORT
        elif filled > most:
            table[r, C_STATE] = REC_LONG
        else:
            table[r, C_STATE] = REC_OK
            values[r, :] = np.nan
            _numbers(buf, at, end, at + first_column + 19, values[r, :3])
            k = 3
            for i in range(line + 1, stop):
                b = trimmed(buf, lines[i], lines[i + 1] - 1)
                if b > lines[i]:
                    _numbers(buf, lines[i], b, lines[i] + first_column, values[r, k : k + 4])
                    k += 4
