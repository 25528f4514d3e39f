"""Student's t against closed forms and against SciPy."""

import numpy as np
import pytest
from scipy import stats

from clothfit.base.student import half_width, inside


@pytest.mark.parametrize("coverage", [0.1, 0.5, 0.95, 0.999])
def test_one_and_two_degrees_have_closed_forms(coverage):
    assert half_width(coverage, 1.0) == pytest.approx(np.tan(np.pi * coverage / 2), rel=1e-11)  # Cauchy
    assert half_width(coverage, 2.0) == pytest.approx(coverage * np.sqrt(2 / (1 - coverage**2)), rel=1e-11)


@pytest.mark.parametrize("freedom", [1.0, 1.7, 3.0, 10.0, 47.5, 1e3, 1e5, 1e8])
def test_it_is_that_of_scipy(freedom):
    # lgamma of large numbers leaves its rounding, some 1e-16 of ν log ν, in the density
    assert half_width(0.95, freedom) == pytest.approx(stats.t.ppf(0.975, freedom), rel=max(1e-11, 3e-16 * freedom))


def test_the_share_grows_from_none_to_all():
    shares = [inside(t, 4.0) for t in np.linspace(0.0, 50.0, 200)]
    assert shares[0] == 0.0
    assert np.all(np.diff(shares) > 0)
    assert shares[-1] == pytest.approx(1.0, abs=1e-5)
