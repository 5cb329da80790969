"""What all pictures share: sizes, colours, time axes, and series thinned without losing their extremes."""

from itertools import pairwise
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from starwise.errors import StarwiseError
from starwise.gnsstime import iso
from starwise.types import F8, I8

MM: Final = 1 / 25.4
WIDTH_IN: Final = {1: 88 * MM, 2: 182 * MM}
"""One and two columns of a journal, inches."""
BLUE, VERMILION, GREEN, ORANGE, SKY, PURPLE, BLACK, GREY = (
    "#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#000000", "#8C8C8C",
)  # fmt: skip
"""Okabe and Ito, Color universal design (2008)."""
SYSTEM: Final = {
    "G": ("GPS", BLUE, "o"), "R": ("GLONASS", VERMILION, "s"), "E": ("Galileo", GREEN, "^"),
    "C": ("BeiDou", ORANGE, "D"), "J": ("QZSS", PURPLE, "v"), "I": ("NavIC", SKY, "P"), "S": ("SBAS", GREY, "X"),
}  # fmt: skip
"""Name, colour and marker by the letter of a system."""
RC: Final[Any] = {
    "font.size": 8, "axes.titlesize": 8, "axes.labelsize": 8, "xtick.labelsize": 7, "ytick.labelsize": 7,
    "legend.fontsize": 7, "legend.frameon": False, "legend.handlelength": 1.4, "legend.columnspacing": 1.0,
    "axes.linewidth": 0.6,
    "lines.linewidth": 0.9, "xtick.major.width": 0.6, "ytick.major.width": 0.6, "grid.linewidth": 0.4,
    "grid.color": "#D9D9D9", "axes.grid": True, "axes.axisbelow": True, "axes.spines.top": False,
    "axes.spines.right": False, "figure.facecolor": "white", "savefig.dpi": 300, "mathtext.default": "regular",
    "pdf.fonttype": 42, "ps.fonttype": 42, "svg.hashsalt": "starwise",
}  # fmt: skip
MANY: Final = 3000
"""Points of a series from which on it is thinned."""


class Picture(Figure):
    """A figure that is written the same way everywhere: fonts embedded, no date, shown as vectors in notebooks."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """As `matplotlib.figure.Figure.savefig`."""
        kind = str(options.get("format") or str(fname).rpartition(".")[2]).lower()
        undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind, {})
        options["metadata"] = {**undated, **(options.get("metadata") or {})} or None
        with matplotlib.rc_context(RC):
            super().savefig(fname, **options)

    def _repr_svg_(self) -> str:
        from io import StringIO

        text = StringIO()
        self.savefig(text, format="svg")
        return text.getvalue()


def picture(columns: int, height_mm: float) -> Picture:
    """An empty figure of one or two columns; to be filled inside ``matplotlib.rc_context(RC)``.

    Raises
    ------
    StarwiseError
        Another number of columns.
    """
    if columns not in WIDTH_IN:
        raise StarwiseError("no such width", found=f"columns={columns}", wanted="1 or 2")
    return Picture(figsize=(WIDTH_IN[columns], height_mm * MM), layout="constrained")


def time_axis(t_ns: I8, start_ns: int) -> tuple[F8, str]:
    """Times since the start in a unit that reads well, and the label of the axis."""
    seconds = (t_ns - start_ns) / 1e9
    longest = float(seconds.max()) if len(seconds) else 0.0
    unit, size = ("s", 1.0) if longest <= 600.0 else ("min", 60.0) if longest <= 3 * 3600.0 else ("h", 3600.0)
    return seconds / size, f"time since {iso(start_ns, 0).replace('T', ' ')} GPST ({unit})"


def thinned(y: F8, size: int = MANY) -> NDArray[np.int64]:
    """Indices of a series that show all of it: in each of ``size / 2`` stretches its least and its greatest value.

    NaN, where a line breaks, stays if all of a stretch is NaN.
    """
    n = len(y)
    if n <= size:
        return np.arange(n)
    edges = np.linspace(0, n, size // 2 + 1).astype(np.int64)
    kept = []
    for a, b in pairwise(edges.tolist()):
        part = y[a:b]
        if np.isnan(part).all():
            kept.append([a])
            continue
        kept.append(sorted({a + int(np.nanargmin(part)), a + int(np.nanargmax(part))}))
    return np.array(sorted({0, n - 1, *(i for pair in kept for i in pair)}), dtype=np.int64)


def broken(t_ns: I8, y: F8) -> tuple[I8, F8]:
    """Series with a NaN where more than three usual steps are missing, so that a line breaks there."""
    if len(t_ns) < 3:
        return t_ns, y
    step = np.diff(t_ns)
    gaps = np.flatnonzero(step > 3 * np.median(step)) + 1
    return np.insert(t_ns, gaps, t_ns[gaps - 1] + 1), np.insert(y, gaps, np.nan, axis=0)
