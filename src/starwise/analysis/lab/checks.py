"""Tests of the hypothesis that filter and system agree, in families; the chance of a false alarm holds for all together.

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

from starwise.analysis.lab.innovations import KINDS, Innovations, Mask
from starwise.analysis.lab.moments import correlation_p, gamma_p, kurtosis_moments, row_moments, sidak, two_sided
from starwise.analysis.lab.series import Series
from starwise.types import F8, I8

MIN_ROWS: Final = 10
"""Rows that a channel must have to be tested by itself."""
MIN_PAIRS: Final = 20
MAX_PAIRED: Final = 120
"""Channels of a sensor that are correlated with each other, those with the most rows."""
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

    @property
    def best(self) -> Check:
        """The test with the smallest p-value."""
        return min(self.tests, key=lambda test: test.p)


def family(name: str, tests: list[Check], more: int = 0) -> Family:
    """A family of tests; p-value 1 where there are none. ``more``: tests made beside these, with larger p-values."""
    known = [test for test in tests if math.isfinite(test.p)]
    if not known:
        return Family(name, (), 1.0)
    return Family(name, tuple(known), float(sidak(min(test.p for test in known), len(known) + more)))


def overall(families: list[Family]) -> float:
    """P-value of the run: chance that the smallest of as many independent families is so small."""
    tested = [f for f in families if f.tests]
    return float(sidak(min(f.p for f in tested), len(tested))) if tested else math.nan


def groups(table: Innovations) -> dict[str, list[int]]:
    """Channels by sensor, by system and sensor, by system, signal and sensor; a group that is another is left out."""
    made: dict[str, list[int]] = {}
    for i, c in enumerate(table.channels):
        for name in (c.kind, f"{c.system} {c.kind}", f"{c.system} {c.signal} {c.kind}"):
            made.setdefault(name.strip(), []).append(i)
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
        if float(f.std()) < 0.01:
            continue
        out.append(_split(kind, f, square / two, four / two**2 - 1.0))
    return out


BINS: Final = 64


def _split(kind: str, f: F8, q: F8, var: F8) -> Split:
    """Split of normalised squares q (mean 1 under H0) with state parts f."""
    p = []
    for weight in (1.0 - f, f):
        value, mean, spread = float(weight @ q), float(weight.sum()), float((weight * weight) @ var)
        p.append(float(gamma_p(np.array(value), np.array(mean), np.array(spread))[0]) if mean > 1.0 else 1.0)
    # Rows of nearly one f are one: the rest works on at most 64 sums.
    at = np.minimum((f * BINS).astype(np.int64), BINS - 1)
    n, fs, qs = (np.bincount(at, weights=w, minlength=BINS) for w in (np.ones(len(f)), f, q))
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


def bias_tests(table: Innovations, stats: Series) -> Family:
    """Mean of each channel against zero."""
    enough = np.flatnonzero(stats.n >= MIN_ROWS)
    spread = np.sqrt(stats.square_mean[enough] / stats.n[enough])
    t = stats.mean_z[enough] * np.sqrt(stats.n[enough]) / spread
    p = two_sided(t)
    return family(
        "bias",
        [
            Check("bias", table.channels[i].label, float(stats.bias[i]), float(q), (i,))
            for i, q in zip(enough.tolist(), p.tolist(), strict=True)
        ],
    )


def pooled_correlation(stats: Series, members: list[int]) -> tuple[F8, F8]:
    """Autocorrelation of several channels together, (L,), weighted by their products, and the number of them."""
    rho, pairs = stats.rho[members], stats.pairs[members]
    known = np.isfinite(rho) & (pairs >= 2)
    count = np.where(known, pairs, 0.0)
    total = count.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(total > 0, (np.where(known, rho, 0.0) * count).sum(axis=0) / total, np.nan), total


def whiteness_tests(table: Innovations, stats: Series) -> Family:
    """Autocorrelation of sensors (all lags together, and the first), and of each channel at its first lag and over lags.

    The mean was taken out, which costs 1 / n at every lag; it is given back.
    """
    tests = []
    for kind in KINDS:
        members = [i for i, c in enumerate(table.channels) if c.kind == kind and stats.n[i] >= MIN_ROWS]
        if not members:
            continue
        rho, pairs = pooled_correlation(stats, members)
        shift = len(members) / max(float(stats.n[members].sum()), 1.0)
        t = (rho + shift) * np.sqrt(pairs)
        ok = np.isfinite(t) & (pairs >= MIN_PAIRS)
        if not ok.any():
            continue
        tests.append(Check("whiteness", kind, float(rho[0]), float(two_sided(t[0])), tuple(members)))
        p = float(_chi2_sf(float((t[ok] ** 2).sum()), int(ok.sum())))
        tests.append(
            Check("whiteness", f"{kind}, {int(ok.sum())} lags", float(np.abs(rho[ok]).max()), p, tuple(members))
        )
    enough = np.flatnonzero((stats.pairs[:, 0] >= MIN_PAIRS) & np.isfinite(stats.rho[:, 0]))
    p1 = correlation_p(stats.rho[enough, 0] + 1.0 / stats.n[enough], stats.pairs[enough, 0])
    for i, value in zip(enough.tolist(), p1.tolist(), strict=True):
        tests.append(Check("whiteness", table.channels[i].label, float(stats.rho[i, 0]), value, (i,)))
    return family("whiteness", tests)


def ljung_box(stats: Series) -> tuple[F8, I8]:
    """Ljung-Box statistic of every channel over the lags taken, (c,), and its degrees of freedom.

    Q = n (n + 2) sum rho(l)^2 / (n - l); with gaps the number of products stands for n - l (Ljung, Box 1978, eq. 1.3).
    """
    known = np.isfinite(stats.rho) & (stats.pairs >= MIN_PAIRS)
    n = stats.n[:, None].astype(np.float64)
    scaled = np.where(
        known, (stats.rho + 1.0 / np.maximum(n, 1.0)) ** 2 * stats.pairs * (n + 2.0) / np.maximum(n, 1.0), 0.0
    )
    return np.asarray(scaled.sum(axis=1)), known.sum(axis=1)


def _chi2_sf(value: float, dof: int) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(dof, value))


def tail_tests(table: Innovations, stats: Series) -> Family:
    """Kurtosis of each sensor, channels brought to one size, and rows outside the gate against its probability."""
    tests = []
    for number, kind in enumerate(KINDS):
        members = [i for i, c in enumerate(table.channels) if c.kind == kind and stats.n[i] >= 4 * MIN_ROWS]
        if not members:
            continue
        n = stats.n[members].astype(np.float64)
        rows = table.used & (table.kind == number)
        shares = np.bincount(table.gate[rows], minlength=3) / max(int(rows.sum()), 1)
        expected, spread = (
            float(sum(w * kurtosis_moments(k, table.gate_probability)[j] for k, w in enumerate(shares))) for j in (0, 1)
        )
        excess = float((n * (stats.kurtosis[members] - expected + 6.0 / (n + 1.0))).sum())
        t = excess / math.sqrt(spread * float(n.sum()))
        tests.append(
            Check("tails", kind, expected + excess / float(n.sum()), float(two_sided(np.array(t))), tuple(members))
        )
    trials, refused = refusals(table)
    if trials and table.gate_probability > 0.0:
        tests.append(Check("tails", "gate", refused / trials, _poisson_p(refused, trials * table.gate_probability)))
    return family("tails", tests)


def refusals(table: Innovations) -> tuple[int, int]:
    """Decisions of the gate, and those against: satellites of an epoch where rows are gated in pairs, else rows."""
    if not table.n:
        return 0, 0
    if not (table.gate == 2).any():
        return table.n, int((~table.used).sum())
    names = sorted({c.sv for c in table.channels})
    satellite = np.array([names.index(c.sv) for c in table.channels])[table.channel]
    key = table.epoch * len(names) + satellite
    return len(np.unique(key)), len(np.unique(key[~table.used]))


def _poisson_p(count: int, mean: float) -> float:
    """Chance of as many or more, half of the chance of just as many taken off (mid-p)."""
    from scipy.special import gammainc, gammaln

    at = math.exp(count * math.log(mean) - mean - float(gammaln(count + 1.0)))
    more = float(gammainc(count, mean)) if count > 0 else 1.0
    return min(1.0, max(more - 0.5 * at, 0.0))


def dense(table: Innovations, members: list[int], centre: F8 | None = None) -> tuple[F8, F8]:
    """Series z of some channels, (len(members), epochs), 0 where there is none, and where there is one (0 or 1)."""
    place = np.full(len(table.channels), -1)
    place[members] = np.arange(len(members))
    rows = np.flatnonzero(table.used & (place[table.channel] >= 0))
    z = table.z[rows] - (0.0 if centre is None else centre[table.channel[rows]])
    out, there = np.zeros((len(members), len(table.t_ns))), np.zeros((len(members), len(table.t_ns)))
    out[place[table.channel[rows]], table.epoch[rows]] = z
    there[place[table.channel[rows]], table.epoch[rows]] = 1.0
    return out, there


def cross_tests(table: Innovations, stats: Series) -> Family:
    """Correlation of channels of a sensor at the same epoch: each pair, and all pairs together."""
    tests: list[Check] = []
    more = 0
    if table.residuals:  # of one fit: dependent by construction
        return family("cross", tests)
    for kind in KINDS:
        members = [i for i, c in enumerate(table.channels) if c.kind == kind and stats.n[i] >= MIN_PAIRS]
        members = sorted(members, key=lambda i: -int(stats.n[i]))[:MAX_PAIRED]
        if len(members) < 2:
            continue
        z, there = dense(table, members)
        product, count = z @ z.T, there @ there.T
        square = (z * z) @ there.T
        upper = np.triu(np.ones_like(count, dtype=bool), 1)
        total = float(count[upper].sum())
        if total >= MIN_PAIRS:
            size = float(((square * square.T)[upper & (count > 0)] / count[upper & (count > 0)]).sum())
            mean = float(product[upper].sum())
            t = mean / math.sqrt(max(size, 1e-300))
            tests.append(Check("cross", f"{kind}, all pairs", mean / max(total, 1.0), float(two_sided(np.array(t)))))
        enough = np.argwhere(upper & (count >= MIN_PAIRS))
        i, j = enough.T
        rho = product[i, j] / np.sqrt(square[i, j] * square[j, i])
        p = correlation_p(rho, count[i, j])
        for k in np.argsort(p)[:20].tolist():
            a, b = members[int(i[k])], members[int(j[k])]
            what = f"{table.channels[a].label} and {table.channels[b].label}"
            tests.append(Check("cross", what, float(rho[k]), float(p[k]), (a, b)))
        more += max(0, len(p) - 20)
    return family("cross", tests, more)


DELAY_MEMORIES: Final = (4, 16, 64)
"""Epochs over which a filter may take the constant part of a delayed position for its own."""


def delay_tests(table: Innovations) -> Family:
    """Innovations of positions and codes against changes of the velocity: what a late fix adds to them.

    A fix that is late by tau is off by -tau v; the filter takes the steady part of that for its own error, within its
    memory, so that what stays is -tau (v - mean of v over that memory). Only velocities *before* the innovation are used:
    they do not depend on it, so that the test is exact (the products are martingale differences).
    """
    tests: list[Check] = []
    rows = np.flatnonzero(
        table.used & np.isin(table.kind, (KINDS.index("code"), KINDS.index("position")))
        & np.isfinite(table.direction).all(axis=1)
    )  # fmt: skip
    if len(rows) < 3 * MIN_ROWS or len(table.velocity) != len(table.t_ns):
        return family("delay", tests)
    known = np.isfinite(table.velocity).all(axis=1)
    if not known.any() or float(np.linalg.norm(np.nan_to_num(table.velocity[known].std(axis=0)))) < 0.1:
        return family("delay", tests)  # m/s: at rest nothing shows a delay
    z = table.z[rows]
    columns = [
        -np.einsum("ij,ij->i", table.direction[rows], _change(table.velocity, known, memory)[table.epoch[rows]])
        / np.sqrt(table.s[rows])
        for memory in DELAY_MEMORIES
    ]
    g = np.stack(columns, axis=1)
    there = np.isfinite(g).all(axis=1)
    g, z = g[there], z[there]
    information, score = g.T @ g, g.T @ z
    if not (np.diag(information) > 0.0).all():
        return family("delay", tests)
    fit = np.linalg.lstsq(information, score, rcond=1e-8)
    gain = float(score @ fit[0])
    tests.append(Check("delay", "position", float(fit[0].sum()), _chi2_sf(gain, int(fit[2])), evidence=0.5 * gain))
    return family("delay", tests)


def _change(velocity: F8, known: Mask, memory: int) -> F8:
    """Velocity of the epoch before less its mean over ``memory`` epochs up to that, (m, 3)."""
    filled = np.vstack([np.zeros((1, 3)), np.cumsum(np.where(known[:, None], velocity, 0.0), axis=0)])
    count = np.concatenate([[0], np.cumsum(known)])
    last = np.arange(len(velocity))
    first = np.maximum(last - memory, 0)
    out = np.full_like(velocity, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        average = (filled[last] - filled[first]) / (count[last] - count[first])[:, None]
    out[1:] = np.where(known[:-1, None], velocity[:-1] - average[1:], np.nan)
    return out


def state_tests(table: Innovations, parts: list[Split]) -> Family:
    """Noise and states by themselves (`Split`), and the correlation of successive rows as far as they show the states."""
    tests = []
    for part in parts:
        tests.append(Check("state", f"{part.kind}, noise", part.noise, part.noise_p))
        tests.append(Check("state", f"{part.kind}, states", part.state, part.state_p))
    for part in parts:
        t, rho = state_correlation(table, part.kind, True)
        tests.append(Check("state", f"{part.kind}, states, successive", rho, float(two_sided(np.array(t)))))
    return family("state", tests)


def state_correlation(table: Innovations, kind: str, states: bool) -> tuple[float, float]:
    """Lag-1 correlation of a sensor's channels, rows weighted by the states' part (or the noise's): t and rho."""
    rows = np.flatnonzero(table.used & (table.kind == KINDS.index(kind)))
    weight = table.state_part[rows] if states else 1.0 - table.state_part[rows]
    weight = np.where(np.isfinite(weight), weight, 0.0 if states else 1.0)
    z, channel, epoch = table.z[rows], table.channel[rows], table.epoch[rows]
    next_to = (channel[1:] == channel[:-1]) & (epoch[1:] == epoch[:-1] + 1)
    w = (weight[1:] * weight[:-1])[next_to]
    product, head, tail = (z[1:] * z[:-1])[next_to], (z[:-1] ** 2)[next_to], (z[1:] ** 2)[next_to]
    scale = float((w * w * head * tail).sum())
    if not scale > 0.0:
        return 0.0, 0.0
    value = float((w * product).sum())
    size = math.sqrt(float((w * head).sum()) * float((w * tail).sum()))
    return value / math.sqrt(scale), value / size if size > 0.0 else 0.0
