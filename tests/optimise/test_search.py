"""What an optimiser is given: coordinates, scaled cost and gradient, the bowl where nothing is finite, and the ends."""

import numpy as np
import pytest
from helpers.scenes import even, trial

from clothfit.motion.divergence import Diverged
from clothfit.motion.simulate import simulate
from clothfit.objective.identifiability import identifiable
from clothfit.objective.objective import Objective
from clothfit.optimise.search import HEIGHT, Search
from clothfit.optimise.status import STALL_EVALUATIONS, Stop
from clothfit.scene.fit_vector import LOWER, UPPER, parameters
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow  # compiles a fit


class Played(Objective):
    """An objective whose answers are given one by one: costs with gradients, or an exception."""

    def __init__(self, scene, answers):
        super().__init__(scene, simulate(scene))
        self.answers = iter(answers)
        self.around = 2.0

    def cost_or_infinity(self, p):
        """What the search sees around the best point when it asks whether that lies on a plateau."""
        return self.around

    def cost_and_gradient(self, p):
        answer = next(self.answers)
        if isinstance(answer, Exception):
            raise answer
        return answer


def real(settings="LG", start=0.5, budget=1000, **fields):
    """A search of a real scene from one value for all."""
    scene = load(trial(settings, 10, 3, 3, **fields))
    goal = Objective(scene, simulate(scene, tolerance=1e-12), 1e-12)
    return Search(goal, np.full(len(parameters(scene)), start), 0.0, budget)


def played(*answers, rmse=0.0, budget=1000, start=1.0, report=None):
    """A search of one stiffness (33 springs) with given answers."""
    return Search(Played(load(even("nG")), answers), np.array([start]), rmse, budget, report)


def steep(cost):
    """An answer that is far from stationary."""
    return cost, np.array([cost])


def ended(search, calls=1000):
    """How a search ends that is asked over and over at its best point."""
    try:
        for _ in range(calls):
            search(search.y)
    except Stop as stop:
        return stop.status
    return "goes on"


def test_coordinates_are_logarithms_weighted_by_the_elements_moved():
    search = real(start=0.5)
    assert len(search.y) == 7 + 1  # two of nine masses are those of fixed vertices
    weight = search.coordinates.weight[search.fitted]
    np.testing.assert_allclose(weight, [1.0] * 7 + [4.0], rtol=1e-15)  # sqrt of 1, and of 16 springs
    np.testing.assert_allclose(search.y, weight * np.log(0.5), rtol=1e-15)  # rounding


def test_there_and_back_within_the_bounds():
    search = real()
    low, high = np.array(search.bounds).T
    kept = identifiable(search.objective.scene)
    for y, value in ((low, LOWER), (high, UPPER), (low - 5, LOWER), (high + 5, UPPER), (search.y, 0.5)):
        p = search.parameters(y)
        np.testing.assert_allclose(p[kept], value, rtol=1e-14)  # rounding of log and exp
        assert (p[~kept] == 0.5).all()
        assert ((p >= LOWER) & (p <= UPPER)).all()


def test_a_start_outside_of_the_bounds_moves_only_what_is_fitted():
    search = real(start=1e6)
    kept = identifiable(search.objective.scene)
    assert (search.best.p[kept] == UPPER).all()
    assert (search.best.p[~kept] == 1e6).all()


def test_the_first_cost_is_one_and_the_others_are_relative_to_it():
    search = played(steep(8.0), steep(4.0), steep(16.0))
    assert [search(search.y)[0] for _ in range(3)] == [1.0, 0.5, 2.0]


def test_the_gradient_is_that_of_the_scaled_cost_in_the_coordinates():
    search = real()
    y, t = search.y + 0.1, 1e-5
    value, slope = search(y)
    direction = np.random.default_rng(0).normal(size=len(y))
    ahead, behind = (search(y + s * t * direction)[0] for s in (1, -1))
    # Central difference: error t² = 1e-10 and rounding 1e-16 / t = 1e-11, relative to values of about 1.
    assert slope @ direction == pytest.approx((ahead - behind) / (2 * t), rel=1e-6)
    assert search(y)[0] == value


def test_the_best_point_stays_the_best():
    search = played(steep(3.0), steep(2.0), steep(5.0))
    for shift in (0.0, 0.3, 0.6):
        search(np.array([shift]))
    assert search.best.cost == 2.0
    assert search.budget.history == [3.0, 2.0, 2.0]
    np.testing.assert_allclose(search.y, 0.3, rtol=1e-13)  # rounding of log and exp


NOT_FINITE = {
    "diverged": Diverged("it did", 3),
    "overflow": (np.inf, np.array([1.0])),
    "nan": (np.nan, np.array([1.0])),
    "gradient": (1.0, np.array([np.nan])),
}


