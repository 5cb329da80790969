"""The whole job in one call: files in, nouns out. The command line is a thin layer over these functions."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from starwise import __version__
from starwise.analysis.accuracy import assess as assess_solution
from starwise.analysis.accuracy import raised
from starwise.analysis.weeks import in_one_week
from starwise.api_assess import PARTS, Laboratory, keep, notes_of, suggested
from starwise.config import RunConfig, load_config
from starwise.errors import StarwiseError
from starwise.io.inputs import Inputs, peek, sort_inputs
from starwise.io.results import prepare_directory, read_solution, write_results
from starwise.types import BroadcastRecords, Ephemeris, IonosphereModel, Observations, Problem, Solution, Truth
from starwise.warmup import COMPILING, ensure_warm

PathLike = str | Path
Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction (0..1) of the whole that is."""


def solve(
    *files: PathLike,
    ephemeris: PathLike | None = None,
    clock: PathLike | None = None,
    config: RunConfig | PathLike | None = None,
    output: PathLike | None = None,
    progress: Progress | None = None,
    report: bool = True,
    notes: Sequence[str] = (),
    **options: Any,
) -> Solution:
    """Position and velocity per epoch, with covariance, from the observations of one receiver.

    Parameters
    ----------
    *files : path-like
        RINEX observation files of one receiver, RINEX navigation files, SP3 and CLK files, in any order and however
        compressed: what each is, is told by its content.
    ephemeris, clock : path-like, optional
        An SP3 file and a CLK file; the same as among ``files``.
    config : RunConfig or path-like, optional
        Configuration or a TOML file with one.
    output : path-like, optional
        Directory for `solution.parquet`, `ledger.parquet`, `solution.pos`, `run.json` and `report.html`.
    progress : callable, optional
    report : bool
        Write `report.html` with the others.
    notes : sequence of str
        To stand in ``run.json`` before what the run itself has to say.
    **options
        Fields of `RunConfig` that override ``config``.

    Returns
    -------
    Solution
        ECEF, GPST, SI; with the ledger, and in ``provenance`` the version, the effective configuration, the inputs
        with their SHA-256, their problems, and a summary.

    Raises
    ------
    StarwiseError
        A file or an option that cannot be used.
    """
    chosen = _config(config, options)
    given = [*files, *(path for path in (ephemeris, clock) if path is not None)]
    inputs = sort_inputs(tuple(given))
    _check(inputs)
    _check_kind(ephemeris, inputs.sp3, "SP3 orbits")
    _check_kind(clock, inputs.clk, "RINEX clocks")
    if output is not None:
        prepare_directory(output)
    say = progress or (lambda _what, _fraction: None)
    ensure_warm(lambda: say(COMPILING, 0.0))
    with ThreadPoolExecutor(1) as pool:
        records = pool.submit(_input_records, inputs)
        solution = _solve(inputs, chosen, say, records)
    if notes:
        said = [*notes, *solution.provenance.get("notes", ())]
        solution = replace(solution, provenance={**solution.provenance, "notes": said})
    if output is not None:
        say("writing", 0.95)
        write_results(solution, output, page_of(solution) if report else None)
    say("done", 1.0)
    return solution


def page_of(solution: Solution, truth: Truth | None = None) -> Callable[[], bytes]:
    """What makes the report of a solution, when called; nothing is loaded before."""

    def make() -> bytes:
        from starwise.report.html import run_page

        return run_page(solution, truth)

    return make


def _solve(inputs: Inputs, config: RunConfig, say: Progress, records: "Future[list[dict[str, Any]]]") -> Solution:
    from starwise.estimators.sessions import solve_sessions
    from starwise.io.rinex_obs import read_obs
    from starwise.report.summary import summarise

    say("reading", 0.0)
    obs = read_obs(*inputs.obs)
    ephemeris, ionosphere, problems = _ephemeris(inputs)
    say("solving", 0.4)
    solution = solve_sessions(obs, ephemeris, ionosphere, config, lambda what, part: say(what, 0.4 + 0.5 * part))
    provenance: dict[str, Any] = {
        "starwise": __version__,
        "config": config.to_dict(),
        "effective": _effective(config.with_options({"dynamics": solution.provenance["dynamics"]["used"]})),
        "inputs": records.result(),
        "station": _station(obs),
        "problems": [_problem(p) for p in (*obs.problems, *problems)],
        **solution.provenance,
        "summary": summarise(solution),
    }
    return replace(solution, provenance=provenance)


