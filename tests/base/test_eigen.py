"""Eigenvalues against closed forms, and of matrices that have none in double precision."""

import numpy as np
import pytest

from clothfit.base.eigen import eigen, pseudo_inverse


def test_the_eigenvalues_of_a_chain_are_those_of_the_textbook():
    n = 9
    values, vectors = eigen(2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    expected = 2 - 2 * np.cos(np.pi * np.arange(1, n + 1) / (n + 1))
    np.testing.assert_allclose(values, expected, atol=1e-14)  # rounding, of numbers up to 4
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(n), atol=1e-14)


@pytest.mark.parametrize("fault", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_has_none(fault):
    H = np.eye(3)
    H[1, 2] = H[2, 1] = fault
    assert eigen(H) is None
    assert np.isnan(pseudo_inverse(H)).all()


def test_an_algorithm_that_does_not_end_gives_none(monkeypatch):
    def fails(*given, **options):
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(np.linalg, "eigh", fails)
    monkeypatch.setattr(np.linalg, "pinv", fails)
    assert eigen(np.eye(2)) is None
    assert np.isnan(pseudo_inverse(np.eye(2))).all()


def test_no_values_have_no_eigenvalues():
    values, vectors = eigen(np.zeros((0, 0)))
    assert (values.shape, vectors.shape) == ((0,), (0, 0))


def test_parts_that_share_nothing_have_the_eigenvalues_of_the_whole():
    """In any order of the coordinates, with zeros between them."""
    rng = np.random.default_rng(0)
    H = np.zeros((9, 9))
    for first, end in ((0, 4), (4, 5), (5, 8)):  # the last coordinate is in no part
        J = rng.normal(size=(7, end - first))
        H[first:end, first:end] = J.T @ J
    order = rng.permutation(9)
    H = H[np.ix_(order, order)]
    values, vectors = eigen(H)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(H), rtol=0, atol=1e-14 * values[-1])  # rounding
    np.testing.assert_allclose(vectors * values @ vectors.T, H, rtol=0, atol=1e-13 * values[-1])
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(9), atol=1e-14)


def test_the_pseudo_inverse_leaves_out_what_is_zero():
    np.testing.assert_allclose(pseudo_inverse(np.diag([2.0, 0.0])), np.diag([0.5, 0.0]), atol=1e-15)
