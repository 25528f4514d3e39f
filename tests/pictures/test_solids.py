"""Colliders as triangles: they lie on the surface that pushes, enclose its volume, and move with it."""

import numpy as np
import pytest
from helpers.scenes import document
from helpers.surfaces import body, torus
from numpy.testing import assert_allclose

from clothfit.engine.forces.touch import build, depths
from clothfit.engine.inputs.sampling import states
from clothfit.engine.system import build as build_system
from clothfit.pictures.solids import box, capsule, solids
from clothfit.pictures.stage import drawn, stage
from clothfit.scene.cloth import CAPSULE
from clothfit.scene.scene import load

ZERO = {"x": 0.0, "y": 0.0, "z": 0.0}
TURNED = {"times": [0, 1], "values": [ZERO, {"x": 20, "y": 70, "z": -30}]}
MOVED = {"times": [0, 1], "values": [ZERO, {"x": 0.3, "y": -0.2, "z": 0.5}]}
SHAPES = {
    "plane": {"type": 0, "rot": {"x": 10, "y": 0, "z": 25}},
    "ball": {"type": 1, "friction": 0.1},
    "capsule": {"type": 2, "radius": 0.3, "radius2": 0.1, "height": 0.7, "rot": {"x": 40, "y": 10, "z": 25}},
    "box": {"type": 3, "scale": {"x": 0.4, "y": 0.9, "z": 0.2}, "rot": {"x": 40, "y": 10, "z": 25}},
}


def world(**fields):
    """A scene with one collider."""
    item = {"pos": {"x": 0.2, "y": -0.4, "z": 0.1}, "rot": ZERO, "scale": {"x": 1, "y": 1, "z": 1}, **fields}
    return load(document(colliders=[item], planes="solid"))


@pytest.mark.parametrize("name", SHAPES)
def test_every_point_lies_on_the_surface_that_pushes_wherever_it_has_moved(name):
    scene = world(**SHAPES[name], posKeys=MOVED, rotKeys=TURNED)
    times = np.array([0.0, 0.35, 1.0])
    (found,) = solids(scene, times, scene.cloths[0].positions)
    (own,) = scene.colliders
    state = states(scene.colliders, times, 1.0, 0)
    number = {1: CAPSULE}.get(own.kind, own.kind)  # a ball is a cone without a length
    for frame in range(3):
        pushing = build([number], [(0.0, 1.0, 0.0)], state[frame])
        assert_allclose(depths(pushing, found.at(frame))[0], 0.0, atol=1e-12)
    assert np.ptp(found.centre[:, 0]) == pytest.approx(0.3)


def test_a_mesh_is_drawn_where_it_pushes_and_its_vertices_go_their_own_ways(tmp_path):
    points, faces = torus(8, 5, 0.4, 0.2)
    np.savez(tmp_path / "grow.npz", positions=np.stack([points, 1.5 * points]), times=np.array([0.0, 1.0]))
    item = body((points, faces), motion={"file": str(tmp_path / "grow.npz")})
    scene = world(**{**item, "pos": {"x": 0.2, "y": -0.4, "z": 0.1}}, posKeys=MOVED, rotKeys=TURNED)
    times = np.array([0.0, 0.5, 1.0])
    (found,) = solids(scene, times, scene.cloths[0].positions)
    system = build_system(scene, 0)
    for frame in range(3):
        own = found.at(frame) - found.centre[frame]
        assert_allclose(own, (1 + 0.5 * times[frame]) * points @ found.turn[frame].T, atol=1e-12)
    assert_allclose(found.at(0), system.colliders.bodies.place @ found.turn[0].T + found.centre[0], atol=1e-12)
    assert np.array_equal(np.sort(found.triangles, axis=None), np.sort(system.colliders.bodies.triangles, axis=None))


@pytest.mark.parametrize(
    ("made", "volume", "share"),
    [
        (box(np.array([0.5, 1.0, 1.5])), 6.0, 1e-12),
        (capsule(1.0, 1.0, 2.0), 4 / 3 * np.pi + 2 * np.pi, 5e-3),  # of a circle in 48 parts 0.3 % are missing
        (capsule(1.0, 1.0, 0.0), 4 / 3 * np.pi, 5e-3),
        (capsule(1.0, 0.3, 0.2), 4 / 3 * np.pi, 1e-2),  # one ball is in the other
    ],
)
def test_triangles_enclose_the_volume_and_are_clockwise_from_outside(made, volume, share):
    points, triangles = made
    a, b, c = (points[triangles[:, k]] for k in range(3))
    assert (a * np.cross(b, c)).sum() / 6 == pytest.approx(volume, rel=share)


def test_a_plane_is_drawn_around_the_motion_on_both_sides_of_its_middle():
    scene = world(**SHAPES["plane"])
    x = scene.cloths[0].positions + np.array([5.0, 0.0, 3.0])
    (found,) = solids(scene, np.zeros(1), x)
    foot = x.mean(axis=0) - found.turn[0, :, 1] * ((x.mean(axis=0) - found.centre[0]) @ found.turn[0, :, 1])
    assert found.endless
    assert_allclose(found.at(0).mean(axis=0), foot, atol=1e-12)


def test_a_box_hides_the_cloth_behind_it_and_not_the_cloth_on_it():
    tall = world(type=3, scale={"x": 9, "y": 1, "z": 9}, pos={"x": 1.5, "y": -0.5, "z": 1.0})  # its top is the cloth
    blue = []
    for shift in (0.0, -0.5, 0.2):
        x = tall.cloths[0].positions + (0.0, shift, 0.0)
        on = stage(tall, [x[None]], 100)
        picture = drawn(on, 0, x, None, 80).astype(int)
        blue.append(int((picture[:, :, 2] > picture[:, :, 0] + 30).sum()))
    lying, inside, above = blue
    assert inside == 0
    assert lying == pytest.approx(above, rel=0.1)  # the picture of the other one has another frame
