"""What a filter believes of an epoch before its first row is used: prediction, then the adaptation rule, if any.

The rule (`starwise.kernels.adapt`) sees every row at the prediction and answers before any is used, so that all at once
and satellite by satellite are the same filter. Of what it answers

- the fading factor multiplies Phi P Phi' of motion and clocks. Lasting errors of ranges have variances of their own,
  which no manoeuvre changes: with D = sqrt(fading) on motion and clocks and one on them, P = D Phi P Phi' D + Q, which
  stays positive definite;
- the factor on Q multiplies the noise of motion and clocks;
- the variances replace those of codes and rates where errors are white. Coloured ones have a scale and weights of their
  own (`starwise.kernels.colored`).

What the fading multiplies in the variance of a row is H Phi P Phi' H' of motion and clocks and, to first order, half of
their covariance with the lasting errors; the rest of it counts as noise of the row.
"""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.adapt import REJECTED, adapt
from starwise.kernels.colored import K_MAX, satellite_rows
from starwise.kernels.error_states import ErrorModel, ErrorRows, Slots, n_errors, predict_errors
from starwise.kernels.filter_epoch import linearise
from starwise.kernels.filter_state import FilterOptions, Work
from starwise.kernels.process import CURRENT, Process, add_noise, current_shape, motion, noise_shape, predict
from starwise.kernels.rangemodel import RowModel, Rows

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit
def advance(
    process: Process, errors: ErrorModel, slots: Slots, x: F8, P: F8, nk: int, nc: int, dt: float, dt_known: float,
    F: F8, G: F8, M: F8, phi: F8,
) -> float:  # fmt: skip
    """State and covariance ``dt`` s later, in place, lasting errors included; the dt that F and G are now for.

    Parameters
    ----------
    dt_known : float
        The dt that F and G (3, 3) are for.
    M : (3, 3)
        Out: shape of the driving noise.
    phi : (>= n,)
        Work space.
    """
    if dt != dt_known:
        motion(process.kind, dt, process.tau_s, F, G)
    if process.kind == CURRENT:
        current_shape(process, x, M)
    else:
        noise_shape(process, x[0], x[1], x[2], M)
    predict(x, P, nk, nc, dt, process, F, G, M)
    if errors.on:
        predict_errors(errors, slots, x, P, nk, nc, dt, F, phi)
    return dt


@njit
def _split(P: F8, Q: F8, n: int, idx: I8, val: F8, count: int) -> tuple[float, float, float]:
    """Variance H P H' of a sparse row: what fading multiplies, what is of Q, and the rest; states below n may fade."""
    moving, lasting, both, q = 0.0, 0.0, 0.0, 0.0
    for a in range(count):
        for b in range(count):
            i, j = min(idx[a], idx[b]), max(idx[a], idx[b])  # of lasting errors only the upper triangle counts
            h = val[a] * val[b]
            if j < n:
                moving += h * P[i, j]
                q += h * Q[i, j]
            elif i < n:
                both += h * P[i, j]
            else:
                lasting += h * P[i, j]
    return max(moving - q + 0.5 * both, 0.0), q, max(lasting + 0.5 * both, 0.0)


@njit
def adapt_epoch(
    options: FilterOptions, process: Process, errors: ErrorModel, rows: Rows, extra: ErrorRows, out: RowModel, m: int,
    x: F8, P: F8, nk: int, nc: int, at: I8, slots: Slots, dt: float, G: F8, M: F8, memory: F8, work: Work,
) -> None:  # fmt: skip
    """Predicted covariance and measurement variances as the rule has them, in place.

    Parameters
    ----------
    m : int
        Rows in ``work.order``.
    x, P
        Prediction, clocks of the epoch active.
    dt, G, M
        As `starwise.kernels.process.predict` took them.
    memory : (k,)
        Of the rule; see `starwise.kernels.adapt.adapt`.
    """
    base, moving = nk + 2 * nc, nk > 3
    Q = np.zeros((base, base))
    add_noise(Q, nk, nc, dt, process, G, M)
    idx, val, count = np.zeros((3, K_MAX), np.int64), np.zeros((3, K_MAX)), np.zeros(3, np.int64)
    vs, rs, part = np.full(3, np.nan), np.zeros(3), np.zeros(3)
    v, p, q, r, use = np.zeros(3 * m), np.zeros(3 * m), np.zeros(3 * m), np.zeros(3 * m), np.zeros(3 * m)
    speed2 = x[3] * x[3] + x[4] * x[4] + x[5] * x[5] if moving else 0.0
    for k in range(m):
        i = work.order[k]
        c = nk + at[rows.clock[i]]
        if errors.on:
            slot = slots.at[extra.sv[i]]
            satellite_rows(
                errors, rows, extra, out, i, x, nk, nc, c, slot, slots.scale[0], speed2, idx, val, count, vs, rs, part
            )
        else:
            vs[0], vs[2], ux, uy, uz, gx, gy, gz = linearise(rows, out, i, x, moving, c, c + nc)
            idx[0, 0], idx[0, 1], idx[0, 2], idx[0, 3] = 0, 1, 2, c
            val[0, 0], val[0, 1], val[0, 2], val[0, 3] = -ux, -uy, -uz, 1.0
            idx[2, 0], idx[2, 1], idx[2, 2], idx[2, 3], idx[2, 4], idx[2, 5], idx[2, 6] = 0, 1, 2, c + nc, 3, 4, 5
            val[2, 0], val[2, 1], val[2, 2], val[2, 3] = gx, gy, gz, 1.0
            val[2, 4], val[2, 5], val[2, 6] = -ux, -uy, -uz
            count[0], count[2] = 4, 7 if moving else 4
            rs[0], rs[2] = out.code_var[i], out.rate_var[i]
            if not rs[2] < np.inf:
                vs[2] = np.nan
        for b in range(3):
            j = 3 * k + b
            v[j], r[j] = vs[b], rs[b]
            if vs[b] == vs[b]:
                p[j], q[j], rest = _split(P, Q, base, idx[b], val[b], count[b])
                r[j] += rest
    found = adapt(options.rule, memory, v, p, q, r, 0.0, use)
    if not errors.on:
        for k in range(m):
            i = work.order[k]
            out.code_var[i] = use[3 * k] if use[3 * k] < 0.1 * REJECTED * r[3 * k] else np.inf
            if v[3 * k + 2] == v[3 * k + 2]:
                out.rate_var[i] = use[3 * k + 2] if use[3 * k + 2] < 0.1 * REJECTED * r[3 * k + 2] else np.inf
    if found.fading == 1.0 and found.q_factor == 1.0:
        return
    root = math.sqrt(found.fading)
    n = base + n_errors(errors, slots)
    for i in range(base):
        for j in range(i + 1):
            P[i, j] = found.fading * P[i, j] + (found.q_factor - found.fading) * Q[i, j]
            P[j, i] = P[i, j]
        for j in range(base, n):
            P[i, j] *= root
            P[j, i] = P[i, j]
