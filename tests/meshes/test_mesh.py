"""The builder of meshes and objects, against the editor's own export and closed forms."""

import io
import json

import numpy as np
import pytest
from helpers.paths import SIDE
from helpers.scenes import document

import clothfit
from clothfit import InvalidInput
from clothfit.meshes import mesh
from clothfit.meshes.mesh import Mesh

FLOAT32 = 2e-6  # the editor computes in float32: a few roundings of 6e-8, times areas and squared lengths


def triangles(*corners):
    return np.array(corners, np.int32).reshape(-1, 3)


def strip(count, seed=1):
    """A strip of `count` triangles with random corners."""
    rng = np.random.default_rng(seed)
    return Mesh(rng.normal(size=(count + 2, 3)), triangles(*((i, i + 1, i + 2) for i in range(count))))


@pytest.fixture(scope="module")
def export():
    """The first object of a real export, and this package's object from the numbers in its description."""
    if not SIDE.is_file():
        pytest.skip("the real export ../shared/scenes/side.txt is not here")
    theirs = json.loads(SIDE.read_text("utf-8-sig"))["objects"][0]
    square = mesh.plane(10, 7.0)
    fixed = square.positions[:, 2] == 3.5
    ours = mesh.object_document(
        square, fixed, density=0.1, stiffness=50.0, damping=0.1, drag=0.1, settings=theirs["optimizationSettings"]
    )
    return theirs, ours


@pytest.mark.parametrize("field", ["springs", "triangles", "vertIsFixed", "optimizationSettings"])
def test_an_object_is_the_front_ends_to_the_last_index(export, field):
    theirs, ours = export
    assert ours[field] == theirs[field]


@pytest.mark.parametrize("field", ["vertMass", "springStiffness", "dragCoefficient", "damping"])
def test_an_object_is_the_front_ends_to_single_precision(export, field):
    theirs, ours = export
    assert ours[field] == pytest.approx(theirs[field], rel=FLOAT32, abs=0)


def test_the_vertices_are_the_front_ends(export):
    theirs, ours = export
    both = [[[v["x"], v["y"], v["z"]] for v in item["vertPos"]] for item in (ours, theirs)]
    np.testing.assert_allclose(*both, rtol=0, atol=7.0 * FLOAT32)


def test_the_fields_have_the_front_ends_order(export):
    theirs, ours = export
    assert list(ours) == list(theirs)


def test_a_plane_has_two_vertices_more_than_divisions_along_its_longer_side():
    square, wide = mesh.plane(10, 7.0), mesh.plane(10, 7.0, 3.5)
    assert square.positions.shape == (144, 3)
    assert len(square.triangles) == 2 * 11 * 11
    assert len(np.unique(wide.positions[:, 0])) == 12
    assert len(np.unique(wide.positions[:, 2])) == 7  # 5.5 cells of the same size, rounded to even


def test_a_plane_without_divisions_is_two_triangles():
    least = mesh.plane(0, 2.0)
    assert least.triangles.tolist() == [[0, 2, 3], [0, 3, 1]]
    assert least.positions.tolist() == [[-1, 0, -1], [1, 0, -1], [-1, 0, 1], [1, 0, 1]]


@pytest.mark.parametrize("size", [(7.0, 3.0), (3.0, 7.0), (7.0, 0.1)])
def test_vertices_are_numbered_along_x_first_and_cells_have_their_four_corners(size):
    sheet = mesh.plane(6, *size)
    columns = len(np.unique(sheet.positions[:, 0]))
    x, z = sheet.positions.reshape(-1, columns, 3)[..., [0, 2]].transpose(2, 0, 1)
    assert (np.diff(x, axis=1) > 0).all()
    assert (np.diff(x, axis=0) == 0).all()
    assert (np.diff(z, axis=0) > 0).all()
    assert np.ptp(x) == pytest.approx(size[0])
    assert np.ptp(z) == pytest.approx(size[1])
    a, b, c, d = sheet.triangles[0].tolist() + sheet.triangles[1].tolist()[2:]
    assert (a, b, c, d) == (0, columns, columns + 1, 1)
    assert sorted({int(v) for v in sheet.triangles.flat}) == list(range(len(sheet.positions)))


