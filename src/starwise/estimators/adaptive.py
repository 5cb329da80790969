"""Adaptation rules for any filter: one interface, one memory that travels with the belief.

A rule sees the innovations of an epoch at the prediction, before any row is used, and answers with a fading factor on
Phi P Phi', a factor on Q and the measurement variances to use; see `starwise.kernels.adapt` for the equations. The
same call serves the EKF (all rows at once), the S3EKF (group by group) and local filters.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from starwise.errors import StarwiseError
from starwise.estimators import ekf, s3ekf
from starwise.kernels import adapt as kernel
from starwise.types import F8, Innovation, Linear, State

Measure = Callable[[State], Linear]
"""Innovations and Jacobian of all rows at a belief."""


@dataclass(frozen=True)
class Adaptation:
    """A rule with its numbers; make one by the functions of `RULES` or by hand.

    Attributes
    ----------
    kind : str
        A key of `KINDS`.
    alpha, weight, limit, eta : float
        ``paper``: adjustment coefficient, d_0, U (squared innovation) and the factor of beta (eq. 17-20).
    memory : float
        ``strong_tracking``: rho of the innovation's covariance; ``sage_husa``: forgetting factor b.
    softening : float
        ``strong_tracking``: factor on R.
    window : int
        ``iae_r``, ``iae_q``: epochs.
    noise : str
        ``sage_husa``: what is estimated, R or Q.
    c, c1 : float
        ``huber``, ``igg3``: sigmas from which a row loses weight; from which it is refused.
    least, most : float
        Limits of every factor.
    """

    kind: str
    alpha: float = 1.0
    weight: float = 1.0
    limit: float = np.inf
    eta: float = 0.0
    memory: float = 0.95
    softening: float = 1.0
    window: int = 30
    noise: Literal["R", "Q"] = "R"
    c: float = 1.5
    c1: float = 4.0
    least: float = 0.05
    most: float = 100.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise StarwiseError("no such adaptation rule", found=self.kind, wanted=" | ".join(KINDS))
        positive = (self.alpha, self.weight, self.softening, self.c, self.least)
        if (
            min(*positive, self.most - self.least, self.c1 - self.c) <= 0.0
            or self.window < 1
            or not 0.0 < self.memory <= 1.0
        ):
            raise StarwiseError("numbers of an adaptation rule outside their limits", found=repr(self))

    def numbers(self) -> kernel.Rule:
        """The same as plain numbers for kernels."""
        return kernel.Rule(
            KINDS[self.kind], self.alpha, self.weight, self.limit, self.memory, self.softening, self.window,
            kernel.ON_Q if self.noise == "Q" else kernel.ON_R, self.c, self.c1, self.least, self.most,
        )  # fmt: skip

    def fresh(self) -> F8:
        """Memory before the first epoch."""
        return np.zeros(kernel.memory_size(self.window))


KINDS: Final = {
    "none": kernel.NONE,
    "paper": kernel.PAPER,
    "strong_tracking": kernel.STRONG,
    "iae_r": kernel.IAE_R,
    "iae_q": kernel.IAE_Q,
    "sage_husa": kernel.SAGE_HUSA,
    "huber": kernel.HUBER,
    "igg3": kernel.IGG3,
}
RULES: Final[dict[str, Adaptation]] = {
    "none": Adaptation("none"),
    # eq. 12-16, without and with the improvements of eq. 17-19
    "fading": Adaptation("paper", most=1e3),
    "fading_improved": Adaptation("paper", alpha=4.0, weight=500.0, limit=120.0**2, most=1e3),
    "strong_tracking": Adaptation("strong_tracking", softening=4.0, most=1e3),
    "iae_r": Adaptation("iae_r"),
    "iae_q": Adaptation("iae_q"),
    "sage_husa_r": Adaptation("sage_husa", memory=0.98),
    "sage_husa_q": Adaptation("sage_husa", memory=0.98, noise="Q"),
    "huber": Adaptation("huber", c=1.345),
    "igg3": Adaptation("igg3", c=1.5, c1=4.0),
}
"""Rules by name, with numbers of the literature. Fading is limited to 1000 an epoch: more than that, some epochs in a
row, leaves a covariance of 1e18 m^2 in which an update loses every digit."""


def factors(
    rule: Adaptation, memory: F8, v: F8, p: F8, q: F8, r: F8, beta: float = 0.0
) -> tuple[kernel.Factors, F8, F8]:
    """Factors of an epoch, the variances to use, and the memory after it (the one given is left alone).

    Parameters
    ----------
    rule : Adaptation
    memory : (k,) float64
        From `Adaptation.fresh`, or of the epoch before.
    v, p, q, r : (m,) float64
        Innovations, H Phi P Phi' H', H Q H' and R of every row.
    beta : float
        ``paper``: term of eq. 20, in the unit of v squared.
    """
    later, r_out = memory.copy(), np.empty(len(v))
    v, p, q, r = (np.ascontiguousarray(a, dtype=np.float64) for a in (v, p, q, r))
    answer = kernel.adapt(rule.numbers(), later, v, p, q, r, float(beta), r_out)
    return answer, r_out, later


def step(
    state: State,
    Phi: F8,
    Q: F8,
    t_ns: int,
    measure: Measure,
    rule: Adaptation,
    memory: F8,
    groups: Sequence[Sequence[int]] | None = None,
    gate: Sequence[float] | None = None,
) -> tuple[State, Innovation, kernel.Factors, F8]:
    """One epoch of an adaptive EKF, or of an adaptive S3EKF: prediction, factors, update.

    Parameters
    ----------
    state : State
    Phi, Q : (n, n)
        To ``t_ns``.
    t_ns : int
        GPST, ns.
    measure : callable
        All rows at a belief; called again after every group of the sequential form.
    rule : Adaptation
    memory : ndarray
        See `factors`.
    groups : sequence of sequence of int, optional
        Rows of each group: the sequential form. Without it all rows are taken at once.
    gate : sequence of float, optional
        Chi-square thresholds by degrees of freedom.

    Returns
    -------
    State, Innovation, Factors, ndarray
        The last is the memory for the next epoch.
    """
    faded = Phi @ state.P @ Phi.T
    ahead = State(t_ns, state.layout, Phi @ state.x, faded + Q)
    rows = measure(ahead)
    p, q = (np.einsum("mi,ij,mj->m", rows.H, A, rows.H) for A in (faded, Q))
    change = ahead.x - state.x
    beta = rule.eta * float((change[:3] ** 2).sum()) if rule.kind == "paper" and rule.eta > 0.0 else 0.0
    found, r, later = factors(rule, memory, rows.v, p, q, rows.r, beta)
    P = found.fading * faded + found.q_factor * Q
    ahead = State(t_ns, state.layout, ahead.x, 0.5 * (P + P.T))
    if groups is None:
        updated, innovation = ekf.update(
            ahead, Linear(rows.v, rows.H, r, rows.row), None if gate is None else float(gate[1])
        )
        return updated, innovation, found, later

    def linearise(belief: State, group: int) -> Linear:
        now, at = measure(belief), np.asarray(groups[group], dtype=np.intp)
        return Linear(now.v[at], now.H[at], r[at], now.row[at])

    updated, innovation = s3ekf.update(ahead, linearise, range(len(groups)), gate)
    return updated, innovation, found, later
