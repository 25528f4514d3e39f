"""The camera and the faces it sees, against closed forms."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from clothfit.pictures import camera
from clothfit.pictures.camera import direction, framed, looking, normals, project, shaped, thinned

ROUNDING = 1e-14  # of a few products of numbers up to 1
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])  # upright, in the plane z = 0
HALVES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


@pytest.mark.parametrize(("yaw", "pitch"), [(0, 0), (30, 24), (-60, 80), (123, -45)])
def test_the_axes_of_a_camera_are_orthonormal(yaw, pitch):
    axes = np.stack(looking(yaw, pitch))
    assert_allclose(axes @ axes.T, np.eye(3), atol=ROUNDING)
    right, _, forward = axes
    assert right[1] == 0.0  # the horizon is level
    assert_allclose(np.cross((0.0, 1.0, 0.0), forward) / np.cos(np.radians(pitch)), right, atol=ROUNDING)


def test_along_z_x_is_to_the_right_and_y_up_as_in_the_editor_and_from_above_what_is_far_is_higher_up():
    assert_allclose(np.stack(looking(0.0, 0.0)), np.eye(3), atol=ROUNDING)
    seen = framed(looking(0.0, 30.0), np.zeros((1, 3)))
    _, up, depth = project(seen, np.array([0.0, 0.0, 2.0]))
    assert_allclose((up, depth), (2 * np.sin(np.radians(30)), 2 * np.cos(np.radians(30))), atol=ROUNDING)


def test_a_parallel_projection_keeps_lengths_across_and_nothing_along():
    seen = framed(looking(40.0, 20.0), np.zeros((1, 3)))
    x = np.random.default_rng(1).standard_normal((20, 3))
    flat = project(seen, x)
    assert_allclose(np.linalg.norm(flat, axis=1), np.linalg.norm(x, axis=1), rtol=1e-14)
    assert_allclose(project(seen, x + 3.0 * seen.forward)[:, :2], flat[:, :2], atol=1e-14)


@pytest.mark.parametrize(("least", "most", "aspect"), [(0.1, 0.5, 0.5), (2.0, 3.0, 2.0), (0.5, 2.0, 1.0)])
def test_all_of_a_motion_is_in_a_picture_whose_shape_is_within_bounds(least, most, aspect):
    x = np.random.default_rng(2).standard_normal((50, 3))
    x[7] = np.nan
    seen = framed(looking(30.0, 24.0), x)
    flat = project(seen, np.delete(x, 7, axis=0))[:, :2]
    assert ((flat > seen.low) & (flat < seen.high)).all()
    seen = framed(looking(0.0, 0.0), SQUARE)  # along +z
    wider = shaped(seen, least, most)
    assert_allclose(wider.aspect, aspect, rtol=1e-14)
    assert ((wider.low <= seen.low) & (wider.high >= seen.high)).all()


def test_a_direction_is_the_first_unless_another_shows_much_more():
    ahead = np.array([SQUARE])
    edge = np.array([SQUARE @ np.array(looking(30.0, 0.0)).T[:, [2, 1, 0]]])
    assert_allclose(direction(np.array([SQUARE[:, [0, 2, 1]]]), HALVES), looking(30.0, 24.0))  # level: all are alike
    for x in (ahead, edge):
        chosen, first = (abs(area(x[0], axes)) for axes in (direction(x, HALVES), looking(30.0, 24.0)))
        assert chosen >= first
    sideways = np.array([SQUARE @ np.stack(looking(-60.0, 0.0))])  # faces a camera of yaw −60
    best, first = (abs(area(sideways[0], axes)) for axes in (direction(sideways, HALVES), looking(30.0, 24.0)))
    assert best > camera.CLEARLY_MORE * first


def area(x, axes):
    """The area that a camera sees."""
    return 0.5 * normals(project(framed(axes, x), x), HALVES)[:, 2].sum()


@pytest.mark.parametrize("turned", [np.eye(3), np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]])])
def test_a_map_is_seen_from_where_it_is_flat(turned):
    x = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0), [0.0]), axis=-1).reshape(-1, 3) @ turned
    flat = project(camera.facing(x), x)
    assert_allclose(flat[:, 2], flat[0, 2], atol=1e-13)
    assert_allclose(np.sort(np.ptp(flat[:, :2], axis=0)), [3, 4], atol=1e-13)


def test_a_small_mesh_stays_whole_and_a_large_one_is_thinned():
    n = 40
    x = np.stack(np.meshgrid(np.linspace(0, 1, n), [0.0], np.linspace(0, 1, n)), axis=-1).reshape(-1, 3)
    quads = [(i, i + 1, i + n + 1, i + n) for j in range(n - 1) for i in range(n * j, n * j + n - 1)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    assert thinned(x, triangles, len(triangles)) is triangles
    few = thinned(x, triangles, 300)
    assert 100 < len(few) <= 300
    size = np.linalg.norm(normals(x, few), axis=1).sum() / 2
    assert_allclose(size, 1.0, atol=0.15)  # the sheet is covered once, but for a rim of one cell of about 1/12
    assert len(np.unique(np.sort(few, axis=1), axis=0)) == len(few)
