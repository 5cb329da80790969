"""Segments flown one after another: each is turned into pieces of path that start where the one before ended."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from starwise.errors import StarwiseError
from starwise.frames import ecef_from_geodetic, geodetic_from_ecef
from starwise.sim.path import F8, Law, LawPiece, Piece, Pose, SplinePiece
from starwise.sim.segments import Climb, Dive, Pitch, Segment, Spline, Static, Straight, Turn, Waypoints

MARGIN_S = 1.0
"""A trajectory reaches this far beyond both ends of its scenario: receiver clocks are not exact."""
LEVEL_RAD = 1e-9
MOST_STEEP = np.radians(60.0)


@dataclass
class _Flight:
    """Where the vehicle is while its segments are flown."""

    pose: Pose
    duration_s: float
    banked: bool
    t_s: float = 0.0
    number: int = 0
    count: int = 0
    pieces: list[Piece] = field(default_factory=list)

    def refuse(self, what: str, *, key: str = "", found: str | None = None, wanted: str | None = None) -> StarwiseError:
        """The error of the present segment."""
        name = f"vehicle.segments[{self.number}]" + (f".{key}" if key else "")
        return StarwiseError(f"'{name}' {what}", found=found, wanted=wanted)

    def law(self, duration_s: float, **laws: tuple[float, ...]) -> Law:
        """A law from here; what is not given stays as it is."""
        given = {"speed": (self.pose.speed_mps,), "pitch": (self.pose.pitch,), **laws}
        return Law(self.t_s, duration_s, **given)

    def add(self, law: Law) -> None:
        """Fly a law."""
        piece = LawPiece(self.pose, law, banked=self.banked)
        self.pieces.append(piece)
        self.pose = piece.end
        self.t_s += law.duration_s

    def rest_s(self) -> float:
        """Time left for a segment that lasts until the end."""
        if self.number < self.count:
            raise self.refuse("lasts until the end but is not the last", wanted="a duration_s")
        return max(self.duration_s - self.t_s, 0.0) + MARGIN_S

    def needs_speed(self) -> float:
        """Speed, which must not be zero."""
        if self.pose.speed_mps <= 0.0:
            raise self.refuse("needs speed and the vehicle stands still", wanted="a straight segment with speed_mps")
        return self.pose.speed_mps

    def needs_level(self) -> None:
        """Path that must be level."""
        if abs(self.pose.pitch) > LEVEL_RAD:
            found = f"a path pitched by {np.degrees(self.pose.pitch):.1f} deg"
            raise self.refuse("starts from level flight", found=found, wanted="a pitch segment with pitch_deg = 0")


def fly(pose: Pose, segments: Sequence[Segment], duration_s: float, *, banked: bool) -> list[Piece]:
    """Pieces of path for segments flown from a pose at time 0, from ``-MARGIN_S`` to ``duration_s + MARGIN_S``.

    Raises
    ------
    StarwiseError
        A segment that cannot be flown from where it starts; segments that end too early.
    """
    before = Law(0.0, MARGIN_S, (pose.speed_mps,), (pose.pitch,))
    flight = _Flight(pose, duration_s, banked, count=len(segments))
    flight.pieces.append(LawPiece(pose, before, banked=banked, backwards=True))
    for number, segment in enumerate(segments, 1):
        flight.number = number
        _FLOWN[type(segment)](flight, segment)
    if flight.t_s < duration_s - 1e-6:
        raise flight.refuse(
            "is the last, and the scenario is longer",
            found=f"{flight.t_s:.3f} s",
            wanted=f"{duration_s:g} s, or a last static or straight segment without duration_s",
        )
    if flight.t_s < duration_s + MARGIN_S:
        flight.add(flight.law(duration_s + MARGIN_S - flight.t_s))
    return flight.pieces


def _static(flight: _Flight, segment: Static) -> None:
    if flight.pose.speed_mps > 0.0:
        found = f"{flight.pose.speed_mps:g} m/s"
        raise flight.refuse("is at rest but the vehicle moves", found=found, wanted="a straight to speed_mps = 0 first")
    flight.add(flight.law(segment.duration_s or flight.rest_s()))


def _straight(flight: _Flight, segment: Straight) -> None:
    v0 = flight.pose.speed_mps
    v1, duration = _speed_change(flight, segment, v0)
    if v1 == v0:
        speed: tuple[float, ...] = (v0,)
    elif segment.smooth:
        speed = (v0, 0.0, 3.0 * (v1 - v0), -2.0 * (v1 - v0))
    else:
        speed = (v0, v1 - v0)
    flight.add(flight.law(duration, speed=speed))


def _speed_change(flight: _Flight, segment: Straight, v0: float) -> tuple[float, float]:
    """Speed at the end and duration of a straight segment."""
    v1, a, duration, distance = (
        segment.speed_mps, segment.acceleration_mps2, segment.duration_s, segment.distance_m,
    )  # fmt: skip
    given = sum(value is not None for value in (v1, a, duration, distance))
    if given == 0:
        return v0, flight.rest_s()
    if duration is not None and given == 1:
        return v0, duration
    if distance is not None and given == 1:
        return v0, distance / flight.needs_speed()
    if given == 2 and v1 is not None and duration is not None:
        return v1, duration
    if given == 2 and v1 is not None and distance is not None:
        if v0 + v1 <= 0.0:
            flight.needs_speed()
        return v1, 2.0 * distance / (v0 + v1)
    if given == 2 and v1 is not None and a is not None:
        if v1 == v0 or a == 0.0:
            raise flight.refuse("changes no speed", found=f"{v0:g} to {v1:g} m/s at {a:g} m/s^2")
        return v1, abs((v1 - v0) / a)
    if given == 2 and a is not None and duration is not None:
        v1 = v0 + a * duration
        if v1 < -1e-9:
            raise flight.refuse(
                "brakes below zero speed",
                key="acceleration_mps2",
                found=f"{v1:g} m/s after {duration:g} s",
                wanted=f"at least {-v0 / duration:g} m/s^2",
            )
        return max(v1, 0.0), duration
    raise flight.refuse(
        "is given too much or too little",
        wanted="duration_s, distance_m, or speed_mps with one of acceleration_mps2, duration_s, distance_m, "
        "or acceleration_mps2 with duration_s",
    )


def _turn(flight: _Flight, segment: Turn) -> None:
    speed = flight.needs_speed() * np.cos(flight.pose.pitch)
    if (segment.radius_m is None) == (segment.rate_dps is None):
        raise flight.refuse("is given both or none of radius_m and rate_dps", wanted="one of them")
    if segment.angle_deg == 0.0:
        raise flight.refuse("turns by nothing", key="angle_deg", found="0")
    rate = np.radians(segment.rate_dps) if segment.rate_dps is not None else speed / (segment.radius_m or 1.0)
    angle = float(np.radians(segment.angle_deg))
    if segment.roll_in_s * rate > abs(angle) * (1.0 + 1e-12):
        raise flight.refuse(
            "has no time for its roll_in_s",
            key="roll_in_s",
            found=f"{segment.roll_in_s:g} s",
            wanted=f"at most {abs(angle) / rate:.3g} s",
        )
    for law in _turn_laws(flight, angle, float(rate), segment.roll_in_s):
        flight.add(law)


def _turn_laws(flight: _Flight, angle: float, rate: float, roll_in_s: float) -> list[Law]:
    """Course laws of a turn: rate built up along a smooth step, held, taken away; lower where the angle is small."""
    sign = np.sign(angle)
    if roll_in_s == 0.0:
        return [flight.law(abs(angle) / rate, course=(0.0, angle))]
    rate = min(rate, abs(angle) / roll_in_s)
    half = 0.5 * sign * rate * roll_in_s  # turned while the rate builds up
    hold = abs(angle) / rate - roll_in_s
    laws = [flight.law(roll_in_s, course=(0.0, 0.0, 0.0, 2.0 * half, -half))]
    if hold > 1e-9:
        laws.append(flight.law(hold, course=(0.0, angle - 2.0 * half)))
    laws.append(flight.law(roll_in_s, course=(0.0, 2.0 * half, 0.0, -2.0 * half, half)))
    t = flight.t_s
    placed = []
    for law in laws:
        placed.append(Law(t, law.duration_s, law.speed, law.pitch, law.course))
        t += law.duration_s
    return placed


def _arc(flight: _Flight, pitch: float, radius_m: float) -> None:
    """Arc in the vertical plane to a pitch (rad)."""
    change = pitch - flight.pose.pitch
    if abs(change) > 0.0:
        duration = abs(change) * radius_m / flight.needs_speed()
        flight.add(flight.law(duration, pitch=(flight.pose.pitch, change)))


def _pitch(flight: _Flight, segment: Pitch) -> None:
    flight.needs_speed()
    _arc(flight, float(np.radians(segment.pitch_deg)), segment.radius_m)


def _climb(flight: _Flight, segment: Climb | Dive) -> None:
    speed = flight.needs_speed()
    flight.needs_level()
    pitch = float(np.radians(segment.pitch_deg))
    arcs = 2.0 * segment.radius_m * (1.0 - np.cos(pitch))
    if arcs > segment.height_m * (1.0 + 1e-12):
        raise flight.refuse(
            "has transition arcs that do not fit",
            key="height_m",
            found=f"{segment.height_m:g} m",
            wanted=f"at least {arcs:.1f} m, or a smaller radius_m or pitch_deg",
        )
    slope_s = (segment.height_m - arcs) / (speed * np.sin(pitch))
    _arc(flight, pitch if isinstance(segment, Climb) else -pitch, segment.radius_m)
    if slope_s > 1e-9:
        flight.add(flight.law(float(slope_s)))
    _arc(flight, 0.0, segment.radius_m)


def _spline(flight: _Flight, segment: Spline) -> None:
    from scipy.interpolate import CubicSpline

    table = np.array(segment.points)
    llh = np.column_stack([np.radians(table[:, 1:3]), table[:, 3]])
    origin = flight.pose.pos_e
    pos = np.vstack([np.zeros(3), ecef_from_geodetic(llh) - origin])
    t = flight.t_s + np.concatenate([[0.0], table[:, 0]])
    pose, speed = flight.pose, flight.needs_speed()
    vel = speed * (pose.f * np.cos(pose.pitch) + pose.u * np.sin(pose.pitch))
    end = "not-a-knot" if len(t) >= 4 else (2, np.zeros(3))
    spline = CubicSpline(t, pos, bc_type=((1, vel), end))
    dense = np.linspace(t[0], t[-1], 64 * len(t) + 1)
    rate = spline(dense, 1)
    up = geodetic_from_ecef(spline(dense) + origin)
    normal = np.stack(
        [np.cos(up[:, 0]) * np.cos(up[:, 1]), np.cos(up[:, 0]) * np.sin(up[:, 1]), np.sin(up[:, 0])], axis=1
    )
    across = np.linalg.norm(rate - np.einsum("ij,ij->i", rate, normal)[:, None] * normal, axis=1)
    if across.min() < 0.02 * np.linalg.norm(rate, axis=1).max():
        raise flight.refuse(
            "nearly stands still, or goes straight up, on its way",
            key="points",
            found=f"{across.min():.3g} m/s ahead at {dense[across.argmin()] - t[0]:.1f} s",
            wanted="points and times that keep it moving",
        )
    piece = SplinePiece(spline, origin, banked=flight.banked)
    flight.pieces.append(piece)
    flight.pose = piece.end
    flight.t_s = float(t[-1])


def _waypoints(flight: _Flight, segment: Waypoints) -> None:
    flight.needs_speed()
    flight.needs_level()
    for number, point in enumerate(segment.points, 1):
        _to_waypoint(flight, segment, number, point)


def _to_waypoint(flight: _Flight, segment: Waypoints, number: int, point: tuple[float, ...]) -> None:
    """Turn until the waypoint lies ahead, then straight to it, changing height on the way.

    Solved in a plane (azimuthal, about where the leg starts), flown on the Earth, and the miss added to the aim
    until it is gone.
    """
    start, t_s, n = flight.pose, flight.t_s, len(flight.pieces)
    height = point[2] if len(point) == 3 else start.height_m
    lat, lon = np.radians(point[:2])
    goal = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    wanted = _plane(start, goal)
    aim, climb, rise = wanted, 1.0, height - start.height_m
    for _ in range(60):
        angle, leg = _turn_and_leg(aim, segment.radius_m)
        if angle is None:
            raise flight.refuse(
                f"waypoint {number} lies inside the turning circle",
                key="points",
                found=str(list(point)),
                wanted=f"farther off, or radius_m below {segment.radius_m:g}",
            )
        pitch = climb * rise / (leg * 8.0 / 15.0) if leg > 0.0 else 0.0
        if abs(pitch) > MOST_STEEP:
            raise flight.refuse(f"waypoint {number} is too steep", key="points", found=str(list(point)))
        flight.pose, flight.t_s = start, t_s
        del flight.pieces[n:]
        if abs(angle) > 1e-12:
            for law in _turn_laws(flight, angle, start.speed_mps / segment.radius_m, segment.roll_in_s):
                flight.add(law)
        if leg > 0.0:
            # a bump of the path's pitch, 16 s^2 (1 - s)^2 of the most: level at both ends
            bump = (0.0, 0.0, 16.0 * pitch, -32.0 * pitch, 16.0 * pitch)
            flight.add(flight.law(leg / start.speed_mps, pitch=bump if rise else (0.0,)))
        miss = wanted - _plane(start, flight.pose.u)
        low = height - flight.pose.height_m
        if np.abs(miss).max() < 1e-6 and abs(low) < 1e-6:
            return
        aim = aim + miss
        if rise:
            climb *= rise / (flight.pose.height_m - start.height_m)
    raise flight.refuse(f"waypoint {number} cannot be reached", key="points", found=str(list(point)))


def _plane(start: Pose, u: F8) -> F8:
    """Distance ahead and to the right, m, of the place with normal ``u``: azimuthal equidistant about ``start``."""
    right = np.cross(start.f, start.u)
    ahead, side, up = float(u @ start.f), float(u @ right), float(u @ start.u)
    across = np.hypot(ahead, side)
    radius = float(np.linalg.norm(start.pos_e))
    scale = radius * (np.arctan2(across, up) / across if across > 0.0 else 1.0)
    return np.array([ahead * scale, side * scale])


def _turn_and_leg(aim: F8, radius_m: float) -> tuple[float | None, float]:
    """Turn (rad, positive right) and straight distance from the origin, heading along x, to ``aim`` (x, y right)."""
    x, y = float(aim[0]), float(aim[1])
    if abs(y) < 1e-7 and x >= 0.0:
        return 0.0, x
    sign = 1.0 if y >= 0.0 else -1.0
    across = radius_m - sign * y  # from the aim to the circle's centre, sideways
    distance2 = x * x + across * across
    if distance2 < radius_m * radius_m:
        return None, 0.0
    leg = float(np.sqrt(distance2 - radius_m * radius_m))
    # the aim is at R sin(a) + L cos(a) ahead and R (1 - cos(a)) + L sin(a) to the side
    angle = np.arctan2(radius_m * x - leg * across, leg * x + radius_m * across)
    angle = float(np.mod(angle, 2.0 * np.pi))
    return (0.0 if angle > 2.0 * np.pi - 1e-9 else sign * angle), leg  # not a circle for a rounding error


_FLOWN: dict[type[Segment], Callable[[_Flight, Any], None]] = {
    Static: _static,
    Straight: _straight,
    Turn: _turn,
    Pitch: _pitch,
    Climb: _climb,
    Dive: _climb,
    Waypoints: _waypoints,
    Spline: _spline,
}
