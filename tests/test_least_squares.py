"""Least squares on hand-made skies: exactness, cold start, exclusion, systems with one satellite, velocity."""

import numpy as np
import pytest

from skies import RECEIVER, T0, options, satellites, sky
from starwise.constants import (
    EPOCH_NO_SOLUTION,
    EPOCH_OK,
    EPOCH_SUSPECT,
    ROW_EXCLUDED,
    ROW_LOW_ELEVATION,
    ROW_USED,
)
from starwise.estimators.least_squares import chi_square_table, empty_epochs, largest_residual_table
from starwise.frames import geodetic_from_ecef
from starwise.kernels.atmosphere import klobuchar_bds
from starwise.kernels.rangemodel import IONO_BDS, epoch_corrections, geodetic, range_los
from starwise.kernels.spp import SppOptions, spp_run
from starwise.models.pseudorange import empty_row_model

SPP = SppOptions(
    fde=True,
    chi2=chi_square_table(1e-3),
    local=largest_residual_table(1e-3),
    max_gdop=30.0,
    max_sigma_m=25.0,
    max_excluded=0.4,
    tie_sigma_m=0.05,
)


def solve(epochs, rows, spp=SPP, model=None):
    ep = empty_epochs(len(epochs.t_ns), int(rows.clock.max()) + 1)
    out = empty_row_model(len(rows.code_m))
    spp_run(model or options(), spp, epochs, rows, ep, out)
    return ep, out


@pytest.mark.laws
def test_noiseless_rows_give_the_truth_from_a_cold_start():
    velocity = np.array([10.0, -20.0, 5.0])
    systems = np.array([0, 0, 0, 0, 1, 1, 2, 2, 3, 3])
    epochs, rows, truth = sky(10, 3, systems=systems, velocity=velocity, drift_mps=3.0)
    ep, _ = solve(epochs, rows)
    assert (ep.status == EPOCH_OK).all()
    # 1e-6 m: float64 rounding of ranges of 2.5e7 m (4e-9 m) times DOP, and the 1e-4 m convergence step squared.
    np.testing.assert_allclose(ep.pos, truth, atol=1e-6, rtol=0)
    np.testing.assert_allclose(ep.vel, np.tile(velocity, (3, 1)), atol=1e-8, rtol=0)
    np.testing.assert_allclose(ep.drift[:, 0], 3.0, atol=1e-8, rtol=0)
    np.testing.assert_allclose(ep.clock[0], np.linspace(1e4, 2e4, 4), atol=1e-6, rtol=0)


@pytest.mark.laws
def test_unit_vector_is_the_derivative_of_the_range():
    sat = np.array([1.5e7, 1.2e7, 1.8e7])
    _, _, *u = range_los(*RECEIVER, *sat)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 100.0
        up = sum(range_los(*(RECEIVER + step), *sat)[:2])
        down = sum(range_los(*(RECEIVER - step), *sat)[:2])
        # The Jacobian leaves out the derivative of the Sagnac term, omega / c * r = 7e-6.
        assert -u[axis] == pytest.approx((up - down) / 200.0, abs=1e-5)


def test_geodetic_twin():
    rng = np.random.default_rng(3)
    pos = rng.normal(size=(200, 3))
    pos *= rng.uniform(6.35e6, 5e7, 200)[:, None] / np.linalg.norm(pos, axis=1)[:, None]
    for p in pos:
        np.testing.assert_allclose(geodetic(*p)[:2], geodetic_from_ecef(p)[:2], atol=1e-13, rtol=0)
        assert geodetic(*p)[2] == pytest.approx(geodetic_from_ecef(p)[2], abs=1e-6)  # m


