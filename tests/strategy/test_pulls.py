"""Nudged motions: where they are pulled, and that the truth stays the minimum with every pull."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import even, load_text

from clothfit.fit.estimate import record_target
from clothfit.motion.motion import at_frames
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.scene.fit_vector import parameters
from clothfit.strategy import first_windows, step_forms

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


@pytest.mark.parametrize("pull", first_windows.PULLS)
def test_at_the_truth_nothing_is_left_to_pull(windy, pull):
    scene, motion = windy
    found = step_forms.nudged(Objective(scene, motion, 1e-10), pull)
    assert found.cost(parameters(scene)) <= step_forms.TOLERANCE**2 * found.still  # as its linear systems are solved


def test_a_stronger_pull_leaves_less(windy):
    scene, motion = windy
    objective, wrong = Objective(scene, motion, 1e-10), 0.2 * parameters(scene)
    costs = [step_forms.nudged(objective, pull).cost(wrong) for pull in first_windows.PULLS]
    assert costs == sorted(costs)
    assert costs[0] < 1e-2 * costs[-1]


def test_a_third_of_the_truth_leads_to_it(windy):
    scene, motion = windy
    search = Search(Objective(scene, motion, 1e-10), parameters(scene) / 3.0, 0.0, 1000)
    found = first_windows.through_pulls(search)
    assert len(found) == len(first_windows.PULLS)
    for p in found:
        np.testing.assert_allclose(p, parameters(scene), rtol=1e-3)  # steps that would save 5 % are the last
    assert search.best.cost <= 1e-6 * search.objective.still


def test_pulls_too_stiff_for_explicit_steps_are_left_out():
    scene = load_text(json.dumps(even("nG", 200, windVel=WIND, integrationMethod=1, delta=0.002)))
    search = Search(Objective(scene, record_target(scene), 1e-10), parameters(scene) / 3.0, 0.0, 1000)
    found = first_windows.through_pulls(search)
    assert 0 < len(found) < len(first_windows.PULLS)
    np.testing.assert_allclose(found[-1], parameters(scene), rtol=0.1)  # steps that would save 5 % are the last
    np.testing.assert_allclose(search.best.p, parameters(scene), rtol=0.01)


def test_forces_that_are_given_are_not_replaced(windy):
    scene, motion = windy
    assert step_forms.can_nudge(Objective(scene, motion))
    given = scene.with_forces(step_forms.pulled(scene, motion, 1.0).forces)
    assert not step_forms.can_nudge(Objective(given, motion))
    assert not step_forms.can_nudge(Objective(scene, motion, objective="velocity"))
