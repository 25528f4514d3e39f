"""The gradient of textbooks in `benchmarks/approximate.py`: where it is the exact one, and its transpose."""

from importlib import import_module

import numpy as np
import pytest
from helpers.paths import BENCHMARKS
from helpers.physics import TIGHT, ball, direction, product, relative, scene, xyz
from helpers.scenes import cloth

from clothfit.base.arrays import Elements
from clothfit.derivative import adjoint
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.scene.forces import Forces

pytestmark = pytest.mark.slow  # compiles a fit

KIND = ("mass", "stiffness", "damping", "drag", "velocity", "rest", "gravity", "force")
STEPS = 12


@pytest.fixture(scope="module")
def approximate():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        yield import_module("approximate")


def pushed(drag, damping, **fields):
    """A cloth of 3 × 3 vertices, two held, on which random forces act, its motion and a weight on the positions."""
    own = scene(cloth(3, 3, vertMass=[0.1] * 9, dragCoefficient=drag, damping=damping), **{"delta": 0.01, **fields})
    rng = np.random.default_rng(3)
    forces = Forces(own.delta * np.arange(STEPS), rng.normal(size=(STEPS, 9, 3)))
    system = build(own.with_forces(forces), 0, steps=STEPS)
    memory, good = rollout(system, STEPS, TIGHT)
    assert good == STEPS
    return system, memory, rng.normal(size=memory.x.shape)


def test_the_same_where_the_step_is_fully_implicit(approximate):
    """Newton's method ends at the step whose adjoint this is. The Jacobians are those of the iteration before, which is
    √1e-14 off as the method is of second order. One iteration alone is far off.
    """
    error = []
    for newton in (1, 12):
        given = (*pushed(0.0, 0.0, delta=0.02, forwardSubSteps=newton), TIGHT, ("force",))
        error.append(relative(*(each.gradient(*given).force for each in (adjoint, approximate))))
    assert error[0] > 1e-3
    assert error[1] < 1e-6


def test_the_tangent_is_the_transpose_of_the_gradient(approximate):
    """With air, damping and a collider as well; both are rounded, and solved for to 1e-14."""
    more = {"windVel": xyz((3, 1, -2)), "colliders": [ball((1.0, -0.75, 1.0), 0.8)], "forwardSubSteps": 3}
    system, memory, weight = pushed(0.4, 0.7, **more)
    change = direction(system)
    change = change._replace(**{name: getattr(change, name)[:0] for name in Elements._fields if name not in KIND})
    forward = np.vdot(weight, approximate.tangent(system, memory, change, TIGHT))
    back = product(approximate.gradient(system, memory, weight, TIGHT, KIND[2:]), change)
    assert forward == pytest.approx(back, rel=1e-11)