@pytest.mark.laws
def test_order_of_satellites_does_not_matter():
    epochs, rows, _ = sky(9, 1, code_sigma=3.0, rate_sigma=0.1)
    order = np.random.default_rng(1).permutation(9)
    shuffled = type(rows)(*(a[order] for a in rows))
    a, b = solve(epochs, rows)[0], solve(epochs, shuffled)[0]
    np.testing.assert_allclose(a.pos, b.pos, atol=1e-6, rtol=0)  # m, summation order


@pytest.mark.parametrize("fault_m", [60.0, 1e3, 1e5, -3e6])
def test_one_faulty_satellite_is_excluded(fault_m):
    epochs, rows, truth = sky(9, 20, code_sigma=1.0)
    bad = np.arange(4, len(rows.code_m), 9)
    rows.code_m[bad] += fault_m
    ep, out = solve(epochs, rows)
    assert (ep.status == EPOCH_OK).all()
    assert (out.status[bad] == ROW_EXCLUDED).all()
    assert np.linalg.norm(ep.pos - truth, axis=1).max() < 15.0  # m: 1 m of noise, PDOP below 4


def test_fault_that_cannot_be_isolated_is_flagged():
    epochs, rows, _ = sky(5, 20, code_sigma=1.0)  # one redundant satellite: detection, no isolation
    rows.code_m[np.arange(2, len(rows.code_m), 5)] += 1e3
    ep, _ = solve(epochs, rows)
    assert (ep.status == EPOCH_SUSPECT).all()


def test_four_satellites_are_solved_but_nothing_checks_them():
    epochs, rows, truth = sky(4, 2)
    ep, _ = solve(epochs, rows)
    np.testing.assert_allclose(ep.pos, truth, atol=1e-5, rtol=0)
    assert (ep.status == EPOCH_SUSPECT).all()
    assert (ep.dof == 0).all()


def test_three_satellites_have_no_solution():
    epochs, rows, _ = sky(3, 2)
    ep, _ = solve(epochs, rows)
    assert (ep.status == EPOCH_NO_SOLUTION).all()
    assert np.isnan(ep.pos).all()


def test_system_with_one_satellite_only_gets_its_clock():
    systems = np.array([0] * 6 + [1])
    epochs, rows, _ = sky(7, 1, systems=systems, code_sigma=2.0)
    with_one = solve(epochs, rows)[0]
    rows.status[6] = 3
    without = solve(epochs, rows)[0]
    np.testing.assert_allclose(with_one.pos, without.pos, atol=1e-5, rtol=0)
    assert np.isfinite(with_one.clock[0, 1])
    assert with_one.dof[0] == without.dof[0]


def test_intersystem_offset_is_held_when_satellites_are_few():
    systems = np.array([0, 0, 0, 0, 0, 1, 1])
    epochs, rows, truth = sky(7, 3, systems=systems)
    rows.status[14 + np.array([0, 1, 2])] = 3  # third epoch: 2 + 2 satellites for 5 unknowns
    ep, _ = solve(epochs, rows)
    np.testing.assert_allclose(ep.pos[2], truth[2], atol=1e-5, rtol=0)
    off = solve(epochs, rows, SPP._replace(tie_sigma_m=0.0))[0]
    assert off.status[2] != EPOCH_NO_SOLUTION or np.isnan(off.pos[2]).all()


def test_normalised_residuals_are_chi_square():
    epochs, rows, truth = sky(12, 2000, code_sigma=1.0, rate_sigma=0.1, step_s=0.1)
    ep, out = solve(epochs, rows, SPP._replace(fde=False))
    mean = ep.nis.mean() / 8.0
    # 2000 x 8 degrees of freedom: sigma of the mean is sqrt(2 / 16000) = 0.011; 5 sigma, false alarm 6e-7.
    assert abs(mean - 1.0) < 0.056
    e = ep.pos - truth
    nees = np.einsum("ni,nij,nj->n", e, np.linalg.inv(ep.cov_pos), e).mean() / 3.0
    assert abs(nees - 1.0) < 5 * np.sqrt(2 / 6000)
    used = out.status == ROW_USED
    # Studentised residuals have unit variance; 24000 rows, correlated within an epoch: 5 sigma of 2000 x 8.
    assert abs((out.v_code[used] ** 2 / out.s_code[used]).mean() - 1.0) < 0.056


