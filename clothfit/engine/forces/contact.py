"""Contact of a cloth with what it slides on: colliders, and itself. It is pushed apart, and rubs.

Who touches is a row: a vertex at a collider (`collider_rows`: planes, round cones, boxes, closed meshes), or the
closest points of two parts of the cloth (`selfcontact.rows`). Of row k these say

    its four vertices, their weights c, n, d, κ, μ, the velocity V of what they go past, and what else it asks to have
    back (`row`),
    whether a step that takes the vertex of a collider by a way, from where it is linearised, knows it (`knows`), and
    before that whether it surely does not (`is_far`), or does whatever happens (not `is_open`),
    how far it is linearised from where the other forces are (`behind`), and how deep it is anywhere (`level`),
    how c, n, d, V and κ change with the vertices (`changes`, `add_back`),

the rest is here, once for all. With U = Σ cᵢ uᵢ − V, S = Σ cᵢ sᵢ and Z = Σ cᵢ wᵢ − V, vertex i feels cᵢ T, with the T
of `law`. As cᵢ n is the derivative of the distance, the push has the energy ½ κ d², and K = −κ cᵢ cⱼ n nᵀ is what is
definite of its second derivative.

A step knows the contacts that it begins with: of colliders, vertices that are inside where it is linearised, or that
their velocities lead there. Who is outside there and ends inside all the same felt nothing: the faster, the deeper, and
with an energy that nothing gave. So such rows are added to the step's matrix and its right-hand side as they are, with
d < 0, and it is solved again, until it ends in no other: those that would then pull are taken out. This solves a
complementarity problem, min ½ (w − w₀)ᵀA (w − w₀) + Σ ½ κ max(0, d − h n·W)² for the rows in view, by Newton's method
with a line search (J. Nocedal, S. J. Wright, Numerical optimization, section 3.5). Pairs of a cloth are
all found so, those that it begins with too (`engine.contact_steps`). Where the surface of a mesh turns away from the
plane that a vertex met, by more than half of its thickness, where pairs would pass through each other, or where at the
end of the step contacts store more than its model knows, one more of Newton's iterations follows, linearised where that
one ended; it begins with the rows that pressed.

What was not touched in the step before does not rub yet. The last solution is the step, and the derivatives take it
with the rows that it was solved with. They are noted for each iteration of it, and for the next step what it pressed
vertices with (`press`), whose derivatives are handed from step to step.
"""

from __future__ import annotations

import numpy as np

from clothfit.engine.forces import collider_rows, law
from clothfit.engine.forces.faces import add_along
from clothfit.engine.forces.law import STICTION_SPEED, across, mixed, pressing, rubbing, spread
from clothfit.engine.forces.selfcontact import rows
from clothfit.engine.forces.surfaces import MESH
from clothfit.kernels.kernel import OfKind, kernel
from clothfit.kernels.lanes.operations import add, fma, load3, mul, splat, sub
from clothfit.kernels.vectors import combine, copy_row, dot

ACTIVE_SET_ROUNDS = 24
"""Times, at most, that an iteration is solved again."""

DROPS = 20
"""In how many of these, contacts that pull are taken out; later they stay, so that the rounds end."""

BESIDE = 2
"""Numbers that a step hands to the next one, before those of contact (`step.guard`)."""

SURPLUS = 0.01
"""What contacts may store at the end of a step beyond what its model has in them, relative to that and the kinetic
energy then.
"""

EXCESS_DEPTH = 0.5
"""How much deeper than it was for the step's model a vertex may end, relative to the thickness."""

(
    count, row, level, behind, most, thick, is_far, knows, lay, is_open, is_reached, may_change, changes, add_back,
    leaving, pass_on, load, give_load,
) = (
    OfKind({collider_rows.Colliders: getattr(collider_rows, name), rows.Contact: getattr(rows, name)})
    for name in (
        "count", "row", "level", "behind", "most", "thick", "is_far", "knows", "lay", "is_open", "is_reached",
        "may_change", "changes", "add_back", "leaving", "pass_on", "load", "give_load",
    )
)  # fmt: skip


# --- forces


@kernel
def sliding(part, k, found, u):
    """γ and U of a row."""
    own, c, n, depth, kappa, mu, V, _ = found
    U = sub(mixed(c, own, u), V)
    return rubbing(pressing(load(part, k)[0], kappa * depth), mu, n, U)[1], U


