"""Lists of units: a TOML file, a file of JSON lines for very many, and tables of true positions."""

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final

from starwise.batch.store import is_url
from starwise.batch.work import Unit
from starwise.checked import merged, nested, read_toml, with_file
from starwise.config import RunConfig
from starwise.errors import StarwiseError

LISTS: Final = ("obs", "nav", "sp3", "clk")
_KEYS: Final = tuple(item.name for item in fields(Unit) if item.name != "config")


@dataclass(frozen=True)
class Manifest:
    """Units to be solved, and what stood beside them.

    Attributes
    ----------
    units : callable
        The units from the beginning, as often as it is called; they need not be in memory.
    total : int or None
        How many there are; None if nobody knows.
    unpaired : tuple of (place, reason)
        Observation files of a folder that no unit could be made of.
    notes : tuple of str
    """

    units: Callable[[], Iterable[Unit]]
    total: int | None = None
    unpaired: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = field(default=())


def read_manifest(
    path: str | Path, base: RunConfig | None = None, options: Mapping[str, Any] | None = None
) -> Manifest:
    """Units of a manifest.

    Parameters
    ----------
    path : path-like
        ``.toml``: tables ``[[unit]]`` and, for all of them, ``[defaults]``; ``.jsonl``: a unit in JSON on every line,
        read as it is needed. The keys are the fields of `Unit`, and ``options``, those of `RunConfig`. Paths are
        relative to the manifest.
    base : RunConfig, optional
        What options are not given stand at.
    options : mapping, optional
        Override those of the manifest.

    Raises
    ------
    StarwiseError
        It cannot be read; a key or a value that cannot be; a name twice; nothing in it.
    """
    path = Path(path)
    maker = _Maker(path, base or RunConfig(), nested(options or {}))
    if path.suffix.lower() in (".jsonl", ".ndjson"):
        total = _check(maker.of_lines(), path)
        return Manifest(maker.of_lines, total)
    data = read_toml(path)
    unknown = sorted(set(data) - {"defaults", "unit"})
    if unknown:
        raise StarwiseError("unknown table", file=path, found=unknown[0], wanted="[defaults], [[unit]]")
    tables, defaults = data.get("unit", []), data.get("defaults", {})
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise StarwiseError("'unit' is not a list of tables", file=path, wanted="[[unit]]")
    if not isinstance(defaults, dict):
        raise StarwiseError("'defaults' is not a table", file=path, wanted="[defaults]")
    lines = [n for n, text in enumerate(path.read_text("utf-8").splitlines(), 1) if text.strip().startswith("[[unit]]")]
    at = lines if len(lines) == len(tables) else [None] * len(tables)
    units = [maker.unit(merged(defaults, table), line) for table, line in zip(tables, at, strict=True)]
    _check(zip(units, at, strict=True), path)
    return Manifest(lambda: units, len(units))


def _check(units: Iterable[tuple[Unit, int | None] | Unit], path: Path) -> int:
    """See that names are not used twice and that there is a unit; their number."""
    seen: set[str] = set()
    for item in units:
        unit, line = item if isinstance(item, tuple) else (item, None)
        if unit.name in seen:
            raise StarwiseError("two units of the same name", file=path, line=line, found=unit.name)
        seen.add(unit.name)
    if not seen:
        raise StarwiseError("no unit in the manifest", file=path, wanted="[[unit]]")
    return len(seen)


class _Maker:
    """Units out of plain tables."""

    def __init__(self, path: Path, base: RunConfig, over: dict[str, Any]) -> None:
        self._path, self._over = path, over
        self._base = base.to_dict()
        self._configs: dict[str, RunConfig] = {}

    def of_lines(self) -> Iterator[Unit]:
        """Units of a file of JSON lines, one at a time."""
        try:
            with self._path.open(encoding="utf-8") as file:
                for line, text in enumerate(file, 1):
                    if not text.strip():
                        continue
                    try:
                        table = json.loads(text)
                    except ValueError:
                        table = None
                    if not isinstance(table, dict):
                        raise StarwiseError("not a JSON object", file=self._path, line=line, found=text.strip())
                    yield self.unit(table, line)
        except OSError as error:
            raise StarwiseError(f"cannot be read ({error.strerror})", file=self._path) from None
        except UnicodeDecodeError:
            raise StarwiseError("not a text file", file=self._path, wanted="JSON lines in UTF-8") from None

    def unit(self, table: Mapping[str, Any], line: int | None) -> Unit:
        """Unit of a table; errors name the file and, where it is known, the line."""
        try:
            values = dict(table)
            options = values.pop("options", {})
            if not isinstance(options, Mapping):
                raise StarwiseError("'options' is not a table", found=str(options))
            if "config" in values:
                raise StarwiseError("unknown configuration key", found="config", wanted=f"one of {', '.join(_KEYS)}")
            for name in [name for name in LISTS if name in values]:
                given = values[name]
                given = (given,) if isinstance(given, str) else given
                if isinstance(given, list | tuple):
                    values[name] = [self._place(place) for place in given]
            if isinstance(values.get("truth"), list):
                values["truth"] = ",".join(str(part) for part in values["truth"])
            if isinstance(values.get("truth"), str):
                values["truth"] = self._truth(values["truth"])
            return replace(Unit.from_dict(values), config=self._config(options))
        except StarwiseError as error:
            named = with_file(error, str(self._path))
            if named.line is None and line is not None:
                named = StarwiseError(named.message, file=named.file, line=line, found=named.found, wanted=named.wanted)
            raise named from None

    def _config(self, options: Mapping[str, Any]) -> RunConfig:
        """Configuration of a unit; of a million of units there are only a few."""
        key = json.dumps(options, sort_keys=True, default=str)
        if key not in self._configs:
            chosen = merged(merged(self._base, nested(options)), self._over)
            self._configs[key] = RunConfig.from_dict(chosen)
        return self._configs[key]

    def _place(self, place: Any) -> Any:
        if not isinstance(place, str) or is_url(place):
            return place
        return str(self._path.parent / Path(place).expanduser())

    def _truth(self, truth: str) -> str:
        beside = self._path.parent / Path(truth).expanduser()
        return str(beside) if not is_url(truth) and beside.exists() else truth


