"""What a file of inertial readings holds: declared in TOML, never guessed.

Layouts of known recorders stand in the package (``starwise/imu_layouts/*.toml``); a description may begin with one of
them (``like = "kf-gins"``) and say the rest.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np

from starwise.checked import Checked, Positive, Range, read_toml, with_file, with_line
from starwise.checked import merged as merge
from starwise.errors import StarwiseError
from starwise.gnsstime import parse_time
from starwise.physics.earth import STANDARD_GRAVITY
from starwise.types import F8

RATE_UNITS: Final[dict[str, float]] = {"rad/s": 1.0, "deg/s": math.pi / 180.0, "deg/h": math.pi / 648_000.0}
ANGLE_UNITS: Final[dict[str, float]] = {"rad": 1.0, "deg": math.pi / 180.0, "arcsec": math.pi / 648_000.0}
FORCE_UNITS: Final[dict[str, float]] = {"m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY}
SPEED_UNITS: Final[dict[str, float]] = {"m/s": 1.0, "g s": STANDARD_GRAVITY}
"""Units of rates (gyro, accelerometer) and of increments (angle, velocity) in SI."""

_DIRECTIONS: Final = {
    "F": (1.0, 0.0, 0.0), "B": (-1.0, 0.0, 0.0), "R": (0.0, 1.0, 0.0),
    "L": (0.0, -1.0, 0.0), "D": (0.0, 0.0, 1.0), "U": (0.0, 0.0, -1.0),
}  # fmt: skip
_TIME_UNITS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True)
class ImuTime(Checked):
    """``[time]``: what the time tags are."""

    scale: Literal["gpst_tow", "gps_seconds", "unix", "seconds", "gpst", "utc"]
    """Seconds of the GPS week; since 1980-01-06 GPST; since 1970 UTC; since `origin`; or dates (GPST or UTC)."""
    column: str
    """Name in the header, or number of the column from 1."""
    unit: Literal["s", "ms", "us", "ns"] = "s"
    week: Annotated[int, Range(0, 9999)] | None = None
    """``gpst_tow``: GPS week (not truncated) of the first row; later weeks follow by themselves."""
    week_column: str | None = None
    origin: str | None = None
    """``seconds``: when the tag was zero, ``2025-07-08T19:34:21.854`` (GPST; with Z, UTC) or ``week:tow``."""
    origin_at: Literal["zero", "first"] = "zero"
    """Whether `origin` is the time of tag zero, or of the first row."""
    clock_rate: Annotated[float, Range(0.9, 1.1)] = 1.0
    """Seconds of GPST per second of the tags, counted from the first row."""
    offset_s: float = 0.0
    """Added to every time: minus the latency, if tags are times of arrival."""
    tags: Literal["as_written", "uniform"] = "as_written"
    """Tags of sensors that sample evenly but are tagged coarsely: taken as they are, or a line laid through them."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scale == "gpst_tow" and (self.week is None) == (self.week_column is None):
            raise StarwiseError(
                "'week' or 'week_column' is needed with seconds of the week", wanted="exactly one of them"
            )
        if self.scale == "seconds" and self.origin is None:
            raise StarwiseError("'origin' is needed with tags in seconds", wanted="the time of tag zero")
        if self.scale != "seconds" and self.origin is not None:
            raise StarwiseError("'origin' is for tags in seconds only", found=self.scale, wanted="seconds")
        if self.scale != "gpst_tow" and (self.week is not None or self.week_column is not None):
            raise StarwiseError("'week' is for seconds of the week only", found=self.scale, wanted="gpst_tow")
        if self.origin is not None:
            parse_time(self.origin)

    @property
    def unit_s(self) -> float:
        """Seconds in a unit of the tags."""
        return _TIME_UNITS[self.unit]


@dataclass(frozen=True)
class ImuGyro(Checked):
    """``[gyro]``: three columns and their unit."""

    columns: tuple[str, ...]
    """Names in the header, or numbers from 1, of the sensor's x, y and z."""
    unit: Literal["rad/s", "deg/s", "deg/h", "rad", "deg", "arcsec"]
    factor: Positive = 1.0
    """Units per number in the file, for raw counts."""
    inverted: bool = False
    """Readings have the opposite sign of the rotation."""


