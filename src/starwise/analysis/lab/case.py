"""What causes are decided on, and what they have in common."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from starwise.analysis.lab.checks import MIN_ROWS, Family, Split
from starwise.analysis.lab.innovations import Innovations
from starwise.analysis.lab.moments import sidak
from starwise.analysis.lab.series import Series

ALPHA: Final = 0.05
"""Chance that a right filter is called wrong, all tests together."""
MATTERS_SCALE: Final = 1.25
"""Ratio of true to assumed variance, or its inverse, from which an error of R or Q matters: 12 % in sigma."""


@dataclass(frozen=True)
class Case:
    """Innovations of a run with their statistics and tests."""

    table: Innovations
    stats: Series
    families: dict[str, Family]
    parts: dict[str, Split]
    colored: bool = False

    def adjusted(self, name: str, p: float) -> float:
        """P-value corrected for the tests of its family, and for the families."""
        own = self.families[name]
        tested = sum(1 for f in self.families.values() if f.tests)
        return float(sidak(float(sidak(p, max(own.count, 1))), max(tested, 1)))

    def smallest(self, name: str, members: list[int]) -> float:
        """Smallest p-value of a family's tests of (some of) these channels, corrected."""
        inside = set(members)
        own = [check.p for check in self.families[name].tests if check.group and set(check.group) <= inside]
        return self.adjusted(name, min(own, default=1.0))

    def members(self, kind: str) -> list[int]:
        """Channels of a sensor with enough rows."""
        return [i for i, c in enumerate(self.table.channels) if c.kind == kind and self.stats.n[i] >= MIN_ROWS]

    @property
    def memoryless(self) -> bool:
        """Rows are residuals of codes: of fits of single epochs, whose covariance no lasting error makes wrong."""
        return self.table.residuals and not any(c.kind == "phase" for c in self.table.channels)

    @property
    def kinds(self) -> list[str]:
        """Sensors that have channels to be judged."""
        return [k for k in dict.fromkeys(c.kind for c in self.table.channels) if self.members(k)]

    def ratio(self, members: list[int]) -> tuple[float, float]:
        """Mean square over its expectation of some channels together, and the number of rows."""
        rows = float(self.stats.square_mean[members].sum())
        return max(float(self.stats.square[members].sum()) / max(rows, 1e-300), 1e-12), rows

    def first_lags(self, members: list[int]) -> np.ndarray:
        """Lag-1 correlation of channels in its standard deviations."""
        rho, pairs = self.stats.rho[members, 0], self.stats.pairs[members, 0]
        return np.asarray(np.nan_to_num(rho) * np.sqrt(pairs))


def scale_gain(ratio: float, n: float) -> float:
    """Log likelihood gained by n innovations when their variance is taken ``ratio`` times as large, at its best."""
    return 0.5 * n * (ratio - 1.0 - math.log(max(ratio, 1e-300)))


def off(ratio: float) -> bool:
    """Whether a ratio of variances is far enough from one to matter."""
    return not 1.0 / MATTERS_SCALE < ratio < MATTERS_SCALE


def num(value: float) -> str:
    """A number for people: two figures, no exponent between 0.0001 and a million."""
    if not math.isfinite(value):
        return "unknown"
    size = abs(value)
    if size >= 100.0:
        digits = 2 - math.ceil(math.log10(size))
        return f"{round(value, digits):.0f}" if size < 1e6 else f"{value:.1e}"
    return f"{value:.2g}" if size >= 1e-4 or size == 0.0 else f"{value:.1e}"


def times(ratio: float) -> str:
    """How a true over an assumed variance is said: ``3.9 x too small``."""
    return f"{num(ratio)} x too small" if ratio > 1.0 else f"{num(1.0 / max(ratio, 1e-300))} x too large"
