"""Closed meshes as colliders: distances against those of shapes and of all triangles, and contacts that a step only
ends in: closed forms, what is left of a surface that turns away, and exact derivatives.
"""

import numpy as np
import pytest
from helpers import physics
from helpers.derivatives import assert_derivatives
from helpers.obstacles import RUB, ring, with_room
from helpers.physics import METHODS, full, relative, scene, sheet, thing, xyz
from helpers.surfaces import block, body, sphere, torus
from scipy.spatial import cKDTree

from clothfit.engine.forces import bodies, collider_rows
from clothfit.engine.forces import contact as forces
from clothfit.engine.inputs import poses, sampling
from clothfit.engine.inputs.body_files import body_of
from clothfit.engine.inputs.tables import later, set_inputs
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.motion.simulate import simulate
from clothfit.scene.keys import Keys

TIGHT = 1e-13


def around(made, count, **fields):
    """The colliders of a scene with one mesh, for so many points."""
    return with_room(full(colliders=[body(made, **fields)]).colliders, count)


# --- distances


def test_a_block_has_the_distances_of_a_box():
    rng = np.random.default_rng(1)
    y, placed = rng.uniform(-1.2, 1.2, (500, 3)), {"pos": xyz((0.2, 0.1, 0.3)), "rot": xyz((15, 25, 5))}
    one = around(block((0.5, 0.35, 0.35)), len(y), **placed, scale=xyz((2, 1, 3)))
    box = {"type": 3, "scale": xyz((1.0, 0.35, 1.05)), **placed}
    other = full(colliders=[{"friction": 0, **box}]).colliders
    for found, expected in zip(collider_rows.depths(one, y), collider_rows.depths(other, y), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-14)


def test_distances_are_those_of_the_nearest_triangle_inside_and_outside_of_a_torus():
    points, faces = torus(24, 16)
    own = around((points, faces), 400)
    y = np.random.default_rng(2).uniform(-1.5, 1.5, (400, 3)) * [1, 0.5, 1]
    depth, normal = (found[0] for found in collider_rows.depths(own, y))
    # the foot of the normal is on the mesh, and none of dense samples of it is nearer
    share = np.random.default_rng(3).dirichlet(np.ones(3), 200)
    samples = np.einsum("sc,fcd->fsd", share, points[faces]).reshape(-1, 3)
    nearest = cKDTree(samples).query(y)[0]
    assert (np.abs(depth) <= nearest + 1e-14).all()
    assert np.abs(nearest - np.abs(depth)).max() < 0.02  # some millimetres between samples
    feet = y + depth[:, None] * normal
    np.testing.assert_allclose(np.abs(collider_rows.depths(own, feet)[0]), 0.0, atol=1e-14)
    inside = np.hypot(np.hypot(y[:, 0], y[:, 2]) - 1, y[:, 1]) < 0.35
    far = np.abs(np.hypot(np.hypot(y[:, 0], y[:, 2]) - 1, y[:, 1]) - 0.35) > 0.02  # beyond the edges' chords
    assert ((depth > 0) == inside)[far].all()
    assert inside[far].sum() > 50


def test_nothing_is_deeper_than_the_box_of_a_mesh_says():
    y = np.random.default_rng(1).uniform(-1.5, 1.5, (500, 3))
    turned = {"pos": xyz((0.2, 0.1, 0.3)), "rot": xyz((15, 25, 5)), "thickness": 0.02}
    for made in (torus(24, 16), block((0.5, 0.35, 0.35))):
        own = around(made, len(y), **turned)
        depth, most = collider_rows.depths(own, y)[0][0], np.array([collider_rows.most(own, y, k) for k in range(500)])
        assert (depth <= most).all()
        known = np.isfinite(most)
        assert known.sum() > 100
    # a block is its box: outside the two are the same, but for the factor that hides no rounding
    np.testing.assert_allclose(most[known], depth[known], atol=3e-9)


def test_where_the_search_begins_changes_no_bit():
    own = around(torus(24, 16), 500)
    y = np.random.default_rng(5).uniform(-1.5, 1.5, (500, 3))
    y[:16] = torus(24, 16)[0][:16] * 1.2  # nearest to corners, of which each belongs to six triangles
    first = collider_rows.depths(own, y)
    own.bodies.last[:] = np.random.default_rng(6).integers(0, 768, own.bodies.last.shape)
    own.bodies.asked[:] = np.nan
    again = collider_rows.depths(own, y)
    assert np.array_equal(first[0], again[0])
    assert np.array_equal(first[1], again[1])


