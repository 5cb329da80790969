"""Solutions for maps and other programs: GeoJSON, KML, GPX, CSV, NMEA, RTKLIB `.pos`.

Heights: GeoJSON, CSV and `.pos` are of the ellipsoid (RFC 7946 section 4), KML, GPX and NMEA of mean sea level (OGC KML
2.2 section 9.20; GPX 1.1 ``ele``; NMEA 0183 GGA). No geoid is on board: without its height the ellipsoidal one is
written there, and said so. Times of KML, GPX and NMEA are UTC.
"""

import contextlib
import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import EPOCH_NO_SOLUTION, EPOCH_SUSPECT, NS
from starwise.errors import StarwiseError
from starwise.frames import geodetic_from_ecef, rotations_ne_enu
from starwise.gnsstime import decimals_of, gpst_to_utc, labels
from starwise.types import Solution

F8 = NDArray[np.float64]

FORMATS: Final = {
    "geojson": ".geojson",
    "kml": ".kml",
    "gpx": ".gpx",
    "csv": ".csv",
    "nmea": ".nmea",
    "pos": ".pos",
}
"""Names of the formats with the suffix of their files."""
SEVERAL: Final = ("geojson", "kml", "gpx")
"""Formats of which one file holds several solutions."""
SEA_LEVEL: Final = ("kml", "gpx", "nmea")
"""Formats whose heights are above mean sea level."""
_SUFFIXES: Final = (
    *FORMATS.values(), ".stat", ".gga", ".nav", ".txt", ".log", ".parquet", ".gz", ".z", ".zip", ".bz2",
)  # fmt: skip
_LAST_DIGIT_DEG: Final = 5e-10
"""Half of the last decimal of longitudes: what would be written as 180, which GPX excludes, is -180."""
_PLAIN: Final = {"nmea": 1, "pos": 5}
"""Quality that is written for every ordinary epoch."""
_GAP: Final = 10.0
"""A line is interrupted where the step in time is so many times the usual one."""


@dataclass(frozen=True)
class Track:
    """Epochs of a solution as a map shows them; row-aligned arrays.

    Attributes
    ----------
    name : str
        As a person calls it; anything may stand in it.
    t_ns, utc_ns : (n,) int64
        GPST and UTC label, ns since 1980-01-06.
    lat_deg, lon_deg, height_m : (n,) float64
        WGS 84; the height is what the format wants as far as it is known, see ``height``.
    height : str
        "ellipsoidal" or "mean sea level": what ``height_m`` is.
    geoid_m : float or None
        Height of the geoid above the ellipsoid, if known.
    sigma_enu_m, vel_enu_mps : (n, 3) float64
        NaN where there is none.
    cov_en_m2 : (n,) float64
        Covariance of east and north.
    status : list of str
        ``EPOCH_STATUS_NAMES`` of each epoch.
    n_used : (n,) int32
    dop : (n, 4) float64
        GDOP, PDOP, HDOP, VDOP.
    segments : tuple of slice
        Stretches without a gap in time that do not cross the antimeridian.
    """

    name: str
    t_ns: NDArray[np.int64]
    utc_ns: NDArray[np.int64]
    lat_deg: F8
    lon_deg: F8
    height_m: F8
    height: str
    geoid_m: float | None
    sigma_enu_m: F8
    vel_enu_mps: F8
    cov_en_m2: F8
    status: NDArray[np.uint8]
    n_used: NDArray[np.int32]
    dop: F8
    segments: tuple[slice, ...]

    def utc(self) -> list[str]:
        """UTC of the epochs, ``2024-03-30T11:59:42Z``, with as many decimals as the time tags need."""
        return labels(self.utc_ns, decimals_of(self.utc_ns), "{date}T{time}Z")


@dataclass(frozen=True)
class Exported:
    """What an export wrote.

    Attributes
    ----------
    files : tuple of Path
    epochs : int
        Epochs written, of all files.
    notes : tuple of str
        What a reader of the files should know.
    """

    files: tuple[Path, ...]
    epochs: int
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Choice:
    """Which epochs are written, and how.

    Attributes
    ----------
    suspect : bool
        Suspect epochs are written, too, marked as far as the format can.
    interval_s : float or None
        Only epochs on multiples of this, GPST.
    geoid_m : float or None
        Height of the geoid above the ellipsoid.
    """

    suspect: bool = True
    interval_s: float | None = None
    geoid_m: float | None = None

    def __post_init__(self) -> None:
        if self.interval_s is not None and not 1e-3 <= self.interval_s <= 86400.0:
            raise StarwiseError("--interval", found=f"{self.interval_s:g}", wanted="0.001 to 86400 s")
        if self.geoid_m is not None and not abs(self.geoid_m) <= 200.0:
            raise StarwiseError(
                "not the height of a geoid", found=f"{self.geoid_m:g}", wanted="metres above the ellipsoid, -107 to 86"
            )