def test_an_upright_plane_is_the_level_one_turned_about_x():
    level, upright = mesh.plane(4, 3.0, 2.0), mesh.plane(4, 3.0, 2.0, upright=True)
    np.testing.assert_array_equal(upright.positions, level.positions[:, [0, 2, 1]])
    np.testing.assert_array_equal(upright.triangles, level.triangles)


@pytest.mark.parametrize("size", [(-1, 1.0, 1.0), (4, 0.0, 1.0), (4, 1.0, -1.0), (4, float("nan"), 1.0)])
def test_a_plane_of_nothing_is_refused(size):
    with pytest.raises(InvalidInput, match="nothing can be made of that"):
        mesh.plane(*size)


def test_the_areas_of_a_plane_add_up_to_its_own():
    assert mesh.areas(mesh.plane(5, 3.0, 2.0)).sum() == pytest.approx(6.0, rel=1e-14)


def test_the_masses_of_any_mesh_add_up_to_density_times_area():
    sheet = strip(20)
    assert mesh.masses(sheet, 0.3).sum() == pytest.approx(0.3 * mesh.areas(sheet).sum(), rel=1e-14)


def test_a_triangle_shares_its_mass_evenly():
    one = Mesh(np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0]]), triangles((0, 1, 2)))
    assert mesh.masses(one, 0.5).tolist() == pytest.approx([1.0, 1.0, 1.0], rel=1e-15)


def test_edges_are_listed_once_in_the_order_of_meeting_with_the_smaller_end_first():
    assert mesh.edges(triangles((5, 2, 7), (7, 2, 1))).tolist() == [[2, 5], [5, 7], [2, 7], [1, 7], [1, 2]]


@pytest.mark.parametrize("divisions", [0, 1, 10])
def test_a_plane_obeys_eulers_formula(divisions):
    sheet = mesh.plane(divisions, 1.0)
    assert len(sheet.positions) - len(mesh.edges(sheet.triangles)) + len(sheet.triangles) == 1


def test_every_side_of_a_triangle_gives_one_spring():
    sheet = mesh.plane(10, 7.0)
    made = mesh.springs(sheet, 50.0)
    assert len(made.ends) == 3 * len(sheet.triangles) == 726
    np.testing.assert_array_equal(made.ends[~made.bends], mesh.edges(sheet.triangles))
    assert made.bends.sum() == 726 - len(mesh.edges(sheet.triangles))


def test_the_stiffnesses_of_two_unequal_triangles():
    # Areas 1 and 3 m² at the common edge 0-1 of length 2 m; the vertices opposite it are 4 m apart.
    two = Mesh(np.array([[-1.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -3, 0]]), triangles((0, 1, 2), (1, 0, 3)))
    made = mesh.springs(two, 8.0)
    assert made.ends.tolist() == [[0, 1], [0, 2], [1, 2], [2, 3], [1, 3], [0, 3]]
    assert made.bends.tolist() == [False, False, False, True, False, False]
    # 8 (1 + 3)/4, 8·1/2 twice, (8/4)·2·3/16 with the area of the second triangle, 8·3/10 twice
    assert made.stiffness.tolist() == pytest.approx([8.0, 4.0, 4.0, 0.75, 2.4, 2.4], rel=1e-14)


def test_without_bending_only_edges_get_springs():
    sheet = mesh.plane(3, 1.0)
    made, all_springs = mesh.springs(sheet, 50.0, bending=False), mesh.springs(sheet, 50.0)
    np.testing.assert_array_equal(made.ends, mesh.edges(sheet.triangles))
    np.testing.assert_array_equal(made.stiffness, all_springs.stiffness[~all_springs.bends])


