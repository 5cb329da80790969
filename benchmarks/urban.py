"""The street: UrbanNav TST (Hong Kong, u-blox M8T, GPS and BeiDou at 1 Hz) by every method, against its truth.

python benchmarks/urban.py [--json]
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

import starwise
from datasets import DATA, URBAN, rtklib_spp, scratch

TRUTH = DATA / "kinematic/urbannav_tst_20190428/groundTruth_TST.csv"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    files = [DATA / URBAN.obs, *(DATA / n for n in URBAN.nav)]
    rows: list[dict[str, Any]] = []
    for method in ("lsq", "ekf", "s3ekf"):
        report = starwise.assess(starwise.solve(*files, method=method, dynamics="vehicle"), TRUTH)
        rows.append({"method": method, **report})
    if shutil.which("rnx2rtkp"):
        with scratch() as folder:
            rtklib_spp(URBAN, Path(folder))
            rows.append({"method": "rtklib", **starwise.assess(Path(folder) / "urbannav_tst.pos", TRUTH)})
    if args.json:
        print(json.dumps(rows, indent=1, default=str))
        return
    keys = ("epochs_solved", "epochs_compared", "rms_2d_m", "rms_3d_m", "p95_3d_m", "coverage_95", "nees_mean")
    print(f"{'':8s}" + "".join(f"{k:>16s}" for k in keys))
    for row in rows:
        cells = [row.get(k) for k in keys]
        print(f"{row['method']:8s}" + "".join(f"{'' if c is None else f'{c:.2f}':>16s}" for c in cells))
        if "unflagged" in row:
            rest = row["unflagged"]
            print(f"  of them not flagged: 3D RMS {rest['rms_3d_m']:.1f} m, 95 % {rest['p95_3d_m']:.1f} m")


if __name__ == "__main__":
    main()
