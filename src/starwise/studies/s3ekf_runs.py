"""Runs of the four scenarios: table 1 of the S3EKF paper, S3EKF against EKF, and the gain in velocity."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from starwise.constants import NS
from starwise.sim.scenario import load_scenario
from starwise.studies.accuracy_runs import describe_scenario, error_sizes, expected_sizes
from starwise.studies.montecarlo import Row
from starwise.studies.s3ekf_filter import JERK_PSD, METHODS, SCENARIOS, SETTLED_S, paper_config, solve_paper
from starwise.studies.scene import Scene

if TYPE_CHECKING:
    import polars as pl

RATE_NOISES: Final = (0.1, 1.0, 6.0)
"""Pseudorange-rate noise of the paper's section 5.2, m/s."""
SIZES: Final = ("horizontal_2rms_m", "vertical_2rms_m", "velocity_2rms_mps")
PAPER_TABLE: Final[dict[str, dict[str, tuple[float, float, float, float]]]] = {
    "horizontal_2rms_m": {"filter": (1.83, 5.01, 2.06, 1.98), "lsq": (9.65, 8.58, 9.29, 9.33)},
    "vertical_2rms_m": {"filter": (2.46, 5.05, 2.50, 3.12), "lsq": (12.75, 13.12, 11.71, 12.63)},
    "velocity_2rms_mps": {"filter": (0.13, 0.12, 0.09, 0.10), "lsq": (0.13, 0.12, 0.09, 0.10)},
}
"""Table 1 of the paper, scenarios 1..4; ``filter``: S3EKF and EKF, which it gives as equal."""
PAPER_GAIN: Final = {0.1: 0.0, 1.0: 0.22, 6.0: 0.63}


@dataclass(frozen=True)
class PaperTask:
    """A run: all four scenarios through all methods, and through least squares and S3EKF at other rate noises."""

    seed: int | None = None

    def description(self) -> Mapping[str, Any]:
        """See `starwise.studies.montecarlo.Task`."""
        return {
            "what": "s3ekf",
            "scenarios": [describe_scenario(load_scenario(name)) for name in SCENARIOS],
            "seed": self.seed,
            "jerk_psd": JERK_PSD,
            "settled_s": SETTLED_S,
            "config": paper_config("s3ekf").to_dict(),
        }

    def prepare(self) -> Callable[[int], Sequence[Row]]:
        """See `starwise.studies.montecarlo.Task`."""
        scenes = [Scene(load_scenario(name), self.seed) for name in SCENARIOS]

        def rows(number: int) -> list[Row]:
            return [row for index, scene in enumerate(scenes, 1) for row in scenario_rows(scene, index, number)]

        return rows


def scenario_rows(scene: Scene, index: int, number: int) -> list[Row]:
    """Rows of one run of one scenario: one per method and rate noise."""
    table: list[Row] = []
    for noise in RATE_NOISES:
        sky = scene.run(number, paper_config("s3ekf"), noise)
        first = int(np.searchsorted(sky.epochs.t_ns, sky.epochs.t_ns[0] + round(SETTLED_S * NS)))
        methods = METHODS if noise == RATE_NOISES[0] else ("lsq", "s3ekf")
        solved = {method: solve_paper(sky, method) for method in methods}
        for method, ep in solved.items():
            difference = np.nan
            if method == "ekf":
                difference = float(np.linalg.norm(ep.pos - solved["s3ekf"].pos, axis=1).max())
            table.append(
                {
                    "run": number,
                    "scenario": index,
                    "rate_noise_mps": noise,
                    "method": method,
                    **error_sizes(ep, sky, first),
                    **expected_sizes(ep, sky, first),
                    "difference_m": difference,
                }
            )
    return table


