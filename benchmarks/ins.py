"""Inertial navigation on real cars: withheld fixes, delays, foreign references; and its speed beside python-ins.

python benchmarks/ins.py [drive] [delay] [toronto] [speed]        (all by default)

Data: shared measurements, see tests/conftest.py. `speed` compares with python-ins where that is installed.
"""

import dataclasses
import gzip
import os
import sys
import time
from pathlib import Path

import numpy as np

from starwise.config_inertial import InertialConfig
from starwise.constants import NS
from starwise.estimators.ins import loose
from starwise.estimators.ins_align import mount_rotation, roll_pitch_yaw
from starwise.estimators.ins_output import InertialRun, quaternions_to_dcm
from starwise.estimators.ins_tight import fixes_of
from starwise.frames import ecef_from_geodetic, geodetic_from_ecef, rotations_ne_enu
from starwise.gnsstime import parse_time
from starwise.io.imu import read_imu
from starwise.io.pos import read_pos
from starwise.kernels.strapdown import mechanise
from starwise.models.inertial import intervals
from starwise.types import Fixes, Inertial

DATA = Path(os.environ.get("STARWISE_SHARED_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")) / "imu"
DRIVE = {"lever_arm_m": [0.0, -0.05, 0.0], "velocity_lag_s": 0.135}
CAR = {"constraint": True, "rest": True}
GAP_S, PERIOD_S, SETTLE_S = 15.0, 40.0, 40.0
INSIDE_95 = 5.991


def drive() -> tuple[Inertial, Fixes]:
    folder = DATA / "rtklibexplorer_drive_0708"
    return read_imu(folder / "imu_1934.csv", "rtklibexplorer-drive"), fixes_of(read_pos(folder / "gnss_1934_sf.pos"))


def part(fixes: Fixes, keep: np.ndarray) -> Fixes:
    return dataclasses.replace(
        fixes, t_ns=fixes.t_ns[keep], available_ns=fixes.available_ns[keep], pos_e=fixes.pos_e[keep],
        cov_pos=fixes.cov_pos[keep], vel_e=fixes.vel_e[keep], cov_vel=fixes.cov_vel[keep],
    )  # fmt: skip


