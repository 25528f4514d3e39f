"""Welding: what is joined, what is left out, and how motions of the mesh are read afterwards."""

import json

import numpy as np
import pytest
import trimesh
from helpers.scenes import changed, trial

from clothfit import InvalidScene, load
from clothfit.meshes import mesh
from clothfit.meshes.mesh import Mesh
from clothfit.meshes.new_scene import new_scene
from clothfit.meshes.problems import problems
from clothfit.meshes.weld import weld
from clothfit.scene.mesh_numbering import FIELD, mesh_counts, numberings, picks, unwelded


def torn(case, seed=0):
    """A mesh whose triangles share no vertices, in another order."""
    order = np.random.default_rng(seed).permutation(case.triangles.size)
    corners = np.argsort(order).astype(np.int32).reshape(-1, 3)
    return Mesh(case.positions[case.triangles.reshape(-1)[order]], corners)


def cube():
    solid = trimesh.creation.box()
    return Mesh(np.array(solid.vertices, float), solid.faces.astype(np.int32))


def test_a_cube_with_split_corners_gets_its_8_vertices_back_and_is_closed():
    welded = weld(torn(cube()))
    assert welded.mesh.positions.shape == (8, 3)
    assert (welded.joined, welded.triangles, welded.unused, welded.renumbered) == (28, 0, 0, True)
    assert problems(welded.mesh) == []
    solid = trimesh.Trimesh(welded.mesh.positions, welded.mesh.triangles, process=False)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(1.0, rel=1e-12)  # of the unit cube; a few additions


def test_every_vertex_of_the_mesh_stays_where_it_was():
    before = torn(mesh.plane(5, 2.0, 1.0))
    welded = weld(before)
    np.testing.assert_array_equal(welded.mesh.positions[welded.vertices], before.positions)
    np.testing.assert_array_equal(welded.vertices[before.triangles], welded.mesh.triangles)


def test_springs_of_a_welded_plane_are_those_of_the_plane():
    whole, again = mesh.plane(5, 2.0), weld(torn(mesh.plane(5, 2.0))).mesh
    a, b = mesh.springs(whole, 30.0), mesh.springs(again, 30.0)
    ends = [np.sort(np.linalg.norm(m.positions[s.ends].mean(axis=1), axis=1)) for m, s in ((whole, a), (again, b))]
    np.testing.assert_allclose(*ends, rtol=1e-12)  # the same springs at the same places; means of two numbers
    np.testing.assert_allclose(np.sort(a.stiffness), np.sort(b.stiffness), rtol=1e-12)  # sums in another order


def test_a_mesh_without_seams_keeps_its_numbers():
    sheet = mesh.plane(4, 1.0)
    welded = weld(sheet)
    np.testing.assert_array_equal(welded.mesh.positions, sheet.positions)
    np.testing.assert_array_equal(welded.mesh.triangles, sheet.triangles)
    assert not welded.renumbered


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


def test_a_scene_without_the_field_has_its_own_numbers():
    scene = load(trial("nG", 5))
    assert numberings(scene) == [None]
    assert picks(scene) is None
    assert mesh_counts(scene) == (16,)


WRONG = [[0, 1], "all", [*range(15), 16], [*range(16), -2], [*range(15), 15.0], 5, [True] * 16]


@pytest.mark.parametrize("value", WRONG)
def test_a_field_that_cannot_be_is_refused(value):
    scene = load(changed(trial("nG", 5), ("objects", 0, FIELD), value))
    with pytest.raises(InvalidScene, match=r"objects\[0\].meshVertices: must be a list"):
        numberings(scene)
