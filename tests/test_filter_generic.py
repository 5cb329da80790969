"""Updates for any sensor, on named beliefs: the laws, and agreement with the sparse kernels."""

import numpy as np
import pytest

from starwise.estimators import ekf, s3ekf
from starwise.kernels.update import update_sequential
from starwise.types import Layout, Linear, State

pytestmark = pytest.mark.laws
NAMES = (*(f"{k}.{a}" for k in ("pos", "vel", "acc") for a in "xyz"), "clk.G", "clk.C", "drift.G", "drift.C")
ROUNDING = 1e-9  # numbers of size 10 through some tens of operations


def belief(rng, names=NAMES):
    A = rng.normal(size=(len(names), len(names)))
    return State(0, Layout(names), rng.normal(size=len(names)) * 10.0, A @ A.T + 0.1 * np.eye(len(names)))


def sensor(rng, state, groups, rows=2):
    """A linear sensor: z = H x + e in groups of rows."""
    m, n = groups * rows, len(state.layout)
    H, r = rng.normal(size=(m, n)), rng.uniform(0.1, 4.0, m)
    z = H @ state.x + rng.normal(size=m) * 5.0

    def linearise(at, group):
        k = slice(rows * group, rows * (group + 1))
        return Linear(z[k] - H[k] @ at.x, H[k], r[k], np.arange(m)[k])

    return linearise, Linear(z - H @ state.x, H, r, np.arange(m))


@pytest.mark.parametrize(("groups", "rows"), [(1, 1), (4, 2), (20, 2), (7, 3)])
def test_sequential_is_batch(groups, rows):
    rng = np.random.default_rng(groups)
    state = belief(rng)
    linearise, everything = sensor(rng, state, groups, rows)
    a, ia = ekf.update(state, everything)
    for order in (range(groups), list(rng.permutation(groups))):
        b, ib = s3ekf.update(state, linearise, order)
        assert np.abs(a.x - b.x).max() < ROUNDING
        assert np.abs(a.P - b.P).max() < ROUNDING
        assert ib.nis == pytest.approx(ia.nis, rel=1e-10)
        assert ib.dof == ia.dof == groups * rows
    assert np.array_equal(a.P, a.P.T)
    assert np.linalg.eigvalsh(a.P)[0] > 0.0


def test_update_is_the_information_form():
    """P^-1 + H' R^-1 H and its solution: weighted least squares with the prior as a measurement."""
    rng = np.random.default_rng(1)
    state = belief(rng)
    _, linear = sensor(rng, state, 10)
    got, innovation = ekf.update(state, linear)
    W = np.linalg.inv(state.P) + linear.H.T @ (linear.H / linear.r[:, None])
    dx = np.linalg.solve(W, linear.H.T @ (linear.v / linear.r))
    assert np.abs(got.x - state.x - dx).max() < 1e-8
    assert np.abs(got.P - np.linalg.inv(W)).max() < 1e-8
    S = linear.H @ state.P @ linear.H.T + np.diag(linear.r)
    assert innovation.nis == pytest.approx(linear.v @ np.linalg.solve(S, linear.v), rel=1e-10)


def test_gate_decides_in_batch_as_row_by_row():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        state = belief(rng)
        _, everything = sensor(rng, state, 20, rows=1)
        everything.v[rng.choice(20, 4, replace=False)] += 300.0
        shifted = everything.v + everything.H @ state.x

        def rows(at, k, linear=everything, z=shifted):
            return Linear(
                z[k : k + 1] - linear.H[k : k + 1] @ at.x,
                linear.H[k : k + 1],
                linear.r[k : k + 1],
                linear.row[k : k + 1],
            )

        a, ia = ekf.update(state, everything, gate=10.8)
        b, ib = s3ekf.update(state, rows, range(20), gate=[0.0, 10.8])
        assert np.array_equal(ia.used, ib.used)
        assert not ia.used.all()
        np.testing.assert_allclose(ia.v, ib.v, atol=1e-8)
        np.testing.assert_allclose(ia.s, ib.s, atol=1e-8)
        assert np.abs(a.x - b.x).max() < 1e-8
        assert ia.nis == pytest.approx(ib.nis, rel=1e-8)


