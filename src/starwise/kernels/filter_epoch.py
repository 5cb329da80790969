"""Measurement update of one epoch: EKF with all satellites at once, or S3EKF satellite by satellite (eq. 5c).

The satellites of an epoch are taken in the order of their measurement variance, the best first, so that the first
decisions of the gate rest on the best measurements, and the order of rows in a file has no influence.
"""

import numpy as np
from numpy.typing import NDArray

from starwise.constants import C_LIGHT, OMEGA_E_GPS, ROW_GATED, ROW_USED
from starwise.kernels._jit import njit
from starwise.kernels.filter_state import FilterOptions, Work
from starwise.kernels.rangemodel import RowModel, Rows, range_los, range_rate
from starwise.kernels.update import (
    USED_CODE,
    USED_RATE,
    mirror,
    update_batch,
    update_satellite,
    update_sequential,
)

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]


SAGNAC = OMEGA_E_GPS / C_LIGHT


@njit
def code_innovation(rows: Rows, out: RowModel, i: int, x: F8, c: int, lasting: F8) -> float:
    """Innovation of the code of row i at state x, clock at element c, with the lasting errors of rows; m."""
    rho, sagnac, _, _, _ = range_los(x[0], x[1], x[2], rows.sat_pos[i, 0], rows.sat_pos[i, 1], rows.sat_pos[i, 2])
    return float(
        rows.code_m[i] - (rho + sagnac + x[c] - rows.clock_m[i] + out.troposphere[i] + out.ionosphere[i]) - lasting[i]
    )


@njit
def linearise(
    rows: Rows, out: RowModel, i: int, x: F8, moving: bool, c: int, d: int
) -> tuple[float, float, float, float, float, float, float, float]:
    """Innovations of code and rate of row i at state x, and the Jacobian of both.

    Returns v_code, v_rate; -d code / d pos = -d rate / d vel (the unit vector plus the Sagnac term's gradient);
    d rate / d pos = -(v_rel - (u . v_rel) u) / rho + its Sagnac part. Groves (2013) 9.162 differentiated.
    """
    sx, sy = rows.sat_pos[i, 0], rows.sat_pos[i, 1]
    wx, wy, wz = rows.sat_vel[i, 0], rows.sat_vel[i, 1], rows.sat_vel[i, 2]
    rho, sagnac, ux, uy, uz = range_los(x[0], x[1], x[2], sx, sy, rows.sat_pos[i, 2])
    out.geometric[i], out.sagnac[i] = rho, sagnac
    v1 = rows.code_m[i] - (rho + sagnac + x[c] - rows.clock_m[i] + out.troposphere[i] + out.ionosphere[i])
    vx, vy, vz = 0.0, 0.0, 0.0
    if moving:
        vx, vy, vz = x[3], x[4], x[5]
    rate = range_rate(x[0], x[1], vx, vy, vz, ux, uy, uz, rows.sat_pos, rows.sat_vel, i)
    v2 = rows.rate_mps[i] - (rate + x[d] - rows.drift_mps[i])
    along = ux * (wx - vx) + uy * (wy - vy) + uz * (wz - vz)
    gx = (along * ux - (wx - vx)) / rho - SAGNAC * wy
    gy = (along * uy - (wy - vy)) / rho + SAGNAC * wx
    gz = (along * uz - (wz - vz)) / rho
    return v1, v2, ux + SAGNAC * sy, uy - SAGNAC * sx, uz, gx, gy, gz


@njit
def arrange(rows: Rows, out: RowModel, start: int, end: int, work: Work) -> int:
    """Usable rows of an epoch, the smallest code variance first, into ``work.order``; their number."""
    m = 0
    for i in range(start, end):
        out.rate_used[i] = 0
        out.v_code[i], out.s_code[i], out.v_rate[i], out.s_rate[i] = np.nan, np.nan, np.nan, np.nan
        if out.status[i] != ROW_USED:
            continue
        j = m - 1
        while j >= 0 and out.code_var[work.order[j]] > out.code_var[i]:
            work.order[j + 1] = work.order[j]
            j -= 1
        work.order[j + 1] = i
        m += 1
    return m


@njit
def _update_linear(
    options: FilterOptions, rows: Rows, out: RowModel, m: int, x: F8, P: F8, nk: int, nc: int, at: I8,
    x1: F8, work: Work,
) -> tuple[float, int]:  # fmt: skip
    """Update of x, P with rows linearised at another state x1: v = z - h(x1) - H (x - x1). NIS and its degrees."""
    n, moving = nk + 2 * nc, nk > 3
    for j in range(n):
        work.dx[j] = x[j] - x1[j]
    for k in range(m):
        i = work.order[k]
        work.ic[k] = nk + at[rows.clock[i]]
        work.idr[k] = work.ic[k] + nc
        v1, v2, ux, uy, uz, gx, gy, gz = linearise(rows, out, i, x1, moving, work.ic[k], work.idr[k])
        work.u[k, 0], work.u[k, 1], work.u[k, 2] = ux, uy, uz
        work.g[k, 0], work.g[k, 1], work.g[k, 2] = gx, gy, gz
        refused = not out.code_var[i] < np.inf
        work.v[k, 0], work.v[k, 1] = np.nan if refused else v1, v2
        work.r[k, 0] = 1.0 if refused else out.code_var[i]
        work.r[k, 1] = out.rate_var[i] if v2 == v2 else np.inf
    if options.sequential:
        nis, dof = update_sequential(
            work.dx, P, n, moving, work.ic, work.idr, work.u, work.g, work.v, work.r, m,
            options.gate1, options.gate2, work.vo, work.so, work.used,
        )  # fmt: skip
    else:
        nis, dof = update_batch(
            work.dx, P, n, moving, work.ic, work.idr, work.u, work.g, work.v, work.r, m,
            options.gate1, options.gate2, work.vo, work.so, work.used,
        )  # fmt: skip
    for j in range(n):
        x[j] = x1[j] + work.dx[j]
    return nis, dof