def table1(runs: "pl.DataFrame") -> list[dict[str, Any]]:
    """Table 1: 2RMS over all epochs of all runs, the spread of single runs, what was expected, the paper's figure.

    Returns
    -------
    list of dict
        ``scenario, method, horizontal_2rms_m, vertical_2rms_m, velocity_2rms_mps``; for each of the three also
        ``<name>_spread`` (standard deviation between runs), ``expected_<name>`` (from the
        estimator's own covariances), ``paper_<name>``, and ``runs``.
    """
    rows = runs.filter(runs["rate_noise_mps"] == RATE_NOISES[0])
    table = []
    for index in range(1, len(SCENARIOS) + 1):
        for method in METHODS:
            some = rows.filter((rows["scenario"] == index) & (rows["method"] == method))
            entry: dict[str, Any] = {"scenario": index, "method": method, "runs": len(some)}
            for name in SIZES:
                values = some[name].to_numpy()
                entry[name] = float(np.sqrt((values**2).mean()))
                entry[f"{name}_spread"] = float(values.std(ddof=1)) if len(values) > 1 else 0.0
                entry[f"expected_{name}"] = float(np.sqrt((some[f"expected_{name}"].to_numpy() ** 2).mean()))
                entry[f"paper_{name}"] = PAPER_TABLE[name]["lsq" if method == "lsq" else "filter"][index - 1]
            table.append(entry)
    return table


def sensitivity(
    psds: Sequence[float] = (0.01, 0.1, 1.0, JERK_PSD, 100.0), runs: int = 10, seed: int | None = None
) -> list[dict[str, Any]]:
    """What another process noise would have given: nothing here was chosen by it.

    Returns
    -------
    list of dict
        ``jerk_psd``; ``horizontal_2rms_m``, ``vertical_2rms_m``, ``velocity_2rms_mps`` of S3EKF (a list, scenarios
        1..4); ``velocity_gain`` (a list, rate noises of the paper, all scenarios together).
    """
    scenes = [Scene(load_scenario(name), seed) for name in SCENARIOS]
    squares = np.zeros((len(psds), len(scenes), len(RATE_NOISES), len(SIZES)))
    lsq = np.zeros((len(scenes), len(RATE_NOISES)))
    for number in range(runs):
        for i, scene in enumerate(scenes):
            for j, noise in enumerate(RATE_NOISES):
                sky = scene.run(number, paper_config("s3ekf"), noise)
                first = int(np.searchsorted(sky.epochs.t_ns, sky.epochs.t_ns[0] + round(SETTLED_S * NS)))
                lsq[i, j] += error_sizes(solve_paper(sky, "lsq"), sky, first)["velocity_2rms_mps"] ** 2 / runs
                for k, psd in enumerate(psds):
                    sizes = error_sizes(solve_paper(sky, "s3ekf", jerk_psd=psd), sky, first)
                    squares[k, i, j] += np.array([sizes[name] for name in SIZES]) ** 2 / runs
    out = []
    for k, psd in enumerate(psds):
        entry: dict[str, Any] = {"jerk_psd": psd}
        for index, name in enumerate(SIZES):
            entry[name] = np.sqrt(squares[k, :, 0, index]).tolist()
        entry["velocity_gain"] = (1.0 - np.sqrt(squares[k, :, :, 2].sum(axis=0) / lsq.sum(axis=0))).tolist()
        out.append(entry)
    return out


def max_difference(runs: "pl.DataFrame") -> float:
    """Largest distance between EKF and S3EKF at any epoch of any run, m."""
    return float(runs.filter(runs["method"] == "ekf")["difference_m"].max())  # type: ignore[arg-type]


def velocity_gain(runs: "pl.DataFrame") -> list[dict[str, Any]]:
    """By how much the filter's velocity is better than that of least squares, by rate noise.

    Returns
    -------
    list of dict
        ``rate_noise_mps``, ``gain`` (1 - RMS of the filter / RMS of least squares, all scenarios together),
        ``paper_gain``, and ``by_scenario``.
    """
    out = []
    for noise in RATE_NOISES:
        rows = runs.filter(runs["rate_noise_mps"] == noise)

        def gain(some: "pl.DataFrame") -> float:
            squares = {
                method: float((some.filter(some["method"] == method)["velocity_2rms_mps"].to_numpy() ** 2).mean())
                for method in ("lsq", "s3ekf")
            }
            return 1.0 - float(np.sqrt(squares["s3ekf"] / squares["lsq"]))

        each = [gain(rows.filter(rows["scenario"] == index)) for index in range(1, len(SCENARIOS) + 1)]
        out.append({"rate_noise_mps": noise, "gain": gain(rows), "paper_gain": PAPER_GAIN[noise], "by_scenario": each})
    return out
