"""A batch from beginning to end: units out to the workers, rows and results back, one table."""

import json
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from starwise._version import __version__
from starwise.batch import store
from starwise.batch.index import SUMMARY, Rows
from starwise.batch.manifest import Manifest
from starwise.batch.work import (
    FAILED,
    NO_SOLUTION,
    OK,
    UNPAIRED,
    Done,
    Work,
    do_unit,
    failed,
    put_result,
    sealed,
    withdraw,
)
from starwise.errors import StarwiseError
from starwise.spread import sources_hash, spread
from starwise.spread.cluster import LOCAL
from starwise.warmup import COMPILING, ensure_warm

if TYPE_CHECKING:
    import polars as pl

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction (0..1) that is."""
BATCH: Final = "batch.json"


def run_batch(
    manifest: Manifest,
    output: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
    do: Callable[[Work], Done] = do_unit,
) -> "pl.DataFrame":
    """Solve all units; a unit that is done already and still holds is not done again.

    Parameters
    ----------
    manifest : Manifest
        Its units are taken as they are needed, a few for every worker.
    output : path-like
        Folder, or URL of fsspec (``s3://bucket/batch``) to which the workers write themselves. A worker of a cluster
        that does not see the folder sends its results back.
    workers : int, optional
        Processes; default one for every core.
    scheduler : str, optional
        Dask scheduler, or ``local``; see `starwise.spread.spread`.
    progress : callable, optional
    do : callable
        The work on a unit.

    Returns
    -------
    DataFrame
        The summary, which is also written: a row for every unit in the order of the manifest, and for what a scan
        could not pair. Its columns are described in ``docs/batch.md``.

    Raises
    ------
    StarwiseError
        The output cannot be written, or another batch is writing there; no scheduler. Bad units raise nothing.
    """
    place = str(output)
    say = progress or (lambda _what, _fraction: None)
    if scheduler is None or scheduler == LOCAL:  # workers elsewhere have kernels of their own
        ensure_warm(lambda: say(COMPILING, 0.0))
    began = time.perf_counter()
    rows, count = Rows(), _Count(manifest.total)
    with _claimed(place) as token:
        say(count.text(), 0.0)
        complete = False
        done = spread(do, _works(manifest, place, token), lost=failed, workers=workers, scheduler=scheduler)
        try:
            for work, result in done:
                _keep(work, result)
                rows.add(result.row)
                count.add(result.row)
                say(count.text(), count.fraction)
            complete = True
        finally:
            # also what there is when it is interrupted; the rest is in the units' own folders
            for number, (path, reason) in enumerate(manifest.unpaired, manifest.total or count.done):
                rows.add({"number": number, "unit": path, "status": UNPAIRED, "message": reason, "resumed": False})
            table = rows.table()
            _write(table, place, time.perf_counter() - began, workers, scheduler, complete)
    say("done", 1.0)
    return table


def _works(manifest: Manifest, place: str, token: str | None) -> Iterator[Work]:
    """Units made ready for workers, one at a time."""
    code = sources_hash()
    names: set[str] = set()
    for number, unit in enumerate(manifest.units()):
        if unit.name in names:
            raise StarwiseError("two units of the same name", found=unit.name)
        names.add(unit.name)
        work = Work(number, unit, place, code, token)
        yield work if token is None else Work(number, unit, place, code, token, sealed(work.place))


def _keep(work: Work, result: Done) -> None:
    """Write what a worker sent back, and remove what holds no longer; a place that fails now fails the batch."""
    if work.token is None or result.unseen:
        return
    if result.row["status"] == FAILED:
        withdraw(work.place)
    elif result.files is not None:
        put_result(result.files, work.place)


@contextmanager
def _claimed(place: str) -> Iterator[str | None]:
    """The output for this batch alone; yields a file there by which workers see that they share the folder."""
    if store.is_url(place):
        store.put_files({BATCH: _json({"starwise": __version__, "complete": False})}, place)  # before the work is done
        yield None
        return
    folder = Path(place)
    with ExitStack() as stack:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            lock = stack.enter_context((folder / ".batch.lock").open("w"))
            if not _locked(lock.fileno()):
                raise StarwiseError("another batch is writing there", file=folder)
            for old in folder.glob(".batch-*"):
                old.unlink(missing_ok=True)
            token = folder.resolve() / f".batch-{uuid.uuid4().hex}"
            token.touch()
        except OSError as error:
            raise StarwiseError(f"cannot be written ({error.strerror})", file=folder) from None
        stack.callback(token.unlink, missing_ok=True)
        yield str(token)


def _locked(number: int) -> bool:
    """Take the lock of an open file, which goes with this process; whether nobody else has it."""
    try:
        import fcntl
    except ImportError:  # Windows: two batches in one folder are not noticed there
        return True
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _write(
    table: "pl.DataFrame", place: str, seconds: float, workers: int | None, scheduler: str | None, complete: bool
) -> None:
    from io import BytesIO

    content = BytesIO()
    table.write_parquet(content)
    record = {
        "starwise": __version__,
        "complete": complete,
        "units": {str(name): int(n) for name, n in table["status"].value_counts(sort=True).iter_rows()},
        "resumed": int(table["resumed"].sum()),
        "workers": workers,
        "scheduler": scheduler,
        "wall_s": round(seconds, 3),
        "unit_s": round(float(table["seconds"].sum()), 3),
        "solutions": "unit=*/solution.parquet",
    }
    store.put_files({SUMMARY: content.getvalue(), BATCH: _json(record)}, place)


def _json(record: dict[str, Any]) -> bytes:
    return (json.dumps(record, indent=1) + "\n").encode()


class _Count:
    """How far a batch is; how fast it goes is seen by who shows it."""

    def __init__(self, total: int | None) -> None:
        self._total = total
        self.done = self._failed = 0
        self._what = "units"

    def add(self, row: Any) -> None:
        """Count a unit."""
        self.done += 1
        self._failed += row["status"] == FAILED
        self._what = "found" if row["resumed"] else "units"

    @property
    def fraction(self) -> float:
        """Part of the units that is done; 0 while their number is unknown."""
        return self.done / self._total if self._total else 0.0

    def text(self) -> str:
        """``37 of 400 units, 2 failed``; ``found`` where the last one was there already."""
        of = f"{self.done} of {self._total} {self._what}" if self._total is not None else f"{self.done} units"
        return f"{of}, {self._failed} failed" if self._failed else of


def span(seconds: float) -> str:
    """A time for people: ``40 s``, ``12 min``, ``5.5 h``, ``12 d``."""
    for unit, length, limit in (("s", 1.0, 99.5), ("min", 60.0, 5970.0), ("h", 3600.0, 172_800.0)):
        if seconds < limit:
            value = seconds / length
            return f"{value:.1f} {unit}" if unit == "h" and value < 10 else f"{value:.0f} {unit}"
    return f"{seconds / 86400:.0f} d"


def counts(table: "pl.DataFrame") -> dict[str, int]:
    """Units of a summary by status."""
    found = dict(table["status"].value_counts().iter_rows())
    return {name: int(found.get(name, 0)) for name in (OK, NO_SOLUTION, FAILED, UNPAIRED)}
