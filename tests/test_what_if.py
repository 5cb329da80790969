"""What-if: added measurements never make a sigma larger, removed ones never smaller; what is asked is understood."""

import math
from pathlib import Path

import numpy as np
import pytest

import starwise
import starwise.demo
from starwise.analysis.run_system import RunSystem
from starwise.analysis.what_if import WhatIf
from starwise.analysis.what_if_change import Change, with_sensor
from starwise.api_assess import sky_of
from starwise.errors import StarwiseError
from starwise.types import Solution

DATA = Path(starwise.demo.__file__).parent / "data"
FILES = (DATA / "demo_MO.rnx.gz", DATA / "demo_MN.rnx.gz")
ROUNDING = 1.0 + 1e-9


@pytest.fixture(scope="module")
def gps() -> Solution:
    return starwise.solve(*FILES, dynamics="vehicle", systems="G", report=False)


@pytest.fixture(scope="module")
def everything() -> Solution:
    return starwise.solve(*FILES, dynamics="vehicle", report=False)


@pytest.mark.laws
@pytest.mark.parametrize("change", ["altimeter", "imu_acceleration", "second_antenna", "doppler"])
def test_what_is_added_never_harms(gps: Solution, change: str) -> None:
    found = WhatIf.of(gps, change, windows=2, epochs=8)
    (outcome,) = found.outcomes
    assert outcome.rows >= found.base.rows
    assert set(outcome.sigma) == set(found.base.sigma)
    assert all(outcome.sigma[key] <= found.base.sigma[key] * ROUNDING for key in outcome.sigma)


@pytest.mark.laws
@pytest.mark.parametrize("change", ["-doppler", "-constellation=C"])
def test_what_is_taken_away_never_helps(everything: Solution, change: str) -> None:
    found = WhatIf.of(everything, change, windows=2, epochs=8)
    (outcome,) = found.outcomes
    assert outcome.rows < found.base.rows
    for key in ("east", "north", "up", "velocity"):
        assert outcome.sigma[key] >= found.base.sigma[key] / ROUNDING


def test_each_sensor_helps_what_it_measures(gps: Solution) -> None:
    found = WhatIf.of(gps, "altimeter=0.5,imu_acceleration,second_antenna", windows=2, epochs=10)
    by_name = {o.name: o for o in found.outcomes}
    base = found.base.sigma
    assert by_name["altimeter=0.5"].sigma["up"] < min(base["up"], 0.8)  # 0.5 m slow and 0.5 m white
    assert by_name["imu_acceleration"].sigma["acceleration"] < 0.2 * base["acceleration"]
    assert found.gained(by_name["second_antenna"]) == (["head"], [])
    # 10 mm over 1 m, one look at least: 0.01 rad
    assert by_name["second_antenna"].sigma["heading"] < math.atan(0.0101)
    together = found.outcomes[-1]
    assert all(together.sigma[k] <= min(o.sigma[k] for o in found.outcomes) * ROUNDING for k in base)
    text = found.explain()
    assert "makes head observable" in " ".join(text.split())
    assert all(len(line) <= 79 for line in text.splitlines())
    assert "position sigma -" in found.verdict


def test_constellation_that_the_run_did_not_use(gps: Solution, everything: Solution) -> None:
    """Added out of the navigation files it brings what it brings where it was used; without them it is refused."""
    sky = sky_of(gps)
    assert sky is not None
    found = WhatIf.of(gps, "constellation=E", sky=sky, windows=2, epochs=8)
    (outcome,) = found.outcomes
    assert outcome.note.endswith("out of the navigation files")
    both = starwise.solve(*FILES, dynamics="vehicle", systems="GE", report=False)
    real = WhatIf.of(both, "-doppler", windows=2, epochs=8).base
    # 15 %: C/N0 is taken as 45 dB-Hz, satellites that were not tracked count, the scale of code noise is the run's own
    for key in ("east", "north", "up"):
        assert outcome.sigma[key] == pytest.approx(real.sigma[key], rel=0.15)
        assert outcome.sigma[key] < found.base.sigma[key]
    with pytest.raises(StarwiseError, match="nothing is known of where satellites of E"):
        WhatIf.of(gps, "constellation=E", windows=1, epochs=2)
    used = WhatIf.of(everything, "constellation=E", windows=1, epochs=2)
    assert used.outcomes[0].sigma == used.base.sigma
    assert "used already" in used.explain()


def test_change_of_a_model_that_has_no_use_for_it() -> None:
    still = starwise.solve(*FILES, dynamics="static", error_model="white", report=False)
    found = WhatIf.of(still, "imu_acceleration", windows=1, epochs=4)
    assert "no acceleration to measure" in found.explain()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not a measurement"),
        ("barometer", "not a measurement"),
        ("constellation", "which constellation"),
        ("constellation=GE", "which constellation"),
        ("altimeter=-1", "takes a positive number"),
        ("altimeter=nan", "takes a positive number"),
        ("doppler=3", "takes no number"),
        ("-altimeter", "no such measurement to take away"),
        ("-constellation=C", "no satellite of C to take away"),
    ],
)
def test_what_cannot_be_asked(gps: Solution, text: str, said: str) -> None:
    with pytest.raises(StarwiseError, match=said):
        WhatIf.of(gps, text)


@pytest.mark.parametrize("text", ["altimeter", "-doppler", "constellation=E", "altimeter=2.5", "imu_acceleration"])
def test_changes_are_written_as_they_are_read(text: str) -> None:
    assert Change.parse(f" {text} ").text == text


@pytest.mark.laws
def test_a_sensor_without_lasting_error_is_a_row_more(gps: Solution) -> None:
    window = RunSystem.of(gps).window(5, 3)
    row = np.zeros((1, window.n))
    row[0, 2] = 1.0
    wider = with_sensor(window, row, 2.0, 0.0, 1.0, "x")
    assert wider.error_names == window.error_names
    for a, b in zip(window.steps, wider.steps, strict=True):
        assert len(b.r) == len(a.r) + 1
        assert b.r[-1] == 4.0
