"""RINEX clock reader: files made by hand, and real ones against a reader of a few lines."""

from pathlib import Path

import numpy as np
import pytest

from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.gnsstime import from_calendar
from starwise.io.clk import read_clk
from starwise.signals import sv_id, sv_name

T_NS = from_calendar(2024, 3, 30, 10)


def header(version: str = "3.04", system: str = "GPS") -> str:
    width = 65 if version == "3.04" else 60
    at = 21 if version == "3.04" else 20
    first = f"{version if version == '3.04' else '     ' + version:<{at}}C"
    rows = [
        f"{first:<{width}}RINEX VERSION / TYPE",
        f"{'   ' + system:<{width}}TIME SYSTEM ID",
        f"{'':<{width}}END OF HEADER",
    ]
    return "\n".join(rows) + "\n"


def line(
    sv: str, minute: int, bias: float, sigma: float | None = 1e-11, version: str = "3.04", second: float = 0.0
) -> str:
    name = f"{sv:<9}" if version == "3.04" else f"{sv:<4}"
    time = f"2024 03 30 10 {minute:02d}{second:10.6f}"
    values = f"{bias:19.12E}" + (f" {sigma:19.12E}" if sigma is not None else "")
    return f"AS {name} {time}{1 if sigma is None else 2:3d}   {values}\n"


def write(tmp_path: Path, text: str, name: str = "made.clk") -> Path:
    path = tmp_path / name
    path.write_bytes(text.encode("latin-1"))
    return path


def body(version: str = "3.04") -> str:
    text = ""
    for minute in range(6):
        text += "AR POTS      2024 03 30 10 00  0.000000  1    0.100000000000E-08\n"
        text += line("G05", minute, 1e-4 + 1e-9 * minute, 1e-11, version)
        text += line("E11", minute, -2e-4, None, version, 30.0)
    return text


@pytest.mark.parametrize("version", ["2.00", "3.00", "3.04"])
def test_numbers_land_in_their_places(tmp_path: Path, version: str) -> None:
    c = read_clk(write(tmp_path, header(version) + body(version)))
    assert c.sv.tolist() == [sv_id("G05"), sv_id("E11")]
    assert c.offsets.tolist() == [0, 6, 12]
    assert c.t_ns[:6].tolist() == [T_NS + 60 * k * NS for k in range(6)]
    assert c.t_ns[6] == T_NS + 30 * NS
    np.testing.assert_allclose(c.clock_s[:6], [1e-4 + 1e-9 * k for k in range(6)], rtol=1e-12)
    np.testing.assert_allclose(c.sigma_s[:6], 1e-11, rtol=3e-16)  # 13 digits over 10^23: two roundings
    assert np.isnan(c.sigma_s[6:]).all()
    assert [p.count for p in c.problems] == [6]  # the AR records


@pytest.mark.parametrize(
    ("system", "shift_s"), [("GPS", 0), ("   ", 0), ("GAL", 0), ("BDT", 14), ("UTC", 18), ("TAI", -19)]
)
def test_time_systems(tmp_path: Path, system: str, shift_s: int) -> None:
    assert read_clk(write(tmp_path, header(system=system) + body())).t_ns[0] == T_NS + shift_s * NS


def test_six_values_on_two_lines(tmp_path: Path) -> None:
    first = line("G05", 0, 1e-4).replace("  2   ", "  6   ")
    more = "   " + f"{1e-12:19.12E} " * 4 + "\n"
    c = read_clk(write(tmp_path, header() + first + more + line("G05", 1, 2e-4)))
    assert c.clock_s.tolist() == [1e-4, 2e-4]
    assert c.problems == ()


def test_crlf_and_fortran_exponents(tmp_path: Path) -> None:
    text = (header() + body()).replace("E-", "D-").replace("\n", "\r\n")
    c = read_clk(write(tmp_path, text))
    np.testing.assert_array_equal(c.clock_s, read_clk(write(tmp_path, header() + body())).clock_s)


