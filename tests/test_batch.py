"""Batches: lists of units, folders, failures, resuming, killing, and the tables that remain."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest

from batches import NAV, OBS, QUICK, TRUTH, contents, figures, masks, of, unit
from starwise.__main__ import main
from starwise.batch import Manifest, Unit, read_index, read_manifest, read_summary, run_batch, scan, store
from starwise.batch import run as run_module
from starwise.batch.manifest import as_toml, with_truths
from starwise.batch.text import batch_text
from starwise.batch.work import Done, Work, do_unit
from starwise.errors import StarwiseError
from starwise.spread import AHEAD, spread


def _lost(item, why):
    return f"lost: {why}"


def _work(item):
    if item == "deadly":
        os.kill(os.getpid(), signal.SIGKILL)
    return item, os.environ["POLARS_MAX_THREADS"]


def test_a_process_that_dies_costs_its_item_and_no_other():
    items = [0, 1, "deadly", 3, 4, 5, 6, 7]
    results = dict(spread(_work, items, lost=_lost, workers=2))
    assert results.pop("deadly").startswith("lost: its process died")
    assert results == {k: (k, "1") for k in (0, 1, 3, 4, 5, 6, 7)}


def _counting(count):
    taken = []

    def items():
        for k in range(count):
            taken.append(k)
            yield k

    return taken, items()


@pytest.mark.parametrize("workers", [1, 2])
def test_items_are_taken_no_further_ahead_than_workers_need(workers):
    taken, items = _counting(1_000_000)
    run = spread(abs, items, lost=_lost, workers=workers)
    for finished, _ in enumerate(run, 1):
        assert len(taken) <= finished + AHEAD * workers
        if finished == 300:
            break
    run.close()


def test_a_batch_of_a_million_takes_units_as_it_needs_them(tmp_path):
    class EnoughError(Exception):
        pass

    taken = []

    def units():
        for k in range(1_000_000):
            taken.append(k)
            yield Unit(f"u{k}", obs=("nowhere",), config=QUICK)

    def done(work):
        return Done({"number": work.number, "unit": work.unit.name, "status": "ok", "resumed": False, "seconds": 0.0})

    def progress(what, fraction):
        if what.startswith("100 of 1000000 units"):
            raise EnoughError

    with pytest.raises(EnoughError):
        run_batch(Manifest(units, 1_000_000), tmp_path, workers=1, progress=progress, do=done)
    assert len(taken) <= 100 + AHEAD
    assert read_summary(tmp_path).height == 100  # what there is was written
    assert not json.loads((tmp_path / "batch.json").read_text())["complete"]


# Lists of units


def test_manifest(tmp_path):
    (tmp_path / "sub").mkdir()
    path = tmp_path / "m.toml"
    path.write_text(
        '[defaults]\nnav = "brdc.nav"\noptions = { mask_deg = 7, "process.model" = "singer" }\n'
        '[[unit]]\nname = "a"\nobs = "sub/a.obs"\ntruth = [1.0, 2, 3]\n'
        '[[unit]]\nname = "b"\nobs = ["s3://x/b1.obs", "/b2.obs"]\nnav = []\nsp3 = "o.sp3"\noptions.mask_deg = 9\n'
    )
    a, b = read_manifest(path, QUICK, {"systems": "G"}).units()
    assert (a.obs, a.nav) == ((str(tmp_path / "sub/a.obs"),), (str(tmp_path / "brdc.nav"),))
    assert a.truth == "1.0,2,3"
    assert (b.obs, b.nav, b.sp3) == (("s3://x/b1.obs", "/b2.obs"), (), (str(tmp_path / "o.sp3"),))
    assert (a.config.mask_deg, b.config.mask_deg, a.config.systems, a.config.method) == (7.0, 9.0, "G", "lsq")
    assert b.config.process.model == "singer"
    again = tmp_path / "again.toml"
    again.write_text(as_toml(Manifest(lambda: [a, b], 2)))
    assert [u.files for u in read_manifest(again).units()] == [a.files, b.files]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no unit in the manifest"),
        ("x = 1", "unknown table"),
        ("[[unit]]\nname = 'a'", "m.toml:1: 'obs' is missing"),
        ("[[unit]]\nname = 'a'\nobs = 'o'\n\n[[unit]]\nname = 'a'\nobs = 'p'", "m.toml:5: two units of the same name"),
        ("[[unit]]\nname = '../a'\nobs = 'o'", "m.toml:1: not the name of a unit"),
        ("[[unit]]\nname = 'a'\nobs = 'o'\nobz = 3", "'obs'?"),
        ("[[unit]]\nname = 'a'\nobs = 'o'\noptions.mask = 3", "'mask_deg'?"),
        ("[[unit]]\nname = 'a'\nobs = 'o'\noptions = 3", "'options' is not a table"),
        ("[[unit]]\nname = 'a'\nobs = []", "'obs' is empty"),
        ("[[unit]]\nname = 'a'\nobs = 5", "'obs' is a list"),
        ("[unit]\nname = 'a'", "[[unit]]"),
        ("[[unit]\n", "m.toml:1: not TOML"),
    ],
)
def test_bad_manifest_is_2(tmp_path, capsys, text, words):
    path = tmp_path / "m.toml"
    path.write_text(text)
    assert main(["batch", str(path), "-o", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_manifest_of_json_lines_is_read_as_needed(tmp_path):
    path = tmp_path / "m.jsonl"
    path.write_text("\n".join(json.dumps({"name": f"u{k}", "obs": "o"}) for k in range(5)) + "\n\n")
    manifest = read_manifest(path)
    assert manifest.total == 5
    assert [u.name for u in manifest.units()] == [f"u{k}" for k in range(5)]
    assert next(iter(manifest.units())).obs == (str(tmp_path / "o"),)
    path.write_text('{"name": "a", "obs": "o"}\n{"name": \n')
    with pytest.raises(StarwiseError, match=r"m\.jsonl:2: not a JSON object"):
        read_manifest(path)


def test_table_of_truths(tmp_path):
    table = tmp_path / "t.csv"
    table.write_text("unit,x_m,y_m,z_m,antenna_up_m\nTLSE,1,2,3,\ntlse00fra_r_2024,4,5,6,0.5\n")
    names = ["TLSE00FRA_R_2022", "TLSE00FRA_R_2024.x", "KIRU"]
    made = with_truths(of(*(unit(name, truth=None) for name in names)), table).units()
    assert [(u.truth, u.antenna_up_m) for u in made] == [("1,2,3", 0.0), ("4,5,6", 0.5), (None, 0.0)]
    own = with_truths(of(unit("tlse", truth="7,8,9")), table).units()
    assert next(iter(own)).truth == "7,8,9"
    for text in ("", "unit,x_m\nA,1\n", "unit,truth,antenna_up_m\nA,b,c\n"):
        table.write_text(text)
        with pytest.raises(StarwiseError, match=r"t\.csv"):
            with_truths(of(unit("a")), table)


def test_a_folder_is_searched_by_content(tmp_path):
    lonely, deep = tmp_path / "lonely", tmp_path / "day" / "deep"
    for folder in (lonely, deep):
        folder.mkdir(parents=True)
    shutil.copy(NAV, tmp_path / "day" / "no-name")
    shutil.copy(OBS, tmp_path / "day" / "demo.obs.gz")
    shutil.copy(OBS, deep / "demo.obs.gz")  # its navigation file is one folder up
    shutil.copy(OBS, lonely / "other.obs")
    (tmp_path / "day" / "notes.txt").write_text("nothing")
    (tmp_path / "broken.gz").write_bytes(b"\x1f\x8b\x08\x00broken")
    # the same observations in another year: nothing in its folder serves then
    import gzip

    (tmp_path / "day" / "old.obs").write_bytes(gzip.decompress(OBS.read_bytes()).replace(b"2026", b"2016"))
    found = scan(tmp_path, QUICK)
    units = {u.name: u for u in found.units()}
    assert sorted(units) == ["day.deep.demo", "day.demo"]
    assert all(u.nav == (str(tmp_path / "day" / "no-name"),) for u in units.values())
    reasons = {Path(place).name: reason for place, reason in found.unpaired}
    assert reasons["other.obs"] == "no navigation file in its folder"
    assert reasons["old.obs"] == "no navigation file of its time"
    assert "damaged" in reasons["broken.gz"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(StarwiseError, match="no observation file"):
        scan(tmp_path / "empty")


@pytest.mark.real
def test_real_folders(shared_data):
    found = scan(shared_data / "static")
    units = {u.name: [Path(nav).name for nav in u.nav] for u in found.units()}
    assert units["KIRU00SWE_R_20240900000_01D_30S_MO"] == ["KIR000SWE_R_20240900000_01D_MN.rnx"]
    assert len(units["delf0010.21d"]) == 2
    assert len(units) == 8
    assert all("tlse_2023001" in place for place, _ in found.unpaired)
    assert len(found.unpaired) == 4


# A batch


def test_failures_do_not_stop_it_and_what_is_done_is_kept(tmp_path, capsys):
    obs = tmp_path / "o.rnx.gz"
    shutil.copy(OBS, obs)
    (tmp_path / "junk.obs").write_bytes(bytes(range(256)))
    units = [
        unit("good", obs=(str(obs),)),
        unit("gone", obs=("nowhere",)),
        unit("junk", obs=(str(tmp_path / "junk.obs"),)),
    ]
    units.append(unit("late", truth="0.1,0.2,nowhere"))
    out = tmp_path / "out"
    table = run_batch(of(*units), out, workers=1)
    assert table["status"].to_list() == ["ok", "failed", "failed", "failed"]
    assert "nowhere: cannot be read" in table["message"][1]
    assert "junk.obs: not a file that a solution" in table["message"][2]
    assert "truth" in table["message"][3]
    assert table["epochs"][0] == table["solved"][0] == table["compared"][0] == 20
    assert table["rms_3d_m"][0] < 5.0  # m; ionosphere wrong by a quarter, code noise below 1 m
    assert pl.read_parquet(out / "summary.parquet").equals(table)
    assert not (out / "unit=gone").exists()
    assert not list(out.glob(".batch-*"))

    before = contents(out)
    again = run_batch(of(*units), out, workers=1)
    assert again["resumed"].to_list() == [True, False, False, False]
    assert figures(again)[0] == figures(table)[0]
    assert again["seconds"][0] == table["seconds"][0]  # of the work, not of the looking
    assert contents(out) == before

    manifest = of(unit("good", obs=(str(obs),), config=QUICK.with_options({"mask_deg": 20.0})))
    assert not run_batch(manifest, out, workers=1)["resumed"][0]  # another configuration
    import gzip

    obs.write_bytes(gzip.compress(gzip.decompress(OBS.read_bytes()).replace(b"12.345", b"12.346") + b" ", mtime=0))
    assert not run_batch(manifest, out, workers=1)["resumed"][0]  # another input
    obs.write_bytes(b"")
    assert run_batch(manifest, out, workers=1)["status"][0] == "failed"
    assert not list((out / "unit=good").iterdir())  # a result that holds no longer is none


def test_without_ledgers(tmp_path):
    run_batch(of(unit("a")), tmp_path, workers=1)
    table = run_batch(of(unit("a", ledger=False)), tmp_path, workers=1)
    assert not table["resumed"][0]
    names = sorted(path.name for path in (tmp_path / "unit=a").iterdir())
    assert names == ["run.json", "solution.parquet", "solution.pos", "unit.json"]
    assert json.loads((tmp_path / "unit=a" / "run.json").read_text())["files"] == [names[1], names[2], names[0]]
    assert run_batch(of(unit("a", ledger=False)), tmp_path, workers=1)["resumed"][0]


def test_reports_of_a_result_go_with_it(tmp_path):
    """A report left behind would look like somebody else's, and the unit would fail for ever."""
    obs = tmp_path / "o.rnx.gz"
    shutil.copy(OBS, obs)
    manifest, folder = of(unit("a", obs=(str(obs),))), tmp_path / "out" / "unit=a"
    run_batch(manifest, tmp_path / "out", workers=1)
    for name in ("report.html", "assess.json"):
        (folder / name).write_text("{}")
    obs.rename(tmp_path / "away")
    assert run_batch(manifest, tmp_path / "out", workers=1)["status"][0] == "failed"
    assert not list(folder.iterdir())
    (tmp_path / "away").rename(obs)
    assert run_batch(manifest, tmp_path / "out", workers=1)["status"][0] == "ok"


