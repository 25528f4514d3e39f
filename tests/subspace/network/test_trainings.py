"""The changes of a training that `benchmarks/networks.py` compares: spectral radii held, physics in the loss."""

from importlib import import_module

import numpy as np
import pytest
from helpers.paths import BENCHMARKS
from helpers.subspaces import moving, scene_of, some

from clothfit.engine.system import build
from clothfit.subspace.network.unrolled import Loss
from clothfit.subspace.physics.reduced import Reduced, State

pytestmark = pytest.mark.slow  # compiles the projected step and its adjoint

R, M = 5, 3


@pytest.fixture(scope="module")
def trainings():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        yield import_module("trainings")


def matrix(values, seed=0):
    """A linear part whose free motions have these λ, R pairs of complex conjugates, with random shapes."""
    rng = np.random.default_rng(seed)
    v = rng.standard_normal((R, R)) + 1j * rng.standard_normal((R, R))
    v, lam = np.concatenate([v, v.conj()], axis=1), np.concatenate([values, np.conj(values)])
    both = np.linalg.solve(np.concatenate([v * lam, v]).T, (v * lam**2).T).real
    p, q = both[:R], both[R:]
    return np.concatenate([p + q, -q, rng.standard_normal((M, R))]), v


def test_only_what_grows_is_held(trainings):
    lam = np.array([0.5, 0.9, 0.99, 1.02, 1.1]) * np.exp(1j * np.array([0.3, 0.7, 1.0, 0.2, 0.5]))
    own, v = matrix(lam)
    before = own.copy()
    assert trainings.radius(own) == pytest.approx(1.1, rel=1e-9)
    trainings.hold(own)
    held = np.concatenate([lam, lam.conj()])
    held /= np.maximum(np.abs(held), 1.0)
    step = trainings.companion(own)
    for each, shape in zip(held, v.T, strict=True):  # all 2 R motions: so there are no others
        state = np.concatenate([each * shape, shape])
        np.testing.assert_allclose(step @ state, each * state, atol=1e-9 * np.linalg.norm(state))
    np.testing.assert_array_equal(own[2 * R :], before[2 * R :])
    before = own.copy()
    trainings.hold(own)  # nothing grows any more
    np.testing.assert_array_equal(own, before)


def test_two_motions_of_one_shape_that_would_become_one_are_shrunk_with_all_others(trainings):
    """Real λ of 1.02 and 1.05 with the same shapes: both would fall on 1."""
    own = np.zeros((2 * R + M, R))
    p, q = (1.02 + 1.05) * np.eye(R), -1.02 * 1.05 * np.eye(R)
    own[:R], own[R : 2 * R] = p + q, -q
    trainings.hold(own)
    found = np.sort(np.linalg.eigvals(trainings.companion(own)).real)
    np.testing.assert_allclose(found, np.repeat([1.02 / 1.05, 1.0], R), rtol=1e-7)  # double roots: the root of rounding


def test_the_error_of_the_physics_has_the_gradient_of_differences(trainings):
    """With wind, a pin that moves, and obstacles; and it is 0 for steps of the physics itself."""
    system = build(scene_of(moving()), 0, steps=40)
    own = Reduced(system, some(system, 7))
    rng = np.random.default_rng(0)
    loss = trainings.WithPhysics(Loss(absolute=False, velocity=2.0), [own], 1.0, count=4)
    loss.chosen = np.array([[0, 3], [0, 11], [1, 0]])  # of the third window there is no physics
    made, given = (0.01 * rng.standard_normal((3, 6, 7)) for _ in range(2))
    first, last = made[:, 0] * 0.9, given[:, 0] * 0.9

    def error(x):
        loss.rng = np.random.default_rng(5)  # at the same frames
        return loss.of(x, given, first, last)

    _, grad = error(made)
    plain = loss.loss.of(made, given, first, last)[1]
    assert np.abs(grad - plain)[:2].max() > 0.1 * np.abs(plain).max()
    np.testing.assert_array_equal(grad[2], plain[2])
    for _ in range(3):
        direction, eps = rng.standard_normal(made.shape), 1e-7
        found = (error(made + eps * direction)[0] - error(made - eps * direction)[0]) / (2 * eps)
        # rounding is 1e-16 / 1e-7 of an error of 1; the third derivative of stiff springs is 1e5, times eps²
        np.testing.assert_allclose(np.vdot(grad, direction), found, rtol=1e-6)
    now = State(made[0, 1], (made[0, 1] - made[0, 0]) / own.h, None, 4)
    frames = np.stack([*made[0, :2], own.advance(now)[0].q])
    assert loss.at(0, 4, frames)[0] == pytest.approx(0.0, abs=1.1e-6)  # √TINY
