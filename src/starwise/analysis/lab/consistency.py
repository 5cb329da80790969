"""`Consistency`: is a filter consistent with what it measures, why not, and what to do about it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from starwise.analysis.lab import words
from starwise.analysis.lab.case import ALPHA, Case
from starwise.analysis.lab.causes import SAFE, find, ranked
from starwise.analysis.lab.causes_size import epoch_findings
from starwise.analysis.lab.checks import Family, epoch_tests, overall, size_tests, splits
from starwise.analysis.lab.checks_series import (
    bias_tests,
    cross_tests,
    delay_tests,
    state_tests,
    tail_tests,
    whiteness_tests,
)
from starwise.analysis.lab.errors import PositionErrors, of_positions, status_findings
from starwise.analysis.lab.findings import Finding
from starwise.analysis.lab.innovations import Innovations, of_solution, table
from starwise.analysis.lab.moments import NOMINAL
from starwise.analysis.lab.plain import plain
from starwise.analysis.lab.rows import autocorrelations, channel_rows, group_row
from starwise.analysis.lab.series import Series, series
from starwise.analysis.lab.simulated import Bounds, simulated_bounds
from starwise.analysis.lab.tuning import Progress, Rerun, Tuning, by_moments, maximise
from starwise.analysis.lab.windows import Windows, windows
from starwise.config import RunConfig
from starwise.errors import StarwiseError
from starwise.types import Solution, Truth

Grade = Literal["consistent", "nearly", "cautious", "inconsistent", "unknown"]


@dataclass(frozen=True)
class Consistency:
    """What can be said about a filter's covariances.

    Under H0 (filter and system agree) innovations over their claimed sigmas are independent and standard normal, and
    errors are what the covariance says. `families` are the tests of it; `findings` are causes, largest evidence first.
    The run passes at 5 %: a filter with the right model fails in one run of twenty.

    Attributes
    ----------
    table : Innovations or None
        None where the solution has no innovations.
    stats : Series or None
        Per channel.
    families : tuple of Family
    p_value : float
        Chance of innovations as odd as these if nothing is wrong; NaN: nothing could be tested.
    findings : tuple of Finding
    positions : PositionErrors or None
        Errors against the truth (or scatter without one), where there are positions.
    not_judged : tuple of str
        What could not be judged, and why.
    """

    table: Innovations | None
    stats: Series | None
    families: tuple[Family, ...]
    p_value: float
    findings: tuple[Finding, ...]
    positions: PositionErrors | None = None
    not_judged: tuple[str, ...] = ()
    config: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(
        cls, solution: Solution, truth: Truth | None = None, *, tolerance_s: float = 0.05, interpolate: bool = False,
        vertical: bool = True,
    ) -> "Consistency":  # fmt: skip
        """Consistency of a run.

        Parameters
        ----------
        solution : Solution
            With its ledger, if it has one; without (fused tracks, position files) only what its positions say.
        truth : Truth, optional
        tolerance_s, interpolate
            Matching in time; see `starwise.analysis.accuracy.match`.
        vertical : bool
            False: heights are not comparable.
        """
        innovations = of_solution(solution)
        positions, missing = of_positions(solution, truth, tolerance_s, interpolate, vertical)
        if innovations is None:
            missing.insert(0, "innovations: this solution has no ledger of them (size, whiteness, bias, causes)")
        return _judged(innovations, positions, missing, status_findings(solution), _config(solution))

    @classmethod
    def from_innovations(
        cls,
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
        solution: Solution | None = None,
        truth: Truth | None = None,
        vertical: bool = True,
    ) -> "Consistency":
        """Consistency of innovations (or residuals) of any program.

        Parameters
        ----------
        t_ns : (n,) array_like of int
            Times of the rows, GPST ns, in any order.
        v, s : (n,) array_like
            Innovations and their variances as the program claims them (m^2 or m^2/s^2). Rows with NaN are left out.
        sv, signal, kind : (n,) sequence of str, or str
            Satellite (``G05``), signal (``1C``) or axis (``east``), sensor: ``code``, ``rate``, ``phase``,
            ``position``, ``velocity``, ``other``. One text for all rows is enough.
        used : (n,) array_like of bool, optional
            Rows that the program used; default all.
        noise_var : (n,) array_like, optional
            Variance of the measurement's own noise, the part R of s: tells errors of R from errors of Q.
        direction : (n, 3) array_like, optional
            Derivative of the measurement with respect to the ECEF position; with ``velocity``: finds late fixes.
        gate, gate_probability
            See `Innovations`.
        velocity_t_ns, velocity : (k,), (k, 3) array_like, optional
            Velocity of the antenna, ECEF m/s.
        residuals : bool
            ``v`` are residuals of a fit per epoch, ``s`` their variances (or those of the measurements, if the program
            gives no better); then sizes are judged with care and channels of an epoch are not compared.
        solution, truth, vertical
            Positions of the same run, and the truth.

        Raises
        ------
        StarwiseError
            Columns that do not fit each other.
        """
        made = table(
            t_ns, v, s, sv=sv, signal=signal, kind=kind, used=used, noise_var=noise_var, direction=direction, gate=gate,
            gate_probability=gate_probability, velocity_t_ns=velocity_t_ns, velocity=velocity, residuals=residuals,
        )  # fmt: skip
        positions: PositionErrors | None = None
        missing: list[str] = []
        status: list[Finding] = []
        if solution is not None:
            positions, missing = of_positions(solution, truth, 0.05, False, vertical)
            status = status_findings(solution)
        return _judged(made, positions, missing, status, {})

    @property
    def passed(self) -> bool | None:
        """Whether nothing is wrong at 5 %; None: nothing could be tested."""
        return None if math.isnan(self.p_value) else self.p_value >= ALPHA

    @property
    def grade(self) -> Grade:
        """How consistent.

        ``consistent``; ``nearly``: provably not, but by amounts that hardly matter; ``cautious``: it claims less than
        it knows, nothing else matters; ``inconsistent``; ``unknown``: nothing to judge by.
        """
        matter = [f for f in self.findings if f.matters]
        if matter:
            return "cautious" if all(f.cause in SAFE for f in matter) else "inconsistent"
        if self.passed is None:
            return "unknown"
        return "consistent" if self.passed else "nearly"

    @property
    def verdict(self) -> str:
        """One line: whether the filter is consistent, and the main cause if not."""
        return words.verdict(self)

    def explain(self) -> str:
        """Several lines of at most 79 columns: what was found, where, and what to do about it."""
        return words.explain(self)

    def bounds(self, runs: int = 100, seed: int = 0) -> Bounds | None:
        """Monte Carlo bounds of the statistics by sensor, with the very rows of this run; None without innovations."""
        return None if self.table is None or not self.table.n else simulated_bounds(self.table, runs, seed)

    @cached_property
    def tuning(self) -> Tuning | None:
        """Better numbers for ``solve --config`` by the size of innovations alone; None: nothing to say."""
        return by_moments(self.findings, self.run_config)

    def tuned(self, rerun: Rerun, *, rounds: int = 2, progress: Progress | None = None) -> Tuning:
        """Better numbers by the likelihood of innovations, the filter run again; see `starwise.analysis.lab.tuning`.

        Parameters
        ----------
        rerun : callable
            Gives the solution of the same measurements for a configuration.
        rounds, progress
            See `starwise.analysis.lab.tuning.maximise`.

        Raises
        ------
        StarwiseError
            The run says not how it was made, or has no innovations.
        """
        config = self.run_config
        if config is None:
            raise StarwiseError(
                "nothing to tune: the solution does not say how it was made", wanted="a result of solve"
            )
        return maximise(rerun, config, rounds=rounds, progress=progress)

    @cached_property
    def run_config(self) -> RunConfig | None:
        """Configuration of the run, its dynamics as settled; None where the solution does not tell."""
        if not self.config:
            return None
        try:
            return RunConfig.from_dict(self.config)
        except StarwiseError:  # of another version, or of another command
            return None

    @cached_property
    def nis_epoch(self) -> Windows | None:
        """NIS of every epoch over its degrees of freedom, with bounds."""
        return None if self.table is None else windows(self.table, 1)

    @cached_property
    def nis_window(self) -> Windows | None:
        """The same over windows of a fiftieth of the run."""
        return None if self.table is None else windows(self.table, max(1, len(self.table.t_ns) // 50))

    @cached_property
    def autocorrelation(self) -> dict[str, dict[str, Any]]:
        """Autocorrelations by sensor and channel: ``lag_s``, ``rho``, ``bound`` (95 % of a lag), ``kind``, ``sv``."""
        return {} if self.table is None or self.stats is None else autocorrelations(self.table, self.stats)

    @cached_property
    def calibration(self) -> dict[str, Any]:
        """Shares inside regions made to hold ``nominal``: of innovations by sensor, of positions against the truth."""
        curves: dict[str, Any] = {"nominal": list(NOMINAL)}
        if self.table is not None and self.stats is not None:
            for kind in dict.fromkeys(c.kind for c in self.table.channels):
                members = [i for i, c in enumerate(self.table.channels) if c.kind == kind]
                n = self.stats.n[members].astype(np.float64)
                inside = np.nan_to_num(self.stats.inside[members])
                curves[kind] = (inside * n[:, None]).sum(axis=0) / n.sum() if n.sum() else None
        if self.positions is not None and self.positions.inside is not None:
            curves["truth"] = self.positions.inside
        return curves

    @cached_property
    def channels(self) -> list[dict[str, Any]]:
        """A row per channel: size, bias, correlation, shares inside."""
        return [] if self.table is None or self.stats is None else channel_rows(self.table, self.stats)

    @cached_property
    def by_satellite(self) -> list[dict[str, Any]]:
        """A row per satellite."""
        return self._grouped(lambda c: c.sv)

    @cached_property
    def by_signal(self) -> list[dict[str, Any]]:
        """A row per system, signal and sensor."""
        return self._grouped(lambda c: f"{c.system} {c.signal} {c.kind}".strip())

    @cached_property
    def by_system(self) -> list[dict[str, Any]]:
        """A row per system and sensor."""
        return self._grouped(lambda c: f"{c.system} {c.kind}".strip())

    @cached_property
    def by_sensor(self) -> list[dict[str, Any]]:
        """A row per sensor."""
        return self._grouped(lambda c: c.kind)

    def _grouped(self, name: Any) -> list[dict[str, Any]]:
        if self.table is None or self.stats is None:
            return []
        members: dict[str, list[int]] = {}
        for i, c in enumerate(self.table.channels):
            members.setdefault(name(c), []).append(i)
        return [group_row(key, self.stats, some, self.table.interval_s) for key, some in members.items() if key]

    def to_dict(self) -> dict[str, Any]:
        """Everything but single epochs as plain numbers, ready for JSON; None for what cannot be said."""
        made = {
            "verdict": self.verdict,
            "grade": self.grade,
            "passed": self.passed,
            "p_value": self.p_value,
            "false_alarm": ALPHA,
            "explanation": self.explain(),
            "findings": [f.to_dict() for f in self.findings],
            "not_judged": list(self.not_judged),
            "tuning": None if self.tuning is None else self.tuning.to_dict(),
            "families": [
                {
                    "name": f.name,
                    "tests": len(f.tests),
                    "p_value": f.p,
                    "worst": f.best.what,
                    "statistic": f.best.statistic,
                }
                for f in self.families
                if f.tests
            ],
            "sensors": self.by_sensor,
            "systems": self.by_system,
            "signals": self.by_signal,
            "satellites": self.by_satellite,
            "channels": self.channels,
            "calibration": self.calibration,
            "windows": None if self.nis_window is None else self.nis_window.to_dict(),
            "positions": None if self.positions is None else self.positions.to_dict(),
        }
        return {key: plain(value) for key, value in made.items()}


def _config(solution: Solution) -> dict[str, Any]:
    """Configuration that the run was made with, dynamics as they were settled."""
    config = dict(solution.provenance.get("config", {}))
    used = solution.provenance.get("dynamics", {})
    if config.get("dynamics") == "auto" and isinstance(used, dict) and used.get("used"):
        config["dynamics"] = used["used"]
    return config


def _judged(
    innovations: Innovations | None, positions: PositionErrors | None, missing: list[str], status: list[Finding],
    config: dict[str, Any],
) -> Consistency:  # fmt: skip
    families: list[Family] = []
    stats: Series | None = None
    found: list[Finding] = list(status)
    if innovations is not None and innovations.n and innovations.used.any():
        stats = series(innovations)
        parts = splits(innovations)
        families = [
            size_tests(innovations, stats), state_tests(innovations, parts), bias_tests(innovations, stats),
            whiteness_tests(innovations, stats), tail_tests(innovations, stats), cross_tests(innovations, stats),
            delay_tests(innovations),
        ]  # fmt: skip
    elif innovations is not None and len(innovations.nis):
        families = [epoch_tests(innovations)]
        found += epoch_findings(families[0])
        missing.insert(0, "single innovations: the solution has the NIS of whole epochs only (whiteness, bias, causes)")
    elif innovations is not None:
        innovations = None
        missing.insert(0, "innovations: the ledger has none")
    if positions is not None and positions.family is not None:
        families.append(positions.family)
    if innovations is not None and stats is not None:
        case = Case(
            innovations, stats, {f.name: f for f in families}, {p.kind: p for p in parts},
            config.get("error_model") == "colored",
        )  # fmt: skip
        found += find(case)
    if positions is not None:
        found += positions.findings(families)
    return Consistency(
        innovations, stats, tuple(families), overall(families), tuple(ranked(found)), positions, tuple(missing), config
    )
