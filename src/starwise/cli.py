"""The command line: options in, text out. No algorithm here, and nothing heavy imported before it is needed."""

import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from starwise import cli_calibrate, cli_fuse, cli_sim
from starwise.errors import StarwiseError
from starwise.terminal import Json
from starwise.terminal import Progress as _Progress
from starwise.terminal import show as _print
from starwise.terminal import show_json as _print_json

app = typer.Typer(
    name="starwise",
    help="Satellite navigation: raw observations in, a trajectory out, with its covariance and the means to check it.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def run(arguments: list[str]) -> int:
    """Run the command line with its arguments; returns the exit code.

    Raises
    ------
    StarwiseError
        Bad input; `starwise.__main__` prints it.
    """
    command = typer.main.get_command(app)
    try:
        code = command.main(args=arguments or ["--help"], prog_name="starwise", standalone_mode=False)
    except typer.Exit as leave:
        return int(leave.exit_code)
    except typer.Abort:
        raise KeyboardInterrupt from None
    except Exception as error:
        # Usage errors are of a class that typer keeps to itself.
        wording = getattr(error, "format_message", None)
        if wording is None:
            raise
        raise StarwiseError(f"{wording()} (see starwise --help)") from None
    return int(code) if isinstance(code, int) else 0


@app.callback(invoke_without_command=True)
def _main(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", "-V", help="Print the version.")] = False,
) -> None:
    if version:
        from starwise import __version__

        _print(f"starwise {__version__}")
        raise typer.Exit


@app.command()
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
            metavar="lsq|ekf|s3ekf|federated",
            help="Estimator; default s3ekf; federated: a filter per constellation, fused. With --imu: loose (default) "
            "or tight.",
        ),
    ] = None,
    share: Annotated[
        str | None,
        typer.Option(metavar="auto|G=..,R=..", help="Shares of the federated filter, scaled to sum 1; default auto."),
    ] = None,
    imu: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Inertial readings: adds attitude and sensor biases.")
    ] = None,
    imu_config: Annotated[
        str | None,
        typer.Option("--imu-config", metavar="FILE.toml|LAYOUT", help="What the file of --imu holds; \\[inertial]."),
    ] = None,
    fixes: Annotated[
        Path | None, typer.Option(metavar="FILE.pos", help="With --imu, in place of RINEX: fixes from elsewhere.")
    ] = None,
    error_model: Annotated[
        str | None,
        typer.Option(metavar="colored|white", help="Range errors that last, as states, or white; default colored."),
    ] = None,
    systems: Annotated[str | None, typer.Option(metavar="LETTERS", help="Satellite systems; default GRECJ.")] = None,
    mask: Annotated[float | None, typer.Option(metavar="DEG", help="Elevation mask; default 10.")] = None,
    dynamics: Annotated[
        str | None,
        typer.Option(
            metavar="static|pedestrian|vehicle|aircraft",
            help="How the user moves; default auto: static where the observations show rest throughout, else vehicle.",
        ),
    ] = None,
    ephemeris: Annotated[Path | None, typer.Option(metavar="SP3", help="Precise orbits.")] = None,
    clock: Annotated[Path | None, typer.Option(metavar="CLK", help="Precise clocks, with --ephemeris.")] = None,
    post: Annotated[
        bool | None,
        typer.Option(
            "--post/--no-post",
            help="Nearest broadcast ephemeris, also one sent after the epoch; default only what had been sent by then.",
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(metavar="T", help="First epoch: 2024-03-30T12:00:00 (GPST; with Z, UTC) or week:tow."),
    ] = None,
    end: Annotated[str | None, typer.Option(metavar="T", help="Last epoch.")] = None,
    interval: Annotated[float | None, typer.Option(metavar="S", help="Only epochs on multiples of S seconds.")] = None,
    sessions: Annotated[
        str | None,
        typer.Option(metavar="LENGTH", help="Start anew after every such time, like 2h; for assess --pool."),
    ] = None,
    combination: Annotated[
        str | None,
        typer.Option(
            metavar="single|uncombined|ionosphere_free",
            help="One frequency or two; default two beside each other (colored), one (white).",
        ),
    ] = None,
    exclude: Annotated[
        list[str] | None, typer.Option(metavar="SV", help="Satellite not to be used, like G05; repeatable.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Configuration; options override it.")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Any key of the configuration, like process.model=singer."),
    ] = None,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
) -> None:
    """Position and velocity per epoch out of RINEX observations and navigation files."""
    began = time.perf_counter()
    named = {
        "method": method,
        "share": share,
        "error_model": error_model,
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
    options.update(_settings(settings or []))
    from starwise import api
    from starwise.config import load_config
    from starwise.gnsstime import parse_duration

    if sessions is not None:
        options["session_s"] = parse_duration(sessions)
    if imu is not None or imu_config is not None or fixes is not None:
        from starwise.cli_ins import solve_imu

        given = [*(files or []), *(path for path in (ephemeris, clock) if path is not None)]
        solve_imu(given, imu, imu_config, fixes, options, config, output, as_json, quiet)
        return
    if not files:
        raise StarwiseError("no files to solve", wanted="RINEX observations and navigation files")

    chosen = load_config(config, options)
    with _Progress(quiet or as_json, quiet) as progress:
        solution = api.solve(*files, ephemeris=ephemeris, clock=clock, config=chosen, output=output, progress=progress)
    if as_json:
        _print_json({**solution.provenance, "directory": str(output)})
    elif not quiet:
        from starwise.report.text import solve_text

        _print(solve_text(solution.provenance, output, time.perf_counter() - began))
    if not solution.has_position.any():
        # The files are written and their ledger says why; a script must still be able to tell.
        sys.stderr.write("starwise: no epoch could be solved; the ledger says why\n")
        raise typer.Exit(1)


def _settings(pairs: list[str]) -> dict[str, Any]:
    """Values of ``--set KEY=VALUE``: TOML values, or plain text where that is no TOML."""
    import tomllib

    options: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.strip():
            raise StarwiseError("--set", found=pair, wanted="KEY=VALUE")
        try:
            options[key.strip()] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            options[key.strip()] = text.strip()
    return options


@app.command()
def assess(
    solutions: Annotated[
        list[str],
        typer.Argument(
            metavar="DIR|FILE.pos[=TRUTH]",
            help="Results of solve, or RTKLIB position files of any format; with a truth of their own after =.",
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
            _print_json(record)
        else:
            _print(pool_text(record))
        return
    if sessions is not None:
        raise StarwiseError("--sessions", found="without --pool", wanted="--pool, or none")
    reports = {path: api.assess(path, own, **how) for path, own in runs}
    if as_json:
        _print_json(next(iter(reports.values())) if len(solutions) == 1 else reports)
        return
    from starwise.report.text import assess_text

    _print("\n\n".join(assess_text(name, report) for name, report in reports.items()))


def _run_and_truth(text: str, truth: str | None) -> tuple[str, str | None]:
    """``DIR=TRUTH`` apart; a path that is there as it stands, equals signs and all, has the truth of all."""
    path, equals, own = text.partition("=")
    if not equals or Path(text).exists():
        return str(Path(text)), truth
    if not own:
        raise StarwiseError("no truth after =", found=text, wanted="DIR=TRUTH")
    return str(Path(path)), own


@app.command()
def info(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="RINEX, SP3, CLK, .pos files or results.")],
    as_json: Json = False,
) -> None:
    """What is in a file, in one screen."""
    from starwise import api
    from starwise.report.text import info_text

    described: dict[str, Any] = {}
    failed = 0
    for path in files:
        try:
            described[str(path)] = api.info(path)
        except StarwiseError as error:
            # One bad file must not hide the others.
            failed += 1
            sys.stderr.write(f"starwise: error: {error}\n")
            continue
        if not as_json:
            _print(("\n" if len(described) > 1 else "") + info_text(str(path), described[str(path)]))
    if as_json and described:
        _print_json(next(iter(described.values())) if len(files) == 1 else described)
    if failed:
        raise typer.Exit(2)


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Directory for the results.")] = Path(
        "starwise-demo"
    ),
    as_json: Json = False,
) -> None:
    """The main job on a simulated drive in a town, judged against its truth."""
    from starwise.demo import run_demo

    with _Progress(as_json) as progress:
        outcome = run_demo(output, progress)
    if as_json:
        _print_json(outcome.record)
    else:
        _print(outcome.text)


@app.command()
def warmup() -> None:
    """Compile all kernels now; else the first solution does, for most of a minute."""
    from starwise.kernels._jit import cache_root
    from starwise.warmup import compile_kernels

    began = time.perf_counter()
    failed = compile_kernels()
    if failed:
        raise StarwiseError("kernels not compiled ahead, but at their first use", found="; ".join(failed))
    _print(f"kernels compiled in {time.perf_counter() - began:.0f} s, kept in {cache_root()}")


cli_fuse.register(app)
cli_sim.register(app)
cli_calibrate.register(app)
