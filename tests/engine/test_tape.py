"""A motion told part by part against the same motion kept whole: everything is the same to the last bit. Then motions
whose steps have given forms: those of a motion that is taken freely, and smooth where that one jumps.
"""

from functools import cache, partial

import numpy as np
import pytest
from helpers import physics
from helpers.hard import crushed, fallen, turning
from helpers.physics import KINDS, TIGHT, VARIANTS, gentle

from clothfit.base import interrupts
from clothfit.base.arrays import Elements
from clothfit.derivative import adjoint
from clothfit.derivative.adjoint import whole
from clothfit.engine import rollout, tape
from clothfit.engine.prescribed import forms_from, forms_of
from clothfit.engine.system import BDF2, IMPLICIT
from clothfit.engine.tape import Plan, Tape

pytestmark = pytest.mark.slow  # compiles a fit

STEPS = 13
SYSTEMS = {
    **{f"{method}, {newton}": partial(gentle, method, newton) for method, newton in VARIANTS},
    "shortened, BDF2": partial(crushed, factor=10.0, delta=0.2, integrationMethod=BDF2),
    "shortened": partial(crushed, delta=0.05),
    "early contacts": partial(fallen, IMPLICIT, 3),
    "early contacts, BDF2": partial(fallen, BDF2),
}
PLANS = {
    "every state": Plan(STEPS, (STEPS,)),
    "each step alone": Plan(1, (1,), STEPS),
    "pairs": Plan(2, (2,), 7),
    "the root": Plan(4, (4,), 4),
    "two levels": Plan(2, (6, 2), 6),
    "four levels": Plan(1, (8, 4, 2, 1), 8),
}


@cache
def made_once(name):
    return SYSTEMS[name]()


def kept(system, steps=STEPS):
    """The whole motion, and a random weight on its positions."""
    memory, good = rollout.rollout(system, steps, TIGHT)
    assert good == steps
    return memory, np.random.default_rng(6).normal(size=memory.x.shape)


def told(system, chosen, steps=STEPS):
    """The same as a tape that was told once."""
    made = Tape(system, steps, TIGHT, chosen)
    for _ in made.forward():
        pass
    assert made.good == steps
    return made


def assert_states(parts, memory):
    """Parts one after the other, in any order, are those of the whole motion."""
    seen = 0
    for part in parts:
        begin, end = part.first, part.first + part.steps
        whole = memory.part(begin, end)
        for name in ("x", "used", "solves", "clamped", "theta", "euler", "predicted", "guard_state"):
            np.testing.assert_array_equal(getattr(part, name), getattr(whole, name))
        for t in range(part.steps):
            np.testing.assert_array_equal(part.w[t, : part.used[t]], whole.w[t, : part.used[t]])
        seen += part.steps
    assert seen == memory.steps


