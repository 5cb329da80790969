"""The observation reader on synthetic text: what is written is read, what is odd is told."""

import datetime as dt
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from obs_twin import cell, epoch2, epoch3, head, header2, header3
from starwise.errors import StarwiseError
from starwise.gnsstime import from_calendar
from starwise.io.rinex_obs import parse_obs, read_obs
from starwise.signals import signal_name, sv_id, sv_name
from starwise.types import Observations

T0 = dt.datetime(2024, 1, 1)
STEP = dt.timedelta(seconds=30)
GPS0 = from_calendar(2024, 1, 1)
Row = tuple[float, float, float, float, int]


def obs_of(lines: list[str], end: str = "\n") -> Observations:
    return parse_obs((end.join(lines) + end).encode(), "synthetic")


def rows(obs: Observations, epoch: int = 0) -> dict[str, Row]:
    """Rows of an epoch by name: code, phase, Doppler, C/N0, LLI."""
    found = {}
    for r in range(obs.offsets[epoch], obs.offsets[epoch + 1]):
        name = f"{sv_name(int(obs.sv[r]))} {signal_name(int(obs.sig[r]))}"
        found[name] = (
            float(obs.code_m[r]),
            float(obs.phase_cyc[r]),
            float(obs.doppler_hz[r]),
            float(obs.cn0_dbhz[r]),
            int(obs.lli[r]),
        )
    return found


def told(obs: Observations, words: str) -> int:
    """How often a problem with these words was counted."""
    return sum(p.count for p in obs.problems if words in p.what)


CODES = {"G": ["C1C", "L1C", "D1C", "S1C", "C2W", "L2W"], "C": ["C2I", "L2I", "D2I", "S2I"]}
ONE = {"G05": [2.1e7, 1.1e8, -1234.567, 45.5, 2.1e7 + 3, 8.6e7], "C01": [3.6e7, 1.9e8, 12.25, 40.0]}


def test_rows_are_joined_on_the_signal_and_sorted_by_satellite() -> None:
    obs = obs_of(header3(CODES) + epoch3(T0, {"C01": ONE["C01"], "G12": ONE["G05"], "G05": ONE["G05"]}))
    found = rows(obs)
    assert list(found) == ["G05 1C", "G05 2W", "G12 1C", "G12 2W", "C01 2I"]
    assert found["G05 1C"] == (2.1e7, 1.1e8, -1234.567, 45.5, 0)
    np.testing.assert_equal(found["G05 2W"], (2.1e7 + 3, 8.6e7, np.nan, np.nan, 0))
    assert obs.problems == ()
    assert obs.t_ns.tolist() == [GPS0]
    assert obs.header.signals["C"] == ("C2I", "L2I", "D2I", "S2I")


def test_carriage_returns_and_a_missing_last_line_end_change_nothing() -> None:
    lines = header3(CODES) + epoch3(T0, ONE) + epoch3(T0 + STEP, ONE)
    text = "\n".join(lines)
    want = parse_obs((text + "\n").encode())
    for other in (text, "\r\n".join(lines) + "\r\n", text + "\n\n\n"):
        got = parse_obs(other.encode())
        np.testing.assert_array_equal(got.code_m, want.code_m)
        np.testing.assert_array_equal(got.lli, want.lli)
        assert got.problems == ()


values = st.one_of(
    st.none(),
    st.integers(min_value=-(10**12) + 1, max_value=10**13 - 1).filter(lambda v: v != 0).map(lambda v: v / 1000),
)
satellites = st.sampled_from([f"{s}{n:02d}" for s in "GRECJIS" for n in (1, 2, 9, 10, 37, 99)])
epochs = st.lists(st.dictionaries(satellites, st.lists(values, min_size=7, max_size=7), max_size=30), max_size=4)


@pytest.mark.laws
@given(epochs)
@settings(max_examples=60, deadline=None)
def test_what_is_written_in_version_3_is_read(data: list[dict[str, list[float | None]]]) -> None:
    names = ["C1C", "L1C", "D1C", "S1C", "L5X", "C5X", "S7Q"]
    lines = header3(dict.fromkeys("GRECJIS", names))
    for i, one in enumerate(data):
        lines += epoch3(T0 + i * STEP, one)
    obs = obs_of(lines)
    compare(obs, data, [n.replace("S7Q", "S7Q") for n in names])


