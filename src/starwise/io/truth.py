"""Reference positions: typed coordinates, tables of text, and any solution that `read_solution` reads."""

import csv
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.frames import ecef_from_geodetic
from starwise.gnsstime import from_week_tow, parse_time, utc_to_gpst
from starwise.io.foreign import kind_of
from starwise.io.results import read_solution
from starwise.types import Truth

# Columns by their names without case and punctuation.
_LAT: Final = ("lat", "latdeg", "latitude", "latitudedeg", "latitudedegrees", "latdegrees")
_LON: Final = ("lon", "lng", "londeg", "lngdeg", "longitude", "longitudedeg", "longitudedegrees", "londegrees")
_HEIGHT: Final = (
    "h", "hm", "height", "heightm", "hgt", "alt", "altm", "altitude", "altitudem", "altitudemeters",
    "ellipsoidalheight", "ellipsoidalheightm", "heightabovewgs84ellipsoidm",
)  # fmt: skip
_XYZ: Final = tuple((a, f"{a}m", f"{a}ecef", f"{a}ecefm", f"ecef{a}", f"ecef{a}m") for a in "xyz")
_WEEK: Final = ("week", "gpsweek", "wn")
_TOW: Final = ("tow", "tows", "sow", "gpstow", "gpstows", "gpsseconds", "seconds", "gpssecs")
_UNIX_EPOCH_NS: Final = -315_964_800 * NS

_TIMES: Final[dict[str, Callable[[str], int]]] = {
    "tgpstns": int,
    "gpst": parse_time,
    "millissincegpsepoch": lambda text: round(float(text)) * 1_000_000,
    "unixtimemillis": lambda text: utc_to_gpst(_UNIX_EPOCH_NS + round(float(text)) * 1_000_000),
    "utc": lambda text: parse_time(text.removesuffix("Z") + "Z"),
}


def read_truth(where: str) -> Truth:
    """Truth typed as ``X,Y,Z`` (ECEF m) or ``lat,lon,h`` (deg, deg, m), or read from a file.

    Files: comma-separated tables with named columns (time as week and tow, ``t_gpst_ns``, ``gpst``, ``utc``,
    ``millisSinceGpsEpoch`` or ``UnixTimeMillis``; position as lat, lon, height or x, y, z), tables without names of
    ``week, tow, lat, lon, height``, position files of RTKLIB, and results of this program.

    Raises
    ------
    StarwiseError
        Neither three numbers nor such a file.
    """
    path = Path(where)
    typed = [part for part in re.split(r"[,\s]+", where.strip()) if part]
    if len(typed) == 3 and not path.exists():
        try:
            return _point([float(part) for part in typed], where)
        except ValueError:
            pass
    if not path.exists():
        raise StarwiseError(
            "no such truth", found=where, wanted="X,Y,Z in metres, lat,lon,h in degrees and metres, or a file"
        )
    if path.is_file() and path.suffix.lower() in (".csv", ".txt") and kind_of(path) == "pos":
        return _read_table(path)
    if path.is_file() and path.suffix.lower() == ".parquet":
        simulated = _simulated_truth(path)
        if simulated is not None:
            return simulated
    solution = read_solution(path, ledger=False)
    if solution.provenance.get("height") == "geodetic":
        raise StarwiseError("heights of the truth are above the geoid", file=path, wanted="ellipsoidal heights")
    keep = solution.has_position
    if not keep.any():
        raise StarwiseError("no position in the truth", file=path)
    return Truth(solution.pos_e[keep], solution.t_ns[keep], str(path), solution.vel_e[keep])


def _simulated_truth(path: Path) -> Truth | None:
    """Truth of a simulation; None if the table is another one (a solution has a status)."""
    import polars as pl

    position = ["pos_x_m", "pos_y_m", "pos_z_m"]
    try:
        columns = pl.read_parquet_schema(path)
        if "status" in columns or not {"t_gpst_ns", *position} <= set(columns):
            return None
        table = pl.read_parquet(path, columns=["t_gpst_ns", *position])
    except (OSError, pl.exceptions.PolarsError) as error:
        raise StarwiseError(f"not a table ({error})", file=path) from None
    return Truth(table.select(position).to_numpy(), table["t_gpst_ns"].to_numpy(), str(path))


