"""Modes of the Laplacian of a mesh: cosines on a rectangle, and no mesh that breaks them."""

import numpy as np
import pytest

from clothfit.meshes.mesh import plane
from clothfit.meshes.new_scene import new_scene
from clothfit.scene.smooth_maps import vertex_modes


def cosine(positions, along, across):
    """The mode of a rectangle with so many half waves along x and z, largest absolute value 1."""
    x, _, z = (positions - positions.min(axis=0)).T / np.maximum(np.ptp(positions, axis=0), 1.0e-9)[:, None]
    return np.cos(np.pi * along * x) * np.cos(np.pi * across * z)


def error(divisions, column, along, across):
    mesh = plane(divisions, 1.0, 0.7)
    mode = vertex_modes(new_scene(mesh).cloths[0], 8)[:, column]
    exact = cosine(mesh.positions, along, across)
    return min(np.abs(mode - exact).max(), np.abs(mode + exact).max())


@pytest.mark.parametrize(("column", "along", "across"), [(1, 1, 0), (2, 0, 1), (3, 1, 1), (4, 2, 0)])
def test_on_a_rectangle_the_modes_are_cosines_in_the_order_of_their_frequencies(column, along, across):
    """Frequencies squared of 1 × 0.7: (1, 0) 1, (0, 1) 2.04, (1, 1) 3.04, (2, 0) 4. On a grid the cosines are the exact
    modes of the discrete Laplacian, that of five points, but for the least weight of diagonals, 1e-9.
    """
    assert error(19, column, along, across) < 1e-7


def test_columns_are_scaled_and_signed():
    modes = vertex_modes(new_scene(plane(9, 1.0)).cloths[0], 12)
    assert modes.shape == (121, 12)
    assert (modes[:, 0] == 1.0).all()
    assert np.abs(modes).max(axis=0).tolist() == [1.0] * 12
    assert modes.max(axis=0).tolist() == pytest.approx([1.0] * 12, abs=1e-6)  # the tie that is allowed


def test_equal_frequencies_of_a_square_are_told_apart_along_its_axes():
    mesh = plane(20, 1.0)
    modes = vertex_modes(new_scene(mesh).cloths[0], 3)
    pure = [np.abs(np.corrcoef(modes[:, k], cosine(mesh.positions, *waves))[0, 1]) for k in (1, 2)
            for waves in ((1, 0), (0, 1))]
    assert sorted(pure)[2:] == pytest.approx([1.0, 1.0], abs=1e-7)
