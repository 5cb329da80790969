"""A sensor of your own in a filter: a barometer with a drifting error, beside heights of satellites."""

import numpy as np

from starwise.analysis.consistency import nis_test
from starwise.estimators import ekf
from starwise.types import Layout, Linear, State

LAYOUT = Layout(("height", "climb", "baro"))  # m, m/s, error of the barometer, m
DT, TAU, BARO, GNSS, READ = 1.0, 600.0, 5.0, 3.0, 0.2  # s, s, m, m, m
PHI = np.array([[1.0, DT, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, np.exp(-DT / TAU)]])
Q = np.diag([0.0, 0.0, BARO**2 * (1.0 - np.exp(-2.0 * DT / TAU))])
Q[:2, :2] = 0.05 * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])


def heights(state: State, gnss_m: float, baro_m: float) -> Linear:
    """Rows: height by satellites, height by pressure."""
    H = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 1.0]])
    return Linear(np.array([gnss_m, baro_m]) - H @ state.x, H, np.array([GNSS**2, READ**2]), np.arange(2))


rng = np.random.default_rng(4)
state = State(0, LAYOUT, np.zeros(3), np.diag([100.0, 1.0, BARO**2]))
truth = rng.multivariate_normal(state.x, state.P)
nis, error = [], []
for k in range(1, 901):
    truth = PHI @ truth + rng.multivariate_normal(np.zeros(3), Q)
    state = ekf.predict(state, PHI, Q, k * 1_000_000_000)
    rows = heights(state, truth[0] + GNSS * rng.normal(), truth[0] + truth[2] + READ * rng.normal())
    state, innovation = ekf.update(state, rows)
    nis.append(innovation.nis)
    error.append(truth[0] - state.x[0])
test, climb = nis_test(nis, 2), state.P[1, 1] ** 0.5
print(f"height RMS {np.std(error):.2f} m, by satellites alone {GNSS:.2f} m; sigma of the climb {climb:.2f} m/s")
print(f"NIS per degree of freedom {test.per_dof:.3f}, accepted {test.low:.3f} to {test.high:.3f}: passed {test.passed}")
