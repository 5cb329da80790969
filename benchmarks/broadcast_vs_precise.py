"""Broadcast ephemerides against precise ones, per system and data set: orbit and clock differences.

Run: python benchmarks/broadcast_vs_precise.py [folder of the shared data]

Orbit: 3D difference at every node of the SP3 file where a healthy, valid record exists; broadcast positions are those
of antenna phase centres, precise ones of centres of mass. Clock: after removing the median of each system and epoch.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from starwise.constants import C_LIGHT, SAT_OK, SYSTEMS
from starwise.io.rinex_nav import read_nav
from starwise.io.sp3 import read_sp3
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.physics.group_delay import PRECISE_CLOCK
from starwise.signals import signal_id, sv_name

_PHONES = "kinematic/phones/products_2021118"
_TLSE = "static/tlse_2022001"
PAIRS = {
    # name: precise orbits, navigation files
    "tlse_2022001 igs": (f"{_TLSE}/igs21906.sp3", (f"{_TLSE}/BRDC00IGS_R_20220010000_01D_MN.zip",)),
    "tlse_2022001 wum": (
        f"{_TLSE}/WUM0MGXULT_20220010000_01H_05M_ORB.SP3",
        (f"{_TLSE}/BRDC00IGS_R_20220010000_01D_MN.zip",),
    ),
    "kiru_2024090 cod": (
        "static/kiru_2024090/COD0MGXFIN_20240900000_01D_05M_ORB.SP3",
        ("static/kiru_2024090/KIR000SWE_R_20240900000_01D_MN.rnx",),
    ),
    "unsa_2019057 igr": ("static/unsa_2019057/igr20422.sp3", ("static/unsa_2019057/brdc0570.19n",)),
    "phones_2021118 cod": (
        f"{_PHONES}/COD0MGXFIN_20211180000_01D_05M_ORB.SP3",
        (f"{_PHONES}/brdc1180.21n", f"{_PHONES}/brdc1190.21n"),
    ),
}  # fmt: skip


class Row(NamedTuple):
    """One line of the table. Metres."""

    system: str
    n: int
    orbit_rms: float
    orbit_max: float
    radial: float
    clock_rms: float
    clock_max: float
    worst: str


def compare(data: Path, name: str, max_age_s: float = 7200.0) -> list[Row]:
    """Differences of one data set per system (``geo`` and ``igso`` apart), records no older than ``max_age_s``."""
    sp3_name, nav_names = PAIRS[name]
    orbits = read_sp3(data / sp3_name)
    eph = BroadcastEphemeris(read_nav(*[data / n for n in nav_names]))
    n_sv, n_t = orbits.clock_s.shape
    sv = np.repeat(orbits.sv, n_t)
    t_ns = np.tile(orbits.t_ns, n_sv)
    s = eph.states(t_ns, sv, np.zeros(len(sv)), post=True)
    pos = s.pos_e + s.vel_e * s.clock_s[:, None]  # a pseudorange of zero: the state is that of t - clock
    d = pos - orbits.pos_e.reshape(-1, 3)
    up = orbits.pos_e.reshape(-1, 3) / np.linalg.norm(orbits.pos_e.reshape(-1, 3), axis=1)[:, None]
    error = np.linalg.norm(d, axis=1)
    clock = (s.clock_s - s.relativity_s) * C_LIGHT - orbits.clock_s.reshape(-1) * C_LIGHT
    clock -= _own_to_precise(eph, s.record, sv)
    fit = np.where(sv >> 8 == SYSTEMS.index("R"), 900.0, max_age_s)
    ok = (s.status == SAT_OK) & np.isfinite(error) & (np.abs(s.age_s) <= fit)
    ok &= ~((sv >> 8 == SYSTEMS.index("E")) & (s.age_s < -3600.0))  # Galileo is not fitted to the time before toe
    rows = []
    for kind in ("G", "R", "E", "C", "C igso", "C geo", "J"):
        mine = ok & (_kinds(sv) == kind)
        if not mine.any():
            continue
        c = clock.copy()
        for t in np.unique(t_ns[mine]):
            now = mine & (t_ns == t)
            c[now] -= np.nanmedian(c[now]) if np.isfinite(c[now]).any() else np.nan
        c = np.abs(c[mine][np.isfinite(c[mine])])
        rows.append(
            Row(
                kind,
                int(mine.sum()),
                float(np.sqrt(np.mean(error[mine] ** 2))),
                float(error[mine].max()),
                float(np.mean((d * up).sum(axis=1)[mine])),
                float(np.sqrt(np.mean(c**2))) if len(c) else np.nan,
                float(c.max()) if len(c) else np.nan,
                sv_name(int(sv[mine][error[mine].argmax()])),
            )
        )
    return rows


def _kinds(sv):
    """System letter, BeiDou apart by orbit: GEO C01-C05, C59-C63; IGSO C06-C10, C13, C16, C31, C38-C40, C56."""
    igso = {6, 7, 8, 9, 10, 13, 16, 31, 38, 39, 40, 56}
    names = []
    for one in sv:
        letter, number = SYSTEMS[one >> 8], one & 255
        if letter == "C" and (number <= 5 or number >= 59):
            letter = "C geo"
        elif letter == "C" and number in igso:
            letter = "C igso"
        names.append(letter)
    return np.array(names)


def _own_to_precise(eph, record, sv):
    """Group delay, m, of the pair that precise clocks belong to, against the broadcast clock."""
    sig, sig2 = np.zeros(len(sv), dtype=np.int16), np.zeros(len(sv), dtype=np.int16)
    for letter, (one, two) in PRECISE_CLOCK.items():
        rows = sv >> 8 == SYSTEMS.index(letter)
        sig[rows], sig2[rows] = signal_id(one), signal_id(two)
    return eph.group_delay(record, sv, sig, sig2)


def main() -> None:
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[2] / "shared" / "data"
    head = ("data set", "system", "n", "orbit RMS", "max", "radial", "clock RMS", "max")
    print("{:20} {:7} {:>6} {:>10} {:>7} {:>7} {:>10} {:>7}  worst".format(*head))
    for name in PAIRS:
        rows = compare(data, name)
        if not rows:
            print(f"{name:20} no record within its limits at any epoch of the orbits")
        for r in rows:
            print(
                f"{name:20} {r.system:7} {r.n:6d} {r.orbit_rms:10.2f} {r.orbit_max:7.2f} {r.radial:7.2f} "
                f"{r.clock_rms:10.2f} {r.clock_max:7.2f}  {r.worst}"
            )
    print("metres; orbit: broadcast (phase centre) minus precise (centre of mass)")


if __name__ == "__main__":
    main()