def _effective(config: RunConfig) -> dict[str, Any]:
    """Numbers behind what the configuration leaves to presets and tables."""
    from dataclasses import asdict

    from starwise.models.process import clocks_from, motion_from
    from starwise.signals import DEFAULT_PAIRS, DEFAULT_PREFERENCE

    own = config.signals or {}
    built_in = (
        {k: [*first, *second] for k, (first, second) in DEFAULT_PAIRS.items()}
        if config.combination == "ionosphere_free"
        else {k: list(v) for k, v in DEFAULT_PREFERENCE.items()}
    )
    return {
        "process": asdict(motion_from(config)),
        "clock": asdict(clocks_from(config)),
        "signals": {k: list(own.get(k, built_in[k])) for k in config.systems},
    }


def _config(config: RunConfig | PathLike | None, options: Mapping[str, Any]) -> RunConfig:
    if isinstance(config, RunConfig):
        return config.with_options(options) if options else config
    return load_config(config, options)


def _check(inputs: Inputs) -> None:
    if not inputs.obs:
        raise StarwiseError("no observations", found=_names(inputs), wanted="a RINEX observation file")
    if not inputs.nav and not inputs.sp3:
        raise StarwiseError("no ephemeris", found=_names(inputs), wanted="a RINEX navigation file, or --ephemeris SP3")
    if inputs.clk and not inputs.sp3:
        raise StarwiseError("clocks without orbits", file=inputs.clk[0], wanted="an SP3 file with them")


def _check_kind(path: PathLike | None, found: tuple[Path, ...], what: str) -> None:
    if path is not None and Path(path) not in found:
        raise StarwiseError("not what the option wants", file=str(path), found=peek(path).kind, wanted=what)


def _names(inputs: Inputs) -> str:
    return ", ".join(path.name for _, path in inputs.all) or "nothing"


def _input_records(inputs: Inputs) -> list[dict[str, Any]]:
    from starwise.io.files import sha256

    return [
        {"kind": kind, "path": str(path), "bytes": path.stat().st_size, "sha256": sha256(path)}
        for kind, path in inputs.all
    ]


def _ephemeris(inputs: Inputs) -> tuple[Ephemeris, IonosphereModel, tuple[Problem, ...]]:
    from starwise.physics.broadcast import BroadcastEphemeris

    records: BroadcastRecords | None = None
    if inputs.nav:
        from starwise.io.rinex_nav import read_nav

        records = read_nav(*inputs.nav)
    broadcast = None if records is None else BroadcastEphemeris(records)
    ionosphere = IonosphereModel() if records is None else records.ionosphere
    problems = () if records is None else records.problems
    if not inputs.sp3:
        assert broadcast is not None
        return broadcast, ionosphere, problems
    from starwise.io.clk import read_clk
    from starwise.io.sp3 import read_sp3
    from starwise.physics.precise import PreciseEphemeris

    orbits = read_sp3(*inputs.sp3)
    clocks = read_clk(*inputs.clk) if inputs.clk else None
    problems += orbits.problems + (() if clocks is None else clocks.problems)
    return PreciseEphemeris(orbits, clocks, broadcast), ionosphere, problems


def _station(obs: Observations) -> dict[str, Any]:
    head = obs.header
    return {
        "marker": head.marker,
        "receiver": head.receiver,
        "antenna": head.antenna,
        "rinex": head.version,
        "approx_pos_e_m": None if head.approx_pos_e is None else list(head.approx_pos_e),
        "antenna_height_east_north_m": list(head.antenna_hen),
        "interval_s": head.interval_s,
    }


def _problem(problem: Problem) -> dict[str, Any]:
    return {"file": problem.file, "line": problem.line, "what": problem.what, "count": problem.count}


