"""Closed triangle meshes as surfaces of colliders: signed distances, and how the nearest point moves with another.

The nearest point q of a surface to a point p is found with a tree of boxes (`boxes`), from the triangle on that was the
nearest one before. Which triangle that was changes the time but no bit: of several at one distance the first counts.
The sign is that of (p − q)·N with the angle-weighted pseudonormal N of the part of the surface that q is on: of a face
its normal, of an edge the sum of those of its two faces, of a corner the sum of the normals of its faces times their
angles there (J. A. Bærentzen, H. Aanæs, IEEE Trans. Vis. Comput. Graph. 11, 243, 2005).

A surface may change over time: its vertices go on paths of their own (`inputs.poses`), and q moves with the mean of
their velocities that q is the mean of. V vertices and T triangles of all meshes together.
"""

from __future__ import annotations

from math import acos, sqrt
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.forces import boxes, triangle
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import (
    add,
    fma,
    lane0,
    lane1,
    lane2,
    load3,
    mul,
    pack,
    splat,
    store3,
    sub,
    where_less,
)
from clothfit.kernels.vectors import cross, dot

NEAR = 1.0 - 1e-9
"""Boxes count as nearer by this factor, so that rounding hides no triangle."""


class Bodies(NamedTuple):
    """B closed meshes, one after another, in the axes of their colliders."""

    place: Array  # (V, 3), m, of the vertices
    velocity: Array  # (V, 3), m/s, in these axes
    triangles: Indices  # (T, 3), leaf by leaf, facing outward
    across: Indices  # (T, 3), the triangle behind the sides AB, BC and CA
    face: Array  # (T, 3), unit normals
    corner: Array  # (V, 3), angle-weighted normals
    tree: boxes.Tree
    vertex: Indices  # (B + 1,), the first vertex of each mesh
    triangle: Indices  # (B + 1,), the first triangle
    node: Indices  # (B + 1,), the first node
    moves: Flags  # (B,), whether their vertices go their own way
    last: Indices  # (B, n), the nearest triangle of each vertex of the cloth when it was last looked for
    asked: Array  # (B, n, 2, 3), m, the points that it was looked for of late, NaN where a mesh was another since then
    found: Indices  # (B, n, 3), the nearest triangles to these, and which of both is the newer one
    clear: Array  # (B, n, 4), m, a point outside that each vertex had, and the least distance of the surface from there
    fastest: Array  # (B,), m/s, of the vertices of each mesh


class Surface(NamedTuple):
    """A closed mesh."""

    place: Array  # (V, 3), m
    triangles: Indices  # (T, 3), facing outward; every edge is a side of two
    across: Indices  # (T, 3), the triangle behind the sides AB, BC and CA


def build(surfaces: list[Surface], count: int) -> Bodies:
    """Bodies of these surfaces, which may be none, for a cloth of so many vertices."""
    nothing = np.zeros((0, 3), np.int32)
    trees, triangles, across, places = [boxes.empty(0)], [nothing], [nothing], [np.zeros((0, 3))]
    vertex, face, node = (np.zeros(len(surfaces) + 1, np.int32) for _ in range(3))
    for i, each in enumerate(surfaces):
        tree, order = boxes.build(each.place[each.triangles].mean(axis=1))
        back = np.empty(len(order), np.int32)
        back[order] = np.arange(len(order))
        trees.append(tree._replace(skip=tree.skip + node[i], first=tree.first + face[i], last=tree.last + face[i]))
        triangles.append(each.triangles[order] + vertex[i])
        across.append(back[each.across[order]] + face[i])
        vertex[i + 1], face[i + 1] = vertex[i] + len(each.place), face[i] + len(order)
        node[i + 1] = node[i] + len(tree.skip)
        places.append(each.place)
    place = np.concatenate(places).astype(float)
    whole = boxes.Tree(*(np.concatenate(parts) for parts in zip(*trees, strict=True)))
    corners = np.concatenate(triangles).astype(np.int32)
    last = np.repeat(face[:-1, None], count, axis=1)
    made = Bodies(
        place, np.zeros_like(place), corners, np.concatenate(across).astype(np.int32), np.zeros((len(corners), 3)),
        np.zeros_like(place), whole, vertex, face, node,
        np.zeros(len(surfaces), bool), last, np.full((*last.shape, 2, 3), np.nan), np.zeros((*last.shape, 3), np.int32),
        np.zeros((*last.shape, 4)), np.zeros(len(surfaces)),
    )  # fmt: skip
    for b in range(len(surfaces)):
        arrange(made, b)
    return made