@pytest.mark.laws
@given(epochs)
@settings(max_examples=60, deadline=None)
def test_what_is_written_in_version_2_is_read(data: list[dict[str, list[float | None]]]) -> None:
    data = [{sv: v for sv, v in one.items() if sv[0] in "GJ"} for one in data]
    data = [one for one in data if one]
    codes = ["C1", "L1", "D1", "S1", "L5", "C5", "S5"]
    lines = header2(codes)
    for i, one in enumerate(data):
        lines += epoch2(T0 + i * STEP, one)
    compare(obs_of(lines), data, ["C1C", "L1C", "D1C", "S1C", "L5X", "C5X", "S5X"])


def compare(obs: Observations, data: list[dict[str, list[float | None]]], names: list[str]) -> None:
    assert obs.n_epochs == len(data)
    assert [p for p in obs.problems if "no epochs" not in p.what] == []
    for i, one in enumerate(data):
        want: dict[str, list[float]] = {}
        for sv, cells in one.items():
            for name, value in zip(names, cells, strict=True):
                if value is not None:
                    want.setdefault(f"{sv} {name[1:]}", [np.nan] * 4)["CLDS".index(name[0])] = value
            if all(v is None for v in cells):
                want[f"{sv} {names[0][1:]}"] = [np.nan] * 4
        got = rows(obs, i)
        assert set(got) == set(want)
        for name in want:
            np.testing.assert_array_equal(got[name][:4], want[name])
        order = [int(v) for v in obs.sv[obs.offsets[i] : obs.offsets[i + 1]]]
        assert order == sorted(order)


def test_blank_and_zero_values_are_missing() -> None:
    obs = obs_of(header3(CODES) + epoch3(T0, {"G05": [0.0, 1.1e8, 0.0, 0.0, None, 0.0], "G06": [0.0] * 6}))
    found = rows(obs)
    np.testing.assert_equal(found["G05 1C"], (np.nan, 1.1e8, np.nan, np.nan, 0))
    assert "G05 2W" not in found
    np.testing.assert_equal(found["G06 1C"], (np.nan,) * 4 + (0,))  # in view, nothing measured


def test_loss_of_lock_is_that_of_the_phase() -> None:
    line = "G05" + cell(2e7, "1 ") + cell(1e8, "35") + cell(-5.0, "7 ") + cell(44.0)
    assert rows(obs_of([*header3(CODES), *epoch3(T0, {}, count=1), line]))["G05 1C"][4] == 3


@pytest.mark.parametrize(("digit", "cn0"), [(1, 9.0), (4, 27.0), (9, 57.0)])
def test_strength_digit_stands_in_where_no_strength_is_declared(digit: int, cn0: float) -> None:
    codes = {"G": ["C1C", "L1C", "C2W", "L2W", "S2W"]}
    line = "G05" + cell(2e7, " 2") + cell(1e8, f" {digit}") + cell(2e7, " 9") + cell(8e7, " 9")
    found = rows(obs_of([*header3(codes), *epoch3(T0, {}, count=1), line]))
    assert found["G05 1C"][3] == cn0
    assert np.isnan(found["G05 2W"][3])  # declared and blank: not measured


def test_scale_factors() -> None:
    extra = [head("G  100  2 C1C L1C", "SYS / SCALE FACTOR"), head("C   10", "SYS / SCALE FACTOR")]
    obs = obs_of(header3(CODES, extra=extra) + epoch3(T0, ONE))
    found = rows(obs)
    assert found["G05 1C"][:4] == (2.1e5, 1.1e6, -1234.567, 45.5)
    assert found["C01 2I"][:4] == (3.6e6, 1.9e7, 1.225, 4.0)


def test_glonass_channels_and_station() -> None:
    extra = [
        head("  3 R01  1 R02 -4 R24  2", "GLONASS SLOT / FRQ #"),
        head("ABCD", "MARKER NAME"),
        head("  4789028.4701   176610.0133  4195017.0310", "APPROX POSITION XYZ"),
        head("        1.5000        0.1000       -0.2000", "ANTENNA: DELTA H/E/N"),
        head("    30.000", "INTERVAL"),
        head("     1", "RCV CLOCK OFFS APPL"),
    ]
    obs = obs_of(header3(CODES, extra=extra) + epoch3(T0, ONE))
    assert obs.channels == {sv_id("R01"): 1, sv_id("R02"): -4, sv_id("R24"): 2}
    h = obs.header
    assert (h.marker, h.interval_s, h.clock_applied) == ("ABCD", 30.0, True)
    assert h.approx_pos_e == (4789028.4701, 176610.0133, 4195017.0310)
    assert h.antenna_hen == (1.5, 0.1, -0.2)


