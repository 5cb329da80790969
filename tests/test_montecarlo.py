"""Monte Carlo: the simulator's own numbers, the same whatever the workers, resumable, safe to be killed."""

from dataclasses import dataclass, replace

import numpy as np
import polars as pl
import pytest

from starwise.config import RunConfig
from starwise.errors import StarwiseError
from starwise.sim.scenario import load_scenario
from starwise.studies import montecarlo
from starwise.studies.accuracy_runs import AccuracyTask, natural_config
from starwise.studies.montecarlo import run_many, task_key
from starwise.studies.s3ekf_filter import SCENARIOS, paper_config, solve_paper
from starwise.studies.scene import Scene, only_noise, sky_of

SHORT = {"time.duration_s": 30.0}


@dataclass(frozen=True)
class Task:
    """Counts its runs in a list that the test holds; numbers from the run."""

    seed: int = 1

    def description(self):
        return {"seed": self.seed}

    def prepare(self):
        def rows(number):
            DONE.append(number)
            return [{"run": number, "value": float(self.seed * number), "name": "a"}]

        return rows


DONE: list[int] = []


@pytest.fixture(autouse=True)
def _fresh():
    DONE.clear()
    montecarlo._kept.__dict__.clear()


def test_runs_in_order_and_in_one_file(tmp_path):
    table = run_many(Task(3), 7, tmp_path, workers=1, block=3)
    assert table["run"].to_list() == list(range(7))
    assert table["value"].to_list() == [3.0 * k for k in range(7)]
    assert pl.read_parquet(tmp_path / "montecarlo.parquet").equals(table)


def test_resumes_where_it_stopped(tmp_path):
    run_many(Task(), 6, tmp_path, workers=1, block=3)
    DONE.clear()
    run_many(Task(), 9, tmp_path, workers=1, block=3)
    assert DONE == [6, 7, 8]
    DONE.clear()
    run_many(Task(2), 3, tmp_path, workers=1, block=3)  # another seed: nothing is taken over
    assert DONE == [0, 1, 2]


def test_a_part_that_is_not_whole_is_done_again(tmp_path):
    whole = run_many(Task(), 6, tmp_path, workers=1, block=3)
    parts = sorted((tmp_path / "parts" / task_key(Task())).glob("*.parquet"))
    parts[0].write_bytes(parts[0].read_bytes()[:50])
    DONE.clear()
    assert run_many(Task(), 6, tmp_path, workers=1, block=3).equals(whole)
    assert DONE == [0, 1, 2]


def test_killed_in_the_middle(tmp_path):
    """What a kill leaves behind: some parts, and a file that was being written."""

    @dataclass(frozen=True)
    class Dies(Task):
        def prepare(self):
            inner = Task.prepare(self)

            def rows(number):
                if number == 4:
                    raise KeyboardInterrupt
                return inner(number)

            return rows

    with pytest.raises(KeyboardInterrupt):
        run_many(Dies(), 6, tmp_path, workers=1, block=3)
    folder = tmp_path / "parts" / task_key(Task())
    (folder / ".montecarlo-000003-000006.parquet.123").write_bytes(b"PAR1")
    assert not (tmp_path / "montecarlo.parquet").exists()
    montecarlo._kept.__dict__.clear()
    DONE.clear()
    table = run_many(Task(), 6, tmp_path, workers=1, block=3)
    assert DONE == [3, 4, 5]
    assert table["run"].to_list() == list(range(6))


def test_bad_arguments(tmp_path):
    with pytest.raises(StarwiseError, match="not at least one run"):
        run_many(Task(), 0, tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(StarwiseError, match="folder cannot be made"):
        run_many(Task(), 1, tmp_path / "file")


def test_the_key_follows_everything(tmp_path):
    scenario = load_scenario(SCENARIOS[2])
    task = AccuracyTask(scenario, 1, ("s3ekf",), RunConfig())
    other = [
        AccuracyTask(scenario, 2, ("s3ekf",), RunConfig()),
        AccuracyTask(scenario, 1, ("ekf",), RunConfig()),
        AccuracyTask(scenario, 1, ("s3ekf",), RunConfig(mask_deg=7.0)),
        AccuracyTask(scenario.with_options({"receiver.noise.code_m": 5.0}), 1, ("s3ekf",), RunConfig()),
    ]
    assert len({task_key(t) for t in [task, *other]}) == 5
    assert task_key(task) == task_key(AccuracyTask(load_scenario(SCENARIOS[2]), 1, ("s3ekf",), RunConfig()))


def test_the_same_whatever_the_number_of_workers(tmp_path):
    scenario = load_scenario(SCENARIOS[2], SHORT)
    task = AccuracyTask(scenario, 5, ("lsq", "s3ekf"), natural_config(scenario))
    one = run_many(task, 6, tmp_path / "one", workers=1, block=2)
    two = run_many(task, 6, tmp_path / "two", workers=2, block=2)
    assert one.equals(two)
    assert one["horizontal_2rms_m"].n_unique() == len(one)
    assert (tmp_path / "one" / "montecarlo.parquet").read_bytes() == (
        tmp_path / "two" / "montecarlo.parquet"
    ).read_bytes()


def test_quick_runs_are_the_simulators():
    """The same random numbers; the instants of reception differ by a microsecond at 300 m/s and 4 km/s of satellite."""
    scenario = load_scenario(SCENARIOS[2], SHORT)
    scene, config = Scene(scenario, 9), paper_config("s3ekf")
    assert scene.quick
    quick, full = scene.run(4, config), sky_of(scene.simulator.run(4), config)
    np.testing.assert_array_equal(quick.epochs.offsets, full.epochs.offsets)
    np.testing.assert_array_equal(quick.sv, full.sv)
    assert np.abs(quick.rows.code_m - full.rows.code_m).max() < 0.02  # m
    assert np.abs(quick.rows.rate_mps - full.rows.rate_mps).max() < 1e-4  # m/s
    # The noise itself: what is left when the clock's part, common to an epoch, is taken out, is below 2 mm.
    difference = quick.rows.code_m - full.rows.code_m
    for a, b in zip(quick.epochs.offsets[:-1], quick.epochs.offsets[1:], strict=True):
        assert np.ptp(difference[a:b]) < 2e-3
    full = replace(full, model=quick.model)
    a, b = (solve_paper(sky, "s3ekf").pos - sky.pos_e for sky in (quick, full))
    assert np.abs(a - b).max() < 2e-3  # m


def test_runs_do_not_depend_on_each_other():
    scenario = load_scenario(SCENARIOS[0], SHORT)
    config = paper_config("lsq")
    a = Scene(scenario, 1).run(3, config)
    other = Scene(scenario, 1)
    other.run(0, config)
    other.run(7, config)
    np.testing.assert_array_equal(other.run(3, config).rows.code_m, a.rows.code_m)
    assert np.abs(other.run(2, config).rows.code_m - a.rows.code_m).max() > 1.0


def test_other_scenarios_are_simulated_in_full():
    scenario = load_scenario("urban-drive", {"time.duration_s": 10.0, "imu": None, "faults": []})
    assert not only_noise(scenario)
    scene, config = Scene(scenario, 3), natural_config(scenario)
    sky = scene.run(1, config)
    full = scene.simulator.run(1)
    np.testing.assert_array_equal(sky.pos_e, full.truth.pos_e)
    with pytest.raises(ValueError, match="white noise"):
        scene.run(1, config, 1.0)
