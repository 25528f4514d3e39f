"""Connected pieces against SciPy's; eigenvalues against closed forms, and of matrices that have none."""

from unittest.mock import Mock

import numpy as np
import pytest
from scipy.sparse import coo_array, csgraph

from clothfit.base.eigen import connected_components, eigen, independent, pseudo_inverse


@pytest.mark.parametrize(("n", "count"), [(1, 0), (5, 0), (50, 20), (300, 200), (300, 2000), (5000, 4000)])
def test_random_graphs_have_the_pieces_that_scipy_finds(n, count):
    pairs = np.random.default_rng(n + count).integers(0, n, (count, 2))
    graph = coo_array((np.ones(count), tuple(pairs.T)), shape=(n, n))
    _, expected = csgraph.connected_components(graph, directed=False)
    np.testing.assert_array_equal(connected_components(pairs, n), expected)
    path = np.random.default_rng(1).permutation(4 * n)
    assert not connected_components(np.stack([path[:-1], path[1:]], axis=1), len(path)).any()


def test_parts_of_a_matrix_are_those_between_which_it_is_zero():
    rng = np.random.default_rng(3)
    H = np.zeros((12, 12))
    for first, end in ((0, 5), (5, 6), (6, 11)):  # the last coordinate is alone, with nothing on the diagonal
        H[first:end, first:end] = 1.0
    H[0, 4] = H[4, 0] = 0.0  # joined by others
    order = rng.permutation(12)
    parts = independent(H[np.ix_(order, order)])
    found = {frozenset(order[own].tolist()) for own in parts}
    assert found == {frozenset(range(5)), frozenset({5}), frozenset(range(6, 11)), frozenset({11})}
    assert [own.tolist() for own in independent(np.ones((3, 3)))] == [[0, 1, 2]]
    assert [own.tolist() for own in independent(np.zeros((0, 0)))] == [[]]


def test_the_eigenvalues_of_a_chain_are_those_of_the_textbook():
    assert [each.shape for each in eigen(np.zeros((0, 0)))] == [(0,), (0, 0)]
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
    fails = Mock(side_effect=np.linalg.LinAlgError)
    monkeypatch.setattr(np.linalg, "eigh", fails)
    monkeypatch.setattr(np.linalg, "pinv", fails)
    assert eigen(np.eye(2)) is None
    assert np.isnan(pseudo_inverse(np.eye(2))).all()


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
