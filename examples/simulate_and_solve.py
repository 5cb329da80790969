"""Simulate a drive into files, solve them, and judge the result: what a user does with files of their own."""

import sys
from pathlib import Path

import starwise
from starwise.sim.run import simulate
from starwise.sim.scenario import load_scenario
from starwise.sim.writers import write_files

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "drive")
scenario = load_scenario("urban-drive", {"output.imu": False})
files = write_files(simulate(scenario), folder)

solution = starwise.solve(files["observations"], files["navigation"], output=folder / "solved")
report = starwise.assess(solution, files["truth"])
print(f"{solution.n_epochs} epochs, 2D RMS {report['rms_2d_m']:.2f} m, 3D RMS {report['rms_3d_m']:.2f} m")
print(f"the 95 % ellipsoid holds the truth in {100 * report['coverage_95']:.0f} %")
