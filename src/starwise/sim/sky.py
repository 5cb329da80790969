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
    MSG_INAV,
    MSG_LNAV,
    N_EPH_PAR,
    N_TGD,
    NS,
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
from starwise.gnsstime import iso, parse_time
from starwise.kernels.sim_orbits import (
    N_ERRORS,
    REL_DOT_PRODUCT,
    REL_ECCENTRICITY,
    REL_NONE,
    OrbitTable,
    integrate,
    true_states,
)
from starwise.signals import sv_id, sv_name
from starwise.sim.broadcast_errors import typical_sizes
from starwise.sim.constellations import Constellation, constellations
from starwise.sim.messages import ACCURACY_M, Satellite, Span, delays_of, make_records, message_of, orbit_table
from starwise.sim.orbits import (
    MU,
    NODE_STEP_S,
    OMEGA_E,
    elements,
    gmst,
    is_geo,
    tle_nodes,
)
from starwise.sim.sections import SYSTEM_OF, EphemerisError, Sky
from starwise.sim.seeds import Streams
from starwise.types import F8, I2, I8, BroadcastRecords, IonosphereModel

KLOBUCHAR: Final = (1.118e-08, -7.451e-09, -5.961e-08, 1.192e-07, 1.167e05, -2.294e05, -1.311e05, 1.049e06)
"""Ionosphere of the sky where no file brings one: as GPS broadcast on 2004-01-01."""
_CLOCK_SIGMA_S: Final = 1e-4
_DRIFT_SIGMA: Final = 1e-12
_DELAY_SIGMA_S: Final = 4e-9


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
        if error.is_none:
            return self
        table = np.zeros((len(self.sv), N_ERRORS, 4))
        for k, sv in enumerate(self.sv):
            sigma = typical_sizes(int(sv)) if error.model == "typical" else np.array(error.sizes)
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
    maker = _Maker(Span.of(start_ns, end_ns), streams)
    ionosphere = IonosphereModel(klobuchar={"G": np.array(KLOBUCHAR)})
    if sky.source == "tables":
        tables = constellations(sky.constellations)
        for constellation in tables:
            maker.addorbit_table(constellation, excluded)
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


class _Maker:
    """Collects satellites, then makes the table of truth and the messages."""

    def __init__(self, span: Span, streams: Streams) -> None:
        self.span, self.streams = span, streams
        self.satellites: list[Satellite] = []

    # -- sources
    def addorbit_table(self, table: Constellation, excluded: set[int]) -> None:
        """Satellites of a constellation's table, moved to the scenario's day.

        All satellites of a kind are moved by their common mean motion and node rate, as station keeping would do;
        within the scenario each follows its own.
        """
        epoch_ns = parse_time(table.epoch)
        since = (self.span.day_ns - epoch_ns) / NS
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
                system, self.span.day_ns, a, orbit.e, math.radians(orbit.i_deg), longitude,
                math.radians(orbit.perigee_deg), anomaly, node_rate, is_geo(sv),
            )  # fmt: skip
            satellite = self._new(sv, orbit.channel)
            satellite.par, satellite.toe_ns = par, self.span.day_ns
            if system == SYS_R:
                satellite.nodes = self._integrated(sv, par)
            self.satellites.append(satellite)

    def _new(self, sv: int, channel: int) -> Satellite:
        """Satellite with a clock and group delays drawn for it."""
        draw = self.streams(f"sky/{sv_name(sv)}").standard_normal(6)
        system = sv >> 8
        tgd = np.full(N_TGD, np.nan)
        if system in (SYS_G, SYS_J, SYS_E, SYS_C):
            tgd[TGD_MAIN] = _DELAY_SIGMA_S * draw[2]
        if system in (SYS_E, SYS_C):
            tgd[TGD_SECOND] = tgd[TGD_MAIN] + 0.3 * _DELAY_SIGMA_S * draw[3]
        return Satellite(
            sv=sv,
            par=np.zeros(N_EPH_PAR),
            toe_ns=self.span.day_ns,
            toc_ns=self.span.day_ns,
            clock=(_CLOCK_SIGMA_S * draw[0], _DRIFT_SIGMA * draw[1], 0.0),
            tgd=tgd,
            channel=channel,
            message=message_of(sv),
            relativity=REL_NONE if system == SYS_R else REL_ECCENTRICITY,
            accuracy_m=ACCURACY_M[system],
            dtau_s=_DELAY_SIGMA_S * draw[2],
        )

    def _integrated(self, sv: int, par: F8) -> F8:
        """Nodes of a GLONASS orbit that has the table's elements at the start of the day."""
        table = orbit_table(
            [Satellite(sv, par, self.span.day_ns, self.span.day_ns, (0.0, 0.0, 0.0), np.zeros(N_TGD))], 0
        )
        state = np.empty((1, 8))
        true_states(table, np.zeros(1, dtype=np.int64), np.array([self.span.node_ns]), state)
        return self._from(state[0, :6], 0)

    def _from(self, state: F8, at: int) -> F8:
        nodes = np.zeros((self.span.n_nodes, 6))
        nodes[at] = state
        integrate(nodes, at, NODE_STEP_S)
        return nodes

    def add_records(self, nav: BroadcastRecords, letters: set[str], excluded: set[int]) -> None:
        """Satellites of broadcast records: of each the healthy one nearest to the middle of the scenario."""
        middle = (self.span.start_ns + self.span.end_ns) // 2
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

    def _of_record(self, nav: BroadcastRecords, row: int, sv: int) -> Satellite:
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
            hop = int((satellite.toe_ns - self.span.node_ns) // round(NODE_STEP_S * NS))
            rest = ((satellite.toe_ns - self.span.node_ns) - hop * round(NODE_STEP_S * NS)) / NS
            two = np.zeros((2, 6))
            two[1] = np.concatenate([par[R_X : R_X + 3], par[R_VX : R_VX + 3]])
            integrate(two, 1, max(rest, 1e-9))
            start = two[0]
            if not 0 <= hop < self.span.n_nodes:
                far = np.zeros((abs(hop) + self.span.n_nodes + 1, 6))
                at = 0 if hop < 0 else len(far) - 1
                far[at] = start
                integrate(far, at, NODE_STEP_S)
                start, hop = (far[-hop], 0) if hop < 0 else (far[at - hop], 0)
            satellite.nodes = self._from(start, hop)
            return satellite
        satellite.par = par.copy()
        satellite.par[[K_A_DOT, K_DELTA_N_DOT]] = 0.0
        satellite.clock = (float(par[K_AF0]), float(par[K_AF1]), float(par[K_AF2]))
        for column in (TGD_MAIN, TGD_SECOND):
            if math.isfinite(satellite.tgd[column]):  # what this message has; blank is none
                satellite.tgd[column] = np.nan_to_num(nav.tgd[row, column])
        satellite.message = int(nav.message[row])
        return satellite

    def add_tle(self, sets: Sequence[tuple[str, str, str]]) -> None:
        """Satellites of two-line elements."""
        if not sets:
            return
        svs, nodes = tle_nodes(sets, self.span.node_ns, self.span.n_nodes)
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
        table = orbit_table(self.satellites, self.span.node_ns)
        delay = np.stack([delays_of(s) for s in self.satellites])
        channels = {s.sv: s.channel for s in self.satellites if s.sv >> 8 == SYS_R}
        records = make_records(self.span, table, self.satellites, ionosphere)
        sv = np.array([s.sv for s in self.satellites], dtype=np.int16)
        return TrueSky(sv, table, delay, channels, records, source)
