"""Default parameters of the coloured error model: how they were found, on the shared measurements.

    python benchmarks/calibrate.py [--rounds N] [--no-folds] [--output FILE.toml]

writes a list of the measurements for ``starwise calibrate`` and runs it.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from datasets import DATA, STATIC, URBAN, DataSet, truth_ecef

STATIONS = {"tlse": "TLSE", "kiru": "KIRU", "unsa": "UNSA", "delf": "DELF", "zegv": "ZEGV", "nagoya": "NAGOYA"}


def entry(data: DataSet, station: str, truth: str, dynamics: str, kinds: str) -> str:
    """A [[set]] table."""
    nav = ", ".join(f"'{DATA / name}'" for name in data.nav)
    return (
        f"[[set]]\nname = '{data.name}'\nstation = '{station}'\nobservations = '{DATA / data.obs}'\n"
        f"navigation = [{nav}]\nsystems = '{data.systems}'\ntruth = '{truth}'\ndynamics = [{dynamics}]\n"
        f"combination = [{kinds}]\n"
    )


def main() -> int:
    """Run ``starwise calibrate`` on all shared measurements with a truth."""
    tables = []
    for data in STATIC:
        assert data.truth is not None
        where = ",".join(f"{v:.4f}" for v in truth_ecef(data.truth))
        station = STATIONS[data.name.split("_")[0].split()[0]]
        tables.append(entry(data, station, where, "'static', 'vehicle'", "'uncombined'"))
        tables.append(entry(data, station, where, "'static'", "'single'"))
    truth = DATA / "kinematic/urbannav_tst_20190428/groundTruth_TST.csv"
    tables.append(entry(URBAN, "TST", str(truth), "'vehicle'", "'single'"))
    with tempfile.TemporaryDirectory(prefix="starwise-calibrate-") as folder:
        sets = Path(folder) / "sets.toml"
        sets.write_text("every = 6\n" + "\n".join(tables))
        return subprocess.call([sys.executable, "-m", "starwise", "calibrate", str(sets), *sys.argv[1:]])


if __name__ == "__main__":
    raise SystemExit(main())
