"""Single point positioning by weighted least squares, epoch by epoch, from a cold start at the Earth's centre."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    EPOCH_NO_SOLUTION,
    EPOCH_OK,
    EPOCH_SUSPECT,
    ROW_EPOCH_UNSOLVED,
    ROW_EXCLUDED,
    ROW_USED,
)
from starwise.kernels._jit import njit
from starwise.kernels.linalg import cholesky, cholesky_inverse, cholesky_solve
from starwise.kernels.rangemodel import (
    Epochs,
    ModelOptions,
    RowModel,
    Rows,
    epoch_corrections,
    range_los,
)
from starwise.kernels.spp_rates import fill, predicted_variance, spp_velocity, threshold

F8 = NDArray[np.float64]
I4 = NDArray[np.int32]
U1 = NDArray[np.uint8]

MIN_RADIUS_M = 6.2e6  # a start nearer to the Earth's centre is a guess, not a place

FILTER_RATES_USED = 0  # rates take part in the filter
FILTER_RATES_WAIT = 1  # left out after a start until the codes alone have determined the velocity
FILTER_RATES_IGNORED = 2  # left out for good: they contradicted codes that agree with each other


class SppOptions(NamedTuple):
    """Numbers of the least-squares solution."""

    fde: bool  # fault detection and exclusion
    chi2: F8  # (k,) threshold of the residual test by degrees of freedom; the last serves all above
    local: F8  # (k,) threshold on the largest normalised residual by number of rows; the last serves all above
    max_gdop: float  # a geometry worse than this is flagged
    max_sigma_m: float  # a position more uncertain than this (3D, 1 sigma) is flagged
    max_excluded: float  # fraction of satellites; more exclusions than that flag the epoch, or end the velocity
    tie_sigma_m: float  # growth of a held inter-system offset, m per sqrt(s); <= 0: never hold


class EpochOut(NamedTuple):
    """Outputs per epoch; clock columns as `Rows.clock`. Filters write the same."""

    pos: F8  # (m, 3) m
    vel: F8  # (m, 3) m/s
    cov_pos: F8  # (m, 3, 3)
    cov_vel: F8  # (m, 3, 3)
    clock: F8  # (m, n_clocks) m
    clock_var: F8  # (m, n_clocks) m^2
    drift: F8  # (m, n_clocks) m/s
    n_used: I4
    dop: F8  # (m, 4) GDOP PDOP HDOP VDOP
    nis: F8  # sum of squared normalised residuals (least squares) or innovations (filters)
    dof: I4
    status: U1
    rates: U1  # FILTER_RATES_*


@njit
def dops(out: RowModel, start: int, end: int, result: F8) -> None:
    """GDOP, PDOP, HDOP, VDOP of the used rows, one common clock (Groves 9.4.3); NaN below four satellites."""
    fill(result, np.nan)
    N = np.zeros((4, 4))
    h = np.empty(4)
    n = 0
    for i in range(start, end):
        if out.status[i] != ROW_USED:
            continue
        c = math.cos(out.elevation[i])
        h[0] = c * math.sin(out.azimuth[i])
        h[1] = c * math.cos(out.azimuth[i])
        h[2] = math.sin(out.elevation[i])
        h[3] = 1.0
        for a in range(4):
            for b in range(4):
                N[a, b] += h[a] * h[b]
        n += 1
    if n < 4 or not cholesky(N, 4):
        return
    Q = np.empty((4, 4))
    cholesky_inverse(N, Q, 4)
    horizontal = Q[0, 0] + Q[1, 1]
    result[0] = math.sqrt(horizontal + Q[2, 2] + Q[3, 3])
    result[1] = math.sqrt(horizontal + Q[2, 2])
    result[2] = math.sqrt(horizontal)
    result[3] = math.sqrt(Q[2, 2])


@njit
def _normal_equations(
    rows: Rows, start: int, end: int, x: F8, column: NDArray[np.int64], m: int,
    tie: F8, tie_var: F8, tied: bool, out: RowModel, N: F8, g: F8,
) -> None:  # fmt: skip
    """Weighted normal equations N dx = g of the used rows at x; residuals go to ``out.v_code``."""
    for a in range(m):
        g[a] = 0.0
        for b in range(m):
            N[a, b] = 0.0
    for i in range(start, end):
        if out.status[i] != ROW_USED:
            continue
        rho, sagnac, ux, uy, uz = range_los(
            x[0], x[1], x[2], rows.sat_pos[i, 0], rows.sat_pos[i, 1], rows.sat_pos[i, 2]
        )
        out.geometric[i], out.sagnac[i] = rho, sagnac
        clk = rows.clock[i]
        v = rows.code_m[i] - (rho + sagnac + x[3 + clk] - rows.clock_m[i] + out.troposphere[i] + out.ionosphere[i])
        out.v_code[i] = v
        w = 1.0 / out.code_var[i]
        c = column[clk]
        N[0, 0] += w * ux * ux
        N[1, 0] += w * uy * ux
        N[1, 1] += w * uy * uy
        N[2, 0] += w * uz * ux
        N[2, 1] += w * uz * uy
        N[2, 2] += w * uz * uz
        N[c, 0] -= w * ux
        N[c, 1] -= w * uy
        N[c, 2] -= w * uz
        N[c, c] += w
        g[0] -= w * ux * v
        g[1] -= w * uy * v
        g[2] -= w * uz * v
        g[c] += w * v
    if tied:
        # Differences of clocks known from earlier epochs, as observations against the first active clock.
        base = -1
        for k in range(len(column)):
            if column[k] < 0 or tie[k] != tie[k]:
                continue
            if base < 0:
                base = k
                continue
            w = 1.0 / (tie_var[k] + tie_var[base] + 1.0)
            v = (tie[k] - tie[base]) - (x[3 + k] - x[3 + base])
            a, b = column[base], column[k]
            N[a, a] += w
            N[b, b] += w
            N[b, a] -= w
            g[a] -= w * v
            g[b] += w * v


@njit
def _worst_row(
    rows: Rows, start: int, end: int, x: F8, column: NDArray[np.int64], Q: F8, out: RowModel
) -> tuple[int, float]:
    """Row with the largest normalised residual (Baarda's w-test), -1 if none is redundant, and |w|; ``s_code``."""
    worst, worst_w = -1, 0.0
    for i in range(start, end):
        if out.status[i] != ROW_USED:
            continue
        _, _, ux, uy, uz = range_los(x[0], x[1], x[2], rows.sat_pos[i, 0], rows.sat_pos[i, 1], rows.sat_pos[i, 2])
        s = out.code_var[i] - predicted_variance(ux, uy, uz, Q, column[rows.clock[i]])
        out.s_code[i] = max(s, 0.0)
        if s < 1e-6 * out.code_var[i]:
            continue  # the only satellite of its clock: nothing checks it
        w = abs(out.v_code[i]) / math.sqrt(s)
        if w > worst_w:
            worst, worst_w = i, w
    return worst, worst_w


@njit
def _excluded_rows(rows: Rows, start: int, end: int, x: F8, column: NDArray[np.int64], Q: F8, out: RowModel) -> None:
    """Residuals of excluded rows at the final solution, and the variances of them if the rows were sound."""
    for i in range(start, end):
        if out.status[i] != ROW_EXCLUDED:
            continue
        rho, sagnac, ux, uy, uz = range_los(
            x[0], x[1], x[2], rows.sat_pos[i, 0], rows.sat_pos[i, 1], rows.sat_pos[i, 2]
        )
        out.geometric[i], out.sagnac[i] = rho, sagnac
        out.v_code[i], out.s_code[i] = np.nan, np.nan
        clk = rows.clock[i]
        if column[clk] < 0:
            continue  # the last of its clock
        model = rho + sagnac + x[3 + clk] - rows.clock_m[i] + out.troposphere[i] + out.ionosphere[i]
        out.v_code[i] = rows.code_m[i] - model
        out.s_code[i] = out.code_var[i] + predicted_variance(ux, uy, uz, Q, column[clk])


@njit
def spp_epoch(
    model: ModelOptions, options: SppOptions, t_ns: int, rows: Rows, start: int, end: int,
    tie: F8, tie_var: F8, x: F8, P: F8, vel: F8, Pv: F8, numbers: F8, out: RowModel,
) -> int:  # fmt: skip
    """Position, clocks and velocity of one epoch by iterated weighted least squares.

    Residual-based fault detection and exclusion: while the weighted sum of squared residuals fails its chi-square
    test, or the largest normalised residual its own (Baarda's w-test: weak signals with large variances hide a single
    outlier from the sum), that satellite goes (Groves 17.4.1) and the epoch is solved again. If nothing can be solved
    without it, the last solution stands and is suspect.

    Parameters
    ----------
    tie, tie_var : (n_clocks,)
        Clock biases relative to each other known from before (NaN: not), m and m^2; used only when the epoch has
        too few satellites for that many clocks.
    x : (3 + n_clocks,)
        In: start (zeros: cold). Out: position (ECEF m) and clock biases (m; NaN for a clock not seen).
    P : (3 + n_clocks, 3 + n_clocks)
        Out: covariance; NaN rows for clocks not seen.
    vel, Pv : (4,), (4, 4)
        Out: see `spp_velocity`.
    numbers : (4,)
        Out: satellites used, degrees of freedom, weighted sum of squared residuals, ``RATES_*`` of the velocity.
    out : RowModel
        Out: rows of the epoch.

    Returns
    -------
    int
        ``EPOCH_OK``, ``EPOCH_SUSPECT`` or ``EPOCH_NO_SOLUTION``.
    """
    nc = len(tie)
    column = np.empty(nc, np.int64)
    N = np.empty((3 + nc, 3 + nc))
    Q = np.empty((3 + nc, 3 + nc))
    g = np.empty(3 + nc)
    excluded = np.zeros(end - start, np.bool_)
    kept = np.zeros(3 + nc)  # the solution before the last exclusion
    n_excluded, last, final = 0, -1, False
    fill(numbers, 0.0)
    fill(vel, np.nan)
    for a in range(3 + nc):
        for b in range(3 + nc):
            P[a, b] = np.nan
    for k in range(nc):
        if x[3 + k] != x[3 + k]:
            x[3 + k] = 0.0
    known = x[0] * x[0] + x[1] * x[1] + x[2] * x[2] > MIN_RADIUS_M**2
    solved = False
    tied = False
    n, m, sse = 0, 0, 0.0
    while True:
        moved = np.inf
        converged = False
        for _ in range(25):
            if moved > 1.0:
                # Atmosphere, elevation and weights do not change over a metre; they are most of the cost.
                epoch_corrections(model, t_ns, rows, start, end, x[0], x[1], x[2], known, out)
                moved = 0.0
                n = 0
                for k in range(nc):
                    column[k] = -1
                for i in range(start, end):
                    if excluded[i - start] and out.status[i] == ROW_USED:
                        out.status[i] = ROW_EXCLUDED
                    if out.status[i] == ROW_USED:
                        n += 1
                        column[rows.clock[i]] = 0
                m = 3
                n_ties = -1
                for k in range(nc):
                    if column[k] == 0:
                        column[k] = m
                        m += 1
                        n_ties += 1 if tie[k] == tie[k] else 0
                tied = n < m and n_ties > 0
                if n + (max(n_ties, 0) if tied else 0) < m:
                    break
            _normal_equations(rows, start, end, x, column, m, tie, tie_var, tied, out, N, g)
            if not cholesky(N, m):
                break
            cholesky_solve(N, g, m)
            step = math.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
            for a in range(3):
                x[a] += g[a]
            for k in range(nc):
                if column[k] >= 0:
                    x[3 + k] += g[column[k]]
            moved += step
            if not known:
                if step < 1e4:
                    known = True
                    moved = np.inf
                continue
            if step < 1e-4:
                converged = True
                break
        if not converged or not known:
            if last < 0 or final:
                break
            excluded[last - start] = False
            n_excluded -= 1
            for a in range(3 + nc):
                x[a] = kept[a]
            known, final = True, True
            continue
        solved = True
        cholesky_inverse(N, Q, m)
        _normal_equations(rows, start, end, x, column, m, tie, tie_var, tied, out, N, g)
        sse = 0.0
        for i in range(start, end):
            if out.status[i] == ROW_USED:
                sse += out.v_code[i] ** 2 / out.code_var[i]
        worst, worst_w = _worst_row(rows, start, end, x, column, Q, out)
        dof = n - m
        if final or not options.fde or dof < 2 or worst < 0:
            break
        if sse <= threshold(options.chi2, dof) and worst_w <= threshold(options.local, n):
            break
        for a in range(3 + nc):
            kept[a] = x[a]
        last = worst
        excluded[worst - start] = True
        n_excluded += 1
        solved = False
    if not solved:
        fill(x, np.nan)
        for i in range(start, end):
            if out.status[i] == ROW_USED or out.status[i] == ROW_EXCLUDED:
                out.status[i] = ROW_EPOCH_UNSOLVED
                out.geometric[i], out.sagnac[i], out.troposphere[i], out.ionosphere[i] = np.nan, np.nan, np.nan, np.nan
                out.v_code[i], out.s_code[i], out.v_rate[i], out.s_rate[i] = np.nan, np.nan, np.nan, np.nan
                out.rate_used[i] = 0
        return EPOCH_NO_SOLUTION
    if n_excluded > 0:
        _excluded_rows(rows, start, end, x, column, Q, out)
    dof = n - m
    numbers[0], numbers[1], numbers[2] = n, max(dof, 0), sse
    for a in range(3):
        for b in range(3):
            P[a, b] = Q[a, b]
    for k in range(nc):
        if column[k] < 0:
            x[3 + k] = np.nan
            continue
        for a in range(3):
            P[3 + k, a] = Q[column[k], a]
            P[a, 3 + k] = Q[column[k], a]
        for j in range(nc):
            if column[j] >= 0:
                P[3 + k, 3 + j] = Q[column[k], column[j]]
    numbers[3] = spp_velocity(
        options.fde, options.chi2, options.max_excluded, rows, start, end, x[0], x[1], x[2], vel, Pv, out
    )
    radius = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    if final or radius < MIN_RADIUS_M or dof < 1 or sse > threshold(options.chi2, dof):
        return EPOCH_SUSPECT
    if n_excluded > options.max_excluded * (n + n_excluded):
        return EPOCH_SUSPECT
    return EPOCH_OK


@njit
def spp_run(model: ModelOptions, options: SppOptions, epochs: Epochs, rows: Rows, ep: EpochOut, out: RowModel) -> None:
    """Least squares for all epochs of a run; each starts from the epoch before only to save iterations.

    Inter-system clock offsets are remembered and serve as observations in epochs that have too few satellites to
    estimate every clock, if ``options.tie_sigma_m`` is positive.
    """
    nc = ep.clock.shape[1]
    x = np.zeros(3 + nc)
    P = np.empty((3 + nc, 3 + nc))
    vel = np.empty(4)
    Pv = np.empty((4, 4))
    numbers = np.empty(4)
    tie = np.full(nc, np.nan)
    tie_var = np.full(nc, np.nan)
    now_tie = np.full(nc, np.nan)
    now_var = np.full(nc, np.nan)
    tie_at = np.zeros(nc)
    for e in range(len(epochs.t_ns)):
        start, end = epochs.offsets[e], epochs.offsets[e + 1]
        now = epochs.t_ns[e] * 1e-9
        for k in range(nc):
            now_tie[k], now_var[k] = tie[k], tie_var[k]
            if tie[k] == tie[k]:
                now_var[k] += options.tie_sigma_m**2 * (now - tie_at[k])
        if x[0] != x[0]:
            fill(x, 0.0)
        status = spp_epoch(
            model, options, epochs.t_ns[e], rows, start, end, now_tie, now_var, x, P, vel, Pv, numbers, out
        )
        if status == EPOCH_NO_SOLUTION:
            # A start taken from a wrong place could be why: once more from the Earth's centre.
            fill(x, 0.0)
            status = spp_epoch(
                model,
                options,
                epochs.t_ns[e],
                rows,
                start,
                end,
                now_tie,
                now_var,
                x,
                P,
                vel,
                Pv,
                numbers,
                out,
            )
        ep.status[e] = status
        ep.n_used[e], ep.dof[e], ep.nis[e] = int(numbers[0]), int(numbers[1]), numbers[2]
        if status == EPOCH_NO_SOLUTION:
            continue
        dops(out, start, end, ep.dop[e])
        if not ep.dop[e, 0] <= options.max_gdop:
            ep.status[e] = EPOCH_SUSPECT
        if not P[0, 0] + P[1, 1] + P[2, 2] <= options.max_sigma_m**2:
            ep.status[e] = EPOCH_SUSPECT
        # Element by element: assigning slices brings numba's error texts along, seconds of compile time.
        for a in range(3):
            ep.pos[e, a] = x[a]
            ep.vel[e, a] = vel[a]
            for b in range(3):
                ep.cov_pos[e, a, b] = P[a, b]
                if vel[0] == vel[0]:
                    ep.cov_vel[e, a, b] = Pv[a, b]
        for k in range(nc):
            ep.clock[e, k] = x[3 + k]
            ep.clock_var[e, k] = P[3 + k, 3 + k]
            if x[3 + k] == x[3 + k]:
                ep.drift[e, k] = vel[3]
        if ep.status[e] == EPOCH_OK and options.tie_sigma_m > 0.0:
            _remember(x, P, nc, now, tie, tie_var, tie_at)


@njit
def _remember(x: F8, P: F8, nc: int, now: float, tie: F8, tie_var: F8, tie_at: F8) -> None:
    """Keep the clocks of a good epoch relative to the first of them."""
    base = -1
    for k in range(nc):
        if x[3 + k] != x[3 + k]:
            continue
        if base < 0:
            base = k
            if tie[base] != tie[base]:
                tie[base], tie_var[base] = 0.0, 0.0
            tie_at[base] = now
            continue
        tie[k] = tie[base] + x[3 + k] - x[3 + base]
        tie_var[k] = P[3 + k, 3 + k] + P[3 + base, 3 + base] - 2.0 * P[3 + k, 3 + base]
        tie_at[k] = now
