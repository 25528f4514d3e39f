"""One correction of XPBD: moves the vertices of a constraint towards it, as far as its compliance lets them.

With C and ∇C at x, the multiplier λ, the inverse masses w, the places p before the substep of h, and

    α̃ = (compliance)/h²,  γ = τ/h,  τ the time of the constraint's damping (damping coefficient times compliance)

    Δ = −(C + α̃ λ + γ ∇C·(x − p)) / ((1 + γ) Σ wᵢ |∇ᵢC|² + α̃),   λ⁺ = λ + ω Δ,   xᵢ⁺ = xᵢ + wᵢ ∇ᵢC ω Δ

(M. Macklin, M. Müller, N. Chentanez, *XPBD*, 2016, eq. 26), with a relaxation ω between 0 and 2, as in successive
over-relaxation: where the directions ∇C stay, the iterations end at the same place, sooner or later (D. Young,
*Iterative solution of large linear systems*, 1971). Without one ω is 1. A sphere is a constraint |x − c| − r ≥ 0 of
each vertex, whose multiplier stays at least 0. Derivatives stand under their values; H is symmetric.
"""

from __future__ import annotations

from math import sqrt

from clothfit.kernels.kernel import kernel
from clothfit.simulators.constraint import bend, measure, size_of


@kernel
def factors(model, c, h):
    """α̃ and γ of constraint c."""
    return model.compliance[c] / (h * h), model.time[c] / h


@kernel
def parts(model, c, h, x, p, multiplier, g):
    """Write ∇C to g; returns Δ, its denominator, ∇C·(x − p) and Σ w |∇C|²; Δ is 0 where nothing can move."""
    stiff, gamma = factors(model, c, h)
    value = measure(model.members, model.rest, c, x, g)
    slide, weight = 0.0, 0.0
    for k in range(size_of(model.members, c)):
        i = model.members[c, k]
        square = 0.0
        for j in range(3):
            square += g[k, j] * g[k, j]
            slide += g[k, j] * (x[i, j] - p[i, j])
        weight += model.inverse[i] * square
    below = (1.0 + gamma) * weight + stiff
    if not below > 0.0 or weight == 0.0:
        return 0.0, 0.0, slide, weight
    return -(value + stiff * multiplier + gamma * slide) / below, below, slide, weight


@kernel
def project(model, c, h, x, p, multiplier, g):
    """Correct x by constraint c; returns λ⁺."""
    change = model.relaxation[c] * parts(model, c, h, x, p, multiplier, g)[0]
    for k in range(size_of(model.members, c)):
        i = model.members[c, k]
        for j in range(3):
            x[i, j] += model.inverse[i] * g[k, j] * change
    return multiplier + change


@kernel
def push_project(model, direction, c, h, x, p, multiplier, dx, dp, dmultiplier, work):
    """Correct x and change dx, the change of x, in the same way; returns λ⁺ and its change."""
    g, d, dg = work[0], work[1], work[2]
    stiff, gamma = factors(model, c, h)
    change, below, slide, weight = parts(model, c, h, x, p, multiplier, g)
    if below == 0.0:
        return multiplier, dmultiplier
    dstiff, dgamma = direction.compliance[c] / (h * h), direction.time[c] / h
    count = size_of(model.members, c)
    for k in range(count):
        i = model.members[c, k]
        for j in range(3):
            d[k, j] = dx[i, j]
    bend(model.members, c, x, d, dg)
    dvalue, dslide, dweight = -direction.rest[c], 0.0, 0.0
    for k in range(count):
        i = model.members[c, k]
        for j in range(3):
            dvalue += g[k, j] * d[k, j]
            dslide += dg[k, j] * (x[i, j] - p[i, j]) + g[k, j] * (dx[i, j] - dp[i, j])
            dweight += g[k, j] * (direction.inverse[i] * g[k, j] + 2.0 * model.inverse[i] * dg[k, j])
    above = dvalue + dstiff * multiplier + stiff * dmultiplier + dgamma * slide + gamma * dslide
    dbelow = dgamma * weight + (1.0 + gamma) * dweight + dstiff
    omega = model.relaxation[c]
    dchange = direction.relaxation[c] * change - omega * (above + change * dbelow) / below
    change *= omega
    for k in range(count):
        i = model.members[c, k]
        w, dw = model.inverse[i], direction.inverse[i]
        for j in range(3):
            x[i, j] += w * g[k, j] * change
            dx[i, j] += dw * g[k, j] * change + w * (dg[k, j] * change + g[k, j] * dchange)
    return multiplier + change, dmultiplier + dchange


