"""Tests of the hypothesis that filter and system agree, in families; the false-alarm rate is that of all together.

Each family looks for one way of being wrong and has one p-value: that of its smallest by Sidak's rule over its tests.
The p-value of the run is that of the smallest family, again by Sidak's rule. Statistics are chosen so that they are
nearly independent under H0 (size, mean, lag products and shape of a normal sample are), which makes the rule exact
instead of cautious; what is left of dependence is measured by simulation.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from starwise.analysis.lab.innovations import KINDS, Innovations
from starwise.analysis.lab.moments import gamma_p, row_moments, sidak
from starwise.analysis.lab.series import Series
from starwise.types import F8

MIN_ROWS: Final = 10
"""Rows that a channel must have to be tested by itself."""
FAMILIES: Final = ("size", "state", "bias", "whiteness", "tails", "cross", "delay", "nees")


@dataclass(frozen=True)
class Check:
    """One test: family, what it is of, its statistic, direction and p-value.

    ``group`` are indices of channels, ``what`` words for them; ``evidence``: logarithm of how much more likely the
    innovations are, where the test says so.
    """

    family: str
    what: str
    statistic: float
    p: float
    group: tuple[int, ...] = ()
    evidence: float = 0.0


@dataclass(frozen=True)
class Family:
    """Tests of one way of being wrong, and their common p-value."""

    name: str
    tests: tuple[Check, ...]
    p: float
    count: int = 0
    """Tests made, also those not kept."""

    @property
    def best(self) -> Check:
        """The test with the smallest p-value."""
        return min(self.tests, key=lambda test: test.p)


def family(name: str, tests: list[Check], more: int = 0) -> Family:
    """A family of tests; p-value 1 where there are none. ``more``: tests made beside these, with larger p-values."""
    known = [test for test in tests if math.isfinite(test.p)]
    if not known:
        return Family(name, (), 1.0)
    count = len(known) + more
    return Family(name, tuple(known), float(sidak(min(test.p for test in known), count)), count)


def overall(families: list[Family]) -> float:
    """P-value of the run: chance that the smallest of as many independent families is so small."""
    tested = [f for f in families if f.tests]
    return float(sidak(min(f.p for f in tested), len(tested))) if tested else math.nan


def groups(table: Innovations) -> dict[str, list[int]]:
    """Channels by sensor, by system and sensor, by system, signal and sensor; a group that is another is left out."""
    made: dict[str, list[int]] = {}
    for i, c in enumerate(table.channels):
        names = (c.kind, f"{c.system} {c.kind}".strip(), f"{c.system} {c.signal} {c.kind}".strip())
        for name in dict.fromkeys(names):
            made.setdefault(name, []).append(i)
    seen: set[tuple[int, ...]] = set()
    out: dict[str, list[int]] = {}
    for name, members in made.items():
        if tuple(members) not in seen and len(members) > 1:
            seen.add(tuple(members))
            out[name] = members
    return out


def size_tests(table: Innovations, stats: Series) -> Family:
    """Mean squares of channels and of groups of channels against their expectation (chi-square)."""
    tests = []
    for name, members in groups(table).items():
        value, mean, var = (float(x[members].sum()) for x in (stats.square, stats.square_mean, stats.square_var))
        if mean >= MIN_ROWS:
            p, _ = gamma_p(np.array(value), np.array(mean), np.array(var))
            tests.append(Check("size", name, value / mean, float(p), tuple(members)))
    enough = np.flatnonzero(stats.n >= MIN_ROWS)
    p, _ = gamma_p(stats.square[enough], stats.square_mean[enough], stats.square_var[enough])
    for i, value in zip(enough.tolist(), p.tolist(), strict=True):
        tests.append(Check("size", table.channels[i].label, float(stats.nis[i]), value, (i,)))
    return family("size", tests)


def epoch_tests(table: Innovations) -> Family:
    """Sum of the NIS of all epochs against its degrees of freedom, where epochs are all that is known."""
    known = np.isfinite(table.nis) & (table.dof > 0)
    dof = float(table.dof[known].sum())
    value = float(table.nis[known].sum())
    p, _ = gamma_p(np.array(value), np.array(dof), np.array(2.0 * dof))
    return family("size", [Check("size", "epochs", value / dof, float(p))])


@dataclass(frozen=True)
class Split:
    """Mean squares of a sensor split by how much of the claimed variance is noise and how much doubt about the states.

    E z^2 = noise (1 - f) + state f, where f is the part of the states: ``noise`` and ``state`` are true over assumed
    variance of either, 1 and 1 under H0. ``gain_noise``, ``gain_state``, ``gain_both``: how much more likely (log) the
    innovations are with one of them, or both, not 1.
    """

    kind: str
    noise: float
    state: float
    noise_p: float
    state_p: float
    gain_noise: float
    gain_state: float
    gain_both: float
    mean_f: float


def splits(table: Innovations) -> list[Split]:
    """`Split` of every sensor whose noise is known."""
    out = []
    two_all, four_all = row_moments(table.gate, table.gate_probability)
    for number, kind in enumerate(KINDS):
        rows = np.flatnonzero(table.used & (table.kind == number) & np.isfinite(table.r))
        if len(rows) < 3 * MIN_ROWS:
            continue
        f, square = table.state_part[rows], table.z[rows] ** 2
        two, four = two_all[rows], four_all[rows]
        if float(((1.0 - f) @ f) ** 2) > SEPARABLE * float((1.0 - f) @ (1.0 - f)) * float(f @ f):
            continue  # all rows are alike: nothing tells noise from states
        out.append(_split(kind, f, square / two, four / two**2 - 1.0))
    return out


SEPARABLE: Final = 0.9
"""Squared cosine between the parts of noise and states of the rows up to which they are told apart."""
BINS: Final = 64


def _split(kind: str, f: F8, q: F8, var: F8) -> Split:
    """Split of normalised squares q (mean 1 under H0) with state parts f."""
    p = []
    for weight in (1.0 - f, f):
        value, mean, spread = float(weight @ q), float(weight.sum()), float((weight * weight) @ var)
        p.append(float(gamma_p(np.array(value), np.array(mean), np.array(spread))[0]) if mean > 1.0 else 1.0)
    # Rows of nearly one f are one: the rest works on at most 64 sums.
    at = np.minimum((f * BINS).astype(np.int64), BINS - 1)
    n: F8 = np.bincount(at, minlength=BINS).astype(np.float64)
    fs: F8 = np.bincount(at, weights=f, minlength=BINS).astype(np.float64)
    qs: F8 = np.bincount(at, weights=q, minlength=BINS).astype(np.float64)
    there = n > 0
    n, fs, qs = n[there], fs[there] / n[there], qs[there]

    def gain(noise: float, state: float) -> float:
        mu = np.maximum(noise * (1.0 - fs) + state * fs, 1e-6)
        return 0.5 * float((qs - qs / mu - n * np.log(mu)).sum())

    noise, state = 1.0, 1.0
    for _ in range(30):  # scoring: least squares with weights of the variance, proportional to mu^2
        mu = np.maximum(noise * (1.0 - fs) + state * fs, 1e-3)
        w = 1.0 / mu**2
        a11, a12, a22 = (float((w * n * x).sum()) for x in ((1.0 - fs) ** 2, fs * (1.0 - fs), fs * fs))
        b1, b2 = float((w * (1.0 - fs) * qs).sum()), float((w * fs * qs).sum())
        det = a11 * a22 - a12 * a12
        if det <= 1e-9 * a11 * a22:
            break
        noise = min(max((a22 * b1 - a12 * b2) / det, 1e-4), 1e6)
        state = min(max((a11 * b2 - a12 * b1) / det, 1e-4), 1e6)
    return Split(
        kind, noise, state, p[0], p[1], _largest(lambda a: gain(a, 1.0)), _largest(lambda a: gain(1.0, a)),
        gain(noise, state), float(f.mean()),
    )  # fmt: skip


def _largest(gain: Callable[[float], float]) -> float:
    """Largest gain over factors from a thousandth to a thousand: a grid, then finer."""
    best = max(np.exp(np.linspace(-6.9, 6.9, 47)).tolist(), key=gain)
    return max(gain(a) for a in (best * np.exp(np.linspace(-0.3, 0.3, 25))).tolist())


def chi2_tail(value: float, dof: int) -> float:
    """Chance of a chi-square variable above a value."""
    from scipy.special import chdtrc

    return float(chdtrc(dof, value))
