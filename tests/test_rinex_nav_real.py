"""RINEX navigation reader on real files, against a reader of a few lines and against counts of the text."""

import datetime as dt
import gzip
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from nav_text import twin
from starwise.constants import (
    K_E,
    K_TOE_SOW,
    MESSAGE_NAMES,
    NS,
    R_AX,
    R_CHANNEL,
    R_GAMMA,
    R_TAU,
    R_VX,
    R_X,
    SYSTEMS,
)
from starwise.errors import StarwiseError
from starwise.gnsstime import GPS_EPOCH, label_to_gpst
from starwise.io.nav_fields import ORBIT
from starwise.io.rinex_nav import read_nav
from starwise.signals import sv_name

pytestmark = pytest.mark.real

FILES = [
    # file below the shared data, records kept, systems; counted once with grep on the record starts
    ("rinex_samples/georinex_edge_cases/14601736.18n", 7, "G"),
    ("rinex_samples/georinex_edge_cases/brdc2420.18n.gz", 44, "G"),
    ("rinex_samples/georinex_edge_cases/ceda2100.18e", 29, "E"),
    ("rinex_samples/georinex_edge_cases/demo_nav3.17n", 4, "G"),
    ("rinex_samples/georinex_edge_cases/galileo3.15n", 3, "E"),
    ("rinex_samples/georinex_edge_cases/minimal2.10n", 1, "G"),
    ("rinex_samples/georinex_edge_cases/minimal3.10n", 1, "S"),
    ("rinex_samples/georinex_edge_cases/p1462100.18g", 154, "R"),
    ("rinex_samples/georinex_edge_cases/qzss_nav3.14n", 1, "J"),
    ("rinex_samples/georinex_edge_cases/spare_filled_nav3.rnx", 7, "GRE"),
    ("rinex_samples/rinex2_nav/amel0010.21g", 6, "R"),
    ("rinex_samples/rinex2_nav/cbw10010.21n.gz", 187, "G"),
    ("rinex_samples/rinex2_nav/dlf10010.21g", 7, "R"),
    ("rinex_samples/rinex2_nav/ijmu3650.21n.gz", 244, "G"),
    ("static/kiru_2024090/KIR000SWE_R_20240900000_01D_MN.rnx", 735, "GECJ"),
    ("static/nl_2021001/AMEL00NLD_R_20210010000_01D_MN.rnx", 2351, "GRECJ"),
    ("static/nl_2021001/CBW100NLD_R_20210010000_01D_MN.rnx", 2311, "GREC"),
    ("static/tlse_2022001/BRDC00IGS_R_20220010000_01D_MN.zip", 18752, "GRECJS"),
    ("static/tlse_2024001/BRDC00IGS_R_20240010000_01D_MN.rnx.gz", 19601, "GRECJIS"),
    ("static/unsa_2019057/brdc0570.19n", 416, "G"),
    ("kinematic/urbannav_tst_20190428/hksc1180.19b", 356, "C"),
    ("kinematic/urbannav_tst_20190428/hksc1180.19n", 203, "G"),
    ("rtk/nagoya_static_rtk_2024/base.nav", 128, "GRECJ"),
]


@pytest.mark.parametrize(("name", "kept", "systems"), FILES)
def test_samples(shared_data: Path, name: str, kept: int, systems: str) -> None:
    r = read_nav(shared_data / name)
    assert r.n == kept
    assert {SYSTEMS[s] for s in r.sv >> 8} == set(systems)
    assert r.counts.get("corrupt", 0) == 0
    assert (np.abs(r.t_tx_ns - r.toe_ns) <= 86_400 * NS).all()
    keys = r.sv.astype(np.int64) * 2**44 + r.toe_ns // NS
    assert (np.diff(keys) >= 0).all()


def test_junk_orbits_are_refused(shared_data: Path) -> None:
    # every record of this file has its node at 4.5e4 rad
    with pytest.raises(StarwiseError, match="longitude of node"):
        read_nav(shared_data / "rinex_samples/georinex_edge_cases/brdc0320.16l.txt")


