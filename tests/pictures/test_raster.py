"""Pictures pixel by pixel: what is near hides what is far, and the light follows the normal."""

import numpy as np
import pytest
from helpers.scenes import document, sphere

from clothfit.kernels.raster import fill, fill_sphere, lit
from clothfit.pictures.palette import GROUND
from clothfit.pictures.polygons import stage
from clothfit.pictures.raster import BEHIND, drawn, vertex_normals
from clothfit.scene.scene import load

AWAY = np.array([0.0, 0.0, -1.0])  # a light from the camera


def sheet(depths, towards, colour=(1.0, 0.5, 0.25), size=8):
    """A square of two triangles over the whole picture, with depths (4,) and normals (4, 3) of its corners."""
    corners = np.array([[0.0, 0.0], [size, 0.0], [size, size], [0.0, size]])
    places = np.column_stack([corners, depths])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return places, np.asarray(towards, float), triangles, np.array([colour, colour], float)


def blank(size=8):
    return np.ones((size, size, 3)), np.full((size, size), BEHIND)


def test_a_face_to_the_light_is_as_bright_as_its_normal_says():
    front = sheet(np.full(4, 2.0), [[0.0, 0.0, -1.0]] * 4)
    back = (front[0], -front[1], front[2][:, ::-1].copy(), front[3])  # the same face, turned round
    for one, share in ((front, 1.0), (back, 0.8)):
        image, depth = blank()
        fill(*one, AWAY, 0.8, image, depth)
        assert (depth == 2.0).all()
        assert np.ptp(image, axis=(0, 1)).max() < 1e-12
        assert image[4, 4].tolist() == pytest.approx([lit(colour, share) for colour in (1.0, 0.5, 0.25)])


def test_the_nearest_surface_is_seen_whatever_the_order():
    near, far = (sheet(np.full(4, z), [[0.0, 0.0, -1.0]] * 4, colour) for z, colour in
                 ((1.0, (1.0, 0.0, 0.0)), (2.0, (0.0, 0.0, 1.0))))  # fmt: skip
    pictures = []
    for order in ((near, far), (far, near)):
        image, depth = blank()
        for one in order:
            fill(*one, AWAY, 1.0, image, depth)
        pictures.append(image)
    assert np.array_equal(*pictures)
    assert (pictures[0][:, :, 0] > pictures[0][:, :, 2]).all()


def test_light_changes_smoothly_over_a_face():
    slanted = np.array([[-0.8, 0.0, -0.6], [0.8, 0.0, -0.6], [0.8, 0.0, -0.6], [-0.8, 0.0, -0.6]])
    image, depth = blank(64)
    fill(*sheet(np.ones(4), slanted, size=64), np.array([0.6, 0.0, -0.8]), 1.0, image, depth)
    row = image[20, :, 2]
    assert np.ptp(row) > 0.2
    assert np.abs(np.diff(row)).max() < 0.1 * np.ptp(row)


def test_a_corner_that_is_not_finite_hides_its_faces_only():
    places, towards, triangles, colours = sheet(np.ones(4), [[0.0, 0.0, -1.0]] * 4)
    places[1] = np.nan
    image, depth = blank()
    fill(places, towards, triangles, colours, AWAY, 1.0, image, depth)
    assert 0.3 < (depth < BEHIND).mean() < 0.7  # one of two


def test_a_sphere_is_as_near_as_its_surface():
    image, depth = blank(65)
    fill_sphere(np.array([32.5, 32.5, 10.0]), 2.0, 10.0, np.ones(3), AWAY, image, depth)
    v, u = np.mgrid[0:65, 0:65] + 0.5
    away = np.hypot(u - 32.5, v - 32.5) / 10.0  # m
    inside = away < 1.999
    assert (depth[away > 2.001] == BEHIND).all()
    assert depth[inside] == pytest.approx(10.0 - np.sqrt(4.0 - away[inside] ** 2), rel=1e-12)


def test_normals_of_a_saddle_of_faces_are_weighted_by_area():
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 3.0]])
    found = vertex_normals(x, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    assert found[0] == pytest.approx(np.array([3.0, 0.0, 1.0]) / np.sqrt(10.0))


def test_a_sphere_hides_the_cloth_behind_it_and_the_target_lies_over_the_cloth():
    scene = load(document(colliders=[sphere(0.5)]))
    x = scene.cloths[0].positions
    on = stage(scene, [x[None]], 100)
    alone, covered = drawn(on, 0, x, None, 100), drawn(on, 0, x, x, 100)
    ground = [int(GROUND[at : at + 2], 16) for at in (1, 3, 5)]
    cloth = alone[:, :, 2].astype(int) > alone[:, :, 0].astype(int) + 30
    assert cloth.mean() > 0.05
    green, before = (each[:, :, 1].astype(int) - each[:, :, 0].astype(int) for each in (covered, alone))
    greener = green > before
    assert greener[cloth].mean() > 0.95
    assert (alone == ground).all(axis=2).any()
