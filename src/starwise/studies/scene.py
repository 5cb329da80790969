"""A scenario made ready to be solved many times: geometry once, random numbers for every run."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.config import RunConfig
from starwise.constants import C_LIGHT, ROW_USED, SYSTEMS
from starwise.estimators.filter import filter_rows
from starwise.estimators.least_squares import empty_epochs, spp_options
from starwise.kernels.rangemodel import Epochs, ModelOptions, RowModel, Rows
from starwise.kernels.spp import EpochOut, spp_run
from starwise.models.pseudorange import empty_row_model, model_options, prepare
from starwise.physics.broadcast import BroadcastEphemeris
from starwise.signals import frequency_table, signal_name, sv_name
from starwise.sim.clock import ReceiverClock
from starwise.sim.run import Simulation, Simulator
from starwise.sim.scenario import Scenario
from starwise.sim.seeds import streams
from starwise.types import F8, I2, BroadcastRecords, IonosphereModel

ALL_SEEN: Final = -1.6
"""Elevation mask, rad, below every satellite: the simulator has applied the scenario's mask already."""


@dataclass(frozen=True)
class Sky:
    """Measurements of one run in the form that estimators take, and what is true.

    Attributes
    ----------
    epochs : Epochs
    rows : Rows
    model : ModelOptions
    n_clocks : int
    pos_e, vel_e : (n_epochs, 3) float64
        True antenna, ECEF, m and m/s.
    sv : (n_rows,) int16
        Satellite of each row.
    """

    epochs: Epochs
    rows: Rows
    model: ModelOptions
    n_clocks: int
    pos_e: F8
    vel_e: F8
    sv: I2

    def solve(self, config: RunConfig, start: tuple[F8, F8] | None = None) -> EpochOut:
        """Positions by ``config.method``; see `starwise.estimators.filter.filter_rows`."""
        return solve_rows(self, config, start)[0]


def solve_rows(sky: Sky, config: RunConfig, start: tuple[F8, F8] | None = None) -> tuple[EpochOut, RowModel]:
    """Positions of every epoch and the model of every row, by ``config.method``."""
    if config.method != "lsq":
        return filter_rows(sky.epochs, sky.rows, sky.model, sky.n_clocks, config, start)
    ep, out = empty_epochs(len(sky.epochs.t_ns), sky.n_clocks), empty_row_model(len(sky.rows.code_m))
    spp_run(sky.model, spp_options(config), sky.epochs, sky.rows, ep, out)
    return ep, out


def only_noise(scenario: Scenario) -> bool:
    """Whether runs of a scenario differ by white noise of one size and by the clock alone."""
    r = scenario.receiver
    errors = r.ephemeris
    return (
        r.noise.model == "fixed"
        and r.multipath.sigma_m == 0.0
        and r.ionosphere.model == "none"
        and r.troposphere.model == "none"
        and errors.is_none
        and r.clock.reset == "none"
        and not scenario.faults
        and all(len(names) == 1 for names in r.signals.values())
    )


