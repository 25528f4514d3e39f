"""The quick look at a scene's structure: when it says yes, so does a validator of JSON Schema."""

import json

import jsonschema
import pytest
from helpers.scenes import cloth, document, sphere
from hypothesis import given
from hypothesis import strategies as st

from clothfit.scene import schema as structure
from clothfit.scene.schema import conforms

SCHEMA = json.loads(structure.schema_path().read_text("utf-8"))
JUDGE = jsonschema.Draft202012Validator(SCHEMA)

values = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 3), st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from(["", "nG", "nGL", "G", "x"]), st.lists(st.integers(0, 2), max_size=2),
    st.dictionaries(st.sampled_from(["x", "y", "z", "type"]), st.integers(-1, 1), max_size=4),
)  # fmt: skip
names = st.sampled_from(
    [*SCHEMA["properties"], *(("objects", 0, name) for name in SCHEMA["$defs"]["object"]["properties"]),
     *(("colliders", 0, name) for name in SCHEMA["$defs"]["collider"]["properties"]), ("fit", "windVel")]
)  # fmt: skip


@given(st.lists(st.tuples(names, values), max_size=3))
def test_what_conforms_is_valid(changes):
    scene = document(cloth(2, 2), colliders=[sphere()], fit={})
    for path, value in changes:
        owner, (*steps, last) = scene, (path if isinstance(path, tuple) else (path,))
        for step in steps:
            held = dict(enumerate(owner)) if isinstance(owner, list) else owner
            owner = held.get(step, {}) if isinstance(held, dict) else {}
        if isinstance(owner, dict):
            owner[last] = value
    assert not conforms(scene, SCHEMA, SCHEMA) or JUDGE.is_valid(scene)


def test_a_scene_as_it_comes_conforms():
    assert conforms(document(cloth(), cloth(2, 2), colliders=[sphere()], fit={"windVel": True}), SCHEMA, SCHEMA)


@pytest.mark.parametrize(
    ("value", "schema"),
    [(1.0, {"enum": [1]}), (True, {"enum": [1]}), (1, {"enum": [True]}), (1, {"const": 1}), (1, {"type": "boolean"})],
)
def test_in_doubt_it_says_no(value, schema):
    assert not conforms(value, schema, schema)
