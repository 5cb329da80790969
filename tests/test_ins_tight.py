"""Tight coupling on a simulated drive: few satellites help, none are survived, the state of clocks is theirs."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from starwise.config import RunConfig
from starwise.config_inertial import InertialConfig
from starwise.constants import C_LIGHT, EPOCH_COASTED
from starwise.errors import StarwiseError
from starwise.estimators.ins import loose
from starwise.estimators.ins_tight import fixes_of, tight
from starwise.estimators.run import solve_run
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.sim.run import Simulation, simulate
from starwise.sim.scenario import Scenario

CANYON_S, TUNNEL_S = (70.0, 110.0), (130.0, 140.0)
TURN = {"kind": "turn", "radius_m": 15.0, "angle_deg": 90.0, "roll_in_s": 1.0}
CONFIG = InertialConfig.from_dict(
    {
        "lever_arm_m": [0.5, 0.0, -1.0],
        "gyro": {"white_dprh": 0.3, "bias_dph": 360.0, "in_run_dph": 6.0, "scale_ppm": 1000.0, "vibration": 0.0},
        "accel": {"white_mpsrh": 0.05, "bias_ug": 1000.0, "in_run_ug": 20.0, "scale_ppm": 1000.0, "vibration": 0.0},
    }
)
OPTIONS = RunConfig(error_model="white", ionosphere="none", troposphere="none")


@cache
def drive() -> Simulation:
    start = {"kind": "straight", "speed_mps": 9.0, "duration_s": 8.0, "smooth": True}
    block = {"kind": "straight", "distance_m": 120.0}
    ways = [block, TURN, block, {**TURN, "angle_deg": -90.0}] * 2
    scenario = Scenario.from_dict(
        {
            "name": "canyon", "seed": 5, "time": {"start": "2024-03-30T12:00:00", "duration_s": 150.0},
            "vehicle": {
                "start": [48.1, 11.5, 560.0], "heading_deg": 40.0,
                "segments": [{"kind": "static", "duration_s": 8.0}, start, *ways, {"kind": "straight"}],
            },
            "receiver": {
                "lever_arm_m": [0.5, 0.0, -1.0], "noise": {"model": "fixed", "code_m": 0.6},
                "clock": {"reset": "millisecond", "bias_s": 4.9e-4, "drift": 2e-7, "intersystem_m": {"E": 12.0}},
            },
            "sky": {"constellations": ["gps", "galileo"]},
            "imu": {"grade": "industrial", "rate_hz": 50.0},
        }
    )  # fmt: skip
    return simulate(scenario)


@cache
def runs() -> dict[str, tuple[Any, Any, Any]]:
    """Time (s), horizontal errors (m) and run, with three satellites in the canyon and none in the tunnel."""
    simulation = drive()
    obs, paths = simulation.observations, simulation.truth.paths
    row_t = ((obs.t_ns - obs.t_ns[0]) * 1e-9)[obs.epoch_of_row()]
    canyon = (row_t >= CANYON_S[0]) & (row_t < CANYON_S[1])
    high = paths.sv[(paths.epoch == 90) & (paths.elevation > np.radians(30.0))]
    gone = (canyon & ~np.isin(obs.sv, high[[0, 2, -1]])) | ((row_t >= TUNNEL_S[0]) & (row_t < TUNNEL_S[1]))
    code, doppler = obs.code_m.copy(), obs.doppler_hz.copy()
    code[gone], doppler[gone] = np.nan, np.nan
    obs = replace(obs, code_m=code, doppler_hz=doppler)
    ephemeris, read = BroadcastEphemeris(simulation.records), simulation.imu
    assert read is not None
    lsq = solve_run(obs, ephemeris, simulation.ionosphere, OPTIONS.with_options({"method": "lsq"}))
    found = {
        "loose": loose(fixes_of(lsq), read.measured, CONFIG, epochs_ns=obs.t_ns),
        "tight": tight(obs, ephemeris, simulation.ionosphere, read.measured, OPTIONS, CONFIG),
    }
    out = {}
    for name, run in found.items():
        k = np.searchsorted(simulation.truth.t_ns, run.solution.t_ns)
        e = np.linalg.norm(run.solution.pos_e - simulation.truth.pos_e[k], axis=1)
        out[name] = ((run.solution.t_ns - obs.t_ns[0]) * 1e-9, e, run)
    return out


@pytest.mark.slow
def test_three_satellites_hold_what_loose_coupling_loses() -> None:
    rms = {}
    for name, (t, e, _) in runs().items():
        inside = (t >= CANYON_S[0]) & (t < CANYON_S[1])
        rms[name] = np.sqrt(np.mean(e[inside] ** 2))
        clear = (t > 40.0) & (t < CANYON_S[0])
        assert np.sqrt(np.mean(e[clear] ** 2)) < 1.0  # m, 3D: code noise 0.6 m, ten satellites and more
    assert rms["tight"] < 0.5 * rms["loose"] + 0.3


@pytest.mark.slow
def test_no_satellite_and_all_back() -> None:
    t, e, run = runs()["tight"]
    none = (t >= TUNNEL_S[0]) & (t < TUNNEL_S[1])
    assert (run.solution.n_used[none] == 0).all()
    assert (run.solution.status[none] == EPOCH_COASTED).all()
    assert e[none].max() < 4.0  # m after 10 s
    assert e[t > TUNNEL_S[1] + 3.0].max() < 2.0
    sigma = np.sqrt(np.trace(run.solution.cov_pos, axis1=1, axis2=2))
    assert sigma[none][-1] > 1.05 * sigma[none][0]


@pytest.mark.slow
def test_clocks_and_their_resets_are_followed() -> None:
    t, _, run = runs()["tight"]
    simulation = drive()
    k = np.searchsorted(simulation.truth.t_ns, run.solution.t_ns)
    truth = C_LIGHT * simulation.truth.clock_s[k]
    assert np.abs(np.diff(truth)).max() > 2e5  # m: the receiver set its clock
    names = run.solution.clock_names
    assert names == ("G", "E")
    open_sky = (t > 40.0) & ((t < CANYON_S[0]) | (t > TUNNEL_S[1] + 3.0))
    apart = run.solution.clock_m[open_sky] - truth[open_sky, None]
    # m: code noise and what group delays of the signals leave in the clock, constant for a run
    assert apart[:, 0].std() < 2.0
    assert (apart[:, 1] - apart[:, 0]).mean() == pytest.approx(12.0, abs=6.0)
    assert (run.solution.ledger["status"] == 14).mean() < 0.02  # gated


def test_a_time_offset_is_for_fixes_only() -> None:
    simulation = drive()
    assert simulation.imu is not None
    with pytest.raises(StarwiseError, match="time offset"):
        tight(
            simulation.observations, BroadcastEphemeris(simulation.records), simulation.ionosphere,
            simulation.imu.measured, OPTIONS, CONFIG.with_options({"time_offset_sigma_s": 0.1}),
        )  # fmt: skip


def test_observations_of_another_day_are_told() -> None:
    simulation = drive()
    assert simulation.imu is not None
    read = simulation.imu.measured
    with pytest.raises(StarwiseError, match="no epoch of the observations within"):
        tight(
            simulation.observations, BroadcastEphemeris(simulation.records), simulation.ionosphere,
            replace(read, t_ns=read.t_ns + 86_400_000_000_000), OPTIONS, CONFIG,
        )  # fmt: skip
