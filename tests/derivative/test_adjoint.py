"""The reverse and the forward sweep against finite differences of the rollout and against each other."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import KINDS, TIGHT, gentle, relative

from clothfit.base.arrays import Elements
from clothfit.derivative import adjoint
from clothfit.engine.rollout import rollout

pytestmark = pytest.mark.slow  # compiles a fit

STEPS = 6
LATE = {"times": [0.0, 0.02, 0.05], "values": 3 * [{"x": 1, "y": 2, "z": -1}], "interpolation": "hold"}
"""Keys of a wind, of which the second holds from the time of step 4 on."""


def positions(system, change, t):
    """Positions with all values changed by t · change."""
    memory, good = rollout(physics.shifted(system, change, t), STEPS, TIGHT)
    assert good == STEPS
    return memory.x


def swept(system):
    """A rollout and a random weight on its positions."""
    memory, good = rollout(system, STEPS, TIGHT)
    assert good == STEPS
    return memory, np.random.default_rng(6).normal(size=memory.x.shape)


@pytest.mark.parametrize(("method", "lead"), [("symplectic", 0), ("implicit", 1), ("bdf2", 1)])
def test_a_later_key_of_the_wind_changes_nothing_before_it_acts(method, lead):
    system = gentle(method, windVelKeys=LATE, fit={"windVelKeys": "L"})
    memory, _ = swept(system)
    change, t = physics.nothing(system), 1e-5
    change.gusts[1] = (1.0, 2.0, -1.0)
    begins = adjoint.first_step(system, change)
    assert begins == 4 - lead
    measured = (positions(system, change, t) - positions(system, change, -t)) / (2 * t)
    found = adjoint.tangent(system, memory, change, TIGHT)
    assert not found[: begins + 1].any()
    assert found[begins + 1].any()
    assert relative(found, measured) < 1e-6  # rounding 1e-15 / 1e-5 against relative derivatives of 1e-4 and more
    change.damping[:] = 1.0
    assert adjoint.first_step(system, change) == 0


def test_what_nobody_asks_for_is_empty_and_the_rest_is_the_same():
    system = gentle()
    memory, weight = swept(system)
    full = adjoint.gradient(system, memory, weight, TIGHT, KINDS)
    some = adjoint.gradient(system, memory, weight, TIGHT, ["rest", "wind"])
    asked = ("mass", "stiffness", "rest", "wind")
    for name in Elements._fields:
        expected = getattr(full, name) if name in asked else getattr(full, name)[:0]
        np.testing.assert_array_equal(getattr(some, name), expected)


def test_what_no_motion_reveals_has_no_gradient():
    system = gentle()
    memory, weight = swept(system)
    gradient = adjoint.gradient(system, memory, weight, TIGHT)
    assert np.flatnonzero(gradient.mass == 0).tolist() == [0, 2]  # the fixed vertices
    assert np.all(gradient.stiffness != 0)  # no spring joins two of them
    velocity = adjoint.gradient(system, memory, weight, TIGHT, ["velocity"]).velocity
    assert np.flatnonzero((velocity == 0).all(axis=1)).tolist() == [0, 2]


def test_the_weight_of_the_initial_frame_does_not_count():
    system = gentle()
    memory, weight = swept(system)
    before = adjoint.gradient(system, memory, weight, TIGHT)
    weight[0] += 1.0
    after = adjoint.gradient(system, memory, weight, TIGHT)
    np.testing.assert_array_equal(before.mass, after.mass)
    np.testing.assert_array_equal(before.stiffness, after.stiffness)
    assert np.abs(adjoint.tangent(system, memory, physics.direction(system), TIGHT)[0]).max() == 0.0
