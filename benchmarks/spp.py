"""Time per epoch of single point positioning and of the 13-state S3EKF, beside other programs, in one process.

    python benchmarks/spp.py [--quick] [--json FILE]

"All included": satellite positions and clocks, corrections, signal selection and, here, the ledger. Reading is not.
All solve the same file with broadcast ephemerides, the broadcast ionosphere and a troposphere model (RTKLIB:
Saastamoinen). cssrlib decodes while it solves: its time is of the first
epochs, GPS alone, decoding included.
"""

from __future__ import annotations

import contextlib
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyrtklib as prl

from _bench import Table, alternate, now, peer, ratio, show, slope
from datasets import STATIC, DataSet, plain, scratch
from starwise.config import RunConfig
from starwise.estimators.run import solve_run
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import read_obs
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.signals import sv_name

SYSTEMS = {"G": prl.SYS_GPS, "R": prl.SYS_GLO, "E": prl.SYS_GAL, "C": prl.SYS_CMP, "J": prl.SYS_QZS}
SETS = ("kiru_2024 2 h", "delf_2021 24 h")
CSSRLIB_EPOCHS = 20


class Pyrtklib:
    """The file read once; `run` positions every epoch as rnx2rtkp does."""

    def __init__(self, obs: Path, nav: Path, systems: str) -> None:
        self.obs, self.nav, sta = prl.obs_t(), prl.nav_t(), prl.sta_t()
        prl.readrnx(str(obs), 1, "", self.obs, self.nav, sta)
        prl.readrnx(str(nav), 1, "", self.obs, self.nav, sta)
        prl.uniqnav(self.nav)
        self.n_epochs = prl.sortobs(self.obs)
        self.options = prl.prcopt_default if isinstance(prl.prcopt_default, prl.prcopt_t) else prl.prcopt_default()
        self.options.navsys = sum(SYSTEMS[s] for s in systems)
        self.options.ionoopt = prl.IONOOPT_BRDC
        self.options.tropopt = prl.TROPOPT_SAAS
        # Rows of each epoch, found beforehand: not part of the timing.
        self.epochs = []
        i = 0
        while i < self.obs.n:
            j = i
            t = self.obs.data[i].time
            while j < self.obs.n and self.obs.data[j].time.time == t.time and self.obs.data[j].time.sec == t.sec:
                j += 1
            self.epochs.append((self.obs.data[i], j - i))  # the rows of an epoch are contiguous in C
            i = j

    def run(self) -> int:
        solved = 0
        sol, ssat = prl.sol_t(), prl.Arr1Dssat_t(255)  # room for every satellite that RTKLIB knows
        azel, msg = prl.Arr1Ddouble(2 * 255), prl.Arr1Dchar(128)
        for first, n in self.epochs:
            solved += prl.pntpos(first, n, self.nav, self.options, sol, azel, ssat.ptr, msg)
        return solved


def _configs(systems: str) -> dict[str, RunConfig]:
    return {
        m: RunConfig(method=m, error_model="white", dynamics="vehicle", systems=systems, post=True)
        for m in ("lsq", "s3ekf")
    }


def measure(data: DataSet, repeats: int, folder: Path) -> dict[str, object]:
    obs_file, nav_file = plain(data.obs, folder), plain(data.nav[0], folder)
    other = Pyrtklib(obs_file, nav_file, data.systems)
    obs, records = read_obs(obs_file), read_nav(nav_file)
    ephemeris = BroadcastEphemeris(records)
    calls = {"pyrtklib": other.run}
    for name, config in _configs(data.systems).items():
        calls[name] = lambda c=config: solve_run(obs, ephemeris, records.ionosphere, c)
    took = {k: v.scaled(1e6 / obs.n_epochs) for k, v in alternate(calls, repeats).items()}
    row: dict[str, object] = {"set": data.name, "epochs": obs.n_epochs}
    row["satellites"] = float(len(obs.sv) and np.mean([len(set(obs.sv[a:b].tolist())) for a, b in _epochs(obs)]))
    row.update({f"{k} us": v for k, v in took.items()})
    row["lsq x"] = ratio(took["pyrtklib"], took["lsq"])
    row["s3ekf x"] = ratio(took["pyrtklib"], took["s3ekf"])
    if "kiru" in data.name and (seconds := cssrlib(obs_file, nav_file)) is not None:
        row["cssrlib us"] = seconds * 1e6
    return row