@pytest.mark.parametrize(("system", "seconds"), [("GPS", 0), ("GAL", 0), ("QZS", 0), ("BDT", 14), ("GLO", 18)])
def test_time_systems(system: str, seconds: int) -> None:
    obs = obs_of(header3(CODES, time=system) + epoch3(T0, ONE))
    assert obs.t_ns[0] == GPS0 + seconds * 10**9


@pytest.mark.parametrize(
    ("text", "want"),
    [
        ("> 2024 01 01 00 00 15.0002755  0  1", 15_000_275_500),
        ("> 2024 01 01 00 00 60.0000000  0  1", 60_000_000_000),
        ("> 2024  1  1  0  0  0.0000001  0  1", 100),
        ("> 2024 12 31 23 59 59.9999999  0  1", (365 * 86400 + 86399) * 10**9 + 999_999_900),
        ("> 2024 03 01 00 00  0.0000000  0  1", 60 * 86400 * 10**9),  # 2024 is a leap year
    ],
)
def test_time_tags_to_the_last_digit(text: str, want: int) -> None:
    obs = obs_of([*header3(CODES), text, "G05" + cell(2e7)])
    assert obs.t_ns[0] - GPS0 == want


@given(st.integers(min_value=0, max_value=100 * 365 * 86400))
@settings(max_examples=200, deadline=None)
def test_dates_are_those_of_the_calendar(seconds: int) -> None:
    t = dt.datetime(1980, 1, 6) + dt.timedelta(seconds=seconds)
    assert obs_of(header3(CODES) + epoch3(t, ONE)).t_ns[0] == seconds * 10**9


def test_picoseconds_of_version_4_02() -> None:
    stamp = "> 2024 01 01 00 00 15.0000001  0  1 23456"
    obs = obs_of([*header3(CODES, version="4.02"), stamp, "G05" + cell(2e7)])
    assert obs.t_ns[0] - GPS0 == 15_000_000_123  # 100 ns and 23.456 ns


def test_clock_offset_is_kept_and_not_applied() -> None:
    stamp = "> 2024 01 01 00 00  0.0000000  0  1       0.000123456789"
    obs = obs_of([*header3(CODES), stamp, "G05" + cell(2e7)])
    assert (obs.clock_offset_s[0], obs.t_ns[0]) == (0.000123456789, GPS0)
    text2 = " 24  1  1  0  0  0.0000000  0  1G05" + " " * 33 + "-0.123456789"
    obs = obs_of([*header2(["C1"]), text2, cell(2e7)])
    assert obs.clock_offset_s[0] == -0.123456789


def test_years_of_two_digits() -> None:
    for year, want in ((80, 1980), (95, 1995), (0, 2000), (24, 2024), (79, 2079)):
        obs = obs_of([*header2(["C1"]), f" {year:2d}  7  1  0  0  0.0000000  0  1G05", cell(2e7)])
        assert obs.t_ns[0] == from_calendar(want, 7, 1)


def test_version_2_names() -> None:
    codes = ["C1", "P1", "L1", "D1", "S1", "P2", "C2", "L2", "C5", "L5", "C7", "L7"]
    v: list[float | None] = [float(i + 1) for i in range(12)]
    obs = obs_of(header2(codes) + epoch2(T0, {"G01": v, "R01": v, "E01": v, "J01": v, "S20": v, "C01": v}))
    found = rows(obs)
    assert found["G01 1C"][:3] == (1.0, 3.0, 4.0)
    assert found["G01 1W"][0] == 2.0
    assert found["G01 2W"][:2] == (6.0, 8.0)
    assert found["G01 2X"][0] == 7.0
    assert found["R01 1P"][0] == 2.0
    assert found["R01 2P"][:2] == (6.0, 8.0)
    assert found["E01 1X"][:2] == (1.0, 3.0)
    assert found["E01 7X"][:2] == (11.0, 12.0)
    assert found["S20 1C"][:2] == (1.0, 3.0)
    assert found["C01 2I"][:2] == (7.0, 8.0)
    assert {n[4:] for n in found if n[0] == "J"} == {"1C", "2X", "5X"}


