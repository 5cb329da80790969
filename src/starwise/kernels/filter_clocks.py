"""Receiver clocks against the measurements of an epoch: jumps, unknown clocks, systems that come and go."""

import math

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.filter_epoch import code_innovation
from starwise.kernels.filter_state import Belief, FilterOptions, Work, enter_clock, forget_common_clock, move_state
from starwise.kernels.linalg import median
from starwise.kernels.rangemodel import RowModel, Rows
from starwise.kernels.update import USED_CODE

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


EQUAL_M = 1e-3
"""Codes that are as near to the median to within this are equally near, and the one of less variance leads."""


@njit
def _lead_with(rows: Rows, out: RowModel, m: int, x: F8, nk: int, at: I8, middle: float, work: Work) -> None:
    """Bring the satellite whose code innovation is nearest to ``middle`` to the front of ``work.order``."""
    best, best_off = -1, np.inf
    for k in range(m):
        i = work.order[k]
        if at[rows.clock[i]] >= 0:
            off = abs(code_innovation(rows, out, i, x, nk + at[rows.clock[i]], work.lasting) - middle)
            # An even number has a median between two: rounding must not choose between them.
            if off < best_off - EQUAL_M:
                best, best_off = k, off
    if best > 0:
        lead = work.order[best]
        for k in range(best, 0, -1):
            work.order[k] = work.order[k - 1]
        work.order[0] = lead


@njit
def align_clocks(
    options: FilterOptions, rows: Rows, out: RowModel, m: int, x: F8, P: F8, nk: int, nc: int, tail: int, at: I8,
    work: Work,
) -> bool:  # fmt: skip
    """Absorb a step common to all clocks: a reset of the receiver's clock.

    The median of the code innovations of all systems is robust against bad satellites and blind to inter-system
    offsets, which are known. It is a step if it is far outside what the prediction allows while at least 60 % of the
    satellites (three or more) agree on it within their own uncertainty. Then the common clock is forgotten and
    starts again at the median with a variance far above the median's own, so that the measurements are not counted
    twice to any effect. Doppler knows nothing of steps: the drifts stay.

    A clock that is merely uncertain (no Doppler yet, or a long gap) is left to the update, which so learns the drift
    that carried it away; but any first satellite would pass its gate as a clock error, so that the one nearest to the
    median comes first.
    """
    if m == 0:
        return False
    s_clk = P[nk, nk]
    for k in range(1, nc):
        s_clk = min(s_clk, P[nk + k, nk + k])
    s_pos = P[0, 0] + P[1, 1] + P[2, 2]
    loose = s_clk > options.clock_loose_m**2
    count = 0
    for k in range(m):
        i = work.order[k]
        if at[rows.clock[i]] < 0:
            continue
        c = nk + at[rows.clock[i]]
        v1 = code_innovation(rows, out, i, x, c, work.lasting)
        work.v[k, 0] = v1
        work.sorted[count] = v1
        count += 1
    if count == 0 or (count < 3 and not loose):
        return False
    middle = median(work.sorted, count)
    if middle * middle < 36.0 * (s_clk + s_pos):
        if loose:
            _lead_with(rows, out, m, x, nk, at, middle, work)
        return False
    agree, spread2 = 0, 0.0
    for k in range(m):
        i = work.order[k]
        if at[rows.clock[i]] < 0:
            continue
        e2 = (work.v[k, 0] - middle) ** 2
        if e2 < 16.0 * (out.code_var[i] + s_pos):
            agree += 1
            spread2 += e2 + out.code_var[i]
    if agree < max(3, math.ceil(0.6 * count)):
        if not loose or agree == 0:
            return False
        spread2 = max(spread2, s_clk)  # too few to be sure: as loose as before
    else:
        spread2 = 25.0 * spread2 / agree
    forget_common_clock(x, P, nk, nc, tail, middle, spread2)
    return True


@njit
def _median_of(k: int, c: int, rows: Rows, out: RowModel, m: int, x: F8, work: Work) -> tuple[float, int]:
    """Median code innovation of the satellites of clock k, at element c, and their number; 0 of fewer than three."""
    count = 0
    for j in range(m):
        i = work.order[j]
        if rows.clock[i] == k:
            work.sorted[count] = code_innovation(rows, out, i, x, c, work.lasting)
            count += 1
    return (median(work.sorted, count) if count >= 3 else 0.0), count


