"""Sizes of what real navigation messages have wrong, by system.

The sum is the global average signal-in-space range error (SISRE) of Montenbruck, Steigenberger and Hauschild,
"Multi-GNSS signal-in-space range error assessment - methodology and results", Advances in Space Research 61 (2018):
GPS 0.6 m, Galileo 0.2 m, BeiDou-2 1 m, GLONASS 2 m (abstract; January to December 2017). Chosen here, without a
published number: QZSS as GPS; BeiDou-3 0.6 m, between BeiDou-2 and Galileo since its satellites measure to each other;
and how the sum divides among the axes: along the track most, across less, the height small against the clock, which
makes most of the sum except for Galileo.
"""

import math
from typing import Final

import numpy as np

from starwise.constants import SYSTEMS
from starwise.signals import sv_name
from starwise.types import F8

TYPICAL: Final[dict[str, tuple[float, float, float, float]]] = {
    "gps": (0.20, 1.00, 0.50, 0.53),
    "glonass": (0.35, 1.20, 1.20, 1.95),
    "galileo": (0.12, 0.30, 0.25, 0.15),
    "beidou2": (0.50, 1.50, 1.20, 0.85),
    "beidou3": (0.10, 0.35, 0.30, 0.58),
    "qzss": (0.30, 1.00, 1.00, 0.50),
}
"""Radial, along track, cross track, clock: 1 sigma, m, independent of each other."""
WEIGHT_RADIAL: Final = 0.98
WEIGHT_ACROSS: Final = {"gps": 49.0, "glonass": 45.0, "galileo": 61.0, "beidou2": 54.0, "beidou3": 54.0, "qzss": 126.0}
"""Mean part of an orbit error in the range, over all places that see the satellite: factor of the radial error, and
reciprocal of the squared factor of the other two; Montenbruck et al. (2015), table 4."""
_NAME: Final = {"G": "gps", "R": "glonass", "E": "galileo", "J": "qzss"}
_FIRST_BEIDOU3: Final = 19
"""Satellites of BeiDou from this number on are of the third generation."""


def constellation_of(sv: int) -> str:
    """Key of `TYPICAL` of a satellite; systems without one count as GPS."""
    name = sv_name(sv)
    assert name[0] in SYSTEMS
    if name[0] == "C":
        return "beidou3" if int(name[1:]) >= _FIRST_BEIDOU3 else "beidou2"
    return _NAME.get(name[0], "gps")


def typical_sizes(sv: int) -> F8:
    """Radial, along-track, cross-track and clock error of a satellite's broadcast ephemeris, 1 sigma, m, (4,)."""
    return np.array(TYPICAL[constellation_of(sv)])


def range_error(name: str) -> float:
    """Signal-in-space range error that a row of `TYPICAL` amounts to, RMS over the Earth, m.

    Montenbruck et al. (2015), equation 3, with errors of orbit and clock that are independent.
    """
    radial, along, cross, clock = TYPICAL[name]
    return math.sqrt((WEIGHT_RADIAL * radial) ** 2 + clock**2 + (along**2 + cross**2) / WEIGHT_ACROSS[name])
