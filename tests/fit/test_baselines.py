"""What a fit must beat: the best still picture, by its formula, and the scene as it came."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.fits import estimate
from helpers.scenes import even

from clothfit import as_motion, load, parameters
from clothfit.cli.parts.estimate_results import ending
from clothfit.fit.estimate import record_target
from clothfit.fit.residual_hints import as_it_came, picture_distance, picture_error
from clothfit.objective.objective import Objective
from clothfit.optimise.status import Status

pytestmark = pytest.mark.slow


def gaps():
    """A scene and its motion, of which a vertex is seen in every other frame, and another one never."""
    scene = load(even("nG", 12))
    motion = record_target(scene)
    seen = np.ones(motion.positions.shape[:2], bool)
    seen[::2, 5], seen[:, 7] = False, False
    return scene, as_motion(scene, np.where(seen[..., None], motion.positions, np.nan), motion.times, seen)


def test_the_still_picture_is_the_mean_of_each_vertex_over_the_frames_that_show_it():
    scene, motion = gaps()
    shown = motion.observed.any(axis=0)
    mean = np.full((16, 3), np.nan)
    mean[shown] = [motion.positions[motion.observed[:, i], i].mean(axis=0) for i in np.flatnonzero(shown)]
    squares = ((motion.positions - mean) ** 2).sum(axis=2)[motion.observed]
    assert picture_error(Objective(scene, motion)) == pytest.approx(np.sqrt(squares.mean()), rel=1e-12)  # rounding


def test_the_picture_is_carried_along_by_what_is_held_where_that_is_nearer():
    """Positions that only travel with what is held leave nothing to a picture that travels with it."""
    scene, motion = gaps()
    on = np.linspace(0.0, 3.0, len(motion.times))[:, None, None] * [1.0, 0.0, 0.5]
    moved = replace(motion, positions=motion.positions + on)
    assert picture_error(Objective(scene, moved)) == pytest.approx(picture_error(Objective(scene, motion)), rel=1e-12)
    across = replace(motion, positions=np.where(scene.cloths[0].fixed[:, None], moved.positions, motion.positions))
    plain = picture_error(Objective(scene, across))
    assert plain < picture_distance(Objective(scene, across), Objective(scene, across), carried=True)


def test_the_scene_as_it_came_is_judged_by_its_own_values_whatever_is_flagged():
    made = even("GG", 12)
    made["objects"][0]["springStiffness"][3] = 90.0  # which one value for all would flatten
    scene, (_, motion) = load(made), gaps()
    objective = Objective(replace(scene, cloths=(replace(scene.cloths[0], settings="nL"),)), motion)
    own = objective.position_rmse(parameters(objective.scene))
    assert as_it_came(Objective(scene, motion)) == pytest.approx(own, rel=1e-9)  # tolerance of the linear systems


def test_the_scene_as_it_came_has_no_error_where_it_diverges():
    scene, motion = gaps()
    wild = load(even("nG", 12, integrationMethod=0, springStiffness=[1e9] * len(scene.cloths[0].stiffness)))
    assert as_it_came(Objective(wild, motion)) is None


def test_a_fit_that_is_no_nearer_than_a_still_picture_fails_and_has_not_converged():
    scene = load(even("nG", 40))
    time = np.arange(40)[:, None, None]
    shaken = scene.cloths[0].positions + np.array([0.3, 0.0, 0.0]) * np.sin(0.7 * time)  # nothing here pushes so
    shaken[:, scene.cloths[0].fixed] = scene.cloths[0].positions[scene.cloths[0].fixed]
    found = estimate(scene, shaken)
    assert found.baselines.still <= found.rmse
    assert (found.verdict.model, found.hints[0].code) == ("fails", "fails")
    assert found.status == Status.STALLED
    assert "converged" not in ending(found)
    assert not any(any(block.interval) for block in found.parameters)
    assert "wind" in found.hints[0].text


def test_a_fit_that_explains_its_target_beats_both():
    scene, motion = gaps()
    found = estimate(scene, motion, start=20.0)
    assert found.verdict.model == "adequate"
    assert found.rmse < 1e-6 < found.baselines.still  # m
    assert found.baselines.start < 1e-8  # m: its own values made the target


def test_velocities_have_no_still_picture():
    scene, motion = gaps()
    assert estimate(scene, motion, start=20.0, objective="velocity").baselines is None
