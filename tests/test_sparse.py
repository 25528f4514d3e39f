"""The block matrix against dense NumPy."""

import numpy as np
import physics
import pytest
from physics import dense_matrix, square, stored, times

from clothfit import sparse

RNG = np.random.default_rng(5)
ENDS = np.array([[0, 1], [3, 1], [1, 3], [2, 4], [4, 0], [2, 3]], np.int32)  # (1, 3) twice, both ways round


def made(ends, free, rng=RNG):
    """A matrix of random blocks."""
    pattern, slot = sparse.pattern(ends, np.asarray(free))
    A = sparse.zeros(pattern, len(free))
    for blocks in (A.diagonal, A.upper):
        random = rng.normal(size=(len(blocks), 3, 3))
        blocks[:] = stored(random + random.transpose(0, 2, 1))
    return A, slot


def test_the_pattern_has_one_slot_per_pair_above_the_diagonal():
    (order, row, column, _), slot = sparse.pattern(ENDS, np.ones(5, bool))
    assert order.tolist() == [0, 1, 2, 3, 4]
    pairs = [(i, int(column[e])) for i in range(5) for e in range(row[i], row[i + 1])]
    assert pairs == [(0, 1), (0, 4), (1, 3), (2, 3), (2, 4)]
    assert slot.tolist() == [0, 2, 2, 4, 1, 3]


def test_pairs_with_a_fixed_vertex_share_a_slot_that_no_row_reads():
    (order, row, column, _), slot = sparse.pattern(ENDS, np.array([True, True, True, False, True]))
    assert order.tolist() == [0, 1, 2, 4]
    assert column.tolist() == [1, 4, 4]
    assert row.tolist() == [0, 2, 2, 3, 3]
    assert slot.tolist() == [0, 3, 3, 2, 1, 3]


@pytest.mark.parametrize("free", [np.ones(5, bool), np.array([True, False, True, True, True])])
def test_multiply_is_the_dense_product(free):
    A, _ = made(ENDS, free)
    x = RNG.normal(size=(5, 3))
    # sums of at most 15 products of order 1
    np.testing.assert_allclose(times(A, x).reshape(-1), dense_matrix(A) @ x.reshape(-1), atol=1e-14)


def test_multiply_overwrites_and_the_last_slot_does_not_count():
    A, _ = made(ENDS, np.ones(5, bool))
    x = RNG.normal(size=(5, 3))
    before = times(A, x)
    A.upper[-1] = np.nan
    out = np.full((5, 3), 7.0)
    sparse.multiply(A, x, out)
    assert out.tolist() == before.tolist()


def test_no_springs_is_a_block_diagonal_matrix():
    A, slot = made(np.zeros((0, 2), np.int32), np.ones(2, bool))
    x = RNG.normal(size=(2, 3))
    assert slot.shape == (0,)
    # sums of three products of order 1
    np.testing.assert_allclose(times(A, x).reshape(-1), dense_matrix(A) @ x.reshape(-1), atol=1e-15)


def test_to_scipy_is_the_same_matrix():
    A, _ = made(ENDS, np.array([True, True, False, True, True]))
    assert sparse.to_scipy(*A).toarray().tolist() == dense_matrix(A).tolist()  # numbers are only moved


def test_inverse_diagonal_blocks():
    A, _ = made(ENDS, np.array([True, True, True, True, False]))
    factors = RNG.normal(size=(5, 3, 3))
    blocks = factors @ factors.transpose(0, 2, 1) + np.eye(3)
    A.diagonal[:5] = stored(blocks)
    inverse = np.full((6, 8), 7.0)
    assert sparse.invert_diagonal(A, 1.5, inverse)
    # condition numbers of some tens
    np.testing.assert_allclose(square(inverse[:4]), 1.5 * np.linalg.inv(blocks[:4]), rtol=1e-12, atol=1e-13)
    assert inverse[:4].tolist() == stored(square(inverse[:4])).tolist()  # what stands twice is twice the same
    assert (inverse[4] == 7.0).all()  # a fixed vertex has no row


@pytest.mark.parametrize("diagonal", [(-1, 1, 1), (1, -1, 1), (1, 1, -1), (0, 1, 1), (np.nan, 1, 1), (-1, -1, 1)])
def test_a_block_that_is_not_positive_definite_is_noticed(diagonal):
    def definite(free, values):
        A, _ = made(ENDS, free)
        A.diagonal[:] = stored(np.eye(3))
        A.diagonal[3] = stored(np.diag(np.array(values, float)))
        return sparse.invert_diagonal(A, 1.0, np.empty((6, 8)))

    assert definite(np.ones(5, bool), (1, 1, 1))
    assert not definite(np.ones(5, bool), diagonal)
    assert definite(np.arange(5) != 3, diagonal)  # unless the vertex is fixed


def test_the_cloth_matrix_is_symmetric_and_has_no_rows_of_fixed_vertices():
    system = physics.full(fixed=(0, 2))
    at = physics.state(system, "stretched")
    dense = dense_matrix(physics.step_terms(system, *physics.parts(system)["springs"], at.y, at.u)[0])
    coupling = dense.reshape(9, 3, 9, 3)[[0, 2]][:, :, [1, 3, 4, 5, 6, 7, 8]]
    assert np.abs(coupling).max() == 0.0
    assert dense.tolist() == dense.T.tolist()
