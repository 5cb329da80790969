"""RTKLIB solution status files (``.stat``): positions as a `Solution`, residuals of every satellite as a table.

Written by RTKLIB's programs with ``out-outstat = residual`` (or ``state``, without residuals); the records are
described at ``rtkopenstat`` in RTKLIB 2.4.3's rtkpos.c. Three things there are easily misread:

* with single-point positions (quality 5, 3) the flag ``vsat`` is always 0: every line of frequency 1 was used;
* the last three numbers of ``$POS`` are the fixed position in relative modes and standard deviations in PPP;
* residuals are those after the fit, with relative positioning double differences. Their variances are not written.
"""

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import EPOCH_COASTED, EPOCH_OK, NS, WEEK_S
from starwise.errors import StarwiseError
from starwise.frames import geodetic_from_ecef, rotations_ne_enu
from starwise.io.bare import bare_solution
from starwise.io.files import read_bytes
from starwise.io.residuals import Residuals
from starwise.signals import sv_id
from starwise.types import F8, I8, Solution

RECORDS: Final = ("$POS", "$VELACC", "$CLK", "$ION", "$TROP", "$TRPG", "$HWBIAS", "$AMB", "$SAT")
"""Kinds of records that RTKLIB writes."""
_SINGLE: Final = ("3", "5")
"""Qualities of single-point positions: SBAS, single."""
_DGPS: Final = "4"
_FIXED: Final = 1
_PPP: Final = 6
_DEAD: Final = 7
_POS_FIELDS: Final = 10
_SAT_FIELDS: Final = 17
_FAR: Final = 1e5  # m: a position, no standard deviation


@dataclass
class _Read:
    """Lines of a file by kind, with their numbers."""

    pos: list[tuple[int, list[str]]] = field(default_factory=list)
    vel: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    sat: list[str] = field(default_factory=list)
    sat_lines: list[int] = field(default_factory=list)
    cut: bool = False


def looks_like_stat(head: str) -> bool:
    """Whether a file begins with a record of a solution status file."""
    return head.lstrip("\ufeff \r\n").split(",", 1)[0] in RECORDS


def has_residuals(path: str | Path) -> bool:
    """Whether a solution status file has ``$SAT`` records."""
    return b"$SAT," in read_bytes(path)


def read_stat(path: str | Path) -> Solution:
    """Solution of the ``$POS`` records of a solution status file, ECEF, GPST.

    Velocities are those of ``$VELACC``. Covariances are known of PPP only (diagonal, ECEF); else NaN. ``provenance``
    has the count of each quality.

    Raises
    ------
    StarwiseError
        Not such a file, or a record that cannot be read.
    """
    name = str(path)
    lines = _lines(read_bytes(path).decode("latin-1"), name)
    n = len(lines.pos)
    if not n:
        raise StarwiseError("no $POS record", file=path, wanted="RTKLIB's out-outstat = state or residual")
    t_ns, table, quality = np.empty(n, np.int64), np.full((n, 6), np.nan), np.empty(n, np.int64)
    vel_n = np.full((n, 3), np.nan)
    for i, (number, fields) in enumerate(lines.pos):
        try:
            t_ns[i], quality[i] = _time(fields), int(fields[3])
            table[i] = [float(text) for text in fields[4:10]]
            moving = lines.vel.get((fields[1], fields[2]))
            if moving is not None:
                vel_n[i] = [float(text) for text in moving[4:7]]
        except (ValueError, OverflowError):
            raise StarwiseError("not a $POS record", file=name, line=number, found=",".join(fields)) from None
    pos_e, cov_pos = _positions(table, quality)
    finite = np.asarray(np.isfinite(pos_e).all(axis=1))
    llh = geodetic_from_ecef(np.where(finite[:, None], pos_e, 0.0))
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])
    absent = np.asarray(np.all(vel_n == 0.0, axis=1) | ~np.all(np.abs(vel_n) < 1e6, axis=1))
    vel_n = np.where(absent[:, None], np.nan, vel_n)  # zeros: no Doppler
    counts = dict(zip(*(part.tolist() for part in np.unique(quality, return_counts=True)), strict=True))
    covariance = "PPP: diagonal" if np.isfinite(cov_pos).any() else "none in such files"
    return bare_solution(
        t_ns,
        pos_e,
        {
            "file": name,
            "format": "rtklib stat",
            "height": "ellipsoidal",
            "covariance": covariance,
            "quality": {str(q): count for q, count in counts.items()},
        },
        cov_pos=cov_pos,
        vel_e=(C.transpose(0, 2, 1) @ vel_n[:, :, None])[:, :, 0],
        status=np.where(quality == _DEAD, EPOCH_COASTED, EPOCH_OK),
    )


