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
from clothfit.engine.solve.sparse import add_block, outer, subtract_block
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import (
    add,
    div,
    fma,
    index,
    load,
    load3,
    load4,
    mul,
    pack,
    prefetch,
    root,
    splat,
    store,
    store3,
    store4,
    sub,
    sum4,
    where_less,
)
from clothfit.kernels.vectors import dot, item

TOGETHER = 64
"""Springs whose lengths are computed together: roots and divisions take as long as all else that a spring needs, but
four at a time, and not one after the other.
"""

FEW = 10_000
"""Springs whose blocks stay in the caches; those of more are fetched ahead of their turn."""

ROWS = 14
EE, LE, SE, WE, LS, REST, K, BENT, BY_K, CL, CS, CW, CE, BETA = range(ROWS)
"""What `add_pullback` computes of springs: e·e, λ·e, s·e, w·e, λ·s, L₀, k, ρ̃, −∂φ/∂k, the factors of ∂φ/∂e, and β."""


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
    return sub(load3(x, springs.ends[i, 0]), load3(x, springs.ends[i, 1]))


@kernel
def add_opposite(out, springs, i, p):
    """out_a += p, out_b −= p for spring i."""
    a, b = springs.ends[i, 0], springs.ends[i, 1]
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
    k, rest, twice = springs.stiffness, springs.rest, splat(0.0)  # k (L − L₀)², also where L = 0, as its limit
    whole = len(rest) - len(rest) % 4
    for i in range(0, whole, 4):
        p, q = difference(y, springs, i), difference(y, springs, i + 1)
        r, s = difference(y, springs, i + 2), difference(y, springs, i + 3)
        length = root(pack(dot(p, p), dot(q, q), dot(r, r), dot(s, s)))
        stretch = sub(length, pack(rest[i], rest[i + 1], rest[i + 2], rest[i + 3]))
        twice = fma(mul(pack(k[i], k[i + 1], k[i + 2], k[i + 3]), stretch), stretch, twice)
    total = sum4(twice)
    for i in range(whole, len(rest)):
        e = difference(y, springs, i)
        stretch = sqrt(dot(e, e)) - rest[i]
        total += k[i] * stretch * stretch
    return 0.5 * total


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
    upright, lowered = pack(1.0, 0.0, 0.0, 0.0), pack(1.0, 0.0, 1.0, 0.0)  # where xx, zz and yy are in a block
    count, stored = len(springs.rest), 0.0
    e, size = np.empty((TOGETHER, 4)), np.ones((3, TOGETHER))
    for begin in range(0, count, TOGETHER):
        end = min(begin + TOGETHER, count)
        for i in range(end, min(end + TOGETHER, count) if count > FEW else end):
            prefetch(A.upper, index(springs.slot, i))
        measure(springs, y, begin, end, e, size)
        for i in range(begin, end):
            j = i - begin
            k, stretch, hat = springs.stiffness[i], size[1, j], size[2, j]
            d = mul(load4(e, j), splat(size[0, j]))
            across = splat(h * h * k * (1.0 - hat))
            along = splat(h * k * (h * hat + springs.damping[item(springs.object, i)]))
            low, high = outer(mul(along, d), d)
            low, high = fma(across, upright, low), fma(across, lowered, high)
            add_block(A.diagonal, springs.ends[i, 0], low, high)
            add_block(A.diagonal, springs.ends[i, 1], low, high)
            subtract_block(A.upper, springs.slot[i], low, high)
            if len(b) == 0:
                continue
            if ahead:
                u_i = difference(u, springs, i)
                pull = mul(splat(h * k * (h * hat * dot(u_i, d) - stretch)), d)
                add_opposite(b, springs, i, fma(across, u_i, pull))
            else:
                stored += k * stretch * stretch
                add_opposite(b, springs, i, mul(splat(-h * k * stretch), d))
    return 0.5 * stored


@kernel
def pull_of(springs, y, i, h, w):
    """(h² K + h D) w at y on one end of spring i, for a velocity w of its other end."""
    _, inverse, d = axis(springs, y, i)
    hat, _ = capped(springs, springs.rest[i] * inverse)
    k = springs.stiffness[i]
    along = h * k * (h * hat + springs.damping[item(springs.object, i)]) * dot(d, w)
    return fma(splat(h * h * k * (1.0 - hat)), w, mul(splat(along), d))


@kernel
def measure(springs, y, begin, end, e, size):
    """Write e of the springs `begin` to below `end` to the rows of e, and 1/L, L − L₀ and ρ̂ to those of size (3, ·); of
    springs of zero length as `axis` does.
    """
    for i in range(begin, end):
        j, e_i = i - begin, difference(y, springs, i)
        store4(e_i, e, j)
        size[0, j], size[1, j] = dot(e_i, e_i), springs.rest[i]
    zero, cap, bend = splat(0.0), splat(springs.cap), splat(springs.bend)
    for j in range(0, end - begin, 4):
        length, rest = root(load(size, 0, j)), load(size, 1, j)
        inverse = div(splat(1.0), where_less(zero, length, length, rest))
        hat = rho = mul(rest, inverse)
        if springs.bend > 0.0:  # as `capped`
            left = sub(cap, rho)
            t = mul(splat(1.0 / springs.bend), left)
            hat = where_less(left, bend, sub(cap, mul(mul(left, t), sub(splat(2.0), t))), rho)
        store(inverse, size, 0, j)
        store(sub(length, rest), size, 1, j)
        store(where_less(cap, rho, cap, hat), size, 2, j)


