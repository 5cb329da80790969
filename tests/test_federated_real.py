"""The federated filter over constellations on real measurements: what it equals, what it finds, what it refuses."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from starwise.config import RunConfig, parse_shares
from starwise.constants import ROW_EXCLUDED, ROW_STATUS_NAMES, ROW_USED
from starwise.errors import StarwiseError
from starwise.estimators.federated_faults import CLOCK_DRIFT, CLOCK_JUMP, SATELLITE, Event
from starwise.estimators.federated_local import information_shares, make_locals, run_locals
from starwise.estimators.federated_master import Beliefs, beliefs, fuse, inverse, separations
from starwise.estimators.federated_run import run_federated, shares_of
from starwise.estimators.filter import run_filter
from starwise.estimators.run import solve_run
from starwise.io.results import read_solution, write_results
from starwise.report.summary import summarise
from starwise.signals import sv_id

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
import federated_real
from federated_real import Case

SHORT = "tlse_2024 1 h"


@pytest.fixture(scope="module")
def hour(shared_data: Path) -> Case:
    return federated_real.load(SHORT)


@pytest.fixture(scope="module")
def quarter(shared_data: Path) -> Case:
    return federated_real.load("tlse_2024 15 min")


def test_shares_are_read_and_refused() -> None:
    assert parse_shares("auto") is None
    assert parse_shares("G=0.5, R=1") == {"G": 0.5, "R": 1.0}
    for text in ("", "G", "G=x", "G=0", "G=-1", "GR=1", "G=1,G=2", "X=1", "G=inf"):
        with pytest.raises(StarwiseError, match="share"):
            RunConfig(method="federated", share=text)
    with pytest.raises(StarwiseError, match="names no satellite system"):
        parse_shares("X=1")
    with pytest.raises(StarwiseError, match="twice"):
        parse_shares("G=1,G=2")
    with pytest.raises(StarwiseError, match="above zero"):
        parse_shares("G=-1")
    with pytest.raises(StarwiseError, match="of the federated filter"):
        RunConfig(method="ekf", share="G=1")


def made_up(rng: np.random.Generator, m: int = 3, K: int = 3, n: int = 5) -> Beliefs:
    A = rng.standard_normal((m, K, n, n))
    P = A @ np.swapaxes(A, -1, -2) + np.eye(n)
    return Beliefs(
        np.ones((m, K), dtype=bool), rng.standard_normal((m, n)) * 1e6, rng.standard_normal((m, K, n)), P, inverse(P)
    )


def test_fusion_is_the_weighted_mean() -> None:
    b = made_up(np.random.default_rng(5))
    use = np.array([[True, True, True], [True, False, True], [False, False, False]])
    x, P = fuse(b, use)
    for e in range(2):
        info = sum(np.linalg.inv(b.P[e, k]) for k in np.flatnonzero(use[e]))
        dx = np.linalg.solve(info, sum(np.linalg.inv(b.P[e, k]) @ b.dx[e, k] for k in np.flatnonzero(use[e])))
        np.testing.assert_allclose(P[e], np.linalg.inv(info), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(x[e] - b.base[e], dx, atol=1e-8)  # m: rounding of 1e6 m
    assert np.isnan(x[2]).all()
    assert np.isnan(P[2]).all()


def test_separations_are_of_the_others_alone() -> None:
    b = made_up(np.random.default_rng(6))
    use = np.ones((3, 3), dtype=bool)
    sep = separations(b, use, 0.0)
    others = use.copy()
    others[:, 1] = False
    x, P = fuse(b, others)
    d = (b.base + b.dx[:, 1] - x)[:, :3]
    S = P[:, :3, :3] + b.P[:, 1, :3, :3]
    np.testing.assert_allclose(sep[:, 1], np.einsum("mi,mi->m", d, np.linalg.solve(S, d[..., None])[..., 0]), rtol=1e-6)
    far = replace(b, dx=b.dx + np.array([0.0, 100.0, 0.0])[None, :, None])  # m: the second local filter is off
    assert np.argmax(separations(far, use, 0.0), axis=1).tolist() == [1, 1, 1]


@pytest.mark.real
def test_one_constellation_is_the_centralised_filter(shared_data: Path) -> None:
    """A share of one, a clock of its own, nobody to fuse with: the same numbers."""
    case = federated_real.load(SHORT, systems="G", fde=False)
    prepared = case.prepared()
    alone, _, events = run_federated(prepared, case.config)
    central, _ = run_filter(prepared, case.config)
    np.testing.assert_allclose(alone.pos, central.pos, atol=1e-5)  # m: rounding through an inverse
    np.testing.assert_allclose(alone.cov_pos, central.cov_pos, rtol=1e-6)
    assert events == []


@pytest.mark.real
def test_sizes_of_shares_do_not_matter_to_what_is_known(hour: Case) -> None:
    """Sky states come back in the units of the run: prior variances of the locals add up to one filter's."""
    prepared = hour.prepared()
    for shares in (np.full(4, 0.25), np.array([0.1, 0.2, 0.3, 0.4])):
        made = make_locals(prepared, hour.config, shares)
        run_locals(made, prepared, hour.config, 1)
        nk = made[0].numbers.process.nk
        for local in made:
            # permanent and slow states: never better known than their prior over the share allows, never worse
            assert (
                np.diagonal(local.common_cov[:, nk:, nk:], axis1=1, axis2=2) <= 1.0 / local.share * (1 + 1e-9)
            ).all()
            # a decimetre of zenith delay is hardly seen: its prior stays
            assert local.common_cov[0, nk, nk] > 0.9 / local.share
        _, P = fuse(beliefs(made), np.ones((len(local.solved), 4), dtype=bool))
        assert (np.diagonal(P[:, nk:, nk:], axis1=1, axis2=2) <= 1.0 + 1e-9).all()


