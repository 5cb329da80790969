"""A whole run: observations and an ephemeris in, a solution with its ledger out."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.config import ClockNoise, ProcessNoise, RunConfig
from starwise.config_errors import ErrorParameters
from starwise.config_noise import MeasurementNoise
from starwise.constants import C_LIGHT, ROW_COMBINED, ROW_GATED, ROW_NOT_SELECTED, ROW_USED
from starwise.estimators.dynamics import settle_dynamics
from starwise.estimators.least_squares import least_squares
from starwise.estimators.row_noise import noise_variances
from starwise.kernels.rangemodel import RowModel
from starwise.kernels.spp import EpochOut
from starwise.models.pseudorange import Prepared, prepare
from starwise.types import F8, Ephemeris, IonosphereModel, Observations, Solution

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction (0..1) that is."""


def solve_run(
    obs: Observations,
    ephemeris: Ephemeris,
    ionosphere: IonosphereModel,
    config: RunConfig,
    progress: Progress | None = None,
) -> Solution:
    """Solve all epochs with the configured method.

    Parameters
    ----------
    obs : Observations
        As read or simulated; ``config.start_ns``, ``end_ns`` and ``interval_s`` are applied here.
    ephemeris : Ephemeris
    ionosphere : IonosphereModel
    config : RunConfig
    progress : callable, optional

    Returns
    -------
    Solution
        With the ledger of every observation row; provenance holds notes and counts, the caller adds inputs.

    Raises
    ------
    StarwiseError
        Nothing to position with.
    """
    say = progress or (lambda _what, _fraction: None)
    obs = obs.between(config.start_ns, config.end_ns, config.interval_s)
    say("satellites", 0.0)
    config, dynamics = settle_dynamics(obs, ephemeris, ionosphere, config)
    prepared = prepare(obs, ephemeris, ionosphere, config)
    say(config.method, 0.3)
    ep, out, events = _estimate(prepared, config)
    say("ledger", 0.8)
    notes = [*prepared.notes, *_filter_notes(ep, config), *_unused(config)]
    solution = Solution(
        t_ns=obs.t_ns,
        status=ep.status,
        pos_e=ep.pos,
        vel_e=ep.vel,
        cov_pos=ep.cov_pos,
        cov_vel=ep.cov_vel,
        clock_m=ep.clock,
        drift_mps=ep.drift,
        clock_sigma_m=np.sqrt(ep.clock_var),
        clock_names=prepared.clock_names,
        n_used=ep.n_used,
        dop=ep.dop,
        nis=ep.nis,
        dof=ep.dof,
        ledger=make_ledger(obs, prepared, out, ep.vel),
        provenance={"dynamics": dynamics, "notes": notes, **events},
    )
    say("done", 1.0)
    return solution


def _estimate(prepared: Prepared, config: RunConfig) -> tuple[EpochOut, RowModel, dict[str, Any]]:
    """Outputs per epoch and row, and what else belongs to the provenance."""
    if config.method == "lsq" and config.error_model == "white":
        return *least_squares(prepared, config), {}
    if config.method == "federated":
        from starwise.estimators.federated_run import run_federated, shares_of

        ep, out, events = run_federated(prepared, config)
        shares = dict(zip(prepared.clock_names, shares_of(prepared, config).tolist(), strict=True))
        return ep, out, {"shares": shares, "events": [event.record() for event in events]}
    from starwise.estimators.filter import run_filter

    ep, out = run_filter(prepared, config)
    if config.clock.isolate:
        from starwise.estimators.tied_clocks import tied_events

        return ep, out, {"events": [event.record() for event in tied_events(prepared, config, ep, out)]}
    return ep, out, {}


def _filter_notes(ep: EpochOut, config: RunConfig) -> tuple[str, ...]:
    """What a user of a filter should know of this run."""
    if config.method == "lsq":
        return ()
    from starwise.estimators.filter import filter_notes

    white = (
        "sigmas hold if errors are white; real ones last for minutes, and then the filter's sigmas come out smaller "
        "than its errors, the more so the higher the rate"
    )
    return (*filter_notes(ep), *((white,) if config.error_model == "white" else ()))


def _unused(config: RunConfig) -> list[str]:
    """What a user has set and this run has no use for."""
    found = []
    if config.error_model == "white" and config.errors != ErrorParameters():
        found.append("[errors] of the configuration is of the coloured error model: without effect here")
    if config.error_model == "colored" and config.noise.code_m != MeasurementNoise().code_m:
        found.append("noise.code_m is of white errors; of coloured ones, as here, it is errors.code_white_m")
    if config.method == "lsq" and (config.process, config.clock) != (ProcessNoise(), ClockNoise()):
        found.append("[process] and [clock] of the configuration are of filters: without effect here")
    return found


