"""Inertial readings against what they are said to be: the likely mistake by its name.

Every test rests on physics, none on a name or on a kind of sensor: the mean specific force of a vehicle is 1 g against
gravity; gyroscopes must explain how the direction of gravity moves; in a curve, the force towards its inside is speed
times rate of turn.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from starwise.physics.earth import STANDARD_GRAVITY
from starwise.types import F8, Inertial

_TILT_WARN: Final = 20.0
_TILT_SEVERE: Final = 75.0
_WINDOW_S: Final = 2.0
_DEG: Final = 180.0 / math.pi


@dataclass(frozen=True)
class ImuFinding:
    """A likely mistake in the description of inertial readings.

    Attributes
    ----------
    mistake : str
        ``accel_unit``, ``accel_sign``, ``gravity_axis``, ``tilt``, ``gyro_unit``, ``gyro_sign``, ``repeated``,
        ``constant``, ``large`` or ``axes_order``.
    text, found, wanted : str
        For people, without a unit left out.
    severe : bool
        The readings cannot be used as described; otherwise worth a look.
    """

    mistake: str
    text: str
    found: str
    wanted: str
    severe: bool


def check_imu(inertial: Inertial, rate_hz: float | None = None) -> list[ImuFinding]:
    """Likely mistakes in readings in body axes forward, right, down; an empty list if none is seen.

    Parameters
    ----------
    inertial : Inertial
        Some seconds at least, not in free fall.
    rate_hz : float, optional
        Declared rate, for confusions of rates with increments; default from the readings.

    Returns
    -------
    list of ImuFinding
        Severe ones first.
    """
    dt = 1.0 / rate_hz if rate_hz is not None else float(np.median(inertial.dt_s))
    each = inertial.dt_s[:, None] if inertial.increments else 1.0
    omega, f = inertial.gyro / each, inertial.accel / each
    if len(f) < 10:
        return []
    found = [_gravity(f, dt, inertial.increments)]
    if found[0] is None:  # with gravity of the wrong size nothing else can be said
        found += [_down(omega, f), _turning(omega, f, dt), _stuck(omega, f), _axes_order(omega, f, dt)]
    listed = [finding for finding in found if finding is not None]
    return sorted(listed, key=lambda finding: not finding.severe)


def _gravity(f: F8, dt: float, increments: bool) -> ImuFinding | None:
    size = float(np.median(np.linalg.norm(f, axis=1)))
    found = f"{size:.4g} m/s^2 in the median"
    if not size > 0.0:
        return ImuFinding("constant", "the accelerometers read nothing", found, "9.8 m/s^2", True)
    ratio = size / STANDARD_GRAVITY
    if 0.5 < ratio < 3.0:  # turns of aircraft and the scale of a poor sensor included; no confusion is so small
        return None
    other = "rates, read as increments" if increments else "increments, read as rates"
    mistakes = {
        "unit g, read as m/s^2": 1.0 / STANDARD_GRAVITY,
        "unit m/s^2, read as g": STANDARD_GRAVITY,
        "unit mg, read as g": 1000.0,
        "unit g, read as mg": 1e-3,
        "unit m/s^2, read as mg": 1e-3 * STANDARD_GRAVITY,
        "unit mg, read as m/s^2": 1000.0 / STANDARD_GRAVITY,
        other: 1.0 / dt if increments else dt,
    }
    likely = min(mistakes, key=lambda name: abs(math.log(ratio / mistakes[name])))
    close = abs(math.log(ratio / mistakes[likely])) < 0.25
    free = "gravity taken off already?" if ratio < 0.1 else "'accel.unit', 'accel.factor' or columns wrong?"
    return ImuFinding(
        "accel_unit", f"specific force is not 1 g: {likely if close else free}", found, "about 9.8 m/s^2", True
    )


def _down(omega: F8, f: F8) -> ImuFinding | None:
    mean = f.mean(axis=0)
    size = float(np.linalg.norm(mean))
    if size < 0.5 * STANDARD_GRAVITY:
        return None  # aerobatics, or a body that tumbles
    up = mean / size  # specific force of a body that is carried points up: -z in forward, right, down
    tilt = math.degrees(math.acos(max(-1.0, min(1.0, -float(up[2])))))
    found = "mean specific force " + " ".join(f"{value:+.2f}" for value in mean) + " m/s^2"
    wanted = "about 0 0 -9.8 forward, right, down"
    if tilt > 180.0 - _TILT_SEVERE:
        turned = _side_force(omega, f)
        text = "gravity has the wrong sign: "
        if turned < -0.3:
            return ImuFinding("accel_sign", text + "accelerometers inverted ('accel.inverted')?", found, wanted, True)
        return ImuFinding("accel_sign", text + "z points up ('axes' like FLU or RFU)?", found, wanted, True)
    if tilt > _TILT_SEVERE:
        axis = "xyz"[int(np.argmax(np.abs(up)))]
        return ImuFinding(
            "gravity_axis", f"gravity is on the {axis} axis: columns or axes swapped?", found, wanted, True
        )
    if tilt > _TILT_WARN:
        return ImuFinding("tilt", f"mounted {tilt:.0f} deg from level, or axes wrong", found, wanted, False)
    return None


def _side_force(omega: F8, f: F8) -> float:
    """Correlation of the rate of turn about the vertical with the largest correlating horizontal force, signed.

    A body that moves forward along its x axis has f_y = v omega_z: positive. Only the y axis is looked at.
    """
    turn = omega[:, 2] - np.median(omega[:, 2])
    side = f[:, 1] - np.median(f[:, 1])
    if np.std(turn) < 0.02 or np.std(side) < 0.05:
        return 0.0
    n = max(1, len(turn) // 5000)
    return float(np.corrcoef(_thinned(turn, n), _thinned(side, n))[0, 1])


def _thinned(x: F8, n: int) -> F8:
    rows = len(x) // n
    return np.asarray(x[: rows * n].reshape(rows, n, *x.shape[1:]).mean(axis=1))


def _turning(omega: F8, f: F8, dt: float) -> ImuFinding | None:
    """Whether the gyroscopes explain the motion of the direction of gravity, and by which factor they would."""
    sizes = np.linalg.norm(omega, axis=1)
    top = float(np.quantile(sizes, 0.99))
    found = f"99 % below {top:.3g} rad/s"
    if top == 0.0:
        return ImuFinding("constant", "the gyroscopes read nothing", found, "at least noise", True)
    if top < 7.0 * math.pi / 180.0 / 3600.0:
        text = "gyroscopes quieter than the Earth's rotation (15 deg/h): unit, or rates read as increments?"
        return ImuFinding("gyro_unit", text, found, "rad/s", True)
    errors = _tilt_errors(omega, f, dt)
    if errors is None:
        return None
    names = {1.0: "", 1.0 / _DEG: "deg read as rad", _DEG: "rad read as deg", -1.0: "inverted",
             dt: "rates read as increments, or increments as rates"}  # fmt: skip
    best = min(errors, key=lambda k: errors[k])
    if best != 1.0 and errors[best] < 0.5 * errors[1.0] and errors[1.0] > 0.15:
        severe = best != -1.0 or errors[best] < 0.25 * errors[1.0]
        kind = "gyro_sign" if best == -1.0 else "gyro_unit"
        text = f"gyroscopes do not explain how the direction of gravity moves: {names[best]}?"
        said = f"{errors[1.0] * _DEG:.0f} deg off in {_WINDOW_S:g} s, {errors[best] * _DEG:.1f} with that mended"
        return ImuFinding(kind, text, said, "a few degrees", severe)
    if top > 35.0:
        return ImuFinding("large", "very fast rotation: deg read as rad?", found, "below 35 rad/s", False)
    return _speed(omega, f, dt)


def _tilt_errors(omega: F8, f: F8, dt: float) -> dict[float, float] | None:
    """Angle, rad, between specific force and where the gyroscopes put it, by the factor put on them.

    Windows of 2 s; the mean over those in which the force is close to 1 g at both ends, so that it shows gravity.
    """
    n = max(2, round(_WINDOW_S / dt))
    edge = max(1, n // 10)
    starts = np.arange(0, len(f) - n - edge, n)
    if len(starts) < 3:
        return None
    starts = starts[:: max(1, len(starts) // 400)]
    ends = [np.stack([f[s + k : s + k + edge].mean(axis=0) for s in starts]) for k in (0, n)]
    sizes = [np.linalg.norm(e, axis=1) for e in ends]
    still = (np.abs(sizes[0] / STANDARD_GRAVITY - 1.0) < 0.1) & (np.abs(sizes[1] / STANDARD_GRAVITY - 1.0) < 0.1)
    if still.sum() < 3:
        return None
    starts, ends = starts[still], [e[still] / s[still][:, None] for e, s in zip(ends, sizes, strict=True)]
    out = {}
    for factor in (1.0, 1.0 / _DEG, _DEG, -1.0, dt):
        u = ends[0].copy()
        for k in range(edge // 2, n + edge // 2):
            # a direction fixed in space turns by -omega in the body
            u = _turned(u, -factor * dt * omega[np.minimum(starts + k, len(omega) - 1)])
        cosine = np.clip((u * ends[1]).sum(axis=1), -1.0, 1.0)
        out[factor] = float(np.sqrt(np.mean(np.arccos(cosine) ** 2)))
    return out


def _turned(u: F8, angle: F8) -> F8:
    """Vectors (n, 3) turned by rotation vectors (n, 3), Rodrigues."""
    size = np.linalg.norm(angle, axis=1, keepdims=True)
    k = angle / np.where(size > 0.0, size, 1.0)
    s, c = np.sin(size), np.cos(size)
    along = (k * u).sum(axis=1, keepdims=True)
    return np.asarray(u * c + np.cross(k, u) * s + k * along * (1.0 - c))


def _speed(omega: F8, f: F8, dt: float) -> ImuFinding | None:
    """Speed out of side force over rate of turn: what a vehicle cannot have is a unit or a sign."""
    n = max(1, round(0.5 / dt))
    turn, side = _thinned(omega[:, 2] - np.median(omega[:, 2]), n), _thinned(f[:, 1] - np.median(f[:, 1]), n)
    if len(turn) < 40 or np.std(side) < 0.3:
        return None
    together = float(np.corrcoef(turn, side)[0, 1])
    if abs(together) < 0.7:
        return None  # mounted askew, or no curves: nothing to be said
    speed = float((turn * side).mean() / (turn * turn).mean())
    found = f"side force / rate of turn = {speed:.3g} m/s"
    if abs(speed) > 400.0:
        return ImuFinding("gyro_unit", "turns too slow for their side force: rad read as deg?", found, "a speed", True)
    if 0.0 < abs(speed) < 0.5 and float(np.quantile(np.abs(turn), 0.99)) > 6.0:
        return ImuFinding("gyro_unit", "turns too fast for their side force: deg read as rad?", found, "a speed", True)
    if speed < 0.0:
        text = "side force has the wrong sign in turns: gyroscopes inverted, or x points backwards?"
        return ImuFinding("gyro_sign", text, found, "positive", False)
    return None


def _stuck(omega: F8, f: F8) -> ImuFinding | None:
    both = np.hstack([omega, f])
    same = float((np.diff(both, axis=0) == 0.0).all(axis=1).mean())
    if same > 0.5:
        return ImuFinding(
            "repeated", "readings repeat the row before: sampled faster than the sensor", f"{same:.0%} of the rows",
            "each reading once", False,
        )  # fmt: skip
    return None


def _axes_order(omega: F8, f: F8, dt: float) -> ImuFinding | None:
    """Most of a vehicle's rotation is about the vertical; if it is about another axis, columns may be swapped."""
    n = max(1, round(0.5 / dt))
    spread = np.std(_thinned(omega, n), axis=0)
    up = int(np.argmax(np.abs(f.mean(axis=0))))
    most = int(np.argmax(spread))
    if most == up or spread[most] < 0.05 or spread[most] < 5.0 * spread[up]:
        return None
    return ImuFinding(
        "axes_order",
        "gyroscopes turn most about an axis that is not vertical: columns of one sensor swapped?",
        f"{'xyz'[most]} turns, gravity is on {'xyz'[up]}",
        "the same axis for a vehicle",
        False,
    )
