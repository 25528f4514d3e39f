"""Springs against their formulas, conservation laws and finite differences."""

import numpy as np
import pytest
from helpers import physics
from helpers.matrices import dense_matrix
from helpers.physics import (
    STATES,
    damping,
    full,
    pushforward_error,
    relative,
    state,
    step_terms,
    times,
    transpose_error,
)

from clothfit.base.arrays import Elements
from clothfit.engine.forces import springs
from clothfit.engine.system import clamped

SYSTEM = full()
SPRINGS = SYSTEM.springs
ALPHA = 0.7


def test_rest_lengths_are_the_lengths_at_the_start():
    expected = [np.linalg.norm(SYSTEM.x0[a] - SYSTEM.x0[b]) for a, b in SPRINGS.ends]
    np.testing.assert_allclose(SPRINGS.rest, expected, rtol=1e-15)  # one rounding each


def test_one_stretched_damped_spring_by_hand():
    one = physics.system(physics.thing([(0, 0, 0), (3, 4, 0)], [(0, 1)], stiffness=20.0, damping=0.5))
    y, u = np.array([[0.0, 0, 0], [6, 8, 0]]), np.array([[0.0, 0, 0], [1, 2, 3]])
    f = physics.total_force(springs, one.springs, y, u)
    # stretched from 5 m to 10 m along (0.6, 0.8, 0), opening at 2.2 m/s: 20 · 5 N + 0.25 · 20 · 2.2 N
    pull = 20 * 5 + 0.25 * 20 * 2.2
    np.testing.assert_allclose(f, [[0.6 * pull, 0.8 * pull, 0], [-0.6 * pull, -0.8 * pull, 0]], rtol=1e-14)


def test_springs_at_rest_exert_nothing():
    f = physics.total_force(springs, SPRINGS, SYSTEM.x0, np.zeros_like(SYSTEM.x0))
    assert np.abs(f).max() == 0.0  # the length is computed in the same way as the rest length


@pytest.mark.parametrize("name", ["random", "stretched", "compressed"])
def test_internal_forces_sum_to_zero_in_force_and_torque(name):
    at = state(SYSTEM, name)
    f = physics.total_force(springs, SPRINGS, at.y, at.u)
    size = np.abs(f).sum()
    # each spring adds p and −p along its axis: rounding of the sum over 9 vertices
    assert np.abs(f.sum(axis=0)).max() < 1e-14 * size
    assert np.abs(np.cross(at.y, f).sum(axis=0)).max() < 1e-14 * size * np.abs(at.y).max()


def test_damping_does_not_resist_a_rigid_motion():
    at = state(SYSTEM, "random")
    spin = np.cross([0.3, -1.0, 0.5], at.y) + [1.0, 2.0, 3.0]
    drag = damping(springs, SPRINGS, at.y, at.u, spin)
    # the length of no spring changes: rounding of d·(ω × e) against k β times speeds of order 1
    assert np.abs(drag).max() < 1e-14 * (ALPHA / 2) * SPRINGS.stiffness.max() * np.abs(spin).max()


def test_damping_is_the_velocity_jacobian():
    at = state(SYSTEM, "random")
    change = physics.total_force(springs, SPRINGS, at.y, at.u + at.du) - physics.total_force(
        springs, SPRINGS, at.y, at.u
    )
    assert relative(damping(springs, SPRINGS, at.y, at.u, at.du), change) < 1e-13  # linear in u: rounding only


@pytest.mark.parametrize("name", STATES)
def test_the_matrix_is_the_true_jacobian_of_the_undamped_force(name):
    at, undamped, t = state(SYSTEM, name), SPRINGS._replace(damping=0.0), 1e-6

    def force(t):
        return physics.total_force(springs, undamped, at.y + t * at.dy, at.u)

    A, _ = step_terms(SYSTEM, springs, undamped, at.y, at.u)
    expected = -(SYSTEM.h**2) * (force(t) - force(-t)) / (2 * t)
    assert relative(times(A, at.dy), expected) < 1e-8  # differences of some 100 N at 1e-6, truncation 1e-11


