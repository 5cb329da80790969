"""Report as one HTML file: what it says, what it keeps of the data, that nothing breaks out of it. No browser here."""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handmade import HERE, handmade_solution
from starwise.__main__ import main
from starwise.constants import NS, ROW_GATED, ROW_LOW_ELEVATION, ROW_NOT_SELECTED, ROW_USED
from starwise.errors import StarwiseError
from starwise.io.results import read_solution, write_results
from starwise.report.html import Compared, compare_page, run_page, study_page, write_page, write_report, write_study
from starwise.report.html.beside import beside
from starwise.report.html.diagnosis import lab_payload, paragraphs
from starwise.report.html.encode import packed, safe_json, thinned
from starwise.report.html.epochs import MAX_EPOCHS, localised, shown_epochs
from starwise.report.html.satellites import MAX_CELLS, autocorrelation_payload, cells_of, satellites_payload
from starwise.report.html.words import checks, duration, number, percent
from starwise.signals import sv_id
from starwise.types import Solution, Truth

KINDS = {"f4": "<f4", "f8": "<f8", "u1": "|u1", "u2": "<u2", "u4": "<u4", "i2": "<i2"}
EVIL = "</script><script>window.hacked=1</script><img src=x onerror='window.hacked=2'>\u2028"


def unpacked(item: dict[str, str]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(item["bdata"]), dtype=KINDS[item["dtype"]])


def data_of(page: bytes) -> dict:
    text = page.decode("utf-8")
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)
    assert found
    return json.loads(found.group(1))


def day(n: int = 2880, satellites: int = 30, signals: int = 2, seed: int = 0) -> Solution:
    """A day of a receiver at rest: 30 satellites all the time, a few refused, two signals each."""
    rng = np.random.default_rng(seed)
    base = handmade_solution(n, step_ns=30 * NS)
    rows = n * satellites * signals
    status = np.tile(np.array([ROW_USED, ROW_NOT_SELECTED][:signals], dtype=np.uint8), n * satellites)
    status[rng.integers(0, rows, 500)] = ROW_GATED
    ledger = {
        "t_ns": np.repeat(base.t_ns, satellites * signals),
        "sv": np.tile(np.repeat(np.array([sv_id(f"G{k + 1:02d}") for k in range(satellites)], np.int16), signals), n),
        "status": status,
        "elevation_rad": rng.uniform(0.0, 1.5, rows),
        "azimuth_rad": rng.uniform(0.0, 6.28, rows),
        "cn0_dbhz": rng.uniform(20.0, 55.0, rows),
        "innovation_m": np.where(status == ROW_USED, rng.normal(size=rows), np.nan),
        "innovation_var_m2": np.where(status == ROW_USED, 1.0, np.nan),
        "rate_innovation_mps": np.full(rows, np.nan),
    }
    return replace(base, ledger=ledger)


@given(
    st.lists(st.lists(st.floats(-1e6, 1e6) | st.just(float("nan")), min_size=50, max_size=50), min_size=1, max_size=3),
    st.integers(10, 60),
)
def test_thinning_keeps_extremes(series: list[list[float]], limit: int) -> None:
    arrays = [np.array(s) for s in series]
    kept = thinned(arrays, limit)
    assert (np.diff(kept) > 0).all()
    assert kept[0] == 0
    assert kept[-1] == 49
    for values in arrays:
        if np.isfinite(values).any():
            assert np.nanmin(values[kept]) == np.nanmin(values)
            assert np.nanmax(values[kept]) == np.nanmax(values)


def test_thinning_keeps_a_spike_in_a_long_series() -> None:
    values = np.sin(np.arange(200_000) / 1e4)
    values[123_457] = 9.0
    kept = thinned([values, -values], 5000)
    assert len(kept) <= 5000
    assert 123_457 in kept


def test_packed_numbers_come_back() -> None:
    values = np.array([1.5, np.nan, -3.0])
    assert np.array_equal(unpacked(packed(values)), values.astype(np.float32), equal_nan=True)
    assert unpacked(packed(np.array([-5.0, 3.0, 1e9, np.nan]), "u1")).tolist() == [0, 3, 255, 0]


@given(st.text())
def test_json_cannot_leave_its_script(text: str) -> None:
    out = safe_json({"a": text, "b": [text]})
    assert not set("<>&\u2028\u2029") & set(out)
    assert json.loads(out) == {"a": text, "b": [text]}


