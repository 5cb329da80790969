"""Accuracy of every method on the shared static sets, beside Debian RTKLIB's single point positioning.

python benchmarks/accuracy.py [--json] [--methods lsq,ekf,s3ekf] [--dynamics static] [--sp3]
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

import numpy as np

import starwise
from datasets import DATA, STATIC, DataSet, rtklib_spp, scratch, truth_ecef
from starwise.frames import C_ne_enu, geodetic_from_ecef


def errors_enu(pos_e: np.ndarray, origin: np.ndarray) -> np.ndarray:
    lat, lon, _ = geodetic_from_ecef(origin)
    return (pos_e - origin) @ C_ne_enu(lat, lon).T


def row(data: DataSet, methods: list[str], dynamics: str, sp3: bool, folder: Path) -> dict[str, object]:
    truth = truth_ecef(data.truth or "")
    _, pos, _ = rtklib_spp(data, folder)
    e = errors_enu(pos, truth)
    result: dict[str, object] = {
        "set": data.name,
        "rtklib_epochs": len(pos),
        "rtklib_rms_2d_m": float(np.sqrt((e[:, :2] ** 2).sum(1).mean())),
        "rtklib_rms_3d_m": float(np.sqrt((e**2).sum(1).mean())),
        "rtklib_mean_enu_m": e.mean(0).round(3).tolist(),
    }
    for method in methods:
        extra = {"ephemeris": DATA / data.sp3} if sp3 and data.sp3 else {}
        if extra and data.clk:
            extra["clock"] = DATA / data.clk
        solution = starwise.solve(
            DATA / data.obs, *(DATA / n for n in data.nav),
            method=method, dynamics=dynamics, systems=data.systems, **extra,
        )  # fmt: skip
        ok = solution.has_position
        e = errors_enu(solution.pos_e[ok], truth)
        result[f"{method}_epochs"] = int(ok.sum())
        result[f"{method}_flagged"] = int(((solution.status != 0) & ok).sum())
        result[f"{method}_rms_2d_m"] = float(np.sqrt((e[:, :2] ** 2).sum(1).mean()))
        result[f"{method}_rms_3d_m"] = float(np.sqrt((e**2).sum(1).mean()))
        result[f"{method}_mean_enu_m"] = e.mean(0).round(3).tolist()
        result[f"{method}_ratio"] = result[f"{method}_rms_3d_m"] / result["rtklib_rms_3d_m"]  # type: ignore[operator]
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--methods", default="lsq,ekf,s3ekf")
    parser.add_argument("--dynamics", default="static")
    parser.add_argument("--sp3", action="store_true", help="precise orbits where the set has them")
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    if shutil.which("rnx2rtkp") is None:
        raise SystemExit("rnx2rtkp is not installed (Debian package rtklib)")
    methods = args.methods.split(",")
    rows = []
    with scratch() as folder:
        for data in STATIC:
            if args.only in data.name and not (args.sp3 and data.sp3 is None):
                rows.append(row(data, methods, args.dynamics, args.sp3, Path(folder)))
    if args.json:
        print(json.dumps(rows, indent=1))
        return
    print(
        f"{'set':18s} {'RTKLIB n':>8s} {'3D m':>7s}"
        + "".join(f" {m + ' n':>8s} {'flag':>4s} {'3D m':>7s} {'ratio':>6s}" for m in methods)
    )
    for r in rows:
        line = f"{r['set']:18s} {r['rtklib_epochs']:8d} {r['rtklib_rms_3d_m']:7.3f}"
        for m in methods:
            line += f" {r[m + '_epochs']:8d} {r[m + '_flagged']:4d} {r[m + '_rms_3d_m']:7.3f} {r[m + '_ratio']:6.3f}"
        print(line)
        print(
            "   mean ENU: RTKLIB", r["rtklib_mean_enu_m"], *(f"{m} {r[m + '_mean_enu_m']}" for m in methods)
        )


if __name__ == "__main__":
    main()
