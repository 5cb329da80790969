"""Inertial sensors: what they would read on a trajectory, and the errors of their grade.

True angular rate and specific force are fitted once by Chebyshev polynomials, panel by panel, halved until they hold
to rounding; readings and their exact integrals follow from the polynomials. Law: without errors, strapdown
integration of the increments returns the trajectory.

Errors (Groves 2013, section 4.4)::

    reading = (I + M) true + constant bias + Markov + white noise,  then quantised

M has scale factors on its diagonal and misalignments beside it. Every error has a random stream of its own.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.physics.earth import STANDARD_GRAVITY
from starwise.sim.path import INTEGRAL, NODES, TO_COEF, K
from starwise.sim.sections import Fault, Imu
from starwise.sim.seeds import Streams
from starwise.sim.trajectory import Trajectory
from starwise.types import Inertial

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

DPH: Final = np.pi / 180.0 / 3600.0
"""1 deg/h in rad/s."""
DPRH: Final = np.pi / 180.0 / 60.0
"""1 deg/sqrt(h) in rad/sqrt(s)."""
UG: Final = 1e-6 * STANDARD_GRAVITY
"""1 micro-g in m/s^2."""


@dataclass(frozen=True)
class SensorErrors:
    """Errors of a triad of gyroscopes (rad) or accelerometers (m/s), SI, 1 sigma, all zero by default."""

    bias: float = 0.0
    """Constant of a run, rad/s or m/s^2."""
    random_walk: float = 0.0
    """Root spectral density of the white noise, rad/sqrt(s) or m/s/sqrt(s)."""
    markov: float = 0.0
    """First-order Markov (in-run) bias, rad/s or m/s^2."""
    markov_tau_s: float = 1000.0
    scale: float = 0.0
    """Scale factor."""
    misalignment: float = 0.0
    """Cross-coupling between axes, rad."""
    quantum: float = 0.0
    """Smallest increment, rad or m/s."""


def _gyro(dph: float, dprh: float, markov: float, tau: float, ppm: float, urad: float, q: float) -> SensorErrors:
    return SensorErrors(dph * DPH, dprh * DPRH, markov * DPH, tau, ppm * 1e-6, urad * 1e-6, q)


def _accel(ug: float, mpsrh: float, markov: float, tau: float, ppm: float, urad: float, q: float) -> SensorErrors:
    return SensorErrors(ug * UG, mpsrh / 60.0, markov * UG, tau, ppm * 1e-6, urad * 1e-6, q)


# Bias, white noise, Markov bias and its time, scale factor, misalignment, quantum (at 100 Hz).
# navigation, tactical, consumer: RMS over the axes of the profiles "aviation", "tactical" and "consumer" in the
# software that comes with Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems",
# 2nd ed. (2013). Their in-run bias: a tenth of the constant one (section 4.4.1), with time constants of that order.
# industrial: data sheet of a calibrated MEMS unit (Aceinna OpenIMU300ZA: bias instability 6 deg/h and 20 micro-g,
# random walks 0.3 deg/sqrt(h) and 0.05 m/s/sqrt(h), scale 0.1 %), constant bias a fifth of its RMS over temperature
# (0.5 deg/s, 5 mg), misalignment 0.05 deg as usual for such units.
GRADES: Final[dict[str, tuple[SensorErrors, SensorErrors]]] = {
    "perfect": (SensorErrors(), SensorErrors()),
    #                    deg/h  deg/rt(h)  deg/h   s     ppm   urad  rad      |  ug    m/s/rt(h)  ug   s   ppm urad m/s
    "navigation": (
        _gyro(0.001, 0.002, 0.0001, 3600.0, 8.0, 8.0, 1e-8),
        _accel(35.0, 0.012, 3.5, 3600.0, 100.0, 80.0, 5e-7),
    ),
    "tactical": (
        _gyro(10.0, 0.01, 1.0, 1000.0, 400.0, 250.0, 2e-6),
        _accel(1000.0, 0.059, 100.0, 1000.0, 400.0, 250.0, 1e-4),
    ),
    "industrial": (
        _gyro(360.0, 0.3, 6.0, 300.0, 1000.0, 870.0, 3e-6),
        _accel(1000.0, 0.05, 20.0, 300.0, 1000.0, 870.0, 5e-5),
    ),
    "consumer": (
        _gyro(200.0, 1.0, 20.0, 300.0, 40_000.0, 14_000.0, 2e-5),
        _accel(10_000.0, 0.59, 1000.0, 300.0, 40_000.0, 10_000.0, 1e-3),
    ),
}
"""Gyroscope and accelerometer errors by grade."""


def errors_of(section: Imu) -> tuple[SensorErrors, SensorErrors]:
    """Gyroscope and accelerometer errors of a scenario's ``[imu]``: the grade's, or what the section gives."""
    units = (
        {
            "bias": (section.gyro_bias_dph, DPH),
            "random_walk": (section.gyro_arw_dprh, DPRH),
            "markov": (section.gyro_markov_dph, DPH),
            "markov_tau_s": (section.gyro_markov_tau_s, 1.0),
            "scale": (section.gyro_scale_ppm, 1e-6),
            "misalignment": (section.gyro_misalignment_urad, 1e-6),
            "quantum": (section.gyro_quantum_rad, 1.0),
        },
        {
            "bias": (section.accel_bias_ug, UG),
            "random_walk": (section.accel_vrw_mpsrh, 1.0 / 60.0),
            "markov": (section.accel_markov_ug, UG),
            "markov_tau_s": (section.accel_markov_tau_s, 1.0),
            "scale": (section.accel_scale_ppm, 1e-6),
            "misalignment": (section.accel_misalignment_urad, 1e-6),
            "quantum": (section.accel_quantum_mps, 1.0),
        },
    )
    made = [
        dataclasses.replace(grade, **{name: value * si for name, (value, si) in given.items() if value is not None})
        for grade, given in zip(GRADES[section.grade], units, strict=True)
    ]
    return made[0], made[1]


@dataclass(frozen=True)
class SimulatedImu:
    """Readings with the truth behind them.

    Attributes
    ----------
    measured, perfect : Inertial
        With errors and without, row-aligned.
    gyro_bias, accel_bias : (n, 3) float64
        Constant and Markov bias together at each reading, rad/s and m/s^2.
    M_gyro, M_accel : (3, 3) float64
        Scale factors and misalignments.
    """

    measured: Inertial
    perfect: Inertial
    gyro_bias: F8
    accel_bias: F8
    M_gyro: F8
    M_accel: F8


def simulate_imu(
    trajectory: Trajectory,
    section: Imu,
    start_ns: int,
    end_ns: int,
    streams: Streams,
    faults: Sequence[Fault] = (),
) -> SimulatedImu:
    """Readings of an inertial unit at the body's origin.

    Parameters
    ----------
    trajectory : Trajectory
    section : Imu
        Grade, rate, output.
    start_ns, end_ns : int
        GPST, ns. Rates are read at the start and then at every period; increments end at the latter only.
    streams : Streams
        One stream per error: ``imu/gyro/bias``, ``imu/accel/white`` ...
    faults : sequence of Fault
        Those of sensors ``gyro`` and ``accelerometer``; an outage of either leaves the readings out.

    Raises
    ------
    StarwiseError
        The attitude jumps, which no gyroscope can follow.
    """
    t0_s, t1_s = (start_ns - trajectory.t0_ns) * 1e-9, (end_ns - trajectory.t0_ns) * 1e-9
    for jump in trajectory.jumps:
        if t0_s < jump.t_s < t1_s:
            raise StarwiseError(
                "the attitude jumps where inertial sensors are simulated",
                found=f"{np.degrees(jump.angle_rad):.1f} deg at {jump.t_s:.3f} s",
                wanted="a smooth way, like roll_in_s in the turns of an aircraft",
            )
    n = int((end_ns - start_ns) * section.rate_hz / NS + 1e-9)
    t_ns = start_ns + np.rint(np.arange(n + 1) * (NS / section.rate_hz)).astype(np.int64)
    perfect = _perfect(trajectory, t_ns, section.output == "increments")
    since = np.asarray((perfect.t_ns - start_ns) * 1e-9, dtype=np.float64)
    gyro_errors, accel_errors = errors_of(section)
    gyro, gyro_bias, M_gyro = _measured(perfect.gyro, perfect, gyro_errors, streams, "gyro")
    accel, accel_bias, M_accel = _measured(perfect.accel, perfect, accel_errors, streams, "accel")
    keep = np.ones(len(since), dtype=bool)
    for number, fault in enumerate(faults):
        if fault.sensor == "gnss":
            continue
        if fault.kind == "outage":
            keep &= ~fault.active(since)
            continue
        reading = gyro if fault.sensor == "gyro" else accel
        reading += _fault(fault, since, perfect, streams(f"imu/fault/{number}"))
    quantised = [
        _quantised(reading, perfect, errors.quantum, section.rate_hz)[keep]
        for reading, errors in ((gyro, gyro_errors), (accel, accel_errors))
    ]
    perfect = Inertial(
        perfect.t_ns[keep], perfect.dt_s[keep], perfect.gyro[keep], perfect.accel[keep], perfect.increments
    )
    measured = Inertial(perfect.t_ns, perfect.dt_s, quantised[0], quantised[1], perfect.increments)
    return SimulatedImu(measured, perfect, gyro_bias[keep], accel_bias[keep], M_gyro, M_accel)


def perfect_imu(trajectory: Trajectory, t_ns: I8, *, increments: bool) -> Inertial:
    """What sensors without errors read: rates at ``t_ns``, or increments over the intervals between them (n - 1).

    Parameters
    ----------
    trajectory : Trajectory
    t_ns : (n,) int64
        GPST, ns, increasing.
    increments : bool
    """
    return _perfect(trajectory, np.asarray(t_ns, dtype=np.int64), increments)


@dataclass(frozen=True)
class _Panels:
    """Chebyshev coefficients (m, K, 6) of angular rate and specific force between edges (m + 1,)."""

    edges: F8
    coef: F8


_TOLERANCE = np.array([1e-13] * 3 + [1e-11] * 3)  # rad/s, m/s^2: where rounding takes over
_LONGEST_S = 60.0
_SHORTEST_S = 1e-3


def _fitted(trajectory: Trajectory, t0_s: float, t1_s: float) -> _Panels:
    """Panels over [t0, t1], none across a knot of the path, halved until the last coefficients vanish."""
    knots = trajectory.knots_s
    inside = knots[(knots > t0_s + 1e-9) & (knots < t1_s - 1e-9)]
    stretches = itertools.pairwise(np.unique(np.concatenate([[t0_s], inside, [t1_s]])))
    pending = np.array(
        [
            pair
            for a, b in stretches
            for pair in itertools.pairwise(np.linspace(a, b, 1 + int(np.ceil((b - a) / _LONGEST_S))))
        ]
    )
    done: list[tuple[F8, F8]] = []
    while len(pending):
        half = 0.5 * (pending[:, 1] - pending[:, 0])
        t = pending[:, :1] + half[:, None] * (NODES + 1.0)
        states = trajectory.states_s(t.ravel())
        values = np.concatenate([states.omega_ib_b, states.f_ib_b], axis=1).reshape(len(pending), K, 6)
        coef = TO_COEF @ values
        size = np.abs(coef).max(axis=1)
        tail = np.abs(coef[:, -3:, :]).max(axis=1)
        good = (tail <= np.maximum(_TOLERANCE, 1e-13 * size)).all(axis=1) | (half < _SHORTEST_S)
        done.append((pending[good], coef[good]))
        bad = pending[~good]
        middle = bad.mean(axis=1)
        pending = np.concatenate([np.stack([bad[:, 0], middle], 1), np.stack([middle, bad[:, 1]], 1)])
    spans = np.concatenate([span for span, _ in done])
    order = np.argsort(spans[:, 0])
    coef = np.concatenate([c for _, c in done])[order]
    return _Panels(np.append(spans[order, 0], t1_s), coef)


def _perfect(trajectory: Trajectory, t_ns: I8, increments: bool) -> Inertial:
    t_s = (t_ns - trajectory.t0_ns) * 1e-9
    panels = _fitted(trajectory, float(t_s[0]), float(t_s[-1]))
    widths = np.diff(panels.edges)
    coef = panels.coef
    if increments:
        coef = 0.5 * widths[:, None, None] * (INTEGRAL @ coef)
    which = np.clip(np.searchsorted(panels.edges, t_s, side="right") - 1, 0, len(widths) - 1)
    out = np.empty((len(t_s), 6))
    ends = np.searchsorted(which, np.arange(len(widths) + 1))
    for k, (a, b) in enumerate(itertools.pairwise(ends)):
        if b > a:
            x = 2.0 * (t_s[a:b] - panels.edges[k]) / widths[k] - 1.0
            out[a:b] = chebyshev.chebvander(x, coef.shape[1] - 1) @ coef[k]
    dt_s = np.diff(t_ns) * 1e-9
    if not increments:
        return Inertial(t_ns, np.append(dt_s[:1], dt_s), out[:, :3].copy(), out[:, 3:].copy(), False)
    step = np.diff(out, axis=0)
    across = np.nonzero(np.diff(which))[0]  # whole panels that end between two readings
    whole = np.concatenate([np.zeros((1, 6)), np.cumsum(coef.sum(axis=1), axis=0)])
    step[across] += whole[which[across + 1]] - whole[which[across]]
    return Inertial(t_ns[1:], dt_s, step[:, :3].copy(), step[:, 3:].copy(), True)


def _measured(true: F8, perfect: Inertial, errors: SensorErrors, streams: Streams, name: str) -> tuple[F8, F8, F8]:
    """Readings with errors but not yet quantised, the bias (n, 3) behind them, and M."""
    n = len(true)
    bias = errors.bias * streams(f"imu/{name}/bias").standard_normal(3)
    M = np.diag(errors.scale * streams(f"imu/{name}/scale").standard_normal(3))
    beside = errors.misalignment * streams(f"imu/{name}/misalignment").standard_normal((3, 3))
    M += beside - np.diag(np.diag(beside))
    total = np.broadcast_to(bias, (n, 3)).copy()
    if errors.markov > 0.0:
        noise = streams(f"imu/{name}/markov").standard_normal((n, 3))
        total += _markov(errors.markov * noise, float(np.median(perfect.dt_s)) / errors.markov_tau_s)
    dt = perfect.dt_s[:, None]
    reading = true @ (np.eye(3) + M).T
    reading += total * dt if perfect.increments else total
    if errors.random_walk > 0.0:
        noise = streams(f"imu/{name}/white").standard_normal((n, 3))
        noise *= errors.random_walk * (np.sqrt(dt) if perfect.increments else 1.0 / np.sqrt(dt))
        reading += noise
    return reading, total, M


def _markov(white: F8, step: float) -> F8:
    """First-order Markov sequences, stationary from the start, with the variance of the white noise (n, 3)."""
    from scipy.signal import lfilter

    keep = np.exp(-step)
    driven = white * np.sqrt(-np.expm1(-2.0 * step))
    driven[0] = white[0]
    return np.asarray(lfilter([1.0], [1.0, -keep], driven, axis=0), dtype=np.float64)


def _fault(fault: Fault, since_s: F8, perfect: Inertial, rng: np.random.Generator) -> F8:
    """What a fault adds to the readings, (n, 3)."""
    axes = np.array([axis in fault.axes for axis in "xyz"], dtype=np.float64)
    shape = np.ones(len(since_s))
    if fault.kind == "ramp":
        shape = since_s - fault.start_s
    added = np.where(fault.active(since_s), fault.size * shape, 0.0)[:, None] * axes
    if fault.kind == "burst":
        added = added * rng.standard_normal(added.shape)
    return added * perfect.dt_s[:, None] if perfect.increments else added


def _quantised(reading: F8, perfect: Inertial, quantum: float, rate_hz: float) -> F8:
    """Increments as pulses are counted (what is left over counts later); rates to the nearest step."""
    if quantum <= 0.0:
        return reading
    if not perfect.increments:
        step = quantum * rate_hz
        return np.asarray(step * np.rint(reading / step))
    counted = np.rint(np.cumsum(reading, axis=0) / quantum)
    return np.asarray(quantum * np.diff(counted, axis=0, prepend=0.0))
