"""Colliders with friction: their surfaces and forces against formulas and differences, motions against closed forms."""


import numpy as np
import pytest
from helpers import physics
from helpers.derivatives import assert_derivatives
from helpers.obstacles import SHAPES, box, capsule, plane, ring, touching, with_room
from helpers.physics import GRAVITY, METHODS, STATES, full, keys, relative, scene, state, thing, xyz
from helpers.scenes import document, problems
from helpers.surfaces import block, body
from scipy.integrate import solve_ivp

from clothfit import InvalidScene, simulate
from clothfit.engine.forces import collider_rows, contact, law
from clothfit.engine.inputs import sampling
from clothfit.engine.inputs.tables import set_inputs
from clothfit.engine.rollout import rollout
from clothfit.engine.step import guard
from clothfit.engine.system import build
from clothfit.pictures.solids import solids

TIGHT = 1e-13


# --- surfaces


def reference(name, p):
    """Distances of points (P, 3), another way: by dense samples of the surface, or of the axis of a cone."""
    if name == "box":
        half = np.array([0.6, 0.35, 0.7])
        inside = (half - np.abs(p)).min(axis=1)
        return np.where(inside > 0, -inside, np.linalg.norm(p - np.clip(p, -half, half), axis=1))
    # the round cone is the union of balls of linear radius on the axis
    share = np.linspace(0, 1, 200_001)
    axis, radius = -0.55 + 1.1 * share, 0.5 - 0.2 * share
    radial = np.hypot(p[:, 0], p[:, 2])
    return np.array([(np.hypot(r, y - axis) - radius).min() for r, y in zip(radial, p[:, 1], strict=True)])


@pytest.mark.parametrize("name", ["box", "capsule"])
def test_distances_are_those_of_the_shapes(name):
    made = touching(SHAPES[name]).colliders
    points = np.random.default_rng(1).uniform(-1.2, 1.2, (300, 3))
    turn, place = made.state[0, collider_rows.AXES : collider_rows.SIZE], made.state[0, collider_rows.PLACE]
    depth, normal = collider_rows.depths(made, points @ turn + place)
    # samples of the axis 5 µm apart miss the minimum by their square
    np.testing.assert_allclose(made.thickness[0] - depth[0], reference(name, points), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(normal[0], axis=1), 1.0, atol=1e-14)


@pytest.mark.parametrize("name", [*SHAPES, "mesh"])
def test_normals_are_the_gradients_of_the_distances(name, wobble):
    made = with_room(touching(SHAPES.get(name) or ring(wobble)).colliders, 200)
    y, t = made.state[0, 0] + np.random.default_rng(2).uniform(-1.2, 1.2, (200, 3)), 1e-6
    both = [[collider_rows.depths(made, y + side * t * e)[0][0] for side in (-1, 1)] for e in np.eye(3)]
    rows = [(before - after) / (2 * t) for before, after in both]
    # rounding at 1e-6, and curvatures that jump where two parts of a surface meet, within 1e-6 of a point
    np.testing.assert_allclose(np.transpose(rows), collider_rows.depths(made, y)[1][0], atol=1e-5)


def test_a_cone_whose_one_end_holds_the_other_is_a_ball():
    made = full(colliders=[capsule(radius=0.2, radius2=0.5, height=0.25)]).colliders
    y = np.random.default_rng(3).normal(size=(50, 3))
    ball = np.linalg.norm(y - [0, 0.125, 0], axis=1) - 0.5
    np.testing.assert_allclose(-collider_rows.depths(made, y)[0][0], ball, atol=1e-14)


