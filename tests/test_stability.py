"""Stability of filters: spectral radii, steady states, exponents and growth of known linear systems."""

import math

import numpy as np
import pytest

from starwise.analysis.stability import lyapunov_exponents, stability
from starwise.analysis.stability_dare import dare, spectral_radii, steady_state
from starwise.analysis.stability_system import LinearSystem, Step

TEXTBOOK = 1e-10  # relative: a few hundred operations in double precision


def scalar(a: float, q: float, r: float = 1.0) -> Step:
    return Step(np.array([[a]]), np.array([[q]]), np.ones((1, 1)), np.array([r]))


@pytest.mark.laws
@pytest.mark.parametrize(("a", "q", "r"), [(1.0, 0.2, 3.0), (0.9, 1.0, 1.0), (1.3, 0.5, 2.0)])
def test_dare_of_one_state_is_the_root_of_a_quadratic(a: float, q: float, r: float) -> None:
    b = r * (1.0 - a * a) - q
    p = 0.5 * (-b + math.sqrt(b * b + 4.0 * q * r))
    s = steady_state(scalar(a, q, r))
    assert s.before[0, 0] == pytest.approx(p, rel=TEXTBOOK)
    assert s.P[0, 0] == pytest.approx(p * r / (p + r), rel=TEXTBOOK)
    assert s.spectral_radius == pytest.approx(a * r / (p + r), rel=TEXTBOOK)


@pytest.mark.laws
def test_dare_of_an_unstable_state_without_noise() -> None:
    """The stabilising solution is P = r (a^2 - 1), and Psi has its pole at 1 / a; P = 0 solves the equation as well."""
    s = steady_state(scalar(1.25, 0.0, 2.0))
    assert s.before[0, 0] == pytest.approx(2.0 * (1.25**2 - 1.0), rel=TEXTBOOK)
    assert s.spectral_radius == pytest.approx(0.8, rel=TEXTBOOK)


@pytest.mark.laws
def test_alpha_beta_filter_is_kalatas() -> None:
    """Steady gains of the piecewise constant acceleration model (Bar-Shalom et al. 2001, 6.5.3)."""
    T, sigma_v, sigma_w = 0.5, 0.8, 3.0
    G = np.array([[T * T / 2.0], [T]])
    step = Step(np.array([[1.0, T], [0.0, 1.0]]), sigma_v**2 * G @ G.T, np.array([[1.0, 0.0]]), np.array([sigma_w**2]))
    lam = sigma_v * T * T / sigma_w
    alpha = -(lam * lam + 8.0 * lam - (lam + 4.0) * math.sqrt(lam * lam + 8.0 * lam)) / 8.0
    beta = (lam * lam + 4.0 * lam - lam * math.sqrt(lam * lam + 8.0 * lam)) / 4.0
    s = steady_state(step)
    np.testing.assert_allclose(s.K[:, 0], [alpha, beta / T], rtol=TEXTBOOK)
    # poles of z^2 - (2 - alpha - beta) z + (1 - alpha)
    assert s.spectral_radius == pytest.approx(math.sqrt(1.0 - alpha), rel=TEXTBOOK)
    np.testing.assert_allclose(s.P[0, 0], alpha * sigma_w**2, rtol=TEXTBOOK)
    system = LinearSystem.constant(("pos", "vel"), (step.Phi, step.Q, step.H, step.R), 200, T)
    found = stability(system, np.diag([100.0, 100.0]))
    assert found.verdict == found.lemma1 == "asymptotically stable"
    assert found.limit_radius == pytest.approx(math.sqrt(1.0 - alpha), rel=TEXTBOOK)
    assert found.spectral_radius[-1] == pytest.approx(math.sqrt(1.0 - alpha), rel=1e-9)  # the run is there by then
    # complex poles: both exponents are the logarithm of the radius
    np.testing.assert_allclose(found.exponents_per_s, math.log(1.0 - alpha) / 2.0 / T, rtol=0.05)


@pytest.mark.laws
def test_spectral_radii_of_known_matrices() -> None:
    c, s = math.cos(0.3), math.sin(0.3)
    A = np.array([[[0.9, 5.0], [0.0, 0.2]], [[0.7 * c, -0.7 * s], [0.7 * s, 0.7 * c]], [[0.0, 4.0], [1.0, 0.0]]])
    np.testing.assert_allclose(spectral_radii(A), [0.9, 0.7, 2.0], rtol=TEXTBOOK)


