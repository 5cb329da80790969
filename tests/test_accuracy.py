"""Accuracy against the truth: known errors give known numbers, a true covariance is found to be true."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats

import starwise
from handmade import HERE, T0, handmade_solution
from starwise.analysis.accuracy import CHI2, NOMINAL, assess, match
from starwise.constants import EPOCH_NO_SOLUTION, EPOCH_SUSPECT, NS
from starwise.errors import StarwiseError
from starwise.frames import C_ne_enu, ecef_from_geodetic, geodetic_from_ecef
from starwise.io.pos import write_pos
from starwise.io.results import write_results
from starwise.io.truth import read_truth
from starwise.types import Solution, Truth


def shifted(error_enu: np.ndarray, sigma: float = 1.0) -> Solution:
    """A solution with given errors, east north up, about `HERE`, and covariance sigma^2 I."""
    n = len(error_enu)
    lat, lon, _ = geodetic_from_ecef(HERE)
    base = handmade_solution(max(n, 1))
    return replace(
        base,
        status=np.zeros(n, dtype=np.uint8),
        pos_e=HERE + error_enu @ C_ne_enu(lat, lon),
        cov_pos=np.tile(np.eye(3) * sigma**2, (n, 1, 1)),
    )


@pytest.mark.golden
def test_chi_square_points() -> None:
    for dof, points in CHI2.items():
        assert points == pytest.approx(scipy.stats.chi2.ppf(np.array(NOMINAL) / 100.0, dof), abs=1e-12)


def test_known_errors_give_known_numbers() -> None:
    error = np.tile([[1.0, 0.0, 2.0], [3.0, 0.0, -2.0]], (10, 1))
    report = assess(shifted(error, sigma=2.0), Truth(HERE))
    wanted = {
        "epochs": 20, "epochs_solved": 20, "epochs_compared": 20, "mean_e_m": 2.0, "mean_n_m": 0.0, "mean_u_m": 0.0,
        "rms_2d_m": np.sqrt(5.0), "rms_3d_m": 3.0, "p95_2d_m": 3.0, "p95_3d_m": np.sqrt(13.0), "coverage_95": 1.0,
        "nees_mean": (5.0 + 13.0) / 2 / 4, "sigma_3d_mean_m": np.sqrt(12.0),
    }  # fmt: skip
    for key, value in wanted.items():
        assert report[key] == pytest.approx(value, abs=1e-7), key  # ECEF numbers of 6e6 m round at 1e-9 m


def test_true_covariance_is_found_true() -> None:
    n = 4000
    report = assess(handmade_solution(n, seed=7), Truth(HERE))
    # 95 % of n epochs, binomial: 5 sigma = 1.7 %. Mean of chi-square(3): 5 sqrt(6 / n) = 0.19. One in a million each.
    assert abs(report["coverage_95"] - 0.95) < 0.0172
    # 5 sigma of the binomial where it is widest, at 50 %: 4 %
    for curve in ("3d", "horizontal", "vertical"):
        assert report["calibration"][curve] == pytest.approx([0.50, 0.68, 0.95], abs=0.04), curve
    assert report["calibration"]["3d"] == [report["coverage_50"], report["coverage_68"], report["coverage_95"]]
    assert abs(report["nees_mean"] - 3.0) < 0.194


@pytest.mark.parametrize(("factor", "seen"), [(0.25, "too small"), (16.0, "too large")])
def test_false_covariance_is_found_false(factor: float, seen: str) -> None:
    solution = handmade_solution(1000)
    report = assess(replace(solution, cov_pos=solution.cov_pos * factor), Truth(HERE))
    if seen == "too small":
        assert report["coverage_95"] < 0.6
        assert report["nees_mean"] > 10.0
    else:
        assert report["coverage_95"] == 1.0
        assert report["nees_mean"] < 0.3


def test_unsolved_and_suspect_epochs_are_counted_apart() -> None:
    error = np.zeros((10, 3))
    error[8] = [300.0, 0.0, 0.0]
    solution = shifted(error)
    status = solution.status.copy()
    status[8], status[9] = EPOCH_SUSPECT, EPOCH_NO_SOLUTION
    report = assess(replace(solution, status=status), Truth(HERE))
    assert (report["epochs"], report["epochs_solved"], report["epochs_flagged"]) == (10, 9, 1)
    assert report["rms_3d_m"] == pytest.approx(100.0, abs=1e-6)  # all solved epochs, the suspect one included
    assert report["unflagged"]["rms_3d_m"] == pytest.approx(0.0, abs=1e-6)
    assert report["flagged"]["rms_3d_m"] == pytest.approx(300.0, abs=1e-6)


def test_truth_along_the_way() -> None:
    times = T0 + np.arange(5) * NS
    path = HERE + np.arange(5)[:, None] * np.array([10.0, 0.0, 0.0])
    base = shifted(np.zeros((4, 3)))
    moved = replace(base, pos_e=path[:4] + np.array([5.0, 0.0, 0.0]), t_ns=times[:4] + NS // 2)
    truth = Truth(path, times)
    assert len(match(moved, truth).at) == 0
    with pytest.raises(StarwiseError, match="time of the truth"):
        assess(moved, truth)
    found = match(moved, truth, interpolate=True)
    assert len(found.at) == 4
    assert np.abs(found.error_n).max() < 1e-6
    near = match(replace(moved, t_ns=times[:4] + 4_000_000), truth)
    np.testing.assert_allclose(np.linalg.norm(near.error_n, axis=1), 5.0, rtol=0, atol=1e-6)
    gap = Truth(path[[0, 4]], times[[0, 4]])
    assert len(match(moved, gap, interpolate=True).at) == 0  # nothing is interpolated over 4 s


def test_without_truth_it_is_scatter() -> None:
    report = assess(handmade_solution(100))
    assert report["reference"] == "own median"
    assert 1.0 < report["rms_3d_m"] < 20.0


def test_no_covariance_no_coverage() -> None:
    solution = shifted(np.ones((5, 3)))
    report = assess(replace(solution, cov_pos=np.full((5, 3, 3), np.nan)), Truth(HERE))
    assert report["coverage_95"] is None
    assert report["nees_mean"] is None
    assert report["rms_3d_m"] == pytest.approx(np.sqrt(3.0), abs=1e-6)


def test_nothing_solved() -> None:
    solution = shifted(np.full((3, 3), np.nan))
    with pytest.raises(StarwiseError, match="no epoch has a position"):
        assess(solution, Truth(HERE))


# -- Truth files, through the public function -----------------------------------------------------------------

LLH = geodetic_from_ecef(HERE)
LAT, LON, H = np.degrees(LLH[0]), np.degrees(LLH[1]), LLH[2]
WEEK, TOW = divmod(T0 // NS, 604_800)

TABLES = {
    "unnamed.csv": f"{WEEK},{TOW},{LAT:.10f},{LON:.10f},{H:.4f}\n{WEEK},{TOW + 1},{LAT:.10f},{LON:.10f},{H:.4f}\n",
    "named.csv": f"GPS Week, GPS TOW (s), Latitude (deg), Longitude (deg), Height (m)\n"
    f"{WEEK},{TOW},{LAT:.10f},{LON:.10f},{H:.4f}\n",
    "xyz.csv": f"t_gpst_ns,x_m,y_m,z_m\n{T0},{HERE[0]},{HERE[1]},{HERE[2]}\n",
    "millis.csv": f"millisSinceGpsEpoch,latDeg,lngDeg,heightAboveWgs84EllipsoidM\n"
    f"{T0 // 1_000_000},{LAT:.10f},{LON:.10f},{H:.4f}\n",
    "unix.csv": f"LatitudeDegrees,LongitudeDegrees,AltitudeMeters,UnixTimeMillis\n"
    f"{LAT:.10f},{LON:.10f},{H:.4f},{(T0 // NS + 315_964_800 - 18) * 1000}\n",
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_truth(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text(TABLES[name])
    truth = read_truth(str(path))
    assert truth.t_ns is not None
    assert truth.t_ns[0] == T0
    assert np.abs(truth.pos_e[0] - HERE).max() < 1e-4  # written to 1e-10 deg and 0.1 mm
    report = starwise.assess(shifted(np.tile([0.0, 3.0, 0.0], (2, 1))), path)
    assert report["mean_n_m"] == pytest.approx(3.0, abs=1e-3)


@pytest.mark.parametrize(
    ("typed", "raised"),
    [(f"{HERE[0]},{HERE[1]},{HERE[2]}", 0.0), (f"{LAT}, {LON}, {H}", 0.0), (f"{LAT} {LON} {H - 1.5}", 1.5)],
)
def test_typed_truth(typed: str, raised: float) -> None:
    report = starwise.assess(shifted(np.zeros((4, 3))), typed, antenna_up_m=raised)
    assert report["rms_3d_m"] < 1e-4


def test_solutions_are_truth_too(tmp_path: Path) -> None:
    solution = handmade_solution(30)
    write_results(solution, tmp_path / "run")
    (tmp_path / "x.pos").write_bytes(write_pos(solution))
    for truth in (tmp_path / "run", tmp_path / "run" / "solution.parquet", tmp_path / "x.pos"):
        assert starwise.assess(tmp_path / "run", truth)["rms_3d_m"] < 1e-3


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "empty"),
        ("a,b\n1,2\n", "no column of time"),
        ("week,tow,a\n1,2,3\n", "no columns of position"),
        ("1,2\n", "too few columns"),
        (f"week,tow,lat,lon,h\n{WEEK},x,1,2,3\n", ":2: row not readable"),
        ("week,tow,lat,lon,h\n", "no rows"),
    ],
)
def test_bad_tables(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(content)
    with pytest.raises(StarwiseError) as caught:
        read_truth(str(path))
    assert words in str(caught.value)


@pytest.mark.parametrize("typed", ["1,2", "a,b,c", "95,10,3", "nan,1,2", "nowhere.csv"])
def test_bad_typed_truth(typed: str) -> None:
    with pytest.raises(StarwiseError):
        read_truth(typed)


def test_heights_above_the_geoid(tmp_path: Path) -> None:
    text = write_pos(shifted(np.tile([0.0, 3.0, -50.0], (4, 1)))).decode().replace("/ellipsoidal", "/geodetic")
    path = tmp_path / "msl.pos"
    path.write_text(text)
    where = ",".join(str(v) for v in HERE)
    report = starwise.assess(path, where)
    assert report["rms_3d_m"] is None
    assert report["rms_2d_m"] == pytest.approx(3.0, abs=1e-3)
    assert report["notes"]
    assert starwise.assess(path, where, geoid_m=50.0)["rms_3d_m"] == pytest.approx(3.0, abs=1e-3)


@pytest.mark.real
def test_truth_of_the_urban_drive(shared_data: Path) -> None:
    truth = read_truth(str(shared_data / "kinematic" / "urbannav_tst_20190428" / "groundTruth_TST.csv"))
    assert truth.t_ns is not None
    assert len(truth.t_ns) == 485
    wanted = ecef_from_geodetic([np.radians(22.30115538), np.radians(114.17900033), 6.59589290])
    assert np.abs(truth.pos_e[0] - wanted).max() < 1e-6


@pytest.mark.real
def test_foreign_solution_against_its_own_truth(shared_data: Path, truth: dict[str, Any]) -> None:
    folder = shared_data / "rtk" / "nagoya_static_rtk_2024"
    lat, lon, h = (folder / "rover_position.txt").read_text().split()
    report = starwise.assess(folder / "rover_rtk.pos", f"{lat},{lon},{h}")
    assert report["epochs"] == 301
    assert report["rms_3d_m"] < 0.01  # fixed RTK, 2 mm in the description of the data
