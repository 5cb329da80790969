"""Reading observation files in process: starwise beside pyrtklib (RTKLIB's own reader in C), same plain files.

    python benchmarks/reading.py [--json FILE] [--runs N] [FILE ...]

Prints the median of N runs (5), taken in turns so that both see the same machine, after one run each to warm up:
compiled kernels and page cache. Both read the file from disk and keep every value it has. RTKLIB keeps at most three
frequencies a satellite and no RINEX 2 code that it cannot name.
"""

import argparse
import gc
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from starwise.io.files import read_bytes
from starwise.io.rinex_obs import read_obs

DATA = Path(os.environ.get("STARWISE_SHARED_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
FILES = [
    "static/unsa_2019057/UNSA00ARG_R_20190570000_01D_30S_MO.crx.gz",
    "static/kiru_2024090/KIRU00SWE_R_20240900000_01D_30S_MO.rnx",
    "static/nl_2021001/zegv0010.21d",
]
GOAL = 4.0
"""Times pyrtklib's speed, RINEX 3."""


def by_rtklib(path: str) -> int:
    """Satellite-epochs that RTKLIB reads."""
    import pyrtklib

    obs, nav, sta = pyrtklib.obs_t(), pyrtklib.nav_t(), pyrtklib.sta_t()
    if pyrtklib.readrnx(path, 1, "", obs, nav, sta) != 1:
        raise SystemExit(f"{path}: RTKLIB cannot read it")
    return int(obs.n)


def by_starwise(path: str) -> int:
    """Rows (satellite, signal) that starwise reads."""
    return read_obs(path).n_rows


def timed(call: Callable[[str], int], path: str) -> tuple[float, int]:
    gc.collect()
    start = time.perf_counter()
    n = call(path)
    return time.perf_counter() - start, n


def compare(path: Path, runs: int) -> dict[str, object]:
    """One row of the table."""
    data = read_bytes(path)
    version = data[:9].decode().strip()
    with tempfile.TemporaryDirectory() as folder:
        plain = str(Path(folder) / "plain.rnx")
        Path(plain).write_bytes(data)
        ours, theirs = [], []
        for k in range(runs + 1):
            mine, rows = timed(by_starwise, plain)
            other, records = timed(by_rtklib, plain)
            if k:
                ours.append(mine)
                theirs.append(other)
    size = len(data) / 1e6
    a, b = statistics.median(ours), statistics.median(theirs)
    return {
        "file": path.name,
        "version": version,
        "size_mb": round(size, 2),
        "rows": rows,
        "satellite_epochs_rtklib": records,
        "starwise_s": a,
        "pyrtklib_s": b,
        "starwise_mb_per_s": size / a,
        "pyrtklib_mb_per_s": size / b,
        "ratio": b / a,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--json", type=Path, help="write the table there as well")
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    files = options.files or [DATA / name for name in FILES]
    missing = [str(f) for f in files if not f.is_file()]
    if missing:
        raise SystemExit(f"not here: {' '.join(missing)}")
    table = [compare(path, options.runs) for path in files]
    print(f"{'file':<44}{'version':>8}{'MB':>8}{'starwise':>16}{'pyrtklib':>16}{'ratio':>8}")
    for row in table:
        ours = f"{row['starwise_s']:.3f} s {row['starwise_mb_per_s']:4.0f} MB/s"
        theirs = f"{row['pyrtklib_s']:.3f} s {row['pyrtklib_mb_per_s']:4.0f} MB/s"
        print(
            f"{str(row['file'])[:43]:<44}{row['version']:>8}{row['size_mb']:>8}{ours:>19}{theirs:>19}{row['ratio']:8.1f}"
        )
    if options.json:
        options.json.write_text(json.dumps({"runs": options.runs, "goal_ratio": GOAL, "table": table}, indent=1) + "\n")
    modern = [row["ratio"] for row in table if str(row["version"]) >= "3"]
    return 0 if all(float(str(r)) >= GOAL for r in modern) else 1


if __name__ == "__main__":
    sys.exit(main())
