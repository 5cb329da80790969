"""Workers as processes of this machine."""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import islice
from typing import Generic

from starwise.spread import AHEAD, ONE_THREAD, Item, Result


def process_pool(count: int) -> ProcessPoolExecutor:
    """Fresh processes: a fork would inherit the locks of threads that it does not have."""
    return ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"), initializer=_begin)


def _begin() -> None:
    """Make a process a worker: one thread, gone when it is interrupted or when the one that started it is gone."""
    os.environ.update(ONE_THREAD)
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))  # nothing that it writes is half-written
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@dataclass
class _Job(Generic[Item]):
    item: Item
    deaths: int = 0
    """Processes that died while it was the only one worked on."""


def by_processes(
    function: Callable[[Item], Result], items: Iterable[Item], count: int, lost: Callable[[Item, str], Result]
) -> Iterator[tuple[Item, Result]]:
    """Items with their results as they are finished, by ``count`` processes; see `starwise.spread.spread`.

    When a process dies, the pool and everything in it are gone, and nobody says which item was to blame. They are
    tried again one at a time; an item is lost when two processes died over it alone.
    """
    source = iter(items)
    suspects: deque[_Job[Item]] = deque()
    waiting: dict[Future[Result], _Job[Item]] = {}
    pool = process_pool(count)
    try:
        while True:
            dead: list[_Job[Item]] = []
            while not dead:
                job = _next_job(source, suspects, len(waiting), count)
                if job is None:
                    break
                try:
                    waiting[pool.submit(function, job.item)] = job
                except BrokenProcessPool:
                    dead.append(job)
            if not waiting and not dead:
                return
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                job = waiting.pop(future)
                if isinstance(future.exception(), BrokenProcessPool):
                    dead.append(job)
                else:
                    yield job.item, future.result()
            if not dead:
                continue
            dead += waiting.values()
            waiting.clear()
            pool.shutdown(wait=True, cancel_futures=True)
            pool = process_pool(count)
            if len(dead) == 1:
                dead[0].deaths += 1
                if dead[0].deaths > 1:
                    yield dead[0].item, lost(dead[0].item, "its process died, twice (out of memory?)")
                    continue
            suspects.extendleft(reversed(dead))
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _next_job(source: Iterator[Item], suspects: deque[_Job[Item]], waiting: int, count: int) -> _Job[Item] | None:
    """What to submit now; suspects go alone."""
    if suspects:
        return suspects.popleft() if not waiting else None
    if waiting >= AHEAD * count:
        return None
    return next((_Job(item) for item in islice(source, 1)), None)
