"""Inputs over time from a list of their own; and what acts on a step, as numbers for a network."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import cloth, document, sphere
from helpers.subspaces import keys, moving, scene_of

from clothfit.base.errors import InvalidInput
from clothfit.cli.subspace import FRAMES, IN_WIND, OF_SMALL, lengths
from clothfit.engine.forces.wind import add_force
from clothfit.engine.system import build
from clothfit.subspace.inputs import Ranges, applied, episodes, gentle_wind, load, varied
from clothfit.subspace.network.signals import fitted, raw

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


@pytest.mark.parametrize("law", ["editor", "air"])
def test_the_wind_by_default_pushes_a_quarter_of_the_weight(law):
    scene = replace(SCENE, cloths=tuple(replace(each, drag_law=law) for each in SCENE.cloths))
    wind, own = gentle_wind(scene), scene.cloths[0]
    system = build(scene, 0)
    f = np.zeros_like(system.x0)
    blown = system.faces._replace(wind=np.array([0.0, wind, 0.0]))
    add_force(blown, system.x0, np.zeros_like(f), f)
    weight = 9.81 * own.mass[~own.fixed].sum()
    error = 0.05 if law == "editor" else 0.1  # two digits of the wind are kept, and the push grows with its square
    assert abs(f[:, 1].sum()) == pytest.approx(0.25 * weight, rel=error)


def test_motions_of_a_flag_are_long_and_those_of_what_falls_moves_or_lies_on_something_are_not():
    blown = {"windVel": {"x": 5.0, "y": 0.0, "z": 0.0}}
    loose = cloth(vertIsFixed=[False] * 12)
    gusts = {"windVelKeys": keys(TIMES, *VALUES)}
    assert lengths(scene_of(document(**blown))) == (OF_SMALL, IN_WIND)
    others = [document(), document(loose, **blown), document(**blown, **gusts), document(colliders=BALLS, **blown)]
    assert {lengths(scene_of(each)) for each in others} == {(OF_SMALL, FRAMES)}


# --- as numbers: how the carrier turns, and motions whose inputs differ

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
