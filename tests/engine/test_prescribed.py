"""Motions whose steps have given forms: those of a motion that is taken freely, and smooth where that one jumps."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import TIGHT, cloth, thing, xyz

from clothfit.derivative import adjoint
from clothfit.engine.prescribed import forms_from, forms_of
from clothfit.engine.snapshots import Plan
from clothfit.engine.system import BDF2, System
from clothfit.engine.tape import Tape

pytestmark = pytest.mark.slow  # compiles a fit

STEPS, PART, STEP = 24, 7, 1e-7


def crushed(**fields) -> System:
    """A cloth whose springs are at a fifth of their rest length, not quite flat, one side fixed."""
    side = 5
    x = np.array([(i, 0.0, j) for j in range(side) for i in range(side)]) / (side - 1)
    x += 1e-3 * np.random.default_rng(3).normal(size=x.shape)
    made = cloth(side, side, vertIsFixed=[i < side for i in range(side**2)], vertPos=[xyz(p) for p in x])
    ends = np.reshape(made["springs"], (-1, 2))
    rest = 5.0 * np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)
    stiff = {"springRestLength": rest.tolist(), "springStiffness": [50.0] * len(ends), "vertMass": [0.01] * side**2}
    return physics.system({**made, **stiff}, **fields)


def turning() -> System:
    """A stiff pendulum that is let go level: tangents lead far from its circle."""
    bob = thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], mass=0.5, stiffness=1e5, fixed=[0])
    return physics.system(bob, delta=0.2)


CASES = {
    "crushed": crushed()._replace(h=0.05),
    "crushed, Newton": crushed(forwardSubSteps=2)._replace(h=0.2),
    "crushed, BDF2": crushed()._replace(h=0.2, method=BDF2),
    "turning": turning(),
}


def positions(tape):
    """All positions (T + 1, n, 3) of a motion."""
    parts = [part.x[: part.steps + 1].copy() for part in tape.forward()]
    return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])


def taped(system, forms=None):
    """A motion in parts of some steps, which can be swept back."""
    return Tape(system, STEPS, TIGHT, Plan(PART, (PART,), 4), forms)


def stiffened(system, change):
    """The system with stiffnesses that are larger by these fractions (S,)."""
    return system._replace(springs=system.springs._replace(stiffness=system.springs.stiffness * (1.0 + change)))


@pytest.mark.parametrize("name", CASES)
def test_a_motion_in_its_own_forms_is_the_same_to_the_bit(name):
    free = taped(CASES[name])
    x = positions(free)
    forms = forms_of(free.forward())
    assert not forms.plain.all()
    held = taped(CASES[name], forms)
    np.testing.assert_array_equal(positions(held), x)
    assert forms_of(held.forward()).equals(forms)
    assert forms_from(CASES[name], free.forward(), TIGHT).equals(forms)


@pytest.mark.parametrize("name", CASES)
def test_the_gradient_is_that_of_the_motion_in_these_forms(name):
    system, rng = CASES[name], np.random.default_rng(1)
    forms = forms_of(taped(system).forward())
    weight = rng.normal(size=(STEPS + 1, *system.x0.shape))
    change = rng.normal(size=len(system.springs.stiffness))
    tape = taped(system, forms)
    positions(tape)
    slope = adjoint.gradient(system, tape, weight, TIGHT).stiffness @ (system.springs.stiffness * change)
    above, below = ((weight * positions(taped(stiffened(system, e * change), forms))).sum() for e in (STEP, -STEP))
    # what a central difference leaves out is of second order in the step, and its rounding of 1e-16 / step
    assert slope == pytest.approx((above - below) / (2.0 * STEP), rel=1e-5)


@pytest.mark.parametrize("name", CASES)
def test_forms_that_are_held_stay_where_free_ones_switch(name):
    system = CASES[name]
    forms = forms_of(taped(system).forward())
    other = stiffened(system, 0.5)
    assert not forms_of(taped(other).forward()).equals(forms)
    assert forms_of(taped(other, forms).forward()).equals(forms)
