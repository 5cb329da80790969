"""Bursts: the state of a running filter is spoiled. How large may that be, how long until it is well again.

Each run simulates a flight of 200 s. All filters settle for 100 s; then an error of a random direction is put into
the position, the velocity or the clock of a copy of each, or into the position at the very beginning. A run has
recovered if its position error is below six sigmas (root of the trace of the undisturbed filter's covariance, which
needs no run to be known) in the last 25 s; the time to recover ends when it is so for good.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from starwise.chi2 import chi_square_points
from starwise.frames import ecef_from_geodetic
from starwise.kernels.stability import (
    CLK,
    NEVER,
    REINITIALISE,
    RESETS,
    ROLL_BACK,
    ROLLED,
    Filter,
    Memory,
    N,
    run_flight,
)
from starwise.sim.seeds import streams
from starwise.studies.stability_scene import MODELS, PERIOD_S, Model, Scene
from starwise.types import F8

if TYPE_CHECKING:
    import polars as pl

WAYS: Final = {"none": NEVER, "reinitialise": REINITIALISE, "roll_back": ROLL_BACK}
"""Nothing; a new start by least squares; kept filters first. The last is what ``recovery`` means."""
KINDS: Final = ("position", "velocity", "clock", "start")
SIZES: Final = (30.0, 100.0, 300.0, 1e3, 1e4, 1e6, 1e8, 3e11)
"""m; of the velocity m/s."""
SETTLE_S: Final = 100.0
LENGTH_S: Final = 200.0
LAST_S: Final = 25.0
QUIET_S: Final = 600.0
SIGMAS: Final = 6.0
FALSE_ALARM: Final = 1e-7
"""Of an epoch's gate, and of each mean's; a mean is the same for many epochs, so it alarms less often."""
WEIGHTS: Final = (1.0 / 4.0, 1.0 / 32.0)
"""Of the means: 1 s and 8 s."""
PATIENCE: Final = 3
KEEP_EVERY: Final = 20
SLOTS: Final = 12
"""A filter is kept every 5 s, for a minute: longer than the means take to see what will be seen."""
SOON: Final = 120
PRIOR: Final = (35.0, 110.5, 10_000.0)
"""Region of use: the middle of what the satellites serve."""
PRIOR_SIGMA: Final = (3e6, 300.0, 10.0, 1e6, 0.3)
"""Position, velocity, acceleration, clock, drift of a new start: a continent, any aircraft, a millisecond or so."""


def filter_of(scene: Scene, model: Model) -> Filter:
    """Numbers of a model's filter and of its recovery."""
    Phi, Q = scene.transition(model)
    _, R = scene.rows(model)
    gates = chi_square_points(FALSE_ALARM, len(R) + 1)
    prior, sigma = np.zeros(N), np.empty(N)
    prior[:3] = ecef_from_geodetic([np.radians(PRIOR[0]), np.radians(PRIOR[1]), PRIOR[2]])
    pos, vel, acc, clk, drift = PRIOR_SIGMA
    sigma[:] = [pos] * 3 + [vel] * 3 + [acc] * 3 + [clk, drift]
    axis, clock = slice(0, CLK, 3), slice(CLK, N)
    return Filter(
        clock=model.clock,
        improved=model.improved,
        solvable=model.clock and model.satellites >= 3,
        F=np.ascontiguousarray(Phi[axis, axis]),
        G=np.ascontiguousarray(Q[axis, axis]),
        C=np.ascontiguousarray(Phi[clock, clock]),
        D=np.ascontiguousarray(Q[clock, clock]),
        variance=R,
        gate=float(gates[len(R)]),
        mean_gate=float(gates[len(R)]),
        weight=np.array(WEIGHTS),
        patience=PATIENCE,
        keep_every=KEEP_EVERY,
        soon=SOON,
        prior=prior,
        prior_sigma=sigma,
    )


def memory_of(x: F8, P: F8, rows: int) -> Memory:
    """Memory of a filter that begins with a belief."""
    return Memory(
        x.copy(), P.copy(), np.zeros((2, rows)), np.zeros(4, dtype=np.int64), np.zeros((SLOTS, N)),
        np.zeros((SLOTS, N, N)), np.zeros((SLOTS, 2, rows)), np.full(SLOTS, -1, dtype=np.int64),
    )  # fmt: skip


def copy_of(memory: Memory) -> Memory:
    """Independent copy of a filter's memory."""
    m = memory
    return Memory(
        m.x.copy(), m.P.copy(), m.mean.copy(), m.tally.copy(), m.kept_x.copy(), m.kept_P.copy(), m.kept_mean.copy(),
        m.kept_at.copy(),
    )  # fmt: skip


