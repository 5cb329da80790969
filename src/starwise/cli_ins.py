"""The inertial side of ``solve``: ``--imu``, ``--imu-config``, ``--fixes``. Options in, text out."""

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from starwise.errors import StarwiseError
from starwise.terminal import Progress, show, show_json


def solve_imu(
    files: list[Path],
    imu: Path | None,
    imu_config: str | None,
    fixes: Path | None,
    options: Mapping[str, Any],
    config: Path | None,
    output: Path,
    as_json: bool,
    quiet: bool,
    report: bool = True,
) -> None:
    """Inertial navigation with satellites or fixes; arguments as the options of ``solve``.

    Raises
    ------
    StarwiseError
        Files or options that cannot be used.
    """
    began = time.perf_counter()
    if imu is None:
        raise StarwiseError("--imu-config and --fixes want --imu FILE")
    if imu_config is None:
        raise StarwiseError(
            "--imu wants --imu-config", wanted="a TOML file that describes the readings, or the name of a layout"
        )
    from starwise.api_inertial import solve_inertial

    with Progress(quiet or as_json, quiet) as progress:
        solution = solve_inertial(
            *files, imu=imu, imu_config=imu_config, fixes=fixes, config=config, options=options, output=output,
            progress=progress, report=report,
        )  # fmt: skip
    if as_json:
        show_json({**solution.provenance, "directory": str(output)})
    elif not quiet:
        from starwise.report.inertial import inertial_text

        show(inertial_text(solution, output, time.perf_counter() - began))
    if not solution.has_position.any():
        sys.stderr.write("starwise: no epoch could be solved\n")
        raise typer.Exit(1)
