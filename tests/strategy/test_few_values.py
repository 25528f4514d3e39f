"""Fits of few values: Gauss–Newton to a minimum, points around it where the cost has steps, and around the end of a
window where contacts switch; and nudged motions, whose minimum the truth stays with every pull.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.marks import fits
from helpers.scenes import even, load_text
from helpers.strangers import small, with_finer_steps

from clothfit.fit.estimate import record_target
from clothfit.motion.motion import at_frames
from clothfit.objective.objective import Objective
from clothfit.optimise import preconditioned
from clothfit.optimise.gauss_newton import Model
from clothfit.optimise.scipy_methods import minimise
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.scene.fit_vector import parameters
from clothfit.strategy import few_values, step_forms


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


# --- windows


SLOPES, STEP = np.array([1.0, 10.0]), 0.5
"""Of the residuals, and the edge of a step of the cost."""


class Barred:
    """The cost |S (y - 1)|², 1 higher up to an edge of the first coordinate: at (0.4, 1) no small step pays."""

    own_widths, search = np.full(2, 100.0), SimpleNamespace(is_late=False)
    bounds = np.full(2, -5.0), np.full(2, 5.0)

    def __init__(self, still=100.0):
        self.objective, self.asked = SimpleNamespace(still=still), []

    def cost(self, y):
        self.asked.append(y)
        return float(((SLOPES * (y - 1.0)) ** 2).sum() + (y[0] < STEP))

    def model(self, y):
        return Model(y, self.cost(y), np.diag(SLOPES**2), SLOPES**2 * (y - 1.0))


@pytest.fixture
def _barred(monkeypatch):
    """Steps end at the minimum beyond the edge, but not before it."""
    monkeypatch.setattr(few_values, "some_steps", lambda part, y, most: np.ones(2) if y[0] >= STEP else y)


@pytest.mark.usefixtures("_barred")
@pytest.mark.parametrize(("still", "end"), [(100.0, 1.0), (1e12, 0.4)])
def test_a_point_around_leads_beyond_the_step_but_near_the_target_none_is_polled(still, end):
    part = Barred(still)
    assert few_values.beyond_switches(part, np.array([0.4, 1.0]), 4).tolist() == [end, 1.0]
    assert (len(part.asked) == 1) is (end < STEP)


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


# --- nudged motions


WIND, FRAMES = {"x": 12.0, "y": 3.0, "z": 4.0}, 24


@pytest.fixture(scope="module")
def windy():
    """A scene in wind and its motion, of which a third is not seen."""
    scene = load_text(json.dumps(even("nG", FRAMES, windVel=WIND)))
    whole = record_target(scene)
    hidden = np.random.default_rng(3).random(whole.positions.shape[:2]) < 1 / 3
    hidden[0] = False
    return scene, replace(whole, positions=np.where(hidden[..., None], 0.0, whole.positions), observed=~hidden)


def test_what_is_seen_is_pulled_to_where_it_is_after_each_step(windy):
    scene, motion = windy
    forces = step_forms.pulled(scene, motion, 1.0).forces
    seen = motion.observed[1:]
    mass = scene.cloths[0].mass
    np.testing.assert_allclose(forces.gain, seen * mass / scene.delta**2, rtol=1e-12)  # m ω², ω = 1 / h
    np.testing.assert_array_equal(forces.places[seen], motion.positions[1:][seen])
    assert forces.pulls
    assert not forces.values.any()


def test_sparse_frames_pull_at_their_steps_with_the_same_impulse(windy):
    scene, motion = windy
    forces = step_forms.pulled(scene, at_frames(motion, slice(0, None, 3)), 1.0).forces
    assert not forces.gain[np.arange(len(forces.gain)) % 3 != 2].any()
    third = step_forms.pulled(scene, motion, 1.0).forces.gain[2::3] / 3.0  # 3 m (ω / 3 h)²
    np.testing.assert_allclose(forces.gain[2::3], third, rtol=1e-12)


def test_frames_between_steps_pull_to_the_line_between_them(windy):
    scene, motion = windy
    times = 0.7 * motion.times  # in steps: 0, 0.7, 1.4, 2.1 …
    forces = step_forms.pulled(scene, replace(motion, times=times), 1.0).forces
    both = motion.observed[1] & motion.observed[2]
    line = motion.positions[1] + (1.0 - 0.7) / 0.7 * (motion.positions[2] - motion.positions[1])
    np.testing.assert_allclose(forces.places[0][both], line[both], rtol=1e-12)
    np.testing.assert_array_equal(forces.gain[0] > 0, both)


@pytest.mark.parametrize("pull", few_values.PULLS)
def test_at_the_truth_nothing_is_left_to_pull(windy, pull):
    scene, motion = windy
    found = step_forms.nudged(Objective(scene, motion, 1e-10), pull)
    assert found.cost(parameters(scene)) <= step_forms.TOLERANCE**2 * found.still  # as its linear systems are solved


def test_a_stronger_pull_leaves_less(windy):
    scene, motion = windy
    objective, wrong = Objective(scene, motion, 1e-10), 0.2 * parameters(scene)
    costs = [step_forms.nudged(objective, pull).cost(wrong) for pull in few_values.PULLS]
    assert costs == sorted(costs)
    assert costs[0] < 1e-2 * costs[-1]


def test_a_third_of_the_truth_leads_to_it(windy):
    scene, motion = windy
    search = Search(Objective(scene, motion, 1e-10), parameters(scene) / 3.0, 0.0, 1000)
    found = few_values.through_pulls(search)
    assert len(found) == len(few_values.PULLS)
    for p in found:
        np.testing.assert_allclose(p, parameters(scene), rtol=1e-3)  # steps that would save 5 % are the last
    assert search.best.cost <= 1e-6 * search.objective.still


def test_pulls_too_stiff_for_explicit_steps_are_left_out():
    scene = load_text(json.dumps(even("nG", 200, windVel=WIND, integrationMethod=1, delta=0.002)))
    search = Search(Objective(scene, record_target(scene), 1e-10), parameters(scene) / 3.0, 0.0, 1000)
    found = few_values.through_pulls(search)
    assert 0 < len(found) < len(few_values.PULLS)
    np.testing.assert_allclose(found[-1], parameters(scene), rtol=0.1)  # steps that would save 5 % are the last
    np.testing.assert_allclose(search.best.p, parameters(scene), rtol=0.01)


def test_forces_that_are_given_are_not_replaced(windy):
    scene, motion = windy
    assert step_forms.can_nudge(Objective(scene, motion))
    given = scene.with_forces(step_forms.pulled(scene, motion, 1.0).forces)
    assert not step_forms.can_nudge(Objective(given, motion))
    assert not step_forms.can_nudge(Objective(scene, motion, objective="velocity"))
