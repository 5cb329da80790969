"""Local filters of a run: the rows of one receiver clock each, with a share of what all constellations have in common.

Common are the motion and, with coloured errors, the states of the sky (troposphere, ionosphere, antenna); a clock,
receiver code biases and the satellites' own states are private. Prior and process variances of the common states are
those of the run over the filter's share: then local filters without feedback may be fused as if independent (Carlson
1990; the joint covariance is bounded by its blocks over the shares). Sky states have unit variance in the kernel and
their size in the measurement, so a share of them is a larger size there.
"""

import math
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.config import RunConfig
from starwise.constants import EPOCH_NO_SOLUTION, ROW_USED
from starwise.estimators.filter import LOOSE_CLOCK_M, filter_options
from starwise.estimators.least_squares import empty_epochs, least_squares, spp_options
from starwise.kernels.error_states import N_SKY, ErrorModel, ErrorRows
from starwise.kernels.filter_run import filter_run
from starwise.kernels.filter_state import FilterOptions
from starwise.kernels.process import Process
from starwise.kernels.rangemodel import Epochs, ModelOptions, RowModel, Rows
from starwise.kernels.spp import EpochOut, SppOptions
from starwise.models.process import clocks_from, motion_from, process_numbers
from starwise.models.pseudorange import Prepared, empty_row_model
from starwise.types import F8, I8

SPARE_SLOTS = 8
"""Satellites that just left and keep their states, beside those in view."""
SEED_SIGMA_M = 1000.0
"""Position of a local filter that cannot start alone: its place is where ranges are made linear, not information."""
SEED_CLOCK_M = 1e6
NEVER = 1 << 30
"""Few satellites, one of them refused, are no reason to start anew from them: the others check the filter."""


@dataclass(frozen=True)
class Numbers:
    """Arguments of the kernel that do not change over epochs."""

    model: ModelOptions
    spp: SppOptions
    process: Process
    options: FilterOptions
    errors: ErrorModel
    slots: int


@dataclass(frozen=True)
class Local:
    """A local filter: rows of one receiver clock, and what came out of them.

    Attributes
    ----------
    name : str
        Letter of its satellite system.
    share : float
    at : (n,) intp
        Its rows among those of the run.
    sv : (n,)
        Satellite of each row.
    epochs, rows, extra
        Its input; epochs are all of the run.
    numbers : Numbers
    ep, out
        Its output, rows as ``at``.
    common, common_cov : (m, k), (m, k, k)
        Motion and sky states per epoch, in the units of the run's error model; NaN: no solution.
    scale : (k,)
        Those units per unit of the local kernel.
    """

    name: str
    share: float
    at: NDArray[np.intp]
    sv: I8
    epochs: Epochs
    rows: Rows
    extra: ErrorRows
    numbers: Numbers
    ep: EpochOut
    out: RowModel
    common: F8
    common_cov: F8
    scale: F8

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Epochs with a belief."""
        return np.asarray(self.ep.status != EPOCH_NO_SOLUTION)

    def run(self, first: int = 0, seed: F8 | None = None) -> None:
        """Filter all epochs from ``first`` on, forgetting what was before; a position ECEF m, ``seed``, helps to start.

        Without it least squares over its own satellites starts the filter.
        """
        n, k = len(self.epochs.t_ns), self.common.shape[1]
        if first >= n:
            return
        nk = self.numbers.process.nk
        start = int(self.epochs.offsets[first])
        epochs = Epochs(self.epochs.t_ns[first:], self.epochs.offsets[first:] - start)
        x0, P0 = np.full(nk + 2, np.nan), np.zeros((nk + 2, nk + 2))
        if seed is not None:
            o = self.numbers.options
            sigmas = [SEED_SIGMA_M] * 3 + [o.velocity_sigma0] * 3 + [o.acceleration_sigma0] * 3
            x0 = np.concatenate([seed, np.zeros(nk - 1)])
            P0 = np.diag(np.square([*sigmas[:nk], SEED_CLOCK_M, o.drift_sigma0]))
        part = EpochOut._make(a[first:] for a in self.ep)
        whole: tuple[NDArray[Any], ...] = part
        for target, value in zip(whole, empty_epochs(n - first, 1), strict=True):
            target[...] = value
        common, cov = self.common[first:], self.common_cov[first:]
        common[...], cov[...] = np.nan, np.nan
        extra = ErrorRows._make(a[start:] for a in self.extra)
        filter_run(
            self.numbers.model, self.numbers.spp, self.numbers.process, self.numbers.options, epochs,
            Rows._make(a[start:] for a in self.rows), x0, P0, self.numbers.errors, extra, self.numbers.slots,
            part, RowModel._make(a[start:] for a in self.out), common, cov,
        )  # fmt: skip
        common *= self.scale
        cov *= self.scale[:, None] * self.scale[None, :]
        assert common.shape[1] == k


def information_shares(prepared: Prepared) -> F8:
    """Shares by what the constellations' codes are worth: usable rows over their variance; (n_clocks,), sum 1.

    No share is below a tenth of an equal one: what is common would then be noise to that filter.
    Rows of the whole run count, also later ones: shares must not change while beliefs without reset are fused.
    """
    use = prepared.rows.status == ROW_USED
    rows, p = prepared.rows, prepared.errors
    if p.on:
        var = prepared.error_rows.slow_m**2 + p.signal_bias[rows.system] ** 2 + p.multipath_sigma[rows.system] ** 2
    else:
        var = rows.sigma_sat_m**2 + prepared.options.code_sigma[rows.system] ** 2
    n = len(prepared.clock_names)
    worth = np.bincount(rows.clock[use], weights=1.0 / (var[use] + 0.01), minlength=n)
    if not worth.sum() > 0.0:
        return np.full(n, 1.0 / n)
    shares = np.maximum(worth / worth.sum(), 0.1 / n)
    return np.asarray(shares / shares.sum())


def shared(errors: ErrorModel, share: float) -> ErrorModel:
    """Error model of a local filter: the sky's variances over its share."""
    s = 1.0 / math.sqrt(share)
    return errors._replace(
        troposphere=s * errors.troposphere,
        vertical_fraction=s * errors.vertical_fraction,
        vertical_floor=s * errors.vertical_floor,
        vertical_unknown=s * errors.vertical_unknown,
        gradient_fraction=s * errors.gradient_fraction,
        gradient_floor=s * errors.gradient_floor,
        slope=s * errors.slope,
    )


