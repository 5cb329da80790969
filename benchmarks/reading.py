"""Reading files: starwise beside pyrtklib (RTKLIB's own reader in C), pygnss-tec, georinex and cssrlib, same files.

    python benchmarks/reading.py [--quick] [--json FILE]

Medians of runs taken in turns, in process, after one to warm up: compiled kernels and page cache. All read the file
from disk and keep every value they have. RTKLIB keeps at most three frequencies a satellite and no RINEX 2 code that
it cannot name. georinex takes minutes for a day: it and the others read the first epochs again ("slice"). Readers that
cannot read a kind of file have no figure there; convbin, as a whole process, reads and writes RINEX.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path

from _bench import Table, alternate, number, peer, processes, ratio, show
from datasets import DATA, scratch
from starwise.io.files import read_bytes
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import read_obs
from starwise.io.sp3 import read_sp3

OBSERVATIONS = {
    "RINEX 3, 24 h 30 s G": "static/unsa_2019057/UNSA00ARG_R_20190570000_01D_30S_MO.crx.gz",
    "RINEX 3, 2 h 30 s GRECJ": "static/kiru_2024090/KIRU00SWE_R_20240900000_01D_30S_MO.rnx",
    "RINEX 2, 24 h 30 s GRE": "static/nl_2021001/zegv0010.21d",
}
HATANAKA = {"Hatanaka 3, 24 h 30 s G": "static/unsa_2019057/UNSA00ARG_R_20190570000_01D_30S_MO.crx.gz"}
NAVIGATION = {
    "navigation 3, 24 h all": "static/kiru_2024090/KIR000SWE_R_20240900000_01D_MN.rnx",
    "navigation 2, 24 h G": "static/unsa_2019057/brdc0570.19n",
}
ORBITS = {"SP3, 24 h 5 min all": "static/kiru_2024090/COD0MGXFIN_20240900000_01D_05M_ORB.SP3"}
SLICE = 20
"""Epochs."""
GOALS = {"pyrtklib": 5.0, "pygnss-tec": 7.0}
"""Times their speed, observations in RINEX 3."""
Reader = Callable[[str], object]


def _rtklib(path: str) -> int:
    import pyrtklib

    obs, nav, sta = pyrtklib.obs_t(), pyrtklib.nav_t(), pyrtklib.sta_t()
    if pyrtklib.readrnx(path, 1, "", obs, nav, sta) != 1:
        raise SystemExit(f"{path}: RTKLIB cannot read it")
    return int(obs.n)


def _rtklib_sp3(path: str) -> int:
    import pyrtklib

    nav = pyrtklib.nav_t()
    pyrtklib.readsp3(path, nav, 0)
    return int(nav.ne)


def _pygnss_tec(path: str) -> object:
    import gnss_tec

    return gnss_tec.read_rinex_obs(path)[1].collect()


def _georinex(path: str) -> object:
    import georinex

    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        return georinex.load(path)


def readers(kind: str, plain: bool, small: bool) -> tuple[dict[str, Reader], list[str]]:
    """Readers of a kind of file that are installed, and the names of those that are not."""
    own: dict[str, Reader] = {"obs": read_obs, "nav": read_nav, "sp3": read_sp3}
    found: dict[str, Reader] = {"starwise": own[kind]}
    absent = []
    for name, module, reader, able in (
        ("pyrtklib", "pyrtklib", _rtklib_sp3 if kind == "sp3" else _rtklib, plain),
        ("pygnss-tec", "gnss_tec", _pygnss_tec, kind == "obs"),
        ("georinex", "georinex", _georinex, small or kind == "sp3"),
    ):
        if peer(module) is None:
            absent.append(name)
        elif able:
            found[name] = reader
    return found, absent


def shortened(data: bytes, epochs: int) -> bytes:
    """The header and the first epochs of a RINEX 3 file."""
    starts = [m.start() for m in re.finditer(rb"^>", data, re.MULTILINE)]
    return data[: starts[epochs]]


def compare(name: str, kind: str, path: Path, size: int, repeats: int, plain: bool, small: bool) -> dict[str, object]:
    """A row of the table."""
    found, _ = readers(kind, plain, small)
    working = {}
    for reader, call in found.items():
        try:
            call(str(path))
        except Exception as error:
            if reader == "starwise":
                raise
            working[reader] = f"fails: {type(error).__name__}"
    took = alternate({r: (lambda c=c: c(str(path))) for r, c in found.items() if r not in working}, repeats, warm=False)
    row: dict[str, object] = {"file": name, "MB": size / 1e6, "starwise ms": took["starwise"].scaled(1e3)}
    row["starwise MB/s"] = size / 1e6 / took["starwise"].least
    for other in ("pyrtklib", "pygnss-tec", "georinex"):
        if other in took:
            row[f"{other} MB/s"] = size / 1e6 / took[other].least
            row[f"{other} x"] = ratio(took[other], took["starwise"])
        else:
            row[f"{other} MB/s"], row[f"{other} x"] = working.get(other), None
    return row


def tables(quick: bool) -> list[Table]:
    repeats = 3 if quick else 9
    table = Table("reading", "Reading in process (x: how many times as long as starwise)")
    converting = Table("convbin", "Reading as a whole process, RINEX to RINEX by Debian's convbin, beside `read_obs`")
    with scratch() as name:
        folder = Path(name)
        for label, file in OBSERVATIONS.items():
            data = read_bytes(DATA / file)
            target = folder / f"{file.rsplit('/', 1)[1].split('.')[0]}.{'21o' if 'RINEX 2' in label else 'rnx'}"
            target.write_bytes(data)
            table.rows.append(compare(label, "obs", target, len(data), repeats, True, False))
            if "GRECJ" in label:
                part = folder / "slice.rnx"
                part.write_bytes(shortened(data, SLICE))
                size = part.stat().st_size
                table.rows.append(compare(f"its first {SLICE} epochs", "obs", part, size, repeats, True, True))
            if shutil.which("convbin"):
                converting.rows.append(_convbin(label, target, folder, repeats))
        for label, file in HATANAKA.items():
            size = len(read_bytes(DATA / file))
            table.rows.append(compare(label + " (.crx.gz)", "obs", DATA / file, size, repeats, False, False))
        for kind, files in (("nav", NAVIGATION), ("sp3", ORBITS)):
            for label, file in files.items():
                target = folder / Path(file).name.replace(".SP3", ".sp3")  # RTKLIB goes by the name's ending
                target.write_bytes((DATA / file).read_bytes())
                small = kind == "nav" and not quick
                size = os.path.getsize(target)
                table.rows.append(compare(label, kind, target, size, 3 if small else repeats, True, small))
    absent = readers("obs", True, True)[1]
    if absent:
        table.notes.append(f"not installed: {', '.join(absent)}")
    wanted = ", ".join(f"{name} {goal:.0f}" for name, goal in GOALS.items())
    table.notes.append(f"wanted: observations in RINEX 3, {wanted} times as long; sizes are of the plain text")
    return [table, converting] if converting.rows else [table]


def _convbin(label: str, path: Path, folder: Path, repeats: int) -> dict[str, object]:
    import sys

    commands = {
        "convbin s": ["convbin", "-r", "rinex", "-v", "3.03", "-o", str(folder / "again.obs"), str(path)],
        "starwise s": [sys.executable, "-c", f"from starwise.io.rinex_obs import read_obs; read_obs({str(path)!r})"],
    }
    took, memory = processes(commands, repeats)
    return {
        "file": label,
        **took,
        "x": ratio(took["convbin s"], took["starwise s"]),
        "convbin MB": number(memory["convbin s"]),
        "starwise MB": number(memory["starwise s"]),
    }


if __name__ == "__main__":
    show(tables, __doc__)
