"""The main job on a simulated drive: simulated into files, solved from those files, judged against the truth.

The drive is the scenario ``urban-drive`` of the package: ten minutes between houses at 1 Hz under four systems, with a
street canyon, a satellite that drifts away, a tunnel, and a receiver that sets its clock.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from starwise import api
from starwise.io.results import prepare_directory, read_solution
from starwise.report.text import solve_text

METHODS = ("lsq", "s3ekf")
"""Compared by the demo; the last one's files are shown."""
SCENARIO = "urban-drive"
SIMULATED = "simulated"
"""Folder of the simulation's files in the demo's directory."""


@dataclass(frozen=True)
class Outcome:
    """What the demo has to say: text for people, a record for machines."""

    text: str
    record: dict[str, Any]


def run_demo(
    directory: str | Path, progress: Callable[[str, float], None] | None = None, report: bool = True
) -> Outcome:
    """Simulate a drive, solve its files and assess the solutions.

    Parameters
    ----------
    directory : path-like
        Where the results go: the simulation's files, a directory per method, and the report.
    progress : callable, optional
    report : bool
        Write ``report.html``: the solution against its truth.

    Raises
    ------
    StarwiseError
        The directory cannot be written.
    """
    import time
    from concurrent.futures import ThreadPoolExecutor

    from starwise.io.truth import read_truth
    from starwise.sim.run import simulate
    from starwise.sim.scenario import load_scenario
    from starwise.sim.writers import write_files
    from starwise.warmup import COMPILING, ensure_warm

    folder = Path(directory)
    say = progress or (lambda _what, _fraction: None)
    began = time.perf_counter()
    prepare_directory(folder / METHODS[-1])  # before anybody waits for kernels
    say("simulating", 0.0)
    with ThreadPoolExecutor(1) as pool:  # the simulator's kernels are compiled here, meanwhile others elsewhere
        warm = pool.submit(ensure_warm, lambda: say(COMPILING, 0.0))
        scenario = load_scenario(SCENARIO, {"output.truth": "csv", "output.imu": False})
        files = write_files(simulate(scenario), folder / SIMULATED)
        warm.result()
    truth = read_truth(str(files["truth"]))
    reports: dict[str, dict[str, Any]] = {}
    for i, method in enumerate(METHODS):
        solution = api.solve(
            files["observations"],
            files["navigation"],
            output=folder / method,
            progress=lambda what, part, i=i: say(what, (1 + i + part) / (1 + len(METHODS))),  # type: ignore[misc]
            method=method,
            report=False,
        )
        reports[method] = api.assess(solution, truth, parts=())
    shown = read_solution(folder / METHODS[-1], ledger=False)
    if report:
        from starwise.report.html import write_report

        say("report", 0.98)
        page = write_report(folder / METHODS[-1], truth, folder / "report.html", title=SCENARIO)
    say("done", 1.0)
    text = solve_text(shown.provenance, folder / METHODS[-1], time.perf_counter() - began)
    record = {
        "directory": str(folder),
        "scenario": SCENARIO,
        "simulated": {kind: str(path) for kind, path in files.items()},
        "assessment": reports,
    }
    if report:
        record["report"] = str(page)
    head = [f"simulated     {SCENARIO} (seed {scenario.seed}): {scenario.description}"]
    return Outcome("\n".join([*head, text, "", *_table(reports), "", *_where(folder, report)]), record)


def _table(reports: dict[str, dict[str, Any]]) -> list[str]:
    rows = [f"against the truth {'':4}" + "".join(f"{method:>12}" for method in reports)]
    for key, label in (
        ("epochs_solved", "epochs solved"),
        ("epochs_flagged", "of them flagged"),
        ("rms_2d_m", "RMS 2D, m"),
        ("rms_3d_m", "RMS 3D, m"),
        ("p95_3d_m", "95 % 3D, m"),
        ("coverage_95", "in 95 % ellipsoid"),
    ):
        cells = (report[key] for report in reports.values())
        rows.append(f"{label:<22}" + "".join(_cell(value) for value in cells))
    cells = (report["unflagged"]["rms_3d_m"] for report in reports.values())
    rows.append(f"{'not flagged, RMS 3D, m':<22}" + "".join(_cell(value) for value in cells))
    return rows


def _cell(value: float | int | None) -> str:
    if value is None:
        return f"{'-':>12}"
    return f"{value:12d}" if isinstance(value, int) else f"{value:12.3f}"


def _where(folder: Path, report: bool) -> list[str]:
    last = METHODS[-1]
    files = (
        *([("report.html", "everything about it, in any browser: begin here")] if report else []),
        (f"{last}/solution.pos", "for RTKPLOT and other readers of RTKLIB files"),
        (f"{last}/ledger.parquet", "why each satellite was used or refused"),
        (f"{last}/run.json", "what exactly was run, on what"),
        (f"{SIMULATED}/", "RINEX, truth, and the scenario as it was run"),
    )
    truth = folder / SIMULATED / f"{SCENARIO}_truth.csv"
    return [
        f"where to look in {folder}/",
        *(f"  {name:<22}  {what}" for name, what in files),
        f"try: starwise assess {folder / last} \\",
        f"         --truth {truth}",
    ]
