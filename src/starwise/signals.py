"""Satellites and signals by their RINEX names, and the frequencies behind them.

A satellite identifier is ``index in SYSTEMS << 8 | number`` (``G05`` = 5, ``R01`` = 257). A signal identifier is
``band << 8 | ord(attribute)`` (``1C`` = 0x143); the observation codes of RINEX are a kind (``C L D S``) before it.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import SYS_C, SYS_E, SYS_G, SYS_I, SYS_J, SYS_R, SYS_S, SYSTEMS
from starwise.errors import StarwiseError


def sv_id(name: str) -> int:
    """Identifier of a satellite named as in RINEX (``G05``; ``G 5`` and ``5`` as old files write it).

    Raises
    ------
    StarwiseError
        Not a satellite name.
    """
    text = name.strip().upper()
    if text.isascii() and text.isdigit():
        text = "G" + text
    system, number = text[:1], text[1:].strip()
    # isascii: '²' is a digit for Python, and bytes of a damaged file come here
    digits = number.isascii() and number.isdigit() and len(number) <= 3
    if system not in SYSTEMS or not system or not digits or not 0 < int(number) < 256:
        raise StarwiseError("not a satellite", found=name, wanted=f"a letter of {SYSTEMS} and a number")
    return SYSTEMS.index(system) << 8 | int(number)


def sv_name(sv: int) -> str:
    """RINEX name of a satellite identifier."""
    return f"{SYSTEMS[sv >> 8]}{sv & 255:02d}"


def signal_id(name: str) -> int:
    """Identifier of a signal named by band and attribute (``1C``)."""
    if len(name) != 2 or not name.isascii() or not name[0].isdigit() or not name[1].isupper():
        raise StarwiseError("not a signal", found=name, wanted="band and attribute as in RINEX, like 1C")
    return int(name[0]) << 8 | ord(name[1])


def signal_name(sig: int) -> str:
    """RINEX band and attribute of a signal identifier (``1C``); ``--`` for 0, no signal."""
    return f"{sig >> 8}{chr(sig & 255)}" if sig else "--"


MHZ: Final = 1e6
# system index, band -> Hz. RINEX 3.05 tables 4-10; the ICD that defines the carrier is named at the right.
FREQUENCY: Final[dict[tuple[int, int], float]] = {
    (SYS_G, 1): 1575.42 * MHZ,  # IS-GPS-200N 3.3.1.1, L1
    (SYS_G, 2): 1227.60 * MHZ,  # IS-GPS-200N 3.3.1.1, L2
    (SYS_G, 5): 1176.45 * MHZ,  # IS-GPS-705J 3.3.1.1, L5
    (SYS_R, 3): 1202.025 * MHZ,  # GLONASS ICD CDMA L3 1.0
    (SYS_R, 4): 1600.995 * MHZ,  # GLONASS ICD CDMA L1 1.0 (G1a)
    (SYS_R, 6): 1248.06 * MHZ,  # GLONASS ICD CDMA L2 1.0 (G2a)
    (SYS_E, 1): 1575.42 * MHZ,  # Galileo OS SIS ICD 2.1 table 2, E1
    (SYS_E, 5): 1176.45 * MHZ,  # E5a
    (SYS_E, 6): 1278.75 * MHZ,  # E6
    (SYS_E, 7): 1207.14 * MHZ,  # E5b
    (SYS_E, 8): 1191.795 * MHZ,  # E5 (E5a + E5b)
    (SYS_C, 1): 1575.42 * MHZ,  # BDS-SIS-ICD-B1C-1.0 4.1, B1C
    (SYS_C, 2): 1561.098 * MHZ,  # BDS-SIS-ICD-B1I-3.0 4.2.1, B1I
    (SYS_C, 5): 1176.45 * MHZ,  # BDS-SIS-ICD-B2a-1.0 4.1, B2a
    (SYS_C, 6): 1268.52 * MHZ,  # BDS-SIS-ICD-B3I-1.0 4.2.1, B3I
    (SYS_C, 7): 1207.14 * MHZ,  # BDS-SIS-ICD-2.1 B2I; BDS-SIS-ICD-B2b-1.0, B2b
    (SYS_C, 8): 1191.795 * MHZ,  # B2 (B2a + B2b)
    (SYS_J, 1): 1575.42 * MHZ,  # IS-QZSS-PNT-005 3.1.1, L1
    (SYS_J, 2): 1227.60 * MHZ,  # L2C
    (SYS_J, 5): 1176.45 * MHZ,  # L5
    (SYS_J, 6): 1278.75 * MHZ,  # IS-QZSS-L6-005 3.1.1, L6
    (SYS_I, 1): 1575.42 * MHZ,  # NavIC L1 SPS ICD 1.0
    (SYS_I, 5): 1176.45 * MHZ,  # IRNSS SPS ICD 1.1 table 1, L5
    (SYS_I, 9): 2492.028 * MHZ,  # IRNSS SPS ICD 1.1 table 1, S
    (SYS_S, 1): 1575.42 * MHZ,  # RTCA DO-229E A.2.4
    (SYS_S, 5): 1176.45 * MHZ,  # RTCA DO-229E / EUROCAE ED-259 L5
}
GLONASS_L1: Final = (1602.0 * MHZ, 0.5625 * MHZ)
"""GLONASS G1: f = 1602 + k 0.5625 MHz (GLONASS ICD L1/L2 5.1, 3.3.1.1)."""
GLONASS_L2: Final = (1246.0 * MHZ, 0.4375 * MHZ)
"""GLONASS G2: f = 1246 + k 0.4375 MHz (GLONASS ICD L1/L2 5.1, 3.3.1.1)."""


def frequency(system: int, band: int, channel: int | None = None) -> float:
    """Carrier frequency, Hz; NaN where the table has none or the GLONASS channel is not known.

    Parameters
    ----------
    system : int
        Index in `SYSTEMS`.
    band : int
        RINEX band digit.
    channel : int, optional
        GLONASS frequency channel k, -7..6, up to 13 before 2005 (needed for G1 and G2 only).
    """
    if system == SYS_R and band in (1, 2):
        if channel is None or not -7 <= channel <= 13:
            return float("nan")
        f0, step = GLONASS_L1 if band == 1 else GLONASS_L2
        return f0 + channel * step
    return FREQUENCY.get((system, band), float("nan"))


def frequency_table(channels: dict[int, int]) -> NDArray[np.float64]:
    """Frequencies, Hz, as an array (7 systems, 256 numbers, 10 bands), NaN where unknown: for kernels.

    Parameters
    ----------
    channels : dict
        GLONASS channel by satellite identifier.
    """
    table = np.full((len(SYSTEMS), 256, 10), np.nan)
    for (system, band), f in FREQUENCY.items():
        table[system, :, band] = f
    for sv, k in channels.items():
        for band in (1, 2):
            table[SYS_R, sv & 255, band] = frequency(SYS_R, band, k)
    return table


# Order in which one signal per satellite is chosen. First the civil signal to which the broadcast clock and group
# delay lead with least error, then the others on the same frequency, then other frequencies.
DEFAULT_PREFERENCE: Final[dict[str, tuple[str, ...]]] = {
    "G": ("1C", "1W", "1P", "1L", "1X", "1S", "1Y", "1M", "2W", "2P", "2L", "2X", "2S", "2C", "5Q", "5X", "5I"),
    "R": ("1C", "1P", "2C", "2P", "3Q", "3X", "3I"),
    "E": ("1C", "1X", "1B", "5Q", "5X", "5I", "7Q", "7X", "7I", "8Q", "8X", "8I", "6C", "6X", "6B"),
    "C": ("2I", "2X", "2Q", "1P", "1X", "1D", "6I", "6X", "6Q", "7I", "7X", "7Q", "5P", "5X", "5D"),
    "J": ("1C", "1X", "1L", "1S", "1Z", "2L", "2X", "2S", "5Q", "5X", "5I"),
    "I": ("5A", "5B", "5C", "5X", "1P", "1X", "1D", "9A", "9B", "9C", "9X"),
    "S": ("1C", "5I", "5Q", "5X"),
}
# Second signal beside the first, uncombined: first those whose group delay is broadcast.
DEFAULT_SECOND: Final[dict[str, tuple[str, ...]]] = {
    "G": ("2W", "2P", "2Y", "2L", "2X", "2S", "2C", "5Q", "5X", "5I", "1C", "1W", "1P"),
    "R": ("2C", "2P", "1C", "1P"),
    "E": ("5Q", "5X", "5I", "7Q", "7X", "7I", "8Q", "8X", "8I", "1C", "1X", "1B"),
    "C": ("6I", "6X", "6Q", "7I", "7X", "7Q", "5P", "5X", "5D", "2I", "2X", "2Q"),
    "J": ("2L", "2X", "2S", "5Q", "5X", "5I", "1C", "1X"),
    "I": ("5A", "5B", "5C", "5X", "9A", "9B", "9C", "9X"),
    "S": ("5I", "5Q", "5X"),
}
# First and second signal of the ionosphere-free combination, in order of preference: each side takes the first present.
DEFAULT_PAIRS: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "G": (("1W", "1P", "1C", "1Y", "1X", "1L"), ("2W", "2P", "2Y", "2L", "2X", "2S", "2C", "5Q", "5X", "5I")),
    "R": (("1P", "1C"), ("2P", "2C")),
    "E": (("1C", "1X", "1B"), ("5Q", "5X", "5I", "7Q", "7X", "7I")),
    "C": (("2I", "2X", "2Q"), ("6I", "6X", "6Q", "7I", "7X", "7Q")),
    "J": (("1C", "1X", "1L", "1S"), ("2L", "2X", "2S", "5Q", "5X", "5I")),
    "I": ((), ()),
    "S": ((), ()),
}
