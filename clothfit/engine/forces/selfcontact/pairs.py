"""Which pairs of a cloth are near each other, and which would pass through each other on their way.

A pair has a number: v T + t for vertex v and triangle t of T, and beyond those n T + e E + f for edges e < f of E.
Pairs that share a vertex do not count, nor do those of fixed vertices only. The thickness of a pair is that of the
cloth, or less: the distance that it has at the start, half of that where an edge joins the two. What lies together at
the start, a seam that is not welded, does not touch. What crosses there is let through for a while, and drawn back.

Along straight ways, x + t (x' − x), the distance of a pair falls no faster than its vertices move past each other: so
far it may go at once, and then look again (conservative advancement). A pair whose distance falls below a tenth of what
it was, or of the thickness, is about to pass through. Reference: B. Mirtich, Impulse-based dynamic simulation of rigid
body systems, PhD thesis, 1996, section 2.3.

Both are looked for where boxes overlap, by a uniform grid, in time proportional to what is found.

Each box of the second set is put into every cell that it reaches; a box of the first set looks into its cells. Two
boxes that meet in several cells count in one of them: that of the lower corner of what they share. Cells are as wide as
the boxes are on average, and there are at most some for each box.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.eigen import connected_components
from clothfit.engine.forces.law import remaining
from clothfit.engine.forces.selfcontact.force import Contact
from clothfit.engine.forces.selfcontact.nearest import CORNER, EDGE, distance, side
from clothfit.kernels.kernel import kernel

ROUNDING = 1e-9
"""Distance relative to a way below which two parts meet: a search for where goes no finer."""

FASTEST = 0.5
"""Speed, m/s, with which what crosses at the start is drawn back, at most."""

LEFT = 0.1
"""The part of a distance that must be left."""

SEAM = 1e-6
"""The part of the thickness below which what is apart at the start counts as a seam, which may pass through itself."""

FLAT = 1e-9
"""Height of the ends of an edge over a triangle, relative to its length, that may be rounding in a flat cloth."""

LOOKS = 1000
"""Times that a pair is looked at on its way, at most; one that is not through by then counts as passing."""

CELLS = 4
"""Most cells for each box."""

ROOM = 32
"""Pairs for each box of the first set that there is room for at first."""


class Surface(NamedTuple):
    """What of a cloth can touch: n vertices, T triangles, E edges; its law and its start."""

    triangles: Indices  # (T, 3)
    edges: Indices  # (E, 2), of the triangles, ascending
    start: Array  # (n, 3), m
    free: Array  # (n,), 1 of free vertices, else 0
    first: Indices  # (n + 1,): vertex i is joined by edges to
    joined: Indices  # joined[first[i]] … joined[first[i + 1] − 1]
    thickness: float  # m
    stiffness: float  # κ, N/m
    friction: float  # μ
    release: float  # s, in which what passes through another part at the start goes back
    crossed: Flags  # (n,), whether a vertex is where two parts cross at the start
    drawn: npt.NDArray[np.int64]  # (D,), pairs, ascending, that are drawn back to the other side,
    side: Array  # (D,), 1 or −1, which one that is,
    beyond: Array  # (D,), and how far from it they are at the start, m
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
    joined, nobody, nothing = np.ascontiguousarray(both[:, 1]), np.zeros(0, np.int64), np.zeros(0)
    fabric = *shape, np.array(start, float), free, first, joined
    return with_crossed(Surface(*fabric, *law, crossed=np.zeros(n, bool), drawn=nobody, side=nothing, beyond=nothing))


def with_crossed(surface: Surface) -> Surface:
    """The surface with what crosses at the start.

    Without the edges that pass through triangles a piece of cloth falls apart; the largest part of it is where it
    should be. The free vertices of the others are drawn back through what they are nearest to, unless they would have
    to be faster than FASTEST.
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
    crossed = through.copy()
    crossed[surface.edges[hits[:, 0]]] = crossed[surface.triangles[hits[:, 1]]] = True
    numbers = [v * len(surface.triangles) + nearest_triangle(surface, part, v) for v in np.flatnonzero(through)]
    drawn = np.array(numbers, np.int64)
    vertices, kind, _, side = look_up(surface, surface.start, drawn)
    beyond = np.array([distance(k, own, surface.start) for k, own in zip(kind, vertices, strict=True)])
    kept = (beyond <= FASTEST * surface.release) & (surface.free[vertices].sum(axis=1) > 0)
    return surface._replace(crossed=crossed, drawn=drawn[kept], side=-side[kept], beyond=beyond[kept])


