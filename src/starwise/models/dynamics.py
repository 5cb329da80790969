"""Whether a receiver stands or moves: told by single epochs of least squares, before any filter believes in either.

The two mistakes do not cost the same. A filter that believes in rest where there is motion is lost; one that believes
in motion where there is rest is only noisier. So rest must be *shown*, by every part of the run, and in doubt the
receiver moves.

Epochs are taken in blocks of five; a block has the medians of its positions and velocities, which one or two bad epochs
do not move. The receiver rests if **every** block says so:

* its position is that of all others, within what the claimed covariance, and the noise seen from epoch to epoch where
  that is more than claimed, allow (99 % of chi-square, 3 degrees);
* its velocity by Doppler is below `SLOW_MPS`, or below five times the noise seen inside the blocks where that is more,
  but never above `SURELY_MOVING_MPS`; so is the slope of its positions, where that can tell;
* the mean velocity of each tenth of the run is no crawl, and blocks differ from each other no more than their noise
  lets them (a boat at its anchor);
* without Doppler, positions are so quiet that what could hide between two of them is harmless.

All limits are speeds, or multiples of noise that is measured on differences of neighbours: none is of a data set.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.frames import C_ne_enu, geodetic_from_ecef

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Mask = NDArray[np.bool_]

BLOCK: Final = 5
"""Epochs of a block: its median withstands two bad ones."""
MIN_BLOCKS: Final = 4
"""Fewer say nothing."""
TRUSTED_SHARE: Final = 0.9
"""Share of epochs that must have a position that least squares trusts, and of blocks with a velocity."""
SLOW_MPS: Final = 0.1
"""Horizontal speed of a block, by Doppler, below which it may rest, m/s: the slowest walk is 0.3, geodetic receivers at
rest show 0.02 to 0.05."""
SLOPE_MPS: Final = 0.05
"""The same by the slope of positions over `SLOPE_SPAN_S` or more."""
SLOPE_SPAN_S: Final = 60.0
QUIET_M: Final = 1.0
"""Noise of positions, per horizontal axis, up to which they show rest without Doppler, m."""
SURELY_MOVING_MPS: Final = 0.3
"""With noise that would allow more than this, nothing is shown, m/s."""
CRAWL_MPS: Final = 0.02
"""Mean speed of a tenth of the run: Doppler at rest has means below 0.005 m/s."""
SWAY_MPS: Final = 0.03
"""Spread of the blocks' velocities, per axis, beyond three times their noise."""
SPREAD: Final = 11.345
"""99 % of chi-square with 3 degrees of freedom (scipy.stats.chi2.ppf(0.99, 3))."""
_OF_MANY: Final = 25.9 / SPREAD
"""Noise is new in every block, and the largest of a thousand must pass: 1e-5 of chi-square in place of 1e-2."""
_MEDIAN_OF_5: Final = 1.25 / np.sqrt(5.0)
"""Standard deviation of the median of five, of one."""
_MAD: Final = 1.4826
"""Standard deviation of a normal variable over the median of its absolute value."""


@dataclass(frozen=True)
class Detected:
    """What was found.

    Attributes
    ----------
    moving : bool
        Or not shown to rest.
    reason : str
        In a few words.
    speed_mps : float
        Largest horizontal speed of a block, m/s; NaN if none is known.
    spread : float
        Largest squared distance of a block from the median position in units of the claimed covariance, per degree
        of freedom; NaN if none is known.
    """

    moving: bool
    reason: str
    speed_mps: float = np.nan
    spread: float = np.nan

    def to_dict(self) -> dict[str, Any]:
        """Plain values, None for NaN."""
        return {
            "moving": self.moving,
            "reason": self.reason,
            "speed_max_mps": round(self.speed_mps, 4) if np.isfinite(self.speed_mps) else None,
            "spread_max": round(self.spread, 4) if np.isfinite(self.spread) else None,
        }