def export_solutions(
    solutions: Sequence[tuple[str, Solution]], to: str, output: str | Path, choice: Choice | None = None
) -> Exported:
    """Write solutions in a format of `FORMATS`, whole or not at all.

    Parameters
    ----------
    solutions : sequence of (name, Solution)
    to : str
        A key of `FORMATS`.
    output : path-like
        The file; a directory for several solutions in a format that holds one (a file of each name).
    choice : Choice, optional

    Raises
    ------
    StarwiseError
        An unknown format, no epoch to write, or a file that cannot be written.
    """
    choice = choice or Choice()
    output = Path(output)
    together = to in SEVERAL or (len(solutions) == 1 and not output.is_dir())
    groups = [list(solutions)] if together else [[one] for one in solutions]
    names = [name for name, _ in solutions]
    if not together and len(solutions) > 1 and not output.is_dir():
        raise StarwiseError(f"one {to} file holds one solution", file=output, wanted="an existing directory")
    if output.is_dir():
        if len(set(names)) < len(names):
            raise StarwiseError("several solutions of one name", found=", ".join(sorted(names)), wanted="other names")
        stem = (lambda group: group[0][0]) if not together else (lambda _: output.name or "tracks")
        paths = [output / f"{_plain(stem(group))}{FORMATS[_known(to)]}" for group in groups]
    else:
        paths = [output]
    made = [render(group, to, choice) for group in groups]
    for path, (data, _, _) in zip(paths, made, strict=True):
        write_whole(path, data)
    notes = dict.fromkeys(note for _, _, said in made for note in said)
    return Exported(tuple(paths), sum(count for _, count, _ in made), tuple(notes))


def _known(to: str) -> str:
    if to not in FORMATS:
        raise StarwiseError("not a format to export to", found=to, wanted=", ".join(FORMATS))
    return to


def _plain(name: str) -> str:
    """A name that is safe as one of a file."""
    text = "".join(ch if ch.isalnum() or ch in "._-+" else "_" for ch in name).strip("._")
    return text or "solution"


def render(solutions: Sequence[tuple[str, Solution]], to: str, choice: Choice) -> tuple[bytes, int, tuple[str, ...]]:
    """Bytes of a file of a format, the number of epochs in it, and notes for its reader.

    Raises
    ------
    StarwiseError
        As in `export_solutions`.
    """
    _known(to)
    kept = [(name, _kept(solution, choice)) for name, solution in solutions]
    choices = [_choice_for(solution, to, choice) for _, solution in kept]
    epochs = sum(solution.n_epochs for _, solution in kept)
    if not epochs:
        raise StarwiseError("no epoch to write", found=", ".join(name for name, _ in kept), wanted="positions")
    said = [*(_height_notes(one, to, chosen) for (_, one), chosen in zip(kept, choices, strict=True))]
    if any(one.provenance.get("week") == "not in the file" for _, one in kept):
        said.append(["the input has no GPS week: times are of the first one, January 1980"])
    said += [_quality_notes(one, to) for _, one in kept]
    notes = list(dict.fromkeys(itertools.chain.from_iterable(said)))
    if to in ("csv", "pos"):
        from starwise.io.maps_text import csv_table
        from starwise.io.pos import write_pos

        solution = _ellipsoidal(kept[0][1], choice)
        return (csv_table(solution) if to == "csv" else write_pos(solution)), epochs, tuple(notes)
    writers: dict[str, Callable[[Sequence[Track]], bytes]] = {}
    if to in ("kml", "gpx"):
        from starwise.io import maps_xml

        writers = {"kml": maps_xml.kml, "gpx": maps_xml.gpx}
    else:
        from starwise.io import maps_text

        writers = {"geojson": maps_text.geojson, "nmea": maps_text.nmea}
    tracks = [_track(name, one, to, chosen) for (name, one), chosen in zip(kept, choices, strict=True)]
    return writers[to](tracks), epochs, tuple(notes)


def _choice_for(solution: Solution, to: str, choice: Choice) -> Choice:
    """With the geoid height of the input where that has one (NMEA), and the format wants heights above sea level."""
    known = solution.provenance.get("geoid_m")
    return (
        choice if choice.geoid_m is not None or known is None or to not in SEA_LEVEL else replace(choice, geoid_m=known)
    )