def horizontal(run: InertialRun, pos_e: np.ndarray, cov: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Errors east, north (n, 2), m, against positions at the run's epochs, and squared distances in its ellipse.

    ``cov`` (n, 3, 3), ECEF: what those positions claim of themselves.
    """
    llh = geodetic_from_ecef(pos_e)
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])
    e = (C @ (run.solution.pos_e - pos_e)[:, :, None])[:, :2, 0]
    P = run.solution.cov_pos if cov is None else run.solution.cov_pos + cov
    P = (C @ P @ C.transpose(0, 2, 1))[:, :2, :2]
    return e, np.einsum("ki,kij,kj->k", e, np.linalg.inv(P), e)


def gaps(inertial: Inertial, fixes: Fixes, config: InertialConfig, reference=None, begin_s=0.0, end_s=1e9) -> dict:
    """Errors in gaps of 15 s out of every 40 s at eight phases, against the withheld fixes or a reference."""
    out: dict[str, list] = {"ends": [], "worst": [], "all": [], "inside": [], "mount": [], "nis": []}
    t0 = inertial.t_ns[0]
    t = (fixes.t_ns - t0) * 1e-9
    for phase in range(0, 40, 5):
        gone = (t - phase) % PERIOD_S < GAP_S
        run = loose(part(fixes, ~gone), inertial, config, epochs_ns=fixes.t_ns[gone])
        k = np.clip(np.searchsorted(fixes.t_ns, run.solution.t_ns - 1_000_000), 0, fixes.n - 1)
        truth = fixes.pos_e[k] if reference is None else reference(run.solution.t_ns)
        e, d2 = horizontal(run, truth, fixes.cov_pos[k] if reference is None else None)
        h, at = np.hypot(e[:, 0], e[:, 1]), (run.solution.t_ns - t0) * 1e-9
        first = (run.start_ns - t0) * 1e-9 + SETTLE_S
        step = np.median(np.diff(t))
        for start in np.arange(phase, t[-1] - GAP_S, PERIOD_S):
            i = np.flatnonzero((at >= start - 1e-3) & (at < start + GAP_S - 1e-3))
            if start < max(first, begin_s) or start + GAP_S > end_s or len(i) < 0.9 * GAP_S / step:
                continue
            out["ends"].append(h[i[-1]])
            out["worst"].append(h[i].max())
            out["all"].append(h[i])
            out["inside"].append(d2[i] < INSIDE_95)
        if "mount_yaw_deg" in run.solution.extra:
            out["mount"].append([run.solution.extra[f"mount_{axis}_deg"][-1] for axis in ("pitch", "yaw")])
        out["nis"].append(run.solution.provenance["nis_per_dof"])
    return out


def line(name: str, result: dict) -> str:
    def points(values: list) -> str:
        return " / ".join(f"{v:5.2f}" for v in np.percentile(values, [50, 68, 95]))

    coverage = np.concatenate(result["inside"]).mean()
    text = f"{name:28s} {len(result['ends']):3d} gaps  end {points(result['ends'])}  worst {points(result['worst'])}"
    text += f"  coverage {coverage:.3f}  NIS/dof {np.mean(result['nis']):.2f}"
    if result["mount"]:
        low, high = np.min(result["mount"], axis=0), np.max(result["mount"], axis=0)
        text += f"  mount pitch {low[0]:.2f}..{high[0]:.2f} yaw {low[1]:.2f}..{high[1]:.2f}"
    return text


CASES = {
    "free inertial": {},
    "constraint": {"vehicle": {"constraint": True}},
    "constraint and rest": {"vehicle": CAR},
    "smoothed": {"vehicle": CAR, "smooth": True},
    "free inertial, smoothed": {"smooth": True},
}


def bench_drive() -> None:
    inertial, fixes = drive()
    print("Withheld RTK fixes, 15 s in every 40 s, 8 phases; horizontal, m, 50 / 68 / 95 %")
    for title, low, high in (("whole drive", 0.0, 1e9), ("first 300 s (constants chosen here)", 0.0, 300.0),
                             ("after 300 s", 300.0, 1e9)):  # fmt: skip
        print(f"-- {title}")
        for name, change in CASES.items():
            config = InertialConfig.from_dict({**DRIVE, **change})
            print(line(name, gaps(inertial, fixes, config, begin_s=low, end_s=high)))


def bench_delay() -> None:
    """Fixes 0.5 s late: predicted to now from the fix's own time (replay), or taken as fresh."""
    inertial, fixes = drive()
    config = InertialConfig.from_dict({**DRIVE, "vehicle": CAR})
    late = dataclasses.replace(fixes, t_ns=fixes.t_ns + NS // 2, available_ns=fixes.t_ns + NS // 2)
    in_order = loose(fixes, inertial, config)
    iv = intervals(inertial, config)
    at = (in_order.solution.t_ns - iv.t_ns[0]) * 1e-9
    k = np.clip(np.searchsorted(fixes.t_ns, in_order.solution.t_ns - 1_000_000), 0, fixes.n - 1)
    arm, errors = np.array(config.lever_arm_m), []
    for i in range(len(at)):
        j = i + 2  # the estimate of t, run on to t + 0.5 s without further fixes
        if j >= len(at) or abs(at[j] - at[i] - 0.5) > 0.01 or at[i] < at[0] + SETTLE_S:
            continue
        nav = in_order.nav[i].copy()
        a, b = np.searchsorted(iv.read.t, at[i]), np.searchsorted(iv.read.t, at[j])
        dt = np.diff(np.concatenate([[at[i]], iv.read.t[a:b], [at[j]]]))
        rows = np.arange(a - 1, b)
        share = (dt / np.diff(iv.read.t)[rows])[:, None]
        bias = in_order.est[i]
        dtheta = iv.read.dtheta[rows] * share - bias[9:12] * dt[:, None]
        dv = iv.read.dv[rows] * share - bias[12:15] * dt[:, None]
        mechanise(nav, np.ascontiguousarray(dtheta), np.ascontiguousarray(dv), dt, np.zeros(7), np.empty((len(dt), 10)))
        llh = nav[7:10]
        C_ne = rotations_ne_enu(llh[:1], llh[1:2])[0]
        C_nb = quaternions_to_dcm(nav[None, :4])[0]
        pos = ecef_from_geodetic(llh) + C_ne.T @ (C_nb @ arm)[[1, 0, 2]] * [1.0, 1.0, 1.0]
        errors.append((C_ne @ (pos - fixes.pos_e[k[j]]))[:2])
    rms = np.sqrt(np.mean(np.sum(np.square(errors), axis=1)))
    e, _ = horizontal(in_order, fixes.pos_e[k])
    settled = at > at[0] + SETTLE_S
    print("Fixes 0.5 s late; horizontal RMS against the fix of the moment, m")
    print(f"no delay            {np.sqrt(np.mean((e[settled] ** 2).sum(axis=1))):.3f}")
    print(f"replay (true tags)  {rms:.3f}")
    ignored = loose(late, inertial, config)
    t = (ignored.solution.t_ns - iv.t_ns[0]) * 1e-9
    k = np.clip(np.searchsorted(fixes.t_ns, ignored.solution.t_ns - 1_000_000), 0, fixes.n - 1)
    e, _ = horizontal(ignored, fixes.pos_e[k])
    print(f"ignored             {np.sqrt(np.mean((e[t > t[0] + SETTLE_S] ** 2).sum(axis=1))):.3f}")
    print("   told:", *(note for note in ignored.solution.provenance["notes"] if "contradict" in note))


def toronto(name: str) -> tuple[Inertial, Fixes, dict[str, np.ndarray], dict[str, np.ndarray], int]:
    """Readings, fixes, reference positions and attitudes of a folder in the "generic replay" form."""

    def table(file: str) -> np.ndarray:
        with gzip.open(DATA / name / file, "rt") as stream:
            return np.genfromtxt(stream, delimiter=",", names=True)

    t0 = parse_time("2026-01-01T00:00:00")
    g = table("gnss.csv.gz")
    t_ns = t0 + np.rint(g["t_s"] * 1e9).astype(np.int64)
    llh = np.stack([np.radians(g["lat_deg"]), np.radians(g["lon_deg"]), g["height_m"]], axis=1)
    C_en = rotations_ne_enu(llh[:, 0], llh[:, 1])[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])[:, None]
    C_ne = C_en.transpose(0, 2, 1)
    vel = np.stack([g[f"v{a}_mps"] for a in "ned"], axis=1)
    R_p, R_v = (
        np.stack([g[f"{kind}_std_{a}_{unit}"] for a in "ned"], axis=1)[:, :, None] ** 2 * np.eye(3)
        for kind, unit in (("pos", "m"), ("vel", "mps"))
    )
    fixes = Fixes(
        t_ns, t_ns, ecef_from_geodetic(llh), C_ne @ R_p @ C_en, (C_ne @ vel[:, :, None])[:, :, 0], C_ne @ R_v @ C_en
    )
    inertial = read_imu(DATA / name / "imu.csv.gz", "generic-replay")
    return inertial, fixes, table("reference_position.csv.gz"), table("reference_attitude.csv.gz"), t0


def bench_toronto() -> None:
    print("u-blox cars against the receiver's own fused solution (agreement, not accuracy)")
    for name in ("urban-mixed-turns-nominal-001", "parking-lot-figure8-nominal-001"):
        inertial, fixes, place, attitude, t0 = toronto(name)

        def reference(t_ns: np.ndarray, place=place, t0=t0) -> np.ndarray:
            t = (t_ns - t0) * 1e-9
            lat, lon, h = (np.interp(t, place["t_s"], place[c]) for c in ("lat_deg", "lon_deg", "height_m"))
            return ecef_from_geodetic(np.stack([np.radians(lat), np.radians(lon), h], axis=1))

        # the sensor's x axis points about 90 deg to the right: declared; lever arm and calibration are not known
        config = InertialConfig.from_dict({"vehicle": {**CAR, "mount_yaw_deg": 90.0}})
        run = loose(fixes, inertial, config)
        t = (run.solution.t_ns - t0) * 1e-9
        m = run.layout.index("mount.pitch")
        C_nb = quaternions_to_dcm(run.nav[:, :4])
        C_nv = np.stack([C @ mount_rotation(*x).T for C, x in zip(C_nb, run.est[:, m : m + 2], strict=True)])
        rpy = np.degrees(roll_pitch_yaw(C_nv))
        known = (t > t[0] + 60.0) & (np.interp(t, attitude["t_s"], attitude["yaw_deg"] != 0.0) == 1.0)
        print(f"-- {name}: NIS/dof {run.solution.provenance['nis_per_dof']:.2f}")
        for i, axis in enumerate(("roll", "pitch", "yaw")):
            other = np.interp(t, attitude["t_s"], np.unwrap(attitude[f"{axis}_deg"], period=360.0))
            d = ((rpy[:, i] - other + 180.0) % 360.0 - 180.0)[known]
            print(f"   {axis:5s} difference, deg: mean {d.mean():6.2f}, sd {d.std():5.2f}")
        e, _ = horizontal(run, reference(run.solution.t_ns))
        ours = np.percentile(np.hypot(e[known, 0], e[known, 1]), [50, 68, 95])
        raw = np.linalg.norm((reference(fixes.t_ns) - fixes.pos_e), axis=1)[(fixes.t_ns - t0) * 1e-9 > t[0] + 60.0]
        print("   horizontal difference, m:", ours.round(2), " of the fixes themselves (3D):",
              np.percentile(raw, [50, 68, 95]).round(2))  # fmt: skip
        for against, where in (("reference", reference), ("withheld fixes", None)):
            for case, change in (("free inertial", {}), ("constraint and rest", {**CAR, "mount_yaw_deg": 90.0})):
                config = InertialConfig.from_dict({"vehicle": {"mount_yaw_deg": 90.0, **change}})
                print("   " + line(f"{case}, {against}", gaps(inertial, fixes, config, where)))


def rate(work, n: int, times: int = 5) -> float:
    """Steps per second, the best of some."""
    best = np.inf
    for _ in range(times):
        began = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - began)
    return n / best


