"""The fit without matrices: products with the derivative of the residuals, and the same minimum."""

from contextlib import suppress

import numpy as np
import pytest
from helpers.marks import FITS
from helpers.physics import TIGHT, scene, xyz
from helpers.scenes import cloth, even

from clothfit.fit.estimate import record_target
from clothfit.motion.degrade import degrade
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.matrix_free import Products
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.scene import load
from clothfit.strategy import trajectory_fit

pytestmark = FITS


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
