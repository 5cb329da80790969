"""Sections of a scenario: ``[time] [vehicle] [sky] [receiver] [imu] [[faults]] [output]``, typed and checked."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from starwise.config import Checked, NotNegative, Positive, Range
from starwise.constants import NS, SYSTEMS
from starwise.errors import StarwiseError
from starwise.gnsstime import parse_time
from starwise.signals import FREQUENCY, signal_id, sv_id
from starwise.sim.segments import Segment

Constellation = Literal["gps", "glonass", "galileo", "beidou1", "beidou2", "beidou3", "qzss"]
SYSTEM_OF = {
    "gps": "G", "glonass": "R", "galileo": "E", "beidou1": "C", "beidou2": "C", "beidou3": "C", "qzss": "J",
}  # fmt: skip
"""RINEX letter of a constellation."""
DEFAULT_SIGNALS: dict[str, tuple[str, ...]] = {
    "G": ("1C", "5Q"), "R": ("1C", "2C"), "E": ("1C", "5Q"), "C": ("2I", "6I"), "J": ("1C", "5Q"),
}  # fmt: skip
Degrees = Annotated[float, Range(-360.0, 360.0)]
Size = Annotated[float, Range(0.0, 1e12)]


def _named(key: str, parse: Callable[[str], int], text: str) -> int:
    """What ``parse`` makes of a text; its error names the key."""
    try:
        return parse(text)
    except StarwiseError as error:
        raise StarwiseError(f"'{key}' is {error.message}", found=error.found, wanted=error.wanted) from None


@dataclass(frozen=True)
class Time(Checked):
    """``[time]``: when, how long, how often."""

    start: str
    """First epoch: ``2024-03-30T12:00:00`` (GPST), with ``Z`` UTC, or ``week:tow``."""
    duration_s: Annotated[float, Range(0.0, 7 * 86400.0, open_low=True)]
    """From the first to the last epoch, s."""
    interval_s: Annotated[float, Range(0.001, 86400.0)] = 1.0
    """Between measurement epochs of the receiver, s."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _named("start", parse_time, self.start)

    @property
    def start_ns(self) -> int:
        """First epoch, GPST ns."""
        return parse_time(self.start)

    @property
    def end_ns(self) -> int:
        """End of the simulated time, GPST ns."""
        return self.start_ns + round(self.duration_s * NS)


