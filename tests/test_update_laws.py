"""Laws of the measurement update: sequential = batch, NIS adds up, order does not matter, gates decide alike."""

import itertools

import numpy as np
import pytest

from starwise.kernels.update import (
    USED_BOTH,
    USED_CODE,
    USED_NONE,
    USED_RATE,
    update_batch,
    update_sequential,
)

pytestmark = pytest.mark.laws
INF = np.inf
# Rounding of numbers of size 1 to 1e4 through some hundred operations, m; far below any millimetre.
ROUNDING = 1e-8


def problem(rng, m, nk=9, clocks=2, with_rate=1.0):
    """Random geometry, covariance and innovations of m satellites; physical sizes."""
    n = nk + 2 * clocks
    u = rng.normal(size=(m, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    ic = nk + rng.integers(0, clocks, m)
    A = rng.normal(size=(n, n))
    scale = np.concatenate(
        [np.full(min(nk, 3), 10.0), np.full(nk - min(nk, 3), 1.0), np.full(clocks, 30.0), np.full(clocks, 1.0)]
    )
    P = scale[:, None] * (A @ A.T / n) * scale
    P = 0.5 * (P + P.T)
    r = np.column_stack([rng.uniform(0.5, 9.0, m) ** 2, rng.uniform(0.02, 0.3, m) ** 2])
    v = np.column_stack([rng.normal(size=m) * 15.0, rng.normal(size=m) * 1.0])
    r[rng.random(m) > with_rate, 1] = INF
    return {
        "n": n,
        "moving": nk >= 6,
        "ic": ic,
        "idr": ic + clocks,
        "u": u,
        "g": rng.normal(size=(m, 3)) * 1e-2,
        "v": v,
        "r": r,
        "P": P,
    }


def run(kernel, p, gate1=INF, gate2=INF, order=None):
    m = len(p["v"])
    order = np.arange(m) if order is None else np.asarray(order)
    x, P = np.zeros(p["n"]), p["P"].copy()
    v_out, s_out, used = np.full((m, 2), np.nan), np.full((m, 2), np.nan), np.zeros(m, np.uint8)
    nis, dof = kernel(
        x, P, p["n"], p["moving"], p["ic"][order], p["idr"][order], p["u"][order], p["g"][order],
        p["v"][order], p["r"][order], m, gate1, gate2, v_out, s_out, used,
    )  # fmt: skip
    return {"x": x, "P": P, "nis": nis, "dof": dof, "v": v_out, "s": s_out, "used": used}


def jacobian(p, k):
    """Twin: dense rows of satellite k."""
    H = np.zeros((2, p["n"]))
    H[0, :3], H[0, p["ic"][k]] = -p["u"][k], 1.0
    H[1, :3], H[1, p["idr"][k]] = p["g"][k], 1.0
    if p["moving"]:
        H[1, 3:6] = -p["u"][k]
    return H if np.isfinite(p["r"][k, 1]) else H[:1]


def textbook(p, order=None):
    """Twin: the conventional update with dense matrices, Joseph's form."""
    order = range(len(p["v"])) if order is None else order
    H = np.vstack([jacobian(p, k) for k in order])
    v = np.concatenate([p["v"][k, : len(jacobian(p, k))] for k in order])
    R = np.diag(np.concatenate([p["r"][k, : len(jacobian(p, k))] for k in order]))
    S = H @ p["P"] @ H.T + R
    K = np.linalg.solve(S, H @ p["P"]).T
    I_KH = np.eye(p["n"]) - K @ H
    return K @ v, I_KH @ p["P"] @ I_KH.T + K @ R @ K.T, float(v @ np.linalg.solve(S, v))


CASES = [(1, 3, 1), (2, 6, 1), (4, 9, 2), (7, 9, 2), (8, 3, 2), (15, 6, 3), (30, 9, 4), (60, 9, 5)]


@pytest.mark.parametrize("kernel", [update_sequential, update_batch])
@pytest.mark.parametrize(("m", "nk", "clocks"), CASES)
@pytest.mark.parametrize("with_rate", [1.0, 0.5, 0.0])
def test_is_the_textbook_update(kernel, m, nk, clocks, with_rate):
    p = problem(np.random.default_rng(m), m, nk, clocks, with_rate)
    x, P, nis = textbook(p)
    got = run(kernel, p)
    assert np.abs(got["x"] - x).max() < ROUNDING
    assert np.abs(got["P"] - P).max() < ROUNDING
    assert got["nis"] == pytest.approx(nis, rel=1e-9)
    assert got["dof"] == sum(len(jacobian(p, k)) for k in range(m))


@pytest.mark.parametrize(("m", "nk", "clocks"), CASES)
def test_sequential_is_batch(m, nk, clocks):
    p = problem(np.random.default_rng(100 + m), m, nk, clocks, 0.8)
    a, b = run(update_sequential, p), run(update_batch, p)
    for name in ("x", "P", "v", "s"):
        assert np.nanmax(np.abs(a[name] - b[name])) < ROUNDING, name
    assert a["nis"] == pytest.approx(b["nis"], rel=1e-10)
    assert a["dof"] == b["dof"]
    assert np.array_equal(a["used"], b["used"])


@pytest.mark.parametrize("kernel", [update_sequential, update_batch])
def test_order_of_satellites_does_not_matter(kernel):
    p = problem(np.random.default_rng(5), 5)
    results = [run(kernel, p, order=o) for o in itertools.permutations(range(5))]
    for r in results[1:]:
        assert np.abs(r["x"] - results[0]["x"]).max() < ROUNDING
        assert np.abs(r["P"] - results[0]["P"]).max() < ROUNDING
        assert r["nis"] == pytest.approx(results[0]["nis"], rel=1e-10)


@pytest.mark.parametrize("seed", range(20))
def test_gates_decide_alike(seed):
    """With outliers of all kinds: the same satellites, the same rows of them, the same state."""
    rng = np.random.default_rng(seed)
    p = problem(rng, 20, with_rate=0.9)
    for k in rng.choice(20, 6, replace=False):
        p["v"][k, rng.integers(0, 2)] += rng.choice([-1, 1]) * 10 ** rng.uniform(0, 5)
    a, b = run(update_sequential, p, 15.1, 18.4), run(update_batch, p, 15.1, 18.4)
    assert np.array_equal(a["used"], b["used"])
    assert 0 < (a["used"] == USED_BOTH).sum() < 20
    for name in ("x", "P", "v", "s"):
        assert np.nanmax(np.abs(a[name] - b[name])) < ROUNDING * 100, name  # innovations up to 1e5 m
    assert a["nis"] == pytest.approx(b["nis"], rel=1e-9)


@pytest.mark.parametrize("kernel", [update_sequential, update_batch])
def test_gate_keeps_the_sound_row_of_a_satellite(kernel):
    p = problem(np.random.default_rng(3), 4)
    p["v"][:] = 0.0
    p["v"][1, 0], p["v"][2, 1], p["v"][3] = 1e4, 1e3, (1e4, 1e3)
    got = run(kernel, p, 15.1, 18.4)
    assert list(got["used"]) == [USED_BOTH, USED_RATE, USED_CODE, USED_NONE]
    assert got["dof"] == 4


@pytest.mark.parametrize("kernel", [update_sequential, update_batch])
def test_rejected_satellites_leave_no_trace(kernel):
    p = problem(np.random.default_rng(4), 9)
    p["v"][[2, 6]] = 1e7
    got = run(kernel, p, 1e4, 1e4)
    x, P, nis = textbook(p, [k for k in range(9) if k not in (2, 6)])
    assert np.abs(got["x"] - x).max() < ROUNDING
    assert np.abs(got["P"] - P).max() < ROUNDING
    assert got["nis"] == pytest.approx(nis, rel=1e-9)


@pytest.mark.parametrize("kernel", [update_sequential, update_batch])
def test_covariance_stays_symmetric_and_positive_for_10000_epochs(kernel):
    rng = np.random.default_rng(8)
    p = problem(rng, 10)
    n = p["n"]
    Phi = np.eye(n)
    Phi[:3, 3:6] = Phi[3:6, 6:9] = np.eye(3)
    Phi[9:11, 11:13] = np.eye(2)
    Q = np.diag([1e-4] * 3 + [1e-3] * 3 + [1e-2] * 3 + [1.0] * 2 + [1e-2] * 2)
    for epoch in range(10_000):
        p["P"] = run(kernel, p)["P"]
        assert np.array_equal(p["P"], p["P"].T), "exact symmetry"
        if epoch % 500 == 0:
            assert np.linalg.eigvalsh(p["P"])[0] > 0.0
        p["P"] = Phi @ p["P"] @ Phi.T + Q
        p["P"] = 0.5 * (p["P"] + p["P"].T)


@pytest.mark.parametrize("kernel", [update_sequential, update_batch])
def test_work_arrays_may_be_larger_than_the_state(kernel):
    """The run keeps P in an array for all systems and uses its leading block."""
    p = problem(np.random.default_rng(6), 8)
    small = run(kernel, p)
    n = p["n"]
    big = np.full((n + 4, n + 4), np.nan)
    big[:n, :n] = p["P"]
    got = run(kernel, {**p, "P": big})
    assert np.array_equal(got["P"][:n, :n], small["P"])
    assert np.isnan(got["P"][n:]).all()
    assert np.array_equal(got["x"], small["x"])
