"""Accuracy of a solution against the truth, and whether its covariance tells it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    EPOCH_COASTED,
    EPOCH_NO_SOLUTION,
    EPOCH_RESET,
    EPOCH_STATUS_NAMES,
    EPOCH_SUSPECT,
)
from starwise.errors import StarwiseError
from starwise.frames import C_ne_enu, geodetic_from_ecef, rotations_ne_enu
from starwise.types import Solution, Truth

F8 = NDArray[np.float64]
Mask = NDArray[np.bool_]

NOMINAL: Final = (50, 68, 95)
"""Shares, %, of epochs that regions of the claimed covariance are made to hold: points of the calibration curve."""
CHI2: Final[Mapping[int, tuple[float, ...]]] = {
    1: (0.454936423119572, 0.988946481478023, 3.84145882069412),
    2: (1.386294361119891, 2.27886856637673, 5.99146454710798),
    3: (2.365973884375338, 3.505882355768183, 7.814727903251178),
}
"""Points of chi-square at `NOMINAL`, by degrees of freedom (scipy.stats.chi2.ppf(nominal / 100, dof))."""
CHI2_3_95: Final = CHI2[3][2]
SPACES: Final = {3: "3d", 2: "horizontal", 1: "vertical"}
"""Names of the calibration curves by degrees of freedom: ellipsoid, ellipse, interval."""


@dataclass(frozen=True)
class Matched:
    """Epochs of a solution that have a truth, with its errors.

    Attributes
    ----------
    at : (m,) int64
        Their indices in the solution.
    error_n : (m, 3) float64
        Estimated minus true position, east north up of the true position, m.
    nees : (m,) float64
        Normalised error squared: error' P^-1 error, 3 degrees of freedom; NaN without a covariance.
    nees_2d, nees_up : (m,) float64
        The same of the horizontal error, 2 degrees of freedom, and of the vertical one, 1.
    """

    at: NDArray[np.int64]
    error_n: F8
    nees: F8
    nees_2d: F8
    nees_up: F8

    @property
    def nees_by_dof(self) -> dict[int, F8]:
        """Normalised errors squared by their degrees of freedom, as the keys of `SPACES`."""
        return {3: self.nees, 2: self.nees_2d, 1: self.nees_up}


def raised(truth: Truth, up_m: float) -> Truth:
    """Truth ``up_m`` higher along the ellipsoid's normal: from a marker to the antenna above it."""
    if up_m == 0.0:
        return truth
    llh = geodetic_from_ecef(truth.pos_e)
    up = rotations_ne_enu(llh[..., 0], llh[..., 1])[..., 2, :]
    return Truth(truth.pos_e + up_m * up, truth.t_ns, truth.source, truth.vel_e)


def match(solution: Solution, truth: Truth, *, tolerance_s: float = 0.05, interpolate: bool = False) -> Matched:
    """Errors of a solution at the epochs for which the truth is known.

    Parameters
    ----------
    solution : Solution
    truth : Truth
    tolerance_s : float
        Greatest distance in time between an epoch and the row of the truth it is compared with; of several the
        nearest is taken.
    interpolate : bool
        Interpolate the truth linearly to the epoch between rows at most 1.5 s apart, instead of taking the nearest.
    """
    if not 0.0 <= tolerance_s < 1e6:  # NaN is refused, too
        raise StarwiseError("tolerance is not a time", found=f"{tolerance_s}", wanted="seconds, 0 or more")
    solved = np.flatnonzero(solution.has_position & (solution.status != EPOCH_NO_SOLUTION))
    if truth.t_ns is None:
        true_e = np.broadcast_to(truth.pos_e, (len(solved), 3))
    else:
        solved, true_e = _aligned(solution.t_ns, solved, truth, tolerance_s, interpolate)
    difference = solution.pos_e[solved] - true_e
    if truth.t_ns is None:
        lat, lon, _ = geodetic_from_ecef(truth.pos_e)
        turn = C_ne_enu(lat, lon)
    else:
        llh = geodetic_from_ecef(true_e)
        turn = rotations_ne_enu(llh[:, 0], llh[:, 1])
    error_n = (turn @ difference[:, :, None])[:, :, 0]
    cov_n = turn @ solution.cov_pos[solved] @ np.swapaxes(turn, -1, -2)
    return Matched(
        solved,
        error_n,
        _nees(error_n, cov_n),
        _nees(error_n[:, :2], cov_n[:, :2, :2]),
        _nees(error_n[:, 2:], cov_n[:, 2:, 2:]),
    )


