"""Configuration of a run: every option, its unit, its default and its limits, in one place.

A configuration is a frozen dataclass, checked when it is made, whether it comes from Python, from a TOML file or
from the command line: an unknown key, a wrong type or a value outside its limits is a `StarwiseError` that names
the key. Add an option by adding a field with a type and, where it has limits, a `Range`.
"""

import dataclasses
import difflib
import math
import re
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from starwise.constants import SYSTEMS
from starwise.errors import StarwiseError
from starwise.gnsstime import parse_time
from starwise.signals import signal_id, sv_id

C = TypeVar("C", bound="Checked")


@dataclass(frozen=True)
class Range:
    """Closed limits of a number, infinite where there are none; ``open_low`` excludes the lower one."""

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False

    def holds(self, value: float) -> bool:
        """Whether ``value`` is inside."""
        return (value > self.low if self.open_low else value >= self.low) and value <= self.high

    def __str__(self) -> str:
        if self.high == math.inf:
            return f"a number {'above' if self.open_low else 'from'} {self.low:g}"
        return f"a number {'above' if self.open_low else 'from'} {self.low:g} to {self.high:g}"


Positive = Annotated[float, Range(0.0, open_low=True)]
NotNegative = Annotated[float, Range(0.0)]
Probability = Annotated[float, Range(0.0, 1.0, open_low=True)]


class Checked:
    """Base of configuration dataclasses: fields are converted and checked against their types when made."""

    def __post_init__(self) -> None:
        hints = typing.get_type_hints(type(self), include_extras=True)
        for item in dataclasses.fields(self):  # type: ignore[arg-type]
            value = _checked(getattr(self, item.name), hints[item.name], item.name)
            object.__setattr__(self, item.name, value)

    @classmethod
    def from_dict(cls: type[C], data: Mapping[str, Any], *, file: str | None = None, prefix: str = "") -> C:
        """Configuration from nested mappings; what is absent keeps its default.

        Raises
        ------
        StarwiseError
            An unknown key (the nearest known one is named), a wrong type, or a value outside its limits.
        """
        known = {item.name for item in dataclasses.fields(cls)}  # type: ignore[arg-type]
        hints = typing.get_type_hints(cls, include_extras=True)
        values: dict[str, Any] = {}
        for key, value in data.items():
            if key not in known:
                near = difflib.get_close_matches(key, sorted(known), n=1, cutoff=0.5)
                wanted = f"'{prefix}{near[0]}'?" if near else f"one of {', '.join(sorted(known))}"
                raise StarwiseError("unknown configuration key", file=file, found=prefix + key, wanted=wanted)
            inner = _checked_class(hints[key])
            try:
                if inner is not None and isinstance(value, Mapping):
                    values[key] = inner.from_dict(value, file=file, prefix=f"{prefix}{key}.")
                else:
                    values[key] = _checked(value, hints[key], prefix + key)
            except StarwiseError as error:
                raise _with_file(error, file) from None
        for item in dataclasses.fields(cls):  # type: ignore[arg-type]
            required = item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING
            if required and item.name not in values:
                raise StarwiseError(f"'{prefix}{item.name}' is missing", file=file)
        try:
            return cls(**values)
        except StarwiseError as error:
            if prefix and error.message.startswith("'") and prefix not in error.message:
                # a check of the whole table names its own key, not where the table stands
                message = f"'{prefix}{error.message[1:]}"
                error = StarwiseError(message, found=error.found, wanted=error.wanted)
            raise _with_file(error, file) from None

    def to_dict(self) -> dict[str, Any]:
        """Nested plain values (lists, numbers, text, None), ready for JSON."""
        plain = _plain(self)
        assert isinstance(plain, dict)
        return plain

    def with_options(self: C, options: Mapping[str, Any]) -> C:
        """Copy with options changed; keys of inner tables are written with a dot (``process.tau_s``)."""
        return type(self).from_dict(_merged(self.to_dict(), _nested(options)))


@dataclass(frozen=True)
class ProcessNoise(Checked):
    """Process model of the user's motion; what is None comes from the preset of `RunConfig.dynamics`.

    Spectral densities are those of the white noise that drives the model, per axis.
    """

    model: Literal["static", "velocity", "acceleration", "singer"] | None = None
    """Fixed position, constant velocity, constant acceleration, or Singer (Markov acceleration)."""
    position_psd_m2_per_s: NotNegative | None = None
    """Static: random walk of the position, m^2/s."""
    acceleration_psd_m2_per_s3: NotNegative | None = None
    """Constant velocity: white acceleration, m^2/s^3."""
    jerk_psd_m2_per_s5: NotNegative | None = None
    """Constant acceleration: white jerk, m^2/s^5."""
    acceleration_sigma_mps2: NotNegative | None = None
    """Singer: standard deviation of the acceleration, m/s^2."""
    acceleration_tau_s: Positive | None = None
    """Singer: correlation time of the acceleration, s."""


