"""Receiver clock: the two-state model of an oscillator with its Allan parameters, and steering by milliseconds.

Phase x (s) and fractional frequency y obey ``dx = y dt + dw1``, ``dy = dw2`` with spectral densities ``h0 / 2``
(white frequency noise) and ``2 pi^2 h_-2`` (random walk of frequency). Law: the Allan variance of the samples is
``h0 / (2 tau) + (2 pi^2 / 3) h_-2 tau``. Flicker noise (h_-1) is not a finite-state process and is left out: a real
oscillator of the grade has a floor of about ``2 ln 2 h_-1`` where the two slopes meet.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.errors import StarwiseError
from starwise.sim.sections import Clock

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# Brown & Hwang, "Introduction to Random Signals and Applied Kalman Filtering", 4th ed. (2012), section 9.3, table of
# Allan variance coefficients of timing standards: h0 (s), h-2 (1/s).
GRADES: Final[dict[str, tuple[float, float]]] = {
    "perfect": (0.0, 0.0),
    "tcxo": (2e-19, 2e-20),  # TCXO, low quality: what navigation receivers have
    "ocxo": (2e-25, 6e-25),
    "rubidium": (2e-22, 1e-30),
}
"""White and random walk frequency noise coefficients of oscillators."""
MILLISECOND: Final = 1e-3
STEER_LIMIT_S: Final = 0.51e-3
"""Offset at which a steered clock is set: past half a millisecond, so that noise cannot set it back and forth."""


@dataclass(frozen=True)
class ClockStates:
    """Receiver clock at n times.

    Attributes
    ----------
    t_ns : (n,) int64
        GPST, ns.
    bias_s : (n,) float64
        Clock reading minus GPST, s, steering included: the receiver tags ``t + bias_s``.
    drift : (n,) float64
        Its rate, s/s (steering does not change it).
    steered_s : (n,) float64
        What steering has added so far: whole milliseconds.
    """

    t_ns: I8
    bias_s: F8
    drift: F8
    steered_s: F8

    @property
    def oscillator_s(self) -> F8:
        """Offset of the free-running oscillator, continuous, s: carrier phase follows it."""
        return self.bias_s - self.steered_s


@dataclass(frozen=True)
class ReceiverClock:
    """An oscillator and how it is steered.

    Attributes
    ----------
    h0_s, hm2_per_s : float
        Allan variance coefficients, s and 1/s.
    bias_s, drift : float
        State at the first sample, s and s/s.
    steered : bool
        By whole milliseconds, whenever the offset passes `STEER_LIMIT_S`.
    """

    h0_s: float
    hm2_per_s: float
    bias_s: float = 0.0
    drift: float = 0.0
    steered: bool = False

    @classmethod
    def of(cls, section: Clock) -> "ReceiverClock":
        """Clock of a scenario's ``[receiver.clock]``."""
        h0, hm2 = GRADES[section.grade]
        return cls(
            h0_s=h0 if section.h0_s is None else section.h0_s,
            hm2_per_s=hm2 if section.hm2_per_s is None else section.hm2_per_s,
            bias_s=section.bias_s,
            drift=section.drift,
            steered=section.reset == "millisecond",
        )

    def allan_variance(self, tau_s: float) -> float:
        """Allan variance of the fractional frequency at an averaging time, s."""
        return self.h0_s / (2.0 * tau_s) + 2.0 * np.pi**2 / 3.0 * self.hm2_per_s * tau_s

    def sample(self, t_ns: I8, rng: np.random.Generator) -> ClockStates:
        """One realisation at times.

        Parameters
        ----------
        t_ns : (n,) int64
            GPST, ns, increasing.
        rng : numpy Generator
            Takes two normal numbers per interval, whatever the grade.
        """
        t = np.asarray(t_ns, dtype=np.int64)
        dt = np.diff(t) * 1e-9
        if (dt <= 0.0).any():
            raise StarwiseError("clock times do not increase")
        white = rng.standard_normal((len(dt), 2))
        # exact discrete noise of (x, y) over dt: q1 dt + q2 dt^3 / 3, q2 dt^2 / 2, q2 dt; Cholesky with y first
        q1, q2 = 0.5 * self.h0_s, 2.0 * np.pi**2 * self.hm2_per_s
        w_y = np.sqrt(q2 * dt) * white[:, 0]
        w_x = 0.5 * dt * w_y + np.sqrt(q1 * dt + q2 * dt**3 / 12.0) * white[:, 1]
        drift = self.drift + np.concatenate([[0.0], np.cumsum(w_y)])
        free = self.bias_s + np.concatenate([[0.0], np.cumsum(drift[:-1] * dt + w_x)])
        steered = _steering(free) if self.steered else np.zeros(len(t))
        return ClockStates(t, free + steered, drift, steered)


def _steering(free_s: F8) -> F8:
    """Whole milliseconds added to a free-running offset so that it stays within `STEER_LIMIT_S`."""
    steered = np.zeros_like(free_s)
    offset, start = 0.0, 0
    while True:
        beyond = np.abs(free_s[start:] + offset) > STEER_LIMIT_S
        if not beyond.any():
            steered[start:] = offset
            return steered
        at = start + int(np.argmax(beyond))
        steered[start:at] = offset
        offset -= MILLISECOND * float(np.round((free_s[at] + offset) / MILLISECOND))
        start = at
