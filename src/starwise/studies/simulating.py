"""A scenario simulated into files, once, and solved many times if asked."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from starwise._version import __version__
from starwise.constants import ROW_EXCLUDED, ROW_USED
from starwise.errors import StarwiseError
from starwise.sim.run import Simulation, Simulator
from starwise.sim.scenario import load_scenario
from starwise.sim.writers import write_files
from starwise.studies.accuracy_runs import METHODS, AccuracyTask, natural_config, navigation_of
from starwise.studies.montecarlo import Progress, run_many
from starwise.types import Solution

if TYPE_CHECKING:
    import polars as pl


def simulate_files(
    scenario: str | Path,
    output: str | Path,
    runs: int = 1,
    seed: int | None = None,
    methods: Sequence[str] = ("s3ekf",),
    workers: int | None = None,
    progress: Progress | None = None,
    scheduler: str | None = None,
    report: bool = True,
) -> dict[str, Any]:
    """Files of run 0 of a scenario and, with more than one run, the errors of all of them.

    Parameters
    ----------
    scenario : path-like
        TOML file, or the name of a shipped scenario.
    output : path-like
        Folder: RINEX, truth, inertial data, the scenario as it was run, ``run.json``; ``montecarlo.parquet``.
    runs : int
    seed : int, optional
        In place of the scenario's.
    methods : sequence of str
        Estimators of the Monte Carlo.
    workers : int, optional
    progress : callable, optional
    scheduler : str, optional
        Dask scheduler for the runs; see `starwise.studies.montecarlo.run_many`.

    Returns
    -------
    dict
        What ``run.json`` holds: ``version, scenario, seed, epochs, rows, satellites_min, satellites_max, files`` and,
        with more than one run, ``montecarlo`` with a row per method.

    Raises
    ------
    StarwiseError
        A scenario that cannot be simulated, a method that does not exist, a folder that cannot be written.
    """
    unknown = [method for method in methods if method not in METHODS]
    if unknown:
        raise StarwiseError("no such method", found=", ".join(unknown), wanted=" | ".join(METHODS))
    if runs < 1:
        raise StarwiseError("not at least one run", found=str(runs))
    say = progress or (lambda _what, _fraction: None)
    say("simulating", 0.0)
    chosen = load_scenario(scenario)
    simulation = Simulator(chosen, seed, navigation_of(chosen)).run(0)
    say("writing", 0.2 if runs > 1 else 0.5)
    paths = write_files(simulation, output)
    seen = simulation.truth.visible
    record: dict[str, Any] = {
        "version": __version__,
        "scenario": chosen.name,
        "seed": simulation.seed,
        "epochs": simulation.observations.n_epochs,
        "rows": simulation.observations.n_rows,
        "satellites_min": int(seen.min()),
        "satellites_max": int(seen.max()),
        "files": {kind: path.name for kind, path in paths.items()},
    }
    if runs > 1:
        task = AccuracyTask(chosen, simulation.seed, tuple(methods), natural_config(chosen))
        table = run_many(
            task,
            runs,
            output,
            workers=workers,
            scheduler=scheduler,
            progress=lambda what, done: say(what, 0.3 + 0.7 * done),
        )
        record["files"]["montecarlo"] = "montecarlo.parquet"
        record["montecarlo"] = [_summary(table, method) for method in methods]
    if report:
        from starwise.report.html import simulation_page, write_page

        record["files"]["report"] = "report.html"
        page = simulation_page(truth_as_solution(simulation), chosen.to_dict(), record)
        write_page(page, Path(output) / "report.html")
    _write_json(record, Path(output) / "run.json")
    say("done", 1.0)
    return record


def truth_as_solution(simulation: Simulation) -> Solution:
    """Antenna, body and satellites in view of a simulation as a solution without errors, for pictures.

    The ledger has a row per epoch and light path: ``used``, or ``excluded`` where a fault acts on its code or rate.
    """
    truth, obs = simulation.truth, simulation.observations
    n, paths, rows = len(truth.t_ns), truth.paths, truth.rows
    nothing = np.full((n, 3, 3), np.nan)
    cn0 = np.full(len(paths.sv), np.nan)
    cn0[rows.path[::-1]] = obs.cn0_dbhz[::-1]  # of several signals the first
    faulty = np.zeros(len(paths.sv), dtype=bool)
    faulty[rows.path[(rows.code_fault_m != 0.0) | (rows.rate_fault_mps != 0.0)]] = True
    order = np.lexsort((paths.sv, paths.epoch))
    ledger: dict[str, NDArray[Any]] = {
        "t_ns": truth.t_ns[paths.epoch[order]],
        "sv": paths.sv[order],
        "status": np.where(faulty[order], ROW_EXCLUDED, ROW_USED).astype(np.uint8),
        "elevation_rad": paths.elevation[order],
        "azimuth_rad": paths.azimuth[order],
        "cn0_dbhz": cn0[order],
    }
    roll, pitch, yaw = np.degrees(truth.euler).T
    return Solution(
        t_ns=truth.t_ns,
        status=np.zeros(n, dtype=np.uint8),
        pos_e=truth.pos_e,
        vel_e=truth.vel_e,
        cov_pos=nothing,
        cov_vel=nothing,
        clock_m=np.empty((n, 0)),
        drift_mps=np.empty((n, 0)),
        clock_sigma_m=np.empty((n, 0)),
        clock_names=(),
        n_used=truth.visible.astype(np.int32),
        dop=np.full((n, 4), np.nan),
        nis=np.full(n, np.nan),
        dof=np.zeros(n, dtype=np.int32),
        ledger=ledger,
        extra={"roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw},
    )


def _summary(table: "pl.DataFrame", method: str) -> dict[str, Any]:
    """2RMS of all runs of a method, and its spread between runs; None where nothing was solved."""
    rows = table.filter(table["method"] == method)
    out: dict[str, Any] = {"method": method, "runs": len(rows)}
    for name in ("horizontal_2rms_m", "vertical_2rms_m", "velocity_2rms_mps"):
        values = rows[name].to_numpy()
        values = values[np.isfinite(values)]
        out[name] = float(np.sqrt((values**2).mean())) if len(values) else None
        out[f"{name}_spread"] = float(values.std(ddof=1)) if len(values) > 1 else None
    return out


def _write_json(record: dict[str, Any], file: Path) -> None:
    beside = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        beside.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        beside.replace(file)
    except OSError as error:
        raise StarwiseError(f"cannot be written ({error.strerror})", file=file) from None