class Scene:
    """A scenario, a seed, and the measurements of any of its runs.

    Where only white noise and the clock differ between runs (`only_noise`), satellites and light paths are computed
    once and a run costs its random numbers: the very numbers that `starwise.sim.run.Simulator` draws. The paths are
    those of run 0, at whose instants of reception every run then takes its measurements; against the simulator, in
    which a clock that differs by a microsecond moves the instants by that much, this is 1 mm. Other scenarios are
    simulated in full for every run.

    Law: run r is the same, to the last bit, whatever ran before and wherever it runs.

    Parameters
    ----------
    scenario : Scenario
    seed : int, optional
        In place of the scenario's.
    nav : BroadcastRecords, optional
        For a sky of source ``nav``.
    """

    def __init__(self, scenario: Scenario, seed: int | None = None, nav: BroadcastRecords | None = None) -> None:
        self.scenario = scenario
        self.simulator = Simulator(scenario, seed, nav)
        self.seed = self.simulator.seed
        self.quick = only_noise(scenario)

    @cached_property
    def first(self) -> Simulation:
        """Run 0 in full."""
        return self.simulator.run(0)

    def run(self, number: int, config: RunConfig, rate_noise_mps: float | None = None) -> Sky:
        """Measurements of a run.

        Parameters
        ----------
        number : int
            From 0.
        config : RunConfig
            What the estimator corrects and how it weights, where the noise is not of one known size.
        rate_noise_mps : float, optional
            Size of the pseudorange-rate noise in place of the scenario's (the same random numbers, scaled).

        Raises
        ------
        StarwiseError
            Nothing to position with; rate noise of a scenario that is not `only_noise`.
        """
        if self.quick:
            return self._noisy(number, rate_noise_mps)
        if rate_noise_mps is not None:
            raise ValueError("only scenarios of white noise can have another rate noise")
        return sky_of(self.first if number == 0 else self.simulator.run(number), config)

    @cached_property
    def _clean(self) -> tuple[Sky, NDArray[np.int64], tuple[str, ...], NDArray[np.int64]]:
        """Run 0 without noise; epoch and signal of every row; names of the signals."""
        sim = self.first
        obs, truth = sim.observations, sim.truth
        paths, at = truth.paths, truth.rows.path
        epoch = obs.epoch_of_row()
        wavelength = C_LIGHT / frequency_table(obs.channels)[obs.sv >> 8, obs.sv & 255, obs.sig >> 8]
        letters = sorted({int(s) >> 8 for s in np.unique(obs.sv)})
        column = np.zeros(len(SYSTEMS), dtype=np.int64)
        column[letters] = np.arange(len(letters))
        n = obs.n_rows
        rows = Rows(
            sat_pos=np.ascontiguousarray(paths.sat_pos_e[at]),
            sat_vel=np.ascontiguousarray(paths.sat_vel_e[at]),
            clock_m=C_LIGHT * paths.sat_clock_s[at] - truth.rows.group_delay_m,
            drift_mps=C_LIGHT * paths.sat_drift[at],
            code_m=obs.code_m - truth.rows.code_noise_m,
            rate_mps=-wavelength * obs.doppler_hz - truth.rows.rate_noise_mps,
            cn0_dbhz=np.full(n, np.nan),  # the noise is of one known size, the air is empty: nothing uses them
            freq_hz=np.full(n, np.inf),
            sigma_sat_m=np.zeros(n),
            noise_factor=np.ones(n),
            system=(obs.sv >> 8).astype(np.int64),
            clock=column[obs.sv >> 8],
            status=np.full(n, ROW_USED, dtype=np.uint8),
        )
        epochs, n_clocks = Epochs(obs.t_ns, obs.offsets), len(letters)
        sky = Sky(epochs, rows, _model(self.scenario), n_clocks, truth.pos_e, truth.vel_e, obs.sv)
        key, which = np.unique(obs.sv.astype(np.int64) << 16 | obs.sig.astype(np.int64), return_inverse=True)
        names = tuple(f"{sv_name(int(k >> 16))}/{signal_name(int(k & 0xFFFF))}" for k in key)
        return sky, epoch, names, which.astype(np.int64)

    def _noisy(self, number: int, rate_noise_mps: float | None) -> Sky:
        clean, epoch, names, which = self._clean
        noise = self.scenario.receiver.noise
        n, rng = len(self.scenario.t_ns), streams(self.seed, number)
        clock = ReceiverClock.of(self.scenario.receiver.clock).sample(self.scenario.t_ns, rng("clock"))
        bias = C_LIGHT * (clock.bias_s - self.first.truth.clock_s)
        drift = C_LIGHT * (clock.drift - self.first.truth.drift)
        sigma = noise.rate_mps if rate_noise_mps is None else rate_noise_mps
        rows = clean.rows._replace(
            code_m=clean.rows.code_m + bias[epoch] + noise.code_m * _white(rng, "code", names, n)[which, epoch],
            rate_mps=clean.rows.rate_mps + drift[epoch] + sigma * _white(rng, "rate", names, n)[which, epoch],
        )
        model = clean.model._replace(fixed_rate_sigma_mps=sigma)
        return replace(clean, rows=rows, model=model)


def _white(rng: object, source: str, names: tuple[str, ...], n: int) -> F8:
    """Unit white noise (signal, epoch): the streams of `starwise.sim.receiver`."""
    assert callable(rng)
    return np.array([rng(f"{source}/{name}").standard_normal(n) for name in names])


def _model(scenario: Scenario) -> ModelOptions:
    """The measurement model of a scenario of white noise: its sizes, and nothing to correct."""
    options = model_options(RunConfig(ionosphere="none", troposphere="none"), IonosphereModel())[0]
    noise = scenario.receiver.noise
    return options._replace(
        mask_rad=ALL_SEEN, fixed_code_sigma_m=max(noise.code_m, 1e-3), fixed_rate_sigma_mps=max(noise.rate_mps, 1e-4)
    )


def sky_of(simulation: Simulation, config: RunConfig) -> Sky:
    """Measurements of a simulation as a receiver has them: satellites from the broadcast message, corrections by model.

    Raises
    ------
    StarwiseError
        Nothing to position with.
    """
    ephemeris = BroadcastEphemeris(simulation.records)
    prepared = prepare(simulation.observations, ephemeris, simulation.ionosphere, config)
    return Sky(
        prepared.epochs,
        prepared.rows,
        prepared.options,
        len(prepared.clock_names),
        simulation.truth.pos_e,
        simulation.truth.vel_e,
        prepared.sightings.sv,
    )
