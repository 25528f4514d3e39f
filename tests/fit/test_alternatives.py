"""What else could explain a target: score tests and wider intervals by linear algebra, and fits of hidden causes."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import even
from scipy import stats

from clothfit import degrade, load, parameters, with_parameters
from clothfit.fit.alternatives import RARE, Alternatives
from clothfit.fit.estimate import estimate, record_target

pytestmark = pytest.mark.slow

SIGMA, ROWS = 0.1, 200
FITTED, OTHERS = np.arange(3, dtype=np.int32), np.arange(3, 5, dtype=np.int32)


def linear(seed, doubt=0.5, wrong=0.0):
    """The residuals (N,) of a linear model with columns (N, 5), three of them fitted, at the best values of these."""
    g = np.random.default_rng(seed)
    J = g.standard_normal((ROWS, 5))
    J[:, 3] += J[:, 0]  # what is not fitted has effects like those of the fitted values
    r = SIGMA * g.standard_normal(ROWS) + wrong * J[:, 3]
    r -= J[:, :3] @ np.linalg.lstsq(J[:, :3], r, rcond=None)[0]
    tau = np.where(np.arange(5) < 3, 0.0, doubt)
    return J, r, Alternatives(J.T @ J, J.T @ r, FITTED, [("wind", None, OTHERS)], tau, np.ones(5))


def test_the_score_is_what_least_squares_by_all_columns_saves():
    J, r, made = linear(0, wrong=0.2)
    (found,) = made.improbable(SIGMA**2)
    best = np.linalg.lstsq(J, r, rcond=None)[0]
    saved = r @ r - np.square(r - J @ best).sum()
    assert found.squares == pytest.approx(saved, rel=1e-8)  # the ridge is 1e-12, refined
    assert found.chance == pytest.approx(stats.chi2.sf(saved / SIGMA**2, 2), rel=1e-6)
    np.testing.assert_allclose(found.change, -best[3:], rtol=1e-8)


def test_noise_fails_the_test_as_rarely_as_it_says(monkeypatch):
    monkeypatch.setattr("clothfit.fit.alternatives.RARE", 0.1)
    count = sum(bool(linear(seed)[2].improbable(SIGMA**2)) for seed in range(400))
    assert 400 * 0.1 - 18 < count < 400 * 0.1 + 18  # three standard deviations of 6
    assert RARE < 0.1


@pytest.mark.parametrize("doubt", [1e-3, 0.02, 10.0])
def test_intervals_widen_as_the_posterior_of_all_columns_says(doubt):
    J, r, made = linear(1, doubt, wrong=0.01)
    prior, A = np.diag([0.0, 0.0, 0.0, *[SIGMA**2 / doubt**2] * 2]), np.diag([2.0, 0.0, 0.0])
    H, g = J.T @ J + prior, J.T @ r
    H[:3, :3] += A
    whole = np.linalg.inv(H)
    alone = np.linalg.inv(J[:, :3].T @ J[:, :3] + A)
    moved, variance = made.widening(SIGMA**2, A)
    np.testing.assert_allclose(variance, SIGMA**2 * np.diag(whole[:3, :3] - alone), rtol=1e-6)
    np.testing.assert_allclose(moved, np.abs((whole @ g)[:3] - alone @ g[:3]), rtol=1e-6, atol=1e-12)


def test_what_acts_just_as_a_fitted_value_is_bounded_by_what_nobody_would_notice():
    J, _, _ = linear(2)
    J[:, 3] = 2.0 * J[:, 0]
    for sigma2 in (SIGMA**2, 0.0):  # of an exact target as well
        made = Alternatives(J[:, :4].T @ J[:, :4], np.zeros(4), FITTED, [], np.array([0, 0, 0, 0.3]), np.ones(4))
        _, variance = made.widening(sigma2, np.zeros((3, 3)))
        np.testing.assert_allclose(variance, [0.36, 0.0, 0.0], atol=1e-8)


def test_a_hidden_gravity_below_the_noise_is_found_and_said():
    scene = load(even("nG", 30, 5, 5))
    other = replace(scene, gravity=np.array([0.0, -9.79, 0.0]))
    found = estimate(scene, degrade(record_target(other), 5e-3, seed=0))
    assert found.verdict.model == "differs"
    text = next(hint.text for hint in found.hints if hint.code == "hidden")
    assert "scene gravity (by " in text


def test_masses_that_only_the_drag_shows_are_as_uncertain_as_that():
    """Twice the mass, stiffness and drag move alike: the motion has their ratios alone."""
    scene = load(even("FF", 12, 4, 4, dragCoefficient=0.2))
    truth = with_parameters(scene, np.array([1.2, 1.2]))
    motion = record_target(truth)
    lighter = replace(scene, cloths=(replace(scene.cloths[0], drag=0.25),))  # a quarter too much
    found = estimate(lighter, motion)
    assert found.verdict.model == "adequate"
    for block, true in zip(found.parameters, parameters(truth, flags=scene), strict=True):
        ((low, high),) = block.interval
        assert low < true < high
        # a doubt of 30 % of the drag at two standard deviations, by the logarithm; and what is off here
        assert high / low == pytest.approx(np.exp(4.0 * 0.3), rel=0.05)
