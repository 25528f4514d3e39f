"""Modes of the Laplacian of a mesh: cosines on a rectangle, and no mesh that breaks them."""


import numpy as np
import pytest
from helpers.scenes import document
from scipy.spatial import Delaunay

from clothfit import load
from clothfit.meshes.mesh import plane
from clothfit.meshes.new_scene import new_scene
from clothfit.scene import smooth_maps
from clothfit.scene.smooth_maps import vertex_modes


def cosine(positions, along, across):
    """The mode of a rectangle with so many half waves along x and z, largest absolute value 1."""
    x, _, z = (positions - positions.min(axis=0)).T / np.maximum(np.ptp(positions, axis=0), 1.0e-9)[:, None]
    return np.cos(np.pi * along * x) * np.cos(np.pi * across * z)


def test_on_a_rectangle_the_modes_are_cosines_in_the_order_of_their_frequencies():
    """Frequencies squared of 1 × 0.7: (1, 0) 1, (0, 1) 2.04, (1, 1) 3.04, (2, 0) 4. On a grid the cosines are the exact
    modes of the discrete Laplacian, that of five points, but for the least weight of diagonals, 1e-9.
    """
    mesh = plane(19, 1.0, 0.7)
    modes = vertex_modes(new_scene(mesh).cloths[0], 8).T
    for mode, waves in zip(modes[1:], ((1, 0), (0, 1), (1, 1), (2, 0)), strict=False):
        exact = cosine(mesh.positions, *waves)
        assert min(np.abs(mode - exact).max(), np.abs(mode + exact).max()) < 1e-7


def test_equal_frequencies_of_a_square_are_told_apart_along_its_axes():
    mesh = plane(20, 1.0)
    modes = checked(vertex_modes(new_scene(mesh).cloths[0], 12), 484, 12)
    assert modes.max(axis=0).tolist() == pytest.approx([1.0] * 12, abs=1e-6)  # the tie that is allowed
    pure = [np.abs(np.corrcoef(modes[:, k], cosine(mesh.positions, *waves))[0, 1]) for k in (1, 2)
            for waves in ((1, 0), (0, 1))]
    assert sorted(pure)[2:] == pytest.approx([1.0, 1.0], abs=1e-7)


def object_of(positions, triangles, springs=()):
    own = {
        "vertPos": [dict(zip("xyz", row, strict=True)) for row in np.asarray(positions, float).tolist()],
        "vertIsFixed": [False] * len(positions), "vertMass": [1.0] * len(positions),
        "springs": np.asarray(springs, int).reshape(-1).tolist(), "springStiffness": [1.0] * len(springs),
        "triangles": np.asarray(triangles, int).reshape(-1).tolist(),
    }  # fmt: skip
    return load(document(own)).cloths[0]


def checked(modes, n, count):
    """The rules that every result keeps."""
    assert modes.shape[0] == n
    assert modes.shape[1] <= count
    assert (modes[:, 0] == 1.0).all()
    assert np.abs(modes).max(axis=0).tolist() == [1.0] * modes.shape[1]
    assert np.linalg.matrix_rank(modes) == modes.shape[1]
    return modes


def test_pieces_have_a_level_each_and_modes_of_their_own():
    one = plane(3, 1.0)
    points = np.concatenate([one.positions, plane(2, 0.3).positions + [5, 0, 0]])
    triangles = np.concatenate([one.triangles, plane(2, 0.3).triangles + 25])
    modes = checked(vertex_modes(object_of(points, triangles), 10), 41, 10)
    assert modes[:, 1].tolist() == [0.0] * 25 + [1.0] * 16
    inside = np.abs(modes[:25]).max(axis=0) > 0, np.abs(modes[25:]).max(axis=0) > 0
    assert (inside[0] ^ inside[1])[1:].all()
    alone = checked(vertex_modes(object_of([*one.positions, (9, 9, 9)], one.triangles), 6), 26, 6)
    assert alone[25].tolist() == [1.0] + [0.0] * 5  # a vertex that nothing joins is in the first mode only


def test_a_chain_without_triangles_has_cosines():
    """Bars of equal length; a vertex at an end has half a bar, so the sampled cosines are the exact modes."""
    x = np.linspace(0, 1, 31)
    own = object_of(np.column_stack([x, 0 * x, 0 * x]), [], [(i, i + 1) for i in range(30)])
    modes = checked(vertex_modes(own, 4), 31, 4)
    assert np.abs(modes - np.cos(np.pi * np.arange(4) * x[:, None])).max() < 1e-9


def test_springs_join_pieces_of_a_mesh():
    one = plane(3, 1.0)
    points = np.concatenate([one.positions, one.positions + [1.2, 0, 0]])
    triangles = np.concatenate([one.triangles, one.triangles + 25])
    seam = [(5 * j + 4, 25 + 5 * j) for j in range(5)]
    modes = checked(vertex_modes(object_of(points, triangles, seam), 3), 50, 3)
    assert np.corrcoef(modes[:, 1], points[:, 0])[0, 1] ** 2 > 0.9  # the longest wave runs along both


def test_degenerate_triangles_do_no_harm():
    """Some without area, some very obtuse, one with a corner named twice."""
    one = plane(6, 1.0)
    points = one.positions.copy()
    points[10] = points[11]
    points[30] = 0.5 * (points[29] + points[31])
    points[50] += [0.12, 0.0, 0.0]
    triangles = np.concatenate([one.triangles, [(0, 0, 1)]])
    checked(vertex_modes(object_of(points, triangles), 12), 64, 12)


@pytest.mark.parametrize("count", [1, 2, 3, 10])
def test_few_vertices_have_few_modes(count):
    modes = checked(vertex_modes(object_of([(0, 0, 0), (1, 0, 0), (0, 0, 1)], [(0, 1, 2)]), count), 3, count)
    assert modes.shape[1] == min(count, 3)


def test_the_result_is_the_same_again_and_on_either_path_of_solution(monkeypatch):
    """A plane beyond the dense limit, against the dense eigenvectors of the same Laplacian."""
    own = new_scene(plane(19, 1.0, 0.7)).cloths[0]
    sparse, again = vertex_modes(own, 8), vertex_modes(own, 8)
    assert np.array_equal(sparse, again)
    monkeypatch.setattr(smooth_maps, "DENSE", len(own.positions))
    dense = vertex_modes(own, 8)
    assert np.abs(sparse - dense).max() < 1e-8  # of the eigensolvers


def test_an_irregular_mesh_has_the_modes_of_its_rectangle():
    rng = np.random.default_rng(2)
    side = np.linspace(0, 1, 20)
    border = [(x, z) for x in side for z in (0, 0.7)] + [(x, z) for x in (0, 1) for z in 0.7 * side[1:-1]]
    flat = np.concatenate([border, rng.random((500, 2)) * [0.98, 0.68] + 0.01])
    points = np.column_stack([flat[:, 0], 0 * flat[:, 0], flat[:, 1]])
    modes = checked(vertex_modes(object_of(points, Delaunay(flat).simplices), 4), len(flat), 4)
    waves = [cosine(points, *each) for each in ((1, 0), (0, 1), (1, 1))]
    match = [abs(np.corrcoef(mode, wave)[0, 1]) for mode, wave in zip(modes.T[1:], waves, strict=True)]
    assert min(match) > 0.99  # an edge is about a twentieth of a wave
