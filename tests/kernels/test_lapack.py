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


def fortran(*shape, seed=1):
    return np.asfortranarray(np.random.default_rng(seed).normal(size=shape))


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


@pytest.mark.parametrize("transposed", [False, True])
def test_products_and_solutions_are_written_in_place(transposed):
    L, B, C = np.asfortranarray(np.linalg.cholesky(definite(4))), fortran(6, 4), fortran(6, 5, seed=2)
    solved = B.copy(order="F")
    lapack.solve_right(L, solved, transposed)
    np.testing.assert_allclose(solved @ (L.T if transposed else L), B, rtol=0, atol=ROUNDING * np.abs(B).max())
    right = fortran(5, 4, seed=3) if transposed else fortran(4, 5, seed=3)
    expected = C - B @ (right.T if transposed else right)
    lapack.subtract_product(B, right, C, transposed)
    np.testing.assert_allclose(C, expected, rtol=0, atol=ROUNDING * np.abs(expected).max())


def test_a_square_is_subtracted_in_the_lower_triangle():
    B, C = fortran(5, 3), definite(5)
    before = C.copy()
    lapack.subtract_square(B, C)
    np.testing.assert_allclose(np.tril(C), np.tril(before - B @ B.T), rtol=0, atol=ROUNDING * np.abs(before).max())
    np.testing.assert_array_equal(np.triu(C, 1), np.triu(before, 1))


def test_nothing_stays_nothing():
    none = np.zeros((0, 0), order="F")
    assert lapack.factorise(none)
    lapack.invert(none)
    lapack.solve_right(none, np.zeros((4, 0), order="F"), True)
    C = fortran(2, 3)
    before = C.copy()
    lapack.subtract_product(np.zeros((2, 0), order="F"), np.zeros((0, 3), order="F"), C, False)
    np.testing.assert_array_equal(C, before)


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
