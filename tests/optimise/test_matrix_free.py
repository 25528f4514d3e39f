"""The fit without matrices: products, block conjugate gradients, samples of the posterior, and the same minimum."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from helpers.physics import TIGHT, scene, xyz
from helpers.scenes import cloth, even, trial
from scipy import stats

from clothfit.fit import trajectory_fit
from clothfit.fit.estimate import record_target
from clothfit.motion.degrade import degrade
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.matrix_free import BlockGradients, Products, Sampling
from clothfit.optimise.prior import first
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.scene import load

pytestmark = pytest.mark.slow


def trajectory(frames=10, noise=0.0, rmse=0.0, heavier=1.0, **options):
    """A small cloth in the wind beside another, against the motion of other values."""
    fits = {"springRestLength": "L", "vertVel": "G"}
    one = cloth(3, 3, optimizationSettings="LL", fit=fits)
    one["vertMass"] = [heavier * mass for mass in one["vertMass"]]
    objects = [one, cloth(2, 2, optimizationSettings="nG")]
    made = scene(*objects, optimizationIterations=frames, windVel=xyz((3, 1, -2)), fit={"windVel": True})
    p = parameters(made)
    motion = degrade(simulate(with_parameters(made, 1.1 * p), tolerance=TIGHT), noise, observed=0.9, seed=1)
    aim = Objective(made, motion, TIGHT, **options)
    return Trajectory(Search(aim, p, rmse, 10**6), aim)


@pytest.mark.parametrize("objective", ["position", {"edge-length": 2.0, "velocity": 0.1}], ids=str)
def test_products_are_those_of_the_residuals_derivative(objective):
    part = trajectory(objective=objective)
    y, t = part.y(part.search.best.p), 1e-5
    here = Products(part, y, TIGHT)
    rng = np.random.default_rng(1)
    z, weight = rng.normal(size=part.size), rng.normal(size=len(here.r))
    measured = (Products(part, y + t * z, TIGHT).r - Products(part, y - t * z, TIGHT).r) / (2 * t)
    # rounding of positions, 1e-15 / 1e-5, against changes of 1e-2; error t²
    np.testing.assert_allclose(here.forward(z), measured, atol=1e-6 * np.abs(measured).max())
    assert z @ here.back(weight) == pytest.approx(weight @ here.forward(z), rel=1e-11)  # solves to 1e-14


def test_its_squares_are_the_cost_and_its_gradient_that_of_the_matrix():
    part = trajectory()
    y = part.y(part.search.best.p)
    here, model = Products(part, y, TIGHT), part.model(y)
    assert here.r @ here.r == pytest.approx(part.cost(y), rel=1e-12)  # the same motion
    np.testing.assert_allclose(here.back(here.r), model.g, atol=1e-10 * np.abs(model.g).max())


def test_it_finds_the_truth_as_with_a_matrix(monkeypatch):
    made = load(even("nL", 15))
    target = degrade(record_target(made), every=2)
    found = []
    for largest in (0.0, np.inf):
        monkeypatch.setattr(trajectory_fit, "LARGEST", largest)
        search = Search(Objective(made, target, 1e-10), np.full(33, 20.0), 1e-7, 2000)
        with suppress(Stop):
            trajectory_fit.by_gauss_newton(search, search.best.p, search.best.p, np.inf)
        found.append(search)
    for search in found:
        assert search.objective.rmse(search.best.cost) < 1e-6
        kept = search.fitted
        assert np.median(np.abs(search.best.p[kept] / 30.0 - 1)) < 1e-3  # of an RMSE of 1e-6 m


def test_noise_leaves_the_same_minimum(monkeypatch):
    costs = []
    for largest in (0.0, np.inf):
        monkeypatch.setattr(trajectory_fit, "LARGEST", largest)
        part = trajectory(8, 1e-2, heavier=5.0)  # a light one is crushed on the way, where steps that switch to their
        # clamped form make steps of the cost
        p = part.search.best.p
        trajectory_fit.by_gauss_newton(part.search, p, p, np.inf)
        costs.append(part.search.best.cost)
    # The valley's floor is flat: 288 residuals less some 70 parameters leave a cost of 217 of the noise's squares,
    # which is uncertain by 21 of them; both end within 4 of each other.
    assert costs[0] == pytest.approx(costs[1], rel=2e-2)


# --- samples of the posterior by products: their covariance and step are those of the matrix


NOISE = 1e-3


@pytest.fixture(scope="module")
def noisy():
    """A noisy trajectory, its coordinates and its prior."""
    made = load(trial("LL", 25))
    aim = Objective(made, degrade(record_target(made), NOISE, observed=0.8, seed=2), 1e-12)
    part = Trajectory(Search(aim, parameters(made), 0.0, 10**6), aim)
    y = part.search.y
    groups = part.prior(y, None).groups
    return part, y, replace(first(y - 0.1, groups, None), tau=(0.3, 0.2)), Products(part, y, 1e-12)


@pytest.mark.parametrize("wide", [True, False])
def test_all_rounds_give_the_step_and_the_covariance_of_the_matrix(noisy, wide):
    part, y, prior, products = noisy
    model, A = part.model(y), prior.matrix(NOISE**2)
    K, count = np.linalg.inv(model.H + A), 64
    sampling = Sampling(products, prior, y, NOISE**2, count, np.random.default_rng(1), wide=wide)
    while sampling.block.W.shape[1] < len(y) and sampling.round() > 1e-9:
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


# --- block conjugate gradients: exact in as many directions as there are unknowns, and never further from the solution


def problem(size, count, seed=0, spread=1e4):
    """S with eigenvalues over `spread`, right sides, and the solutions."""
    rng = np.random.default_rng(seed)
    V = np.linalg.qr(rng.normal(size=(size, size)))[0]
    S = V * np.geomspace(1.0, spread, size) @ V.T
    B = rng.normal(size=(size, count))
    return S, B, np.linalg.solve(S, B)


def begun(S, B, X=None, diagonal=None):
    X = np.zeros_like(B) if X is None else X
    return BlockGradients(lambda z: S @ z, B, X, S @ X, np.diag(S) if diagonal is None else diagonal)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("count", [1, 3, 8])
def test_as_many_directions_as_unknowns_solve_the_equations(count, seed):
    S, B, exact = problem(24, count, seed)
    own = begun(S, B, np.random.default_rng(9).normal(size=B.shape))
    while own.W.shape[1] < 24 and own.round():
        pass
    assert own.W.shape[1] <= 24
    np.testing.assert_allclose(own.X, exact, atol=1e-9 * np.abs(exact).max())  # rounding times a condition of 1e4


def test_right_sides_that_depend_on_each_other_add_no_directions():
    S, B, exact = problem(30, 2)
    own = begun(S, np.stack([B[:, 0], 2.0 * B[:, 0], 0.0 * B[:, 0], B[:, 1]], axis=1))
    assert own.round()
    assert own.W.shape[1] == 2
    while own.W.shape[1] < 30 and own.round():
        pass
    np.testing.assert_allclose(own.X[:, 1], 2.0 * exact[:, 0], atol=1e-9 * np.abs(exact).max())
    np.testing.assert_allclose(own.X[:, 2], 0.0, atol=1e-12)