def test_all_rows_refused_leaves_the_belief():
    rng = np.random.default_rng(2)
    state = belief(rng)
    linearise, everything = sensor(rng, state, 3)
    assert ekf.update(state, everything, gate=0.0)[0] is state
    got, innovation = s3ekf.update(state, linearise, range(3), gate=[0.0, 0.0, 0.0])
    assert got is state
    assert innovation.dof == 0


def test_kernel_is_the_generic_update_with_sparse_rows():
    rng = np.random.default_rng(3)
    state = belief(rng)
    state = State(0, state.layout, np.zeros(13), state.P)
    m = 12
    u = rng.normal(size=(m, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    g, v = rng.normal(size=(m, 3)) * 1e-2, rng.normal(size=(m, 2))
    r, ic = np.tile([9.0, 0.01], (m, 1)), rng.integers(9, 11, m)
    H = np.zeros((m, 2, 13))
    for k in range(m):
        H[k, 0, :3], H[k, 0, ic[k]] = -u[k], 1.0
        H[k, 1, :3], H[k, 1, 3:6], H[k, 1, ic[k] + 2] = g[k], -u[k], 1.0
    want, innovation = s3ekf.update(
        state, lambda at, k: Linear(v[k] - H[k] @ at.x, H[k], r[k], np.array([2 * k, 2 * k + 1])), range(m)
    )
    x, P = np.zeros(13), state.P.copy()
    v_out, s_out, used = np.empty((m, 2)), np.empty((m, 2)), np.empty(m, np.uint8)
    nis, dof = update_sequential(x, P, 13, True, ic, ic + 2, u, g, v, r, m, np.inf, np.inf, v_out, s_out, used)
    assert np.abs(x - want.x).max() < ROUNDING
    assert np.abs(P - want.P).max() < ROUNDING
    np.testing.assert_allclose(v_out.ravel(), innovation.v, atol=ROUNDING)
    np.testing.assert_allclose(s_out.ravel(), innovation.s, atol=1e-8)
    assert (nis, dof) == (pytest.approx(innovation.nis, rel=1e-10), innovation.dof)


def test_predict_keeps_symmetry_and_composes():
    rng = np.random.default_rng(4)
    state = belief(rng)
    Phi = np.eye(13) + 0.1 * rng.normal(size=(13, 13))
    Q = np.diag(rng.uniform(0.1, 1.0, 13))
    once = ekf.predict(state, Phi @ Phi, Phi @ Q @ Phi.T + Q, 2)
    twice = ekf.predict(ekf.predict(state, Phi, Q, 1), Phi, Q, 2)
    assert np.abs(once.x - twice.x).max() < 1e-10
    assert np.abs(once.P - twice.P).max() < 1e-9
    assert np.array_equal(once.P, once.P.T)
    assert once.t_ns == 2


def test_grow_then_shrink_is_identity():
    rng = np.random.default_rng(5)
    state = belief(rng)
    grown = state.moved_to(
        Layout(("clk.E", *reversed(NAMES), "drift.E")), {"clk.E": (5.0, 1e6), "drift.E": (0.0, 100.0)}
    )
    back = grown.moved_to(state.layout)
    assert np.array_equal(back.x, state.x)
    assert np.array_equal(back.P, state.P)


def test_singular_innovations_are_refused():
    state = State(0, Layout(("a", "b")), np.zeros(2), np.zeros((2, 2)))
    linear = Linear(np.ones(2), np.eye(2), np.zeros(2), np.arange(2))
    with pytest.raises(ValueError, match="not positive definite"):
        ekf.update(state, linear)
    with pytest.raises(ValueError, match="not positive definite"):
        s3ekf.update(state, lambda at, k: linear, [0])
