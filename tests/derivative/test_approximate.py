"""The approximate sweep back: where it is the exact one, and how fast it comes near it elsewhere."""

import numpy as np
import pytest
from helpers.physics import METHODS, TIGHT, ball, direction, product, relative, scene, thing, xyz
from helpers.scenes import cloth

from clothfit.base.arrays import Elements
from clothfit.derivative import adjoint, approximate
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.scene.forces import Forces

pytestmark = pytest.mark.slow  # compiles a fit

KIND = ("mass", "stiffness", "damping", "drag", "velocity", "rest", "gravity", "force")
ALL = ("force", "velocity", "gravity")


def pushed(one, steps, delta=0.01, seed=3, **fields):
    """The system of an object on which random forces act."""
    own = scene(one, delta=delta, **fields)
    times, rng = delta * np.arange(steps), np.random.default_rng(seed)
    return build(own.with_forces(Forces(times, rng.normal(size=(steps, len(own.cloths[0].mass), 3)))), 0, steps=steps)


def lossless(**fields):
    """A cloth of 3 × 3 vertices, two held, whose forces have no Jacobians but those that the solver knows."""
    return cloth(3, 3, vertMass=[0.1] * 9, dragCoefficient=0.0, damping=0.0, **fields)


def both(system, steps, kinds=ALL):
    """The exact and the approximate gradient of a random weight on the positions."""
    memory, good = rollout(system, steps, TIGHT)
    assert good == steps
    weight = np.random.default_rng(6).normal(size=memory.x.shape)
    return [each.gradient(system, memory, weight, TIGHT, kinds) for each in (adjoint, approximate)]


def assert_same(found, tolerance):
    """Every kind of two gradients is the same."""
    for exact, own in zip(*found, strict=True):
        np.testing.assert_allclose(own, exact, rtol=0, atol=tolerance * np.abs(exact).max(initial=0.0))


def test_the_same_for_a_vertex_that_falls_and_is_damped():
    """Its forces are linear in the state, so no derivative is left out; rounding of 20 steps."""
    assert_same(both(pushed(thing([(0, 0, 0)], mass=0.5, damping=2.0), 20), 20), 1e-12)


def test_the_same_for_springs_of_no_length():
    """f = −k (x_a − x_b) is linear. With pins, so that what they pull counts; rounding through a cloth of 9."""
    path = [xyz((0, 0, 0)), xyz((0.3, 0, 0.5))]
    pins = [{"vertices": [0], "posKeys": {"times": [0.0, 0.1], "values": path}}]
    own = lossless(pins=pins, fit={"posKeys": "L", "pinOffset": "G"})
    system = pushed(own, 20)
    system = system._replace(springs=system.springs._replace(rest=np.zeros_like(system.springs.rest)))
    found = both(system, 20, (*ALL, "path", "shift"))
    assert np.abs(found[0].path).max() > 0
    assert_same(found, 1e-10)


def test_the_same_where_the_step_is_fully_implicit():
    """Newton's method ends at the step whose adjoint this is. The Jacobians are those of the iteration before, which is
    √1e-14 off as the method is of second order. One iteration alone is far off.
    """
    error = [
        relative(*(each.force for each in both(pushed(lossless(), 20, delta=0.02, forwardSubSteps=newton), 20)))
        for newton in (1, 12)
    ]
    assert error[0] > 1e-3
    assert error[1] < 1e-6


@pytest.mark.parametrize("newton", [1, 3])
def test_the_tangent_is_the_transpose_of_the_gradient(newton):
    """With air, damping and a collider as well; both are rounded, and solved for to 1e-14."""
    one = cloth(3, 3, vertMass=[0.1] * 9, dragCoefficient=0.4, damping=0.7)
    more = {"windVel": xyz((3, 1, -2)), "colliders": [ball((1.0, -0.75, 1.0), 0.8)], "forwardSubSteps": newton}
    system = pushed(one, 12, **more)
    memory, good = rollout(system, 12, TIGHT)
    assert good == 12
    weight = np.random.default_rng(6).normal(size=memory.x.shape)
    change = direction(system)
    change = change._replace(**{name: getattr(change, name)[:0] for name in Elements._fields if name not in KIND})
    forward = np.vdot(weight, approximate.tangent(system, memory, change, TIGHT))
    back = product(approximate.gradient(system, memory, weight, TIGHT, KIND[2:]), change)
    assert forward == pytest.approx(back, rel=1e-11)


@pytest.mark.parametrize("method", ["implicit", "symplectic", "explicit"])
def test_the_error_falls_with_the_step(method):
    """By half with h each time, at the same forces; not so of BDF2, whose weights of the last steps are others."""
    errors = []
    for halves in (1, 2, 4):
        steps = 20 * halves
        system = pushed(lossless(), steps, 0.008 / halves, integrationMethod=METHODS[method])
        assert system.inputs is not None
        system.inputs.force[:steps] = np.repeat(system.inputs.force[:steps:halves][:20], halves, axis=0)
        memory, good = rollout(system, steps, TIGHT)
        assert good == steps
        last = np.zeros_like(memory.x)
        last[-1] = np.random.default_rng(6).normal(size=last.shape[1:])
        found = [each.gradient(system, memory, last, TIGHT, ("force",)).force for each in (adjoint, approximate)]
        errors.append(relative(found[1][:steps], found[0][:steps]))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert orders.min() > 0.8  # of h alone 1; the next order is a few hundredths of it here
    assert orders.max() < 1.3
