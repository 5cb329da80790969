"""Accuracy and honesty of the default filter on the shared measurements, beside Debian RTKLIB's SPP.

python benchmarks/honesty.py [--dynamics static|vehicle|auto] [--single] [--json] [--only NAME]

For every set at a known point: 3D RMS over all solved epochs as a ratio to RTKLIB's; sessions of two hours with the
filter restarted: share of epochs in which the 95 % ellipsoid holds the truth, NEES per degree of freedom, and the mean
claimed 3D sigma as a ratio to RTKLIB's; then all sessions pooled, with the calibration curve.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import starwise
from datasets import DATA, STATIC, rtklib_spp, scratch, truth_ecef
from starwise.analysis.pool import Run, pool
from starwise.types import Truth


def measure(options: dict[str, Any], only: str = "") -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """A row per set whose name contains ``only``, and what they are together."""
    rows: list[dict[str, Any]] = []
    runs: list[Run] = []
    with scratch() as folder:
        for data in STATIC:
            if only not in data.name:
                continue
            point = truth_ecef(data.truth or "")
            truth = Truth(point, source=data.name)
            files = [DATA / data.obs, *(DATA / name for name in data.nav)]
            whole = starwise.solve(*files, systems=data.systems, **options)
            parts = starwise.solve(*files, systems=data.systems, session_s=7200.0, **options)
            _, theirs, sd = rtklib_spp(data, Path(folder))
            ok = whole.has_position
            run = Run(data.name, parts, truth)
            runs.append(run)
            sessions = pool([run])
            ours = float(np.sqrt(np.mean(np.sum((whole.pos_e[ok] - point) ** 2, axis=1))))
            rtklib = float(np.sqrt(np.mean(np.sum((theirs - point) ** 2, axis=1))))
            rows.append(
                {
                    "set": data.name,
                    "epochs": int(ok.sum()),
                    "epochs_rtklib": len(theirs),
                    "rms_3d_m": ours,
                    "ratio": ours / rtklib,
                    "sigma_ratio": sessions["sigma_3d_mean_m"] / float(np.mean(np.linalg.norm(sd, axis=1))),
                    **{k: sessions[k] for k in ("sessions", "coverage_95", "nees_mean", "sigma_3d_mean_m")},
                }
            )
    total = pool(runs)
    summary = {
        "ratio_geometric_mean": float(np.exp(np.mean([np.log(r["ratio"]) for r in rows]))),
        "sigma_ratio_mean": float(np.average([r["sigma_ratio"] for r in rows], weights=[r["sessions"] for r in rows])),
        **{k: total[k] for k in ("sessions", "coverage_50", "coverage_68", "coverage_95", "nees_mean")},
    }
    return rows, summary


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dynamics", default="static")
    parser.add_argument("--single", action="store_true", help="one frequency only")
    parser.add_argument("--only", default="", help="sets whose name contains this")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    options: dict[str, Any] = {"dynamics": args.dynamics}
    if args.single:
        options["combination"] = "single"
    rows, summary = measure(options, args.only)
    if args.json:
        print(json.dumps({"sets": rows, "pooled": summary}, indent=1))
        return
    print(
        f"{'set':<20}{'epochs':>7}{'RTKLIB':>8}{'RMS m':>7}{'ratio':>7}   "
        f"{'sessions':>8}{'95 %':>6}{'NEES':>6}{'sigma/':>8}"
    )
    for r in rows:
        print(
            f"{r['set']:<20}{r['epochs']:>7}{r['epochs_rtklib']:>8}{r['rms_3d_m']:>7.2f}{r['ratio']:>7.2f}   "
            f"{r['sessions']:>8}{100 * r['coverage_95']:>6.1f}{r['nees_mean']:>6.2f}{r['sigma_ratio']:>8.2f}"
        )
    print(
        f"{'geometric mean; pooled':<42}{summary['ratio_geometric_mean']:>7.3f}   {summary['sessions']:>8}"
        f"{100 * summary['coverage_95']:>6.1f}{summary['nees_mean']:>6.2f}{summary['sigma_ratio_mean']:>8.2f}"
    )
    print(
        f"calibration: inside the 50, 68, 95 % ellipsoid {100 * summary['coverage_50']:.1f}, "
        f"{100 * summary['coverage_68']:.1f}, {100 * summary['coverage_95']:.1f} %"
    )


if __name__ == "__main__":
    main()
