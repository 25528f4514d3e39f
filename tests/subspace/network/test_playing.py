"""Networks in MODEL, and the motions they play, beside the formula in plain double precision."""

import dataclasses

import numpy as np
import pytest
from helpers.networks import by_formula, model_of
from helpers.subspaces import keys, moving, scene_of

from clothfit.base.errors import InvalidInput
from clothfit.engine.system import build
from clothfit.subspace.carrier import shift, start_velocity
from clothfit.subspace.model import load_model, save
from clothfit.subspace.play import play

pytestmark = pytest.mark.slow  # compiles the engine's tables and the network's steps

STEPS = 30


@pytest.fixture(scope="module")
def scene():
    """A cloth with wind, a moving pin, a sphere and a floor."""
    return scene_of(moving())


@pytest.mark.parametrize("activation", ["relu", "elu"])
def test_a_motion_is_that_of_the_formula(scene, activation):
    model = model_of(scene, STEPS, activation=activation)
    part, system = model.parts[0], build(scene, 0, steps=STEPS)
    own = part.network
    q, before = np.zeros(own.r), -system.h * start_velocity(system, part.basis)
    w = own.signals.of(system, STEPS)
    found = play(model, scene, STEPS + 1)
    for t in range(STEPS):
        q, before = by_formula(own, q, before, w[t]), q
        # single precision: 6e-8 of numbers of size 1 in each of about 30 sums, and the steps forget
        np.testing.assert_allclose(found.coordinates[0][t + 1], q, atol=1e-5)
    free = system.vertex.free
    x = system.x0 + shift(system.inputs, STEPS + 1)[-1] + part.basis @ q
    np.testing.assert_allclose(found.motion.positions[-1][free], x[free], atol=3e-5)
    np.testing.assert_array_equal(found.motion.positions[-1][system.inputs.pins], system.inputs.path[STEPS])
    assert found.clamped == []


def test_a_file_gives_the_same_motion(scene, tmp_path):
    model = model_of(scene, STEPS)
    save(model, tmp_path / "m.npz")
    read = load_model(tmp_path / "m.npz")
    np.testing.assert_array_equal(play(read, scene, 20).motion.positions, play(model, scene, 20).motion.positions)


def test_arrays_that_do_not_fit_are_refused(scene, tmp_path):
    model = model_of(scene, STEPS)
    part = model.parts[0]
    own = part.network
    for change in ({"offset": own.offset[1:]}, {"linear": own.linear * np.nan}, {"activation": "sine"}):
        wrong = dataclasses.replace(part, network=dataclasses.replace(own, **change))
        save(dataclasses.replace(model, parts=(wrong,)), tmp_path / "w.npz")
        with pytest.raises(InvalidInput, match=r"w\.npz: "):
            load_model(tmp_path / "w.npz")


def test_coordinates_and_inputs_stay_within_their_ranges(scene):
    model = model_of(scene, STEPS)
    part = model.parts[0]
    small = dataclasses.replace(part.network, range=part.network.range * 0.01, input_range=part.network.input_range / 2)
    played = play(dataclasses.replace(model, parts=(dataclasses.replace(part, network=small),)), scene, STEPS + 1)
    assert np.abs(played.coordinates[0]).max() <= np.float32(0.02)
    assert played.clamped == ["the inputs leave the range that the network was trained in; they are clamped"]


def test_what_is_not_there_is_0_and_other_pins_are_refused(scene):
    model = model_of(scene, STEPS)
    calm, still = moving(), moving()
    del calm["windVelKeys"]
    still["windVelKeys"] = keys([0, 1], (0, 0, 0), (0, 0, 0))
    found = [play(model, scene_of(each), 20).motion.positions for each in (calm, still)]
    np.testing.assert_array_equal(*found)
    both = moving()
    both["objects"][0]["vertIsFixed"][2] = True
    both["objects"][0]["pins"][0]["vertices"] = [0, 2]
    with pytest.raises(InvalidInput, match=r"trained with wind, carrier, pins \(6 numbers\); here there are"):
        play(model, scene_of(both), 5)
