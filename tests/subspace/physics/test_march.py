"""Steps on a basis: with a basis of all motions they are the engine's own."""

import numpy as np
import pytest
from helpers.physics import of_air
from helpers.scenes import cloth, document, sphere
from helpers.subspaces import moving, scene_of, some, whole

from clothfit.base.errors import InvalidInput
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.subspace import translation
from clothfit.subspace.physics.march import TOGETHER, March, roll
from clothfit.subspace.physics.samples import Reduced, check_reducible, decode

pytestmark = pytest.mark.slow  # compiles motions with inputs

STEPS = 25
METHODS = {"implicit": (2, 1), "newton": (2, 3), "bdf2": (3, 1), "bdf2 newton": (3, 2)}


def system_of(method, **fields):
    number, iterations = METHODS[method]
    made = moving(integrationMethod=number, forwardSubSteps=iterations, **fields)
    return build(scene_of(made), 0, steps=STEPS)


@pytest.mark.parametrize(
    ("method", "law"), [*((each, "editor") for each in METHODS), ("newton", "air"), ("bdf2", "air")]
)
def test_on_all_motions_the_steps_are_the_engine_s(method, law):
    """With wind, a pin that moves, a sphere and a floor that rubs; 30 coordinates are two registers, the second not
    full.
    """
    system = of_air(system_of(method)) if law == "air" else system_of(method)
    full, good = rollout(system._replace(guarded=False), STEPS, 1e-13)  # reduced steps are never judged
    assert good == STEPS
    assert not full.clamped.any()
    own = Reduced(system, whole(system))
    same = int(full.hit.argmax()) + 1 if full.hit.any() else STEPS + 1  # a reduced BDF2 step is never an Euler step
    assert same > STEPS // 2
    # single precision rounds at 6e-8 of 3 m; steps amplify that, most where a contact switches
    np.testing.assert_allclose(decode(system, own.basis, roll(own, STEPS))[:same], full.x[:same], atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_basis_in_other_coordinates_gives_the_same_motion(method):
    """And vectors that are not orthogonal by mass, fewer than a register has."""
    system = system_of(method, windVel={"x": 2, "y": 0, "z": 1})
    basis = some(system, 7)
    mix = np.eye(7) + 0.3 * np.random.default_rng(0).standard_normal((7, 7))
    first, other = (Reduced(system, each) for each in (basis, basis @ mix))
    q = roll(first, STEPS)
    np.testing.assert_allclose(roll(other, STEPS) @ mix.T, q, atol=2e-5 * np.abs(q).max())


def test_a_galerkin_step_leaves_no_force_within_the_basis():
    """The full step solves A w = b, that on a basis Uᵀ A U ω = Uᵀ b."""
    system = build(scene_of(document(cloth(4, 3), windVel={"x": 3, "y": 0, "z": 1})), 0)
    own, full = Reduced(system, some(system, 5)), Reduced(system, whole(system))
    w, omega = ((roll(each, 1)[1] / system.h) for each in (full, own))
    D, _ = full.linearised(np.zeros(full.r), translation.start_velocity(system, full.basis), 0)
    A, U = full.matrix(D), own.basis[system.vertex.free].reshape(-1, own.r)
    np.testing.assert_allclose(U.T @ (A @ (U @ omega - w)), 0.0, atol=2e-6 * np.abs(U.T @ (A @ w)).max())


def test_fixed_vertices_pins_and_the_start_are_exact():
    system = build(scene_of(moving()), 0, steps=STEPS)
    own = Reduced(system, some(system, 4))
    x = decode(system, own.basis, roll(own, STEPS))
    np.testing.assert_array_equal(x[0], system.x0)
    np.testing.assert_array_equal(x[:, system.inputs.pins], system.inputs.path[: STEPS + 1])
    still = ~system.vertex.free
    still[system.inputs.pins] = False
    np.testing.assert_array_equal(x[:, still], np.broadcast_to(system.x0[still], (STEPS + 1, still.sum(), 3)))


def test_a_motion_in_parts_is_that_in_one():
    own = Reduced(system_of("bdf2"), some(system_of("bdf2"), 7))
    in_one = roll(own, STEPS)
    motion, parts = March(own), np.zeros((STEPS, own.r))
    assert [motion.take(parts[:10]), motion.take(parts[10:11]), motion.take(parts[11:])] == [10, 1, 14]
    np.testing.assert_array_equal(parts, in_one[1:])
    beside = np.zeros((STEPS, own.r))
    assert March(own.under(own.system), motion).take(beside) == STEPS
    np.testing.assert_array_equal(beside, parts)
    assert TOGETHER > STEPS


def test_compressed_springs_are_clamped_where_the_matrix_is_not_definite():
    scene = scene_of(document(cloth(4, 3, springStiffness=[3e4] * 23, restLengthFactor=1), delta=0.05))
    system = build(scene, 0)
    squeezed = system._replace(x0=system.x0 * 0.2)
    own = Reduced(squeezed, whole(system))
    rest = np.zeros(own.r), np.zeros(own.r), 0
    assert np.linalg.eigvalsh(own.matrix(own.linearised(*rest)[0]))[0] < 0.0
    D, b = own.linearised(*rest, cap=1.0)
    points = np.zeros_like(own.layout.constant)
    np.add.at(points, own.layout.point, own.layout.weight[:, None] * b)
    right = own.system.h * own.fixed.weight @ system.vertex.gravity + points.ravel() @ own.layout.rows
    q = roll(own, 3)
    one = own.system.h * np.linalg.solve(own.matrix(D), right)
    np.testing.assert_allclose(q[1], one, atol=1e-6 * np.abs(q[1]).max())
    assert np.isfinite(q).all()


def test_a_motion_that_is_lost_ends():
    system = build(scene_of(document(cloth(4, 3))), 0)
    own = Reduced(system._replace(v0=np.where(system.vertex.free[:, None], np.full(3, 1e30), 0.0)), some(system, 3))
    q = roll(own, 4)
    assert np.isnan(q[1:]).all()


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"integrationMethod": 1}, "a subspace needs implicit steps"),
        ({"selfCollision": {"thickness": 0.01}}, "where a cloth touches itself"),
    ],
)
def test_what_a_subspace_does_not_have_is_refused(fields, said):
    with pytest.raises(InvalidInput, match=said):
        check_reducible(build(scene_of(document(colliders=[sphere(0.1)], **fields)), 0))
