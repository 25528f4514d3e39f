"""PyTorch: compiled assembly, conjugate gradients on a CSR matrix, the solve an autograd function of its own.

Steps and solver are Python loops, for neither has a fixed length; what lies between two solves is compiled by
`torch.compile`, forward and backward. Backward through a solve is one with the same matrix, from the last λ, to the
same tolerance; PyTorch's tape does the rest.
"""

from __future__ import annotations

import warnings

import numpy as np
import torch

from measure import cores
from peers.problem import Problem, block_pattern

torch.set_num_threads(cores())
warnings.filterwarnings("ignore", message="Sparse CSR tensor support")  # is in beta state, it says


def conjugate_gradients(A, M, b, first, tolerance):
    """Solve A x = b with the preconditioner M; x and the iterations."""
    x, r = first.clone(), b - torch.mv(A, first)
    goal = tolerance**2 * float(torch.dot(b, b))
    z = torch.mv(M, r)
    d, rz, count = z.clone(), float(torch.dot(r, z)), 0
    while float(torch.dot(r, r)) > goal:
        q = torch.mv(A, d)
        alpha = rz / float(torch.dot(d, q))
        x.add_(d, alpha=alpha)
        r.sub_(q, alpha=alpha)
        z = torch.mv(M, r)
        before, rz = rz, float(torch.dot(r, z))
        d.mul_(rz / before).add_(z)
        count += 1
    return x, count


class Solve(torch.autograd.Function):
    """w of A w = b; the gradients are λ of A λ = w̄ by b, and −λ wᵀ by the entries of A."""

    @staticmethod
    def forward(ctx, blocks, b, first, peer, tolerance):
        """Solve, from the guess `first`."""
        A, M = peer.matrices(blocks)
        w, count = conjugate_gradients(A, M, b, first, tolerance)
        peer.count += count
        ctx.save_for_backward(w)
        ctx.matrices, ctx.peer, ctx.tolerance = (A, M), peer, tolerance
        return w

    @staticmethod
    def backward(ctx, w_bar):
        """Solve again, with the transpose, which is the same."""
        (w,), peer = ctx.saved_tensors, ctx.peer
        peer.lam, _ = conjugate_gradients(*ctx.matrices, w_bar, peer.lam, ctx.tolerance)
        lam, w = peer.lam.view(-1, 3), w.view(-1, 3)
        return -lam[peer.rows][:, :, None] * w[peer.columns][:, None, :], peer.lam, None, None, None


