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
from clothfit.engine.forces.faces import (
    add_along,
    add_blocks,
    add_fours,
    all_fours,
    change_of_normal,
    drag_of,
    edges,
    mean,
    relative,
)
from clothfit.kernels.fours import (
    add_to_objects,
    along,
    blocks,
    crosses,
    dots,
    everywhere,
    kept,
    minus,
    of_objects,
    plus,
    scaled,
)
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, div, fma, load3, mul, root, splat, sub, sum4, where_less
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
    end, third = len(faces.corners), splat(1.0 / 3.0)
    for i in range(0, end, 4):
        _, _, n, _, size = normals(faces, y, i, end)
        c = scaled(mul(mul(splat(h / 6.0), of_objects(faces.drag, faces.object, i, end)), size), n)  # h κ n
        add_blocks(A, faces, i, end, blocks(n, c, splat(0.0)))
        if len(b) > 0:
            u_a, u_b, u_c = all_fours(u, faces, i, end)
            at_a, at_b, at_c = dots(n, u_a), dots(n, u_b), dots(n, u_c)
            push = sub(dots(n, everywhere(faces.wind)), mul(third, add(add(at_a, at_b), at_c)))
            add_fours(b, faces, i, end, 0, scaled(add(push, at_a), c))
            add_fours(b, faces, i, end, 1, scaled(add(push, at_b), c))
            add_fours(b, faces, i, end, 2, scaled(add(push, at_c), c))
    return 0.0


@kernel
def normals(faces, y, i, end):
    """p, q, n, |n|² and |n| of up to four faces from i, before `end`."""
    a, b, c = all_fours(y, faces, i, end)
    p, q = minus(b, a), minus(c, a)
    n = crosses(p, q)
    square = dots(n, n)
    return p, q, n, square, root(square)


@kernel(empty=None, apart=None)
def add_pullback(faces, y, u, w, s, lam, h, grad, gy, gu):
    if faces.quadratic:
        air.add_pullback(faces, y, u, w, s, lam, h, grad, gy, gu)
        return
    end, zero, third = len(faces.corners), splat(0.0), splat(1.0 / 3.0)
    for i in range(0, end, 4):
        p, q, n, square, size = normals(faces, y, i, end)
        c = mul(splat(h / 6.0), size)
        scale = mul(c, of_objects(faces.drag, faces.object, i, end))  # h κ
        (u_a, u_b, u_c), (w_a, w_b, w_c) = all_fours(u, faces, i, end), all_fours(w, faces, i, end)
        l_a, l_b, l_c = all_fours(lam, faces, i, end)
        flow = minus(everywhere(faces.wind), scaled(third, plus(plus(u_a, u_b), u_c)))
        lam_sum = plus(plus(l_a, l_b), l_c)  # Λ
        eta, total = dots(n, flow), dots(n, lam_sum)
        w_a, w_b, w_c = minus(u_a, w_a), minus(u_b, w_b), minus(u_c, w_c)  # of −θ
        nu_a, nu_b, nu_c = dots(n, l_a), dots(n, l_b), dots(n, l_c)
        at_a, at_b, at_c = dots(n, w_a), dots(n, w_b), dots(n, w_c)
        value = fma(total, eta, fma(nu_a, at_a, fma(nu_b, at_b, mul(nu_c, at_c))))  # φ/(h κ)
        g = along(eta, lam_sum, scaled(total, flow))  # its derivative by n at fixed κ
        g = along(at_a, l_a, along(nu_a, w_a, along(at_b, l_b, along(nu_b, w_b, g))))
        g = along(at_c, l_c, along(nu_c, w_c, g))
        push, mean_nu = scaled(scale, n), mul(third, total)
        add_fours(gu, faces, i, end, 0, scaled(sub(nu_a, mean_nu), push))
        add_fours(gu, faces, i, end, 1, scaled(sub(nu_b, mean_nu), push))
        add_fours(gu, faces, i, end, 2, scaled(sub(nu_c, mean_nu), push))
        if len(grad.drag) > 0:
            add_to_objects(grad.drag, faces.object, i, end, mul(c, value))
        if len(grad.wind) > 0:
            by_x, by_y, by_z = scaled(kept(total, i, end), push)
            grad.wind[0] += sum4(by_x)
            grad.wind[1] += sum4(by_y)
            grad.wind[2] += sum4(by_z)
        # κ = drag |n| / 6, so ∂κ/∂n = κ n / |n|²; without area φ is of third order in n, and its derivative is 0
        bent = where_less(zero, square, div(value, square), zero)
        g = scaled(scale, along(bent, n, g))
        by_b, by_c = crosses(q, g), crosses(g, p)  # g·(dp × q) = dp·(q × g) and g·(p × dq) = dq·(g × p)
        add_fours(gy, faces, i, end, 1, by_b)
        add_fours(gy, faces, i, end, 2, by_c)
        add_fours(gy, faces, i, end, 0, minus(scaled(splat(-1.0), by_b), by_c))


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
