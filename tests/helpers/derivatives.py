"""Checks of the derivatives of a scene's motion, for tests of forces and inputs in whole motions."""

import numpy as np

from clothfit import Scene, parameters, simulate
from clothfit.base.arrays import Array
from clothfit.derivative.sensitivity import columns, sweep
from clothfit.derivative.verify import check, direction_of, scaled
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import acting


def assert_right(objective: Objective, p: Array) -> None:
    """The gradient of an objective at p (P,) is the derivative of its cost, and the tangent its transpose."""
    assert check(objective, p, seed=4).passed


def quotient_error(objective: Objective, p: Array, step: float) -> float:
    """The relative difference of the slope along a direction and Richardson's extrapolation of central differences with
    a step and three times that: of fourth order, so that noise of the cost counts little in steps of 1e-5.
    """
    gradient = objective.cost_and_gradient(p)[1]
    d = scaled(p, direction_of(p, gradient, np.random.default_rng(1)))
    one, other = ((objective.cost(p + s * d) - objective.cost(p - s * d)) / (2 * s) for s in (step, 3 * step))
    return abs((9 * one - other) / 8 / float(gradient @ d) - 1)


def assert_gradient_and_tangent(
    made: Scene, tolerance: float, product: float, switches: bool = False, step: float | None = None
) -> None:
    """The gradient belongs to the cost, and the tangent is its transpose to `product`, relative; what touches what
    `switches` within the long steps of the order, but not within the short one of the difference, or within three times
    the `step` of `quotient_error`.
    """
    values = [cloth.mass * 1.1 for cloth in made.cloths], [cloth.stiffness * 0.9 for cloth in made.cloths]
    target = simulate(made.with_values(*values))
    objective = Objective(made, target, tolerance)
    found = check(objective, parameters(made), seed=1)
    assert switches or found.order > 1.9
    difference = found.difference if step is None else quotient_error(objective, parameters(made), step)
    assert difference < (1e-7 if switches else 1e-6)
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
    made: Scene, tolerance: float, product: float, equal: float = 1e-11, switches: bool = False,
    step: float | None = None,
) -> None:  # fmt: skip
    """Gradient, tangent and all columns belong to the motion and to each other; see `assert_gradient_and_tangent`."""
    assert_gradient_and_tangent(made, tolerance, product, switches, step)
    assert_dense_sensitivity(made, tolerance, equal)
