"""Covariances from blocks: what they come to where the textbook knows, and fits whose model differs or is chaotic."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.marks import FITS
from helpers.scenes import even, trial

from clothfit.fit import posterior
from clothfit.fit.estimate import estimate, record_target
from clothfit.fit.posterior import Kept
from clothfit.motion.degrade import degrade
from clothfit.scene.scene import load

pytestmark = FITS


def kept(J, r):
    """The scores of one run with all coordinates, from J (T, R, Q) and r (T, R) of its steps."""
    made = Kept(J.shape[2])
    scores = made.keep(np.arange(J.shape[2]))
    for each, left in zip(J, r, strict=True):
        scores.add(each, left, np.ones((1, 3, J.shape[2])))
    return made


def regression(seed, steps=42, rows=5, values=3):
    """Rows of a linear problem, in steps, with their residuals at the minimum, and K."""
    rng = np.random.default_rng(seed)
    J, y = rng.standard_normal((steps, rows, values)), rng.standard_normal((steps, rows))
    K = np.linalg.inv(np.einsum("trq,trp->qp", J, J))
    return J, np.einsum("trq,q->tr", J, K @ np.einsum("trq,tr->q", J, y)) - y, K


def test_of_a_linear_problem_it_is_the_jackknife_of_refits():
    J, r, K = regression(0)
    found = kept(J, r).blocks(np.ones(3)).covariance(np.arange(3), K)
    refits = []
    for b in range(3):
        rest = np.flatnonzero(np.arange(42) // 14 != b)
        refits.append(np.linalg.lstsq(J[rest].reshape(-1, 3), r[rest].reshape(-1), rcond=None)[0])
    spread = np.array(refits)  # of the steps from the minimum of all
    np.testing.assert_allclose(found, 2.0 * 2 / 3 * spread.T @ spread, rtol=1e-9)  # rounding


def test_independent_residuals_have_twice_their_covariance():
    found, true = [], []
    for seed in range(300):
        J, r, K = regression(seed, steps=120)
        found.append(np.trace(kept(J, r).blocks(np.ones(3)).covariance(np.arange(3), K)))
        true.append(2.0 * np.trace(K))
    # Each has three values with two degrees of freedom: a relative standard error of 0.6 / √300, and three of them;
    # leaving a third out is not quite linear in how much it says, which adds some percent of 1 / 240 · 3.
    np.testing.assert_allclose(np.mean(found), np.mean(true), rtol=0.12)


def test_what_one_block_alone_shows_is_not_known():
    J, r, _ = regression(1)
    J[14:, :, 2] = 0.0  # the third value acts in the first block only
    K = np.linalg.inv(np.einsum("trq,trp->qp", J, J))
    found = kept(J, r).blocks(np.ones(3)).covariance(np.arange(3), K)
    assert not found[2, 2] < 1e12 * K[2, 2]


def test_coordinates_scale_and_too_few_frames_say_nothing():
    J, r, K = regression(2, values=2)
    scale = np.array([2.0, 0.5])
    one = kept(J, r).blocks(np.ones(2)).covariance(np.arange(2), K)
    other = kept(J, r).blocks(scale).covariance(np.arange(2), K / np.outer(scale, scale))
    np.testing.assert_allclose(other, one / np.outer(scale, scale), rtol=1e-9)  # rounding
    assert kept(J[:11], r[:11]).blocks(scale) is None  # two blocks of four frames
    unseen = np.zeros((31, 0, 2)), np.zeros((31, 0))
    made = kept(J[:11], r[:11])
    for each, left in zip(*unseen, strict=True):
        made.runs[0][1].add(each, left, np.ones((1, 3, 2)))
    assert made.blocks(scale) is None  # steps between frames are no frames
    assert Kept(posterior.MOST_VALUES + 1).blocks(np.ones(posterior.MOST_VALUES + 1)) is None


def test_several_motions_share_the_blocks():
    J, r, _ = regression(3)
    made = Kept(3)
    for part in np.array_split(np.arange(42), 3):
        scores = made.keep(np.arange(3))
        for t in part:
            scores.add(J[t], r[t], np.ones((1, 3, 3)))
    one, other = made.blocks(np.ones(3)), kept(J, r).blocks(np.ones(3))
    np.testing.assert_allclose(one.scores, other.scores, rtol=1e-12)  # the same blocks
    np.testing.assert_allclose(one.information, other.information, rtol=1e-12)


def test_growth_is_that_of_the_run_that_grows_most():
    made = Kept(1)
    for rate in (1.0, 1.2):
        scores = made.keep(np.arange(1))
        for t in range(101):
            scores.add(np.zeros((0, 1)), np.zeros(0), np.full((1, 1, 1), rate**t))
    assert made.growth == pytest.approx(1.2**75, rel=1e-9)  # from a quarter of 101 steps to the last


@cache
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
