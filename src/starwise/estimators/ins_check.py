"""What innovations of an inertial run say about its inputs: time tags of velocities, delays that nobody declared."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from starwise.config_inertial import InertialConfig
from starwise.errors import StarwiseError
from starwise.estimators.ins_align import NEAR_S, FixTable
from starwise.physics.earth import curvature_radii
from starwise.types import F8

LAG_S = 0.05
"""Velocities that lag their positions by more than this beyond what is declared are told of, s."""
NIS_ALARM = 2.5
"""Mean NIS per degree of freedom from which on fixes and readings are said to contradict each other."""
NIS_CAP = 30.0
"""NIS per degree of freedom at most, in that mean: a few wild fixes are no contradiction of the rest."""


def velocity_lag(table: FixTable) -> tuple[float, float]:
    """Time by which velocities lag the positions of the same fixes, and its 1 sigma, s; NaN if nothing tells.

    With p' from central differences, p' - v = lag a for a velocity that is so late; fitted by least squares over all
    steps in which a is not zero. The sigma allows for errors that last for some fixes.
    """
    shared = np.intersect1d(np.rint(table.t * 1e6), np.rint(table.tv * 1e6))
    if len(shared) < 20:
        return np.nan, np.nan
    at = np.searchsorted(np.rint(table.t * 1e6), shared)
    av = np.searchsorted(np.rint(table.tv * 1e6), shared)
    t, v = table.t[at], table.vel[av]
    llh = table.llh[at] - table.llh[at[0]]
    R_M, R_N = curvature_radii(table.llh[at, 0])
    h = table.llh[at, 2]
    scale = np.stack([R_M + h, (R_N + h) * np.cos(table.llh[at, 0])], axis=1)
    step = (t[2:] - t[:-2])[:, None]
    near = step[:, 0] <= NEAR_S
    d = ((llh[2:, :2] - llh[:-2, :2]) * scale[1:-1] / step - v[1:-1, :2])[near]
    a = ((v[2:, :2] - v[:-2, :2]) / step)[near]
    power = float((a * a).sum())
    if power < 1.0:
        return np.nan, np.nan
    lag = float((d * a).sum() / power)
    left = d - lag * a
    return lag, 3.0 * float(np.sqrt((left**2).mean() / power))


def lag_note(table: FixTable, config: InertialConfig) -> list[str]:
    """A note if velocities lag their positions and the configuration does not say so.

    ``table`` holds velocities at their tags, not yet shifted.
    """
    lag, sigma = velocity_lag(table)
    beyond = lag - config.velocity_lag_s
    if not config.use_velocity or not abs(beyond) > max(LAG_S, 5.0 * sigma):
        return []
    return [
        f"velocities of the fixes lag their positions by {lag:.2f} s and {config.velocity_lag_s:g} s are declared: "
        "inertial.velocity_lag_s"
    ]


def start_note(t: F8, start_s: float) -> list[str]:
    """A note on fixes (times in s since the first reading) before the alignment, which get no epoch."""
    before = int((t < start_s - 1e-6).sum())
    if not before:
        return []
    return [f"aligned {start_s:.1f} s after the first reading: {before} fixes before that are without an epoch"]


def mean_nis(nis: F8) -> float:
    """Mean NIS per degree of freedom (3 each), single values capped at `NIS_CAP`; NaN without any."""
    told = nis[np.isfinite(nis)] / 3.0
    return float(np.minimum(told, NIS_CAP).mean()) if len(told) else np.nan


def shifted(table: FixTable, shift_s: float, end_s: float) -> FixTable:
    """Fixes taken as valid ``shift_s`` later; those that leave the readings are left out."""
    t, tv = table.t + shift_s, table.tv + shift_s
    p, q = (t >= 0.0) & (t <= end_s), (tv >= 0.0) & (tv <= end_s)
    return replace(
        table, t=t[p], llh=table.llh[p], cov=table.cov[p], tv=tv[q], vel=table.vel[q], vel_cov=table.vel_cov[q]
    )


def what_if(nis_of: Callable[[float], float], limit_s: float = 1.5) -> tuple[float, float]:
    """Shift of all fixes (s, positive: later) at which they agree best with the readings, and the mean NIS there.

    Parameters
    ----------
    nis_of : callable
        Mean NIS per degree of freedom of a run with the fixes shifted by so many seconds.
    limit_s : float
        Shifts from minus to plus this are tried: a grid of 0.25 s, then halved around the best to 0.03 s.
    """
    known: dict[float, float] = {}

    def value(shift: float) -> float:
        key = round(shift, 6)
        if key not in known:
            try:
                known[key] = float(nis_of(key))
            except StarwiseError:
                known[key] = np.inf
        return known[key]

    step = 0.25
    best = min(np.arange(-limit_s, limit_s + 1e-9, step).tolist(), key=value)
    while step > 0.04:
        step *= 0.5
        best = min((best - step, best, best + step), key=value)
    return best, value(best)
