"""Measurement update with correlated errors: satellite by satellite, two codes and a rate each.

The rows of a satellite are taken one after the other (code, second code, rate) on innovations conditioned on all
that was accepted before, then the state is corrected once with what was accepted: with S = L L' grown row by row,

    W = L^-1 H P,    y = L^-1 v,    x += W' y,    P -= W' W,

a rank-3 correction of the upper triangle of P in one pass over the memory, which is what an update of some 200 states
costs. H is sparse: a code touches about a dozen states.
"""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.constants import ROW_USED
from starwise.kernels._jit import njit
from starwise.kernels.error_states import (
    EAST,
    IONOSPHERE,
    N_SKY,
    NORTH,
    SIGNAL,
    SLOPE,
    SLOW,
    TROPOSPHERE,
    VERTICAL,
    ErrorModel,
    ErrorRows,
    Slots,
    adapt_scale,
    enter_satellites,
    motion_rate_variance,
    n_errors,
    reset_errors,
    shell_mapping,
    shell_offset,
    signal_sigmas,
)
from starwise.kernels.filter_epoch import arrange, linearise, tally
from starwise.kernels.filter_state import Belief, FilterOptions, Work
from starwise.kernels.rangemodel import F_L1, RowModel, Rows
from starwise.kernels.update import USED_CODE, USED_RATE

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

K_MAX = 20  # non-zeros of a row
UPPER_BAND_HZ = 1.4e9


@njit
def _add(idx: I8, val: F8, k: int, element: int, value: float) -> int:
    idx[k] = element
    val[k] = value
    return k + 1


@njit
def code_states(
    errors: ErrorModel, rows: Rows, extra: ErrorRows, out: RowModel, i: int, second: bool, base: int, slot: int,
    scale: float, idx: I8, val: F8,
) -> tuple[int, float, float]:  # fmt: skip
    """Error states that a code of row i sees, from entry 4 of idx and val on; end, white variance, scaled part."""
    el, az = out.elevation[i], out.azimuth[i]
    freq, cn0 = rows.freq_hz[i], rows.cn0_dbhz[i]
    if second:
        freq, cn0 = extra.freq2_hz[i], extra.cn02_dbhz[i]
    system = rows.system[i]
    first = base + N_SKY + errors.n_bias + slot * errors.block
    white, multipath, part = signal_sigmas(errors, system, el, cn0, rows.noise_factor[i], scale)
    s = max(math.sin(el), 0.05)
    k = _add(idx, val, 4, first + SLOW, extra.slow_m[i])
    k = _add(idx, val, k, base + TROPOSPHERE, errors.troposphere / (s + 0.02))
    if freq < 1e12:
        mapping, offset = shell_mapping(el), shell_offset(el)
        g = (F_L1 / freq) ** 2
        model = out.ionosphere[i] * (rows.freq_hz[i] / F_L1) ** 2  # slant, on L1
        vertical = model / mapping
        k = _add(idx, val, k, first + IONOSPHERE, g * math.hypot(
            errors.ionosphere_fraction * model, errors.ionosphere_floor * mapping))  # fmt: skip
        sigma = math.hypot(errors.vertical_fraction * vertical, errors.vertical_floor)
        if model == 0.0:
            sigma = max(sigma, errors.vertical_unknown)  # no model: the whole delay is an error
        k = _add(idx, val, k, base + VERTICAL, g * mapping * sigma)
        sigma = math.hypot(errors.gradient_fraction * vertical, errors.gradient_floor) * offset
        k = _add(idx, val, k, base + NORTH, g * mapping * sigma * math.cos(az))
        k = _add(idx, val, k, base + EAST, g * mapping * sigma * math.sin(az))
    band = 0 if freq > UPPER_BAND_HZ else 1
    factor = rows.noise_factor[i]  # above one: combination of two signals, independent in what follows
    k = _add(idx, val, k, base + SLOPE + band, factor * errors.slope * (1.0 / max(s, 0.1) - 1.5))
    bias = extra.bias2[i] if second else extra.bias1[i]
    if bias >= 0:
        k = _add(idx, val, k, base + N_SKY + bias, errors.receiver_bias)
    sigma = factor * errors.signal_bias[system]
    k = _add(idx, val, k, first + (errors.signal2 if second else SIGNAL), sigma)
    state = errors.multipath2 if second else errors.multipath1
    if state >= 0:
        k = _add(idx, val, k, first + state, multipath)
    else:
        white += multipath * multipath
    return k, white, part


