"""Which vertices of a new cloth are held."""

import numpy as np
import pytest

from clothfit import InvalidInput
from clothfit.meshes import mesh
from clothfit.meshes.new_scene import SIDES, at_side, in_box, listed

SHEET = mesh.plane(2, 3.0).positions  # 4 x 4 vertices, 1 m apart, from -1.5 to 1.5 in x and z


def chosen(flags):
    return np.flatnonzero(flags).tolist()


def test_a_box_holds_what_is_inside_and_on_its_surface():
    assert chosen(in_box(SHEET, (-1.5, -1, -1.5), (-0.5, 1, 0))) == [0, 1, 4, 5]
    assert chosen(in_box(SHEET, (-1.4, -1, -1.5), (-0.6, 1, 0))) == []
    assert chosen(in_box(SHEET, (-1.5, 0, -1.5), (-1.5, 0, -1.5))) == [0]


def test_the_corners_of_a_box_come_in_any_order():
    a, b = np.array([-1.5, -1, 0.5]), np.array([0.5, 1, -1.5])
    np.testing.assert_array_equal(in_box(SHEET, a, b), in_box(SHEET, np.minimum(a, b), np.maximum(a, b)))


@pytest.mark.parametrize(
    ("side", "expected"),
    [("left", [0, 4, 8, 12]), ("right", [3, 7, 11, 15]), ("back", [0, 1, 2, 3]), ("front", [12, 13, 14, 15])],
)
def test_sides_of_a_level_plane(side, expected):
    assert chosen(at_side(SHEET, side)) == expected


@pytest.mark.parametrize(("side", "expected"), [("top", [12, 13, 14, 15]), ("bottom", [0, 1, 2, 3])])
def test_sides_of_an_upright_plane(side, expected):
    assert chosen(at_side(mesh.plane(2, 3.0, upright=True).positions, side)) == expected


def test_a_reach_takes_more_rows():
    assert at_side(SHEET, "left", 0.99).sum() == 4
    assert at_side(SHEET, "left", 1.0).sum() == 8
    assert at_side(SHEET, "left", 9.0).all()


def test_opposite_sides_are_mirror_images():
    points = np.random.default_rng(0).normal(size=(50, 3))
    for side, other in (("left", "right"), ("bottom", "top"), ("back", "front")):
        np.testing.assert_array_equal(at_side(points, side, 0.5), at_side(-points, other, 0.5))


@pytest.mark.parametrize(("side", "reach"), [("inside", None), ("top", None), ("left", -1.0), ("left", np.nan)])
def test_a_side_that_cannot_be_is_refused(side, reach):
    with pytest.raises(InvalidInput, match=r"^fix side: "):
        at_side(SHEET, side, reach)


def test_ranges_include_both_ends():
    assert chosen(listed(16, [(0, 0), (11, 11), (3, 5), (4, 6)])) == [0, 3, 4, 5, 6, 11]
    assert chosen(listed(16, [])) == []


@pytest.mark.parametrize("ranges", [[(16, 16)], [(3, 2)], [(0, 99)], [(-1, 2)]])
def test_a_vertex_that_is_not_there_is_refused(ranges):
    with pytest.raises(InvalidInput, match="the mesh has vertices 0 to 15"):
        listed(16, ranges)


def test_every_side_has_an_opposite():
    assert {(axis, -sign) for axis, sign in SIDES.values()} == set(SIDES.values())
