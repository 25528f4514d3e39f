"""SciPy's minimisers on the search: what they are told, and that they leave the end to it."""

import numpy as np
import pytest
from helpers.scenes import even
from scipy import optimize

from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.scipy_methods import METHODS, lbfgs, minimise
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow


def search_of(settings, start, budget, **fields):
    """A search for a scene's own values."""
    made = load(even(settings, 8, 3, 3, **fields))
    return Search(Objective(made, simulate(made), 1e-10), np.array(start), 0.0, budget)


@pytest.mark.parametrize("method", METHODS)
def test_every_one_goes_down_within_its_budget_and_the_bounds(method, monkeypatch):
    told, original = {}, optimize.minimize
    monkeypatch.setattr(optimize, "minimize", lambda *given, **more: told.update(more) or original(*given, **more))
    search = search_of("GG", [0.05, 10.0], 25)
    first = search.objective.cost(search.best.p)
    with pytest.raises(Stop) as stop:
        raise Stop(minimise(search, method))
    assert stop.value.status in ("converged", "stalled", "limit")
    assert search.budget.evaluations <= 25
    assert search.best.cost < 0.5 * first
    # neither a tolerance nor a limit of SciPy's own ends it before the search does
    options = told["options"]
    assert all(value <= 1e-10 for name, value in options.items() if name.endswith("tol"))
    limits = [options[name] for name in ("maxiter", "maxfun") if name in options]
    assert limits
    assert min(limits) > 25


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
    search = search_of("nG", [9e3], 20, springStiffness=[3e4] * 16, fit={"bounds": {"stiffness": [1, 1e4]}})
    with pytest.raises(Stop):
        raise Stop(minimise(search, "bfgs"))
    assert search.best.p[0] <= 1e4
