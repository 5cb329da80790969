"""The coloured filter in simulated worlds: exactly its model (NEES against its interval), and white (loss of RMS).

python benchmarks/honesty_simulated.py [--json] [--runs 150] [--white-runs 30]

In a world that is the model, the mean NEES over independent runs lies inside its chi-square interval at each of nine
epochs (false alarm 1 % each), with robust weights, adaptation and gate off, and as they are by default. In a white
world of 1 m the coloured filter is set against a white filter that knows the variance: the price of being prepared for
errors that last, paid where there are none.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from starwise.config import RunConfig
from starwise.models.error_model import error_model
from starwise.models.process import RESTING_PSD
from starwise.studies.colored_world import ColoredWorlds, nees

SETTINGS = [
    ("static", "auto", 30.0, 3600.0),
    ("static", "single", 30.0, 3600.0),
    ("static", "auto", 1.0, 300.0),
    ("vehicle", "auto", 1.0, 120.0),
]
FALSE_ALARM = 0.01


def exact(dynamics: str, combination: str, interval_s: float, duration_s: float, runs: int) -> list[dict[str, object]]:
    """NEES of the filter without and with its robust parts."""
    config = RunConfig(dynamics=dynamics, combination=combination)
    default = replace(config.errors, floor_m=0.0)
    config = replace(config, errors=default)
    plain = replace(default, late_sigma=1e9, early_sigma=1e9, scale_max=1.0)
    filters = {"plain": replace(config, errors=plain, gate_probability=1e-300), "default": config}
    source = ColoredWorlds(config, interval_s=interval_s, duration_s=duration_s)
    found: dict[str, list[np.ndarray]] = {name: [] for name in filters}
    error: dict[str, list[np.ndarray]] = {name: [] for name in filters}
    for number in range(runs):
        world = source.run(number)
        for name, filter_config in filters.items():
            errors = error_model(filter_config.errors, combination != "single", world.errors.n_bias, interval_s)
            ep = replace(world, errors=errors).solve(filter_config)
            found[name].append(nees(ep, world.pos_e))
            error[name].append(((ep.pos - world.pos_e) ** 2).sum(axis=1))
    low, high = chi2.ppf([FALSE_ALARM / 2.0, 1.0 - FALSE_ALARM / 2.0], 3 * runs) / (3 * runs)
    out = []
    for name, values in found.items():
        q = np.array(values)
        at = np.linspace(0, q.shape[1] - 1, 9).astype(int)
        mean = q[:, at].mean(axis=0) / 3.0
        out.append(
            {
                "world": "model",
                "dynamics": dynamics,
                "combination": combination,
                "interval_s": interval_s,
                "filter": name,
                "runs": runs,
                "low": low,
                "high": high,
                "nees_per_dof": mean.tolist(),
                "outside": int(((mean < low) | (mean > high)).sum()),
                "nees_mean": float(q.mean() / 3.0),
                "coverage_95": float((q < chi2.ppf(0.95, 3)).mean()),
                "rms_3d_m": float(np.sqrt(np.mean(error[name]))),
            }
        )
    return out


def white(dynamics: str, combination: str, interval_s: float, duration_s: float, runs: int) -> dict[str, object]:
    """RMS of the coloured filter over that of the white one, which is told the variance, on the first signal."""
    config = RunConfig(dynamics=dynamics, combination=combination)
    process = {"position_psd_m2_per_s": RESTING_PSD} if dynamics == "static" else {}
    right = RunConfig.from_dict(
        {"dynamics": dynamics, "combination": "single", "error_model": "white", "process": process}
    )
    source = ColoredWorlds(config, interval_s=interval_s, duration_s=duration_s)
    squares: dict[str, list[np.ndarray]] = {"colored": [], "white": []}
    for number in range(runs):
        world = source.run(number, "white")
        for name, chosen in (("colored", config), ("white", right)):
            squares[name].append(((world.solve(chosen).pos - world.pos_e) ** 2).sum(axis=1))
    rms = {name: float(np.sqrt(np.mean(values))) for name, values in squares.items()}
    return {
        "world": "white", "dynamics": dynamics, "combination": combination, "interval_s": interval_s, "runs": runs,
        "rms_colored_m": rms["colored"], "rms_white_m": rms["white"], "ratio": rms["colored"] / rms["white"],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--runs", type=int, default=150)
    parser.add_argument("--white-runs", type=int, default=30)
    args = parser.parse_args()
    results: list[dict[str, object]] = []
    for setting in SETTINGS:
        found = [*exact(*setting, args.runs), white(*setting, args.white_runs)]
        results += found
        if args.json:
            continue
        for r in found:
            head = f"{r['dynamics']:8s}{r['combination']:7s}{r['interval_s']:4.0f} s  "
            if r["world"] == "model":
                print(
                    f"{head}world = model, {r['filter']:8s}NEES/3 {r['nees_mean']:.2f}, at nine epochs "
                    + " ".join(f"{v:.2f}" for v in r["nees_per_dof"])  # type: ignore[attr-defined]
                    + f"; {r['outside']} outside {r['low']:.2f}..{r['high']:.2f}; coverage of 95 % "
                    f"{r['coverage_95']:.3f}; RMS {r['rms_3d_m']:.2f} m",
                    flush=True,
                )
            else:
                print(
                    f"{head}world white: {r['rms_colored_m']:.2f} m against {r['rms_white_m']:.2f} m, "
                    f"ratio {r['ratio']:.2f} (wanted: 1.15)",
                    flush=True,
                )
    if args.json:
        print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
