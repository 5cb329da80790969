"""The shared real measurements as a table: what belongs together, and how RTKLIB is run on it."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from starwise.frames import C_ne_enu, geodetic_from_ecef

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("STARWISE_SHARED_DATA", ROOT.parent / "shared" / "data"))


@dataclass(frozen=True)
class DataSet:
    name: str
    obs: str
    nav: tuple[str, ...]
    truth: str | None
    conf: str = "spp.conf"
    sp3: str | None = None
    clk: str | None = None
    systems: str = "GRECJ"


STATIC = (
    DataSet("tlse_2022 1 h", "static/tlse_2022001/TLSE00FRA_R_20220010000_01H_30S_MO.rnx.gz",
            ("static/tlse_2022001/BRDC00IGS_R_20220010000_01D_MN.zip",), "TLSE_2022.001",
            sp3="static/tlse_2022001/igs21906.sp3"),
    DataSet("tlse_2022 24 h G", "static/tlse_2022001/TLSE00FRA_R_20220010000_01D_30S_GO.zip",
            ("static/tlse_2022001/BRDC00IGS_R_20220010000_01D_MN.zip",), "TLSE_2022.001",
            conf="spp_gps.conf", sp3="static/tlse_2022001/igs21906.sp3", systems="G"),
    DataSet("tlse_2024 15 min", "static/tlse_2024001/TLSE00FRA_R_20240011200_15M_01S_MO.crx.gz",
            ("static/tlse_2024001/BRDC00IGS_R_20240010000_01D_MN.rnx.gz",), "TLSE_2024.001"),
    DataSet("tlse_2024 1 h", "static/tlse_2024001/TLSE00FRA_R_20240011800_01H_30S_MO.crx.gz",
            ("static/tlse_2024001/BRDC00IGS_R_20240010000_01D_MN.rnx.gz",), "TLSE_2024.001"),
    DataSet("kiru_2024 2 h", "static/kiru_2024090/KIRU00SWE_R_20240900000_01D_30S_MO.rnx",
            ("static/kiru_2024090/KIR000SWE_R_20240900000_01D_MN.rnx",), "KIRU_2024.244",
            sp3="static/kiru_2024090/COD0MGXFIN_20240900000_01D_05M_ORB.SP3",
            clk="static/kiru_2024090/COD0MGXFIN_20240900000_01D_30S_CLK_short.CLK"),
    DataSet("unsa_2019 24 h", "static/unsa_2019057/UNSA00ARG_R_20190570000_01D_30S_MO.crx.gz",
            ("static/unsa_2019057/brdc0570.19n",), "UNSA_2019.155", conf="spp_gps.conf",
            sp3="static/unsa_2019057/igr20422.sp3", systems="G"),
    DataSet("delf_2021 24 h", "static/nl_2021001/delf0010.21d",
            ("static/nl_2021001/AMEL00NLD_R_20210010000_01D_MN.rnx",), "DELF"),
    DataSet("zegv_2021 24 h", "static/nl_2021001/zegv0010.21d",
            ("static/nl_2021001/AMEL00NLD_R_20210010000_01D_MN.rnx",), "ZEGV"),
    DataSet("nagoya rover", "rtk/nagoya_static_rtk_2024/rover.obs",
            ("rtk/nagoya_static_rtk_2024/base.nav",), "NAGOYA_ROVER"),
    DataSet("nagoya base", "rtk/nagoya_static_rtk_2024/base.obs",
            ("rtk/nagoya_static_rtk_2024/base.nav",), "NAGOYA_BASE"),
)  # fmt: skip
URBAN = DataSet(
    "urbannav tst", "kinematic/urbannav_tst_20190428/COM3_190428_124409.obs",
    ("kinematic/urbannav_tst_20190428/hksc1180.19n", "kinematic/urbannav_tst_20190428/hksc1180.19b"), None,
)  # fmt: skip


def truth_ecef(name: str) -> np.ndarray:
    """Antenna reference point, ECEF m: the marker plus the ARP height along the ellipsoid's normal."""
    entry = json.loads((DATA / "truth.json").read_text())[name]
    marker = np.array(entry["marker_ecef_m"], dtype=float)
    lat, lon, _ = geodetic_from_ecef(marker)
    return marker + C_ne_enu(lat, lon)[2] * entry["arp_height_above_marker_m"]


def plain(path: str, folder: Path) -> Path:
    """The file, decompressed into ``folder`` (RTKLIB reads plain files)."""
    from starwise.io.files import read_bytes

    target = folder / (Path(path).name + ".plain")
    if not target.exists():
        target.write_bytes(read_bytes(DATA / path))
    return target


def rtklib_spp(data: DataSet, folder: Path, sp3: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time of week (s), ECEF positions (n, 3) and their standard deviations (n, 3) of Debian's rnx2rtkp."""
    out = folder / (data.name.replace(" ", "_") + ".pos")
    conf = folder / data.conf
    text = (DATA / "rtklib_conf" / data.conf).read_text()
    conf.write_text(text.replace("=brdc\npos1-navsys", "=precise\npos1-navsys") if sp3 else text)
    command = ["rnx2rtkp", "-k", str(conf), "-o", str(out)]
    command += [str(plain(data.obs, folder)), *(str(plain(n, folder)) for n in data.nav)]
    if sp3 and data.sp3:
        orbits = folder / Path(data.sp3).with_suffix(".sp3").name  # RTKLIB goes by the name's ending
        if not orbits.exists():
            orbits.write_bytes((DATA / data.sp3).read_bytes())
        command.append(str(orbits))
    subprocess.run(command, check=True, capture_output=True)
    table = np.array(
        [line.split()[:10] for line in out.read_text().splitlines() if line[:1].isdigit()], dtype=float
    ).reshape(-1, 10)
    return table[:, 1], table[:, 2:5], table[:, 7:10]


def scratch() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="starwise-bench-")
