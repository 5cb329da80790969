"""RTKLIB position files (``.pos``): written in its latitude/longitude form, read in every form it can write.

The form is that of RTKLIB 2.4.3 (manual, appendix B.4, and what its programs write): comment lines begin with
``%``, the last of them names the columns. Off-diagonal elements of a covariance are written as ``sdxy``, the square
root of its size with its sign.
"""

import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    EPOCH_COASTED,
    EPOCH_NO_SOLUTION,
    EPOCH_OK,
    EPOCH_SUSPECT,
    NS,
    WEEK_S,
)
from starwise.errors import StarwiseError
from starwise.frames import C_ne_enu, ecef_from_geodetic, geodetic_from_ecef, rotations_ne_enu
from starwise.gnsstime import decimals_of, from_calendar, label_to_gpst, labels
from starwise.io.files import read_bytes
from starwise.types import Solution

F8 = NDArray[np.float64]

Q_OK: Final = 5
"""RTKLIB's quality "single": what a position of this package is."""
Q_COASTED: Final = 7
"""RTKLIB's quality "dead reckoning": predicted without a measurement."""
Q_NONE: Final = 0
"""RTKLIB's quality "none": its programs skip the line. Written for suspect epochs."""

_JST_S: Final = 9 * 3600
_LARGEST: Final = 1e15
"""Numbers from here on, and infinities, are read as missing: no length, angle or count is that large."""
_FLIP: Final = [1, 0, 2]  # north, east, up from east, north, up


def write_pos(solution: Solution, *, program: str = "starwise") -> bytes:
    """Text of a `.pos` file: GPST, latitude, longitude (deg), ellipsoidal height (m), sigmas, velocities.

    Epochs without a position are left out. ``Q`` is 5 for an ordinary epoch, 7 for one that was only predicted, 0 for
    a suspect one (RTKLIB's programs skip Q = 0). Time has as many decimals (3, 6 or 9) as its tags need. Velocity
    columns, as with RTKLIB's ``out-outvel``, appear if any epoch has a velocity; where one has none they are ``nan``.
    """
    keep = solution.has_position & (solution.status != EPOCH_NO_SOLUTION)
    t_ns, pos_e = solution.t_ns[keep], solution.pos_e[keep]
    llh = geodetic_from_ecef(pos_e)
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])
    quality = np.select(
        [solution.status[keep] == EPOCH_COASTED, solution.status[keep] == EPOCH_SUSPECT],
        [Q_COASTED, Q_NONE],
        Q_OK,
    )
    columns = [
        np.degrees(llh[:, :2]),
        llh[:, 2:],
        quality[:, None],
        solution.n_used[keep, None],
        _deviations(C @ solution.cov_pos[keep] @ C.transpose(0, 2, 1)),
    ]
    row = "%s %14.9f %14.9f %10.4f %3d %3d %8.4f %8.4f %8.4f %8.4f %8.4f %8.4f   0.00    0.0"
    names = (
        "  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m)"
        " age(s)  ratio"
    )
    if np.isfinite(solution.vel_e[keep]).any():
        vel_n = (C @ solution.vel_e[keep, :, None])[:, _FLIP, 0]
        columns += [vel_n, _deviations(C @ solution.cov_vel[keep] @ C.transpose(0, 2, 1))]
        row += " %10.5f %10.5f %10.5f %9.5f %8.5f %8.5f %8.5f %8.5f %8.5f"
        names += "    vn(m/s)    ve(m/s)    vu(m/s)      sdvn     sdve     sdvu    sdvne    sdveu    sdvun"
    decimals = decimals_of(t_ns, least=3)
    head = (
        f"% program   : {program}\n"
        "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,7:coasted,0:suspect,"
        "ns=# of satellites)\n"
        f"%  GPST{' ' * (16 + decimals)}{names[1:]}\n"
    )
    times = [text.replace("-", "/") for text in labels(t_ns, decimals, "{date} {time}")]
    values = np.concatenate(columns, axis=1).tolist()
    body = "\n".join([row % (at, *line) for at, line in zip(times, values, strict=True)])
    return (head + body + ("\n" if body else "")).encode("ascii")


