"""The coloured filter against a dense one on named states, and its covariance over long runs."""

import numpy as np
import pytest

from colored_twin import Twin
from skies import RECEIVER, options, sky
from starwise.config import RunConfig
from starwise.config_errors import ErrorParameters
from starwise.constants import EPOCH_OK
from starwise.estimators.filter import filter_options, filter_rows
from starwise.kernels.colored import update_colored
from starwise.kernels.error_states import ErrorRows, Slots, enter_satellites, n_errors, predict_errors, reset_errors
from starwise.kernels.filter_epoch import arrange
from starwise.kernels.filter_state import Work
from starwise.kernels.process import motion as motion_of
from starwise.kernels.process import noise_shape, predict
from starwise.kernels.rangemodel import epoch_corrections
from starwise.models.error_model import error_model
from starwise.models.process import clocks_from, motion_from, process_numbers
from starwise.models.pseudorange import empty_row_model
from starwise.sim.range_errors import draw_range_errors

L2 = 1227.60e6
GPS_GALILEO = np.array([0] * 7 + [2] * 6)
CAR = np.array([8.0, -6.0, 3.0])
PLAIN = {"late_sigma": 1e9, "early_sigma": 1e9, "scale_max": 1.0, "floor_m": 0.0}
"""Robust weights and adaptation off: what is left is linear."""


def extra_rows(rows, n_sat, n_epochs, dual=True, slow=0.8):
    """Rows of the coloured model: satellites 1.. of their system, a receiver bias on every second signal."""
    n = len(rows.code_m)
    none = np.full(n, np.nan)
    sv = rows.system * 256 + 1 + np.tile(np.arange(n_sat), n_epochs)
    return ErrorRows(
        sv=sv, slow_m=np.full(n, slow) * np.where(rows.system == 2, 0.5, 1.0),
        bias1=np.full(n, -1, np.int64), bias2=np.where(rows.system == 2, 1, 0).astype(np.int64),
        code2_m=rows.code_m.copy() if dual else none.copy(), clock2_m=np.zeros(n),
        freq2_hz=np.full(n, L2) if dual else none.copy(),
        cn02_dbhz=np.full(n, 40.0) if dual else none.copy(), v2=none.copy(), s2=none.copy(), used=np.zeros(n, np.uint8),
    )  # fmt: skip


def pick(epochs, rows, extra, keep):
    """Only the rows in ``keep``."""
    counts = np.array([keep[a:b].sum() for a, b in zip(epochs.offsets[:-1], epochs.offsets[1:], strict=True)])
    return (
        epochs._replace(offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)),
        type(rows)(*(a[keep] for a in rows)),
        type(extra)(*(a[keep] for a in extra)),
    )


def with_errors(errors, epochs, rows, extra, truth, velocity, seed=0):
    """The exact rows with errors drawn from the model."""
    out = empty_row_model(len(rows.code_m))
    for e, t in enumerate(epochs.t_ns):
        epoch_corrections(options(), t, rows, epochs.offsets[e], epochs.offsets[e + 1], *truth[e], True, out)
    speed = np.full(len(epochs.t_ns), np.linalg.norm(velocity))
    e1, e2 = draw_range_errors(errors, epochs, rows, extra, out, speed, np.random.default_rng(seed))
    return rows._replace(code_m=rows.code_m + e1), extra._replace(code2_m=extra.code2_m + e2)


def scene(*, step_s=1.0, n_epochs=40, dual=True, velocity=None, seed=0, systems=GPS_GALILEO, **parameters):
    """Sky, rows and model."""
    velocity = np.zeros(3) if velocity is None else velocity
    epochs, rows, truth = sky(
        len(systems), n_epochs, seed=seed, systems=systems, velocity=velocity, step_s=step_s, drift_mps=15.0,
        rate_sigma=0.1,
    )  # fmt: skip
    rows.cn0_dbhz[:] = np.tile(np.linspace(38.0, 48.0, len(systems)), n_epochs)
    extra = extra_rows(rows, len(systems), n_epochs, dual)
    errors = error_model(ErrorParameters(**{**PLAIN, **parameters}), dual, 2, step_s)
    rows, extra = with_errors(errors, epochs, rows, extra, truth, velocity, seed + 1)
    return errors, epochs, rows, extra, truth


def belief(config, velocity, n_clocks):
    """A start, wrong by what its covariance allows."""
    motion = motion_from(config)
    x = np.zeros(motion.nk + 2 * n_clocks)
    P = np.diag([9.0] * 3 + [1.0] * (motion.nk - 3) + [100.0] * n_clocks + [4.0] * n_clocks)
    x[:3] = RECEIVER + np.array([2.0, -1.0, 3.0])
    if motion.nk > 3:
        x[3:6] = velocity
    x[motion.nk : motion.nk + n_clocks] = np.linspace(1e4, 2e4, n_clocks) if n_clocks > 1 else 1e4
    x[motion.nk + n_clocks :] = 15.0
    return x, P


