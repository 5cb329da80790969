"""Scenarios: everything that a simulation is made from, as one TOML file, typed and checked.

Every key has its unit in its name; an unknown key, a wrong type, a value outside its limits is one clear line with
the line of the file. Lists are counted from 1 in messages. The sections are in `starwise.sim.sections`.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from starwise.config import Checked, Range, read_toml
from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.sim.sections import SYSTEM_OF, Fault, Imu, Output, Receiver, Sky, Time, Vehicle

if TYPE_CHECKING:
    from starwise.sim.trajectory import Trajectory


@dataclass(frozen=True)
class Scenario(Checked):
    """A whole simulation, checked."""

    time: Time
    vehicle: Vehicle
    name: str = "scenario"
    description: str = ""
    seed: Annotated[int, Range(0)] = 1
    sky: Sky = field(default_factory=Sky)
    receiver: Receiver = field(default_factory=Receiver)
    imu: Imu | None = None
    faults: tuple[Fault, ...] = ()
    output: Output = field(default_factory=Output)
    folder: str = "."
    """Folder from which the paths of files count; the scenario file's own."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.imu is None and any(fault.sensor != "gnss" for fault in self.faults):
            raise StarwiseError("'faults' of an inertial sensor without one", wanted="a section [imu]")
        missing = sorted({SYSTEM_OF[c] for c in self.sky.constellations} - set(self.receiver.signals))
        if missing:
            raise StarwiseError(
                "'receiver.signals' leaves a system of the sky without signals", found=" ".join(missing)
            )

    @cached_property
    def t_ns(self) -> NDArray[np.int64]:
        """Measurement epochs, (n,) int64 GPST ns, both ends included."""
        n = int(round(self.time.duration_s * NS) // round(self.time.interval_s * NS)) + 1
        return self.time.start_ns + np.arange(n, dtype=np.int64) * round(self.time.interval_s * NS)

    @cached_property
    def trajectory(self) -> "Trajectory":
        """The vehicle's true trajectory, from 1 s before the scenario's start to 1 s after its end.

        Raises
        ------
        StarwiseError
            A segment that cannot be flown; a recorded file that cannot be used or is too short.
        """
        from starwise.sim.flight import MARGIN_S
        from starwise.sim.trajectory import from_segments, read_recorded

        start_ns, duration_s = self.time.start_ns, self.time.duration_s
        if self.vehicle.recorded is None:
            return from_segments(self.vehicle, start_ns, duration_s)
        recorded = read_recorded(self.path_of(self.vehicle.recorded), start_ns)
        first, last = recorded.begin_s + MARGIN_S, recorded.end_s - MARGIN_S
        if first > 1e-6 or last < duration_s - 1e-6:
            raise StarwiseError(
                "'vehicle.recorded' does not cover the scenario",
                found=f"{first:g} to {last:g} s",
                wanted=f"0 to {duration_s:g} s",
            )
        return recorded

    def path_of(self, name: str) -> Path:
        """Path of a file that the scenario names."""
        return Path(self.folder) / name


def load_scenario(path: str | Path, options: Mapping[str, Any] | None = None) -> Scenario:
    """Scenario of a TOML file, or of the package by its name (``s3ekf-3-turn``).

    Parameters
    ----------
    path : path-like
        The file; without a suffix and not existing, the name of a shipped scenario.
    options : mapping, optional
        What overrides the file; keys with a dot reach into tables (``receiver.mask_deg``).

    Raises
    ------
    StarwiseError
        The file cannot be read or is not TOML; a key is unknown or missing; a value does not fit.
    """
    file = _find(path)
    data = read_toml(file)
    data.setdefault("name", file.stem)
    data.setdefault("folder", str(file.parent))
    try:
        scenario = Scenario.from_dict(data)
        if not options:
            scenario.trajectory  # noqa: B018  an impossible segment is an error of the file
    except StarwiseError as error:
        raise error if error.file else _located(error, file) from None
    if options:
        scenario = scenario.with_options(options)
        scenario.trajectory  # noqa: B018
    return scenario


def shipped() -> tuple[str, ...]:
    """Names of the scenarios in the package."""
    folder = resources.files("starwise.sim") / "scenarios"
    return tuple(sorted(item.name[:-5] for item in folder.iterdir() if item.name.endswith(".toml")))


def _find(path: str | Path) -> Path:
    file = Path(path)
    if file.suffix or file.exists():
        return file
    if file.name == str(path) and file.name in shipped():
        return Path(str(resources.files("starwise.sim") / "scenarios" / f"{file.name}.toml"))
    raise StarwiseError("no such scenario", found=str(path), wanted=f"a file, or one of {', '.join(shipped())}")


def _located(error: StarwiseError, file: Path) -> StarwiseError:
    """The error with the scenario's file and the line of its key, where the text shows it."""
    quoted = re.match(r"'([\w.\[\]]+)'", error.message)
    key = quoted.group(1) if quoted else (error.found or "")
    line = _line_of(key, file.read_text(encoding="utf-8").splitlines())
    return StarwiseError(error.message, file=file, line=error.line or line, found=error.found, wanted=error.wanted)


def _line_of(key: str, lines: list[str]) -> int | None:
    """Line (from 1) of a dotted key like ``vehicle.segments[2].radius_m``, or of its table, or None."""
    table, number, leaf = "", 0, key
    indexed = re.match(r"([\w.]+)\[(\d+)\]\.?(\w*)$", key)
    if indexed:
        table, number, leaf = indexed.group(1), int(indexed.group(2)), indexed.group(3)
    elif "." in key:
        table, _, leaf = key.rpartition(".")
    here, count, at_table = "", 0, None
    for i, text in enumerate(lines, 1):
        header = re.match(r"\s*\[\[?\s*([\w.]+)\s*\]\]?", text)
        if header:
            here = header.group(1)
            count += here == table
            if here == table and (not number or count == number):
                at_table = i
            elif here == key and not number:
                return i
        elif (
            leaf
            and here == table
            and (not number or count == number)
            and re.match(rf"\s*['\"]?{re.escape(leaf)}['\"]?\s*=", text)
        ):
            return i
    return at_table
