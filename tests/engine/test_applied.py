"""Forces that are applied, and springs that pull to given places: closed forms, the guard, and their derivatives."""

import numpy as np
import pytest
from helpers.physics import METHODS, VARIANTS, chain, scene, thing, xyz
from helpers.scenes import cloth

from clothfit import Forces, energies, simulate
from clothfit.derivative import adjoint
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build, with_elements, zeros

pytestmark = pytest.mark.slow  # compiles motions with inputs

TIGHT = 1e-13
STEPS = 12


def flapping(method, newton, **fields):
    """A cloth in wind over a sphere, with two vertices held."""
    made = {"windVel": xyz((3, 1, -2)), "delta": 0.005, "tolerance": TIGHT, **fields}
    one = cloth(3, 3, vertMass=[0.1 + 0.01 * i for i in range(9)], dragCoefficient=0.4, damping=0.7)
    return scene(one, integrationMethod=METHODS[method], forwardSubSteps=newton, **made)


def given(own, pulls, seed=1, size=0.3):
    """Forces at random for a scene, with springs where it `pulls`."""
    rng, n = np.random.default_rng(seed), sum(own.vertex_counts)
    places = own.cloths[0].positions + 0.1 * rng.normal(size=(STEPS, n, 3))
    times, values = own.delta * np.arange(STEPS), size * rng.normal(size=(STEPS, n, 3))
    return Forces(times, values, 20.0 * rng.random((STEPS, n)), places, pulls)


def errors(own, forces, step=1e-4):
    """Of a random cost: how far the adjoint is from the tangent, and from a central difference, relative."""
    system = build(own.with_forces(forces), 0, steps=STEPS)
    motion, good = rollout(system, STEPS, TIGHT)
    assert good == STEPS
    rng = np.random.default_rng(2)
    weight, along = rng.normal(size=motion.x.shape), np.zeros_like(system.inputs.force)
    along[:STEPS] = rng.normal(size=(STEPS, *system.x0.shape))
    gradient = adjoint.gradient(system, motion, weight, TIGHT, ("force",)).force
    change = adjoint.tangent(system, motion, zeros(system)._replace(force=along), TIGHT)
    exact, start = float((weight * change).sum()), system.inputs.force.copy()

    def cost(t):
        values = zeros(system)._replace(mass=system.vertex.mass, stiffness=system.springs.stiffness)
        moved = with_elements(system, values._replace(force=start + t * along))
        return float((weight * rollout(moved, STEPS, TIGHT)[0].x).sum())

    difference = (cost(step) - cost(-step)) / (2.0 * step)
    return abs((gradient * along).sum() / exact - 1.0), abs(difference / exact - 1.0), motion


@pytest.mark.parametrize("pulls", [False, True])
@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_gradient_and_tangent(method, newton, pulls):
    own = flapping(method, newton)
    transposed, difference, _ = errors(own, given(own, pulls))
    assert transposed < 1e-11  # rounding of 12 steps
    assert difference < 1e-6  # step² of the difference, over the scale of the change


def test_gradient_through_clamped_and_shortened_steps():
    """A cloth whose springs are at a fraction of their rest length, not quite flat: some steps would add energy."""
    flat = cloth(4, 4, springRestLength=[3.0] * 33, springStiffness=[50.0] * 33, vertMass=[0.01] * 16)
    for i, point in enumerate(flat["vertPos"]):
        point["y"] = 1e-2 * (i % 3)
    own = scene(flat, delta=0.05, tolerance=TIGHT)
    transposed, difference, motion = errors(own, given(own, False, size=0.01), step=1e-6)
    assert motion.clamped.any()
    assert (motion.theta < 1.0).any()
    assert transposed < 1e-9  # matrices near singular lose digits
    assert difference < 1e-4  # the motion is nearly chaotic: its third derivative is large, and small steps round


@pytest.mark.parametrize("method", ["implicit", "bdf2"])
def test_no_force_changes_no_bit(method):
    own = scene(cloth(4, 3, stiffness=500.0), integrationMethod=METHODS[method], optimizationIterations=40)
    nothing = Forces(own.delta * np.arange(39), np.zeros((39, 12, 3)))
    np.testing.assert_array_equal(simulate(own.with_forces(nothing)).positions, simulate(own).positions)


@pytest.mark.parametrize("method", ["explicit", "symplectic", "implicit"])  # BDF2 remembers two steps
def test_momentum_is_what_the_forces_give(method):
    """Free vertices that are joined: their momentum after T steps is Σ h u."""
    own = scene(chain(3, "nn"), integrationMethod=METHODS[method], delta=0.01, gravity=xyz((0, 0, 0)), tolerance=TIGHT)
    forces = given(own, False, size=2.0)
    end = simulate(own.with_forces(forces), STEPS + 3).positions[-2:]
    momentum = own.cloths[0].mass @ (end[1] - end[0]) / own.delta
    np.testing.assert_allclose(momentum, own.delta * forces.values.sum(axis=(0, 1)), rtol=1e-9, atol=1e-11)  # rounding


def test_a_spring_to_a_place_pulls_as_its_closed_form():
    """One vertex, implicit Euler: m (x⁺ − 2 x + x₋)/h² = κ (R − x⁺)."""
    own = scene(thing([(0, 0, 0)], mass=0.5), delta=0.01, gravity=xyz((0, 0, 0)), tolerance=TIGHT)
    place, gain, m, h = np.array([1.0, 2.0, -1.0]), 30.0, 0.5, 0.01
    forces = Forces(h * np.arange(20), np.zeros((20, 1, 3)), np.full((20, 1), gain), np.tile(place, (20, 1, 1)), True)
    x = simulate(own.with_forces(forces), 21).positions[:, 0]
    before, now = np.zeros(3), np.zeros(3)
    for found in x[1:]:
        before, now = now, (m / h**2 * (2 * now - before) + gain * place) / (m / h**2 + gain)
        np.testing.assert_allclose(found, now, rtol=1e-11, atol=1e-13)


def test_energy_counts_the_work_of_the_forces():
    """Without damping, springs or air the symplectic and implicit steps of a free vertex: the work is u·Δx."""
    own = scene(thing([(0, 0, 0)], mass=0.5), delta=0.01, gravity=xyz((0, 0, 0)), integrationMethod=1)
    forces = Forces(0.01 * np.arange(10), np.tile([1.0, 0.0, 0.0], (10, 1, 1)))
    pushed = own.with_forces(forces)
    motion = simulate(pushed, 11)
    found = energies(pushed, motion)
    np.testing.assert_allclose(found.wind[-1], motion.positions[-1, 0, 0], rtol=1e-12)  # 1 N over the way
    assert found.kinetic[-1] == pytest.approx(0.5 * 0.5 * (0.1 / 0.5) ** 2, rel=1e-12)  # (Σ h u)²/2m