def _point(values: Sequence[float], where: str) -> Truth:
    if not np.isfinite(values).all():
        raise StarwiseError("truth is not finite", found=where)
    if np.linalg.norm(values) > 1e6 or not any(values):
        if not 6.2e6 < np.linalg.norm(values) < 5e7:
            raise StarwiseError("truth is not a place on or above the Earth", found=where, wanted="ECEF metres")
        return Truth(np.array(values), source=where)
    lat, lon, h = values
    if abs(lat) > 90.0 or abs(lon) > 360.0:
        raise StarwiseError(
            "truth is neither on the Earth nor an angle", found=where, wanted="X,Y,Z in metres or lat,lon,h"
        )
    return Truth(ecef_from_geodetic([np.radians(lat), np.radians(lon), h]), source=where)


def _read_table(path: Path) -> Truth:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise StarwiseError(f"cannot be read ({error})", file=path) from None
    try:
        rows = [(n, row) for n, row in enumerate(csv.reader(text.splitlines()), 1) if any(c.strip() for c in row)]
    except csv.Error as error:
        raise StarwiseError(f"not a table ({error})", file=path) from None
    if not rows:
        raise StarwiseError("the table is empty", file=path)
    names = [re.sub(r"[^a-z0-9]", "", cell.lower()) for cell in rows[0][1]]
    if not re.search("[a-df-z]", "".join(names)):  # numbers only: e may be an exponent
        if len(names) < 5:
            raise StarwiseError(
                "too few columns", file=path, line=rows[0][0], wanted="week, tow, lat, lon, height or names"
            )
        names = ["week", "tow", "lat", "lon", "h", *[f"#{i}" for i in range(5, len(names))]]
    else:
        rows = rows[1:]
    time_of = _time_reader(names, path)
    position_of = _position_reader(names, path)
    t_ns, pos = [], []
    for number, row in rows:
        try:
            pos.append(position_of(row))
            t_ns.append(_instant(time_of(row)))
        except (ValueError, IndexError, OverflowError, StarwiseError):
            raise StarwiseError("row not readable", file=path, line=number, found=",".join(row)) from None
    if not t_ns:
        raise StarwiseError("the table has no rows", file=path)
    times, first = np.unique(np.array(t_ns, dtype=np.int64), return_index=True)
    table = np.array(pos)[first]
    table[~(np.abs(table) < 1e9)] = np.nan
    finite = np.isfinite(table).all(axis=1)
    times, table = times[finite], table[finite]
    if _column(names, _LAT) is not None:
        if (np.abs(table[:, 0]) > 90.0).any() or (np.abs(table[:, 1]) > 360.0).any():
            raise StarwiseError("latitude or longitude outside its range", file=path, wanted="degrees")
        table = ecef_from_geodetic(np.column_stack([np.radians(table[:, :2]), table[:, 2]]))
    if not len(times):
        raise StarwiseError("no row has a position", file=path)
    return Truth(table, times, str(path))


def _instant(t_ns: int) -> int:
    if not 0 <= t_ns < 1 << 62:
        raise ValueError
    return t_ns


def _column(names: Sequence[str], wanted: Sequence[str]) -> int | None:
    return next((names.index(name) for name in wanted if name in names), None)


def _time_reader(names: Sequence[str], path: Path) -> Callable[[Sequence[str]], int]:
    week, tow = _column(names, _WEEK), _column(names, _TOW)
    if week is not None and tow is not None:
        return lambda row: from_week_tow(int(float(row[week])), float(row[tow]))
    for name, read in _TIMES.items():
        at = _column(names, (name,))
        if at is not None:
            return lambda row: read(row[at])
    raise StarwiseError(
        "no column of time", file=path, line=1, wanted="week and tow, t_gpst_ns, gpst, utc or UnixTimeMillis"
    )


def _position_reader(names: Sequence[str], path: Path) -> Callable[[Sequence[str]], list[float]]:
    for group in ((_LAT, _LON, _HEIGHT), _XYZ):
        at = [_column(names, wanted) for wanted in group]
        if all(i is not None for i in at):
            columns = [i for i in at if i is not None]
            return lambda row: [float(row[i]) if row[i].strip() else float("nan") for i in columns]
    raise StarwiseError("no columns of position", file=path, line=1, wanted="lat, lon, height or x, y, z")
