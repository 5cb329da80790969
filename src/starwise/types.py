"""The nouns: what readers and simulators make, filters consume and produce, and analysis reads.

Struct of arrays throughout; SI, ECEF and GPST inside. NaN means missing. A row that shares an index with another
noun is *row-aligned* with it, and says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from starwise.constants import N_EPH_PAR, N_TGD
from starwise.errors import StarwiseError
from starwise.signals import signal_name, sv_name

if TYPE_CHECKING:
    import polars as pl

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]
I2 = NDArray[np.int16]
U1 = NDArray[np.uint8]


@dataclass(frozen=True)
class Problem:
    """Something in an input that was dealt with, and how: counted, kept, shown; never silent."""

    file: str
    line: int
    """Line number (from 1) of the first case."""
    what: str
    count: int = 1


@dataclass(frozen=True)
class ObservationHeader:
    """What the header of an observation file says about station and receiver; empty text where it is silent."""

    version: str = ""
    marker: str = ""
    receiver: str = ""
    antenna: str = ""
    approx_pos_e: tuple[float, float, float] | None = None
    """Approximate marker position, ECEF m, in whatever frame the operator uses (ETRS89 in Europe)."""
    antenna_hen: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Antenna reference point above the marker: height, east, north, m."""
    interval_s: float | None = None
    time_system: str = "GPS"
    cn0_unit: str = ""
    """SIGNAL STRENGTH UNIT as the header has it; empty where it is silent (RINEX 2 and many others)."""
    clock_applied: bool = False
    """RCV CLOCK OFFS APPL: the receiver's clock offset is already in the observations and epochs."""
    signals: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Observation codes by system letter, in file order (RINEX 2 codes translated to RINEX 3 names)."""


@dataclass(frozen=True)
class Observations:
    """Observations: a row per (epoch, satellite, signal), sorted by epoch, then satellite, then file order.

    A satellite listed in an epoch whose values are all blank keeps one row per signal that its system declares
    first, all NaN, so that "missing" can be told from "not in view".

    Attributes
    ----------
    t_ns : (n_epochs,) int64
        Receiver time tags in GPST, ns (receiver clock error included), strictly increasing.
    offsets : (n_epochs + 1,) int64
        Rows of epoch i are ``offsets[i]:offsets[i + 1]``.
    flag : (n_epochs,) uint8
        RINEX epoch flag: 0 ok, 1 power failure since the epoch before.
    clock_offset_s : (n_epochs,) float64
        Receiver clock offset as written in the file, s, NaN where absent.
    sv : (n_rows,) int16
        Satellite identifier (`starwise.signals.sv_id`).
    sig : (n_rows,) int16
        Signal identifier (`starwise.signals.signal_id`).
    code_m : (n_rows,) float64
        Pseudorange, m.
    phase_cyc : (n_rows,) float64
        Carrier phase, cycles.
    doppler_hz : (n_rows,) float64
        Doppler shift, Hz, positive when approaching.
    cn0_dbhz : (n_rows,) float64
        Carrier to noise density, dB-Hz.
    lli : (n_rows,) uint8
        Loss of lock indicator of the phase (RINEX 3.05 table A3 notes), 0 where blank.
    channels : dict
        GLONASS frequency channel by satellite identifier, as far as the source knows it.
    header : ObservationHeader
    problems : tuple of Problem
    """

    t_ns: I8
    offsets: I8
    flag: U1
    clock_offset_s: F8
    sv: I2
    sig: I2
    code_m: F8
    phase_cyc: F8
    doppler_hz: F8
    cn0_dbhz: F8
    lli: U1
    channels: dict[int, int] = field(default_factory=dict)
    header: ObservationHeader = field(default_factory=ObservationHeader)
    problems: tuple[Problem, ...] = ()

    @property
    def n_epochs(self) -> int:
        """Number of epochs."""
        return len(self.t_ns)

    @property
    def n_rows(self) -> int:
        """Number of (epoch, satellite, signal) rows."""
        return len(self.sv)

    def epoch_of_row(self) -> I8:
        """Epoch index of every row, (n_rows,) int64."""
        return np.repeat(np.arange(self.n_epochs, dtype=np.int64), np.diff(self.offsets))

    def between(
        self, start_ns: int | None = None, end_ns: int | None = None, interval_s: float | None = None
    ) -> "Observations":
        """Observations with epochs in [start, end] and, if asked, only those on multiples of ``interval_s``.

        An epoch counts as on a multiple when its tag is within 5 ms of it (receivers whose clock runs free tag
        epochs a few ms off the grid), or within a quarter of an interval shorter than 20 ms.
        """
        keep = np.ones(self.n_epochs, dtype=bool)
        if start_ns is not None:
            keep &= self.t_ns >= start_ns
        if end_ns is not None:
            keep &= self.t_ns <= end_ns
        if interval_s is not None:
            step = round(interval_s * 1e9)
            tick = min(10_000_000, step // 2)
            if step < 10_000_000:
                raise StarwiseError("interval too short", found=f"{interval_s} s", wanted="at least 0.01 s")
            # Distance to the nearest multiple, within 5 ms either way: tags drift, and steps need not be round.
            keep &= (self.t_ns + tick // 2) % step < tick
        return self.taken(keep)

    def taken(self, keep: NDArray[np.bool_]) -> "Observations":
        """Observations with the epochs that ``keep`` (n_epochs,) marks."""
        if keep.all():
            return self
        rows = np.repeat(keep, np.diff(self.offsets))
        counts = np.diff(self.offsets)[keep]
        return Observations(
            t_ns=self.t_ns[keep],
            offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
            flag=self.flag[keep],
            clock_offset_s=self.clock_offset_s[keep],
            sv=self.sv[rows],
            sig=self.sig[rows],
            code_m=self.code_m[rows],
            phase_cyc=self.phase_cyc[rows],
            doppler_hz=self.doppler_hz[rows],
            cn0_dbhz=self.cn0_dbhz[rows],
            lli=self.lli[rows],
            channels=self.channels,
            header=self.header,
            problems=self.problems,
        )

    def to_polars(self) -> "pl.DataFrame":
        """Flat table with names in place of identifiers: one row per (epoch, satellite, signal)."""
        import polars as pl

        svs, sv_at = np.unique(self.sv, return_inverse=True)
        sigs, sig_at = np.unique(self.sig, return_inverse=True)
        return pl.DataFrame(
            {
                "t_gpst_ns": np.repeat(self.t_ns, np.diff(self.offsets)),
                "sv": pl.Series([sv_name(int(s)) for s in svs], dtype=pl.String).gather(sv_at),
                "signal": pl.Series([signal_name(int(s)) for s in sigs], dtype=pl.String).gather(sig_at),
                "code_m": self.code_m,
                "phase_cyc": self.phase_cyc,
                "doppler_hz": self.doppler_hz,
                "cn0_dbhz": self.cn0_dbhz,
                "lli": self.lli,
            }
        )


@dataclass(frozen=True)
class IonosphereModel:
    """Broadcast ionosphere coefficients. Klobuchar: 4 alpha, 4 beta (s, s/semicircle ...), IS-GPS-200N 20.3.3.5.2.5.

    ``klobuchar[system letter]`` is an (8,) array alpha0..3, beta0..3; ``nequick`` is (ai0, ai1, ai2) of Galileo;
    both may be empty. Where several sets were broadcast, ``history`` keeps (t_ns, system letter, values) in time order.
    """

    klobuchar: dict[str, F8] = field(default_factory=dict)
    nequick: F8 | None = None
    history: tuple[tuple[int, str, tuple[float, ...]], ...] = ()


@dataclass(frozen=True)
class BroadcastRecords:
    """Broadcast navigation records of all systems: a row per record, sorted by satellite, then reference time.

    Attributes
    ----------
    sv : (n,) int16
        Satellite identifier.
    message : (n,) int8
        ``MSG_*`` of `starwise.constants` (RINEX 2 and 3: inferred from system and, for Galileo, data sources).
    toc_ns, toe_ns : (n,) int64
        Clock and ephemeris reference times, GPST ns. GLONASS and SBAS: both are the epoch of the record.
    t_tx_ns : (n,) int64
        Transmission time of the message, GPST ns (GLONASS: message frame time); where the file does not say, when
        such a data set is first sent as a rule (GPS 2 h before toe, Galileo 11 min after, BeiDou at toe).
    par : (n, N_EPH_PAR) float64
        Kepler records: columns ``K_*``; GLONASS and SBAS: ``R_*``; SI units and radians.
    tgd : (n, N_TGD) float64
        Group delays and inter-signal corrections, s, NaN where not broadcast.
    accuracy_m : (n,) float64
        1-sigma user range accuracy from URA / SISA / URAI, m; NaN if unknown, inf if "no prediction: do not use".
    health : (n,) int32
        Health word as broadcast; 0 is healthy in every system. GLONASS: Bn | l_n or other unhealthy flags.
    iode : (n,) int32
        IODE, IODnav, AODE or IODEC; -1 if none.
    iodc : (n,) int32
        IODC, AODC; -1 if none.
    fit_s : (n,) float64
        Fit interval, s, NaN if not given.
    source : (n,) int32
        Galileo data sources bits; others 0.
    ionosphere : IonosphereModel
    leap_s : int or None
        Leap seconds from the header.
    counts : dict
        Records read, duplicate, corrupt ... by name, for people.
    problems : tuple of Problem
    """

    sv: I2
    message: NDArray[np.int8]
    toc_ns: I8
    toe_ns: I8
    t_tx_ns: I8
    par: F8
    tgd: F8
    accuracy_m: F8
    health: I4
    iode: I4
    iodc: I4
    fit_s: F8
    source: I4
    ionosphere: IonosphereModel = field(default_factory=IonosphereModel)
    leap_s: int | None = None
    counts: dict[str, int] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.sv)
        if self.par.shape != (n, N_EPH_PAR) or self.tgd.shape != (n, N_TGD):
            raise ValueError(f"par {self.par.shape} and tgd {self.tgd.shape} must have {n} rows")

    @property
    def n(self) -> int:
        """Number of records."""
        return len(self.sv)


@dataclass(frozen=True)
class PreciseOrbits:
    """Tabulated orbits (and clocks) of an SP3 file: satellites x epochs.

    Attributes
    ----------
    t_ns : (n_epochs,) int64
        GPST, ns, strictly increasing.
    sv : (n_sv,) int16
    pos_e : (n_sv, n_epochs, 3) float64
        Centre of mass, ECEF (ITRF of the product), m; NaN where absent or bad.
    clock_s : (n_sv, n_epochs) float64
        Satellite clock, s (periodic relativity not included), NaN where absent.
    pos_sigma_m, clock_sigma_s : (n_sv, n_epochs) float64
        1 sigma as far as the file gives it, else NaN.
    predicted : (n_sv, n_epochs) bool
        Orbit flagged as predicted.
    time_system, frame, agency : str
    """

    t_ns: I8
    sv: I2
    pos_e: F8
    clock_s: F8
    pos_sigma_m: F8
    clock_sigma_s: F8
    predicted: NDArray[np.bool_]
    time_system: str = "GPS"
    frame: str = ""
    agency: str = ""
    problems: tuple[Problem, ...] = ()


@dataclass(frozen=True)
class PreciseClocks:
    """Satellite clocks of a RINEX CLK file, per satellite.

    Attributes
    ----------
    sv : (n_sv,) int16
    offsets : (n_sv + 1,) int64
        Samples of satellite i are ``offsets[i]:offsets[i + 1]``.
    t_ns : (n,) int64
        GPST, ns, strictly increasing within a satellite.
    clock_s, sigma_s : (n,) float64
    """

    sv: I2
    offsets: I8
    t_ns: I8
    clock_s: F8
    sigma_s: F8
    problems: tuple[Problem, ...] = ()


@dataclass(frozen=True)
class SatStates:
    """Satellites at transmission, row-aligned with the request.

    Attributes
    ----------
    pos_e, vel_e : (n, 3) float64
        ECEF *of the transmission instant* (the Earth's rotation during the flight is a term of the model), m, m/s.
    clock_s : (n,) float64
        Satellite clock offset including relativity, without group delay, s: t_sv = t + clock_s.
    drift : (n,) float64
        Its rate including relativity, s/s.
    relativity_s : (n,) float64
        The eccentricity term contained in ``clock_s``, s.
    sigma_m : (n,) float64
        1-sigma range accuracy claimed by the ephemeris, m.
    t_tx_ns : (n,) int64
        Transmission time, GPST ns.
    age_s : (n,) float64
        Transmission time minus reference time (toe), s; tabulated orbits: distance to the nearest node.
    status : (n,) int8
        ``SAT_*``; rows that are not ``SAT_OK`` hold NaN, except unhealthy ones that could be computed.
    record : (n,) int32
        Index of the broadcast record used (for group delays), -1 if none.
    """

    pos_e: F8
    vel_e: F8
    clock_s: F8
    drift: F8
    relativity_s: F8
    sigma_m: F8
    t_tx_ns: I8
    age_s: F8
    status: NDArray[np.int8]
    record: I4


class Ephemeris(Protocol):
    """Anything that knows where satellites are: broadcast, tabulated or simulated."""

    channels: dict[int, int]
    """GLONASS frequency channel by satellite identifier, as far as known."""
    notes: tuple[str, ...]
    """What was decided about the input that a user should know."""

    def states(self, t_rx_ns: I8, sv: I2, code_m: F8, post: bool = False) -> SatStates:
        """Satellite states at the transmission time of pseudoranges.

        Parameters
        ----------
        t_rx_ns : (n,) int64
            Receiver time tags, GPST ns.
        sv : (n,) int16
            Satellites.
        code_m : (n,) float64
            Pseudoranges, m: t_tx = t_rx - code / c - satellite clock, whatever the receiver clock is.
        post : bool
            Allow a record that was transmitted after ``t_rx_ns`` (post-processing).
        """
        ...

    def group_delay(self, record: I4, sv: I2, sig: I2, sig2: I2) -> F8:
        """Group delay, m, to *subtract* from the satellite clock times c, for one signal or a combination.

        The modelled pseudorange is ``range - c * clock_s + group_delay + ...``.

        Parameters
        ----------
        record, sv : (n,)
            From `SatStates` and the request.
        sig, sig2 : (n,) int16
            Signals; ``sig2`` 0 for a single frequency, else the second of the ionosphere-free combination.

        Returns
        -------
        (n,) float64
            NaN where the delay of that signal is not known.
        """
        ...


@dataclass(frozen=True)
class Sightings:
    """What a positioning filter takes: one row per (epoch, satellite) with the chosen signal or combination.

    Rows are sorted by epoch. Everything here is independent of the receiver's position.

    Attributes
    ----------
    t_ns : (n_epochs,) int64
    offsets : (n_epochs + 1,) int64
    sv : (n,) int16
    sig, sig2 : (n,) int16
        Chosen signal, and the second of the ionosphere-free combination or 0.
    row, row2 : (n,) int64
        Row in `Observations` of either signal, -1 for none.
    code_m : (n,) float64
        Pseudorange (or its combination), m.
    rate_mps : (n,) float64
        Pseudorange rate -lambda D, m/s; NaN without Doppler.
    cn0_dbhz : (n,) float64
    freq_hz : (n,) float64
        Carrier of ``sig``; scales the ionosphere.
    noise_factor : (n,) float64
        Amplification of code noise by the combination: 1, or about 3 for ionosphere-free.
    status : (n,) uint8
        ``ROW_USED`` or the reason why the row cannot be used.
    """

    t_ns: I8
    offsets: I8
    sv: I2
    sig: I2
    sig2: I2
    row: I8
    row2: I8
    code_m: F8
    rate_mps: F8
    cn0_dbhz: F8
    freq_hz: F8
    noise_factor: F8
    status: U1


@dataclass(frozen=True)
class Inertial:
    """Readings of an inertial measurement unit, body axes forward, right, down.

    Attributes
    ----------
    t_ns : (n,) int64
        GPST, ns, strictly increasing; increments belong to the interval that ends there.
    dt_s : (n,) float64
        Length of the interval, s.
    gyro : (n, 3) float64
        Angular rate against inertial space, rad/s; or its integral over the interval, rad.
    accel : (n, 3) float64
        Specific force, m/s^2; or its integral over the interval (in the turning body axes), m/s.
    increments : bool
        Whether the readings are integrals.
    problems : tuple of Problem
        What a reader found and dealt with. A gap is where ``dt_s`` is shorter than the step of ``t_ns``.
    """

    t_ns: I8
    dt_s: F8
    gyro: F8
    accel: F8
    increments: bool
    problems: tuple[Problem, ...] = ()


@dataclass(frozen=True)
class Fixes:
    """Positions (and velocities) from elsewhere, each with the time it is valid for and the time it is there.

    Sorted by ``available_ns``, then ``t_ns``.

    Attributes
    ----------
    t_ns : (n,) int64
        Time that the fix is valid for, GPST ns.
    available_ns : (n,) int64
        Time from which on it can be used, GPST ns; never before ``t_ns``.
    pos_e : (n, 3) float64
        ECEF, m; NaN where there is none.
    cov_pos : (n, 3, 3) float64
        ECEF, m^2.
    vel_e : (n, 3) float64 or None
        ECEF, m/s; NaN where there is none.
    cov_vel : (n, 3, 3) float64 or None
        ECEF, m^2/s^2.
    source : str
        Where they came from, for people.
    problems : tuple of Problem
    """

    t_ns: I8
    available_ns: I8
    pos_e: F8
    cov_pos: F8
    vel_e: F8 | None = None
    cov_vel: F8 | None = None
    source: str = ""
    problems: tuple[Problem, ...] = ()

    @property
    def n(self) -> int:
        """Number of fixes."""
        return len(self.t_ns)


@dataclass(frozen=True)
class Layout:
    """Names of the state's elements, in order: ``pos.x``, ``vel.y``, ``acc.z``, ``clk.G``, ``drift.C`` ..."""

    names: tuple[str, ...]

    def __post_init__(self) -> None:
        if len(set(self.names)) != len(self.names):
            raise ValueError(f"names appear twice in {self.names}")

    def __len__(self) -> int:
        return len(self.names)

    def index(self, name: str) -> int:
        """Position of a name; KeyError if the state has no such element."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(name) from None

    def indices(self, names: Sequence[str]) -> NDArray[np.intp]:
        """Positions of several names."""
        return np.array([self.index(n) for n in names], dtype=np.intp)

    def __contains__(self, name: object) -> bool:
        return name in self.names


@dataclass(frozen=True)
class State:
    """A Gaussian belief about named elements at a time.

    Attributes
    ----------
    t_ns : int
        GPST, ns.
    layout : Layout
        Names of the n elements.
    x : (n,) float64
        Mean, SI (clock in metres).
    P : (n, n) float64
        Covariance, symmetric.
    """

    t_ns: int
    layout: Layout
    x: F8
    P: F8

    def plus(self, dx: F8) -> "State":
        """Belief with ``dx`` added to the mean."""
        return State(self.t_ns, self.layout, self.x + dx, self.P)

    def moved_to(self, layout: Layout, prior: dict[str, tuple[float, float]] | None = None) -> "State":
        """Belief re-ordered by name to ``layout``.

        Parameters
        ----------
        layout : Layout
            Elements wanted. Those that vanish are marginalised out.
        prior : dict, optional
            Mean and *variance* of elements that are new; they start uncorrelated with the rest.

        Raises
        ------
        KeyError
            An element is new and has no prior.
        """
        n = len(layout)
        x, P = np.empty(n), np.zeros((n, n))
        old = [(i, self.layout.index(name)) for i, name in enumerate(layout.names) if name in self.layout]
        for i, name in enumerate(layout.names):
            if name not in self.layout:
                x[i], P[i, i] = (prior or {})[name]
        if old:
            to = np.array([i for i, _ in old])
            at = np.array([j for _, j in old])
            x[to] = self.x[at]
            P[np.ix_(to, to)] = self.P[np.ix_(at, at)]
        return State(self.t_ns, layout, x, P)


@dataclass(frozen=True)
class Linear:
    """All that a filter sees of a sensor: linearised rows with uncorrelated errors (whiten before returning).

    Attributes
    ----------
    v : (m,) float64
        Innovation: measured minus predicted.
    H : (m, n) float64
        Jacobian of the prediction in the state's elements.
    r : (m,) float64
        Variance of each row's error.
    row : (m,) int64
        Where the row came from (index in the sensor's own noun), for the ledger.
    """

    v: F8
    H: F8
    r: F8
    row: I8


@dataclass(frozen=True)
class Innovation:
    """What an update did with its rows: innovation, its variance, whether it was used.

    Attributes
    ----------
    v : (m,) float64
        Innovation at the moment when the row was processed.
    s : (m,) float64
        Its variance H P H' + r at that moment.
    used : (m,) bool
    row : (m,) int64
    nis : float
        Normalised innovation squared of the used rows together, chi-square with ``dof`` degrees of freedom.
    dof : int
    """

    v: F8
    s: F8
    used: NDArray[np.bool_]
    row: I8
    nis: float
    dof: int


@dataclass(frozen=True)
class Solution:
    """A trajectory with its covariance, the ledger of every measurement, and where it came from.

    Attributes
    ----------
    t_ns : (n,) int64
        Time tags of the epochs, GPST ns.
    status : (n,) uint8
        ``EPOCH_*``.
    pos_e, vel_e : (n, 3) float64
        ECEF, m and m/s; NaN where there is none.
    cov_pos, cov_vel : (n, 3, 3) float64
        Covariances, ECEF, m^2 and m^2/s^2.
    clock_m : (n, n_clocks) float64
        Receiver clock bias per system, m, columns as ``clock_names``; NaN where not estimated.
    drift_mps : (n, n_clocks) float64
    clock_sigma_m : (n, n_clocks) float64
    clock_names : tuple of str
        System letters.
    n_used : (n,) int32
        Satellites used.
    dop : (n, 4) float64
        GDOP, PDOP, HDOP, VDOP of the satellites used; NaN where not defined.
    nis : (n,) float64
        Normalised innovation (filters) or residual (least squares) squared of the epoch.
    dof : (n,) int32
        Its degrees of freedom.
    ledger : dict of (m,) arrays
        Columns row-aligned with each other; see `docs/formats.md`.
    provenance : dict
        Version, effective configuration, hashes of inputs, summary.
    extra : dict of (n,) float64
        What else was estimated, by the name of its column in the files (unit last): attitude, sensor biases.
    """

    t_ns: I8
    status: U1
    pos_e: F8
    vel_e: F8
    cov_pos: F8
    cov_vel: F8
    clock_m: F8
    drift_mps: F8
    clock_sigma_m: F8
    clock_names: tuple[str, ...]
    n_used: I4
    dop: F8
    nis: F8
    dof: I4
    ledger: dict[str, NDArray[Any]] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    extra: dict[str, F8] = field(default_factory=dict)

    @property
    def n_epochs(self) -> int:
        """Number of epochs, solved or not."""
        return len(self.t_ns)

    @property
    def has_position(self) -> NDArray[np.bool_]:
        """Epochs with a position, whatever its status."""
        return np.asarray(np.isfinite(self.pos_e).all(axis=1))

    @property
    def plot(self) -> Any:
        """Pictures for papers: ``plot.track()``, ``.errors(truth)``, ``.sky()``, ``.nis()``; each a matplotlib Figure.

        A `starwise.report.figures.Plots`, which stands floors above this noun and is looked up when asked for.
        """
        from importlib import import_module

        return import_module("starwise.report.figures").Plots(self)


@dataclass(frozen=True)
class Truth:
    """Where the antenna really was: one point, or a trajectory.

    Attributes
    ----------
    pos_e : (3,) or (n, 3) float64
        ECEF, m.
    t_ns : (n,) int64 or None
        GPST, ns, increasing; None for one point.
    source : str
        Where it came from, for people.
    vel_e : (n, 3) float64 or None
        ECEF, m/s, where known.
    """

    pos_e: F8
    t_ns: I8 | None = None
    source: str = ""
    vel_e: F8 | None = None