def test_a_worker_of_another_version_takes_nothing_away(tmp_path):
    run_batch(of(unit("a")), tmp_path, workers=1)
    before = contents(tmp_path)
    table = run_batch(of(unit("a")), tmp_path, workers=1, do=lambda work: do_unit(replace(work, code="another")))
    assert "another version" in table["message"][0]
    do_unit(Work(0, unit("a"), str(tmp_path), "another"))  # as at a URL, where workers write by themselves
    assert contents(tmp_path) == before
    assert run_batch(of(unit("a")), tmp_path, workers=1)["resumed"][0]


def test_results_sent_back_leave_nothing_of_those_before(tmp_path, monkeypatch):
    """Neither a ledger of other rows, nor, where it is interrupted, the old seal on new files."""
    folder = tmp_path / "unit=a"
    run_batch(of(unit("a")), tmp_path, workers=1)
    (folder / "assess.json").write_text("{}")
    claimed, put = run_module._claimed, store.put_files

    @contextmanager
    def elsewhere(place):
        with claimed(place) as token:
            yield f"{token}-on-another-machine"

    def interrupted(files, place):
        if place.endswith("unit=a"):
            assert not (folder / "unit.json").exists()
        put(files, place)

    monkeypatch.setattr(run_module, "_claimed", elsewhere)
    monkeypatch.setattr(store, "put_files", interrupted)
    table = run_batch(of(unit("a", ledger=False)), tmp_path, workers=1)
    assert (table["status"][0], table["resumed"][0]) == ("ok", False)
    assert sorted(p.name for p in folder.iterdir()) == ["run.json", "solution.parquet", "solution.pos", "unit.json"]


