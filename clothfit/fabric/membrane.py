"""In-plane stiffness of a cloth of springs, and springs for a given one.

A spring k of length L along the unit direction d, under a uniform strain E, has the energy ½ k L² (d·E·d)². All of them
over the area A give the areal stiffness

    C = (1/A) Σ k L² d ⊗ d ⊗ d ⊗ d,   N/m,

the same in every order of its indices: a cloth of springs has C₁₁₂₂ = C₁₂₁₂, so that three numbers a = C₁₁₁₁,
b = C₂₂₂₂, c = C₁₁₂₂ describe one with two axes of symmetry. What a pull test measures is the inverse,
1/(d d : C⁻¹ : d d): along the warp, along the weft, and at 45° (bias). On an irregular mesh the vertices do not follow
a uniform strain, and C is too stiff: there the mesh is loaded, and what gives way is counted (`measured`).

The other way round, the stiffnesses of the springs are those for which uniform strains of the mesh are in equilibrium
under a uniform stress: at each vertex v the forces of the springs are those of linear triangles,

    Σ k L (d·E·d) d = Σ A (C:E)·∇φ_v   for three E,

a sparse linear least-squares problem. Where it is solved, what the springs do is C on any mesh; an irregular mesh of
edges can do that for cloth that is not much softer in shear than along the yarns, a grid also for others.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.fabric.balance import shares
from clothfit.fabric.hinges import Material, edge_squares, vertex_areas, vertex_normals
from clothfit.scene.directions import Slots

PULLS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.5, 0.5], [0.5, 0.5, -0.5]])
"""d ⊗ d of warp, weft and the bias to both sides, as components (11, 22, 12)."""

TWICE = np.array([1.0, 1.0, 2.0])
"""How often a component of a symmetric tensor counts in a double product."""

SKEW = 0.1
"""Weight of what ties pulling to shearing, which no grid with parallel diagonals is without."""

BALANCE = 0.3
"""Weight of the balance of forces, against that of the stiffness around each vertex."""

SMALL = 500
"""Vertices of a mesh whose matrix is a full one."""

GROUND = 1e-9
"""Stiffness, as a share of the largest spring's, that holds what nothing else does."""

RESISTS = 1e-4
"""The share of the largest stiffness below which one counts as none."""


def tensor(squares: Array, weight: Array, area: float) -> Array:
    """C (3, 3), N/m, by components (11, 22, 12), of springs with these c², s², 2 c s (S, 3) and k L² (S,), N m."""
    half = squares / TWICE
    return np.asarray((half * weight[:, None]).T @ half / area)


def of_springs(mesh: Material, ends: Indices, stiffness: Array) -> Array:
    """C (3, 3), N/m, of springs (S, 2) with k (S,), N/m, in the mean directions of the triangles at their ends."""
    total = np.zeros((2, len(mesh.positions), 3))
    axes = mesh.warp.copy()
    axes[axes @ np.array([1.0, 1e-3, 1e-6]) < 0] *= -1  # a direction and its opposite are one
    for own, sums in zip((axes, np.cross(np.cross(mesh.warp, mesh.weft), axes)), total, strict=True):
        np.add.at(sums, mesh.triangles, np.repeat(own[:, None], 3, axis=1))
    e = mesh.positions[ends[:, 1]] - mesh.positions[ends[:, 0]]
    c, s = ((e * (each[ends[:, 0]] + each[ends[:, 1]])).sum(axis=1) for each in total)
    length2 = (e * e).sum(axis=1)
    squares = np.stack([c * c, s * s, 2 * c * s], axis=1) / np.maximum(c * c + s * s, 1e-300)[:, None]
    return tensor(squares, stiffness * length2, mesh.area)


def pulls(stiffness: Array) -> Array:
    """Stiffness along warp, weft and bias (3,), N/m, in a pull test whose sides are free; 0 where nothing resists. Of
    the two bias directions, which differ where all diagonals of a grid are parallel, it is the geometric mean.
    """
    full = stiffness * np.outer(TWICE, TWICE)  # of the strains 11, 22 and 12, the last once
    scale = np.abs(full).max()
    if not scale > 0:
        return np.zeros(3)
    values, vectors = np.linalg.eigh(full / scale)
    load = PULLS * TWICE @ vectors
    soft = values < 1e-9  # a mode that nothing resists
    gives = (np.abs(load) > 1e-6) & soft
    compliance = ((load**2)[:, ~soft] / values[~soft]).sum(axis=1)
    made = np.where(gives.any(axis=1) | (compliance == 0), 0.0, scale / np.where(compliance > 0, compliance, 1.0))
    return both_ways(made)


