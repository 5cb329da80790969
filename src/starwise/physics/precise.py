"""Precise ephemerides: orbits of SP3 files, clocks of SP3 or RINEX clock files, as an `Ephemeris`."""

import numpy as np
from numpy.typing import NDArray

from starwise.constants import OMEGA_E_GPS, SYSTEMS
from starwise.errors import StarwiseError
from starwise.gnsstime import iso
from starwise.kernels.lagrange import Nodes, precise_states
from starwise.physics.broadcast import BroadcastEphemeris, empty_states
from starwise.physics.group_delay import PRECISE_CLOCK
from starwise.signals import frequency_table, signal_id
from starwise.types import F8, I2, I4, I8, PreciseClocks, PreciseOrbits, SatStates

FLOOR_SIGMA_M = 0.5
"""1-sigma range error of what is not applied, m: the satellite antenna's phase centre, see `PreciseEphemeris`."""


class PreciseEphemeris:
    r"""Satellite states by tabulated orbits and clocks, ECEF (the product's ITRF) and GPST.

    Orbits: polynomial of degree 10 through the 11 nearest nodes, in axes that do not rotate with the Earth; velocity
    is its derivative. Clocks: straight lines; within the span of ``clocks``, if given, from there and nowhere else,
    so that two products with different time references never meet in an epoch. Nothing is extrapolated beyond one
    interval of the table, holes of more than three intervals are not bridged. The law: at a node the position is
    the node's.

    Positions are **centres of mass**. The offset of the antenna's phase centre, which the clocks of the products take
    for granted, is not applied (it needs the ANTEX file of the product): 0.6 to 2.7 m towards the Earth, mostly
    common to a system and so absorbed by its clock; between blocks of a system it differs by up to 1 m.
    `FLOOR_SIGMA_M` stands for that in ``sigma_m``.

    Parameters
    ----------
    orbits : PreciseOrbits
    clocks : PreciseClocks, optional
        Clocks in place of those of ``orbits``, for the time that they cover.
    broadcast : BroadcastEphemeris, optional
        Source of group delays (and of GLONASS channels): without it only the pair of signals that the clocks belong
        to is free of unknown delays.

    Attributes
    ----------
    notes : tuple of str
        What a user of these products should know, for people.

    Raises
    ------
    StarwiseError
        The table has fewer than two epochs.

    References
    ----------
    S. Hilla, "The extended standard product 3 orbit format (SP3-d)" (2016); J. Ray, W. Gurtner, "RINEX extensions to
    handle clock information" 3.04; H. Yousif, A. El-Rabbany, GPS Solutions 11 (2007) for the interpolation.
    """

    def __init__(
        self,
        orbits: PreciseOrbits,
        clocks: PreciseClocks | None = None,
        broadcast: BroadcastEphemeris | None = None,
    ) -> None:
        if len(orbits.t_ns) < 2:
            raise StarwiseError("precise orbits too short", found=f"{len(orbits.t_ns)} epochs", wanted="2 or more")
        self.broadcast = broadcast
        self.channels: dict[int, int] = dict(broadcast.channels) if broadcast else {}
        self._orbits = _orbit_nodes(orbits)
        self._sp3_clocks = _sp3_clock_nodes(orbits)
        self._clocks = self._sp3_clocks if clocks is None else _clock_nodes(clocks)
        self.notes: tuple[str, ...] = _notes(self._orbits, self._clocks)
        self._frequency = frequency_table(self.channels)

    def states(self, t_rx_ns: I8, sv: I2, code_m: F8, post: bool = False) -> SatStates:
        """Satellite states at transmission, ECEF of that instant; see `starwise.types.Ephemeris.states`.

        ``post`` changes nothing: tables know all times. Group delays, which last for months, come from the nearest
        broadcast record.
        """
        n = len(sv)
        if not len(t_rx_ns) == len(code_m) == n:
            raise ValueError(f"rows do not match: {len(t_rx_ns)} times, {n} satellites, {len(code_m)} codes")
        out = empty_states(n)
        precise_states(
            np.ascontiguousarray(t_rx_ns, dtype=np.int64),
            np.ascontiguousarray(sv, dtype=np.int16),
            np.ascontiguousarray(code_m, dtype=np.float64),
            self._orbits,
            self._clocks,
            self._sp3_clocks,
            FLOOR_SIGMA_M,
            out.pos_e,
            out.vel_e,
            out.clock_s,
            out.drift,
            out.relativity_s,
            out.sigma_m,
            out.t_tx_ns,
            out.age_s,
            out.status,
        )
        if self.broadcast is None:
            out.record[:] = -1
        else:
            out.record[:] = self.broadcast.states(t_rx_ns, sv, code_m, post=True).record
        return out

    def group_delay(self, record: I4, sv: I2, sig: I2, sig2: I2) -> F8:
        """Group delay, m, against the pair of signals that precise clocks belong to (`PRECISE_CLOCK`).

        Broadcast delays where there is a record; else zero for a combination on the bands of that pair, NaN for all
        other signals.
        """
        out = (
            np.full(len(sv), np.nan)
            if self.broadcast is None
            else self.broadcast.group_delay(record, sv, sig, sig2, PRECISE_CLOCK)
        )
        unknown = ~np.isfinite(out)
        if unknown.any():
            out[unknown & _on_reference(sv, sig, sig2)] = 0.0
        return out


