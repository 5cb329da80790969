"""True trajectory of a vehicle: position, velocity, acceleration, attitude and angular rate at any time.

Built from segments (`from_segments`) or from a recorded path (`from_points`); see `starwise.sim.path` for the
kinematics. Body frame: forward, right, down; its origin is where the IMU is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.frames import C_ne_enu, ecef_from_geodetic, geodetic_from_ecef, rotations_ne_enu
from starwise.physics.earth import OMEGA_IE, gravity_e
from starwise.sim.flight import MARGIN_S, fly
from starwise.sim.path import F8, Piece, Points, Pose, RecordedPiece, cross
from starwise.sim.sections import Vehicle
from starwise.sim.segments import Segment

I8 = NDArray[np.int64]
OMEGA_IE_E = np.array([0.0, 0.0, OMEGA_IE])


@dataclass(frozen=True)
class TrajectoryStates:
    """Truth at n times.

    Attributes
    ----------
    t_ns : (n,) int64
        GPST, ns.
    pos_e, vel_e, acc_e : (n, 3) float64
        Position of the body's origin in ECEF and its first and second derivative *in ECEF*, m, m/s, m/s^2.
    C_eb : (n, 3, 3) float64
        Rotation from body (forward, right, down) to ECEF.
    omega_eb_b, omega_ib_b : (n, 3) float64
        Angular rate of the body against the Earth and against inertial space, body axes, rad/s.
    """

    t_ns: I8
    pos_e: F8
    vel_e: F8
    acc_e: F8
    C_eb: F8
    omega_eb_b: F8
    omega_ib_b: F8

    @cached_property
    def llh(self) -> F8:
        """Latitude, longitude (rad) and ellipsoidal height (m), (n, 3)."""
        return geodetic_from_ecef(self.pos_e)

    @cached_property
    def C_eb_ned(self) -> F8:
        """Rotation (n, 3, 3) from body to local north-east-down."""
        enu = rotations_ne_enu(self.llh[:, 0], self.llh[:, 1])
        ned = np.stack([enu[:, 1], enu[:, 0], -enu[:, 2]], axis=1)
        return np.asarray(ned @ self.C_eb)

    @property
    def vel_ned(self) -> F8:
        """Velocity, local north-east-down, m/s (n, 3)."""
        enu = np.einsum("nij,nj->ni", rotations_ne_enu(self.llh[:, 0], self.llh[:, 1]), self.vel_e)
        return np.stack([enu[:, 1], enu[:, 0], -enu[:, 2]], axis=1)

    @property
    def euler(self) -> F8:
        """Roll, pitch, yaw (heading of the nose, 0..2 pi) against north-east-down, rad (n, 3). Groves (2.23)."""
        C = self.C_eb_ned
        roll = np.arctan2(C[:, 2, 1], C[:, 2, 2])
        pitch = np.arcsin(np.clip(-C[:, 2, 0], -1.0, 1.0))
        return np.stack([roll, pitch, np.mod(np.arctan2(C[:, 1, 0], C[:, 0, 0]), 2.0 * np.pi)], axis=1)

    @property
    def q_eb(self) -> F8:
        """Quaternion from body to ECEF, scalar first and not negative, (n, 4)."""
        from scipy.spatial.transform import Rotation

        q = Rotation.from_matrix(self.C_eb).as_quat()[:, [3, 0, 1, 2]]
        return np.asarray(np.where(q[:, :1] < 0.0, -q, q), dtype=np.float64)

    @property
    def f_ib_b(self) -> F8:
        """Specific force, body axes, m/s^2 (n, 3): what perfect accelerometers at the origin feel. Groves (5.36)."""
        f_e = self.acc_e + 2.0 * cross(OMEGA_IE_E[None], self.vel_e) - gravity_e(self.pos_e)
        return np.asarray(np.einsum("nji,nj->ni", self.C_eb, f_e))

    def at_lever_arm(self, lever_b: ArrayLike) -> tuple[F8, F8]:
        """Position and velocity (m, m/s, ECEF) of a point fixed in the body at ``lever_b`` (3,), m."""
        lever = np.asarray(lever_b, dtype=np.float64)
        pos = self.pos_e + self.C_eb @ lever
        vel = self.vel_e + np.einsum("nij,nj->ni", self.C_eb, cross(self.omega_eb_b, lever[None]))
        return pos, vel


@dataclass(frozen=True)
class Jump:
    """An instant at which the attitude jumps: no gyroscope can follow."""

    t_s: float
    angle_rad: float


class Trajectory:
    """A path over time, evaluated anywhere.

    Law: position, velocity and acceleration are derivatives of each other, attitude and angular rate likewise;
    position and velocity are continuous throughout, and acceleration within a piece.

    Parameters
    ----------
    pieces : sequence of Piece
        In order of time, each starting where the one before ended; times in s since ``t0_ns``.
    t0_ns : int
        GPST ns of time 0.
    """

    def __init__(self, pieces: Sequence[Piece], t0_ns: int) -> None:
        self._pieces = tuple(pieces)
        self.t0_ns = t0_ns
        self._starts = np.array([piece.t_s for piece in pieces])
        self.begin_s = float(self._starts[0])
        self.end_s = pieces[-1].t_s + pieces[-1].duration_s

    @property
    def t_span_ns(self) -> tuple[int, int]:
        """First and last time at which there is a trajectory, GPST ns."""
        return self.t0_ns + round(self.begin_s * NS), self.t0_ns + round(self.end_s * NS)

    @cached_property
    def knots_s(self) -> F8:
        """Times, s since ``t0_ns``, between which everything is smooth, both ends included."""
        inner = [np.concatenate([[piece.t_s], piece.knots]) for piece in self._pieces]
        return np.concatenate([*inner, [self.end_s]])

    @cached_property
    def jumps(self) -> tuple[Jump, ...]:
        """Instants at which the attitude jumps by more than 1e-6 rad."""
        found = []
        for before, after, t in zip(self._pieces, self._pieces[1:], self._starts[1:], strict=False):
            at = np.array([t])
            C = [_attitude(piece.at(at))[0] for piece in (before, after)]
            chord = float(np.linalg.norm(C[0] - C[1])) / np.sqrt(2.0)  # 2 sin(angle / 2)
            if chord > 1e-6:
                found.append(Jump(float(t), float(2.0 * np.arcsin(min(1.0, 0.5 * chord)))))
        return tuple(found)

    def states(self, t_ns: ArrayLike) -> TrajectoryStates:
        """Truth at times.

        Parameters
        ----------
        t_ns : (n,) int64 array_like
            GPST, ns, in any order. Where two segments meet, the later one's acceleration is given.

        Raises
        ------
        StarwiseError
            A time outside the trajectory (which reaches 1 s beyond the scenario at both ends).
        """
        t = np.atleast_1d(np.asarray(t_ns, dtype=np.int64))
        return self._states(t, np.asarray((t - self.t0_ns) * 1e-9, dtype=np.float64))

    def states_s(self, t_s: F8) -> TrajectoryStates:
        """Truth at times in s since ``t0_ns`` (float64, for quadrature)."""
        return self._states(self.t0_ns + np.rint(t_s * NS).astype(np.int64), t_s)

    def _states(self, t_ns: I8, t_s: F8) -> TrajectoryStates:
        if len(t_s) and (t_s.min() < self.begin_s - 1e-9 or t_s.max() > self.end_s + 1e-9):
            outside = t_s.min() if t_s.min() < self.begin_s else t_s.max()
            raise StarwiseError(
                "no trajectory at this time",
                found=f"{outside:.3f} s",
                wanted=f"{self.begin_s:g} to {self.end_s:g} s from its start",
            )
        points = self._points(t_s)
        C_eb = _attitude(points)
        omega_eb_b = _body_rate(points, C_eb)
        omega_ib_b = omega_eb_b + OMEGA_IE * C_eb[:, 2, :]
        return TrajectoryStates(t_ns, points.pos_e, points.vel_e, points.acc_e, C_eb, omega_eb_b, omega_ib_b)

    def _points(self, t_s: F8) -> Points:
        which = np.clip(np.searchsorted(self._starts, t_s, side="right") - 1, 0, len(self._pieces) - 1)
        present = np.unique(which)
        if len(present) == 1:
            return self._pieces[int(present[0])].at(t_s)
        columns = {name: np.empty((len(t_s), size)) for name, size in _COLUMNS.items()}
        for k in present:
            rows = np.nonzero(which == k)[0]
            points = self._pieces[int(k)].at(t_s[rows])
            for name, column in columns.items():
                column[rows] = getattr(points, name)
        return Points(**columns)


_COLUMNS = {
    "pos_e": 3, "vel_e": 3, "acc_e": 3, "u": 3, "f": 3, "pitch": 1, "pitch_rate": 1, "omega_ep": 3, "bank": 1,
    "bank_rate": 1,
}  # fmt: skip


def _attitude(p: Points) -> F8:
    """C_eb: nose along the path, right wing down by the bank."""
    cg, sg, cb, sb = np.cos(p.pitch), np.sin(p.pitch), np.cos(p.bank), np.sin(p.bank)
    right = cross(p.f, p.u)
    below = p.f * sg - p.u * cg  # down in the path's vertical plane
    return np.stack([p.f * cg + p.u * sg, right * cb + below * sb, below * cb - right * sb], axis=2)


def _body_rate(p: Points, C_eb: F8) -> F8:
    """omega_eb_b: the path's level frame turns, the path pitches about its right, the body banks about its nose."""
    omega_e = p.omega_ep + p.pitch_rate * cross(p.f, p.u) + p.bank_rate * C_eb[:, :, 0]
    return np.asarray(np.einsum("nji,nj->ni", C_eb, omega_e))


