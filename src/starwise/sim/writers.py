"""Files of a simulation: RINEX, truth, inertial data and the scenario as it was run."""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from starwise.errors import StarwiseError
from starwise.sim.rinex_writer import write_nav, write_obs
from starwise.sim.run import Simulation
from starwise.sim.truth import SimTruth
from starwise.types import Inertial


def write_truth(truth: SimTruth, path: str | Path) -> None:
    """Write the truth of every epoch as Parquet or CSV, by the suffix.

    Raises
    ------
    StarwiseError
        Another suffix, or the file cannot be written.
    """
    table = truth.epochs_to_polars()
    file = Path(path)
    try:
        if file.suffix == ".parquet":
            table.write_parquet(file)
        elif file.suffix == ".csv":
            table.write_csv(file)
        else:
            raise StarwiseError("truth is written as Parquet or CSV", found=file.suffix, wanted=".parquet or .csv")
    except OSError as error:
        raise StarwiseError(f"cannot be written ({error})", file=file) from None


def write_imu(imu: Inertial, path: str | Path) -> None:
    """Write inertial readings as CSV; the names of the columns say whether they are rates or increments.

    Raises
    ------
    StarwiseError
        The file cannot be written.
    """
    import polars as pl

    names = ("dtheta_{}_rad", "dv_{}_mps") if imu.increments else ("gyro_{}_radps", "accel_{}_mps2")
    columns: dict[str, NDArray[np.generic]] = {"t_gpst_ns": imu.t_ns, "dt_s": imu.dt_s}
    for name, values in zip(names, (imu.gyro, imu.accel), strict=True):
        columns |= {name.format(axis): values[:, k] for k, axis in enumerate("xyz")}
    try:
        pl.DataFrame(columns).write_csv(Path(path))
    except OSError as error:
        raise StarwiseError(f"cannot be written ({error})", file=path) from None


def write_files(simulation: Simulation, folder: str | Path) -> dict[str, Path]:
    """Write what the scenario's ``[output]`` asks for into a folder, which is made if it is not there.

    Returns
    -------
    dict
        Paths by what they are: ``observations``, ``navigation``, ``truth``, ``terms``, ``imu``, ``scenario``.

    Raises
    ------
    StarwiseError
        The folder or a file cannot be written.
    """
    output = simulation.scenario.output
    base = Path(folder)
    try:
        base.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StarwiseError(f"folder cannot be made ({error.strerror})", file=base) from None
    stem = simulation.scenario.name
    paths: dict[str, Path] = {}
    if output.rinex:
        paths["observations"], paths["navigation"] = base / f"{stem}_MO.rnx", base / f"{stem}_MN.rnx"
        write_obs(simulation.observations, paths["observations"])
        write_nav(simulation.records, paths["navigation"])
    paths["truth"] = base / f"{stem}_truth.{output.truth}"
    write_truth(simulation.truth, paths["truth"])
    paths["terms"] = base / f"{stem}_terms.parquet"
    paths["scenario"] = base / f"{stem}_scenario.json"
    effective = {**simulation.scenario.to_dict(), "seed": simulation.seed, "run": simulation.run}
    try:
        simulation.truth.rows_to_polars(simulation.observations.sig).write_parquet(paths["terms"])
        paths["scenario"].write_text(json.dumps(effective, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise StarwiseError(f"cannot be written ({error})", file=base) from None
    if output.imu and simulation.imu is not None:
        paths["imu"] = base / f"{stem}_imu.csv"
        write_imu(simulation.imu.measured, paths["imu"])
    return paths
