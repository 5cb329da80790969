"""Options of the command line converted without pydantic, which typer loads for that: 0.1 s of every start.

Plain texts, paths, numbers and flags, and lists of them, are converted here; a value that does not fit, and every
other kind of option, is left to typer, which words the error.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args, get_origin

_SPECIAL = ("parser", "click_type", "exists", "resolve_path", "allow_dash", "min", "max")
"""What a parameter may ask for beyond its type."""


@dataclass(frozen=True)
class _Plain:
    """What typer asks of an option: its value converted, or its own converter's error."""

    kind: type
    listed: bool
    made_by_typer: Any

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """Converted value; None and nothing stay what they are."""
        several = param.multiple or param.nargs == -1
        if value is None:
            return () if several else None
        try:
            if self.listed:
                return [self._one(item) for item in value] if isinstance(value, list | tuple) else [self._one(value)]
            return self._one(value)
        except (TypeError, ValueError):
            return self.made_by_typer().coerce(value, param, ctx)

    def _one(self, value: Any) -> Any:
        if isinstance(value, self.kind):
            return value
        if self.kind is bool or not isinstance(value, str):
            raise TypeError
        return self.kind(value)


def without_pydantic() -> None:
    """Make typer convert plain options by `_Plain`; does nothing with a typer that works otherwise."""
    try:
        from typer import core

        build = core.build_runtime_param  # type: ignore[attr-defined]
    except (ImportError, AttributeError):
        return

    def build_plain(descriptor: Any) -> Any:
        annotation, info = descriptor.annotation, descriptor.parameter_info
        listed = get_origin(annotation) is list
        kind = get_args(annotation)[0] if listed else annotation
        special = any(getattr(info, name, None) not in (None, False) for name in _SPECIAL)
        if kind not in (str, Path, int, float, bool) or special:
            return build(descriptor)
        return _Plain(kind, listed, lambda: build(descriptor))

    core.build_runtime_param = build_plain  # type: ignore[attr-defined]
