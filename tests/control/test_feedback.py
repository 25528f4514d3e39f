"""The regulator: its gains against those of the algebraic equation, its model against differences of steps."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.physics import scene, thing, xyz
from scipy.linalg import solve_discrete_are

from clothfit import Forces, Key, load_forces, save_forces
from clothfit.control import feedback
from clothfit.control.controls import modes_of
from clothfit.control.feedback import Tangent, riccati, with_gains
from clothfit.engine.rollout import fill, rollout
from clothfit.engine.step import implicit
from clothfit.engine.system import build
from clothfit.motion.simulate import answered, simulate

NONE = xyz((0, 0, 0))
ALL = np.arange(12)


def planned(own, vertices, steps=30, size=0.05):
    """Forces that swing some vertices to and fro."""
    values = np.zeros((steps, 12, 3))
    turn = np.linspace(0.0, 6.0, steps)[:, None]
    values[:, vertices] = size * np.stack([np.sin(turn), np.cos(turn), np.sin(2.0 * turn)], axis=2)
    return Forces(own.delta * np.arange(steps), values)


def keys_of(own, plan, steps):
    """A key on all vertices where a plan leads, after so many steps."""
    x = simulate(own.with_forces(plan), len(plan.times) + 1).positions
    return [Key(step, 0, ALL.astype(np.int32), x[step]) for step in steps]


@pytest.mark.slow
def test_gains_of_a_cloth_at_rest_are_those_of_its_oscillator():
    """A vertex on a spring at its rest length swings along it, and is free across it."""
    pair = thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], mass=0.3, stiffness=50.0, fixed=(0,))
    own = scene(pair, delta=0.02, gravity=NONE, tolerance=1e-14)
    steps, h, m, price = 500, 0.02, 0.3, 0.04
    system = build(own.with_forces(Forces(h * np.arange(steps), np.zeros((steps, 2, 3)))), 0, steps=steps)
    motion, _ = rollout(system, steps, 1e-14)
    shapes = modes_of(own.cloths[0], np.array([1], np.int32), 1)
    assert abs(shapes[0, 0]) == pytest.approx(m**-0.5, rel=1e-12)
    tangent = Tangent(system, np.array([[m**-0.5]]), np.ones((1, 1)))
    found = riccati(tangent, motion, [np.array([[2.0]])] * steps, price * np.eye(3))
    for axis, k in enumerate((50.0, 0.0, 0.0)):
        v = np.array([-h * k, m]) / (m + h * h * k)
        A = np.array([np.array([1.0, 0.0]) + h * v, v])
        B = np.sqrt(m) * np.array([[h * h], [h]]) / (m + h * h * k)  # of (q, p) = √m (x, v)
        P = solve_discrete_are(A, B, np.diag([2.0, 0.0]), np.array([[price]]))
        known = np.linalg.solve(price + B.T @ P @ B, B.T @ P @ A)[0]
        np.testing.assert_allclose(found[0, axis, [axis, 3 + axis]], known, rtol=1e-8)
    across = found[0].copy()
    for axis in range(3):
        across[axis, [axis, 3 + axis]] = 0.0
    assert np.abs(across).max() < 1e-9 * np.abs(found[0]).max()  # the axes do not touch each other


@pytest.mark.slow
@pytest.mark.parametrize(("method", "newton"), [("implicit", 1), ("implicit", 3), ("symplectic", 1), ("explicit", 1)])
def test_the_model_is_the_tangent_of_a_step(flag, method, newton):
    """With all modes, against central differences of one step from a state in a motion."""
    own = flag(method, delta=0.005, forwardSubSteps=newton, tolerance=1e-14)
    plan, t, free = planned(own, [5, 6], steps=12), 7, np.flatnonzero(~own.cloths[0].fixed)
    system = build(own.with_forces(plan), 0, steps=12)
    motion, _ = rollout(system, 12, 1e-14)
    shapes = modes_of(own.cloths[0], free.astype(np.int32), len(free))
    mass = own.cloths[0].mass[free]
    np.testing.assert_allclose(shapes.T @ (mass[:, None] * shapes), np.eye(len(free)), atol=1e-12)
    push = np.zeros((len(free), 1))
    push[2] = 1.0
    A, B = Tangent(system, shapes, push).matrices(motion, t)
    rng, step = np.random.default_rng(3), 1e-6
    dz, dg = rng.normal(size=A.shape[1]), rng.normal(size=3)

    def after(scale):
        """The coordinates after step t, from a state that is moved by so much."""
        dx, dv = (np.zeros((12, 3)) for _ in range(2))
        dx[free], dv[free] = (scale * shapes @ part.reshape(-1, 3) for part in np.split(dz, 2))
        values = plan.values.copy()
        values[t, free[2]] += scale * dg
        moved = build(own.with_forces(replace(plan, values=values)), 0, steps=12)
        one, _ = rollout(moved, 12, 1e-14)  # memory of the right shape; its step t is taken again
        again = one.part(t, t + 1)._replace(x=np.array(motion.x[t : t + 2] + dx), v=motion.velocity(t) + dv)
        assert fill(moved, 1e-14, implicit.workspace(moved), again) == 1
        return np.concatenate(
            [((mass[:, None] * shapes).T @ y[free]).reshape(-1) for y in (again.x[1], again.w[0, again.used[0] - 1])]
        )

    difference = (after(step) - after(-step)) / (2.0 * step)
    np.testing.assert_allclose(A @ dz + B @ dg, difference, atol=1e-6 * np.abs(difference).max())


@pytest.mark.slow
def test_no_force_of_a_feedback_is_above_its_bound(flag):
    own = flag()
    plan = planned(own, [5, 6])
    bound = 1.01 * np.linalg.norm(plan.values, axis=2).max()
    back = replace(with_gains(own, plan, keys_of(own, plan, [30]), bound), pulls=True)
    other = own.with_values([1.5 * own.cloths[0].mass], [own.cloths[0].stiffness])
    acts = answered(other.with_forces(back), 30, 1e-12).forces
    size = np.linalg.norm(acts.values, axis=2)
    assert size.max() == pytest.approx(bound, rel=1e-12)  # the cloth is so heavy that it is reached
    assert not acts.values[:, [0, 1, 2, 3, 4, 7, 8, 9, 10, 11]].any()
    assert np.abs(acts.values - plan.values).max() > 0.05 * bound


@pytest.mark.slow
def test_steps_that_are_not_those_of_the_plan(flag):
    """Half as long steps: the reference is between that of the rows."""
    own = flag()
    plan = planned(own, [5, 6], size=0.01)
    back = replace(with_gains(own, plan, keys_of(own, plan, [30])), pulls=True)
    finer = own.with_step(0.5 * own.delta, 61)
    here = simulate(own.with_forces(plan), 31).positions
    apart, left = (
        np.abs(simulate(finer.with_forces(each), 61).positions[::2] - here).max() for each in (plan, back)
    )
    assert left < apart  # the feedback takes the error of the longer steps for a disturbance


@pytest.mark.slow
def test_a_file_keeps_the_gains(flag, tmp_path):
    own = flag()
    plan = planned(own, [5, 6])
    made = with_gains(own, plan, keys_of(own, plan, [30]))
    save_forces(made, tmp_path / "f.npz")
    again = load_forces(tmp_path / "f.npz", 12, pulls=True)
    for name in ("measure", "push", "gains", "reference", "bound"):
        np.testing.assert_array_equal(getattr(again.regulator, name), getattr(made.regulator, name))
    other = own.with_values([1.05 * own.cloths[0].mass], [own.cloths[0].stiffness])
    one, two = (simulate(other.with_forces(replace(each, pulls=True)), 31).positions for each in (made, again))
    np.testing.assert_array_equal(one, two)


@pytest.mark.slow
def test_springs_are_kept_where_forces_act_on_all_free_vertices(flag):
    own = flag()
    plan = planned(own, np.flatnonzero(~own.cloths[0].fixed))
    springs = replace(plan, gain=np.ones((30, 12)), places=np.zeros((30, 12, 3)))
    assert with_gains(own, springs, keys_of(own, plan, [30])) is springs


def test_long_motions_get_fewer_modes():
    assert feedback.count_of(132, 14, 100) == (100, 14)
    assert feedback.count_of(3, 9, 10) == (3, 9)
    k, m = feedback.count_of(4000, 400, 1000)
    assert 1 <= m <= k < 100
    assert 18 * k * m * 1000 <= feedback.MOST_NUMBERS
