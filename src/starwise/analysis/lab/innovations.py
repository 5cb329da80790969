"""Innovations of any filter as one plain table: what the laboratory judges.

A *channel* is a series of one kind: the code of a signal of a satellite, its rate, one axis of a position fix. An
*epoch* is an instant of the run. Of each row: innovation v, variance S that the filter claimed for it, whether it was
used, and, where it is known, how much of S is the measurement's own noise R; the rest is doubt about the states.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from starwise.constants import ROW_GATED, ROW_USED
from starwise.errors import StarwiseError
from starwise.frames import geodetic_from_ecef, rotations_ne_enu
from starwise.signals import signal_name, sv_name
from starwise.types import F8, I8, Solution

Mask = NDArray[np.bool_]

KINDS: Final = ("code", "rate", "phase", "position", "velocity", "other")
"""Sensors by which rows are grouped."""
UNITS: Final = {"code": "m", "rate": "m/s", "phase": "m", "position": "m", "velocity": "m/s", "other": ""}


@dataclass(frozen=True, order=True)
class Channel:
    """A series of innovations: satellite (``""``: none), signal or axis, sensor."""

    sv: str
    signal: str
    kind: str

    @property
    def system(self) -> str:
        """Letter of the satellite's system, empty where there is no satellite."""
        return self.sv[:1]

    @property
    def label(self) -> str:
        """Name for people: ``G05 1C code``."""
        return " ".join(part for part in (self.sv, self.signal, self.kind) if part)


@dataclass(frozen=True)
class Innovations:
    """Innovations of a run, sorted by channel, then time.

    Attributes
    ----------
    t_ns : (m,) int64
        Instants, GPST, strictly increasing.
    channels : tuple of Channel
    epoch, channel : (n,) int64
        Index in `t_ns` and `channels`.
    v, s : (n,) float64
        Innovation and its claimed variance, units of the channel's sensor.
    used : (n,) bool
    r : (n,) float64
        Part of s that is the measurement's own noise; NaN: not known.
    direction : (n, 3) float64
        Derivative of the measurement with respect to the position, ECEF; NaN: not known.
    gate : (n,) uint8
        How the filter gates the row: 0 not at all, 1 by itself, 2 together with another row of the satellite.
    gate_probability : float
        Chance that a row as modelled is refused.
    velocity : (m, 3) float64
        Of the antenna, ECEF m/s; NaN: not known.
    residuals : bool
        Rows of an epoch are residuals of a fit (not innovations): they add up to fewer degrees of freedom.
    nis, dof : (m,) float64
        Of the epoch, where the estimator says so itself (needed for residuals); NaN, 0: from the rows.
    """

    t_ns: I8
    channels: tuple[Channel, ...]
    epoch: I8
    channel: I8
    v: F8
    s: F8
    used: Mask
    r: F8
    direction: F8
    gate: NDArray[np.uint8]
    gate_probability: float = 0.0
    velocity: F8 = field(default_factory=lambda: np.empty((0, 3)))
    residuals: bool = False
    nis: F8 = field(default_factory=lambda: np.empty(0))
    dof: F8 = field(default_factory=lambda: np.empty(0))

    @cached_property
    def z(self) -> F8:
        """Innovations over their claimed standard deviations, (n,)."""
        return np.asarray(self.v / np.sqrt(self.s))

    @cached_property
    def kind(self) -> NDArray[np.int64]:
        """Index in `KINDS` of every row, (n,)."""
        return np.array([KINDS.index(c.kind) for c in self.channels], dtype=np.int64)[self.channel]

    @cached_property
    def state_part(self) -> F8:
        """Part of the claimed variance that is doubt about the states, 1 - r / s, (n,); NaN: not known."""
        return np.asarray(np.clip(1.0 - self.r / self.s, 0.0, 1.0))

    @cached_property
    def interval_s(self) -> float:
        """Most frequent step of the epochs, to a millisecond, s; NaN with fewer than two."""
        if len(self.t_ns) < 2:
            return math.nan
        steps, counts = np.unique(np.rint(np.diff(self.t_ns) * 1e-6), return_counts=True)
        return max(float(steps[np.argmax(counts)]), 1.0) * 1e-3

    @cached_property
    def slot(self) -> I8:
        """Place of every instant on a grid of the usual step, (m,): lags are counted in it, across gaps.

        Where instants are not on such a grid (or gaps are longer than all else) they are numbered as they come.
        """
        count = np.arange(len(self.t_ns), dtype=np.int64)
        step = self.interval_s * 1e9
        if len(count) < 3 or not step > 0.0:
            return count
        slot = np.rint((self.t_ns - self.t_ns[0]) / step).astype(np.int64)
        regular = bool((np.diff(slot) > 0).all()) and slot[-1] < 20 * len(count)
        return slot if regular else count

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(self.v)


