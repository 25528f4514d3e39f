"""Which pairs of a cloth are near each other, and which would pass through each other on their way.

A pair has a number: v T + t for vertex v and triangle t of T, and beyond those n T + e E + f for edges e < f of E.
Pairs that share a vertex do not count, nor do those of fixed vertices only. The thickness of a pair is that of the
cloth, or less: the distance that it has at the start, half of that where an edge joins the two. What lies together at
the start, a seam that is not welded, does not touch. What crosses there is let through for a while, and drawn back.

Along straight ways, x + t (x' − x), the distance of a pair falls no faster than its vertices move past each other: so
far it may go at once, and then look again (conservative advancement). A pair whose distance falls below a tenth of what
it was, or of the thickness, is about to pass through. Reference: B. Mirtich, Impulse-based dynamic simulation of rigid
body systems, PhD thesis, 1996, section 2.3.

Both are looked for where boxes overlap (`boxes`), in time about proportional to what is found.
"""

from __future__ import annotations

from functools import partial
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.eigen import connected_components
from clothfit.engine.forces.boxes import Parts, overlapping, parts
from clothfit.engine.forces.law import remaining
from clothfit.engine.forces.selfcontact import nearest
from clothfit.engine.forces.selfcontact.nearest import CORNER, EDGE, LEFT, distance, past_each_other
from clothfit.engine.forces.selfcontact.rows import Contact
from clothfit.engine.solve.sparse import MULTIGRID_FROM
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import mul, splat
from clothfit.kernels.parallel import together
from clothfit.kernels.vectors import dot

FASTEST = 0.5
"""Speed, m/s, with which what crosses at the start is drawn back, at most."""

APART, BESIDE, CROSSING, THROUGH = 0, 1, 2, 3
"""Where a vertex starts: in a piece of cloth that crosses nothing; elsewhere in one that does; in an edge or a triangle
that crosses; on the wrong side.
"""

FLAT = 1e-9
"""Height of the ends of an edge over a triangle, relative to its length, that may be rounding in a flat cloth."""

class Surface(NamedTuple):
    """What of a cloth can touch: n vertices, T triangles, E edges; its law and its start."""

    triangles: Indices  # (T, 3)
    edges: Indices  # (E, 2), of the triangles, ascending
    start: Array  # (n, 3), m
    free: Array  # (n,), 1 of free vertices, else 0
    first: Indices  # (n + 1,): vertex i is joined by edges to
    neighbours: Indices  # neighbours[first[i]] … neighbours[first[i + 1] − 1]
    points: Parts  # the vertices, the edges and the triangles as what may overlap
    lines: Parts
    faces: Parts
    thickness: float  # m
    stiffness: float  # κ, N/m
    friction: float  # μ
    release: float  # s, in which what passes through another part at the start goes back
    crossed: npt.NDArray[np.int8]  # (n,), how far a vertex is where parts cross at the start: APART … THROUGH
    drawn: npt.NDArray[np.int64]  # (D,), pairs, ascending, that are drawn back to the other side,
    side: Array  # (D,), 1 or −1, which one that is,
    beyond: Array  # (D,), and how far from it they are at the start, m
    patches: npt.NDArray[np.int32]  # (D, K), the triangles along which they may slide
    left: float = 0.0  # the share of `beyond` that is left in a step, 1 at the start


def surface(triangles: Indices, start: Array, fixed: Flags, law: tuple[float, float, float, float]) -> Surface:
    """The surface of a cloth with so many triangles, at these positions (n, 3) at the start, with a thickness, m, a
    stiffness, N/m, a coefficient of friction, and a time of release, s.
    """
    n = len(start)
    sides = np.sort(np.concatenate([triangles[:, :2], triangles[:, 1:], triangles[:, ::2]]), axis=1)
    edges = np.unique(sides, axis=0).astype(np.int32).reshape(-1, 2)
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    first = np.searchsorted(both[:, 0], np.arange(n + 1)).astype(np.int32)
    shape = np.array(triangles, np.int32, order="C"), np.ascontiguousarray(edges)  # what is read-only is another type
    free = np.where(fixed, 0.0, 1.0)
    neighbours, nobody = np.ascontiguousarray(both[:, 1]), np.zeros(0, np.int64)
    points = np.arange(n, dtype=np.int32)[:, None]
    fabric = *shape, np.array(start, float), free, first, neighbours
    trees = parts(points, start), parts(shape[1], start), parts(shape[0], start)
    none, patches = np.zeros(0), np.zeros((0, 1), np.int32)
    made = Surface(*fabric, *trees, *law, np.zeros(n, np.int8), nobody, none, none, patches)
    return with_crossed(made)