def from_segments(vehicle: Vehicle, t0_ns: int, duration_s: float) -> Trajectory:
    """Trajectory of a vehicle's segments from time ``t0_ns`` (GPST ns) on, for at least ``duration_s``.

    Raises
    ------
    StarwiseError
        A segment that cannot be flown from where it starts; segments that end before the duration.
    """
    lat, lon = np.radians(vehicle.start[:2])
    llh = np.array([lat, lon, vehicle.start[2]])
    east, north, up = C_ne_enu(float(lat), float(lon))
    heading = np.radians(vehicle.heading_deg)
    pose = Pose(
        pos_e=ecef_from_geodetic(llh),
        u=up,
        f=north * np.cos(heading) + east * np.sin(heading),
        height_m=vehicle.start[2],
        speed_mps=vehicle.speed_mps,
        pitch=float(np.radians(vehicle.pitch_deg)),
    )
    segments: tuple[Segment, ...] = vehicle.segments
    return Trajectory(fly(pose, segments, duration_s, banked=vehicle.kind == "aircraft"), t0_ns)


def from_points(
    t_ns: ArrayLike, llh: ArrayLike, euler: ArrayLike | None = None, t0_ns: int | None = None
) -> Trajectory:
    """Trajectory through recorded points, flown again (cubic splines through positions and attitude angles).

    Parameters
    ----------
    t_ns : (n,) int64 array_like
        GPST, ns, strictly increasing, at least 4.
    llh : (n, 3) array_like
        Latitude, longitude (rad), ellipsoidal height (m).
    euler : (n, 3) array_like, optional
        Roll, pitch, heading, rad. Without it the nose follows the path where that moves by more than 0.5 m/s, and
        is interpolated across halts; roll is zero.
    t0_ns : int, optional
        Time from which the trajectory counts its seconds; the first point's.

    Raises
    ------
    StarwiseError
        Too few points, times that do not increase, or values that are not finite.
    """
    from scipy.interpolate import CubicSpline

    t = np.asarray(t_ns, dtype=np.int64)
    points = np.asarray(llh, dtype=np.float64)
    if len(t) < 4 or points.shape != (len(t), 3) or (np.diff(t) <= 0).any() or not np.isfinite(points).all():
        raise StarwiseError(
            "recorded trajectory cannot be flown",
            found=f"{len(t)} times, points {points.shape}",
            wanted="at least 4 points (finite) at increasing times",
        )
    t_s = (t - (t[0] if t0_ns is None else t0_ns)) * 1e-9
    pos = ecef_from_geodetic(points)
    spline = CubicSpline(t_s, pos - pos[0])
    if euler is None:
        angles = _angles_along(points, np.asarray(spline(t_s, 1)))
    else:
        given = np.asarray(euler, dtype=np.float64)
        if given.shape != points.shape or not np.isfinite(given).all():
            raise StarwiseError("recorded attitude does not fit", found=str(given.shape), wanted=str(points.shape))
        angles = np.unwrap(given[:, ::-1], axis=0)
    piece = RecordedPiece(spline, CubicSpline(t_s, angles), pos[0], margin_s=MARGIN_S)
    return Trajectory([piece], int(t[0]) if t0_ns is None else t0_ns)


