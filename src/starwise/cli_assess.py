"""Command ``assess``. Options in, text out; nothing heavy imported early."""

from pathlib import Path
from typing import Annotated, Any

import typer

from starwise.errors import StarwiseError
from starwise.terminal import Json, NoReport, Progress, show, show_json


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command()(assess)


def assess(
    solutions: Annotated[
        list[str],
        typer.Argument(
            metavar="DIR|FILE[=TRUTH]",
            help="Results of solve; RTKLIB .pos and .stat, NMEA, tables of gnss_lib_py, results of KF-GINS; with a "
            "truth of their own after =.",
        ),
    ],
    truth: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z|FILE",
            help="ECEF metres, or lat,lon,height in degrees and metres, or a file: table, .pos, result. Of all that "
            "have none of their own.",
        ),
    ] = None,
    pool: Annotated[
        bool, typer.Option("--pool", help="Sessions of all together: does the claimed covariance hold the truth?")
    ] = False,
    sessions: Annotated[
        str | None,
        typer.Option(metavar="LENGTH", help="With --pool: length of a session, like 2h; default as solve was run."),
    ] = None,
    antenna_up: Annotated[
        float, typer.Option(metavar="M", help="Height of the antenna above the point that the truth is of.")
    ] = 0.0,
    geoid: Annotated[
        float | None, typer.Option(metavar="M", help="Geoid height, for position files with heights above the geoid.")
    ] = None,
    tolerance: Annotated[
        float, typer.Option(metavar="S", help="Greatest distance in time to a row of the truth.")
    ] = 0.05,
    interpolate: Annotated[bool, typer.Option("--interpolate", help="Interpolate the truth between its rows.")] = False,
    rtklib_conf: Annotated[
        Path | None, typer.Option("--rtklib-conf", metavar="FILE.conf", help="Options that RTKLIB wrote a .stat with.")
    ] = None,
    what_if: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="Measurements to add, or with - to take away: altimeter, doppler, imu_acceleration, second_antenna, "
            "constellation=E; separated by commas.",
        ),
    ] = None,
    without: Annotated[
        str | None,
        typer.Option(metavar="LIST", help="Parts to leave out: consistency, observability, stability; or all."),
    ] = None,
    every_step: Annotated[
        bool, typer.Option("--every-step", help="Stability follows all epochs, not 240: slow for long runs.")
    ] = False,
    suggest: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="Write the suggested configuration there, not beside assess.json."),
    ] = None,
    tune: Annotated[
        bool,
        typer.Option("--tune", help="Suggest by maximum likelihood: the run is solved some dozen times anew."),
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="OUT", help="Directory (or FILE.json) for the details of one solution."),
    ] = None,
    no_report: NoReport = False,
    as_json: Json = False,
) -> None:
    """Errors against the truth, whether the covariance tells them, and what the laboratory says of the filter.

    A directory of results gets assess.json with all details, and suggested.toml where a better configuration is seen.
    """
    from starwise import api

    runs = [_run_and_truth(text, truth) for text in solutions]
    how: dict[str, Any] = {
        "antenna_up_m": antenna_up,
        "geoid_m": geoid,
        "tolerance_s": tolerance,
        "interpolate": interpolate,
    }
    if pool:
        from starwise.gnsstime import parse_duration
        from starwise.report.text import pool_text

        pairs = [(path, own) if own is not None else path for path, own in runs]
        record = api.pool(*pairs, session_s=None if sessions is None else parse_duration(sessions), **how)
        if as_json:
            show_json(record)
        else:
            show(pool_text(record))
        return
    if sessions is not None:
        raise StarwiseError("--sessions", found="without --pool", wanted="--pool, or none")
    if len(runs) > 1 and (output is not None or suggest is not None or tune):
        option = "--output" if output is not None else "--suggest" if suggest is not None else "--tune"
        raise StarwiseError(option, found=f"{len(runs)} solutions", wanted="one at a time")
    how |= {"what_if": what_if, "parts": _parts(without), "steps": None if every_step else 240}
    reports: dict[str, dict[str, Any]] = {}
    with Progress(as_json or not tune) as say:
        for path, own in runs:
            reports[path] = api.assess(
                path, own, rtklib_conf=rtklib_conf, write=True if output is None else output, suggest=suggest,
                tune=tune, progress=say, **how,
            )  # fmt: skip
    if not no_report:
        from starwise.report.html import refresh_reports

        refresh_reports(runs, antenna_up_m=antenna_up)
    if as_json:
        show_json(next(iter(reports.values())) if len(solutions) == 1 else reports)
        return
    from starwise.report.lab import lab_text
    from starwise.report.text import assess_text

    show("\n\n".join(f"{assess_text(name, report)}\n\n{lab_text(report)}".rstrip() for name, report in reports.items()))


def _parts(without: str | None) -> tuple[str, ...]:
    """Parts of the laboratory that are left."""
    from starwise.api_assess import PARTS

    out = set() if without is None else {part.strip() for part in without.split(",")}
    if "all" in out:
        return ()
    unknown = sorted(out - set(PARTS))
    if unknown:
        raise StarwiseError("--without", found=unknown[0] or "nothing", wanted=f"{', '.join(PARTS)}, or all")
    return tuple(part for part in PARTS if part not in out)


def _run_and_truth(text: str, truth: str | None) -> tuple[str, str | None]:
    """``DIR=TRUTH`` apart; a path that is there as it stands, equals signs and all, has the truth of all."""
    path, equals, own = text.partition("=")
    if not equals or Path(text).exists():
        return str(Path(text)), truth
    if not own:
        raise StarwiseError("no truth after =", found=text, wanted="DIR=TRUTH")
    return str(Path(path)), own
