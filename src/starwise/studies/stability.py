"""The stability paper (Gao, Tan 2007) reproduced: controllability, observability, spectral radii, bursts."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from starwise._version import __version__
from starwise.analysis.observability import (
    cramer_rao,
    degree_by_covariance,
    degree_by_solution,
    observability,
)
from starwise.analysis.stability import ErrorDynamics, stability
from starwise.analysis.stability_controllability import (
    controllability,
    uniform_controllability,
    uniform_observability,
)
from starwise.analysis.stability_dare import steady_state
from starwise.errors import StarwiseError
from starwise.studies.montecarlo import run_many, write_whole
from starwise.studies.s3ekf import write_text
from starwise.studies.stability_bursts import BurstTask, burst_table, survival
from starwise.studies.stability_scene import BESIDE, CLK, MODELS, NAMES, PERIOD_S, PLACE, Model, Numbers, Scene

Progress = Callable[[str, float], None]
SEED: Final = 2007
RUNS: Final = 30
"""Bursts of each model, kind and size; asking for more runs than this gives no more."""
LATITUDES: Final = (40.0, 25.0)
LOCAL: Final = 11
"""Steps of the window by which a case is called observable: as many as states (2.75 s)."""
MINUTE: Final = 240
SYMBOLS: Final = ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "dt", "df")
"""The paper's names of the states, in the order of the layout."""
PAPER_DEGREE: Final = {
    "dt": 0.16, "df": 0.147, "x": 0.295, "y": -0.195, "z": 0.088, "vx": 0.234, "vy": -0.169, "vz": 0.102,
    "ax": 0.215, "ay": -0.162, "az": 0.107,
}  # fmt: skip
DEGREE_S: Final = (10.0, 50.0, 100.0, 600.0)
SOUTH: Final = (40.0, 36.0, 34.0, 33.0, 32.0, 30.0, 25.0, 20.0)
CLOCKS: Final = (1e-12, 1e-10, 1e-9, 1e-8, 1e-7)
"""Stabilities: an atomic clock to a poor crystal; the paper's is 1e-10."""