def make_locals(prepared: Prepared, config: RunConfig, shares: F8) -> list[Local]:
    """A local filter for every receiver clock of a run; nothing has been computed yet."""
    motion, clocks = motion_from(config), clocks_from(config)
    process, options = process_numbers(motion, clocks), filter_options(config, motion, clocks)
    nk, n_epochs = motion.nk, len(prepared.epochs.t_ns)
    spp = spp_options(config)
    made = []
    for k, (name, share) in enumerate(zip(prepared.clock_names, shares.tolist(), strict=True)):
        at = np.flatnonzero(prepared.rows.clock == k)
        offsets = np.searchsorted(at, prepared.epochs.offsets).astype(np.int64)
        rows = Rows._make(np.ascontiguousarray(a[at]) for a in prepared.rows)._replace(
            clock=np.zeros(len(at), np.int64)
        )
        extra, errors = prepared.error_rows, prepared.errors
        scale = np.ones(nk)
        if errors.on:
            extra, n_bias = _own_biases(ErrorRows._make(np.ascontiguousarray(a[at]) for a in extra))
            errors = shared(errors, share)._replace(n_bias=n_bias)
            scale = np.concatenate([scale, np.full(N_SKY, 1.0 / math.sqrt(share))])
        s = 1.0 / math.sqrt(share)
        numbers = Numbers(
            prepared.options,
            spp,
            process._replace(horizontal=process.horizontal / share, vertical=process.vertical / share),
            options._replace(
                velocity_sigma0=s * options.velocity_sigma0,
                acceleration_sigma0=s * options.acceleration_sigma0,
                clock_loose_m=LOOSE_CLOCK_M,
                weak_patience=NEVER,
            ),
            errors,
            int(np.diff(offsets).max(initial=0)) + SPARE_SLOTS,
        )
        n = len(scale)
        made.append(
            Local(
                name, share, at, prepared.sightings.sv[at].astype(np.int64), Epochs(prepared.epochs.t_ns, offsets),
                rows, extra, numbers, empty_epochs(n_epochs, 1), empty_row_model(len(at)),
                np.full((n_epochs, n), np.nan), np.full((n_epochs, n, n), np.nan), scale,
            )
        )  # fmt: skip
    return made


def _own_biases(extra: ErrorRows) -> tuple[ErrorRows, int]:
    """Receiver code biases numbered anew: those of these rows alone."""
    used = np.unique(np.concatenate([extra.bias1, extra.bias2]))
    used = used[used >= 0]

    def renumbered(bias: I8) -> I8:
        return np.where(bias >= 0, np.searchsorted(used, bias), -1).astype(np.int64)

    return extra._replace(bias1=renumbered(extra.bias1), bias2=renumbered(extra.bias2)), len(used)


def run_locals(made: Sequence[Local], prepared: Prepared, config: RunConfig, threads: int | None = None) -> None:
    """Run all local filters, in parallel threads (the kernel holds no lock of the interpreter).

    A constellation with too few satellites to start by itself starts about the position of another one, or of least
    squares over all of them, a kilometre wide: from there on it contributes what it has.
    """
    workers = threads or min(len(made), os.cpu_count() or 1)
    _each(lambda local: local.run(), made, workers)
    late = [local for local in made if _waited(local)]
    if not late:
        return
    pos = np.full((len(prepared.epochs.t_ns), 3), np.nan)
    for local in made:
        free = ~np.isfinite(pos[:, 0]) & local.solved
        pos[free] = local.common[free, :3]
    if not np.isfinite(pos[:, 0]).any():
        pos = least_squares(prepared, config)[0].pos
    known = np.flatnonzero(np.isfinite(pos[:, 0]))
    if len(known):
        first = int(known[0])
        _each(lambda local: local.run(first, pos[first]), late, workers)


def _waited(local: Local) -> bool:
    """Whether a filter had rows before it could start."""
    has = np.flatnonzero(np.diff(local.epochs.offsets) > 0)
    solved = np.flatnonzero(local.solved)
    return len(has) > 0 and (len(solved) == 0 or solved[0] > has[0])


def _each(work: Callable[[Local], None], made: Iterable[Local], workers: int) -> None:
    if workers <= 1:
        for local in made:
            work(local)
        return
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, sorted(made, key=lambda local: -len(local.at))))  # the longest first
