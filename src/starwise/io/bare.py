"""Solutions of which a file tells little more than times and positions."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from starwise.constants import EPOCH_NO_SOLUTION, EPOCH_OK
from starwise.types import F8, I8, Solution


def bare_solution(
    t_ns: I8,
    pos_e: F8,
    provenance: dict[str, Any],
    *,
    cov_pos: F8 | None = None,
    vel_e: F8 | None = None,
    cov_vel: F8 | None = None,
    status: ArrayLike | None = None,
    n_used: ArrayLike | None = None,
    ledger: dict[str, NDArray[Any]] | None = None,
    extra: dict[str, F8] | None = None,
) -> Solution:
    """Solution in ECEF, m, in the order of time, NaN in everything that is not given.

    Parameters
    ----------
    t_ns : (n,) int64
        GPST, ns, in any order.
    pos_e : (n, 3) float64
    provenance : dict
    cov_pos, vel_e, cov_vel, status, n_used, ledger, extra
        As in `Solution`; ``status`` is ok by default, and none in any case where there is no position.
    """
    n = len(t_ns)
    order = np.argsort(t_ns, kind="stable")

    def rows(values: F8 | None, *shape: int) -> F8:
        return np.full((n, *shape), np.nan) if values is None else values[order]

    given = np.full(n, EPOCH_OK, np.uint8) if status is None else np.asarray(status, dtype=np.uint8)[order]
    places = pos_e[order]
    none = np.full((n, 0), np.nan)
    return Solution(
        t_ns=t_ns[order],
        status=np.where(np.isfinite(places).all(axis=1), given, EPOCH_NO_SOLUTION).astype(np.uint8),
        pos_e=places,
        vel_e=rows(vel_e, 3),
        cov_pos=rows(cov_pos, 3, 3),
        cov_vel=rows(cov_vel, 3, 3),
        clock_m=none,
        drift_mps=none,
        clock_sigma_m=none,
        clock_names=(),
        n_used=np.zeros(n, dtype=np.int32) if n_used is None else np.asarray(n_used, dtype=np.int32)[order],
        dop=np.full((n, 4), np.nan),
        nis=np.full(n, np.nan),
        dof=np.zeros(n, dtype=np.int32),
        ledger=ledger or {},
        provenance=provenance,
        extra={name: values[order] for name, values in (extra or {}).items()},
    )