@njit
def predicted_errors(
    errors: ErrorModel, rows: Rows, extra: ErrorRows, out: RowModel, m: int, x: F8, base: int, slots: Slots,
    scale: float, work: Work,
) -> None:  # fmt: skip
    """Sum of the lasting errors of the first code of each satellite in ``work.order``, into ``work.lasting``; m."""
    idx, val = np.zeros(K_MAX, np.int64), np.zeros(K_MAX)
    for q in range(m):
        i = work.order[q]
        count, _, _ = code_states(errors, rows, extra, out, i, False, base, slots.at[extra.sv[i]], scale, idx, val)
        total = 0.0
        for k in range(4, count):
            total += val[k] * x[idx[k]]
        work.lasting[i] = total


@njit
def _times_p(P: F8, n: int, idx: I8, val: F8, count: int, a: F8) -> None:
    """Product a = h P for a sparse row h; only the upper triangle of P is read."""
    for i in range(n):
        a[i] = 0.0
    end = np.uint64(n)
    for k in range(count):
        e, c = np.uint64(idx[k]), val[k]
        for i in range(e):
            a[i] += c * P[i, e]
        for i in range(e, end):  # unsigned: numba makes vector code only of indices that cannot be negative
            a[i] += c * P[e, i]


@njit
def _correct(x: F8, P: F8, n: int, W: F8, y: F8) -> None:
    """Correction x += W' y and P -= W' W (upper triangle) with three rows of W."""
    y0, y1, y2 = y[0], y[1], y[2]
    a, b, c = W[0], W[1], W[2]
    for i in range(n):
        x[i] += a[i] * y0 + b[i] * y1 + c[i] * y2
    end = np.uint64(n)
    for i in range(0, n - 1, 2):  # two rows at once: W is read half as often; one element below the diagonal is spoilt
        p, q = P[i], P[i + 1]
        a0, b0, c0 = a[i], b[i], c[i]
        a1, b1, c1 = a[i + 1], b[i + 1], c[i + 1]
        for j in range(np.uint64(i), end):  # unsigned: see `_times_p`
            p[j] -= a0 * a[j] + b0 * b[j] + c0 * c[j]
            q[j] -= a1 * a[j] + b1 * b[j] + c1 * c[j]
    if n % 2 == 1:
        i = n - 1
        P[i, i] -= a[i] * a[i] + b[i] * b[i] + c[i] * c[i]


@njit
def _stretch(t: float, late: float, early: float) -> float:
    """Factor on the variance of a normalised innovation t: 1 inside, t / limit outside (Huber's weight)."""
    limit = late if t > 0.0 else early
    return max(1.0, abs(t) / limit)


@njit
def satellite_rows(
    errors: ErrorModel, rows: Rows, extra: ErrorRows, out: RowModel, i: int, x: F8, nk: int, nc: int, c: int,
    slot: int, scale: float, speed2: float, idx: I8, val: F8, count: I8, v: F8, r: F8, part: F8,
) -> None:  # fmt: skip
    """Code of the first signal, of the second, and rate of row i at state x, as sparse rows; (3,) each.

    Parameters
    ----------
    c, slot : int
        Element of the satellite's clock; its slot.
    speed2 : float
        Squared speed that adds to the noise of rates, (m/s)^2.
    idx, val, count : (3, K_MAX), (3, K_MAX), (3,)
        Out: elements of the state that a row sees, and how; their number.
    v, r, part : (3,)
        Out: innovations (NaN: no such row), white variances, parts of them that the common factor scales.
    """
    base, moving = nk + 2 * nc, nk > 3
    v1, v2, ux, uy, uz, gx, gy, gz = linearise(rows, out, i, x, moving, c, c + nc)
    for b in range(2):
        idx[b, 0], idx[b, 1], idx[b, 2], idx[b, 3] = 0, 1, 2, c
        val[b, 0], val[b, 1], val[b, 2], val[b, 3] = -ux, -uy, -uz, 1.0
    count[0], r[0], part[0] = code_states(errors, rows, extra, out, i, False, base, slot, scale, idx[0], val[0])
    v[0], v[1], v[2] = v1, np.nan, v2
    if errors.dual and extra.code2_m[i] == extra.code2_m[i]:
        count[1], r[1], part[1] = code_states(errors, rows, extra, out, i, True, base, slot, scale, idx[1], val[1])
        iono2 = out.ionosphere[i] * (rows.freq_hz[i] / extra.freq2_hz[i]) ** 2
        v[1] = (
            v1 + (extra.code2_m[i] - rows.code_m[i]) + (extra.clock2_m[i] - rows.clock_m[i])
            - (iono2 - out.ionosphere[i])
        )  # fmt: skip
    for b in range(2):
        if v[b] == v[b]:
            for k in range(4, count[b]):
                v[b] -= val[b, k] * x[idx[b, k]]
    idx[2, 0], idx[2, 1], idx[2, 2], idx[2, 3] = 0, 1, 2, c + nc
    val[2, 0], val[2, 1], val[2, 2], val[2, 3] = gx, gy, gz, 1.0
    count[2] = 4
    if moving:
        idx[2, 4], idx[2, 5], idx[2, 6] = 3, 4, 5
        val[2, 4], val[2, 5], val[2, 6] = -ux, -uy, -uz
        count[2] = 7
    r[2] = out.rate_var[i] + motion_rate_variance(errors, rows.cn0_dbhz[i], speed2)
    if not r[2] < np.inf:
        v[2] = np.nan


