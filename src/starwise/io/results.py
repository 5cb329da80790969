"""Files of a result: ``solution.parquet``, ``ledger.parquet``, ``solution.pos`` and ``run.json`` in one directory.

The columns are described in ``docs/formats.md``. NaN inside the program is null in the files; radians become degrees.
"""

import contextlib
import json
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import EPOCH_STATUS_NAMES, ROW_STATUS_NAMES
from starwise.errors import StarwiseError
from starwise.frames import geodetic_from_ecef, rotations_ne_enu
from starwise.io.foreign import read_foreign
from starwise.io.kf_gins import NAV_NAME
from starwise.io.pos import write_pos
from starwise.signals import signal_id, signal_name, sv_id, sv_name
from starwise.types import Solution

if TYPE_CHECKING:
    import polars as pl

SOLUTION: Final = "solution.parquet"
LEDGER: Final = "ledger.parquet"
POS: Final = "solution.pos"
RUN: Final = "run.json"
RESULT_FILES: Final = (SOLUTION, LEDGER, POS, RUN)
REPORT: Final = "report.html"
"""Beside them, where a report is asked for."""
ASSESSMENT: Final = "assess.json"
"""What `starwise assess` found on a result; of no use beside another."""

_COMPRESSION: Final = "zstd"
_LEVEL: Final = 1  # as fast as lz4 on a ledger of a day and a quarter smaller; level 3 takes half as long again
_GPS_EPOCH_UNIX_NS: Final = 315_964_800 * 1_000_000_000
_AXES: Final = "xyz"
_PAIRS: Final = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_DOPS: Final = ("gdop", "pdop", "hdop", "vdop")


def write_results(
    solution: Solution, directory: str | Path, report: Callable[[], bytes] | None = None, *, ledger: bool = True
) -> dict[str, Path]:
    """Write the files of a result into a directory, all or none of the new ones.

    The files are complete under temporary names before the first takes its place; ``run.json`` says ``"complete":
    false`` while they do. Files of the same names that this program did not write are not overwritten. A report and
    an assessment of the result that was there before are removed with it.

    Parameters
    ----------
    solution : Solution
    directory : path-like
    report : callable, optional
        Makes ``report.html``, written as a fifth file.
    ledger : bool
        Write ``ledger.parquet``; false where nothing is to be asked of it later.

    Returns
    -------
    dict
        Path of each file by name.

    Raises
    ------
    StarwiseError
        The directory cannot be written, or holds foreign files of these names.
    """
    folder = Path(directory)
    prepare_directory(folder)
    stale = [folder / name for name in (REPORT, ASSESSMENT)] if _is_ours(folder) else []
    writers: dict[str, Callable[[Path], None]] = {
        SOLUTION: lambda path: _write_parquet(solution_table(solution), path),
        LEDGER: lambda path: _write_parquet(ledger_table(solution.ledger), path),
        POS: lambda path: _write_bytes(write_pos(solution, program=_program(solution)), path),
        RUN: lambda path: _write_bytes(_json(_run_record(solution, names, complete=True)), path),
    }
    if not ledger:
        del writers[LEDGER]
        stale.append(folder / LEDGER)
    if report is not None:
        writers[REPORT] = lambda path: _write_bytes(report(), path)
    names = list(writers)
    order = [name for name in (LEDGER, REPORT, POS, SOLUTION, RUN) if name in writers]
    temporary = {name: folder / f".{name}.{os.getpid()}.tmp" for name in writers}
    try:
        with ThreadPoolExecutor(2) as pool:  # Parquet is encoded while the text is formatted
            list(pool.map(lambda name: writers[name](temporary[name]), order))
        _write_bytes(_json(_run_record(solution, names, complete=False)), folder / RUN)
        for path in stale:
            path.unlink(missing_ok=True)
        for name in writers:
            os.replace(temporary[name], folder / name)
    except OSError as error:
        raise StarwiseError(f"cannot be written ({error.strerror})", file=folder) from None
    finally:
        for path in temporary.values():
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
    return {name: folder / name for name in writers}


