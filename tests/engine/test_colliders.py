"""Colliders with friction: their surfaces and forces against formulas and differences, motions against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import physics
from helpers.derivatives import assert_derivatives
from helpers.obstacles import SHAPES, box, capsule, plane, ring, touching, with_room
from helpers.physics import GRAVITY, METHODS, STATES, VARIANTS, full, keys, relative, scene, sheet, state, thing, xyz
from helpers.scenes import document, problems
from helpers.surfaces import block, body

from clothfit.engine.forces import colliders, touch
from clothfit.engine.inputs import sampling
from clothfit.engine.step import guard
from clothfit.engine.system import build
from clothfit.motion.energy import energies
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective

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
    turn, place = made.state[0, touch.AXES : touch.SIZE], made.state[0, touch.PLACE]
    depth, normal = touch.depths(made, points @ turn + place)
    # samples of the axis 5 µm apart miss the minimum by their square
    np.testing.assert_allclose(made.thickness[0] - depth[0], reference(name, points), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(normal[0], axis=1), 1.0, atol=1e-14)


@pytest.mark.parametrize("name", [*SHAPES, "mesh"])
def test_normals_are_the_gradients_of_the_distances(name, wobble):
    made = with_room(touching(SHAPES.get(name) or ring(wobble)).colliders, 200)
    y, t = made.state[0, 0] + np.random.default_rng(2).uniform(-1.2, 1.2, (200, 3)), 1e-6
    both = [[touch.depths(made, y + side * t * e)[0][0] for side in (-1, 1)] for e in np.eye(3)]
    rows = [(before - after) / (2 * t) for before, after in both]
    # rounding at 1e-6, and curvatures that jump where two parts of a surface meet, within 1e-6 of a point
    np.testing.assert_allclose(np.transpose(rows), touch.depths(made, y)[1][0], atol=1e-5)


def test_a_cone_whose_one_end_holds_the_other_is_a_ball():
    made = full(colliders=[capsule(radius=0.2, radius2=0.5, height=0.25)]).colliders
    y = np.random.default_rng(3).normal(size=(50, 3))
    ball = np.linalg.norm(y - [0, 0.125, 0], axis=1) - 0.5
    np.testing.assert_allclose(-touch.depths(made, y)[0][0], ball, atol=1e-14)


# --- the force


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("at", STATES)
def test_force_matrix_and_right_hand_side(name, at):
    system = touching(SHAPES[name])
    made, point = system.colliders, state(system, at)
    depth, normal = (found[0] for found in touch.depths(made, point.y))
    d, n = np.maximum(depth, 0.0)[:, None], normal
    assert (d > 0).any()
    V = made.state[0, 1] + np.cross(made.state[0, 2], point.y - made.state[0, 0])

    def across(v):
        return v - n * (n * v).sum(axis=1, keepdims=True)

    slip = across(point.u - V)
    gamma = 0.6 * 700 * d / np.sqrt((slip * slip).sum(axis=1, keepdims=True) + touch.CREEP**2)
    f = 700 * d * n - gamma * slip
    assert relative(physics.total_force(colliders, made, point.y, point.u), f) < 1e-13
    A, b = physics.step_terms(system, colliders, made, point.y, point.u)
    h, inside = system.h, d > 0
    push = 700 * inside * n * (n * point.dy).sum(axis=1, keepdims=True)
    assert relative(physics.times(A, point.dy), h * h * push + h * gamma * across(point.dy)) < 1e-13
    assert relative(b, h * (f + gamma * across(point.u))) < 1e-12
    assert relative(physics.damping(colliders, made, point.y, point.u, point.dy), -gamma * across(point.dy)) < 1e-13
    later = physics.step_terms(system, colliders, made, point.y, point.u, ahead=True)[1]
    outward = 700 * inside * n * (n * point.u).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(later - b, h * h * outward, atol=1e-11)  # differences of numbers of some 10
    power = colliders.damping_power(made, point.y, point.u, point.w)
    assert power == pytest.approx(-(gamma * slip * point.w).sum(), rel=1e-12)
    assert colliders.energy(made, point.y) == pytest.approx(350 * (d * d).sum(), rel=1e-13)


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
    assert creep == pytest.approx(touch.CREEP * 0.99 / np.sqrt(1 - 0.99**2), rel=0.01)
    gone, t = sliding(angle, np.tan(angle) / 1.01, method, newton, 900)
    # a difference of two forces a hundred times as large, of which v/q < 1 leaves out some
    assert acceleration(gone, t, 100) == pytest.approx(GRAVITY * np.sin(angle) * (1 - 1 / 1.01), rel=0.03)


@pytest.mark.slow
def test_a_chain_over_a_capsule_obeys_the_capstan_law():
    radius, mu, n, hang = 0.1, 0.4, 40, 10
    arc = np.pi * (np.arange(n + 1) / n)
    over = radius * np.stack([-np.cos(arc), np.sin(arc)], axis=1)
    seg = np.linalg.norm(over[1] - over[0])
    below = seg * np.arange(hang, 0, -1)
    sides = [np.stack([np.full(hang, side * radius), -down], 1) for side, down in ((-1, below), (1, below[::-1]))]
    x = np.concatenate([sides[0], over, sides[1]])
    last = len(x) - 1
    ends = [(i, i + 1) for i in range(last)]
    pull = [{"vertices": [last], "posKeys": keys([0, 1], [(0, 0, 0), (0, -0.1, 0)])}]
    rope = thing(
        np.column_stack([x, np.zeros(len(x))]), ends, mass=[0.1] + [1e-5] * last, stiffness=1e4, fixed=[last], pins=pull
    )  # fmt: skip
    bar = capsule(radius=radius, radius2=radius, height=1.0, rot=xyz((90, 0, 0)), friction=mu)
    made = scene(rope, colliders=[bar], delta=2e-3, optimizationIterations=401, integrationMethod=2, tolerance=1e-10)
    motion = simulate(made)
    steps = np.diff(motion.positions[200:], axis=1)  # the weight rises evenly by then
    tension = 1e4 * (np.linalg.norm(steps, axis=2) - made.cloths[0].lengths)
    # the contact ends within one segment of 0.08 rad on each side, averaged over the passing of five
    assert tension[:, -1].mean() / tension[:, 0].mean() == pytest.approx(np.exp(mu * np.pi), rel=0.03)


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
    np.testing.assert_allclose(w[[0, 2]], [0.3 + spin * z, -spin * x], atol=touch.CREEP)


def thrown(settings="LL", **fields):
    """A sheet with velocities, held at a corner."""
    one = sheet(settings, vertIsFixed=[i == 0 for i in range(9)], **fields)
    return {**one, "vertVel": [xyz((1.0 + 0.1 * i, -0.5, -0.6)) for i in range(9)]}


def still_cloth():
    """The same, of which nothing is fitted."""
    return scene(thrown("nn")).cloths[0]


def rich(method="implicit", newton=1):
    """A cloth on colliders of each shape, some of which move."""
    one = thrown(fit={"damping": "G", "dragCoefficient": "G", "vertVel": "L", "springRestLength": "L"})
    return scene(
        one, integrationMethod=METHODS[method], forwardSubSteps=newton, delta=0.005, optimizationIterations=5,
        colliders=[SHAPES["plane"], physics.ball((1.0, -0.74, 1.0), 0.8), SHAPES["capsule"], SHAPES["box"]],
        planes="solid", tolerance=TIGHT, windVel=xyz((4, -2, -3)),
        fit={"windVel": True, "gravity": True, "friction": "L", "contact": "L", "colliderOffset": "G"},
        colliderOffset=xyz((1e-3, -2e-3, 1e-3)),  # small: steps as long as it is do not change contacts
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_gradient_tangent_and_columns(method, newton):
    made = rich(method, newton)
    # the longest steps along the contacts' stiffness switch one of them
    made = replace(made, fits={name: mode for name, mode in made.fits.items() if name != "contact"})
    # systems are solved to 1e-13, and friction makes their condition about 1e4
    assert_derivatives(made, TIGHT, 1e-10)


@pytest.mark.slow
def test_without_friction_its_gradient_is_the_limit_from_above():
    made = replace(rich("bdf2"), fits={"friction": "L"}, cloths=(still_cloth(),))
    smooth = made.with_values([made.cloths[0].mass], [made.cloths[0].stiffness], friction=np.zeros(3))
    objective, t = Objective(smooth, simulate(made), TIGHT), 1e-6
    gradient = objective.cost_and_gradient(np.zeros(3))[1]
    # a one-sided difference of second order
    start = objective.cost(np.zeros(3))
    far = [(4 * objective.cost(t * e) - objective.cost(2 * t * e) - 3 * start) / (2 * t) for e in np.eye(3)]
    assert np.all(gradient != 0)
    np.testing.assert_allclose(gradient, far, rtol=1e-5)


@pytest.mark.slow
def test_friction_is_what_the_account_of_energy_says_it_takes():
    angle, mu = 0.6, 0.4
    made = scene(
        thing([(0, 0, 0)], mass=0.2), colliders=[plane(angles=(0, 0, np.degrees(angle)), friction=mu)], planes="solid",
        delta=1e-3, integrationMethod=3, optimizationIterations=401, tolerance=TIGHT,
    )  # fmt: skip
    motion = simulate(made)
    found = energies(made, motion)
    way = np.linalg.norm(motion.positions[-1] - motion.positions[0])
    # but for the start, when the vertex sinks in by 2 mm and jumps
    assert found.damping[-1] == pytest.approx(mu * 0.2 * GRAVITY * np.cos(angle) * way, rel=0.02)
    assert abs(found.numerical[-1]) < 0.02 * found.damping[-1]


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
    (capsule(radius=0), "radius: 0 is too small; it must be above 0"),
    (capsule(height=-1), "height: -1 is too small; it must be at least 0"),
    (box(friction=-0.1), "friction: -0.1 is too small; it must be at least 0"),
    (box(stiffness=0), "stiffness: 0 is too small; it must be above 0"),
    (plane(thickness=-1), "thickness: -1 is too small; it must be at least 0"),
    (box(lengths=(1, 0, 1)), "scale.y: 0 is too small; it must be above 0"),
    (box(rotKeys=keys([1, 0], [(0, 0, 0)] * 2)), "rotKeys.times[1]: 0 s is not later than 1 s"),
    ({**box(), "type": 5}, "type: 5 is not one of 0, 1, 2, 3, 4"),
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


@pytest.mark.parametrize(("field", "value", "least"), [
    ("thickness", 0, "above 0"), ("stiffness", -1, "above 0"), ("friction", -0.5, "at least 0"),
])  # fmt: skip
def test_faults_of_self_contact_are_named_with_their_place(field, value, least):
    said = [f"selfCollision.{field}: {value} is too small; it must be {least}"]
    assert problems(document(selfCollision={field: value})) == said
