"""One step of each scheme against the scene format written down with dense matrices, and its derivatives."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import METHODS, STATES, TIGHT, dense_forces, full, relative

from clothfit.base.arrays import Elements
from clothfit.engine.step import explicit, implicit
from clothfit.engine.system import EXPLICIT, IMPLICIT, clamped, with_elements

FIXED = [0, 2]
VARIANTS = [("explicit", 1), ("symplectic", 1), ("implicit", 1), ("implicit", 2), ("implicit", 5)]


def system(method="implicit", newton=1, delta=0.02):
    return full(fixed=FIXED, integrationMethod=METHODS[method], forwardSubSteps=newton, delta=delta)


def start(system, name):
    """State whose fixed vertices are at rest."""
    at, free = physics.state(system, name), system.vertex.free[:, None]
    return at._replace(u=at.u * free, du=at.du * free)


def taken(system, x, v, tolerance=TIGHT, first=None):
    """Velocities of the iterations used (k, n, 3), CG iterations, direct solves."""
    w = np.zeros((system.newton_iterations, *x.shape))
    if system.method != IMPLICIT:
        explicit.step(system, x, v, w[0], np.empty_like(x))
        return w, 0, 0
    work = implicit.workspace(system)
    implicit.prepare(system, x, v, work)
    used, iterations, direct = implicit.step(system, x, v, v if first is None else first, tolerance, work, w)
    return w[:used], iterations, direct


def as_taken(system, at):
    """The system, clamped where a step from this state has to be."""
    return system if len(taken(system, at.y, at.u)[0]) else clamped(system)


def dense_step(system, x, v):
    """The velocity after the step of the scene format: for implicit ones, linearised."""
    h, implicitly = system.h, float(system.method == IMPLICIT)
    f, K, D = dense_forces(system, x, v)
    M, unknown = np.kron(np.diag(system.vertex.mass), np.eye(3)), np.repeat(system.vertex.free, 3)
    A = M - implicitly * (h * D + h * h * K)
    right = (M - implicitly * h * D) @ v.reshape(-1) + h * f.reshape(-1)
    w = np.zeros(x.size)
    w[unknown] = np.linalg.solve(A[np.ix_(unknown, unknown)], right[unknown])
    return w.reshape(x.shape), np.linalg.eigvalsh(A[np.ix_(unknown, unknown)]).min()


@pytest.mark.parametrize("name", STATES)
@pytest.mark.parametrize("method", ["explicit", "symplectic", "implicit"])
def test_the_step_is_that_of_the_scene_format(method, name):
    one = system(method)
    at = start(one, name)
    one = as_taken(one, at)
    assert (one.springs.cap == 1.0) == (name == "compressed" and method == "implicit")
    w = taken(one, at.y, at.u)[0][-1]
    # explicit: sums of some tens of terms; implicit: condition number below 1e3, residual 1e-14
    assert relative(w, dense_step(one, at.y, at.u)[0]) < (1e-10 if method == "implicit" else 1e-13)
    assert np.abs(w[FIXED]).max() == 0.0


def test_a_compressed_cloth_has_an_indefinite_matrix_and_is_stepped_in_the_clamped_form():
    one = system()
    one = with_elements(one, Elements(one.vertex.mass, 40 * one.springs.stiffness))
    at, safe = start(one, "compressed"), clamped(one)
    expected, least = dense_step(safe, at.y, at.u)
    assert dense_step(one, at.y, at.u)[1] < 0 < 0.99 * one.vertex.mass.min() < least
    assert len(taken(one, at.y, at.u)[0]) == 0  # refused
    w, _, direct = taken(safe, at.y, at.u)
    assert (len(w), direct) == (1, 0)
    assert relative(w[0], expected) < 1e-10  # condition number below 1e4


def residual(system, x, v, w):
    """M (w − v) − h f(x + h w, w) of the free vertices, and the size of its terms."""
    f = system.h * dense_forces(system, x + system.h * w, w)[0]
    free = system.vertex.free
    return np.linalg.norm((system.vertex.mass[:, None] * (w - v) - f)[free]), np.linalg.norm(f[free])


@pytest.mark.parametrize("name", ["rest", "random", "stretched"])
def test_newton_starts_from_the_linearised_step_and_solves_backward_euler(name):
    # the Jacobians are not complete, so the convergence is linear: a small time step keeps it quick
    many = system(newton=60, delta=0.005)
    at = start(many, name)
    w, once = (taken(each, at.y, at.u, 1e-12)[0] for each in (many, system(delta=0.005)))
    np.testing.assert_array_equal(w[0], once[0])  # the same operations
    error, size = residual(many, at.y, at.u, w[-1])
    assert 2 < len(w) < 60  # the residual was within tolerance before the iterations ran out
    assert error < 1e-10 * size  # tolerance relative to a right-hand side that contains A u
    assert residual(many, at.y, at.u, w[0])[0] > 1e3 * error


def test_a_step_with_nothing_left_to_improve_stops_early():
    still = physics.system(physics.thing([(0, 0, 0)]), forwardSubSteps=5)  # free fall is linear
    assert len(taken(still, still.x0, np.zeros((1, 3)))[0]) == 1


def test_a_good_guess_costs_no_iteration():
    one = system()
    at = start(one, "stretched")
    w, iterations, direct = taken(one, at.y, at.u, 1e-10)
    assert (iterations > 0, direct) == (True, 0)
    assert taken(one, at.y, at.u, 1e-9, w[0])[1:] == (0, 0)


def push(system, at, change):
    """The change of the velocity and of the position after the step (2, n, 3); explicit positions go with the old one.
    """
    (w, *_), dx, dv, work = taken(system, at.y, at.u), at.dy.copy(), at.du.copy(), implicit.workspace(system)
    if system.method == IMPLICIT:
        implicit.pushforward(system, at.y, at.u, w, len(w), 1.0, TIGHT, work, dx, dv, change)
    else:
        explicit.pushforward(system, at.y, at.u, w[0], work, dx, dv, change)
    return np.array([dx, dv])


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
@pytest.mark.parametrize("name", STATES)
def test_the_pushforward_is_the_derivative_of_the_step(name, method, newton):
    one = system(method, newton, delta=0.005)
    at = start(one, name)
    one, change = as_taken(one, at), physics.direction(one)

    def moved(t):
        y, u = at.y + t * at.dy, at.u + t * at.du
        w = taken(physics.shifted(one, change, t), y, u)[0][-1]
        return np.array([y + one.h * (u if one.method == EXPLICIT else w), w])

    t = 1e-6
    # solves good to 1e-13 and a difference at 1e-6 leave 1e-7; truncation 1e-12 times third derivatives
    assert relative(push(one, at, change), (moved(t) - moved(-t)) / (2 * t)) < (1e-6 if method == "implicit" else 1e-8)


@pytest.mark.parametrize(("method", "newton"), VARIANTS)
@pytest.mark.parametrize("name", STATES)
def test_the_pullback_is_the_transpose_of_the_pushforward(name, method, newton):
    one = system(method, newton)
    at = start(one, name)
    one, change, grad = as_taken(one, at), physics.direction(one), physics.nothing(one)
    w, work = taken(one, at.y, at.u)[0], implicit.workspace(one)
    x_bar, v_bar, out = at.lam.copy(), at.w.copy(), push(one, at, change)
    terms = np.array([x_bar, v_bar]) * out
    if one.method == IMPLICIT:
        implicit.pullback(one, at.y, at.u, w, len(w), 1.0, TIGHT, work, x_bar, v_bar, grad)
    else:
        explicit.pullback(one, at.y, at.u, w[0], work, x_bar, v_bar, grad)
    back = np.vdot(x_bar, at.dy) + np.vdot(v_bar, at.du) + physics.product(grad, change)
    assert abs(terms.sum() - back) < 1e-12 * np.abs(terms).sum()  # solves to 1e-14, condition number below 100


def test_fixed_vertices_pass_positions_on_and_no_velocities():
    for method in ("explicit", "symplectic", "implicit"):
        one = system(method)
        at = start(one, "stretched")
        dx, dv = push(one, at, physics.direction(one))
        assert np.abs(dv[FIXED]).max() == 0.0
        np.testing.assert_array_equal(dx[FIXED], at.dy[FIXED])