def simulate(scene: Scene, model: Model, run: int, seed: int) -> tuple[F8, F8, F8]:
    """Measurements (K, m) of a flight, the true positions (K, 3), and the filter's state at the start (11,).

    Errors are the model's own: white, of its sigmas; the clock's drift is drawn from its Markov process. Filters of
    one run share errors of the same kind.
    """
    source = streams(seed, run)
    pos, vel, acc = scene.kinematics
    K, k = len(pos), model.satellites
    Phi, Q = scene.transition(Model(3))
    C, D = Phi[CLK:, CLK:], Q[CLK:, CLK:]
    clock = np.zeros((K + 1, 2))
    if model.clock:
        g = source("stability/clock")
        L = np.linalg.cholesky(D)
        clock[0, 1] = g.normal() * scene.numbers.drift_mps
        for i in range(K):
            clock[i + 1] = C @ clock[i] + L @ g.normal(size=2)
    line = scene.satellites(k) - pos[:, None]
    rho = np.linalg.norm(line, axis=2)
    height = scene.llh[1:, 2:]
    parts = [rho + clock[1:, :1], height]
    if model.improved:
        rate = -(line * vel[:, None]).sum(axis=2) / rho + clock[1:, 1:]
        parts += [rate, acc]
    z = np.concatenate(parts, axis=1)
    names = [f"range/{i}" for i in range(k)] + ["height"]
    names += [f"rate/{i}" for i in range(k)] + [f"ins/{i}" for i in range(3)] if model.improved else []
    _, R = scene.rows(model)
    for i, name in enumerate(names):
        z[:, i] += np.sqrt(R[i]) * source(f"stability/{name}").normal(size=K)
    x = np.concatenate([pos[0] - PERIOD_S * vel[0], vel[0], acc[0], clock[0]])
    sigma = np.sqrt(np.diag(scene.P0(model)))
    if not model.clock:
        sigma[CLK:] = 0.0
    return z, pos, x + sigma * source("stability/start").normal(size=N)


def burst_of(kind: str, size: float, source: np.random.Generator) -> F8:
    """Error (11,) of a size and a random direction."""
    out = np.zeros(N)
    u = source.normal(size=3)
    u /= np.linalg.norm(u)
    if kind == "clock":
        out[CLK] = size if u[0] > 0.0 else -size
    else:
        first = 3 if kind == "velocity" else 0
        out[first : first + 3] = size * u
    return out


@dataclass(frozen=True)
class BurstTask:
    """Bursts of all kinds and sizes in all models, for `starwise.studies.montecarlo.run_many`."""

    seed: int
    sizes: tuple[float, ...] = SIZES
    models: tuple[Model, ...] = MODELS

    def description(self) -> Mapping[str, Any]:
        """Everything that the numbers depend on."""
        return {
            "task": "stability bursts",
            "seed": self.seed,
            "sizes": self.sizes,
            "models": [str(m) for m in self.models],
        }

    def prepare(self) -> Callable[[int], Sequence[Mapping[str, float | int | str | None]]]:
        """Do what is common to all runs."""
        scene, quiet = Scene(duration_s=LENGTH_S), Scene(duration_s=QUIET_S)
        ready = []
        for model in self.models:
            sigma = scene.system(model).filtered(scene.P0(model)).P[:, :3, :3]
            bound = SIGMAS * np.sqrt(np.trace(sigma, axis1=1, axis2=2))
            ready.append((model, filter_of(scene, model), scene.satellites(model.satellites), bound))

        def one(run: int) -> list[Mapping[str, float | int | str | None]]:
            rows: list[Mapping[str, float | int | str | None]] = []
            for model, f, sat, bound in ready:
                rows.append(_quiet(quiet, model, f, sat, run, self.seed))
                rows += _bursts(scene, model, f, sat, bound, run, self.seed, self.sizes)
            return rows

        return one


def _quiet(scene: Scene, model: Model, f: Filter, sat: F8, run: int, seed: int) -> dict[str, float | int | str]:
    """A long run without a burst: alarms of it are false."""
    z, truth, x = simulate(scene, model, run, seed)
    memory, error = memory_of(x, scene.P0(model), z.shape[1]), np.empty(len(z))
    run_flight(f, sat, z, truth, 0, len(z), ROLL_BACK, memory, error)
    settled = error[round(SETTLE_S / PERIOD_S) :]
    return _row(model, "none", 0.0, "roll_back", run, True, 0.0, float(settled.max()), memory, truth[-1])