@kernel
def past(found, u, w, s, lag):
    """U, S and Z of a row that is linearised by `lag` ahead of the others."""
    own, c, V = found[0], found[1], found[6]
    return sub(mixed(c, own, u), V), add(mixed(c, own, s), lag), sub(mixed(c, own, w), V)


@kernel(empty=0.0, apart=0.0)
def energy(part, y):
    total = 0.0  # ½ κ d²
    for k in range(count(part, y)):
        kappa, depth = level(part, y, k)
        total += 0.5 * kappa * max(depth, 0.0) * max(depth, 0.0)
    return total


@kernel(empty=0.0, apart=0.0)
def damping_power(part, y, u, w):
    total = 0.0
    for k in range(count(part, y)):
        found = row(part, y, k)
        if found[3] > 0.0 and knows(part, y, k, found, splat(0.0)):
            gamma, U = sliding(part, k, found, u)
            total -= gamma * dot(across(found[2], U), sub(mixed(found[1], found[0], w), found[6]))
    return total


@kernel(empty=(0.0, 0.0), apart=(0.0, 0.0))
def power(part, y, u, w, s, h, begin, f):
    """What moves does at the end of a step, and what friction takes, W, by the forces of its model, which are added to
    f; `begin` has when it begins and how long it is, s, h what its model takes for that.
    """
    total, rubbed = 0.0, 0.0
    for k in range(count(part, y)):
        part.depth[k], way = most(part, y, k), way_of(k % len(y), u, w, s, h)
        if is_far(part, y, k, way, part.depth[k]):
            continue
        found, lag = row(part, y, k), behind(part, y, k)
        own, c, n, depth, kappa, _, V, _ = found
        if knows(part, y, k, found, add(way, lag)):
            push = kappa * (depth - dot(n, add(mixed(c, own, s), lag)))
            gamma, Z = sliding(part, k, found, u)[0], sub(mixed(c, own, w), V)
            T = law.force(push, gamma, n, Z)
            spread(c, own, T, f)
            total += dot(T, V) + push * leaving(part, found, begin)
            rubbed += gamma * dot(across(n, Z), Z)
    return total, rubbed


@kernel
def way_of(i, u, w, s, h):
    """From y to where u leads vertex i: it goes by s from y, at last with w for u."""
    return fma(splat(h), sub(load3(u, i), load3(w, i)), load3(s, i))


@kernel(empty=None, apart=None)
def add_force(part, y, u, f):
    for k in range(count(part, y)):
        if is_far(part, y, k, splat(0.0), most(part, y, k)):
            continue
        found = row(part, y, k)
        own, c, n, depth, kappa, _, _, _ = found
        if knows(part, y, k, found, splat(0.0)):
            gamma, U = sliding(part, k, found, u)
            spread(c, own, law.force(kappa * depth, gamma, n, U), f)


@kernel(empty=None, apart=None)
def add_damping(part, y, u, scale, q, out):
    for k in range(count(part, y)):
        damp_row(part, k, y, u, scale, q, out)


@kernel
def damp_row(part, k, y, u, scale, q, out):
    """`add_damping` of one row."""
    if not (part.depth[k] > 0.0 or load(part, k)[0] > 0.0):
        return
    found = row(part, y, k)
    own, c, n, depth, _, mu, _, _ = found
    if pressing(load(part, k)[0], depth) > 0.0 and mu > 0.0 and knows(part, y, k, found, splat(0.0)):
        spread(c, own, mul(splat(-scale * sliding(part, k, found, u)[0]), across(n, mixed(c, own, q))), out)


@kernel(empty=0.0, apart=0.0)
def add_step(part, y, u, h, ahead, A, b):
    stored, reach = 0.0, 0.0 if ahead else h
    for k in range(count(part, y)):
        part.depth[k], led = most(part, y, k), load3(u, k % len(y))
        if is_far(part, y, k, mul(splat(reach), led), part.depth[k]):
            continue
        found, lag = row(part, y, k), behind(part, y, k)
        own, c, n, depth, kappa, _, V, _ = found
        part.depth[k] = depth
        if knows(part, y, k, found, fma(splat(reach), led, lag)):
            rub = h * sliding(part, k, found, u)[0]
            lay(part, k, found, h * h * kappa, rub, law.turning(h, h * h * kappa, depth), 1.0, A)
            if len(b) > 0:
                stored += 0.5 * kappa * max(depth, 0.0) * depth
                going = h * dot(n, mixed(c, own, u)) if ahead else -dot(n, lag)
                spread(c, own, law.force(h * kappa * (depth + going), -rub, n, V), b)
    return stored


