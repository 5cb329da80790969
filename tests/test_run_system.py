"""Linear systems of finished runs: they are those of the filter that made them, and the analyses obey their laws."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import starwise
import starwise.demo
from starwise.analysis.run_ins import InertialSystem
from starwise.analysis.run_observability import Observability
from starwise.analysis.run_stability import Stability
from starwise.analysis.run_system import RunSystem, system_of
from starwise.analysis.run_window import RunWindow, filtered, whitened
from starwise.analysis.threads import _functions, one_thread
from starwise.config import RunConfig
from starwise.config_inertial import InertialConfig
from starwise.errors import StarwiseError
from starwise.frames import C_ne_enu, ecef_from_geodetic, geodetic_from_ecef
from starwise.types import Fixes, Solution

DATA = Path(starwise.demo.__file__).parent / "data"
FILES = (DATA / "demo_MO.rnx.gz", DATA / "demo_MN.rnx.gz")


@pytest.fixture(scope="module")
def colored() -> Solution:
    return starwise.solve(*FILES, dynamics="vehicle", report=False)


@pytest.fixture(scope="module")
def white() -> Solution:
    return starwise.solve(*FILES, dynamics="vehicle", error_model="white", report=False)


def sigmas_of_run(solution: Solution, first: int, count: int, floor: float) -> np.ndarray:
    """Claimed sigmas of the position, east north up, m, without the floor that no state describes."""
    lat, lon, _ = geodetic_from_ecef(solution.pos_e[first])
    C = C_ne_enu(lat, lon)
    cov = solution.cov_pos[first : first + count] - floor**2 * np.eye(3)
    return np.sqrt(np.diagonal(C @ cov @ C.T, axis1=1, axis2=2))


@pytest.mark.laws
@pytest.mark.parametrize("model", ["colored", "white"])
def test_covariances_of_the_run_come_out_again(model: str, request: pytest.FixtureRequest) -> None:
    solution: Solution = request.getfixturevalue(model)
    system = RunSystem.of(solution)
    first, length = system.longest_stretch()
    count = min(60, length)
    window = system.window(first, count)
    made = np.array([np.sqrt(np.diag(b.P)[:3]) for b in filtered(window)])
    floor = system.table.errors.floor if system.table.errors.on else 0.0
    claimed = sigmas_of_run(solution, first, count, floor)
    # 0.1 %: a rate's change with the position; 1 %: also the speed that shortens multipath, here after the update
    np.testing.assert_allclose(made / claimed, 1.0, atol=0.01 if model == "colored" else 0.001)
    assert system.table.errors.on == (model == "colored")


@pytest.mark.laws
def test_robust_weights_come_out_of_the_innovations(colored: Solution) -> None:
    """A code three sigmas late counts as one of twice the variance (Huber, 1.5 sigmas): S is doubled through R."""
    v = 3.0 * np.sqrt(colored.ledger["innovation_var_m2"])
    table = RunSystem.of(replace(colored, ledger={**colored.ledger, "innovation_m": v})).table
    s = colored.ledger["innovation_var_m2"][np.isfinite(colored.ledger["elevation_rad"])]
    there = table.used[:, 0]
    assert there.any()
    np.testing.assert_allclose(table.extra[there, 0], s[there], rtol=1e-9)
    assert table.scale[-1] > 1.0  # and such codes raise the scale of code noise


def dense(window: RunWindow) -> tuple[np.ndarray, np.ndarray]:
    """Measurements of a window as functions of x at its beginning and the covariance of their errors, by definition."""
    M, rows = np.eye(window.n), []
    for s in window.steps:
        M = s.Phi @ M
        rows.append(s.H @ M)
    size = [len(s.r) for s in window.steps]
    edge = np.cumsum([0, *size])
    C = np.zeros((edge[-1], edge[-1]))
    for k, a in enumerate(window.steps):
        fade = np.ones(len(a.phi))
        for j in range(k, len(window.steps)):
            b = window.steps[j]
            if j > k:
                fade = fade * b.phi
            block = b.E @ (fade[:, None] * a.E.T)
            C[edge[j] : edge[j + 1], edge[k] : edge[k + 1]] = block
            C[edge[k] : edge[k + 1], edge[j] : edge[j + 1]] = block.T
        C[edge[k] : edge[k + 1], edge[k] : edge[k + 1]] += np.diag(a.r)
    return np.concatenate(rows), C


@pytest.mark.laws
def test_lasting_errors_are_taken_out_exactly(colored: Solution) -> None:
    window = RunSystem.of(colored).window(20, 6)
    H, C = dense(window)
    O = whitened(window)  # noqa: E741
    W = H.T @ np.linalg.solve(C, H)
    scale = np.sqrt(np.outer(np.diag(W), np.diag(W)))
    # 1e-9 of the diagonal: covariances of some hundred rows, conditions up to 1e5
    np.testing.assert_allclose(O.T @ O / scale, W / scale, atol=1e-9)
    without = np.concatenate([s.H for s in window.steps])
    assert O.shape == without.shape


@pytest.mark.laws
def test_filter_with_two_kinds_of_states_is_the_dense_one(colored: Solution) -> None:
    window = RunSystem.of(colored).window(10, 4)
    P = window.system().filtered(window.prior_of_all()).P
    for step, belief in zip(P, filtered(window, dynamics=True), strict=True):
        d = np.sqrt(np.diag(step))
        np.testing.assert_allclose(belief.P / np.outer(d, d), step / np.outer(d, d), atol=1e-6)  # Joseph's form there
        assert belief.Psi.shape == step.shape


@pytest.mark.laws
def test_bound_is_below_what_the_filter_has(colored: Solution) -> None:
    window = RunSystem.of(colored).window(0, 30)
    wide = [np.diag(b.P)[: window.n] for b in filtered(window)]
    bound = [np.diag(b.P)[: window.n] for b in filtered(window, widened=False)]
    assert all((b <= w * (1.0 + 1e-9)).all() for b, w in zip(bound, wide, strict=True))


@pytest.mark.laws
def test_what_is_left_of_a_start_is_the_product_of_all_psi(white: Solution) -> None:
    system = RunSystem.of(white)
    first, _ = system.longest_stretch()
    window = system.window(first, 20)
    M = np.eye(window.n)
    for belief in filtered(window, dynamics=True):
        M = belief.Psi @ M
    found = Stability.of(system, steps=20)
    D = found.scale / found.scale[:, None]
    assert found.product_norm[-1] == pytest.approx(np.linalg.norm(M * D, 2), rel=1e-6)
    assert (found.product_norm_P <= 1.0 + 1e-6).all()  # Deyst, Price: optimal gains


def test_run_is_observable_and_stable(colored: Solution) -> None:
    seen = Observability.of(colored, windows=4)
    assert seen.verdict in ("observable", "weakly observable")
    assert all(s.window.rank == len(s.window.layout) for s in seen.spans)
    assert seen.epochs is not None
    assert seen.epochs.alone > 0.9
    stable = Stability.of(colored, steps=80)
    assert stable.verdict == "asymptotically stable"
    assert stable.controllability.controllable
    assert "slope.1" in stable.constants
    for text in (seen.explain(), stable.explain()):
        assert all(len(line) <= 79 for line in text.splitlines())
        assert seen.verdict in text or stable.verdict in text


def only(solution: Solution, satellites: int) -> Solution:
    """The run as if no more than so many satellites had been used in each epoch."""
    ledger = {name: values.copy() for name, values in solution.ledger.items()}
    keep: dict[int, set[int]] = {}
    for row in range(len(ledger["sv"])):
        kept = keep.setdefault(int(ledger["t_ns"][row]), set())
        sv = int(ledger["sv"][row])
        if sv >> 8 == 0 and ledger["status"][row] == 0 and (len(kept) < satellites or sv in kept):
            kept.add(sv)
        else:
            ledger["status"][row], ledger["rate_used"][row] = 2, False
    return replace(solution, ledger=ledger)


def test_two_satellites_leave_directions_that_have_names(white: Solution) -> None:
    weak = Observability.of(only(white, 2), windows=3)
    assert weak.verdict == "weakly observable"  # in ten seconds the satellites move by a milliradian
    assert all(s.window.weakest.strength < 0.1 for s in weak.spans)
    seen = Observability.of(only(white, 2), windows=3, tolerance=1e-3)  # noise times a thousand
    assert seen.verdict == "not observable"
    assert seen.epochs is not None
    assert seen.epochs.alone == 0.0
    names = " ".join(name for name, _ in seen.unobservable)
    assert "pos." in names
    assert "clk.G" in names
    assert "changes no measurement" in " ".join(seen.explain().split())


def test_least_squares_has_no_memory() -> None:
    solution = starwise.solve(*FILES, method="lsq", error_model="white", report=False)
    stable = Stability.of(solution)
    assert stable.verdict == "no memory"
    assert "solved by itself" in stable.explain()
    assert all(s.window.count == 1 for s in Observability.of(solution, windows=3).spans)


def test_solutions_that_do_not_say_what_was_measured(white: Solution) -> None:
    for bad in (replace(white, ledger={}), replace(white, provenance={})):
        with pytest.raises(StarwiseError):
            system_of(bad)
    unused = replace(white, ledger={**white.ledger, "status": np.full(len(white.ledger["sv"]), 2, np.uint8),
                                    "rate_used": np.zeros(len(white.ledger["sv"]), bool)})  # fmt: skip
    with pytest.raises(StarwiseError, match="nothing is observable"):
        Observability.of(unused)
    with pytest.raises(StarwiseError, match="no windows"):
        Observability.of(white, windows=0)


def inertial(n: int, turning: bool) -> tuple[Solution, Fixes]:
    """A level vehicle at rest, or in a circle of 20 m at 10 m/s, with fixes each second."""
    t = np.arange(n, dtype=float)
    yaw = t * 0.5 if turning else np.zeros(n)
    llh = np.tile([0.8, 0.2, 300.0], (n, 1))
    north, east = (20.0 * np.sin(yaw), 20.0 * (1.0 - np.cos(yaw))) if turning else (np.zeros(n), np.zeros(n))
    llh[:, 0] += north / 6.37e6
    llh[:, 1] += east / 6.38e6 / np.cos(0.8)
    pos = ecef_from_geodetic(llh)
    C = C_ne_enu(0.8, 0.2)
    v = 10.0 * np.stack([np.sin(yaw), np.cos(yaw), np.zeros(n)], axis=1) if turning else np.zeros((n, 3))
    nan, t_ns = np.full((n, 0), np.nan), (t * 1e9).astype(np.int64)
    eye = np.broadcast_to(np.eye(3), (n, 3, 3))
    solution = Solution(
        t_ns, np.zeros(n, np.uint8), pos, v @ C, eye, eye, nan, nan, nan, (), np.zeros(n, np.int32),
        np.full((n, 4), np.nan), np.zeros(n), np.zeros(n, np.int32), {},
        {"config": {**RunConfig().to_dict(), "method": "loose", "inertial": InertialConfig().to_dict()}},
        {"roll_deg": np.zeros(n), "pitch_deg": np.zeros(n), "yaw_deg": np.degrees(yaw),
         **{f"sigma_{a}_deg": np.full(n, 5.0) for a in ("roll", "pitch", "yaw")}},
    )  # fmt: skip
    return solution, Fixes(t_ns, t_ns, pos, 0.1**2 * eye, v @ C, 0.05**2 * eye)


def test_heading_of_an_inertial_run_is_seen_in_turns_only() -> None:
    degree = {}
    for turning in (False, True):
        solution, fixes = inertial(40, turning)
        system = InertialSystem.of(solution, fixes)
        seen = Observability.of(system, windows=1, epochs=40)
        degree[turning] = seen.states()["att.d"]["degree"]
        assert seen.states()["pos.n"]["degree"] > 0.99
        assert len(seen.spans[0].window.layout) == 15
    assert degree[False] < 0.01
    assert degree[True] > 0.7  # from 5 deg to below 1.5


def test_an_inertial_run_wants_the_sigmas_of_its_fixes() -> None:
    solution, _ = inertial(10, False)
    with pytest.raises(StarwiseError, match="sigmas are not known"):
        system_of(solution)


def test_one_thread_from_two_threads_leaves_as_many_as_there_were() -> None:
    functions = _functions()
    if functions is None:
        pytest.skip("numpy's BLAS has no function for its threads")
    get, put = functions
    before = get()
    put(2)
    try:
        first, second = one_thread(), one_thread()
        first.__enter__()
        second.__enter__()
        assert get() == 1
        first.__exit__(None, None, None)
        assert get() == 1  # the other is still inside
        second.__exit__(None, None, None)
        assert get() == 2
    finally:
        put(before)
