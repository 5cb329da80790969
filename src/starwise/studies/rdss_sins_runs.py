"""Monte Carlo of the RDSS/SINS paper: which runs are done, what is kept of each, and what many come to."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from starwise.analysis.consistency import (
    DelayCheck,
    autocorrelation,
    coverage,
    delay_check,
    nis_region,
    nis_test,
    pass_region,
    whiteness_bound,
    whiteness_test,
)
from starwise.estimators.late import LateMethod, LateRows, LinearSystem, run_late
from starwise.kernels.sins15 import N0, linear_model
from starwise.sim.seeds import streams
from starwise.studies.montecarlo import Row
from starwise.studies.rdss_sins_scene import (
    DELAY_SIGMA_S,
    DURATION_S,
    EVERY,
    EXPERIMENTS,
    PERIOD,
    PERIOD_S,
    RATE_HZ,
    Experiment,
    Scene,
    SinsRun,
    Way,
    variant,
)

if TYPE_CHECKING:
    import polars as pl

RunRow = dict[str, float | int | str | None]
SEED: Final = 20030401
K: Final = 50
"""Terms of the statistics (paper)."""
LAGS: Final = 8
WINDOW: Final = K + LAGS
"""Fixes in a window: every lag has K terms."""
SETTLED_S: Final = DURATION_S / 4.0
"""Errors and windows count from here on."""
PAPER_RHO: Final = (-0.4054, -0.0259, -0.0411, -0.0881, 0.1637, -0.1903, 0.0842, 0.1781)
PAPER_NIS: Final = 0.893
WAYS: Final[tuple[Way, ...]] = ("optimal_prediction", "replay", "cloning", "ignored", "estimated")
SPEEDS: Final = (5.0, 10.0, 20.0, 40.0, 100.0, 250.0)
TURNS: Final = (0.0, 2.0, 5.0, 10.0, 30.0, 90.0)


@dataclass(frozen=True)
class Job:
    """An experiment, the ways it is filtered by, and what part of the runs it gets."""

    group: str
    experiment: Experiment
    ways: tuple[Way, ...]
    every: int = 1
    """Run numbers that are multiples of this."""


def jobs() -> tuple[Job, ...]:
    """All that is run: the paper's two experiments, and beyond."""
    beyond = 5
    short: tuple[Way, ...] = ("optimal_prediction", "replay", "cloning", "ignored")
    out = [Job("paper", experiment, ("free", *WAYS)) for experiment in EXPERIMENTS.values()]
    for speed in (60.0, 250.0):
        for known in (False, True):
            what = f"jitter 0.1 s, {'known' if known else 'unknown'}, {speed:g} m/s"
            x = variant(name=what, speed_mps=speed, jitter_s=0.1, known_jitter=known)
            out.append(Job("jitter", x, short if not known else ("replay", "cloning"), beyond))
    for speed in SPEEDS:
        x = variant(name=f"ignored at {speed:g} m/s", speed_mps=speed)
        out.append(Job("speed", x, ("ignored",), beyond))
    for turn in TURNS:
        x = variant(name=f"100 m/s, turns of {turn:g} deg", speed_mps=100.0, turns=turn > 0.0, turn_deg=turn)
        out.append(Job("blind spot", x, ("ignored", "optimal_prediction", "estimated"), beyond))
    models: dict[str, dict[str, Any]] = {
        "R x 0.25": {"R_factor": 0.25},
        "R x 4": {"R_factor": 4.0},
        "fix errors correlated 0.3": {"fix_correlation": 0.3},
        "fix errors correlated 0.6": {"fix_correlation": 0.6},
        "height error constant": {"constant_height_error": True},
    }
    out += [
        Job("model", variant(name=name, **changes), ("optimal_prediction",), beyond) for name, changes in models.items()
    ]
    return tuple(out)


@dataclass(frozen=True)
class SinsTask:
    """A run of all jobs whose turn it is."""

    seed: int = SEED

    def description(self) -> Mapping[str, Any]:
        """See `starwise.studies.montecarlo.Task`."""
        return {
            "what": "rdss_sins",
            "seed": self.seed,
            "jobs": [asdict(job) for job in jobs()],
            "windows": [K, LAGS, SETTLED_S],
        }

    def prepare(self) -> Callable[[int], Sequence[Row]]:
        """See `starwise.studies.montecarlo.Task`."""
        scenes: dict[int, Scene] = {}
        todo = jobs()

        def rows(number: int) -> list[Row]:
            out: list[Row] = []
            for index, job in enumerate(todo):
                if number % job.every:
                    continue
                if index not in scenes:
                    scenes[index] = Scene(job.experiment)
                measured = scenes[index].simulate(number, self.seed)
                done = {way: scenes[index].filtered(measured, way) for way in job.ways}
                reference = done.get("replay")
                for way in job.ways:
                    head: RunRow = {"group": job.group, "experiment": job.experiment.name, "method": way, "run": number}
                    out.append(head | run_row(done[way], reference, free=way == "free"))
            return out

        return rows


