"""Pieces of graphs against SciPy's."""

import numpy as np
import pytest
from scipy.sparse import coo_array, csgraph

from clothfit.base.graph import connected_components, independent


@pytest.mark.parametrize(("n", "count"), [(1, 0), (5, 0), (50, 20), (300, 200), (300, 2000), (5000, 4000)])
def test_random_graphs_have_the_pieces_that_scipy_finds(n, count):
    pairs = np.random.default_rng(n + count).integers(0, n, (count, 2))
    graph = coo_array((np.ones(count), tuple(pairs.T)), shape=(n, n))
    _, expected = csgraph.connected_components(graph, directed=False)
    np.testing.assert_array_equal(connected_components(pairs, n), expected)


def test_a_long_path_in_any_order_is_one_piece():
    order = np.random.default_rng(1).permutation(20_000)
    pairs = np.stack([order[:-1], order[1:]], axis=1)
    assert not connected_components(pairs, len(order)).any()


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
