"""Keys: what they ask for, and what is refused with its place."""

import json

import numpy as np
import pytest
from helpers.physics import chain, scene

from clothfit import InvalidInput, Motion
from clothfit.control import keyframes

TWO = [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]


def own():
    """Two objects of three and two vertices, steps of 0.1 s; the masses of the first are 1, 2, 3 kg."""
    return scene(chain(3, "nn"), chain(2, "nn"), delta=0.1)


def read(**key):
    """The keys of a document with one."""
    return keyframes.from_json(json.dumps({"keys": [{"time": 0.2, **key}]}), "k.json", own())


def test_what_a_key_asks_for():
    (key,) = read(vertices=[2, 0], positions=TWO, velocities=TWO, weight=2, hard=True)
    assert (key.step, key.cloth, key.vertices.tolist(), key.weight, key.hard) == (2, 0, [2, 0], 2.0, True)
    assert key.positions.tolist() == key.velocities.tolist() == TWO
    (key,) = read(object=1, positions=TWO)
    assert (key.cloth, key.vertices.tolist()) == (1, [0, 1])
    (key,) = read(vertices=[1, 2], average=[1, 2, 3])
    assert (key.share.tolist(), key.positions.tolist()) == ([0.5, 0.5], [[1, 2, 3]])
    (key,) = read(centre=[1, 2, 3])
    np.testing.assert_allclose(key.share, [1 / 6, 2 / 6, 3 / 6], rtol=1e-15)


def test_keys_are_in_order_of_time():
    keys = [{"time": t, "vertices": [0], "positions": [[0, 0, 0]]} for t in (0.5, 0.1, 0.3)]
    assert [key.step for key in keyframes.from_json(json.dumps({"keys": keys}), "k", own())] == [1, 3, 5]


def test_the_frames_of_a_motion_are_keys():
    x = np.arange(30.0).reshape(2, 5, 3)
    seen = np.ones((2, 5), bool)
    seen[1, [0, 3]] = False
    motion = Motion(x, np.array([0.0, 0.4]), (3, 2), seen)
    first, second = keyframes.from_motion(motion, own())
    assert (first.step, first.cloth, first.vertices.tolist()) == (4, 0, [1, 2])
    assert (second.step, second.cloth, second.vertices.tolist()) == (4, 1, [1])
    assert second.positions.tolist() == x[1, [4]].tolist()
    with pytest.raises(InvalidInput, match="has no frame after the start"):
        keyframes.from_motion(Motion(x[:1], np.zeros(1), (3, 2)), own())


FAULTS = {
    "no time": ({"time": None, "positions": TWO}, "k.json: keys[0].time: is missing"),
    "the start": ({"time": 0.0, "positions": TWO}, "k.json: keys[0]: 0 s is not after the start"),
    "between steps": ({"time": 0.25, "positions": TWO}, "0.25 s is between two steps of 0.1 s; the nearest"),
    "endless": ({"time": 1e400, "positions": TWO}, "keys[0].time: is not a number below"),
    "no object": ({"object": 2, "positions": TWO}, "keys[0].object: there is no such object; there are 2"),
    "no vertex": ({"vertices": [3], "positions": TWO}, "keys[0].vertices[0]: there is no such vertex; there are 3"),
    "a huge vertex": ({"vertices": [10**400], "positions": TWO}, "keys[0].vertices[0]: there is no such vertex"),
    "twice": ({"vertices": [0, 0], "positions": TWO}, "keys[0].vertices: names a vertex twice"),
    "too few": ({"positions": TWO}, "keys[0].positions: has 2 items for 3 vertices"),
    "no vector": ({"vertices": [0], "positions": [[0, 0]]}, "keys[0].positions[0]: must be three numbers"),
    "NaN": ({"vertices": [0], "positions": [[0, 0, float("nan")]]}, "keys[0].positions[0]: must be three finite"),
    "huge": ({"vertices": [0], "positions": [[0, 0, 10**400]]}, "keys[0].positions[0]: must be three finite"),
    "nothing": ({}, "needs one of positions, average and centre; it has none"),
    "both": ({"centre": [0, 0, 0], "average": [0, 0, 0]}, "it has average and centre"),
    "part of the centre": ({"centre": [0, 0, 0], "vertices": [0]}, "the centre of mass is that of all"),
    "a mean that moves": ({"centre": [0, 0, 0], "velocities": TWO}, "keys[0].velocities: go with positions only"),
    "weight": ({"centre": [0, 0, 0], "weight": 0}, "keys[0].weight: must be within"),
    "hard": ({"centre": [0, 0, 0], "hard": 1}, "keys[0].hard: must be true or false"),
    "misspelt": ({"centre": [0, 0, 0], "wieght": 1}, "keys[0].wieght: there is no such field"),
}


@pytest.mark.parametrize(("key", "said"), FAULTS.values(), ids=list(FAULTS))
def test_faults_are_named_with_their_place(key, said):
    with pytest.raises(InvalidInput) as refused:
        read(**key)
    assert said in str(refused.value)


@pytest.mark.parametrize("text", ["{", "[]", '{"keys": []}', '{"keys": {}}', '{"keys": [1]}', "[" * 100_000])
def test_other_documents_are_refused(text):
    with pytest.raises(InvalidInput, match=r"^k\.json: "):
        keyframes.from_json(text, "k.json", own())


def test_two_keys_for_one_vertex_at_one_time_are_refused():
    keys = [{"time": 0.2, "vertices": [0], "positions": [[0, 0, 0]]}] * 2
    with pytest.raises(InvalidInput, match=r"two ask for vertex 0 of objects\[0\] at one time"):
        keyframes.from_json(json.dumps({"keys": keys}), "k", own())