@dataclass(frozen=True)
class ImuAccel(Checked):
    """``[accel]``: three columns and their unit."""

    columns: tuple[str, ...]
    unit: Literal["m/s^2", "g", "mg", "m/s", "g s"]
    factor: Positive = 1.0
    inverted: bool = False
    """Readings are minus specific force: at rest, the axis that points down reads +1 g."""


@dataclass(frozen=True)
class ImuFile(Checked):
    """Description of a file of inertial readings."""

    readings: Literal["rates", "increments"]
    """Angular rate and specific force, or their integrals over the interval that ends at the tag."""
    rate_hz: Positive
    """Rows per second; a longer step than 1.5 of it is a gap."""
    time: ImuTime
    gyro: ImuGyro
    accel: ImuAccel
    axes: str | None = None
    """Where the sensor's x, y and z point: three of Forward Backward Right Left Down Up, like FRD, FLU or RFU."""
    rotation: tuple[tuple[float, ...], ...] | None = None
    """In place of `axes`: rows of the 3 x 3 rotation from sensor axes to forward, right, down."""
    delimiter: Literal["comma", "semicolon", "tab", "whitespace"] = "comma"
    header_lines: Annotated[int, Range(0, 10_000)] = 0
    """Lines before the readings; the last of them has the names of the columns, where names are used."""
    comment: str | None = None
    """What a line without readings begins with."""
    standard_gravity_mps2: Annotated[float, Range(9.7, 9.9)] = STANDARD_GRAVITY
    """What the maker means by 1 g."""
    check: bool = True
    """Refuse a file whose readings contradict this description (see `starwise.io.imu_check`)."""
    note: str = ""
    """For people."""
    sensor: dict[str, float] = field(default_factory=dict)
    """For people and filters: data sheet figures by name; not used by the reader."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, triad in (("gyro", self.gyro), ("accel", self.accel)):
            if len(triad.columns) != 3 or len(set(triad.columns)) != 3:
                raise StarwiseError(
                    f"'{name}.columns' are not three different ones", found=", ".join(triad.columns), wanted="x, y, z"
                )
        shared = {*self.gyro.columns} & {*self.accel.columns} or (
            {self.time.column} & {*self.gyro.columns, *self.accel.columns}
        )
        if shared:
            raise StarwiseError("a column is used twice", found=sorted(shared)[0], wanted="each once")
        kinds = (
            ("gyro", self.gyro.unit, {"rates": RATE_UNITS, "increments": ANGLE_UNITS}),
            ("accel", self.accel.unit, {"rates": FORCE_UNITS, "increments": SPEED_UNITS}),
        )
        for name, unit, units in kinds:
            if unit not in units[self.readings]:
                raise StarwiseError(
                    f"'{name}.unit' is not a unit of {self.readings}",
                    found=unit,
                    wanted=" | ".join(units[self.readings]),
                )
        if (self.axes is None) == (self.rotation is None):
            raise StarwiseError("'axes' or 'rotation' is needed", wanted="exactly one of them")
        self.C_bs()
        named = [c for c in self.columns if not c.isdecimal()]
        if named and self.header_lines == 0:
            raise StarwiseError(
                "columns have names but the file no header", found=named[0], wanted="numbers, or 'header_lines'"
            )
        if "0" in self.columns:
            raise StarwiseError("columns are counted from 1", found="0", wanted="1, 2, 3 ...")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], *, file: str | None = None, prefix: str = "") -> "ImuFile":
        """Description from nested mappings; columns may be numbers or names."""
        plain = {k: dict(v) if isinstance(v, Mapping) else v for k, v in data.items()}
        for table in ("time", "gyro", "accel"):
            inner = plain.get(table)
            for key in ("column", "columns", "week_column"):
                if isinstance(inner, dict) and key in inner:
                    inner[key] = _column_text(inner[key])
        return super().from_dict(plain, file=file, prefix=prefix)

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns used: time, week if any, gyro, accelerometer."""
        week = (self.time.week_column,) if self.time.week_column is not None else ()
        return (self.time.column, *week, *self.gyro.columns, *self.accel.columns)

    @property
    def gyro_si(self) -> float:
        """SI per number of a gyro column, with its sign."""
        size = self.gyro.factor * (RATE_UNITS | ANGLE_UNITS)[self.gyro.unit]
        return -size if self.gyro.inverted else size

    @property
    def accel_si(self) -> float:
        """SI per number of an accelerometer column, with its sign."""
        size = self.accel.factor * (FORCE_UNITS | SPEED_UNITS)[self.accel.unit]
        if "g" in self.accel.unit:
            size *= self.standard_gravity_mps2 / STANDARD_GRAVITY
        return -size if self.accel.inverted else size

    def C_bs(self) -> F8:
        """Rotation (3, 3) from sensor axes to forward, right, down.

        Raises
        ------
        StarwiseError
            Not three different axes, or not a rotation.
        """
        if self.axes is not None:
            letters = self.axes.upper()
            if len(letters) != 3 or any(letter not in _DIRECTIONS for letter in letters):
                raise StarwiseError("'axes' are not three directions", found=self.axes, wanted="like FRD, FLU or RFU")
            C = np.array([_DIRECTIONS[letter] for letter in letters]).T
        else:
            assert self.rotation is not None
            if len(self.rotation) != 3 or any(len(row) != 3 for row in self.rotation):
                raise StarwiseError("'rotation' is not 3 x 3", wanted="three rows of three numbers")
            C = np.array(self.rotation)
        if np.abs(C @ C.T - np.eye(3)).max() > 1e-4 or not np.linalg.det(C) > 0.0:
            name, found = ("axes", self.axes) if self.axes is not None else ("rotation", str(C.tolist()))
            raise StarwiseError(
                f"'{name}' is not a rotation", found=found, wanted="three perpendicular axes, right-handed"
            )
        u, _, vt = np.linalg.svd(C)
        return np.asarray(u @ vt)  # typed with four decimals or so: the nearest rotation