@pytest.mark.real
def test_as_good_as_the_centralised_filter(hour: Case, quarter: Case) -> None:
    for case in (hour, quarter):
        row = federated_real.accuracy(case)
        assert row["federated"]["rms_3d_m"] <= 1.1 * row["ekf"]["rms_3d_m"]
        assert row["federated"]["coverage_95"] >= 0.9
        assert row["events"] == 0  # nothing is wrong, nobody is named
        if case.obs.n_epochs >= 900:  # of a short run, what is done once is most
            assert row["federated"]["ms_per_epoch"] <= 2.0 * row["s3ekf"]["ms_per_epoch"]


@pytest.mark.real
def test_threads_change_nothing(hour: Case) -> None:
    prepared = hour.prepared()
    found = []
    for threads in (1, 4):
        made = make_locals(prepared, hour.config, shares_of(prepared, hour.config))
        run_locals(made, prepared, hour.config, threads)
        found.append(np.stack([local.common for local in made]))
    np.testing.assert_array_equal(found[0], found[1])


def named(events: list[Event], cause: str) -> set[str]:
    return {e.satellite or e.constellation for e in events if e.cause == cause}


@pytest.mark.real
@pytest.mark.parametrize("name", ["G12", "R04", "E08", "C19"])
def test_a_satellite_that_drifts_away_is_named(quarter: Case, name: str) -> None:
    out = federated_real.fault(quarter, [sv_id(name)], rate_mps=federated_real.RAMP_MPS)
    assert named(out["events"], SATELLITE) == {name}
    limit = 40.0 if name[0] == "R" else 25.0  # s
    delay = federated_real.delay(out["events"], name[0], out["t0_ns"])
    assert delay is not None
    assert 0.0 < delay <= limit
    assert out["peak_m"] <= 6.0


@pytest.mark.real
@pytest.mark.parametrize("name", ["G18", "R09", "E21", "C29"])
def test_the_fault_of_the_best_satellite_is_not_taken_for_the_clock(hour: Case, name: str) -> None:
    """Where 30 s leave the clock uncertain, the satellite that is processed first must not decide it."""
    out = federated_real.fault(hour, [sv_id(name)], rate_mps=federated_real.RAMP_MPS)
    assert [(e.satellite, e.cause) for e in out["events"]] == [(name, SATELLITE)]
    assert federated_real.delay(out["events"], name[0], out["t0_ns"]) == 30.0  # s: the first epoch with an error
    assert out["peak_m"] <= 2.0