def prepare_directory(directory: str | Path) -> None:
    """Make the directory of a result and see that it may be written; called before the work, too.

    Raises
    ------
    StarwiseError
        It is a file, cannot be made, or holds result files that this program did not write.
    """
    folder = Path(directory)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise StarwiseError("the output is a file", file=folder, wanted="a directory") from None
    except OSError as error:
        raise StarwiseError(f"cannot be made ({error.strerror})", file=folder) from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise StarwiseError("the output directory is not writable", file=folder)
    present = [name for name in (*RESULT_FILES, REPORT) if (folder / name).exists()]
    if present and not _is_ours(folder):
        raise StarwiseError(
            f"holds a {present[0]} that starwise did not write",
            file=folder,
            wanted="another output directory, or that file removed",
        )


def _is_ours(folder: Path) -> bool:
    try:
        return "starwise" in json.loads((folder / RUN).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False


def _program(solution: Solution) -> str:
    return f"starwise {solution.provenance.get('starwise', '')}".strip()


def _run_record(solution: Solution, files: list[str], *, complete: bool) -> dict[str, Any]:
    return {"starwise": "?", **solution.provenance, "complete": complete, "files": files}


def _json(record: dict[str, Any]) -> bytes:
    return (json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode("utf-8")


def _write_bytes(data: bytes, path: Path) -> None:
    path.write_bytes(data)


def _write_parquet(table: "pl.DataFrame", path: Path) -> None:
    table.write_parquet(path, compression=_COMPRESSION, compression_level=_LEVEL)


def _series(name: str, values: NDArray[Any]) -> "pl.Series":
    import polars as pl

    return pl.Series(name, np.ascontiguousarray(values), nan_to_null=values.dtype.kind == "f")


def _names(name: str, codes: NDArray[Any], label: Callable[[int], str]) -> "pl.Series":
    """Names of identifiers as an enumeration (stored once, in the order of the identifiers)."""
    table = np.full(1 << 16, -1, dtype=np.int32)
    wide = codes.astype(np.uint16)
    table[wide] = 0
    known = np.flatnonzero(table == 0)
    table[known] = np.arange(len(known))
    return _enum(name, table[wide], [label(int(code)) for code in known])


def _enum(name: str, index: NDArray[Any], labels: Sequence[str]) -> "pl.Series":
    import polars as pl

    return pl.Series(name, index.astype(np.uint32)).cat.to(pl.Enum(list(labels)))


def _instants(name: str, t_ns: NDArray[np.int64]) -> "pl.Series":
    import polars as pl

    return pl.Series(name, t_ns + _GPS_EPOCH_UNIX_NS).cast(pl.Datetime("ns"))


def solution_table(solution: Solution) -> "pl.DataFrame":
    """Solution as a table, a row per epoch; columns as in ``docs/formats.md``."""
    import polars as pl

    llh = geodetic_from_ecef(solution.pos_e)
    C = rotations_ne_enu(llh[:, 0], llh[:, 1])
    cov_enu = C @ solution.cov_pos @ C.transpose(0, 2, 1)
    vcov_enu = C @ solution.cov_vel @ C.transpose(0, 2, 1)
    vel_enu = (C @ solution.vel_e[:, :, None])[:, :, 0]
    with np.errstate(invalid="ignore"):  # other programs write covariances with negative variances
        sigma_enu, vsigma_enu = (np.sqrt(np.diagonal(c, axis1=1, axis2=2)) for c in (cov_enu, vcov_enu))
    columns = [
        pl.Series("t_gpst_ns", solution.t_ns),
        _instants("gpst", solution.t_ns),
        _enum("status", solution.status, EPOCH_STATUS_NAMES),
        _series("lat_deg", np.degrees(llh[:, 0])),
        _series("lon_deg", np.degrees(llh[:, 1])),
        _series("h_m", llh[:, 2]),
        *(_series(f"{a}_m", solution.pos_e[:, i]) for i, a in enumerate(_AXES)),
        *(_series(f"v{a}_mps", solution.vel_e[:, i]) for i, a in enumerate(_AXES)),
        *(_series(f"v{a}_mps", vel_enu[:, i]) for i, a in enumerate("enu")),
        *(_series(f"sigma_{a}_m", sigma_enu[:, i]) for i, a in enumerate("enu")),
        *(_series(f"sigma_v{a}_mps", vsigma_enu[:, i]) for i, a in enumerate("enu")),
        *(_series(f"cov_{_AXES[i]}{_AXES[j]}_m2", solution.cov_pos[:, i, j]) for i, j in _PAIRS),
        *(_series(f"cov_v{_AXES[i]}v{_AXES[j]}_m2ps2", solution.cov_vel[:, i, j]) for i, j in _PAIRS),
    ]
    for i, system in enumerate(solution.clock_names):
        columns += [
            _series(f"clock_{system}_m", solution.clock_m[:, i]),
            _series(f"sigma_clock_{system}_m", solution.clock_sigma_m[:, i]),
            _series(f"drift_{system}_mps", solution.drift_mps[:, i]),
        ]
    columns.append(pl.Series("n_used", solution.n_used))
    columns += [_series(name, solution.dop[:, i]) for i, name in enumerate(_DOPS)]
    columns += [_series("nis", solution.nis), pl.Series("dof", solution.dof)]
    columns += [_series(name, values) for name, values in solution.extra.items()]
    return pl.DataFrame(columns)


def ledger_table(ledger: dict[str, NDArray[Any]]) -> "pl.DataFrame":
    """Ledger as a table with names in place of identifiers and degrees in place of radians."""
    import polars as pl

    columns = []
    for name, values in ledger.items():
        if name == "t_ns":
            columns.append(pl.Series("t_gpst_ns", values))
        elif name == "sv":
            columns.append(_names(name, values, sv_name))
        elif name in ("sig", "sig2"):
            columns.append(_names(name.replace("sig", "signal"), values, signal_name))
        elif name == "status":
            columns.append(_enum(name, values, ROW_STATUS_NAMES))
        elif name.endswith("_rad"):
            columns.append(_series(name.removesuffix("_rad") + "_deg", np.degrees(values)))
        else:
            columns.append(_series(name, values))
    return pl.DataFrame(columns)


def read_solution(path: str | Path, *, ledger: bool = True) -> Solution:
    """Solution of a result directory, of its ``solution.parquet`` alone, or of a file of another program.

    Parameters
    ----------
    path : path-like
        Directory, Parquet file, or what `starwise.io.foreign.read_foreign` reads: `.pos`, ``.stat``, NMEA, tables of
        gnss_lib_py, navigation results of KF-GINS (also their directory), ``starwise export --to csv``.
    ledger : bool
        Read the ledger, too, where there is one.

    Raises
    ------
    StarwiseError
        Nothing there, an unfinished result, or columns missing.
    """
    path = Path(path)
    if not path.exists():
        raise StarwiseError("no such file or directory", file=path)
    if path.is_dir() and not (path / SOLUTION).exists() and (path / NAV_NAME).is_file():
        path = path / NAV_NAME
    if not path.is_dir() and not (path.is_file() and _is_parquet(path)):
        return read_foreign(path)
    table_path = path / SOLUTION if path.is_dir() else path
    provenance: dict[str, Any] = {}
    if path.is_dir():
        if not table_path.is_file():
            raise StarwiseError(f"no {SOLUTION} in this directory", file=path)
        provenance = _read_run(path / RUN)
    rows = _read_parquet(path / LEDGER) if ledger and (path / LEDGER).is_file() else None
    table = _read_parquet(table_path)
    try:
        return solution_of_table(table, {} if rows is None else _ledger_of(rows), provenance)
    except (KeyError, ValueError, TypeError) as error:
        raise StarwiseError(f"not a solution table ({error})", file=table_path) from None


def _is_parquet(path: Path) -> bool:
    try:
        with open(path, "rb") as file:
            return file.read(4) == b"PAR1"
    except OSError as error:
        raise StarwiseError(f"cannot be read: {error.strerror}", file=path) from None


def _read_run(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise StarwiseError("not JSON", file=path) from None
    if not isinstance(record, dict):
        raise StarwiseError("not a JSON object", file=path)
    if record.pop("complete", True) is False:
        raise StarwiseError("an unfinished result: its writing was interrupted", file=path)
    record.pop("files", None)
    return record


def _read_parquet(path: Path) -> "pl.DataFrame":
    import polars as pl

    try:
        return pl.read_parquet(path, use_pyarrow=False)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise StarwiseError(f"not readable as Parquet ({str(error).splitlines()[0]})", file=path) from None


def _numbers(table: "pl.DataFrame", name: str) -> NDArray[np.float64]:
    """Column as float64 with NaN for null; KeyError if it is not there."""
    if name not in table.columns:
        raise KeyError(name)
    import polars as pl

    return np.asarray(table[name].cast(pl.Float64).fill_null(float("nan")).to_numpy(), dtype=np.float64)


def _symmetric(table: "pl.DataFrame", pattern: str) -> NDArray[np.float64]:
    cov = np.empty((table.height, 3, 3))
    for i, j in _PAIRS:
        cov[:, i, j] = cov[:, j, i] = _numbers(table, pattern.format(_AXES[i], _AXES[j]))
    return cov


def solution_of_table(table: "pl.DataFrame", ledger: dict[str, NDArray[Any]], provenance: dict[str, Any]) -> Solution:
    """Solution of a table with the columns of ``solution.parquet``; KeyError, ValueError or TypeError if it is none."""
    systems = tuple(name[6:-2] for name in table.columns if name.startswith("clock_") and name.endswith("_m"))
    if "status" not in table.columns or "t_gpst_ns" not in table.columns:
        raise KeyError("t_gpst_ns and status")

    def stack(names: Sequence[str]) -> NDArray[np.float64]:
        if not names:
            return np.empty((table.height, 0))
        return np.stack([_numbers(table, name) for name in names], axis=1)

    return Solution(
        t_ns=table["t_gpst_ns"].to_numpy().astype(np.int64),
        status=_codes(table["status"], EPOCH_STATUS_NAMES.index).astype(np.uint8),
        pos_e=stack([f"{a}_m" for a in _AXES]),
        vel_e=stack([f"v{a}_mps" for a in _AXES]),
        cov_pos=_symmetric(table, "cov_{}{}_m2"),
        cov_vel=_symmetric(table, "cov_v{}v{}_m2ps2"),
        clock_m=stack([f"clock_{s}_m" for s in systems]),
        drift_mps=stack([f"drift_{s}_mps" for s in systems]),
        clock_sigma_m=stack([f"sigma_clock_{s}_m" for s in systems]),
        clock_names=systems,
        n_used=_numbers(table, "n_used").astype(np.int32),
        dop=stack(_DOPS),
        nis=_numbers(table, "nis"),
        dof=_numbers(table, "dof").astype(np.int32),
        ledger=ledger,
        provenance=provenance,
        # further estimates stand behind the last column that every solution has
        extra={name: _numbers(table, name) for name in table.columns[table.columns.index("dof") + 1 :]},
    )


def _codes(series: "pl.Series", code: Callable[[str], int]) -> NDArray[np.int64]:
    names = series.unique().to_list()
    return np.asarray(series.cast(str).replace_strict({name: code(name) for name in names}).to_numpy())


def _ledger_of(table: "pl.DataFrame") -> dict[str, NDArray[Any]]:
    ledger: dict[str, NDArray[Any]] = {}
    for name in table.columns:
        series = table[name]
        if name == "t_gpst_ns":
            ledger["t_ns"] = series.to_numpy().astype(np.int64)
        elif name == "sv":
            ledger[name] = _codes(series, sv_id).astype(np.int16)
        elif name in ("signal", "signal2"):
            ids = _codes(series, lambda text: 0 if text == "--" else signal_id(text))
            ledger[name.replace("signal", "sig")] = ids.astype(np.int16)
        elif name == "status":
            ledger[name] = _codes(series, ROW_STATUS_NAMES.index).astype(np.uint8)
        elif name.endswith("_deg"):
            ledger[name.removesuffix("_deg") + "_rad"] = np.radians(_numbers(table, name))
        elif series.dtype.is_float():
            ledger[name] = _numbers(table, name)
        else:
            ledger[name] = series.to_numpy()
    return ledger
