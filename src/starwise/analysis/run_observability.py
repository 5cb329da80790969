"""Observability of a finished run: what its measurements see, how well, and which combinations of states not at all.

Two views. *Epochs by themselves*: the codes of one epoch against the unknowns position and clocks, for every epoch of
the run. *Windows* of some epochs, evenly spread: all navigation states of the filter, with the errors of measurements
that last taken out exactly (`starwise.analysis.run_window.whitened`), scaled by the sigmas of a filter's start, so that
an eigenvalue of 1 is a direction about which the window says as much as the start did.

Beside the information of a window stands what a filter makes of it, process noise and all: sigma at its end with and
without the measurements; the first is the Cramer-Rao bound of the model along the window.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from starwise.analysis.lab.plain import plain
from starwise.analysis.observability import (
    TOLERANCE,
    WindowObservability,
    degree_by_solution,
    direction,
    seen_by,
)
from starwise.analysis.run_system import AnySystem, system_of
from starwise.analysis.run_window import RunWindow, filtered, whitened
from starwise.analysis.threads import one_thread
from starwise.analysis.words import paragraph, spoken
from starwise.errors import StarwiseError
from starwise.gnsstime import iso
from starwise.types import F8, I8, Layout, Solution

WINDOWS: Final = 8
"""Windows of a run, unless asked for others."""
EPOCHS: Final = 10
"""Epochs of a window."""
GROUPS: Final = {
    "pos": ("position", "m"), "vel": ("velocity", "m/s"), "acc": ("acceleration", "m/s^2"), "clk": ("clock", "m"),
    "drift": ("clock drift", "m/s"), "att": ("attitude", "rad"), "bg": ("gyro bias", "rad/s"),
    "ba": ("accelerometer bias", "m/s^2"), "isb": ("inter-system bias", "m"), "isd": ("inter-system drift", "m/s"),
    "head": ("heading", "rad"),
}  # fmt: skip
"""States by the first part of their names, with units."""


@dataclass(frozen=True)
class Span:
    """One window of a run.

    Attributes
    ----------
    t_ns : int
        Its first epoch, GPST.
    seconds : float
    satellites : float
        Mean number of satellites used.
    window : WindowObservability
    bound : (count, n) float64
        Cramer-Rao bound of the sigmas after each epoch, from the prior of a start.
    sigma : (n,) float64
        The same at the end with the weights that the filter used.
    sigma_free : (n,) float64
        At the end without any measurement.
    """

    t_ns: int
    seconds: float
    satellites: float
    window: WindowObservability
    bound: F8
    sigma: F8
    sigma_free: F8

    @property
    def degree(self) -> F8:
        """Degree of observability of each state, 1 - sigma / sigma without measurements: 0 nothing, 1 everything."""
        return np.asarray(1.0 - self.sigma / self.sigma_free)

    @property
    def degree_paper(self) -> F8:
        """The degree of Gao and Tan's eq. 8-12 for the initial state of one start sigma in every state; see `degree_by_solution`."""  # noqa: E501
        W = self.window.gramian * np.outer(self.window.scale, self.window.scale)
        return degree_by_solution(W, W @ np.ones(len(W)))


@dataclass(frozen=True)
class EpochGeometry:
    """Codes of single epochs against position and clocks.

    Attributes
    ----------
    epoch : (k,) int64
        Epochs of the run that have any code.
    unknowns, rank : (k,) int64
        3 and the number of clocks seen; how many combinations of them the codes determine.
    sigma_m : (k,) float64
        Sigma of the weakest combination (unit vector, metres) by the white noise of the codes and their lasting errors'
        prior; infinite where rank is missing.
    weakest : str
        That combination at the epoch of the middle sigma.
    """

    epoch: I8
    unknowns: I8
    rank: I8
    sigma_m: F8
    weakest: str

    @property
    def alone(self) -> float:
        """Part of the epochs that determine position and clocks by themselves."""
        return float((self.rank == self.unknowns).mean()) if len(self.epoch) else 0.0


