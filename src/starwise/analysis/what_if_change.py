"""Changes of a run's measurements: what may be asked for, and what it does to a window of the run.

======================  ============================================================================================
``altimeter=S``         height, white 0.5 m, with a slow error of S m (5) over an hour, a state: barometric
``doppler``             pseudorange rates of all satellites used, with their usual variance
``imu_acceleration=S``  accelerations east, north, up (attitude known), white S m/s^2 (0.05), a bias of S over 300 s
``second_antenna=B``    heading from carrier phases over B m (1): 10 mm / B; the heading is a state of its own
``constellation=E``     satellites of another system, above the mask, with the variances of their kind
======================  ============================================================================================

A minus in front takes away (``-doppler``, ``-constellation=G``).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from starwise.analysis.run_window import OTHER, RunStep, RunWindow
from starwise.constants import SYSTEMS
from starwise.errors import StarwiseError
from starwise.types import F8, Layout

DEFAULTS: Final[dict[str, float | None]] = {
    "altimeter": 5.0, "doppler": None, "imu_acceleration": 0.05, "second_antenna": 1.0, "constellation": None,
}  # fmt: skip
"""What may be asked for, and the number it takes where none is given."""
ALTIMETER_WHITE_M: Final = 0.5
ALTIMETER_TAU_S: Final = 3600.0
ACCELERATION_TAU_S: Final = 300.0
HEADING_PRIOR: Final = math.pi / math.sqrt(3.0)
"""Standard deviation of a heading of which nothing is known, rad."""
HEADING_PSD: Final = 0.1**2
"""Random walk of a heading on the move, rad^2/s: six degrees in a second."""
PHASE_M: Final = 0.01
"""Error of a difference of carrier phases across a baseline, m."""


@dataclass(frozen=True)
class Change:
    """One measurement to add or to take away.

    Attributes
    ----------
    kind : str
        A key of `DEFAULTS`.
    add : bool
    value : float or None
        Its number.
    system : str
        Letter of the constellation, else empty.
    """

    kind: str
    add: bool = True
    value: float | None = None
    system: str = ""

    @property
    def text(self) -> str:
        """As it is written on the command line."""
        tail = f"={self.system}" if self.system else ""
        if self.value is not None and self.value != DEFAULTS[self.kind]:
            tail = f"={self.value:g}"
        return f"{'' if self.add else '-'}{self.kind}{tail}"

    @classmethod
    def parse(cls, text: str) -> "Change":
        """Change out of ``altimeter``, ``-doppler``, ``constellation=E``, ``altimeter=2.5`` ...

        Raises
        ------
        StarwiseError
            Nothing known, or a number that it does not take.
        """
        name, equals, tail = text.strip().lstrip("+").partition("=")
        add = not name.startswith("-")
        name = name.lstrip("-").replace("-", "_")
        if name not in DEFAULTS:
            wanted = "altimeter, doppler, imu_acceleration, second_antenna, constellation=LETTER; with - to remove"
            raise StarwiseError("what-if: not a measurement", found=text.strip() or "nothing", wanted=wanted)
        if name == "constellation":
            if len(tail) != 1 or tail.upper() not in SYSTEMS:
                raise StarwiseError("what-if: which constellation?", found=text, wanted=f"a letter of {SYSTEMS}")
            return cls(name, add, None, tail.upper())
        value = DEFAULTS[name]
        if equals:
            try:
                given = float(tail)
            except ValueError:
                given = math.nan
            if value is None or not 0.0 < given < math.inf:
                kind = "no" if value is None else "a positive"
                raise StarwiseError(f"what-if: {name} takes {kind} number", found=text)
            value = given
        if not add and value is not None:
            raise StarwiseError("what-if: the run has no such measurement to take away", found=text)
        return cls(name, add, value)


def selection(changes: Sequence[Change]) -> dict[str, Any]:
    """Keywords of a system's `changed`: whether rates are used (None: as they were), and the systems that are not."""
    rates = next((c.add for c in reversed(changes) if c.kind == "doppler"), None)
    return {"rates": rates, "without": "".join(c.system for c in changes if c.kind == "constellation" and not c.add)}


def with_heading(window: RunWindow, moving: bool) -> RunWindow:
    """Window with a heading among its states, about which nothing measured says anything."""
    n = window.n

    def grown(A: F8, corner: float) -> F8:
        B = np.zeros((n + 1, n + 1))
        B[:n, :n], B[n, n] = A, corner
        return B

    steps = []
    before = window.steps[0].t_ns
    for s in window.steps:
        q = HEADING_PSD * (s.t_ns - before) * 1e-9 if moving else 0.0
        before = s.t_ns
        H = np.concatenate([s.H, np.zeros((len(s.H), 1))], axis=1)
        steps.append(replace(s, Phi=grown(s.Phi, 1.0), Q=grown(s.Q, q), H=H))
    layout = Layout((*window.layout.names, "head"))
    return replace(window, layout=layout, prior=grown(window.prior, HEADING_PRIOR**2), steps=tuple(steps))


def added(window: RunWindow, change: Change) -> tuple[RunWindow, str]:
    """Window with the rows of a sensor at every epoch, and why not where it makes no sense."""
    if not change.add or change.value is None:
        return window, ""
    n, value, names = window.n, change.value, window.layout
    rows = np.zeros((1, n))
    if change.kind == "altimeter":
        rows[0, names.index("pos.u" if "pos.u" in names else "pos.d")] = 1.0
        return with_sensor(window, rows, ALTIMETER_WHITE_M, value, ALTIMETER_TAU_S, "alt"), ""
    if change.kind == "second_antenna":
        rows[0, names.index("att.d" if "att.d" in names else "head")] = 1.0
        return with_sensor(window, rows, math.atan(PHASE_M / value), 0.0, 1.0, "base"), ""
    if "att.d" in names:
        return window, "an inertial run has accelerometers"
    if "acc.e" not in names:
        return window, "the motion model has no acceleration to measure"
    rows = np.zeros((3, n))
    rows[range(3), names.indices(("acc.e", "acc.n", "acc.u"))] = 1.0
    return with_sensor(window, rows, value, value, ACCELERATION_TAU_S, "imu"), ""


def with_sensor(window: RunWindow, rows: F8, white: float, slow: float, tau_s: float, name: str) -> RunWindow:
    """Window with rows (k, n) at every epoch: white noise and, if not 0, a Markov error of sigma ``slow`` each."""
    k, states = len(rows), len(rows) if slow > 0.0 else 0
    steps, before = [], window.steps[0].t_ns
    for s in window.steps:
        dt = (s.t_ns - before) * 1e-9
        before = s.t_ns
        E = np.zeros((len(s.E) + k, s.E.shape[1] + states))
        E[: len(s.E), : s.E.shape[1]] = s.E
        if states:
            E[len(s.E) :, s.E.shape[1] :] = slow * np.eye(k)
        steps.append(
            RunStep(
                s.t_ns, s.Phi, s.Q, np.concatenate([s.phi, np.full(states, math.exp(-dt / tau_s))]),
                np.concatenate([s.H, rows]), E, np.concatenate([s.r, np.full(k, white**2)]),
                np.concatenate([s.widened, np.zeros(k)]), np.concatenate([s.kind, np.full(k, OTHER)]),
                np.concatenate([s.sv, np.full(k, -1, s.sv.dtype)]),
            )
        )  # fmt: skip
    names = tuple(f"{name}.{i}" for i in range(states))
    return replace(window, error_names=(*window.error_names, *names), steps=tuple(steps))