def make_ledger(
    obs: Observations, prepared: Prepared, out: RowModel, vel_e: F8 | None = None
) -> dict[str, NDArray[Any]]:
    """Ledger: a row per (epoch, satellite, signal) of the observations, in their order.

    The row of the chosen signal carries the terms of the model; for it

        code = geometric + sagnac + receiver_clock - satellite_clock + group_delay
               + troposphere + ionosphere + innovation

    to rounding, all in metres (for least squares the innovation is the residual; for filters the receiver clock is the
    predicted one, and the innovation is what is left beside the error states as they were predicted). A group delay
    that is not broadcast is NaN and counts as 0. The row of a second signal, taken beside the first, has its code, its
    status and its innovation, conditioned on the first one's. Rows of signals that were not chosen have their status
    and NaN.
    """
    s, n = prepared.sightings, obs.n_rows
    at = s.row
    status = prepared.row_status.copy()
    status[at] = out.status
    second = np.flatnonzero(s.row2 >= 0)
    beside = len(prepared.error_rows.code2_m) > 0 and bool(np.isfinite(prepared.error_rows.code2_m[second]).any())
    used = (prepared.error_rows.used[second] & 2) != 0 if beside else out.status[second] == ROW_USED
    taken = ROW_USED if beside else ROW_COMBINED
    refused = np.where(out.status[second] == ROW_USED, ROW_GATED, out.status[second])
    status[s.row2[second]] = np.where(used, taken, refused)
    pairs = s.sig2.copy()
    if beside:  # codes whose group delay nobody knows were not taken
        without = second[~np.isfinite(prepared.error_rows.code2_m[second])]
        status[s.row2[without]] = ROW_NOT_SELECTED
        pairs[without] = 0
    if len(prepared.error_rows.used):
        first_refused = (out.status == ROW_USED) & (prepared.error_rows.used == 2)
        status[at[first_refused]] = ROW_GATED

    noise, noise2, rate_noise = noise_variances(prepared, out, vel_e)
    satellite_clock = C_LIGHT * prepared.states.clock_s
    known = out.geometric + out.sagnac + out.troposphere + out.ionosphere - prepared.rows.clock_m
    sig2 = np.zeros(n, dtype=np.int16)
    sig2[at] = pairs
    rate_used = np.zeros(n, dtype=bool)
    rate_used[at] = out.rate_used != 0
    columns: dict[str, NDArray[Any] | tuple[F8, F8 | None]] = {
        "t_ns": np.repeat(obs.t_ns, np.diff(obs.offsets)),
        "sv": obs.sv,
        "sig": obs.sig,
        "sig2": sig2,
        "status": status,
        "rate_used": rate_used,
        "elevation_rad": (out.elevation, None),
        "azimuth_rad": (out.azimuth, None),
        "cn0_dbhz": obs.cn0_dbhz,
        "code_m": (s.code_m, prepared.error_rows.code2_m),
        "geometric_m": (out.geometric, None),
        "sagnac_m": (out.sagnac, None),
        "satellite_clock_m": (satellite_clock, None),
        "relativity_m": (C_LIGHT * prepared.states.relativity_s, None),
        "group_delay_m": (prepared.group_delay_m, None),
        "troposphere_m": (out.troposphere, None),
        "ionosphere_m": (out.ionosphere, None),
        "receiver_clock_m": (s.code_m - known - out.v_code, None),
        "innovation_m": (out.v_code, prepared.error_rows.v2),
        "innovation_var_m2": (out.s_code, prepared.error_rows.s2),
        "rate_innovation_mps": (out.v_rate, None),
        "rate_innovation_var_m2ps2": (out.s_rate, None),
        "noise_var_m2": (noise, noise2),
        "rate_noise_var_m2ps2": (rate_noise, None),
        "ephemeris_age_s": (prepared.states.age_s, None),
        "ephemeris_sigma_m": (prepared.rows.sigma_sat_m, None),
    }
    # One piece of memory for all terms: pages that are touched for the first time cost more than what is written there.
    block = iter(np.full((sum(isinstance(c, tuple) for c in columns.values()), n), np.nan))
    ledger: dict[str, NDArray[Any]] = {}
    for name, column in columns.items():
        if isinstance(column, tuple):
            ledger[name] = next(block)
            ledger[name][at] = column[0]
            if beside and column[1] is not None:
                ledger[name][s.row2[second]] = column[1][second]
        else:
            ledger[name] = column
    return ledger
