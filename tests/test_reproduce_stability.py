"""The stability paper's systems: what it states, and what its spectral radii hide."""

import json
from pathlib import Path
from typing import Any

import pytest

from starwise import cli
from starwise.studies.stability import PAPER_DEGREE, case, degrees, growth_by_clock, south
from starwise.studies.stability_scene import BESIDE, MODELS, Numbers, Scene

Case = dict[str, Any]


@pytest.fixture(scope="module")
def cases() -> dict[tuple[int, str], Case]:
    scene = Scene(37.0)  # no latitude of the report
    return {(m.satellites, m.name): case(scene, m)[0] for m in (*MODELS, *BESIDE)}


def test_three_satellites(cases: dict[tuple[int, str], Case]) -> None:
    for model in ("plain", "improved"):
        c = cases[3, model]
        assert c["controllable"]
        assert c["observable"]
        assert c["rank"] == 11
        assert c["spectral_radius_max"] < 1.0
        assert c["verdict"] == c["lemma1"] == "asymptotically stable"
        assert c["frozen_radius"] < 1.0
        # without a prior 600 s of measurements know nearly as much
        assert c["sigma_position_m"] <= c["bound_position_m"] < 1.1 * c["sigma_position_m"]


def test_two_satellites_without_clock(cases: dict[tuple[int, str], Case]) -> None:
    c, nine = cases[2, "plain_no_clock"], cases[2, "plain_9_states"]
    assert c["spectral_radius_max"] == pytest.approx(1.0, abs=1e-12)
    assert not c["observable"]
    assert c["unobservable"] == ["clk", "drift"]
    assert c["verdict"] == "stable"
    assert nine["spectral_radius_late"] < 0.99
    assert nine["observable"]
    assert nine["verdict"] == "asymptotically stable"
    # the clock has nothing to do with it: the positions are the same
    assert nine["sigma_position_m"] == pytest.approx(c["sigma_position_m"], rel=1e-9)


def test_two_satellites_with_clock(cases: dict[tuple[int, str], Case]) -> None:
    c = cases[2, "improved"]
    assert c["controllable"]
    assert not c["observable"]
    assert c["rank"] == 10
    assert len(c["unobservable"]) == 1
    assert "clk" in c["unobservable"][0]
    assert "pos.n" in c["unobservable"][0]
    assert 1.0 - 1e-6 < c["spectral_radius_late"] < 1.0
    assert c["verdict"] == "stable"
    assert c["bound_position_m"] > 1e3 * c["sigma_position_m"]  # infinite, or as good as


def test_growth_that_the_radius_does_not_show() -> None:
    rows = growth_by_clock()
    assert all(r["spectral_radius_max"] < 1.0 for r in rows)
    assert rows[-1]["growth_of_position"] > 10.0
    assert [r["growth_of_position"] for r in rows] == sorted(r["growth_of_position"] for r in rows)


def test_degree_of_observability() -> None:
    found = degrees(Scene(duration_s=600.0), 1)
    d = found["degree"]
    assert set(d) == set(PAPER_DEGREE)
    assert d["x"] > d["y"] > d["z"]
    assert all(0.0 <= v < 1.0 for v in d.values())
    # nine ways to read the paper's formula, and none gives its table
    assert len(found["degree_windows"]) == 9
    assert max(w["cosine"] for w in found["degree_windows"]) < 0.95


def test_radii_above_one_exist_but_are_no_matter_of_latitude() -> None:
    rows = south()
    assert not any(r["above_one_s"] for r in rows if r["settings"] == "study")
    assert all(r["above_one_s"] for r in rows if r["settings"] == "quiet")


def test_command_writes_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    from starwise.studies import stability, stability_scene

    monkeypatch.setattr(stability, "LATITUDES", (40.0,))
    monkeypatch.setattr(stability, "SOUTH", (40.0, 30.0))
    monkeypatch.setattr(stability, "CLOCKS", (1e-10,))
    monkeypatch.setattr(stability, "BESIDE", stability_scene.BESIDE[:1])
    base = tmp_path / "out"
    assert cli.run(["reproduce", "stability", "-o", str(base), "--runs", "1", "--workers", "1", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result == json.loads((base / "reproduce.json").read_text())
    wanted = {
        "satellites", "model", "latitude_deg", "controllable", "observable", "rank", "spectral_radius_max",
        "spectral_radius_late", "verdict",
    }  # fmt: skip
    assert all(wanted <= set(c) for c in result["cases"])
    burst = {"satellites", "model", "recovery", "largest_survived_m", "recovery_s"}
    assert all(burst <= set(b) for b in result["bursts"])
    assert {b["recovery"] for b in result["bursts"]} == {True, False}
    assert result["settings"]["numbers"]["range_m"] == Numbers().range_m
    for name in ("report.md", "cases.csv", "radii.csv", "degree.csv", "bursts.csv", "bursts.parquet"):
        assert (base / name).stat().st_size > 100
    report = (base / "report.md").read_text()
    assert "clk" in report
    assert "asymptotically stable" in report
