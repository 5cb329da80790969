"""The laboratory on real measurements: runs of starwise and of RTKLIB, and a mistuned filter put right.

python benchmarks/lab_real.py [--only NAME] [--json]     every static set: default, white errors, RTKLIB's SPP
python benchmarks/lab_real.py --tuning [--only NAME]     R x 10, Q x 0.01, then as the laboratory suggests
python benchmarks/lab_real.py --pooled                   the same on every set, sessions of two hours counted together:
                                                         a receiver at rest has one error at a time, not 0.95 of one

R x 10 is ten times the variance of white noise (``errors.code_white_m``, ``errors.code_white_glonass_m`` and
``noise.rate_mps`` times the root of ten; with white errors ``noise.code_m``). Q x 0.01 is a hundredth of the driving
noise of every state: of the motion and the clock, and of the lasting errors, whose sizes are then a tenth.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from datasets import DATA, STATIC, DataSet, plain, scratch, truth_ecef
from starwise.analysis.lab import Consistency
from starwise.analysis.lab.tuning import IONOSPHERE, SLOW
from starwise.analysis.pool import Run, pool
from starwise.config import RunConfig
from starwise.config_errors import ErrorParameters
from starwise.estimators.sessions import solve_sessions
from starwise.io.pos import read_pos
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import read_obs
from starwise.models.process import CLOCKS, RESTING_PSD
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.types import Solution, Truth

R_FACTOR, Q_FACTOR = 10.0, 0.01
SESSION_S = 7200.0


def solver(data: DataSet) -> Callable[[RunConfig], Solution]:
    """What solves a set with a configuration; files are read once."""
    obs = read_obs(DATA / data.obs)
    records = read_nav(*(DATA / name for name in data.nav))
    ephemeris = BroadcastEphemeris(records)

    def run(config: RunConfig) -> Solution:
        solution = solve_sessions(obs, ephemeris, records.ionosphere, config, lambda _what, _part: None)
        return replace(solution, provenance={**solution.provenance, "config": config.to_dict()})

    return run


def rtklib(data: DataSet, folder: Path) -> Solution:
    """Single point positions of Debian's rnx2rtkp."""
    out, conf = folder / "rtklib.pos", folder / data.conf
    conf.write_text((DATA / "rtklib_conf" / data.conf).read_text())
    files = [str(plain(name, folder)) for name in (data.obs, *data.nav)]
    subprocess.run(["rnx2rtkp", "-k", str(conf), "-o", str(out), *files], check=True, capture_output=True)
    return read_pos(out)


def row(name: str, program: str, made: Consistency) -> dict[str, Any]:
    """Line of the table."""
    p = made.positions
    code = next((r for r in made.by_sensor if r["name"] == "code"), None)
    rate = next((r for r in made.by_sensor if r["name"] == "rate"), None)
    return {
        "set": name,
        "program": program,
        "nees": None if p is None else p.nees,
        "coverage_95": None if p is None or p.inside is None else float(p.inside[2]),
        "lag_1_position": None if p is None else p.rho_1,
        "lag_1_code": None if code is None else code["rho_1"],
        "nis_code": None if code is None else code["nis"],
        "nis_rate": None if rate is None else rate["nis"],
        "verdict": made.verdict,
    }


def mistuned(config: RunConfig) -> RunConfig:
    """R x 10, Q x 0.01."""
    small, noisy = math.sqrt(Q_FACTOR), math.sqrt(R_FACTOR)
    plain_errors = ErrorParameters()
    sizes = [*SLOW, *IONOSPHERE, "signal_bias_m", "signal_bias_glonass_m", "multipath_m", "troposphere_m", "slope_m"]
    options: dict[str, Any] = {f"errors.{key}": small * getattr(plain_errors, key) for key in sizes}
    for key in ("code_white_m", "code_white_glonass_m"):
        options[f"errors.{key}"] = noisy * getattr(plain_errors, key)
    options["noise.rate_mps"] = noisy * config.noise.rate_mps
    options["noise.code_m"] = noisy * config.noise.code_m
    options["process.position_psd_m2_per_s"] = Q_FACTOR * RESTING_PSD
    options["clock.bias_psd_m2_per_s"] = Q_FACTOR * CLOCKS.bias_psd
    options["clock.drift_psd_m2_per_s3"] = Q_FACTOR * CLOCKS.drift_psd
    return config.with_options(options)


