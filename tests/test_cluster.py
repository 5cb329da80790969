"""Dask: the same numbers as here, workers that are killed and added, an object store, nothing piled up."""

import json
import operator
import os
import shutil
import signal
from contextlib import contextmanager

import pytest

from batches import NAV, OBS, contents, figures, masks, of, unit
from starwise.__main__ import main
from starwise.batch import read_index, read_summary, run_batch
from starwise.batch import run as run_module
from starwise.batch.work import Work, do_unit
from starwise.errors import StarwiseError
from starwise.sim.scenario import load_scenario
from starwise.spread import AHEAD, spread
from starwise.studies.accuracy_runs import AccuracyTask, natural_config
from starwise.studies.montecarlo import run_many
from starwise.studies.s3ekf_filter import SCENARIOS

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def store():
    """An S3-compatible server on this machine, with a bucket; workers started later inherit where it is."""
    pytest.importorskip("s3fs")
    server = pytest.importorskip("moto.server").ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            patch.setenv(name, "test")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        for name in ("AWS_CA_BUNDLE", "AWS_PROFILE", "HTTP_PROXY", "HTTPS_PROXY", "http_proxy", "https_proxy"):
            patch.delenv(name, raising=False)
        import s3fs

        s3 = s3fs.S3FileSystem(use_listings_cache=False)
        s3.mkdir("bucket")
        yield s3
    server.stop()


@pytest.fixture(scope="module")
def cluster(store):
    """Three workers of one thread."""
    with distributed.LocalCluster(
        n_workers=3,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        memory_limit=0,
        silence_logs=50,
    ) as made:
        yield made


def kill_one(cluster):
    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        pids = client.run(os.getpid)
    os.kill(min(pids.values()), signal.SIGKILL)


def once(action):
    """Progress that acts when the first piece of work is done."""
    state = {"acted": False}

    def progress(what, fraction):
        if fraction > 0 and not state["acted"]:
            state["acted"] = True
            action()

    return progress, state


def test_monte_carlo_with_a_worker_killed_is_the_local_one(tmp_path, cluster):
    scenario = load_scenario(SCENARIOS[2], {"time.duration_s": 30.0})
    task = AccuracyTask(scenario, 5, ("lsq",), natural_config(scenario))
    run_many(task, 40, tmp_path / "here", workers=1, block=2)
    progress, state = once(lambda: kill_one(cluster))
    run_many(task, 40, tmp_path / "there", block=2, scheduler=cluster.scheduler_address, progress=progress)
    assert state["acted"]
    there, here = (tmp_path / name / "montecarlo.parquet" for name in ("there", "here"))
    assert there.read_bytes() == here.read_bytes()
    assert sorted(p.name for p in (tmp_path / "there" / "parts").glob("*/*")) == sorted(
        p.name for p in (tmp_path / "here" / "parts").glob("*/*")
    )


def test_batch_with_a_worker_killed_and_one_added_is_the_local_one(tmp_path, cluster):
    def happens():
        kill_one(cluster)
        cluster.scale(4)

    progress, state = once(happens)
    table = run_batch(masks(10), tmp_path / "there", scheduler=cluster.scheduler_address, progress=progress)
    assert state["acted"]
    here = run_batch(masks(10), tmp_path / "here", workers=1)
    assert table["status"].to_list() == ["ok"] * 10
    assert figures(table) == figures(here)
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
    cluster.scale(3)


def test_workers_that_do_not_see_the_folder_send_their_results(tmp_path, cluster, monkeypatch):
    claimed = run_module._claimed

    @contextmanager
    def elsewhere(place):
        with claimed(place) as token:
            yield f"{token}-on-another-machine"

    manifest = of(*masks(2).units(), unit("bad", obs=("nowhere",)))
    here = run_batch(manifest, tmp_path / "here", workers=1)
    monkeypatch.setattr(run_module, "_claimed", elsewhere)
    table = run_batch(manifest, tmp_path / "there", scheduler=cluster.scheduler_address)
    assert figures(table) == figures(here)
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
    again = run_batch(manifest, tmp_path / "there", scheduler=cluster.scheduler_address)
    assert again["resumed"].to_list() == [True, True, False]


