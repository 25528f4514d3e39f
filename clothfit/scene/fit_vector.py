"""The fit vector: which values a scene flags, their order, and the conversion in both directions.

An object's `optimizationSettings` has two letters, masses then stiffnesses: n nothing, F one factor on the values, R
one for each family and region, M a smooth map of them, G one value for the whole object, L one per vertex or spring;
the `fit` of an object or of the scene flags the other `kinds` by the letters that their table gives them.
Parameters are concatenated object by object, for each in the order of the kinds; those of the scene as a whole come
last. Vectors are stored component by component.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from clothfit.base.arrays import Array, Elements, Flags
from clothfit.base.errors import InvalidInput
from clothfit.scene.block import Block, reached
from clothfit.scene.kinds import CLOTH_KINDS, KIND, KINDS, LETTERED
from clothfit.scene.scene import Scene, check_is_scene

LOWER, UPPER = KIND["mass"].lower, KIND["mass"].upper
"""Default bounds of ordinary masses and stiffnesses, kg or N/m; `bounds` gives those of every parameter."""

AT_BOUND = 1e-9
"""Relative distance within which a value is at its bound: more than the rounding of exp and log."""


def bounds(scene: Scene) -> tuple[Array, Array]:
    """Lower and upper bound (P,) of every parameter."""
    ends = [(np.zeros(0), np.zeros(0)), *(block.limits for block in scene.blocks)]
    return np.concatenate([low for low, _ in ends]), np.concatenate([high for _, high in ends])


def at_lower(p: Array, lower: Array | float) -> Flags:
    """Which of the parameters p lie at their lower bounds."""
    return np.asarray(p <= lower + AT_BOUND * np.abs(lower))


def at_upper(p: Array, upper: Array | float) -> Flags:
    """Which of the parameters p lie at their upper bounds."""
    return np.asarray(p >= upper - AT_BOUND * np.abs(upper))


def of_kinds(scene: Scene, names: Collection[str]) -> Flags:
    """Which parameters (P,) are of these kinds."""
    found = scene.blocks
    return np.repeat(np.array([block.name in names for block in found], bool), [block.count for block in found])


def size(scene: Scene) -> int:
    """Number of parameters P."""
    return sum(block.count for block in scene.blocks)


def fitted_cloths(scene: Scene) -> list[int]:
    """The objects that have parameters or that one of the scene's acts on; a fit simulates these and no others."""
    found = scene.blocks
    own = {block.cloth for block in found if block.cloth is not None}
    shared = {i for block in found if block.cloth is None for i in reached(scene.cloths, block.name)}
    return sorted(own | shared) or list(range(len(scene.cloths) if found else 0))


def parameters(scene: Scene, flags: Scene | None = None) -> Array:
    """The flagged values (P,), in SI units: of each object in turn its kinds in order, then those of the scene.

    A value that is flagged with G is the mean. Factors are those on the scene's own values, 1. `flags` is the scene
    whose flags count (default: `scene`), and on whose values the factors are; of a map those that come nearest. Raises
    InvalidInput when the objects of the two differ in size.
    """
    check_is_scene(scene)
    parts = [np.zeros(0)]
    for block in (flags or scene).blocks:
        if block.cloth is None:
            values = np.asarray(getattr(scene, block.name))
        elif block.cloth < len(scene.cloths):
            values = np.atleast_1d(getattr(scene.cloths[block.cloth], block.name))
        else:
            values = np.zeros(0)
        if values.shape != block.shape:
            owner = "the scene" if block.cloth is None else f"objects[{block.cloth}]"
            counts = f"{len(values)} values of {block.name}, {block.shape[0]} are needed"
            raise InvalidInput(f"{scene.name}: {owner} has {counts}")
        parts.append(block.gather(values))
    return np.concatenate(parts)


