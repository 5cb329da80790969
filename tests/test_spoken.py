"""What the laboratory and the tables say, in words and numbers that people can read."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import starwise
from starwise.analysis.lab.causes_size import _noise_finding
from starwise.analysis.words import spoken
from starwise.cli_report import _table
from starwise.report.html.diagnosis import lab_payload
from starwise.report.inertial import _estimate
from starwise.report.text import _cell

ROW: dict[str, Any] = {"epochs_solved": 9, "epochs_flagged": 0, "rms_2d_m": 596.9, "rms_3d_m": 597.3}
ROW |= {"name": "urban", "p95_3d_m": 1029.2, "sigma_3d_mean_m": 7.8, "coverage_95": 0.0}


def test_directions_are_told_in_words() -> None:
    assert spoken("pos.u + 0.89 clk.G + 0.34 pos.e") == "up + 0.89 clock of G + 0.34 east"
    assert spoken("isd.C + 0.14 isb.E") == "drift of C's clock offset + 0.14 clock offset of E"
    assert spoken("vel.n + att.d + bg.x") == "velocity north + attitude down + gyro bias x"
    assert spoken("slope.1, bias.G.2W") == "slope.1, bias.G.2W"


def test_without_a_truth_no_share_inside_is_told() -> None:
    head, row, foot = _table([ROW], known=False)
    assert row.split()[-1] == "-"
    assert "scatter" in foot
    assert _table([ROW], known=True)[1].split()[-1] == "0.00"
    assert all("lengths in m" in _table([ROW], known)[-1] for known in (True, False))
    assert max(map(len, [head, row, foot, *_table([ROW], known=True)])) <= 80


def test_huge_numbers_do_not_run_into_each_other() -> None:
    assert len(_cell(-6383718.147, "m")) == len(_cell(2.9489459929571031e13, " ")) == len(_cell(None, "m")) == 14
    assert _cell(5.0794, "m").split() == ["5.079", "m"]


def test_an_estimate_at_its_end_has_no_figures() -> None:
    case = cast("Any", SimpleNamespace(table=SimpleNamespace(gate_probability=0.0)))
    end, inside = (_noise_finding(case, "code", ratio, 0.0, 1.0) for ratio in (1e-4, 0.05))
    assert "10000" not in end.words
    assert "0.01" not in end.cure
    assert "20 x too large" in inside.words


def test_the_curve_ends_where_the_words_do() -> None:
    stability = {"product_norm": [1.0, 0.5, 0.08], "product_norm_P": [1.0, 0.6, 0.25], "seconds": 2.0}
    assert lab_payload({"stability": stability})["product"]["norm"] == [1.0, 0.6, 0.25]


def test_a_truth_of_another_place_is_doubted(tmp_path: Path) -> None:
    lines = ["% GPST lat lon h Q ns sdn sde sdu"]
    lines += [f"2024/03/30 12:00:{k:02d}.000 48.1 11.5 560.0 5 8 1.0 1.0 1.0 0 0 0 0 0" for k in range(5)]
    pos = tmp_path / "a.pos"
    pos.write_text("\n".join(lines) + "\n")
    swapped = starwise.assess(pos, "11.5,48.1,560.0", parts=())
    assert any("km away" in note for note in swapped["notes"])
    right = starwise.assess(pos, "48.1,11.5,560.0", parts=())
    assert not any("km away" in note for note in right["notes"])
    assert np.isclose(right["rms_3d_m"], 0.0, atol=1e-3)  # m: nine decimals of degrees


def test_epochs_without_a_truth_are_told(tmp_path: Path) -> None:
    head = "% GPST lat lon h Q ns sdn sde sdu"
    for name, seconds in (("a", range(5)), ("b", range(3))):
        rows = [f"2024/03/30 12:00:{k:02d}.000 48.1 11.5 560.0 5 8 1.0 1.0 1.0 0 0 0 0 0" for k in seconds]
        (tmp_path / f"{name}.pos").write_text("\n".join([head, *rows]) + "\n")
    report = starwise.assess(tmp_path / "a.pos", tmp_path / "b.pos", parts=())
    assert report["epochs_compared"] == 3
    assert any(note.startswith("2 solved epochs have no truth") for note in report["notes"])
    assert pytest.approx(0.0, abs=1e-6) == report["rms_3d_m"]  # m: the same numbers


def test_no_sigma_is_told_as_nought() -> None:
    small, large = _estimate("accelerometer bias z", 0.017, 0.0004, "m/s^2"), _estimate("yaw", 40.41, 0.583, "deg")
    assert "+- 0.00040" in small
    assert "+- 0.583" in large
    assert small.index(".") == large.index(".")
