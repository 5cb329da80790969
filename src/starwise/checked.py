"""Configuration dataclasses that check themselves: the machinery behind `starwise.config` and scenarios.

An unknown key, a wrong type or a value outside its limits is a `StarwiseError` that names the key.
"""

import dataclasses
import difflib
import math
import re
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from starwise.errors import StarwiseError

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
        hints = _hints(type(self))
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
        hints = _hints(cls)
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
                raise with_file(error, file) from None
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
            raise with_file(error, file) from None

    def to_dict(self) -> dict[str, Any]:
        """Nested plain values (lists, numbers, text, None), ready for JSON."""
        plain = _plain(self)
        assert isinstance(plain, dict)
        return plain

    def with_options(self: C, options: Mapping[str, Any]) -> C:
        """Copy with options changed; keys of inner tables are written with a dot (``process.tau_s``)."""
        return type(self).from_dict(merged(self.to_dict(), nested(options)))


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


_HINTS: dict[type, dict[str, Any]] = {}


def _hints(cls: type) -> dict[str, Any]:
    """Types of the fields of a class, looked up once: that takes longer than all else of a check."""
    if cls not in _HINTS:
        _HINTS[cls] = typing.get_type_hints(cls, include_extras=True)
    return _HINTS[cls]


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
            raise StarwiseError(
                f"'{key}' is a list", found=str(value), wanted=f"[{value!r}]?" if isinstance(value, str) else "a list"
            )
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


def nested(options: Mapping[str, Any]) -> dict[str, Any]:
    """``{"process.model": x}`` as ``{"process": {"model": x}}``."""
    out: dict[str, Any] = {}
    for key, value in options.items():
        head, dot, rest = key.partition(".")
        if dot:
            inner = out.setdefault(head, {})
            if not isinstance(inner, dict):
                raise StarwiseError("configuration key given as a value and as a table", found=key)
            out[head] = merged(inner, nested({rest: value}))
        else:
            out[key] = value
    return out


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Nested mappings, the second over the first."""
    out = dict(base)
    for key, value in over.items():
        both = isinstance(value, Mapping) and isinstance(out.get(key), Mapping)
        out[key] = merged(out[key], value) if both else value
    return out


def with_file(error: StarwiseError, file: str | None) -> StarwiseError:
    """The error with its file, unless it names one."""
    return StarwiseError(
        error.message, file=error.file or file, line=error.line, found=error.found, wanted=error.wanted
    )


def with_line(error: StarwiseError, path: Path) -> StarwiseError:
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
