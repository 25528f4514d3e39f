"""Which parameters a motion can reveal: those that act on a free vertex that the target shows, or on one joined to it.

This is structure alone; how well the data determine a value is for `fit/confidence`.

Which fitted values are hard to tell apart: the correlations of their errors.

Where the errors of two values have a correlation near 1 or −1, the motion determines a combination of the two much
better than each alone: masses and stiffnesses that grow together, a spring and its neighbour. The interval of each is
then wide, and another fit may share out their sum, or their difference, in another way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags
from clothfit.base.eigen import connected_components
from clothfit.scene.block import Block, reached
from clothfit.scene.cloth import Cloth
from clothfit.scene.fit_vector import size
from clothfit.scene.scene import Scene

Seen = Mapping[int, Flags] | None
"""For each fitted cloth, the vertices (n,) that a target shows; None: all."""


def unobservable(cloth: Cloth, name: str, colliders: int, seen: Flags | None = None) -> Flags:
    """Flags of the values of a kind, one per vertex (n,), per spring (S,) or for all (1,), that a motion cannot reveal.

    It hides masses and velocities of fixed vertices; masses where only weight and node damping move a vertex, so that
    they cancel; stiffnesses and rest lengths between two fixed vertices, and rest lengths of springs without stiffness;
    drag and wind where the air meets no free vertex; what belongs to colliders where there are none; everything of a
    cloth that is fixed; of pins' paths the key that the start has, and all of those that lead nothing. Where `seen`
    (n,) gives the vertices that a target shows, it also hides all of the parts of the cloth in which no free vertex is
    seen.
    """
    shown = ~cloth.fixed if seen is None else ~cloth.fixed & observable_vertices(cloth, seen)
    if name in ("stiffness", "rest"):
        slack = (cloth.stiffness == 0) & (name == "rest" and cloth.mode("stiffness") == "n")
        return np.asarray(~shown[cloth.springs].any(axis=1) | slack)
    if name == "velocity":
        return np.asarray(~shown)
    if name in ("path", "shift"):
        return unobservable_paths(cloth, name, shown, seen)
    if name in ("drag", "wind", "gusts"):
        return np.array([not (cloth.feels_air and shown[cloth.triangles].any())])
    if name in ("damping", "gravity"):
        return np.array([not shown.any()])
    if name in ("friction", "contact", "offset"):
        return np.array([not (colliders > 0 and shown.any())])
    pushed = np.full(len(cloth.mass), colliders > 0)
    pushed[cloth.springs.reshape(-1)] = True
    if cloth.feels_air:
        pushed[cloth.triangles.reshape(-1)] = True
    return np.asarray(~shown | ~pushed)


def unobservable_paths(cloth: Cloth, name: str, shown: Flags, seen: Flags | None) -> Flags:
    """The same of the keys of pins' paths, (K,), or of their offset, (1,): pins lead free vertices, `shown` (n,), and
    may be seen themselves.
    """
    moves = shown | (cloth.fixed if seen is None else seen & cloth.fixed)
    for links in (cloth.springs, cloth.triangles if cloth.feels_air else cloth.triangles[:0]):
        moves = moves.copy()
        moves[links[shown[links].any(axis=1)]] = True
    found = np.array([not moves[pin.vertices].any() for pin in cloth.pins], bool)
    if name == "shift":
        return np.array([found.all()])
    return np.asarray(found[cloth.key_pins] | (cloth.datums == np.arange(len(cloth.path))))


def observable_vertices(cloth: Cloth, seen: Flags) -> Flags:
    """Which vertices (n,) springs and faces of free vertices join to a free vertex that is seen."""
    free, n = ~cloth.fixed, len(cloth.mass)
    faces = cloth.triangles if cloth.feels_air else cloth.triangles[:0]
    pairs = np.concatenate([cloth.springs, faces[:, :2], faces[:, 1:], faces[:, ::2]])
    pairs = pairs[free[pairs].all(axis=1)]  # a fixed vertex passes nothing on
    part = connected_components(pairs, n)
    return np.isin(part, part[free & seen])


def identifiable(scene: Scene, seen: Seen = None) -> Flags:
    """Which entries of the fit vector (P,) a motion can reveal; `seen` as above (default: all)."""
    kept = np.ones(size(scene), bool)
    for block in scene.blocks:
        cloths = reached(scene.cloths, block.name) if block.cloth is None else [block.cloth]
        shown = [None if seen is None else seen[i] for i in cloths]
        pushes = scene.obstacles + (scene.self_contact is not None)
        masks = [unobservable(scene.cloths[i], block.name, pushes, s) for i, s in zip(cloths, shown, strict=True)]
        if block.factors is not None:
            kept[block.part] = block.factors.acting(~masks[0])
        elif block.mode == "G" or block.cloth is None:
            kept[block.part] = not all(mask.all() for mask in masks)
        else:
            kept[block.part] = ~np.repeat(masks[0], block.kind.components)
    return kept


FEW, NOTABLE, STRONG = 8, 0.5, 0.9
"""Of up to so many values the pairs with a notable correlation are listed, of more those with a strong one."""

MOST = 20  # pairs that are listed, the strongest ones


@dataclass(frozen=True)
class Value:
    """One fitted value."""

    object: int | None  # None: of the scene as a whole
    name: str  # of the kind
    index: int  # within its block; of a vector its component


@dataclass(frozen=True)
class Correlation:
    """How the errors of two fitted values go together."""

    first: Value
    second: Value
    correlation: float  # −1 … 1


def strongest(matrix: Array, places: NDArray[np.intp], blocks: Sequence[Block]) -> tuple[Correlation, ...]:
    """The strongest correlations of a covariance matrix (F, F) of the parameters at `places` (F,) of the fit vector,
    strongest first; of parameters without a variance none.
    """
    deviation = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.abs(matrix / np.outer(deviation, deviation))
    found = np.triu(np.where(np.isfinite(found), found, 0.0), 1)
    rows, columns = np.nonzero(found >= (NOTABLE if len(places) <= FEW else STRONG))
    order = np.argsort(-found[rows, columns], kind="stable")[:MOST]
    return tuple(
        Correlation(
            value_at(int(places[i]), blocks), value_at(int(places[j]), blocks),
            float(np.clip(matrix[i, j] / (deviation[i] * deviation[j]), -1.0, 1.0)),
        )
        for i, j in zip(rows[order], columns[order], strict=True)
    )  # fmt: skip


def value_at(place: int, blocks: Sequence[Block]) -> Value:
    """The value at a place of the fit vector."""
    (block,) = (each for each in blocks if each.part.start <= place < each.part.stop)
    return Value(block.cloth, block.name, place - block.part.start)
