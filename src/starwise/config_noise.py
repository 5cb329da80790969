"""Noise of the receiver's measurements, as ``[noise]`` of a configuration file."""

from dataclasses import dataclass

from starwise.checked import Checked, Positive


@dataclass(frozen=True)
class MeasurementNoise(Checked):
    """White noise of codes and pseudorange rates, 1 sigma at the zenith and 45 dB-Hz; it grows towards the horizon."""

    code_m: Positive = 0.4
    """Codes with white errors (with coloured ones: ``errors.code_white_m``); GLONASS twice as much, m."""
    rate_mps: Positive = 0.1
    """Pseudorange rates (Doppler), m/s."""
