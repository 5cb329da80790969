"""A filter that is lost starts anew: bursts of its state, up to places from which no satellite is in view."""

from pathlib import Path

import numpy as np
import pytest

import starwise.demo
from starwise.config import RunConfig
from starwise.constants import EPOCH_RESET
from starwise.estimators.filter import filter_rows
from starwise.estimators.run import solve_run
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import read_obs
from starwise.kernels.error_states import ErrorModel, Slots
from starwise.kernels.filter_alarm import are_strained, contradicted
from starwise.kernels.rangemodel import Epochs
from starwise.kernels.spp import EpochOut
from starwise.models.error_model import no_errors
from starwise.models.process import motion_from
from starwise.models.pseudorange import Prepared, prepare
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.sim.run import simulate
from starwise.sim.scenario import load_scenario

DEMO = Path(starwise.demo.__file__).parent / "data"


def prepared(obs: Path, nav: Path, config: RunConfig) -> Prepared:
    records = read_nav(nav)
    return prepare(read_obs(obs), BroadcastEphemeris(records), records.ionosphere, config)


def filtered(p: Prepared, config: RunConfig, first: int, last: int, start: tuple[np.ndarray, np.ndarray] | None = None):
    epochs = Epochs(p.epochs.t_ns[first:last], p.epochs.offsets[first : last + 1])
    colored = (p.errors, p.error_rows) if p.errors.on else None
    return filter_rows(epochs, p.rows, p.options, len(p.clock_names), config, start, colored=colored)[0]


def spoilt(
    calm: EpochOut, config: RunConfig, e: int, position: float, velocity: float
) -> tuple[np.ndarray, np.ndarray]:
    """State of an epoch with the sigmas that it had, and an error along a fixed direction."""
    motion, nc = motion_from(config), calm.clock.shape[1]
    n = motion.nk + 2 * nc
    x, P = np.zeros(n), np.zeros((n, n))
    u = np.array([0.6, -0.64, 0.48])
    x[:3], P[:3, :3] = calm.pos[e] + position * u, calm.cov_pos[e]
    if motion.nk > 3:
        x[3:6], P[3:6, 3:6] = calm.vel[e] + velocity * u, calm.cov_vel[e]
        P[6:9, 6:9] = motion.acceleration_sigma0**2 * np.eye(3)
    x[motion.nk : motion.nk + nc], x[motion.nk + nc :] = calm.clock[e], calm.drift[e]
    P[range(motion.nk, motion.nk + nc), range(motion.nk, motion.nk + nc)] = calm.clock_var[e]
    P[range(motion.nk + nc, n), range(motion.nk + nc, n)] = 1.0
    return x, P


def epochs_to_recover(p: Prepared, config: RunConfig, calm: EpochOut, e: int, position: float, velocity: float) -> int:
    hit = filtered(p, config, e + 1, len(calm.pos), spoilt(calm, config, e, position, velocity))
    off = np.linalg.norm(hit.pos - calm.pos[e + 1 :], axis=1)
    sigma = np.sqrt(np.trace(calm.cov_pos[e + 1 :], axis1=1, axis2=2))
    bad = np.flatnonzero(~(off < 6.0 * sigma))
    return int(bad[-1]) + 1 if len(bad) else 0


@pytest.mark.parametrize("model", ["colored", "white"])
def test_bursts_of_a_drive(model: str) -> None:
    config = RunConfig(dynamics="vehicle", error_model=model)  # type: ignore[arg-type]
    p = prepared(DEMO / "demo_MO.rnx.gz", DEMO / "demo_MN.rnx.gz", config)
    n = min(len(p.epochs.t_ns), 90)
    calm = filtered(p, config, 0, n)
    assert not (calm.status == 4).any()
    # three epochs to be sure, one to start, a few until the start is as good as the filter was
    for position, velocity in ((1e4, 0.0), (1e7, 0.0), (3e11, 0.0), (0.0, 1e5), (0.0, 3e11)):
        assert epochs_to_recover(p, config, calm, 30, position, velocity) <= 15, (position, velocity)


@pytest.mark.real
def test_bursts_at_rest(shared_data: Path) -> None:
    """From 30 m, which most codes allow, to where no satellite is in view."""
    folder = shared_data / "static/kiru_2024090"
    config = RunConfig(dynamics="static")
    p = prepared(
        folder / "KIRU00SWE_R_20240900000_01D_30S_MO.rnx", folder / "KIR000SWE_R_20240900000_01D_MN.rnx", config
    )
    calm = filtered(p, config, 0, 140)
    assert not (calm.status == 4).any()
    for size in (30.0, 100.0, 3e11):
        assert epochs_to_recover(p, config, calm, 80, size, 0.0) <= 20, size


def test_reflections_that_agree_do_not_move_a_filter() -> None:
    """In a street least squares passes its own test tens of metres off; a filter that refuses its codes is right."""
    made = simulate(load_scenario("urban-drive"), 2)
    ephemeris = BroadcastEphemeris(made.records)
    config = RunConfig(dynamics="vehicle", error_model="white", end="2024-03-30T08:03:00")
    solution = solve_run(made.observations, ephemeris, made.ionosphere, config)
    assert not (solution.status == EPOCH_RESET).any()
    at = np.searchsorted(made.truth.t_ns, solution.t_ns)
    # 3 m RMS; 100 m and more where it started from least squares
    assert np.linalg.norm(solution.pos_e - made.truth.pos_e[at], axis=1).max() < 25.0


@pytest.mark.laws
def test_signs() -> None:
    x, P = np.zeros(4), np.eye(4)
    assert not contradicted(np.array([8.0, 0.0, 0.0]), np.eye(3), x, P)  # 64 < 36 (3 + 3)
    assert contradicted(np.array([15.0, 0.0, 0.0]), np.eye(3), x, P)
    nothing: ErrorModel = no_errors()[0]
    slots = Slots(
        np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros(1, np.int64), np.ones(1)
    )
    assert not are_strained(nothing, slots, 1e9 * np.ones(4), P, 0)  # white errors have no states to be strained
