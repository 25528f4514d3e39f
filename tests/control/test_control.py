"""The least forces: closed forms, gradients, bits of the playback, and what cannot be reached."""

import numpy as np
import pytest
from helpers.physics import chain, scene, thing, xyz

from clothfit import Forces, InvalidInput, Key, find_forces, simulate
from clothfit.control import closed_loop
from clothfit.control.closed_loop import ClosedLoop, Costs, Task

pytestmark = pytest.mark.slow  # compiles motions with inputs

NONE = xyz((0, 0, 0))


def lonely(**fields):
    """One free vertex of 0.5 kg, without weight."""
    return scene(thing([(0, 0, 0)], mass=0.5), delta=0.02, gravity=NONE, tolerance=1e-13, **fields)


def at(step, vertices, positions, **more):
    """A key of the first object."""
    return Key(step, 0, np.array(vertices, np.int32), np.array(positions, float), **more)


def test_the_least_effort_of_a_free_vertex():
    """x_N = h²/m Σ (N − j) u_j: the least Σ |u|² h that gives x_N = d has u_j in proportion to N − j."""
    own, steps, d = lonely(), 30, np.array([0.3, -0.1, 0.2])
    found = find_forces(own, [at(steps, [0], [d])])
    weight = steps - np.arange(steps)
    u = 0.5 / own.delta**2 * weight[:, None] * d / (weight**2).sum()
    np.testing.assert_allclose(found.forces.values[:, 0], u, atol=2e-3 * np.abs(u).max())  # where the descent ends
    assert found.effort == pytest.approx(own.delta * (u**2).sum(), rel=1e-3)
    assert found.keys[0].rmse < 1e-5
    assert found.free[0] == pytest.approx(np.linalg.norm(d), rel=1e-12)


def test_at_rest_at_the_key():
    own = lonely()
    found = find_forces(own, [at(30, [0], [[0.3, 0, 0]], velocities=np.zeros((1, 3)))])
    x = found.motion.positions[:, 0, 0]
    assert abs(x[30] - 0.3) < 1e-5
    assert abs(x[30] - x[29]) < 1e-5


@pytest.mark.parametrize("method", ["implicit", "bdf2", "symplectic"])
def test_playback_gives_the_same_bits(flag, method):
    own = flag(method, optimizationIterations=13, delta=0.02 if method != "symplectic" else 0.005)
    x = own.cloths[0].positions
    keys = [at(5, range(12), x + [0, 0.1, 0.05] * (~own.cloths[0].fixed)[:, None]), at(10, range(12), x, hard=True)]
    found = find_forces(own, keys)
    assert all(key.rmse < 1e-3 for key in found.keys)
    assert found.keys[1].rmse < (1e-6 if method != "symplectic" else 2e-5)  # of penalties multipliers leave more
    again = simulate(own.with_forces(Forces(found.forces.times, found.forces.values)))
    np.testing.assert_array_equal(again.positions, found.motion.positions)
    assert not found.forces.values[:, own.cloths[0].fixed].any()


def test_a_disturbed_cloth_arrives_by_the_feedback(flag):
    own = flag(optimizationIterations=25)
    x = own.cloths[0].positions
    found = find_forces(own, [at(20, range(12), x)], budget=20.0)
    other = own.with_values([own.cloths[0].mass], [1.05 * own.cloths[0].stiffness])
    back = Forces(found.forces.times, found.forces.values, found.forces.gain, found.forces.places, pulls=True)
    missed = [
        np.linalg.norm(simulate(other.with_forces(each)).positions[20] - x) for each in (found.forces, back)
    ]
    assert missed[1] < 0.2 * missed[0]


def test_the_mean_of_vertices_and_few_forces():
    """Forces on two vertices of a chain bring the centre of mass to a place."""
    own = scene(chain(4, "nn", damping=0.2), delta=0.02, gravity=NONE, tolerance=1e-12)
    mass = own.cloths[0].mass
    goal = np.array([[2.0, 0.3, -0.2]])
    pushed = [np.isin(np.arange(4), [0, 3])]
    found = find_forces(own, [at(25, range(4), goal, share=mass / mass.sum())], pushed, budget=20.0)
    assert found.keys[0].rmse < 1e-3 * found.free[0]
    assert not found.forces.values[:, 1:3].any()


def test_no_force_is_above_its_bound():
    keys = [at(15, [0], [[0.075, 0, 0]])]
    found = find_forces(lonely(), keys, costs=Costs(most=1.0))
    sizes = np.linalg.norm(found.forces.values[:, 0], axis=1)
    assert sizes.max() <= 1.0 + 1e-12
    assert found.at_bound > 3  # without a bound the first is 1.13 N
    assert found.keys[0].rmse < 1e-3  # 1 N over 0.3 s can reach 0.09 m
    assert find_forces(lonely(), keys, costs=Costs(most=0.1)).keys[0].rmse > 0.05  # 0.1 N cannot


@pytest.mark.parametrize(("method", "newton"), [("implicit", 1), ("implicit", 3), ("bdf2", 1), ("explicit", 1)])
@pytest.mark.parametrize("costs", [Costs(), Costs(smooth=0.1, most=0.2, even=0.5)])
def test_the_gradient_of_all_costs(flag, method, newton, costs, monkeypatch):
    """Against central differences, with springs, penalties and multipliers."""
    monkeypatch.setattr(closed_loop, "SOLVE_TOLERANCE", 1e-14)
    own = flag(method, delta=0.005, forwardSubSteps=newton)
    rng, held = np.random.default_rng(4), own.cloths[0].fixed
    pushed = ~held & np.isin(np.arange(12), [1, 5, 6, 9])
    x = own.cloths[0].positions
    keys = [at(4, [5, 7], x[[5, 7]] + 0.1), at(8, [2, 6, 8], [x[[2, 6, 8]].mean(axis=0)], share=np.full(3, 1 / 3))]
    loop = ClosedLoop(Task(own, 0, keys, pushed, costs), np.tile(x, (9, 1, 1)), 20.0)
    loop.penalty = 3.0
    f, d = (rng.normal(size=(8, 12, 3)) * loop.unknown[:, :, None] for _ in range(2))
    loop(f)
    loop.insist()
    _, gradient = loop(f)
    step = 1e-3  # what the stiff springs of a key round is 1e-9 N: smaller steps show that
    difference = (loop(f + step * d)[0] - loop(f - step * d)[0]) / (2.0 * step)
    assert abs((gradient * d).sum() / difference - 1.0) < 1e-6


def test_a_fixed_vertex_cannot_be_elsewhere(flag):
    own = flag()
    with pytest.raises(InvalidInput, match=r"vertex 0 of objects\[0\] is fixed, and asked to be 1 m from where it is"):
        find_forces(own, [at(5, [0], own.cloths[0].positions[[0]] + [1, 0, 0], hard=True)])


def test_nothing_is_done_where_control_would_only_harm():
    """A force that must hardly change cannot follow keys to and fro: none leaves the chain nearer to them."""
    own = scene(chain(3, "nn"), delta=0.02, gravity=NONE)
    x = own.cloths[0].positions
    keys = [at(step, [2], x[[2]] + [0, 0, 0.01 * (-1) ** step]) for step in range(2, 12, 2)]
    keys += [at(step, [2], x[[2]] - [0, 0, 0.01]) for step in range(3, 13, 2)]
    found = find_forces(own, keys, [np.isin(np.arange(3), [0])], costs=Costs(smooth=1e3))
    total = [sum(miss**2 for miss in each) for each in ([key.rmse for key in found.keys], found.free)]
    assert total[0] <= total[1]
