"""Reports opened in a browser: every panel has data, hover, selection and keys work, nothing complains, printing."""

import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from handmade import HERE, handmade_solution
from starwise import api
from starwise.analysis.accuracy import assess
from starwise.config_inertial import InertialConfig
from starwise.demo import run_demo
from starwise.estimators.ins import loose
from starwise.estimators.ins_tight import fixes_of
from starwise.io.imu import read_imu
from starwise.io.pos import read_pos
from starwise.io.results import read_solution, write_results
from starwise.io.truth import read_truth
from starwise.report.html import Compared, compare_page, run_page, write_page, write_report, write_study
from starwise.studies.adaptive_federated import reproduce_adaptive_federated
from starwise.studies.simulating import simulate_files
from starwise.types import Truth

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not here (apt-get install chromium)")
LOAD_S = 2.0
"""The page with words and numbers, in processor time of its main thread: other programs do not count."""
DRAWN_S = 12.0
"""All panels; three seconds on a machine with four programs for each core."""
DRAWN = """() => [...document.querySelectorAll('.plot')].map((box) => [box.dataset.panel, box.dataset.drawn === '1',
  [...box.querySelectorAll('.gd .trace path, .gd .trace .point, .gd .textpoint, .gd .bars path')]
    .filter((p) => p.tagName !== 'path' || (p.getAttribute('d') || '').length > 9).length])"""


@dataclass
class Opened:
    """A page with what it said and asked for."""

    tab: Any
    said: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    load_s: float = 0.0
    drawn_s: float = 0.0


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    sync = pytest.importorskip("playwright.sync_api")
    with sync.sync_playwright() as playwright:
        options = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        yield running
        running.close()


def busy(client: Any) -> float:
    """Processor time of a page's main thread, s."""
    metrics = client.send("Performance.getMetrics")["metrics"]
    return float(next(item["value"] for item in metrics if item["name"] == "TaskDuration"))


def opened(browser: Any, file: Path, ready: bool = True, **how: Any) -> Opened:
    how.setdefault("viewport", {"width": 1440, "height": 900})
    page = Opened(browser.new_context(**how).new_page())
    page.tab.on("console", lambda message: page.said.append(message.text))
    page.tab.on("pageerror", lambda error: page.said.append(str(error)))
    page.tab.on("request", lambda request: page.asked.append(request.url))
    client = page.tab.context.new_cdp_session(page.tab)
    client.send("Performance.enable", {"timeDomain": "threadTicks"})
    before = busy(client)
    page.tab.goto(file.resolve().as_uri())
    page.load_s = busy(client) - before
    if ready:
        page.tab.wait_for_selector("html[data-ready='1']", timeout=90_000)
        page.drawn_s = busy(client) - before
    return page


def until(page: Opened, condition: str) -> None:
    """Wait until a condition holds; the page's policy forbids what Playwright would do."""
    for _ in range(200):
        if page.tab.evaluate(condition):
            return
        page.tab.wait_for_timeout(50)
    raise AssertionError(condition)


def close(page: Opened) -> None:
    assert page.said == []
    assert all(url.startswith(("file:", "data:", "blob:")) for url in page.asked)
    assert sum(url.startswith("file:") for url in page.asked) == 1
    page.tab.context.close()


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo")
    run_demo(folder)
    return folder / "report.html"


