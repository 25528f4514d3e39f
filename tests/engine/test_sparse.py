"""The block matrix against dense NumPy."""

import numpy as np
import pytest
from helpers import matrices
from helpers.physics import dense_matrix, square, stored, times

from clothfit.engine.solve import sparse

pytestmark = pytest.mark.slow  # compiles a fit

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


@pytest.mark.parametrize(("fixed", "expected"), [
    ([], ([0, 1, 2, 3, 4], [0, 2, 3, 5, 5, 5], [1, 4, 3, 3, 4], [0, 2, 2, 4, 1, 3])),
    ([3], ([0, 1, 2, 4], [0, 2, 2, 3, 3], [1, 4, 4], [0, 3, 3, 2, 1, 3])),  # the last slot is one that no row reads
])  # fmt: skip
def test_the_pattern_has_one_slot_per_pair_above_the_diagonal(fixed, expected):
    (order, row, column, _), slot = sparse.pattern(ENDS, ~np.isin(np.arange(5), fixed))
    assert tuple(each.tolist() for each in (order, row, column, slot)) == expected


def test_multiply_overwrites_and_the_last_slot_does_not_count():
    A, _ = made(ENDS, np.ones(5, bool))
    x = RNG.normal(size=(5, 3))
    before = times(A, x)
    A.upper[-1] = np.nan
    out = np.full((5, 3), 7.0)
    sparse.multiply(A, x, out)
    assert out.tolist() == before.tolist()


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


def laid_out(ends, free):
    """A pattern, checked: every free vertex has one row, subdomains follow each other, columns are later than rows."""
    made, slot = sparse.pattern(ends, free)
    order, row, column, subdomains = made
    assert sorted(order.tolist()) == np.flatnonzero(free).tolist()
    assert subdomains.reshape(-1)[1:-1:2].tolist() == subdomains.reshape(-1)[2::2].tolist()
    assert (subdomains[0, 0], subdomains[2, 1]) == (0, len(order))
    place = np.full(len(free), -1)
    place[order] = np.arange(len(order))
    of_slot = np.stack([np.repeat(np.arange(len(order)), np.diff(row)), place[column]], axis=1)
    assert (of_slot[:, 0] < of_slot[:, 1]).all()
    kept = free[ends].all(axis=1)
    assert of_slot[slot[kept]].tolist() == np.sort(place[ends[kept]], axis=1).tolist()
    assert (slot[~kept] == len(column)).all()
    return made, of_slot


def across(made, of_slot):
    """How many slots join the first subdomain and the second."""
    middle, end = made.subdomains[1]
    return int(((of_slot[:, 0] < middle) & (middle <= of_slot[:, 1]) & (of_slot[:, 1] < end)).sum())


def width(of_slot):
    """The mean distance of joined vertices in the order of sweep."""
    return float((of_slot[:, 1] - of_slot[:, 0]).mean())


@pytest.mark.parametrize("side", [4, 9, 20])
@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("fixed", [(), (0, 3), range(4, 8)])
def test_two_subdomains_of_a_large_cloth_are_not_joined(monkeypatch, side, mixed, fixed):
    monkeypatch.setattr(sparse, "MULTIGRID_FROM", 10)
    ends, free = matrices.joined(side), matrices.free_but(side * side, *fixed)
    made, of_slot = laid_out(matrices.scrambled(ends, side * side) if mixed else ends, free)
    assert across(made, of_slot) == 0
    sizes = np.diff(made.subdomains, axis=1).reshape(-1)
    assert sizes[0] == len(made.order) // 2
    assert sizes[2] <= 3 * side  # a spring reaches two rows of the grid, and one vertex, far


def test_a_small_cloth_is_one_share_in_the_order_of_its_vertices():
    ends, free = matrices.scrambled(matrices.joined(5), 25), matrices.free_but(25, 3, 9)
    made, _ = laid_out(ends, free)
    assert made.order.tolist() == np.flatnonzero(free).tolist()
    assert made.subdomains.tolist() == [[0, 23], [23, 23], [23, 23]]


def test_the_numbers_of_the_vertices_hardly_matter_to_a_large_cloth(monkeypatch):
    monkeypatch.setattr(sparse, "MULTIGRID_FROM", 10)
    side, free = 20, np.ones(400, bool)
    ends = matrices.joined(side)
    mixed = matrices.scrambled(ends, 400)
    assert np.abs(mixed[:, 0] - mixed[:, 1]).mean() > 100  # a third of all
    # levels of equal distance from a corner hold up to twice as many vertices as a row
    assert width(laid_out(mixed, free)[1]) < 2.5 * width(laid_out(ends, free)[1])
    rest = sparse.sweep(ends, free)[0][:200]
    assert (np.diff(rest) > 0).all()  # an order that is good already is kept


@pytest.mark.filterwarnings("error")  # of means of nothing, say
@pytest.mark.parametrize("free", [np.zeros(12, bool), np.arange(12) < 1, np.arange(12) % 2 == 0, np.ones(12, bool)])
@pytest.mark.parametrize("large", [1, 10])
def test_vertices_without_springs_have_rows_without_slots(monkeypatch, free, large):
    monkeypatch.setattr(sparse, "MULTIGRID_FROM", large)
    chain = np.stack([np.arange(11), np.arange(1, 12)], axis=1).astype(np.int32)
    made, of_slot = laid_out(chain[~free[chain].all(axis=1)], free)
    assert made.row.tolist() == [0] * (free.sum() + 1)
    assert len(of_slot) == 0


def test_separate_pieces_are_shared_out_as_well(monkeypatch):
    monkeypatch.setattr(sparse, "MULTIGRID_FROM", 10)
    one = matrices.joined(5)
    ends = np.concatenate([one, one + 25, one + 50])
    free = matrices.free_but(78, 7, 30)  # three vertices belong to no piece
    made, of_slot = laid_out(matrices.scrambled(ends, 78), free)
    assert across(made, of_slot) == 0
    assert (np.diff(made.subdomains, axis=1)[:2] > 0).all()


@pytest.mark.parametrize("large", [10, 10_000])
def test_the_product_does_not_depend_on_the_order_of_sweep(monkeypatch, large):
    ends, free = matrices.scrambled(matrices.joined(6), 36), matrices.free_but(36, 5, 17)
    x = RNG.normal(size=(36, 3))
    expected = (dense_matrix(matrices.matrix(ends, free)) @ x.reshape(-1)).reshape(36, 3)
    monkeypatch.setattr(sparse, "MULTIGRID_FROM", large)
    A = matrices.matrix(ends, free)
    # sums of some 40 products of order 10
    np.testing.assert_allclose(times(A, x), expected, atol=1e-12)
    rows = (3 * np.sort(A.order)[:, None] + np.arange(3)).reshape(-1)  # of the free vertices
    assert sparse.to_scipy(*A).toarray().tolist() == dense_matrix(A)[np.ix_(rows, rows)].tolist()  # only moved
