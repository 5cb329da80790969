"""The simulated sky: true orbits and clocks of the satellites, and the navigation messages that describe them.

Whatever the sky is made from, truth comes first and messages follow: Keplerian truth is re-issued exactly with a new
reference time; integrated (GLONASS) and SGP4 orbits are sampled or fitted. A message's error is then only what the
scenario asks for.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from starwise.constants import (
    DAY_S,
    K_A_DOT,
    K_AF0,
    K_AF1,
    K_AF2,
    K_DELTA_N_DOT,
    MSG_D1,
    MSG_D2,
    MSG_FDMA,
    MSG_FNAV,
    MSG_INAV,
    MSG_LNAV,
    N_EPH_PAR,
    N_TGD,
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
    SYSTEMS,
    TGD_MAIN,
    TGD_SECOND,
)
from starwise.errors import StarwiseError
from starwise.gnsstime import BDT_OFFSET_S, GLONASST_UTC_S, gpst_to_utc, iso, leap_seconds, parse_time, utc_to_gpst
from starwise.kernels.sim_orbits import (
    N_ERRORS,
    ORBIT_KEPLER,
    ORBIT_NODES,
    REL_DOT_PRODUCT,
    REL_ECCENTRICITY,
    REL_NONE,
    OrbitTable,
    glonass_gravity,
    integrate,
    true_states,
)
from starwise.signals import frequency, sv_id, sv_name
from starwise.sim.constellations import Constellation, constellations
from starwise.sim.orbits import (
    MU,
    NODE_STEP_S,
    OMEGA_E,
    elements,
    fitted,
    gmst,
    is_geo,
    rebased,
    tle_nodes,
)
from starwise.sim.sections import SYSTEM_OF, EphemerisError, Sky
from starwise.sim.seeds import Streams
from starwise.types import F8, I2, I8, BroadcastRecords, IonosphereModel

KLOBUCHAR: Final = (1.118e-08, -7.451e-09, -5.961e-08, 1.192e-07, 1.167e05, -2.294e05, -1.311e05, 1.049e06)
"""Ionosphere of the sky where no file brings one: as GPS broadcast on 2004-01-01."""
ISSUE_S: Final = {SYS_G: 7200, SYS_R: 1800, SYS_E: 3600, SYS_C: 3600, SYS_J: 3600}
"""Spacing of messages, s."""
_LEAD_S: Final = {SYS_G: 7200, SYS_R: 900, SYS_E: -600, SYS_C: 0, SYS_J: 3600}
"""How long before its reference time a message is sent first, s."""
_MARGIN_S: Final = 3 * 3600
"""Tabulated orbits reach this far beyond the scenario."""
_CLOCK_SIGMA_S: Final = 1e-4
_DRIFT_SIGMA: Final = 1e-12
_DELAY_SIGMA_S: Final = 4e-9
_ACCURACY_M: Final = {SYS_G: 2.0, SYS_R: 2.5, SYS_E: 3.12, SYS_C: 2.0, SYS_J: 2.0}


@dataclass(frozen=True)
class TrueSky:
    """Satellites as they are, and as they say they are.

    Attributes
    ----------
    sv : (n,) int16
        Satellites, sorted.
    table : OrbitTable
        True orbits and clocks (row k is ``sv[k]``).
    delay_s : (n, 10) float64
        True group delay of each band against the broadcast clock (I/NAV for Galileo), s.
    channels : dict
        GLONASS channel by satellite.
    records : BroadcastRecords
        Messages, without the errors that `with_error` adds to the truth.
    source : str
        Where the orbits come from, for people.
    """

    sv: I2
    table: OrbitTable
    delay_s: F8
    channels: dict[int, int]
    records: BroadcastRecords
    source: str

    def states(self, t_ns: I8, sv: I2) -> F8:
        """True position, velocity (ECEF of the instant), clock (s) and drift (s/s), (n, 8), at times."""
        out = np.empty((len(sv), 8))
        index = np.searchsorted(self.sv, sv).astype(np.int64)
        true_states(self.table, index, np.ascontiguousarray(t_ns, dtype=np.int64), out)
        return out

    def with_error(self, error: EphemerisError, streams: Streams) -> "TrueSky":
        """Sky whose truth differs from its messages.

        Per satellite and axis a constant and a slow sinusoid (of ``tau_s`` a radian), half the variance each: their
        sum is Gaussian with the sigma asked for, and smooth. Streams ``ephemeris/<satellite>``.
        """
        sigma = np.array([error.radial_m, error.along_m, error.cross_m, error.clock_m])
        if not sigma.any():
            return self
        table = np.zeros((len(self.sv), N_ERRORS, 4))
        for k, sv in enumerate(self.sv):
            draw = streams(f"ephemeris/{sv_name(int(sv))}").standard_normal((3, N_ERRORS)) * sigma / math.sqrt(2.0)
            table[k, :, 0] = draw[0]
            table[k, :, 1] = np.hypot(draw[1], draw[2])
            table[k, :, 2] = 1.0 / error.tau_s
            table[k, :, 3] = np.arctan2(draw[2], draw[1])
        return replace(self, table=self.table._replace(error=table))


def build_sky(
    sky: Sky,
    start_ns: int,
    end_ns: int,
    streams: Streams,
    nav: BroadcastRecords | None = None,
    tle: Sequence[tuple[str, str, str]] = (),
) -> TrueSky:
    """Sky of a scenario.

    Parameters
    ----------
    sky : Sky
        Section of the scenario.
    start_ns, end_ns : int
        Time that must be covered, GPST.
    streams : Streams
        Clocks and group delays of tables and two-line elements, streams ``sky/<satellite>``.
    nav : BroadcastRecords, optional
        For source ``nav``.
    tle : sequence of (satellite, line 1, line 2)
        For source ``tle``, from `starwise.sim.orbits.read_tle`.

    Raises
    ------
    StarwiseError
        No satellite, or records that do not cover the time.
    """
    letters = {SYSTEM_OF[name] for name in sky.constellations}
    excluded = {sv_id(name) for name in sky.exclude}
    maker = _Maker(start_ns, end_ns, streams)
    ionosphere = IonosphereModel(klobuchar={"G": np.array(KLOBUCHAR)})
    if sky.source == "tables":
        tables = constellations(sky.constellations)
        for constellation in tables:
            maker.add_table(constellation, excluded)
        source = "; ".join(f"{c.title}: {c.source}" for c in tables)
    elif sky.source == "nav":
        if nav is None:
            raise StarwiseError("the sky of a navigation file needs its records", wanted="nav")
        maker.add_records(nav, letters, excluded)
        if "G" in nav.ionosphere.klobuchar:
            ionosphere = IonosphereModel(klobuchar={"G": nav.ionosphere.klobuchar["G"]})
        source = "broadcast navigation file"
    else:
        wanted = [one for one in tle if one[0][0] in letters and sv_id(one[0]) not in excluded]
        maker.add_tle(wanted)
        source = "two-line elements, SGP4"
    if not maker.satellites:
        raise StarwiseError(
            "no satellite in the sky", found=" ".join(sky.constellations), wanted="constellations that the files have"
        )
    return maker.finished(ionosphere, source)


@dataclass
class _Satellite:
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


class _Maker:
    """Collects satellites, then makes the table of truth and the messages."""

    def __init__(self, start_ns: int, end_ns: int, streams: Streams) -> None:
        self.start_ns, self.end_ns, self.streams = start_ns, end_ns, streams
        self.day_ns = start_ns // (DAY_S * NS) * DAY_S * NS
        step = round(NODE_STEP_S * NS)
        self.node_ns = (start_ns - _MARGIN_S * NS) // step * step
        self.n_nodes = int((end_ns + _MARGIN_S * NS - self.node_ns) // step) + 2
        self.satellites: list[_Satellite] = []

    # -- sources
    def add_table(self, table: Constellation, excluded: set[int]) -> None:
        """Satellites of a constellation's table, moved to the scenario's day.

        All satellites of a kind are moved by their common mean motion and node rate, as station keeping would do;
        within the scenario each follows its own.
        """
        epoch_ns = parse_time(table.epoch)
        since = (self.day_ns - epoch_ns) / NS
        for orbit in table.orbits:
            sv = sv_id(orbit.name)
            if sv in excluded:
                continue
            system = sv >> 8
            mu, omega = MU[system], OMEGA_E[system]
            node_rate = math.radians(orbit.node_rate_deg_day) / DAY_S
            kin = [o for o in table.orbits if abs(o.a_m - orbit.a_m) < 1e5]
            if orbit.a_m == 0.0:  # ground track stands still
                n = omega - node_rate
                a = (mu / n**2) ** (1.0 / 3.0)
                common_n, common_rate = n, node_rate
            else:
                a = orbit.a_m
                common_n = math.sqrt(mu / np.mean([o.a_m for o in kin]) ** 3)
                common_rate = float(np.mean([math.radians(o.node_rate_deg_day) / DAY_S for o in kin]))
            longitude = math.radians(orbit.node_deg) - (0.0 if table.node_is_longitude else gmst(epoch_ns))
            longitude += math.fmod((common_rate - omega) * since, 2.0 * math.pi)
            anomaly = math.radians(orbit.anomaly_deg) + math.fmod(common_n * since, 2.0 * math.pi)
            par = elements(
                system, self.day_ns, a, orbit.e, math.radians(orbit.i_deg), longitude,
                math.radians(orbit.perigee_deg), anomaly, node_rate, is_geo(sv),
            )  # fmt: skip
            satellite = self._new(sv, orbit.channel)
            satellite.par, satellite.toe_ns = par, self.day_ns
            if system == SYS_R:
                satellite.nodes = self._integrated(sv, par)
            self.satellites.append(satellite)

    def _new(self, sv: int, channel: int) -> _Satellite:
        """Satellite with a clock and group delays drawn for it."""
        draw = self.streams(f"sky/{sv_name(sv)}").standard_normal(6)
        system = sv >> 8
        tgd = np.full(N_TGD, np.nan)
        if system in (SYS_G, SYS_J, SYS_E, SYS_C):
            tgd[TGD_MAIN] = _DELAY_SIGMA_S * draw[2]
        if system in (SYS_E, SYS_C):
            tgd[TGD_SECOND] = tgd[TGD_MAIN] + 0.3 * _DELAY_SIGMA_S * draw[3]
        return _Satellite(
            sv=sv,
            par=np.zeros(N_EPH_PAR),
            toe_ns=self.day_ns,
            toc_ns=self.day_ns,
            clock=(_CLOCK_SIGMA_S * draw[0], _DRIFT_SIGMA * draw[1], 0.0),
            tgd=tgd,
            channel=channel,
            message=_message(sv),
            relativity=REL_NONE if system == SYS_R else REL_ECCENTRICITY,
            accuracy_m=_ACCURACY_M[system],
            dtau_s=_DELAY_SIGMA_S * draw[2],
        )

    def _integrated(self, sv: int, par: F8) -> F8:
        """Nodes of a GLONASS orbit that has the table's elements at the start of the day."""
        table = _table([_Satellite(sv, par, self.day_ns, self.day_ns, (0.0, 0.0, 0.0), np.zeros(N_TGD))], 0)
        state = np.empty((1, 8))
        true_states(table, np.zeros(1, dtype=np.int64), np.array([self.node_ns]), state)
        return self._from(state[0, :6], 0)

    def _from(self, state: F8, at: int) -> F8:
        nodes = np.zeros((self.n_nodes, 6))
        nodes[at] = state
        integrate(nodes, at, NODE_STEP_S)
        return nodes

    def add_records(self, nav: BroadcastRecords, letters: set[str], excluded: set[int]) -> None:
        """Satellites of broadcast records: of each the healthy one nearest to the middle of the scenario."""
        middle = (self.start_ns + self.end_ns) // 2
        wanted = np.isin(nav.message, (MSG_LNAV, MSG_INAV, MSG_D1, MSG_D2, MSG_FDMA))
        for sv in np.unique(nav.sv[wanted]):
            if SYSTEMS[sv >> 8] not in letters or int(sv) in excluded:
                continue
            rows = np.flatnonzero(wanted & (nav.sv == sv) & (nav.health == 0))
            rows = rows[np.abs(nav.toe_ns[rows] - middle) <= DAY_S * NS]
            if len(rows) == 0:
                continue
            row = int(rows[np.argmin(np.abs(nav.toe_ns[rows] - middle))])
            self.satellites.append(self._of_record(nav, row, int(sv)))
        if not self.satellites:
            raise StarwiseError(
                "no broadcast record within a day of the scenario",
                found=f"{iso(int(nav.toe_ns.min()), 0)} to {iso(int(nav.toe_ns.max()), 0)}" if nav.n else "no records",
                wanted=iso(middle, 0),
            )

    def _of_record(self, nav: BroadcastRecords, row: int, sv: int) -> _Satellite:
        par, system = nav.par[row], sv >> 8
        satellite = self._new(sv, 0)
        satellite.toe_ns, satellite.toc_ns = int(nav.toe_ns[row]), int(nav.toc_ns[row])
        accuracy = float(nav.accuracy_m[row])
        satellite.accuracy_m = accuracy if math.isfinite(accuracy) else satellite.accuracy_m
        if system == SYS_R:
            satellite.clock = (float(par[R_TAU]), float(par[R_GAMMA]), 0.0)
            satellite.channel = round(float(par[R_CHANNEL]))
            satellite.dtau_s = float(np.nan_to_num(par[R_DTAU]))
            # to the nearest node by short steps, then over all of them
            hop = int((satellite.toe_ns - self.node_ns) // round(NODE_STEP_S * NS))
            rest = ((satellite.toe_ns - self.node_ns) - hop * round(NODE_STEP_S * NS)) / NS
            two = np.zeros((2, 6))
            two[1] = np.concatenate([par[R_X : R_X + 3], par[R_VX : R_VX + 3]])
            integrate(two, 1, max(rest, 1e-9))
            start = two[0]
            if not 0 <= hop < self.n_nodes:
                far = np.zeros((abs(hop) + self.n_nodes + 1, 6))
                at = 0 if hop < 0 else len(far) - 1
                far[at] = start
                integrate(far, at, NODE_STEP_S)
                start, hop = (far[-hop], 0) if hop < 0 else (far[at - hop], 0)
            satellite.nodes = self._from(start, hop)
            return satellite
        satellite.par = par.copy()
        satellite.par[[K_A_DOT, K_DELTA_N_DOT]] = 0.0
        satellite.clock = (float(par[K_AF0]), float(par[K_AF1]), float(par[K_AF2]))
        satellite.tgd = np.where(np.isfinite(nav.tgd[row]), nav.tgd[row], 0.0)
        satellite.message = int(nav.message[row])
        return satellite

    def add_tle(self, sets: Sequence[tuple[str, str, str]]) -> None:
        """Satellites of two-line elements."""
        if not sets:
            return
        svs, nodes = tle_nodes(sets, self.node_ns, self.n_nodes)
        channels = {sv_id(o.name): o.channel for c in constellations(("glonass",)) for o in c.orbits}
        for sv, states in zip(svs, nodes, strict=True):
            if sv >> 8 not in MU:
                continue
            satellite = self._new(sv, channels.get(sv, 0))
            satellite.nodes, satellite.from_tle = states, True
            if sv >> 8 != SYS_R:
                satellite.relativity = REL_DOT_PRODUCT
            self.satellites.append(satellite)

    # -- results
    def finished(self, ionosphere: IonosphereModel, source: str) -> TrueSky:
        """Table, group delays and messages."""
        self.satellites.sort(key=lambda s: s.sv)
        table = _table(self.satellites, self.node_ns)
        delay = np.stack([_delays(s) for s in self.satellites])
        channels = {s.sv: s.channel for s in self.satellites if s.sv >> 8 == SYS_R}
        rows: list[_Row] = []
        for k, satellite in enumerate(self.satellites):
            rows.extend(self._messages(table, k, satellite))
        records = _records(rows, ionosphere, leap_seconds(self.start_ns))
        sv = np.array([s.sv for s in self.satellites], dtype=np.int16)
        return TrueSky(sv, table, delay, channels, records, source)

    def _issues(self, satellite: _Satellite) -> list[int]:
        """Reference times of a satellite's messages, GPST ns: all that can be in use during the scenario."""
        system = satellite.sv >> 8
        step = ISSUE_S[system] * NS
        first = self.start_ns - 2 * step
        if system == SYS_R:  # minutes 15 and 45 of Moscow time, a whole number of hours from UTC
            utc = gpst_to_utc(first) + GLONASST_UTC_S * NS
            base = utc_to_gpst((utc // step) * step + step // 2 - GLONASST_UTC_S * NS)
        elif satellite.nodes is None and satellite.toe_ns != self.day_ns:  # a real message stays one of them
            base = satellite.toe_ns + (first - satellite.toe_ns) // step * step
        else:
            offset = BDT_OFFSET_S * NS if system == SYS_C else 0
            base = (first - offset) // step * step + offset
        count = int((self.end_ns + step - base) // step) + 1
        return [base + k * step for k in range(count)]

    def _messages(self, table: OrbitTable, k: int, satellite: _Satellite) -> "list[_Row]":
        system = satellite.sv >> 8
        out = []
        for number, toe_ns in enumerate(self._issues(satellite)):
            dt = (toe_ns - satellite.toc_ns) / NS
            a0, a1, a2 = satellite.clock
            clock = (a0 + dt * (a1 + dt * a2), a1 + 2.0 * dt * a2, a2)
            if system == SYS_R:
                par = np.zeros(N_EPH_PAR)
                state = _sampled(table, k, np.array([toe_ns]))[0]
                par[R_X : R_X + 3], par[R_VX : R_VX + 3] = state[:3], state[3:6]
                par[R_AX : R_AX + 3] = _left_over(table, k, toe_ns) if satellite.from_tle else 0.0
                par[R_TAU], par[R_GAMMA] = clock[0], clock[1]
                par[R_CHANNEL], par[R_DTAU] = satellite.channel, satellite.dtau_s
            else:
                par = self._keplerian(table, k, satellite, toe_ns)
                par[K_AF0], par[K_AF1], par[K_AF2] = clock
            out.append(_Row(satellite, toe_ns, par, satellite.message, number, clock[0]))
            if satellite.message == MSG_INAV:
                shift = satellite.tgd[TGD_MAIN] - satellite.tgd[TGD_SECOND]
                fnav = par.copy()
                fnav[K_AF0] += shift  # the same signal E1 must leave at the same time by both messages
                out.append(_Row(satellite, toe_ns, fnav, MSG_FNAV, number, clock[0] + shift))
        return out

    def _keplerian(self, table: OrbitTable, k: int, satellite: _Satellite, toe_ns: int) -> F8:
        """Parameters of a message: moved exactly where that can be done, fitted to the truth elsewhere."""
        if satellite.nodes is None:
            if toe_ns == satellite.toe_ns:
                return satellite.par.copy()
            if not is_geo(satellite.sv):
                return rebased(satellite.par, satellite.toe_ns, toe_ns, satellite.sv >> 8)
        half = max(ISSUE_S[satellite.sv >> 8], 7200) * NS
        t_ns = np.linspace(toe_ns - half, toe_ns + half, 33).astype(np.int64)
        if satellite.nodes is not None:
            last = self.node_ns + (self.n_nodes - 2) * round(NODE_STEP_S * NS)
            t_ns = t_ns[(t_ns >= self.node_ns) & (t_ns <= last)]
        states = _sampled(table, k, t_ns)
        par, _ = fitted(satellite.sv, toe_ns, t_ns, states[:, :3], states[:, 3:6])
        return par


@dataclass(frozen=True)
class _Row:
    satellite: _Satellite
    toe_ns: int
    par: F8
    message: int
    number: int
    clock_s: float


def _message(sv: int) -> int:
    system = sv >> 8
    if system == SYS_R:
        return MSG_FDMA
    if system == SYS_E:
        return MSG_INAV
    if system == SYS_C:
        return MSG_D2 if is_geo(sv) else MSG_D1
    return MSG_LNAV


def _sampled(table: OrbitTable, k: int, t_ns: I8) -> F8:
    out = np.empty((len(t_ns), 8))
    true_states(table, np.full(len(t_ns), k, dtype=np.int64), np.ascontiguousarray(t_ns, dtype=np.int64), out)
    return out


def _left_over(table: OrbitTable, k: int, t_ns: int) -> F8:
    """Acceleration (3,) of a true GLONASS orbit beyond the message's own model: its luni-solar term."""
    h = 120
    states = _sampled(table, k, t_ns + np.array([-2, -1, 0, 1, 2], dtype=np.int64) * h * NS)
    v = states[:, 3:6]
    x, y, z, vx, vy = (float(s) for s in states[2, :5])
    acceleration = (8.0 * (v[3] - v[1]) - (v[4] - v[0])) / (12.0 * h)  # to 1e-8 m/s^2
    return np.asarray(acceleration - np.array(glonass_gravity(x, y, z, vx, vy)))


def _table(satellites: Sequence[_Satellite], node_ns: int) -> OrbitTable:
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


def _delays(satellite: _Satellite) -> F8:
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
