"""Adaptation rules and process models in a street, in the compiled satellite filters.

python benchmarks/adaptation_urban.py [--runs 4] [--first 1] [--json]

Every rule of `starwise.estimators.adaptive` in the coloured filter (rules of P and Q) and in the white one, the
"current" model beside Singer, and the federated filter, all with ``vehicle`` dynamics: on the UrbanNav drive and on
simulated drives through the canyon of the scenario ``urban-drive`` (seeds FIRST, FIRST + 1, ...). A rule wins if its 2D
and 3D RMS are below the default's on both.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from datasets import DATA, URBAN
from starwise.analysis.accuracy import assess
from starwise.config import WEIGHTING_RULES, RunConfig
from starwise.estimators.adaptive import RULES
from starwise.estimators.run import solve_run
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import read_obs
from starwise.io.truth import read_truth
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.sim.run import simulate
from starwise.sim.scenario import load_scenario
from starwise.types import Ephemeris, IonosphereModel, Observations, Truth

TRUTH = DATA / "kinematic/urbannav_tst_20190428/groundTruth_TST.csv"
DEFAULT = "coloured"
CURRENT: dict[str, Any] = {"process": {"model": "current"}}


@dataclass(frozen=True)
class Drive:
    name: str
    obs: Observations
    ephemeris: Ephemeris
    ionosphere: IonosphereModel
    truth: Truth


def urban() -> Drive:
    records = read_nav(*(DATA / n for n in URBAN.nav))
    obs = read_obs(DATA / URBAN.obs)
    return Drive("UrbanNav", obs, BroadcastEphemeris(records), records.ionosphere, read_truth(str(TRUTH)))


def canyon(seed: int) -> Drive:
    made = simulate(load_scenario("urban-drive"), seed)
    truth = Truth(made.truth.pos_e, made.truth.t_ns, source="simulated")
    return Drive(f"canyon {seed}", made.observations, BroadcastEphemeris(made.records), made.ionosphere, truth)


def filters() -> dict[str, RunConfig]:
    """Configurations by name: coloured, then white, each with what it can have."""
    found: dict[str, dict[str, Any]] = {DEFAULT: {}, f"{DEFAULT}, current": CURRENT}
    for rule in RULES:
        if rule not in ("none", *WEIGHTING_RULES):
            found[f"{DEFAULT}, {rule}"] = {"adaptation": rule}
    found[f"{DEFAULT}, federated"] = {"method": "federated"}
    white = {"error_model": "white"}
    found |= {"white": white, "white, current": white | CURRENT}
    found |= {f"white, {rule}": white | {"adaptation": rule} for rule in RULES if rule != "none"}
    return {name: RunConfig.from_dict({"dynamics": "vehicle", **options}) for name, options in found.items()}


def measure(drive: Drive) -> dict[str, dict[str, float]]:
    """Figures by name of the filter."""
    keys = ("epochs_compared", "rms_2d_m", "rms_3d_m", "p95_3d_m", "coverage_95", "nees_mean")
    found = {}
    for name, config in filters().items():
        report = assess(solve_run(drive.obs, drive.ephemeris, drive.ionosphere, config), drive.truth)
        found[name] = {key: float(report[key]) for key in keys}
    return found


def winners(real: dict[str, dict[str, float]], mean: dict[str, dict[str, float]]) -> list[str]:
    """Filters with smaller errors than the default on both drives, 2D and 3D."""
    return [
        name
        for name in real
        if all(table[name][key] < table[DEFAULT][key] for table in (real, mean) for key in ("rms_2d_m", "rms_3d_m"))
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--first", type=int, default=1, help="first seed of the canyon")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    real = measure(urban())
    simulated = [measure(canyon(seed)) for seed in range(args.first, args.first + args.runs)]
    mean = {
        name: {key: float(np.mean([run[name][key] for run in simulated])) for key in figures_of}
        for name, figures_of in real.items()
    }
    won = winners(real, mean)
    if args.json:
        print(json.dumps({"urbannav": real, "canyon": simulated, "wins_on_both": won}, indent=1))
        return
    keys = ("rms_2d_m", "rms_3d_m", "p95_3d_m", "coverage_95", "nees_mean")
    print(f"{'':<28}{'UrbanNav: ' + ' '.join(keys):<60}canyon, mean of {args.runs}")
    for name in real:
        cells = ["".join(f"{table[name][key]:>10.2f}" for key in keys) for table in (real, mean)]
        print(f"{name:<28}{cells[0]}   {cells[1]}")
    print(f"better than '{DEFAULT}' in 2D and 3D on both: {', '.join(won) or 'none'}")


if __name__ == "__main__":
    main()