# --- the force


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("at", STATES)
def test_force_matrix_and_right_hand_side(name, at):
    system = touching(SHAPES[name])
    made, point = system.colliders, state(system, at)
    depth, normal = (found[0] for found in collider_rows.depths(made, point.y))
    d, n = np.maximum(depth, 0.0)[:, None], normal
    assert (d > 0).any()
    V = made.state[0, 1] + np.cross(made.state[0, 2], point.y - made.state[0, 0])

    def across(v):
        return v - n * (n * v).sum(axis=1, keepdims=True)

    slip = across(point.u - V)
    gamma = 0.6 * 700 * d / np.sqrt((slip * slip).sum(axis=1, keepdims=True) + law.STICTION_SPEED**2)
    f = 700 * d * n - gamma * slip
    assert relative(physics.total_force(contact, made, point.y, point.u), f) < 1e-13
    A, b = physics.step_terms(system, contact, made, point.y, point.u)
    h, inside = system.h, d > 0
    push = 700 * inside * n * (n * point.dy).sum(axis=1, keepdims=True)
    assert relative(physics.times(A, point.dy), h * h * push + h * gamma * across(point.dy)) < 1e-13
    assert relative(b, h * (f + gamma * across(point.u))) < 1e-12
    assert relative(physics.damping(contact, made, point.y, point.u, point.dy), -gamma * across(point.dy)) < 1e-13
    later = physics.step_terms(system, contact, made, point.y, point.u, ahead=True)[1]
    outward = 700 * inside * n * (n * point.u).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(later - b, h * h * outward, atol=1e-11)  # differences of numbers of some 10
    power = contact.damping_power(made, point.y, point.u, point.w)
    assert power == pytest.approx(-(gamma * slip * (point.w - V)).sum(), rel=1e-12)
    assert contact.energy(made, point.y) == pytest.approx(350 * (d * d).sum(), rel=1e-13)


# --- motions


def sliding(angle, friction, method="bdf2", newton=1, steps=300, delta=2e-3):
    """The distance down a slope of a square of cloth that begins at rest on it, at each frame, and the times."""
    turn = physics.rotation((0, 0, 1), angle)
    depth = 0.1 * GRAVITY * np.cos(angle) / 1000  # where the push carries the weight
    x = np.array([[a, -depth, b] for a in (0.0, 0.1) for b in (0.0, 0.1)]) @ turn.T
    block = thing(x, [(0, 1), (1, 3), (3, 2), (2, 0), (0, 3), (1, 2)], [(0, 1, 2), (1, 3, 2)], stiffness=100.0)
    made = scene(
        block, colliders=[plane(angles=(0, 0, np.degrees(angle)), friction=friction)], planes="solid", delta=delta,
        integrationMethod=METHODS[method], forwardSubSteps=newton, optimizationIterations=steps + 1, tolerance=TIGHT,
    )  # fmt: skip
    motion = simulate(made)
    moved = (motion.positions - motion.positions[0]) @ turn[:, 0]
    assert np.ptp(moved, axis=1).max() < 1e-9  # a block: nothing stretches
    return -moved.mean(axis=1), motion.times


@pytest.mark.slow
@pytest.mark.parametrize(("method", "newton"), [("implicit", 12), ("bdf2", 1), ("symplectic", 1)])
def test_a_block_slides_down_a_slope(method, newton):
    angle, mu = 0.6, 0.4
    delta = 2e-4 if method == "symplectic" else 2e-3
    way, t = sliding(angle, mu, method, newton, steps=round(0.6 / delta), delta=delta)
    a = acceleration(way, t, len(way) // 4)
    # late enough to be much faster than ε and than μ h g
    assert a == pytest.approx(GRAVITY * (np.sin(angle) - mu * np.cos(angle)), rel=0.01)


def acceleration(way, t, span):
    """The mean over the last two times so many frames."""
    return (way[-1] - 2 * way[-1 - span] + way[-1 - 2 * span]) / t[span] ** 2


@pytest.mark.slow
@pytest.mark.parametrize(("method", "newton"), [("implicit", 12), ("bdf2", 1)])
def test_a_block_holds_up_to_the_coefficient_of_friction(method, newton):
    angle = 0.5
    held, t = sliding(angle, np.tan(angle) / 0.99, method, newton, 500)
    creep = (held[-1] - held[-100]) / (t[-1] - t[-100])
    assert creep == pytest.approx(law.STICTION_SPEED * 0.99 / np.sqrt(1 - 0.99**2), rel=0.01)
    gone, t = sliding(angle, np.tan(angle) / 1.01, method, newton, 900)
    # a difference of two forces a hundred times as large, of which v/q < 1 leaves out some
    assert acceleration(gone, t, 100) == pytest.approx(GRAVITY * np.sin(angle) * (1 - 1 / 1.01), rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "off"), [("implicit", 0.02), ("bdf2", 0.002)])  # of first and of second order
