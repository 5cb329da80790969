"""The sky with the satellites' tracks, and normalised innovations with their chi-square bounds."""

from typing import Any, Final

import matplotlib
import numpy as np
from numpy.typing import NDArray

from starwise.constants import ROW_EXCLUDED, ROW_GATED
from starwise.errors import StarwiseError
from starwise.report.figures_style import (
    BLACK,
    BLUE,
    GREY,
    RC,
    SKY,
    SYSTEM,
    VERMILION,
    Picture,
    picture,
    thinned,
    time_axis,
)
from starwise.signals import sv_name
from starwise.types import F8, Solution

REFUSED: Final = (ROW_GATED, ROW_EXCLUDED)
_PER_TRACK: Final = 400
"""Points drawn of one satellite's track."""
_MOST_CROSSES: Final = 2000


def sky(solution: Solution, columns: int, colour: str) -> Picture:
    """See `starwise.report.figures.Plots.sky`."""
    if colour not in ("system", "residual", "cn0"):
        raise StarwiseError("no such colouring", found=colour, wanted="system | residual | cn0")
    ledger = solution.ledger
    if not {"azimuth_rad", "elevation_rad", "sv", "status"} <= ledger.keys():
        raise StarwiseError(
            "the solution has no ledger with directions", wanted="a result of solve, read with its ledger"
        )
    seen = np.isfinite(ledger["azimuth_rad"]) & (ledger["elevation_rad"] >= 0.0)
    if not seen.any():
        raise StarwiseError("no direction in the ledger: nothing to draw")
    with matplotlib.rc_context(RC):
        figure = picture(columns, (96 if columns == 1 else 120) + (0 if colour == "system" else 10))
        ax = figure.add_subplot(projection="polar")
        _dome(ax)
        if colour == "system":
            _tracks(ax, ledger, seen)
        else:
            _coloured(figure, ax, ledger, seen, colour)
        _labels(ax, ledger, seen)
        refused = np.flatnonzero(seen & np.isin(ledger["status"], REFUSED))
        if len(refused):
            few = refused[:: 1 + len(refused) // _MOST_CROSSES]
            ax.plot(*_polar(ledger, few), "x", color=BLACK, ms=3, mew=0.6, ls="none", zorder=5, gid="refused",
                    label=f"refused ({len(refused)})")  # fmt: skip
        figure.legend(
            *ax.get_legend_handles_labels(),
            loc="outside lower center",
            ncols=5 if columns == 1 else 8,
            handletextpad=0.2,
        )
    return figure


def _dome(ax: Any) -> None:
    ax.set_theta_zero_location("N")
    ax.set_theta_direction(-1)
    ax.set_ylim(0.0, 90.0)
    ax.set_yticks((0, 30, 60, 90), ("90°", "60°", "30°", ""))
    ax.set_xticks(np.radians((0, 45, 90, 135, 180, 225, 270, 315)), ("N", "", "E", "", "S", "", "W", ""))
    ax.tick_params(axis="x", pad=-1)
    ax.tick_params(axis="y", labelsize=6, labelcolor=GREY)
    ax.set_rlabel_position(22.5)


def _polar(ledger: dict[str, NDArray[Any]], at: NDArray[Any]) -> tuple[F8, F8]:
    return ledger["azimuth_rad"][at], 90.0 - np.degrees(ledger["elevation_rad"][at])


def _satellites(ledger: dict[str, NDArray[Any]], seen: NDArray[np.bool_]) -> dict[str, NDArray[np.intp]]:
    """Rows by satellite: one per epoch, that of its first signal with a direction, in time."""
    at = np.flatnonzero(seen)
    order = at[np.argsort(ledger["sv"][at], kind="stable")]
    ids, first = np.unique(ledger["sv"][order], return_index=True)
    rows = {}
    for sv, part in zip(ids, np.split(order, first[1:]), strict=True):
        _, once = np.unique(ledger["t_ns"][part], return_index=True)
        rows[sv_name(int(sv))] = part[once]
    return rows


def _tracks(ax: Any, ledger: dict[str, NDArray[Any]], seen: NDArray[np.bool_]) -> None:
    told = set()
    for name, rows in _satellites(ledger, seen).items():
        title, colour, marker = SYSTEM[name[0]]
        rows = rows[:: 1 + len(rows) // _PER_TRACK]
        theta, r = _polar(ledger, rows)
        t = ledger["t_ns"][rows]
        step = np.diff(t)
        gaps = np.flatnonzero(step > 10 * np.median(step)) + 1 if len(step) else np.zeros(0, np.intp)
        ax.plot(np.insert(theta, gaps, np.nan), np.insert(r, gaps, np.nan), color=colour, lw=1.4, gid=name,
                solid_capstyle="round")  # fmt: skip
        ax.plot(theta[-1:], r[-1:], marker, color=colour, ms=4.5, mec="white", mew=0.5, zorder=4,
                label="_" if title in told else title, ls="none")  # fmt: skip
        told.add(title)


def _coloured(figure: Picture, ax: Any, ledger: dict[str, NDArray[Any]], seen: NDArray[np.bool_], what: str) -> None:
    if what == "cn0":
        value, label, limits, colours = ledger["cn0_dbhz"], "C/N0 (dB-Hz)", (25.0, 55.0), "viridis"
    else:
        value = np.abs(ledger["innovation_m"]) / np.sqrt(ledger["innovation_var_m2"])
        label, limits, colours = "size of the innovation (sigma)", (0.0, 3.0), "cividis_r"
    shown = []
    for rows in _satellites(ledger, seen & np.isfinite(value)).values():
        shown.append(rows[:: 1 + len(rows) // _PER_TRACK])
    if not shown:
        raise StarwiseError(f"no {label} in the ledger: nothing to draw")
    at = np.concatenate(shown)
    theta, r = _polar(ledger, at)
    points = ax.scatter(theta, r, c=value[at], s=5, cmap=colours, vmin=limits[0], vmax=limits[1], lw=0, gid=what)
    figure.colorbar(points, ax=ax, label=label, location="bottom", shrink=0.6, aspect=30, pad=0.06, extend="both")


def _labels(ax: Any, ledger: dict[str, NDArray[Any]], seen: NDArray[np.bool_]) -> None:
    for name, rows in _satellites(ledger, seen).items():
        theta, r = _polar(ledger, rows[-1:])
        ax.annotate(name, (theta[0], r[0]), xytext=(3, 3), textcoords="offset points", fontsize=5.5, zorder=6,
                    annotation_clip=False)  # fmt: skip


def nis(solution: Solution, columns: int, probability: float) -> Picture:
    """See `starwise.report.figures.Plots.nis`."""
    if not 0.0 < probability < 1.0:
        raise StarwiseError("not a probability", found=f"{probability}", wanted="between 0 and 1")
    from scipy.special import chdtr, chdtri

    at = np.flatnonzero(np.isfinite(solution.nis) & (solution.dof > 0))
    if not len(at):
        raise StarwiseError("no epoch has a NIS: nothing to draw", wanted="a result of a filter or of least squares")
    value, dof = solution.nis[at], solution.dof[at].astype(np.float64)
    tail = 0.5 * (1.0 - probability)
    low, high = chdtri(dof, 1.0 - tail) / dof, chdtri(dof, tail) / dof
    ratio, share = value / dof, chdtr(dof, value)
    inside = float(np.mean((ratio >= low) & (ratio <= high)))
    t, label = time_axis(solution.t_ns[at], int(solution.t_ns[0]))
    with matplotlib.rc_context(RC):
        figure = picture(columns, 92 if columns == 1 else 62)
        shape = (2, 1) if columns == 1 else (1, 2)
        ratios = {"height_ratios": (2, 1)} if columns == 1 else {"width_ratios": (2.2, 1)}
        ax, side = figure.subplots(*shape, gridspec_kw=ratios)
        bounds = np.union1d(thinned(low), thinned(high))
        ax.fill_between(t[bounds], low[bounds], high[bounds], step="mid", color=SKY, alpha=0.4, lw=0, gid="bounds",
                        label=f"chi-square, {100 * probability:g} %")  # fmt: skip
        ax.axhline(1.0, color=BLACK, lw=0.6, label="expected")
        shown = thinned(ratio)
        ax.plot(t[shown], ratio[shown], ".", color=BLUE, ms=2.2, gid="nis", label="epoch")
        width = max(5, len(at) // 40)
        if len(at) > 3 * width:
            _mean_line(ax, t, value, dof, width)
        top = 1.15 * max(float(np.percentile(ratio, 99.0)), float(np.percentile(high, 95.0)))
        out = int((ratio > top).sum())
        ax.set(ylim=(0.0, top), xlabel=label, ylabel="NIS / degrees of freedom")
        ax.margins(x=0.01)
        text = f"mean {value.sum() / dof.sum():.2f}, {100 * inside:.0f} % inside" + (f", {out} above" if out else "")
        ax.text(0.99, 0.97, text, transform=ax.transAxes, ha="right", va="top", fontsize=7,
                bbox={"fc": "white", "ec": "none", "alpha": 0.75, "pad": 1.0})  # fmt: skip
        figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=2 if columns == 1 else 4)
        side.hist(share, bins=20, range=(0.0, 1.0), weights=np.full(len(at), 100.0 / len(at)), color=BLUE, alpha=0.75,
                  rwidth=0.9, gid="share")  # fmt: skip
        side.axhline(5.0, color=BLACK, lw=0.6)
        side.set(xlim=(0, 1), xlabel="chi-square probability of NIS", ylabel="epochs (%)")
        small = {"transform": side.transAxes, "va": "top", "fontsize": 6, "color": "#555555"}
        back = {"bbox": {"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.5}}
        side.text(0.07, 0.97, "smaller than claimed", **small, **back)
        side.text(0.98, 0.97, "larger", ha="right", **small, **back)
    return figure


def _mean_line(ax: Any, t: F8, value: F8, dof: F8, width: int) -> None:
    """Mean over a window of epochs, each by its degrees of freedom."""
    total = np.concatenate([[0.0], np.cumsum(value)])
    of = np.concatenate([[0.0], np.cumsum(dof)])
    mean = (total[width:] - total[:-width]) / (of[width:] - of[:-width])
    middle = t[width // 2 : width // 2 + len(mean)]
    shown = thinned(mean)
    ax.plot(middle[shown], mean[shown], color=VERMILION, lw=1.0, label=f"mean of {width}", gid="mean")
