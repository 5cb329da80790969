"""Pictures of a solution for papers: ``solution.plot.track()`` and its siblings, by matplotlib.

matplotlib is loaded when the first picture is asked for (``pip install 'starwise[plot]'``).
"""

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Literal

from starwise.errors import StarwiseError
from starwise.types import Solution, Truth

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Columns = Literal[1, 2]
"""Width of a picture in columns of a journal: 88 or 182 mm."""
Colour = Literal["system", "residual", "cn0"]


@dataclass(frozen=True)
class Plots:
    """Pictures of one solution.

    Each returns a matplotlib ``Figure`` in the size it will be printed at, with lettering of 8 points;
    ``figure.savefig("track.pdf")`` (or ``.svg``) writes it as vectors with embedded fonts. Colours are those of Okabe
    and Ito, told apart by all readers; shapes and dashes differ, too.
    """

    solution: Solution

    def track(
        self,
        truth: Truth | str | Path | None = None,
        *,
        columns: Columns = 1,
        ellipses: int | None = None,
        enlarge: float | None = None,
    ) -> "Figure":
        """Track in local east and north, m, with 95 % ellipses of the claimed covariance.

        Parameters
        ----------
        truth : Truth, path-like or str, optional
            Drawn beneath, as in `starwise.assess`; a point is the origin, too. Else the origin is the median position.
        columns : {1, 2}
            Width.
        ellipses : int, optional
            How many, evenly spread over the epochs with a position, first and last included; default 12, or 3 where
            they are larger than the track.
        enlarge : float, optional
            Factor of their size; default: 1, or a round number if they could not be seen. The legend says it.

        Raises
        ------
        StarwiseError
            No position to draw, or matplotlib is not installed.
        """
        return _drawing("figures_track").track(self.solution, _truth(truth), columns, ellipses, enlarge)  # type: ignore[no-any-return]

    def errors(
        self, truth: Truth | str | Path, *, columns: Columns = 1, tolerance_s: float = 0.05, interpolate: bool = False
    ) -> "Figure":
        """Errors to east, north and up over time, m, in the bands of 1 and 3 sigma that the solution claims.

        With two columns also the calibration curve: how often regions of a claimed probability hold the truth.

        Parameters
        ----------
        truth : Truth, path-like or str
            As in `starwise.assess`.
        columns : {1, 2}
            Width.
        tolerance_s, interpolate
            Matching in time; see `starwise.analysis.accuracy.match`.

        Raises
        ------
        StarwiseError
            No epoch with a truth, or matplotlib is not installed.
        """
        known = _truth(truth)
        assert known is not None
        return _drawing("figures_track").errors(self.solution, known, columns, tolerance_s, interpolate)  # type: ignore[no-any-return]

    def sky(self, *, columns: Columns = 1, colour: Colour = "system") -> "Figure":
        """Tracks of the satellites as seen from the receiver: azimuth, and elevation in degrees (90 in the middle).

        Parameters
        ----------
        columns : {1, 2}
            Width.
        colour : {"system", "residual", "cn0"}
            What colour stands for: the constellation, the normalised innovation (sigma), or C/N0 (dB-Hz). Rows that a
            gate or an exclusion refused are crosses in all of them.

        Raises
        ------
        StarwiseError
            The solution has no ledger with directions, or matplotlib is not installed.
        """
        return _drawing("figures_sky").sky(self.solution, columns, colour)  # type: ignore[no-any-return]

    def nis(self, *, columns: Columns = 1, probability: float = 0.95) -> "Figure":
        """Normalised innovation squared per degree of freedom over time, with its chi-square bounds.

        Beside it how often it falls where: the share of epochs by the chi-square probability of their NIS, which is
        even if innovations are as large as claimed.

        Parameters
        ----------
        columns : {1, 2}
            Width.
        probability : float
            Of the region between the bounds, two-sided, for each epoch by its own degrees of freedom.

        Raises
        ------
        StarwiseError
            No epoch has a NIS, a probability is none, or matplotlib is not installed.
        """
        return _drawing("figures_sky").nis(self.solution, columns, probability)  # type: ignore[no-any-return]


def _drawing(module: str) -> ModuleType:
    from importlib import import_module

    try:
        import_module("matplotlib")
    except ImportError:
        raise StarwiseError("pictures need matplotlib", wanted="pip install 'starwise[plot]'") from None
    return import_module(f"starwise.report.{module}")


def _truth(truth: Truth | str | Path | None) -> Truth | None:
    if truth is None or isinstance(truth, Truth):
        return truth
    from starwise.io.truth import read_truth

    return read_truth(str(truth))
