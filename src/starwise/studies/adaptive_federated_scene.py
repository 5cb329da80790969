"""The flight of the adaptive federated paper, its receivers' fixes, and the epochs that count.

The paper gives start (32 N, 118 E, 300 m), speed (300 m/s), first course (north), duration (1000 s) and that the
flight climbs, is level, changes speed and turns. What is chosen here, before any filter saw it: a climb at 8 deg by
4000 m, +-3 m/s^2 for 10 s, a turn of 90 deg at 1.5 deg/s and one at 5.6 deg/s (3 g).

Receivers: white errors of 10, 23 and 5 m per axis (the paper's sigmas), or those as first-order Markov errors of any
correlation time plus the paper's white noise, or errors as the geometry of simulated constellations makes them.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import NS
from starwise.estimators.fuse_plane import Plane, unroll
from starwise.gnsstime import parse_time
from starwise.sim.sections import Constellation, Sky, Vehicle
from starwise.sim.seeds import streams
from starwise.sim.segments import Climb, Straight, Turn
from starwise.sim.sky import build_sky
from starwise.sim.trajectory import from_segments
from starwise.types import F8

RECEIVERS: Final = ("GPS", "GLONASS", "Galileo")
CONSTELLATIONS: Final[tuple[Constellation, ...]] = ("gps", "glonass", "galileo")
SIGMA_M: Final = (10.0, 23.0, 5.0)
"""Position error of each receiver per axis, m."""
WHITE_M: Final = (1e-3, 5e-3, 1e-4)
"""The paper's R: white noise beside the Markov error, m."""
DURATION_S: Final = 1000
AXES: Final = ("longitude", "latitude", "height")
SETTLED_S: Final = 60
"""After a manoeuvre, until the steady state."""
BEGUN_S: Final = 100
AFTER_S: Final = 10
"""A manoeuvre's window reaches this far beyond it."""
MANEUVER_MPS2: Final = 0.1
_START: Final = "2009-05-15T04:00:00"


@dataclass(frozen=True)
class Flight:
    """Truth at 1 Hz.

    Attributes
    ----------
    plane : Plane
        Along the true positions: they are ``plane.base_e``, and ``plane.s`` unrolled.
    vel : (n, 3) float64
        Velocity in the plane's axes, m/s.
    steady, maneuver : (n,) bool
        Epochs from 100 s on that are 60 s after any manoeuvre; manoeuvres and 10 s after.
    first : (n,) int
        Number (from 1) of the manoeuvre in whose window an epoch is, 0 for none.
    """

    t_ns: NDArray[np.int64]
    plane: Plane
    vel: F8
    steady: NDArray[np.bool_]
    maneuver: NDArray[np.bool_]
    first: NDArray[np.int64]