def with_crossed(surface: Surface) -> Surface:
    """The surface with what crosses at the start.

    Without the edges that pass through triangles a piece of cloth falls apart; the largest part of it is where it
    should be. The free vertices of the others are drawn back through what they are nearest to, unless they would have
    to be faster than FASTEST. They may slide along it (`at_time`): anywhere on another piece, and on their own to
    triangles up to two away, as what is beside them is not what they are through.
    """
    hits = pierced(surface)
    if not len(hits):
        return surface
    n, passing = len(surface.start), np.isin(np.arange(len(surface.edges)), hits[:, 0])
    part = connected_components(surface.edges[~passing], n)
    piece, size = connected_components(surface.edges, n), np.bincount(part)
    order = np.argsort(size[part], kind="stable")
    main = np.zeros(n, np.int64)
    main[piece[order]] = part[order]  # of each piece the largest, which comes last
    through = part != main[piece]
    crossing = np.concatenate([surface.edges[hits[:, 0]].ravel(), surface.triangles[hits[:, 1]].ravel()])
    crossed = np.where(np.isin(piece, piece[crossing]), BESIDE, APART).astype(np.int8)
    crossed[crossing] = CROSSING
    crossed[through] = THROUGH
    drawn, beyond, patches, shape = [], [], [], surface.triangles
    for v in np.flatnonzero(through):
        apart = np.flatnonzero((part[shape] != part[v]).all(axis=1))
        t, delta = nearest_triangle(surface, v, apart, surface.start)
        if delta <= FASTEST * surface.release and surface.free[[v, *shape[t]]].any():
            beside = surface.edges[np.isin(surface.edges, shape[t]).any(axis=1)]
            other = piece[shape[apart, 0]] != piece[v]
            patches.append(apart[other if other[apart == t] else np.isin(shape[apart], beside).any(axis=1)])
            drawn.append(v * len(shape) + t)
            beyond.append(delta)
    most = max(map(len, patches), default=1)
    about = np.array([np.resize(each, most) for each in patches], np.int32).reshape(-1, most)
    numbers: Any = np.array(drawn, np.int64)
    made = surface._replace(crossed=crossed, drawn=numbers, beyond=np.array(beyond, float), patches=about)
    return made._replace(side=-of_each(surface, surface.start, numbers)[3])


@kernel
def nearest_triangle(surface, v, among, x):
    """The triangle that is nearest to a vertex at x (n, 3), `among` these, and how far it is, m."""
    best, least, own = 0, 1e300, np.zeros(4, np.int32)
    for t in among:
        pair_of(surface, CORNER, v, t, own)
        delta = distance(CORNER, own, x)
        if delta < least:
            best, least = t, delta
    return best, least


