"""Cost of a unit of a batch, measured, and what 10 000 stations x 365 days would take.

python benchmarks/batch.py [DIR] [--turns 3] [--core-hour 0.04] [--gb-month 0.02] [--cores 1000] [--json]

Every unit of a folder is done as a worker does it, in this process, after a first turn that loads everything:
processor seconds (children included), bytes read and written, the largest memory. Without a folder: a simulated day of
four constellations on two frequencies at 30 s, packed as archives do (Hatanaka, gzip), from which the estimate is made,
and beside it the day files among the shared measurements. Prices are assumptions, in any currency; the reader's own go
in by the options.
"""

from __future__ import annotations

import argparse
import gzip
import json
import resource
import tempfile
import time
from pathlib import Path

import hatanaka

from datasets import DATA
from day import SCENARIO
from starwise.batch import Unit, scan
from starwise.batch.work import Work, do_unit
from starwise.spread import sources_hash
from starwise.studies.simulating import simulate_files

STATIONS, DAYS = 10_000, 365


def processor_s() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def simulated_day(folder: Path) -> Unit:
    """A day of four constellations as an archive has it."""
    (folder / "day.toml").write_text(SCENARIO)
    simulate_files(folder / "day.toml", folder / "sim")
    obs = next((folder / "sim").glob("*_MO.rnx"))
    packed = folder / f"{obs.stem}.crx.gz"
    packed.write_bytes(hatanaka.compress(obs.read_bytes()))
    nav = next((folder / "sim").glob("*_MN.rnx"))
    packed_nav = folder / f"{nav.name}.gz"
    packed_nav.write_bytes(gzip.compress(nav.read_bytes()))
    return Unit("simulated-GREC", obs=(str(packed),), nav=(str(packed_nav),))


def measure(units: list, turns: int) -> list[dict]:
    rows = []
    for number, unit in enumerate(units):
        spent, wall = [], []
        for _ in range(turns + 1):
            with tempfile.TemporaryDirectory(prefix="starwise-bench-") as folder:
                token = Path(folder, "token")
                token.touch()
                cpu, began = processor_s(), time.perf_counter()
                row = do_unit(Work(number, unit, folder, sources_hash(), str(token))).row
                spent.append(processor_s() - cpu)
                wall.append(time.perf_counter() - began)
                ledger = Path(folder, f"unit={unit.name}", "ledger.parquet").stat().st_size
        rows.append(
            {
                "unit": unit.name,
                "epochs": row["epochs"],
                "clocks": row["clocks"],
                "satellites": row["satellites"],
                "cpu_s": sorted(spent[1:])[turns // 2],
                "wall_s": sorted(wall[1:])[turns // 2],
                "MB_in": row["bytes_in"] / 1e6,
                "MB_out": row["bytes_out"] / 1e6,
                "MB_without_ledger": (row["bytes_out"] - ledger) / 1e6,
            }
        )
    return rows


def estimate(rows: list[dict], core_hour: float, gb_month: float, cores: int) -> dict:
    """A year of 10 000 stations, every unit as the mean of those measured."""
    units = STATIONS * DAYS
    mean = {
        name: sum(row[name] for row in rows) / len(rows) for name in ("cpu_s", "MB_in", "MB_out", "MB_without_ledger")
    }
    hours = units * mean["cpu_s"] / 3600
    return {
        "units": units,
        **mean,
        "core_hours": hours,
        "cores": cores,
        "hours": hours / cores,
        "TB_in": units * mean["MB_in"] / 1e6,
        "TB_out": units * mean["MB_out"] / 1e6,
        "TB_without_ledgers": units * mean["MB_without_ledger"] / 1e6,
        "cost_of_computing": hours * core_hour,
        "cost_of_a_month_of_storage": units * mean["MB_out"] / 1e3 * gb_month,
        "core_hour": core_hour,
        "gb_month": gb_month,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--core-hour", type=float, default=0.04)
    parser.add_argument("--gb-month", type=float, default=0.02)
    parser.add_argument("--cores", type=int, default=1000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.folder is not None:
        rows = measure(list(scan(args.folder).units()), args.turns)
        year = estimate(rows, args.core_hour, args.gb_month, args.cores)
    else:
        real = list(scan(DATA / "static").units()) if DATA.is_dir() else []
        real = [unit for unit in real if unit.name[:4] in ("delf", "zegv", "UNSA") or "01D_30S_GO" in unit.name]
        with tempfile.TemporaryDirectory(prefix="starwise-bench-") as folder:
            rows = measure([simulated_day(Path(folder)), *real], args.turns)
        year = estimate(rows[:1], args.core_hour, args.gb_month, args.cores)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    if args.json:
        print(json.dumps({"units": rows, "estimate": year, "peak_MB": memory}, indent=1))
        return
    print(f"{'unit':<36} {'epochs':>6} {'clocks':>6} {'cpu s':>6} {'MB in':>6} {'MB out':>6}")
    for row in rows:
        print(
            f"{row['unit']:<36} {row['epochs']:>6} {row['clocks']:>6} {row['cpu_s']:>6.2f} {row['MB_in']:>6.2f}"
            f" {row['MB_out']:>6.2f}"
        )
    print(f"largest memory of the process: {memory:.0f} MB\n")
    print(f"{STATIONS} stations x {DAYS} days = {year['units']} units of {year['cpu_s']:.2f} s")
    print(f"  processor   {year['core_hours']:.0f} core hours; on {args.cores} cores {year['hours']:.1f} h")
    print(f"  read        {year['TB_in']:.1f} TB")
    print(f"  written     {year['TB_out']:.1f} TB, without ledgers {year['TB_without_ledgers']:.1f} TB")
    print(f"  cost        {year['cost_of_computing']:.0f} at {args.core_hour} per core hour; a month of storage")
    print(f"              {year['cost_of_a_month_of_storage']:.0f} at {args.gb_month} per GB and month")


if __name__ == "__main__":
    main()
