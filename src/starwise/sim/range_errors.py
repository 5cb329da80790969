"""Range errors that last, drawn exactly as the coloured error model describes them.

The formulas are those in words of `starwise.kernels.error_states`, written once more in numpy over whole runs: a
filter on these errors is a filter in a world that is its model, and shares no code with it.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from starwise.kernels.error_states import ErrorModel, ErrorRows
from starwise.kernels.rangemodel import Epochs, RowModel, Rows
from starwise.types import F8

L1_HZ: Final = 1575.42e6
EARTH_KM: Final = 6371.0
SHELL_KM: Final = 450.0


def gauss_markov(steps_s: F8, rate: F8, shape: tuple[int, ...], rng: np.random.Generator) -> F8:
    """Stationary processes of unit variance with memory exp(-dt rate), one sample per epoch.

    Parameters
    ----------
    steps_s : (m - 1,)
        Time between the epochs.
    rate : (m - 1,)
        Reciprocal correlation time over each step, 1/s; 0: constant.
    shape : tuple of int
        Of the processes.

    Returns
    -------
    (m, *shape) float64
    """
    x = rng.standard_normal((len(steps_s) + 1, *shape))
    for k, f in enumerate(np.exp(-steps_s * rate)):
        x[k + 1] = f * x[k] + math.sqrt(1.0 - f * f) * x[k + 1]
    return x


def draw_range_errors(
    errors: ErrorModel,
    epochs: Epochs,
    rows: Rows,
    extra: ErrorRows,
    at_truth: RowModel,
    speed_mps: F8,
    rng: np.random.Generator,
) -> tuple[F8, F8]:
    """Errors of the codes of both signals, m, white noise included.

    Parameters
    ----------
    errors : ErrorModel
        Sizes and correlation times.
    epochs, rows, extra
        What is measured when; the codes themselves are not read, nor is ``extra.code2_m``.
    at_truth : RowModel
        Elevation, azimuth and modelled ionosphere delay of the rows, seen from the true position.
    speed_mps : (n_epochs,)
        True speed: motion shortens multipath.
    rng : numpy.random.Generator

    Returns
    -------
    code1_m, code2_m : (n,) float64
        The second is NaN where there is no second carrier.
    """
    steps = np.diff(epochs.t_ns) * 1e-9
    _, sat = np.unique(extra.sv, return_inverse=True)
    e = np.repeat(np.arange(len(epochs.t_ns)), np.diff(epochs.offsets))
    n_sat = int(sat.max()) + 1 if len(sat) else 0

    def lasting(tau_s: float, *shape: int) -> F8:
        return gauss_markov(steps, np.full(len(steps), 1.0 / tau_s), shape, rng)

    slow = lasting(errors.slow_tau, n_sat)[e, sat]
    sky = lasting(errors.vertical_tau, 3)[e]
    ionosphere = lasting(errors.ionosphere_tau, n_sat)[e, sat]
    troposphere = lasting(errors.troposphere_tau)[e]
    slope = rng.standard_normal(2)
    bias = np.append(rng.standard_normal(errors.n_bias), 0.0)  # the last one serves the references, -1
    el, az = at_truth.elevation, at_truth.azimuth
    s = np.maximum(np.sin(el), 0.05)
    mapping = 1.0 / np.sqrt(1.0 - (EARTH_KM / (EARTH_KM + SHELL_KM) * np.cos(el)) ** 2)
    away = EARTH_KM / 1000.0 * (0.5 * math.pi - el - np.arcsin(EARTH_KM / (EARTH_KM + SHELL_KM) * np.cos(el)))
    slant = at_truth.ionosphere * (rows.freq_hz / L1_HZ) ** 2
    zenith = slant / mapping
    of_sky = np.hypot(errors.vertical_fraction * zenith, errors.vertical_floor)
    of_sky = np.where(slant == 0.0, np.maximum(of_sky, 5.0), of_sky)
    gradient = np.hypot(errors.gradient_fraction * zenith, errors.gradient_floor) * away
    delay = ionosphere * np.hypot(errors.ionosphere_fraction * slant, errors.ionosphere_floor * mapping)
    delay += mapping * of_sky * sky[:, 0] + mapping * gradient * (np.cos(az) * sky[:, 1] + np.sin(az) * sky[:, 2])
    common = extra.slow_m * slow + errors.troposphere / (s + 0.02) * troposphere
    multipath_rate = 1.0 / errors.multipath_tau + speed_mps[1:] / errors.multipath_length
    codes = []
    for freq, cn0, which in (
        (rows.freq_hz, rows.cn0_dbhz, extra.bias1),
        (extra.freq2_hz, extra.cn02_dbhz, extra.bias2),
    ):
        signal = lasting(errors.signal_tau, n_sat)[e, sat] * errors.signal_bias[rows.system]
        reflected = gauss_markov(steps, multipath_rate, (n_sat,), rng)[e, sat]
        white = rng.standard_normal((2, len(e)))
        noise, lingering = _sizes(errors, rows.system, s, cn0, rows.noise_factor)
        code = common + np.where(freq < 1e12, (L1_HZ / freq) ** 2 * delay, 0.0)
        code += errors.slope * (1.0 / np.maximum(s, 0.1) - 1.5) * slope[np.where(freq > 1.4e9, 0, 1)]
        code += errors.receiver_bias * bias[which] + signal
        code += lingering * (reflected if errors.multipath else white[1]) + noise * white[0]
        codes.append(np.where(np.isfinite(freq) | (freq == np.inf), code, np.nan))
    return codes[0], codes[1]


def _sizes(errors: ErrorModel, system: NDArray[np.int64], s: F8, cn0: F8, factor: F8) -> tuple[F8, F8]:
    """Sigmas of white noise and of multipath, m."""
    known = np.where(np.isfinite(cn0), np.maximum(cn0, 10.0), np.inf)
    low = 10.0 ** (np.maximum(45.0 - known, 0.0) / 10.0)
    weak = (errors.weak_sigma * 10.0 ** ((errors.weak_cn0 - known) / errors.weak_decade)) ** 2
    thermal = (errors.code_white[system] * factor) ** 2 * (0.5 * low + 0.5 / s**2)
    multipath = (errors.multipath_sigma[system] / s) ** 2
    white = thermal + (1.0 - errors.weak_share) * weak
    return np.sqrt(white), np.sqrt(multipath + errors.weak_share * weak)
