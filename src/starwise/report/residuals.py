"""Screen of ``starwise assess`` for residuals of other programs."""

from collections.abc import Mapping
from typing import Any

_PER_LINE = 2
_MOST = 60


def size_lines(sizes: Mapping[str, Any]) -> list[str]:
    """How many residuals, and how large, in words of at most 79 columns.

    Parameters
    ----------
    sizes : mapping
        ``sizes`` of the same.
    """
    lines = [f"{sizes['rows']} residuals of {sizes['satellites']} satellites in {sizes['epochs']} epochs"]
    for kind in ("code", "phase"):
        if sizes[f"{kind}_rms_m"] is not None:
            lines.append(f"{kind}: RMS {sizes[f'{kind}_rms_m']:.3f} m")
    if sizes["zenith_sigma_m"] is not None:
        lines += [
            f"error of a code at the zenith: {sizes['zenith_sigma_m']:.2f} m, {sizes['claimed_ratio']:.2f} x what "
            "RTKLIB's options claim",
            "  (less the variances of ephemeris and ionosphere, which are in no file)",
        ]
    return lines


def residual_lines(consistency: Mapping[str, Any]) -> list[str]:
    """Sizes, and a cell per satellite: bias, relative size, correlation from epoch to epoch.

    Parameters
    ----------
    consistency : mapping
        ``consistency`` of ``starwise assess --json`` for a file with residuals.
    """
    lines = ["residuals", *size_lines(consistency["sizes"])]
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
