"""The balances of momentum along a motion: the step's own residual, linear in masses and stiffnesses."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import METHODS, TIGHT, ball, scene, thing, xyz
from helpers.scenes import cloth

from clothfit.engine.system import all_elements, with_elements
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.optimise.balances import Track, balances, smoothed, summed_twice, track

pytestmark = pytest.mark.slow  # compiles a fit

VARIANTS = [("explicit", 1), ("symplectic", 1), ("implicit", 1), ("implicit", 12), ("bdf2", 1), ("bdf2", 12)]


def made(method="implicit", newton=1, nx=3, frames=8, **fields):
    """A heavy cloth in the wind, on a sphere."""
    rng = np.random.default_rng(31)
    n, springs = 3 * nx, len(cloth(nx, 3)["springStiffness"])
    own = {
        "vertMass": rng.uniform(0.04, 0.08, n).tolist(),
        "springStiffness": rng.uniform(15.0, 60.0, springs).tolist(),
        "dragCoefficient": 0.3,
        "damping": 0.2,
        "optimizationSettings": "LL",
    }
    return scene(
        cloth(nx, 3, **{**own, **fields}),
        integrationMethod=METHODS[method],
        forwardSubSteps=newton,
        delta=0.02 if method in ("implicit", "bdf2") else 0.005,
        optimizationIterations=frames,
        tolerance=1e-13,
        windVel=xyz((4, 2, -3)),
        colliders=[ball((1.0, -0.748, 1.0), 0.75)],
    )


def hide(motion, where):
    """The motion without the vertices of `where` (frames, vertices)."""
    return Motion(np.where(where[:, :, None], np.nan, motion.positions), motion.times, motion.vertex_counts, ~where)


def rows(method, newton, vary=None, frames=8):
    """The balances of a small cloth along its own motion, for other elements where `vary` changes them."""
    given = made(method, newton, frames=frames)
    aim = Objective(given, simulate(given, tolerance=TIGHT), TIGHT)
    (run,) = aim.runs
    system = run.system if vary is None else with_elements(run.system, vary(all_elements(run.system)))
    return balances(system, track(run.comparison.goal, system)), system


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_along_its_own_motion_all_is_in_balance(method, newton):
    found, system = rows(method, newton)
    assert found.valid[:, system.vertex.free].all()
    assert not found.valid[:, ~system.vertex.free].any()
    weight = system.h * 9.81 * system.vertex.mass.min()
    # solves to 1e-13; velocities from differences of metres over h, times stiffnesses of 60 N/m and h
    assert np.abs(found.residual[found.valid]).max() < 1e-9 * weight


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
def test_the_residual_is_linear_and_the_columns_are_its_slope(method, newton):
    rng = np.random.default_rng(5)
    before, system = rows(method, newton)
    mass, stiffness = rng.normal(size=9) * 0.02, rng.normal(size=16) * 20.0
    after, _ = rows(method, newton, lambda e: e._replace(mass=e.mass + mass, stiffness=e.stiffness + stiffness))
    expected = before.mass * mass[:, None]
    for s, ends in enumerate(system.springs.ends):
        expected[:, ends] += before.stiffness[:, s] * stiffness[s]
    change = (after.residual - before.residual)[before.valid]
    np.testing.assert_allclose(change, -expected[before.valid], atol=1e-12 * np.abs(expected).max())  # rounding
    assert np.abs(expected[before.valid]).max() > 1e-3


@pytest.mark.parametrize(("method", "lost_rows"), [("implicit", [3, 4, 5]), ("bdf2", [3, 4, 5, 6, 7])])
def test_rows_that_a_hidden_vertex_touches_are_not_valid(method, lost_rows):
    given = made(method, nx=4, frames=9, triangles=[], dragCoefficient=0.0)
    motion = simulate(given, tolerance=TIGHT)
    where = np.zeros((9, 12), bool)
    where[4, 11] = True
    (run,) = Objective(given, hide(motion, where), TIGHT).runs
    found = balances(run.system, track(run.comparison.goal, run.system))
    ends = run.system.springs.ends
    near = sorted({11, *ends[(ends == 11).any(axis=1)].ravel().tolist()})
    lost = np.argwhere(~found.valid & run.system.vertex.free)
    # the steps from 3 to 4 and from 4 to 5, and those after, whose velocities before the step need frame 4
    assert sorted(set(lost[:, 0].tolist())) == lost_rows
    assert sorted(set(lost[:, 1].tolist())) == near


@pytest.mark.parametrize("frames", [2, 3, 8])
def test_rows_have_one_order_however_few_steps_there_are(frames):
    """What is in another order has another type, for which the kernel would be compiled again."""
    found, _ = rows("implicit", 1, frames=frames)
    assert all(array.flags.c_contiguous for array in found)


def test_sums_of_sums_end_at_the_first_gap():
    found, system = rows("implicit", 1)
    valid = found.valid.copy()
    valid[3, 5] = False
    twice = summed_twice(found._replace(valid=valid))
    assert twice.valid[:, 5].tolist() == [True] * 3 + [False] * 4
    assert twice.valid[:, 4].all()
    by_hand = sum((7 - 1 - t) * found.mass[t, 4] for t in range(7)) + found.mass[:, 4].sum(axis=0)
    np.testing.assert_allclose(twice.mass[-1, 4], by_hand, rtol=1e-12)  # rounding
    spring = int(np.flatnonzero((system.springs.ends == 4).any(axis=1))[0])
    expected = np.cumsum(np.cumsum(found.stiffness[:, spring], axis=0), axis=0)
    np.testing.assert_allclose(twice.stiffness[:, spring], expected, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize(("method", "reach"), [("implicit", 0.02), ("bdf2", 0.04 / 3)])
def test_errors_of_positions_enter_sums_of_sums_one_by_one(method, reach):
    fields = {"integrationMethod": METHODS[method], "delta": 0.02}
    alone = physics.system(thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], mass=[0.3, 0.7], stiffness=0.0), **fields)
    rng, seen = np.random.default_rng(2), np.ones((20, 2), bool)
    moved, error = (0.1 * rng.normal(size=(20, 2, 3)) for _ in range(2))
    moved[0] = error[0] = 0.0
    x = alone.x0 + moved
    off, exact = (summed_twice(balances(alone, Track(each, seen)), alone.method).residual for each in (x + error, x))
    expected = np.array([[0.3], [0.7]]) * error[1:] / reach  # m e/h, and of BDF2 h' = 2h/3
    np.testing.assert_allclose(off - exact, expected, atol=1e-11)  # sums of sums of rounding, of numbers up to 100


def test_smoothing_leaves_a_parabola_alone():
    t = np.arange(20.0)[:, None, None]
    x = np.ones((1, 3, 3)) + 0.3 * t - 0.02 * t**2
    seen = np.ones((20, 3), bool)
    seen[8, 1] = False
    found = smoothed(Track(x, seen), x[0], 7)
    np.testing.assert_allclose(found.x, x, rtol=1e-12)  # rounding
    assert np.flatnonzero(~found.seen[:, 1]).tolist() == [5, 6, 7, 8, 9, 10, 11]
    assert found.seen[:, 0].all()
    short = Track(x[:5], seen[:5])
    assert smoothed(short, x[0], 7) is short
