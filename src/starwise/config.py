"""Configuration of a run: every option, its unit, its default and its limits, in one place.

A configuration is a frozen dataclass, checked when it is made, whether it comes from Python, from a TOML file or
from the command line: an unknown key, a wrong type or a value outside its limits is a `StarwiseError` that names
the key. Add an option by adding a field with a type and, where it has limits, a `Range`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from starwise.checked import Checked as Checked
from starwise.checked import NotNegative as NotNegative
from starwise.checked import Positive as Positive
from starwise.checked import Probability as Probability
from starwise.checked import Range as Range
from starwise.checked import merged, nested, with_line
from starwise.checked import read_toml as read_toml
from starwise.config_errors import ErrorParameters
from starwise.config_noise import MeasurementNoise
from starwise.constants import SYSTEMS
from starwise.errors import StarwiseError
from starwise.gnsstime import parse_time
from starwise.signals import signal_id, sv_id


@dataclass(frozen=True)
class ProcessNoise(Checked):
    """Process model of the user's motion; what is None comes from the preset of `RunConfig.dynamics`.

    Spectral densities are those of the white noise that drives the model, per axis.
    """

    model: Literal["static", "velocity", "acceleration", "singer", "current"] | None = None
    """Fixed position, constant velocity, constant acceleration, Singer (Markov acceleration), or "current" statistical
    model (Markov acceleration about the predicted one, its variance by what is left to the largest one)."""
    position_psd_m2_per_s: NotNegative | None = None
    """Static: random walk of the position, m^2/s."""
    acceleration_psd_m2_per_s3: NotNegative | None = None
    """Constant velocity: white acceleration, m^2/s^3."""
    jerk_psd_m2_per_s5: NotNegative | None = None
    """Constant acceleration: white jerk, m^2/s^5."""
    acceleration_sigma_mps2: NotNegative | None = None
    """Singer: standard deviation of the acceleration, m/s^2."""
    acceleration_tau_s: Positive | None = None
    """Singer, "current": correlation time of the acceleration, s."""
    acceleration_max_mps2: Positive | None = None
    """"Current": largest acceleration, m/s^2."""


@dataclass(frozen=True)
class ClockNoise(Checked):
    """Process noise of the receiver's clock; None takes the filter's default."""

    bias_psd_m2_per_s: NotNegative | None = None
    """White frequency noise, m^2/s."""
    drift_psd_m2_per_s3: NotNegative | None = None
    """Random walk of the frequency, m^2/s^3."""
    intersystem_psd_m2_per_s: NotNegative | None = None
    """Random walk of the clock of a system against the first system's, m^2/s."""
    isolate: bool = False
    """ekf, s3ekf: name constellations whose codes leave those of all others together, for receivers at rest. The clocks
    are tied in any case; this believes the majority of the satellites where the common clock is not known, and lists
    ``events``."""


WEIGHTING_RULES: Final = ("iae_r", "sage_husa_r", "huber", "igg3")
"""Adaptation rules that change the variances of measurements."""


