"""L-BFGS in the metric of Gauss–Newton: the metric, how fast a round descends with it, and what ends a round."""

import contextlib
import itertools
from functools import partial

import numpy as np
import pytest
from helpers.strangers import small, with_finer_steps

from clothfit.motion.degrade import degrade
from clothfit.motion.divergence import Diverged
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise import preconditioned
from clothfit.optimise.gauss_newton import Model
from clothfit.optimise.preconditioned import LEAST_RIDGE, ROUND, SHORT_ROUND, WIDTH, Patience, descend, metric, minimise
from clothfit.optimise.scipy_methods import minimise as minimise_by_scipy
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import parameters


def unlimited(clock=lambda: 0.0):
    """A patience that is never over; no time passes by its clock, so that only evaluations end a round."""
    return Patience(clock, np.inf)


class Bowl:
    """A search of a quadratic cost 1 + (y − y*)ᵀ Q (y − y*) / 2 in a box; it notes its evaluations."""

    is_late, unit = False, 0.0

    def __init__(self, Q, lowest, size=10.0, start=None):
        self.Q, self.lowest = Q, lowest
        self.y = np.zeros(len(lowest)) if start is None else start
        self.bounds, self.best, self.evaluations = [(-size, size)] * len(lowest), self, 0
        self.cost = self.value(self.y)

    def value(self, y):
        """Its cost."""
        return 1.0 + 0.5 * float((y - self.lowest) @ self.Q @ (y - self.lowest))

    def __call__(self, y):
        """Cost and gradient; the best point is kept."""
        self.evaluations += 1
        cost = self.value(y)
        if cost < self.cost:
            self.y, self.cost = y.copy(), cost
        return cost, self.Q @ (y - self.lowest)


def bowl(condition=1e8, count=12, **options):
    """A bowl along random axes, whose curvatures differ by the factor `condition`."""
    rng = np.random.default_rng(4)
    axes, _ = np.linalg.qr(rng.normal(size=(count, count)))
    Q = axes @ np.diag(np.geomspace(1.0, condition, count)) @ axes.T
    return Bowl(0.5 * (Q + Q.T), rng.uniform(-1, 1, count), **options)


# --- a round on a quadratic cost


def test_a_round_in_the_metric_of_a_quadratic_cost_ends_at_its_minimum():
    search = bowl()
    # the cost is |u − u*|² / 2 there: a step along its gradient ends at u*, once its length is known
    descend(search, np.linalg.cholesky(search.Q), unlimited(), SHORT_ROUND)
    assert search.evaluations <= SHORT_ROUND
    # rounding of u, about 1e-16 sqrt(condition) of u* = Lᵀ (y* − y₀)
    np.testing.assert_allclose(search.y, search.lowest, atol=1e-10)
    assert search.cost == pytest.approx(1.0, abs=1e-12)


def test_the_first_step_of_a_round_is_as_long_as_the_metric_says():
    search = bowl()
    far = search.cost - 1.0
    # L of a cost c₀ + |u|² about its minimum: c₀ = 1 in the unit of a search that has not evaluated yet
    descend(search, np.linalg.cholesky(search.Q / 2.0), unlimited(), 2)
    assert search.evaluations == 2
    assert search.cost - 1.0 < 1e-10 * far  # rounding, by sqrt(condition) of 1e8


def test_without_its_metric_a_round_comes_less_far():
    near, far = bowl(), bowl()
    descend(near, np.linalg.cholesky(near.Q), unlimited(), SHORT_ROUND)
    descend(far, None, unlimited(), SHORT_ROUND)
    assert near.cost - 1.0 < 1e-6 * (far.cost - 1.0)


def test_a_metric_that_is_only_near_the_curvature_needs_a_few_evaluations_more():
    search = bowl()
    rng = np.random.default_rng(5)
    off = rng.normal(size=(12, 12))
    root = np.linalg.cholesky(search.Q)
    near = np.linalg.cholesky(root @ (np.eye(12) + 0.02 * (off + off.T)) @ root.T)
    descend(search, near, unlimited())
    assert search.evaluations <= ROUND
    np.testing.assert_allclose(search.y, search.lowest, atol=1e-6)


@pytest.mark.parametrize("in_metric", [True, False])
def test_no_round_leaves_the_bounds_or_ends_above_its_start(in_metric):
    search = bowl(condition=1e3, size=0.5)  # the minimum lies outside
    before = search.cost
    descend(search, np.linalg.cholesky(search.Q) if in_metric else None, unlimited())
    assert (np.abs(search.y) <= 0.5).all()
    assert search.cost < before


@pytest.mark.parametrize("most", [1, 3, SHORT_ROUND])
def test_a_round_has_so_many_evaluations_at_most(most):
    search = bowl()
    descend(search, None, unlimited(), most)
    assert search.evaluations == most


# --- what ends a round, and a descent


def clock(seconds):
    """A clock that goes on by so many seconds each time it is looked at."""
    return partial(next, itertools.count(0.0, seconds))


def test_a_round_that_saves_little_ends_after_a_number_of_evaluations_and_seconds():
    search = bowl()
    search.cost = 0.5  # nothing that is found is better
    descend(search, None, unlimited(clock(1.0)))
    assert search.evaluations == preconditioned.SLOW_EVALUATIONS
    search = bowl()
    search.cost = 0.5
    descend(search, None, unlimited(clock(1e-9)))
    assert search.evaluations == ROUND  # in no time


