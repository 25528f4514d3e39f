"""What is wrong with a mesh: each problem in the smallest mesh that has it, and none in one that has none."""

import json

import numpy as np
import pytest
import trimesh
from helpers.scenes import changed, trial

from clothfit import InvalidInput, InvalidScene, load, mesh, new_scene
from clothfit.meshes.mesh import Mesh
from clothfit.meshes.problems import problems, together, weld
from clothfit.scene.mesh_numbering import FIELD, mesh_counts, numberings, picks, unwelded

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def made(points, *corners):
    return Mesh(np.array(points, float), np.array(corners, np.int32).reshape(-1, 3))


def solid(shape):
    """The mesh of one of trimesh's."""
    return Mesh(np.array(shape.vertices, float), shape.faces.astype(np.int32))


def torn(case, seed=0):
    """A mesh whose triangles share no vertices, in another order."""
    order = np.random.default_rng(seed).permutation(case.triangles.size)
    corners = np.argsort(order).astype(np.int32).reshape(-1, 3)
    return Mesh(case.positions[case.triangles.reshape(-1)[order]], corners)


CUBE, SHEET = solid(trimesh.creation.box()), mesh.plane(4, 2.0)


def found(case):
    return {problem.kind: problem for problem in problems(case)}


IN_ORDER = [SHEET, mesh.plane(0, 1.0, 3.0), made(SQUARE, (0, 1, 2), (0, 2, 3)), solid(trimesh.creation.icosphere(2))]


@pytest.mark.parametrize("case", IN_ORDER)
def test_a_mesh_in_order_has_no_problems_and_keeps_its_numbers(case):
    assert problems(case) == []
    welded = weld(case)
    np.testing.assert_array_equal(welded.mesh.positions, case.positions)
    np.testing.assert_array_equal(welded.mesh.triangles, case.triangles)
    assert not welded.renumbered


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
    try:
        mesh.object_document(case, np.zeros(len(case.positions), bool), density=1.0, stiffness=1.0)
        built = True
    except InvalidInput:
        built = False
    assert built != any(problem.fatal for problem in problems(case))  # fatal is what the builder refuses


ALONE = mesh.plane(5, 1.0)._replace(positions=np.vstack([mesh.plane(5, 1.0).positions, np.eye(3), 2 * np.eye(3)]))
WORST = made([*SQUARE, (0, 0, 0), (9, 9, 9)], (0, 1, 2), (4, 2, 3))


def test_what_is_fatal_comes_first_and_only_the_first_few_are_named():
    assert [problem.kind for problem in problems(WORST)] == ["unused", "seam"]
    assert "6 vertices are in no triangle (49, 50, 51, 52, 53, …)" in found(ALONE)["unused"].sentence
    point = weld(made([(1, 1, 1)] * 3, (0, 1, 2))).mesh  # that collapses
    assert [(problem.kind, problem.fatal) for problem in problems(point)] == [("empty", True)]


# Welding: what is joined, what is left out, and how motions of the mesh are read afterwards.


def test_a_cube_with_split_corners_gets_its_8_vertices_back_and_is_closed():
    kinds = found(torn(CUBE))
    assert (kinds["parts"].count, kinds["seam"].count) == (12, 28)
    assert not any(problem.fatal for problem in kinds.values())
    welded = weld(torn(CUBE))
    assert welded.mesh.positions.shape == (8, 3)
    assert (welded.joined, welded.triangles, welded.unused, welded.renumbered) == (28, 0, 0, True)
    assert problems(welded.mesh) == []
    closed = trimesh.Trimesh(welded.mesh.positions, welded.mesh.triangles, process=False)
    assert closed.is_watertight
    assert closed.volume == pytest.approx(1.0, rel=1e-12)  # of the unit cube; a few additions


def test_every_vertex_stays_where_it_was_and_springs_of_a_welded_plane_are_those_of_the_plane():
    whole, before = mesh.plane(5, 2.0, 1.0), torn(mesh.plane(5, 2.0, 1.0))
    welded = weld(before)
    np.testing.assert_array_equal(welded.mesh.positions[welded.vertices], before.positions)
    np.testing.assert_array_equal(welded.vertices[before.triangles], welded.mesh.triangles)
    both = [(each, mesh.springs(each, 30.0)) for each in (whole, welded.mesh)]
    ends = [np.sort(np.linalg.norm(m.positions[s.ends].mean(axis=1), axis=1)) for m, s in both]
    np.testing.assert_allclose(*ends, rtol=1e-12)  # the same springs at the same places; means of two numbers
    np.testing.assert_allclose(*(np.sort(made.stiffness) for _, made in both), rtol=1e-12)  # sums in another order


