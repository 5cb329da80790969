"""The simulated receiver: what it measures of the true sky, with every error as its own term.

Each error source has its own random stream per satellite and signal, drawn for every epoch whether received or not:
turning a source off, or masking a satellite, changes no other number.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import C_LIGHT, NS, SYS_C, SYSTEMS
from starwise.errors import StarwiseError
from starwise.kernels.sim_orbits import Paths, directions, paths
from starwise.kernels.sim_receiver import markov
from starwise.signals import frequency_table, signal_id, signal_name, sv_name
from starwise.sim.atmosphere import atmosphere
from starwise.sim.faults import check_faults, clock_jumps_s, fault_terms, outages
from starwise.sim.sections import Fault, Noise, Receiver
from starwise.sim.seeds import Streams
from starwise.sim.sky import TrueSky
from starwise.sim.truth import PathTruth, RowTruth, SimTruth
from starwise.types import F8, I2, I8, U1, ObservationHeader, Observations

F_L1: Final = 1575.42e6
MIN_SIN_EL: Final = 0.05
PHASE_MULTIPATH: Final = 0.01
"""Multipath on the phase over that on the code: millimetres for decimetres (a quarter wavelength is the bound)."""


@dataclass(frozen=True)
class Motion:
    """The antenna and its clock at the epochs of a run.

    Attributes
    ----------
    t_ns : (n,) int64
        Receiver time tags, GPST ns.
    clock_s, drift : (n,) float64
        Receiver clock: received at ``t - clock``; its rate, s/s.
    steered_s : (n,) float64
        Part of ``clock_s`` that the carrier phase does not follow.
    pos_e, vel_e : (n, 3) float64
        Antenna at the true time of reception, ECEF, m, m/s.
    acc_e, euler : (n, 3) float64
        Body, for the truth only.
    """

    t_ns: I8
    clock_s: F8
    drift: F8
    steered_s: F8
    pos_e: F8
    vel_e: F8
    acc_e: F8
    euler: F8

    @classmethod
    def at_rest(cls, t_ns: I8, pos_e: F8) -> "Motion":
        """A fixed antenna with a perfect clock."""
        n = len(t_ns)
        zero, zeros = np.zeros(n), np.zeros((n, 3))
        return cls(t_ns, zero, zero, zero, np.tile(np.asarray(pos_e, dtype=np.float64), (n, 1)), zeros, zeros, zeros)


def receive(
    receiver: Receiver,
    faults: Sequence[Fault],
    sky: TrueSky,
    motion: Motion,
    streams: Streams,
    marker: str = "SIMU",
    seen: NDArray[np.bool_] | None = None,
) -> tuple[Observations, SimTruth]:
    """Observations of a run, and the truth behind them.

    Parameters
    ----------
    receiver : Receiver
        Section of the scenario.
    faults : sequence of Fault
    sky : TrueSky
    motion : Motion
        Without the clock jumps of ``faults``, which are added here.
    streams : Streams
    marker : str
        Name of the station in the header.
    seen : (n_epochs, n_satellites) bool, optional
        From `in_view`, where many runs share it.

    Raises
    ------
    StarwiseError
        Nothing is received at all; a fault names what is not there.
    """
    since = (motion.t_ns - motion.t_ns[0]) / NS
    jumps = clock_jumps_s(faults, since)
    clock = motion.clock_s + jumps
    if seen is None:
        seen = in_view(receiver, sky, motion.t_ns, motion.pos_e)
    epoch, index = (axis.astype(np.int64) for axis in np.nonzero(seen))
    kept = ~outages(faults, since[epoch], sky.sv[index])
    if not kept.any():
        raise StarwiseError("no satellite is received at any time: an outage covers them all")
    epoch, index = epoch[kept], index[kept]
    sv = sky.sv[index]
    geometry = _empty_paths(len(index))
    paths(sky.table, index, epoch, motion.t_ns, clock, motion.drift, motion.pos_e, motion.vel_e, geometry)
    klobuchar = next(iter(sky.records.ionosphere.klobuchar.values()), np.zeros(8))
    air = atmosphere(receiver, klobuchar, streams, motion.t_ns, motion.pos_e, motion.vel_e, sv, epoch, geometry)

    path, sig = _rows(receiver, sv)
    lost = outages(faults, since[epoch[path]], sv[path], sig)
    path, sig = path[~lost], sig[~lost]
    check_faults(faults, sky.sv, sig, float(since[-1]))
    rows = _measure(receiver, faults, sky, streams, since, epoch, sv, index, geometry, air, path, sig)
    obs = _observations(receiver, sky, motion, epoch, sv, geometry, air, rows, path, sig, marker)
    truth = SimTruth(
        t_ns=motion.t_ns,
        clock_s=clock,
        drift=motion.drift,
        steered_s=motion.steered_s,
        pos_e=motion.pos_e,
        vel_e=motion.vel_e,
        acc_e=motion.acc_e,
        euler=motion.euler,
        paths=_path_truth(epoch, sv, geometry, air),
        rows=rows.truth,
        visible=np.bincount(epoch, minlength=len(motion.t_ns)).astype(np.int32),
    )
    return obs, truth


# -- which satellites -----------------------------------------------------------------------------------------------
def in_view(receiver: Receiver, sky: TrueSky, t_ns: I8, pos_e: F8) -> NDArray[np.bool_]:
    """Satellites above the masks that send a signal asked for, (n_epochs, n_satellites).

    Raises
    ------
    StarwiseError
        There is none at any time.
    """
    n, m = len(t_ns), len(sky.sv)
    elevation, azimuth = np.empty((n, m)), np.empty((n, m))
    directions(sky.table, t_ns, pos_e, elevation, azimuth)
    seen = elevation >= math.radians(receiver.mask_deg)
    for start, end, mask in receiver.azimuth_masks_deg:
        width = (end - start) % 360.0 if end != start else 360.0
        inside = (np.degrees(azimuth) - start) % 360.0 <= width
        seen &= ~(inside & (elevation < math.radians(mask)))
    seen &= np.array([len(_signals(receiver, int(s))) > 0 for s in sky.sv])[None, :]
    if not seen.any():
        raise StarwiseError(
            "no satellite is visible at any time",
            found=f"{m} in the sky, highest at {np.degrees(elevation.max()):.1f} deg",
            wanted="a mask, a place and signals that let one be received",
        )
    return np.asarray(seen)


def _signals(receiver: Receiver, sv: int) -> tuple[str, ...]:
    """Signals received of a satellite: those asked for that it sends (BeiDou-2 and BeiDou-3 differ)."""
    names = receiver.signals.get(SYSTEMS[sv >> 8], ())
    if sv >> 8 != SYS_C:
        return names
    if sv & 255 <= 18:  # BDS-SIS-ICD-2.1: B1I, B2I, B3I
        return tuple(s for s in names if s[0] in "26" or (s[0] == "7" and s[1] in "IQX"))
    return tuple(s for s in names if not (s[0] == "7" and s[1] in "IQX"))  # B2b is 7D, 7P, 7Z


def _rows(receiver: Receiver, sv: I2) -> tuple[I8, I2]:
    """Path and signal of every observation, by path and order of signals."""
    names = {int(s): [signal_id(name) for name in _signals(receiver, int(s))] for s in np.unique(sv)}
    most = max(len(ids) for ids in names.values())
    table = np.zeros((1 << 15, most), dtype=np.int16)
    for one, ids in names.items():
        table[one, : len(ids)] = ids
    wide = table[sv]
    path, column = np.nonzero(wide)
    return path.astype(np.int64), wide[path, column]


# -- measurements -----------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Measured:
    truth: RowTruth
    cn0_dbhz: F8
    wavelength_m: F8
    lli: U1


@dataclass(frozen=True)
class _Groups:
    """Rows of each (satellite, signal), in order of time, and the random numbers that belong to them."""

    order: I8
    bounds: I8
    names: tuple[str, ...]
    epoch: I8
    n_epochs: int
    streams: Streams

    def white(self, source: str) -> F8:
        """Unit white noise of a source, row-aligned."""
        return self.each(source, lambda rng: rng.standard_normal(self.n_epochs))

    def each(self, source: str, make: Callable[[np.random.Generator], F8]) -> F8:
        """Numbers of a source: ``make`` gives one for every epoch of a (satellite, signal)."""
        out = np.empty(len(self.order))
        for name, a, b in zip(self.names, self.bounds[:-1], self.bounds[1:], strict=True):
            rows = self.order[a:b]
            out[rows] = make(self.streams(f"{source}/{name}"))[self.epoch[rows]]
        return out


def _groups(sv: I2, sig: I2, epoch: I8, n_epochs: int, streams: Streams) -> _Groups:
    key = sv.astype(np.int64) << 16 | sig.astype(np.int64)
    order = np.argsort(key, kind="stable")
    _, first = np.unique(key[order], return_index=True)
    bounds = np.append(first, len(key)).astype(np.int64)
    names = tuple(f"{sv_name(int(sv[r]))}/{signal_name(int(sig[r]))}" for r in order[first])
    return _Groups(order.astype(np.int64), bounds, names, epoch, n_epochs, streams)


def _measure(
    receiver: Receiver, faults: Sequence[Fault], sky: TrueSky, streams: Streams, since: F8, epoch: I8, sv: I2,
    index: I8, p: Paths, air: F8, path: I8, sig: I2,
) -> _Measured:  # fmt: skip
    """All terms of all rows."""
    row_sv, row_epoch = sv[path], epoch[path]
    band = sig >> 8
    carrier = frequency_table(sky.channels)[row_sv >> 8, row_sv & 255, band]
    wavelength = C_LIGHT / carrier
    squared = (F_L1 / carrier) ** 2
    g = _groups(row_sv, sig, row_epoch, len(since), streams)
    fault = fault_terms(faults, since[row_epoch], row_sv, sig, wavelength)
    sin_el = np.maximum(np.sin(p.elevation[path]), MIN_SIN_EL)
    cn0 = _cn0(receiver.noise, sin_el, g) + fault.cn0_db
    factor = _noise_factor(receiver.noise, sin_el, cn0)

    multipath = np.zeros(len(path))
    if receiver.multipath.sigma_m > 0.0:
        rho = np.exp(-np.diff(since, prepend=0.0) / receiver.multipath.tau_s)

        def correlated(rng: np.random.Generator) -> F8:
            out = np.empty(len(since))
            markov(rng.standard_normal(len(since)), rho, out)
            return out

        multipath = receiver.multipath.sigma_m / sin_el * g.each("multipath", correlated)

    def noise(source: str, sigma: float) -> F8:
        return factor * sigma * g.white(source) if sigma > 0.0 else np.zeros(len(path))

    def bursts(source: str, sigma: F8) -> F8:
        return sigma * g.white(f"burst/{source}") if sigma.any() else np.zeros(len(path))

    arc, lli = _arcs(g, row_epoch)
    ambiguity = _ambiguities(g, arc) if receiver.phase else np.full(len(path), np.nan)
    truth = RowTruth(
        path=path,
        ionosphere_m=squared * air[path, 0],
        group_delay_m=C_LIGHT * sky.delay_s[index[path], band],
        intersystem_m=_intersystem(receiver, row_sv),
        multipath_m=multipath,
        phase_multipath_m=PHASE_MULTIPATH * multipath,
        code_noise_m=noise("code", receiver.noise.code_m),
        phase_noise_m=noise("phase", receiver.noise.phase_m),
        rate_noise_mps=noise("rate", receiver.noise.rate_mps),
        code_fault_m=fault.code_m + bursts("code", fault.code_sigma_m),
        phase_fault_m=fault.phase_m + bursts("phase", fault.phase_sigma_m),
        rate_fault_mps=fault.rate_mps + bursts("rate", fault.rate_sigma_mps),
        rate_mps=p.rate_mps[path] + air[path, 3] - squared * air[path, 1],
        ambiguity_cyc=ambiguity,
    )
    return _Measured(truth, cn0, wavelength, lli | fault.slip.astype(np.uint8))


def _cn0(noise: Noise, sin_el: F8, g: _Groups) -> F8:
    """C/N0, dB-Hz: from horizon to zenith with the sine of the elevation, and noise."""
    level = noise.cn0_horizon_dbhz + (noise.cn0_zenith_dbhz - noise.cn0_horizon_dbhz) * sin_el
    if noise.cn0_sigma_db > 0.0:
        level = level + noise.cn0_sigma_db * g.white("cn0")
    return np.maximum(level, 1.0)


def _noise_factor(noise: Noise, sin_el: F8, cn0: F8) -> F8:
    if noise.model == "elevation":
        return 1.0 / sin_el
    if noise.model == "cn0":
        return np.asarray(10.0 ** ((45.0 - cn0) / 20.0))
    return np.ones(len(sin_el))


def _intersystem(receiver: Receiver, sv: I2) -> F8:
    by_system = np.zeros(len(SYSTEMS))
    for letter, value in receiver.clock.intersystem_m.items():
        by_system[SYSTEMS.index(letter)] = value
    return np.asarray(by_system[sv >> 8])


def _arcs(g: _Groups, epoch: I8) -> tuple[I8, U1]:
    """Number of the arc (from 0) of every row within its signal, and LLI at the start of all but the first epoch's."""
    arc = np.zeros(len(epoch), dtype=np.int64)
    lli = np.zeros(len(epoch), dtype=np.uint8)
    for a, b in zip(g.bounds[:-1], g.bounds[1:], strict=True):
        rows = g.order[a:b]
        breaks = np.diff(epoch[rows], prepend=epoch[rows[0]] - 1) > 1
        arc[rows] = np.cumsum(breaks)
        lli[rows] = breaks
        lli[rows[0]] = epoch[rows[0]] > 0
    return arc, lli


