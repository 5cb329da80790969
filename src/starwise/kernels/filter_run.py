"""All epochs of a run through the EKF (all satellites at once) or the S3EKF (satellite by satellite).

An epoch: predict; model the rows at the predicted position; align the clocks if they jumped or are unknown; take
systems in or out of the state; update with the gate inside; judge the epoch as a whole; start again from least
squares if the filter is lost.
"""

import numpy as np
from numpy.typing import NDArray

from starwise.constants import EPOCH_COASTED, EPOCH_NO_SOLUTION, EPOCH_OK, EPOCH_RESET, EPOCH_SUSPECT
from starwise.kernels._jit import njit
from starwise.kernels.adapt import NONE, memory_size
from starwise.kernels.colored import predicted_errors, start_colored, update_colored
from starwise.kernels.error_states import (
    N_SKY,
    ErrorModel,
    ErrorRows,
    Slots,
    enter_satellites,
    n_errors,
    reset_errors,
)
from starwise.kernels.filter_alarm import (
    FEWEST_IN_VIEW,
    REFUSED_ALARM,
    REFUSED_USUAL,
    are_strained,
    can_judge,
    contradicted,
    in_view,
    refused_part,
)
from starwise.kernels.filter_clocks import activate_clocks, align_clocks, count_missed
from starwise.kernels.filter_epoch import arrange, tally, update_epoch
from starwise.kernels.filter_predict import adapt_epoch, advance
from starwise.kernels.filter_state import Belief, FilterOptions, Work, start_filter
from starwise.kernels.process import Process
from starwise.kernels.rangemodel import Epochs, ModelOptions, RowModel, Rows, epoch_corrections
from starwise.kernels.spp import (
    FILTER_RATES_IGNORED,
    FILTER_RATES_USED,
    FILTER_RATES_WAIT,
    EpochOut,
    SppOptions,
    dops,
    spp_epoch,
)
from starwise.kernels.spp_rates import RATES_CHECKED, RATES_FAILED, threshold

F8 = NDArray[np.float64]

TRIAL_EPOCHS = 10  # agreeing epochs, and time, that the codes alone have to determine the velocity before rates return
TRIAL_NS = 10_000_000_000
SOON_EPOCHS = 30  # starts within so many epochs, or so much time, of each other have a common cause
SOON_NS = 60_000_000_000
MAX_CLOCK_VAR = 1e14  # m^2; beyond, rounding (1e-16 of it) would reach the variance of a code
MAX_STRIKES = 2  # starts soon after each other with rates that contradict codes that agree: rates are ignored


@njit
def _write(e: int, nk: int, nc: int, floor: float, belief: Belief, ep: EpochOut) -> None:
    """State of epoch e into the outputs; ``floor`` m per axis is the error of a position that no state describes."""
    x, P = belief.x, belief.P
    for i in range(3):
        ep.pos[e, i] = x[i]
        ep.vel[e, i] = x[3 + i] if nk > 3 else 0.0
        for j in range(3):
            ep.cov_pos[e, i, j] = P[i, j]
            ep.cov_vel[e, i, j] = P[3 + i, 3 + j] if nk > 3 else 0.0
        ep.cov_pos[e, i, i] += floor * floor
    for k in range(len(belief.at)):
        c = belief.at[k]
        if c >= 0:
            ep.clock[e, k] = x[nk + c]
            ep.clock_var[e, k] = P[nk + c, nk + c]
            ep.drift[e, k] = x[nk + nc + c]


@njit
def _write_common(e: int, nk: int, nc: int, belief: Belief, common: F8, common_cov: F8) -> None:
    """States that constellations have in common into row e: motion, then those of the sky; nothing if it is empty."""
    n = common.shape[1]
    base = nk + 2 * nc
    for i in range(n):
        r = i if i < nk else base + i - nk
        common[e, i] = belief.x[r]
        for j in range(i, n):
            c = j if j < nk else base + j - nk
            common_cov[e, i, j] = belief.P[r, c]
            common_cov[e, j, i] = belief.P[r, c]


