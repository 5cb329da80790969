"""Workers of a Dask cluster (package ``distributed``): what it does well is left to it.

Dask places the work, notices workers that come and go, and repeats what a dead worker had in hand or had not yet
handed over. Here is only what keeps the scheduler small (few items of many are with it), and the checks.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import islice
from typing import Any, Final

from starwise.errors import StarwiseError
from starwise.spread import AHEAD, ONE_THREAD, Item, Result, cores, sources_hash

Client = Any
"""`distributed.Client`; the package is half typed, and need not be there."""

LOCAL: Final = "local"
CONNECT_S: Final = 15
_COUNT_EVERY_S: Final = 1.0
"""The number of workers is asked for no more often."""


def check_scheduler(scheduler: str | None) -> None:
    """See, before other work is done, that Dask is there and that this looks like a scheduler; None is none.

    Raises
    ------
    StarwiseError
        It is not.
    """
    if scheduler is None:
        return
    _distributed()
    if scheduler != LOCAL and "://" not in scheduler:
        raise StarwiseError("not the address of a scheduler", found=scheduler, wanted="tcp://HOST:PORT, or local")


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError:
        raise StarwiseError(
            "--scheduler needs Dask, which is not installed", wanted="pip install 'starwise[cluster]'"
        ) from None


@contextmanager
def connected(scheduler: str, workers: int | None = None) -> Iterator[Client]:
    """Client of a scheduler, or of a cluster on this machine (``local``) that lives as long as it.

    Raises
    ------
    StarwiseError
        Dask is not installed; no scheduler at this address; a worker without this program, or with other sources.
    """
    check_scheduler(scheduler)
    distributed = _distributed()
    if scheduler == LOCAL:
        with (
            distributed.LocalCluster(
                n_workers=workers or cores(),
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                memory_limit=0,
                silence_logs=50,
                env=ONE_THREAD,
            ) as here,
            distributed.Client(here, set_as_default=False) as client,
        ):
            yield client
        return
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise StarwiseError(
            f"no Dask scheduler answers ({' '.join(str(error).split())[:100]})",
            found=scheduler,
            wanted="tcp://HOST:PORT, or local",
        ) from None
    with client:
        _check_workers(client)
        yield client


def _check_workers(client: Client) -> None:
    """See that the workers that are there now run this program; later ones are checked by what they work on."""
    try:
        found = client.run(sources_hash)
    except Exception as error:
        said = f"{type(error).__name__}: {' '.join(str(error).split())[:80]}"
        raise StarwiseError(
            f"a worker of the cluster cannot run starwise ({said})", wanted="the same starwise everywhere"
        ) from None
    for address, code in found.items():
        check_code(code, address)


def check_code(code: str, where: str = "this worker") -> None:
    """Compare the hash of a program's sources with this one's.

    Raises
    ------
    StarwiseError
        They differ.
    """
    if code != sources_hash():
        raise StarwiseError(f"{where} runs another version of starwise", wanted="the same everywhere")


def by_cluster(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    scheduler: str,
    workers: int | None,
    lost: Callable[[Item, str], Result],
) -> Iterator[tuple[Item, Result]]:
    """Items with their results as they are finished, by a Dask cluster; see `starwise.spread.spread`."""
    from concurrent.futures import CancelledError

    distributed = _distributed()
    with connected(scheduler, workers) as client:
        source = iter(items)
        waiting: dict[Any, Item] = {}
        finished = distributed.as_completed(loop=client.loop)
        room = _Room(client)
        try:
            while True:
                for item in islice(source, max(0, room.of_all() - len(waiting))):
                    future = client.submit(function, item, pure=False)
                    waiting[future] = item
                    finished.add(future)
                if not waiting:
                    return
                future = next(finished)
                item = waiting.pop(future)
                try:
                    result = future.result()
                except distributed.KilledWorker as error:
                    result = lost(item, f"its worker died, {error.allowed_failures + 1} times (out of memory?)")
                except CancelledError:
                    raise StarwiseError("the scheduler is gone, or has dropped the work", found=scheduler) from None
                future.release()
                yield item, result
        finally:
            if waiting and client.status == "running":
                client.cancel(list(waiting))


class _Room:
    """Items that may be with the scheduler at a time, as workers come and go."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._count, self._at = 0, -_COUNT_EVERY_S

    def of_all(self) -> int:
        if time.monotonic() - self._at >= _COUNT_EVERY_S:
            self._count, self._at = sum(self._client.nthreads().values()), time.monotonic()
        return AHEAD * max(1, self._count)
