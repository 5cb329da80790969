"""RTKLIB position files: every form its programs write, and our own round trip."""

import itertools
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handmade import handmade_solution
from starwise.constants import EPOCH_COASTED, EPOCH_OK, EPOCH_SUSPECT
from starwise.errors import StarwiseError
from starwise.frames import ecef_from_geodetic, enu_from_ecef
from starwise.io.pos import parse_pos, read_pos, write_pos
from starwise.io.results import solution_table
from starwise.types import Solution

SPP = ["pos1-posmode=single", "pos1-frequency=l1", "pos1-ionoopt=brdc", "pos1-tropopt=saas", "pos1-navsys=9"]


def test_round_trip() -> None:
    solution = handmade_solution()
    back = parse_pos(write_pos(solution), "x.pos")
    keep = solution.has_position
    np.testing.assert_array_equal(back.t_ns, solution.t_ns[keep])
    np.testing.assert_array_equal(back.n_used, solution.n_used[keep])
    # 1e-9 deg is 0.11 mm, the height has 0.1 mm
    np.testing.assert_allclose(back.pos_e, solution.pos_e[keep], rtol=0, atol=2e-4)
    np.testing.assert_allclose(back.vel_e, solution.vel_e[keep], rtol=0, atol=2e-5)  # written to 1e-5 m/s
    # deviations are written to 1e-4 m: of a variance of d^2, 2 d 1e-4, here d < 10 m
    np.testing.assert_allclose(back.cov_pos, solution.cov_pos[keep], rtol=0, atol=5e-3)
    np.testing.assert_allclose(back.cov_vel, solution.cov_vel[keep], rtol=0, atol=5e-5)
    wanted = {3: EPOCH_COASTED, 4: EPOCH_SUSPECT}
    assert [int(s) for s in back.status] == [wanted.get(i, EPOCH_OK) for i in range(len(back.status))]


@pytest.mark.parametrize("step_ns", [1_000_000_000, 100_000, 1_000_001])
def test_times_keep_their_nanoseconds(step_ns: int) -> None:
    solution = handmade_solution(5, step_ns=step_ns)
    back = parse_pos(write_pos(solution), "x.pos")
    np.testing.assert_array_equal(back.t_ns, solution.t_ns)


def test_without_velocity_there_are_no_velocity_columns() -> None:
    solution = handmade_solution(5)
    still = replace(solution, vel_e=np.full((5, 3), np.nan), cov_vel=np.full((5, 3, 3), np.nan))
    text = write_pos(still).decode()
    assert "vn(m/s)" not in text
    assert len(text.splitlines()[-1].split()) == 15
    back = parse_pos(text.encode(), "x.pos")
    assert np.isnan(back.vel_e).all()
    assert np.isnan(back.cov_vel).all()


