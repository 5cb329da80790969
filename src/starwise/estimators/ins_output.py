"""What an inertial filter gives: room for its outputs, and the nouns made of them."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.config_inertial import InertialConfig
from starwise.constants import EPOCH_COASTED, EPOCH_OK, NS
from starwise.errors import StarwiseError
from starwise.estimators.ins_align import FixTable, Start, roll_pitch_yaw
from starwise.estimators.sessions import joined
from starwise.frames import ecef_from_geodetic, rotations_ne_enu
from starwise.kernels.ins_run import Out
from starwise.kernels.ins_smooth import Records
from starwise.models.inertial import InertialState, Intervals
from starwise.types import F8, Inertial, Layout, Solution


@dataclass(frozen=True)
class InertialRun:
    """What an inertial filter says at its epochs.

    Attributes
    ----------
    solution : Solution
        Of the antenna; ``extra`` holds attitude, biases and what else was estimated, with sigmas.
    nav : (n, 10) float64
        Of the sensor: quaternion, velocity (north, east, down), latitude, longitude, height.
    est, sigma : (n, m) float64
        Estimates (first nine: 0) and their standard deviations, by ``layout``.
    layout : Layout
    pos_cov, vel_cov : (n, 3, 3) float64
        Of the antenna, north, east, down.
    fixes : dict of arrays
        Per position: ``t_ns``, ``innovation_m`` (north, east, down), ``nis``, ``weight`` (below 1: outside the gate);
        ``velocity_t_ns`` ... likewise per velocity.
    constraints : dict
        Number and mean NIS of constraint, rest, barometer, odometer; ``innovations`` (k, 4): time (s), right, down,
        speed. After gaps too long to bridge: of the first stretch.
    start_ns : int
    """

    solution: Solution
    nav: F8
    est: F8
    sigma: F8
    layout: Layout
    pos_cov: F8
    vel_cov: F8
    fixes: dict[str, NDArray[Any]] = field(default_factory=dict)
    constraints: dict[str, Any] = field(default_factory=dict)
    start_ns: int = 0


def join_runs(work: Callable[[Inertial], InertialRun], parts: list[Inertial]) -> InertialRun:
    """Run each stretch of readings by itself; those that cannot be navigated are left out, with a note.

    Raises
    ------
    StarwiseError
        None of them can be navigated: what is wrong with the first.
    """
    if len(parts) == 1:
        return work(parts[0])
    runs: list[InertialRun] = []
    failed: list[StarwiseError] = []
    for part in parts:
        try:
            runs.append(work(part))
        except StarwiseError as error:
            failed.append(error)
    if not runs:
        raise failed[0]
    notes = [f"{len(parts)} stretches of readings between gaps too long to bridge: the filter begins anew in each"]
    notes += [f"{len(failed)} of them cannot be navigated: {failed[0].message}"] if failed else []
    whole = joined([run.solution for run in runs])
    names = list(dict.fromkeys(name for run in runs for name in run.layout.names))
    if any(len(run.layout) != len(names) for run in runs):
        names = [name for name in names if all(name in run.layout for run in runs)]

    def stack(values: list[F8]) -> F8:
        return np.concatenate([v[:, r.layout.indices(names)] for v, r in zip(values, runs, strict=True)])

    return replace(
        runs[0],
        solution=replace(whole, provenance={**whole.provenance, "notes": [*notes, *whole.provenance["notes"]]}),
        nav=np.concatenate([run.nav for run in runs]),
        est=stack([run.est for run in runs]),
        sigma=stack([run.sigma for run in runs]),
        layout=Layout(tuple(names)),
        pos_cov=np.concatenate([run.pos_cov for run in runs]),
        vel_cov=np.concatenate([run.vel_cov for run in runs]),
        fixes={key: np.concatenate([run.fixes[key] for run in runs]) for key in runs[0].fixes},
    )


@dataclass(frozen=True)
class Aids:
    """What aided at which times: s since the first reading, NIS, its degrees of freedom, satellites used."""

    t: F8
    nis: F8
    dof: NDArray[Any]
    n_used: NDArray[Any]


def empty_out(n: int, k: int, p: int, q: int, c: int, keep: bool) -> Out:
    """Room for k nodes of n elements, p positions, q velocities, c constraints; ``keep`` for smoothing."""
    nan = np.nan
    return Out(
        nav=np.full((k, 10), nan), est=np.full((k, n), nan), P=np.zeros((k if keep else 0, n, n)),
        var=np.full((k, n), nan), omega=np.zeros((k, 3)), att_cov=np.full((k, 3, 3), nan),
        pos_cov=np.full((k, 3, 3), nan), vel_cov=np.full((k, 3, 3), nan),
        pos_v=np.full((p, 3), nan), pos_nis=np.full(p, nan), pos_weight=np.full(p, nan),
        vel_v=np.full((q, 3), nan), vel_nis=np.full(q, nan), vel_weight=np.full(q, nan),
        pseudo=np.zeros((4, 2)), pseudo_v=np.full((c, 3), nan),
    )  # fmt: skip


def empty_records(n: int, k: int) -> Records:
    """Room for k records of n elements."""
    return Records(np.zeros(k, np.int64), np.zeros(k, np.int64), np.zeros((k, 10 * n + 12)), np.zeros(1, np.int64))


def quaternions_to_dcm(q: F8) -> F8:
    """Rotations C_nb (n, 3, 3) of quaternions (n, 4), scalar first."""
    a, b, c, d = q.T
    C = np.empty((len(q), 3, 3))
    C[:, 0, 0], C[:, 1, 1] = a * a + b * b - c * c - d * d, a * a - b * b + c * c - d * d
    C[:, 2, 2] = a * a - b * b - c * c + d * d
    C[:, 0, 1], C[:, 1, 0] = 2.0 * (b * c - a * d), 2.0 * (b * c + a * d)
    C[:, 0, 2], C[:, 2, 0] = 2.0 * (b * d + a * c), 2.0 * (b * d - a * c)
    C[:, 1, 2], C[:, 2, 1] = 2.0 * (c * d - a * b), 2.0 * (c * d + a * b)
    return C


def packed(
    iv: Intervals, nodes: F8, aids: Aids, marks: F8, table: FixTable, start: Start,
    state: InertialState, config: InertialConfig, out: Out,
) -> InertialRun:  # fmt: skip
    """Outputs of the kernel as nouns."""
    t0, at = int(iv.t_ns[0]), state.at
    C = quaternions_to_dcm(out.nav[:, :4])
    arm = out.est[:, at.arm : at.arm + 3] if at.arm >= 0 else np.broadcast_to(config.lever_arm_m, (len(nodes), 3))
    llh = out.nav[:, 7:10]
    C_en = rotations_ne_enu(llh[:, 0], llh[:, 1])[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])[:, None]
    C_ne = C_en.transpose(0, 2, 1)
    arm_n = (C @ arm[:, :, None])[:, :, 0]
    vel_n = out.nav[:, 4:7] + (C @ np.cross(out.omega, arm)[:, :, None])[:, :, 0]
    k = len(nodes)
    nis, dof, n_used = np.full(k, np.nan), np.zeros(k, dtype=np.int32), np.zeros(k, dtype=np.int32)
    at_us = np.rint(aids.t * 1e6).astype(np.int64)
    where = np.clip(np.searchsorted(at_us, np.rint(nodes * 1e6).astype(np.int64)), 0, max(len(at_us) - 1, 0))
    used = np.zeros(k, dtype=bool)
    if len(at_us):
        used = (at_us[where] == np.rint(nodes * 1e6)) & np.isfinite(aids.nis[where])
        nis[used], dof[used], n_used[used] = aids.nis[where][used], aids.dof[where][used], aids.n_used[where][used]
    status = np.where(used, EPOCH_OK, EPOCH_COASTED).astype(np.uint8)
    solution = Solution(
        t_ns=t0 + np.rint(nodes * NS).astype(np.int64),
        status=status,
        pos_e=ecef_from_geodetic(llh) + (C_ne @ arm_n[:, :, None])[:, :, 0],
        vel_e=(C_ne @ vel_n[:, :, None])[:, :, 0],
        cov_pos=C_ne @ out.pos_cov @ C_en,
        cov_vel=C_ne @ out.vel_cov @ C_en,
        clock_m=np.empty((k, 0)), drift_mps=np.empty((k, 0)), clock_sigma_m=np.empty((k, 0)), clock_names=(),
        n_used=n_used,
        dop=np.full((k, 4), np.nan),
        nis=nis,
        dof=dof,
        extra=_extra(C, out, state),
    )  # fmt: skip
    kinds = ("constraint", "rest", "barometer", "odometer")
    constraints: dict[str, Any] = {
        name: {"count": int(out.pseudo[i, 0]), "mean_nis": float(out.pseudo[i, 1] / max(out.pseudo[i, 0], 1.0))}
        for i, name in enumerate(kinds)
    }
    constraints["innovations"] = np.column_stack([marks, out.pseudo_v])
    return InertialRun(
        solution, out.nav, out.est, np.sqrt(np.maximum(out.var, 0.0)), state.layout, out.pos_cov, out.vel_cov,
        fixes={
            "t_ns": t0 + np.rint(table.t * NS).astype(np.int64), "innovation_m": out.pos_v, "nis": out.pos_nis,
            "weight": out.pos_weight, "velocity_t_ns": t0 + np.rint(table.tv * NS).astype(np.int64),
            "velocity_innovation_mps": out.vel_v, "velocity_nis": out.vel_nis, "velocity_weight": out.vel_weight,
        },
        constraints=constraints,
        start_ns=t0 + round(start.t_s * NS),
    )  # fmt: skip


_UNITS: dict[str, tuple[str, float]] = {
    "bg": ("gyro_bias_{}_dph", math.degrees(3600.0)), "bgc": ("gyro_constant_{}_dph", math.degrees(3600.0)),
    "ba": ("accel_bias_{}_mps2", 1.0), "bac": ("accel_constant_{}_mps2", 1.0),
    "sg": ("gyro_scale_{}_ppm", 1e6), "sa": ("accel_scale_{}_ppm", 1e6),
    "mount": ("mount_{}_deg", math.degrees(1.0)), "axle": ("axle_{}_m", 1.0), "steer": ("steer_{}", 1.0),
    "arm": ("lever_arm_{}_m", 1.0), "tau": ("time_offset_s", 1.0), "baro": ("baro_error_m", 1.0),
    "odo": ("odometer_scale", 1.0),
}  # fmt: skip


def _extra(C: F8, out: Out, state: InertialState) -> dict[str, F8]:
    """Columns beside position and velocity: attitude and every other estimate, each with its sigma."""
    rpy = roll_pitch_yaw(C)
    columns: dict[str, F8] = {}
    cos, sin = np.cos(rpy[:, 2]), np.sin(rpy[:, 2])
    cov = out.att_cov
    ahead = cov[:, 0, 0] * cos**2 + 2.0 * cov[:, 0, 1] * cos * sin + cov[:, 1, 1] * sin**2
    across = cov[:, 0, 0] * sin**2 - 2.0 * cov[:, 0, 1] * cos * sin + cov[:, 1, 1] * cos**2
    for i, (name, var) in enumerate((("roll", ahead), ("pitch", across), ("yaw", cov[:, 2, 2]))):
        columns[f"{name}_deg"] = np.degrees(rpy[:, i])
        columns[f"sigma_{name}_deg"] = np.degrees(np.sqrt(np.maximum(var, 0.0)))
    for j, full in enumerate(state.layout.names):
        if j < 9:
            continue
        part, _, member = full.partition(".")
        if part in ("clk", "drift", "isb"):
            continue  # clocks have their place in a solution
        pattern, scale = _UNITS[part]
        name = pattern.format(member)
        columns[name] = scale * out.est[:, j]
        columns[f"sigma_{name}"] = scale * np.sqrt(np.maximum(out.var[:, j], 0.0))
    return columns
