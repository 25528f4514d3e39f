"""The explicit and the symplectic step against their formulas, and their derivatives."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import STATES, dense_forces, full, relative, state

from clothfit.base.arrays import NO_NUMBERS
from clothfit.engine.step import explicit, implicit, transition
from clothfit.engine.system import EXPLICIT, SYMPLECTIC

FIXED = [0, 2]
METHODS = [EXPLICIT, SYMPLECTIC]


def system(method):
    return full(fixed=FIXED, integrationMethod=method, delta=0.005)


def start(system, name):
    """State whose fixed vertices are at rest."""
    at = state(system, name)
    free = system.vertex.free[:, None]
    return at._replace(u=at.u * free, du=at.du * free)


def step(system, x, v):
    """Position and velocity after the step."""
    w, x_new = np.empty((1, *x.shape)), np.empty_like(x)
    transition.step(system, x, v, v, 1e-12, implicit.workspace(system), w, x_new)
    return x_new, w[0]


@pytest.mark.parametrize("name", STATES)
def test_both_steps_are_those_of_the_scene_format(name):
    one, other = (system(method) for method in METHODS)
    at = start(one, name)
    f = dense_forces(one, at.y, at.u)[0]
    v_new = (at.u + one.h * f / one.vertex.mass[:, None]) * one.vertex.free[:, None]
    for made, expected in (
        (step(one, at.y, at.u), at.y + one.h * at.u),
        (step(other, at.y, at.u), at.y + one.h * v_new),
    ):
        # sums of some tens of terms of one size
        np.testing.assert_allclose(made[1], v_new, atol=1e-13 * np.abs(v_new).max())
        np.testing.assert_allclose(made[0], expected, atol=1e-13)


@pytest.mark.parametrize("method", METHODS)
def test_fixed_vertices_stay(method):
    one = system(method)
    at = start(one, "stretched")
    x_new, v_new = step(one, at.y, at.u)
    np.testing.assert_array_equal(x_new[FIXED], at.y[FIXED])
    assert np.abs(v_new[FIXED]).max() == 0.0


def push(system, at, change):
    """dx, dv after the step."""
    dx, dv = at.dy.copy(), at.du.copy()
    v_new = step(system, at.y, at.u)[1]
    explicit.pushforward(system, at.y, at.u, v_new, implicit.workspace(system), dx, dv, change)
    return dx, dv


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["random", "stretched", "compressed"])
def test_the_pushforward_misses_of_the_true_derivative_nothing_but_what_the_forces_leave_out(name, method):
    # without drag, spheres and spring damping the step's model is the force itself and its derivative the true one
    one = system(method)
    one = one._replace(
        springs=one.springs._replace(damping=0.0),
        faces=one.faces._replace(corners=one.faces.corners[:0]),
    )
    # the one coefficient of damping belongs to vertices and springs together
    check_derivative(one, start(one, name), physics.direction(one)._replace(damping=NO_NUMBERS))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["random", "stretched", "compressed"])
def test_the_pushforward_is_the_derivative_of_the_step_with_every_force(name, method):
    one = system(method)
    check_derivative(one, start(one, name), physics.direction(one))


def check_derivative(system, at, change):
    t = 1e-6

    def moved(t):
        return np.array(step(physics.shifted(system, change, t), at.y + t * at.dy, at.u + t * at.du))

    measured = (moved(t) - moved(-t)) / (2 * t)
    # rounding 1e-16 / 1e-6, truncation 1e-12 times third derivatives
    assert relative(np.array(push(system, at, change)), measured) < 1e-8


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", STATES)
def test_the_pullback_is_the_transpose_of_the_pushforward(name, method):
    one = system(method)
    at = start(one, name)
    change = physics.direction(one)
    dx, dv = push(one, at, change)
    x_bar, v_bar = at.lam.copy(), at.w.copy()
    forward = np.vdot(x_bar, dx) + np.vdot(v_bar, dv)
    size = np.abs(x_bar * dx).sum() + np.abs(v_bar * dv).sum()
    grad = physics.nothing(one)
    v_new = step(one, at.y, at.u)[1]
    explicit.pullback(one, at.y, at.u, v_new, implicit.workspace(one), x_bar, v_bar, grad)
    back = np.vdot(x_bar, at.dy) + np.vdot(v_bar, at.du) + physics.product(grad, change)
    assert abs(forward - back) < 1e-12 * size  # rounding of sums of some 100 products
