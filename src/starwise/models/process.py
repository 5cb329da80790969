"""What the filter believes of the motion of its user and of its receiver's clocks: presets and exact matrices.

The numbers of the presets come from what such users do, not from any data set; `RunConfig.process` and
`RunConfig.clock` override them one by one.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from starwise.config import RunConfig
from starwise.constants import C_LIGHT
from starwise.errors import StarwiseError
from starwise.kernels.process import ACCELERATION, CURRENT, SINGER, STATIC, VELOCITY, Process, motion
from starwise.types import F8

KINDS: Final = {
    "static": STATIC, "velocity": VELOCITY, "acceleration": ACCELERATION, "singer": SINGER, "current": CURRENT,
}  # fmt: skip
ORDERS: Final = {"static": 1, "velocity": 2, "acceleration": 3, "singer": 3, "current": 3}
_AXES: Final = ("x", "y", "z")
RAYLEIGH: Final = (4.0 - math.pi) / math.pi
"""Variance of the "current" model over a_max squared, where the acceleration is estimated as zero."""


@dataclass(frozen=True)
class Motion:
    """Motion of the user, the same on every axis but for the strength of the noise up and across.

        static        x' = w                                        w: m^2/s
        velocity      x' = v, v' = w                                w: m^2/s^3
        acceleration  x' = v, v' = a, a' = w                        w: m^2/s^5
        singer        x' = v, v' = a, a' = -a / tau + w             variance of a: m^2/s^4, w: 2 sigma^2 / tau
        current       the same about the predicted acceleration; variance (4 - pi) / pi (a_max - |a|)^2

    Law: Phi(c, b) Phi(b, a) = Phi(c, a) and Q(c, a) = Phi(c, b) Q(b, a) Phi(c, b)' + Q(c, b), for any dt.

    Attributes
    ----------
    model : str
        A key of `KINDS`.
    horizontal, vertical : float
        Spectral density of w (Singer: variance of the acceleration; "current": that of one estimated as zero) per
        axis, units above.
    tau_s : float
        Singer, "current": correlation time of the acceleration, s.
    velocity_sigma0, acceleration_sigma0 : float
        Standard deviations of a start about which nothing is known, m/s and m/s^2.
    """

    model: str
    horizontal: float
    vertical: float
    tau_s: float = 1.0
    velocity_sigma0: float = 1.0
    acceleration_sigma0: float = 1.0

    @property
    def a_max(self) -> float:
        """Largest horizontal acceleration of the "current" model, m/s^2, else zero."""
        return math.sqrt(self.horizontal / RAYLEIGH) if self.model == "current" else 0.0

    @property
    def nk(self) -> int:
        """Number of kinematic states: 3, 6 or 9."""
        return 3 * ORDERS[self.model]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the kinematic states, in order."""
        return tuple(f"{kind}.{axis}" for kind in ("pos", "vel", "acc")[: ORDERS[self.model]] for axis in _AXES)


@dataclass(frozen=True)
class Clocks:
    """Receiver clocks: b' = d + w_b, d' = w_d for the oscillator, and the like for each system by itself.

    Attributes
    ----------
    bias_psd, drift_psd : float
        Oscillator: white frequency noise, m^2/s; random walk of the frequency, m^2/s^3.
    system_bias_psd, system_drift_psd : float
        Each system's clock against the oscillator.
    drift_sigma0 : float
        Drift of a clock of which nothing is known, m/s.
    intersystem_sigma0, intersystem_drift_sigma0 : float
        A new system's clock and drift against those known, m and m/s.
    """

    bias_psd: float
    drift_psd: float
    system_bias_psd: float
    system_drift_psd: float
    drift_sigma0: float
    intersystem_sigma0: float
    intersystem_drift_sigma0: float


def clock_psd(h0: float, h_2: float) -> tuple[float, float]:
    """Spectral densities (m^2/s, m^2/s^3) of a two-state clock from its Allan variance parameters.

    S_b = c^2 h_0 / 2, S_d = 2 pi^2 c^2 h_-2 (Van Dierendonck et al. 1984; Brown and Hwang 2012, 9.3).
    """
    return C_LIGHT**2 * h0 / 2.0, 2.0 * math.pi**2 * C_LIGHT**2 * h_2


