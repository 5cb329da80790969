"""The three measurement updates repeated many times inside compiled code, so that they can be timed.

Every turn starts from the same state and covariance. `turns_empty` restores them and does nothing else: its time is
to be taken off the others'.
"""

import numpy as np
from numpy.typing import NDArray

from starwise.kernels._jit import njit
from starwise.kernels.compressed import update_compressed
from starwise.kernels.update import update_batch, update_sequential

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]


@njit
def _restore(n: int, x: F8, P: F8, P0: F8, add: float) -> None:
    for i in range(n):
        x[i] = 0.0
        for j in range(n):
            P[i, j] = P0[i, j] + add


@njit
def turns_empty(turns: int, n: int, x: F8, P: F8, P0: F8) -> None:
    """Restore x and P, ``turns`` times."""
    for k in range(turns):
        _restore(n, x, P, P0, float(k))  # so that the compiler does not leave the loop out


@njit
def turns_sequential(
    turns: int, n: int, x: F8, P: F8, P0: F8, ic: I8, idr: I8, u: F8, g: F8, v: F8, r: F8, m: int,
    gate1: float, gate2: float, v_out: F8, s_out: F8, used: U1,
) -> None:  # fmt: skip
    """Satellite by satellite, ``turns`` times; arguments as `starwise.kernels.update.update_sequential`."""
    for _ in range(turns):
        _restore(n, x, P, P0, 0.0)
        update_sequential(x, P, n, True, ic, idr, u, g, v, r, m, gate1, gate2, v_out, s_out, used)


@njit
def turns_batch(
    turns: int, n: int, x: F8, P: F8, P0: F8, ic: I8, idr: I8, u: F8, g: F8, v: F8, r: F8, m: int,
    gate1: float, gate2: float, v_out: F8, s_out: F8, used: U1,
) -> None:  # fmt: skip
    """All satellites at once, ``turns`` times; arguments as `starwise.kernels.update.update_batch`."""
    for _ in range(turns):
        _restore(n, x, P, P0, 0.0)
        update_batch(x, P, n, True, ic, idr, u, g, v, r, m, gate1, gate2, v_out, s_out, used)


@njit
def turns_compressed(
    turns: int, n: int, nk: int, x: F8, P: F8, P0: F8, ic: I8, idr: I8, u: F8, g: F8, v: F8, r: F8, m: int
) -> None:
    """Rows compressed first, ``turns`` times; arguments as `starwise.kernels.compressed.update_compressed`."""
    for _ in range(turns):
        _restore(n, x, P, P0, 0.0)
        update_compressed(x, P, n, nk, True, ic, idr, u, g, v, r, m)
