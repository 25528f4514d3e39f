"""A change of a training that `benchmarks/networks.py` compares: spectral radii held."""

from importlib import import_module

import numpy as np
import pytest
from helpers.paths import BENCHMARKS

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
