"""Numbers out of fixed columns of text held as bytes. A blank field is NaN, a field that is not a number is a flag."""

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit

U1 = NDArray[np.uint8]

_POW10 = 10.0 ** np.arange(23)  # exact in float64 up to 1e22


@njit
def parse_int(buf: U1, start: int, end: int) -> tuple[int, bool]:
    """Integer in ``buf[start:end]`` (bytes), spaces around allowed. Returns value, ok; a blank field is not ok."""
    i = start
    while i < end and buf[i] == 32:
        i += 1
    negative = False
    if i < end and (buf[i] == 45 or buf[i] == 43):
        negative = buf[i] == 45
        i += 1
    value = 0
    digits = 0
    while i < end and 48 <= buf[i] <= 57 and digits < 18:
        value = value * 10 + int(np.int64(buf[i]) - 48)
        digits += 1
        i += 1
    while i < end and buf[i] == 32:
        i += 1
    if digits == 0 or i != end:
        return 0, False
    return (-value if negative else value), True


@njit
def parse_float(buf: U1, start: int, end: int) -> tuple[float, bool]:
    """Real number in ``buf[start:end]`` (bytes): F, E and D formats. Returns value, ok.

    A blank field gives (NaN, True); text that is not a number (NaN, False). The mantissa is gathered as an integer
    and scaled once, so that F14.3 fields and 13-digit mantissas are rounded correctly.
    """
    i = start
    while i < end and buf[i] == 32:
        i += 1
    if i >= end:
        return np.nan, True
    negative = False
    if buf[i] == 45 or buf[i] == 43:
        negative = buf[i] == 45
        i += 1
    mantissa = 0
    digits = 0
    scale = 0
    seen = False
    while i < end and 48 <= buf[i] <= 57:
        seen = True
        if digits < 18:
            mantissa = mantissa * 10 + int(np.int64(buf[i]) - 48)
            if mantissa > 0:
                digits += 1
        else:
            scale += 1
        i += 1
    if i < end and buf[i] == 46:
        i += 1
        while i < end and 48 <= buf[i] <= 57:
            seen = True
            if digits < 18:
                mantissa = mantissa * 10 + int(np.int64(buf[i]) - 48)
                scale -= 1
                if mantissa > 0:
                    digits += 1
            i += 1
    if not seen:
        return np.nan, False
    if i < end and (buf[i] == 69 or buf[i] == 101 or buf[i] == 68 or buf[i] == 100):  # E e D d
        i += 1
        down = False
        if i < end and (buf[i] == 45 or buf[i] == 43):
            down = buf[i] == 45
            i += 1
        exponent = 0
        any_digit = False
        while i < end and 48 <= buf[i] <= 57:
            any_digit = True
            if exponent < 10000:
                exponent = exponent * 10 + int(np.int64(buf[i]) - 48)
            i += 1
        if not any_digit:
            return np.nan, False
        scale += -exponent if down else exponent
    while i < end and buf[i] == 32:
        i += 1
    if i != end:
        return np.nan, False
    value = float(mantissa)
    while scale > 0:
        step = min(scale, 22)
        value *= _POW10[step]
        scale -= step
        if value > 1e300:
            return np.nan, False
    while scale < 0 and value != 0.0:
        step = min(-scale, 22)
        value /= _POW10[step]
        scale += step
    return (-value if negative else value), True
