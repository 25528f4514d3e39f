"""SciPy's minimisers on the search: what they are told, and that they leave the end to it."""

import numpy as np
import pytest
from helpers.marks import FITS
from helpers.scenes import even

from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.scipy_methods import METHODS, lbfgs, minimise, options
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.scene.scene import load

pytestmark = FITS


@pytest.mark.parametrize("method", METHODS)
def test_every_one_goes_down_within_its_budget_and_the_bounds(method):
    made = load(even("GG", 8, 3, 3))
    search = Search(Objective(made, simulate(made), 1e-10), np.array([0.05, 10.0]), 1e-9, 25)
    first = search.objective.cost(search.best.p)
    with pytest.raises(Stop) as stop:
        raise Stop(minimise(search, method))
    assert stop.value.status in ("converged", "stalled", "limit")
    assert search.budget.evaluations <= 25
    assert search.best.cost < 0.5 * first


@pytest.mark.parametrize("method", [name for name in METHODS if name != "l-bfgs-b"])
def test_no_tolerance_ends_it_before_the_search_does(method):
    told = options(method, 123)
    ends = {name: value for name, value in told.items() if name.endswith("tol") or name == "tol"}
    assert all(value <= 1e-10 for value in ends.values())
    limits = [told[name] for name in ("maxiter", "maxfun") if name in told]
    assert limits
    assert min(limits) > 123


def test_l_bfgs_leaves_its_end_to_the_cost():
    seen = []

    def flat(y):
        seen.append(y)
        if len(seen) == 300:
            raise Stop("limit")
        return 1e-12 * float((y**4).sum()), 4e-12 * y**3

    with pytest.raises(Stop):
        lbfgs(flat, np.array([3.0, -2.0]))
    seen.clear()
    lbfgs(flat, np.array([3.0, -2.0]), limit=5)
    assert 5 <= len(seen) < 30  # a line search is brought to its end


def test_without_bounds_of_its_own_the_values_are_clipped():
    made = load(even("nG", 8, 3, 3, springStiffness=[3e4] * 16, fit={"bounds": {"stiffness": [1, 1e4]}}))
    search = Search(Objective(made, simulate(made), 1e-10), np.array([9e3]), 0.0, 20)
    with pytest.raises(Stop):
        raise Stop(minimise(search, "bfgs"))
    assert search.best.p[0] <= 1e4