def test_friction_on_what_is_curved_is_that_of_the_weight(method, off):
    """A light vertex slides over a ball. It presses in by 1 µm, and steps leave the surface by a hundred times that:
    with friction by the depth it is slowed by 3 % of this, and by 121 %.
    """
    radius, mu, speed, begin, mass, times = 0.2, 0.3, 0.5, 0.09, 1e-4, np.arange(101) * 2e-3
    deep = mass * (GRAVITY * np.cos(begin) - speed**2 / radius) / 1000
    x = [((radius - deep) * np.sin(begin), (radius - deep) * np.cos(begin), 0)]
    velocity = [xyz(speed * np.array([np.cos(begin), -np.sin(begin), 0]))]

    def ends(friction):
        made = scene(
            thing(x, mass=mass, vertVel=velocity), integrationMethod=METHODS[method], delta=2e-3, tolerance=TIGHT,
            colliders=[{**physics.ball((0, 0, 0), radius), "thickness": 0, "friction": friction}],
            optimizationIterations=len(times),
        )  # fmt: skip
        end = simulate(made).positions[-1, 0]
        return np.arctan2(end[0], end[1])

    def rate(_, state, friction):
        angle, turn = state
        push = (GRAVITY * np.cos(angle) - radius * turn**2) * turn / np.hypot(turn, law.STICTION_SPEED / radius)
        return turn, (GRAVITY * np.sin(angle) - friction * push) / radius

    exact = [solve_ivp(rate, times[[0, -1]], (begin, speed / radius), args=(f,), rtol=1e-10).y[0, -1] for f in (0, mu)]
    assert ends(0.0) - ends(mu) == pytest.approx(exact[0] - exact[1], rel=off)


@pytest.mark.parametrize("method", ["implicit", "bdf2"])
def test_several_iterations_at_what_is_curved_keep_the_speed(method):
    """What a later iteration gains is a thousandth; a step that is halved for it loses half of its speed."""
    small = thing([(0.018, 0.1992, 0)], mass=1e-4, vertVel=[xyz((0.498, -0.045, 0))])
    made = scene(
        small, integrationMethod=METHODS[method], delta=0.01, forwardSubSteps=4, tolerance=TIGHT,
        colliders=[{**physics.ball((0, 0, 0), 0.2), "thickness": 0}], optimizationIterations=21,
    )  # fmt: skip
    motion = simulate(made)
    x = motion.positions[:, 0]
    square = 0.25 + 2 * GRAVITY * (x[0, 1] - x[-2:, 1].mean())
    assert ((x[-1] - x[-2]) ** 2).sum() / 0.01**2 == pytest.approx(square, rel=0.1)  # of first order at 10 ms
    assert motion.remedies.shortened_steps == 0


