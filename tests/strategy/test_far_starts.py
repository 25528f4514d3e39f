"""Few markers of a cloth, from starts that are decades off: the same values, and intervals that contain the truth."""

import numpy as np
import pytest
from helpers.marks import FITS
from helpers.scenes import cloth, document

from clothfit.fit.estimate import estimate
from clothfit.motion.degrade import degrade
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.scene import load
from clothfit.strategy.auto import by_ladder

pytestmark = FITS

NOISE = 1e-3  # m, of a coordinate
SIDE = 5  # vertices along each side


@pytest.fixture(scope="module")
def hanging():
    """A fabric that hangs from one side, of one stiffness along, across and between, and what five markers show."""
    made = cloth(SIDE, SIDE, 0.2, optimizationSettings="nL", damping=0.02, vertMass=[0.01] * SIDE**2,
                 vertIsFixed=[i % SIDE == 0 for i in range(SIDE**2)])  # fmt: skip
    ends = np.array(made["springs"]).reshape(-1, 2)
    along = {1: 50.0, SIDE: 25.0}
    made["springStiffness"] = [along.get(int(gap), 2.5) for gap in abs(ends[:, 1] - ends[:, 0])]
    scene = load(document(made, optimizationIterations=60))
    truth = simulate(scene, tolerance=1e-10)
    return scene, truth, degrade(truth, NOISE, observed=0.2, seed=3, fps=30.0)


def error(scene, truth):
    """Root mean square distance of a scene's motion from the true one, m, over all vertices."""
    away = simulate(scene, tolerance=1e-10).positions - truth.positions
    return np.sqrt((away * away).sum(axis=-1).mean())


@pytest.mark.parametrize("start", [1e-3, 0.02, 1e4])
def test_a_start_that_is_decades_off_leads_to_the_truth(hanging, start):
    scene, truth, target = hanging
    found = estimate(scene, target, start=start)
    ends = [(-np.inf, np.inf) if pair is None else pair for block in found.parameters for pair in block.interval]
    lower, upper = np.array(ends).T
    within = (lower <= parameters(scene)) & (parameters(scene) <= upper)
    assert error(found.scene, truth) < NOISE  # 240 readings of few combinations: better than one of them
    assert np.mean(within) > 0.8  # of 95 %; values are of few families, so not apart


def test_a_ladder_comes_to_the_truth_and_not_to_the_noise(hanging):
    scene, truth, target = hanging
    start = np.full(len(parameters(scene)), 0.02)
    search = Search(Objective(scene, target, 1e-10), start, 0.0, 10**4)
    by_ladder(search, None, [start])
    assert error(with_parameters(scene, search.best.p), truth) < NOISE