@kernel(empty=None, apart=None)
def add_pullback(part, y, u, w, s, lam, h, grad, gy, gu):
    for k in range(count(part, y)):
        pull_row(part, k, y, u, w, s, lam, h, grad, gy, gu)


@kernel
def pull_row(part, k, y, u, w, s, lam, h, grad, gy, gu):
    """`add_pullback` of one row."""
    way = way_of(k % len(y), u, w, s, h)
    if is_far(part, y, k, way, part.depth[k]):
        return
    found, lag = row(part, y, k), behind(part, y, k)
    own, c, n, depth, kappa, mu, _, more = found
    if knows(part, y, k, found, add(way, lag)):
        U, S, Z = past(found, u, w, s, lag)
        pressed, _, by_made = load(part, k)
        made = by_made / h if depth > dot(n, S) else 0.0
        vectors, by_law = law.pull((kappa, mu, depth, n, U, pressed), S, Z, mixed(c, own, lam), made)
        give_load(part, k, h * by_law[3])
        spread(c, own, mul(splat(h), vectors[1]), gu)
        add_back(part, found, vectors, by_law, (y, u, w, s, lam), h, grad, gy)
        if len(grad.friction) > 0:
            grad.friction[more[0]] += h * by_law[1]
        if len(grad.contact) > 0:
            grad.contact[more[0]] += h * more[1] * by_law[2]


@kernel(empty=None, apart=None)
def add_pushforward(part, y, u, w, s, dy, du, direction, h, out):
    for k in range(count(part, y)):
        way = way_of(k % len(y), u, w, s, h)
        if is_far(part, y, k, way, part.depth[k]):
            continue
        found, lag = row(part, y, k), behind(part, y, k)
        own, c, n, depth, kappa, mu, _, more = found
        if knows(part, y, k, found, add(way, lag)):
            U, S, Z = past(found, u, w, s, lag)
            dc, dn, ddelta, dV, dkappa, dlag = changes(part, y, found, dy, direction)
            dU, dZ = add(mixed(dc, own, u), sub(mixed(c, own, du), dV)), sub(mixed(dc, own, w), dV)
            dmu = direction.friction[more[0]] if len(direction.friction) > 0 else 0.0
            dkappa += more[1] * direction.contact[more[0]] if len(direction.contact) > 0 else 0.0
            moved = dn, ddelta, dU, add(mixed(dc, own, s), dlag), dZ
            pressed, dload, _ = load(part, k)
            T, dT = law.change((kappa, mu, depth, n, U, pressed), S, Z, moved, dmu, dkappa, dload)
            spread(dc, own, mul(splat(h), T), out)
            spread(c, own, mul(splat(h), dT), out)


# --- the rows of a step


@kernel(absent=None)
def clear(part):
    """Before a step: nothing is met yet, nor pressed before."""
    part.turn[0] = 0
    part.on[:] = False
    part.depth[:] = np.inf  # until it is linearised
    part.load[:] = -1.0


@kernel(absent=None)
def turn_to(part, k):
    """From now on iteration k of the step is computed."""
    part.turn[0] = k


@kernel(empty=False, apart=False)
def is_deep(part):
    """Whether something is deep where the step was linearised at last."""
    return part.depth.max() > 0.0


@kernel(absent=None)
def save_active(part, steps, t):
    """Write what step t of a `rollout.Rollout` met, in the iterations that it took, and what it pressed."""
    copy_flags(part.on[: part.turn[0] + 1], steps.active[t])
    save_load(part, steps, t)


@kernel
def save_load(colliders, steps, t):
    """Write what pressed the vertices in step t."""
    copy_row(colliders.load[1], steps.guard_state[t + 1, BESIDE:])


@kernel(absent=None)
def expect(part, steps, t):
    """Before step t of a `rollout.Rollout`: nothing is met yet, and what the one before has pressed is set."""
    clear(part)
    set_load(part, steps.guard_state[t, BESIDE:])