@kernel(apart=None)
def add_pullback(springs, y, u, w, s, lam, h, grad, gy, gu):
    # φ = −h k ψ(e),  ψ = (L − L₀) λ·d + (1 − ρ̂) λ·s + ρ̂ (λ·d)(d·s) + β (λ·d)(d·w),  with λ = λ_a − λ_b held fixed.
    # ∂ρ̂/∂e = −ρ̃ d/L and ∂(p·d)/∂e = (p − (p·d) d)/L for any fixed vector p, so ∂φ/∂e = cl λ + cs s + cw w + ce e.
    count = len(springs.rest)
    rows, size = np.empty((4 * TOGETHER, 4)), np.ones((ROWS, TOGETHER))
    for begin in range(0, count, TOGETHER):
        end = min(begin + TOGETHER, count)
        for i in range(begin, end):
            j, a, b = i - begin, springs.ends[i, 0], springs.ends[i, 1]
            e_i, s_i = sub(load3(y, a), load3(y, b)), sub(load3(s, a), load3(s, b))
            w_i, l_i = sub(load3(w, a), load3(w, b)), sub(load3(lam, a), load3(lam, b))
            store4(e_i, rows, 4 * j)
            store4(s_i, rows, 4 * j + 1)
            store4(w_i, rows, 4 * j + 2)
            store4(l_i, rows, 4 * j + 3)
            size[EE, j], size[LE, j] = dot(e_i, e_i), dot(l_i, e_i)
            size[SE, j], size[WE, j] = dot(s_i, e_i), dot(w_i, e_i)
            size[LS, j], size[REST, j], size[K, j] = dot(l_i, s_i), springs.rest[i], springs.stiffness[i]
            size[BETA, j] = springs.damping[item(springs.object, i)]
        by_lengths(springs, end - begin, h, size)
        for i in range(begin, end):
            j = i - begin
            grad.stiffness[i] -= size[BY_K, j]
            g = fma(splat(size[CW, j]), load4(rows, 4 * j + 2), mul(splat(size[CE, j]), load4(rows, 4 * j)))
            g = fma(splat(size[CL, j]), load4(rows, 4 * j + 3), fma(splat(size[CS, j]), load4(rows, 4 * j + 1), g))
            add_opposite(gy, springs, i, g)
        if len(grad.damping) > 0:  # β = α/2
            for j in range(end - begin):
                own = item(springs.object, begin + j)
                grad.damping[own] -= 0.5 * h * size[K, j] * size[LE, j] * size[WE, j]
        if len(grad.rest) > 0:
            for j in range(end - begin):
                if size[EE, j] > 0.0:  # else it exerts nothing, whatever its rest length
                    bent = (size[LS, j] - size[LE, j] * size[SE, j]) * size[BENT, j] / size[REST, j]
                    grad.rest[begin + j] += h * size[K, j] * (size[LE, j] + bent)


@kernel
def by_lengths(springs, count, h, size):
    """From the products of so many springs' vectors, in the rows of `size`, what depends on their lengths, four at a
    time: the factors of ∂φ/∂e, what they add to the gradient, ρ̃, and λ·d, s·d, w·d for the products with e.
    """
    zero, one, two, three, four = splat(0.0), splat(1.0), splat(2.0), splat(3.0), splat(4.0)
    cap, bend, step = splat(springs.cap), splat(springs.bend), splat(h)
    for j in range(0, count, 4):
        beta, length, rest = load(size, BETA, j), root(load(size, EE, j)), load(size, REST, j)
        inverse = div(one, where_less(zero, length, length, rest))
        ld, sd = mul(load(size, LE, j), inverse), mul(load(size, SE, j), inverse)
        wd, ls = mul(load(size, WE, j), inverse), load(size, LS, j)
        hat = bent = rho = mul(rest, inverse)
        if springs.bend > 0.0:  # as `capped`
            left = sub(cap, rho)
            t = mul(splat(1.0 / springs.bend), left)
            hat = where_less(left, bend, sub(cap, mul(mul(left, t), sub(two, t))), rho)
            bent = where_less(left, bend, mul(mul(rho, t), sub(four, mul(three, t))), rho)
        hat, bent = where_less(cap, rho, cap, hat), where_less(cap, rho, zero, bent)
        slack, pull = sub(one, rho), mul(length, ld)
        turn = fma(beta, wd, mul(hat, sd))
        store(mul(step, fma(mul(slack, length), ld, fma(sub(one, hat), ls, mul(ld, turn)))), size, BY_K, j)
        hk = mul(sub(zero, step), load(size, K, j))
        by_length = mul(hk, inverse)
        store(fma(by_length, turn, mul(hk, slack)), size, CL, j)
        store(mul(by_length, mul(hat, ld)), size, CS, j)
        store(mul(by_length, mul(beta, ld)), size, CW, j)
        along = sub(fma(rho, pull, mul(bent, ls)), mul(ld, fma(bent, sd, add(turn, turn))))
        store(mul(by_length, mul(inverse, along)), size, CE, j)  # 1/L² of tiny scenes overflows
        store(ld, size, LE, j)
        store(sd, size, SE, j)
        store(wd, size, WE, j)
        store(bent, size, BENT, j)


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
