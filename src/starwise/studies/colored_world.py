"""Worlds that are exactly the coloured error model, or exactly white, on a sky of the simulator.

In the first the mean NEES of the position over independent runs must lie inside its chi-square interval; in the
second the coloured filter, which is wrong there, must not lose much against a white filter with the right variance.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal

import numpy as np

from starwise.config import RunConfig
from starwise.constants import ROW_USED
from starwise.estimators.filter import filter_rows
from starwise.kernels.error_states import ErrorModel, ErrorRows
from starwise.kernels.rangemodel import Epochs, ModelOptions, RowModel, Rows, epoch_corrections, range_los, range_rate
from starwise.kernels.spp import EpochOut
from starwise.models.error_model import error_model, slow_sigma
from starwise.models.process import clocks_from, matrices, motion_from
from starwise.models.pseudorange import EPHEMERIS_SIGMA_M, empty_row_model, model_options
from starwise.signals import FREQUENCY
from starwise.sim.range_errors import draw_range_errors
from starwise.sim.run import Simulator
from starwise.sim.scenario import Scenario
from starwise.studies.scene import ALL_SEEN
from starwise.types import F8, I8, IonosphereModel

BANDS: Final = {0: (1, 2), 1: (4, 6), 2: (1, 5), 3: (2, 6)}
"""Bands of the two signals by system G R E C; GLONASS with its new ones, on one carrier."""
KLOBUCHAR: Final = (1.1176e-8, 1.4901e-8, -5.9605e-8, -1.1921e-7, 1.0445e5, 1.1469e5, -6.5536e4, -4.5875e5)
"""Broadcast coefficients of an ordinary day."""
Kind = Literal["colored", "white"]


@dataclass(frozen=True)
class World:
    """Measurements of one run, what the coloured model needs to know of them, and the true positions."""

    epochs: Epochs
    rows: Rows
    extra: ErrorRows
    errors: ErrorModel
    model: ModelOptions
    n_clocks: int
    pos_e: F8

    def solve(self, config: RunConfig) -> EpochOut:
        """Positions by a filter; ``config.error_model`` white: on the first signal alone."""
        colored = (self.errors, self.extra) if config.error_model == "colored" else None
        return filter_rows(self.epochs, self.rows, self.model, self.n_clocks, config, colored=colored)[0]


class ColoredWorlds:
    """Runs over one sky that differ by their random numbers alone.

    Parameters
    ----------
    config : RunConfig
        ``errors`` and ``dynamics`` are what is true: the sizes of the errors, and the motion. ``combination`` single
        or auto: one signal or two. A static receiver does not move at all.
    constellations : tuple of str
        See `starwise.sim.sections.Sky`.
    duration_s, interval_s : float
    start : str
        First epoch.
    place : (float, float, float)
        Latitude deg, longitude deg, height m.
    mask_deg : float
    white_m : float
        Size of the code errors of a white world.
    """

    def __init__(
        self,
        config: RunConfig,
        constellations: tuple[str, ...] = ("gps", "galileo"),
        duration_s: float = 3600.0,
        interval_s: float = 30.0,
        start: str = "2024-03-30T10:00:00",
        place: tuple[float, float, float] = (47.0, 8.0, 500.0),
        mask_deg: float = 10.0,
        white_m: float = 1.0,
    ) -> None:
        self.config, self.white_m = config, white_m
        self.scenario = Scenario.from_dict(
            {
                "name": "colored world",
                "time": {"start": start, "duration_s": duration_s, "interval_s": interval_s},
                "vehicle": {"start": list(place), "segments": [{"kind": "static"}]},
                "sky": {"constellations": list(constellations)},
                "receiver": {"mask_deg": mask_deg, "phase": False, "clock": {"grade": "perfect"}},
            }
        )

    @property
    def _dual(self) -> bool:
        return self.config.combination != "single"

    @cached_property
    def _rows(self) -> tuple[Epochs, Rows, ErrorRows, ModelOptions, F8]:
        """All that runs have in common: satellites, carriers, C/N0; codes and rates are still empty."""
        truth = Simulator(self.scenario, 0).run(0).truth
        paths = truth.paths
        n, system = len(paths.sv), (paths.sv >> 8).astype(np.int64)
        offsets = np.searchsorted(paths.epoch, np.arange(len(truth.t_ns) + 1)).astype(np.int64)
        present, clock = np.unique(system, return_inverse=True)
        carrier = np.array([[FREQUENCY[k, band] for band in BANDS[int(k)]] for k in present])
        cn0 = 36.0 + 14.0 * np.sin(paths.elevation)
        nan, p = np.full(n, np.nan), self.config.errors
        rows = Rows(
            sat_pos=np.ascontiguousarray(paths.sat_pos_e),
            sat_vel=np.ascontiguousarray(paths.sat_vel_e),
            clock_m=np.zeros(n),
            drift_mps=np.zeros(n),
            code_m=nan.copy(),
            rate_mps=nan.copy(),
            cn0_dbhz=cn0,
            freq_hz=carrier[clock, 0],
            sigma_sat_m=np.zeros(n),
            noise_factor=np.ones(n),
            system=system,
            clock=clock.astype(np.int64),
            status=np.full(n, ROW_USED, dtype=np.uint8),
        )
        nominal = EPHEMERIS_SIGMA_M[system]
        extra = ErrorRows(
            sv=paths.sv.astype(np.int64),
            slow_m=slow_sigma(p, paths.sv, nominal, nominal),
            bias1=np.full(n, -1, dtype=np.int64),
            bias2=clock.astype(np.int64) if self._dual else np.full(n, -1, dtype=np.int64),
            code2_m=nan.copy(),
            clock2_m=np.zeros(n),
            freq2_hz=carrier[clock, 1],
            cn02_dbhz=cn0 - 2.0,
            v2=nan.copy(),
            s2=nan.copy(),
            used=np.zeros(n, dtype=np.uint8),
        )
        options = model_options(self.config, IonosphereModel(klobuchar={"G": np.array(KLOBUCHAR)}))[0]
        return Epochs(truth.t_ns, offsets), rows, extra, options._replace(mask_rad=ALL_SEEN), truth.pos_e[0]

    def run(self, number: int, kind: Kind = "colored") -> World:
        """World ``number``, from 0; its random numbers depend on the number alone."""
        epochs, rows, extra, model, home = self._rows
        rng = np.random.default_rng([2024, number])
        n_clocks, dual = int(rows.clock.max()) + 1, self._dual
        interval_s = self.scenario.time.interval_s
        errors = error_model(self.config.errors, dual, n_clocks if dual else 0, interval_s)
        states = self._motion(epochs.t_ns, home, n_clocks, rng)
        pos, vel, clock = states[:, :3], states[:, 3:6], states[:, 9:]
        e = np.repeat(np.arange(len(epochs.t_ns)), np.diff(epochs.offsets))
        out = empty_row_model(len(e))
        code, rate = np.empty(len(e)), np.empty(len(e))
        for k, t in enumerate(epochs.t_ns):
            a, b = epochs.offsets[k], epochs.offsets[k + 1]
            epoch_corrections(model, t, rows, a, b, pos[k, 0], pos[k, 1], pos[k, 2], True, out)
            (x, y, _), (vx, vy, vz) = pos[k], vel[k]
            for i in range(a, b):
                rho, sagnac, ux, uy, uz = range_los(*pos[k], *rows.sat_pos[i])
                code[i] = rho + sagnac
                rate[i] = range_rate(x, y, vx, vy, vz, ux, uy, uz, rows.sat_pos, rows.sat_vel, i)
        code += clock[e, rows.clock] + out.troposphere
        rate += clock[e, n_clocks + rows.clock]
        squeeze = (rows.freq_hz / extra.freq2_hz) ** 2
        code1, code2 = code + out.ionosphere, code + out.ionosphere * squeeze
        if kind == "white":
            model = model._replace(fixed_code_sigma_m=self.white_m, fixed_rate_sigma_mps=model.rate_sigma)
            error1, error2 = self.white_m * rng.standard_normal((2, len(e)))
            rate += model.rate_sigma * rng.standard_normal(len(e))
        else:
            speed = np.linalg.norm(vel, axis=1)
            error1, error2 = draw_range_errors(errors, epochs, rows, extra, out, speed, rng)
            rate += self._rate_sigma(out, rows, speed[e], errors) * rng.standard_normal(len(e))
        rows = rows._replace(code_m=code1 + error1, rate_mps=rate)
        extra = extra._replace(code2_m=code2 + error2 if dual else np.full(len(e), np.nan))
        return World(epochs, rows, extra, errors, model, n_clocks, pos)

    def _rate_sigma(self, out: RowModel, rows: Rows, speed: F8, errors: ErrorModel) -> F8:
        """Noise of pseudorange rates, m/s: that of the receiver, and of reflections while it moves."""
        weak = errors.weak_sigma * 10.0 ** ((errors.weak_cn0 - rows.cn0_dbhz) / errors.weak_decade)
        sigma: F8 = np.sqrt(out.rate_var + speed**2 * (errors.rate_motion**2 + (errors.rate_weak * weak) ** 2))
        return sigma

    def _motion(self, t_ns: I8, home: F8, n_clocks: int, rng: np.random.Generator) -> F8:
        """Position, velocity, acceleration, clocks and drifts of every epoch, (m, 9 + 2 n_clocks)."""
        motion, clocks = motion_from(self.config), clocks_from(self.config)
        x = np.zeros((len(t_ns), 9 + 2 * n_clocks))
        up = home / np.linalg.norm(home)
        x[0, :3] = home
        x[0, 9 : 9 + n_clocks] = 1e4 + 30.0 * rng.standard_normal(n_clocks)
        x[0, 9 + n_clocks :] = 30.0 + clocks.intersystem_drift_sigma0 * rng.standard_normal(n_clocks)
        nk = motion.nk
        if nk > 3:
            east = np.cross([0.0, 0.0, 1.0], up)
            x[0, 3:6] = 10.0 * east / np.linalg.norm(east)
        at = np.r_[0:nk, 9 : 9 + 2 * n_clocks]
        for k, dt in enumerate(np.diff(t_ns) * 1e-9):
            Phi, Q = matrices(motion, clocks, n_clocks, float(dt), up)
            if nk == 3:
                Q[:3] = 0.0  # at rest
            values, vectors = np.linalg.eigh(Q)
            noise = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(Q)))
            x[k + 1, at] = Phi @ x[k, at] + noise
        return x


def nees(ep: EpochOut, pos_e: F8) -> F8:
    """Normalised error squared of the position, 3 degrees of freedom, per epoch; NaN without a position."""
    error = ep.pos - pos_e
    solved = np.isfinite(error[:, 0])
    out = np.full(len(error), np.nan)
    out[solved] = np.einsum(
        "ni,ni->n", error[solved], np.linalg.solve(ep.cov_pos[solved], error[solved, :, None])[..., 0]
    )
    return out
