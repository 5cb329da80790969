"""Numbers of navigation records into columns: units, times, accuracies, and the test that they make an orbit."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    DAY_S,
    K_A_DOT,
    K_DELTA_N_DOT,
    K_E,
    K_SQRT_A,
    K_TOE_SOW,
    MSG_CNAV,
    MSG_CNV2,
    MSG_FDMA,
    MSG_FNAV,
    MSG_INAV,
    MSG_SBAS,
    N_EPH_PAR,
    N_TGD,
    NS,
    R_AX,
    R_CHANNEL,
    R_DTAU,
    R_GAMMA,
    R_TAU,
    R_VX,
    R_X,
    SYS_C,
    SYS_E,
    SYS_G,
    SYS_J,
    SYS_R,
    TGD_SECOND,
    WEEK_S,
)
from starwise.gnsstime import BDT_OFFSET_S, BDT_WEEK_OFFSET, utc_to_gpst
from starwise.io.nav_fields import (
    FIELDS,
    GLONASS_ACCURACY,
    MAX_ABS,
    ORBIT,
    RATES,
    SQRT_A_RANGE,
    Fields,
    at,
    ura_index_m,
)
from starwise.types import F8, I2, I4, I8

Mask = NDArray[np.bool_]

T_TX_WINDOW_S: Final = DAY_S
"""A transmission time further than this from toe is not one (0.9999E9 for "unknown")."""
TOE_WINDOW_S: Final = 4 * 3600
"""Clock and orbit of a data set share their reference time, all but a few (IS-GPS-200N 20.3.4.5); with a clock
further off than a fit interval one of the two is damaged."""
FRAME_WINDOW_S: Final = 3600
"""The same for GLONASS and SBAS, whose messages are sent within half an hour of their epoch."""
SENT_S: Final[dict[tuple[int, int | None], int]] = {
    # When a data set is first sent, as a rule, against its toe, s; for records that do not say. Others: at toe.
    (SYS_G, None): -7200,  # toe is 2 h after the first transmission (IS-GPS-200N table 20-XIII)
    (SYS_G, MSG_CNAV): -5400,  # toe is 1.5 h after it (IS-GPS-200N table 30-XIII)
    (SYS_G, MSG_CNV2): -5400,  # IS-GPS-800J 3.5.3
    (SYS_J, None): -3600,  # fit of 2 h about toe (IS-QZSS-PNT-005 5.4.1.2)
    (SYS_E, None): 660,  # no rule published; of 13 000 records 89 in 100 begin 655 to 745 s after toe, 1 in 1000 before
    (SYS_R, None): -900,  # t_b is the middle of half an hour (GLONASS ICD L1/L2 5.1, 4.4)
}
NO_PREDICTION_M: Final = 6144.0
"""Above this a URA in metres says "no accuracy prediction" (IS-GPS-200N 20.3.3.3.1.3, N = 15)."""


@dataclass
class Records:
    """Columns of `starwise.types.BroadcastRecords` before merging, with the line each record came from."""

    sv: I2
    message: NDArray[np.int8]
    toc_ns: I8
    toe_ns: I8
    t_tx_ns: I8
    par: F8
    tgd: F8
    accuracy_m: F8
    health: I4
    iode: I4
    iodc: I4
    fit_s: F8
    source: I4
    line: I8
    file: I4
    week_off: Mask
    """The week number contradicts the epoch."""


Fault = tuple[str, Mask]
"""What is wrong, and in which records."""


def keplerian(system: int, message: int, prn: I8, label: I8, line: I8, v: F8) -> tuple[Records, list[Fault]]:
    """Records of one system and message, and the faults that make some of them unusable.

    Parameters
    ----------
    system, message : int
    prn, label, line : (n,) int64
        Satellite number, epoch (toc) as ns since 1980-01-06 in the scale of the system, line in the file.
    v : (n, N_VALUES) float64
        Numbers in file order: NaN where blank, inf where not readable.
    """
    f = FIELDS[system, message]
    n = len(prn)
    shift = BDT_OFFSET_S * NS if system == SYS_C else 0
    par, tgd = np.zeros((n, N_EPH_PAR)), np.full((n, N_TGD), np.nan)
    for column, index in ORBIT.items():
        par[:, column] = v[:, index]
    if f.rates:
        for column, index in RATES.items():
            par[:, column] = v[:, index]
    for column, index in f.tgd.items():
        tgd[:, column] = v[:, index]
    toc_sow = label % (WEEK_S * NS) / NS  # weeks of every system start on Sunday 00:00 in its own scale
    sow = toc_sow.copy() if f.toe < 0 else v[:, f.toe]
    par[:, K_TOE_SOW] = sow
    source = _integer(v, f.source, 0) if f.source >= 0 else np.zeros(n, np.int32)
    codes = np.full(n, message, np.int8)
    if message == MSG_INAV and f.source >= 0:
        codes[_is_fnav(source)] = MSG_FNAV
    tgd[codes == MSG_FNAV, TGD_SECOND] = np.nan  # F/NAV has no BGD(E1, E5b); writers put 0 or the one of I/NAV
    faults = _orbit_faults(system, par, v, f)
    faults.append(("a group delay is not readable", np.isinf(tgd).any(axis=1)))
    faults.append(("toe outside the week", ~((sow >= 0.0) & (sow < WEEK_S))))
    toe = label + _wrapped_ns(sow - toc_sow, WEEK_S)
    faults.append(("toe far from toc", np.abs(toe - label) > TOE_WINDOW_S * NS))
    t_tx = toe + _since(v[:, f.t_tx], sow, WEEK_S, T_TX_WINDOW_S, _sent(system, message))
    health, iode, iodc = (_integer(v, i) for i in (f.health, f.iode, f.iodc))
    records = Records(
        sv=(system << 8 | prn).astype(np.int16),
        message=codes,
        toc_ns=label + shift,
        toe_ns=toe + shift,
        t_tx_ns=t_tx + shift,
        par=par,
        tgd=tgd,
        accuracy_m=_accuracy(system, v, f),
        health=health,
        iode=iode,
        iodc=iodc,
        fit_s=_fit(system, v[:, f.fit]) if f.fit >= 0 else np.full(n, np.nan),
        source=source,
        line=line,
        file=np.zeros(n, np.int32),
        week_off=_week_off(system, toe, v[:, f.week]) if f.week >= 0 else np.zeros(n, bool),
    )
    return records, faults


def _wrapped_ns(seconds: F8, period: int) -> I8:
    """Seconds folded to within half a period of zero, as ns; 0 where there is no number."""
    good = np.where(np.isfinite(seconds), seconds, 0.0)
    folded: F8 = good - period * np.rint(good / period)
    return np.rint(folded * 1e3).astype(np.int64) * 1_000_000


def _sent(system: int, message: int) -> int:
    """Seconds from toe to the first transmission, as a rule."""
    return SENT_S.get((system, message), SENT_S.get((system, None), 0))


def _since(t_tx: F8, reference: F8, period: int, window: int, rule: int) -> I8:
    """Transmission minus reference time, ns, folded to the nearest; ``rule`` where the file has no credible time.

    Nor is 0 one: writers put it for "unknown", and at the start of a week and of a day the rule says nearly the same.
    """
    with np.errstate(invalid="ignore"):
        since = t_tx - reference
        since = since - period * np.rint(since / period)
        good = (np.abs(t_tx) < 2 * WEEK_S) & (t_tx != 0.0) & (np.abs(since) <= window)
    return np.rint(np.where(good, since, float(rule)) * 1e3).astype(np.int64) * 1_000_000


def _integer(v: F8, index: int, missing: int = -1) -> I4:
    """A column of whole numbers; ``missing`` where blank, not readable or too large."""
    if index < 0:
        return np.full(len(v), missing, np.int32)
    column = v[:, index]
    good = np.isfinite(column) & (np.abs(column) < 2**31 - 1)
    return np.where(good, np.rint(np.where(good, column, 0.0)), missing).astype(np.int32)


def _is_fnav(source: I4) -> Mask:
    """F/NAV by the data sources of Galileo (RINEX 3.05 table A8): bit 1, without bits 0 and 2; else bit 8."""
    inav, fnav = (source & 0b101) != 0, (source & 0b10) != 0
    clock_e5a = (source & 0b1_0000_0000) != 0
    by_bits: Mask = np.where(inav == fnav, clock_e5a, fnav)
    return by_bits


def _accuracy(system: int, v: F8, f: Fields) -> F8:
    """1-sigma range accuracy, m: NaN if not known, inf if the satellite says that it gives none."""
    if f.accuracy < 0:
        return np.full(len(v), np.nan)
    given = v[:, f.accuracy]
    if f.accuracy_ned >= 0:  # CNAV: elevation dependent and independent parts, as indices
        return np.hypot(ura_index_m(given), ura_index_m(v[:, f.accuracy_ned]))
    if system == SYS_E:  # SISA in metres, -1 for "no accuracy prediction available"
        return np.where(given < 0.0, np.inf, np.where(given > 0.0, given, np.nan))
    good = np.where(given > NO_PREDICTION_M, np.inf, np.where(given < 0.0, np.nan, given))
    return np.where(given == 0.0, 2.0, good)  # index 0 written in place of its metres


def _fit(system: int, given: F8) -> F8:
    """Fit interval, s. GPS: hours, but 1 is the flag ("more than four": six hours); QZSS: the flag (2 or 4 hours)."""
    if system == SYS_J:
        hours = np.where(given == 0.0, 2.0, np.where(given == 1.0, 4.0, given))
    else:
        hours = np.where(given == 1.0, 6.0, np.where(given > 0.0, given, np.nan))
    return np.where((hours > 0.0) & (hours <= 200.0), hours * 3600.0, np.nan)


def _week_off(system: int, toe_label: I8, week: F8) -> Mask:
    """Whether a week number is neither that of toe nor a neighbour, in any of the counts that writers use.

    Weeks modulo 1024 (which makes Galileo's own count and the GPS one the same) and, for BeiDou, both BDT and GPS
    weeks pass; a week that is blank or 0 says nothing.
    """
    given = np.where(np.isfinite(week), week, 0.0)
    true = toe_label // (WEEK_S * NS)
    difference = np.mod(true - given + 1.0, 1024.0)
    agrees = difference <= 2.0
    if system == SYS_C:
        agrees |= np.mod(true - BDT_WEEK_OFFSET - given + 1.0, 1024.0) <= 2.0
    off: Mask = ~agrees & (given > 0.0)
    return off


def _orbit_faults(system: int, par: F8, v: F8, f: Fields) -> list[Fault]:
    used = [*ORBIT, K_TOE_SOW] + ([K_A_DOT, K_DELTA_N_DOT] if f.rates else [])
    numbers = np.concatenate([par[:, used], v[:, [f.health]]], axis=1)
    others = [i for i in (f.t_tx, f.week, f.accuracy, f.accuracy_ned, f.iode, f.iodc, f.fit, f.source) if i >= 0]
    faults: list[Fault] = [
        ("a number is not readable", np.isinf(numbers).any(axis=1) | np.isinf(v[:, others]).any(axis=1)),
        ("a number is missing", np.isnan(numbers).any(axis=1)),
        ("eccentricity outside [0, 0.5)", ~((par[:, K_E] >= 0.0) & (par[:, K_E] < 0.5))),
    ]
    low, high = SQRT_A_RANGE[system]
    faults.append(("semi-major axis of no satellite", ~((par[:, K_SQRT_A] >= low) & (par[:, K_SQRT_A] <= high))))
    for column, (what, limit) in MAX_ABS.items():
        faults.append((f"{what} out of range", ~(np.abs(par[:, column]) <= limit)))
    return faults


def tabulated(system: int, prn: I8, label: I8, line: I8, v: F8) -> tuple[Records, list[Fault]]:
    """Records of GLONASS or SBAS: position, velocity and acceleration at an epoch. Parameters as `keplerian`."""
    glonass = system == SYS_R
    n = len(prn)
    par, tgd = np.zeros((n, N_EPH_PAR)), np.full((n, N_TGD), np.nan)
    par[:, R_TAU], par[:, R_GAMMA] = v[:, 0], v[:, 1]
    for axis in range(3):
        for column, index in ((R_X, 0), (R_VX, 1), (R_AX, 2)):
            par[:, column + axis] = v[:, at(axis + 1, index)] * 1000.0
    essential = np.concatenate([par[:, : R_AX + 3], v[:, [at(1, 3), at(2, 3)]]], axis=1)
    faults: list[Fault] = [
        ("a number is not readable", np.isinf(essential).any(axis=1) | np.isinf(v[:, 2])),
        ("a number is missing", np.isnan(essential).any(axis=1)),
    ]
    radius: F8 = np.sqrt((par[:, R_X : R_X + 3] ** 2).sum(axis=1))
    speed: F8 = np.sqrt((par[:, R_VX : R_VX + 3] ** 2).sum(axis=1))
    # SBAS fields: 8 bits of 0.0000625 m/s^2 and more (RTCA DO-229 A.4.4.11)
    low, high, fastest, jolt = (20e6, 30e6, 5e3, 1e-3) if glonass else (38e6, 46e6, 4e3, 0.04)
    steady: Mask = np.abs(par[:, R_AX : R_AX + 3]).max(axis=1) <= jolt
    faults += [
        ("position of no satellite", ~((radius >= low) & (radius <= high))),
        ("velocity of no satellite", ~(speed <= fastest)),
        ("acceleration out of range", ~steady),
        ("clock out of range", ~((np.abs(par[:, R_TAU]) <= 2.1e-3) & (np.abs(par[:, R_GAMMA]) <= 2e-9))),
    ]
    if glonass:
        epoch = utc_to_gpst(label)
        accuracy, health = _glonass_words(par, v, faults)
        since = _since(v[:, 2], (label % (DAY_S * NS)) / NS, DAY_S, FRAME_WINDOW_S, _sent(system, MSG_FDMA))
        iode = np.rint((label + 10_800 * NS) % (DAY_S * NS) / (900 * NS)).astype(np.int32)  # t_b of the Moscow day
    else:
        epoch = label
        accuracy = _accuracy(system, np.ascontiguousarray(v), Fields(t_tx=-1, health=-1, accuracy=at(2, 3)))
        health = _integer(v, at(1, 3), 0)
        since = _since(v[:, 2], (label % (WEEK_S * NS)) / NS, WEEK_S, FRAME_WINDOW_S, 0)
        iode = _integer(v, at(3, 3))
    records = Records(
        sv=(system << 8 | prn).astype(np.int16),
        message=np.full(n, MSG_FDMA if glonass else MSG_SBAS, np.int8),
        toc_ns=epoch,
        toe_ns=epoch,
        t_tx_ns=epoch + since,
        par=par,
        tgd=tgd,
        accuracy_m=accuracy,
        health=health,
        iode=iode,
        iodc=np.full(n, -1, np.int32),
        fit_s=np.full(n, np.nan),
        source=np.zeros(n, np.int32),
        line=line,
        file=np.zeros(n, np.int32),
        week_off=np.zeros(n, bool),
    )
    return records, faults


def _glonass_words(par: F8, v: F8, faults: list[Fault]) -> tuple[F8, I4]:
    """Channel, DeltaTau, accuracy and health of GLONASS (RINEX 3.05 table A10).

    Health: B_n as the file gives it (bits 0 to 2), 8 if l_n of string 3 says unhealthy, 16 if the almanac does.
    """
    channel = v[:, at(2, 3)]
    faults.append(("frequency channel outside -7..13", ~((channel >= -7.0) & (channel <= 13.0))))
    par[:, R_CHANNEL] = np.where(np.isfinite(channel), np.rint(channel), 0.0)
    dtau = v[:, at(4, 1)]
    par[:, R_DTAU] = np.where(np.abs(dtau) < 1e-6, dtau, np.nan)  # .999999999999E+09 is "not known"
    index = _integer(v, at(4, 2), 15)
    accuracy = GLONASS_ACCURACY[np.where((index >= 0) & (index <= 15), index, 15)]
    flags = _integer(v, at(4, 3), 0)
    flags = np.where((flags > 0) & (flags < 8), flags, 0)
    health = _integer(v, at(1, 3), 1)
    health = np.where((health >= 0) & (health < 8), health, 7)
    health = health | np.where(flags & 4, 8, 0) | np.where((flags & 3) == 2, 16, 0)
    return accuracy, health.astype(np.int32)
