"""The track with its ellipses, and errors in the bands that the solution claims."""

import math
from dataclasses import dataclass
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from starwise.analysis.accuracy import Matched, match
from starwise.constants import EPOCH_COASTED, EPOCH_NO_SOLUTION, EPOCH_RESET, EPOCH_SUSPECT
from starwise.errors import StarwiseError
from starwise.frames import C_ne_enu, enu_from_ecef, geodetic_from_ecef, rotations_ne_enu
from starwise.report.figures_style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RC,
    SKY,
    VERMILION,
    Picture,
    broken,
    picture,
    thinned,
    time_axis,
)
from starwise.types import F8, Solution, Truth

ELLIPSE_95: Final = math.sqrt(5.991464547107979)
"""Half axes of the 95 % ellipse in sigmas: root of the chi-square point with 2 degrees of freedom."""
FLAGGED: Final = ((EPOCH_COASTED, "coasted", ORANGE, "v"), (EPOCH_SUSPECT, "suspect", VERMILION, "x"),
                  (EPOCH_RESET, "started anew", GREEN, "D"))  # fmt: skip
_ROUND: Final = (1.0, 2.0, 5.0)


def track(
    solution: Solution, truth: Truth | None, columns: int, ellipses: int | None, enlarge: float | None
) -> Picture:
    """See `starwise.report.figures.Plots.track`."""
    keep = np.flatnonzero(solution.has_position & (solution.status != EPOCH_NO_SOLUTION))
    if not len(keep):
        raise StarwiseError("no epoch with a position: nothing to draw")
    point = truth is not None and truth.t_ns is None
    origin = truth.pos_e if truth is not None and point else np.median(solution.pos_e[keep], axis=0)
    enu = enu_from_ecef(solution.pos_e[keep], origin)
    true = np.zeros((1, 2)) if truth is None or point else enu_from_ecef(truth.pos_e, origin)[:, :2]
    points = enu[:, :2] if truth is None else np.concatenate([enu[:, :2], true])
    shapes = _ellipses(solution, keep, origin, 12 if ellipses is None else ellipses)
    low, high = _extent(points)
    if ellipses is None and shapes.size.max() > 0.5 * (high - low).max():
        shapes = _ellipses(solution, keep, origin, 3)  # they lie on each other
    factor = enlarge or _enlargement(float(shapes.size.max()), float((high - low).max()))
    if factor == 1.0:  # a receiver at rest: what is claimed is wider than what is seen
        middle = np.median(points, axis=0)
        low, high = np.minimum(low, middle - 1.2 * shapes.size), np.maximum(high, middle + 1.2 * shapes.size)
    outside = int(((points < low) | (points > high)).any(axis=1).sum())
    with matplotlib.rc_context(RC):
        wide = 68.0 if columns == 1 else 160.0
        figure = picture(columns, min(wide * float((high - low)[1] / (high - low)[0]), 1.2 * wide, 110.0) + 32.0)
        ax = figure.add_subplot()
        if truth is not None and not point:
            ax.plot(*_line(truth.t_ns, true), color=GREY, lw=2.4, solid_capstyle="round", label="truth", gid="truth")
        elif point:
            ax.plot(0.0, 0.0, "+", color=BLACK, ms=9, mew=1.4, zorder=6, label="truth", gid="truth")
        few = len(keep) <= 200
        ax.plot(*_line(solution.t_ns[keep], enu), color=BLUE, marker="." if few else None, ms=3, label="estimate",
                gid="estimate", zorder=3)  # fmt: skip
        _ends(ax, enu)
        _flags(ax, solution.status[keep], enu[:, 0], enu[:, 1])
        _frame(ax, low, high, origin)
        _draw_ellipses(ax, shapes, enu, factor)
        if outside:
            ax.text(0.99, 0.01, f"positions outside: {outside}", transform=ax.transAxes, ha="right", va="bottom",
                    fontsize=7, color=VERMILION)  # fmt: skip
        figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=3 if columns == 1 else 7)
    return figure


