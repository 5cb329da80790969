"""What the readers of line-oriented files share: where lines start, and whole columns of epochs."""

import numpy as np

from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.gnsstime import BDT_OFFSET_S, utc_to_gpst
from starwise.types import I8, U1

GPS_TAI_S = 19
"""TAI - GPST, s (IS-GPS-200N 3.3.4)."""


def line_starts(buf: U1) -> tuple[I8, U1]:
    """Byte where each line starts, and its first byte.

    Returns
    -------
    (n + 1,) int64
        Starts; the last entry is one past the final line break, or past the byte where it would be.
    (n,) uint8
        First bytes; that of an empty line is its line break.
    """
    breaks = np.flatnonzero(buf == 10)
    if len(buf) and (len(breaks) == 0 or breaks[-1] != len(buf) - 1):
        breaks = np.append(breaks, len(buf))
    lines = np.concatenate([[0], breaks + 1]).astype(np.int64)
    first = buf[np.minimum(lines[:-1], max(len(buf) - 1, 0))]
    return lines, first


def labels_to_gpst(labels: I8, system: str, file: str) -> I8:
    """GPST, ns, of epochs given as ns since 1980-01-06 00:00 in a time system of SP3 or RINEX clock files.

    Raises
    ------
    StarwiseError
        The time system is unknown.
    """
    if system in ("GPS", "GAL", "QZS", "IRN", "IRS", ""):
        return labels
    if system in ("BDT", "BDS"):
        return labels + BDT_OFFSET_S * NS
    if system in ("UTC", "GLO"):
        return utc_to_gpst(labels)
    if system == "TAI":
        return labels - GPS_TAI_S * NS
    raise StarwiseError(
        "unknown time system", file=file, found=system, wanted="GPS, GAL, QZS, IRN, BDT, UTC, GLO or TAI"
    )