def test_an_object_store_in_and_out(tmp_path, cluster, store):
    for path in (OBS, NAV):
        store.pipe_file(f"bucket/in/{path.name}", path.read_bytes())
    there = [
        unit(u.name, obs=(f"s3://bucket/in/{OBS.name}",), nav=(f"s3://bucket/in/{NAV.name}",), config=u.config)
        for u in masks(3).units()
    ]
    table = run_batch(of(*there), "s3://bucket/out", scheduler=cluster.scheduler_address)
    assert table["status"].to_list() == ["ok"] * 3, table["message"].to_list()
    here = run_batch(masks(3), tmp_path / "here", workers=1)
    assert figures(table.drop("bytes_out")) == figures(here.drop("bytes_out"))  # run.json names other places
    for path in (tmp_path / "here").glob("unit=*/*.p*"):
        assert store.cat_file(f"bucket/out/{path.relative_to(tmp_path / 'here')}") == path.read_bytes()
    again = run_batch(of(*there), "s3://bucket/out", scheduler=cluster.scheduler_address)
    assert again["resumed"].all()
    store.rm_file("bucket/out/unit=mask-01/ledger.parquet")
    again = run_batch(of(there[1]), "s3://bucket/out", scheduler=cluster.scheduler_address)
    assert not again["resumed"].any()
    assert store.exists("bucket/out/unit=mask-01/ledger.parquet")
    assert read_summary("s3://bucket/out").height == 1
    with pytest.raises(StarwiseError, match="s3://no-such-bucket/out: cannot be written"):
        run_batch(of(there[0]), "s3://no-such-bucket/out", workers=1)  # before anything is solved


def test_nothing_piles_up_in_the_scheduler(cluster):
    taken = []

    def items():
        for k in range(1_000_000):
            taken.append(k)
            yield k

    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        most = 0
        run = spread(operator.neg, items(), lost=lambda item, why: why, scheduler=cluster.scheduler_address)
        for finished, (item, result) in enumerate(run, 1):
            assert result == -item
            # three workers; a fourth may be leaving
            assert len(taken) <= finished + AHEAD * 4
            if finished % 100 == 0:
                most = max(most, client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)))
            if finished == 500:
                break
        run.close()
    assert 0 < most <= AHEAD * 4 + 2


def test_local_cluster_by_the_command(tmp_path, capsys):
    shutil.copy(OBS, tmp_path / "o.gz")
    shutil.copy(NAV, tmp_path / "n.gz")
    sets = ["--set", "method=lsq", "--set", "error_model=white", "--set", "end=2026-03-21T12:20:20"]
    arguments = ["batch", str(tmp_path), "-o", str(tmp_path / "out"), "--scheduler", "local", "--workers", "1", *sets]
    assert main([*arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["units"]["ok"] == 1
    assert read_index(tmp_path / "out").collect().height == 20


def test_what_is_missing_is_said(tmp_path, cluster, monkeypatch, capsys):
    with pytest.raises(StarwiseError, match="not the address of a scheduler"):
        run_batch(masks(1), tmp_path, scheduler="here")
    from starwise.spread import cluster as module

    monkeypatch.setattr(module, "CONNECT_S", 0.5)
    with pytest.raises(StarwiseError, match="no Dask scheduler answers"):
        run_batch(masks(1), tmp_path, scheduler="tcp://127.0.0.1:9")

    class OtherWorkers:
        def run(self, function):
            return {"tcp://here:1": function(), "tcp://there:2": "another"}

    with pytest.raises(StarwiseError, match="tcp://there:2 runs another version"):
        module._check_workers(OtherWorkers())
    assert "another version" in do_unit(Work(0, unit("a"), str(tmp_path), "another")).row["message"]

    def absent(name):
        raise ImportError(name)

    monkeypatch.setattr(module, "import_module", absent)
    assert main(["simulate", "s3ekf-3-turn", "--runs", "2", "-o", str(tmp_path / "s"), "--scheduler", "local"]) == 2
    assert "starwise[cluster]" in capsys.readouterr().err
