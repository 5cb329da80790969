"""Bounds by simulation: what the statistics of a run would be if nothing were wrong, with its very gaps and gates."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from starwise.analysis.lab.checks import overall, size_tests
from starwise.analysis.lab.checks_series import bias_tests, cross_tests, whiteness_tests
from starwise.analysis.lab.innovations import KINDS, Innovations
from starwise.analysis.lab.plain import plain
from starwise.analysis.lab.rows import group_row
from starwise.analysis.lab.series import series
from starwise.types import F8

BOUNDED = ("nis", "rho_1", "kurtosis", "mean_z")


@dataclass(frozen=True)
class Bounds:
    """Regions that hold 95 % of right filters with the rows of this run.

    Attributes
    ----------
    runs : int
    sensors : dict
        By sensor, for ``nis`` (per degree of freedom), ``rho_1``, ``kurtosis`` and ``mean_z``: ``low``, ``high``, and
        the value ``seen``.
    false_alarm : float
        Share of simulated runs whose size, bias, whiteness and cross-correlation fail together at 5 %: the check on the
        closed formulas.
    """

    runs: int
    sensors: dict[str, dict[str, dict[str, float]]]
    false_alarm: float

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {"runs": self.runs, "sensors": plain(self.sensors), "false_alarm": self.false_alarm}


def simulated_bounds(table: Innovations, runs: int = 100, seed: int = 0) -> Bounds:
    """Bounds of a run's statistics by simulated innovations in its place.

    Parameters
    ----------
    table : Innovations
    runs : int
    seed : int
    """
    rng = np.random.default_rng(seed)
    seen = _sensors(table)
    drawn: dict[str, dict[str, list[float]]] = {kind: {name: [] for name in BOUNDED} for kind in seen}
    failed = 0
    for _ in range(runs):
        one = replace(table, v=_accepted(table, rng) * np.sqrt(table.s))
        for kind, values in _sensors(one).items():
            for name in BOUNDED:
                drawn[kind][name].append(values[name])
        stats = series(one)
        tests = [test(one, stats) for test in (size_tests, bias_tests, whiteness_tests, cross_tests)]
        failed += overall(tests) < 0.05
    sensors = {
        kind: {
            name: {
                "low": float(np.quantile(values, 0.025)),
                "high": float(np.quantile(values, 0.975)),
                "seen": seen[kind][name],
            }
            for name, values in each.items()
        }
        for kind, each in drawn.items()
    }
    return Bounds(runs, sensors, failed / max(runs, 1))


def _sensors(table: Innovations) -> dict[str, dict[str, float]]:
    stats = series(table)
    out = {}
    for kind in KINDS:
        members = [i for i, c in enumerate(table.channels) if c.kind == kind]
        if members and stats.n[members].sum() > 0:
            out[kind] = group_row(kind, stats, members, table.interval_s)
    return out


def _accepted(table: Innovations, rng: np.random.Generator) -> F8:
    """Standard normal numbers inside the gate of each row."""
    z = rng.standard_normal(table.n)
    if table.gate_probability <= 0.0:
        return z
    from scipy.special import chdtri

    limits = np.array([np.inf, chdtri(1, table.gate_probability), chdtri(2, table.gate_probability)])[table.gate]
    pair = table.gate == 2
    while True:
        other = np.where(pair, rng.standard_normal(table.n), 0.0)
        out = np.flatnonzero(z * z + other * other > limits)
        if not len(out):
            return z
        inside = z * z + other * other <= limits
        fresh = rng.standard_normal(len(out))
        z[out] = fresh
        limits = np.where(inside, np.inf, limits)  # decided; the rest is drawn again