def table(
    t_ns: ArrayLike,
    v: ArrayLike,
    s: ArrayLike,
    *,
    sv: Sequence[str] | NDArray[Any] | str = "",
    signal: Sequence[str] | NDArray[Any] | str = "",
    kind: Sequence[str] | NDArray[Any] | str = "code",
    used: ArrayLike | None = None,
    noise_var: ArrayLike | None = None,
    direction: ArrayLike | None = None,
    gate: ArrayLike | int = 0,
    gate_probability: float = 0.0,
    velocity_t_ns: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    residuals: bool = False,
) -> Innovations:
    """Innovations of any program as a table; see `Innovations` for what the columns are.

    Parameters
    ----------
    t_ns : (n,) array_like of int
        Time of every row, GPST ns, in any order.
    v, s : (n,) array_like
        Innovation, and its variance as claimed (not its sigma). Rows without either are left out.
    sv, signal, kind : (n,) sequence of str, or str
        Satellite as in RINEX, signal or axis, sensor (of `KINDS`); one text for all rows.
    used, noise_var, direction, gate
        Rows of `Innovations.used`, ``r``, ``direction``, ``gate``, as far as they are known.
    gate_probability : float
    velocity_t_ns, velocity : (k,), (k, 3) array_like
        Velocity of the antenna, ECEF m/s, and its times.
    residuals : bool

    Raises
    ------
    StarwiseError
        Columns of different lengths, an unknown sensor, a variance that is not one.
    """
    times = np.asarray(t_ns, dtype=np.int64)
    n = len(times)
    value, var = _column("v", v, n), _column("s", s, n)
    if (var[np.isfinite(var)] < 0.0).any():
        raise StarwiseError("a variance is negative", found=f"{np.nanmin(var):g}", wanted="variances, not sigmas")
    keep = np.isfinite(value) & np.isfinite(var) & (var > 0.0)
    names = [_names(column, n)[keep] for column in (sv, signal, kind)]
    wrong = sorted(set(names[2].tolist()) - set(KINDS))
    if wrong:
        raise StarwiseError("not a sensor", found=wrong[0], wanted=", ".join(KINDS))
    channels, channel = _channels(*names)
    epochs, epoch = np.unique(times[keep], return_inverse=True)
    order = np.lexsort((epoch, channel))
    made = Innovations(
        t_ns=epochs,
        channels=channels,
        epoch=epoch[order].astype(np.int64),
        channel=channel[order],
        v=value[keep][order],
        s=var[keep][order],
        used=(np.ones(n, dtype=bool) if used is None else np.asarray(used, dtype=bool))[keep][order],
        r=(np.full(n, np.nan) if noise_var is None else _column("noise_var", noise_var, n))[keep][order],
        direction=(np.full((n, 3), np.nan) if direction is None else np.asarray(direction, dtype=np.float64))[keep][
            order
        ],
        gate=np.broadcast_to(np.asarray(gate, dtype=np.uint8), (n,))[keep][order],
        gate_probability=gate_probability,
        velocity=_velocity_at(epochs, velocity_t_ns, velocity),
        residuals=residuals,
    )
    return made


def _column(name: str, values: ArrayLike, n: int) -> F8:
    column = np.asarray(values, dtype=np.float64)
    if column.shape != (n,):
        raise StarwiseError(f"'{name}' has another length than the times", found=str(column.shape), wanted=f"({n},)")
    return column


def _names(column: Sequence[str] | NDArray[Any] | str, n: int) -> NDArray[np.str_]:
    values: NDArray[np.str_] = np.asarray(column, dtype=np.str_)
    if values.shape not in ((), (n,)):
        raise StarwiseError("names have another length than the times", found=str(values.shape), wanted=f"({n},)")
    return np.broadcast_to(values, (n,))


