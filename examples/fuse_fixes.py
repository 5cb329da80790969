"""Fixes of two receivers on one vehicle, one of them poor, fused into one solution; then judged against the truth."""

from pathlib import Path

import numpy as np

import starwise
from starwise.sim.run import simulate
from starwise.sim.scenario import load_scenario

truth = simulate(load_scenario("urban-drive")).truth.reference()
assert truth.t_ns is not None
rng = np.random.default_rng(2)
print("file         3D RMS, m")
for name, sigma in (("good", 1.0), ("poor", 4.0)):
    seconds = truth.t_ns // 1_000_000_000
    xyz = truth.pos_e + sigma * rng.normal(size=truth.pos_e.shape)
    lines = [f"{s // 604800},{s % 604800},{x:.3f},{y:.3f},{z:.3f}" for s, (x, y, z) in zip(seconds, xyz, strict=True)]
    Path(f"{name}.csv").write_text("week,tow,x,y,z\n" + "\n".join(lines) + "\n")
    print(f"{name}.csv {np.sqrt(np.mean(np.sum((xyz - truth.pos_e) ** 2, axis=1))):12.2f}")

fused = starwise.fuse_files(["good.csv", "poor.csv"])
report = starwise.assess(fused, truth)
print(f"both, fused {report['rms_3d_m']:9.2f}, 95 % ellipsoid holds {100 * report['coverage_95']:.0f} %")
