"""Nested records as rows of a key and a value in words."""

from collections.abc import Mapping
from typing import Any


def settings(provenance: Mapping[str, Any]) -> list[tuple[str, list[tuple[str, str]]]]:
    """Configuration as given and as it came into effect: tables of (key, value)."""
    out = []
    for title, key in (
        ("Configuration as given", "config"),
        ("In effect, from presets and tables", "effective"),
        ("Motion, as found", "dynamics"),
    ):
        value = provenance.get(key)
        if isinstance(value, Mapping) and value:
            out.append((title, flattened(value)))
    return out


def station(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What the observation file says of its station."""
    rows = flattened(provenance.get("station") or {})
    return [(key, value) for key, value in rows if value not in ("default", "", "none")]


def input_row(item: Mapping[str, Any]) -> dict[str, str]:
    """An input: kind, path, size in words, SHA-256."""
    size = item.get("bytes")
    return {
        "kind": str(item.get("kind", "input")),
        "path": str(item.get("path", item.get("file", ""))),
        "size": "" if size is None else f"{size / 1e6:.2f} MB",
        "sha256": str(item.get("sha256", "")),
    }


def flattened(value: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Nested tables as dotted keys with their values in words."""
    rows: list[tuple[str, str]] = []
    for key, item in value.items():
        if isinstance(item, Mapping) and item:
            rows += flattened(item, f"{prefix}{key}.")
        else:
            rows.append((f"{prefix}{key}", worded(item)))
    return rows


def worded(item: Any) -> str:
    """A value in words."""
    if item is None:
        return "default"
    if isinstance(item, bool):
        return "yes" if item else "no"
    if isinstance(item, float):
        return f"{item:.9g}"
    if isinstance(item, list | tuple):
        return ", ".join(worded(i) for i in item) or "none"
    return str(item)
