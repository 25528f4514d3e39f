"""The fit vector: which masses and stiffnesses a scene flags, in which order, and the way there and back.

An object's `optimizationSettings` has two letters, masses then stiffnesses: n nothing, G one value for the whole
object, L one per vertex or spring. Parameters of all objects are concatenated in object order, masses before
stiffnesses.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clothfit.arrays import Array, Elements, Flags
from clothfit.errors import InvalidInput
from clothfit.scene import Cloth, Scene

LOWER, UPPER = 1e-4, 1e4
"""Bounds of every parameter, kg or N/m."""

AT_BOUND = 1e-9
"""How near to a bound counts as at it, relative: beyond the rounding of exp and log."""

NAMES = ("mass", "stiffness")

Seen = Mapping[int, Flags] | None
"""Of each fitted cloth, which vertices (n,) a target shows; None: all."""


@dataclass(frozen=True)
class Block:
    """The parameters of one kind of one cloth: a slice of the fit vector."""

    cloth: int  # index of the object
    name: str  # "mass" or "stiffness"
    mode: str  # "G" or "L"
    elements: int  # vertices or springs
    start: int  # place in the fit vector

    @property
    def count(self) -> int:
        """Number of parameters."""
        return 1 if self.mode == "G" else self.elements

    @property
    def part(self) -> slice:
        """Where they stand in the fit vector."""
        return slice(self.start, self.start + self.count)

    def reduce(self, per_element: Array) -> Array:
        """Gradient by the parameters (count,) from the gradient by the elements (elements,)."""
        return per_element if self.mode == "L" else per_element.sum(keepdims=True)

    def spread(self, p: Array) -> Array:
        """Value of every element (elements,) from the fit vector (P,)."""
        return np.broadcast_to(p[self.part], (self.elements,))


def at_lower(p: Array) -> Flags:
    """Which of the parameters p lie at the lower bound."""
    return np.asarray(p <= LOWER * (1 + AT_BOUND))


def at_upper(p: Array) -> Flags:
    """Which of the parameters p lie at the upper bound."""
    return np.asarray(p >= UPPER * (1 - AT_BOUND))


def blocks(scene: Scene) -> list[Block]:
    """What the scene flags, in the order of the fit vector."""
    found: list[Block] = []
    start = 0
    for index, cloth in enumerate(scene.cloths):
        for name, mode in zip(NAMES, cloth.settings, strict=True):
            elements = len(getattr(cloth, name))
            if mode != "n" and elements > 0:
                found.append(Block(index, name, mode, elements, start))
                start += found[-1].count
    return found


def size(scene: Scene) -> int:
    """Number of parameters P."""
    return sum(block.count for block in blocks(scene))


def fitted_cloths(scene: Scene) -> list[int]:
    """The objects that have parameters; a fit simulates these and no others."""
    return sorted({block.cloth for block in blocks(scene)})


def parameters(scene: Scene, flags: Scene | None = None) -> Array:
    """The flagged parameters (P,), kg and N/m: objects in order, mass before stiffness; mode G: the mean.

    `flags` is the scene whose settings say what is flagged, where that is another one. Raises InvalidInput when the
    objects of the two differ in size.
    """
    parts = []
    for block in blocks(flags or scene):
        values = getattr(scene.cloths[block.cloth], block.name) if block.cloth < len(scene.cloths) else np.zeros(0)
        if len(values) != block.elements:
            raise InvalidInput(
                f"{scene.name}: objects[{block.cloth}] has {len(values)} values of {block.name}, "
                f"{block.elements} are needed"
            )
        parts.append(values if block.mode == "L" else values.mean(keepdims=True))
    return np.concatenate(parts) if parts else np.zeros(0)


def with_parameters(scene: Scene, p: Sequence[float] | Array, untouched: Collection[Block] = ()) -> Scene:
    """Make a new scene with the flagged parameters p (P,); blocks that are `untouched` keep the scene's values.

    Raises InvalidInput (InvalidScene) on a bad shape or value.
    """
    values = check_shape(scene, p)
    masses = [cloth.mass for cloth in scene.cloths]
    stiffnesses = [cloth.stiffness for cloth in scene.cloths]
    for block in blocks(scene):
        if block in untouched:
            continue
        (masses if block.name == "mass" else stiffnesses)[block.cloth] = block.spread(values)
    return scene.with_values(masses, stiffnesses)


def check_shape(scene: Scene, p: Sequence[float] | Array) -> Array:
    """p as an array (P,). Raises InvalidInput when its length is not the scene's number of parameters."""
    values = np.asarray(p, float)
    if values.shape != (size(scene),):
        raise InvalidInput(f"parameters: shape {values.shape} given, {scene.name} has ({size(scene)},)")
    return values


def elements(scene: Scene, cloth: int, p: Array, absent: float | None = None) -> Elements:
    """Masses and stiffnesses of one cloth for the fit vector p (P,).

    What is not flagged has the scene's value, or `absent` where that is given (0 for directions).
    """
    source = scene.cloths[cloth]
    values = {
        name: getattr(source, name) if absent is None else np.full(len(getattr(source, name)), absent) for name in NAMES
    }
    for block in blocks(scene):
        if block.cloth == cloth:
            values[block.name] = block.spread(p)
    return Elements(*(np.array(values[name], float) for name in NAMES))


def hidden(cloth: Cloth, name: str, spheres: int, seen: Flags | None = None) -> Flags:
    """Which masses (n,) or stiffnesses (S,) of a cloth a motion of it cannot reveal, by structure.

    Masses: fixed vertices; vertices that only weight and node damping move, where the mass cancels. Stiffnesses:
    springs between two fixed vertices. And, where `seen` (n,) tells which vertices a target shows: all of the parts
    of the cloth in which no free vertex is seen.
    """
    told = ~cloth.fixed if seen is None else ~cloth.fixed & told_of(cloth, seen)
    if name == "stiffness":
        return np.asarray(~told[cloth.springs].any(axis=1))
    pushed = np.full(len(cloth.mass), spheres > 0)
    pushed[cloth.springs.reshape(-1)] = True
    if cloth.drag > 0:
        pushed[cloth.triangles.reshape(-1)] = True
    return np.asarray(~told | ~pushed)


def told_of(cloth: Cloth, seen: Flags) -> Flags:
    """Which vertices (n,) are joined to a free vertex that is seen, through springs and faces of free vertices."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    free, n = ~cloth.fixed, len(cloth.mass)
    faces = cloth.triangles if cloth.drag > 0 else cloth.triangles[:0]
    pairs = np.concatenate([cloth.springs, faces[:, :2], faces[:, 1:], faces[:, ::2]])
    pairs = pairs[free[pairs].all(axis=1)]  # a fixed vertex passes nothing on
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    return np.isin(part, part[free & seen])


def unidentifiable(scene: Scene, block: Block, seen: Seen = None) -> list[int]:
    """The parameters of a block that the motion cannot reveal, counted within the block (mode L: vertices or springs).

    `seen` tells of each fitted cloth which vertices (n,) a target shows (default: all).
    """
    own = None if seen is None else seen[block.cloth]
    mask = hidden(scene.cloths[block.cloth], block.name, len(scene.spheres), own)
    if block.mode == "G":
        return [0] if mask.all() else []
    return [int(i) for i in np.flatnonzero(mask)]


def identifiable(scene: Scene, seen: Seen = None) -> Flags:
    """Which entries of the fit vector (P,) can be fitted."""
    kept = np.ones(size(scene), bool)
    for block in blocks(scene):
        kept[block.start + np.array(unidentifiable(scene, block, seen), int)] = False
    return kept