def test_version_2_phase_goes_with_the_code_that_is_there() -> None:
    codes = ["C1", "P1", "L1", "S1", "P2", "C2", "L2"]
    obs = obs_of(header2(codes) + epoch2(T0, {"G01": [None, 2.0, 3.0, 44.0, None, 6.0, 7.0]}))
    found = rows(obs)
    assert set(found) == {"G01 1W", "G01 2X"}
    np.testing.assert_equal(found["G01 1W"][:4], (2.0, 3.0, np.nan, 44.0))
    assert found["G01 2X"][:2] == (6.0, 7.0)


def test_version_2_names_without_a_system_letter() -> None:
    blank = [*header2(["C1"], system=" "), " 24  1  1  0  0  0.0000000  0  2  5G12", cell(2e7), cell(3e7)]
    assert list(rows(obs_of(blank))) == ["G05 1C", "G12 1C"]
    glonass = [*header2(["C1"], system="R"), " 24  1  1  0  0  0.0000000  0  1  5", cell(2e7)]
    assert list(rows(obs_of(glonass))) == ["R05 1C"]


def test_beidou_names_of_version_3_02() -> None:
    codes = {"C": ["C1I", "L1I", "C7I"]}
    obs = obs_of(header3(codes, version="3.02") + epoch3(T0, {"C06": [1.0, 2.0, 3.0]}))
    assert list(rows(obs)) == ["C06 2I", "C06 7I"]
    codes = {"C": ["C1X", "L1X", "C2I"]}  # B1C since 3.03
    obs = obs_of(header3(codes) + epoch3(T0, {"C06": [1.0, 2.0, 3.0]}))
    assert list(rows(obs)) == ["C06 1X", "C06 2I"]


# -- events -------------------------------------------------------------------------------------------------
def test_header_lines_in_an_event_change_what_follows() -> None:
    new = [head("G    2 C5Q L5Q", "SYS / # / OBS TYPES"), head("hello", "COMMENT")]
    lines = header3(CODES) + epoch3(T0, ONE) + [">                              4  2", *new]
    lines += epoch3(T0 + STEP, {"G05": [2e7, 3e7], "C01": ONE["C01"]})
    obs = obs_of(lines)
    assert list(rows(obs, 1)) == ["G05 5Q", "C01 2I"]
    assert obs.problems == ()
    assert obs.header.signals["G"] == ("C1C", "L1C", "D1C", "S1C", "C2W", "L2W", "C5Q", "L5Q")


def test_header_lines_in_an_event_of_version_2() -> None:
    one: dict[str, list[float | None]] = {"G05": [2e7, 3e7]}
    lines = header2(["C1", "L1"]) + epoch2(T0, one)
    lines += [" " * 28 + "4  2", head("     1    P2", "# / TYPES OF OBSERV"), head("hello", "COMMENT")]
    lines += epoch2(T0 + STEP, {"G05": [4e7]})
    obs = obs_of(lines)
    assert [list(rows(obs, i)) for i in (0, 1)] == [["G05 1C"], ["G05 2W"]]
    assert obs.problems == ()


@pytest.mark.parametrize("flag", [2, 3, 5])
def test_other_events_are_told(flag: int) -> None:
    lines = header3(CODES) + epoch3(T0, ONE)
    lines += [f"> 2024 01 01 00 00 10.0000000  {flag}  1", head("hello", "COMMENT"), *epoch3(T0 + STEP, ONE)]
    obs = obs_of(lines)
    assert obs.n_epochs == 2
    assert told(obs, f"flag {flag}") == 1


def test_cycle_slip_records_are_skipped_and_told() -> None:
    slips = epoch3(T0, ONE, flag=6)
    obs = obs_of(header3(CODES) + epoch3(T0, ONE) + slips + epoch3(T0 + STEP, ONE))
    assert (obs.n_epochs, told(obs, "cycle slip")) == (2, 1)
    two: dict[str, list[float | None]] = {"G05": [2e7]}
    obs = obs_of(header2(["C1"]) + epoch2(T0, two) + epoch2(T0, two, flag=6) + epoch2(T0 + STEP, two))
    assert (obs.n_epochs, told(obs, "cycle slip")) == (2, 1)


