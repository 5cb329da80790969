"""The filter of the stability paper on raw measurements, and its recovery when its state has been spoiled.

State: position, velocity, acceleration (ECEF, 9), clock bias and drift (m, m/s). Rows: pseudoranges of satellites at
rest, height above the ellipsoid, and in the improved model pseudorange rates and accelerations. Rows are taken one
after another, all linearised at the prediction: the same as all at once, and the whitened innovations come for free.

Watching. An epoch is refused if its NIS passes a chi-square gate; the prediction stays. Two exponentially weighted
means of the whitened innovations (short, long) find what is too small for that but lasts: under H0 the mean with
weight a has covariance a / (2 - a) I. The filter is lost after ``patience`` refused epochs in a row, or when a mean
passes its gate.

Recovery. (1) Roll back: filters kept some time ago are run again over the measurements since, newest first; the first
that nobody objects to goes on. That undoes whatever happened to the *state*. (2) If none will do, or there is none,
start the position (and the clock, if it can be solved) anew from a regional prior by iterated least squares, and keep
the rest. (3) If that is lost again soon, start velocity, acceleration and drift anew as well.

Sources: Groves (2013) 3.2.7, 17.3 and 17.4 (innovation filtering and recovery); Gao, Tan (2007) eq. 3-5.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starwise.constants import WGS84_A, WGS84_E2
from starwise.kernels._jit import njit

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

N = 11
CLK = 9
DRIFT = 10
NEVER = 0
"""Nobody watches: every epoch is used."""
REINITIALISE = 1
ROLL_BACK = 2
REFUSED = 0
RESETS = 1
ROLLED = 2
LAST = 3
"""Columns of `Memory.tally`: refused epochs in a row, new starts, roll-backs, epoch of the last new start."""


class Filter(NamedTuple):
    """Numbers of a filter."""

    clock: bool  # the measurements have the clock's error
    improved: bool
    solvable: bool  # the clock can be solved from one epoch
    F: F8  # (3, 3) transition of an axis
    G: F8  # (3, 3) its noise
    C: F8  # (2, 2) transition of the clock
    D: F8  # (2, 2) its noise
    variance: F8  # (m,) of the rows
    gate: float  # chi-square of an epoch
    mean_gate: float  # chi-square of a mean
    weight: F8  # (2,) of the means
    patience: int  # refused epochs in a row
    keep_every: int  # epochs between filters that are kept
    soon: int  # epochs within which a second new start is a whole one
    prior: F8  # (11,) state of a new start
    prior_sigma: F8  # (11,)


class Memory(NamedTuple):
    """What a filter carries; a run changes it."""

    x: F8  # (11,)
    P: F8  # (11, 11)
    mean: F8  # (2, m)
    tally: I8  # (4,)
    kept_x: F8  # (slots, 11)
    kept_P: F8  # (slots, 11, 11)
    kept_mean: F8  # (slots, 2, m)
    kept_at: I8  # (slots,) epoch; -1: empty


class Work(NamedTuple):
    """Work space."""

    H: F8  # (m, 11)
    zhat: F8  # (m,)
    w: F8  # (m,)
    x: F8  # (11,)
    P: F8  # (11, 11)
    at: F8  # (11,)


@njit
def predict_flight(f: Filter, x: F8, P: F8) -> None:
    """Time update, in place."""
    F, C = f.F, f.C
    for i in range(3):
        x[i] += F[0, 1] * x[3 + i] + F[0, 2] * x[6 + i]
        x[3 + i] += F[1, 2] * x[6 + i]
        x[6 + i] *= F[2, 2]
    x[CLK] += C[0, 1] * x[DRIFT]
    x[DRIFT] *= C[1, 1]
    for j in range(N):
        for i in range(3):
            P[i, j] += F[0, 1] * P[3 + i, j] + F[0, 2] * P[6 + i, j]
            P[3 + i, j] += F[1, 2] * P[6 + i, j]
            P[6 + i, j] *= F[2, 2]
        P[CLK, j] += C[0, 1] * P[DRIFT, j]
        P[DRIFT, j] *= C[1, 1]
    for j in range(N):
        for i in range(3):
            P[j, i] += F[0, 1] * P[j, 3 + i] + F[0, 2] * P[j, 6 + i]
            P[j, 3 + i] += F[1, 2] * P[j, 6 + i]
            P[j, 6 + i] *= F[2, 2]
        P[j, CLK] += C[0, 1] * P[j, DRIFT]
        P[j, DRIFT] *= C[1, 1]
    for i in range(3):
        for a in range(3):
            for b in range(3):
                P[3 * a + i, 3 * b + i] += f.G[a, b]
    for a in range(2):
        for b in range(2):
            P[CLK + a, CLK + b] += f.D[a, b]
    for i in range(N):
        for j in range(i):
            P[j, i] = P[i, j]


@njit
def linearise_flight(f: Filter, sat: F8, x: F8, H: F8, zhat: F8) -> None:
    """Rows of H and modelled measurements at the state ``x``."""
    k = len(sat)
    for r in range(len(zhat)):
        for i in range(N):
            H[r, i] = 0.0
    for s in range(k):
        dx, dy, dz = sat[s, 0] - x[0], sat[s, 1] - x[1], sat[s, 2] - x[2]
        rho = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / rho, dy / rho, dz / rho
        H[s, 0], H[s, 1], H[s, 2] = -dx, -dy, -dz
        zhat[s] = rho
        if f.improved:
            r = k + 1 + s
            along = dx * x[3] + dy * x[4] + dz * x[5]
            H[r, 0], H[r, 1], H[r, 2] = (x[3] - dx * along) / rho, (x[4] - dy * along) / rho, (x[5] - dz * along) / rho
            H[r, 3], H[r, 4], H[r, 5] = -dx, -dy, -dz
            zhat[r] = -along
        if f.clock:
            H[s, CLK] = 1.0
            zhat[s] += x[CLK]
            if f.improved:
                H[k + 1 + s, DRIFT] = 1.0
                zhat[k + 1 + s] += x[DRIFT]
    if f.improved:
        for i in range(3):
            H[2 * k + 1 + i, 6 + i] = 1.0
            zhat[2 * k + 1 + i] = x[6 + i]
    # Height: Bowring's formula, below 1e-6 m at flying heights, and its gradient, the vertical.
    p = math.sqrt(x[0] * x[0] + x[1] * x[1])
    b = WGS84_A * math.sqrt(1.0 - WGS84_E2)
    beta = math.atan2(x[2] * WGS84_A, p * b)
    lat = math.atan2(
        x[2] + WGS84_E2 / (1.0 - WGS84_E2) * b * math.sin(beta) ** 3, p - WGS84_E2 * WGS84_A * math.cos(beta) ** 3
    )
    sl, cl = math.sin(lat), math.cos(lat)
    zhat[k] = p * cl + x[2] * sl - WGS84_A * math.sqrt(1.0 - WGS84_E2 * sl * sl)
    H[k, 0], H[k, 1], H[k, 2] = cl * x[0] / p, cl * x[1] / p, sl


@njit
def update_flight(f: Filter, H: F8, zhat: F8, z: F8, at: F8, x: F8, P: F8, w: F8) -> float:
    """Measurement update with rows linearised at ``at``, x and P in place; whitened innovations in w; their NIS."""
    a = np.empty(N)
    nis = 0.0
    for r in range(len(z)):
        v, s = z[r] - zhat[r], f.variance[r]
        for i in range(N):
            v -= H[r, i] * (x[i] - at[i])
            t = 0.0
            for j in range(N):
                t += P[i, j] * H[r, j]
            a[i] = t
        for i in range(N):
            s += H[r, i] * a[i]
        w[r] = v / math.sqrt(s)
        nis += v * v / s
        for i in range(N):
            x[i] += a[i] * (v / s)
            for j in range(N):
                P[i, j] -= a[i] * a[j] / s
    return nis


@njit
def step_flight(f: Filter, sat: F8, z: F8, watched: bool, x: F8, P: F8, mean: F8, count: I8, work: Work) -> bool:
    """One epoch; True if the filter is lost."""
    predict_flight(f, x, P)
    linearise_flight(f, sat, x, work.H, work.zhat)
    for i in range(N):
        work.x[i] = x[i]
        for j in range(N):
            work.P[i, j] = P[i, j]
    nis = update_flight(f, work.H, work.zhat, z, x, work.x, work.P, work.w)
    if watched and not nis <= f.gate:
        count[REFUSED] += 1
        return bool(count[REFUSED] >= f.patience)
    count[REFUSED] = 0
    for i in range(N):
        x[i] = work.x[i]
        for j in range(N):
            P[i, j] = work.P[i, j]
    if not watched:
        return False
    lost = False
    for q in range(2):
        a, size = f.weight[q], 0.0
        for r in range(len(z)):
            mean[q, r] += a * (work.w[r] - mean[q, r])
            size += mean[q, r] * mean[q, r]
        lost |= size * (2.0 - a) / a > f.mean_gate
    return lost


@njit
def roll_back(f: Filter, sat: F8, z: F8, k: int, memory: Memory, work: Work) -> bool:
    """Newest kept filter that runs to epoch k without objection becomes the filter; False if there is none."""
    slots, m = len(memory.kept_at), z.shape[1]
    before = k
    for _ in range(slots):
        best = -1
        for s in range(slots):
            at = memory.kept_at[s]
            if 0 <= at < before and (best < 0 or at > memory.kept_at[best]):
                best = s
        if best < 0:
            return False
        before = memory.kept_at[best]
        for i in range(N):
            memory.x[i] = memory.kept_x[best, i]
            for j in range(N):
                memory.P[i, j] = memory.kept_P[best, i, j]
        for q in range(2):
            for r in range(m):
                memory.mean[q, r] = memory.kept_mean[best, q, r]
        memory.tally[REFUSED] = 0
        lost = False
        for e in range(before + 1, k + 1):
            if step_flight(f, sat, z[e], True, memory.x, memory.P, memory.mean, memory.tally, work):
                lost = True
                break
        if not lost and memory.tally[REFUSED] == 0:
            for s in range(slots):
                if memory.kept_at[s] > before:
                    memory.kept_at[s] = -1
            return True
    return False


@njit
def start_anew(f: Filter, sat: F8, z: F8, whole: bool, memory: Memory, work: Work) -> None:
    """Position, clock if it can be solved, and if ``whole`` everything, from the prior and one epoch, iterated."""
    x, P = memory.x, memory.P
    x0, P0 = x.copy(), np.zeros((N, N))
    for i in range(N):
        for j in range(N):
            P0[i, j] = P[i, j]
    for i in range(N):
        # A clock that cannot be solved keeps its value: nothing else is known of it.
        if i < 3 or (i == CLK and f.solvable) or (whole and i != CLK):
            x0[i] = f.prior[i]
            for j in range(N):
                P0[i, j] = 0.0
                P0[j, i] = 0.0
            P0[i, i] = f.prior_sigma[i] ** 2
    for i in range(N):
        work.at[i] = x0[i]
    for _ in range(10):
        linearise_flight(f, sat, work.at, work.H, work.zhat)
        for i in range(N):
            x[i] = x0[i]
            for j in range(N):
                P[i, j] = P0[i, j]
        update_flight(f, work.H, work.zhat, z, work.at, x, P, work.w)
        for i in range(N):
            work.at[i] = x[i]
    for q in range(2):
        for r in range(len(z)):
            memory.mean[q, r] = 0.0
    for s in range(len(memory.kept_at)):
        memory.kept_at[s] = -1


@njit
def run_flight(
    f: Filter, sat: F8, z: F8, truth: F8, first: int, last: int, way: int, memory: Memory, error: F8
) -> None:
    """Epochs ``first`` .. ``last`` - 1 of a flight.

    Parameters
    ----------
    f : Filter
    sat : (k, 3)
        Satellites, ECEF, m.
    z : (K, m)
        Measurements.
    truth : (K, 3)
        Positions, ECEF, m.
    first, last : int
    way : int
        NEVER, REINITIALISE, ROLL_BACK.
    memory : Memory
        In place.
    error : (K,)
        Out: distance of the position from the truth, m.
    """
    m = z.shape[1]
    work = Work(np.empty((m, N)), np.empty(m), np.empty(m), np.empty(N), np.empty((N, N)), np.empty(N))
    x, P, count = memory.x, memory.P, memory.tally
    for k in range(first, last):
        lost = step_flight(f, sat, z[k], way != NEVER, x, P, memory.mean, count, work)
        if lost:
            if way == ROLL_BACK and roll_back(f, sat, z, k, memory, work):
                count[ROLLED] += 1
            else:
                whole = count[RESETS] > 0 and k - count[LAST] <= f.soon
                start_anew(f, sat, z[k], whole, memory, work)
                count[RESETS] += 1
                count[LAST] = k
            count[REFUSED] = 0
        elif way != NEVER and count[REFUSED] == 0 and k % f.keep_every == 0:
            s = (k // f.keep_every) % len(memory.kept_at)
            memory.kept_at[s] = k
            for i in range(N):
                memory.kept_x[s, i] = x[i]
                for j in range(N):
                    memory.kept_P[s, i, j] = P[i, j]
            for q in range(2):
                for r in range(m):
                    memory.kept_mean[s, q, r] = memory.mean[q, r]
        dx, dy, dz = x[0] - truth[k, 0], x[1] - truth[k, 1], x[2] - truth[k, 2]
        error[k] = math.sqrt(dx * dx + dy * dy + dz * dz)
