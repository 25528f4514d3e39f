"""The BDF2 step: its equation written down again, closed forms, and where it is an Euler step instead."""

import numba
import numpy as np
import pytest
from helpers import physics
from helpers.hard import crushed, energies
from helpers.physics import TIGHT, ball, cloth, dense_forces, full

from clothfit.engine.rollout import rollout
from clothfit.engine.step import bdf2, guard
from clothfit.engine.system import BDF2, IMPLICIT

pytestmark = pytest.mark.slow  # compiles steps


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


@pytest.mark.parametrize("fixed", [(), (0, 2)])
def test_the_motion_is_that_of_the_definition(fixed):
    system = full(fixed=fixed, integrationMethod=BDF2, delta=0.004)
    memory = run(system, 8)
    np.testing.assert_allclose(memory.x, written_down(system, 8), atol=1e-12)  # solves to 1e-14, of a condition of 100
    assert memory.euler.tolist() == [True] + [False] * 7


def hanging(method, k):
    """Positions at 61 frames of 0.02 s of a cloth that swings from one side, k steps to a frame."""
    one = cloth(7, 7, size=1.5, vertIsFixed=[i < 7 for i in range(49)], damping=0.05, dragCoefficient=0.0)
    one |= {"vertMass": [0.02] * 49, "springStiffness": [60.0] * len(one["springStiffness"])}
    memory = run(physics.system(one, integrationMethod=method, delta=0.02 / k), 60 * k, 1e-9)
    assert memory.euler.sum() == (1 if method == BDF2 else 0)
    return memory.x[::k]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="hundreds of steps are slow without compilation")
def test_a_hanging_cloth_is_five_times_nearer_to_the_converged_motion_than_by_euler_steps():
    finest, finer = (hanging(BDF2, k) for k in (32, 16))
    exact, by_steps = finest + (finest - finer) / 3, [(IMPLICIT, 1), (BDF2, 1), (BDF2, 2), (BDF2, 4)]
    euler, one, two, four = (np.sqrt(((hanging(*each) - exact) ** 2).sum(axis=2).mean()) for each in by_steps)
    assert one < 0.2 * euler
    assert abs(np.log2(two / four) - 2) < 0.4  # steps of 0.01 s are not yet short beside the cloth's oscillations
    assert one / two > 2.0


def test_euler_steps_are_those_that_would_add_energy_and_the_ones_after_a_shortened_step():
    system = crushed(delta=0.2, integrationMethod=BDF2)
    memory = run(system, 60, 1e-8)
    assert memory.euler[1:].any()
    assert not memory.euler.all()
    inner, weight = energies(system, memory)
    assert (np.diff(inner + weight) <= guard.SLACK * inner[:-1] + guard.LEAST_RISE + 1e-13 * inner.max()).all()
    short = np.flatnonzero(memory.theta[:-1] < 1)
    assert len(short)
    assert memory.euler[short].all()
    assert memory.euler[short + 1].all()


def test_an_ordinary_cloth_takes_bdf2_steps_only():
    one = cloth(6, 6, size=1.0, damping=0.1, dragCoefficient=0.1, vertMass=[0.01] * 36)
    memory = run(physics.system(one, integrationMethod=BDF2, delta=0.02), 100, 1e-6)
    assert memory.euler.sum() == 1
    assert not memory.clamped.any()


def test_the_sudden_stop_on_a_sphere_is_survived():
    one = cloth(5, 5, size=1.0, vertIsFixed=[False] * 25, vertMass=[0.05] * 25, dragCoefficient=0.0)
    ground = {"delta": 0.02, "colliders": [ball((0.5, -1.5, 0.5), 0.9)]}
    memory = run(physics.system(one, integrationMethod=BDF2, **ground), 100, 1e-6)
    assert np.abs(memory.w).max() < 20.0  # m/s; it falls from 0.6 m, and rolls off
