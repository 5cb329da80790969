"""A picture of a solution: its track, and its errors against what it claims. Plain SVG, no library."""

from collections.abc import Iterable
from html import escape

import numpy as np
from numpy.typing import NDArray

from starwise.analysis.accuracy import match
from starwise.constants import EPOCH_COASTED, EPOCH_NO_SOLUTION, EPOCH_SUSPECT
from starwise.frames import enu_from_ecef, rotations_ne_enu
from starwise.frames import geodetic_from_ecef as geodetic
from starwise.types import Solution, Truth

F8 = NDArray[np.float64]
Point = tuple[float, float]
_WIDTH, _TRACK, _PANEL, _MARGIN = 820.0, 460.0, 90.0, 56.0
_STYLE = (
    "text{font:12px sans-serif;fill:#333}.t{font-size:15px}.axis{stroke:#999;fill:none}"
    ".truth{stroke:#bbb;stroke-width:4;fill:none}.est{stroke:#1f6fb4;stroke-width:1.3;fill:none}"
    ".claim{fill:#1f6fb4;fill-opacity:.15}.flag{fill:#d33}"
)


def track_svg(solution: Solution, truth: Truth | None = None, *, title: str = "starwise") -> str:
    """Track (east, north) and, with a truth, the errors in time with the 2-sigma band that the solution claims."""
    keep = solution.has_position & (solution.status != EPOCH_NO_SOLUTION)
    body: list[str] = []
    height = _TRACK
    if keep.any():
        origin = np.median(solution.pos_e[keep], axis=0)
        body += _track(solution, keep, truth, origin)
        if truth is not None:
            body += _errors(solution, truth)
            height += 3 * _PANEL + 40
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:g} {height:g}"><style>{_STYLE}</style>'
        f'<rect width="100%" height="100%" fill="#fff"/><text class="t" x="16" y="24">{escape(title)}</text>'
        + "".join(body)
        + "</svg>\n"
    )


def _track(solution: Solution, keep: NDArray[np.bool_], truth: Truth | None, origin: F8) -> list[str]:
    enu = enu_from_ecef(solution.pos_e[keep], origin)[:, :2]
    true = np.empty((0, 2))
    if truth is not None and truth.t_ns is not None:
        true = enu_from_ecef(truth.pos_e, origin)[:, :2]
    everything = np.concatenate([enu, true])
    low, high = np.percentile(everything, 0.5, axis=0), np.percentile(everything, 99.5, axis=0)
    span = max(float((high - low).max()), 1.0) * 1.15
    middle = (low + high) / 2
    scale = (_TRACK - 2 * _MARGIN) / span

    def place(points: F8) -> list[Point]:
        x = _WIDTH / 2 + (points[:, 0] - middle[0]) * scale
        y = _TRACK / 2 - (points[:, 1] - middle[1]) * scale
        inside = (np.abs(x - _WIDTH / 2) < _WIDTH / 2) & (np.abs(y - _TRACK / 2) < _TRACK / 2 - 30)
        return list(zip(x[inside].tolist(), y[inside].tolist(), strict=True))

    flagged = np.isin(solution.status[keep], (EPOCH_SUSPECT, EPOCH_COASTED))
    decade = 10.0 ** np.floor(np.log10(span / 3))
    length = max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= span / 3)
    x1 = _MARGIN + length * scale
    return [
        _line(place(true), "truth"),
        _line(place(enu), "est"),
        *(f'<circle class="flag" cx="{x:.1f}" cy="{y:.1f}" r="2"/>' for x, y in place(enu[flagged])),
        f'<path class="axis" d="M{_MARGIN:g} {_TRACK - 30:g}H{x1:.1f}"/>',
        f'<text x="{_MARGIN:g}" y="{_TRACK - 36:g}">{length:g} m</text>',
        f'<text text-anchor="end" x="{_WIDTH - 16:g}" y="24">grey: truth, blue: estimate, '
        "red: flagged (suspect or coasted)</text>",
    ]


def _errors(solution: Solution, truth: Truth) -> list[str]:
    matched = match(solution, truth)
    if not len(matched.at):
        return []
    llh = geodetic(solution.pos_e[matched.at])
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])
    cov = C @ solution.cov_pos[matched.at] @ C.transpose(0, 2, 1)
    t_s = (solution.t_ns[matched.at] - solution.t_ns[0]) / 1e9
    x = _MARGIN + t_s / max(float(t_s[-1]), 1.0) * (_WIDTH - 1.9 * _MARGIN)
    out: list[str] = []
    for i, name in enumerate(("east", "north", "up")):
        error, band = matched.error_n[:, i], 2 * np.sqrt(cov[:, i, i])
        # Errors in full but for a few outliers; the band of a long coasted stretch may leave the panel.
        widest = max(np.percentile(np.abs(error), 99.5), np.percentile(np.nan_to_num(band), 90))
        limit = max(float(widest) * 1.1, 0.01)
        zero = _TRACK + 20 + _PANEL * (i + 0.5)
        unit = (_PANEL - 14) / 2 / limit

        def at(values: F8, zero: float = zero, unit: float = unit, limit: float = limit) -> list[Point]:
            y = zero - np.clip(np.nan_to_num(values), -limit, limit) * unit
            return list(zip(x.tolist(), y.tolist(), strict=True))

        out += [
            f'<polygon class="claim" points="{_points([*at(band), *reversed(at(-band))])}"/>',
            f'<path class="axis" d="M{_MARGIN:g} {zero:g}H{x[-1]:.1f}"/>',
            _line(at(error), "est"),
            f'<text x="8" y="{zero + 4:g}">{name}</text>',
            f'<text text-anchor="end" x="{_WIDTH - 6:g}" y="{zero - limit * unit + 8:.1f}">{limit:.1f} m</text>',
        ]
    out.append(
        f'<text x="{_MARGIN:g}" y="{_TRACK + 3 * _PANEL + 34:g}">errors over {t_s[-1]:.0f} s; '
        "band: 2 sigma as claimed</text>"
    )
    return out


def _line(points: Iterable[Point], css: str) -> str:
    return f'<polyline class="{css}" points="{_points(points)}"/>'


def _points(points: Iterable[Point]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
