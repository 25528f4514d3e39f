"""The structure of a scene: the published schema, its defaults, and our words for what breaks it."""

import json

import jsonschema
import pytest
from helpers.scenes import MISSING, changed, cloth, document, kind, problems, sphere

from clothfit.base.messages import place
from clothfit.scene import array_checks as checks
from clothfit.scene import scene
from clothfit.scene import schema as structure

SCHEMA = json.loads(structure.schema_path().read_text("utf-8"))
JUDGE = jsonschema.Draft202012Validator(SCHEMA)

INF, NAN = float("inf"), float("nan")

# Every rule of the schema, broken at the first place of a scene that has every field.

VECTOR = {"x": 0.0, "y": 1.0, "z": 0.0}
KEYS = {"times": [0.0, 1.0], "values": [VECTOR, VECTOR], "interpolation": "hold"}
FILE = {"file": "a.csv", "fps": 24, "scale": 0.1, "up": "z", "handedness": "right", "points": [0]}
OWN = {
    "vertVel": [VECTOR] * 4, "springRestLength": [1.0] * 5, "families": {"names": ["a"], "springs": [0] * 5},
    "regions": [{"name": "a", "vertices": [0]}], "warp": VECTOR, "pinOffset": VECTOR,
    "pins": [{"vertices": [0], "posKeys": FILE, "rotKeys": KEYS, "pivot": VECTOR}],
    "fit": {"damping": True, "vertVel": "L", "springRestLength": "M", "pinOffset": "G", "bounds": {"mass": [1, None]}},
}  # fmt: skip
COLLIDER = {
    **sphere(), "posKeys": KEYS, "rotKeys": KEYS, "scaleKeys": {**KEYS, "values": [{"x": 1, "y": 1, "z": 1}] * 2},
    "radius": 1.0, "radius2": 1.0, "height": 1.0, "thickness": 0.1, "stiffness": 9.0, "friction": 0.3,
}  # fmt: skip
FULL = json.loads(json.dumps(document(
    cloth(2, 2, **OWN), colliders=[COLLIDER], gravity=VECTOR, colliderOffset=VECTOR, windVelKeys=KEYS, gravityKeys=KEYS,
    frame={"posKeys": KEYS, "rotKeys": KEYS, "pivot": VECTOR}, planes="solid",
    selfCollision={"thickness": 0.1, "stiffness": 9.0, "friction": 0.1},
    fit={"windVel": "G", "windVelKeys": "L", "friction": "G", "colliderOffset": "n", "bounds": {"wind": [None, 2.0]}},
)))  # fmt: skip  # each part apart
LONG = {
    "vertPos", "vertIsFixed", "vertMass", "vertVel", "springs", "springStiffness", "springRestLength", "triangles",
    "families", "regions",
}  # fmt: skip
BEYOND = [(value, "is not a finite number") for value in (NAN, -INF, 10**400)]
WRONG = {  # of each type: values that have another, and what is said of them
    "array": [({}, "an object is not a list"), ("abc", '"abc" is not a list')],
    "boolean": [(0, "0 is not true or false"), ("true", '"true" is not true or false')],
    "integer": [(True, "true is not a whole number"), (2.0, "2.0 is not a whole number"), ("3", '"3" is not a whole')],
    "number": [(True, "true is not a number"), ("1", '"1" is not a number'), ([1], "a list is not"), *BEYOND],
    "object": [(7, "7 is not an object"), (None, "null is not an object"), ([0], "a list is not an object")],
    "string": [(5, "5 is not text"), (None, "null is not text")],
}
EITHER = [(True, "true is not a number or null"), ({}, "an object is not a number or null")]
OF_RULES = {  # values that break a rule
    "enum": lambda _: [(9, "9 is not one of ")],
    "minimum": lambda bound: [(bound - 1, f"is too small; it must be at least {bound}")],
    "exclusiveMinimum": lambda bound: [(bound, f"is too small; it must be above {bound}"), (-0.5, "-0.5 is too small")],
    "maximum": lambda bound: [(bound + 1, f"is too large; it must be at most {bound}")],
    "exclusiveMaximum": lambda bound: [(bound, f"is too large; it must be below {bound}")],
    "minItems": lambda bound: [([], f"is empty; at least {bound} is needed"), *[([1], "has 1 of 2")] * (bound - 1)],
    "maxItems": lambda bound: [([1] * (bound + 1), f"has {bound + 1} items; {bound} are needed")],
    "pattern": lambda _: [("x", '"x" is not two letters of '), ("nx", '"nx" is not two'), ("nn\n", "two letters")],
    "maxLength": lambda _: [("nLG", '"nLG" is not two letters of')],
}