@njit
def _update_satellites(
    options: FilterOptions, rows: Rows, out: RowModel, m: int, x: F8, P: F8, nk: int, nc: int, at: I8, work: Work
) -> tuple[float, int]:
    """Eq. 5c for all satellites: h and H at the state that the satellite before has left. NIS and its degrees."""
    n, moving = nk + 2 * nc, nk > 3
    nis, dof = 0.0, 0
    for k in range(m):
        i = work.order[k]
        c = nk + at[rows.clock[i]]
        d = c + nc
        v1, v2, ux, uy, uz, gx, gy, gz = linearise(rows, out, i, x, moving, c, d)
        r2 = out.rate_var[i] if v2 == v2 else np.inf
        refused = not out.code_var[i] < np.inf  # by a rule: no innovation passes
        r1 = 1.0 if refused else out.code_var[i]
        bits, q, s1, s2 = update_satellite(
            x, P, n, moving, c, d, ux, uy, uz, gx, gy, gz, np.nan if refused else v1, v2, r1, r2,
            options.gate1, options.gate2, work.a, work.b,
        )  # fmt: skip
        work.used[k] = bits
        work.vo[k, 0], work.vo[k, 1], work.so[k, 0], work.so[k, 1] = v1, v2 if r2 < np.inf else np.nan, s1, s2
        nis += q
        dof += (bits & 1) + (bits >> 1)
    mirror(P, n)
    return nis, dof


@njit
def update_epoch(
    options: FilterOptions, rows: Rows, out: RowModel, m: int, x: F8, P: F8, nk: int, nc: int, at: I8,
    x2: F8, P2: F8, work: Work,
) -> tuple[float, int]:  # fmt: skip
    """Measurement update of one epoch with the rows in ``work.order``; x and P in place, row outputs in ``work``.

    If it moves the position by more than 20 m, it is done once more from the prediction with the rows linearised at
    its result (iterated EKF, Groves 3.4.1): what the curvature of the ranges leaves, 20^2 / (2 rho), is 0.01 mm.

    Returns
    -------
    nis : float
        Sum over the used rows.
    dof : int
        Their number.
    """
    n = nk + 2 * nc
    for i in range(n):
        x2[i] = x[i]
        for j in range(n):
            P2[i, j] = P[i, j]
    if options.sequential:
        nis, dof = _update_satellites(options, rows, out, m, x, P, nk, nc, at, work)
    else:
        nis, dof = _update_linear(options, rows, out, m, x, P, nk, nc, at, x2, work)
    dx, dy, dz = x[0] - x2[0], x[1] - x2[1], x[2] - x2[2]
    if dx * dx + dy * dy + dz * dz > 400.0:
        for i in range(n):
            x[i], x2[i] = x2[i], x[i]
            for j in range(n):
                P[i, j] = P2[i, j]
        nis, dof = _update_linear(options, rows, out, m, x, P, nk, nc, at, x2, work)
    return nis, dof


@njit
def tally(rows: Rows, out: RowModel, m: int, at: I8, work: Work) -> tuple[int, bool, int]:
    """Row outputs of an update from ``work``, and its judgement.

    Returns
    -------
    n_used : int
        Satellites whose code was used.
    agreed : bool
        More than half of the codes were used, and half of the rates where there are four or more (a receiver that
        moves under a static model shows in its rates first). Where five or more codes were used, a system of which
        none was does not count: its clock stepped, and `activate_clocks` will see to it. Where there were five or
        more codes and fewer than four were used, nothing says that these are the right ones.
    n_clocks : int
        Receiver clocks of the codes used.
    """
    n_used, n_rates, n_rates_used = 0, 0, 0
    for k in range(m):
        i = work.order[k]
        n_rates += 1 if work.so[k, 1] == work.so[k, 1] else 0
        n_rates_used += 1 if work.used[k] & USED_RATE else 0
        out.v_code[i], out.v_rate[i] = work.vo[k, 0], work.vo[k, 1]
        out.s_code[i], out.s_rate[i] = work.so[k, 0], work.so[k, 1]
        out.rate_used[i] = 1 if work.used[k] & USED_RATE else 0
        if work.used[k] & USED_CODE:
            out.status[i] = ROW_USED
            n_used += 1
        else:
            out.status[i] = ROW_GATED
    n_all, n_clocks = m, 0
    for c in range(len(at)):
        count, any_used = 0, False
        for k in range(m):
            if rows.clock[work.order[k]] == c:
                count += 1
                if work.used[k] & USED_CODE:
                    any_used = True
        if any_used:
            n_clocks += 1
        elif n_used >= 5:
            n_all -= count
    agreed = 2 * n_used > n_all and (m < 5 or n_used >= 4) and (n_rates < 4 or 2 * n_rates_used >= n_rates)
    return n_used, agreed, n_clocks
