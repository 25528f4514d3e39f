"""Pieces of graphs against SciPy's."""

import numpy as np
import pytest
from scipy.sparse import coo_array, csgraph

from clothfit.base.graph import connected_components


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
