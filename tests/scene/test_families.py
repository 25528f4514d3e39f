"""Which springs share a parameter in mode R: families by the directions of a grid, none on irregular meshes."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from clothfit.meshes.mesh import Mesh, plane, springs
from clothfit.meshes.new_scene import new_scene
from clothfit.scene.families import FAMILIES, families_of, spring_groups, vertex_groups

ALL = (
    "edges along", "edges across", "edges diagonal", "bending along", "bending across", "bending diagonal",
)  # fmt: skip


def counts(mesh):
    groups = spring_groups(new_scene(mesh).cloths[0])
    return dict(zip(groups.names, np.bincount(groups.of).tolist(), strict=True))


def of_plane(columns, rows):
    """The families of a plane of so many cells, counted by hand."""
    return {
        "edges along": columns * (rows + 1), "edges across": rows * (columns + 1), "edges diagonal": columns * rows,
        "bending along": rows * (columns - 1), "bending across": columns * (rows - 1),
        "bending diagonal": columns * rows,
    }  # fmt: skip


def rolled(mesh, radius, axis):
    """A plane in x and z, rolled isometrically about x (axis 0) or z (axis 2)."""
    x, _, z = mesh.positions.T
    along, around = (x, z) if axis == 0 else (z, x)
    turned = radius * np.sin(around / radius), radius * np.cos(around / radius)
    rows = (along, turned[1], turned[0]) if axis == 0 else (turned[0], turned[1], along)
    return Mesh(np.stack(rows, axis=1), mesh.triangles)


@pytest.mark.parametrize(
    ("divisions", "width", "height"), [(10, 1.0, 1.0), (10, 3.0, 1.0), (7, 1.0, 2.5), (0, 1.0, 1.0)]
)
def test_a_plane_has_its_directions(divisions, width, height):
    mesh = plane(divisions, width, height)
    columns = int((np.abs(mesh.positions[:, 2] - mesh.positions[0, 2]) < 1e-9).sum())
    rows = len(mesh.positions) // columns
    found = counts(mesh)
    assert found == {name: count for name, count in of_plane(columns - 1, rows - 1).items() if count}


def test_cells_need_not_be_squares():
    mesh = plane(8, 1.0)
    stretched = Mesh(mesh.positions * [1.0, 1.0, 4.0], mesh.triangles)
    assert counts(stretched) == counts(mesh)


@pytest.mark.parametrize("seed", range(3))
def test_a_turned_plane_of_single_precision_has_the_same_families(seed):
    mesh = plane(9, 2.0, 1.2)
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    turned = Mesh((mesh.positions @ q).astype(np.float32).astype(float), mesh.triangles)
    assert sorted(counts(turned).values()) == sorted(counts(mesh).values())
    assert set(counts(turned)) == set(ALL)


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("radius", [0.2, 0.5])
def test_a_rolled_plane_has_the_families_of_the_flat_one(axis, radius):
    mesh = plane(10, 1.0)
    assert sorted(counts(rolled(mesh, radius, axis)).values()) == sorted(counts(mesh).values())


def test_other_numbers_of_vertices_and_triangles_change_nothing():
    mesh = plane(6, 1.0, 0.7)
    rng = np.random.default_rng(1)
    order = rng.permutation(len(mesh.positions))
    triangles = np.argsort(order)[mesh.triangles][rng.permutation(len(mesh.triangles))]
    spun = np.stack([np.roll(row, k) for row, k in zip(triangles, rng.integers(0, 3, len(triangles)), strict=True)])
    assert counts(Mesh(mesh.positions[order], spun.astype(np.int32))) == counts(mesh)


@pytest.mark.parametrize("count", [30, 100, 1000])
@pytest.mark.parametrize("seed", range(5))
def test_an_irregular_mesh_has_no_directions(count, seed):
    points = np.random.default_rng(seed).random((count, 2))
    triangles = Delaunay(points).simplices.astype(np.int32)
    assert set(counts(Mesh(np.column_stack([points, np.zeros(count)]), triangles))) == {"edges", "bending"}


def test_a_cube_has_no_directions():
    """Three cells meet at each corner, so their directions contradict each other."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
    assert set(counts(Mesh(corners, np.array(triangles, np.int32)))) == {"edges", "bending"}


