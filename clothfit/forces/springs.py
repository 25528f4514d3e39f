"""Springs with damping along their axis.

A spring joins a and b: e = y_a − y_b, L = |e|, d = e/L, rest length L₀, stiffness k, damping β k with β = α/2
(α the object's damping coefficient, read in s here, in 1/s at the vertices).

    f_a = −k (L − L₀) d − β k (d·(u_a − u_b)) d = −f_b
    K_aa = −k [(1 − ρ) I + ρ d dᵀ],  D_aa = −β k d dᵀ,  ρ = L₀/L    (the damping's position derivative is left out)

The damping is linear in the velocity and D is its exact derivative, so the velocity before the step drops out of
the step's model: with s and w the differences s_a − s_b and w_a − w_b,

    F_a(w) = −k [(1 − ρ)(e + s) + ρ d (d·s) + β d (d·w)].

The force on b is the opposite and every block is symmetric, so one pass over the springs serves both ends.
Reference: D. Baraff, A. Witkin, Large steps in cloth simulation, SIGGRAPH 1998.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from clothfit.arrays import Array, Indices
from clothfit.kernel import kernel


class Springs(NamedTuple):
    """Constants of the springs of one cloth."""

    ends: Indices  # (S, 2), the vertices a and b
    rest: Array  # L₀, (S,), m
    stiffness: Array  # k, (S,), N/m
    damping: float  # β = α/2, s
    slot: Indices  # (S,), place of the block (a, b) in the matrix


def build(ends: Indices, rest: Array, stiffness: Array, damping: float, slot: Indices) -> Springs:
    """Springs with rest lengths (S,) m and stiffnesses (S,) N/m, with the object's damping coefficient α."""
    return Springs(ends, np.array(rest, float), np.array(stiffness, float), 0.5 * float(damping), slot)


@kernel
def difference(x, a, b):
    """x_a − x_b as three numbers."""
    return x[a, 0] - x[b, 0], x[a, 1] - x[b, 1], x[a, 2] - x[b, 2]


@kernel
def add_opposite(out, a, b, p0, p1, p2):
    """out_a += p, out_b −= p."""
    out[a, 0] += p0
    out[a, 1] += p1
    out[a, 2] += p2
    out[b, 0] -= p0
    out[b, 1] -= p1
    out[b, 2] -= p2


@kernel
def axis(springs, y, i):
    """Length and unit vector of spring i; a spring of zero length has no direction and exerts nothing."""
    e0, e1, e2 = difference(y, springs.ends[i, 0], springs.ends[i, 1])
    length = sqrt(e0 * e0 + e1 * e1 + e2 * e2)
    if length == 0.0:
        return springs.rest[i], 0.0, 0.0, 0.0
    return length, e0 / length, e1 / length, e2 / length


@kernel
def pointlike(d0, d1, d2):
    """Whether a spring's axis is that of one of zero length, which exerts nothing whatever its rest length."""
    return d0 == 0.0 and d1 == 0.0 and d2 == 0.0


@kernel
def add_force(springs, y, u, f):
    for i in range(len(springs.rest)):
        a, b = springs.ends[i, 0], springs.ends[i, 1]
        length, d0, d1, d2 = axis(springs, y, i)
        u0, u1, u2 = difference(u, a, b)
        stretch = length - springs.rest[i]
        pull = -springs.stiffness[i] * (stretch + springs.damping * (d0 * u0 + d1 * u1 + d2 * u2))
        add_opposite(f, a, b, pull * d0, pull * d1, pull * d2)


@kernel
def add_damping(springs, y, scale, q, out):
    for i in range(len(springs.rest)):
        a, b = springs.ends[i, 0], springs.ends[i, 1]
        _, d0, d1, d2 = axis(springs, y, i)
        p0, p1, p2 = difference(q, a, b)
        pull = -scale * springs.damping * springs.stiffness[i] * (d0 * p0 + d1 * p1 + d2 * p2)
        add_opposite(out, a, b, pull * d0, pull * d1, pull * d2)


@kernel
def add_step(springs, y, u, h, A, b):
    diagonal, upper = A.diagonal, A.upper
    for i in range(len(springs.rest)):
        p, q = springs.ends[i, 0], springs.ends[i, 1]
        length, d0, d1, d2 = axis(springs, y, i)
        k = springs.stiffness[i]
        rho = springs.rest[i] / length
        across = h * h * k * (1.0 - rho)
        along = h * k * (h * rho + springs.damping)
        a0, a1, a2 = along * d0, along * d1, along * d2
        xx, xy, xz = across + a0 * d0, a0 * d1, a0 * d2
        yy, yz, zz = across + a1 * d1, a1 * d2, across + a2 * d2
        slot = springs.slot[i]
        upper[slot, 0] -= xx
        upper[slot, 1] -= xy
        upper[slot, 2] -= xz
        upper[slot, 3] -= yy
        upper[slot, 4] -= yz
        upper[slot, 5] -= zz
        for end in (p, q):
            diagonal[end, 0] += xx
            diagonal[end, 1] += xy
            diagonal[end, 2] += xz
            diagonal[end, 3] += yy
            diagonal[end, 4] += yz
            diagonal[end, 5] += zz
        pull = -h * k * (length - springs.rest[i])
        add_opposite(b, p, q, pull * d0, pull * d1, pull * d2)


