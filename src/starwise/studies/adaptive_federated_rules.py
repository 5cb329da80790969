"""What each adaptation rule gains and costs: the same flight, filters that believe the wrong thing in turn."""

from dataclasses import replace
from typing import Any, Final

import numpy as np

from starwise.estimators.adaptive import RULES, Adaptation
from starwise.estimators.adaptive_fixes import least_squares
from starwise.kernels.adapt_run import Motion, adaptive_run
from starwise.kernels.maneuver import CURRENT, SINGER
from starwise.sim.seeds import streams
from starwise.studies.adaptive_federated_scene import Fixes, Flight, flight, white_fixes
from starwise.types import F8

SINGER_3: Final = Motion(SINGER, 3.0**2, 20.0, 0.0, 300.0, 3.0)
STIFF: Final = Motion(SINGER, 0.1**2, 20.0, 0.0, 300.0, 0.1)
CURRENT_30: Final = Motion(CURRENT, 0.0, 10.0, 30.0, 300.0, 3.0)
CASES: Final[dict[str, tuple[str, Motion]]] = {
    "as modelled": ("Singer 3 m/s^2, noise as told", SINGER_3),
    "current": ('"current" model, a_max 30 m/s^2, noise as told', CURRENT_30),
    "stiff": ("Singer 0.1 m/s^2: manoeuvres are not in the model", STIFF),
    "noise x 3": ("true noise three times what the filter is told", SINGER_3),
    "noise / 3": ("true noise a third of it", SINGER_3),
    "outliers": ("every 20th fix of a receiver off by 10 sigmas", SINGER_3),
}
BETWEEN: Final = (
    "fading", "fading_improved", "strong_tracking", "iae_r", "iae_q", "sage_husa_r", "sage_husa_q", "huber", "igg3",
)  # fmt: skip


def _fixes(case: str, seed: int, run: int) -> Fixes:
    scale = {"noise x 3": 3.0, "noise / 3": 1.0 / 3.0}.get(case, 1.0)
    fixes = white_fixes(seed, run, scale=scale)
    if case != "outliers":
        return fixes
    rng = streams(seed, run)("outliers")
    hit = rng.random(fixes.z.shape[:2]) < 0.05
    hit[0] = False
    far = 10.0 * np.sqrt(fixes.r) * rng.choice([-1.0, 1.0], fixes.z.shape)
    return replace(fixes, z=fixes.z + np.where(hit[:, :, None], far, 0.0))


def run_rule(rule: Adaptation, motion: Motion, fixes: Fixes) -> tuple[F8, F8]:
    """Positions (n, 3) and their variances by an adaptive filter over fixes of several receivers."""
    n = len(fixes.z)
    x, P, found = np.zeros((n, 3, 3)), np.zeros((n, 3, 3, 3)), np.zeros((n, 3))
    adaptive_run(motion, rule.numbers(), 1.0, np.ascontiguousarray(fixes.z), fixes.r, x, P, found)
    return x[:, :, 0], P[:, :, 0, 0]


def compare_rules(seed: int, runs: int) -> list[dict[str, Any]]:
    """Every rule in every case: RMS over the plain filter's, steady and in manoeuvres, and NEES per axis.

    Returns
    -------
    list of dict
        ``case``, ``what``, ``rule``, ``steady``, ``maneuver`` (RMS over least squares of the case), ``nees_steady``,
        ``nees_maneuver``.
    """
    path = flight()
    out = []
    for case, (what, motion) in CASES.items():
        fixes = [_fixes(case, seed, run) for run in range(runs)]
        base = _sizes([least_squares(f.z, f.r) for f in fixes], path)
        for name in ("none", *BETWEEN):
            mine = _sizes([run_rule(RULES[name], motion, f) for f in fixes], path)
            out.append(
                {
                    "case": case,
                    "what": what,
                    "rule": name,
                    "steady": mine[0] / base[0],
                    "maneuver": mine[1] / base[1],
                    "nees_steady": mine[2],
                    "nees_maneuver": mine[3],
                }
            )
    return out


def _sizes(estimates: list[tuple[F8, F8]], path: Flight) -> tuple[float, float, float, float]:
    """RMS and NEES per axis, steady and in manoeuvres."""
    parts = []
    for when in (path.steady, path.maneuver):
        errors = [(pos - path.plane.s)[when] for pos, _ in estimates]
        parts.append(float(np.sqrt(np.mean([e**2 for e in errors]))))
        parts.append(float(np.mean([e**2 / var[when] for e, (_, var) in zip(errors, estimates, strict=True)])))
    return parts[0], parts[2], parts[1], parts[3]