@pytest.fixture(scope="module")
def kiru(shared_data: Path, truth: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, data = tmp_path_factory.mktemp("kiru"), shared_data / "static" / "kiru_2024090"
    names = ("KIRU00SWE_R_20240900000_01D_30S_MO.rnx", "KIR000SWE_R_20240900000_01D_MN.rnx")
    api.solve(*(data / name for name in names), output=folder, end="2024-03-30T01:00:00")
    known = truth["KIRU_2024.244"]
    point = ",".join(map(str, known["marker_ecef_m"]))
    return write_report(folder, point, antenna_up_m=known["arp_height_above_marker_m"])


@pytest.fixture(scope="module")
def urban(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, data = tmp_path_factory.mktemp("urban"), shared_data / "kinematic" / "urbannav_tst_20190428"
    files = [*data.glob("*.obs"), *data.glob("*.19[bn]")]
    api.solve(*files, output=folder, dynamics="vehicle", start="2019-04-28T12:57:00", end="2019-04-28T13:07:00")
    return write_report(folder, str(data / "groundTruth_TST.csv"))


@pytest.fixture(scope="module")
def car(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, data = tmp_path_factory.mktemp("car"), shared_data / "imu" / "rtklibexplorer_drive_0708"
    fixes = fixes_of(read_pos(data / "gnss_1934_sf.pos"))
    options = {
        "lever_arm_m": [0.0, -0.05, 0.0], "velocity_lag_s": 0.135, "vehicle": {"constraint": True, "rest": True},
    }  # fmt: skip
    run = loose(fixes, read_imu(data / "imu_1934.csv", "rtklibexplorer-drive"), InertialConfig.from_dict(options))
    return write_page(run_page(run.solution, title="car"), folder / "report.html")


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("paper")
    reproduce_adaptive_federated(folder, 1, None, 1)
    return write_study(folder, "adaptive_federated")


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated")
    simulate_files("urban-drive", folder)
    return folder / "report.html"


@pytest.fixture(scope="module")
def both(demo: Path) -> Path:
    truth = read_truth(str(next((demo.parent / "simulated").glob("*_truth.csv"))))
    items = []
    for name in ("lsq", "s3ekf"):
        solution = read_solution(demo.parent / name, ledger=False)
        items.append(Compared(name, solution, assess(solution, truth)))
    return write_page(compare_page(items, truth), demo.parent / "compare.html")


@pytest.fixture(scope="module")
def page(demo: Path, browser: Any) -> Iterator[Opened]:
    """The demo's report, opened once; each test leaves it as it was."""
    shared = opened(browser, demo)
    yield shared
    close(shared)


PAGES = {
    "demo": {"track", "motion", "errors", "cdf", "calibration", "sky", "availability", "residuals", "persat", "nis",
             "rho", "geometry", "clocks"},
    "kiru": {"track", "motion", "errors", "cdf", "calibration", "sky", "availability", "residuals", "persat", "nis",
             "rho", "geometry", "clocks"},
    "urban": {"track", "motion", "errors", "cdf", "calibration", "sky", "availability", "residuals", "persat", "nis",
              "rho", "geometry", "clocks"},
    "car": {"track", "motion", "claimed", "nis", "attitude", "biases"},
    "simulated": {"track", "motion", "attitude", "sky", "availability", "geometry"},
    "both": {"cmp-track", "cmp-height", "cmp-errors", "cmp-cdf", "cmp-count"},
}  # fmt: skip


@pytest.mark.parametrize("name", list(PAGES))
def test_every_panel_has_data(name: str, browser: Any, request: pytest.FixtureRequest) -> None:
    file = request.getfixturevalue(name)
    assert file.stat().st_size < 8e6
    page = opened(browser, file)
    assert page.load_s < LOAD_S
    assert page.drawn_s < DRAWN_S
    panels = page.tab.evaluate(DRAWN)
    assert {panel for panel, _, _ in panels} == PAGES[name]
    for panel, drawn, marks in panels:
        assert drawn, panel
        assert marks > 0, panel
    assert page.tab.evaluate("document.scrollingElement.scrollWidth <= innerWidth")
    close(page)


def test_paper_has_its_tables_and_figures(paper: Path, browser: Any) -> None:
    page = opened(browser, paper)
    assert page.tab.locator("table").count() >= 5
    figures = page.tab.evaluate("[...document.querySelectorAll('.study img')].map((i) => [i.complete, i.naturalWidth])")
    assert len(figures) == (paper.parent / "report.md").read_text(encoding="utf-8").count("![") > 0
    assert all(complete and width > 0 for complete, width in figures)
    close(page)


def test_hover_tells_epoch_satellites_and_ledger(page: Opened) -> None:
    for panel in ("motion", "errors", "nis", "geometry", "availability", "residuals"):
        page.tab.locator(f"#panel-{panel}").scroll_into_view_if_needed()
        box = page.tab.locator(f"[data-panel={panel}]").bounding_box()
        page.tab.mouse.move(box["x"] + 0.32 * box["width"], box["y"] + 0.5 * box["height"])
        page.tab.mouse.move(box["x"] + 0.33 * box["width"], box["y"] + 0.5 * box["height"])
        until(page, "document.querySelector('.tip.on') !== null")
        text = page.tab.locator(".tip").inner_text()
        assert re.search(r"08:0\d:\d\d", text), (panel, text)
        assert re.search(r"\d+ of \d+ satellites used", text), (panel, text)
    # at 08:05 a satellite lies, and the ledger says that it was not used
    page.tab.evaluate(
        "(s) => { s.value = 300; s.dispatchEvent(new Event('input')); }", page.tab.query_selector("#slider")
    )
    until(page, "document.documentElement.dataset.epoch === '300'")
    assert "08:05:00" in page.tab.locator("#when").inner_text()
    assert re.search(r"filter's gate\s+E01", page.tab.locator("#why").inner_text())
    assert "k-test" in page.tab.locator("[data-sat=E01]").get_attribute("class")
    page.tab.keyboard.press("Escape")


def test_selection_is_seen_in_every_panel_of_satellites(page: Opened) -> None:
    page.tab.locator("[data-sat=E01]").click()
    until(page, "document.documentElement.dataset.satellite === 'E01'")
    for panel in ("sky", "availability", "residuals", "persat"):
        found = page.tab.locator(f"[data-panel={panel}] .over .sel, [data-panel={panel}] .over .row")
        assert found.count() == 1, panel
        assert "dim" in page.tab.locator(f"#panel-{panel}").get_attribute("class"), panel
    for panel in ("motion", "errors", "nis", "geometry", "clocks"):  # they show when it was used
        assert page.tab.locator(f"[data-panel={panel}] .over .strip").count() > 1, panel
    assert len(page.tab.locator("[data-panel=track] .over .sel").get_attribute("d")) > 1000
    assert "E01" in page.tab.locator("#one").inner_text()
    # a click on a bar selects, too
    page.tab.locator("#panel-availability").scroll_into_view_if_needed()
    box = page.tab.locator("[data-panel=availability]").bounding_box()
    page.tab.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.4 * box["height"])
    until(page, "!['', 'E01'].includes(document.documentElement.dataset.satellite)")
    page.tab.keyboard.press("Escape")
    until(page, "document.documentElement.dataset.satellite === ''")
    assert page.tab.locator(".over .sel, .over .row, .over .strip").count() == 0


def test_keys_zoom_and_colours(page: Opened) -> None:
    page.tab.locator("[data-panel=motion]").focus()
    for key, epoch in (
        ("Home", 0),
        ("ArrowRight", 1),
        ("Shift+ArrowRight", 11),
        ("ArrowLeft", 10),
        ("End", 600),
        ("Home", 0),
    ):
        page.tab.keyboard.press(key)
        until(page, f"document.documentElement.dataset.epoch === '{epoch}'")
    page.tab.evaluate("document.activeElement.blur()")  # as when the page has just been opened
    for key, epoch in (("Shift+ArrowRight", 10), ("ArrowLeft", 9)):
        page.tab.keyboard.press(key)
        until(page, f"document.documentElement.dataset.epoch === '{epoch}'")
    assert page.tab.locator("[data-panel=errors] .cursor").count() == 1
    # what is dragged over in one panel is the range of all
    box = page.tab.locator("[data-panel=motion]").bounding_box()
    page.tab.locator("#panel-motion").scroll_into_view_if_needed()
    box = page.tab.locator("[data-panel=motion]").bounding_box()
    page.tab.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 60)
    page.tab.mouse.down()
    page.tab.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 62, steps=4)
    page.tab.mouse.up()
    until(page, "document.documentElement.classList.contains('zoomed')")
    ranges = "(p) => document.querySelector(`[data-panel=${p}] .gd`)._fullLayout.xaxis.range.map((v) => +new Date(v))"
    assert page.tab.evaluate(ranges, "motion") == page.tab.evaluate(ranges, "nis")
    page.tab.keyboard.press("Escape")
    until(page, "!document.documentElement.classList.contains('zoomed')")
    ground = "getComputedStyle(document.body).backgroundColor"
    light = page.tab.evaluate(ground)
    page.tab.locator("#theme").click()
    assert page.tab.evaluate(ground) != light
    for switch in page.tab.locator("[data-switch] button").all():
        switch.click()
    page.tab.locator("#theme").click()
    assert page.tab.evaluate(ground) == light


