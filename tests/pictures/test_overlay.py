"""A fitted motion over its target."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import cloth, document, even
from numpy.testing import assert_allclose, assert_array_equal

from clothfit import evaluate, parameters, with_parameters
from clothfit.motion.motion import as_motion
from clothfit.motion.simulate import simulate
from clothfit.pictures.overlay import distances, overlaid
from clothfit.scene.scene import load


@pytest.fixture(scope="module")
def pair():
    truth = load(even("nG", 8))
    return truth, with_parameters(truth, 1.3 * parameters(truth))


def test_a_scene_over_itself_is_nowhere_apart(pair):
    over = overlaid(pair[0], pair[0], None, 6)
    assert_array_equal(over.rmse, 0.0)
    assert over.own.shape == over.goal.shape == (6, 16, 3)


def test_the_errors_of_the_frames_are_those_that_evaluate_tells(pair):
    over, told = overlaid(*pair, None, 8), evaluate(*pair, horizon=8)
    assert_allclose(np.sqrt((over.rmse**2).mean()), told.fitted.rmse, rtol=1e-9)
    assert_allclose(over.largest.max(), told.fitted.max_error, rtol=1e-9)


def test_finer_steps_are_shown_at_the_frames_of_the_true_scene(pair):
    fine = pair[1].with_step(pair[1].delta / 2, 15)
    over, told = overlaid(pair[0], fine, None, 8), evaluate(pair[0], fine, horizon=8)
    assert over.own.shape == over.goal.shape == (8, 16, 3)
    assert_allclose(np.sqrt((over.rmse**2).mean()), told.fitted.rmse, rtol=1e-9)


def test_a_target_between_the_steps_is_met_there(pair):
    truth, _ = pair
    x = simulate(truth, 8, 1e-10).positions
    target = as_motion(truth, 0.5 * (x[:-1] + x[1:]), truth.delta * (0.5 + np.arange(7)))
    assert_allclose(overlaid(truth, truth, target, 8).rmse, 0.0, atol=1e-12)
    assert len(overlaid(truth, truth, target, 5).times) == 4  # those that five frames reach


def test_what_was_not_observed_is_neither_shown_nor_counted(pair):
    truth, _ = pair
    motion = simulate(truth, 4, 1e-10)
    x, seen = motion.positions.copy(), np.ones((4, 16), bool)
    seen[2, 3] = seen[3] = False
    x[2, 3] += 100.0
    over = overlaid(truth, truth, as_motion(truth, x, observed=seen), 4)
    assert np.isnan(over.goal[2, 3]).all()
    assert_allclose(over.rmse, [0, 0, 0, np.nan], atol=1e-12)


def test_only_the_objects_that_are_fitted_count():
    scene = load(document(cloth(optimizationSettings="nG"), cloth()))
    x = np.zeros((2, 24, 3))
    y = x.copy()
    y[1, 0, 0], y[1, 12:] = 3.0, 50.0
    rmse, largest = distances(scene, x, y)
    assert_allclose(rmse, [0.0, 3.0 / np.sqrt(12)])
    assert_allclose(largest, [0.0, 3.0])


def test_a_motion_that_diverges_is_shown_until_then(pair):
    truth, fitted = pair
    wild = replace(fitted, method=0, delta=truth.delta * 1.0)
    over = overlaid(truth, with_parameters(wild, [9e3]), None, 8)
    assert 1 <= len(over.times) <= 8
    assert np.isfinite(over.own).all()
