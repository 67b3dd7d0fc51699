"""Student's t: equal to SciPy's, at its limits too."""

import math

import numpy as np
import pytest
from scipy.special import stdtr, stdtrit

from neurosym_jax.evaluation.intervals import half_interval, two_sided_p

FREEDOMS = (0.2, 0.8, 1.0, 1.5, 2.0, 7.2, 30.0, 111.3, 1000.5, 1e5, math.inf)


@pytest.mark.parametrize("freedom", FREEDOMS)
def test_p_values_and_intervals_are_those_of_scipy(freedom):
    half = half_interval(freedom)
    normal = math.isinf(freedom)
    expected = 1.959963984540054 if normal else stdtrit(freedom, 0.975)
    np.testing.assert_allclose(half, expected, rtol=1e-9)
    np.testing.assert_allclose(two_sided_p(half, freedom), 0.05, rtol=1e-9)
    for t in (1e-3, 0.3, 1.0, -1.0, 2.0, 4.5, 10.0):
        expected = math.erfc(abs(t) / 2**0.5) if normal else 2 * stdtr(freedom, -abs(t))
        np.testing.assert_allclose(two_sided_p(t, freedom), expected, rtol=1e-8)


def test_limits():
    assert two_sided_p(0.0, 3.0) == 1
    assert two_sided_p(math.inf, 3.0) == two_sided_p(math.inf, math.inf) == 0
    assert math.isnan(two_sided_p(math.nan, 3.0))
    assert math.isnan(two_sided_p(1.0, 0.0))
    assert math.isnan(two_sided_p(1.0, math.nan))
    assert math.isnan(half_interval(0.0))
    assert math.isnan(half_interval(math.nan))