def test_cells_tell_of_every_satellite_and_epoch_the_row_that_came_furthest() -> None:
    solution = handmade_solution(12)
    ledger = dict(solution.ledger)
    # two rows of G05 at every epoch: one refused, then one used; the used one speaks
    for name, values in ledger.items():
        ledger[name] = np.concatenate([values.reshape(12, 4)[:, :1], values.reshape(12, 4)], axis=1).ravel()
    ledger["status"] = np.tile(np.array([ROW_LOW_ELEVATION, ROW_USED, ROW_USED, 2, ROW_GATED], np.uint8), 12)
    cells = cells_of(replace(solution, ledger=ledger))
    assert cells is not None
    assert cells.n == 48
    assert len({(int(s), int(e)) for s, e in zip(cells.sv, cells.epoch, strict=True)}) == 48
    assert set(cells.status[cells.sv == sv_id("G05")].tolist()) == {ROW_USED}
    assert set(cells.status[cells.sv == sv_id("C60")].tolist()) == {ROW_GATED}


def test_stretches_are_exact() -> None:
    solution = day(200, 5, 1)
    cells = cells_of(solution)
    assert cells is not None
    out = satellites_payload(solution, cells)
    runs = {key: unpacked(value) for key, value in out["runs"].items()}
    status = np.full((5, 200), 255)
    for s, code, first, last in zip(runs["sv"], runs["status"], runs["first"], runs["last"], strict=True):
        status[s, first : last + 1] = code
    assert np.array_equal(status, solution.ledger["status"].reshape(200, 5).T)
    assert sum(out["table"]["used"]) == int((solution.ledger["status"] == ROW_USED).sum())


def test_autocorrelation_is_that_of_the_definition() -> None:
    solution = day(300, 4, 1, seed=3)
    v = solution.ledger["innovation_m"].reshape(300, 4)
    for k in range(1, 300):
        v[k] += 0.6 * np.nan_to_num(v[k - 1])
    cells = cells_of(solution)
    assert cells is not None
    out = autocorrelation_payload(solution, cells)
    assert out is not None
    w = np.clip(v, -6.0, 6.0)
    for lag in (1, 2, 7):
        a, b = w[:-lag], w[lag:]
        there = np.isfinite(a) & np.isfinite(b)
        a, b = a[there], b[there]
        assert out["rho"][lag - 1] == pytest.approx((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()), abs=1e-12)


def test_a_day_is_below_eight_megabytes() -> None:
    solution = day()
    assert len(solution.ledger["sv"]) == 172_800
    page = run_page(solution)
    assert len(page) < 8e6
    data = data_of(page)
    assert data["epochs"]["n"] == 2880
    kept = unpacked(data["sats"]["epoch"])
    assert len(kept) <= MAX_CELLS
    # the greatest residual of all is among those that are sent, whatever was thinned
    v = unpacked(data["sats"]["v"])
    assert np.nanmax(np.abs(v)) == pytest.approx(np.nanmax(np.abs(solution.ledger["innovation_m"])), rel=1e-6)


def test_a_long_run_is_thinned_with_its_extremes() -> None:
    solution = replace(handmade_solution(30_000), ledger={})
    pos = solution.pos_e.copy()
    pos[20_001] += 500.0
    solution = replace(solution, pos_e=pos)
    local = localised(solution)
    shown = shown_epochs(solution, local)
    assert len(shown) <= MAX_EPOCHS
    assert 20_001 in shown
    assert set(solution.status[shown].tolist()) == {0, 1, 2, 3, 4}
    assert len(run_page(solution)) < 8e6


def test_everything_from_a_file_is_escaped() -> None:
    provenance = {
        "starwise": "0",
        "config": {"method": EVIL, "key": EVIL},
        "station": {"marker": EVIL, "receiver": EVIL},
        "inputs": [{"kind": EVIL, "path": EVIL, "bytes": 1, "sha256": EVIL}],
        "problems": [{"file": EVIL, "line": 3, "what": EVIL, "count": 2}],
        "notes": [EVIL],
        "events": [{"gpst": EVIL, "constellation": EVIL, "satellite": EVIL, "cause": EVIL, "size_m": 1.0}],
        "summary": {
            "rows": 10, "rows_refused": {EVIL: 3}, "satellites_most_refused": {EVIL: [EVIL]},
            "systems": {"G": {"satellites": 1, "satellites_used": 1, "rows_used": 3, "signals": {EVIL: 3}}},
        },
    }  # fmt: skip
    solution = replace(handmade_solution(30), provenance=provenance)
    found = {"consistency": {"verdict": EVIL, "explanation": EVIL, "more": {EVIL: EVIL}}}
    truth = Truth(HERE, source=EVIL)
    clean = run_page(handmade_solution(30), Truth(HERE))
    pages = [run_page(solution, truth, found), study_page("# T\n\n" + EVIL + "\n\n| a |\n|---|\n| " + EVIL + " |", ".")]
    stats = {"epochs": 30, "epochs_solved": 30, "epochs_compared": 30}
    pages.append(compare_page([Compared(EVIL, solution, stats), Compared("b", solution, stats)], truth))
    for page in pages:
        text = page.decode("utf-8")
        assert "<script>window" not in text
        assert "<img src=x" not in text
        scripts = text.count("<script")
        assert scripts in (clean.decode().count("<script"), 2)  # no script but our own (a study has no plotly)
        assert "window.hacked" in text or "window.hacked" not in EVIL


