"""Broadcast ephemerides: which record counts when, and where the satellites are by it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    K_A_DOT,
    K_DELTA_N_DOT,
    K_E,
    K_SQRT_A,
    K_TOE_SOW,
    MESSAGE_NAMES,
    MSG_CNAV,
    MSG_CNV2,
    MSG_FNAV,
    MSG_INAV,
    MSG_LNAV,
    NS,
    R_AX,
    R_CHANNEL,
    R_X,
    SAT_INACCURATE,
    SAT_OK,
    SAT_UNHEALTHY,
    SYS_C,
    SYS_E,
    SYS_G,
    SYS_I,
    SYS_J,
    SYS_R,
    SYS_S,
    SYSTEMS,
)
from starwise.errors import StarwiseError
from starwise.kernels.glonass import N_NODES
from starwise.kernels.orbits import N_RANKS, Table, broadcast_states
from starwise.physics.group_delay import delay_table, group_delay, reference_table
from starwise.physics.slots import misfiled
from starwise.signals import frequency_table, sv_name
from starwise.types import F8, I2, I4, I8, BroadcastRecords, SatStates

Ranks = Mapping[str, Sequence[Sequence[str]]]

DEFAULT_MESSAGES: Final[Ranks] = {
    # Messages in order of preference; those in one bracket are equals. The first that has a valid record is used.
    "G": (("LNAV",), ("CNAV",), ("CNV2",)),  # the whole constellation sends LNAV; its TGD is for L1
    "R": (("FDMA",),),
    "E": (("INAV",), ("FNAV",)),  # I/NAV: E1 and E5b; prefer F/NAV for E1 and E5a, see `galileo_first`
    "C": (("D1", "D2"), ("CNV1",), ("CNV2",), ("CNV3",)),  # D1, D2: every satellite, B1I and B3I
    "J": (("LNAV",), ("CNAV",), ("CNV2",)),
    "I": (("LNAV",), ("CNV1",)),
    "S": (("SBAS",),),
}

LIMIT_S: Final[dict[tuple[int, int | None], tuple[float, float, float]]] = {
    # Largest |t - toe| at which a record is used, s; how long before and after toe the fit holds. Between the two the
    # claimed accuracy is widened by `STALE_MPH2`. None: all other messages of the system.
    (SYS_G, None): (7200.0, 7200.0, 7200.0),  # fit of 4 h about toe, longer if flagged (IS-GPS-200N 20.3.3.4.3.1)
    (SYS_G, MSG_CNAV): (5400.0, 5400.0, 5400.0),  # 3 h (IS-GPS-200N 30.3.3.1.1)
    (SYS_G, MSG_CNV2): (5400.0, 5400.0, 5400.0),  # 3 h (IS-GPS-800J 3.5.3)
    (SYS_R, None): (1800.0, 900.0, 900.0),  # +-15 min (ICD L1/L2 5.1, A.3.1.2); twice that for a lost record
    (SYS_E, None): (14400.0, 3600.0, 14400.0),  # 4 h from the start of transmission (Galileo OS SDD 1.3, 2.3.1.1)
    (SYS_C, None): (21600.0, 7200.0, 7200.0),  # hourly, no limit in the ICD; 6 h as RTKLIB
    (SYS_J, None): (7200.0, 7200.0, 7200.0),  # 2 h about toe (IS-QZSS-PNT-005 5.4.1.2), more where flagged
    (SYS_I, None): (7200.0, 7200.0, 7200.0),  # 2 h (IRNSS SPS ICD 1.1, 6.2.1.3)
    (SYS_S, None): (360.0, 360.0, 360.0),  # time-out of message 9 en route (RTCA DO-229E table A-25)
}
_MARGIN_S: Final = 1.0
"""Rounding of labels and the flight time."""

HEALTH_MASK: Final[dict[tuple[int, int | None], int]] = {
    # Bits of the health word that make a satellite unhealthy for positioning; the others concern other signals.
    (SYS_G, None): 0x3F,  # 6 bits: summary and signal code (IS-GPS-200N 20.3.3.3.1.4); any code is a defect
    (SYS_G, MSG_CNAV): 0x6,  # L1, L2, L5 from the high bit (IS-GPS-200N 30.3.3.1.1.2); L5 alone was set for years
    (SYS_R, None): -1,  # Bn and l_n as the reader joined them
    (SYS_E, MSG_INAV): 0x1C7,  # E1-B DVS, HS; E5b DVS, HS (RINEX 3.05 table A8): bits 0, 1-2, 6, 7-8
    (SYS_E, MSG_FNAV): 0x38,  # E5a DVS, HS: bits 3, 4-5
    (SYS_E, None): 0x1FF,
    (SYS_C, None): -1,  # SatH1; HS of CNV1-3
    (SYS_J, MSG_LNAV): 0x30,  # MSB: L1 navigation data; next: L1 C/A. Then L2C, L5, L1C, L1C/B (which C/A excludes)
    (SYS_J, MSG_CNAV): 0x6,
    (SYS_J, None): -1,
    (SYS_I, None): -1,
    (SYS_S, None): -1,
}

UNKNOWN_SIGMA_M: Final = 5.0
"""1-sigma range accuracy of a record that claims none (GLONASS before RINEX 3.05, BDS CNV), m."""
_LAG_MAX_S: Final = 14400.0
"""A record is not known earlier than this before its reference time, whatever its transmission time says."""


def galileo_first(message: str) -> Ranks:
    """`DEFAULT_MESSAGES` with ``INAV`` or ``FNAV`` first for Galileo.

    Raises
    ------
    StarwiseError
        Another message.
    """
    if message not in ("INAV", "FNAV"):
        raise StarwiseError("not a Galileo message", found=message, wanted="INAV or FNAV")
    other = "FNAV" if message == "INAV" else "INAV"
    return {**DEFAULT_MESSAGES, "E": ((message,), (other,))}


@dataclass(frozen=True)
class _Rules:
    """Per record: rank of its message (-1: not wanted), status, limits, time from which it can be known, sigma."""

    rank: NDArray[np.int64]
    status: NDArray[np.int8]
    limit_ns: I8
    before_ns: I8
    after_ns: I8
    avail_ns: I8
    sigma_m: F8


class BroadcastEphemeris:
    r"""Satellite states and group delays by broadcast records, ECEF and GPST.

    A row asks for satellite s at the time its signal left: ``t_tx = t_rx - code / c - clock(t_tx)``. With ``post``
    the record with the nearest reference time answers, wherever it was fitted to that time; without, the one
    transmitted last before ``t_rx``, which is what a receiver had. The law: without ``post`` no state depends
    on a record with ``t_tx_ns > t_rx_ns``.

    The position is that of the antenna phase centre (GPS L1/L2, Galileo, BeiDou B3I ... by each control segment).
    GLONASS is in PZ-90.11, which agrees with ITRF to centimetres.

    Parameters
    ----------
    records : BroadcastRecords
    messages : mapping, optional
        Per system letter, message names in ranks of preference; missing letters keep `DEFAULT_MESSAGES`, an empty
        sequence turns a system off.

    Attributes
    ----------
    notes : tuple of str
        What was found in the records and dealt with, for people.

    Raises
    ------
    StarwiseError
        ``messages`` names a system or message that does not exist.

    References
    ----------
    IS-GPS-200N 20.3.3; Galileo OS SIS ICD 2.1, 5.1; BDS-SIS-ICD-B1I-3.0, 5.2; GLONASS ICD L1/L2 5.1, A.3.1;
    IS-QZSS-PNT-005.
    """

    def __init__(self, records: BroadcastRecords, messages: Ranks | None = None) -> None:
        self.records = records
        self.channels: dict[int, int] = _channels(records)
        stray = misfiled(records)
        self.notes: tuple[str, ...] = ()
        if stray.any():
            slots = " ".join(sv_name(int(s)) for s in np.unique(records.sv[stray]))
            self.notes = (f"{stray.sum()} GLONASS records filed under the wrong slot left out ({slots})",)
        rules = _rules(records, {**DEFAULT_MESSAGES, **(messages or {})}, ~stray)
        self._table = _table(records, rules)
        self._message = np.ascontiguousarray(records.message, dtype=np.int8)
        self._delays = delay_table(records)
        self._frequency = frequency_table(self.channels)
        self._own_clock = reference_table({})

    def states(self, t_rx_ns: I8, sv: I2, code_m: F8, post: bool = False) -> SatStates:
        """Satellite states at transmission, ECEF of that instant; see `starwise.types.Ephemeris.states`.

        A row whose pseudorange is missing or above 1e9 m has NaN in its state and the status of its record.
        """
        n = len(sv)
        out = empty_states(n)
        if not len(t_rx_ns) == len(code_m) == n:
            raise ValueError(f"rows do not match: {len(t_rx_ns)} times, {n} satellites, {len(code_m)} codes")
        broadcast_states(
            np.ascontiguousarray(t_rx_ns, dtype=np.int64),
            np.ascontiguousarray(sv, dtype=np.int16),
            np.ascontiguousarray(code_m, dtype=np.float64),
            bool(post),
            self._table,
            out.pos_e,
            out.vel_e,
            out.clock_s,
            out.drift,
            out.relativity_s,
            out.sigma_m,
            out.t_tx_ns,
            out.age_s,
            out.status,
            out.record,
        )
        return out

    def group_delay(
        self, record: I4, sv: I2, sig: I2, sig2: I2, reference: dict[str, tuple[str, str]] | None = None
    ) -> F8:
        """Group delay, m, of signals or combinations; see `starwise.types.Ephemeris.group_delay`.

        ``reference`` names, by system letter, the pair whose ionosphere-free combination the clock belongs to, where
        it is not the broadcast one (`starwise.physics.group_delay.PRECISE_CLOCK`).
        """
        ref = self._own_clock if reference is None else reference_table(reference)
        return group_delay(self._delays, self._message, self._frequency, ref, record, sv, sig, sig2)


def empty_states(n: int) -> SatStates:
    """`SatStates` of n rows, not filled."""
    return SatStates(
        pos_e=np.empty((n, 3)),
        vel_e=np.empty((n, 3)),
        clock_s=np.empty(n),
        drift=np.empty(n),
        relativity_s=np.empty(n),
        sigma_m=np.empty(n),
        t_tx_ns=np.empty(n, dtype=np.int64),
        age_s=np.empty(n),
        status=np.empty(n, dtype=np.int8),
        record=np.empty(n, dtype=np.int32),
    )


def _channels(records: BroadcastRecords) -> dict[int, int]:
    """GLONASS frequency channel by satellite: that of its last record."""
    rows = np.flatnonzero((records.sv >> 8 == SYS_R) & (np.abs(records.par[:, R_CHANNEL]) <= 13))
    rows = rows[np.argsort(records.toe_ns[rows], kind="stable")]
    return {int(records.sv[i]): round(float(records.par[i, R_CHANNEL])) for i in rows}


def _rank_table(messages: Ranks) -> NDArray[np.int64]:
    """Rank of each message by system, -1 where it is not wanted, (7, number of messages)."""
    table = np.full((len(SYSTEMS), len(MESSAGE_NAMES)), -1, dtype=np.int64)
    for letter, ranks in messages.items():
        if letter not in SYSTEMS or not letter:
            raise StarwiseError("no such system", found=letter, wanted=f"a letter of {SYSTEMS}")
        if len(ranks) > N_RANKS:
            raise StarwiseError(f"more than {N_RANKS} ranks of messages", found=str(ranks))
        for rank, names in enumerate(ranks):
            for name in names:
                if name not in MESSAGE_NAMES:
                    raise StarwiseError("no such message", found=name, wanted=" ".join(MESSAGE_NAMES[1:]))
                table[SYSTEMS.index(letter), MESSAGE_NAMES.index(name)] = rank
        if ranks:
            table[SYSTEMS.index(letter), 0] = 0  # message not known: as good as the first
    return table


def _by_message(rules: Mapping[tuple[int, int | None], float], records: BroadcastRecords) -> F8:
    """Value of a rule for every record: that of its system and message, or of its system."""
    table = np.empty((len(SYSTEMS), len(MESSAGE_NAMES)))
    for s in range(len(SYSTEMS)):
        for m in range(len(MESSAGE_NAMES)):
            table[s, m] = rules[s, m] if (s, m) in rules else rules[s, None]
    return np.asarray(table[records.sv >> 8, records.message])


def _rules(records: BroadcastRecords, messages: Ranks, trusted: NDArray[np.bool_]) -> _Rules:
    system = records.sv >> 8
    rank = _rank_table(messages)[system, records.message]
    rank = np.where(_plausible(records) & trusted, rank, -1)

    limits = [_by_message({k: v[i] for k, v in LIMIT_S.items()}, records) for i in range(3)]
    flagged = (system == SYS_G) & (records.message == MSG_LNAV) & (records.fit_s > 0)
    half_fit = np.minimum(records.fit_s, 26 * 3600.0) / 2.0  # IODC tables of IS-GPS-200N go up to 26 h
    limits = [np.where(flagged, np.maximum(limit, half_fit), limit) for limit in limits]
    limit_ns, before_ns, after_ns = (((limit + _MARGIN_S) * NS).astype(np.int64) for limit in limits)

    avail = np.maximum(records.t_tx_ns, records.toe_ns - int(_LAG_MAX_S * NS))

    mask = _by_message(HEALTH_MASK, records).astype(np.int64)
    status = np.full(records.n, SAT_OK, dtype=np.int8)
    status[np.isinf(records.accuracy_m)] = SAT_INACCURATE
    status[(records.health.astype(np.int64) & mask) != 0] = SAT_UNHEALTHY

    known = np.isfinite(records.accuracy_m) & (records.accuracy_m > 0)
    sigma = np.where(known, records.accuracy_m, np.where(np.isinf(records.accuracy_m), np.inf, UNKNOWN_SIGMA_M))
    # What GLONASS says of itself (F_T) is of orbit and clock alone. Its users also see the delays between the channels
    # of satellite and receiver, 1-2 m each, for which the message has no correction.
    sigma = np.where(records.sv >> 8 == SYS_R, np.maximum(sigma, UNKNOWN_SIGMA_M), sigma)
    return _Rules(rank, status, limit_ns, before_ns, after_ns, avail, sigma)


def _plausible(records: BroadcastRecords) -> NDArray[np.bool_]:
    """Records whose numbers make an orbit at all: finite, an ellipse, above the Earth and below the Moon."""
    system = records.sv >> 8
    cartesian = (system == SYS_R) | (system == SYS_S)
    par = records.par
    kepler = (
        np.isfinite(par[:, [c for c in range(K_TOE_SOW + 1) if c not in (K_A_DOT, K_DELTA_N_DOT)]]).all(axis=1)
        & (par[:, K_E] >= 0.0)
        & (par[:, K_E] < 0.9)
        & (par[:, K_SQRT_A] > 2550.0)
        & (par[:, K_SQRT_A] < 15000.0)
    )
    radius = np.sqrt((par[:, R_X : R_X + 3] ** 2).sum(axis=1))
    state = np.isfinite(par[:, : R_AX + 3]).all(axis=1) & (radius > 6.5e6) & (radius < 2e8)
    return np.asarray(np.where(cartesian, state, kepler))


def _table(records: BroadcastRecords, rules: _Rules) -> Table:
    """Records arranged for the kernel."""
    used = np.flatnonzero(rules.rank >= 0)
    key = records.sv[used].astype(np.int64) * N_RANKS + rules.rank[used]
    toe, avail, t_tx = records.toe_ns[used], rules.avail_ns[used], records.t_tx_ns[used]
    by_toe = used[np.lexsort((t_tx, toe, key))]
    by_tx = used[np.lexsort((toe, avail, key))]
    start = np.searchsorted(np.sort(key), np.arange(len(SYSTEMS) * 256 * N_RANKS + 1))
    glonass = np.flatnonzero(records.sv >> 8 == SYS_R)
    slot = np.full(records.n, -1, dtype=np.int32)
    slot[glonass] = np.arange(len(glonass))
    par = np.ascontiguousarray(records.par, dtype=np.float64).copy()
    for column in (K_A_DOT, K_DELTA_N_DOT):
        par[~np.isfinite(par[:, column]), column] = 0.0
    return Table(
        start=start.astype(np.int64),
        by_toe=by_toe.astype(np.int64),
        by_tx=by_tx.astype(np.int64),
        toe_ns=np.ascontiguousarray(records.toe_ns, dtype=np.int64),
        toc_ns=np.ascontiguousarray(records.toc_ns, dtype=np.int64),
        avail_ns=rules.avail_ns.astype(np.int64),
        limit_ns=rules.limit_ns,
        before_ns=rules.before_ns,
        after_ns=rules.after_ns,
        status=rules.status,
        sigma_m=np.ascontiguousarray(rules.sigma_m, dtype=np.float64),
        par=par,
        slot=slot,
        nodes=np.empty((len(glonass), 2, N_NODES, 6)),
        reach=np.zeros((len(glonass), 2), dtype=np.int32),
    )