def _deviations(cov: F8) -> F8:
    """Standard deviations n e u and signed roots ne eu un, (n, 6), of ENU covariances (n, 3, 3)."""
    picked = np.stack([cov[:, 1, 1], cov[:, 0, 0], cov[:, 2, 2], cov[:, 0, 1], cov[:, 0, 2], cov[:, 1, 2]], axis=1)
    picked[:, :3] = np.maximum(picked[:, :3], 0.0)  # a negative variance is written as RTKLIB does
    return np.asarray(np.sign(picked) * np.sqrt(np.abs(picked)))


# -- Reading ------------------------------------------------------------------------------------------------


@dataclass
class _Form:
    """How the lines of a file are to be read; what the header does not say is guessed from the first line."""

    coordinates: str = ""  # llh, dms, xyz, enu
    scale: str = "GPST"
    geodetic_height: bool = False
    ref_e: F8 | None = None
    said: bool = False  # a header named the columns


@dataclass
class _Rows:
    """What the lines hold, in the coordinates of the file."""

    t_ns: list[int] = field(default_factory=list)
    numbers: list[list[float]] = field(default_factory=list)


_DATE = re.compile(r"\s*(\d{2,4})[/\-.](\d{1,2})[/\-.](\d{1,2})[ T]+(\d{1,2}):(\d{1,2}):(\d{1,2}(?:\.\d*)?)")
_NOT_NUMBER = re.compile(r"[^0-9eE+\-.naifNAIF]+")


def read_pos(path: str | Path) -> Solution:
    """Solution of a `.pos` file as RTKLIB writes it, whatever its output options.

    Latitude/longitude/height in degrees or in degrees, minutes and seconds; x/y/z; east/north/up of a baseline (the
    header must give the reference position); calendar or week and seconds; GPST, UTC or JST; any separator; with or
    without velocities, sigmas and header. Without a header, columns are taken as latitude/longitude/height unless they
    are as large as an ECEF position, and time as GPST.

    Heights above the geoid (``out-height = geodetic``) cannot be turned into ellipsoidal ones without the geoid: they
    are kept as they are, and ``provenance["height"]`` is "geodetic".

    Returns
    -------
    Solution
        ``status`` is suspect for Q = 0, coasted for Q = 7, else ok. Where the file has no sigmas, covariances are NaN.
        ``provenance`` holds the form of the file and the count of each Q.

    Raises
    ------
    StarwiseError
        Not such a file, or a line that does not fit its header.
    """
    path = Path(path)
    return parse_pos(read_bytes(path), str(path))


def parse_pos(raw: bytes, name: str) -> Solution:
    """Solution of the bytes of a `.pos` file; see `read_pos`. ``name`` is for messages."""
    text = raw.decode("latin-1")
    if re.match(r"\s*\$G[A-Z]", text):
        from starwise.io.nmea import parse_nmea

        return parse_nmea(text, name)
    form, rows = _Form(), _Rows()
    widths: set[int] = set()
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        if line.lstrip().startswith(("%", "#")):
            _read_header(line, form, name, number)
            continue
        t_ns, rest = _read_time(line, form, name, number)
        if not 0 <= t_ns < 1 << 62:
            raise StarwiseError("time out of range", file=name, line=number, found=line.strip())
        try:
            values = [float(part) for part in _NOT_NUMBER.sub(" ", rest).split()]
        except ValueError:
            raise StarwiseError("not numbers", file=name, line=number, found=line.strip()) from None
        if not form.coordinates:
            form.coordinates = _guess(values)
        if len(values) < (7 if form.coordinates == "dms" else 3):
            raise StarwiseError(
                "too few columns", file=name, line=number, found=line.strip(), wanted="time and a position"
            )
        widths.add(len(values))
        rows.t_ns.append(t_ns)
        rows.numbers.append(values)
    if not rows.t_ns and not form.said:
        raise StarwiseError("not a position file", file=name, wanted="an RTKLIB .pos file")
    return _assemble(form, rows, max(widths, default=3), name)


def _read_header(line: str, form: _Form, name: str, number: int) -> None:
    for scale in ("GPST", "UTC", "JST"):
        if re.match(rf"[%#]\s*{scale}\b", line):
            form.scale = scale
    kinds = {"x-ecef(m)": "xyz", "latitude(d'": "dms", "latitude(deg)": "llh", "e-baseline(m)": "enu"}
    for title, kind in kinds.items():
        if title in line:
            form.coordinates, form.said = kind, True
    if "/geodetic" in line:
        form.geodetic_height = True
    if "ref pos" in line or "slave pos" in line:
        try:
            values = [float(v) for v in _NOT_NUMBER.sub(" ", line.split(":", 1)[1]).split()]
            form.ref_e = _reference(values)
        except (ValueError, IndexError):
            raise StarwiseError("reference position not readable", file=name, line=number, found=line.strip()) from None


