"""Steps whose contacts would add energy: they are taken anew with these contacts in their equations, and only they."""

from pathlib import Path

import numpy as np
import pytest
from helpers import physics
from helpers.costs import simulate_all
from helpers.physics import KINDS, TIGHT, ball, cloth, relative, thing, xyz

import clothfit
from clothfit.derivative import adjoint
from clothfit.derivative.columns import columns
from clothfit.derivative.sensitivity import sweep
from clothfit.engine.forces import spheres, vertex
from clothfit.engine.march import velocity
from clothfit.engine.rollout import rollout
from clothfit.engine.snapshots import Plan
from clothfit.engine.step import guard
from clothfit.engine.system import BDF2, IMPLICIT, build
from clothfit.engine.tape import Tape
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import parameters

pytestmark = pytest.mark.slow  # compiles a fit

EXAMPLES = Path(__file__).parents[2] / "examples"
METHODS = {"implicit": IMPLICIT, "bdf2": BDF2}
STEPS = 50


def falling(speed, mass=0.0014, stiffness=None, side=8, spacing=0.2, **fields):
    """A level cloth 10 cm over a sphere of 1 m that falls at this speed, m/s, with steps of 20 ms."""
    n = side * side
    x = np.array([(i, 0.0, j) for j in range(side) for i in range(side)]) * spacing
    x += np.array([-0.5, 0.0, -0.5]) * (side - 1) * spacing + [0.0, 0.6, 0.0]
    own = {"vertPos": [xyz(p) for p in x], "vertVel": [xyz((0, -speed, 0))] * n, "vertMass": [mass] * n}
    made = cloth(side, side, vertIsFixed=[False] * n, damping=0.0, dragCoefficient=0.0, **own)
    made["optimizationSettings"] = "LL"
    ends = np.reshape(made["springs"], (-1, 2))
    made["springRestLength"] = np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1).tolist()
    made["springStiffness"] = np.linspace(*(stiffness or (25, 185)), len(ends)).tolist()
    return physics.scene(made, colliders=[ball((0, 0, 0), 0.5)], **{"delta": 0.02, **fields})


FALLS = {
    "from 50 m": build(falling(31.3), 0),
    "light": build(falling(4.4), 0),
    "stiff": build(falling(10.0, mass=0.01, stiffness=(1e5, 1e5)), 0),
    "in Newton's iterations": build(falling(31.3, forwardSubSteps=3), 0),
}


def energies(system, memory):
    """Kinetic, stored and weight's energy together at each state, J."""
    weight = [vertex.energy(system.vertex, x) for x in memory.x]
    return np.array([guard.energy(system, x, velocity(memory, t)) for t, x in enumerate(memory.x)]) + weight


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
@pytest.mark.parametrize("name", FALLS)
def test_a_cloth_that_falls_on_a_sphere_has_never_more_energy_than_it_fell_with(name, method):
    system = FALLS[name]._replace(method=method)
    memory, good = rollout(system, STEPS, 1e-8)
    assert good == STEPS
    found, fell = energies(system, memory), guard.energy(system, system.x0, system.v0)
    assert found.max() - found[0] <= guard.CONTACT_SLACK * fell
    assert found[-1] < found[0] - 0.9 * fell  # the sphere stops it: what it fell with is gone


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_without_early_contacts_it_would_have(method):
    system = FALLS["from 50 m"]._replace(method=method, guarded=False)
    memory, good = rollout(system, STEPS, 1e-8)
    found = energies(system, memory)[: good + 1]
    assert found.max() > 10 * guard.energy(system, system.x0, system.v0)


def points(method, heights, speed, mass=0.1, **fields):
    """Points without springs above and beside a sphere of radius 0.5 m; the second falls freely."""
    where = [(0.9 * i, y, 0.0) for i, y in enumerate(heights)]
    made = thing(where, mass=mass, vertVel=[xyz((0, -speed, 0))] * len(where))
    return physics.system(made, colliders=[ball((0, 0, 0), 0.5)], delta=0.02)._replace(method=method)


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_only_what_meets_the_sphere_is_stopped(method):
    system = points(method, (0.6, 0.6), 30.0)
    memory, _ = rollout(system, 10, TIGHT)
    alone, _ = rollout(points(method, (50.0, 0.6), 30.0), 10, TIGHT)
    assert memory.early[0]
    assert (memory.theta == 1).all()
    np.testing.assert_allclose(memory.x[:2, 1], alone.x[:2, 1], rtol=1e-14)
    if method == IMPLICIT:  # the step after it is a BDF2 step in one, an Euler step in the other
        np.testing.assert_allclose(memory.x[:, 1], alone.x[:, 1], rtol=1e-14)
    assert (memory.x[1:, 0, 1] > 0.5 - 0.11).all()  # the depth of the first step is 0.101 m: see below
    assert (np.abs(memory.w[1:, 0, 0, 1]) < 0.4 * 30.0).all()  # pushed out of it by 5 J of the 45 J that it fell with


def test_the_early_contact_is_an_implicit_spring_from_the_surface_on():
    m, h, k, speed, gap = 0.1, 0.02, spheres.STIFFNESS, 30.0, 0.1
    memory, _ = rollout(points(IMPLICIT, (0.5 + gap,), speed), 1, TIGHT)
    assert memory.early[0]
    # m (w − v) = h (−m g + k d), d = −gap − h w: the depth after the step
    w = (-m * speed - h * m * physics.GRAVITY - h * k * gap) / (m + h * h * k)
    np.testing.assert_allclose(memory.w[0, 0, 0], (0.0, w, 0.0), rtol=1e-9, atol=1e-12)