def test_power_failure_flag_is_kept() -> None:
    obs = obs_of(header3(CODES) + epoch3(T0, ONE) + epoch3(T0 + STEP, ONE, flag=1))
    assert obs.flag.tolist() == [0, 1]


def test_a_glued_file_is_read_with_its_own_header() -> None:
    second = header3({"G": ["L1C", "C1C"]}, time="BDT") + epoch3(T0 + STEP, {"G05": [1.0, 2.0]})
    obs = obs_of(header3(CODES) + epoch3(T0, ONE) + second)
    assert obs.t_ns.tolist() == [GPS0, GPS0 + 44 * 10**9]
    assert rows(obs, 1)["G05 1C"][:2] == (2.0, 1.0)
    assert told(obs, "another header") == 1
    other = header2(["C1"]) + epoch2(T0 + 2 * STEP, {"G07": [3e7]})
    obs = obs_of(header3(CODES) + epoch3(T0, ONE) + other + header3(CODES) + epoch3(T0 + STEP, ONE))
    assert obs.n_epochs == 3


# -- order, doubles, several files -------------------------------------------------------------------------
def test_epochs_out_of_order_are_sorted_and_told() -> None:
    order = [2, 0, 3, 1]
    lines = header3(CODES)
    for i in order:
        lines += epoch3(T0 + i * STEP, {"G05": [1e7 + i], "G06": [2e7 + i]})
    obs = obs_of(lines)
    assert obs.t_ns.tolist() == [GPS0 + i * 30 * 10**9 for i in range(4)]
    assert obs.code_m[0::2].tolist() == [1e7 + i for i in range(4)]
    assert told(obs, "out of order") == 2


def test_of_equal_epochs_the_first_stays() -> None:
    lines = header3(CODES) + epoch3(T0, {"G05": [1e7]}) + epoch3(T0, {"G05": [2e7]}) + epoch3(T0 + STEP, ONE)
    obs = obs_of(lines)
    assert obs.n_epochs == 2
    assert obs.code_m[0] == 1e7
    assert told(obs, "one kept") == 1
    assert obs.problems[0].line == len(header3(CODES)) + 3


def test_a_damaged_time_tag_does_not_replace_the_epoch_whose_time_it_took() -> None:
    times = [0, 1, 4, 3, 4, 5]  # the third should be 2
    lines = header3(CODES)
    for i, k in enumerate(times):
        lines += epoch3(T0 + k * STEP, {"G05": [1e7 + i]})
    obs = obs_of(lines)
    assert obs.code_m.tolist() == [1e7, 1e7 + 1, 1e7 + 3, 1e7 + 4, 1e7 + 5]
    assert told(obs, "out of order") == 1
    assert told(obs, "one kept") == 1


def test_many_events_take_time_in_proportion() -> None:
    event = [">                              4  1", head("hello", "COMMENT")]
    started = time.perf_counter()
    obs = obs_of(header3(CODES) + event * 60_000 + epoch3(T0, ONE))
    assert time.perf_counter() - started < 20.0, "s; about 2 here, 45 if lines were counted from the start"
    assert obs.n_epochs == 1


def test_a_satellite_listed_twice_counts_once() -> None:
    lines = header3(CODES) + epoch3(T0, {"G05": [1e7], "G06": [3e7]}, count=3) + ["G05" + cell(2e7)]
    obs = obs_of(lines)
    assert rows(obs)["G05 1C"][0] == 1e7
    assert obs.n_rows == 2
    assert told(obs, "twice in an epoch") == 1


def test_several_files_are_spliced(tmp_path: Path) -> None:
    extra = [[head("  1 R01  1", "GLONASS SLOT / FRQ #")], [head("  1 R02 -4", "GLONASS SLOT / FRQ #")]]
    for k in (0, 1):
        lines = header3(CODES, extra=extra[k])
        for i in range(2 * k, 2 * k + 3):
            lines += epoch3(T0 + i * STEP, {"G05": [1e7 * (k + 1) + i]})
        (tmp_path / f"{k}.rnx").write_text("\n".join(lines) + "\n")
    obs = read_obs(tmp_path / "1.rnx", tmp_path / "0.rnx")
    assert obs.code_m.tolist() == [1e7, 1e7 + 1, 2e7 + 2, 2e7 + 3, 2e7 + 4]
    assert told(obs, "another file") == 1
    assert set(obs.channels) == {sv_id("R01"), sv_id("R02")}


