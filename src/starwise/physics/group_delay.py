"""Satellite group delays of signals against broadcast and precise clocks.

Every clock belongs to a signal or a pair of signals; any other signal leaves the satellite earlier or later. The rule
is one: ``delay(signal) - delay(reference of the clock)``.

=======  ==========================================  ======================================================
system   reference of the broadcast clock            delays broadcast
=======  ==========================================  ======================================================
G        L1 P(Y) and L2 P(Y), ionosphere-free        TGD of L1; CNAV: ISC of L1 C/A, L2C, L5, L1C
J        L1 C/A and L2C, ionosphere-free             TGD of L1; CNAV: ISC of L2C, L5, L1C
E        I/NAV: E1 and E5b; F/NAV: E1 and E5a        BGD(E1, E5a), BGD(E1, E5b)
C        B3I                                         TGD1 of B1I, TGD2 of B2I; CNV1-3: B1C, B2a, B2b
R        G1                                          DeltaTau of G2
I        L5 and S, ionosphere-free                   TGD of S
=======  ==========================================  ======================================================

Approximations, all of them below a metre: L1 C/A of GPS without CNAV takes the delay of L1 P(Y) (ISC L1 C/A is under
1.5 ns), L2C that of L2 P(Y), L1C without CNAV-2 that of L1 P(Y); Galileo E5 AltBOC takes the mean of E5a and E5b.
Signals of which nothing is broadcast (Galileo E6, GPS L5 without CNAV, BeiDou B1C without CNV1/2, B3A) are NaN.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.constants import (
    ISC_1,
    ISC_6,
    MSG_CNV3,
    MSG_FNAV,
    N_TGD,
    R_DTAU,
    SYS_C,
    SYS_G,
    SYS_J,
    SYS_R,
    SYSTEMS,
    TGD_B1CP,
    TGD_B2AP,
    TGD_SECOND,
)
from starwise.kernels.group_delay import DTAU, N_DELAYS, TGD_B2B, group_delays
from starwise.signals import signal_id
from starwise.types import F8, I2, I4, BroadcastRecords

BROADCAST_CLOCK: Final[dict[str, tuple[str, str]]] = {}
"""Reference pairs that say "the record's own"."""
PRECISE_CLOCK: Final[dict[str, tuple[str, str]]] = {
    # The pair of signals each system's clocks of the IGS and MGEX analysis centres belong to (clock files name
    # them in SYS / PCVS or DCBS APPLIED; IGS MGEX analysis guidelines).
    "G": ("1W", "2W"),
    "R": ("1P", "2P"),
    "E": ("1C", "5Q"),
    "C": ("2I", "6I"),
    "J": ("1C", "2L"),
}


def reference_table(pairs: dict[str, tuple[str, str]]) -> I2:
    """Signal identifiers (7, 2) of reference pairs by system letter; 0 where a system has none."""
    table = np.zeros((len(SYSTEMS), 2), dtype=np.int16)
    for letter, (one, two) in pairs.items():
        table[SYSTEMS.index(letter)] = signal_id(one), signal_id(two)
    return table


def delay_table(records: BroadcastRecords) -> F8:
    """Broadcast delays of every record, s, (n, N_DELAYS), completed from the satellite's other messages.

    What a message does not carry (ISC in LNAV; B1C, B2a and B2b in D1) is taken from the record of the same satellite
    that is nearest in time and has it: these delays change by less than 0.1 ns in a day. Galileo's are not mixed:
    I/NAV has both, and what F/NAV has is all that its clock needs.
    """
    n = records.n
    d = np.full((n, N_DELAYS), np.nan)
    d[:, :N_TGD] = records.tgd
    system = records.sv >> 8
    glonass = system == SYS_R
    d[glonass, DTAU] = records.par[glonass, R_DTAU]
    cnv3 = (system == SYS_C) & (records.message == MSG_CNV3)
    d[cnv3, TGD_B2B] = d[cnv3, TGD_B2AP]
    d[cnv3, TGD_B2AP] = np.nan
    fnav = records.message == MSG_FNAV
    d[fnav & (d[:, TGD_SECOND] == 0.0), TGD_SECOND] = np.nan  # RINEX 3 writes 0 for what F/NAV does not have
    columns = [*range(ISC_1, ISC_6 + 1), TGD_B1CP, TGD_B2AP, TGD_B2B]
    donors = np.isfinite(d[:, columns]).any(axis=1) & np.isin(system, (SYS_G, SYS_C, SYS_J))
    for sv in np.unique(records.sv[donors]):
        rows = np.flatnonzero(records.sv == sv)
        t = records.toe_ns[rows]
        for column in (*columns, *range(2)):
            have = np.isfinite(d[rows, column])
            if have.any() and not have.all():
                d[rows[~have], column] = d[rows[have][_nearest(t[have], t[~have])], column]
    return d


def _nearest(values: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.intp]:
    """Index of the value nearest to each wanted one."""
    order = np.argsort(values, kind="stable")
    at = np.clip(np.searchsorted(values, wanted, sorter=order), 1, max(len(values) - 1, 1))
    left, right = order[at - 1], order[np.minimum(at, len(values) - 1)]
    return np.where(wanted - values[left] <= values[right] - wanted, left, right)


def group_delay(
    delays: F8,
    message: NDArray[np.int8],
    frequency: F8,
    reference: I2,
    record: I4,
    sv: I2,
    sig: I2,
    sig2: I2,
) -> F8:
    """Group delays, m, of rows, NaN where not known; see `starwise.types.Ephemeris.group_delay`.

    Parameters
    ----------
    delays : (n_records, N_DELAYS) float64
        From `delay_table`.
    message : (n_records,) int8
    frequency : (7, 256, 10) float64
        Carriers, from `starwise.signals.frequency_table`.
    reference : (7, 2) int16
        From `reference_table`.
    record, sv, sig, sig2 : (n,)
    """
    out = np.empty(len(sv))
    group_delays(
        np.ascontiguousarray(record, dtype=np.int32),
        np.ascontiguousarray(sv, dtype=np.int16),
        np.ascontiguousarray(sig, dtype=np.int16),
        np.ascontiguousarray(sig2, dtype=np.int16),
        delays,
        message,
        frequency,
        reference,
        out,
    )
    return out
