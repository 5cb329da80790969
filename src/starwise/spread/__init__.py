"""Work spread over processes of this machine or over a Dask cluster: a function, many items, results as they come.

Items are taken from their source only as far as work for the workers needs: a source may be a generator of millions.
Which worker does what, and in which order, is open; the result of an item must not depend on it.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Final, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
Lost = Callable[[Item, str], Result]
"""Result of an item whose workers died, from the item and what happened; or it raises."""

AHEAD: Final = 3
"""Items taken for every worker: one is worked on, the others wait, so that no worker is idle."""
ONE_THREAD: Final = {
    "POLARS_MAX_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
}
"""Environment of a worker: there is one worker for every core already."""


def cores() -> int:
    """Cores that this process may use; a container or a batch job may have fewer than there are."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1


def spread(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    lost: Callable[[Item, str], Result],
    workers: int | None = None,
    scheduler: str | None = None,
) -> Iterator[tuple[Item, Result]]:
    """Items with their results, in the order in which they are finished.

    Parameters
    ----------
    function : callable
        Of one item; what it raises ends everything. It and the items must be picklable.
    items : iterable
        At most `AHEAD` for every worker are taken and not finished.
    lost : callable
        Gives the result of an item on which workers died again and again.
    workers : int, optional
        Processes; 1: this one. Default: one for every core. With a cluster on this machine: its workers.
    scheduler : str, optional
        Address of a Dask scheduler (``tcp://host:8786``), or ``local`` for a cluster on this machine.

    Raises
    ------
    StarwiseError
        Dask is not installed; no scheduler there; its workers have another version of this program.
    """
    if scheduler is not None:
        from starwise.spread.cluster import by_cluster

        yield from by_cluster(function, items, scheduler, workers, lost)
        return
    count = workers or cores()
    if count == 1:
        for item in items:
            yield item, function(item)
        return
    from starwise.spread.processes import by_processes

    yield from by_processes(function, items, count, lost)


@lru_cache(maxsize=1)
def sources_hash() -> str:
    """Hash of the package's sources: results of another program are not taken for this one's."""
    import hashlib

    base = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for path in sorted(base.rglob("*.py")):
        digest.update(str(path.relative_to(base)).encode() + path.read_bytes())
    return digest.hexdigest()
