"""The fit vector: which values a scene flags, in which order, and the way there and back.

An object's `optimizationSettings` has two letters, masses then stiffnesses: n nothing, G one value for the whole
object, L one per vertex or spring; the `fit` of an object or of the scene flags the other `kinds` by the same letters.
Parameters of all objects are concatenated in object order, for each in the order of the kinds; those of the scene as a
whole come last. Vectors stand component by component.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from clothfit.base.arrays import Array, Elements, Flags
from clothfit.base.errors import InvalidInput
from clothfit.scene.block import Block
from clothfit.scene.kinds import CLOTH_KINDS, KIND, KINDS, LETTERED, SCENE_KINDS, Kind
from clothfit.scene.scene import Cloth, Scene

LOWER, UPPER = KIND["mass"].lower, KIND["mass"].upper
"""Bounds of masses and stiffnesses, kg or N/m; `bounds` gives those of every parameter."""

AT_BOUND = 1e-9
"""How near to a bound counts as at it, relative: beyond the rounding of exp and log."""

Seen = Mapping[int, Flags] | None
"""Of each fitted cloth, which vertices (n,) a target shows; None: all."""

def bounds(scene: Scene) -> tuple[Array, Array]:
    """Lower and upper bound (P,) of every parameter."""
    found = blocks(scene)
    lower, upper = ([np.full(b.count, getattr(b.kind, end)) for b in found] for end in ("lower", "upper"))
    return np.concatenate([np.zeros(0), *lower]), np.concatenate([np.zeros(0), *upper])


def at_lower(p: Array, lower: Array | float) -> Flags:
    """Which of the parameters p lie at their lower bounds."""
    return np.asarray(p <= lower + AT_BOUND * np.abs(lower))


def at_upper(p: Array, upper: Array | float) -> Flags:
    """Which of the parameters p lie at their upper bounds."""
    return np.asarray(p >= upper - AT_BOUND * np.abs(upper))


def blocks(scene: Scene) -> list[Block]:
    """What the scene flags, in the order of the fit vector."""
    found: list[Block] = []
    start = 0
    for cloth, kind, mode in _flagged(scene):
        owner = scene if cloth is None else scene.cloths[cloth]
        shape = np.shape(getattr(owner, kind.name)) or (1,)
        if np.prod(shape) > 0:
            unit = _unit(owner, kind) if mode == "G" and isinstance(owner, Cloth) else None
            found.append(Block(cloth, kind.name, mode, _moved(scene, cloth, kind), start, shape, unit))
            start += found[-1].count
    return found


def _flagged(scene: Scene) -> Iterator[tuple[int | None, Kind, str]]:
    """What the scene flags: of what cloth, what kind, in which mode."""
    for index, cloth in enumerate(scene.cloths):
        yield from ((index, kind, cloth.mode(kind.name)) for kind in CLOTH_KINDS if cloth.mode(kind.name) != "n")
    yield from ((None, kind, scene.mode(kind.name)) for kind in SCENE_KINDS if scene.mode(kind.name) != "n")


def _unit(cloth: Cloth, kind: Kind) -> Array | None:
    """What the one parameter of a kind is multiplied with at each spring or vertex."""
    if kind.name == "rest":
        return cloth.lengths
    return np.where(cloth.fixed, 0.0, 1.0) if kind.name == "velocity" else None


def _moved(scene: Scene, cloth: int | None, kind: Kind) -> int:
    """How many vertices or springs a kind moves, at least 1."""
    if cloth is None:
        return max(1, sum(scene.vertex_counts[i] for i in reached(scene, kind.name)))
    return len(scene.cloths[cloth].stiffness if kind.of == "spring" else scene.cloths[cloth].mass)


def feels_air(cloth: Cloth) -> bool:
    """Whether the air drags a cloth, or may do so in a fit."""
    return bool(len(cloth.triangles)) and (cloth.drag > 0 or cloth.mode("drag") != "n")


def reached(scene: Scene, name: str) -> list[int]:
    """The cloths that a kind of the scene as a whole can move: the wind those that feel the air."""
    return [i for i, cloth in enumerate(scene.cloths) if not cloth.fixed.all() and (name != "wind" or feels_air(cloth))]


def size(scene: Scene) -> int:
    """Number of parameters P."""
    return sum(block.count for block in blocks(scene))


def fitted_cloths(scene: Scene) -> list[int]:
    """The objects that have parameters or feel one of the scene's; a fit simulates these and no others."""
    found = blocks(scene)
    own = {block.cloth for block in found if block.cloth is not None}
    shared = {i for block in found if block.cloth is None for i in reached(scene, block.name)}
    return sorted(own | shared) or list(range(len(scene.cloths) if found else 0))


def parameters(scene: Scene, flags: Scene | None = None) -> Array:
    """The flagged values (P,), in SI units: of each object in turn its kinds in order, then those of the scene.

    A value that is flagged with G is the mean. `flags` is the scene whose flags count (default: `scene`). Raises
    InvalidInput when the objects of the two differ in size.
    """
    parts = [np.zeros(0)]
    for block in blocks(flags or scene):
        if block.cloth is None:
            values = np.asarray(getattr(scene, block.name))
        elif block.cloth < len(scene.cloths):
            values = np.atleast_1d(getattr(scene.cloths[block.cloth], block.name))
        else:
            values = np.zeros(0)
        if values.shape != block.shape:
            raise InvalidInput(
                f"{scene.name}: objects[{block.cloth}] has {len(values)} values of {block.name}, "
                f"{block.shape[0]} are needed"
            )
        parts.append(block.gather(values))
    return np.concatenate(parts)


