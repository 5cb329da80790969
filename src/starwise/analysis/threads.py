"""Small matrices on one core: threads of BLAS that wait for each other cost a hundred times what they save there.

On a busy machine a step of a filter with 190 states took 60 ms on two threads, on one 2 ms: the threads spin. numpy has
no function for this; its OpenBLAS does, under one of a few names. Where there is none (other BLAS), nothing happens.
"""

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, Final

_NAMES: Final = ("scipy_openblas_{}_num_threads64_", "openblas_{}_num_threads64_", "scipy_openblas_{}_num_threads",
                 "openblas_{}_num_threads")  # fmt: skip


@cache
def _functions() -> tuple[Any, Any] | None:
    """Getter and setter of the number of threads of numpy's BLAS; None if it has none that is known."""
    import numpy as np

    core = getattr(np, "_core", None) or np.core
    try:
        library = ctypes.CDLL(core._multiarray_umath.__file__)  # finds symbols of what it is linked to
    except (OSError, AttributeError):
        return None
    for name in _NAMES:
        try:
            get, put = getattr(library, name.format("get")), getattr(library, name.format("set"))
        except AttributeError:
            continue
        get.restype, get.argtypes, put.restype, put.argtypes = ctypes.c_int, [], None, [ctypes.c_int]
        return get, put
    return None


_LOCK: Final = threading.Lock()
_INSIDE: Final = {"depth": 0, "before": 0}


@contextmanager
def one_thread() -> Iterator[None]:
    """Matrix products of numpy on one thread inside; of all threads of the process, until the last of them is out."""
    functions = _functions()
    if functions is None:
        yield
        return
    get, put = functions
    with _LOCK:
        if _INSIDE["depth"] == 0:
            _INSIDE["before"] = get()
            put(1)
        _INSIDE["depth"] += 1
    try:
        yield
    finally:
        with _LOCK:
            _INSIDE["depth"] -= 1
            if _INSIDE["depth"] == 0:
                put(_INSIDE["before"])
