"""One unit of a batch, as a worker does it: files in, result and a row of the summary out."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Final

from starwise.batch import store
from starwise.checked import Checked, Range
from starwise.config import RunConfig
from starwise.errors import StarwiseError
from starwise.io.results import ASSESSMENT, REPORT, RESULT_FILES, RUN, write_results
from starwise.spread.cluster import check_code
from starwise.types import Solution

SEAL: Final = "unit.json"
"""Written last into the folder of a unit: what it was made from, and its row."""
_WHOLE: Final = (SEAL, *RESULT_FILES, REPORT, ASSESSMENT)
"""A result, and what was made of it later."""
OK, NO_SOLUTION, FAILED, UNPAIRED = "ok", "no_solution", "failed", "unpaired"
NAME_LENGTH: Final = 200
Row = dict[str, float | int | str | bool | None]


@dataclass(frozen=True)
class Unit(Checked):
    """One run of a batch. Places are paths or URLs of fsspec, like ``s3://bucket/name``."""

    name: str
    """Of its folder ``unit=NAME`` and of its row: letters, digits, ``. _ -``."""
    obs: tuple[str, ...]
    """RINEX observations of one receiver."""
    nav: tuple[str, ...] = ()
    sp3: tuple[str, ...] = ()
    clk: tuple[str, ...] = ()
    truth: str | None = None
    """ECEF ``X,Y,Z`` in metres, ``lat,lon,h`` in degrees and metres, or a file; see `starwise.api.assess`."""
    antenna_up_m: float = 0.0
    """Height of the antenna above the point that the truth is of, m."""
    tolerance_s: Annotated[float, Range(0.0, 1e5)] = 0.05
    """Greatest distance in time to a row of the truth, s."""
    interpolate: bool = False
    """Interpolate the truth between its rows."""
    ledger: bool = True
    """Keep ``ledger.parquet``, most of the bytes of a result."""
    config: RunConfig = field(default_factory=RunConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        plain = self.name.replace("-", "").replace(".", "").replace("_", "")
        if not (plain.isascii() and plain.isalnum()) or self.name[0] == "." or len(self.name) > NAME_LENGTH:
            raise StarwiseError(
                "not the name of a unit", found=self.name, wanted=f"letters, digits, . _ -, at most {NAME_LENGTH}"
            )
        if not self.obs:
            raise StarwiseError("'obs' is empty", found=self.name, wanted="observation files")

    @property
    def files(self) -> tuple[str, ...]:
        """Everything that `starwise.api.solve` is given."""
        return (*self.obs, *self.nav, *self.sp3, *self.clk)

    @property
    def truth_file(self) -> str | None:
        """The truth, if it is a file."""
        if self.truth is None:
            return None
        return self.truth if store.is_url(self.truth) or Path(self.truth).exists() else None


@dataclass(frozen=True)
class Work:
    """A unit on its way to a worker."""

    number: int
    unit: Unit
    output: str
    """Folder or URL of the batch."""
    code: str
    """Hash of the program's sources where the batch was started."""
    token: str | None = None
    """A file in ``output`` that a worker sees who shares this folder; None: it is a URL."""
    known: Mapping[str, Any] | None = None
    """The seal of what is there already, if ``output`` is a folder and the result is whole."""

    @property
    def place(self) -> str:
        """Folder or URL of the unit."""
        return f"{self.output.rstrip('/')}/unit={self.unit.name}"


@dataclass(frozen=True)
class Done:
    """What comes back: the row and, from a worker that does not see the folder, the files."""

    row: Row
    files: Mapping[str, bytes] | None = None
    unseen: bool = False
    """The unit was not looked at: a result that is there stays."""


def sealed(place: str) -> dict[str, Any] | None:
    """Seal of a folder's result if it is whole: all files there in their sizes, and ``run.json`` complete."""
    seal = store.read_json(f"{place}/{SEAL}")
    if seal is None or not isinstance(seal.get("row"), dict) or not isinstance(seal.get("files"), dict):
        return None
    if store.sizes(tuple(seal["files"]), place) != seal["files"]:
        return None
    run = store.read_json(f"{place}/{RUN}")
    return seal if run is not None and run.get("complete") is True else None


def key_of(unit: Unit, code: str) -> str:
    """Hash of all that a unit's result depends on: contents of its files, configuration, truth, program.

    Raises
    ------
    StarwiseError
        A file is not there.
    """
    truth = unit.truth if unit.truth_file is None else store.fingerprint(unit.truth_file)
    return store.hash_of(
        {
            "files": [store.fingerprint(place) for place in unit.files],
            "roles": [len(unit.obs), len(unit.nav), len(unit.sp3), len(unit.clk)],
            "config": unit.config.to_dict(),
            "truth": [truth, unit.antenna_up_m, unit.tolerance_s, unit.interpolate] if truth else None,
            "ledger": unit.ledger,
            "code": code,
        }
    )


def do_unit(work: Work) -> Done:
    """Solve a unit and judge it, unless its result is there and still holds; a failure is a row, too."""
    began = time.perf_counter()
    try:
        check_code(work.code)
    except StarwiseError as error:
        return failed(work, str(error), began, unseen=True)
    try:
        key = key_of(work.unit, work.code)
        known = work.known if work.token is not None else sealed(work.place)
        if known is not None and known.get("key") == key:
            return Done({**known["row"], "number": work.number, "resumed": True})
        return _do_anew(work, key, began)
    except StarwiseError as error:
        return failed(work, str(error), began)
    except MemoryError:
        return failed(work, "out of memory", began)
    except Exception as error:
        text = " ".join(str(error).split())[:200]
        return failed(work, f"a defect of the program ({type(error).__name__}: {text})", began)


def failed(work: Work, message: str, began: float | None = None, *, unseen: bool = False) -> Done:
    """Row of a unit that failed. What an earlier batch left at a URL is removed; in a folder, whoever sees it does.

    Unless the unit was not looked at: a worker of another version must not take away what others have done.
    """
    if work.token is None and not unseen:
        message += withdraw(work.place)
    seconds = 0.0 if began is None else time.perf_counter() - began
    return Done(
        {
            "number": work.number,
            "unit": work.unit.name,
            "status": FAILED,
            "seconds": round(seconds, 3),
            "message": message,
            "resumed": False,
        },
        unseen=unseen,
    )


def withdraw(place: str) -> str:
    """Remove the result of an earlier batch, which holds no longer; what went wrong with it, for a message."""
    try:
        if store.read_json(f"{place}/{SEAL}") is not None:
            store.remove_files(_WHOLE, place)
    except StarwiseError as error:
        return f"; {error}"
    return ""


def put_result(files: Mapping[str, Path | bytes], place: str) -> None:
    """Write the files of a result, the seal last, where another may be: of that one nothing is left that would fit.

    Raises
    ------
    StarwiseError
        The place cannot be written.
    """
    store.remove_files((SEAL, *(name for name in _WHOLE if name not in files)), place)
    store.put_files(files, place)


def _do_anew(work: Work, key: str, began: float) -> Done:
    unit = work.unit
    places = (*unit.files, *((unit.truth_file,) if unit.truth_file else ()))
    with store.fetched(places) as local, TemporaryDirectory(prefix="starwise-") as folder:
        try:
            solution = _solve(unit, local)
            row: Row = {"number": work.number, "unit": unit.name, **_figures(solution)}
            if unit.truth is not None and row["status"] == OK:
                row.update(_judged(unit, solution, str(local.get(unit.truth, unit.truth))))
        except StarwiseError as error:
            raise _with_places(error, local) from None
        shared = work.token is not None and Path(work.token).exists()
        if shared or work.token is None:
            store.remove_files((SEAL,), work.place)
            store.remove_leftovers(work.place)
        files = write_results(solution, work.place if shared else folder, ledger=unit.ledger)
        written = {name: path.stat().st_size for name, path in files.items()}
        row["bytes_in"] = sum(local[place].stat().st_size for place in dict.fromkeys(unit.files))
        row["bytes_out"] = sum(written.values())
        row["seconds"] = round(time.perf_counter() - began, 3)
        row["resumed"] = False
        seal = _seal(key, row, written)
        if shared:
            store.put_files({SEAL: seal}, work.place)
            return Done(row)
        if work.token is None:
            put_result({**files, SEAL: seal}, work.place)
            return Done(row)
        return Done(row, {**{name: path.read_bytes() for name, path in files.items()}, SEAL: seal})


def _with_places(error: StarwiseError, local: Mapping[str, Path]) -> StarwiseError:
    """The error with the places that the unit names, not the copies."""
    message, file = error.message, error.file
    for place, path in local.items():
        message = message.replace(str(path), place)
        file = place if file == str(path) else file
    return StarwiseError(message, file=file, line=error.line, found=error.found, wanted=error.wanted)


def _seal(key: str, row: Row, written: Mapping[str, int]) -> bytes:
    import json

    record = {"key": key, "files": dict(written), "row": row}
    return (json.dumps(record, indent=1, allow_nan=False) + "\n").encode()


def _solve(unit: Unit, local: Mapping[str, Path]) -> Solution:
    """Solution; its provenance names the places that the unit names, not the copies."""
    from starwise.api import solve

    solution = solve(*(local[place] for place in unit.files), config=unit.config)
    names = {str(path): place for place, path in local.items()}
    inputs = [{**item, "path": names.get(item["path"], item["path"])} for item in solution.provenance["inputs"]]
    problems = [{**item, "file": names.get(item["file"], item["file"])} for item in solution.provenance["problems"]]
    return replace(solution, provenance={**solution.provenance, "inputs": inputs, "problems": problems})


def _figures(solution: Solution) -> Row:
    """Columns of the summary that need no truth."""
    about = solution.provenance
    summary, problems = about["summary"], about["problems"]
    solved = bool(solution.has_position.any())
    return {
        "status": OK if solved else NO_SOLUTION,
        "marker": about["station"]["marker"],
        "first_gpst": summary["first_epoch_gpst"],
        "last_gpst": summary["last_epoch_gpst"],
        "interval_s": summary["interval_s"],
        "epochs": summary["epochs"],
        "solved": summary["epochs_solved"],
        "satellites": summary.get("satellites_used_mean"),
        "sigma_3d_m": summary["sigma_3d_mean_m"],
        "clocks": "".join(solution.clock_names),
        "problems": sum(int(item["count"]) for item in problems),
        "message": str(problems[0]["what"]) if problems else None,
    }


def _judged(unit: Unit, solution: Solution, truth: str) -> Row:
    from starwise.api import assess

    try:
        report = assess(
            solution,
            truth,
            antenna_up_m=unit.antenna_up_m,
            tolerance_s=unit.tolerance_s,
            interpolate=unit.interpolate,
            parts=(),
        )
    except StarwiseError as error:
        raise StarwiseError(f"solved, but not to be judged: {error}") from None
    kept = ("rms_2d_m", "rms_3d_m", "p95_3d_m", "mean_u_m", "coverage_50", "coverage_68", "coverage_95", "nees_mean")
    return {"compared": report["epochs_compared"], **{name: report[name] for name in kept}}
