"""Picture of a report for the README: ``python tools/screenshot.py [report.html] [docs/img/report.png]``.

Without arguments the demo is run and its report is shown. Needs Chromium and playwright; nothing is downloaded.
"""

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CHROMIUM = "/usr/bin/chromium"
SIZE = {"width": 1440, "height": 1310}
EPOCH, SATELLITE = 300, "E01"


def main() -> None:
    page = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    picture = Path(sys.argv[2]) if len(sys.argv) > 2 else ROOT / "docs" / "img" / "report.png"
    with tempfile.TemporaryDirectory() as folder:
        if page is None:
            from starwise.demo import run_demo

            run_demo(folder)
            page = Path(folder) / "report.html"
        shoot(page, picture)
    print(f"{picture}  ({picture.stat().st_size / 1e3:.0f} kB)")


def shoot(page: Path, picture: Path) -> None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        options = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        tab = browser.new_page(viewport=SIZE, color_scheme="light")
        tab.goto(page.resolve().as_uri())
        tab.wait_for_selector("html[data-ready='1']", timeout=90_000)
        slider = tab.query_selector("#slider")
        tab.evaluate(f"(s) => {{ s.value = {EPOCH}; s.dispatchEvent(new Event('input')); }}", slider)
        if tab.locator(f"[data-sat={SATELLITE}]").count():
            tab.locator(f"[data-sat={SATELLITE}]").click()
        tab.mouse.move(5, 500)
        tab.wait_for_timeout(400)
        picture.parent.mkdir(parents=True, exist_ok=True)
        tab.screenshot(path=picture)
        browser.close()


if __name__ == "__main__":
    main()
