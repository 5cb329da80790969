"""Extended Kalman filter for any sensor: all rows of an epoch at once (Groves 2013, 3.2.2 and 3.4.1).

Pure functions on named beliefs, for any sensor that can be written as `Linear`. Runs over satellites use the same
equations in `starwise.kernels.filter_run`, with sparse rows.
"""

import numpy as np

from starwise.kernels.linalg import cholesky
from starwise.types import F8, Innovation, Linear, State


def predict(state: State, Phi: F8, Q: F8, t_ns: int) -> State:
    """Belief at a later time: x = Phi x, P = Phi P Phi' + Q, exactly symmetric.

    Parameters
    ----------
    state : State
    Phi, Q : (n, n)
        Transition matrix and process noise from ``state.t_ns`` to ``t_ns``.
    t_ns : int
        GPST, ns.
    """
    P = Phi @ state.P @ Phi.T + Q
    return State(t_ns, state.layout, Phi @ state.x, 0.5 * (P + P.T))


def update(state: State, linear: Linear, gate: float | None = None) -> tuple[State, Innovation]:
    """Belief after all rows of a measurement, by the Cholesky factor of S = H P H' + R.

    With a gate the rows are taken in order and each is tested on its innovation conditioned on the rows accepted
    before, as a row-by-row sequential update would; refused rows are left out of S.

    Parameters
    ----------
    state : State
    linear : Linear
        m rows with uncorrelated errors.
    gate : float, optional
        Chi-square threshold, 1 degree of freedom.

    Returns
    -------
    State
    Innovation
        ``v`` and ``s`` are conditioned on the rows used before (the first: plain).

    Raises
    ------
    ValueError
        S is not positive definite.
    """
    if gate is None:
        return _update_all(state, linear)
    H, PH = linear.H, linear.H @ state.P
    m = len(linear.v)
    v, s = linear.v.copy(), np.empty(m)
    kept: list[int] = []
    L, y = np.zeros((m, m)), np.zeros(m)
    for k in range(m):
        n = len(kept)
        row = np.zeros(n)
        for i in range(n):
            row[i] = (H[k] @ PH[kept[i]] - row[:i] @ L[i, :i]) / L[i, i]
        s[k] = H[k] @ PH[k] + linear.r[k] - row @ row
        v[k] -= row @ y[:n]
        if s[k] > 0.0 and v[k] ** 2 <= gate * s[k]:
            L[n, :n], L[n, n] = row, np.sqrt(s[k])
            y[n] = v[k] / L[n, n]
            kept.append(k)
    used = np.zeros(m, dtype=bool)
    used[kept] = True
    out = state
    if kept:
        out, _ = _update_all(state, Linear(linear.v[kept], H[kept], linear.r[kept], linear.row[kept]))
    return out, Innovation(v, s, used, linear.row, float(y @ y), len(kept))


def _update_all(state: State, linear: Linear) -> tuple[State, Innovation]:
    m = len(linear.v)
    W = linear.H @ state.P
    S = W @ linear.H.T + np.diag(linear.r)
    if not cholesky(S, m):
        raise ValueError("innovation covariance is not positive definite")
    y = linear.v.copy()
    for i in range(m):  # W := L^-1 H P, y := L^-1 v
        W[i] = (W[i] - S[i, :i] @ W[:i]) / S[i, i]
        y[i] = (y[i] - S[i, :i] @ y[:i]) / S[i, i]
    P = state.P - W.T @ W
    d = np.diag(S)
    innovation = Innovation(y * d, d * d, np.ones(m, dtype=bool), linear.row, float(y @ y), m)
    return State(state.t_ns, state.layout, state.x + W.T @ y, 0.5 * (P + P.T)), innovation
