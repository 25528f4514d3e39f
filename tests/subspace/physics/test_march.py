"""All steps in one compiled loop: those that `Reduced` takes one by one, with sums in single precision."""

import numpy as np
import pytest
from helpers.scenes import cloth, document
from helpers.subspaces import moving, scene_of, some, whole

from clothfit.engine.system import build
from clothfit.subspace.physics.adjoint import simulate
from clothfit.subspace.physics.march import TOGETHER, March, roll
from clothfit.subspace.physics.reduced import Reduced

pytestmark = pytest.mark.slow  # compiles motions with inputs

STEPS = 25
METHODS = {"implicit": (2, 1), "newton": (2, 3), "bdf2": (3, 1), "bdf2 newton": (3, 2)}


def reduced(method, size=7, steps=STEPS):
    number, iterations = METHODS[method]
    fields = {"integrationMethod": number, "forwardSubSteps": iterations, "windVel": {"x": 2, "y": 0, "z": 1}}
    system = build(scene_of(moving(**fields)), 0, steps=steps)
    return Reduced(system, some(system, size))


@pytest.mark.parametrize("size", [7, 19])  # less than one register, and two of which the second is not full
@pytest.mark.parametrize("method", METHODS)
def test_its_motion_is_that_of_single_steps(method, size):
    own = reduced(method, size)
    q = simulate(own, STEPS).q
    # single precision rounds at 6e-8; steps amplify that, most where a contact switches
    np.testing.assert_allclose(roll(own, STEPS), q, atol=2e-5 * np.abs(q).max())


def test_a_motion_in_parts_is_that_in_one(monkeypatch):
    own = reduced("bdf2")
    in_one = roll(own, STEPS)
    motion, parts = March(own), np.zeros((STEPS, own.r))
    assert [motion.take(parts[:10]), motion.take(parts[10:11]), motion.take(parts[11:])] == [10, 1, 14]
    np.testing.assert_array_equal(parts, in_one[1:])
    beside = np.zeros((STEPS, own.r))
    assert March(own.under(own.system), motion).take(beside) == STEPS
    np.testing.assert_array_equal(beside, parts)
    assert TOGETHER > STEPS


def test_compressed_springs_are_clamped_where_the_matrix_is_not_definite():
    scene = scene_of(document(cloth(4, 3, springStiffness=[3e4] * 23, restLengthFactor=1), delta=0.05))
    system = build(scene, 0)
    own = Reduced(system._replace(x0=system.x0 * 0.2), whole(system))
    q = simulate(own, 3).q
    np.testing.assert_allclose(roll(own, 3), q, atol=1e-4 * np.abs(q).max())


def test_a_motion_that_is_lost_ends():
    system = build(scene_of(document(cloth(4, 3))), 0)
    own = Reduced(system._replace(v0=np.where(system.vertex.free[:, None], 1e30, 0.0)), some(system, 3))
    q = roll(own, 4)
    assert np.isnan(q[1:]).all()