def test_an_edge_or_a_corner_has_one_number_whichever_triangle_it_is_found_from():
    corners = block()[0]
    sides = [(a + b) / 2 for i, a in enumerate(corners) for b in corners[:i] if np.linalg.norm(a - b) == 1.0]
    y = 1.2 * np.concatenate([corners, sides])
    own = around(block(), len(y))
    found, again = np.empty((2, 1, len(y)), np.int32)
    collider_rows.fill_parts(own, y, found)
    assert len(np.unique(found)) == 8 + 12
    for step in 1e-9 * np.concatenate([np.eye(3), -np.eye(3)]):
        own.bodies.last[:] = np.random.default_rng(9).integers(0, 12, own.bodies.last.shape)
        collider_rows.fill_parts(own, y + step, again)
        assert np.array_equal(again, found)


def test_two_meshes_are_two_colliders():
    one, other = body(sphere(6), pos=xyz((0.5, 0, 0))), body(block(), pos=xyz((-0.5, 0.2, 0)))
    both = full(colliders=[one, other]).colliders
    y = np.random.default_rng(8).uniform(-1, 1, (9, 3))
    for c, each in enumerate((one, other)):
        alone = full(colliders=[each]).colliders
        assert np.array_equal(collider_rows.depths(both, y)[0][c], collider_rows.depths(alone, y)[0][0])


# --- motion of the mesh


def test_vertices_are_where_the_file_has_them_and_have_its_velocity(wobble):
    for method in ("implicit", "symplectic"):
        made = full(colliders=[ring(wobble)], integrationMethod=METHODS[method], delta=0.04)
        frames = np.load(wobble)["positions"]
        set_inputs(made.inputs, made, 2)
        late = 2 + made.inputs.lead
        own = made.colliders.bodies
        np.testing.assert_allclose(own.place, frames[late], atol=1e-14)  # a step to a frame: on the keys
        rate = (frames[3] - frames[2]) / 0.04
        np.testing.assert_allclose(own.velocity, rate, atol=1e-12)
        again = bodies.build([bodies.Surface(own.place, *body_of(physics.scene(
            physics.sheet("nn"), colliders=[ring(wobble)]).colliders[0]).surface[1:])], 9)  # fmt: skip
        # the same normals and boxes as of a mesh that is built there, whose tree has another order
        assert np.array_equal(own.corner, again.corner) or relative(own.corner, again.corner) < 1e-14
        assert np.array_equal(own.tree.box[0], again.tree.box[0])


@pytest.mark.parametrize("interpolation", ["linear", "smooth", "hold"])
def test_frames_are_interpolated_as_keys_are(interpolation):
    rng = np.random.default_rng(9)
    own, values = np.array([0.0, 0.1, 0.35, 0.5]), rng.normal(size=(4, 5, 3))
    times = np.linspace(-0.1, 0.7, 33)
    place, weight = poses.shares(own, interpolation, times)

    class Moving:
        times, frames, motion = own, values, "body.motion"

    rows = poses.frames_of(Moving, interpolation)
    found = np.einsum("tj,tjvc->tvc", weight, rows[place])
    expected = sampling.interpolated(Keys(own, values, interpolation), times)
    np.testing.assert_allclose(found, expected, atol=1e-13)
    np.testing.assert_allclose(poses.places(Moving, interpolation, times), expected, atol=1e-13)


# --- forces


def test_a_contact_ahead_brakes_a_vertex_and_has_no_friction():
    system = full(colliders=[body(block((1, 1, 1)), **RUB)], gravity=xyz((0, 0, 0)))
    own, h = system.colliders, system.h
    y = np.tile([0.1, 0.65, 0.2], (9, 1))  # 5 cm above the thickness
    A, b = physics.step_terms(system, forces, own, y, np.tile([1.0, -0.03 / h, 0], (9, 1)))
    assert not b.any()
    A, b = physics.step_terms(system, forces, own, y, np.tile([1.0, -0.08 / h, 0], (9, 1)))
    np.testing.assert_allclose(b, np.tile([0, -h * 700 * 0.05, 0], (9, 1)), atol=1e-12)
    np.testing.assert_allclose(physics.times(A, np.ones((9, 3))), np.tile([0, h * h * 700, 0], (9, 1)), atol=1e-12)
    # with the extrapolated state that is where it is already
    assert not physics.step_terms(system, forces, own, y, np.tile([0, -0.08 / h, 0], (9, 1)), ahead=True)[1].any()


# --- motions


def test_fast_vertices_do_not_pass_through_a_thin_mesh():
    plate = body(block((2, 0.02, 2)), thickness=0.01)  # 4 cm in a step where it meets it
    motion = simulate(flat(0.6, 0.0, 0.01, optimizationIterations=51, colliders=[plate]))
    assert motion.positions[..., 1].min() > 0.01


