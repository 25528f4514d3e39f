"""Continuation: springs that pull a motion to its target, and the coordinates in which motions change evenly."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import even, load_text

from clothfit.fit import continuation
from clothfit.fit.estimate import record_target
from clothfit.motion.motion import at_frames
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.scene.fit_vector import parameters

# --- coordinates


@pytest.fixture(scope="module", params=["editor", "air"])
def blown(request):
    """A search by all kinds of values, from still air, for a motion in wind, solved tightly; and the truth (P,)."""
    fields = {"fit": {"windVel": "G", "gravity": "G"}, "windVel": WIND}
    of_cloth = {"fit": {"damping": "G", "dragCoefficient": "G"}, "dragCoefficient": 0.4, "dragLaw": request.param}
    document = even("nF", 9, **fields)
    document["objects"][0] |= of_cloth
    scene = load_text(json.dumps(document))
    p = parameters(scene)
    start = p.copy()
    start[3:6] = 0.0
    return Search(Objective(scene, record_target(scene), 1e-13), start, 0.0, 1000), p


def test_values_come_back_from_their_coordinates(blown):
    search, p = blown
    even = continuation.Even(search, search.objective)
    for factor in (1.0, 1e-3, 30.0):
        np.testing.assert_allclose(even.parameters(even.y(factor * p)), factor * p, rtol=1e-12)
    assert even.y(np.where(np.arange(len(p)) == 2, 0.0, p))[2] == 0.0  # no drag at all has a coordinate


def test_more_drag_pushes_no_more_in_the_same_wind(blown):
    search, p = blown
    even = continuation.Even(search, search.objective)
    y = even.y(p)
    y[2] += 1.0
    more = even.parameters(y)
    power = 1 if even.power == 1.0 else 2
    np.testing.assert_allclose(more[2] * more[3:6] ** power, p[2] * p[3:6] ** power, rtol=0.02)  # but for s, of 1 %


def test_the_model_is_the_derivative_by_the_coordinates(blown):
    search, p = blown
    even = continuation.Even(search, search.objective)
    y = even.y(1.2 * p)
    step = 1e-5  # differences of second order, of costs solved to 1e-13
    for i, each in enumerate(np.eye(len(y)) * step):
        change = (even.cost(y + each) - even.cost(y - each)) / (2.0 * step)
        assert 2.0 * even.model(y).g[i] == pytest.approx(change, rel=1e-5, abs=1e-7)


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
    forces = continuation.with_nudging(scene, motion, 1.0).forces
    seen = motion.observed[1:]
    mass = scene.cloths[0].mass
    np.testing.assert_allclose(forces.gain, seen * mass / scene.delta**2, rtol=1e-12)  # m ω², ω = 1 / h
    np.testing.assert_array_equal(forces.places[seen], motion.positions[1:][seen])
    assert forces.pulls
    assert not forces.values.any()


def test_sparse_frames_pull_at_their_steps_with_the_same_impulse(windy):
    scene, motion = windy
    forces = continuation.with_nudging(scene, at_frames(motion, slice(0, None, 3)), 1.0).forces
    assert not forces.gain[np.arange(len(forces.gain)) % 3 != 2].any()
    third = continuation.with_nudging(scene, motion, 1.0).forces.gain[2::3] / 3.0  # 3 m (ω / 3 h)²
    np.testing.assert_allclose(forces.gain[2::3], third, rtol=1e-12)


def test_frames_between_steps_pull_to_the_line_between_them(windy):
    scene, motion = windy
    times = 0.7 * motion.times  # in steps: 0, 0.7, 1.4, 2.1 …
    forces = continuation.with_nudging(scene, replace(motion, times=times), 1.0).forces
    both = motion.observed[1] & motion.observed[2]
    line = motion.positions[1] + (1.0 - 0.7) / 0.7 * (motion.positions[2] - motion.positions[1])
    np.testing.assert_allclose(forces.places[0][both], line[both], rtol=1e-12)
    np.testing.assert_array_equal(forces.gain[0] > 0, both)


@pytest.mark.parametrize("pull", continuation.NUDGES[:-1])
def test_at_the_truth_nothing_is_left_to_pull(windy, pull):
    scene, motion = windy
    found = continuation.nudged(Objective(scene, motion, 1e-10), pull)
    left = found.cost(parameters(scene)) / found.cost_at_rest
    assert left <= continuation.NUDGED_TOLERANCE**2  # as its linear systems are solved


def test_a_stronger_pull_leaves_less(windy):
    scene, motion = windy
    objective, wrong = Objective(scene, motion, 1e-10), 0.2 * parameters(scene)
    costs = [continuation.nudged(objective, pull).cost(wrong) for pull in (3.0, *continuation.NUDGES[:-1])]
    assert costs == sorted(costs)
    assert costs[0] < 1e-2 * costs[-1]


@pytest.mark.parametrize("factor", [1 / 3, 30.0])
def test_values_that_are_far_off_lead_to_the_truth(windy, factor):
    scene, motion = windy
    search = Search(Objective(scene, motion, 1e-10), factor * parameters(scene), 0.0, 1000)
    continuation.through_nudging(search, continuation.NUDGES)
    np.testing.assert_allclose(search.best.p, parameters(scene), rtol=1e-3)  # steps that would save 1 % are the last


def test_pulls_too_stiff_for_explicit_steps_are_left_out():
    scene = load_text(json.dumps(even("nG", 200, windVel=WIND, integrationMethod=1, delta=0.002)))
    search = Search(Objective(scene, record_target(scene), 1e-10), parameters(scene) / 3.0, 0.0, 1000)
    continuation.through_nudging(search, (3.0, *continuation.NUDGES))
    np.testing.assert_allclose(search.best.p, parameters(scene), rtol=0.01)


def test_forces_that_are_given_are_not_replaced(windy):
    scene, motion = windy
    assert continuation.can_nudge(Objective(scene, motion))
    given = scene.with_forces(continuation.with_nudging(scene, motion, 1.0).forces)
    assert not continuation.can_nudge(Objective(given, motion))
    assert not continuation.can_nudge(Objective(scene, motion, objective="velocity"))
