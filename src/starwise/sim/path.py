"""Pieces of a path: exact kinematics of a point and its direction over the curved Earth.

A *law* piece prescribes speed v(t), pitch gamma(t) of the path above the local horizon and course psi(t), measured
from a direction w that is carried parallel along the surface of constant height, so that psi = const is a geodesic.
With u the ellipsoid's normal, f = w cos(psi) + (w x u) sin(psi) the horizontal direction of motion::

    d pos / dt = v (f cos(gamma) + u sin(gamma))          d h / dt = v sin(gamma)
    d u / dt   = curvature of the surface (R_M + h, R_N + h) along f, times v cos(gamma)
    d w / dt   = -(w . du/dt) u

u, w, h and pos are integrated by Picard iteration on Chebyshev nodes: converged to the last bit, because their right
hand sides depend on the unknowns only through the Earth's curvature (1e-4 rad/s at most). Velocity, acceleration,
attitude and angular rate are closed formulas of them: mutually consistent by construction. Nothing is singular at
the poles. A *spline* piece has its position given; the same quantities follow from its derivatives.
"""

import itertools
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from starwise.constants import WGS84_A, WGS84_E2
from starwise.frames import geodetic_from_ecef
from starwise.physics.earth import STANDARD_GRAVITY

F8 = NDArray[np.float64]
K = 16
"""Chebyshev nodes in a panel."""
PANEL_RAD = 1.5
"""Most that a panel may turn; 16 nodes resolve it to 1e-17."""
PANEL_S = 60.0
"""Longest panel, s."""


def _matrices() -> tuple[F8, F8, F8]:
    x: F8 = np.cos(np.pi * (np.arange(K, dtype=np.float64) + 0.5) / K)
    to_coef = np.asarray(np.linalg.inv(chebyshev.chebvander(x, K - 1)), dtype=np.float64)
    integral: F8 = np.array([chebyshev.chebint(row, lbnd=-1.0) for row in np.eye(K)]).T  # (K + 1, K)
    return x, to_coef, integral


NODES, TO_COEF, INTEGRAL = _matrices()
"""Chebyshev points of the first kind; values at them to coefficients; coefficients to those of the integral from -1."""
_TO_INTEGRAL = chebyshev.chebvander(NODES, K) @ INTEGRAL @ TO_COEF


def dot(a: F8, b: F8) -> F8:
    """Scalar products of (n, 3) rows, as a column (n, 1)."""
    return np.asarray(np.einsum("ij,ij->i", a, b)[:, None])


