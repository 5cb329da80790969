"""Command ``calibrate``: parameters of the coloured error model out of measurements with known positions."""

from pathlib import Path
from typing import Annotated, Any

import typer

from starwise.terminal import Json, Progress, show, show_json


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command()(calibrate)


def calibrate(
    sets: Annotated[
        Path,
        typer.Argument(
            metavar="SETS.toml", help="[\\[set]] tables: name, observations, navigation, truth; see docs/formats.md."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE.toml", help="Parameters found, for solve --config."),
    ] = None,
    rounds: Annotated[
        int, typer.Option(metavar="N", min=0, help="Times that every parameter is tried; 0: judge those there are.")
    ] = 2,
    folds: Annotated[
        bool, typer.Option("--folds/--no-folds", help="Also leave out each station in turn, and judge it.")
    ] = True,
    as_json: Json = False,
) -> None:
    """Sizes and times of range errors by maximum likelihood, with cross-validation over stations.

    The score is the mean logarithm of the density that the filter gave to the true position (docs/error-model.md).
    """
    from starwise.studies.calibration import calibrate as run

    with Progress(as_json) as progress:
        result = run(sets, rounds=rounds, folds=folds, output=output, progress=progress)
    if as_json:
        show_json(result)
    else:
        show(_text(result, output))


_HEAD = f"{'set':<24}{'dynamics':<12}{'n':>3} {'50 %':>5} {'68 %':>5} {'95 %':>5} {'NEES':>5} {'sigma':>6} {'RMS':>6}"


def _table(rows: list[dict[str, Any]], total: dict[str, Any]) -> list[str]:
    lines = [_HEAD]
    for row in rows:
        lines.append(
            f"{row['name'][:23]:<24}{row['dynamics']:<12}{row['sessions']:>3} {100 * row['coverage_50']:5.0f} "
            f"{100 * row['coverage_68']:5.0f} {100 * row['coverage_95']:5.0f} {row['nees_mean']:5.2f} "
            f"{row['sigma_3d_mean_m']:6.2f} {row['rms_3d_m']:6.2f}"
        )
    lines.append(
        f"{'pooled':<24}{'':<12}{total['sessions']:>3} {100 * total['coverage_50']:5.0f} "
        f"{100 * total['coverage_68']:5.0f} {100 * total['coverage_95']:5.0f} {total['nees_mean']:5.2f} "
        f"{total['sigma_3d_mean_m']:6.2f} {total['rms_3d_m']:6.2f}"
    )
    return lines


def _text(result: dict[str, Any], output: Path | None) -> str:
    lines = []
    for name, (old, new) in result["changed"].items():
        lines.append(f"  {name:<24}{old:>10g} -> {new:g}")
    before, after = result["score_before"], result["score_after"]
    lines = [
        f"score {before:.3f} -> {after:.3f}, parameters that changed:" if lines else f"score {after:.3f}, as before",
        *lines,
        "",
        "Share of epochs inside the claimed ellipsoids; NEES per degree of freedom; m:",
        *_table(result["sets"], result["pooled"]),
    ]
    if "cross_validation" in result:
        lines += ["", "Each station with the parameters that the others give:"]
        lines += _table(result["cross_validation"], result["cross_validation_pooled"])
    if output is not None:
        lines += ["", f"Parameters in {output}"]
    return "\n".join(lines)
