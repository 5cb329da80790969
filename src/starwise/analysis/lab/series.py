"""Statistics of channels and of groups of channels: size, mean, autocorrelation, shape; all channels at a time."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.analysis.lab.innovations import Innovations
from starwise.analysis.lab.moments import NOMINAL, normal_quantile, row_moments
from starwise.types import F8, I8

BLOCK: Final = 4_000_000
"""Elements of the dense series (channels x epochs) handled at a time: 32 MB."""
LAGS: Final = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 48, 64, 80, 96, 128, 160, 192, 256, 384, 512)
"""Lags, epochs, at which autocorrelations are taken; the longest is a quarter of the run at most."""


@dataclass(frozen=True)
class Series:
    """Statistics per channel; arrays (c,), autocorrelations (c, L).

    Attributes
    ----------
    n, refused : used rows; rows outside the gate.
    square, square_mean, square_var : sum of z^2, its expectation and variance under H0.
    mean_z, bias, bias_sigma : mean of z; weighted mean of v with its standard deviation if rows are independent.
    lags : (L,) epochs.
    rho, pairs : autocorrelation of z less its mean, and the number of products.
    inside : (c, 4) share of z inside the intervals made to hold `NOMINAL`.
    skew, kurtosis : of z, 0 and 3 for a normal distribution.
    state_part : mean part of the variance that is doubt about the states, NaN: not known.
    """

    n: I8
    refused: I8
    square: F8
    square_mean: F8
    square_var: F8
    mean_z: F8
    bias: F8
    bias_sigma: F8
    lags: I8
    rho: F8
    pairs: F8
    inside: F8
    skew: F8
    kurtosis: F8
    state_part: F8

    @property
    def nis(self) -> F8:
        """Mean of z^2 over its expectation: 1 where R and P are right."""
        return np.asarray(_ratio(self.square, self.square_mean))


def _ratio(a: F8, b: F8) -> F8:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(b > 0.0, a / b, np.nan)


def lags_for(epochs: int, longer: bool = False) -> I8:
    """Lags of `LAGS` up to a quarter of the run, at least one; ``longer``: on beyond them, each half as long again.

    Errors of positions last for an hour, at 1 Hz seven times the longest of `LAGS`: a sum that ends there takes errors
    for more independent ones than they are.
    """
    lags = list(LAGS)
    while longer and lags[-1] < epochs // 4:
        lags.append(lags[-1] * 3 // 2)
    return np.array([lag for lag in lags if lag <= max(1, epochs // 4)], dtype=np.int64)


def series(table: Innovations) -> Series:
    """Statistics of every channel of a table."""
    c = len(table.channels)
    use = np.flatnonzero(table.used)
    at, z, v, s = table.channel[use], table.z[use], table.v[use], table.s[use]
    two, four = row_moments(table.gate[use], table.gate_probability)

    def total(weights: NDArray[Any]) -> F8:
        return np.asarray(np.bincount(at, weights=weights, minlength=c), dtype=np.float64)

    n = np.bincount(at, minlength=c).astype(np.int64)
    count = n.astype(np.float64)
    mean_z = _ratio(total(z), count)
    weight = total(1.0 / s)
    centred = z - mean_z[at]
    m2, m3, m4 = (_ratio(total(centred**k), count) for k in (2, 3, 4))
    slots = int(table.slot[-1]) + 1 if len(table.t_ns) else 0
    lags = lags_for(slots)
    rho, pairs = _autocorrelations(at, table.slot[table.epoch[use]], centred, c, slots, lags)
    magnitude = np.abs(z)
    return Series(
        n=n,
        refused=np.bincount(table.channel[~table.used], minlength=c).astype(np.int64),
        square=total(z * z),
        square_mean=total(two),
        square_var=total(four - two * two),
        mean_z=mean_z,
        bias=_ratio(total(v / s), weight),
        bias_sigma=np.sqrt(_ratio(np.ones(c), weight)),
        lags=lags,
        rho=rho,
        pairs=pairs,
        inside=np.stack([_ratio(total((magnitude <= normal_quantile(p)) * 1.0), count) for p in NOMINAL], axis=1),
        skew=_ratio(m3, m2**1.5),
        kurtosis=_ratio(m4, m2 * m2),
        state_part=_ratio(total(table.state_part[use]), count),
    )


def blocks(channels: int, epochs: int) -> Iterator[tuple[int, int]]:
    """Ranges of channels whose dense series fit into `BLOCK`."""
    step = max(1, BLOCK // max(epochs, 1))
    for first in range(0, channels, step):
        yield first, min(first + step, channels)


def _autocorrelations(at: I8, epoch: I8, z: F8, channels: int, epochs: int, lags: I8) -> tuple[F8, F8]:
    """Normalised autocorrelations of series with gaps, (c, L), and the numbers of their products.

    rho(l) = sum z_k z_{k+l} / sqrt(sum z_k^2 sum z_{k+l}^2)    over the k where both are there
    """
    rho, pairs = np.full((channels, len(lags)), np.nan), np.zeros((channels, len(lags)))
    edges = np.searchsorted(at, np.arange(channels + 1))
    for first, end in blocks(channels, epochs):
        rows = slice(edges[first], edges[end])
        dense, there = np.zeros((end - first, epochs)), np.zeros((end - first, epochs))
        dense[at[rows] - first, epoch[rows]] = z[rows]
        there[at[rows] - first, epoch[rows]] = 1.0
        square = dense * dense
        for i, lag in enumerate(lags.tolist()):
            count = np.einsum("ij,ij->i", there[:, :-lag], there[:, lag:])
            product = np.einsum("ij,ij->i", dense[:, :-lag], dense[:, lag:])
            head = np.einsum("ij,ij->i", square[:, :-lag], there[:, lag:])
            tail = np.einsum("ij,ij->i", there[:, :-lag], square[:, lag:])
            pairs[first:end, i] = count
            rho[first:end, i] = _ratio(product, np.sqrt(head * tail))
    return rho, pairs


def correlation_time(rho: F8, pairs: F8, lags: I8, interval_s: float) -> float:
    """Time, s, in which an autocorrelation falls to 1/e of its value at no lag; NaN if it is not above its noise.

    A Markov error beside white noise has rho(l) = a exp(-l / tau) with a < 1: a and tau are fitted to the lags, up to
    the first that is within its noise.
    """
    solid = np.isfinite(rho) & (pairs >= 8)
    noise = 1.0 / np.sqrt(np.maximum(pairs, 1.0))
    keep = []
    for i in range(len(lags)):
        if not solid[i] or rho[i] < 2.0 * noise[i]:
            break
        keep.append(i)
    if not keep:
        return math.nan
    if len(keep) == 1:
        return float(-lags[0] * interval_s / math.log(min(max(float(rho[0]), 0.05), 0.999)))
    x, y = lags[keep].astype(np.float64), np.log(rho[keep])
    w = rho[keep] ** 2 * pairs[keep]
    mean_x, mean_y = np.average(x, weights=w), np.average(y, weights=w)
    slope = float(np.average((x - mean_x) * (y - mean_y), weights=w) / np.average((x - mean_x) ** 2, weights=w))
    longest = 4.0 * float(lags[keep[-1]])
    return interval_s * (min(-1.0 / slope, longest) if slope < 0.0 else longest)


def effective_share(rho: F8, lags: I8) -> float:
    """Part of the rows that count as independent for a mean: 1 / (1 + 2 sum rho).

    The sum is over all lags up to the first that is not positive, interpolated between those taken (Bayley, Hammersley
    1946).
    """
    total, before, at = 0.0, 1.0, 0
    for lag, value in zip(lags.tolist(), rho.tolist(), strict=True):
        if not value > 0.0:
            break
        total += (lag - at) * value if lag - at == 1 else 0.5 * (lag - at) * (before + value)
        before, at = value, lag
    return 1.0 / (1.0 + 2.0 * total)
