"""Models that are played: networks beside their formula in plain double precision, and many instances at once."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from helpers.networks import by_formula, model_of
from helpers.subspaces import keys, moving, scene_of
from helpers.subspaces import model_of as physics_of

from clothfit.base.errors import InvalidInput
from clothfit.engine.system import build
from clothfit.subspace.inputs import applied
from clothfit.subspace.model import load_model, save
from clothfit.subspace.play import Instances, clamped, instances, motion_in, play, play_all
from clothfit.subspace.translation import shift, start_velocity

pytestmark = pytest.mark.slow  # compiles the engine's tables and the steps

STEPS, FRAMES = 30, 12
SCENE = scene_of(moving())
"""A cloth with wind, a moving pin, a sphere and a floor."""

GUST = {"acts": "wind", "times": [0, 0.2], "values": [[0, 0, 0], [3, 0, -3]]}
SCENES = [SCENE, applied(SCENE, [GUST]), SCENE]
network = cache(lambda: model_of(SCENE, STEPS))  # not before a test wants it, as it compiles


def with_network(**changes):
    """The model whose network has other fields."""
    part = network().parts[0]
    part = dataclasses.replace(part, network=dataclasses.replace(part.network, **changes))
    return dataclasses.replace(network(), parts=(part,))


@pytest.mark.parametrize("activation", ["relu", "elu"])
def test_a_motion_is_that_of_the_formula_and_many_move_as_each_alone(activation):
    model = with_network(activation=activation)
    part, system = model.parts[0], build(SCENE, 0, steps=STEPS)
    own = part.network
    q, before = np.zeros(own.r), -system.h * start_velocity(system, part.basis)
    w = own.signals.of(system, STEPS)
    found = play(model, SCENE, STEPS + 1)
    for t in range(STEPS):
        q, before = by_formula(own, q, before, w[t]), q
        # single precision: 6e-8 of numbers of size 1 in each of about 30 sums, and the steps forget
        np.testing.assert_allclose(found.coordinates[0][t + 1], q, atol=1e-5)
    free = system.vertex.free
    x = system.x0 + shift(system.inputs, STEPS + 1)[-1] + part.basis @ q
    np.testing.assert_allclose(found.motion.positions[-1][free], x[free], atol=3e-5)
    np.testing.assert_array_equal(found.motion.positions[-1][system.inputs.pins], system.inputs.path[STEPS])
    assert found.clamped == []
    together = play_all(model, SCENES, FRAMES).coordinates[0]
    for made, scene in zip(together, SCENES, strict=True):
        np.testing.assert_allclose(made, play(model, scene, FRAMES).coordinates[0], atol=1e-5)  # sums in another order
    assert np.abs(together[1] - together[0]).max() > 1e-3


def test_a_file_gives_the_same_motion_and_arrays_that_do_not_fit_are_refused(tmp_path):
    save(network(), tmp_path / "m.npz")
    read = load_model(tmp_path / "m.npz")
    np.testing.assert_array_equal(play(read, SCENE, 20).motion.positions, play(network(), SCENE, 20).motion.positions)
    own = network().parts[0].network
    for change in ({"offset": own.offset[1:]}, {"linear": own.linear * np.nan}, {"activation": "sine"}):
        save(with_network(**change), tmp_path / "w.npz")
        with pytest.raises(InvalidInput, match=r"w\.npz: "):
            load_model(tmp_path / "w.npz")


def test_coordinates_and_inputs_stay_within_their_ranges():
    own = network().parts[0].network
    small = with_network(range=own.range * 0.01, input_range=own.input_range / 2)
    played = play(small, SCENE, STEPS + 1)
    assert np.abs(played.coordinates[0]).max() <= np.float32(0.02)
    assert played.clamped == ["the inputs leave the range that the network was trained in; they are clamped"]


def test_what_is_not_there_is_0_and_other_pins_are_refused():
    calm, still, both = moving(), moving(), moving()
    del calm["windVelKeys"]
    still["windVelKeys"] = keys([0, 1], (0, 0, 0), (0, 0, 0))
    found = [play(network(), scene_of(each), 20).motion.positions for each in (calm, still)]
    np.testing.assert_array_equal(*found)
    both["objects"][0]["vertIsFixed"][2] = True
    both["objects"][0]["pins"][0]["vertices"] = [0, 2]
    with pytest.raises(InvalidInput, match=r"trained with wind, carrier, pins \(6 numbers\); here there are"):
        play(network(), scene_of(both), 5)


@pytest.mark.parametrize("normals", [False, True])
def test_instances_on_a_basis_move_as_each_would_alone(normals):
    model = physics_of(SCENE, normals=normals)
    found = play_all(model, SCENES, FRAMES)
    for i, scene in enumerate(SCENES):
        alone = play(model, scene, FRAMES)
        np.testing.assert_array_equal(found.coordinates[0][i], alone.coordinates[0])
        np.testing.assert_array_equal(motion_in(model, scene, found, i).positions, alone.motion.positions)
    assert np.abs(found.coordinates[0][1] - found.coordinates[0][0]).max() > 1e-3
    assert set(found.us) == {"state", "decode", "normals"}
    own = Instances(model, 0, [SCENE] * 3, FRAMES)
    for _ in range(5):
        own.step()
    for x in own.positions():
        np.testing.assert_allclose(x, play(model, SCENE, 6).motion.positions[5], atol=1e-5)  # single precision


def test_instances_stay_within_the_recorded_range_and_follow_a_seed():
    model = physics_of(SCENE)
    scenes = instances(model, SCENE, 3, 40, seed=4)
    assert play_all(model, scenes, 5).clamped == []
    for a, b in zip(scenes, instances(model, SCENE, 2, 40, seed=4), strict=False):
        np.testing.assert_array_equal(a.wind_keys.values, b.wind_keys.values)
    with pytest.raises(InvalidInput, match="not those of the model"):
        play_all(model, [scene_of({**moving(), "objects": moving()["objects"] * 2})], 3)


def test_pins_and_velocities_at_the_start_are_held_within_a_range_wherever_they_begin():
    system = build(scene_of(moving()), 0, steps=5)
    limits = {"wind": [[-9.0] * 3, [9.0] * 3], "pins": [[-0.1] * 3, [0.2] * 3], "start": [[-1.0] * 3, [2.0] * 3]}
    assert system.inputs is not None
    path = system.inputs.path + np.linspace(1e6, -1e9, len(system.inputs.path))[:, None, None]
    said: dict[str, None] = {}
    own = clamped(system._replace(inputs=system.inputs._replace(path=path), v0=system.v0 + 1e9), limits, said)
    assert [sentence.split(",")[0] for sentence in said] == [
        "the start is faster than those that were recorded", "pins leave the range that was recorded"
    ]  # fmt: skip
    pins, start = system.inputs.pins, system.x0[system.inputs.pins]
    moved = own.inputs.path - start
    np.testing.assert_allclose([moved.min(), moved.max()], [-0.1, 0.2], atol=1e-12)
    np.testing.assert_allclose(own.v0[pins], (own.inputs.path[1] - own.inputs.path[0]) / system.h)
    assert (own.v0[system.vertex.free] == 2.0).all()
    np.testing.assert_array_equal(own.inputs.wind, system.inputs.wind)
    assert clamped(system, limits, {}).inputs is system.inputs
