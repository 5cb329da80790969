"""Command ``export``: results for maps and other programs. Options in, text out; nothing heavy imported early."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from starwise.errors import StarwiseError
from starwise.terminal import Json, show, show_json


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command()(export)


def export(
    solutions: Annotated[
        list[Path],
        typer.Argument(metavar="DIR|FILE...", help="Results of starwise, or solutions of other programs, like .pos."),
    ],
    to: Annotated[
        str | None,
        typer.Option("--to", metavar="FORMAT", help="geojson, kml, gpx, csv, nmea or pos; default by the name of -o."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE|DIR|-",
            help="A file, a directory, or - for the standard output; default a new file here, named by the first "
            "input. geojson, kml and gpx take several inputs in one file.",
        ),
    ] = None,
    geoid: Annotated[
        float | None,
        typer.Option(metavar="M", help="Geoid height above the ellipsoid: kml, gpx and nmea expect mean sea level."),
    ] = None,
    interval: Annotated[float | None, typer.Option(metavar="S", help="Only epochs on multiples of S seconds.")] = None,
    suspect: Annotated[
        bool, typer.Option("--suspect/--no-suspect", help="Suspect epochs, marked as such; or leave them out.")
    ] = True,
    as_json: Json = False,
) -> None:
    """Results for maps and other programs: GeoJSON, KML, GPX, CSV, NMEA, RTKLIB .pos."""
    from starwise import api_export

    chosen = api_export.format_of(to, output)
    if output == Path("-"):
        if as_json:
            raise StarwiseError("--json", found="with -o -", wanted="one of them: both print to the standard output")
        data, notes = api_export.rendered(*solutions, to=chosen, geoid_m=geoid, interval_s=interval, suspect=suspect)
        sys.stdout.buffer.write(data)
        sys.stdout.flush()
        for note in notes:
            sys.stderr.write(f"starwise: {note}\n")
        return
    target = output if output is not None else api_export.fresh_name(solutions[0], chosen)
    done = api_export.export(*solutions, to=chosen, output=target, geoid_m=geoid, interval_s=interval, suspect=suspect)
    if as_json:
        files = [str(path) for path in done.files]
        show_json({"format": chosen, "files": files, "epochs": done.epochs, "notes": list(done.notes)})
        return
    names = ", ".join(str(path) for path in done.files)
    show("\n".join([f"{done.epochs} epochs written to {names}", *(f"note: {note}" for note in done.notes)]))
