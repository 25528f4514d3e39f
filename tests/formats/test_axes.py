"""Axes of other tools: closed forms, handedness, round trip."""

import numpy as np
import pytest

from clothfit.formats.axes import HANDS, SCENE, UPS, Axes, facing, from_scene, to_scene

ALL = [Axes(up, hand, scale) for up in UPS for hand in HANDS for scale in (1.0, 0.01)]


def test_the_scenes_own_axes_change_nothing():
    points = np.random.default_rng(0).normal(size=(4, 5, 3))
    assert (to_scene(points, SCENE) == points).all()


@pytest.mark.parametrize("axes", ALL)
def test_there_and_back(axes):
    points = np.random.default_rng(0).normal(size=(4, 5, 3))
    np.testing.assert_allclose(from_scene(to_scene(points, axes), axes), points, rtol=4e-16)  # two roundings


@pytest.mark.parametrize("axes", ALL)
def test_up_is_up(axes):
    up = np.eye(3)[1 if axes.up == "y" else 2]
    np.testing.assert_array_equal(to_scene(up, axes), [0, axes.scale, 0])


@pytest.mark.parametrize("axes", ALL)
def test_only_right_handed_axes_are_mirrored(axes):
    image = to_scene(np.eye(3), axes) / axes.scale
    assert np.linalg.det(image) == pytest.approx(-1 if axes.handedness == "right" else 1)


# The front is where the cross product of two sides, taken by its formula, points: in either handedness.
@pytest.mark.parametrize("axes", ALL)
def test_the_front_of_a_triangle_stays_the_front(axes):
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 1]])
    (a, b, c), image = facing(np.array([[0, 1, 2]]), axes)[0], to_scene(corners, axes)
    front = to_scene(np.cross(corners[1] - corners[0], corners[2] - corners[0]), axes)
    turned = np.cross(image[b] - image[a], image[c] - image[a])
    assert np.dot(front, turned) > 0