def with_truths(manifest: Manifest, table: str | Path) -> Manifest:
    """Manifest with the truths of a table; those that units have of their own stay.

    Parameters
    ----------
    manifest : Manifest
    table : path-like
        CSV with a heading: ``unit`` (name of the unit, or what its name begins with, in any case: the longest that
        fits is taken), ``truth`` as in `Unit` or ``x_m, y_m, z_m``; perhaps ``antenna_up_m``.

    Raises
    ------
    StarwiseError
        Not such a table.
    """
    known = _truths(Path(table))
    longest = max(map(len, known), default=0)

    def units() -> Iterator[Unit]:
        for unit in manifest.units():
            name = unit.name.upper()
            found = next((known[name[:n]] for n in range(min(len(name), longest), 0, -1) if name[:n] in known), None)
            yield (
                unit
                if found is None or unit.truth is not None
                else replace(unit, truth=found[0], antenna_up_m=found[1])
            )

    return replace(manifest, units=units)


def without_ledgers(manifest: Manifest) -> Manifest:
    """Manifest whose units keep no ledger."""
    return replace(manifest, units=lambda: (replace(unit, ledger=False) for unit in manifest.units()))


def _truths(path: Path) -> dict[str, tuple[str, float]]:
    try:
        rows = list(csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines()))
    except OSError as error:
        raise StarwiseError(f"cannot be read ({error.strerror})", file=path) from None
    except (UnicodeDecodeError, csv.Error):
        raise StarwiseError("not a table of text", file=path, wanted="CSV in UTF-8") from None
    found: dict[str, tuple[str, float]] = {}
    for line, row in enumerate(rows, 2):
        cells = {
            str(key).strip().lower(): (value or "").strip() for key, value in row.items() if isinstance(value, str)
        }
        xyz = [cells.get(f"{axis}_m", "") for axis in "xyz"]
        truth = cells.get("truth") or (",".join(xyz) if all(xyz) else "")
        if not cells.get("unit") or not truth:
            raise StarwiseError(
                "not a row of a table of truths", file=path, line=line, found=",".join(cells.values()),
                wanted="columns unit and truth, or unit, x_m, y_m, z_m; perhaps antenna_up_m",
            )  # fmt: skip
        beside = path.parent / truth
        try:
            up = float(cells.get("antenna_up_m") or 0.0)
        except ValueError:
            raise StarwiseError(
                "antenna_up_m is not a number", file=path, line=line, found=cells["antenna_up_m"], wanted="metres"
            ) from None
        found[cells["unit"].upper()] = (str(beside) if not is_url(truth) and beside.is_file() else truth, up)
    if not found:
        raise StarwiseError("no truth in the table", file=path, wanted="columns unit and truth, or unit, x_m, y_m, z_m")
    return found


def as_toml(manifest: Manifest) -> str:
    """Manifest as TOML, options left out; what a scan found, to be kept and edited."""
    notes = [f"# left out: {place}: {reason}" for place, reason in manifest.unpaired]
    notes += [f"# {note}" for note in manifest.notes]
    parts = ["\n".join(notes)] if notes else []
    for unit in manifest.units():
        lines = ["[[unit]]", f"name = {json.dumps(unit.name)}"]
        lines += [f"{name} = {json.dumps(list(getattr(unit, name)))}" for name in LISTS if getattr(unit, name)]
        if unit.truth is not None:
            lines.append(f"truth = {json.dumps(unit.truth)}")
        if unit.antenna_up_m:
            lines.append(f"antenna_up_m = {unit.antenna_up_m!r}")
        parts.append("\n".join(lines))
    return "\n\n".join(parts)
