"""The structure of a scene: the published schema, its defaults, and our words for what breaks it."""

import json

import jsonschema
import pytest
from helpers.scenes import MISSING, changed, cloth, document, kind, problems, sphere

from clothfit.scene import scene
from clothfit.scene import schema as structure

SCHEMA = json.loads(structure.schema_path().read_text("utf-8"))

INF = float("inf")
WITH_SPHERE = document(colliders=[sphere()])

# Path of the change, new value, place in the message, a word of the message.
BROKEN = [
    (("integrationMethod",), MISSING, "integrationMethod", "missing"),
    (("delta",), MISSING, "delta", "missing"),
    (("objects",), MISSING, "objects", "missing"),
    (("objects", 0, "vertPos"), MISSING, "objects[0].vertPos", "missing"),
    (("objects", 0, "vertIsFixed"), MISSING, "objects[0].vertIsFixed", "missing"),
    (("objects", 0, "vertMass"), MISSING, "objects[0].vertMass", "missing"),
    (("objects", 0, "springs"), MISSING, "objects[0].springs", "missing"),
    (("objects", 0, "springStiffness"), MISSING, "objects[0].springStiffness", "missing"),
    (("colliders", 0, "type"), MISSING, "colliders[0].type", "missing"),
    (("colliders", 0, "pos"), MISSING, "colliders[0].pos", "missing"),
    (("colliders", 0, "scale"), MISSING, "colliders[0].scale", "missing"),
    (("colliders", 0, "pos", "y"), MISSING, "colliders[0].pos.y", "missing"),
    (("windVel", "z"), MISSING, "windVel.z", "missing"),
    (("title",), 5, "title", "5 is not text"),
    (("title",), None, "title", "null is not text"),
    (("delta",), True, "delta", "true is not a number"),
    (("delta",), "0.02", "delta", '"0.02" is not a number'),
    (("delta",), 0, "delta", "above 0"),
    (("delta",), -0.02, "delta", "-0.02 is too small"),
    (("delta",), float("nan"), "delta", "NaN is not a finite number"),
    (("delta",), INF, "delta", "Infinity is not a finite number"),
    (("delta",), 10**400, "delta", "finite"),
    (("tolerance",), 0, "tolerance", "above 0"),
    (("tolerance",), 1, "tolerance", "below 1"),
    (("integrationMethod",), 4, "integrationMethod", "4 is not one of 0, 1, 2, 3"),
    (("integrationMethod",), True, "integrationMethod", "true is not a whole number"),
    (("integrationMethod",), 2.0, "integrationMethod", "2.0 is not a whole number"),
    (("optimizationIterations",), 1, "optimizationIterations", "at least 2"),
    (("optimizationIterations",), 99.5, "optimizationIterations", "99.5 is not a whole number"),
    (("forwardSubSteps",), 0, "forwardSubSteps", "at least 1"),
    (("printTimes",), 0, "printTimes", "0 is not true or false"),
    (("windVel",), [0, 0, 0], "windVel", "a list is not an object"),
    (("windVel", "x"), "strong", "windVel.x", '"strong" is not a number'),
    (("windVel", "x"), INF, "windVel.x", "finite"),
    (("objects",), {}, "objects", "an object is not a list"),
    (("objects",), [], "objects", "empty"),
    (("objects", 0), 7, "objects[0]", "7 is not an object"),
    (("objects", 0, "vertMass"), 0.1, "objects[0].vertMass", "0.1 is not a list"),
    (("objects", 0, "springs"), {}, "objects[0].springs", "an object is not a list"),
    (("objects", 0, "triangles"), "abc", "objects[0].triangles", '"abc" is not a list'),
    (("objects", 0, "dragCoefficient"), -0.1, "objects[0].dragCoefficient", "at least 0"),
    (("objects", 0, "damping"), -1, "objects[0].damping", "at least 0"),
    (("objects", 0, "damping"), INF, "objects[0].damping", "finite"),
    (("objects", 0, "optimizationSettings"), "x", "objects[0].optimizationSettings", "two letters"),
    (("objects", 0, "optimizationSettings"), "nLG", "objects[0].optimizationSettings", "two letters"),
    (("objects", 0, "optimizationSettings"), "nx", "objects[0].optimizationSettings", '"nx"'),
    (("objects", 0, "optimizationSettings"), "nn\n", "objects[0].optimizationSettings", "two letters"),
    (("objects", 0, "optimizationSettings"), 3, "objects[0].optimizationSettings", "3 is not text"),
    (("colliders",), 1, "colliders", "1 is not a list"),
    (("colliders", 0, "type"), 5, "colliders[0].type", "5 is not one of 0, 1, 2, 3, 4"),
    (("colliders", 0, "pos"), None, "colliders[0].pos", "null is not an object"),
    (("colliders", 0, "scale", "x"), 0, "colliders[0].scale.x", "above 0"),
    (("colliders", 0, "scale", "x"), -1, "colliders[0].scale.x", "above 0"),
    (("colliders", 0, "rot", "y"), "up", "colliders[0].rot.y", "number"),
]


