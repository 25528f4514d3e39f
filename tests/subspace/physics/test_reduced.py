"""Steps on a basis: with a basis of all motions they are the engine's own."""

import numpy as np
import pytest
from helpers.scenes import cloth, document, sphere
from helpers.subspaces import moving, scene_of, some, whole

from clothfit.base.errors import InvalidInput
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.subspace.physics.adjoint import simulate
from clothfit.subspace.physics.reduced import Reduced, check, decode

pytestmark = pytest.mark.slow  # compiles motions with inputs

STEPS = 25


@pytest.mark.parametrize(
    ("method", "iterations"), [(2, 1), (2, 3), (3, 1), (3, 2)], ids=["implicit", "newton", "bdf2", "bdf2 newton"]
)
def test_on_all_motions_the_steps_are_the_engine_s(method, iterations):
    scene = scene_of(moving(integrationMethod=method, forwardSubSteps=iterations))
    system = build(scene, 0, steps=STEPS)
    full, good = rollout(system, STEPS, 1e-13)
    assert good == STEPS
    assert not full.clamped.any()
    own = Reduced(system, whole(system))
    # the engine solves to 1e-13, stops its iterations there, and contacts and folds amplify what is left
    np.testing.assert_allclose(decode(own, simulate(own, STEPS).q), full.x, atol=1e-8)


def test_a_galerkin_step_leaves_no_force_within_the_basis():
    """A step to w minimises what the full step's equation leaves, seen from the basis: Uᵀ(A w − b) = 0."""
    scene = scene_of(document(cloth(4, 3), windVel={"x": 3, "y": 0, "z": 1}))
    system = build(scene, 0)
    own = Reduced(system, some(system, 5))
    state, _ = own.advance(own.start())
    full = Reduced(system, whole(system))
    begin = full.start()
    full.linearise(full.iteration(begin, None, False))
    A = full.matrix(full.iteration(begin, None, False))
    right = full.linearise(full.iteration(begin, None, False)) + full.h * full.weight @ system.vertex.gravity
    U = own.basis[system.vertex.free].reshape(-1, own.r)
    np.testing.assert_allclose(U.T @ (A @ (U @ state.p) - right), 0.0, atol=1e-13)


def test_fixed_vertices_pins_and_the_start_are_exact():
    system = build(scene_of(moving()), 0, steps=STEPS)
    own = Reduced(system, some(system, 4))
    x = decode(own, simulate(own, STEPS).q)
    np.testing.assert_array_equal(x[0], system.x0)
    np.testing.assert_array_equal(x[:, system.inputs.pins], system.inputs.path[: STEPS + 1])
    still = ~system.vertex.free
    still[system.inputs.pins] = False
    np.testing.assert_array_equal(x[:, still], np.broadcast_to(system.x0[still], (STEPS + 1, still.sum(), 3)))


def test_compressed_springs_are_clamped_where_the_matrix_is_not_definite():
    scene = scene_of(document(cloth(4, 3, springStiffness=[3e4] * 23, restLengthFactor=1), delta=0.05))
    system = build(scene, 0)
    squeezed = system._replace(x0=system.x0 * 0.2)
    own = Reduced(squeezed, whole(system))
    assert np.isfinite(simulate(own, 5).q).all()


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"integrationMethod": 1}, "a subspace needs implicit steps"),
        ({"selfCollision": {"thickness": 0.01}}, "where a cloth touches itself"),
    ],
)
def test_what_a_subspace_does_not_have_is_refused(fields, said):
    with pytest.raises(InvalidInput, match=said):
        check(build(scene_of(document(colliders=[sphere(0.1)], **fields)), 0))
