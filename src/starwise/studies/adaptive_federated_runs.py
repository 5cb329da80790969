"""Runs of the adaptive federated study: every filter on every kind of receiver error, a row per filter and axis."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import NS
from starwise.estimators.adaptive_fixes import KALMAN, LITERAL, improved_filter, least_squares, literal_filter
from starwise.models.maneuver import Maneuvers
from starwise.studies.adaptive_federated_scene import (
    AXES,
    Fixes,
    Flight,
    constellation_fixes,
    flight,
    white_fixes,
)
from starwise.types import F8

if TYPE_CHECKING:
    import polars as pl

Row = Mapping[str, float | int | str | None]
SHARES: Final = np.array([1 / 3, 1 / 6, 1 / 2])
SCALES: Final = (0.5, 1.0, 1.5, 2.0, 3.0)
"""True standard deviations over those that the filter is told."""
TAUS_S: Final = (0.0, 1.0, 3.0, 10.0, 60.0)
"""Correlation times of the receivers' errors."""
STARTED_S: Final = 30
DIVERGED_M: Final = 60.0
"""No error of a filter that works gets there: five times the worst of least squares in thousands of epochs."""


@dataclass(frozen=True)
class Estimate:
    """Position of every epoch in the plane, and the variance that the filter claims per axis (NaN: none)."""

    pos: F8
    var: F8


def _ls(fixes: Fixes, _: F8) -> Estimate:
    return Estimate(*least_squares(fixes.z, fixes.r))


def _paper(constants: Any) -> Callable[[Fixes, F8], Estimate]:
    def run(fixes: Fixes, t_s: F8) -> Estimate:
        track = literal_filter(fixes.z, 1.0, constants)
        return Estimate(track.pos, np.einsum("nii->ni", track.cov_pos))

    return run


def _improved(bank: Maneuvers) -> Callable[[Fixes, F8], Estimate]:
    def run(fixes: Fixes, t_s: F8) -> Estimate:
        track = improved_filter(t_s, fixes.z, fixes.r, bank, SHARES)
        return Estimate(track.pos, np.einsum("nii->ni", track.cov_pos))

    return run


FILTERS: Final[dict[str, Callable[[Fixes, F8], Estimate]]] = {
    "least_squares": _ls,
    "kalman": _paper(KALMAN),
    "kalman_discretised": _paper(replace(KALMAN, discretised=True, fuse_eps=False, p0=(400.0, 9e4, 100.0, 100.0))),
    "literal": _paper(LITERAL),
    "improved": _improved(Maneuvers()),
}
"""Filters of table 1. ``kalman_discretised`` is the plain filter at its best: Q exact, P(0) as is, eps not fused."""
WHITE: Final = _improved(Maneuvers(most_inflation=1.0))