def _line(t_ns: Any, enu: F8) -> tuple[F8, F8]:
    """East and north with breaks at gaps; of long series every k-th, which on a map loses nothing."""
    _, xy = broken(t_ns, enu[:, :2])
    step = max(1, len(xy) // 20_000)
    return xy[::step, 0], xy[::step, 1]


def _ends(ax: Any, enu: F8) -> None:
    for i, marker, name in ((0, "o", "start"), (-1, "s", "end")):
        ax.plot(enu[i, 0], enu[i, 1], marker, ms=5, mfc="white", mec=BLACK, mew=0.9, zorder=7, ls="none", label=name)


def _flags(ax: Any, status: NDArray[np.uint8], x: F8, y: F8) -> None:
    for code, name, colour, marker in FLAGGED:
        at = np.flatnonzero(status == code)
        if len(at):
            ax.plot(x[at], y[at], marker, color=colour, ms=3.2, mew=0.8, ls="none", label=f"{name} ({len(at)})",
                    gid=name, zorder=4)  # fmt: skip


def _extent(points: F8) -> tuple[F8, F8]:
    """Corners of the picture: around all but a few wild positions, neither a strip nor a dot."""
    low, high = np.percentile(points, 0.5, axis=0), np.percentile(points, 99.5, axis=0)
    least, greatest = points.min(axis=0), points.max(axis=0)
    if (greatest - least).max() <= 2.0 * max((high - low).max(), 1e-9):
        low, high = least, greatest
    size = np.maximum(high - low, 0.4 * max((high - low).max(), 0.02))
    middle = (low + high) / 2.0
    return middle - 0.58 * size, middle + 0.58 * size


def _frame(ax: Any, low: F8, high: F8, origin: F8) -> None:
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    ax.set_aspect("equal")
    long = float((high - low).max()) > 5000.0
    if long:
        ax.xaxis.set_major_formatter(lambda value, _: f"{value / 1000:g}")
        ax.yaxis.set_major_formatter(lambda value, _: f"{value / 1000:g}")
    unit = "km" if long else "m"
    lat, lon, _ = geodetic_from_ecef(origin)
    north, east = math.degrees(lat), math.degrees(lon)
    place = f"{abs(north):.5f}° {'N' if north >= 0 else 'S'} {abs(east):.5f}° {'E' if east >= 0 else 'W'}"
    ax.set(xlabel=f"east of {place} ({unit})", ylabel=f"north ({unit})")


@dataclass(frozen=True)
class Ellipses:
    """95 % ellipses of some epochs: indices of positions, half axes (minor, major), directions, half sizes, m."""

    at: NDArray[Any]
    half: F8
    axes: F8
    size: F8


def _ellipses(solution: Solution, keep: NDArray[Any], origin: F8, number: int) -> Ellipses:
    """Of positions evenly spread; sizes to east and north are the medians."""
    lat, lon, _ = geodetic_from_ecef(origin)
    turn = C_ne_enu(lat, lon)
    cov = (turn @ solution.cov_pos[keep] @ turn.T)[:, :2, :2]
    there = np.flatnonzero(np.isfinite(cov).all(axis=(1, 2)))
    if number <= 0 or not len(there):
        nothing = np.zeros((0, 2))
        return Ellipses(np.zeros(0, np.intp), nothing, np.zeros((0, 2, 2)), np.zeros(2))
    at = there[np.unique(np.linspace(0, len(there) - 1, number).round().astype(int))]
    values, vectors = np.linalg.eigh(cov[at])
    half = ELLIPSE_95 * np.sqrt(np.maximum(values, 0.0))
    size = ELLIPSE_95 * np.median(np.sqrt(np.diagonal(cov[at], axis1=1, axis2=2)), axis=0)
    return Ellipses(at, half, vectors, size)


def _draw_ellipses(ax: Any, shapes: Ellipses, enu: F8, factor: float) -> None:
    for i, (minor, major), axes in zip(shapes.at, shapes.half, shapes.axes, strict=True):
        angle = math.degrees(math.atan2(axes[1, 1], axes[0, 1]))
        for face, edge, alpha, gid in ((SKY, "none", 0.18, None), ("none", BLUE, 0.8, "ellipse")):
            ax.add_patch(Ellipse((enu[i, 0], enu[i, 1]), 2 * factor * major, 2 * factor * minor, angle=angle, fc=face,
                                 ec=edge, alpha=alpha, lw=0.6, zorder=2, gid=gid))  # fmt: skip
    if len(shapes.at):
        name = "95 % ellipse" + (f", {factor:g} times" if factor != 1.0 else "")
        ax.plot([], [], "o", mfc=SKY, mec=BLUE, alpha=0.6, ms=6, label=name)


def _enlargement(half_axis_m: float, span_m: float) -> float:
    """1, or the largest round number that makes an ellipse a thirtieth of the picture where it would be a dot."""
    wanted = span_m / 60.0 / half_axis_m if half_axis_m > 0.0 else 1.0
    if wanted < 2.0:
        return 1.0
    decade = 10.0 ** math.floor(math.log10(wanted))
    return max(step * decade for step in _ROUND if step * decade <= wanted)


def errors(solution: Solution, truth: Truth, columns: int, tolerance_s: float, interpolate: bool) -> Picture:
    """See `starwise.report.figures.Plots.errors`."""
    matched = match(solution, truth, tolerance_s=tolerance_s, interpolate=interpolate)
    if not len(matched.at):
        raise StarwiseError("no epoch of the solution has a truth", wanted="a truth of the same time, or a tolerance")
    with matplotlib.rc_context(RC):
        figure = picture(columns, 96)
        grid = figure.add_gridspec(3, columns, width_ratios=(1,) if columns == 1 else (2.2, 1))
        first = None
        for i, name in enumerate(("east", "north", "up")):
            ax = figure.add_subplot(grid[i, 0], sharex=first)
            first = first or ax
            _error_panel(ax, solution, matched, i, name)
            if i < 2:
                ax.tick_params(labelbottom=False)
        ax.set_xlabel(time_axis(solution.t_ns[matched.at], int(solution.t_ns[0]))[1])
        handles = {}
        for panel in figure.axes:
            handles.update(dict(zip(*reversed(panel.get_legend_handles_labels()), strict=True)))
        many = 3 if columns == 1 else 6
        figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=many)
        if columns == 2:
            _calibration(figure.add_subplot(grid[:, 1]), matched)
    return figure


