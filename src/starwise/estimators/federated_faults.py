"""Faults in the local filters of a run, named: satellites, clocks of constellations, whole constellations.

Three watchers, each causal, each with thresholds of chance alone:

- a **satellite**, by the innovations of its code in the local filter: one, two in a row, or sums of several against
  their variances. The filter's gate has refused such a code already; here it gets a name;
- the **clock** of a constellation, by its changes against those of the others: one oscillator drives all of them, and
  system times wander by decimetres in hours. A jump is absorbed by the local filter; a ramp common to all satellites of
  a constellation looks like nothing else;
- a **constellation**, by the separation of its position from the fusion of the others. It leaves the fusion, starts
  anew by itself and comes back when it agrees.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import EPOCH_COASTED, EPOCH_RESET, NS, ROW_EXCLUDED
from starwise.estimators.federated_local import Local
from starwise.estimators.federated_master import beliefs, separations
from starwise.gnsstime import iso
from starwise.signals import sv_name
from starwise.types import F8, I8

SATELLITE: Final = "satellite"
CLOCK_JUMP: Final = "clock jump"
CLOCK_DRIFT: Final = "clock drift"
SEPARATED: Final = "separated"
RETURNED: Final = "returned"

ONE_SIGMA: Final = 6.0  # an innovation by itself: chance 2e-9
TWO_SIGMA: Final = 3.3  # each of two in a row, same sign: 5e-7
SUM_SIGMA: Final = 5.0  # sums over WINDOWS epochs over the root of their number: 6e-7
WINDOWS: Final = (5, 10)
WINDOW_S: Final = 30.0  # beyond, what a model leaves out lasts, too
LEAST_M: Final = 3.0  # what is smaller may be a reflection, and does little harm
LEAST_TOGETHER_M: Final = 1.0  # of three satellites to the same side
CLOCK_SIGMA: Final = 5.0
CLOCK_CHANGES: Final = 0.1
"""Part of a clock's variance that may change within `CLOCK_LAG_S`: its errors are those of orbits, atmosphere and
biases, which last for 40 minutes and more (2 x 60 / 2400 = 5 %)."""
CLOCK_FLOOR_M: Final = 0.7  # noise and multipath of codes, and satellites that come and go
CLOCK_LAG_S: Final = 60.0
SEPARATION: Final = 30.66  # chi-square, 3 degrees of freedom, 1e-6
AGREEMENT: Final = 16.27  # 1e-3
PATIENCE: Final = 2  # epochs in a row
PROBATION_S: Final = 60.0
PROBATION_EPOCHS: Final = 3
QUIET_S: Final = 60.0  # what recurs sooner is the same event
BARRED_S: Final = 3600.0  # a named satellite stays out of a local filter that starts anew
MAX_RESTARTS: Final = 20
CHUNK: Final = 1024


@dataclass(frozen=True)
class Event:
    """Something that a local filter was found guilty of.

    Attributes
    ----------
    t_ns : int
        GPST of the epoch at which it was named.
    constellation : str
        Letter.
    satellite : str or None
    cause : str
        ``satellite``, ``clock jump``, ``clock drift``, ``separated``, ``returned``.
    size_m : float
        Innovation, change of the clock, or distance of the positions.
    """

    t_ns: int
    constellation: str
    satellite: str | None
    cause: str
    size_m: float

    def record(self) -> dict[str, str | float | None]:
        """Plain values for `run.json`."""
        return {
            "gpst": iso(self.t_ns),
            "constellation": self.constellation,
            "satellite": self.satellite,
            "cause": self.cause,
            "size_m": round(self.size_m, 2),
        }


@dataclass(frozen=True)
class Alarms:
    """Satellites of a local filter whose codes are not where it expects them.

    Attributes
    ----------
    satellites : (S,)
    on : (m, S)
        Per epoch.
    size : (m, S)
        Innovation, m.
    """

    satellites: I8
    on: NDArray[np.bool_]
    size: F8


def alarms(local: Local, least_m: float = LEAST_M) -> Alarms:
    """Tests of the code innovations of every satellite of a local filter; those below ``least_m`` do not count."""
    t_ns = local.epochs.t_ns
    m = len(t_ns)
    epoch = np.repeat(np.arange(m), np.diff(local.epochs.offsets))
    calm = local.ep.status != EPOCH_RESET  # residuals of least squares are no innovations
    ok = np.isfinite(local.out.v_code) & (local.out.s_code > 0.0) & calm[epoch]
    satellites, column = np.unique(local.sv[ok], return_inverse=True)
    t, size = np.zeros((m, len(satellites))), np.zeros((m, len(satellites)))
    seen = np.zeros(t.shape, dtype=np.bool_)
    t[epoch[ok], column] = local.out.v_code[ok] / np.sqrt(local.out.s_code[ok])
    size[epoch[ok], column] = local.out.v_code[ok]
    seen[epoch[ok], column] = True
    on = np.abs(t) > ONE_SIGMA
    on[1:] |= (np.minimum(t[1:], t[:-1]) > TWO_SIGMA) | (np.maximum(t[1:], t[:-1]) < -TWO_SIGMA)
    step = float(np.median(np.diff(t_ns))) / NS if m > 1 else np.inf
    for n in WINDOWS:
        if m >= n and n * step <= WINDOW_S:
            on[n - 1 :] |= (np.abs(_sums(t, n)) > SUM_SIGMA * np.sqrt(n)) & (_sums(seen, n) == n)
    on &= np.abs(size) > least_m
    return Alarms(satellites, on, size)


def satellite_events(local: Local) -> list[Event]:
    """Satellites of a local filter that were named."""
    t_ns, found = local.epochs.t_ns, alarms(local)
    events = []
    for j in np.flatnonzero(found.on.any(axis=0)):
        name = sv_name(int(found.satellites[j]))
        for e in _apart(t_ns, np.flatnonzero(found.on[:, j])):
            events.append(Event(int(t_ns[e]), local.name, name, SATELLITE, float(found.size[e, j])))
    return events


def leaves(local: Local) -> NDArray[np.bool_]:
    """Epochs at which three or more satellites of a local filter have left to the same side within `WINDOW_S`; (m,).

    Its clock goes away, and its rates do not say so.
    """
    t_ns, found = local.epochs.t_ns, alarms(local, LEAST_TOGETHER_M)
    count = np.zeros(len(t_ns), dtype=np.int64)
    if not found.on.any():
        return count > 0
    lag = np.searchsorted(t_ns, t_ns - int(WINDOW_S * NS))
    for side in (found.size > 0.0, found.size < 0.0):
        total = np.concatenate([np.zeros((1, side.shape[1])), np.cumsum(found.on & side, axis=0)])
        count = np.maximum(count, (total[1:] - total[lag] > 0).sum(axis=1))
    return np.asarray(count >= 3)


def _sums(values: F8 | NDArray[np.bool_], n: int) -> F8:
    """Sums of n consecutive rows."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    return np.asarray(total[n:] - total[:-n])