def test_phone_in_the_dark(demo: Path, browser: Any) -> None:
    how = {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "has_touch": True, "color_scheme": "dark"}
    page = opened(browser, demo, **how)
    assert page.tab.evaluate("document.documentElement.dataset.theme") == "dark"
    assert page.tab.evaluate("document.documentElement.scrollWidth") <= 390
    assert all(drawn and marks for _, drawn, marks in page.tab.evaluate(DRAWN))
    page.tab.locator(".fold").tap()
    page.tab.locator("[data-sat=G12]").tap()
    until(page, "document.documentElement.dataset.satellite === 'G12'")
    close(page)


def test_print_draws_every_panel(demo: Path, browser: Any, tmp_path: Path) -> None:
    page = opened(browser, demo, ready=False, color_scheme="dark")
    page.tab.pdf(path=tmp_path / "report.pdf", prefer_css_page_size=True)
    assert all(drawn and marks for _, drawn, marks in page.tab.evaluate(DRAWN))
    if shutil.which("pdftotext"):
        command = ["pdftotext", "-layout", tmp_path / "report.pdf", "-"]
        text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        for title in page.tab.locator("figure h3").all_inner_texts():
            assert title in text
        assert "SHA-256" in text
    close(page)


def test_markup_in_a_marker_is_text(browser: Any, tmp_path: Path) -> None:
    evil = "<script>window.hacked=1</script><img src=x onerror='window.hacked=2'>"
    base = handmade_solution(40)
    provenance = {
        **base.provenance, "station": {"marker": evil}, "notes": [evil],
        "inputs": [{"kind": "x", "path": evil, "bytes": 1, "sha256": "0"}],
    }  # fmt: skip
    solution = replace(base, provenance=provenance)
    found = {
        "consistency": {"verdict": evil, "explanation": evil},
        "observability": {
            "states": {evil: {"degree": 0.9, "sigma": 1.0, "sigma_free": 9.0}},
            "epochs": {"epoch": [0, 20, 39], "sigma_m": [1.0, 30.0, 2.0]},
        },
        "stability": {"product_norm": [1.0, 0.5, 0.1], "seconds": 39.0},
    }
    write_results(solution, tmp_path, lambda: run_page(solution, Truth(HERE, source=evil), found))
    stats = assess(solution, Truth(HERE))
    compare = write_page(
        compare_page([Compared(evil, solution, stats), Compared("b", base, stats)]), tmp_path / "c.html"
    )
    for file in (tmp_path / "report.html", compare):
        page = opened(browser, file)
        assert page.tab.evaluate("window.hacked === undefined")
        assert evil in page.tab.locator("body").inner_text()
        panels = {panel: marks for panel, _, marks in page.tab.evaluate(DRAWN)}
        assert all(panels.values()), panels
        assert file == compare or {"obs-degree", "obs-sigma", "stab-product"} <= set(panels)
        close(page)
