"""Fits of few values: Gauss–Newton to a minimum, points around it where the cost has steps, and around the end of a
window where contacts switch; and nudged motions, whose minimum the truth stays with every pull.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.strangers import small, with_finer_steps

from clothfit.fit import few_values
from clothfit.objective.objective import Objective
from clothfit.optimise.gauss_newton import Model
from clothfit.optimise.scipy_methods import minimise
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.scene.fit_vector import parameters


def test_many_values_are_not_settled():
    search = search_of("nL")
    search.visit(search.start)
    assert search.fitted.sum() > few_values.FEW_VALUES
    known = search.budget.evaluations
    assert not few_values.minimised(search)
    assert search.budget.evaluations == known


@pytest.mark.slow
def test_a_few_steps_come_to_the_minimum_of_a_model_that_differs():
    search, other = (search_of("nF", of_cloth={"damping": "G"}) for _ in range(2))
    search.visit(search.start)
    before = search.best.cost
    assert few_values.minimised(search)
    assert search.is_stationary
    with pytest.raises(Stop):
        minimise(other, "l-bfgs-b")
    assert search.best.cost < 0.9 * before
    # a step that is left saves less than `PATIENCE.flat` of the cost, by which Gauss–Newton goes on some times
    assert search.best.cost <= 1.01 * other.best.cost


def search_of(letters, **fields):
    """A search for the motion of a small sheet by steps four times finer than its own."""
    scene = small(letters, 20, **fields)
    return Search(Objective(scene, with_finer_steps(scene, 4), 1e-10), 1.3 * parameters(scene), 1e-8, 400)


# --- windows


SLOPES, STEP = np.array([1.0, 10.0]), 0.5
"""Of the residuals, and the edge of a step of the cost."""


class Barred:
    """The cost |S (y - 1)|², 1 higher up to an edge of the first coordinate: at (0.4, 1) no small step pays."""

    own_widths, search = np.full(2, 100.0), SimpleNamespace(is_late=False)
    bounds = np.full(2, -5.0), np.full(2, 5.0)

    def __init__(self, still=100.0):
        self.objective, self.asked = SimpleNamespace(cost_at_rest=still), []

    def cost(self, y):
        self.asked.append(y)
        return float(((SLOPES * (y - 1.0)) ** 2).sum() + (y[0] < STEP))

    def model(self, y):
        return Model(y, self.cost(y), np.diag(SLOPES**2), SLOPES**2 * (y - 1.0))


@pytest.fixture
def _barred(monkeypatch):
    """Steps end at the minimum beyond the edge, but not before it."""
    monkeypatch.setattr(few_values, "some_steps", lambda part, y, most: np.ones(2) if y[0] >= STEP else y)


class Rough(Barred):
    """The same, with a sensitivity that is so large that all points by its metric are within the edge."""

    own_widths = np.ones(2)

    def model(self, y):
        return Model(y, self.cost(y), 1e12 * np.eye(2), 1e12 * SLOPES**2 * (y - 1.0))


@pytest.mark.usefixtures("_barred")
@pytest.mark.parametrize(("still", "end"), [(100.0, 1.0), (1e12, 0.4)])
def test_a_point_around_leads_beyond_the_step_but_near_the_target_none_is_polled(still, end):
    part = Barred(still)
    assert few_values.beyond_switches(part, np.array([0.4, 1.0]), 4).tolist() == [end, 1.0]
    assert (len(part.asked) == 1) is (end < STEP)


@pytest.mark.usefixtures("_barred")
@pytest.mark.parametrize(("wide", "end"), [(True, 1.0), (False, 0.4)])
def test_a_wide_look_leads_out_of_where_the_sensitivity_says_nothing(wide, end):
    assert few_values.beyond_switches(Rough(), np.array([0.4, 1.0]), 4, wide).tolist() == [end, 1.0]


@pytest.mark.usefixtures("_barred")
def test_the_points_are_where_a_smooth_cost_is_higher_by_the_same():
    part, y = Barred(), np.array([-2.0, 1.0])  # all points cost more, or lie as far from the edge
    part.own_widths = np.full(2, 1e9)
    model = part.model(y)
    few_values.beyond_switches(part, y, 4)
    around = np.array([each - y for each in part.asked[3 : 3 + 12]])
    rises = (around @ model.H * around).sum(axis=1) / model.cost
    inside = (np.abs(y + around) < 5.0).all(axis=1)
    np.testing.assert_allclose(np.sqrt(rises[inside]), np.repeat(few_values.RADII, 4)[inside], rtol=1e-12)
    assert inside.sum() >= 8
