"""Smooth maps over a cloth: the lowest modes of the Laplacian of its mesh, the basis of mode M.

The Laplacian is that of linear finite elements, with the areas nearest to each vertex as masses, which on a rectangle
gives cosines: L φ = λ M φ with

    L_ij = −(cot α + cot β)/2   at the edge ij, α and β the angles opposite it
    M_i  = Σ (|ij|² cot α + |ik|² cot β)/8   over the triangles ijk, α and β opposite ij and ik; where a triangle is
           obtuse, half of its area at that corner and a quarter at the others

Its weights follow the shape of the cloth, not the density of the mesh. They are kept above 0, so that obtuse and flat
triangles do no harm. Springs that leave the triangles, or join pieces of them, are bars of weight ℓ/L, L their length
and ℓ its mean; without triangles all springs are such bars.
Sources: Pinkall and Polthier (1993), Computing discrete minimal surfaces and their conjugates; Meyer, Desbrun, Schröder
and Barr (2003), Discrete differential-geometry operators for triangulated 2-manifolds.

n vertices.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.eigen import connected_components
from clothfit.scene.cloth import Cloth
from clothfit.scene.directions import Slots, angles, edges_of, keys

LEAST_WEIGHT, MOST_COTANGENT = 1e-9, 1e3
"""Bounds of the weights: the least beside that of 1 of an equilateral mesh, and the cotangent of an angle of 1e-3."""

LEAST_MASS = 1e-3
"""The least mass of a vertex, as a share of the mean one: its triangles may have no area."""

DENSE = 300
"""The most vertices of a piece whose modes are found from a dense matrix, which is faster up to there."""

SPARE = 4
"""Modes that are found beyond those that are asked for, so that the last ones are not half of an equal pair."""

EQUAL = 1e-6
"""Eigenvalues whose relative difference is below this belong to one plane, in which any direction is smooth alike."""

TIE = 1e-6
"""Entries whose relative difference is below this are equally large."""


class Laplacian(NamedTuple):
    """Weighted edges and vertices."""

    ends: Slots  # (E, 2)
    weight: Array  # (E,), above 0
    mass: Array  # (n,), above 0, m²


def vertex_modes(cloth: Cloth, count: int) -> Array:
    """The first `count` modes (n, K) of the mesh of a cloth, lowest frequency first; K is smaller where it has fewer.

    The first column is 1. Every other has the largest absolute value 1, at a positive entry. Of a cloth in several
    pieces each piece but the largest has a column that is 1 on it and 0 elsewhere, and modes of its own; vertices
    that nothing joins have neither.
    """
    n = len(cloth.positions)
    built = laplacian(cloth)
    piece = connected_components(built.ends, n)
    sizes = np.bincount(piece)
    order = [p for p in np.argsort(-sizes, kind="stable").tolist() if sizes[p] > 1]
    columns = [np.ones(n)]
    values = [0.0]
    for rank, p in enumerate(order):
        own = np.flatnonzero(piece == p)
        if rank:
            columns.append(np.where(piece == p, 1.0, 0.0))
            values.append(0.0)
        found, modes = _modes(_part(built, own, n), cloth.positions[own], count)
        values += found.tolist()
        columns += [_filled(mode, own, n) for mode in modes.T]
    chosen = np.argsort(values, kind="stable")[:count]
    return np.stack([columns[i] for i in chosen], axis=1)


def laplacian(cloth: Cloth) -> Laplacian:
    """The Laplacian of the mesh of a cloth."""
    n, triangles = len(cloth.positions), cloth.triangles
    edges = edges_of(triangles)
    angle = angles(cloth.positions, triangles)
    cotangent = np.cos(angle) / np.maximum(np.sin(angle), 1 / MOST_COTANGENT)
    weight = np.bincount(edges.of.reshape(-1), cotangent.reshape(-1) / 2, len(edges.key))
    mass = np.bincount(triangles.reshape(-1), _shares(cloth.positions[triangles], angle, cotangent).reshape(-1), n)
    bars = _bars(cloth, connected_components(edges.ends, n))
    length = np.sqrt(((cloth.positions[bars[:, 0]] - cloth.positions[bars[:, 1]]) ** 2).sum(axis=1))
    mean = float(length.mean()) if len(bars) else 1.0
    mass = mass + np.bincount(bars.reshape(-1), np.repeat(length * mean / 2, 2), n)
    positive = mass[mass > 0]
    least = LEAST_MASS * float(positive.mean()) if len(positive) else 1.0
    weights = np.concatenate([np.maximum(weight, LEAST_WEIGHT), np.maximum(mean / length, LEAST_WEIGHT)])
    return Laplacian(np.concatenate([edges.ends, bars]).astype(np.intp), weights, np.maximum(mass, least))


def _shares(at: Array, angle: Array, cotangent: Array) -> Array:
    """The area (T, 3), m², of a triangle with corners `at` (T, 3, 3) that belongs to each of them."""
    side = np.roll(at, -1, axis=1) - np.roll(at, 1, axis=1)  # opposite each corner
    part = (side * side).sum(axis=2) * cotangent / 8
    nearest = part.sum(axis=1)[:, None] - part
    normal = np.cross(side[:, 0], side[:, 1])
    area = np.sqrt((normal * normal).sum(axis=1))[:, None] / 2
    wide = angle > np.pi / 2
    return np.asarray(np.where(wide.any(axis=1, keepdims=True), area * np.where(wide, 0.5, 0.25), nearest))


def _bars(cloth: Cloth, piece: Slots) -> Slots:
    """The springs (B, 2), each pair of vertices once, that leave the triangles or join `piece` (n,) to another."""
    _, first = np.unique(keys(cloth.springs), return_index=True)
    ends = cloth.springs[np.sort(first)].astype(np.intp)
    alone = np.ones(len(cloth.positions), bool)
    alone[cloth.triangles] = False
    a, b = ends.T
    return np.asarray(ends[alone[a] | alone[b] | (piece[a] != piece[b])])


def _part(built: Laplacian, own: Slots, n: int) -> Laplacian:
    """The Laplacian of the vertices `own`, a whole piece, numbered from 0."""
    number = np.full(n, -1)
    number[own] = np.arange(len(own))
    inside = number[built.ends[:, 0]] >= 0
    return Laplacian(number[built.ends[inside]], built.weight[inside], built.mass[own])


def _filled(mode: Array, own: Slots, n: int) -> Array:
    """A mode of a piece on all n vertices, scaled so that its largest absolute value is 1, at a positive entry."""
    found = np.zeros(n)
    size = np.abs(mode)
    top = int(np.argmax(size > size.max() * (1 - TIE)))  # the first of equal ones
    found[own] = mode / mode[top]
    return np.clip(found, -1.0, 1.0)


def _modes(part: Laplacian, positions: Array, count: int) -> tuple[Array, Array]:
    """The eigenvalues (K,), relative to the size of the piece, and modes (n, K) of a piece, the constant left out."""
    n = len(part.mass)
    wanted = min(count + SPARE, n)
    scale = 1 / np.sqrt(part.mass)
    matrix = _matrix(part, scale)
    if n <= DENSE or wanted > n // 2:
        value, vector = np.linalg.eigh(matrix.toarray())
        value, vector = value[:wanted], vector[:, :wanted]
    else:
        from scipy.sparse.linalg import eigsh

        start = np.random.default_rng(0).standard_normal(n)
        shift = -1.0 / float(part.mass.sum())  # just below the spectrum, where the matrix can be factorised
        value, vector = eigsh(matrix, wanted, sigma=shift, which="LM", v0=start)
        order = np.argsort(value, kind="stable")
        value, vector = value[order], vector[:, order]
    vector = _aligned(value[1:], vector[:, 1:], positions)
    return value[1:], vector * scale[:, None]


def _matrix(part: Laplacian, scale: Array) -> Any:
    """M^-½ L M^-½, sparse."""
    from scipy.sparse import coo_array

    (i, j), n = part.ends.T, len(scale)
    link = part.weight * scale[i] * scale[j]
    total = np.bincount(part.ends.reshape(-1), np.repeat(part.weight, 2), n) * scale * scale
    every = np.arange(n)
    rows, columns = np.concatenate([i, j, every]), np.concatenate([j, i, every])
    return coo_array((np.concatenate([-link, -link, total]), (rows, columns)), shape=(n, n)).tocsc()


def _aligned(value: Array, vector: Array, positions: Array) -> Array:
    """The eigenvectors, those of equal eigenvalues turned so that rounding does not choose them: into the axes of the
    second moments of the positions, weighted differently along x, y and z.
    """
    found = vector.copy()
    moment = ((positions - positions.mean(axis=0)) ** 2) @ [1.0, 0.6, 0.3]
    breaks = np.flatnonzero(np.diff(value) > EQUAL * value[1:]) + 1
    for group in np.split(np.arange(len(value)), breaks):
        if len(group) > 1:
            own = vector[:, group]
            found[:, group] = own @ np.linalg.eigh(own.T @ (moment[:, None] * own))[1]
    return found
