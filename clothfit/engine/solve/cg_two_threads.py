"""The conjugate gradients of `cg` for large cloths, whose rows two threads share.

The rows are in three subdomains (`sparse.Pattern`): the first two are not joined to each other, and the separator is
joined to both. Each pass over the rows goes through the subdomains, in the order 0, 1, 2 where values are pushed to
later rows and 2, 0, 1 where they come from there; a second thread, where there is one, takes subdomain 1 (see
`two_threads`). The numbers are the same to the last bit with one thread or two.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from clothfit.base.arrays import Array, staggered
from clothfit.engine.solve import cg, sparse, ssor, two_threads
from clothfit.engine.solve.cg import CHECK_WITHIN, CONVERGED, INDEFINITE, LIMIT
from clothfit.engine.solve.two_threads import SERVES, STOP, Worker
from clothfit.kernels.kernel import kernel

RESIDUAL, COPY, SOLVE_LOWER, WEIGH = 0.0, 1.0, 2.0, 3.0
SOLVE_UPPER, APPLY_LOWER, UPDATE, CLEAR, SQUARED_RESIDUAL = 4.0, 5.0, 6.0, 7.0, 8.0
"""Passes over the rows. Integers would make numba compile everything below anew for each value that it knows."""


class Second(NamedTuple):
    """What the second subdomain needs of its own."""

    far: Array  # (n, 4), as `own` of `cg.Workspace`
    worker: Worker


def second(A: sparse.BlockMatrix) -> Second | None:
    """Memory for the second subdomain of a matrix; None where all its rows are in the first."""
    begin, end = A.subdomains[1]
    _, far = staggered(2, len(A.diagonal) - 1, 4)  # half a page from where x begins, and away from the others
    return Second(far, two_threads.worker()) if begin < end else None


@kernel
def solve(A, b, tolerance, limit, work, second, w):
    """As `cg.solve`, in subdomains; the lines of the algorithm have the same numbers."""
    x, own, inverse, far = work.x, work.own, work.inverse, second.far
    bb = ssor.enter(A, A.subdomains[0], b, w, x, own)
    bb += ssor.enter(A, A.subdomains[1], b, w, x, far) + ssor.enter(A, A.subdomains[2], b, w, x, own)
    rr = sweep(A, work, second, RESIDUAL, 0.0, 0.0)  # 1
    target = tolerance * tolerance * bb
    if ssor.is_solved(A, rr, bb, target, w):
        return 0, CONVERGED
    omega = ssor.omega(A)
    if not sparse.invert_diagonal(A, omega, inverse):
        return 0, INDEFINITE
    scale, kappa = 1.0 / omega, 2.0 / omega - 1.0
    sweep(A, work, second, COPY, 0.0, 0.0)
    sweep(A, work, second, SOLVE_LOWER, 0.0, 0.0)
    rz = sweep(A, work, second, WEIGH, scale, 0.0)
    ratio, beta = rr / rz, 0.0
    for iteration in range(1, limit + 1):  # 2
        sweep(A, work, second, SOLVE_UPPER, kappa, beta)  # 8 of the last j
        curvature = sweep(A, work, second, APPLY_LOWER, 0.0, 0.0)
        if not curvature > 0.0:
            return iteration, INDEFINITE
        alpha = rz / curvature  # 3
        rz_new = sweep(A, work, second, UPDATE, alpha, scale)  # 4, 5, 6
        if rz_new * ratio <= CHECK_WITHIN * target:
            sweep(A, work, second, CLEAR, 0.0, 0.0)
            rr = sweep(A, work, second, SQUARED_RESIDUAL, scale, 0.0)
            if rr <= target:
                ssor.leave(A, x, w)
                return iteration, CONVERGED
            ratio = rr / rz_new
        beta, rz = rz_new / rz, rz_new  # 7
    return limit, LIMIT


@kernel
def sweep(A, work, second, phase, first, other):
    """A pass over all rows, subdomain by subdomain, with its parameters; returns its sum over the rows."""
    worker = second.worker
    serves = worker.flags[SERVES] == 1
    total = 0.0
    for turn in range(3):
        s = (turn + 2) % 3 if phase == SOLVE_UPPER else turn
        if serves and s == 1 and not two_threads.claim(worker):
            two_threads.wait(worker)
            total += worker.message[0, 3]
            continue
        if serves and s == 0:
            worker.message[0, 1], worker.message[0, 2] = first, other
            two_threads.post(worker, phase)
        total += act(A, work, second.far, s, phase, first, other)
        if serves and s == 1:
            two_threads.done(worker)
    return total


@kernel
def act(A, work, far, s, phase, first, other):
    """A pass over the rows of subdomain s; returns its sum."""
    x, r, p, t, q, z, own, inverse = work
    subdomain = A.subdomains[s]
    if s == 1:
        own = far
    if s == 2 and phase in (RESIDUAL, SOLVE_LOWER, APPLY_LOWER, SQUARED_RESIDUAL):
        ssor.gather(A, subdomain, far, own)
    if phase == RESIDUAL:
        return ssor.residual(A, subdomain, x, own, r)
    if phase == COPY:
        ssor.copy_rows(A, subdomain, r, own)
    elif phase == SOLVE_LOWER:
        ssor.solve_lower(A, subdomain, inverse, own, r)
    elif phase == WEIGH:
        return ssor.weigh(A, subdomain, first, r, z)
    elif phase == SOLVE_UPPER:
        ssor.solve_upper(A, subdomain, inverse, first, other, z, p, t, own)
    elif phase == APPLY_LOWER:
        return ssor.apply_lower(A, subdomain, inverse, p, t, own, q)
    elif phase == UPDATE:
        return ssor.advance(A, subdomain, first, other, t, q, x, r, z)
    elif phase == CLEAR:
        ssor.clear(A, subdomain, own)
    elif phase == SQUARED_RESIDUAL:
        return ssor.squared_residual(A, subdomain, first, r, own)
    return 0.0


@kernel(nogil=True)
def serve(A, work, second):
    """The second thread: pass over subdomain 1 whenever a phase is posted, until the phase is STOP."""
    worker = second.worker
    two_threads.enter(worker)
    while True:
        phase = two_threads.next_phase(worker)
        if phase == STOP:
            return
        worker.message[0, 3] = act(A, work, second.far, 1, phase, worker.message[0, 1], worker.message[0, 2])
        two_threads.done(worker)


@contextmanager
def served(A: sparse.BlockMatrix, work: cg.Workspace, second: Second | None) -> Iterator[None]:
    """Within the block a second thread serves the solves with this matrix and memory, if their rows are shared."""
    if second is None:
        yield
        return
    with two_threads.serving(second.worker, lambda: serve(A, work, second)):
        yield
