"""From observations and an ephemeris to rows: units, claims of accuracy, notes, and configuration that is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import starwise
import starwise.demo
from starwise.analysis.accuracy import assess
from starwise.config import RunConfig, load_config
from starwise.constants import SYS_E, SYS_G, SYS_R
from starwise.errors import StarwiseError
from starwise.estimators.run import solve_run
from starwise.gnsstime import parse_time
from starwise.io.rinex_nav import read_nav
from starwise.io.rinex_obs import read_obs
from starwise.models.process import motion_from
from starwise.models.pseudorange import EPHEMERIS_SIGMA_M, _ephemeris_sigma, _is_dbhz
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.types import Observations, Truth

DATA = Path(starwise.demo.__file__).parent / "data"


@pytest.mark.parametrize(
    ("unit", "values", "is_dbhz"),
    [
        ("DBHZ", [45.0, 30.0], True),
        ("", [45.0, 30.0, 25.0], True),
        ("", [7.0, 8.0, 9.0], False),  # RINEX 2 receivers with their own numbers
        ("", [110.0, 250.0], False),
        ("AMPLITUDE", [45.0], False),
        ("", [], True),
        ("dB-Hz", [40.0], True),
    ],
)
def test_unit_of_signal_strength(unit: str, values: list[float], is_dbhz: bool) -> None:
    assert _is_dbhz(unit, np.array(values)) is is_dbhz


def test_claims_of_accuracy() -> None:
    system = np.array([SYS_G, SYS_G, SYS_G, SYS_E, SYS_R, SYS_G])
    claim = np.array([2.0, 4.85, np.nan, 3.12, 5.0, 0.5])
    sigma = _ephemeris_sigma(claim, system)
    real = EPHEMERIS_SIGMA_M
    assert sigma[0] == sigma[2] == real[SYS_G]
    assert sigma[1] == pytest.approx(np.sqrt(real[SYS_G] ** 2 + 4.85**2 - 2.5**2))
    assert sigma[3] == real[SYS_E]
    assert sigma[4] == real[SYS_R]
    assert sigma[5] == 0.5
    steps = _ephemeris_sigma(np.linspace(2.0, 6.0, 400), np.zeros(400, dtype=int))
    assert np.abs(np.diff(steps)).max() < 0.25  # m: it grows without a jump


@pytest.mark.parametrize(
    "options",
    [
        {"process.jerk_psd_m2_per_s5": 1.0},
        {"dynamics": "static", "process.acceleration_tau_s": 3.0},
        {"process.model": "velocity", "process.acceleration_sigma_mps2": 1.0},
    ],
)
def test_numbers_that_the_process_model_has_no_use_for_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(StarwiseError, match="belongs to another process model"):
        motion_from(load_config(None, options))


def test_one_number_keeps_the_proportion_of_the_preset() -> None:
    preset = motion_from(RunConfig())
    same = motion_from(load_config(None, {"process.acceleration_sigma_mps2": np.sqrt(preset.horizontal).item()}))
    assert (same.horizontal, same.vertical) == pytest.approx((preset.horizontal, preset.vertical))


@pytest.mark.parametrize(
    "options", [{"signals": {"G": ["1c"]}}, {"signals": {"G": []}}, {"gate_probability": 1.0}, {"start": "12:00"}]
)
def test_options_that_would_silently_do_something_else_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(StarwiseError):
        RunConfig.from_dict(options)


def test_week_and_time_of_week() -> None:
    assert parse_time("2290:0.5") == 2290 * 604_800 * 10**9 + 500_000_000


def test_interval_is_a_distance_to_the_grid() -> None:
    t = 10**18 + np.arange(0, 100) * 1_000_000_000
    n = len(t)
    obs = Observations(
        t_ns=t + np.where(np.arange(n) % 2, 3_000_000, -3_000_000),  # a receiver clock that is 3 ms off either way
        offsets=np.zeros(n + 1, dtype=np.int64),
        flag=np.zeros(n, dtype=np.uint8),
        clock_offset_s=np.full(n, np.nan),
        sv=np.zeros(0, dtype=np.int16),
        sig=np.zeros(0, dtype=np.int16),
        code_m=np.zeros(0),
        phase_cyc=np.zeros(0),
        doppler_hz=np.zeros(0),
        cn0_dbhz=np.zeros(0),
        lli=np.zeros(0, dtype=np.uint8),
    )
    assert obs.between(interval_s=10.0).n_epochs == 10
    assert obs.between(interval_s=1.0).n_epochs == 100


def test_notes_reach_the_solution() -> None:
    solution = starwise.solve(DATA / "demo_MO.rnx.gz", DATA / "demo_MN.rnx.gz", interval_s=60.0, error_model="white")
    assert any("white" in note for note in solution.provenance["notes"])
    lsq = starwise.solve(DATA / "demo_MO.rnx.gz", DATA / "demo_MN.rnx.gz", interval_s=60.0, method="lsq")
    assert not any("white" in note for note in lsq.provenance["notes"])
    assert not any("[errors]" in note for note in solution.provenance["notes"])
    told = starwise.solve(
        DATA / "demo_MO.rnx.gz", DATA / "demo_MN.rnx.gz", interval_s=60.0, error_model="white",
        **{"errors.slow_gps_m": 3.0},
    )  # fmt: skip
    assert any("[errors]" in note for note in told.provenance["notes"])


def test_singular_covariance_does_not_improve_the_score() -> None:
    solution = starwise.solve(DATA / "demo_MO.rnx.gz", DATA / "demo_MN.rnx.gz", interval_s=60.0, method="lsq")
    truth = Truth(solution.pos_e + 1.0, solution.t_ns)
    assert assess(solution, truth)["coverage_95"] == 1.0
    solution.cov_pos[:5] = 0.0
    assert assess(solution, truth)["coverage_95"] == pytest.approx(1.0 - 5 / solution.n_epochs)


def test_files_of_two_receivers_are_refused() -> None:
    from starwise.io.rinex_obs import read_obs, splice

    one = read_obs(DATA / "demo_MO.rnx.gz")
    other = Observations(**{**one.__dict__, "code_m": one.code_m + 1000.0})
    with pytest.raises(StarwiseError, match="different receivers"):
        splice([one, other])
    assert splice([one, one]).n_epochs == one.n_epochs


def test_an_ephemeris_counts_from_its_transmission_on_unless_post_says_otherwise() -> None:
    """All records are sent in the middle of the run: before that nothing is solved, and the user is told."""
    obs, records = read_obs(DATA / "demo_MO.rnx.gz"), read_nav(DATA / "demo_MN.rnx.gz")
    middle = int(obs.t_ns[obs.n_epochs // 2])
    late = BroadcastEphemeris(replace(records, t_tx_ns=np.full(records.n, middle)))
    config = RunConfig(method="lsq", interval_s=60.0)
    now, later = (solve_run(obs, late, records.ionosphere, config.with_options({"post": p})) for p in (False, True))
    assert (now.has_position == (now.t_ns >= middle)).all()
    assert later.has_position.all()
    assert any("--post" in note for note in now.provenance["notes"])
    assert not any("--post" in note for note in later.provenance["notes"])
