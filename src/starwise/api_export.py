"""Solutions for maps and other programs, in one call."""

from pathlib import Path

from starwise.errors import StarwiseError
from starwise.io.maps import FORMATS, Choice, Exported, export_solutions, name_of, render, stem_of
from starwise.io.results import read_solution
from starwise.types import Solution

PathLike = str | Path


def export(
    *solutions: Solution | PathLike,
    to: str | None = None,
    output: PathLike,
    geoid_m: float | None = None,
    interval_s: float | None = None,
    suspect: bool = True,
) -> Exported:
    """Write solutions as GeoJSON, KML, GPX, CSV, NMEA or RTKLIB `.pos`, whole or not at all.

    Parameters
    ----------
    *solutions : Solution or path-like
        Solutions, directories of results, or files that `starwise.read_solution` reads.
    to : str, optional
        ``geojson``, ``kml``, ``gpx``, ``csv``, ``nmea`` or ``pos``; default: by the suffix of ``output``.
    output : path-like
        The file, or an existing directory. GeoJSON, KML and GPX hold several solutions in one file.
    geoid_m : float, optional
        Height of the geoid above the ellipsoid, m. KML, GPX and NMEA expect heights above mean sea level.
    interval_s : float, optional
        Only epochs on multiples of this, s of GPST.
    suspect : bool
        Suspect epochs are written, too, and marked: status in GeoJSON, KML and CSV, ``type`` in GPX, quality 0 in NMEA
        and `.pos`.

    Returns
    -------
    Exported
        The files, the number of epochs, and what their readers should know.

    Raises
    ------
    StarwiseError
        An unknown format, nothing to write, or a file that cannot be read or written.
    """
    _distinct(solutions, Path(output))
    choice = Choice(suspect=suspect, interval_s=interval_s, geoid_m=geoid_m)
    return export_solutions(_named(solutions), format_of(to, Path(output)), output, choice)


def rendered(
    *solutions: Solution | PathLike,
    to: str,
    geoid_m: float | None = None,
    interval_s: float | None = None,
    suspect: bool = True,
) -> tuple[bytes, tuple[str, ...]]:
    """Bytes of what `export` would write into one file, and the notes for its readers."""
    choice = Choice(suspect=suspect, interval_s=interval_s, geoid_m=geoid_m)
    named = _named(solutions)
    if len(named) > 1 and to in FORMATS and to not in ("geojson", "kml", "gpx"):
        raise StarwiseError(f"one {to} file holds one solution", found=f"{len(named)} inputs", wanted="one")
    data, _, notes = render(named, to, choice)
    return data, notes


def format_of(to: str | None, output: Path | None) -> str:
    """The format asked for, or that of the output's suffix."""
    if to is not None:
        return to.lower()
    suffix = "" if output is None else output.suffix.lower()
    by_suffix = {end: name for name, end in FORMATS.items()} | {".json": "geojson"}
    if suffix not in by_suffix:
        raise StarwiseError(
            "no format to export to", found=None if output is None else str(output),
            wanted=f"--to with one of {', '.join(FORMATS)}",
        )  # fmt: skip
    return by_suffix[suffix]


def fresh_name(first: PathLike, to: str) -> Path:
    """File named by an input, in the current directory, that does not exist yet.

    Raises
    ------
    StarwiseError
        It does.
    """
    target = Path(f"{stem_of(first)}{FORMATS.get(to, '')}")
    if target.exists():
        raise StarwiseError("exists already", file=target, wanted="-o with the name of the output")
    return target


def _named(solutions: tuple[Solution | PathLike, ...]) -> list[tuple[str, Solution]]:
    if not solutions:
        raise StarwiseError("nothing to export", wanted="solutions")
    named = []
    for number, item in enumerate(solutions, 1):
        if isinstance(item, Solution):
            named.append((name_of(f"solution {number}", item), item))
        else:
            solution = read_solution(item, ledger=False)
            named.append((name_of(item, solution), solution))
    twice = {name for name, _ in named if [other for other, _ in named].count(name) > 1}
    return [
        (name if name not in twice else f"{name} {number}", solution)
        for number, (name, solution) in enumerate(named, 1)
    ]  # one station may come twice


def _distinct(solutions: tuple[Solution | PathLike, ...], output: Path) -> None:
    for item in solutions:
        if not isinstance(item, Solution) and output.is_file() and Path(item).is_file() and output.samefile(item):
            raise StarwiseError("the output is an input", file=output, wanted="another name")
