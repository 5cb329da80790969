"""Least squares, one epoch at a time (Groves 9.4)."""

from functools import lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from starwise.chi2 import chi_square_points
from starwise.config import RunConfig
from starwise.constants import EPOCH_NO_SOLUTION
from starwise.kernels.rangemodel import RowModel
from starwise.kernels.spp import EpochOut, SppOptions, spp_run
from starwise.models.pseudorange import Prepared, empty_row_model


@lru_cache(maxsize=16)
def chi_square_table(false_alarm: float, size: int = 200) -> NDArray[np.float64]:
    """Thresholds (size,) of chi-square tests by degrees of freedom; entry 0 is never used; one shared array."""
    return chi_square_points(false_alarm, size)


@lru_cache(maxsize=16)
def largest_residual_table(false_alarm: float, size: int = 200) -> NDArray[np.float64]:
    """Thresholds (size,) on the largest of n normalised residuals by n, each with a share of the false alarm.

    Baarda's test of single rows with Bonferroni's bound: about 4 for 1e-3 and 15 rows. Entry 0 is never used.
    """
    normal = NormalDist()
    return np.array([-normal.inv_cdf(false_alarm / (2.0 * max(n, 1))) for n in range(size)])


def empty_epochs(n: int, n_clocks: int) -> EpochOut:
    """Outputs for ``n`` epochs: no solution, NaN."""
    return EpochOut(
        pos=np.full((n, 3), np.nan),
        vel=np.full((n, 3), np.nan),
        cov_pos=np.full((n, 3, 3), np.nan),
        cov_vel=np.full((n, 3, 3), np.nan),
        clock=np.full((n, n_clocks), np.nan),
        clock_var=np.full((n, n_clocks), np.nan),
        drift=np.full((n, n_clocks), np.nan),
        n_used=np.zeros(n, dtype=np.int32),
        dop=np.full((n, 4), np.nan),
        nis=np.full(n, np.nan),
        dof=np.zeros(n, dtype=np.int32),
        status=np.full(n, EPOCH_NO_SOLUTION, dtype=np.uint8),
        rates=np.zeros(n, dtype=np.uint8),
    )


def spp_options(config: RunConfig) -> SppOptions:
    """Numbers of the least-squares solution out of a configuration."""
    return SppOptions(
        fde=config.fde,
        chi2=chi_square_table(1e-3),
        local=largest_residual_table(1e-3),
        max_gdop=30.0,
        max_sigma_m=25.0,
        max_excluded=0.4,
        # Receiver hardware delays between systems drift by centimetres over minutes: 0.05 m after 1 s, 3 m after 1 h.
        tie_sigma_m=0.05,
    )


def least_squares(prepared: Prepared, config: RunConfig) -> tuple[EpochOut, RowModel]:
    """Position, clocks, velocity and drift of every epoch from a cold start, with exclusion of faulty satellites.

    Returns
    -------
    EpochOut, RowModel
        Per epoch and per sighting.
    """
    ep = empty_epochs(len(prepared.epochs.t_ns), len(prepared.clock_names))
    out = empty_row_model(len(prepared.rows.code_m))
    spp_run(prepared.options, spp_options(config), prepared.epochs, prepared.rows, ep, out)
    return ep, out
