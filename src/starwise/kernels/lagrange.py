"""Tabulated orbits and clocks at transmission: polynomial of degree 10 through 11 nodes, clocks on straight lines."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.constants import C_LIGHT, MU_GAL, NS, OMEGA_E_GPS, SAT_NO_CLOCK, SAT_NO_EPHEMERIS, SAT_OK, SAT_TOO_OLD
from starwise.kernels._jit import njit

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]
I2 = NDArray[np.int16]
I1 = NDArray[np.int8]

N_NODES = 11
"""Nodes of the interpolating polynomial."""
MAX_GAP = 3
"""Widest hole between two neighbouring nodes, in intervals, that is bridged (orbits and clocks)."""
MAX_SPAN = 15
"""Widest set of nodes, in intervals (10 without holes)."""
EXTRAPOLATION_M = 1.0
"""1-sigma error one interval beyond the last node, m: the table's millimetres multiplied by the polynomial.

Seen on final orbits at 5 and 15 min: 0.4 to 0.8 m RMS.
"""
MAX_CODE_M = 1e9


class Nodes(NamedTuple):
    """Samples per satellite, ragged: those of row i are ``offsets[i]:offsets[i + 1]``.

    Attributes
    ----------
    row : (7 * 256,) int32
        Row of a satellite identifier, -1 if not in the table.
    offsets : (n_sv + 1,) int64
    t_ns : (n,) int64
        Strictly increasing within a satellite.
    value : (n, m) float64
        Orbits: position in the frame of `T0_NS` that does not rotate, m. Clocks: offset, s.
    sigma : (n,) float64
    step_ns : int
        Nominal interval.
    t0_ns : int
        Instant whose Earth-fixed axes the orbits' frame has.
    first_ns, last_ns : int
        Span of the whole table.
    """

    row: I4
    offsets: I8
    t_ns: I8
    value: F8
    sigma: F8
    step_ns: int
    t0_ns: int
    first_ns: int
    last_ns: int


@njit
def _place(t_ns: I8, lo: int, hi: int, t: float, origin: int) -> int:
    """First index in ``lo:hi`` whose time is after ``origin + t`` (s)."""
    while lo < hi:
        mid = (lo + hi) >> 1
        if (t_ns[mid] - origin) * 1e-9 <= t:
            lo = mid + 1
        else:
            hi = mid
    return lo


@njit
def clock_at(clocks: Nodes, row: int, origin: int, t: float) -> tuple[float, float, float]:
    """Clock offset, s, its rate, s/s, and sigma, s, at ``origin`` ns + ``t`` s; NaN where there is none.

    Row -1 has none. Straight line between two samples at most `MAX_GAP` intervals apart; beyond the ends at most one
    interval.
    """
    if row < 0:
        return np.nan, np.nan, np.nan
    lo, hi = clocks.offsets[row], clocks.offsets[row + 1]
    if hi - lo < 2:
        return np.nan, np.nan, np.nan
    i = _place(clocks.t_ns, lo, hi, t, origin)
    step = clocks.step_ns * 1e-9
    a = min(max(i - 1, lo), hi - 2)
    ta, tb = (clocks.t_ns[a] - origin) * 1e-9, (clocks.t_ns[a + 1] - origin) * 1e-9
    span = tb - ta
    if span > (MAX_GAP + 0.5) * step or t < ta - step or t > tb + step:
        return np.nan, np.nan, np.nan
    rate = (clocks.value[a + 1, 0] - clocks.value[a, 0]) / span
    sigma = max(clocks.sigma[a], clocks.sigma[a + 1])
    return clocks.value[a, 0] + rate * (t - ta), rate, sigma


@njit
def orbit_at(orbits: Nodes, row: int, origin: int, t: float, p: F8, v: F8, x: F8, sample: F8) -> tuple[int, float]:
    """Position and velocity, ECEF of the instant, m and m/s, at ``origin`` ns + ``t`` s.

    Neville's scheme on the 11 nodes nearest to the instant, in the frame that does not rotate; velocity is the
    derivative of the same polynomial.

    Parameters
    ----------
    p, v : (N_NODES, 3) float64
        Work space; the result stands in row 0.
    x : (N_NODES,) float64
        Work space.
    sample : (2,) float64
        Distance to the nearest node, s, and its sigma, m.

    Returns
    -------
    int
        ``SAT_*``.
    float
        How far outside the nodes the instant lies, s.
    """
    lo, hi = orbits.offsets[row], orbits.offsets[row + 1]
    if hi - lo < N_NODES:
        return SAT_NO_EPHEMERIS, 0.0
    step = orbits.step_ns * 1e-9
    i = _place(orbits.t_ns, lo, hi, t, origin)
    first, last = (orbits.t_ns[lo] - origin) * 1e-9, (orbits.t_ns[hi - 1] - origin) * 1e-9
    outside = max(first - t, t - last, 0.0)
    if outside > step:
        return SAT_TOO_OLD, outside
    # nearest node in the middle, moved inwards at the ends
    b = min(max(i, lo + 1), hi - 1)
    ta, tb = (orbits.t_ns[b - 1] - origin) * 1e-9, (orbits.t_ns[b] - origin) * 1e-9
    if tb - ta > (MAX_GAP + 0.5) * step:
        return SAT_NO_EPHEMERIS, 0.0
    near = b if tb - t < t - ta else b - 1
    sample[0] = abs((orbits.t_ns[near] - origin) * 1e-9 - t)
    sample[1] = orbits.sigma[near]
    start = min(max(near - N_NODES // 2, lo), hi - N_NODES)
    if (orbits.t_ns[start + N_NODES - 1] - orbits.t_ns[start]) * 1e-9 > (MAX_SPAN + 0.5) * step:
        return SAT_NO_EPHEMERIS, 0.0
    for j in range(N_NODES):
        x[j] = ((orbits.t_ns[start + j] - origin) * 1e-9 - t) / step
        for k in range(3):
            p[j, k] = orbits.value[start + j, k]
            v[j, k] = 0.0
    for m in range(1, N_NODES):
        for j in range(N_NODES - m):
            w = 1.0 / (x[j + m] - x[j])
            left, right = x[j + m] * w, x[j] * w
            for k in range(3):
                v[j, k] = left * v[j, k] - right * v[j + 1, k] + (p[j + 1, k] - p[j, k]) * w
                p[j, k] = left * p[j, k] - right * p[j + 1, k]
    # back to the Earth-fixed axes of the instant
    angle = OMEGA_E_GPS * ((origin - orbits.t0_ns) * 1e-9 + t)
    s, c = math.sin(angle), math.cos(angle)
    px, py = p[0, 0], p[0, 1]
    vx, vy = v[0, 0] / step, v[0, 1] / step
    p[0, 0], p[0, 1] = c * px + s * py, c * py - s * px
    v[0, 0] = c * vx + s * vy + OMEGA_E_GPS * p[0, 1]
    v[0, 1] = c * vy - s * vx - OMEGA_E_GPS * p[0, 0]
    v[0, 2] /= step
    return SAT_OK, outside


@njit
def precise_states(
    t_rx_ns: I8,
    sv: I2,
    code_m: F8,
    orbits: Nodes,
    clocks: Nodes,
    other: Nodes,
    floor_m: float,
    pos_e: F8,
    vel_e: F8,
    clock_s: F8,
    drift: F8,
    relativity_s: F8,
    sigma_m: F8,
    t_tx_ns: I8,
    age_s: F8,
    status: I1,
) -> None:
    """Satellite states at transmission for rows (time of reception, satellite, pseudorange) from tables.

    The periodic relativistic term -2 r v / c^2 is added to the clock (SP3-d and RINEX clock conventions leave it
    out; IS-GPS-200N 20.3.3.3.3.1). ``other`` has the clocks of times outside the span of ``clocks``; ``floor_m`` joins
    every sigma. Outputs as in `starwise.types.SatStates`.
    """
    p, v = np.empty((N_NODES, 3)), np.empty((N_NODES, 3))
    x, sample = np.empty(N_NODES), np.empty(2)
    for i in range(len(sv)):
        for k in range(3):
            pos_e[i, k] = np.nan
            vel_e[i, k] = np.nan
        clock_s[i] = np.nan
        drift[i] = np.nan
        relativity_s[i] = np.nan
        sigma_m[i] = np.nan
        age_s[i] = np.nan
        t_tx_ns[i] = t_rx_ns[i]
        row = orbits.row[sv[i]]
        if row < 0:
            status[i] = SAT_NO_EPHEMERIS
            continue
        missing = not abs(code_m[i]) <= MAX_CODE_M
        flight = 0.0 if missing else code_m[i] / C_LIGHT
        origin = t_rx_ns[i]
        clock, rate, clock_sigma = np.nan, np.nan, np.nan
        inside = clocks.first_ns - clocks.step_ns <= origin <= clocks.last_ns + clocks.step_ns
        for _ in range(2):
            t = -flight - (clock if clock == clock else 0.0)
            if inside:
                clock, rate, clock_sigma = clock_at(clocks, clocks.row[sv[i]], origin, t)
            else:
                clock, rate, clock_sigma = clock_at(other, other.row[sv[i]], origin, t)
        t = -flight - (clock if clock == clock else 0.0)
        state, outside = orbit_at(orbits, row, origin, t, p, v, x, sample)
        if state == SAT_OK and clock != clock:
            state = SAT_NO_CLOCK
        status[i] = state
        if state != SAT_OK or missing:
            continue
        rv = p[0, 0] * v[0, 0] + p[0, 1] * v[0, 1] + p[0, 2] * v[0, 2]
        rel = -2.0 * rv / (C_LIGHT * C_LIGHT)
        for k in range(3):
            pos_e[i, k] = p[0, k] - v[0, k] * rel
            vel_e[i, k] = v[0, k]
        # its rate from the force of a central body, -2 (v v + r a) / c^2 in the inertial frame
        r2 = p[0, 0] ** 2 + p[0, 1] ** 2 + p[0, 2] ** 2
        wx, wy = v[0, 0] - OMEGA_E_GPS * p[0, 1], v[0, 1] + OMEGA_E_GPS * p[0, 0]
        rel_dot = -2.0 * (wx * wx + wy * wy + v[0, 2] ** 2 - MU_GAL / math.sqrt(r2)) / C_LIGHT**2
        clock_s[i] = clock + rel
        drift[i] = rate + rel_dot
        relativity_s[i] = rel
        variance = floor_m * floor_m + (EXTRAPOLATION_M * outside * NS / orbits.step_ns) ** 2
        if sample[1] == sample[1]:
            variance += sample[1] ** 2
        if clock_sigma == clock_sigma:
            variance += (C_LIGHT * clock_sigma) ** 2
        sigma_m[i] = math.sqrt(variance)
        age_s[i] = sample[0]
        t_tx_ns[i] = origin + np.int64(round((t - rel) * NS))
