"""Least squares with bounds and a trust_region, against SciPy's and against what a minimum must satisfy."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.sparse import csr_array

from clothfit.base import interrupts
from clothfit.kernels import parallel
from clothfit.optimise import evidence, trust_region

SIZES = [1, 2, 7, 40]


def problem(size, seed, rows=None):
    """A random J and r, as H, g, and bounds that hold some of the solution."""
    rng = np.random.default_rng(seed)
    J, r = rng.normal(size=(rows or 3 * size, size)), rng.normal(size=rows or 3 * size)
    lower, upper = -0.1 * rng.uniform(size=size), 0.1 * rng.uniform(size=size)
    return J, r, lower, upper


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("width", [1.0, np.inf])
def test_it_is_the_bounded_least_squares_solution(size, seed, width):
    J, r, lower, upper = problem(size, seed)
    lower, upper = width * lower, width * upper
    found = trust_region.solve(J.T @ J, J.T @ r, lower, upper)
    expected = lsq_linear(J, -r, (lower, upper), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(found, expected, atol=1e-12)  # a condition of H below 100
    assert ((found >= lower) & (found <= upper)).all()


def coupled(size, condition, seed):
    """H of this condition, as neighbouring springs have, a g whose solution lies far outside, and bounds."""
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.normal(size=(size, size)))
    H = Q @ np.diag(np.geomspace(1.0 / condition, 1.0, size)) @ Q.T
    return (H + H.T) / 2, rng.normal(size=size) * 1e-3, -rng.uniform(size=size), rng.uniform(size=size)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("size", [30, 100])
def test_strongly_coupled_coordinates_meet_the_conditions_of_a_minimum(size, seed):
    H, g, lower, upper = coupled(size, 1e6, seed)
    delta = trust_region.solve(H, g, lower, upper)
    slope = H @ delta + g
    low, high = delta <= lower, delta >= upper
    assert (low | high).sum() > size // 4
    assert np.abs(slope[~low & ~high]).max() < 1e-14  # rounding of sums of numbers below 1
    assert (slope[low] >= 0).all()
    assert (slope[high] <= 0).all()


@pytest.mark.parametrize("radius", [np.inf, 3.0])
def test_even_cut_short_it_goes_down(radius, monkeypatch):
    H, g, lower, upper = coupled(60, 1e12, 1)
    values = []
    for steps in (1, 2, 5, 20, 100):
        monkeypatch.setattr(trust_region, "STEPS", steps)
        delta = trust_region.solve(H, g, lower, upper, radius)
        assert ((delta >= lower) & (delta <= upper)).all()
        values.append(delta @ H @ delta + 2 * g @ delta)
    assert values[0] < 0
    assert (np.diff(values) <= 0).all()


def test_where_0_is_not_within_the_bounds():
    H, g = np.diag([1.0, 2.0, 1.0]), np.array([-3.0, 0.0, 0.0])
    found = trust_region.solve(H, g, np.array([1.0, 1.0, -5.0]), np.array([2.0, 4.0, -1.0]))
    assert found.tolist() == [2.0, 1.0, -1.0]


def test_what_the_matrix_does_not_determine_stays_0():
    J, r, *_ = problem(6, 1, rows=4)
    wide = np.full(6, 1e3)
    found = trust_region.solve(J.T @ J, J.T @ r, -wide, wide)
    np.testing.assert_allclose(found, -np.linalg.pinv(J) @ r, rtol=1e-9)  # the condition squared, 1e2 … 1e4


@pytest.mark.parametrize("singular", [False, True])
@pytest.mark.parametrize("radius", [1e-6, 0.01, 0.1])
def test_the_radius_is_kept_and_used(singular, radius):
    J, r, *_ = problem(8, 2, rows=5 if singular else 24)
    H, g, wide = J.T @ J, J.T @ r, np.full(8, np.inf)
    whole = trust_region.solve(H, g, -wide, wide)
    assert np.linalg.norm(whole) > radius
    delta = trust_region.solve(H, g, -wide, wide, radius)
    assert 0.98 * radius < np.linalg.norm(delta) <= 1.0101 * radius  # "to 1 %"
    # the minimum on a sphere: the slope points inwards, along δ
    slope = H @ delta + g
    shift = -(slope @ delta) / (delta @ delta)
    assert shift > 0
    # eigenvalues below 1e-13 of the largest are left out; the rest is rounding
    np.testing.assert_allclose(slope, -shift * delta, atol=1e-9 * np.abs(g).max())


def test_bounds_cut_the_ball():
    H, g = np.eye(2), np.array([-10.0, -10.0])
    delta = trust_region.solve(H, g, np.array([-1.0, -1.0]), np.array([0.1, 5.0]), 1.0)
    assert delta[0] == 0.1
    assert 0.1 < delta[1] <= 1.0101  # "to 1 %"


def test_one_point_and_no_coordinates():
    J, r, *_ = problem(4, 6)
    point = np.zeros(4)
    np.testing.assert_array_equal(trust_region.solve(J.T @ J, J.T @ r, point, point), 0.0)
    none = np.zeros(0)
    assert trust_region.solve(np.zeros((0, 0)), none, none, none).shape == (0,)


@pytest.mark.parametrize("singular", [False, True])
@pytest.mark.parametrize("radius", [np.inf, 0.05])
def test_parts_that_share_nothing_are_solved_as_the_whole(singular, radius, monkeypatch):
    """Two problems of different sizes and scales within one trust_region, their coordinates mixed, on two threads."""
    monkeypatch.setattr(parallel, "processors", lambda: 2)
    monkeypatch.setattr(evidence, "LARGE", 1)
    (J, r, *_), (K, s, *_) = problem(8, 2, rows=5 if singular else 24), problem(5, 3)
    order = np.random.default_rng(1).permutation(13)
    H = np.block([[J.T @ J, np.zeros((8, 5))], [np.zeros((5, 8)), 9.0 * K.T @ K]])[np.ix_(order, order)]
    of = trust_region.Quadratic(H, np.concatenate([J.T @ r, K.T @ s])[order])
    assert sorted(map(len, of.places)) == [5, 8]
    delta = trust_region.within(of, radius)
    monkeypatch.setattr(trust_region, "independent", lambda H: [np.arange(len(H))])
    whole = trust_region.within(trust_region.Quadratic(H, of.g), radius)
    # rounding times the condition; within a ball both are right to 1 %, in the same rounds
    np.testing.assert_allclose(delta, whole, rtol=0, atol=1e-8 * np.abs(whole).max())


@pytest.mark.parametrize(("seed", "width"), [(4, 1.0), (0, 10.0), (4, 10.0)])
def test_steps_do_not_go_in_circles_where_the_matrix_is_singular(monkeypatch, seed, width):
    """Two or three sets of coordinates are held in turn, at the minimum but for rounding."""
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(30, 200)) * np.exp(2.0 * rng.normal(size=200))
    b = 10.0 * rng.normal(size=30)
    lower, upper = -width * rng.uniform(size=200), width * rng.uniform(size=200)
    solved, within = [], trust_region.within
    monkeypatch.setattr(trust_region, "within", lambda *problem: solved.append(1) or within(*problem))
    found = trust_region.solve(J.T @ J, J.T @ b, lower, upper)
    assert len(solved) <= 10
    best = lsq_linear(J, -b, (lower, upper), tol=1e-14).cost  # half of |J δ + b|²
    assert np.sum((J @ found + b) ** 2) <= 2.0 * best + 1e-9 * b @ b


def test_a_way_of_rounding_that_leads_out_of_the_bounds_costs_nothing_of_the_others():
    """Masses and stiffnesses with one common factor, of which g has a rounding: its way is 1000 times as long as the
    bounds are wide, and H does not count as singular.
    """
    rng = np.random.default_rng(0)
    axes = np.linalg.qr(np.column_stack([np.ones(40), rng.normal(size=(40, 39))]))[0]
    values = np.concatenate([[1e-11], np.geomspace(1e-4, 1.0, 39)])
    along = np.concatenate([[1e-8 * np.sqrt(40)], values[1:] * rng.normal(size=39)])
    H, g = (axes * values) @ axes.T, axes @ along
    assert trust_region.cholesky(H) is not None
    found = trust_region.solve(H, g, np.full(40, -5.0), np.full(40, 5.0))
    least = -np.sum(along[1:] ** 2 / values[1:])  # without that way, and inside the bounds
    assert trust_region.quadratic(H, g, found) <= 0.999 * least  # a shift of 1e-6 takes a hundredth off what 1e-4 adds


def test_an_end_of_the_time_is_heard_between_two_steps():
    J, r, lower, upper = problem(40, 0)
    with interrupts.limited(0.0), pytest.raises(interrupts.OutOfTime):
        trust_region.solve(J.T @ J, J.T @ r, lower, upper)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("H", [np.zeros((0, 0)), np.full((3, 3), np.nan), np.diag([1.0, np.inf])], ids=str)
def test_nothing_is_printed_about_matrices_that_cannot_be_factorised(capfd, H):
    size, wide = len(H), np.full(len(H), np.inf)
    np.testing.assert_array_equal(trust_region.solve(H, np.ones(size), -wide, wide), np.zeros(size))
    assert trust_region.cholesky(H) is None
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("seed", range(3))
def test_of_a_singular_matrix_the_eigenvalues_are_taken_once(seed, monkeypatch):
    """Where bounds cut the way again and again; and the minimum is that of SciPy."""
    rng = np.random.default_rng(seed)
    J, b = rng.normal(size=(30, 200)), 10.0 * rng.normal(size=30)
    lower, upper = -rng.uniform(size=200), rng.uniform(size=200)
    taken, solved, within_singular, within = [], [], trust_region.within_singular, trust_region.within
    monkeypatch.setattr(trust_region, "within_singular", lambda *given: taken.append(1) or within_singular(*given))
    monkeypatch.setattr(trust_region, "within", lambda *given: solved.append(1) or within(*given))
    found = trust_region.solve(J.T @ J, J.T @ b, lower, upper)
    assert len(taken) == 1 < len(solved)
    best = lsq_linear(J, -b, (lower, upper), tol=1e-14).cost  # half of |J δ + b|²
    assert np.sum((J @ found + b) ** 2) <= 2.0 * best + 1e-6 * b @ b  # by eigenvalues in every step it is 2e-8, too


def test_a_large_singular_matrix_needs_no_eigenvalues(monkeypatch):
    J, r, lower, upper = problem(60, 0, rows=30)
    exact = trust_region.solve(J.T @ J, J.T @ r, 10.0 * lower, 10.0 * upper)
    monkeypatch.setattr(trust_region, "EIGENVALUES", 59)
    monkeypatch.setattr(trust_region, "within_singular", None)
    found = trust_region.solve(J.T @ J, J.T @ r, 10.0 * lower, 10.0 * upper)
    assert np.sum((J @ found + r) ** 2) <= np.sum((J @ exact + r) ** 2) + 1e-9 * r @ r  # as above


def test_a_long_solution_is_heard_of_between_its_steps(monkeypatch):
    H, g, lower, upper = coupled(60, 1e6, 0)
    heard, alone = [], trust_region.solve(H, g, lower, upper)
    monkeypatch.setattr(trust_region, "PATIENCE", 0.0)
    found = trust_region.solve(H, g, lower, upper, waiting=lambda: heard.append(1))
    assert len(heard) > 2
    np.testing.assert_array_equal(found, alone)


def test_a_singular_matrix_beyond_numbers_changes_nothing_and_prints_nothing(capfd):
    H = np.diag([1e308, 1e308, 0.0])  # its trace is infinite
    with np.errstate(all="ignore"):
        found = trust_region.solve(H, np.array([-1e300, 1.0, 0.0]), np.full(3, -1e-9), np.full(3, 1e-9))
    assert np.isfinite(found).all()
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("size", [3, 40])
def test_a_sparse_matrix_has_the_solution_of_the_dense_one(size):
    rng = np.random.default_rng(2)
    A = rng.normal(size=(2 * size, size)) * (rng.uniform(size=(2 * size, size)) < 0.3)
    A[:, 1] = 0.0  # what no row knows
    H, right = A.T @ A + np.diag((A == 0).all(axis=0) * 0.0), A.T @ rng.normal(size=2 * size)
    found = trust_region.unbounded(csr_array(H), right)
    seen = np.diag(H) > 0
    expected = np.linalg.lstsq(H[np.ix_(seen, seen)], right[seen], rcond=None)[0]
    np.testing.assert_allclose(found[seen], expected, rtol=1e-6, atol=1e-9)  # the ridge, over the least eigenvalue
    assert (found[~seen] == 0).all()
    both = [trust_region.solve(M, -right, np.full(size, -0.1), np.full(size, 0.1)) for M in (csr_array(H), H)]
    np.testing.assert_allclose(*both, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("wrong", [np.inf, np.nan])
def test_a_sparse_matrix_that_has_no_factor_moves_nothing(wrong):
    H = csr_array(np.diag([1.0, wrong, 2.0]))
    np.testing.assert_array_equal(trust_region.unbounded(H, np.ones(3)), 0.0)