# -- bad input ---------------------------------------------------------------------------------------------
def refusal(lines: list[str]) -> str:
    with pytest.raises(StarwiseError) as caught:
        obs_of(lines)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith("synthetic:")
    return text


def test_headers_that_cannot_be_used_are_refused() -> None:
    good = header3(CODES)
    assert "END OF HEADER" in refusal(good[:-1])
    assert "END OF HEADER" in refusal(good[:-1] + epoch3(T0, ONE))
    assert "7 stated, 6 listed" in refusal([good[0], good[1].replace("  6", "  7"), *good[2:]])
    assert "not an observation file" in refusal(["nonsense"])
    assert "rinex_nav" in refusal([head("     3.04           NAVIGATION DATA     M", "RINEX VERSION / TYPE")])
    assert "version" in refusal([good[0].replace("3.04", "9.04"), *good[1:]])
    assert "version" in refusal([good[0].replace("3.04", "abcd"), *good[1:]])
    assert "declares no observations" in refusal([good[0], *good[3:]])
    assert "time system" in refusal(header3(CODES, time="XYZ"))
    assert told(obs_of([*good, *epoch3(T0, ONE), " 12 345.000"]), "no record") == 1  # no satellite without a letter
    assert "no epoch" in refusal([*good, "what is this", "and that"])


def test_a_satellite_of_an_undeclared_system_is_told() -> None:
    obs = obs_of(header3(CODES) + epoch3(T0, {"G05": [1e7], "E01": [2e7]}))
    assert list(rows(obs)) == ["G05 1C"]
    assert told(obs, "declares no signals") == 1


def test_more_values_than_declared_are_told() -> None:
    obs = obs_of(header3(CODES) + epoch3(T0, {"C01": [*ONE["C01"], 5.0]}))
    assert rows(obs)["C01 2I"][:4] == tuple(ONE["C01"])
    assert told(obs, "more on a satellite's line") == 1
    obs = obs_of(header2(["C1"]) + epoch2(T0, {"G05": [2e7, 5.0]}))
    assert told(obs, "more on a satellite's line") == 1


def test_a_wrong_number_of_satellites_costs_nothing() -> None:
    for count in (0, 1, 3, 99):
        obs = obs_of(header3(CODES) + epoch3(T0, ONE, count=count) + epoch3(T0 + STEP, ONE))
        assert obs.n_rows == 6
        assert told(obs, "number of satellites") == 1


def test_a_bad_epoch_record_costs_one_epoch() -> None:
    good = header3(CODES)
    for bad in ("> 23 29", "> 2024 13 01 00 00  0.0000000  0  2", "> 2024 02 30 00 00  0.0000000  0  2",
                "> 2024 01 01 00 00 61.0000000  0  2", "> 2024 01 01 00 00  0.0000000  9  2"):  # fmt: skip
        lines = good + epoch3(T0, ONE) + [bad, *epoch3(T0, ONE)[1:], *epoch3(T0 + 2 * STEP, ONE)]
        obs = obs_of(lines)
        assert obs.n_epochs == 2
        assert [(p.line, p.count) for p in obs.problems] == [(len(good) + 4, 1)], bad


def test_values_that_are_no_numbers_are_left_blank_and_told() -> None:
    for text in ("  2000x000.000  ", "  20000000 000  ", "         -.     ", "2-000000.000    ", "  1e5.000       "):
        obs = obs_of([*header3(CODES), *epoch3(T0, {}, count=1), "G05" + text + cell(1e8)])
        np.testing.assert_equal(rows(obs)["G05 1C"][:2], (np.nan, 1e8))
        assert told(obs, "not a number") == 1, text


def test_odd_but_clear_numbers_are_read() -> None:
    for text, want in (("  20000000.5    ", 2e7 + 0.5), ("         -.125  ", -0.125), ("  20000000      ", 2e7),
                       ("2.0000000D+07   ", 2e7), ("9999999999.999  ", 9999999999.999)):  # fmt: skip
        obs = obs_of([*header3(CODES), *epoch3(T0, {}, count=1), "G05" + text + cell(1e8)])
        assert rows(obs)["G05 1C"][:2] == (want, 1e8)


