"""Navigation messages of the simulated sky, made from its true orbits and clocks.

Keplerian truth is re-issued exactly with a new reference time, integrated and SGP4 orbits are sampled (GLONASS) or
fitted: a message's error is only what the scenario asks for.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from starwise.constants import (
    DAY_S,
    K_AF0,
    K_AF1,
    K_AF2,
    MSG_D1,
    MSG_D2,
    MSG_FDMA,
    MSG_FNAV,
    MSG_INAV,
    MSG_LNAV,
    N_EPH_PAR,
    NS,
    R_AX,
    R_CHANNEL,
    R_DTAU,
    R_GAMMA,
    R_TAU,
    R_VX,
    R_X,
    SYS_C,
    SYS_E,
    SYS_G,
    SYS_J,
    SYS_R,
    TGD_MAIN,
    TGD_SECOND,
)
from starwise.gnsstime import BDT_OFFSET_S, GLONASST_UTC_S, gpst_to_utc, leap_seconds, utc_to_gpst
from starwise.kernels.sim_orbits import (
    N_ERRORS,
    ORBIT_KEPLER,
    ORBIT_NODES,
    REL_ECCENTRICITY,
    OrbitTable,
    glonass_gravity,
    true_states,
)
from starwise.signals import frequency
from starwise.sim.orbits import MU, NODE_STEP_S, OMEGA_E, fitted, is_geo, rebased
from starwise.types import F8, I8, BroadcastRecords, IonosphereModel

ISSUE_S: Final = {SYS_G: 7200, SYS_R: 1800, SYS_E: 3600, SYS_C: 3600, SYS_J: 3600}
"""Spacing of messages, s."""
_LEAD_S: Final = {SYS_G: 7200, SYS_R: 900, SYS_E: -600, SYS_C: 0, SYS_J: 3600}
"""How long before its reference time a message is sent first, s."""
_MARGIN_S: Final = 3 * 3600
"""Tabulated orbits reach this far beyond the scenario."""
ACCURACY_M: Final = {SYS_G: 2.0, SYS_R: 2.5, SYS_E: 3.12, SYS_C: 2.0, SYS_J: 2.0}


@dataclass
class Satellite:
    """A satellite's true orbit and clock, and what its messages say beside them.

    The orbit is Keplerian (``par`` at ``toe_ns``) or tabulated (``nodes``); ``clock`` is the polynomial at ``toc_ns``,
    ``tgd`` as in `starwise.types.BroadcastRecords`.
    """

    sv: int
    par: F8
    toe_ns: int
    toc_ns: int
    clock: tuple[float, float, float]
    tgd: F8
    channel: int = 0
    message: int = MSG_LNAV
    nodes: F8 | None = None
    relativity: int = REL_ECCENTRICITY
    health: int = 0
    accuracy_m: float = 2.0
    dtau_s: float = 0.0
    from_tle: bool = False


@dataclass(frozen=True)
class Span:
    """Time that a sky covers, GPST ns.

    Attributes
    ----------
    start_ns, end_ns : int
        Of the scenario.
    day_ns : int
        Start of its first day: reference time of orbits from tables.
    node_ns : int
        First node of tabulated orbits.
    n_nodes : int
        Their number, `NODE_STEP_S` apart.
    """

    start_ns: int
    end_ns: int
    day_ns: int
    node_ns: int
    n_nodes: int

    @classmethod
    def of(cls, start_ns: int, end_ns: int) -> "Span":
        """Span of a scenario, with tables that reach three hours beyond it."""
        step = round(NODE_STEP_S * NS)
        node_ns = (start_ns - _MARGIN_S * NS) // step * step
        return cls(
            start_ns,
            end_ns,
            start_ns // (DAY_S * NS) * DAY_S * NS,
            node_ns,
            int((end_ns + _MARGIN_S * NS - node_ns) // step) + 2,
        )


@dataclass(frozen=True)
class _Row:
    satellite: Satellite
    toe_ns: int
    par: F8
    message: int
    number: int


def _issues(span: Span, satellite: Satellite) -> list[int]:
    """Reference times of a satellite's messages, GPST ns: all that can be in use during the scenario."""
    system = satellite.sv >> 8
    step = ISSUE_S[system] * NS
    first = span.start_ns - 2 * step
    if system == SYS_R:  # minutes 15 and 45 of Moscow time, a whole number of hours from UTC
        utc = gpst_to_utc(first) + GLONASST_UTC_S * NS
        base = utc_to_gpst((utc // step) * step + step // 2 - GLONASST_UTC_S * NS)
    elif satellite.nodes is None and satellite.toe_ns != span.day_ns:  # a real message stays one of them
        base = satellite.toe_ns + (first - satellite.toe_ns) // step * step
    else:
        offset = BDT_OFFSET_S * NS if system == SYS_C else 0
        base = (first - offset) // step * step + offset
    count = int((span.end_ns + step - base) // step) + 1
    return [base + k * step for k in range(count)]


def _messages(span: Span, table: OrbitTable, k: int, satellite: Satellite) -> list[_Row]:
    """Messages of one satellite."""
    system = satellite.sv >> 8
    out = []
    for number, toe_ns in enumerate(_issues(span, satellite)):
        dt = (toe_ns - satellite.toc_ns) / NS
        a0, a1, a2 = satellite.clock
        clock = (a0 + dt * (a1 + dt * a2), a1 + 2.0 * dt * a2, a2)
        if system == SYS_R:
            par = np.zeros(N_EPH_PAR)
            state = sampled(table, k, np.array([toe_ns]))[0]
            par[R_X : R_X + 3], par[R_VX : R_VX + 3] = state[:3], state[3:6]
            par[R_AX : R_AX + 3] = _left_over(table, k, toe_ns) if satellite.from_tle else 0.0
            par[R_TAU], par[R_GAMMA] = clock[0], clock[1]
            par[R_CHANNEL], par[R_DTAU] = satellite.channel, satellite.dtau_s
        else:
            par = _keplerian(span, table, k, satellite, toe_ns)
            par[K_AF0], par[K_AF1], par[K_AF2] = clock
        out.append(_Row(satellite, toe_ns, par, satellite.message, number))
        if satellite.message == MSG_INAV:
            shift = satellite.tgd[TGD_MAIN] - satellite.tgd[TGD_SECOND]
            fnav = par.copy()
            fnav[K_AF0] += shift  # the same signal E1 must leave at the same time by both messages
            out.append(_Row(satellite, toe_ns, fnav, MSG_FNAV, number))
    return out


def _keplerian(span: Span, table: OrbitTable, k: int, satellite: Satellite, toe_ns: int) -> F8:
    """Parameters of a message: moved exactly where that can be done, fitted to the truth elsewhere."""
    if satellite.nodes is None:
        if toe_ns == satellite.toe_ns:
            return satellite.par.copy()
        if not is_geo(satellite.sv):
            return rebased(satellite.par, satellite.toe_ns, toe_ns, satellite.sv >> 8)
    half = max(ISSUE_S[satellite.sv >> 8], 7200) * NS
    t_ns = np.linspace(toe_ns - half, toe_ns + half, 33).astype(np.int64)
    if satellite.nodes is not None:
        last = span.node_ns + (span.n_nodes - 2) * round(NODE_STEP_S * NS)
        t_ns = t_ns[(t_ns >= span.node_ns) & (t_ns <= last)]
    states = sampled(table, k, t_ns)
    par, _ = fitted(satellite.sv, toe_ns, t_ns, states[:, :3], states[:, 3:6])
    return par


def message_of(sv: int) -> int:
    """Message that a satellite sends: LNAV, FDMA, I/NAV, D1 or D2."""
    system = sv >> 8
    if system == SYS_R:
        return MSG_FDMA
    if system == SYS_E:
        return MSG_INAV
    if system == SYS_C:
        return MSG_D2 if is_geo(sv) else MSG_D1
    return MSG_LNAV


def sampled(table: OrbitTable, k: int, t_ns: I8) -> F8:
    """True position, velocity, clock and drift of satellite ``k`` at times, (n, 8)."""
    out = np.empty((len(t_ns), 8))
    true_states(table, np.full(len(t_ns), k, dtype=np.int64), np.ascontiguousarray(t_ns, dtype=np.int64), out)
    return out


def _left_over(table: OrbitTable, k: int, t_ns: int) -> F8:
    """Acceleration (3,) of a true GLONASS orbit beyond the message's own model: its luni-solar term."""
    h = 120
    states = sampled(table, k, t_ns + np.array([-2, -1, 0, 1, 2], dtype=np.int64) * h * NS)
    v = states[:, 3:6]
    x, y, z, vx, vy = (float(s) for s in states[2, :5])
    acceleration = (8.0 * (v[3] - v[1]) - (v[4] - v[0])) / (12.0 * h)  # to 1e-8 m/s^2
    return np.asarray(acceleration - np.array(glonass_gravity(x, y, z, vx, vy)))


def orbit_table(satellites: Sequence[Satellite], node_ns: int) -> OrbitTable:
    """Truth of satellites as the kernels take it."""
    n = len(satellites)
    tabulated = [k for k, s in enumerate(satellites) if s.nodes is not None]
    slot = np.full(n, -1, dtype=np.int64)
    slot[tabulated] = np.arange(len(tabulated))
    nodes = [s.nodes for s in satellites if s.nodes is not None]
    return OrbitTable(
        kind=np.where(slot >= 0, ORBIT_NODES, ORBIT_KEPLER).astype(np.int64),
        relativity=np.array([s.relativity for s in satellites], dtype=np.int64),
        geo=np.array([is_geo(s.sv) and s.nodes is None for s in satellites], dtype=np.int64),
        mu=np.array([MU[s.sv >> 8] for s in satellites]),
        omega_e=np.array([OMEGA_E[s.sv >> 8] for s in satellites]),
        par=np.stack([s.par for s in satellites]),
        toe_ns=np.array([s.toe_ns for s in satellites], dtype=np.int64),
        toc_ns=np.array([s.toc_ns for s in satellites], dtype=np.int64),
        clock=np.array([s.clock for s in satellites]),
        start_ns=node_ns,
        step_s=NODE_STEP_S,
        slot=slot,
        nodes=np.stack(nodes) if nodes else np.zeros((0, 2, 6)),
        error=np.zeros((n, N_ERRORS, 4)),
        error_ns=satellites[0].toe_ns,
    )


def delays_of(satellite: Satellite) -> F8:
    """Group delay of each band against the broadcast clock, s, (10,): what the message's TGD means.

    IS-GPS-200N 20.3.3.3.3.2; Galileo OS SIS ICD 2.1, 5.1.5; BDS-SIS-ICD-B1I-3.0, 5.2.4.10. Bands of which the message
    says nothing follow the same square law (GPS L5) or have no delay.
    """
    system = satellite.sv >> 8
    out = np.zeros(10)
    tgd = np.nan_to_num(satellite.tgd)
    f1 = frequency(system, 1, satellite.channel)
    for band in range(1, 10):
        f = frequency(system, band, satellite.channel)
        if not math.isfinite(f):
            continue
        gamma = (f1 / f) ** 2
        if system in (SYS_G, SYS_J):
            out[band] = gamma * tgd[TGD_MAIN]
        elif system == SYS_E:
            # against the I/NAV clock: E1 by BGD(E1, E5b), E5a by the difference to the F/NAV clock
            out[band] = gamma * tgd[TGD_SECOND]
            if band == 5:
                out[band] = tgd[TGD_SECOND] + (gamma - 1.0) * tgd[TGD_MAIN]
        elif system == SYS_C:
            out[band] = {2: tgd[TGD_MAIN], 7: tgd[TGD_SECOND], 1: tgd[TGD_MAIN]}.get(band, 0.0)
        elif system == SYS_R and band == 2:
            out[band] = satellite.dtau_s
    if system == SYS_E:
        out[8] = 0.5 * (out[5] + out[7])
    return out


def make_records(
    span: Span, table: OrbitTable, satellites: Sequence[Satellite], ionosphere: IonosphereModel
) -> BroadcastRecords:
    """Messages of all satellites that can be in use during the scenario."""
    rows = [row for k, satellite in enumerate(satellites) for row in _messages(span, table, k, satellite)]
    return _records(rows, ionosphere, leap_seconds(span.start_ns))


def _records(rows: list[_Row], ionosphere: IonosphereModel, leap_s: int) -> BroadcastRecords:
    rows = sorted(rows, key=lambda r: (r.satellite.sv, r.toe_ns, r.message))
    system = np.array([r.satellite.sv >> 8 for r in rows])
    toe = np.array([r.toe_ns for r in rows], dtype=np.int64)
    lead = np.array([_LEAD_S[int(s)] for s in system], dtype=np.int64)
    number = np.array([r.number for r in rows], dtype=np.int64)
    fit = np.where(system == SYS_G, 4.0 * 3600.0, np.where(system == SYS_J, 2.0 * 3600.0, np.nan))
    data_source = {MSG_INAV: 517, MSG_FNAV: 258}  # RINEX 3.05 table A8
    tgd = np.stack([r.satellite.tgd for r in rows])
    keep = np.array([r.message == MSG_FNAV for r in rows])
    tgd[keep, TGD_SECOND] = np.nan
    moscow = np.array([int(gpst_to_utc(int(t))) + GLONASST_UTC_S * NS for t in toe])
    t_b = moscow % (DAY_S * NS) // (900 * NS)  # GLONASS ICD L1/L2 5.1, 4.4
    iode = np.where(system == SYS_R, t_b, np.where(system == SYS_C, 1, number % 240))
    return BroadcastRecords(
        sv=np.array([r.satellite.sv for r in rows], dtype=np.int16),
        message=np.array([r.message for r in rows], dtype=np.int8),
        toc_ns=toe,
        toe_ns=toe,
        t_tx_ns=toe - lead * NS,
        par=np.stack([r.par for r in rows]),
        tgd=tgd,
        accuracy_m=np.array([r.satellite.accuracy_m for r in rows]),
        health=np.array([r.satellite.health for r in rows], dtype=np.int32),
        iode=iode.astype(np.int32),
        iodc=np.where(np.isin(system, (SYS_G, SYS_J)), iode, np.where(system == SYS_C, 1, -1)).astype(np.int32),
        fit_s=fit,
        source=np.array([data_source.get(r.message, 0) for r in rows], dtype=np.int32),
        ionosphere=ionosphere,
        leap_s=leap_s,
    )
