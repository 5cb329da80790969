"""Monte Carlo of a scenario: how far off the estimators are, a row per run and method."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from starwise.config import RunConfig
from starwise.constants import EPOCH_NO_SOLUTION, EPOCH_RESET
from starwise.frames import geodetic_from_ecef, rotations_ne_enu
from starwise.kernels.spp import EpochOut
from starwise.sim.scenario import Scenario
from starwise.studies.montecarlo import Row
from starwise.studies.scene import Scene, Sky
from starwise.types import F8, BroadcastRecords

METHODS = ("lsq", "ekf", "s3ekf")


def navigation_of(scenario: Scenario) -> BroadcastRecords | None:
    """Records of the navigation files that a scenario's sky comes from; None if it comes from elsewhere.

    Raises
    ------
    StarwiseError
        A file cannot be read.
    """
    if scenario.sky.source != "nav":
        return None
    from starwise.io.rinex_nav import read_nav

    return read_nav(*(scenario.path_of(name) for name in scenario.sky.files))


def describe_scenario(scenario: Scenario) -> dict[str, Any]:
    """What the numbers of a scenario depend on: its values, and the contents of its files."""
    values = scenario.to_dict()
    values.pop("folder")
    names = list(scenario.sky.files) + ([scenario.vehicle.recorded] if scenario.vehicle.recorded else [])
    values["files"] = [
        hashlib.sha256(path.read_bytes()).hexdigest() if (path := scenario.path_of(name)).is_file() else ""
        for name in names
    ]
    return values


def natural_config(scenario: Scenario) -> RunConfig:
    """Configuration that fits a scenario: its systems, its vehicle, its mask, models for what it simulates."""
    letters = "".join(dict.fromkeys(name[0] for name in scenario.receiver.signals))
    return RunConfig(
        error_model="white",
        systems=letters,
        dynamics="aircraft" if scenario.vehicle.kind == "aircraft" else "vehicle",
        mask_deg=max(scenario.receiver.mask_deg, -5.0),
        ionosphere="none" if scenario.receiver.ionosphere.model == "none" else "broadcast",
        troposphere="none" if scenario.receiver.troposphere.model == "none" else "seasonal",
    )


def local_errors(pos_e: F8, vel_e: F8, sky: Sky) -> tuple[F8, F8]:
    """Position and velocity errors, east north up of the true position, m and m/s, (n, 3)."""
    llh = geodetic_from_ecef(sky.pos_e)
    turn = rotations_ne_enu(llh[:, 0], llh[:, 1])
    pos = np.einsum("nij,nj->ni", turn, pos_e - sky.pos_e)
    return pos, np.einsum("nij,nj->ni", turn, vel_e - sky.vel_e)


def error_sizes(ep: EpochOut, sky: Sky, first: int = 0) -> dict[str, float]:
    """2RMS of horizontal and vertical position and of velocity (three-dimensional), from epoch ``first`` on.

    2RMS is twice the root of the mean square of the length of the error: in the plane, upwards, in space.
    """
    pos, vel = (e[first:] for e in local_errors(ep.pos, ep.vel, sky))
    known = np.isfinite(pos[:, 0])
    pos, vel = pos[known], vel[known & np.isfinite(vel[:, 0])]

    def twice_rms(e: F8) -> float:
        return float(2.0 * np.sqrt((e**2).sum(axis=1).mean())) if len(e) else float("nan")

    return {
        "horizontal_2rms_m": twice_rms(pos[:, :2]),
        "vertical_2rms_m": twice_rms(pos[:, 2:]),
        "velocity_2rms_mps": twice_rms(vel),
    }


def expected_sizes(ep: EpochOut, sky: Sky, first: int = 0) -> dict[str, float]:
    """What the estimator's own covariances say that `error_sizes` will be; names with ``expected_`` before them."""
    llh = geodetic_from_ecef(sky.pos_e[first:])
    turn = rotations_ne_enu(llh[:, 0], llh[:, 1])

    def variances(cov: F8) -> F8:
        return np.asarray(np.einsum("nij,njk,nik->ni", turn, cov[first:], turn))

    pos, vel = variances(ep.cov_pos), variances(ep.cov_vel)

    def twice(variance: F8) -> float:
        return float(2.0 * np.sqrt(np.nanmean(variance))) if np.isfinite(variance).any() else float("nan")

    return {
        "expected_horizontal_2rms_m": twice(pos[:, 0] + pos[:, 1]),
        "expected_vertical_2rms_m": twice(pos[:, 2]),
        "expected_velocity_2rms_mps": twice(vel.sum(axis=1)),
    }


@dataclass(frozen=True)
class AccuracyTask:
    """Runs of one scenario through some methods.

    Attributes
    ----------
    scenario : Scenario
    seed : int
    methods : tuple of str
    config : RunConfig
        ``method`` is set for each.
    """

    scenario: Scenario
    seed: int
    methods: tuple[str, ...]
    config: RunConfig

    def description(self) -> Mapping[str, Any]:
        """See `Task`."""
        return {
            "what": "accuracy",
            "scenario": describe_scenario(self.scenario),
            "seed": self.seed,
            "methods": list(self.methods),
            "config": self.config.to_dict(),
        }

    def prepare(self) -> Callable[[int], Sequence[Row]]:
        """See `Task`."""
        scene = Scene(self.scenario, self.seed, navigation_of(self.scenario))
        configs = [self.config.with_options({"method": method}) for method in self.methods]

        def rows(number: int) -> list[dict[str, float | int | str | None]]:
            sky = scene.run(number, self.config)
            return [_row(number, config, sky) for config in configs]

        return rows


def _row(number: int, config: RunConfig, sky: Sky) -> dict[str, float | int | str | None]:
    ep = sky.solve(config)
    distance = np.linalg.norm(ep.pos - sky.pos_e, axis=1)
    solved = np.isfinite(distance) & (ep.status != EPOCH_NO_SOLUTION)
    return {
        "run": number,
        "method": config.method,
        "epochs": len(ep.status),
        "solved": int(solved.sum()),
        "restarts": int((ep.status == EPOCH_RESET).sum()),
        **error_sizes(ep, sky),
        "max_3d_m": float(distance[solved].max()) if solved.any() else float("nan"),
        "final_3d_m": float(distance[solved][-1]) if solved.any() else float("nan"),
    }
