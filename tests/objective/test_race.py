"""A race of points: which costs it knows, what it leaves out, and what it does not depend on."""

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from helpers.scenes import even

from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import load
from clothfit.strategy.wide_search import race

FACTORS = [3.0, 1.1, 0.5, 1.6, 0.8, 0.2]


@pytest.fixture(scope="module")
def target():
    """An objective of one value, and points around its truth."""
    truth = load(even("nG", 40))
    return Objective(truth, simulate(truth), 1e-10), [factor * parameters(truth) for factor in FACTORS]


@pytest.fixture(scope="module")
def costs(target):
    objective, points = target
    return np.array([objective.cost(p) for p in points])


@pytest.mark.parametrize("enough", [1, 3, 6])
def test_it_knows_the_cheapest_exactly(target, costs, enough):
    found = race(*target, enough)
    cheapest = np.argsort(costs)[:enough]
    assert found.ended[cheapest].all()
    np.testing.assert_array_equal(found.costs[found.ended], costs[found.ended])
    assert (found.costs[~found.ended] > costs[cheapest].max()).all()


def test_the_others_are_not_simulated_to_their_end(target):
    objective, points = target
    few, all_of_them = race(objective, points, 2), race(objective, points, len(points))
    assert all_of_them.steps == len(points) * objective.steps
    assert few.steps < all_of_them.steps
    assert few.work < all_of_them.work


def test_those_above_a_limit_are_not_either(target, costs):
    limit = np.sort(costs)[2] / 2.0
    found = race(*target, 6, limit)
    assert found.ended[costs <= limit].all()
    assert not found.ended.all()
    assert (found.costs[costs > limit] > limit).all()


def test_a_motion_that_diverges_costs_more_than_any_other():
    objective = Objective(load(even("nG", 40, integrationMethod=0)), simulate(load(even("nG", 40))), 1e-10)
    found = race(objective, [np.array([1e4]), np.array([1e-3])], 2)
    assert found.costs[0] == np.inf
    assert np.isfinite(found.costs[1])


def test_threads_change_nothing(target):
    turns = []

    def late(function, runs):
        """Two threads, of which now the one and now the other is the slower."""
        turns.append(0)

        def one(number, run):
            time.sleep(1e-3 * (number == len(turns) % 2))
            return function(run)

        with ThreadPoolExecutor(2) as pool:
            return list(pool.map(one, range(2), runs))

    alone, together = race(*target, 3), race(*target, 3, each=late)
    np.testing.assert_array_equal(alone.costs, together.costs)
    assert (alone.steps, alone.work) == (together.steps, together.work)