def reproduce_stability(
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
        Folder for ``reproduce.json``, ``report.md``, ``cases.csv``, ``radii.csv``, ``degree.csv``, ``bursts.csv``,
        ``bursts.parquet`` (a row per run) and, where matplotlib is there, ``fig*.svg``.
    runs : int
        Bursts of each model, kind and size; at most 30.
    seed : int, optional
        In place of 2007.
    workers : int, optional
    progress : callable, optional
    scheduler : str, optional
        Dask scheduler for the runs; see `starwise.studies.montecarlo.run_many`.

    Returns
    -------
    dict
        ``cases``, ``degree``, ``bursts`` (the paper's results), ``degree_table``, ``degree_windows``, ``growth``,
        ``south``, ``burst_table``, ``false_alarms``, ``checks``, ``paper``, ``settings``.

    Raises
    ------
    StarwiseError
        Not at least one run; a negative seed; the folder cannot be written.
    """
    import polars as pl

    if seed is not None and seed < 0:
        raise StarwiseError("a seed is not negative", found=str(seed))
    if runs < 1:
        raise StarwiseError("not at least one run", found=str(runs))
    base, number, count = Path(output), SEED if seed is None else seed, min(runs, RUNS)
    say = progress or (lambda _what, _fraction: None)
    table = run_many(
        BurstTask(number), count, base, name="bursts", block=5, workers=workers, scheduler=scheduler,
        progress=lambda what, f: say(what, 0.6 * f),
    )  # fmt: skip
    records = burst_table(table)
    cases, radii = [], {}
    jobs = [(latitude, model) for latitude in LATITUDES for model in (*MODELS, *BESIDE)]
    for i, (latitude, model) in enumerate(jobs):
        say("spectral radii", 0.6 + 0.3 * i / len(jobs))
        row, found = case(Scene(latitude), model)
        cases.append(row)
        radii[f"{model.satellites} {model.name} {latitude:g}"] = found
    say("degree of observability, growth, south", 0.9)
    result: dict[str, Any] = {
        "cases": cases,
        **degrees(Scene(), number),
        "bursts": survival(records),
        "growth": growth_by_clock(),
        "south": south(),
        "burst_table": [r for r in records if r["kind"] != "none"],
        "false_alarms": [_false_alarm(r) for r in records if r["kind"] == "none"],
        "settings": settings(count, number),
    }
    result["checks"] = checks(result)
    result = finite(result)
    from starwise.studies.stability_report import write_report

    columns = {"t_s": Scene().t_s.tolist()} | {k: s.spectral_radius.tolist() for k, s in radii.items()}
    columns |= {f"product {k}": s.product_norm.tolist() for k, s in radii.items()}
    write_whole(pl.DataFrame(columns), base / "radii.csv")
    flat = [{k: "; ".join(v) if isinstance(v, list) else v for k, v in row.items()} for row in result["cases"]]
    write_whole(pl.DataFrame(flat, infer_schema_length=None), base / "cases.csv")
    write_whole(pl.DataFrame(result["degree_table"], infer_schema_length=None), base / "degree.csv")
    write_whole(pl.DataFrame(result["burst_table"], infer_schema_length=None), base / "bursts.csv")
    write_report(result, columns, base)
    write_text(json.dumps(result, indent=1, allow_nan=False) + "\n", base / "reproduce.json")
    say("done", 1.0)
    return result


def case(scene: Scene, model: Model) -> tuple[dict[str, Any], ErrorDynamics]:
    """One of the paper's systems at a latitude: all its analyses as a record, and the error dynamics."""
    system, P0 = scene.system(model), scene.P0(model)
    N, scale = len(system), np.sqrt(np.diag(P0))
    local = system.in_enu(scene.C_ne)
    windows = [observability(local, first, LOCAL) for first in (0, (N - LOCAL) // 2, N - LOCAL)]
    worst = min(windows, key=lambda w: w.rank)
    whole = observability(local, prior=P0)
    reach = controllability(system)
    found = stability(system, P0)
    rho = found.spectral_radius
    growth = found.worst_growth
    P = system.filtered(P0).P[-1]
    try:
        steady = steady_state(system.steps[N // 2]).spectral_radius
    except ValueError:
        steady = None
    record = {
        "satellites": model.satellites,
        "model": model.name,
        "latitude_deg": scene.latitude_deg,
        "controllable": reach.controllable,
        "observable": worst.rank == len(system.layout),
        "rank": worst.rank,
        "states": len(system.layout),
        "unobservable": [d.name for d in worst.unobservable],
        "rank_whole_run": whole.rank,
        "informative_whole_run": whole.informative,
        "weakest_whole_run": whole.weakest.name,
        "weakest_strength": whole.weakest.strength,
        "condition": worst.condition,
        "uniform_low": uniform_observability(system, MINUTE, scale, MINUTE).low,
        "uniform_noise_low": uniform_controllability(system, LOCAL, scale, MINUTE).low,
        "spectral_radius_max": float(rho.max()),
        "spectral_radius_late": float(rho[N // 2 :].max()),
        "spectral_radius_median": float(np.median(rho)),
        "norm_max": float(found.norm.max()),
        "above_one_s": _above(rho),
        "verdict": found.verdict,
        "lemma1": found.lemma1,
        "contraction": found.contraction,
        "product_norm": float(found.product_norm[-1]),
        "product_norm_max": float(found.product_norm.max()),
        "window_radius_max": float(found.window_radius.max()),
        "exponent_per_s": found.exponent_per_s,
        "growth_states": growth.states if growth else "",
        "growth": growth.factor if growth else 1.0,
        "growth_after_s": growth.after_s if growth else 0.0,
        "frozen_radius": steady,
        "sigma_position_m": float(np.sqrt(np.trace(P[:3, :3]))),
        "bound_position_m": float(np.linalg.norm(cramer_rao(system)[-1, :3])),
        "explained": found.explain(),
        "observability_explained": worst.explain(),
    }
    return record, found


def _above(rho: np.ndarray[Any, np.dtype[np.float64]]) -> list[str]:
    """First and last instant with a spectral radius above 1, as text; empty if there is none."""
    at = np.flatnonzero(rho > 1.0 + 1e-9)
    return [f"{(k + 1) * PERIOD_S:g} s" for k in (at[0], at[-1])] if len(at) else []


def degrees(scene: Scene, seed: int) -> dict[str, Any]:
    """Table 1: by the paper's formula, by the covariance, and the paper's values judged.

    The paper gives neither window nor vector b. Tried: z of the whole state without noise, z of an error drawn from
    P0, and that with noise, over 1 s, 10 s and 50 s.
    """
    model = MODELS[0]
    system, P0 = scene.system(model), scene.P0(model)
    P = system.filtered(P0).P
    at = {t: round(t / PERIOD_S) for t in DEGREE_S}
    learned = {t: degree_by_covariance(P[k - 1], P0) for t, k in at.items()}
    against_free = degree_by_covariance(P[at[50.0] - 1], system.part(0, at[50.0]).free(P0))
    pos, vel, acc = scene.kinematics
    state = np.concatenate([pos[0], vel[0], acc[0], [0.0, 0.0]])
    g = np.random.default_rng(seed)
    drawn = g.normal(size=len(state)) * np.sqrt(np.diag(P0))
    printed = np.array([PAPER_DEGREE[s] for s in SYMBOLS])
    windows, formula = [], np.full(len(state), np.nan)
    for seconds in (1.0, 10.0, 50.0):
        part = system.part(0, round(seconds / PERIOD_S))
        O, sigma = _plain_matrix(part.steps)  # noqa: E741
        for name, b in (
            ("state", O.T @ (O @ state)),
            ("error", O.T @ (O @ drawn)),
            ("error and noise", O.T @ (O @ drawn + g.normal(size=len(O)) * sigma)),
        ):
            s = degree_by_solution(O.T @ O, b)
            windows.append(
                {"window_s": seconds, "b": name, "cosine": _cosine(s, np.abs(printed)), "ordered": _ordered(s)}
                | {symbol: float(v) for symbol, v in zip(SYMBOLS, s, strict=True)}
            )
            if name == "state" and seconds == 10.0:
                formula = s
    rows = [
        {
            "state": symbol,
            "name": name,
            "paper": PAPER_DEGREE[symbol],
            "formula": float(formula[i]),
            **{f"covariance_{t:g}s": float(learned[t][i]) for t in DEGREE_S},
            "against_free_50s": float(against_free[i]),
        }
        for i, (symbol, name) in enumerate(zip(SYMBOLS, NAMES, strict=True))
    ]
    return {
        "degree": {row["state"]: row["covariance_50s"] for row in rows},
        "degree_table": rows,
        "degree_windows": windows,
    }


def _plain_matrix(steps: Sequence[Any]) -> tuple[Any, Any]:
    """The paper's Q_o: rows H_k Phi^k without weights; and the sigma of each row."""
    M, blocks, sigma = np.eye(len(steps[0].Phi)), [], []
    for s in steps:
        blocks.append(s.H @ M)
        sigma.append(np.sqrt(s.R))
        M = s.Phi @ M
    return np.concatenate(blocks), np.concatenate(sigma)


def _cosine(a: Any, b: Any) -> float:
    return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))


def _ordered(s: Any) -> bool:
    """The paper's result: x > y > z in position."""
    return bool(s[0] > s[1] > s[2])


def growth_by_clock() -> list[dict[str, Any]]:
    """Two satellites, improved, with the clock: transient growth by the stability of the clock."""
    rows = []
    for value in CLOCKS:
        scene, model = Scene(numbers=replace(Numbers(), stability=value)), MODELS[3]
        found = stability(scene.system(model), scene.P0(model), groups=("pos",))
        pos = found.growth[0]
        rows.append(
            {
                "clock_stability": value,
                "growth_of_position": pos.factor,
                "after_s": pos.after_s,
                "spectral_radius_max": float(found.spectral_radius.max()),
                "verdict": found.verdict,
            }
        )
    return rows


def south() -> list[dict[str, Any]]:
    """Three satellites, plain, the first 100 s at several latitudes: where the spectral radius passes 1.

    With the numbers of the study, with a start known to 10 m, and with slow ones that make the effect (``quiet``).
    """
    n = Numbers()
    # Searched for, to see whether the effect can exist at all: a start known to metres, an aircraft that hardly
    # accelerates, a clock that hardly drifts.
    quiet = Numbers(stability=7e-12, acceleration_mps2=0.008, tau_s=1800.0, sigma0=(3.2, 0.04, 0.008, 3.2))
    settings = {"study": n, "start known to 10 m": replace(n, sigma0=(10.0, 10.0, 1.0, 10.0)), "quiet": quiet}
    rows = []
    for name, numbers in settings.items():
        for latitude in SOUTH:
            scene = Scene(latitude, numbers, 100.0)
            system = scene.system(MODELS[0])
            gains = system.filtered(scene.P0(MODELS[0])).K
            Psi = np.stack([(np.eye(system.n) - K @ s.H) @ s.Phi for K, s in zip(gains, system.steps, strict=True)])
            rho = np.abs(np.linalg.eigvals(Psi)).max(axis=1)
            rows.append(
                {
                    "settings": name,
                    "latitude_deg": latitude,
                    "spectral_radius_max": float(rho.max()),
                    "above_one_s": _above(rho),
                }
            )
    return rows


def checks(result: Mapping[str, Any]) -> dict[str, Any]:
    """The paper's statements, each with whether it was found."""
    here = {(c["satellites"], c["model"], c["latitude_deg"]): c for c in result["cases"]}

    def every(satellites: int, model: str, test: Callable[[dict[str, Any]], bool]) -> bool:
        return all(test(here[satellites, model, latitude]) for latitude in LATITUDES)

    sizes = {(b["satellites"], b["model"], b["kind"], b["recovery"]): b["largest_survived_m"] for b in result["bursts"]}
    degree = result["degree"]
    ratio = {
        kind: _ratio(sizes[3, "improved", kind, False], sizes[3, "plain", kind, False])
        for kind in ("position", "velocity", "clock", "start")
    }
    study = [r for r in result["south"] if r["settings"] == "study"]
    return {
        "three_satellites_below_one": every(3, "plain", lambda c: c["spectral_radius_max"] < 1.0),
        "three_satellites_observable": every(3, "plain", lambda c: c["observable"] and c["controllable"]),
        "two_without_clock_exactly_one": every(
            2, "plain_no_clock", lambda c: abs(c["spectral_radius_late"] - 1.0) < 1e-9
        ),
        "two_without_clock_unobservable": every(2, "plain_no_clock", lambda c: not c["observable"]),
        "nine_states_below_0_99": every(2, "plain_9_states", lambda c: c["spectral_radius_late"] < 0.99),
        "improved_three_asymptotically_stable": every(
            3, "improved", lambda c: c["verdict"] == "asymptotically stable" and c["observable"]
        ),
        "improved_two_stable_unobservable": every(
            2, "improved", lambda c: c["verdict"] == "stable" and not c["observable"] and c["controllable"]
        ),
        "above_one_south_of_33": any(r["above_one_s"] for r in study if r["latitude_deg"] < 33.0),
        "degree_x_y_z": degree["x"] > degree["y"] > degree["z"],
        "x_y_z_at_s": [t for t in DEGREE_S if _falls(result["degree_table"], f"covariance_{t:g}s")],
        "improved_over_plain_without_recovery": ratio,
        "improved_survives_ten_times_more": all(r is not None and r >= 10.0 for r in ratio.values()),
    }


def _falls(rows: Sequence[Mapping[str, Any]], key: str) -> bool:
    value = {row["state"]: row[key] for row in rows}
    return bool(value["x"] > value["y"] > value["z"])


def _ratio(a: float, b: float) -> float | None:
    return a / b if b > 0.0 else None


def settings(runs: int, seed: int) -> dict[str, Any]:
    """Everything that was chosen."""
    return {
        "version": __version__,
        "runs": runs,
        "seed": seed,
        "period_s": PERIOD_S,
        "place": list(PLACE),
        "latitudes_deg": list(LATITUDES),
        "local_window_steps": LOCAL,
        "numbers": {k: list(v) if isinstance(v, tuple) else v for k, v in vars(Numbers()).items()},
        "clock_states_from": CLK,
    }


def _false_alarm(record: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "satellites": record["satellites"],
        "model": record["model"],
        "runs": record["runs"],
        "false_alarms": record["resets"] + record["rolled"],
        "median_largest_error_m": record["median_peak_m"],
    }


def finite(value: Any) -> Any:
    """The same with None for numbers that JSON has no word for."""
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