@dataclass(frozen=True)
class Observability:
    """What the measurements of a run see of its states.

    Attributes
    ----------
    spans : tuple of Span
        Windows over the run.
    epochs : EpochGeometry or None
        None for inertial runs with fixes.
    notes : tuple of str
        What was left out or assumed.
    """

    spans: tuple[Span, ...]
    epochs: EpochGeometry | None
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        run: Solution | AnySystem,
        *,
        windows: int = WINDOWS,
        epochs: int = EPOCHS,
        tolerance: float = TOLERANCE,
    ) -> "Observability":
        """Observability of a finished run.

        Parameters
        ----------
        run : Solution or system
            A solution with its ledger and provenance, as `solve` returns and `read_solution` reads it.
        windows, epochs : int
            Number of windows, evenly spread over the run, and epochs of each.
        tolerance : float
            Of the rank: directions seen less than this part of the best seen one count as not seen.

        Raises
        ------
        StarwiseError
            The solution does not say what was measured: no ledger, no provenance.
        """
        system = system_of(run) if isinstance(run, Solution) else run
        if windows < 1 or epochs < 1:
            raise StarwiseError("no windows to look at", found=f"{windows} of {epochs} epochs", wanted="1 or more")
        with one_thread():
            spans = tuple(span(system, w, tolerance) for w in spread(system, windows, epochs))
        if not spans:
            raise StarwiseError("no measurement of the run was used: nothing is observable")
        return cls(spans, epoch_geometry(system, tolerance), system.notes)

    @property
    def verdict(self) -> str:
        """``observable``, ``weakly observable``, ``partly observable`` (in some windows only) or ``not observable``.

        Weakly: of full rank, but about some direction a window says less than the start of a filter knows.
        """
        found = [s.window.verdict for s in self.spans]
        lost = found.count("not observable")
        if lost:
            return "not observable" if lost == len(found) else "partly observable"
        return "observable" if all(v == "observable" for v in found) else "weakly observable"

    @property
    def unobservable(self) -> tuple[tuple[str, int], ...]:
        """Directions not seen, by name, with the number of windows in which they are not; most frequent first."""
        count = Counter(d.name for s in self.spans for d in s.window.unobservable)
        return tuple(count.most_common())

    def states(self) -> dict[str, dict[str, float]]:
        """Of each state the medians over the windows that have it: ``sigma, bound, sigma_free, degree, windows``."""
        names = list(dict.fromkeys(name for s in self.spans for name in s.window.layout.names))
        out = {}
        for name in names:
            have = [(s, s.window.layout.index(name)) for s in self.spans if name in s.window.layout]
            out[name] = {
                "sigma": float(np.median([s.sigma[i] for s, i in have])),
                "bound": float(np.median([s.bound[-1, i] for s, i in have])),
                "sigma_free": float(np.median([s.sigma_free[i] for s, i in have])),
                "degree": float(np.median([s.degree[i] for s, i in have])),
                "windows": float(len(have)),
            }
        return out

    def explain(self) -> str:
        """Verdict, reason and what would help, in plain words; lines of up to 79 columns."""
        first, n = self.spans[0], len(self.spans)
        size = f"{first.window.count} epochs ({first.seconds:.4g} s)"
        parts = []
        if self.unobservable:
            lost = sum(s.window.rank < len(s.window.layout) for s in self.spans)
            what = "; ".join(spoken(name) for name, _ in self.unobservable[:3])
            more = f" and {len(self.unobservable) - 3} others" if len(self.unobservable) > 3 else ""
            parts.append(
                f"{self.verdict}: in {lost} of {n} windows of {size} a shift of the state along {what}{more} changes "
                "no measurement. There the filter only repeats what it believed before; another satellite or sensor "
                "that sees it is needed, or motion over a longer window."
            )
        else:
            worst = max(self.spans, key=lambda s: s.window.condition)
            weakest = min((s.window for s in self.spans), key=lambda w: w.weakest.strength)
            text = f"{self.verdict}: measurements see all states in {n} windows of {size}"
            text += f", condition number up to {worst.window.condition:.2g}; seen least: {spoken(weakest.weakest.name)}"
            if weakest.weakest.strength < 1.0:
                text += f", about which a window tells {weakest.weakest.strength:.2g} of what was known before it"
            parts.append(text + ".")
        if self.epochs is not None and len(self.epochs.epoch):
            alone = self.epochs.alone
            sigma = np.median(self.epochs.sigma_m)
            text = f"{100.0 * alone:.4g} % of the epochs determine position and clocks by themselves"
            if alone >= 0.5:
                text += f", worst along {spoken(self.epochs.weakest)} (median sigma {sigma:.2g} m)"
            parts.append(text + ".")
        parts += [f"Note: {note}." for note in self.notes]
        return paragraph(parts)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain numbers, for JSON; None where there is no number."""
        record: dict[str, Any] = {
            "verdict": self.verdict,
            "explain": self.explain(),
            "unobservable": [{"direction": name, "windows": count} for name, count in self.unobservable],
            "states": self.states(),
            "windows": [_span_record(s) for s in self.spans],
            "epochs": None if self.epochs is None else _epoch_record(self.epochs),
            "notes": list(self.notes),
        }
        return dict(plain(record))


def spread(system: AnySystem, windows: int, epochs: int) -> list[RunWindow]:
    """Windows evenly spread over the epochs of a run with measurements; a memoryless estimator has epochs only."""
    measured = system.measured
    if not len(measured):
        return []
    count = 1 if system.memoryless else min(epochs, len(measured))
    last = len(measured) - count
    first = np.unique(np.linspace(0, last, windows).round().astype(int)) if last > 0 else np.zeros(1, dtype=int)
    return [system.window(int(measured[k]), count) for k in first]


def span(system: AnySystem, window: RunWindow, tolerance: float = TOLERANCE) -> Span:
    """Observability of one window."""
    if system.memoryless:
        window = window.without_unseen()
    O = whitened(window)  # noqa: E741
    seen = seen_by(O, window.layout, window.first, len(window.steps), prior=window.prior, tolerance=tolerance)
    n = window.n
    bound = np.array([np.sqrt(np.diag(b.P)[:n]) for b in filtered(window, widened=False)])
    sigma = bound[-1]
    if any(s.widened.any() for s in window.steps):
        *_, last = filtered(window)
        sigma = np.sqrt(np.diag(last.P)[:n])
    free = window.prior
    for s in window.steps:
        free = s.Phi @ free @ s.Phi.T + s.Q
    used = [len(set(s.sv.tolist()) - {-1}) for s in window.steps]
    return Span(
        window.steps[0].t_ns, window.duration_s, float(np.mean(used)), seen, bound, sigma, np.sqrt(np.diag(free))
    )


def epoch_geometry(system: AnySystem, tolerance: float = TOLERANCE) -> EpochGeometry | None:
    """Codes of each epoch against position and clocks."""
    table = system.table
    if table is None:
        return None
    rows = np.flatnonzero(table.used[:, 0] & (table.clock >= 0))
    if not len(rows):
        return None
    nc = len(table.clock_names)
    r = table.white[rows, 0] + table.lasting[rows, 0]
    H = np.zeros((len(rows), 3 + nc))
    H[:, :3] = -table.direction[rows]
    H[np.arange(len(rows)), 3 + table.clock[rows]] = 1.0
    H /= np.sqrt(r)[:, None]
    epoch, first = np.unique(table.epoch[rows], return_index=True)
    W = np.add.reduceat(H[:, :, None] * H[:, None, :], first, axis=0)
    d = np.sqrt(np.diagonal(W, axis1=1, axis2=2))
    there = d > 0.0
    unit = np.where(there, d, 1.0)
    even = np.linalg.eigvalsh(W / (unit[:, :, None] * unit[:, None, :]))
    rank = (even > tolerance**2 * even[:, -1:]).sum(axis=1)
    unknowns = there.sum(axis=1)
    lam, V = np.linalg.eigh(W + np.where(there, 0.0, 1e12)[:, :, None] * np.eye(3 + nc))  # clocks not seen stay out
    with np.errstate(divide="ignore"):
        sigma = np.where(rank == unknowns, 1.0 / np.sqrt(np.maximum(lam[:, 0], 1e-300)), np.inf)
    middle = int(np.argsort(sigma)[len(sigma) // 2])
    names = Layout((*("pos.e", "pos.n", "pos.u"), *(f"clk.{s}" for s in table.clock_names)))
    weakest = direction(V[middle][:, 0], names, np.ones(3 + nc), 0.0).name
    return EpochGeometry(epoch, unknowns, rank, sigma, weakest)


def _span_record(s: Span) -> dict[str, Any]:
    w = s.window
    names = w.layout.names
    position = [k for k, name in enumerate(names) if name.startswith("pos.")]

    def by_state(values: Sequence[float] | F8) -> dict[str, float]:
        return dict(zip(names, np.asarray(values, dtype=float).tolist(), strict=True))

    return {
        "first_gpst": iso(s.t_ns),
        "epoch": w.first,
        "epochs": w.count,
        "seconds": s.seconds,
        "satellites_mean": s.satellites,
        "verdict": w.verdict,
        "states": len(names),
        "rank": w.rank,
        "informative": w.informative,
        "condition": w.condition,
        "singular_values": w.singular.tolist(),
        "unobservable": [d.name for d in w.unobservable],
        "weakest": w.weakest.name,
        "weakest_strength": w.weakest.strength,
        "degree": by_state(s.degree),
        "degree_paper": by_state(s.degree_paper),
        "sigma_ratio": by_state(w.sigma_ratio),
        "sigma": by_state(s.sigma),
        "sigma_free": by_state(s.sigma_free),
        "bound": by_state(s.bound[-1]),
        "bound_position_m": np.linalg.norm(s.bound[:, position], axis=1).tolist(),
    }


def _epoch_record(g: EpochGeometry) -> dict[str, Any]:
    step = max(1, math.ceil(len(g.epoch) / 400))
    return {
        "count": len(g.epoch),
        "alone": g.alone,
        "weakest": g.weakest,
        "weakest_sigma_m": float(np.median(g.sigma_m)),
        "every": step,
        "epoch": g.epoch[::step].tolist(),
        "unknowns": g.unknowns[::step].tolist(),
        "rank": g.rank[::step].tolist(),
        "sigma_m": g.sigma_m[::step].tolist(),
    }
