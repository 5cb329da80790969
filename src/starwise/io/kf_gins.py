"""Results of KF-GINS: navigation states and their standard deviations, two texts of numbers without names.

Columns as in its README, section 2.2: ``KF_GINS_Navresult.nav`` has week, seconds of week, latitude, longitude (deg),
ellipsoidal height (m), velocity north, east, down (m/s), roll, pitch, yaw (deg); ``KF_GINS_STD.txt`` has seconds of
week and 1 sigma of position and velocity (north, east, down), attitude (deg), gyroscope biases (deg/h), accelerometer
biases (mGal), scale factors (ppm). The program writes 0 for the week: it is not known, and `starwise.assess` takes that
of the truth. Positions are of the inertial unit, not of the antenna.
"""

import re
from io import StringIO
from pathlib import Path
from typing import Final

import numpy as np

from starwise.constants import NS, WEEK_S
from starwise.errors import StarwiseError
from starwise.frames import ecef_from_geodetic, rotations_ne_enu
from starwise.io.bare import bare_solution
from starwise.io.files import read_bytes
from starwise.types import F8, Solution

NAV_COLUMNS: Final = 11
STD_COLUMNS: Final = 22
NAV_NAME: Final = "KF_GINS_Navresult.nav"
STD_NAME: Final = "KF_GINS_STD.txt"
_MATCH_S: Final = 1e-4
"""Greatest difference of the time tags of a state and its sigmas."""


def columns_of(head: str) -> int:
    """Number of columns if every whole line of the text is that many numbers, else 0."""
    lines = [line for line in head.splitlines()[:20] if line.strip()]
    if len(lines) > 1 and not head.endswith(("\n", "\r")) and len(head.splitlines()) <= 20:
        lines = lines[:-1]
    counts = {len(line.split()) for line in lines}
    if len(counts) != 1:
        return 0
    try:
        for line in lines:
            [float(text) for text in line.split()]
    except ValueError:
        return 0
    return counts.pop()


def looks_like_nav(head: str) -> bool:
    """Whether a text without names has the columns of a navigation result: week, seconds, angles, ..."""
    if columns_of(head) != NAV_COLUMNS:
        return False
    row = [float(text) for text in head.split(maxsplit=NAV_COLUMNS)[:NAV_COLUMNS]]
    return row[0] == int(row[0]) and 0 <= row[0] < 10_000 and 0.0 <= row[1] <= WEEK_S and abs(row[2]) <= 90.0


def looks_like_std(head: str) -> bool:
    """Whether a text without names has the columns of the standard deviations."""
    if columns_of(head) != STD_COLUMNS:
        return False
    row = [float(text) for text in head.split(maxsplit=STD_COLUMNS)[:STD_COLUMNS]]
    return 0.0 <= row[0] <= WEEK_S and min(row[1:]) >= 0.0


def std_beside(nav: Path) -> Path | None:
    """Standard deviations beside a navigation result, by the program's names; None if there are none."""
    if not re.search("navresult", nav.name, re.IGNORECASE):
        return None
    path = nav.with_name(re.sub("navresult", "STD", nav.stem, flags=re.IGNORECASE) + ".txt")
    return path if path.is_file() else None


def nav_beside(std: Path) -> Path | None:
    """Navigation result beside its standard deviations, by the program's names; None if there is none."""
    found = re.fullmatch(r"(.*)std", std.stem, re.IGNORECASE)
    path = std.with_name(f"{found[1]}Navresult.nav") if found else std
    return path if found and path.is_file() else None