@pytest.mark.parametrize(("path", "value", "place", "word"), BROKEN, ids=[kind(*row[:2]) for row in BROKEN])
def test_one_broken_field_gives_one_problem_with_its_place(path, value, place, word):
    found = problems(changed(WITH_SPHERE, path, value))
    assert len(found) == 1
    assert found[0].startswith(f"{place}: ")
    assert word in found[0]


@pytest.mark.parametrize("text", ["[]", "1", "null", '"scene"', "true"])
def test_the_top_level_must_be_an_object(text):
    (found,) = problems(text)
    assert found.startswith("top level: ")
    assert found.endswith("is not an object")


def test_all_problems_of_the_structure_are_collected_and_only_these():
    broken = changed(document(delta=0, tolerance="tight"), ("objects", 0, "vertMass"), [-1])
    assert [found.split(":")[0] for found in problems(broken)] == ["delta", "tolerance"]


def test_missing_fields_are_each_named():
    assert [found.split(":")[0] for found in problems("{}")] == ["integrationMethod", "delta", "objects"]


def test_the_list_of_problems_and_the_values_in_it_stay_short():
    (found,) = problems(document(title="x", optimizationIterations="9" * 10_000))
    assert len(found) < 150
    assert len(problems(document(*[1] * 10_000))) <= structure.MOST_PROBLEMS


def test_a_deep_value_in_place_of_a_scalar_is_refused():
    assert len(problems(document(title=json.loads("[" * 500 + "]" * 500)))) == 1


def test_planes_may_have_any_scale():
    flat = changed(WITH_SPHERE, ("colliders", 0, "scale", "x"), 0)
    assert structure.problems_of(changed(flat, ("colliders", 0, "type"), 0)) == []


def test_the_schema_is_a_schema_and_names_no_address():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["$id"] == "urn:clothfit:scene:1"


def test_the_published_schema_accepts_a_scene_and_describes_the_long_lists():
    validator = jsonschema.Draft202012Validator(SCHEMA)
    validator.validate(document(cloth(), cloth(2, 2), colliders=[sphere()]))
    for name, item in {"vertMass": 0, "springStiffness": -1, "springs": -1, "triangles": 0.5, "vertPos": {}}.items():
        assert not validator.is_valid(document(cloth(**{name: [item]})))


def test_every_field_of_the_schema_has_a_description_with_a_unit():
    bounds = {"bounds": SCHEMA["$defs"]["bounds"]}
    fields = [SCHEMA["properties"], bounds, *(part.get("properties", {}) for part in SCHEMA["$defs"].values())]
    described = {name: field["description"] for group in fields for name, field in group.items()}
    assert {"delta", "vertPos", "springStiffness", "scale", "x"} <= set(described)
    containers = {"objects", "colliders"}
    units = ("unit", " m", " s", " kg", " N/m", " degrees")
    assert [
        name for name, text in described.items() if name not in containers and not any(u in text for u in units)
    ] == []


def test_the_long_lists_are_lists_of_the_schema():
    assert set(structure.LONG_ARRAYS) <= set(SCHEMA["$defs"]["object"]["properties"])


def test_only_the_required_fields_are_needed_and_the_rest_has_the_defaults_of_the_schema():
    required = SCHEMA["$defs"]["object"]["required"]
    small = {"integrationMethod": 1, "delta": 0.01, "objects": [{name: cloth()[name] for name in required}]}
    made = scene.load(small)
    assert (made.title, made.tolerance, made.frames, made.newton_iterations) == ("", 1e-5, 100, 1)
    assert made.wind.tolist() == [0, 0, 0]
    assert made.spheres == ()
    (only,) = made.cloths
    assert (only.triangles.shape, only.drag, only.damping, only.settings) == ((0, 3), 0, 0, "nn")
