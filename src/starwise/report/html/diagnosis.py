"""What an assessment found, for a page: verdicts in words, numbers, and the series behind them."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from starwise.report.html.tables import worded

PARTS = ("consistency", "observability", "stability", "what_if")
_SAID = ("verdict", "explain", "explanation", "text", "grade")


def findings(assessment: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """Consistency, observability, stability and what-if: verdict, words, numbers, and the panels to be drawn."""
    drawn = lab_payload(assessment)
    panels = {
        "observability": [("obs-degree", "degree"), ("obs-sigma", "sigma")],
        "stability": [("stab-product", "product")],
    }
    out = []
    for key in PARTS:
        part = (assessment or {}).get(key)
        if not part:
            continue
        if not isinstance(part, Mapping):
            part = {"rows": part}
        out.append({
            "key": key,
            "title": key.replace("_", "-").capitalize(),
            "verdict": str(part.get("verdict", "")),
            "text": paragraphs(str(part.get("explain") or part.get("explanation") or part.get("text") or "")),
            "rows": _scalars([(name, value) for name, value in part.items() if name not in _SAID]),
            "panels": [panel for panel, needed in panels.get(key, ()) if needed in drawn],
        })  # fmt: skip
    return out


def paragraphs(text: str) -> list[str]:
    """Text that was broken for a terminal, in whole paragraphs: one for each sentence that began a line."""
    out: list[str] = []
    for line in text.splitlines():
        new = not line.startswith("  ") and (not out or out[-1].endswith((".", ":")) or re.match(r"\d+\. ", line))
        if new and line.strip():
            out.append(line.strip())
        elif line.strip():
            out[-1:] = [f"{out[-1]} {line.strip()}" if out else line.strip()]
    return out


def lab_payload(assessment: Mapping[str, Any] | None) -> dict[str, Any]:
    """Series of an assessment: degree of observability per state, sigma of single epochs, decay of disturbances."""
    out: dict[str, Any] = {}
    observability = _mapping(assessment, "observability")
    states = _mapping(observability, "states")
    rows = [(name, item) for name, item in states.items() if isinstance(item, Mapping) and _number(item.get("degree"))]
    if rows:
        out["degree"] = {
            "names": [name for name, _ in rows],
            "degree": [item["degree"] for _, item in rows],
            "sigma": [item.get("sigma") for _, item in rows],
            "free": [item.get("sigma_free") for _, item in rows],
        }
    epochs = _mapping(observability, "epochs")
    if _numbers(epochs.get("epoch")) and _numbers(epochs.get("sigma_m"), len(epochs["epoch"])):
        out["sigma"] = {"epoch": epochs["epoch"], "sigma_m": epochs["sigma_m"]}
    stability = _mapping(assessment, "stability")
    product, other = stability.get("product_norm"), stability.get("product_norm_P")
    if _numbers(product) and _number(stability.get("seconds")) and isinstance(product, list) and len(product) > 1:
        if isinstance(other, list) and _numbers(other, len(product)):  # the larger, as the words say
            product = [max(a, b) if _number(a) and _number(b) else None for a, b in zip(product, other, strict=True)]
        out["product"] = {"norm": product, "seconds": stability["seconds"]}
    return out


def _mapping(record: Mapping[str, Any] | None, key: str) -> Mapping[str, Any]:
    value = (record or {}).get(key)
    return value if isinstance(value, Mapping) else {}


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _numbers(value: Any, length: int | None = None) -> bool:
    """Whether a value is a list with a number in it, and of a length."""
    if not isinstance(value, list) or not any(_number(item) for item in value):
        return False
    return length is None or len(value) == length


def _scalars(rows: list[tuple[str, Any]]) -> list[tuple[str, str]]:
    """Numbers and words of a record; long series are left to the JSON file."""
    out = []
    for name, value in rows:
        if isinstance(value, Mapping):
            out += [(f"{name}.{key}", text) for key, text in _scalars(list(value.items()))]
        elif isinstance(value, list | tuple):
            if len(value) <= 12 and all(isinstance(item, str | int | float) for item in value):
                out.append((name, ", ".join(_short(item) for item in value)))
        elif value is not None:
            out.append((name, _short(value)))
    return out


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) and np.isfinite(value) else worded(value)
