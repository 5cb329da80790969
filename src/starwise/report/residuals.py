"""Screen of ``starwise assess`` for residuals of other programs."""

from collections.abc import Mapping
from typing import Any

_PER_LINE = 2
_MOST = 60


def residual_lines(consistency: Mapping[str, Any]) -> list[str]:
    """What the laboratory found, and a cell per satellite: bias, relative size, correlation from epoch to epoch.

    Parameters
    ----------
    consistency : mapping
        ``consistency`` of ``starwise assess --json`` for a file with residuals.
    """
    lines = ["residuals", *consistency["explanation"].splitlines()]
    rows = [row for row in consistency.get("satellites", ()) if row["used"]][:_MOST]
    if not rows:
        return lines
    head = f"{'satellite':10}{'rows':>7}{'bias':>8}{'size':>7}{'lag 1':>7}"
    lines += ["", "  ".join([head] * min(_PER_LINE, len(rows)))]
    cells = [
        f"{row['name']:10}{row['used']:7d}{_cell(row['bias'], 8)}{_cell(_root(row['nis']), 7)}{_cell(row['rho_1'], 7)}"
        for row in rows
    ]
    half = -(-len(cells) // _PER_LINE)
    lines += ["  ".join(cells[i::half]) for i in range(half)]
    lines += [
        "bias: mean, m; size: over what the weights expect, 1 on average;",
        "lag 1: correlation of successive epochs",
    ]
    return lines


def _root(value: float | None) -> float | None:
    return None if value is None or value < 0.0 else value**0.5


def _cell(value: float | None, width: int) -> str:
    return f"{'-':>{width}}" if value is None else f"{value:{width}.2f}"
