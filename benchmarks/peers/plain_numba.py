"""Plain numba: block-Jacobi conjugate gradients from the last velocity, on a matrix stored in full.

As a user would write it who knows the method and numba, and stops there: loops over vertices, springs and faces, 3 × 3
blocks as (…, 3, 3) arrays, one compiled loop over all steps, no trick of a lower level. The adjoint's systems have the
step's matrix, assembled again, and start from the last λ. No `fastmath`: with it the program is a tenth slower.
"""

from __future__ import annotations

from peers.plain_numba_adjoint import sweep_back
from peers.plain_numba_step import simulate
from peers.problem import Problem, block_pattern


class Peer:
    """The program on one cloth."""

    name = "plain numba"

    def __init__(self, problem: Problem) -> None:
        self.problem, self.pattern, self.iterations = problem, block_pattern(problem), 0.0

    def steps(self, n, tolerance):
        """The motion of n steps."""
        p = self.problem
        xs, _, iterations = simulate(p, p.stiffness, *self.pattern, n, tolerance)
        self.iterations = iterations / n
        return xs

    def cost_and_gradient(self, k, target, tolerance):
        """G and ∂G/∂k."""
        xs, vs, _ = simulate(self.problem, k, *self.pattern, len(target) - 1, tolerance)
        return sweep_back(self.problem, k, *self.pattern, xs, vs, target, tolerance)
