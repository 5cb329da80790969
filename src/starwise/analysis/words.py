"""Paragraphs of limited width; states by words, not by the names that they have in tables."""

import re
import textwrap
from collections.abc import Sequence
from typing import Final

WIDTH: Final = 79
STATES: Final = {
    "pos": "position", "vel": "velocity", "acc": "acceleration", "att": "attitude", "head": "heading",
    "clk": "clock", "isb": "clock offsets of systems", "drift": "clock drift", "isd": "drifts of those offsets",
    "bg": "gyro bias", "ba": "accelerometer bias",
}  # fmt: skip
"""Groups of states, by the first part of their names."""
_AXES: Final = {"e": "east", "n": "north", "u": "up", "d": "down"}
_NAME: Final = re.compile(r"\b(pos|vel|acc|att|clk|isb|drift|isd|bg|ba)\.(\w+)\b")


def paragraph(parts: Sequence[str]) -> str:
    """Sentences as lines of up to `WIDTH` columns, each part from a line of its own."""
    return "\n".join(textwrap.fill(part, WIDTH, break_long_words=False) for part in parts)


def spoken(name: str) -> str:
    """A direction of the state in words: ``pos.u + 0.89 clk.G`` is ``up + 0.89 clock of G``."""
    return _NAME.sub(_word, name)


def _word(found: re.Match[str]) -> str:
    stem, part = found.groups()
    if stem == "pos":
        return _AXES.get(part, part)
    if stem == "isb":
        return f"clock offset of {part}"
    if stem == "isd":
        return f"drift of {part}'s clock offset"
    if stem in ("clk", "drift"):
        return f"{STATES[stem]} of {part}"
    return f"{STATES[stem]} {_AXES.get(part, part)}"
