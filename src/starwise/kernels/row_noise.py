"""Variance of the noise of each row by itself: what an innovation's variance has that is not doubt about the states."""

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.error_states import ErrorModel, ErrorRows, motion_rate_variance, signal_sigmas
from starwise.kernels.rangemodel import RowModel, Rows

F8 = NDArray[np.float64]


@njit
def row_noise(
    errors: ErrorModel, rows: Rows, extra: ErrorRows, out: RowModel, speed2: F8, code: F8, code2: F8, rate: F8
) -> None:
    """Noise of codes and rates under the coloured error model, at its smallest scale.

    Parameters
    ----------
    errors : ErrorModel
    rows : Rows
    extra : ErrorRows
    out : RowModel
        Elevations, and the variance of rates at rest.
    speed2 : (n,) float64
        Squared speed of the receiver, (m/s)^2.
    code, code2, rate : (n,) float64
        Out: variances, m^2 and (m/s)^2; NaN where there is no such row.
    """
    for i in range(len(rows.code_m)):
        code[i], code2[i], rate[i] = np.nan, np.nan, np.nan
        if out.elevation[i] != out.elevation[i]:
            continue
        system, el, factor = rows.system[i], out.elevation[i], rows.noise_factor[i]
        white, lasting, _ = signal_sigmas(errors, system, el, rows.cn0_dbhz[i], factor, 1.0)
        code[i] = white + (0.0 if errors.multipath1 >= 0 else lasting * lasting)
        if extra.code2_m[i] == extra.code2_m[i]:
            white, lasting, _ = signal_sigmas(errors, system, el, extra.cn02_dbhz[i], factor, 1.0)
            code2[i] = white + (0.0 if errors.multipath2 >= 0 else lasting * lasting)
        rate[i] = out.rate_var[i] + motion_rate_variance(errors, rows.cn0_dbhz[i], speed2[i])