class Peer:
    """The program on one cloth."""

    name = "PyTorch"

    def __init__(self, problem: Problem) -> None:
        self.problem, self.iterations, self.count = problem, 0.0, 0
        n = len(problem.mass)
        self.pattern(problem)
        values = ("x0", "v0", "mass", "rest", "stiffness", "wind", "gravity")
        self.x0, self.v0, self.mass, self.rest, self.k, self.wind, self.gravity = (
            torch.tensor(getattr(problem, name), dtype=torch.float64) for name in values
        )
        self.a, self.b = torch.tensor(problem.ends.T, dtype=torch.int64)
        self.corners = torch.tensor(problem.corners, dtype=torch.int64)
        self.free = torch.tensor(problem.free, dtype=torch.float64)[:, None]
        self.unit, self.lam = torch.eye(3, dtype=torch.float64), torch.zeros(3 * n, dtype=torch.float64)
        self.system = torch.compile(self.assemble)

    def pattern(self, problem):
        """Where blocks go: the matrix's blocks row by row with the diagonal, and its scalars as CSR.

        Fixed vertices keep their diagonal block alone, with a right-hand side of 0.
        """
        n, (row, column, _) = len(problem.mass), block_pattern(problem)
        rows = np.repeat(np.arange(n), np.diff(row))
        kept = problem.free[rows] & problem.free[column]
        keys = np.unique(np.r_[np.arange(n) * (n + 1), rows[kept] * n + column[kept]])
        rows, columns = keys // n, keys % n
        a, b = problem.ends.T.astype(np.int64)
        wanted = np.concatenate([np.arange(n) * (n + 1), a * n + b, b * n + a])
        slots = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        slots[keys[slots] != wanted] = len(keys)  # one more, which is not read
        self.rows, self.columns, self.slots = torch.tensor(rows), torch.tensor(columns), torch.tensor(slots)
        e, r, c = (index.ravel() for index in np.indices((len(keys), 3, 3)))
        order = np.lexsort((3 * columns[e] + c, 3 * rows[e] + r))
        self.order = torch.tensor(order)
        self.csr = torch.tensor(np.searchsorted((3 * rows[e] + r)[order], np.arange(3 * n + 1)))
        self.csr_columns = torch.tensor((3 * columns[e] + c)[order])
        i, r, c = (index.ravel() for index in np.indices((n, 3, 3)))
        self.m, self.m_columns = torch.arange(0, 9 * n + 1, 3), torch.tensor(3 * i + c)

    def matrices(self, blocks):
        """The matrix, and the inverses of its diagonal blocks."""
        values, inverses = blocks.reshape(-1)[self.order], torch.linalg.inv(blocks[self.slots[: len(self.mass)]])
        size = (len(self.lam), len(self.lam))
        return (
            torch.sparse_csr_tensor(self.csr, self.csr_columns, values, size, check_invariants=False),
            torch.sparse_csr_tensor(self.m, self.m_columns, inverses.reshape(-1), size, check_invariants=False),
        )

    def assemble(self, x, v, k):
        """Blocks (E, 3, 3) of the matrix and the right-hand side (3 n,)."""
        p, h = self.problem, self.problem.h
        e = x[self.a] - x[self.b]
        length = torch.sqrt((e * e).sum(dim=1))
        d, rho = e / length[:, None], self.rest / length
        along = (h * k * (h * rho + 0.5 * p.damping))[:, None] * d
        springs = along[:, :, None] * d[:, None, :] + (h * h * k * (1.0 - rho))[:, None, None] * self.unit
        pull = (h * k * (length - self.rest))[:, None] * d
        b = self.mass[:, None] * (v + h * self.gravity)
        b = b.index_add(0, self.a, -pull).index_add(0, self.b, pull)
        vertex = (1.0 + h * p.damping) * self.mass[:, None, None] * self.unit
        vertex = vertex.index_add(0, self.a, springs).index_add(0, self.b, springs)
        if len(p.corners):
            i, j, m = self.corners.T
            normal = torch.linalg.cross(x[j] - x[i], x[m] - x[i])
            kappa = h * p.drag / 6.0 * torch.sqrt((normal * normal).sum(dim=1))
            inflow = (normal * (self.wind - (v[i] + v[j] + v[m]) / 3.0)).sum(dim=1)
            scaled = kappa[:, None] * normal
            lumped, push = scaled[:, :, None] * normal[:, None, :], inflow[:, None] * scaled
            drag = torch.zeros_like(vertex)
            for corner in (i, j, m):
                drag = drag.index_add(0, corner, lumped)
                b = b.index_add(0, corner, push)
            vertex = vertex + drag
            b = b + (drag * v[:, None, :]).sum(dim=2)
        blocks = torch.zeros((len(self.rows) + 1, 3, 3), dtype=torch.float64)
        blocks = blocks.index_add(0, self.slots, torch.cat([vertex, -springs, -springs]))
        return blocks[:-1], (self.free * b).reshape(-1)

    def simulate(self, k, n, tolerance):
        """The list of the n + 1 positions (vertices, 3)."""
        x, v, self.count = self.x0, self.v0, 0
        xs = [x]
        for _ in range(n):
            blocks, b = self.system(x, v, k)
            v = Solve.apply(blocks, b, v.detach().reshape(-1), self, tolerance).view(-1, 3)
            x = x + self.problem.h * v
            xs.append(x)
        self.iterations = self.count / n
        return xs

    def steps(self, n, tolerance):
        """The motion of n steps."""
        with torch.no_grad():
            return torch.stack(self.simulate(self.k, n, tolerance)).numpy()

    def cost_and_gradient(self, k, target, tolerance):
        """G and ∂G/∂k."""
        k = torch.tensor(k, requires_grad=True)
        self.lam = torch.zeros_like(self.lam)
        gap = torch.stack(self.simulate(k, len(target) - 1, tolerance)) - torch.as_tensor(target)
        cost = (gap * gap).sum()
        cost.backward()
        return float(cost.detach()), k.grad.numpy()
