"""Keys and pins in the scene file: what is refused, and where."""

import copy
import json
import os

import pytest
from helpers.physics import xyz
from helpers.scenes import MISSING, changed, document, load_text, problems, sphere

from clothfit.objective.identifiability import identifiable
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.scene import dumps, load, save

PIN = {"vertices": [0, 3], "posKeys": {"times": [0, 1], "values": [xyz((0, 0, 0)), xyz((1, 0, 0))]}}


def scene():
    """A scene with keys everywhere: vertices 0 and 3 of its object are fixed."""
    made = copy.deepcopy(document(colliders=[sphere()]))
    made["objects"][0]["pins"] = [copy.deepcopy(PIN)]
    made["windVelKeys"] = {"times": [0.0, 0.5], "values": [xyz((0, 0, 0)), xyz((1, 2, 3))], "interpolation": "smooth"}
    made["gravityKeys"] = {"times": [0.1], "values": [xyz((0, 0, 0))], "interpolation": "hold"}
    made["colliders"][0]["posKeys"] = copy.deepcopy(PIN["posKeys"])
    return made


WIND = ("windVelKeys",)
POSITION = ("objects", 0, "pins", 0, "posKeys")
FAULTS = [
    ((*WIND, "times"), [0.5, 0.5], "windVelKeys.times[1]: 0.5 s is not later than 0.5 s before it"),
    ((*WIND, "times"), [0.0], "windVelKeys.values: has 2 items for 1 times"),
    ((*WIND, "times"), MISSING, "windVelKeys: needs times and values, or a file"),
    ((*WIND, "file"), "gusts.csv", "windVelKeys: has both a file and times and values; give one of them"),
    ((*WIND, "fps"), 24, "windVelKeys: fps, scale, up, handedness, mesh, points and joint belong to a file, and "
     "there is none"),
    (("colliders", 0, "posKeys", "times"), [1, 0], "colliders[0].posKeys.times[1]: 0 s is not later than 1 s before"),
    (("objects", 0, "pins", 0, "vertices"), [0, 12], "objects[0].pins[0].vertices[1]: 12 is no vertex; the object has"),
    (("objects", 0, "pins", 0, "vertices"), [0, 10**30], f"objects[0].pins[0].vertices[1]: {10**30} is no vertex"),
    (("objects", 0, "pins", 0, "vertices"), [1], "objects[0].pins[0].vertices[0]: vertex 1 is not fixed (vertIsFixed)"),
    (("objects", 0, "pins", 0, "vertices"), [0, 0], "objects[0].pins[0].vertices[1]: vertex 0 is twice in this pin"),
    (("objects", 0, "pins"), [PIN, PIN], "objects[0].pins[1].vertices[0]: vertex 0 is in pins[0] as well"),
    (POSITION, MISSING, "objects[0].pins[0]: needs posKeys, rotKeys or both"),
    (("objects", 0, "fit"), {"bounds": {"path": [1, 0]}}, "objects[0].fit.bounds.path: the lower bound 1 must be"),
]


@pytest.mark.parametrize(("path", "value", "said"), FAULTS)
def test_faults_are_named_with_their_place(path, value, said):
    found = problems(changed(scene(), path, value))
    assert any(problem.startswith(said) for problem in found), found


def test_only_keys_in_the_scene_can_be_fitted():
    text = json.dumps(scene())
    assert dumps(load_text(text)) == text.encode()
    made = {**scene(), "fit": {"windVelKeys": "L"}}
    assert load(made).blocks[-1].count == 6
    assert problems(changed(made, WIND, {"file": "gusts.csv"})) == [
        "fit.windVelKeys: keys of a file cannot be fitted; write times and values into the scene"
    ]
    assert problems(changed(made, WIND, MISSING)) == ["fit.windVelKeys: there are no windVelKeys to fit"]


