"""The S3EKF paper reproduced: everything that it shows, and what it does not."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from starwise._version import __version__
from starwise.analysis.operation_count import operation_gain
from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.sim.scenario import load_scenario
from starwise.studies.accuracy_runs import local_errors
from starwise.studies.montecarlo import run_many, write_whole
from starwise.studies.s3ekf_filter import JERK_PSD, METHODS, SCENARIOS, SETTLED_S, paper_config, solve_paper
from starwise.studies.s3ekf_real import real_data
from starwise.studies.s3ekf_robustness import robustness
from starwise.studies.s3ekf_runs import PaperTask, max_difference, sensitivity, table1, velocity_gain
from starwise.studies.scene import Scene
from starwise.studies.update_timing import time_updates

Progress = Callable[[str, float], None]
RUNS: Final = 100
PAPER_OPERATION_GAIN: Final = {7: 0.0, 8: 0.081, 15: 0.5}
"""Figure 7 and its text: crossing, 8.1 %, "more than 50 %"."""


def reproduce_s3ekf(
    output: str | Path,
    runs: int = RUNS,
    seed: int | None = None,
    data: Path | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    scheduler: str | None = None,
) -> dict[str, Any]:
    """All results of the paper and beyond, also written to a folder.

    Parameters
    ----------
    output : path-like
        Folder for ``reproduce.json``, ``report.md``, ``table1.csv``, ``table1.parquet``, ``runs.parquet``,
        ``errors.csv`` (figures 3 to 6), ``operation_gain.csv`` and, where matplotlib is there, ``fig*.svg``.
    runs : int
        Monte Carlo runs of every scenario.
    seed : int, optional
        In place of the scenarios'.
    data : Path, optional
        Folder of real measurements.
    workers : int, optional
    progress : callable, optional
    scheduler : str, optional
        Dask scheduler for the runs; see `starwise.studies.montecarlo.run_many`.

    Returns
    -------
    dict
        ``table1``, ``max_difference_m``, ``velocity_gain``, ``operation_gain``, ``time_ratio``, ``real``,
        ``robustness``, ``sensitivity``, ``scenario2`` (figures 3 to 6 in numbers), ``paper``, ``settings``.

    Raises
    ------
    StarwiseError
        Not at least one run; a negative seed; the folder cannot be written.
    """
    import polars as pl

    if seed is not None and seed < 0:
        raise StarwiseError("a seed is not negative", found=str(seed))
    base = Path(output)
    say = progress or (lambda _what, _fraction: None)
    table = run_many(
        PaperTask(seed),
        runs,
        base,
        name="runs",
        workers=workers,
        scheduler=scheduler,
        progress=lambda what, f: say(what, 0.6 * f),
    )
    say("other process noise", 0.6)
    others = sensitivity(seed=seed)
    say("one run of scenario 2", 0.64)
    errors = scenario2_errors(seed)
    say("robustness", 0.65)
    beyond = robustness(seed, lambda f: say("robustness", 0.65 + 0.1 * f))
    say("real data", 0.75)
    real = real_data(data, lambda f: say("real data", 0.75 + 0.15 * f))
    say("time of updates", 0.9)
    result: dict[str, Any] = {
        "table1": table1(table),
        "max_difference_m": max_difference(table),
        "velocity_gain": velocity_gain(table),
        "operation_gain": operation_gain(),
        "time_ratio": time_updates(),
        "real": real,
        "robustness": beyond,
        "sensitivity": others,
        "scenario2": summary_of_errors(errors),
        "paper": {"operation_gain": [{"n": n, "gain": gain} for n, gain in PAPER_OPERATION_GAIN.items()]},
        "settings": {
            "version": __version__,
            "runs": runs,
            "scenarios": list(SCENARIOS),
            "seeds": [load_scenario(name).seed if seed is None else seed for name in SCENARIOS],
            "jerk_psd_m2_per_s5": JERK_PSD,
            "statistics_from_s": SETTLED_S,
            "filter": "see starwise.studies.s3ekf_filter",
        },
    }
    from starwise.studies.s3ekf_report import write_report

    write_whole(pl.DataFrame(result["table1"]), base / "table1.csv")
    write_whole(pl.DataFrame(result["table1"]), base / "table1.parquet")
    write_whole(pl.DataFrame(result["operation_gain"]), base / "operation_gain.csv")
    write_whole(pl.DataFrame(errors), base / "errors.csv")
    write_report(result, errors, base)
    write_text(json.dumps(result, indent=1, allow_nan=False) + "\n", base / "reproduce.json")
    say("done", 1.0)
    return result


def write_text(text: str, file: Path) -> None:
    """Write a text beside its place, then rename it.

    Raises
    ------
    StarwiseError
        The file cannot be written.
    """
    beside = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(file)
    except OSError as error:
        raise StarwiseError(f"cannot be written ({error.strerror})", file=file) from None


def scenario2_errors(seed: int | None = None) -> dict[str, list[float]]:
    """Errors of run 0 of scenario 2 by epoch (figures 3 to 5) and satellites in view (figure 6).

    Returns
    -------
    dict of columns
        ``t_s``, ``satellites``; for each method ``<method>_horizontal_m``, ``_vertical_m``, ``_velocity_mps``.
    """
    sky = Scene(load_scenario(SCENARIOS[1]), seed).run(0, paper_config("s3ekf"))
    columns: dict[str, list[float]] = {
        "t_s": ((sky.epochs.t_ns - sky.epochs.t_ns[0]) / NS).tolist(),
        "satellites": np.diff(sky.epochs.offsets).tolist(),
    }
    for method in METHODS:
        ep = solve_paper(sky, method)
        pos, vel = local_errors(ep.pos, ep.vel, sky)
        columns[f"{method}_horizontal_m"] = np.hypot(pos[:, 0], pos[:, 1]).tolist()
        columns[f"{method}_vertical_m"] = pos[:, 2].tolist()
        columns[f"{method}_velocity_mps"] = np.linalg.norm(vel, axis=1).tolist()
    return columns


def summary_of_errors(errors: dict[str, list[float]]) -> dict[str, Any]:
    """Continuity through changes of satellites: steps of the error where the sky changes, and elsewhere.

    Returns
    -------
    dict
        ``satellites_min``, ``satellites_max``, ``changes``; for each method the largest step of the horizontal error
        from one epoch to the next at a change of the number of satellites and at all other epochs, after the start.
    """
    n = np.asarray(errors["satellites"])
    t = np.asarray(errors["t_s"])[1:]
    changed, settled = np.diff(n) != 0, t >= SETTLED_S
    out: dict[str, Any] = {
        "satellites_min": int(n.min()),
        "satellites_max": int(n.max()),
        "changes": int(changed.sum()),
    }
    for method in METHODS:
        step = np.abs(np.diff(np.asarray(errors[f"{method}_horizontal_m"])))

        def largest(where: Any, step: Any = step) -> float | None:
            return float(step[where].max()) if where.any() else None

        out[f"{method}_largest_step_at_change_m"] = largest(changed & settled)
        out[f"{method}_largest_step_elsewhere_m"] = largest(~changed & settled)
    return out
