"""Coarser levels against dense algebra: what a level is, what a cycle does, and how few a solve needs."""

import numpy as np
import pytest
from helpers.matrices import dense_solution, free_but, in_order, joined, lanes_of, matrix, right_side, scrambled
from helpers.physics import dense_matrix
from helpers.scenes import needs_compiler

from clothfit.engine.solve import cg, linear, minres, multigrid, sparse
from clothfit.engine.solve.multigrid import LAST_SWEEPS

pytestmark = pytest.mark.slow  # compiles a fit

SIDE = 7
N = SIDE * SIDE
FREE = free_but(N, 0, 6, 20)
ENDS = scrambled(joined(SIDE), N)


@pytest.fixture(autouse=True)
def _few_are_many(monkeypatch):
    """As if some vertices were very many: coarser levels, and rows in one subdomain."""
    monkeypatch.setattr(sparse, "MULTIGRID_FROM", 10)


SINGLE = 2e-6
"""What sums of some hundred numbers of order 1 may be off that are kept in single precision, 6e-8 each."""


def levels(A):
    """The levels and coarsenings of a matrix, filled."""
    made = multigrid.hierarchy(A)
    assert multigrid.prepare(A, made, False)
    return made


def belongs(coarsening):
    """Pᵀ (coarse, fine): the weight of each vertex of the finer level in each of the coarse one, in order of sweep."""
    P = np.zeros((len(coarsening.start) - 1, len(coarsening.pattern.order)))
    for i in range(len(P)):
        own = slice(coarsening.start[i], coarsening.start[i + 1])
        P[i, coarsening.aggregate[own]] = coarsening.weight[own]
    return P.T


def three(small):
    """The same for each of three coordinates."""
    return np.kron(small, np.eye(3))


def test_a_small_matrix_has_no_coarser_levels(monkeypatch):
    monkeypatch.setattr(sparse, "MULTIGRID_FROM", 10_000)
    assert multigrid.hierarchy(matrix(ENDS, FREE)) is None


def test_a_coarse_matrix_is_the_triple_product_and_every_vertex_shares_itself_out():
    A = matrix(ENDS, FREE)
    made = levels(A)
    for fine, coarse, coarsening in zip(made.levels, made.levels[1:], made.coarsenings, strict=False):
        own = belongs(coarsening)
        np.testing.assert_allclose(own.sum(axis=0), 1.0, atol=1e-15)  # shares of a few neighbours, rounded
        assert own.sum(axis=1).min() > 0.0
        assert len(own) < 0.5 * own.shape[1]
        P = three(own).T
        expected = P.T @ dense_matrix(fine.A) @ P
        np.testing.assert_allclose(dense_matrix(coarse.A), expected, atol=SINGLE * np.abs(expected).max())


def cycles(A, made, r):
    """M⁻¹ r of one cycle for r (n, 3)."""
    multigrid.precondition(A, made, lanes_of(r), 1.0)
    finest = made.levels[0]
    assert (finest.z[:, 3] == 0.0).all()
    z = np.zeros((N, 3))
    z[A.order] = finest.z[:, :3]
    return z


def halves(at):
    """Dense A, and the inverse of D + L, of a level; the transpose of the inverse is that of D + Lᵀ."""
    A = in_order(at.A)
    block = np.arange(len(A)) // 3
    return A, np.linalg.inv(np.where(block[:, None] >= block, A, 0.0))


def smoothed(at, correction=0.0):
    """Dense M⁻¹ of a level: a sweep back, what coarser levels add, a sweep forwards."""
    A, lower = halves(at)
    unit = np.eye(len(A))
    once = lower.T + correction @ (unit - A @ lower.T) if np.ndim(correction) else lower.T
    return once + lower @ (unit - A @ once)


def test_a_cycle_is_what_its_formula_says():
    A = matrix(ENDS, FREE)
    made = levels(A)
    fine, middle, last = made.levels
    coarsest, _ = halves(last)
    error = np.eye(len(coarsest)) - smoothed(last) @ coarsest
    operator = np.linalg.solve(coarsest.T, (np.eye(len(error)) - np.linalg.matrix_power(error, LAST_SWEEPS)).T).T
    for at, coarsening in ((middle, made.coarsenings[1]), (fine, made.coarsenings[0])):
        P = three(belongs(coarsening)).T
        operator = smoothed(at, P @ operator @ P.T)
    r = right_side(FREE)
    expected = operator @ r[A.order].reshape(-1)
    # triangular systems of condition below 100 on three levels
    atol = 10.0 * SINGLE * np.abs(expected).max()
    np.testing.assert_allclose(cycles(A, made, r)[A.order].reshape(-1), expected, atol=atol)


def test_the_size_of_a_right_side_is_left_to_the_caller():
    A = matrix(ENDS, FREE)
    made, order = levels(A), A.order
    r = right_side(FREE)
    z = cycles(A, made, r)
    for size in (1.0, 1e-60):  # which single precision does not reach
        square = multigrid.precondition(A, made, lanes_of(size * r), size)
        np.testing.assert_allclose(made.levels[0].z[:, :3], z[order], atol=SINGLE * np.abs(z).max())
        np.testing.assert_allclose(square, size**2 * np.vdot(r, z), rtol=10.0 * SINGLE)


def solve(A, b, w, tolerance=1e-12):
    """Iterations and direct solves for A w = b, by multigrid."""
    work = linear.workspace(A)
    assert work.large is not None
    return linear.solve(A, b, tolerance, work, w, True)[:2]


