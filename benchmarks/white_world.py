"""What the coloured error model costs where errors are white after all.

    python benchmarks/white_world.py [--seeds 4] [--json]

Receivers at rest under a simulated sky whose orbits, clocks and atmosphere are as broadcast, with white code
noise and nothing else; the default filter beside ``--error-model white``, both with static and with vehicle dynamics.
3D RMS over all epochs and seeds, and how often the 95 % ellipsoids hold the truth.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import starwise
from datasets import scratch
from starwise.analysis.accuracy import match
from starwise.io.truth import read_truth
from starwise.studies.simulating import simulate_files

SCENARIO = """
name = "white"
description = "White errors"
seed = {seed}
[time]
start = "2024-03-30T08:00:00"
duration_s = {duration}
interval_s = {interval}
[vehicle]
kind = "car"
start = [48.7784, 9.18, 300.0]
heading_deg = 35.0
[[vehicle.segments]]
kind = "static"
[sky]
source = "tables"
constellations = ["gps", "galileo", "beidou3"]
[receiver]
signals = {{ G = ["1C", "2W"], E = ["1C", "5Q"], C = ["2I", "6I"] }}
mask_deg = 10.0
phase = false
[receiver.noise]
model = "{noise}"
code_m = {code}
rate_mps = 0.05
[receiver.ionosphere]
model = "broadcast"
scale = 1.0
[receiver.troposphere]
model = "saastamoinen"
"""
CASES = (
    (3600.0, 30.0, "fixed", 1.0),
    (3600.0, 30.0, "cn0", 0.5),
    (600.0, 1.0, "fixed", 1.0),
    (600.0, 1.0, "elevation", 0.5),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with scratch() as name:
        for duration, interval, noise, code in CASES:
            square: dict[tuple[str, str], list[float]] = {}
            inside: dict[tuple[str, str], list[float]] = {}
            for seed in range(args.seeds):
                folder = Path(name) / f"{interval:g}-{noise}-{seed}"
                scenario = Path(name) / "white.toml"
                scenario.write_text(
                    SCENARIO.format(seed=seed, duration=duration, interval=interval, noise=noise, code=code)
                )
                simulate_files(scenario, folder)
                obs, nav = next(folder.glob("*_MO.rnx")), next(folder.glob("*_MN.rnx"))
                truth = read_truth(str(next(folder.glob("*_truth.parquet"))))
                for dynamics in ("static", "vehicle"):
                    for model in ("white", "colored"):
                        solution = starwise.solve(
                            obs, nav, error_model=model, dynamics=dynamics, troposphere="saastamoinen"
                        )
                        matched = match(solution, truth)
                        key = (dynamics, model)
                        square.setdefault(key, []).append(float((matched.error_n**2).sum(1).mean()))
                        inside.setdefault(key, []).append(float((matched.nees < 7.815).mean()))
            for dynamics in ("static", "vehicle"):
                rms = {m: float(np.sqrt(np.mean(square[dynamics, m]))) for m in ("white", "colored")}
                rows.append(
                    {
                        "interval_s": interval,
                        "noise": f"{noise} {code:g} m",
                        "dynamics": dynamics,
                        "white_m": rms["white"],
                        "colored_m": rms["colored"],
                        "ratio": rms["colored"] / rms["white"],
                        **{f"coverage_95_{m}": float(np.mean(inside[dynamics, m])) for m in ("white", "colored")},
                    }
                )
    if args.json:
        print(json.dumps(rows, indent=1))
        return
    print(
        f"{'step':>5} {'noise':<15} {'dynamics':<9} {'white m':>8} {'colored m':>10} {'ratio':>6}   95 % white, colored"
    )
    for r in rows:
        print(
            f"{r['interval_s']:>4g}s {r['noise']:<15} {r['dynamics']:<9} {r['white_m']:>8.2f} {r['colored_m']:>10.2f} "
            f"{r['ratio']:>6.2f}   {100 * r['coverage_95_white']:.0f} {100 * r['coverage_95_colored']:.0f}"
        )


if __name__ == "__main__":
    main()
