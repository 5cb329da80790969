"""BeiDou-1 radio determination (RDSS): active positioning with two geostationary satellites.

A user asks; the ground station measures the round trips to the user over two satellites, takes the user's height from a
map or from the user, computes the position and sends it back. What arrives is therefore the position *at the time of
the request*, one latency ago.

Up and down the same way, the rotation of the Earth during the flight cancels to first order (the Sagnac terms have
opposite signs; what is left is below a millimetre): a round trip is twice the distance in ECEF at the moment when the
user's transponder answers.
"""

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.frames import ecef_from_geodetic, geodetic_from_ecef, rotations_ne_enu
from starwise.kernels.rdss import fix_many
from starwise.types import F8, I8, Fixes

GEO_RADIUS_M: Final = 42_164_170.0
"""Radius of the geostationary orbit, m: (GM / omega_ie^2)^(1/3)."""
BEIDOU1_LONGITUDES_DEG: Final = (80.0, 140.0)
"""Satellites of BeiDou-1 (a third, 110.5 E, was the spare)."""


@dataclass(frozen=True)
class RdssNoise:
    """Errors of an active fix, 1 sigma, m.

    Attributes
    ----------
    orbit_m, ranging_m : float
        Distance to a satellite: by the drift of the satellite, and everything else (half the error of a round trip).
    height_m : float
        Height that the ground station assumes.
    """

    orbit_m: float = 8.0
    ranging_m: float = 13.0
    height_m: float = 10.0

    @property
    def distance_m(self) -> float:
        """Whole error of a distance."""
        return float(np.hypot(self.orbit_m, self.ranging_m))


@dataclass(frozen=True)
class RdssGeometry:
    """What errors of a fix come to at a place, in east, north, up.

    Attributes
    ----------
    from_distance, from_height : (3, 3) float64
        Covariances, m^2, of the part by distances and of the part by height; the fix has their sum.
    """

    from_distance: F8
    from_height: F8

    @property
    def cov_enu(self) -> F8:
        """Covariance of the fix, east, north, up, m^2."""
        return np.asarray(self.from_distance + self.from_height)

    @property
    def sigmas(self) -> dict[str, float]:
        """Paper's equation 4: east-west and north-south sigmas, by their two parts and whole, m."""
        return {
            "ew_distance": float(np.sqrt(self.from_distance[0, 0])),
            "ew_height": float(np.sqrt(self.from_height[0, 0])),
            "ew": float(np.sqrt(self.cov_enu[0, 0])),
            "ns_distance": float(np.sqrt(self.from_distance[1, 1])),
            "ns_height": float(np.sqrt(self.from_height[1, 1])),
            "ns": float(np.sqrt(self.cov_enu[1, 1])),
        }


def geostationary(longitudes_deg: tuple[float, ...] = BEIDOU1_LONGITUDES_DEG) -> F8:
    """Positions (n, 3) of geostationary satellites, ECEF, m."""
    lon = np.radians(np.asarray(longitudes_deg, dtype=np.float64))
    return GEO_RADIUS_M * np.stack([np.cos(lon), np.sin(lon), np.zeros(len(lon))], axis=1)


def round_trips(pos_e: F8, sats_e: F8) -> F8:
    """Round trips (n, 2) between users (n, 3) and two satellites (2, 3), m: twice the distance."""
    return np.asarray(2.0 * np.linalg.norm(np.asarray(pos_e)[:, None, :] - sats_e, axis=2))


def solve_rdss(trips_m: F8, height_m: F8, sats_e: F8, start_deg: tuple[float, float]) -> F8:
    """Positions (n, 3), ECEF m, of round trips and heights.

    Parameters
    ----------
    trips_m : (n, 2)
        Round trips to the two satellites, m.
    height_m : (n,)
        Ellipsoidal heights, m: held exactly.
    sats_e : (2, 3)
        Satellites, ECEF, m.
    start_deg : (lat, lon)
        Rough place; thousands of km off do no harm, but its hemisphere decides between north and south.

    Returns
    -------
    (n, 3) float64
        NaN where there is no solution: distances that do not meet on the ellipsoid, or within some km of the equator.

    Raises
    ------
    StarwiseError
        A start on the equator, which leaves north or south open.
    """
    if start_deg[0] == 0.0:
        raise StarwiseError("north or south?", found="start on the equator", wanted="a latitude with its sign")
    h = np.ascontiguousarray(height_m, dtype=np.float64)
    found, iterations = np.empty((len(h), 2)), np.empty(len(h), dtype=np.int64)
    fix_many(np.ascontiguousarray(trips_m, dtype=np.float64), h, sats_e, np.radians(start_deg), found, iterations)
    return ecef_from_geodetic(np.column_stack([found, h]))


def rdss_geometry(pos_e: F8, sats_e: F8, noise: RdssNoise | None = None) -> RdssGeometry:
    """Covariance of a fix by its geometry, in the two parts of the paper's equation 4.

    The linearised fix is G dx = d, with rows of G the directions from the satellites and the vertical: dx = G^-1 d.

    Parameters
    ----------
    pos_e : (3,), sats_e : (2, 3)
        User and satellites, ECEF, m.
    noise : RdssNoise, optional

    Raises
    ------
    StarwiseError
        No geometry: a user in the plane of the satellites (the equator).
    """
    noise = noise or RdssNoise()
    A = _inverse(np.asarray(pos_e)[None], sats_e)[0]
    return RdssGeometry(noise.distance_m**2 * A[:, :2] @ A[:, :2].T, noise.height_m**2 * A[:, 2:] @ A[:, 2:].T)


