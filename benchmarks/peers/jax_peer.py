"""JAX: matrix-free conjugate gradients in a `scan` over the steps, differentiated through `custom_linear_solve`.

The matrix is never formed: a product gathers, for each vertex, its springs' blocks times what their other ends hold, by
a list of springs padded to the longest; gathering is several times faster here than adding to scattered places. The
derivative is JAX's own: reverse mode through the scan, implicit at each solve, its systems solved to the same
tolerance.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from peers.problem import Problem

jax.config.update("jax_enable_x64", True)


def incident(members, n):
    """For each of n vertices the entries of `members` (R,) that name it, padded with R: (n, most)."""
    order = np.argsort(members, kind="stable")
    counts = np.bincount(members, minlength=n)
    starts = np.cumsum(counts) - counts
    table = np.full((n, counts.max(initial=0)), len(members))
    table[members[order], np.arange(len(members)) - np.repeat(starts, counts)] = order
    return table


def symmetric(scale, n):
    """scale · n nᵀ as its six upper numbers."""
    x, y, z = n
    return scale * jnp.stack([x * x, x * y, x * z, y * y, y * z, z * z])


def apply(blocks, x):
    """Products of symmetric blocks (6, …) with vectors (3, …)."""
    xx, xy, xz, yy, yz, zz = blocks
    return jnp.stack([
        xx * x[0] + xy * x[1] + xz * x[2],
        xy * x[0] + yy * x[1] + yz * x[2],
        xz * x[0] + yz * x[1] + zz * x[2],
    ])


def inverse(blocks):
    """Inverses of symmetric blocks (6, …)."""
    xx, xy, xz, yy, yz, zz = blocks
    c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    rest = [xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy]
    return jnp.stack([c0, c1, c2, *rest]) / (xx * c0 + xy * c1 + xz * c2)


def conjugate_gradients(matvec, b, first, inverses, tolerance):
    """Solve A x = b from a first guess; x and the iterations."""
    goal = tolerance**2 * jnp.vdot(b, b)
    r = b - matvec(first)
    z = apply(inverses, r)

    def go_on(state):
        return jnp.vdot(state[1], state[1]) > goal

    def iterate(state):
        x, r, d, rz, count = state
        q = matvec(d)
        alpha = rz / jnp.vdot(d, q)
        x, r = x + alpha * d, r - alpha * q
        z = apply(inverses, r)
        after = jnp.vdot(r, z)
        return x, r, z + after / rz * d, after, count + 1

    x, *_, count = lax.while_loop(go_on, iterate, (first, r, z, jnp.vdot(r, z), 0))
    return x, count


class Peer:
    """The program on one cloth; vectors are (3, n)."""

    name = "JAX"

    def __init__(self, problem: Problem) -> None:
        self.problem, self.iterations = problem, 0.0
        n, springs = len(problem.mass), len(problem.rest)
        a, b = problem.ends.T
        self.ends, self.free = (a, b), jnp.asarray(problem.free, float)
        self.at = incident(np.r_[a, b], n)  # ends of springs; entry e is spring e mod S
        self.other = np.r_[b, a, 0][self.at]
        self.spring = np.r_[np.arange(springs), np.arange(springs), springs][self.at]
        self.at_corner = incident(problem.corners.reshape(-1), n)
        self.run = jax.jit(self.simulate, static_argnums=(1,))
        self.slope = jax.jit(jax.value_and_grad(self.cost))

    def per_vertex(self, per_spring):
        """Gather (c, S) to (c, n, most): the springs at each vertex, zero where there is none."""
        return jnp.pad(per_spring, ((0, 0), (0, 1)))[:, self.spring]

    def system(self, x, v, k):
        """Blocks of the springs, gathered (6, n, most), the diagonal (6, n) without them, and b (3, n)."""
        p, h = self.problem, self.problem.h
        a, b = self.ends
        e = x[:, a] - x[:, b]
        length = jnp.sqrt((e * e).sum(axis=0))
        d, rho = e / length, p.rest / length
        unit = jnp.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0])[:, None]
        blocks = symmetric(h * k * (h * rho + 0.5 * p.damping), d) + h * h * k * (1.0 - rho) * unit
        pull = h * k * (length - p.rest) * d
        signed = jnp.concatenate([pull, -pull, jnp.zeros((3, 1))], axis=1)
        diagonal = (1.0 + h * p.damping) * p.mass * unit
        right = p.mass * (v + h * p.gravity[:, None]) - signed[:, self.at].sum(axis=2)
        if len(p.corners):
            i, j, m = p.corners.T
            normal = jnp.cross(x[:, j] - x[:, i], x[:, m] - x[:, i], axis=0)
            kappa = h * p.drag / 6.0 * jnp.sqrt((normal * normal).sum(axis=0))
            mean = (v[:, i] + v[:, j] + v[:, m]) / 3.0
            push = kappa * (normal * (p.wind[:, None] - mean)).sum(axis=0) * normal
            both = jnp.concatenate([symmetric(kappa, normal), push])
            both = jnp.pad(jnp.repeat(both, 3, axis=1), ((0, 0), (0, 1)))[:, self.at_corner].sum(axis=2)
            diagonal += both[:6]
            right += both[6:] + apply(both[:6], v)
        return self.per_vertex(blocks), diagonal, self.free * right

    def step(self, k, tolerance, state, _):
        """One step."""
        x, v = state
        blocks, rest, b = self.system(x, v, k)
        diagonal = rest + blocks.sum(axis=2)
        inverses = self.free * inverse(diagonal)

        def matvec(w):
            return self.free * (apply(diagonal, w) - apply(blocks, w[:, self.other]).sum(axis=2))

        def solve(matvec, b, first=None):
            first = jnp.zeros_like(b) if first is None else first
            return conjugate_gradients(matvec, b, first, lax.stop_gradient(inverses), tolerance)

        w, count = lax.custom_linear_solve(
            matvec, b, partial(solve, first=lax.stop_gradient(v)), solve, symmetric=True, has_aux=True
        )
        w = self.free * w  # so that in reverse the right-hand side, too, is zero at fixed vertices
        after = x + self.problem.h * w
        return (after, w), (after, count)

    def simulate(self, k, n, tolerance):
        """Positions (n + 1, 3, vertices) and iterations (n,)."""
        start = jnp.asarray(self.problem.x0.T), jnp.asarray(self.problem.v0.T)
        _, (x, count) = lax.scan(partial(self.step, k, tolerance), start, length=n)
        return jnp.concatenate([start[0][None], x]), count

    def cost(self, k, target, tolerance):
        """G."""
        gap = self.simulate(k, len(target) - 1, tolerance)[0] - jnp.swapaxes(target, 1, 2)
        return (gap * gap).sum()

    def steps(self, n, tolerance):
        """The motion of n steps."""
        x, count = self.run(self.problem.stiffness, n, tolerance)
        self.iterations = float(count.mean())
        return np.swapaxes(np.asarray(x), 1, 2)

    def cost_and_gradient(self, k, target, tolerance):
        """G and ∂G/∂k."""
        cost, gradient = self.slope(k, target, tolerance)
        return float(cost), np.asarray(gradient)
