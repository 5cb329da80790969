"""Command ``assess``. Options in, text out; nothing heavy imported early."""

from pathlib import Path
from typing import Annotated, Any

import typer

from starwise.errors import StarwiseError
from starwise.terminal import Json, NoReport, show, show_json


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
    no_report: NoReport = False,
    as_json: Json = False,
) -> None:
    """Errors against the truth, and whether the covariance tells them."""
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
    reports = {path: api.assess(path, own, rtklib_conf=rtklib_conf, **how) for path, own in runs}
    if not no_report:
        from starwise.report.html import refresh_reports

        refresh_reports(runs, antenna_up_m=antenna_up)
    if as_json:
        show_json(next(iter(reports.values())) if len(solutions) == 1 else reports)
        return
    from starwise.report.text import assess_text

    show("\n\n".join(assess_text(name, report) for name, report in reports.items()))


def _run_and_truth(text: str, truth: str | None) -> tuple[str, str | None]:
    """``DIR=TRUTH`` apart; a path that is there as it stands, equals signs and all, has the truth of all."""
    path, equals, own = text.partition("=")
    if not equals or Path(text).exists():
        return str(Path(text)), truth
    if not own:
        raise StarwiseError("no truth after =", found=text, wanted="DIR=TRUTH")
    return str(Path(path)), own