def rdss_covariances(pos_e: F8, sats_e: F8, noise: RdssNoise | None = None) -> F8:
    """Covariances of fixes at many places, east, north, up, (n, 3, 3), m^2; see `rdss_geometry`."""
    noise = noise or RdssNoise()
    A = _inverse(np.asarray(pos_e), sats_e)
    variances = np.array([noise.distance_m**2, noise.distance_m**2, noise.height_m**2])
    return np.asarray((A * variances) @ A.transpose(0, 2, 1))


def _inverse(pos_e: F8, sats_e: F8) -> F8:
    """G^-1 (n, 3, 3), east, north, up, of users (n, 3)."""
    llh = geodetic_from_ecef(pos_e)
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])
    away = (pos_e[:, None, :] - sats_e) @ C.transpose(0, 2, 1)
    G = np.zeros((len(pos_e), 3, 3))
    G[:, :2] = away / np.linalg.norm(away, axis=2, keepdims=True)
    G[:, 2, 2] = 1.0
    flat = np.abs(np.linalg.det(G)) < 1e-4
    if flat.any():
        lat = float(np.degrees(llh[flat, 0][0]))
        raise StarwiseError("no position from these satellites", found=f"latitude {lat:.3f} deg")
    return np.asarray(np.linalg.inv(G), dtype=np.float64)


@dataclass(frozen=True)
class RdssProtocol:
    """When requests go out and answers come in.

    A command beforehand starts the receiver (pre-request); the first request follows one latency later, and every
    answer is at once followed by the next request. So fixes are as far apart as they are late.

    Attributes
    ----------
    pre_request_s : float
        When the pre-request is given.
    latency_s : float
        From request to answer: four trips to the geostationary orbit, 0.5 s, and what the ground station needs.
    jitter_s : float
        Standard deviation of the latency; it never falls below the flight time.
    """

    pre_request_s: float = 0.0
    latency_s: float = 1.5
    jitter_s: float = 0.0

    FLIGHT_S: ClassVar[float] = 0.5

    def schedule(self, duration_s: float, rng: np.random.Generator | None = None) -> tuple[F8, F8]:
        """Times of requests, which the fixes are valid for, and of their answers, s, until ``duration_s``.

        Raises
        ------
        StarwiseError
            A latency below the flight time of the signals; jitter without random numbers.
        """
        if self.latency_s < self.FLIGHT_S:
            raise StarwiseError(
                "latency shorter than light takes", found=f"{self.latency_s} s", wanted=f"at least {self.FLIGHT_S} s"
            )
        if self.jitter_s > 0.0 and rng is None:
            raise StarwiseError("jitter needs random numbers", found=f"{self.jitter_s} s")
        asked: list[float] = []
        answered: list[float] = []
        t = self.pre_request_s + self.latency_s
        while True:
            late = self.latency_s
            if rng is not None and self.jitter_s > 0.0:
                late = max(self.FLIGHT_S, late + self.jitter_s * float(rng.standard_normal()))
            if t + late > duration_s:
                return np.array(asked), np.array(answered)
            asked.append(t)
            answered.append(t + late)
            t += late


def rdss_fixes(
    pos_e: F8, t_ns: I8, available_ns: I8, rng: np.random.Generator, noise: RdssNoise | None = None,
    sats_e: F8 | None = None,
) -> Fixes:  # fmt: skip
    """Simulated fixes: round trips and heights with errors, solved, with their covariance.

    Parameters
    ----------
    pos_e : (n, 3)
        True positions at the requests, ECEF, m.
    t_ns, available_ns : (n,) int64
        Times of requests and answers, GPST ns.
    rng : numpy.random.Generator
    noise : RdssNoise, optional
    sats_e : (2, 3), optional
        Default: the satellites of BeiDou-1.

    Raises
    ------
    StarwiseError
        As `rdss_geometry`.
    """
    noise = noise or RdssNoise()
    sats = geostationary() if sats_e is None else sats_e
    n = len(pos_e)
    llh = geodetic_from_ecef(pos_e)
    trips = round_trips(pos_e, sats) + 2.0 * noise.distance_m * rng.standard_normal((n, 2))
    h = llh[:, 2] + noise.height_m * rng.standard_normal(n)
    lat0, lon0 = np.degrees(llh[0, :2]) if n else (30.0, 110.0)
    found = solve_rdss(trips, h, sats, (float(lat0), float(lon0)))
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])
    cov = C.transpose(0, 2, 1) @ rdss_covariances(pos_e, sats, noise) @ C
    return Fixes(t_ns, available_ns, found, cov, source="BeiDou-1 RDSS, simulated")


def latency_ns(seconds: F8, start_ns: int) -> I8:
    """Times of a schedule as GPST, ns."""
    return start_ns + np.rint(np.asarray(seconds) * NS).astype(np.int64)