@kernel(absent=None)
def set_load(colliders, load):
    """Set what has pressed vertices in the step before, (R,), N."""
    copy_row(load, colliders.load[0])


@kernel(empty=None, apart=None)
def press(colliders, y, u, w, s, h):
    """Note what presses vertices at the end of a step, by its model."""
    for k in range(count(colliders, y)):
        left, kappa, _, _ = left_in(colliders, k, y, u, w, s, h)
        colliders.load[1, k] = kappa * max(left, 0.0)


@kernel
def left_in(colliders, k, y, u, w, s, h):
    """How deep a vertex is at the end of a step, by its model, m, κ, n and S; 0 where the step does not know it."""
    i, way = k % len(y), way_of(k % len(y), u, w, s, h)
    if not is_far(colliders, y, k, way, colliders.depth[k]):
        found, lag = row(colliders, y, k), behind(colliders, y, k)
        if knows(colliders, y, k, found, add(way, lag)):
            S = add(load3(s, i), lag)
            return found[3] - dot(found[2], S), found[4], found[2], S
    return 0.0, 0.0, splat(0.0), splat(0.0)


@kernel(empty=None, apart=None)
def add_press(colliders, y, u, w, s, h, scale, out):
    """out += scale times the gradient by w, for that by what presses vertices."""
    for k in range(count(colliders, y)):
        by_made = colliders.of_load[1, k]
        if by_made != 0.0:
            left, kappa, n, _ = left_in(colliders, k, y, u, w, s, h)
            if left > 0.0:
                add_along(out, k % len(y), -scale * by_made * h * kappa, n)


@kernel(empty=None, apart=None)
def push_press(colliders, y, u, w, s, dy, dq, direction, h):
    """Set the changes of what presses vertices, for those of y and of the velocity, dq, from where s counts, (n, 3)."""
    for k in range(count(colliders, y)):
        colliders.of_load[1, k] = 0.0
        left, kappa, n, S = left_in(colliders, k, y, u, w, s, h)
        if left > 0.0:
            found = row(colliders, y, k)
            _, dn, ddelta, _, dkappa, dlag = changes(colliders, y, found, dy, direction)
            dkappa += direction.contact[found[7][0]] if len(direction.contact) > 0 else 0.0
            moved = dn, ddelta, fma(splat(h), load3(dq, k % len(y)), dlag)
            colliders.of_load[1, k] = law.pushed(kappa, left, n, S, moved, dkappa)


@kernel(absent=None)
def hand(colliders, back):
    """Before the derivative of a step: what it uses of the loads is what the one before makes or, `back`, the other way
    round.
    """
    to = 1 if back else 0
    copy_row(colliders.of_load[1 - to], colliders.of_load[to])
    if back:
        colliders.of_load[0] = 0.0


@kernel(absent=None)
def end_press(colliders):
    """After the derivative of the last iteration of a step, backwards: others make no loads."""
    colliders.of_load[1] = 0.0


@kernel(absent=None)
def forget(colliders):
    """Before the derivatives of a motion."""
    colliders.of_load[:] = 0.0


@kernel(absent=None)
def load_active(part, steps, t):
    """Set what step t met, and the one before has pressed, before its derivatives."""
    part.turn[0] = 0
    part.depth[:] = np.inf
    copy_flags(steps.active[t], part.on)
    set_load(part, steps.guard_state[t, BESIDE:])


@kernel
def copy_flags(a, out):
    """out = a, (N, R), as far as a has rows."""
    for k in range(len(a)):
        copy_row(a[k], out[k])


@kernel(empty=0, apart=0)
def update_active(part, free, at, h, end, drops, A, b):
    """Add to A and b the rows that an iteration ends in and did not know, and where `drops` take out those that it met
    before and that pull; returns how many there are of both.

    `at` is x before the step, y and u where it is linearised and its velocity w; `end` is scratch (n, 3).
    """
    x, y, u, w = at
    combine(1.0, x, h, w, end)
    changed, on = 0, part.on[part.turn[0]]
    for k in range(count(part, y)):
        if not (is_open(part, k) and is_reached(part, k, free, y, end, h * STICTION_SPEED)):
            continue
        found = row(part, y, k)
        own, c, n, depth, kappa, _, V, _ = found
        presses = left_of(part, k, found, y, end) > 0.0
        if presses == on[k] or not (presses or drops) or not may_change(part, k, found, presses, at, end, h):
            continue
        on[k] = presses
        changed += 1
        sign, rub = 1.0 if presses else -1.0, h * sliding(part, k, found, u)[0]
        lay(part, k, found, h * h * kappa, rub, 0.0, sign, A)
        at_y = sub(mixed(c, own, y), behind(part, y, k))
        left = depth + dot(n, sub(at_y, mixed(c, own, x)))  # n·(y − x): h n·U where the step is linearised ahead
        Z = mixed(led(free, own, c), own, w)
        spread(c, own, law.force(sign * h * kappa * (left - h * dot(n, Z)), sign * rub, n, sub(Z, V)), b)
    return changed


