"""The steps of the plain numba program: assembly, conjugate gradients, and one loop over all steps."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit


@njit(cache=True)
def assemble(p, k, slots, x, v, diagonal, blocks, b):
    """A = M − h D − h² K and b = (M − h D) v + h f, in which the damping of vertices and springs drops out."""
    h = p.h
    diagonal.fill(0.0)
    blocks.fill(0.0)
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
def copy(a, out):
    """out = a."""
    for i in range(len(out)):
        for c in range(3):
            out[i, c] = a[i, c]


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
    copy(z, d)
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
    copy(p.x0, xs[0])
    copy(p.v0, vs[0])
    iterations = 0
    for t in range(steps):
        x, v, w = xs[t], vs[t], vs[t + 1]
        assemble(p, k, slots, x, v, diagonal, blocks, b)
        invert(diagonal, inverse)
        copy(v, w)
        iterations += conjugate_gradients(
            p.free, row, column, diagonal, blocks, inverse, b, tolerance, r, z, d, q, w
        )
        for i in range(n):
            for c in range(3):
                xs[t + 1, i, c] = x[i, c] + p.h * w[i, c]
    return xs, vs, iterations