def compare(errors, epochs, rows, extra, config, velocity=None, n_clocks=2):
    """Run both; returns the kernel's outputs and the twin."""
    return compare_from(errors, epochs, rows, extra, config, belief(config, velocity, n_clocks), n_clocks)


def compare_from(errors, epochs, rows, extra, config, start, n_clocks=2):
    """The same from a given start."""
    ep, _ = filter_rows(epochs, rows, options(), n_clocks, config, start, colored=(errors, extra))
    numbers = filter_options(config, motion_from(config), clocks_from(config))
    twin = Twin(errors, motion_from(config), clocks_from(config), 0.1, config.method != "ekf")
    twin.start(int(epochs.t_ns[0]), *start, n_clocks)
    pos, cov, clocks, nis = twin.run(
        epochs, rows, extra,
        {"absent": numbers.absent_s, "intersystem": numbers.intersystem_sigma0,
         "intersystem_drift": numbers.intersystem_drift_sigma0},
    )  # fmt: skip
    # m: ranges of 2.5e7 m in float64 carry 4e-9 m, the gain of a wide start multiplies it
    np.testing.assert_allclose(ep.pos, pos, atol=1e-7, rtol=0)
    np.testing.assert_allclose(ep.cov_pos, cov, atol=1e-7, rtol=1e-8)
    for e, found in enumerate(clocks):
        for k, (x, var) in found.items():
            assert abs(ep.clock[e, k] - x) < 1e-7, (e, k)
            assert abs(ep.clock_var[e, k] - var) < 1e-7 + 1e-8 * var, (e, k)
        assert np.isfinite(ep.clock[e]).sum() == len(found)
    np.testing.assert_allclose(ep.nis, nis, rtol=1e-6, atol=1e-6)
    return ep, twin


def configuration(dynamics, method="s3ekf", **changes):
    return RunConfig(dynamics=dynamics, method=method, gate_probability=1e-300, **changes)


@pytest.mark.laws
@pytest.mark.parametrize("method", ["s3ekf", "ekf"])
@pytest.mark.parametrize("dynamics", ["static", "vehicle"])
@pytest.mark.parametrize("step_s", [1.0, 30.0])
def test_the_kernel_is_a_dense_filter_on_named_states(method, dynamics, step_s):
    velocity = CAR if dynamics == "vehicle" else None
    errors, epochs, rows, extra, _ = scene(step_s=step_s, velocity=velocity)
    assert errors.multipath == (step_s == 1.0)
    ep, twin = compare(errors, epochs, rows, extra, configuration(dynamics, method), velocity)
    assert len(twin.state.layout) > 60
    assert (ep.status == EPOCH_OK).all()


