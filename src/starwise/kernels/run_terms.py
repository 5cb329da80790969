"""What a filter believed of every row of a finished run: from its ledger, once more by the same functions.

The ledger holds what the variances and error states of a row are computed from (elevation, azimuth, C/N0, ionosphere)
and its innovations, so that the common factor on code noise, which follows them, can be followed again.
"""

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.colored import K_MAX, code_states
from starwise.kernels.error_states import ErrorModel, ErrorRows, Slots, adapt_scale, motion_rate_variance
from starwise.kernels.rangemodel import Epochs, ModelOptions, RowModel, Rows, variances

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]


@njit
def run_terms(
    options: ModelOptions, errors: ErrorModel, epochs: Epochs, rows: Rows, extra: ErrorRows, out: RowModel, fresh: U1,
    speed2: F8, lasting: F8, white: F8, rate: F8, scale: F8,
) -> None:  # fmt: skip
    """Variances of lasting errors, of white noise and of rates of all rows of a run.

    Parameters
    ----------
    options : ModelOptions
    errors : ErrorModel
    epochs : Epochs
    rows, extra, out : Rows, ErrorRows, RowModel
        Of ``out`` elevation, azimuth, ionosphere and the innovations ``v_code``, ``s_code``; of ``extra`` also ``v2``
        and ``s2``; of ``rows`` what variances need.
    fresh : (m,)
        1 where an epoch started the filter: its innovations do not move the factor.
    speed2 : (m,)
        Squared speed, (m/s)^2.
    lasting : (n, 2)
        Out: prior variance of the lasting errors of the first and second code, m^2.
    white, rate : (n, 2), (n,)
        Out: variances of white noise, m^2 and m^2/s^2.
    scale : (m,)
        Out: the factor on the variance of code noise and multipath at each epoch.
    """
    none, idx, val = np.zeros(0, np.int64), np.zeros(K_MAX, np.int64), np.zeros(K_MAX)
    slots = Slots(none, none, none, none, np.ones(1))
    t_last = epochs.t_ns[0] if len(epochs.t_ns) else 0
    for e in range(len(epochs.t_ns)):
        total, weight = 0.0, 0.0
        scale[e] = slots.scale[0]
        for i in range(epochs.offsets[e], epochs.offsets[e + 1]):
            code, r = variances(
                options, rows.system[i], out.elevation[i], rows.cn0_dbhz[i], rows.sigma_sat_m[i], rows.noise_factor[i],
                out.ionosphere[i], rows.freq_hz[i],
            )  # fmt: skip
            white[i, 0], rate[i] = code, r
            if not errors.on:
                continue
            rate[i] = r + motion_rate_variance(errors, rows.cn0_dbhz[i], speed2[e])
            for b in range(2):
                if b == 1 and extra.code2_m[i] != extra.code2_m[i]:  # NaN
                    continue
                count, white[i, b], part = code_states(
                    errors, rows, extra, out, i, b == 1, 0, 0, slots.scale[0], idx, val
                )
                for k in range(4, count):
                    lasting[i, b] += val[k] * val[k]
                v = extra.v2[i] if b == 1 else out.v_code[i]
                s = extra.s2[i] if b == 1 else out.s_code[i]
                if s > 0.0:
                    total += part * min(v * v / s, 9.0)
                    weight += part
        dt = 0.0 if fresh[e] else (epochs.t_ns[e] - t_last) * 1e-9
        t_last = epochs.t_ns[e]
        if errors.on:
            adapt_scale(errors, slots, dt, total, weight)


@njit
def row_states(
    errors: ErrorModel, rows: Rows, extra: ErrorRows, out: RowModel, at: I8, scale: F8, idx: I8, val: F8, count: I8
) -> None:
    """Error states that the codes of some rows see.

    Parameters
    ----------
    errors, rows, extra, out
        As `run_terms`.
    at : (k,)
        Rows.
    scale : (k,)
        Factor on the variance of code noise at the epochs of these rows.
    idx, val : (k, 2, K_MAX)
        Out: as `code_states` gives them for a layout without other states and with one satellite; entries from 4 to
        ``count``.
    count : (k, 2)
        Out; 0: no such code.
    """
    for j in range(len(at)):
        i = at[j]
        for b in range(2):
            if b == 1 and extra.code2_m[i] != extra.code2_m[i]:
                continue
            count[j, b], _, _ = code_states(errors, rows, extra, out, i, b == 1, 0, 0, scale[j], idx[j, b], val[j, b])