def broken(value, rules, path=()):
    """Of each rule for what is at a path of FULL, and within: the path, values that break it, part of what is said."""
    rules = SCHEMA["$defs"][rules["$ref"].removeprefix("#/$defs/")] if "$ref" in rules else rules
    kind = rules.get("type")
    cases = WRONG[kind] if isinstance(kind, str) else EITHER if kind == ["number", "null"] else []
    if not LONG & {*path} or "pins" in path:  # else the range is that of a kind, or of the other lists
        cases = [*cases, *(case for rule in rules.keys() & OF_RULES for case in OF_RULES[rule](rules[rule]))]
    yield from ((path, wrong, word) for wrong, word in cases if path)
    yield from (((*path, name), MISSING, "is missing, and it has no default") for name in rules.get("required", ()))
    if isinstance(value, dict):
        fields = rules["properties"]
        parts = [(name, fields[name]) for name in value if name in fields]
    else:
        parts = [(0, rules["items"])] if isinstance(value, list) else []
    for step, part in parts:
        yield from broken(value[step], part, (*path, step))


def test_every_broken_rule_gives_one_problem_with_its_place():
    cases = [*broken(FULL, SCHEMA), (("colliders", 0, "scale", "x"), 0, "above 0")]
    assert len(cases) > 700
    for path, value, word in cases:
        found = problems(changed(FULL, path, value))
        assert found[0].startswith(f"{place(path)}: ")
        assert word in found[0]
        assert len(found) == 1 or value in ({}, "abc")  # what other lists must be as long as
    flat = changed(FULL, ("colliders", 0, "scale", "x"), 0)
    assert structure.problems_of(changed(flat, ("colliders", 0, "type"), 0)) == []  # a plane may have any scale


BOUNDS = {
    "delta": {"exclusiveMinimum": 0}, "tolerance": {"exclusiveMinimum": 0, "exclusiveMaximum": 1},
    "optimizationIterations": {"minimum": 2}, "forwardSubSteps": {"minimum": 1}, "objects": {"minItems": 1},
    "integrationMethod": {"enum": [0, 1, 2, 3, 4]},
    "object": {"required": ["vertPos", "vertIsFixed", "vertMass", "springs", "springStiffness"]},
    "dragCoefficient": {"minimum": 0}, "damping": {"minimum": 0}, "optimizationSettings": {"maxLength": 2},
    "collider": {"required": ["type", "pos", "scale"]}, "type": {"enum": [0, 1, 2, 3, 4]},
    "vector": {"required": ["x", "y", "z"]},
}  # fmt: skip


def keywords(rules):
    """The keywords of JSON Schema in a schema and all within it."""
    parts = [*rules.get("properties", {}).values(), *rules.get("$defs", {}).values()]
    parts += [rules[name] for name in ("items", "if", "then", "not", "else") if name in rules]
    parts += [each for name in ("anyOf", "allOf", "oneOf") for each in rules.get(name, ())]
    return set(rules).union(*map(keywords, parts))


def test_the_schema_has_no_keyword_that_nobody_judges():
    ways_on = {"$ref", "properties", "items", "if", "required", "additionalProperties"}
    judged = {"type", "const", *OF_RULES, *structure.BOUNDS}
    assert keywords(SCHEMA) <= ways_on | judged | structure.SAY_NOTHING


def test_the_bounds_are_those_of_the_format():
    assert SCHEMA["required"] == ["integrationMethod", "delta", "objects"]
    defined = SCHEMA["$defs"]
    known = {**defined["collider"]["properties"], **defined["object"]["properties"], **SCHEMA["properties"], **defined}
    assert [name for name, rules in BOUNDS.items() if not rules.items() <= known[name].items()] == []


EMPTY = {name: [] for name in ("vertPos", "vertIsFixed", "vertMass", "springs", "springStiffness")}


@pytest.mark.parametrize(
    ("text", "places"),
    [
        ("{}", ["integrationMethod", "delta", "objects"]),
        *[(text, ["top level"]) for text in ("[]", "1", "null", '"scene"', "true")],
        # all of the structure, and of the values only where that is right
        (changed(document(delta=0, tolerance="tight"), ("objects", 0, "vertMass"), [-1]), ["delta", "tolerance"]),
        (document(EMPTY), ["objects[0].vertPos"]),
        (document(cloth(), cloth(2, 2, vertMass=[1, 1, 1, -1])), ["objects[1].vertMass[3]"]),
        (changed(document(), ("objects", 0, "vertPos", 2), {"x": "a", "z": False}),
         [f"objects[0].vertPos[2].{axis}" for axis in "yxz"]),
    ],
)  # fmt: skip
def test_each_problem_is_listed_with_its_place(text, places):
    assert [found.split(":")[0] for found in problems(text)] == places