@dataclass(frozen=True)
class ClockNoise(Checked):
    """Process noise of the receiver's clock; None takes the filter's default."""

    bias_psd_m2_per_s: NotNegative | None = None
    """White frequency noise, m^2/s."""
    drift_psd_m2_per_s3: NotNegative | None = None
    """Random walk of the frequency, m^2/s^3."""
    intersystem_psd_m2_per_s: NotNegative | None = None
    """Random walk of the clock of a system against the first system's, m^2/s."""


@dataclass(frozen=True)
class RunConfig(Checked):
    """Options of ``starwise solve``; the effective values stand in ``run.json`` beside every result."""

    method: Literal["lsq", "ekf", "s3ekf"] = "s3ekf"
    """Least squares per epoch, EKF (all satellites at once), or EKF satellite by satellite."""
    systems: str = "GRECJ"
    """Satellite systems to position with, letters as in RINEX."""
    dynamics: Literal["static", "pedestrian", "vehicle", "aircraft"] = "vehicle"
    """Preset of the process model; sets what `process` leaves open."""
    mask_deg: Annotated[float, Range(-5.0, 90.0)] = 10.0
    """Elevation mask, degrees."""
    cn0_min_dbhz: Annotated[float, Range(0.0, 99.0)] = 0.0
    """Rows with a known C/N0 below this are not used, dB-Hz."""
    signals: dict[str, tuple[str, ...]] | None = None
    """Preference of signals by system letter, like ``{"G": ["1C", "2W"]}``; None: the built-in table."""
    combination: Literal["single", "ionosphere_free"] = "single"
    """One signal per satellite, or the ionosphere-free combination of two."""
    ionosphere: Literal["broadcast", "none"] = "broadcast"
    troposphere: Literal["seasonal", "saastamoinen", "none"] = "seasonal"
    """Mean weather of latitude and season mapped by Niell, or Saastamoinen in a standard atmosphere over sin(el)."""
    weighting: Literal["standard"] = "standard"
    """Measurement variance from elevation, C/N0 and the accuracy the ephemeris claims."""
    error_model: Literal["white"] = "white"
    """Errors of successive epochs are taken as independent."""
    exclude: tuple[str, ...] = ()
    """Satellites never to be used, like ``["G05", "R12"]``."""
    fde: bool = True
    """Least squares: fault detection and exclusion by residuals."""
    gate_probability: Annotated[float, Range(0.0, 0.5, open_low=True)] = 1e-3
    """Chance that the filter's gate refuses a satellite whose errors are as modelled."""
    post: bool = False
    """Allow broadcast records transmitted after the epoch (nearest in time); false: what a receiver had then."""
    start: str | None = None
    """First epoch: ``2024-03-30T12:00:00`` (GPST), with ``Z`` UTC, or ``week:tow``."""
    end: str | None = None
    """Last epoch, written likewise."""
    interval_s: Annotated[float, Range(0.01, 86400.0)] | None = None
    """Use only epochs on multiples of this, s."""
    process: ProcessNoise = field(default_factory=ProcessNoise)
    clock: ClockNoise = field(default_factory=ClockNoise)

    def __post_init__(self) -> None:
        super().__post_init__()
        unknown = sorted(set(self.systems) - set(SYSTEMS))
        if not self.systems or unknown or len(set(self.systems)) != len(self.systems):
            raise StarwiseError(
                "systems: not letters, each once",
                found=self.systems,
                wanted=f"letters of {SYSTEMS}, like GRECJ",
            )
        for name in self.exclude:
            sv_id(name)
        for system, names in (self.signals or {}).items():
            if not names:
                raise StarwiseError(
                    f"'signals.{system}' is empty", found="[]", wanted="signals, or leave the system out"
                )
            if len(system) != 1 or system not in SYSTEMS:
                raise StarwiseError("signals: not a system", found=system, wanted=f"a letter of {SYSTEMS}")
            for name in names:
                signal_id(name)
        start, end = self.start_ns, self.end_ns
        if start is not None and end is not None and end < start:
            raise StarwiseError("end is before start", found=str(self.end), wanted=f"after {self.start}")

    @property
    def start_ns(self) -> int | None:
        """`start` as GPST, ns, or None."""
        return None if self.start is None else parse_time(self.start)

    @property
    def end_ns(self) -> int | None:
        """`end` as GPST, ns, or None."""
        return None if self.end is None else parse_time(self.end)


def load_config(path: str | Path | None = None, options: Mapping[str, Any] | None = None) -> RunConfig:
    """Configuration of a TOML file, with options that override it.

    Parameters
    ----------
    path : path-like, optional
        TOML file with the fields of `RunConfig` as keys, `process` and `clock` as tables.
    options : mapping, optional
        What overrides the file: fields of `RunConfig`; keys with a dot reach into the tables.

    Raises
    ------
    StarwiseError
        The file cannot be read or is not TOML; a key is unknown; a value does not fit.
    """
    data: dict[str, Any] = {}
    if path is not None:
        data = read_toml(Path(path))
        try:
            RunConfig.from_dict(data, file=str(path))
        except StarwiseError as error:
            raise _with_line(error, Path(path)) from None
    return RunConfig.from_dict(_merged(data, _nested(options or {})))


