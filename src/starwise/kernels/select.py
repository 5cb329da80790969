"""Choice of one signal, or one ionosphere-free pair, per satellite and epoch."""

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    C_LIGHT,
    ROW_BAD_CODE,
    ROW_COMBINED,
    ROW_EXCLUDED_BY_USER,
    ROW_NO_CODE,
    ROW_NO_FREQUENCY,
    ROW_NO_PAIR,
    ROW_NOT_SELECTED,
    ROW_SYSTEM_OFF,
    ROW_USED,
)
from starwise.kernels._jit import njit

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I2 = NDArray[np.int16]
U1 = NDArray[np.uint8]

SINGLE = 0  # one signal per satellite
COMBINED = 1  # ionosphere-free combination of two
UNCOMBINED = 2  # one signal, and a second one beside it where there is one

CODE_MIN_M = 1.0e7  # a satellite cannot be nearer than about 1.9e7 m; receiver clocks run free by some 30 ms
CODE_MAX_M = 6.5e7  # an inclined geosynchronous satellite at the horizon is at 4.2e7 m


@njit
def count_sightings(offsets: I8, sv: I2) -> int:
    """Number of (epoch, satellite) groups."""
    n = 0
    for e in range(len(offsets) - 1):
        for i in range(offsets[e], offsets[e + 1]):
            if i == offsets[e] or sv[i] != sv[i - 1]:
                n += 1
    return n


@njit
def _best(start: int, end: int, sv: I2, sig: I2, rank: I8, not_band: int, row_status: U1) -> int:
    """Row with a usable code and the smallest rank, not on the carrier ``not_band``; -1 if none."""
    best, best_rank = -1, 1 << 30
    for i in range(start, end):
        if row_status[i] != ROW_NOT_SELECTED or sig[i] >> 8 == not_band:
            continue
        r = rank[sv[i] >> 8, sig[i] >> 8, sig[i] & 127]
        if 0 <= r < best_rank:
            best, best_rank = i, r
    return best


@njit
def _rate(i: int, start: int, end: int, sv: I2, sig: I2, doppler: F8, frequency: F8) -> float:
    """Pseudorange rate, m/s: from the row's own Doppler, else from any other signal of the satellite."""
    system, number = sv[i] >> 8, sv[i] & 255
    if doppler[i] == doppler[i]:
        return float(-C_LIGHT / frequency[system, number, sig[i] >> 8] * doppler[i])
    for k in range(start, end):
        f = frequency[system, number, sig[k] >> 8]
        if doppler[k] == doppler[k] and f == f:
            return float(-C_LIGHT / f * doppler[k])
    return np.nan


@njit
def select_signals(
    offsets: I8, sv: I2, sig: I2, code: F8, doppler: F8, cn0: F8,
    system_on: U1, excluded: U1, rank: I8, rank2: I8, mode: int, frequency: F8,
    row_status: U1, s_offsets: I8, s_sv: I2, s_sig: I2, s_sig2: I2, s_row: I8, s_row2: I8,
    s_code: F8, s_rate: F8, s_cn0: F8, s_freq: F8, s_factor: F8, s_status: U1,
) -> None:  # fmt: skip
    """Fill sightings (see `starwise.types.Sightings`) and the status of every observation row.

    Parameters
    ----------
    offsets, sv, sig, code, doppler, cn0
        Columns of `Observations`.
    system_on : (7,) uint8
    excluded : (7, 256) uint8
        Satellites that the user has taken out.
    rank, rank2 : (7, 10, 128) int64
        Preference of first and second signal by system, band and attribute; smaller is better, negative is never.
    mode : int
        ``SINGLE``, ``COMBINED`` or ``UNCOMBINED``.
    frequency : (7, 256, 10) float64
        Carrier by system, satellite number and band, Hz.
    """
    k = -1
    for e in range(len(offsets) - 1):
        s_offsets[e] = k + 1
        i = offsets[e]
        while i < offsets[e + 1]:
            start = i
            while i < offsets[e + 1] and sv[i] == sv[start]:
                i += 1
            k += 1
            system, number = sv[start] >> 8, sv[start] & 255
            s_sv[k], s_sig[k], s_sig2[k] = sv[start], 0, 0
            s_row[k], s_row2[k] = start, -1
            s_code[k], s_rate[k], s_cn0[k], s_freq[k], s_factor[k] = np.nan, np.nan, np.nan, np.nan, 1.0
            any_code = False
            fault = ROW_NO_CODE
            for r in range(start, i):
                if system_on[system] == 0:
                    row_status[r] = ROW_SYSTEM_OFF
                elif excluded[system, number] != 0:
                    row_status[r] = ROW_EXCLUDED_BY_USER
                elif code[r] != code[r]:
                    row_status[r] = ROW_NO_CODE
                elif not CODE_MIN_M < code[r] < CODE_MAX_M:
                    row_status[r] = ROW_BAD_CODE
                    fault = ROW_BAD_CODE
                elif not frequency[system, number, sig[r] >> 8] > 0.0:
                    row_status[r] = ROW_NO_FREQUENCY
                    fault = ROW_NO_FREQUENCY
                else:
                    row_status[r] = ROW_NOT_SELECTED
                    any_code = True
            if not any_code:
                s_status[k] = (
                    row_status[start] if row_status[start] in (ROW_SYSTEM_OFF, ROW_EXCLUDED_BY_USER) else fault
                )
                continue
            first = _best(start, i, sv, sig, rank, -1, row_status)
            if first < 0:
                s_status[k] = ROW_NO_PAIR if mode == COMBINED else ROW_NOT_SELECTED
                continue
            second = -1
            if mode != SINGLE:
                second = _best(start, i, sv, sig, rank2, sig[first] >> 8 if mode == UNCOMBINED else -1, row_status)
                if mode == COMBINED and (second < 0 or sig[second] >> 8 == sig[first] >> 8):
                    s_status[k] = ROW_NO_PAIR
                    row_status[first] = ROW_NO_PAIR
                    s_row[k], s_sig[k] = first, sig[first]
                    continue
            f1 = frequency[system, number, sig[first] >> 8]
            s_sig[k], s_row[k], s_cn0[k] = sig[first], first, cn0[first]
            s_rate[k] = _rate(first, start, i, sv, sig, doppler, frequency)
            s_status[k] = ROW_USED
            row_status[first] = ROW_USED
            if second < 0 or mode == UNCOMBINED:
                s_code[k], s_freq[k] = code[first], f1
                if second >= 0:
                    s_sig2[k], s_row2[k] = sig[second], second
                    row_status[second] = ROW_USED
                continue
            f2 = frequency[system, number, sig[second] >> 8]
            a = f1 * f1 / (f1 * f1 - f2 * f2)  # Groves 9.78: first-order ionosphere cancels
            b = 1.0 - a
            s_sig2[k], s_row2[k] = sig[second], second
            s_code[k] = a * code[first] + b * code[second]
            s_freq[k] = np.inf
            s_factor[k] = np.sqrt(a * a + b * b)
            row_status[second] = ROW_COMBINED
    s_offsets[len(offsets) - 1] = k + 1
