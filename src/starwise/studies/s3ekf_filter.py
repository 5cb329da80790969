"""The filter of the S3EKF paper, chosen once for all four scenarios: 13 states, white jerk, no gate, no restart.

The paper names neither process noise, nor P0, nor a clock model. What is chosen here, before any result was seen:

- **Process noise.** White jerk of spectral density `JERK_PSD` on every axis. A sequence of acceleration steps of size
  a at a mean rate lambda has the density lambda a^2: 4 steps of 20 m/s^2, 2 and 8 of 30 m/s^2 in the 1100 s of the
  four scenarios make 9.6 m^2/s^5 on the axis that is hit.
- **Start.** Position, velocity, clocks and their covariance from least squares at the first epoch; acceleration
  0 +- 1 m/s^2, independent.
- **Clocks.** Bias and drift per system, one oscillator (TCXO, Allan parameters as simulated) and a small random walk
  for each; the paper's are independent.
- **Measurement noise.** The 6 m and 0.1 m/s (or what is simulated) of every satellite, for least squares likewise.
- **Statistics** from `SETTLED_S` on, when the manoeuvres begin: until then the position still averages its start.
"""

from typing import Final, Literal

import numpy as np

from starwise.config import RunConfig
from starwise.estimators.filter import filter_options
from starwise.estimators.least_squares import empty_epochs, spp_options
from starwise.kernels.filter_run import filter_run
from starwise.kernels.spp import EpochOut
from starwise.models.error_model import MAX_SLOTS, no_errors
from starwise.models.process import Motion, clocks_from, process_numbers
from starwise.models.pseudorange import empty_row_model
from starwise.studies.scene import Sky, solve_rows
from starwise.types import F8

JERK_PSD: Final = 10.0
"""Spectral density of the white jerk per axis, m^2/s^5."""
SETTLED_S: Final = 60.0
SCENARIOS: Final = ("s3ekf-1-static", "s3ekf-2-steps", "s3ekf-3-turn", "s3ekf-4-climb-dive")
Method = Literal["lsq", "ekf", "s3ekf"]
METHODS: Final[tuple[Method, ...]] = ("lsq", "ekf", "s3ekf")


def paper_motion(jerk_psd: float = JERK_PSD) -> Motion:
    """Process model of the paper's filter: white jerk, the same on all axes."""
    return Motion("acceleration", jerk_psd, jerk_psd, velocity_sigma0=300.0, acceleration_sigma0=1.0)


def paper_config(method: Method) -> RunConfig:
    """What the paper's filter and its least squares share with ``starwise solve``: systems, no corrections."""
    return RunConfig(
        error_model="white",
        method=method,
        systems="GC",
        dynamics="aircraft",
        mask_deg=5.0,
        ionosphere="none",
        troposphere="none",
        fde=False,
    )


def solve_paper(
    sky: Sky,
    method: Method,
    start: tuple[F8, F8] | None = None,
    gated: bool = False,
    restarts: bool = False,
    jerk_psd: float = JERK_PSD,
) -> EpochOut:
    """All epochs by the paper's filter, or by least squares.

    Parameters
    ----------
    sky : Sky
    method : str
    start : ((n,), (n, n)), optional
        Belief at the first epoch in place of least squares.
    gated : bool
        Test every satellite like ``starwise solve``; the paper does not.
    restarts : bool
        Let a filter that is lost, or that is more uncertain than 10 km, start again from least squares.
    jerk_psd : float
        Process noise, m^2/s^5.
    """
    config = paper_config(method)
    if method == "lsq":
        return solve_rows(sky, config)[0]
    motion, clocks = paper_motion(jerk_psd), clocks_from(config)
    options = filter_options(config, motion, clocks)
    if not gated:
        options = options._replace(gate1=np.inf, gate2=np.inf)
    if not restarts:
        options = options._replace(patience=1 << 30, weak_patience=1 << 30, lost_sigma_m=np.inf)
    n = motion.nk + 2 * sky.n_clocks
    x0, P0 = start if start is not None else (np.full(n, np.nan), np.zeros((n, n)))
    ep, out = empty_epochs(len(sky.epochs.t_ns), sky.n_clocks), empty_row_model(len(sky.rows.code_m))
    filter_run(
        sky.model,
        spp_options(config),
        process_numbers(motion, clocks),
        options,
        sky.epochs,
        sky.rows,
        np.array(x0, dtype=np.float64),
        np.array(P0, dtype=np.float64),
        *no_errors(),
        MAX_SLOTS,
        ep,
        out,
        np.zeros((0, 0)),
        np.zeros((0, 0, 0)),
    )
    return ep
