"""The fabric of a cloth: what its masses and springs are per area and per width, on whatever mesh; and the way back.

    density      masses over areas, kg/m²
    stretch      force per width over strain in a pull test, along warp, weft and bias, N/m (`membrane`)
    shear        stiffness against a change of the angle between warp and weft, N/m
    bending      secant bending stiffness along warp, weft and bias, N m (`bending`), at CURVATURE or, where the mesh is
                 too coarse for that, at the curvature that folds a hinge by about a radian
    bending at rest   the same for small bends: 0 where the bending springs are at rest in a flat cloth

n vertices, S springs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.fabric import bending, hinges, membrane
from clothfit.fabric.bending import CURVATURE, EXCESS
from clothfit.fabric.hinges import Hinges, Material
from clothfit.scene.cloth import Cloth
from clothfit.scene.directions import Keys, Slots, edges_of, keys

ROUNDS = 10
"""Most corrections of what is asked of the springs by what they do on an irregular mesh."""

CLOSE = 2e-3
"""Relative difference from what is wanted at which these end."""

WEIGHTS = np.array([1.0, 1.0, 0.1])
"""Of warp, weft and bias, where a mesh cannot have all."""

PULL = 0.5
"""Most that edges may be strained to hold bending springs; those that are too soft for it are made stiffer."""

LARGEST = 50_000
"""Vertices up to which a mesh is loaded to see how it gives way; in a larger one uniform strains are taken."""

Three = tuple[float, float, float]


@dataclass(frozen=True)
class Fabric:
    """What a cloth is made of; directions are warp, weft and bias."""

    density: float  # kg/m²
    stretch: Three  # N/m
    shear: float  # N/m
    bending: Three  # N m, secant at `curvature`
    bending_at_rest: Three  # N m
    curvature: float  # 1/m

    @property
    def bends(self) -> bool:
        """Whether its bending says something of the cloth, and not of how coarse its mesh is."""
        return self.curvature == CURVATURE or min(self.bending_at_rest) > 0


class Woven(NamedTuple):
    """Springs and masses of a fabric on a mesh."""

    ends: Indices  # (S, 2), the smaller index first
    stiffness: Array  # (S,), N/m
    rest: Array  # (S,), m
    mass: Array  # (n,), kg


@lru_cache(maxsize=4)
def fabric_of(cloth: Cloth) -> Fabric | None:
    """The fabric of an object; None where it has no faces with an area, or no springs."""
    mesh = material_of(cloth)
    if mesh is None:
        return None
    stretch = _stretch(mesh, cloth.springs, cloth.stiffness)
    linear, cubic, own = _hinges(mesh, cloth, stretch)
    share = bending.relaxed(mesh, own, linear) if len(mesh.positions) <= LARGEST else np.ones(3)
    curvature = min(CURVATURE, 1.0 / float(np.median(own.length))) if len(own.length) else CURVATURE
    rest, secant = (share * bending.secant(mesh, own, linear, 0 * linear, 1.0),
                    share * bending.secant(mesh, own, linear, cubic, curvature))  # fmt: skip
    return Fabric(float(cloth.mass.sum()) / mesh.area, _three(stretch[:3]), float(stretch[3]), _three(secant),
                  _three(rest), curvature)  # fmt: skip


def rows_of(own: Fabric | None) -> dict[str, str]:
    """The same for people, by names."""
    if own is None:
        return dict.fromkeys(("fabric", "stretch, shear", "bending"), "none")
    stretch, bent, flat = (" / ".join(f"{value:.3g}" for value in values) for values in (
        own.stretch, [1e6 * each for each in own.bending], [1e6 * each for each in own.bending_at_rest]
    ))  # fmt: skip
    return {
        "fabric": f"{1e3 * own.density:.4g} g/m²",
        "stretch, shear": f"{stretch} N/m warp/weft/bias, {own.shear:.3g} N/m",
        "bending": f"{bent} µN m at a radius of {100 / own.curvature:.3g} cm, {flat} when flat",
    }


def _three(values: Array) -> Three:
    first, second, third = values.tolist()
    return first, second, third


def material_of(cloth: Cloth) -> Material | None:
    """The mesh of an object and its directions."""
    if not len(cloth.triangles) or not len(cloth.springs) or not (cloth.areas > 0).any():
        return None
    given = cloth.layout
    along = across = None
    if given.warp is None and given.family is not None:
        edges = edges_of(cloth.triangles).ends
        along, across = hinges.named_edges(edges, cloth.springs, given.names, given.family)
        if not (along.any() and across.any()):
            along = across = None
    return hinges.material(cloth.positions, cloth.triangles, given.warp, along, across)


def _stretch(mesh: Material, ends: Indices, stiffness: Array) -> Array:
    """Stiffness along warp, weft and bias, and in shear (4,), N/m."""
    if len(mesh.positions) <= LARGEST:
        return membrane.measured(mesh, ends, stiffness)
    full = membrane.of_springs(mesh, ends, stiffness)
    return np.append(membrane.pulls(full), full[2, 2])


def _hinges(mesh: Material, cloth: Cloth, stretch: Array) -> tuple[Array, Array, Hinges]:
    """c and k g² (H,), N m, of all hinges that a spring may lie over, and those.

    What pushes a bent cloth also stretches it: the springs' k counts in series with the rest of the cloth.
    """
    own = hinges.all_hinges(mesh)
    chord = keys(own.vertices[:, :2])
    spring, there = _matched(chord, _rank(chord) + np.isin(chord, keys(mesh.ends)), keys(cloth.springs))
    stiffness = np.where(there, cloth.stiffness[spring], 0.0)
    push = stiffness * (cloth.rest[spring] - own.length)
    push = np.where(push > 1e-9 * stiffness * own.length, push, 0.0)
    area = mesh.areas[own.triangle].sum(axis=1) / 2
    over = stiffness * own.length**2 / np.maximum(area, 1e-300)
    c2, s2 = np.abs(own.moment[:, :2]).T / np.maximum(np.abs(own.moment[:, :2]).sum(axis=1), 1e-300)[:, None].T
    rest = np.maximum(_along(stretch, c2, s2) - over, 1e-3 * over)
    cubic = stiffness * own.lever**2 * rest / np.maximum(rest + over, 1e-300)
    return push * own.lever, cubic, own


def _rank(key: Keys) -> Slots:
    """How many of the keys (N,) before each are the same."""
    order = np.argsort(key, kind="stable")
    _, start, count = np.unique(key[order], return_index=True, return_counts=True)
    rank = np.empty(len(key), np.intp)
    rank[order] = np.arange(len(key)) - np.repeat(start, count)
    return rank


def _matched(wanted: Keys, rank: Slots, springs: Keys) -> tuple[Slots, Flags]:
    """Which of the springs (S,) is the one of this rank with each key (H,), and whether there is one: at an edge, and
    over two hinges between the same vertices, there are several.
    """
    order = np.lexsort((_rank(springs), springs))
    at = np.searchsorted(springs[order], wanted) + rank
    inside = np.minimum(at, len(springs) - 1)
    return order[inside], (at < len(springs)) & (springs[order][inside] == wanted)


def _along(stretch: Array, c2: Array, s2: Array) -> Array:
    """Stiffness (N,), N/m, of a pull in directions with these squares of components."""
    one, two, bias = 1 / np.maximum(stretch[:3], 1e-6 * stretch.max() + 1e-300)
    compliance = c2 * c2 * one + s2 * s2 * two + c2 * s2 * (4 * bias - one - two)
    return np.asarray(1 / np.maximum(compliance, 1e-2 * min(one, two)))


def woven(
    positions: Array, triangles: Indices, density: float, stretch: Three, bend: Three, fixed: Flags | None = None,
    warp: Array | None = None,
) -> Woven:  # fmt: skip
    """The springs and masses of a fabric on a mesh that is flat at rest wherever it can be unfolded.

    `density` in kg/m², `stretch` in N/m and `bend` in N m along warp, weft and bias. A triangle all of whose vertices
    are `fixed` (n,) cannot bend, and a hinge at it has twice the stiffness, as only its other half bends. Raises
    InvalidInput where a value is not above 0 (of bending, not at least 0), or the mesh has no area.
    """
    if not (density > 0 and min(stretch) > 0 and min(bend) >= 0 and np.isfinite([density, *stretch, *bend]).all()):
        raise InvalidInput("a fabric needs a density and stretch above 0, and bending of 0 or more")
    mesh = hinges.material(positions, triangles, warp)
    if not mesh.area > 0:
        raise InvalidInput("a fabric needs a mesh with an area")
    own = hinges.hinges_of(mesh)
    fold = _folds(mesh, own, np.array(bend, float))
    if fixed is not None:
        held = fixed[own.vertices]
        fold = fold * np.where(held[:, 2:].all(axis=1) & (held[:, 0] != held[:, 1]), 2.0, 1.0)
    kept = fold > 0
    over, push, flat = own.vertices[kept, :2], (fold / own.lever)[kept], own.length[kept]
    edge = _membrane(mesh, np.array(stretch, float), over, push / (EXCESS * flat))
    held_by = _held(mesh, own, fold)
    edge = np.maximum(edge, np.abs(held_by) / PULL)
    length = np.linalg.norm(positions[mesh.ends[:, 0]] - positions[mesh.ends[:, 1]], axis=1)
    return Woven(
        np.concatenate([mesh.ends, np.sort(over, axis=1)]).astype(np.int32),
        np.concatenate([edge, push / (EXCESS * flat)]),
        np.concatenate([length * (1 - held_by / edge), flat * (1 + EXCESS)]),
        _masses(mesh, density),
    )  # fmt: skip


def with_springs_at_rest(mesh: Material, density: float, stretch: Three, over: Indices, stiffness: Array) -> Woven:
    """The springs and masses of a fabric whose bending springs `over` hinges (N, 2), N/m, are at rest when flat."""
    edge = _membrane(mesh, np.array(stretch, float), over, stiffness)
    ends = np.concatenate([mesh.ends, np.sort(over, axis=1)]).astype(np.int32)
    length = np.linalg.norm(mesh.positions[ends[:, 0]] - mesh.positions[ends[:, 1]], axis=1)
    return Woven(ends, np.concatenate([edge, stiffness]), length, _masses(mesh, density))


def _masses(mesh: Material, density: float) -> Array:
    """Masses (n,), kg. Raises InvalidInput where a vertex would have none."""
    mass = density * hinges.vertex_areas(mesh)
    if not mass.all():
        raise InvalidInput(f"vertex {mass.argmin()} has no mass, being in no triangle that has an area; remove it")
    return mass


def longest_step(cloth: Cloth, bend: Three) -> float:
    """The time step, s, up to which the step of second order follows a cloth whose bending springs push (longer ones
    shake it): √(5 m / B) times the median length of its springs, with m the mean mass of a vertex.
    """
    most = max(bend)
    return float(np.median(cloth.lengths) * np.sqrt(5 * cloth.mass.mean() / most)) if most > 0 else np.inf


def _held(mesh: Material, own: Hinges, fold: Array) -> Array:
    """Force densities (E,), N/m, of the edges that hold hinges with these stiffnesses (H,), N m, in the plane."""
    key = keys(mesh.ends)
    found = np.zeros(len(key))
    for i, j in ((0, 2), (0, 3), (1, 2), (1, 3), (2, 3)):
        density = -fold * own.weights[:, i] * own.weights[:, j]
        use = np.flatnonzero(density)
        np.add.at(found, np.searchsorted(key, keys(own.vertices[use][:, [i, j]])), density[use])
    return found


def _membrane(mesh: Material, stretch: Array, over: Indices, stiffness: Array) -> Array:
    """Stiffnesses of the edges, N/m, that pull as wanted (3,), N/m, together with springs `over` hinges (N, 2), N/m.

    First what is asked of balanced springs is corrected by what they do; where that does not do for warp and weft, then
    the springs by their directions.
    """
    ends = np.concatenate([mesh.ends, over])
    c2, s2, _ = hinges.edge_squares(mesh).T
    parts = np.stack([c2 * c2, s2 * s2, 4 * c2 * s2])  # of warp, weft and bias; a diagonal is the bias's alone
    parts /= parts.sum(axis=0)
    asked, edge, best, least = stretch.copy(), np.zeros(0), np.zeros(0), np.inf
    for trial in range(2 * ROUNDS):
        if trial < ROUNDS:
            edge = membrane.springs_for(mesh, membrane.wanted(asked))
        ratio = np.maximum(_stretch(mesh, ends, np.concatenate([edge, stiffness]))[:3] / stretch, 1e-3)
        wrong = np.abs(np.log(ratio))
        if (error := float(wrong @ WEIGHTS)) < least:
            best, least = edge, error
        if error < CLOSE or (trial >= ROUNDS - 1 and wrong[:2].max() < 5 * CLOSE):
            break
        asked = asked / np.clip(ratio, 0.5, 2.0)
        asked[2] = min(asked[2], 1.5 * asked[:2].max())
        if trial >= ROUNDS - 1:
            edge = edge * np.exp(-np.log(np.clip(ratio, 0.5, 2.0)) @ parts)
    return best


def _folds(mesh: Material, own: Hinges, bend: Array) -> Array:
    """Stiffnesses of the hinges, N m, with these bending stiffnesses (3,)."""
    if not bend[:2].any() or not len(own.edge):
        return np.zeros(len(own.edge))
    bend = np.maximum(bend, 1e-3 * bend.max())
    asked, best, least = bend.copy(), None, np.inf
    for _ in range(ROUNDS):
        fold = bending.folds_for(mesh, own, bending.wanted(asked))
        share = bending.relaxed(mesh, own, fold) if len(mesh.positions) <= LARGEST else np.ones(3)
        ratio = share * bending.secant(mesh, own, fold, 0 * fold, 1.0) / bend
        if (error := float(np.abs(np.log(np.maximum(ratio, 1e-3))) @ WEIGHTS)) < least:
            best, least = fold, error
        if error < CLOSE:
            break
        asked = asked / np.clip(ratio, 0.5, 2.0)
    assert best is not None
    return best
