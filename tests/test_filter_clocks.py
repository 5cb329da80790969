"""Clock states of systems that enter, leave and jump: exact operations on the belief."""

import numpy as np
import pytest

from starwise.kernels.filter_state import enter_clock, forget_common_clock, move_state
from starwise.kernels.linalg import median

pytestmark = pytest.mark.laws
NK = 6


def belief(rng, clocks, size=16):
    n = NK + 2 * clocks
    A = rng.normal(size=(n, n))
    x, P = np.zeros(size), np.zeros((size, size))
    x[:n], P[:n, :n] = rng.normal(size=n), A @ A.T
    return x, P


def test_grow_by_a_clock_then_shrink_is_identity():
    rng = np.random.default_rng(1)
    x, P = belief(rng, 2)
    x0, P0 = x.copy(), P.copy()
    at, x2, P2 = np.array([0, -1, 1, -1, -1]), np.zeros(16), np.zeros((16, 16))
    move_state(x, P, NK, 0, at, np.array([0, 1, 2, -1, -1]), x2, P2)
    enter_clock(x, P, NK, 3, 0, 1, 0, 9.0, 0.25)
    assert list(at) == [0, 1, 2, -1, -1]
    # The new clock is the reference plus its own error: var(difference) is exactly that, and it is uncorrelated.
    n = NK + 6
    assert P[NK + 1, NK + 1] + P[NK, NK] - 2 * P[NK + 1, NK] == pytest.approx(9.0, abs=1e-12)
    assert np.abs(P[NK + 1, :NK] - P[NK, :NK]).max() < 1e-15
    assert P[NK + 4, NK + 4] + P[NK + 3, NK + 3] - 2 * P[NK + 4, NK + 3] == pytest.approx(0.25, abs=1e-12)
    assert np.linalg.eigvalsh(P[:n, :n])[0] > 0.0
    assert np.array_equal(P, P.T)
    move_state(x, P, NK, 0, at, np.array([0, -1, 1, -1, -1]), x2, P2)
    n = NK + 4
    assert np.array_equal(x[:n], x0[:n])
    assert np.array_equal(P[:n, :n], P0[:n, :n])


def test_forgetting_the_common_clock_keeps_differences_and_the_rest():
    rng = np.random.default_rng(2)
    x, P = belief(rng, 3)
    n = NK + 6
    x0, P0 = x.copy(), P.copy()
    forget_common_clock(x, P, NK, 3, 0, 100.0, 25.0)
    T = np.eye(n)  # clocks as differences to the first
    T[NK + 1, NK] = T[NK + 2, NK] = -1.0
    before, after = T @ P0[:n, :n] @ T.T, T @ P[:n, :n] @ T.T
    others = [i for i in range(n) if i != NK]
    np.testing.assert_allclose(after[np.ix_(others, others)], before[np.ix_(others, others)], atol=1e-12)
    np.testing.assert_allclose(after[NK, others], 0.0, atol=1e-12)
    assert after[NK, NK] == pytest.approx(25.0, abs=1e-12)
    np.testing.assert_allclose(x[:n] - x0[:n], [0.0] * NK + [100.0] * 3 + [0.0] * 3, atol=1e-12)
    np.testing.assert_allclose(P, P.T, atol=1e-12)
    assert np.linalg.eigvalsh(P[:n, :n])[0] > 0.0


@pytest.mark.parametrize("n", [1, 2, 3, 8, 21])
def test_median(n):
    values = np.random.default_rng(n).normal(size=n + 3)
    assert median(values.copy(), n) == pytest.approx(np.median(values[:n]), abs=1e-15)