def test_the_bending_springs_are_named_by_the_direction_in_which_they_bend():
    """A bending spring over an edge across the cloth bends it along: its ends are two columns apart."""
    mesh = plane(5, 1.0)
    groups = spring_groups(new_scene(mesh).cloths[0])
    ends = springs(mesh, 1.0).ends
    columns, rows = np.abs(ends[:, 0] % 7 - ends[:, 1] % 7), np.abs(ends[:, 0] // 7 - ends[:, 1] // 7)
    names = np.array(groups.names)[groups.of]
    assert set(columns[names == "bending along"].tolist()) == {2}
    assert set(rows[names == "bending across"].tolist()) == {2}
    assert set(rows[names == "edges along"].tolist()) == {0}


def test_all_vertices_are_one_group():
    groups = vertex_groups(new_scene(plane(3, 1.0)).cloths[0])
    assert groups.names == ("all",)
    assert groups.of.tolist() == [0] * 25


def test_flexion_springs_over_two_cells_in_a_row_bend():
    """Springs from each vertex to the second next one in its row or column, as many simulators have them."""
    mesh = plane(4, 1.0)
    index = np.arange(36).reshape(6, 6)
    rows = [index[:, :-2], index[:, 2:]], [index[:-2], index[2:]]
    pairs = np.concatenate([np.stack([a.reshape(-1), b.reshape(-1)], axis=1) for a, b in rows]).astype(np.int32)
    family = families_of(mesh.positions, mesh.triangles, pairs)
    assert [FAMILIES[k] for k in family] == ["bending along"] * 24 + ["bending across"] * 24


def test_springs_beside_the_mesh_are_others():
    mesh = plane(2, 1.0)
    far = np.array([[0, 15], [0, 14], [3, 12]], np.int32)
    assert [FAMILIES[k] for k in families_of(mesh.positions, mesh.triangles, far)] == ["other"] * 3
    assert [FAMILIES[k] for k in families_of(mesh.positions, mesh.triangles[:0], far)] == ["other"] * 3
    assert len(families_of(mesh.positions, mesh.triangles, far[:0])) == 0


def test_cells_that_are_cut_crosswise_have_the_directions_of_their_triangles():
    """A vertex in the middle of each cell: the half diagonals are the sides of right-angled cells."""
    n = 5
    x, z = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0))
    cx, cz = np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5)
    points = np.column_stack([np.append(x, cx), np.zeros((n + 1) ** 2 + n * n), np.append(z, cz)])
    corner = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (part.reshape(-1) for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    m = (n + 1) ** 2 + np.arange(n * n)
    triangles = np.concatenate([np.stack(each, axis=1) for each in ((a, b, m), (b, c, m), (c, d, m), (d, a, m))])
    found = counts(Mesh(points, triangles.astype(np.int32)))
    assert {name: found[name] for name in ("edges along", "edges across", "edges diagonal")} == {
        "edges along": 2 * n * n, "edges across": 2 * n * n, "edges diagonal": 2 * n * (n + 1)
    }  # fmt: skip


@pytest.mark.parametrize(
    "triangles", [[(0, 1, 2)], [(0, 0, 0)], [(0, 1, 2), (0, 1, 2)], [(0, 1, 2), (0, 1, 3), (0, 1, 4)]]
)
def test_strange_triangles_have_families(triangles):
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 0, 0), (0, 1, 0), (0, 0, 1)], float)
    pairs = np.array([(0, 1), (1, 2), (3, 4), (2, 3)], np.int32)
    assert len(families_of(points, np.array(triangles, np.int32), pairs)) == 4
