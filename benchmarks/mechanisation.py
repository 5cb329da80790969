"""Mechanisation: steps a second of starwise and of python-ins, its compiled loop alone and its Integrator.

python benchmarks/mechanisation.py [--quick] [--json FILE]
"""

from __future__ import annotations

import numpy as np

from _bench import Table, alternate, peer, ratio, show
from starwise.kernels.strapdown import mechanise

STEPS = 50_000
DT_S = 0.01


def readings() -> tuple[np.ndarray, np.ndarray]:
    """Gyro (rad) and accelerometer (m/s) increments of a vehicle that shakes."""
    rng = np.random.default_rng(0)
    gyro = rng.normal(size=(STEPS + 1, 3)) * 1e-3
    return gyro, rng.normal(size=(STEPS + 1, 3)) * 1e-2 + [0.0, 0.0, -0.0981]


def tables(quick: bool) -> list[Table]:
    gyro, accel = readings()
    nav0 = np.array([1.0, 0, 0, 0, 10, 10, 0, np.radians(50.0), np.radians(10.0), 100.0])
    out, dts = np.empty((STEPS, 10)), np.full(STEPS, DT_S)
    calls = {"starwise": lambda: mechanise(nav0.copy(), gyro[1:], accel[1:], dts, np.zeros(7), out)}
    table = Table("mechanisation", "Mechanisation, million steps a second")
    if peer("pyins") is None:
        table.notes.append("not installed: python-ins")
    else:
        calls.update(_python_ins(gyro, accel))
    took = alternate(calls, 7 if quick else 21)
    for name, seconds in took.items():
        row: dict[str, object] = {"": name, "million steps/s": STEPS / seconds.least / 1e6}
        row["ms for 50 000"] = seconds.scaled(1e3)
        if name != "starwise":
            row["x"] = ratio(seconds, took["starwise"])
        table.rows.append(row)
    table.notes.append("wanted: 5 x the speed of python-ins; results are compared by `benchmarks/ins.py speed`")
    return [table]


def _python_ins(gyro: np.ndarray, accel: np.ndarray) -> dict[str, object]:
    import pandas as pd
    from pyins import strapdown, util

    imu = pd.DataFrame(
        np.hstack([gyro, accel]), index=np.arange(STEPS + 1) * DT_S, columns=util.GYRO_COLS + util.ACCEL_COLS
    )
    pva = pd.Series([50.0, 10.0, 100.0, 10.0, 10.0, 0.0, 0.0, 0.0, 0.0], index=util.TRAJECTORY_COLS, name=0.0)
    made = strapdown.compute_increments_from_imu(imu, "increment")
    state = [np.empty((STEPS + 1, 3)), np.empty((STEPS + 1, 3)), np.empty((STEPS + 1, 3, 3))]
    state[0][0], state[1][0], state[2][0] = pva.iloc[:3], pva.iloc[3:6], np.eye(3)
    theta = np.ascontiguousarray(made[["theta_x", "theta_y", "theta_z"]])
    dv = np.ascontiguousarray(made[["dv_x", "dv_y", "dv_z"]])
    intervals_s = np.asarray(made.dt)
    return {
        "python-ins, its compiled loop": lambda: strapdown.integrate(intervals_s, *state, theta, dv, 0, True),
        "python-ins, its Integrator": lambda: strapdown.Integrator(pva).integrate(made),
    }


if __name__ == "__main__":
    show(tables, __doc__)
