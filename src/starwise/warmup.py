"""Compiled kernels made ahead of their first use, by two processes at once.

numba compiles a kernel when it is first called: over a minute of one core for a whole solution. The two halves of
that are independent except for two kernels, and numba looks into the cache on disk before every compilation, also of a
kernel that another one calls. So one process compiles least squares and the update with white errors, then the readers
and the ephemerides; the other everything else of the filter, and last the filter's loop, which by then finds those two
in the cache. Nothing is compiled twice.

A finished warm-up leaves a marker beside the kernels, named by a hash of their sources; looking for it is all that
later runs do. Whatever fails here fails silently: the kernels are then compiled at their first use, as ever.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from starwise.config import RunConfig
    from starwise.kernels.filter_state import Work
    from starwise.kernels.rangemodel import Epochs, ModelOptions, RowModel, Rows

ABOUT_S = 70
"""What the announcement says: a warm-up took 67 s on two virtual cores of a server; a laptop may be faster."""
COMPILING = "compiling"
"""What a progress callback is told meanwhile."""
TIMEOUT_S = 600.0
PARTS = ("least-squares", "filter")
EXTRA = ("rare", "inertial")
"""Kernels for RINEX 2 and precise ephemerides, and for inertial navigation: compiled only by ``starwise warmup``."""
_MAIN = ("filter_run", "row_noise", "rinex_obs", "rinex_nav", "orbits", "select", "group_delay")
"""Kernel modules that import all others that a solution from RINEX 3 and 4 needs."""


def wanted() -> bool:
    """Whether a warm-up helps: not switched off, kernels are compiled at all, and two cores to do it on."""
    if os.environ.get("STARWISE_NO_WARMUP", "0") not in ("", "0"):
        return False
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return False
    # In a program that embeds Python, `sys.executable` is that program, or nothing.
    return _cores() > 1 and Path(sys.executable or "").name.lower().startswith("python")


def _cores() -> int:
    allowed = getattr(os, "sched_getaffinity", None)  # Linux: a container or a batch job may have fewer than there are
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1


def marker() -> Path:
    """File that exists once the kernels as they are now have been compiled for this machine."""
    from starwise.kernels._jit import cache_root

    return cache_root() / _marker_name()


def _marker_name() -> str:
    import llvmlite.binding as llvm

    from starwise.kernels._jit import cache_name

    names = [llvm.get_host_cpu_name(), *(cache_name(module) for module in _MAIN)]
    return f"warm-{sha256(' '.join(names).encode()).hexdigest()[:16]}"


def is_warm() -> bool:
    """Whether the kernels as they are now have been compiled, here or in a shared cache."""
    from starwise.kernels._jit import cache_roots

    name = _marker_name()
    return any((root / name).exists() for root in cache_roots())


def ensure_warm(announce: Callable[[], None] | None = None) -> None:
    """Compile the kernels of a solution unless that has been done, or does not help.

    Parameters
    ----------
    announce : callable, optional
        Called before a compilation starts, which takes over a minute.
    """
    if not wanted() or is_warm():
        return
    try:
        with _alone():
            if is_warm():
                return  # another process did it while this one waited
            if announce is not None:
                announce()
            compile_kernels(PARTS)
    except OSError:
        return


def compile_kernels(parts: tuple[str, ...] = PARTS + EXTRA) -> list[str]:
    """Compile kernels, a process per part, and leave the marker; returns what went wrong, a line per part.

    The marker is left even then: a warm-up that failed once would fail again, and cost its time at every start.

    Raises
    ------
    OSError
        A process cannot be started, or the cache cannot be written.
    """
    from starwise.kernels._jit import cache_root

    path = [os.environ.get("PYTHONPATH", ""), str(Path(__file__).parents[1])]
    environment = {
        **os.environ,
        "STARWISE_NO_WARMUP": "1",
        "STARWISE_CACHE_DIR": str(cache_root()),
        "PYTHONPATH": os.pathsep.join(filter(None, path)),
    }
    running: list[subprocess.Popen[str]] = []
    failed: list[str] = []
    try:
        for part in parts:
            running.append(
                subprocess.Popen(
                    [sys.executable, "-P", "-m", "starwise.warmup", part],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.PIPE,
                    text=True,
                    env=environment,
                )
            )
        for part, process in zip(parts, running, strict=True):
            try:
                _, said = process.communicate(timeout=TIMEOUT_S)
            except subprocess.TimeoutExpired:
                failed.append(f"{part}: not done after {TIMEOUT_S:.0f} s")
                continue
            if process.returncode != 0:
                failed.append(f"{part}: {(said.strip().splitlines() or ['no reason given'])[-1]}")
    finally:
        for process in running:
            if process.poll() is None:
                process.kill()
                process.wait()
    marker().write_text("\n".join(failed), encoding="utf-8")
    return failed


@contextmanager
def _alone() -> Iterator[None]:
    """One warm-up of a cache at a time; the lock goes with the process that holds it."""
    from starwise.kernels._jit import cache_root

    with (cache_root() / "warm.lock").open("w") as file:
        _lock(file)
        yield


def _lock(file: IO[str]) -> None:
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)  # gives up with OSError after 10 s
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX)


def _least_squares() -> None:
    """Compile least squares on nothing, which the other process waits for, then the rest on the data of the demo."""
    from importlib import resources

    from starwise.config import RunConfig
    from starwise.estimators.least_squares import empty_epochs, spp_options
    from starwise.estimators.run import solve_run
    from starwise.io.rinex_nav import read_nav
    from starwise.io.rinex_obs import read_obs
    from starwise.kernels.spp import spp_run
    from starwise.physics.broadcast import BroadcastEphemeris

    # White: least squares with coloured errors goes through the filter's loop, which the other process compiles.
    config = RunConfig(method="lsq", error_model="white")
    model, epochs, rows, out = _nothing(config)
    spp_run(model, spp_options(config), epochs, rows, empty_epochs(0, 1), out)
    _white_update()
    with resources.as_file(resources.files("starwise") / "demo" / "data") as data:
        obs = read_obs(data / "demo_MO.rnx.gz")
        records = read_nav(data / "demo_MN.rnx.gz")
    solve_run(obs, BroadcastEphemeris(records), records.ionosphere, config)


def _work(n: int) -> Work:
    """Work space of a filter of n states and one row."""
    import numpy as np

    from starwise.kernels.filter_state import Work

    ints, pair, line = np.zeros(1, np.int64), np.zeros((1, 2)), np.zeros((1, 3))
    return Work(
        ints, ints, ints, line, line, pair, pair, pair, pair, np.zeros(1, np.uint8),
        np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(1), np.zeros(1),
    )  # fmt: skip


def _white_update() -> None:
    """Compile the update with white errors, a tenth of the filter that needs nothing else of it."""
    import numpy as np

    from starwise.config import RunConfig
    from starwise.estimators.filter import filter_options
    from starwise.kernels.filter_epoch import update_epoch
    from starwise.models.process import clocks_from, motion_from, process_numbers

    config = RunConfig()
    _, _, rows, out = _nothing(config)
    motion, clocks = motion_from(config), clocks_from(config)
    nk, options = process_numbers(motion, clocks).nk, filter_options(config, motion, clocks)
    n = nk + 2
    work = _work(n)
    x, P = np.zeros(n), np.zeros((n, n))
    update_epoch(options, rows, out, 0, x, P, nk, 1, np.full(1, -1, np.int64), x.copy(), P.copy(), work)


def _filter() -> None:
    """Compile the filter, what needs no least squares first; arguments of exactly the types of `filter_run`."""
    import numpy as np

    from starwise.config import RunConfig
    from starwise.estimators.filter import filter_options, filter_rows
    from starwise.kernels import colored, error_states, filter_clocks, filter_epoch, filter_predict, process
    from starwise.kernels.adapt import memory_size
    from starwise.kernels.filter_state import Belief, start_filter
    from starwise.kernels.row_noise import row_noise
    from starwise.models.error_model import no_errors
    from starwise.models.process import clocks_from, motion_from, process_numbers

    config = RunConfig()
    model, epochs, rows, out = _nothing(config)
    motion, clocks = motion_from(config), clocks_from(config)
    numbers, options = process_numbers(motion, clocks), filter_options(config, motion, clocks)
    nk = numbers.nk
    n = nk + 2
    work = _work(n)
    x, P, x2, P2 = np.zeros(n), np.zeros((n, n)), np.zeros(n), np.zeros((n, n))
    belief = Belief(x, P, np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros(1, np.int64))
    F, G, M = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    filter_clocks.align_clocks(options, rows, out, 0, x, P, nk, 1, 0, belief.at, work)
    filter_clocks.activate_clocks(options, rows, out, 0, 0, nk, 1, 0, belief, x2, P2, work)
    process.predict(x, P, nk, 1, 1.0, numbers, F, G, M)
    process.motion(numbers.kind, 1.0, numbers.tau_s, F, G)
    process.noise_shape(numbers, 6.4e6, 0.0, 0.0, M)
    start_filter(options, nk, 0, np.full(4, np.nan), np.zeros((4, 4)), np.zeros(4), np.zeros((4, 4)), 1.0, belief)
    filter_epoch.arrange(rows, out, 0, 0, work)
    filter_epoch.tally(rows, out, 0, belief.at, work)
    errors, extra = no_errors()
    slots = error_states.Slots(belief.at, belief.at, belief.at, np.zeros(1, np.int64), np.ones(1))
    phi = np.ones(error_states.N_SKY)
    error_states.predict_errors(errors, slots, x, P, nk, 1, 1.0, F, phi)
    error_states.enter_satellites(errors, extra, work.order, 0, 0, slots, x, P, n)
    colored.update_colored(options, errors, rows, extra, out, 0, x, P, nk, 1, belief.at, slots, 1.0, x2, work)
    filter_clocks.count_missed(rows, 0, 0, belief, work)
    filter_predict.advance(numbers, errors, slots, x, P, nk, 1, 1.0, -1.0, F, G, M, phi)
    filter_predict.adapt_epoch(
        options, numbers, errors, rows, extra, out, 0, x, P, nk, 1, belief.at, slots, 1.0, G, M,
        np.zeros(memory_size(options.rule.window)), work,
    )  # fmt: skip
    filter_rows(epochs, rows, model, 1, config)
    none = np.zeros(0)
    row_noise(errors, rows, extra, out, none, none, none, none)


def _nothing(config: RunConfig) -> tuple[ModelOptions, Epochs, Rows, RowModel]:
    """Inputs of the estimators without an epoch; types and layouts are those of `starwise.models.pseudorange`."""
    import numpy as np

    from starwise.kernels.rangemodel import Epochs, Rows
    from starwise.models.pseudorange import empty_row_model, model_options
    from starwise.types import IonosphereModel

    def empty(name: str) -> Any:
        if name in ("sat_pos", "sat_vel"):
            return np.zeros((0, 3))
        return np.zeros(0, {"system": np.int64, "clock": np.int64, "status": np.uint8}.get(name, np.float64))

    rows = Rows(**{name: empty(name) for name in Rows._fields})
    epochs = Epochs(np.zeros(0, np.int64), np.zeros(1, np.int64))
    return model_options(config, IonosphereModel())[0], epochs, rows, empty_row_model(0)


_RINEX_2 = """\
     2.11           OBSERVATION DATA    G (GPS)             RINEX VERSION / TYPE
     1    C1                                                # / TYPES OF OBSERV
  2024     3    30     0     0    0.0000000     GPS         TIME OF FIRST OBS
                                                            END OF HEADER
 24  3 30  0  0  0.0000000  0  1G01
  22000000.000
