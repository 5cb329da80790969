"""The coloured filter on what receivers and files come up with: no crash, no NaN called a solution, no P below 0."""

import numpy as np
import pytest

from skies import options, satellites
from starwise.config import RunConfig
from starwise.constants import C_LIGHT, EPOCH_NO_SOLUTION, EPOCH_OK, OMEGA_E_GPS
from starwise.estimators.filter import filter_rows
from test_colored import CAR, pick, scene

DEFAULT = {"late_sigma": 1.5, "early_sigma": 1.5, "scale_max": 6.0, "floor_m": 0.25}


def solve(errors, epochs, rows, extra, n_clocks=2, **config):
    ep, _ = filter_rows(
        epochs, rows, options(fixed_code_sigma_m=0.0), n_clocks, RunConfig(**config), colored=(errors, extra)
    )
    solved = ep.status != EPOCH_NO_SOLUTION
    assert np.isfinite(ep.pos[ep.status == EPOCH_OK]).all()
    assert np.isfinite(ep.cov_pos[ep.status == EPOCH_OK]).all()
    P = ep.cov_pos[solved & np.isfinite(ep.cov_pos).all(axis=(1, 2))]
    if len(P):
        # Relative to the largest: float64 leaves 1e-16 of a start of 1000 m.
        least, most = np.linalg.eigvalsh(P)[:, [0, 2]].T
        assert (least > -1e-12 * most).all()
    assert not (ep.clock_var < 0.0).any()
    return ep


def error(ep, truth):
    """Largest error of the epochs that are good, m."""
    good = ep.status == EPOCH_OK
    return np.linalg.norm((ep.pos - truth)[good], axis=1).max(initial=0.0)


def path(sat, pos):
    """Range and Sagnac term, m."""
    return np.linalg.norm(sat - pos, axis=1) + OMEGA_E_GPS / C_LIGHT * (sat[:, 0] * pos[1] - sat[:, 1] * pos[0])


def motion(dynamics):
    return CAR if dynamics == "vehicle" else None


def change_cn0(value):
    def change(rows, extra, _):
        rows.cn0_dbhz[:] = value
        extra.cn02_dbhz[:] = value

    return change


def change_second(value):
    def change(_, extra, __):
        extra.code2_m[:] = value

    return change


def wrong_codes(rows, extra, rng):
    rows.code_m[rng.choice(len(rows.code_m), 60, replace=False)] += 1e7
    extra.code2_m[rng.choice(len(rows.code_m), 60, replace=False)] -= 1e7


def no_carrier(_, extra, __):
    extra.freq2_hz[:] = np.nan


@pytest.mark.parametrize("dynamics", ["static", "vehicle"])
@pytest.mark.parametrize(
    ("change", "good_m"),
    [
        (change_cn0(np.nan), 15.0),
        (change_cn0(0.0), np.inf),
        (change_cn0(99.0), 15.0),
        (change_second(np.nan), 25.0),
        (change_second(1e7), 25.0),
        (no_carrier, 25.0),
        (wrong_codes, 25.0),
    ],
)
def test_odd_values(dynamics, change, good_m):
    errors, epochs, rows, extra, truth = scene(velocity=motion(dynamics), **DEFAULT)
    change(rows, extra, np.random.default_rng(1))
    ep = solve(errors, epochs, rows, extra, dynamics=dynamics)
    assert error(ep, truth) < good_m


@pytest.mark.parametrize("dynamics", ["static", "vehicle"])
def test_one_satellite(dynamics):
    errors, epochs, rows, extra, _ = scene(velocity=motion(dynamics), **DEFAULT)
    sat, epoch = np.tile(np.arange(13), 40), np.repeat(np.arange(40), 13)
    ep = solve(errors, *pick(epochs, rows, extra, sat == 0), dynamics=dynamics)
    assert (ep.status == EPOCH_NO_SOLUTION).all()
    ep = solve(errors, *pick(epochs, rows, extra, (sat == 0) | (epoch < 10)), dynamics=dynamics)
    # One range tells next to nothing of a place at rest, and nothing of one that moves.
    assert ep.cov_pos[-1, 0, 0] > (2.0 if dynamics == "vehicle" else 0.9) * ep.cov_pos[9, 0, 0]