def read_toml(path: Path) -> dict[str, Any]:
    """Contents of a TOML file; `StarwiseError` with the line where it cannot be read or is not TOML."""
    import tomllib

    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StarwiseError(f"cannot be read ({error.strerror})", file=path) from None
    except UnicodeDecodeError:
        raise StarwiseError("not a text file", file=path, wanted="TOML in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        text = str(error)
        at = re.search(r" \(at line (\d+), column \d+\)", text)
        raise StarwiseError(
            f"not TOML: {text.replace(at.group(0), '') if at else text}",
            file=path,
            line=int(at.group(1)) if at else None,
        ) from None


def _checked_class(hint: Any) -> type[Checked] | None:
    return hint if isinstance(hint, type) and issubclass(hint, Checked) else None


def _checked(value: Any, hint: Any, key: str) -> Any:
    """``value`` converted to the type ``hint``, or a `StarwiseError` naming ``key``."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        if value is None and type(None) in args:
            return None
        return _checked(value, next(arg for arg in args if arg is not type(None)), key)
    if origin is Annotated:
        number = _checked(value, args[0], key)
        for limit in args[1:]:
            if isinstance(limit, Range) and not limit.holds(number):
                raise StarwiseError(f"'{key}' is outside its limits", found=str(value), wanted=str(limit))
        return number
    if origin is Literal:
        if value not in args or isinstance(value, bool):
            raise StarwiseError(f"'{key}' has no such choice", found=str(value), wanted=" | ".join(args))
        return value
    if origin is tuple:
        if isinstance(value, str) or not isinstance(value, list | tuple):
            raise StarwiseError(f"'{key}' is a list", found=str(value), wanted="a list")
        tables = _checked_class(args[0]) is not None
        return tuple(_checked(v, args[0], f"{key}[{i}]" if tables else key) for i, v in enumerate(value, 1))
    if origin is dict:
        if not isinstance(value, Mapping):
            raise StarwiseError(f"'{key}' is a table", found=str(value), wanted="a table of lists")
        return {_checked(k, args[0], key): _checked(v, args[1], f"{key}.{k}") for k, v in value.items()}
    return _checked_plain(value, hint, key)


def _checked_plain(value: Any, hint: Any, key: str) -> Any:
    inner = _checked_class(hint)
    if inner is not None:
        if isinstance(value, Mapping):
            return inner.from_dict(value, prefix=f"{key}.")
        if isinstance(value, inner):
            return value
    if hint is float:
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
        raise StarwiseError(f"'{key}' is a number", found=str(value), wanted="a finite number")
    if hint is str and hasattr(value, "isoformat"):
        return str(value.isoformat())  # TOML has dates of its own
    if type(value) is hint:
        return value
    wanted = {bool: "true or false", int: "a whole number", str: "text"}.get(hint, "a table")
    raise StarwiseError(f"'{key}' has the wrong type", found=str(value), wanted=wanted)


def _plain(value: Any) -> Any:
    if isinstance(value, Checked):
        return {item.name: _plain(getattr(value, item.name)) for item in dataclasses.fields(value)}  # type: ignore[arg-type]
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, tuple) else value


def _nested(options: Mapping[str, Any]) -> dict[str, Any]:
    """``{"process.model": x}`` as ``{"process": {"model": x}}``."""
    out: dict[str, Any] = {}
    for key, value in options.items():
        head, dot, rest = key.partition(".")
        if dot:
            inner = out.setdefault(head, {})
            if not isinstance(inner, dict):
                raise StarwiseError("configuration key given as a value and as a table", found=key)
            out[head] = _merged(inner, _nested({rest: value}))
        else:
            out[key] = value
    return out


def _merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    out = dict(base)
    for key, value in over.items():
        both = isinstance(value, Mapping) and isinstance(out.get(key), Mapping)
        out[key] = _merged(out[key], value) if both else value
    return out


def _with_file(error: StarwiseError, file: str | None) -> StarwiseError:
    return StarwiseError(
        error.message, file=error.file or file, line=error.line, found=error.found, wanted=error.wanted
    )


def _with_line(error: StarwiseError, path: Path) -> StarwiseError:
    """The error with the line of its key, where the text of the file shows it."""
    key = re.search(r"'([\w.]+)'", error.message)
    name = (key.group(1) if key else error.found or "").rpartition(".")[2]
    lines = path.read_text(encoding="utf-8").splitlines()
    at = [i for i, text in enumerate(lines, 1) if name and re.match(rf"\s*\[?['\"]?{re.escape(name)}\b", text)]
    return StarwiseError(
        error.message,
        file=error.file,
        line=at[0] if len(at) == 1 else None,
        found=error.found,
        wanted=error.wanted,
    )