@lru_cache(maxsize=4)
def flight(roll_in_s: float = 0.0) -> Flight:
    """The flight; ``roll_in_s`` is the time in which turns build up."""
    vehicle = Vehicle(
        kind="aircraft",
        start=(32.0, 118.0, 300.0),
        heading_deg=0.0,
        speed_mps=300.0,
        segments=(
            Straight(duration_s=150.0),
            Climb(pitch_deg=8.0, radius_m=12_000.0, height_m=4000.0),
            Straight(duration_s=110.0),
            Straight(speed_mps=330.0, acceleration_mps2=3.0),
            Straight(duration_s=100.0),
            Straight(speed_mps=300.0, acceleration_mps2=3.0),
            Straight(duration_s=110.0),
            Turn(angle_deg=90.0, rate_dps=1.5, roll_in_s=roll_in_s),
            Straight(duration_s=140.0),
            Turn(angle_deg=90.0, rate_dps=90.0 / 16.0, roll_in_s=roll_in_s),
            Straight(),
        ),
    )
    t0 = parse_time(_START)
    t_ns = t0 + NS * np.arange(DURATION_S + 1, dtype=np.int64)
    trajectory = from_segments(vehicle, t0, float(DURATION_S))
    truth = trajectory.states(t_ns)
    plane = unroll(truth.pos_e)
    # what accelerates against the straight line of the plane, at 10 Hz so that no arc falls between two epochs
    fine = trajectory.states(t0 + NS // 10 * np.arange(10 * DURATION_S + 1, dtype=np.int64))
    along = unroll(fine.pos_e).s
    acc = np.linalg.norm(np.diff(along, 2, axis=0), axis=1) * 100.0
    moving = np.flatnonzero(acc > MANEUVER_MPS2) / 10.0 + 0.1
    second = np.arange(DURATION_S + 1)
    since = np.full(DURATION_S + 1, np.inf)
    for k in second:
        before = moving[moving <= k]
        if len(before):
            since[k] = k - before[-1]
    begun = second >= BEGUN_S
    maneuver = begun & (since <= AFTER_S)
    starts = maneuver & ~np.concatenate([[False], maneuver[:-1]])
    return Flight(
        t_ns=t_ns,
        plane=plane,
        vel=plane.rotated_from_ecef(truth.vel_e),
        steady=begun & (since > SETTLED_S),
        maneuver=maneuver,
        first=np.where(maneuver, np.cumsum(starts), 0),
    )


@dataclass(frozen=True)
class Fixes:
    """Receivers' fixes of one run in the plane's axes.

    Attributes
    ----------
    z : (n, receivers, 3) float64
        m.
    r : (n, receivers, 3) float64
        Variances as the filter is told, m^2.
    """

    z: F8
    r: F8


def white_fixes(seed: int, run: int, scale: float = 1.0, tau_s: float = 0.0, roll_in_s: float = 0.0) -> Fixes:
    """Fixes with errors of `SIGMA_M` times ``scale``, the filter being told `SIGMA_M`.

    Parameters
    ----------
    seed, run : int
        Streams ``fixes/<receiver>`` of `starwise.sim.seeds`.
    scale : float
        What the filter does not know.
    tau_s : float
        Correlation time of the errors, s; 0: white.
    roll_in_s : float
        Of the flight.
    """
    path = flight(roll_in_s)
    n, K = len(path.t_ns), len(RECEIVERS)
    rng = streams(seed, run)
    errors = np.empty((n, K, 3))
    for k, name in enumerate(RECEIVERS):
        e = rng(f"fixes/{name}").standard_normal((n, 3))
        if tau_s > 0.0:
            e = _markov(e, float(np.exp(-1.0 / tau_s)))
            e = e * SIGMA_M[k] + WHITE_M[k] * rng(f"fixes/{name}/white").standard_normal((n, 3))
            errors[:, k] = scale * e
        else:
            errors[:, k] = scale * SIGMA_M[k] * e
    r = np.broadcast_to(np.square(SIGMA_M)[None, :, None], errors.shape).copy()
    return Fixes(path.plane.s[:, None] + errors, r)


def _markov(w: F8, decay: float) -> F8:
    """First-order Markov series of unit variance out of white noise (n, ...)."""
    from scipy.signal import lfilter

    gain = np.sqrt(1.0 - decay * decay)
    driven = np.concatenate([w[:1], gain * w[1:]])
    return np.asarray(lfilter([1.0], [1.0, -decay], driven, axis=0))


@lru_cache(maxsize=1)
def _geometry() -> tuple[tuple[F8, F8], ...]:
    """Per receiver: L (n, 3, satellites) that makes a fix's error of unit range errors, and its variances (n, 3)."""
    path = flight()
    out = []
    for name in CONSTELLATIONS:
        start, end = int(path.t_ns[0]), int(path.t_ns[-1])
        sky = build_sky(Sky(constellations=(name,)), start - NS, end + NS, streams(2009, 0))
        n, m = len(path.t_ns), len(sky.sv)
        states = sky.states(np.repeat(path.t_ns, m), np.tile(sky.sv, n)).reshape(n, m, -1)
        los = states[:, :, :3] - path.plane.base_e[:, None]
        u = np.einsum("nij,nkj->nki", path.plane.C_se, los / np.linalg.norm(los, axis=2)[:, :, None])
        H = np.concatenate([-u, np.ones((n, m, 1))], axis=2)
        H[u[:, :, 2] < np.sin(np.radians(5.0))] = 0.0  # below the mask
        N = np.linalg.inv(np.einsum("nki,nkj->nij", H, H))
        out.append((np.einsum("nij,nkj->nik", N, H)[:, :3], np.einsum("nii->ni", N)[:, :3]))
    return tuple(out)


def constellation_fixes(seed: int, run: int) -> Fixes:
    """Fixes by least squares from simulated GPS, GLONASS and Galileo: errors as the geometry makes them.

    Range errors are white, of a size that makes the horizontal error of a receiver `SIGMA_M` per axis in the mean; the
    vertical error, and the correlation between axes, follow from the satellites.
    """
    path = flight()
    n, K = len(path.t_ns), len(RECEIVERS)
    rng = streams(seed, run)
    errors, r = np.empty((n, K, 3)), np.empty((n, K, 3))
    for k, (L, var) in enumerate(_geometry()):
        unit = SIGMA_M[k] / np.sqrt(var[:, :2].mean())
        noise = rng(f"ranges/{RECEIVERS[k]}").standard_normal((n, L.shape[2]))
        errors[:, k] = unit * np.einsum("nik,nk->ni", L, noise)
        r[:, k] = unit * unit * var
    return Fixes(path.plane.s[:, None] + errors, r)