@kernel(empty=0.0, apart=0.0)
def slope_error(part, free, at, before, h, end):
    """The derivative of the rows' energies, J, along the way from the velocities `before` (n, 3) to w, at its end, less
    that of those which the solution w had; the other arguments are those of `update_active`.
    """
    x, y, _, w = at
    combine(1.0, x, h, w, end)
    total, on = 0.0, part.on[part.turn[0]]
    for k in range(count(part, y)):
        if not (is_open(part, k) and is_reached(part, k, free, y, end, h * STICTION_SPEED)):
            continue
        found = row(part, y, k)
        own, c, n, _, kappa, _, _, _ = found
        left = left_of(part, k, found, y, end)
        presses = left > 0.0
        if presses != on[k] and may_change(part, k, found, presses, at, end, h):
            change = -h * dot(n, sub(mixed(c, own, w), mixed(c, own, before)))
            total += kappa * abs(left) * change  # −left where it pulls
    return total


@kernel(empty=0.0, apart=0.0)
def surplus(part, free, at, h, end):
    """How much more contacts store at the `end` (n, 3) of an iteration than its model has in them and SURPLUS of that,
    J, or inf where one is deeper than EXCESS_DEPTH says; the other arguments are those of `update_active`.
    """
    y, more = at[1], 0.0
    for k in range(count(part, y)):
        if is_reached(part, k, free, y, end, 0.0):
            found, (kappa, deep) = row(part, y, k), level(part, end, k)
            left, thickness = left_of(part, k, found, y, end), thick(part, y, k)
            if 0.0 < thickness < (deep - max(left, 0.0) - h * STICTION_SPEED) / EXCESS_DEPTH:
                return np.inf
            more += 0.5 * (kappa * max(deep, 0.0) * deep - (1.0 + SURPLUS) * found[4] * max(left, 0.0) * left)
    return more


@kernel
def left_of(part, k, found, y, end):
    """d − n·S: how deep a row is for the model of a step that ends at `end` (n, 3)."""
    own, c, n, depth, _, _, _, _ = found
    return depth - dot(n, add(sub(mixed(c, own, end), mixed(c, own, y)), behind(part, y, k)))


@kernel
def depths_along(part, y, end):
    """How deep rows (R,) are where they are linearised, and for the model of a step from there to `end` (n, 3), m."""
    depth, left = np.zeros(count(part, y)), np.zeros(count(part, y))
    for k in range(len(depth)):
        found = row(part, y, k)
        depth[k], left[k] = found[3], left_of(part, k, found, y, end)
    return depth, left


@kernel
def led(free, own, c):
    """The weights c where a row is fixed, 0 where it is free."""
    one, other = 0.0 if free[own[0]] else c[0], 0.0 if free[own[1]] else c[1]
    return one, other, 0.0 if free[own[2]] else c[2], 0.0 if free[own[3]] else c[3]


@kernel(empty=None, apart=None)
def carry(part, free, at, h, end):
    """Let the next iteration begin with the rows that press in this one; the arguments are those of `update_active`."""
    combine(1.0, at[0], h, at[3], end)
    for k in range(count(part, at[1])):
        part.on[part.turn[0] + 1, k] = pass_on(part, k, free, at, h, end)


@kernel
def turns_inward(colliders):
    """Whether a surface of a collider may turn away from a plane that a vertex met: that of a mesh that is thick."""
    for c in range(len(colliders.rows)):
        own = colliders.rows[c]
        if own[collider_rows.SHAPE, 0] == MESH and own[collider_rows.LAW, collider_rows.THICKNESS] > 0.0:
            return True
    return False
