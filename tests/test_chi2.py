"""Points of chi-square against scipy, which the program itself does without."""

import numpy as np
import pytest
import scipy.stats

from starwise.chi2 import chi_square_points


@pytest.mark.laws
@pytest.mark.parametrize("p", [1e-12, 1e-6, 1e-3, 0.01, 0.05, 0.3, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("size", [2, 3, 200])
def test_against_scipy(p: float, size: int) -> None:
    points = chi_square_points(p, size)
    wanted = scipy.stats.chi2.isf(p, np.arange(1, size))
    # relative, as both are scale parameters of one test; rounding near p = 1 costs three digits
    np.testing.assert_allclose(points[1:], wanted, rtol=1e-11, atol=0)


def test_certain_alarm() -> None:
    assert (chi_square_points(1.0, 5) == 0.0).all()
