"""SciPy: assembly by vectorised NumPy, `scipy.sparse.linalg.cg` on a BSR matrix with block-Jacobi, no derivative.

What springs and faces contribute is added up by constant sparse matrices of ones, so that no Python loop runs over
elements.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import bsr_array, csr_array
from scipy.sparse.linalg import cg

from peers.problem import Problem


class Peer:
    """The program on one cloth."""

    name = "SciPy"
    cost_and_gradient = None

    def __init__(self, problem: Problem) -> None:
        self.problem, self.iterations = problem, 0.0
        n, springs, faces = len(problem.mass), len(problem.rest), len(problem.corners)
        place = np.cumsum(problem.free) - 1  # of the free vertices among the unknowns
        self.free = np.flatnonzero(problem.free)
        a, b = problem.ends.T
        s, i = np.arange(springs), np.arange(len(self.free))
        # blocks of the matrix: one for each vertex, (a, a), (b, b), (a, b) and (b, a) for each spring, joined by place
        rows, columns = np.concatenate([[a, a], [b, b], [a, b], [b, a]], axis=1)
        kept = problem.free[rows] & problem.free[columns]
        m = len(self.free)
        keys = place[rows[kept]] * m + place[columns[kept]]
        blocks, slots = np.unique(np.concatenate([i * m + i, keys]), return_inverse=True)
        self.columns, self.starts = blocks % m, np.searchsorted(blocks, np.arange(m + 1) * m)
        self.diagonal = slots[:m]
        signs = np.repeat([1.0, 1.0, -1.0, -1.0], springs)[kept]
        self.to_blocks = csr_array((signs, (slots[m:], np.tile(s, 4)[kept])), shape=(len(blocks), springs))
        self.to_ends = csr_array((np.repeat([1.0, -1.0], springs), (np.r_[a, b], np.r_[s, s])), shape=(n, springs))
        corner = problem.corners.reshape(-1)
        self.to_corners = csr_array((np.ones(3 * faces), (corner, np.arange(3 * faces) // 3)), shape=(n, faces))

    def assemble(self, x, v):
        """The matrix and the right-hand side of the free vertices."""
        p, h = self.problem, self.problem.h
        e = x[p.ends[:, 0]] - x[p.ends[:, 1]]
        length = np.sqrt((e * e).sum(axis=1))
        d, rho = e / length[:, None], p.rest / length
        across = h * h * p.stiffness * (1.0 - rho)
        along = h * p.stiffness * (h * rho + 0.5 * p.damping)
        springs = (along[:, None] * d)[:, :, None] * d[:, None, :] + across[:, None, None] * np.eye(3)
        data = (self.to_blocks @ springs.reshape(-1, 9)).reshape(-1, 3, 3)
        pull = h * p.stiffness * (length - p.rest)
        b = p.mass[:, None] * (v + h * p.gravity) - self.to_ends @ (pull[:, None] * d)
        vertex = np.multiply.outer((1.0 + h * p.damping) * p.mass, np.eye(3))
        if len(p.corners):
            i, j, k = p.corners.T
            n = np.cross(x[j] - x[i], x[k] - x[i])
            kappa = h * p.drag / 6.0 * np.sqrt((n * n).sum(axis=1))
            inflow = (n * (p.wind - (v[i] + v[j] + v[k]) / 3.0)).sum(axis=1)
            lumped = (kappa[:, None] * n)[:, :, None] * n[:, None, :]
            lumped = (self.to_corners @ lumped.reshape(-1, 9)).reshape(-1, 3, 3)
            vertex += lumped
            b += self.to_corners @ ((kappa * inflow)[:, None] * n) + np.einsum("irc,ic->ir", lumped, v)
        data[self.diagonal] += vertex[self.free]
        size = 3 * len(self.free)
        return bsr_array((data, self.columns, self.starts), shape=(size, size)), b[self.free].ravel()

    def steps(self, n, tolerance):
        """The motion of n steps."""
        p, free, count = self.problem, self.free, 0
        xs, v = np.empty((n + 1, *p.x0.shape)), p.v0.copy()
        xs[0] = p.x0

        def tick(_):
            nonlocal count
            count += 1

        m = len(free)
        for t in range(n):
            A, b = self.assemble(xs[t], v)
            inverses = np.linalg.inv(A.data[self.diagonal])
            M = bsr_array((inverses, np.arange(m), np.arange(m + 1)), shape=A.shape)
            w, ended = cg(A, b, v[free].ravel(), rtol=tolerance, atol=0.0, M=M, callback=tick)
            if ended:
                raise ArithmeticError(f"SciPy's conjugate gradients end with {ended} in step {t + 1}")
            v[free] = w.reshape(-1, 3)
            xs[t + 1] = xs[t] + p.h * v
        self.iterations = count / n
        return xs
