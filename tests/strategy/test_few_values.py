"""The descent of few values: Gauss–Newton to a minimum, and points around it where the cost has steps."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.marks import fits
from helpers.strangers import small, with_finer_steps

from clothfit.objective.objective import Objective
from clothfit.optimise import preconditioned
from clothfit.optimise.scipy_methods import minimise
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.scene.fit_vector import parameters
from clothfit.strategy import few_values


class Steps:
    """A search of the cost |y|²/λ + 1, but lower by `depth` from `edge` on along the first axis."""

    is_late, each, size = False, 0.0, 3

    def __init__(self, edge, depth):
        self.edge, self.depth = edge, depth
        self.fitted, self.bounds = np.ones(self.size, bool), [(-2.0, 2.0)] * self.size
        self.scales = np.array([1.0, 1e-2, 1e2])  # λ
        self.objective, self.y, self.visited = SimpleNamespace(blocks=()), np.zeros(self.size), []
        self.best = SimpleNamespace(cost=self.value(self.y))

    def value(self, y):
        """The cost at y (3,)."""
        return float((y**2 / self.scales).sum()) + 1.0 - self.depth * (y[0] >= self.edge)

    def parameters(self, y):
        """They are the coordinates."""
        return y

    def has_time(self, seconds):
        """There is no limit."""
        return seconds < np.inf

    def visit(self, y):
        """Keep the best point."""
        self.visited.append(y)
        if self.value(y) < self.best.cost:
            self.y, self.best = y, SimpleNamespace(cost=self.value(y))


@pytest.fixture
def _by_its_scales(monkeypatch):
    """The metric of `Steps`."""
    monkeypatch.setattr(preconditioned, "for_metric", lambda own: own)
    monkeypatch.setattr(preconditioned, "metric", lambda own, _: np.diag(1.0 / np.sqrt(own.scales)))


@pytest.mark.usefixtures("_by_its_scales")
def test_points_around_are_where_a_smooth_cost_is_higher_by_the_same():
    search = Steps(edge=np.inf, depth=0.0)
    assert not few_values.polled(search)
    inside = [y for y in search.visited if (np.abs(y) < 2.0).all()]
    rises = [search.value(y) - 1.0 for y in inside]
    assert len(search.visited) == 6
    assert len(inside) == 4  # those along the third axis lie beyond the bounds, and end there
    np.testing.assert_allclose(rises, few_values.RADIUS**2, rtol=1e-12)
    assert (np.abs(search.visited) <= 2.0).all()
    assert search.best.cost == 1.0


@pytest.mark.usefixtures("_by_its_scales")
@pytest.mark.parametrize(("depth", "pays"), [(0.2, True), (few_values.RADIUS**2 + 0.5 * few_values.PAYS, False)])
def test_a_descent_goes_on_where_a_point_around_costs_clearly_less(depth, pays):
    search = Steps(edge=0.2, depth=depth)
    assert few_values.polled(search) is pays
    assert search.best.cost == pytest.approx(1.0 - depth + few_values.RADIUS**2, rel=1e-12)


def test_many_values_are_not_polled_and_not_settled():
    search = search_of("nL")
    search.visit(search.start)
    assert search.fitted.sum() > few_values.FEW_VALUES
    known = search.budget.evaluations
    assert not few_values.settled(search)
    assert not few_values.polled(search)
    assert search.budget.evaluations == known


@fits
def test_a_few_steps_come_to_the_minimum_of_a_model_that_differs():
    search, other = (search_of("nF", of_cloth={"damping": "G"}) for _ in range(2))
    search.visit(search.start)
    before = search.best.cost
    assert few_values.settled(search)
    assert search.is_settled
    with pytest.raises(Stop):
        minimise(other, "l-bfgs-b")
    assert search.best.cost < 0.9 * before
    # a step that is left saves less than `PATIENCE.flat` of the cost, by which Gauss–Newton goes on some times
    assert search.best.cost <= 1.01 * other.best.cost


def search_of(letters, **fields):
    """A search for the motion of a small sheet by steps four times finer than its own."""
    scene = small(letters, 20, **fields)
    return Search(Objective(scene, with_finer_steps(scene, 4), 1e-10), 1.3 * parameters(scene), 1e-8, 400)
