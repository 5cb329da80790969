"""Rest and motion told from single epochs: rest has to be shown, everything else is motion."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import starwise
import starwise.demo
from starwise.config import ProcessNoise, RunConfig
from starwise.constants import NS
from starwise.estimators.dynamics import EPOCHS_LOOKED_AT, _looked_at, settle_dynamics
from starwise.frames import C_ne_enu, ecef_from_geodetic
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import read_obs
from starwise.models.dynamics import BLOCK, Detected, detect_motion
from starwise.models.process import motion_from
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.report.text import solve_text

DATA = Path(starwise.demo.__file__).parent / "data"
FILES = (DATA / "demo_MO.rnx.gz", DATA / "demo_MN.rnx.gz")
HERE = ecef_from_geodetic([0.8, 0.2, 300.0])
TURN = C_ne_enu(0.8, 0.2)
KIRUNA = "KIR000SWE_R_20240900000_01D_MN.rnx"


def look(
    move: np.ndarray | None = None,
    *,
    n: int = 600,
    step_s: float = 1.0,
    sigma_v: float = 0.03,
    sigma_p: float = 0.3,
    doppler: bool = True,
    seed: int = 1,
    bad: float = 0.0,
) -> Detected:
    """What is found of a receiver that drifts slowly by errors of 2 m and moves as ``move`` (n, 3) says, ENU m."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * step_s
    move = np.zeros((n, 3)) if move is None else move
    slow = 2.0 * np.sin(2 * np.pi * t[:, None] / 5000.0 + rng.uniform(0, 6, 3)) * [1.0, 1.0, 2.0]
    pos = move + slow + sigma_p * rng.normal(size=(n, 3)) * [1.0, 1.0, 2.0]
    vel = np.gradient(move, t, axis=0) + sigma_v * rng.normal(size=(n, 3)) * [1.0, 1.0, 2.0]
    wild = rng.random(n) < bad
    vel[wild] += rng.normal(size=(int(wild.sum()), 3)) * 5.0
    cov_p = np.tile(TURN.T @ np.diag([9.0, 9.0, 36.0]) @ TURN, (n, 1, 1))  # 3 m, as least squares claims
    cov_v = np.tile(TURN.T @ np.diag([0.01, 0.01, 0.04]) @ TURN, (n, 1, 1))
    if not doppler:
        vel = np.full((n, 3), np.nan)
    t_ns = np.round(t * NS).astype(np.int64)
    return detect_motion(t_ns, HERE + pos @ TURN, cov_p, vel @ TURN, cov_v, np.ones(n, dtype=bool))


def path(speed: np.ndarray, step_s: float = 1.0) -> np.ndarray:
    """Displacement eastwards of a speed profile."""
    return np.outer(np.cumsum(speed) * step_s, [1.0, 0.0, 0.0])


def part(n: int, first: float, last: float) -> np.ndarray:
    k = np.arange(n) / n
    return ((k >= first) & (k < last)).astype(float)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("n", "step_s"), [(30, 1.0), (600, 1.0), (2880, 30.0), (3000, 0.1)])
@pytest.mark.parametrize("sigma_v", [0.005, 0.03, 0.08])
def test_rest_is_rest(n: int, step_s: float, sigma_v: float, seed: int) -> None:
    found = look(n=n, step_s=step_s, sigma_v=sigma_v, seed=seed)
    assert not found.moving, found


@pytest.mark.parametrize("seed", range(3))
def test_rest_is_shown_by_positions_where_there_is_no_doppler(seed: int) -> None:
    assert not look(n=2880, step_s=30.0, doppler=False, seed=seed).moving
    assert not look(n=600, sigma_p=0.1, doppler=False, seed=seed).moving


@pytest.mark.parametrize("doppler", [True, False])
@pytest.mark.parametrize(
    ("what", "n", "step_s"), [("walk", 600, 1.0), ("walk", 2880, 30.0), ("drive and back", 600, 1.0)]
)
def test_a_tenth_of_the_run_is_enough(what: str, n: int, step_s: float, doppler: bool) -> None:
    on = part(n, 0.45, 0.55)
    speed = 1.0 * on if what == "walk" else 5.0 * part(n, 0.45, 0.5) - 5.0 * part(n, 0.5, 0.55)
    assert look(path(speed, step_s), n=n, step_s=step_s, doppler=doppler, sigma_p=0.1).moving


def test_five_seconds_of_walking_in_an_hour_are_motion() -> None:
    n = 3600
    for first in range(1000, 1005):  # wherever the blocks begin
        speed = np.zeros(n)
        speed[first : first + 5] = 1.0
        assert look(path(speed), n=n).moving


def test_motion_that_returns_is_motion() -> None:
    t = np.arange(600.0)
    for radius, period in ((2.0, 20.0), (3.0, 120.0), (0.5, 15.0), (2.0, 40.0)):
        circle = radius * np.stack([np.cos(2 * np.pi * t / period), np.sin(2 * np.pi * t / period), 0 * t], axis=1)
        assert look(circle).moving, (radius, period)
    up = np.outer(2.0 * np.sin(2 * np.pi * t / 20.0), [0.0, 0.0, 1.0])
    assert look(up).moving
    assert look(path(np.full(600, 0.05))).moving  # a crawl


def test_doubt_is_motion() -> None:
    assert look(sigma_v=0.3).moving  # a telephone: slow motion may hide in its Doppler
    assert look(doppler=False, sigma_p=2.0).moving
    assert look(n=15).moving
    assert look(n=40, doppler=False).moving
    nothing = np.zeros((0, 3, 3))
    empty = np.zeros(0, dtype=np.int64), np.zeros((0, 3)), nothing, np.zeros((0, 3)), nothing, np.zeros(0, dtype=bool)
    assert detect_motion(*empty).moving