def test_page_fetches_nothing_and_runs_nothing_else() -> None:
    text = run_page(handmade_solution(30)).decode("utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy
    assert policy.group(1).startswith("default-src &#39;none&#39;")
    assert policy.group(1).count("sha256-") == 2
    assert "unsafe-eval" not in policy.group(1)
    assert "script-src &#39;unsafe-inline" not in policy.group(1)
    own = re.sub(r'<script type="text/plain" id="plotly">.*?</script>', "", text, flags=re.S)
    assert not re.search(r'(src|href)="(?!#|data:)', own)
    assert not re.search(r"url\((?!#|data:)[^)$]", own)


def test_python_part_of_plotly_stays_out() -> None:
    import subprocess
    import sys

    code = (
        "import sys; sys.path.insert(0, 'tests'); from handmade import handmade_solution; "
        "from starwise.report.html import run_page; run_page(handmade_solution(30)); "
        "print([m for m in ('plotly', 'matplotlib', 'pandas') if m in sys.modules])"
    )
    root = Path(__file__).resolve().parents[1]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("n", [0, 1, 2])
def test_next_to_nothing_makes_a_page_too(n: int) -> None:
    assert b"</html>" in run_page(handmade_solution(n))


def test_nothing_solved_makes_a_page_too() -> None:
    base = handmade_solution(20)
    nothing = replace(base, pos_e=np.full((20, 3), np.nan), status=np.ones(20, np.uint8))
    text = run_page(nothing, Truth(HERE)).decode()
    assert "0 of 20 epochs" in text
    assert 'data-panel="track"' not in text


def test_words() -> None:
    assert [number(v) for v in (1234.5, 0.012345, -2.5, None, float("nan"), 0.0)] == [
        "1234", "0.0123", "−2.50", "–", "–", "0",
    ]  # fmt: skip
    assert [duration(s) for s in (5, 65, 7200, 86370)] == ["5 s", "1 min 5 s", "2 h", "23 h 59 min"]
    assert [percent(*p) for p in ((1, 1), (0, 3), (9999, 10000), (1, 3), (1, 0))] == [
        "100 %", "0 %", "> 99.9 %", "33.3 %", "–",
    ]  # fmt: skip


def test_trust_is_told_by_what_is_unsafe() -> None:
    solution = handmade_solution(20)

    def level(what: str, **parts: object) -> str:
        made = checks(solution, parts.get("stats"), parts.get("nis"), parts.get("rho"), parts.get("found"))  # type: ignore[arg-type]
        return next(item.level for item in made if item.what == what)

    stats = {"coverage_95": 0.5, "nees_mean": 9.0, "epochs_compared": 20}
    assert level("Covariance", stats=stats) == "bad"
    assert level("Covariance", stats={**stats, "coverage_95": 0.96}) == "good"
    assert level("Accuracy") == "unknown"
    assert level("Consistency", found={"consistency": {"verdict": "not consistent: R is 9 x too small"}}) == "bad"
    assert (
        level("Consistency", found={"consistency": {"verdict": "not judged: nothing", "grade": "unknown"}}) == "unknown"
    )
    assert level("Observability", found={"observability": {"verdict": "observable"}}) == "good"
    assert level("Stability", found={"stability": {"verdict": "unstable"}}) == "bad"


def test_text_broken_for_a_terminal_is_whole_again() -> None:
    text = (
        "Verdict: all\n  well.\ncode: 3\n  innovations.\nweakly seen up to\n35 m.\n1. First, at\n   length.\n2. Second."
    )
    assert paragraphs(text) == [
        "Verdict: all well.", "code: 3 innovations.", "weakly seen up to 35 m.", "1. First, at length.", "2. Second.",
    ]  # fmt: skip
    assert paragraphs("") == []


def test_series_of_an_assessment_are_drawn_where_they_are_whole() -> None:
    found = {
        "observability": {
            "states": {"pos.e": {"degree": 0.9, "sigma": 1.0, "sigma_free": 10.0}, "clk.G": {"degree": None}},
            "epochs": {"epoch": [0, 1], "sigma_m": [1.0]},
        },
        "stability": {"product_norm": [1.0, None, 0.1], "seconds": 2.0},
    }
    drawn = lab_payload(found)
    assert drawn["degree"]["names"] == ["pos.e"]
    assert set(drawn) == {"degree", "product"}  # epochs and sigmas of different number are not
    assert lab_payload(None) == lab_payload({"observability": [], "stability": "no"}) == {}


def test_report_of_a_directory_and_of_a_position_file(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    write_results(handmade_solution(40), folder)
    assert main(["report", str(folder), "--truth", ",".join(map(str, HERE))]) == 0
    record = json.loads((folder / "run.json").read_text())
    assert record["files"][-1] == "report.html"
    assert "Errors against the truth" in (folder / "report.html").read_text(encoding="utf-8")
    written = write_report(folder / "solution.pos", None, tmp_path / "foreign.html")
    assert "solution.pos" in written.read_text(encoding="utf-8")
    (folder / "assess.json").write_text("[]")
    with pytest.raises(StarwiseError, match="not a JSON object"):
        write_report(folder)
    (folder / "assess.json").write_text(json.dumps({"stability": {"verdict": "stable", "explanation": "All decay."}}))
    assert "All decay." in write_report(folder).read_text(encoding="utf-8")


def test_new_results_remove_what_was_said_of_the_old(tmp_path: Path) -> None:
    write_results(handmade_solution(40), tmp_path, lambda: b"<html>")
    (tmp_path / "assess.json").write_text("{}")
    assert json.loads((tmp_path / "run.json").read_text())["files"][-1] == "report.html"
    write_results(handmade_solution(30), tmp_path)
    assert not (tmp_path / "assess.json").exists()
    assert not (tmp_path / "report.html").exists()
    assert read_solution(tmp_path).n_epochs == 30
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "report.html").write_text("mine")
    with pytest.raises(StarwiseError, match="did not write"):
        write_results(handmade_solution(30), foreign)
    assert (foreign / "report.html").read_text() == "mine"


def test_a_report_that_fails_leaves_the_old_result(tmp_path: Path) -> None:
    write_results(handmade_solution(40), tmp_path, lambda: b"old")

    def fails() -> bytes:
        raise OSError(28, "No space left on device")

    with pytest.raises(StarwiseError, match="No space left"):
        write_results(handmade_solution(30), tmp_path, fails)
    assert read_solution(tmp_path).n_epochs == 40
    assert (tmp_path / "report.html").read_bytes() == b"old"
    assert not list(tmp_path.glob(".*"))


def test_compare_on_a_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, seed in (("a", 1), ("b", 2)):
        write_results(handmade_solution(40, seed=seed), tmp_path / name)
    truth = ",".join(map(str, HERE))
    page = tmp_path / "both.html"
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--truth", truth, "-o", str(page)]) == 0
    out = capsys.readouterr().out.splitlines()
    assert max(map(len, out[:3])) <= 80
    assert out[1].startswith("a ")
    assert data_of(page.read_bytes())["reference"] == "truth"
    assert main(["compare", str(tmp_path / "a")]) == 2
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "a" / "solution.pos"), "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)) == {"a", "solution.pos"}


