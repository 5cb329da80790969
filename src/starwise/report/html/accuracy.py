"""Errors of a solution against a truth, as a page draws them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from starwise.analysis.accuracy import Matched, assess, match
from starwise.errors import StarwiseError
from starwise.frames import enu_from_ecef
from starwise.report.html.encode import packed, thinned
from starwise.report.html.epochs import MAX_EPOCHS, Local
from starwise.types import Solution, Truth

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
SHARES = np.concatenate([np.linspace(0.02, 0.98, 49), [0.99, 0.997]])
"""Nominal shares at which the calibration curve is computed."""


def compared(solution: Solution, truth: Truth | None) -> Matched | None:
    """Epochs with a truth; None without one, or where their times do not meet."""
    if truth is None:
        return None
    matched = match(solution, truth)
    return matched if len(matched.at) else None


def errors_by_epoch(solution: Solution, matched: Matched) -> F8:
    """Errors east, north, up (n, 3), m, of all epochs; NaN without a truth."""
    errors = np.full((solution.n_epochs, 3), np.nan)
    errors[matched.at] = matched.error_n
    return errors


def truth_payload(
    solution: Solution, truth: Truth, matched: Matched, errors: F8, local: Local, shown: I8
) -> dict[str, Any]:
    """Truth in the local frame, errors of the shown epochs, their distribution and the calibration curve."""
    true = np.atleast_2d(truth.pos_e)
    enu = enu_from_ecef(true, local.origin_e)
    if truth.t_ns is not None and len(solution.t_ns):
        near = (truth.t_ns >= solution.t_ns[0] - 10**10) & (truth.t_ns <= solution.t_ns[-1] + 10**10)
        enu = enu[near] if near.any() else enu
    kept = thinned(list(enu.T), MAX_EPOCHS)
    return {
        "source": truth.source,
        "point": truth.t_ns is None,
        "e": packed(enu[kept, 0]),
        "n": packed(enu[kept, 1]),
        "u": packed(enu[kept, 2]),
        "errors": [packed(errors[shown, k]) for k in range(3)],
        "compared": len(matched.at),
        "cdf": distribution(errors[matched.at]),
        "calibration": calibration_curves(matched),
    }


def distribution(errors: F8) -> dict[str, Any]:
    """Cumulative distribution of horizontal, vertical and spatial errors: lengths, m, at common shares."""
    shares = np.concatenate([np.linspace(0.0, 0.99, 100), [0.995, 1.0]])
    lengths = {
        "horizontal": np.hypot(errors[:, 0], errors[:, 1]),
        "vertical": np.abs(errors[:, 2]),
        "3D": np.linalg.norm(errors, axis=1),
    }
    out: dict[str, Any] = {"share": shares.round(4).tolist()}
    for name, values in lengths.items():
        there = values[np.isfinite(values)]
        if len(there):
            out[name] = np.quantile(there, shares).round(4).tolist()
    return out


def calibration_curves(matched: Matched) -> dict[str, Any] | None:
    """Share of epochs inside the regions of the claimed covariance that should hold each nominal share."""
    from scipy.special import chdtri

    out: dict[str, Any] = {"nominal": SHARES.round(4).tolist()}
    for dof, name in ((3, "3D"), (2, "horizontal"), (1, "vertical")):
        nees = matched.nees_by_dof[dof]
        stated = np.sort(nees[~np.isnan(nees)])
        if len(stated):
            inside = np.searchsorted(stated, chdtri(dof, 1.0 - SHARES), side="right") / len(stated)
            out[name] = inside.round(4).tolist()
    return out if len(out) > 1 else None


def statistics(solution: Solution, truth: Truth | None) -> dict[str, Any] | None:
    """What `starwise.analysis.accuracy.assess` says; None where nothing can be compared."""
    if truth is None:
        return None
    try:
        return assess(solution, truth)
    except StarwiseError:
        return None
