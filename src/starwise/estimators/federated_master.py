"""The master of a run's local filters: fusion in information form, and who contradicts the others.

Arrays run over epochs, then local filters. Deviations count from a base per epoch, one of the local filters' own
means: sums of information times ECEF coordinates would lose eight digits. The equations are those of
`starwise.kernels.federated`, here for all epochs at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from starwise.estimators.federated_local import Local
from starwise.types import F8

B1 = NDArray[np.bool_]


@dataclass(frozen=True)
class Beliefs:
    """Beliefs of K local filters of their common states at m epochs.

    Attributes
    ----------
    known : (m, K) bool
        The local filter has one.
    base : (m, n)
    dx : (m, K, n)
        Mean less base; zero where not known.
    P, info : (m, K, n, n)
        Covariance and its inverse; info is zero where not known.
    """

    known: B1
    base: F8
    dx: F8
    P: F8
    info: F8


def inverse(A: F8) -> F8:
    """Inverse of symmetric positive definite matrices (..., n, n) of elements of very different size; NaN: of NaN."""
    d = np.sqrt(np.diagonal(A, axis1=-2, axis2=-1))
    d = np.where(d > 0.0, d, 1.0)
    scaled = A / (d[..., :, None] * d[..., None, :])
    n = A.shape[-1]
    result = np.linalg.inv(scaled + 1e-14 * np.eye(n)) / (d[..., :, None] * d[..., None, :])
    return np.asarray(0.5 * (result + np.swapaxes(result, -1, -2)))


def beliefs(made: Sequence[Local], first: int = 0, end: int | None = None) -> Beliefs:
    """Beliefs of the local filters of some epochs, all by default."""
    part = slice(first, end)
    known = np.stack([local.solved[part] & np.isfinite(local.common[part, 0]) for local in made], axis=1)
    x = np.stack([local.common[part] for local in made], axis=1)
    P = np.stack([local.common_cov[part] for local in made], axis=1)
    m, n = len(known), x.shape[2]
    lead = np.argmax(known, axis=1)
    base = np.where(np.asarray(known.any(axis=1))[:, None], x[np.arange(m), lead], 0.0)
    dx = np.where(known[:, :, None], x - base[:, None, :], 0.0)
    P = np.where(known[:, :, None, None], P, np.eye(n))
    info = np.where(known[:, :, None, None], inverse(P), 0.0)
    return Beliefs(known, base, dx, P, info)


def fuse(b: Beliefs, use: B1) -> tuple[F8, F8]:
    """Fused mean (m, n) and covariance (m, n, n) of the local filters in ``use`` (m, K); NaN where there is none."""
    weight: B1 = np.logical_and(use, b.known)[:, :, None, None]
    total = np.sum(weight * b.info, axis=1)
    eta = np.einsum("mkij,mkj->mi", weight * b.info, b.dx)
    some = np.asarray((use & b.known).any(axis=1))
    n = total.shape[1]
    P = inverse(np.where(some[:, None, None], total, np.eye(n)))
    x = b.base + (P @ eta[:, :, None])[:, :, 0]
    P[~some], x[~some] = np.nan, np.nan
    return x, P


def separations(b: Beliefs, use: B1, floor_m: float) -> F8:
    """Squared distance of every local position from the fusion of the others in ``use``, over both covariances; (m, K).

    Chi-square with three degrees of freedom where errors are as claimed; NaN where there is nothing to compare with.
    ``floor_m`` per axis is the error that no state describes.
    """
    m, K = use.shape
    out = np.full((m, K), np.nan)
    floor = 2.0 * floor_m**2 * np.eye(3)
    weight: B1 = np.asarray(use & b.known)
    for k in range(K):
        others = weight.copy()
        others[:, k] = False
        at = np.flatnonzero(b.known[:, k] & others.any(axis=1))
        if not len(at):
            continue
        part = Beliefs(b.known[at], b.base[at], b.dx[at], b.P[at], b.info[at])
        x, P = fuse(part, others[at])
        d = (part.base + part.dx[:, k] - x)[:, :3]
        S = P[:, :3, :3] + part.P[:, k, :3, :3] + floor
        out[at, k] = np.einsum("mi,mi->m", d, np.linalg.solve(S, d[:, :, None])[:, :, 0])
    return out