def read_kf_gins(nav: str | Path, std: str | Path | None = None, *, week: int | None = None) -> Solution:
    """Solution of a navigation result of KF-GINS, ECEF of the inertial unit, with attitude in ``extra``.

    Parameters
    ----------
    nav : path-like
        Navigation result (or a reference of the same columns).
    std : path-like, optional
        Standard deviations; default: those beside it, if it has the program's name. Without them covariances are NaN.
    week : int, optional
        GPS week, for files with 0 in its column. Without it times are seconds of the first GPS week.

    Raises
    ------
    StarwiseError
        Other columns, numbers that cannot be read, or standard deviations of other times.
    """
    nav = Path(nav)
    table = _table(nav, NAV_COLUMNS, "week, seconds, position, velocity, attitude")
    beside = std_beside(nav) if std is None else Path(std)
    weeks = table[:, 0]
    seconds_ns = np.round(table[:, 1] * NS)
    if not ((weeks >= 0) & (weeks < 10_000) & (weeks % 1 == 0) & (seconds_ns >= 0) & (seconds_ns <= WEEK_S * NS)).all():
        raise StarwiseError("week or seconds of week out of range", file=nav)
    if (np.abs(table[:, 2]) > 90.0).any() or (np.abs(table[:, 3]) > 360.0).any() or (np.abs(table[:, 4]) > 1e9).any():
        raise StarwiseError("latitude, longitude or height outside its range", file=nav, wanted="degrees, metres")
    given = week if week is not None and not weeks.any() else 0
    t_ns = (weeks.astype(np.int64) + given) * WEEK_S * NS + seconds_ns.astype(np.int64)
    if not weeks.any():  # one week after another without their numbers
        t_ns += np.concatenate([[0], np.cumsum(np.diff(t_ns) < -WEEK_S * NS // 2)]) * WEEK_S * NS
    llh = np.column_stack([np.radians(table[:, 2:4]), table[:, 4]])
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])[:, [1, 0, 2]]
    C[:, 2] *= -1.0  # ECEF to north, east, down
    turn = C.transpose(0, 2, 1)
    sigmas = None if beside is None else _sigmas(beside, table[:, 1])
    extra = {name: table[:, i].copy() for i, name in ((8, "roll_deg"), (9, "pitch_deg"), (10, "yaw_deg"))}
    if sigmas is not None:
        extra |= {f"sigma_{name}": sigmas[:, 6 + i].copy() for i, name in enumerate(tuple(extra))}
    return bare_solution(
        t_ns,
        ecef_from_geodetic(llh),
        {
            "file": str(nav),
            "format": "kf-gins",
            "height": "ellipsoidal",
            "covariance": "none" if beside is None else f"diagonal, of {beside.name}",
            "week": "not in the file" if not weeks.any() and week is None else "known",
            "point": "inertial unit",
        },
        cov_pos=None if sigmas is None else _turned(turn, sigmas[:, :3]),
        vel_e=(turn @ table[:, 5:8, None])[:, :, 0],
        cov_vel=None if sigmas is None else _turned(turn, sigmas[:, 3:6]),
        extra=extra,
    )


def _turned(turn: F8, sigma: F8) -> F8:
    """ECEF covariances (n, 3, 3) of standard deviations (n, 3) in the axes that ``turn`` leads from."""
    return np.asarray((turn * (sigma**2)[:, None, :]) @ turn.transpose(0, 2, 1))


def _sigmas(path: Path, seconds: F8) -> F8:
    """Standard deviations of position, velocity, attitude (n, 9) at the times of the states."""
    table = _table(path, STD_COLUMNS, "seconds, sigmas of position, velocity, attitude, sensors")
    if (table[:, 1:10] < 0.0).any():
        raise StarwiseError("a standard deviation is negative", file=path)
    if len(table) == len(seconds) and (np.abs(table[:, 0] - seconds) <= _MATCH_S).all():
        return table[:, 1:10]
    order = np.argsort(table[:, 0], kind="stable")
    times = table[order, 0]
    at = np.clip(np.searchsorted(times, seconds - _MATCH_S), 0, len(times) - 1)
    same = np.abs(times[at] - seconds) <= _MATCH_S
    if not same.any():
        raise StarwiseError(
            "standard deviations of other times than the states", file=path,
            found=f"{times[0]:.3f} to {times[-1]:.3f} s", wanted=f"{seconds.min():.3f} to {seconds.max():.3f} s",
        )  # fmt: skip
    out = table[order[at], 1:10]
    out[~same] = np.nan
    return out


def _table(path: Path, columns: int, what: str) -> F8:
    text = read_bytes(path).decode("latin-1")
    try:
        table = np.loadtxt(StringIO(text), ndmin=2)
    except (ValueError, UserWarning):
        table = np.empty((0, 0))
    if table.shape[1] == columns and len(table) and np.isfinite(table).all():
        return np.asarray(table, dtype=np.float64)
    for number, line in enumerate(text.splitlines(), 1):
        fields = line.split("#")[0].split()
        if fields and not _numbers(fields, columns):
            raise StarwiseError("not a row of KF-GINS", file=path, line=number, found=line.strip(),
                                wanted=f"{columns} numbers: {what}")  # fmt: skip
    raise StarwiseError("no rows", file=path, wanted=f"{columns} numbers a line: {what}")


def _numbers(fields: list[str], columns: int) -> bool:
    try:
        return len(fields) == columns and all(abs(float(text)) < np.inf for text in fields)
    except ValueError:
        return False
