"""The passes over rows against dense triangular matrices, all rows at once and in three subdomains."""

from typing import NamedTuple

import numpy as np
import pytest
from helpers.matrices import free_but, in_order, joined, lanes_of, matrix, parts, right_side, scrambled

from clothfit.base.arrays import aligned
from clothfit.engine.solve import sparse, ssor

pytestmark = pytest.mark.slow  # compiles a fit

SIDE = 6
N = SIDE * SIDE
FREE = free_but(N, 3, 17)
OMEGA = 1.4
GUARD = 7.0  # at fixed vertices, which no pass touches
WHOLE, SPLIT = "whole", "split"


class Case(NamedTuple):
    """A matrix, its subdomains and its parts in the order of sweep."""

    A: sparse.BlockMatrix
    subdomains: np.ndarray
    inverse: np.ndarray  # D̂⁻¹
    D: np.ndarray
    lower: np.ndarray  # D̂ + L
    upper: np.ndarray


@pytest.fixture(params=[WHOLE, SPLIT])
def case(request, monkeypatch):
    """The same matrix with the same order of sweep, its rows in one subdomain or in three."""
    monkeypatch.setattr(sparse, "MULTIGRID_FROM", 10)
    A = matrix(scrambled(joined(SIDE), N), FREE)
    m, inverse = len(A.order), aligned(N + 1, 8)
    assert (np.diff(A.subdomains, axis=1) > 0).all()
    assert sparse.invert_diagonal(A, OMEGA, inverse)
    whole = np.array([[0, m], [m, m], [m, m]], np.int32)
    return Case(A, {WHOLE: whole, SPLIT: A.subdomains}[request.param], inverse, *parts(A, OMEGA))


def vector(seed):
    """Random (n, 4), GUARD at fixed vertices, 0 in lane 3 of the others."""
    made = lanes_of(right_side(FREE, seed))
    made[~FREE] = GUARD
    return made


def blank():
    """What is to be filled: (n, 4)."""
    return np.where(FREE[:, None], np.nan, GUARD) * np.ones(4)


def flat(case, v):
    """The free rows (3m,) of a vector (n, 4), in the order of sweep; its lane 3 and its fixed rows are as they were."""
    assert (v[case.A.order, 3] == 0.0).all()
    assert (v[~FREE] == GUARD).all()
    return v[case.A.order, :3].reshape(-1)


def forward(case, run, start=None):
    """The sum over the subdomains of run(subdomain, own), with own = start (or 0) at first: as two threads do it."""
    own, far = np.zeros((2, N, 4))
    for subdomain, memory in zip(case.subdomains, (own, far, own), strict=True):
        if start is not None:
            rows = case.A.order[slice(*subdomain)]
            memory[rows] = start[rows]
    total = 0.0
    for s, subdomain in enumerate(case.subdomains):
        if s == 2:
            ssor.gather(case.A, subdomain, far, own)
        total += run(subdomain, far if s == 1 else own) or 0.0
    assert (far[case.A.order[case.subdomains[2, 0] :]] == 0.0).all()  # taken over, for the next pass
    return total


def close(a, b):
    """To rounding: sums of some 20 products of order 1 … 10, and triangular systems of condition below 100."""
    np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


def test_residual(case):
    x, b, r = vector(1), vector(2), blank()
    rr = forward(case, lambda subdomain, own: ssor.residual(case.A, subdomain, x, own, r), b)
    expected = flat(case, b) - in_order(case.A) @ flat(case, x)
    close(flat(case, r), expected)
    close(rr, expected @ expected)


def test_lower_triangular_solve(case):
    b, r = vector(1), blank()
    forward(case, lambda subdomain, own: ssor.solve_lower(case.A, subdomain, case.inverse, own, r), b)
    close(flat(case, r), np.linalg.solve(case.lower, flat(case, b)))


def upward(case, beta, z, p):
    """p = z + β p, t and own of solve_upper, the third subdomain first."""
    t, own, kappa = blank(), blank(), 2.0 / OMEGA - 1.0
    for s in (2, 0, 1):
        ssor.solve_upper(case.A, case.subdomains[s], case.inverse, kappa, beta, z, p, t, own)
    return t, own