def _aligned(
    t_ns: NDArray[np.int64], solved: NDArray[np.int64], truth: Truth, tolerance_s: float, interpolate: bool
) -> tuple[NDArray[np.int64], F8]:
    assert truth.t_ns is not None
    times, wanted = truth.t_ns, t_ns[solved]
    if not len(times):
        return solved[:0], np.empty((0, 3))
    after = np.clip(np.searchsorted(times, wanted), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(times[after] - wanted) <= np.abs(wanted - times[before]), after, before)
    hit = np.abs(times[nearest] - wanted) <= round(tolerance_s * 1e9)
    true_e = truth.pos_e[nearest]
    if interpolate:
        gap = times[after] - times[before]
        between = (times[before] <= wanted) & (wanted <= times[after]) & (gap > 0) & (gap <= 1_500_000_000)
        share = np.where(between, (wanted - times[before]) / np.where(gap > 0, gap, 1), 0.0)[:, None]
        mixed = truth.pos_e[before] * (1.0 - share) + truth.pos_e[after] * share
        true_e = np.where(between[:, None], mixed, true_e)
        hit |= between
    return solved[hit], true_e[hit]


def _nees(difference: F8, cov: F8) -> F8:
    """Normalised error squared; NaN where the covariance is missing, inf where it is singular."""
    nees = np.full(len(difference), np.nan)
    usable = np.flatnonzero(np.isfinite(cov).all(axis=(1, 2)) & np.isfinite(difference).all(axis=1))
    spread = np.linalg.eigvalsh(cov[usable])
    nees[usable] = np.inf  # a covariance that claims certainty in some direction is wrong about it
    usable = usable[(spread[:, 0] > 1e-14 * spread[:, -1]) & (spread[:, 0] > 0.0)]  # else: singular to rounding
    solved = np.linalg.solve(cov[usable], difference[usable][:, :, None])[:, :, 0]
    nees[usable] = np.einsum("ij,ij->i", difference[usable], solved)
    return nees


def assess(
    solution: Solution,
    truth: Truth | None = None,
    *,
    tolerance_s: float = 0.05,
    interpolate: bool = False,
    vertical: bool = True,
) -> dict[str, Any]:
    """Statistics of a solution's errors against the truth; lengths in metres, in the local frame of the truth.

    The headline numbers are over **all** solved epochs, whatever their status; ``unflagged`` and ``flagged`` give the
    same over the epochs that the solution itself trusts and those that it calls suspect or coasted.

    Parameters
    ----------
    solution : Solution
    truth : Truth, optional
        Without it the errors are counted from the solution's own mean position: scatter, not accuracy.
    tolerance_s, interpolate
        See `match`.
    vertical : bool
        False: heights are not comparable (above the geoid); what needs them is None.

    Returns
    -------
    dict
        ``epochs``, ``epochs_solved``, ``epochs_compared``, ``mean_e_m``, ``mean_n_m``, ``mean_u_m``, ``rms_2d_m``,
        ``rms_3d_m``, ``p95_2d_m``, ``p95_3d_m``, ``coverage_50``, ``coverage_68``, ``coverage_95`` (fractions of
        epochs whose 50, 68, 95 % ellipsoid with 3 degrees of freedom holds the truth), ``nees_mean`` (3 expected),
        ``sigma_3d_mean_m``, ``calibration`` (the same fractions in space, horizontally and vertically beside the
        nominal ones), counts of each status; None where nothing can be said.

    Raises
    ------
    StarwiseError
        No epoch has both a position and a truth.
    """
    solved = solution.has_position & (solution.status != EPOCH_NO_SOLUTION)
    if not solved.any():
        raise StarwiseError("no epoch has a position")
    reference = "truth"
    if truth is None:
        # The median: one gross error must not move the reference.
        truth = Truth(np.median(solution.pos_e[solved], axis=0), source="the solution's own median position")
        reference = "own median"
    matched = match(solution, truth, tolerance_s=tolerance_s, interpolate=interpolate)
    if not len(matched.at):
        raise StarwiseError("no epoch of the solution lies in the time of the truth", found=truth.source)
    flagged = np.isin(solution.status[matched.at], (EPOCH_SUSPECT, EPOCH_COASTED))
    everything = np.ones(len(matched.at), dtype=bool)
    report: dict[str, Any] = {
        "epochs": solution.n_epochs,
        "epochs_solved": int(solved.sum()),
        "epochs_compared": len(matched.at),
        **_statistics(solution, matched, everything, vertical),
        "calibration": calibration(matched, vertical),
        "reference": reference,
        "truth": truth.source,
        "epochs_flagged": int(flagged.sum()),
        "epochs_by_status": {
            name: int(np.count_nonzero(solution.status == code)) for code, name in enumerate(EPOCH_STATUS_NAMES)
        },
        "epochs_reset": int(np.count_nonzero(solution.status == EPOCH_RESET)),
        "unflagged": _statistics(solution, matched, ~flagged, vertical),
        "flagged": _statistics(solution, matched, flagged, vertical),
    }
    return report


