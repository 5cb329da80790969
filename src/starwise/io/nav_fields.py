"""Which number of a navigation record is what: one table per message, and the ranges a real orbit keeps to.

Sources: RINEX 2.11 tables A4, A11, A16; RINEX 3.05 tables A6 to A20; RINEX 4.01 tables A9 to A31.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from starwise.constants import (
    ISC_1,
    ISC_2,
    ISC_3,
    ISC_4,
    ISC_5,
    ISC_6,
    K_A_DOT,
    K_AF0,
    K_AF1,
    K_AF2,
    K_CIC,
    K_CIS,
    K_CRC,
    K_CRS,
    K_CUC,
    K_CUS,
    K_DELTA_N,
    K_DELTA_N_DOT,
    K_E,
    K_I0,
    K_IDOT,
    K_M0,
    K_OMEGA,
    K_OMEGA0,
    K_OMEGA_DOT,
    K_SQRT_A,
    K_TOE_SOW,
    MSG_CNAV,
    MSG_CNV1,
    MSG_CNV2,
    MSG_CNV3,
    MSG_D1,
    MSG_D2,
    MSG_FNAV,
    MSG_INAV,
    MSG_LNAV,
    SYS_C,
    SYS_E,
    SYS_G,
    SYS_I,
    SYS_J,
    TGD_B1CP,
    TGD_B2AP,
    TGD_MAIN,
    TGD_SECOND,
)
from starwise.types import F8


def at(line: int, column: int) -> int:
    """Index of a number by its orbit line (from 1; 0 is the clock line) and its column (from 0)."""
    return column if line == 0 else 3 + 4 * (line - 1) + column


@dataclass(frozen=True)
class Fields:
    """Where a Keplerian message keeps its numbers; -1 where it has none."""

    t_tx: int
    health: int
    toe: int = at(3, 0)
    """Seconds of the system's week; -1: the same as toc (CNAV, CNAV-2)."""
    week: int = -1
    accuracy: int = -1
    """Metres, or an index of URA_ED where ``accuracy_ned`` is given."""
    accuracy_ned: int = -1
    iode: int = -1
    iodc: int = -1
    fit: int = -1
    source: int = -1
    rates: bool = False
    """A_DOT stands in place of IODE and delta_n0_dot after IDOT (CNAV family)."""
    tgd: dict[int, int] = field(default_factory=dict)


ORBIT: Final[dict[int, int]] = {
    K_AF0: at(0, 0), K_AF1: at(0, 1), K_AF2: at(0, 2),
    K_CRS: at(1, 1), K_DELTA_N: at(1, 2), K_M0: at(1, 3),
    K_CUC: at(2, 0), K_E: at(2, 1), K_CUS: at(2, 2), K_SQRT_A: at(2, 3),
    K_CIC: at(3, 1), K_OMEGA0: at(3, 2), K_CIS: at(3, 3),
    K_I0: at(4, 0), K_CRC: at(4, 1), K_OMEGA: at(4, 2), K_OMEGA_DOT: at(4, 3),
    K_IDOT: at(5, 0),
}  # fmt: skip
"""Numbers that stand in the same place in every Keplerian message."""
RATES: Final[dict[int, int]] = {K_A_DOT: at(1, 0), K_DELTA_N_DOT: at(5, 1)}

_GPS_LNAV = Fields(
    iode=at(1, 0), week=at(5, 2), accuracy=at(6, 0), health=at(6, 1), tgd={TGD_MAIN: at(6, 2)},
    iodc=at(6, 3), t_tx=at(7, 0), fit=at(7, 1),
)  # fmt: skip
_GALILEO = Fields(
    iode=at(1, 0), source=at(5, 1), week=at(5, 2), accuracy=at(6, 0), health=at(6, 1),
    tgd={TGD_MAIN: at(6, 2), TGD_SECOND: at(6, 3)}, t_tx=at(7, 0),
)  # fmt: skip
_BDS_D = Fields(
    iode=at(1, 0), week=at(5, 2), accuracy=at(6, 0), health=at(6, 1),
    tgd={TGD_MAIN: at(6, 2), TGD_SECOND: at(6, 3)}, t_tx=at(7, 0), iodc=at(7, 1),
)  # fmt: skip
_ISC = {TGD_MAIN: at(6, 2), ISC_1: at(7, 0), ISC_2: at(7, 1), ISC_3: at(7, 2), ISC_4: at(7, 3)}
_GPS_CNAV = Fields(
    toe=-1, rates=True, accuracy=at(6, 0), accuracy_ned=at(5, 2), health=at(6, 1), tgd=_ISC, t_tx=at(8, 0)
)
_GPS_CNV2 = Fields(
    toe=-1, rates=True, accuracy=at(6, 0), accuracy_ned=at(5, 2), health=at(6, 1),
    tgd={**_ISC, ISC_5: at(8, 0), ISC_6: at(8, 1)}, t_tx=at(9, 0),
)  # fmt: skip