def assess(
    solution: Solution | PathLike,
    truth: Truth | str | Path | None = None,
    *,
    antenna_up_m: float = 0.0,
    geoid_m: float | None = None,
    tolerance_s: float = 0.05,
    interpolate: bool = False,
    rtklib_conf: PathLike | None = None,
    parts: Sequence[str] = PARTS,
    what_if: str | None = None,
    windows: int = 8,
    steps: int | None = 240,
    write: bool | PathLike = False,
    suggest: PathLike | None = None,
    tune: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Errors of a solution against the truth, whether its covariance tells them, and what the laboratory says.

    Parameters
    ----------
    solution : Solution or path-like
        A solution, the directory of a result, or a file that `starwise.read_solution` reads: RTKLIB `.pos` and
        ``.stat``, NMEA, tables of gnss_lib_py (also of residuals alone), navigation results of KF-GINS.
    truth : Truth, path-like or str, optional
        A truth, its file, ``"X,Y,Z"`` (ECEF, m) or ``"lat,lon,h"`` (deg, m). Without it the errors are counted from
        the solution's own median position: scatter, not accuracy.
    antenna_up_m : float
        Height of the antenna above the point that the truth is of, m.
    geoid_m : float, optional
        Geoid height above the ellipsoid, m, to be added to a position file's heights above the geoid.
    tolerance_s, interpolate
        Matching in time; see `starwise.analysis.accuracy.match`.
    rtklib_conf : path-like, optional
        Options that RTKLIB wrote a ``.stat`` with, for the weights of its residuals.
    parts : sequence of str
        Parts of the laboratory: ``consistency``, ``observability``, ``stability``; empty: accuracy alone.
    what_if : str, optional
        Measurements to add or take away, like ``"altimeter,-doppler,constellation=E"``; see
        `starwise.analysis.what_if_change`.
    windows, steps : int
        Windows of the run that observability looks at, epochs that stability follows (None: all).
    write : bool or path-like
        Write ``assess.json`` and, if there is something to suggest, ``suggested.toml``: into the directory of the
        result (True; nothing if ``solution`` is none), or into a directory, or a file ``*.json``.
    suggest : path-like, optional
        File for the suggested configuration in place of ``suggested.toml``.
    tune : bool
        Find it by maximum likelihood of the innovations: the measurements are solved some dozen times anew.
    progress : callable, optional
        Of the tuning.

    Returns
    -------
    dict
        See `starwise.analysis.accuracy.assess` and `starwise.api_assess.Laboratory`; ``docs/formats.md`` describes
        every key. Files of residuals have ``consistency``; those without positions have nothing else but ``notes``.

    Raises
    ------
    StarwiseError
        A file that cannot be read, or nothing to compare.
    """
    from starwise.studies.residuals import judge_residuals, source_of_residuals

    residuals, positions = None, True
    if not isinstance(solution, Solution):
        residuals, positions = source_of_residuals(solution, rtklib_conf)
    if residuals is not None and not positions:
        alone = judge_residuals(residuals)
        return {"consistency": alone.to_dict(), "notes": list(alone.notes)}
    source = solution
    laboratory = Laboratory(tuple(parts), what_if, windows, steps, tolerance_s, interpolate)
    solution, truth, vertical = _judged(solution, truth, antenna_up_m, geoid_m, laboratory.needed)
    report = assess_solution(
        solution, truth, tolerance_s=tolerance_s, interpolate=interpolate, vertical=vertical or truth is None
    )
    notes = notes_of(solution, truth, vertical, report, tolerance_s)
    found, consistency = laboratory.records(solution, truth, vertical)
    report |= found
    if residuals is not None:
        judged = judge_residuals(residuals, conf=rtklib_conf, solution=solution, truth=truth, vertical=vertical)
        report["consistency"] = judged.to_dict()
        notes += judged.notes
    report["notes"] = notes
    tuning = None
    if tune or suggest is not None or (write is not False and "consistency" in parts):
        rerun = _rerun_of(solution) if tune else None
        tuning = suggested(solution, consistency, rerun=rerun, progress=progress, needed=tune or suggest is not None)
    if laboratory.needed:
        report["suggested"] = None if tuning is None else tuning.to_dict()
    keep(report, source, write, suggest, None if tuning is None else tuning.to_toml())
    return report


def _rerun_of(solution: Solution) -> Callable[[RunConfig], Solution]:
    """What solves the inputs of a run once more with another configuration."""
    paths = [Path(item["path"]) for item in solution.provenance.get("inputs", ())]
    gone = [str(path) for path in paths if not path.is_file()]
    if gone or not paths:
        raise StarwiseError("the inputs of the run are gone", found=gone[0] if gone else "none", wanted="no tuning")
    return lambda config: solve(*paths, config=config, report=False)


def _judged(
    solution: Solution | PathLike, truth: Truth | str | Path | None, antenna_up_m: float, geoid_m: float | None,
    ledger: bool = False,
) -> tuple[Solution, Truth | None, bool]:  # fmt: skip
    """Solution and truth of the same point, read where need be, and whether their heights are comparable."""
    if not isinstance(solution, Solution):
        solution = read_solution(solution, ledger=ledger)
    if truth is not None and not isinstance(truth, Truth):
        from starwise.io.truth import read_truth

        truth = read_truth(str(truth))
    vertical = solution.provenance.get("height") != "geodetic"
    if geoid_m is not None:
        if vertical:
            raise StarwiseError("heights are ellipsoidal already; a geoid height is not to be added")
        as_truth = Truth(solution.pos_e)
        solution, vertical = replace(solution, pos_e=raised(as_truth, geoid_m).pos_e), True
    if truth is None:
        return solution, None, vertical
    solution, truth = in_one_week(solution, truth)
    return solution, raised(truth, antenna_up_m), vertical


def pool(
    *runs: Solution | PathLike | tuple[Solution | PathLike, Truth | str | Path],
    truth: Truth | str | Path | None = None,
    session_s: float | None = None,
    antenna_up_m: float = 0.0,
    geoid_m: float | None = None,
    tolerance_s: float = 0.05,
    interpolate: bool = False,
) -> dict[str, Any]:
    """Whether the covariances of several runs hold the truth as often as they claim, over their sessions.

    Parameters
    ----------
    *runs : Solution, path-like, or pair
        Solutions, directories of results or position files; as a pair, with a truth of their own.
    truth : Truth, path-like or str, optional
        That of all runs without their own; as in `assess`.
    session_s : float, optional
        Length of a session, s; default: as the run was made (option ``session_s``), or else the whole run as one.
    antenna_up_m, geoid_m, tolerance_s, interpolate
        See `assess`.

    Returns
    -------
    dict
        See `starwise.analysis.pool.pool`.

    Raises
    ------
    StarwiseError
        A file that cannot be read, a run without a truth, or nothing to compare.
    """
    from starwise.analysis.pool import Run
    from starwise.analysis.pool import pool as pool_runs

    made = []
    for i, item in enumerate(runs, 1):
        one, own = item if isinstance(item, tuple) else (item, truth)
        name = _run_name(one, i) if isinstance(one, Solution) else str(one)
        if own is None:
            raise StarwiseError("pooling needs the truth of every run", file=name, wanted="--truth, or DIR=TRUTH")
        solution, known, vertical = _judged(one, own, antenna_up_m, geoid_m)
        assert known is not None
        made.append(Run(name, solution, known, vertical))
    return pool_runs(made, session_s=session_s, tolerance_s=tolerance_s, interpolate=interpolate)


def _run_name(solution: Solution, number: int) -> str:
    marker = solution.provenance.get("station", {}).get("marker")
    return f"run {number}" + (f" {marker}" if marker else "")


def info(path: PathLike) -> dict[str, Any]:
    """What is in a RINEX, SP3 or CLK file, a position file or a result, as a plain dictionary.

    Raises
    ------
    StarwiseError
        The file cannot be read.
    """
    from starwise.report.info import describe

    return describe(Path(path))
