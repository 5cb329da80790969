"""The language in which a vehicle's path is written: one class per kind of segment.

A segment starts where the one before ended, with its position, heading, pitch of the path and speed. Lengths and
radii are those of the path on the curved Earth; "straight" is a geodesic of the surface of constant height, so that
level flight stays level and no side force is felt but Coriolis'.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

from starwise.config import Checked, Positive, Range
from starwise.errors import StarwiseError

S = TypeVar("S", bound="Segment")
Angle = Annotated[float, Range(-36000.0, 36000.0)]


@dataclass(frozen=True)
class Segment(Checked):
    """Base of all segments; made from a table by the value of its key ``kind``."""

    @classmethod
    def from_dict(cls: type[S], data: Mapping[str, Any], *, file: str | None = None, prefix: str = "") -> S:
        """Segment of the class that ``kind`` names.

        Raises
        ------
        StarwiseError
            No or an unknown ``kind``, an unknown key, a value that does not fit.
        """
        if cls is not Segment:
            return super().from_dict(data, file=file, prefix=prefix)
        kind = data.get("kind")
        wanted = " | ".join(KINDS)
        if kind is None:
            raise StarwiseError(f"'{prefix}kind' is missing", file=file, wanted=wanted)
        if not isinstance(kind, str) or kind not in KINDS:
            raise StarwiseError(f"'{prefix}kind' has no such choice", file=file, found=str(kind), wanted=wanted)
        made = KINDS[kind].from_dict(data, file=file, prefix=prefix)
        assert isinstance(made, cls)
        return made


@dataclass(frozen=True)
class Static(Segment):
    """At rest; without a duration, until the scenario ends."""

    kind: Literal["static"] = "static"
    duration_s: Positive | None = None


@dataclass(frozen=True)
class Straight(Segment):
    """Straight on, at constant speed or changing it; with nothing given, until the scenario ends.

    Constant speed: `duration_s` or `distance_m`. A change of speed takes two of `speed_mps` (at its end),
    `acceleration_mps2` (its size; with `duration_s` signed) and `duration_s`.
    """

    kind: Literal["straight"] = "straight"
    duration_s: Positive | None = None
    distance_m: Positive | None = None
    speed_mps: Annotated[float, Range(0.0, 1e5)] | None = None
    acceleration_mps2: Annotated[float, Range(-1e4, 1e4)] | None = None
    smooth: bool = False
    """Change the speed along a smooth step (acceleration continuous) in the same time."""


@dataclass(frozen=True)
class Turn(Segment):
    """Turn at constant speed, level unless the path is pitched; `radius_m` (horizontal) or `rate_dps`."""

    angle_deg: Angle
    """Change of course, degrees; positive to the right."""
    kind: Literal["turn"] = "turn"
    radius_m: Positive | None = None
    rate_dps: Positive | None = None
    roll_in_s: Annotated[float, Range(0.0, 600.0)] = 0.0
    """Time in which the turn rate, and an aircraft's bank, build up smoothly, and in which they go again."""


@dataclass(frozen=True)
class Pitch(Segment):
    """Arc in the vertical plane to another pitch of the path, at constant speed."""

    pitch_deg: Annotated[float, Range(-89.0, 89.0)]
    """Pitch of the path at the end, degrees above the horizon."""
    radius_m: Positive
    kind: Literal["pitch"] = "pitch"


@dataclass(frozen=True)
class Climb(Segment):
    """From level flight up to another level: arc, straight slope, arc, at constant speed."""

    pitch_deg: Annotated[float, Range(0.0, 89.0, open_low=True)]
    """Pitch of the slope, degrees."""
    radius_m: Positive
    """Radius of both transition arcs."""
    height_m: Positive
    """Height gained, arcs included."""
    kind: Literal["climb"] = "climb"


@dataclass(frozen=True)
class Dive(Segment):
    """From level flight down to another level: arc, straight slope, arc, at constant speed."""

    pitch_deg: Annotated[float, Range(0.0, 89.0, open_low=True)]
    """Pitch of the slope downwards, degrees, positive."""
    radius_m: Positive
    """Radius of both transition arcs."""
    height_m: Positive
    """Height lost, arcs included, positive."""
    kind: Literal["dive"] = "dive"


@dataclass(frozen=True)
class Waypoints(Segment):
    """Through waypoints at constant speed: to each a turn of `radius_m` until it lies ahead, then straight."""

    points: tuple[tuple[float, ...], ...]
    """``[latitude deg, longitude deg]``, or with a height in m as third number."""
    radius_m: Positive
    kind: Literal["waypoints"] = "waypoints"
    roll_in_s: Annotated[float, Range(0.0, 600.0)] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_points(self.points, (2, 3), "[lat deg, lon deg] or [lat deg, lon deg, height m]", 0)


@dataclass(frozen=True)
class Spline(Segment):
    """Smooth curve from here through points at given times (cubic spline, starting with the present velocity)."""

    points: tuple[tuple[float, ...], ...]
    """``[time s since the segment's start, latitude deg, longitude deg, height m]``, times increasing."""
    kind: Literal["spline"] = "spline"

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_points(self.points, (4,), "[time s, lat deg, lon deg, height m]", 1)
        times = [0.0, *(point[0] for point in self.points)]
        for before, after in itertools.pairwise(times):
            if after <= before:
                raise StarwiseError("'points' times do not increase", found=f"{after:g} after {before:g} s")


KINDS: dict[str, type[Segment]] = {
    "static": Static,
    "straight": Straight,
    "turn": Turn,
    "pitch": Pitch,
    "climb": Climb,
    "dive": Dive,
    "waypoints": Waypoints,
    "spline": Spline,
}
"""Segment classes by the word that names them in a scenario."""


def _check_points(points: tuple[tuple[float, ...], ...], sizes: tuple[int, ...], wanted: str, lat: int) -> None:
    if not points:
        raise StarwiseError("'points' is empty", wanted=f"a list of {wanted}")
    for point in points:
        if len(point) not in sizes or abs(point[lat]) > 90.0 or abs(point[lat + 1]) > 360.0:
            raise StarwiseError("'points' has one that is none", found=str(list(point)), wanted=wanted)
