"""Constellations named by one filter with tied clocks, on real measurements with faults put into them."""

import sys
from pathlib import Path

import numpy as np
import pytest

from starwise.config import RunConfig
from starwise.errors import StarwiseError
from starwise.estimators.federated_faults import CLOCK_DRIFT, CLOCK_JUMP
from starwise.estimators.run import solve_run

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
import federated_real
from federated_real import Case, fault

TIED = {"method": "s3ekf", "clock": {"isolate": True}}


@pytest.fixture(scope="module")
def quarter(shared_data: Path) -> Case:
    return federated_real.load("tlse_2024 15 min", **TIED)


@pytest.fixture(scope="module")
def hour(shared_data: Path) -> Case:
    return federated_real.load("tlse_2024 1 h", **TIED)


def satellites(case: Case, constellation: str) -> list[int]:
    prepared = case.prepared()
    clock = prepared.clock_names.index(constellation)
    return [int(sv) for sv in np.unique(prepared.sightings.sv[prepared.rows.clock == clock])]


@pytest.mark.real
@pytest.mark.parametrize("constellation", ["G", "R", "E", "C"])
@pytest.mark.parametrize("doppler", [False, True])
def test_a_ramp_common_to_a_constellation_is_named(quarter: Case, constellation: str, doppler: bool) -> None:
    """50 m/min: named within 10 s, as a drift, nobody else, and the position stays within 4 m."""
    out = fault(quarter, satellites(quarter, constellation), rate_mps=federated_real.RAMP_MPS, doppler=doppler)
    clocks = [event for event in out["events"] if event.satellite is None]
    assert {event.constellation for event in out["events"]} == {constellation}
    assert clocks[0].cause == CLOCK_DRIFT
    assert (clocks[0].t_ns - out["t0_ns"]) * 1e-9 <= 10.0
    assert out["peak_m"] < 4.0


@pytest.mark.real
def test_the_best_constellation_does_not_take_the_clock_along(hour: Case) -> None:
    """Epochs 30 s apart: the common clock is not known to 3 m, and the first satellites would decide on it."""
    for how, cause in (({"rate_mps": federated_real.RAMP_MPS}, CLOCK_DRIFT), ({"step_m": 300.0}, CLOCK_JUMP)):
        out = fault(hour, satellites(hour, "E"), **how)
        assert {event.constellation for event in out["events"]} == {"E"}
        assert next(event.cause for event in out["events"] if event.satellite is None) == cause
        assert out["peak_m"] < 2.0


@pytest.mark.real
def test_nothing_is_named_without_a_fault_and_of_two_nobody(hour: Case, shared_data: Path) -> None:
    solution = solve_run(hour.obs, hour.ephemeris, hour.ionosphere, hour.config)
    assert solution.provenance["events"] == []
    two = federated_real.load("tlse_2024 1 h", systems="GE", **TIED)
    out = fault(two, satellites(two, "E"), rate_mps=federated_real.RAMP_MPS)
    assert all(event.satellite is not None for event in out["events"])


def test_where_it_makes_no_sense() -> None:
    for options in ({"method": "federated"}, {"method": "lsq"}, {"error_model": "white"}):
        with pytest.raises(StarwiseError, match="isolate"):
            RunConfig.from_dict({**options, "clock": {"isolate": True}})