def _reference(values: list[float]) -> F8:
    """Reference position, ECEF m, written as x y z, as degrees and height, or as two d m s and height."""
    if len(values) >= 7:
        lat, lon = _degrees(np.array([values[:3]])), _degrees(np.array([values[3:6]]))
        return ecef_from_geodetic([np.radians(lat[0]), np.radians(lon[0]), values[6]])
    if np.linalg.norm(values[:3]) > 1e6:
        return np.array(values[:3])
    lat_deg, lon_deg, h = values[:3]
    return ecef_from_geodetic([np.radians(lat_deg), np.radians(lon_deg), h])


def _read_time(line: str, form: _Form, name: str, number: int) -> tuple[int, str]:
    """GPST, ns, at the start of a line, and the rest of the line."""
    scale = {"GPST": "GPS", "UTC": "UTC", "JST": "UTC"}[form.scale]
    shift = _JST_S * NS if form.scale == "JST" else 0
    match = _DATE.match(line)
    if match is not None:
        y, mo, d, h, mi = (int(g) for g in match.groups()[:5])
        try:
            label = from_calendar(y, mo, d, h, mi, float(match.group(6)))
        except StarwiseError as error:
            raise StarwiseError(error.message, file=name, line=number, found=match.group(0).strip()) from None
        return label_to_gpst(label - shift, scale), line[match.end() :]
    parts = _NOT_NUMBER.sub(" ", line).split(maxsplit=2)
    try:
        week, tow_ns = int(parts[0]), round(float(parts[1]) * NS)
        if not (0 <= week < 10000 and 0 <= tow_ns <= WEEK_S * NS):
            raise ValueError
    except (ValueError, IndexError, OverflowError):
        raise StarwiseError(
            "no time",
            file=name,
            line=number,
            found=line.strip(),
            wanted="yyyy/mm/dd hh:mm:ss or week and seconds",
        ) from None
    return label_to_gpst(week * WEEK_S * NS + tow_ns - shift, scale), parts[2] if len(parts) > 2 else ""


def _guess(values: list[float]) -> str:
    """Kind of the coordinates of a line without header."""
    if np.linalg.norm(values[:3]) > 1e6:
        return "xyz"
    return "dms" if len(values) in (17, 26) else "llh"


def _degrees(dms: F8) -> F8:
    """Degrees, minutes, seconds (n, 3) as degrees; the sign of the degrees, also of -0, counts for all."""
    sign = np.where(np.signbit(dms[:, 0]), -1.0, 1.0)
    return np.asarray(sign * (np.abs(dms[:, 0]) + dms[:, 1] / 60.0 + dms[:, 2] / 3600.0))


def _assemble(form: _Form, rows: _Rows, width: int, name: str) -> Solution:
    n = len(rows.t_ns)
    table = np.full((n, max(width, 26)), np.nan)
    for i, values in enumerate(rows.numbers):
        table[i, : len(values)] = values
    order = np.argsort(np.array(rows.t_ns, dtype=np.int64), kind="stable")
    t_ns, table = np.array(rows.t_ns, dtype=np.int64)[order], table[order]
    table[~(np.abs(table) < _LARGEST)] = np.nan
    first = 7 if form.coordinates == "dms" else 3
    pos_e, C = _positions(form, table, name)
    block = table[:, first:]
    quality = np.nan_to_num(block[:, 0], nan=Q_OK).astype(np.int64)
    n_used = np.clip(np.nan_to_num(block[:, 1]), 0, 9999).astype(np.int32)
    local = form.coordinates in ("llh", "dms")
    # Columns in the order of the axes: n e u (llh), x y z, or e n u.
    axes = _FLIP if local else [0, 1, 2]
    order6 = _PAIRS_LLH if local else _PAIRS_XYZ
    cov_pos = _rotated(C, _covariance(block[:, 2:8], axes, order6))
    vel = block[:, 10:13][:, axes] if block.shape[1] >= 13 else np.full((n, 3), np.nan)
    sd_vel = block[:, 13:19] if block.shape[1] >= 19 else np.full((n, 6), np.nan)
    vel_e = (C.transpose(0, 2, 1) @ vel[:, :, None])[:, :, 0]
    absent = ~np.isfinite(pos_e).all(axis=1)
    status = np.select(
        [absent, quality == Q_NONE, quality == Q_COASTED], [EPOCH_NO_SOLUTION, EPOCH_SUSPECT, EPOCH_COASTED], EPOCH_OK
    )
    none = np.full((n, 0), np.nan)
    return Solution(
        t_ns=t_ns,
        status=status.astype(np.uint8),
        pos_e=pos_e,
        vel_e=vel_e,
        cov_pos=cov_pos,
        cov_vel=_rotated(C, _covariance(sd_vel, axes, order6)),
        clock_m=none,
        drift_mps=none,
        clock_sigma_m=none,
        clock_names=(),
        n_used=n_used,
        dop=np.full((n, 4), np.nan),
        nis=np.full(n, np.nan),
        dof=np.zeros(n, dtype=np.int32),
        provenance={
            "file": name,
            "format": "rtklib pos",
            "coordinates": form.coordinates,
            "time": form.scale,
            "header": form.said,
            "height": "geodetic" if form.geodetic_height else "ellipsoidal",
            "quality": {str(q): count for q, count in sorted(Counter(quality.tolist()).items())},
            **_impossible(cov_pos),
        },
    )