# A temperature-compensated crystal, the poorest oscillator in common receivers: h0 2e-19 s, h-2 2e-20 Hz (Brown and
# Hwang 2012, table 9.3). A better one loses nothing: each epoch's satellites give the clock to a metre anyway.
_TCXO = clock_psd(2e-19, 2e-20)
CLOCKS: Final = Clocks(
    bias_psd=_TCXO[0],
    drift_psd=_TCXO[1],
    # Delays of receiver channels and of system times wander by about a nanosecond (0.3 m) in an hour.
    system_bias_psd=0.3**2 / 3600.0,
    # The same oscillator drives all channels; what is left is satellite clock drift common to a system, 1e-13.
    system_drift_psd=(1e-13 * C_LIGHT) ** 2 / 3600.0,
    drift_sigma0=3e-6 * C_LIGHT,  # crystals are specified to a few ppm
    intersystem_sigma0=1e-6 * C_LIGHT,  # system times agree to a microsecond, hardware delays are shorter
    intersystem_drift_sigma0=0.01,  # m/s: the same oscillator; 3e-11 is the worst ever seen between system times
)

RESTING_PSD: Final = 0.01**2 / 3600.0
"""Static, where errors that last have states of their own: the ground moves by tides, 1 cm in an hour; m^2/s."""
PRESETS: Final[dict[str, Motion]] = {
    # The antenna does not move; what moves its position is error that the measurement model takes for white and that
    # is not: the remainders of ionosphere, orbits and clocks, some 3 m in an hour. With less the filter would average
    # errors that do not average, and believe it.
    "static": Motion("static", 3.0**2 / 3600.0, 3.0**2 / 3600.0),
    # Walking: turning back (2.8 m/s) takes about 2 s: sigma 1 m/s after 2 s across. Stairs and slopes: 0.3 m/s.
    "pedestrian": Motion("velocity", 0.5, 0.05, velocity_sigma0=2.0),
    # Cars: braking and cornering seldom above 3-4 m/s^2, normally below 1, for about 3 s; on roads, hardly vertical.
    "vehicle": Motion("singer", 1.0**2, 0.3**2, 3.0, velocity_sigma0=30.0, acceleration_sigma0=1.0),
    # Aircraft: turns up to 3 g (30 m/s^2, 3 sigma) that last some 10 s, in any direction.
    "aircraft": Motion("singer", 10.0**2, 10.0**2, 10.0, velocity_sigma0=300.0, acceleration_sigma0=10.0),
}
A_MAX: Final = {"aircraft": 30.0}
"""Largest horizontal acceleration for the "current" model, m/s^2, by preset; of all others `A_MAX_OTHERS`."""
A_MAX_OTHERS: Final = 4.0
MOVING: Final = "vehicle"
"""Preset for a user of whom only that it may move is known; that of ``auto`` until somebody has looked."""


def motion_from(config: RunConfig) -> Motion:
    """Motion model of a configuration: the preset of `dynamics`, with what `process` says instead.

    Raises
    ------
    StarwiseError
        `process` has a number that the model has no use for.
    """
    m = PRESETS[MOVING if config.dynamics == "auto" else config.dynamics]
    if m.model == "static" and config.error_model == "colored":
        m = replace(m, horizontal=RESTING_PSD, vertical=RESTING_PSD)
    p = config.process
    model = p.model or m.model
    of_model = {
        "position_psd_m2_per_s": "static",
        "acceleration_psd_m2_per_s3": "velocity",
        "jerk_psd_m2_per_s5": "acceleration",
        "acceleration_sigma_mps2": "singer",
        "acceleration_tau_s": "singer or current",
        "acceleration_max_mps2": "current",
    }
    for key, owner in of_model.items():
        if getattr(p, key) is not None and model not in owner.split(" or "):
            raise StarwiseError(
                f"'process.{key}' belongs to another process model",
                found=f"model {model} (dynamics {config.dynamics})",
                wanted=f"process.model = {owner}",
            )
    if model != m.model:
        # Another model than the preset's: defaults of the preset that has it, or of a car's jerk.
        fallback = {
            "static": PRESETS["static"],
            "velocity": PRESETS["pedestrian"],
            "acceleration": Motion("acceleration", 1.0, 0.1, acceleration_sigma0=1.0),
            "singer": PRESETS["vehicle"],
            "current": _current(m if m.model == "singer" else PRESETS["vehicle"], A_MAX.get(config.dynamics)),
        }[model]
        m = replace(
            fallback,
            velocity_sigma0=m.velocity_sigma0 if m.model != "static" else fallback.velocity_sigma0,
        )
    strength = {
        "static": p.position_psd_m2_per_s,
        "velocity": p.acceleration_psd_m2_per_s3,
        "acceleration": p.jerk_psd_m2_per_s5,
        "singer": None if p.acceleration_sigma_mps2 is None else p.acceleration_sigma_mps2**2,
        "current": None if p.acceleration_max_mps2 is None else RAYLEIGH * p.acceleration_max_mps2**2,
    }[model]
    if strength is not None:
        # One number is given: the horizontal one; the vertical keeps the preset's proportion to it.
        share = m.vertical / m.horizontal if m.horizontal > 0.0 else 1.0
        m = replace(m, horizontal=strength, vertical=strength * share)
    if model in ("singer", "current"):
        m = replace(
            m,
            tau_s=p.acceleration_tau_s or m.tau_s,
            acceleration_sigma0=math.sqrt(max(m.horizontal, m.vertical)),
        )
    return m


