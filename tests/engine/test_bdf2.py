"""The BDF2 step: its equation written down again, closed forms, its order, its guard, its parts to the last bit."""

from itertools import pairwise

import numba
import numpy as np
import pytest
from helpers import physics
from helpers.physics import GRAVITY, TIGHT, ball, cloth, dense_forces, full, thing, unbound, xyz

from clothfit.engine.march import velocity
from clothfit.engine.rollout import rollout
from clothfit.engine.snapshots import Plan
from clothfit.engine.step import bdf2, guard, implicit
from clothfit.engine.system import BDF2, IMPLICIT, clamped
from clothfit.engine.tape import Tape

pytestmark = pytest.mark.slow  # compiles steps

SLOW_WITHOUT = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of steps are slow without compilation")


def made(*objects, **fields):
    return physics.system(*objects, integrationMethod=BDF2, **fields)


def run(system, steps, tolerance=TIGHT):
    """The memory of a motion that stays finite."""
    memory, good = rollout(system, steps, tolerance)
    assert good == steps
    return memory


def solved(system, v, x, u, y, h):
    """The velocity w of (M − h D − h² K) w = M v + h [f(y, u) + K (x − y) − D u], dense, K and D at (y, u)."""
    free = np.repeat(system.vertex.free, 3)
    f, K, D = dense_forces(system, y, u)
    M = np.diag(np.repeat(system.vertex.mass, 3))
    b = M @ v.ravel() + h * (f.ravel() + K @ (x - y).ravel() - D @ u.ravel())
    w = np.zeros(len(b))
    w[free] = np.linalg.solve((M - h * D - h * h * K)[np.ix_(free, free)], b[free])
    return w.reshape(x.shape)


def written_down(system, steps):
    """The motion (steps + 1, n, 3), by its definition."""
    h, third = system.h, 2 * system.h / 3
    x, v = [system.x0], [system.v0]
    for t in range(steps):
        if t == 0:
            w, base, reach = solved(system, v[0], x[0], v[0], x[0], h), x[0], h
        else:
            base, reach = (4 * x[t] - x[t - 1]) / 3, third
            u = 2 * v[t] - v[t - 1]
            w = solved(bdf2.forms(system)[1], (4 * v[t] - v[t - 1]) / 3, base, u, base + third * u, third)
        x.append(base + reach * w)
        v.append(w)
    return np.array(x)


@pytest.mark.parametrize("name", ["plain", "with fixed vertices"])
def test_the_motion_is_that_of_the_definition(name):
    system = full(fixed=() if name == "plain" else (0, 2), integrationMethod=BDF2, delta=0.004)
    memory = run(system, 8)
    np.testing.assert_allclose(memory.x, written_down(system, 8), atol=1e-12)  # solves to 1e-14, of a condition of 100
    assert memory.euler.tolist() == [True] + [False] * 7


@pytest.mark.parametrize("form", ["own", "clamped"])
def test_the_right_hand_side_is_that_of_a_newton_iteration(form):
    system = full(fixed=(0,)) if form == "own" else clamped(full(fixed=(0,)))
    at, work, b = physics.state(system, "compressed"), implicit.workspace(system), np.zeros((9, 3))
    u = at.u * system.vertex.free[:, None]
    implicit.assemble(system, at.y + system.h * u, u, True, work.A, work.b)
    implicit.add_momentum(system.vertex, at.w, work.b)
    implicit.assemble_newton(system, at.y, at.w, u, work.y, work.A, work.gy, b)
    b[~system.vertex.free] = 0.0
    np.testing.assert_allclose(work.b, b, rtol=1e-12, atol=1e-14 * np.abs(b).max())  # rounding


def test_fixed_vertices_stay_to_the_last_bit():
    system = full(fixed=(0, 2, 5), integrationMethod=BDF2, delta=0.004)
    memory = run(system, 20)
    held = np.broadcast_to(system.x0[[0, 2, 5]], (21, 3, 3))
    np.testing.assert_array_equal(memory.x[:, [0, 2, 5]], held)


def test_free_fall_is_exact_from_the_second_step_on():
    h, t = 0.02, np.arange(31)
    x = run(made(thing([(1, 2, 3)], mass=0.3), delta=h), 30).x[:, 0, 1]
    # v_t = −g h t; the first step moves by h v₁, where ½ h v₁ is right, and what is too much fades as 1 + ⅓ + ⅑ …
    late = 0.75 * h * h * GRAVITY * (1 - 3.0**-t)
    np.testing.assert_allclose(x, 2 - 0.5 * GRAVITY * (h * t) ** 2 - late, atol=1e-14 * 30)  # a rounding per step


