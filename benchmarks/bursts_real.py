"""Bursts in the state of the satellite filter on real measurements: the largest survived, and the time to recover.

    python benchmarks/bursts_real.py [kiru|urban|tlse] [--runs 4] [--json]

A filter is started in the middle of a run with the state and the sigmas that it had there, and an error in one group of
states: position, velocity or receiver clock, in a random direction, from 30 m (m/s) to 3e11. Recovered: the position is
within six of the undisturbed filter's sigmas of the undisturbed one, for good. Nothing tells the filter of the burst.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator

import numpy as np

from datasets import DATA, STATIC, URBAN, DataSet
from starwise.config import RunConfig
from starwise.estimators.dynamics import settle_dynamics
from starwise.estimators.filter import filter_rows
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import read_obs
from starwise.kernels.rangemodel import Epochs
from starwise.kernels.spp import EpochOut
from starwise.models.process import motion_from
from starwise.models.pseudorange import Prepared, prepare
from starwise.physics.broadcast import BroadcastEphemeris

SIZES = (30.0, 100.0, 300.0, 1e3, 3e3, 1e4, 1e5, 1e7, 3e11)
SETS = {"kiru": STATIC[4], "tlse": STATIC[2], "urban": URBAN}
FOLLOWED = 120
SIGMAS = 6.0


class Run:
    """A prepared data set and its undisturbed filter."""

    def __init__(self, data: DataSet, **options: object) -> None:
        obs = read_obs(DATA / data.obs)
        records = read_nav(*(DATA / n for n in data.nav))
        ephemeris = BroadcastEphemeris(records)
        config = RunConfig().with_options(options)
        self.config, _ = settle_dynamics(obs, ephemeris, records.ionosphere, config)
        self.prepared: Prepared = prepare(obs, ephemeris, records.ionosphere, self.config)
        self.calm = self.filtered(0, len(self.prepared.epochs.t_ns), None)

    def filtered(self, first: int, last: int, start: tuple[np.ndarray, np.ndarray] | None) -> EpochOut:
        p = self.prepared
        epochs = Epochs(p.epochs.t_ns[first:last], p.epochs.offsets[first : last + 1])
        ep, _ = filter_rows(
            epochs, p.rows, p.options, len(p.clock_names), self.config, start, colored=(p.errors, p.error_rows)
        )
        return ep

    def belief(self, e: int) -> tuple[np.ndarray, np.ndarray]:
        """State of epoch e and its covariance by groups, as a start."""
        calm, motion = self.calm, motion_from(self.config)
        nk, nc = motion.nk, len(self.prepared.clock_names)
        x, P = np.zeros(nk + 2 * nc), np.zeros((nk + 2 * nc, nk + 2 * nc))
        x[:3], P[:3, :3] = calm.pos[e], calm.cov_pos[e]
        if nk > 3:
            x[3:6], P[3:6, 3:6] = calm.vel[e], calm.cov_vel[e]
        if nk > 6:
            P[6:9, 6:9] = motion.acceleration_sigma0**2 * np.eye(3)
        known = np.isfinite(calm.clock[e])
        x[nk : nk + nc] = np.where(known, calm.clock[e], np.nanmean(calm.clock[e]))
        x[nk + nc :] = np.where(np.isfinite(calm.drift[e]), calm.drift[e], np.nanmean(calm.drift[e]))
        for k in range(nc):
            P[nk + k, nk + k] = calm.clock_var[e, k] if known[k] else 1e6
            P[nk + nc + k, nk + nc + k] = 1.0
        return x, P

    def burst(self, kind: str, size: float, e: int, rng: np.random.Generator) -> float | None:
        """Time to recover, s; None: not within what is followed."""
        x, P = self.belief(e)
        nk, nc = motion_from(self.config).nk, len(self.prepared.clock_names)
        if kind == "clock":
            x[nk : nk + nc] += size * rng.choice([-1.0, 1.0])
        else:
            u = rng.standard_normal(3)
            at = 0 if kind == "position" else 3
            x[at : at + 3] += size * u / np.linalg.norm(u)
        last = min(e + 1 + FOLLOWED, len(self.prepared.epochs.t_ns))
        hit = self.filtered(e + 1, last, (x, P))
        off = hit.pos - self.calm.pos[e + 1 : last]
        sigma = np.sqrt(np.trace(self.calm.cov_pos[e + 1 : last], axis1=1, axis2=2))
        with np.errstate(invalid="ignore"):
            good = np.linalg.norm(off, axis=1) < SIGMAS * sigma
        bad = np.flatnonzero(~good)
        if len(bad) and bad[-1] >= len(good) - 2:
            return None
        back = 0 if not len(bad) else int(bad[-1]) + 1
        return float(self.prepared.epochs.t_ns[e + 1 + back] - self.prepared.epochs.t_ns[e]) * 1e-9


def experiment(run: Run, runs: int, seed: int = 1) -> Iterator[dict[str, object]]:
    """A row per kind and size."""
    n = len(run.prepared.epochs.t_ns)
    good = np.flatnonzero(np.isfinite(run.calm.pos[:, 0]) & (run.calm.status == 0))
    good = good[(good > n // 10) & (good < n - 30)]
    kinds = ("position", "velocity", "clock") if motion_from(run.config).nk > 3 else ("position", "clock")
    for kind in kinds:
        for size in SIZES:
            rng = np.random.default_rng([seed, int(size) % 2**31])
            times = [run.burst(kind, size, int(rng.choice(good)), rng) for _ in range(runs)]
            back = [t for t in times if t is not None]
            yield {
                "kind": kind, "size": size, "runs": runs, "recovered": len(back),
                "median_s": float(np.median(back)) if back else None, "max_s": max(back) if back else None,
            }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", nargs="?", choices=sorted(SETS), default="kiru")
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--dynamics", default="auto")
    parser.add_argument("--error-model", default="colored")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    run = Run(SETS[args.set], dynamics=args.dynamics, error_model=args.error_model)
    rows = list(experiment(run, args.runs))
    if args.json:
        print(json.dumps(rows, indent=1))
        return
    print(f"{args.set}, {run.config.dynamics}, {args.error_model}: {len(run.prepared.epochs.t_ns)} epochs")
    for row in rows:
        times = "" if row["median_s"] is None else f"median {row['median_s']:.0f} s, max {row['max_s']:.0f} s"
        print(f"{row['kind']:<10}{row['size']:>10.0e}  {row['recovered']}/{row['runs']}   {times}")


if __name__ == "__main__":
    main()
