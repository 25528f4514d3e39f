"""Air drag of the faces against its formula, and its derivatives against finite differences."""

import numpy as np
import pytest
from helpers import physics
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
    xyz,
)

from clothfit.engine.forces import wind

SYSTEM = full()
FACES = SYSTEM.faces


def triangle(**fields):
    """A right triangle of legs 2 m and 3 m in the plane y = 0: n = (0, −6, 0), area 3."""
    return physics.system(
        physics.thing([(0, 0, 0), (2, 0, 0), (0, 0, 3)], triangles=[(0, 1, 2)], dragCoefficient=0.5), **fields
    ).faces


def test_one_face_in_still_air_by_hand():
    u = np.array([[1.0, 0.3, 0], [0, 0.6, 2], [0, 0.9, 0]])  # mean velocity along n: 0.6 m/s
    f = physics.total_force(wind, triangle(), np.array([[0.0, 0, 0], [2, 0, 0], [0, 0, 3]]), u)
    # (drag A / 3) n (n·(−ū)) = (0.5 · 3 / 3) (−6) (6 · 0.6) on each corner
    np.testing.assert_allclose(f, [[0, -0.5 * 36 * 0.6, 0]] * 3, rtol=1e-14)


def test_wind_along_the_face_does_nothing_and_wind_across_pushes():
    y, still = np.array([[0.0, 0, 0], [2, 0, 0], [0, 0, 3]]), np.zeros((3, 3))
    along = physics.total_force(wind, triangle(windVel=xyz((5, 0, -7))), y, still)
    across = physics.total_force(wind, triangle(windVel=xyz((5, 2, -7))), y, still)
    assert np.abs(along).max() == 0.0
    np.testing.assert_allclose(across, [[0, 0.5 * 36 * 2, 0]] * 3, rtol=1e-14)


@pytest.mark.parametrize("name", STATES)
def test_a_cloth_that_moves_with_the_wind_feels_nothing(name):
    at = state(SYSTEM, name)
    f = physics.total_force(wind, FACES, at.y, np.broadcast_to(FACES.wind, at.y.shape).copy())
    still = physics.total_force(wind, FACES, at.y, np.zeros_like(at.y))
    assert np.abs(f).max() < 1e-15 * max(np.abs(still).max(), 1)  # the mean of three equal numbers, rounded


def test_damping_is_lumped_per_vertex():
    at = state(SYSTEM, "random")
    expected = np.zeros_like(at.y)
    for corners in FACES.corners:
        a, b, c = at.y[corners]
        n = np.cross(b - a, c - a)
        for i in corners:
            expected[i] -= FACES.drag * np.linalg.norm(n) / 6 * n * (n @ at.du[i])
    assert relative(damping(wind, FACES, at.y, at.u, at.du), expected) < 1e-14  # the same products in another order


def test_damping_is_the_row_sum_of_the_true_jacobian():
    at = state(SYSTEM, "random")
    same = np.broadcast_to([0.3, -1.0, 2.0], at.y.shape).copy()
    change = physics.total_force(wind, FACES, at.y, at.u + same) - physics.total_force(wind, FACES, at.y, at.u)
    assert relative(damping(wind, FACES, at.y, at.u, same), change) < 1e-13  # linear in u: rounding only


def test_the_step_gets_the_damping_and_no_stiffness():
    at = state(SYSTEM, "random")
    A, b = step_terms(SYSTEM, wind, FACES, at.y, at.u)
    f = physics.total_force(wind, FACES, at.y, at.u)
    # the same products in another order
    assert relative(times(A, at.dy), -SYSTEM.h * damping(wind, FACES, at.y, at.u, at.dy)) < 1e-14
    assert relative(b, SYSTEM.h * (f - damping(wind, FACES, at.y, at.u, at.u))) < 1e-13


@pytest.mark.parametrize("name", STATES)
def test_the_pushforward_is_the_derivative_of_the_model(name):
    # a polynomial but for |n|: truncation 1e-10 times derivatives of some tens, rounding 1e-11
    assert pushforward_error(SYSTEM, "wind", state(SYSTEM, name)) < 1e-7


@pytest.mark.parametrize("name", STATES)
def test_the_pullback_is_the_transpose_of_the_pushforward(name):
    assert transpose_error(SYSTEM, "wind", state(SYSTEM, name)) < 1e-12  # rounding of sums of some 100 products


def test_a_face_without_area_feels_nothing_and_stays_finite():
    line = np.array([[0.0, 0, 0], [1, 1, 0], [2, 2, 0]])
    small = physics.system(physics.thing(line, [(0, 1)], [(0, 1, 2)], dragCoefficient=0.5), windVel=xyz((3, 1, -2)))
    at = state(small, "random")._replace(y=line)
    out = physics.pushforward(small, wind, small.faces, at, physics.direction(small))
    assert np.abs(physics.total_force(wind, small.faces, line, at.u)).max() == 0.0
    assert np.abs(out).max() == 0.0  # third order in n


def test_no_drag_no_faces():
    corners = np.array([[0, 1, 2]], np.int32)
    assert wind.build(corners, 0.0, np.zeros(3)).corners.shape == (0, 3)
    assert wind.build(corners, 0.1, np.zeros(3)).corners.tolist() == [[0, 1, 2]]
