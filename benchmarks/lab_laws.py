"""The laboratory's laws: a right filter passes as often as promised, wrong ones are found and named.

python benchmarks/lab_laws.py [--right 2000] [--runs 200] [--first 0] [--only NAME] [--json]

Worlds and cases stand in `starwise.studies.lab_worlds`. ``--first``: number of the first run, which decides all random
numbers.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict
from functools import partial

from starwise.studies.lab_worlds import CASES, FIX_CASES, CarWorld, FixWorld, Judged, judge


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--right", type=int, default=2000, help="runs with the right model")
    parser.add_argument("--runs", type=int, default=200, help="runs of every wrong one")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows: list[Judged] = []
    if not args.json:
        print(f"{'':38}{'runs':>6}{'found %':>9}{'named %':>9}   first finding, by number of runs")
    for world, cases in ((CarWorld(), CASES), (FixWorld(), FIX_CASES)):
        label = "car" if isinstance(world, CarWorld) else "fixes"
        for case in cases:
            if args.only not in f"{label}: {case.name}":
                continue
            count = args.runs if case.causes else (args.right if label == "car" else args.runs)
            started = time.perf_counter()
            row = judge(partial(world.run, wrong=case), case, range(args.first, args.first + count))
            rows.append(row)
            if not args.json:
                names = ", ".join(f"{name} {number}" for name, number in list(row.names.items())[:4])
                each = 1e3 * (time.perf_counter() - started) / count
                print(
                    f"{label + ': ' + row.case:38}{row.runs:6d}{100 * row.detected:9.1f}{100 * row.named:9.1f}   "
                    f"{names}   ({each:.0f} ms a run)",
                    flush=True,
                )
    if args.json:
        print(json.dumps([asdict(row) for row in rows], indent=1))


if __name__ == "__main__":
    main()
