"""The RDSS/SINS paper: laws of the navigator with late fixes, and small runs of everything that is reproduced."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from starwise import cli
from starwise.analysis.consistency import coverage, pass_region
from starwise.errors import StarwiseError
from starwise.kernels.sins15 import N0, linear_model, new_mind, roll
from starwise.physics.rdss import RdssNoise
from starwise.studies.rdss_sins import reproduce_rdss_sins
from starwise.studies.rdss_sins_runs import LAGS, WAYS, WINDOW, K, check_of, window_counts
from starwise.studies.rdss_sins_scene import (
    EVERY,
    EXPERIMENTS,
    PERIOD,
    RATE_HZ,
    Measured,
    Scene,
    SinsErrors,
    variant,
)

SHORT_S = 240.0
NONE = SinsErrors(1e-12, 1e-9, 1e-6, 1e-18, 1e-18, 1e-14, 1e-13, 1e-13)


@pytest.fixture(scope="module")
def turning() -> Scene:
    return Scene(variant(duration_s=SHORT_S))


@pytest.fixture(scope="module")
def brief() -> Scene:
    """40 s straight, then 20 s of a turn: short enough for kernels that are not compiled."""
    return Scene(variant(duration_s=60.0))


@pytest.mark.laws
def test_ways_are_one_at_exactly_one_period(brief: Scene) -> None:
    measured = brief.simulate(0, 5)
    runs = {way: brief.filtered(measured, way) for way in ("optimal_prediction", "replay", "cloning")}
    by_prediction = runs["optimal_prediction"].position_error
    # linear in the same nominal trajectory: rounding of latitudes (1e-9 m) only
    np.testing.assert_allclose(runs["cloning"].position_error, by_prediction, rtol=0, atol=2e-8)
    # flown again from the corrected state: second order of a first correction of 100 m
    np.testing.assert_allclose(runs["replay"].position_error, by_prediction, rtol=0, atol=5e-3)
    np.testing.assert_allclose(runs["cloning"].P, runs["optimal_prediction"].P, rtol=0, atol=1e-6)  # m^2 of 1e4


def test_without_errors_nothing_goes_wrong() -> None:
    quiet = RdssNoise(0.0, 1e-6, 1e-6)
    scene = Scene(variant(duration_s=SHORT_S, errors=NONE, noise=quiet))
    measured = scene.simulate(0, 1)
    for way in ("free", "optimal_prediction", "replay", "cloning"):
        run = scene.filtered(measured, way)  # type: ignore[arg-type]
        assert np.abs(run.position_error).max() < 2e-3, way  # m: increments of 50 ms through rolling turns


@pytest.mark.laws
def test_transitions_are_those_of_the_navigator(brief: Scene) -> None:
    # small errors of the start carried on by the product of Phi, and by two navigators side by side
    T = len(brief.perfect.dt_s) // EVERY
    nav, Phi, Q = np.empty((T + 1, 10)), np.empty((T, N0, N0)), np.empty((T, N0, N0))
    linear_model(brief.perfect.gyro, brief.perfect.accel, brief.nav0(), brief.model(), nav, Phi, Q)
    total = np.eye(N0)
    for j in range(T):
        total = Phi[j] @ total
    fixes = brief.simulate(0, 1).fixes
    last = np.array([T * EVERY])
    at_end = fixes._replace(lat=fixes.lat[:1], lon=fixes.lon[:1], R=fixes.R[:1], valid=last, there=last)
    for start, dx in (
        ((np.array([1e-6, -2e-6, 3e-6]), np.zeros(2), np.zeros(2)), [1e-6, -2e-6, 3e-6, 0, 0, 0, 0]),
        ((np.zeros(3), np.array([0.01, -0.02]), np.zeros(2)), [0, 0, 0, -0.01, 0.02, 0, 0]),
        ((np.zeros(3), np.zeros(2), np.array([3.0, 5.0])), [0, 0, 0, 0, 0, -3.0, -5.0]),
    ):
        ends = []
        for nav0 in (brief.nav0(), brief.nav0(*start)):
            one = Measured(brief.perfect.gyro, brief.perfect.accel, nav0, at_end)
            run = Scene.filtered(brief, one, "free")
            ends.append(np.concatenate([run.velocity_error[0], run.position_error[0]]))
        expected = (total[:, :7] @ np.array(dx))[3:7]
        np.testing.assert_allclose(ends[0] - ends[1], expected, rtol=2e-3, atol=2e-4 * np.abs(expected).max())
    bias_g, bias_a = np.array([3e-6, -2e-6, 1e-6]), np.array([1e-4, -2e-4, 0.0])
    ends = []
    for on in (0.0, 1.0):
        readings = (brief.perfect.gyro + on * bias_g / RATE_HZ, brief.perfect.accel + on * bias_a / RATE_HZ)
        run = Scene.filtered(brief, Measured(*readings, brief.nav0(), at_end), "free")
        ends.append(np.concatenate([run.velocity_error[0], run.position_error[0]]))
    kept = np.eye(N0)  # biases without decay
    for j in range(T):
        step = Phi[j].copy()
        step[13:, 13:] = np.eye(2)
        kept = step @ kept
    expected = (kept[:, 7:10] @ bias_g + kept[:, 13:] @ bias_a[:2])[3:7]
    np.testing.assert_allclose(ends[0] - ends[1], expected, rtol=5e-3, atol=2e-3 * np.abs(expected).max())
    np.testing.assert_array_equal(Phi[:, :7, 10:13], Phi[:, :7, 7:10])
    decay = np.exp(-EVERY / RATE_HZ / SinsErrors().tau_s)
    np.testing.assert_allclose(Phi[:, range(10, N0), range(10, N0)], decay, rtol=1e-14)
    mind = new_mind(N0)
    mind.nav[:] = brief.nav0()
    mind.bias[:] = 1e-9
    track = np.zeros((T * EVERY + 1, 4))
    roll(mind, brief.perfect.gyro, brief.perfect.accel, 0, 100, brief.model(), np.eye(N0), track, False)
    np.testing.assert_allclose(mind.bias, 1e-9 * np.array([1.0] * 3 + [decay ** (100 / EVERY)] * 5), rtol=1e-12)


@pytest.mark.laws
@pytest.mark.parametrize("way", ["ignored", "optimal_prediction", "replay", "cloning"])
def test_the_response_to_a_delay_is_a_derivative(brief: Scene, way: Any) -> None:
    # fixes moved by what a further delay of 10 ms does: innovations and positions move by the signature
    measured = brief.simulate(0, 5)
    base = brief.filtered(measured, way)
    late = 0.01
    at = measured.fixes.there if way == "ignored" else measured.fixes.valid
    lat, _, h = brief.llh[at].T
    vel = brief.vel_n[at, :2] + (base.velocity_error if way == "ignored" else 0.0)  # the filter's, 2 m/s off if wrong
    moved = measured.fixes._replace(
        lat=measured.fixes.lat - late * vel[:, 0] / (6.3587e6 + h),
        lon=measured.fixes.lon - late * vel[:, 1] / ((6.3870e6 + h) * np.cos(lat)),
    )
    there = brief.filtered(replace(measured, fixes=moved), way)
    # m/s of 60: radii are rounded to 1e-3, velocities are those after the update
    np.testing.assert_allclose((there.v - base.v) / late, base.signature, rtol=0, atol=0.5)
    np.testing.assert_allclose((there.position_error - base.position_error) / late, base.effect, rtol=0, atol=0.5)
    assert np.abs(base.signature).max() > 10.0


def test_ignoring_the_delay_is_found_and_estimating_it_works(turning: Scene) -> None:
    measured = turning.simulate(3, 5)
    ignored = check_of(turning.filtered(measured, "ignored"))
    assert ignored.verdict == "wrong"
    assert abs(ignored.delay_s - 1.5) < 5.0 * ignored.sigma_s + 0.1  # s: the curve of the track within the delay
    assert check_of(turning.filtered(measured, "optimal_prediction")).verdict == "confirmed"
    tau, sigma = turning.filtered(measured, "estimated").tau[-1]
    assert sigma < 0.1
    assert abs(tau - 1.5) < 5.0 * sigma


def test_straight_flight_is_called_unverifiable() -> None:
    scene = Scene(variant(speed_mps=100.0, turns=False, duration_s=SHORT_S))
    for number in range(4):
        measured = scene.simulate(number, 5)
        ignored = scene.filtered(measured, "ignored")
        last = ignored.position_error[-60:].mean(axis=0)
        assert 120.0 < np.linalg.norm(last) < 180.0  # m: 1.5 s at 100 m/s, +- what 240 s of fixes leave
        assert check_of(ignored).verdict != "confirmed"
        assert check_of(scene.filtered(measured, "optimal_prediction")).verdict != "confirmed"
        assert scene.filtered(measured, "estimated").tau[-1, 1] > 0.5  # s: it knows that it does not know


def test_jitter_is_harmless_if_the_fix_tells_its_time() -> None:
    x = variant(speed_mps=250.0, jitter_s=0.1, duration_s=2.0 * SHORT_S)
    told, not_told = Scene(replace(x, known_jitter=True)), Scene(x)
    sizes = []
    for scene, way in ((told, "replay"), (told, "cloning"), (not_told, "optimal_prediction")):
        errors = [scene.filtered(scene.simulate(k, 6), way).position_error[160:] for k in range(6)]  # type: ignore[arg-type]
        sizes.append(float(np.sqrt((np.array(errors) ** 2).sum(axis=2).mean())))
    assert abs(sizes[0] - sizes[1]) < 0.01  # m: both exact
    assert sizes[2] > 1.1 * sizes[0]


def test_statistics_of_many_windows() -> None:
    counts = np.zeros(3)
    covered = []
    scene = Scene(EXPERIMENTS["dynamic"])
    for number in range(8):
        run = scene.filtered(scene.simulate(number, 77), "optimal_prediction")
        late = np.flatnonzero(run.t_s >= 390.0)
        row = window_counts(run, late)
        counts += [row["windows"], row["nis_passed"], row["white_passed"]]  # type: ignore[list-item]
        covered.append(coverage(run.position_error[late], run.P[late, 2:, 2:]))
    assert counts[0] == 8 * (780 // WINDOW)
    least = pass_region(int(counts[0]), 0.95, 0.9999)[0]
    assert counts[1] / counts[0] >= least
    assert counts[2] / counts[0] >= least
    assert np.mean(covered) == pytest.approx(0.95, abs=0.05)  # errors of a run are correlated over minutes


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    folder = tmp_path_factory.mktemp("rdss_sins")
    return reproduce_rdss_sins(folder, runs=2, seed=11, workers=1), folder


@pytest.mark.slow
def test_everything_is_reproduced(reproduced: tuple[dict[str, Any], Path]) -> None:
    result, folder = reproduced
    for name in ("static", "dynamic"):
        r = result[name]
        for key in (
            "nis_per_dof", "nis_low", "nis_high", "rho", "rho_bound", "consistent", "rms_position_m", "rms_velocity_mps"
        ):  # fmt: skip
            assert key in r
        assert len(r["rho"]) == LAGS
        assert r["nis_low"] < r["nis_per_dof"] < r["nis_high"]
        assert 5.0 < r["rms_position_m"] < 9.0  # m: 6.9 expected of two runs
        assert [row["method"] for row in r["delay_methods"]] == list(WAYS)
        assert r["free_rms_position_m"] > 500.0
        assert r["windows"] == 2 * 13
    methods = {row["method"]: row for row in result["delay_methods"]}
    assert methods["ignored"]["rms_position_m"] > 90.0  # m, of 60 m/s times 1.5 s
    assert not methods["ignored"]["consistent"]
    assert methods["optimal_prediction"]["consistent"]
    for row in result["equivalence"].values():
        assert row["linear_m"]["optimal_prediction"] < 1e-9
        assert row["linear_m"]["cloning"] < 1e-9
        assert row["navigator_m"]["optimal_prediction"] < 0.01
    assert result["paper"]["vector"]["outside"] == [1]
    assert not result["paper"]["scalar"]["white"]
    assert result["paper"]["nis_passed"]
    straight = next(r for r in result["blind_spot"] if r["method"] == "ignored")
    assert straight["rms_position_m"] == pytest.approx(150.0, rel=0.07)
    assert straight["delay_confirmed_rate"] == 0.0
    assert json.loads((folder / "reproduce.json").read_text()) == json.loads(json.dumps(result))
    text = (folder / "report.md").read_text()
    assert "not white" in text
    for file in ("static.csv", "dynamic.csv", "summary.csv", "runs.parquet"):
        assert (folder / file).stat().st_size > 0


@pytest.mark.slow
def test_the_command_prints_it(reproduced: tuple[dict[str, Any], Path], capsys: pytest.CaptureFixture[str]) -> None:
    result, folder = reproduced
    arguments = ["reproduce", "rdss_sins", "-o", str(folder), "--runs", "2", "--seed", "11", "--workers", "1"]
    assert cli.run([*arguments, "--json"]) == 0  # finished runs are taken from the folder
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(result))
    assert cli.run(arguments) == 0
    out = capsys.readouterr().out
    assert "optimal prediction" in out
    assert max(len(line) for line in out.splitlines() if "report" not in line) <= 80


def test_a_negative_seed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StarwiseError, match="not negative"):
        reproduce_rdss_sins(tmp_path, runs=1, seed=-1)
    assert (PERIOD, RATE_HZ, K) == (30, 20, 50)
