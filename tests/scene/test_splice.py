"""New numbers into an old text: the tokens that changed, and not a byte more."""

import json

from hypothesis import given, settings
from hypothesis import strategies as st

from clothfit.scene.splice import splice

TEXT = """
{ "springStiffness": [1, 2], "note": "\\"objects\\": [ { ]}",
  "objects" : [
    {"vertMass":[ 0.10, 1e-1,\t0.019999999552965165 , 3 ],"x":{"vertMass":[9]},"springStiffness":[]},
    {"springStiffness":[5.0,6],"deep":[[[{"a":"]"}]]],"vert\\u004dass" : [7]}
  ],"end":null}
"""
VALUES = [
    {"vertMass": [0.1, 0.1, 0.019999999552965165, 3.0], "springStiffness": []},
    {"vertMass": [7.0], "springStiffness": [5.0, 6.0]},
]


def test_only_the_tokens_that_differ_are_replaced():
    assert splice(TEXT, VALUES) == TEXT
    new = [{"vertMass": [0.1, 0.25, 0.02, 3], "springStiffness": []}, {"vertMass": [1e-7], "springStiffness": [5, 6.5]}]
    expected = TEXT.replace("1e-1", "0.25").replace("0.019999999552965165", "0.02")
    expected = expected.replace('dass" : [7]', 'dass" : [1e-07]').replace("[5.0,6]", "[5.0,6.5]")
    assert splice(TEXT, new) == expected


def test_deep_unknown_fields_need_no_recursion():
    deep = "[" * 100_000 + "]" * 100_000
    text = f'{{"deep":{deep},"objects":[{{"deep":{deep},"vertMass":[1]}}]}}'
    assert splice(text, [{"vertMass": [2.0]}]) == text.replace("[1]", "[2.0]")


finite = st.floats(allow_nan=False, allow_infinity=False)
mass = finite.filter(bool)  # 0.0 and -0.0 are equal, so one is not replaced by the other
anything = st.recursive(
    st.none() | st.booleans() | finite | st.integers() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=5,
)


@st.composite
def documents(draw):
    unknown = st.dictionaries(st.text().filter(lambda key: key not in ("objects", "vertMass")), anything, max_size=3)
    masses = draw(st.lists(st.lists(mass, max_size=6), min_size=1, max_size=3))
    objects = [{**draw(unknown), "vertMass": numbers, **draw(unknown)} for numbers in masses]
    return {**draw(unknown), "objects": objects, **draw(unknown)}


layouts = st.sampled_from([{}, {"indent": 2}, {"separators": (",", ":")}, {"ensure_ascii": False}, {"indent": "\t"}])


@settings(max_examples=30)
@given(documents(), layouts, st.data())
def test_the_spliced_text_is_the_text_of_the_changed_document(document, layout, data):
    text = json.dumps(document, **layout)
    for item in document["objects"]:
        item["vertMass"] = [data.draw(mass | st.just(old)) for old in item["vertMass"]]
    values = [{"vertMass": item["vertMass"]} for item in document["objects"]]
    assert json.loads(splice(text, values)) == document
    assert splice(text, values) == json.dumps(document, **layout)