def _channels(sv: NDArray[np.str_], signal: NDArray[np.str_], kind: NDArray[np.str_]) -> tuple[tuple[Channel, ...], I8]:
    """Channels in the order of their names, and that of every row."""
    parts = [np.unique(column, return_inverse=True) for column in (sv, signal, kind)]
    code = np.zeros(len(sv), dtype=np.int64)
    for labels, at in parts:
        code = code * max(len(labels), 1) + at
    present, channel = np.unique(code, return_inverse=True)
    made = []
    for number in present.tolist():
        fields = []
        for labels, _ in reversed(parts):
            number, k = divmod(number, len(labels))
            fields.append(str(labels[k]))
        made.append(Channel(*reversed(fields)))
    return tuple(made), channel.astype(np.int64)


def _velocity_at(epochs: I8, t_ns: ArrayLike | None, velocity: ArrayLike | None) -> F8:
    out = np.full((len(epochs), 3), np.nan)
    if t_ns is None or velocity is None:
        return out
    times, values = np.asarray(t_ns, dtype=np.int64), np.asarray(velocity, dtype=np.float64)
    if not len(times):
        return out
    at = np.clip(np.searchsorted(times, epochs), 0, len(times) - 1)
    same = times[at] == epochs
    out[same] = values[at[same]]
    return out


def of_solution(solution: Solution) -> Innovations | None:
    """Innovations in the ledger of a run; without rows where only epochs have a NIS; None where there is neither.

    Innovations without their variances are none: nothing says how large they should be.
    """
    ledger = solution.ledger
    if not set(_NEEDED) <= set(ledger) or not solution.n_epochs:
        return _epochs_only(solution)
    config = solution.provenance.get("config", {})
    lsq = config.get("method") == "lsq"
    residuals = lsq and config.get("error_model") == "white"
    colored = config.get("error_model", "colored") == "colored"
    probability = 0.0 if residuals else float(config.get("gate_probability", 0.0))
    parts = [_ledger_rows(ledger, "code"), _ledger_rows(ledger, "rate")]
    at = np.concatenate([rows for rows, _, _, _ in parts])
    v, s, used = (np.concatenate([part[i] for part in parts]) for i in (1, 2, 3))
    kind = np.repeat([0, 1], [len(part[0]) for part in parts])
    t_ns, inverse = np.unique(ledger["t_ns"], return_inverse=True)
    epoch = inverse[at].astype(np.int64)
    code = (ledger["sv"][at].astype(np.int64) << 16 | ledger["sig"][at].astype(np.int64)) << 1 | kind
    present, channel = np.unique(code, return_inverse=True)
    channels = tuple(
        Channel(sv_name(number >> 17), signal_name(number >> 1 & 0xFFFF), KINDS[number & 1])
        for number in present.tolist()
    )
    judged = _after_starts(solution, t_ns, epoch, used, s, lsq)
    order = np.lexsort((epoch, channel))
    order = order[judged[order]]
    at, epoch, kind = at[order], epoch[order], kind[order]
    known = np.searchsorted(solution.t_ns, t_ns)
    known = np.clip(known, 0, max(len(solution.t_ns) - 1, 0))
    here = solution.t_ns[known] == t_ns if len(solution.t_ns) else np.zeros(len(t_ns), dtype=bool)
    velocity = np.where(here[:, None], solution.vel_e[known], np.nan) if len(solution.t_ns) else np.empty((0, 3))
    position = np.where(here[:, None], solution.pos_e[known], np.nan) if len(solution.t_ns) else np.empty((0, 3))
    return Innovations(
        t_ns=t_ns,
        channels=channels,
        epoch=epoch,
        channel=channel[order].astype(np.int64),
        v=v[order],
        s=s[order],
        used=used[order],
        r=_noise(ledger, at, kind),
        direction=np.where((kind == 0)[:, None], _direction(ledger, at, position, epoch), np.nan),
        gate=_gates(ledger, at, colored, probability),
        gate_probability=probability,
        velocity=velocity,
        residuals=residuals,
        nis=np.where(here, solution.nis[known], np.nan) if residuals else np.empty(0),
        dof=np.where(here, solution.dof[known], 0).astype(np.float64) if residuals else np.empty(0),
    )


