"""More of the federated filter on real measurements: many sessions, tied clocks, thresholds, threads.

python benchmarks/federated_checks.py pooled|tied|quiet|thresholds|threads [--dynamics static] [--only NAME] [--json]

pooled      Sessions of two hours of all sets with more than one constellation, both filters started anew in each: the
            error of a receiver at rest is one slowly moving number, so that a set is one draw and only many tell
            accuracy and honesty.
tied        The faults of whole constellations of `federated_real`, in the centralised filter, whose clocks are one
            oscillator with slowly varying biases (``clock.isolate``).
quiet       What the federated filter and the one with tied clocks name in all sets as they are, without faults.
thresholds  Events of the federated filter without faults, real sets and drives through the simulated canyon, and delays
            of ramps common to a constellation, with `CLOCK_FLOOR_M` and `LEAST_TOGETHER_M` halved and doubled.
threads     The local filters alone on 1, 2 and 4 threads, and how long a thread of Python beside them stands still.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
from typing import Any

import numpy as np

import starwise
from adaptation_urban import canyon
from datasets import DATA, STATIC, truth_ecef
from federated_real import (
    RAMP_MPS,
    SETS,
    Case,
    common,
    delay,
    estimate,
    fault,
    load,
    show_common,
    show_threads,
    threads,
)
from starwise.analysis.pool import Run, pool
from starwise.config import RunConfig
from starwise.estimators import federated_faults
from starwise.estimators.federated_local import make_locals
from starwise.estimators.federated_run import shares_of
from starwise.gnsstime import session_numbers
from starwise.models.pseudorange import prepare
from starwise.types import Truth

SESSION_S = 7200.0
TIED: dict[str, Any] = {"method": "s3ekf", "clock": {"isolate": True}}
CANYONS = (21, 22, 23, 24)
KNOBS = ("CLOCK_FLOOR_M", "LEAST_TOGETHER_M")
FACTORS = (0.5, 1.0, 2.0)


def pooled(dynamics: str) -> dict[str, Any]:
    """Both filters over sessions of all sets: RMS, coverage, NEES, and the ratio of RMS session by session."""
    runs: dict[str, list[Run]] = {"s3ekf": [], "federated": []}
    squares: dict[str, list[float]] = {name: [] for name in runs}
    for data in STATIC:
        if len(data.systems) < 2:
            continue
        point = truth_ecef(data.truth or "")
        files = [DATA / data.obs, *(DATA / nav for nav in data.nav)]
        for name in runs:
            done = starwise.solve(
                *files, systems="GREC", dynamics=dynamics, method=name, session_s=SESSION_S
            )  # fmt: skip
            runs[name].append(Run(data.name, done, Truth(point, source=data.name)))
            error2 = np.sum((done.pos_e - point) ** 2, axis=1)
            session = session_numbers(done.t_ns, SESSION_S)
            squares[name] += [float(np.nanmean(error2[session == i])) for i in np.unique(session)]
    ratios = np.sqrt(np.array(squares["federated"]) / np.array(squares["s3ekf"]))
    keys = ("sessions", "rms_3d_m", "coverage_50", "coverage_68", "coverage_95", "nees_mean", "sigma_3d_mean_m")
    totals = {name: pool(of) for name, of in runs.items()}
    return {
        **{name: {key: total[key] for key in keys} for name, total in totals.items()},
        "ratio": totals["federated"]["rms_3d_m"] / totals["s3ekf"]["rms_3d_m"],
        "ratio_by_session": {str(q): float(np.quantile(ratios, q / 100.0)) for q in (5, 50, 95)},
    }


def longest_wait(case: Case) -> tuple[float, float]:
    """Longest time, s, for which a thread that counts stands still: alone, and beside the local filters."""
    waits = []
    prepared = case.prepared()
    shares = shares_of(prepared, case.config)
    for busy in (False, True):
        gaps, stop = [0.0], threading.Event()

        def count(gaps: list[float] = gaps, stop: threading.Event = stop) -> None:
            last = time.perf_counter()
            while not stop.is_set():
                now = time.perf_counter()
                gaps[0] = max(gaps[0], now - last)
                last = now

        made = make_locals(prepared, case.config, shares)
        counter = threading.Thread(target=count)
        counter.start()
        if busy:
            made[0].run()
        else:
            time.sleep(0.2)
        stop.set()
        counter.join()
        waits.append(gaps[0])
    return waits[0], waits[1]


def thresholds(only: str) -> list[dict[str, Any]]:
    """False events and delays of common ramps, by threshold and factor; each one by itself."""
    rows = []
    before = {knob: getattr(federated_faults, knob) for knob in KNOBS}
    sets = [load(data.name) for data in STATIC if len(data.systems) > 1 and only in data.name]
    moving = RunConfig(method="federated", systems="GREC", dynamics="vehicle")
    drives = [(drive, prepare(drive.obs, drive.ephemeris, drive.ionosphere, moving)) for drive in map(canyon, CANYONS)]
    for knob in KNOBS:
        for factor in FACTORS:
            setattr(federated_faults, knob, factor * before[knob])
            try:
                still = sum(_named(estimate(case.prepared(), case.config)[1]) for case in sets)
                street = sum(_named(estimate(prepared, moving)[1]) for _, prepared in drives)
                rows.append(
                    {
                        "threshold": knob,
                        "m": factor * before[knob],
                        "false_at_rest": still,
                        "false_in_canyon": street,
                        "delays_s": [_common_ramp(load(name)) for name in SETS if only in name],
                    }
                )
            finally:
                setattr(federated_faults, knob, before[knob])
    return rows


def _named(events: list[federated_faults.Event]) -> int:
    """Constellations named: satellites have thresholds of their own."""
    return sum(event.satellite is None and event.cause != federated_faults.RETURNED for event in events)


def _common_ramp(case: Case) -> list[float | None]:
    """Delay until every constellation is named after a ramp on its codes, s."""
    prepared = case.prepared()
    found = []
    for k, constellation in enumerate(prepared.clock_names):
        satellites = [int(sv) for sv in np.unique(prepared.sightings.sv[prepared.rows.clock == k])]
        out = fault(case, satellites, rate_mps=RAMP_MPS)
        found.append(delay([e for e in out["events"] if e.satellite is None], constellation, out["t0_ns"]))
    return found


def show_tied(dynamics: str, only: str, as_json: bool) -> None:
    """Faults of whole constellations under tied clocks."""
    rows = [row for name in SETS if only in name for row in common(load(name, dynamics=dynamics, **TIED))]
    if as_json:
        print(json.dumps(rows, indent=1))
        return
    show_common(rows)


def show_quiet(dynamics: str, only: str, as_json: bool) -> None:
    """Events of sets without faults, by filter."""
    found: dict[str, Any] = {}
    for data in STATIC:
        for name, options in (("federated", {}), ("tied", TIED)):
            if only in data.name:
                case = load(data.name, dynamics=dynamics, **options)
                _, events = estimate(case.prepared(), case.config)
                found[f"{data.name}, {name}"] = [event.record() for event in events]
    if as_json:
        print(json.dumps(found, indent=1))
        return
    for name, events in found.items():
        print(f"{name:<28} {len(events)} named: {[e['satellite'] or e['constellation'] for e in events]}")


def show_pooled(found: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(json.dumps(found, indent=1))
        return
    for name in ("s3ekf", "federated"):
        r = found[name]
        curve = ", ".join(f"{100 * r[f'coverage_{k}']:.1f}" for k in (50, 68, 95))
        print(
            f"{name:<10}{r['sessions']:>4} sessions, RMS {r['rms_3d_m']:.2f} m, claimed {r['sigma_3d_mean_m']:.2f} m; "
            f"inside the 50, 68, 95 % ellipsoid {curve} %; NEES {r['nees_mean']:.2f}"
        )
    by = found["ratio_by_session"]
    print(f"ratio {found['ratio']:.3f}; by session, 5 %, median, 95 %: {by['5']:.2f}, {by['50']:.2f}, {by['95']:.2f}")


def show_thresholds(rows: list[dict[str, Any]], as_json: bool) -> None:
    if as_json:
        print(json.dumps(rows, indent=1))
        return
    print(
        "threshold, m; constellations named without a fault: at rest, in the canyon; delays of common ramps by set, s"
    )
    for r in rows:
        delays = "; ".join(" ".join("-" if d is None else f"{d:.0f}" for d in of) for of in r["delays_s"])
        print(f"{r['threshold']:<18}{r['m']:>5.2f}{r['false_at_rest']:>5}{r['false_in_canyon']:>5}   {delays}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("pooled", "tied", "quiet", "thresholds", "threads"))
    parser.add_argument("--dynamics", default="static")
    parser.add_argument("--only", default="")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.what == "pooled":
        show_pooled(pooled(args.dynamics), args.json)
    elif args.what == "tied":
        show_tied(args.dynamics, args.only, args.json)
    elif args.what == "quiet":
        show_quiet(args.dynamics, args.only, args.json)
    elif args.what == "thresholds":
        show_thresholds(thresholds(args.only), args.json)
    else:
        for case in (load(name) for name in SETS if args.only in name):
            show_threads(case.name, threads(case))
            alone, beside = longest_wait(case)
            print(f"  a thread beside: stands still for {1e3 * alone:.0f} ms alone, {1e3 * beside:.0f} ms at most")


if __name__ == "__main__":
    main()
