"""Commands ``report`` and ``compare``. Options in, text out; nothing heavy imported early."""

from pathlib import Path
from typing import Annotated, Any

import typer

from starwise.errors import StarwiseError
from starwise.terminal import Json, show, show_json

Truth = Annotated[
    str | None,
    typer.Option("--truth", metavar="X,Y,Z|FILE", help="As for assess: ECEF metres, lat,lon,height, or a file."),
]
AntennaUp = Annotated[
    float, typer.Option("--antenna-up", metavar="M", help="Height of the antenna above the point that the truth is of.")
]


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    app.command()(report)
    app.command()(compare)


def report(
    source: Annotated[
        Path, typer.Argument(metavar="DIR|FILE.pos", help="Result of solve, fuse or demo, or a position file.")
    ],
    truth: Truth = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE.html", help="Default: report.html in DIR, or beside the file."),
    ] = None,
    antenna_up: AntennaUp = 0.0,
) -> None:
    """A page that opens in any browser, offline: track, errors, satellites, innovations, provenance."""
    from starwise.report.html import write_report

    written = write_report(source, truth, output, antenna_up_m=antenna_up)
    show(f"{written}  ({written.stat().st_size / 1e6:.1f} MB)")


def compare(
    solutions: Annotated[
        list[Path], typer.Argument(metavar="DIR|FILE.pos...", help="Two results or position files, or more.")
    ],
    truth: Truth = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE.html", help="Write a page that shows them over each other."),
    ] = None,
    antenna_up: AntennaUp = 0.0,
    as_json: Json = False,
) -> None:
    """Several solutions beside each other: a table, and a page with -o."""
    from starwise.studies.comparing import compare_files

    if len(solutions) < 2:
        raise StarwiseError("comparing takes two solutions or more", found=f"{len(solutions)}")
    compared = compare_files(solutions, truth, output, antenna_up_m=antenna_up)
    if as_json:
        show_json({item.name: item.stats for item in compared})
        return
    for line in _table([{"name": item.name, **item.stats} for item in compared], truth is not None):
        show(line)
    if output is not None:
        show(f"\n{output}  ({output.stat().st_size / 1e6:.1f} MB)")


_COLUMNS = (
    ("epochs_solved", "solved", 7, 0),
    ("epochs_flagged", "flagged", 8, 0),
    ("rms_2d_m", "RMS 2D", 9, 3),
    ("rms_3d_m", "RMS 3D", 9, 3),
    ("p95_3d_m", "95% 3D", 9, 3),
    ("sigma_3d_mean_m", "claimed", 9, 3),
    ("coverage_95", "in 95%", 7, 2),
)


def _table(rows: list[dict[str, Any]], known: bool) -> list[str]:
    """Table of at most 80 columns; lengths in metres. About a median nothing is said of the covariance."""
    width = 80 - sum(column[2] for column in _COLUMNS)
    lines = [f"{'':{width}}" + "".join(f"{label:>{size}}" for _, label, size, _ in _COLUMNS)]
    for row in rows:
        name = str(row["name"])
        name = name if len(name) < width else "..." + name[-(width - 4) :]
        if not known:
            row = {**row, "coverage_95": None}
        cells = ("-" if row.get(key) is None else f"{row[key]:.{digits}f}" for key, _, _, digits in _COLUMNS)
        pairs = zip(cells, _COLUMNS, strict=True)
        lines.append(f"{name:{width}}" + "".join(f"{cell:>{column[2]}}" for cell, column in pairs))
    lines.append("lengths in m; claimed: 1 sigma, 3D; in 95%: share inside the 95 % ellipsoid")
    if not known:
        lines[-1] = "lengths in m; no truth: about each solution's own median (scatter, not accuracy)"
    return lines
