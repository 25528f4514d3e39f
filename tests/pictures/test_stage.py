"""A moment of a scene as pixels: what is near hides what is far, the light follows the normal; what is marked; and
colliders as triangles, which lie on the surface that pushes; of controlled motions the key that comes next, forces as
arrows, distances from the keys.
"""

import io

import numpy as np
import pytest
from helpers import physics
from helpers.scenes import cloth, document, sphere
from helpers.surfaces import body, torus
from numpy.testing import assert_allclose, assert_array_equal

from clothfit import Forces, Key, load, simulate
from clothfit.control.control import controlled_motion
from clothfit.engine.forces.collider_rows import build, depths
from clothfit.engine.inputs.sampling import states
from clothfit.engine.system import build as build_system
from clothfit.kernels.raster import fill, fill_sphere, lit
from clothfit.pictures import gif
from clothfit.pictures import stage as scenery
from clothfit.pictures.camera import project
from clothfit.pictures.picture_file import CLOTHS, GROUND
from clothfit.pictures.plots import chosen
from clothfit.pictures.solids import box, capsule, solids
from clothfit.pictures.stage import BEHIND, bare, drawn, good_frames, pins, sightings, stage, wind
from clothfit.scene.cloth import CAPSULE

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
    near, far = (sheet(np.full(4, z), [AWAY] * 4, colour) for z, colour in ((1.0, (1, 0, 0)), (2.0, (0, 0, 1))))
    for order in ((near, far), (far, near)):
        image, depth = blank()
        for one in order:
            fill(*one, AWAY, 1.0, image, depth)
        assert (depth == 1.0).all()
        assert (image[:, :, 0] > image[:, :, 2]).all()


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


def still(scene, frames=3, shift=(0.0, 0.0, 0.0)):
    """The cloths of a scene, moved by `shift` from frame to frame."""
    x = np.concatenate([cloth.positions for cloth in scene.cloths])
    return x + np.arange(frames)[:, None, None] * np.array(shift)


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
    far = still(scene, 20, (0.0, -2.0, 0.0))
    assert_array_equal(stage(scene, [still(scene)], 1000).middle, 0.0)
    on = stage(scene, [far], 1000)
    first, last = (drawn(on, frame, far[frame], None, 80) for frame in (0, 19))
    assert (np.abs(first.astype(int) - last).max(axis=2) > 5).mean() < 5e-3  # but for rounding at edges


def test_vertices_that_no_face_shows_are_dots():
    scene = load(document(cloth(), cloth(triangles=[])))
    x = still(scene)
    on = stage(scene, [x], 1000)
    places, colours = bare(on, 0, x[0])
    assert_allclose(places, project(on.camera, x[0, 12:])[:, :2])
    assert_allclose(colours, np.tile(CLOTHS[1], (12, 1)))


def test_a_motion_is_shown_until_it_loses_itself_and_falling_far_is_not_that():
    assert good_frames(still(load(document()), 10, (0.0, -5.0, 0.0))) == 10
    for value in (1e9, np.inf, np.nan):
        x = still(load(document()), 10)
        x[4:, 3] = value
        assert good_frames(x) == 4


def test_an_unobserved_vertex_hides_its_faces_of_the_target_alone_and_the_others_are_marked():
    scene = load(document())
    x = still(scene)
    goal = x.copy()
    goal[:, 0] = np.nan
    on = stage(scene, [x, goal], 1000)
    own, part, whole = (drawn(on, 1, x[1], over, 200) for over in (None, goal[1], x[1]))
    green = [(over.astype(int) - own != 0).any(axis=2).sum() for over in (part, whole)]
    touching = int((scene.cloths[0].triangles == 0).any(axis=1).sum())
    assert green[0] / green[1] == pytest.approx(1 - touching / 12, abs=0.02)  # faces alike; pixels at their edges
    assert_allclose(sightings(on, 1, goal[1]), project(on.camera, x[1, 1:])[:, :2])
    assert len(sightings(on, 1, x[1])) == 0  # of what is seen as a whole the faces are enough


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
    scene, times = world(**SHAPES[name], posKeys=MOVED, rotKeys=TURNED), np.array([0.0, 0.35, 1.0])
    (found,), (own,) = solids(scene, times, scene.cloths[0].positions), scene.colliders
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


# Marks of controlled motions.


STEPS, H = 20, 0.02


@pytest.fixture(scope="module")
def own():
    """A hanging cloth that forces in x push, twice as much at the end; keys in part, of a mean and of all."""
    made = physics.scene(cloth(), delta=H, optimizationIterations=STEPS + 1)
    u = np.zeros((STEPS, 12, 3))
    u[:, 5:, 0] = np.linspace(0.1, 0.2, STEPS)[:, None]
    pushed = made.with_forces(Forces(H * np.arange(STEPS), u))
    motion = simulate(pushed)
    x = motion.positions
    keys = [
        Key(8, 0, np.array([6, 7], np.int32), x[8, [6, 7]] + [0, 0.3, 0.4]),
        Key(8, 0, np.arange(12, dtype=np.int32), np.array([[0.0, 1.0, 0.0]]), share=np.full(12, 1 / 12)),
        Key(20, 0, np.arange(12, dtype=np.int32), x[20]),
    ]
    return controlled_motion(made, pushed, keys, motion), x, u