@kernel
def add_pullback(springs, y, u, w, s, lam, h, grad, gy, gu):
    # φ = −h k ψ(e),  ψ = (1 − ρ)(L λ·d + λ·s) + ρ (λ·d)(d·s) + β (λ·d)(d·w),  with λ = λ_a − λ_b held fixed.
    # ∂ρ/∂e = −ρ d/L and ∂(p·d)/∂e = (p − (p·d) d)/L for any fixed vector p.
    for i in range(len(springs.rest)):
        a, b = springs.ends[i, 0], springs.ends[i, 1]
        length, d0, d1, d2 = axis(springs, y, i)
        s0, s1, s2 = difference(s, a, b)
        w0, w1, w2 = difference(w, a, b)
        l0, l1, l2 = difference(lam, a, b)
        rho = springs.rest[i] / length
        beta = springs.damping
        ld = l0 * d0 + l1 * d1 + l2 * d2
        sd = s0 * d0 + s1 * d1 + s2 * d2
        wd = w0 * d0 + w1 * d1 + w2 * d2
        ls = l0 * s0 + l1 * s1 + l2 * s2
        grad.stiffness[i] -= h * ((1.0 - rho) * (length * ld + ls) + ld * (rho * sd + beta * wd))
        if len(grad.damping) > 0:  # β = α/2
            grad.damping[0] -= 0.5 * h * springs.stiffness[i] * ld * wd
        if len(grad.rest) > 0 and not pointlike(d0, d1, d2):  # ∂ρ/∂L₀ = 1/L
            grad.rest[i] += h * springs.stiffness[i] * (ld + (ls - ld * sd) / length)
        # ∂ψ/∂e = cl λ + cs s + cw w + cd d
        cl = (1.0 - rho) + (rho * sd + beta * wd) / length
        cs = rho * ld / length
        cw = beta * ld / length
        cd = (rho * (ls + length * ld) - ld * (3.0 * rho * sd + 2.0 * beta * wd)) / length
        hk = -h * springs.stiffness[i]
        g0 = cl * l0 + cs * s0 + cw * w0 + cd * d0
        g1 = cl * l1 + cs * s1 + cw * w1 + cd * d1
        g2 = cl * l2 + cs * s2 + cw * w2 + cd * d2
        add_opposite(gy, a, b, hk * g0, hk * g1, hk * g2)


@kernel
def add_pushforward(springs, y, u, w, s, dy, du, direction, h, out):
    # With t = (d·de)/L and n = de/L − t d = dd:  dρ = −ρ t, and each product rule in turn.
    for i in range(len(springs.rest)):
        a, b = springs.ends[i, 0], springs.ends[i, 1]
        length, d0, d1, d2 = axis(springs, y, i)
        s0, s1, s2 = difference(s, a, b)
        w0, w1, w2 = difference(w, a, b)
        e0, e1, e2 = difference(dy, a, b)
        rho = springs.rest[i] / length
        beta = springs.damping
        sd = s0 * d0 + s1 * d1 + s2 * d2
        wd = w0 * d0 + w1 * d1 + w2 * d2
        t = (e0 * d0 + e1 * d1 + e2 * d2) / length
        n0, n1, n2 = e0 / length - t * d0, e1 / length - t * d1, e2 / length - t * d2
        sn = s0 * n0 + s1 * n1 + s2 * n2
        wn = w0 * n0 + w1 * n1 + w2 * n2
        # F/(−k) = (1 − ρ)(e + s) + turn d, its change with y, and on top the change of k
        turn = rho * sd + beta * wd
        swing = rho * (t * length + sn - t * sd) + beta * wn
        hk = -h * springs.stiffness[i]
        cd = hk * swing - h * direction.stiffness[i] * ((1.0 - rho) * length + turn)
        cs = hk * rho * t - h * direction.stiffness[i] * (1.0 - rho)
        ce = hk * (1.0 - rho)
        cn = hk * turn
        if len(direction.damping) > 0:
            cd += 0.5 * hk * direction.damping[0] * wd
        if len(direction.rest) > 0 and not pointlike(d0, d1, d2):
            cd += hk * direction.rest[i] * (sd / length - 1.0)
            cs -= hk * direction.rest[i] / length
        p0 = cd * d0 + cs * s0 + ce * e0 + cn * n0
        p1 = cd * d1 + cs * s1 + ce * e1 + cn * n1
        p2 = cd * d2 + cs * s2 + ce * e2 + cn * n2
        add_opposite(out, a, b, p0, p1, p2)