@pytest.mark.parametrize("beta", [0.0, 0.7])
def test_upper_triangular_solve(case, beta):
    z, p = vector(1), vector(2)
    direction = flat(case, z) + beta * flat(case, p)
    t, own = upward(case, beta, z, p)
    expected = np.linalg.solve(case.upper, direction)
    close(flat(case, p), direction)
    close(flat(case, t), expected)
    close(flat(case, own), direction - (2.0 / OMEGA - 1.0) * case.D @ expected)


def test_two_triangular_solves_are_the_preconditioned_matrix(case):
    p, q = vector(1), blank()
    t, start = upward(case, 0.0, p.copy(), p)

    def run(subdomain, own):
        return ssor.apply_lower(case.A, subdomain, case.inverse, p, t, own, q)

    curvature = forward(case, run, start)
    expected = np.linalg.solve(case.lower, in_order(case.A) @ np.linalg.solve(case.upper, flat(case, p)))
    close(flat(case, q), expected)
    close(curvature, flat(case, p) @ expected)


def test_the_true_residual_from_the_preconditioned_one(case):
    r = vector(1)
    squared = forward(case, lambda subdomain, own: ssor.squared_residual(case.A, subdomain, 1.0 / OMEGA, r, own))
    close(squared, np.linalg.norm(case.lower @ flat(case, r)) ** 2)


def test_steps_along_a_direction(case):
    t, q, x, r, z = vector(1), vector(2), vector(3), vector(4), blank()
    moved, left = flat(case, x) + 0.3 * flat(case, t), flat(case, r) - 0.3 * flat(case, q)
    rz = sum(ssor.advance(case.A, subdomain, 0.3, 1.0 / OMEGA, t, q, x, r, z) for subdomain in case.subdomains)
    close(flat(case, x), moved)
    close(flat(case, r), left)
    close(flat(case, z), case.D @ left / OMEGA)
    close(rz, left @ case.D @ left / OMEGA)


def test_weights(case):
    r, z = vector(1), blank()
    rz = sum(ssor.weigh(case.A, subdomain, 0.5, r, z) for subdomain in case.subdomains)
    close(flat(case, z), 0.5 * case.D @ flat(case, r))
    close(rz, 0.5 * flat(case, r) @ case.D @ flat(case, r))


def test_vectors_come_in_and_go_out_as_they_are(case):
    b, w = right_side(FREE, 1), right_side(FREE, 2) + GUARD * ~FREE[:, None]
    x, own, out = blank(), blank(), np.full((N, 3), GUARD)
    bb = sum(ssor.enter(case.A, subdomain, b, w, x, own) for subdomain in case.subdomains)
    close(bb, np.vdot(b, b))
    assert flat(case, x).tolist() == w[case.A.order].reshape(-1).tolist()
    assert flat(case, own).tolist() == b[case.A.order].reshape(-1).tolist()
    ssor.leave(case.A, x, out)
    assert out.tolist() == w.tolist()
    for subdomain in case.subdomains:
        ssor.clear(case.A, subdomain, own)
    assert (flat(case, own) == 0.0).all()


def relaxation(mass, pull=1.0):
    """ω of a grid of free vertices that all have this mass."""
    return ssor.omega(matrix(joined(SIDE), np.ones(N, bool), pull, mass))


def test_the_relaxation_factor_is_nearer_2_the_lighter_the_masses():
    factors = [relaxation(10.0**-k) for k in range(-3, 4)]
    assert (np.diff(factors) > 0).all()
    assert factors[0] > 1.0
    assert factors[-1] < 2.0


def test_the_relaxation_factor_by_its_formula():
    A = matrix(joined(SIDE), np.ones(N, bool))
    q = 3.0 * N / np.trace(in_order(A))  # the masses beside the diagonal: springs add up to 0 over a row
    assert ssor.omega(A) == pytest.approx(2.0 / (1.0 + q**0.2), rel=1e-12)  # sums of some hundred numbers


def test_the_relaxation_factor_of_extremes():
    assert relaxation(1.0, pull=0.0) == 1.0  # nothing to relax
    assert relaxation(0.0) == 2.0 / (1.0 + 1e-5**0.2)  # no mass: not 2, where nothing would converge
    assert relaxation(100.0, pull=-1.0) == 1.0  # an indefinite matrix has none, and conjugate gradients notice