def test_a_round_that_saves_much_is_no_slow_one():
    search = bowl(condition=1e3)
    descend(search, None, unlimited(clock(1.0)), 25)
    assert search.evaluations > preconditioned.SLOW_EVALUATIONS


def test_a_search_that_is_late_has_no_round():
    search = bowl()
    search.is_late = True
    descend(search, None, unlimited())
    assert search.evaluations == 0


@pytest.mark.parametrize(("saving", "over"), [(0.001, True), (0.02, False)])
def test_patience_is_over_where_seconds_save_less_than_a_fraction(saving, over):
    patience = Patience(clock(1.0), 5.0, 0.01)
    costs = [1.0, *((1.0 - saving) ** (k / 5.0) for k in range(1, 12))]
    assert [patience.is_over(cost) for cost in costs] == [False] * 5 + [over] * 7


def test_patience_does_not_count_other_seconds():
    patience = Patience(clock(1.0), 5.0)
    found = []
    for _ in range(20):
        found.append(patience.is_over(1.0))
        patience.uncounted += 0.9
    assert not any(found)  # only 2 seconds count


# --- the metric of a fit


def search_of(letters="nR", noise=None, off=1.2, **fields):
    """A search of a target by finer steps, or of its own motion with noise, from values that are off by a factor."""
    scene = small(letters, 16, **fields)
    target = with_finer_steps(scene, 4) if noise is None else degrade(simulate(scene, tolerance=1e-12), noise=noise)
    return Search(Objective(scene, target, 1e-10), off * parameters(scene), 0.0, 10**6)


@pytest.mark.slow
@pytest.mark.parametrize("letters", ["nR", "LL"])
def test_the_metric_is_the_root_of_the_normal_equations_with_a_ridge(letters):
    search = search_of(letters)
    part = Trajectory(search, search.objective)
    y = search.y
    L = metric(part, y)
    model = part.model(y)
    # a scatter of WIDTH counts as much as one residual
    ridge = max(model.cost / part.residuals() / WIDTH**2, LEAST_RIDGE * np.abs(model.H).max())
    wanted = (model.H + ridge * np.eye(len(y))) / model.cost
    assert np.array_equal(L, np.tril(L))
    np.testing.assert_allclose(L @ L.T, wanted, rtol=1e-12, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.slow
def test_a_matrix_that_rounding_has_made_indefinite_has_a_larger_ridge(monkeypatch):
    search = search_of()
    part = Trajectory(search, search.objective)
    y, count = search.y, len(search.y)
    H = np.diag([1.0] * (count - 1) + [-1e-6])
    monkeypatch.setattr(Trajectory, "model", lambda *_: Model(y, 1e-12, H, np.zeros(count)))
    added = np.diag(metric(part, y) @ metric(part, y).T) * 1e-12 - np.diag(H)
    np.testing.assert_allclose(added, added[0], rtol=1e-6)  # rounding of differences
    assert 1e-6 < added[0] < 1e-3  # not more than what is needed, times STEEPER


@pytest.mark.slow
@pytest.mark.parametrize("why", ["no room", "diverged", "overflow", "no cost"])
def test_there_is_no_metric_where_there_is_no_sensitivity(monkeypatch, why):
    search = search_of()
    part = Trajectory(search, search.objective)
    y, count = search.y, len(search.y)

    def model(*_):
        if why == "diverged":
            raise Diverged("far", 3)
        H = np.full((count, count), np.inf) if why == "overflow" else np.eye(count)
        return Model(y, 0.0 if why == "no cost" else 1.0, H, np.zeros(count))

    monkeypatch.setattr(Trajectory, "model", model)
    monkeypatch.setattr(Trajectory, "fits", lambda _: why != "no room")
    assert metric(part, y) is None


# --- descents


def reached(search, method):
    """The cost at the end of a method."""
    search.visit(search.start)
    with contextlib.suppress(Stop):
        method(search)
    return search.best.cost


@pytest.mark.slow
def test_a_round_of_an_exact_model_ends_at_the_floor_of_its_noise():
    search = search_of("nR", noise=1e-4)
    truth = search.objective.cost(search.start / 1.2)
    root = metric(preconditioned.for_metric(search), search.y)
    found = reached(search, lambda own: preconditioned.one_round(own, root))
    assert found < truth  # as 12 residuals of thousands follow the noise
    assert search.best.cost > 0.9 * truth


@pytest.mark.slow
@pytest.mark.parametrize("letters", ["nR", "RR"])
def test_a_descent_ends_where_scipys_does(letters):
    found = reached(search_of(letters), minimise)
    # both end where rounds, or fifty evaluations, save less than a percent
    assert found <= 1.01 * reached(search_of(letters), lambda search: minimise_by_scipy(search, "l-bfgs-b"))


@pytest.mark.slow
def test_without_a_metric_the_coordinates_themselves_do(monkeypatch):
    monkeypatch.setattr(preconditioned, "metric", lambda *_: None)
    search = search_of()
    before = search.objective.cost(search.start)
    assert reached(search, minimise) < before


@pytest.mark.parametrize("metric_size", [None, 1e-10])
def test_a_round_whose_numbers_overflow_is_over(metric_size):
    search = Bowl(np.diag([1e308, 1e308]), np.array([1.0, -1.0]), size=1e300)
    root = None if metric_size is None else np.diag([metric_size] * 2)
    with np.errstate(all="ignore"):
        assert not descend(search, root, unlimited())
    assert np.isfinite(search.y).all()