def _column_text(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_column_text(v) for v in value]
    return str(value) if type(value) is int else value


def layout_names() -> list[str]:
    """Names of the layouts in the package."""
    folder = resources.files("starwise") / "imu_layouts"
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_imu_config(where: str | Path, options: Mapping[str, Any] | None = None) -> ImuFile:
    """Description of inertial files out of a TOML file, or one of the package's layouts by its name.

    Parameters
    ----------
    where : path-like or str
        A file, or a name of `layout_names`. The key ``like`` names a layout to begin with.
    options : mapping, optional
        Tables and keys that override the file.

    Raises
    ------
    StarwiseError
        Not readable, not TOML, an unknown key, a missing one, or a value that does not fit.
    """
    path = Path(where)
    known = layout_names()
    if not path.exists() and str(where) in known:
        data, path = _layout(str(where)), Path(f"{where}.toml")
    elif not path.exists() and path.suffix != ".toml":
        raise StarwiseError("no such description", found=str(where), wanted=f"a TOML file or {' | '.join(known)}")
    else:
        data = read_toml(path)
        data.pop("inertial", None)  # options of the filter: starwise.config_inertial
        like = data.pop("like", None)
        if like is not None:
            if like not in known:
                raise StarwiseError("'like': no such layout", file=path, found=str(like), wanted=" | ".join(known))
            data = _over(_layout(like), data)
    data = _over(data, options or {})
    try:
        return ImuFile.from_dict(data, file=str(path))
    except StarwiseError as error:
        raise (with_line(error, path) if path.is_file() else with_file(error, str(path))) from None


def _over(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Merged tables, where a rotation replaces the base's axes and the other way round."""
    merged = merge(base, over)
    for one, other in (("axes", "rotation"), ("rotation", "axes")):
        if one in over and other not in over:
            merged.pop(other, None)
    return merged


def _layout(name: str) -> dict[str, Any]:
    with resources.as_file(resources.files("starwise") / "imu_layouts" / f"{name}.toml") as path:
        return read_toml(path)
