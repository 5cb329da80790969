"""What positions say by themselves: errors against the truth, or scatter; and epochs that the filter distrusts."""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.analysis.accuracy import match
from starwise.analysis.lab.case import ALPHA, num
from starwise.analysis.lab.checks import Check, Family, family
from starwise.analysis.lab.findings import Cause, Finding
from starwise.analysis.lab.moments import NOMINAL, gamma_p, sidak
from starwise.analysis.lab.series import correlation_time, effective_share, lags_for
from starwise.constants import EPOCH_COASTED, EPOCH_NO_SOLUTION, EPOCH_RESET, EPOCH_SUSPECT
from starwise.types import F8, I8, Solution, Truth

MIN_EPOCHS: Final = 20


@dataclass(frozen=True)
class PositionErrors:
    """Errors of positions and whether their covariance tells them.

    Attributes
    ----------
    reference : str
        ``truth``, or ``own median``: scatter of a receiver at rest.
    dof : int
        3, or 2 where heights are not comparable.
    epochs : int
        Compared.
    nees : float
        Mean of error' P^-1 error over its degrees of freedom: 1 expected; NaN without covariances.
    nees_low, nees_high : float
        Region that holds 95 % of such means of an honest solution, with the epochs that count as independent.
    independent : float
        Number of epochs that count as independent: errors last.
    correlation_s : float
        Time for which errors last.
    rho_1 : float
        Correlation of the normalised errors of successive epochs.
    inside : (4,) float64 or None
        Share of epochs with the truth inside the regions made to hold 50, 68, 95, 99 %.
    lag_s, rho : (L,) float64
        Autocorrelation of the errors.
    nees_t_ns, nees_epoch : (m,)
        Of every epoch compared.
    family : Family or None
    """

    reference: str
    dof: int
    epochs: int
    nees: float
    nees_low: float
    nees_high: float
    independent: float
    correlation_s: float
    rho_1: float
    inside: F8 | None
    lag_s: F8
    rho: F8
    nees_t_ns: I8
    nees_epoch: F8
    family: Family | None

    def findings(self, families: list[Family]) -> list[Finding]:
        """Covariances that are provably too small or too large against the truth."""
        if self.family is None or not self.family.tests:
            return []
        p = float(sidak(self.family.p, max(1, sum(1 for f in families if f.tests))))
        if p >= ALPHA:
            return []
        small = self.nees > 1.0
        size = math.sqrt(self.nees)
        words = (
            f"Position errors are {num(size)} times as large as claimed (NEES {num(self.nees)} per degree of freedom)."
        )
        cure = (
            "Covariances are too small: see the causes, or inflate."
            if small
            else "Safe, but blunt: sigmas could be smaller."
        )
        evidence = 0.5 * self.independent * self.dof * (self.nees - 1.0 - math.log(max(self.nees, 1e-300)))
        cause = Cause.OVERCONFIDENT if small else Cause.MODEST
        return [
            Finding(
                cause,
                "position",
                self.nees,
                "NEES per degree of freedom",
                p,
                evidence,
                not 0.5 < self.nees < 1.5,
                words,
                cure,
            )
        ]

    def to_dict(self) -> dict[str, Any]:
        """Plain values but for single epochs."""
        from starwise.analysis.lab.plain import plain

        names = (
            "reference", "dof", "epochs", "nees", "nees_low", "nees_high", "independent", "correlation_s", "rho_1",
            "inside", "lag_s", "rho",
        )  # fmt: skip
        return {name: plain(getattr(self, name)) for name in names}


