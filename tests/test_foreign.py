"""Files of other programs: told by content, read as their authors mean them, refused in one line when damaged."""

import json
import random
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import starwise
from handmade import handmade_solution
from starwise import read_solution
from starwise.cli import run
from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.frames import C_ne_enu, C_ne_ned, ecef_from_geodetic, geodetic_from_ecef
from starwise.gnsstime import from_calendar, from_week_tow
from starwise.io.foreign import kind_of
from starwise.io.maps import Choice, render
from starwise.io.pos import read_pos
from starwise.io.residuals import read_residuals
from starwise.io.truth import read_truth
from starwise.signals import sv_id, sv_name
from starwise.studies.residuals import Weights, _scale, judge_residuals
from test_edge_mutations import mutated

STAT_SPP = (
    "$POS,2307,518400.000,5,2251421.4204,862817.8446,5885476.8503,0.0000,0.0000,0.0000\n"
    "$VELACC,2307,518400.000,5,0.0026,-0.0044,0.0043,0.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0\n"
    "$CLK,2307,518400.000,5,1,-59.431,0.000,0.955,1.593\n"
    "$SAT,2307,518400.000,G04,1,97.2,30.3,-0.1378,0.0000,0,43.5,0,0,0,0,0,0\n"
    "$SAT,2307,518400.000,129,1,307.2,15.4,-1.1653,0.0000,0,39.5,0,0,0,0,0,0\n"
)
STAT_PPP = (
    "$POS,2307,518400.000,6,2251420.9262,862818.3683,5885473.6313,1.8868,1.1983,3.5766\n"
    "$TROP,2307,518400.000,6,1,2.2454,0.1198\n"
    "$SAT,2307,518400.000,G04,1,97.2,30.3,-0.4046,0.0028,1,43.5,0,0,1,0,0,0\n"
    "$SAT,2307,518400.000,G05,1,307.2,15.4,-0.1396,-0.0387,0,39.5,0,0,1,0,0,0\n"
)
STAT_RTK = (
    "$POS,2320,116400.000,1,-3817679.9534,3562838.3786,3650160.0240,-3817679.8650,3562838.4753,3650159.8381\n"
    "$SAT,2320,116400.000,G05,1,50.2,67.6,0.3536,0.0002,1,46.9,2,0,1,0,0,0\n"
    "$SAT,2320,116400.000,G11,1,50.2,67.6,0.0000,0.0000,1,46.9,2,0,1,0,0,0\n"
    "$SAT,2320,116400.000,G05,2,50.2,67.6,0.2586,0.0004,1,49.5,2,0,1,0,0,0\n"
)
STATES = (
    "gps_millis,x_rx_wls_m,y_rx_wls_m,z_rx_wls_m,b_rx_wls_m,lat_rx_wls_deg,lon_rx_wls_deg,alt_rx_wls_m\n"
    "1303770943999.0,-2696238.26,-4297685.36,3852395.47,16.2,37.395,-122.10,10.9\n"
    "1303770944999.5,-2696238.27,-4297693.82,3852400.48,136.4,37.395,-122.10,19.7\n"
    "1303770945999.0,nan,nan,nan,nan,nan,nan,nan\n"
)
RESIDUALS = (
    "residuals_m,gps_millis,gnss_id,sv_id,signal_type\n"
    "-4.92,1303770943999.0,gps,2,l1\n-22.9,1303770943999.0,galileo,5,e1\nnan,1303770943999.0,qzss,193,l1\n"
)
NAV = "".join(
    f"{0.0:<15.9f} {456300.0 + 0.005 * i:<15.9f} {30.4447873696:<15.9f} {114.4718632 + 1e-7 * i:<15.9f} {20.9:<15.9f} "
    f"{0.1:<15.9f} {2.0:<15.9f} {-0.05:<15.9f} {0.85:<15.9f} {-2.03:<15.9f} {185.7:<15.9f} \n"
    for i in range(50)
)
STD = "".join(
    f"{456300.0 + 0.005 * i:<15.9f} " + " ".join(f"{v:<15.9f}" for v in (1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    + " 1.0" * 12 + " \n"
    for i in range(50)
)  # fmt: skip
NMEA = (
    "$GNRMC,235959.00,A,4807.038,N,01131.000,E,022.4,084.4,311221,003.1,W\r\n"
    "$GNGGA,000000.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,\r\n"
    "$GNGST,000000.00,38,5.0,3.0,30,4.5826,3.6056,6.0\r\n"
    "$GNGGA,000001.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,\r\n"
)


def checked(line: str) -> str:
    total = 0
    for byte in line[1:].encode():
        total ^= byte
    return f"{line}*{total:02X}"


def written(folder: Path, text: str | bytes, name: str = "file") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


KINDS: dict[str, tuple[str, str]] = {
    "stat": (STAT_SPP, "stat"),
    "states": (STATES, "gnss_lib_py"),
    "residuals": (RESIDUALS, "gnss_lib_py residuals"),
    "nav": (NAV, "kf-gins"),
    "std": (STD, "kf-gins std"),
    "nmea": (NMEA, "nmea"),
    "binary and nmea": ("\xb5b\x01\x07\x00" + NMEA, "nmea"),
    "android": (
        "NMEA," + checked("$GPGGA,234257.00,3725.59,N,12210.42,W,1,24,0.4,51.9,M,-28.4,M,,") + ",16994\n",
        "nmea",
    ),
    "pos": ("% program\n2190 518400.000 43.5 1.4 157.2 5 21 1.7 1.2 3.1 0.1 0.1 0.1 0.0 0.0\n", "pos"),
    "headless pos": ("2190 518400.000 43.5 1.4 157.2 5 21 1.7 1.2 3.1 0.1 0.1 0.1 0.0 0.0\n", "pos"),
}


@pytest.mark.parametrize("name", KINDS)
def test_told_by_content(name: str, tmp_path: Path) -> None:
    text, kind = KINDS[name]
    assert kind_of(written(tmp_path, text.encode("latin-1"))) == kind


# -- RTKLIB .stat -----------------------------------------------------------------------------------------------


def test_stat_single(tmp_path: Path) -> None:
    path = written(tmp_path, STAT_SPP)
    solution = read_solution(path)
    assert solution.t_ns.tolist() == [from_week_tow(2307, 518400.0)]
    np.testing.assert_array_equal(solution.pos_e[0], [2251421.4204, 862817.8446, 5885476.8503])
    lat, lon, _ = geodetic_from_ecef(solution.pos_e[0])
    np.testing.assert_allclose(C_ne_enu(lat, lon) @ solution.vel_e[0], [0.0026, -0.0044, 0.0043], rtol=0, atol=1e-9)
    assert np.isnan(solution.cov_pos).all()  # the zeros are no sigmas
    table = read_residuals(path)
    assert [sv_name(int(sv)) for sv in table.sv] == ["G04", "S29"]
    assert table.valid.all()  # vsat is 0 with single positions, and means nothing
    assert np.isnan(table.phase_m).all()
    np.testing.assert_allclose(table.code_m, [-0.1378, -1.1653])
    np.testing.assert_allclose(np.degrees(table.elevation_rad), [30.3, 15.4])
    np.testing.assert_allclose(table.cn0_dbhz, [43.5, 39.5])
    assert "no variances" in table.notes[0]


def test_stat_ppp_has_sigmas_where_others_have_a_fixed_position(tmp_path: Path) -> None:
    solution = read_solution(written(tmp_path, STAT_PPP))
    np.testing.assert_allclose(np.sqrt(np.diag(solution.cov_pos[0])), [1.8868, 1.1983, 3.5766])
    table = read_residuals(tmp_path / "file")
    assert table.valid.tolist() == [True, False]
    np.testing.assert_allclose(table.phase_m, [0.0028, -0.0387])
    fixed = read_solution(written(tmp_path, STAT_RTK))
    np.testing.assert_array_equal(fixed.pos_e[0], [-3817679.8650, 3562838.4753, 3650159.8381])
    assert np.isnan(fixed.cov_pos).all()


def test_stat_relative_leaves_the_reference_satellite_out(tmp_path: Path) -> None:
    table = read_residuals(written(tmp_path, STAT_RTK))
    assert [(sv_name(int(sv)), table.channels[c]) for sv, c in zip(table.sv, table.channel, strict=True)] == [
        ("G05", "L1"), ("G05", "L2"), ("G11", "L1"),
    ]  # fmt: skip
    assert table.valid.tolist() == [True, True, False]
    assert np.isnan(table.code_m[2])
    assert "double differences" in table.notes[1]


def test_stat_cut_by_a_crash(tmp_path: Path) -> None:
    table = read_residuals(written(tmp_path, STAT_SPP[:-30]))
    assert table.n == 1
    assert "nan" not in judge_residuals(table).explain()  # of one epoch there is no correlation
    assert "cut" in table.notes[-1]


@pytest.fixture(scope="module")
def rnx2rtkp() -> str:
    program = shutil.which("rnx2rtkp")
    if program is None:
        pytest.skip("rnx2rtkp (Debian package rtklib) is not installed")
    return program


@pytest.fixture(scope="module")
def kiru(rnx2rtkp: str, shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Position file of KIRU by RTKLIB with options of the shared set, and its status file beside it."""
    folder = tmp_path_factory.mktemp("kiru")
    source = shared_data / "static" / "kiru_2024090"
    files = [
        next(source.glob(pattern))
        for pattern in ("KIRU00SWE_R_*_MO.rnx", "KIR000SWE_R_*_MN.rnx", "*_ORB.SP3", "*_CLK_short.CLK")
    ]

    def made(conf: str) -> Path:
        out = folder / f"{conf}.pos"
        if not out.exists():
            text = (shared_data / "rtklib_conf" / f"{conf}.conf").read_text() + "\nout-outstat=residual\n"
            written(folder, text, f"{conf}.conf")
            subprocess.run(
                [rnx2rtkp, "-k", folder / f"{conf}.conf", "-o", out, *files],
                check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
        return out

    return made


@pytest.mark.real
@pytest.mark.parametrize(("conf", "channels"), [("spp", ("L1",)), ("ppp_static", ("L1",))])
def test_stat_of_rtklib(conf: str, channels: tuple[str, ...], kiru: Callable[[str], Path]) -> None:
    pos = kiru(conf)
    stat = pos.with_name(pos.name + ".stat")
    solution, reference = read_solution(stat), read_pos(pos)
    np.testing.assert_array_equal(solution.t_ns, reference.t_ns)
    assert np.abs(solution.pos_e - reference.pos_e).max() < 1e-4  # both written to 0.1 mm
    if conf == "ppp_static":
        sigma = np.sqrt(np.diagonal(solution.cov_pos, axis1=1, axis2=2))
        wanted = np.sqrt(np.diagonal(reference.cov_pos, axis1=1, axis2=2))
        np.testing.assert_allclose(sigma, wanted, rtol=0, atol=1.1e-4)
    table = read_residuals(stat)
    assert table.channels == channels
    used = np.array([np.count_nonzero(table.valid & (table.t_ns == t)) for t in reference.t_ns])
    assert np.abs(used - reference.n_used).max() <= (0 if conf == "spp" else 2)


@pytest.mark.real
def test_laboratory_on_rtklib(kiru: Callable[[str], Path], truth: dict[str, Any]) -> None:
    stat = kiru("spp").with_name("spp.pos.stat")
    report = judge_residuals(stat, solution=read_solution(stat))
    # Half a minute apart, errors of orbits, ionosphere and reflections last: nobody's residuals are white there.
    assert report.consistency.passed is False
    assert any(str(finding.cause) == "correlated" for finding in report.consistency.findings)
    assert (
        0.3 < report.sizes["zenith_sigma_m"] < 2.0
    )  # m, code errors of a geodetic receiver with a broadcast ionosphere
    assert len(report.consistency.by_satellite) > 40
    assert max(len(line) for line in report.explain().splitlines()) <= 79


def simulated_stat(rng: np.random.Generator, sigma: Callable[[np.ndarray], np.ndarray], epochs: int = 240) -> str:
    """Status file of least squares with weights of RTKLIB, errors of ``sigma`` of the elevation."""
    el = np.radians(rng.uniform(12.0, 85.0, 12))
    az = rng.uniform(0.0, 2.0 * np.pi, 12)
    H = np.column_stack([-np.cos(el) * np.sin(az), -np.cos(el) * np.cos(az), -np.sin(el), np.ones(12)])
    W = np.diag(1.0 / Weights().known_var(el, np.zeros(12, np.int64)))
    project = np.eye(12) - H @ np.linalg.solve(H.T @ W @ H, H.T @ W)
    lines = []
    for k in range(epochs):
        tow = 518400.0 + 30.0 * k
        lines.append(f"$POS,2307,{tow:.3f},5,2251421.4204,862817.8446,5885476.8503,0.0000,0.0000,0.0000")
        residual = project @ (sigma(el) * rng.normal(size=12))
        for i in range(12):
            lines.append(
                f"$SAT,2307,{tow:.3f},G{i + 1:02d},1,{np.degrees(az[i]):.1f},{np.degrees(el[i]):.1f},{residual[i]:.4f},"
                "0.0000,0,43.5,0,0,0,0,0,0"
            )
    return "\n".join(lines) + "\n"


def test_sizes_of_simulated_residuals(tmp_path: Path) -> None:
    """Errors of twice the assumed sigma are found to be so; a satellite with a bias is named."""
    rng = np.random.default_rng(5)

    def sigma(el: np.ndarray) -> np.ndarray:
        return np.asarray(2.0 * np.sqrt(Weights().known_var(el, np.zeros(len(el), np.int64))))

    report = judge_residuals(written(tmp_path, simulated_stat(rng, sigma), "a.stat"))
    # 240 epochs of 8 degrees of freedom: 1 sigma of the ratio is 1 / sqrt(2 * 1920) = 1.6 %
    assert report.sizes["claimed_ratio"] == pytest.approx(2.0, rel=0.065)
    conf = written(tmp_path, "stats-errphase=0.006\nstats-errphaseel=0.006\n", "a.conf")
    assert judge_residuals(tmp_path / "a.stat", conf=conf).sizes["claimed_ratio"] < 1.7
    names = [finding.where for finding in report.consistency.findings if str(finding.cause) == "bias"]
    assert not names
    text = (tmp_path / "a.stat").read_text().splitlines()
    for i, line in enumerate(text):
        fields = line.split(",")
        if fields[0] == "$SAT" and fields[3] == "G05":
            fields[7] = f"{float(fields[7]) + 3.0:.4f}"
            text[i] = ",".join(fields)
    biased = judge_residuals(written(tmp_path, "\n".join(text) + "\n", "b.stat"))
    assert any("G05" in f.where for f in biased.consistency.findings if str(f.cause) == "bias")


def test_a_clock_of_rtklib_per_system() -> None:
    """QZSS and SBAS have that of GPS: 8 rows, less 3 coordinates and 2 clocks."""
    system = np.array([0, 0, 0, 0, 4, 6, 2, 2])  # G G G G J S E E
    assert _scale(np.zeros(8, np.int64), system, np.full(8, 3.0 / 8.0)) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.real
def test_assess_a_stat(
    kiru: Callable[[str], Path],
    truth: dict[str, Any],
    capsys: pytest.CaptureFixture[str],
    shared_data: Path,
    tmp_path: Path,
) -> None:
    stat = kiru("spp").with_name("spp.pos.stat")
    place = ",".join(str(v) for v in truth["KIRU_2024.244"]["marker_ecef_m"])
    conf = shared_data / "rtklib_conf" / "spp.conf"
    assert run(["assess", str(stat), "--truth", place, "--rtklib-conf", str(conf)]) == 0
    shown = capsys.readouterr().out
    for words in ("RMS 3D", "Not consistent", "lag 1", "\nG05 ", "writes no variances"):
        assert words in shown.replace("  G05", "\nG05")
    assert max(len(line) for line in shown.splitlines()[1:]) <= 80
    assert run(["assess", str(stat), "--truth", place, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    pos = starwise.assess(kiru("spp"), place)
    assert report["rms_3d_m"] == pytest.approx(pos["rms_3d_m"], abs=1e-4)  # both files have 0.1 mm
    assert pos["consistency"]["sizes"] == report["consistency"]["sizes"]  # of the status file beside the positions
    assert pos["coverage_95"] > 0.9
    assert report["coverage_95"] is None
    assert report["consistency"]["grade"] == "inconsistent"
    assert len(report["consistency"]["satellites"]) > 40
    alone = written(tmp_path, kiru("spp").read_bytes(), "alone.pos")
    with pytest.raises(StarwiseError, match="without residuals"):
        run(["assess", str(alone), "--rtklib-conf", str(conf)])


def test_assess_residuals_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, RESIDUALS, "r.csv")
    assert run(["assess", str(path), "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)) == {"consistency", "notes"}
    assert run(["assess", str(path)]) == 0
    assert "2 residuals of 2 satellites in 1 epochs" in capsys.readouterr().out


# -- NMEA ---------------------------------------------------------------------------------------------------------


def test_gst_gives_the_covariance(tmp_path: Path) -> None:
    solution = read_solution(written(tmp_path, NMEA))
    assert solution.t_ns[0] == from_calendar(2022, 1, 1, system="UTC")
    lat, lon, _ = geodetic_from_ecef(solution.pos_e[0])
    C = C_ne_enu(lat, lon)
    bearing = np.radians(30.0)  # of the major axis of 5 m, from north to east; 3 m across
    along, across = np.array([np.sin(bearing), np.cos(bearing)]), np.array([np.cos(bearing), -np.sin(bearing)])
    wanted = np.zeros((3, 3))
    wanted[:2, :2] = 25.0 * np.outer(along, along) + 9.0 * np.outer(across, across)
    wanted[2, 2] = 36.0
    np.testing.assert_allclose(C @ solution.cov_pos[0] @ C.T, wanted, rtol=0, atol=1e-3)  # sigmas have 4 decimals
    assert np.isnan(solution.cov_pos[1]).all()
    assert solution.provenance["covariance"] == "GST; 1 epochs without"


@pytest.mark.parametrize(
    ("gst", "sigmas"),
    [
        ("38,60,38,89,15,24,31", (24.0, 15.0, 31.0)),  # an ellipse that contradicts the sigmas says nothing
        (",,,,15,24,31", (24.0, 15.0, 31.0)),
        ("38,60,38,90,,,31", (60.0, 38.0, 31.0)),
        ("38,60,38,0,,,31", (38.0, 60.0, 31.0)),  # the major axis points north
        ("38,60,38,89,15,24,", None),
        ("38,0,0,0,0,0,0", None),
        ("38", None),
    ],
)
def test_gst_with_holes(gst: str, sigmas: tuple[float, float, float] | None, tmp_path: Path) -> None:
    text = NMEA.replace("38,5.0,3.0,30,4.5826,3.6056,6.0", gst)
    solution = read_solution(written(tmp_path, text))
    if sigmas is None:
        assert solution.provenance["covariance"] == "no GST: none"
        return
    lat, lon, _ = geodetic_from_ecef(solution.pos_e[0])
    C = C_ne_enu(lat, lon)
    np.testing.assert_allclose(C @ solution.cov_pos[0] @ C.T, np.diag(np.square(sigmas)), rtol=0, atol=1e-6)


def gga(clock: str) -> str:
    return f"$GNGGA,{clock},4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"


def rmc(clock: str, date: str) -> str:
    return f"$GNRMC,{clock},A,4807.038,N,01131.000,E,,,{date},,,A"


@pytest.mark.parametrize(
    ("lines", "first", "steps_s"),
    [
        # one date for two days
        (
            ["$GNZDA,000000.00,01,01,2022,00,00", *(gga(f"{hour % 24:02d}0000") for hour in range(48))],
            (2022, 1, 1),
            [3600.0] * 47,
        ),
        # the position before its date, over midnight with a leap second, and after a night without any
        (
            [
                line
                for clock, date in (
                    ("235958", "311216"), ("235959", "311216"), ("235960", "311216"), ("000000", "010117"),
                    ("123000", "020117"), ("123001", "020117"),
                )
                for line in (gga(clock), rmc(clock, date))
            ],
            (2016, 12, 31),
            [1.0, 1.0, 1.0, 36.5 * 3600.0, 1.0],
        ),
        # more than half a day before the first date; one of them without a height
        (
            [*(gga(f"{h:02d}0000") for h in range(24)), gga("230001").replace("545.4", ""), rmc("235900", "311221")],
            (2021, 12, 31),
            [3600.0] * 23,
        ),
        (
            ["$GNZDA,000000.00,01,01,99999999999,00,00", gga("000000"), rmc("000000", "010122"), gga("000001")],
            (2022, 1, 1),
            [1.0],
        ),
    ],
)  # fmt: skip
def test_days_of_nmea(lines: list[str], first: tuple[int, int, int], steps_s: list[float], tmp_path: Path) -> None:
    solution = read_solution(written(tmp_path, "\n".join(lines)))
    np.testing.assert_array_equal(np.diff(solution.t_ns), np.array(steps_s) * NS)
    assert (solution.t_ns[0] - from_calendar(first[0], first[1], first[2], system="UTC")) // (86400 * NS) == 0


def test_height_of_nmea_without_the_geoid(tmp_path: Path) -> None:
    above = [gga("000001").replace("46.9", ""), rmc("000001", "010122"), gga("000002").replace("46.9,M", ",")]
    solution = read_solution(written(tmp_path, "\n".join(above), "a.nmea"))
    assert solution.provenance["height"] == "geodetic"
    assert geodetic_from_ecef(solution.pos_e[0])[2] == pytest.approx(545.4, abs=1e-6)
    starwise.export(solution, output=tmp_path / "b.nmea")  # and it stays so
    assert read_solution(tmp_path / "b.nmea").provenance["height"] == "geodetic"
    solution = read_solution(written(tmp_path, "\n".join([*above, gga("000003")])))
    assert geodetic_from_ecef(solution.pos_e)[:, 2].tolist() == pytest.approx([545.4 + 46.9], abs=1e-6)
    assert solution.provenance["skipped"] == 2
    assert solution.provenance["geoid_m"] == 46.9


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        (",N,", ",s,"), (",E,", ",,"), ("4807.038", "4877.038"), ("4807.038", "-4807.03"), ("4807.038", "4807.nan"),
        ("000001", "007501"), ("000001", "000061"),
    ],
)  # fmt: skip
def test_sentences_that_are_damaged(right: str, wrong: str, tmp_path: Path) -> None:
    lines = [rmc("000000", "010122"), gga("000000"), gga("000001").replace(right, wrong, 1)]
    solution = read_solution(written(tmp_path, "\n".join(lines)))
    assert (solution.n_epochs, solution.provenance["skipped"]) == (1, 1)


def test_checksums_wrong_now_and_then_and_always(tmp_path: Path) -> None:
    pairs = [
        (
            checked(f"$GNRMC,0000{i:02d}.00,A,4807.038,N,01131.000,E,,,010122,,,A"),
            checked(f"$GNGGA,0000{i:02d}.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"),
        )
        for i in range(12)
    ]
    some = [rmc for rmc, _ in pairs] + [gga[:-2] + "00" if i == 3 else gga for i, (_, gga) in enumerate(pairs)]
    solution = read_solution(written(tmp_path, "\n".join(some)))
    assert solution.n_epochs == 11
    assert solution.provenance["skipped"] == 1
    every = "\n".join(f"{rmc[:-2]}00\n{gga}" for rmc, gga in pairs)
    solution = read_solution(written(tmp_path, every))
    assert solution.n_epochs == 12
    assert solution.provenance["checksums"] == "wrong in all RMC"


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "epochs", "sigma_m"),
    [
        ("streams/pygnssutils/pygpsdata-nmea.log", 1, (24.0, 15.0, 31.0)),
        ("streams/pyubx2/pygpsdata-MIXED2.log", 1, (44.0, 20.0, 31.0)),
        ("kinematic/phones/android/nmea/pixel6.nmea", 48, None),
        ("kinematic/google_mtv_20200206/MTV.Local1.ublox-F9K.20200206-181434.nmea", 1653, None),
        # every RMC of this file has a wrong checksum
        ("kinematic/google_mtv_20200206/MTV.Local1.SPAN.20200206-181434.gga", 1748, None),
    ],
)
def test_nmea_of_receivers(
    name: str, epochs: int, sigma_m: tuple[float, ...] | None, shared_data: Path, tmp_path: Path
) -> None:
    solution = read_solution(shared_data / name)
    assert solution.n_epochs == epochs
    if sigma_m is None:
        assert solution.provenance["covariance"] == "no GST: none"
        return
    lat, lon, _ = geodetic_from_ecef(solution.pos_e[0])
    C = C_ne_enu(lat, lon)
    seen = np.sqrt(np.diag(C @ solution.cov_pos[0] @ C.T))
    np.testing.assert_allclose(np.sort(seen), np.sort(np.array(sigma_m)), rtol=0, atol=0.51)  # written in whole metres


# -- gnss_lib_py ------------------------------------------------------------------------------------------------


def test_gnss_lib_py_states(tmp_path: Path) -> None:
    solution = read_solution(written(tmp_path, STATES))
    assert solution.t_ns.tolist() == [1303770943999000000, 1303770944999500000, 1303770945999000000]
    np.testing.assert_array_equal(solution.pos_e[1], [-2696238.27, -4297693.82, 3852400.48])
    assert solution.has_position.tolist() == [True, True, False]
    assert solution.provenance["estimate"] == "wls"
    ekf = STATES.replace("_wls_", "_ekf_").replace("b_rx_ekf_m", "vx_rx_ekf_mps,vy_rx_ekf_mps,vz_rx_ekf_mps")
    rows = [ekf.splitlines()[0], "1303770943999.0,1e6,2e6,6e6,1.0,2.0,3.0,37.395,-122.10,10.9"]
    solution = read_solution(written(tmp_path, "\n".join(rows)))
    np.testing.assert_array_equal(solution.vel_e[0], [1.0, 2.0, 3.0])
    angles = "gps_millis,lat_rx_gt_deg,lon_rx_gt_deg,alt_rx_gt_m\n1000,45.0,7.0,100.0\n"
    solution = read_solution(written(tmp_path, angles))
    wanted = ecef_from_geodetic([np.radians(45.0), np.radians(7.0), 100.0])
    np.testing.assert_allclose(solution.pos_e[0], wanted, rtol=0, atol=1e-8)
    truth = read_truth(str(written(tmp_path, STATES, "t.csv")))
    assert len(truth.pos_e) == 2


def test_gnss_lib_py_residuals(tmp_path: Path) -> None:
    table = read_residuals(written(tmp_path, RESIDUALS))
    assert table.sv.tolist() == sorted(sv_id(name) for name in ("G02", "E05", "J01"))
    assert table.channels == ("e1", "l1")
    assert int(table.valid.sum()) == 2
    assert judge_residuals(table).sizes["rows"] == 2
    with pytest.raises(StarwiseError, match="residuals without positions"):
        read_solution(tmp_path / "file")


# -- KF-GINS ----------------------------------------------------------------------------------------------------


def test_kf_gins(tmp_path: Path) -> None:
    nav = written(tmp_path, NAV, "KF_GINS_Navresult.nav")
    alone = read_solution(nav)
    assert np.isnan(alone.cov_pos).all()
    assert alone.t_ns[1] - alone.t_ns[0] == NS // 200
    assert alone.provenance["week"] == "not in the file"
    std = written(tmp_path, STD, "KF_GINS_STD.txt")
    for path in (nav, std, tmp_path):
        solution = read_solution(path)
        lat, lon, h = geodetic_from_ecef(solution.pos_e[0])
        assert (np.degrees(lat), np.degrees(lon), h) == pytest.approx((30.4447873696, 114.4718632, 20.9), abs=1e-7)
        C = C_ne_ned(lat, lon)
        np.testing.assert_allclose(C @ solution.cov_pos[0] @ C.T, np.diag([1.0, 4.0, 9.0]), rtol=0, atol=1e-9)
        np.testing.assert_allclose(C @ solution.cov_vel[0] @ C.T, np.diag([0.01, 0.04, 0.09]), rtol=0, atol=1e-9)
        np.testing.assert_allclose(C @ solution.vel_e[0], [0.1, 2.0, -0.05], rtol=0, atol=1e-9)
        assert solution.extra["yaw_deg"][0] == 185.7
        assert solution.extra["sigma_yaw_deg"][0] == 0.6


def test_assess_kf_gins_against_a_truth_with_weeks(tmp_path: Path) -> None:
    nav = written(tmp_path, NAV, "KF_GINS_Navresult.nav")
    written(tmp_path, STD, "KF_GINS_STD.txt")
    rows = [line.split() for line in NAV.splitlines()]
    for row in rows:
        row[0], row[4] = "2017", "22.9"
    dated = written(tmp_path, "\n".join(" ".join(row) for row in rows), "truth.nav")
    for solution, truth in ((nav, dated), (dated, nav)):
        report = starwise.assess(solution, str(truth))
        assert report["epochs_compared"] == 50
        assert report["rms_3d_m"] == pytest.approx(2.0, abs=1e-6)
    notes = starwise.assess(nav, str(dated))["notes"]
    assert any("week" in note for note in notes)
    assert any("inertial unit" in note for note in notes)
    assert "January 1980" in starwise.export(nav, output=tmp_path / "x.geojson").notes[0]
    assert starwise.assess(nav, str(dated))["coverage_50"] == 1.0  # 2 m up of 3 m sigma


def test_kf_gins_over_the_end_of_a_week_without_its_number(tmp_path: Path) -> None:
    rows = [line.split() for line in NAV.splitlines()[:4]]
    for row, tow in zip(rows, ("604799.5", "604799.75", "0.0", "0.25"), strict=True):
        row[1] = tow
    solution = read_solution(written(tmp_path, "\n".join(" ".join(row) for row in rows)))
    np.testing.assert_array_equal(np.diff(solution.t_ns), [NS // 4] * 3)


def test_kf_gins_std_of_other_times(tmp_path: Path) -> None:
    nav = written(tmp_path, NAV, "KF_GINS_Navresult.nav")
    lines = STD.splitlines(keepends=True)
    written(tmp_path, "".join(lines[10:]), "KF_GINS_STD.txt")
    solution = read_solution(nav)
    assert np.isnan(solution.cov_pos[:10]).all()
    assert np.isfinite(solution.cov_pos[10:]).all()
    written(tmp_path, STD.replace("4563", "1234"), "KF_GINS_STD.txt")
    with pytest.raises(StarwiseError, match="other times"):
        read_solution(nav)


# -- Bad input --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (STAT_SPP.replace("G04", "X04"), "file:4: not a satellite"),
        (STAT_SPP.replace("97.2", "x"), "file:4: not a \\$SAT record"),
        (STAT_SPP.split("$SAT")[0].replace("2251421.4204", "x"), "file:1: not a \\$POS record"),
        (STAT_SPP.replace("$CLK", "$CLO"), "file:3: not a record"),
        ("residuals_m,gps_millis\n", "no rows"),
        (STATES.replace("1303770944999.5", "x"), "file:3: not a number in gps_millis"),
        (STATES.replace("-2696238.27", "x"), "file:3: not a number in x_rx_wls_m"),
        (RESIDUALS.replace("gps,2", "gps,x"), "file:2: not a number in sv_id"),
        (RESIDUALS.replace("gps,2", "gps,99999"), "file:2: not a satellite"),
        (RESIDUALS.replace("gnss_id", "id"), "no gnss_id"),
        (NAV + "1 2 3\n", "file:51: not a row of KF-GINS"),
        (NAV.replace("20.9", "nan "), "file"),
        (STD, "Navresult.nav beside it"),
    ],
)
def test_refused_in_one_line(text: str, words: str, tmp_path: Path) -> None:
    path = written(tmp_path, text)
    read = read_residuals if "$SAT" in text or text.startswith("residuals") else read_solution
    with pytest.raises(StarwiseError, match=words) as caught:
        read(path)
    assert "\n" not in str(caught.value)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["stat", "states", "residuals", "nav", "std", "nmea", "csv"])
def test_mutations(name: str, tmp_path: Path) -> None:
    rng = random.Random(7)
    if name == "csv":
        original = render([("x", handmade_solution(12))], "csv", Choice())[0]
    else:
        original = KINDS[name][0].encode("latin-1")
    written(tmp_path, NAV, "KF_GINS_Navresult.nav")
    path = tmp_path / "KF_GINS_STD.txt"
    refused = 0
    for _ in range(250):
        path.write_bytes(mutated(original, rng) or b" ")
        for read in (read_solution, read_residuals):
            try:
                read(path)  # type: ignore[operator]
            except StarwiseError as error:
                refused += 1
                assert "\n" not in str(error)
    assert refused > 20