def test_negative_fractions_of_a_degree() -> None:
    line = b"2190 518400.000   -0 30 00.00000   -1 15 36.00000   100.0000   5   8\n"
    head = b"%  GPST  latitude(d'\")   longitude(d'\")  height(m)   Q  ns\n"
    back = parse_pos(head + line, "x.pos")
    wanted = ecef_from_geodetic([np.radians(-0.5), np.radians(-1.26), 100.0])
    np.testing.assert_allclose(back.pos_e[0], wanted, rtol=0, atol=1e-6)
    assert np.isnan(back.cov_pos).all()


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (b"", "not a position file"),
        (b"hello world\n", "x.pos:1: no time"),
        (b"% GPST x-ecef(m)\n2190 1.0 1 2\n", "x.pos:2: too few columns"),
        (b"2190 1.0 91.0 200.0 3.0 5 6\n", "latitude"),
        (b"2022/13/01 00:00:00 1 2 3\n", "x.pos:1"),
        (b"99999 1.0 1 2 3\n", "no time"),
        (b"% GPST e-baseline(m)\n2190 1.0 1 2 3 1 9\n", "reference position"),
        (b"% ref pos : a b\n", "x.pos:1: reference position"),
        (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "x.pos"),
        (b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\n", "date"),
    ],
)
def test_refused_in_one_line(raw: bytes, words: str) -> None:
    with pytest.raises(StarwiseError) as caught:
        parse_pos(raw, "x.pos")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_nmea_with_midnight_between_date_and_position() -> None:
    text = (
        "$GPRMC,235959.00,A,4807.038,N,01131.000,E,022.4,084.4,311221,003.1,W\n"
        "$GPGGA,000000.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,\n"
    )
    back = parse_pos(text.encode(), "x.pos")
    assert back.n_epochs == 1
    assert (back.t_ns[0] // 10**9 - 18) % 86400 == 0  # GPST is 18 s ahead of UTC midnight
    llh = ecef_from_geodetic([np.radians(48 + 7.038 / 60), np.radians(11 + 31 / 60), 545.4 + 46.9])
    np.testing.assert_allclose(back.pos_e[0], llh, rtol=0, atol=1e-6)


# -- Against RTKLIB's own output ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rnx2rtkp() -> str:
    program = shutil.which("rnx2rtkp")
    if program is None:
        pytest.skip("rnx2rtkp (Debian package rtklib) is not installed")
    return program


@pytest.fixture(scope="module")
def tlse(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    from starwise.io.files import read_bytes

    folder = tmp_path_factory.mktemp("tlse")
    source = shared_data / "static" / "tlse_2022001"
    (folder / "tlse.obs").write_bytes(read_bytes(source / "TLSE00FRA_R_20220010000_01H_30S_MO.rnx.gz"))
    (folder / "brdc.nav").write_bytes(read_bytes(source / "BRDC00IGS_R_20220010000_01D_MN.zip"))
    return [str(folder / "tlse.obs"), str(folder / "brdc.nav")]


def rtklib(program: str, files: list[str], folder: Path, *options: str) -> bytes:
    conf, out = folder / "run.conf", folder / "run.pos"
    conf.write_text("\n".join(options) + "\n")
    subprocess.run([program, "-k", conf, "-o", out, *files], check=True, capture_output=True)
    return out.read_bytes()


def compare(form: Solution, reference: Solution, velocity: bool, vertical: bool = True) -> None:
    np.testing.assert_array_equal(form.t_ns, reference.t_ns)
    np.testing.assert_array_equal(form.n_used, reference.n_used)
    error = enu_from_ecef(form.pos_e, reference.pos_e[0]) - enu_from_ecef(reference.pos_e, reference.pos_e[0])
    # degrees to 1e-9 (0.1 mm) or arc seconds to 1e-5 (0.3 mm), heights to 0.1 mm
    assert np.abs(error[:, : 3 if vertical else 2]).max() < 5e-4
    # deviations to 1e-4 m: of a variance of d^2, 2 d 1e-4, here d < 4 m
    assert np.abs(form.cov_pos - reference.cov_pos).max() < 2e-3
    if velocity:
        assert np.abs(form.vel_e - reference.vel_e).max() < 3e-5  # written to 1e-5 m/s
        assert np.abs(form.cov_vel - reference.cov_vel).max() < 2e-5
    else:
        assert np.isnan(form.vel_e).all()


COORDINATES = [("xyz", "deg"), ("llh", "deg"), ("llh", "dms")]
TIMES = [("hms", "gpst"), ("tow", "gpst"), ("hms", "utc"), ("tow", "utc"), ("hms", "jst")]
LAYOUTS = [("", "on", "on"), (",", "on", "off"), (";", "off", "on"), ("\\t", "off", "off")]
# A third of all combinations, in which every pair of options occurs.
FORMS = [
    (COORDINATES[c], TIMES[t], LAYOUTS[s])
    for c, t, s in itertools.product(range(3), range(5), range(4))
    if (c + t + s) % 3 == 0
]


@pytest.fixture(scope="module")
def reference(rnx2rtkp: str, tlse: list[str], tmp_path_factory: pytest.TempPathFactory) -> Solution:
    options = ["out-solformat=xyz", "out-timeform=tow", "out-outvel=on"]
    return parse_pos(rtklib(rnx2rtkp, tlse, tmp_path_factory.mktemp("ref"), *SPP, *options), "ref.pos")


@pytest.mark.real
@pytest.mark.parametrize(("coordinates", "time_form", "layout"), FORMS)
def test_forms_of_rtklib(
    rnx2rtkp: str,
    tlse: list[str],
    tmp_path: Path,
    coordinates: tuple[str, str],
    time_form: tuple[str, str],
    layout: tuple[str, str, str],
    reference: Solution,
) -> None:
    assert reference.n_epochs > 100
    separator, velocity, head = layout
    raw = rtklib(
        rnx2rtkp,
        tlse,
        tmp_path,
        *SPP,
        f"out-solformat={coordinates[0]}",
        f"out-degform={coordinates[1]}",
        f"out-timeform={time_form[0]}",
        f"out-timesys={time_form[1]}",
        f"out-fieldsep={separator}",
        f"out-outvel={velocity}",
        f"out-outhead={head}",
    )
    compare(parse_pos(raw, "form.pos"), reference, velocity == "on")
    if time_form[1] == "gpst":
        bare = b"\n".join(line for line in raw.splitlines() if not line.startswith(b"%"))
        compare(parse_pos(bare, "bare.pos"), reference, velocity == "on")


@pytest.mark.real
def test_geodetic_height_is_kept_and_said(rnx2rtkp: str, tlse: list[str], tmp_path: Path, reference: Solution) -> None:
    form = parse_pos(rtklib(rnx2rtkp, tlse, tmp_path, *SPP, "out-solformat=llh", "out-height=geodetic"), "x.pos")
    assert form.provenance["height"] == "geodetic"
    compare(form, reference, velocity=False, vertical=False)


@pytest.mark.real
def test_nmea_of_rtklib(rnx2rtkp: str, tlse: list[str], tmp_path: Path, reference: Solution) -> None:
    form = parse_pos(rtklib(rnx2rtkp, tlse, tmp_path, *SPP, "out-solformat=nmea"), "x.pos")
    np.testing.assert_array_equal(form.t_ns, reference.t_ns)
    # GGA: 1e-7 minutes is 0.2 mm, heights have 1 mm
    assert np.abs(form.pos_e - reference.pos_e).max() < 2e-3


@pytest.mark.real
@pytest.mark.parametrize("degrees", ["deg", "dms"])
def test_baseline_needs_its_reference_and_finds_it(
    rnx2rtkp: str, shared_data: Path, tmp_path: Path, degrees: str
) -> None:
    folder = shared_data / "rtk" / "nagoya_static_rtk_2024"
    files = [str(folder / name) for name in ("rover.obs", "base.obs", "base.nav")]
    base = (folder / "base_position.txt").read_text().split()[:3]
    mode = [
        "pos1-posmode=kinematic", "pos1-frequency=l1", "ant2-postype=llh", "pos1-navsys=1",
        *(f"ant2-pos{i}={value}" for i, value in enumerate(base, 1)),
    ]  # fmt: skip
    form = [f"out-degform={degrees}", "out-outhead=on"]
    reference = parse_pos(rtklib(rnx2rtkp, files, tmp_path, *mode, *form, "out-solformat=xyz"), "ref.pos")
    assert reference.n_epochs > 10
    enu = parse_pos(rtklib(rnx2rtkp, files, tmp_path, *mode, *form, "out-solformat=enu"), "enu.pos")
    np.testing.assert_array_equal(enu.t_ns, reference.t_ns)
    # the header writes the reference position to 1e-9 deg and 0.1 mm
    assert np.abs(enu.pos_e - reference.pos_e).max() < 1e-3
    assert np.abs(enu.cov_pos - reference.cov_pos).max() < 2e-3


@pytest.mark.real
def test_our_file_is_read_by_rtklib(rnx2rtkp: str, tmp_path: Path) -> None:
    program = shutil.which("pos2kml")
    if program is None:
        pytest.skip("pos2kml (Debian package rtklib) is not installed")
    solution = handmade_solution(60)
    (tmp_path / "ours.pos").write_bytes(write_pos(solution))
    subprocess.run([program, "-o", tmp_path / "ours.kml", tmp_path / "ours.pos"], check=True, capture_output=True)
    text = (tmp_path / "ours.kml").read_text()
    assert text.count("<Point>") >= 55


@pytest.mark.filterwarnings("error")
def test_a_covariance_that_is_none_is_named() -> None:
    """RTKLIB, fixed epochs: correlations above 1; and rounding to 0.1 mm that leaves nothing of a variance."""
    line = (
        "2320 116400.000 -3817681.3784 3562839.9775 3650158.3754 1 42 0.0045 0.0052 {} -0.0041 0.0035 -0.0033 0.0 18.5"
    )
    head = "%  GPST  x-ecef(m)  y-ecef(m)  z-ecef(m)  Q  ns  sdx(m)  sdy(m)  sdz(m)\n"
    solution = parse_pos("\n".join([head, line.format("0.0100"), line.format("0.0000")]).encode(), "x.pos")
    assert solution.provenance["covariance"].startswith("1 of 2 epochs")
    table = solution_table(solution)
    nulls = [table[f"sigma_{axis}_m"].null_count() for axis in "enu"]
    assert sum(nulls) > 0  # a negative variance has no root
    written = write_pos(solution)
    assert all(float(text) >= 0.0 for row in written.splitlines()[3:] for text in row.split()[7:10])
    back = parse_pos(written, "y.pos")
    assert (np.linalg.eigvalsh(back.cov_pos)[:, 0] > 0.0).tolist() == [True, False]
    whole = parse_pos((head + line.format("0.0100")).encode(), "x.pos")
    assert "covariance" not in whole.provenance


def test_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(StarwiseError, match="cannot be read"):
        read_pos(tmp_path / "nothing.pos")