@kernel
def nearest_triangle(surface, part, v):
    """The triangle that is nearest to a vertex at the start, of those without a corner in the same part."""
    best, least, own = 0, 1e300, np.zeros(4, np.int32)
    own[0] = v
    for t in range(len(surface.triangles)):
        a, b, c = surface.triangles[t, 0], surface.triangles[t, 1], surface.triangles[t, 2]
        if part[a] != part[v] and part[b] != part[v] and part[c] != part[v]:
            own[1], own[2], own[3] = a, b, c
            delta = distance(CORNER, own, surface.start)
            if delta < least:
                best, least = t, delta
    return best


def at_time(surface: Surface, time: float) -> Surface:
    """The surface for a step that ends at a time, s."""
    return surface._replace(left=remaining(time, surface.release)) if surface.crossed.any() else surface


def none(surface: Surface) -> Contact:
    """A contact without pairs."""
    nobody, nothing, law = np.zeros(0, np.int32), np.zeros(0), (surface.stiffness, surface.friction)
    return Contact(np.zeros((0, 4), np.int32), nobody, nothing, nothing, surface.free, *law)


def nowhere() -> Surface:
    """The surface of a cloth that does not meet itself: of no vertices."""
    nobody = np.zeros((0, 3), np.int32)
    return surface(nobody, np.zeros((0, 3)), np.zeros(0, bool), (0.0, 0.0, 0.0, 0.0))


def of_numbers(surface: Surface, x: Array, numbers: Indices) -> Contact:
    """The contact of these pairs (P,), by their numbers, in a step that begins at x (n, 3)."""
    vertices, kind, thickness, sides = look_up(surface, x, numbers)
    return Contact(vertices, kind, thickness, sides, surface.free, surface.stiffness, surface.friction)


def some(contact: Contact, which: Flags) -> Contact:
    """The contact of some of its pairs."""
    of_pairs = ("vertices", "kind", "thickness", "side")
    return contact._replace(**{name: getattr(contact, name)[which] for name in of_pairs})


def touching(surface: Surface, x: Array) -> Contact:
    """The contact of all pairs that are nearer at x (n, 3) than their thickness."""
    return of_numbers(surface, x, near(surface, x))


@kernel
def look_up(surface, x, numbers):
    """The vertices, kind, thickness and side of pairs."""
    count = len(numbers)
    vertices, kind = np.zeros((count, 4), np.int32), np.zeros(count, np.int32)
    thickness, sides = np.zeros(count), np.zeros(count)
    for k in range(len(numbers)):
        kind[k] = vertices_of(surface, numbers[k], vertices[k])
        thickness[k] = thickness_of(surface, kind[k], vertices[k])
        sides[k] = side(kind[k], vertices[k], x)
        d = np.searchsorted(surface.drawn, numbers[k]) if surface.left > 0.0 else len(surface.drawn)
        if d < len(surface.drawn) and surface.drawn[d] == numbers[k]:
            thickness[k] = surface.thickness - surface.left * (surface.thickness + surface.beyond[d])
            sides[k] = surface.side[d]
    return vertices, kind, thickness, sides


@kernel
def vertices_of(surface, number, own):
    """Write the four vertices of a pair; returns its kind."""
    faces, n = len(surface.triangles), len(surface.start)
    if number < n * faces:
        own[0] = number // faces
        t = number % faces
        own[1], own[2], own[3] = surface.triangles[t, 0], surface.triangles[t, 1], surface.triangles[t, 2]
        return CORNER
    e, f = (number - n * faces) // len(surface.edges), (number - n * faces) % len(surface.edges)
    own[0], own[1], own[2], own[3] = surface.edges[e, 0], surface.edges[e, 1], surface.edges[f, 0], surface.edges[f, 1]
    return EDGE


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
                if surface.joined[e] == own[b]:
                    return min(surface.thickness, 0.5 * at_start)
    return min(surface.thickness, at_start)


@kernel
def counts(surface, kind, own):
    """Whether a pair can touch: no vertex is in both, one is free, and the two do not cross since the start."""
    ends = 1 if kind == CORNER else 2
    crossed = surface.crossed
    one = crossed[own[0]] or (kind == EDGE and crossed[own[1]])
    if surface.left > 0.0 and one and (crossed[own[2]] or crossed[own[3]] or (kind == CORNER and crossed[own[1]])):
        return False
    for a in range(ends):
        for b in range(ends, 4):
            if own[a] == own[b]:
                return False
    free = surface.free
    return free[own[0]] + free[own[1]] + free[own[2]] + free[own[3]] > 0.0


