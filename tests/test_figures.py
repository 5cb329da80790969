"""Pictures of a solution carry its numbers: what is drawn is read back and compared."""

import builtins
import dataclasses
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.stats import chi2

import starwise
from handmade import HERE, handmade_solution
from starwise.analysis.accuracy import match
from starwise.constants import EPOCH_NO_SOLUTION, NS, ROW_GATED
from starwise.errors import StarwiseError
from starwise.frames import C_ne_enu, geodetic_from_ecef
from starwise.types import Solution, Truth

pytest.importorskip("matplotlib")
from starwise.report.figures_style import WIDTH_IN, broken, thinned

TRUTH = Truth(HERE)


def with_sky(n: int = 40) -> Solution:
    solution = handmade_solution(n)
    ledger = dict(solution.ledger)
    rng = np.random.default_rng(3)
    m = len(ledger["sv"])
    ledger["azimuth_rad"] = np.tile([0.3, 1.9, 3.5, 5.0], n) + np.repeat(np.linspace(0, 0.3, n), 4)
    ledger["innovation_var_m2"] = np.full(m, 1.0)
    ledger["cn0_dbhz"] = rng.uniform(30, 50, m)
    return dataclasses.replace(solution, ledger=ledger)


def drawn(figure: Any, gid: str) -> Any:
    """The one artist of a name."""
    found = [a for ax in figure.axes for a in (*ax.lines, *ax.collections, *ax.patches) if a.get_gid() == gid]
    assert len(found) == 1, (gid, found)
    return found[0]


def ellipses(figure: Any) -> list[Any]:
    return [p for p in figure.axes[0].patches if p.get_gid() == "ellipse"]


def test_track_is_where_the_solution_is() -> None:
    solution = handmade_solution()
    figure = solution.plot.track(TRUTH)
    keep = solution.status != EPOCH_NO_SOLUTION
    lat, lon, _ = geodetic_from_ecef(HERE)
    enu = (solution.pos_e[keep] - HERE) @ C_ne_enu(lat, lon).T
    x, y = drawn(figure, "estimate").get_data()
    assert np.allclose(x, enu[:, 0], atol=1e-6)  # m
    assert np.allclose(y, enu[:, 1], atol=1e-6)
    assert figure.axes[0].get_xlabel() == "east of 43.56000° N 1.48000° W (m)"
    assert figure.axes[0].get_ylabel() == "north (m)"
    assert figure.axes[0].get_aspect() == 1.0


def test_ellipses_hold_what_the_covariance_claims() -> None:
    solution = handmade_solution()
    figure = solution.plot.track(ellipses=5)
    shapes = ellipses(figure)
    assert len(shapes) == 5
    keep = np.flatnonzero(solution.has_position)
    origin = np.median(solution.pos_e[keep], axis=0)
    lat, lon, _ = geodetic_from_ecef(origin)
    turn = C_ne_enu(lat, lon)
    at = keep[np.linspace(0, len(keep) - 1, 5).round().astype(int)]
    for shape, i in zip(shapes, at, strict=True):
        cov = (turn @ solution.cov_pos[i] @ turn.T)[:2, :2]
        edge = shape.get_patch_transform().transform(np.array([[1.0, 0.0], [0.0, 1.0], [0.6, 0.8]])) - shape.center
        # every point of the edge is at the 95 % point of chi-square with 2 degrees of freedom
        assert np.allclose(np.einsum("ni,ij,nj->n", edge, np.linalg.inv(cov), edge), chi2.ppf(0.95, 2), rtol=1e-9)


def test_ellipses_too_small_to_see_are_enlarged_and_the_legend_says_so() -> None:
    solution = handmade_solution()
    moving = dataclasses.replace(solution, pos_e=solution.pos_e + np.outer(np.arange(40), [300.0, 0.0, 0.0]))
    legend = moving.plot.track().legends[0]
    assert any("95 % ellipse," in text.get_text() for text in legend.get_texts())
    shapes, larger = (ellipses(moving.plot.track(enlarge=factor)) for factor in (1.0, 20.0))
    assert larger[0].width == pytest.approx(20 * shapes[0].width)


