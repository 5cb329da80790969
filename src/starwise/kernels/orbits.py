"""Broadcast satellite states of many rows: choice of the record, light time, dispatch by system."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    C_LIGHT,
    K_AF0,
    K_AF1,
    K_AF2,
    NS,
    R_GAMMA,
    R_TAU,
    SAT_BAD_EPHEMERIS,
    SAT_NO_EPHEMERIS,
    SAT_TOO_OLD,
    SYS_C,
    SYS_R,
    SYS_S,
)
from starwise.kernels._jit import njit
from starwise.kernels.glonass import glonass, parabola
from starwise.kernels.kepler import kepler

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]
I2 = NDArray[np.int16]
I1 = NDArray[np.int8]

N_RANKS = 4
"""Messages of one satellite are tried in this many ranks of preference."""
STALE_MPH2 = 5.0
"""Growth of the range error outside the interval of fit, m per squared hour.

Orbits extrapolate with the square of time; measured against final orbits, in range: Galileo before toe 5 to 6,
BeiDou before 4 to 5, after 2 to 3 m/h^2.
"""
MAX_CODE_M = 1e9
"""Pseudoranges beyond this are no light time at all."""


class Table(NamedTuple):
    """Broadcast records arranged for lookup. Records keep their numbers; ``by_*`` order the usable ones.

    Attributes
    ----------
    start : (n_keys + 1,) int64
        Records of satellite ``sv`` in rank r: ``by_*[start[k]:start[k + 1]]`` with ``k = sv * N_RANKS + r``.
    by_toe : (m,) int64
        Sorted by key, reference time, transmission time.
    by_tx : (m,) int64
        Sorted by key, time of availability, reference time.
    toe_ns, toc_ns, avail_ns : (n,) int64
        Reference times, and the time from which the record can be known, GPST.
    limit_ns : (n,) int64
        Largest distance from toe at which the record may be used.
    before_ns, after_ns : (n,) int64
        How far before and after toe the record describes the orbit it was fitted to.
    status : (n,) int8
        ``SAT_*`` of the record itself.
    sigma_m : (n,) float64
    par : (n, N_EPH_PAR) float64
    slot : (n,) int32
        Place of a GLONASS record in ``nodes``, -1 for others.
    nodes : (n_glonass, 2, N_NODES, 6) float64
    reach : (n_glonass, 2) int32
    """

    start: I8
    by_toe: I8
    by_tx: I8
    toe_ns: I8
    toc_ns: I8
    avail_ns: I8
    limit_ns: I8
    before_ns: I8
    after_ns: I8
    status: I1
    sigma_m: F8
    par: F8
    slot: I4
    nodes: F8
    reach: I4


@njit
def _last_at_or_before(values: I8, order: I8, lo: int, hi: int, t: int) -> int:
    """Last place in ``order[lo:hi]`` whose value is at most ``t``; ``lo - 1`` if none."""
    while lo < hi:
        mid = (lo + hi) >> 1
        if values[order[mid]] <= t:
            lo = mid + 1
        else:
            hi = mid
    return lo - 1


@njit
def _outside_fit(table: Table, rec: int, t_ns: int) -> int:
    """Time by which ``t_ns`` lies outside the interval to which a record was fitted, ns."""
    age: int = t_ns - table.toe_ns[rec]
    return max(age - int(table.after_ns[rec]), -age - int(table.before_ns[rec]), 0)


@njit
def choose(table: Table, sv: int, t_ns: int, post: bool) -> int:
    """Record of a satellite for a time, or minus the ``SAT_*`` reason why there is none.

    The first rank with a valid record wins. Within it: the record transmitted last before ``t_ns``; in
    post-processing, of the two whose reference times enclose ``t_ns``, the one fitted to that time, or if both or
    neither are, the nearer. Of those that share a reference time, the newest upload.
    """
    reason = SAT_NO_EPHEMERIS
    best: int
    for rank in range(N_RANKS):
        key = sv * N_RANKS + rank
        lo, hi = table.start[key], table.start[key + 1]
        if lo == hi:
            continue
        if post:
            reason = SAT_TOO_OLD
            i = _last_at_or_before(table.toe_ns, table.by_toe, lo, hi, t_ns)
            best = -1
            if i >= lo:
                best = table.by_toe[i]
            if i + 1 < hi:
                toe = table.toe_ns[table.by_toe[i + 1]]
                later = table.by_toe[_last_at_or_before(table.toe_ns, table.by_toe, lo, hi, toe)]
                if best < 0:
                    best = later
                else:
                    gain = _outside_fit(table, best, t_ns) - _outside_fit(table, later, t_ns)
                    if gain > 0 or (gain == 0 and toe - t_ns < t_ns - table.toe_ns[best]):
                        best = later
            if abs(t_ns - table.toe_ns[best]) <= table.limit_ns[best]:
                return best
        else:
            i = _last_at_or_before(table.avail_ns, table.by_tx, lo, hi, t_ns)
            if i >= lo:
                reason = SAT_TOO_OLD
            while i >= lo:
                best = table.by_tx[i]
                if abs(t_ns - table.toe_ns[best]) <= table.limit_ns[best]:
                    return best
                i -= 1
    return -reason


@njit
def broadcast_states(
    t_rx_ns: I8,
    sv: I2,
    code_m: F8,
    post: bool,
    table: Table,
    pos_e: F8,
    vel_e: F8,
    clock_s: F8,
    drift: F8,
    relativity_s: F8,
    sigma_m: F8,
    t_tx_ns: I8,
    age_s: F8,
    status: I1,
    record: I4,
) -> None:
    """Satellite states at transmission for rows (time of reception, satellite, pseudorange).

    The transmission time follows from the satellite's own reading: t_sv = t_rx - code / c holds whatever the
    receiver's clock does, and t_tx = t_sv - clock(t_tx). Outputs as in `starwise.types.SatStates`.
    """
    for row in range(len(sv)):
        for k in range(3):
            pos_e[row, k] = np.nan
            vel_e[row, k] = np.nan
        clock_s[row] = np.nan
        drift[row] = np.nan
        relativity_s[row] = np.nan
        sigma_m[row] = np.nan
        age_s[row] = np.nan
        t_tx_ns[row] = t_rx_ns[row]
        record[row] = -1
        rec = choose(table, sv[row], t_rx_ns[row], post)
        if rec < 0:
            status[row] = -rec
            continue
        record[row] = rec
        status[row] = table.status[rec]
        stale = STALE_MPH2 * (_outside_fit(table, rec, t_rx_ns[row]) / (3600.0 * NS)) ** 2
        sigma_m[row] = math.sqrt(table.sigma_m[rec] ** 2 + stale**2)
        if not abs(code_m[row]) <= MAX_CODE_M:
            continue
        p = table.par[rec]
        system = sv[row] >> 8
        number = sv[row] & 255
        flight = code_m[row] / C_LIGHT
        # differences of int64 lose nothing; seconds since the reference times by the satellite's clock
        t_c = (t_rx_ns[row] - table.toc_ns[rec]) * 1e-9 - flight
        t_e = (t_rx_ns[row] - table.toe_ns[rec]) * 1e-9 - flight

        if system in (SYS_R, SYS_S):
            af0, af1, af2 = p[R_TAU], p[R_GAMMA], 0.0
        else:
            af0, af1, af2 = p[K_AF0], p[K_AF1], p[K_AF2]
        clock = 0.0
        for _ in range(3):
            dt = t_c - clock
            clock = af0 + dt * (af1 + dt * af2)
        t_k = t_e - clock
        rate = af1 + 2.0 * af2 * (t_c - clock)
        rel = 0.0
        if system == SYS_R:
            slot = table.slot[rec]
            x, y, z, vx, vy, vz = glonass(p, t_k, table.nodes[slot], table.reach[slot])
        elif system == SYS_S:
            x, y, z, vx, vy, vz = parabola(p, t_k)
        else:
            geo = system == SYS_C and (number <= 5 or 59 <= number <= 63)
            x, y, z, vx, vy, vz, rel, rel_dot = kepler(p, system, geo, t_k)
            # the satellite's reading contains the relativistic term too: it was transmitted `rel` earlier
            x -= vx * rel
            y -= vy * rel
            z -= vz * rel
            t_k -= rel
            clock += rel
            rate += rel_dot
        if not abs(x + y + z + clock) < 1e9:
            status[row] = SAT_BAD_EPHEMERIS
            continue
        pos_e[row, 0], pos_e[row, 1], pos_e[row, 2] = x, y, z
        vel_e[row, 0], vel_e[row, 1], vel_e[row, 2] = vx, vy, vz
        clock_s[row] = clock
        drift[row] = rate
        relativity_s[row] = rel
        age_s[row] = t_k
        t_tx_ns[row] = table.toe_ns[rec] + np.int64(round(t_k * NS))
