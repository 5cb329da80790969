"""Stability of the filter of a finished run: what became of errors of its start, and of disturbances on the way.

The filter is followed from a start on, with the gains that it used (`starwise.analysis.run_system`). An error e of the
navigation states that enters before epoch k has become  Psi_j .. Psi_k e  after epoch j, Psi = (I - K H) Phi of all
states; of that product the rows and columns of the navigation states are kept. In units of P its norm is at most 1 for
optimal gains (Deyst, Price 1968; of a block, too: the rest of P only adds), in units of the late sigmas it may grow.

Lasting errors of measurements are states that fade by themselves or never do; no verdict rests on them.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from starwise.analysis.lab.plain import plain
from starwise.analysis.observability import direction, observability
from starwise.analysis.run_system import AnySystem, system_of
from starwise.analysis.run_window import RunStep, RunWindow
from starwise.analysis.stability import Growth, Verdict
from starwise.analysis.stability_controllability import (
    Controllability,
    UniformBounds,
    controllability,
    uniform_controllability,
    uniform_observability,
)
from starwise.analysis.stability_dare import SteadyState, spectral_radii, steady_state
from starwise.analysis.stability_system import LinearSystem
from starwise.analysis.threads import one_thread
from starwise.analysis.words import STATES, paragraph, spoken
from starwise.errors import StarwiseError
from starwise.gnsstime import iso
from starwise.types import F8, I8, Solution

STEPS: Final = 240
"""Epochs that are followed, unless asked for others."""
STARTS: Final = 6
"""Instants, evenly spread, at which a disturbance enters."""
SAMPLES: Final = 5
"""Epochs of which the spectral radius of Psi is computed."""
WINDOW: Final = 10
"""Epochs of the windows for uniform bounds."""


@dataclass(frozen=True)
class Stability:
    """Error dynamics of the filter of a run.

    Attributes
    ----------
    t_ns : int
        Epoch at which the filter started, GPST.
    epochs, of_epochs : int
        Epochs followed, and epochs of that stretch of the run.
    seconds : float
    states, error_states : int
        Navigation states, and states of lasting errors.
    scale : (n,) float64
        Late sigmas of the navigation states: units of the norms.
    left : str
        The error of the start of which most is left, by states.
    at : (k,) int64
        Epochs (from the start) of `spectral_radius` and `norm`.
    spectral_radius, norm : (k,) float64
        Of Psi with all states; the norm in units of the sigmas.
    product_norm, product_norm_P : (epochs,) float64
        Norm of the product from the start to each epoch, navigation states, in units of `scale` and of P.
    late_s : float
        Time over which a disturbance of the settled filter was followed: from the middle on.
    fade_s : dict of float
        Time after which a disturbance of the settled filter is down to 1/e, by groups of states: as seen, or
        extrapolated where it lasts longer than `late_s`; infinite: it does not fade in that time.
    exponents_per_s : (n,) float64
        Finite-time Lyapunov exponents of the settled filter, falling, 1/s; NaN: of what is lost in rounding.
    growth : tuple of Growth
        Transient growth by groups.
    controllability : Controllability
        By process noise, of the navigation states.
    constants : tuple of str
        Error states that no noise reaches.
    observable_bounds, controllable_bounds : UniformBounds
        Of the Gramians of all windows of some epochs, states in units of `scale`.
    steady : SteadyState or None
        Of the last epoch's geometry held for ever; only where errors are white.
    memoryless : bool
        Single epochs: there are no error dynamics.
    notes : tuple of str
    """

    t_ns: int
    epochs: int
    of_epochs: int
    seconds: float
    states: int
    error_states: int
    scale: F8
    left: str
    at: I8
    spectral_radius: F8
    norm: F8
    product_norm: F8
    product_norm_P: F8
    late_s: float
    fade_s: dict[str, float]
    exponents_per_s: F8
    growth: tuple[Growth, ...]
    controllability: Controllability
    constants: tuple[str, ...]
    observable_bounds: UniformBounds | None
    controllable_bounds: UniformBounds | None
    steady: SteadyState | None
    memoryless: bool = False
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, run: Solution | AnySystem, *, steps: int | None = STEPS) -> "Stability":
        """Stability of the filter of a finished run, followed from the start of its longest stretch without a restart.

        Parameters
        ----------
        run : Solution or system
            A solution with its ledger and provenance.
        steps : int, optional
            Epochs to follow; None: all of them (a day at 30 s with 30 satellites takes some ten seconds).

        Raises
        ------
        StarwiseError
            The solution does not say what was measured; fewer than two epochs to follow.
        """
        system = system_of(run) if isinstance(run, Solution) else run
        first, length = system.longest_stretch()
        count = length if steps is None else min(steps, length)
        if count < 2:
            raise StarwiseError("too short to be followed", found=f"{count} epochs in a stretch", wanted="2 or more")
        if system.memoryless:
            count = 2  # nothing is followed: a form of the object
        with one_thread():
            return _follow(system, system.window(first, count), length)

    @property
    def contraction(self) -> float:
        """What the run leaves of the worst error of its start: in units of the sigmas, or of P, the larger."""
        return float(max(self.product_norm[-1], self.product_norm_P[-1]))

    @property
    def verdict(self) -> Verdict | str:
        """``asymptotically stable``, ``stable``, ``not stable``; ``no memory`` for estimators of single epochs.

        Asymptotically: 1/e or less is left of every error of the start. Not stable: the worst is e times as large at
        the end, and 1.5 times what it was in the first half.
        """
        if self.memoryless:
            return "no memory"
        if self.contraction <= math.exp(-1.0):
            return "asymptotically stable"
        norm = self.product_norm
        growing = norm[-1] > math.e and norm[-1] > 1.5 * norm[: (len(norm) + 1) // 2].max()
        return "not stable" if growing else "stable"

    @property
    def worst_growth(self) -> Growth | None:
        """Group of states with the largest transient growth."""
        return max(self.growth, key=lambda g: g.factor, default=None)

    def explain(self) -> str:
        """Verdict, reason and warnings, in plain words; lines of up to 79 columns."""
        if self.memoryless:
            return paragraph(
                ["no memory: every epoch is solved by itself. No error outlives its epoch, and none is averaged."]
            )
        part = "" if self.epochs == self.of_epochs else f" of {self.of_epochs}"
        parts = [
            f"{self.verdict}: after {self.epochs}{part} epochs ({self.seconds:.4g} s) {self.contraction:.2g} is left "
            f"of the error of the start that lasts longest ({spoken(self.left)})."
        ]
        fades = ", ".join(f"{STATES.get(name, name)} {_time(t, self.late_s)}" for name, t in self.fade_s.items())
        parts.append(f"Once settled, the filter forgets a disturbance (1/e is left) after: {fades}.")
        worst = self.worst_growth
        if worst is not None and worst.factor > 2.0:
            parts.append(
                f"Before that an error of {STATES.get(worst.states, worst.states)} grows {worst.factor:.3g}-fold "
                f"within {worst.after_s:.3g} s: the spectral radius does not show this."
            )
        low, high = float(self.spectral_radius.min()), float(self.spectral_radius.max())
        parts.append(
            f"Spectral radius of {len(self.at)} single epochs {_radius(low)} to {_radius(high)} (below 1, and repeated "
            "for ever, such an epoch forgets every error; what counts is the product of all, above)."
        )
        text = self.controllability.explain()
        if self.constants:
            text += f" Taken as constant, without noise: {_listed(self.constants)}."
        parts.append(text)
        bounds = (self.observable_bounds, self.controllable_bounds)
        for what, b in zip(("Measurements inform", "Process noise moves"), bounds, strict=True):
            if b is not None:
                every = "in each" if b.holds else "but not in each"
                parts.append(
                    f"{what} every direction of the state, {every} of {b.windows} windows of {b.count} epochs."
                )
        return paragraph([*parts, *(f"Note: {note}." for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain numbers, for JSON; None where there is no number."""
        step = max(1, math.ceil(self.epochs / 400))
        worst = self.worst_growth
        record = {
            "verdict": self.verdict,
            "explain": self.explain(),
            "first_gpst": iso(self.t_ns),
            "epochs": self.epochs,
            "epochs_of_stretch": self.of_epochs,
            "seconds": self.seconds,
            "states": self.states,
            "error_states": self.error_states,
            "contraction": self.contraction,
            "left": self.left,
            "spectral_radius_max": self.spectral_radius.max() if len(self.at) else math.nan,
            "spectral_radius": self.spectral_radius,
            "norm": self.norm,
            "sampled_epochs": self.at,
            "product_norm": self.product_norm[::step],
            "product_norm_P": self.product_norm_P[::step],
            "every": step,
            "followed_late_s": self.late_s,
            "fade_s": self.fade_s,
            "exponents_per_s": self.exponents_per_s,
            "growth": [vars(g) for g in self.growth],
            "growth_max": None if worst is None else worst.factor,
            "controllable": self.controllability.controllable,
            "controllable_rank": self.controllability.rank,
            "uncontrollable": [d.name for d in self.controllability.uncontrollable],
            "constants": list(self.constants),
            "observable_bounds": None if self.observable_bounds is None else vars(self.observable_bounds),
            "controllable_bounds": None if self.controllable_bounds is None else vars(self.controllable_bounds),
            "steady_sigma": None if self.steady is None else np.sqrt(np.diag(self.steady.P)),
            "steady_spectral_radius": None if self.steady is None else self.steady.spectral_radius,
            "notes": list(self.notes),
        }
        return dict(plain(record))


