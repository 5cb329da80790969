"""Measurements that come late: one interface to five ways of using them, and a wrapper that replays any filter.

`run_late` is for linear systems (error states around a nominal trajectory among them), compiled. `Replay` puts late
measurements of any kind, a satellite epoch for example, into any filter that can say what its belief becomes: kept
checkpoints make the result that of a filter which had everything in order.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Generic, Literal, TypeVar

import numpy as np

from starwise.errors import StarwiseError
from starwise.kernels import late
from starwise.types import F8, I8, Fixes

LateMethod = Literal["ignored", "optimal_prediction", "replay", "cloning", "estimated"]
METHODS: Final[dict[str, int]] = {
    "ignored": late.IGNORED,
    "optimal_prediction": late.OPTIMAL_PREDICTION,
    "replay": late.REPLAY,
    "cloning": late.CLONING,
    "estimated": late.ESTIMATED,
}


@dataclass(frozen=True)
class LinearSystem:
    """Linear system on evenly spaced steps, x the error around a nominal trajectory.

        x_{j+1} = Phi_j x_j + w_j,   w_j ~ N(0, Q_j)

    Attributes
    ----------
    Phi, Q : (T, n, n) float64
        From step j to j + 1.
    step_s : float
        Length of a step, s.
    nominal : (T + 1, m) float64 or None
        What a measurement would be on the nominal trajectory, by step; None: x is the whole state.
    """

    Phi: F8
    Q: F8
    step_s: float
    nominal: F8 | None = None


@dataclass(frozen=True)
class LateRows:
    """Measurements ``y = nominal(valid) + H x(valid) + noise``, in any order.

    Attributes
    ----------
    valid, there : (F,) int64
        Steps at which they are valid (as the filter believes) and from which on they can be used.
    y : (F, m) float64
        NaN: no such row.
    H : (F, m, n) float64
    r : (F, m) float64
        Variances; errors of rows are uncorrelated (whiten before).
    """

    valid: I8
    there: I8
    y: F8
    H: F8
    r: F8


@dataclass(frozen=True)
class DelayPrior:
    """What is known of a delay that is to be estimated: Gaussian, s, with a random walk of ``walk`` s/sqrt(s)."""

    mean_s: float = 0.5
    sigma_s: float = 1.0
    walk: float = 0.0
    longest_s: float = 10.0


@dataclass(frozen=True)
class LateRun:
    """Beliefs by step and innovations by measurement (in the order of arrival).

    Attributes
    ----------
    x : (T + 1, n), P : (T + 1, n, n)
        With all that was there by then.
    v : (F, m), S : (F, m, m)
    nis : (F,) float64
    dof : (F,) int64
    delay_s, delay_sigma_s : (F,)
        Method ``estimated``, else NaN.
    order : (F,) int64
        Index of each measurement in the rows that were given.
    """

    x: F8
    P: F8
    v: F8
    S: F8
    nis: F8
    dof: I8
    delay_s: F8
    delay_sigma_s: F8
    order: I8


def run_late(
    system: LinearSystem,
    rows: LateRows,
    x0: F8,
    P0: F8,
    method: LateMethod = "replay",
    delay: DelayPrior | None = None,
) -> LateRun:
    """Beliefs of all steps, each with what was there by then.

    Parameters
    ----------
    system, rows
    x0 : (n,), P0 : (n, n)
        Belief at step 0.
    method : {"ignored", "optimal_prediction", "replay", "cloning", "estimated"}
        See `starwise.kernels.late`. All but ``ignored`` and ``estimated`` use ``rows.valid``; ``replay`` and
        ``cloning`` are exact for any delays, ``optimal_prediction`` as long as they come in order.
    delay : DelayPrior, optional
        Method ``estimated``.

    Raises
    ------
    StarwiseError
        Unknown method; a measurement that is there before it is valid, or outside the steps; zero variance.
    """
    if method not in METHODS:
        raise StarwiseError("no such way with late measurements", found=str(method), wanted=" | ".join(METHODS))
    T, n = system.Phi.shape[0], len(x0)
    F, m = rows.y.shape
    if F and (rows.valid.min() < 0 or rows.there.max() > T or (rows.there < rows.valid).any()):
        raise StarwiseError("late measurements: steps out of order", wanted=f"0 <= valid <= there <= {T}")
    if not (rows.r[np.isfinite(rows.y)] > 0.0).all():
        raise StarwiseError("a measurement with zero or no variance", wanted="positive variances")
    order = np.lexsort((rows.valid, rows.there)).astype(np.int64)
    kernel_rows = late.LateRows(
        rows.valid[order].astype(np.int64), rows.there[order].astype(np.int64), _c(rows.y[order]), _c(rows.H[order]),
        _c(rows.r[order]),
    )  # fmt: skip
    nominal = np.zeros((T + 1, m)) if system.nominal is None else system.nominal
    prior = delay or DelayPrior()
    walk = prior.walk**2 * system.step_s
    out = late.LateOut(
        np.empty((T + 1, n)), np.empty((T + 1, n, n)), np.full((F, m), np.nan), np.full((F, m, m), np.nan),
        np.full((F, 2), np.nan),
    )  # fmt: skip
    late.late_run(
        METHODS[method],
        late.LateSystem(_c(system.Phi), _c(system.Q), _c(nominal), system.step_s),
        kernel_rows,
        _c(x0),
        _c(P0),
        _outstanding(kernel_rows),
        late.LateDelay(prior.mean_s, prior.sigma_s, walk, prior.longest_s),
        out,
    )
    nis, dof = _nis(out.v, out.S)
    return LateRun(out.x, out.P, out.v, out.S, nis, dof, out.delay[:, 0], out.delay[:, 1], order)


def delay_response(system: LinearSystem, rows: LateRows, P0: F8, method: LateMethod, rate: F8) -> tuple[F8, F8]:
    """What a delay of 1 s that the filter does not know adds to its innovations and to its last belief.

    The filter is linear: its answer to the change of the measurements alone is the filter run on that change.

    Parameters
    ----------
    system, rows, P0, method
        As in `run_late` (not ``estimated``).
    rate : (T + 1, m)
        Rate of change of what is measured, per s, by step: the velocity of the nominal trajectory.

    Returns
    -------
    signature : (F, m)
        For `starwise.analysis.consistency.known_fault`, row-aligned with `LateRun.v`.
    effect : (T + 1, n)
        On the estimates.
    """
    at = rows.there if method == "ignored" else rows.valid
    changed = LateRows(rows.valid, rows.there, np.where(np.isnan(rows.y), np.nan, -rate[at]), rows.H, rows.r)
    run = run_late(LinearSystem(system.Phi, system.Q, system.step_s), changed, np.zeros(P0.shape[0]), P0, method)
    return run.v, run.x


def steps_of(fixes: Fixes, start_ns: int, step_s: float) -> tuple[I8, I8]:
    """Steps at which fixes are valid (nearest) and from which on they can be used (the next one).

    Raises
    ------
    StarwiseError
        A fix that is there before it is valid.
    """
    early = fixes.available_ns < fixes.t_ns
    if early.any():
        raise StarwiseError(
            "a fix is there before the time it is valid for",
            found=f"{int(early.sum())} fixes",
            wanted="available later",
        )
    step_ns = round(step_s * 1e9)
    valid = np.rint((fixes.t_ns - start_ns) / step_ns).astype(np.int64)
    return valid, np.maximum(-((start_ns - fixes.available_ns) // step_ns), valid)


def _c(a: F8) -> F8:
    return np.ascontiguousarray(a, dtype=np.float64)


def _outstanding(rows: late.LateRows) -> int:
    """Most measurements that are taken and not there, at any step."""
    taken, there = np.sort(rows.valid), np.sort(rows.there)
    if not len(taken):
        return 1
    # clones of a step are made before its answers are used
    return max(1, int((np.searchsorted(taken, taken, "right") - np.searchsorted(there, taken, "left")).max()))


def _nis(v: F8, S: F8) -> tuple[F8, I8]:
    nis, dof = np.full(len(v), np.nan), np.isfinite(v).sum(axis=1)
    for k in np.flatnonzero(dof):
        a = np.isfinite(v[k])
        nis[k] = v[k][a] @ np.linalg.solve(S[k][np.ix_(a, a)], v[k][a])
    return nis, dof.astype(np.int64)


B = TypeVar("B")


@dataclass
class Replay(Generic[B]):
    """Late measurements put into any filter at the time they belong to.

    The filter is two functions without memory. Law: after any sequence of measurements the belief is that of a filter
    which got them in the order of their times (ties in the order of arrival), to the last digit.

    Attributes
    ----------
    t_ns : int
        Present time.
    belief : B
        Present belief.
    predict : callable
        ``predict(belief, from_ns, to_ns) -> belief``; must not change its argument.
    memory_s : float
        How far back checkpoints are kept; what is older than that is refused.
    """

    t_ns: int
    belief: B
    predict: Callable[[B, int, int], B]
    memory_s: float = 10.0
    refused: int = 0
    """Measurements that were older than the memory."""
    _times: list[int] = field(default_factory=list)
    _updates: list[Callable[[B], B]] = field(default_factory=list)
    _after: list[B] = field(default_factory=list)
    _base: tuple[int, B] | None = None

    def __post_init__(self) -> None:
        self._base = (self.t_ns, self.belief)

    def advance(self, t_ns: int) -> B:
        """Belief at a later time.

        Raises
        ------
        ValueError
            Time runs back.
        """
        if t_ns < self.t_ns:
            raise ValueError(f"time runs back from {self.t_ns} to {t_ns}")
        self.t_ns = t_ns
        keep = bisect_left(self._times, t_ns - round(self.memory_s * 1e9))
        if keep > 0:
            self._base = (self._times[keep - 1], self._after[keep - 1])
            del self._times[:keep], self._updates[:keep], self._after[:keep]
        at, belief = (self._times[-1], self._after[-1]) if self._times else self._checkpoint()
        self.belief = self.predict(belief, at, t_ns)
        return self.belief

    def add(self, valid_ns: int, update: Callable[[B], B]) -> bool:
        """Put in a measurement that has just come; False if it is older than the memory.

        Parameters
        ----------
        valid_ns : int
            Time it is valid for, not after the present.
        update : callable
            ``update(belief at valid_ns) -> belief``.

        Raises
        ------
        ValueError
            The measurement is of the future.
        """
        if valid_ns > self.t_ns:
            raise ValueError(f"valid at {valid_ns}, after the present {self.t_ns}")
        if valid_ns < self._checkpoint()[0]:
            self.refused += 1
            return False
        k = bisect_right(self._times, valid_ns)
        self._times.insert(k, valid_ns)
        self._updates.insert(k, update)
        at, belief = (self._times[k - 1], self._after[k - 1]) if k > 0 else self._checkpoint()
        del self._after[k:]
        for t, again in zip(self._times[k:], self._updates[k:], strict=True):
            belief = again(self.predict(belief, at, t))
            self._after.append(belief)
            at = t
        self.belief = self.predict(belief, at, self.t_ns)
        return True

    def _checkpoint(self) -> tuple[int, B]:
        assert self._base is not None
        return self._base
