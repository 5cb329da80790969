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


def _load_numba_without_scipy_linalg() -> None:
    """Import numba's array functions without all of scipy.linalg.

    ``numba.np.arraymath`` imports ``scipy.linalg.cython_blas`` only to see that it is there: 0.2-0.3 s at every start,
    more than all other imports together. No kernel here calls BLAS. Whoever compiles a function that does still
    finds the real module, because numba imports it again by name at that moment.
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


_load_numba_without_scipy_linalg()

F = TypeVar("F", bound=Callable[..., Any])

FLAGS = {"contract", "reassoc", "arcp", "nsz"}
"""Safe parts of fast maths. Never plain ``fastmath=True``: it removes the tests for NaN that mark missing values."""


_IMPORT = re.compile(rb"^from starwise\.kernels\.(\w+) import", re.MULTILINE)


def _sources_hash(module: str) -> str:
    """Hash of everything that the compiled code of a kernel module depends on.

    That is the module, all kernel modules that it imports, however indirectly, the constants and numba's version.
    numba checks only the file of the cached function itself; after an edit to a kernel that it *calls* it would
    return the old result.
    """
    here = Path(__file__).parent
    digest = hashlib.sha256(f"{numba.__version__} {sys.version}".encode())
    digest.update((here.parent / "constants.py").read_bytes())
    seen: set[str] = set()
    waiting = ["_jit", module]
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        text = (here / f"{name}.py").read_bytes()
        digest.update(hashlib.sha256(text).digest())
        waiting.extend(sorted(found.decode() for found in _IMPORT.findall(text)))
    return digest.hexdigest()[:16]


def _writable(path: Path) -> bool:
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            return True
    except OSError:
        return False


@cache
def cache_root() -> Path:
    """Directory of compiled kernels: ``$STARWISE_CACHE_DIR``, or the user's cache, or a temporary one.

    The installation itself may be read-only or shared; nothing is written there.
    """
    asked = os.environ.get("STARWISE_CACHE_DIR")
    if asked:
        candidates = [Path(asked)]
    elif sys.platform == "win32":
        candidates = [Path(os.environ.get("LOCALAPPDATA", "~")).expanduser() / "starwise" / "cache"]
    elif sys.platform == "darwin":
        candidates = [Path("~/Library/Caches/starwise").expanduser()]
    else:
        candidates = [Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "starwise"]
    owner = os.getuid() if hasattr(os, "getuid") else 0
    candidates.append(Path(tempfile.gettempdir()) / f"starwise-{owner}")
    for base in candidates:
        if _writable(base):
            return base
    return Path(tempfile.mkdtemp(prefix="starwise-"))


@cache
def cache_dir(module: str) -> str:
    """Directory of the compiled code of a kernel module as it is now."""
    return str(cache_root() / f"{module}-{_sources_hash(module)}")


def njit(function: F) -> F:
    """Compile a kernel: cached under `cache_root`, numpy's error model (x / 0 is inf), safe fast maths, no GIL held.

    numba reads its cache setting when a function is decorated, so it is set for that moment only: other users of
    numba in the same process are not affected.
    """
    config: Any = numba.config  # its attributes are made at run time
    before = config.CACHE_DIR
    config.CACHE_DIR = cache_dir(function.__module__.rpartition(".")[2])
    try:
        compiled: Any = numba.njit(cache=True, error_model="numpy", fastmath=FLAGS, nogil=True)(function)
    finally:
        config.CACHE_DIR = before
    return cast(F, compiled)
