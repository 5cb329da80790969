"""NMEA 0183 positions (GGA, dates of RMC or ZDA, sigmas of GST) as a `Solution`."""

import datetime as dt
import re
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import DAY_S, EPOCH_COASTED, EPOCH_OK, NS
from starwise.errors import StarwiseError
from starwise.frames import ecef_from_geodetic, rotations_ne_enu
from starwise.gnsstime import GPS_EPOCH, utc_to_gpst
from starwise.io.bare import bare_solution
from starwise.types import Solution

F8 = NDArray[np.float64]

_ESTIMATED: Final = 6  # GGA fix quality: dead reckoning
_SENTENCE: Final = re.compile(
    # With a checksum it may stand anywhere, as in logs with binary messages; without one it ends its line.
    r"\$([A-Z]{2})(GGA|RMC|ZDA|GST),([^*$\r\n]*)(?:\*([0-9A-Fa-f]{2})|[ \t]*(?=[\r\n]|\Z))"
)
_ALIKE: Final = 0.3
"""Greatest relative difference between the variances of the ellipse and of latitude and longitude of one GST."""

_GEOID_SPREAD_M: Final = 1.0
"""Within this, the geoid is one height for a whole file."""
_NORTH_SOUTH: Final = {"N": 1.0, "S": -1.0}
_EAST_WEST: Final = {"E": 1.0, "W": -1.0}
_MANY: Final = 10
"""Wrong checksums from which on they are the writer's."""

Row = tuple[int, float, float, float, int, int]
"""GPST ns, latitude, longitude (deg), ellipsoidal height (m), quality, satellites."""


def looks_like_nmea(head: str) -> bool:
    """Whether the beginning of a file has a sentence that positions are read from."""
    return _SENTENCE.search(head) is not None


@dataclass
class _Log:
    """What has been read so far."""

    midnight_ns: int | None = None  # UTC label of the day of the last instant that is known
    second: float = 0.0  # its second of that day
    waiting: list[tuple[float, str, list[str]]] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    sigmas: dict[int, list[float]] = field(default_factory=dict)
    skipped: int = 0
    forgiven: tuple[str, ...] = ()
    geoid_m: list[float] = field(default_factory=list)


def parse_nmea(text: str, name: str) -> Solution:
    """Solution of a text with NMEA sentences of any talker: GGA gives positions, RMC or ZDA the date, GST the sigmas.

    Height above the ellipsoid is the sum of the antenna's height above the geoid and the geoid separation of the same
    sentence (``provenance["geoid_m"]``, if it is one for all). Without any separation heights stay above the geoid, and
    ``provenance["height"]`` is "geodetic"; if only some lack it, those are left out. Time is UTC. A position has the
    date of the sentence with its time of day, else the one that brings it nearest to the position before.

    Covariances are of the GST of the same time: 1-sigma errors of latitude, longitude and height; east and north are
    correlated as the error ellipse says, where ellipse and sigmas agree. Epochs without GST have NaN, and
    ``provenance["covariance"]`` says how many those are.

    Sentences with a wrong checksum, and those that cannot be read, are left out and counted in
    ``provenance["skipped"]``; where a program gets the checksums of one kind of sentence wrong throughout, they are
    taken and ``provenance["checksums"]`` says so. A sentence may stand after other things in its line (logs of Android,
    mixed binary logs).

    Raises
    ------
    StarwiseError
        No sentence with a position and a date.
    """
    log = _Log()
    sentences = [(match, _checksum_holds(match)) for match in _SENTENCE.finditer(text)]
    log.forgiven = _never_right(sentences)
    for match, right in sentences:
        if not right and match.group(2) not in log.forgiven:
            log.skipped += 1
            continue
        try:
            _take(log, match.group(2), match.group(3).split(","))
        except (ValueError, IndexError, OverflowError):
            log.skipped += 1
    _place(log)
    if not log.rows:
        raise StarwiseError("no NMEA position with a date", file=name, wanted="GGA with RMC or ZDA sentences")
    return _solution(log, name)


