"""A scenario simulated: sky, vehicle, receiver and inertial sensors together."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import NS
from starwise.errors import StarwiseError
from starwise.sim.clock import ReceiverClock
from starwise.sim.imu import SimulatedImu, simulate_imu
from starwise.sim.orbits import read_tle
from starwise.sim.receiver import Motion, in_view, receive
from starwise.sim.scenario import Scenario
from starwise.sim.seeds import Streams, streams
from starwise.sim.sky import TrueSky, build_sky
from starwise.sim.trajectory import TrajectoryStates
from starwise.sim.truth import SimTruth
from starwise.types import F8, I8, BroadcastRecords, IonosphereModel, Observations

_TAYLOR_S: Final = 2e-3
"""Up to this clock offset a smooth path between tag and reception is a parabola (jerk 100 m/s^3: 1e-7 m)."""


@dataclass(frozen=True)
class Simulation:
    """What a run of a scenario gives: the nouns that files give, and the truth."""

    scenario: Scenario
    seed: int
    run: int
    observations: Observations
    records: BroadcastRecords
    truth: SimTruth
    imu: SimulatedImu | None
    sky: TrueSky

    @property
    def ionosphere(self) -> IonosphereModel:
        """Broadcast ionosphere coefficients."""
        return self.records.ionosphere


class Simulator:
    """A scenario made ready for many runs: orbits, messages and path are made once.

    Law: run ``r`` of seed ``s`` is the same, to the last bit, whatever ran before and wherever it runs.

    Parameters
    ----------
    scenario : Scenario
    seed : int, optional
        In place of the scenario's.
    nav : BroadcastRecords, optional
        Records for a sky of source ``nav`` (files are read by the caller).

    Raises
    ------
    StarwiseError
        A sky without satellites, a path that cannot be flown, a file that cannot be read.
    """

    def __init__(self, scenario: Scenario, seed: int | None = None, nav: BroadcastRecords | None = None) -> None:
        self.scenario = scenario
        self.seed = scenario.seed if seed is None else seed
        if self.seed < 0:
            raise StarwiseError("a seed is not negative", found=str(self.seed))
        self._nav = nav

    @cached_property
    def sky(self) -> TrueSky:
        """True sky without ephemeris errors; the same for every run of a seed."""
        scenario = self.scenario
        sets = []
        if scenario.sky.source == "tle":
            for name in scenario.sky.files:
                path = scenario.path_of(name)
                try:
                    text = path.read_text(encoding="utf-8", errors="replace")
                except OSError as error:
                    raise StarwiseError(f"cannot be read ({error.strerror})", file=path) from None
                sets += read_tle(text, str(path))
        start, end = int(scenario.t_ns[0]), int(scenario.t_ns[-1])
        return build_sky(scenario.sky, start, end, streams(self.seed), self._nav, sets)

    def run(self, number: int = 0) -> Simulation:
        """One run; ``number`` (from 0) chooses its random numbers."""
        scenario = self.scenario
        rng = streams(self.seed, number)
        sky = self.sky.with_error(scenario.receiver.ephemeris, rng)
        observations, truth = receive(
            scenario.receiver, scenario.faults, sky, self._motion(rng), rng, scenario.output.marker, self._in_view
        )
        imu = None
        if scenario.imu is not None:
            imu = simulate_imu(
                scenario.trajectory, scenario.imu, scenario.time.start_ns, scenario.time.end_ns, rng, scenario.faults
            )
        return Simulation(scenario, self.seed, number, observations, sky.records, truth, imu, sky)

    @cached_property
    def _at_tags(self) -> tuple[TrajectoryStates, F8, F8]:
        return self._antenna(self.scenario.t_ns)

    @cached_property
    def _in_view(self) -> NDArray[np.bool_]:
        """Satellites above the masks; neither clock nor ephemeris error moves them by 1e-6 rad."""
        return in_view(self.scenario.receiver, self.sky, self.scenario.t_ns, self._at_tags[1])

    @cached_property
    def _to_knot_s(self) -> F8:
        """Time between each tag and the nearest instant at which the path is not smooth, s."""
        path = self.scenario.trajectory
        t_s = (self.scenario.t_ns - path.t0_ns) * 1e-9
        k = np.searchsorted(path.knots_s, t_s)
        after = path.knots_s[np.minimum(k, len(path.knots_s) - 1)]
        return np.minimum(np.abs(after - t_s), np.abs(path.knots_s[np.maximum(k - 1, 0)] - t_s))

    def _antenna(self, t_ns: I8) -> tuple[TrajectoryStates, F8, F8]:
        """Body, and position and velocity of the antenna, at times."""
        body = self.scenario.trajectory.states(t_ns)
        pos_e, vel_e = body.at_lever_arm(self.scenario.receiver.lever_arm_m)
        return body, np.ascontiguousarray(pos_e), np.ascontiguousarray(vel_e)

    def _motion(self, rng: Streams) -> Motion:
        """Antenna and clock at the epochs."""
        scenario = self.scenario
        clock = ReceiverClock.of(scenario.receiver.clock).sample(scenario.t_ns, rng("clock"))
        at, pos_e, vel_e = self._at_tags
        b = clock.bias_s[:, None]
        pos_e, vel_e = pos_e - b * (vel_e - 0.5 * b * at.acc_e), vel_e - b * at.acc_e
        direct = np.flatnonzero((np.abs(clock.bias_s) > _TAYLOR_S) | (np.abs(clock.bias_s) >= self._to_knot_s))
        if len(direct):
            received = scenario.t_ns[direct] - np.rint(clock.bias_s[direct] * NS).astype(np.int64)
            _, pos_e[direct], vel_e[direct] = self._antenna(received)
        return Motion(
            t_ns=scenario.t_ns,
            clock_s=clock.bias_s,
            drift=clock.drift,
            steered_s=clock.steered_s,
            pos_e=np.ascontiguousarray(pos_e),
            vel_e=np.ascontiguousarray(vel_e),
            acc_e=at.acc_e,
            euler=at.euler,
        )


def simulate(
    scenario: Scenario, seed: int | None = None, nav: BroadcastRecords | None = None, run: int = 0
) -> Simulation:
    """Simulate a scenario once; see `Simulator`."""
    return Simulator(scenario, seed, nav).run(run)