def _epochs(obs: object) -> list[tuple[int, int]]:
    o = obs.offsets  # type: ignore[attr-defined]
    return list(zip(o[:-1].tolist(), o[1:].tolist(), strict=True))


def cssrlib(obs: Path, nav: Path) -> float | None:
    """Seconds for each of the first epochs, GPS alone, as far as it gets; None where it is not installed or fails."""
    if peer("cssrlib") is None:
        return None
    from cssrlib.gnss import Nav, rSigRnx
    from cssrlib.pntpos import stdpos
    from cssrlib.rinex import rnxdec

    with contextlib.redirect_stdout(io.StringIO()):
        decoder, state = rnxdec(), Nav(1)
        state = decoder.decode_nav(str(nav), state)
        decoder.setSignals([rSigRnx(s) for s in ("GC1C", "GL1C", "GD1C", "GS1C")])
        decoder.decode_obsh(str(obs))
        state.pmode = 1
        position = stdpos(state, decoder.pos)
        start = now()
        for epoch in range(CSSRLIB_EPOCHS):
            try:
                position.process(decoder.decode_obs(), cs=None)
            except (ArithmeticError, ValueError, np.linalg.LinAlgError):  # its filter diverges on some files
                return (now() - start) / max(epoch, 1)
        return (now() - start) / CSSRLIB_EPOCHS


def growth_satellites(folder: Path, repeats: int) -> Table:
    """Microseconds of an epoch by satellites: the richest file with ever more of its satellites."""
    data = next(d for d in STATIC if d.name == SETS[0])
    obs, records = read_obs(plain(data.obs, folder)), read_nav(plain(data.nav[0], folder))
    ephemeris = BroadcastEphemeris(records)
    seen, counts = np.unique(obs.sv, return_counts=True)
    order = [sv_name(int(sv)) for sv in seen[np.argsort(-counts)]]
    table = Table("spp-satellites", f"Epoch by satellites ({data.name}), us, all included")
    for keep in (5, 10, 20, 30, 40, len(order)):
        calls = {}
        for name, config in _configs(data.systems).items():
            chosen = replace(config, exclude=tuple(order[keep:]))
            calls[name] = lambda c=chosen: solve_run(obs, ephemeris, records.ionosphere, c)
        took = alternate(calls, repeats)
        solution = calls["lsq"]()
        used = float(np.mean(solution.n_used[solution.n_used > 0])) if (solution.n_used > 0).any() else 0.0
        row: dict[str, object] = {"satellites of the file": keep, "used": used}
        table.rows.append({**row, **{k: v.scaled(1e6 / obs.n_epochs) for k, v in took.items()}})
    rows = table.rows[1:]
    x = [float(r["used"]) for r in rows]
    exponents = ", ".join(f"{k}^{slope(x, [r[k].least for r in rows]):.2f}" for k in ("lsq", "s3ekf"))
    table.notes.append(f"time ~ satellites: {exponents} (from the second row on; 1 is linear)")
    return table


def tables(quick: bool) -> list[Table]:
    repeats = 3 if quick else 9
    table = Table("spp", "Epoch in process, us, all included but reading (x: pyrtklib's time over it)")
    with scratch() as folder:
        for data in STATIC:
            if data.name in SETS:
                table.rows.append(measure(data, repeats, Path(folder)))
        growth = growth_satellites(Path(folder), repeats)
    table.notes.append("wanted: lsq at least 20 times as fast as pyrtklib")
    if peer("cssrlib") is None:
        table.notes.append("not installed: cssrlib")
    if peer("gnss_lib_py") is None:
        table.notes.append("not installed: gnss_lib_py (its releases conflict with the versions of constraints.txt)")
    return [table, growth]


if __name__ == "__main__":
    show(tables, __doc__)
