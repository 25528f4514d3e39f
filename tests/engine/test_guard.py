"""Steps that would add energy: shortened, or taken anew with the contacts that begin in them in their equations, and
only they; energies and derivatives of what was taken.
"""

from functools import partial

import numpy as np
import pytest
from helpers import physics
from helpers.derivatives import assert_dense_sensitivity
from helpers.hard import crushed, energies, fallen, falling, turning
from helpers.paths import EXAMPLES
from helpers.physics import GRAVITY, KINDS, TIGHT, ball, gentle, relative, thing, xyz

import clothfit
from clothfit.derivative import adjoint
from clothfit.engine.forces import spheres, springs, vertex
from clothfit.engine.rollout import rollout
from clothfit.engine.step import guard, implicit
from clothfit.engine.step.states import velocities, velocity
from clothfit.engine.system import BDF2, IMPLICIT, build

pytestmark = pytest.mark.slow  # compiles a fit

STEPS = 50
HARD = {
    "crushed": crushed(delta=0.05),
    "crushed, longer steps": crushed(delta=0.1),
    "crushed, Newton": crushed(forwardSubSteps=2, delta=0.2),
    "turning": turning(),
}
FALLS = {
    "from 50 m": build(falling(31.3), 0),
    "light": build(falling(4.4), 0),
    "stiff": build(falling(10.0, mass=0.01, stiffness=(1e5, 1e5)), 0),
    "in Newton's iterations": build(falling(31.3, forwardSubSteps=3), 0),
}
BOTH = pytest.mark.parametrize("method", [IMPLICIT, BDF2], ids=["implicit", "bdf2"])


def test_the_energy_that_comes_with_the_step_is_the_same():
    system = physics.full()
    at = physics.state(system, "random")
    energy, power = implicit.prepare(system, at.y, at.u, implicit.workspace(system))
    stored = springs.energy(system.springs, at.y) + spheres.energy(system.spheres, at.y)
    assert energy == pytest.approx(stored + 0.5 * np.sum(system.vertex.mass[:, None] * at.u**2), rel=1e-13)  # sums
    assert power == pytest.approx(-GRAVITY * system.vertex.mass @ at.u[:, 1], rel=1e-12)
    assert guard.energy(system, at.y, at.u) == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(guard.moving(system.vertex, at.u), (energy - stored, power), rtol=1e-12)
    weight = -system.vertex.mass @ at.y @ system.vertex.gravity
    assert vertex.energy(system.vertex, at.y) == pytest.approx(weight, rel=1e-12)


# --- shortened steps


@pytest.mark.parametrize("name", HARD)
def test_energy_never_rises_where_the_step_of_the_format_lets_it(name):
    system = HARD[name]
    plain, memory = (rollout(each, STEPS, 1e-8)[0] for each in (system._replace(guarded=False), system))
    before = sum(energies(system, plain))
    assert np.max(np.diff(before)) > 0.01 * before.max()  # where it does
    assert (memory.theta < 1).any()
    inner, weight = energies(system, memory)
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
    (once, _), theta = rollout(whole, 1, TIGHT), memory.theta[t]
    assert np.log2(theta) == np.round(np.log2(theta))
    # two solves from different first guesses
    np.testing.assert_allclose(velocities(memory, t)[0], once.w[0, 0], atol=1e-12)
    np.testing.assert_allclose(memory.w[t, 0], theta * once.w[0, 0], atol=1e-12)
    np.testing.assert_array_equal(memory.x[t + 1], memory.x[t] + system.h * memory.w[t, 0])
    v, before = 2 * theta * once.w[0, 0], energies(system, memory)[0][t]
    longer = guard.fault(system, t, before, np.inf, once.x[0], v, once.x[0] + system.h * v)
    assert longer == guard.SPRINGS  # the next longer part would have added energy


def test_no_step_is_shortened_in_wind():
    windy = gentle(windVel=xyz((30.0, 0, 0)))
    assert not guard.applies(windy)
    assert guard.applies(gentle(windVel=xyz((0, 0, 0))))
    assert guard.applies(windy._replace(faces=windy.faces._replace(drag=np.zeros(1))))
    assert not guard.applies(gentle("symplectic", windVel=xyz((0, 0, 0))))


def test_a_contact_that_begins_with_a_step_is_left_as_the_format_has_it():
    drop = physics.system(thing([(0, 1, 0)], mass=0.5), colliders=[ball((0, 0, 0), 0.5)], delta=0.05)
    (memory, _), (plain, _) = (rollout(each, 12, TIGHT) for each in (drop, drop._replace(guarded=False)))
    assert np.max(np.diff(sum(energies(drop, memory)))) > 0.05  # J: it is in before it is felt
    np.testing.assert_array_equal(memory.x, plain.x)


# --- contacts that begin in a step


@BOTH
@pytest.mark.parametrize("name", FALLS)
def test_a_cloth_that_falls_on_a_sphere_has_never_more_energy_than_it_fell_with(name, method):
    system = FALLS[name]._replace(method=method)
    memory, good = rollout(system, STEPS, 1e-8)
    assert good == STEPS
    found, fell = sum(energies(system, memory)), guard.energy(system, system.x0, system.v0)
    assert found.max() - found[0] <= guard.CONTACT_SLACK * fell
    assert found[-1] < found[0] - 0.9 * fell  # the sphere stops it: what it fell with is gone
    if name == "from 50 m":  # without early contacts it would have
        free, good = rollout(system._replace(guarded=False), STEPS, 1e-8)
        assert sum(energies(system, free.part(0, good))).max() > 10 * fell


