"""Steps that would add energy: they are shortened, and only they; energies and derivatives of what was taken."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import GRAVITY, TIGHT, ball, cloth, gentle, relative, thing, xyz

from clothfit.derivative import adjoint
from clothfit.engine.forces import spheres, springs, total
from clothfit.engine.march import velocities, velocity
from clothfit.engine.rollout import rollout
from clothfit.engine.step import guard, implicit
from clothfit.engine.system import all_elements

pytestmark = pytest.mark.slow  # compiles a fit

STEPS = 60


def crushed(side=5, factor=5.0, **fields):
    """A cloth whose springs are at a fraction of their rest length, not quite flat, one side fixed."""
    x = np.array([(i, 0.0, j) for j in range(side) for i in range(side)]) / (side - 1)
    x += 1e-3 * np.random.default_rng(3).normal(size=x.shape)
    held = [i < side for i in range(side * side)]
    made = cloth(side, side, vertIsFixed=held, vertPos=[xyz(p) for p in x], vertMass=[0.01] * side**2)
    ends = np.reshape(made["springs"], (-1, 2))
    rest = factor * np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)
    return physics.system({**made, "springRestLength": rest.tolist(), "springStiffness": [50.0] * len(ends)}, **fields)


def turning(k=1e5, h=0.2, **fields):
    """A stiff pendulum that is let go level: tangents lead far from its circle."""
    bob = thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], mass=0.5, stiffness=k, fixed=[0])
    return physics.system(bob, delta=h, **fields)


HARD = {
    "crushed": crushed()._replace(h=0.05),
    "crushed, longer steps": crushed()._replace(h=0.1),
    "crushed, Newton": crushed(forwardSubSteps=2)._replace(h=0.2),
    "turning": turning(),
}


def energies(system, memory, good):
    """Kinetic and stored energy, and that of the weight, (good + 1,) each, J."""
    moving = [velocity(memory, t) for t in range(good + 1)]
    x = memory.x
    inner = [guard.moving(system.vertex, v)[0] + total.stored_energy(system, x[t], x[t]) for t, v in enumerate(moving)]
    m, g = system.vertex.mass, system.vertex.gravity
    return np.array(inner), -np.einsum("n,tnc,c->t", m, memory.x[: good + 1], g)


def test_the_energy_that_comes_with_the_step_is_the_same():
    system = physics.full()
    at = physics.state(system, "random")
    work = implicit.workspace(system)
    energy, power = implicit.prepare(system, at.y, at.u, work)
    stored = springs.energy(system.springs, at.y) + spheres.energy(system.spheres, at.y)
    assert energy == pytest.approx(stored + 0.5 * np.sum(system.vertex.mass[:, None] * at.u**2), rel=1e-13)  # sums
    assert power == pytest.approx(-GRAVITY * system.vertex.mass @ at.u[:, 1], rel=1e-12)
    np.testing.assert_allclose(guard.moving(system.vertex, at.u), (energy - stored, power), rtol=1e-12)


@pytest.mark.parametrize("name", HARD)
def test_energy_never_rises_where_the_step_of_the_format_lets_it(name):
    system = HARD[name]
    plain, safe = (rollout(each, STEPS, 1e-8) for each in (system._replace(guarded=False), system))
    before, weight = energies(system, *plain)
    assert np.max(np.diff(before + weight)) > 0.01 * before.max()  # where it does
    memory, good = safe
    assert good == STEPS
    assert (memory.theta < 1).any()
    inner, weight = energies(system, memory, good)
    rounding = 1e-13 * np.abs(weight).max()  # of the differences
    assert (np.diff(inner + weight) <= guard.SLACK * inner[:-1] + guard.LEAST_RISE + rounding).all()


@pytest.mark.parametrize("method", ["implicit", "symplectic"])
@pytest.mark.parametrize("newton", [1, 3])
def test_a_gentle_motion_is_that_of_the_format_to_the_last_bit(method, newton):
    for system in (gentle(method, newton), gentle(method, newton, windVel=xyz((0, 0, 0)))):
        (plain, _), (guarded, _) = (rollout(each, STEPS, TIGHT) for each in (system._replace(guarded=False), system))
        assert (guarded.theta == 1).all()
        np.testing.assert_array_equal(plain.x, guarded.x)


def test_a_shortened_step_is_a_part_of_the_step_of_the_format():
    system = HARD["turning"]
    memory, _ = rollout(system, STEPS, TIGHT)
    t = int(np.argmax(memory.theta < 1))
    whole = system._replace(guarded=False, x0=memory.x[t], v0=velocity(memory, t).copy())
    once, _ = rollout(whole, 1, TIGHT)
    theta = memory.theta[t]
    assert np.log2(theta) == np.round(np.log2(theta))
    # two solves from different first guesses
    np.testing.assert_allclose(velocities(memory, t)[0], once.w[0, 0], atol=1e-12)
    np.testing.assert_allclose(memory.w[t, 0], theta * once.w[0, 0], atol=1e-12)
    np.testing.assert_array_equal(memory.x[t + 1], memory.x[t] + system.h * memory.w[t, 0])
    v, before = 2 * theta * once.w[0, 0], energies(system, memory, t)[0][-1]
    longer = guard.fault(system, t, before, np.inf, once.x[0], v, once.x[0] + system.h * v)
    assert longer == guard.SPRINGS  # the next longer part would have added energy


def test_no_step_is_shortened_in_wind():
    windy = gentle(windVel=xyz((30.0, 0, 0)))
    assert not guard.applies(windy)
    assert guard.applies(gentle(windVel=xyz((0, 0, 0))))
    assert guard.applies(windy._replace(faces=windy.faces._replace(drag=0.0)))
    assert not guard.applies(gentle("symplectic", windVel=xyz((0, 0, 0))))


def test_a_contact_that_begins_with_a_step_is_left_as_the_format_has_it():
    drop = physics.system(thing([(0, 1, 0)], mass=0.5), colliders=[ball((0, 0, 0), 0.5)], delta=0.05)
    (memory, good), (plain, _) = (rollout(each, 12, TIGHT) for each in (drop, drop._replace(guarded=False)))
    inner, weight = energies(drop, memory, good)
    assert np.max(np.diff(inner + weight)) > 0.05  # J: it is in before it is felt
    np.testing.assert_array_equal(memory.x, plain.x)


def test_how_a_motion_is_cut_into_runs_changes_nothing(monkeypatch):
    whole, _ = rollout(HARD["crushed"], STEPS, 1e-6)
    assert (whole.theta < 1).any()
    monkeypatch.setattr("clothfit.engine.rollout.STRETCH", 25)  # one step of 25 vertices at a time
    cut, _ = rollout(HARD["crushed"], STEPS, 1e-6)
    for one, other in zip(whole[:6], cut[:6], strict=True):
        np.testing.assert_array_equal(one, other)


def until_shortened(system, newton):
    """A system that starts a step before its first shortened one, and a motion of some steps."""
    memory, _ = rollout(system, STEPS, TIGHT)
    t = max(0, int(np.argmax(memory.theta < 1)) - 1)
    start = system._replace(x0=memory.x[t].copy(), v0=velocity(memory, t).copy())
    again, good = rollout(start, 4, TIGHT)
    assert good == 4
    assert (again.theta < 1).any()
    return start, again


@pytest.mark.parametrize("name", HARD)
def test_the_derivatives_are_those_of_the_shortened_step(name):
    system, memory = until_shortened(HARD[name], 1)
    change, t = physics.direction(system), 1e-7
    # wind would end the guard
    change = change._replace(velocity=change.velocity * system.vertex.free[:, None], wind=0 * change.wind)
    forward = adjoint.tangent(system, memory, change, TIGHT)

    def moved(t):
        found, _ = rollout(physics.shifted(system, change, t), 4, TIGHT)
        np.testing.assert_array_equal(found.theta, memory.theta)  # no switch between the two points
        np.testing.assert_array_equal(found.clamped, memory.clamped)
        return found.x

    measured = (moved(t) - moved(-t)) / (2 * t)
    assert relative(forward, measured) < 1e-5  # truncation 1e-14 times third derivatives of a turn
    weight = np.random.default_rng(5).normal(size=memory.x.shape)
    weight[0] = 0.0
    gradient = adjoint.gradient(system, memory, weight, TIGHT, physics.KINDS)
    size = np.abs(weight * forward).sum()
    assert abs(np.vdot(weight, forward) - physics.product(gradient, change)) < 1e-10 * size
    assert set(all_elements(system)._fields) == set(gradient._fields)
