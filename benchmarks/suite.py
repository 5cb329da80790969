"""The benchmark suite: every speed table in one run, as text, Markdown and JSON.

    python -m benchmarks [--quick] [--cpu] [--only NAME]... [--json FILE] [--markdown FILE]

Contenders take turns, so that all see the same machine; cells are the median and, in brackets, the quartiles; ratios
are of the fastest turns, because what is slower was interrupted. Packages that are not installed are named. Real
measurements come from ``$STARWISE_SHARED_DATA``; without them, and without Debian's rtklib, tables that need them are
left out, with the reason. Where the peers come from: ``pip install starwise[bench]``.
"""

from __future__ import annotations

import argparse
import importlib
import os
import shutil
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: with matrices of a filter's size threads only wait

from _bench import Table, count_cpu, machine, write_json
from datasets import DATA

SUITE = {
    "start-up": ("whole_process", "start_up"),
    "days": ("whole_process", "days"),
    "growth": ("whole_process", "growth"),
    "spp": ("spp", "tables"),
    "update": ("update", "tables"),
    "reading": ("reading", "tables"),
    "mechanisation": ("mechanisation", "tables"),
    "monte-carlo": ("monte_carlo_peers", "tables"),
}
"""Name, module, function of each group of tables."""
NEEDS_DATA = ("start-up", "days", "growth", "spp", "reading")
NEEDS_RTKLIB = ("start-up", "days", "growth")


def missing(name: str) -> str | None:
    """Why a group cannot run here."""
    if name in NEEDS_DATA and not DATA.is_dir():
        return f"no measurements at {DATA} (STARWISE_SHARED_DATA)"
    if name in NEEDS_RTKLIB and shutil.which("rnx2rtkp") is None:
        return "Debian's rtklib is not installed"
    return None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer sizes and repeats: minutes instead of an hour")
    parser.add_argument("--only", action="append", choices=SUITE, metavar="NAME", help=", ".join(SUITE))
    parser.add_argument("--cpu", action="store_true", help="processor time, for a machine that others use, too")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write tables and machine there")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables there as Markdown")
    options = parser.parse_args()
    if options.cpu:
        count_cpu()
    begun = machine()
    print("\n".join(f"{key:<16}{value}" for key, value in begun.items()), flush=True)
    made: list[Table] = []
    for name in options.only or SUITE:
        reason = missing(name)
        if reason is not None:
            print(f"\n{name}: left out, {reason}")
            continue
        module, function = SUITE[name]
        for table in getattr(importlib.import_module(module), function)(options.quick):
            print("\n" + table.text(), flush=True)
            made.append(table)
        if options.json:  # after every group: an interrupted run keeps what it has
            write_json(options.json, made)
    if options.markdown:
        head = "".join(f"- {key}: {value}\n" for key, value in begun.items())
        options.markdown.write_text(head + "\n" + "\n".join(table.markdown() for table in made), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