def points(method, heights, speed, mass=0.1):
    """Points without springs above and beside a sphere of radius 0.5 m; the second falls freely."""
    where = [(0.9 * i, y, 0.0) for i, y in enumerate(heights)]
    made = thing(where, mass=mass, vertVel=[xyz((0, -speed, 0))] * len(where))
    return physics.system(made, colliders=[ball((0, 0, 0), 0.5)], delta=0.02)._replace(method=method)


@BOTH
def test_only_what_meets_the_sphere_is_stopped(method):
    memory, alone = (rollout(points(method, (y, 0.6), 30.0), 10, TIGHT)[0] for y in (0.6, 50.0))
    assert memory.predicted[0]
    assert (memory.theta == 1).all()
    np.testing.assert_allclose(memory.x[:2, 1], alone.x[:2, 1], rtol=1e-14)
    if method == IMPLICIT:  # the step after it is a BDF2 step in one, an Euler step in the other
        np.testing.assert_allclose(memory.x[:, 1], alone.x[:, 1], rtol=1e-14)
    assert (memory.x[1:, 0, 1] > 0.5 - 0.11).all()  # the depth of the first step is 0.101 m: see below
    assert (np.abs(memory.w[1:, 0, 0, 1]) < 0.4 * 30.0).all()  # pushed out of it by 5 J of the 45 J that it fell with


def test_the_early_contact_is_an_implicit_spring_from_the_surface_on():
    m, h, k, speed, gap = 0.1, 0.02, spheres.STIFFNESS, 30.0, 0.1
    memory, _ = rollout(points(IMPLICIT, (0.5 + gap,), speed), 1, TIGHT)
    assert memory.predicted[0]
    # m (w − v) = h (−m g + k d), d = −gap − h w: the depth after the step
    w = (-m * speed - h * m * GRAVITY - h * k * gap) / (m + h * h * k)
    np.testing.assert_allclose(memory.w[0, 0, 0], (0.0, w, 0.0), rtol=1e-9, atol=1e-12)


def test_an_ordinary_contact_is_that_of_the_format_to_the_last_bit():
    given = build(clothfit.load(EXAMPLES / "drape.json"), 0)
    (memory, _), (plain, _) = (rollout(each, 30, 1e-5) for each in (given, given._replace(guarded=False)))
    assert (np.linalg.norm(memory.x[-1] - given.spheres.centre[0], axis=1) < given.spheres.radius[0]).any()
    np.testing.assert_array_equal(memory.x, plain.x)
    assert not memory.predicted.any()
    assert not rollout(given._replace(method=BDF2), 30, 1e-5)[0].predicted.any()


# --- derivatives


def until_shortened(system):
    """A system that starts a step before its first shortened one."""
    memory, _ = rollout(system, STEPS, TIGHT)
    t = max(0, int(np.argmax(memory.theta < 1)) - 1)
    return system._replace(x0=memory.x[t].copy(), v0=velocity(memory, t).copy())


SWITCHED = [
    *((partial(until_shortened, each), 0, 1e-5) for each in HARD.values()),  # of a turn third derivatives are large
    *((partial(fallen, method, newton), 3, 1e-6) for method in (IMPLICIT, BDF2) for newton in (1, 3)),
]


@pytest.mark.parametrize(("made", "count", "error"), SWITCHED)
def test_the_derivatives_are_those_of_the_steps_that_were_taken(made, count, error):
    system = made()
    memory, good = rollout(system, 4, TIGHT)
    assert good == 4
    assert memory.predicted.any() if count else (memory.theta < 1).any()
    change = physics.direction(system)
    # wind would end the guard
    change = change._replace(velocity=change.velocity * system.vertex.free[:, None], wind=0 * change.wind)
    forward = adjoint.tangent(system, memory, change, TIGHT)

    def moved(t):
        found, _ = rollout(physics.shifted(system, change, t), 4, TIGHT)
        for name in ("theta", "clamped", "predicted", "euler"):  # no switch between the points
            np.testing.assert_array_equal(getattr(found, name), getattr(memory, name))
        return found.x

    sizes = 2e-4 / 4.0 ** np.arange(count + 2 if count else 0)
    rest = np.array([np.abs(moved(t) - memory.x - t * forward).max() for t in sizes])
    seen = rest[1:] > 1e-12
    assert seen.sum() >= count
    assert (np.log(rest[:-1] / rest[1:])[seen] / np.log(4.0) > 1.9).all()
    # rounding 1e-16/1e-7, truncation 1e-14
    assert relative(forward, (moved(1e-7) - moved(-1e-7)) / 2e-7) < error
    weight = np.random.default_rng(5).normal(size=memory.x.shape)
    weight[0] = 0.0
    back = physics.product(adjoint.gradient(system, memory, weight, TIGHT, KINDS), change)
    assert abs(np.vdot(weight, forward) - back) < 1e-10 * np.abs(weight * forward).sum()


@BOTH
def test_every_column_of_the_sensitivity_is_a_tangent(method):
    made = falling(12.0, side=4, spacing=0.15, integrationMethod=method, optimizationIterations=6)
    assert rollout(build(made, 0), 5, TIGHT)[0].predicted.any()
    # linear systems are solved to 1e-14, of a condition below 1000, a few in a row
    assert_dense_sensitivity(made, TIGHT, 1e-10)
