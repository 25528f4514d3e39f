"""Handles, wind, velocities and forces in a basis: derivatives, closed forms, playback, what cannot be moved."""

import io

import numpy as np
import pytest
from helpers.physics import scene, thing, xyz
from helpers.scenes import cloth

from clothfit import Costs, InvalidInput, Key, find_controls, simulate
from clothfit.control.controls import Controls, Handle, immovable, shapes_of, steered
from clothfit.control.shooting import Shooting
from clothfit.scene.scene import dumps, load

pytestmark = pytest.mark.slow  # compiles motions with inputs

NONE = xyz((0, 0, 0))
ALL = range(12)


def key(step, vertices, positions, **more):
    """A key of the first object."""
    return Key(step, 0, np.array(vertices, np.int32), np.array(positions, float), **more)


BALL = {"type": 2, "pos": xyz((1.5, -0.35, 1.0)), "scale": xyz((0.6, 0.6, 0.6)), "rot": NONE}


def handle(*vertices):
    """Vertices of the first object that move together."""
    return Handle(0, np.array(vertices, np.int32))


CASES = {
    "handles": Controls(handles=(handle(0), handle(8, 9)), every=0.01),
    "wind": Controls(wind=True, every=0.01),
    "velocity": Controls(velocity=True),
    "knots": Controls(forces=[np.isin(np.arange(12), [4, 5, 10])], every=0.01),
    "all": Controls(forces=[np.ones(12, bool)], handles=(handle(11),), wind=True, velocity=True, modes=5),
}


@pytest.mark.parametrize(
    ("method", "newton", "name"),
    [*(("implicit", 1, name) for name in CASES), ("implicit", 3, "all"), ("bdf2", 2, "all"), ("symplectic", 1, "few")],
)
def test_derivatives_along_all_controls(flag, method, newton, name):
    """J dz against central differences, its transpose and its whole matrix against it: bounds and velocities too."""
    own = flag(method, forwardSubSteps=newton, delta=0.005, tolerance=1e-14, colliders=[BALL])
    controls, rng = CASES.get(name, Controls(velocity=True, handles=(handle(11),))), np.random.default_rng(3)
    x, mean = own.cloths[0].positions, np.full(3, 1 / 3)
    keys = [key(4, [5, 7], x[[5, 7]] + 0.1, velocities=np.ones((2, 3))), key(8, [2, 6, 10], [[1, 0, 1]], share=mean)]
    problem = Shooting(steered(own, controls, 0.04), keys, controls, 8, Costs(smooth=0.02, most=1e-3, even=0.5))
    problem.gamma = 1e-3
    z, d = (0.1 * rng.normal(size=problem.size) for _ in range(2))
    shot = problem.shoot(z)
    along = problem.push(shot, d)
    step = 1e-5
    ahead, behind = (problem.residuals(problem.shoot(z + sign * step * d)) for sign in (1, -1))
    np.testing.assert_allclose((ahead - behind) / (2 * step), along, atol=1e-6 * np.abs(along).max())
    r = rng.normal(size=len(along))
    assert problem.pull(shot, r) @ d == pytest.approx(along @ r, rel=1e-9)
    problem.most = np.inf
    np.testing.assert_allclose(problem.matrix(shot) @ d, problem.push(shot, d), atol=1e-9 * np.abs(along).max())


def test_the_velocity_that_takes_a_free_vertex_somewhere():
    """Without forces x_N = N h v."""
    own = scene(thing([(0, 0, 0)], mass=0.5), delta=0.02, gravity=NONE, tolerance=1e-13)
    goal = np.array([[0.3, -0.1, 0.2]])
    found = find_controls(own, [key(30, [0], goal)], Controls(velocity=True))
    assert found.keys[0].rmse < 1e-3
    np.testing.assert_allclose(found.scene.cloths[0].velocity, goal / 0.6, rtol=3e-3)  # less what gentleness costs
    assert found.forces is None


def test_a_hard_key_by_forces_at_knots():
    """Linear in time, on one vertex: the bound of 1 µm is met by multipliers."""
    own = scene(thing([(0, 0, 0)], mass=0.5), delta=0.02, gravity=NONE, tolerance=1e-13)
    found = find_controls(own, [key(30, [0], [[0.3, -0.1, 0.2]], hard=True)], Controls(every=0.1))
    assert found.keys[0].rmse < 1e-6
    u = found.forces.values[:, 0]
    assert np.abs(np.diff(u, n=2, axis=0)[1:4]).max() < 1e-9 * np.abs(u).max()  # within the first interval


def test_a_handle_leads_a_chain_and_the_scene_plays_back():
    """A chain that is led by its end comes nearer than a tenth; the scene that is written moves alike, bit by bit."""
    row = [(i, 0, 0) for i in range(4)]
    own = scene(thing(row, [(0, 1), (1, 2), (2, 3)], mass=0.01, damping=0.5), delta=0.02, gravity=NONE)
    x = own.cloths[0].positions
    keys = [key(25, range(1, 4), x[1:] + [0.4, 0.0, 0.1])]
    found = find_controls(own, keys, Controls(handles=(handle(0),)))
    assert found.keys[0].rmse < 0.1 * found.free[0]
    assert found.optimality < 1e-2
    again = load(io.BytesIO(dumps(found.scene)))
    np.testing.assert_array_equal(simulate(again, 26).positions, found.motion.positions[:26])
    assert again.cloths[0].fixed[0]
    np.testing.assert_array_equal(again.cloths[0].pins[0].position.values[0], 0.0)  # it begins where it was


