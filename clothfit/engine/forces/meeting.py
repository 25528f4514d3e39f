"""Contacts with colliders that a step begins with, and those that it only ends in.

A step knows the vertices that are in a collider where it is linearised, and those that their velocities lead into it.
One that is outside there and ends inside all the same felt nothing: the faster the body, the deeper, and with an energy
that nothing gave. So such contacts are added to the step's matrix and its right-hand side as they are, with d < 0, and
it is solved again, until it ends in no other: those that would then pull are taken out. Where the surface of a mesh
turns away from the plane that a vertex met, by more than half of its thickness, one more of Newton's iterations
follows, linearised where that one ended; it begins with the contacts that pressed. The law is `law`, a
spring that pushes where the way along the normal is longer than the distance,

    F = κ (d − n·s) n > 0,

and does not rub yet. The last solution is the step, and the derivatives take it with the contacts that it was solved
with. They are noted for each iteration of it.
"""

from __future__ import annotations

from clothfit.engine.forces.faces import add_along
from clothfit.engine.forces.law import CREEP, block
from clothfit.engine.forces.surfaces import MESH
from clothfit.engine.forces.touch import LAW, SHAPE, STIFFNESS, THICKNESS, contact, counts
from clothfit.engine.solve.sparse import add_block
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import fma, load3, splat, sub
from clothfit.kernels.vectors import combine, dot

STRAY = 0.5
"""How much deeper than it was for the step's model a vertex may end, relative to the thickness."""

ROUNDS = 12
"""Times, at most, that an iteration is solved again."""

DROPS = 4
"""In how many of these, contacts that pull are taken out; later they stay, so that the rounds end."""


@kernel(absent=None)
def clear(colliders):
    """Before a step: nothing is met yet."""
    colliders.turn[0] = 0
    colliders.met[:] = False


@kernel(absent=None)
def turn_to(colliders, k):
    """From now on iteration k of the step is computed."""
    colliders.turn[0] = k


@kernel(empty=False, apart=False)
def touches(colliders):
    """Whether a vertex is in a collider where the step was linearised at last."""
    return colliders.depth.max() > 0.0


@kernel(absent=None)
def note(colliders, met, t):
    """Write what step t met to met (T, N, C, n)."""
    copy_flags(colliders.met, met[t])


@kernel(absent=None)
def recall(colliders, met, t):
    """Set what step t met, before its derivatives."""
    colliders.turn[0] = 0
    copy_flags(met[t], colliders.met)


@kernel
def copy_flags(a, out):
    """out = a, (N, C, n), as `vectors.copy` does it."""
    for k in range(out.shape[0]):
        for c in range(out.shape[1]):
            for i in range(out.shape[2]):
                out[k, c, i] = a[k, c, i]


@kernel(empty=0, apart=0)
def meet(colliders, free, at, h, end, drops, A, b):
    """Add to A and b the contacts that an iteration ends in and did not know, and where `drops` take out those that it
    met before and that pull; returns how many there are of both.

    `at` is x before the step, y and u where it is linearised and its velocity w; `end` is scratch (n, 3).
    """
    x, y, u, w = at
    changed = 0
    combine(1.0, x, h, w, end)
    for c in range(len(colliders.rows)):
        own, met = colliders.rows[c], colliders.met[colliders.turn[0], c]
        for i in range(len(x)):
            if not free[i] or (not met[i] and not deeper(colliders, i, c, y, end, h * CREEP)):
                continue
            depth, _, _, n, _, _ = contact(colliders, y, i, c)
            if depth > 0.0:
                continue
            back = sub(load3(x, i), load3(y, i))  # −h u where the step is linearised ahead, else 0
            if not met[i] and counts(colliders, depth, n, c, i, load3(y, i), fma(splat(h), load3(u, i), back)):
                continue
            presses = depth - dot(n, sub(load3(end, i), load3(y, i))) > 0.0
            if presses == met[i] or not (presses or drops):
                continue
            met[i] = presses
            changed += 1
            kappa = own[LAW, STIFFNESS] if presses else -own[LAW, STIFFNESS]
            low, high = block(h * h * kappa, 0.0, n)
            add_block(A.diagonal, i, low, high)
            add_along(b, i, h * kappa * (depth - dot(n, back)), n)
    return changed


@kernel
def deeper(colliders, i, c, y, end, least):
    """Whether vertex i ends deeper in collider c than that: distances fall no faster than it goes from y on."""
    depth, way = colliders.depth[c, i], sub(load3(end, i), load3(y, i))
    if depth <= least and dot(way, way) <= (least - depth) * (least - depth):
        return False
    return contact(colliders, end, i, c)[0] > least


@kernel(empty=False, apart=False)
def strays(colliders, free, at, h, end):
    """Whether an iteration ends with a vertex too deep in a collider that is thick, seen from what its model knew; the
    arguments are those of `meet`. Writes `end`.
    """
    x, y, _, w = at
    combine(1.0, x, h, w, end)
    for c in range(len(colliders.rows)):
        own = colliders.rows[c]
        for i in range(len(y)):
            if own[SHAPE, 0] == MESH and own[LAW, THICKNESS] > 0.0 and free[i]:
                most = STRAY * own[LAW, THICKNESS] + h * CREEP
                if deeper(colliders, i, c, y, end, most):
                    deep = contact(colliders, end, i, c)[0]
                    depth, _, _, n, _, _ = contact(colliders, y, i, c)
                    if deep - max(depth - dot(n, sub(load3(end, i), load3(y, i))), 0.0) > most:
                        return True
    return False


@kernel(empty=None, apart=None)
def carry(colliders, free, at, h, end):
    """Let the next iteration begin with the contacts that pressed in this one and are outside at its end; the arguments
    are those of `strays`.
    """
    x, y, u, w = at
    combine(1.0, x, h, w, end)
    k = colliders.turn[0]
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            depth, _, _, n, _, _ = contact(colliders, y, i, c)
            way = fma(splat(h), load3(u, i), sub(load3(x, i), load3(y, i)))
            if free[i] and counts(colliders, depth, n, c, i, load3(y, i), way):
                presses = depth - dot(n, sub(load3(end, i), load3(y, i))) > 0.0
                colliders.met[k + 1, c, i] = presses and contact(colliders, end, i, c)[0] <= 0.0
