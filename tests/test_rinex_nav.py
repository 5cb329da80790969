"""RINEX navigation reader on files made by hand."""

import datetime as dt
import gzip
from pathlib import Path

import numpy as np
import pytest

from nav_text import (
    BDT_WEEK,
    EPOCH,
    GLONASS_CLOCK,
    GPS_CLOCK,
    GPS_WEEK,
    SOW,
    e19,
    glonass,
    header,
    kepler,
    record,
    write,
)
from starwise.constants import (
    K_A_DOT,
    K_AF0,
    K_CIC,
    K_CRC,
    K_CRS,
    K_DELTA_N_DOT,
    K_E,
    K_IDOT,
    K_M0,
    K_OMEGA,
    K_OMEGA_DOT,
    K_SQRT_A,
    K_TOE_SOW,
    MSG_CNAV,
    MSG_CNV1,
    MSG_CNV2,
    MSG_D1,
    MSG_D2,
    MSG_FDMA,
    MSG_FNAV,
    MSG_INAV,
    MSG_LNAV,
    MSG_SBAS,
    NS,
    R_AX,
    R_CHANNEL,
    R_DTAU,
    R_TAU,
    R_VX,
    R_X,
    TGD_B1CP,
    TGD_B2AP,
    TGD_MAIN,
    TGD_SECOND,
)
from starwise.errors import StarwiseError
from starwise.gnsstime import from_calendar
from starwise.io.nav_fields import ura_index_m
from starwise.io.rinex_nav import read_nav
from starwise.signals import sv_id

T_NS = from_calendar(2024, 3, 30, 12)
BAD = [
    ("eccentricity", 1, 1, 0.5),
    ("semi-major axis", 1, 3, 2153.7),
    ("toe outside", 2, 0, 604_800.0),
    ("toe far from toc", 2, 0, SOW - 20_000.0),
    ("longitude of node", 2, 2, -22.5),
    ("inclination", 3, 0, 96.0),
    ("rate of node", 3, 3, -8.1e-5),
    ("week contradicts", 4, 2, GPS_WEEK + 7.0),
    ("missing", 0, 3, None),
]


def one(tmp_path: Path, text: str):  # type: ignore[no-untyped-def]
    return read_nav(write(tmp_path, text))


def gps(version: int = 3) -> str:
    return record("G07", GPS_CLOCK, kepler(), version=version)


