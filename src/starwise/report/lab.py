"""What ``starwise assess`` says of consistency, observability, stability and what-if, in at most 80 columns."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, Final

WIDTH: Final = 80
LABEL: Final = 15
NAME: Final = 17
GROUPS: Final = {
    "pos": ("position, 3D", "m"), "vel": ("velocity, 3D", "m/s"), "acc": ("acceleration", "m/s2"),
    "att": ("attitude", "rad"), "clk": ("clock", "m"), "isb": ("inter-system", "m"), "drift": ("clock drift", "m/s"),
    "bg": ("gyro bias", "rad/s"), "ba": ("accel. bias", "m/s2"),
}  # fmt: skip
"""States shown in the table of observability, by the first part of their names."""
COLUMNS: Final = {
    "east": "east",
    "north": "north",
    "up": "up",
    "velocity": "veloc.",
    "clock": "clock",
    "heading": "heading",
}
"""Sigmas shown in the table of what-if."""


def lab_text(report: Mapping[str, Any]) -> str:
    """Screen of the laboratory's parts in a report of ``starwise.assess``; empty if it has none."""
    blocks = []
    if report.get("consistency"):
        blocks.append(_part("consistency", _words(report["consistency"])))
    seen = report.get("observability")
    if seen:
        blocks.append([*_part("observability", _words(seen)), *_state_table(seen)])
    if report.get("stability"):
        blocks.append(_part("stability", _words(report["stability"])))
    if report.get("what_if"):
        blocks.append(_what_if(report["what_if"]))
    return "\n\n".join("\n".join(lines) for lines in blocks)


def _words(part: Mapping[str, Any]) -> str:
    return str(part.get("explain") or part.get("explanation") or part.get("verdict") or "")


def _part(label: str, text: str) -> list[str]:
    """Paragraphs under a label; a line that begins with a space belongs to the one before."""
    paragraphs: list[str] = []
    for line in text.splitlines():
        if paragraphs and (line.startswith(" ") or _goes_on(paragraphs[-1])):
            paragraphs[-1] += " " + line.strip()
        else:
            paragraphs.append(line.strip())
    lines: list[str] = []
    for paragraph in paragraphs:
        clean = "".join(ch if ch.isprintable() else "?" for ch in paragraph)
        lines += textwrap.wrap(clean, WIDTH - LABEL, subsequent_indent="  ", break_long_words=False)
    return [f"{label if k == 0 else '':<{LABEL}}{line}" for k, line in enumerate(lines)]


def _goes_on(paragraph: str) -> bool:
    """A line that a paragraph goes on after: it does not end a sentence."""
    return not paragraph.endswith((".", "!", "?", ")"))


def _state_table(part: Mapping[str, Any]) -> list[str]:
    """Sigmas at the end of a window, with and without measurements, by groups of states."""
    states = part.get("states") or {}
    rows = []
    for stem, (label, unit) in GROUPS.items():
        members = [v for name, v in states.items() if name.partition(".")[0] == stem]
        if not members:
            continue
        with_it, without = (_size([m[key] for m in members]) for key in ("sigma", "sigma_free"))
        if with_it is None or without is None:
            continue
        degree = 1.0 - with_it / without if without > 0.0 else math.nan
        rows.append(f"{'':{LABEL}}{label:<16}{with_it:>11.3g} {unit:<6}{without:>11.3g} {unit:<6}{degree:>9.4f}")
    if not rows:
        return []
    head = f"{'':{LABEL}}{'sigma, 1 window':<16}{'measured':>11} {'':<6}{'unmeasured':>11} {'':<6}{'degree':>9}"
    return [head, *rows]


def _size(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return math.sqrt(sum(v * v for v in known)) if len(known) == len(values) else None


def _what_if(part: Mapping[str, Any]) -> list[str]:
    """A line per change: per cent of the sigmas, and what becomes observable."""
    base = part["as_it_was"]["sigma"]
    keys = [key for key in COLUMNS if base.get(key) is not None]
    lines = [f"{'what if':<{LABEL}}{'sigmas, m, rad':<{NAME}}" + "".join(f"{COLUMNS[key]:>8}" for key in keys)]
    lines.append(f"{'':{LABEL}}{'as it was':<{NAME}}" + "".join(f"{base[key]:>8.3g}" for key in keys))
    for outcome in part["outcomes"]:
        name = outcome["change"]
        if " + " in name:
            name = "all of it"
        cells = "".join(f"{_change(outcome['sigma_change'].get(key)):>8}" for key in keys)
        lines.append(f"{'':{LABEL}}{name[: NAME - 1]:<{NAME}}{cells}")
        gained = outcome["becomes_observable"]
        lost = outcome["becomes_unobservable"]
        notes = [f"now observable: {'; '.join(gained[:2])}"] if gained else []
        notes += [f"no longer observable: {'; '.join(lost[:2])}"] if lost else []
        notes += [outcome["note"]] if outcome.get("note") else []
        for note in notes if name != "all of it" else notes[: len(notes) - bool(outcome.get("note"))]:
            lines += [f"{'':{LABEL}}  {text}" for text in textwrap.wrap(note, WIDTH - LABEL - 2)]
    return lines


def _change(value: float | None) -> str:
    if value is None:
        return "-"
    if abs(value) < 0.005:
        return "="
    return f"{100.0 * value:+.0f} %" if value < 9.0 else f"x {1.0 + value:.3g}"