EXPERIMENTS: Final[dict[str, tuple[str, Any]]] = {
    "kalman": ("as in the paper", KALMAN),
    "kalman, P(0)": ("P(0) of 20 m, 300 m/s, 10 m/s^2, 10 m", replace(KALMAN, p0=(400.0, 9e4, 100.0, 100.0))),
    "kalman, Q": ("Q discretised", replace(KALMAN, discretised=True)),
    "kalman, eps": ("eps left to the local filters", replace(KALMAN, fuse_eps=False)),
    "kalman, Q, eps": ("both", replace(KALMAN, discretised=True, fuse_eps=False)),
    "kalman, Q shared": (
        "both, and Q shared like P",
        replace(KALMAN, discretised=True, fuse_eps=False, share_noise=True),
    ),
    "literal": ("as in the paper, a_max 30 m/s^2", LITERAL),
    "literal, P(0)": ("P(0) of 20 m, 300 m/s, 10 m/s^2, 10 m", replace(LITERAL, p0=(400.0, 9e4, 100.0, 100.0))),
    "literal, no beta": ("beta = 0", replace(LITERAL, beta="none")),
    "literal, beta of a": ("beta of the acceleration's change", replace(LITERAL, beta="acceleration")),
    "literal, Q": ("Q discretised, beta = 0", replace(LITERAL, discretised=True, beta="none")),
    "literal, eps": ("eps left to the local filters, beta = 0", replace(LITERAL, fuse_eps=False, beta="none")),
    "literal, R": (
        "errors where they belong: R of 10, 23, 5 m, no eps, beta = 0",
        replace(LITERAL, R=(10.0, 23.0, 5.0), sigma=(1e-3, 1e-3, 1e-3), beta="none"),
    ),
    "literal, R, a_max 1": (
        "the same with a_max 1 m/s^2",
        replace(LITERAL, R=(10.0, 23.0, 5.0), sigma=(1e-3, 1e-3, 1e-3), beta="none", a_max=1.0),
    ),
    "literal, a_max 0.03": ("a_max 0.03 m/s^2, beta = 0", replace(LITERAL, a_max=0.03, beta="none")),
    "literal, a_max 1": ("a_max 1 m/s^2, beta = 0", replace(LITERAL, a_max=1.0, beta="none")),
    "literal, a_max 100": ("a_max 100 m/s^2, beta = 0", replace(LITERAL, a_max=100.0, beta="none")),
}  # fmt: skip
"""One thing changed at a time: the weak points of the equations."""


def rows_of(case: str, run: int, name: str, estimate: Estimate, path: Flight) -> list[Row]:
    """Errors of one filter in one run, a row per axis."""
    error = estimate.pos - path.plane.s
    steady, maneuver = error[path.steady], error[path.maneuver]
    with np.errstate(invalid="ignore", divide="ignore"):
        nees = error**2 / estimate.var
    out: list[Row] = []
    for a, axis in enumerate(AXES):
        size = np.abs(steady[:, a])
        out.append(
            {
                "case": case,
                "run": run,
                "filter": name,
                "axis": axis,
                "mean_abs_m": float(size.mean()),
                "var_abs_m2": float(size.var()),
                "mean_m": float(steady[:, a].mean()),
                "square_m2": float((steady[:, a] ** 2).mean()),
                "maneuver_square_m2": float((maneuver[:, a] ** 2).mean()),
                "maneuver_max_m": float(np.abs(maneuver[:, a]).max()),
                "start_square_m2": float((error[:STARTED_S, a] ** 2).mean()),
                "nees_steady": float(nees[path.steady, a].mean()),
                "nees_maneuver": float(nees[path.maneuver, a].mean()),
                "largest_m": float(np.nanmax(np.abs(error[STARTED_S:, a]))),
            }
        )
    return out


@dataclass(frozen=True)
class FederatedTask:
    """All cases of one run; see `starwise.studies.montecarlo.Task`."""

    seed: int

    def description(self) -> dict[str, Any]:
        """Everything that the numbers depend on."""
        return {"study": "adaptive_federated", "seed": self.seed}

    def prepare(self) -> Callable[[int], Sequence[Row]]:
        """The function that gives the rows of a run."""
        path = flight()
        t_s = np.asarray((path.t_ns - path.t_ns[0]) / NS, dtype=np.float64)

        def rows(run: int) -> Sequence[Row]:
            out: list[Row] = []
            for case, fixes in (
                ("white", white_fixes(self.seed, run)),
                ("constellations", constellation_fixes(self.seed, run)),
            ):
                for name, solve in FILTERS.items():
                    out += rows_of(case, run, name, solve(fixes, t_s), path)
            known = {name: [row for row in out if row["filter"] == name and row["case"] == "white"] for name in FILTERS}
            for scale in SCALES:
                fixes = white_fixes(self.seed, run, scale=scale)
                for name in ("least_squares", "improved"):
                    if scale == 1.0:
                        out += [{**row, "case": f"scale {scale:g}"} for row in known[name]]
                    else:
                        out += rows_of(f"scale {scale:g}", run, name, FILTERS[name](fixes, t_s), path)
            for tau in TAUS_S:
                fixes = white_fixes(self.seed, run, tau_s=tau)
                for name in ("least_squares", "improved"):
                    if tau == 0.0:
                        out += [{**row, "case": f"tau {tau:g}"} for row in known[name]]
                    else:
                        out += rows_of(f"tau {tau:g}", run, name, FILTERS[name](fixes, t_s), path)
                out += rows_of(f"tau {tau:g}", run, "taken as white", WHITE(fixes, t_s), path)
            return out

        return rows


