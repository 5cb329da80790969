"""Fusing, sharing and testing beliefs of local filters, by the names of their states.

Local filters may be of any kind, with any states of their own; what they have in common is named. The equations are
in `starwise.kernels.federated`.
"""

from collections.abc import Sequence

import numpy as np

from starwise.kernels import federated as kernel
from starwise.kernels import federated_isolation
from starwise.types import F8, Layout, State


def fuse_states(beliefs: Sequence[State], common: Sequence[str], base: F8 | None = None) -> State:
    """Fused belief of the common states, information added about a common base.

    Law: beliefs that share one prior and one process noise (`share_state`) and saw different measurements give the
    belief of the filter that saw them all.

    Parameters
    ----------
    beliefs : sequence of State
        Of one time.
    common : sequence of str
        Names that every layout has.
    base : (n,) float64, optional
        Point from which deviations count; the first belief's mean without.

    Raises
    ------
    ValueError
        No belief, beliefs of different times, or a singular covariance.
    """
    x, P = _stacked(beliefs, common)
    n = len(common)
    x_g, P_g = np.zeros(n), np.zeros((n, n))
    about = x[0].copy() if base is None else np.asarray(base, dtype=np.float64)
    use = np.ones(len(beliefs), dtype=np.bool_)
    if not kernel.fuse(x, P, use, -1, n, about, x_g, P_g, np.zeros((n, n)), np.zeros((n, n))):
        raise ValueError("a covariance of the common states is singular")
    return State(beliefs[0].t_ns, Layout(tuple(common)), x_g, P_g)


def share_state(belief: State, fused: State, share: float) -> State:
    """Belief of a local filter that takes the master's common states with covariance P_g / share.

    Its private states keep their regression on the common ones.

    Raises
    ------
    ValueError
        A share that is not positive, or a singular covariance.
    """
    if not share > 0.0:
        raise ValueError(f"share {share} is not positive")
    private = [name for name in belief.layout.names if name not in fused.layout]
    order = Layout((*fused.layout.names, *private))
    local = belief.moved_to(order)
    n, nc = len(order), len(fused.layout)
    x, P = local.x.copy(), local.P.copy()
    if not kernel.share_out(x, P, n, nc, fused.x, fused.P, share, np.zeros((n, n)), np.zeros((n, n))):
        raise ValueError("the covariance of the common states is singular")
    return State(belief.t_ns, order, x, P).moved_to(belief.layout)


def shares(beliefs: Sequence[State], common: Sequence[str], least: float = 0.1) -> F8:
    """Shares by the information of each belief's first three common states, sum 1.

    Parameters
    ----------
    beliefs, common
        As in `fuse_states`.
    least : float
        No share is below this part of an equal one: a filter that knows little must not be given so little that its
        shared noise drowns it.
    """
    _, P = _stacked(beliefs, common)
    out = np.zeros(len(beliefs))
    kernel.auto_shares(P, np.ones(len(beliefs), dtype=np.bool_), least, out)
    return out


def separations(beliefs: Sequence[State], common: Sequence[str], tested: int = 3) -> F8:
    """Squared distance of every belief from the fusion of the others, over both covariances.

    Chi-square with ``tested`` degrees of freedom (the leading common states) where errors are as claimed; NaN where
    there is nothing to compare with.
    """
    x, P = _stacked(beliefs, common)
    every, out = np.ones(len(beliefs), dtype=np.bool_), np.empty(len(beliefs))
    federated_isolation.separations(x, P, every, every, len(common), tested, out)
    return out


def _stacked(beliefs: Sequence[State], common: Sequence[str]) -> tuple[F8, F8]:
    if not beliefs or len({belief.t_ns for belief in beliefs}) > 1:
        raise ValueError("fusing takes beliefs of one time")
    moved = [belief.moved_to(Layout(tuple(common))) for belief in beliefs]
    return np.stack([b.x for b in moved]), np.stack([b.P for b in moved])
