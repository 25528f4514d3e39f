"""The gradient by factors on a scene's values: against its own cost, and against that by the values themselves."""

import numba
import numpy as np
import pytest
from helpers.physics import METHODS, TIGHT, ball, scene, sheet, xyz

from clothfit.derivative.verify import DIFFERENCE, ORDER, PRODUCT, check
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective, cost_and_gradient
from clothfit.scene.fit_vector import parameters, with_parameters

pytestmark = [
    pytest.mark.slow,  # compiles a fit
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of simulations are slow without compilation"),
]

FRAMES = 14
VALUES = {
    "vertMass": np.linspace(0.05, 0.4, 9).tolist(),
    "springStiffness": np.linspace(4.0, 60.0, 16).tolist(),
}


def made(letters, rest="n", **fields):
    """A sheet in wind on a sphere, whose values all differ."""
    own = sheet(letters, fit={"springRestLength": rest})
    return scene(
        {**own, **VALUES}, integrationMethod=METHODS["implicit"], delta=0.02, optimizationIterations=FRAMES,
        windVel=xyz((4, -2, -3)), colliders=[ball((1.0, -0.748, 1.0), 0.75)], **fields,
    )  # fmt: skip


def truth(given):
    """The motion of other values."""
    p = parameters(given)
    moved = p * 1.15 * np.exp(0.1 * np.random.default_rng(12).normal(size=p.shape))
    return simulate(with_parameters(given, moved), tolerance=TIGHT)


@pytest.mark.parametrize("letters", ["Fn", "nF", "FF", "Rn", "nR", "RM", "Mn", "nM", "MM", "FL", "MG"])
def test_the_gradient_is_the_derivative_of_the_cost(letters):
    given = made(letters)
    at = parameters(given) * np.exp(0.1 * np.random.default_rng(5).normal(size=len(parameters(given))))
    for p in (parameters(given), at):
        report = check(Objective(given, truth(given)), p, seed=4)
        assert report.order > ORDER
        assert report.difference < DIFFERENCE
        assert report.product < PRODUCT


@pytest.mark.parametrize("mode", "FRM")
def test_the_gradient_by_factors_follows_from_that_by_the_values(mode):
    given, each = made(mode * 2, rest=mode), made("LL", rest="L")
    goal = truth(each)
    (value, gradient), (same, by_value) = (cost_and_gradient(one, goal) for one in (given, each))
    assert value == same  # the same motion
    values = parameters(each)
    parts = [(own.factors.dense(), all_of) for own, all_of in zip(given.blocks, each.blocks, strict=True)]
    expected = [B.T @ (by_value * values)[own.part] for B, own in parts]
    np.testing.assert_allclose(gradient, np.concatenate(expected), rtol=1e-11)  # sums that may cancel


def test_of_two_experiments_the_factors_are_on_the_values_of_the_main_scene():
    main = made("MR")
    other = made("nn", gravity=xyz((0, -5, 1)))
    changed = with_parameters(main, parameters(main) * 1.3)
    other = other.with_values([changed.cloths[0].mass], [changed.cloths[0].stiffness])
    p = np.exp(0.1 * np.random.default_rng(6).normal(size=len(parameters(main))))
    wanted = with_parameters(main, p).cloths[0]
    goal = simulate(other.with_values([wanted.mass], [wanted.stiffness]), FRAMES, TIGHT)
    assert Objective(main, [(goal, other)], TIGHT).cost(p) == 0.0