def test_an_ordinary_contact_is_that_of_the_format_to_the_last_bit():
    given = build(clothfit.load(EXAMPLES / "drape.json"), 0)
    (memory, _), (plain, _) = (rollout(each, 30, 1e-5) for each in (given, given._replace(guarded=False)))
    assert (np.linalg.norm(memory.x[-1] - given.spheres.centre[0], axis=1) < given.spheres.radius[0]).any()
    np.testing.assert_array_equal(memory.x, plain.x)
    assert not memory.early.any()
    assert not rollout(given._replace(method=BDF2), 30, 1e-5)[0].early.any()


def test_which_contacts_begin():
    made = spheres.build([[0.0, 0.0, 0.0]], [1.0])
    y = np.array([[2.0, 0, 0], [2.0, 0, 0], [2.0, 0, 0], [2.0, 0.0, 0], [2.0, 0.9, 0], [2.0, 1.1, 0]])
    u = np.array([[-1.1, 0, 0], [-0.9, 0, 0], [1.1, 0, 0], [-9.0, 0, 0], [-9.0, 0, 0], [-9.0, 0, 0]])
    # also where the way leads through the sphere and out again
    assert [spheres.begins(made, y, u, 1.0, i, 0) for i in range(6)] == [True, False, False, True, True, False]


# Derivatives and recomputation ----------------------------------------------------------------------------------------


def small(method, newton=1):
    """A fall of few vertices whose early steps come soon, and go on."""
    return build(falling(12.0, side=4, spacing=0.15, forwardSubSteps=newton, integrationMethod=method), 0)


@pytest.mark.parametrize("newton", [1, 3])
@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_the_derivatives_are_those_of_the_steps_with_early_contacts(method, newton):
    system, steps = small(method, newton), 4
    memory, good = rollout(system, steps, TIGHT)
    assert good == steps
    assert memory.early.any()
    change = physics.direction(system)
    change = change._replace(wind=0 * change.wind)  # wind would end the guard
    forward = adjoint.tangent(system, memory, change, TIGHT)

    def moved(t):
        found, _ = rollout(physics.shifted(system, change, t), steps, TIGHT)
        for name in ("theta", "clamped", "early", "euler"):  # no switch between the points
            np.testing.assert_array_equal(getattr(found, name), getattr(memory, name))
        return found.x

    sizes = 2e-4 / 4.0 ** np.arange(5)
    rest = np.array([np.abs(moved(t) - memory.x - t * forward).max() for t in sizes])
    orders = np.log(rest[:-1] / rest[1:]) / np.log(4.0)
    assert orders[rest[1:] > 1e-12].min() > 1.9
    assert (rest[1:] > 1e-12).sum() >= 3
    measured = (moved(1e-7) - moved(-1e-7)) / 2e-7
    assert relative(forward, measured) < 1e-6  # rounding 1e-16/1e-7, truncation below
    weight = np.random.default_rng(5).normal(size=memory.x.shape)
    weight[0] = 0.0
    gradient = adjoint.gradient(system, memory, weight, TIGHT, KINDS)
    size = np.abs(weight * forward).sum()
    assert abs(np.vdot(weight, forward) - physics.product(gradient, change)) < 1e-10 * size


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_every_column_of_the_sensitivity_is_a_tangent(method):
    made = falling(12.0, side=4, spacing=0.15, integrationMethod=method, optimizationIterations=6)
    objective, p = Objective(made, simulate(made), TIGHT), parameters(made)
    system, memory = simulate_all(objective, objective.runs[0], p)
    assert memory.early.any()
    every = columns(system, objective.blocks, p, np.arange(len(p), dtype=np.int32), np.ones(len(p)), len(p))
    found = np.array([step.copy() for step in sweep(system, memory, every)])
    for q in range(0, len(p), 7):
        (change,) = objective.tangent(p, np.eye(len(p))[q])
        # linear systems are solved to 1e-14, of a condition below 1000, a few in a row
        np.testing.assert_allclose(found[:, :, q], change[1:].reshape(len(found), -1), atol=1e-10 * np.abs(found).max())


@pytest.mark.parametrize("chosen", [Plan(1, (1,), STEPS), Plan(4, (4,), 8), Plan(2, (6, 2), 9)], ids=str)
@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_steps_that_are_computed_again_are_the_same_to_the_last_bit(method, chosen):
    system, steps = small(method), 30
    memory, good = rollout(system, steps, TIGHT)
    assert good == steps
    assert memory.early.any()
    weight = np.random.default_rng(6).normal(size=memory.x.shape)
    tape = Tape(system, steps, TIGHT, chosen)
    for part in tape.forward():
        end = part.first + part.steps
        np.testing.assert_array_equal(part.x, memory.x[part.first : end + 1])
        np.testing.assert_array_equal(part.budget, memory.budget[part.first : end + 1])
    assert tape.fallbacks.early_contacts == memory.early.sum()
    one, other = (adjoint.gradient(system, each, weight, TIGHT, KINDS) for each in (memory, tape))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def test_how_a_motion_is_cut_into_runs_changes_nothing(monkeypatch):
    for method in METHODS.values():
        system = small(method)
        whole, _ = rollout(system, 30, 1e-8)
        with monkeypatch.context() as patched:
            patched.setattr("clothfit.engine.rollout.STRETCH", 1)  # one step at a time
            cut, _ = rollout(system, 30, 1e-8)
        assert whole.early.any()
        for one, other in zip(whole[:9], cut[:9], strict=True):
            np.testing.assert_array_equal(one, other)
