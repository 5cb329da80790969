"""A day at 30 s of four constellations on two frequencies: the default filter beside Debian RTKLIB's PPP.

    python benchmarks/day.py [--runs 3] [--json]

The day is simulated. Both programs read the same plain RINEX files and broadcast ephemerides; the compile cache of
starwise is warm (one run before). Runs alternate; medians of wall time, peak memory, and their ratio are printed, and
beside that the filter alone, in process, per epoch.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from pathlib import Path

import starwise
from _bench import process as run
from datasets import DATA, scratch
from starwise.studies.simulating import simulate_files

SCENARIO = """
name = "day"
description = "A day at rest"
seed = 11
[time]
start = "2024-03-30T00:00:00"
duration_s = 86370.0
interval_s = 30.0
[vehicle]
kind = "car"
start = [48.8, 9.2, 300.0]
heading_deg = 0.0
[[vehicle.segments]]
kind = "static"
[sky]
source = "tables"
constellations = ["gps", "glonass", "galileo", "beidou2", "beidou3"]
[receiver]
signals = { G = ["1C", "2W"], R = ["1C", "2C"], E = ["1C", "5Q"], C = ["2I", "6I"] }
mask_deg = 10.0
phase = true
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    with scratch() as name:
        folder = Path(name)
        (folder / "day.toml").write_text(SCENARIO)
        simulate_files(folder / "day.toml", folder / "sim")
        obs = next((folder / "sim").glob("*_MO.rnx"))
        nav = next((folder / "sim").glob("*_MN.rnx"))
        conf = (DATA / "rtklib_conf/ppp_static.conf").read_text()
        conf = conf.replace("=precise", "=brdc").replace("pos1-navsys        =13", "pos1-navsys        =45")
        (folder / "ppp.conf").write_text(conf)
        commands = {
            "rtklib": ["rnx2rtkp", "-k", str(folder / "ppp.conf"), "-o", str(folder / "r.pos"), str(obs), str(nav)],
            "starwise": [sys.executable, "-m", "starwise", "solve", str(obs), str(nav), "-o", str(folder / "out"),
                         "--dynamics", "static"],
        }  # fmt: skip
        run(commands["starwise"])
        times: dict[str, list[tuple[float, float]]] = {key: [] for key in commands}
        for _ in range(args.runs):
            for key, command in commands.items():
                times[key].append(run(command))
        seconds = {key: statistics.median(s for s, _ in values) for key, values in times.items()}
        solution = starwise.solve(obs, nav, dynamics="static")
        per_epoch = _filter_ms(obs, nav)
        result = {
            "epochs": len(solution.t_ns),
            "satellites_mean": round(float(solution.n_used.mean()), 1),
            "rtklib_ppp_s": round(seconds["rtklib"], 2),
            "starwise_s": round(seconds["starwise"], 2),
            "times_faster": round(seconds["rtklib"] / seconds["starwise"], 2),
            "filter_ms_per_epoch": round(per_epoch, 3),
            "peak_mb": round(max(m for _, m in times["starwise"])),
        }
    print(json.dumps(result, indent=1) if args.json else "\n".join(f"{k:<22}{v}" for k, v in result.items()))


def _filter_ms(obs: Path, nav: Path) -> float:
    """Milliseconds per epoch of the filter alone."""
    from starwise.config import RunConfig
    from starwise.estimators.filter import run_filter
    from starwise.io.rinex_nav import read_nav
    from starwise.io.rinex_obs import read_obs
    from starwise.models.pseudorange import prepare
    from starwise.physics.broadcast import BroadcastEphemeris

    config = RunConfig(dynamics="static")
    records = read_nav(nav)
    prepared = prepare(read_obs(obs), BroadcastEphemeris(records), records.ionosphere, config)
    best = 1e9
    for _ in range(3):
        start = time.perf_counter()
        run_filter(prepared, config)
        best = min(best, time.perf_counter() - start)
    return 1e3 * best / len(prepared.epochs.t_ns)


if __name__ == "__main__":
    main()