def with_parameters(scene: Scene, p: Sequence[float] | Array, untouched: Collection[Block] = ()) -> Scene:
    """Make a new scene with the flagged values p (P,), in the order of `parameters`.

    Blocks in `untouched` keep the scene's values. Raises InvalidInput when p has another shape, InvalidScene when a
    value is not finite or outside what its kind allows.
    """
    values = check_shape(scene, p)
    flagged = [block for block in scene.blocks if block not in untouched]
    made = {kind.name: [getattr(cloth, kind.name) for cloth in scene.cloths] for kind in CLOTH_KINDS}
    for block in flagged:
        if block.cloth is not None:
            old, new = made[block.name][block.cloth], block.spread(values)
            kept = np.where(block.column == 0, old, new)  # fixed vertices keep their velocities
            made[block.name][block.cloth] = kept.reshape(np.shape(old)) if np.ndim(old) else new[0]
    shared = {block.name: block.spread(values) for block in flagged if block.cloth is None}
    return scene.with_values(made.pop("mass"), made.pop("stiffness"), **made, **shared)


def check_shape(scene: Scene, p: Sequence[float] | Array) -> Array:
    """p as an array (P,). Raises InvalidInput when its length is not the scene's number of parameters."""
    values = np.asarray(p, float)
    if values.shape != (size(scene),):
        raise InvalidInput(f"parameters: shape {values.shape} given, {scene.name} has ({size(scene)},)")
    return values


def elements(scene: Scene, cloth: int, p: Array) -> Elements:
    """Values of one cloth, and of those that are simulated with it, for the fit vector p (P,).

    Masses and stiffnesses that are not flagged have the scene's value; other kinds that are not flagged are empty.
    """
    values = {name: _together(scene, cloth, name) for name in LETTERED}
    for block, part in acting(scene, cloth):
        if block.cloth is None:
            values[block.name] = block.spread(p)
            continue
        values.setdefault(block.name, _together(scene, cloth, block.name))[part] = block.spread(p)
    if "offset" in values:
        values["offset"] = values["offset"] - scene.offset  # a system has the colliders where its scene has them
    return _elements(values)


def changes(scene: Scene, cloth: int, p: Array, direction: Array) -> Elements:
    """Change of the values of one cloth, and of those that are simulated with it, at p (P,) along `direction` (P,): 0
    of masses and stiffnesses that are not flagged.
    """
    values = {name: 0.0 * _together(scene, cloth, name) for name in LETTERED}
    for block, part in acting(scene, cloth):
        if block.cloth is None:
            values[block.name] = block.change(p, direction)
            continue
        values.setdefault(block.name, 0.0 * _together(scene, cloth, block.name))[part] = block.change(p, direction)
    return _elements(values)


def acting(scene: Scene, cloth: int) -> list[tuple[Block, slice]]:
    """The blocks that act on a cloth and on those that are simulated with it, each with the places of its values among
    those of all of them.
    """
    group, found = scene.together(cloth), list[tuple[Block, slice]]()
    for block in scene.blocks:
        if block.cloth is None:
            found.append((block, slice(None)))
        elif block.cloth in group:
            first = sum(np.atleast_1d(getattr(scene.cloths[i], block.name)).shape[0] for i in group if i < block.cloth)
            found.append((block, slice(first, first + block.shape[0])))
    return found


def _together(scene: Scene, cloth: int, name: str) -> Array:
    """The scene's values of a kind of a cloth, and of those that are simulated with it."""
    return np.concatenate([np.atleast_1d(getattr(scene.cloths[i], name)) for i in scene.together(cloth)]).astype(float)


def _elements(values: dict[str, Array]) -> Elements:
    return Elements(**{name: np.array(value, float, order="C") for name, value in values.items()})


def extra_kinds(scene: Scene, cloth: int) -> list[str]:
    """The kinds beside masses and stiffnesses by which a fit needs the gradient of one cloth."""
    asked = {block.name for block, _ in acting(scene, cloth)}
    return [kind.name for kind in KINDS if kind.name in asked and kind.name not in LETTERED]