def _current(like: Motion, a_max: float | None) -> Motion:
    """The "current" model with the correlation time of a Singer model, and its proportion of vertical to horizontal."""
    h = RAYLEIGH * (a_max or A_MAX_OTHERS) ** 2
    return replace(like, model="current", horizontal=h, vertical=h * like.vertical / like.horizontal)


def clocks_from(config: RunConfig) -> Clocks:
    """Clock model of a configuration."""
    c = config.clock
    given = {
        "bias_psd": c.bias_psd_m2_per_s,
        "drift_psd": c.drift_psd_m2_per_s3,
        "system_bias_psd": c.intersystem_psd_m2_per_s,
    }
    return replace(CLOCKS, **{name: value for name, value in given.items() if value is not None})


def process_numbers(motion_model: Motion, clocks: Clocks) -> Process:
    """The same as plain numbers for kernels."""
    return Process(
        kind=KINDS[motion_model.model],
        nk=motion_model.nk,
        horizontal=motion_model.horizontal,
        vertical=motion_model.vertical,
        tau_s=motion_model.tau_s,
        bias_psd=clocks.bias_psd,
        drift_psd=clocks.drift_psd,
        system_bias_psd=clocks.system_bias_psd,
        system_drift_psd=clocks.system_drift_psd,
        a_max=motion_model.a_max,
    )


def matrices(motion_model: Motion, clocks: Clocks, n_clocks: int, dt_s: float, up: F8 | None = None) -> tuple[F8, F8]:
    """Phi and Q (n, n) over ``dt_s``, states position, velocity, acceleration, clock biases, clock drifts (ECEF, SI).

    Of the "current" model: those of the covariance, about an acceleration of zero.

    Parameters
    ----------
    motion_model : Motion
    clocks : Clocks
    n_clocks : int
    dt_s : float
        s, not negative.
    up : (3,) array, optional
        Unit vector of the vertical; without it the horizontal noise applies to all axes.
    """
    order = motion_model.nk // 3
    F, G = np.empty((3, 3)), np.empty((3, 3))
    motion(KINDS[motion_model.model], dt_s, motion_model.tau_s, F, G)
    M = motion_model.horizontal * np.eye(3)
    if up is not None:
        M += (motion_model.vertical - motion_model.horizontal) * np.outer(up, up)
    together, own = np.ones((n_clocks, n_clocks)), np.eye(n_clocks)
    b = clocks.bias_psd * together + clocks.system_bias_psd * own
    d = clocks.drift_psd * together + clocks.system_drift_psd * own
    nk, n = motion_model.nk, motion_model.nk + 2 * n_clocks
    Phi, Q = np.zeros((n, n)), np.zeros((n, n))
    Phi[:nk, :nk] = np.kron(F[:order, :order], np.eye(3))
    Q[:nk, :nk] = np.kron(G[:order, :order], M)
    Phi[nk:, nk:] = np.kron([[1.0, dt_s], [0.0, 1.0]], own)
    Q[nk:, nk:] = np.block([[b * dt_s + d * dt_s**3 / 3.0, d * dt_s**2 / 2.0], [d * dt_s**2 / 2.0, d * dt_s]])
    return Phi, Q


def driving(motion_model: Motion, clocks: Clocks, n_clocks: int) -> tuple[F8, F8]:
    """The continuous model: x' = A x + w with spectral density W (n, n), noise alike on all axes."""
    order = motion_model.nk // 3
    A1, W1 = np.zeros((order, order)), np.zeros((order, order))
    A1[np.arange(order - 1), np.arange(1, order)] = 1.0
    W1[-1, -1] = motion_model.horizontal
    if motion_model.model in ("singer", "current"):
        A1[-1, -1] = -1.0 / motion_model.tau_s
        W1[-1, -1] = 2.0 * motion_model.horizontal / motion_model.tau_s
    nk, n = motion_model.nk, motion_model.nk + 2 * n_clocks
    A, W = np.zeros((n, n)), np.zeros((n, n))
    A[:nk, :nk], W[:nk, :nk] = np.kron(A1, np.eye(3)), np.kron(W1, np.eye(3))
    together, own = np.ones((n_clocks, n_clocks)), np.eye(n_clocks)
    A[nk:, nk:] = np.kron([[0.0, 1.0], [0.0, 0.0]], own)
    W[nk : nk + n_clocks, nk : nk + n_clocks] = clocks.bias_psd * together + clocks.system_bias_psd * own
    W[nk + n_clocks :, nk + n_clocks :] = clocks.drift_psd * together + clocks.system_drift_psd * own
    return A, W