@njit
def update_colored(
    options: FilterOptions, errors: ErrorModel, rows: Rows, extra: ErrorRows, out: RowModel, m: int,
    x: F8, P: F8, nk: int, nc: int, at: I8, slots: Slots, dt: float, x1: F8, work: Work,
) -> tuple[float, int]:  # fmt: skip
    """Update of x and P with the satellites in ``work.order``; NIS and its degrees of freedom.

    Sequential: each satellite is linearised at the state that the one before left (eq. 5c). Else all are at the
    prediction, which ``x1`` receives: the EKF, whose correction with all rows at once is the same as row by row.
    """
    base, moving = nk + 2 * nc, nk > 3
    n = base + n_errors(errors, slots)
    idx, val, count = np.zeros((3, K_MAX), np.int64), np.zeros((3, K_MAX)), np.zeros(3, np.int64)
    W, L, y = np.zeros((3, n)), np.zeros((3, 3)), np.zeros(3)
    v, r, part = np.zeros(3), np.zeros(3), np.zeros(3)
    total, weight = 0.0, 0.0
    for j in range(n):
        x1[j] = x[j]
    nis, dof, speed2 = 0.0, 0, 0.0
    if moving:
        speed2 = x[3] * x[3] + x[4] * x[4] + x[5] * x[5]
    for q in range(m):
        i = work.order[q]
        c = nk + at[rows.clock[i]]
        slot = slots.at[extra.sv[i]]
        at_x = x if options.sequential else x1
        satellite_rows(
            errors, rows, extra, out, i, at_x, nk, nc, c, slot, slots.scale[0], speed2, idx, val, count, v, r, part
        )
        bits, rank = 0, 0
        extra.used[i] = 0
        work.vo[q, 0], work.vo[q, 1], work.so[q, 0], work.so[q, 1] = v[0], np.nan, np.nan, np.nan
        for b in range(3):
            if v[b] != v[b]:
                continue
            t = v[b]
            if not options.sequential:
                for k in range(count[b]):
                    t -= val[b, k] * (x[idx[b, k]] - x1[idx[b, k]])
            a = W[rank]
            _times_p(P, n, idx[b], val[b], count[b], a)
            s = r[b]
            for k in range(count[b]):
                s += val[b, k] * a[idx[b, k]]
            vb, sb = t, s
            for j in range(rank):
                p = 0.0
                for k in range(count[b]):
                    p += val[b, k] * W[j, idx[b, k]]
                L[rank, j] = p
                vb -= p * y[j]
                sb -= p * p
            if sb > 0.0:
                stretch = _stretch(vb / math.sqrt(sb), errors.late if b < 2 else errors.early, errors.early)
            else:
                stretch = 1.0
            if b == 0:
                work.vo[q, 0], work.so[q, 0] = vb, sb
            elif b == 2:
                work.vo[q, 1], work.so[q, 1] = vb, sb
            else:
                extra.v2[i], extra.s2[i] = vb, sb
            if b < 2 and sb > 0.0:
                total += part[b] * min(vb * vb / sb, 9.0)
                weight += part[b]
            if not (sb > 0.0 and vb * vb <= options.gate1 * sb):
                continue
            nis += vb * vb / sb
            dof += 1
            inv = 1.0 / math.sqrt(sb * stretch)
            for j in range(rank):
                p = L[rank, j]
                for k in range(n):
                    a[k] -= p * W[j, k]
            for k in range(n):
                a[k] *= inv
            y[rank] = vb * inv
            rank += 1
            if b == 2:
                bits |= USED_RATE
            else:
                bits |= USED_CODE
                extra.used[i] |= np.uint8(1 + b)
        work.used[q] = bits
        if rank == 0:
            continue
        for b in range(rank, 3):
            y[b] = 0.0
            for k in range(n):
                W[b, k] = 0.0
        _correct(x, P, n, W, y)
    for i in range(base):
        for j in range(i):
            P[i, j] = P[j, i]
    adapt_scale(errors, slots, dt, total, weight)
    return nis, dof


