"""Epochs of a solution for a page: the track about a local origin, what was claimed, and everything estimated."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import EPOCH_NO_SOLUTION, EPOCH_STATUS_NAMES, EPOCH_SUSPECT
from starwise.frames import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotations_ne_enu
from starwise.report.html.encode import packed, thinned
from starwise.types import Solution

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

MAX_EPOCHS: Final = 8_000
"""Epochs with all their numbers; of more, the extremes of every series are kept."""
GPS_UNIX_MS: Final = 315_964_800_000
"""GPS epoch in the milliseconds of JavaScript, which know no leap seconds: labels stay GPST."""


@dataclass(frozen=True)
class Local:
    """A solution in a local frame.

    Attributes
    ----------
    origin_e : (3,) float64
        ECEF, m: the median of the positions.
    enu : (n, 3) float64
        East, north, up of the origin's tangent plane, m; NaN where there is no position.
    height : (n,) float64
        Ellipsoidal height, m.
    vel, sigma, sigma_vel : (n, 3) float64
        Velocity and 1 sigma of position and velocity, east, north, up.
    cov_en : (n, 3) float64
        Variances east, north and their covariance, m^2.
    """

    origin_e: F8
    enu: F8
    height: F8
    vel: F8
    sigma: F8
    sigma_vel: F8
    cov_en: F8


def localised(solution: Solution, origin_e: F8 | None = None) -> Local:
    """Solution about ``origin_e`` (default: the median of positions that are not suspect)."""
    solved = solution.has_position & (solution.status != EPOCH_NO_SOLUTION)
    good = solved & (solution.status != EPOCH_SUSPECT)
    if origin_e is None:
        chosen = good if good.any() else solved
        origin_e = np.median(solution.pos_e[chosen], axis=0) if chosen.any() else np.full(3, np.nan)
    pos_e = np.where(solved[:, None], solution.pos_e, np.nan)
    llh = geodetic_from_ecef(pos_e)
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])
    cov = C @ solution.cov_pos @ C.transpose(0, 2, 1)
    cov_vel = C @ solution.cov_vel @ C.transpose(0, 2, 1)
    with np.errstate(invalid="ignore"):
        return Local(
            origin_e=origin_e,
            enu=enu_from_ecef(pos_e, origin_e),
            height=llh[:, 2],
            vel=(C @ solution.vel_e[:, :, None])[:, :, 0],
            sigma=np.sqrt(np.diagonal(cov, axis1=1, axis2=2)),
            sigma_vel=np.sqrt(np.diagonal(cov_vel, axis1=1, axis2=2)),
            cov_en=np.stack([cov[:, 0, 0], cov[:, 1, 1], cov[:, 0, 1]], axis=1),
        )


def shown_epochs(solution: Solution, local: Local, errors: F8 | None = None) -> I8:
    """Epochs that are drawn: all, or with the extremes of every series."""
    if solution.n_epochs <= MAX_EPOCHS:
        return np.arange(solution.n_epochs)
    series = [*local.enu.T, *local.vel.T, *local.sigma.T, solution.nis, solution.n_used.astype(np.float64)]
    series += [(solution.status == code).astype(np.float64) for code in np.unique(solution.status)]
    series.append(solution.dop[:, 1])
    series += [] if errors is None else list(errors.T)
    return thinned(series, MAX_EPOCHS)


def epochs_payload(solution: Solution, local: Local, shown: I8) -> dict[str, Any]:
    """Series of the shown epochs, packed; times in ms from ``t0_ms``."""
    t_ns = solution.t_ns
    first = int(t_ns[0]) if len(t_ns) else 0
    llh = geodetic_from_ecef(local.origin_e) if np.isfinite(local.origin_e).all() else np.full(3, np.nan)
    out: dict[str, Any] = {
        "n": solution.n_epochs,
        "t0_ms": first // 1_000_000 + GPS_UNIX_MS,
        "t_ms": packed((t_ns[shown] - first) / 1e6, "f8"),
        "index": packed(shown, "u4"),
        "interval_ms": float(np.median(np.diff(t_ns))) / 1e6 if len(t_ns) > 1 else 1000.0,
        "status": packed(solution.status[shown], "u1"),
        "statuses": list(EPOCH_STATUS_NAMES),
        "origin_llh": [float(np.degrees(llh[0])), float(np.degrees(llh[1])), float(llh[2])],
        "h": packed(local.height[shown], "f8"),
        "n_used": packed(solution.n_used[shown], "u2"),
        "dop": [packed(solution.dop[shown, k]) for k in range(4)] if np.isfinite(solution.dop).any() else None,
        "nis": packed(solution.nis[shown]) if np.isfinite(solution.nis).any() else None,
        "dof": packed(solution.dof[shown], "u2"),
    }
    for name, values in (("enu", local.enu), ("vel", local.vel), ("sigma", local.sigma),
                         ("sigma_vel", local.sigma_vel), ("cov_en", local.cov_en)):  # fmt: skip
        out[name] = [packed(values[shown, k]) for k in range(3)] if np.isfinite(values).any() else None
    out["clocks"] = _clocks(solution, shown)
    out["extra"] = {name: packed(values[shown]) for name, values in solution.extra.items() if np.isfinite(values).any()}
    out["graticule"] = graticule(local)
    return out


def _clocks(solution: Solution, shown: I8) -> list[dict[str, Any]]:
    out = []
    for k, name in enumerate(solution.clock_names):
        bias = solution.clock_m[shown, k]
        if not np.isfinite(bias).any():
            continue
        out.append({
            "name": name,
            "bias": packed(bias, "f8"),
            "sigma": packed(solution.clock_sigma_m[shown, k]),
            "drift": packed(solution.drift_mps[shown, k]),
        })  # fmt: skip
    return out


def graticule(local: Local) -> list[dict[str, Any]]:
    """Meridians and parallels about the track: value in degrees, which, and its line east, north, m."""
    there = local.enu[np.isfinite(local.enu).all(axis=1)]
    if not len(there):
        return []
    lat, lon, h = geodetic_from_ecef(local.origin_e)
    low, high = np.percentile(there[:, :2], 1.0, axis=0), np.percentile(there[:, :2], 99.0, axis=0)
    span = max(float((high - low).max()), 2.0) * 1.5
    middle = (low + high) / 2.0
    radius = 6_371_000.0
    out: list[dict[str, Any]] = []
    for k, (name, at, scale) in enumerate((("lon", lon, radius * np.cos(lat)), ("lat", lat, radius))):
        step = _nice_angle(float(np.degrees(span / max(scale, 1.0))) / 3.5)
        centre = float(np.degrees(at + middle[k] / max(scale, 1.0)))
        first = np.ceil((centre - 5.0 * step) / step)
        other = lat if k == 0 else lon
        other_scale = radius if k == 0 else radius * np.cos(lat)
        along = np.linspace(other + (middle[1 - k] - 2.0 * span) / max(other_scale, 1.0),
                            other + (middle[1 - k] + 2.0 * span) / max(other_scale, 1.0), 9)  # fmt: skip
        for i in range(10):
            value = (first + i) * step
            fixed = np.full(len(along), np.radians(value))
            pair = (along, fixed) if k == 0 else (fixed, along)
            enu = enu_from_ecef(ecef_from_geodetic(np.stack([*pair, np.full(len(along), h)], axis=1)), local.origin_e)
            out.append({"kind": name, "deg": float(value), "step": step, "e": enu[:, 0].round(3).tolist(),
                        "n": enu[:, 1].round(3).tolist()})  # fmt: skip
    return out


def _nice_angle(wanted_deg: float) -> float:
    """Step of a graticule near a wanted one: round in degrees, minutes or seconds."""
    for unit in (1.0, 1.0 / 60.0, 1.0 / 3600.0):
        for step in (30.0, 20.0, 10.0, 5.0, 2.0, 1.0):
            if step * unit <= wanted_deg:
                return step * unit
    decade = 10.0 ** np.floor(np.log10(max(wanted_deg, 1e-12) * 3600.0)) / 3600.0
    return float(max(s * decade for s in (1.0, 2.0, 5.0) if s * decade <= max(wanted_deg, 1e-12) * 1.0000001))