def tune(data: DataSet) -> list[dict[str, Any]]:
    """A mistuned run and the run that the laboratory suggests, coloured and white."""
    run, truth = solver(data), Truth(truth_ecef(data.truth or ""))
    rows = []
    for model in ("colored", "white"):
        bad = mistuned(RunConfig(systems=data.systems, dynamics="static", error_model=model))
        before = Consistency.of(run(bad), truth)
        suggested = before.tuned(run)
        after = Consistency.of(run(bad.with_options(dict(suggested.settings))), truth)
        rows.append(row(data.name, f"{model}, R x 10, Q x 0.01", before))
        rows.append({**row(data.name, "as suggested", after), "evaluations": suggested.evaluations})
    return rows


def table(data: DataSet) -> list[dict[str, Any]]:
    """Default, white, and RTKLIB on a set."""
    run, truth = solver(data), Truth(truth_ecef(data.truth or ""))
    rows = []
    for model in ("colored", "white"):
        config = RunConfig(systems=data.systems, error_model=model)
        rows.append(row(data.name, f"starwise, {model}", Consistency.of(run(config), truth)))
    with scratch() as folder:
        rows.append(row(data.name, "RTKLIB SPP", Consistency.of(rtklib(data, Path(folder)), truth)))
    return rows


def pooled() -> dict[str, dict[str, Any]]:
    """Coverage over sessions of two hours of all sets: mistuned, as suggested, and by default."""
    found: dict[str, dict[str, Any]] = {}
    runs: dict[str, list[Run]] = {}
    for data in STATIC:
        run, truth = solver(data), Truth(truth_ecef(data.truth or ""))
        for model in ("colored", "white"):
            bad = mistuned(RunConfig(systems=data.systems, dynamics="static", error_model=model))
            settings = dict(Consistency.of(run(bad), truth).tuned(run).settings)
            configs = {f"{model}, R x 10, Q x 0.01": bad, f"{model}, as suggested": bad.with_options(settings)}
            if model == "colored":
                configs["default"] = RunConfig(systems=data.systems, dynamics="static")
            for name, config in configs.items():
                made = run(config.with_options({"session_s": SESSION_S}))
                runs.setdefault(name, []).append(Run(f"{data.name}", made, truth, True))
    for name, list_of_runs in runs.items():
        record = pool(list_of_runs, session_s=SESSION_S)
        found[name] = {
            key: record[key] for key in ("coverage_50", "coverage_68", "coverage_95", "nees_mean", "sessions")
        }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="sets whose name contains this")
    parser.add_argument("--tuning", action="store_true")
    parser.add_argument("--pooled", action="store_true")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.pooled:
        made = pooled()
        lines = [
            f"{name:<28}" + "".join(f"  {key} {value:.3f}" for key, value in row.items()) for name, row in made.items()
        ]
        print(json.dumps(made, indent=1) if args.json else "\n".join(lines))
        return
    rows: list[dict[str, Any]] = []
    if not args.json:
        columns = f"{'NEES':>7}{'cov 95':>8}{'lag 1':>7}{'code':>7}{'NIS code':>10}{'rate':>9}"
        print(f"{'set':<18}{'program':<28}{columns}   verdict")
    for data in STATIC:
        if args.only not in data.name or (args.tuning and not data.name.startswith(("kiru", "tlse"))):
            continue
        for item in tune(data) if args.tuning else table(data):
            rows.append(item)
            if not args.json:
                numbers = "".join(
                    f"{'-' if item[key] is None else format(item[key], form):>{width}}"
                    for key, form, width in (
                        ("nees", ".2f", 7), ("coverage_95", ".3f", 8), ("lag_1_position", ".2f", 7),
                        ("lag_1_code", ".2f", 7), ("nis_code", ".3g", 10), ("nis_rate", ".3g", 9),
                    )
                )  # fmt: skip
                print(f"{item['set']:<18}{item['program']:<28}{numbers}   {item['verdict'][:90]}", flush=True)
    if args.json:
        print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