def _kept(solution: Solution, choice: Choice) -> Solution:
    keep = solution.has_position & (solution.status != EPOCH_NO_SOLUTION)
    if not choice.suspect:
        keep &= solution.status != EPOCH_SUSPECT
    if choice.interval_s is not None:
        # time tags corrected for the receiver's clock, as RTKLIB's are, lie beside the multiples
        step = round(choice.interval_s * NS)
        beside = min(5_000_000, step // 4)
        keep &= (solution.t_ns + beside) % step <= 2 * beside
    return rows_of(solution, keep)


def rows_of(solution: Solution, keep: NDArray[np.bool_]) -> Solution:
    """Some epochs of a solution, without its ledger."""
    rows = {
        name: getattr(solution, name)[keep]
        for name in (
            "t_ns", "status", "pos_e", "vel_e", "cov_pos", "cov_vel", "clock_m", "drift_mps", "clock_sigma_m",
            "n_used", "dop", "nis", "dof",
        )
    }  # fmt: skip
    return replace(solution, **rows, ledger={}, extra={name: v[keep] for name, v in solution.extra.items()})


def _height_notes(solution: Solution, to: str, choice: Choice) -> list[str]:
    above_geoid = solution.provenance.get("height") == "geodetic"
    if to in SEA_LEVEL:
        if not above_geoid and choice.geoid_m is None:
            return [f"heights are ellipsoidal where {to} expects mean sea level: give --geoid"]
        return []
    if above_geoid and choice.geoid_m is None:
        return [f"heights are above the geoid, as in the input, where {to} expects the ellipsoid: give --geoid"]
    if not above_geoid and choice.geoid_m is not None:
        raise StarwiseError(f"heights of {to} are ellipsoidal, and so is the input", wanted="no --geoid")
    return []


def _quality_notes(solution: Solution, to: str) -> list[str]:
    """That fixes, floats and so on of the input are not told apart in the output."""
    seen = solution.provenance.get("quality")
    if to not in _PLAIN or not isinstance(seen, dict):
        return []
    plain = "016" if solution.provenance.get("format") == "nmea" else "057"
    if set(seen) <= set(plain):
        return []
    return [f"quality (RTK, PPP, DGPS) of the input is not kept: written as {_PLAIN[to]}, single"]


def _ellipsoidal(solution: Solution, choice: Choice) -> Solution:
    """The solution with its heights above the ellipsoid, where that is known."""
    if solution.provenance.get("height") != "geodetic" or choice.geoid_m is None:
        return solution
    llh = geodetic_from_ecef(solution.pos_e)
    up = rotations_ne_enu(llh[:, 0], llh[:, 1])[:, 2]
    return replace(
        solution,
        pos_e=solution.pos_e + choice.geoid_m * up,
        provenance={**solution.provenance, "height": "ellipsoidal"},
    )


def _track(name: str, solution: Solution, to: str, choice: Choice) -> Track:
    llh = geodetic_from_ecef(solution.pos_e)
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])
    cov = C @ solution.cov_pos @ C.transpose(0, 2, 1)
    above_geoid = solution.provenance.get("height") == "geodetic"
    shift, height = 0.0, "mean sea level" if above_geoid else "ellipsoidal"
    if choice.geoid_m is not None:
        if to in SEA_LEVEL and not above_geoid:
            shift, height = -choice.geoid_m, "mean sea level"
        elif to not in SEA_LEVEL and above_geoid:
            shift, height = choice.geoid_m, "ellipsoidal"
    lon_deg = np.degrees(llh[:, 1])
    lon_deg[lon_deg >= 180.0 - _LAST_DIGIT_DEG] = -180.0
    with np.errstate(invalid="ignore"):
        sigma = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    return Track(
        name=name,
        t_ns=solution.t_ns,
        utc_ns=gpst_to_utc(solution.t_ns),
        lat_deg=np.degrees(llh[:, 0]),
        lon_deg=lon_deg,
        height_m=llh[:, 2] + shift,
        height=height,
        geoid_m=choice.geoid_m,
        sigma_enu_m=sigma,
        vel_enu_mps=(C @ solution.vel_e[:, :, None])[:, :, 0],
        cov_en_m2=cov[:, 0, 1],
        status=solution.status,
        n_used=solution.n_used,
        dop=solution.dop,
        segments=_segments(solution.t_ns, lon_deg),
    )


def _segments(t_ns: NDArray[np.int64], lon_deg: F8) -> tuple[slice, ...]:
    """Stretches without a gap in time or a jump across the antimeridian."""
    steps = np.diff(t_ns)
    if not steps.any():
        return (slice(0, len(t_ns)),)
    usual = np.median(steps[steps > 0])  # an instant may come twice, as in logs of two talkers
    cut = (steps > _GAP * usual) | (np.abs(np.diff(lon_deg)) > 180.0)
    ends = [0, *(np.flatnonzero(cut) + 1).tolist(), len(t_ns)]
    return tuple(slice(a, b) for a, b in itertools.pairwise(ends))


def write_whole(path: Path, data: bytes) -> None:
    """Write a file under a temporary name, then give it its own: never half of it.

    Raises
    ------
    StarwiseError
        It cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    except OSError as error:
        raise StarwiseError(f"cannot be written ({error.strerror})", file=path) from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def name_of(path: str | Path, solution: Solution) -> str:
    """What people call a solution: the marker of its station, or else the name of its directory or file."""
    station: Any = solution.provenance.get("station")
    marker = str(station.get("marker") or "").strip() if isinstance(station, dict) else ""
    return marker or stem_of(path)


def stem_of(path: str | Path) -> str:
    """Name of a directory, or of a file without the suffixes that say what it is."""
    path = Path(path)
    if path.is_dir():
        return path.resolve().name
    name = path.name
    while len(stem := Path(name).stem) < len(name) and Path(name).suffix.lower() in _SUFFIXES:
        name = stem
    return name
