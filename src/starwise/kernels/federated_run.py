"""A federated filter over linear measurements, epoch by epoch; the equations are in `starwise.kernels.federated`."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.federated import (
    LOCAL_ABSENT,
    LOCAL_JUMPED,
    LOCAL_OUT,
    LOCAL_USED,
    Locals,
    Options,
    auto_shares,
    forget_private,
    fuse,
    predict_local,
    share_out,
    update_row,
)
from starwise.kernels.federated_isolation import isolate

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]


class Measured(NamedTuple):
    """Linear rows by epoch and local filter: rows offsets[e, i] : offsets[e, i + 1], uncorrelated."""

    offsets: I8  # (n_epochs, K + 1)
    present: Bool  # (n_epochs, K) False: the local filter is switched off in that epoch
    z: F8  # (m,)
    r: F8  # (m,)
    H: F8  # (m, n_max)


class FederatedOut(NamedTuple):
    """Results per epoch."""

    x: F8  # (n_epochs, nc)
    P: F8  # (n_epochs, nc, nc)
    status: I8  # (n_epochs, K) LOCAL_*
    separation: F8  # (n_epochs, K) statistic, chi-square with `test_states` degrees of freedom; NaN: not tested
    nis: F8  # (n_epochs, K)
    share: F8  # (n_epochs, K)


@njit
def _shares(options: Options, P: F8, active: Bool, share: F8) -> None:
    """Shares of the local filters that are ``active``, sum 1."""
    if options.auto_share:
        auto_shares(P, active, options.least_share, share)
        return
    total = 0.0
    for k in range(len(active)):
        share[k] = options.share[k] if active[k] else 0.0
        total += share[k]
    for k in range(len(active)):
        share[k] /= max(total, 1e-300)


@njit
def _copy(x: F8, P: F8, x_to: F8, P_to: F8) -> None:
    for i in range(len(x)):
        x_to[i] = x[i]
        for j in range(len(x)):
            P_to[i, j] = P[i, j]


@njit
def _update(x: F8, P: F8, n: int, rows: Measured, e: int, k: int, w: F8) -> float:
    """All rows of a local filter in an epoch, one at a time; their normalised innovation squared."""
    nis = 0.0
    for i in range(rows.offsets[e, k], rows.offsets[e, k + 1]):
        nis += update_row(x, P, n, rows.H[i], rows.z[i], rows.r[i], w)
    return nis


@njit
def federated_run(options: Options, locals_: Locals, rows: Measured, out: FederatedOut) -> None:
    """Fused common states of every epoch.

    Parameters
    ----------
    options : Options
    locals_ : Locals
        Beliefs at the epoch before the first; the last epoch's on return.
    rows : Measured
    out : FederatedOut
    """
    x, P, nc = locals_.x, locals_.P, options.nc
    K, width = x.shape[0], x.shape[1]
    A, B = np.zeros((width, width + 1)), np.zeros((width, width))
    w, x_g, P_g = np.zeros(width), np.zeros(nc), np.zeros((nc, nc))
    share = np.zeros(K)
    active, use = np.zeros(K, dtype=np.bool_), np.zeros(K, dtype=np.bool_)
    sharing = np.zeros(K, dtype=np.bool_)
    out_of, suspect = np.zeros(K, dtype=np.bool_), np.zeros(K, dtype=np.bool_)
    jumped = np.zeros(K, dtype=np.bool_)
    x_a, P_a, x_b, P_b = np.zeros(width), np.zeros((width, width)), np.zeros(width), np.zeros((width, width))
    failed, agreed = np.zeros(K, dtype=np.int64), np.zeros(K, dtype=np.int64)
    level = np.zeros((K, K, 2))
    known = False
    gates = len(options.innovation_gate)
    for e in range(rows.offsets.shape[0]):
        for k in range(K):
            active[k] = rows.present[e, k] and not out_of[k]
            # without reset every belief is fused, now or when it is back: the shares of all must stay one in sum
            sharing[k] = active[k] or not options.reset
        _shares(options, P, sharing, share)
        for k in range(K):
            out.share[e, k] = share[k]
            out.nis[e, k] = out.separation[e, k] = math.nan
            suspect[k] = jumped[k] = False
            if options.reset and known and active[k]:
                share_out(x[k], P[k], locals_.n[k], nc, x_g, P_g, share[k], A, B)
            # with reset, one that is not asked, or on probation, is predicted alone, with the noise of an equal share
            beta = share[k] if share[k] > 0.0 else 1.0 / K
            predict_local(x[k], P[k], locals_.n[k], nc, locals_.Phi[k], locals_.Q[k], beta, A)
            if not rows.present[e, k]:
                continue
            m = rows.offsets[e, k + 1] - rows.offsets[e, k]
            gate = options.innovation_gate[min(m, gates - 1)]
            _copy(x[k], P[k], x_b, P_b)
            nis = _update(x[k], P[k], locals_.n[k], rows, e, k, w)
            if m > 0 and nis > gate and locals_.n[k] > nc:
                # a receiver clock may jump: the same rows once more, nothing being known of the private states
                _copy(x[k], P[k], x_a, P_a)
                _copy(x_b, P_b, x[k], P[k])
                forget_private(x[k], P[k], locals_.n[k], nc, locals_.P0[k])
                again = _update(x[k], P[k], locals_.n[k], rows, e, k, w)
                jumped[k] = again <= gate
                if jumped[k]:
                    nis = again
                else:
                    _copy(x_a, P_a, x[k], P[k])
            out.nis[e, k] = nis
            suspect[k] = m > 0 and nis > gate
        for k in range(K):
            use[k] = active[k] if options.reset else not out_of[k] and (rows.present[e, k] or known)
        if options.test_states > 0:
            isolate(options, locals_, rows.present[e], use, suspect, level, failed, agreed, out_of, out.separation[e])
        if fuse(x, P, use, -1, nc, x_g, x_g, P_g, A, B):
            known = True
        for k in range(K):
            if jumped[k]:
                for j in range(K):
                    level[k, j, 1] = level[j, k, 1] = 0.0  # its clock differences begin anew
            status = LOCAL_USED if rows.present[e, k] else LOCAL_ABSENT
            if out_of[k]:
                status = LOCAL_OUT
            elif jumped[k]:
                status = LOCAL_JUMPED
            out.status[e, k] = status
        for i in range(nc):
            out.x[e, i] = x_g[i]
            for j in range(nc):
                out.P[e, i, j] = P_g[i, j]
        for k in range(K):
            # a filter that has just been taken out starts anew, about where the master is without it
            if out_of[k] and agreed[k] < 0:
                agreed[k] = 0
                for i in range(locals_.n[k]):
                    x[k, i] = x_g[i] if i < nc else locals_.x0[k, i]
                    for j in range(locals_.n[k]):
                        P[k, i, j] = locals_.P0[k, i, j]
