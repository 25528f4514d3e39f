"""The fit without matrices: products with the derivative of the residuals, and the same minimum."""

from contextlib import suppress

import numba
import numpy as np
import pytest
from helpers.physics import TIGHT, scene, xyz
from helpers.scenes import cloth, even

from clothfit.fit.estimate import record_target
from clothfit.motion.degrade import degrade
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.matrix_free import FAR, Residuals
from clothfit.optimise.priors.prior import none
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.scene import load
from clothfit.strategy import trajectory_fit

pytestmark = [
    pytest.mark.slow,  # compiles a fit
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of simulations need compilation"),
]


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


@pytest.mark.parametrize("tau", [None, 0.5, np.inf])
@pytest.mark.parametrize("objective", ["position", {"edge-length": 2.0, "velocity": 0.1}], ids=str)
def test_products_are_those_of_the_residuals_derivative(objective, tau):
    part = trajectory(objective=objective)
    y = part.y(part.search.best.p)
    residuals = Residuals(part, part.prior(y - 0.1, tau), y)
    r, J, t = residuals(y), residuals.jacobian(y), 1e-5
    rng = np.random.default_rng(1)
    z, weight = rng.normal(size=part.size), rng.normal(size=len(r))
    measured = (residuals(y + t * z) - residuals(y - t * z)) / (2 * t)
    # rounding of positions, 1e-15 / 1e-5, against changes of 1e-2; error t²
    np.testing.assert_allclose(J @ z, measured, atol=1e-6 * np.abs(measured).max())
    forward = weight @ (J @ z)
    assert z @ (J.T @ weight) == pytest.approx(forward, rel=1e-11)  # solves to 1e-14


def test_without_a_prior_its_squares_are_the_cost():
    part = trajectory()
    y = part.y(part.search.best.p)
    residuals = Residuals(part, none(part.size), y)
    r = residuals(y)
    assert r @ r == pytest.approx(part.cost(y), rel=1e-12)  # the same motion
    model = part.model(y)
    np.testing.assert_allclose(residuals.jacobian(y).T @ r, model.g, atol=1e-10 * np.abs(model.g).max())


def test_where_the_simulation_diverges_the_residuals_are_huge_and_finite():
    made = load(even("nG", 60, integrationMethod=0, delta=0.004))
    aim = Objective(made, simulate(made), 1e-10)
    part = Trajectory(Search(aim, np.array([20.0]), 0.0, 100), aim)
    y = part.y(np.array([20.0]))
    residuals = Residuals(part, none(1), y)
    near, far = residuals(y), residuals(part.y(np.array([1e4])))
    assert near.shape == far.shape
    assert (far == FAR * np.abs(near).max()).all()


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