@pytest.mark.laws
@pytest.mark.parametrize("method", ["s3ekf", "ekf"])
def test_it_is_with_one_frequency_and_with_gaps_in_codes_and_rates(method):
    errors, epochs, rows, extra, _ = scene(dual=False)
    compare(errors, epochs, rows, extra, configuration("static", method))
    errors, epochs, rows, extra, _ = scene(velocity=CAR, seed=5)
    rng = np.random.default_rng(5)
    n = len(rows.code_m)
    extra.code2_m[rng.choice(n, n // 3, replace=False)] = np.nan
    rows.rate_mps[rng.choice(n, n // 4, replace=False)] = np.nan
    compare(errors, epochs, rows, extra, configuration("vehicle", method), CAR)


@pytest.mark.laws
@pytest.mark.parametrize("step_s", [1.0, 30.0])
def test_satellites_that_come_leave_and_return(step_s):
    """Some return before they are forgotten, some after: with what was known of them, and as new ones."""
    errors, epochs, rows, extra, _ = scene(step_s=step_s, n_epochs=60, absent_s=12.0 * step_s)
    epoch, sat = np.repeat(np.arange(60), 13), np.tile(np.arange(13), 60)
    keep = np.ones(len(sat), bool)
    for k, (a, b) in {0: (5, 30), 1: (10, 18), 3: (0, 20), 5: (25, 40), 8: (20, 31), 12: (0, 60), 11: (40, 60)}.items():
        keep[(sat == k) & (epoch >= a) & (epoch < b)] = False
    keep[(epoch > 44) & (epoch < 48)] = False  # an outage of all
    ep, twin = compare(errors, *pick(epochs, rows, extra, keep), configuration("static"))
    assert ep.n_used.max() == 11
    assert f"slow.{extra.sv[11]}" not in twin.state.layout


@pytest.mark.laws
def test_a_clock_system_that_vanishes_and_returns():
    """For less than an hour and for more: its clock is kept, then forgotten; two satellites start it by the state."""
    systems = np.array([0] * 7 + [2] * 2)
    errors, epochs, rows, extra, _ = scene(step_s=30.0, n_epochs=240, systems=systems)
    # Ordinary inter-system offset, so that the wide prior of a new clock holds it.
    rows.code_m[rows.system == 2] -= 1e4 - 40.0
    extra.code2_m[rows.system == 2] -= 1e4 - 40.0
    epoch = np.repeat(np.arange(240), 9)
    gone = (epoch < 10) | ((epoch >= 20) & (epoch < 60)) | ((epoch >= 80) & (epoch < 215))
    keep = ~((rows.system == 2) & gone)
    start = belief(configuration("static"), np.zeros(3), 2)
    start[0][4] = 1e4 + 40.0
    args = pick(epochs, rows, extra, keep)
    config = configuration("static")
    ep, _ = filter_rows(args[0], args[1], options(), 2, config, start, colored=(errors, args[2]))
    known = np.isfinite(ep.clock[:, 1])
    assert known[70]
    assert known[190]
    assert not known[210]
    assert known[230]
    compare_from(errors, *args, config, start)


@pytest.mark.laws
def test_a_common_error_of_the_sky_is_no_step_of_the_clock():
    """Sixty metres at the zenith: the states of the ionosphere take it, and no clock is thought to have jumped."""
    errors, epochs, rows, extra, _ = scene(n_epochs=25, seed=3, vertical_floor_m=60.0, receiver_bias_m=1.0)
    compare(errors, epochs, rows, extra, configuration("static"))


def work_space(m, size):
    ints, pairs = np.zeros((3, m), np.int64), np.zeros((4, m, 2))
    los, vectors = np.zeros((2, m, 3)), np.zeros((3, size))
    return Work(*ints, *los, *pairs, np.zeros(m, np.uint8), *vectors, np.zeros(m), np.zeros(1000))


def whole(P, n):
    """P from its upper triangle, which is what counts."""
    U = np.triu(P[:n, :n])
    return U + np.triu(U, 1).T


@pytest.mark.laws
@pytest.mark.parametrize("dynamics", ["static", "vehicle"])
def test_the_covariance_stays_positive_definite(dynamics):
    """An hour at 1 Hz from a start of 1000 m, satellites in and out: correlations keep a positive least eigenvalue."""
    config = configuration(dynamics)
    errors, epochs, rows, extra, truth = scene(n_epochs=40, velocity=CAR if dynamics == "vehicle" else None)
    motion, clocks = motion_from(config), clocks_from(config)
    process, numbers = process_numbers(motion, clocks), filter_options(config, motion, clocks)
    nk, nc, size = motion.nk, 2, 200
    x, P, x1, phi = np.zeros(size), np.zeros((size, size)), np.zeros(size), np.ones(size)
    x0, P0 = belief(config, CAR, nc)
    base = nk + 2 * nc
    x[:base], P[:base, :base] = x0, P0 * 1e5
    slots = Slots(
        np.full(7 * 256, -1), np.zeros(64, np.int64), np.zeros(64, np.int64), np.zeros(1, np.int64), np.ones(1)
    )
    reset_errors(errors, slots, x, P, base)
    F, G, M = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    out, at, work = empty_row_model(len(rows.code_m)), np.arange(nc), work_space(64, size)
    rng = np.random.default_rng(1)
    worst = 1.0
    for e in range(3600):
        k = e % 40  # the same forty seconds of sky over and over
        a, b, t = int(epochs.offsets[k]), int(epochs.offsets[k + 1]), int(epochs.t_ns[0]) + e * 1_000_000_000
        x[:3] = truth[k] if dynamics == "vehicle" and k == 0 else x[:3]
        if e > 0:
            motion_of(process.kind, 1.0, process.tau_s, F, G)
            noise_shape(process, x[0], x[1], x[2], M)
            predict(x, P, nk, nc, 1.0, process, F, G, M)
            predict_errors(errors, slots, x, P, nk, nc, 1.0, F, phi)
        epoch_corrections(options(), t, rows, a, b, x[0], x[1], x[2], True, out)
        out.status[a:b][rng.random(b - a) < (0.9 if (e // 200) % 3 == 1 else 0.05)] = 3
        m = arrange(rows, out, a, b, work)
        enter_satellites(errors._replace(absent_s=8.0), extra, work.order, m, t, slots, x, P, base)
        update_colored(numbers, errors, rows, extra, out, m, x, P, nk, nc, at, slots, 1.0, x1, work)
        n = base + n_errors(errors, slots)
        assert np.isfinite(x[:n]).all()
        if e % 50 == 0 or e < 5:
            Q = whole(P, n)
            sigma = np.sqrt(np.diag(Q))
            worst = min(worst, np.linalg.eigvalsh(Q / np.outer(sigma, sigma))[0])
            assert (np.diag(Q)[base:] <= 1.0 + 1e-9).all()  # never less known than before anything was measured
            np.testing.assert_array_equal(P[:base, :base], P[:base, :base].T)
    assert worst > 1e-12
