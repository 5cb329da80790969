"""The one decorator of every kernel, and where its compiled code is kept."""

import hashlib
import importlib
import os
import re
import sys
import tempfile
import types
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba


def load_numba_without_scipy_linalg() -> None:
    """Import numba's array functions without all of scipy.linalg.

    ``numba.np.arraymath`` imports ``scipy.linalg.cython_blas`` only to see that it is there: 0.2-0.3 s at every start,
    more than all other imports together. No kernel here calls BLAS. Whoever compiles a function that does still
    finds the real module, because numba imports it again by name at that moment. Called before numba would do it:
    when it is about to load or to compile a kernel.
    """
    names = ("scipy.linalg", "scipy.linalg.cython_blas")
    if any(name in sys.modules for name in (*names, "numba.np.arraymath")):
        return
    try:
        for name in names:
            sys.modules[name] = types.ModuleType(name)
        importlib.import_module("numba.np.arraymath")
    finally:
        for name in names:
            sys.modules.pop(name, None)


F = TypeVar("F", bound=Callable[..., Any])

FLAGS = {"contract", "reassoc", "arcp", "nsz"}
"""Safe parts of fast maths. Never plain ``fastmath=True``: it removes the tests for NaN that mark missing values."""
OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": FLAGS, "nogil": True}
"""Of every kernel: x / 0 is inf as in numpy, safe fast maths, and no lock of the interpreter held."""

_IMPORT = re.compile(rb"^from starwise\.kernels\.(\w+) import", re.MULTILINE)


@cache
def _source(module: str) -> tuple[bytes, tuple[str, ...]]:
    """Hash of a kernel module's text, and the kernel modules that it imports."""
    text = (Path(__file__).parent / f"{module}.py").read_bytes()
    return hashlib.sha256(text).digest(), tuple(sorted({found.decode() for found in _IMPORT.findall(text)} - {"_jit"}))


def _sources_hash(module: str) -> str:
    """Hash of everything that the compiled code of a kernel module depends on.

    That is the module, all kernel modules that it imports, however indirectly, the constants, the options of the
    compiler and numba's version. numba itself checks only the file of the cached function; after an edit to a kernel
    that it *calls* it would return the old result.
    """
    options = sorted((key, sorted(value) if isinstance(value, set) else value) for key, value in OPTIONS.items())
    digest = hashlib.sha256(f"{numba.__version__} {sys.version} {options}".encode())
    digest.update((Path(__file__).parents[1] / "constants.py").read_bytes())
    seen: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        own, imported = _source(name)
        digest.update(own)
        waiting.extend(imported)
    return digest.hexdigest()[:16]


def _writable(path: Path) -> bool:
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            return True
    except OSError:
        return False


@cache
def cache_roots() -> tuple[Path, ...]:
    """Directories of compiled kernels: the first is written, all are read.

    ``$STARWISE_CACHE_DIR``, or the user's cache, or a temporary one if those cannot be written. What was asked for and
    cannot be written is read all the same: somebody may have filled it for all (``starwise warmup``). The installation
    itself may be read-only or shared; nothing is written there.
    """
    asked = os.environ.get("STARWISE_CACHE_DIR")
    if sys.platform == "win32":
        own = Path(os.environ.get("LOCALAPPDATA", "~")).expanduser() / "starwise" / "cache"
    elif sys.platform == "darwin":
        own = Path("~/Library/Caches/starwise").expanduser()
    else:
        own = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "starwise"
    first = Path(asked) if asked else own
    if _writable(first):
        return (first,)
    shared = (first,) if first.is_dir() else ()
    owner = os.getuid() if hasattr(os, "getuid") else 0
    for base in (own, Path(tempfile.gettempdir()) / f"starwise-{owner}"):
        if base != first and _writable(base):
            return (base, *shared)
    return (Path(tempfile.mkdtemp(prefix="starwise-")), *shared)


def cache_root() -> Path:
    """Directory where compiled kernels are written; see `cache_roots`."""
    return cache_roots()[0]


@cache
def cache_name(module: str) -> str:
    """Name of the directory, below a `cache_root`, of the compiled code of a kernel module as it is now."""
    return f"{module}-{_sources_hash(module)}"


@cache
def _kernel_cache() -> Any:
    """Class of the cache of kernels, or None where numba is not built as `starwise.kernels._cache` expects."""
    try:
        return importlib.import_module("starwise.kernels._cache").KernelCache
    except (ImportError, AttributeError):
        return None


def njit(function: F) -> F:
    """Compile a kernel with `OPTIONS` when it is first called; what is compiled is kept under `cache_root`."""
    compiled: Any = numba.njit(**OPTIONS)(function)
    if not hasattr(compiled, "enable_caching"):  # with NUMBA_DISABLE_JIT
        return cast(F, compiled)
    own = _kernel_cache()
    if own is not None:
        compiled._cache = own(function)
        return cast(F, compiled)
    # numba reads its cache setting when caching is enabled, so it is set for that moment only: other users of numba in
    # the same process are not affected.
    config: Any = numba.config  # its attributes are made at run time
    before = config.CACHE_DIR
    config.CACHE_DIR = str(cache_root() / cache_name(function.__module__.rpartition(".")[2]))
    try:
        compiled.enable_caching()
    finally:
        config.CACHE_DIR = before
    return cast(F, compiled)
