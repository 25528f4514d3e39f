"""Checks of the derivatives of a scene's motion, for tests of forces and inputs in whole motions."""

import numpy as np

from clothfit import Scene, parameters, simulate
from clothfit.base.arrays import Array
from clothfit.derivative.sensitivity import columns, sweep
from clothfit.derivative.verify import check
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import acting


def assert_right(objective: Objective, p: Array) -> None:
    """The gradient of an objective at p (P,) is the derivative of its cost, and the tangent its transpose."""
    assert check(objective, p, seed=4).passed


def assert_gradient_and_tangent(made: Scene, tolerance: float, product: float, switches: bool = False) -> None:
    """The gradient belongs to the cost, and the tangent is its transpose to `product`, relative; what touches what
    `switches` within the long steps of the order, but not within the short one of the difference.
    """
    values = [cloth.mass * 1.1 for cloth in made.cloths], [cloth.stiffness * 0.9 for cloth in made.cloths]
    target = simulate(made.with_values(*values))
    found = check(Objective(made, target, tolerance), parameters(made), seed=1)
    assert switches or found.order > 1.9
    assert found.difference < (1e-7 if switches else 1e-6)
    assert found.product < product


def assert_dense_sensitivity(made: Scene, tolerance: float, equal: float = 1e-11) -> None:
    """The columns of the sensitivity, along a direction, are the tangent to `equal`, relative."""
    objective, p = Objective(made, simulate(made), tolerance), parameters(made)
    system, tape = objective.simulate(objective.runs[0], p)
    direction = np.random.default_rng(2).normal(size=len(p))
    change = objective.tangent(p, direction)[0][:, system.vertex.free]
    wanted = columns(system, acting(objective.scene, 0), p, np.arange(len(p), dtype=np.int32), np.ones(len(p)), len(p))
    for t, dx in enumerate(sweep(system, tape, wanted)):
        expected = change[t + 1].reshape(-1)
        # two ways to the same sums of some hundred products
        np.testing.assert_allclose(dx @ direction, expected, atol=equal * np.abs(expected).max())


def assert_derivatives(
    made: Scene, tolerance: float, product: float, equal: float = 1e-11, switches: bool = False
) -> None:
    """Gradient, tangent and all columns belong to the motion and to each other; see `assert_gradient_and_tangent`."""
    assert_gradient_and_tangent(made, tolerance, product, switches)
    assert_dense_sensitivity(made, tolerance, equal)
