"""Monte Carlo: 1000 runs of scenario 3 of the S3EKF paper on all cores, and the same filter by filterpy on a sample.

python benchmarks/montecarlo.py [--json] [--runs 1000] [--sample 5]
python benchmarks/montecarlo.py --table 10000 [--json]

The second makes a table: 100, 1000 ... runs by one process and by one for every core: time, processor time, memory.

filterpy's ExtendedKalmanFilter gets the same measurements, the same process and measurement noise and the same start;
its callbacks h and H are vectorised numpy. The largest distance between the two trajectories is printed.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np

from starwise.constants import C_LIGHT, OMEGA_E_GPS
from starwise.models.process import clocks_from, matrices
from starwise.sim.scenario import load_scenario
from starwise.studies.accuracy_runs import AccuracyTask, natural_config
from starwise.studies.montecarlo import run_many
from starwise.studies.s3ekf_filter import paper_config, paper_motion, solve_paper
from starwise.studies.scene import Scene, Sky

SCENARIO = "s3ekf-3-turn"
SAGNAC = OMEGA_E_GPS / C_LIGHT


def own(runs: int, workers: int | None = None) -> float:
    scenario = load_scenario(SCENARIO)
    task = AccuracyTask(scenario, scenario.seed, ("s3ekf",), natural_config(scenario))
    with tempfile.TemporaryDirectory(prefix="starwise-bench-") as folder:
        began = time.perf_counter()
        run_many(task, runs, folder, workers=workers)
        return time.perf_counter() - began


class Epoch:
    """What satellites give at an epoch, and filterpy's two callbacks."""

    def __init__(self, sky: Sky, a: int, b: int) -> None:
        r = sky.rows
        self.sat, self.vel, self.clock = r.sat_pos[a:b], r.sat_vel[a:b], r.clock_m[a:b]
        self.drift, self.at, self.m = r.drift_mps[a:b], r.clock[a:b], int(b - a)
        self.z = np.column_stack([r.code_m[a:b], r.rate_mps[a:b]]).ravel()

    def geometry(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        d = self.sat - x[:3]
        rho = np.sqrt((d * d).sum(axis=1))
        u, w = d / rho[:, None], self.vel - x[3:6]
        return rho, u, w, (u * w).sum(axis=1)

    def h(self, x: np.ndarray) -> np.ndarray:
        rho, _, _, along = self.geometry(x)
        sat, vel = self.sat, self.vel
        out = np.empty(2 * self.m)
        out[::2] = rho + SAGNAC * (sat[:, 0] * x[1] - sat[:, 1] * x[0]) + x[9 + self.at] - self.clock
        sagnac = SAGNAC * (vel[:, 0] * x[1] + sat[:, 0] * x[4] - vel[:, 1] * x[0] - sat[:, 1] * x[3])
        out[1::2] = along + sagnac + x[11 + self.at] - self.drift
        return out

    def H(self, x: np.ndarray) -> np.ndarray:
        rho, u, w, along = self.geometry(x)
        sat, vel, zero = self.sat, self.vel, np.zeros(self.m)
        e = u + SAGNAC * np.column_stack([sat[:, 1], -sat[:, 0], zero])
        g = (along[:, None] * u - w) / rho[:, None] + SAGNAC * np.column_stack([-vel[:, 1], vel[:, 0], zero])
        out = np.zeros((2 * self.m, 13))
        out[::2, :3], out[1::2, :3], out[1::2, 3:6] = -e, g, -e
        out[2 * np.arange(self.m), 9 + self.at] = 1.0
        out[2 * np.arange(self.m) + 1, 11 + self.at] = 1.0
        return out


def filterpy_run(sky: Sky, start: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    from filterpy.kalman import ExtendedKalmanFilter

    config = paper_config("ekf")
    Phi, Q = matrices(paper_motion(), clocks_from(config), 2, 1.0)
    pos = np.empty((len(sky.epochs.t_ns), 3))
    f = None
    for e, (a, b) in enumerate(itertools.pairwise(sky.epochs.offsets)):
        now = Epoch(sky, a, b)
        if f is None or f.dim_z != 2 * now.m:  # filterpy fixes the size of the measurement
            belief = start if f is None else (f.x, f.P)
            f = ExtendedKalmanFilter(dim_x=13, dim_z=2 * now.m)
            f.F, f.Q, f.R = Phi, Q, np.diag(np.tile([36.0, 0.01], now.m))
            f.x, f.P = belief
        if e > 0:
            f.predict()
        f.update(now.z, HJacobian=now.H, Hx=now.h)
        pos[e] = f.x[:3]
    return pos


def sample(count: int) -> dict[str, float]:
    """The same runs by both, interleaved, one core: noise drawn, filtered; the least of three turns of each run."""
    scene = Scene(load_scenario(SCENARIO))
    config, apart = paper_config("ekf"), 0.0
    P0 = np.diag([100.0] * 3 + [10.0] * 3 + [1.0] * 3 + [100.0] * 2 + [1.0] * 2)
    spent = {"filterpy": 0.0, "own": 0.0}
    for number in range(count):
        sky = scene.run(number, config)
        x0 = np.concatenate([sky.pos_e[0], sky.vel_e[0], np.zeros(3), np.full(2, 1e-5 * C_LIGHT), np.full(2, 3.0)])
        pos, least = {}, {"filterpy": np.inf, "own": np.inf}
        for _ in range(3):
            began = time.perf_counter()
            pos["filterpy"] = filterpy_run(scene.run(number, config), (x0.copy(), P0.copy()))
            least["filterpy"] = min(least["filterpy"], time.perf_counter() - began)
            began = time.perf_counter()
            pos["own"] = solve_paper(scene.run(number, config), "s3ekf", (x0, P0)).pos
            least["own"] = min(least["own"], time.perf_counter() - began)
        apart = max(apart, float(np.linalg.norm(pos["filterpy"] - pos["own"], axis=1).max()))
        for name, value in least.items():
            spent[name] += value / count * 1e3
    return {
        "filterpy_ms_per_run": spent["filterpy"],
        "own_ms_per_run_one_core": spent["own"],
        "ratio_one_core": spent["filterpy"] / spent["own"],
        "largest_distance_m": apart,
    }


def measured(runs: int, workers: int) -> dict[str, float]:
    """In a process of its own, so that its memory and its children's are of nothing else."""
    command = [sys.executable, __file__, "--one", str(runs), str(workers)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def one(runs: int, workers: int) -> dict[str, float]:
    own(2, 1)  # compiled code is loaded
    before = processor_s()
    seconds = own(runs, workers)
    memory = [resource.getrusage(who).ru_maxrss / 1e3 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return {
        "runs": runs,
        "workers": workers,
        "seconds": seconds,
        "cpu_s": processor_s() - before,
        "peak_MB_of_the_first": memory[0],
        "peak_MB_of_another": memory[1],
    }


def processor_s() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def table(most: int) -> list[dict[str, float]]:
    sizes = sorted({min(most, size) for size in (100, 1000, 10_000, 100_000, most)})
    rows = []
    for size in sizes:
        first = measured(size, 1)
        rest = [measured(size, count) for count in [os.cpu_count() or 1] if count > 1]
        rows += [{**row, "speed_up": first["seconds"] / row["seconds"]} for row in (first, *rest)]
    return rows


def show_table(rows: list[dict[str, float]]) -> None:
    load = os.getloadavg()[0]
    print(f"{SCENARIO}, S3EKF, 200 epochs a run; load of the machine at the end {load:.1f}")
    print(f"{'runs':>7} {'processes':>9} {'s':>7} {'cpu s':>7} {'ms/run':>7} {'speed-up':>8} {'MB':>5} {'MB other':>8}")
    for row in rows:
        print(
            f"{row['runs']:>7} {row['workers']:>9} {row['seconds']:>7.1f} {row['cpu_s']:>7.1f}"
            f" {row['seconds'] / row['runs'] * 1e3:>7.2f} {row['speed_up']:>8.2f} {row['peak_MB_of_the_first']:>5.0f}"
            f" {row['peak_MB_of_another']:>8.0f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--sample", type=int, default=5)
    parser.add_argument("--table", type=int, metavar="MOST")
    parser.add_argument("--one", type=int, nargs=2, metavar=("RUNS", "WORKERS"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        print(json.dumps(one(*args.one)))
        return
    if args.table:
        rows = table(args.table)
        print(json.dumps(rows, indent=1)) if args.json else show_table(rows)
        return
    own(2, 1)  # compiled code is loaded
    result = {"runs": args.runs, "seconds": own(args.runs), **sample(args.sample)}
    result["ratio_all_cores"] = result["filterpy_ms_per_run"] * args.runs / 1e3 / result["seconds"]
    if args.json:
        print(json.dumps(result, indent=1))
        return
    print(f"{args.runs} runs of {SCENARIO}, S3EKF, all cores: {result['seconds']:.1f} s (wanted: 1000 in 60 s)")
    print(f"one run on one core, noise drawn and filtered: {result['own_ms_per_run_one_core']:.2f} ms")
    print(f"the same run by filterpy: {result['filterpy_ms_per_run']:.1f} ms")
    print(
        f"ratio {result['ratio_one_core']:.0f} on one core, {result['ratio_all_cores']:.0f} with all cores and "
        f"start-up of the workers (wanted: 20); largest distance {result['largest_distance_m'] * 1e3:.3f} mm"
    )


if __name__ == "__main__":
    main()
