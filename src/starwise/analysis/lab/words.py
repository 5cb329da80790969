"""The laboratory's judgement in plain words."""

import math
import textwrap
from typing import TYPE_CHECKING, Final

from starwise.analysis.lab.case import num
from starwise.analysis.lab.checks import MIN_ROWS

if TYPE_CHECKING:
    from starwise.analysis.lab.consistency import Consistency

WIDTH: Final = 79
MOST: Final = 8
"""Findings told in full."""


def verdict(c: "Consistency") -> str:
    """One line."""
    if c.grade == "unknown":
        return "not judged: nothing to judge by"
    if c.grade == "consistent":
        return "consistent: nothing provably wrong at 5 %"
    first = next((f for f in c.findings if f.matters), c.findings[0] if c.findings else None)
    if c.grade == "nearly":
        what = "" if first is None else f" ({first.words.rstrip('.')})"
        return f"nearly consistent: provably off, but hardly by what matters{what}"
    assert first is not None
    if c.grade == "cautious":
        p = c.positions
        if p is not None and p.nees > 1.0:  # against the truth; too few independent epochs to prove it
            seen = f"position errors are {num(math.sqrt(p.nees))} times as large as claimed"
            return f"cautious by its innovations alone, {seen}: {first.words.rstrip('.')}"
        return f"cautious: {first.words.rstrip('.')}"
    return f"not consistent: {first.words.rstrip('.')}"


def explain(c: "Consistency") -> str:
    """Several lines of at most `WIDTH` columns."""
    lines = _wrapped(verdict(c)[:1].upper() + verdict(c)[1:] + ".")
    for row in c.by_sensor:
        lasts = (
            "" if not math.isfinite(row["rho_1"]) else f", correlation {row['rho_1']:+.2f} from one epoch to the next"
        )
        what = f"innovations, NIS {num(row['nis'])} per degree of freedom (1 expected)"
        if c.table is not None and c.table.residuals:  # less than 1 by the fit, or 1 where a program gives no sigmas
            what = f"residuals of a fit, mean square {num(row['nis'])} of the variance they were taken to have"
        lines += _wrapped(f"{row['name']}: {row['used']} {what}{lasts}.")
    p = c.positions
    if p is not None and p.reference == "truth":
        held = (
            "" if p.inside is None else f"; the truth is inside 95 % regions in {100.0 * p.inside[2]:.0f} % of epochs"
        )
        lines += _wrapped(
            f"position: NEES {num(p.nees)} per degree of freedom, {num(p.nees_low)} to {num(p.nees_high)} if honest "
            f"({p.epochs} epochs are worth {p.independent:.0f}, because errors last){held}."
        )
    matter = [f for f in c.findings if f.matters]
    for number, finding in enumerate(matter[:MOST], 1):
        lines += _wrapped(f"{number}. {finding.words} {finding.cure}", "   ")
    if len(matter) > MOST:
        lines += _wrapped(f"And {len(matter) - MOST} more.")
    slight = [f for f in c.findings if not f.matters]
    if slight:
        lines += _wrapped("Provable but slight: " + " ".join(f.words for f in slight[:3]))
    if c.tuning is not None:
        said = ", ".join(f"{key} = {value}" for key, value in c.tuning.settings.items())
        lines += _wrapped(f"Suggested: {said}.")
    if c.grade == "unknown" and c.table is not None and c.table.n:
        lines += _wrapped(f"Not judged: innovations: fewer than {MIN_ROWS} used of every channel, nothing is proved.")
    for text in c.not_judged:
        lines += _wrapped(f"Not judged: {text}.")
    return "\n".join(lines)


def _wrapped(text: str, indent: str = "  ") -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent=indent, break_long_words=False) or [""]