def test_what_no_cloth_can_have_is_left_out():
    sheet = mesh.plane(1, 1.0)
    extra = np.array([[0, 0, 1], [4, 3, 0], [5, 4, 1]], np.int32)  # names one twice; as the first; another
    two_sided = np.concatenate([sheet.triangles, sheet.triangles[:, ::-1], extra[:1]])
    welded = weld(Mesh(np.vstack([sheet.positions, [[9.0, 9, 9]]]), two_sided.astype(np.int32)))
    np.testing.assert_array_equal(welded.mesh.triangles, sheet.triangles)
    assert (welded.triangles, welded.unused, welded.vertices[-1]) == (9, 1, -1)
    assert problems(welded.mesh) == []


def test_a_distance_joins_what_is_that_near():
    sheet = mesh.plane(3, 1.0)
    shaken = torn(sheet)
    noise = np.random.default_rng(1).uniform(-1e-3, 1e-3, shaken.positions.shape)
    shaken = shaken._replace(positions=shaken.positions + noise)
    assert len(weld(shaken).mesh.positions) == len(shaken.positions)
    assert len(weld(shaken, 0.01).mesh.positions) == len(sheet.positions)


# --- the numbers of the mesh in the scene


@pytest.fixture
def welded():
    """A torn plane with two stray vertices, and the scene of it."""
    before = torn(mesh.plane(2, 1.0))
    stray = Mesh(np.vstack([[[7.0, 7, 7]], before.positions, [[8.0, 8, 8]]]), before.triangles + np.int32(1))
    found = weld(stray)
    return stray, found, new_scene(found.mesh, numbering=found.vertices)


def test_positions_of_the_mesh_become_those_of_the_scene_and_back(welded):
    stray, found, scene = welded
    assert mesh_counts(scene) == (len(stray.positions),)
    np.testing.assert_array_equal(stray.positions[picks(scene)], scene.cloths[0].positions)
    moving = np.random.default_rng(2).normal(size=(4, len(found.mesh.positions), 3))
    again = unwelded(scene, moving)
    assert again.shape == (4, len(stray.positions), 3)
    np.testing.assert_array_equal(again[:, picks(scene)], moving)
    np.testing.assert_array_equal(again[:, 0], moving[:, 0])  # the stray ones go with the first


def test_several_objects_are_counted_one_after_another(welded):
    _, found, scene = welded
    document = json.loads(scene.source.text)
    plain = trial("nG", 5)["objects"][0]
    both = load({**document, "objects": [plain, *document["objects"], plain]})
    n, m = len(plain["vertPos"]), len(found.vertices)
    assert mesh_counts(both) == (n, m, n)
    own = np.unique(found.vertices, return_index=True)[1][1:]
    expected = np.concatenate([np.arange(n), n + own, n + m + np.arange(n)])
    np.testing.assert_array_equal(picks(both), expected)
    alone = load(trial("nG", 5))  # without the field
    assert (numberings(alone), picks(alone), mesh_counts(alone)) == ([None], None, (16,))


WRONG = [[0, 1], "all", [*range(15), 16], [*range(16), -2], [*range(15), 15.0], 5, [True] * 16]


@pytest.mark.parametrize("value", WRONG)
def test_a_field_that_cannot_be_is_refused(value):
    scene = load(changed(trial("nG", 5), ("objects", 0, FIELD), value))
    with pytest.raises(InvalidScene, match=r"objects\[0\].meshVertices: must be a list"):
        numberings(scene)


# Edges, parts and places of meshes, against trimesh and the builder of springs.


def test_places_are_one_from_each_to_the_next_unless_that_joins_everything_and_takes_the_memory():
    row = np.array([[0.0, 0, 0], [5, 0, 0], [1, 0, 0], [2, 0, 0], [5.5, 0, 0]])
    assert together(row, 1.0).tolist() == [0, 1, 0, 0, 1]
    assert together(row, 0.9).tolist() == [0, 1, 2, 3, 1]
    assert together(row[[0, 0, 1]], 0.0).tolist() == [0, 0, 2]
    with pytest.raises(InvalidInput, match="too many others"):
        together(np.random.default_rng(0).random((20_000, 3)), 10.0)
