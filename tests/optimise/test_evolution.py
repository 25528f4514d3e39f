"""The evolution strategy: minima that it finds, and what its distribution does not depend on."""

import numpy as np
import pytest

from clothfit.optimise.evolution import Evolution, minimise

FREE = (np.full(2, -np.inf), np.full(2, np.inf))


def begun(mean, seed=0, widths=(1.0, 1.0), ends=FREE, count=16):
    return Evolution(np.array(mean, float), np.array(widths), ends, count, seed)


def valley(x):
    """Rosenbrock's function, whose minimum is 0 at (1, 1)."""
    return 100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2


def anyhow(cost):
    """A cost that no limit ends."""
    return lambda points, _enough, _limit: np.array([cost(x) for x in points])


def test_it_follows_a_bent_valley_to_its_minimum():
    best, least = minimise(anyhow(valley), begun([-1.0, 2.0]), lambda: False)
    # it ends with standard deviations of 1e-3 of the first ones, where the cost is about 1e-6
    np.testing.assert_allclose(best, 1.0, atol=1e-2)
    assert least == valley(best) < 1e-5


@pytest.mark.parametrize("seed", range(3))
def test_small_minima_do_not_hold_it(seed):
    def rough(x):
        return float(x @ x + 0.5 * np.sum(1.0 - np.cos(20.0 * x)))  # minima every 0.3, up to 1 deep

    best, _ = minimise(anyhow(rough), begun([3.0, -2.0], seed), lambda: False)
    assert np.abs(best).max() < 1.5 * 2.0 * np.pi / 20.0  # one of the lowest minimum's neighbours, or that itself


def test_only_the_order_of_the_costs_counts():
    plain, curved = begun([-1.0, 2.0]), begun([-1.0, 2.0])
    for _ in range(5):
        points = plain.draw()
        np.testing.assert_array_equal(points, curved.draw())
        costs = np.array([valley(x) for x in points])
        plain.learn(points, costs)
        curved.learn(points, np.where(costs > np.median(costs), np.inf, np.log(costs)))
    np.testing.assert_array_equal(plain.C, curved.C)


def test_the_units_of_the_coordinates_do_not_matter():
    unit = np.array([1e3, 1e-4])
    plain, scaled = begun([-1.0, 2.0]), begun([-1e3, 2e-4], widths=unit)
    for _ in range(5):
        for each, size in ((plain, np.ones(2)), (scaled, unit)):
            points = each.draw()
            each.learn(points, np.array([valley(x / size) for x in points]))
    # the axes of C may point either way, so single draws may differ, but not by the size of the units
    assert 0.05 < np.min(scaled.widths / unit / plain.widths) < 20.0


def test_points_stay_within_the_ends():
    ends = (np.array([1.5, -np.inf]), np.full(2, np.inf))
    seen = []

    def cost(x):
        seen.append(x)
        return valley(x)

    best, _ = minimise(anyhow(cost), begun([2.0, 2.0], ends=ends), lambda: False)
    assert min(x[0] for x in seen) >= 1.5
    np.testing.assert_allclose(best, [1.5, 2.25], atol=1e-2)  # the lowest point of the valley there


def test_it_ends_when_it_is_told_to():
    counts = []
    best, _ = minimise(anyhow(lambda x: counts.append(1) or valley(x)), begun([-1.0, 2.0]), lambda: len(counts) >= 32)
    assert len(counts) == 32
    assert np.isfinite(best).all()


def test_points_above_the_limit_may_cost_anything_above_it():
    def ended(points, enough, limit):
        costs = np.array([valley(x) for x in points])
        limit = min(limit, np.sort(costs)[enough - 1])
        return np.where(costs <= limit, costs, 1.5 * limit)

    seen = []
    for cost in (anyhow(valley), ended):
        evolution = begun([1.2, 1.4], widths=(0.1, 0.1))
        minimise(cost, evolution, lambda one=evolution: one.generation == 3)
        seen.append(evolution.mean)
    # nearly all of these costs are below twice the middle one before, so the better half is known
    np.testing.assert_allclose(*seen, rtol=0.05)
