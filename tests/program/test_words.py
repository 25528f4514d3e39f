"""Names are words of the field: private ones that may not come back as names in the package or as those of modules."""

import io
import re
import tokenize

import pytest
from helpers.paths import ROOT

PRIVATE = {
    "astray": "may_be_local", "carrier": "translation", "climb": "refine", "course": "motion", "creep": "stiction",
    "crowd": "instances", "crowded": "instances", "dear": "expensive", "foreseen": "predicted",
    "foretold": "predicted", "knock": "probe", "ladder": "hierarchy", "likeness": "alignment", "looser": "loose",
    "mistaken": "mislabelled", "polls": "poll steps", "pupil": "training", "pupils": "trainings", "rung": "level",
    "rungs": "levels", "settle": "converge", "settled": "stationary", "somebody": "its name", "spot": "contact point",
    "spots": "contact points", "story": "memory", "stray": "margin", "strays": "exceeds", "tally": "running cost",
    "teach": "train", "worth": "break_even",
}  # fmt: skip
"""What may be no part of a name, and the word of the field for it."""

PUBLIC = {"ladder": {"cli/parts/estimate_results", "fit/estimate", "fit/result"}, "rungs": {
    "fit/routes", "optimise/checkpoint", "optimise/search"}}  # fmt: skip
"""Where one of them is a key of a file, or of what commands print, and a field that bears its name."""

NAME = re.compile(r"[A-Za-z_]+")
CAPITAL = re.compile(r"(?<=[a-z])(?=[A-Z])")


def private_in(names):
    """The private words that names have as parts."""
    parts = (CAPITAL.sub("_", name).lower().split("_") for name in names)
    return {part for each in parts for part in each} & PRIVATE.keys()


def private(module, source):
    """The private words of a module's own name and of the names in its source."""
    found = private_in([module.rpartition("/")[2]])
    if private_in(set(NAME.findall(source))):  # maybe in texts and comments: only these are read token by token
        words = tokenize.generate_tokens(io.StringIO(source).readline)
        found |= private_in({word.string for word in words if word.type == tokenize.NAME})
    return {word for word in found if module not in PUBLIC.get(word, ())}


def test_no_name_in_the_package_is_a_private_word():
    package = ROOT / "clothfit"
    modules = {path.relative_to(package).with_suffix("").as_posix(): path for path in package.rglob("*.py")}
    found = {module: private(module, path.read_text("utf-8")) for module, path in modules.items()}
    assert {module: words for module, words in found.items() if words} == {}


@pytest.mark.parametrize(
    ("module", "source", "words"),
    [
        ("engine/spot", "", {"spot"}),
        ("fit/a", "class SolvedLooser(Exception):\n    pass\n", {"looser"}),
        ("fit/a", "def f(x):\n    return x.is_settled\n", {"settled"}),
        ("fit/a", "LOOKS = 1\nFEWEST_RUNGS = 3\n", {"rungs"}),
        ("fit/a", 'def course_of(x):\n    """A story of polls."""\n    return x  # settled\n', {"course"}),
        ("fit/a", "def f():\n    return 'a ladder'\n", set()),
        ("fit/result", "ladder = []\n", set()),
        ("fit/a", "of_course = underworth = 1\n", {"course"}),
    ],
)
def test_private_words_are_found_in_names_and_not_in_texts(module, source, words):
    assert private(module, source) == words
