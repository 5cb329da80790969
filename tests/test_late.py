"""Late measurements: exact ways agree with the filter that had everything in order; the others fail as they must."""

from typing import Any

import numpy as np
import pytest

from starwise.analysis.consistency import delay_check, known_fault, nis_test, whiteness_test
from starwise.errors import StarwiseError
from starwise.estimators import ekf
from starwise.estimators.late import (
    DelayPrior,
    LateMethod,
    LateRows,
    LinearSystem,
    Replay,
    delay_response,
    run_late,
    steps_of,
)
from starwise.types import Fixes, Layout, Linear, State

DT = 0.25
SIGMA_V = 0.5
NOISE_M = 5.0


def system(T: int, nominal: Any = None) -> LinearSystem:
    """Two axes of position and velocity errors, white acceleration."""
    F = np.array([[1.0, DT], [0.0, 1.0]])
    q = 0.02 * np.array([[DT**3 / 3.0, DT**2 / 2.0], [DT**2 / 2.0, DT]])
    Phi, Q = np.kron(np.eye(2), F), np.kron(np.eye(2), q)
    return LinearSystem(np.broadcast_to(Phi, (T, 4, 4)), np.broadcast_to(Q, (T, 4, 4)), DT, nominal)


H = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
P0 = np.diag([100.0**2, SIGMA_V**2, 100.0**2, SIGMA_V**2])


def track(T: int, speed: float, *, turning: bool) -> tuple[Any, Any]:
    """Nominal position and velocity, east and north, by step."""
    t = DT * np.arange(T + 1)
    heading = 0.3 + (0.6 * np.sin(0.06 * t) * 3.0 if turning else 0.0 * t)
    vel = speed * np.stack([np.sin(heading), np.cos(heading)], axis=1)
    pos = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * DT * (vel[1:] + vel[:-1]), axis=0)])
    return pos, vel


def simulated(rng: Any, T: int, valid: Any, there: Any, nominal: Any) -> tuple[Any, LateRows]:
    """True errors by step, and measurements."""
    s = system(T)
    L = np.linalg.cholesky(s.Q[0])
    x = np.empty((T + 1, 4))
    x[0] = np.sqrt(np.diag(P0)) * rng.standard_normal(4)
    for j in range(T):
        x[j + 1] = s.Phi[j] @ x[j] + L @ rng.standard_normal(4)
    y = nominal[valid] + x[valid] @ H.T + NOISE_M * rng.standard_normal((len(valid), 2))
    n = len(valid)
    return x, LateRows(valid, there, y, np.broadcast_to(H, (n, 2, 4)), np.full((n, 2), NOISE_M**2))


def in_order(s: LinearSystem, rows: LateRows, j: int) -> tuple[Any, Any]:
    """Belief at step j of a plain filter that has all that is there by then in order of validity: textbook matrices."""
    x, P = np.zeros(4), P0.copy()
    known = [f for f in np.argsort(rows.valid, kind="stable") if rows.there[f] <= j]
    for i in range(j + 1):
        if i > 0:
            x, P = s.Phi[i - 1] @ x, s.Phi[i - 1] @ P @ s.Phi[i - 1].T + s.Q[i - 1]
        for f in known:
            if rows.valid[f] == i:
                S = rows.H[f] @ P @ rows.H[f].T + np.diag(rows.r[f])
                K = P @ rows.H[f].T @ np.linalg.inv(S)
                x = x + K @ (rows.y[f] - s.nominal[i] - rows.H[f] @ x)  # type: ignore[index]
                P = P - K @ S @ K.T
    return x, P


def delays(rng: Any, kind: str, F: int) -> tuple[Any, Any]:
    """Steps of validity and of arrival."""
    if kind == "one period":
        valid = 6 * np.arange(F)
        return valid, valid + 6
    if kind == "varying":
        valid = 6 * np.arange(F)
        return valid, valid + rng.integers(0, 7, F)
    valid = 6 * np.arange(F)  # out of order: up to five outstanding
    return valid, valid + rng.integers(0, 30, F)