def test_gradient_of_steps_that_end_after_fewer_iterations():
    velocity = [xyz((0.498, -0.045, 0)), xyz((0.498, -0.045, 0.01))]
    made = scene(
        thing([(0.018, 0.1992, 0), (0.018, 0.1992, 0.02)], [(0, 1)], mass=1e-4, stiffness=0.01, vertVel=velocity,
              optimizationSettings="GG"),
        colliders=[{**physics.ball((0, 0, 0), 0.2), "thickness": 0}], integrationMethod=2, delta=0.01,
        forwardSubSteps=4, optimizationIterations=10, tolerance=1e-13, fit={"contact": True},
    )  # fmt: skip
    used = rollout(build(made, 0), 9, 1e-13)[0].used
    assert sorted(set(used)) == [1, 4]
    assert_derivatives(made, 1e-13, 1e-10, switches=True, step=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_what_lies_on_a_collider_that_moves_goes_with_it(method):
    path = {"posKeys": keys([0, 10], [(0, 0, 0), (3.0, 0, 0)]), "rotKeys": keys([0, 10], [(0, 0, 0), (0, 100, 0)])}
    ride = plane(friction=1.0, **path)
    small = 1e-4 if METHODS[method] < 2 else 2e-3
    made = scene(
        thing([(0.2, -1e-3, 0.1)]), colliders=[ride], planes="solid", integrationMethod=METHODS[method], delta=small,
        optimizationIterations=round(0.5 / small) + 1,
    )  # fmt: skip
    motion = simulate(made)
    t = motion.times[-1]
    assert np.allclose(build(made, 0).inputs.centre[:, 1], [0.3, 0, 0], atol=1e-12)
    turned = sampling.rotation(np.array([0, 10 * t, 0])).apply([0.2, 0, 0.1]) + [0.3 * t, 0, 0]
    # it catches up within 0.3 m/s / g, and then lags by less than ε
    np.testing.assert_allclose(motion.positions[-1, 0, [0, 2]], turned[[0, 2]], atol=0.3**2 / GRAVITY + 1e-3)
    w = (motion.positions[-1, 0] - motion.positions[-2, 0]) / made.delta
    spin = np.radians(10)
    x, z = motion.positions[-1, 0, 0] - 0.3 * t, motion.positions[-1, 0, 2]
    np.testing.assert_allclose(w[[0, 2]], [0.3 + spin * z, -spin * x], atol=law.STICTION_SPEED)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [2.0, 2.5])
def test_gradient_of_steps_that_begin_an_iteration_with_contacts_outside(speed):
    x, ends = [(-0.02, 0.3005, 0), (0, 0.302, 0.1), (0.05, 0.31, 0)], [(0, 1), (1, 2), (0, 2)]
    made = scene(
        {**thing(x, ends, mass=0.01, stiffness=5.0), "vertVel": [xyz((4, -speed, 0))] * 3},
        colliders=[capsule(friction=0.3, stiffness=300.0, thickness=0)], integrationMethod=2, forwardSubSteps=3,
        delta=0.02, optimizationIterations=4, tolerance=TIGHT, gravity=xyz((0, -9.81, 0)), fit={"gravity": True},
    )  # fmt: skip
    assert rollout(build(made, 0), 3, TIGHT)[0].active[2, 1].any()
    assert_derivatives(made, TIGHT, 1e-10)


# --- sizes that change


def shape(kind, lengths=(1, 1, 1), at=(0, 0, 0), **fields):
    """A collider of a type of the file."""
    return {**body(block()), "type": kind, "pos": xyz(at), "scale": xyz(lengths), **fields}


GROWS = keys([0, 0.04, 0.1], [(2, 2, 2), (2.6, 2.4, 2.2), (2.2, 3, 2.6)])
DROP = {"delta": 0.005, "optimizationIterations": 41, "tolerance": TIGHT}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "interpolation"),
    # a mesh that jumps throws the vertex off, and then meets it earlier in a step than a box does
    [(3, "linear"), (3, "smooth"), (3, "hold"), (4, "linear"), (4, "smooth")],
)
def test_a_vertex_on_a_box_that_grows_is_one_on_a_box_that_is_lifted(kind, interpolation):
    one = thing([(0.1, 0.5, 0.05)], mass=0.05, vertVel=[xyz((0, 0, 0))])
    grows = {**GROWS, "interpolation": interpolation}
    top = [0.5 * (value["y"] / 2 - 1) for value in GROWS["values"]]
    lifted = keys(GROWS["times"], [(0, y, 0) for y in top], interpolation=interpolation)
    wide = shape(3, (4, 1, 4), posKeys=lifted, stiffness=100)
    a = simulate(scene(one, colliders=[shape(kind, scaleKeys=grows, stiffness=100)], **DROP))
    b = simulate(scene(one, colliders=[wide], **DROP))
    assert np.ptp(a.positions[:, 0, 1]) > 0.05
    np.testing.assert_allclose(a.positions, b.positions, atol=1e-11)


