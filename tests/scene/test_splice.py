"""New numbers into an old text: the tokens that changed, and not a byte more."""

import json
from random import Random

import pytest

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


NUMBERS = (0.0, -0.0, 5e-324, -1e-7, 0.1, 1e16, -1.7976931348623157e308, 2**53 + 1, -(10**40), 3)
SIGNS = '"\\/[]{},: \t\n\0ae1-é\u2028\U0001f600'


def number(chance):
    return chance.choice([*NUMBERS, chance.gauss(), chance.gauss() * 10.0 ** chance.randint(-300, 300)])


def text_of(chance):
    return "".join(chance.choices(SIGNS, k=chance.randint(0, 6))) or chance.choice(["", "masses", "vertMas", "null"])


def anything(chance, depth=3):
    """A value, as odd as any; with `depth` lists and objects within each other."""
    kind = chance.randrange(6 if depth else 4)
    if kind < 4:
        return (None, chance.random() < 0.5, number(chance), text_of(chance))[kind]
    inner = [anything(chance, depth - 1) for _ in range(chance.randint(0, 4))]
    return inner if kind == 4 else {text_of(chance): each for each in inner}


def document(chance):
    """A scene with masses, which are not 0, as 0.0 and −0.0 are equal, and other fields before and behind them."""
    more = lambda: {text_of(chance): anything(chance) for _ in range(chance.randint(0, 3))}  # noqa: E731
    objects = [{**more(), "vertMass": [number(chance) or 1.0 for _ in range(chance.randint(0, 6))], **more()}
               for _ in range(chance.randint(1, 3))]  # fmt: skip
    return {**more(), "objects": objects, **more()}


@pytest.mark.parametrize("layout", [
    {}, {"indent": 2}, {"separators": (",", ":")}, {"ensure_ascii": False}, {"indent": "\t"},
])  # fmt: skip
def test_the_spliced_text_is_the_text_of_the_changed_document(layout):
    for seed in range(40):
        chance = Random(seed)
        own = document(chance)
        text = json.dumps(own, **layout)
        for item in own["objects"]:
            item["vertMass"] = [chance.choice([old, number(chance) or 1.0]) for old in item["vertMass"]]
        values = [{"vertMass": item["vertMass"]} for item in own["objects"]]
        assert json.loads(splice(text, values)) == own
        assert splice(text, values) == json.dumps(own, **layout)
