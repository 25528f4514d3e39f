"""The long arrays of a scene: every kind of wrong value is found and named by its place in the flat list."""

import numpy as np
import pytest
from helpers.scenes import MISSING, changed, cloth, document, kind, problems

from clothfit.scene import array_checks as checks
from clothfit.scene import scene

INF = float("inf")
NAN = float("nan")
N = 12  # vertices of the default cloth
SPRINGS = cloth()["springs"]
S = len(SPRINGS) // 2

# Path of the change inside objects[0], new value, place in the message after objects[0], a word of the message.
BROKEN = [
    (("vertPos", 5), 3, ".vertPos[5]", "3 is not a vector"),
    (("vertPos", 5), None, ".vertPos[5]", "null is not a vector"),
    (("vertPos", 5), [0, 0, 0], ".vertPos[5]", "a list is not a vector"),
    (("vertPos", 5, "y"), MISSING, ".vertPos[5].y", "missing"),
    (("vertPos", 5, "y"), "1", ".vertPos[5].y", '"1" is not a number'),
    (("vertPos", 5, "y"), True, ".vertPos[5].y", "true is not a number"),
    (("vertPos", 5, "y"), None, ".vertPos[5].y", "null is not a number"),
    (("vertPos", 5, "z"), NAN, ".vertPos[5].z", "NaN is not a finite number"),
    (("vertPos", 5, "x"), -INF, ".vertPos[5].x", "-Infinity is not a finite number"),
    (("vertPos", 5, "x"), 10**400, ".vertPos[5].x", "finite"),
    (("vertPos", 5, "x"), 10**300, ".springs[4]", "vertices 0 and 5 are too far apart"),
    (("vertIsFixed", 2), 1, ".vertIsFixed[2]", "1 is not true or false"),
    (("vertIsFixed", 2), "true", ".vertIsFixed[2]", '"true" is not true or false'),
    (("vertIsFixed",), [False] * 11, ".vertIsFixed", "11 values for 12 vertices"),
    (("vertMass", 3), True, ".vertMass[3]", "true is not a number"),
    (("vertMass", 3), "1", ".vertMass[3]", '"1" is not a number'),
    (("vertMass", 3), [1], ".vertMass[3]", "a list is not a number"),
    (("vertMass", 3), 0, ".vertMass[3]", "above 0"),
    (("vertMass", 3), -0.5, ".vertMass[3]", "-0.5 kg must be above 0"),
    (("vertMass", 3), NAN, ".vertMass[3]", "finite"),
    (("vertMass", 3), INF, ".vertMass[3]", "finite"),
    (("vertMass", 3), 10**400, ".vertMass[3]", "finite"),
    (("vertMass",), [1.0], ".vertMass", "1 value for 12 vertices"),
    (("vertMass",), [], ".vertMass", "0 values for 12 vertices"),
    (("springs", 3), N, ".springs[3]", "vertex 12 does not exist (the object has 12 vertices)"),
    (("springs", 3), -1, ".springs[3]", "vertex -1 does not exist"),
    (("springs", 3), 10**30, ".springs[3]", "does not exist"),
    (("springs", 3), 3.0, ".springs[3]", "3.0 is not an index"),
    (("springs", 3), True, ".springs[3]", "true is not an index"),
    (("springs", 3), "3", ".springs[3]", '"3" is not an index'),
    (("springs", 3), SPRINGS[2], ".springs[2]", "joined to itself"),
    (("vertPos", 1), {"x": 0, "y": 0, "z": 0}, ".springs[0]", "vertices 0 and 1 lie at the same place"),
    (("springs",), [*SPRINGS, 0], ".springs", f"{2 * S + 1} indices do not make pairs"),
    (("springs",), SPRINGS[:-2], ".springStiffness", f"{S} values for {S - 1} springs"),
    (("springStiffness",), [1.0] * (S + 1), ".springStiffness", f"{S + 1} values for {S} springs"),
    (("springStiffness", 4), -1, ".springStiffness[4]", "-1.0 N/m must be 0 or more"),
    (("springStiffness", 4), None, ".springStiffness[4]", "null is not a number"),
    (("springStiffness", 4), INF, ".springStiffness[4]", "finite"),
    (("triangles", 7), N, ".triangles[7]", "vertex 12 does not exist"),
    (("triangles", 7), -2, ".triangles[7]", "vertex -2 does not exist"),
    (("triangles", 7), 0.5, ".triangles[7]", "0.5 is not an index"),
    (("triangles",), [0, 1, 2, 3], ".triangles", "4 indices do not make triples"),
]


@pytest.mark.parametrize(("path", "value", "place", "word"), BROKEN, ids=[kind(*row[:2]) for row in BROKEN])
def test_one_broken_value_is_named_first(path, value, place, word):
    found = problems(changed(document(), ("objects", 0, *path), value))
    assert found[0].startswith(f"objects[0]{place}: ")
    assert word in found[0]


def test_an_object_needs_vertices():
    empty = {name: [] for name in ("vertPos", "vertIsFixed", "vertMass", "springs", "springStiffness")}
    assert problems(document(empty)) == ["objects[0].vertPos: is empty; an object needs at least one vertex"]


def test_the_second_object_is_named_by_its_index():
    found = problems(document(cloth(), cloth(2, 2, vertMass=[1, 1, 1, -1])))
    assert found == ["objects[1].vertMass[3]: the mass -1.0 kg must be above 0"]


def test_problems_of_all_arrays_are_collected_a_handful_each():
    bad = cloth(vertMass=[-1.0] * N, springStiffness=[-1.0] * S, triangles=[99] * 6)
    found = problems(document(bad))
    places = [problem.split("[")[1] for problem in found]
    assert len(places) == 3 * checks.HANDFUL
    assert f"(and {N - checks.HANDFUL} more in this list)" in next(p for p in found if ".vertMass[4]" in p)


def test_a_vector_tells_each_wrong_component():
    found = problems(changed(document(), ("objects", 0, "vertPos", 2), {"x": "a", "z": False}))
    assert [problem.split(":")[0] for problem in found] == [f"objects[0].vertPos[2].{axis}" for axis in "xyz"]


def test_what_is_odd_but_right_passes():
    twice = cloth(springs=[0, 1, 0, 1], springStiffness=[1.0, 0])
    slivers = cloth(triangles=[0, 0, 1, 0, 1, 2, 0, 1, 2])
    lonely = cloth(springs=[], springStiffness=[])
    together = cloth(vertPos=[{"x": 0, "y": 0, "z": 0}] * N, springs=[], springStiffness=[])
    made = scene.load(document(twice, slivers, lonely, together))
    assert [len(item.springs) for item in made.cloths] == [2, S, 0, 0]


def test_integers_and_large_integers_are_numbers():
    made = scene.load(document(cloth(vertMass=[2**70] * N, springStiffness=[7] * S)))
    assert made.cloths[0].mass.tolist() == [2.0**70] * N
    assert made.cloths[0].stiffness.tolist() == [7.0] * S


def test_new_values_are_copied_and_checked():
    found: list[str] = []
    given = np.ones(3)
    made = checks.new_values(given, 3, "here", found)
    given[:] = 5
    assert made is not None
    assert made.tolist() == [1, 1, 1]
    wrong = ([1, 2], [[1, 2, 3]], ["a", "b", "c"], [1j, 1, 1], [[1], [1, 2]], None, [1, 2, NAN])
    assert [checks.new_values(values, 3, "here", found) for values in wrong] == [None] * len(wrong)
    assert len(found) == len(wrong)
