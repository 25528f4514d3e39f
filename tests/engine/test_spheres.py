"""Sphere colliders against their formula, and their derivatives against finite differences."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import STATES, ball, full, pushforward_error, relative, state, step_terms, times, transpose_error

from clothfit.engine.forces import spheres

SYSTEM = full(colliders=[ball((1.0, -0.3, 1.0), 0.8), ball((0.5, 0.4, 1.5), 0.9)])
SPHERES = SYSTEM.spheres


def test_the_push_is_1000_newton_per_metre_of_depth_outward():
    one = spheres.build([[1.0, 2.0, 3.0]], [0.5])
    y = np.array([[1.3, 2.0, 3.0], [1.0, 2.0, 2.6], [1.6, 2.0, 3.0], [1.0, 2.0, 3.0]])
    f = physics.total_force(spheres, one, y, np.zeros_like(y))
    # depths 0.2 m and 0.1 m; outside; at the centre, pushed up by the whole radius. y − c is rounded at 1e-16
    np.testing.assert_allclose(f, [[200, 0, 0], [0, 0, -100], [0, 0, 0], [0, 500, 0]], atol=1e-11)


def test_the_radius_is_half_the_scale():
    assert SPHERES.radius.tolist() == [0.8, 0.9]


def test_pushes_of_several_spheres_add_up():
    at = state(SYSTEM, "random")
    both = physics.total_force(spheres, SPHERES, at.y, at.u)
    each = [spheres.Spheres(SPHERES.centre[[c]], SPHERES.radius[[c]]) for c in (0, 1)]
    first, second = (physics.total_force(spheres, one, at.y, at.u) for one in each)
    assert min(np.abs(first).max(), np.abs(second).max()) > 0
    np.testing.assert_allclose(both, first + second, rtol=1e-14, atol=1e-12)  # one rounding of some 100 N


@pytest.mark.parametrize("name", STATES)
def test_the_matrix_keeps_the_normal_part_of_the_stiffness(name):
    at = state(SYSTEM, name)
    A, b = step_terms(SYSTEM, spheres, SPHERES, at.y, at.u)
    expected = np.zeros_like(at.y)
    for centre, radius in zip(SPHERES.centre, SPHERES.radius, strict=True):
        n = (at.y - centre) / np.linalg.norm(at.y - centre, axis=1, keepdims=True)
        inside = np.linalg.norm(at.y - centre, axis=1) < radius
        expected += inside[:, None] * 1000 * n * (n * at.dy).sum(axis=1, keepdims=True)
    # the same products in another order
    assert relative(times(A, at.dy), SYSTEM.h**2 * expected) < 1e-14
    assert relative(b, SYSTEM.h * physics.total_force(spheres, SPHERES, at.y, at.u)) < 1e-14


def test_along_the_normal_the_matrix_is_the_true_jacobian():
    one = physics.system(physics.thing([(0.1, 0.3, 0.2)]), colliders=[ball((0, 0, 0), 1.0)])
    y, t = one.x0, 1e-6
    A, _ = step_terms(one, spheres, one.spheres, y, y)
    above = physics.total_force(spheres, one.spheres, (1 + t) * y, y)
    below = physics.total_force(spheres, one.spheres, (1 - t) * y, y)
    # linear in the distance: the difference of forces of 600 N at 1e-6 leaves 1e-10
    assert relative(times(A, y), -(one.h**2) * (above - below) / (2 * t)) < 1e-8


@pytest.mark.parametrize("name", STATES)
def test_the_pushforward_is_the_derivative_of_the_model(name):
    # central differences at 1e-5, 0.3 m and more from the centres: truncation 1e-10 / 0.3², rounding 1e-11
    assert pushforward_error(SYSTEM, "spheres", state(SYSTEM, name)) < 1e-7


@pytest.mark.parametrize("name", STATES)
def test_the_pullback_is_the_transpose_of_the_pushforward(name):
    assert transpose_error(SYSTEM, "spheres", state(SYSTEM, name)) < 1e-12  # rounding of sums of some tens of products


def test_at_the_centre_the_derivatives_stay_finite():
    one = physics.system(physics.thing([(0, 0, 0)]), colliders=[ball((0, 0, 0), 1.0)])
    at = state(one, "rest")
    assert np.isfinite(physics.pushforward(one, spheres, one.spheres, at, physics.direction(one))).all()
    assert transpose_error(one, "spheres", at) < 1e-12


def test_no_spheres_no_rows():
    none = spheres.build([], [])
    assert none.centre.shape == (0, 3)
    assert none.radius.shape == (0,)