def test_springs_do_not_depend_on_place_turn_or_scale():
    sheet = strip(30)
    turn, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    moved = sheet._replace(positions=3.0 * sheet.positions @ turn + [4.0, -5.0, 6.0])
    # Area and squared length scale alike; 1e-9 covers the thinnest of the random triangles.
    np.testing.assert_allclose(mesh.springs(moved, 1.0).stiffness, mesh.springs(sheet, 1.0).stiffness, rtol=1e-9)


def test_air_pushes_a_face_as_in_the_world():
    # ½ · 1.2 kg/m³ · 2 m² · (5 m/s)² = 30 N, all corners together: drag · A · (2 A)² · v
    one = Mesh(np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]]), triangles((0, 1, 2)))
    made = mesh.object_document(one, [False] * 3, density=1.0, stiffness=1.0, drag=mesh.air_drag(one, 5.0))
    scene = clothfit.load(document(made, windVel={"x": 0.0, "y": 0.0, "z": 5.0}, integrationMethod=0, delta=0.5))
    moved = clothfit.simulate(scene, 3).positions[2, :, 2]  # the second step moves by h · h f/m, h = 0.5 s
    np.testing.assert_allclose(moved, 0.25 * 30.0 / 2.0, rtol=1e-12)  # of 2 kg


def test_a_mesh_without_triangles_has_no_springs():
    made = mesh.springs(Mesh(np.zeros((0, 3)), triangles()), 1.0)
    assert made.ends.shape == (0, 2)
    assert made.stiffness.shape == (0,)


def test_an_edge_of_three_triangles_is_refused():
    with pytest.raises(InvalidInput, match="3 triangles share the edge between vertices 0 and 1; at most 2 can"):
        mesh.sides(triangles((0, 1, 2), (1, 0, 3), (0, 1, 4)))


def test_a_spring_of_no_length_is_refused():
    folded = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]]), triangles((0, 1, 2), (1, 0, 3)))
    with pytest.raises(InvalidInput, match="vertices 2 and 3 need a spring but are at the same place"):
        mesh.springs(folded, 1.0)


def test_a_vertex_in_no_triangle_is_refused():
    sheet = mesh.plane(1, 1.0)
    alone = sheet._replace(positions=np.vstack([sheet.positions, [9.0, 9.0, 9.0]]))
    with pytest.raises(InvalidInput, match="vertex 9 has no mass"):
        mesh.masses(alone, 0.1)


def test_a_mask_of_another_length_is_refused():
    with pytest.raises(InvalidInput, match="fixed: 8 values for 9 vertices"):
        mesh.object_document(mesh.plane(1, 1.0), [True] * 8, density=0.1, stiffness=50.0)


def test_an_object_makes_a_valid_scene():
    sheet = mesh.plane(3, 2.0)
    fixed = sheet.positions[:, 0] < -0.9
    made = mesh.object_document(sheet, fixed, density=0.2, stiffness=30.0, damping=0.4, drag=0.5, settings="GL")
    cloth = clothfit.load(io.StringIO(json.dumps(document(made)))).cloths[0]
    np.testing.assert_array_equal(cloth.positions, sheet.positions)
    np.testing.assert_array_equal(cloth.fixed, fixed)
    np.testing.assert_array_equal(cloth.mass, mesh.masses(sheet, 0.2))
    np.testing.assert_array_equal(cloth.springs, mesh.springs(sheet, 30.0).ends)
    np.testing.assert_array_equal(cloth.stiffness, mesh.springs(sheet, 30.0).stiffness)
    np.testing.assert_array_equal(cloth.triangles, sheet.triangles)
    assert (cloth.drag, cloth.damping, cloth.settings) == (0.5, 0.4, "GL")


@pytest.mark.parametrize("size", [(1e308, 1e308), (1e200, 1.0), (np.inf, 1.0)])
def test_a_plane_too_long_for_numbers_is_refused(size):
    with pytest.raises(InvalidInput, match="nothing can be made of that"):
        mesh.plane(10, *size)
