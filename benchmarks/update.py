"""Measurement update and filter step: the S3EKF's beside its C twin, a batch update, filterpy, Stone Soup and numpy.

    python benchmarks/update.py [--quick] [--json FILE]

Same rows, same outputs (x, P, NIS, innovations, gate decisions), 9 kinematic states and two clocks with drift. A
measurement is a compiled loop of updates; restoring x and P for the next turn is measured alone and taken off. The C
twin (`c_twin/s3ekf_update.c`) is compiled here, by the system's cc, for this processor; the results are compared.

A step is prediction and update. filterpy, Stone Soup and numpy are called from Python with their matrices made
beforehand; so is starwise in the column "starwise, called", while in a run its loop over epochs is compiled.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numba
import numpy as np

from _bench import Spread, Table, now, peer, ratio, show, slope
from starwise.kernels._jit import OPTIONS
from starwise.kernels.process import motion, noise_shape, predict
from starwise.kernels.turns import turns_batch, turns_empty, turns_sequential
from starwise.kernels.update import USED_BOTH, update_sequential
from starwise.models.process import clocks_from, matrices, process_numbers
from starwise.studies.s3ekf_filter import paper_config, paper_motion
from starwise.studies.update_timing import GATES, NK, Problem, make_problem

SATELLITES = (4, 8, 15, 20, 30, 45, 60)
STATES = (8, 13, 20, 30, 45, 60)
WANTED = {8: 0.60, 15: 0.40, 30: 0.25, 60: 0.15}
"""Time of the sequential over that of the batch form, at most."""
C_FLAGS = ("-O3", "-march=native", "-ffp-contract=fast", "-fassociative-math", "-freciprocal-math",
           "-fno-signed-zeros", "-fno-trapping-math", "-fno-math-errno", "-shared", "-fPIC")  # fmt: skip
"""What the kernels allow their compiler (`starwise.kernels._jit.FLAGS`), and no more."""


def c_twin(folder: Path) -> ctypes.CDLL | None:
    """The twin compiled; None without a C compiler."""
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        return None
    source, library = Path(__file__).with_name("c_twin") / "s3ekf_update.c", folder / "twin.so"
    subprocess.run([compiler, *C_FLAGS, "-o", str(library), str(source), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def c_call(twin: ctypes.CDLL, p: Problem) -> Callable[[int], None]:
    """Turns of the twin on a problem."""
    d, i = ctypes.c_double, ctypes.c_int

    def at(array: np.ndarray) -> ctypes.c_void_p:
        return ctypes.c_void_p(array.ctypes.data)

    rows = [at(a) for a in (p.ic, p.idr, p.u, p.g, p.v, p.r)]
    tail = [i(len(p.u)), d(GATES[0]), d(GATES[1]), at(p.v_out), at(p.s_out), at(p.used)]
    return lambda k: twin.turns(ctypes.c_long(k), at(p.x), at(p.P), at(p.P0), i(p.n), *rows, *tail)


def widened(p: Problem, n: int, rng: np.random.Generator) -> Problem:
    """The same rows and n states: those after the clocks are seen by no row but correlated with all."""
    A = rng.normal(size=(n, n))
    P0 = np.eye(n) + A @ A.T / n
    P0[: p.n, : p.n] = p.P0
    P0[p.n :, : p.n] *= 0.1
    P0[: p.n, p.n :] = P0[p.n :, : p.n].T
    room = (np.empty_like(p.v_out), np.empty_like(p.s_out), np.empty_like(p.used))
    return Problem(n, np.zeros(n), P0.copy(), P0, p.ic, p.idr, p.u, p.g, p.v, p.r, *room)


def times(p: Problem, twin: ctypes.CDLL | None, repeats: int) -> dict[str, Spread]:
    """Microseconds of one update by each form, after their answers have been compared."""
    gates = (*GATES, p.v_out, p.s_out, p.used)
    head = (p.n, p.x, p.P, p.P0)
    calls: dict[str, Callable[[int], object]] = {
        "empty": lambda k: turns_empty(k, *head),
        "sequential": lambda k: turns_sequential(k, *head, *p.rows, *gates),
        "batch": lambda k: turns_batch(k, *head, *p.rows, *gates),
    }
    if twin is not None:
        calls["C twin"] = c_call(twin, p)
    answers = {}
    for name, call in calls.items():
        call(1)
        answers[name] = (p.x.copy(), p.P.copy(), p.used.copy())
    for name in calls:
        if name != "empty":
            for a, b in zip(answers[name], answers["sequential"], strict=True):
                # states of metres, and rounding in another order
                assert np.abs(a.astype(float) - b).max() < 1e-8, f"the {name} form gives another answer"
            assert (answers[name][2] == USED_BOTH).all(), "sound rows were refused"
    turns = max(20, 60_000 // (len(p.u) * p.n))
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            start = now()
            call(turns)
            taken[name].append((now() - start) / turns * 1e6)
    empty = Spread.of(taken.pop("empty")).least
    return {name: Spread.of([max(v - empty, 1e-3) for v in values]) for name, values in taken.items()}


def updates(quick: bool) -> list[Table]:
    rng, repeats = np.random.default_rng(1), 11 if quick else 41
    by_m = Table("update", "Measurement update, 13 states, us by satellites (in a compiled loop)")
    by_n = Table("update-states", "Measurement update, 20 satellites, us by states (in a compiled loop)")
    with tempfile.TemporaryDirectory(prefix="starwise-bench-") as name:
        twin = c_twin(Path(name))
        for m in SATELLITES:
            found = times(make_problem(m, 2, rng), twin, repeats)
            by_m.rows.append(_row({"satellites": m}, found, WANTED.get(m)))
        base = make_problem(20, 1, rng)
        for n in STATES:
            p = _six_states(rng) if n == 8 else widened(base, n, rng)
            by_n.rows.append(_row({"states": n}, times(p, twin, repeats)))
    growth = [slope([float(r[c]) for r in t.rows], [r["sequential"].least for r in t.rows])
              for t, c in ((by_m, "satellites"), (by_n, "states"))]  # fmt: skip
    by_m.notes.append(f"time of the sequential form ~ satellites^{growth[0]:.2f}")
    by_n.notes.append(f"time of the sequential form ~ states^{growth[1]:.2f} (2 is the size of P)")
    if twin is None:
        by_m.notes.append("no C compiler: no twin")
    return [by_m, by_n]


def _six_states(rng: np.random.Generator) -> Problem:
    """Position, velocity, one clock: 8 states."""
    p = make_problem(20, 1, rng)
    keep = [0, 1, 2, 3, 4, 5, 9, 10]
    P0 = np.ascontiguousarray(p.P0[np.ix_(keep, keep)])
    return Problem(8, np.zeros(8), P0.copy(), P0, p.ic - 3, p.idr - 3, p.u, p.g, p.v, p.r, p.v_out, p.s_out, p.used)


def _row(head: dict[str, Any], found: dict[str, Spread], wanted: float | None = None) -> dict[str, Any]:
    row = {**head, **found, "sequential / batch": ratio(found["sequential"], found["batch"])}
    if "C twin" in found:
        row["sequential / C"] = ratio(found["sequential"], found["C twin"])
    if wanted is not None:
        row["at most (batch)"] = wanted
    return row


@numba.njit(**OPTIONS)
def steps(turns, x, P, P0, nk, nc, numbers, F, G, M, ic, idr, u, g, v, r, v_out, s_out, used):
    """Prediction over a second and update without a gate, ``turns`` times; the kernels are those of the filter."""
    n = nk + 2 * nc
    for _ in range(turns):
        for i in range(n):
            x[i] = 0.0
            for j in range(n):
                P[i, j] = P0[i, j]
        motion(numbers.kind, 1.0, numbers.tau_s, F, G)
        noise_shape(numbers, 6.4e6, 0.0, 0.0, M)
        predict(x, P, nk, nc, 1.0, numbers, F, G, M)
        update_sequential(x, P, n, True, ic, idr, u, g, v, r, len(u), np.inf, np.inf, v_out, s_out, used)


def dense(p: Problem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """H (2m, n), z (2m,) and R (2m, 2m) of a problem."""
    m = len(p.u)
    H = np.zeros((2 * m, p.n))
    H[::2, :3], H[1::2, :3], H[1::2, 3:6] = -p.u, p.g, -p.u
    H[2 * np.arange(m), p.ic] = 1.0
    H[2 * np.arange(m) + 1, p.idr] = 1.0
    return H, p.v.ravel(), np.diag(p.r.ravel())


def peers(p: Problem, Phi: np.ndarray, Q: np.ndarray) -> dict[str, Callable[[], tuple[np.ndarray, np.ndarray]]]:
    """A step of each other implementation; returns x and P."""
    H, z, R = dense(p)

    def plain() -> tuple[np.ndarray, np.ndarray]:
        x, P = Phi @ np.zeros(p.n), Phi @ p.P0 @ Phi.T + Q
        PHt = P @ H.T
        K = np.linalg.solve(H @ PHt + R, PHt.T).T
        P = P - K @ PHt.T
        return x + K @ (z - H @ x), 0.5 * (P + P.T)

    calls = {"numpy": plain}
    filterpy = peer("filterpy.kalman")
    if filterpy is not None:
        f = filterpy.ExtendedKalmanFilter(dim_x=p.n, dim_z=len(z))
        f.F, f.Q, f.R = Phi, Q, R

        def by_filterpy() -> tuple[np.ndarray, np.ndarray]:
            f.x, f.P = np.zeros(p.n), p.P0
            f.predict()
            f.update(z, HJacobian=lambda _x: H, Hx=lambda x: H @ x)
            return f.x, f.P

        calls["filterpy"] = by_filterpy
    if peer("stonesoup") is not None:
        calls["Stone Soup"] = _stone_soup(p, Phi, Q, H, z, R)
    return calls


def _stone_soup(p: Problem, Phi: np.ndarray, Q: np.ndarray, H: np.ndarray, z: np.ndarray, R: np.ndarray) -> Any:
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
    from stonesoup.predictor.kalman import ExtendedKalmanPredictor
    from stonesoup.types.array import CovarianceMatrix, StateVector
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import ExtendedKalmanUpdater

    class Rows(LinearGaussian):
        def matrix(self, **_: Any) -> np.ndarray:
            return H

    transition = LinearGaussianTimeInvariantTransitionModel(
        transition_matrix=Phi, covariance_matrix=CovarianceMatrix(Q)
    )
    model = Rows(ndim_state=p.n, mapping=tuple(range(len(z))), noise_covar=CovarianceMatrix(R))
    predictor, updater = ExtendedKalmanPredictor(transition), ExtendedKalmanUpdater(model)
    t0 = datetime(2024, 3, 30)
    prior = GaussianState(StateVector(np.zeros(p.n)), CovarianceMatrix(p.P0), timestamp=t0)
    seen = Detection(StateVector(z), timestamp=t0 + timedelta(seconds=1), measurement_model=model)

    def by_stone_soup() -> tuple[np.ndarray, np.ndarray]:
        predicted = predictor.predict(prior, timestamp=seen.timestamp)
        after = updater.update(SingleHypothesis(predicted, seen))
        return np.asarray(after.state_vector, float).ravel(), np.asarray(after.covar, float)

    return by_stone_soup


def step_table(quick: bool) -> Table:
    rng, repeats = np.random.default_rng(2), 9 if quick else 31
    moves, clocks = paper_motion(), clocks_from(paper_config("ekf"))
    numbers = process_numbers(moves, clocks)
    Phi, Q = matrices(moves, clocks, 2, 1.0)
    table = Table("step", "Filter step (prediction and update), 13 states, us by satellites")
    for m in (8, 20, 40):
        p = make_problem(m, 2, rng)
        work = (np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)))
        rows = (p.ic, p.idr, p.u, p.g, p.v, p.r, p.v_out, p.s_out, p.used)

        def own(k: int, p: Problem = p, work: Any = work, rows: Any = rows) -> None:
            steps(k, p.x, p.P, p.P0, NK, 2, numbers, *work, *rows)

        others = peers(p, Phi, Q)
        own(1)
        for name, call in others.items():
            x, P = call()
            # Stone Soup and filterpy invert S, of condition 1e6 with these rows
            assert np.abs(x - p.x).max() < 1e-5, f"{name} gives another state"
            assert np.abs(P - p.P).max() < 1e-4, f"{name} gives another covariance"
        calls: dict[str, tuple[Callable[[], object], int]] = {
            "starwise": (lambda own=own: own(400), 400), "starwise, called": (lambda own=own: own(1), 1),
            **{name: (call, 1) for name, call in others.items()},
        }  # fmt: skip
        taken: dict[str, list[float]] = {name: [] for name in calls}
        for _ in range(repeats):
            for name, (call, inside) in calls.items():
                outside = 1 if inside > 1 else 20
                start = now()
                for _ in range(outside):
                    call()
                taken[name].append((now() - start) / (inside * outside) * 1e6)
        found = {name: Spread.of(values) for name, values in taken.items()}
        row: dict[str, Any] = {"satellites": m, **found}
        row.update({f"{name} x": ratio(found[name], found["starwise"]) for name in others})
        table.rows.append(row)
    absent = [name for name in ("filterpy", "Stone Soup") if name not in others]
    if absent:
        table.notes.append(f"not installed: {', '.join(absent)}")
    table.notes.append("wanted: filterpy 25 x, Stone Soup 50 x the time of starwise")
    return table


def tables(quick: bool) -> list[Table]:
    return [*updates(quick), step_table(quick)]


if __name__ == "__main__":
    show(tables, __doc__)