def pendulum(h, alpha=0.8, k=30.0, m=0.5):
    """A mass on a vertical spring below a fixed vertex, at rest length 1 m at the start."""
    return made(thing([(0, 0, 0), (0, -1, 0)], [(0, 1)], mass=m, stiffness=k, fixed=[0], damping=alpha), delta=h)


def test_a_spring_is_the_damped_oscillator_of_the_scheme():
    h, alpha, k, m, steps = 0.01, 0.8, 30.0, 0.5, 60
    A = np.array([[0.0, 1.0], [-k / m, -(alpha + alpha / 2 * k / m)]])  # (z, v)' = A (z, v)
    z = [np.array([0.5 * GRAVITY / k, 0.0])]
    z.append(np.linalg.solve(np.eye(2) - h * A, z[0]))
    for _ in range(steps - 1):
        z.append(np.linalg.solve(np.eye(2) - 2 * h / 3 * A, (4 * z[-1] - z[-2]) / 3))
    found = run(pendulum(h), steps).x[:, 1, 1] + 1 + 0.5 * GRAVITY / k
    np.testing.assert_allclose(found, np.array(z)[:, 0], atol=1e-13)  # a rounding of numbers of order 1 per step


def slope(steps, errors):
    return np.polyfit(np.log(1 / np.asarray(steps)), np.log(errors), 1)[0]


@SLOW_WITHOUT
def test_a_spring_converges_to_the_continuous_oscillator_with_order_two():
    m, k, alpha, end = 0.5, 30.0, 0.8, 0.4
    decay = (alpha * m + alpha / 2 * k) / (2 * m)
    omega = np.emath.sqrt(k / m - decay**2)
    start = 0.5 * GRAVITY / k
    exact = (start * np.exp(-decay * end) * (np.cos(omega * end) + decay / omega * np.sin(omega * end))).real
    steps = [160, 320, 640]
    errors = [abs(run(pendulum(end / n), n).x[-1, 1, 1] + 1 + start - exact) for n in steps]
    assert abs(slope(steps, errors) - 2) < 0.1


@SLOW_WITHOUT
@pytest.mark.parametrize("newton", [1, 3])
def test_a_swinging_cloth_in_the_wind_converges_with_order_two(newton):
    one = cloth(3, 3, size=0.5, damping=0.5, dragCoefficient=0.2, springStiffness=[8.0] * 16, vertMass=[0.1] * 9)
    end, steps = 0.3, np.array([120, 240, 480, 960])
    fields = {"windVel": xyz((1, 0, 2)), "forwardSubSteps": newton}
    last = [run(made(one, delta=end / n, **fields), n).x[-1] for n in steps]
    gaps = [np.linalg.norm(a - b) for a, b in pairwise(last)]  # of refinements: they fall like the error
    assert abs(slope(steps[:-1], gaps) - 2) < 0.15


def hanging(method, frames, k):
    """Positions at `frames` frames of 0.02 s of a cloth that swings from one side, k steps to a frame."""
    one = cloth(7, 7, size=1.5, vertIsFixed=[i < 7 for i in range(49)], damping=0.05, dragCoefficient=0.0)
    one |= {"vertMass": [0.02] * 49, "springStiffness": [60.0] * len(one["springStiffness"])}
    memory = run(physics.system(one, integrationMethod=method, delta=0.02 / k), (frames - 1) * k, 1e-9)
    assert memory.euler.sum() == (1 if method == BDF2 else 0)
    return memory.x[::k]


@SLOW_WITHOUT
def test_a_hanging_cloth_is_five_times_nearer_to_the_converged_motion_than_by_euler_steps():
    finest, finer = (hanging(BDF2, 61, k) for k in (32, 16))
    exact = finest + (finest - finer) / 3

    def error(method, k):
        return np.sqrt(((hanging(method, 61, k) - exact) ** 2).sum(axis=2).mean())

    euler, one, two, four = error(IMPLICIT, 1), error(BDF2, 1), error(BDF2, 2), error(BDF2, 4)
    assert one < 0.2 * euler
    assert abs(np.log2(two / four) - 2) < 0.4  # steps of 0.01 s are not yet short beside the cloth's oscillations
    assert one / two > 2.0


