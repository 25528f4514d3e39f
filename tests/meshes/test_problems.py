"""What is wrong with a mesh: each problem in the smallest mesh that has it, and none in one that has none."""

import numpy as np
import pytest
import trimesh

from clothfit import InvalidInput
from clothfit.meshes import mesh
from clothfit.meshes.mesh import Mesh
from clothfit.meshes.problems import problems
from clothfit.meshes.weld import weld

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def made(points, *corners):
    return Mesh(np.array(points, float), np.array(corners, np.int32).reshape(-1, 3))


def split(solid):
    """The mesh of a solid whose triangles share no vertices."""
    corners = np.arange(solid.faces.size, dtype=np.int32).reshape(-1, 3)
    return Mesh(np.array(solid.vertices[solid.faces.reshape(-1)]), corners)


def found(case):
    return {problem.kind: problem for problem in problems(case)}


@pytest.mark.parametrize("case", [mesh.plane(4, 2.0), mesh.plane(0, 1.0, 3.0), made(SQUARE, (0, 1, 2), (0, 2, 3))])
def test_a_mesh_in_order_has_no_problems(case):
    assert problems(case) == []


def test_a_closed_solid_has_none_either():
    solid = trimesh.creation.icosphere(2)
    assert problems(Mesh(np.array(solid.vertices), solid.faces.astype(np.int32))) == []


CASES = {
    "unused": (made([*SQUARE, (9, 9, 9), (8, 8, 8)], (0, 1, 2), (0, 2, 3)), 2, (4, 5), True, True),
    "collapsed": (made(SQUARE, (0, 1, 2), (0, 2, 3), (1, 2, 2)), 1, (2,), True, True),
    "repeated": (made(SQUARE, (0, 1, 2), (0, 2, 3), (3, 2, 0)), 1, (2,), True, True),
    "non-manifold": (made([*SQUARE, (0, 0, 1)], (0, 1, 2), (0, 2, 3), (0, 2, 4)), 1, (0,), True, False),
    # 4 is where 3 is: the vertices opposite the edge 0-1, which need a spring
    "no-length": (made([*SQUARE, (0, 1, 0)], (0, 1, 3), (1, 0, 4)), 1, (3,), True, True),
    # 4 lies on the side 0-1 of a triangle, beyond which it has another one of some area
    "flat": (made([*SQUARE, (0.5, 0, 0)], (0, 4, 1), (0, 1, 2), (0, 2, 3), (4, 3, 0)), 1, (0,), False, False),
    "massless": (made([*SQUARE, (0.5, 0, 0)], (0, 1, 2), (0, 2, 3), (0, 4, 1)), 1, (4,), True, False),
    "orientation": (made(SQUARE, (0, 1, 2), (0, 3, 2)), 1, (0,), False, False),
    "parts": (made([*SQUARE, *(SQUARE[:3] + 5)], (0, 1, 2), (0, 2, 3), (4, 5, 6)), 2, (0, 4), False, False),
    "seam": (made([*SQUARE, *SQUARE[[0, 2]]], (0, 1, 2), (4, 5, 3)), 2, (4, 5), False, True),
}


@pytest.mark.parametrize("kind", CASES)
def test_each_problem_is_found_counted_and_named(kind):
    case, count, first, fatal, weldable = CASES[kind]
    problem = found(case)[kind]
    assert (problem.count, problem.first, problem.fatal, problem.weldable) == (count, first, fatal, weldable)
    assert ("--weld" in problem.sentence) == weldable


def test_a_mesh_that_collapses_when_it_is_welded_is_none():
    point = weld(made([(1, 1, 1)] * 3, (0, 1, 2))).mesh
    (problem,) = problems(point)
    assert (problem.kind, problem.fatal) == ("empty", True)


def builds(case):
    """Whether the editor's objects can be made of a mesh."""
    try:
        mesh.object_document(case, np.zeros(len(case.positions), bool), density=1.0, stiffness=1.0)
    except InvalidInput:
        return False
    return True


@pytest.mark.parametrize("kind", CASES)
def test_fatal_is_what_the_builder_refuses(kind):
    case = CASES[kind][0]
    assert builds(case) != any(problem.fatal for problem in problems(case))


def test_what_makes_a_scene_impossible_comes_first():
    worst = made([*SQUARE, (0, 0, 0), (9, 9, 9)], (0, 1, 2), (4, 2, 3))
    assert [problem.kind for problem in problems(worst)] == ["unused", "seam"]


def test_only_the_first_few_are_named():
    sheet = mesh.plane(5, 1.0)
    alone = sheet._replace(positions=np.vstack([sheet.positions, np.arange(30.0).reshape(10, 3)]))
    assert "10 vertices are in no triangle (49, 50, 51, 52, 53, …)" in found(alone)["unused"].sentence


def test_a_torn_cube_is_12_parts_and_28_vertices_too_many():
    kinds = found(split(trimesh.creation.box()))
    assert (kinds["parts"].count, kinds["seam"].count) == (12, 28)
    assert not any(problem.fatal for problem in kinds.values())
