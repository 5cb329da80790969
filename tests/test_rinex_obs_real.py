"""Every observation file of the shared data, against a slow reader of a few lines and against its packed copies."""

from pathlib import Path

import numpy as np
import pytest

from obs_twin import V2, Twin, read
from starwise.errors import StarwiseError
from starwise.io.files import read_bytes
from starwise.io.rinex_obs import read_obs
from starwise.signals import signal_name, sv_name
from starwise.types import Observations

pytestmark = pytest.mark.real

GOOD = [
    "rinex_samples/rinex2_obs/AJAC3550.21O",
    "rinex_samples/rinex2_obs/KOSG0010.95O",
    "rinex_samples/rinex2_obs/aopr0010.17o",
    "rinex_samples/rinex2_obs/barq071q.19o",
    "rinex_samples/rinex2_obs/delf0010.21o",
    "rinex_samples/rinex2_obs/npaz3550.21o",
    "rinex_samples/rinex2_obs/wsra0010.21o",
    "rinex_samples/rinex2_obs/zegv0010.21o",
    "rinex_samples/rinex3_obs/ACOR00ESP_R_20213550000_01D_30S_MO.rnx",
    "rinex_samples/rinex3_obs/DUTH0630.22O",
    "rinex_samples/rinex3_obs/VLNS0010.22O",
    "rinex_samples/rinex3_obs/VLNS0630.22O",
    "rinex_samples/rinex3_obs/flrs0010.12o",
    "rinex_samples/rinex3_obs/gps.23O.gz",
    "rinex_samples/rinex3_obs/pdel0010.21o",
    "rinex_samples/crinex1_rinex2/eijs0010.21d",
    "rinex_samples/crinex3/DOUR00BEL_R_20200130000_01D_30S_MO.crx",
    "rinex_samples/crinex3/KUNZ00CZE.crx",
    "rinex_samples/georinex_edge_cases/demo.10o",
    "rinex_samples/georinex_edge_cases/demo3.10o",
    "rinex_samples/georinex_edge_cases/14601736.18o",
    "rinex_samples/georinex_edge_cases/ab430140.18o.zip",
    "rinex_samples/georinex_edge_cases/ac660270.18o.Z",
    "rinex_samples/georinex_edge_cases/P43300USA_R_20190012056_17M_15S_MO.crx.bz2",
    "rinex_samples/hatanaka_containers/sample.rnx",
    "kinematic/phones/android/rinex_obs/pixel6.23o",
    "kinematic/urbannav_tst_20190428/COM3_190428_124409.obs",
    "rtk/geonet_2005092/07590920.05o",
    "rtk/geonet_2005092/30400920.05o",
    "rtk/nagoya_static_rtk_2024/base.obs",
    "rtk/nagoya_static_rtk_2024/rover.obs",
    "static/tlse_2023001/tlse001b.23o",
    "static/tlse_2023001/NIST00USA_R_20230010100_05M_30S_MO.crx.gz",
    "static/kiru_2024090/KIRU00SWE_R_20240900000_01D_30S_MO.rnx",
]


def names(twin: Twin, system: str) -> dict[str, tuple[str, ...]]:
    """RINEX 3 names that a raw code may take, by code as written."""
    if twin.version >= 3:
        table = {c: (c,) for c in twin.codes.get(system, [])}
        if system == "C" and abs(twin.version - 3.02) < 0.001:
            table = {c: (c[0] + "2" + c[2] if c[1] == "1" else c,) for c in table}
        return table
    known = V2.get(system, {})
    table = {c: (known[c],) for c in twin.codes[""] if c in known}
    for code in twin.codes[""]:
        if code[0] in "LDS":
            band = code[1]
            modes = [known[p + band][1:] for p in "PC" if p + band in twin.codes[""] and p + band in known]
            if modes:
                table[code] = tuple(code[0] + m for m in modes)
    return table


def check(obs: Observations, twin: Twin) -> None:
    epochs = sorted(twin.epochs, key=lambda e: e[0])
    assert obs.n_epochs == len(epochs)
    np.testing.assert_array_equal(obs.t_ns, [e[0] for e in epochs])
    np.testing.assert_array_equal(obs.flag, [e[1] for e in epochs])
    column = {"C": obs.code_m, "P": obs.code_m, "L": obs.phase_cyc, "D": obs.doppler_hz, "S": obs.cn0_dbhz}
    tables = {s: names(twin, s) for s in "GRECJIS"}
    used = 0
    for i, (_, _, rows) in enumerate(epochs):
        at = {}
        for r in range(obs.offsets[i], obs.offsets[i + 1]):
            at[sv_name(int(obs.sv[r])), signal_name(int(obs.sig[r]))] = r
        assert list(dict.fromkeys(sv for sv, _ in at)) == sorted(rows, key=lambda sv: ("GRECJIS".index(sv[0]), sv))
        for sv, values in rows.items():
            for code, (value, lli, _) in values.items():
                if code[0] not in column or code not in tables[sv[0]]:
                    continue
                found = [at[sv, n[1:]] for n in tables[sv[0]][code] if (sv, n[1:]) in at]
                found = [r for r in found if column[code[0]][r] == value]
                assert len(found) == 1 or (found and code[0] == "S"), (i, sv, code, value)
                if code[0] == "L" and lli.isdigit():
                    assert obs.lli[found[0]] == int(lli)
                used += 1
    total = sum(int(np.isfinite(column[k]).sum()) for k in "CLD")
    total_twin = sum(c[0] in "CPLD" and c in tables[sv[0]] for _, _, rows in epochs for sv in rows for c in rows[sv])
    assert total == total_twin  # nothing but what the file holds
    assert used > 0


