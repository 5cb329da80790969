"""Solutions for maps: what other programs read from our files is what we wrote; and our own readers read them back."""

import csv
import json
import os
import shutil
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import starwise
from handmade import handmade_solution
from starwise.cli import run
from starwise.constants import EPOCH_OK, EPOCH_SUSPECT, NS
from starwise.errors import StarwiseError
from starwise.frames import C_ne_enu, ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef
from starwise.gnsstime import from_calendar, gpst_to_utc
from starwise.io.maps import FORMATS, Choice, export_solutions, render
from starwise.io.results import read_solution, write_results
from starwise.types import Solution

EVIL = "<script>alert('x')</script> & \"]]> \x07\ud800é"
GPX = "{http://www.topografix.com/GPX/1/1}"
KML = "{http://www.opengis.net/kml/2.2}"


def text_of(solution: Solution, to: str, name: str = "HERE", **choice: object) -> bytes:
    return render([(name, solution)], to, Choice(**choice))[0]  # type: ignore[arg-type]


def solved(solution: Solution) -> Solution:
    return replace(solution, status=np.full_like(solution.status, EPOCH_OK))


@pytest.fixture
def solution() -> Solution:
    return handmade_solution(40, step_ns=NS // 10)


def _local(cov: np.ndarray, place: np.ndarray) -> np.ndarray:
    """East, north, up."""
    lat, lon, _ = geodetic_from_ecef(place)
    C = C_ne_enu(lat, lon)
    return np.asarray(C @ cov @ C.T)


@pytest.mark.parametrize(("to", "sigmas"), [("csv", 1e-9), ("nmea", 3e-3), ("pos", 3e-3)])
def test_round_trip_through_our_own_reader(to: str, sigmas: float, solution: Solution, tmp_path: Path) -> None:
    path = tmp_path / f"x{FORMATS[to]}"
    made = starwise.export(solution, output=path)
    assert made.files == (path,)
    assert made.epochs == 39  # one epoch has no position
    back = read_solution(path)
    kept = np.isin(solution.t_ns, back.t_ns)
    assert kept.sum() == (38 if to == "nmea" else 39)  # quality 0 of NMEA, a suspect epoch, is skipped by readers
    np.testing.assert_array_equal(back.t_ns, solution.t_ns[kept])
    # 1e-7 minutes and 1e-9 degrees are below 0.2 mm; heights of NMEA have 1 mm
    np.testing.assert_allclose(back.pos_e, solution.pos_e[kept], rtol=0, atol=7e-4)
    # NMEA and pos write sigmas to 0.1 mm: of a variance of d^2 that is 2 d 1e-4, d < 10 m
    got, wanted = (_local(cov, solution.pos_e[0]) for cov in (back.cov_pos, solution.cov_pos[kept]))
    if to == "nmea":  # knows of no correlation with the height
        wanted[:, :2, 2] = wanted[:, 2, :2] = 0.0
    np.testing.assert_allclose(got, wanted, rtol=0, atol=sigmas)
    np.testing.assert_array_equal(back.n_used, solution.n_used[kept])


def test_csv_is_the_whole_solution(solution: Solution, tmp_path: Path) -> None:
    with_extra = replace(solution, extra={"roll_deg": np.arange(40.0)})
    starwise.export(with_extra, output=tmp_path / "x.csv")
    back = read_solution(tmp_path / "x.csv")
    keep = solution.has_position
    for name in ("pos_e", "vel_e", "cov_pos", "cov_vel", "clock_m", "drift_mps", "dop", "nis", "dof", "status"):
        np.testing.assert_array_equal(getattr(back, name), getattr(solution, name)[keep], err_msg=name)
    np.testing.assert_array_equal(back.extra["roll_deg"], with_extra.extra["roll_deg"][keep])


@pytest.mark.parametrize("to", FORMATS)
def test_times_are_utc_where_the_format_is(to: str) -> None:
    # 2016-12-31 23:59:58.250 to the next day: GPST - UTC goes from 17 to 18 s in between
    t0 = from_calendar(2016, 12, 31, 23, 59, 58.25, "UTC")
    text = text_of(replace(solved(handmade_solution(4)), t_ns=t0 + np.arange(4) * NS), to).decode()
    utc = {"nmea": "235958.250", "pos": None}.get(to, "2016-12-31T23:59:58.250Z")
    after = {"nmea": "000000.250", "pos": None}.get(to, "2017-01-01T00:00:00.250Z")
    if to == "pos":
        utc, after = "2017/01/01 00:00:15.250", "2017/01/01 00:00:18.250"
    assert utc in text
    assert after in text
    assert text.index(str(utc)) < text.index(str(after))


def test_names_cannot_break_out(solution: Solution) -> None:
    root = ET.fromstring(text_of(solution, "gpx", EVIL))
    assert root.findtext(f"{GPX}trk/{GPX}name") == EVIL.replace("\x07", "?").replace("\ud800", "?")
    root = ET.fromstring(text_of(solution, "kml", EVIL))
    assert root.findtext(f"{KML}Document/{KML}name") == EVIL.replace("\x07", "?").replace("\ud800", "?")
    features = json.loads(text_of(solution, "geojson", EVIL))["features"]
    assert features[0]["properties"]["name"] == EVIL


def test_suspect_epochs_are_marked_or_left_out(solution: Solution) -> None:
    one = int((solution.status == EPOCH_SUSPECT).sum())
    assert one == 1
    assert text_of(solution, "gpx").count(b"<type>suspect</type>") == one
    assert text_of(solution, "geojson").count(b'"status": "suspect"') == one
    assert text_of(solution, "kml").count(b"#suspect") == one
    assert text_of(solution, "nmea").count(b",V,") == one
    assert text_of(solution, "csv").count(b",suspect,") == one
    marks = {
        "gpx": b"<type>suspect</type>", "geojson": b'"status": "suspect"', "kml": b"#suspect", "nmea": b",V,",
        "csv": b",suspect,",
    }  # fmt: skip
    for to, mark in marks.items():
        assert mark not in text_of(solution, to, suspect=False)
    for suspect in (True, False):
        rows = [row.split() for row in text_of(solution, "pos", suspect=suspect).splitlines() if row[:1] != b"%"]
        assert [row[5] for row in rows].count(b"0") == (one if suspect else 0)


def test_heights(solution: Solution) -> None:
    h = geodetic_from_ecef(solution.pos_e[0])[2]

    def first(to: str, given: Solution, **choice: object) -> tuple[float, tuple[str, ...]]:
        data, _, notes = render([("x", given)], to, Choice(**choice))  # type: ignore[arg-type]
        if to == "gpx":
            return float(ET.fromstring(data).findtext(f".//{GPX}ele") or "nan"), notes
        if to == "nmea":
            fields = data.decode().splitlines()[1].split(",")
            return float(fields[9]), (*notes, fields[11])
        return json.loads(data)["features"][-1]["geometry"]["coordinates"][2], notes

    above_geoid = replace(solution, provenance={"height": "geodetic"})
    assert first("gpx", solution, geoid_m=48.5) == (pytest.approx(h - 48.5, abs=1e-4), ())
    assert first("gpx", above_geoid) == (pytest.approx(h, abs=1e-4), ())
    height, notes = first("gpx", solution)
    assert height == pytest.approx(h, abs=1e-4)
    assert "ellipsoidal" in notes[0]
    # altitude and separation of NMEA add up to the ellipsoidal height, geoid known or not
    for choice in ({}, {"geoid_m": 48.5}):
        height, notes = first("nmea", solution, **choice)
        assert height + float(notes[-1]) == pytest.approx(h, abs=2e-3)
    last = geodetic_from_ecef(solution.pos_e[-1])[2]
    assert first("geojson", solution) == (pytest.approx(last, abs=1e-4), ())
    assert first("geojson", above_geoid, geoid_m=48.5) == (pytest.approx(last + 48.5, abs=1e-4), ())
    assert "above the geoid" in first("geojson", above_geoid)[1][0]
    with pytest.raises(StarwiseError, match="ellipsoidal"):
        first("geojson", solution, geoid_m=48.5)


def test_the_geoid_of_nmea_is_kept(solution: Solution, tmp_path: Path) -> None:
    starwise.export(solution, output=tmp_path / "x.nmea", geoid_m=48.5)
    made = starwise.export(tmp_path / "x.nmea", output=tmp_path / "x.gpx")
    assert made.notes == ()
    height = float(ET.parse(made.files[0]).getroot().findtext(f".//{GPX}ele") or "nan")
    assert height == pytest.approx(geodetic_from_ecef(solution.pos_e[0])[2] - 48.5, abs=2e-3)  # NMEA has 1 mm
    starwise.export(solution, output=tmp_path / "y.nmea")  # separation 0: not known
    assert "ellipsoidal" in starwise.export(tmp_path / "y.nmea", output=tmp_path / "y.gpx").notes[0]


def test_shapes_of_kml_lie_on_the_ground_unless_sea_level_is_known(solution: Solution) -> None:
    assert b"clampToGround" in text_of(solution, "kml")
    assert b"<altitudeMode>absolute" in text_of(solution, "kml", geoid_m=48.5)


def test_lines_end_at_gaps_and_at_the_antimeridian() -> None:
    lon = np.radians([179.9, 179.99, -179.92, -179.9, -179.9, -179.9])
    llh = np.column_stack([np.zeros(6), lon, np.zeros(6)])
    t_ns = np.array([0, 1, 2, 3, 60, 61]) * NS
    track = replace(solved(handmade_solution(6)), pos_e=ecef_from_geodetic(llh), t_ns=t_ns)
    root = ET.fromstring(text_of(track, "gpx"))
    assert [len(part) for part in root.iter(f"{GPX}trkseg")] == [2, 2, 2]
    assert all(-180.0 <= float(point.get("lon", "")) < 180.0 for point in root.iter(f"{GPX}trkpt"))
    lines = [f for f in json.loads(text_of(track, "geojson"))["features"] if f["geometry"]["type"] == "LineString"]
    assert [len(line["geometry"]["coordinates"]) for line in lines] == [2, 2, 2]


def test_lines_where_instants_come_twice_and_at_the_antimeridian_itself() -> None:
    llh = np.column_stack(
        [np.zeros(6), np.radians([179.98, 179.99, 180.0, 179.9999999999, -179.9, -179.8]), np.zeros(6)]
    )
    t_ns = np.array([0, 0, 1, 1, 2, 2]) * NS
    track = replace(solved(handmade_solution(6)), pos_e=ecef_from_geodetic(llh), t_ns=t_ns)
    parts = [
        [float(point.get("lon", "")) for point in part.iter(f"{GPX}trkpt")]
        for part in ET.fromstring(text_of(track, "gpx")).iter(f"{GPX}trkseg")
    ]
    # what is written as 180 would lie outside GPX's range, and draw a line around the world
    assert parts == [[179.98, 179.99], [-180.0, -180.0, -179.9, -179.8]]


@pytest.mark.parametrize(
    ("quality", "given", "to", "said"),
    [
        ({"1": 300, "5": 1}, "rtklib pos", "pos", True),
        ({"1": 300, "5": 1}, "rtklib pos", "nmea", True),
        ({"6": 3}, "rtklib stat", "nmea", True),
        ({"1": 3, "6": 1}, "nmea", "pos", False),
        ({"1": 3, "5": 1}, "nmea", "nmea", True),
        ({"5": 3, "7": 1, "0": 2}, "rtklib pos", "pos", False),
        ({"1": 300}, "rtklib pos", "gpx", False),
    ],
)
def test_a_quality_that_gets_lost_is_named(
    quality: dict[str, int], given: str, to: str, said: bool, solution: Solution
) -> None:
    foreign = replace(solution, provenance={"quality": quality, "format": given})
    notes = render([("x", foreign)], to, Choice())[2]
    assert any(note.startswith("quality") for note in notes) == said
    assert all(len(note) <= 73 for note in notes)  # "note: " before it, 80 columns


def test_satellites_that_are_not_known_are_not_none(solution: Solution) -> None:
    bare = replace(solution, n_used=np.zeros_like(solution.n_used))
    for to, word in (("gpx", b"<sat>"), ("geojson", b'"satellites"'), ("kml", b'"satellites"')):
        assert word in text_of(solution, to)
        assert word not in text_of(bare, to)
    assert text_of(bare, "nmea").splitlines()[1].split(b",")[7] == b""


def test_interval(solution: Solution) -> None:
    kept = text_of(solution, "geojson", interval_s=1.0).count(b'"Point"')
    assert kept == 4 - 0  # 4 s at 10 Hz from a whole second; none of them is the epoch without a position
    moved = replace(solution, t_ns=solution.t_ns - 400_000)  # corrected for a receiver clock
    assert text_of(moved, "geojson", interval_s=1.0).count(b'"Point"') == kept


def test_points_of_a_long_kml_are_thinned() -> None:
    text = text_of(handmade_solution(5000), "kml").decode()
    assert text.count("<Point>") == 2000
    assert text.count("<gx:coord>") == 4999


# -- Files ------------------------------------------------------------------------------------------------------


def test_several_solutions(tmp_path: Path, solution: Solution) -> None:
    pair = [("a b", solution), ("c", solution)]
    made = export_solutions(pair, "gpx", tmp_path / "x.gpx")
    assert [el.text for el in ET.parse(made.files[0]).iter(f"{GPX}name")] == ["a b", "c"]
    made = export_solutions(pair, "nmea", tmp_path)
    assert [path.name for path in made.files] == ["a_b.nmea", "c.nmea"]
    with pytest.raises(StarwiseError, match="existing directory"):
        export_solutions(pair, "csv", tmp_path / "x.csv")


def test_nothing_half_written(tmp_path: Path, solution: Solution) -> None:
    target = tmp_path / "x.kml"
    target.write_text("old")
    empty = replace(solution, pos_e=np.full_like(solution.pos_e, np.nan))
    with pytest.raises(StarwiseError, match="no epoch"):
        starwise.export(empty, output=target)
    assert target.read_text() == "old"
    with pytest.raises(StarwiseError, match="cannot be written"):
        starwise.export(solution, output=tmp_path / "absent" / "x.kml")
    if os.getuid():  # root may write anywhere
        tmp_path.chmod(0o500)
        with pytest.raises(StarwiseError, match="cannot be written"):
            starwise.export(solution, output=tmp_path / "y.kml")
        tmp_path.chmod(0o700)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x.kml"]


def test_command(
    tmp_path: Path, solution: Solution, capsysbinary: pytest.CaptureFixture[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_results(solution, tmp_path / "out")
    assert run(["export", "out", "--to", "kml"]) == 0
    assert b"39 epochs written to out.kml\nnote: heights are ellipsoidal" in capsysbinary.readouterr().out
    with pytest.raises(StarwiseError, match="exists already"):
        run(["export", "out", "--to", "kml"])
    assert run(["export", "out", "-o", "y.geojson", "--json"]) == 0
    assert json.loads(capsysbinary.readouterr().out) == {
        "format": "geojson", "files": ["y.geojson"], "epochs": 39, "notes": [],
    }  # fmt: skip
    assert run(["export", "out/solution.pos", "--to", "nmea", "-o", "-"]) == 0
    seen = capsysbinary.readouterr()
    assert seen.out.startswith(b"$GNZDA,")
    assert b"ellipsoidal" in seen.err
    for wrong, words in (
        (["out"], "no format"),
        (["out", "-o", "x.doc"], "no format"),
        (["out", "--to", "doc", "-o", "x"], "not a format"),
        (["out/solution.pos", "-o", "out/solution.pos"], "the output is an input"),
        (["out", "--to", "csv", "--geoid", "900"], "not the height of a geoid"),
        (["out", "--to", "csv", "--interval", "0"], "--interval"),
        (["out", "out", "--to", "csv", "-o", "z.csv"], "existing directory"),
        (["absent", "--to", "csv"], "no such file"),
    ):
        with pytest.raises(StarwiseError, match=words):
            run(["export", *wrong])
    assert (tmp_path / "out" / "solution.pos").read_bytes().startswith(b"% program")


# -- Other programs -----------------------------------------------------------------------------------------------


def tool(name: str, package: str) -> str:
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} (Debian package {package}) is not installed")
    return path


def by_gpsbabel(to: str, path: Path) -> np.ndarray:
    """Latitude, longitude, height, time of day of every point, read by gpsbabel."""
    command = [tool("gpsbabel", "gpsbabel"), "-t", "-i", to, "-f", str(path), "-o", "unicsv,prec=9", "-F", "-"]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    names = lines[0].split(",")
    at = [names.index(name) for name in ("Latitude", "Longitude", "Altitude", "Time")]
    rows = [[line.split(",")[i] for i in at] for line in lines[1:]]
    days = [np.dot([3600, 60, 1], [float(part) for part in row[3].split(":")]) for row in rows]
    return np.column_stack([np.array([row[:3] for row in rows], dtype=float), days])


def by_ogr(to: str, path: Path) -> np.ndarray:
    """The same, read by GDAL."""
    layer = {"gpx": ["track_points"], "kml": ["epochs"], "geojson": [path.stem]}[to]
    where = ["-where", "status IS NOT NULL"] if to == "geojson" else []
    command = [
        tool("ogr2ogr", "gdal-bin"), "-f", "CSV", "/vsistdout/", str(path), *layer, *where,
        "-lco", "GEOMETRY=AS_WKT",
    ]  # fmt: skip
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    rows = []
    for row in csv.DictReader(text.splitlines()):
        x, y, *z = row["WKT"].split("(")[1].split(")")[0].split()
        clock = row[{"gpx": "time", "kml": "timestamp", "geojson": "utc"}[to]].split()[1]
        second = np.dot([3600, 60, 1], [float(part) for part in clock.split("+")[0].rstrip("Z").split(":")])
        rows.append([float(y), float(x), float(z[0] if z else row["ele"]), second])
    return np.array(rows)


def by_rtklib(to: str, path: Path) -> np.ndarray:
    """The same, read by RTKLIB's pos2kml, from the KML that it makes; without times."""
    program = tool("pos2kml", "rtklib")
    made = path.with_name("rtklib.kml")
    subprocess.run(
        [program, "-a", "-o", str(made), str(path)], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    texts = [point.text or "" for point in ET.parse(made).getroot().findall(".//{*}Point/{*}coordinates")]
    table = np.array([[float(part) for part in text.split(",")] for text in texts])
    return np.column_stack([table[:, [1, 0, 2]], np.full(len(table), np.nan)])


READERS = [
    (by_gpsbabel, "gpx"), (by_gpsbabel, "kml"), (by_gpsbabel, "nmea"),
    (by_ogr, "gpx"), (by_ogr, "kml"), (by_ogr, "geojson"),
    (by_rtklib, "pos"), (by_rtklib, "nmea"),
]  # fmt: skip


@pytest.mark.parametrize(("reader", "to"), READERS)
def test_other_programs_read_what_we_wrote(reader: Callable[[str, Path], np.ndarray], to: str, tmp_path: Path) -> None:
    solution = solved(handmade_solution(60, step_ns=30 * NS))
    solution = replace(solution, pos_e=np.where(np.isnan(solution.pos_e), solution.pos_e[0], solution.pos_e))
    path = tmp_path / f"track{FORMATS[to]}"
    starwise.export(solution, output=path)
    seen = reader(to, path)
    assert len(seen) == 60
    back = ecef_from_geodetic(np.column_stack([np.radians(seen[:, :2]), seen[:, 2]]))
    error = enu_from_ecef(back, solution.pos_e[0]) - enu_from_ecef(solution.pos_e, solution.pos_e[0])
    # what these programs print: 1e-6 .. 1e-9 degrees (0.1 m at worst), heights to 0.1 m
    assert np.abs(error[:, :2]).max() < 0.12
    assert np.abs(error[:, 2]).max() < 0.11
    if np.isfinite(seen[:, 3]).all():
        utc = (gpst_to_utc(solution.t_ns) // NS) % 86400
        np.testing.assert_allclose(seen[:, 3], utc, rtol=0, atol=1e-3)