def both_ways(four: Array) -> Array:
    """Warp, weft and bias (3,) of stiffnesses along warp, weft and both bias directions (4,)."""
    return np.array([four[0], four[1], np.sqrt(four[2]) * np.sqrt(four[3])])


def wanted(stretch: Array) -> Array:
    """C (3, 3), N/m, whose pulls along warp, weft and bias are these (3,), N/m, all above 0.

    a and b follow from c by 1/E₁ = b/(ab − c²): with t = c²/(ab), a = E₁/(1 − t), b = E₂/(1 − t). c is found so that
    the bias is right; where it is more than a cloth of springs can have, it is as much as that.
    """
    warp, weft, bias = np.asarray(stretch, float)

    def made(t: float) -> Array:
        a, b = warp / (1 - t), weft / (1 - t)
        c = np.sqrt(t * a * b)
        return np.array([[a, c, 0.0], [c, b, 0.0], [0.0, 0.0, c]])

    low, high = 1e-12, 0.3
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if pulls(made(middle))[2] < bias else (low, middle)
    return made(0.5 * (low + high))


def plain_rule(mesh: Material, stiffness: Array, squares: Array) -> Array:
    """Stiffnesses (E,), N/m, of the edges by their directions: k = (d d : C : d d) ΣA / L², with the areas at each."""
    along = np.einsum("ei,ij,ej->e", squares, stiffness, squares)
    area = np.bincount(mesh.of.reshape(-1), np.repeat(mesh.areas, 3), len(mesh.ends))
    e = mesh.positions[mesh.ends[:, 1]] - mesh.positions[mesh.ends[:, 0]]
    return np.asarray(along * area / np.maximum((e * e).sum(axis=1), 1e-300))


def measured(mesh: Material, ends: Indices, stiffness: Array) -> Array:
    """Stiffness along warp, weft and bias, and in shear (4,), N/m, of a mesh of springs (S, 2) with k (S,), N/m.

    The vertices, free to move along the surface, are loaded as a uniform stress would load them; what gives way is the
    compliance. Other than C, which holds all strains uniform, this is right for an irregular mesh too. 0 where nothing
    resists.
    """
    count = len(mesh.positions)
    if not mesh.area > 0 or not (stiffness > 0).any():
        return np.zeros(4)
    frames = _frames(mesh)
    e = mesh.positions[ends[:, 1]] - mesh.positions[ends[:, 0]]
    unit = e / np.maximum(np.linalg.norm(e, axis=1), 1e-300)[:, None]
    values = np.concatenate([sign * np.einsum("skj,sj->sk", frames[ends[:, end]], unit)
                             for end, sign in ((0, -1.0), (1, 1.0))], axis=1)  # fmt: skip
    columns = np.concatenate([2 * ends[:, [end]] + [0, 1] for end in (0, 1)], axis=1)
    stresses = (*PULLS, np.array([0.0, 0.0, 1.0]))
    loads = np.stack([np.einsum("nkj,nj->nk", frames, _stress_forces(mesh, each)).reshape(-1) for each in stresses])
    solve = _dense if count <= SMALL else _sparse
    given = (loads * solve(values, columns, stiffness, 2 * count, loads.T).T).sum(axis=1)
    found = np.where(given > 0, mesh.area / np.where(given > 0, given, 1.0), 0.0)
    found = np.where(found > RESISTS * found.max(), found, 0.0)
    return np.append(both_ways(found[:4]), found[4])


