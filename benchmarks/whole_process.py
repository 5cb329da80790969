"""Whole process, from the shell: `starwise solve` beside Debian's rnx2rtkp on the same plain files.

    python benchmarks/whole_process.py [--json] [--runs 5]

Both single point positioning of a whole day with a .conf; the compile cache of starwise is warm (one run before).
The runs alternate; medians, ratio of medians and peak memory (largest resident size of the process) are printed.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

from datasets import DATA, STATIC, DataSet, plain, scratch


def run(command: list[str]) -> tuple[float, float]:
    """Wall seconds and peak resident MB of a command; its failure is an error."""
    start = time.perf_counter()
    # Not to a pipe: rnx2rtkp writes its progress to stderr, and a full pipe that nobody reads would stop it.
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - start
    if os.waitstatus_to_exitcode(status) != 0:
        raise SystemExit(f"failed: {' '.join(command)}")
    return seconds, usage.ru_maxrss / 1024.0


def measure(data: DataSet, runs: int, folder: Path) -> dict[str, object]:
    obs, navs = plain(data.obs, folder), [plain(n, folder) for n in data.nav]
    out = folder / "out"
    starwise = [sys.executable, "-m", "starwise", "solve", str(obs), *map(str, navs), "-o", str(out)]
    commands = {
        "rtklib": ["rnx2rtkp", "-k", str(DATA / "rtklib_conf" / data.conf), "-o", str(folder / "r.pos"),
                   str(obs), *map(str, navs)],
        "lsq": [*starwise, "--error-model", "white", "--method", "lsq", "--systems", data.systems],
        "s3ekf": [*starwise, "--error-model", "white", "--systems", data.systems],
    }  # fmt: skip
    for command in commands.values():
        run(command)
    results: dict[str, list[tuple[float, float]]] = {k: [] for k in commands}
    for _ in range(runs):
        for name, command in commands.items():
            results[name].append(run(command))
    seconds = {k: statistics.median(s for s, _ in v) for k, v in results.items()}
    memory = {k: max(m for _, m in v) for k, v in results.items()}
    size = obs.stat().st_size / 1e6
    return {
        "set": data.name,
        "obs_mb": round(size, 1),
        **{f"{k}_s": round(v, 2) for k, v in seconds.items()},
        **{f"{k}_times_faster": round(seconds["rtklib"] / seconds[k], 2) for k in ("lsq", "s3ekf")},
        "peak_mb": round(memory["s3ekf"]),
        "peak_limit_mb": round(8 * size + 300),
    }


def simulated(folder: Path) -> DataSet:
    """An hour at 1 Hz of four constellations: the epochs and satellites of a modern receiver's day at 30 s."""
    scenario = folder / "hour.toml"
    scenario.write_text(
        'name = "hour"\ndescription = "an hour at rest"\nseed = 5\n[time]\nstart = "2024-03-30T08:00:00"\n'
        'duration_s = 3600.0\ninterval_s = 1.0\n[vehicle]\nkind = "car"\nstart = [48.8, 9.2, 300.0]\n'
        'heading_deg = 0.0\n[[vehicle.segments]]\nkind = "static"\n'
    )
    run([sys.executable, "-m", "starwise", "simulate", str(scenario), "-o", str(folder / "hour")])
    return DataSet("simulated 1 h 1 Hz", str(folder / "hour/hour_MO.rnx"), (str(folder / "hour/hour_MN.rnx"),), None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--runs", type=int, default=5)
    args = parser.parse_args()
    names = ("delf_2021 24 h", "zegv_2021 24 h", "unsa_2019 24 h", "kiru_2024 2 h")
    with scratch() as folder:
        sets = [simulated(Path(folder)), *(d for d in STATIC if d.name in names)]
        rows = [measure(d, args.runs, Path(folder)) for d in sets]
    if args.json:
        print(json.dumps(rows, indent=1))
        return
    print(
        f"{'':20s} {'MB':>6s} {'RTKLIB s':>9s} {'lsq s':>7s} {'x':>5s} {'s3ekf s':>8s} {'x':>5s} {'peak MB':>8s} limit"
    )
    for r in rows:
        print(
            f"{r['set']:20s} {r['obs_mb']:6.1f} {r['rtklib_s']:9.2f} {r['lsq_s']:7.2f} {r['lsq_times_faster']:5.2f}"
            f" {r['s3ekf_s']:8.2f} {r['s3ekf_times_faster']:5.2f} {r['peak_mb']:8d} {r['peak_limit_mb']}"
        )


if __name__ == "__main__":
    main()
