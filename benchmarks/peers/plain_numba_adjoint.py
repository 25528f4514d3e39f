"""The derivative of the plain numba program: back through the steps, with the matrix assembled again at each."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from peers.plain_numba_step import assemble, conjugate_gradients, face, invert


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
        g.fill(0.0)  # ∂φ/∂n
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
