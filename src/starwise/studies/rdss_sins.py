"""The RDSS/SINS paper reproduced: optimal prediction of late fixes, its consistency, and what the tests cannot see."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from starwise._version import __version__
from starwise.analysis.consistency import judge_autocorrelation, lag_p_value, nis_region, whiteness_bound
from starwise.errors import StarwiseError
from starwise.frames import ecef_from_geodetic
from starwise.physics.rdss import geostationary, rdss_geometry
from starwise.studies.montecarlo import run_many, write_whole
from starwise.studies.rdss_sins_runs import (
    LAGS,
    PAPER_NIS,
    PAPER_RHO,
    SEED,
    SETTLED_S,
    WAYS,
    WINDOW,
    K,
    SinsTask,
    jobs,
    linear_difference,
    mean_window,
    summarise,
    window_bounds,
)
from starwise.studies.rdss_sins_scene import EXPERIMENTS, PERIOD_S, START, Experiment, Scene, SinsErrors
from starwise.studies.s3ekf import write_text

Progress = Callable[[str, float], None]
RUNS: Final = 200
PLACES: Final = ((20.0, 116.0), (30.0, 116.0), (40.0, 116.0), (40.0, 90.0), (50.0, 116.0))
"""Latitude, longitude of the table of equation 4."""


def reproduce_rdss_sins(
    output: str | Path,
    runs: int = RUNS,
    seed: int | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    scheduler: str | None = None,
) -> dict[str, Any]:
    """All results of the paper and beyond, also written to a folder.

    Parameters
    ----------
    output : path-like
        Folder for ``reproduce.json``, ``report.md``, ``runs.parquet`` (a row per run, experiment and method),
        ``summary.csv``, ``static.csv`` and ``dynamic.csv`` (run 0 by fix) and, where matplotlib is there, ``fig*.svg``.
    runs : int
        Monte Carlo runs of the two experiments; a fifth of them of everything beyond.
    seed : int, optional
    workers : int, optional
    progress : callable, optional
    scheduler : str, optional
        Dask scheduler for the runs; see `starwise.studies.montecarlo.run_many`.

    Returns
    -------
    dict
        ``static``, ``dynamic``: of optimal prediction, means over the runs of NIS per degree of freedom and of rho of
        the last window, the regions of a window, ``consistent`` (as many windows pass as must), RMS errors, pass
        rates, ``delay_methods``; ``delay_methods``: those of the dynamic experiment; ``jitter``, ``speed``,
        ``blind_spot``, ``model``: lists likewise; ``paper``: its own numbers judged; ``equivalence``, ``geometry``,
        ``settings``.

    Raises
    ------
    StarwiseError
        Not at least one run; a negative seed; the folder cannot be written.
    """
    import polars as pl

    if seed is not None and seed < 0:
        raise StarwiseError("a seed is not negative", found=str(seed))
    base, number = Path(output), SEED if seed is None else seed
    say = progress or (lambda _what, _fraction: None)
    task = SinsTask(number)
    table = run_many(
        task,
        runs,
        base,
        workers=workers,
        scheduler=scheduler,
        name="runs",
        progress=lambda what, f: say(what, 0.85 * f),
    )
    say("linear system", 0.85)
    groups: dict[str, list[dict[str, Any]]] = {}
    for group, name, method in table.select("group", "experiment", "method").unique(maintain_order=True).rows():
        groups.setdefault(group, []).append(summarise(table, name, method))
    paper = {(row["experiment"], row["method"]): row for row in groups["paper"]}
    result: dict[str, Any] = {name: _experiment(table, name, paper) for name in EXPERIMENTS}
    result["delay_methods"] = result["dynamic"]["delay_methods"]
    result |= {name.replace(" ", "_"): rows for name, rows in groups.items() if name != "paper"}
    result["equivalence"] = {
        name: {
            "linear_m": linear_difference(experiment, number),
            "navigator_m": {way: paper[name, way]["replay_difference_m"] for way in ("optimal_prediction", "cloning")},
        }
        for name, experiment in EXPERIMENTS.items()
    }
    filtered = table.filter((pl.col("group") == "paper") & (pl.col("method") == "optimal_prediction"))
    result["paper"] = judged_paper() | {"lowest_here": float(filtered["rho1"].to_numpy().min())}
    result["geometry"] = geometry_table()
    result["settings"] = _settings(runs, number)
    say("one run of each", 0.95)
    curves = {name: run_curves(experiment, number) for name, experiment in EXPERIMENTS.items()}
    from starwise.studies.rdss_sins_report import write_report

    for name, columns in curves.items():
        write_whole(pl.DataFrame(columns), base / f"{name}.csv")
    flat = [row for rows in groups.values() for row in rows]
    write_whole(pl.DataFrame(flat, infer_schema_length=None), base / "summary.csv")
    write_report(result, curves, base)
    write_text(json.dumps(result, indent=1, allow_nan=False) + "\n", base / "reproduce.json")
    say("done", 1.0)
    return result


def _experiment(table: Any, name: str, rows: dict[tuple[str, str], dict[str, Any]]) -> dict[str, Any]:
    """Results of optimal prediction in one of the paper's experiments, the other ways beside it."""
    own = rows[name, "optimal_prediction"]
    window = mean_window(table, name, "optimal_prediction")
    keys = ("method", "rms_position_m", "nis_per_dof", "consistent")
    rest = (
        "rms_velocity_mps", "coverage_95", "nis_pass_rate", "white_pass_rate", "both_pass_rate", "delay_wrong_rate",
        "delay_unverifiable_rate", "delay_confirmed_rate", "delay_s", "delay_sigma_s", "tau_s", "tau_sigma_s",
        "tau_spread_s",
    )  # fmt: skip
    methods = []
    for way in WAYS:
        row = rows[name, way]
        methods.append({k: row[k] for k in keys} | {k: row[k] for k in rest if k in row})
    return {
        "nis_per_dof": window["nis_per_dof"],
        **window_bounds(),
        "rho": window["rho"],
        "consistent": own["consistent"],
        "rms_position_m": own["rms_position_m"],
        "rms_velocity_mps": own["rms_velocity_mps"],
        "free_rms_position_m": rows[name, "free"]["rms_position_m"],
        "nis_per_dof_all": own["nis_per_dof"],
        **{k: own[k] for k in own if k.endswith("_rate") or k in ("coverage_95", "windows", "claimed_position_m")},
        "first_run": window["first_run"],
        "delay_methods": methods,
    }


