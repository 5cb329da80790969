"""The command line: options in, text out. No algorithm here, and nothing heavy imported before it is needed."""

import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from starwise import cli_assess, cli_batch, cli_calibrate, cli_export, cli_fuse, cli_report, cli_sim, cli_solve
from starwise.cli_examples import epilog
from starwise.errors import StarwiseError
from starwise.options import without_pydantic
from starwise.terminal import Json, NoReport
from starwise.terminal import Progress as _Progress
from starwise.terminal import show as _print
from starwise.terminal import show_json as _print_json

app = typer.Typer(
    name="starwise",
    help="Satellite navigation: raw observations in, a trajectory out, with its covariance and the means to check it.",
    epilog="Begin with: starwise demo\n\nThen with files of your own: starwise solve rover.obs brdc.nav -o out\n\n"
    "Help on a command, with examples: starwise solve --help",
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
    without_pydantic()
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
        context = getattr(error, "ctx", None)
        command_path = "starwise" if context is None else context.command_path
        raise StarwiseError(f"{wording()} (see {command_path} --help)") from None
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


cli_solve.register(app)
cli_assess.register(app)
cli_batch.register(app)
cli_export.register(app)


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
    no_report: NoReport = False,
    as_json: Json = False,
) -> None:
    """The main job on a simulated drive in a town, judged against its truth."""
    from starwise.demo import run_demo

    with _Progress(as_json) as progress:
        outcome = run_demo(output, progress, not no_report)
    if as_json:
        _print_json(outcome.record)
    else:
        _print(outcome.text)


@app.command()
def warmup() -> None:
    """Compile all kernels now; else the first solution does, for over a minute."""
    from starwise.kernels._jit import cache_root
    from starwise.warmup import compile_kernels

    began = time.perf_counter()
    failed = compile_kernels()
    if failed:
        raise StarwiseError("kernels not compiled ahead, but at their first use", found="; ".join(failed))
    _print(f"kernels compiled in {time.perf_counter() - began:.0f} s, kept in {cache_root()}")


cli_fuse.register(app)
cli_report.register(app)
cli_sim.register(app)
cli_calibrate.register(app)

for _command in app.registered_commands:
    if _command.epilog is None and _command.callback is not None:
        _command.epilog = epilog(_command.name or _command.callback.__name__)