def of_positions(
    solution: Solution, truth: Truth | None, tolerance_s: float, interpolate: bool, vertical: bool
) -> tuple[PositionErrors | None, list[str]]:
    """Errors of a solution's positions, and what could not be judged."""
    solved = solution.has_position & (solution.status != EPOCH_NO_SOLUTION)
    missing: list[str] = []
    if int(solved.sum()) < 2:
        return None, ["positions: fewer than two epochs have one"]
    reference = "truth"
    if truth is None:
        missing.append("errors of the positions (NEES, calibration): they need the truth")
        if _moves(solution, solved):
            return None, missing
        truth, reference = Truth(np.median(solution.pos_e[solved], axis=0)), "own median"
    matched = match(solution, truth, tolerance_s=tolerance_s, interpolate=interpolate)
    if len(matched.at) < 2:
        return None, [*missing, "positions: no epoch lies in the time of the truth"]
    dof = 3 if vertical else 2
    nees = (matched.nees if vertical else matched.nees_2d) / dof
    error = matched.error_n[:, :dof]
    t_ns = solution.t_ns[matched.at]
    lags = lags_for(len(t_ns), longer=True)
    rho, pairs = _error_correlation(error if reference == "truth" else error - error.mean(axis=0), lags)
    interval = float(np.median(np.diff(t_ns))) * 1e-9
    # The variance of a mean of squares grows with the squares of the correlations (Bartlett 1946).
    count = len(t_ns) * effective_share(rho * np.abs(rho), lags)
    known = np.isfinite(nees)
    if not known.any():
        missing.append("sigmas: the solution has no covariance of its positions")
    value = float(nees[known].mean()) if known.any() and reference == "truth" else math.nan
    made, low, high = None, math.nan, math.nan
    if math.isfinite(value):
        from scipy.special import gammaincinv

        shape = 0.5 * max(count, 1.0) * dof
        low, high = float(gammaincinv(shape, 0.025)) / shape, float(gammaincinv(shape, 0.975)) / shape
        p, _ = gamma_p(np.array(value), np.array(1.0), np.array(1.0 / shape))
        made = family("nees", [Check("nees", "position", value, float(p))])
    inside = _inside(nees[known], dof) if math.isfinite(value) else None
    return PositionErrors(
        reference, dof, len(t_ns), value, low, high, count, correlation_time(rho, pairs, lags, interval),
        float(rho[0]), inside, np.asarray(lags * interval, dtype=np.float64), rho, t_ns, nees, made,
    ), missing  # fmt: skip


def _moves(solution: Solution, solved: np.ndarray) -> bool:
    """Whether the antenna moved: more than 20 m between quartiles, or a speed."""
    spread = np.subtract(*np.percentile(solution.pos_e[solved], [75, 25], axis=0))
    return bool(np.linalg.norm(spread) > 20.0)


def _error_correlation(error: F8, lags: I8) -> tuple[F8, F8]:
    """Autocorrelation of errors about zero, all axes together, (L,)."""
    good: NDArray[np.bool_] = np.asarray(np.isfinite(error).all(axis=1))
    e = np.where(good[:, None], error, 0.0)
    rho, pairs = np.full(len(lags), np.nan), np.zeros(len(lags))
    for i, lag in enumerate(lags.tolist()):
        both = good[:-lag] & good[lag:]
        size = math.sqrt(float((e[:-lag][both] ** 2).sum()) * float((e[lag:][both] ** 2).sum()))
        pairs[i] = float(both.sum())
        rho[i] = float((e[:-lag][both] * e[lag:][both]).sum()) / size if size > 0.0 else np.nan
    return rho, pairs


def _inside(nees: F8, dof: int) -> F8:
    from scipy.special import chdtri

    return np.array([float(np.mean(nees * dof <= chdtri(dof, 1.0 - share))) for share in NOMINAL])


def status_findings(solution: Solution) -> list[Finding]:
    """Epochs at which the filter itself says that it was lost."""
    resets = int(np.count_nonzero(solution.status == EPOCH_RESET))
    suspect = int(np.count_nonzero(solution.status == EPOCH_SUSPECT))
    coasted = int(np.count_nonzero(solution.status == EPOCH_COASTED))
    n = max(solution.n_epochs, 1)
    if resets == 0 and suspect < 0.05 * n:
        return []
    often = "once" if resets == 1 else f"{resets} times"
    words = f"The filter was lost: restarted {often}, {suspect} epochs suspect, {coasted} coasted, of {n}."
    return [
        Finding(
            Cause.LOST, "run", float(resets), "restarts", math.nan, 10.0 * (resets + suspect), resets > 0 or suspect >
            0.2 * n, words, "Look at the times of the restarts: outages, wrong dynamics, interference.",
        )
    ]  # fmt: skip
