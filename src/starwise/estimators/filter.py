"""EKF and S3EKF over a whole run: configuration to numbers, then `starwise.kernels.filter_run`."""

import numpy as np

from starwise.config import RunConfig
from starwise.estimators.adaptive import RULES
from starwise.estimators.least_squares import chi_square_table, empty_epochs, spp_options
from starwise.kernels.error_states import ErrorModel, ErrorRows
from starwise.kernels.filter_run import filter_run
from starwise.kernels.filter_state import FilterOptions
from starwise.kernels.rangemodel import Epochs, ModelOptions, RowModel, Rows
from starwise.kernels.spp import FILTER_RATES_IGNORED, EpochOut
from starwise.models.error_model import MAX_SLOTS, no_errors
from starwise.models.process import Clocks, Motion, clocks_from, motion_from, process_numbers
from starwise.models.pseudorange import Prepared, empty_row_model
from starwise.types import F8

EPOCH_FALSE_ALARM = 1e-5
"""Chance that an epoch whose errors are as modelled fails the whole-epoch test."""
PATIENCE = 3
"""Consecutive failed epochs after which the filter is declared lost: chance 1e-15, while an outage of good
measurements (a tunnel's end, a turn) rarely lasts longer than it."""

LOOSE_CLOCK_M = 3.0
"""Where a clock has been predicted worse than this and faults are to be named, the satellite nearest to the median
comes first: the fault of the first, or of the best constellation, would else pass as the clock's."""


def filter_options(config: RunConfig, motion: Motion, clocks: Clocks) -> FilterOptions:
    """Numbers of the filter out of a configuration."""
    gate = chi_square_table(config.gate_probability, 3)
    return FilterOptions(
        sequential=config.method != "ekf",
        gate1=float(gate[1]),
        gate2=float(gate[2]),
        chi2=chi_square_table(EPOCH_FALSE_ALARM, 400),
        patience=PATIENCE,
        weak_patience=2 * PATIENCE,
        velocity_sigma0=motion.velocity_sigma0,
        acceleration_sigma0=motion.acceleration_sigma0,
        drift_sigma0=clocks.drift_sigma0,
        intersystem_sigma0=clocks.intersystem_sigma0,
        intersystem_drift_sigma0=clocks.intersystem_drift_sigma0,
        # a bad satellite of 100 m would still pass as a clock error
        clock_loose_m=LOOSE_CLOCK_M if config.clock.isolate else 100.0,
        # Least squares from nothing is better: ranges bend by dx^2 / (2 rho), 2 m at 10 km, 0.2 m at 3 km (the coloured
        # update is not iterated).
        lost_sigma_m=3_000.0 if config.error_model == "colored" else 10_000.0,
        memoryless=config.method == "lsq",
        rule=RULES[config.adaptation].numbers(),
        absent_s=3600.0,  # the inter-system bias is still known to 0.3 m then; the state stays small
    )


def run_filter(prepared: Prepared, config: RunConfig) -> tuple[EpochOut, RowModel]:
    """Position, velocity, clocks and drifts of every epoch by EKF or S3EKF (``config.method``).

    Returns
    -------
    EpochOut, RowModel
        Per epoch and per sighting.
    """
    return filter_rows(
        prepared.epochs, prepared.rows, prepared.options, len(prepared.clock_names), config,
        colored=(prepared.errors, prepared.error_rows),
    )  # fmt: skip


def filter_notes(ep: EpochOut) -> list[str]:
    """What the filter decided about its input that a user should know."""
    ignored = np.flatnonzero(ep.rates == FILTER_RATES_IGNORED)
    if len(ignored) == 0:
        return []
    return [
        f"Doppler contradicts code ranges that agree with each other: ignored from epoch {ignored[0] + 1} of "
        f"{len(ep.rates)} on (sign or unit of the Doppler values?)"
    ]


def filter_rows(
    epochs: Epochs,
    rows: Rows,
    model: ModelOptions,
    n_clocks: int,
    config: RunConfig,
    start: tuple[F8, F8] | None = None,
    colored: tuple[ErrorModel, ErrorRows] | None = None,
) -> tuple[EpochOut, RowModel]:
    """EKF or S3EKF over prepared rows, real or simulated.

    Parameters
    ----------
    epochs, rows, model
        As the kernels take them.
    n_clocks : int
        Receiver clocks in ``rows.clock``.
    config : RunConfig
        ``method``, ``dynamics``, ``process``, ``clock``, ``adaptation``, ``gate_probability``, ``fde``.
    start : ((n,), (n, n)), optional
        Belief at the first epoch: kinematic states, clock bias, then drift, of every system; ECEF, SI. Without it
        the first epoch that least squares can solve starts the filter.
    colored : (ErrorModel, ErrorRows), optional
        Errors that last and their rows; without it errors are white.

    Returns
    -------
    EpochOut, RowModel
        Per epoch and per row.

    Raises
    ------
    ValueError
        ``start`` has the wrong shape.
    """
    motion, clocks = motion_from(config), clocks_from(config)
    n = motion.nk + 2 * n_clocks
    x0, P0 = start if start is not None else (np.full(n, np.nan), np.zeros((n, n)))
    if x0.shape != (n,) or P0.shape != (n, n):
        raise ValueError(f"start has shapes {x0.shape} and {P0.shape}, the state has {n} elements")
    ep = empty_epochs(len(epochs.t_ns), n_clocks)
    out = empty_row_model(len(rows.code_m))
    filter_run(
        model,
        spp_options(config),
        process_numbers(motion, clocks),
        filter_options(config, motion, clocks),
        epochs,
        rows,
        np.array(x0, dtype=np.float64),
        np.array(P0, dtype=np.float64),
        *(colored or no_errors()),
        max(MAX_SLOTS, int(np.diff(epochs.offsets).max(initial=0))),
        ep,
        out,
        np.zeros((0, 0)),
        np.zeros((0, 0, 0)),
    )
    return ep, out