@dataclass(frozen=True)
class Vehicle(Checked):
    """``[vehicle]``: where it starts and what it does; or a recorded trajectory flown again."""

    kind: Literal["car", "aircraft"] = "car"
    """Both point their nose along the path; an aircraft banks in turns, a car stays level across."""
    start: tuple[float, ...] = ()
    """Latitude deg, longitude deg, ellipsoidal height m (WGS 84); of the body's origin, where the IMU is."""
    heading_deg: Degrees = 0.0
    """Course at the start, clockwise from north, degrees."""
    pitch_deg: Annotated[float, Range(-89.0, 89.0)] = 0.0
    """Pitch of the path at the start, degrees above the horizon."""
    speed_mps: Annotated[float, Range(0.0, 1e5)] = 0.0
    """Speed at the start, m/s."""
    segments: tuple[Segment, ...] = ()
    recorded: str | None = None
    """CSV file (path from the scenario's folder) with columns t_s, lat_deg, lon_deg, height_m and, all or none,
    heading_deg, pitch_deg, roll_deg; in place of start and segments."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.recorded is not None:
            if self.segments or self.start:
                raise StarwiseError("'recorded' excludes start and segments", found=self.recorded)
            return
        if len(self.start) != 3 or abs(self.start[0]) > 90.0 or abs(self.start[1]) > 360.0:
            raise StarwiseError(
                "'start' is not a place",
                found=str(list(self.start)),
                wanted="[latitude deg, longitude deg, height m]",
            )
        if not self.segments:
            raise StarwiseError("'segments' is missing", wanted="at least one [[vehicle.segments]]")


@dataclass(frozen=True)
class Sky(Checked):
    """``[sky]``: which satellites there are."""

    source: Literal["tables", "nav", "tle"] = "tables"
    """Nominal constellations of the package, broadcast navigation files, or two-line elements."""
    constellations: tuple[Constellation, ...] = ("gps", "glonass", "galileo", "beidou3")
    """Which to use; with files, the systems to take from them."""
    files: tuple[str, ...] = ()
    """Navigation or TLE files (paths from the scenario's folder)."""
    exclude: tuple[str, ...] = ()
    """Satellites that are not there, like ``["G05"]``."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.exclude:
            _named("exclude", sv_id, name)
        if (self.source == "tables") == bool(self.files):
            wanted = "no files with source tables" if self.files else f"the files of source {self.source}"
            raise StarwiseError("'files' does not fit the source", found=str(list(self.files)), wanted=wanted)
        if not self.constellations:
            raise StarwiseError("'constellations' is empty", wanted=" | ".join(SYSTEM_OF))


@dataclass(frozen=True)
class Noise(Checked):
    """``[receiver.noise]``: thermal noise, white, 1 sigma; the sizes hold at the zenith or at 45 dB-Hz.

    fixed: everywhere alike. elevation: over the sine of the elevation. cn0: times ``10^((45 - C/N0) / 20)``.
    """

    model: Literal["fixed", "elevation", "cn0"] = "cn0"
    code_m: NotNegative = 0.3
    phase_m: NotNegative = 0.002
    rate_mps: NotNegative = 0.05
    """Of the pseudorange rate; Doppler gets it over the wavelength."""
    cn0_zenith_dbhz: Annotated[float, Range(0.0, 99.0)] = 50.0
    cn0_horizon_dbhz: Annotated[float, Range(0.0, 99.0)] = 35.0
    cn0_sigma_db: NotNegative = 0.5


@dataclass(frozen=True)
class Clock(Checked):
    """``[receiver.clock]``: the oscillator and how the receiver handles it."""

    grade: Literal["perfect", "tcxo", "ocxo", "rubidium"] = "tcxo"
    h0_s: NotNegative | None = None
    """White frequency noise coefficient, s; None: the grade's."""
    hm2_per_s: NotNegative | None = None
    """Random walk frequency noise coefficient, 1/s; None: the grade's."""
    bias_s: float = 0.0
    """Offset at the start, s; positive: the receiver's clock is ahead."""
    drift: float = 0.0
    """Frequency offset at the start, s/s."""
    reset: Literal["none", "millisecond"] = "none"
    """millisecond: steered by whole milliseconds when it is more than half a millisecond off."""
    intersystem_m: dict[str, float] = field(default_factory=dict)
    """Constant receiver delay by system letter (against 0), m."""


@dataclass(frozen=True)
class Multipath(Checked):
    """``[receiver.multipath]``: code error per satellite and signal, first-order Markov; zero by default."""

    sigma_m: NotNegative = 0.0
    """At the zenith; over the sine of the elevation elsewhere."""
    tau_s: Positive = 30.0


@dataclass(frozen=True)
class Ionosphere(Checked):
    """``[receiver.ionosphere]``: the true delay, which need not be what a receiver corrects with."""

    model: Literal["none", "broadcast", "layer"] = "none"
    """none; Klobuchar with the broadcast coefficients times `scale`; a thin layer with a daily course."""
    scale: NotNegative = 1.2
    vtec_tecu: NotNegative = 20.0
    """layer: vertical electron content above the user at 14 h local time, TECU."""
    north_tecu_per_deg: float = -0.5
    east_tecu_per_deg: float = 0.1
    residual_m: NotNegative = 0.0
    """1 sigma of a first-order Markov process per satellite, slant L1 delay over the mapping, m."""
    residual_tau_s: Positive = 1800.0


@dataclass(frozen=True)
class Troposphere(Checked):
    """``[receiver.troposphere]``: the true delay."""

    model: Literal["none", "saastamoinen"] = "none"
    zenith_offset_m: float = 0.0
    """Added to the model's zenith delay, m."""
    residual_m: NotNegative = 0.0
    """1 sigma of a first-order Markov zenith delay, m."""
    residual_tau_s: Positive = 7200.0


@dataclass(frozen=True)
class EphemerisError(Checked):
    """``[receiver.ephemeris]``: what the navigation message has wrong, 1 sigma, first-order Markov per satellite."""

    model: Literal["given", "typical"] = "given"
    """given: the sizes below for every satellite; typical: those of each system (`broadcast_errors.TYPICAL`)."""
    radial_m: NotNegative = 0.0
    along_m: NotNegative = 0.0
    cross_m: NotNegative = 0.0
    clock_m: NotNegative = 0.0
    tau_s: Positive = 7200.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.model == "typical" and any(self.sizes):
            raise StarwiseError("'model' typical excludes sizes", wanted='model = "given", or no sizes')

    @property
    def sizes(self) -> tuple[float, float, float, float]:
        """Sizes given: radial, along track, cross track, clock, m."""
        return self.radial_m, self.along_m, self.cross_m, self.clock_m

    @property
    def is_none(self) -> bool:
        """Whether messages are right."""
        return self.model == "given" and not any(self.sizes)


@dataclass(frozen=True)
class Receiver(Checked):
    """``[receiver]``: antenna, signals, masks and errors of the satellite receiver."""

    signals: dict[str, tuple[str, ...]] = field(default_factory=lambda: dict(DEFAULT_SIGNALS))
    """Signals by system letter, like ``{G = ["1C", "5Q"]}``."""
    mask_deg: Annotated[float, Range(-5.0, 90.0)] = 5.0
    azimuth_masks_deg: tuple[tuple[float, ...], ...] = ()
    """``[azimuth from, azimuth to (clockwise), elevation]``: nothing is seen below, degrees."""
    lever_arm_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Antenna from the body's origin: forward, right, down, m."""
    doppler: bool = True
    phase: bool = True
    noise: Noise = field(default_factory=Noise)
    clock: Clock = field(default_factory=Clock)
    multipath: Multipath = field(default_factory=Multipath)
    ionosphere: Ionosphere = field(default_factory=Ionosphere)
    troposphere: Troposphere = field(default_factory=Troposphere)
    ephemeris: EphemerisError = field(default_factory=EphemerisError)

    def __post_init__(self) -> None:
        super().__post_init__()
        for system, names in self.signals.items():
            if len(system) != 1 or system not in SYSTEMS:
                raise StarwiseError("'signals' not a system", found=system, wanted=f"a letter of {SYSTEMS}")
            for name in names:
                band = _named("signals", signal_id, name) >> 8
                if (SYSTEMS.index(system), band) not in FREQUENCY and (system, band) not in (("R", 1), ("R", 2)):
                    raise StarwiseError("'signals' has no such band", found=f"{system} {name}")
        for mask in self.azimuth_masks_deg:
            if len(mask) != 3 or not -90.0 <= mask[2] <= 90.0:
                raise StarwiseError(
                    "'azimuth_masks_deg' has one that is none",
                    found=str(list(mask)),
                    wanted="[azimuth from, azimuth to, elevation], degrees",
                )
        if len(self.lever_arm_m) != 3:
            raise StarwiseError("'lever_arm_m' is not a place", wanted="[forward, right, down] in m")


@dataclass(frozen=True)
class Imu(Checked):
    """``[imu]``: inertial sensors at the body's origin; errors of the grade, or each given here.

    Sizes are 1 sigma; constant errors (bias, scale factor, misalignment) are drawn once per run and axis.
    """

    grade: Literal["perfect", "navigation", "tactical", "industrial", "consumer"] = "tactical"
    rate_hz: Annotated[float, Range(0.1, 10_000.0)] = 100.0
    output: Literal["rates", "increments"] = "increments"
    """Angular rate and specific force at the tag; or their integrals over the interval that ends there."""
    gyro_bias_dph: NotNegative | None = None
    gyro_arw_dprh: NotNegative | None = None
    """Angular random walk, deg/sqrt(h)."""
    gyro_markov_dph: NotNegative | None = None
    gyro_markov_tau_s: Positive | None = None
    gyro_scale_ppm: NotNegative | None = None
    gyro_misalignment_urad: NotNegative | None = None
    gyro_quantum_rad: NotNegative | None = None
    """Smallest angle increment, rad."""
    accel_bias_ug: NotNegative | None = None
    accel_vrw_mpsrh: NotNegative | None = None
    """Velocity random walk, m/s/sqrt(h)."""
    accel_markov_ug: NotNegative | None = None
    accel_markov_tau_s: Positive | None = None
    accel_scale_ppm: NotNegative | None = None
    accel_misalignment_urad: NotNegative | None = None
    accel_quantum_mps: NotNegative | None = None
    """Smallest velocity increment, m/s."""


@dataclass(frozen=True)
class Fault(Checked):
    """``[[faults]]``: something goes wrong for a while.

    =============  =====================================================================  =================
    kind           what happens                                                           unit of ``size``
    =============  =====================================================================  =================
    outage         nothing is received                                                    none
    step           a constant is added                                                    m, m/s (rate)
    ramp           an error grows from zero                                               m/s, m/s^2 (rate)
    cycle_slip     the phase jumps and stays (loss of lock is indicated once)             cycles
    spoof          code, phase and Doppler pulled off together, growing from zero         m/s
    clock_jump     the receiver's clock jumps and stays                                   m
    burst          white noise is added                                                   m, m/s (rate)
    =============  =====================================================================  =================

    For ``sensor`` gyro or accelerometer the unit is rad/s or m/s^2 (ramp: per second).
    """

    kind: Literal["outage", "step", "ramp", "cycle_slip", "spoof", "clock_jump", "burst"]
    sensor: Literal["gnss", "gyro", "accelerometer"] = "gnss"
    satellites: tuple[str, ...] = ()
    """Satellites or system letters, like ``["G05", "R"]``; empty: all."""
    signals: tuple[str, ...] = ()
    """Signals, like ``["1C"]``; empty: all."""
    observable: Literal["code", "phase", "rate", "all"] = "code"
    """What a step, ramp or burst acts on."""
    axes: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
    """Of an inertial sensor: forward, right, down."""
    start_s: NotNegative = 0.0
    """Since the start of the scenario, s."""
    duration_s: Positive | None = None
    """None: until the end."""
    size: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.satellites:
            if not (len(name) == 1 and name in SYSTEMS):
                _named("satellites", sv_id, name)
        for name in self.signals:
            _named("signals", signal_id, name)
        if self.kind != "outage" and self.size == 0.0:
            raise StarwiseError(f"'size' of a {self.kind} is missing", wanted="a number other than 0")
        if self.kind == "burst" and self.size < 0.0:
            raise StarwiseError("'size' of a burst is negative noise", found=f"{self.size:g}", wanted="above 0")
        if self.sensor != "gnss" and self.kind not in ("outage", "step", "ramp", "burst"):
            wanted = "outage | step | ramp | burst"
            raise StarwiseError(f"'kind' is not for the {self.sensor}", found=self.kind, wanted=wanted)
        if self.sensor != "gnss" and (self.satellites or self.signals):
            raise StarwiseError(f"'sensor' {self.sensor} has no satellites and signals")

    def active(self, t_s: Any) -> Any:
        """Whether the fault is on at times since the scenario's start, s (scalar or array)."""
        end = float("inf") if self.duration_s is None else self.start_s + self.duration_s
        return (t_s >= self.start_s) & (t_s < end)


@dataclass(frozen=True)
class Output(Checked):
    """``[output]``: what is written."""

    marker: str = "SIMU"
    """Four-character marker name of the files."""
    rinex: bool = True
    """Observation and navigation files, RINEX 3.05."""
    truth: Literal["parquet", "csv"] = "parquet"
    imu: bool = True
    """Inertial data as CSV, where the scenario has an IMU."""
