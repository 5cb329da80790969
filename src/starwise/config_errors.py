"""Parameters of the coloured error model, as ``[errors]`` of a configuration file."""

from dataclasses import dataclass
from typing import Annotated

from starwise.checked import Checked, NotNegative, Positive, Range


@dataclass(frozen=True)
class ErrorParameters(Checked):
    """Sizes and correlation times of range errors; one set for every receiver, place and day.

    Sigmas in metres at one standard deviation, times in seconds. The defaults were found by ``starwise calibrate``
    (see docs/error-model.md); the states themselves are described in `starwise.kernels.error_states`.
    """

    slow_gps_m: NotNegative = 0.8
    """Orbit and clock of a satellite, common to its signals."""
    slow_glonass_m: NotNegative = 2.5
    slow_galileo_m: NotNegative = 0.3
    slow_beidou_m: NotNegative = 1.0
    slow_beidou_geo_m: NotNegative = 1.8
    slow_qzss_m: NotNegative = 1.0
    slow_tau_s: Positive = 3600.0
    precise_fraction: NotNegative = 0.7
    """The same with precise orbits and clocks, as a fraction: group delays and antenna offsets remain."""
    ionosphere_fraction: NotNegative = 0.13
    """Slant delay of a satellite, remainder as a fraction of the broadcast model."""
    ionosphere_floor_m: NotNegative = 0.1
    ionosphere_tau_s: Positive = 2400.0
    vertical_fraction: NotNegative = 0.3
    """Zenith delay of the whole sky, remainder as a fraction of the broadcast model."""
    vertical_floor_m: NotNegative = 0.3
    gradient_fraction: NotNegative = 0.2
    """Its slope to the north and east, per 1000 km."""
    gradient_floor_m: NotNegative = 0.2
    vertical_tau_s: Positive = 4800.0
    troposphere_m: NotNegative = 0.1
    """Zenith delay of the troposphere."""
    troposphere_tau_s: Positive = 7200.0
    slope_m: NotNegative = 0.25
    """Elevation-dependent code error of receiver and antenna, times (1 / sin el - 1.5)."""
    receiver_bias_m: NotNegative = 30.0
    """Code bias of a receiver between two signals of a system."""
    signal_bias_m: NotNegative = 0.2
    """Code bias of a satellite's signal."""
    signal_bias_glonass_m: NotNegative = 1.4
    signal_tau_s: Positive = 14400.0
    code_white_m: NotNegative = 0.25
    """White noise of a code at the zenith and 45 dB-Hz."""
    code_white_glonass_m: NotNegative = 0.5
    multipath_m: NotNegative = 0.3
    """Multipath of a code at the zenith; over sin of the elevation."""
    multipath_tau_s: Positive = 16.0
    multipath_length_m: Positive = 3.0
    """Travel over which multipath changes."""
    weak_cn0_dbhz: Annotated[float, Range(0.0, 60.0)] = 33.0
    """C/N0 at which reflections and diffraction are `weak_m`."""
    weak_m: NotNegative = 8.0
    weak_decade_db: Positive = 8.0
    """Loss of C/N0 over which they grow tenfold."""
    weak_share: Annotated[float, Range(0.0, 1.0)] = 0.95
    """Part of their variance that lasts; the rest is white."""
    rate_motion: NotNegative = 0.01
    """Noise of a pseudorange rate per speed of the receiver,"""
    rate_weak_per_m: NotNegative = 0.002
    """and the same per metre of weak-signal sigma: reflections have Doppler shifts of other directions."""
    scale_max: Annotated[float, Range(1.0, 100.0)] = 6.0
    """Largest factor by which innovations may raise the sigmas of code noise and multipath,"""
    scale_rise_s: Positive = 20.0
    """time in which they do,"""
    scale_fall_s: Positive = 900.0
    """and in which the factor returns to one."""
    late_sigma: Positive = 1.5
    """Innovation of a code, in sigmas, from which it counts less: codes that are late are suspect,"""
    early_sigma: Positive = 1.5
    """and those that are early, and rates."""
    floor_m: NotNegative = 0.25
    """Error of a position per axis that no state describes."""
    absent_s: Positive = 1200.0
    """Time after which a satellite out of view is forgotten."""
