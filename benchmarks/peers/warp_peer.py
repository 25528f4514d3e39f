"""Warp on the processor: kernels over vertices, springs and faces, a conjugate-gradient kernel written by hand, and the
derivative by an adjoint written by hand as well. All steps of a run are recorded once as a graph and then replayed.

On a processor Warp runs a kernel's elements one after the other, so sums are not in danger, and the solver's loop is a
kernel of a single element. It starts from the last velocity, the adjoint's from the last λ.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from peers import warp_kernels as kernels
from peers.problem import Problem, block_pattern
from peers.warp_kernels import mat, vec


class Peer:
    """The program on one cloth."""

    name = "Warp"

    def __init__(self, problem: Problem) -> None:
        self.problem, self.iterations, self.graphs = problem, 0.0, {}
        n, (row, column, slots) = len(problem.mass), block_pattern(problem)
        self.cloth, self.work = kernels.Cloth(), kernels.Work()
        for field in ("mass", "rest"):
            setattr(self.cloth, field, wp.array(getattr(problem, field), dtype=wp.float64))
        self.cloth.free = wp.array(problem.free, dtype=wp.bool)
        arrays = {"ends": problem.ends, "slots": slots, "corners": problem.corners, "row": row, "column": column}
        for field, value in arrays.items():
            setattr(self.cloth, field, wp.array(value, dtype=wp.int32))
        self.cloth.drag, self.cloth.damping, self.cloth.h = problem.drag, problem.damping, problem.h
        self.cloth.wind, self.cloth.gravity = vec(*problem.wind), vec(*problem.gravity)
        for field in ("diagonal", "inverse"):
            setattr(self.work, field, wp.zeros(n, dtype=mat))
        for field in ("b", "r", "d", "q"):
            setattr(self.work, field, wp.zeros(n, dtype=vec))
        self.work.blocks, self.work.iterations = wp.zeros(len(column), dtype=mat), wp.zeros(1, dtype=wp.int32)
        self.w, self.lam, self.x_bar, self.v_bar = (wp.zeros(n, dtype=vec) for _ in range(4))
        self.k, self.gradient = (wp.array(problem.stiffness, dtype=wp.float64) for _ in range(2))
        self.cost, self.v0 = wp.zeros(1, dtype=wp.float64), wp.array(problem.v0, dtype=vec)

    def launch(self, kernel, count, *arguments):
        """Launch, or record, a kernel over `count` elements."""
        wp.launch(kernel, dim=count, inputs=[self.cloth, *arguments], device="cpu")

    def assemble(self, t):
        """The matrix and the right-hand side of step t."""
        p = self.problem
        self.work.blocks.zero_()
        self.launch(kernels.vertices, len(p.mass), t, self.v, self.work)
        self.launch(kernels.springs, len(p.rest), self.k, t, self.x, self.work)
        if len(p.corners):
            self.launch(kernels.faces, len(p.corners), t, self.x, self.v, self.work)

    def forward(self, n):
        """All steps."""
        self.work.iterations.zero_()
        wp.copy(self.w, self.v0)
        for t in range(n):
            self.assemble(t)
            self.launch(kernels.solve, 1, self.work, self.w)
            self.launch(kernels.advance, len(self.problem.mass), t, self.w, self.x, self.v)

    def backward(self, n):
        """The adjoint sweep."""
        p, size = self.problem, len(self.problem.mass)
        for array in (self.lam, self.x_bar, self.v_bar, self.gradient, self.cost):
            array.zero_()
        for t in range(n, -1, -1):
            wp.launch(kernels.compare, dim=size, inputs=[t, self.x, self.target, self.x_bar, self.cost], device="cpu")
            if t == 0:
                break
            self.assemble(t - 1)
            self.launch(kernels.seed, size, self.x_bar, self.v_bar, self.work)
            self.launch(kernels.solve, 1, self.work, self.lam)
            self.launch(kernels.vertices_back, size, self.lam, self.v_bar)
            state = (t - 1, self.x, self.v, self.lam, self.x_bar)
            self.launch(kernels.springs_back, len(p.rest), self.k, *state, self.gradient)
            if len(p.corners):
                self.launch(kernels.faces_back, len(p.corners), *state, self.v_bar)

    def replay(self, n, tolerance, back):
        """Run the graph of n steps, recorded at the first call; `back` with the adjoint sweep."""
        key = n, tolerance, back
        if key not in self.graphs:
            self.cloth.tolerance = tolerance
            x = np.broadcast_to(self.problem.x0, (n + 1, *self.problem.x0.shape))
            v = np.broadcast_to(self.problem.v0, x.shape)
            self.x, self.v, self.target = (wp.array(a, dtype=vec, device="cpu") for a in (x, v, x))
            wp.load_module(kernels, device="cpu")
            with wp.ScopedCapture(device="cpu") as capture:
                self.forward(n)
                if back:
                    self.backward(n)
            self.graphs[key] = capture.graph, self.x, self.target
        return self.graphs[key]

    def steps(self, n, tolerance):
        """The motion of n steps."""
        graph, x, _ = self.replay(n, tolerance, False)
        self.k.assign(self.problem.stiffness)
        wp.capture_launch(graph)
        self.iterations = float(self.work.iterations.numpy()[0]) / n
        return x.numpy().copy()

    def cost_and_gradient(self, k, target, tolerance):
        """G and ∂G/∂k."""
        graph, _, goal = self.replay(len(target) - 1, tolerance, True)
        self.k.assign(k)
        goal.assign(target)
        wp.capture_launch(graph)
        return float(self.cost.numpy()[0]), self.gradient.numpy().copy()