def _ambiguities(g: _Groups, arc: I8) -> F8:
    """Whole cycles, new for every arc; streams ``ambiguity/<satellite>/<signal>``."""
    out = np.empty(len(arc))
    for name, a, b in zip(g.names, g.bounds[:-1], g.bounds[1:], strict=True):
        rows = g.order[a:b]
        drawn = g.streams(f"ambiguity/{name}").integers(-1_000_000, 1_000_000, int(arc[rows].max()) + 1)
        out[rows] = drawn[arc[rows]]
    return out


# -- nouns ------------------------------------------------------------------------------------------------------------
def _observations(
    receiver: Receiver, sky: TrueSky, motion: Motion, epoch: I8, sv: I2, p: Paths, air: F8, rows: _Measured,
    path: I8, sig: I2, marker: str,
) -> Observations:  # fmt: skip
    t = rows.truth
    code = (
        p.code_m[path] + t.ionosphere_m + air[path, 2] + t.group_delay_m + t.intersystem_m + t.multipath_m
        + t.code_noise_m + t.code_fault_m
    )  # fmt: skip
    n, blank = len(path), np.full(len(path), np.nan)
    phase, doppler = blank, blank
    if receiver.phase:
        metres = (
            p.code_m[path] - C_LIGHT * motion.steered_s[epoch[path]] - t.ionosphere_m + air[path, 2]
            + t.phase_multipath_m + t.phase_noise_m + t.phase_fault_m
        )  # fmt: skip
        phase = metres / rows.wavelength_m + t.ambiguity_cyc
    if receiver.doppler:
        doppler = -(t.rate_mps + t.rate_noise_mps + t.rate_fault_mps) / rows.wavelength_m
    counts = np.bincount(epoch[path], minlength=len(motion.t_ns))
    systems = {SYSTEMS[int(s) >> 8] for s in np.unique(sv)}
    kinds = "C" + "L" * receiver.phase + "D" * receiver.doppler + "S"
    step = np.diff(motion.t_ns)
    header = ObservationHeader(
        version="3.05",
        marker=marker,
        receiver="STARWISE SIMULATOR",
        antenna="ISOTROPIC",
        approx_pos_e=(float(motion.pos_e[0, 0]), float(motion.pos_e[0, 1]), float(motion.pos_e[0, 2])),
        interval_s=float(step[0]) / NS if len(step) else None,
        signals={
            letter: tuple(kind + name for name in receiver.signals[letter] for kind in kinds)
            for letter in SYSTEMS
            if letter in systems
        },
    )
    return Observations(
        t_ns=motion.t_ns,
        offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        flag=np.zeros(len(motion.t_ns), dtype=np.uint8),
        clock_offset_s=np.full(len(motion.t_ns), np.nan),
        sv=sv[path],
        sig=sig,
        code_m=code,
        phase_cyc=phase,
        doppler_hz=doppler,
        cn0_dbhz=rows.cn0_dbhz,
        lli=rows.lli if receiver.phase else np.zeros(n, dtype=np.uint8),
        channels={one: sky.channels[one] for one in np.unique(sv).tolist() if one in sky.channels},
        header=header,
    )


def _path_truth(epoch: I8, sv: I2, p: Paths, air: F8) -> PathTruth:
    return PathTruth(
        epoch, sv, p.sat_pos, p.sat_vel, p.sat_clock, p.sat_drift, p.range_m, p.range_rate, p.elevation, p.azimuth,
        air[:, 0], air[:, 2],
    )  # fmt: skip


def _empty_paths(n: int) -> Paths:
    def column(*shape: int) -> NDArray[np.float64]:
        return np.empty((n, *shape))

    return Paths(
        sat_pos=column(3), sat_vel=column(3), sat_clock=column(), sat_drift=column(), range_m=column(),
        range_rate=column(), code_m=column(), rate_mps=column(), elevation=column(), azimuth=column(),
    )  # fmt: skip