def _error_panel(ax: Any, solution: Solution, matched: Matched, i: int, name: str) -> None:
    llh = geodetic_from_ecef(solution.pos_e[matched.at])
    turn = rotations_ne_enu(llh[:, 0], llh[:, 1])
    sigma = np.sqrt(np.einsum("nj,njk,nk->n", turn[:, i], solution.cov_pos[matched.at], turn[:, i]))
    error = matched.error_n[:, i]
    start = int(solution.t_ns[0])
    both = np.stack([error, sigma], axis=1)
    t_ns, both = broken(solution.t_ns[matched.at], both)
    t, _ = time_axis(t_ns, start)
    shown = np.union1d(thinned(both[:, 0]), thinned(both[:, 1]))
    x, y, s = t[shown], both[shown, 0], both[shown, 1]
    ax.fill_between(x, -3 * s, 3 * s, color=SKY, alpha=0.28, lw=0, label="3 sigma claimed", gid="3 sigma")
    ax.fill_between(x, -s, s, color=SKY, alpha=0.6, lw=0, label="1 sigma", gid="1 sigma")
    ax.axhline(0.0, color=BLACK, lw=0.5)
    ax.plot(x, y, color=BLUE, lw=0.8, label="error", gid="error")
    at, _ = time_axis(solution.t_ns[matched.at], start)
    _flags(ax, solution.status[matched.at], at, error)
    claimed = float(np.nanpercentile(s, 90)) if np.isfinite(s).any() else 0.0
    limit = 1.15 * max(float(np.percentile(np.abs(error), 99.5)), 3.0 * claimed, 1e-3)
    ax.set(ylim=(-limit, limit), ylabel=f"{name} (m)")
    ax.margins(x=0.01)
    outside = int((np.abs(error) > limit).sum())
    note = f"RMS {math.sqrt(float(np.mean(error**2))):.3g} m" + (f", {outside} outside" if outside else "")
    ax.text(0.99, 0.96, note, transform=ax.transAxes, ha="right", va="top", fontsize=7,
            bbox={"fc": "white", "ec": "none", "alpha": 0.75, "pad": 1.0})  # fmt: skip


def _calibration(ax: Any, matched: Matched) -> None:
    from scipy.special import chdtr

    ax.plot([0, 100], [0, 100], color=GREY, lw=0.8, ls=":", label="honest")
    styles = {3: ("ellipsoid", BLUE, "-"), 2: ("horizontal", VERMILION, "--"), 1: ("height", GREEN, "-.")}
    for dof, nees in matched.nees_by_dof.items():
        known = np.sort(nees[np.isfinite(nees)])
        if not len(known):
            continue
        name, colour, dash = styles[dof]
        nominal = np.concatenate([[0.0], 100.0 * chdtr(dof, known), [100.0]])
        seen = np.concatenate([[0.0], 100.0 * np.arange(1, len(known) + 1) / len(known), [100.0]])
        shown = np.unique(np.linspace(0, len(nominal) - 1, 400).astype(int))
        ax.plot(nominal[shown], seen[shown], color=colour, ls=dash, label=name, gid=f"calibration {dof}")
    ax.set(xlim=(0, 100), ylim=(0, 100), xlabel="claimed probability of the region (%)", ylabel="epochs inside (%)")
    ax.set_aspect("equal")
    ax.legend(loc="lower right")
    ax.set_title("below the line: too sure", color=GREY, fontsize=7)
