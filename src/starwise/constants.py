"""Physical constants and the small integer codes shared by kernels and nouns, each with its source.

Everything is SI. Kernels may import this module and nothing else of the package: numba freezes these
values into the compiled code.
"""

from typing import Final

C_LIGHT: Final = 299_792_458.0
"""Speed of light, m/s (exact; IS-GPS-200N 20.3.4.3)."""

# -- Earth ------------------------------------------------------------------------------------------------
OMEGA_E_GPS: Final = 7.2921151467e-5
"""Earth rotation rate, rad/s (IS-GPS-200N table 20-IV; Galileo OS SIS ICD 2.1 table 67; IS-QZSS-PNT-005)."""
OMEGA_E_BDS: Final = 7.2921150e-5
"""Earth rotation rate in BDCS, rad/s (BDS-SIS-ICD-B1I-3.0 section 3.2)."""
OMEGA_E_GLO: Final = 7.2921151467e-5
"""Earth rotation rate in PZ-90.11, rad/s (GLONASS ICD general description 2016; L1/L2 ICD 5.1 has 7.292115e-5)."""

MU_GPS: Final = 3.986005e14
"""Gravitational constant of the GPS and QZSS user algorithm, m^3/s^2 (IS-GPS-200N table 20-IV)."""
MU_GAL: Final = 3.986004418e14
"""Gravitational constant, m^3/s^2 (Galileo OS SIS ICD 2.1 table 67)."""
MU_BDS: Final = 3.986004418e14
"""Gravitational constant, m^3/s^2 (BDS-SIS-ICD-B1I-3.0 section 3.2)."""
MU_GLO: Final = 3.986004418e14
"""Gravitational constant, m^3/s^2 (PZ-90.11, GLONASS ICD CDMA general description 2016; L1/L2 ICD 5.1 has ...44e14)."""
J2_GLO: Final = 1.0826257e-3
"""Second zonal harmonic (GLONASS ICD L1/L2 5.1, A.3.1.2)."""
AE_GLO: Final = 6_378_136.0
"""Equatorial radius of PZ-90, m (GLONASS ICD L1/L2 5.1, A.3.1.2)."""

WGS84_A: Final = 6_378_137.0
"""Semi-major axis of the WGS 84 ellipsoid, m (NGA.STND.0036 table 3.1)."""
WGS84_F: Final = 1.0 / 298.257223563
"""Flattening of the WGS 84 ellipsoid (NGA.STND.0036 table 3.1)."""
WGS84_E2: Final = WGS84_F * (2.0 - WGS84_F)
"""First eccentricity squared of the WGS 84 ellipsoid."""

# -- Time -------------------------------------------------------------------------------------------------
NS: Final = 1_000_000_000
"""Nanoseconds in a second."""
DAY_S: Final = 86_400
"""Seconds in a day."""
WEEK_S: Final = 604_800
"""Seconds in a week."""

# -- Systems: the high byte of a satellite identifier is the index in SYSTEMS ------------------------------
SYSTEMS: Final = "GRECJIS"
"""RINEX system letters (RINEX 3.05 table 2), in the order of the system index."""
N_SYSTEMS: Final = 7
SYS_G: Final = 0
SYS_R: Final = 1
SYS_E: Final = 2
SYS_C: Final = 3
SYS_J: Final = 4
SYS_I: Final = 5
SYS_S: Final = 6

# -- Navigation messages (RINEX 4.01 table 13) -------------------------------------------------------------
MSG_UNKNOWN: Final = 0
MSG_LNAV: Final = 1
MSG_CNAV: Final = 2
MSG_CNV1: Final = 3
MSG_CNV2: Final = 4
MSG_CNV3: Final = 5
MSG_INAV: Final = 6
MSG_FNAV: Final = 7
MSG_D1: Final = 8
MSG_D2: Final = 9
MSG_FDMA: Final = 10
MSG_SBAS: Final = 11
MESSAGE_NAMES: Final = (
    "?", "LNAV", "CNAV", "CNV1", "CNV2", "CNV3", "INAV", "FNAV", "D1", "D2", "FDMA", "SBAS",
)  # fmt: skip