@pytest.mark.parametrize("name", GOOD)
def test_same_as_a_slow_reader(shared_data: Path, name: str) -> None:
    path = shared_data / name
    check(read_obs(path), read(read_bytes(path).decode("latin-1")))


PAIRS = [
    ("rinex2_obs/AJAC3550.21O", "crinex1_rinex2/AJAC3550.21D"),
    ("rinex2_obs/KOSG0010.95O", "crinex1_rinex2/KOSG0010.95D"),
    ("rinex2_obs/aopr0010.17o", "crinex1_rinex2/aopr0010.17d"),
    ("rinex2_obs/delf0010.21o", "crinex1_rinex2/delf0010.21d"),
    ("rinex2_obs/wsra0010.21o", "crinex1_rinex2/wsra0010.21d"),
    ("rinex2_obs/npaz3550.21o", "crinex1_rinex2/npaz3550.21d"),
    ("rinex2_obs/zegv0010.21o", "crinex1_rinex2/zegv0010.21d"),
    ("rinex3_obs/DUTH0630.22O", "crinex3/DUTH0630.22D"),
    ("rinex3_obs/VLNS0010.22O", "crinex3/VLNS0010.22D"),
    ("rinex3_obs/VLNS0630.22O", "crinex3/VLNS0630.22D"),
    ("rinex3_obs/flrs0010.12o", "crinex3/flrs0010.12d"),
    ("rinex3_obs/pdel0010.21o", "crinex3/pdel0010.21d"),
    ("rinex3_obs/ACOR00ESP_R_20213550000_01D_30S_MO.rnx", "crinex3/ACOR00ESP_R_20213550000_01D_30S_MO.crx"),
    *((f"hatanaka_containers/sample.rnx{a}", f"hatanaka_containers/sample.{kind}{b}")
      for kind in ("rnx", "crx") for a, b in (("", ""), ("", ".Z"), ("", ".bz2"), ("", ".gz"), ("", ".zip"))),
]  # fmt: skip


def same(a: Observations, b: Observations) -> None:
    for name in ("t_ns", "offsets", "flag", "clock_offset_s", "sv", "sig", "code_m", "phase_cyc", "doppler_hz",
                 "cn0_dbhz", "lli"):  # fmt: skip
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert a.channels == b.channels
    assert a.header.signals == b.header.signals


@pytest.mark.parametrize(("plain", "packed"), PAIRS)
def test_packed_copy_is_the_same(shared_data: Path, plain: str, packed: str) -> None:
    samples = shared_data / "rinex_samples"
    same(read_obs(samples / plain), read_obs(samples / packed))


@pytest.mark.parametrize(
    "folder",
    ["rinex2_obs", "rinex3_obs", "crinex1_rinex2", "crinex3", "hatanaka_containers", "georinex_edge_cases", "met",
     "rinex2_nav"],
)  # fmt: skip
def test_every_sample_is_read_or_refused_in_one_line(shared_data: Path, folder: str) -> None:
    read_files = 0
    for path in sorted((shared_data / "rinex_samples" / folder).iterdir()):
        try:
            obs = read_obs(path)
        except StarwiseError as error:
            assert "\n" not in str(error), path.name
            assert str(path) in str(error), path.name
            continue
        read_files += 1
        assert (np.diff(obs.t_ns) > 0).all()
        assert obs.n_epochs or any("no epochs" in p.what for p in obs.problems)
    assert read_files > 0 or folder in ("met", "rinex2_nav")


def test_edge_cases_one_by_one(shared_data: Path) -> None:
    folder = shared_data / "rinex_samples" / "georinex_edge_cases"
    assert read_obs(folder / "blank.10o").n_epochs == 0
    assert read_obs(folder / "blank3.10o").n_epochs == 0
    bad = read_obs(folder / "badtime.10o")  # first record's seconds are "0 .0", the second's 60.0
    assert bad.n_epochs == 1
    assert bad.problems[0].line == 5
    junk = read_obs(folder / "junk_time_obs3.10o")
    assert junk.n_epochs == 2
    assert [p.line for p in junk.problems] == [10]
    with pytest.raises(StarwiseError, match="6 stated, 7 listed"):
        read_obs(folder / "wrong_obs2_count.10o")
    glonass = read_obs(folder / "default_time_system2.10o")
    # a GLONASS file without a named time system is in UTC: 15 leap seconds in March 2010
    assert glonass.header.time_system == "GLO"
    assert glonass.t_ns[0] == read_obs(folder / "demo.10o").t_ns[0] + 45 * 10**9
    events = read_obs(folder / "14601736.18o")
    assert {p.what for p in events.problems} == {"event: antenna moves (flag 2)", "event: new site (flag 3)"}
    cut = read_obs(shared_data / "rinex_samples" / "rinex2_obs" / "rovn0010.21o")
    assert cut.n_epochs == 5
    assert any("epoch dropped" in p.what for p in cut.problems)
