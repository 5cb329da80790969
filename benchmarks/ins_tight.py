"""Loose and tight coupling on a simulated drive: a canyon with two or three satellites, and a tunnel with none.

python benchmarks/ins_tight.py [runs]
"""

import sys
from dataclasses import replace

import numpy as np

from starwise.config import RunConfig
from starwise.config_inertial import InertialConfig
from starwise.estimators.ins import loose
from starwise.estimators.ins_tight import fixes_of, tight
from starwise.estimators.run import solve_run
from starwise.frames import enu_from_ecef
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.sim.run import Simulation, Simulator
from starwise.sim.scenario import Scenario
from starwise.types import Observations

CANYON_S = (150.0, 210.0)
TUNNEL_S = (240.0, 260.0)
STRAIGHT = {"kind": "straight", "distance_m": 200.0}
TURN = {"kind": "turn", "radius_m": 15.0, "angle_deg": 90.0, "roll_in_s": 1.0}
BACK = {**TURN, "angle_deg": -90.0}


def scenario(grade: str) -> Scenario:
    """Five minutes through blocks of 200 m at 9 m/s."""
    start = {"kind": "straight", "speed_mps": 9.0, "duration_s": 8.0, "smooth": True}
    blocks = [STRAIGHT, TURN, STRAIGHT, BACK, STRAIGHT, BACK, STRAIGHT, TURN] * 2
    return Scenario.from_dict(
        {
            "name": "canyon",
            "time": {"start": "2024-03-30T12:00:00", "duration_s": 300.0, "interval_s": 1.0},
            "vehicle": {
                "start": [48.1, 11.5, 560.0], "heading_deg": 40.0,
                "segments": [{"kind": "static", "duration_s": 10.0}, start, *blocks, {"kind": "straight"}],
            },
            "receiver": {
                "lever_arm_m": [0.5, 0.0, -1.0], "noise": {"code_m": 0.6}, "multipath": {"sigma_m": 0.5},
                "clock": {"intersystem_m": {"E": 12.0, "C": -20.0}},
            },
            "imu": {"grade": grade},
        }
    )  # fmt: skip


def blocked(simulation: Simulation, keep: str, rng: np.random.Generator) -> Observations:
    """Observations with few satellites above 30 deg in the canyon, drawn at random, and none in the tunnel.

    ``keep`` is how many, turn and turn about for 10 s each: ``"2"``, ``"3"``, ``"23"``.
    """
    obs, paths = simulation.observations, simulation.truth.paths
    t_s = (obs.t_ns - obs.t_ns[0]) * 1e-9
    row_t = t_s[obs.epoch_of_row()]
    canyon = (row_t >= CANYON_S[0]) & (row_t < CANYON_S[1])
    middle = np.searchsorted(t_s, np.mean(CANYON_S))
    high = paths.sv[(paths.epoch == middle) & (paths.elevation > np.radians(30.0))]
    left = rng.choice(high, 3, replace=False)
    turn = np.array([int(c) for c in keep])[(row_t // 10.0).astype(int) % len(keep)]
    gone = (canyon & ~(np.isin(obs.sv, left[:2]) | ((obs.sv == left[2]) & (turn == 3)))) | (
        (row_t >= TUNNEL_S[0]) & (row_t < TUNNEL_S[1])
    )
    code, doppler, phase = obs.code_m.copy(), obs.doppler_hz.copy(), obs.phase_cyc.copy()
    code[gone], doppler[gone], phase[gone] = np.nan, np.nan, np.nan
    return replace(obs, code_m=code, doppler_hz=doppler, phase_cyc=phase)


def errors(run: object, simulation: Simulation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (s), horizontal error (m) and whether it is inside the 95 % ellipse, of the antenna."""
    solution = run.solution  # type: ignore[attr-defined]
    truth = simulation.truth.reference()
    k = np.searchsorted(truth.t_ns, solution.t_ns)
    origin = truth.pos_e[0]
    e = enu_from_ecef(solution.pos_e, origin) - enu_from_ecef(truth.pos_e[k], origin)
    P = run.pos_cov[:, :2, :2]  # type: ignore[attr-defined]
    d = e[:, [1, 0]]
    inside = np.einsum("ki,kij,kj->k", d, np.linalg.inv(P), d) < 5.991
    return (solution.t_ns - truth.t_ns[0]) * 1e-9, np.hypot(e[:, 0], e[:, 1]), inside


def main(runs: int) -> None:
    config = {"lever_arm_m": [0.5, 0.0, -1.0], "alignment_speed_mps": 3.0}
    # Simulated sensors do not vibrate; the rest is what the grade's data sheet says (starwise.sim.imu.GRADES).
    sensor = {
        "gyro": {"white_dprh": 0.3, "bias_dph": 360.0, "in_run_dph": 6.0, "scale_ppm": 1000.0, "vibration": 0.0},
        "accel": {"white_mpsrh": 0.05, "bias_ug": 1000.0, "in_run_ug": 20.0, "scale_ppm": 1000.0, "vibration": 0.0},
    }
    cases = {
        "inertial": InertialConfig.from_dict({**config, **sensor}),
        "with constraints": InertialConfig.from_dict({**config, **sensor, "vehicle": {"constraint": True}}),
    }
    options = RunConfig(error_model="white")
    print("canyon: horizontal error at its end, m, and RMS in it; tunnel: error at its end; median of runs")
    for keep in ("2", "23", "3"):
        simulator = Simulator(scenario("industrial"), seed=100)
        results: dict[tuple[str, str], list[tuple[float, float, float, float]]] = {}
        for number in range(runs):
            simulation = simulator.run(number)
            obs = blocked(simulation, keep, np.random.default_rng(number))
            ephemeris = BroadcastEphemeris(simulation.records)
            inertial = simulation.imu.measured
            lsq = solve_run(obs, ephemeris, simulation.ionosphere, options.with_options({"method": "lsq"}))
            for name, case in cases.items():
                for method in ("loose", "tight"):
                    if method == "loose":
                        run = loose(fixes_of(lsq), inertial, case, epochs_ns=obs.t_ns)
                    else:
                        run = tight(obs, ephemeris, simulation.ionosphere, inertial, options, case)
                    t, h, inside = errors(run, simulation)
                    canyon = (t >= CANYON_S[0]) & (t < CANYON_S[1])
                    tunnel = (t >= TUNNEL_S[0]) & (t < TUNNEL_S[1])
                    results.setdefault((name, method), []).append(
                        (h[canyon][-1], float(np.sqrt(np.mean(h[canyon] ** 2))), h[tunnel][-1], inside[t > 60].mean())
                    )
        for (name, method), values in results.items():
            end, rms, tunnel_end, coverage = np.median(values, axis=0)
            print(
                f"{keep:2s} satellites  {name:17s} {method:6s} end {end:7.2f}  RMS {rms:6.2f}  "
                f"tunnel {tunnel_end:6.2f}  coverage {coverage:.2f}"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
