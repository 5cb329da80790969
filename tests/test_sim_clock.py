"""Receiver clock: its Allan variance is what its parameters say; steering; independence of the sampling."""

import numpy as np
import pytest

from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.sim.clock import GRADES, STEER_LIMIT_S, ReceiverClock
from starwise.sim.sections import Clock
from starwise.sim.seeds import streams

T0_NS = 1_400_000_000 * NS


def times(n: int, step_s: float) -> np.ndarray:
    return T0_NS + (np.arange(n) * round(step_s * NS)).astype(np.int64)


def allan_variance(x: np.ndarray, m: int, step_s: float) -> float:
    """Overlapping Allan variance of phases x, s, at m steps (NIST SP 1065, eq. 11)."""
    second = x[2 * m :] - 2.0 * x[m:-m] + x[: -2 * m]
    return float(np.mean(second**2) / (2.0 * (m * step_s) ** 2))


@pytest.mark.laws
@pytest.mark.parametrize("grade", [grade for grade in GRADES if grade != "perfect"])
@pytest.mark.parametrize("m", [1, 10, 100])
def test_allan_variance_of_samples(grade: str, m: int) -> None:
    clock = ReceiverClock.of(Clock(grade=grade))  # type: ignore[arg-type]
    found = np.mean(
        [
            allan_variance(clock.sample(times(20_000, 1.0), streams(5, k)("clock")).oscillator_s, m, 1.0)
            for k in range(8)
        ]
    )
    # 8 x 20000 / m / 2 independent pairs at least: 4 standard deviations of a chi-square mean
    assert found == pytest.approx(clock.allan_variance(float(m)), rel=4.0 * np.sqrt(2.0 / (8 * 20_000 / m / 2)))


@pytest.mark.laws
def test_covariance_does_not_depend_on_the_sampling() -> None:
    clock = ReceiverClock(2e-19, 2e-20, bias_s=1e-4, drift=1e-7)
    ends = []
    uneven = T0_NS + (np.array([0.0, 0.1, 2.0, 2.5, 10.0]) * NS).astype(np.int64)
    for t in (uneven, times(2, 10.0)):
        runs = [clock.sample(t, streams(9, k)("clock")) for k in range(4000)]
        ends.append(np.array([(r.bias_s[-1] - 1.01e-4, r.drift[-1] - 1e-7) for r in runs]))
    q1, q2, dt = 1e-19, 2.0 * np.pi**2 * 2e-20, 10.0
    wanted = np.array([[q1 * dt + q2 * dt**3 / 3.0, q2 * dt**2 / 2.0], [q2 * dt**2 / 2.0, q2 * dt]])
    for end in ends:
        np.testing.assert_allclose(np.cov(end.T), wanted, rtol=0.1)  # 4 sigma of 4000 samples: 9 %
        np.testing.assert_allclose(end.mean(axis=0) / np.sqrt(np.diag(wanted)), 0.0, atol=4.0 / np.sqrt(4000))


def test_drift_is_the_rate_of_the_bias() -> None:
    states = ReceiverClock.of(Clock(grade="ocxo", bias_s=1e-5, drift=2e-8)).sample(
        times(1000, 1.0), streams(1)("clock")
    )
    rate = np.diff(states.bias_s)
    middle = 0.5 * (states.drift[1:] + states.drift[:-1])
    # white frequency noise of h0 = 2e-25 over 1 s, and a tenth of a step of the random walk
    np.testing.assert_allclose(rate, middle, atol=6.0 * np.sqrt(1e-25 + 2.0 * np.pi**2 * 6e-25 / 12.0))


def test_perfect_clock_goes_as_it_was_set() -> None:
    states = ReceiverClock.of(Clock(grade="perfect", bias_s=1e-3, drift=1e-6)).sample(
        times(100, 1.0), streams(1)("clock")
    )
    np.testing.assert_allclose(states.bias_s, 1e-3 + 1e-6 * np.arange(100), atol=1e-17)
    np.testing.assert_array_equal(states.drift, 1e-6)


def test_steered_by_whole_milliseconds() -> None:
    clock = ReceiverClock.of(Clock(grade="tcxo", drift=-3e-7, bias_s=0.0102, reset="millisecond"))
    states = clock.sample(times(20_000, 1.0), streams(3)("clock"))
    assert np.abs(states.bias_s).max() <= STEER_LIMIT_S
    steps = np.diff(states.steered_s)
    np.testing.assert_allclose(steps[steps != 0.0], 1e-3, atol=1e-15)
    assert states.steered_s[0] == pytest.approx(-0.010, abs=1e-15)
    free = ReceiverClock.of(Clock(grade="tcxo", drift=-3e-7, bias_s=0.0102)).sample(
        times(20_000, 1.0), streams(3)("clock")
    )
    np.testing.assert_allclose(states.oscillator_s, free.bias_s, atol=1e-15)
    np.testing.assert_array_equal(states.drift, free.drift)


def test_parameters_given_win_over_the_grade() -> None:
    clock = ReceiverClock.of(Clock(grade="rubidium", h0_s=1e-20))
    assert (clock.h0_s, clock.hm2_per_s) == (1e-20, GRADES["rubidium"][1])


def test_times_must_increase() -> None:
    with pytest.raises(StarwiseError, match="clock times do not increase"):
        ReceiverClock(0.0, 0.0).sample(np.array([2, 1], dtype=np.int64), streams(1)("clock"))