def test_one_outlier_below_the_sum_is_found_by_its_own_residual():
    """A residual of 4.7 sigma among 14 exact rows: a sum of 22 passes with 10 degrees of freedom (29.6)."""
    epochs, rows, truth = sky(14, 1, seed=4)
    rows.code_m[3] += 1.0
    _, unit = solve(epochs, rows, SPP._replace(fde=False))
    w = unit.v_code[3] / np.sqrt(unit.s_code[3])
    rows.code_m[3] += 4.7 / w - 1.0
    before, _ = solve(epochs, rows, SPP._replace(local=np.full(2, np.inf)))
    ep, out = solve(epochs, rows)
    assert (before.status, before.n_used) == (EPOCH_OK, 14)
    assert (ep.status, ep.n_used) == (EPOCH_OK, 13)
    assert out.status[3] == ROW_EXCLUDED
    np.testing.assert_allclose(ep.pos, truth, atol=1e-6, rtol=0)  # m: exact rows, rounding
    np.testing.assert_allclose(out.v_code[3], 4.7 / w, atol=1e-5, rtol=0)  # and its residual is that of this solution
    assert out.s_code[3] > 1.0, "a row outside: variances add"


def test_thresholds_of_the_largest_residual():
    table = largest_residual_table(1e-3)
    assert table[1] == pytest.approx(3.2905, abs=1e-4)  # two-sided 1e-3 of the normal distribution
    assert table[10] == pytest.approx(3.8906, abs=1e-4)  # 1e-4


