"""What users have of an objective: few names, the motion, and its products."""

import numpy as np
import pytest
from helpers.scenes import cloth, document, even

import clothfit
from clothfit.objective import objective as inside

NAMES = {
    "cost", "cost_and_gradient", "frames", "identifiable", "needs", "observations", "position_rmse", "positions",
    "pullback", "rmse", "steps", "tangent", "until",
}  # fmt: skip


@pytest.fixture
def scene():
    return clothfit.load(even("nL", 8, 3, 3))


def test_its_public_names_are_few():
    assert {name for name in dir(clothfit.Objective) if not name.startswith("_")} == NAMES


def test_it_shows_its_sizes_in_a_line(scene):
    objective = clothfit.Objective(scene, np.zeros((8, 9, 3)))
    assert repr(objective) == "<Objective of scene: position; 1 target, 8 frames, 72 positions, 16 values>"
    assert repr(clothfit.Objective(scene, objective=lambda motion: (0.0, 0 * motion.positions))) == (
        "<Objective of scene: own; 1 target, 8 frames, 0 positions, 16 values>"
    )


@pytest.mark.slow  # compiles a gradient
class TestDerivatives:
    def test_the_positions_are_those_of_a_simulation(self):
        two = [cloth(3, 3, optimizationSettings="nG"), cloth(3, 2), cloth(2, 2, optimizationSettings="Ln")]
        scene = clothfit.load(document(*two, optimizationIterations=9))
        scene = clothfit.with_parameters(scene, clothfit.parameters(scene))
        motion = clothfit.simulate(scene, tolerance=1e-14)
        found = clothfit.Objective(scene).positions(clothfit.parameters(scene))
        assert [x.shape for x in found] == [(9, 9, 3), (9, 4, 3)]  # of the objects that are fitted
        for x, number in zip(found, (0, 2), strict=True):
            np.testing.assert_array_equal(x, motion.of(number))

    def test_without_a_target_nothing_is_compared(self, scene):
        objective, p = clothfit.Objective(scene), clothfit.parameters(scene)
        cost, gradient = objective.cost_and_gradient(p)
        assert (cost, objective.observations, np.abs(gradient).max()) == (0.0, 0, 0.0)
        assert np.isnan(objective.position_rmse(p))

    def test_the_pullback_of_a_costs_derivative_is_its_gradient(self, scene):
        goal = clothfit.simulate(clothfit.with_parameters(scene, 1.3 * clothfit.parameters(scene)))
        objective, p = clothfit.Objective(scene, goal), clothfit.parameters(scene)
        (x,) = objective.positions(p)
        cost, gradient = objective.cost_and_gradient(p)
        assert cost == pytest.approx(((x - goal.positions) ** 2).sum(), rel=1e-12)
        found = objective.pullback(p, [2.0 * (x - goal.positions)])
        np.testing.assert_allclose(found, gradient, rtol=1e-12, atol=1e-14 * np.abs(gradient).max())

    def test_it_is_what_a_fit_minimises(self, scene):
        goal = clothfit.simulate(clothfit.with_parameters(scene, 1.3 * clothfit.parameters(scene)))
        options = {"objective": {"velocity": 0.1, "position": 1.0}, "loss": "huber"}
        own, p = clothfit.Objective(scene, goal, **options), clothfit.parameters(scene)
        other = inside.Objective(scene, goal, **options)
        assert own.cost(p) == other.cost(p)
        assert own.until(4).cost(p) == other.until(4).cost(p)
        assert own.rmse(own.cost(p)) == other.rmse(other.cost(p))
        assert own.position_rmse(p) == other.position_rmse(p)
        assert clothfit.verify.check(own, p).passed