START_SIGMA_M = 1000.0
"""Position and common clock of a start: so wide that the measurements decide, so narrow that ranges are linear."""


@njit
def start_colored(
    options: FilterOptions, errors: ErrorModel, rows: Rows, extra: ErrorRows, out: RowModel, start: int, end: int,
    nk: int, t_ns: int, xs: F8, vel: F8, tie: F8, tie_var: F8, doubt: float, belief: Belief, slots: Slots,
    x1: F8, work: Work,
) -> int:  # fmt: skip
    """Belief from the satellites that least squares used, weighted with the full covariance of their errors.

    The solution of least squares is only the point at which the ranges are made linear: its own covariance would
    count the same measurements twice, and without their common errors. Rates take part if its velocity was checked.

    Parameters
    ----------
    xs : (3 + n_clocks,)
        Position and clocks of least squares, NaN for clocks not seen.
    vel : (4,)
        Velocity and drift, NaN: not known.
    tie, tie_var : (n_clocks,)
        Each clock against the first one as known before, m, and its variance; NaN: not known. They count where there
        are too few satellites to estimate every clock; else the start would believe an offset that may have stepped.
    doubt : float
        Factor on the resulting covariance.

    Returns
    -------
    int
        Number of active clocks.
    """
    x, P, at = belief.x, belief.P, belief.at
    nc = 0
    for k in range(len(at)):
        at[k] = -1
        belief.missed[k] = 0
        if xs[3 + k] == xs[3 + k]:
            at[k] = nc
            belief.seen_ns[k] = t_ns
            nc += 1
    base = nk + 2 * nc
    usable, first = 0, -1
    for i in range(start, end):
        usable += 1 if out.status[i] == ROW_USED else 0
    for i in range(base):
        x[i] = 0.0
        for j in range(base):
            P[i, j] = 0.0
    known = vel[0] == vel[0]
    for i in range(3):
        x[i] = xs[i]
        P[i, i] = START_SIGMA_M**2
        if nk > 3:
            x[3 + i] = vel[i] if known else 0.0
            P[3 + i, 3 + i] = options.velocity_sigma0**2
        if nk > 6:
            P[6 + i, 6 + i] = options.acceleration_sigma0**2
    for k in range(len(at)):
        if at[k] < 0:
            continue
        c = nk + at[k]
        x[c] = xs[3 + k]
        x[c + nc] = vel[3] if vel[3] == vel[3] else 0.0
        for j in range(nc):
            P[c, nk + j] = START_SIGMA_M**2
            P[c + nc, nk + nc + j] = options.drift_sigma0**2
        if first < 0 and tie[k] == tie[k]:
            first = k
        if usable < 3 + nc and first >= 0 and tie[k] == tie[k]:
            x[c] = xs[3 + first] + (tie[k] - tie[first])
            P[c, c] += tie_var[k]
        else:
            P[c, c] += options.intersystem_sigma0**2
        P[c + nc, c + nc] += options.intersystem_drift_sigma0**2
    for i in range(start, end):
        if not known or out.rate_used[i] == 0:
            out.rate_var[i] = np.inf
    m = arrange(rows, out, start, end, work)
    reset_errors(errors, slots, x, P, base)
    enter_satellites(errors, extra, work.order, m, t_ns, slots, x, P, base)
    update_colored(options, errors, rows, extra, out, m, x, P, nk, nc, at, slots, 0.0, x1, work)
    tally(rows, out, m, at, work)
    if doubt > 1.0:
        n = base + n_errors(errors, slots)
        for i in range(n):
            for j in range(n):
                P[i, j] *= doubt
    return nc
