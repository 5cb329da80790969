"""SP3 reader: files made by hand, and real ones against a reader of a few lines."""

import datetime as dt
import gzip
from pathlib import Path

import numpy as np
import pytest

from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.gnsstime import from_calendar, utc_to_gpst
from starwise.io.sp3 import read_sp3
from starwise.signals import sv_id, sv_name

T_NS = from_calendar(2024, 3, 30)
START = dt.datetime(2024, 3, 30)
SVS = ("G01", "E11", "C30")


def made(
    version: str = "d", epochs: int = 4, system: str = "GPS", svs: tuple[str, ...] = SVS, start: dt.datetime = START,
    tail: str = "", offset_km: float = 0.0,
) -> str:  # fmt: skip
    """An SP3 file: satellite i at (10000 + i, -20000 - 10 epoch, 5000.5) km, clock i + 0.25 microseconds."""
    text = f"#{version}P{start:%Y %m %d %H %M}  0.00000000 {epochs:7d} ORBIT IGS20 FIT TEST\n"
    text += "## 2307 518400.00000000   900.00000000 60399 0.0000000000000\n"
    for k in range(0, max(len(svs), 85), 17):
        names = "".join(s if version != "a" else f"{int(s[1:]):3d}" for s in svs[k : k + 17])
        count = f"{len(svs):5d}" if k == 0 else "     "
        text += f"+{count}   {names + '  0' * (17 - len(svs[k : k + 17]))}\n"
    for k in range(0, max(len(svs), 85), 17):
        text += "++       " + "".join(f"{5 if k + j < len(svs) else 0:3d}" for j in range(17)) + "\n"
    text += f"%c M  cc {system} ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc\n"
    text += "%c cc cc ccc ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc\n"
    text += "%f  1.2500000  1.025000000  0.00000000000  0.000000000000000\n"
    text += "%f  0.0000000  0.000000000  0.00000000000  0.000000000000000\n"
    text += "%i    0    0    0    0      0      0      0      0         0\n" * 2
    text += "/* made for a test\n" * 4
    for e in range(epochs):
        t = start + dt.timedelta(seconds=900 * e)
        text += f"*  {t.year} {t.month:2d} {t.day:2d} {t.hour:2d} {t.minute:2d}  0.00000000\n"
        for i, sv in enumerate(svs):
            name = sv if version != "a" else f" {int(sv[1:]):2d}"
            xyz = (10_000.0 + i + offset_km, -20_000.0 - 10 * e, 5000.5)
            text += f"P{name}" + "".join(f"{v:14.6f}" for v in (*xyz, i + 0.25)) + tail + "\n"
    return text + "EOF\n"


def write(tmp_path: Path, text: str, name: str = "made.sp3") -> Path:
    path = tmp_path / name
    path.write_bytes(text.encode("latin-1"))
    return path


@pytest.mark.parametrize("version", ["a", "b", "c", "d", " "])
def test_numbers_land_in_their_places(tmp_path: Path, version: str) -> None:
    svs = ("G01", "G11", "G30") if version in "a " else SVS
    text = (
        made(version if version != " " else "a", svs=svs).replace("#a", "# ")
        if version == " "
        else made(version, svs=svs)
    )
    o = read_sp3(write(tmp_path, text))
    assert o.sv.tolist() == [sv_id(s) for s in sorted(svs, key=sv_id)]
    assert o.t_ns.tolist() == [T_NS + k * 900 * NS for k in range(4)]
    for s, name in enumerate(o.sv):
        i = svs.index(sv_name(int(name)))
        np.testing.assert_allclose(o.pos_e[s, 2], [1e7 + 1e3 * i, -20_020e3, 5_000_500.0], atol=1e-8)  # m, F14.6 km
        np.testing.assert_allclose(o.clock_s[s], (i + 0.25) * 1e-6, rtol=1e-15)
    assert (o.frame, o.agency, o.time_system) == ("IGS20", "TEST", "GPS")
    np.testing.assert_allclose(o.pos_sigma_m, 0.032)  # 2^5 mm
    assert o.problems == ()


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_line_ends(tmp_path: Path, end: str) -> None:
    o = read_sp3(write(tmp_path, made().replace("\n", end)))
    assert o.pos_e.shape == (3, 4, 3)
    assert o.problems == ()


@pytest.mark.parametrize(
    ("system", "shift_s"),
    [("GPS", 0), ("ccc", 0), ("   ", 0), ("GAL", 0), ("QZS", 0), ("BDT", 14), ("UTC", 18), ("GLO", 18), ("TAI", -19)],
)
def test_time_systems(tmp_path: Path, system: str, shift_s: int) -> None:
    o = read_sp3(write(tmp_path, made(system=system)))
    assert o.t_ns[0] == T_NS + shift_s * NS
    assert utc_to_gpst(T_NS) == T_NS + 18 * NS


def test_unknown_time_system(tmp_path: Path) -> None:
    with pytest.raises(StarwiseError, match="time system"):
        read_sp3(write(tmp_path, made(system="XYZ")))