@kernel
def pull_project(model, c, h, x, p, multiplier, x_bar, p_bar, multiplier_bar, grad, work):
    """Turn x_bar, the gradient by x⁺, into that by x; x is that before the correction. Adds to p_bar and to `grad`;
    returns the gradient by λ.
    """
    g, g_bar, turned = work[0], work[1], work[2]
    stiff, gamma = factors(model, c, h)
    change, below, slide, weight = parts(model, c, h, x, p, multiplier, g)
    if below == 0.0:
        return multiplier_bar
    count, omega = size_of(model.members, c), model.relaxation[c]
    change_bar = multiplier_bar  # by ω Δ, then by Δ
    for k in range(count):
        i = model.members[c, k]
        along = 0.0
        for j in range(3):
            along += g[k, j] * x_bar[i, j]
            g_bar[k, j] = model.inverse[i] * omega * change * x_bar[i, j]
        change_bar += model.inverse[i] * along
        grad.inverse[i] += omega * change * along
    grad.relaxation[c] += change * change_bar
    change_bar *= omega
    above_bar, below_bar = -change_bar / below, -change * change_bar / below
    grad.compliance[c] += (above_bar * multiplier + below_bar) / (h * h)
    grad.time[c] += (above_bar * slide + below_bar * weight) / h
    grad.rest[c] -= above_bar
    scale = 2.0 * (1.0 + gamma) * below_bar
    for k in range(count):
        i = model.members[c, k]
        for j in range(3):
            grad.inverse[i] += (1.0 + gamma) * below_bar * g[k, j] * g[k, j]
            g_bar[k, j] += scale * model.inverse[i] * g[k, j] + gamma * above_bar * (x[i, j] - p[i, j])
    bend(model.members, c, x, g_bar, turned)
    for k in range(count):
        i = model.members[c, k]
        for j in range(3):
            x_bar[i, j] += (1.0 + gamma) * above_bar * g[k, j] + turned[k, j]
            p_bar[i, j] -= gamma * above_bar * g[k, j]
    return multiplier_bar + stiff * above_bar


@kernel
def gap(centre, radius, x, i, n):
    """Write the outward normal of vertex i at a sphere to n (3,); returns the gap, m, and the distance to the centre,
    infinite at the centre itself, whose normal is up.
    """
    for j in range(3):
        n[j] = x[i, j] - centre[j]
    distance = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if distance == 0.0:
        n[0], n[1], n[2] = 0.0, 1.0, 0.0
        return -radius, float("inf")
    for j in range(3):
        n[j] /= distance
    return distance - radius, distance


@kernel
def push_out(stiff, inverse, depth, multiplier):
    """Δ of a contact of gap `depth`, and whether it presses after that."""
    change = -(depth + stiff * multiplier) / (inverse + stiff)
    if multiplier + change > 0.0:
        return change, True
    return -multiplier, False


@kernel
def touch(stiff, inverse, centre, radius, x, i, multiplier, n):
    """Correct vertex i by its contact with a sphere; returns λ⁺."""
    depth, _ = gap(centre, radius, x, i, n)
    change, _ = push_out(stiff, inverse, depth, multiplier)
    for j in range(3):
        x[i, j] += inverse * n[j] * change
    return multiplier + change


@kernel
def push_touch(stiff, inverse, dinverse, centre, radius, x, i, multiplier, dx, dmultiplier, n):
    """Correct vertex i and its change; returns λ⁺ and its change."""
    depth, distance = gap(centre, radius, x, i, n)
    change, presses = push_out(stiff, inverse, depth, multiplier)
    along = n[0] * dx[i, 0] + n[1] * dx[i, 1] + n[2] * dx[i, 2]
    dchange = -dmultiplier
    if presses:
        dchange = -(along + stiff * dmultiplier + change * dinverse) / (inverse + stiff)
    for j in range(3):
        turn = (dx[i, j] - along * n[j]) / distance
        x[i, j] += inverse * n[j] * change
        dx[i, j] += inverse * (turn * change + n[j] * dchange) + dinverse * n[j] * change
    return multiplier + change, dmultiplier + dchange


@kernel
def pull_touch(stiff, inverse, centre, radius, x, i, multiplier, x_bar, multiplier_bar, grad, n):
    """The adjoint of `touch`; see `pull_project`."""
    depth, distance = gap(centre, radius, x, i, n)
    change, presses = push_out(stiff, inverse, depth, multiplier)
    along = n[0] * x_bar[i, 0] + n[1] * x_bar[i, 1] + n[2] * x_bar[i, 2]
    change_bar = multiplier_bar + inverse * along
    grad.inverse[i] += change * along
    depth_bar, out = 0.0, multiplier_bar
    if presses:
        depth_bar = -change_bar / (inverse + stiff)
        grad.inverse[i] += change * depth_bar
        out = multiplier_bar + stiff * depth_bar
    else:
        out = multiplier_bar - change_bar
    for j in range(3):
        turn = (x_bar[i, j] - along * n[j]) / distance
        x_bar[i, j] += inverse * change * turn + depth_bar * n[j]
    return out
