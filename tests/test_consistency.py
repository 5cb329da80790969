"""Statistics of innovations: published values, acceptance under the hypothesis, and what they cannot see."""

import numpy as np
import pytest

from starwise.analysis.consistency import (
    autocorrelation,
    coverage,
    delay_check,
    judge_autocorrelation,
    known_fault,
    lag_p_value,
    nis_region,
    nis_test,
    pass_region,
    whitened,
    whiteness_bound,
    whiteness_test,
)

PAPER = (-0.4054, -0.0259, -0.0411, -0.0881, 0.1637, -0.1903, 0.0842, 0.1781)


@pytest.mark.golden
def test_the_papers_autocorrelations_are_not_white() -> None:
    # the paper says that all eight lie inside +-0.2772; rho(1) does not, whichever bound is taken
    assert round(1.96 / 50**0.5, 4) == 0.2772
    for m in (1, 2):
        test = judge_autocorrelation(PAPER, K=50, m=m)
        assert test.outside == (1,)
        assert not test.passed
        assert test.bound < 0.4054
    assert lag_p_value(-0.4054, 50) == pytest.approx(0.003, abs=0.0005)  # both sides; 0.15 % on one
    assert lag_p_value(-0.4054, 50, m=2) < 1e-4


@pytest.mark.golden
def test_region_of_the_average_nis() -> None:
    # chi-square with 100 degrees of freedom: 74.22 and 129.56 (Abramowitz & Stegun table 26.8)
    low, high = nis_region(100)
    assert low == pytest.approx(0.7422, abs=1e-4)
    assert high == pytest.approx(1.2956, abs=1e-4)


@pytest.mark.laws
@pytest.mark.parametrize("m", [1, 2, 3])
def test_a_correct_filter_passes_as_often_as_it_should(m: int) -> None:
    rng = np.random.default_rng(5)
    runs, K, lags = 4000, 50, 8
    A = rng.standard_normal((m, m)) + 2.0 * np.eye(m)
    S = np.broadcast_to(A @ A.T, (K + lags, m, m))
    passed = np.zeros((runs, 3), dtype=bool)
    for k in range(runs):
        u = rng.standard_normal((K + lags, m))
        v = u @ A.T
        passed[k, 0] = nis_test((u * u).sum(axis=1), m).passed
        passed[k, 1] = whiteness_test(v, S, lags).passed
        passed[k, 2] = abs(autocorrelation(u, 1)[0]) <= whiteness_bound(K + lags - 1, m)
    low, high = pass_region(runs, 0.95, 0.9999)
    assert low <= passed[:, 0].mean() <= high
    # lags of one series are not quite independent: up to 1 % more pass than 95 % (seen: 95.3 to 95.8 %)
    assert low <= passed[:, 1].mean() <= high + 0.01
    assert low <= passed[:, 2].mean() <= high


@pytest.mark.laws
def test_coloured_and_wrongly_scaled_innovations_fail() -> None:
    rng = np.random.default_rng(6)
    white = rng.standard_normal((158, 2))
    coloured = white.copy()
    for k in range(1, len(coloured)):
        coloured[k] += 0.6 * coloured[k - 1]
    assert not whiteness_test(coloured, lags=8).passed
    assert whiteness_test(white, lags=8).passed
    difference = np.diff(rng.standard_normal((151, 1)), axis=0)
    assert whiteness_test(difference, lags=8).rho[0] == pytest.approx(-0.5, abs=0.3)  # 5 sigma of 0.06
    assert not nis_test((white**2).sum(axis=1) * 2.0, 2).passed
    assert not nis_test((white**2).sum(axis=1) * 0.5, 2).passed


@pytest.mark.laws
def test_whitening_removes_the_covariance() -> None:
    rng = np.random.default_rng(7)
    S = np.array([[4.0, 1.5], [1.5, 1.0]])
    v = rng.multivariate_normal([0.0, 0.0], S, size=20_000)
    u = whitened(v, np.broadcast_to(S, (len(v), 2, 2)))
    np.testing.assert_allclose(u.T @ u / len(u), np.eye(2), atol=0.05)  # 5 sigma of 20 000 samples
    assert coverage(v, np.broadcast_to(S, (len(v), 2, 2))) == pytest.approx(0.95, abs=0.008)  # 5 sigma


@pytest.mark.laws
def test_a_known_fault_is_estimated_without_bias_and_with_its_sigma() -> None:
    rng = np.random.default_rng(8)
    n, runs = 40, 3000
    S = np.broadcast_to(np.array([[4.0, 1.0], [1.0, 2.0]]), (n, 2, 2))
    g = rng.standard_normal((n, 2))
    L = np.linalg.cholesky(S[0])
    found = [known_fault(0.7 * g + rng.standard_normal((n, 2)) @ L.T, S, g) for _ in range(runs)]
    sizes, sigma = np.array([f.size for f in found]), found[0].sigma
    assert abs(sizes.mean() - 0.7) < 5.0 * sigma / runs**0.5
    assert sizes.std() == pytest.approx(sigma, rel=0.07)  # 5 sigma of a deviation from 3000 runs
    clean = [known_fault(rng.standard_normal((n, 2)) @ L.T, S, g).p_value for _ in range(runs)]
    assert np.mean(np.array(clean) < 0.05) == pytest.approx(0.05, abs=0.02)  # 5 sigma


def test_a_delay_that_cannot_be_seen_is_not_confirmed() -> None:
    rng = np.random.default_rng(9)
    v, S = rng.standard_normal((50, 2)), np.broadcast_to(np.eye(2), (50, 2, 2))
    straight = np.zeros((50, 2))
    check = delay_check(v, S, straight, [100.0, 0.0], claimed_m=5.0, plausible_s=1.0)
    assert (check.verdict, check.hidden_m) == ("unverifiable", 100.0)
    assert delay_check(v, S, straight, [0.0, 0.0], claimed_m=5.0, plausible_s=1.0).verdict == "confirmed"  # at rest
    turning = 30.0 * rng.standard_normal((50, 2))
    assert delay_check(v, S, turning, [60.0, 0.0], claimed_m=5.0, plausible_s=1.0).verdict == "confirmed"
    assert delay_check(v + 1.5 * turning, S, turning, [60.0, 0.0], claimed_m=5.0, plausible_s=1.0).verdict == "wrong"


def test_too_short_series_are_refused() -> None:
    with pytest.raises(ValueError, match="too few"):
        autocorrelation(np.zeros(10), 8, K=50)
    assert not nis_test([], 2).passed
