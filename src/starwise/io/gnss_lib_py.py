"""Tables of gnss_lib_py: state estimates as a `Solution`, residuals as a table.

Names as that library writes them (its standard nomenclature, and ``solve_wls``, ``solve_gnss_ekf``, ``solve_residuals``
of version 1): ``gps_millis`` is GPST in milliseconds since 1980-01-06; ``x_rx<source>_m`` and so on are ECEF, with an
estimator like ``_wls`` or ``_ekf`` in the middle or nothing (then it is the reference of the data set, often);
``lat_rx..._deg``, ``lon_rx..._deg``, ``alt_rx..._m`` are WGS 84, the height ellipsoidal. It writes no covariances.
"""

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from starwise.constants import SYSTEMS
from starwise.errors import StarwiseError
from starwise.frames import ecef_from_geodetic
from starwise.io.bare import bare_solution
from starwise.io.files import read_bytes
from starwise.io.residuals import Residuals
from starwise.signals import sv_id
from starwise.types import F8, I8, Solution

if TYPE_CHECKING:
    import polars as pl

_LETTERS: Final = {
    "gps": "G", "glonass": "R", "galileo": "E", "beidou": "C", "qzss": "J", "irnss": "I", "sbas": "S",
}  # fmt: skip
_MILLI_NS: Final = 1_000_000


def looks_like_state(head: str) -> bool:
    """Whether a table's first line has the columns of a state estimate."""
    names = _names(head)
    return "gps_millis" in names and bool(_estimators(names)) and "residuals_m" not in names


def looks_like_residuals(head: str) -> bool:
    """Whether a table's first line has the columns of residuals."""
    names = _names(head)
    return {"gps_millis", "residuals_m"} <= set(names)


def _names(head: str) -> list[str]:
    first = head.lstrip("\ufeff").split("\n", 1)[0]
    return [name.strip().strip('"') for name in first.split(",")]


def _estimators(names: list[str]) -> list[str]:
    """Middle parts of the names of the positions there are, ``_wls``, ``_ekf`` ...; those of an estimator first."""
    found = [match[1] for name in names if (match := re.fullmatch(r"x_rx(\w*)_m", name))]
    found += [match[1] for name in names if (match := re.fullmatch(r"lat_rx(\w*)_deg", name))]
    kept = [
        middle
        for middle in dict.fromkeys(found)
        if {f"{a}_rx{middle}_m" for a in "xyz"} <= set(names)
        or {f"lat_rx{middle}_deg", f"lon_rx{middle}_deg", f"alt_rx{middle}_m"} <= set(names)
    ]
    return sorted(kept, key=lambda middle: (middle in ("", "_gt"), kept.index(middle)))


def read_gnss_lib_py(path: str | Path) -> Solution:
    """Solution of a state estimate of gnss_lib_py, ECEF, GPST; without covariances, which it does not write.

    Of several estimates in one table the first is taken (an estimator before a reference); ``provenance`` names it and
    the others.

    Raises
    ------
    StarwiseError
        Columns missing, or a row that cannot be read.
    """
    table = _table(path)
    middles = _estimators(table.columns)
    if not middles or "gps_millis" not in table.columns:
        raise StarwiseError("no state estimate", file=path, line=1, wanted="gps_millis and x_rx..._m, y_rx..., z_rx...")
    middle = middles[0]
    t_ns = _times(table, path)
    if {f"{a}_rx{middle}_m" for a in "xyz"} <= set(table.columns):
        pos_e = np.column_stack([_column(table, f"{a}_rx{middle}_m", path) for a in "xyz"])
    else:
        llh = np.column_stack([_column(table, f"{a}_rx{middle}_{u}", path) for a, u in
                               (("lat", "deg"), ("lon", "deg"), ("alt", "m"))])  # fmt: skip
        llh[(np.abs(llh[:, 0]) > 90.0) | (np.abs(llh[:, 1]) > 360.0)] = np.nan
        pos_e = ecef_from_geodetic(np.column_stack([np.radians(llh[:, :2]), llh[:, 2]]))
    size = np.linalg.norm(pos_e, axis=1)
    pos_e[~((size > 1e6) & (size < 1e9))] = np.nan
    velocity = [f"v{a}_rx{middle}_mps" for a in "xyz"]
    vel_e = None
    if set(velocity) <= set(table.columns):
        vel_e = np.column_stack([_column(table, name, path) for name in velocity])
    # A table of measurements repeats the state on every row of an epoch.
    times, first = np.unique(t_ns, return_index=True)
    return bare_solution(
        times,
        pos_e[first],
        {
            "file": str(path),
            "format": "gnss_lib_py",
            "height": "ellipsoidal",
            "covariance": "none in such files",
            "estimate": middle.lstrip("_") or "rx",
            "other_estimates": [other.lstrip("_") or "rx" for other in middles[1:]],
        },
        vel_e=None if vel_e is None else vel_e[first],
    )