@pytest.mark.laws
@pytest.mark.parametrize(
    ("kind", "method"),
    [
        *((kind, "replay") for kind in ("one period", "varying", "out of order")),
        *((kind, "cloning") for kind in ("one period", "varying", "out of order")),
        *((kind, "optimal_prediction") for kind in ("one period", "varying")),  # answers in the order of requests
    ],
)
def test_exact_ways_equal_the_filter_in_order(kind: str, method: LateMethod) -> None:
    rng = np.random.default_rng(3)
    T = 300
    valid, there = delays(rng, kind, 45)
    pos, _ = track(T, 60.0, turning=True)
    _, rows = simulated(rng, T, valid, there, pos)
    run = run_late(system(T, pos), rows, np.zeros(4), P0, method)
    for j in (0, 5, 6, 7, 30, 119, 200, T):
        x, P = in_order(system(T, pos), rows, j)
        np.testing.assert_allclose(run.x[j], x, rtol=0, atol=1e-9)  # m: rounding
        np.testing.assert_allclose(run.P[j], P, rtol=0, atol=1e-8)  # m^2: of 1e4 at the start


@pytest.mark.laws
def test_several_rows_late_and_some_missing() -> None:
    rng = np.random.default_rng(4)
    T = 120
    valid, there = delays(rng, "out of order", 15)
    pos, _ = track(T, 20.0, turning=True)
    _, rows = simulated(rng, T, valid, there, pos)
    y = rows.y.copy()
    y[3, 1] = np.nan
    y[7] = np.nan
    H2 = rows.H + 0.1 * rng.standard_normal(rows.H.shape)
    some = LateRows(rows.valid, rows.there, y, H2, rows.r)
    runs = [run_late(system(T, pos), some, np.zeros(4), P0, m) for m in ("replay", "cloning")]
    np.testing.assert_allclose(runs[0].x[-1], runs[1].x[-1], rtol=0, atol=1e-9)  # m: rounding
    assert sorted(runs[0].dof.tolist())[:3] == [0, 1, 2]


@pytest.mark.laws
def test_without_delay_all_ways_are_one() -> None:
    rng = np.random.default_rng(5)
    T = 60
    valid = 6 * np.arange(10)
    pos, _ = track(T, 20.0, turning=True)
    _, rows = simulated(rng, T, valid, valid, pos)
    methods: tuple[LateMethod, ...] = ("replay", "cloning", "optimal_prediction", "ignored")
    runs = [run_late(system(T, pos), rows, np.zeros(4), P0, m) for m in methods]
    for run in runs[1:]:
        np.testing.assert_allclose(run.x, runs[0].x, rtol=0, atol=1e-10)  # m: rounding
        np.testing.assert_allclose(run.v, runs[0].v, rtol=0, atol=1e-10)


