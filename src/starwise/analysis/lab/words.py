"""The laboratory's judgement in plain words."""

import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from starwise.analysis.lab.consistency import Consistency

WIDTH = 79


def verdict(c: "Consistency") -> str:
    """One line."""
    if c.grade == "unknown":
        return "not judged: nothing to judge by"
    if c.grade == "consistent":
        return "consistent: nothing is wrong at 5 %"
    first = next((f for f in c.findings if f.matters), c.findings[0] if c.findings else None)
    if c.grade == "nearly":
        what = "" if first is None else f" ({first.words.rstrip('.')})"
        return f"nearly consistent: provably off, but hardly by what matters{what}"
    assert first is not None
    return f"not consistent: {first.words.rstrip('.')}"


def explain(c: "Consistency") -> str:
    """Several lines of at most `WIDTH` columns."""
    lines = _wrapped(verdict(c)[:1].upper() + verdict(c)[1:] + ".")
    if c.table is not None:
        for row in c.by_sensor:
            lines += _wrapped(
                f"{row['name']}: {row['used']} innovations, NIS {row['nis']:.3g} per degree of freedom (1 expected), "
                f"correlation {row['rho_1']:+.2f} from one epoch to the next."
            )
    if c.positions is not None and c.positions.reference == "truth":
        p = c.positions
        lines += _wrapped(
            f"position: NEES {p.nees:.3g} per degree of freedom, {p.nees_low:.2g} to {p.nees_high:.2g} if honest "
            f"({p.epochs} epochs are worth {p.independent:.0f}: errors last)."
        )
    for number, finding in enumerate(c.findings, 1):
        lines += _wrapped(f"{number}. {finding.words} {finding.cure}", "   ")
    for text in c.not_judged:
        lines += _wrapped(f"Not judged: {text}.")
    return "\n".join(lines)


def _wrapped(text: str, indent: str = "  ") -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent=indent, break_long_words=False) or [""]
