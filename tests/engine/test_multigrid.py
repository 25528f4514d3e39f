"""Coarser levels against dense algebra: what a level is, what a cycle does, and how few a solve needs."""

import numpy as np
import pytest
from helpers.matrices import dense_solution, free_but, in_order, joined, lanes_of, matrix, right_side, scrambled
from helpers.physics import dense_matrix
from helpers.scenes import needs_compiler

from clothfit.engine.solve import cg, linear, multigrid, sparse
from clothfit.engine.solve.multigrid import BOOST, LAST_SWEEPS

pytestmark = pytest.mark.slow  # compiles a fit

SIDE = 7
N = SIDE * SIDE
FREE = free_but(N, 0, 6, 20)
ENDS = scrambled(joined(SIDE), N)


@pytest.fixture(autouse=True)
def _few_are_many(monkeypatch):
    """As if some vertices were very many: coarser levels, and rows in one subdomain."""
    monkeypatch.setattr(sparse, "MULTIGRID_FROM", 10)
    monkeypatch.setattr(sparse, "TWO_THREADS_FROM", 10)


def levels(A):
    """The levels and coarsenings of a matrix, filled."""
    made = multigrid.hierarchy(A)
    assert multigrid.prepare(made.levels, made.coarsenings)
    return made


def belongs(coarsening, vertices):
    """Pᵀ (coarse, n), 0 or 1: which vertices of the finer level make up each of the coarse one."""
    count = len(coarsening.pattern.order)
    return (np.arange(count)[:, None] == coarsening.aggregate[vertices]).astype(float)


def three(small):
    """The same for each of three coordinates."""
    return np.kron(small, np.eye(3))


def test_every_vertex_is_in_one_aggregate_with_its_neighbours():
    A = matrix(ENDS, FREE)
    first, second = multigrid.hierarchy(A).coarsenings
    assert (first.aggregate[~FREE] == -1).all()
    for coarsening, vertices in ((first, np.flatnonzero(FREE)), (second, first.pattern.order)):
        sizes = belongs(coarsening, vertices).sum(axis=1)
        assert sizes.sum() == len(vertices)
        assert sizes.min() >= 1
        assert len(sizes) < 0.5 * len(vertices)
    together = belongs(first, np.arange(N)).T @ belongs(first, np.arange(N))
    near = np.zeros((N, N))
    near[ENDS[:, 0], ENDS[:, 1]] = near[ENDS[:, 1], ENDS[:, 0]] = 1.0
    steps = np.linalg.matrix_power(np.eye(N) + near * np.outer(FREE, FREE), 4)
    assert (steps[together > 0] > 0).all()  # at most two springs from the middle


def test_a_small_matrix_has_no_coarser_levels(monkeypatch):
    monkeypatch.setattr(sparse, "MULTIGRID_FROM", 10_000)
    assert multigrid.hierarchy(matrix(ENDS, FREE)) is None


def test_a_coarse_matrix_is_the_triple_product():
    A = matrix(ENDS, FREE)
    made = levels(A)
    for fine, coarse, coarsening in zip(made.levels, made.levels[1:], made.coarsenings, strict=False):
        P = three(belongs(coarsening, np.arange(len(fine.r)))).T
        # sums of some hundred blocks of order 1
        np.testing.assert_allclose(dense_matrix(coarse.A), P.T @ dense_matrix(fine.A) @ P, atol=1e-11)


def cycles(made, r):
    """M⁻¹ r of one cycle for r (n, 3)."""
    finest = made.levels[0]
    finest.r[:] = lanes_of(r)
    multigrid.cycle(made.levels, made.coarsenings)
    assert (finest.z[finest.A.order, 3] == 0.0).all()
    return finest.z[:, :3] * FREE[:, None]


def test_a_cycle_is_a_symmetric_positive_definite_operator():
    made = levels(matrix(ENDS, FREE))
    order = made.levels[0].A.order
    columns = []
    for i in order:
        for axis in range(3):
            unit = np.zeros((N, 3))
            unit[i, axis] = 1.0
            columns.append(cycles(made, unit)[order].reshape(-1))
    inverse = np.stack(columns, axis=1)
    assert np.abs(inverse - inverse.T).max() < 1e-12 * np.abs(inverse).max()
    assert np.linalg.eigvalsh(inverse).min() > 0.0
    r = right_side(FREE)
    # sums of some hundred products
    np.testing.assert_allclose(cycles(made, r)[order].reshape(-1), inverse @ r[order].reshape(-1), atol=1e-12)


