"""The mesh of a cloth: directions in its triangles, its edges under uniform strain, its hinges under uniform curvature.

A hinge is two triangles (p, a, b) and (q, b, a) at their common edge, unfolded into a plane. The heights of p and q
over the edge are h₁ and h₂, the spring between them has the length l. Four points of a plane have one affine
dependency, Σλᵢ = 0 and Σλᵢ xᵢ = 0; scaled so that λ_p = 1/h₁ and λ_q = 1/h₂ it gives the fold angle for small
deflections,

    θ = Σ λᵢ zᵢ = κ : M,   M = ½ Σ λᵢ xᵢ ⊗ xᵢ   for z = ½ xᵀ κ x.

In a row of a grid three vertices p, m, q in a line make a hinge as well, with λ_p = 1/α and λ_q = 1/β for the lengths
α and β of its two edges; there it takes the place of those over the edges across the row, which would tie bending to
twisting.

Components of strain and curvature are (11, 22, 12), 1 along the warp and 2 along the weft; c and s are the components
of a direction. n vertices, T triangles, S springs, H hinges.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.scene import directions
from clothfit.scene.directions import ACROSS, ALONG, DIAGONAL, Slots
from clothfit.scene.families import FAMILIES

STRAIGHT = 0.02
"""Sine of the angle by which a row may turn at a vertex."""

SMOOTHINGS = 20
"""How often directions that come from edges are averaged with those around."""

STEEP = 0.3
"""Least length of the part of a direction that lies in a triangle, for the direction to say anything there."""


class Material(NamedTuple):
    """A flat or curved mesh with the directions of its cloth."""

    positions: Array  # (n, 3), m
    triangles: Indices  # (T, 3)
    areas: Array  # (T,), m²
    warp: Array  # (T, 3), unit vectors in the triangles; 0 where a triangle has no area
    weft: Array  # (T, 3)
    ends: Indices  # (E, 2), edges
    of: Slots  # (T, 3), the edge of each side, opposite the corner
    uses: Slots  # (E,), triangles at each edge
    diagonal: Flags  # (E,), halves a cell of a grid
    along: Flags  # (E,), runs along the cloth
    across: Flags  # (E,)

    @property
    def area(self) -> float:
        """The area of the whole, m²."""
        return float(self.areas.sum())


class Hinges(NamedTuple):
    """The hinges of a mesh."""

    vertices: Indices  # (H, 4): p, q, a, b; of a row p, q, m, m
    triangle: Slots  # (H, 2); of a row two at m
    edge: Slots  # (H,); of a row -1
    weights: Array  # (H, 4), λ, 1/m
    moment: Array  # (H, 3), M, m: θ = M·(κ₁₁, κ₂₂, 2 κ₁₂)
    length: Array  # (H,), l, m, unfolded
    lever: Array  # (H,), h₁ h₂ / l, m: the spring is shorter by half of it times θ²
    rule: Array  # (H,), c = B times this, in a lattice


def material(positions: Array, triangles: Indices, warp: Array | None = None, along: Flags | None = None,
             across: Flags | None = None) -> Material:  # fmt: skip
    """The mesh with its directions: `warp`, (3,) or (T, 3), where that lies in a triangle; else those of its grid, or
    of the edges (E,) that are `along` and `across` the cloth; else x, or z where x leaves the triangle.
    """
    at = positions[triangles]
    double = np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])
    size = np.linalg.norm(double, axis=1)
    normal = double / np.where(size > 0, size, 1.0)[:, None]
    edges = directions.edges_of(triangles)
    given = None if warp is None else np.broadcast_to(np.asarray(warp, float), triangles.shape)
    classes = directions.classes(positions, triangles, edges, given)
    named = along is not None or across is not None
    along, across = (classes == ALONG if along is None else along), (classes == ACROSS if across is None else across)
    found = np.zeros_like(normal)
    candidates = [] if given is None else [given]
    for chosen, turn in ((along, False), (across, True)):
        for side in range(3):
            e = at[:, (side + 2) % 3] - at[:, (side + 1) % 3]
            candidates.append(np.where(chosen[edges.of[:, side]][:, None], np.cross(e, normal) if turn else e, 0.0))
    candidates += [np.broadcast_to(np.eye(3)[axis], normal.shape) for axis in (0, 2)]
    for each in candidates:
        length = np.linalg.norm(each, axis=1)
        unit = each / np.where(length > 0, length, 1.0)[:, None]
        inside = unit - (unit * normal).sum(axis=1)[:, None] * normal
        length = np.linalg.norm(inside, axis=1)
        free = ~found.any(axis=1) & (length > STEEP) & (size > 0)
        found[free] = inside[free] / length[free, None]
    if named:
        found = smoothed(found, normal, triangles, len(positions))
    return Material(positions, triangles, size / 2, found, np.cross(normal, found), edges.ends, edges.of, edges.uses,
                    classes == DIAGONAL, along, across)  # fmt: skip


def smoothed(warp: Array, normal: Array, triangles: Indices, count: int) -> Array:
    """Directions (T, 3) in triangles, each the mean of those around it: an edge of an irregular mesh that is said to
    run along the cloth does so within 22.5° only. The mean is of d ⊗ d less the same across it, where a direction and
    its opposite are one.
    """
    weft = np.cross(normal, warp)
    field = warp[:, :, None] * warp[:, None] - weft[:, :, None] * weft[:, None]
    uses = np.maximum(np.bincount(triangles.reshape(-1), minlength=count), 1)[:, None, None]
    for _ in range(SMOOTHINGS):
        total = np.zeros((count, 3, 3))
        np.add.at(total, triangles, np.repeat(field[:, None], 3, axis=1))
        field = (total / uses)[triangles].mean(axis=1)
    inside = np.eye(3) - normal[:, :, None] * normal[:, None]
    return np.asarray(np.linalg.eigh(inside @ field @ inside)[1][:, :, 2])


def components(mesh: Material, vectors: Array, triangles: Slots) -> tuple[Array, Array]:
    """Components c and s (N,) of vectors (N, 3) in the directions of triangles (N,)."""
    return (vectors * mesh.warp[triangles]).sum(axis=1), (vectors * mesh.weft[triangles]).sum(axis=1)


def edge_squares(mesh: Material) -> Array:
    """c², s² and 2 c s (E, 3) of the edges, the means over the triangles at each: strain · this is that of the edge."""
    side = mesh.of.reshape(-1)
    e = mesh.positions[mesh.ends[side, 1]] - mesh.positions[mesh.ends[side, 0]]
    length2 = np.maximum((e * e).sum(axis=1), np.finfo(float).tiny)
    c, s = components(mesh, e, np.repeat(np.arange(len(mesh.triangles)), 3))
    rows = np.stack([c * c, s * s, 2 * c * s], axis=1) / length2[:, None]
    total = np.stack([np.bincount(side, row, len(mesh.ends)) for row in rows.T], axis=1)
    return np.asarray(total / mesh.uses[:, None])


def hinges_of(mesh: Material) -> Hinges:
    """The hinges at all edges with two triangles, without those of triangles that have no area; those of rows instead
    where an edge of a grid lies across rows at both its ends.
    """
    rows, crossed = _rows(mesh)
    over = folds(mesh)
    return joined(chosen(over, ~crossed[over.edge]), rows)


def all_hinges(mesh: Material) -> Hinges:
    """The hinges at all edges with two triangles, and those of the rows of a grid."""
    return joined(folds(mesh), _rows(mesh)[0])


def chosen(own: Hinges, which: Flags) -> Hinges:
    """Some of the hinges (H,)."""
    return Hinges(own.vertices[which], own.triangle[which], own.edge[which], own.weights[which], own.moment[which],
                  own.length[which], own.lever[which], own.rule[which])  # fmt: skip


def joined(first: Hinges, second: Hinges) -> Hinges:
    """The hinges of both."""
    return Hinges(*(np.concatenate([a, b]) for a, b in zip(first, second, strict=True)))


def folds(mesh: Material) -> Hinges:
    """The hinges at all edges with two triangles."""
    edges = directions.edges_of(mesh.triangles)
    pairs = directions.pairs_of(edges)
    corners = directions.opposite(mesh.triangles, pairs)
    good = (mesh.areas[pairs.triangle] > 0).all(axis=1) & (edges.uses[pairs.edge] == 2)
    good &= corners[:, 0] != corners[:, 1]
    edge, triangle, corners = pairs.edge[good], pairs.triangle[good], corners[good]
    a, b = (mesh.positions[mesh.ends[edge, k]] for k in (0, 1))
    along = b - a
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    feet, heights = [], []
    c, s = list[Array](), list[Array]()
    for k in (0, 1):
        rise = mesh.positions[corners[:, k]] - a
        foot = (rise * along).sum(axis=1)
        out = rise - foot[:, None] * along
        height = np.linalg.norm(out, axis=1)
        for vector, into in ((along, c), (out / height[:, None], s)):  # in the frame of each triangle
            into.append(np.stack(components(mesh, vector, triangle[:, k]), axis=1))
        feet.append(foot)
        heights.append(height)
    (f, g), (h1, h2) = feet, heights
    share = f / length / h1, g / length / h2
    weights = np.stack([1 / h1, 1 / h2, -(1 / h1 - share[0]) - (1 / h2 - share[1]), -share[0] - share[1]], axis=1)
    # x relative to a, with axes along the edge (e) and across it towards p (o); b has x = length
    ee = 0.5 * (f * f / h1 + g * g / h2 + weights[:, 3] * length * length)
    eo = 0.5 * (f - g)
    oo = 0.5 * (h1 + h2)
    same = np.where((c[0] * c[1]).sum(axis=1) < 0, -1.0, 1.0)[:, None]  # a direction and its opposite are one
    e = _mean(c[0], same * c[1])
    o = _mean(s[0], -same * s[1])
    moment = np.stack([
        ee * e[:, 0] ** 2 + 2 * eo * e[:, 0] * o[:, 0] + oo * o[:, 0] ** 2,
        ee * e[:, 1] ** 2 + 2 * eo * e[:, 1] * o[:, 1] + oo * o[:, 1] ** 2,
        ee * e[:, 0] * e[:, 1] + eo * (e[:, 0] * o[:, 1] + e[:, 1] * o[:, 0]) + oo * o[:, 0] * o[:, 1],
    ], axis=1)  # fmt: skip
    chord = np.hypot(f - g, h1 + h2)
    vertices = np.concatenate([corners, mesh.ends[edge]], axis=1).astype(np.int32)
    rule = length * length / mesh.areas[triangle].sum(axis=1)
    return Hinges(vertices, triangle, edge, weights, moment, chord, h1 * h2 / chord, rule)


def _rows(mesh: Material) -> tuple[Hinges, Flags]:
    """The hinges of the rows of a grid, and which edges (E,) lie across rows at both their ends."""
    through = np.zeros((2, len(mesh.positions)), bool)  # vertices that a row along, across the cloth goes through
    rows = [_row(mesh, mesh.along), _row(mesh, mesh.across)]
    for way, (vertices, _) in enumerate(rows):
        through[way, vertices[:, 2]] = True
    crossed = (mesh.across & through[0][mesh.ends].all(axis=1)) | (mesh.along & through[1][mesh.ends].all(axis=1))
    owner = np.zeros(len(mesh.ends), np.intp)
    owner[mesh.of.reshape(-1)] = np.repeat(np.arange(len(mesh.triangles)), 3)
    made = []
    for way, (vertices, edge) in enumerate(rows):
        replaces = np.zeros(len(mesh.positions), bool)
        replaces[mesh.ends[crossed & (mesh.along if way else mesh.across)]] = True
        used = replaces[vertices[:, 2]]
        vertices, triangle = vertices[used], owner[edge[used]]
        at = mesh.positions[vertices]
        alpha, beta = (np.linalg.norm(at[:, k] - at[:, 2], axis=1) for k in (0, 1))
        length, none = alpha + beta, np.zeros(len(vertices))
        moment = np.zeros((len(vertices), 3))
        moment[:, way] = length / 2
        made.append(Hinges(
            vertices, np.stack([triangle, triangle], axis=1), np.full(len(vertices), -1),
            np.stack([1 / alpha, 1 / beta, -1 / alpha - 1 / beta, none], axis=1), moment, length,
            alpha * beta / length, 4 * vertex_areas(mesh)[vertices[:, 2]] / length**2,
        ))  # fmt: skip
    return joined(*made), crossed


def _row(mesh: Material, which: Flags) -> tuple[Indices, Slots]:
    """Vertices p, q, m, m (R, 4) of each two of these edges that go straight through a vertex m, and an edge (R,)."""
    ends, edge = mesh.ends[which], np.flatnonzero(which)
    middle, other = np.concatenate([ends, ends[:, ::-1]]).T
    order = np.argsort(middle, kind="stable")
    number = np.bincount(middle, minlength=len(mesh.positions))
    m = np.flatnonzero(number == 2)
    first = (np.cumsum(number) - number)[m]
    pick = np.stack([order[first], order[first + 1]], axis=1)
    arms = mesh.positions[other[pick]] - mesh.positions[m][:, None]
    normal = vertex_normals(mesh)[m][:, None]
    flat = arms - (arms * normal).sum(axis=2, keepdims=True) * normal
    sizes = np.linalg.norm(flat, axis=2).prod(axis=1)
    straight = np.linalg.norm(np.cross(flat[:, 0], flat[:, 1]), axis=1) <= STRAIGHT * sizes
    straight &= (flat[:, 0] * flat[:, 1]).sum(axis=1) < 0
    found = np.stack([*other[pick].T, m, m], axis=1)[straight].astype(np.int32)
    return found, np.concatenate([edge, edge])[pick[straight, 0]]


def vertex_normals(mesh: Material) -> Array:
    """Unit normals (n, 3) at the vertices, means by area; 0 at a vertex without triangles."""
    normal = np.zeros_like(mesh.positions)
    own = np.cross(mesh.warp, mesh.weft) * mesh.areas[:, None]
    np.add.at(normal, mesh.triangles, np.repeat(own[:, None], 3, axis=1))
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None])


def vertex_areas(mesh: Material) -> Array:
    """The area (n,), m², of each vertex: a third of its triangles."""
    return np.asarray(np.bincount(mesh.triangles.reshape(-1), np.repeat(mesh.areas / 3, 3), len(mesh.positions)), float)


def _mean(first: Array, second: Array) -> Array:
    """The mean of two directions (H, 2), with length 1."""
    total = first + second
    length = np.linalg.norm(total, axis=1)
    return np.where(length[:, None] > 0, total / np.where(length > 0, length, 1.0)[:, None], first)


def named_edges(mesh_ends: Indices, springs: Indices, names: tuple[str, ...], family: Indices) -> tuple[Flags, Flags]:
    """Which edges (E,) are springs of the families along and across the cloth."""
    key, own = directions.keys(mesh_ends), directions.keys(springs)
    wanted = [np.flatnonzero([name == FAMILIES[way] for name in names]) for way in (ALONG, ACROSS)]
    along, across = (np.isin(key, own[np.isin(family, each)]) for each in wanted)
    return along, across