def test_momentum_of_a_free_cloth_without_weight():
    one = cloth(3, 3, vertIsFixed=[False] * 9, dragCoefficient=0.0, damping=0.3)
    system = unbound(made(one, delta=0.005), damping=0.0)
    at = physics.state(system, "stretched")
    memory = run(system._replace(x0=at.y, v0=at.u), 12)
    mass = system.vertex.mass[:, None]
    momenta = [(mass * velocity(memory, t)).sum(axis=0) for t in range(13)]
    # the forces are internal: rounding, and 1e-14 of the linear solver, per step
    assert np.abs(np.diff(momenta, axis=0)).max() < 1e-13 * np.abs(mass * at.u).sum()


# Steps that are not BDF2's --------------------------------------------------------------------------------------------


def crushed(side=5, factor=5.0):
    """A cloth whose springs are at a fraction of their rest length, one side fixed."""
    x = np.array([(i, 0.0, j) for j in range(side) for i in range(side)]) / (side - 1)
    x += 1e-3 * np.random.default_rng(3).normal(size=x.shape)
    held = [i < side for i in range(side * side)]
    one = cloth(side, side, vertIsFixed=held, vertPos=[xyz(p) for p in x], vertMass=[0.01] * side**2)
    ends = np.reshape(one["springs"], (-1, 2))
    rest = factor * np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)
    return made({**one, "springRestLength": rest.tolist(), "springStiffness": [50.0] * len(ends)}, delta=0.2)


def energies(system, memory):
    """Kinetic and stored energy at each state (T + 1,), and the work of the weight over each step (T,), J."""
    x = memory.x
    inner = [guard.energy(system, x[t], velocity(memory, t)) for t in range(memory.steps + 1)]
    return np.array(inner), np.einsum("n,c,tnc->t", system.vertex.mass, system.vertex.gravity, np.diff(x, axis=0))


def test_no_step_of_a_crushed_cloth_adds_energy():
    system = crushed()
    memory = run(system, 60, 1e-8)
    assert memory.euler[1:].any()
    assert not memory.euler.all()
    inner, work = energies(system, memory)
    assert (np.diff(inner) - work <= guard.SLACK * inner[:-1] + guard.LEAST_RISE + 1e-13 * inner.max()).all()


def test_the_step_after_a_shortened_one_is_an_euler_step():
    memory = run(crushed(), 60, 1e-8)
    short = np.flatnonzero(memory.theta[:-1] < 1)
    assert len(short)
    assert memory.euler[short].all()
    assert memory.euler[short + 1].all()


def test_an_ordinary_cloth_takes_bdf2_steps_only():
    one = cloth(6, 6, size=1.0, damping=0.1, dragCoefficient=0.1, vertMass=[0.01] * 36)
    memory = run(made(one, delta=0.02), 100, 1e-6)
    assert memory.euler.sum() == 1
    assert not memory.clamped.any()


def test_the_sudden_stop_on_a_sphere_is_survived():
    one = cloth(5, 5, size=1.0, vertIsFixed=[False] * 25, vertMass=[0.05] * 25, dragCoefficient=0.0)
    memory = run(made(one, delta=0.02, colliders=[ball((0.5, -1.5, 0.5), 0.9)]), 100, 1e-6)
    assert np.abs(memory.w).max() < 20.0  # m/s; it falls from 0.6 m, and rolls off


# In parts -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("plan", [Plan(1, (1,), 40), Plan(3, (3,), 14), Plan(2, (8, 2), 9)])
def test_parts_with_euler_and_shortened_steps_are_the_same_to_the_last_bit(plan):
    system = crushed()
    whole = run(system, 40, 1e-8)
    assert whole.euler[1:].any()
    assert (whole.theta < 1).any()
    tape = Tape(system, 40, 1e-8, plan)
    for parts in (tape.forward(), tape.backward()):
        for part in parts:
            place = slice(part.first, part.first + part.steps)
            np.testing.assert_array_equal(part.x, whole.x[part.first : part.first + part.steps + 1])
            for name in ("w", "used", "clamped", "theta", "euler"):
                np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[place])


def test_how_a_motion_is_cut_into_runs_changes_nothing(monkeypatch):
    whole = run(crushed(), 40, 1e-6)
    monkeypatch.setattr("clothfit.engine.rollout.STRETCH", 25)  # one step of 25 vertices at a time
    cut = run(crushed(), 40, 1e-6)
    for one, other in zip(whole[:7], cut[:7], strict=True):
        np.testing.assert_array_equal(one, other)