@pytest.mark.slow
def test_a_ball_that_grows_is_an_ellipse_of_none_and_the_same_for_capsules_without_height():
    one = thing([(0.2, 0.5, 0.1)], mass=0.05)
    balls = [shape(1, scaleKeys=GROWS), shape(2, (1, 0.5, 1), scaleKeys=GROWS, friction=0.0)]
    a, b = (simulate(scene(one, colliders=[each], **DROP)) for each in balls)
    np.testing.assert_allclose(a.positions, b.positions, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", [2, 3])  # a ball moves its points along its normals
def test_its_surface_has_the_velocity_of_its_points(kind, method):
    # what is at p in the axes is at f p there: of a capsule in the radial directions by x, along its axis by y
    turned = {"rot": xyz((20, 30, 40)), "scaleKeys": GROWS, "thickness": 10.0, "friction": 0.3}
    one = thing([(0.4, 0.3, -0.2)])
    made = scene(one, colliders=[shape(kind, **turned)], integrationMethod=METHODS[method], **DROP)
    system, h = build(made, 0), made.delta
    which = {2: [0, 1, 0], 3: [0, 1, 2]}[kind]
    values = np.array([[value[axis] for axis in "xyz"] for value in GROWS["values"]])[:, which]
    axes = sampling.states(made.colliders, np.zeros(1), h, 0)[0, 0, collider_rows.AXES : collider_rows.SIZE]
    for t in (0, 5, 9, 15):
        set_inputs(system.inputs, system, t)
        begins, now, ends = (
            np.array([np.interp(h * (t + k), GROWS["times"], column) for column in values.T])
            for k in (0, system.inputs.lead, 1)
        )
        p = axes @ system.x0[0]
        expected = axes.T @ (p * (ends - begins) / (h * now))
        depth, normal = collider_rows.depths(system.colliders, system.x0)
        along, still = np.zeros((1, 3)), np.zeros((1, 3))
        contact.add_force(system.colliders, system.x0, expected[None], along)  # which does not slide
        contact.add_force(system.colliders, system.x0, np.zeros((1, 3)), still)
        np.testing.assert_allclose(along[0], 1000.0 * depth[0, 0] * normal[0, 0], rtol=1e-10, atol=1e-9)
        assert np.abs(still - along).max() > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", [1, 2, 3, 4])
def test_pictures_show_its_size(kind):
    made = scene(thing([(0.1, 0.6, 0)]), colliders=[shape(kind, (1, 0.8, 1), scaleKeys=GROWS)], **DROP)
    (found,) = solids(made, np.array([0.0, 0.04, 0.1]), made.cloths[0].positions[None])
    assert found.moves
    sizes = np.array([np.ptp(found.at(frame), axis=0) for frame in range(3)])
    along_x = np.array([1.0, 1.3, 1.1])
    np.testing.assert_allclose(sizes[:, 0], along_x * sizes[0, 0], rtol=1e-12)
    assert sizes[0, 0] == pytest.approx(1.0, rel=1e-2)


def test_a_smooth_scale_that_swings_below_0_is_refused_with_its_place(tmp_path):
    swing = keys([0, 0.02, 0.04, 0.06], [(5, 5, 5), (0.01, 0.01, 0.01), (0.01, 0.01, 0.01), (5, 5, 5)])
    (tmp_path / "zero.csv").write_text("0,1,1,1\n1,1,1,0\n")
    zero = {"file": str(tmp_path / "zero.csv")}
    for own, kind in (({**swing, "interpolation": "smooth"}, 3), ({**swing, "interpolation": "smooth"}, 4), (zero, 1)):
        made = scene(thing([(0, 0, 0)]), colliders=[shape(kind, scaleKeys=own)], delta=0.005)
        with pytest.raises(InvalidScene, match=r"colliders\[0\]\.scaleKeys.*: at .* s the scale is not above 0"):
            build(made, 0, steps=300)


def test_a_plane_has_no_size():
    made = scene(thing([(0, 0, 0)]), colliders=[shape(0, scaleKeys=GROWS)], planes="solid")
    assert made.warnings == ("colliders[0].scaleKeys: a plane has no size, so they change nothing",)
    assert not made.moves


# --- scenes


def test_steps_at_colliders_are_not_shortened():
    assert guard.applies(full(windVel=xyz((0, 0, 0))))
    assert not guard.applies(touching(SHAPES["box"], windVel=xyz((0, 0, 0))))


def test_planes_are_solid_only_where_the_scene_says_so():
    still = scene(thing([(0, 0, 0)]), colliders=[plane(), box()])
    assert [each.name for each in still.colliders] == ["box"]
    assert still.warnings[0].startswith("colliders[0]: planes are ignored, as in the editor; ")
    solid = scene(thing([(0, 0, 0)]), colliders=[plane(), box()], planes="solid")
    assert [each.name for each in solid.colliders] == ["plane", "box"]
    assert not solid.warnings


def test_a_sphere_with_a_field_of_its_own_is_the_same_sphere():
    own = {"delta": 0.002, "optimizationIterations": 150, "integrationMethod": 1}  # whose steps nothing shortens
    drop = thing([(0.05, 0.6, 0.1)], mass=0.5)
    plain, other = (simulate(scene(drop, colliders=[ball], **own)) for ball in (
        physics.ball((0, 0, 0), 0.5), {**physics.ball((0, 0, 0), 0.5), "friction": 0}))  # fmt: skip
    assert plain.positions[-1, 0, 2] > 0.15  # it has slid aside
    np.testing.assert_allclose(other.positions, plain.positions, atol=1e-12)


def test_sizes_are_those_of_unity_unless_they_are_given():
    made = scene(thing([(0, 0, 0)]), colliders=[
        {"type": 2, "pos": xyz((0, 0, 0)), "scale": xyz((0.4, 1.5, 9))}, box(lengths=(1, 2, 3)),
        {"type": 2, "pos": xyz((0, 0, 0)), "scale": xyz((0, 0, 0)), "radius": 0.2, "radius2": 0.1, "height": 2},
    ])  # fmt: skip
    sizes = [each.size for each in made.colliders]
    np.testing.assert_allclose(sizes, [[0.2, 0.2, 2.6], [0.5, 1.0, 1.5], [0.2, 0.1, 2.0]], rtol=1e-15)


BAD = [
    (box(lengths=(1, 0, 1)), "scale.y: 0 is too small; it must be above 0"),
    (box(scaleKeys=keys([0, 1], [(1, 1, 1), (0, 1, 1)])), "scaleKeys.values[1].x: 0 is too small; it must be"),
    ({**physics.ball((0, 0, 0), 1), "scaleKeys": keys([0], [(1, -2, 1)])}, "scaleKeys.values[0].y: -2 is too small"),
    (box(scaleKeys={"file": "a.glb", "joint": "arm"}), "scaleKeys: a joint has no scale; give times and values"),
    (body(block(), scaleKeys=keys([0], [(1, 1, 1)]), motion={"file": "walk.pc2"}),
     "scaleKeys: a mesh with a motion has its size from that"),
]  # fmt: skip


@pytest.mark.parametrize(("item", "said"), BAD)
def test_faults_are_named_with_their_place(item, said):
    found = problems(document(thing([(0, 0, 0)]), colliders=[item], planes="solid"))
    assert any(problem.startswith(f"colliders[0].{said}") for problem in found), found
