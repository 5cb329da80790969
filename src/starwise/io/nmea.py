"""NMEA 0183 positions (GGA, with the date of RMC or ZDA) as a `Solution`."""

import re
from collections import Counter
from typing import Final

import numpy as np

from starwise.constants import DAY_S, EPOCH_COASTED, EPOCH_OK, NS
from starwise.errors import StarwiseError
from starwise.frames import ecef_from_geodetic
from starwise.gnsstime import from_calendar
from starwise.types import Solution

_ESTIMATED: Final = 6  # GGA fix quality: dead reckoning
_SENTENCE = re.compile(r"\$([A-Z]{2})([A-Z]{3}),([^*\r\n]*)(?:\*([0-9A-Fa-f]{2}))?\s*$")


def parse_nmea(text: str, name: str) -> Solution:
    """Solution of a text of NMEA sentences: GGA gives positions, RMC or ZDA the date.

    Height above the ellipsoid is the sum of the antenna's height above the geoid and the geoid separation of the same
    sentence. Time is UTC. GGA has no sigmas: covariances are NaN. Sentences with a wrong checksum, and those before
    the first date, are left out and counted in ``provenance["skipped"]``.

    Raises
    ------
    StarwiseError
        No sentence with a position and a date.
    """
    date: tuple[int, int, int] | None = None
    last_s = -1.0
    rows: list[tuple[int, float, float, float, int, int]] = []
    waiting: list[tuple[float, list[str]]] = []
    skipped = 0
    for line in text.splitlines():
        match = _SENTENCE.match(line.strip())
        if match is None or not _checksum_holds(line.strip(), match.group(4)):
            skipped += bool(line.strip())
            continue
        kind, fields = match.group(2), match.group(3).split(",")
        try:
            if kind == "RMC" and fields[1] == "A":
                date = (int(fields[8][4:6]), int(fields[8][2:4]), int(fields[8][0:2]))
                last_s = _second_of_day(fields[0])
            elif kind == "ZDA" and len(fields) >= 4 and fields[3]:
                date = (int(fields[3]), int(fields[2]), int(fields[1]))
                last_s = _second_of_day(fields[0])
            elif kind == "GGA" and fields[5] not in ("", "0"):
                waiting.append((_second_of_day(fields[0]), fields))
            if date is not None:
                rows += [_row(date, last_s, second, gga) for second, gga in waiting]
                waiting.clear()
        except (ValueError, IndexError, StarwiseError):
            waiting.clear()
            skipped += 1
    if not rows:
        raise StarwiseError("no NMEA position with a date", file=name, wanted="GGA with RMC or ZDA sentences")
    return _solution(rows, skipped + len(waiting), name)


def _checksum_holds(sentence: str, given: str | None) -> bool:
    if given is None:
        return True
    total = 0
    for ch in sentence[1 : sentence.index("*")]:
        total ^= ord(ch)
    return total == int(given, 16)


def _second_of_day(text: str) -> float:
    second = int(text[:2]) * 3600 + int(text[2:4]) * 60 + float(text[4:])
    if not 0.0 <= second <= DAY_S:
        raise ValueError("not a time of day")
    return second


def _row(
    date: tuple[int, int, int], date_s: float, second: float, gga: list[str]
) -> tuple[int, float, float, float, int, int]:
    """GPST ns, latitude, longitude (deg), ellipsoidal height (m), quality, satellites of a GGA sentence."""
    lat_deg = _angle(gga[1], gga[2] == "S", 2)
    lon_deg = _angle(gga[3], gga[4] == "W", 3)
    h = float(gga[8]) + (float(gga[10]) if gga[10] else 0.0)
    # The date belongs to the second of its own sentence; GGA may stand on the other side of midnight.
    days = round((date_s - second) / DAY_S)
    t_ns = from_calendar(*date, system="UTC") + days * DAY_S * NS + round(second * NS)
    if not (0 <= t_ns < 1 << 62 and abs(lat_deg) <= 90.0 and abs(lon_deg) <= 360.0 and abs(h) < 1e9):
        raise ValueError("out of range")
    return t_ns, lat_deg, lon_deg, h, int(gga[5]), min(int(gga[6] or 0), 9999)


def _angle(text: str, negative: bool, digits: int) -> float:
    value = int(text[:digits]) + float(text[digits:]) / 60.0
    return -value if negative else value


def _solution(rows: list[tuple[int, float, float, float, int, int]], skipped: int, name: str) -> Solution:
    rows.sort(key=lambda row: row[0])
    n = len(rows)
    llh = np.array([row[1:4] for row in rows])
    llh[:, :2] = np.radians(llh[:, :2])
    quality = np.array([row[4] for row in rows])
    nan, none = np.full((n, 3, 3), np.nan), np.full((n, 0), np.nan)
    return Solution(
        t_ns=np.array([row[0] for row in rows], dtype=np.int64),
        status=np.where(quality == _ESTIMATED, EPOCH_COASTED, EPOCH_OK).astype(np.uint8),
        pos_e=ecef_from_geodetic(llh),
        vel_e=np.full((n, 3), np.nan),
        cov_pos=nan,
        cov_vel=nan.copy(),
        clock_m=none,
        drift_mps=none,
        clock_sigma_m=none,
        clock_names=(),
        n_used=np.array([row[5] for row in rows], dtype=np.int32),
        dop=np.full((n, 4), np.nan),
        nis=np.full(n, np.nan),
        dof=np.zeros(n, dtype=np.int32),
        provenance={
            "file": name,
            "format": "nmea",
            "height": "ellipsoidal",
            "skipped": skipped,
            "quality": {str(q): count for q, count in sorted(Counter(quality.tolist()).items())},
        },
    )
