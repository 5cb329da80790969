"""Command ``fuse``: position fixes of several receivers. Options in, text out; nothing heavy imported early."""

from pathlib import Path
from typing import Annotated, Any

import typer

from starwise.terminal import Json, NoReport, Progress, show, show_json


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command()(fuse)


def fuse(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE", help="A file per receiver: RTKLIB .pos, NMEA, CSV table, or result of solve."),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="DIR", help="Directory for the results.")
    ] = None,
    method: Annotated[
        str | None, typer.Option(metavar="adaptive|lsq", help="Filter, or combination per epoch; default adaptive.")
    ] = None,
    dynamics: Annotated[
        str | None,
        typer.Option(metavar="static|pedestrian|vehicle|aircraft", help="How the vehicle moves; default vehicle."),
    ] = None,
    sigma: Annotated[
        float | None,
        typer.Option(metavar="M", help="Horizontal sigma of files that claim none (vertical: twice); default 3."),
    ] = None,
    geoid: Annotated[
        float | None, typer.Option(metavar="M", help="Geoid height, for files with heights above the geoid.")
    ] = None,
    tolerance: Annotated[
        float | None, typer.Option(metavar="S", help="Fixes closer in time are one epoch's; default 0.005.")
    ] = None,
    no_report: NoReport = False,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
) -> None:
    """One solution out of the position fixes of several receivers on one vehicle."""
    from starwise.estimators.fuse import FuseConfig
    from starwise.studies.fusing import fuse_files, fuse_text

    named: dict[str, Any] = {
        "method": method,
        "dynamics": dynamics,
        "sigma_horizontal_m": sigma,
        "sigma_vertical_m": None if sigma is None else 2.0 * sigma,
        "tolerance_s": tolerance,
    }
    config = FuseConfig.from_dict({key: value for key, value in named.items() if value is not None})
    with Progress(quiet or as_json, quiet) as progress:
        solution = fuse_files(files, config, output, geoid, progress, not no_report)
    if as_json:
        where = {} if output is None else {"directory": str(output)}
        show_json({**solution.provenance, **where})
    elif not quiet:
        show(fuse_text(solution.provenance, output))