def test_the_course_beside_its_keys(own):
    found, x, u = own
    assert found.due.tolist() == [8, 20]
    assert [found.next(frame) for frame in (0, 8, 9, 20)] == [0, 0, 1, 1]
    assert np.isnan(found.poses[0]).any(axis=1).sum() == 10
    assert_array_equal(found.poses[1], x[20])
    assert found.distance[0, 8] == pytest.approx(0.5, rel=1e-12)
    mean = x.mean(axis=1) - [0.0, 1.0, 0.0]
    assert_allclose(found.distance[1], np.linalg.norm(mean, axis=1), rtol=1e-12)
    assert found.distance[2, 20] == 0.0 < found.distance[2, :20].min()
    assert found.effort.sum() == pytest.approx(H * (u**2).sum(), rel=1e-12)
    assert found.effort[-1] == 0.0  # nothing begins at the last frame
    assert np.abs(found.free[1:] - x[1:]).max() > 1e-4


def test_the_marks_of_each_frame_are_within_the_picture(own):
    found, x, _ = own
    made = scenery.marks(found)
    size = np.linalg.norm(np.ptp(x[0], axis=0))
    lengths = np.linalg.norm(made.arrows, axis=2)
    assert lengths.max() == pytest.approx(scenery.LONGEST * size)
    assert lengths[0, 6] == pytest.approx(0.5 * scenery.LONGEST * size)
    assert not made.arrows[:, :5].any()
    assert_array_equal(made.keys[8], found.poses[0])
    assert_array_equal(made.keys[9], found.poses[1])
    assert [len(each) for each in made.dots] == [1] * 9 + [0] * 12
    assert made.largest == pytest.approx(0.2)
    on = stage(found.scene, [x, *made.seen(x)], 100, times=found.times)
    for frame in range(STEPS):
        for ends in scenery.arrows(on, frame, x[frame], made):
            assert ((ends > on.camera.low) & (ends < on.camera.high)).all()


def test_no_more_arrows_than_can_be_told_apart_and_none_without_forces():
    many = physics.scene(physics.chain(3 * scenery.MOST_ARROWS, "nn"), delta=H, optimizationIterations=2)
    pushed = many.with_forces(Forces(np.zeros(1), np.ones((1, 3 * scenery.MOST_ARROWS, 3))))
    x = many.cloths[0].positions
    keys = [Key(1, 0, np.arange(len(x), dtype=np.int32), x)]
    made = scenery.marks(controlled_motion(many, pushed, keys, simulate(pushed)))
    assert 0.5 * scenery.MOST_ARROWS < made.arrows[0].any(axis=1).sum() <= scenery.MOST_ARROWS
    still = physics.scene(physics.thing([(0, 0, 0)]), delta=H, optimizationIterations=3, gravity=physics.xyz((0, 0, 0)))
    motion = simulate(still)
    made = scenery.marks(controlled_motion(still, still, [Key(2, 0, np.zeros(1, np.int32), np.ones((1, 3)))], motion))
    assert not made.arrows.any()
    assert [name for name, _ in made.legend] == ["key", "cloth"]


def test_a_film_holds_the_keys(own):
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed; no animation is drawn")
    found, *_ = own
    made = scenery.marks(found)
    cut = gif.film(found.times, [7, 20])
    assert 7 in cut.frames  # every second one is shown otherwise
    waits = dict(zip(cut.frames, cut.durations, strict=True))
    assert waits[7] - waits[2] == pytest.approx(1000 * gif.LAST_FRAME_PAUSE, abs=200)  # a motion this short is slowed
    plain = gif.animation(found.scene, found.times, found.own, made.keys, 200)
    drawn = gif.animation(found.scene, found.times, found.own, made.keys, 200, made)
    first = [np.array(image.open(io.BytesIO(each)).convert("RGB")).astype(int) for each in (plain, drawn)]
    red = [((each[:, :, 0] - each[:, :, 2] > 120) & (each[:, :, 1] > 50)).sum() for each in first]
    assert red[1] > 15 + 5 * red[0]  # arrows


@pytest.mark.quick
def test_a_strip_shows_the_keys():
    assert chosen(101) == [0, 20, 40, 60, 80, 100]
    assert chosen(101, [50, 100]) in ([0, 20, 50, 60, 80, 100], [0, 20, 40, 50, 80, 100])
    assert set(chosen(101, [3, 4, 5])) >= {3, 4, 5}
    assert chosen(101, list(range(1, 90))) == chosen(101)
    assert chosen(2, [1]) == [0, 1]
