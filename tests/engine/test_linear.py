"""The linear solve against dense algebra: conjugate gradients, coarser levels (what one is, what a cycle does, how few
a solve needs), how they say they ended, and what follows where they are not enough.
"""

import numpy as np
import pytest
from helpers import matrices
from helpers.matrices import dense_solution, free_but, in_order, joined, lanes_of, right_side, scrambled
from helpers.physics import dense_matrix

from clothfit.engine.solve import cg, linear, minres, multigrid, sparse
from clothfit.engine.solve.multigrid import LAST_SWEEPS

pytestmark = pytest.mark.slow  # compiles a fit

SIDE = 7
N = SIDE * SIDE
FREE = free_but(N, 0, 6, 20)
ALL = np.repeat(FREE, 3)
ENDS = scrambled(joined(SIDE), N)

CLOSE = 1e-10
"""Of solutions to a tolerance of 1e-12, of a condition number below 100."""

SINGLE = 2e-6
"""What sums of some hundred numbers of order 1 may be off that are kept in single precision, 6e-8 each."""


def matrix(pull=1.0):
    """Of springs of strength `pull` and a mass on each vertex."""
    return matrices.matrix(ENDS, FREE, pull)


@pytest.fixture
def _few_are_many(monkeypatch):
    """As if some vertices were very many: coarser levels, and rows in two subdomains."""
    monkeypatch.setattr(sparse, "MULTIGRID_FROM", 10)


@pytest.fixture(params=[10_000, 10], ids=["small", "large"])
def _either(request, monkeypatch):
    """Conjugate gradients with SSOR, and with multigrid."""
    monkeypatch.setattr(sparse, "MULTIGRID_FROM", request.param)


LARGE, BOTH = (pytest.mark.usefixtures(name) for name in ("_few_are_many", "_either"))


def by_cg(A, b, w, tolerance=1e-14, limit=200):
    return cg.solve(A, b, tolerance, limit, cg.workspace(len(b)), w)


def solve(A, b, w, tolerance=1e-12):
    """Iterations, and how many direct solves."""
    return linear.solve(A, b, tolerance, linear.workspace(A), w, True)[:2]


def indefinite(beyond):
    """A matrix with positive definite diagonal blocks whose least eigenvalue is −`beyond`, beside others up to 60."""
    A = matrix()
    least = np.linalg.eigvalsh(in_order(A)).min()
    A.diagonal[:, [sparse.XX, sparse.YY, sparse.ZZ]] -= least + beyond
    return A


# --- both


@BOTH
@pytest.mark.parametrize("guess", [0.0, 1.0])
def test_the_solution_is_that_of_a_dense_solver(guess):
    A, b, w = matrix(), right_side(FREE), guess * right_side(FREE, 9)
    iterations, direct = solve(A, b, w)
    assert (0 < iterations < 40, direct) == (True, 0)
    np.testing.assert_allclose(w, dense_solution(A, b), atol=CLOSE)
    assert np.abs(w[~FREE]).max() == 0.0
    before = w.copy()
    assert solve(A, b, w, 1e-10) == (0, 0)  # as good a guess costs nothing
    np.testing.assert_array_equal(w, before)


@BOTH
@pytest.mark.filterwarnings("ignore:overflow")
def test_after_a_system_that_is_refused_or_beyond_all_bounds_the_next_one_is_solved():
    hard, A, b, w = indefinite(0.3), matrix(), right_side(FREE), np.zeros((N, 3))
    work = linear.workspace(A)
    assert linear.solve(hard, b, 1e-12, work, w, False)[1:] == (0, False)
    for before in (b, np.full_like(b, 1e308)):
        linear.solve(A, before, 1e-12, work, w, True)
        w[:] = 0.0
        assert linear.solve(A, b, 1e-12, work, w, False)[1:] == (0, True)
        np.testing.assert_allclose(w, dense_solution(A, b), atol=CLOSE)


@BOTH
@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_a_singular_matrix_and_one_that_is_not_finite_give_no_numbers(value):
    A, b, w = matrix(), right_side(FREE), np.zeros((N, 3))
    if value == 0.0:
        A.diagonal[:] = A.upper[:] = 0.0
    A.diagonal[A.order[0], 0] = value
    assert solve(A, b, w)[1] == 1
    assert not np.isfinite(w[FREE]).any() if value == 0.0 else not np.isfinite(w[FREE]).all()


# --- conjugate gradients