def judged_paper() -> dict[str, Any]:
    """The paper's printed statistics under the package's own tests."""
    low, high = nis_region(2 * K)
    out: dict[str, Any] = {
        "rho": list(PAPER_RHO),
        "nis_per_dof": PAPER_NIS,
        "nis_low": low,
        "nis_high": high,
        "nis_passed": low <= PAPER_NIS <= high,
        "paper_bound": 0.2772,
    }
    for kind, m in (("scalar", 1), ("vector", 2)):
        test = judge_autocorrelation(PAPER_RHO, K, m)
        chance = lag_p_value(PAPER_RHO[0], K, m)
        out[kind] = {
            "bound": test.bound,
            "bound_each": test.bound_each,
            "outside": list(test.outside),
            "white": test.passed,
            "chance_of_first": chance,
            "chance_of_first_in_any_of_eight": 1.0 - (1.0 - chance) ** LAGS,
        }
    out["outside_its_own_bound"] = [k for k, r in enumerate(PAPER_RHO, 1) if abs(r) > 0.2772]
    out["single_lag_bound"] = whiteness_bound(K)
    return out


def geometry_table() -> list[dict[str, float]]:
    """Equation 4: sigmas of a fix, m, by their parts, at some places on the ellipsoid."""
    return [
        {"latitude_deg": lat, "longitude_deg": lon}
        | rdss_geometry(ecef_from_geodetic([np.radians(lat), np.radians(lon), 0.0]), geostationary()).sigmas
        for lat, lon in PLACES
    ]


def run_curves(experiment: Experiment, seed: int) -> dict[str, list[float]]:
    """Columns of run 0 by fix: errors of all ways, innovations, positions in the plane.

    Returns
    -------
    dict of columns
        ``t_s``; ``<method>_north_m``, ``_east_m`` for all ways and the free navigator; ``v_north_m``, ``v_east_m``,
        ``s_north_m``, ``s_east_m`` (innovations of optimal prediction and their sigmas), ``sigma_north_m``,
        ``sigma_east_m`` (of the position); ``true_*``, ``fix_*``, ``free_*``: plane coordinates about the start, m.
    """
    scene = Scene(experiment)
    measured = scene.simulate(0, seed)
    out: dict[str, list[float]] = {}
    for way in ("free", *WAYS):
        run = scene.filtered(measured, way)
        out["t_s"] = run.t_s.tolist()
        out |= {f"{way}_{axis}_m": run.position_error[:, k].tolist() for k, axis in enumerate(("north", "east"))}
        if way == "optimal_prediction":
            for k, axis in enumerate(("north", "east")):
                out[f"v_{axis}_m"] = run.v[:, k].tolist()
                out[f"s_{axis}_m"] = np.sqrt(run.S[:, k, k]).tolist()
                out[f"sigma_{axis}_m"] = np.sqrt(run.P[:, 2 + k, 2 + k]).tolist()
    lat0, lon0, _ = scene.llh[0]
    scale = 6.37e6 * np.array([1.0, np.cos(lat0)])
    true = (scene.llh[measured.fixes.there, :2] - [lat0, lon0]) * scale
    fix = (np.stack([measured.fixes.lat, measured.fixes.lon], axis=1) - [lat0, lon0]) * scale
    for k, axis in enumerate(("north", "east")):
        out[f"true_{axis}_m"], out[f"fix_{axis}_m"] = true[:, k].tolist(), fix[:, k].tolist()
    return out


def _settings(runs: int, seed: int) -> dict[str, Any]:
    errors = SinsErrors()
    return {
        "version": __version__,
        "runs": runs,
        "runs_beyond": len(range(0, runs, max(job.every for job in jobs()))),
        "seed": seed,
        "period_s": PERIOD_S,
        "K": K,
        "lags": LAGS,
        "window": WINDOW,
        "statistics_from_s": SETTLED_S,
        "start": list(START),
        "errors": {name: float(value) for name, value in vars(errors).items()},
    }