def _dense(values: Array, columns: Slots, stiffness: Array, size: int, loads: Array) -> Array:
    """K⁻¹ of loads (size, L), for K = Σ k b bᵀ of springs whose b have these values (S, 4) in these columns, without
    the libraries for sparse matrices, which take longer to load.
    """
    matrix = np.zeros((size, size))
    np.add.at(matrix, (columns[:, :, None], columns[:, None]), stiffness[:, None, None] * values[:, :, None]
              * values[:, None])  # fmt: skip
    matrix[np.diag_indices(size)] += GROUND * stiffness.max()
    return np.asarray(np.linalg.solve(matrix, loads), float)


def _sparse(values: Array, columns: Slots, stiffness: Array, size: int, loads: Array) -> Array:
    """The same of many vertices."""
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import splu

    rows = np.repeat(np.arange(len(values)), 4)
    rise = coo_array((values.reshape(-1), (rows, columns.reshape(-1))), shape=(len(values), size)).tocsr()
    matrix = rise.T @ diags_array(stiffness) @ rise + diags_array(np.full(size, GROUND * stiffness.max()))
    return np.asarray(splu(matrix.tocsc()).solve(loads))


def _frames(mesh: Material) -> Array:
    """Two unit vectors in the surface at each vertex (n, 2, 3)."""
    normal = vertex_normals(mesh)
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
    first /= np.maximum(np.linalg.norm(first, axis=1), 1e-300)[:, None]
    return np.stack([first, np.cross(normal, first)], axis=1)


def springs_for(mesh: Material, stiffness: Array) -> Array:
    """Stiffnesses (E,), N/m, of the edges."""
    from scipy.sparse import coo_array

    squares, ends = edge_squares(mesh), mesh.ends
    rule = plain_rule(mesh, stiffness, squares)
    rule = np.maximum(rule, 1e-6 * rule.max())
    e = mesh.positions[ends[:, 1]] - mesh.positions[ends[:, 0]]
    count, springs = len(mesh.positions), len(ends)
    own = vertex_areas(mesh)
    scale = np.abs(stiffness).max()
    half = squares / TWICE
    energy = rule * (e * e).sum(axis=1) / scale / 2
    rows, columns, values, right = [], [], [], []
    spring = np.arange(springs)
    for row, (i, j) in enumerate(((0, 0), (1, 1), (0, 1), (0, 2), (1, 2))):
        weight = SKEW if 2 in (i, j) else 1.0
        for end in (0, 1):
            rows.append(ends[:, end] + count * row)
            columns.append(spring)
            values.append(weight * half[:, i] * half[:, j] * energy / own[ends[:, end]])
        right.append(np.full(count, weight * stiffness[i, j] / scale))
    for way in range(3):  # a unit strain 11, 22, and 12 with 21
        pull = (rule * squares[:, way])[:, None] * e
        for axis in range(3):
            for end, sign in ((0, -1.0), (1, 1.0)):
                rows.append(ends[:, end] + count * (5 + 3 * way + axis))
                columns.append(spring)
                values.append(BALANCE * sign * pull[:, axis] / np.sqrt(own[ends[:, end]]) / scale)
        loads = _stress_forces(mesh, stiffness[:, way] * (2.0 if way == 2 else 1.0)) / np.sqrt(own)[:, None] / scale
        right.append(BALANCE * loads.T.reshape(-1))
    matrix = coo_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
                       shape=(14 * count, springs)).tocsr()  # fmt: skip
    target = np.concatenate(right)
    x = shares(matrix, target)
    return np.asarray(rule * x)


def _stress_forces(mesh: Material, stress: Array) -> Array:
    """Forces (n, 3), N, of linear triangles under a uniform stress (11, 22, 12), N/m, on what holds the vertices."""
    at = mesh.positions[mesh.triangles]
    normal = np.cross(mesh.warp, mesh.weft)
    forces = np.zeros_like(mesh.positions)
    for corner in range(3):
        side = at[:, (corner + 2) % 3] - at[:, (corner + 1) % 3]
        gradient = np.cross(normal, side) / 2  # area times the gradient of the vertex's shape function
        c, s = (gradient * mesh.warp).sum(axis=1), (gradient * mesh.weft).sum(axis=1)
        first, second = stress[0] * c + stress[2] * s, stress[2] * c + stress[1] * s
        force = first[:, None] * mesh.warp + second[:, None] * mesh.weft
        np.add.at(forces, mesh.triangles[:, corner], force)
    return forces
