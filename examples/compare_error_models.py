"""A quarter of an hour at rest, errors taken as white or as states that last: who tells the truth about itself?"""

import starwise
from starwise.estimators.run import solve_run
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.sim.run import Simulator
from starwise.sim.scenario import Scenario

scenario = Scenario.from_dict(
    {
        "time": {"start": "2024-03-30T12:00:00", "duration_s": 900.0, "interval_s": 1.0},
        "vehicle": {"start": [48.1, 11.5, 560.0], "segments": [{"kind": "static"}]},
        "receiver": {
            "ephemeris": {"model": "typical"},
            "ionosphere": {"model": "broadcast", "scale": 1.2, "residual_m": 0.3},
            "troposphere": {"model": "saastamoinen", "residual_m": 0.05},
            "multipath": {"sigma_m": 0.4, "tau_s": 60.0},
        },
    }
)
simulator = Simulator(scenario)
print("run  model     3D error, m  claimed, m  95 % ellipsoid holds")
for number in range(3):
    run = simulator.run(number)
    for model in ("white", "colored"):
        config = starwise.RunConfig(error_model=model, dynamics="static")
        solution = solve_run(run.observations, BroadcastEphemeris(run.records), run.ionosphere, config)
        report = starwise.assess(solution, run.truth.reference())
        held, claimed = 100 * report["coverage_95"], report["sigma_3d_mean_m"]
        print(f"{number:3}  {model:8} {report['rms_3d_m']:12.2f} {claimed:11.2f} {held:20.0f} %")