def _on_reference(sv: I2, sig: I2, sig2: I2) -> NDArray[np.bool_]:
    """Rows whose combination lies on the bands that the precise clock of their system belongs to."""
    same = np.zeros(len(sv), dtype=bool)
    for letter, (one, two) in PRECISE_CLOCK.items():
        rows = np.asarray(sv) >> 8 == SYSTEMS.index(letter)
        same |= rows & (sig >> 8 == signal_id(one) >> 8) & (sig2 >> 8 == signal_id(two) >> 8)
    return same


def _notes(orbits: Nodes, clocks: Nodes) -> tuple[str, ...]:
    """Remark on a clock file that does not span the orbits."""
    margin = orbits.step_ns
    if clocks.first_ns <= orbits.first_ns + margin and clocks.last_ns >= orbits.last_ns - margin:
        return ()
    span = f"{iso(clocks.first_ns, 0)} to {iso(clocks.last_ns, 0)}"
    return (f"the clock file covers {span} GPST; outside, clocks are those of the orbit file",)


def _step_ns(t_ns: I8) -> int:
    """Nominal interval of a table: the median."""
    return int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 1


def _rows(sv: I2) -> I4:
    row = np.full(len(SYSTEMS) * 256, -1, dtype=np.int32)
    row[np.asarray(sv, dtype=np.int64)] = np.arange(len(sv))
    return row


def _ragged(orbits: PreciseOrbits, value: F8, sigma: F8, t0_ns: int) -> Nodes:
    """Samples of all satellites without the missing ones; ``value`` is (n_sv, n_epochs, m)."""
    have = np.isfinite(value).all(axis=2)
    t_ns = np.broadcast_to(orbits.t_ns, have.shape)
    return Nodes(
        row=_rows(orbits.sv),
        offsets=np.concatenate([[0], np.cumsum(have.sum(axis=1))]).astype(np.int64),
        t_ns=np.ascontiguousarray(t_ns[have], dtype=np.int64),
        value=np.ascontiguousarray(value[have], dtype=np.float64),
        sigma=np.ascontiguousarray(sigma[have], dtype=np.float64),
        step_ns=_step_ns(orbits.t_ns),
        t0_ns=t0_ns,
        first_ns=int(orbits.t_ns[0]),
        last_ns=int(orbits.t_ns[-1]),
    )


def _orbit_nodes(orbits: PreciseOrbits) -> Nodes:
    """Nodes turned to the axes that the Earth had at the first epoch."""
    t0 = int(orbits.t_ns[0])
    angle = OMEGA_E_GPS * ((orbits.t_ns - t0) * 1e-9)
    s, c = np.sin(angle), np.cos(angle)
    x, y, z = np.moveaxis(orbits.pos_e, 2, 0)
    turned = np.stack([c * x - s * y, s * x + c * y, z], axis=2)
    return _ragged(orbits, turned, orbits.pos_sigma_m, t0)


def _sp3_clock_nodes(orbits: PreciseOrbits) -> Nodes:
    return _ragged(orbits, orbits.clock_s[:, :, None], orbits.clock_sigma_s, int(orbits.t_ns[0]))


def _clock_nodes(clocks: PreciseClocks) -> Nodes:
    have = np.isfinite(clocks.clock_s)
    counts = np.add.reduceat(have, clocks.offsets[:-1]) if len(clocks.sv) else np.zeros(0)
    counts = np.where(np.diff(clocks.offsets) > 0, counts, 0)
    steps = np.diff(clocks.t_ns)
    steps = steps[steps > 0]
    return Nodes(
        row=_rows(clocks.sv),
        offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        t_ns=np.ascontiguousarray(clocks.t_ns[have], dtype=np.int64),
        value=np.ascontiguousarray(clocks.clock_s[have][:, None], dtype=np.float64),
        sigma=np.ascontiguousarray(clocks.sigma_s[have], dtype=np.float64),
        step_ns=int(np.median(steps)) if len(steps) else 1,
        t0_ns=0,
        first_ns=int(clocks.t_ns.min()) if len(clocks.t_ns) else 0,
        last_ns=int(clocks.t_ns.max()) if len(clocks.t_ns) else 0,
    )