@pytest.mark.parametrize("harm", ["cut", "unfinished", "removed", "unsealed", "swapped"])
def test_half_written_work_is_not_trusted(tmp_path, harm):
    manifest = of(unit("a"))
    run_batch(manifest, tmp_path, workers=1)
    whole = contents(tmp_path)
    folder = tmp_path / "unit=a"
    if harm == "cut":
        with (folder / "ledger.parquet").open("r+b") as file:
            file.truncate(1000)
    elif harm == "unfinished":
        run = (folder / "run.json").read_text()
        (folder / "run.json").write_text(run.replace('"complete": true', '"complete":false'))
    elif harm == "removed":
        (folder / "solution.pos").unlink()
    elif harm == "unsealed":
        (folder / "unit.json").unlink()
    else:
        (folder / "unit.json").write_text("{")
    assert not run_batch(manifest, tmp_path, workers=1)["resumed"][0]
    assert contents(tmp_path) == whole
    assert run_batch(manifest, tmp_path, workers=1)["resumed"][0]


def test_foreign_files_are_not_overwritten(tmp_path):
    (tmp_path / "unit=a").mkdir()
    (tmp_path / "unit=a" / "solution.pos").write_text("mine")
    table = run_batch(of(unit("a")), tmp_path, workers=1)
    assert "did not write" in table["message"][0]
    assert (tmp_path / "unit=a" / "solution.pos").read_text() == "mine"


