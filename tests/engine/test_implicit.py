"""The implicit step against the scene format written down with dense matrices, and its derivatives."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import STATES, TIGHT, dense_forces, full, relative, state

from clothfit.base.arrays import Elements
from clothfit.engine.step import implicit, transition
from clothfit.engine.system import clamped, with_elements

FIXED = (0, 2)


def system(newton=1, delta=0.02):
    return full(fixed=FIXED, forwardSubSteps=newton, delta=delta)


def start(system, name):
    """State whose fixed vertices are at rest."""
    at = state(system, name)
    return at._replace(u=at.u * system.vertex.free[:, None])


def as_taken(system, x, v):
    """The system, clamped where a step from this state has to be."""
    return system if len(step(system, x, v)[0]) else clamped(system)


def step(system, x, v, tolerance=TIGHT):
    """Velocities of the iterations used (k, n, 3), CG iterations, direct solves."""
    iterates = np.zeros((system.newton_iterations, *x.shape))
    used, iterations, direct = from_guess(system, x, v, v, tolerance, iterates)
    return iterates[:used], iterations, direct


def from_guess(system, x, v, first, tolerance, iterates):
    """The step with a first guess of the velocity."""
    work = implicit.workspace(system)
    implicit.prepare(system, x, v, work)
    return implicit.step(system, x, v, first, tolerance, work, iterates)


def dense_step(system, x, v):
    """The linearised step of the scene format."""
    h, n = system.h, len(x)
    f, K, D = dense_forces(system, x, v)
    M = np.kron(np.diag(system.vertex.mass), np.eye(3))
    unknown = np.repeat(system.vertex.free, 3)
    right = (M - h * D) @ v.reshape(-1) + h * f.reshape(-1)
    w = np.zeros(3 * n)
    w[unknown] = np.linalg.solve((M - h * D - h * h * K)[np.ix_(unknown, unknown)], right[unknown])
    return w.reshape(n, 3)


def residual(system, x, v, w):
    """M (w − v) − h f(x + h w, w) of the free vertices, and the size of its terms."""
    f, _, _ = dense_forces(system, x + system.h * w, w)
    terms = system.vertex.mass[:, None] * (w - v), system.h * f
    free = system.vertex.free
    return np.linalg.norm((terms[0] - terms[1])[free]), np.linalg.norm(terms[1][free])


@pytest.mark.parametrize("name", STATES)
def test_the_linearised_step_is_that_of_the_scene_format(name):
    at = start(system(), name)
    one = as_taken(system(), at.y, at.u)
    assert (one.springs.cap == 1.0) == (name == "compressed")
    velocities, _, _ = step(one, at.y, at.u)
    # condition number below 1e3, residual 1e-14
    assert relative(velocities[-1], dense_step(one, at.y, at.u)) < 1e-10
    assert np.abs(velocities[-1][list(FIXED)]).max() == 0.0


def least_eigenvalue(system, at):
    """Of the matrix of the step of the scene format, or of its clamped form."""
    _, K, D = dense_forces(system, at.y, at.u)
    A = np.kron(np.diag(system.vertex.mass), np.eye(3)) - system.h * D - system.h**2 * K
    unknown = np.repeat(system.vertex.free, 3)
    return np.linalg.eigvalsh(A[np.ix_(unknown, unknown)]).min()


def test_a_compressed_cloth_has_an_indefinite_matrix_and_is_stepped_in_the_clamped_form():
    one = system()
    one = with_elements(one, Elements(one.vertex.mass, 40 * one.springs.stiffness))
    at = start(one, "compressed")
    safe = clamped(one)
    assert least_eigenvalue(one, at) < 0 < 0.99 * one.vertex.mass.min() < least_eigenvalue(safe, at)
    w, x_new, work = np.zeros((1, *at.y.shape)), np.zeros_like(at.y), implicit.workspace(one)
    transition.prepare(one, at.y, at.u, work)
    assert transition.step(one, at.y, at.u, at.u, TIGHT, work, w, x_new)[0] == 0  # refused
    transition.prepare(safe, at.y, at.u, work)
    used, _, direct = transition.step(safe, at.y, at.u, at.u, TIGHT, work, w, x_new)
    assert (used, direct) == (1, 0)
    assert relative(w[0], dense_step(safe, at.y, at.u)) < 1e-10  # condition number below 1e4
    np.testing.assert_array_equal(x_new, at.y + one.h * w[0])


@pytest.mark.parametrize("name", ["rest", "random", "stretched"])
def test_newton_starts_from_the_linearised_step_and_solves_backward_euler(name):
    # the Jacobians are not complete, so the convergence is linear: a small time step keeps it quick
    many = system(newton=60, delta=0.005)
    at = start(many, name)
    velocities, _, _ = step(many, at.y, at.u, 1e-12)
    np.testing.assert_array_equal(
        velocities[0], step(system(delta=0.005), at.y, at.u, 1e-12)[0][0]
    )  # the same operations
    error, size = residual(many, at.y, at.u, velocities[-1])
    assert 2 < len(velocities) < 60  # the residual was within tolerance before the iterations ran out
    assert error < 1e-10 * size  # tolerance relative to a right-hand side that contains A u
    assert residual(many, at.y, at.u, velocities[0])[0] > 1e3 * error


def test_a_step_with_nothing_left_to_improve_stops_early():
    still = physics.system(physics.thing([(0, 0, 0)]), forwardSubSteps=5)  # free fall is linear
    velocities, _, _ = step(still, still.x0, np.zeros((1, 3)))
    assert len(velocities) == 1


def test_a_good_guess_costs_no_iteration():
    one = system()
    at = start(one, "stretched")
    velocities, iterations, direct = step(one, at.y, at.u, 1e-10)
    again = from_guess(one, at.y, at.u, velocities[0], 1e-9, np.zeros_like(velocities))
    assert (iterations > 0, direct) == (True, 0)
    assert again == (1, 0, 0)


def push(system, at, velocities, change, tolerance=TIGHT):
    """dx, dv after the step for dx, dv before it."""
    dx, dv = at.dy.copy(), at.du.copy()
    work = implicit.workspace(system)
    implicit.pushforward(system, at.y, at.u, velocities, len(velocities), 1.0, tolerance, work, dx, dv, change)
    return dx, dv


@pytest.mark.parametrize("newton", [1, 2, 5])
@pytest.mark.parametrize("name", STATES)
def test_the_pushforward_is_the_derivative_of_the_step(name, newton):
    one = system(newton, delta=0.005)
    at = start(one, name)
    one = as_taken(one, at.y, at.u)
    at = at._replace(du=at.du * one.vertex.free[:, None])
    change, t = physics.direction(one), 1e-6

    def moved(t):
        v = at.u + t * at.du
        w = step(physics.shifted(one, change, t), at.y + t * at.dy, v)[0][-1]
        return np.array([at.y + t * at.dy + one.h * w, w])

    velocities = step(one, at.y, at.u)[0]
    assert len(velocities) == newton
    measured = (moved(t) - moved(-t)) / (2 * t)
    # solves good to 1e-13 and a difference at 1e-6 leave 1e-7; truncation 1e-12 times third derivatives
    assert relative(np.array(push(one, at, velocities, change)), measured) < 1e-6


@pytest.mark.parametrize("newton", [1, 2, 5])
@pytest.mark.parametrize("name", STATES)
def test_the_pullback_is_the_transpose_of_the_pushforward(name, newton):
    one = system(newton)
    at = start(one, name)
    one = as_taken(one, at.y, at.u)
    at = at._replace(du=at.du * one.vertex.free[:, None])
    change = physics.direction(one)
    velocities = step(one, at.y, at.u)[0]
    dx, dv = push(one, at, velocities, change)
    x_bar, v_bar = at.lam.copy(), at.w.copy()
    forward = np.vdot(x_bar, dx) + np.vdot(v_bar, dv)
    size = np.abs(x_bar * dx).sum() + np.abs(v_bar * dv).sum()
    grad = physics.nothing(one)
    work = implicit.workspace(one)
    implicit.pullback(one, at.y, at.u, velocities, len(velocities), 1.0, TIGHT, work, x_bar, v_bar, grad)
    back = np.vdot(x_bar, at.dy) + np.vdot(v_bar, at.du) + physics.product(grad, change)
    assert abs(forward - back) < 1e-12 * size  # solves to 1e-14, condition number below 100


def test_fixed_vertices_pass_positions_on_and_no_velocities():
    one = system()
    at = start(one, "stretched")
    velocities = step(one, at.y, at.u)[0]
    dx, dv = push(one, at, velocities, physics.direction(one))
    assert np.abs(dv[list(FIXED)]).max() == 0.0
    np.testing.assert_array_equal(dx[list(FIXED)], at.dy[list(FIXED)])
