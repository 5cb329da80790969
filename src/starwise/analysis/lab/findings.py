"""From tests to causes: what is wrong, where, how large, and what to do about it."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any


class Cause(StrEnum):
    """Ways in which a filter and its system disagree."""

    R_TOO_SMALL = "r_too_small"
    """The measurements are noisier than the filter assumes."""
    R_TOO_LARGE = "r_too_large"
    Q_TOO_SMALL = "q_too_small"
    """The states change more than the filter assumes: it is too stiff."""
    Q_TOO_LARGE = "q_too_large"
    CORRELATED = "correlated"
    """Errors of a measurement last from epoch to epoch; the filter takes each for a new one."""
    BIAS = "bias"
    DELAY = "delay"
    """Positions are late (or early) against what the filter predicts with."""
    HEAVY_TAILS = "heavy_tails"
    CROSS_CORRELATED = "cross_correlated"
    """Errors of different channels go together."""
    LOST = "lost"
    """The filter failed its own tests, or started again."""
    OVERCONFIDENT = "overconfident"
    """Against the truth: errors larger than claimed."""
    MODEST = "modest"
    """Against the truth: errors smaller than claimed."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes
    ----------
    cause : Cause
    where : str
        Channels that it is of: ``code``, ``E 5Q code``, ``G17``, ``motion`` ...
    size : float
        How large, in ``unit``.
    unit : str
        ``true / assumed variance``, ``s``, ``m`` ...
    p_value : float
        Chance of such a statistic if nothing is wrong, corrected for all tests of its family.
    evidence : float
        Logarithm of how much more likely the innovations are with this cause than without: ranks the findings.
    matters : bool
        Large enough to matter; a long run proves differences that do not.
    words, cure : str
        For people.
    """

    cause: Cause
    where: str
    size: float
    unit: str
    p_value: float
    evidence: float
    matters: bool
    words: str
    cure: str

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        from starwise.analysis.lab.plain import plain

        return {
            "cause": str(self.cause),
            "where": self.where,
            **{k: plain(getattr(self, k)) for k in ("size", "unit", "p_value", "evidence", "matters", "words", "cure")},
        }
