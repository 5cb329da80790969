"""GNSS time scales. Inside the package, time is int64 nanoseconds of GPST since 1980-01-06 00:00:00.

A float64 of seconds since 1980 steps by 0.24 us: 71 m of light. Leap seconds live here and nowhere else.

Scales (RINEX 3.05 section 4.1; IS-GPS-200N 3.3.4; BDS-SIS-ICD-B1I-3.0 3.3; GLONASS ICD L1/L2 5.1, 3.3.3):

* GPST = QZSST = GST (Galileo) = IRNSST to the nanoseconds that inter-system clock states absorb;
* BDT = GPST - 14 s;
* UTC = GPST - (TAI-UTC - 19 s);
* GLONASST = UTC + 3 h.
"""

import datetime as dt
import re
from typing import Final, overload

import numpy as np
from numpy.typing import NDArray

from starwise.constants import DAY_S, NS, WEEK_S
from starwise.errors import StarwiseError

GPS_EPOCH: Final = dt.datetime(1980, 1, 6)
"""Origin of GPST (IS-GPS-200N 3.3.4)."""
BDT_OFFSET_S: Final = 14
"""GPST - BDT, s (BDT started 2006-01-01 UTC, when GPST - UTC was 14 s; BDS-SIS-ICD-B1I-3.0 3.3)."""
BDT_WEEK_OFFSET: Final = 1356
"""GPS week of BDT week 0."""
GST_WEEK_OFFSET: Final = 1024
"""GPS week of Galileo system time week 0 (Galileo OS SIS ICD 2.1, 5.1.2)."""
GLONASST_UTC_S: Final = 10_800
"""GLONASST - UTC, s (GLONASS ICD L1/L2 5.1, 3.3.3)."""