@pytest.mark.parametrize("kind", NOT_FINITE)
def test_what_is_not_finite_is_a_bowl_around_the_best_above_every_cost(kind):
    search = played(steep(2.0), steep(50.0), *[NOT_FINITE[kind]] * 3)
    best = search.y
    search(best), search(best + 1)
    (near, slope), (far, _) = (search(best + away) for away in (0.5, 2.0))
    assert far > near > 50.0 / 2.0
    assert near == pytest.approx(HEIGHT * 25 * 1.25)  # 25: the worst cost met over the first
    assert slope == pytest.approx(HEIGHT * 25 * 2 * 0.5)
    assert search.best.cost == 2.0
    np.testing.assert_array_equal(search.y, best)


def test_without_any_finite_cost_the_bowl_is_finite_and_nobody_is_told():
    told = []
    search = played(*[Diverged("it did", 1)] * 2, report=told.append)
    value, slope = search(search.y + 1.0)
    assert np.isfinite(value)
    assert np.isfinite(slope).all()
    assert told == []
    assert search.best.cost == np.inf


def flat(slope, cost=1.0):
    """An answer with that derivative."""
    return cost, np.array([slope])


LOOK = 2  # evaluations on both sides of the best point, where the slope says that it is the end
ENDS = {  # what is answered and how, the status, and after how many evaluations
    "the budget is spent before another evaluation": ([steep(1.0)] * 5, {"budget": 3}, "limit", 3),
    "an RMSE of 2.5e-4: 1e-4 over 1600 positions": ([steep(1.0), steep(1e-4)], {"rmse": 1e-3}, "converged", 2),
    "stationary": ([steep(1.0), flat(1e-6, 1.0 - 1e-9)], {}, "converged", 2 + LOOK),
    "not yet stationary": ([flat(1e-4)] * 5, {"budget": 4}, "limit", 4),
    "outwards above": ([flat(-1.0 / UPPER)], {"start": UPPER}, "converged", 1 + LOOK),
    "outwards below": ([flat(1.0 / LOWER)], {"start": LOWER}, "converged", 1 + LOOK),
    "inwards above": ([flat(1.0 / UPPER)] * 5, {"start": UPPER, "budget": 4}, "limit", 4),
    "inwards below": ([flat(-1.0 / LOWER)] * 5, {"start": LOWER, "budget": 4}, "limit", 4),
    "nothing gets better for long": ([steep(1.0)] * 200, {}, "stalled", STALL_EVALUATIONS + 1),
    "0.5 % better in 50 evaluations": ([steep(0.9999**i) for i in range(200)], {"budget": 150}, "limit", 150),
}


@pytest.mark.parametrize("case", ENDS)
def test_how_it_ends(case):
    answers, options, status, evaluations = ENDS[case]
    search = played(*answers, **options)
    assert (ended(search), search.budget.evaluations) == (status, evaluations)
    assert search.best.cost == min(cost for cost, _ in answers[:evaluations])


def test_a_plateau_is_not_convergence():
    search = played(*[flat(1e-7)] * 200)
    search.objective.around = 1.0 + 1e-6
    assert ended(search) == "stalled"
    assert search.budget.evaluations == STALL_EVALUATIONS + 1 + LOOK


def test_where_noise_sets_the_floor_a_stall_is_convergence():
    assert ended(played(*[flat(1e-2)] * 200)) == "converged"


# --- visits


def test_a_visit_is_remembered_where_it_is_the_best():
    search = real("nG", 5.0)
    costs = [search.visit(np.array([k])) for k in (20.0, 30.0, 1.0)]
    assert search.best.cost == min(costs)
    assert search.best.p.tolist() == [(20.0, 30.0, 1.0)[int(np.argmin(costs))]]
    assert search.budget.history == [np.inf, costs[0], min(costs[:2])]  # what was the best before each


def test_a_measure_counts_and_is_not_remembered():
    search = real("nG", 5.0, budget=2)
    part = search.objective.until(4)
    assert search.measure(np.array([20.0]), part) == part.cost(np.array([20.0]))
    assert search.measure(np.array([20.0])) == search.objective.cost(np.array([20.0]))
    assert (search.best.cost, search.budget.evaluations) == (np.inf, 2)
    with pytest.raises(Stop) as stop:
        search.measure(np.array([20.0]))
    assert stop.value.status == "limit"
    assert search.budget.evaluations == 2


def test_a_visit_where_the_simulation_diverges_is_infinite():
    search = real("nG", 5.0, integrationMethod=0, delta=0.02)
    assert search.visit(np.array([1e4])) == np.inf
    assert search.best.p.tolist() == [5.0]


def test_a_better_point_is_told_and_ends_where_the_error_is_small_enough():
    told = []
    search = Search(Played(load(even("nG")), []), np.array([1.0]), 1e-3, 10, told.append)
    search.accept(np.array([2.0]), 5.0)
    assert (search.best.p.tolist(), search.best.cost) == ([2.0], 5.0)
    search.accept(np.array([3.0]), 6.0)
    assert (search.best.p.tolist(), search.best.cost) == ([2.0], 5.0)
    with pytest.raises(Stop) as stop:
        search.accept(np.array([4.0]), 1e-4)
    assert stop.value.status == "converged"
    assert [progress.cost for progress in told] == [5.0, 1e-4]
