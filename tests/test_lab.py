"""The laboratory: laws of its tests, causes told apart, and what it says of runs and of plain tables."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from handmade import handmade_solution
from starwise.analysis.consistency import pass_region
from starwise.analysis.lab import Cause, Consistency
from starwise.analysis.lab.innovations import table
from starwise.analysis.lab.moments import holm, kurtosis_moments, sidak, truncated_moments
from starwise.analysis.lab.series import correlation_time, effective_share, series
from starwise.errors import StarwiseError
from starwise.studies.lab_worlds import CASES, FIX_CASES, CarWorld, FixWorld, Wrong, judge
from starwise.types import Truth

NS = 1_000_000_000


def white(n: int, channels: int, seed: int, scale: float = 1.0) -> dict[str, object]:
    """Columns of independent innovations: ``channels`` satellites, n epochs of 1 s."""
    rng = np.random.default_rng(seed)
    t = np.tile(np.arange(n) * NS, channels)
    s = rng.uniform(0.5, 4.0, n * channels)
    v = scale * np.sqrt(s) * rng.standard_normal(n * channels)
    return {"t_ns": t, "v": v, "s": s, "sv": np.repeat([f"G{k + 1:02d}" for k in range(channels)], n), "signal": "1C"}


def judged(columns: dict[str, object], **more: object) -> Consistency:
    return Consistency.from_innovations(**columns, **more)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def car() -> CarWorld:
    return CarWorld()


@pytest.mark.laws
@pytest.mark.parametrize(("gate", "degrees"), [(1, 1), (2, 2)])
def test_moments_inside_a_gate_are_those_of_samples(gate: int, degrees: int) -> None:
    rng = np.random.default_rng(5)
    z = rng.standard_normal((400_000, degrees))
    from scipy.special import chdtri

    inside = z[(z**2).sum(axis=1) <= chdtri(degrees, 0.05)][:, 0]
    two, four = truncated_moments(gate, 0.05)
    assert np.mean(inside**2) == pytest.approx(two, abs=0.006)  # five standard errors of 400 000 samples
    assert np.mean(inside**4) == pytest.approx(four, abs=0.03)
    kurtosis, _ = kurtosis_moments(gate, 0.05)
    assert np.mean(inside**4) / np.mean(inside**2) ** 2 == pytest.approx(kurtosis, abs=0.03)


def test_several_tests_together() -> None:
    assert float(sidak(0.01, 5)) == pytest.approx(1.0 - 0.99**5, abs=1e-12)
    assert float(sidak(1e-20, 5)) == pytest.approx(5e-20, rel=1e-9)
    adjusted = holm(np.array([0.04, np.nan, 0.001, 0.5]))
    assert adjusted[2] == pytest.approx(1.0 - 0.999**3)
    assert adjusted[0] == pytest.approx(1.0 - 0.96**2)
    assert np.isnan(adjusted[1])


@pytest.mark.laws
def test_autocorrelation_of_a_markov_error_beside_noise() -> None:
    rng = np.random.default_rng(3)
    n, tau, keep = 40_000, 30.0, math.exp(-1.0 / 30.0)
    lasting = np.zeros(n)
    drive = math.sqrt(1.0 - keep * keep) * rng.standard_normal(n)
    for k in range(1, n):
        lasting[k] = keep * lasting[k - 1] + drive[k]
    made = table(np.arange(n) * NS, lasting + rng.standard_normal(n), np.full(n, 2.0), sv="G01")
    stats = series(made)
    assert stats.rho[0, 0] == pytest.approx(0.5 * keep, abs=0.03)
    assert correlation_time(stats.rho[0], stats.pairs[0], stats.lags, 1.0) == pytest.approx(tau, rel=0.25)
    # 1 + 2 sum rho = 1 + 2 * 0.5 / (1 / keep - 1); its estimate from 1300 correlation times is good to a fifth
    assert effective_share(stats.rho[0], stats.lags) == pytest.approx(1.0 / (1.0 + 1.0 / (1.0 / keep - 1.0)), rel=0.3)


@pytest.mark.laws
def test_gaps_do_not_make_a_series_correlated() -> None:
    columns = white(4000, 1, 11)
    keep = np.random.default_rng(1).random(4000) < 0.4
    made = judged({k: v[keep] if isinstance(v, np.ndarray) else v for k, v in columns.items()})
    assert made.passed
    assert made.stats is not None
    assert made.stats.pairs[0, 0] == pytest.approx(0.16 * 4000, rel=0.1)


@pytest.mark.laws
def test_a_right_filter_passes_as_often_as_promised(car: CarWorld) -> None:
    # The full law, 2000 runs, is benchmarks/lab_laws.py; 40 runs are wrong by chance, 1e-3, outside this region.
    row = judge(car.run, CASES[0], range(40))
    low, high = pass_region(40)
    assert low <= row.named <= high
    assert row.detected == pytest.approx(1.0 - row.named)


@pytest.mark.laws
@pytest.mark.parametrize("wrong", CASES[1:], ids=lambda wrong: wrong.name)
def test_what_is_wrong_is_found_and_named(car: CarWorld, wrong: Wrong) -> None:
    row = judge(lambda number: car.run(number, wrong), wrong, range(6))
    assert row.detected == 1.0
    assert row.named >= 4.5 / 6.0, row.names  # 80 % of many; by chance below in one of sixty if it were just that


@pytest.mark.laws
@pytest.mark.parametrize("wrong", FIX_CASES[1:], ids=lambda wrong: wrong.name)
def test_fixes_judged_by_v_and_s_alone(wrong: Wrong) -> None:
    world = FixWorld()
    row = judge(lambda number: world.run(number, wrong, noise_known=False), wrong, range(3))
    assert (row.detected, row.named) == (1.0, 1.0), row.names


def test_size_of_what_is_wrong(car: CarWorld) -> None:
    made = car.run(7, Wrong("", code_var=2.0))
    assert made.findings[0].where == "code"
    assert made.findings[0].size == pytest.approx(2.0, rel=0.1)  # true over assumed variance; 5000 rows
    assert "too small" in made.verdict
    biased = car.run(7, Wrong("", bias_m=2.0)).findings[0]
    assert 1.2 < biased.size < 2.1  # m of 2; the position takes a part of it
    late = FixWorld().run(7, Wrong("", delay_s=0.5)).findings[0]
    assert 0.2 < late.size < 0.8  # s: what the filter has not taken for its own


def test_one_signal_of_several_is_named() -> None:
    rng = np.random.default_rng(2)
    good, bad = white(400, 8, 21), white(400, 8, 22, scale=2.0)
    made = judged(
        {
            "t_ns": np.concatenate([good["t_ns"], good["t_ns"], bad["t_ns"]]),
            "v": np.concatenate([good["v"], rng.permutation(good["v"]) * 0 + white(400, 8, 23)["v"], bad["v"]]),
            "s": np.concatenate([good["s"], white(400, 8, 23)["s"], bad["s"]]),
            "sv": np.concatenate([good["sv"], good["sv"], np.char.replace(bad["sv"], "G", "E")]),
            "signal": np.repeat(["1C", "2W", "5Q"], 3200),
        }
    )
    assert made.findings[0].cause is Cause.R_TOO_SMALL
    assert made.findings[0].where.startswith("E")
    assert made.findings[0].size == pytest.approx(4.0, rel=0.1)
    row = next(r for r in made.by_system if r["name"] == "G code")
    assert row["nis"] == pytest.approx(1.0, abs=0.06)


def test_calibration_curve_and_windows() -> None:
    made = judged(white(2000, 5, 4))
    np.testing.assert_allclose(made.calibration["code"], made.calibration["nominal"], atol=0.02)
    windows = made.nis_window
    assert windows is not None
    assert windows.dof.sum() == 10_000
    inside = (windows.per_dof >= windows.low) & (windows.per_dof <= windows.high)
    assert inside.mean() > 0.85  # 50 windows at 95 %: fewer than 43 in one of a thousand
    assert made.nis_epoch is not None
    assert len(made.nis_epoch.per_dof) == 2000


def test_report_is_plain_and_narrow(car: CarWorld) -> None:
    made = car.run(3, CASES[1])
    text = json.dumps(made.to_dict(), allow_nan=False)
    assert '"verdict"' in text
    assert all(len(line) <= 79 for line in made.explain().splitlines())
    assert {"sensors", "satellites", "signals", "systems", "channels", "findings", "calibration"} <= set(made.to_dict())


def test_solutions_without_innovations() -> None:
    solution = replace(handmade_solution(), ledger={}, nis=np.full(handmade_solution().n_epochs, np.nan))
    made = Consistency.of(solution)
    assert made.grade in ("unknown", "inconsistent")
    assert any("no ledger" in text for text in made.not_judged)
    json.dumps(made.to_dict(), allow_nan=False)


def test_positions_against_the_truth() -> None:
    rng = np.random.default_rng(9)
    n = 500
    base = handmade_solution()
    home = np.array([4_000_000.0, 600_000.0, 4_900_000.0])
    for scale, cause in ((1.0, None), (3.0, Cause.OVERCONFIDENT), (0.3, Cause.MODEST)):
        solution = replace(
            base, t_ns=np.arange(n) * NS, status=np.zeros(n, dtype=np.uint8),
            pos_e=home + scale * rng.standard_normal((n, 3)), vel_e=np.zeros((n, 3)),
            cov_pos=np.tile(np.eye(3), (n, 1, 1)), cov_vel=np.tile(np.eye(3), (n, 1, 1)), clock_m=np.empty((n, 0)),
            drift_mps=np.empty((n, 0)), clock_sigma_m=np.empty((n, 0)), clock_names=(), nis=np.full(n, np.nan),
            dof=np.zeros(n, dtype=np.int32), n_used=np.zeros(n, dtype=np.int32), dop=np.full((n, 4), np.nan), ledger={},
            extra={},
        )  # fmt: skip
        made = Consistency.of(solution, Truth(home))
        assert made.positions is not None
        assert made.positions.nees == pytest.approx(scale**2, rel=0.15)
        assert [f.cause for f in made.findings] == ([] if cause is None else [cause])
        assert made.positions.independent > 400


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"s": np.array([1.0, -1.0])}, "variance is negative"),
        ({"s": np.array([1.0])}, "another length"),
        ({"kind": "smell"}, "not a sensor"),
        ({"sv": ["G01"]}, "another length"),
    ],
)
def test_tables_that_do_not_fit(change: dict[str, object], said: str) -> None:
    columns: dict[str, object] = {"t_ns": np.array([0, NS]), "v": np.zeros(2), "s": np.ones(2), **change}
    with pytest.raises(StarwiseError, match=said):
        judged(columns)


@pytest.mark.parametrize("n", [0, 1, 2, 5])
def test_hardly_any_rows(n: int) -> None:
    made = judged({"t_ns": np.arange(n) * NS, "v": np.ones(n), "s": np.ones(n), "sv": "G01"})
    assert made.grade in ("unknown", "consistent")
    json.dumps(made.to_dict(), allow_nan=False)
    made.explain()


def test_rows_that_are_not_numbers_are_left_out() -> None:
    columns = white(300, 3, 8)
    columns["v"][::7] = np.nan  # type: ignore[index]
    columns["s"][::11] = np.inf  # type: ignore[index]
    made = judged(columns)
    assert made.table is not None
    assert made.table.n < 900
    assert made.passed


@pytest.mark.laws
def test_errors_of_half_an_hour_at_1_hz_are_few_independent_ones() -> None:
    n, keep, home = 20_000, math.exp(-1.0 / 1800.0), np.array([4_000_000.0, 600_000.0, 4_900_000.0])
    base, counts = handmade_solution(), []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        drive = math.sqrt(1.0 - keep * keep) * rng.standard_normal((n, 3))
        drive[0] = rng.standard_normal(3)
        # x_k = keep x_{k-1} + drive_k, in blocks so that powers of keep stay numbers
        error, last, power = np.empty((n, 3)), np.zeros(3), keep ** np.arange(1, 501)[:, None]
        for k in range(0, n, 500):
            error[k : k + 500] = power * (last + np.cumsum(drive[k : k + 500] / power, axis=0))
            last = error[k + 499]
        solution = replace(
            base, t_ns=np.arange(n) * NS, status=np.zeros(n, dtype=np.uint8), pos_e=home + error,
            vel_e=np.zeros((n, 3)), cov_pos=np.tile(np.eye(3), (n, 1, 1)), cov_vel=np.tile(np.eye(3), (n, 1, 1)),
            clock_m=np.empty((n, 0)), drift_mps=np.empty((n, 0)), clock_sigma_m=np.empty((n, 0)), clock_names=(),
            nis=np.full(n, np.nan), dof=np.zeros(n, dtype=np.int32), n_used=np.zeros(n, dtype=np.int32),
            dop=np.full((n, 4), np.nan), ledger={}, extra={},
        )  # fmt: skip
        positions = Consistency.of(solution, Truth(home)).positions
        assert positions is not None
        counts.append(positions.independent)
    # Squares of a Markov process: n / tau = 11 independent ones; to the longest lag of innovations it were 26.
    assert 8.0 < np.median(counts) < 16.0


def test_ledger_without_variances_of_innovations() -> None:
    made = Consistency.of(handmade_solution())
    assert "innovation_m" in handmade_solution().ledger  # but nothing says how large they should be
    assert made.stats is None
    assert any("single innovations" in text for text in made.not_judged)
    nothing = replace(handmade_solution(), nis=np.full(40, np.nan))
    assert any("no ledger of them" in text for text in Consistency.of(nothing).not_judged)


def test_what_all_channels_share_is_not_called_their_own() -> None:
    columns = white(600, 8, 3)
    columns["v"] = columns["v"] + 1.5  # type: ignore[operator]
    first = judged(columns).findings[0]
    assert (first.cause, first.where) == (Cause.BIAS, "code")
    assert first.size == pytest.approx(1.5, abs=0.1)  # m; standard error 0.05 of a channel's mean
    columns = white(600, 8, 3)
    columns["v"] = columns["v"] + np.repeat(np.linspace(-3.0, 3.0, 8), 600)  # type: ignore[operator]
    assert judged(columns).findings[0].cause is Cause.CORRELATED


def test_errors_that_last_are_not_called_small_too() -> None:
    """Rows far within their sigmas, whose errors last so long that their sum is not."""
    n, channels, keep = 3000, 8, math.exp(-1.0 / 100.0)
    rng, lasting = np.random.default_rng(4), np.zeros((3000, 8))
    lasting[0] = rng.standard_normal(channels)
    for k in range(1, n):
        lasting[k] = keep * lasting[k - 1] + math.sqrt(1.0 - keep * keep) * rng.standard_normal(channels)
    made = judged(
        {
            "t_ns": np.tile(np.arange(n) * NS, channels), "v": lasting.T.ravel(), "s": np.full(n * channels, 4.0),
            "sv": np.repeat([f"G{k + 1:02d}" for k in range(channels)], n), "signal": "1C",
        }
    )  # fmt: skip
    matter = {f.cause for f in made.findings if f.matters}
    assert Cause.CORRELATED in matter
    assert Cause.R_TOO_LARGE not in matter


def test_correlation_of_all_pairs_is_one() -> None:
    rng = np.random.default_rng(6)
    n, channels = 500, 6
    shared = np.repeat(rng.standard_normal(n)[:, None], channels, axis=1)
    v = 0.1 * (shared + rng.standard_normal((n, channels)))  # claimed ten times too large: still a correlation of 0.5
    made = judged(
        {
            "t_ns": np.tile(np.arange(n) * NS, channels), "v": v.T.ravel(), "s": np.ones(n * channels),
            "sv": np.repeat([f"G{k + 1:02d}" for k in range(channels)], n), "signal": "1C",
        }
    )  # fmt: skip
    cross = next(f for f in made.families if f.name == "cross")
    assert next(c for c in cross.tests if "all pairs" in c.what).statistic == pytest.approx(0.5, abs=0.07)


def test_too_few_rows_are_named() -> None:
    made = judged({"t_ns": np.arange(5) * NS, "v": 100.0 * np.ones(5), "s": np.ones(5), "sv": "G01"})
    assert made.grade == "unknown"
    assert "fewer than 10" in made.explain()


def test_small_innovations_do_not_outshine_the_truth() -> None:
    """Innovations far too small, positions 1.6 sigmas off for the whole run: not cautious, whatever can be proved."""
    n, home = 600, np.array([4_000_000.0, 600_000.0, 4_900_000.0])
    columns = white(n, 6, 5, scale=0.3)
    solution = replace(
        handmade_solution(), t_ns=np.arange(n) * NS, status=np.zeros(n, dtype=np.uint8), ledger={}, extra={},
        pos_e=home + 1.6 * np.ones((n, 3)) + 0.01 * np.random.default_rng(1).standard_normal((n, 3)),
        vel_e=np.zeros((n, 3)), cov_pos=np.tile(np.eye(3), (n, 1, 1)), cov_vel=np.tile(np.eye(3), (n, 1, 1)),
        clock_m=np.empty((n, 0)), drift_mps=np.empty((n, 0)), clock_sigma_m=np.empty((n, 0)), clock_names=(),
        nis=np.full(n, np.nan), dof=np.zeros(n, dtype=np.int32), n_used=np.zeros(n, dtype=np.int32),
        dop=np.full((n, 4), np.nan),
    )  # fmt: skip
    made = judged(columns, solution=solution, truth=Truth(home))
    assert made.positions is not None
    assert made.positions.nees == pytest.approx(1.6**2, rel=0.01)
    assert made.verdict.startswith("cautious by its innovations alone, position errors are 1.6 times")
    assert judged(columns).verdict.startswith("cautious: R of code")


@pytest.mark.laws
@pytest.mark.parametrize(
    "wrong",
    [
        Wrong("Q 16 x too small", (Cause.Q_TOO_SMALL,), process=16.0),
        Wrong("R of codes 20 x too small", (Cause.R_TOO_SMALL,), code_var=20.0),
        Wrong("a satellite biased by 5 m", (Cause.BIAS,), bias_m=5.0),
        Wrong("a satellite biased by 50 m, that the gate refuses throughout", (Cause.BIAS,), bias_m=50.0),
        Wrong("a satellite biased by 2 m, R of codes 2 x too large", (Cause.BIAS,), code_var=0.5, bias_m=2.0),
    ],
    ids=lambda wrong: wrong.name,
)
def test_large_errors_are_named_as_small_ones(car: CarWorld, wrong: Wrong) -> None:
    """The gate refuses rows by the dozen then: no tails, and no robust weights to be asked for."""
    row = judge(lambda number: car.run(300 + number, wrong), wrong, range(6))
    assert row.detected == 1.0
    assert row.named >= 4.5 / 6.0, row.names
    if wrong.bias_m > 0.0:  # the satellite that has it, not those that got a part of it with the position
        sizes = [car.run(300 + number, wrong).findings[0].size for number in range(6)]
        assert np.mean(np.array(sizes) > 0.5 * wrong.bias_m) >= 4.5 / 6.0, sizes


def test_a_refused_satellite_is_named_with_its_size(car: CarWorld) -> None:
    first = car.run(7, Wrong("", bias_m=20.0)).findings[0]
    assert first.cause is Cause.BIAS
    assert first.size == pytest.approx(20.0, abs=1.0)  # m; noise of 300 rows, and what the position took at first
    assert "outside the gate" in first.words


def test_a_delay_of_a_millisecond_does_not_matter(car: CarWorld) -> None:
    made = car.run(501, Wrong("", process=100.0))
    assert all(not f.matters for f in made.findings if f.cause is Cause.DELAY)
    assert any(f.matters for f in car.run(501, Wrong("", delay_s=0.2)).findings if f.cause is Cause.DELAY)


def test_lasting_errors_do_not_matter_to_fits_of_single_epochs() -> None:
    """Of residuals nobody may conclude that a covariance of one epoch is too small because errors last."""
    columns = white(600, 8, 3)
    columns["v"] = columns["v"] + np.repeat(np.linspace(-3.0, 3.0, 8), 600)  # type: ignore[operator]
    fits = judged(columns, residuals=True)
    lasting = [f for f in fits.findings if f.cause is Cause.CORRELATED]
    assert lasting
    assert not any(f.matters for f in lasting)
    assert "residuals of a fit" in fits.explain()
    assert any(f.matters for f in judged(columns).findings if f.cause is Cause.CORRELATED)
    columns["kind"] = "phase"  # residuals of phases are a filter's
    assert any(f.matters for f in judged(columns, residuals=True).findings if f.cause is Cause.CORRELATED)