def _apart(t_ns: I8, at: NDArray[np.intp]) -> list[int]:
    """The epochs of ``at`` that do not follow another one within `QUIET_S`."""
    return [int(e) for i, e in enumerate(at) if i == 0 or t_ns[e] - t_ns[at[i - 1]] > QUIET_S * NS]


def clock_events(made: Sequence[Local], use: NDArray[np.bool_]) -> list[Event]:
    """Clocks of constellations in ``use`` (m, K) that leave the others'; it takes three to tell whose it is."""
    t_ns = made[0].epochs.t_ns
    m, K = len(t_ns), len(made)
    if K < 3 or m < 3:
        return []
    here = use & np.stack([(local.ep.n_used > 0) & (local.ep.status != EPOCH_COASTED) for local in made], axis=1)
    clock = np.where(here, np.concatenate([local.ep.clock for local in made], axis=1), np.nan)
    var = np.where(here, np.concatenate([local.ep.clock_var for local in made], axis=1), np.nan)
    step = float(np.median(np.diff(t_ns))) / NS
    excess, size = np.zeros((m, K)), np.zeros((m, K))
    for lag in sorted({1, max(1, round(CLOCK_LAG_S / max(step, 1e-3)))}):
        if lag >= m:
            continue
        near = (t_ns[lag:] - t_ns[:-lag]) <= 2.0 * lag * max(step, 1e-3) * NS
        change = np.where(near[:, None], clock[lag:] - clock[:-lag], np.nan)
        # of an estimate that has learnt since: Var(x2 - x1) = P1 - P2
        spread = CLOCK_CHANGES * var[lag:] + np.maximum(var[:-lag] - var[lag:], 0.0) + CLOCK_FLOOR_M**2
        for k in range(K):
            others = np.delete(np.arange(K), k)
            enough = np.isfinite(change[:, others]).sum(axis=1) >= 2
            middle = np.zeros(len(change))
            doubt = np.full(len(change), np.inf)
            middle[enough] = np.nanmedian(change[enough][:, others], axis=1)
            doubt[enough] = np.nanmedian(spread[enough][:, others], axis=1)
            ratio = np.nan_to_num(np.abs(change[:, k] - middle) / np.sqrt(spread[:, k] + doubt))
            more = ratio > excess[lag:, k]
            excess[lag:, k] = np.where(more, ratio, excess[lag:, k])
            size[lag:, k] = np.where(more, change[:, k] - middle, size[lag:, k])
    worst = np.argmax(excess, axis=1)
    named = np.flatnonzero(excess[np.arange(m), worst] > CLOCK_SIGMA)
    events = []
    for k in range(K):
        for e in _apart(t_ns, named[worst[named] == k]):
            events.append(Event(int(t_ns[e]), made[k].name, None, _kind(clock, e, k), float(size[e, k])))
    return events