def test_study_takes_figures_of_its_own_folder_only(tmp_path: Path) -> None:
    (tmp_path / "fig.svg").write_text("<svg xmlns='http://www.w3.org/2000/svg'/>")
    (tmp_path / "report.md").write_text(
        "# A paper\n\n## One\n\n| a | b |\n|---|---|\n| 1 | 2 |\n\n![f](fig.svg)\n![x](/etc/passwd)\n"
    )
    text = write_study(tmp_path).read_text(encoding="utf-8")
    assert text.count("data:image/svg+xml;base64,") == 1
    assert "passwd" not in text
    assert "<td>1</td>" in text
    with pytest.raises(StarwiseError, match="cannot be read"):
        write_study(tmp_path / "none")
    with pytest.raises(StarwiseError, match="cannot be written"):
        write_page(b"", tmp_path / "none" / "x.html")


def test_numbers_beside_the_papers() -> None:
    row = {"scenario": 1, "method": "lsq", "horizontal_2rms_m": 5.0, "paper_horizontal_2rms_m": 10.0}
    (group,) = beside("s3ekf", {"table1": [row, {**row, "method": "ekf"}]})
    (pair,) = group.pairs
    assert (pair.ours, pair.paper, pair.ratio) == ("5.00", "10.0", "0.50")
    assert pair.at_paper == pytest.approx(2.0 * pair.at_ours, abs=0.02)  # places are rounded to 0.01 %
    assert pair.left + pair.width == pytest.approx(pair.at_paper)
    here = {"dynamic": {"rho": [0.1, -0.1]}, "paper": {"rho": [-0.4, 0.2]}}
    (group,) = beside("rdss_sins", here)
    assert group.zero > 0.0  # there are numbers on both sides
    assert [pair.ratio for pair in group.pairs] == ["", ""]
    assert beside("another", {"table1": []}) == beside("stability", {}) == []
