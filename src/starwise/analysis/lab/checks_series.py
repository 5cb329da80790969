"""Tests of means, correlations and shapes of innovations, by families (see `starwise.analysis.lab.checks`)."""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.analysis.lab.checks import MIN_ROWS, Check, Family, Split, chi2_tail, family
from starwise.analysis.lab.innovations import KINDS, Innovations
from starwise.analysis.lab.moments import correlation_p, kurtosis_moments, two_sided
from starwise.analysis.lab.series import Series
from starwise.analysis.threads import one_thread
from starwise.types import F8, I8

MIN_PAIRS: Final = 20
MAX_PAIRED: Final = 120
"""Channels of a sensor that are correlated with each other, those with the most rows."""


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
    """Autocorrelation of sensors (all lags together, and the first), and of each channel at its first lag.

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
        p = float(chi2_tail(float((t[ok] ** 2).sum()), int(ok.sum())))
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
    """Chance of as many or more."""
    from scipy.special import gammainc

    return float(gammainc(count, mean)) if count > 0 else 1.0


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
        with one_thread():
            product, count, square = z @ z.T, there @ there.T, (z * z) @ there.T
        upper = np.triu(np.ones_like(count, dtype=bool), 1)
        total = float(count[upper].sum())
        if total >= MIN_PAIRS:
            size = float(((square * square.T)[upper & (count > 0)] / count[upper & (count > 0)]).sum())
            mean = float(product[upper].sum())
            t = mean / math.sqrt(max(size, 1e-300))
            rho = mean / math.sqrt(max(size * total, 1e-300))
            tests.append(Check("cross", f"{kind}, all pairs", rho, float(two_sided(np.array(t)))))
        enough = np.argwhere(upper & (count >= MIN_PAIRS))
        i, j = enough.T
        with np.errstate(divide="ignore", invalid="ignore"):
            pair = product[i, j] / np.sqrt(square[i, j] * square[j, i])
        p = correlation_p(pair, count[i, j])
        for k in np.argsort(p)[:20].tolist():
            a, b = members[int(i[k])], members[int(j[k])]
            what = f"{table.channels[a].label} and {table.channels[b].label}"
            tests.append(Check("cross", what, float(pair[k]), float(p[k]), (a, b)))
        more += max(0, len(p) - 20)
    return family("cross", tests, more)


DELAY_MEMORIES: Final = (4, 16, 64)
"""Epochs over which a filter may take the constant part of a delayed position for its own."""


def delay_tests(table: Innovations) -> Family:
    """Innovations of positions and codes against changes of the velocity: what a late fix adds to them.

    A fix that is late by tau is off by -tau v; the filter takes the steady part of that for its own error, within its
    memory, so that what stays is -tau (v - mean of v over that memory). Only velocities *before* the innovation are
    used: they do not depend on it, so that the test is exact (the products are martingale differences).
    """
    tests: list[Check] = []
    rows = np.flatnonzero(
        table.used & np.isin(table.kind, (KINDS.index("code"), KINDS.index("position")))
        & np.isfinite(table.direction).all(axis=1)
    )  # fmt: skip
    if len(rows) < 3 * MIN_ROWS or len(table.velocity) != len(table.t_ns):
        return family("delay", tests)
    known: NDArray[np.bool_] = np.asarray(np.isfinite(table.velocity).all(axis=1))
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
    alone = score / np.diag(information)
    size = float(alone[np.argmax(alone * score)])  # of the memory that fits best; all together share it unsteadily
    tests.append(Check("delay", "position", size, chi2_tail(gain, int(fit[2])), evidence=0.5 * gain))
    return family("delay", tests)


def _change(velocity: F8, known: NDArray[Any], memory: int) -> F8:
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
    """Noise and states by themselves (`Split`), and how successive rows go together as far as they show the states."""
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
    z, channel, epoch = table.z[rows], table.channel[rows], table.slot[table.epoch[rows]]
    next_to = (channel[1:] == channel[:-1]) & (epoch[1:] == epoch[:-1] + 1)
    w = (weight[1:] * weight[:-1])[next_to]
    product, head, tail = (z[1:] * z[:-1])[next_to], (z[:-1] ** 2)[next_to], (z[1:] ** 2)[next_to]
    scale = float((w * w * head * tail).sum())
    if not scale > 0.0:
        return 0.0, 0.0
    value = float((w * product).sum())
    size = math.sqrt(float((w * head).sum()) * float((w * tail).sum()))
    return value / math.sqrt(scale), value / size if size > 0.0 else 0.0
