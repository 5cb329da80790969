"""Reports on disk: of a result's directory or a position file, beside what is there."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from starwise.analysis.accuracy import raised
from starwise.errors import StarwiseError
from starwise.io.results import ASSESSMENT, REPORT, RUN, read_solution
from starwise.io.truth import read_truth
from starwise.report.html.run import run_page
from starwise.types import Truth


def write_page(page: bytes, file: str | Path) -> Path:
    """Write a page beside its place, then rename it.

    Raises
    ------
    StarwiseError
        It cannot be written.
    """
    path = Path(file)
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        beside.write_bytes(page)
        beside.replace(path)
    except OSError as error:
        raise StarwiseError(f"cannot be written ({error.strerror})", file=path) from None
    finally:
        beside.unlink(missing_ok=True)
    return path


def write_report(
    source: str | Path,
    truth: Truth | str | Path | None = None,
    file: str | Path | None = None,
    *,
    antenna_up_m: float = 0.0,
    title: str = "",
) -> Path:
    """Report of a result's directory or of a position file.

    Parameters
    ----------
    source : path-like
        Directory of a result, or a position file. ``assess.json`` in the directory is shown, too; without it the
        consistency of the innovations is judged here.
    truth : Truth, path-like or str, optional
        As in `starwise.api.assess`.
    file : path-like, optional
        Default: ``report.html`` in the directory; beside a position file, its name with ``.html``.
    antenna_up_m : float
        Height of the antenna above the point that the truth is of, m.
    title : str, optional

    Returns
    -------
    Path
        Where it is.

    Raises
    ------
    StarwiseError
        Nothing to report on, a truth that cannot be read, or a file that cannot be written.
    """
    place = Path(source)
    solution = read_solution(place)
    if truth is not None and not isinstance(truth, Truth):
        truth = read_truth(str(truth))
    known = None if truth is None else raised(truth, antenna_up_m)
    if file is None:
        file = place / REPORT if place.is_dir() else place.with_suffix(".html")
    found = read_assessment(place)
    if found is None and "innovation_var_m2" in solution.ledger:
        from starwise.analysis.lab import Consistency

        found = {"consistency": Consistency.of(solution, known).to_dict()}
    page = run_page(solution, known, found, title=title or ("" if place.is_dir() else place.name))
    written = write_page(page, file)
    if place.is_dir() and written == place / REPORT:
        _noted(place / RUN)
    return written


def write_study(folder: str | Path, paper: str = "") -> Path:
    """Report of a reproduced paper: its ``report.md`` and figures as ``report.html`` beside them.

    Raises
    ------
    StarwiseError
        There is none, or the page cannot be written.
    """
    from starwise.report.html.study import study_page

    base = Path(folder)
    try:
        text = (base / "report.md").read_text(encoding="utf-8")
    except OSError as error:
        raise StarwiseError(f"cannot be read ({error.strerror})", file=base / "report.md") from None
    numbers = _read_json(base / "reproduce.json") if (base / "reproduce.json").is_file() else None
    return write_page(study_page(text, base, paper, numbers), base / REPORT)


def refresh_reports(sources: Sequence[tuple[str, str | None]], *, antenna_up_m: float = 0.0) -> list[Path]:
    """Reports of those of the sources that are directories of results which may be written, with their truths.

    Parameters
    ----------
    sources : sequence of (path, truth or None)
    antenna_up_m : float
        See `write_report`.
    """
    written = []
    for source, truth in sources:
        folder = Path(source)
        if (folder / RUN).is_file() and os.access(folder, os.W_OK):
            written.append(write_report(folder, truth, antenna_up_m=antenna_up_m))
    return written


def read_assessment(folder: Path) -> dict[str, Any] | None:
    """What ``assess.json`` of a directory holds; None without one.

    Raises
    ------
    StarwiseError
        It is there and is no JSON object.
    """
    file = folder / ASSESSMENT
    return _read_json(file) if folder.is_dir() and file.is_file() else None


def _read_json(file: Path) -> dict[str, Any]:
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise StarwiseError("not JSON", file=file) from None
    if not isinstance(found, dict):
        raise StarwiseError("not a JSON object", file=file)
    return found


def _noted(run: Path) -> None:
    """Name the report among the files of its run."""
    if not run.is_file():
        return
    record = json.loads(run.read_text(encoding="utf-8"))
    files = record.get("files")
    if isinstance(files, list) and REPORT not in files:
        files.append(REPORT)
        write_page((json.dumps(record, indent=1, ensure_ascii=False) + "\n").encode("utf-8"), run)
