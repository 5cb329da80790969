"""Position fixes of several receivers on one vehicle, fused: any rates, any of them missing or wrong for a while."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from starwise.chi2 import chi_square_points
from starwise.config import Checked, Positive, Range
from starwise.constants import EPOCH_OK, EPOCH_SUSPECT
from starwise.errors import StarwiseError
from starwise.estimators.adaptive_fixes import improved_filter, least_squares
from starwise.estimators.fuse_plane import unroll
from starwise.frames import geodetic_from_ecef, rotations_ne_enu
from starwise.gnsstime import iso
from starwise.models.maneuver import BANKS
from starwise.types import F8, I8, Solution

LARGEST_M: Final = 1e5
"""Fixes of one epoch that are farther apart are of other places: no plane holds them."""
APART_M: Final = 10_000.0
"""Receivers that are never nearer to each other are not on one vehicle, whatever their files claim."""
APART_SIGMAS: Final = 20.0
APART_LEAST_M: Final = 100.0
"""Nor are those that are never nearer than so many of their claimed sigmas and the length of a long vehicle."""
NEVER_NEARER: Final = 0.05
"""Part of the fixes that may be nearer by chance."""
FASTEST_MPS: Final = 1000.0
"""What moves between fixes of different times is no distance."""


@dataclass(frozen=True)
class FuseConfig(Checked):
    """Options of ``starwise fuse``."""

    method: Literal["adaptive", "lsq"] = "adaptive"
    """Federated filter with manoeuvre hypotheses, or the inverse-variance combination of every epoch by itself."""
    dynamics: Literal["static", "pedestrian", "vehicle", "aircraft"] = "vehicle"
    """How the vehicle moves: bank of hypotheses in `starwise.models.maneuver.BANKS`."""
    sigma_horizontal_m: Positive = 3.0
    """Of receivers whose files claim none, per axis; the true scale is then found from their differences."""
    sigma_vertical_m: Positive = 6.0
    tolerance_s: float = 0.005
    """Fixes whose tags differ by less are one epoch's."""
    false_alarm: float = 1e-6
    """Chance that a good fix is refused for contradicting the others; 0: all are believed."""
    lasting: float = 0.5
    """Part of the claimed sigma that is common to all receivers and lasts (atmosphere, orbits): it neither averages nor
    shows in their differences, and is added to the covariance of the filter; 0: errors are the receivers' own."""
    scale: bool = True
    """Scale the claimed noise, and find its correlation in time, from the differences of the receivers."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not Range(0.0, 1.0).holds(self.tolerance_s):
            raise StarwiseError("'tolerance_s' is outside its limits", found=str(self.tolerance_s), wanted="0 to 1")
        if not Range(0.0, 1.0).holds(self.lasting):
            raise StarwiseError("'lasting' is outside its limits", found=str(self.lasting), wanted="0 to 1")
        if not Range(0.0, 0.1).holds(self.false_alarm):
            raise StarwiseError("'false_alarm' is outside its limits", found=str(self.false_alarm), wanted="0 to 0.1")


@dataclass(frozen=True)
class Receiver:
    """Fixes of one receiver.

    Attributes
    ----------
    name : str
    t_ns : (n,) int64
        GPST, ns, in any order.
    pos_e : (n, 3) float64
        ECEF, m; rows with NaN are left out.
    cov_e : (n, 3, 3) float64
        m^2; NaN where nothing is claimed.
    """

    name: str
    t_ns: I8
    pos_e: F8
    cov_e: F8


@dataclass(frozen=True)
class _Epochs:
    """Fixes in order of time: NaN where a receiver has none."""

    t_ns: I8
    pos_e: F8
    cov_e: F8


def fuse_fixes(receivers: Sequence[Receiver], config: FuseConfig | None = None) -> Solution:
    """Position and velocity of every epoch at which any receiver has a fix, ECEF.

    All fixes must be of one point of the vehicle. Nothing later than an epoch has part in it.

    Parameters
    ----------
    receivers : sequence of Receiver
        One or more; noise and faults can be told from two and three on.
    config : FuseConfig, optional

    Returns
    -------
    Solution
        ``n_used``: receivers that took part; ``nis`` and ``dof``: of the combined fix against the prediction; status
        suspect where a receiver was refused and only one is left. The ledger has a row per fix: ``receiver`` (index
        in ``provenance["receivers"]``), ``used``, ``east_m``, ``north_m``, ``up_m`` from the fused position.

    Raises
    ------
    StarwiseError
        No fix at all; receivers without a fix, or at another time than all others; receivers that are never near each
        other; fixes of one epoch in different places.
    """
    options = config or FuseConfig()
    if not receivers:
        raise StarwiseError("no position fixes", wanted="one or more receivers")
    epochs = _merge(receivers, options)
    t_s = np.asarray((epochs.t_ns - epochs.t_ns[0]) * 1e-9, dtype=np.float64)
    weight = np.where(np.isnan(epochs.pos_e[:, :, 0]), 0.0, 1.0 / np.einsum("nkii->nk", epochs.cov_e))
    base = np.einsum("nk,nki->ni", weight / weight.sum(axis=1)[:, None], np.nan_to_num(epochs.pos_e))
    plane = unroll(base)
    z = plane.from_ecef(epochs.pos_e)
    spread = np.nanmax(np.abs(z - plane.s[:, None]), axis=(1, 2))
    if spread.max() > LARGEST_M:
        at = int(spread.argmax())
        raise StarwiseError(
            "fixes of one epoch are not of one place",
            found=f"{spread[at] / 1e3:.0f} km apart, {t_s[at]:.3f} s after the first",
            wanted="receivers on one vehicle",
        )
    r = np.einsum("nkii->nki", plane.cov_from_ecef(epochs.cov_e)).copy()
    r[np.isnan(z)] = 1.0
    there = ~np.isnan(z[:, :, 0])
    if options.method == "lsq":
        s, var = least_squares(z, r)
        cov, vel, cov_vel = var[:, :, None] * np.eye(3), np.full_like(s, np.nan), np.full((len(s), 3, 3), np.nan)
        used, nis = there, np.full(len(s), np.nan)
        notes: dict[str, Any] = {}
    else:
        s, cov, vel, cov_vel, used, nis, notes = _adaptive(t_s, z, r, options)
        common = least_squares(np.where(used[:, :, None], z, np.nan), r)[1]
        cov = cov + options.lasting**2 * common[:, :, None] * np.eye(3)
    lost = (there & ~used).any(axis=1)
    status = np.where(lost & (used.sum(axis=1) < 2), EPOCH_SUSPECT, EPOCH_OK)
    n, none = len(t_s), np.full((len(t_s), 0), np.nan)
    return Solution(
        t_ns=epochs.t_ns,
        status=status.astype(np.uint8),
        pos_e=plane.to_ecef(s),
        vel_e=plane.rotated_to_ecef(vel),
        cov_pos=plane.cov_to_ecef(cov),
        cov_vel=plane.cov_to_ecef(cov_vel),
        clock_m=none,
        drift_mps=none,
        clock_sigma_m=none,
        clock_names=(),
        n_used=used.sum(axis=1).astype(np.int32),
        dop=np.full((n, 4), np.nan),
        nis=nis,
        dof=np.where(np.isnan(nis), 0, 3).astype(np.int32),
        ledger=_ledger(epochs, plane.to_ecef(s), used),
        provenance={
            "receivers": [receiver.name for receiver in receivers],
            "fixes": there.sum(axis=0).tolist(),
            "refused": (there & ~used).sum(axis=0).tolist(),
            **notes,
        },
    )


def _adaptive(
    t_s: F8, z: F8, r: F8, options: FuseConfig
) -> tuple[F8, F8, F8, F8, NDArray[np.bool_], F8, dict[str, Any]]:
    from dataclasses import replace

    bank = BANKS[options.dynamics]
    if not options.scale:
        bank = replace(bank, scale_window=0.0, most_inflation=1.0)
    if options.false_alarm > 0.0:
        bank = replace(bank, gate=float(chi_square_points(options.false_alarm, 4)[3]))
    track = improved_filter(t_s, z, r, bank)
    told = options.scale and bool(((~np.isnan(z[:, :, 0])).sum(axis=1) > 1).any())
    notes = {
        "noise_scale": float(track.scale[-1]) if told else None,
        "noise_correlation": float(track.correlation[-1]) if told else None,
        "cruise_share": float(np.nanmean(track.cruise)),
    }
    return track.pos, track.cov_pos, track.vel, track.cov_vel, track.used, track.nis, notes


def _merge(receivers: Sequence[Receiver], options: FuseConfig) -> _Epochs:
    """Fixes of all receivers by epoch; what a file does not claim of its noise is filled in."""
    cleaned = [_cleaned(receiver, options) for receiver in receivers]
    _check_times(receivers, [t for t, _, _ in cleaned])
    _check_places(receivers, cleaned)
    times = np.sort(np.concatenate([t for t, _, _ in cleaned]))
    tolerance = round(options.tolerance_s * 1e9)
    starts = [0]
    for i in range(1, len(times)):
        if times[i] - times[starts[-1]] > tolerance:
            starts.append(i)
    t_ns = times[starts]
    n, K = len(t_ns), len(receivers)
    pos, cov = np.full((n, K, 3), np.nan), np.broadcast_to(np.eye(3), (n, K, 3, 3)).copy()
    for k, (t, p, c) in enumerate(cleaned):
        at = np.searchsorted(t_ns, t, side="right") - 1
        pos[at, k], cov[at, k] = p, c
    return _Epochs(t_ns, pos, cov)


def _check_times(receivers: Sequence[Receiver], times: Sequence[I8]) -> None:
    """Refuse a receiver whose fixes all lie before or after those of every other one."""
    for k, t in enumerate(times):
        others = [o for j, o in enumerate(times) if j != k]
        if others and all(t[-1] < o[0] or o[-1] < t[0] for o in others):
            raise StarwiseError(
                "no time in common with the other receivers",
                file=receivers[k].name,
                found=f"{iso(int(t[0]))} to {iso(int(t[-1]))} GPST",
                wanted=f"fixes within {iso(int(min(o[0] for o in others)))} to {iso(int(max(o[-1] for o in others)))}",
            )


def _check_places(receivers: Sequence[Receiver], cleaned: Sequence[tuple[I8, F8, F8]]) -> None:
    """Refuse receivers that are never near each other: those of different vehicles, or of different datums."""
    for k, (t, pos, cov) in enumerate(cleaned):
        for j in range(k):
            other_t, other_pos, other_cov = cleaned[j]
            after = np.clip(np.searchsorted(other_t, t), 1, max(len(other_t) - 1, 1))
            left, right = after - 1, np.minimum(after, len(other_t) - 1)
            at = np.where(np.abs(t - other_t[left]) <= np.abs(other_t[right] - t), left, right)
            moved = FASTEST_MPS * np.abs(t - other_t[at]) * 1e-9
            apart = np.maximum(np.linalg.norm(pos - other_pos[at], axis=1) - moved, 0.0)
            claimed = np.sqrt(np.einsum("nii->n", cov + other_cov[at]))
            limit = np.minimum(np.maximum(APART_SIGMAS * claimed, APART_LEAST_M), APART_M)
            if np.quantile(apart / limit, NEVER_NEARER) > 1.0:
                raise StarwiseError(
                    "receivers are never near each other: not of one place",
                    file=receivers[k].name,
                    found=f"{float(np.median(apart)):.0f} m from {receivers[j].name} in the middle",
                    wanted=f"receivers on one vehicle, within {float(np.median(limit)):.0f} m of each other",
                )


def _cleaned(receiver: Receiver, options: FuseConfig) -> tuple[I8, F8, F8]:
    """Times, positions and covariances of the fixes that there are, in order, one at a time."""
    finite = np.isfinite(receiver.pos_e).all(axis=1)
    if not finite.any():
        raise StarwiseError("no position fix", file=receiver.name)
    t, first = np.unique(receiver.t_ns[finite], return_index=True)
    pos, cov = receiver.pos_e[finite][first], receiver.cov_e[finite][first].copy()
    good = np.isfinite(cov).all(axis=(1, 2)) & (np.nan_to_num(np.einsum("nii->ni", cov)) > 0.0).all(axis=1)
    bad = np.asarray(~good)
    if bad.any():
        llh = geodetic_from_ecef(pos[bad])
        C = rotations_ne_enu(llh[:, 0], llh[:, 1])
        own = np.diag(np.square([options.sigma_horizontal_m] * 2 + [options.sigma_vertical_m]))
        cov[bad] = C.transpose(0, 2, 1) @ own @ C
    return t.astype(np.int64), pos, cov


def _ledger(epochs: _Epochs, fused_e: F8, used: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """A row per fix."""
    at, k = np.nonzero(np.isfinite(epochs.pos_e[:, :, 0]))
    llh = geodetic_from_ecef(fused_e)
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])
    d = np.einsum("nij,nj->ni", C[at], epochs.pos_e[at, k] - fused_e[at])
    return {
        "t_ns": epochs.t_ns[at],
        "receiver": k.astype(np.int32),
        "used": used[at, k],
        "east_m": d[:, 0],
        "north_m": d[:, 1],
        "up_m": d[:, 2],
    }
