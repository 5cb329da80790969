"""Single-satellite sequential EKF, S3EKF (Chen, Zhang, Huo 2012, eq. 5a-5e), for any sensor that comes in groups.

The rows of one satellite are a group. The groups are processed one after another; h and H of each are evaluated at
the state that the one before has left (eq. 5c). For a linear sensor that is exactly `starwise.estimators.ekf.update`;
for satellites the two differ by the curvature of a range, dx^2 / (2 rho): 0.2 micrometres for 3 m.
"""

from collections.abc import Callable, Sequence

import numpy as np

from starwise.types import Innovation, Linear, State

Linearise = Callable[[State, int], Linear]
"""Rows of group k at a belief; rows of different groups must be uncorrelated."""


def update(
    state: State, linearise: Linearise, groups: Sequence[int], gate: Sequence[float] | None = None
) -> tuple[State, Innovation]:
    """Belief after all groups, one at a time.

    Parameters
    ----------
    state : State
        Predicted belief, x^0 and P^0 of eq. 5a and 5b.
    linearise : callable
        Innovation and Jacobian of a group at a belief.
    groups : sequence of int
        Groups in the order to be taken.
    gate : sequence of float, optional
        Chi-square thresholds by degrees of freedom (``gate[2]`` for a group of two rows): a group whose normalised
        innovation squared is above is left out whole.

    Returns
    -------
    State
        x^n and P^n of eq. 5d and 5e.
    Innovation
        Rows of all groups in order, at the moment when they were processed.

    Raises
    ------
    ValueError
        An innovation covariance is not positive definite.
    """
    v: list[float] = []
    s: list[float] = []
    used: list[bool] = []
    row: list[int] = []
    nis, dof = 0.0, 0
    for group in groups:
        linear = linearise(state, group)
        m = len(linear.v)
        PH = state.P @ linear.H.T
        S = linear.H @ PH + np.diag(linear.r)
        try:
            L = np.linalg.cholesky(S)
        except np.linalg.LinAlgError:
            raise ValueError(f"innovation covariance of group {group} is not positive definite") from None
        W = np.linalg.solve(L, PH.T)
        y = np.linalg.solve(L, linear.v)
        q = float(y @ y)
        accept = m > 0 and (gate is None or q <= gate[min(m, len(gate) - 1)])
        if accept:
            P = state.P - W.T @ W
            state = State(state.t_ns, state.layout, state.x + W.T @ y, 0.5 * (P + P.T))
            nis += q
            dof += m
        v.extend(linear.v)
        s.extend(np.diag(S))
        used.extend([accept] * m)
        row.extend(int(r) for r in linear.row)
    return state, Innovation(
        np.array(v), np.array(s), np.array(used, dtype=bool), np.array(row, dtype=np.int64), nis, dof
    )