@njit
def restart(
    model: ModelOptions, spp: SppOptions, options: FilterOptions, errors: ErrorModel, t_ns: int, rows: Rows,
    extra: ErrorRows, start: int, end: int, nk: int, nc: int, running: bool, failing: bool, alarmed: bool,
    desperate: bool, since_s: float, belief: Belief, slots: Slots, x2: F8, work: Work, e: int, ep: EpochOut,
    out: RowModel,
) -> tuple[int, int]:  # fmt: skip
    """Start, or start again, from the least-squares solution of this epoch, if it has one that can be trusted.

    A solution that failed its test, or that nothing checks, is taken only if ``desperate``, with that much more
    variance, and the epoch is marked suspect. A velocity is taken only if its rates were checked, and not if the start
    before this one failed soon, ``since_s`` ago (else NaN): something wrong in the rates passed the check. A static
    receiver says what: the rates, if they claim that it went far and its codes that it did not. A filter that is only
    ``alarmed`` starts again where least squares contradicts it, and else goes on.

    Returns
    -------
    nc : int
        Number of active clocks, 0 if the filter did not start.
    rates : int
        ``RATES_*``; -1: not believed.
    """
    n_all = len(belief.at)
    tie, tie_var = np.full(n_all, np.nan), np.full(n_all, np.nan)
    if running:
        x, P = belief.x, belief.P
        for k in range(n_all):
            if belief.at[k] >= 0:
                c = nk + belief.at[k]
                tie[k] = x[c] - x[nk]
                tie_var[k] = P[c, c] + P[nk, nk] - 2.0 * P[c, nk]
    xs, Ps = np.zeros(3 + n_all), np.zeros((3 + n_all, 3 + n_all))
    vel, Pv, numbers = np.zeros(4), np.zeros((4, 4)), np.zeros(4)
    status = spp_epoch(model, spp, t_ns, rows, start, end, tie, tie_var, xs, Ps, vel, Pv, numbers, out)
    if not (status == EPOCH_OK or (status == EPOCH_SUSPECT and desperate)):
        return 0, -1
    judge = can_judge(out, start, end, int(numbers[1]))
    if alarmed and not (judge and contradicted(xs, Ps, belief.x, belief.P)):
        return 0, -1
    doubt = 1.0
    if status == EPOCH_SUSPECT:
        doubt = max(1.0, numbers[2] / numbers[1]) if numbers[1] > 0.0 else 4.0
    rates = int(numbers[3])
    if since_s == since_s and rates == RATES_CHECKED:
        if nk > 3:
            rates = -1
        else:
            gone2, went2, var = 0.0, 0.0, 0.0
            for i in range(3):
                gone2 += (vel[i] * since_s) ** 2
                went2 += (xs[i] - belief.x[i]) ** 2
                var += Ps[i, i]
            if gone2 > 25.0 * var and went2 < gone2 / 16.0:
                rates = RATES_FAILED
    if rates != RATES_CHECKED:
        for i in range(4):
            vel[i] = np.nan
        for i in range(start, end):
            out.rate_used[i] = 0
    if errors.on:
        nc = start_colored(
            options, errors, rows, extra, out, start, end, nk, t_ns, xs, vel, tie, tie_var, doubt, belief, slots,
            x2, work,
        )  # fmt: skip
    else:
        nc = start_filter(options, nk, t_ns, xs, Ps, vel, Pv, doubt, belief)
    _write(e, nk, nc, errors.floor, belief, ep)
    dops(out, start, end, ep.dop[e])
    ep.status[e] = EPOCH_RESET if (failing or alarmed) and status == EPOCH_OK else status
    ep.n_used[e], ep.dof[e], ep.nis[e] = int(numbers[0]), int(numbers[1]), numbers[2]
    return nc, rates


