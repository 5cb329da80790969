"""``starwise compare``: several solutions beside each other."""

from collections.abc import Sequence
from pathlib import Path

from starwise.analysis.accuracy import assess, raised
from starwise.errors import StarwiseError
from starwise.io.results import read_solution
from starwise.io.truth import read_truth
from starwise.report.html import Compared, compare_page, write_page


def compare_files(
    paths: Sequence[str | Path],
    truth: str | None = None,
    output: str | Path | None = None,
    *,
    antenna_up_m: float = 0.0,
) -> list[Compared]:
    """Solutions with their errors against a truth, or their scatter; also as a page.

    Parameters
    ----------
    paths : sequence of path-like
        Directories of results or position files.
    truth : str, optional
        As in `starwise.api.assess`.
    output : path-like, optional
        The page.
    antenna_up_m : float
        Height of the antenna above the point that the truth is of, m.

    Raises
    ------
    StarwiseError
        A file that cannot be read or written, or nothing to compare.
    """
    known = None if truth is None else raised(read_truth(truth), antenna_up_m)
    items = []
    for path, name in zip(paths, _names(paths), strict=True):
        solution = read_solution(path, ledger=False)
        if not solution.has_position.any():
            raise StarwiseError("no epoch has a position", file=path)
        vertical = known is None or solution.provenance.get("height") != "geodetic"
        items.append(Compared(name, solution, assess(solution, known, vertical=vertical)))
    if output is not None:
        write_page(compare_page(items, known), output)
    return items


def _names(paths: Sequence[str | Path]) -> list[str]:
    """Last parts of the paths, with as many before them as tell them apart."""
    parts = [Path(path).parts for path in paths]
    for n in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-n:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{path} ({i})" for i, path in enumerate(paths, 1)]
