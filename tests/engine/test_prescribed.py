"""Motions whose steps have given forms: those of a motion that is taken freely, and smooth where that one jumps."""

import numpy as np
import pytest
from helpers.hard import crushed, turning
from helpers.physics import TIGHT

from clothfit.derivative import adjoint
from clothfit.engine.prescribed import forms_from, forms_of
from clothfit.engine.system import BDF2
from clothfit.engine.tape import Plan, Tape

pytestmark = pytest.mark.slow  # compiles a fit

STEPS, PART, STEP = 24, 7, 1e-7
CASES = {
    "crushed": crushed(delta=0.05),
    "crushed, Newton": crushed(forwardSubSteps=2, delta=0.2),
    "crushed, BDF2": crushed(delta=0.2, integrationMethod=BDF2),
    "turning": turning(),
}
ALL = pytest.mark.parametrize("system", CASES.values(), ids=CASES)


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


@ALL
def test_a_motion_in_its_own_forms_is_the_same_to_the_bit(system):
    free = taped(system)
    x, forms = positions(free), forms_of(free.forward())
    assert not forms.plain.all()
    held = taped(system, forms)
    np.testing.assert_array_equal(positions(held), x)
    assert forms_of(held.forward()).equals(forms)
    assert forms_from(system, free.forward(), TIGHT).equals(forms)


@ALL
def test_the_gradient_is_that_of_the_motion_in_these_forms(system):
    rng, forms = np.random.default_rng(1), forms_of(taped(system).forward())
    weight = rng.normal(size=(STEPS + 1, *system.x0.shape))
    change, tape = rng.normal(size=len(system.springs.stiffness)), taped(system, forms)
    positions(tape)
    slope = adjoint.gradient(system, tape, weight, TIGHT).stiffness @ (system.springs.stiffness * change)
    above, below = ((weight * positions(taped(stiffened(system, e * change), forms))).sum() for e in (STEP, -STEP))
    # what a central difference leaves out is of second order in the step, and its rounding of 1e-16 / step
    assert slope == pytest.approx((above - below) / (2.0 * STEP), rel=1e-5)


@ALL
def test_forms_that_are_held_stay_where_free_ones_switch(system):
    forms, other = forms_of(taped(system).forward()), stiffened(system, 0.5)
    assert not forms_of(taped(other).forward()).equals(forms)
    assert forms_of(taped(other, forms).forward()).equals(forms)