def test_more_satellites_than_85(tmp_path: Path) -> None:
    svs = tuple(f"{s}{n:02d}" for s in "GREC" for n in range(1, 31))
    o = read_sp3(write(tmp_path, made(svs=svs)))
    assert len(o.sv) == 120
    np.testing.assert_allclose(o.pos_sigma_m, 0.032)


def test_absent_and_flags(tmp_path: Path) -> None:
    lines = made().split("\n")
    rows = [k for k, line in enumerate(lines) if line.startswith("P")]
    lines[rows[0]] = "PG01" + f"{0.0:14.6f}" * 3 + f"{999999.999999:14.6f}"
    lines[rows[1]] = lines[rows[1]][:46] + f"{999999.999999:14.6f}"
    lines[rows[2]] = lines[rows[2]][:46]
    lines[rows[3]] = f"{lines[rows[3]]:60}  3  3  3  10 EP  MP"
    o = read_sp3(write(tmp_path, "\n".join(lines)))
    g, e, c = (o.sv.tolist().index(sv_id(s)) for s in SVS)
    assert np.isnan(o.pos_e[g, 0]).all()
    assert np.isnan(o.clock_s[[g, e, c], 0]).all()
    assert np.isfinite(o.pos_e[[e, c], 0]).all()
    assert o.predicted[g].tolist() == [False, True, False, False]
    assert o.pos_sigma_m[g, 1] == pytest.approx(1.25**3 * 1e-3, abs=1e-12)
    assert o.clock_sigma_s[g, 1] == pytest.approx(1.025**10 * 1e-12, abs=1e-20)


def test_velocities_and_correlations_are_passed_over(tmp_path: Path) -> None:
    text = made()
    extra = "\n".join(
        line if not line.startswith("P") else f"{line}\nEP  55  55  55     222\nV{line[1:]}\nEV  22  22  22     111"
        for line in text.split("\n")
    )
    plain, other = read_sp3(write(tmp_path, text)), read_sp3(write(tmp_path, extra))
    np.testing.assert_array_equal(plain.pos_e, other.pos_e)
    assert other.problems == ()


class TestMerging:
    def test_next_day(self, tmp_path: Path) -> None:
        a = write(tmp_path, made(epochs=97), "a.sp3")
        b = write(tmp_path, made(epochs=96, start=START + dt.timedelta(days=1), offset_km=1.0), "b.sp3")
        o = read_sp3(a, b)
        assert len(o.t_ns) == 97 + 95
        assert (np.diff(o.t_ns) == 900 * NS).all()
        assert o.pos_e[0, 96, 0] == 1e7  # the epoch both have: the file named first
        assert read_sp3(b, a).pos_e[0, 96, 0] == 1e7 + 1000.0

    def test_observed_wins_over_predicted(self, tmp_path: Path) -> None:
        old = write(tmp_path, made(tail="                   P"), "old.sp3")
        new = write(tmp_path, made(offset_km=2.0), "new.sp3")
        assert read_sp3(old).predicted.all()
        for o in (read_sp3(old, new), read_sp3(new, old)):
            assert not o.predicted.any()
            assert o.pos_e[0, 0, 0] == 10_002e3


class TestDamage:
    def test_no_eof(self, tmp_path: Path) -> None:
        o = read_sp3(write(tmp_path, made().removesuffix("EOF\n")))
        assert o.pos_e.shape == (3, 4, 3)
        assert "EOF" in o.problems[0].what

    def test_cut_anywhere(self, tmp_path: Path) -> None:
        text = made()
        whole = read_sp3(write(tmp_path, text))
        for stop in range(0, len(text), 11):
            try:
                o = read_sp3(write(tmp_path, text[:stop]))
            except StarwiseError:
                continue
            got = np.isfinite(o.pos_e)
            for s, sv in enumerate(o.sv):
                full = whole.pos_e[whole.sv.tolist().index(sv)][: len(o.t_ns)]
                np.testing.assert_array_equal(o.pos_e[s][got[s]], full[got[s]])
            clocks = np.isfinite(o.clock_s)
            index = [whole.sv.tolist().index(sv) for sv in o.sv]
            np.testing.assert_array_equal(o.clock_s[clocks], whole.clock_s[index, : len(o.t_ns)][clocks])

    @pytest.mark.parametrize(
        ("old", "new"),
        [
            (" 0 30  0.0", " 1 30  0.0"),
            (" 0 30  0.0", " 0 35  0.0"),
            (" 3 30  0 30", " 3 28  0 30"),
            (" 0 30  0.0", " 0 x0  0.0"),
        ],
    )
    def test_an_epoch_out_of_line_is_left_out(self, tmp_path: Path, old: str, new: str) -> None:
        text = made(epochs=12)
        head, body = text.split("/*", 1)
        o = read_sp3(write(tmp_path, head + "/*" + body.replace(old, new, 1)))
        assert len(o.t_ns) == 11
        assert T_NS + 1800 * NS not in o.t_ns
        assert "left out" in o.problems[0].what

    def test_shifted_and_unreadable_numbers(self, tmp_path: Path) -> None:
        lines = made().split("\n")
        rows = [k for k, line in enumerate(lines) if line.startswith("P")]
        lines[rows[0]] = lines[rows[0]].replace("PG01", "PG01 ")
        lines[rows[1]] = lines[rows[1]][:10] + "x" + lines[rows[1]][11:]
        lines[rows[2]] = "PL99" + lines[rows[2]][4:]
        lines[rows[3]] = "PG01" + f"{100.0:14.6f}" * 4
        lines[rows[4]] = lines[rows[3] + 1]
        lines.insert(rows[5], lines[rows[5]])
        o = read_sp3(write(tmp_path, "\n".join(lines)))
        whats = " ".join(p.what for p in o.problems)
        for part in ("number not readable", "no navigation system", "second time", "no satellite"):
            assert part in whats
        assert T_NS not in o.t_ns  # nothing is left of the first epoch
        assert np.isnan(o.pos_e[0, 0]).all()

    @pytest.mark.parametrize("text", ["", "\n", "garbage\n", "#cP2017  2 14\n", "#dP"])
    def test_refused_in_one_line(self, tmp_path: Path, text: str) -> None:
        with pytest.raises(StarwiseError) as caught:
            read_sp3(write(tmp_path, text))
        assert "\n" not in str(caught.value)

    def test_no_file(self, tmp_path: Path) -> None:
        with pytest.raises(StarwiseError):
            read_sp3()