@pytest.mark.parametrize("guess", [0.0, 1.0])
def test_the_solution_is_that_of_a_dense_solver(guess):
    A, b, w = matrix(ENDS, FREE), right_side(FREE), guess * right_side(FREE, 9)
    iterations, direct = solve(A, b, w)
    assert (0 < iterations < 40, direct) == (True, 0)
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-10)  # tolerance 1e-12, condition number below 100
    assert np.abs(w[~FREE]).max() == 0.0
    assert solve(A, b, w, 1e-10) == (0, 0)  # as good a guess costs nothing


def indefinite(beyond):
    """A matrix with positive definite diagonal blocks whose least eigenvalue is −`beyond`, beside others up to 60."""
    A = matrix(ENDS, FREE)
    least = np.linalg.eigvalsh(in_order(A)).min()
    A.diagonal[:, [sparse.XX, sparse.YY, sparse.ZZ]] -= least + beyond
    return A


@pytest.mark.parametrize("beyond", [1e-3, 0.3])
def test_an_indefinite_matrix_needs_no_factorisation(beyond):
    A, b, w = indefinite(beyond), right_side(FREE), np.zeros((N, 3))
    values = np.linalg.eigvalsh(in_order(A))
    assert values[0] < -0.9 * beyond
    iterations, direct = solve(A, b, w, 1e-10)
    assert (0 < iterations < minres.MOST, direct) == (True, 0)
    residual = dense_matrix(A) @ w.reshape(-1) - b.reshape(-1)
    assert np.linalg.norm(residual * np.repeat(FREE, 3)) <= 1.001e-10 * np.linalg.norm(b)  # the tolerance, and rounding
    # times the condition number, below 1e5
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-5 * np.abs(w).max())
    assert solve(A, b, w, 1.1e-10) == (0, 0)  # as good a guess costs nothing


def test_near_a_singular_matrix_no_more_is_asked_than_rounding_allows():
    A, b, w = indefinite(1e-6), right_side(FREE), np.zeros((N, 3))
    assert solve(A, b, w, 1e-14)[1] == 0
    residual = (dense_matrix(A) @ w.reshape(-1) - b.reshape(-1)) * np.repeat(FREE, 3)
    assert np.linalg.norm(residual) > 1e-14 * np.linalg.norm(b)
    assert np.linalg.norm(residual) < 2.0 * minres.ROUNDING * np.abs(dense_matrix(A)).max() * np.linalg.norm(w)


def test_an_indefinite_matrix_is_refused_where_it_may_be():
    A, w = indefinite(0.3), np.zeros((N, 3))
    assert not linear.solve(A, right_side(FREE), 1e-12, linear.workspace(A), w, False)[2]


@pytest.mark.parametrize("axis", range(3))
def test_nor_does_one_with_a_diagonal_block_that_is_not_definite(axis):
    A, b, w = matrix(ENDS, FREE), right_side(FREE), np.zeros((N, 3))
    A.diagonal[A.order[5], [sparse.XX, sparse.YY, sparse.ZZ][axis]] = -1.0
    assert solve(A, b, w)[1] == 0
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-9)  # tolerance 1e-12, condition number below 1000


def test_a_singular_matrix_goes_to_the_direct_solver():
    A, w = matrix(ENDS, FREE), np.zeros((N, 3))
    A.diagonal[:] = A.upper[:] = 0.0
    assert solve(A, right_side(FREE), w)[1] == 1
    assert np.isnan(w[FREE]).all()


@pytest.mark.filterwarnings("ignore:overflow")
def test_numbers_beyond_all_bounds_do_not_spoil_the_next_solve():
    A, b, w = matrix(ENDS, FREE), right_side(FREE), np.zeros((N, 3))
    work = linear.workspace(A)
    linear.solve(A, np.full_like(b, 1e308), 1e-12, work, w, True)
    w[:] = 0.0
    assert linear.solve(A, b, 1e-12, work, w, True)[1:] == (0, True)
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-10)


def physical(side):
    """The matrix of a step of a cloth of 4.9 kg with springs of 50 N/m, h = 0.02 s, however fine.

    The springs' share in it grows like side².
    """
    return matrix(joined(side), free_but(side * side, 0, side - 1), 0.02**2 * 50.0, 4.9 / side**2, even=True)


@needs_compiler  # a minute and a half otherwise
def test_refinement_hardly_adds_iterations(monkeypatch):
    by_cycles, by_sweeps = [], []
    for side in (24, 48):
        A = physical(side)
        b = right_side(free_but(side * side, 0, side - 1))
        by_cycles.append(solve(A, b, np.zeros_like(b), 1e-8))
        with monkeypatch.context() as patch:
            patch.setattr(sparse, "MULTIGRID_FROM", 10_000)
            one = physical(side)
        by_sweeps.append(cg.solve(one, b, 1e-8, 1000, cg.workspace(len(b)), np.zeros_like(b)))
    assert [direct for _, direct in by_cycles] == [0, 0]
    assert [ended for _, ended in by_sweeps] == [cg.CONVERGED] * 2
    # half the distance between vertices: up to twice the sweeps for the same way
    assert by_cycles[1][0] < 1.5 * by_cycles[0][0]
    assert by_sweeps[1][0] > 1.5 * by_sweeps[0][0]