@pytest.mark.golden
@pytest.mark.parametrize(
    "name",
    [
        "static/kiru_2024090/KIR000SWE_R_20240900000_01D_MN.rnx",
        "static/tlse_2024001/BRDC00IGS_R_20240010000_01D_MN.rnx.gz",
    ],
)
def test_every_number_as_a_plain_reader_sees_it(shared_data: Path, name: str) -> None:
    path = shared_data / name
    data = gzip.decompress(path.read_bytes()) if name.endswith(".gz") else path.read_bytes()
    scale = {"C": "BDT", "R": "GLO"}
    wanted: dict[tuple[str, int], list[list[float | None]]] = {}
    for sv, epoch, numbers in twin(data.decode()):
        label = (epoch - GPS_EPOCH) // dt.timedelta(seconds=1) * NS
        wanted.setdefault((sv, label_to_gpst(label, scale.get(sv[0], "GPS"))), []).append(numbers)
    r = read_nav(path)
    for i in range(r.n):
        p = r.par[i]
        sv = sv_name(int(r.sv[i]))
        copies = wanted[sv, int(r.toc_ns[i])]
        if sv[0] in "RS":
            ours = [p[R_TAU], p[R_GAMMA], *(p[c + k] / 1000 for c in (R_X, R_VX, R_AX) for k in range(3))]
            read = [[n[0], n[1], *(n[3 + c + 4 * k] for c in range(3) for k in range(3))] for n in copies]
            if sv[0] == "R":
                ours.append(p[R_CHANNEL])
                read = [[*row, n[10]] for row, n in zip(read, copies, strict=True)]
        else:
            ours = [*p[list(ORBIT)], p[K_TOE_SOW], r.health[i]]
            read = [[*(n[k] for k in ORBIT.values()), n[11], n[24]] for n in copies]
        assert any(all(map(same, ours, row)) for row in read), sv


def same(a: float, b: float | None) -> bool:
    """Equal but for one rounding (km to m and back; 13 digits scaled by more than 10^22)."""
    return b is not None and abs(a - b) <= 3e-16 * abs(b)


def test_rinex4_counts_by_message(shared_data: Path) -> None:
    path = shared_data / "rinex_samples/rinex4/BRD400DLR_S_20230710000_01D_MN.rnx.gz"
    text = gzip.decompress(path.read_bytes()).decode()
    wanted = Counter(f"{s} {m}" for s, m in re.findall(r"^> EPH (\w)\d\d (\w+)", text, re.MULTILINE))
    r = read_nav(path)
    assert {k: v for k, v in r.counts.items() if re.fullmatch(r"\w \w+", k)} == dict(wanted)
    for name in ("STO", "EOP", "ION"):
        assert r.counts[name] == len(re.findall(rf"^> {name} ", text, re.MULTILINE))
    assert r.counts["kept"] + r.counts["duplicate"] + r.counts["contradictory"] == sum(wanted.values())
    kept = Counter(f"{SYSTEMS[s >> 8]} {MESSAGE_NAMES[m]}" for s, m in zip(r.sv, r.message, strict=True))
    assert set(kept) == set(wanted)
    assert set(r.ionosphere.klobuchar) == {"G", "C", "J", "I"}
    assert (r.par[r.message < 10][:, K_E] < 0.5).all()


def test_merging_files_of_neighbours(shared_data: Path) -> None:
    paths = sorted((shared_data / "static/nl_2021001").glob("*_MN.rnx"))
    apart = [read_nav(p) for p in paths]
    r = read_nav(*paths)
    assert r.counts["duplicate"] > 1000  # both stations saw most of the sky
    assert r.n + r.counts["duplicate"] + r.counts["contradictory"] == sum(a.n for a in apart)
    same = {(int(s), int(t), int(m)) for a in apart for s, t, m in zip(a.sv, a.toe_ns, a.message, strict=True)}
    assert {(int(s), int(t), int(m)) for s, t, m in zip(r.sv, r.toe_ns, r.message, strict=True)} == same