def with_parameters(scene: Scene, p: Sequence[float] | Array, untouched: Collection[Block] = ()) -> Scene:
    """Make a new scene with the flagged values p (P,), in the order of `parameters`.

    Blocks in `untouched` keep the scene's values. Raises InvalidInput when p has another shape, InvalidScene when a
    value is not finite or outside what its kind allows.
    """
    values = check_shape(scene, p)
    flagged = [block for block in blocks(scene) if block not in untouched]
    made = {kind.name: [getattr(cloth, kind.name) for cloth in scene.cloths] for kind in CLOTH_KINDS}
    for block in flagged:
        if block.cloth is not None:
            old, new = made[block.name][block.cloth], block.spread(values)
            kept = np.where(block.column == 0, old, new)  # fixed vertices keep their velocities
            made[block.name][block.cloth] = kept if np.ndim(old) else new[0]
    shared = {block.name: block.spread(values) for block in flagged if block.cloth is None}
    return scene.with_values(made.pop("mass"), made.pop("stiffness"), **made, **shared)


def check_shape(scene: Scene, p: Sequence[float] | Array) -> Array:
    """p as an array (P,). Raises InvalidInput when its length is not the scene's number of parameters."""
    values = np.asarray(p, float)
    if values.shape != (size(scene),):
        raise InvalidInput(f"parameters: shape {values.shape} given, {scene.name} has ({size(scene)},)")
    return values


def elements(scene: Scene, cloth: int, p: Array, absent: float | None = None) -> Elements:
    """Values of one cloth for the fit vector p (P,).

    Masses and stiffnesses that are not flagged have the scene's value, or `absent` where that is given (0 for
    directions); other kinds that are not flagged are empty.
    """
    source = scene.cloths[cloth]
    values = {
        name: getattr(source, name) if absent is None else np.full(len(getattr(source, name)), absent)
        for name in LETTERED
    }
    for block in blocks(scene):
        if block.cloth in (cloth, None):
            values[block.name] = block.spread(p)
    return Elements(**{name: np.array(value, float, order="C") for name, value in values.items()})


def extra_kinds(scene: Scene, cloth: int) -> list[str]:
    """The kinds besides masses and stiffnesses whose gradient a fit needs of one cloth."""
    asked = {block.name for block in blocks(scene) if block.cloth in (cloth, None)}
    return [kind.name for kind in KINDS if kind.name in asked and kind.name not in LETTERED]


def hidden(cloth: Cloth, name: str, spheres: int, seen: Flags | None = None) -> Flags:
    """Which values of a kind, one flag per vertex (n,), per spring (S,) or for all (1,), a motion of a cloth cannot
    reveal, by structure.

    Of masses and velocities those of fixed vertices; masses where only weight and node damping move a vertex, so that
    they cancel; stiffnesses and rest lengths between two fixed vertices, and the rest length of what has no stiffness;
    drag and wind where the air meets no free vertex; everything of a cloth that is fixed. And, where `seen` (n,) tells
    which vertices a target shows: all of the parts of the cloth in which no free vertex is seen.
    """
    told = ~cloth.fixed if seen is None else ~cloth.fixed & told_of(cloth, seen)
    if name in ("stiffness", "rest"):
        slack = (cloth.stiffness == 0) & (name == "rest" and cloth.mode("stiffness") == "n")
        return np.asarray(~told[cloth.springs].any(axis=1) | slack)
    if name == "velocity":
        return np.asarray(~told)
    if name in ("drag", "wind"):
        return np.array([not (feels_air(cloth) and told[cloth.triangles].any())])
    if name in ("damping", "gravity"):
        return np.array([not told.any()])
    pushed = np.full(len(cloth.mass), spheres > 0)
    pushed[cloth.springs.reshape(-1)] = True
    if feels_air(cloth):
        pushed[cloth.triangles.reshape(-1)] = True
    return np.asarray(~told | ~pushed)


def told_of(cloth: Cloth, seen: Flags) -> Flags:
    """Which vertices (n,) are joined to a free vertex that is seen, through springs and faces of free vertices."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    free, n = ~cloth.fixed, len(cloth.mass)
    faces = cloth.triangles if feels_air(cloth) else cloth.triangles[:0]
    pairs = np.concatenate([cloth.springs, faces[:, :2], faces[:, 1:], faces[:, ::2]])
    pairs = pairs[free[pairs].all(axis=1)]  # a fixed vertex passes nothing on
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    return np.isin(part, part[free & seen])


def unidentifiable(scene: Scene, block: Block, seen: Seen = None) -> list[int]:
    """The parameters of a block that the motion cannot reveal, counted within the block.

    `seen` tells of each fitted cloth which vertices (n,) a target shows (default: all).
    """
    cloths = reached(scene, block.name) if block.cloth is None else [block.cloth]
    masks = [
        hidden(scene.cloths[i], block.name, len(scene.spheres), None if seen is None else seen[i]) for i in cloths
    ]
    if block.mode == "G":
        return list(range(block.count)) if all(mask.all() for mask in masks) else []
    return [int(i) for i in np.flatnonzero(np.repeat(masks[0], block.kind.components))]


def identifiable(scene: Scene, seen: Seen = None) -> Flags:
    """Which entries of the fit vector (P,) can be fitted."""
    kept = np.ones(size(scene), bool)
    for block in blocks(scene):
        kept[block.start + np.array(unidentifiable(scene, block, seen), int)] = False
    return kept
