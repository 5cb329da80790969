"""Dask on this machine: three workers, one killed in the middle; is the result the local one, to the last bit?

python benchmarks/cluster.py [--runs 1000] [--json]

Two jobs: Monte Carlo runs of scenario 3 of the S3EKF paper, and a batch of station-days (the shared measurements; the
drive of the demo where they are absent). Each is done here first, then by the cluster, one of whose workers is killed
by SIGKILL when a third is done.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import signal
import tempfile
import time
from importlib import resources
from pathlib import Path

import distributed

from datasets import DATA
from starwise.batch import Manifest, Unit, run_batch, scan
from starwise.config import RunConfig
from starwise.sim.scenario import load_scenario
from starwise.studies.accuracy_runs import AccuracyTask, natural_config
from starwise.studies.montecarlo import run_many

SCENARIO = "s3ekf-3-turn"


class Killer:
    """Progress that kills a worker once, when a third is done."""

    def __init__(self, cluster: distributed.LocalCluster) -> None:
        self.cluster, self.killed = cluster, 0
        self.before: set[int] = set()

    def pids(self) -> set[int]:
        with distributed.Client(self.cluster.scheduler_address, set_as_default=False) as client:
            return set(client.run(os.getpid).values())

    def __call__(self, what: str, fraction: float) -> None:
        if not self.killed and fraction >= 1 / 3:
            self.before = self.pids()
            self.killed = min(self.before)
            os.kill(self.killed, signal.SIGKILL)

    def report(self) -> dict:
        return {"killed": self.killed, "workers_before": len(self.before), "workers_at_the_end": len(self.pids())}


def contents(folder: Path) -> str:
    """Hash of all results, without the seconds that the seals of units hold."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("unit=*/*")):
        data = path.read_bytes()
        if path.name == "unit.json":
            record = json.loads(data)
            del record["row"]["seconds"]
            data = json.dumps(record, sort_keys=True).encode()
        digest.update(str(path.relative_to(folder)).encode() + data)
    return digest.hexdigest()


def monte_carlo(runs: int, base: Path, cluster: distributed.LocalCluster) -> dict:
    scenario = load_scenario(SCENARIO)
    task = AccuracyTask(scenario, scenario.seed, ("s3ekf",), natural_config(scenario))
    began = time.perf_counter()
    run_many(task, runs, base / "here")
    here = time.perf_counter() - began
    killer = Killer(cluster)
    began = time.perf_counter()
    run_many(task, runs, base / "there", scheduler=cluster.scheduler_address, progress=killer)
    there = time.perf_counter() - began
    name = "montecarlo.parquet"
    equal = (base / "here" / name).read_bytes() == (base / "there" / name).read_bytes()
    return {"what": f"{runs} runs of {SCENARIO}", "here_s": here, "cluster_s": there, "equal": equal, **killer.report()}


def units() -> Manifest:
    if DATA.is_dir():
        return scan(DATA / "static")
    demo = Path(str(resources.files("starwise.demo"))) / "data"
    files = {"obs": (str(demo / "demo_MO.rnx.gz"),), "nav": (str(demo / "demo_MN.rnx.gz"),)}
    made = [Unit(f"mask-{k}", **files, config=RunConfig(mask_deg=5.0 + k)) for k in range(10)]
    return Manifest(lambda: made, len(made))


def batch(base: Path, cluster: distributed.LocalCluster) -> dict:
    manifest = units()
    began = time.perf_counter()
    run_batch(manifest, base / "batch-here")
    here = time.perf_counter() - began
    killer = Killer(cluster)
    began = time.perf_counter()
    table = run_batch(manifest, base / "batch-there", scheduler=cluster.scheduler_address, progress=killer)
    there = time.perf_counter() - began
    equal = contents(base / "batch-here") == contents(base / "batch-there")
    solved = int((table["status"] == "ok").sum())
    return {"what": f"batch of {solved} units", "here_s": here, "cluster_s": there, "equal": equal, **killer.report()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    with (
        tempfile.TemporaryDirectory(prefix="starwise-bench-") as folder,
        distributed.LocalCluster(
            n_workers=3, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", memory_limit=0,
            silence_logs=50,
        ) as cluster,
    ):  # fmt: skip
        rows = [monte_carlo(args.runs, Path(folder), cluster), batch(Path(folder), cluster)]
    if args.json:
        print(json.dumps(rows, indent=1))
        return
    for row in rows:
        equal = "equal to the last bit" if row["equal"] else "DIFFERENT"
        print(f"{row['what']}: by processes {row['here_s']:.1f} s,", end=" ")
        print(f"by {row['workers_before']} workers of Dask {row['cluster_s']:.1f} s;")
        print(f"  worker {row['killed']} killed in the middle, {row['workers_at_the_end']} at the end; result {equal}")
    if not all(row["equal"] for row in rows):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