def test_two_batches_in_one_folder_are_refused(tmp_path):
    with run_module._claimed(str(tmp_path)), pytest.raises(StarwiseError, match="another batch"):
        run_batch(of(unit("a")), tmp_path, workers=1)
    with pytest.raises(StarwiseError, match="two units of the same name"):
        run_batch(of(unit("a"), unit("a")), tmp_path, workers=1)
    (tmp_path / "file").write_text("")
    with pytest.raises(StarwiseError, match="cannot be written"):
        run_batch(of(unit("a")), tmp_path / "file", workers=1)


def test_results_at_a_url(tmp_path):
    """A store within this process; the tests of clusters have a real one."""
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    memory.pipe_file("/in/o.gz", OBS.read_bytes())
    manifest = of(unit("a", obs=("memory://in/o.gz",)))
    table = run_batch(manifest, "memory://out", workers=1)
    assert table["status"].to_list() == ["ok"], table["message"][0]
    local = tmp_path / "local"
    run_batch(of(unit("a")), local, workers=1)
    for name in ("solution.parquet", "ledger.parquet", "solution.pos"):
        assert memory.cat_file(f"/out/unit=a/{name}") == (local / "unit=a" / name).read_bytes()
    run = json.loads(memory.cat_file("/out/unit=a/run.json"))
    assert run["inputs"][0]["path"] == "memory://in/o.gz"
    missing = run_batch(of(unit("a", obs=("memory://in/gone",))), "memory://out", workers=1)
    assert "memory://in/gone: cannot be read" in missing["message"][0]
    assert not memory.exists("/out/unit=a/solution.parquet")
    assert "needs a package" in run_batch(of(unit("b", obs=("gs://a/b",))), tmp_path / "c", workers=1)["message"][0]


