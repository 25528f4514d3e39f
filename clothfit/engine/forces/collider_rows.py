"""Colliders that a cloth slides on, with friction, as rows of `contact`: how deep a vertex is, where to, and how fast
they move.

A vertex at the signed distance δ < d₀ from the surface (`surfaces`), d₀ the thickness, is at the depth d = d₀ − δ. With
the outward normal n, the collider goes past it at y with the velocity V = ċ + W (y − c), W p = ω × p + S p with the
rate S at which it stretches. There dV = W dy, from `surfaces` and `bodies` dδ = n·dy and dn = H dy, H = k P + j t tᵀ,
and ∂F/∂c = −∂F/∂y. The surface of a mesh may also go its own way, which is then a part of V and of dV.

A step that is linearised where it begins, at x, finds colliders where they are at its end. As if they stayed there, and
the cloth came to meet them, it takes a vertex at the point p that x comes to if it goes with the collider, by
V = (p − x)/h: so the depth is that before the step, with its friction, and the surface the one that x lies on.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin, sqrt
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.forces import bodies as meshes
from clothfit.engine.forces.faces import add_along
from clothfit.engine.forces.law import across, block, remaining
from clothfit.engine.forces.spheres import offset_of
from clothfit.engine.forces.surfaces import BOX, CONE, MESH, distance
from clothfit.engine.forces.triangle import BC, B, C
from clothfit.engine.forces.vertex import Vertex
from clothfit.engine.solve.sparse import add_block, outer
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, lane0, lane1, lane2, load3, mul, pack, splat, store3, sub
from clothfit.kernels.vectors import copy, cross, dot

PLACE, VELOCITY, SPIN, AXES, SIZE, RATE, LAW, SHAPE = 0, 1, 2, 3, 6, 7, 8, 9
"""Rows of a collider: c, m; ċ, m/s; ω, 1/s; three unit vectors, its axes; r, s, l of a cone or half of the lengths of a
box, m; how fast it stretches along its axes, 1/s; d₀, m, κ, N/m, and μ; the number of `surfaces`, of a mesh which of
`bodies`, and the share of `Colliders.begin` that is left.
"""

STATE = 8
"""Rows that change as a collider moves."""

NOWHERE = (-1, 0)
"""Triangle and part of a collider that is no mesh."""

CUTS = 12
"""Times that a way is cut to two thirds of it, to see whether it leads through a collider."""

RESTING = 10.0
"""Weights of a vertex that may press it into a collider on which a cloth lies."""

WIDER = 1.0 + 1e-9
"""Factor of the ball about a collider, so that rounding hides no vertex."""

THICKNESS, STIFFNESS, FRICTION = 0, 1, 2
"""Places in the row LAW."""

MANY, SPREAD = 2**31 - 3, 7919
"""Numbers that parts of surfaces are spread over, by this factor."""

NOBODY = np.zeros((0, 0, 4))
"""What of a cloth begins inside of colliders where nothing does."""


class Colliders(NamedTuple):
    """Colliders of a scene but for its plain spheres: one array, as each one that a step carries costs time.

    A scene without them, in which nothing changes, has None in this place, so that nothing is compiled for them.
    """

    rows: Array  # (C, 10, 3)
    on: Flags  # (N, C n), contacts that each iteration of a step only ends in (`contact.update_active`)
    turn: Indices  # (1,), the iteration that is computed
    depth: Array  # (C n,), m, of each vertex at most, where the step was linearised; inf before that
    span: Array  # (2,), h, s, of a step that is linearised where it begins, else 0; and of the last such step
    point: Array  # (C n, 3), m, p of each vertex in such a step, found when it is asked for
    origin: Array  # (C n, 3), m, the x that it belongs to, NaN where it is not known
    posed: Array  # (C, 10, 3), the rows that all p belong to, NaN where meshes have changed since
    bodies: meshes.Bodies  # the meshes
    begin: Array  # (C, n, 4), d, m, and n of each vertex at the start, 0 where it may be pushed at once; or (0, 0, 4)
    release: Array  # (C,), s, in which what begins inside leaves
    load: Array  # (2, C n), N, what pressed each vertex in the step before, −1 where none was; and in this one
    of_load: Array  # (2, C n), the gradient by that, or its change, while derivatives are taken

    @property
    def state(self) -> Array:
        """What changes as they move, (C, 8, 3), not a copy."""
        return self.rows[:, :STATE]

    @property
    def thickness(self) -> Array:
        """d₀, (C,), m."""
        return self.rows[:, LAW, THICKNESS]

    @property
    def stiffness(self) -> Array:
        """κ, (C,), N/m."""
        return self.rows[:, LAW, STIFFNESS]

    @property
    def friction(self) -> Array:
        """μ, (C,)."""
        return self.rows[:, LAW, FRICTION]


def build(
    shape: Sequence[int], law: Sequence[Sequence[float]], state: Array, bodies: meshes.Bodies | None = None,
    count: int = 0, iterations: int = 1, release: Sequence[float] = (),
) -> Colliders:  # fmt: skip
    """So many colliders, C of them, which may be 0: shapes, laws (3,) and the states (C, 8, 3). Those that are meshes
    have the bodies, in this order. `count` and `iterations` are those of the cloth's vertices and its steps.
    """
    rows = np.zeros((len(shape), 10, 3))
    rows[:, :STATE] = state
    for row, number, numbers in zip(rows, shape, law, strict=True):
        row[LAW], row[SHAPE] = numbers, number
    rows[rows[:, SHAPE, 0] == MESH, SHAPE, 1] = np.arange(np.count_nonzero(rows[:, SHAPE, 0] == MESH))
    on, turn = np.zeros((iterations, len(shape) * count), bool), np.zeros(1, np.int32)
    times = np.array(release if len(release) else np.zeros(len(shape)), float)
    depth = np.full(on.shape[1], np.inf)
    span, point, posed = np.zeros(2), np.zeros((on.shape[1], 3)), np.full(rows.shape, np.nan)
    places = span, point, np.full(point.shape, np.nan), posed
    load = np.full((2, on.shape[1]), -1.0)
    kept = NOBODY, times, load, np.zeros_like(load)
    return Colliders(rows, on, turn, depth, *places, bodies or meshes.build([], count), *kept)


def released(colliders: Colliders, vertex: Vertex, x0: Array) -> Colliders:
    """The same colliders for a motion that begins at x0 (n, 3): of those that a free vertex begins inside of, deeper
    than what lies on it presses, what they hold of the cloth is let go over their time.
    """
    if not len(colliders.rows):
        return colliders
    depth, normal = depths(colliders._replace(begin=NOBODY), x0)
    pressed = RESTING * np.linalg.norm(vertex.gravity) * vertex.mass / colliders.stiffness[:, None]
    inside = (depth - colliders.thickness[:, None] > pressed) & vertex.free
    begin = np.concatenate([depth[..., None], normal], axis=2)
    begin[(depth <= 0.0) | ~(inside.any(axis=1) & (colliders.release > 0.0))[:, None]] = 0.0
    return colliders._replace(begin=begin if begin.any() else NOBODY)


@kernel(absent=None)
def let_go(colliders, time):
    """Set what is left of what colliders hold at a time, s, from the start: it goes smoothly to 0; no step begins."""
    colliders.span[0] = 0.0
    if len(colliders.begin) > 0:
        for c in range(len(colliders.rows)):
            colliders.rows[c, SHAPE, 2] = remaining(time, colliders.release[c])


@kernel(absent=False)
def lets_go(colliders):
    """Whether something begins inside, and is let go."""
    return len(colliders.begin) > 0


@kernel
def held(colliders, c, i):
    """How much deeper than the thickness says vertex i may be in collider c, m."""
    return colliders.rows[c, SHAPE, 2] * colliders.begin[c, i, 0] if len(colliders.begin) > 0 else 0.0


def copied(colliders: Colliders) -> Colliders:
    """The same colliders with memory of their own for what changes."""
    names = "rows", "on", "turn", "depth", "span", "point", "origin", "posed", "load", "of_load"
    own = {name: getattr(colliders, name).copy() for name in names}
    return colliders._replace(**own, bodies=meshes.copied(colliders.bodies))


@kernel
def contact(colliders, y, i, c):
    """Depth d (0 or less: no contact), k, j, n and t of vertex i at collider c, and where on a mesh that is: triangle,
    part and weights.
    """
    return touched(colliders, load3(y, i), i, c)


@kernel
def touched(colliders, p, i, c):
    """The same of a vertex at p (lanes)."""
    own = colliders.rows[c]
    delta, k, j, n, t, point = measured(colliders.bodies, own, i, p)
    return own[LAW, THICKNESS] - held(colliders, c, i) - delta, k, j, outward(own, n), outward(own, t), point


@kernel
def measured(bodies, own, i, y_i):
    """What `surfaces.distance` gives in the axes of a collider for vertex i at y_i, and the place on a mesh."""
    p = seen(own, y_i)
    if own[SHAPE, 0] == MESH:
        return meshes.distance(bodies, int(own[SHAPE, 1]), i, p)
    delta, k, j, n, t = distance(int(own[SHAPE, 0]), own[SIZE], lane0(p), lane1(p), lane2(p))
    return delta, k, j, n, t, (-1, 0, 0.0, 0.0)


@kernel
def seen(own, y_i):
    """A point from the centre of a collider, in its axes."""
    return inward(own, sub(y_i, load3(own, PLACE)))


@kernel
def inward(own, v):
    """The components of v along the axes of a collider."""
    return pack(dot(load3(own, AXES), v), dot(load3(own, AXES + 1), v), dot(load3(own, AXES + 2), v), 0.0)


@kernel
def outward(own, v):
    """v₀ a + v₁ b + v₂ e, with the axes of a collider."""
    a, b, e = load3(own, AXES), load3(own, AXES + 1), load3(own, AXES + 2)
    return fma(splat(lane2(v)), e, fma(splat(lane1(v)), b, mul(splat(lane0(v)), a)))


@kernel
def count(colliders, y):
    return len(colliders.rows) * len(y)


@kernel
def row(colliders, y, k):
    c = k // len(y)
    i = k - c * len(y)
    p = place(colliders, y, k)
    depth, curve, bend, n, t, point = touched(colliders, p, i, c)
    kappa, mu = colliders.rows[c, LAW, STIFFNESS], colliders.rows[c, LAW, FRICTION]
    if is_carried(colliders, c):
        away = sub(p, load3(colliders.rows[c], PLACE))
        V = swollen(colliders.rows[c], away, mul(splat(-1.0 / colliders.span[0]), behind(colliders, y, k)))
    else:
        V = surface_velocity(colliders, p, c, point)
    return (i, i, i, i), (1.0, 0.0, 0.0, 0.0), n, depth, kappa, mu, V, (c, 1.0, curve, bend, t, point)


@kernel
def level(colliders, y, k):
    """κ, and how deep a vertex is at y, wherever the step is linearised; far away 0."""
    c = k // len(y)
    i, own = k - c * len(y), colliders.rows[c]
    may = bound(colliders.bodies, own, i, load3(y, i)) > 0.0
    return own[LAW, STIFFNESS], contact(colliders, y, i, c)[0] if may else 0.0


@kernel
def place(colliders, y, k):
    """Where a vertex is linearised: in a step that is linearised where it begins, at y, where it is carried to."""
    c = k // len(y)
    i = k - c * len(y)
    y_i = load3(y, i)
    if not colliders.span[0] > 0.0:
        return y_i
    if not is_placed(colliders, y_i, k):
        store3(carried(colliders, c, i, y_i)[0], colliders.point, k)
        store3(y_i, colliders.origin, k)
    return load3(colliders.point, k)


@kernel
def is_placed(colliders, y_i, k):
    """Whether it is known where a vertex at y_i (lanes) is carried to."""
    x = colliders.origin[k]
    return x[0] == lane0(y_i) and x[1] == lane1(y_i) and x[2] == lane2(y_i)


@kernel
def about(colliders, y, k):
    """That place or, where it takes a search that may not be needed, one that is near; and how far from it at most, m.
    """
    c = k // len(y)
    own, y_i, h = colliders.rows[c], load3(y, k - c * len(y)), colliders.span[0]
    if h > 0.0 and follows_mesh(own, colliders.bodies) and not is_placed(colliders, y_i, k):
        return led_rigidly(own, y_i, h), h * colliders.bodies.fastest[int(own[SHAPE, 1])]
    return place(colliders, y, k), 0.0


@kernel
def behind(colliders, y, k):
    """How far y is behind that."""
    return sub(load3(y, k % len(y)), place(colliders, y, k))


@kernel(absent=None)
def begin(colliders, h):
    """Linearise where a step begins that is h long; with 0 at y, wherever that is."""
    colliders.span[0] = h
    if h > 0.0:
        same = h == colliders.span[1]
        for j in range(colliders.rows.size):
            same = same and colliders.rows.flat[j] == colliders.posed.flat[j]
        if not same:
            colliders.span[1] = h
            for c in range(len(colliders.rows)):
                copy(colliders.rows[c], colliders.posed[c])
            for k in range(len(colliders.origin)):
                colliders.origin[k, 0] = np.nan


@kernel
def carried(colliders, c, i, x_i):
    """Where vertex i comes to that is at x_i and goes with collider c, but for what round ones grow; and of a mesh that
    changes the triangles, and the parts of them, that were looked for to find with which it goes, else −1.
    """
    own, bodies, h = colliders.rows[c], colliders.bodies, colliders.span[0]
    if not moves(own, bodies):
        return x_i, (NOWHERE, NOWHERE, NOWHERE)
    base = led_rigidly(own, x_i, h)
    if not follows_mesh(own, bodies):
        return base, (NOWHERE, NOWHERE, NOWHERE)
    p, first = followed(bodies, own, i, base, base, h)
    p, second = followed(bodies, own, i, base, p, h)
    if second == first:
        return p, (first, second, NOWHERE)
    p, third = followed(bodies, own, i, base, p, h)
    return p, (first, second, third)


@kernel
def led_rigidly(own, x_i, h):
    """Where that is but for what the triangles of a mesh move in its axes."""
    centre = load3(own, PLACE)
    from_centre = turned(own, sub(fma(splat(h), load3(own, VELOCITY), x_i), centre), h)
    return add(centre, widened(own, from_centre, h))


@kernel
def follows_mesh(own, bodies):
    """Whether a collider is a mesh that changes."""
    return own[SHAPE, 0] == MESH and bodies.moves[int(own[SHAPE, 1])]


@kernel
def followed(bodies, own, i, base, p, h):
    """Where vertex i comes to from `base` with the point of a changing mesh that is nearest to p; and that's triangle
    and part.
    """
    f, part, wb, wc = meshes.nearest(bodies, int(own[SHAPE, 1]), i, seen(own, p))
    return fma(splat(h), outward(own, meshes.drift(bodies, f, wb, wc)), base), (f, part)


@kernel
def is_carried(colliders, c):
    """Whether collider c takes vertices to where the step is linearised."""
    return colliders.span[0] > 0.0 and moves(colliders.rows[c], colliders.bodies)


@kernel
def moves(own, bodies):
    """Whether a collider moves in the step, or a box of it grows, or its mesh changes."""
    if own[SHAPE, 0] == BOX and grows(own):
        return True
    if follows_mesh(own, bodies):
        return True
    V, W = load3(own, VELOCITY), load3(own, SPIN)
    return dot(V, V) + dot(W, W) > 0.0


@kernel
def turned(own, v, h):
    """v turned as a collider turns in h (Rodrigues' formula)."""
    omega = load3(own, SPIN)
    square = dot(omega, omega)
    if square == 0.0:
        return v
    angle, about = sqrt(square) * h, cross(omega, v)
    more = mul(splat((1.0 - cos(angle)) / square), cross(omega, about))
    return add(v, fma(splat(sin(angle) / sqrt(square)), about, more))


@kernel
def widened(own, v, h):
    """v as a box that grows stretches it in h; it is its own transpose."""
    if own[SHAPE, 0] != BOX or not grows(own):
        return v
    more = pack(1.0 / (1.0 - h * own[RATE, 0]), 1.0 / (1.0 - h * own[RATE, 1]), 1.0 / (1.0 - h * own[RATE, 2]), 0.0)
    return outward(own, mul(more, inward(own, v)))


@kernel
def grows(own):
    """Whether a collider grows or shrinks."""
    return own[RATE, 0] != 0.0 or own[RATE, 1] != 0.0 or own[RATE, 2] != 0.0


@kernel
def most(colliders, y, k):
    """How deep a vertex is at most where it is linearised, and as far from `about` that as it may be."""
    at, slack = about(colliders, y, k)
    return bound(colliders.bodies, colliders.rows[k // len(y)], k % len(y), at) + 2.0 * slack


@kernel
def load(colliders, k):
    """What pressed a vertex in the step before, N, and the gradients or changes of that and of what presses it now."""
    return colliders.load[0, k], colliders.of_load[0, k], colliders.of_load[1, k]


@kernel
def give_load(colliders, k, by_load):
    colliders.of_load[0, k] += by_load


@kernel
def thick(colliders, y, k):
    """d₀."""
    return colliders.rows[k // len(y), LAW, THICKNESS]


@kernel
def bound(bodies, own, i, p):
    """How deep a point of vertex i is at most, by a ball about the collider, or by what is known of a mesh; unknown in
    there.
    """
    shape, size = int(own[SHAPE, 0]), own[SIZE]
    if shape == MESH:
        away = meshes.beyond(bodies, int(own[SHAPE, 1]), i, seen(own, p))
        return own[LAW, THICKNESS] - away if away > 0.0 else np.inf
    if shape == BOX:
        reach = size[0] + size[1] + size[2]
    elif shape == CONE:
        reach = max(size[0], size[1]) + 0.5 * size[2]
    else:
        return np.inf
    away = sub(p, load3(own, PLACE))
    return WIDER * reach + own[LAW, THICKNESS] - sqrt(dot(away, away))


@kernel
def is_far(colliders, y, k, way, depth):
    """Whether a step by `way` from y surely does not know a vertex that is so deep at most where it is linearised."""
    if not depth < 0.0 or colliders.on[colliders.turn[0], k]:
        return False
    way = add(way, sub(load3(y, k % len(y)), about(colliders, y, k)[0]))
    return dot(way, way) < depth * depth


@kernel
def knows(colliders, y, k, found, way):
    """Whether a step by `way` knows a vertex: inside, met, or about to enter, seen from where it is linearised."""
    (i, _, _, _), _, n, depth, _, _, _, more = found
    if depth > 0.0 or colliders.on[colliders.turn[0], k]:
        return True
    if depth - dot(n, way) <= 0.0:
        return False
    c, y_i = more[0], place(colliders, y, k)
    bodies, own, slack = colliders.bodies, colliders.rows[c], held(colliders, c, i)
    least = own[LAW, THICKNESS] - slack
    if own[SHAPE, 0] != MESH:
        return lowest(own, y_i, way) < least
    if measured(bodies, own, i, add(y_i, way))[0] < least:
        return True
    return slack == 0.0 and meshes.crosses(bodies, int(own[SHAPE, 1]), seen(own, y_i), seen(own, add(y_i, way)))


@kernel
def lay(colliders, k, found, push, rub, turn, sign, A):
    (i, _, _, _), _, n, _, _, _, _, (_, _, curve, bend, t, _) = found
    low, high = block(sign * push, sign * rub - (turn * curve if turn > 0.0 else 0.0), n)
    add_block(A.diagonal, i, low, high)
    if turn > 0.0 and bend != 0.0:
        low, high = outer(mul(splat(-turn * bend), t), t)
        add_block(A.diagonal, i, low, high)


@kernel
def is_open(colliders, k):
    """Whether a vertex is outside where the step is linearised; of others nothing changes in it."""
    return colliders.depth[k] <= 0.0


@kernel
def is_reached(colliders, k, free, y, end, least):
    """Whether a vertex is met, or ends deeper than that."""
    c = k // len(y)
    i = k - c * len(y)
    return free[i] and (colliders.on[colliders.turn[0], k] or deeper(colliders, i, c, y, end, least))


@kernel
def deeper(colliders, i, c, y, end, least):
    """Whether vertex i ends deeper in collider c than that: distances fall no faster than it goes on."""
    depth, way = colliders.depth[c * len(y) + i], sub(load3(end, i), about(colliders, y, c * len(y) + i)[0])
    if depth <= least and dot(way, way) <= (least - depth) * (least - depth):
        return False
    return contact(colliders, end, i, c)[0] > least


@kernel
def may_change(colliders, k, found, presses, at, end, h):
    """Whether a vertex is not known for any other reason than that it is met."""
    on = colliders.on[colliders.turn[0], k]
    return on or not knows(colliders, at[1], k, found, led_by(colliders, k, at, h))


@kernel
def led_by(colliders, k, at, h):
    """From where a vertex is linearised to where u leads it; `at` as for `contact.update_active`."""
    x, y, u, _ = at
    i = k % len(x)
    return fma(splat(h), load3(u, i), sub(load3(x, i), place(colliders, y, k)))


@kernel
def pass_on(colliders, k, free, at, h, end):
    """Whether a vertex presses, and is outside at its end."""
    x, y, u, _ = at
    way = fma(splat(h), load3(u, k % len(y)), sub(load3(x, k % len(y)), load3(y, k % len(y))))
    if is_far(colliders, y, k, way, min(colliders.depth[k], most(colliders, y, k))):
        return False
    found = row(colliders, y, k)
    (i, _, _, _), _, n, depth, _, _, _, more = found
    if not (free[i] and knows(colliders, at[1], k, found, led_by(colliders, k, at, h))):
        return False
    presses = depth - dot(n, sub(load3(end, i), place(colliders, at[1], k))) > 0.0
    return presses and contact(colliders, end, i, more[0])[0] <= 0.0


@kernel
def changes(colliders, y, found, dy, direction):
    (i, _, _, _), _, n, _, _, _, _, (c, _, curve, bend, t, point) = found
    offset = offset_of(direction)
    away = sub(load3(dy, i), offset)
    dy_i = carried_change(colliders, c, i, y, away)
    dn = fma(splat(curve), across(n, dy_i), mul(splat(bend * dot(t, dy_i)), t))
    lag, own = sub(away, dy_i), colliders.rows[c]
    if is_carried(colliders, c):
        dV = swollen(own, dy_i, mul(splat(-1.0 / colliders.span[0]), lag))
    else:
        dV = surface_change(colliders.bodies, own, point, dy_i)
    ddelta = dot(n, dy_i) + held_change(colliders, c, i, offset)
    return (0.0, 0.0, 0.0, 0.0), dn, ddelta, dV, 0.0, lag


@kernel
def add_back(colliders, found, vectors, by_law, at, h, grad, gy):
    (i, _, _, _), _, n, _, _, _, _, (c, _, curve, bend, t, point) = found
    by_n, by_U, by_S, by_Z, _ = vectors
    own = colliders.rows[c]
    by_y = fma(splat(curve), across(n, by_n), mul(splat(bend * dot(t, by_n)), t))
    by_y, by_V = fma(splat(by_law[0]), n, by_y), add(by_U, by_Z)  # but for the sign
    if is_carried(colliders, c):
        lag = fma(splat(1.0 / colliders.span[0]), by_V, by_S)
        by_p = sub(sub(by_y, swollen(own, by_V, splat(0.0))), lag)
        by_y = add(lag, carried_gradient(colliders, c, i, at[0], by_p))
    else:
        by_y = sub(by_y, surface_gradient(colliders.bodies, own, point, by_V))
    add_along(gy, i, h, by_y)
    if len(grad.offset) > 0:
        grad.offset[0] -= h * lane0(by_y)
        grad.offset[1] -= h * lane1(by_y)
        grad.offset[2] -= h * lane2(by_y)
        if len(colliders.begin) > 0:
            for axis in range(3):  # what is held begins deeper
                grad.offset[axis] += h * by_law[0] * own[SHAPE, 2] * colliders.begin[c, i, 1 + axis]


@kernel
def carried_change(colliders, c, i, y, dy):
    """The change of where vertex i is linearised for one of y, both less than how far the colliders are moved."""
    if not is_carried(colliders, c):
        return dy
    h, own, bodies = colliders.span[0], colliders.rows[c], colliders.bodies
    feet, dy = carried(colliders, c, i, load3(y, i))[1], widened(own, turned(own, dy, h), h)
    dp = dy
    for f, part in feet:
        if f >= 0:
            dp = fma(splat(h), outward(own, meshes.drift_change(bodies, f, part, inward(own, dp))), dy)
    return dp


@kernel
def carried_gradient(colliders, c, i, y, by_p):
    """The transpose."""
    h, own, bodies = colliders.span[0], colliders.rows[c], colliders.bodies
    feet = carried(colliders, c, i, load3(y, i))[1]
    by_y = by_p
    for f, part in (feet[2], feet[1], feet[0]):
        if f >= 0:
            by_p = mul(splat(h), outward(own, meshes.drift_gradient(bodies, f, part, inward(own, by_p))))
            by_y = add(by_y, by_p)
    return turned(own, widened(own, by_y, h), -h)


@kernel
def leaving(colliders, found, begin):
    """How fast a collider pushes out what it held of a vertex, in the step from a time, s, m/s."""
    if len(colliders.begin) == 0:
        return 0.0
    (time, h), c = begin, found[7][0]
    held_then = remaining(time, colliders.release[c]) - colliders.rows[c, SHAPE, 2]
    return held_then / h * colliders.begin[c, found[0][0], 0]


@kernel
def lowest(own, y_i, way):
    """The least distance of a convex collider on the way from y_i, roughly: it is a convex function along it."""
    low, high, least = 0.0, 1.0, away_from(own, add(y_i, way))
    for _ in range(CUTS):
        one, other = low + (high - low) / 3.0, high - (high - low) / 3.0
        first = away_from(own, fma(splat(one), way, y_i))
        second = away_from(own, fma(splat(other), way, y_i))
        least = min(least, min(first, second))
        if first < second:
            high = other
        else:
            low = one
    return least


@kernel
def away_from(own, y_i):
    """The distance of a point from a collider that is no mesh."""
    p = seen(own, y_i)
    return distance(int(own[SHAPE, 0]), own[SIZE], lane0(p), lane1(p), lane2(p))[0]


@kernel(absent=False)
def some_grow(colliders):
    """Whether a collider grows or shrinks."""
    found = False
    for c in range(len(colliders.rows)):
        found = found or grows(colliders.rows[c])
    return found


@kernel
def stretched(own, away, V):
    """V, and the velocity with which a collider that grows moves what is `away` from its centre; it is its own
    transpose.
    """
    if not grows(own):
        return V
    return add(V, outward(own, mul(load3(own, RATE), inward(own, away))))


@kernel
def swollen(own, away, V):
    """The same where `carried` has that of boxes in V."""
    return V if own[SHAPE, 0] == BOX else stretched(own, away, V)


@kernel
def surface_change(bodies, own, point, dy):
    """dV."""
    dV = stretched(own, dy, cross(load3(own, SPIN), dy))
    f, part, _, _ = point
    return add(dV, outward(own, meshes.drift_change(bodies, f, part, inward(own, dy)))) if f >= 0 else dV


@kernel
def surface_gradient(bodies, own, point, by_v):
    """The gradient by y, for one by V."""
    by_y = stretched(own, by_v, cross(by_v, load3(own, SPIN)))
    f, part, _, _ = point
    return add(by_y, outward(own, meshes.drift_gradient(bodies, f, part, inward(own, by_v)))) if f >= 0 else by_y


@kernel
def surface_velocity(colliders, p, c, point):
    """V of collider c at p (lanes)."""
    own, (f, _, wb, wc) = colliders.rows[c], point
    away = sub(p, load3(own, PLACE))
    V = stretched(own, away, add(load3(own, VELOCITY), cross(load3(own, SPIN), away)))
    return add(V, outward(own, meshes.drift(colliders.bodies, f, wb, wc))) if f >= 0 else V


@kernel
def depths(colliders, y):
    """Depth (C, n), m, 0 or less outside, and normal (C, n, 3) of points y (n, 3)."""
    depth, normal = np.zeros((len(colliders.rows), len(y))), np.zeros((len(colliders.rows), len(y), 3))
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            depth[c, i], _, _, n, _, _ = contact(colliders, y, i, c)
            store3(n, normal[c], i)
    return depth, normal


@kernel
def fill_parts(colliders, y, out):
    """out (C, n) = a number for the part of each collider's surface that points y (n, 3) are nearest to, on which the
    normal bends smoothly: a face, an edge or a corner, of a mesh its vertices, one end or the mantle of a round cone.
    """
    for c in range(len(colliders.rows)):
        own = colliders.rows[c]
        for i in range(len(y)):
            _, k, j, n, _, (f, part, wb, wc) = measured(colliders.bodies, own, i, load3(y, i))
            number = (1 if k != 0.0 else 0) + (2 if j != 0.0 else 0)
            if own[SHAPE, 0] == BOX:
                number += 4 * int(13 + np.sign(lane0(n)) + 3 * np.sign(lane1(n)) + 9 * np.sign(lane2(n)))
            if f >= 0:
                weights = 0.0 if part in (BC, B, C) else 1.0, wb, wc
                for e in range(3):
                    if weights[e] > 0.0:
                        mixed = (1 + colliders.bodies.triangles[f, e]) * SPREAD
                        number += (mixed ^ (mixed >> 7)) * SPREAD % MANY  # so that sums of others are others
            out[c, i] = number % MANY


@kernel
def held_change(colliders, c, i, offset):
    """The change of `held` where all colliders move by an offset."""
    if len(colliders.begin) == 0:
        return 0.0
    begin = colliders.begin[c, i]
    return colliders.rows[c, SHAPE, 2] * dot(pack(begin[1], begin[2], begin[3], 0.0), offset)
