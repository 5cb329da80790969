"""A plane in which a straight flight is straight: fixes unrolled along the curved Earth.

Constant velocity is not straight in ECEF (0.014 m/s^2 at 300 m/s), nor in metres of longitude and latitude (0.009 m/s^2
eastwards at 32 N), and a filter of 100 s of memory is off by tens of metres for it. Here displacements from epoch to
epoch are measured with the Earth's radii of curvature where they happen, in axes east', north', up that are carried
along parallel to themselves (wander azimuth): a geodesic flown at constant speed and climb is a straight line.

    north' + i east' turned against north + i east by alpha,   d alpha = sin(lat) d lon
    ds = (R_N + h) cos(lat) d lon east + (R_M + h) d lat north + d h up

Sources: Groves (2013) 2.4.2 (radii of curvature), 5.3.5 (wander azimuth).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from starwise.constants import WGS84_A, WGS84_E2
from starwise.frames import geodetic_from_ecef, rotations_ne_enu
from starwise.types import F8


@dataclass(frozen=True)
class Plane:
    """Points along a path and the same unrolled.

    Attributes
    ----------
    base_e : (n, 3) float64
        Points, ECEF, m: any within some kilometres of the path.
    s : (n, 3) float64
        The same in the plane: east', north', up, m, from the first.
    C_se : (n, 3, 3) float64
        Rotation from ECEF to the plane's axes at each point.
    """

    base_e: F8
    s: F8
    C_se: F8

    def from_ecef(self, pos_e: F8) -> F8:
        """Coordinates in the plane of positions (n, 3) or (n, m, 3), ECEF m, near the points."""
        d = pos_e - (self.base_e if pos_e.ndim == 2 else self.base_e[:, None])
        if pos_e.ndim == 2:
            return np.asarray(self.s + np.einsum("nij,nj->ni", self.C_se, d))
        return np.asarray(self.s[:, None] + np.einsum("nij,nkj->nki", self.C_se, d))

    def to_ecef(self, s: F8) -> F8:
        """ECEF positions, m, of coordinates (n, 3) in the plane."""
        return np.asarray(self.base_e + np.einsum("nji,nj->ni", self.C_se, s - self.s))

    def rotated_from_ecef(self, vectors: F8) -> F8:
        """Vectors (n, 3) in the plane's axes."""
        return np.asarray(np.einsum("nij,nj->ni", self.C_se, vectors))

    def rotated_to_ecef(self, vectors: F8) -> F8:
        """Vectors (n, 3) of the plane in ECEF."""
        return np.asarray(np.einsum("nji,nj->ni", self.C_se, vectors))

    def cov_from_ecef(self, cov: F8) -> F8:
        """Covariances (n, ..., 3, 3) in the plane's axes."""
        C = self.C_se.reshape(len(self.C_se), *(1,) * (cov.ndim - 3), 3, 3)
        return np.asarray(C @ cov @ np.swapaxes(C, -1, -2))

    def cov_to_ecef(self, cov: F8) -> F8:
        """Covariances (n, 3, 3) of the plane in ECEF."""
        return np.asarray(self.C_se.transpose(0, 2, 1) @ cov @ self.C_se)


def unroll(base_e: F8) -> Plane:
    """Plane along points (n, 3), ECEF m, in order of time.

    Noise of the points does not matter: it is in ``s`` as it is in ``base_e``, and cancels in `Plane.from_ecef`.
    """
    llh = geodetic_from_ecef(base_e)
    lat, lon, h = llh[:, 0], llh[:, 1], llh[:, 2]
    dlon = np.remainder(np.diff(lon) + np.pi, 2.0 * np.pi) - np.pi
    mid_lat, mid_h = 0.5 * (lat[1:] + lat[:-1]), 0.5 * (h[1:] + h[:-1])
    w2 = 1.0 - WGS84_E2 * np.sin(mid_lat) ** 2
    R_N = WGS84_A / np.sqrt(w2)
    R_M = R_N * (1.0 - WGS84_E2) / w2
    east, north = (R_N + mid_h) * np.cos(mid_lat) * dlon, (R_M + mid_h) * np.diff(lat)
    turn = np.sin(mid_lat) * dlon
    alpha = np.concatenate([[0.0], np.cumsum(turn)])
    mid = alpha[:-1] + 0.5 * turn
    step = np.stack(
        [east * np.cos(mid) - north * np.sin(mid), north * np.cos(mid) + east * np.sin(mid), np.diff(h)], axis=1
    )
    s = np.vstack([np.zeros(3), np.cumsum(step, axis=0)])
    return Plane(np.asarray(base_e, dtype=np.float64), s, _turned(rotations_ne_enu(lat, lon), alpha))


def _turned(C: F8, alpha: NDArray[np.float64]) -> F8:
    """Rotations (n, 3, 3) to east-north-up, turned to the plane's axes."""
    c, s = np.cos(alpha)[:, None], np.sin(alpha)[:, None]
    return np.stack([c * C[:, 0] - s * C[:, 1], c * C[:, 1] + s * C[:, 0], C[:, 2]], axis=1)