def _follow(system: AnySystem, window: RunWindow, length: int) -> Stability:
    """Covariance and disturbances of a window, epoch by epoch."""
    n, N, P = window.n, len(window.steps), window.prior_of_all()
    groups = _groups(window)
    entries = np.unique(np.linspace(0, N - 1, STARTS + 1).astype(int)[:-1])
    middle = int(entries[np.abs(entries - N // 2).argmin()])
    samples = set(np.unique(np.linspace(0, N - 1, SAMPLES).astype(int)).tolist())
    M = np.zeros((len(P), 0))
    blocks, variances, roots, radii, norms = [], [], [], [], []
    L0 = np.linalg.cholesky(_scaled(window.prior))
    for k, s in enumerate(window.steps):
        if k in entries:
            fresh = np.zeros((len(P), n))
            fresh[:n] = np.eye(n)
            M = np.concatenate([M, fresh], axis=1)
        P, K, H = _step(P, s, n)
        M[:n] = s.Phi @ M[:n]
        M[n:] *= s.phi[:, None]
        M = M - K @ (H @ M)
        blocks.append(M[:n].copy())
        variances.append(np.diag(P)[:n].copy())
        L = np.linalg.cholesky(_scaled(P[:n, :n]))
        d, d0 = np.sqrt(np.diag(P)[:n]), np.sqrt(np.diag(window.prior))
        roots.append(np.linalg.solve(L, (M[:n, :n] * d0 / d[:, None]) @ L0))
        if k in samples:
            Psi = np.eye(len(P)) - K @ H
            Psi[:, :n] = Psi[:, :n] @ s.Phi
            Psi[:, n:] = Psi[:, n:] * s.phi
            # Constants of signals that this epoch does not have: an eigenvalue of exactly 1 each, of no interest.
            there = np.concatenate([np.ones(n, dtype=bool), (s.phi < 1.0) | s.E.any(axis=0)])
            Psi = Psi[np.ix_(there, there)]
            sigma = np.sqrt(np.diag(P))[there]
            radii.append(float(spectral_radii(Psi)))
            norms.append(float(np.linalg.norm(Psi * sigma / sigma[:, None], 2)))
    scale = np.sqrt(np.mean(variances[N // 2 :], axis=0))
    D = scale / scale[:, None]
    j = int(np.searchsorted(entries, middle))
    late = np.array([b[:, j * n : (j + 1) * n] for b in blocks[middle:]])
    late_s = max((window.steps[-1].t_ns - window.steps[max(middle - 1, 0)].t_ns) * 1e-9, window.period_s)
    with np.errstate(divide="ignore"):
        singular = np.linalg.svd(late[-1] * D, compute_uv=False)
        # What is below rounding of the largest is no number of the product's any more.
        exponents = np.log(np.where(singular > 1e-13 * n * singular[0], singular, np.nan)) / late_s
    plain_system = window.navigation()
    steady = None
    if not window.error_names and len(window.steps[-1].r):
        try:
            steady = steady_state(plain_system.steps[-1])
        except ValueError:
            steady = None
    bounds = _bounds(plain_system, scale)
    permanent = np.all([s.phi == 1.0 for s in window.steps[1:]], axis=0)
    return Stability(
        t_ns=window.steps[0].t_ns, epochs=N, of_epochs=length, seconds=window.duration_s,
        states=n, error_states=len(window.error_names), scale=scale, left=_left(blocks[-1][:, :n] * D, scale, window),
        at=np.array(sorted(samples), dtype=np.int64), spectral_radius=np.array(radii), norm=np.array(norms),
        product_norm=np.linalg.norm(np.array([b[:, :n] for b in blocks]) * D, 2, axis=(1, 2)),
        product_norm_P=np.linalg.norm(np.array(roots), 2, axis=(1, 2)),
        late_s=late_s, fade_s=_fades(late, D, groups, window, middle, late_s), exponents_per_s=exponents,
        growth=_growth(blocks, entries, groups, window),
        controllability=controllability(plain_system, 1 if n < N else 0),
        constants=tuple(name for name, same in zip(window.error_names, permanent, strict=True) if same),
        observable_bounds=bounds[0], controllable_bounds=bounds[1],
        steady=steady, memoryless=system.memoryless, notes=system.notes,
    )  # fmt: skip


def _bounds(system: LinearSystem, scale: F8) -> tuple[UniformBounds, UniformBounds]:
    """Uniform bounds of both Gramians over up to 20 windows; they hold if no window lacks a rank."""
    count = min(WINDOW, len(system))
    every = max(1, (len(system) - count) // 20)
    first = range(0, len(system) - count + 1, every)
    seen = uniform_observability(system, count, scale, every)
    moved = uniform_controllability(system, count, scale, every)
    return (
        replace(seen, holds=all(observability(system, k, count).rank == system.n for k in first)),
        replace(moved, holds=all(controllability(system, k, count).controllable for k in first)),
    )


def _step(P: F8, s: RunStep, n: int) -> tuple[F8, F8, F8]:
    """Covariance after a step, gain and measurement matrix of all states."""
    P = P.copy()
    P[:n] = s.Phi @ P[:n]
    P[:, :n] = P[:, :n] @ s.Phi.T
    P[n:] *= s.phi[:, None]
    P[:, n:] *= s.phi
    P[:n, :n] += s.Q
    P[range(n, len(P)), range(n, len(P))] += 1.0 - s.phi**2
    H = np.concatenate([s.H, s.E], axis=1)
    if not len(s.r):
        return P, np.zeros((len(P), 0)), H
    W = H @ P
    S = W @ H.T
    S[range(len(S)), range(len(S))] += s.r
    K = np.asarray(np.linalg.solve(S, W).T)
    P = P - K @ W
    return 0.5 * (P + P.T), K, H


def _scaled(P: F8) -> F8:
    """Correlations of P, a trace of independent noise added: what is singular to rounding has a root, too."""
    d = np.sqrt(np.diag(P))
    return np.asarray(P / np.outer(d, d) + 1e-12 * np.eye(len(P)))


def _left(product: F8, scale: F8, window: RunWindow) -> str:
    """Name of the error of the start of which most is left at the end."""
    V = np.linalg.svd(product)[2]
    return direction(V[0] * scale, window.layout, scale, 0.0).name


def _groups(window: RunWindow) -> dict[str, I8]:
    """Navigation states by the first part of their names."""
    stems = [name.partition(".")[0] for name in window.layout.names]
    return {g: np.flatnonzero([s == g for s in stems]) for g in dict.fromkeys(stems)}


def _fades(late: F8, D: F8, groups: dict[str, I8], window: RunWindow, middle: int, late_s: float) -> dict[str, float]:
    """Time in which a disturbance of each group falls to 1/e in that group, s."""
    before = window.steps[max(middle - 1, 0)].t_ns
    t = np.array([(s.t_ns - before) * 1e-9 for s in window.steps[middle:]])
    out = {}
    for name, at in groups.items():
        size = np.linalg.norm((late * D)[:, at[:, None], at], 2, axis=(1, 2))
        above = np.flatnonzero(size > math.exp(-1.0))
        if not len(above):
            out[name] = float(t[0]) if t[0] > 0.0 else window.period_s
        elif above[-1] + 1 < len(size):
            out[name] = float(t[above[-1] + 1])
        else:
            out[name] = float(late_s / -math.log(size[-1])) if size[-1] < 1.0 - 1e-9 else math.inf
    return out


def _growth(blocks: list[F8], entries: I8, groups: dict[str, I8], window: RunWindow) -> tuple[Growth, ...]:
    """Largest factor by which an error of a group grows in that group, over all entries and later epochs."""
    n, t0 = window.n, window.steps[0].t_ns
    cubes = [np.array([b[:, j * n : (j + 1) * n] for b in blocks[entry:]]) for j, entry in enumerate(entries)]
    found = []
    for name, at in groups.items():
        best = Growth(name, 1.0, 0.0, 0.0, 1.0)
        for j, entry in enumerate(entries):
            size = np.linalg.norm(cubes[j][:, at[:, None], at], 2, axis=(1, 2))
            k = int(size.argmax())
            if size[k] > best.factor:
                start = (window.steps[entry].t_ns - t0) * 1e-9
                after = (window.steps[entry + k].t_ns - t0) * 1e-9 - start + window.period_s
                best = Growth(name, float(size[k]), start, after, float(size[-1]))
        found.append(best)
    return tuple(found)


def _time(t: float, followed: float) -> str:
    if not math.isfinite(t):
        return f"not within {_time(followed, followed)}"
    text = f"{t:.3g} s" if t < 3600.0 else f"{t / 3600.0:.3g} h"
    return text if t <= followed else f"about {text}"


def _radius(rho: float) -> str:
    if abs(rho - 1.0) < 1e-9:
        return "1"
    return f"1 {'-' if rho < 1.0 else '+'} {abs(rho - 1.0):.1e}" if abs(rho - 1.0) < 0.01 else f"{rho:.3f}"


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(names[:6]) + (f" and {len(names) - 6} others" if len(names) > 6 else "")
