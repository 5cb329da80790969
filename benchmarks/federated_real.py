"""The federated filter on real measurements at known points: accuracy, honesty, faults put into them, speed.

python benchmarks/federated_real.py [--dynamics static] [--only NAME] [--all] [--doppler] [--json]

Per set: the federated filter beside the centralised EKF with the same error model; then a fault from the middle of the
set on: 50 m/min on the codes of one satellite (every satellite with --all, else three of each constellation), the same
on all satellites of a constellation, a jump of 1 us of one constellation's clock. "blind" is the centralised filter
without gate and robust weights. With --doppler the ramps are in the Doppler, too. Last: time per epoch, and threads.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from datasets import DATA, STATIC, truth_ecef
from starwise.config import RunConfig
from starwise.constants import C_LIGHT, NS, ROW_USED
from starwise.estimators import filter as filter_module
from starwise.estimators.federated_faults import Event
from starwise.estimators.federated_local import make_locals, run_locals
from starwise.estimators.federated_run import run_federated, shares_of
from starwise.estimators.filter import filter_options, run_filter
from starwise.estimators.tied_clocks import tied_events
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import read_obs
from starwise.kernels.spp import EpochOut
from starwise.models.pseudorange import Prepared, prepare
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.signals import frequency_table, sv_name
from starwise.types import Observations

SETS = ("kiru_2024 2 h", "tlse_2024 1 h", "tlse_2024 15 min", "nagoya rover", "nagoya base")
RAMP_MPS = 50.0 / 60.0
JUMP_M = 1e-6 * C_LIGHT
INSIDE_95 = 7.815


@dataclass(frozen=True)
class Case:
    name: str
    obs: Observations
    ephemeris: BroadcastEphemeris
    ionosphere: Any
    config: RunConfig
    truth: np.ndarray

    def prepared(self, obs: Observations | None = None) -> Prepared:
        return prepare(obs or self.obs, self.ephemeris, self.ionosphere, self.config)

    @property
    def middle(self) -> int:
        return self.obs.n_epochs // 2


def load(name: str, **options: Any) -> Case:
    data = next(d for d in STATIC if d.name == name)
    records = read_nav(*(DATA / nav for nav in data.nav))
    config = RunConfig.from_dict({"method": "federated", "systems": "GREC", "dynamics": "static", **options})
    obs = read_obs(DATA / data.obs)
    return Case(name, obs, BroadcastEphemeris(records), records.ionosphere, config, truth_ecef(data.truth or ""))


def faulty(case: Case, satellites: list[int], rate_mps: float = 0.0, step_m: float = 0.0,
           doppler: bool = False) -> Observations:  # fmt: skip
    """Observations with a ramp and a step on the codes of satellites from the middle on; on their Doppler if asked."""
    obs = case.obs
    t_ns = np.repeat(obs.t_ns, np.diff(obs.offsets))
    t0 = int(obs.t_ns[case.middle])
    at = np.isin(obs.sv, satellites) & (t_ns >= t0)
    code, shift = obs.code_m.copy(), obs.doppler_hz.copy()
    code[at] += step_m + rate_mps * (t_ns[at] - t0) / NS
    if doppler:
        frequency = frequency_table(case.ephemeris.channels)
        carrier = frequency[obs.sv >> 8, obs.sv & 255, obs.sig >> 8]
        shift[at] -= rate_mps * carrier[at] / C_LIGHT
    return replace(obs, code_m=code, doppler_hz=shift)


def blind(prepared: Prepared, config: RunConfig) -> np.ndarray:
    """Positions of the centralised filter without any detection."""

    def options(*arguments: Any) -> Any:
        return filter_options(*arguments)._replace(
            gate1=np.inf, gate2=np.inf, patience=1 << 30, weak_patience=1 << 30
        )  # fmt: skip

    filter_module.filter_options = options
    try:
        errors = prepared.errors._replace(late=np.inf, early=np.inf)
        return run_filter(replace(prepared, errors=errors), config)[0].pos
    finally:
        filter_module.filter_options = filter_options


def steady(case: Case, prepared: Prepared) -> dict[str, list[int]]:
    """Satellites of each constellation that are used from three epochs before the fault to twenty after it."""
    made = make_locals(prepared, case.config, shares_of(prepared, case.config))
    run_locals(made, prepared, case.config)
    first, last = case.middle - 3, min(case.middle + 20, case.obs.n_epochs - 1)
    found = {}
    for local in made:
        epoch = np.repeat(np.arange(case.obs.n_epochs), np.diff(local.epochs.offsets))
        use = (local.out.status == ROW_USED) & (epoch >= first) & (epoch <= last)
        satellites, count = np.unique(local.sv[use], return_counts=True)
        found[local.name] = [int(sv) for sv, n in zip(satellites, count, strict=True) if n > last - first]
    return found


def estimate(prepared: Prepared, config: RunConfig) -> tuple[EpochOut, list[Event]]:
    """The federated filter, or the centralised one with its clocks watched; what was named."""
    if config.method == "federated":
        ep, _, events = run_federated(prepared, config)
        return ep, events
    ep, out = run_filter(prepared, config)
    return ep, tied_events(prepared, config, ep, out)


def fault(case: Case, satellites: list[int], **how: Any) -> dict[str, Any]:
    """What the federated filter makes of a fault."""
    obs = faulty(case, satellites, **how)
    prepared = case.prepared(obs)
    ep, events = estimate(prepared, case.config)
    t0 = int(obs.t_ns[case.middle])
    after = np.linalg.norm(ep.pos - case.truth, axis=1)[case.middle :]
    return {"prepared": prepared, "events": events, "peak_m": float(np.nanmax(after)), "t0_ns": t0}


def delay(events: list[Event], constellation: str, t0_ns: int) -> float | None:
    """Seconds from a fault to the first event that names its constellation."""
    times = [e.t_ns for e in events if e.constellation == constellation and e.t_ns >= t0_ns]
    return (min(times) - t0_ns) / NS if times else None


def ramps(case: Case, every: bool, doppler: bool) -> list[dict[str, Any]]:
    rows = []
    for constellation, satellites in steady(case, case.prepared()).items():
        for sv in satellites if every else satellites[:: max(1, len(satellites) // 3)]:
            out = fault(case, [sv], rate_mps=RAMP_MPS, doppler=doppler)
            lost = blind(out["prepared"], case.config)
            peak = float(np.nanmax(np.linalg.norm(lost - case.truth, axis=1)[case.middle :]))
            wrong = [e.record() for e in out["events"] if e.satellite != sv_name(sv)]
            rows.append(
                {
                    "set": case.name,
                    "satellite": sv_name(sv),
                    "delay_s": delay(out["events"], constellation, out["t0_ns"]),
                    "itself": any(e.satellite == sv_name(sv) for e in out["events"]),
                    "peak_m": out["peak_m"],
                    "blind_m": peak,
                    "wrong": wrong,
                }
            )
    return rows


def common(case: Case) -> list[dict[str, Any]]:
    rows = []
    sightings = case.prepared()
    for k, constellation in enumerate(sightings.clock_names):
        satellites = [int(sv) for sv in np.unique(sightings.sightings.sv[sightings.rows.clock == k])]
        for kind, how in (
            ("ramp", {"rate_mps": RAMP_MPS}),
            ("ramp, Doppler too", {"rate_mps": RAMP_MPS, "doppler": True}),
            ("jump of 1 us", {"step_m": JUMP_M}),
        ):
            out = fault(case, satellites, **how)
            named = [e for e in out["events"] if e.constellation == constellation and e.cause.startswith("clock")]
            rows.append(
                {
                    "set": case.name,
                    "constellation": constellation,
                    "fault": kind,
                    "delay_s": delay(out["events"], constellation, out["t0_ns"]),
                    "clock_named_s": delay(named, constellation, out["t0_ns"]),
                    "cause": named[0].cause if named else None,
                    "peak_m": out["peak_m"],
                    "wrong": [e.record() for e in out["events"] if e.constellation != constellation],
                }
            )
    return rows


def accuracy(case: Case) -> dict[str, Any]:
    """RMS and coverage of both filters; time per epoch, best of three."""
    row: dict[str, Any] = {"set": case.name, "epochs": case.obs.n_epochs}
    prepared = case.prepared()
    for name in ("ekf", "s3ekf", "federated"):
        config = case.config.with_options({"method": name})
        best = np.inf
        for _ in range(3):
            began = time.perf_counter()
            ep = run_federated(prepared, config)[0] if name == "federated" else run_filter(prepared, config)[0]
            best = min(best, time.perf_counter() - began)
        e = ep.pos - case.truth
        nees = np.einsum("ni,ni->n", e, np.linalg.solve(ep.cov_pos, e[:, :, None])[:, :, 0])
        row[name] = {
            "rms_3d_m": float(np.sqrt(np.mean(np.sum(e**2, axis=1)))),
            "coverage_95": float(np.mean(nees < INSIDE_95)),
            "ms_per_epoch": 1e3 * best / case.obs.n_epochs,
        }
    row["events"] = len(run_federated(prepared, case.config)[2])
    return row


def threads(case: Case) -> dict[int, float]:
    """Seconds of the local filters alone by number of threads, best of five."""
    prepared = case.prepared()
    shares = shares_of(prepared, case.config)
    times = {}
    for n in (1, 2, 4):
        best = np.inf
        for _ in range(5):
            made = make_locals(prepared, case.config, shares)
            began = time.perf_counter()
            run_locals(made, prepared, case.config, n)
            best = min(best, time.perf_counter() - began)
        times[n] = best
    return times


def show_common(rows: list[dict[str, Any]]) -> None:
    print("\nwhole constellations: first named s, clock named s, peak m")
    for r in rows:
        print(
            f"{r['set']:<18}{r['constellation']} {r['fault']:<18} {r['delay_s']} {r['clock_named_s']} {r['cause']} "
            f"{r['peak_m']:.2f} wrong {len(r['wrong'])}"
        )


def show_threads(name: str, times: dict[int, float]) -> None:
    print(f"{name}: local filters on " + ", ".join(f"{n} threads {s:.3f} s" for n, s in times.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dynamics", default="static")
    parser.add_argument("--only", default="")
    parser.add_argument("--all", action="store_true", help="a ramp on every satellite")
    parser.add_argument("--doppler", action="store_true")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    cases = [load(name, dynamics=args.dynamics) for name in SETS if args.only in name]
    found = {
        "accuracy": [accuracy(case) for case in cases],
        "ramps": [row for case in cases for row in ramps(case, args.all, args.doppler)],
        "common": [row for case in cases for row in common(case)],
        "threads": {case.name: threads(case) for case in cases},
    }
    if args.json:
        print(json.dumps(found, indent=1))
        return
    print(f"{'set':<18}{'ekf m':>7}{'fed m':>7}{'ratio':>7}{'95 %':>7}{'ekf, s3ekf, fed ms/epoch':>28}{'events':>8}")
    for row in found["accuracy"]:
        ekf, s3, fed = row["ekf"], row["s3ekf"], row["federated"]
        print(
            f"{row['set']:<18}{ekf['rms_3d_m']:>7.2f}{fed['rms_3d_m']:>7.2f}{fed['rms_3d_m'] / ekf['rms_3d_m']:>7.2f}"
            f"{100 * fed['coverage_95']:>7.1f}{ekf['ms_per_epoch']:>12.2f}{s3['ms_per_epoch']:>8.2f}"
            f"{fed['ms_per_epoch']:>8.2f}{row['events']:>8}"
        )
    print("\n50 m/min on one satellite: delay s, median (worst), not named; peak m; worst ratio to the blind filter")
    for case in cases:
        for letter in "GREC":
            rows = [r for r in found["ramps"] if r["set"] == case.name and r["satellite"][0] == letter]
            if not rows:
                continue
            times = [r["delay_s"] for r in rows if r["delay_s"] is not None]
            off = [r["satellite"] for r in rows if r["delay_s"] is None]
            ratio = max(rows, key=lambda r: r["peak_m"] / r["blind_m"])
            print(
                f"{case.name:<18}{letter} {len(rows):>3} faults {np.median(times):>6.0f} ({max(times):.0f}) "
                f"{' '.join(off) or '-':<8} peak {max(r['peak_m'] for r in rows):.2f}, ratio "
                f"{ratio['peak_m'] / ratio['blind_m']:.2f} (of {ratio['blind_m']:.1f} m); "
                f"wrong {sum(len(r['wrong']) for r in rows)}"
            )
    show_common(found["common"])
    for name, times in found["threads"].items():
        show_threads(name, times)


if __name__ == "__main__":
    main()