@dataclass(frozen=True)
class RunConfig(Checked):
    """Options of ``starwise solve``; the effective values stand in ``run.json`` beside every result."""

    method: Literal["lsq", "ekf", "s3ekf", "federated"] = "s3ekf"
    """Least squares per epoch, EKF (all satellites at once), EKF satellite by satellite, or one of these per
    constellation, fused by a master that takes faulty constellations out."""
    share: str = "auto"
    """federated: parts of what the constellations have in common, ``G=0.4,R=0.1,...``; auto: by their accuracy."""
    systems: str = "GRECJ"
    """Satellite systems to position with, letters as in RINEX."""
    dynamics: Literal["auto", "static", "pedestrian", "vehicle", "aircraft"] = "auto"
    """Preset of the process model; sets what `process` leaves open. auto: static where the observations show rest
    throughout, else vehicle."""
    mask_deg: Annotated[float, Range(-5.0, 90.0)] = 10.0
    """Elevation mask, degrees."""
    cn0_min_dbhz: Annotated[float, Range(0.0, 99.0)] = 0.0
    """Rows with a known C/N0 below this are not used, dB-Hz."""
    signals: dict[str, tuple[str, ...]] | None = None
    """Preference of signals by system letter, like ``{"G": ["1C", "2W"]}``; None: the built-in table."""
    combination: Literal["auto", "single", "uncombined", "ionosphere_free"] = "auto"
    """One signal per satellite, two beside each other, or their ionosphere-free combination; auto: two with the
    coloured error model, which has states for what they differ in, and one with the white."""
    ionosphere: Literal["broadcast", "none"] = "broadcast"
    troposphere: Literal["seasonal", "saastamoinen", "none"] = "seasonal"
    """Mean weather of latitude and season mapped by Niell, or Saastamoinen in a standard atmosphere over sin(el)."""
    weighting: Literal["standard"] = "standard"
    """Measurement variance from elevation, C/N0 and the accuracy the ephemeris claims."""
    adaptation: Literal[
        "none", "fading", "fading_improved", "strong_tracking", "iae_r", "iae_q", "sage_husa_r", "sage_husa_q",
        "huber", "igg3",
    ] = "none"  # fmt: skip
    """Rule by which filters change P, Q or R from innovations; those of R are for white errors only."""
    error_model: Literal["colored", "white"] = "colored"
    """Range errors as states that last, on two frequencies; or independent from epoch to epoch, on one."""
    exclude: tuple[str, ...] = ()
    """Satellites never to be used, like ``["G05", "R12"]``."""
    fde: bool = True
    """Least squares: fault detection and exclusion by residuals."""
    gate_probability: Annotated[float, Range(0.0, 0.5, open_low=True)] = 1e-3
    """Chance that the filter's gate refuses a satellite whose errors are as modelled."""
    post: bool = False
    """Allow broadcast records transmitted after the epoch (nearest in time); false: what a receiver had then."""
    start: str | None = None
    """First epoch: ``2024-03-30T12:00:00`` (GPST), with ``Z`` UTC, or ``week:tow``."""
    end: str | None = None
    """Last epoch, written likewise."""
    interval_s: Annotated[float, Range(0.01, 86400.0)] | None = None
    """Use only epochs on multiples of this, s."""
    session_s: Annotated[float, Range(1.0, 31_536_000.0)] | None = None
    """Start the estimator anew after every so many seconds; None: once. For runs to be pooled in ``assess``."""
    process: ProcessNoise = field(default_factory=ProcessNoise)
    clock: ClockNoise = field(default_factory=ClockNoise)
    noise: MeasurementNoise = field(default_factory=MeasurementNoise)
    errors: ErrorParameters = field(default_factory=ErrorParameters)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.combination == "uncombined" and self.error_model == "white":
            raise StarwiseError(
                "two uncombined frequencies need states for the ionosphere",
                found="combination uncombined, error_model white",
                wanted="error_model colored",
            )
        if self.adaptation != "none" and self.method == "lsq":
            raise StarwiseError(
                "adaptation rules are of filters", found=f"adaptation {self.adaptation}, method lsq",
                wanted="method ekf, s3ekf or federated",
            )  # fmt: skip
        if self.adaptation in WEIGHTING_RULES and self.error_model == "colored":
            raise StarwiseError(
                "coloured errors have a scale and robust weights of their own: no other rule of R beside them",
                found=f"adaptation {self.adaptation}, error_model colored",
                wanted="error_model white, or a rule of P or Q",
            )
        if self.clock.isolate and (self.error_model == "white" or self.method in ("lsq", "federated")):
            raise StarwiseError(
                "'clock.isolate' is of the coloured filter of all constellations",
                found=f"method {self.method}, error_model {self.error_model}",
                wanted="method ekf or s3ekf, error_model colored (federated names them by itself)",
            )
        unknown = sorted(set(self.systems) - set(SYSTEMS))
        if not self.systems or unknown or len(set(self.systems)) != len(self.systems):
            raise StarwiseError(
                "systems: not letters, each once",
                found=self.systems,
                wanted=f"letters of {SYSTEMS}, like GRECJ",
            )
        if parse_shares(self.share) is not None and self.method != "federated":
            raise StarwiseError(
                "shares are of the federated filter", found=f"share {self.share}, method {self.method}",
                wanted="method federated",
            )  # fmt: skip
        for name in self.exclude:
            sv_id(name)
        for system, names in (self.signals or {}).items():
            if not names:
                raise StarwiseError(
                    f"'signals.{system}' is empty", found="[]", wanted="signals, or leave the system out"
                )
            if len(system) != 1 or system not in SYSTEMS:
                raise StarwiseError("signals: not a system", found=system, wanted=f"a letter of {SYSTEMS}")
            for name in names:
                signal_id(name)
        start, end = self.start_ns, self.end_ns
        if start is not None and end is not None and end < start:
            raise StarwiseError("end is before start", found=str(self.end), wanted=f"after {self.start}")

    @property
    def start_ns(self) -> int | None:
        """`start` as GPST, ns, or None."""
        return None if self.start is None else parse_time(self.start)

    @property
    def end_ns(self) -> int | None:
        """`end` as GPST, ns, or None."""
        return None if self.end is None else parse_time(self.end)


def parse_shares(text: str) -> dict[str, float] | None:
    """Shares by system letter of ``G=0.4,R=0.1``, as given; None: auto.

    Raises
    ------
    StarwiseError
        Not a list of systems with positive numbers.
    """
    if text.strip() == "auto":
        return None
    shares: dict[str, float] = {}
    for item in text.split(","):
        name, _, number = (part.strip() for part in item.partition("="))
        try:
            value = float(number)
        except ValueError:
            value = float("nan")
        wrong = ""
        if value != value:
            wrong = "'share' is not readable"
        elif len(name) != 1 or name not in SYSTEMS:
            wrong = "'share' names no satellite system"
        elif name in shares:
            wrong = "'share' names a system twice"
        elif not 0.0 < value < float("inf"):
            wrong = "'share' is not above zero"
        if wrong:
            raise StarwiseError(wrong, found=item, wanted="auto, or like G=0.4,R=0.1,E=0.3,C=0.2")
        shares[name] = value
    return shares


def load_config(path: str | Path | None = None, options: Mapping[str, Any] | None = None) -> RunConfig:
    """Configuration of a TOML file, with options that override it.

    Parameters
    ----------
    path : path-like, optional
        TOML file with the fields of `RunConfig` as keys, `process` and `clock` as tables.
    options : mapping, optional
        What overrides the file: fields of `RunConfig`; keys with a dot reach into the tables.

    Raises
    ------
    StarwiseError
        The file cannot be read or is not TOML; a key is unknown; a value does not fit.
    """
    data: dict[str, Any] = {}
    if path is not None:
        data = read_toml(Path(path))
        try:
            RunConfig.from_dict(data, file=str(path))
        except StarwiseError as error:
            raise with_line(error, Path(path)) from None
    return RunConfig.from_dict(merged(data, nested(options or {})))