def test_at_rest_the_picture_holds_the_ellipse() -> None:
    solution = handmade_solution()
    still = dataclasses.replace(solution, pos_e=HERE + 0.01 * (solution.pos_e - HERE))
    ax = still.plot.track(TRUTH, ellipses=1).axes[0]
    (shape,) = (p for p in ax.patches if p.get_gid() == "ellipse")
    box = shape.get_extents().transformed(ax.transData.inverted())
    assert ax.get_xlim()[0] < box.x0 < box.x1 < ax.get_xlim()[1]
    assert ax.get_ylim()[0] < box.y0 < box.y1 < ax.get_ylim()[1]


def test_a_wild_position_does_not_shrink_the_track_and_is_counted() -> None:
    solution = handmade_solution(400)
    pos = solution.pos_e.copy()
    pos[7] += 1e5
    figure = dataclasses.replace(solution, pos_e=pos).plot.track()
    assert np.ptp(figure.axes[0].get_xlim()) < 100.0  # m
    (told,) = [t.get_text() for t in figure.axes[0].texts]
    assert told.startswith("positions outside: ")
    assert 1 <= int(told.rpartition(" ")[2]) <= 8  # and a few at the rim


def test_errors_and_their_bands() -> None:
    solution = handmade_solution()
    figure = solution.plot.errors(TRUTH, columns=2)
    matched = match(solution, TRUTH)
    lat, lon, _ = geodetic_from_ecef(HERE)
    turn = C_ne_enu(lat, lon)
    cov = turn @ solution.cov_pos[matched.at] @ turn.T
    for i, ax in enumerate(figure.axes[:3]):
        line = next(item for item in ax.lines if item.get_gid() == "error")
        assert np.allclose(line.get_ydata(), matched.error_n[:, i], atol=1e-9)
        band = next(item for item in ax.collections if item.get_gid() == "1 sigma")
        top = band.get_paths()[0].vertices[:, 1].max()
        assert top == pytest.approx(np.sqrt(cov[:, i, i].max()), rel=1e-6)
        assert ax.get_ylabel() == f"{('east', 'north', 'up')[i]} (m)"
    assert figure.axes[2].get_xlabel().endswith("GPST (s)")
    # the calibration curve passes where `assess` counts
    curve = drawn(figure, "calibration 3").get_data()
    held = 100.0 * np.mean(matched.nees <= chi2.ppf(0.68, 3))
    assert np.interp(68.0, *curve) == pytest.approx(held, abs=100.0 / len(matched.at))  # one epoch


def test_sky_has_every_satellite_where_it_is_and_crosses_the_refused() -> None:
    solution = with_sky()
    figure = solution.plot.sky()
    for k, name in enumerate(("G05", "G31", "E07", "C60")):
        theta, r = drawn(figure, name).get_data()
        assert np.allclose(theta, solution.ledger["azimuth_rad"][k::4])
        assert np.allclose(r, 90.0 - np.degrees(solution.ledger["elevation_rad"][k::4]))
    crosses = drawn(figure, "refused").get_data()[0]
    assert len(crosses) == np.count_nonzero(solution.ledger["status"] == ROW_GATED) == 40
    ax = figure.axes[0]
    assert (ax.get_theta_direction(), ax.get_theta_offset()) == (-1, np.pi / 2)  # north up, east right
    assert {"G05", "G31", "E07", "C60"} <= {t.get_text() for t in ax.texts}


@pytest.mark.parametrize(("colour", "column"), [("cn0", "cn0_dbhz"), ("residual", "innovation_m")])
def test_sky_by_a_quantity(colour: Any, column: str) -> None:
    solution = with_sky()
    values = drawn(solution.plot.sky(colour=colour), colour).get_array()
    wanted = np.abs(solution.ledger[column])
    assert np.allclose(np.sort(values), np.sort(wanted[np.isfinite(wanted)]))


def test_nis_and_its_bounds() -> None:
    solution = handmade_solution()
    figure = solution.plot.nis(columns=2, probability=0.9)
    t, ratio = drawn(figure, "nis").get_data()
    assert np.allclose(ratio, solution.nis / 18)
    assert np.allclose(t, np.arange(40.0))
    edge = drawn(figure, "bounds").get_paths()[0].vertices[:, 1]
    assert edge.min() == pytest.approx(chi2.ppf(0.05, 18) / 18)
    assert edge.max() == pytest.approx(chi2.ppf(0.95, 18) / 18)
    bars = [p.get_height() for p in figure.axes[1].patches]
    assert sum(bars) == pytest.approx(100.0)