"""
_SP3 = """\
#dP2024  3 30  0  0  0.00000000       2 ORBIT IGS20 FIT TEST
+    1   G01
%c G  cc GPS ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc
%f  1.2500000  1.025000000  0.00000000000  0.000000000000000
*  2024  3 30  0  0  0.00000000
PG01  20000.000000  10000.000000  10000.000000      1.000000
*  2024  3 30  0 15  0.00000000
PG01  20000.000000  10000.000000  10000.000000      1.000000
EOF
"""
_CLK = """\
     3.00           C                                       RINEX VERSION / TYPE
                                                            END OF HEADER
AS G01  2024 03 30 00 00  0.000000  1    1.000000000000e-06
AS G01  2024 03 30 00 05  0.000000  1    1.000000000000e-06
"""


def _rare() -> None:
    """Compile the readers of RINEX 2, SP3 and CLK and the interpolation, on a file of each in its shortest form."""
    from tempfile import TemporaryDirectory

    import numpy as np

    from starwise.io.clk import read_clk
    from starwise.io.rinex_obs import parse_obs
    from starwise.io.sp3 import read_sp3
    from starwise.physics.precise import PreciseEphemeris

    parse_obs(_RINEX_2.encode())
    with TemporaryDirectory() as folder:
        sp3, clk = Path(folder, "table.sp3"), Path(folder, "table.clk")
        sp3.write_text(_SP3)
        clk.write_text(_CLK)
        ephemeris = PreciseEphemeris(read_sp3(sp3), read_clk(clk))
    ephemeris.states(np.zeros(0, np.int64), np.zeros(0, np.int16), np.zeros(0))


def _inertial() -> None:
    """Compile inertial navigation on 20 s of made-up readings, smoothing included, and with satellites on nothing."""
    import numpy as np

    from starwise.config import RunConfig
    from starwise.config_inertial import InertialConfig
    from starwise.constants import NS
    from starwise.estimators.ins import SkyTable, fix_table, loose, run_filter
    from starwise.estimators.ins_align import align
    from starwise.estimators.late import LateRows, LinearSystem, run_late
    from starwise.frames import ecef_from_geodetic
    from starwise.kernels.ins_tight import Seen, Sky
    from starwise.models.inertial import inertial_state, intervals
    from starwise.models.process import clocks_from
    from starwise.types import Fixes, Inertial

    t = np.arange(0, 20 * NS, NS // 20)
    force = np.tile([0.0, 0.0, -9.8], (len(t), 1))
    inertial = Inertial(t, np.full(len(t), 0.05), 1e-4 * np.sin(force + t[:, None]), force, False)
    at = t[20:-20:20]
    lat = 0.8 + 1e-6 * np.arange(len(at))  # 6 m/s to the north
    pos = ecef_from_geodetic(np.stack([lat, np.zeros(len(at)), np.zeros(len(at))], axis=1))
    vel = np.gradient(pos, axis=0)
    cov = np.tile(np.eye(3), (len(at), 1, 1))
    fixes = Fixes(at, at, pos, cov, vel, cov)
    config = InertialConfig.from_dict({"smooth": True, "vehicle": {"constraint": True, "rest": True}})
    loose(fixes, inertial, config)
    run = RunConfig()
    model, epochs, rows, out = _nothing(run)
    iv, state = intervals(inertial, config), inertial_state(config, clocks=("G",), noise=clocks_from(run))
    table, _ = fix_table(fixes, int(iv.t_ns[0]), float(iv.read.t[-1]), config)
    nothing = np.zeros(0, np.int64)
    sky = Sky(epochs, rows, model, 1.0, 1.0)
    start = align(iv, table, state, config)
    seen = Seen(out, nothing, nothing, np.zeros(0))
    run_filter(iv, table, start, state, config, np.zeros(0), sky=SkyTable(np.zeros(0), sky, seen))
    one = np.ones((1, 1, 1))
    late = LateRows(np.zeros(1, np.int64), np.ones(1, np.int64), one[0], one, one[0])
    run_late(LinearSystem(one, one, 1.0), late, one[0, 0], one[0])


def main(part: str) -> None:
    """Compile one part in this process."""
    import gc

    # A compilation makes millions of objects that stay until it ends: looking for dead ones takes a tenth of the time.
    gc.set_threshold(100_000, 50, 100)
    {"least-squares": _least_squares, "filter": _filter, "rare": _rare, "inertial": _inertial}[part]()


if __name__ == "__main__":
    main(sys.argv[1])
