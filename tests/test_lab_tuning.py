"""Suggested configurations: what the likelihood finds, and what it must not be believed."""

import tomllib
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from handmade import handmade_solution
from starwise.analysis.lab import Cause, Consistency, Finding
from starwise.analysis.lab.tuning import Parameter, by_moments, independent_rows, log_likelihood, maximise
from starwise.config import RunConfig
from starwise.constants import ROW_GATED, ROW_USED
from starwise.errors import StarwiseError
from starwise.signals import signal_id, sv_id
from starwise.types import Solution

N, SATELLITES = 600, 8
EDGE = 10.8276  # chi-square, one degree of freedom, chance 1e-3: the gate
NS = 1_000_000_000


def world(rate_mps: float, code_m: float = 0.4) -> Callable[[RunConfig], Solution]:
    """A filter whose states are known: innovations are the noise, and S is what the configuration says of it."""
    rng = np.random.default_rng(4)
    v_code, v_rate = code_m * rng.standard_normal(N * SATELLITES), rate_mps * rng.standard_normal(N * SATELLITES)
    base = handmade_solution(N)

    def rerun(config: RunConfig) -> Solution:
        ones = np.ones(N * SATELLITES)
        code = v_code**2 <= EDGE * config.noise.code_m**2
        rate = v_rate**2 <= EDGE * config.noise.rate_mps**2
        ledger = {
            "t_ns": np.repeat(base.t_ns, SATELLITES),
            "sv": np.tile(np.array([sv_id(f"G{k:02d}") for k in range(1, SATELLITES + 1)], dtype=np.int16), N),
            "sig": np.full(N * SATELLITES, signal_id("1C"), dtype=np.int16),
            "status": np.where(code, ROW_USED, ROW_GATED).astype(np.uint8),
            "rate_used": rate,
            "elevation_rad": 0.7 * ones,
            "azimuth_rad": ones,
            "innovation_m": v_code,
            "innovation_var_m2": config.noise.code_m**2 * ones,
            "rate_innovation_mps": v_rate,
            "rate_innovation_var_m2ps2": config.noise.rate_mps**2 * ones,
        }
        dof = (code.reshape(N, -1).sum(axis=1) + rate.reshape(N, -1).sum(axis=1)).astype(np.int32)
        return replace(base, ledger=ledger, dof=dof, provenance={"config": config.to_dict()})

    return rerun


WHITE = RunConfig(error_model="white", dynamics="static")


@pytest.mark.laws
def test_likelihood_is_that_of_independent_normals() -> None:
    made = Consistency.of(world(0.1)(WHITE))
    assert made.table is not None
    value, rows = log_likelihood(made.table)
    assert rows == 2 * N * SATELLITES
    z2, s = made.table.z**2, made.table.s
    assert value == pytest.approx(-0.5 * float((z2 + np.log(s)).sum()), abs=5.0)  # 10 of 10 000 beyond 10.83 cost less
    assert independent_rows(made.table) == 2 * SATELLITES  # ten minutes: one lasting error each


@pytest.mark.laws
def test_noise_that_is_larger_than_assumed_is_found() -> None:
    noise = [Parameter("Doppler noise", {"noise.rate_mps": 0.1}, 2.0)]
    found = maximise(world(0.4), WHITE, parameters=noise, rounds=3)
    # 16 rows that count against a prior of factor 2 about 0.1: between the two, and nearer to 0.4 than to 0.1
    assert 0.2 <= found.settings["noise.rate_mps"] <= 0.42
    assert found.gain > 0.0


@pytest.mark.laws
def test_small_innovations_do_not_prove_small_errors() -> None:
    found = maximise(world(0.005), WHITE, rounds=1)
    assert found.settings["noise.rate_mps"] == pytest.approx(0.1)
    mistuned = WHITE.with_options({"noise.rate_mps": 1.0})
    assert maximise(world(0.005), mistuned, rounds=1).settings["noise.rate_mps"] == pytest.approx(0.1)


def test_suggestion_is_a_configuration(tmp_path: object) -> None:
    found = maximise(world(0.1), WHITE, rounds=1)
    options = tomllib.loads(found.to_toml())
    assert RunConfig.from_dict(options).noise.rate_mps == found.settings["noise.rate_mps"]
    assert found.to_dict()["evaluations"] == found.evaluations > 3


def test_lasting_errors_ask_for_the_coloured_model() -> None:
    rng = np.random.default_rng(8)
    solution = world(0.1)(WHITE)
    means = np.tile(0.4 * rng.standard_normal(SATELLITES), N)
    lasting = replace(solution, ledger={**solution.ledger, "innovation_m": solution.ledger["innovation_m"] + means})
    made = Consistency.of(lasting)
    assert made.findings[0].cause is Cause.CORRELATED
    assert made.tuning is not None
    assert made.tuning.settings == {"error_model": "colored"}


def test_moments_scale_what_is_wrong() -> None:
    made = Consistency.of(world(0.15)(WHITE))
    assert made.tuning is not None
    # rows of a pair are gated together, which is reckoned as one by one: 6 %
    assert made.tuning.settings["noise.rate_mps"] == pytest.approx(0.15, rel=0.1)
    assert Consistency.of(world(0.01)(WHITE)).tuning is None
    assert by_moments([], WHITE) is None
    odd = Finding(Cause.R_TOO_SMALL, "E 5Q code", 4.0, "", 0.0, 10.0, True, "", "")
    assert by_moments([odd], WHITE) is None  # no key for a single signal


def test_nothing_to_tune() -> None:
    with pytest.raises(StarwiseError, match="no innovations"):
        maximise(lambda config: replace(world(0.1)(config), ledger={}, nis=np.full(N, np.nan)), WHITE)
    made = Consistency.from_innovations(np.arange(50) * NS, np.zeros(50), np.ones(50))
    with pytest.raises(StarwiseError, match="how it was made"):
        made.tuned(world(0.1))


@pytest.mark.laws
def test_bounds_by_simulation_agree_with_formulas() -> None:
    made = Consistency.of(world(0.1)(WHITE))
    found = made.bounds(40, seed=1)
    assert found is not None
    row = found.sensors["rate"]
    assert row["nis"]["low"] < row["nis"]["seen"] < row["nis"]["high"]
    # 4800 rows: 1 +- 1.96 sqrt(2 / 4800); quantiles of 40 runs are good to a third of that
    assert row["nis"]["high"] - 1.0 == pytest.approx(0.04, abs=0.016)
    assert row["rho_1"]["high"] == pytest.approx(0.028, abs=0.012)
    assert found.false_alarm <= 0.2  # of 40; 5 % expected