def cross(a: F8, b: F8) -> F8:
    """Vector products of (n, 3) rows."""
    c = np.empty(np.broadcast_shapes(a.shape, b.shape))
    c[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    c[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    c[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return c


def normal_rate(u: F8, h: F8, vel_h: F8) -> F8:
    """Rate of the ellipsoid's normal, 1/s (n, 3), for normals u, heights h (n, 1) and horizontal velocities, ECEF.

    The prime vertical curvature everywhere plus the excess of the meridian's along north (zero at the poles).
    """
    s = u[:, 2:3]
    w2 = 1.0 - WGS84_E2 * s * s
    R_N = WGS84_A / np.sqrt(w2)
    R_M = R_N * (1.0 - WGS84_E2) / w2
    north_cos = -u * s  # cos(lat) times the unit vector to the north
    north_cos[:, 2] += 1.0
    excess = R_N * WGS84_E2 / w2 / ((R_M + h) * (R_N + h))
    return np.asarray(vel_h / (R_N + h) + excess * dot(vel_h, north_cos) * north_cos)


def position(u: F8, h: float) -> F8:
    """ECEF position (3,) at height h above the point with ellipsoid normal u."""
    R_N = WGS84_A / np.sqrt(1.0 - WGS84_E2 * u[2] * u[2])
    return np.asarray(u * [R_N + h, R_N + h, R_N * (1.0 - WGS84_E2) + h])


@dataclass(frozen=True)
class Pose:
    """Where a piece ends and the next begins: everything that must be continuous."""

    pos_e: F8
    u: F8
    """Normal of the ellipsoid, ECEF."""
    f: F8
    """Horizontal direction of motion (kept at rest), ECEF unit vector."""
    height_m: float
    speed_mps: float
    pitch: float
    """Of the path above the horizon, rad."""


@dataclass(frozen=True)
class Points:
    """Kinematics at n times; vectors (n, 3) ECEF, scalars (n, 1)."""

    pos_e: F8
    vel_e: F8
    acc_e: F8
    u: F8
    f: F8
    pitch: F8
    pitch_rate: F8
    omega_ep: F8
    """Rate of the path's level frame (f, right, down) against the Earth, rad/s."""
    bank: F8
    bank_rate: F8


class Piece(Protocol):
    """A stretch of path over [t_s, t_s + duration_s], extrapolated smoothly outside."""

    t_s: float
    duration_s: float
    knots: F8
    """Times at which some derivative of its quantities may jump, ends excluded, s."""

    def at(self, t: F8) -> Points:
        """Kinematics at times, s."""
        ...


@dataclass(frozen=True)
class Law:
    """Speed (m/s), pitch and course (rad) as polynomials of s = (t - t_s) / duration_s, ascending coefficients."""

    t_s: float
    duration_s: float
    speed: tuple[float, ...]
    pitch: tuple[float, ...] = (0.0,)
    course: tuple[float, ...] = (0.0,)

    def values(self, coef: tuple[float, ...], t: F8, order: int = 0) -> F8:
        """A polynomial or its time derivative at times t, (n, 1)."""
        s = (np.asarray(t) - self.t_s) / self.duration_s
        c = np.polynomial.polynomial.polyder(coef, order) if order else np.asarray(coef)
        return np.asarray(np.polynomial.polynomial.polyval(s, c) / self.duration_s**order)[:, None]

    def end(self, coef: tuple[float, ...]) -> float:
        """Value of a polynomial at the end."""
        return float(sum(coef))


@dataclass(frozen=True)
class _Panel:
    t_a: float
    t_b: float
    uw: F8
    """Chebyshev coefficients of u and w, (K, 6)."""
    ph: F8
    """Of the position since the panel's start and of the height, (K + 1, 4)."""
    pos_e: F8


class LawPiece:
    """A law flown from a pose.

    Parameters
    ----------
    start : Pose
    law : Law
    banked : bool
        Bank by ``atan(v cos(gamma) psi' / g)``, as in a coordinated level turn.
    backwards : bool
        The law is flown back in time from the pose, for its duration.
    """

    def __init__(self, start: Pose, law: Law, *, banked: bool = False, backwards: bool = False) -> None:
        self.law, self.banked = law, banked
        self.duration_s = law.duration_s
        self.t_s = law.t_s - (law.duration_s if backwards else 0.0)
        self.knots = np.zeros(0)
        coarse = law.t_s + np.linspace(0.0, 1.0, 65) * law.duration_s
        turned = sum(np.abs(np.diff(law.values(coef, coarse), axis=0)).sum() for coef in (law.pitch, law.course))
        n = int(np.ceil(max(turned / PANEL_RAD, law.duration_s / PANEL_S, 1.0)))
        edges = law.t_s + np.linspace(0.0, -1.0 if backwards else 1.0, n + 1) * law.duration_s
        self._panels: list[_Panel] = []
        u, w, h, pos = start.u, start.f, start.height_m, start.pos_e
        for a, b in itertools.pairwise(edges):
            panel = _fly(law, float(a), float(b), u, w, h, pos)
            self._panels.append(panel)
            uw, ph = panel.uw.sum(axis=0), panel.ph.sum(axis=0)  # Chebyshev polynomials are 1 at the end
            u, w = _orthonormal(uw[:3], uw[3:])
            h, pos = float(ph[3]), pos + ph[:3]
        course = law.end(law.course)
        f = w * np.cos(course) + np.cross(w, u) * np.sin(course)
        self.end = Pose(pos, u, f, h, law.end(law.speed), law.end(law.pitch))
        self._edges = np.sort(edges)
        if backwards:
            self._panels.reverse()

    def at(self, t: F8) -> Points:
        """Kinematics at times, s."""
        law = self.law
        uw, ph = np.empty((len(t), 6)), np.empty((len(t), 4))
        which = np.clip(np.searchsorted(self._edges, t, side="right") - 1, 0, len(self._panels) - 1)
        for k in np.unique(which):
            rows = np.nonzero(which == k)[0]
            panel = self._panels[k]
            x = 2.0 * (t[rows] - panel.t_a) / (panel.t_b - panel.t_a) - 1.0
            basis = chebyshev.chebvander(x, K)
            uw[rows] = basis[:, :K] @ panel.uw
            ph[rows] = basis @ panel.ph
            ph[rows, :3] += panel.pos_e
        u, w, h = uw[:, :3], uw[:, 3:], ph[:, 3:4]
        v, v1 = law.values(law.speed, t), law.values(law.speed, t, 1)
        g, g1 = law.values(law.pitch, t), law.values(law.pitch, t, 1)
        psi, psi1 = law.values(law.course, t), law.values(law.course, t, 1)
        cg, sg = np.cos(g), np.sin(g)
        f = w * np.cos(psi) + cross(w, u) * np.sin(psi)
        along = f * cg + u * sg
        omega_ep = cross(u, normal_rate(u, h, v * cg * f)) - psi1 * u
        omega_ev = omega_ep + g1 * cross(f, u)  # right = f x u
        acc_e = v1 * along + v * cross(omega_ev, along)
        bank = bank_rate = np.zeros_like(v)
        if self.banked:
            side = v * cg * psi1 / STANDARD_GRAVITY
            side1 = (v1 * cg - v * sg * g1) * psi1 + v * cg * law.values(law.course, t, 2)
            bank, bank_rate = np.arctan(side), side1 / STANDARD_GRAVITY / (1.0 + side * side)
        return Points(ph[:, :3], v * along, acc_e, u, f, g, g1, omega_ep, bank, bank_rate)


def _orthonormal(u: F8, w: F8) -> tuple[F8, F8]:
    u = u / np.sqrt(u @ u)
    w = w - (w @ u) * u
    return u, w / np.sqrt(w @ w)


def _fly(law: Law, a: float, b: float, u0: F8, w0: F8, h0: float, pos0: F8) -> _Panel:
    """One panel of a law by Picard iteration."""
    half = 0.5 * (b - a)
    t = a + half * (NODES + 1.0)
    v, g, psi = law.values(law.speed, t), law.values(law.pitch, t), law.values(law.course, t)
    up, ahead = v * np.sin(g), v * np.cos(g)
    c, s = np.cos(psi), np.sin(psi)
    h = h0 + half * _TO_INTEGRAL @ up
    u, w = np.broadcast_to(u0, (K, 3)), np.broadcast_to(w0, (K, 3))
    for _ in range(30):
        vel_h = ahead * (w * c + cross(w, u) * s)
        u_dot = normal_rate(u, h, vel_h)
        w_dot = -dot(w, u_dot) * u
        u_new = u0 + half * _TO_INTEGRAL @ u_dot
        w_new = w0 + half * _TO_INTEGRAL @ w_dot
        change = max(np.abs(u_new - u).max(), np.abs(w_new - w).max())
        u, w = u_new, w_new
        if change < 1e-16:
            break
    vel = np.hstack([ahead * (w * c + cross(w, u) * s) + up * u, up])
    ph = half * INTEGRAL @ TO_COEF @ vel
    ph[0, 3] += h0
    return _Panel(a, b, TO_COEF @ np.hstack([u, w]), ph, pos0)


class SplinePiece:
    """A path given as a piecewise polynomial position; the nose along the velocity.

    Parameters
    ----------
    spline : scipy.interpolate.PPoly
        ECEF position minus ``origin`` over absolute time in s.
    origin : (3,) ndarray
    banked : bool
    """

    def __init__(self, spline: Any, origin: F8, *, banked: bool = False) -> None:
        self._derivatives = [spline, *(spline.derivative(k) for k in (1, 2, 3))]
        self._origin, self.banked = origin, banked
        self.t_s, self.duration_s = float(spline.x[0]), float(spline.x[-1] - spline.x[0])
        self.knots = np.asarray(spline.x[1:-1], dtype=np.float64)
        end = self.at(np.array([spline.x[-1]]))
        llh = geodetic_from_ecef(end.pos_e[0])
        speed = float(np.linalg.norm(end.vel_e[0]))
        self.end = Pose(end.pos_e[0], end.u[0], end.f[0], float(llh[2]), speed, float(end.pitch[0, 0]))

    def at(self, t: F8) -> Points:
        """Kinematics at times, s."""
        pos, vel, acc, jerk = (np.asarray(d(t)) for d in self._derivatives)
        pos = pos + self._origin
        u, _, u_dot = level_frame(pos, vel)
        up, up1 = dot(vel, u), dot(acc, u) + dot(vel, u_dot)
        vel_h = vel - up * u
        acc_h = acc - up1 * u - up * u_dot  # rate of vel_h
        ahead = np.sqrt(dot(vel_h, vel_h))
        f = vel_h / ahead
        right = cross(f, u)
        ahead1 = dot(f, acc_h)
        course1 = dot(right, acc_h) / ahead
        omega_ep = cross(u, u_dot) - course1 * u
        v2 = ahead * ahead + up * up
        pitch, pitch_rate = np.arctan2(up, ahead), (up1 * ahead - up * ahead1) / v2
        bank = bank_rate = np.zeros_like(ahead)
        if self.banked:
            side = dot(acc, right) / STANDARD_GRAVITY
            side1 = (dot(jerk, right) + dot(acc, cross(omega_ep, right))) / STANDARD_GRAVITY
            bank, bank_rate = np.arctan(side), side1 / (1.0 + side * side)
        return Points(pos, vel, acc, u, f, pitch, pitch_rate, omega_ep, bank, bank_rate)


class RecordedPiece:
    """A recorded path: splines through its positions and through its attitude angles.

    Parameters
    ----------
    spline : scipy.interpolate.PPoly
        ECEF position minus ``origin`` over absolute time in s.
    angles : scipy.interpolate.PPoly
        Heading from north (unwrapped), pitch, roll, rad.
    origin : (3,) ndarray
    margin_s : float
        Time by which either end may be extrapolated.
    """

    def __init__(self, spline: Any, angles: Any, origin: F8, margin_s: float) -> None:
        self._derivatives = [spline, spline.derivative(1), spline.derivative(2)]
        self._angles = [angles, angles.derivative(1)]
        self._origin = origin
        self.t_s = float(spline.x[0]) - margin_s
        self.duration_s = float(spline.x[-1]) + margin_s - self.t_s
        self.knots = np.asarray(spline.x[1:-1], dtype=np.float64)

    def at(self, t: F8) -> Points:
        """Kinematics at times, s."""
        pos, vel, acc = (np.asarray(d(t)) for d in self._derivatives)
        pos = pos + self._origin
        u, _, u_dot = level_frame(pos, vel)
        angle, rate = (np.asarray(d(t)) for d in self._angles)
        east = np.stack([-u[:, 1], u[:, 0], np.zeros(len(t))], axis=1)
        cos_lat2 = dot(east, east)
        east = east / np.sqrt(cos_lat2)
        north = cross(u, east)
        f = north * np.cos(angle[:, :1]) + east * np.sin(angle[:, :1])
        # north-east-up turns about the normal by longitude rate times sin(latitude) besides parallel transport
        swing = dot(u_dot, east) / np.sqrt(cos_lat2) * u[:, 2:3]
        omega_ep = cross(u, u_dot) + (swing - rate[:, :1]) * u
        return Points(pos, vel, acc, u, f, angle[:, 1:2], rate[:, 1:2], omega_ep, angle[:, 2:3], rate[:, 2:3])


def level_frame(pos: F8, vel: F8) -> tuple[F8, F8, F8]:
    """Normal of the ellipsoid, height (n, 1) and rate of the normal at positions and velocities, ECEF."""
    llh = geodetic_from_ecef(pos)
    lat, lon = llh[:, 0], llh[:, 1]
    u = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
    h = llh[:, 2:3]
    return u, h, normal_rate(u, h, vel - dot(vel, u) * u)