def _epochs_only(solution: Solution) -> Innovations | None:
    """Epochs of an estimator that gives their NIS and no more (fixes in an inertial navigator)."""
    if not (np.isfinite(solution.nis) & (solution.dof > 0)).any():
        return None
    nothing, none = np.empty(0), np.empty(0, dtype=np.int64)
    return Innovations(
        t_ns=solution.t_ns, channels=(), epoch=none, channel=none, v=nothing, s=nothing, used=np.empty(0, dtype=bool),
        r=nothing, direction=np.empty((0, 3)), gate=np.empty(0, dtype=np.uint8), velocity=solution.vel_e,
        residuals=True, nis=solution.nis, dof=solution.dof.astype(np.float64),
    )  # fmt: skip


_NEEDED: Final = (
    "t_ns", "sv", "sig", "status", "rate_used", "elevation_rad", "azimuth_rad", "innovation_m", "innovation_var_m2",
    "rate_innovation_mps", "rate_innovation_var_m2ps2",
)  # fmt: skip
"""Columns of a ledger that innovations are made of."""
NOTHING_KNOWN_M2: Final = 1e4
"""Variance of an innovation, m^2, above which it only says where the start was put."""


def _after_starts(solution: Solution, t_ns: I8, epoch: I8, used: Mask, s: F8, lsq: bool) -> Mask:
    """Rows that are innovations: not those of epochs that (re)start the filter, whose rows are of least squares.

    There the degrees of freedom of the epoch are fewer than its rows: least squares has spent some on its parameters.
    """
    if lsq:
        return s < NOTHING_KNOWN_M2
    known = np.clip(np.searchsorted(solution.t_ns, t_ns), 0, max(len(solution.t_ns) - 1, 0))
    rows = np.bincount(epoch[used], minlength=len(t_ns))
    start = (solution.t_ns[known] == t_ns) & (solution.dof[known] < rows)
    if np.mean(start) > 0.5:  # an estimator that counts otherwise
        return np.ones(len(epoch), dtype=bool)
    return np.asarray(~start[epoch])


def _ledger_rows(ledger: dict[str, NDArray[Any]], kind: str) -> tuple[I8, F8, F8, Mask]:
    """Rows of a sensor in a ledger, innovations, variances, and whether they were used."""
    names = ("innovation_m", "innovation_var_m2") if kind == "code" else (
        "rate_innovation_mps", "rate_innovation_var_m2ps2")  # fmt: skip
    v, s = ledger[names[0]], ledger[names[1]]
    taken = ledger["status"] == ROW_USED if kind == "code" else ledger["rate_used"].astype(bool)
    refused = ledger["status"] == ROW_GATED if kind == "code" else ~taken
    rows = np.flatnonzero(np.isfinite(v) & np.isfinite(s) & (s > 0.0) & (taken | refused))
    return rows, v[rows], s[rows], taken[rows]


def _noise(ledger: dict[str, NDArray[Any]], at: I8, kind: I8) -> F8:
    if "noise_var_m2" not in ledger:
        return np.full(len(at), np.nan)
    return np.where(kind == 0, ledger["noise_var_m2"][at], ledger["rate_noise_var_m2ps2"][at])


def _gates(ledger: dict[str, NDArray[Any]], at: I8, colored: bool, probability: float) -> NDArray[np.uint8]:
    """The coloured filter gates rows one by one, the white one code and rate of a satellite together."""
    if probability == 0.0:
        return np.zeros(len(at), dtype=np.uint8)
    if colored:
        return np.ones(len(at), dtype=np.uint8)
    both = (ledger["status"] == ROW_USED) & ledger["rate_used"].astype(bool)
    return np.where(both[at], 2, 1).astype(np.uint8)


def _direction(ledger: dict[str, NDArray[Any]], at: I8, position: F8, epoch: I8) -> F8:
    """Minus the unit vector to the satellite, ECEF, from the position of its epoch."""
    C = np.full((len(position), 3, 3), np.nan)
    there = np.isfinite(position).all(axis=1)
    llh = geodetic_from_ecef(position[there])
    C[there] = rotations_ne_enu(llh[:, 0], llh[:, 1])
    az, el = ledger["azimuth_rad"][at], ledger["elevation_rad"][at]
    enu = np.stack([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)], axis=1)
    return np.asarray(-np.einsum("nji,nj->ni", C[epoch], enu))
