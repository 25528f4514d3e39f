"""LAPACK without the interpreter's lock: against NumPy."""

import sys
import threading
import time

import numpy as np
import pytest

from clothfit.kernels import lapack

ROUNDING = 1e-12
"""Relative; the matrices' conditions are below 100."""


def definite(n, seed=0):
    J = np.random.default_rng(seed).normal(size=(3 * n, n))
    return np.asfortranarray(J.T @ J)


def test_the_factor_and_the_inverse_are_those_of_the_matrix():
    A = definite(7)
    L = A.copy(order="F")
    assert lapack.factorise(L)
    np.testing.assert_allclose(np.tril(L), np.linalg.cholesky(A), rtol=ROUNDING)
    lapack.invert(L)
    inverse = np.linalg.inv(A)
    np.testing.assert_allclose(np.tril(L), np.tril(inverse), rtol=0, atol=ROUNDING * np.abs(inverse).max())


@pytest.mark.parametrize("wrong", [-np.eye(3), np.zeros((3, 3))], ids=["negative", "0"])
def test_what_is_not_positive_definite_has_no_factor(wrong, capfd):
    assert not lapack.factorise(np.asfortranarray(wrong))
    assert capfd.readouterr() == ("", "")


def test_nothing_stays_nothing():
    none = np.zeros((0, 0), order="F")
    assert lapack.factorise(none)
    lapack.invert(none)


@pytest.mark.parametrize("wrong", [np.ones((3, 4)), np.ones((4, 4), np.float32, order="F"), np.ones((6, 6))[::2, ::2]])
def test_other_arrays_are_refused(wrong):
    with pytest.raises(ValueError, match="Fortran"):
        lapack.factorise(wrong)


def test_other_threads_run_meanwhile():
    """One that counts gets on while this one factorises: with the lock held it would not be asked at all."""
    A, counts, over = definite(1500), [0], threading.Event()

    def count():
        while not over.wait(1e-4):
            counts[0] += 1

    before, thread = sys.getswitchinterval(), threading.Thread(target=count, daemon=True)
    sys.setswitchinterval(1.0)  # between two lines of this thread the lock is not handed on
    try:
        thread.start()
        time.sleep(0.01)
        seen = counts[0]
        assert lapack.factorise(A)
        after = counts[0]
    finally:
        over.set()
        sys.setswitchinterval(before)
        thread.join()
    assert after > seen