def halves(at):
    """Dense A, and the inverse of D + L, of a level."""
    A = in_order(at.A)
    block = np.arange(len(A)) // 3
    return A, np.linalg.inv(np.where(block[:, None] >= block, A, 0.0))


def smoothed(at, correction=0.0):
    """Dense M⁻¹ of a level: a sweep forwards, what coarser levels add, a sweep back."""
    A, lower = halves(at)
    unit = np.eye(len(A))
    once = lower + correction @ (unit - A @ lower) if np.ndim(correction) else lower
    return once + lower.T @ (unit - A @ once)


def test_a_cycle_is_what_its_formula_says():
    made = levels(matrix(ENDS, FREE))
    fine, middle, last = made.levels
    A, _ = halves(last)
    error = np.eye(len(A)) - smoothed(last) @ A
    operator = np.linalg.solve(A.T, (np.eye(len(A)) - np.linalg.matrix_power(error, LAST_SWEEPS)).T).T
    for at, coarse, coarsening in ((middle, last, made.coarsenings[1]), (fine, middle, made.coarsenings[0])):
        P = three(belongs(coarsening, at.A.order)[coarse.A.order]).T
        operator = smoothed(at, BOOST * P @ operator @ P.T)
    r = right_side(FREE)
    expected = operator @ r[fine.A.order].reshape(-1)
    # triangular systems of condition below 100 on three levels
    np.testing.assert_allclose(cycles(made, r)[fine.A.order].reshape(-1), expected, atol=1e-11)


def test_a_cycle_leaves_the_residual_of_what_it_found():
    made = levels(matrix(ENDS, FREE))
    A, order = made.levels[0].A, made.levels[0].A.order
    r = right_side(FREE)
    z = cycles(made, r)
    expected = r[order].reshape(-1) - in_order(A) @ z[order].reshape(-1)
    # sums of some dozen products of order 1
    np.testing.assert_allclose(made.levels[0].rest[order, :3].reshape(-1), expected, atol=1e-13)


def solve(A, b, w, tolerance=1e-12):
    """Iterations and direct solves for A w = b, by multigrid."""
    work = linear.workspace(A)
    assert work.hierarchy is not None
    return linear.solve(A, b, tolerance, work, w, True)[:2]


@pytest.mark.parametrize("guess", [0.0, 1.0])
def test_the_solution_is_that_of_a_dense_solver(guess):
    A, b, w = matrix(ENDS, FREE), right_side(FREE), guess * right_side(FREE, 9)
    iterations, direct = solve(A, b, w)
    assert (0 < iterations < 40, direct) == (True, 0)
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-10)  # tolerance 1e-12, condition number below 100
    assert np.abs(w[~FREE]).max() == 0.0
    assert solve(A, b, w, 1e-10) == (0, 0)  # as good a guess costs nothing


@pytest.mark.parametrize("blocks", ["upper", "diagonal"])
def test_an_indefinite_matrix_goes_to_the_direct_solver(blocks):
    A, b, w = matrix(ENDS, FREE), right_side(FREE), np.zeros((N, 3))
    getattr(A, blocks)[:] *= {"upper": 4.0, "diagonal": -1.0}[blocks]  # of which one has blocks that are not definite
    assert np.linalg.eigvalsh(in_order(A)).min() < 0
    assert solve(A, b, w)[1] == 1
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-10)  # two factorisations, condition number below 1e4


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
            patch.setattr(sparse, "TWO_THREADS_FROM", 10_000)
            one = physical(side)
        by_sweeps.append(cg.solve(one, b, 1e-8, 1000, cg.workspace(len(b)), np.zeros_like(b)))
    assert [direct for _, direct in by_cycles] == [0, 0]
    assert [ended for _, ended in by_sweeps] == [cg.CONVERGED] * 2
    # half the distance between vertices: up to twice the sweeps for the same way
    assert by_cycles[1][0] < 1.5 * by_cycles[0][0]
    assert by_sweeps[1][0] > 1.5 * by_sweeps[0][0]
