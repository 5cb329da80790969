"""Observability and controllability: textbook systems, invariance, the Cramer-Rao bound."""

import math

import numpy as np
import pytest

from starwise.analysis.observability import (
    cramer_rao,
    degree_by_covariance,
    degree_by_solution,
    gramian,
    observability,
    observability_over,
)
from starwise.analysis.stability_controllability import (
    controllability,
    controllability_matrix,
    uniform_controllability,
    uniform_observability,
)
from starwise.analysis.stability_system import LinearSystem, Step
from starwise.frames import C_ne_enu
from starwise.types import F8, Layout

TEXTBOOK = 1e-10  # relative: a few hundred operations in double precision
EYE1 = np.eye(1)


def rng(seed: int = 7) -> np.random.Generator:
    return np.random.default_rng(seed)


def constant_velocity(T: float = 0.5, q: float = 0.3, r: float = 2.0, count: int = 20) -> LinearSystem:
    Phi = [[1.0, T], [0.0, 1.0]]
    Q = [[q * T**3 / 3, q * T**2 / 2], [q * T**2 / 2, q * T]]
    return LinearSystem.constant(("pos", "vel"), (Phi, Q, [[1.0, 0.0]], [[r]]), count, T)


def random_system(n: int = 4, m: int = 2, count: int = 12, seed: int = 3) -> LinearSystem:
    g = rng(seed)
    steps = []
    for k in range(count):
        A, B = g.normal(size=(n, n)), g.normal(size=(m + k % 2, m + k % 2))
        steps.append(
            Step(np.eye(n) + 0.2 * A, A @ A.T * 0.1, g.normal(size=(m + k % 2, n)), B @ B.T + np.eye(m + k % 2))
        )
    return LinearSystem(Layout(tuple(f"s.{i}" for i in range(n))), tuple(steps))


@pytest.mark.laws
def test_gramian_of_constant_velocity_is_the_sum_of_powers() -> None:
    T, r, N = 0.5, 2.0, 20
    t = T * np.arange(1, N + 1)
    wanted = np.array([[N, t.sum()], [t.sum(), (t * t).sum()]]) / r
    np.testing.assert_allclose(gramian(constant_velocity(T, r=r, count=N)), wanted, rtol=TEXTBOOK)


@pytest.mark.laws
def test_diagonal_noise_is_the_same_as_a_vector_or_a_matrix() -> None:
    g = rng()
    Phi, H, r = np.eye(3) + 0.1 * g.normal(size=(3, 3)), g.normal(size=(2, 3)), np.array([0.25, 9.0])
    one = LinearSystem.constant(("a", "b", "c"), (Phi, np.eye(3), H, r), 5)
    other = LinearSystem.constant(("a", "b", "c"), (Phi, np.eye(3), H, np.diag(r)), 5)
    np.testing.assert_allclose(gramian(one), gramian(other), rtol=TEXTBOOK)
    np.testing.assert_allclose(one.filtered(np.eye(3)).P, other.filtered(np.eye(3)).P, rtol=TEXTBOOK)


@pytest.mark.laws
def test_gramian_of_a_decaying_state_is_a_geometric_sum() -> None:
    a, N = 0.9, 30
    system = LinearSystem.constant(("a",), ([[a]], [[0.1]], [[2.0]], [[0.5]]), N)
    wanted = 4.0 / 0.5 * a**2 * (1.0 - a ** (2 * N)) / (1.0 - a**2)
    assert gramian(system)[0, 0] == pytest.approx(wanted, rel=TEXTBOOK)
    reach = controllability(system, count=N).gramian[0, 0]
    assert reach == pytest.approx(0.1 * (1.0 - a ** (2 * N)) / (1.0 - a**2), rel=TEXTBOOK)


@pytest.mark.laws
def test_infinite_gramian_solves_the_lyapunov_equation() -> None:
    from scipy.linalg import solve_discrete_lyapunov

    A = np.array([[0.6, 0.2, 0.0], [-0.1, 0.5, 0.3], [0.0, 0.1, 0.4]])
    H, Q = np.array([[1.0, 0.0, 0.5]]), np.diag([0.0, 0.2, 0.1])
    system = LinearSystem.constant(("a", "b", "c"), (A, Q, H, EYE1), 200)
    W = solve_discrete_lyapunov(A.T, H.T @ H) - H.T @ H  # the window's first measurement is one step on
    np.testing.assert_allclose(gramian(system), W, rtol=TEXTBOOK, atol=TEXTBOOK)
    Y = solve_discrete_lyapunov(A, Q)
    np.testing.assert_allclose(controllability(system, count=200).gramian, Y, rtol=TEXTBOOK, atol=TEXTBOOK)


