"""Measurement update: satellite by satellite (S3EKF) against all at once (Cholesky), both compiled, 13 states.

python benchmarks/update.py [--json] [--repeats 41]

Same rows, same outputs (x, P, NIS, innovations, gate decisions), 9 kinematic states and two clocks with drift. Both
use the sparsity of H and the symmetry of P. A measurement is the median over interleaved repeats of a compiled loop;
restoring x and P for the next turn is measured alone and taken off both.
"""

from __future__ import annotations

import argparse
import json
import time

import numba
import numpy as np

from starwise.kernels._jit import FLAGS
from starwise.kernels.update import USED_BOTH, update_batch, update_sequential

SATELLITES = (4, 5, 6, 8, 10, 15, 20, 30, 45, 60)
WANTED = {8: 0.60, 15: 0.40, 30: 0.25, 60: 0.15}
N = 13
njit = numba.njit(error_model="numpy", fastmath=FLAGS)  # as the kernels are compiled


@njit
def turns_sequential(turns, x, P, P0, ic, idr, u, g, v, r, m, gate1, gate2, v_out, s_out, used):
    for _ in range(turns):
        for i in range(N):
            x[i] = 0.0
            for j in range(N):
                P[i, j] = P0[i, j]
        update_sequential(x, P, N, True, ic, idr, u, g, v, r, m, gate1, gate2, v_out, s_out, used)


@njit
def turns_batch(turns, x, P, P0, ic, idr, u, g, v, r, m, gate1, gate2, v_out, s_out, used):
    for _ in range(turns):
        for i in range(N):
            x[i] = 0.0
            for j in range(N):
                P[i, j] = P0[i, j]
        update_batch(x, P, N, True, ic, idr, u, g, v, r, m, gate1, gate2, v_out, s_out, used)


@njit
def turns_empty(turns, x, P, P0, ic, idr, u, g, v, r, m, gate1, gate2, v_out, s_out, used):
    for k in range(turns):
        for i in range(N):
            x[i] = 0.0
            for j in range(N):
                P[i, j] = P0[i, j] + k  # so that the compiler does not leave the loop out


def scene(m: int, rng: np.random.Generator) -> tuple:
    """A sky of m satellites above a horizon, the paper's noise (6 m, 0.1 m/s), a covariance as before an update."""
    az, el = rng.uniform(0, 2 * np.pi, m), rng.uniform(0.1, 1.5, m)
    u = np.column_stack([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)])
    scale = np.array([5.0] * 3 + [0.5] * 3 + [1.0] * 3 + [10.0] * 2 + [0.5] * 2)
    A = rng.normal(size=(N, N))
    P0 = scale[:, None] * (np.eye(N) + A @ A.T / N) * scale
    ic = 9 + np.arange(m) % 2
    r = np.tile([36.0, 0.01], (m, 1))
    g = rng.normal(size=(m, 3)) * 1e-4
    e = np.linalg.cholesky(P0) @ rng.normal(size=N)  # the error of the prediction, and what the rows see of it
    v = np.column_stack([e[ic] - u @ e[:3], e[ic + 2] + g @ e[:3] - u @ e[3:6]]) + np.sqrt(r) * rng.normal(size=(m, 2))
    out = (np.empty((m, 2)), np.empty((m, 2)), np.empty(m, np.uint8))
    return np.zeros(N), P0.copy(), P0, ic, ic + 2, u, g, v, r, m, 20.0, 25.0, *out


def measure(repeats: int) -> list[dict[str, float]]:
    rng = np.random.default_rng(1)
    loops = {"empty": turns_empty, "sequential": turns_sequential, "batch": turns_batch}
    table = []
    for m in SATELLITES:
        args = scene(m, rng)
        turns = max(20, 4000 // m)
        results = {}
        for name, loop in loops.items():
            loop(1, *args)
            results[name] = (args[0].copy(), args[1].copy())
        for a, b in zip(results["sequential"], results["batch"], strict=True):
            assert np.abs(a - b).max() < 1e-8, "the two do not agree"
        assert (args[-1] == USED_BOTH).all(), "sound rows were refused"
        times: dict[str, list[float]] = {name: [] for name in loops}
        for _ in range(repeats):
            for name, loop in loops.items():
                start = time.perf_counter()
                loop(turns, *args)
                times[name].append((time.perf_counter() - start) / turns * 1e6)
        median = {name: float(np.median(t)) for name, t in times.items()}
        sequential, batch = median["sequential"] - median["empty"], median["batch"] - median["empty"]
        row = {"satellites": m, "sequential_us": sequential, "batch_us": batch, "ratio": sequential / batch}
        if m in WANTED:
            row["wanted"] = WANTED[m]
        table.append(row)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repeats", type=int, default=41)
    args = parser.parse_args()
    table = measure(args.repeats)
    if args.json:
        print(json.dumps(table, indent=1))
        return
    print("satellites  sequential us  batch us  ratio  at most")
    for row in table:
        wanted = f"{row['wanted']:8.2f}" if "wanted" in row else ""
        times = f"{row['sequential_us']:14.2f} {row['batch_us']:9.2f}"
        print(f"{row['satellites']:10.0f} {times} {row['ratio']:6.2f} {wanted}")


if __name__ == "__main__":
    main()
