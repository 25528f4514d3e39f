"""What is painted of a moment of a scene."""

import numpy as np
import pytest
from helpers.scenes import cloth, document, sphere
from numpy.testing import assert_allclose, assert_array_equal

from clothfit.pictures.camera import project
from clothfit.pictures.palette import CLOTHS
from clothfit.pictures.polygons import (
    SPHERE_DISCS,
    TARGET_OPACITY,
    bare,
    good_frames,
    painted,
    pins,
    sightings,
    stage,
    wind,
)
from clothfit.scene.scene import load


def still(scene, frames=3, shift=(0.0, 0.0, 0.0)):
    """The cloths of a scene, moved by `shift` from frame to frame."""
    x = np.concatenate([cloth.positions for cloth in scene.cloths])
    return x + np.arange(frames)[:, None, None] * np.array(shift)


def test_several_cloths_have_colours_of_their_own():
    scene = load(document(cloth(), cloth(vertPos=[{"x": i % 4, "y": 2.0, "z": i // 4} for i in range(12)])))
    on = stage(scene, [still(scene)], 1000)
    (layer,) = painted(on, 0, still(scene)[0])
    assert len(layer.corners) == 24
    assert len(np.unique(layer.colours.round(6), axis=0)) == 2  # two level sheets, each in one light


def test_the_target_is_painted_over_the_cloth_and_shines_through():
    scene = load(document())
    x = still(scene)
    on = stage(scene, [x, x], 1000)
    own, over = painted(on, 0, x[0], x[0])
    assert (own.opacity, over.opacity) == (1.0, TARGET_OPACITY)
    assert_allclose(own.corners, over.corners)
    assert (over.colours[:, 1] > over.colours[:, [0, 2]].max(axis=1)).all()  # green


def test_an_unobserved_vertex_hides_its_faces_of_the_target_alone_and_the_others_are_marked():
    scene = load(document())
    x = still(scene)
    goal = x.copy()
    goal[:, 0] = np.nan
    on = stage(scene, [x, goal], 1000)
    own, over = painted(on, 1, x[1], goal[1])
    touching = int((scene.cloths[0].triangles == 0).any(axis=1).sum())
    assert (len(own.corners), len(over.corners)) == (12, 12 - touching)
    assert_allclose(sightings(on, 1, goal[1]), project(on.camera, x[1, 1:])[:, :2])
    assert len(sightings(on, 1, x[1])) == 0  # of what is seen as a whole the faces are enough


def test_a_sphere_lies_between_the_faces_behind_its_middle_and_those_before_it():
    scene = load(document(colliders=[sphere(0.5)]))
    x = still(scene)
    on = stage(scene, [x], 1000)
    behind, ball, before = painted(on, 0, x[0])
    assert len(ball.corners) == SPHERE_DISCS
    assert len(behind.corners) + len(before.corners) == 12
    middle = ball.corners[0].mean(axis=0)
    assert_allclose(middle, project(on.camera, np.zeros(3))[:2], atol=1e-12)
    assert_allclose(np.linalg.norm(ball.corners[0] - middle, axis=1), 0.5)  # a disc of the sphere's radius
    outer = np.linalg.norm(ball.corners - middle, axis=2).max(axis=1)
    assert (outer <= 0.5 + 1e-12).all()  # and what shades it stays inside


def test_fixed_vertices_and_the_wind_are_shown():
    scene = load(document(windVel={"x": 3.0, "y": 0.0, "z": 4.0}))
    x = still(scene)
    on = stage(scene, [x], 1000)
    assert_allclose(pins(on, 0, x[0]), project(on.camera, x[0][scene.cloths[0].fixed])[:, :2])
    way, speed = wind(on, 0)
    assert speed == 5.0
    assert_allclose(way, project(on.camera, np.array([0.6, 0.0, 0.8]))[:2])
    assert wind(stage(load(document()), [x], 1000), 0) is None


def test_the_camera_follows_a_cloth_that_goes_far_and_only_such_a_one():
    scene = load(document())
    near, far = still(scene), still(scene, 20, (0.0, -2.0, 0.0))
    assert_array_equal(stage(scene, [near], 1000).middle, 0.0)
    on = stage(scene, [far], 1000)
    first, last = (painted(on, frame, far[frame])[0].corners for frame in (0, 19))
    assert_allclose(first, last, atol=1e-12)


def test_vertices_that_no_face_shows_are_dots():
    scene = load(document(cloth(), cloth(triangles=[])))
    x = still(scene)
    on = stage(scene, [x], 1000)
    places, colours = bare(on, 0, x[0])
    assert_allclose(places, project(on.camera, x[0, 12:])[:, :2])
    assert_allclose(colours, np.tile(CLOTHS[1], (12, 1)))


def test_falling_far_is_not_losing_itself():
    assert good_frames(still(load(document()), 10, (0.0, -5.0, 0.0))) == 10


@pytest.mark.parametrize("value", [1e9, np.inf, np.nan])
def test_a_motion_is_shown_until_it_loses_itself(value):
    x = still(load(document()), 10)
    x[4:, 3] = value
    assert good_frames(x) == 4
