"""Adaptation rules in a street: on the white satellite filter, beside the coloured default.

python benchmarks/adaptation_urban.py [--runs 4] [--json]

The white filter (code and Doppler, Singer vehicle, a clock and drift per system, gate) with every rule of
`starwise.estimators.adaptive`, on the UrbanNav drive and on simulated drives through the canyon of the scenario
``urban-drive`` (seeds 1, 2, ...). A rule sees the rows of an epoch before any is used. All filters start from least
squares, and start anew when more than half of the codes are refused three times running.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace

import numpy as np

from datasets import DATA, URBAN
from starwise.analysis.accuracy import assess
from starwise.config import RunConfig
from starwise.constants import NS, ROW_USED
from starwise.estimators.adaptive import RULES, Adaptation, step
from starwise.estimators.least_squares import chi_square_table, empty_epochs, least_squares
from starwise.estimators.run import solve_run
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import read_obs
from starwise.io.truth import read_truth
from starwise.kernels.filter_epoch import linearise
from starwise.kernels.rangemodel import epoch_corrections
from starwise.models.process import clocks_from, matrices, motion_from
from starwise.models.pseudorange import Prepared, empty_row_model, prepare
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.sim.run import simulate
from starwise.sim.scenario import load_scenario
from starwise.types import F8, Ephemeris, IonosphereModel, Layout, Linear, Observations, Solution, State, Truth

TRUTH = DATA / "kinematic/urbannav_tst_20190428/groundTruth_TST.csv"
PATIENCE = 3
JUMP_M = 1e4  # receivers set their clocks by a millisecond, 300 km


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


class Filter:
    """The white filter of the package in its plainest form, with room for a rule."""

    def __init__(self, prepared: Prepared, config: RunConfig) -> None:
        self.p, self.out = prepared, empty_row_model(len(prepared.rows.code_m))
        self.motion, self.clocks = motion_from(config), clocks_from(config)
        self.nc, self.nk = len(prepared.clock_names), self.motion.nk
        names = [f"{kind}.{s}" for kind in ("clk", "drift") for s in prepared.clock_names]
        self.layout = Layout((*self.motion.names, *names))
        self.gate = chi_square_table(config.gate_probability, 3)
        self.lsq = least_squares(prepared, config)[0]

    def start(self, e: int) -> State | None:
        """Belief from least squares of an epoch."""
        pos, nk, nc = self.lsq.pos[e], self.nk, self.nc
        if not (np.isfinite(pos).all() and self.lsq.status[e] == 0):
            return None
        x, P = np.zeros(len(self.layout)), np.zeros((len(self.layout),) * 2)
        x[:3], P[:3, :3] = pos, self.lsq.cov_pos[e]
        P[3:6, 3:6] = self.motion.velocity_sigma0**2 * np.eye(3)
        P[6:9, 6:9] = self.motion.acceleration_sigma0**2 * np.eye(3)
        clock = self.lsq.clock[e]
        middle = float(np.nanmean(clock))
        x[nk : nk + nc] = np.where(np.isfinite(clock), clock, middle)
        P[nk : nk + nc, nk : nk + nc] = np.diag(np.where(np.isfinite(clock), 30.0**2, 300.0**2))
        c = self.clocks
        P[nk + nc :, nk + nc :] = c.drift_sigma0**2 + c.intersystem_drift_sigma0**2 * np.eye(nc)
        return State(int(self.p.epochs.t_ns[e]), self.layout, x, P)

    def rows(self, e: int, belief: State) -> Linear:
        """Codes, then rates, of an epoch at a belief."""
        p, out, x = self.p, self.out, belief.x
        start, end = int(p.epochs.offsets[e]), int(p.epochs.offsets[e + 1])
        known = bool(x[0] == x[0])
        epoch_corrections(p.options, p.epochs.t_ns[e], p.rows, start, end, x[0], x[1], x[2], known, out)
        at = [i for i in range(start, end) if out.status[i] == ROW_USED]
        v, r = np.full(2 * len(at), np.nan), np.zeros(2 * len(at))
        H = np.zeros((2 * len(at), len(x)))
        for k, i in enumerate(at):
            c = self.nk + int(p.rows.clock[i])
            v1, v2, ux, uy, uz, gx, gy, gz = linearise(p.rows, out, i, x, True, c, c + self.nc)
            j = len(at) + k
            v[k], v[j], r[k], r[j] = v1, v2, out.code_var[i], out.rate_var[i]
            H[k, :3], H[k, c] = (-ux, -uy, -uz), 1.0
            H[j, :3], H[j, 3:6], H[j, c + self.nc] = (gx, gy, gz), (-ux, -uy, -uz), 1.0
        ok = np.isfinite(v) & np.isfinite(r)
        return Linear(v[ok], H[ok], r[ok], np.concatenate([at, at]).astype(np.int64)[ok])

    def run(self, rule: Adaptation) -> Solution:
        t_ns, nk, nc = self.p.epochs.t_ns, self.nk, self.nc
        ep = empty_epochs(len(t_ns), nc)
        state: State | None = None
        memory, failed = rule.fresh(), 0
        for e in range(len(t_ns)):
            fresh = self.start(e) if state is None or failed >= PATIENCE else None
            if fresh is not None:
                state, failed, memory = fresh, 0, rule.fresh()
            elif state is not None:
                state, failed, memory = self._epoch(e, state, rule, memory, failed)
            if state is None:
                continue
            ep.status[e] = 0
            ep.pos[e], ep.vel[e] = state.x[:3], state.x[3:6]
            ep.cov_pos[e], ep.cov_vel[e] = state.P[:3, :3], state.P[3:6, 3:6]
            ep.clock[e], ep.drift[e] = state.x[nk : nk + nc], state.x[nk + nc :]
        return Solution(
            t_ns=t_ns, status=ep.status, pos_e=ep.pos, vel_e=ep.vel, cov_pos=ep.cov_pos, cov_vel=ep.cov_vel,
            clock_m=ep.clock, drift_mps=ep.drift, clock_sigma_m=np.sqrt(ep.clock_var),
            clock_names=self.p.clock_names, n_used=ep.n_used, dop=ep.dop, nis=ep.nis, dof=ep.dof,
        )  # fmt: skip

    def _epoch(self, e: int, state: State, rule: Adaptation, memory: F8, failed: int) -> tuple[State, int, F8]:
        t = int(self.p.epochs.t_ns[e])
        dt = (t - state.t_ns) / NS
        up = state.x[:3] / np.linalg.norm(state.x[:3])
        Phi, Q = matrices(self.motion, self.clocks, self.nc, dt, up)
        ahead = State(t, self.layout, Phi @ state.x, state.P)
        now = self.rows(e, ahead)
        codes = now.H[:, self.nk : self.nk + self.nc].any(axis=1)
        if not len(now.v):
            P = Phi @ state.P @ Phi.T + Q
            return State(t, self.layout, ahead.x, 0.5 * (P + P.T)), failed, memory
        jump = float(np.median(now.v[codes])) if codes.any() else 0.0
        if abs(jump) > JUMP_M:  # taken before the prediction, which leaves clocks shifted by as much
            x = state.x.copy()
            x[self.nk : self.nk + self.nc] += jump
            P = state.P.copy()
            P[self.nk : self.nk + self.nc, self.nk : self.nk + self.nc] += 30.0**2
            state = replace(state, x=x, P=P)
        state, innovation, _, memory = step(
            state, Phi, Q, t, lambda belief: self.rows(e, belief), rule, memory, None, self.gate
        )
        used = innovation.used[: int(codes.sum())]
        return state, (failed + 1 if 2 * used.sum() <= len(used) else 0), memory


def figures(drive: Drive, solution: Solution) -> dict[str, float]:
    report = assess(solution, drive.truth)
    keys = ("epochs_compared", "rms_2d_m", "rms_3d_m", "p95_3d_m", "coverage_95", "nees_mean")
    return {key: float(report[key]) for key in keys}


def measure(drive: Drive) -> dict[str, dict[str, float]]:
    """Figures by rule, and of the package's own filters."""
    white = RunConfig(dynamics="vehicle", error_model="white")
    colored = RunConfig(dynamics="vehicle")
    found = {
        name: figures(drive, solve_run(drive.obs, drive.ephemeris, drive.ionosphere, config))
        for name, config in (
            ("coloured (default)", colored),
            ("coloured, federated", colored.with_options({"method": "federated"})),
            ("white (package)", white),
        )
    }
    prepared = prepare(drive.obs, drive.ephemeris, drive.ionosphere, white)
    own = Filter(prepared, white)
    for name, rule in RULES.items():
        found[name] = figures(drive, own.run(rule))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    real = measure(urban())
    simulated = [measure(canyon(seed)) for seed in range(1, args.runs + 1)]
    mean = {
        name: {key: float(np.mean([run[name][key] for run in simulated])) for key in figures_of}
        for name, figures_of in real.items()
    }
    if args.json:
        print(json.dumps({"urbannav": real, "canyon": simulated}, indent=1))
        return
    keys = ("rms_2d_m", "rms_3d_m", "p95_3d_m", "coverage_95", "nees_mean")
    print(f"{'':<22}{'UrbanNav: ' + ' '.join(keys):<60}canyon, mean of {args.runs}")
    for name in real:
        cells = ["".join(f"{table[name][key]:>10.2f}" for key in keys) for table in (real, mean)]
        print(f"{name:<22}{cells[0]}   {cells[1]}")


if __name__ == "__main__":
    main()
