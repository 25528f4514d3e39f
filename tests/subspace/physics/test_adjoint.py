"""The gradient and the tangent of reduced motions, against differences and against each other."""

import numpy as np
import pytest
from helpers.subspaces import moving, scene_of, some

from clothfit.base.arrays import Elements
from clothfit.engine.system import all_elements, build
from clothfit.subspace.physics.adjoint import KINDS, gradient, simulate, tangent, with_values
from clothfit.subspace.physics.reduced import Reduced
from clothfit.subspace.physics.samples import Selection

pytestmark = pytest.mark.slow  # compiles derivatives

STEPS = 12
METHODS = {"implicit": (2, 1), "newton": (2, 3), "bdf2": (3, 1), "bdf2 newton": (3, 2)}


def cubature_of(system):
    """Some elements with weights that are none of a kind."""
    rng = np.random.default_rng(2)
    springs = np.sort(rng.choice(len(system.springs.rest), 15, replace=False)).astype(np.int32)
    faces, vertices = np.arange(0, len(system.faces.corners), 2, dtype=np.int32), np.arange(4, 11, dtype=np.int32)
    return Selection(springs, rng.uniform(0.5, 2.0, 15), faces, rng.uniform(0.5, 2.0, len(faces)), vertices,
                     rng.uniform(0.5, 2.0, 7))  # fmt: skip


def reduced(method, weights=True):
    number, iterations = METHODS[method]
    fields = {"integrationMethod": number, "forwardSubSteps": iterations, "windVel": {"x": 2, "y": 0, "z": 1}}
    system = build(scene_of(moving(**fields)), 0, steps=STEPS)
    return Reduced(system, some(system, 7), cubature_of(system) if weights else None)


def direction_of(system, seed):
    """A random change of all kinds, relative to their values."""
    rng, own = np.random.default_rng(seed), all_elements(system)
    made = {name: getattr(own, name) * rng.uniform(-1, 1, np.shape(getattr(own, name)))
            for name in ("mass", "stiffness", *KINDS)}  # fmt: skip
    return Elements(**made)


def moved(own, direction, step):
    values = all_elements(own.system)
    changed = {name: getattr(values, name) + step * getattr(direction, name)
               for name in ("mass", "stiffness", *KINDS)}  # fmt: skip
    return with_values(own, values._replace(**changed))


@pytest.mark.parametrize("method", METHODS)
def test_the_tangent_is_the_limit_of_differences(method):
    own = reduced(method)
    direction = direction_of(own.system, 4)
    change = tangent(own, simulate(own, STEPS), direction)
    size = np.linalg.norm(change)
    assert size > 0
    errors = []
    for step in (1e-3, 1e-4):
        ahead, back = (simulate(moved(own, direction, sign * step), STEPS).q for sign in (1, -1))
        errors.append(np.linalg.norm((ahead - back) / (2 * step) - change) / size)
    assert errors[0] < 1e-3
    assert errors[1] < 1e-6  # of second order in the step, down to rounding of 1e-16/1e-4 times what steps amplify
    assert errors[1] < 0.02 * errors[0] + 1e-9


@pytest.mark.parametrize("weights", [True, False], ids=["cubature", "all elements"])
@pytest.mark.parametrize("method", METHODS)
def test_the_gradient_is_the_tangent_transposed(method, weights):
    own = reduced(method, weights)
    motion = simulate(own, STEPS)
    by_q = np.random.default_rng(9).standard_normal(motion.q.shape)
    by_q[0] = 0.0
    grad = gradient(own, motion, by_q, KINDS)
    for seed in (1, 2):
        direction = direction_of(own.system, seed)
        change = tangent(own, motion, direction)
        product = sum((getattr(grad, name) * getattr(direction, name)).sum() for name in ("mass", "stiffness", *KINDS))
        assert product == pytest.approx((by_q * change).sum(), rel=1e-9)  # rounding, cancelled in the sums


def test_springs_that_are_not_evaluated_have_no_gradient():
    own = reduced("implicit")
    motion = simulate(own, STEPS)
    grad = gradient(own, motion, np.ones_like(motion.q))
    there = np.isin(np.arange(len(grad.stiffness)), own.chosen.springs)
    assert (grad.stiffness[there] != 0).all()
    assert not grad.stiffness[~there].any()
    assert grad.drag.size == grad.rest.size == 0