@pytest.mark.laws
def test_gramians_add_over_windows() -> None:
    system = random_system()
    M = np.eye(system.n)
    for s in system.steps[:5]:
        M = s.Phi @ M
    whole = gramian(system.part(0, 5)) + M.T @ gramian(system.part(5, 99)) @ M
    np.testing.assert_allclose(gramian(system), whole, rtol=TEXTBOOK)


@pytest.mark.laws
def test_information_of_the_window_is_that_of_a_filter_without_noise() -> None:
    system = random_system()
    quiet = LinearSystem(system.layout, tuple(Step(s.Phi, 0.0 * s.Q, s.H, s.R) for s in system.steps))
    P0 = np.diag([4.0, 1.0, 9.0, 2.0])
    P = quiet.filtered(P0).P[-1]
    M = np.eye(4)
    for s in system.steps:
        M = s.Phi @ M
    at_start = np.linalg.inv(np.linalg.inv(P0) + gramian(system))
    np.testing.assert_allclose(P, M @ at_start @ M.T, rtol=1e-8, atol=1e-10)
    ratio = observability(system, prior=P0).sigma_ratio
    np.testing.assert_allclose(ratio, np.sqrt(np.diag(at_start) / np.diag(P0)), rtol=1e-8)


@pytest.mark.laws
def test_ranks_and_names_do_not_depend_on_units() -> None:
    system = constant_velocity()
    units = np.diag([1e-6, 3e5])  # radians of the Earth, thousandths of a second
    other = system.transformed(units, Layout(("pos", "vel")))
    a, b = observability(system), observability(other)
    assert a.rank == b.rank == 2
    assert a.condition == pytest.approx(b.condition, rel=1e-6)
    hidden = LinearSystem.constant(("clk.G", "pos.u", "bias"), (np.eye(3), np.eye(3), [[1.0, -1.0, 0.0]], EYE1), 5)
    for scale in ([1.0, 1.0, 1.0], [1.0, 1.0, 1e-7]):
        found = observability(hidden.transformed(np.diag(scale), hidden.layout))
        assert found.rank == 1
        assert {d.name for d in found.unobservable} == {"bias", "clk.G + pos.u"}


def test_hidden_directions_are_named_in_east_north_up() -> None:
    lat, lon = 0.7, 2.0
    C = C_ne_enu(lat, lon)
    names = ("pos.x", "pos.y", "pos.z", "clk.G")
    # satellites at one elevation of 90 deg only: the clock and the height cannot be told apart, east and north not seen
    row = np.concatenate([-C[2], [1.0]])
    system = LinearSystem.constant(names, (np.eye(4), np.eye(4), row[None], EYE1), 3)
    found = observability(system.in_enu(C))
    assert found.rank == 1
    assert {d.name for d in found.unobservable} == {"pos.e", "pos.n", "pos.u + clk.G"}
    assert found.verdict == "not observable"
    assert "pos.u + clk.G" in found.explain()


def test_weak_is_told_from_hidden() -> None:
    step = (np.eye(2), np.zeros((2, 2)), [[1.0, 0.0], [0.0, 1e-3]], np.eye(2))
    system = LinearSystem.constant(("a", "b"), step, 4)
    prior = np.diag([100.0, 100.0])
    found = observability(system, prior=prior)
    assert (found.verdict, found.rank, found.informative) == ("weakly observable", 2, 1)
    assert found.weakest.name == "b"
    assert found.weakest.strength == pytest.approx(1e-3 * 2.0 * 10.0)  # sqrt(4) of them, sigma 10
    np.testing.assert_allclose(found.sigma_ratio, [1 / math.sqrt(401.0), 1 / math.sqrt(1.0 + 4e-4)], rtol=1e-12)
    assert observability(system, prior=1e8 * prior).verdict == "observable"


