"""Correlated errors of pseudoranges as states of the filter: what they are, and how they live in time.

A filter that calls range errors white is sure of a wrong place within minutes, because real ones last for minutes to
hours. Here every lasting error is a state e of unit variance, a Gauss-Markov process

    e(t + dt) = exp(-dt / tau) e(t) + w,    var w = 1 - exp(-2 dt / tau),

whose size stands in the measurement: h e with h its sigma in metres at that moment. So a sigma may follow elevation
or C/N0 without a change of the process. The code on frequency f of satellite j of system s sees

    slow_j                        orbit and clock of the satellite: common to its signals
    + troposphere m(el)           remainder of the zenith delay
    + (f1 / f)^2 ( ionosphere_j   remainder of the slant delay after the broadcast model
        + M(el) (vertical + north dn + east de) )      that of the whole sky: M the thin shell's mapping function
    + slope_f (1 / sin el - 1.5)  of the receiver and its antenna, per frequency band: permanent
    + bias_sf                     receiver code bias of a signal against the first signal of the system: permanent
    + signal_jf                   of the satellite's signal: inter-signal biases and slow multipath
    + multipath_jf                fast multipath and reflections
    + white noise.

States stand behind the clocks: first those of the receiver and the sky, then a block for each satellite in view, in
the order in which the satellites came. Of this part of P only the upper triangle counts.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]

# States of the receiver and the sky; receiver code biases follow.
TROPOSPHERE = 0
VERTICAL = 1
NORTH = 2
EAST = 3
SLOPE = 4  # and 5: upper (above 1.4 GHz) and lower band
N_SKY = 6
# States of a satellite; further ones at the offsets that `ErrorModel` holds.
SLOW = 0
IONOSPHERE = 1
SIGNAL = 2

SHELL_RATIO = 6_371.0 / (6_371.0 + 450.0)  # thin shell at 450 km (IGS maps: IONEX 1.0 uses the same)


class ErrorModel(NamedTuple):
    """Numbers of the coloured error model; sigmas in m, times in s. ``on`` false: errors are white."""

    on: bool
    dual: bool  # a second signal is used
    multipath: bool  # multipath has states; else it is white from epoch to epoch
    n_bias: int  # receiver code biases
    block: int  # states of a satellite
    signal2: int  # offsets in the block of a satellite, -1: no such state
    multipath1: int
    multipath2: int
    slow_tau: float
    ionosphere_fraction: float  # slant remainder as a part of the broadcast model's delay
    ionosphere_floor: float
    ionosphere_tau: float
    vertical_fraction: float  # the same of the delay at the zenith, common to the sky
    vertical_floor: float
    vertical_unknown: float  # least, where there is no broadcast model
    gradient_fraction: float  # per 1000 km
    gradient_floor: float
    vertical_tau: float
    troposphere: float
    troposphere_tau: float
    slope: float
    receiver_bias: float
    signal_bias: F8  # (7,) per system
    signal_tau: float
    code_white: F8  # (7,) at the zenith and 45 dB-Hz
    multipath_sigma: F8  # (7,) at the zenith
    multipath_tau: float  # at rest
    multipath_length: float  # m of travel over which it changes
    weak_cn0: float  # dB-Hz at which reflections and diffraction are `weak_sigma`
    weak_sigma: float
    weak_decade: float  # dB over which that grows tenfold
    weak_share: float  # part of its variance that lasts (multipath state), the rest is white
    rate_motion: float  # noise of a rate per speed of the receiver
    rate_weak: float  # the same per m of weak-signal sigma, 1/m
    scale_max: float  # largest factor on the sigmas of code noise and multipath
    scale_rise: float  # s, with which it follows innovations that are too large
    scale_fall: float  # and too small
    late: float  # normalised innovation of a code beyond which it counts less: late by so much
    early: float  # or early
    floor: float  # of the position, per axis
    absent_s: float  # a satellite not seen for so long leaves the state


class ErrorRows(NamedTuple):
    """What the coloured error model needs of a row beyond `Rows`; (n,) each, or empty."""

    sv: I8  # satellite identifier
    slow_m: F8  # sigma of the satellite's orbit and clock
    bias1: I8  # receiver code bias of the first signal, -1: the reference of its system
    bias2: I8
    code2_m: F8  # second signal; NaN: none
    clock2_m: F8  # c * satellite clock - its group delay
    freq2_hz: F8
    cn02_dbhz: F8
    v2: F8  # out: innovation of the second code, m
    s2: F8  # out: its variance
    used: U1  # out: 1 the first code, 2 the second, 3 both


class Slots(NamedTuple):
    """Which satellites have states."""

    at: I8  # (7 * 256,) slot of a satellite, -1: none
    sv: I8  # (n_max,) satellite of each slot
    seen_ns: I8  # (n_max,)
    size: I8  # (1,) their number
    scale: F8  # (1,) factor on the variance of code noise and multipath, from 1


@njit
def n_errors(errors: ErrorModel, slots: Slots) -> int:
    """Number of error states in use."""
    return int(N_SKY + errors.n_bias + slots.size[0] * errors.block) if errors.on else 0


@njit
def reset_errors(errors: ErrorModel, slots: Slots, x: F8, P: F8, base: int) -> None:
    """Error states that nothing is known of, at element ``base``: no satellites, unit variances."""
    for s in range(slots.size[0]):
        slots.at[slots.sv[s]] = -1
    slots.size[0] = 0
    for j in range(base, base + N_SKY + errors.n_bias):
        _fresh(x, P, j)


@njit
def _fresh(x: F8, P: F8, j: int) -> None:
    """Element j := unit variance, independent of all before it."""
    x[j] = 0.0
    for i in range(j):
        P[i, j] = 0.0
        P[j, i] = 0.0
    P[j, j] = 1.0


@njit
def _remove(errors: ErrorModel, slots: Slots, x: F8, P: F8, base: int, s: int) -> None:
    """Marginalise slot s out; the last slot takes its place."""
    last = slots.size[0] - 1
    b = errors.block
    to = base + N_SKY + errors.n_bias + s * b
    source = base + N_SKY + errors.n_bias + last * b
    slots.at[slots.sv[s]] = -1
    if s != last:
        for k in range(b):
            x[to + k] = x[source + k]
            for i in range(to):
                P[i, to + k] = P[i, source + k]
            for i in range(to + b, source):
                P[to + k, i] = P[i, source + k]
            for j in range(b):
                P[to + k, to + j] = P[source + k, source + j]
        slots.sv[s] = slots.sv[last]
        slots.seen_ns[s] = slots.seen_ns[last]
        slots.at[slots.sv[s]] = s
    slots.size[0] = last


@njit
def enter_satellites(
    errors: ErrorModel, extra: ErrorRows, order: I8, m: int, t_ns: int, slots: Slots, x: F8, P: F8, base: int
) -> None:  # fmt: skip
    """Satellites absent for long leave the state, those that appear enter it with what is known of any.

    Where there are no slots left, the satellite seen longest ago leaves; there are as many slots as an epoch has rows.
    """
    for s in range(slots.size[0] - 1, -1, -1):
        if (t_ns - slots.seen_ns[s]) * 1e-9 > errors.absent_s:
            _remove(errors, slots, x, P, base, s)
    for k in range(m):  # first those that have a slot, so that none of them makes room for another
        if slots.at[extra.sv[order[k]]] >= 0:
            slots.seen_ns[slots.at[extra.sv[order[k]]]] = t_ns
    for k in range(m):
        sv = extra.sv[order[k]]
        if slots.at[sv] < 0:
            if slots.size[0] == len(slots.sv):
                oldest = 0
                for s in range(1, slots.size[0]):
                    if slots.seen_ns[s] < slots.seen_ns[oldest]:
                        oldest = s
                _remove(errors, slots, x, P, base, oldest)
            s = slots.size[0]
            slots.size[0] = s + 1
            slots.at[sv] = s
            slots.sv[s] = sv
            first = base + N_SKY + errors.n_bias + s * errors.block
            for j in range(first, first + errors.block):
                _fresh(x, P, j)
        slots.seen_ns[slots.at[sv]] = t_ns


@njit
def memory(errors: ErrorModel, n_slots: int, dt: float, speed: float, phi: F8) -> None:
    """Factors exp(-dt / tau) of all error states, into ``phi``; motion shortens multipath."""
    for j in range(N_SKY + errors.n_bias):
        phi[j] = 1.0
    phi[TROPOSPHERE] = math.exp(-dt / errors.troposphere_tau)
    phi[VERTICAL] = math.exp(-dt / errors.vertical_tau)
    phi[NORTH], phi[EAST] = phi[VERTICAL], phi[VERTICAL]
    slow, ionosphere = math.exp(-dt / errors.slow_tau), math.exp(-dt / errors.ionosphere_tau)
    signal = math.exp(-dt / errors.signal_tau)
    multipath = math.exp(-dt * (1.0 / errors.multipath_tau + speed / errors.multipath_length))
    for s in range(n_slots):
        b = N_SKY + errors.n_bias + s * errors.block
        phi[b + SLOW], phi[b + IONOSPHERE], phi[b + SIGNAL] = slow, ionosphere, signal
        if errors.signal2 >= 0:
            phi[b + errors.signal2] = signal
        if errors.multipath1 >= 0:
            phi[b + errors.multipath1] = multipath
        if errors.multipath2 >= 0:
            phi[b + errors.multipath2] = multipath


@njit
def predict_errors(
    errors: ErrorModel, slots: Slots, x: F8, P: F8, nk: int, nc: int, dt: float, F: F8, phi: F8
) -> None:  # fmt: skip
    """Error states ``dt`` s later and their covariance with the rest; the rest by `starwise.kernels.process.predict`.

    The dynamics are diagonal: every element of P is scaled once. Rows of motion and clocks are left symmetric.
    """
    base = nk + 2 * nc
    n = base + n_errors(errors, slots)
    speed = 0.0
    if nk > 3:
        # less what noise of the estimate adds: at rest it would look like motion
        speed2 = x[3] * x[3] + x[4] * x[4] + x[5] * x[5] - P[3, 3] - P[4, 4] - P[5, 5]
        speed = math.sqrt(max(speed2, 0.0))
    memory(errors, slots.size[0], dt, speed, phi)
    orders = nk // 3
    for i in range(3):
        for a in range(orders):
            r = 3 * a + i
            for j in range(base, n):
                s = F[a, a] * P[r, j]
                for b in range(a + 1, orders):
                    s += F[a, b] * P[3 * b + i, j]
                P[r, j] = s
    for k in range(nc):
        r = nk + k
        for j in range(base, n):
            P[r, j] += dt * P[r + nc, j]
    for i in range(base):
        row = P[i]
        for j in range(n - base):
            row[base + j] *= phi[j]
        for j in range(base, n):
            P[j, i] = row[j]
    tail, first = np.uint64(n - base), np.uint64(base)
    for i in range(tail):
        f = phi[i]
        row = P[i + first]
        x[i + first] *= f
        for j in range(i, tail):  # unsigned: numba makes vector code only of indices that cannot be negative
            row[j + first] *= f * phi[j]
        row[i + first] += 1.0 - f * f


@njit
def shell_mapping(el: float) -> float:
    """Thin-shell mapping function: slant over vertical ionosphere."""
    c = SHELL_RATIO * math.cos(el)
    return 1.0 / math.sqrt(1.0 - c * c)


@njit
def shell_offset(el: float) -> float:
    """Distance from the receiver to where the ray pierces the shell, along the ground, 1000 km."""
    return 6.371 * (0.5 * math.pi - el - math.asin(SHELL_RATIO * math.cos(el)))


@njit
def weak_sigma(errors: ErrorModel, cn0: float) -> float:
    """Standard deviation of reflection and diffraction at a C/N0 (dB-Hz; NaN: not known), m."""
    if cn0 != cn0:
        return 0.0
    return float(errors.weak_sigma * 10.0 ** ((errors.weak_cn0 - max(cn0, 10.0)) / errors.weak_decade))


STREET_SPEED = 40.0  # m/s; whoever is faster has no reflectors beside him


@njit
def motion_rate_variance(errors: ErrorModel, cn0: float, speed2: float) -> float:
    """Variance that motion adds to a rate, (m/s)^2: a reflected signal has the Doppler shift of another direction."""
    b = errors.rate_weak * weak_sigma(errors, cn0)
    return min(speed2, STREET_SPEED**2) * (errors.rate_motion * errors.rate_motion + b * b)


@njit
def signal_sigmas(
    errors: ErrorModel, system: int, el: float, cn0: float, factor: float, scale: float
) -> tuple[float, float, float]:
    """Variance of white noise (m^2), standard deviation of multipath (m), and the part of both that is scaled.

    Reflected and diffracted signals are weak, and late by the size of streets. A combination of signals amplifies
    what is their own by ``factor``.
    """
    s = max(math.sin(el), 0.05)
    low = 1.0
    if cn0 == cn0 and cn0 < 45.0:
        low = 10.0 ** ((45.0 - max(cn0, 10.0)) / 10.0)
    weak = (weak_sigma(errors, cn0) * factor) ** 2
    a = errors.code_white[system] * factor
    white = scale * a * a * (0.5 * low + 0.5 / (s * s))
    b = scale * (errors.multipath_sigma[system] * factor / s) ** 2
    part = (white + b) / (white + b + weak)
    return white + (1.0 - errors.weak_share) * weak, math.sqrt(b + errors.weak_share * weak), part


@njit
def adapt_scale(errors: ErrorModel, slots: Slots, dt: float, total: float, weight: float) -> None:
    """Factor on the variance of code noise and multipath from the normalised innovations of an epoch.

    ``total`` / ``weight`` is their mean square, one if the factor is right. Innovations that are too large raise it
    at once: the antenna came among reflectors. Small ones take long to lower it: at rest, reflections stay as they are
    and show in no innovation. It never falls below one.
    """
    if not weight > 0.0 or not dt > 0.0:
        return
    q = total / weight
    tau = errors.scale_rise if q > 1.0 else errors.scale_fall
    scale = slots.scale[0] * (1.0 + (q - 1.0) * -math.expm1(-dt / tau))
    slots.scale[0] = min(max(scale, 1.0), errors.scale_max**2)