def test_the_list_of_problems_and_the_values_in_it_stay_short():
    (found,) = problems(document(title="x", optimizationIterations="9" * 10_000))
    assert len(found) < 150
    assert len(problems(document(*[1] * 10_000))) <= structure.MOST_PROBLEMS


def test_the_published_schema_accepts_a_scene_and_describes_the_long_lists():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["$id"] == "urn:clothfit:scene:1"
    JUDGE.validate(document(cloth(), cloth(2, 2), colliders=[sphere()], fit={"windVel": True}))
    for name, item in {"vertMass": 0, "springStiffness": -1, "springs": -1, "triangles": 0.5, "vertPos": {}}.items():
        assert not JUDGE.is_valid(document(cloth(**{name: [item]})))


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


def test_only_the_required_fields_are_needed_and_the_rest_has_the_defaults_of_the_schema():
    required = SCHEMA["$defs"]["object"]["required"]
    small = {"integrationMethod": 1, "delta": 0.01, "objects": [{name: cloth()[name] for name in required}]}
    made = scene.load(small)
    assert (made.title, made.tolerance, made.frames, made.newton_iterations) == ("", 1e-5, 100, 1)
    assert made.wind.tolist() == [0, 0, 0]
    assert made.spheres == ()
    (only,) = made.cloths
    assert (only.triangles.shape, only.drag, only.damping, only.settings) == ((0, 3), 0, 0, "nn")


# The long arrays of a scene: every kind of wrong value is found and named by its place in the flat list.


N = 12  # vertices of the default cloth
SPRINGS = cloth()["springs"]
S = len(SPRINGS) // 2

# Path of the change inside objects[0], new value, place in the message after objects[0], where it is not that of the
# change, a word of the message.
OF_ARRAYS = [
    (("vertPos", 5, "x"), 10**300, "springs[4]", "vertices 0 and 5 are too far apart"),
    (("vertIsFixed",), [False] * 11, "", "11 values for 12 vertices"),
    (("vertMass", 3), 0, "", "above 0"),
    (("vertMass", 3), -0.5, "", "-0.5 kg must be above 0"),
    (("vertMass",), [], "", "0 values for 12 vertices"),
    (("springs", 3), N, "", "vertex 12 does not exist (the object has 12 vertices)"),
    (("springs", 3), -1, "", "vertex -1 does not exist"),
    (("springs", 3), 10**30, "", "does not exist"),
    (("springs", 3), SPRINGS[2], "springs[2]", "joined to itself"),
    (("vertPos", 1), {"x": 0, "y": 0, "z": 0}, "springs[0]", "vertices 0 and 1 lie at the same place"),
    (("springs",), [*SPRINGS, 0], "", f"{2 * S + 1} indices do not make pairs"),
    (("springs",), SPRINGS[:-2], "springStiffness", f"{S} values for {S - 1} springs"),
    (("springStiffness",), [1.0] * (S + 1), "", f"{S + 1} values for {S} springs"),
    (("springStiffness", 4), -1, "", "-1.0 N/m must be 0 or more"),
    (("triangles", 7), N, "", "vertex 12 does not exist"),
    (("triangles",), [0, 1, 2, 3], "", "4 indices do not make triples"),
]


@pytest.mark.parametrize(("path", "value", "where", "word"), OF_ARRAYS, ids=[kind(*row[:2]) for row in OF_ARRAYS])
def test_one_broken_value_is_named_first(path, value, where, word):
    first = problems(changed(document(), ("objects", 0, *path), value))[0]
    assert first.startswith(f"objects[0].{where or place(path)}: ")
    assert word in first


def test_problems_of_all_arrays_are_collected_a_handful_each():
    bad = cloth(vertMass=[-1.0] * N, springStiffness=[-1.0] * S, triangles=[99] * 6)
    found = problems(document(bad))
    places = [problem.split("[")[1] for problem in found]
    assert len(places) == 3 * checks.HANDFUL
    assert f"(and {N - checks.HANDFUL} more in this list)" in next(p for p in found if ".vertMass[4]" in p)


def test_what_is_odd_but_right_passes():
    twice = cloth(springs=[0, 1, 0, 1], springStiffness=[1.0, 0])
    slivers = cloth(triangles=[0, 0, 1, 0, 1, 2, 0, 1, 2])
    lonely = cloth(springs=[], springStiffness=[])
    together = cloth(vertPos=[{"x": 0, "y": 0, "z": 0}] * N, springs=[], springStiffness=[])
    whole = cloth(vertMass=[2**70] * N, springStiffness=[7] * S)  # integers are numbers
    made = scene.load(document(twice, slivers, lonely, together, whole))
    assert [len(item.springs) for item in made.cloths] == [2, S, 0, 0, S]
    assert (made.cloths[4].mass.tolist(), made.cloths[4].stiffness.tolist()) == ([2.0**70] * N, [7.0] * S)
