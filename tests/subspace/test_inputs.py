"""Inputs over time from a list of their own."""

import json

import numpy as np
import pytest
from helpers.scenes import cloth, document, sphere
from helpers.subspaces import keys, scene_of

from clothfit.base.errors import InvalidInput
from clothfit.cli.subspace import FRAMES, IN_WIND, OF_SMALL, lengths
from clothfit.engine.system import build
from clothfit.subspace.inputs import Ranges, applied, episodes, gentle_wind, load, varied

BALLS = [sphere(0.1), {**sphere(0.2), "friction": 0.1}]
SCENE = scene_of(document(cloth(), colliders=BALLS))
TIMES, VALUES = [0.0, 0.1, 0.3], [(0, 0, 0), (1, 2, 3), (-1, 0, 2)]


@pytest.mark.parametrize(
    ("item", "fields"),
    [
        ({"acts": "wind", "values": VALUES}, {"windVelKeys": keys(TIMES, *VALUES)}),
        ({"acts": "gravity", "values": VALUES}, {"gravityKeys": keys(TIMES, *VALUES)}),
        ({"acts": "collider", "collider": 0, "pos": VALUES},
         {"colliders": [{**BALLS[0], "posKeys": keys(TIMES, *VALUES)}, BALLS[1]]}),
        ({"acts": "collider", "collider": 1, "rot": VALUES},
         {"colliders": [BALLS[0], {**BALLS[1], "rotKeys": keys(TIMES, *VALUES)}]}),
        ({"acts": "pins", "vertices": [3], "offsets": VALUES},
         {"objects": [cloth(pins=[{"vertices": [3], "posKeys": keys(TIMES, *VALUES)}])]}),
        ({"acts": "frame", "pos": VALUES}, {"frame": {"posKeys": keys(TIMES, *VALUES)}}),
    ],
)  # fmt: skip
def test_they_do_what_keys_of_a_scene_do(item, fields):
    got = build(applied(SCENE, [{"times": TIMES, "interpolation": "smooth", **item}]), 0, steps=20).inputs
    same = build(scene_of({**document(cloth(), colliders=BALLS), **fields}), 0, steps=20).inputs
    for name in ("wind", "gravity", "centre", "path", "pins"):
        np.testing.assert_array_equal(getattr(got, name), getattr(same, name))


@pytest.mark.parametrize(
    ("item", "said"),
    [
        ({"acts": "rain"}, r"inputs\[0\].acts: 'rain' is none of wind, gravity"),
        ({"acts": "wind"}, r"inputs\[0\]: needs values, with times, or a file"),
        ({"acts": "wind", "times": [0, 0], "values": [[0, 0, 0]] * 2}, "times must increase"),
        ({"acts": "wind", "times": [0], "values": [[0, 0]]}, "needs a list of finite vectors"),
        ({"acts": "wind", "times": [0], "values": [[0, 0, float("nan")]]}, "needs a list of finite vectors"),
        ({"acts": "wind", "times": [0], "values": [[0, 0, 0]], "pos": []}, "wind has no pos"),
        ({"acts": "pins", "vertices": [1], "times": [0], "offsets": [[0, 0, 0]]}, "only fixed vertices"),
        ({"acts": "pins", "object": 1, "times": [0], "offsets": [[0, 0, 0]]}, "1 is none of the 1 there are"),
        ({"acts": "collider", "collider": 2, "times": [0], "pos": [[0, 0, 0]]}, "there is no collider 2"),
        ({"acts": "wind", "times": [0], "values": [[0, 0, 0]], "interpolation": "wavy"}, "'wavy' is none of linear"),
    ],
)
def test_what_is_wrong_is_named(item, said):
    with pytest.raises(InvalidInput, match=said):
        applied(SCENE, [item])


def test_a_file_has_a_list(tmp_path):
    path = tmp_path / "inputs.json"
    path.write_text(json.dumps({"inputs": [{"acts": "wind", "times": [0], "values": [[1, 0, 0]]}]}))
    assert load(str(path))[0]["acts"] == "wind"
    for text in ("[", "{}", '{"inputs": 3}', "[1]"):
        path.write_text(text)
        with pytest.raises(InvalidInput, match=r"inputs\.json: it "):
            load(str(path))


def test_episodes_are_the_same_for_the_same_seed_and_within_their_ranges():
    ranges = Ranges(4.0, pins=0.2)
    made = episodes(SCENE, ranges, 4, 2.0, 7)
    assert made == episodes(SCENE, ranges, 6, 2.0, 7)[:4]
    assert made[0] != episodes(SCENE, ranges, 1, 2.0, 8)[0]
    for each in made:
        wind, pins = np.array(each.items[0]["values"]), np.array(each.items[1]["offsets"])
        assert abs(wind).max() <= 4.0
        assert abs(pins).max() <= 0.2
        assert not pins[0].any()
    rests = np.array(made[1].items[0]["values"])
    late = np.array(made[1].items[0]["times"]) > 1.4
    assert not rests[late].any()
    assert varied(SCENE, made[0]).wind_keys is not None


def test_the_wind_by_default_pushes_a_quarter_of_the_weight():
    wind, own = gentle_wind(SCENE), SCENE.cloths[0]
    system = build(SCENE, 0)
    from clothfit.engine.forces.wind import add_force

    f = np.zeros_like(system.x0)
    blown = system.faces._replace(wind=np.array([0.0, wind, 0.0]))
    add_force(blown, system.x0, np.zeros_like(f), f)
    weight = 9.81 * own.mass[~own.fixed].sum()
    assert abs(f[:, 1].sum()) == pytest.approx(0.25 * weight, rel=0.05)  # two digits of the wind are kept


def test_motions_of_a_flag_are_long_and_those_of_what_falls_moves_or_lies_on_something_are_not():
    blown = {"windVel": {"x": 5.0, "y": 0.0, "z": 0.0}}
    loose = cloth(vertIsFixed=[False] * 12)
    gusts = {"windVelKeys": keys(TIMES, *VALUES)}
    assert lengths(scene_of(document(**blown))) == (OF_SMALL, IN_WIND)
    others = [document(), document(loose, **blown), document(**blown, **gusts), document(colliders=BALLS, **blown)]
    assert {lengths(scene_of(each)) for each in others} == {(OF_SMALL, FRAMES)}