def bench_speed() -> None:
    n, dt = 50_000, 0.01
    rng = np.random.default_rng(0)
    gyro = rng.normal(size=(n + 1, 3)) * 1e-3
    accel = rng.normal(size=(n + 1, 3)) * 1e-2 + [0.0, 0.0, -0.0981]
    lla = [np.radians(50.0), np.radians(10.0), 100.0]
    nav0, out, dts = np.array([1.0, 0, 0, 0, 10, 10, 0, *lla]), np.empty((n, 10)), np.full(n, dt)
    mechanise(nav0.copy(), gyro[1:], accel[1:], dts, np.zeros(7), out)
    ours = rate(lambda: mechanise(nav0.copy(), gyro[1:], accel[1:], dts, np.zeros(7), out), n)
    print(f"mechanisation, starwise: {ours / 1e6:.2f} million steps/s")
    inertial, fixes = drive()
    config = InertialConfig.from_dict(DRIVE)
    full = InertialConfig.from_dict({**DRIVE, "vehicle": CAR})
    steps = len(inertial.t_ns)
    for name, chosen in (("15 states", config), ("20 states, constraint and rest", full)):
        loose(fixes, inertial, chosen)
        speed = rate(lambda chosen=chosen: loose(fixes, inertial, chosen), steps, 3)
        print(f"drive of 549 s, {name}: {steps / speed:.2f} s, {speed / 1e3:.0f} thousand IMU steps/s")
        if name == "15 states":
            filter_speed = speed
    try:
        import pandas as pd
        import pyins
        from pyins import filters, measurements, strapdown, util
    except ImportError:
        print("python-ins is not installed: no comparison")
        return
    del pyins
    columns = util.GYRO_COLS + util.ACCEL_COLS
    imu = pd.DataFrame(np.hstack([gyro, accel]), index=np.arange(n + 1) * dt, columns=columns)
    pva = pd.Series([50.0, 10.0, 100.0, 10.0, 10.0, 0.0, 0.0, 0.0, 0.0], index=util.TRAJECTORY_COLS, name=0.0)
    made = strapdown.compute_increments_from_imu(imu, "increment")

    def integrate() -> None:
        strapdown.Integrator(pva).integrate(made)

    integrate()
    whole = rate(integrate, n, 3)
    state = [np.empty((n + 1, 3)), np.empty((n + 1, 3)), np.empty((n + 1, 3, 3))]
    state[0][0], state[1][0], state[2][0] = pva.iloc[:3], pva.iloc[3:6], np.eye(3)
    theta = np.ascontiguousarray(made[["theta_x", "theta_y", "theta_z"]])
    dv = np.ascontiguousarray(made[["dv_x", "dv_y", "dv_z"]])
    intervals_s, bare = np.asarray(made.dt), 0.0
    for _ in range(10):  # turn and turn about: other work on the machine hits both
        bare = max(bare, rate(lambda: strapdown.integrate(intervals_s, *state, theta, dv, 0, True), n, 1))
        ours = max(ours, rate(lambda: mechanise(nav0.copy(), gyro[1:], accel[1:], dts, np.zeros(7), out), n, 1))
    print(f"mechanisation, python-ins: {whole / 1e6:.2f} (its Integrator), {bare / 1e6:.2f} (its compiled loop alone)")
    print(f"   starwise ({ours / 1e6:.2f}) is {ours / whole:.1f} and {ours / bare:.1f} times as fast")
    _accuracy(pd, strapdown, util)
    # the feedback filter on a piece of the same drive: 10 s (it takes minutes for more)
    t = (inertial.t_ns - inertial.t_ns[0]) * 1e-9
    piece = (t > 100.0) & (t < 110.0)
    imu = pd.DataFrame(np.hstack([inertial.gyro, inertial.accel])[piece], index=t[piece], columns=columns)
    made = strapdown.compute_increments_from_imu(imu, "rate")
    llh = geodetic_from_ecef(fixes.pos_e)
    tf = (fixes.t_ns - inertial.t_ns[0]) * 1e-9
    near = (tf > 100.0) & (tf < 110.0)
    C = rotations_ne_enu(llh[near, 0], llh[near, 1])[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])[:, None]
    vel = (C @ fixes.vel_e[near, :, None])[:, :, 0]
    position = pd.DataFrame(np.column_stack([np.degrees(llh[near, :2]), llh[near, 2]]), tf[near], util.LLA_COLS)
    velocity = pd.DataFrame(vel, tf[near], util.VEL_COLS)
    first = [*position.iloc[0], *velocity.iloc[0], 0.0, -5.0, np.degrees(np.arctan2(vel[0, 1], vel[0, 0]))]
    start = pd.Series(first, index=util.TRAJECTORY_COLS, name=t[piece][0])
    aids = [measurements.Position(position, 0.05), measurements.NedVelocity(velocity, 0.1)]

    def feedback(step: float) -> None:
        filters.run_feedback_filter(start, 1.0, 1.0, 3.0, 10.0, made, measurements=aids, time_step=step)

    for step in (0.1,):
        began = time.perf_counter()
        feedback(step)
        theirs = len(made) / (time.perf_counter() - began)
        print(
            f"filter, python-ins, covariance every {step:g} s: {theirs / 1e3:.1f} thousand IMU steps/s; starwise "
            f"{filter_speed / theirs:.0f} times as fast (covariance at every reading)"
        )