def read_gnss_lib_py_residuals(path: str | Path) -> Residuals:
    """Residuals of a table of gnss_lib_py with ``residuals_m``, ``gnss_id``, ``sv_id`` and perhaps ``signal_type``.

    Raises
    ------
    StarwiseError
        Columns missing, or a row that cannot be read.
    """
    table = _table(path)
    missing = [name for name in ("gps_millis", "residuals_m", "gnss_id", "sv_id") if name not in table.columns]
    if missing:
        raise StarwiseError("columns missing", file=path, line=1, found="no " + ", ".join(missing))
    t_ns, sv = _times(table, path), _satellites(table, path)
    signals = table["signal_type"].to_list() if "signal_type" in table.columns else ["1"] * table.height
    named = ["?" if str(name).lower() in ("", "none", "nan") else str(name) for name in signals]
    channels = tuple(sorted(set(named)))
    channel = np.array([channels.index(name) for name in named], dtype=np.int16)
    code = _column(table, "residuals_m", path)
    code[~(np.abs(code) < 1e12)] = np.nan
    order = np.lexsort((channel, sv, t_ns))
    optional = {
        name: _column(table, name, path) if name in table.columns else np.full(table.height, np.nan)
        for name in ("az_sv_deg", "el_sv_deg", "cn0_dbhz", "raw_pr_sigma_m")
    }
    sigma = np.where(optional["raw_pr_sigma_m"] > 0.0, optional["raw_pr_sigma_m"], np.nan)
    notes = ["residuals are those after the fit; gnss_lib_py weights all rows alike unless told otherwise"]
    return Residuals(
        t_ns=t_ns[order],
        sv=sv[order],
        channel=channel[order],
        channels=channels,
        azimuth_rad=np.radians(optional["az_sv_deg"])[order],
        elevation_rad=np.radians(optional["el_sv_deg"])[order],
        code_m=code[order],
        phase_m=np.full(table.height, np.nan),
        cn0_dbhz=optional["cn0_dbhz"][order],
        valid=np.isfinite(code)[order],
        source=str(path),
        format="gnss_lib_py",
        notes=tuple(notes),
        sigma_m=sigma[order] if np.isfinite(sigma).any() else None,
    )


def _table(path: str | Path) -> "pl.DataFrame":
    import polars as pl

    try:
        table = pl.read_csv(io.BytesIO(read_bytes(path)), infer_schema=False, encoding="utf8-lossy")
    except pl.exceptions.PolarsError as error:
        raise StarwiseError(f"not a table ({str(error).splitlines()[0]})", file=path) from None
    table = table.rename({name: name.strip().strip("\ufeff") for name in table.columns})
    if not table.height:
        raise StarwiseError("the table has no rows", file=path)
    return table


def _column(table: "pl.DataFrame", name: str, path: str | Path) -> F8:
    """Numbers of a column; NaN where it is blank."""
    import polars as pl

    texts = table[name].str.strip_chars()
    blank = texts.is_null() | texts.str.to_lowercase().is_in(["", "nan", "none", "null"])
    numbers = texts.cast(pl.Float64, strict=False)
    bad = (~blank & numbers.is_null()).arg_true()
    if len(bad):
        raise StarwiseError(f"not a number in {name}", file=path, line=int(bad[0]) + 2, found=str(texts[int(bad[0])]))
    return np.array(numbers.fill_null(float("nan")).to_numpy(), dtype=np.float64)


def _times(table: "pl.DataFrame", path: str | Path) -> I8:
    millis = _column(table, "gps_millis", path)
    bad = np.flatnonzero(~((millis >= 0.0) & (millis < 4e12)))
    if len(bad):
        raise StarwiseError("not a time in gps_millis", file=path, line=int(bad[0]) + 2, found=f"{millis[bad[0]]}")
    whole = np.floor(millis)
    return np.asarray(whole.astype(np.int64) * _MILLI_NS + np.round((millis - whole) * _MILLI_NS).astype(np.int64))


def _satellites(table: "pl.DataFrame", path: str | Path) -> "np.ndarray[tuple[int], np.dtype[np.int16]]":
    numbers = _column(table, "sv_id", path)
    known: dict[tuple[str, float], int] = {}
    out = np.empty(table.height, dtype=np.int16)
    for i, (system, number) in enumerate(zip(table["gnss_id"].to_list(), numbers.tolist(), strict=True)):
        key = (str(system).strip().lower(), number)
        if key not in known:
            letter = _LETTERS.get(key[0], "")
            try:
                if not letter or number != int(number):
                    raise ValueError
                known[key] = sv_id(f"{letter}{_number(letter, int(number)):02d}")
            except (ValueError, OverflowError, StarwiseError):
                raise StarwiseError(
                    "not a satellite", file=path, line=i + 2, found=f"{system} {number:g}",
                    wanted=f"gnss_id of {', '.join(_LETTERS)}, and a number",
                ) from None  # fmt: skip
        out[i] = known[key]
    return out


def _number(letter: str, number: int) -> int:
    """Number as in RINEX of a PRN: QZSS 193 is J01, SBAS 120 is S20."""
    if letter == "J" and number >= 193:
        return number - 192
    return number - 100 if letter == "S" and number >= 120 else number


assert set(_LETTERS.values()) == set(SYSTEMS)