def near(surface: Surface, x: Array) -> Indices:
    """The numbers, ascending, of the pairs that are nearer at x (n, 3) than their thickness, or drawn back."""
    found = selected(surface, x, x, 0.5 * surface.thickness, False)  # from x to x
    return np.union1d(found, surface.drawn) if surface.left > 0.0 else found


def meeting(surface: Surface, x: Array, after: Array) -> Indices:
    """The numbers, ascending, of the pairs that would pass through each other from x to `after`, (n, 3) each, or that
    are then nearer than their thickness.
    """
    return selected(surface, x, after, 0.5 * surface.thickness, True)


@kernel
def crossing(surface, x, after, numbers):
    """Those of the pairs with these numbers that would pass through each other from x to `after`, (n, 3) each."""
    own, kept = np.zeros(4, np.int32), np.zeros(len(numbers), np.bool_)
    for k in range(len(numbers)):
        kind = vertices_of(surface, numbers[k], own)
        kept[k] = counts(surface, kind, own) and passes(surface, kind, own, x, after)
    return numbers[kept]


def selected(surface: Surface, x: Array, after: Array, margin: float, moving: bool) -> Indices:
    """The numbers of the pairs that `is_near` or `passes` selects, of those whose boxes overlap."""
    low, high = np.minimum(x, after) - margin, np.maximum(x, after) + margin
    corners = overlapping(np.hstack([low, high]), boxes(low, high, surface.triangles))
    edges = overlapping(boxes(low, high, surface.edges))
    found = []
    for kind, pairs in ((CORNER, corners), (EDGE, edges)):
        numbers = np.empty(len(pairs), np.int64)
        found.append(numbers[: select(surface, x, after, moving, kind, pairs, numbers)])
    return np.sort(np.concatenate(found))


def boxes(low: Array, high: Array, part: Indices) -> Array:
    """The boxes (M, 6) of what has these vertices (M, …), from the corners of those of each vertex (n, 3)."""
    return np.hstack([low[part].min(axis=1), high[part].max(axis=1)])


@kernel
def select(surface, x, after, moving, kind, pairs, numbers):
    """Write the numbers of the pairs that are selected; returns how many there are."""
    own, count = np.zeros(4, np.int32), 0
    faces, n = len(surface.triangles), len(surface.start)
    for m in range(len(pairs)):
        a, b = np.int64(pairs[m, 0]), np.int64(pairs[m, 1])
        number = a * faces + b if kind == CORNER else n * faces + a * len(surface.edges) + b
        vertices_of(surface, number, own)
        if not counts(surface, kind, own):
            continue
        if is_near(surface, kind, own, after) or (moving and passes(surface, kind, own, x, after)):
            numbers[count] = number
            count += 1
    return count


@kernel
def is_near(surface, kind, own, x):
    """Whether a pair is nearer than its thickness."""
    delta = distance(kind, own, x)
    return delta < surface.thickness and delta < thickness_of(surface, kind, own)


@kernel
def passes(surface, kind, own, x, after):
    """Whether a pair comes nearer on its way than a tenth of its distance or of the thickness."""
    delta, speed = distance(kind, own, x), past_each_other(kind, own, x, after)
    least = max(LEFT * min(delta, surface.thickness), ROUNDING * speed)
    if delta - speed > least:
        return False
    y, t = np.empty((4, 3)), 0.0
    corners = np.arange(4)
    for _ in range(LOOKS):
        t += (delta - 0.5 * least) / speed
        if t >= 1.0:
            return False
        for e in range(4):
            for c in range(3):
                y[e, c] = x[own[e], c] + t * (after[own[e], c] - x[own[e], c])
        delta = distance(kind, corners, y)
        if not delta > least:
            break
    return thickness_of(surface, kind, own) > SEAM * surface.thickness


@kernel
def past_each_other(kind, own, x, after):
    """How far the two of a pair move past each other at most, without what all four vertices do."""
    mean0, mean1, mean2 = 0.0, 0.0, 0.0
    for e in range(4):
        i = own[e]
        mean0 += 0.25 * (after[i, 0] - x[i, 0])
        mean1 += 0.25 * (after[i, 1] - x[i, 1])
        mean2 += 0.25 * (after[i, 2] - x[i, 2])
    one, other = 0.0, 0.0
    for e in range(4):
        i = own[e]
        w0, w1, w2 = after[i, 0] - x[i, 0] - mean0, after[i, 1] - x[i, 1] - mean1, after[i, 2] - x[i, 2] - mean2
        size = w0 * w0 + w1 * w1 + w2 * w2
        if e == 0 or (e == 1 and kind == EDGE):
            one = max(one, size)
        else:
            other = max(other, size)
    return sqrt(one) + sqrt(other)


