"""Units of a folder: observation files told by their content, with the navigation files that fit in time."""

import os
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from starwise.batch.manifest import Manifest
from starwise.batch.work import NAME_LENGTH, Unit
from starwise.config import RunConfig
from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.io.inputs import head_of, peek

Span = tuple[int, int]
"""First and last instant, GPST ns; of observations to within the leap seconds, which is all that pairing needs."""

USABLE_AFTER_S: Final = 7200
"""An ephemeris serves this long after its reference time (most for four hours)."""
ENOUGH_S: Final = 600
"""A navigation file fits if it serves for that long of the observations, or for half of them."""
_PACKING: Final = (".gz", ".z", ".bz2", ".zip")
_LONG: Final = re.compile(r"_(\d\d)([MHDY])_\d\d[CZSMHD]_[A-Z]{2}\.", re.IGNORECASE)
_SHORT: Final = re.compile(r"^\w{4}\d{3}([0-9a-x])(?:\d\d)?\.\d\d[od]", re.IGNORECASE)
_UNIT_S: Final = {"M": 60, "H": 3600, "D": 86400, "Y": 366 * 86400}
_GPS_EPOCH: Final = datetime(1980, 1, 6, tzinfo=UTC)


@dataclass(frozen=True)
class _Found:
    """Files of a folder by what they are."""

    obs: tuple[Path, ...]
    nav: tuple[tuple[Path, Span], ...]


def scan(
    folder: str | Path, config: RunConfig | None = None, progress: Callable[[str, float], None] | None = None
) -> Manifest:
    """Units of a folder and its subfolders, one for every observation file.

    An observation file is paired with the navigation files of its own folder (else of the nearest folder above that
    has fitting ones) whose ephemerides serve while it lasts; where some of these are of the same station, by the
    first four letters of the name, with those alone. Orbit and clock files are left to manifests.

    Parameters
    ----------
    folder : path-like
    config : RunConfig, optional
        Of all units.
    progress : callable, optional

    Returns
    -------
    Manifest
        ``unpaired`` has the observation files without a navigation file, and files that cannot be read.

    Raises
    ------
    StarwiseError
        The folder cannot be read, or there is nothing to solve in it.
    """
    base = Path(folder)
    say = progress or (lambda _what, _fraction: None)
    left: list[tuple[str, str]] = []
    others: dict[str, int] = {}
    paths = sorted(Path(at, name) for at, _, names in os.walk(base) for name in names if not name.startswith("."))
    by_folder: dict[Path, list[tuple[Path, str]]] = {}
    for number, path in enumerate(paths):
        say("scanning", number / (2 * len(paths)))
        kind = _kind(path, left)
        if kind in ("rinex_obs", "rinex_nav"):
            by_folder.setdefault(path.parent, []).append((path, kind))
        elif kind in ("sp3", "clk"):
            others[kind] = others.get(kind, 0) + 1
    found = {at: _navigation(files, left) for at, files in by_folder.items()}
    pairs: list[tuple[Path, list[Path]]] = []
    count = sum(len(files.obs) for files in found.values())
    for at in sorted(found):
        for path in found[at].obs:
            say("scanning", 0.5 + len(pairs) / (2 * max(count, 1)))
            pairs.append((path, _pair(path, found, base, left)))
    paired = [(path, nav) for path, nav in pairs if nav]
    names = _names([path for path, _ in paired], base)
    chosen = config or RunConfig()
    units = [Unit(names[path], obs=(str(path),), nav=tuple(map(str, nav)), config=chosen) for path, nav in paired]
    notes = [f"{n} {kind.upper()} files left alone: a manifest can name them" for kind, n in sorted(others.items())]
    if not units and not left:
        raise StarwiseError("no observation file here", file=base, wanted="RINEX observation and navigation files")
    return Manifest(lambda: units, len(units), tuple(sorted(left)), tuple(notes))


def _kind(path: Path, left: list[tuple[str, str]]) -> str:
    """Kind of a file; what is damaged or no file at all is no kind."""
    try:
        return peek(path).kind if path.is_file() else "unknown"
    except StarwiseError as error:
        if path.suffix.lower() in _PACKING:
            left.append((str(path), str(error)))
        return "unknown"