def read_stat_residuals(path: str | Path) -> Residuals:
    """Residuals of the ``$SAT`` records of a solution status file.

    Raises
    ------
    StarwiseError
        Not such a file, no residuals in it, or a record that cannot be read.
    """
    name = str(path)
    lines = _lines(read_bytes(path).decode("latin-1"), name)
    if not lines.sat:
        raise StarwiseError("no residuals ($SAT records)", file=path, wanted="RTKLIB's out-outstat = residual")
    quality = {(fields[1], fields[2]): fields[3] for _, fields in lines.pos}
    texts, numbers = _columns(lines, name)
    t_ns = np.round(numbers["week"] * WEEK_S).astype(np.int64) * NS + np.round(numbers["tow"] * NS).astype(np.int64)
    sv = _satellites(texts["sv"], lines, name)
    said = [quality.get(instant, "") for instant in zip(texts["week"], texts["tow"], strict=True)]
    single, code_only = np.isin(said, _SINGLE), np.isin(said, (*_SINGLE, _DGPS))
    frequency = numbers["frq"].astype(np.int64)
    known = np.abs(numbers["resp"]) < 1e9
    valid = known & np.where(single, frequency == 1, numbers["vsat"] != 0.0)
    relative = bool({"1", "2", _DGPS} & set(quality.values())) and str(_PPP) not in quality.values()
    # differences of the reference satellite against itself
    valid &= ~(relative & (numbers["resp"] == 0.0))
    code = np.where(known & (valid | (not relative)), numbers["resp"], np.nan)
    phase = np.where(code_only | (relative & ~valid) | ~(np.abs(numbers["resc"]) < 1e9), np.nan, numbers["resc"])
    notes = ["residuals are those after the fit; RTKLIB writes no variances for them"]
    if relative:
        notes.append("residuals of relative positioning are double differences against a satellite that is not named")
    if lines.cut:
        notes.append("the last line is cut and was left out")
    order = np.lexsort((frequency, sv, t_ns))
    return Residuals(
        t_ns=t_ns[order],
        sv=sv[order],
        channel=(frequency - 1).astype(np.int16)[order],
        channels=tuple(f"L{i}" if i < 3 else "L5" if i == 3 else f"f{i}" for i in range(1, int(frequency.max()) + 1)),
        azimuth_rad=np.radians(numbers["az"])[order],
        elevation_rad=np.radians(numbers["el"])[order],
        code_m=code[order],
        phase_m=phase[order],
        cn0_dbhz=np.where(numbers["snr"] > 0.0, numbers["snr"], np.nan)[order],
        valid=valid[order],
        source=name,
        format="rtklib stat",
        notes=tuple(notes),
    )


_SAT_COLUMNS: Final = ("kind", "week", "tow", "sv", "frq", "az", "el", "resp", "resc", "vsat", "snr")


def _columns(lines: _Read, name: str) -> tuple[dict[str, list[str]], dict[str, F8]]:
    import polars as pl

    try:
        table = pl.read_csv(
            io.BytesIO("\n".join(lines.sat).encode("utf-8")),
            has_header=False,
            infer_schema=False,
            quote_char=None,
            truncate_ragged_lines=True,
            columns=list(range(len(_SAT_COLUMNS))),
        )
    except pl.exceptions.PolarsError as error:
        raise StarwiseError(f"$SAT records not readable ({str(error).splitlines()[0]})", file=name) from None
    table.columns = list(_SAT_COLUMNS)
    numbers = table.select(pl.col([c for c in _SAT_COLUMNS if c not in ("kind", "sv")]).cast(pl.Float64, strict=False))
    frame = numbers.fill_null(float("nan"))
    whole = (
        pl.col("week").is_between(0, 9999)
        & pl.col("tow").is_between(0.0, WEEK_S)
        & pl.col("frq").is_between(1, 99)
        & pl.col("az").is_finite()
        & pl.col("el").is_between(-90.0, 90.0)
        & pl.col("vsat").is_finite()
    )
    bad = np.flatnonzero(~frame.select(whole.alias("ok"))["ok"].to_numpy())
    if table.height != len(lines.sat) or len(bad):
        at = int(bad[0]) if len(bad) else 0
        raise StarwiseError("not a $SAT record", file=name, line=lines.sat_lines[at], found=lines.sat[at])
    texts = {column: table[column].to_list() for column in ("week", "tow", "sv")}
    return texts, {column: frame[column].to_numpy() for column in frame.columns}