def summary(table: "pl.DataFrame", case: str) -> list[dict[str, Any]]:
    """Means over the runs of one case: a record per filter and axis, in the order in which they were run."""
    import polars as pl

    mine = table.filter(pl.col("case") == case)
    out = (
        mine.group_by("filter", "axis", maintain_order=True)
        .agg(
            pl.col("mean_abs_m").mean(),
            pl.col("var_abs_m2").mean(),
            pl.col("square_m2").mean().sqrt().alias("rms_m"),
            pl.col("mean_m").mean(),
            pl.col("maneuver_square_m2").mean().sqrt().alias("maneuver_rms_m"),
            pl.col("maneuver_max_m").median(),
            pl.col("maneuver_max_m").quantile(0.95, "linear").alias("maneuver_max_95_m"),
            pl.col("start_square_m2").mean().sqrt().alias("start_rms_m"),
            pl.col("nees_steady").mean(),
            pl.col("nees_maneuver").mean(),
            pl.col("largest_m").max(),
            pl.col("mean_abs_m").std().fill_null(0.0).alias("mean_abs_spread_m"),
        )
        .to_dicts()
    )
    return [{k: (None if isinstance(v, float) and not np.isfinite(v) else v) for k, v in row.items()} for row in out]


def worst_axis_max(table: "pl.DataFrame", case: str, name: str) -> NDArray[np.float64]:
    """Largest error in manoeuvres of every run, over longitude, latitude and height, m."""
    import polars as pl

    mine = table.filter((pl.col("case") == case) & (pl.col("filter") == name))
    return np.asarray(mine.group_by("run").agg(pl.col("maneuver_max_m").max())["maneuver_max_m"].to_numpy())


def experiments(seed: int, runs: int) -> list[dict[str, Any]]:
    """The paper's equations with one thing changed at a time, on white errors.

    Returns
    -------
    list of dict
        ``name``, ``change``, steady |error| over least squares per axis, manoeuvre RMS over least squares per axis,
        RMS of the first 30 s, median fading factor.
    """
    path = flight()
    out = []
    fixes = [white_fixes(seed, run) for run in range(runs)]
    base = [least_squares(f.z, f.r)[0] - path.plane.s for f in fixes]
    for name, (change, constants) in EXPERIMENTS.items():
        tracks = [literal_filter(f.z, 1.0, constants) for f in fixes]
        errors = [t.pos - path.plane.s for t in tracks]
        out.append(
            {
                "name": name,
                "change": change,
                **_against(errors, base, path),
                "start_rms_m": float(np.sqrt(np.mean([e[:STARTED_S, :2] ** 2 for e in errors]))),
                "fading_median": float(np.median([t.fading[1:] for t in tracks])),
            }
        )
    return out


def _against(errors: Sequence[F8], base: Sequence[F8], path: Flight) -> dict[str, float]:
    def steady(a: int, of: Sequence[F8]) -> float:
        return float(np.mean([np.abs(e[path.steady, a]) for e in of]))

    def rms(a: int, of: Sequence[F8]) -> float:
        return float(np.sqrt(np.mean([e[path.maneuver, a] ** 2 for e in of])))

    out = {}
    for a, axis in enumerate(AXES[:2]):
        out[f"steady_{axis}"] = steady(a, errors) / steady(a, base)
        out[f"maneuver_rms_{axis}"] = rms(a, errors) / rms(a, base)
    return out