def _angles_along(llh: F8, vel_e: F8, least_mps: float = 0.5) -> F8:
    """Heading, pitch, roll (n, 3) of a nose along the velocity, bridged where it hardly moves."""
    enu = np.einsum("nij,nj->ni", rotations_ne_enu(llh[:, 0], llh[:, 1]), vel_e)
    moving = np.nonzero(np.hypot(enu[:, 0], enu[:, 1]) > least_mps)[0]
    angles = np.zeros((len(llh), 3))
    if len(moving):
        heading = np.unwrap(np.arctan2(enu[moving, 0], enu[moving, 1]))
        pitch = np.arctan2(enu[moving, 2], np.hypot(enu[moving, 0], enu[moving, 1]))
        rows = np.arange(len(llh))
        angles[:, 0] = np.interp(rows, moving, heading)
        angles[:, 1] = np.interp(rows, moving, pitch)
    return angles


def read_recorded(path: str | Path, t0_ns: int) -> Trajectory:
    """Trajectory of a CSV file with columns t_s, lat_deg, lon_deg, height_m [, heading_deg, pitch_deg, roll_deg].

    Parameters
    ----------
    path : path-like
        The file; times count from the scenario's start.
    t0_ns : int
        GPST, ns, of the scenario's start.
    """
    file = Path(path)
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise StarwiseError(f"cannot be read ({error.__class__.__name__})", file=file) from None
    names = [name.strip() for name in lines[0].split(",")] if lines else []
    needed = ["t_s", "lat_deg", "lon_deg", "height_m"]
    optional = ["roll_deg", "pitch_deg", "heading_deg"]
    missing = [name for name in needed if name not in names]
    some = [name for name in optional if name in names]
    if missing or (some and len(some) < len(optional)):
        wanted = ",".join(needed) + " and all or none of " + ",".join(optional)
        raise StarwiseError("columns are missing", file=file, line=1, found=lines[0] if lines else "", wanted=wanted)
    rows = []
    for number, line in enumerate(lines[1:], 2):
        if line.strip():
            try:
                rows.append([float(text) for text in line.split(",")])
            except ValueError:
                raise StarwiseError("not numbers", file=file, line=number, found=line) from None
            if len(rows[-1]) != len(names):
                raise StarwiseError("wrong number of columns", file=file, line=number, found=line)
    table = np.array(rows).reshape(-1, len(names))
    column = {name: table[:, k] for k, name in enumerate(names)}
    t = np.rint(column["t_s"] * NS).astype(np.int64) + t0_ns
    llh = np.stack([np.radians(column["lat_deg"]), np.radians(column["lon_deg"]), column["height_m"]], axis=1)
    euler = np.stack([np.radians(column[name]) for name in optional], axis=1) if some else None
    try:
        recorded = from_points(t, llh, euler, t0_ns)
    except StarwiseError as error:
        raise StarwiseError(error.message, file=file, found=error.found, wanted=error.wanted) from None
    return recorded