_LEAP_DATES: Final = (
    # GPST - UTC becomes 1, 2, ... 18 s at 00:00 UTC of these days (IERS Bulletin C; none announced after 2017)
    (1981, 7, 1), (1982, 7, 1), (1983, 7, 1), (1985, 7, 1), (1988, 1, 1), (1990, 1, 1), (1991, 1, 1),
    (1992, 7, 1), (1993, 7, 1), (1994, 7, 1), (1996, 1, 1), (1997, 7, 1), (1999, 1, 1), (2006, 1, 1),
    (2009, 1, 1), (2012, 7, 1), (2015, 7, 1), (2017, 1, 1),
)  # fmt: skip
_LEAP_UTC_NS: Final = np.array(
    [(dt.datetime(*d) - GPS_EPOCH) // dt.timedelta(seconds=1) * NS for d in _LEAP_DATES], dtype=np.int64
)
"""UTC label (ns since 1980-01-06 UTC, leap seconds not counted) from which each leap second counts."""
_LEAP_GPST_NS: Final = _LEAP_UTC_NS + np.arange(1, len(_LEAP_DATES) + 1) * NS

IntArray = NDArray[np.int64]


@overload
def leap_seconds(t_ns: int) -> int: ...
@overload
def leap_seconds(t_ns: IntArray) -> IntArray: ...
def leap_seconds(t_ns: int | IntArray) -> int | IntArray:
    """GPST - UTC, s, at a GPST.

    Parameters
    ----------
    t_ns : int or (n,) int64 array
        GPST, ns since 1980-01-06.
    """
    n = np.searchsorted(_LEAP_GPST_NS, t_ns, side="right")
    return int(n) if np.ndim(n) == 0 else n.astype(np.int64)


@overload
def utc_to_gpst(utc_ns: int) -> int: ...
@overload
def utc_to_gpst(utc_ns: IntArray) -> IntArray: ...
def utc_to_gpst(utc_ns: int | IntArray) -> int | IntArray:
    """GPST, ns, of a UTC label given as ns since 1980-01-06 00:00 UTC without leap seconds."""
    n = np.searchsorted(_LEAP_UTC_NS, utc_ns, side="right")
    return int(utc_ns + int(n) * NS) if np.ndim(n) == 0 else utc_ns + n.astype(np.int64) * NS


@overload
def gpst_to_utc(t_ns: int) -> int: ...
@overload
def gpst_to_utc(t_ns: IntArray) -> IntArray: ...
def gpst_to_utc(t_ns: int | IntArray) -> int | IntArray:
    """UTC label, ns since 1980-01-06 00:00 UTC without leap seconds, of a GPST (23:59:60 maps to 00:00:00)."""
    return t_ns - leap_seconds(t_ns) * NS


def week_tow(t_ns: int) -> tuple[int, float]:
    """GPS week (not truncated) and time of week, s, of a GPST."""
    week, tow_ns = divmod(int(t_ns), WEEK_S * NS)
    return week, tow_ns / NS


def from_week_tow(week: int, tow_s: float) -> int:
    """GPST, ns, of a GPS week (not truncated) and a time of week in seconds (rounded to the nanosecond)."""
    return week * WEEK_S * NS + round(tow_s * NS)


def from_calendar(
    year: int, month: int, day: int, hour: int = 0, minute: int = 0, second: float = 0.0, system: str = "GPS"
) -> int:
    """GPST, ns, of a calendar label in a time system named as in RINEX.

    Parameters
    ----------
    year, month, day, hour, minute : int
        The label. Two-digit years follow RINEX 2: 80-99 are 1980-1999, 00-79 are 2000-2079.
    second : float
        0 <= second < 61, rounded to the nanosecond.
    system : {"GPS", "GAL", "QZS", "IRN", "BDT", "GLO", "UTC"}
        GLO labels in RINEX files are UTC (RINEX 3.05 section 4.1), not Moscow time.

    Raises
    ------
    StarwiseError
        The label is not a date, or the system is unknown.
    """
    if 0 <= year < 100:
        year += 1900 if year >= 80 else 2000
    try:
        days = (dt.date(year, month, day) - GPS_EPOCH.date()).days
    except ValueError as error:
        raise StarwiseError(f"not a date: {year}-{month}-{day} ({error})") from None
    if not (0 <= hour <= 24 and 0 <= minute <= 60 and 0.0 <= second < 61.0):
        raise StarwiseError(f"not a time of day: {hour}:{minute}:{second}")
    label = (days * DAY_S + hour * 3600 + minute * 60) * NS + round(second * NS)
    return label_to_gpst(label, system)


def label_to_gpst(label_ns: int, system: str) -> int:
    """GPST, ns, of a label (ns since 1980-01-06 00:00 in the scale ``system``, as in `from_calendar`)."""
    if system in ("GPS", "GAL", "QZS", "IRN"):
        return label_ns
    if system == "BDT":
        return label_ns + BDT_OFFSET_S * NS
    if system in ("GLO", "UTC"):
        return utc_to_gpst(label_ns)
    raise StarwiseError("unknown time system", found=system, wanted="GPS, GLO, GAL, QZS, BDT, IRN or UTC")


def to_datetime(t_ns: int) -> dt.datetime:
    """GPST as a naive datetime in GPST (microseconds, truncated): for printing."""
    return GPS_EPOCH + dt.timedelta(microseconds=int(t_ns) // 1000)


def iso(t_ns: int, decimals: int = 3) -> str:
    """GPST as text, ``2024-03-30T00:00:00.000`` (rounded to ``decimals``)."""
    step = 10 ** (9 - decimals)
    t_ns = (int(t_ns) + step // 2) // step * step
    seconds, frac = divmod(t_ns, NS)
    text = (GPS_EPOCH + dt.timedelta(seconds=seconds)).strftime("%Y-%m-%dT%H:%M:%S")
    return text if decimals == 0 else f"{text}.{frac // step:0{decimals}d}"


def labels(label_ns: IntArray, decimals: int, pattern: str = "{date}T{time}") -> list[str]:
    """Calendar labels of many instants, ``2024-03-30T12:00:00.000``; of UTC labels as of GPST.

    Parameters
    ----------
    label_ns : (n,) int64
        ns since 1980-01-06 00:00 of the scale that is written; cut, not rounded, to ``decimals``.
    decimals : int
        Of the second, 0 to 9.
    pattern : str
        ``{date}`` is yyyy-mm-dd, ``{time}`` is hh:mm:ss with decimals.
    """
    seconds = np.datetime_as_string(np.datetime64(GPS_EPOCH, "s") + (label_ns // NS).astype("timedelta64[s]"), unit="s")
    parts = ((label_ns % NS) // 10 ** (9 - decimals)).tolist() if decimals else []
    whole = [text.split("T") for text in seconds.tolist()]
    tails = [f".{part:0{decimals}d}" for part in parts] if decimals else [""] * len(whole)
    return [pattern.format(date=day, time=clock + tail) for (day, clock), tail in zip(whole, tails, strict=True)]


def decimals_of(t_ns: IntArray, least: int = 0) -> int:
    """Decimals of a second that instants need to be told apart from their neighbours: ``least``, 3, 6 or 9."""
    steps = [least, *(d for d in (3, 6) if d > least)]
    return next((d for d in steps if not (np.asarray(t_ns) % 10 ** (9 - d)).any()), 9)


def parse_time(text: str) -> int:
    """GPST, ns, of a time typed by a person: ISO in GPST, or ``week:tow``; with a trailing ``Z``, UTC.

    Raises
    ------
    StarwiseError
        The text is neither.
    """
    text = text.strip()
    try:
        if ":" in text and "-" not in text and "T" not in text and text.count(":") == 1:
            week, tow = text.split(":")
            if not 500 <= int(week) <= 9999 or not 0.0 <= float(tow) <= WEEK_S:
                raise ValueError  # 12:00 is a time of day without a day, not week 12
            return from_week_tow(int(week), float(tow))
        utc = text.endswith("Z")
        when = dt.datetime.fromisoformat(text.removesuffix("Z"))
        if when.tzinfo is not None:
            utc, when = True, when.astimezone(dt.UTC).replace(tzinfo=None)
    except (ValueError, OverflowError):
        raise StarwiseError(
            "not a time", found=text, wanted="2024-03-30T12:00:00 (GPST), ...Z (UTC) or week:tow"
        ) from None
    label = (when - GPS_EPOCH) // dt.timedelta(microseconds=1) * 1000
    return utc_to_gpst(label) if utc else label


def glonasst_of_day(t_ns: int) -> float:
    """Seconds into the GLONASS (Moscow) day of a GPST."""
    return ((gpst_to_utc(int(t_ns)) + GLONASST_UTC_S * NS) % (DAY_S * NS)) / NS


def session_numbers(t_ns: IntArray, length_s: float) -> IntArray:
    """Number of the session that each epoch belongs to, from 0: time since the first epoch over the length.

    A rest at the end that is shorter than half a session belongs to the last whole one.

    Parameters
    ----------
    t_ns : (n,) int64
        Epochs, increasing, ns.
    length_s : float
        Length of a session, s.

    Returns
    -------
    (n,) int64
    """
    if not len(t_ns):
        return np.zeros(0, dtype=np.int64)
    length = round(length_s * NS)
    since = np.asarray(t_ns) - t_ns[0]
    number = since // length
    last = int(number[-1])
    if last > 0 and 2 * (int(since[-1]) - last * length) < length:
        number = np.where(number == last, last - 1, number)
    return np.asarray(number, dtype=np.int64)


_UNIT_S: Final = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "": 1.0}


def parse_duration(text: str) -> float:
    """Seconds of a length of time written like ``2h``, ``90min``, ``7200s``, ``1d`` or ``7200``.

    Raises
    ------
    StarwiseError
        Not such a text, or not above 0.
    """
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*(s|min|h|d|)\s*", text)
    seconds = float(found[1]) * _UNIT_S[found[2]] if found else 0.0
    if not seconds > 0.0:
        raise StarwiseError("not a length of time", found=text, wanted="like 2h, 90min, 7200s")
    return seconds
