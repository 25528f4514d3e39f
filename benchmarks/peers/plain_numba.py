"""Plain numba: block-Jacobi conjugate gradients from the last velocity, on a matrix stored in full.

As a user would write it who knows the method and numba, and stops there: loops over vertices, springs and faces, 3 × 3
blocks as (…, 3, 3) arrays, one compiled loop over all steps, no trick of a lower level. The adjoint's systems have the
step's matrix, assembled again, and start from the last λ. No `fastmath`: with it the program is a tenth slower.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from peers.problem import Problem, block_pattern


@njit(cache=True)
def assemble(p, k, slots, x, v, diagonal, blocks, b):
    """A = M − h D − h² K and b = (M − h D) v + h f, in which the damping of vertices and springs drops out."""
    h = p.h
    diagonal[:] = 0.0
    blocks[:] = 0.0
    for i in range(len(p.mass)):
        for c in range(3):
            diagonal[i, c, c] = p.mass[i] * (1.0 + h * p.damping)
            b[i, c] = p.mass[i] * (v[i, c] + h * p.gravity[c])
    for s in range(len(k)):
        i, j = p.ends[s, 0], p.ends[s, 1]
        ij, ji = slots[s, 0], slots[s, 1]
        e0, e1, e2 = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
        length = sqrt(e0 * e0 + e1 * e1 + e2 * e2)
        d = (e0 / length, e1 / length, e2 / length)
        rho = p.rest[s] / length
        across = h * h * k[s] * (1.0 - rho)
        along = h * k[s] * (h * rho + 0.5 * p.damping)
        pull = h * k[s] * (length - p.rest[s])
        for r in range(3):
            for c in range(3):
                value = along * d[r] * d[c]
                if r == c:
                    value += across
                diagonal[i, r, c] += value
                diagonal[j, r, c] += value
                blocks[ij, r, c] -= value
                blocks[ji, r, c] -= value
            b[i, r] -= pull * d[r]
            b[j, r] += pull * d[r]
    for t in range(len(p.corners)):
        n, kappa, inflow = face(p, x, v, t)
        for corner in range(3):
            j = p.corners[t, corner]
            push = h * kappa * (inflow + n[0] * v[j, 0] + n[1] * v[j, 1] + n[2] * v[j, 2])
            for r in range(3):
                b[j, r] += push * n[r]
                for c in range(3):
                    diagonal[j, r, c] += h * kappa * n[r] * n[c]


@njit(cache=True)
def face(p, x, v, t):
    """Normal n, κ = drag |n| / 6 and n·(wind − v̄) of face t."""
    i, j, k = p.corners[t, 0], p.corners[t, 1], p.corners[t, 2]
    p0, p1, p2 = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
    q0, q1, q2 = x[k, 0] - x[i, 0], x[k, 1] - x[i, 1], x[k, 2] - x[i, 2]
    n = (p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0)
    inflow = 0.0
    for c in range(3):
        inflow += n[c] * (p.wind[c] - (v[i, c] + v[j, c] + v[k, c]) / 3.0)
    return n, p.drag / 6.0 * sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), inflow


@njit(cache=True)
def invert(diagonal, inverse):
    """Inverses of the diagonal blocks, by cofactors."""
    for i in range(len(diagonal)):
        a = diagonal[i]
        c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
        c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
        c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
        det = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
        inverse[i, 0, 0] = c00 / det
        inverse[i, 0, 1] = inverse[i, 1, 0] = c01 / det
        inverse[i, 0, 2] = inverse[i, 2, 0] = c02 / det
        inverse[i, 1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) / det
        inverse[i, 1, 2] = inverse[i, 2, 1] = (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]) / det
        inverse[i, 2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) / det


@njit(cache=True)
def multiply(free, row, column, diagonal, blocks, x, out):
    """out = A x in the free rows, 0 in the others."""
    for i in range(len(free)):
        s0, s1, s2 = 0.0, 0.0, 0.0
        if free[i]:
            d, x0, x1, x2 = diagonal[i], x[i, 0], x[i, 1], x[i, 2]
            s0 = d[0, 0] * x0 + d[0, 1] * x1 + d[0, 2] * x2
            s1 = d[1, 0] * x0 + d[1, 1] * x1 + d[1, 2] * x2
            s2 = d[2, 0] * x0 + d[2, 1] * x1 + d[2, 2] * x2
            for e in range(row[i], row[i + 1]):
                a, j = blocks[e], column[e]
                x0, x1, x2 = x[j, 0], x[j, 1], x[j, 2]
                s0 += a[0, 0] * x0 + a[0, 1] * x1 + a[0, 2] * x2
                s1 += a[1, 0] * x0 + a[1, 1] * x1 + a[1, 2] * x2
                s2 += a[2, 0] * x0 + a[2, 1] * x1 + a[2, 2] * x2
        out[i, 0], out[i, 1], out[i, 2] = s0, s1, s2


@njit(cache=True)
def precondition(inverse, r, z):
    """z = (diagonal blocks)⁻¹ r; returns r·z."""
    total = 0.0
    for i in range(len(r)):
        for c in range(3):
            z[i, c] = inverse[i, c, 0] * r[i, 0] + inverse[i, c, 1] * r[i, 1] + inverse[i, c, 2] * r[i, 2]
            total += r[i, c] * z[i, c]
    return total


@njit(cache=True)
def conjugate_gradients(free, row, column, diagonal, blocks, inverse, b, tolerance, r, z, d, q, x):
    """Solve A x = b from the guess in x; returns the iterations."""
    multiply(free, row, column, diagonal, blocks, x, q)
    bb, rr = 0.0, 0.0
    for i in range(len(b)):
        for c in range(3):
            r[i, c] = b[i, c] - q[i, c] if free[i] else 0.0
            bb += b[i, c] * b[i, c] if free[i] else 0.0
            rr += r[i, c] * r[i, c]
    rz = precondition(inverse, r, z)
    d[:] = z
    for iteration in range(100_000):
        if rr <= tolerance * tolerance * bb:
            return iteration
        multiply(free, row, column, diagonal, blocks, d, q)
        dq = 0.0
        for i in range(len(b)):
            for c in range(3):
                dq += d[i, c] * q[i, c]
        alpha = rz / dq
        rr = 0.0
        for i in range(len(b)):
            for c in range(3):
                x[i, c] += alpha * d[i, c]
                r[i, c] -= alpha * q[i, c]
                rr += r[i, c] * r[i, c]
        before = rz
        rz = precondition(inverse, r, z)
        beta = rz / before
        for i in range(len(b)):
            for c in range(3):
                d[i, c] = z[i, c] + beta * d[i, c]
    return 100_000


@njit(cache=True)
def simulate(p, k, row, column, slots, steps, tolerance):
    """Positions and velocities (steps + 1, n, 3), and the iterations of all steps together."""
    n = len(p.mass)
    xs, vs = np.empty((steps + 1, n, 3)), np.empty((steps + 1, n, 3))
    diagonal, inverse, blocks = np.empty((n, 3, 3)), np.empty((n, 3, 3)), np.empty((len(column), 3, 3))
    b, r, z, d, q = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    xs[0], vs[0] = p.x0, p.v0
    iterations = 0
    for t in range(steps):
        x, v, w = xs[t], vs[t], vs[t + 1]
        assemble(p, k, slots, x, v, diagonal, blocks, b)
        invert(diagonal, inverse)
        w[:] = v
        iterations += conjugate_gradients(
            p.free, row, column, diagonal, blocks, inverse, b, tolerance, r, z, d, q, w
        )
        for i in range(n):
            for c in range(3):
                xs[t + 1, i, c] = x[i, c] + p.h * w[i, c]
    return xs, vs, iterations


@njit(cache=True)
def sweep_back(p, k, row, column, slots, xs, vs, target, tolerance):
    """Cost and gradient by the stiffnesses, along a motion: A λ = v̄ + h x̄, then the derivative of −λᵀ(A w − b)."""
    n, h = len(p.mass), p.h
    diagonal, inverse, blocks = np.empty((n, 3, 3)), np.empty((n, 3, 3)), np.empty((len(column), 3, 3))
    b, r, z, d, q = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    lam, x_bar, v_bar, gradient = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(len(k))
    cost = 0.0
    for t in range(len(target) - 1, -1, -1):
        for i in range(n):
            for c in range(3):
                gap = xs[t, i, c] - target[t, i, c]
                cost += gap * gap
                x_bar[i, c] += 2.0 * gap
        if t == 0:
            break
        x, v, w = xs[t - 1], vs[t - 1], vs[t]
        assemble(p, k, slots, x, v, diagonal, blocks, b)
        invert(diagonal, inverse)
        for i in range(n):
            for c in range(3):
                b[i, c] = v_bar[i, c] + h * x_bar[i, c] if p.free[i] else 0.0
        conjugate_gradients(p.free, row, column, diagonal, blocks, inverse, b, tolerance, r, z, d, q, lam)
        for i in range(n):
            for c in range(3):
                v_bar[i, c] = p.mass[i] * lam[i, c]
        springs_back(p, k, x, w, lam, x_bar, gradient)
        faces_back(p, x, v, w, lam, x_bar, v_bar)
    return cost, gradient


@njit(cache=True)
def springs_back(p, k, x, w, lam, x_bar, gradient):
    """Of spring s, λᵀ(A w − b) = h k ψ(e), ψ = (1 − ρ) λ·(e + h w) + (h ρ + α/2) (λ·d)(w·d), of differences i − j."""
    h = p.h
    for s in range(len(k)):
        i, j = p.ends[s, 0], p.ends[s, 1]
        e0, e1, e2 = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
        w0, w1, w2 = w[i, 0] - w[j, 0], w[i, 1] - w[j, 1], w[i, 2] - w[j, 2]
        l0, l1, l2 = lam[i, 0] - lam[j, 0], lam[i, 1] - lam[j, 1], lam[i, 2] - lam[j, 2]
        length = sqrt(e0 * e0 + e1 * e1 + e2 * e2)
        d0, d1, d2 = e0 / length, e1 / length, e2 / length
        rho = p.rest[s] / length
        sigma = h * rho + 0.5 * p.damping
        ld, wd = l0 * d0 + l1 * d1 + l2 * d2, w0 * d0 + w1 * d1 + w2 * d2
        lev = l0 * (e0 + h * w0) + l1 * (e1 + h * w1) + l2 * (e2 + h * w2)
        gradient[s] -= h * ((1.0 - rho) * lev + sigma * ld * wd)
        cl = (1.0 - rho) + sigma * wd / length
        cw = sigma * ld / length
        cd = (rho * lev - (h * rho + 2.0 * sigma) * ld * wd) / length
        g0 = -h * k[s] * (cl * l0 + cw * w0 + cd * d0)
        g1 = -h * k[s] * (cl * l1 + cw * w1 + cd * d1)
        g2 = -h * k[s] * (cl * l2 + cw * w2 + cd * d2)
        x_bar[i, 0] += g0
        x_bar[i, 1] += g1
        x_bar[i, 2] += g2
        x_bar[j, 0] -= g0
        x_bar[j, 1] -= g1
        x_bar[j, 2] -= g2


@njit(cache=True)
def faces_back(p, x, v, w, lam, x_bar, v_bar):
    """Of face t, λᵀ(A w − b) = φ = h κ [Σ_j (λ_j·n)(n·(w_j − v_j)) − (Λ·n)(n·(wind − v̄))], Λ = Σ_j λ_j."""
    g = np.empty(3)
    for t in range(len(p.corners)):
        n, kappa, inflow = face(p, x, v, t)
        size = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
        if size == 0.0:
            continue
        i, j, k = p.corners[t, 0], p.corners[t, 1], p.corners[t, 2]
        total, value = 0.0, 0.0  # Λ·n, φ/(h κ)
        g[:] = 0.0  # ∂φ/∂n
        for corner in range(3):
            m = p.corners[t, corner]
            nu, theta = 0.0, 0.0
            for c in range(3):
                nu += lam[m, c] * n[c]
                theta += (w[m, c] - v[m, c]) * n[c]
            total += nu
            value += nu * theta
            for c in range(3):
                g[c] += lam[m, c] * (theta - inflow) + (w[m, c] - v[m, c]) * nu
                v_bar[m, c] += p.h * kappa * nu * n[c]
        value -= total * inflow
        for c in range(3):
            g[c] -= (p.wind[c] - (v[i, c] + v[j, c] + v[k, c]) / 3.0) * total
            g[c] = -p.h * kappa * (g[c] + value * n[c] / size)
            for corner in range(3):
                v_bar[p.corners[t, corner], c] -= p.h * kappa * total * n[c] / 3.0
        for c in range(3):  # n = p × q: ∂/∂p = q × g, ∂/∂q = g × p
            c1, c2 = (c + 1) % 3, (c + 2) % 3
            by_p = (x[k, c1] - x[i, c1]) * g[c2] - (x[k, c2] - x[i, c2]) * g[c1]
            by_q = g[c1] * (x[j, c2] - x[i, c2]) - g[c2] * (x[j, c1] - x[i, c1])
            x_bar[j, c] += by_p
            x_bar[k, c] += by_q
            x_bar[i, c] -= by_p + by_q


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
