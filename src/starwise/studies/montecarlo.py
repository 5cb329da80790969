"""Many runs of a task over all cores: the same numbers whatever the number of workers, and safe to be killed.

Runs are done in blocks. A finished block is a Parquet file under ``parts/<key>`` of the output folder, written beside
and renamed, so that it is whole or not there; a later call takes it instead of computing it again if the key agrees:
the task with all its numbers, and the program's sources. The blocks in order are the result.
"""

import hashlib
import json
import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from starwise.errors import StarwiseError

if TYPE_CHECKING:
    import polars as pl

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction (0..1) that is."""
Row = Mapping[str, float | int | str | None]
Block = tuple[int, int]
"""First run, and the one after the last."""
BLOCK: Final = 25
"""Runs in a block: a tenth of a second to a second of work."""
AHEAD: Final = 3
"""Blocks that wait for each other process, so that none is idle while this one works on its own."""


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
    done = len(blocks) - len(missing)
    say("runs", done / len(blocks))
    for _ in _finish(task, missing, files, workers):
        done += 1
        say("runs", done / len(blocks))
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
    import multiprocessing

    # Fresh processes: a fork would inherit the locks of threads that it does not have. This process works, too, from
    # the first moment on, while the others are still being started.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count - 1, mp_context=context, initializer=_leave_with_parent) as pool:
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


def _leave_with_parent() -> None:
    """End this process when the one that started it is gone: a killed run leaves nobody waiting behind."""
    import multiprocessing
    import threading

    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _do_here(task: Task, block: Block, files: Mapping[Block, Path]) -> Block:
    _do_block(task, block, str(files[block]))
    return block


_prepared: dict[str, Callable[[int], Sequence[Row]]] = {}


def _do_block(task: Task, block: Block, file: str) -> None:
    """Rows of a block into its file."""
    import polars as pl

    key = task_key(task)
    if key not in _prepared:
        _prepared.clear()
        _prepared[key] = task.prepare()
    rows = [row for number in range(*block) for row in _prepared[key](number)]
    write_whole(pl.DataFrame(rows, infer_schema_length=None), Path(file))


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
    beside = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        if file.suffix == ".csv":
            table.write_csv(beside)
        else:
            table.write_parquet(beside)
        beside.replace(file)
    except OSError as error:
        raise StarwiseError(f"cannot be written ({error})", file=file) from None


def task_key(task: Task) -> str:
    """Hash of what the numbers of a task depend on."""
    text = json.dumps({"task": task.description(), "code": _code_hash()}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@lru_cache(maxsize=1)
def _code_hash() -> str:
    """Hash of the package's sources: results of another program are not taken for this one's."""
    base = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for path in sorted(base.rglob("*.py")):
        digest.update(str(path.relative_to(base)).encode() + path.read_bytes())
    return digest.hexdigest()