def _take(log: _Log, kind: str, fields: list[str]) -> None:
    if kind == "RMC":
        if fields[1] == "A":
            _dated(log, fields[8][4:6], fields[8][2:4], fields[8][0:2], _second_of_day(fields[0]))
    elif kind == "ZDA":
        if len(fields) >= 4 and fields[3]:
            _dated(log, fields[3], fields[2], fields[1], _second_of_day(fields[0]))
    elif kind == "GST" or fields[5] not in ("", "0"):
        second = _second_of_day(fields[0])
        if log.waiting and log.waiting[-1][0] != second:
            _place(log)
        log.waiting.append((second, kind, fields))


def _dated(log: _Log, year: str, month: str, day: str, second: float) -> None:
    """A sentence with a date: what waits is of the same instant, or else of the time before."""
    number = int(year)
    number += (1900 if number >= 80 else 2000) if number < 100 else 0
    midnight_ns = (dt.date(number, int(month), int(day)) - GPS_EPOCH.date()).days * DAY_S * NS
    if not 0 <= midnight_ns < 1 << 62:
        raise ValueError("out of range")
    if log.waiting and log.waiting[-1][0] != second:
        _place(log)
    log.midnight_ns, log.second = midnight_ns, second
    _place(log)
    log.midnight_ns, log.second = midnight_ns, second


def _place(log: _Log) -> None:
    """Give the sentences that wait the day that brings them nearest to the last instant, if there is one."""
    if log.midnight_ns is None:
        return
    for second, kind, fields in reversed(log.waiting):  # several instants: those before the first date
        midnight_ns = log.midnight_ns + round((log.second - second) / DAY_S) * DAY_S * NS
        t_ns = utc_to_gpst(midnight_ns) + round(second * NS)
        try:
            if t_ns < 0:
                raise ValueError("out of range")
            if kind == "GST":
                log.sigmas[t_ns] = _gst(fields)
            else:
                log.rows.append(_row(t_ns, fields))
                log.geoid_m.append(float(fields[10].strip() or "nan"))
        except (ValueError, IndexError, KeyError):
            log.skipped += 1
            continue
        log.midnight_ns, log.second = midnight_ns, second
    log.waiting.clear()


def _geoid(separations: list[float]) -> dict[str, float]:
    """Height of the geoid, if the sentences agree on one; 0 is what many write where it is not known."""
    known = np.array([height for height in separations if height == height])  # without the blank ones
    return (
        {"geoid_m": float(np.median(known))} if len(known) and known.all() and np.ptp(known) < _GEOID_SPREAD_M else {}
    )


def _never_right(sentences: list[tuple[re.Match[str], bool]]) -> tuple[str, ...]:
    """Kinds of sentences of which there are many and not one has the right checksum: the fault of their writer."""
    counts = Counter(match.group(2) for match, _ in sentences)
    right = {match.group(2) for match, holds in sentences if holds}
    return tuple(sorted(kind for kind, count in counts.items() if kind not in right and count >= _MANY))


def _checksum_holds(match: re.Match[str]) -> bool:
    if match.group(4) is None:
        return True
    total = 0
    for byte in match.group(0)[1:-3].encode("latin-1", "replace"):
        total ^= byte
    return total == int(match.group(4), 16)


def _second_of_day(text: str) -> float:
    hour, minute, second = int(text[:2]), int(text[2:4]), float(text[4:])
    if not (0 <= hour <= 24 and 0 <= minute < 60 and 0.0 <= second < 61.0 and hour * 3600 + minute * 60 <= DAY_S):
        raise ValueError("not a time of day")
    return hour * 3600 + minute * 60 + second


def _row(t_ns: int, gga: list[str]) -> Row:
    lat_deg = _angle(gga[1], _NORTH_SOUTH[gga[2]], 2)
    lon_deg = _angle(gga[3], _EAST_WEST[gga[4]], 3)
    h = float(gga[8]) + float(gga[10].strip() or 0.0)
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 360.0 and abs(h) < 1e9):
        raise ValueError("out of range")
    return t_ns, lat_deg, lon_deg, h, int(gga[5]), min(int(gga[6] or 0), 9999)


