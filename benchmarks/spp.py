"""Time per epoch of single point positioning and of the 13-state S3EKF, beside pyrtklib's pntpos, in one process.

    python benchmarks/spp.py [--json] [--runs 5]

"All included": satellite positions and clocks, corrections, signal selection and, here, the ledger. Reading is not.
Both sides solve the same file with broadcast ephemerides, the broadcast ionosphere and Saastamoinen's troposphere.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path
from typing import Any

import pyrtklib as prl

from datasets import STATIC, DataSet, plain, scratch
from starwise.config import RunConfig
from starwise.estimators.run import solve_run
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import read_obs
from starwise.physics.broadcast import BroadcastEphemeris

SYSTEMS = {"G": prl.SYS_GPS, "R": prl.SYS_GLO, "E": prl.SYS_GAL, "C": prl.SYS_CMP, "J": prl.SYS_QZS}


class Pyrtklib:
    """The file read once; `run` positions every epoch as rnx2rtkp does."""

    def __init__(self, obs: Path, nav: Path, systems: str) -> None:
        self.obs, self.nav, sta = prl.obs_t(), prl.nav_t(), prl.sta_t()
        prl.readrnx(str(obs), 1, "", self.obs, self.nav, sta)
        prl.readrnx(str(nav), 1, "", self.obs, self.nav, sta)
        prl.uniqnav(self.nav)
        self.n_epochs = prl.sortobs(self.obs)
        self.options = prl.prcopt_default if isinstance(prl.prcopt_default, prl.prcopt_t) else prl.prcopt_default()
        self.options.navsys = sum(SYSTEMS[s] for s in systems)
        self.options.ionoopt = prl.IONOOPT_BRDC
        self.options.tropopt = prl.TROPOPT_SAAS
        # Rows of each epoch, found beforehand: not part of the timing.
        self.epochs = []
        i = 0
        while i < self.obs.n:
            j = i
            t = self.obs.data[i].time
            while j < self.obs.n and self.obs.data[j].time.time == t.time and self.obs.data[j].time.sec == t.sec:
                j += 1
            self.epochs.append((self.obs.data[i], j - i))  # the rows of an epoch are contiguous in C
            i = j

    def run(self) -> int:
        solved = 0
        sol, ssat = prl.sol_t(), prl.Arr1Dssat_t(255)  # room for every satellite that RTKLIB knows
        azel, msg = prl.Arr1Ddouble(2 * 255), prl.Arr1Dchar(128)
        for first, n in self.epochs:
            solved += prl.pntpos(first, n, self.nav, self.options, sol, azel, ssat.ptr, msg)
        return solved


def timed(function: Any) -> tuple[float, Any]:
    start = time.perf_counter()
    result = function()
    return time.perf_counter() - start, result


def measure(data: DataSet, runs: int, folder: Path) -> dict[str, object]:
    obs_file, nav_file = plain(data.obs, folder), plain(data.nav[0], folder)
    peer = Pyrtklib(obs_file, nav_file, data.systems)
    obs, records = read_obs(obs_file), read_nav(nav_file)
    ephemeris = BroadcastEphemeris(records)
    configs = {
        m: RunConfig(method=m, error_model="white", dynamics="vehicle", systems=data.systems, post=True)
        for m in ("lsq", "s3ekf")
    }
    times: dict[str, list[float]] = {"pyrtklib": [], "lsq": [], "s3ekf": []}
    for config in configs.values():
        solve_run(obs, ephemeris, records.ionosphere, config)  # compile or load
    solved = 0
    for _ in range(runs):
        seconds, solved = timed(peer.run)
        times["pyrtklib"].append(seconds)
        for name, config in configs.items():
            seconds, _ = timed(lambda c=config: solve_run(obs, ephemeris, records.ionosphere, c))
            times[name].append(seconds)
    us = {k: statistics.median(v) / obs.n_epochs * 1e6 for k, v in times.items()}
    return {
        "set": data.name,
        "epochs": obs.n_epochs,
        "pyrtklib_solved": solved,
        **{f"{k}_us": round(v, 1) for k, v in us.items()},
        "lsq_times_faster": round(us["pyrtklib"] / us["lsq"], 1),
        "s3ekf_times_faster": round(us["pyrtklib"] / us["s3ekf"], 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--runs", type=int, default=5)
    args = parser.parse_args()
    with scratch() as folder:
        rows = [measure(d, args.runs, Path(folder)) for d in STATIC if d.name in ("kiru_2024 2 h", "delf_2021 24 h")]
    if args.json:
        print(json.dumps(rows, indent=1))
        return
    print(f"{'set':16s} {'epochs':>6s} {'pyrtklib us':>11s} {'lsq us':>8s} {'x':>5s} {'s3ekf us':>8s} {'x':>5s}")
    for r in rows:
        print(
            f"{r['set']:16s} {r['epochs']:6d} {r['pyrtklib_us']:11.1f} {r['lsq_us']:8.1f} {r['lsq_times_faster']:5.1f}"
            f" {r['s3ekf_us']:8.1f} {r['s3ekf_times_faster']:5.1f}"
        )


if __name__ == "__main__":
    main()