def test_a_motion_that_begins_later_finds_its_poses(wobble):
    made = full(colliders=[ring(wobble)])
    set_inputs(made.inputs, made, 3)
    expected = made.colliders.bodies.place.copy()
    set_inputs(later(made.inputs, 2), made, 1)
    assert np.array_equal(made.colliders.bodies.place, expected)


# --- contacts that a step only ends in


def prism(outline):
    """A closed mesh with this outline in x and y, of five corners, all of which the fourth one sees."""
    return {
        "type": 4, "pos": xyz((0, 0, 0)), "scale": xyz((1, 1, 1)), "thickness": 0.01, "friction": 0.3,
        "mesh": {
            "vertices": [xyz((x, y, z)) for z in (-1, 1) for x, y in outline],
            "triangles": [3, 0, 4, 3, 1, 0, 3, 2, 1, 8, 9, 5, 8, 5, 6, 8, 6, 7]
            + [i for e in range(5) for a, b in [(e, (e + 1) % 5)] for i in (a, b, b + 5, a, b + 5, a + 5)],
        },
    }  # fmt: skip


FLOOR = prism([(-1, -1), (1, -1), (1, 0), (0, 0), (-1, 0)])
VALLEY = prism([(-1, -1), (1, -1), (1, 1), (0, 0), (-1, 1)])


def flat(height, speed, mass, **fields):
    """Four vertices that come down on something."""
    corners = [(a, height, b) for a in (-0.1, 0.1) for b in (-0.1, 0.1)]
    own = thing(corners, [(0, 1), (1, 3), (3, 2), (2, 0)], mass=mass)
    own["vertVel"] = [xyz((0, -speed, 0))] * 4
    made = {"integrationMethod": 2, "delta": 0.02, "gravity": xyz((0, -9.81, 0))}
    return scene(own, tolerance=TIGHT, **{**made, **fields})


def test_a_vertex_that_ends_in_a_mesh_is_held_by_an_implicit_spring():
    m, h, kappa, y = 0.01, 0.02, 1000.0, 0.012
    part = rollout(build(flat(y, 0.0, m, colliders=[FLOOR]), 0), 1, TIGHT)[0]
    assert part.used[0] == 1
    assert part.active[0, 0].all()
    expected = (-9.81 * h * m + h * kappa * (0.01 - y)) / (m + h * h * kappa)
    np.testing.assert_allclose(part.velocity(1)[:, 1], expected, rtol=1e-12)


def test_what_the_step_knew_or_does_not_reach_is_not_met():
    for y, speed in ((0.05, 1.0), (0.05, 3.0), (0.009, 3.0)):
        assert not rollout(build(flat(y, speed, 0.01, colliders=[FLOOR]), 0), 1, TIGHT)[0].active.any()


def over(turning, method="implicit", newton=1, frames=3, fall=4.1):
    """A sheet that falls on a floor, or along one side of a valley and into the other."""
    one = sheet("LL", vertIsFixed=[False] * 9, damping=0.1)
    x = np.array([[0.04 * p["x"], 0.0, 0.1 * p["z"]] for p in one["vertPos"]])
    x -= x.mean(axis=0)
    x[:, 1] = 0.013 + 2e-4 * np.arange(9)
    v = np.array([(1.0 + 0.1 * i, 0.0, 0.3) for i in range(9)])
    if turning:
        x, v = x @ TURN.T + [-0.08, 0.08, 0.0], np.array([(4.0 + 0.02 * i, -fall, 0.3) for i in range(9)])
    one["vertPos"], one["vertVel"] = [xyz(p) for p in x], [xyz(p) for p in v]
    one.pop("springRestLength", None)
    return scene(
        one, integrationMethod=METHODS[method], forwardSubSteps=newton, delta=0.02, optimizationIterations=frames,
        colliders=[VALLEY if turning else FLOOR], tolerance=TIGHT, fit={"gravity": True},
        gravity=xyz((0, -9.81, 0) if turning else (0, -40, 0)),
    )  # fmt: skip


TURN = np.array([[1, 1, 0], [-1, 1, 0], [0, 0, np.sqrt(2)]]) / np.sqrt(2)
TURNS = [("implicit", 1, False), ("implicit", 1, True), ("implicit", 3, True), ("bdf2", 1, True)]


@pytest.mark.slow
@pytest.mark.parametrize(("method", "newton", "turning"), TURNS)
def test_gradient_and_tangent_of_contacts_that_a_step_ends_in(method, newton, turning):
    made = over(turning, method, newton, fall=4.0 if newton > 1 else 4.1)  # a speed at which few contacts switch
    part = rollout(build(made, 0), 2, TIGHT)[0]
    assert part.active.any() or turning
    assert (part.used > newton).any() == turning  # the other side is no part of what the first solution knows
    # systems are solved to 1e-13, and friction makes their condition about 1e4
    assert_derivatives(made, TIGHT, 1e-10, 1e-9)