FIELDS: Final[dict[tuple[int, int], Fields]] = {
    (SYS_G, MSG_LNAV): _GPS_LNAV,
    (SYS_J, MSG_LNAV): _GPS_LNAV,
    (SYS_I, MSG_LNAV): Fields(
        iode=at(1, 0), week=at(5, 2), accuracy=at(6, 0), health=at(6, 1), tgd={TGD_MAIN: at(6, 2)},
        t_tx=at(7, 0),
    ),
    (SYS_E, MSG_INAV): _GALILEO,
    (SYS_E, MSG_FNAV): _GALILEO,
    (SYS_C, MSG_D1): _BDS_D,
    (SYS_C, MSG_D2): _BDS_D,
    (SYS_G, MSG_CNAV): _GPS_CNAV,
    (SYS_J, MSG_CNAV): _GPS_CNAV,
    (SYS_G, MSG_CNV2): _GPS_CNV2,
    (SYS_J, MSG_CNV2): _GPS_CNV2,
    # BDS-3: SISAI indices have no published conversion to metres (BDS-SIS-ICD-B1C-1.0 7.14), so no accuracy
    (SYS_C, MSG_CNV1): Fields(
        rates=True, tgd={ISC_1: at(7, 0), TGD_B1CP: at(7, 2), TGD_B2AP: at(7, 3)}, health=at(8, 1),
        iodc=at(8, 3), t_tx=at(9, 0), iode=at(9, 3),
    ),
    (SYS_C, MSG_CNV2): Fields(
        rates=True, tgd={ISC_2: at(7, 1), TGD_B1CP: at(7, 2), TGD_B2AP: at(7, 3)}, health=at(8, 1),
        iodc=at(8, 3), t_tx=at(9, 0), iode=at(9, 3),
    ),
    (SYS_C, MSG_CNV3): Fields(rates=True, tgd={TGD_B2AP: at(7, 3)}, health=at(7, 1), t_tx=at(8, 0)),
}  # fmt: skip

SQRT_A_RANGE: Final[dict[int, tuple[float, float]]] = {
    # sqrt(m): the orbits in use with room for disposal and test orbits (E14, E18: 5289 sqrt(m))
    SYS_G: (4900.0, 5500.0),
    SYS_E: (5000.0, 5800.0),
    SYS_C: (4900.0, 6700.0),
    SYS_J: (6300.0, 6700.0),
    SYS_I: (6300.0, 6700.0),
}
MAX_ABS: Final[dict[int, tuple[str, float]]] = {
    # the widest field among the ICDs (IS-GPS-200N, Galileo OS SIS 2.1, BDS B1I 3.0 and B1C 1.0), rounded up
    K_AF0: ("clock bias", 0.07),  # Galileo: 31 bits of 2^-34 s
    K_AF1: ("clock drift", 2e-8),  # Galileo: 21 bits of 2^-46
    K_AF2: ("clock drift rate", 5e-15),  # GPS: 8 bits of 2^-55
    K_I0: ("inclination", 3.2),
    K_OMEGA0: ("longitude of node", 6.4),  # some writers count from 0 to 2 pi
    K_OMEGA: ("argument of perigee", 6.4),
    K_M0: ("mean anomaly", 6.4),
    K_DELTA_N: ("mean motion difference", 1e-7),  # GPS 1.2e-8; NavIC has 22 bits of 2^-41 semicircles/s and uses 2e-8
    K_OMEGA_DOT: ("rate of node", 1e-6),
    K_IDOT: ("rate of inclination", 3e-9),  # 14 bits of 2^-43 semicircles/s
    K_CUC: ("Cuc", 1e-3),
    K_CUS: ("Cus", 1e-3),
    K_CIC: ("Cic", 1e-3),
    K_CIS: ("Cis", 1e-3),
    K_CRC: ("Crc", 33_000.0),
    K_CRS: ("Crs", 33_000.0),
    K_A_DOT: ("rate of semi-major axis", 17.0),
    K_DELTA_N_DOT: ("rate of mean motion difference", 1e-10),  # CNAV: 23 bits of 2^-57 semicircles/s^2
}
ESSENTIAL: Final = (*ORBIT, K_TOE_SOW)
"""Columns that may not be blank."""

GLONASS_ACCURACY: Final = np.array(
    # m by index F_T (GLONASS ICD L1/L2 5.1 table 4.4); 15: RINEX 3.05 writes it where F_T is not known
    [1.0, 2.0, 2.5, 4.0, 5.0, 7.0, 10.0, 12.0, 14.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0, np.nan]
)


def ura_index_m(index: F8) -> F8:
    """User range accuracy, m, of a signed index (IS-GPS-200N 20.3.3.3.1.3 and 30.3.3.1.1.4).

    15 and -16 say that there is no prediction (inf); NaN stays NaN.
    """
    n = np.clip(np.round(index), -16.0, 15.0)
    ura = np.where(n <= 6, 2.0 ** (1.0 + n / 2.0), 2.0 ** (n - 2.0))
    ura = np.where((n == 15) | (n == -16), np.inf, ura)
    return np.where(np.isnan(index), np.nan, ura)
