"""Monte Carlo of a filter of your own: NEES over runs, inside its chi-square bounds if the filter is consistent."""

import numpy as np
from scipy.stats import chi2

from starwise.estimators import ekf
from starwise.types import Layout, Linear, State

LAYOUT = Layout(("pos", "vel"))
DT, PSD, SIGMA, EPOCHS, RUNS = 1.0, 0.1, 2.0, 60, 100  # s, m^2/s^3, m
PHI = np.array([[1.0, DT], [0.0, 1.0]])
Q = PSD * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
H = np.array([[1.0, 0.0]])
L = np.linalg.cholesky(Q)


def one_run(rng: np.random.Generator, assumed_psd: float) -> np.ndarray:
    """Error' P^-1 error at each epoch of one run."""
    state = State(0, LAYOUT, np.zeros(2), np.diag([100.0, 4.0]))
    truth = rng.multivariate_normal(state.x, state.P)
    out = np.empty(EPOCHS)
    for k in range(EPOCHS):
        truth = PHI @ truth + L @ rng.normal(size=2)
        state = ekf.predict(state, PHI, Q * assumed_psd / PSD, (k + 1) * 1_000_000_000)
        measured = H @ truth + SIGMA * rng.normal(size=1)
        state, _ = ekf.update(state, Linear(measured - H @ state.x, H, np.array([SIGMA**2]), np.arange(1)))
        error = truth - state.x
        out[k] = error @ np.linalg.solve(state.P, error)
    return out


low, high = chi2.ppf([0.025, 0.975], 2 * RUNS) / (2 * RUNS)
print(f"NEES per degree of freedom at the last epoch; consistent from {low:.2f} to {high:.2f}")
for name, psd in (("as it is", PSD), ("a tenth of it", PSD / 10), ("ten times", PSD * 10)):
    streams = np.random.default_rng(7).spawn(RUNS)
    nees = np.mean([one_run(rng, psd)[-1] for rng in streams]) / 2
    print(f"  process noise assumed {name:14} {nees:5.2f}  {'consistent' if low < nees < high else 'not consistent'}")
