"""Linear systems of a finished run: what its filter did, epoch by epoch, as matrices, out of solution and ledger.

Navigation states x (position, velocity, acceleration east, north, up; clocks and drifts of the systems) and errors e of
the measurements that last (coloured error model; none where errors are white):

    x_k = Phi_k x_{k-1} + w_k,   w ~ (0, Q_k);       e_k = phi_k e_{k-1} + u_k,   u ~ (0, 1 - phi_k^2), diagonal
    z_k = H_k x_k + E_k e_k + v_k,   v ~ (0, diag r_k)

H are the directions of the satellites, E the sizes of the errors, r white noise with what robust weights added. The
errors are *kept as states, all of them*, with their unit prior: nothing is approximated, and a satellite that appears
finds its states as they are before anything is known. Observability concerns x alone: e is noise there, correlated in
time, and `whitened` takes it out exactly, by the filter of e alone. Where the filter itself is followed (covariance,
stability), x and e are filtered together, as in the run.

What the ledger does not repeat is left out: the change of a rate with the position (1.5e-4 1/s), the excess of an
ephemeris' own claim over the usual, adaptation rules, steps of receiver clocks, GLONASS channels.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from starwise.analysis.run_table import RunTable, run_table
from starwise.analysis.stability_system import LinearSystem, Step
from starwise.config import RunConfig
from starwise.errors import StarwiseError
from starwise.kernels.colored import START_SIGMA_M
from starwise.kernels.error_states import EAST, N_SKY, NORTH, SIGNAL, SLOW, TROPOSPHERE, VERTICAL, ErrorModel
from starwise.kernels.error_states import IONOSPHERE as SLANT
from starwise.models.error_model import error_names
from starwise.models.process import Clocks, Motion, clocks_from, matrices, motion_from
from starwise.types import F8, I8, Layout, Solution

CODE, CODE2, RATE, OTHER = 0, 1, 2, 3
"""Kinds of measurements."""
UP: Final = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class RunStep:
    """One epoch of a run as a linear system; see the module.

    Attributes
    ----------
    t_ns : int
    Phi, Q : (n, n) float64
    phi : (n_e,) float64
    H, E : (m, n), (m, n_e) float64
    r : (m,) float64
        Variances that the filter worked with.
    widened : (m,) float64
        Part of them that robust weights added.
    kind : (m,) int64
        `CODE` ...
    sv : (m,) int16
        Satellite, -1: none.
    """

    t_ns: int
    Phi: F8
    Q: F8
    phi: F8
    H: F8
    E: F8
    r: F8
    widened: F8
    kind: I8
    sv: NDArray[np.int16]


@dataclass(frozen=True)
class RunWindow:
    """Consecutive epochs of a run as a linear system that begins with a filter's start.

    Attributes
    ----------
    layout : Layout
        Navigation states.
    error_names : tuple of str
        The lasting errors behind them.
    prior : (n, n) float64
        Covariance of the navigation states before the first epoch: that of a start about which nothing is known.
    steps : tuple of RunStep
    first : int
        Epoch of the run.
    """

    layout: Layout
    error_names: tuple[str, ...]
    prior: F8
    steps: tuple[RunStep, ...]
    first: int = 0

    @property
    def duration_s(self) -> float:
        """From the first to the last epoch, s."""
        return (self.steps[-1].t_ns - self.steps[0].t_ns) * 1e-9

    @property
    def period_s(self) -> float:
        """Mean time between epochs, s."""
        return self.duration_s / max(len(self.steps) - 1, 1) or 1.0

    @property
    def n(self) -> int:
        """Number of navigation states."""
        return len(self.layout)

    def system(self) -> LinearSystem:
        """The same as dense matrices with all states, for the analyses of any linear system."""
        names = Layout((*self.layout.names, *self.error_names))
        steps = []
        for s in self.steps:
            n, k = self.n, len(s.phi)
            Phi, Q = np.zeros((n + k, n + k)), np.zeros((n + k, n + k))
            Phi[:n, :n], Q[:n, :n] = s.Phi, s.Q
            Phi[range(n, n + k), range(n, n + k)] = s.phi
            Q[range(n, n + k), range(n, n + k)] = 1.0 - s.phi**2
            steps.append(Step(Phi, Q, np.concatenate([s.H, s.E], axis=1), s.r))
        return LinearSystem(names, tuple(steps), self.period_s)

    def prior_of_all(self) -> F8:
        """Covariance of all states before the first epoch."""
        n, k = self.n, len(self.error_names)
        P = np.eye(n + k)
        P[:n, :n] = self.prior
        return P

    def navigation(self) -> LinearSystem:
        """The navigation states alone, lasting errors as white noise: for what does not depend on their memory."""
        steps = [Step(s.Phi, s.Q, s.H, s.r + (s.E**2).sum(axis=1)) for s in self.steps]
        return LinearSystem(self.layout, tuple(steps), self.period_s)


@dataclass(frozen=True)
class Belief:
    """What a filter knows after the measurements of an epoch, and its error dynamics.

    Attributes
    ----------
    P : (n, n) float64
        Covariance of all states.
    Psi : (n, n) float64
        (I - K H) Phi.
    """

    P: F8
    Psi: F8


def filtered(window: RunWindow, *, widened: bool = True, dynamics: bool = False) -> Iterator[Belief]:
    """Covariances of all states after every epoch of a window, as the filter of the run has them.

    Parameters
    ----------
    window : RunWindow
    widened : bool
        With the variance that robust weights added; without it this is the Cramer-Rao bound of the model.
    dynamics : bool
        Also Psi of every epoch (else it is empty).
    """
    n, P = window.n, window.prior_of_all()
    for s in window.steps:
        P[:n] = s.Phi @ P[:n]
        P[:, :n] = P[:, :n] @ s.Phi.T
        P[n:] *= s.phi[:, None]
        P[:, n:] *= s.phi
        P[:n, :n] += s.Q
        P[range(n, len(P)), range(n, len(P))] += 1.0 - s.phi**2
        A = None
        if len(s.r):
            H = np.concatenate([s.H, s.E], axis=1)
            W = H @ P
            S = W @ H.T
            S[range(len(S)), range(len(S))] += s.r if widened else s.r - s.widened
            K = np.linalg.solve(S, W).T
            P = P - K @ W
            P = 0.5 * (P + P.T)
            A = K @ H if dynamics else None
        Psi = np.empty((0, 0))
        if dynamics:
            Psi = np.eye(len(P)) if A is None else np.eye(len(P)) - A
            Psi[:, :n] = Psi[:, :n] @ s.Phi
            Psi[:, n:] = Psi[:, n:] * s.phi
        yield Belief(P, Psi)
        P = P.copy()


def whitened(window: RunWindow) -> F8:
    """Observability matrix of the navigation states at the window's beginning, (sum of m, n), in units of the noise.

    Rows are H_k Phi_k .. Phi_1 less what the errors before and beside them say of their error: the innovations of the
    filter of e alone, to which the rows are data, one column each, divided by their root covariance. Without lasting
    errors the rows of `starwise.analysis.observability.observability_matrix`. Process noise of x is left out, as in the
    definition of the Gramian.
    """
    n, ne = window.n, len(window.error_names)
    M, P, X = np.eye(n), np.eye(ne), np.zeros((ne, n))
    blocks = []
    for s in window.steps:
        M = s.Phi @ M
        P = P * np.outer(s.phi, s.phi)
        P[range(ne), range(ne)] += 1.0 - s.phi**2
        X = s.phi[:, None] * X
        if not len(s.r):
            continue
        data = s.H @ M - s.E @ X
        if not s.E.any():
            blocks.append(data / np.sqrt(s.r)[:, None])
            continue
        W = s.E @ P
        S = W @ s.E.T
        S[range(len(S)), range(len(S))] += s.r
        L = np.linalg.cholesky(S)
        white = np.linalg.solve(L, np.concatenate([data, W], axis=1))
        blocks.append(white[:, :n])
        X = X + white[:, n:].T @ white[:, :n]
        P = P - white[:, n:].T @ white[:, n:]
    return np.concatenate(blocks) if blocks else np.zeros((0, n))


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
        if "inertial" in given:
            raise StarwiseError(
                "an inertial run: its system is that of its 15 states", wanted="starwise.analysis.run_ins"
            )
        config, notes = config_of(solution)
        precise = any(item.get("kind") == "orbits" for item in solution.provenance.get("inputs", ()))
        table = run_table(solution, config, precise)
        return cls(solution, config, motion_from(config), clocks_from(config), table, notes)

    @property
    def memoryless(self) -> bool:
        """Every epoch was solved by itself: no filter."""
        return self.config.method == "lsq"

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
        table = self.table
        last = min(first + count, len(table.t_ns))
        rows = np.arange(table.offsets[first], table.offsets[last])
        rows = rows[(table.used[rows].any(axis=1)) & (table.clock[rows] >= 0)]
        return self.build(first, last, rows, table.used[rows])

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
        epoch = table.epoch[rows]
        cut = np.searchsorted(epoch, np.arange(first, last + 1))
        steps, t_before, made = [], int(table.t_ns[first]), {}
        for k, e in enumerate(range(first, last)):
            dt = (int(table.t_ns[e]) - t_before) * 1e-9
            t_before = int(table.t_ns[e])
            if dt not in made:
                made[dt] = matrices(self.motion, self.clocks, len(letters), dt, UP)
            part = slice(cut[k], cut[k + 1])
            steps.append(
                self._step(e, rows[part], use[part], column, slot, len(letters), n_e, made[dt], phis[k], len(names))
            )
        error_states = error_names(errors, table.bias_names, satellites.tolist()) if errors.on else ()
        return RunWindow(names, error_states, self.prior(len(letters)), tuple(steps), first)

    def names(self, letters: list[str]) -> Layout:
        """Navigation states with the clocks of some systems."""
        local = dict(zip("xyz", "enu", strict=True))
        motion = [f"{name[:-1]}{local[name[-1]]}" for name in self.motion.names]
        return Layout((*motion, *(f"clk.{s}" for s in letters), *(f"drift.{s}" for s in letters)))

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
        return P

    def _step(
        self, e: int, rows: NDArray[np.intp], use: NDArray[np.bool_], column: I8, slot: I8, nc: int, n_e: int,
        motion: tuple[F8, F8], phi: F8, n: int,
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
        H[line[~rate], nk + clock[~rate]] = 1.0
        H[line[rate], nk + nc + clock[rate]] = 1.0
        H[line[~rate], :3] = -table.direction[at[~rate]]
        if nk > 3:
            H[line[rate], 3:6] = -table.direction[at[rate]]
        if n_e:
            code = line[~rate]
            where, b = at[code], kind[code]
            count, idx, val = table.count[where, b], table.idx[where, b], table.val[where, b]
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
    given.pop("inertial", None)
    config = RunConfig.from_dict({key: value for key, value in given.items() if value is not None})
    used = solution.provenance.get("dynamics", {}).get("used")
    if used:
        config = config.with_options({"dynamics": used})
    notes = []
    if config.method == "federated":
        notes.append("federated: the system is that of the central filter with the same measurements")
    if getattr(config, "adaptation", "none") != "none":
        notes.append(f"adaptation {config.adaptation}: not followed, the system is that without it")  # type: ignore[attr-defined]
    return config, tuple(notes)
