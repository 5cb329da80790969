"""What if: the same run with measurements added or taken away, and what becomes of observability and sigmas.

No position is computed again. The linear systems of windows of the run (`starwise.analysis.run_system`) get other rows
(`starwise.analysis.what_if_change`), and both analyses are repeated: which directions are seen, and the sigmas of a
filter that starts at the window's first epoch and sees all of it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.analysis.lab.plain import plain
from starwise.analysis.observability import TOLERANCE, WindowObservability, seen_by
from starwise.analysis.run_observability import spread
from starwise.analysis.run_system import AnySystem, RunSystem, system_of
from starwise.analysis.run_window import filtered, whitened
from starwise.analysis.threads import one_thread
from starwise.analysis.what_if_change import DEFAULTS, Change, added, selection, with_heading
from starwise.analysis.words import paragraph
from starwise.constants import SYSTEMS
from starwise.errors import StarwiseError
from starwise.types import F8, I8, Layout, Solution

WINDOWS: Final = 4
"""Windows of a run in which each change is tried."""
EPOCHS: Final = 30
"""Epochs of each."""
Sky = Callable[[str, I8, F8], tuple[I8, NDArray[Any], F8, F8]]
"""Satellites of a system (letter) at instants (k,) and places (k, 3), ECEF: instant's index, satellite, elevation and
azimuth (rad)."""


@dataclass(frozen=True)
class Outcome:
    """Observability and sigmas of the windows of a run under some changes.

    Attributes
    ----------
    name : str
        ``as it was``, or the changes.
    windows : tuple of WindowObservability
    sigma : dict of float
        By what people ask for: ``east``, ``north``, ``up`` (m), ``velocity`` (m/s), ``acceleration``, ``clock`` (m),
        ``drift``, ``heading`` (rad), ``tilt`` ...; median over the windows, at their ends.
    rows : float
        Measurements per epoch, mean.
    note : str
        Why the change is none, or what it took for granted; empty.
    """

    name: str
    windows: tuple[WindowObservability, ...]
    sigma: dict[str, float]
    rows: float
    note: str = ""

    @property
    def unobservable(self) -> dict[str, int]:
        """Directions not seen, with the number of windows."""
        found: dict[str, int] = {}
        for w in self.windows:
            for d in w.unobservable:
                found[d.name] = found.get(d.name, 0) + 1
        return found

    @property
    def position_m(self) -> float:
        """Sigma of the position, 3D, m."""
        return math.sqrt(sum(self.sigma[k] ** 2 for k in ("east", "north", "up")))


@dataclass(frozen=True)
class WhatIf:
    """Changes of a run's measurements, one by one and together, beside the run as it was.

    Attributes
    ----------
    base : Outcome
    outcomes : tuple of Outcome
    windows, epochs : int
        Size of the trial.
    """

    base: Outcome
    outcomes: tuple[Outcome, ...]
    windows: int
    epochs: int

    @classmethod
    def of(
        cls,
        run: Solution | AnySystem,
        changes: str | Sequence[str | Change],
        *,
        sky: Sky | None = None,
        windows: int = WINDOWS,
        epochs: int = EPOCHS,
    ) -> "WhatIf":
        """Outcomes of changes.

        Parameters
        ----------
        run : Solution or system
        changes : str or sequence
            ``"altimeter,-doppler,constellation=E"``, or a list of such; each is tried by itself, then all together.
        sky : callable, optional
            Where satellites of a constellation are that the run did not use; without it none can be added.
        windows, epochs : int

        Raises
        ------
        StarwiseError
            A change that is none, or a constellation of which nothing is known.
        """
        parts = changes.split(",") if isinstance(changes, str) else list(changes)
        wanted = [c if isinstance(c, Change) else Change.parse(c) for c in parts]
        if not wanted:
            raise StarwiseError("what-if: nothing asked for", wanted=", ".join(DEFAULTS))
        system = system_of(run) if isinstance(run, Solution) else run
        trial = _Trial(system, sky, windows, epochs, any(c.kind == "second_antenna" for c in wanted))
        with one_thread():
            base = trial.outcome(())
            outcomes = [trial.outcome((c,)) for c in wanted]
            if len(wanted) > 1:
                outcomes.append(trial.outcome(tuple(wanted)))
        return cls(base, tuple(outcomes), len(base.windows), trial.epochs)

    def gained(self, outcome: Outcome) -> tuple[list[str], list[str]]:
        """Directions that a change makes observable (in at least one window more), and those that it loses."""
        before, after = self.base.unobservable, outcome.unobservable
        return (
            [name for name, count in before.items() if after.get(name, 0) < count],
            [name for name, count in after.items() if before.get(name, 0) < count],
        )

    @property
    def verdict(self) -> str:
        """Which change lowers the position's sigma most, and by how much."""
        best = min(self.outcomes, key=lambda o: o.position_m)
        return f"{best.name}: position sigma {_percent(self.base.position_m, best.position_m)}"

    def explain(self) -> str:
        """A line or two for every change, in plain words; lines of up to 79 columns."""
        return paragraph([self._words(o) for o in self.outcomes])

    def _words(self, o: Outcome) -> str:
        if o.note and o.sigma == self.base.sigma:
            return f"{o.name}: {o.note}."
        gained, lost = self.gained(o)
        parts = []
        if gained:
            parts.append(f"makes {'; '.join(gained[:3])} observable")
        if lost:
            parts.append(f"loses {'; '.join(lost[:3])}")
        moved = [
            f"{key} {_percent(self.base.sigma[key], o.sigma[key])}"
            for key in o.sigma
            if key in self.base.sigma and abs(o.sigma[key] / self.base.sigma[key] - 1.0) > 0.005
        ]
        parts.append("sigmas: " + (", ".join(moved) if moved else "as before, to half a per cent"))
        return f"{o.name}: {'; '.join(parts)}." + (f" ({o.note})" if o.note else "")

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain numbers, for JSON."""

        def record(o: Outcome) -> dict[str, Any]:
            gained, lost = self.gained(o)
            before = self.base.sigma
            return {
                "change": o.name,
                "note": o.note or None,
                "rank": [w.rank for w in o.windows],
                "states": [len(w.layout) for w in o.windows],
                "rows_per_epoch": o.rows,
                "unobservable": [{"direction": name, "windows": count} for name, count in o.unobservable.items()],
                "becomes_observable": gained,
                "becomes_unobservable": lost,
                "position_3d_m": o.position_m,
                "sigma": o.sigma,
                "sigma_change": {k: v / before[k] - 1.0 for k, v in o.sigma.items() if before.get(k, 0.0) > 0.0},
            }

        return dict(
            plain(
                {
                    "verdict": self.verdict,
                    "explain": self.explain(),
                    "windows": self.windows,
                    "epochs": self.epochs,
                    "as_it_was": record(self.base),
                    "outcomes": [record(o) for o in self.outcomes],
                }
            )
        )


def _percent(before: float, after: float) -> str:
    return f"{100.0 * (after / before - 1.0):+.0f} %" if after < 10.0 * before else f"x {after / before:.3g}"


class _Trial:
    """The windows of a run, with a heading among the states if somebody asks for one, and changes of them."""

    def __init__(self, system: AnySystem, sky: Sky | None, windows: int, epochs: int, heading: bool) -> None:
        self.system, self.sky, self.heading = system, sky, heading
        self.spans = [(w.first, len(w.steps)) for w in spread(system, windows, epochs)]
        if not self.spans:
            raise StarwiseError("no measurement of the run was used: nothing to change")
        self.epochs = self.spans[0][1]

    def outcome(self, changes: tuple[Change, ...]) -> Outcome:
        """What becomes of the windows."""
        name = " + ".join(c.text for c in changes) or "as it was"
        system, notes = self.system, []
        for c in changes:
            if c.kind == "constellation" and not c.add and c.system not in system.systems:
                raise StarwiseError(f"what-if: the run used no satellite of {c.system} to take away")
            if c.kind == "constellation" and c.add:
                system, note = self._with_constellation(system, c.system)
                notes.append(note)
        seen, sigmas, rows = [], [], []
        for first, count in self.spans:
            window = system.changed(first, count, **selection(changes))
            if self.heading and "att.d" not in window.layout:
                window = with_heading(window, system.moving)
            for c in changes:
                window, note = added(window, c)
                notes += [note] if note and note not in notes else []
            if system.memoryless:
                window = window.without_unseen()
            O = whitened(window)  # noqa: E741
            seen.append(seen_by(O, window.layout, first, count, prior=window.prior, tolerance=TOLERANCE))
            *_, last = filtered(window)
            sigmas.append(by_group(window.layout, np.asarray(np.diag(last.P)[: window.n])))
            rows.append(float(np.mean([len(s.r) for s in window.steps])))
        keys = list(dict.fromkeys(key for s in sigmas for key in s))
        sigma = {key: float(np.median([s[key] for s in sigmas if key in s])) for key in keys}
        return Outcome(name, tuple(seen), sigma, float(np.mean(rows)), "; ".join(notes))

    def _with_constellation(self, system: AnySystem, letter: str) -> tuple[AnySystem, str]:
        """System in which satellites of another constellation were used at the epochs of the windows."""
        if not isinstance(system, RunSystem):
            return system, "satellites cannot be added to an inertial run"
        table = system.table
        if (table.used[:, 0] & (table.sv >> 8 == SYSTEMS.index(letter))).any():
            return system, f"satellites of {letter} are used already"
        if self.sky is None:
            raise StarwiseError(
                f"what-if: nothing is known of where satellites of {letter} were",
                found="no row of it in the ledger has a direction",
                wanted="the navigation files of the run where its run.json says they are, with that system in them",
            )
        epochs = np.unique(np.concatenate([np.arange(first, first + count) for first, count in self.spans]))
        epochs = epochs[system.solution.has_position[epochs]]
        solution = system.solution
        index, sv, elevation, azimuth = self.sky(letter, solution.t_ns[epochs], solution.pos_e[epochs])
        above = elevation >= math.radians(system.config.mask_deg)
        if not above.any():
            raise StarwiseError(f"what-if: no satellite of {letter} above the mask in the navigation files of the run")
        made = system.with_satellites(letter, epochs[index[above]], sv[above], elevation[above], azimuth[above])
        return made, f"{len(np.unique(sv[above]))} satellites of {letter}, out of the navigation files"


def by_group(layout: Layout, variance: F8) -> dict[str, float]:
    """Sigmas as people ask for them, out of the variances of the states."""
    v = dict(zip(layout.names, variance.tolist(), strict=True))
    out = {}
    single = {"pos.e": "east", "pos.n": "north", "pos.u": "up", "pos.d": "up", "head": "heading", "att.d": "heading"}
    for name, label in single.items():
        if name in v:
            out[label] = math.sqrt(v[name])
    both = {
        "vel": "velocity", "acc": "acceleration", "att": "tilt", "bg": "gyro bias", "ba": "accelerometer bias",
        "clk": "clock", "isb": "inter-system", "drift": "drift",
    }  # fmt: skip
    for stem, label in both.items():
        parts = [x for name, x in v.items() if name.startswith(f"{stem}.") and name != "att.d"]
        if parts:
            out[label] = math.sqrt(max(parts) if stem in ("clk", "isb", "drift") else sum(parts))
    return out