def _impossible(cov: F8) -> dict[str, str]:
    """How many covariances are none: RTKLIB writes such at fixed epochs, and rounds to 0.1 mm."""
    known = cov[np.isfinite(cov).all(axis=(1, 2))]
    count = int((np.linalg.eigvalsh(known)[:, 0] <= 0.0).sum()) if len(known) else 0
    said = f"{count} of {len(known)} epochs have one that is not positive definite, as written; it holds no truth"
    return {"covariance": said} if count else {}


def _positions(form: _Form, table: F8, name: str) -> tuple[F8, F8]:
    """ECEF positions (n, 3) and the rotations (n, 3, 3) from ECEF to the axes of the file's sigmas."""
    n = len(table)
    if form.coordinates == "xyz":
        return table[:, :3], np.broadcast_to(np.eye(3), (n, 3, 3))
    if form.coordinates == "enu":
        if form.ref_e is None and n == 0:
            return table[:, :3], np.empty((0, 3, 3))
        if form.ref_e is None:
            raise StarwiseError(
                "a baseline without its reference position",
                file=name,
                wanted="a header line '% ref pos', which RTKLIB writes with out-outhead = on",
            )
        lat, lon, _ = geodetic_from_ecef(form.ref_e)
        C = C_ne_enu(lat, lon)
        return form.ref_e + table[:, :3] @ C, np.broadcast_to(C, (n, 3, 3))
    if form.coordinates == "dms":
        lat_deg, lon_deg, h = _degrees(table[:, :3]), _degrees(table[:, 3:6]), table[:, 6]
    else:
        lat_deg, lon_deg, h = table[:, 0], table[:, 1], table[:, 2]
    if (np.abs(lat_deg) > 90.0).any() or (np.abs(lon_deg) > 360.0).any():
        raise StarwiseError("latitude or longitude outside its range", file=name, wanted="degrees")
    llh = np.stack([np.radians(lat_deg), np.radians(lon_deg), h], axis=1)
    return ecef_from_geodetic(llh), rotations_ne_enu(llh[:, 0], llh[:, 1])


_PAIRS_LLH: Final = ((0, 1), (0, 2), (1, 2))  # ne, eu, un as indices of east, north, up
_PAIRS_XYZ: Final = ((0, 1), (1, 2), (0, 2))  # xy, yz, zx; en, nu, ue


def _covariance(sd: F8, axes: list[int], pairs: tuple[tuple[int, int], ...]) -> F8:
    """Covariances (n, 3, 3) of RTKLIB's six columns: three deviations, three signed roots (absent: zero)."""
    cov = np.empty((len(sd), 3, 3))
    for i in range(3):
        cov[:, i, i] = sd[:, axes[i]] ** 2
    for k, (i, j) in enumerate(pairs):
        root = sd[:, 3 + k]
        cov[:, i, j] = cov[:, j, i] = np.where(np.isnan(root), 0.0, np.sign(root) * root**2)
    return cov


def _rotated(C: F8, cov: F8) -> F8:
    return np.asarray(C.transpose(0, 2, 1) @ cov @ C)
