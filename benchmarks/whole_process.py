"""Whole process, from the shell: `starwise solve` beside Debian's rnx2rtkp on the same plain files; start-up; growth.

    python benchmarks/whole_process.py [--quick] [--json FILE]

Single point positioning of whole days with a .conf (white errors, one frequency: the same job), without the HTML
report, which RTKLIB does not make. The compile cache of starwise is warm. Runs alternate; medians, ratio of medians
and peak memory (largest resident size of the process) are printed. Growth: the same receiver for ever longer.
"""

from __future__ import annotations

import sys
from pathlib import Path

from _bench import Table, processes, ratio, show, slope
from datasets import DATA, STATIC, DataSet, plain, scratch

SETS = ("delf_2021 24 h", "zegv_2021 24 h", "unsa_2019 24 h", "kiru_2024 2 h")
SCENARIO = """
name = "{name}"
description = "At rest"
seed = 5
[time]
start = "2024-03-30T00:00:00"
duration_s = {duration}
interval_s = {interval}
[vehicle]
kind = "car"
start = [48.8, 9.2, 300.0]
heading_deg = 0.0
[[vehicle.segments]]
kind = "static"
"""
STARWISE = (sys.executable, "-m", "starwise")


def simulated(folder: Path, name: str, epochs: int, interval_s: float = 1.0) -> DataSet:
    """Files of four constellations, one frequency, made by the simulator."""
    from starwise.studies.simulating import simulate_files

    out = folder / name.replace(" ", "_")
    scenario = out.with_suffix(".toml")
    scenario.write_text(SCENARIO.format(name=out.name, duration=(epochs - 1) * interval_s, interval=interval_s))
    simulate_files(scenario, out)
    obs, nav = next(out.glob("*_MO.rnx")), next(out.glob("*_MN.rnx"))
    return DataSet(name, str(obs), (str(nav),), None)


def commands(data: DataSet, folder: Path, methods: tuple[str, ...] = ("lsq", "s3ekf")) -> dict[str, list[str]]:
    obs, navs = plain(data.obs, folder), [plain(n, folder) for n in data.nav]
    made = {"rtklib": ["rnx2rtkp", "-k", str(DATA / "rtklib_conf" / data.conf), "-o", str(folder / "r.pos"),
                       str(obs), *map(str, navs)]}  # fmt: skip
    for method in methods:
        made[method] = [*STARWISE, "solve", str(obs), *map(str, navs), "-o", str(folder / "out"), "--no-report",
                        "--error-model", "white", "--method", method, "--systems", data.systems]  # fmt: skip
    return made


def measure(data: DataSet, repeats: int, folder: Path) -> dict[str, object]:
    took, memory = processes(commands(data, folder), repeats)
    size = plain(data.obs, folder).stat().st_size / 1e6
    return {
        "set": data.name,
        "MB of file": size,
        **{f"{k} s": v for k, v in took.items()},
        "lsq x": ratio(took["rtklib"], took["lsq"]),
        "s3ekf x": ratio(took["rtklib"], took["s3ekf"]),
        "peak MB": memory["s3ekf"],
        "rtklib peak MB": memory["rtklib"],
    }


def days(quick: bool) -> list[Table]:
    """Days of real receivers and simulated ones."""
    table = Table("day", "Whole process, s, warm cache (x: RTKLIB's time over it)")
    with scratch() as name:
        folder = Path(name)
        sets = [simulated(folder, "simulated 24 h 30 s GREC", 2880, 30.0)]
        sets += [d for d in STATIC if d.name in (SETS[:1] if quick else SETS)]
        if not quick:
            sets.append(simulated(folder, "simulated 24 h 1 Hz GREC", 86_400))
        for data in sets:
            table.rows.append(measure(data, 3 if quick else 5, folder))
    table.notes.append("wanted: 2 x on a day at 30 s, 10 x on the simulated day at 1 Hz")
    return [table]


def growth(quick: bool) -> list[Table]:
    """Time and memory by epochs."""
    table = Table("epochs", "Whole process by epochs (1 Hz, four constellations), s")
    with scratch() as name:
        folder = Path(name)
        for epochs in (60, 600, 6000) if quick else (600, 6000, 60_000):
            row = measure(simulated(folder, f"{epochs} epochs", epochs), 3, folder)
            table.rows.append({"epochs": epochs, **{k: v for k, v in row.items() if k != "set"}})
    x = [float(row["epochs"]) for row in table.rows]
    for method in ("rtklib", "lsq", "s3ekf"):
        y = [row[f"{method} s"].least for row in table.rows]
        table.notes.append(
            f"{method}: time ~ epochs^{slope(x[1:], y[1:]):.2f} at the end; "
            f"{(y[2] - y[1]) / (x[2] - x[1]) * 1e6:.0f} us for every further epoch"
        )
    m = [float(row["peak MB"]) for row in table.rows]
    table.notes.append(f"starwise: {(m[2] - m[1]) / (x[2] - x[1]) * 1e3:.1f} kB of peak memory for every further epoch")
    return [table]


def start_up(quick: bool) -> list[Table]:
    """What a small job costs."""
    table = Table("start-up", "Start-up, s, of whole processes")
    with scratch() as name:
        folder = Path(name)
        data = simulated(folder, "60 epochs", 60)
        solve = commands(data, folder, ("lsq", "s3ekf"))
        default = [a for a in solve["s3ekf"] if a not in ("--error-model", "white")]
        calls = {
            "python -c pass": [sys.executable, "-c", "pass"],
            "import numpy, numba, polars": [sys.executable, "-c", "import numpy, numba, polars"],
            "starwise --help": [*STARWISE, "--help"],
            "60 epochs, RTKLIB": solve["rtklib"],
            "60 epochs, lsq": solve["lsq"],
            "60 epochs, s3ekf white": solve["s3ekf"],
            "60 epochs, s3ekf (default)": default,
            "60 epochs, default, with report.html": [a for a in default if a != "--no-report"],
        }
        took, memory = processes(calls, 5 if quick else 15)
        table.rows = [{"command": k, "s": took[k], "peak MB": memory[k]} for k in calls]
    floor = took["import numpy, numba, polars"].median
    table.notes.append(f"wanted: 60 epochs in 0.6 s; importing numpy, numba and polars alone is {floor:.2f} s here")
    return [table]


def tables(quick: bool) -> list[Table]:
    return [*start_up(quick), *growth(quick), *days(quick)]


if __name__ == "__main__":
    show(tables, __doc__)