def experiment(method: LateMethod, speed: float, *, turning: bool, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    T, F = 1200, 199
    valid = 6 * np.arange(F)
    pos, vel = track(T, speed, turning=turning)
    x, rows = simulated(rng, T, valid, valid + 6, pos)
    s = system(T, pos)
    run = run_late(s, rows, np.zeros(4), P0, method)
    error = (run.x - x)[T // 2 :, [0, 2]]
    out = {
        "rms": float(np.sqrt((error**2).sum(axis=1).mean())),
        "nis": nis_test(run.nis[-58:], 2).passed,
        "white": whiteness_test(run.v[-58:], run.S[-58:], 8, 50).passed,
    }
    signature, effect = delay_response(s, rows, P0, method, vel)
    claimed = float(np.sqrt(run.P[-1, 0, 0] + run.P[-1, 2, 2]))
    out["check"] = delay_check(run.v, run.S, signature, effect[-1, [0, 2]], claimed, 2.0)
    return out


def test_straight_flight_hides_an_ignored_delay_from_nis_and_whiteness_but_not_from_the_check() -> None:
    hidden = [experiment("ignored", 100.0, turning=False, seed=k) for k in range(20)]
    assert np.mean([e["rms"] for e in hidden]) == pytest.approx(150.0, rel=0.05)  # 1.5 s times 100 m/s
    assert np.mean([e["nis"] and e["white"] for e in hidden]) >= 0.7  # 0.9 expected; 20 runs
    assert all(e["check"].verdict != "confirmed" for e in hidden)
    turning = [experiment("ignored", 100.0, turning=True, seed=k) for k in range(5)]
    assert all(e["check"].verdict == "wrong" for e in turning)
    assert all(abs(e["check"].delay_s - 1.5) < 5.0 * e["check"].sigma_s + 0.15 for e in turning)  # s: (1.5 s)^2 / 2 a
    good = [experiment("optimal_prediction", 100.0, turning=True, seed=k) for k in range(20)]
    assert all(e["check"].verdict == "confirmed" for e in good)
    slow = [experiment("ignored", 0.0, turning=False, seed=k) for k in range(5)]
    assert all(e["check"].verdict == "confirmed" for e in slow)


def test_an_unknown_delay_is_estimated_where_the_track_turns() -> None:
    rng = np.random.default_rng(8)
    T, F = 1200, 190
    valid = 6 * np.arange(F)
    there = valid + 5
    pos, _ = track(T, 60.0, turning=True)
    errors, z = [], []
    for _ in range(20):
        x, rows = simulated(rng, T, valid, there, pos)
        run = run_late(system(T, pos), rows, np.zeros(4), P0, "estimated", DelayPrior(0.5, 1.0))
        z.append((run.delay_s[-1] - 1.25) / run.delay_sigma_s[-1])
        errors.append((run.x - x)[T // 2 :, [0, 2]])
        assert run.delay_sigma_s[-1] < 0.1
    assert np.sqrt(np.mean(np.square(z))) < 2.0  # 1 expected; 20 runs, 5 sigma is 1.8
    rms = float(np.sqrt((np.array(errors) ** 2).sum(axis=2).mean()))
    exact = [
        run_late(
            system(T, pos), simulated(np.random.default_rng(k), T, valid, there, pos)[1], np.zeros(4), P0, "replay"
        )
        for k in range(1)
    ]
    assert rms < 2.0 * float(np.sqrt(exact[0].P[-1, 0, 0] + exact[0].P[-1, 2, 2]))
    straight = run_late(
        system(T, track(T, 60.0, turning=False)[0]),
        simulated(rng, T, valid, there, track(T, 60.0, turning=False)[0])[1],
        np.zeros(4), P0, "estimated", DelayPrior(0.5, 1.0),
    )  # fmt: skip
    assert straight.delay_sigma_s[-1] > 0.5  # s: it cannot be seen, and the filter knows


@pytest.mark.laws
def test_the_fault_signature_is_that_of_the_augmented_filter() -> None:
    # a filter with the delay as a state of infinite prior estimates what the signature estimates afterwards
    rng = np.random.default_rng(9)
    T, F = 400, 60
    valid = 6 * np.arange(F)
    pos, vel = track(T, 50.0, turning=True)
    _, rows = simulated(rng, T, valid, valid, pos)
    s = system(T, pos)
    run = run_late(s, rows, np.zeros(4), P0, "ignored")
    signature, _ = delay_response(s, rows, P0, "ignored", vel)
    found = known_fault(run.v, run.S, signature)
    Phi = np.broadcast_to(np.block([[s.Phi[0], np.zeros((4, 1))], [np.zeros((1, 4)), np.eye(1)]]), (T, 5, 5))
    Q = np.zeros((T, 5, 5))
    Q[:, :4, :4] = s.Q
    H5 = np.concatenate([rows.H, -vel[rows.there][:, :, None]], axis=2)
    big = np.block([[P0, np.zeros((4, 1))], [np.zeros((1, 4)), 1e4 * np.eye(1)]])
    five = LateRows(rows.valid, rows.there, rows.y, H5, rows.r)
    wide = run_late(LinearSystem(Phi, Q, DT, pos), five, np.zeros(5), big, "ignored")
    assert found.size == pytest.approx(wide.x[-1, 4], abs=1e-5)  # s: prior of 100 s instead of infinite
    assert found.sigma == pytest.approx(np.sqrt(wide.P[-1, 4, 4]), rel=1e-5)


def test_bad_rows_are_refused() -> None:
    pos, _ = track(10, 1.0, turning=False)
    _, rows = simulated(np.random.default_rng(0), 10, np.array([2]), np.array([4]), pos)
    for changed, message in (
        ({"there": np.array([1])}, "steps out of order"),
        ({"there": np.array([11])}, "steps out of order"),
        ({"r": np.zeros((1, 2))}, "zero or no variance"),
    ):
        bad = LateRows(**{**rows.__dict__, **changed})
        with pytest.raises(StarwiseError, match=message):
            run_late(system(10, pos), bad, np.zeros(4), P0)
    with pytest.raises(StarwiseError, match="no such way"):
        run_late(system(10, pos), rows, np.zeros(4), P0, "guess")  # type: ignore[arg-type]
    fixes = Fixes(np.array([5]), np.array([4]), np.zeros((1, 3)), np.zeros((1, 3, 3)))
    with pytest.raises(StarwiseError, match="before the time it is valid"):
        steps_of(fixes, 0, 1.0)


@pytest.mark.laws
def test_steps_of_fixes() -> None:
    fixes = Fixes(
        np.array([0, 1_000_000_000]), np.array([250_000_001, 1_000_000_000]), np.zeros((2, 3)), np.zeros((2, 3, 3))
    )
    valid, there = steps_of(fixes, 0, 0.25)
    assert valid.tolist() == [0, 4]
    assert there.tolist() == [2, 4]


LAYOUT = Layout(("pos", "vel"))


def predicted(belief: State, at: int, to: int) -> State:
    dt = (to - at) * 1e-9
    Q = 0.1 * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    return ekf.predict(belief, np.array([[1.0, dt], [0.0, 1.0]]), Q, to)


@pytest.mark.laws
@pytest.mark.parametrize("seed", range(4))
def test_any_filter_replayed_equals_itself_in_order(seed: int) -> None:
    # epochs of several nonlinear ranges to known points: a late satellite epoch in one dimension
    rng = np.random.default_rng(seed)
    stations = np.array([[-400.0, 300.0], [500.0, 200.0], [100.0, -600.0]])

    def epoch(z: Any) -> Any:
        def update(belief: State) -> State:
            away = np.stack([belief.x[0] - stations[:, 0], -stations[:, 1]], axis=1)
            r = np.hypot(away[:, 0], away[:, 1])
            H = np.stack([away[:, 0] / r, np.zeros(3)], axis=1)
            return ekf.update(belief, Linear(z - r, H, np.full(3, 4.0), np.arange(3)))[0]

        return update

    valid = np.sort(rng.choice(np.arange(1, 200), 40, replace=False)) * 50_000_000
    there = valid + rng.integers(0, 2_000, 40) * 1_000_000
    epochs = [epoch(np.hypot(3.0 * t * 1e-9 - stations[:, 0], stations[:, 1]) + rng.normal(0, 2, 3)) for t in valid]
    start = State(0, LAYOUT, np.zeros(2), np.diag([100.0, 25.0]))
    late = Replay(0, start, predicted, memory_s=5.0)
    for f in np.argsort(there, kind="stable"):
        late.advance(int(there[f]))
        assert late.add(int(valid[f]), epochs[f])
    late.advance(12_000_000_000)
    belief, at = start, 0
    for f in range(40):
        belief, at = epochs[f](predicted(belief, at, int(valid[f]))), int(valid[f])
    belief = predicted(belief, at, 12_000_000_000)
    np.testing.assert_array_equal(late.belief.x, belief.x)
    np.testing.assert_array_equal(late.belief.P, belief.P)
    assert not late.add(0, epochs[0])
    assert late.refused == 1
    with pytest.raises(ValueError, match="after the present"):
        late.add(13_000_000_000, epochs[0])
    with pytest.raises(ValueError, match="runs back"):
        late.advance(0)
