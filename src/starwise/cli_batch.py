"""Command ``batch``. Options in, text out; nothing heavy imported early."""

import time
from pathlib import Path
from typing import Annotated

import typer

from starwise.errors import StarwiseError
from starwise.terminal import Json, Progress, read_settings, show, show_json

Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler", metavar="tcp://..|local", help="Workers of a Dask cluster; local: of one on this machine."
    ),
]
Workers = Annotated[int | None, typer.Option("--workers", metavar="N", min=1, help="Processes; default: all cores.")]


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command()(batch)


def batch(
    manifest: Annotated[
        Path, typer.Argument(metavar="MANIFEST|DIR", help="List of units (.toml, .jsonl), or a folder to be searched.")
    ],
    output: Annotated[
        str | None, typer.Option("--output", "-o", metavar="DIR|URL", help="Where results and the summary go.")
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    truth_table: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="True positions: unit,x_m,y_m,z_m or unit,truth; unit: how names begin."),
    ] = None,
    config: Annotated[Path | None, typer.Option(metavar="FILE.toml", help="Configuration of all units.")] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Any key of it, for all units; overrides the manifest."),
    ] = None,
    no_ledger: Annotated[
        bool, typer.Option("--no-ledger", help="Keep no ledger.parquet: most of the bytes of a result.")
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the units as a manifest, solve nothing.")] = False,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
) -> None:
    """Many station-days or drives, over all cores or a cluster; started again, it goes on where it was.

    Ends with 1 if a unit failed or has no position, or none was found; with 2 if the list of units is bad.
    """
    from starwise.batch import read_manifest, run_batch, scan
    from starwise.batch.manifest import as_toml, with_truths, without_ledgers
    from starwise.config import load_config
    from starwise.spread.cluster import check_scheduler

    began = time.perf_counter()
    over = read_settings(settings or [])
    if output is None and not dry_run:
        raise StarwiseError("no output", wanted="--output DIR or URL, or --dry-run")
    check_scheduler(scheduler)
    with Progress(quiet or as_json, quiet) as progress:
        if manifest.is_dir():
            units = scan(manifest, load_config(config, over), progress)
        else:
            units = read_manifest(manifest, load_config(config), over)
        if truth_table is not None:
            units = with_truths(units, truth_table)
        if no_ledger:
            units = without_ledgers(units)
        if dry_run:
            show(as_toml(units))
            return
        assert output is not None
        table = run_batch(units, output, workers=workers, scheduler=scheduler, progress=progress)
    from starwise.batch.run import counts
    from starwise.batch.text import batch_text

    n = counts(table)
    if as_json:
        show_json({"directory": output, "units": n, "notes": list(units.notes), "summary": table.to_dicts()})
    elif not quiet:
        show("\n".join([batch_text(table, output, time.perf_counter() - began), *units.notes]))
    if n["failed"] or n["no_solution"] or not n["ok"]:
        raise typer.Exit(1)