@pytest.mark.parametrize("columns", [1, 2])
def test_vectors_of_the_width_of_a_column(columns: Any, tmp_path: Path) -> None:
    solution = with_sky()
    for name, draw in (
        ("track", lambda: solution.plot.track(TRUTH, columns=columns)),
        ("errors", lambda: solution.plot.errors(TRUTH, columns=columns)),
        ("sky", lambda: solution.plot.sky(columns=columns)),
        ("nis", lambda: solution.plot.nis(columns=columns)),
    ):
        file, figure = tmp_path / f"{name}.svg", draw()
        figure.savefig(file)
        root = ElementTree.parse(file).getroot()
        assert not list(root.iter("{http://www.w3.org/2000/svg}image"))  # nothing drawn as pixels
        assert float(root.attrib["width"].removesuffix("pt")) == pytest.approx(72 * WIDTH_IN[columns], abs=0.1)
        first = file.read_bytes()
        draw().savefig(file)
        assert file.read_bytes() == first  # no date, no chance
        figure.savefig(tmp_path / f"{name}.pdf")
        assert b"/Subtype /Image" not in (tmp_path / f"{name}.pdf").read_bytes()


@pytest.mark.laws
def test_thinning_keeps_every_extreme_and_every_gap() -> None:
    rng = np.random.default_rng(1)
    y = rng.normal(size=100_000)
    y[[17, 50_001, 99_990]] = [90.0, -80.0, 70.0]
    y[30_000:30_500] = np.nan
    at = thinned(y, 1000)
    assert len(at) <= 1100
    assert {17, 50_001, 99_990, 0, len(y) - 1} <= set(at.tolist())
    assert np.isnan(y[at]).any()
    assert (np.diff(at) > 0).all()


def test_lines_break_at_gaps() -> None:
    t = np.concatenate([np.arange(10), np.arange(100, 110)]) * NS
    t2, y2 = broken(t, np.arange(20.0))
    assert np.isnan(y2[10])
    assert t2[10] == 9 * NS + 1
    assert len(y2) == 21


def test_bad_input_is_one_line() -> None:
    solution = handmade_solution()
    with pytest.raises(StarwiseError, match="no ledger with directions"):
        solution.plot.sky()
    nothing = dataclasses.replace(solution, pos_e=np.full((40, 3), np.nan), nis=np.full(40, np.nan))
    for draw in (nothing.plot.track, lambda: nothing.plot.errors(TRUTH), nothing.plot.nis):
        with pytest.raises(StarwiseError, match="no epoch"):
            draw()
    elsewhen = Truth(np.tile(HERE, (3, 1)), np.arange(3) * NS)
    with pytest.raises(StarwiseError, match="no epoch of the solution has a truth"):
        solution.plot.errors(elsewhen)
    with pytest.raises(StarwiseError, match="no such width"):
        solution.plot.track(columns=3)
    with pytest.raises(StarwiseError, match="not a probability"):
        solution.plot.nis(probability=95)
    with pytest.raises(StarwiseError, match="no such colouring"):
        with_sky().plot.sky(colour="red")


def test_a_covariance_that_is_not_known_draws_no_ellipse_and_no_band() -> None:
    solution = dataclasses.replace(handmade_solution(), cov_pos=np.full((40, 3, 3), np.nan))
    assert not ellipses(solution.plot.track())
    assert solution.plot.errors(TRUTH, columns=2).axes


def test_without_matplotlib_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__
    for name in [key for key in sys.modules if key.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert builtins.__import__ is real
    with pytest.raises(StarwiseError, match=r"pip install 'starwise\[plot\]'"):
        handmade_solution().plot.track()


@pytest.mark.real
def test_a_day_of_real_measurements_stays_small(shared_data: Path, tmp_path: Path) -> None:
    """Nor does it take long: vectors of a day are thinned."""
    folder = shared_data / "static" / "kiru_2024090"
    files = [next(folder.glob(f"*{kind}.rnx")) for kind in ("_MO", "_MN")]
    solution = starwise.solve(*files, method="lsq", interval_s=60.0)
    for name, figure in (("sky", solution.plot.sky()), ("nis", solution.plot.nis()), ("track", solution.plot.track())):
        file = tmp_path / f"{name}.pdf"
        figure.savefig(file)
        assert file.stat().st_size < 400_000, name  # bytes: what a journal's printer takes without a murmur
