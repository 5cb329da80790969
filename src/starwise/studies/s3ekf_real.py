"""EKF and S3EKF on real measurements: the same trajectories, and the time of an epoch."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from starwise.config import RunConfig
from starwise.constants import EPOCH_OK
from starwise.estimators.filter import run_filter
from starwise.models.pseudorange import Prepared, prepare

Say = Callable[[float], None]


class DataSet(NamedTuple):
    """Files of one station and time, relative to the folder of data."""

    name: str
    obs: str
    nav: str


SETS: Final = (
    DataSet(
        "KIRU 2024-03-30, 30 s",
        "static/kiru_2024090/KIRU00SWE_R_20240900000_01D_30S_MO.rnx",
        "static/kiru_2024090/KIR000SWE_R_20240900000_01D_MN.rnx",
    ),
    DataSet(
        "TLSE 2024-01-01, 1 s",
        "static/tlse_2024001/TLSE00FRA_R_20240011200_15M_01S_MO.crx.gz",
        "static/tlse_2024001/BRDC00IGS_R_20240010000_01D_MN.rnx.gz",
    ),
    DataSet(
        "TLSE 2022-01-01, 30 s",
        "static/tlse_2022001/TLSE00FRA_R_20220010000_01H_30S_MO.rnx.gz",
        "static/tlse_2022001/BRDC00IGS_R_20220010000_01D_MN.zip",
    ),
)
SYSTEMS: Final = ("GC", "GREC")
DATA: Final = Path("..") / "shared" / "data"
"""Where the data are looked for if nobody says otherwise."""


def real_data(folder: Path | None = None, say: Say = lambda _: None, repeats: int = 7) -> list[dict[str, Any]]:
    """Both forms on every data set that is there.

    Parameters
    ----------
    folder : Path, optional
        Folder with the data; default `DATA`.
    say : callable
        Fraction done.
    repeats : int
        Times that every run is timed; the fastest counts.

    Returns
    -------
    list of dict
        ``data``, ``systems``, ``epochs``, ``n_min``, ``n_mean``, ``n_max`` (satellites used per epoch),
        ``max_difference_m`` between the two forms, ``same_decisions`` (status and number of satellites agree at every
        epoch), ``ekf_us`` and ``s3ekf_us`` (whole filter, per epoch), ``ratio``. A data set that is not there has
        ``data`` and ``absent`` only.

    Raises
    ------
    StarwiseError
        A file cannot be read.
    """
    base = DATA if folder is None else folder
    table: list[dict[str, Any]] = []
    for k, data in enumerate(SETS):
        obs, nav = base / data.obs, base / data.nav
        if not (obs.is_file() and nav.is_file()):
            table.append({"data": data.name, "absent": f"no {obs if not obs.is_file() else nav}"})
        else:
            table += _compare(data.name, obs, nav, repeats)
        say((k + 1) / len(SETS))
    return table


def _compare(name: str, obs: Path, nav: Path, repeats: int) -> list[dict[str, Any]]:
    from starwise.io.rinex_nav import read_nav
    from starwise.io.rinex_obs import read_obs
    from starwise.physics.broadcast import BroadcastEphemeris

    observations, records = read_obs(obs), read_nav(nav)
    ephemeris = BroadcastEphemeris(records)
    table = []
    for systems in SYSTEMS:
        config = RunConfig(systems=systems, error_model="white", dynamics="aircraft", mask_deg=5.0)
        prepared = prepare(observations, ephemeris, records.ionosphere, config)
        table.append({"data": name, "systems": systems, **_both(prepared, config, repeats)})
    return table


def _both(prepared: Prepared, config: RunConfig, repeats: int) -> dict[str, Any]:
    configs = {form: config.with_options({"method": form}) for form in ("ekf", "s3ekf")}
    solved = {form: run_filter(prepared, c)[0] for form, c in configs.items()}
    fastest = dict.fromkeys(configs, np.inf)
    for _ in range(repeats):
        for form, c in configs.items():
            began = time.perf_counter()
            run_filter(prepared, c)
            fastest[form] = min(fastest[form], time.perf_counter() - began)
    a, b = solved["ekf"], solved["s3ekf"]
    n = len(a.status)
    used = b.n_used[b.status == EPOCH_OK]
    return {
        "epochs": n,
        "n_min": int(used.min()),
        "n_mean": float(used.mean()),
        "n_max": int(used.max()),
        "max_difference_m": float(np.nanmax(np.linalg.norm(a.pos - b.pos, axis=1))),
        "same_decisions": bool((a.status == b.status).all() and (a.n_used == b.n_used).all()),
        "ekf_us": fastest["ekf"] / n * 1e6,
        "s3ekf_us": fastest["s3ekf"] / n * 1e6,
        "ratio": fastest["s3ekf"] / fastest["ekf"],
    }
