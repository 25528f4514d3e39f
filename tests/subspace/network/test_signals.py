"""What acts on a step, as numbers: how the carrier turns, and motions whose inputs differ."""

import numpy as np
import pytest
from helpers.scenes import cloth, document
from helpers.subspaces import keys, moving, scene_of

from clothfit.base.errors import InvalidInput
from clothfit.engine.system import build
from clothfit.subspace.network.signals import fitted, raw

pytestmark = pytest.mark.quick

STEPS = 10
RATE = np.deg2rad(45.0)  # rad/s


def in_frame(fixed, about):
    """A system of a cloth whose frame turns about an axis at RATE, with these vertices fixed."""
    end = [90.0 * (axis == about) for axis in "xyz"]
    turning = {"rotKeys": {**keys([0, 2], (0, 0, 0), tuple(end)), "interpolation": "linear"}}
    own = cloth(4, 3, vertIsFixed=[i in fixed for i in range(12)])
    return build(scene_of(document(own, frame=turning, integrationMethod=2)), 0, steps=STEPS)


@pytest.mark.parametrize("about", ["x", "y", "z"])
def test_the_turn_is_that_of_the_frame(about):
    """Of pins that are in no line, from the first step on."""
    system = in_frame((0, 1, 6, 11), about)
    turn = dict(raw(system, STEPS))["turn"]
    rate = RATE * (np.array(list("xyz")) == about)
    chord = (RATE * system.h) ** 2 / 10  # instead of the arc: (ωh)²/12, relative
    np.testing.assert_allclose(turn[:, :3], np.tile(rate, (STEPS, 1)), rtol=chord, atol=1e-9)
    np.testing.assert_allclose(turn[:, 3:], 0.0, atol=1e-9)


def test_pins_in_a_line_have_no_turn_about_it():
    """Those of the first row, along x."""
    assert "turn" not in dict(raw(in_frame((0, 1, 3), "x"), STEPS))
    turn = dict(raw(in_frame((0, 1, 3), "z"), STEPS))["turn"]
    np.testing.assert_allclose(turn[:, :3], np.tile([0, 0, RATE], (STEPS, 1)), rtol=1e-4, atol=1e-9)


def test_a_frame_that_does_not_turn_has_no_such_inputs():
    own = cloth(4, 3)
    shifted = {"posKeys": keys([0, 0.1, 0.2], (0, 0, 0), (0.3, 0.1, -0.2), (0, 0.4, 0))}
    found = raw(build(scene_of(document(own, frame=shifted, integrationMethod=2)), 0, steps=STEPS), STEPS)
    assert [name for name, _ in found] == ["carrier", "pins", "colliders"]


def test_motions_with_other_inputs_share_the_signals():
    """What a motion has not is 0 in it; pins that are others are refused."""
    calm, windy = moving(), moving()
    del calm["windVelKeys"]
    systems = [build(scene_of(each), 0, steps=STEPS) for each in (calm, windy)]
    own = fitted([raw(each, STEPS) for each in systems])
    assert [name for name, _ in own.parts] == ["wind", "carrier", "pins"]
    w = [own.of(each, STEPS) for each in systems]
    np.testing.assert_array_equal(w[0][:, :3], 0.0)
    np.testing.assert_array_equal(w[1][:, :3], dict(raw(systems[1], STEPS))["wind"])
    np.testing.assert_array_equal(w[0][:, 3:], w[1][:, 3:])
    with pytest.raises(InvalidInput, match="the same pins and colliders in all"):
        fitted([raw(systems[0], STEPS), raw(in_frame((0, 1, 3), "z"), STEPS)])
