"""Linear systems of a finished run: what its filter did, epoch by epoch, as matrices, out of solution and ledger.

Navigation states: position, velocity, acceleration (as the motion model has them) east, north, up; clock and drift of
the receiver against the first system, and what the other systems' differ from it by: ``clk.G``, ``isb.E``,
``drift.G``, ``isd.E``. Behind them the errors of the measurements that last (coloured error model; none where errors
are white).

H are the directions of the satellites, E the sizes of the errors, r white noise with what robust weights added: those
of the filter to rounding, so that its covariances come out again (`starwise.analysis.run_window.filtered`).

What the ledger does not repeat is left out: the change of a rate with the position (1.5e-4 1/s), adaptation rules,
steps of receiver clocks, GLONASS channels.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.analysis.run_ins import InertialSystem
from starwise.analysis.run_table import RunTable, run_table
from starwise.analysis.run_window import CODE, RATE, RunStep, RunWindow
from starwise.config import RunConfig
from starwise.constants import SYSTEMS
from starwise.errors import StarwiseError
from starwise.kernels.colored import START_SIGMA_M
from starwise.kernels.error_states import EAST, N_SKY, NORTH, SIGNAL, SLOW, TROPOSPHERE, VERTICAL, ErrorModel
from starwise.kernels.error_states import IONOSPHERE as SLANT
from starwise.models.error_model import error_names
from starwise.models.process import Clocks, Motion, clocks_from, matrices, motion_from
from starwise.types import F8, I8, Fixes, Layout, Solution

UP: Final = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class RunSystem:
    """A finished run as a source of linear systems.

    Attributes
    ----------
    solution : Solution
    config : RunConfig
        As it was made, ``dynamics`` settled.
    motion : Motion
    clocks : Clocks
    table : RunTable
    notes : tuple of str
        What the analysis leaves out or assumes.
    """

    solution: Solution
    config: RunConfig
    motion: Motion
    clocks: Clocks
    table: RunTable
    notes: tuple[str, ...] = field(default=())

    @classmethod
    def of(cls, solution: Solution) -> "RunSystem":
        """System of a run.

        Raises
        ------
        StarwiseError
            The solution has no ledger of satellites or does not say how it was made; inertial and fused runs.
        """
        given = solution.provenance.get("config")
        if not isinstance(given, Mapping) or "receivers" in solution.provenance:
            raise StarwiseError("the solution does not say how it was made", wanted="a result directory of solve")
        config, notes = config_of(solution)
        precise = any(item.get("kind") == "orbits" for item in solution.provenance.get("inputs", ()))
        table = run_table(solution, config, precise)
        return cls(solution, config, motion_from(config), clocks_from(config), table, notes)

    @property
    def memoryless(self) -> bool:
        """Every epoch was solved by itself: no filter."""
        return self.config.method == "lsq"

    @cached_property
    def measured(self) -> NDArray[np.intp]:
        """Epochs of which a measurement was used."""
        return np.unique(self.table.epoch[self.table.used.any(axis=1)])

    def longest_stretch(self) -> tuple[int, int]:
        """First epoch and number of epochs of the longest part without a new start of the filter."""
        begin = np.flatnonzero(self.table.fresh)
        if not len(begin):
            raise StarwiseError("no epoch of the run was solved")
        edges = np.append(begin, len(self.table.t_ns))
        k = int(np.diff(edges).argmax())
        return int(edges[k]), int(edges[k + 1] - edges[k])

    def window(self, first: int, count: int) -> RunWindow:
        """Epochs ``first`` to ``first + count`` (exclusive) as a linear system that begins anew."""
        return self.changed(first, count)

    @property
    def systems(self) -> str:
        """Letters of the systems of which satellites were used."""
        return "".join(SYSTEMS[k] for k in np.unique(self.table.sv[self.table.used[:, 0]] >> 8))

    @property
    def moving(self) -> bool:
        """The filter expects motion."""
        return self.motion.nk > 3

    def changed(self, first: int, count: int, *, rates: bool | None = None, without: str = "") -> RunWindow:
        """As `window`, with the rates of all satellites used (True) or none (False), and without systems (letters)."""
        table = self.table
        last = min(first + count, len(table.t_ns))
        rows = np.arange(table.offsets[first], table.offsets[last])
        off = [SYSTEMS.index(letter) for letter in without]
        rows = rows[table.used[rows].any(axis=1) & (table.clock[rows] >= 0) & ~np.isin(table.sv[rows] >> 8, off)]
        use = table.used[rows].copy()
        if rates is not None:
            use[:, RATE] = rates & (use[:, RATE] | (use[:, CODE] & np.isfinite(table.white[rows, RATE])))
        return self.build(first, last, rows, use)

    def build(self, first: int, last: int, rows: NDArray[np.intp], use: NDArray[np.bool_]) -> RunWindow:
        """System of epochs ``first`` to ``last`` with chosen rows of the table and, of each, codes and rate."""
        table, errors = self.table, self.table.errors
        seen = np.unique(table.clock[rows]) if len(rows) else np.zeros(0, np.int64)
        column = np.full(len(table.clock_names), -1)
        column[seen] = np.arange(len(seen))
        letters = [table.clock_names[k] for k in seen]
        names = self.names(letters)
        satellites = np.unique(table.sv[rows])
        slot = np.full(1 << 15, -1)
        slot[satellites] = np.arange(len(satellites))
        n_e = N_SKY + errors.n_bias + errors.block * len(satellites) if errors.on else 0
        phis = self._memory(first, last, len(satellites))
        states = table.states_of(rows) if n_e else None
        epoch = table.epoch[rows]
        cut = np.searchsorted(epoch, np.arange(first, last + 1))
        T = self._differences(len(letters))
        steps, t_before, made = [], int(table.t_ns[first]), {}
        for k, e in enumerate(range(first, last)):
            dt = (int(table.t_ns[e]) - t_before) * 1e-9
            t_before = int(table.t_ns[e])
            if dt not in made:
                Phi, Q = matrices(self.motion, self.clocks, len(letters), dt, UP)
                made[dt] = Phi, T @ Q @ T.T  # Phi is the same for differences
            part = slice(cut[k], cut[k + 1])
            own = None if states is None else tuple(a[part] for a in states)
            steps.append(
                self._step(
                    e, rows[part], use[part], column, slot, len(letters), n_e, made[dt], phis[k], len(names), own
                )
            )
        error_states = error_names(errors, table.bias_names, satellites.tolist()) if errors.on else ()
        return RunWindow(names, error_states, self.prior(len(letters)), tuple(steps), first)

    def names(self, letters: list[str]) -> Layout:
        """Navigation states with the clocks of some systems."""
        local = dict(zip("xyz", "enu", strict=True))
        motion = [f"{name[:-1]}{local[name[-1]]}" for name in self.motion.names]
        clocks = [f"{kind}.{s}" for pair in (("clk", "isb"), ("drift", "isd")) for kind, s in _kinds(pair, letters)]
        return Layout((*motion, *clocks))

    def prior(self, n_clocks: int) -> F8:
        """Covariance of a start about which nothing is known, as the filter's."""
        nk, m, c = self.motion.nk, self.motion, self.clocks
        P = np.zeros((nk + 2 * n_clocks, nk + 2 * n_clocks))
        sizes = (START_SIGMA_M, m.velocity_sigma0, m.acceleration_sigma0)
        P[range(nk), range(nk)] = np.repeat(sizes[: nk // 3], 3) ** 2
        own = np.eye(n_clocks)
        a, b = slice(nk, nk + n_clocks), slice(nk + n_clocks, nk + 2 * n_clocks)
        P[a, a] = START_SIGMA_M**2 + c.intersystem_sigma0**2 * own
        P[b, b] = c.drift_sigma0**2 + c.intersystem_drift_sigma0**2 * own
        T = self._differences(n_clocks)
        return np.asarray(T @ P @ T.T)

    def _differences(self, n_clocks: int) -> F8:
        """Matrix from clocks and drifts of all systems to those of the first and the others' differences from it."""
        nk = self.motion.nk
        T = np.eye(nk + 2 * n_clocks)
        for block in (nk, nk + n_clocks):
            T[block + 1 : block + n_clocks, block] = -1.0
        return T

    def _step(
        self, e: int, rows: NDArray[np.intp], use: NDArray[np.bool_], column: I8, slot: I8, nc: int, n_e: int,
        motion: tuple[F8, F8], phi: F8, n: int, states: tuple[NDArray[Any], ...] | None,
    ) -> RunStep:  # fmt: skip
        table, nk = self.table, self.motion.nk
        which, kind = np.nonzero(use)
        order = np.lexsort((which, kind))
        which, kind = which[order], kind[order]
        at = rows[which]
        m = len(at)
        H, E = np.zeros((m, n)), np.zeros((m, n_e))
        rate = kind == RATE
        line = np.arange(m)
        clock = column[table.clock[at]]
        for which_kind, block in ((~rate, nk), (rate, nk + nc)):
            H[line[which_kind], block] = 1.0
            H[line[which_kind], block + clock[which_kind]] = 1.0
        H[line[~rate], :3] = -table.direction[at[~rate]]
        if nk > 3:
            H[line[rate], 3:6] = -table.direction[at[rate]]
        if states is not None:
            code = line[~rate]
            where, b = at[code], kind[code]
            idx, val, count = (a[which[code], b] for a in states)
            common = N_SKY + table.errors.n_bias
            shift = np.where(idx >= common, slot[table.sv[where]][:, None] * table.errors.block, 0)
            k = np.arange(idx.shape[1])
            inside = (k >= 4) & (k < count[:, None])
            row, col = np.nonzero(inside)
            np.add.at(E, (code[row], (idx + shift)[row, col]), val[row, col])
        widened = table.extra[at, kind]
        return RunStep(
            int(table.t_ns[e]), motion[0], motion[1], phi, H, E, table.white[at, kind] + widened, widened,
            kind.astype(np.int64), table.sv[at],
        )  # fmt: skip

    def _memory(self, first: int, last: int, n_satellites: int) -> list[F8]:
        """Factors of the error states over the step that ends at each epoch."""
        errors, table = self.table.errors, self.table
        if not errors.on:
            return [np.zeros(0)] * (last - first)
        tau = error_times(errors)
        speed = self._speed()
        out = []
        for e in range(first, last):
            dt = (table.t_ns[e] - table.t_ns[max(e - 1, first)]) * 1e-9
            rate = 1.0 / tau
            for place in (errors.multipath1, errors.multipath2):
                if place >= 0:
                    rate[N_SKY + errors.n_bias + place] += speed[max(e - 1, 0)] / errors.multipath_length
            head, block = rate[: N_SKY + errors.n_bias], rate[N_SKY + errors.n_bias :]
            out.append(np.exp(-dt * np.concatenate([head, np.tile(block, n_satellites)])))
        return out

    def _speed(self) -> F8:
        """Speed less what noise of the estimate adds, m/s, 0 where not known."""
        solution = self.solution
        if self.motion.nk == 3:
            return np.zeros(solution.n_epochs)
        noise = np.trace(solution.cov_vel, axis1=1, axis2=2)
        return np.asarray(np.sqrt(np.maximum(np.nan_to_num((solution.vel_e**2).sum(axis=1) - noise), 0.0)))

    def with_satellites(self, letter: str, epoch: I8, sv: NDArray[Any], elevation: F8, azimuth: F8) -> "RunSystem":
        """The run as if satellites of another system had been used, too; (k,) each, elevation and azimuth in rad.

        Their rows stand in the ledger with the signals that `solve` prefers, 45 dB-Hz, and the ionosphere that the
        run's own rows have, mapped to their elevation; a rate each where the run has any.
        """
        from starwise.analysis.run_table import with_rows

        ledger, names = with_rows(self.solution, self.config, letter, epoch, sv, elevation, azimuth)
        k = len(names) - len(self.solution.clock_names)
        solution = replace(
            self.solution, ledger=ledger, clock_names=names, clock_m=_wider(self.solution.clock_m, k),
            drift_mps=_wider(self.solution.drift_mps, k), clock_sigma_m=_wider(self.solution.clock_sigma_m, k),
        )  # fmt: skip
        return replace(self, solution=solution, table=run_table(solution, self.config))


def _wider(values: F8, k: int) -> F8:
    return np.concatenate([values, np.full((len(values), k), np.nan)], axis=1)


def _kinds(pair: tuple[str, str], letters: list[str]) -> list[tuple[str, str]]:
    """Names of the first system's state and of the differences of the others."""
    return [(pair[0] if k == 0 else pair[1], letter) for k, letter in enumerate(letters)]


def error_times(errors: ErrorModel) -> F8:
    """Correlation times of the common error states and of one satellite's, s; infinite: permanent."""
    common, block = np.full(N_SKY + errors.n_bias, np.inf), np.empty(errors.block)
    common[TROPOSPHERE] = errors.troposphere_tau
    common[[VERTICAL, NORTH, EAST]] = errors.vertical_tau
    block[SLOW], block[SLANT], block[SIGNAL] = errors.slow_tau, errors.ionosphere_tau, errors.signal_tau
    if errors.signal2 >= 0:
        block[errors.signal2] = errors.signal_tau
    for place in (errors.multipath1, errors.multipath2):
        if place >= 0:
            block[place] = errors.multipath_tau
    return np.concatenate([common, block])


def config_of(solution: Solution) -> tuple[RunConfig, tuple[str, ...]]:
    """Configuration of a run out of its provenance, with the motion that was found; notes on what is not followed."""
    given: dict[str, Any] = dict(solution.provenance["config"])
    config = RunConfig.from_dict({key: value for key, value in given.items() if value is not None})
    used = solution.provenance.get("dynamics", {}).get("used")
    if used:
        config = config.with_options({"dynamics": used})
    notes = []
    if config.method == "federated":
        notes.append("federated: the system is that of the central filter with the same measurements")
    if config.adaptation != "none":
        notes.append(f"adaptation {config.adaptation}: not followed, the system is that without it")
    return config, tuple(notes)


AnySystem = RunSystem | InertialSystem


def system_of(solution: Solution, fixes: Fixes | None = None) -> AnySystem:
    """System of a finished run, whatever filter made it.

    Parameters
    ----------
    solution : Solution
    fixes : Fixes, optional
        Those of an inertial run with fixes: their sigmas are not in the result.

    Raises
    ------
    StarwiseError
        The solution does not say what was measured.
    """
    given = solution.provenance.get("config")
    if isinstance(given, Mapping) and "inertial" in given:
        return InertialSystem.of(solution, fixes)
    return RunSystem.of(solution)