def run_row(run: SinsRun, replay: SinsRun | None = None, *, free: bool = False) -> RunRow:
    """Numbers of one run, without the first quarter.

    Returns
    -------
    dict
        RMS of position and velocity; passed windows of each test; autocorrelations and NIS of the last window; the
        check of the delay; the estimated delay.
    """
    late = run.t_s >= SETTLED_S
    error = run.position_error[late]
    row: RunRow = {
        "rms_position_m": _rms(error),
        "rms_velocity_mps": _rms(run.velocity_error[late]),
        "last_position_m": float(np.linalg.norm(run.position_error[-1])),
        "claimed_position_m": float(np.sqrt(run.P[late, 2, 2] + run.P[late, 3, 3]).mean()),
        "coverage_95": None if free else coverage(error, run.P[late, 2:, 2:]),
        "nis_per_dof": None if free else float(run.nis[late].mean() / 2.0),
        "replay_difference_m": None,
    }
    if replay is not None and not free:
        row["replay_difference_m"] = float(np.abs(run.position_error - replay.position_error).max())
    row |= dict.fromkeys(("windows", "nis_passed", "white_passed", "both_passed", "eq8_passed"), 0)
    row |= dict.fromkeys(("scalar_each_passed", "scalar_joint_passed"), 0)
    row |= dict.fromkeys(("window_nis", *(f"rho{k}" for k in range(1, LAGS + 1))), None)
    row |= {
        "verdict": None,
        "delay_s": None,
        "delay_sigma_s": None,
        "hidden_m": None,
        "tau_s": None,
        "tau_sigma_s": None,
    }
    if free:
        return row
    row |= window_counts(run, np.flatnonzero(late))
    if np.isfinite(run.tau[-1, 0]):
        row |= {"tau_s": float(run.tau[-1, 0]), "tau_sigma_s": float(run.tau[-1, 1])}
        return row
    check = check_of(run)
    seen = np.isfinite(check.sigma_s)
    row |= {"verdict": check.verdict, "hidden_m": check.hidden_m}
    row |= {"delay_s": check.delay_s if seen else None, "delay_sigma_s": check.sigma_s if seen else None}
    return row


def check_of(run: SinsRun) -> DelayCheck:
    """Delay check of a whole run."""
    claimed = float(np.sqrt(run.P[-1, 2, 2] + run.P[-1, 3, 3]))
    return delay_check(run.v, run.S, run.signature, run.effect[-1], claimed, DELAY_SIGMA_S)


def _rms(error: Any) -> float:
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def window_counts(run: SinsRun, at: Any) -> RunRow:
    """Passed windows, back to back from the end of the run, and the numbers of the last one."""
    count = len(at) // WINDOW
    passed = np.zeros((count, 6), dtype=bool)
    out: RunRow = {}
    joint = whiteness_bound(K, 1, LAGS)
    for w in range(count):
        i = at[len(at) - (w + 1) * WINDOW : len(at) - w * WINDOW]
        v, S = run.v[i], run.S[i]
        nis = nis_test(run.nis[i[:K]], 2)
        white = whiteness_test(v, S, LAGS, K)
        north = np.abs(autocorrelation(v[:, 0], LAGS, K))
        passed[w] = (
            nis.passed,
            white.passed,
            nis.passed and white.passed,
            (np.abs(autocorrelation(v, LAGS, K)) <= 1.96 / np.sqrt(K)).all(),
            (north <= 1.96 / np.sqrt(K)).all(),
            (north <= joint).all(),
        )
        if w == 0:
            out["window_nis"] = nis.per_dof
            out |= {f"rho{k}": float(r) for k, r in enumerate(white.rho, 1)}
    names = ("nis_passed", "white_passed", "both_passed", "eq8_passed", "scalar_each_passed", "scalar_joint_passed")
    return out | {"windows": count} | {name: int(passed[:, k].sum()) for k, name in enumerate(names)}


