"""Numbers as text in fixed columns: the body of a RINEX 3 observation file."""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I2 = NDArray[np.int16]
U1 = NDArray[np.uint8]

SATELLITE = 3
FIELD = 16


@njit
def _fixed(buf: U1, end: int, width: int, value: float) -> bool:
    """Write ``value`` with three decimals, right-aligned before ``end``; False (blank) if it does not fit."""
    if not abs(value) < 1e15:
        return False
    n = np.int64(math.floor(abs(value) * 1000.0 + 0.5))
    at = end - 1
    digits = 0
    while digits < 4 or n > 0:
        if digits == 3:
            buf[at] = 46
            at -= 1
        if at < end - width:
            return False
        buf[at] = 48 + n % 10
        n //= 10
        at -= 1
        digits += 1
    if value < 0.0:
        if at < end - width:
            return False
        buf[at] = 45
    return True


@njit
def _blank(buf: U1, start: int, end: int) -> None:
    for i in range(start, end):
        buf[i] = 32


@njit
def observation_lines(
    row_offsets: I8, epoch_bytes: U1, epoch_starts: I8, sv: I2, column: I8, place: I8, n_columns: I8,
    letters: U1,
    values: F8, lli: U1, out: U1,
) -> int:  # fmt: skip
    """Epoch records of a RINEX 3 observation file; returns the number of bytes written.

    Parameters
    ----------
    row_offsets : (n_epochs + 1,) int64
        Rows of each epoch, satellites together.
    epoch_bytes, epoch_starts : (m,), (n_epochs + 1,)
        Text of the epoch lines, each with its end of line.
    sv : (n_rows,) int16
    column : (n_rows,) int64
        First observation column of the row's signal.
    place : (4,) int64
        Where code, phase, Doppler and C/N0 stand from there; -1 for what is not written.
    n_columns : (7,) int64
        Observation types by system.
    letters : (7,) uint8
        System letters.
    values : (n_rows, 4) float64
        Code, phase, Doppler, C/N0; NaN is blank.
    lli : (n_rows,) uint8
    out : uint8
        Large enough.

    References
    ----------
    RINEX 3.05 table A3: A1, I2.2, m (F14.3, I1, I1).
    """
    at = 0
    for e in range(len(row_offsets) - 1):
        for i in range(epoch_starts[e], epoch_starts[e + 1]):
            out[at] = epoch_bytes[i]
            at += 1
        r = row_offsets[e]
        while r < row_offsets[e + 1]:
            s = sv[r]
            width = SATELLITE + FIELD * n_columns[s >> 8]
            _blank(out, at, at + width)
            out[at] = letters[s >> 8]
            out[at + 1], out[at + 2] = 48 + (s & 255) // 10, 48 + (s & 255) % 10
            last = at + SATELLITE
            while r < row_offsets[e + 1] and sv[r] == s:
                strength = values[r, 3]
                ssi = 0
                if strength > 0.0:
                    ssi = min(max(int(strength / 6.0), 1), 9)  # RINEX 3.05 table A2
                for k in range(4):
                    if place[k] < 0:
                        continue
                    field = at + SATELLITE + FIELD * (column[r] + place[k])
                    if _fixed(out, field + 14, 14, values[r, k]):
                        last = max(last, field + 14)
                        if k == 1 and lli[r] > 0:
                            out[field + 14] = 48 + lli[r] % 8
                            last = max(last, field + 15)
                        if k < 2 and ssi > 0:
                            out[field + 15] = 48 + ssi
                            last = max(last, field + 16)
                    else:
                        _blank(out, field, field + 14)
                r += 1
            out[last] = 10
            at = last + 1
    return at
