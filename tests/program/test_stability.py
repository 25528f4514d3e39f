"""Hard cases stay stable: the cheap ones of benchmarks/stability.py, with what must hold; gradients through them."""

import sys
from importlib import import_module

import numpy as np
import pytest
from helpers.paths import BENCHMARKS

import clothfit
from clothfit.base.arrays import Elements
from clothfit.derivative.adjoint import Sweep
from clothfit.engine.rollout import rollout
from clothfit.engine.step import guard
from clothfit.engine.step.states import velocity
from clothfit.engine.system import BDF2, build
from clothfit.motion.energy import CONTACT, GRAVITY, balances

sys.path.insert(0, str(BENCHMARKS))
try:
    hard_cases, stability = import_module("hard_cases"), import_module("stability")
finally:
    sys.path.remove(str(BENCHMARKS))

CASES = hard_cases.CASES
STILL = [name for name, case in CASES.items() if not case.windy]
WINDY = [name for name, case in CASES.items() if case.windy]
STEPS, TOLERANCE = 100, 1e-5
pytestmark = pytest.mark.slow


def totals(system, steps=STEPS):
    """Positions, energy (steps + 1,), J, and the most that is ever in one place, of a motion that stays finite."""
    memory, good = rollout(system, steps, TOLERANCE)
    assert good == steps
    stored = balances(system, memory.x)[:, : CONTACT + 1]
    stored[:, GRAVITY] -= stored[0, GRAVITY]
    return memory, stored.sum(axis=1), np.abs(stored).max()


@pytest.mark.parametrize("name", STILL)
def test_without_wind_no_frame_gains_more_than_a_hundredth_of_the_energy(name):
    for system in CASES[name].systems():
        _, total, scale = totals(system)
        start = total[0] if total[0] > 0 else scale  # a level cloth at rest starts with none
        assert np.diff(total).max() <= 0.01 * start  # the bar; measured: below 2e-5


@pytest.mark.parametrize("name", STILL)
def test_bdf2_stays_finite_and_no_step_adds_energy(name):
    for given in CASES[name].systems():
        system = given._replace(method=BDF2)
        memory, good = rollout(system, STEPS, TOLERANCE)
        assert good == STEPS
        inner = np.array([guard.energy(system, memory.x[t], velocity(memory, t)) for t in range(STEPS + 1)])
        work = np.einsum("n,c,tnc->t", system.vertex.mass, system.vertex.gravity, np.diff(memory.x, axis=0))
        begins = guard.starts_deep(system.spheres, system.x0) or not len(system.spheres.radius)
        assert begins  # else a contact may begin with a step, which then gains its energy
        rounding = 1e-12 * inner.max()
        assert (np.diff(inner) - work <= guard.SLACK * inner[:-1] + guard.LEAST_RISE + rounding).all()


def growth(divisions, stiffness):
    """How far, m, the vertices of a cloth that swings down and folds move for a stiffness of e times as much: the root
    mean square of the derivative at the worst of 60 frames, a step of 1/24 s each.
    """
    sheet = clothfit.mesh.plane(divisions, 1.0)
    held = sheet.positions[:, 2] == 0.5
    made = clothfit.new_scene(sheet, held, stiffness=stiffness, delta=1 / 24, frames=60)
    system = build(made, 0)
    memory, good = rollout(system, 59, 1e-10)
    assert good == 59
    direction = Elements(np.zeros(len(held)), system.springs.stiffness.copy(), rest=np.zeros(0))
    moved = Sweep(system, direction, 1e-12).through(memory)
    return np.sqrt((np.array(moved) ** 2).sum(axis=2).mean(axis=1)).max()


def test_derivatives_of_long_bdf2_steps_do_not_explode():
    found = [growth(divisions, stiffness) for divisions in (7, 9, 10, 11) for stiffness in (50.0, 150.0, 500.0)]
    # A cloth of 1 m. Implicit steps: 0.16 m; with the springs' push sideways in the matrix 2 m, and 1e4 m at worst.
    assert np.median(found) < 0.5


@pytest.mark.parametrize("name", WINDY)
def test_in_wind_it_stays_finite_or_says_where_not(name):
    found = stability.run(CASES[name].systems(), STEPS + 50)
    assert (found.good == STEPS + 50) != found.where.startswith("objects[0], vertex ")
    assert ("crushed" in name) == bool(found.where)


CRUSHED = [name for name in CASES if name.startswith("crushed") and "1e5" not in name]


@pytest.mark.parametrize("name", CRUSHED)
def test_a_crushed_cloth_unfolds_and_never_gains(name):
    system = CASES[name].systems()[0]
    memory, total, _ = totals(system, 250)  # 5 s
    assert total[0] > 1000  # J: each spring at a fifth of its length
    assert np.diff(total).max() <= 1e-6 * total[0]
    a, b = system.springs.ends.T
    length = np.linalg.norm(memory.x[-1, a] - memory.x[-1, b], axis=1)
    assert np.abs(length / system.springs.rest - 1).mean() < 0.05


def test_the_step_of_the_format_is_shown_beside_it():
    systems = CASES["crushed"].systems()
    plain, own = (stability.run(each, STEPS) for each in ([s._replace(guarded=False) for s in systems], systems))
    assert plain.rise > 100 * plain.start
    assert own.rise <= 1e-6 * own.start
    assert (plain.clamped_steps, plain.shortened_steps) == (0, 0)
    assert plain.direct_solves > 0 < own.clamped_steps


def test_values_at_the_ends_of_the_bounds_are_finite_or_diverged():
    found = dict(stability.at_bounds())
    assert set(found) == {"all at the lower ends", "all at the upper ends", "at random ends"}
    assert not any("WRONG" in told for told in found.values())
    assert all("finite" in told for told in found.values())
