"""Weight and node damping against their formulas, and their derivatives against finite differences."""

import numpy as np
import pytest
from helpers import physics
from helpers.physics import (
    GRAVITY,
    STATES,
    damping,
    full,
    parts,
    pushforward_error,
    state,
    step_terms,
    times,
    transpose_error,
    xyz,
)

from clothfit.engine.forces import vertex

SYSTEM = full()
M = SYSTEM.vertex.mass[:, None]


@pytest.mark.parametrize("name", STATES)
def test_the_force_is_weight_less_damping_times_momentum(name):
    at = state(SYSTEM, name)
    f = physics.total_force(vertex, SYSTEM.vertex, at.y, at.u)
    # a handful of operations on numbers of order 1
    np.testing.assert_allclose(f, M * (np.array([0, -GRAVITY, 0]) - 0.7 * at.u), rtol=1e-14, atol=1e-15)


def test_damping_is_the_velocity_jacobian():
    at = state(SYSTEM, "random")
    change = physics.total_force(vertex, SYSTEM.vertex, at.y, at.u + at.du) - physics.total_force(
        vertex, SYSTEM.vertex, at.y, at.u
    )
    # the force is linear in u: only rounding of a difference of numbers of order 1
    np.testing.assert_allclose(damping(vertex, SYSTEM.vertex, at.y, at.u, at.du), change, atol=1e-14)


def test_the_step_gets_the_mass_damping_and_the_weight_alone():
    at = state(SYSTEM, "random")
    A, b = step_terms(SYSTEM, vertex, SYSTEM.vertex, at.y, at.u)
    # products of four numbers
    np.testing.assert_allclose(times(A, at.dy), SYSTEM.h * 0.7 * M * at.dy, rtol=1e-14)
    np.testing.assert_allclose(b, SYSTEM.h * M * [[0, -GRAVITY, 0]], rtol=1e-14)


@pytest.mark.parametrize("name", STATES)
def test_the_pushforward_is_the_derivative_of_the_model(name):
    # linear in the mass: central differences at 1e-5 lose 5 digits to rounding and nothing else
    assert pushforward_error(SYSTEM, "vertex", state(SYSTEM, name)) < 1e-9


@pytest.mark.parametrize("name", STATES)
def test_the_pullback_is_the_transpose_of_the_pushforward(name):
    assert transpose_error(SYSTEM, "vertex", state(SYSTEM, name)) < 1e-12  # rounding of a sum of 27 products


def test_fixed_vertices_are_those_of_the_scene():
    assert np.flatnonzero(~full(fixed=(0, 2)).vertex.free).tolist() == [0, 2]


def test_all_forces_of_the_system_are_covered():
    box = {"type": 3, "pos": xyz((0, -9, 0)), "scale": xyz((1, 1, 1))}  # without one its field is None
    fields = {
        field
        for field, value in full(colliders=[box])._asdict().items()
        if type(value).__module__.startswith("clothfit.engine.forces")
    }
    assert fields == {"vertex", "springs", "faces", "spheres", "colliders", "applied"}
    assert len(parts(SYSTEM)) == len(fields - {"applied"})  # which belongs to steps, not to states: test_applied