def coverage(nees: F8, dof: int) -> tuple[float, ...] | None:
    """Shares of epochs whose error lies inside the region that holds each of `NOMINAL`; None without covariances.

    Parameters
    ----------
    nees : (m,) float64
        Normalised errors squared; NaN (no covariance) does not count, inf (a singular one) is outside.
    dof : int
        Their degrees of freedom, 1 to 3.
    """
    stated = nees[~np.isnan(nees)]
    return tuple(float(np.mean(stated <= point)) for point in CHI2[dof]) if len(stated) else None


def calibration(matched: Matched, vertical: bool = True) -> dict[str, Any]:
    """The calibration curve: ``nominal`` shares, and those seen in space, horizontally, vertically; None if unknown."""
    curves: dict[str, Any] = {"nominal": [share / 100.0 for share in NOMINAL]}
    for dof, nees in matched.nees_by_dof.items():
        seen = coverage(nees, dof) if vertical or dof == 2 else None
        curves[SPACES[dof]] = None if seen is None else list(seen)
    return curves


def _statistics(solution: Solution, matched: Matched, which: Mask, vertical: bool) -> dict[str, Any]:
    error, nees = matched.error_n[which], matched.nees[which]
    at = matched.at[which]
    known, held = np.isfinite(nees), coverage(nees, 3)
    length_2d, length_3d = np.hypot(error[:, 0], error[:, 1]), np.linalg.norm(error, axis=1)
    trace = np.trace(solution.cov_pos[at], axis1=1, axis2=2)
    sigma_3d = np.sqrt(trace[np.isfinite(trace) & (trace >= 0.0)])
    nothing = not len(error)

    def value(number: Any, *, needs_height: bool = False, absent: bool = False) -> float | None:
        return None if nothing or absent or (needs_height and not vertical) else float(number())

    return {
        "mean_e_m": value(lambda: error[:, 0].mean()),
        "mean_n_m": value(lambda: error[:, 1].mean()),
        "mean_u_m": value(lambda: error[:, 2].mean(), needs_height=True),
        "rms_2d_m": value(lambda: np.sqrt(np.mean(length_2d**2))),
        "rms_3d_m": value(lambda: np.sqrt(np.mean(length_3d**2)), needs_height=True),
        "p95_2d_m": value(lambda: np.percentile(length_2d, 95.0)),
        "p95_3d_m": value(lambda: np.percentile(length_3d, 95.0), needs_height=True),
        **{
            f"coverage_{share}": value(lambda i=i: (held or ())[i], needs_height=True, absent=held is None)
            for i, share in enumerate(NOMINAL)
        },
        "nees_mean": value(lambda: nees[known].mean(), needs_height=True, absent=not known.any()),
        "sigma_3d_mean_m": value(lambda: sigma_3d.mean(), absent=not len(sigma_3d)),
    }
