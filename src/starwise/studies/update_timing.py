"""Measured time of one measurement update: batch, sequential and compressed, equally compiled."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from starwise.constants import C_LIGHT
from starwise.errors import StarwiseError
from starwise.kernels.turns import turns_batch, turns_compressed, turns_empty, turns_sequential
from starwise.types import F8, I8, U1

SATELLITES: Final = (4, 5, 6, 7, 8, 10, 12, 15, 20, 25, 30, 40, 50, 60)
NK: Final = 9
GATES: Final = (20.0, 25.0)
"""Chi-square thresholds that no sound row fails; batch and sequential test every satellite against them."""


@dataclass(frozen=True)
class Problem:
    """One measurement update: prediction, rows, and room for the answer."""

    n: int
    x: F8
    P: F8
    P0: F8
    ic: I8
    idr: I8
    u: F8
    g: F8
    v: F8
    r: F8
    v_out: F8
    s_out: F8
    used: U1

    @property
    def rows(self) -> tuple[Any, ...]:
        """Arguments of the kernels that describe the satellites."""
        return self.ic, self.idr, self.u, self.g, self.v, self.r, len(self.u)


def make_problem(m: int, clocks: int, rng: np.random.Generator) -> Problem:
    """A sky of ``m`` satellites, 6 m and 0.1 m/s of noise, and a covariance as filters have before an update."""
    n = NK + 2 * clocks
    az, el = rng.uniform(0.0, 2.0 * np.pi, m), rng.uniform(0.1, 1.5, m)
    u = np.column_stack([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)])
    scale = np.array([5.0] * 3 + [0.5] * 3 + [1.0] * 3 + [10.0] * clocks + [0.5] * clocks)
    A = rng.normal(size=(n, n))
    P0 = scale[:, None] * (np.eye(n) + A @ A.T / n) * scale
    ic = NK + np.arange(m, dtype=np.int64) % clocks
    r = np.tile([36.0, 0.01], (m, 1))
    g = rng.normal(size=(m, 3)) * 3e4 / C_LIGHT
    e = np.linalg.cholesky(P0) @ rng.normal(size=n)
    v = np.column_stack([e[ic] - u @ e[:3], e[ic + clocks] + g @ e[:3] - np.einsum("ij,j->i", u, e[3:6])])
    v += np.sqrt(r) * rng.normal(size=(m, 2))
    room = (np.empty((m, 2)), np.empty((m, 2)), np.empty(m, np.uint8))
    return Problem(n, np.zeros(n), P0.copy(), P0, ic, ic + clocks, u, g, v, r, *room)


def time_updates(satellites: Sequence[int] = SATELLITES, clocks: int = 2, repeats: int = 41) -> list[dict[str, float]]:
    """Microseconds of one update by number of satellites.

    The fastest of interleaved repeats of a compiled loop of about a millisecond (what is slower was interrupted);
    restoring x and P for the next turn is timed alone and taken off. The three answers are compared before anything
    is timed.

    Returns
    -------
    list of dict
        ``n``, ``batch_us``, ``sequential_us``, ``compressed_us``, ``sequential_over_batch``,
        ``compressed_over_sequential``.

    Raises
    ------
    StarwiseError
        The three do not give the same answer.
    """
    rng = np.random.default_rng(1)
    return [_time(m, clocks, rng, repeats) for m in satellites]


def _time(m: int, clocks: int, rng: np.random.Generator, repeats: int) -> dict[str, float]:
    p = make_problem(m, clocks, rng)
    head: tuple[Any, ...] = (p.n, p.x, p.P, p.P0)
    gates: tuple[Any, ...] = (*GATES, p.v_out, p.s_out, p.used)
    turns = max(10, 1500 // m)
    calls: dict[str, Callable[[int], None]] = {
        "empty": lambda k: turns_empty(k, *head),
        "batch": lambda k: turns_batch(k, *head, *p.rows, *gates),
        "sequential": lambda k: turns_sequential(k, *head, *p.rows, *gates),
        "compressed": lambda k: turns_compressed(k, p.n, NK, *head[1:], *p.rows),
    }
    answers = {}
    for name, call in calls.items():
        call(1)
        answers[name] = (p.x.copy(), p.P.copy())
    for name in ("sequential", "compressed"):
        for a, b in zip(answers[name], answers["batch"], strict=True):
            if not np.abs(a - b).max() < 1e-7:  # rounding on states of metres
                raise StarwiseError(f"the {name} update differs from the batch update", found=f"{m} satellites")
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            start = time.perf_counter()
            call(turns)
            times[name].append((time.perf_counter() - start) / turns * 1e6)
    least = {name: min(values) for name, values in times.items()}
    net = {name: max(least[name] - least["empty"], 1e-3) for name in ("batch", "sequential", "compressed")}
    return {
        "n": m,
        "batch_us": net["batch"],
        "sequential_us": net["sequential"],
        "compressed_us": net["compressed"],
        "sequential_over_batch": net["sequential"] / net["batch"],
        "compressed_over_sequential": net["compressed"] / net["sequential"],
    }
