"""Air drag of the faces, in still air or wind: the editor's law, or for `quadratic` faces that of `air`.

Triangle (a, b, c): un-normalised normal n = (y_b − y_a) × (y_c − y_a), area |n|/2, mean velocity ū, wind W. Each
of the three vertices feels

    f = κ n (n·(W − ū)),   κ = drag · area / 3 = drag |n| / 6,  D = −κ n nᵀ (lumped: per vertex, not per mean),  K = 0.

n is not divided by its length: existing scenes are tuned to that. With Λ = Σ λ_i and per vertex θ_i = n·(w_i − u_i),
ν_i = n·λ_i:

    φ = h Σ λ_i·F_i = h κ [ (n·Λ)(n·(W − ū)) − Σ ν_i θ_i ].

The other law is called apart: a scene without it compiles nothing of it.
"""

from __future__ import annotations

from math import sqrt

from clothfit.engine.forces import air
from clothfit.engine.forces.faces import add_along, add_by_normal, at, change_of_normal, drag_of, edges, mean, relative
from clothfit.engine.solve.sparse import add_block, outer
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, lane0, lane1, lane2, load3, mul, splat, sub
from clothfit.kernels.vectors import cross, dot, item, vector


@kernel
def normal(faces, y, i):
    """n of face i, and κ."""
    p, q = edges(faces, y, i)
    n = cross(p, q)
    return n, drag_of(faces, i) / 6.0 * sqrt(dot(n, n))


@kernel
def powers(faces, y, u, w):
    """f·w, W, in its two parts: the push of the wind on a cloth that is still, and what its own velocity adds."""
    if faces.quadratic:
        return air.powers(faces, y, u, w)
    wind, drag = 0.0, 0.0
    still = vector(faces.wind)
    for i in range(len(faces.corners)):
        n, kappa = normal(faces, y, i)
        along = 3.0 * kappa * dot(n, mean(faces, w, i))
        wind += along * dot(n, still)
        drag -= along * dot(n, mean(faces, u, i))
    return wind, drag


@kernel(empty=None, apart=None)
def add_force(faces, y, u, f):
    if faces.quadratic:
        air.add_force(faces, y, u, f)
        return
    for i in range(len(faces.corners)):
        n, kappa = normal(faces, y, i)
        push = kappa * dot(n, relative(faces, u, i))
        for corner in range(3):
            add_along(f, faces.corners[i, corner], push, n)


@kernel(empty=None, apart=None)
def add_damping(faces, y, u, scale, q, out):
    if faces.quadratic:
        air.add_damping(faces, y, u, scale, q, out)
        return
    for i in range(len(faces.corners)):
        n, kappa = normal(faces, y, i)
        for corner in range(3):
            j = faces.corners[i, corner]
            add_along(out, j, -scale * kappa * dot(load3(q, j), n), n)


@kernel(empty=0.0, apart=0.0)
def add_step(faces, y, u, h, ahead, A, b):
    if faces.quadratic:
        air.add_step(faces, y, u, h, ahead, A, b)
        return 0.0
    for i in range(len(faces.corners)):
        n, kappa = normal(faces, y, i)
        c = h * kappa
        low, high = outer(mul(splat(c), n), n)
        for corner in range(3):
            add_block(A.diagonal, faces.corners[i, corner], low, high)
        if len(b) > 0:
            push = dot(n, relative(faces, u, i))
            for corner in range(3):
                j = faces.corners[i, corner]
                add_along(b, j, c * (push + dot(load3(u, j), n)), n)
    return 0.0


@kernel(empty=None, apart=None)
def add_pullback(faces, y, u, w, s, lam, h, grad, gy, gu):
    if faces.quadratic:
        air.add_pullback(faces, y, u, w, s, lam, h, grad, gy, gu)
        return
    for i in range(len(faces.corners)):
        n, kappa = normal(faces, y, i)
        size = dot(n, n)
        if size == 0.0:
            continue  # φ is of third order in n: its derivative is 0
        flow = relative(faces, u, i)
        eta = dot(n, flow)
        a, b, c = at(lam, faces, i)
        lam_sum = add(add(a, b), c)  # Λ
        total = dot(n, lam_sum)
        g = fma(splat(eta), lam_sum, mul(splat(total), flow))  # ∂[φ/(h κ)]/∂n at fixed κ
        value = total * eta
        for corner in range(3):
            j = faces.corners[i, corner]
            lam_j, change = load3(lam, j), sub(load3(w, j), load3(u, j))
            nu, theta = dot(n, lam_j), dot(n, change)
            value -= nu * theta
            g = fma(splat(-theta), lam_j, fma(splat(-nu), change, g))
            add_along(gu, j, h * kappa * (nu - total / 3.0), n)
        if len(grad.drag) > 0:
            grad.drag[item(faces.object, i)] += h / 6.0 * sqrt(size) * value
        if len(grad.wind) > 0:
            grad.wind[0] += h * kappa * total * lane0(n)
            grad.wind[1] += h * kappa * total * lane1(n)
            grad.wind[2] += h * kappa * total * lane2(n)
        g = fma(splat(value / size), n, g)  # κ = drag |n| / 6, so ∂κ/∂n = κ n / |n|²
        add_by_normal(gy, faces, y, i, mul(splat(h * kappa), g))


@kernel(empty=None, apart=None)
def add_pushforward(faces, y, u, w, s, dy, du, direction, h, out):
    if faces.quadratic:
        air.add_pushforward(faces, y, u, w, s, dy, du, direction, h, out)
        return
    # F_j = κ n (η − θ_j): the product rule over κ, n, η and θ_j.
    for i in range(len(faces.corners)):
        n, kappa = normal(faces, y, i)
        size = dot(n, n)
        if size == 0.0:
            continue
        dn = change_of_normal(faces, y, dy, i)
        dkappa = kappa * dot(n, dn) / size
        if len(direction.drag) > 0:
            dkappa += direction.drag[item(faces.object, i)] / 6.0 * sqrt(size)
        flow = relative(faces, u, i)
        eta = dot(n, flow)
        deta = dot(dn, flow) - dot(n, mean(faces, du, i))
        if len(direction.wind) > 0:
            deta += dot(n, vector(direction.wind))
        for corner in range(3):
            j = faces.corners[i, corner]
            change = sub(load3(w, j), load3(u, j))
            through = eta - dot(n, change)
            dthrough = deta - dot(dn, change) + dot(n, load3(du, j))
            add_along(out, j, h * (dkappa * through + kappa * dthrough), n)
            add_along(out, j, h * kappa * through, dn)