def detect_motion(t_ns: I8, pos_e: F8, cov_pos: F8, vel_e: F8, cov_vel: F8, trusted: Mask) -> Detected:
    """Whether the receiver of single-epoch solutions stands still throughout.

    Parameters
    ----------
    t_ns : (n,) int64
        Epochs, GPST ns; those of a block must follow each other, blocks may be apart.
    pos_e, vel_e : (n, 3) float64
        ECEF, m and m/s; NaN where there is none.
    cov_pos, cov_vel : (n, 3, 3) float64
        Claimed covariances, m^2 and m^2/s^2.
    trusted : (n,) bool
        Epochs whose position passed its own test.
    """
    if len(t_ns) < BLOCK * MIN_BLOCKS or trusted.sum() < BLOCK * MIN_BLOCKS:
        return Detected(True, "too few epochs to tell")
    middle = np.median(pos_e[trusted], axis=0)
    lat, lon, _ = geodetic_from_ecef(middle)
    turn = C_ne_enu(lat, lon)
    at = np.flatnonzero(trusted)
    blocks = at[: len(at) // BLOCK * BLOCK].reshape(-1, BLOCK)
    rates = _by_doppler(vel_e[blocks] @ turn.T, turn @ cov_vel[blocks] @ turn.T)
    pos_n = (pos_e[at] - middle) @ turn.T
    noise = _noise(pos_n)
    seen = turn.T @ np.diag(_OF_MANY * (_MEDIAN_OF_5 * noise) ** 2) @ turn
    spread = _spread((pos_e[blocks] - middle), cov_pos[blocks], seen)
    quick, slow = (_by_positions(t_ns[at], pos_n, span) for span in (0.0, SLOPE_SPAN_S))
    doppler = len(rates.speed) >= TRUSTED_SHARE * len(blocks)
    shown = rates if doppler else slow if len(slow.speed) else quick

    def found(moving: bool, reason: str) -> Detected:
        return Detected(moving, reason, float(shown.speed.max()), float(spread.max()) / 3.0)

    if trusted.mean() < TRUSTED_SHARE:
        return found(True, f"{100.0 * (1.0 - trusted.mean()):.0f} % of the epochs without a trusted position")
    if (spread > SPREAD).any():
        return found(True, "positions differ by more than their errors")
    if len(rates.speed):
        why = rates.why_moving(SLOW_MPS) or rates.why_unknown()
        if why:
            return found(True, f"Doppler: {why}")
    for slopes, slow_mps in ((quick, SLOW_MPS), (slow, SLOPE_MPS)):
        why = slopes.why_moving(slow_mps) if len(slopes.speed) and not slopes.why_unknown() else ""
        if why:
            return found(True, f"positions: {why}")
    if not doppler:
        if len(slow.speed) < MIN_BLOCKS:
            return found(True, "too short to tell without Doppler")
        loud = max(noise * [1.0, 1.0, 0.5]) > QUIET_M
        why = slow.why_unknown() or quick.why_unknown() or ("too noisy" if loud else "")
        if why:
            return found(True, f"no Doppler, and positions: {why}")
    return found(False, "at rest by Doppler and positions" if doppler else "at rest by positions, without Doppler")


def _spread(difference: F8, cov: F8, seen: F8) -> F8:
    """Squared distance of each block's median position from the middle in units of its covariance, (m,).

    What is claimed is meant for errors that last, in the main; noise of the block that is ``seen`` comes on top.
    """
    d = np.median(difference, axis=1)
    C = np.median(cov, axis=1) + seen
    return np.asarray((d * np.linalg.solve(C, d[:, :, None])[:, :, 0]).sum(axis=1))


@dataclass(frozen=True)
class _Velocities:
    """Velocities of blocks, east north up, and their noise, 1 sigma per axis, m/s, (m, 3)."""

    vel: F8
    sigma: F8

    @property
    def speed(self) -> F8:
        """Horizontal speed of every block."""
        return np.asarray(np.hypot(self.vel[:, 0], self.vel[:, 1]))

    @property
    def across(self) -> F8:
        """Horizontal noise of every block, 1 sigma per axis."""
        return np.asarray(np.hypot(self.sigma[:, 0], self.sigma[:, 1]) / np.sqrt(2.0))

    def why_unknown(self) -> str:
        """What keeps these velocities from showing rest; empty if nothing does."""
        if not np.isfinite(self.sigma).all():
            return "too few neighbours to know its noise"
        noise = float(np.median(self.across))
        return f"noise of {noise:.2f} m/s hides slow motion" if 5.0 * noise > SURELY_MOVING_MPS else ""

    def why_moving(self, slow_mps: float) -> str:
        """What speaks against rest; empty if nothing does."""
        v, s = self.vel, self.sigma
        limit = np.clip(5.0 * self.across, slow_mps, SURELY_MOVING_MPS)
        if (self.speed > limit).any():
            return f"up to {self.speed.max():.2f} m/s"
        # the vertical is weaker by half
        if (np.abs(v[:, 2]) > np.clip(5.0 * s[:, 2], 2.0 * slow_mps, 2.0 * SURELY_MOVING_MPS)).any():
            return f"up to {np.abs(v[:, 2]).max():.2f} m/s vertically"
        sway = _MAD * np.median(np.abs(v - np.median(v, axis=0)), axis=0)
        if (sway > np.maximum(3.0 * np.median(s, axis=0), [SWAY_MPS, SWAY_MPS, 2.0 * SWAY_MPS])).any():
            return f"sways by {sway.max():.2f} m/s"
        for part in np.array_split(v[:, :2], min(10, len(v) // MIN_BLOCKS) or 1):
            mean, error = part.mean(axis=0), part.std(axis=0) / np.sqrt(len(part))
            if np.hypot(*mean) > max(CRAWL_MPS, 5.0 * float(np.hypot(*error))):
                return f"crawls at {np.hypot(*mean):.2f} m/s"
        return ""


def _by_doppler(vel: F8, cov: F8) -> _Velocities:
    """Velocities of the blocks of which at least three epochs have one; noise of neighbours' differences."""
    known = np.isfinite(vel).all(axis=2)
    rows = np.flatnonzero(known.sum(axis=1) >= 3)
    vel, cov = vel[rows], cov[rows]
    if not len(rows):
        return _Velocities(np.empty((0, 3)), np.empty((0, 3)))
    claimed = np.sqrt(np.diagonal(cov, axis1=2, axis2=3))
    # what is claimed knows the geometry, what is seen knows the receiver: claimed times the ratio of all blocks
    step = np.abs(np.diff(vel, axis=1)) / (np.sqrt(2.0) * 0.5 * (claimed[:, 1:] + claimed[:, :-1]))
    seen = step[np.isfinite(step).all(axis=2)]
    ratio = _MAD * np.median(seen, axis=0) if len(seen) else np.full(3, np.nan)
    return _Velocities(np.nanmedian(vel, axis=1), _MEDIAN_OF_5 * ratio * np.nanmedian(claimed, axis=1))


def _noise(pos: F8) -> F8:
    """Noise of one position, by its differences to its neighbours, 1 sigma per axis, m, (3,)."""
    return np.asarray(_MAD * np.median(np.abs(np.diff(pos, axis=0)), axis=0) / np.sqrt(2.0))


def _by_positions(t_ns: I8, pos: F8, span_s: float) -> _Velocities:
    """Slopes of the positions over blocks of five epochs or ``span_s``, whichever is more."""
    step_s = float(np.median(np.diff(t_ns))) * 1e-9
    size = max(BLOCK, int(np.ceil(span_s / max(step_s, 1e-3))) + 1)
    n = len(t_ns) // size
    if n == 0:
        return _Velocities(np.empty((0, 3)), np.empty((0, 3)))
    t = (t_ns[: n * size].reshape(n, size) - t_ns[0]) * 1e-9
    p = pos[: n * size].reshape(n, size, 3)
    t = t - t.mean(axis=1, keepdims=True)
    scale = (t**2).sum(axis=1)[:, None]
    slope = (t[:, :, None] * p).sum(axis=1) / scale
    return _Velocities(slope, _noise(pos) / np.sqrt(scale))