def at_time(surface: Surface, time: float, x: Array) -> Surface:
    """The surface for a step from x (n, 3) that ends at a time, s."""
    if time >= surface.release or not surface.crossed.any():
        return surface
    drawn: Any = surface.drawn.copy()
    for d, v in enumerate(drawn // len(surface.triangles)):
        drawn[d] = v * len(surface.triangles) + nearest_triangle(surface, v, surface.patches[d], x)[0]
    return surface._replace(drawn=drawn, left=remaining(time, surface.release))


def none(surface: Surface) -> Contact:
    """A contact without pairs."""
    return of_numbers(surface, surface.start, np.zeros(0, np.int64))


def nowhere() -> Surface:
    """The surface of a cloth that does not meet itself: of no vertices."""
    nobody = np.zeros((0, 3), np.int32)
    return surface(nobody, np.zeros((0, 3)), np.zeros(0, bool), (0.0, 0.0, 0.0, 0.0))


def of_numbers(surface: Surface, x: Array, numbers: Indices) -> Contact:
    """The contact of these pairs (P,), by their numbers, in a step that begins at x (n, 3); all of them press."""
    vertices, kind, thickness, sides = of_each(surface, x, numbers)
    law, on = (surface.thickness, surface.stiffness, surface.friction), np.ones((1, len(numbers)), bool)
    turn, depth, slot = np.zeros(1, np.int32), np.full(len(numbers), np.inf), np.zeros((len(numbers), 6), np.int32)
    return Contact(vertices, kind, thickness, sides, surface.free, *law, on, turn, depth, slot)


def contact_at(surface: Surface, x: Array) -> Contact:
    """The contact of all pairs that are nearer at x (n, 3) than their thickness."""
    return of_numbers(surface, x, near(surface, x))


def of_each(surface: Surface, x: Array, numbers: Indices) -> tuple[Indices, Indices, Array, Array]:
    """The vertices (P, 4), kind, thickness and side (P,) of pairs."""
    count = len(numbers)
    found = np.zeros((count, 4), np.int32), np.zeros(count, np.int32), np.zeros(count), np.zeros(count)
    if count:  # a cloth that does not meet itself compiles nothing for pairs
        look_up(surface, x, numbers, *found)
    return found


@kernel
def look_up(surface, x, numbers, vertices, kind, thickness, sides):
    """Write what `of_each` returns."""
    for k in range(len(numbers)):
        kind[k] = vertices_of(surface, numbers[k], vertices[k])
        thickness[k] = thickness_of(surface, kind[k], vertices[k])
        sides[k] = nearest.side(kind[k], vertices[k], x)
        d = np.searchsorted(surface.drawn, numbers[k]) if surface.left > 0.0 else len(surface.drawn)
        if d < len(surface.drawn) and surface.drawn[d] == numbers[k]:
            thickness[k] = surface.thickness - surface.left * (surface.thickness + surface.beyond[d])
            sides[k] = surface.side[d]


@kernel
def vertices_of(surface, number, own):
    """Write the four vertices of a pair; returns its kind."""
    faces, corners = len(surface.triangles), len(surface.start) * len(surface.triangles)
    if number < corners:
        pair_of(surface, CORNER, number // faces, number % faces, own)
        return CORNER
    pair_of(surface, EDGE, (number - corners) // len(surface.edges), (number - corners) % len(surface.edges), own)
    return EDGE


@kernel
def pair_of(surface, kind, a, b, own):
    """The number of the pair of vertex a and triangle b, or of edges a and b, whose vertices are written."""
    triangles, edges = surface.triangles, surface.edges
    if kind == CORNER:
        own[0], own[1], own[2], own[3] = a, triangles[b, 0], triangles[b, 1], triangles[b, 2]
        return a * len(triangles) + b
    own[0], own[1], own[2], own[3] = edges[a, 0], edges[a, 1], edges[b, 0], edges[b, 1]
    return len(surface.start) * len(triangles) + a * len(edges) + b


@kernel
def thickness_of(surface, kind, own):
    """The thickness of a pair."""
    at_start = distance(kind, own, surface.start)
    if not at_start < 2.0 * surface.thickness:
        return surface.thickness
    ends = 1 if kind == CORNER else 2
    for a in range(ends):
        for e in range(surface.first[own[a]], surface.first[own[a] + 1]):
            for b in range(ends, 4):
                if surface.neighbours[e] == own[b]:
                    return min(surface.thickness, 0.5 * at_start)
    return min(surface.thickness, at_start)


@kernel
def counts(surface, kind, own):
    """Whether a pair can touch: no vertex is in both, one is free, and the two do not cross since the start, or come to
    cross as what is on the wrong side slides.
    """
    crossed, ends = surface.crossed, 1 if kind == CORNER else 2
    one, middle, other = crossed[own[0]], crossed[own[1]], max(crossed[own[2]], crossed[own[3]])
    both = max(one, middle) + other if kind == EDGE else one + max(middle, other)
    if surface.left > 0.0 and both >= THROUGH + BESIDE:
        return False
    for a in range(ends):
        for b in range(ends, 4):
            if own[a] == own[b]:
                return False
    free = surface.free
    return free[own[0]] + free[own[1]] + free[own[2]] + free[own[3]] > 0.0


def near(surface: Surface, x: Array, view: Indices | None = None) -> Indices:
    """The numbers, ascending, of the pairs that are nearer at x (n, 3) than their thickness, or drawn back; all of them
    are in `view`, where there is one.
    """
    found = chosen(surface, x, x, around(surface, x, x, 0.0) if view is None else view, True, False)
    return np.union1d(found, surface.drawn) if surface.left > 0.0 else found


def colliding(surface: Surface, x: Array, after: Array, view: Indices | None = None) -> Indices:
    """The numbers, ascending, of the pairs that would pass through each other from x to `after`, (n, 3) each, or that
    are then nearer than their thickness; `view` as for `near`.
    """
    view = around(surface, x, after, 0.0) if view is None else view
    return np.asarray(chosen(surface, x, after, view, True, True))


def crossing(surface: Surface, x: Array, after: Array, numbers: Indices) -> Indices:
    """Those of the pairs with these numbers that would pass through each other from x to `after`, (n, 3) each."""
    return np.asarray(chosen(surface, x, after, numbers, False, True))


@kernel
def chosen(surface, x, after, numbers, close, moving):
    """Those of the pairs with these numbers that can touch, and that `close` are near at `after` or `moving` would pass
    through each other from x on, (n, 3) each.
    """
    own, kept = np.zeros(4, np.int32), np.zeros(len(numbers), np.bool_)
    for k in range(len(numbers)):
        kind = vertices_of(surface, numbers[k], own)
        if counts(surface, kind, own):
            thickness = thickness_of(surface, kind, own)
            near = close and distance(kind, own, after) < thickness
            kept[k] = near or (moving and nearest.passes(kind, own, x, after, surface.thickness, thickness))
    return numbers[kept]


def around(surface: Surface, x: Array, after: Array, margin: float) -> Indices:
    """The numbers, ascending, of the pairs that may be near at x, pass through each other from there, or be near where
    they end, no vertex farther than `margin`, m, from `after`, (n, 3).
    """
    motion = x, after - x, surface.thickness, margin

    def of_kind(kind: int, one: Parts, other: Parts) -> npt.NDArray[np.int64]:
        pairs = overlapping(one, other, *motion)
        numbers = np.empty(len(pairs), np.int64)
        return numbers[: reach(surface, x, after, 2.0 * margin, kind, pairs, numbers)]

    kinds = (CORNER, surface.points, surface.faces), (EDGE, surface.lines, surface.lines)
    each = [partial(of_kind, *own) for own in kinds]
    return np.sort(np.concatenate(together(each) if len(x) >= MULTIGRID_FROM else [part() for part in each]))


@kernel(nogil=True)
def reach(surface, x, after, more, kind, pairs, numbers):
    """Write the numbers of the pairs that may come within their thickness, or pass, where they come nearer by no more
    than from x to `after` and by `more`, m; returns how many there are.
    """
    own, count = np.zeros(4, np.int32), 0
    for m in range(len(pairs)):
        number = pair_of(surface, kind, np.int64(pairs[m, 0]), np.int64(pairs[m, 1]), own)
        if counts(surface, kind, own):
            r = nearest.closest(kind, own, x)[2]
            delta, way = sqrt(dot(r, r)), past_each_other(kind, own, x, after) + more
            least = delta - way / (1.0 - LEFT)
            if least < surface.thickness and least < thickness_of(surface, kind, own):
                between = min(delta, nearest.apart(kind, own, mul(splat(1.0 / delta), r), after) - more)
                least = max(thickness_of(surface, kind, own), LEFT * min(delta, surface.thickness))
                if not between > least + nearest.ROUNDING * way:
                    numbers[count] = number
                    count += 1
    return count


def pierced(surface: Surface) -> Indices:
    """The pairs (M, 2) of an edge and a triangle that it passes through at the start."""
    x, edges, triangles = surface.start, surface.edges, surface.triangles
    found = overlapping(surface.lines, surface.faces, x, np.zeros_like(x), 0.0, 0.0)
    ends, corners = edges[found[:, 0]], triangles[found[:, 1]]
    apart = ~(ends[:, :, None] == corners[:, None]).any(axis=(1, 2))
    found, (p, q), (a, b, c) = found[apart], x[ends[apart]].swapaxes(0, 1), x[corners[apart]].swapaxes(0, 1)
    one, other = volumes(a, b, c, p), volumes(a, b, c, q)
    least = FLAT * np.linalg.norm(np.cross(b - a, c - a), axis=1) * np.linalg.norm(q - p, axis=1)
    across = (one * other < 0.0) & (np.minimum(abs(one), abs(other)) > least)
    turns = np.array([volumes(p, q, a, b), volumes(p, q, b, c), volumes(p, q, c, a)])
    within = (turns >= 0).all(axis=0) | (turns <= 0).all(axis=0)
    return np.asarray(found[across & within])


def volumes(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Six times the signed volumes (M,) of tetrahedra with these corners (M, 3)."""
    return np.asarray(np.einsum("mi,mi->m", np.cross(b - a, c - a), d - a))
