"""Times without a week: solutions and truths of programs that write only seconds of the week."""

from dataclasses import replace
from typing import Final

import numpy as np

from starwise.constants import NS, WEEK_S
from starwise.types import I8, Solution, Truth

_WEEK_NS: Final = WEEK_S * NS
_WEEKLESS_NS: Final = 4 * _WEEK_NS
"""Before this, GPST: nobody measured in January 1980, so the week is not known."""


def in_one_week(solution: Solution, truth: Truth) -> tuple[Solution, Truth]:
    """Solution and truth with the week of the other where one of them has none (KF-GINS writes 0)."""
    if truth.t_ns is None or not len(truth.t_ns) or not solution.n_epochs:
        return solution, truth
    ours, theirs = _weekless(solution.t_ns), _weekless(truth.t_ns)
    if ours == theirs:
        return solution, truth
    apart = int(np.median(truth.t_ns)) - int(np.median(solution.t_ns))
    shift = round(apart / _WEEK_NS) * _WEEK_NS
    if ours:
        return replace(solution, t_ns=solution.t_ns + shift), truth
    return solution, replace(truth, t_ns=truth.t_ns - shift)


def _weekless(t_ns: I8) -> bool:
    return bool(t_ns.min() >= 0 and t_ns.max() < _WEEKLESS_NS)