REAL = [
    # satellites and epochs, by the header and counts of '*' lines
    ("products/sp3/COD0MGXFIN_20230500000_01D_05M_ORB.SP3.gz", 118, 289),
    ("products/sp3/ESA0OPSRAP_20232390000_01D_15M_ORB.SP3.gz", 54, 96),
    ("products/sp3/Sta21114.sp3.gz", 121, 97),
    ("products/sp3/co108870.sp3", 24, 96),
    ("products/sp3/emr08874.sp3", 25, 96),
    ("products/sp3/sio06492.sp3", 17, 148),
    ("products/sp3/example.txt", 5, 1),
    ("static/kiru_2024090/COD0MGXFIN_20240900000_01D_05M_ORB.SP3", 121, 289),
    ("static/tlse_2022001/WUM0MGXULT_20220010000_01H_05M_ORB.SP3", 112, 13),
    ("static/tlse_2022001/igs21906.sp3", 32, 96),
    ("static/unsa_2019057/igr20422.sp3", 32, 96),
    ("static/unsa_2019057/igu20422_18.sp3", 31, 192),
    ("rinex_samples/georinex_edge_cases/truncated.sp3", 32, 1),
]


@pytest.mark.real
@pytest.mark.parametrize(("name", "satellites", "epochs"), REAL)
def test_real_files_as_a_plain_reader_sees_them(shared_data: Path, name: str, satellites: int, epochs: int) -> None:
    data = (shared_data / name).read_bytes()
    text = (gzip.decompress(data) if name.endswith(".gz") else data).decode()
    wanted: dict[tuple[int, int], tuple[float, ...]] = {}
    t_ns = 0
    for line in text.splitlines():
        if line.startswith("*"):
            y, mo, d, h, mi = (int(line[a:b]) for a, b in ((3, 7), (7, 10), (10, 13), (13, 16), (16, 19)))
            t_ns = from_calendar(y, mo, d, h, mi, float(line[19:31]))
        elif line.startswith("P") and len(line) >= 60:
            numbers = tuple(float(line[4 + 14 * k : 18 + 14 * k]) for k in range(4))
            if any(numbers[:3]):
                wanted[sv_id(line[1:4]), t_ns] = numbers
    o = read_sp3(shared_data / name)
    assert o.pos_e.shape == (satellites, epochs, 3)
    got = {
        (int(o.sv[i]), int(o.t_ns[j])): (i, j) for i, j in zip(*np.nonzero(np.isfinite(o.pos_e[..., 0])), strict=True)
    }
    assert len(wanted) - len(got) in ((0, 1) if not text.rstrip().endswith("EOF") else (0,))
    for key, (i, j) in got.items():
        x, y, z, clock = wanted[key]
        np.testing.assert_allclose(o.pos_e[i, j], (x * 1e3, y * 1e3, z * 1e3), rtol=0, atol=1e-7)  # m: one rounding
        if clock < 999_999.0:
            assert abs(o.clock_s[i, j] - clock * 1e-6) < 1e-18  # s
        else:
            assert np.isnan(o.clock_s[i, j])


@pytest.mark.real
@pytest.mark.parametrize("name", ["blank.sp3", "header.sp3"])
def test_real_files_refused(shared_data: Path, name: str) -> None:
    with pytest.raises(StarwiseError):
        read_sp3(shared_data / "rinex_samples/georinex_edge_cases" / name)


@pytest.mark.real
def test_predicted_half_of_an_ultra_rapid(shared_data: Path) -> None:
    o = read_sp3(shared_data / "static/unsa_2019057/igu20422_18.sp3")
    assert not o.predicted[:, :96].any()
    assert o.predicted[:, 96:].all()