def _kind(clock: F8, e: int, k: int) -> str:
    """Jump or drift, by what the clock does in the epoch after against the others."""
    if e + 1 >= len(clock):
        return CLOCK_JUMP
    others = np.delete(np.arange(clock.shape[1]), k)
    now, then = clock[e] - clock[e - 1], clock[e + 1] - clock[e]
    first, second = (float(d[k] - np.nanmedian(d[others])) for d in (now, then))
    return CLOCK_JUMP if not abs(second) > 0.3 * abs(first) else CLOCK_DRIFT


def in_order(events: Sequence[Event]) -> list[Event]:
    """Events in the order of time; of those that are the same within `QUIET_S`, the first."""
    last: dict[tuple[str, str | None, str], int] = {}
    kept = []
    for event in sorted(events, key=lambda event: event.t_ns):
        key = (event.constellation, event.satellite, event.cause)
        if key not in last or event.t_ns - last[key] > QUIET_S * NS:
            kept.append(event)
        last[key] = event.t_ns
    return kept


def isolate(made: Sequence[Local], floor_m: float) -> tuple[NDArray[np.bool_], list[Event]]:
    """Which local filters the master fuses, (m, K), and why not the others.

    A local filter that leaves starts anew at the next epoch, without the satellites that were named; its arrays are
    overwritten from there on.
    """
    t_ns = made[0].epochs.t_ns
    m, K = len(t_ns), len(made)
    use = np.ones((m, K), dtype=np.bool_)
    events: list[Event] = []
    out = np.zeros(K, dtype=np.bool_)
    left = np.stack([leaves(local) for local in made], axis=1)
    bad, good, since, restarts = (np.zeros(K, dtype=np.int64) for _ in range(4))
    first = 0
    while first < m:
        end = min(first + CHUNK, m)
        b = beliefs(made, first, end)
        sep = separations(b, np.broadcast_to(~out, (end - first, K)), floor_m)
        change = end
        if out.any() or (sep > SEPARATION).any() or bad.any() or left[first:end].any():
            for e in range(first, end):
                row = sep[e - first]
                over = row > SEPARATION
                bad = np.where(over & ~out, bad + 1, 0)
                good = np.where(out & (row < AGREEMENT) & ~left[e], good + 1, 0)
                since = np.where(good == 1, t_ns[e], since)
                back = np.flatnonzero(
                    (good >= PROBATION_EPOCHS) & (t_ns[e] - since >= PROBATION_S * NS) & (restarts < MAX_RESTARTS)
                )
                guilty = np.flatnonzero((bad >= PATIENCE) | (left[e] & ~out & np.isfinite(row)))
                use[e] = ~out
                if len(back):
                    for k in back.tolist():
                        events.append(Event(int(t_ns[e]), made[k].name, None, RETURNED, 0.0))
                    out[back], good[back] = False, 0
                    change = e + 1
                    break
                active = int((~out & b.known[e - first]).sum())
                if len(guilty) and active >= 3:
                    k = int(guilty[np.argmax(row[guilty])])
                    cause = SEPARATED if bad[k] >= PATIENCE else CLOCK_DRIFT
                    events.append(Event(int(t_ns[e]), made[k].name, None, cause, _distance(made, ~out, k, e)))
                    out[k], use[e, k] = True, False
                    bad[:], good[k] = 0, 0
                    restarts[k] += 1
                    if restarts[k] < MAX_RESTARTS:
                        _start_anew(made[k], e + 1)
                        left[e + 1 :, k] = leaves(made[k])[e + 1 :]
                    change = e + 1
                    break
        first = change
    return use, events


def _distance(made: Sequence[Local], active: NDArray[np.bool_], k: int, e: int) -> float:
    others = [local.common[e, :3] for i, local in enumerate(made) if active[i] and i != k and local.solved[e]]
    return float(np.linalg.norm(made[k].common[e, :3] - np.mean(others, axis=0)))


def _start_anew(local: Local, first: int) -> None:
    """Run a local filter from an epoch on without the satellites that were named shortly before."""
    t_ns, offsets = local.epochs.t_ns, local.epochs.offsets
    if first >= len(t_ns):
        return
    begin = int(np.searchsorted(t_ns, t_ns[first] - int(QUIET_S * NS)))
    until = int(np.searchsorted(t_ns, t_ns[first] + int(BARRED_S * NS)))
    found = alarms(local)
    named = found.satellites[found.on[begin:first].any(axis=0)]
    rows = slice(int(offsets[first]), int(offsets[until]))
    if len(named) < 3:  # one or two; more are not the satellites' fault
        local.rows.status[rows][np.isin(local.sv[rows], named)] = ROW_EXCLUDED
    local.run(first)