@pytest.mark.laws
def test_exponents_of_triangular_matrices_are_the_logarithms_of_their_diagonals() -> None:
    A = np.array([[0.5, 1.0, 2.0], [0.0, 0.9, -1.0], [0.0, 0.0, 0.8]])
    found = lyapunov_exponents(np.broadcast_to(A, (2000, 3, 3)))
    np.testing.assert_allclose(found, np.log([0.9, 0.8, 0.5]), rtol=TEXTBOOK)


def given(Psi: np.ndarray, count: int) -> LinearSystem:
    """System whose error dynamics are Psi: gains of zero."""
    n = len(Psi)
    step = (Psi, np.eye(n), np.zeros((1, n)), np.eye(1), np.zeros((n, 1)))
    return LinearSystem.constant([f"s{i}.a" for i in range(n)], step, count)


def test_verdicts_of_constant_dynamics() -> None:
    assert stability(given(np.diag([0.5, 0.9]), 3)).verdict == "asymptotically stable"
    assert stability(given(np.diag([0.5, 1.0]), 300)).verdict == "stable"
    assert stability(given(np.diag([0.5, 1.01]), 3)).verdict == "not stable"
    # a double eigenvalue of 1 that is no full one: grows, though slowly
    drifting = stability(given(np.array([[1.0, 1.0], [0.0, 1.0]]), 300))
    assert drifting.product_norm[-1] == pytest.approx(300.0, rel=0.01)


def test_radii_below_one_do_not_make_products_small() -> None:
    """The classical counterexample: two nilpotent matrices in turn; lemma 1 of the paper is wrong."""
    up, down = np.array([[0.0, 2.0], [0.0, 0.0]]), np.array([[0.0, 0.0], [2.0, 0.0]])
    steps = [(A, np.eye(2), np.zeros((1, 2)), np.eye(1), np.zeros((2, 1))) for A in (up, down) * 20]
    found = stability(LinearSystem.of(("a", "b"), steps))
    np.testing.assert_allclose(found.spectral_radius, 0.0, atol=1e-15)
    assert found.lemma1 == "asymptotically stable"
    assert found.verdict == "not stable"
    assert "By spectral radii alone" in found.explain()
    np.testing.assert_allclose(found.norm, 2.0)
    assert found.product_norm[-1] == pytest.approx(2.0**40)


@pytest.mark.laws
def test_errors_in_units_of_the_covariance_never_grow() -> None:
    g = np.random.default_rng(5)
    steps = []
    for _ in range(40):
        B = 0.3 * g.normal(size=(3, 3))
        steps.append((np.eye(3) + B, B @ B.T + 1e-3 * np.eye(3), g.normal(size=(1, 3)), np.eye(1)))
    found = stability(LinearSystem.of(("a", "b", "c"), steps), np.eye(3))
    assert (np.diff(found.product_norm_P) <= 1e-12).all()
    assert found.product_norm_P[0] <= 1.0 + 1e-12


def test_growth_is_found_and_named() -> None:
    """A velocity that nobody corrects for long carries the position away; the spectral radius is below 1."""
    Psi = np.array([[0.99, 1.0], [0.0, 0.99]])
    system = LinearSystem.constant(
        ("pos.x", "pos.y"), (Psi, np.eye(2), np.zeros((1, 2)), np.eye(1), np.zeros((2, 1))), 500, 0.25
    )
    found = stability(system, starts=1)
    k = np.arange(1, 501)
    worst = found.worst_growth
    assert worst is not None
    assert worst.states == "pos"
    assert worst.factor == pytest.approx(float((k * 0.99 ** (k - 1)).max()), rel=0.02)  # the other elements add a bit
    assert worst.after_s == pytest.approx(0.25 * 100, abs=0.5)
    assert "does not show" in found.explain()


def test_unobserved_constant_has_no_steady_state() -> None:
    blind = Step(np.diag([1.0, 0.5]), np.diag([0.1, 0.1]), np.array([[0.0, 1.0]]), np.array([1.0]))
    with pytest.raises(ValueError, match="no steady state"):
        dare(blind)
    system = LinearSystem.constant(("a", "b"), (blind.Phi, blind.Q, blind.H, blind.R), 200)
    found = stability(system, np.eye(2))
    assert found.steady is None
    assert found.verdict == found.lemma1 == "stable"
    np.testing.assert_allclose(found.spectral_radius, 1.0, atol=1e-12)
    np.testing.assert_allclose(found.product_norm_P[-1] <= 1.0, True)


def test_gains_or_a_covariance_are_needed() -> None:
    with pytest.raises(ValueError, match="covariance P0"):
        stability(LinearSystem.constant(("a",), (np.eye(1),) * 4, 3))