def residuals(A, b, omega, count):
    """The norms of the residuals of conjugate gradients with symmetric successive over-relaxation, dense."""
    whole, (D, lower, upper) = matrices.in_order(A), matrices.parts(A, omega)
    r, w, norms = b.copy(), np.zeros(len(b)), []
    z = p = np.linalg.solve(upper, D @ np.linalg.solve(lower, r))
    for _ in range(count):
        step = (r @ z) / (p @ whole @ p)
        w, after = w + step * p, r - step * (whole @ p)
        again = np.linalg.solve(upper, D @ np.linalg.solve(lower, after))
        p, r, z = again + (after @ again) / (r @ z) * p, after, again
        norms.append(np.linalg.norm(b - whole @ w))
    return np.array(norms)


def test_the_iterations_are_those_of_the_preconditioned_method():
    A, b = matrix(), right_side(FREE)
    own = b[A.order].reshape(-1)
    norms = residuals(A, own, cg.relaxation(A), 30)
    for tolerance in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10):
        w = 7.0 * ~FREE[:, None] * np.ones(3)
        iterations, ended = by_cg(A, b, w, tolerance)
        expected = 1 + int(np.argmax(norms <= tolerance * np.linalg.norm(own)))
        assert (iterations, ended) == (expected, cg.CONVERGED)
        assert by_cg(A, b, np.zeros_like(w), tolerance, iterations - 1) == (iterations - 1, cg.LIMIT)
        left = own - matrices.in_order(A) @ w[A.order].reshape(-1)
        assert np.linalg.norm(left) == pytest.approx(norms[iterations - 1], rel=1e-3)  # rounding of that many steps
        assert (w[~FREE] == 7.0).all()  # no pass touches a fixed vertex


def test_without_a_right_side_a_guess_becomes_zero():
    w = right_side(FREE)
    assert by_cg(matrix(), np.zeros_like(w), w) == (0, cg.CONVERGED)
    assert np.abs(w).max() == 0.0


def test_a_block_that_is_not_positive_definite_is_noticed_at_once_and_negative_curvature_later():
    A = matrix()
    A.diagonal[A.order[4], sparse.YY] = -1.0
    assert by_cg(A, right_side(FREE), np.zeros((N, 3))) == (0, cg.INDEFINITE)
    A = matrix()
    A.upper[:] *= 4.0  # the diagonal blocks stay positive definite
    assert np.linalg.eigvalsh(dense_matrix(A)[np.ix_(ALL, ALL)]).min() < 0
    iterations, ended = by_cg(A, right_side(FREE), np.zeros((N, 3)))
    assert ended == cg.INDEFINITE
    assert iterations > 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])  # the last has an infinite square
def test_numbers_that_are_not_finite_do_not_pass_as_converged(value):
    b = right_side(FREE)
    b[1, 1] = value
    assert by_cg(matrix(), b, np.zeros((N, 3)))[1] != cg.CONVERGED


def relaxation(mass, pull=1.0):
    """ω of a grid of free vertices that all have this mass."""
    return cg.relaxation(matrices.matrix(joined(6), np.ones(36, bool), pull, mass))


def test_the_relaxation_factor_by_its_formula_and_at_its_extremes():
    A = matrices.matrix(joined(6), np.ones(36, bool))
    q = 3.0 * 36 / np.trace(matrices.in_order(A))  # the masses beside the diagonal: springs add up to 0 over a row
    assert cg.relaxation(A) == pytest.approx(2.0 / (1.0 + q**0.2), rel=1e-12)  # sums of some hundred numbers
    assert relaxation(1.0, pull=0.0) == 1.0  # nothing to relax
    assert relaxation(0.0) == 2.0 / (1.0 + 1e-5**0.2)  # no mass: not 2, where nothing would converge
    assert relaxation(100.0, pull=-1.0) == 1.0  # an indefinite matrix has none, and conjugate gradients notice


# --- with what follows them


@pytest.mark.parametrize(("scale", "solves"), [(1.0, 0), (4.0, 1), (-30.0, 1)])
def test_a_factorisation_is_for_indefinite_systems_alone(scale, solves):
    A, b, w = matrix(), right_side(FREE), np.zeros((N, 3))
    A.upper[:] *= scale
    assert (np.linalg.eigvalsh(in_order(A)).min() < 0) == bool(solves)
    assert solve(A, b, w)[1] == solves
    np.testing.assert_allclose(w, dense_solution(A, b), atol=CLOSE)
    assert np.abs(w[~FREE]).max() == 0.0