def _accuracy(pd, strapdown, util) -> None:
    """Both mechanisations on the same increments of a simulated flight."""
    from starwise.frames import C_ne_ned
    from starwise.sim.imu import perfect_imu
    from starwise.sim.sections import Vehicle
    from starwise.sim.trajectory import from_segments

    turn = {"kind": "turn", "rate_dps": 5.0, "angle_deg": 65.0, "roll_in_s": 3.0}
    ways = [{"kind": "straight", "duration_s": 4.0}, turn, {"kind": "straight"}]
    given = {"kind": "aircraft", "start": [-33.0, 151.0, 800.0], "heading_deg": 70.0, "speed_mps": 200.0,
             "segments": ways}  # fmt: skip
    t0 = parse_time("2024-03-30T12:00:00")
    path = from_segments(Vehicle.from_dict(given), t0, 61.0)
    for hz in (25, 100):
        t = t0 + np.rint(np.arange(60 * hz + 1) * (NS / hz)).astype(np.int64)
        read = perfect_imu(path, t, increments=True)
        ends = path.states(t[[1, -1]])
        llh = geodetic_from_ecef(ends.pos_e)
        C = np.stack([C_ne_ned(*p[:2]) for p in llh])
        rpy, vel = roll_pitch_yaw(C @ ends.C_eb), (C @ ends.vel_e[:, :, None])[:, :, 0]
        from starwise.estimators.ins_align import quaternion

        nav = np.concatenate([quaternion((C @ ends.C_eb)[0]), vel[0], llh[0]])
        last = np.array([*read.gyro[0], *read.accel[0], read.dt_s[0]])
        k = len(read.dt_s) - 1
        mechanise(nav, read.gyro[1:].copy(), read.accel[1:].copy(), read.dt_s[1:].copy(), last, np.empty((k, 10)))
        ours = np.linalg.norm(ecef_from_geodetic(nav[7:10]) - ends.pos_e[1])
        index = np.arange(len(read.dt_s)) / hz
        imu = pd.DataFrame(np.hstack([read.gyro, read.accel]), index=index, columns=util.GYRO_COLS + util.ACCEL_COLS)
        made = strapdown.compute_increments_from_imu(imu, "increment")
        first = [*np.degrees(llh[0, :2]), llh[0, 2], *vel[0], *np.degrees(rpy[0])]
        found = strapdown.Integrator(pd.Series(first, index=util.TRAJECTORY_COLS, name=0.0)).integrate(made).iloc[-1]
        other = [np.radians(found["lat"]), np.radians(found["lon"]), found["alt"]]
        theirs = np.linalg.norm(ecef_from_geodetic(other) - ends.pos_e[1])
        print(
            f"   error after a flight of 12 km, {hz} Hz: starwise {ours * 1e3:.3f} mm, python-ins {theirs * 1e3:.3f} mm"
        )


if __name__ == "__main__":
    WORK = {"drive": bench_drive, "delay": bench_delay, "toronto": bench_toronto, "speed": bench_speed}
    for name in sys.argv[1:] or WORK:
        WORK[name]()