def test_merging(tmp_path: Path) -> None:
    a = write(tmp_path, header() + line("G05", 0, 1e-4) + line("G05", 1, 2e-4), "a.clk")
    b = write(tmp_path, header() + line("G05", 1, 9e-4) + line("G05", 2, 3e-4) + line("G06", 2, 4e-4), "b.clk")
    c = read_clk(a, b)
    assert c.clock_s.tolist() == [1e-4, 2e-4, 3e-4, 4e-4]
    assert read_clk(b, a).clock_s.tolist() == [1e-4, 9e-4, 3e-4, 4e-4]


def test_damage_is_left_out_and_noted(tmp_path: Path) -> None:
    good = [line("G05", k, 1e-4) for k in range(10)]
    bad = {
        1: ("satellite", good[1].replace("G05", "X05")),
        2: ("epoch not readable", good[2].replace("2024", "20x4")),
        3: ("epoch out of order", good[3].replace("10 03", "12 03")),
        4: ("number", good[4].replace("1.0000", "1.0x00")),
        5: ("no satellite", good[5].replace("E-04", "E+04")),
        6: ("cut short", good[6][:44] + "\n"),
        7: ("contradict", good[7] + line("G05", 7, 2e-4)),
    }
    text = header() + "".join(bad[k][1] if k in bad else row for k, row in enumerate(good))
    c = read_clk(write(tmp_path, text))
    assert c.t_ns.tolist() == [T_NS + 60 * k * NS for k in (0, 8, 9)]
    whats = " | ".join(p.what for p in c.problems)
    for what, _ in bad.values():
        assert what in whats


def test_cut_anywhere(tmp_path: Path) -> None:
    text = header() + body()
    whole = read_clk(write(tmp_path, text))
    known = dict(zip(whole.t_ns.tolist(), whole.clock_s.tolist(), strict=True))
    for stop in range(len(text)):
        try:
            c = read_clk(write(tmp_path, text[:stop]))
        except StarwiseError:
            continue
        assert all(known[t] == v for t, v in zip(c.t_ns.tolist(), c.clock_s.tolist(), strict=True))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "\n",
        "garbage",
        header().replace("C  ", "O  ", 1),
        header("5.00"),
        header(),
        header().replace("END OF", "END"),
    ],
)
def test_refused_in_one_line(tmp_path: Path, text: str) -> None:
    with pytest.raises(StarwiseError) as caught:
        read_clk(write(tmp_path, text))
    assert "\n" not in str(caught.value)


REAL = [
    ("products/clk/COD20352.CLK", 423),
    ("products/clk/COD21925.CLK_05S", 10),
    ("products/clk/USNO1.txt", 1),
    ("products/clk/example1.txt", 1),
    ("products/clk/example2.txt", 2),
    ("static/kiru_2024090/COD0MGXFIN_20240900000_01D_30S_CLK_short.CLK", 29_038),
    ("kinematic/phones/products_2021118/COD0MGXFIN_20211180000_01D_30S_CLK.CLK", 14_036),
]


@pytest.mark.real
@pytest.mark.parametrize(("name", "records"), REAL)
def test_real_files_as_a_plain_reader_sees_them(shared_data: Path, name: str, records: int) -> None:
    text = (shared_data / name).read_text()
    wanted = {}
    for row in text.splitlines():
        if row.startswith("AS "):
            _, sv, *time, second, _n, bias = row.split()[:10]
            wanted[sv_id(sv), from_calendar(*(int(w) for w in time), float(second))] = float(bias)
    c = read_clk(shared_data / name)
    assert len(wanted) == records
    sv = np.repeat(c.sv, np.diff(c.offsets))
    got = {(int(s), int(t)): v for s, t, v in zip(sv, c.t_ns, c.clock_s, strict=True)}
    assert got.keys() == wanted.keys()
    for key, value in wanted.items():
        assert got[key] == pytest.approx(value, rel=3e-16, abs=0.0), sv_name(key[0])  # the last bit of 12 digits


@pytest.mark.real
def test_a_file_without_satellites(shared_data: Path) -> None:
    with pytest.raises(StarwiseError, match="no satellite clocks"):
        read_clk(shared_data / "products/clk/example3.txt")
