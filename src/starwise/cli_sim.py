"""Commands that simulate: ``simulate`` and ``reproduce``. Options in, text out; nothing heavy imported early."""

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from starwise.errors import StarwiseError
from starwise.terminal import Json, NoReport, Progress, show, show_json

Output = Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Directory for the results.")]
Runs = Annotated[int, typer.Option("--runs", metavar="N", min=1, help="Monte Carlo runs; they are resumed.")]
Seed = Annotated[int | None, typer.Option("--seed", metavar="S", help="In place of the scenario's.")]
PAPERS = ("s3ekf", "rdss_sins", "adaptive_federated", "stability")
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="tcp://..|local",
        help="Runs by workers of a Dask cluster; local: of one on this machine.",
    ),
]
Workers = Annotated[int | None, typer.Option("--workers", metavar="N", min=1, help="Processes; default: all cores.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    app.command()(simulate)
    app.command()(reproduce)


def simulate(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO",
            help="A scenario file (TOML), or one of the package: urban-drive, s3ekf-1-static, s3ekf-2-steps, "
            "s3ekf-3-turn, s3ekf-4-climb-dive.",
        ),
    ],
    output: Output,
    runs: Runs = 1,
    seed: Seed = None,
    method: Annotated[
        str, typer.Option(metavar="lsq|ekf|s3ekf|all", help="With --runs: estimators whose errors are collected.")
    ] = "s3ekf",
    workers: Workers = None,
    scheduler: Scheduler = None,
    no_report: NoReport = False,
    as_json: Json = False,
) -> None:
    """RINEX files, inertial data and the truth out of a scenario.

    With --runs N also montecarlo.parquet: every run solved, a row per run and method with its errors. The files are
    those of run 0.
    """
    from starwise.spread.cluster import check_scheduler
    from starwise.studies.simulating import simulate_files

    check_scheduler(scheduler)
    methods = ("lsq", "ekf", "s3ekf") if method == "all" else (method,)
    began = time.perf_counter()
    with Progress(as_json) as progress:
        record = simulate_files(
            scenario,
            output,
            runs=runs,
            seed=seed,
            methods=methods,
            workers=workers,
            progress=progress,
            scheduler=scheduler,
            report=not no_report,
        )
    if as_json:
        show_json(record)
    else:
        show(_simulate_text(record, output, time.perf_counter() - began))


def _simulate_text(record: dict[str, Any], output: Path, seconds: float) -> str:
    lines = [
        f"{record['scenario']}: {record['epochs']} epochs of {record['satellites_min']}-{record['satellites_max']} "
        f"satellites, seed {record['seed']}, {seconds:.1f} s"
    ]
    lines += [f"  {kind:<13} {name}" for kind, name in record["files"].items()]
    for row in record.get("montecarlo", []):
        lines.append(
            f"  {row['method']:<6} {row['runs']} runs, 2RMS over all epochs:"
            f" horizontal {row['horizontal_2rms_m']:.3f} m,\n         vertical {row['vertical_2rms_m']:.3f} m,"
            f" velocity {row['velocity_2rms_mps']:.3f} m/s"
        )
    return "\n".join([*lines, f"  in {output}"])


def reproduce(
    paper: Annotated[
        str, typer.Argument(metavar="PAPER", help="One of: s3ekf, rdss_sins, adaptive_federated, stability.")
    ],
    output: Output = Path("starwise-reproduce"),
    runs: Runs = 100,
    seed: Seed = None,
    data: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of real measurements; default ../shared/data where it exists."),
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    no_report: NoReport = False,
    as_json: Json = False,
) -> None:
    """Results of a paper, beside its own figures: tables, figures and a report."""
    if paper not in PAPERS:
        raise StarwiseError("no such paper", found=paper, wanted=" | ".join(PAPERS))
    if data is not None and not data.is_dir():
        raise StarwiseError("no such folder", file=data)
    from starwise.spread.cluster import check_scheduler

    check_scheduler(scheduler)
    if paper == "rdss_sins":
        _rdss_sins(output, runs, seed, workers, scheduler, as_json)
    elif paper == "adaptive_federated":
        _adaptive_federated(output, runs, seed, workers, scheduler, as_json)
    elif paper == "stability":
        _stability(output, runs, seed, workers, scheduler, as_json)
    else:
        _s3ekf(output, runs, seed, data, workers, scheduler, as_json)
    if not no_report:
        from starwise.report.html import write_study

        page = write_study(output, paper)
        if not as_json:
            show(f"In a browser:     {page}")


def _s3ekf(
    output: Path,
    runs: int,
    seed: int | None,
    data: Path | None,
    workers: int | None,
    scheduler: str | None,
    as_json: bool,
) -> None:
    """Sequential square-root-free filter (S3EKF)."""
    from starwise.studies.s3ekf import reproduce_s3ekf

    with Progress(as_json) as progress:
        result = reproduce_s3ekf(output, runs, seed, data, workers, progress, scheduler)
    if as_json:
        show_json(result)
        return
    from starwise.studies.s3ekf_report import short_text

    show(short_text(result) + f"\nThe whole report: {output / 'report.md'}")


def _adaptive_federated(
    output: Path, runs: int, seed: int | None, workers: int | None, scheduler: str | None, as_json: bool
) -> None:
    """Adaptive federated filter (Sun, Wu, Zhao, Liu 2009)."""
    from starwise.studies.adaptive_federated import reproduce_adaptive_federated
    from starwise.studies.adaptive_federated_report import short_text

    with Progress(as_json) as progress:
        result = reproduce_adaptive_federated(output, runs, seed, workers, progress, scheduler)
    if as_json:
        show_json(result)
    else:
        show(short_text(result) + f"\nThe whole report: {output / 'report.md'}")


def _stability(
    output: Path, runs: int, seed: int | None, workers: int | None, scheduler: str | None, as_json: bool
) -> None:
    """Controllability, observability and stability of a filter (Gao, Tan 2007)."""
    from starwise.studies.stability import reproduce_stability
    from starwise.studies.stability_report import short_text

    with Progress(as_json) as progress:
        result = reproduce_stability(output, runs, seed, workers, progress, scheduler)
    if as_json:
        show_json(result)
    else:
        show(short_text(result) + f"\nThe whole report: {output / 'report.md'}")


def _rdss_sins(
    output: Path, runs: int, seed: int | None, workers: int | None, scheduler: str | None, as_json: bool
) -> None:
    """Optimal prediction of late fixes (Lin, Meng, He)."""
    from starwise.studies.rdss_sins import reproduce_rdss_sins
    from starwise.studies.rdss_sins_report import short_text

    with Progress(as_json) as progress:
        result = reproduce_rdss_sins(output, runs, seed, workers, progress, scheduler)
    if as_json:
        show_json(result)
    else:
        show(short_text(result) + f"\nThe whole report: {output / 'report.md'}")
