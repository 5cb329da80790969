"""What a report costs: a day file solved with and without it, and its page opened in Chromium.

python benchmarks/report.py [runs]          (5 by default; alternately, in fresh processes; medians)

Data: shared measurements, see tests/conftest.py. Times of a busy machine say little: read the differences and the
processor times. The page is timed in Chromium's own clock of its main thread, so that other programs do not count.
"""

import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from datasets import DATA

DAY = ("static/nl_2021001/delf0010.21d", "static/nl_2021001/AMEL00NLD_R_20210010000_01D_MN.rnx")
CHROMIUM = "/usr/bin/chromium"


def solve(folder: Path, *options: str) -> tuple[float, float]:
    """Wall and processor seconds of a whole process."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    files = [str(DATA / name) for name in DAY]
    subprocess.run([sys.executable, "-m", "starwise", "solve", *files, "-o", str(folder), "-q", *options], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.perf_counter() - began, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def opened(page: Path) -> dict[str, float]:
    """Main thread's seconds until the page is loaded, and until every panel is drawn; wall seconds of the same."""
    from playwright.sync_api import sync_playwright

    out = {}
    with sync_playwright() as playwright:
        options = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        tab = browser.new_page(viewport={"width": 1440, "height": 900})
        client = tab.context.new_cdp_session(tab)
        client.send("Performance.enable", {"timeDomain": "threadTicks"})

        def busy() -> float:
            found = client.send("Performance.getMetrics")["metrics"]
            return {item["name"]: item["value"] for item in found}["TaskDuration"]

        began, start = time.perf_counter(), busy()
        tab.goto(page.resolve().as_uri())
        out["load_s"], out["load_wall_s"] = busy() - start, time.perf_counter() - began
        tab.wait_for_selector("html[data-ready='1']", timeout=60_000)
        out["drawn_s"], out["drawn_wall_s"] = busy() - start, time.perf_counter() - began
        browser.close()
    return out


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        solve(place / "warm")
        plain, full = [], []
        for _ in range(runs):
            plain.append(solve(place / "plain", "--no-report"))
            full.append(solve(place / "full"))
        page = place / "full" / "report.html"
        for name, times in (("without a report", plain), ("with a report", full)):
            wall, cpu = (statistics.median(column) for column in zip(*times, strict=True))
            print(f"{name:18s} wall {wall:6.2f} s   processor {cpu:6.2f} s   (median of {runs})")
        pairs = zip(plain, full, strict=True)
        more = [tuple(b - a for a, b in zip(one, other, strict=True)) for one, other in pairs]
        wall, cpu = (statistics.median(column) for column in zip(*more, strict=True))
        print(f"{'the report costs':18s} wall {wall:6.2f} s   processor {cpu:6.2f} s   (median of the differences)")
        print(f"{'size':18s} {page.stat().st_size / 1e6:.2f} MB")
        seen = opened(page)
        print(f"{'page loaded':18s} wall {seen['load_wall_s']:6.2f} s   main thread {seen['load_s']:6.2f} s")
        print(f"{'all panels drawn':18s} wall {seen['drawn_wall_s']:6.2f} s   main thread {seen['drawn_s']:6.2f} s")


if __name__ == "__main__":
    main()