def test_an_ill_conditioned_system_is_solved_when_the_iterations_run_out_or_before():
    A, b, w = matrix(pull=1e9), right_side(FREE), np.zeros((N, 3))
    solve(A, b, w, 1e-6)
    residual = b.reshape(-1) - dense_matrix(A) @ w.reshape(-1)
    # 1e-6 of |b|, or of a direct solver 1e-16 · 1e9 · |w| with |w| below |b|
    assert np.linalg.norm(residual[ALL]) < 2e-6 * np.linalg.norm(b)


def test_what_a_factorisation_gives_is_no_solution_unless_it_solves_the_system(monkeypatch):
    import scipy.sparse.linalg

    class Broken:
        def __init__(self, A, **_):
            pass

        def solve(self, known):
            return 1.01 * known

    monkeypatch.setattr(scipy.sparse.linalg, "splu", Broken)
    assert np.isnan(linear.factorise_and_solve(*matrix()[:-1], right_side(FREE))).all()


def test_a_cloth_without_free_vertices_is_solved():
    w = np.zeros((N, 3))
    A = sparse.zeros(sparse.pattern(ENDS, np.zeros(N, bool))[0], N)
    assert linear.solve(A, np.zeros((N, 3)), 1e-12, linear.workspace(A), w, True) == (0, 0, True)
    assert np.abs(w).max() == 0.0


# --- coarser levels


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


def test_a_small_matrix_has_no_coarser_levels():
    assert multigrid.hierarchy(matrix()) is None


@LARGE
def test_a_coarse_matrix_is_the_triple_product_and_every_vertex_shares_itself_out():
    A = matrix()
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


@LARGE
def test_a_cycle_is_what_its_formula_says():
    A = matrix()
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


@LARGE
def test_the_size_of_a_right_side_is_left_to_the_caller():
    A = matrix()
    made, order = levels(A), A.order
    r = right_side(FREE)
    z = cycles(A, made, r)
    for size in (1.0, 1e-60):  # which single precision does not reach
        square = multigrid.precondition(A, made, lanes_of(size * r), size)
        np.testing.assert_allclose(made.levels[0].z[:, :3], z[order], atol=SINGLE * np.abs(z).max())
        np.testing.assert_allclose(square, size**2 * np.vdot(r, z), rtol=10.0 * SINGLE)


@LARGE
@pytest.mark.parametrize("beyond", [1e-3, 0.3])
def test_an_indefinite_matrix_needs_no_factorisation(beyond):
    A, b, w = indefinite(beyond), right_side(FREE), np.zeros((N, 3))
    values = np.linalg.eigvalsh(in_order(A))
    assert values[0] < -0.9 * beyond
    iterations, direct = solve(A, b, w, 1e-10)
    assert (0 < iterations < minres.MOST_ITERATIONS, direct) == (True, 0)
    residual = dense_matrix(A) @ w.reshape(-1) - b.reshape(-1)
    assert np.linalg.norm(residual * np.repeat(FREE, 3)) <= 1.001e-10 * np.linalg.norm(b)  # the tolerance, and rounding
    # times the condition number, below 1e5
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-5 * np.abs(w).max())
    assert solve(A, b, w, 1.1e-10) == (0, 0)  # as good a guess costs nothing


@LARGE
def test_near_a_singular_matrix_no_more_is_asked_than_rounding_allows():
    A, b, w = indefinite(1e-6), right_side(FREE), np.zeros((N, 3))
    assert solve(A, b, w, 1e-14)[1] == 0
    residual = (dense_matrix(A) @ w.reshape(-1) - b.reshape(-1)) * np.repeat(FREE, 3)
    assert np.linalg.norm(residual) > 1e-14 * np.linalg.norm(b)
    assert np.linalg.norm(residual) < 2.0 * minres.ROUNDING * np.abs(dense_matrix(A)).max() * np.linalg.norm(w)


@LARGE
@pytest.mark.parametrize("axis", range(3))
def test_nor_does_one_with_a_diagonal_block_that_is_not_definite(axis):
    A, b, w = matrix(), right_side(FREE), np.zeros((N, 3))
    A.diagonal[A.order[5], [sparse.XX, sparse.YY, sparse.ZZ][axis]] = -1.0
    assert solve(A, b, w)[1] == 0
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-9)  # tolerance 1e-12, condition number below 1000


def physical(side):
    """The matrix of a step of a cloth of 4.9 kg with springs of 50 N/m, h = 0.02 s, however fine.

    The springs' share in it grows like side².
    """
    return matrices.matrix(joined(side), free_but(side * side, 0, side - 1), 0.02**2 * 50.0, 4.9 / side**2, even=True)


@LARGE
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