@pytest.mark.parametrize("field", ["posKeys", "pinOffset"])
def test_paths_and_offsets_are_those_of_pins(field):
    made = scene()
    made["objects"][0]["fit"] = {field: True if field == "pinOffset" else "L"}
    assert load(made).blocks[-1].count == (3 if field == "pinOffset" else 6)
    of_a_file = changed(made, POSITION, {"file": "path.csv"})
    said = "no pin has posKeys with times and values in the scene; those of a file cannot be fitted"
    if field == "posKeys":
        assert problems(of_a_file) == [f"objects[0].fit.posKeys: {said}"]
    else:
        assert load(of_a_file).blocks[-1].count == 3
    assert problems(changed(made, ("objects", 0, "pins"), [])) == [f"objects[0].fit.{field}: the object has no pins"]


def test_only_the_values_of_fitted_paths_change_in_a_file():
    made = scene()
    made["objects"][0]["fit"] = {"posKeys": "L", "pinOffset": "G"}
    made["objects"][0]["pins"].insert(0, {"vertices": [1], "posKeys": {"file": "path.csv"}})
    made["objects"][0]["vertIsFixed"][1] = True
    text = json.dumps(made)
    loaded = load_text(text)
    p = parameters(loaded)
    assert p.tolist() == [0, 0, 0, 1, 0, 0, 0, 0, 0]
    assert dumps(with_parameters(loaded, p)) == text.encode()
    moved = json.loads(dumps(with_parameters(loaded, p + [0, 0, 0, 0.5, 2, 0, 0, -1, 0])))
    expected = json.loads(text)
    expected["objects"][0]["pins"][1]["posKeys"]["values"][1] = xyz((1.5, 2, 0))
    expected["objects"][0]["pinOffset"] = xyz((0, -1, 0))
    assert moved == expected


def test_of_a_path_the_key_at_time_0_is_not_identifiable():
    made = scene()
    pin = made["objects"][0]["pins"][0]
    pin["posKeys"] = {"times": [-1, 0, 1], "values": [xyz((0, 0, 0))] * 3}
    made["objects"][0]["fit"] = {"posKeys": "L"}
    assert identifiable(load(made)).tolist() == [True] * 3 + [False] * 3 + [True] * 3


def test_files_are_found_where_they_were_when_a_scene_goes_to_another_folder(tmp_path):
    made = scene()
    made["windVelKeys"] = {"file": "gusts.csv", "interpolation": "smooth"}
    made["objects"][0]["pins"] = [{**PIN, "rotKeys": {"file": "../turn.npz"}}]
    made["objects"][0]["fit"] = {"posKeys": "L"}
    made["frame"] = {"posKeys": {"file": "/places/car.csv"}}
    cube = {"type": 4, "pos": xyz((0, 0, 0)), "scale": xyz((1, 1, 1)), "friction": 0.3}
    made["colliders"] += [{**cube, "mesh": "body.obj", "motion": {"file": "body.pc2"}}, {**cube, "mesh": {"file": "b"}}]
    home, away = tmp_path / "home", tmp_path / "a" / "way"
    home.mkdir()
    away.mkdir(parents=True)
    text = json.dumps(made, indent=1)
    (home / "scene.json").write_text(text)
    loaded = load(home / "scene.json")
    save(loaded, home / "other.json")
    assert (home / "other.json").read_text() == text
    save(with_parameters(loaded, parameters(loaded) + [0, 0, 0, 1, 0, 0]), away / "scene.json")
    expected = copy.deepcopy(made)
    expected["windVelKeys"]["file"] = "../../home/gusts.csv"
    expected["objects"][0]["pins"][0]["rotKeys"]["file"] = "../../turn.npz"
    expected["objects"][0]["pins"][0]["posKeys"]["values"][1] = xyz((2, 0, 0))
    expected["colliders"][1] |= {"mesh": "../../home/body.obj", "motion": {"file": "../../home/body.pc2"}}
    expected["colliders"][2]["mesh"]["file"] = "../../home/b"
    assert json.loads((away / "scene.json").read_text()) == expected
    back = load(away / "scene.json")
    assert os.path.realpath(back.wind_keys.file) == str(home.resolve() / "gusts.csv")
    save(loaded, away / "second.json")
    save(load(away / "second.json"), home / "back.json")
    assert (home / "back.json").read_text() == text