def _navigation(files: list[tuple[Path, str]], left: list[tuple[str, str]]) -> _Found:
    """Observation files of a folder, and its navigation files with the time that they serve."""
    nav: list[tuple[Path, Span]] = []
    for path, kind in files:
        if kind != "rinex_nav":
            continue
        try:
            nav.append((path, nav_span(path)))
        except StarwiseError as error:
            left.append((str(path), str(error)))
    return _Found(tuple(path for path, kind in files if kind == "rinex_obs"), tuple(nav))


def _pair(path: Path, found: dict[Path, _Found], base: Path, left: list[tuple[str, str]]) -> list[Path]:
    """Navigation files for an observation file; none: it goes to ``left`` with the reason."""
    try:
        span = obs_span(path)
    except StarwiseError as error:
        left.append((str(path), str(error)))
        return []
    seen = False
    for folder in (path.parent, *path.parent.parents):
        nav = found[folder].nav if folder in found else ()
        seen = seen or bool(nav)
        fitting = [file for file, serves in nav if _fits(span, serves)]
        if fitting:
            own = [file for file in fitting if file.name[:4].upper() == path.name[:4].upper()]
            return own or fitting
        if folder == base:
            break
    left.append((str(path), "no navigation file of its time" if seen else "no navigation file in its folder"))
    return []


def _fits(span: Span, serves: Span) -> bool:
    common = min(span[1], serves[1]) - max(span[0], serves[0])
    return common >= min(ENOUGH_S * NS, (span[1] - span[0]) // 2)


def nav_span(path: Path) -> Span:
    """Time that the ephemerides of a navigation file serve.

    Raises
    ------
    StarwiseError
        It cannot be read.
    """
    from starwise.io.rinex_nav import read_nav

    toe = read_nav(path).toe_ns
    return int(toe.min()), int(toe.max()) + USABLE_AFTER_S * NS


def obs_span(path: Path) -> Span:
    """First and about the last epoch of an observation file: by its header and the length that its name tells.

    Where either is missing the whole file is read.

    Raises
    ------
    StarwiseError
        It cannot be read, or has no epoch.
    """
    head = head_of(path).decode("latin-1")
    header = head.partition("END OF HEADER")[0].splitlines()
    first, last = _time(header, "TIME OF FIRST OBS"), _time(header, "TIME OF LAST OBS")
    length = _length_s(path.name)
    if first is not None and last is None and length is not None:
        last = first + length * NS
    if first is not None and last is not None and last >= first:
        return first, last
    from starwise.io.rinex_obs import read_obs

    t_ns = read_obs(path).t_ns
    if not len(t_ns):
        raise StarwiseError("no epoch", file=path)
    return int(t_ns[0]), int(t_ns[-1])


def _time(header: list[str], label: str) -> int | None:
    line = next((text for text in header if text[60:].strip() == label), "")
    try:
        year, month, day, hour, minute = (int(part) for part in line[:30].split())
        since = datetime(year, month, day, hour, minute, tzinfo=UTC) - _GPS_EPOCH
    except ValueError:
        return None
    return round(since.total_seconds()) * NS


def _length_s(name: str) -> int | None:
    """Length that a name tells: ``_01D_`` of long names; session 0 or a to x of short ones, a day or an hour."""
    long = _LONG.search(name)
    if long is not None:
        return int(long.group(1)) * _UNIT_S[long.group(2).upper()] or None
    short = _SHORT.match(name)
    if short is not None:
        return 86400 if short.group(1) == "0" else 3600 if short.group(1).isalpha() else None
    return None


def _names(paths: list[Path], base: Path) -> dict[Path, str]:
    """Names of units: of the files without what tells their form; with more of the path where that is not enough."""

    def stem(path: Path) -> str:
        name = path.name
        while Path(name).suffix.lower() in _PACKING:
            name = Path(name).stem
        return Path(name).stem if Path(name).suffix.lower() in (".rnx", ".crx", ".obs") else name

    ways: tuple[Callable[[Path], str], ...] = (
        stem,
        lambda path: ".".join([*path.parent.relative_to(base).parts, stem(path)]),
        lambda path: ".".join(path.relative_to(base).parts),
    )
    names: dict[Path, str] = {}
    rest = paths
    for way in ways:
        made = {path: re.sub(r"[^A-Za-z0-9._-]", "_", way(path)).lstrip(".")[-NAME_LENGTH:] for path in rest}
        often = Counter([*names.values(), *made.values()])
        names |= {path: name for path, name in made.items() if often[name] == 1 and name.strip("._-")}
        rest = [path for path in rest if path not in names]
    return names | {path: f"unit-{number}" for number, path in enumerate(rest)}
