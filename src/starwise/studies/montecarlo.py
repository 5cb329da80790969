"""Many runs of a task over all cores: the same numbers whatever the number of workers, and safe to be killed.

Runs are done in blocks. A finished block is a Parquet file under ``parts/<key>`` of the output folder, written beside
and renamed, so that it is whole or not there; a later call takes it instead of computing it again if the key agrees:
the task with all its numbers, and the program's sources. The blocks in order are the result.
"""

import hashlib
import json
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from starwise.errors import StarwiseError
from starwise.spread import AHEAD, sources_hash, spread

if TYPE_CHECKING:
    import polars as pl

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction (0..1) that is."""
Row = Mapping[str, float | int | str | None]
Block = tuple[int, int]
"""First run, and the one after the last."""
BLOCK: Final = 25
"""Runs in a block: a tenth of a second to a second of work."""


class Task(Protocol):
    """What is to be done many times. Must be picklable: every worker gets a copy and prepares it for itself."""

    def description(self) -> Mapping[str, Any]:
        """Everything that the numbers depend on, ready for JSON."""
        ...

    def prepare(self) -> Callable[[int], Sequence[Row]]:
        """Do what is common to all runs; the function that gives the rows of a run."""
        ...


def run_many(
    task: Task,
    runs: int,
    folder: str | Path,
    *,
    name: str = "montecarlo",
    workers: int | None = None,
    scheduler: str | None = None,
    block: int = BLOCK,
    progress: Progress | None = None,
) -> "pl.DataFrame":
    """Rows of runs 0 .. ``runs`` - 1, also written to ``<name>.parquet`` in a folder.

    Parameters
    ----------
    task : Task
    runs : int
    folder : path-like
        Is made if it is not there.
    name : str
        Of the result file.
    workers : int, optional
        Processes; 1: this one. Default: one for every core, and no more than there are blocks to do.
    scheduler : str, optional
        Dask scheduler whose workers do the runs, or ``local``; see `starwise.spread.spread`. The numbers are the same.
    block : int
        Runs in a block.
    progress : callable, optional

    Raises
    ------
    StarwiseError
        Not at least one run; the folder cannot be written; what a run raises.
    """
    import polars as pl

    if runs < 1:
        raise StarwiseError("not at least one run", found=str(runs))
    base = Path(folder)
    parts = base / "parts" / task_key(task)
    try:
        parts.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StarwiseError(f"folder cannot be made ({error.strerror})", file=parts) from None
    blocks = [(first, min(first + block, runs)) for first in range(0, runs, block)]
    files = {b: parts / f"{name}-{b[0]:06d}-{b[1]:06d}.parquet" for b in blocks}
    say = progress or (lambda _what, _fraction: None)
    missing = [b for b in blocks if not _whole(files[b])]
    done = runs - sum(b[1] - b[0] for b in missing)
    say(f"{done} of {runs} runs", done / runs)
    by = (
        _finish(task, missing, files, workers) if scheduler is None else _send(task, missing, files, workers, scheduler)
    )
    for b in by:
        done += b[1] - b[0]
        say(f"{done} of {runs} runs", done / runs)
    table = pl.concat([pl.read_parquet(files[b]) for b in blocks], how="vertical")
    write_whole(table, base / f"{name}.parquet")
    return table


def _finish(task: Task, missing: Sequence[Block], files: Mapping[Block, Path], workers: int | None) -> Iterator[Block]:
    """Do the missing blocks; yields after each."""
    count = min(workers or os.cpu_count() or 1, len(missing))
    pending = deque(missing)
    if count <= 1:
        while pending:
            yield _do_here(task, pending.popleft(), files)
        return
    from starwise.spread.processes import process_pool

    # This process works, too, from the first moment on, while the others are still being started.
    with process_pool(count - 1) as pool:
        waiting: dict[Future[None], Block] = {}
        try:
            while pending or waiting:
                while pending and len(waiting) < AHEAD * (count - 1):
                    b = pending.popleft()
                    waiting[pool.submit(_do_block, task, b, str(files[b]))] = b
                if not pending:
                    back = next((future for future in reversed(waiting) if future.cancel()), None)
                    if back is not None:
                        pending.append(waiting.pop(back))
                if pending:
                    yield _do_here(task, pending.popleft(), files)
                else:
                    wait(waiting, return_when=FIRST_COMPLETED)
                for future in [future for future in waiting if future.done()]:
                    future.result()
                    yield waiting.pop(future)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _do_here(task: Task, block: Block, files: Mapping[Block, Path]) -> Block:
    _do_block(task, block, str(files[block]))
    return block


def _send(
    task: Task, missing: Sequence[Block], files: Mapping[Block, Path], workers: int | None, scheduler: str
) -> Iterator[Block]:
    """Have the missing blocks done by a cluster, whose workers need not see the folder; yields after each."""
    if not missing:
        return
    key = task_key(task)
    items = ((task, key, block) for block in missing)
    for (_, _, block), content in spread(_sent_block, items, lost=_lost, workers=workers, scheduler=scheduler):
        _write_beside(files[block], partial(Path.write_bytes, data=content))
        yield block


def _sent_block(item: tuple[Task, str, Block]) -> bytes:
    """Rows of a block as Parquet, on a worker that must find the same task in the same program."""
    from io import BytesIO

    task, key, block = item
    if task_key(task) != key:
        raise StarwiseError("a worker has another version of starwise, or other files", wanted="the same everywhere")
    content = BytesIO()
    _rows(task, block).write_parquet(content)
    return content.getvalue()


def _lost(item: tuple[Task, str, Block], why: str) -> bytes:
    raise StarwiseError(f"runs {item[2][0]} to {item[2][1] - 1} cannot be done: {why}")


_kept = threading.local()
"""Of this thread: the last task, prepared. A worker of a cluster may have several threads."""


def _do_block(task: Task, block: Block, file: str) -> None:
    """Rows of a block into its file."""
    write_whole(_rows(task, block), Path(file))


def _rows(task: Task, block: Block) -> "pl.DataFrame":
    import polars as pl

    key = task_key(task)
    if getattr(_kept, "key", None) != key:
        _kept.key, _kept.rows = None, None  # not both in memory
        _kept.key, _kept.rows = key, task.prepare()
    rows = [row for number in range(*block) for row in _kept.rows(number)]
    return pl.DataFrame(rows, infer_schema_length=None)


def _whole(file: Path) -> bool:
    """Whether a part is there and can be read."""
    import polars as pl

    if not file.is_file():
        return False
    try:
        pl.read_parquet_schema(file)
    except (OSError, pl.exceptions.PolarsError):
        return False
    return True


def write_whole(table: "pl.DataFrame", file: Path) -> None:
    """Write a table as Parquet or CSV (by the suffix) beside its place, then rename it: whole, or not there.

    Raises
    ------
    StarwiseError
        The file cannot be written.
    """
    _write_beside(file, table.write_csv if file.suffix == ".csv" else table.write_parquet)


def _write_beside(file: Path, write: Callable[[Path], object]) -> None:
    beside = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        write(beside)
        beside.replace(file)
    except OSError as error:
        raise StarwiseError(f"cannot be written ({error})", file=file) from None


def task_key(task: Task) -> str:
    """Hash of what the numbers of a task depend on."""
    text = json.dumps({"task": task.description(), "code": sources_hash()}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