# -- Columns of a broadcast ephemeris' parameter array -----------------------------------------------------
# Keplerian records (G, E, C, J, I). Angles rad, lengths m, times s; names as in IS-GPS-200N table 20-II.
K_AF0: Final = 0  # s
K_AF1: Final = 1  # s/s
K_AF2: Final = 2  # s/s^2
K_SQRT_A: Final = 3  # sqrt(m)
K_E: Final = 4
K_I0: Final = 5
K_OMEGA0: Final = 6
K_OMEGA: Final = 7
K_M0: Final = 8
K_DELTA_N: Final = 9
K_OMEGA_DOT: Final = 10
K_IDOT: Final = 11
K_CUC: Final = 12
K_CUS: Final = 13
K_CRC: Final = 14
K_CRS: Final = 15
K_CIC: Final = 16
K_CIS: Final = 17
K_A_DOT: Final = 18  # m/s (CNAV, CNV1..3), 0 elsewhere
K_DELTA_N_DOT: Final = 19  # rad/s^2 (CNAV, CNV1..3), 0 elsewhere
K_TOE_SOW: Final = 20  # s of the system's own week: omega_k needs it
N_EPH_PAR: Final = 21
# GLONASS and SBAS records (ECEF at the reference time): the same array, other columns.
R_TAU: Final = 0  # s, clock offset as RINEX gives it: -TauN (GLONASS) or aGf0 (SBAS); add to satellite time
R_GAMMA: Final = 1  # s/s, +GammaN or aGf1
R_X: Final = 2  # m; y, z follow
R_VX: Final = 5  # m/s
R_AX: Final = 8  # m/s^2 (luni-solar)
R_CHANNEL: Final = 11  # FDMA frequency channel -7..6
R_DTAU: Final = 12  # s, DeltaTau_n between L2 and L1 (RINEX 3.05 4th line), NaN if absent
# Group delays, a second array of N_TGD columns, seconds, NaN where not broadcast.
TGD_MAIN: Final = 0  # G J I: TGD; E: BGD(E1, E5a); C: TGD1 (B1I against B3I)
TGD_SECOND: Final = 1  # E: BGD(E1, E5b); C: TGD2 (B2I against B3I)
TGD_B1CP: Final = 2  # C CNV1/2: TGD of B1C pilot
TGD_B2AP: Final = 3  # C CNV1/2: TGD of B2a pilot; CNV3: of B2b I
ISC_1: Final = 4  # ISC L1C/A (CNAV), ISC_B1Cd (CNV1)
ISC_2: Final = 5  # ISC L2C (CNAV), ISC_B2ad (CNV2)
ISC_3: Final = 6  # ISC L5I5
ISC_4: Final = 7  # ISC L5Q5
ISC_5: Final = 8  # ISC L1Cd
ISC_6: Final = 9  # ISC L1Cp
N_TGD: Final = 10

# -- Status of a satellite's state ---------------------------------------------------------------------------
SAT_OK: Final = 0
SAT_NO_EPHEMERIS: Final = 1
SAT_UNHEALTHY: Final = 2
SAT_TOO_OLD: Final = 3
SAT_BAD_EPHEMERIS: Final = 4  # the numbers do not make an orbit (checked on reading or evaluation)
SAT_NO_CLOCK: Final = 5
SAT_INACCURATE: Final = 6  # "no accuracy prediction available": URA index 15, SISA 255

# -- Status of a row (epoch, satellite, signal) in the ledger -----------------------------------------------
ROW_USED: Final = 0
ROW_COMBINED: Final = 1  # second signal of an ionosphere-free pair whose first signal carries the row
ROW_NOT_SELECTED: Final = 2  # another signal of this satellite was preferred
ROW_SYSTEM_OFF: Final = 3
ROW_NO_CODE: Final = 4  # the satellite is in the epoch, its pseudorange is blank
ROW_BAD_CODE: Final = 5  # outside the range any satellite can have
ROW_NO_EPHEMERIS: Final = 6
ROW_UNHEALTHY: Final = 7
ROW_EPHEMERIS_TOO_OLD: Final = 8
ROW_BAD_EPHEMERIS: Final = 9
ROW_NO_CLOCK: Final = 10
ROW_INACCURATE: Final = 11
ROW_LOW_ELEVATION: Final = 12
ROW_LOW_CN0: Final = 13
ROW_GATED: Final = 14  # innovation outside the filter's gate
ROW_EXCLUDED: Final = 15  # least squares: fault detection and exclusion
ROW_EPOCH_UNSOLVED: Final = 16
ROW_NO_PAIR: Final = 17  # ionosphere-free asked for and the second frequency is missing
ROW_NO_FREQUENCY: Final = 18  # GLONASS channel unknown, or a band without a frequency in the table
ROW_EXCLUDED_BY_USER: Final = 19
ROW_STATUS_NAMES: Final = (
    "used", "combined", "not_selected", "system_off", "no_code", "bad_code", "no_ephemeris", "unhealthy",
    "ephemeris_too_old", "bad_ephemeris", "no_clock", "inaccurate", "low_elevation", "low_cn0", "gated",
    "excluded", "epoch_unsolved", "no_pair", "no_frequency", "excluded_by_user",
)  # fmt: skip

# -- Status of an epoch of a solution -----------------------------------------------------------------------
EPOCH_OK: Final = 0
EPOCH_NO_SOLUTION: Final = 1
EPOCH_COASTED: Final = 2  # predicted only: no measurement was used at this epoch
EPOCH_SUSPECT: Final = 3  # a position that failed its own consistency test, or that nothing can check
EPOCH_RESET: Final = 4  # the filter was lost and started again at this epoch
EPOCH_STATUS_NAMES: Final = ("ok", "none", "coasted", "suspect", "reset")