def assert_same(found, expected):
    for name in Elements._fields:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("chosen", PLANS.values(), ids=PLANS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_derivatives_are_the_same_to_the_last_bit(name, chosen):
    system = made_once(name)
    memory, weight = kept(system)
    made, change = told(system, chosen), physics.direction(system)
    forward = adjoint.tangent(system, memory, change, TIGHT)
    back = adjoint.gradient(system, memory, weight, TIGHT, KINDS)
    for _ in range(2):  # what one sweep leaves behind does not disturb the next
        assert_same(adjoint.gradient(system, made, weight, TIGHT, KINDS), back)
        np.testing.assert_array_equal(adjoint.tangent(system, made, change, TIGHT), forward)


@pytest.mark.parametrize("chosen", PLANS.values(), ids=PLANS)
@pytest.mark.parametrize("name", ["implicit, 1", "implicit, 3", *list(SYSTEMS)[-4:]])
def test_the_states_are_the_same_there_and_back(name, chosen):
    system = made_once(name)
    memory, _ = kept(system)
    assert memory.euler[1:].any() == ("BDF2" in name)
    assert (memory.theta < 1).any() == name.startswith("shortened")
    assert memory.predicted.any() == name.startswith("early")
    made = Tape(system, STEPS, TIGHT, chosen)
    for tell in (made.forward, made.backward, made.forward, made.backward):
        assert_states(tell(), memory)
    assert made.fallbacks.early_contacts == memory.predicted.sum()


@pytest.mark.parametrize("name", list(SYSTEMS)[-4:])
def test_how_a_motion_is_cut_into_runs_changes_nothing(name, monkeypatch):
    whole, _ = kept(made_once(name))
    monkeypatch.setattr(rollout, "STRETCH", 1)  # one step at a time
    cut, _ = kept(made_once(name))
    assert_states([cut], whole)


@pytest.mark.parametrize("chosen", PLANS.values(), ids=PLANS)
def test_no_more_is_held_and_computed_than_the_plan_says(chosen, monkeypatch):
    counts, most = [], [0]
    compute = tape.fill

    def counted(system, tolerance, work, part):
        counts.append(part.steps)
        return compute(system, tolerance, work, part)

    monkeypatch.setattr(tape, "fill", counted)
    made = told(gentle(), chosen)
    assert sum(counts) == STEPS
    for _ in made.backward():
        most[0] = max(most[0], len(made._kept))
    assert sum(counts) <= (len(chosen.strides) + 1) * STEPS
    assert most[0] <= (chosen.snapshots or 1)
    assert made._room.steps == chosen.length


def test_a_tape_without_a_plan_holds_a_few_steps(monkeypatch):
    monkeypatch.setattr(tape, "SHORTEST_PART", 3)
    monkeypatch.setattr(tape, "STRETCH", 1)
    system = gentle()
    memory, _ = kept(system)
    made = Tape(system, STEPS, TIGHT)
    assert [(part.first, part.steps) for part in made.forward()] == [(0, 3), (3, 3), (6, 3), (9, 3), (12, 1)]
    assert_states(made.forward(), memory)
    assert list(made._kept) == [0]


@pytest.mark.parametrize("chosen", PLANS.values(), ids=PLANS)
def test_a_motion_of_no_steps_is_its_start(chosen):
    system = gentle()
    made = Tape(system, 0, TIGHT, chosen)
    (part,) = made.forward()
    np.testing.assert_array_equal(part.x, system.x0[None])
    assert list(made.backward()) == []


@pytest.mark.parametrize("length", [1, 7, 100])
def test_a_motion_that_diverges_late_ends_where_it_does(length):
    stiff = gentle("explicit", delta=0.01)
    memory, good = rollout.rollout(stiff, 100, TIGHT)
    assert 10 < good < 100
    made = Tape(stiff, 100, TIGHT, Plan(length, (length,)))
    for part in made.forward():
        end = min(part.first + part.steps, good)
        np.testing.assert_array_equal(part.x[: end - part.first + 1], memory.x[part.first : end + 1])
    assert made.good == good
    np.testing.assert_array_equal(made.fault, memory.x[good + 1])


def test_an_interrupt_between_parts_does_no_harm(monkeypatch):
    system = gentle()
    memory, weight = kept(system)
    made = told(system, PLANS["two levels"])
    interrupts.request()
    with pytest.raises(KeyboardInterrupt):
        adjoint.gradient(system, made, weight, TIGHT)
    interrupts.clear()
    assert_same(adjoint.gradient(system, made, weight, TIGHT), adjoint.gradient(system, memory, weight, TIGHT))


def test_a_derivative_may_be_told_part_by_part():
    system = gentle()
    memory, weight = kept(system)
    asked = []

    def slope(part):
        asked.append(part.first)
        return whole(weight)(part)

    found = adjoint.gradient(system, told(system, PLANS["pairs"]), slope, TIGHT)
    assert asked == sorted(asked, reverse=True)
    assert_same(found, adjoint.gradient(system, memory, weight, TIGHT))


# --- given forms

HELD, STEP = 24, 1e-7
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
    return Tape(system, HELD, TIGHT, Plan(7, (7,), 4), forms)


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
    weight = rng.normal(size=(HELD + 1, *system.x0.shape))
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