def _satellites(names: list[str], lines: _Read, name: str) -> NDArray[np.int16]:
    known: dict[str, int] = {}
    out = np.empty(len(names), dtype=np.int16)
    for i, text in enumerate(names):
        if text not in known:
            try:
                known[text] = sv_id(_rinex_name(text))
            except StarwiseError:
                raise StarwiseError("not a satellite", file=name, line=lines.sat_lines[i], found=text) from None
        out[i] = known[text]
    return out


def _rinex_name(text: str) -> str:
    """RTKLIB writes SBAS satellites as their PRN, RINEX as PRN - 100 behind S; QZSS as J01."""
    number = text.strip()
    return f"S{int(number) - 100:02d}" if number.isdigit() and 120 <= int(number) <= 199 else number


def _lines(text: str, name: str) -> _Read:
    out = _Read()
    all_lines = text.splitlines()
    whole = text.endswith(("\n", "\r"))
    for number, line in enumerate(all_lines, 1):
        if not line.strip():
            continue
        kind = line.split(",", 1)[0].strip("\ufeff \t")
        last = number == len(all_lines) and not whole
        if kind not in RECORDS:
            if last:
                out.cut = True
                continue
            raise StarwiseError(
                "not a record of a solution status file", file=name, line=number, found=line.strip(),
                wanted=", ".join(RECORDS),
            )  # fmt: skip
        least = _SAT_FIELDS if kind == "$SAT" else _POS_FIELDS if kind == "$POS" else 0
        if line.count(",") + 1 < least:
            if last:
                out.cut = True
                continue
            raise StarwiseError(
                f"a {kind} record with too few fields", file=name, line=number, found=line.strip(), wanted=f"{least}"
            )
        if kind == "$SAT":
            out.sat.append(line)
            out.sat_lines.append(number)
        elif kind == "$POS":
            out.pos.append((number, line.split(",")))
        elif kind == "$VELACC":
            fields = line.split(",")
            if len(fields) >= 7:
                out.vel[fields[1], fields[2]] = fields
    if not out.pos and not out.sat:
        raise StarwiseError("no solution status", file=name, wanted="$POS or $SAT records of RTKLIB")
    return out


def _time(fields: list[str]) -> int:
    week, tow = int(fields[1]), float(fields[2])
    if not (0 <= week <= 9999 and 0.0 <= tow <= WEEK_S):
        raise ValueError
    return week * WEEK_S * NS + round(tow * NS)


def _positions(table: F8, quality: I8) -> tuple[F8, F8]:
    """Positions (n, 3) and covariances (n, 3, 3), ECEF; the second triple is a fixed position, or PPP's sigmas."""
    first, second = table[:, :3], table[:, 3:]
    fixed = (quality == _FIXED) & (np.abs(second).max(axis=1) > _FAR)
    pos_e = np.where(fixed[:, None], second, first)
    pos_e[~((np.linalg.norm(pos_e, axis=1) > 1e6) & (np.linalg.norm(pos_e, axis=1) < 1e9))] = np.nan
    cov = np.full((len(table), 3, 3), np.nan)
    ppp = np.isin(quality, (_PPP, _FIXED)) & ~fixed & (second > 0.0).all(axis=1) & (second < _FAR).all(axis=1)
    cov[ppp] = 0.0
    for i in range(3):
        cov[ppp, i, i] = second[ppp, i] ** 2
    return pos_e, cov