def _bursts(
    scene: Scene, model: Model, f: Filter, sat: F8, bound: F8, run: int, seed: int, sizes: Sequence[float]
) -> list[Mapping[str, float | int | str | None]]:
    z, truth, x = simulate(scene, model, run, seed)
    K, at = len(z), round(SETTLE_S / PERIOD_S)
    fresh = memory_of(x, scene.P0(model), z.shape[1])
    settled, error = copy_of(fresh), np.empty(K)
    run_flight(f, sat, z, truth, 0, at, ROLL_BACK, settled, error)
    rows: list[Mapping[str, float | int | str | None]] = []
    for kind in KINDS:
        if kind == "clock" and not model.clock:
            continue  # its clock is in no measurement
        source = streams(seed, run)(f"stability/burst/{kind}")
        for size in sizes:
            burst = burst_of(kind, size, source)
            first = 0 if kind == "start" else at
            for way, number in WAYS.items():
                memory = copy_of(fresh if kind == "start" else settled)
                memory.x[:] += burst
                memory.tally[RESETS : ROLLED + 1] = 0
                run_flight(f, sat, z, truth, first, K, number, memory, error)
                # At the start the filter is given the time that it needs anyway.
                bad = np.flatnonzero(~(error[first:] <= np.maximum(bound[first:], bound[at])))
                time = 0.0 if not len(bad) else (int(bad[-1]) + 1) * PERIOD_S
                ok = time <= (K - first) * PERIOD_S - LAST_S
                peak = float(np.nan_to_num(error[first:], nan=np.inf).max())
                rows.append(_row(model, kind, size, way, run, ok, time, peak, memory, truth[-1]))
    return rows


def _row(
    model: Model, kind: str, size: float, way: str, run: int, ok: bool, time: float, peak: float, memory: Memory,
    truth: F8,
) -> dict[str, float | int | str]:  # fmt: skip
    e, P = memory.x[:3] - truth, memory.P[:3, :3]
    d = np.sqrt(np.maximum(np.diag(P), 1e-30))
    with np.errstate(over="ignore", invalid="ignore"):
        nees = float(e / d @ np.linalg.pinv(P / np.outer(d, d)) @ (e / d)) if np.isfinite(P).all() else np.inf
    return {
        "satellites": model.satellites,
        "model": model.name,
        "kind": kind,
        "size": size,
        "way": way,
        "run": run,
        "recovered": int(ok),
        "time_s": float(time),
        "peak_m": peak,
        "nees": nees if np.isfinite(nees) else 1e300,
        "resets": int(memory.tally[RESETS]),
        "rolled": int(memory.tally[ROLLED]),
    }


def burst_table(table: "pl.DataFrame") -> list[dict[str, Any]]:
    """A record per model, kind, size and way: how many recovered, when, how far off, and whether the covariance knew.

    ``honest`` is the part of runs whose position error at the end lies in the 99.9 % ellipsoid of the filter.
    """
    import polars as pl

    limit = float(chi_square_points(1e-3, 4)[3])
    keys = ["satellites", "model", "kind", "size", "way"]
    grouped = table.group_by(keys, maintain_order=True).agg(
        pl.len().alias("runs"),
        pl.col("recovered").sum(),
        pl.col("time_s").filter(pl.col("recovered") == 1).median().alias("median_s"),
        pl.col("time_s").filter(pl.col("recovered") == 1).max().alias("max_s"),
        pl.col("peak_m").median().alias("median_peak_m"),
        (pl.col("nees") <= limit).mean().alias("honest"),
        ((pl.col("resets") + pl.col("rolled")) > 0).mean().alias("detected"),
        pl.col("resets").sum(),
        pl.col("rolled").sum(),
    )
    return list(grouped.to_dicts())


def survival(records: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A record per model, kind and recovery: the largest size up to which *every* run of *every* size recovers.

    ``honest_at_largest``: part of these runs whose covariance holds their error at the end. A filter may stay within
    its six sigmas and yet be sure of a wrong position.
    """
    out: list[dict[str, Any]] = []
    for recovery, way in ((False, "none"), (True, "roll_back")):
        rows = [r for r in records if r["way"] == way and r["kind"] != "none"]
        for key in dict.fromkeys((r["satellites"], r["model"], r["kind"]) for r in rows):
            mine = sorted((r for r in rows if (r["satellites"], r["model"], r["kind"]) == key), key=lambda r: r["size"])
            good: list[Mapping[str, Any]] = []
            for r in mine:
                if r["recovered"] < r["runs"]:
                    break
                good.append(r)
            after = [r for r in mine if r["recovered"] == r["runs"]]
            times = [r["median_s"] for r in good]
            out.append(
                {
                    "satellites": key[0],
                    "model": key[1],
                    "kind": key[2],
                    "recovery": recovery,
                    "largest_survived_m": good[-1]["size"] if good else 0.0,
                    "recovery_s": max(times) if times else None,
                    "recovery_max_s": max(r["max_s"] for r in good) if good else None,
                    "honest_at_largest": good[-1]["honest"] if good else None,
                    "largest_with_all_runs": after[-1]["size"] if after else 0.0,
                    "lost_sizes": [r["size"] for r in mine if r["recovered"] < r["runs"]],
                    "undetected_sizes": [r["size"] for r in mine if r["detected"] < 0.5],
                    "runs": mine[0]["runs"],
                    "unit": "m/s" if key[2] == "velocity" else "m",
                }
            )
    return out
