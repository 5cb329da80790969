"""Monte Carlo: a run of scenario 3 of the S3EKF paper by starwise, by filterpy and by a loop in numpy; cost by runs.

    python benchmarks/monte_carlo_peers.py [--quick] [--json FILE]

All draw the same noise, start alike and filter the same 200 epochs; the largest distance between their trajectories
is printed. Runs on all cores, start-up of the workers included, are in the second table.
"""

from __future__ import annotations

import itertools

import numpy as np

from _bench import Table, alternate, peer, ratio, show, slope
from montecarlo import SCENARIO, Epoch, filterpy_run, own
from starwise.constants import C_LIGHT
from starwise.models.process import clocks_from, matrices
from starwise.sim.scenario import load_scenario
from starwise.studies.s3ekf_filter import paper_config, paper_motion, solve_paper
from starwise.studies.scene import Scene, Sky


def numpy_run(sky: Sky, start: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """An extended Kalman filter as one writes it in numpy."""
    Phi, Q = matrices(paper_motion(), clocks_from(paper_config("ekf")), 2, 1.0)
    pos = np.empty((len(sky.epochs.t_ns), 3))
    x, P = start
    for e, (a, b) in enumerate(itertools.pairwise(sky.epochs.offsets)):
        if e > 0:
            x, P = Phi @ x, Phi @ P @ Phi.T + Q
        now = Epoch(sky, a, b)
        H = now.H(x)
        PHt = P @ H.T
        S = H @ PHt + np.diag(np.tile([36.0, 0.01], now.m))
        K = np.linalg.solve(S, PHt.T).T
        x = x + K @ (now.z - now.h(x))
        P = P - K @ PHt.T
        P = 0.5 * (P + P.T)
        pos[e] = x[:3]
    return pos


def peers(quick: bool) -> Table:
    scene, config = Scene(load_scenario(SCENARIO)), paper_config("ekf")
    sky = scene.run(0, config)
    P0 = np.diag([100.0] * 3 + [10.0] * 3 + [1.0] * 3 + [100.0] * 2 + [1.0] * 2)
    x0 = np.concatenate([sky.pos_e[0], sky.vel_e[0], np.zeros(3), np.full(2, 1e-5 * C_LIGHT), np.full(2, 3.0)])
    calls = {
        "starwise": lambda: solve_paper(scene.run(0, config), "s3ekf", (x0.copy(), P0.copy())).pos,
        "numpy": lambda: numpy_run(scene.run(0, config), (x0.copy(), P0.copy())),
    }
    table = Table("monte-carlo", "A Monte Carlo run of 200 epochs on one core, noise drawn and filtered")
    if peer("filterpy") is None:
        table.notes.append("not installed: filterpy")
    else:
        calls["filterpy"] = lambda: filterpy_run(scene.run(0, config), (x0.copy(), P0.copy()))
    took = alternate(calls, 3 if quick else 9)
    reference = calls["starwise"]()
    for name, call in calls.items():
        apart = float(np.linalg.norm(call() - reference, axis=1).max())
        table.rows.append({
            "": name, "ms": took[name].scaled(1e3), "x": ratio(took[name], took["starwise"]),
            "largest distance mm": apart * 1e3,
        })  # fmt: skip
    return table


def growth(quick: bool) -> Table:
    table = Table("monte-carlo-runs", "Monte Carlo by runs, all cores, s")
    own(2, 1)  # compiled code is loaded
    sizes = (1, 10, 100, 1000) if quick else (1, 10, 100, 1000, 10_000)
    for runs in sizes:
        seconds = own(runs)
        table.rows.append({"runs": runs, "s": seconds, "ms a run": seconds / runs * 1e3})
    last = table.rows[-2:]
    exponent = slope([float(r["runs"]) for r in last], [float(r["s"]) for r in last])
    table.notes.append(f"time ~ runs^{exponent:.2f} at the end")
    return table


def tables(quick: bool) -> list[Table]:
    return [peers(quick), growth(quick)]


if __name__ == "__main__":
    show(tables, __doc__)