@pytest.mark.parametrize("seed", [101, 203, 577, 581])
def test_exclusion_that_leaves_nothing_keeps_the_solution_before_it(seed):
    """Faults of thousands of kilometres move the position until the mask leaves too few satellites."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(6, 9))
    epochs, rows, _ = sky(n, 1, seed=seed)
    bad = int(rng.integers(1, 4))
    rows.code_m[rng.choice(n, bad, False)] += rng.choice([1e5, 1e6, 1e7, -1e6, -1e7, 3e7], bad)
    ep, out = solve(epochs, rows, model=options(mask_rad=np.radians(5.0)))
    off, _ = solve(epochs, rows, SPP._replace(fde=False), model=options(mask_rad=np.radians(5.0)))
    assert off.status[0] == EPOCH_SUSPECT
    assert ep.status[0] == EPOCH_SUSPECT
    assert np.isfinite(ep.pos).all()
    assert not (out.status == ROW_EXCLUDED).any()


BAD_HZ = 38.0  # m/s: 200 Hz on L1


def test_velocity_of_five_rates_is_tested():
    epochs, rows, _ = sky(5, 1, rate_sigma=0.1)
    good, out = solve(epochs, rows)
    assert np.isfinite(good.vel).all()
    assert (out.rate_used == 1).all()
    rows.rate_mps[2] += BAD_HZ
    ep, out = solve(epochs, rows)
    assert ep.status[0] == EPOCH_OK, "the codes are sound"
    assert np.isnan(ep.vel).all(), "one too many, but not enough to say which"
    assert np.isnan(ep.drift).all()
    assert (out.rate_used == 0).all()
    assert np.isnan(out.v_rate).all()


def test_velocity_of_four_rates_is_ten_times_as_uncertain():
    epochs, rows, _ = sky(5, 1, rate_sigma=0.1)
    five, _ = solve(epochs, rows)
    rows.rate_mps[0] = np.nan
    four, _ = solve(epochs, rows)
    assert np.isfinite(four.vel).all()
    # Without the factor the fifth rate cannot make the variance more than some ten times smaller.
    assert np.trace(four.cov_vel[0]) > 100.0 * np.trace(five.cov_vel[0])


@pytest.mark.parametrize("bad", range(9))
def test_one_bad_rate_is_excluded(bad):
    epochs, rows, _ = sky(9, 1, rate_sigma=0.1)
    rows.rate_mps[bad] += BAD_HZ
    ep, out = solve(epochs, rows)
    np.testing.assert_array_equal(out.rate_used, np.arange(9) != bad)
    assert np.abs(ep.vel).max() < 1.5  # m/s: 0.1 m/s and what a weak geometry makes of it
    assert abs(out.v_rate[bad] - BAD_HZ) < 3.0, "its residual is that of the final solution"


def test_too_many_bad_rates_leave_no_velocity():
    epochs, rows, _ = sky(9, 1, rate_sigma=0.1)
    rows.rate_mps[:] *= -1.0
    ep, out = solve(epochs, rows)
    assert ep.status[0] == EPOCH_OK
    assert np.isnan(ep.vel).all()
    assert (out.rate_used == 0).all()


def test_residual_of_an_excluded_row_is_that_of_the_final_solution():
    epochs, rows, _ = sky(9, 1, code_sigma=1.0)
    rows.code_m[4] += 1e3
    _, out = solve(epochs, rows)
    assert out.status[4] == ROW_EXCLUDED
    assert abs(out.v_code[4] - 1e3) < 15.0  # m; before the exclusion part of it is in the position


def test_rows_refused_after_the_cold_start_keep_their_direction_only():
    epochs, rows, _ = sky(10, 1, code_sigma=1.0)
    _, out = solve(epochs, rows, model=options(mask_rad=np.radians(25.0), troposphere=1))
    low = out.status == ROW_LOW_ELEVATION
    assert 0 < low.sum() < 6
    assert np.isfinite(out.elevation).all()
    for values in (out.geometric, out.sagnac, out.troposphere, out.ionosphere, out.v_code, out.s_code):
        assert np.isnan(values[low]).all()
        assert np.isfinite(values[~low]).all()


def seen(elevation_deg, **changes):
    """Model of satellites in the south at given elevations, from `RECEIVER`."""
    n = len(elevation_deg)
    _, rows, _ = sky(n, 1)
    rows.sat_pos[:] = satellites(np.full(n, 180.0), np.array(elevation_deg))
    rows.system[:] = 3  # BeiDou
    out = empty_row_model(n)
    model = options(mask_rad=np.radians(-5.0), **changes)
    epoch_corrections(model, T0, rows, 0, n, *RECEIVER, True, out)
    return out, rows


@pytest.mark.parametrize("troposphere", [1, 2])
def test_troposphere_does_not_vanish_below_the_horizon(troposphere):
    out, _ = seen([0.01, -0.01, -3.0], troposphere=troposphere)
    assert 60.0 < out.troposphere[0] < 120.0  # m: published delays at the horizon are about 90 m
    assert out.troposphere[1] == pytest.approx(out.troposphere[0], rel=0.02)
    assert out.troposphere[2] == pytest.approx(out.troposphere[1], rel=0.02)


def test_ionosphere_of_beidou_takes_its_own_time():
    coef = np.zeros((7, 8))
    coef[3] = [2e-8, 0.0, 0.0, 0.0, 1e5, 0.0, 0.0, 0.0]
    out, rows = seen([30.0], iono_model=np.full(7, IONO_BDS), iono_coef=coef)
    lat, lon, _ = geodetic(*RECEIVER)
    tow = float(T0 // 1_000_000_000 % 604_800)
    at = [klobuchar_bds(coef[3], lat, lon, out.azimuth[0], out.elevation[0], t) for t in (tow - 14.0, tow)]
    scale = (1561.098e6 / rows.freq_hz[0]) ** 2
    assert out.ionosphere[0] == pytest.approx(at[0] * scale, rel=1e-12)
    assert at[0] != at[1]
