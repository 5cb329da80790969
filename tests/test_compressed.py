"""Law of the compressed update: equal to the batch and sequential updates where nothing is gated."""

import numpy as np
import pytest

from starwise.kernels.compressed import update_compressed
from starwise.kernels.update import update_batch, update_sequential
from test_update_laws import problem, run

pytestmark = pytest.mark.laws
# Normal equations square the condition of H: rounding of 1e-16 times 1e6, on states of metres.
ROUNDING = 1e-7


def compressed(p, m=None):
    m = len(p["v"]) if m is None else m
    x, P = np.zeros(p["n"]), p["P"].copy()
    nk = int(p["nk"])
    nis, dof = update_compressed(x, P, p["n"], nk, p["moving"], p["ic"], p["idr"], p["u"], p["g"], p["v"], p["r"], m)
    return x, P, nis, dof


@pytest.mark.parametrize("nk", [3, 6, 9])
@pytest.mark.parametrize("clocks", [1, 2, 4])
@pytest.mark.parametrize("m", [1, 2, 3, 4, 7, 12, 45])
def test_equals_batch_and_sequential(nk, clocks, m):
    rng = np.random.default_rng(1000 * nk + 100 * clocks + m)
    p = {**problem(rng, m, nk, clocks, with_rate=0.8), "nk": nk}
    x, P, nis, dof = compressed(p)
    for kernel in (update_batch, update_sequential):
        other = run(kernel, p)
        assert dof == other["dof"]
        assert np.abs(x - other["x"]).max() < ROUNDING
        assert np.abs(P - other["P"]).max() < ROUNDING * np.abs(p["P"]).max()
        assert nis == pytest.approx(other["nis"], rel=1e-7, abs=1e-7)
    assert (P == P.T).all()


def test_no_satellite_changes_nothing():
    p = {**problem(np.random.default_rng(1), 1), "nk": 9}
    x, P, nis, dof = compressed(p, 0)
    assert dof == 0
    assert nis == 0.0
    assert (x == 0.0).all()
    np.testing.assert_allclose(P, p["P"], rtol=0.0, atol=1e-12)


def test_same_direction_many_times_is_one_direction():
    """All satellites in one place: the normal matrix has rank two."""
    p = {**problem(np.random.default_rng(2), 6, 9, 1), "nk": 9}
    p["u"][:] = p["u"][0]
    p["g"][:] = p["g"][0]
    x, P, _, _ = compressed(p)
    other = run(update_batch, p)
    assert np.abs(x - other["x"]).max() < ROUNDING
    assert np.abs(P - other["P"]).max() < ROUNDING * np.abs(p["P"]).max()
