"""Whether the coloured filter knows how wrong it is: in a world that is its model, and when things happen to it."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2

from starwise.config import RunConfig
from starwise.config_errors import ErrorParameters
from starwise.constants import C_LIGHT, EPOCH_COASTED, EPOCH_OK, EPOCH_RESET, EPOCH_SUSPECT
from starwise.kernels.rangemodel import Epochs
from starwise.studies.colored_world import ColoredWorlds, nees

INSIDE = chi2.ppf(0.95, 3)
RUNS = 12


def config(dynamics, **changes):
    return RunConfig(dynamics=dynamics, errors=ErrorParameters(floor_m=0.0), **changes)


@lru_cache(maxsize=4)
def worlds(dynamics, interval_s, duration_s):
    return ColoredWorlds(config(dynamics), interval_s=interval_s, duration_s=duration_s)


def runs(dynamics, change=lambda world: world, interval_s=1.0, duration_s=120.0, count=RUNS):
    """Outputs and normalised errors of several runs with something changed."""
    source = worlds(dynamics, interval_s, duration_s)
    for number in range(count):
        world = change(source.run(number))
        ep = world.solve(config(dynamics))
        yield world, ep, nees(ep, world.pos_e)


def only(world, keep):
    """The rows in ``keep``."""
    counts = np.add.reduceat(np.append(keep, False), world.epochs.offsets[:-1]) * (np.diff(world.epochs.offsets) > 0)
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return replace(
        world, epochs=Epochs(world.epochs.t_ns, offsets), rows=type(world.rows)(*(a[keep] for a in world.rows)),
        extra=type(world.extra)(*(a[keep] for a in world.extra)),
    )  # fmt: skip


def epoch_of(world):
    return np.repeat(np.arange(len(world.epochs.t_ns)), np.diff(world.epochs.offsets))


def sigma(ep):
    return np.sqrt(np.trace(ep.cov_pos, axis1=1, axis2=2))


@pytest.mark.laws
@pytest.mark.parametrize(("dynamics", "interval_s", "duration_s"), [("static", 30.0, 1800.0), ("vehicle", 1.0, 60.0)])
def test_nees_of_a_world_that_is_the_model(dynamics, interval_s, duration_s):
    """Robust weights, adaptation and gate off: what is left must be exact. False alarm 1e-3 in each of five epochs."""
    source = worlds(dynamics, interval_s, duration_s)
    plain = replace(source.config.errors, late_sigma=1e9, early_sigma=1e9, scale_max=1.0)
    exact = replace(source.config, errors=plain, gate_probability=1e-300)
    n = 60
    found = []
    for number in range(n):
        world = source.run(number)
        errors = world.errors._replace(late=1e9, early=1e9, scale_max=1.0)
        found.append(nees(replace(world, errors=errors).solve(exact), world.pos_e))
    last = len(found[0]) - 1
    for e in (0, 2, 10, last // 2, last):
        mean = np.mean([f[e] for f in found])
        low, high = chi2.ppf([0.5e-3, 1.0 - 0.5e-3], 3 * n) / n
        assert low < mean < high, (e, mean)


@pytest.mark.parametrize("dynamics", ["static", "vehicle"])
def test_the_default_filter_is_honest_in_its_own_world(dynamics):
    """With robust weights, gate and adaptation: they cost a little, and promise nothing that is not held."""
    values = np.array([q for _, _, q in runs(dynamics)])
    # 12 runs hardly average: the mean of 36 squares, 1 +- 0.24, at 4 sigma; adaptation may widen.
    assert 0.4 < values.mean() / 3.0 < 1.95
    assert (values < INSIDE).mean() > 0.8


@pytest.mark.parametrize("dynamics", ["static", "vehicle"])
def test_sigma_grows_when_satellites_go(dynamics):
    """Forty seconds of two satellites, ten of none: sigma grows all the while, holds the error, and recovers."""

    def change(world):
        e, first = epoch_of(world), np.unique(world.extra.sv)[:2]
        few = (e >= 60) & (e < 100) & ~np.isin(world.extra.sv, first)
        return only(world, ~few & ~((e >= 100) & (e < 110)))

    inside = []
    for _, ep, q in runs(dynamics, change):
        s = sigma(ep)
        assert (np.diff(s[64:110]) > -1e-3 * s[64:109]).all()
        if dynamics == "vehicle":
            assert s[109] > 5.0 * s[59]  # singer, 1 m/s^2 over ten seconds and more
        assert (ep.status[100:110] == EPOCH_COASTED).all()
        assert (ep.status[113:] == EPOCH_OK).all()
        assert s[-1] < 1.5 * s[59]
        inside.append(q[60:] < INSIDE)
    assert np.mean(inside) > 0.8


@pytest.mark.parametrize("dynamics", ["static", "vehicle"])
def test_a_refused_satellite_returns(dynamics):
    """60 m late for forty seconds: refused, then used again, and the sigma never shrinks by the fault."""

    def change(world):
        e = epoch_of(world)
        bad = (world.extra.sv == world.extra.sv[3]) & (e >= 50) & (e < 90)
        rows = world.rows._replace(code_m=world.rows.code_m + 60.0 * bad)
        return replace(world, rows=rows, extra=world.extra._replace(code2_m=world.extra.code2_m + 60.0 * bad))

    inside, used = [], []
    for (world, ep, q), (_, clean, _) in zip(runs(dynamics, change), runs(dynamics), strict=True):
        assert (sigma(ep)[50:90] >= sigma(clean)[50:90] - 0.05).all()  # m
        assert not (ep.status == EPOCH_RESET).any()
        used.append(ep.n_used[[40, 70, 115]])
        inside.append(q < INSIDE)
        assert len(world.epochs.t_ns) == len(ep.status)
    used = np.mean(used, axis=0)
    assert used[1] < used[0] - 0.9
    assert used[2] > used[1] + 0.9
    assert np.mean(inside) > 0.8


@pytest.mark.parametrize("dynamics", ["static", "vehicle"])
@pytest.mark.parametrize("which", ["all", "galileo"])
def test_a_clock_that_jumps(dynamics, which):
    """1 ms of the receiver, or 1 us of one system: at once or after three epochs all is as before."""
    jump = 1e-3 * C_LIGHT if which == "all" else 1e-6 * C_LIGHT

    def change(world):
        hit = (epoch_of(world) >= 60) & ((world.rows.system == 2) | (which == "all"))
        rows = world.rows._replace(code_m=world.rows.code_m + jump * hit)
        return replace(world, rows=rows, extra=world.extra._replace(code2_m=world.extra.code2_m + jump * hit))

    inside = []
    for world, ep, q in runs(dynamics, change):
        assert (ep.status == EPOCH_RESET).sum() == 0
        assert (ep.status[70:] == EPOCH_OK).all()
        assert (ep.status == EPOCH_SUSPECT).sum() <= 4
        column = 1 if which == "galileo" else 0
        assert abs(ep.clock[70, column] - ep.clock[59, column] - jump - 11 * ep.drift[59, column]) < 30.0  # m
        assert ep.n_used[-1] > 0.7 * (world.epochs.offsets[-1] - world.epochs.offsets[-2])
        inside.append(q[60:] < INSIDE)
    assert np.mean(inside) > 0.8
