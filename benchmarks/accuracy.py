"""Accuracy of every method on the shared static sets, beside Debian RTKLIB's single point positioning.

python benchmarks/accuracy.py [--json] [--methods lsq,ekf,s3ekf] [--dynamics static] [--sp3] [--no-post]
                              [--error-model white]

RTKLIB takes the nearest broadcast record, also one from the future; so does starwise here, but for ``--no-post``.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

import starwise
from datasets import DATA, STATIC, DataSet, rtklib_spp, scratch, truth_ecef
from starwise.frames import C_ne_enu, geodetic_from_ecef
from starwise.types import Solution


def errors_enu(pos_e: np.ndarray, origin: np.ndarray) -> np.ndarray:
    lat, lon, _ = geodetic_from_ecef(origin)
    return (pos_e - origin) @ C_ne_enu(lat, lon).T


def summary(solution: Solution, truth: np.ndarray) -> dict[str, Any]:
    ok = solution.has_position
    e = errors_enu(solution.pos_e[ok], truth)
    return {
        "epochs": int(ok.sum()),
        "flagged": int(((solution.status != 0) & ok).sum()),
        "rms_2d_m": float(np.sqrt((e[:, :2] ** 2).sum(1).mean())),
        "rms_3d_m": float(np.sqrt((e**2).sum(1).mean())),
        "mean_enu_m": e.mean(0).round(3).tolist(),
    }


def row(
    data: DataSet, methods: list[str], dynamics: str, model: str, sp3: bool, post: bool, folder: Path
) -> dict[str, Any]:
    truth = truth_ecef(data.truth or "")
    _, pos, _ = rtklib_spp(data, folder, sp3)
    e = errors_enu(pos, truth)
    rtklib = {"epochs": len(pos), "rms_3d_m": float(np.sqrt((e**2).sum(1).mean())), "mean_enu_m": e.mean(0).tolist()}
    result: dict[str, Any] = {"set": data.name, "rtklib": rtklib}
    solutions = {}
    for method in methods:
        extra: dict[str, Any] = {"post": post, "error_model": "white" if method == "lsq_same" else model}
        if sp3 and data.sp3:
            extra["ephemeris"] = DATA / data.sp3
            if data.clk:
                extra["clock"] = DATA / data.clk
        if method == "lsq_same":  # the models that the .conf gives RTKLIB: standard atmosphere over sin(elevation)
            extra["troposphere"] = "saastamoinen"
        files = [DATA / data.obs, *(DATA / n for n in data.nav)]
        name = method.removesuffix("_same")
        solutions[method] = starwise.solve(*files, method=name, dynamics=dynamics, systems=data.systems, **extra)
        result[method] = summary(solutions[method], truth)
        result[method]["ratio"] = result[method]["rms_3d_m"] / rtklib["rms_3d_m"]
    if {"ekf", "s3ekf"} <= set(methods):
        apart = np.linalg.norm(solutions["ekf"].pos_e - solutions["s3ekf"].pos_e, axis=1)
        result["ekf_s3ekf_max_m"] = float(np.nanmax(apart))
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--methods", default="lsq_same,lsq,ekf,s3ekf")
    parser.add_argument("--dynamics", default="static")
    parser.add_argument("--error-model", default="colored", help="colored, or white")
    parser.add_argument("--sp3", action="store_true", help="precise orbits, on the sets that have them")
    parser.add_argument("--no-post", action="store_true", help="only ephemerides sent before the epoch, the default")
    parser.add_argument("--only", default="", help="sets whose name contains this")
    args = parser.parse_args()
    if shutil.which("rnx2rtkp") is None:
        raise SystemExit("rnx2rtkp is not installed (Debian package rtklib)")
    methods = args.methods.split(",")
    rows = []
    with scratch() as folder:
        for data in STATIC:
            if args.only in data.name and not (args.sp3 and data.sp3 is None):
                rows.append(
                    row(data, methods, args.dynamics, args.error_model, args.sp3, not args.no_post, Path(folder))
                )
    if args.json:
        print(json.dumps(rows, indent=1))
        return
    print(f"{'3D RMS, m; n solved; / RTKLIB':28s}" + "".join(f"{m:>21s}" for m in ["RTKLIB", *methods]))
    for r in rows:
        cells = [f"{r['rtklib']['rms_3d_m']:8.3f} {r['rtklib']['epochs']:5d}      "]
        cells += [f"{r[m]['rms_3d_m']:8.3f} {r[m]['epochs']:5d} {r[m]['ratio']:5.3f}" for m in methods]
        last = f"  ekf-s3ekf {r['ekf_s3ekf_max_m']:.1e} m" if "ekf_s3ekf_max_m" in r else ""
        print(f"{r['set']:28s}" + "".join(f"{c:>21s}" for c in cells) + last, flush=True)
    means = [f"{np.exp(np.mean([np.log(r[m]['ratio']) for r in rows])):20.3f}" for m in methods]
    print(f"{'geometric mean of ratios':49s}" + " ".join(means))


if __name__ == "__main__":
    main()