def copied(bodies: Bodies) -> Bodies:
    """The same bodies with memory of their own for what changes."""
    names = "place", "velocity", "face", "corner", "moves", "last", "asked", "found", "clear", "fastest"
    own = {name: getattr(bodies, name).copy() for name in names}
    return bodies._replace(**own, tree=bodies.tree._replace(box=bodies.tree.box.copy()))


@kernel
def arrange(bodies, b):
    """Set the normals and the boxes of body b where its vertices are."""
    for v in range(bodies.vertex[b], bodies.vertex[b + 1]):
        store3(splat(0.0), bodies.corner, v)
    for f in range(bodies.triangle[b], bodies.triangle[b + 1]):
        corners = bodies.triangles[f]
        a, b_, c = load3(bodies.place, corners[0]), load3(bodies.place, corners[1]), load3(bodies.place, corners[2])
        n = unit(cross(sub(b_, a), sub(c, a)))
        store3(n, bodies.face, f)
        add_angle(bodies.corner, corners[0], sub(b_, a), sub(c, a), n)
        add_angle(bodies.corner, corners[1], sub(c, b_), sub(a, b_), n)
        add_angle(bodies.corner, corners[2], sub(a, c), sub(b_, c), n)
    boxes.refit(bodies.tree, bodies.node[b], bodies.node[b + 1], bodies.triangles, bodies.place, bodies.place)
    bodies.asked[b] = np.nan


@kernel
def add_angle(corner, v, e, g, n):
    """Add to the normal of vertex v that of a face, n, times the angle between its sides e and g."""
    cosine = dot(e, g) / sqrt(dot(e, e) * dot(g, g))
    store3(fma(splat(acos(min(max(cosine, -1.0), 1.0))), n, load3(corner, v)), corner, v)


@kernel
def unit(v):
    """v/|v|."""
    return mul(splat(1.0 / sqrt(dot(v, v))), v)


@kernel
def nearest(bodies, b, i, p):
    """The triangle of body b that is nearest to a point (lanes) of vertex i, the part of it, and the weights w_b, w_c
    (`triangle`). A step asks for the same points again and again.
    """
    asked, found = bodies.asked[b, i], bodies.found[b, i]
    for k in range(2):
        if asked[k, 0] == lane0(p) and asked[k, 1] == lane1(p) and asked[k, 2] == lane2(p):
            found[2] = k
            part, wb, wc, _ = nearest_part(bodies, found[k], p)
            return int(found[k]), part, wb, wc
    tree, best = bodies.tree, int(bodies.last[b, i])
    part, wb, wc, least = nearest_part(bodies, best, p)
    node, end = bodies.node[b], bodies.node[b + 1]
    while node < end:
        if boxes.gap(tree.box[node], p) * NEAR > least:
            node = tree.skip[node]
            continue
        for f in range(tree.first[node], tree.last[node]):
            other, other_b, other_c, square = nearest_part(bodies, f, p)
            if square < least or (square == least and f < best):
                best, part, wb, wc, least = f, other, other_b, other_c, square
        node += 1
    older = 1 - found[2]
    bodies.last[b, i], found[older], found[2] = best, best, older
    store3(p, asked, older)
    return best, part, wb, wc


@kernel
def beyond(bodies, b, i, p):
    """How far a point (lanes) of vertex i is outside of body b, at least: from the box about it, or from where the
    vertex was when that was found; 0 where neither is known.
    """
    gap = NEAR * sqrt(boxes.gap(bodies.tree.box[bodies.node[b]], p))
    way = sub(p, load3(bodies.clear[b], i))
    return max(gap, bodies.clear[b, i, 3] - sqrt(dot(way, way)) / NEAR)


@kernel
def set_clear(bodies, b, i, p, delta):
    """Note that the distance of a point (lanes) of vertex i is delta."""
    store3(p, bodies.clear[b], i)
    bodies.clear[b, i, 3] = NEAR * max(delta, 0.0)


@kernel
def corners(bodies, field, f):
    """The rows of a field (V, 3) at the corners of triangle f."""
    own = bodies.triangles[f]
    return load3(field, own[0]), load3(field, own[1]), load3(field, own[2])


