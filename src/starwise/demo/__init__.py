"""The main job on data that ship with the package: synthetic, made by ``tools/make_demo.py``.

Ten minutes of a drive at 1 Hz under GPS, Galileo and BeiDou. For two minutes one satellite lies by 60 m; for fifty
seconds the vehicle stands in a street canyon with few satellites and reflected signals.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from starwise import api
from starwise.io.results import read_solution
from starwise.report.text import solve_text

METHODS = ("lsq", "s3ekf")
"""Compared by the demo; the last one's files are shown."""


@dataclass(frozen=True)
class Outcome:
    """What the demo has to say: text for people, a record for machines."""

    text: str
    record: dict[str, Any]


def run_demo(directory: str | Path, progress: Callable[[str, float], None] | None = None) -> Outcome:
    """Solve and assess the data of the package.

    Parameters
    ----------
    directory : path-like
        Where the results go: a directory per method, and a picture of the track.
    progress : callable, optional

    Raises
    ------
    StarwiseError
        The directory cannot be written.
    """
    import time

    from starwise.io.truth import read_truth
    from starwise.report.track import track_svg

    folder = Path(directory)
    say = progress or (lambda _what, _fraction: None)
    began = time.perf_counter()
    reports: dict[str, dict[str, Any]] = {}
    with resources.as_file(resources.files("starwise.demo") / "data") as data:
        truth = read_truth(str(data / "demo_truth.csv"))
        for i, method in enumerate(METHODS):
            solution = api.solve(
                data / "demo_MO.rnx.gz",
                data / "demo_MN.rnx.gz",
                output=folder / method,
                progress=lambda what, part, i=i: say(what, (i + part) / len(METHODS)),  # type: ignore[misc]
                method=method,
            )
            reports[method] = api.assess(solution, truth)
    picture = folder / "track.svg"
    shown = read_solution(folder / METHODS[-1], ledger=False)
    picture.write_text(track_svg(shown, truth, title=f"starwise demo, {METHODS[-1]}"), encoding="utf-8")
    say("done", 1.0)
    text = solve_text(solution.provenance, folder / METHODS[-1], time.perf_counter() - began)
    record = {"directory": str(folder), "picture": str(picture), "assessment": reports}
    return Outcome("\n".join([text, "", *_table(reports), "", *_where(folder)]), record)


def _table(reports: dict[str, dict[str, Any]]) -> list[str]:
    rows = [f"against the truth {'':4}" + "".join(f"{method:>12}" for method in reports)]
    for key, label in (
        ("epochs_solved", "epochs solved"),
        ("rms_2d_m", "RMS 2D, m"),
        ("rms_3d_m", "RMS 3D, m"),
        ("p95_3d_m", "95 % 3D, m"),
        ("coverage_95", "in 95 % ellipsoid"),
    ):
        cells = (report[key] for report in reports.values())
        rows.append(f"{label:<22}" + "".join(_cell(value) for value in cells))
    return rows


def _cell(value: float | int | None) -> str:
    if value is None:
        return f"{'-':>12}"
    return f"{value:12d}" if isinstance(value, int) else f"{value:12.3f}"


def _where(folder: Path) -> list[str]:
    last = folder / METHODS[-1]
    return [
        "where to look",
        f"  {folder}/track.svg               the track and its errors, in any browser",
        f"  {last}/solution.pos      for RTKPLOT and other readers of RTKLIB files",
        f"  {last}/ledger.parquet    why each satellite was used or refused",
        f"  {last}/run.json          what exactly was run, on what",
        f"try: starwise assess {last} --truth X,Y,Z",
    ]
