"""Many instances at once."""

import numpy as np
import pytest
from helpers import networks
from helpers.subspaces import model_of, moving, scene_of

from clothfit.base.errors import InvalidInput
from clothfit.subspace.inputs import applied
from clothfit.subspace.play import Crowd, instances, motion_in, play, play_all

pytestmark = pytest.mark.slow  # compiles motions with inputs

SCENE = scene_of(moving())
FRAMES = 12


@pytest.mark.parametrize("normals", [False, True])
def test_each_moves_as_it_would_alone(normals):
    gust = {"acts": "wind", "times": [0, 0.2], "values": [[0, 0, 0], [9, 0, -9]]}
    model = model_of(SCENE, normals=normals)
    scenes = [SCENE, applied(SCENE, [gust]), SCENE]
    found = play_all(model, scenes, FRAMES)
    for i, scene in enumerate(scenes):
        alone = play(model, scene, FRAMES)
        np.testing.assert_array_equal(found.coordinates[0][i], alone.coordinates[0])
        np.testing.assert_array_equal(motion_in(model, scene, found, i).positions, alone.motion.positions)
    assert np.abs(found.coordinates[0][1] - found.coordinates[0][0]).max() > 1e-3
    assert set(found.us) == {"state", "decode", "normals"}


def test_frames_of_all_are_those_of_each():
    model = model_of(SCENE)
    own = Crowd(model, 0, [SCENE] * 3, FRAMES)
    for _ in range(5):
        own.step()
    alone = play(model, SCENE, 6).motion.positions[5]
    for x in own.positions():
        np.testing.assert_allclose(x, alone, atol=1e-5)  # single precision


def test_instances_stay_within_the_recorded_range_and_follow_a_seed():
    model = model_of(SCENE)
    scenes = instances(model, SCENE, 3, 40, seed=4)
    assert play_all(model, scenes, 5).clamped == []
    again = instances(model, SCENE, 2, 40, seed=4)
    for a, b in zip(scenes, again, strict=False):
        np.testing.assert_array_equal(a.wind_keys.values, b.wind_keys.values)
    with pytest.raises(InvalidInput, match="not those of the model"):
        play_all(model, [scene_of({**moving(), "objects": moving()["objects"] * 2})], 3)


@pytest.mark.parametrize("activation", ["relu", "elu"])
def test_instances_of_a_network_move_as_they_would_alone(activation):
    gust = {"acts": "wind", "times": [0, 0.2], "values": [[0, 0, 0], [3, 0, -3]]}
    model = networks.model_of(SCENE, FRAMES, activation=activation)
    scenes = [SCENE, applied(SCENE, [gust])]
    found = play_all(model, scenes, FRAMES)
    for i, scene in enumerate(scenes):
        alone = play(model, scene, FRAMES)
        np.testing.assert_allclose(found.coordinates[0][i], alone.coordinates[0], atol=1e-5)  # sums in another order
    assert np.abs(found.coordinates[0][1] - found.coordinates[0][0]).max() > 1e-3
