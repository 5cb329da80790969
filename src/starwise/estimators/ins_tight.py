"""Inertial navigation aided by pseudoranges and Doppler, satellite by satellite (tight coupling)."""

from dataclasses import replace

import numpy as np

from starwise.chi2 import chi_square_points
from starwise.config import RunConfig
from starwise.config_inertial import InertialConfig
from starwise.errors import StarwiseError
from starwise.estimators.ins import SkyTable, fix_table, run_filter
from starwise.estimators.ins_align import align
from starwise.estimators.ins_check import start_note
from starwise.estimators.ins_output import InertialRun, join_runs
from starwise.estimators.run import make_ledger, solve_run
from starwise.gnsstime import iso
from starwise.kernels.ins_tight import Seen, Sky
from starwise.models.inertial import inertial_state, intervals, stretches
from starwise.models.process import clocks_from
from starwise.models.pseudorange import empty_row_model, prepare
from starwise.types import I8, Ephemeris, Fixes, Inertial, IonosphereModel, Observations, Solution


def fixes_of(solution: Solution) -> Fixes:
    """Positions and velocities of a solution as fixes, there at once; epochs without a position are left out."""
    k = solution.has_position
    return Fixes(
        t_ns=solution.t_ns[k],
        available_ns=solution.t_ns[k],
        pos_e=solution.pos_e[k],
        cov_pos=solution.cov_pos[k],
        vel_e=solution.vel_e[k],
        cov_vel=solution.cov_vel[k],
        source=str(solution.provenance.get("file", "")),
    )


def tight(
    obs: Observations,
    ephemeris: Ephemeris,
    ionosphere: IonosphereModel,
    inertial: Inertial,
    run: RunConfig,
    config: InertialConfig,
    *,
    epochs_ns: I8 | None = None,
) -> InertialRun:
    """Inertial navigation aided satellite by satellite; least squares where satellites suffice aligns it.

    Parameters
    ----------
    obs, ephemeris, ionosphere
        As `starwise.estimators.run.solve_run`.
    inertial : Inertial
    run : RunConfig
        Systems, signals, corrections, mask, gate of the satellites.
    config : InertialConfig
    epochs_ns : (k,) int64, optional
        Epochs of the output beside those of the observations.

    Raises
    ------
    StarwiseError
        Nothing to navigate or to align with.
    """
    if config.time_offset_sigma_s > 0.0:
        raise StarwiseError(
            "a time offset is estimated with fixes only", wanted="time_offset_sigma_s = 0 with method tight"
        )
    obs = obs.between(run.start_ns, run.end_ns, run.interval_s)
    run = run.with_options({"start": None, "end": None, "interval_s": None, "error_model": "white"})
    if run.combination == "uncombined":
        run = run.with_options({"combination": "single"})
    return join_runs(
        lambda part: _tight(obs, ephemeris, ionosphere, part, run, config, epochs_ns), stretches(inertial, config)
    )


def _tight(
    obs: Observations,
    ephemeris: Ephemeris,
    ionosphere: IonosphereModel,
    inertial: Inertial,
    run: RunConfig,
    config: InertialConfig,
    epochs_ns: I8 | None,
) -> InertialRun:
    """One stretch of readings without long gaps."""
    whole = obs
    obs = obs.between(int(inertial.t_ns[0]), int(inertial.t_ns[-1]))
    if not len(obs.t_ns) and len(whole.t_ns):
        raise StarwiseError(
            "no epoch of the observations within the inertial readings",
            found=f"{iso(int(whole.t_ns[0]))} to {iso(int(whole.t_ns[-1]))}",
            wanted=f"{iso(int(inertial.t_ns[0]))} to {iso(int(inertial.t_ns[-1]))}: time scales, offsets?",
        )
    iv = intervals(inertial, config)
    t0, end = int(iv.t_ns[0]), float(iv.read.t[-1])
    first = solve_run(obs, ephemeris, ionosphere, run.with_options({"method": "lsq"}))
    table, notes = fix_table(fixes_of(first), t0, end, config)
    prepared = prepare(obs, ephemeris, ionosphere, run)
    names = prepared.clock_names
    state = inertial_state(config, clocks=names, noise=clocks_from(run))
    start = align(iv, table, state, config)
    gates = chi_square_points(run.gate_probability, 3)
    e, rows = len(obs.t_ns), empty_row_model(len(prepared.rows.code_m))
    seen = Seen(rows, np.zeros(e, dtype=np.int64), np.zeros(e, dtype=np.int64), np.full(e, np.nan))
    sky = Sky(prepared.epochs, prepared.rows, prepared.options, float(gates[1]), float(gates[2]))
    sky_t = np.asarray((obs.t_ns - t0) * 1e-9, dtype=np.float64)
    extra = np.zeros(0) if epochs_ns is None else np.asarray((epochs_ns - t0) * 1e-9, dtype=np.float64)
    result = run_filter(iv, table, start, state, config, extra, sky=SkyTable(sky_t, sky, seen))
    clk, n = state.at.clk, len(names)
    clock = np.repeat(result.est[:, clk : clk + 1], n, axis=1)
    sigma = np.repeat(result.sigma[:, clk : clk + 1], n, axis=1)
    for c in range(1, n):
        clock[:, c] += result.est[:, state.at.isb + c - 1]
        sigma[:, c] = np.hypot(sigma[:, c], result.sigma[:, state.at.isb + c - 1])
    solution = replace(
        result.solution,
        clock_m=clock,
        drift_mps=np.repeat(result.est[:, clk + 1 : clk + 2], n, axis=1),
        clock_sigma_m=sigma,
        clock_names=names,
        ledger=make_ledger(obs, prepared, rows),
        provenance={"notes": [*iv.notes, *notes, *start_note(sky_t, start.t_s), *prepared.notes]},
    )
    return replace(result, solution=solution)