@njit
def filter_run(
    model: ModelOptions, spp: SppOptions, process: Process, options: FilterOptions, epochs: Epochs, rows: Rows,
    x0: F8, P0: F8, errors: ErrorModel, extra: ErrorRows, max_slots: int, ep: EpochOut, out: RowModel,
    common: F8, common_cov: F8,
) -> None:  # fmt: skip
    """Filter all epochs of a run; arguments as `starwise.kernels.spp.spp_run`, and a start.

    Parameters
    ----------
    model : ModelOptions
    spp : SppOptions
        Least squares, which starts the filter.
    process : Process
    options : FilterOptions
    epochs : Epochs
    rows : Rows
    x0, P0 : (nk + 2 n_clocks,), (n, n)
        Belief at the first epoch, all clocks in the state; x0[0] NaN: start from least squares.
    errors : ErrorModel
    extra : ErrorRows
        Empty where errors are white.
    max_slots : int
        Satellites that can have error states at once.
    ep : EpochOut
        Out: per epoch.
    out : RowModel
        Out: per row. At an epoch that (re)starts the filter, those of least squares.
    common, common_cov : (m, k), (m, k, k)
        Out: motion and, k = nk + N_SKY, the states of the sky, with their covariance; k = 0: not wanted.
    """
    n_all, nk = ep.clock.shape[1], process.nk
    m_max = 1
    for e in range(len(epochs.t_ns)):
        m_max = max(m_max, epochs.offsets[e + 1] - epochs.offsets[e])
    ints, pairs, size = np.zeros((3, m_max), np.int64), np.zeros((4, m_max, 2)), nk + 2 * n_all
    if errors.on:
        size += N_SKY + errors.n_bias + errors.block * max_slots
    slots = Slots(
        np.full(7 * 256, -1, np.int64), np.zeros(max_slots, np.int64), np.zeros(max_slots, np.int64),
        np.zeros(1, np.int64), np.ones(1),
    )  # fmt: skip
    phi = np.ones(size)
    los, vectors = np.zeros((2, m_max, 3)), np.zeros((4, size))
    work = Work(
        ints[0], ints[1], ints[2], los[0], los[1], pairs[0], pairs[1], pairs[2], pairs[3],
        np.zeros(m_max, np.uint8), vectors[0], vectors[1], vectors[2], np.zeros(m_max), np.zeros(len(rows.code_m)),
    )  # fmt: skip
    belief = Belief(
        np.zeros(size), np.zeros((size, size)), np.full(n_all, -1, np.int64), np.zeros(n_all, np.int64),
        np.zeros(n_all, np.int64),
    )  # fmt: skip
    x, P, at = belief.x, belief.P, belief.at
    x2, P2 = np.zeros(size), np.zeros((size, size))
    F, G, M, memory = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(memory_size(options.rule.window))
    running, nc, t_last, dt_known = False, 0, 0, -1.0
    failed = 0  # epochs in a row that disagreed
    weak = 0  # epochs in a row in which codes were gated and the rest was too few to check itself
    blind, strained, refused = 0, 0, 0.0  # signs of a filter that is lost and does not fail, see `filter_alarm`
    wait, t_wait = 0, 0  # epochs until rates are used, and since when
    strikes, e_strike, t_strike, e_start, t_start = 0, -SOON_EPOCHS - 1, 0, -SOON_EPOCHS - 1, 0
    ignore = False  # rates are wrong throughout
    max_var = spp.max_sigma_m**2
    checked = True  # the position has been confirmed by more satellites than it takes to make one
    if x0[0] == x0[0]:
        running, nc, t_last = True, n_all, epochs.t_ns[0]
        for i in range(nk + 2 * n_all):
            x[i] = x0[i]
            for j in range(nk + 2 * n_all):
                P[i, j] = P0[i, j]
        for k in range(n_all):
            at[k] = k
            belief.seen_ns[k] = t_last
        if errors.on:
            reset_errors(errors, slots, x, P, nk + 2 * nc)
    for e in range(len(epochs.t_ns)):
        t_ns, start, end = epochs.t_ns[e], epochs.offsets[e], epochs.offsets[e + 1]
        lost, dt = not running, 0.0
        m = 0
        if running:
            dt = max((t_ns - t_last) * 1e-9, 0.0)  # variances do not shrink, whatever a caller takes for time
            dt_known = advance(process, errors, slots, x, P, nk, nc, dt, dt_known, F, G, M, phi)
            lost = not P[0, 0] + P[1, 1] + P[2, 2] < options.lost_sigma_m**2 or not P[nk, nk] < MAX_CLOCK_VAR
        if options.memoryless:
            running, lost, failed = False, True, 0
        t_last = t_ns
        failing = running and (failed >= options.patience or weak >= options.weak_patience)
        alarmed = running and not (lost or failing)
        alarmed = alarmed and (max(blind, strained) >= options.patience or refused > REFUSED_ALARM)
        if lost or failing or alarmed:
            desperate = not running or failed >= 2 * options.patience
            soon = e - e_start <= SOON_EPOCHS or t_ns - t_start <= SOON_NS
            since_s = (t_ns - t_start) * 1e-9 if failing and soon else np.nan
            started, rates = restart(
                model, spp, options, errors, t_ns, rows, extra, start, end, nk, nc, running, failing, alarmed,
                desperate, since_s, belief, slots, x2, work, e, ep, out,
            )  # fmt: skip
            if started > 0:
                _write_common(e, nk, started, belief, common, common_cov)
                checked = ep.status[e] != EPOCH_SUSPECT
                if rates == RATES_FAILED and checked and (failing or not running):
                    soon = e - e_strike <= SOON_EPOCHS or t_ns - t_strike <= SOON_NS
                    strikes = strikes + 1 if soon else 1
                    e_strike, t_strike = e, t_ns
                    ignore = ignore or strikes >= MAX_STRIKES
                memory.fill(0.0)
                wait, t_wait = 0 if rates == RATES_CHECKED else TRIAL_EPOCHS, t_ns
                nc, running, failed, weak, e_start, t_start = started, True, 0, 0, e, t_ns
                blind, strained, refused = 0, 0, 0.0
                if not P[0, 0] + P[1, 1] + P[2, 2] <= max_var:
                    ep.status[e] = EPOCH_SUSPECT
                if ignore:
                    ep.rates[e] = FILTER_RATES_IGNORED
                continue
            if not running:
                ep.status[e] = EPOCH_NO_SOLUTION
                continue
            if failed >= options.patience:
                # Lost, and this epoch cannot be solved by itself: go on with more doubt.
                n = nk + 2 * nc + n_errors(errors, slots)
                for i in range(n):
                    for j in range(n):
                        P[i, j] *= 4.0
            if P[0, 0] + P[1, 1] + P[2, 2] > 1e12 or not P[nk, nk] < MAX_CLOCK_VAR:
                running = False
                ep.status[e] = EPOCH_NO_SOLUTION
                continue
        known = x[0] == x[0]  # always; a literal True would be a type of its own, compiled once more
        epoch_corrections(model, t_ns, rows, start, end, x[0], x[1], x[2], known, out)
        m = arrange(rows, out, start, end, work)
        ep.rates[e] = FILTER_RATES_IGNORED if ignore else (FILTER_RATES_WAIT if wait > 0 else FILTER_RATES_USED)
        if ep.rates[e] != FILTER_RATES_USED:
            for k in range(m):
                out.rate_var[work.order[k]] = np.inf
        if errors.on:
            base = nk + 2 * nc
            enter_satellites(errors, extra, work.order, m, t_ns, slots, x, P, base)
            predicted_errors(errors, rows, extra, out, m, x, base, slots, slots.scale[0], work)
        if m > 0:
            tail = n_errors(errors, slots)
            stepped = align_clocks(options, rows, out, m, x, P, nk, nc, tail, at, work)
            nc = activate_clocks(options, rows, out, m, t_ns, nk, nc, tail, belief, x2, P2, work)
            if options.rule.kind != NONE and dt > 0.0 and not stepped:  # a clock forgotten has no Q left to take out
                adapt_epoch(
                    options, process, errors, rows, extra, out, m, x, P, nk, nc, at, slots, dt, G, M, memory, work
                )
        if errors.on:
            nis, dof = update_colored(options, errors, rows, extra, out, m, x, P, nk, nc, at, slots, dt, x2, work)
        else:
            nis, dof = update_epoch(options, rows, out, m, x, P, nk, nc, at, x2, P2, work)
        n_used, agreed, n_clocks = tally(rows, out, m, at, work)
        count_missed(rows, m, t_ns, belief, work)
        _write(e, nk, nc, errors.floor, belief, ep)
        _write_common(e, nk, nc, belief, common, common_cov)
        dops(out, start, end, ep.dop[e])
        ep.n_used[e], ep.dof[e], ep.nis[e] = n_used, dof, nis
        if m == 0:
            ep.status[e] = EPOCH_COASTED
            blind = blind + 1 if in_view(rows, start, end) >= FEWEST_IN_VIEW else 0
            continue
        blind = 0
        strained = strained + 1 if are_strained(errors, slots, x, P, nk + 2 * nc) else 0
        refused = min(max(refused + refused_part(rows, m, at, work) - REFUSED_USUAL, 0.0), 2.0 * REFUSED_ALARM)
        redundant = n_used > 3 + n_clocks
        if not agreed or nis > threshold(options.chi2, dof):
            failed += 1
            ep.status[e] = EPOCH_SUSPECT
            wait = TRIAL_EPOCHS if wait > 0 else 0
        else:
            if n_used == m or redundant:
                failed, weak = 0, 0
                # A start that nothing checked stays a guess, however well the same satellites agree with it later.
                checked = checked or redundant
            else:
                weak += 1  # which of the codes are wrong, nothing says
            if wait > 1 or t_ns - t_wait >= TRIAL_NS:
                wait = max(wait - 1, 0)
            certain = P[0, 0] + P[1, 1] + P[2, 2] <= max_var
            ep.status[e] = EPOCH_OK if checked and certain and weak == 0 else EPOCH_SUSPECT
        checked = checked and failed + weak < options.patience