def test_the_right_hand_side_leaves_the_damping_to_the_matrix():
    at = state(SYSTEM, "stretched")
    _, b = step_terms(SYSTEM, springs, SPRINGS, at.y, at.u)
    expected = SYSTEM.h * physics.total_force(springs, SPRINGS, at.y, np.zeros_like(at.u))
    assert relative(b, expected) < 1e-14  # f − D u is the elastic force


@pytest.mark.parametrize("name", ["random", "compressed"])
def test_the_clamped_matrix_has_no_push_sideways_and_the_same_force(name):
    safe, at = clamped(SYSTEM), state(SYSTEM, name)
    (A, b), (plain, same) = (step_terms(SYSTEM, springs, each.springs, at.y, at.u) for each in (safe, SYSTEM))
    eigenvalues = np.linalg.eigvalsh(dense_matrix(A))
    assert eigenvalues.min() > -1e-13 * eigenvalues.max() > np.linalg.eigvalsh(dense_matrix(plain)).min()  # rounding
    np.testing.assert_array_equal(b, same)


def test_nothing_is_clamped_where_no_spring_is_compressed():
    at = state(SYSTEM, "stretched")
    (A, _), (plain, _) = (step_terms(SYSTEM, springs, e.springs, at.y, at.u) for e in (clamped(SYSTEM), SYSTEM))
    np.testing.assert_array_equal(dense_matrix(A), dense_matrix(plain))


FORMS = pytest.mark.parametrize("one", [SYSTEM, clamped(SYSTEM)], ids=["as it is", "clamped"])


@pytest.mark.parametrize(
    ("name", "one"),  # at rest every spring is where its clamping begins, and the clamped model has a kink
    [(name, SYSTEM) for name in STATES] + [(name, clamped(SYSTEM)) for name in STATES if name != "rest"],
)
def test_the_pushforward_is_the_derivative_of_the_model(name, one):
    # central differences at 1e-5: truncation 1e-10 times a third derivative of some tens, rounding 1e-11
    assert pushforward_error(one, "springs", state(SYSTEM, name)) < 1e-7


@FORMS
@pytest.mark.parametrize("name", STATES)
def test_the_pullback_is_the_transpose_of_the_pushforward(name, one):
    assert transpose_error(one, "springs", state(SYSTEM, name)) < 1e-12  # rounding of sums of some 100 products


def test_a_spring_of_zero_length_exerts_nothing_and_stays_finite():
    one = physics.system(physics.thing([(0, 0, 0), (1, 0, 0)], [(0, 1)], stiffness=20.0, damping=0.5))
    at = state(one, "random")._replace(y=np.zeros((2, 3)))
    A, b = step_terms(one, springs, one.springs, at.y, at.u)
    change = Elements(np.ones(2), np.ones(1))
    out = physics.pushforward(one, springs, one.springs, at, change)
    assert [np.abs(array).max() for array in (A.diagonal, A.upper, b)] == [0, 0, 0]
    assert np.isfinite(out).all()


@pytest.mark.parametrize("rho", [0.5, 0.949, 0.951, 0.97, 0.999, 1.001, 1.5])
def test_the_derivative_of_the_rounded_clamp(rho):
    rounded, t = SPRINGS._replace(cap=1.0, bend=0.05), 1e-6
    low, high = (springs.capped(rounded, rho + sign * t)[0] for sign in (-1, 1))
    hat, bent = springs.capped(rounded, rho)
    assert 0.0 <= hat <= 1.0
    assert bent / rho == pytest.approx((high - low) / (2 * t), abs=1e-8)  # t² times a third derivative of 6/0.05²


@pytest.mark.parametrize("rho", [0.95, 1.0])
def test_the_rounded_clamp_has_no_kink(rho):
    rounded = SPRINGS._replace(cap=1.0, bend=0.05)
    before, after = (springs.capped(rounded, rho + side)[1] / (rho + side) for side in (-1e-9, 1e-9))
    assert after == pytest.approx(before, abs=1e-6)  # a second derivative of 4/0.05, over 2e-9
