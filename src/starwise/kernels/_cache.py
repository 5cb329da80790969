"""Cache of compiled kernels that loads them without numba's tables of types.

This builds on numba's own machinery, which is no part of its documented interface. Where a later numba has changed it,
importing this module fails and `starwise.kernels._jit` takes numba's ordinary cache, which is a little slower to start.
"""

import contextlib
import importlib
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from starwise.kernels._jit import cache_name, cache_root, cache_roots, load_numba_without_scipy_linalg

caching: Any = importlib.import_module("numba.core.caching")
runtime: Any = importlib.import_module("numba.core.runtime")
for _name in ("_CacheLocator", "CompileResultCacheImpl", "FunctionCache", "IndexDataCacheFile"):
    getattr(caching, _name)

_DAMAGED = (EOFError, pickle.UnpicklingError)
"""What reading a cut file raises, as a computer leaves it that loses its power."""


@contextlib.contextmanager
def _turn(folder: Path) -> Iterator[None]:
    """One writer of a directory at a time, where locks are to be had.

    numba reads the index, chooses the name of a file and writes both. Two processes that do so at once for two
    signatures of a kernel would choose the same name, and one of the signatures would get the code of the other.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as file:
        with contextlib.suppress(ImportError, OSError):
            fcntl: Any = importlib.import_module("fcntl")
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


class _Locator(caching._CacheLocator):  # type: ignore[misc]
    """Where numba keeps a kernel: a directory named by a hash of its sources, which needs no other stamp."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._name = cache_name(function.__module__.rpartition(".")[2])
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Callable[..., Any], _file: str) -> "_Locator":
        return cls(function)

    def get_cache_path(self) -> str:
        return str(cache_root() / self._name)

    def paths(self) -> list[str]:
        return [str(root / self._name) for root in cache_roots()]

    def ensure_cache_path(self) -> None:
        Path(self.get_cache_path()).mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        return ""

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Implementation(caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = [_Locator]  # noqa: RUF012 - as in numba


class KernelCache(caching.FunctionCache):  # type: ignore[misc]
    """numba's cache of compiled functions, without what a function that is there does not need.

    numba fills its tables of types and functions before it looks: 0.2 s that only a compilation uses, which fills them
    anyway. A shared cache that cannot be written is read, too, and a cache that cannot be written, or is damaged, is no
    error.
    """

    _impl_class = _Implementation

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Compiled function of a signature, or None."""
        load_numba_without_scipy_linalg()
        runtime.rtsys.initialize(target_context)
        key, stamp = self._index_key(sig, target_context.codegen()), self._impl.locator.get_source_stamp()
        for path in self._impl.locator.paths():
            with contextlib.suppress(OSError, *_DAMAGED):
                data = caching.IndexDataCacheFile(path, self._impl.filename_base, stamp).load(key)
                if data is not None:
                    return self._impl.rebuild(target_context, data)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function."""
        with contextlib.suppress(OSError), _turn(Path(self._impl.locator.get_cache_path())):
            try:
                super().save_overload(sig, data)
            except _DAMAGED:
                self._cache_file.flush()
                super().save_overload(sig, data)
