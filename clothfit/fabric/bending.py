"""Bending stiffness of a cloth of springs, and springs for a given one.

A bending spring joins the vertices p and q opposite an edge. Its length l, when the hinge is folded by θ, is shorter
by ½ g θ² with the lever g = h₁ h₂ / l: only in second order. At its rest length, as the editor makes it, it therefore
does not resist a small fold at all: its energy is ⅛ k g² θ⁴. One that is longer at rest than the flat hinge lets it be
pushes with t = k (L₀ − l); the edges of the hinge hold it in the plane, and its energy in a fold is

    ½ c θ² + ⅛ k g² θ⁴,   c = t g.

That is a linear bending stiffness, as of an elastic plate. The forces between the four vertices are exactly those of
the energy ½ c (Σ λᵢ zᵢ)², force densities −c λᵢ λⱼ: the quadratic bending energy of M. Bergou et al., A quadratic
bending model for inextensible surfaces, SGP 2006, made of springs. With θ = κ : M of a curvature κ (`hinges`) the
energy per area of a cloth bent to a cylinder of curvature κ is w(κ), from which

    B(κ) = 2 w / κ²

is the secant bending stiffness, N m, and B(0) the one at rest: 0 for a cloth whose springs are at rest.

Components as in `hinges`. H hinges.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.eigen import pseudo_inverse
from clothfit.fabric.balance import shares
from clothfit.fabric.hinges import Hinges, Material, vertex_areas
from clothfit.fabric.membrane import PULLS, TWICE

CURVATURE = 10.0
"""1/m, at which the secant bending stiffness is given: a bend with a radius of 10 cm."""

EXCESS = 1.0
"""How much longer than the flat hinge a bending spring is at rest, as a share: the more, the less its push changes."""

BALANCE = 0.3
"""Weight of the balance of forces, against that of the stiffness around each vertex."""


def inside(mesh: Material, hinges: Hinges) -> tuple[Flags, Array]:
    """Vertices (n,) all of whose surroundings have hinges, and the areas (n,), m², of all vertices."""
    bare = np.ones(len(mesh.ends), bool)
    bare[hinges.edge[hinges.edge >= 0]] = False
    rows = np.zeros((2, len(mesh.positions)), bool)
    own = hinges.edge < 0
    for way in (0, 1):
        rows[way, hinges.vertices[own & (hinges.moment[:, way] > 0), 2]] = True
    bare[(mesh.across & rows[0][mesh.ends].all(axis=1)) | (mesh.along & rows[1][mesh.ends].all(axis=1))] = False
    bare |= mesh.uses < 2
    poor = bare[mesh.of].any(axis=1)  # triangles with a side that is no hinge
    whole = np.zeros(len(mesh.positions), bool)
    whole[mesh.triangles] = True
    whole[mesh.triangles[poor]] = False
    return whole, vertex_areas(mesh)


def secant(mesh: Material, hinges: Hinges, linear: Array, cubic: Array, curvature: float) -> Array:
    """B (3,), N m, along warp, weft and bias at a curvature, 1/m, of hinges with c (H,), N m, and k g² (H,), N m.

    The mean over the vertices that are far enough from the border to have all their hinges; where there is none, over
    the areas of the hinges.
    """
    fold = hinges.moment @ (PULLS * TWICE).T * curvature  # (H, 4)
    energy = 0.5 * linear[:, None] * fold**2 + 0.125 * cubic[:, None] * fold**4
    whole, area = inside(mesh, hinges)
    share = parts(hinges, whole)
    total = area[whole].sum()
    if not total > 0:
        share, total = np.ones(len(hinges.edge)), mesh.areas[hinges.triangle].sum() / 3
    scale = 0.5 * max(curvature, 1e-300) ** 2
    return mean_bias(share @ energy / scale / total) if total > 0 else np.zeros(3)


def mean_bias(four: Array) -> Array:
    """Warp, weft and bias (3,) of values along warp, weft and both bias directions (4,)."""
    return np.array([four[0], four[1], (four[2] + four[3]) / 2])


def parts(hinges: Hinges, chosen: Flags) -> Array:
    """The part (H,) of each hinge that belongs to chosen vertices: a quarter each, of a row the one in the middle."""
    own = chosen[hinges.vertices]
    return np.where(hinges.edge < 0, own[:, 2], own.mean(axis=1))


def relaxed(mesh: Material, hinges: Hinges, linear: Array) -> Array:
    """What is left (3,), as a share, of the stiffness against a uniform curvature along warp, weft and bias where the
    vertices find their own heights, all but those at the border; 1 on a regular mesh.

    Hinges of triangles also bend the other way, by about a quarter. So along warp and weft a strip, whose sides may
    curl, is up to a tenth softer than a wide cloth, and what is given is the geometric mean of both.
    """
    whole, _ = inside(mesh, hinges)
    fold = hinges.moment * TWICE
    if not whole.any() or not (linear > 0).any() or _balanced(mesh, hinges, linear, whole, fold):
        return np.ones(3)
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import splu

    rows = np.repeat(np.arange(len(linear)), 4)
    rise = coo_array((hinges.weights.reshape(-1), (rows, hinges.vertices.reshape(-1))),
                     shape=(len(linear), len(mesh.positions))).tocsc()[:, np.flatnonzero(whole)]  # fmt: skip
    matrix = rise.T @ diags_array(linear) @ rise
    matrix = matrix + diags_array(np.full(len(matrix.diagonal()), 1e-9 * matrix.diagonal().max()))
    left = fold - rise @ splu(matrix.tocsc()).solve(rise.T @ (linear[:, None] * fold))
    weight = (linear * parts(hinges, whole))[:, None]
    plate, after = fold.T @ (weight * fold), left.T @ (weight * left)
    energy, rest = (((PULLS @ each) * PULLS).sum(axis=1) for each in (plate, after))
    share = mean_bias(rest / np.where(energy > 0, energy, 1.0))
    strip = 1 / np.maximum(np.diag(pseudo_inverse(after)) * np.diag(after), 1.0)
    share[:2] *= np.sqrt(strip[:2])
    return share


def _balanced(mesh: Material, hinges: Hinges, linear: Array, whole: Flags, fold: Array) -> bool:
    """Whether uniform curvatures need no other heights of the inner vertices, as on a grid."""
    moment = linear[:, None] * fold
    for way in moment.T:
        force = (way[:, None] * hinges.weights).reshape(-1)
        at = hinges.vertices.reshape(-1)
        total, size = (np.bincount(at, each, len(mesh.positions)) for each in (force, np.abs(force)))
        if (np.abs(total)[whole] > 1e-6 * size.max()).any():
            return False
    return True


def wanted(bending: Array) -> Array:
    """The plate (3, 3), N m, by curvatures (11, 22, 12), with these bending stiffnesses (3,) along warp, weft and bias.

    Bending one way does not bend it the other way; the bias says how much it resists being twisted, 0 at least.
    """
    warp, weft, bias = np.asarray(bending, float)
    return np.diag([warp, weft, max(bias - (warp + weft) / 4, 0.05 * min(warp, weft))])


def folds_for(mesh: Material, hinges: Hinges, plate: Array) -> Array:
    """Hinge stiffnesses c (H,), N m, of a mesh whose uniform curvatures have the energy ½ κ : plate : κ."""
    from scipy.sparse import coo_array

    if not len(hinges.edge):
        return np.zeros(0)
    whole, area = inside(mesh, hinges)
    full = plate * np.outer(TWICE, TWICE)
    size = np.abs(plate).max()
    across = hinges.moment / np.maximum(np.abs(hinges.moment).sum(axis=1), 1e-300)[:, None]
    stiff = np.einsum("hi,ij,hj->h", across, full, across) / np.maximum((across * TWICE * across).sum(axis=1), 1e-300)
    rule = np.maximum(stiff, 1e-3 * size) * hinges.rule
    count, number = len(mesh.positions), len(hinges.edge)
    order = np.arange(number)
    rows, columns, values, right = [], [], [], []
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    for row, (i, j) in enumerate(pairs):
        energy = rule * hinges.moment[:, i] * hinges.moment[:, j] / size / 4
        for corner in range(4):
            vertex = np.where(hinges.edge < 0, hinges.vertices[:, 2], hinges.vertices[:, corner])
            keep = whole[vertex]
            rows.append(vertex[keep] + count * row)
            columns.append(order[keep])
            values.append(energy[keep] / area[vertex[keep]])
        right.append(np.where(whole, plate[i, j] / size, 0.0))
    for way in range(3):
        for corner in range(4):
            vertex = hinges.vertices[:, corner]
            keep = whole[vertex]
            force = rule * hinges.moment[:, way] * hinges.weights[:, corner] / size
            rows.append(vertex[keep] + count * (6 + way))
            columns.append(order[keep])
            values.append(BALANCE * force[keep])
        right.append(np.zeros(count))
    matrix = coo_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
                       shape=(9 * count, number)).tocsr()  # fmt: skip
    target = np.concatenate(right)
    return np.asarray(rule * shares(matrix, target))
