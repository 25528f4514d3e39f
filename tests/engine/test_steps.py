"""One step of each scheme against the scene format written down with dense matrices, and its derivatives."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import METHODS, STATES, TIGHT, dense_forces, full, relative

from clothfit.base.arrays import Elements
from clothfit.engine.step import explicit, implicit
from clothfit.engine.system import IMPLICIT, clamped, with_elements

FIXED = [0, 2]


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