def test_a_file_cut_within_a_number_does_not_give_a_wrong_number() -> None:
    text = "\n".join(header3(CODES) + epoch3(T0, ONE) + epoch3(T0 + STEP, ONE)) + "\n"
    want = parse_obs(text.encode())
    start = text.index("> 2024 01 01 00 00 30")
    good = {f: set(getattr(want, f)[np.isfinite(getattr(want, f))]) for f in ("code_m", "phase_cyc", "doppler_hz")}
    for n in range(start, len(text)):
        obs = parse_obs(text[:n].encode())
        assert 1 <= obs.n_epochs <= 2
        for name, known in good.items():
            found = getattr(obs, name)
            assert set(found[np.isfinite(found)]) <= known, n


V2_ROWS: dict[str, list[float | None]] = {
    f"G{n:02d}": [2e7 + n, 1e8 + n, 40.0 + n, 2.1e7 + n, 8e7 + n, 30.0 + n, -500.0 - n] for n in range(1, 15)
}
V2_LINES = header2(["C1", "L1", "S1", "P2", "L2", "S2", "D1"])


def test_a_line_lost_or_doubled_never_shifts_satellites_in_version_2() -> None:
    body = epoch2(T0, V2_ROWS) + epoch2(T0 + STEP, V2_ROWS) + epoch2(T0 + 2 * STEP, V2_ROWS)
    want = obs_of(V2_LINES + body)
    per = len(body) // 3
    for i in range(per, 2 * per):
        for other in (body[:i] + body[i + 1 :], [*body[:i], body[i], *body[i:]]):
            obs = obs_of(V2_LINES + other)
            assert obs.n_epochs >= 2, i
            assert sum(p.count for p in obs.problems) >= 1
            for k, t in enumerate(obs.t_ns):
                same = rows(want, int(np.searchsorted(want.t_ns, t)))
                assert rows(obs, k).keys() == same.keys()
                np.testing.assert_array_equal(list(rows(obs, k).values()), list(same.values()))


def test_a_damaged_epoch_record_of_version_2_costs_its_own_epoch() -> None:
    body = [epoch2(T0 + i * STEP, V2_ROWS) for i in range(3)]
    body[1][0] = body[1][0].replace("30.0000000", "3x.0000000")
    obs = obs_of(V2_LINES + body[0] + body[1] + body[2])
    assert obs.t_ns.tolist() == [GPS0, GPS0 + 60 * 10**9]
    assert [p.line for p in obs.problems] == [len(V2_LINES) + len(body[0]) + 1]


def test_a_cut_version_2_file_keeps_whole_satellites() -> None:
    text = "\n".join(V2_LINES + epoch2(T0, V2_ROWS) + epoch2(T0 + STEP, V2_ROWS)) + "\n"
    want = parse_obs(text.encode())
    start = text.index(" 24  1  1  0  0 30")
    for n in range(start, len(text), 7):
        obs = parse_obs(text[:n].encode())
        assert 1 <= obs.n_epochs <= 2
        k = obs.n_rows
        np.testing.assert_array_equal(obs.sv, want.sv[:k])
        ok = np.isfinite(obs.code_m)
        np.testing.assert_array_equal(obs.code_m[ok], want.code_m[:k][ok])


def test_outputs_grow_when_lines_are_denser_than_expected() -> None:
    # a single digit of strength a line: many more rows a byte than any real file has
    lines = header3({"G": ["C1C"]})
    for i in range(400):
        lines += epoch3(T0 + i * STEP, {f"G{n:02d}": [] for n in range(1, 60)})
    obs = obs_of(lines)
    assert (obs.n_epochs, obs.n_rows) == (400, 400 * 59)
    assert np.isnan(obs.code_m).all()


def test_more_lines_than_an_epoch_can_have() -> None:
    lines = [*header3({"G": ["C1C"]}), *epoch3(T0, {}, count=99), *["G05" + cell(2e7)] * 3000]
    obs = obs_of(lines)
    assert obs.n_rows == 1
    assert told(obs, "more satellite lines") == 3000 - 1024