@njit
def activate_clocks(
    options: FilterOptions, rows: Rows, out: RowModel, m: int, t_ns: int, nk: int, nc: int, tail: int, belief: Belief,
    x2: F8, P2: F8, work: Work,
) -> int:  # fmt: skip
    """Take clocks of systems that appear into the state and those absent for long out of it; the new number.

    A system whose codes were all refused for `patience` epochs has stepped against the others: it enters anew.
    """
    at = belief.at
    n_all = len(at)
    want = np.zeros(n_all, np.bool_)
    fresh = np.zeros(n_all, np.bool_)
    for k in range(m):
        want[rows.clock[work.order[k]]] = True
    change = False
    refs = 0
    for k in range(n_all):
        if at[k] >= 0:
            again = want[k] and belief.missed[k] >= options.patience and nc > 1
            stale = not want[k] and (t_ns - belief.seen_ns[k]) * 1e-9 > options.absent_s
            if again:
                fresh[k] = True
                change = True
            elif stale:
                change = True
            else:
                want[k] = True
                refs += 1
        elif want[k]:
            fresh[k] = True
            change = True
    if not change:
        return nc
    if refs == 0:
        # Everything known would go: keep the clock seen last as the bridge to the oscillator.
        keep = -1
        for k in range(n_all):
            if at[k] >= 0 and (keep < 0 or belief.seen_ns[k] > belief.seen_ns[keep]):
                keep = k
        want[keep] = True
        fresh[keep] = False
    new_at = np.full(n_all, -1, np.int64)
    count, ref, best = 0, -1, np.inf
    for k in range(n_all):
        if want[k]:
            new_at[k] = count
            count += 1
            if not fresh[k]:
                p = belief.P[nk + at[k], nk + at[k]]
                if p < best:
                    ref, best = k, p
    old_at = at.copy()
    move_state(belief.x, belief.P, nk, tail, at, new_at, x2, P2)
    for k in range(n_all):
        if not fresh[k]:
            continue
        wide = 1e3 if old_at[k] >= 0 else 1.0  # a system that stepped: anything up to a millisecond
        sigma = wide * options.intersystem_sigma0
        enter_clock(
            belief.x, belief.P, nk, count, tail, new_at[k], new_at[ref], sigma * sigma,
            options.intersystem_drift_sigma0**2,
        )  # fmt: skip
        belief.missed[k] = 0
        belief.seen_ns[k] = t_ns
        # Several satellites of it: start at the median of what they say, against the reference's: the oscillator may
        # have gone anywhere since the last epoch, and takes all its clocks along.
        common, n_common = _median_of(ref, nk + new_at[ref], rows, out, m, belief.x, work)
        c = nk + new_at[k]
        n_sat, var = 0, 0.0
        for j in range(m):
            i = work.order[j]
            if rows.clock[i] == k:
                v1 = code_innovation(rows, out, i, belief.x, c, work.lasting)
                work.sorted[n_sat] = v1
                var += out.code_var[i]
                n_sat += 1
        if n_sat >= 3:
            middle = median(work.sorted, n_sat)
            spread = 0.0
            for j in range(n_sat):
                work.sorted[j] = abs(work.sorted[j] - middle)
            spread = 1.5 * median(work.sorted, n_sat)
            belief.x[c] += middle - common
            own = 25.0 * (spread * spread + var / n_sat)
            if n_common < 3:
                own += belief.P[nk + new_at[ref], nk + new_at[ref]]
            if own < sigma * sigma:
                belief.P[c, c] += own - sigma * sigma
    return count


@njit
def count_missed(rows: Rows, m: int, t_ns: int, belief: Belief, work: Work) -> None:
    """Per clock: when a code of it was last used, and for how many epochs all were refused."""
    for k in range(len(belief.at)):
        seen, used = False, False
        for j in range(m):
            if rows.clock[work.order[j]] == k:
                seen = True
                if work.used[j] & USED_CODE:
                    used = True
        if used:
            belief.seen_ns[k] = t_ns
            belief.missed[k] = 0
        elif seen:
            belief.missed[k] += 1
