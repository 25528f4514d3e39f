"""Samples of the posterior by products: their covariance and step are those of the matrix."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.marks import FITS
from helpers.scenes import trial
from scipy import stats

from clothfit.fit.estimate import record_target
from clothfit.motion.degrade import degrade
from clothfit.objective.objective import Objective
from clothfit.optimise.matrix_free import Products, Sampling
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import load

pytestmark = FITS

NOISE = 1e-3


@pytest.fixture(scope="module")
def noisy():
    """A noisy trajectory, its coordinates and its prior."""
    made = load(trial("LL", 25))
    aim = Objective(made, degrade(record_target(made), NOISE, observed=0.8, seed=2), 1e-12)
    part = Trajectory(Search(aim, parameters(made), 0.0, 10**6), aim)
    y = part.search.y
    prior = part.prior(y - 0.1, None).alone(0.3)
    return part, y, replace(prior, tau=(0.3, 0.2)), Products(part, y, 1e-12)


@pytest.mark.parametrize("wide", [True, False])
def test_all_rounds_give_the_step_and_the_covariance_of_the_matrix(noisy, wide):
    part, y, prior, products = noisy
    model, A = part.model(y), prior.matrix(NOISE**2)
    K, count = np.linalg.inv(model.H + A), 64
    sampling = Sampling(products, prior, y, NOISE**2, count, np.random.default_rng(1), wide=wide)
    while sampling.block.rank < len(y) and sampling.round() > 1e-9:
        pass
    step = -K @ (model.g + A @ (y - prior.centre))
    np.testing.assert_allclose(sampling.step, step, atol=1e-5 * np.abs(step).max())  # a condition of 1e6, rounding
    # the squares of `count` samples over the variance are chi-square: all within what one in 1e5 leaves, and their mean
    ratio = sampling.deviation**2 / (NOISE**2 * np.diag(K))
    low, high = stats.chi2.ppf([1e-5 / len(y), 1 - 1e-5 / len(y)], count) / count
    assert (ratio > low).all()
    assert (ratio < high).all()
    away = np.linalg.solve(np.linalg.cholesky(NOISE**2 * K), sampling.samples)  # independent, of variance 1
    assert np.mean(away**2) == pytest.approx(1.0, abs=5 * np.sqrt(2 / away.size))
    determined = np.trace(model.H @ K)
    assert sampling.determined == pytest.approx(determined, abs=5 * np.sqrt(2 * len(y) / count))


def test_few_rounds_leave_them_too_wide_or_too_narrow_as_asked(noisy):
    part, y, prior, products = noisy
    exact = NOISE * np.sqrt(np.diag(np.linalg.inv(part.model(y).H + prior.matrix(NOISE**2))))
    found = []
    for wide in (True, False):
        sampling = Sampling(products, prior, y, NOISE**2, 16, np.random.default_rng(1), wide=wide)
        sampling.round()
        found.append(np.median(sampling.deviation / exact))
    assert found[0] > 1.5
    assert found[1] < 0.7


def test_what_the_data_push_against_a_bound_stays(noisy):
    _, y, prior, products = noisy
    none = np.zeros(len(y), bool)
    free = Sampling(products, prior, y, NOISE**2, 2, np.random.default_rng(1))
    place = int(np.argmax(np.abs(free.gradient) / np.sqrt(free.diagonal)))
    at = none.copy()
    at[place] = True
    ends = (at, none) if free.gradient[place] > 0 else (none, at)
    pushed = Sampling(products, prior, y, NOISE**2, 2, np.random.default_rng(1), ends)
    pulled = Sampling(products, prior, y, NOISE**2, 2, np.random.default_rng(1), ends[::-1])
    for sampling in (pushed, pulled):
        sampling.round()
    assert pushed.step[place] == 0.0
    assert (pushed.samples[place] == 0.0).all()
    assert pulled.step[place] != 0.0
    assert free.shown.all()