@kernel
def nearest_part(bodies, f, p):
    """The part of triangle f nearest to p, its weights, and the square of the distance, m²."""
    a, b, c = corners(bodies, bodies.place, f)
    part, wb, wc = triangle.nearest(p, a, b, c)
    away = sub(p, triangle.weighted(wb, wc, a, b, c))
    return part, wb, wc, dot(away, away)


@kernel
def pseudonormal(bodies, f, part):
    """N of a part of triangle f, not of length 1 where that is an edge or a corner."""
    if part == triangle.FACE:
        return load3(bodies.face, f)
    if part <= triangle.CA:
        return add(load3(bodies.face, f), load3(bodies.face, bodies.across[f, part - triangle.AB]))
    return load3(bodies.corner, bodies.triangles[f, part - triangle.A])


@kernel
def distance(bodies, b, i, p):
    """δ, k, j, n and t, as those of `surfaces`, of body b at a point (lanes) of vertex i in its axes; then where the
    nearest point is: triangle, part and weights.
    """
    f, part, wb, wc = nearest(bodies, b, i, p)
    a, b_, c = corners(bodies, bodies.place, f)
    n, t = pseudonormal(bodies, f, part), pack(1.0, 0.0, 0.0, 0.0)
    if part == triangle.FACE:
        delta = dot(n, sub(p, a))
        set_clear(bodies, b, i, p, delta)
        return delta, 0.0, 0.0, n, t, (f, part, wb, wc)
    away = sub(p, triangle.weighted(wb, wc, a, b_, c))
    delta = sqrt(dot(away, away))
    if delta == 0.0:
        return 0.0, 0.0, 0.0, unit(n), t, (f, part, wb, wc)
    if dot(n, away) < 0.0:
        delta = -delta
    set_clear(bodies, b, i, p, delta)
    if part <= triangle.CA:
        t = unit(triangle.edge(part, a, b_, c))
    j = -1.0 / delta if part <= triangle.CA else 0.0
    return delta, 1.0 / delta, j, mul(splat(1.0 / delta), away), t, (f, part, wb, wc)


@kernel
def crosses(bodies, b, p, q):
    """Whether the way from p to q (lanes) enters body b through a triangle."""
    tree, node, end = bodies.tree, bodies.node[b], bodies.node[b + 1]
    way, still = (where_less(p, q, p, q), where_less(p, q, q, p)), (splat(0.0), splat(0.0))
    while node < end:
        if not boxes.meet(boxes.bounds(tree.box[node]), way, still):
            node = tree.skip[node]
            continue
        for f in range(tree.first[node], tree.last[node]):
            if enters(bodies, f, p, q):
                return True
        node += 1
    return False


@kernel
def enters(bodies, f, p, q):
    """Whether the way from p to q enters through triangle f."""
    a, b, c = corners(bodies, bodies.place, f)
    n, way = load3(bodies.face, f), sub(q, p)
    if not dot(n, sub(p, a)) >= 0.0 > dot(n, sub(q, a)):
        return False
    e, g, m = sub(a, p), sub(b, p), sub(c, p)
    volumes = dot(way, cross(e, g)), dot(way, cross(g, m)), dot(way, cross(m, e))
    return max(volumes) <= 0.0


@kernel
def drift(bodies, f, wb, wc):
    """The velocity of a point of triangle f in the body's axes, m/s."""
    a, b, c = corners(bodies, bodies.velocity, f)
    return triangle.weighted(wb, wc, a, b, c)


@kernel
def drift_change(bodies, f, part, dp):
    """The change of that velocity where the point goes with the nearest one to a point that changes by dp."""
    by_b, by_c = slopes(bodies, f, part)
    a, b, c = corners(bodies, bodies.velocity, f)
    return triangle.moved(by_b, by_c, dp, a, b, c)


@kernel
def drift_gradient(bodies, f, part, by_drift):
    """The transpose: the gradient by the point, for one by the velocity."""
    by_b, by_c = slopes(bodies, f, part)
    a, b, c = corners(bodies, bodies.velocity, f)
    return fma(splat(dot(sub(c, a), by_drift)), by_c, mul(splat(dot(sub(b, a), by_drift)), by_b))


@kernel
def slopes(bodies, f, part):
    """The gradients of the weights by the point."""
    a, b, c = corners(bodies, bodies.place, f)
    return triangle.weight_gradients(part, a, b, c)
