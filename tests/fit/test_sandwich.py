"""Covariances from blocks: what they come to where the textbook knows, and fits whose model differs or is chaotic."""

import json
from dataclasses import replace

import numba
import numpy as np
import pytest
from helpers.scenes import even, load_text, trial

from clothfit.fit import sandwich
from clothfit.fit.estimate import estimate, record_target
from clothfit.fit.sandwich import Kept
from clothfit.motion.degrade import degrade

pytestmark = [
    pytest.mark.slow,  # compiles a fit
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="many simulations need compilation"),
]


def load(made):
    return load_text(json.dumps(made))


def kept(parts):
    """The scores of one run with all coordinates."""
    made = Kept(parts.shape[1])
    scores = made.keep(np.arange(parts.shape[1]))
    for part in parts:
        scores.add(part, np.ones((1, 3, parts.shape[1])))
    return made


def test_independent_scores_have_twice_their_covariance():
    rng, true = np.random.default_rng(0), np.array([[2.0, 0.6], [0.6, 1.0]])
    scores = rng.standard_normal((400, 40, 2)) @ np.linalg.cholesky(true).T
    found = np.mean([kept(each).blocks(np.ones(2)).covariance() for each in scores], axis=0)
    # 400 estimates with three degrees of freedom each: a relative standard error of 0.04, and three of them
    np.testing.assert_allclose(found, 2.0 * 40 * true, rtol=0.12)


def test_coordinates_scale_and_too_few_steps_say_nothing():
    parts = np.random.default_rng(1).standard_normal((40, 2))
    scale = np.array([2.0, 0.5])
    one, other = (kept(parts).blocks(each).covariance() for each in (np.ones(2), scale))
    np.testing.assert_allclose(other, one * np.outer(scale, scale), rtol=1e-12)  # rounding
    assert kept(parts[:11]).blocks(scale) is None  # two blocks of four steps
    assert Kept(sandwich.MOST_VALUES + 1).blocks(np.ones(sandwich.MOST_VALUES + 1)) is None


def test_growth_is_that_of_the_run_that_grows_most():
    made = Kept(1)
    for rate in (1.0, 1.2):
        scores = made.keep(np.arange(1))
        for t in range(101):
            scores.add(np.zeros(1), np.full((1, 1, 1), rate**t))
    assert made.growth == pytest.approx(1.2**75, rel=1e-9)  # from a quarter of 101 steps to the last


def other_model(settings="nG"):
    """A scene with one stiffness, and a noisy motion of the same cloth with a stiffness for each spring."""
    scattered = load(trial(settings, 40, 5, 5, vertMass=[0.02] * 25))
    return load(even(settings, 40, 5, 5)), degrade(record_target(scattered), 1e-4, seed=1)


def test_where_the_model_differs_intervals_are_wide_and_never_without_the_verdict():
    scene, motion = other_model()
    found = estimate(scene, motion)
    assert found.verdict.model == "differs"
    ((low, high),) = found.parameters[0].interval
    assert found.sigma > 3e-4  # far above the noise
    assert high / low > 1.1
    # Other frames give another value, which the interval contains.
    early = replace(motion, positions=motion.positions[:25], times=motion.times[:25])
    ((other_low, other_high),) = estimate(scene, early).parameters[0].interval
    assert max(low, other_low) < min(high, other_high)


def test_for_many_values_of_a_wrong_model_there_are_none():
    scene, motion = other_model("nL")
    wrong = replace(scene, gravity=scene.gravity * 0.5)
    found = estimate(wrong, motion, max_evaluations=30)
    assert found.verdict.model == "differs"
    assert not any(found.parameters[0].interval)
    assert found.parameters[0].unidentifiable == []
    assert any("the model differs" in text for text in found.warnings)


def test_a_chaotic_motion_is_called_so(monkeypatch):
    scene, motion = other_model()
    monkeypatch.setattr("clothfit.fit.confidence.CHAOS", 1.0)
    found = estimate(scene, motion)
    assert any("chaotic" in text for text in found.warnings)
    assert found.rank is None
    assert (found.parameters[0].unidentifiable, found.parameters[0].interval) == ([], [None])