@pytest.mark.real
def test_a_clock_that_jumps_is_absorbed_and_named(quarter: Case) -> None:
    glonass = [int(sv) for sv in np.unique(quarter.obs.sv) if sv >> 8 == 1]
    out = federated_real.fault(quarter, glonass, step_m=federated_real.JUMP_M)
    assert [(e.constellation, e.cause) for e in out["events"]] == [("R", CLOCK_JUMP)]
    assert out["events"][0].size_m == pytest.approx(federated_real.JUMP_M, abs=5.0)  # m: noise of the clock
    assert out["events"][0].t_ns == out["t0_ns"]
    assert out["peak_m"] <= 2.0


@pytest.mark.real
@pytest.mark.parametrize("doppler", [False, True])
def test_a_constellation_that_drifts_away_is_harmless_and_named(quarter: Case, doppler: bool) -> None:
    gps = [int(sv) for sv in np.unique(quarter.obs.sv) if sv >> 8 == 0]
    out = federated_real.fault(quarter, gps, rate_mps=federated_real.RAMP_MPS, doppler=doppler)
    assert "G" in named(out["events"], CLOCK_DRIFT)
    assert {e.constellation for e in out["events"]} == {"G"}
    assert out["peak_m"] <= 4.0


@pytest.mark.real
def test_rows_of_a_constellation_that_is_out_are_excluded(quarter: Case) -> None:
    gps = [int(sv) for sv in np.unique(quarter.obs.sv) if sv >> 8 == 0]
    prepared = quarter.prepared(federated_real.faulty(quarter, gps, rate_mps=federated_real.RAMP_MPS))
    ep, out, events = run_federated(prepared, quarter.config)
    at = int(np.searchsorted(prepared.epochs.t_ns, next(e.t_ns for e in events if e.cause == CLOCK_DRIFT))) + 5
    rows = slice(int(prepared.epochs.offsets[at]), int(prepared.epochs.offsets[at + 1]))
    mine = prepared.rows.system[rows] == 0
    assert (out.status[rows][mine] == ROW_EXCLUDED).any()
    assert not (out.status[rows][mine] == ROW_USED).any()
    assert ep.n_used[at] == (out.status[rows] == ROW_USED).sum()


@pytest.mark.real
def test_constellations_too_small_to_start_alone_contribute(hour: Case) -> None:
    """Three satellites of a constellation are no position, but they are information."""
    keep = [int(sv) for sv in np.unique(hour.obs.sv) if sv >> 8 == 2]
    few = [sv_id(name) for name in ("G16", "G26", "G31")]
    exclude = [sv for sv in np.unique(hour.obs.sv).tolist() if sv not in keep and sv not in few]
    at = np.isin(hour.obs.sv, exclude)
    case = replace(hour, obs=replace(hour.obs, code_m=np.where(at, np.nan, hour.obs.code_m)))
    prepared = case.prepared()
    ep, _, _ = run_federated(prepared, case.config)
    both = np.trace(ep.cov_pos, axis1=1, axis2=2)
    made = make_locals(prepared, case.config, information_shares(prepared))
    run_locals(made, prepared, case.config, 1)
    assert [local.name for local in made] == ["G", "E"]
    assert made[0].solved.all()
    alone = np.trace(made[1].common_cov[:, :3, :3], axis1=1, axis2=2)
    assert (both < alone).mean() > 0.9
    e = np.linalg.norm(ep.pos - case.truth, axis=1)
    assert np.sqrt(np.mean(e**2)) < 6.0  # m: eight satellites


@pytest.mark.real
def test_events_are_in_the_files(shared_data: Path, hour: Case, tmp_path: Path) -> None:
    obs = federated_real.faulty(hour, [sv_id("G31")], rate_mps=federated_real.RAMP_MPS)
    solution = solve_run(obs, hour.ephemeris, hour.ionosphere, hour.config)
    (event,) = solution.provenance["events"]
    shares = solution.provenance["shares"]
    assert sorted(shares) == ["C", "E", "G", "R"]
    assert sum(shares.values()) == pytest.approx(1.0)
    assert (event["satellite"], event["constellation"], event["cause"]) == ("G31", "G", "satellite")
    assert summarise(solution)["events"] == {"satellite": 1}
    mine = (solution.ledger["sv"] == sv_id("G31")) & (solution.ledger["t_ns"] > obs.t_ns[hour.middle + 1])
    refused = solution.ledger["status"][mine] == ROW_STATUS_NAMES.index("gated")
    assert refused.any()
    write_results(solution, tmp_path / "out")
    assert read_solution(tmp_path / "out").provenance["events"] == [event]
