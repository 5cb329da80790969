"""Scaffolding of the benchmarks: alternating measurements, medians and spread, tables, and what machine this is."""

from __future__ import annotations

import argparse
import gc
import importlib
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

PACKAGES = ("numpy", "numba", "polars", "pyrtklib", "filterpy", "stonesoup", "python-ins", "pygnss-tec", "georinex",
            "gnss-lib-py", "cssrlib")  # fmt: skip


@dataclass(frozen=True)
class Spread:
    """Median, quartiles and least of repeated measurements."""

    median: float
    low: float
    high: float
    least: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Spread:
        least, low, median, high = np.percentile(list(values), [0, 25, 50, 75])
        return cls(float(median), float(low), float(high), float(least))

    def scaled(self, factor: float) -> Spread:
        return Spread(self.median * factor, self.low * factor, self.high * factor, self.least * factor)

    def __str__(self) -> str:
        return f"{number(self.median)} ({number(self.low)}-{number(self.high)})"


class _Clock:
    """The clock of all measurements: what a wall clock says, or processor time, all threads."""

    cpu = False


def now() -> float:
    """Seconds by the chosen clock."""
    return time.process_time() if _Clock.cpu else time.perf_counter()


def count_cpu() -> None:
    """Measure processor time from now on: for machines that others use at the same time."""
    _Clock.cpu = True


def number(value: float) -> str:
    """Three significant digits, no exponent."""
    if value != value:
        return "-"
    if value == 0.0 or abs(value) >= 100.0:
        return f"{value:.0f}"
    return f"{value:.{max(0, 2 - int(np.floor(np.log10(abs(value)))))}f}"


def alternate(calls: dict[str, Callable[[], object]], repeats: int, warm: bool = True) -> dict[str, Spread]:
    """Seconds of each call, taken in turns so that all see the same machine; one turn before does not count."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(-1 if warm else 0, repeats):
        for name, call in calls.items():
            gc.collect()
            start = now()
            call()
            seconds = now() - start
            if turn >= 0:
                times[name].append(seconds)
    return {name: Spread.of(values) for name, values in times.items()}


LAUNCHER = """
import os, subprocess, sys, time
start = time.perf_counter()
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
_, status, usage = os.wait4(child.pid, 0)
wall = time.perf_counter() - start
cpu = usage.ru_utime + usage.ru_stime
print(wall, cpu, usage.ru_maxrss / 1024.0, os.waitstatus_to_exitcode(status))
"""
"""Starts a command from a small process: the peak memory of a child counts what its parent had when it forked.

Not to a pipe: rnx2rtkp writes its progress to stderr, and a full pipe that nobody reads would stop it.
"""


def process(command: Sequence[str]) -> tuple[float, float]:
    """Seconds and peak resident MB of a command; its failure is an error."""
    # Python programs may keep their byte code, as they do when installed.
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(
        [sys.executable, "-S", "-c", LAUNCHER, *command], capture_output=True, text=True, check=True, env=environment
    )
    wall, cpu, memory, code = done.stdout.split()
    if int(code) != 0:
        raise SystemExit(f"failed: {' '.join(command)}")
    return float(cpu if _Clock.cpu else wall), float(memory)


def processes(commands: dict[str, Sequence[str]], repeats: int) -> tuple[dict[str, Spread], dict[str, float]]:
    """Seconds and largest peak memory, MB, of commands run in turns; one turn before warms caches."""
    times: dict[str, list[float]] = {name: [] for name in commands}
    memory = dict.fromkeys(commands, 0.0)
    for turn in range(-1, repeats):
        for name, command in commands.items():
            seconds, peak = process(command)
            memory[name] = max(memory[name], peak)
            if turn >= 0:
                times[name].append(seconds)
    return {name: Spread.of(values) for name, values in times.items()}, memory


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Exponent of y ~ x^k: 1 is linear growth."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def peer(name: str) -> ModuleType | None:
    """A module of another package, None where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


@dataclass
class Table:
    """A table of results; cells are text, numbers or spreads."""

    name: str
    title: str
    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def columns(self) -> list[str]:
        return list(dict.fromkeys(key for row in self.rows for key in row))

    def _cells(self) -> list[list[str]]:
        def cell(value: Any) -> str:
            return "" if value is None else number(value) if isinstance(value, float) else str(value)

        return [[cell(row.get(c)) for c in self.columns()] for row in self.rows]

    def text(self) -> str:
        lines = [self.columns(), *self._cells()]
        widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
        body = []
        for line in lines:
            first, *others = zip(line, widths, strict=True)
            body.append("  ".join([first[0].ljust(first[1]), *(c.rjust(w) for c, w in others)]))
        return "\n".join([f"{self.title}", *body, *(f"  {note}" for note in self.notes)])

    def markdown(self) -> str:
        columns = self.columns()
        lines = [columns, ["---"] + ["--:"] * (len(columns) - 1), *self._cells()]
        table = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        return f"### {self.title}\n\n{table}\n" + "".join(f"\n{note}\n" for note in self.notes)

    def plain(self) -> dict[str, Any]:
        def value(v: Any) -> Any:
            return vars(v) if isinstance(v, Spread) else v

        rows = [{k: value(v) for k, v in row.items()} for row in self.rows]
        return {"name": self.name, "title": self.title, "rows": rows, "notes": self.notes}


def machine() -> dict[str, Any]:
    """Processor, cores, load and versions: what a figure of time means nothing without."""
    cpu = platform.processor()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if "model name" in line]
        cpu = names[0] if names else cpu
    allowed = getattr(os, "sched_getaffinity", None)
    found: dict[str, Any] = {
        "cpu": cpu,
        "cores": len(allowed(0)) if allowed else os.cpu_count(),
        "load": [round(x, 1) for x in os.getloadavg()] if hasattr(os, "getloadavg") else [],
        "clock": "processor time" if _Clock.cpu else "wall",
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
    }
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "absent"
    found["rtklib (Debian)"] = "absent"
    if shutil.which("dpkg-query") is not None:
        query = ["dpkg-query", "-W", "-f=${Version}", "rtklib"]
        found["rtklib (Debian)"] = subprocess.run(query, capture_output=True, text=True).stdout or "absent"
    return found


def show(tables: Callable[[bool], list[Table]], about: str | None) -> None:
    """Command line of one benchmark: ``--quick`` and ``--json FILE``."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer sizes and repeats")
    parser.add_argument("--cpu", action="store_true", help="processor time, for a machine that others use, too")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the tables there as well")
    options = parser.parse_args()
    if options.cpu:
        count_cpu()
    made = tables(options.quick)
    sys.stdout.write("\n\n".join(table.text() for table in made) + "\n")
    if options.json:
        write_json(options.json, made)


def write_json(path: Path, tables: list[Table]) -> None:
    """Tables and machine as one JSON object."""
    whole = {"machine": machine(), "tables": [table.plain() for table in tables]}
    path.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")


def ratio(slow: Spread, fast: Spread) -> float:
    """How many times as long the first takes, by the fastest turns of each: what is slower was interrupted."""
    return slow.least / fast.least