def test_windows_over_a_run() -> None:
    blind = Step(np.eye(1), np.zeros((1, 1)), np.zeros((0, 1)), np.zeros(0))
    seeing = Step(np.eye(1), np.zeros((1, 1)), np.ones((1, 1)), np.ones(1))
    system = LinearSystem(Layout(("a",)), (blind,) * 4 + (seeing,) * 4)
    assert [w.rank for w in observability_over(system, 2, 2)] == [0, 0, 1, 1]
    # from step 1 on the window 1..4 has one measurement, 0..3 none
    bounds = uniform_observability(system, 4, np.ones(1))
    assert (bounds.low, bounds.high, bounds.windows, bounds.holds) == (0.0, 4.0, 5, False)
    assert uniform_observability(system, 5, np.ones(1)).holds


@pytest.mark.laws
def test_controllability_of_a_chain() -> None:
    """White jerk of the last state only reaches a chain of integrators; a constant is not reached."""
    Phi = np.eye(4) + np.diag([0.5, 0.5, 0.0], 1)
    Q = np.diag([0.0, 0.0, 1.0, 0.0])
    system = LinearSystem.constant(("pos", "vel", "acc", "bias"), (Phi, Q, np.eye(4), np.eye(4)), 8)
    found = controllability(system)
    assert found.rank == 3
    assert [d.name for d in found.uncontrollable] == ["bias"]
    assert "bias" in found.explain()
    assert not uniform_controllability(system, 4, np.ones(4)).holds
    # eq. 6 for constant Phi
    G = np.array([[0.0], [0.0], [1.0], [0.0]])
    wanted = np.concatenate([np.linalg.matrix_power(Phi, 3 - k) @ G for k in range(4)], axis=1)
    mine = controllability_matrix(system.part(0, 4))
    np.testing.assert_allclose(mine @ mine.T, wanted @ wanted.T, atol=1e-14)


@pytest.mark.laws
def test_cramer_rao_bound_is_the_kalman_filter() -> None:
    system = random_system()
    P0 = np.diag([4.0, 1.0, 9.0, 2.0])
    np.testing.assert_allclose(cramer_rao(system, P0), system.filtered(P0).sigma, rtol=1e-9)


def test_cramer_rao_bound_without_prior() -> None:
    system = constant_velocity(T=0.5, q=0.0, r=2.0, count=6)
    bound = cramer_rao(system)
    assert np.isinf(bound[0]).tolist() == [False, True]  # a position, no velocity yet
    t = 0.5 * np.arange(6)
    A = np.stack([np.ones(6), t - t[-1]], axis=1)  # a straight line through six points
    np.testing.assert_allclose(bound[-1], np.sqrt(2.0 * np.diag(np.linalg.inv(A.T @ A))), rtol=1e-9)


def test_degrees() -> None:
    P0, P = np.diag([100.0, 4.0]), np.diag([1.0, 4.0])
    np.testing.assert_allclose(degree_by_covariance(P, P0), [0.9, 0.0])
    system = constant_velocity()
    free = system.free(P0)
    assert (degree_by_covariance(system.filtered(P0).P[-1], free) > 0.5).all()


@pytest.mark.laws
def test_degree_of_the_paper_depends_on_the_state_and_not_on_how_well_it_is_seen() -> None:
    g = rng()
    B = g.normal(size=(5, 5))
    W, x0 = B @ B.T, g.normal(size=5)
    s = degree_by_solution(W, W @ x0)
    # measurements a thousand times better: the same
    np.testing.assert_allclose(degree_by_solution(1e6 * W, 1e6 * W @ x0), s, rtol=1e-6)
    # eigenvalues replaced: the same
    _, V = np.linalg.eigh(W)
    other: F8 = V @ np.diag([1.0, 2.0, 3.0, 4.0, 5.0]) @ V.T
    np.testing.assert_allclose(degree_by_solution(other, other @ x0), s, rtol=1e-6)
    # another state: another "degree of observability"
    assert abs(degree_by_solution(W, W @ (3.0 * x0)) - s / 3.0).max() < 1e-6


def test_matrices_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="step 0"):
        LinearSystem.of(("a",), [(np.eye(2), np.eye(2), np.eye(2), np.eye(2))])
    with pytest.raises(ValueError, match="without steps"):
        LinearSystem.of(("a",), [])
    with pytest.raises(ValueError, match="fewer than 9"):
        uniform_observability(constant_velocity(count=4), 9, np.ones(2))