def summarise(table: "pl.DataFrame", experiment: str, method: str) -> dict[str, Any]:
    """What all runs of a method in an experiment come to.

    Returns
    -------
    dict
        RMS over runs, mean NIS per degree of freedom, parts of windows that passed and the least part that a correct
        filter has (99.9 %), coverage, ``consistent``: both parts reach it; verdicts of the delay check.
    """
    import polars as pl

    rows = table.filter((pl.col("experiment") == experiment) & (pl.col("method") == method))
    runs, windows = rows.height, int(rows["windows"].sum())

    def mean(name: str) -> float | None:
        value = rows[name].mean()
        return float(value) if isinstance(value, int | float) else None

    def rms(name: str) -> float:
        return float(np.sqrt(np.mean(np.square(rows[name].to_numpy()))))

    out: dict[str, Any] = {
        "experiment": experiment,
        "method": method,
        "runs": runs,
        "rms_position_m": rms("rms_position_m"),
        "rms_velocity_mps": rms("rms_velocity_mps"),
        "claimed_position_m": mean("claimed_position_m"),
    }
    if method == "free":
        return out
    rate = {name: float(rows[f"{name}_passed"].sum()) / windows for name in ("nis", "white", "both", "eq8")}
    least = pass_region(windows)[0]
    out |= {
        "nis_per_dof": mean("nis_per_dof"),
        "coverage_95": mean("coverage_95"),
        "windows": windows,
        **{f"{name}_pass_rate": value for name, value in rate.items()},
        "scalar_each_pass_rate": float(rows["scalar_each_passed"].sum()) / windows,
        "scalar_joint_pass_rate": float(rows["scalar_joint_passed"].sum()) / windows,
        "least_pass_rate": least,
        "consistent": bool(rate["nis"] >= least and rate["white"] >= least),
        "replay_difference_m": _most(rows["replay_difference_m"].to_list()),
    }
    verdicts = rows["verdict"].drop_nulls().to_list()
    if verdicts:
        out |= {f"delay_{v}_rate": verdicts.count(v) / len(verdicts) for v in ("wrong", "unverifiable", "confirmed")}
        out |= {"delay_s": mean("delay_s"), "delay_sigma_s": mean("delay_sigma_s"), "hidden_m": mean("hidden_m")}
    else:
        out |= {"tau_s": mean("tau_s"), "tau_sigma_s": mean("tau_sigma_s"), "tau_spread_s": _spread(rows["tau_s"])}
    return out


def _most(values: list[float | None]) -> float | None:
    there = [value for value in values if value is not None]
    return max(there) if there else None


def _spread(column: "pl.Series") -> float:
    return float(np.sqrt(np.mean((column.to_numpy() - PERIOD_S) ** 2)))


def window_bounds() -> dict[str, float]:
    """Regions of the tests of a window."""
    low, high = nis_region(2 * K)
    return {"nis_low": low, "nis_high": high, "rho_bound": whiteness_bound(K, 2, LAGS)}


def mean_window(table: "pl.DataFrame", experiment: str, method: str) -> dict[str, Any]:
    """Numbers of the last window: means over all runs, and those of run 0."""
    import polars as pl

    rows = table.filter((pl.col("experiment") == experiment) & (pl.col("method") == method)).sort("run")
    names = [f"rho{k}" for k in range(1, LAGS + 1)]
    first = rows.row(0, named=True)
    bounds = window_bounds()
    inside = bounds["nis_low"] <= first["window_nis"] <= bounds["nis_high"]
    white = all(abs(first[name]) <= bounds["rho_bound"] for name in names)
    return {
        "nis_per_dof": float(rows["window_nis"].to_numpy().mean()),
        "rho": [float(rows[name].to_numpy().mean()) for name in names],
        "first_run": {
            "nis_per_dof": first["window_nis"],
            "rho": [first[name] for name in names],
            "passed": bool(inside and white),
        },
    }


def linear_difference(experiment: Experiment, seed: int = SEED) -> dict[str, float]:
    """Largest difference to exact replay of position estimates in the linear 15-state system, m.

    The error states along the true trajectory, without the second order that feedback into a navigator has: there the
    ways must agree to rounding.
    """
    scene = Scene(experiment)
    every, model = EVERY, scene.model()
    T = len(scene.perfect.dt_s) // every
    nav, Phi, Q = np.empty((T + 1, 10)), np.empty((T, N0, N0)), np.empty((T, N0, N0))
    linear_model(scene.perfect.gyro, scene.perfect.accel, scene.nav0(), model, nav, Phi, Q)
    rng = streams(seed, 0)("linear")
    P0 = experiment.errors.P0()
    x = np.sqrt(np.diag(P0)) * rng.standard_normal(N0)
    valid = scene.asked // every
    at = np.empty((T + 1, 2))
    roots = np.sqrt(np.maximum(Q.diagonal(axis1=1, axis2=2), 0.0))  # correlations of the noise do not matter here
    for j in range(T + 1):
        at[j] = x[5:7]
        if j < T:
            x = Phi[j] @ x + roots[j] * rng.standard_normal(N0)
    L = np.linalg.cholesky(scene.R)
    H = np.zeros((len(valid), 2, N0))
    H[:, :, 5:7] = np.linalg.inv(L)
    y = np.einsum("kij,kj->ki", H[:, :, 5:7], at[valid]) + rng.standard_normal((len(valid), 2))
    rows = LateRows(valid, valid + PERIOD // every, y, H, np.ones((len(valid), 2)))
    system = LinearSystem(Phi, Q, every / RATE_HZ)
    exact = run_late(system, rows, np.zeros(N0), P0, "replay").x[:, 5:7]
    others: tuple[LateMethod, ...] = ("optimal_prediction", "cloning", "ignored")
    return {way: float(np.abs(run_late(system, rows, np.zeros(N0), P0, way).x[:, 5:7] - exact).max()) for way in others}