class TestGps:
    @pytest.mark.parametrize("version", [2, 3])
    def test_numbers_land_in_their_columns(self, tmp_path: Path, version: int) -> None:
        r = one(tmp_path, header("2.11" if version == 2 else "3.05", "N") + gps(version))
        assert r.sv.tolist() == [sv_id("G07")]
        assert r.message.tolist() == [MSG_LNAV]
        assert (r.toc_ns[0], r.toe_ns[0]) == (T_NS, T_NS)
        assert r.t_tx_ns[0] == T_NS - 7182 * NS
        p = r.par[0]
        assert p[K_AF0] == -1.5e-4
        assert (p[K_SQRT_A], p[K_E], p[K_M0]) == (5153.7, 0.0125, 1.25)
        assert (p[K_CRS], p[K_CRC], p[K_CIC]) == (12.5, 220.5, 3.5e-8)
        assert (p[K_OMEGA], p[K_OMEGA_DOT], p[K_IDOT], p[K_TOE_SOW]) == (-1.75, -8.1e-9, 1.1e-10, SOW)
        assert (p[K_A_DOT], p[K_DELTA_N_DOT]) == (0.0, 0.0)
        assert r.tgd[0, TGD_MAIN] == -9.3e-9
        assert np.isnan(r.tgd[0, 1:]).all()
        assert (r.accuracy_m[0], r.health[0], r.iode[0], r.iodc[0], r.fit_s[0]) == (2.8, 0, 45, 45, 14_400.0)

    @pytest.mark.parametrize(
        "change",
        [
            lambda t: t.replace("\n", "\r\n"),
            lambda t: t.replace("e-", "D-").replace("e+", "D+"),
            lambda t: "\n".join(line.rstrip() for line in t.split("\n")),
            lambda t: t + "\n\n",
            lambda t: t.rstrip("\n"),
            lambda t: "\n".join(f"{line:<80}" for line in t.split("\n")),
        ],
    )
    def test_same_in_every_dress(self, tmp_path: Path, change) -> None:  # type: ignore[no-untyped-def]
        plain = one(tmp_path, header() + gps())
        other = one(tmp_path, change(header() + gps()))
        np.testing.assert_array_equal(plain.par, other.par)
        assert other.toe_ns[0] == T_NS
        assert other.problems == ()

    def test_fortran_numbers_without_leading_digit(self, tmp_path: Path) -> None:
        text = header() + gps().replace(e19(5153.7), "  .515370000000D+04").replace(e19(-2.25), " -.225000000000D+01")
        r = one(tmp_path, text)
        assert r.par[0, K_SQRT_A] == 5153.7

    @pytest.mark.parametrize(("year", "full"), [(80, 1980), (99, 1999), (0, 2000), (24, 2024), (79, 2079)])
    def test_two_digit_years(self, tmp_path: Path, year: int, full: int) -> None:
        epoch = dt.datetime(full, 5, 6, 2, 0, 0)
        seconds = (epoch - dt.datetime(1980, 1, 6)).total_seconds()
        rows = kepler(sow=seconds % 604_800, week=seconds // 604_800, t_tx=None)
        r = one(tmp_path, header("2.10") + record("G01", GPS_CLOCK, rows, epoch, 2))
        assert r.toe_ns[0] == from_calendar(full, 5, 6, 2)

    def test_tenths_of_seconds(self, tmp_path: Path) -> None:
        epoch = EPOCH.replace(second=43, microsecond=600_000)
        r = one(tmp_path, header("2.11") + record("G01", GPS_CLOCK, kepler(), epoch, 2))
        assert r.toc_ns[0] == T_NS + 43_600_000_000
        assert r.toe_ns[0] == T_NS

    @pytest.mark.parametrize("week", [GPS_WEEK, GPS_WEEK - 2048, GPS_WEEK % 1024, GPS_WEEK - 1, GPS_WEEK + 1, 0, None])
    def test_week_counts_of_writers(self, tmp_path: Path, week: float | None) -> None:
        r = one(tmp_path, header() + record("G01", GPS_CLOCK, kepler(week=week)))
        assert r.toe_ns[0] == T_NS

    def test_toe_across_the_week(self, tmp_path: Path) -> None:
        epoch = dt.datetime(2024, 3, 30, 23, 59, 44)  # Saturday; toe is 0 of the week that begins
        r = one(tmp_path, header() + record("G01", GPS_CLOCK, kepler(sow=0.0, t_tx=604_000.0), epoch))
        assert r.toe_ns[0] == from_calendar(2024, 3, 31)
        assert r.t_tx_ns[0] == r.toe_ns[0] - 800 * NS

    @pytest.mark.parametrize("t_tx", [0.9999e9, -0.9999e9, None, 0.0, 90_000.0])
    def test_no_transmission_time(self, tmp_path: Path, t_tx: float | None) -> None:
        r = one(tmp_path, header() + record("G01", GPS_CLOCK, kepler(t_tx=t_tx)))
        assert r.t_tx_ns[0] == T_NS - 7200 * NS  # as a data set is sent by the rule

    @pytest.mark.parametrize(("what", "line", "column", "value"), BAD)
    def test_impossible_records_are_left_out(
        self, tmp_path: Path, what: str, line: int, column: int, value: float | None
    ) -> None:
        rows = kepler()
        rows[line][column] = value
        good = "".join(record(f"G{n:02d}", GPS_CLOCK, kepler()) for n in (1, 2, 3))
        r = one(tmp_path, header() + good + record("G09", GPS_CLOCK, rows))
        assert r.sv.tolist() == [1, 2, 3]
        assert r.counts["corrupt"] == 1
        (problem,) = r.problems
        assert what in problem.what
        assert problem.line == 2 + 3 * 8 + 1

    def test_a_habit_of_the_writer_is_not_damage(self, tmp_path: Path) -> None:
        text = header() + "".join(record(f"G{n:02d}", GPS_CLOCK, kepler(week=77.0)) for n in (1, 2, 3))
        r = one(tmp_path, text)
        assert r.n == 3
        assert "unknown count" in r.problems[0].what

    @pytest.mark.parametrize(
        ("field", "given", "wanted"),
        [((5, 0), 0.0, 2.0), ((5, 0), 8192.0, np.inf), ((5, 0), 6144.0, 6144.0), ((5, 0), None, np.nan)],
    )
    def test_accuracy(self, tmp_path: Path, field: tuple[int, int], given: float | None, wanted: float) -> None:
        rows = kepler()
        rows[field[0]][field[1]] = given
        np.testing.assert_equal(one(tmp_path, header() + record("G01", GPS_CLOCK, rows)).accuracy_m[0], wanted)


class TestLines:
    """Damage to lines: the record goes, its neighbours stay."""

    TEXT = header() + "".join(record(f"G{n:02d}", GPS_CLOCK, kepler()) for n in (1, 2, 3))

    @pytest.mark.parametrize("line", range(10, 18))
    @pytest.mark.parametrize("harm", ["drop", "double", "word", "shift left", "shift right"])
    def test_one_line(self, tmp_path: Path, line: int, harm: str) -> None:
        lines = self.TEXT.split("\n")
        old = lines[line]
        lines[line : line + 1] = {
            "drop": [],
            "double": [old, old],
            "word": [old[:10] + "garbage" + old[17:]],
            "shift left": [old[1:]],
            "shift right": [" " + old],
        }[harm]
        r = one(tmp_path, "\n".join(lines))
        whole = one(tmp_path, self.TEXT)
        for i in range(r.n):  # what survives is right: a blank more or less may be harmless
            np.testing.assert_array_equal(r.par[i], whole.par[0])
            np.testing.assert_array_equal(r.tgd[i], whole.tgd[0])
            assert (r.health[i], r.iode[i], r.accuracy_m[i]) == (0, 45, 2.8)
        assert 3 in r.sv
        if harm in ("drop", "word") or (harm == "double" and line > 10):
            assert 2 not in r.sv
            assert r.counts["corrupt"] >= 1

    def test_cut_anywhere(self, tmp_path: Path) -> None:
        whole = one(tmp_path, self.TEXT)
        for stop in range(len(header()), len(self.TEXT), 7):
            try:
                r = one(tmp_path, self.TEXT[:stop])
            except StarwiseError:
                continue
            for i in range(r.n):
                np.testing.assert_array_equal(r.par[i], whole.par[0])

    def test_blank_orbit_line_at_the_end(self, tmp_path: Path) -> None:
        rows = kepler()
        rows[6] = [None, None]
        r = one(tmp_path, header() + record("G01", GPS_CLOCK, rows) + gps())
        assert r.n == 2

    def test_two_files_joined_end_to_end(self, tmp_path: Path) -> None:
        second = header(extra=(f"{18:6d}{'':54}LEAP SECONDS",)) + gps()
        r = one(tmp_path, self.TEXT + second)
        assert r.sv.tolist() == [1, 2, 3, 7]
        assert r.leap_s == 18


class TestOtherSystems:
    def test_glonass_is_utc_and_kilometres(self, tmp_path: Path) -> None:
        r = one(tmp_path, header() + record("R05", GLONASS_CLOCK, glonass(fourth=True)))
        assert r.message[0] == MSG_FDMA
        assert r.toe_ns[0] == r.toc_ns[0] == T_NS + 18 * NS
        assert r.t_tx_ns[0] == r.toe_ns[0] + 30 * NS
        p = r.par[0]
        assert p[R_TAU] == 3.5e-5
        assert p[R_X : R_X + 3].tolist() == [12_000_500.0, -18_000_250.0, 13_500_750.0]
        assert p[R_VX : R_VX + 3].tolist() == [-1250.0, 500.0, 2750.0]
        np.testing.assert_allclose(p[R_AX : R_AX + 3], [1.8e-6, -9.3e-7, 0.0], rtol=1e-15)  # km/s^2 times 1000
        assert (p[R_CHANNEL], p[R_DTAU]) == (-4.0, 2.8e-9)
        assert r.accuracy_m[0] == 2.5  # F_T = 2
        assert r.iode[0] == 60  # 15:00 Moscow

    def test_glonass_with_three_and_four_lines_in_one_file(self, tmp_path: Path) -> None:
        text = record("R05", GLONASS_CLOCK, glonass()) + record("R06", GLONASS_CLOCK, glonass(fourth=True))
        r = one(tmp_path, header("3.04") + text + record("R07", GLONASS_CLOCK, glonass()) + gps())
        assert r.n == 4
        assert np.isnan(r.par[1, R_DTAU])
        assert r.par[2, R_DTAU] == 2.8e-9

    @pytest.mark.parametrize(("bn", "flags", "health"), [(0, 3, 0), (1, 3, 1), (0, 4, 8), (0, 2, 16), (1, 6, 25)])
    def test_glonass_health(self, tmp_path: Path, bn: int, flags: int, health: int) -> None:
        rows = glonass(fourth=True)
        rows[0][3], rows[3][3] = float(bn), float(flags)
        assert one(tmp_path, header() + record("R05", GLONASS_CLOCK, rows)).health[0] == health

    def test_glonass_unknowns(self, tmp_path: Path) -> None:
        rows = glonass()
        rows.append([None, 0.999999999999e9, 15.0, None])
        r = one(tmp_path, header() + record("R05", GLONASS_CLOCK, rows))
        assert np.isnan(r.par[0, R_DTAU])
        assert np.isnan(r.accuracy_m[0])
        assert r.health[0] == 0

    @pytest.mark.parametrize("radius", [0.5, 2.0])
    def test_glonass_position_of_no_satellite(self, tmp_path: Path, radius: float) -> None:
        rows = glonass()
        for row in rows:
            row[0] = row[0] * radius  # type: ignore[operator]
        with pytest.raises(StarwiseError, match="position of no satellite"):
            one(tmp_path, header() + record("R05", GLONASS_CLOCK, rows))

    @pytest.mark.parametrize("week", [BDT_WEEK, GPS_WEEK])
    @pytest.mark.parametrize(("sv", "message"), [("C23", MSG_D1), ("C03", MSG_D2), ("C60", MSG_D2), ("C58", MSG_D1)])
    def test_beidou_is_bdt(self, tmp_path: Path, week: float, sv: str, message: int) -> None:
        rows = kepler(sqrt_a=6493.0 if message == MSG_D2 else 5282.6, week=week, t_tx=SOW + 18.0)
        rows[5][3] = -3.1e-9
        rows[6][1] = 7.0
        r = one(tmp_path, header() + record(sv, GPS_CLOCK, rows))
        assert r.message[0] == message
        assert r.toc_ns[0] == r.toe_ns[0] == T_NS + 14 * NS
        assert r.t_tx_ns[0] == r.toe_ns[0] + 18 * NS
        assert r.par[0, K_TOE_SOW] == SOW
        assert r.tgd[0, :2].tolist() == [-9.3e-9, -3.1e-9]
        assert (r.iode[0], r.iodc[0]) == (45, 7)

    @pytest.mark.parametrize(
        ("source", "message"),
        [(513, MSG_INAV), (516, MSG_INAV), (517, MSG_INAV), (258, MSG_FNAV), (2, MSG_FNAV), (256, MSG_FNAV),
         (0, MSG_INAV), (None, MSG_INAV), (263, MSG_FNAV), (519, MSG_INAV)],
    )  # fmt: skip
    def test_galileo_messages(self, tmp_path: Path, source: int | None, message: int) -> None:
        rows = kepler(sqrt_a=5440.6, t_tx=SOW + 700.0)
        rows[4][1] = source
        rows[5] = [3.12, 130.0, -2.1e-9, -2.3e-9]
        r = one(tmp_path, header() + record("E11", GPS_CLOCK, rows))
        assert r.message[0] == message
        assert r.source[0] == (source or 0)
        assert (r.accuracy_m[0], r.health[0], r.iodc[0]) == (3.12, 130, -1)
        assert r.tgd[0, TGD_MAIN] == -2.1e-9
        np.testing.assert_equal(r.tgd[0, TGD_SECOND], -2.3e-9 if message == MSG_INAV else np.nan)

    @pytest.mark.parametrize(
        ("sv", "rule"), [("E11", 660), ("C21", 0), ("C03", 0), ("J02", -3600), ("I05", 0), ("G05", -7200)]
    )
    def test_records_without_transmission_time_are_known_when_such_are_sent(
        self, tmp_path: Path, sv: str, rule: int
    ) -> None:
        """Seconds against toe at which a constellation begins to send a data set."""
        rows = kepler(sqrt_a={"E": 5440.6, "C": 5282.6, "G": 5153.7}.get(sv[0], 6493.4), t_tx=None)
        r = one(tmp_path, header() + record(sv, GPS_CLOCK, rows))
        assert r.t_tx_ns[0] == r.toe_ns[0] + rule * NS

    @pytest.mark.parametrize(("sisa", "wanted"), [(-1.0, np.inf), (3.12, 3.12), (0.0, np.nan)])
    def test_galileo_accuracy(self, tmp_path: Path, sisa: float, wanted: float) -> None:
        rows = kepler(sqrt_a=5440.6)
        rows[5][0] = sisa
        np.testing.assert_equal(one(tmp_path, header() + record("E11", GPS_CLOCK, rows)).accuracy_m[0], wanted)

    def test_sbas(self, tmp_path: Path) -> None:
        rows: list[list[float | None]] = [
            [-33_893.9, 1e-3, 0.0, 0.0],
            [25_080.2, 0.0, 0.0, 32_767.0],
            [12.5, 0.0, 0.0, 77.0],
        ]
        r = one(tmp_path, header() + record("S22", [1e-8, 0.0, SOW + 5.0], rows))
        assert r.message[0] == MSG_SBAS
        assert r.toe_ns[0] == T_NS
        assert r.t_tx_ns[0] == T_NS + 5 * NS
        assert (r.iode[0], r.accuracy_m[0]) == (77, np.inf)
        assert r.par[0, R_VX] == 1.0

    @pytest.mark.parametrize(
        ("kind", "letter"), [("G", "R"), ("H", "S"), ("E", "E"), ("L", "E"), ("N", "G"), ("J", "J")]
    )
    def test_rinex2_type_is_the_system(self, tmp_path: Path, kind: str, letter: str) -> None:
        if letter == "R":
            body = record("R04", GLONASS_CLOCK, glonass(), version=2)
        elif letter == "S":
            rows: list[list[float | None]] = [[-33_893.9, 0, 0, 0], [25_080.2, 0, 0, 4.0], [1.0, 0, 0, 7.0]]
            body = record("S04", [0.0, 0.0, SOW], rows, version=2)
        else:
            body = record("G04", GPS_CLOCK, kepler({"G": 5153.7, "E": 5440.6, "J": 6493.0}[letter]), version=2)
        r = one(tmp_path, header("2.12", f"{kind}: NAV DATA") + body)
        assert r.sv.tolist() == [sv_id(f"{letter}04")]


class TestRinex4:
    def text(self, message: str, sv: str, rows: list[list[float | None]], name: str = "EPH") -> str:
        return header("4.00") + f"> {name} {sv} {message:<4}\n" + record(sv, GPS_CLOCK, rows)

    def cnav(self, sqrt_a: float) -> list[list[float | None]]:
        rows = kepler(sqrt_a)
        rows[0][0] = 0.01  # A_DOT
        rows[2][0] = SOW - 9000.0  # t_op
        rows[4] = [1.1e-10, 2e-14, -6.0, 2.0]
        rows[5] = [-1.0, 0.0, 4.7e-9, 7.0]
        return [*rows[:6], [-3e-10, -2e-9, 7e-9, 6e-9]]

    def test_cnav(self, tmp_path: Path) -> None:
        r = one(tmp_path, self.text("CNAV", "G01", [*self.cnav(5153.7), [SOW - 5400.0, 2307.0]]))
        assert r.message[0] == MSG_CNAV
        assert r.toe_ns[0] == r.toc_ns[0] == T_NS
        assert r.par[0, [K_A_DOT, K_DELTA_N_DOT, K_TOE_SOW]].tolist() == [0.01, 2e-14, SOW]
        assert r.t_tx_ns[0] == T_NS - 5400 * NS
        assert r.tgd[0].tolist()[:1] == [4.7e-9]
        assert r.tgd[0, 4:8].tolist() == [-3e-10, -2e-9, 7e-9, 6e-9]
        assert r.accuracy_m[0] == pytest.approx(np.hypot(2**0.5, 0.25), abs=1e-12)  # URA_ED -1, URA_NED0 -6
        assert r.iode[0] == -1

    def test_cnav2(self, tmp_path: Path) -> None:
        rows = [*self.cnav(6493.0), [1e-9, 2e-9], [SOW - 3594.0, 2307.0]]
        r = one(tmp_path, self.text("CNV2", "J02", rows))
        assert (r.message[0], r.tgd[0, 8], r.tgd[0, 9]) == (MSG_CNV2, 1e-9, 2e-9)
        assert r.t_tx_ns[0] == T_NS - 3594 * NS

    @pytest.mark.parametrize("message", ["CNV1", "CNV2"])
    def test_beidou_cnv(self, tmp_path: Path, message: str) -> None:
        rows = kepler(5282.6)
        rows[0][0] = -2e-3
        rows[4] = [1.1e-10, 3e-14, 3.0, SOW]
        rows[5] = [0.0, -4.0, -1.0, -1.0]
        isc = [-8e-10, None] if message == "CNV1" else [None, -8e-10]
        rows[6:] = [[*isc, 9e-9, -5e-9], [0.0, 1.0, 0.0, 33.0], [SOW + 20.0, None, None, 21.0]]
        r = one(tmp_path, self.text(message, "C19", rows))
        assert r.message[0] == (MSG_CNV1 if message == "CNV1" else MSG_CNV2)
        assert r.toe_ns[0] == T_NS + 14 * NS
        assert (r.iode[0], r.iodc[0], r.health[0]) == (21, 33, 1)
        assert r.tgd[0, [TGD_B1CP, TGD_B2AP]].tolist() == [9e-9, -5e-9]
        assert r.tgd[0, 4 if message == "CNV1" else 5] == -8e-10
        assert np.isnan(r.accuracy_m[0])

    def test_what_is_not_an_ephemeris(self, tmp_path: Path) -> None:
        epoch = "    2024 03 30 12 00 00"
        first = "".join(e19(v) for v in (1e-8, 2e-8, 3e-8))
        rest = "    " + "".join(e19(v) for v in (4e-8, 1e5, 2e5, 3e5)) + "\n    " + e19(4e5)
        ion = f"> ION G12 LNAV\n{epoch}{first}\n{rest}\n"
        japan = f"> ION J02 CNVX\n{epoch}{first}\n{rest}{e19(1.0)}\n"
        nequick = f"> ION E02 IFNV\n{epoch}{e19(160.0)}{e19(0.5)}{e19(0.01)}\n    {e19(0.0)}\n"
        sto = "> STO G23 LNAV\n    2024 03 30 16 51 12 GPUT\n" + "    " + e19(1.0) + e19(2.0) + "\n"
        unknown = "> EPH I02 L1NV\nI02 2024 03 30 12 00 00" + e19(0.0) * 3 + "\n    " + e19(1.0) + "\n"
        r = one(tmp_path, self.text("LNAV", "G07", kepler()) + ion + japan + nequick + sto + unknown)
        assert r.n == 1
        assert r.ionosphere.klobuchar["G"].tolist() == [1e-8, 2e-8, 3e-8, 4e-8, 1e5, 2e5, 3e5, 4e5]
        assert "J" not in r.ionosphere.klobuchar
        assert r.ionosphere.nequick is not None
        assert r.ionosphere.nequick.tolist() == [160.0, 0.5, 0.01]
        assert [h[:2] for h in r.ionosphere.history] == [(T_NS, "G"), (T_NS, "E")]
        assert (r.counts["STO"], r.counts["ION"], r.counts["unsupported"]) == (1, 3, 1)

    def test_names_that_disagree(self, tmp_path: Path) -> None:
        text = self.text("LNAV", "G07", kepler()) + "> EPH G08 LNAV\n" + gps()
        r = one(tmp_path, text)
        assert r.n == 1
        assert r.counts["corrupt"] == 1


class TestMerging:
    def test_identical_records_once(self, tmp_path: Path) -> None:
        a = write(tmp_path, header() + gps(), "a.rnx")
        late = kepler(t_tx=SOW - 600.0)
        b = write(tmp_path, header("2.11") + record("G07", GPS_CLOCK, late, version=2), "b.24n")
        r = read_nav(a, b)
        assert (r.n, r.counts["duplicate"], r.counts["contradictory"]) == (1, 1, 0)
        assert r.t_tx_ns[0] == T_NS - 7182 * NS  # sent first
        np.testing.assert_array_equal(read_nav(b, a).par, r.par)

    def test_fewer_digits_are_no_contradiction(self, tmp_path: Path) -> None:
        rows = kepler()
        rows[0][3] = 1.25 * (1 + 1e-12)
        r = one(tmp_path, header() + gps() + record("G07", GPS_CLOCK, rows))
        assert (r.n, r.counts["duplicate"]) == (1, 1)

    def test_most_copies_win(self, tmp_path: Path) -> None:
        rows = kepler()
        rows[0][3] = 1.35
        text = header() + record("G07", GPS_CLOCK, rows) + gps() + gps() + record("G08", GPS_CLOCK, kepler())
        r = one(tmp_path, text)
        assert r.par[:, K_M0].tolist() == [1.25, 1.25]
        assert (r.counts["duplicate"], r.counts["contradictory"]) == (1, 1)
        assert r.problems[0].line == 3
        assert "contradict" in r.problems[0].what

    def test_of_two_the_one_sent_last(self, tmp_path: Path) -> None:
        rows = kepler(t_tx=SOW - 100.0)
        rows[5][2] = -8.9e-9
        for text in (gps() + record("G07", GPS_CLOCK, rows), record("G07", GPS_CLOCK, rows) + gps()):
            r = one(tmp_path, header() + text)
            assert r.tgd[0, TGD_MAIN] == -8.9e-9
            assert (r.n, r.counts["contradictory"]) == (1, 1)

    def test_health_and_issue_make_another_message(self, tmp_path: Path) -> None:
        sick, new = kepler(), kepler()
        sick[5][1], new[0][0] = 63.0, 46.0
        r = one(tmp_path, header() + gps() + record("G07", GPS_CLOCK, sick) + record("G07", GPS_CLOCK, new))
        assert sorted(zip(r.health.tolist(), r.iode.tolist(), strict=True)) == [(0, 45), (0, 46), (63, 45)]

    def test_order(self, tmp_path: Path) -> None:
        later = kepler(sow=SOW + 7200.0)
        text = record("R05", GLONASS_CLOCK, glonass()) + record("G08", GPS_CLOCK, later, EPOCH.replace(hour=14))
        r = one(tmp_path, header() + text + record("G08", GPS_CLOCK, kepler()) + gps())
        assert r.sv.tolist() == [7, 8, 8, sv_id("R05")]
        assert (np.diff(r.toe_ns[1:3]) == 7200 * NS).all()

    def test_compressed(self, tmp_path: Path) -> None:
        path = tmp_path / "x.rnx.gz"
        path.write_bytes(gzip.compress((header() + gps()).encode()))
        assert read_nav(path).n == 1


class TestHeader:
    def test_klobuchar_of_rinex_2_and_3(self, tmp_path: Path) -> None:
        alpha, beta = "1.1176D-08 -1.4901D-08 -5.9605D-08  1.1921D-07", "9.8304D+04 -1.1469D+05 -1.9661D+05  7.2090D+05"
        old = header("2.11", "N", (f"    {alpha}          ION ALPHA", f"    {beta}          ION BETA"))
        new = header(
            "3.04",
            extra=(f"GPSA   {alpha}       IONOSPHERIC CORR", f"GPSB   {beta}       IONOSPHERIC CORR",
                   f"{'GAL    1.2200E+02  1.5625E-02  2.8931E-02  0.0000E+00':<60}IONOSPHERIC CORR"),
        )  # fmt: skip
        wanted = [1.1176e-8, -1.4901e-8, -5.9605e-8, 1.1921e-7, 98_304.0, -114_690.0, -196_610.0, 720_900.0]
        assert one(tmp_path, old + gps(2)).ionosphere.klobuchar["G"].tolist() == wanted
        ionosphere = one(tmp_path, new + gps()).ionosphere
        assert ionosphere.klobuchar["G"].tolist() == wanted
        assert ionosphere.nequick is not None
        assert ionosphere.nequick.tolist() == [122.0, 0.015625, 0.028931]

    def test_most_frequent_beidou_set(self, tmp_path: Path) -> None:
        lines = []
        for mark, factor in (("A 01", 9), ("B 02", 1), ("C 03", 1)):
            for kind, value in (("A", "1.0000E-08"), ("B", "2.0000E+05")):
                lines.append(f"BDS{kind}   {value.replace('1.', f'{factor}.', 1) if kind == 'A' else value}"
                             f"{'  0.0000E+00' * 3} {mark}  IONOSPHERIC CORR")  # fmt: skip
        r = one(tmp_path, header(extra=tuple(lines)) + gps())
        assert r.ionosphere.klobuchar["C"][[0, 4]].tolist() == [1e-8, 2e5]

    @pytest.mark.parametrize(("line", "wanted"), [("    18    18  1929     7", 18), ("     4     4   573     6", 18)])
    def test_leap_seconds(self, tmp_path: Path, line: str, wanted: int) -> None:
        r = one(tmp_path, header(extra=(f"{line:<60}LEAP SECONDS",)) + gps())
        assert r.leap_s == wanted
        assert r.problems == ()

    def test_leap_seconds_that_cannot_be(self, tmp_path: Path) -> None:
        r = one(tmp_path, header(extra=(f"{'    28':<60}LEAP SECONDS",)) + gps())
        assert "28" in r.problems[0].what

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("", "empty"),
            ("\n \n", "empty"),
            ("nothing of the kind\n", "not a RINEX navigation file"),
            (header("3.04", "OBSERVATION DATA"), "not a RINEX navigation file"),
            (header("5.00"), "version not supported"),
            (header("x.yz"), "version not supported"),
            (header().replace("END OF HEADER", "END"), "does not end"),
            (header(), "no usable navigation record"),
            (header() + "G01 2024", "no usable navigation record"),
        ],
    )
    def test_refused_in_one_line(self, tmp_path: Path, text: str, message: str) -> None:
        with pytest.raises(StarwiseError, match=message) as caught:
            one(tmp_path, text)
        assert "\n" not in str(caught.value)
        assert "made.rnx" in str(caught.value)

    def test_no_file(self, tmp_path: Path) -> None:
        with pytest.raises(StarwiseError):
            read_nav()
        with pytest.raises(StarwiseError):
            read_nav(tmp_path / "absent.rnx")


@pytest.mark.golden
def test_ura_index_table() -> None:
    # IS-GPS-200N 20.3.3.3.1.3: nominal values of X = 2^(1 + N/2) and 2^(N - 2), "1, 3, 5" rounded to 2.8, 5.7, 11.3
    table = [2.0, 2.8, 4.0, 5.7, 8.0, 11.3, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0, 1024.0, 2048.0, 4096.0]
    np.testing.assert_allclose(ura_index_m(np.arange(15.0)), table, atol=0.05)  # m, the table's rounding
    assert np.isinf(ura_index_m(np.array([15.0, -16.0]))).all()