@pytest.mark.parametrize("dynamics", ["static", "vehicle"])
@pytest.mark.parametrize("gap_s", [3600, 86_400, 100 * 86_400, 3000 * 86_400])
def test_huge_gaps(dynamics, gap_s):
    errors, epochs, rows, extra, truth = scene(velocity=motion(dynamics), **DEFAULT)
    epochs.t_ns[20:] += gap_s * 1_000_000_000
    # The clock goes on: 15 m/s, for a day at most (what a receiver's resets would leave).
    step = 15.0 * min(gap_s, 86_400)
    late = np.repeat(np.arange(40), 13) >= 20
    rows.code_m[late] += step
    extra.code2_m[late] += step
    ep = solve(errors, epochs, rows, extra, dynamics=dynamics)
    assert error(ep, truth) < 25.0
    assert (ep.status[-5:] == EPOCH_OK).all()


@pytest.mark.parametrize("dynamics", ["static", "vehicle"])
@pytest.mark.parametrize("back", [19, 5])
def test_times_that_repeat_or_run_back(dynamics, back):
    """Readers sort epochs and keep one of each time; rows made by others need not: nothing shrinks by it."""
    errors, epochs, rows, extra, truth = scene(velocity=motion(dynamics), **DEFAULT)
    epochs.t_ns[20] = epochs.t_ns[back]
    ep = solve(errors, epochs, rows, extra, dynamics=dynamics)
    assert error(ep, truth) < 25.0


def test_a_hundred_satellites():
    systems = np.array([0] * 32 + [2] * 30 + [3] * 40)
    errors, epochs, rows, extra, truth = scene(systems=systems, n_epochs=10, **DEFAULT)
    ep = solve(errors, epochs, rows, extra, 3, dynamics="static")
    assert (ep.status == EPOCH_OK).all()
    assert error(ep, truth) < 8.0
    few = np.tile(np.arange(102) < 60, 10)
    solve(errors, *pick(epochs, rows, extra, few ^ (np.repeat(np.arange(10), 102) % 2 == 0)), 3, dynamics="static")


@pytest.mark.parametrize("dynamics", ["vehicle", "aircraft", "static"])
def test_eight_kilometres_per_second(dynamics):
    errors, epochs, rows, extra, truth = scene(velocity=np.array([5000.0, -5000.0, 3700.0]), **DEFAULT)
    ep = solve(errors, epochs, rows, extra, dynamics=dynamics)
    assert error(ep, truth) < 25.0  # a static filter is not good, and says so


@pytest.mark.parametrize("dynamics", ["static", "vehicle"])
def test_satellites_at_the_zenith_and_below_the_horizon(dynamics):
    errors, epochs, rows, extra, truth = scene(velocity=motion(dynamics), n_epochs=20, **DEFAULT)
    elevation = np.array([90.0, 0.0, -4.9, 1e-9, 89.999999, 30.0, 45.0, 60.0, 20.0, 35.0, 50.0, 15.0, 70.0])
    there = satellites(np.linspace(0.0, 330.0, 13), elevation)
    for e in range(20):
        at = slice(13 * e, 13 * e + 13)
        change = path(there, truth[e]) - path(rows.sat_pos[at], truth[e])
        rows.code_m[at] += change
        extra.code2_m[at] += change
        rows.sat_pos[at], rows.sat_vel[at] = there, 0.0
    rows.rate_mps[:] = np.nan
    ep = solve(errors, epochs, rows, extra, dynamics=dynamics, mask_deg=-5.0)
    assert ep.n_used.max() > 11
    assert error(ep, truth) < 25.0
    assert (ep.status == EPOCH_OK).sum() > 10
