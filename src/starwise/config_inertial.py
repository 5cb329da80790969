"""Configuration of inertial navigation: sensors, vehicle and constraints, with their units and defaults.

The defaults are those of a MEMS unit in a car. Errors of a sensor are stated as data sheets state them; what a car's
engine does to it is `vibration`.
"""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from starwise.checked import Checked, NotNegative, Positive, Range
from starwise.errors import StarwiseError


@dataclass(frozen=True)
class GyroNoise(Checked):
    """Errors of the gyroscopes, 1 sigma."""

    white_dprh: NotNegative = 0.3
    """White noise (angle random walk), deg/sqrt(h)."""
    bias_dph: NotNegative = 1000.0
    """Bias at the start, unless rest gives it, deg/h."""
    in_run_dph: NotNegative = 100.0
    """Size of the changes of the bias (first-order Markov), deg/h."""
    in_run_tau_s: Positive = 300.0
    """Their correlation time, s."""
    scale_ppm: NotNegative = 0.0
    """Scale factor error, ppm; estimated if not 0."""
    vibration: NotNegative = 0.3
    """Part of the scatter from reading to reading (over 0.5 s) that is white noise: vibration folded down."""


@dataclass(frozen=True)
class AccelNoise(Checked):
    """Errors of the accelerometers, 1 sigma."""

    white_mpsrh: NotNegative = 0.1
    """White noise (velocity random walk), m/s/sqrt(h)."""
    bias_ug: NotNegative = 30_000.0
    """Bias at the start, micro-g."""
    in_run_ug: NotNegative = 2000.0
    """Size of the changes of the bias (first-order Markov), micro-g."""
    in_run_tau_s: Positive = 300.0
    """Their correlation time, s."""
    scale_ppm: NotNegative = 0.0
    """Scale factor error, ppm; estimated if not 0."""
    vibration: NotNegative = 0.2
    """As for the gyroscopes."""


@dataclass(frozen=True)
class VehicleConfig(Checked):
    """What the vehicle can and cannot do, and how the sensor sits in it."""

    constraint: bool = False
    """The axle that does not steer goes where it points (no sliding sideways, no jumping): cars, trains."""
    rest: bool = False
    """Zero velocity and zero rate where the readings are quiet."""
    mount_pitch_deg: float = 0.0
    """Attitude of the declared sensor axes in the vehicle: pitch ..."""
    mount_yaw_deg: float = 0.0
    """... and yaw, deg; estimated from there."""
    mount_sigma_deg: NotNegative = 10.0
    axle_m: float = 0.0
    """Distance of the unsteered axle ahead of the sensor (behind: negative), m; estimated from there."""
    axle_sigma_m: NotNegative = 1.5
    slip_sigma_mps: Positive = 0.05
    """Error of the lateral constraint, m/s, 1 sigma, independent at `interval_s`."""
    bounce_sigma_mps: Positive = 0.1
    """Error of the vertical constraint, m/s."""
    steer_sigma: NotNegative = 0.005
    """Sideslip per lateral and squat per longitudinal acceleration, rad/(m/s^2); estimated if not 0."""
    interval_s: Positive = 0.5
    """Interval of constraints, s: their errors last for some tenths of a second."""


@dataclass(frozen=True)
class InertialConfig(Checked):
    """Options of inertial navigation with fixes or satellites."""

    method: Literal["loose", "tight"] = "loose"
    """Fixes, or pseudoranges and Doppler satellite by satellite."""
    lever_arm_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Antenna as seen from the sensor, in the declared axes (forward, right, down), m."""
    lever_arm_sigma_m: NotNegative = 0.0
    """Estimate the lever arm if not 0."""
    time_offset_sigma_s: NotNegative = 0.0
    """Estimate a time offset of fixes (a tag t is of t + offset) if not 0; for small ones, below 0.15 s."""
    velocity_lag_s: Annotated[float, Range(-1.0, 1.0)] = 0.0
    """Velocities of fixes are valid so long before their tags, s (filters of receivers)."""
    use_velocity: bool = True
    fix_sigma_m: NotNegative = 0.0
    """1 sigma of fixes that claim none (NMEA, columns that are absent or zero), m per axis; 0: they are not used."""
    velocity_sigma_mps: NotNegative = 0.0
    """The same for their velocities, m/s."""
    gyro: GyroNoise = field(default_factory=GyroNoise)
    accel: AccelNoise = field(default_factory=AccelNoise)
    constant_bias: bool = False
    """Estimate constant parts of the biases beside the Markov ones, instead of one sum."""
    vehicle: VehicleConfig = field(default_factory=VehicleConfig)
    alignment: Literal["velocity", "gyrocompass"] = "velocity"
    """Heading at the start: direction of motion (ground vehicles), or the Earth's rotation, at rest."""
    alignment_speed_mps: Positive = 3.0
    """Speed from which the direction of motion is a heading, m/s."""
    smooth: bool = False
    """Fixed-interval smoothing: every epoch from all measurements, before and after it."""
    output_rate_hz: NotNegative = 0.0
    """Epochs per second beside those of the fixes; 0: none."""
    max_gap_s: Positive = 2.0
    """Longest gap of the readings to bridge, s; after a longer one the filter starts again."""
    baro_sigma_m: Positive = 5.0
    """Slow error of barometric heights, m, where such are given."""
    odometer_scale_sigma: NotNegative = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.lever_arm_m) != 3:
            found = str(list(self.lever_arm_m))
            raise StarwiseError("'lever_arm_m' is not three numbers", found=found, wanted="forward, right, down")
