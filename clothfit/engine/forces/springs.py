"""Springs with damping along their axis.

A spring joins a and b: e = y_a − y_b, L = |e|, d = e/L, rest length L₀, stiffness k, damping β k with β = α/2
(α the object's damping coefficient, read in s here, in 1/s at the vertices).

    f_a = −k (L − L₀) d − β k (d·(u_a − u_b)) d = −f_b
    K_aa = −k [(1 − ρ) I + ρ d dᵀ],  D_aa = −β k d dᵀ,  ρ = L₀/L    (the damping's position derivative is left out)

The damping is linear in the velocity and D is its exact derivative, so the velocity before the step drops out of
the step's model: with s and w the differences s_a − s_b and w_a − w_b,

    F_a(w) = −k [(1 − ρ)(e + s) + ρ d (d·s) + β d (d·w)].

A compressed spring, ρ > 1, pushes sideways: −K is not positive semi-definite. Where the step's matrix must be positive
definite, K takes ρ̂ = min(ρ, 1) for ρ; then F_a = −k [(1 − ρ) e + (1 − ρ̂) s + ρ̂ d (d·s) + β d (d·w)], the same force
with a stiffer model of how it changes, as in J. Teran et al., Robust quasistatic finite elements and flesh
simulation, SCA 2005, there per element as well.

The force on b is the opposite and every block is symmetric, so one pass over the springs serves both ends.
Reference: D. Baraff, A. Witkin, Large steps in cloth simulation, SIGGRAPH 1998.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.engine.solve.sparse import add_block, subtract_block
from clothfit.kernels.fours import (
    add_some,
    add_to_objects,
    along,
    blocks,
    dots,
    four_of,
    halves,
    of_four,
    of_objects,
    scaled,
    some,
)
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import (
    add,
    div,
    fma,
    index,
    index2,
    load3,
    mul,
    prefetch,
    root,
    splat,
    store3,
    sub,
    sum4,
    where_less,
)
from clothfit.kernels.vectors import dot, item

FEW, AHEAD = 10_000, 64
"""Springs whose blocks stay in the caches; those of more are fetched so many springs ahead of their turn."""


class Springs(NamedTuple):
    """Constants of the springs of one cloth."""

    ends: Indices  # (S, 2), the vertices a and b
    rest: Array  # L₀, (S,), m
    stiffness: Array  # k, (S,), N/m
    damping: Array  # β = α/2 of each object, (K,), s
    slot: Indices  # (S,), place of the block (a, b) in the matrix
    cap: float = np.inf  # most that ρ counts as in K: 1 makes −K positive semi-definite
    object: Indices | None = None  # (S,), the object of each spring; None: there is one
    bend: float = 0.0  # how far below the cap ρ̂ leaves ρ, so that its derivative does not jump


def build(
    ends: Indices, rest: Array, stiffness: Array, damping: Array, slot: Indices, owner: Indices | None = None
) -> Springs:
    """Springs with rest lengths (S,) m and stiffnesses (S,) N/m, the damping coefficients α (K,) of their objects, and
    whose they are (S,) where there are several.
    """
    return Springs(ends, np.array(rest, float), np.array(stiffness, float), 0.5 * damping, slot, object=owner)


@kernel
def difference(x, springs, i):
    """x_a − x_b for spring i."""
    return sub(load3(x, index2(springs.ends, i, 0)), load3(x, index2(springs.ends, i, 1)))


@kernel
def add_opposite(out, springs, i, p):
    """out_a += p, out_b −= p for spring i."""
    a, b = index2(springs.ends, i, 0), index2(springs.ends, i, 1)
    store3(add(load3(out, a), p), out, a)
    store3(sub(load3(out, b), p), out, b)


@kernel
def axis(springs, y, i):
    """Length, its inverse and unit vector of spring i; one of zero length has no direction and exerts nothing: there
    the vector is 0, and the inverse that of the rest length.
    """
    e = difference(y, springs, i)
    length = sqrt(dot(e, e))
    if length == 0.0:
        return 0.0, 1.0 / springs.rest[i], e
    inverse = 1.0 / length
    return length, inverse, mul(e, splat(inverse))


@kernel
def capped(springs, rho):
    """ρ̂ = min(ρ, cap), and ρ̃ for ∂ρ̂/∂e = −ρ̃ d/L and ∂ρ̂/∂L₀ = ρ̃/L₀: ρ, or 0 where the cap holds it.

    Within `bend` below the cap, a cubic leads from the one to the other with its derivative.
    """
    left = springs.cap - rho
    if left < 0.0:
        return springs.cap, 0.0
    if left < springs.bend:
        t = 1.0 / springs.bend * left
        return springs.cap - left * t * (2.0 - t), rho * t * (4.0 - 3.0 * t)
    return rho, rho


@kernel
def energy(springs, y):
    end, twice = len(springs.rest), splat(0.0)  # k (L − L₀)², also where L = 0, as its limit
    for i in range(0, end, 4):
        e = differences(y, springs, i, end)
        stretch = sub(root(dots(e, e)), some(springs.rest, i, end, 1.0))
        twice = fma(mul(some(springs.stiffness, i, end, 0.0), stretch), stretch, twice)
    return 0.5 * sum4(twice)


@kernel
def damping_power(springs, y, u, w):
    total = 0.0
    for i in range(len(springs.rest)):
        _, _, d = axis(springs, y, i)
        along = dot(d, difference(u, springs, i)) * dot(d, difference(w, springs, i))
        total -= springs.damping[item(springs.object, i)] * springs.stiffness[i] * along
    return total


@kernel(apart=None)
def add_force(springs, y, u, f):
    for i in range(len(springs.rest)):
        length, _, d = axis(springs, y, i)
        stretch = length - springs.rest[i]
        beta = springs.damping[item(springs.object, i)]
        pull = -springs.stiffness[i] * (stretch + beta * dot(d, difference(u, springs, i)))
        add_opposite(f, springs, i, mul(splat(pull), d))


@kernel
def add_damping(springs, y, u, scale, q, out):
    for i in range(len(springs.rest)):
        _, _, d = axis(springs, y, i)
        beta = springs.damping[item(springs.object, i)]
        pull = -scale * beta * springs.stiffness[i] * dot(d, difference(q, springs, i))
        add_opposite(out, springs, i, mul(splat(pull), d))


@kernel(apart=0.0)
def add_step(springs, y, u, h, ahead, A, b):
    end, linear = len(springs.rest), len(b) > 0
    one, step, twice = splat(1.0), splat(h), splat(0.0)
    for i in range(0, end, 4):
        for e in range(i + AHEAD, min(i + AHEAD + 4, end) if end > FEW else 0):
            prefetch(A.upper, index(springs.slot, e))
        e = differences(y, springs, i, end)
        length, inverse = lengths(springs, i, end, dots(e, e))
        d, rest, k = scaled(inverse, e), some(springs.rest, i, end, 1.0), some(springs.stiffness, i, end, 0.0)
        hat, _ = capped_lanes(springs, mul(rest, inverse))
        stretch, hk, wide = sub(length, rest), mul(step, k), mul(step, hat)
        across = mul(mul(step, hk), sub(one, hat))
        axial = mul(hk, add(wide, of_objects(springs.damping, springs.object, i, end)))
        p, q, r, s = halves(blocks(scaled(axial, d), d, across))
        add_blocks(springs, i, A, p)
        if i + 1 < end:
            add_blocks(springs, i + 1, A, q)
        if i + 2 < end:
            add_blocks(springs, i + 2, A, r)
        if i + 3 < end:
            add_blocks(springs, i + 3, A, s)
        twice = fma(mul(k, stretch), stretch, twice)
        if linear:
            pull = mul(splat(-h), mul(k, stretch))
            if ahead:
                moved = differences(u, springs, i, end)
                pull = fma(mul(hk, wide), dots(moved, d), pull)
                add_opposites(b, springs, i, end, along(across, moved, scaled(pull, d)))
            else:
                add_opposites(b, springs, i, end, scaled(pull, d))
    return 0.5 * sum4(twice)


@kernel
def add_blocks(springs, i, A, own):
    """Add the block of spring i, given in two halves, to the diagonal and subtract it from what is beside that."""
    low, high = own
    add_block(A.diagonal, index2(springs.ends, i, 0), low, high)
    add_block(A.diagonal, index2(springs.ends, i, 1), low, high)
    subtract_block(A.upper, index(springs.slot, i), low, high)


@kernel
def differences(x, springs, i, end):
    """x_a − x_b for up to four springs from i, before `end`."""
    p, q = difference(x, springs, i), difference(x, springs, min(i + 1, end - 1))
    return of_four(p, q, difference(x, springs, min(i + 2, end - 1)), difference(x, springs, min(i + 3, end - 1)))


@kernel
def add_opposites(out, springs, i, end, v):
    """`add_opposite` for up to four springs from i, before `end`."""
    p, q, r, s = four_of(v, splat(0.0))
    add_opposite(out, springs, i, p)
    if i + 1 < end:
        add_opposite(out, springs, i + 1, q)
    if i + 2 < end:
        add_opposite(out, springs, i + 2, r)
    if i + 3 < end:
        add_opposite(out, springs, i + 3, s)


@kernel
def lengths(springs, i, end, square):
    """L and 1/L of up to four springs from i, of L²; as `axis` does where they are 0."""
    length = root(square)
    return length, div(splat(1.0), where_less(splat(0.0), length, length, some(springs.rest, i, end, 1.0)))


@kernel
def capped_lanes(springs, rho):
    """`capped`, of four springs."""
    zero, cap = splat(0.0), splat(springs.cap)
    hat = bent = rho
    if springs.bend > 0.0:
        two, three, four, bend = splat(2.0), splat(3.0), splat(4.0), splat(springs.bend)
        left = sub(cap, rho)
        t = mul(splat(1.0 / springs.bend), left)
        hat = where_less(left, bend, sub(cap, mul(mul(left, t), sub(two, t))), rho)
        bent = where_less(left, bend, mul(mul(rho, t), sub(four, mul(three, t))), rho)
    return where_less(cap, rho, cap, hat), where_less(cap, rho, zero, bent)


@kernel
def pull_of(springs, y, i, h, w):
    """(h² K + h D) w at y on one end of spring i, for a velocity w of its other end."""
    _, inverse, d = axis(springs, y, i)
    hat, _ = capped(springs, springs.rest[i] * inverse)
    k = springs.stiffness[i]
    along = h * k * (h * hat + springs.damping[item(springs.object, i)]) * dot(d, w)
    return fma(splat(h * h * k * (1.0 - hat)), w, mul(splat(along), d))


@kernel(apart=None)
def add_pullback(springs, y, u, w, s, lam, h, grad, gy, gu):
    # φ = −h k ψ(e),  ψ = (L − L₀) λ·d + (1 − ρ̂) λ·s + ρ̂ (λ·d)(d·s) + β (λ·d)(d·w),  with λ = λ_a − λ_b held fixed.
    # ∂ρ̂/∂e = −ρ̃ d/L and ∂(p·d)/∂e = (p − (p·d) d)/L for any fixed vector p, so ∂φ/∂e = cl λ + cs s + cw w + ce e.
    end, zero, one, step = len(springs.rest), splat(0.0), splat(1.0), splat(h)
    for i in range(0, end, 4):
        e, s_i = differences(y, springs, i, end), differences(s, springs, i, end)
        w_i, l_i = differences(w, springs, i, end), differences(lam, springs, i, end)
        length, inverse = lengths(springs, i, end, dots(e, e))
        ld, sd, wd = mul(dots(l_i, e), inverse), mul(dots(s_i, e), inverse), mul(dots(w_i, e), inverse)
        ls, beta = dots(l_i, s_i), of_objects(springs.damping, springs.object, i, end)
        rest, hk = some(springs.rest, i, end, 1.0), mul(step, some(springs.stiffness, i, end, 0.0))
        rho = mul(rest, inverse)
        hat, bent = capped_lanes(springs, rho)
        slack, pull, back = sub(one, rho), mul(length, ld), sub(zero, hk)
        turn = fma(beta, wd, mul(hat, sd))
        by_k = mul(step, fma(mul(slack, length), ld, fma(sub(one, hat), ls, mul(ld, turn))))
        add_some(grad.stiffness, i, end, sub(zero, by_k))
        if len(grad.damping) > 0:  # β = α/2
            add_to_objects(grad.damping, springs.object, i, end, mul(mul(splat(0.5), back), mul(ld, wd)))
        if len(grad.rest) > 0:  # without length nothing acts, whatever the rest length
            by_rest = mul(hk, add(ld, div(mul(sub(ls, mul(ld, sd)), bent), rest)))
            add_some(grad.rest, i, end, where_less(zero, length, by_rest, zero))
        by_length = mul(back, inverse)
        along_d = sub(fma(rho, pull, mul(bent, ls)), mul(ld, fma(bent, sd, add(turn, turn))))
        g = scaled(mul(by_length, mul(inverse, along_d)), e)  # 1/L² of tiny scenes overflows
        g = along(mul(by_length, mul(beta, ld)), w_i, g)
        g = along(mul(by_length, mul(hat, ld)), s_i, g)
        add_opposites(gy, springs, i, end, along(fma(by_length, turn, mul(back, slack)), l_i, g))


@kernel(apart=None)
def add_pushforward(springs, y, u, w, s, dy, du, direction, h, out):
    # With t = (d·de)/L and n = de/L − t d = dd:  dρ = −ρ t, dρ̂ = −ρ̃ t, and each product rule in turn.
    for i in range(len(springs.rest)):
        own = item(springs.object, i)
        beta = springs.damping[own]
        length, inverse, d = axis(springs, y, i)
        s_i, w_i, e_i = difference(s, springs, i), difference(w, springs, i), difference(dy, springs, i)
        rho = springs.rest[i] * inverse
        hat, bent = capped(springs, rho)
        sd, wd = dot(s_i, d), dot(w_i, d)
        t = dot(e_i, d) * inverse
        n = fma(splat(-t), d, mul(splat(inverse), e_i))
        sn, wn = dot(s_i, n), dot(w_i, n)
        # F/(−k) = (1 − ρ) e + (1 − ρ̂) s + turn d, its change with y, and on top the change of k
        turn = hat * sd + beta * wd
        swing = rho * t * length + hat * sn - bent * t * sd + beta * wn
        hk = -h * springs.stiffness[i]
        cd = hk * swing - h * direction.stiffness[i] * ((1.0 - rho) * length + turn)
        cs = hk * bent * t - h * direction.stiffness[i] * (1.0 - hat)
        ce = hk * (1.0 - rho)
        cn = hk * turn
        if len(direction.damping) > 0:
            cd += 0.5 * hk * direction.damping[own] * wd
        if len(direction.rest) > 0 and dot(d, d) > 0.0:  # else it exerts nothing, whatever its rest length
            change = bent / springs.rest[i]  # ∂ρ̂/∂L₀
            cd += hk * direction.rest[i] * (sd * change - 1.0)
            cs -= hk * direction.rest[i] * change
        p = fma(splat(cd), d, fma(splat(cs), s_i, fma(splat(ce), e_i, mul(splat(cn), n))))
        add_opposite(out, springs, i, p)
