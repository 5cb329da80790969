"""The part of each row's innovation variance that is its own noise, for the ledger."""

import numpy as np

from starwise.kernels.rangemodel import RowModel
from starwise.kernels.row_noise import row_noise
from starwise.models.pseudorange import Prepared
from starwise.types import F8


def noise_variances(prepared: Prepared, out: RowModel, vel_e: F8 | None) -> tuple[F8, F8, F8]:
    """Noise of the first code, the second code (m^2) and the rate ((m/s)^2) of every sighting, (n,) each; NaN: none.

    Parameters
    ----------
    prepared : Prepared
    out : RowModel
        As the estimator left it.
    vel_e : (n_epochs, 3) float64 or None
        Velocity, ECEF m/s: rates of a moving receiver are noisier under the coloured error model, whose lasting errors
        are states, not noise. The common factor by which innovations raise code noise is left at one.
    """
    n = len(prepared.rows.code_m)
    code, code2, rate = out.code_var.copy(), np.full(n, np.nan), out.rate_var.copy()
    if prepared.errors.on:
        speed2 = np.zeros(n)
        if vel_e is not None:
            each = np.nan_to_num((vel_e**2).sum(axis=1))
            speed2 = np.repeat(each, np.diff(prepared.epochs.offsets))
        row_noise(prepared.errors, prepared.rows, prepared.error_rows, out, speed2, code, code2, rate)
    for values in (code, rate):
        values[~np.isfinite(values)] = np.nan
    return code, code2, rate