def pierced(surface: Surface) -> Indices:
    """The pairs (M, 2) of an edge and a triangle that it passes through at the start."""
    x, edges, triangles = surface.start, surface.edges, surface.triangles
    found = overlapping(boxes(x, x, edges), boxes(x, x, triangles))
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


def overlapping(boxes: Array, others: Array | None = None) -> Indices:
    """The pairs (M, 2) of boxes (A, 6) and (B, 6), lower corners first, that overlap; without others those of the
    boxes among themselves, the lower number first.
    """
    alike = others is None
    others = boxes if others is None else others
    if not len(boxes) or not len(others):
        return np.zeros((0, 2), np.int32)
    corner = others[:, :3].min(axis=0)
    extent = np.maximum(others[:, 3:].max(axis=0) - corner, 1e-300)
    width = max(float((each[:, 3:] - each[:, :3]).mean()) for each in (boxes, others)) or 1e-300
    while np.prod(np.ceil(extent / width)) > CELLS * len(others) + 64:
        width *= 1.25
    shape = np.maximum(np.ceil(extent / width), 1).astype(np.int64)
    cells, own = np.empty((len(boxes), 6), np.int32), np.empty((len(others), 6), np.int32)
    find_cells(boxes, corner, width, shape, cells)
    find_cells(others, corner, width, shape, own)
    start, member = filed(own, shape)
    room = np.empty((ROOM * len(boxes), 2), np.int32)
    while (count := search(boxes, cells, others, own, shape, start, member, alike, room)) > len(room):
        room = np.empty((count, 2), np.int32)
    return room[:count]


@kernel
def find_cells(boxes, corner, width, shape, cells):
    """Write the first and the last cell (A, 6) of boxes along each axis; what is outside counts to the last ones."""
    for b in range(len(boxes)):
        for c in range(6):
            axis = c % 3
            place = int((boxes[b, c] - corner[axis]) / width)
            cells[b, c] = min(max(place, 0), shape[axis] - 1)


@kernel
def filed(own, shape):
    """The boxes in each cell: those of cell c are member[start[c]] … member[start[c + 1] − 1]."""
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for b in range(len(own)):
        for x in range(own[b, 0], own[b, 3] + 1):
            for y in range(own[b, 1], own[b, 4] + 1):
                for z in range(own[b, 2], own[b, 5] + 1):
                    start[(x * shape[1] + y) * shape[2] + z] += 1
    for c in range(len(start) - 1):
        start[c + 1] += start[c]
    member = np.empty(start[-1], np.int32)
    for b in range(len(own) - 1, -1, -1):
        for x in range(own[b, 0], own[b, 3] + 1):
            for y in range(own[b, 1], own[b, 4] + 1):
                for z in range(own[b, 2], own[b, 5] + 1):
                    c = (x * shape[1] + y) * shape[2] + z
                    start[c] -= 1
                    member[start[c]] = b
    return start, member


@kernel
def meet(boxes, a, others, b):
    """Whether two boxes overlap."""
    along0 = boxes[a, 0] <= others[b, 3] and others[b, 0] <= boxes[a, 3]
    along1 = boxes[a, 1] <= others[b, 4] and others[b, 1] <= boxes[a, 4]
    return along0 and along1 and boxes[a, 2] <= others[b, 5] and others[b, 2] <= boxes[a, 5]


@kernel
def search(boxes, cells, others, own, shape, start, member, alike, room):
    """Write the pairs of boxes that overlap, as many as there is room for; returns how many there are."""
    count = 0
    for a in range(len(boxes)):
        for x in range(cells[a, 0], cells[a, 3] + 1):
            for y in range(cells[a, 1], cells[a, 4] + 1):
                for z in range(cells[a, 2], cells[a, 5] + 1):
                    c = (x * shape[1] + y) * shape[2] + z
                    for e in range(start[c], start[c + 1]):
                        b = member[e]
                        if (alike and b <= a) or not meet(boxes, a, others, b):
                            continue
                        first = x == max(cells[a, 0], own[b, 0]) and y == max(cells[a, 1], own[b, 1])
                        if first and z == max(cells[a, 2], own[b, 2]):
                            if count < len(room):
                                room[count, 0], room[count, 1] = a, b
                            count += 1
    return count
