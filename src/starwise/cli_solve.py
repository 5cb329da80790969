"""Command ``solve``. Options in, text out; nothing heavy imported early."""

import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from starwise.errors import StarwiseError
from starwise.terminal import Json, NoReport, Progress, read_settings, show, show_json

_FILTER, _CHOICE, _FILES = "Method", "Satellites and epochs", "Further files"


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command()(solve)


def solve(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Directory for the results.")],
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="OBS NAV",
            help="RINEX observations of one receiver and navigation files, in any order, however compressed; SP3 and "
            "CLK files may stand here, too.",
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            metavar="METHOD",
            help="lsq, ekf, s3ekf (default) or federated: a filter per constellation, fused. With --imu: loose "
            "(default) or tight.",
            rich_help_panel=_FILTER,
        ),
    ] = None,
    share: Annotated[
        str | None,
        typer.Option(
            metavar="G=..,R=..",
            help="Shares of the federated filter, scaled to sum 1; default auto.",
            rich_help_panel=_FILTER,
        ),
    ] = None,
    imu: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Inertial readings: adds attitude and sensor biases.", rich_help_panel=_FILES
        ),
    ] = None,
    imu_config: Annotated[
        str | None,
        typer.Option(
            "--imu-config",
            metavar="TOML",
            help="What the file of --imu holds, and \\[inertial]; or the name of a layout.",
            rich_help_panel=_FILES,
        ),
    ] = None,
    fixes: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="With --imu, in place of RINEX: fixes of another program (.pos, NMEA, CSV).",
            rich_help_panel=_FILES,
        ),
    ] = None,
    adaptation: Annotated[
        str | None,
        typer.Option(
            metavar="RULE",
            help="Adapt filters to their innovations by fading, fading_improved, strong_tracking, iae_q or "
            "sage_husa_q; with white errors also iae_r, sage_husa_r, huber, igg3. Default none.",
            rich_help_panel=_FILTER,
        ),
    ] = None,
    error_model: Annotated[
        str | None,
        typer.Option(
            metavar="MODEL",
            help="colored (default): range errors that last are states; or white.",
            rich_help_panel=_FILTER,
        ),
    ] = None,
    systems: Annotated[
        str | None,
        typer.Option(metavar="LETTERS", help="Satellite systems; default GRECJ.", rich_help_panel=_CHOICE),
    ] = None,
    mask: Annotated[
        float | None, typer.Option(metavar="DEG", help="Elevation mask; default 10.", rich_help_panel=_CHOICE)
    ] = None,
    dynamics: Annotated[
        str | None,
        typer.Option(
            metavar="HOW",
            help="static, pedestrian, vehicle or aircraft; default auto: static where the observations show rest "
            "throughout, else vehicle.",
            rich_help_panel=_FILTER,
        ),
    ] = None,
    ephemeris: Annotated[
        Path | None, typer.Option(metavar="SP3", help="Precise orbits.", rich_help_panel=_FILES)
    ] = None,
    clock: Annotated[
        Path | None, typer.Option(metavar="CLK", help="Precise clocks, with --ephemeris.", rich_help_panel=_FILES)
    ] = None,
    post: Annotated[
        bool | None,
        typer.Option(
            "--post/--no-post",
            help="Nearest broadcast ephemeris, also one sent after the epoch; default only what had been sent by then.",
            rich_help_panel=_CHOICE,
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="T",
            help="First epoch: 2024-03-30T12:00:00 (GPST; with Z, UTC) or week:tow.",
            rich_help_panel=_CHOICE,
        ),
    ] = None,
    end: Annotated[str | None, typer.Option(metavar="T", help="Last epoch.", rich_help_panel=_CHOICE)] = None,
    interval: Annotated[
        float | None,
        typer.Option(metavar="S", help="Only epochs on multiples of S seconds.", rich_help_panel=_CHOICE),
    ] = None,
    sessions: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help="Start anew after every such time, like 2h; for assess --pool.",
            rich_help_panel=_FILTER,
        ),
    ] = None,
    combination: Annotated[
        str | None,
        typer.Option(
            metavar="CODES",
            help="single: one frequency (default with white errors); uncombined: two beside each other (with "
            "colored); or ionosphere_free.",
            rich_help_panel=_FILTER,
        ),
    ] = None,
    exclude: Annotated[
        list[str] | None,
        typer.Option(metavar="SV", help="Satellite not to be used, like G05; repeatable.", rich_help_panel=_CHOICE),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(metavar="TOML", help="Configuration; options override it.", rich_help_panel=_FILTER),
    ] = None,
    rtklib_conf: Annotated[
        Path | None,
        typer.Option(
            "--rtklib-conf",
            metavar="CONF",
            help="Options of RTKLIB, as far as there are equivalents.",
            rich_help_panel=_FILTER,
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=..",
            help="Any key of the configuration, like process.model=singer.",
            rich_help_panel=_FILTER,
        ),
    ] = None,
    no_report: NoReport = False,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
) -> None:
    """Position and velocity per epoch out of RINEX observations and navigation files."""
    began = time.perf_counter()
    named = {
        "method": method,
        "share": share,
        "error_model": error_model,
        "adaptation": adaptation,
        "systems": systems,
        "mask_deg": mask,
        "dynamics": dynamics,
        "post": post,
        "start": start,
        "end": end,
        "interval_s": interval,
        "combination": combination,
        "exclude": exclude or None,
    }
    options = {key: value for key, value in named.items() if value is not None}
    options.update(read_settings(settings or []))
    from starwise import api
    from starwise.config import load_config
    from starwise.gnsstime import parse_duration

    if sessions is not None:
        options["session_s"] = parse_duration(sessions)
    notes: list[str] = []
    if rtklib_conf is not None:
        from starwise.io.rtklib_conf import options_of

        others = {"--config": config, "--imu": imu or imu_config or fixes}
        given = [*(files or []), *([ephemeris] if ephemeris else [])]
        options, notes = options_of(rtklib_conf, options, others, given)
    if imu is not None or imu_config is not None or fixes is not None:
        from starwise.cli_ins import solve_imu

        given = [*(files or []), *(path for path in (ephemeris, clock) if path is not None)]
        solve_imu(given, imu, imu_config, fixes, options, config, output, as_json, quiet, not no_report)
        return
    if not files:
        raise StarwiseError("no files to solve", wanted="RINEX observations and navigation files")

    chosen = load_config(config, options)
    with Progress(quiet or as_json, quiet) as progress:
        solution = api.solve(
            *files, ephemeris=ephemeris, clock=clock, config=chosen, output=output, progress=progress, notes=notes,
            report=not no_report,
        )  # fmt: skip
    if as_json:
        show_json({**solution.provenance, "directory": str(output)})
    elif not quiet:
        from starwise.report.text import solve_text

        show(solve_text(solution.provenance, output, time.perf_counter() - began))
    if not solution.has_position.any():
        # The files are written and their ledger says why; a script must still be able to tell.
        from starwise.report.text import unsolved_text

        sys.stderr.write(f"starwise: {unsolved_text(solution.provenance['summary'])}\n")
        raise typer.Exit(1)
