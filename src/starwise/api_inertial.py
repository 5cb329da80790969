"""Inertial navigation in one call: readings with fixes or with satellites, files in, a solution out."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from starwise import __version__
from starwise.api import PathLike, Progress, _check, _ephemeris, _input_records, _problem, _station, page_of
from starwise.checked import merged, nested, read_toml, with_file, with_line
from starwise.config import RunConfig
from starwise.config_inertial import InertialConfig
from starwise.errors import StarwiseError
from starwise.io.imu import read_imu
from starwise.io.imu_config import layout_names
from starwise.io.inputs import Inputs, sort_inputs
from starwise.io.results import prepare_directory, read_solution, write_results
from starwise.types import Inertial, Solution

_WITH_FIXES = ("start", "end", "interval_s")
"""Options of a run that also hold for fixes."""


def solve_inertial(
    *files: PathLike,
    imu: PathLike,
    imu_config: PathLike,
    fixes: PathLike | None = None,
    config: PathLike | None = None,
    options: Mapping[str, Any] | None = None,
    output: PathLike | None = None,
    progress: Progress | None = None,
    report: bool = True,
) -> Solution:
    """Position, velocity, attitude and sensor biases out of inertial readings and fixes or satellites.

    Parameters
    ----------
    *files : path-like
        RINEX observations and navigation files, as `starwise.api.solve`; none with ``fixes``.
    imu : path-like
        Inertial readings.
    imu_config : path-like
        TOML description of the readings (`starwise.io.imu_config`), or the name of a layout. Its table ``[inertial]``,
        if there, has options of `InertialConfig`.
    fixes : path-like, optional
        Positions and velocities from elsewhere: ``.pos`` of any form, NMEA, or a result of this program.
    config : path-like, optional
        TOML file with fields of `RunConfig`, and a table ``[inertial]``.
    options : mapping, optional
        What overrides them: fields of `RunConfig`, ``method`` (``loose`` or ``tight``), and ``inertial.KEY``.
    output : path-like, optional
        Directory for the results, as `starwise.api.solve`.
    progress : callable, optional
    report : bool
        Write ``report.html``, too.

    Returns
    -------
    Solution
        Of the antenna; ``extra`` has attitude (of the sensor's declared axes), biases and their sigmas.

    Raises
    ------
    StarwiseError
        A file or an option that cannot be used.
    """
    say = progress or (lambda _what, _fraction: None)
    run, chosen, given = _configs(imu_config, config, options or {})
    if fixes is not None and chosen.method == "tight":
        raise StarwiseError("tight coupling wants satellites", found="--fixes", wanted="RINEX files, or --method loose")
    unused = sorted(given - set(_WITH_FIXES)) if fixes is not None else []
    if unused:
        raise StarwiseError("an option that fixes have no use for", found=unused[0], wanted=", ".join(_WITH_FIXES))
    if (fixes is None) == (not files):
        wanted = "RINEX files, or --fixes FILE" if fixes is None else "one of them: RINEX files, or --fixes"
        raise StarwiseError("inertial readings want something to aid them", wanted=wanted)
    if output is not None:
        prepare_directory(output)
    say("reading", 0.0)
    inertial = read_imu(imu, imu_config if str(imu_config) in layout_names() else Path(imu_config))
    records = [_record("inertial", imu)]
    if fixes is not None:
        records.append(_record("fixes", fixes))
    else:
        inputs = sort_inputs(tuple(files))
        _check(inputs)
        records = [*_input_records(inputs), *records]
    try:
        if fixes is not None:
            solution = _with_fixes(fixes, inertial, run, chosen, say)
        else:
            solution = _with_satellites(inputs, inertial, run, chosen, say)
    except StarwiseError as error:
        raise with_file(error, str(imu)) from None
    from starwise.report.summary import summarise

    provenance: dict[str, Any] = {
        "starwise": __version__,
        "config": {**run.to_dict(), "method": chosen.method, "inertial": chosen.to_dict()},
        "inputs": records,
        **solution.provenance,
        "problems": [*(_problem(p) for p in inertial.problems), *solution.provenance.get("problems", [])],
        "summary": {**summarise(solution), **_attitude(solution)},
    }
    solution = replace(solution, provenance=provenance)
    if output is not None:
        say("writing", 0.95)
        write_results(solution, output, page_of(solution) if report else None)
    say("done", 1.0)
    return solution


def _configs(
    imu_config: PathLike, config: PathLike | None, options: Mapping[str, Any]
) -> tuple[RunConfig, InertialConfig, set[str]]:
    """Options of the run and of the inertial filter, and the names of those of the run that were given."""
    run_data: dict[str, Any] = {}
    ins_data: dict[str, Any] = {}
    if config is not None:
        run_data = read_toml(Path(config))
        ins_data = _table(run_data.pop("inertial", {}), config)
    if str(imu_config) not in layout_names() and Path(imu_config).is_file():
        ins_data = merged(_table(read_toml(Path(imu_config)).get("inertial", {}), imu_config), ins_data)
    asked = nested(options)
    over = asked.pop("inertial", {})
    ins_data = merged(ins_data, over if isinstance(over, Mapping) else {})
    for source in (run_data, asked):
        method = source.pop("method", None)
        if method is None:
            continue
        if method not in ("loose", "tight"):
            raise StarwiseError("'method' has no such choice with --imu", found=str(method), wanted="loose | tight")
        ins_data["method"] = method
    run_data = merged(run_data, asked)
    if run_data.get("adaptation", "none") != "none":
        raise StarwiseError("adaptation rules are of satellite filters", found="--imu", wanted="adaptation none")
    clock = run_data.get("clock")
    if isinstance(clock, Mapping) and clock.get("isolate"):
        raise StarwiseError("'clock.isolate' is of satellite filters", found="--imu", wanted="clock.isolate false")
    return RunConfig.from_dict(run_data), InertialConfig.from_dict(ins_data, prefix="inertial."), set(run_data)


def _table(value: Any, file: PathLike) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise StarwiseError("'inertial' is a table", file=str(file), found=str(value), wanted="[inertial]")
    try:
        InertialConfig.from_dict(value, file=str(file), prefix="inertial.")
    except StarwiseError as error:
        raise with_line(error, Path(file)) from None
    return dict(value)


def _record(kind: str, path: PathLike) -> dict[str, Any]:
    from starwise.io.files import sha256

    file = Path(path)
    file = file / "solution.parquet" if file.is_dir() else file
    if not file.is_file():
        raise StarwiseError("no such file", file=str(path))
    return {"kind": kind, "path": str(path), "bytes": file.stat().st_size, "sha256": sha256(file)}


def _with_fixes(fixes: PathLike, inertial: Inertial, run: RunConfig, config: InertialConfig, say: Progress) -> Solution:
    from starwise.estimators.ins import loose
    from starwise.estimators.ins_tight import fixes_of

    read = read_solution(Path(fixes), ledger=False)
    keep = np.ones(read.n_epochs, dtype=bool)
    if run.start_ns is not None:
        keep &= read.t_ns >= run.start_ns
    if run.end_ns is not None:
        keep &= read.t_ns <= run.end_ns
    if run.interval_s is not None:
        step = round(run.interval_s * 1e9)
        keep &= (read.t_ns + 5_000_000) % step < 10_000_000
    found = fixes_of(read)
    k = keep[read.has_position]
    assert found.vel_e is not None
    assert found.cov_vel is not None
    found = replace(
        found, t_ns=found.t_ns[k], available_ns=found.available_ns[k], pos_e=found.pos_e[k], cov_pos=found.cov_pos[k],
        vel_e=found.vel_e[k], cov_vel=found.cov_vel[k], source=str(fixes),
    )  # fmt: skip
    say("loose coupling", 0.3)
    solution = loose(found, inertial, config).solution
    notes = list(solution.provenance.get("notes", []))
    if read.provenance.get("height") == "geodetic":
        notes.append("heights of the fixes are above the geoid: so are those of the result")
    return replace(solution, provenance={**solution.provenance, "notes": notes})


def _with_satellites(
    inputs: Inputs, inertial: Inertial, run: RunConfig, config: InertialConfig, say: Progress
) -> Solution:
    from starwise.estimators.ins import loose
    from starwise.estimators.ins_tight import fixes_of, tight
    from starwise.estimators.run import solve_run
    from starwise.io.rinex_obs import read_obs

    obs = read_obs(*inputs.obs)
    ephemeris, ionosphere, problems = _ephemeris(inputs)
    say(f"{config.method} coupling", 0.3)
    if config.method == "tight":
        solution = tight(obs, ephemeris, ionosphere, inertial, run, config).solution
    else:
        # Fixes of single epochs: their errors do not depend on each other through a filter.
        epochs = solve_run(obs, ephemeris, ionosphere, run.with_options({"method": "lsq"}))
        made = loose(fixes_of(epochs), inertial, config, epochs_ns=epochs.t_ns).solution
        notes = [*epochs.provenance.get("notes", []), *made.provenance.get("notes", [])]
        solution = replace(made, provenance={**made.provenance, "notes": notes})
    found = [_problem(p) for p in (*obs.problems, *problems)]
    return replace(solution, provenance={**solution.provenance, "station": _station(obs), "problems": found})


def _attitude(solution: Solution) -> dict[str, Any]:
    """Last estimates beside position and velocity, with their sigmas."""
    if not solution.n_epochs:
        return {}
    return {"final": {name: round(float(values[-1]), 6) for name, values in solution.extra.items()}}