def test_killed_and_started_again(tmp_path):
    """SIGKILL of the whole batch in the middle; two processes; what was finished then is not touched again."""
    lines = [{"name": u.name, "obs": list(u.obs), "nav": list(u.nav), "options": {"mask_deg": u.config.mask_deg}}
             for u in masks(8).units()]  # fmt: skip
    path, out, clean = tmp_path / "m.jsonl", tmp_path / "out", tmp_path / "clean"
    path.write_text("\n".join(map(json.dumps, lines)))
    sets = ["method=lsq", "error_model=white", f"end={QUICK.end}"]
    sets = [text for pair in sets for text in ("--set", pair)]
    command = [sys.executable, "-m", "starwise", "batch", str(path), "--workers", "2", *sets, "-q", "-o"]
    process = subprocess.Popen([*command, str(out)])
    while process.poll() is None and len(list(out.glob("unit=*/unit.json"))) < 2:
        time.sleep(0.005)
    process.kill()
    process.wait()
    assert not (out / "summary.parquet").exists()  # it was in the middle
    time.sleep(0.3)  # its processes notice that it is gone
    finished = {seal: seal.stat().st_mtime_ns for seal in out.glob("unit=*/unit.json")}
    assert 2 <= len(finished) < 8
    (out / "unit=mask-07").mkdir(exist_ok=True)
    (out / "unit=mask-07" / ".ledger.parquet.1.tmp").write_bytes(b"PAR1")  # as a killed process leaves it
    assert subprocess.run([*command, str(out)], check=False).returncode == 0
    table = read_summary(out)
    assert table["resumed"].sum() >= len(finished)
    assert table["status"].to_list() == ["ok"] * 8
    assert all(seal.stat().st_mtime_ns == before for seal, before in finished.items())
    run_batch(read_manifest(path, QUICK), clean, workers=1)
    assert contents(out) == contents(clean)


def test_index_and_summary_can_be_queried(tmp_path):
    gps = QUICK.with_options({"systems": "G"})
    out = tmp_path / "out"
    table = run_batch(of(unit("all"), unit("0012", config=gps), unit("bad", nav=("nowhere",))), out, workers=1)
    index = read_index(out)
    rows = index.group_by("unit").agg(pl.len(), pl.col("sigma_e_m").mean(), pl.col("clock_G_m").count()).collect()
    assert dict(rows.select("unit", "len").iter_rows()) == {"all": 20, "0012": 20}
    assert set(index.collect_schema().names()) >= {f"clock_{letter}_m" for letter in table["clocks"][0]}
    duckdb = pytest.importorskip("duckdb")
    query = (
        f"SELECT unit, count(*), avg(sigma_e_m) FROM read_parquet('{out}/unit=*/solution.parquet', "
        "hive_partitioning = true, hive_types_autocast = false, union_by_name = true) "
        f"SEMI JOIN '{out}/summary.parquet' USING (unit) GROUP BY unit ORDER BY unit"
    )
    got = duckdb.sql(query).fetchall()
    assert [row[:2] for row in got] == [("0012", 20), ("all", 20)]
    sigma = dict(rows.select("unit", "sigma_e_m").iter_rows())
    assert got[1][2] == pytest.approx(sigma["all"], abs=1e-12)  # m, order of summation
    with pytest.raises(StarwiseError, match="no summary"):
        read_index(tmp_path)


def test_screen_is_80_columns_and_the_exit_code_tells(tmp_path, capsys):
    shutil.copy(OBS, tmp_path / "A_RATHER_LONG_NAME_OF_A_STATION_20260800000_01D_30S_MO.rnx.gz")
    shutil.copy(NAV, tmp_path / "nav.gz")
    (tmp_path / "t.csv").write_text(f"unit,truth\nA_RATHER,{TRUTH}\n")
    (tmp_path / "c.toml").write_text(f'method = "lsq"\nerror_model = "white"\nend = "{QUICK.end}"\n')
    options = ["--workers", "1", "--truth-table", str(tmp_path / "t.csv"), "--config", str(tmp_path / "c.toml")]
    assert main(["batch", str(tmp_path), "-o", str(tmp_path / "out"), *options]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "A_RATHER_LONG" in out
    assert "1 solved" in out
    assert all(len(line) <= 80 or str(tmp_path) in line for line in out.splitlines())
    assert main(["batch", str(tmp_path), "--dry-run"]) == 0
    manifest = tmp_path / "m.toml"
    manifest.write_text(capsys.readouterr().out + '\n[[unit]]\nname = "bad"\nobs = "gone"\n')
    assert main(["batch", str(manifest), "-o", str(tmp_path / "out"), "--json", *options]) == 1
    record = json.loads(capsys.readouterr().out)
    assert record["units"] == {"ok": 1, "no_solution": 0, "failed": 1, "unpaired": 0}
    assert record["summary"][0]["resumed"]
    assert main(["batch", str(manifest)]) == 2
    high = [*options, "--set", "mask_deg=89"]
    assert main(["batch", str(tmp_path), "-o", str(tmp_path / "none"), "-q", *high]) == 1  # as solve: no position
    (tmp_path / "nav.gz").unlink()
    assert main(["batch", str(tmp_path), "-o", str(tmp_path / "lonely"), "-q", *options]) == 1
    many = pl.concat([read_summary(tmp_path / "out")] * 50)
    # 30 of 100 units, the failed ones with an error of a few lines, as long as the path in it; all would be over 200
    assert len(batch_text(many, "out", 5000.0).splitlines()) < 140