def test_loud_codes_hide_no_rest_that_doppler_shows() -> None:
    assert not look(sigma_p=10.0).moving
    assert look(path(part(600, 0.45, 0.55)), sigma_p=10.0).moving


def test_single_wild_velocities_do_not_move_a_receiver() -> None:
    assert not look(bad=0.02, sigma_v=0.01).moving


def test_of_long_runs_blocks_of_neighbours_are_looked_at() -> None:
    keep = _looked_at(86_400)
    assert keep.sum() == EPOCHS_LOOKED_AT
    runs = np.diff(np.flatnonzero(np.diff(np.r_[0, keep.astype(int), 0])))[::2]
    assert (runs >= BLOCK).all()
    gaps = np.diff(np.flatnonzero(keep))
    assert gaps.max() < 90  # s, at 1 Hz: no drive is shorter
    assert _looked_at(100).all()


def test_the_demo_moves_and_what_a_user_says_counts() -> None:
    obs, nav = read_obs(FILES[0]), read_nav(FILES[1])
    ephemeris = BroadcastEphemeris(nav)

    def settled(**options: object) -> tuple[str, bool]:
        config, record = settle_dynamics(obs, ephemeris, nav.ionosphere, RunConfig.from_dict(options))
        assert record["used"] == config.dynamics
        return config.dynamics, record["detected"]

    assert settled() == ("vehicle", True)
    assert settled(dynamics="static") == ("static", False)
    assert settled(method="lsq") == ("vehicle", False)  # has no use for it
    assert settled(process={"model": "velocity"}) == ("vehicle", False)
    # options that least squares, by which one looks, does not have
    assert settled(method="federated", share="G=1,R=1,E=1,C=1,J=1") == ("vehicle", True)
    assert settled(adaptation="fading") == ("vehicle", True)
    assert motion_from(RunConfig()) == motion_from(RunConfig(dynamics="vehicle"))
    assert RunConfig().process == ProcessNoise()


def test_what_was_found_is_said(tmp_path: Path) -> None:
    solution = starwise.solve(*FILES, interval_s=5.0, method="ekf", error_model="white")
    record = solution.provenance
    assert record["config"]["dynamics"] == "auto"
    assert record["dynamics"]["used"] == "vehicle"
    assert record["dynamics"]["detected"]
    assert record["effective"]["process"]["model"] == "singer"
    assert "vehicle (detected: " in solve_text(record, tmp_path, 1.0)
    told = starwise.solve(*FILES, interval_s=5.0, method="ekf", error_model="white", dynamics="pedestrian")
    assert "pedestrian" in solve_text(told.provenance, tmp_path, 1.0)
    assert "detected" not in solve_text(told.provenance, tmp_path, 1.0)
    assert np.isfinite(told.pos_e).any()


@pytest.mark.real
@pytest.mark.parametrize(
    ("folder", "obs", "nav", "dynamics"),
    [
        ("static/kiru_2024090", "KIRU00SWE_R_20240900000_01D_30S_MO.rnx", (KIRUNA,), "static"),
        ("static/unsa_2019057", "UNSA00ARG_R_20190570000_01D_30S_MO.crx.gz", ("brdc0570.19n",), "static"),
        ("static/nl_2021001", "delf0010.21d", ("AMEL00NLD_R_20210010000_01D_MN.rnx",), "static"),  # no Doppler
        ("rtk/nagoya_static_rtk_2024", "rover.obs", ("base.nav",), "static"),
        ("rtk/geonet_2005092", "07590920.05o", ("07590920.05n",), "static"),  # no Doppler
        ("kinematic/urbannav_tst_20190428", "COM3_190428_124409.obs", ("hksc1180.19n", "hksc1180.19b"), "vehicle"),
    ],
)  # fmt: skip
def test_real_receivers(shared_data: Path, folder: str, obs: str, nav: tuple[str, ...], dynamics: str) -> None:
    base = shared_data / folder
    observations, records = read_obs(base / obs), read_nav(*(base / name for name in nav))
    config, record = settle_dynamics(observations, BroadcastEphemeris(records), records.ionosphere, RunConfig())
    assert config.dynamics == dynamics, record


@pytest.mark.real
def test_a_station_that_is_carried_for_a_minute_moves(shared_data: Path) -> None:
    """Real errors of five minutes at 1 Hz, with the antenna carried 20 m away and back within 40 s of them."""
    base = shared_data / "rtk/nagoya_static_rtk_2024"
    solution = starwise.solve(base / "rover.obs", base / "base.nav", method="lsq", error_model="white")
    speed = np.zeros(solution.n_epochs)
    speed[100:120], speed[120:140] = 1.0, -1.0
    lat_turn = C_ne_enu(*np.radians(solution.provenance["summary"]["mean_llh"][:2]))
    for factor, moving in ((0.0, False), (1.0, True)):
        moved = replace(
            solution,
            pos_e=solution.pos_e + factor * path(speed) @ lat_turn,
            vel_e=solution.vel_e + factor * np.outer(speed, lat_turn[0]),
        )
        found = detect_motion(
            moved.t_ns, moved.pos_e, moved.cov_pos, moved.vel_e, moved.cov_vel, np.ones(moved.n_epochs, dtype=bool)
        )
        assert found.moving is moving, found
