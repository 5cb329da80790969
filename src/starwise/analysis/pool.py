"""Sessions of several runs pooled: whether the claimed covariance holds the truth as often as it says.

The error of a filter at rest is one slowly moving number, so that a run of a day says little more about its covariance
than one epoch does. Many runs of a few hours, each with a filter started anew, are a sample. Every session counts the
same, whatever its rate and length: an hour at 1 Hz knows no more of an error that lasts for an hour than one at 30 s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.analysis.accuracy import CHI2, NOMINAL, SPACES, Matched, match
from starwise.errors import StarwiseError
from starwise.gnsstime import session_numbers
from starwise.types import Solution, Truth

F8 = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """A solution to be pooled, and its truth.

    Attributes
    ----------
    name : str
    solution : Solution
    truth : Truth
    vertical : bool
        False: heights are not comparable; the run counts horizontally alone.
    """

    name: str
    solution: Solution
    truth: Truth
    vertical: bool = True


_MEANS: Final = ("nees_mean", "sigma_3d_mean_m", "mse_2d_m2", "mse_3d_m2")


def pool(
    runs: Sequence[Run], *, session_s: float | None = None, tolerance_s: float = 0.05, interpolate: bool = False
) -> dict[str, Any]:
    """Calibration curve, NEES and claimed sigma over the sessions of several runs, each session with equal weight.

    Parameters
    ----------
    runs : sequence of Run
    session_s : float, optional
        Length of a session, s. Default: as the run was made (`RunConfig.session_s`), or else the whole run as one.
    tolerance_s, interpolate
        See `starwise.analysis.accuracy.match`.

    Returns
    -------
    dict
        ``sessions``, ``epochs_compared``, ``coverage_50``, ``coverage_68``, ``coverage_95``, ``nees_mean`` (per degree
        of freedom: 1 expected), ``sigma_3d_mean_m``, ``rms_2d_m``, ``rms_3d_m``, ``calibration`` (see
        `starwise.analysis.accuracy.calibration`), and in ``runs`` the same of every run with its ``name``.

    Raises
    ------
    StarwiseError
        No run; one without a common epoch with its truth.
    """
    if not runs:
        raise StarwiseError("nothing to pool", wanted="results of solve")
    records, sessions = [], []
    for run in runs:
        mine = _sessions(run, session_s, tolerance_s, interpolate)
        records.append({"name": run.name, "truth": run.truth.source, **_pooled(mine)})
        sessions += mine
    return {**_pooled(sessions), "runs": records}


def _sessions(run: Run, session_s: float | None, tolerance_s: float, interpolate: bool) -> list[dict[str, Any]]:
    solution = run.solution
    matched = match(solution, run.truth, tolerance_s=tolerance_s, interpolate=interpolate)
    if not len(matched.at):
        raise StarwiseError("no epoch with both a position and a truth", file=run.name, found=run.truth.source)
    length = session_s or solution.provenance.get("config", {}).get("session_s")
    number = session_numbers(solution.t_ns, length)[matched.at] if length else np.zeros(len(matched.at), dtype=np.int64)
    return [_session(solution, matched, np.flatnonzero(number == one), run.vertical) for one in np.unique(number)]


def _session(solution: Solution, matched: Matched, which: NDArray[np.intp], vertical: bool) -> dict[str, Any]:
    """Means over the epochs of one session; NaN where nothing can be said."""
    error = matched.error_n[which]
    trace = np.trace(solution.cov_pos[matched.at[which]], axis1=1, axis2=2)
    known = matched.nees[which][np.isfinite(matched.nees[which])]
    held = {}
    for dof, nees in matched.nees_by_dof.items():
        stated = nees[which][~np.isnan(nees[which])]
        usable = len(stated) and (vertical or dof == 2)
        held[dof] = [float(np.mean(stated <= point)) if usable else np.nan for point in CHI2[dof]]
    return {
        "epochs": len(which),
        "held": held,
        "nees_mean": float(known.mean()) / 3.0 if len(known) and vertical else np.nan,
        "sigma_3d_mean_m": _mean(np.sqrt(trace[trace >= 0.0])),
        "mse_2d_m2": _mean((error[:, :2] ** 2).sum(axis=1)),
        "mse_3d_m2": _mean((error**2).sum(axis=1)) if vertical else np.nan,
    }


def _mean(values: F8) -> float:
    return float(values.mean()) if len(values) else np.nan


def _pooled(sessions: list[dict[str, Any]]) -> dict[str, Any]:
    """Means over sessions that have the number; None where none has."""

    def over(values: list[float]) -> float | None:
        known = [value for value in values if np.isfinite(value)]
        return float(np.mean(known)) if known else None

    curves = {SPACES[dof]: [over([s["held"][dof][i] for s in sessions]) for i in range(len(NOMINAL))] for dof in SPACES}
    mean = {name: over([s[name] for s in sessions]) for name in _MEANS}
    return {
        "sessions": len(sessions),
        "epochs_compared": sum(s["epochs"] for s in sessions),
        **{f"coverage_{share}": curves["3d"][i] for i, share in enumerate(NOMINAL)},
        "nees_mean": mean["nees_mean"],
        "sigma_3d_mean_m": mean["sigma_3d_mean_m"],
        "rms_2d_m": None if mean["mse_2d_m2"] is None else float(np.sqrt(mean["mse_2d_m2"])),
        "rms_3d_m": None if mean["mse_3d_m2"] is None else float(np.sqrt(mean["mse_3d_m2"])),
        "calibration": {"nominal": [share / 100.0 for share in NOMINAL], **curves},
    }