def test_wind_brings_a_cloth_nearer(flag):
    own = flag()
    other = simulate(steered(own, Controls(wind=True), 0.5).with_values(
        [own.cloths[0].mass], [own.cloths[0].stiffness], gusts=np.linspace(0, 4, 18).reshape(6, 3)), 26)
    keys = [key(step, ALL, other.positions[step]) for step in (12, 25)]
    found = find_controls(own, keys, Controls(wind=True))
    assert max(each.rmse for each in found.keys) < 0.05 * max(found.free)


def test_what_forces_cost(flag):
    """|R z|² is the mean of |u|², of changes within 0.02 s and differences over 0.5 m, relative to 3 m in 0.04 s."""
    own, rng = flag(delta=0.005), np.random.default_rng(5)
    cloth, acts = own.cloths[0], ~own.cloths[0].fixed
    costs = Costs(smooth=0.02, even=0.5)
    problem = Shooting(own, [key(8, [5], [[1, 0, 1]])], Controls(every=0.01), 8, costs)
    z = rng.normal(size=problem.size)
    u = problem.forces(z).values
    pairs = cloth.springs[acts[cloth.springs].all(axis=1)]
    length = np.linalg.norm(cloth.positions[pairs[:, 0]] - cloth.positions[pairs[:, 1]], axis=1)
    differences = (u[:, pairs[:, 0]] - u[:, pairs[:, 1]]) / length[:, None]
    total = (u**2).sum() + (np.diff(u, axis=0) ** 2).sum() * (0.02 / own.delta) ** 2 + 0.25 * (differences**2).sum()
    unit = cloth.mass.mean() * 3.0 / 0.04**2
    assert ((problem.gentle @ z) ** 2).sum() == pytest.approx(total / unit**2 / 8 / acts.sum(), rel=1e-6)


def test_what_no_control_can_move():
    """Of two separate chains only one has forces; a fixed vertex is where it is."""
    both = thing([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], [(0, 1), (2, 3)], mass=0.5)
    own = scene(both, delta=0.02, gravity=NONE)
    pushed = [np.isin(np.arange(4), [0])]
    keys = [key(5, range(4), own.cloths[0].positions + [0, 0, 0.1])]
    (stuck,) = immovable(own, keys, Controls(forces=pushed))
    np.testing.assert_array_equal(stuck, [False, False, True, True])
    found = find_controls(own, keys, Controls(forces=pushed, every=0.02))
    assert found.keys[0].immovable == 2


def test_modes_are_those_of_a_chain_in_tension():
    """Of n free equal masses on a chain held at one end: sin((2 j − 1) π i / (2 n + 1)) at mass i, the largest 1."""
    n = 9
    line = thing([(i, 0, 0) for i in range(n + 1)], [(i, i + 1) for i in range(n)], mass=0.1, fixed=[0])
    own = scene(line).cloths[0]
    shapes = shapes_of(own, ~own.fixed, 3)
    for j in (1, 2, 3):
        shape = np.sin((2 * j - 1) * np.pi * np.arange(n + 1) / (2 * n + 1))
        found = shapes[:, j - 1]
        np.testing.assert_allclose(found * np.sign(found[1]), shape / np.abs(shape).max(), atol=1e-9)
    with pytest.raises(InvalidInput, match="1000 are asked for"):
        shapes_of(own, ~own.fixed, 1000)


def test_handles_that_cannot_be():
    pins = [{"vertices": [0, 3], "rotKeys": {"times": [0, 1], "values": [NONE, xyz((0, 90, 0))]}}]
    held = cloth(pins=pins, vertIsFixed=[i in (0, 3) for i in ALL])
    own = scene(held)
    with pytest.raises(InvalidInput, match="has some of these vertices and others"):
        steered(own, Controls(handles=(handle(0),)), 1.0)
    with pytest.raises(InvalidInput, match="turns, or follows a motion"):
        steered(own, Controls(handles=(handle(0, 3),)), 1.0)


def test_two_objects_with_keys_and_one_without_controls_of_its_own():
    """The whole matrix against products, where the numbers of one object are not those of the other."""
    row = [(i, 0, 0) for i in range(3)]
    own = scene(*(thing(row, [(0, 1), (1, 2)], mass=0.01, damping=0.5) for _ in range(2)), delta=0.02, gravity=NONE)
    wanted = np.array(row) + [0.1, 0.2, 0.0]
    keys = [Key(step, cloth, np.arange(3, dtype=np.int32), wanted) for cloth, step in ((0, 4), (1, 6))]
    pushed = [np.array([False, False, True]), np.ones(3, bool)]
    for controls in (Controls(handles=(handle(0),), every=0.02), Controls(forces=pushed, every=0.04)):
        problem = Shooting(steered(own, controls, 0.12), keys, controls, 6, Costs())
        d = np.random.default_rng(1).normal(size=problem.size)
        for problem.horizon in (4, 6):  # up to the first key, and to the last
            shot = problem.shoot(0.1 * d)
            along = problem.push(shot, d)
            np.testing.assert_allclose(problem.matrix(shot) @ d, along, atol=1e-9 * np.abs(along).max())
    found = find_controls(own, keys, Controls(handles=(handle(0),)))
    assert found.keys[0].rmse < found.free[0]
    assert found.keys[1].rmse == found.free[1]


def test_a_cloth_of_handles_alone():
    own = scene(thing([(0, 0, 0)], mass=0.5), delta=0.02)
    found = find_controls(own, [key(20, [0], [[0.3, 0.1, 0.0]])], Controls(handles=(handle(0),)))
    assert found.keys[0].rmse < 1e-3


@pytest.mark.parametrize("controls", [Controls(velocity=True), Controls(every=0.02)])
def test_a_cloth_that_cannot_move_at_all(controls):
    held = thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], mass=0.5, fixed=(0, 1))
    with pytest.raises(InvalidInput, match="all of it is fixed"):
        find_controls(scene(held, delta=0.02), [key(5, [0, 1], np.zeros((2, 3)))], controls)