def _angle(text: str, sign: float, digits: int) -> float:
    minutes = float(text[digits:])
    if not (text[:digits].isdigit() and 0.0 <= minutes < 60.0):
        raise ValueError("not degrees and minutes")
    return sign * (int(text[:digits]) + minutes / 60.0)


def _positive(text: str) -> float:
    """A sigma; blank, zero and less are what receivers write for none."""
    value = float(text) if text.strip() else 0.0
    return value if 0.0 < value < 1e9 else float("nan")


def _gst(fields: list[str]) -> list[float]:
    """Semi-axes, bearing (deg, any), sigmas of latitude, longitude, height; NaN where there is none."""
    bearing = float(fields[4]) if len(fields) > 4 and fields[4].strip() else float("nan")
    values = [_positive(text) for text in fields[2:8]]
    values[2:3] = [bearing if abs(bearing) <= 360.0 else float("nan")] * len(values[2:3])
    return values


def _covariances(rows: list[Row], sigmas: dict[int, list[float]], llh: F8) -> F8:
    """ECEF covariances (n, 3, 3), NaN without GST."""
    table = np.full((len(rows), 6), np.nan)
    for i, row in enumerate(rows):
        given = sigmas.get(row[0])
        if given is not None:
            table[i, : len(given)] = given
    major2, minor2, bearing = table[:, 0] ** 2, table[:, 1] ** 2, np.radians(table[:, 2])
    s, c = np.sin(bearing), np.cos(bearing)
    ellipse = np.stack([major2 * s * s + minor2 * c * c, major2 * c * c + minor2 * s * s], axis=1)  # east, north
    claimed = table[:, [4, 3]] ** 2
    horizontal = np.where(np.isnan(claimed), ellipse, claimed)
    # Some receivers fill the ellipse and the sigmas from different sources; then nothing is known of a correlation.
    agree = (np.abs(ellipse - horizontal) <= _ALIKE * horizontal).all(axis=1)
    cov = np.zeros((len(rows), 3, 3))
    cov[:, 0, 0], cov[:, 1, 1], cov[:, 2, 2] = horizontal[:, 0], horizontal[:, 1], table[:, 5] ** 2
    bound = 0.99 * np.sqrt(horizontal[:, 0] * horizontal[:, 1])
    cov[:, 0, 1] = cov[:, 1, 0] = np.where(agree, np.clip((major2 - minor2) * s * c, -bound, bound), 0.0)
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])
    rotated = C.transpose(0, 2, 1) @ cov @ C
    rotated[np.isnan(cov).any(axis=(1, 2))] = np.nan
    return np.asarray(rotated)


def _solution(log: _Log, name: str) -> Solution:
    blank = np.isnan(log.geoid_m)
    above_geoid = bool(blank.all())
    if not above_geoid:  # heights of two kinds cannot stand in one solution
        log.skipped += int(blank.sum())
        log.rows = [row for row, left_out in zip(log.rows, blank.tolist(), strict=True) if not left_out]
    rows = sorted(log.rows, key=lambda row: row[0])
    llh = np.array([row[1:4] for row in rows])
    llh[:, :2] = np.radians(llh[:, :2])
    quality = np.array([row[4] for row in rows])
    cov_pos = _covariances(rows, log.sigmas, llh)
    without = int(np.isnan(cov_pos[:, 0, 0]).sum())
    return bare_solution(
        np.array([row[0] for row in rows], dtype=np.int64),
        ecef_from_geodetic(llh),
        {
            "file": name,
            "format": "nmea",
            "height": "geodetic" if above_geoid else "ellipsoidal",
            "covariance": "no GST: none" if without == len(rows) else f"GST; {without} epochs without",
            **_geoid(log.geoid_m),
            "skipped": log.skipped,
            "checksums": f"wrong in all {', '.join(log.forgiven)}" if log.forgiven else "right",
            "quality": {str(q): count for q, count in sorted(Counter(quality.tolist()).items())},
        },
        cov_pos=cov_pos,
        status=np.where(quality == _ESTIMATED, EPOCH_COASTED, EPOCH_OK),
        n_used=[row[5] for row in rows],
    )
