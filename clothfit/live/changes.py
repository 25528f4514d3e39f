"""New values for a scene while it moves: what `Engine.set` takes, checked, as a new scene.

A scene is immutable, so whoever asks for a change gets its error at once, and the thread that steps takes whole scenes.
Masses, stiffnesses and the like are other values of the same scene; other pins or obstacles are another text of it,
which is read as any file is, so that the same sentences say what is wrong, and what is saved is what moved.

A page turns factors on the masses and stiffnesses of a base scene, for all and for each family and region: a value is
that of the base times the factor of all and the factor of its group, both 1 at first. A fit, or another scene, makes a
new base.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput, InvalidScene
from clothfit.scene.cloth import Cloth
from clothfit.scene.families import Groups, spring_groups, vertex_groups
from clothfit.scene.scene import Scene, dumps, load
from clothfit.scene.splice import splice

OF_OBJECTS = ("mass", "stiffness", "damping", "drag", "rest")
OF_SCENE = ("wind", "gravity")
OF_CONTACTS = ("friction", "contact")
OTHERS = ("pins", "colliders")

SETTABLE = (*OF_OBJECTS, *OF_SCENE, *OF_CONTACTS, *OTHERS)
"""What can be set, by name."""

PLACES = ("pos", "rot", "scale")
"""Fields of a collider that can be set: vectors of three numbers."""


def changed(scene: Scene, values: Mapping[str, Any], index: int | None = None) -> tuple[Scene, bool]:
    """The scene with other values, of the object `index` or of all, and whether pins or obstacles differ. Raises
    InvalidInput, with the reason.
    """
    unknown = [name for name in values if name not in SETTABLE]
    if unknown:
        raise InvalidInput(f"there is no {unknown[0]!r} to set; there are {', '.join(SETTABLE)}")
    if index is not None and not 0 <= index < len(scene.cloths):
        raise InvalidInput(f"there is no object {index}; the scene has {len(scene.cloths)}")
    given = {name: value for name, value in values.items() if name not in OTHERS}
    made = with_given(scene, given, index) if given else scene
    for name, edit in (("pins", pinned), ("colliders", placed)):
        if name in values:
            made = edit(made, values[name], index)
    return made, any(name in values for name in OTHERS)


def with_given(scene: Scene, given: Mapping[str, Any], index: int | None) -> Scene:
    """The scene with other values of kinds."""
    own = {name: each_object(scene, name, value, index) for name, value in given.items() if name in OF_OBJECTS}
    masses = own.pop("mass", [cloth.mass for cloth in scene.cloths])
    stiffnesses = own.pop("stiffness", [cloth.stiffness for cloth in scene.cloths])
    shared = {name: numbers(given[name], name) for name in (*OF_SCENE, *OF_CONTACTS) if name in given}
    shared |= {name: spread(shared[name], np.shape(getattr(scene, name))) for name in OF_CONTACTS if name in given}
    return scene.with_values(masses, stiffnesses, **own, **shared)


def each_object(scene: Scene, name: str, value: Any, index: int | None) -> list[Any]:
    """A value for each object: a number for all of its elements, or one for each of them."""
    for_each = isinstance(value, (list, tuple)) and len(value) == 1 and not isinstance(value[0], Real)
    if index is None and len(scene.cloths) == 1 and not for_each:
        index = 0
    parts = value
    if index is not None or isinstance(value, Real):
        chosen = range(len(scene.cloths)) if index is None else [index]
        parts = [value if i in chosen else getattr(cloth, name) for i, cloth in enumerate(scene.cloths)]
    if isinstance(parts, (str, Mapping)) or not isinstance(parts, (Sequence, np.ndarray)):
        raise InvalidInput(f"{name}: a number is needed, or one item for each object")
    if len(parts) != len(scene.cloths):
        raise InvalidInput(f"{name}: {len(parts)} items for {len(scene.cloths)} objects are given")
    return [of_object(cloth, name, part) for cloth, part in zip(scene.cloths, parts, strict=True)]


def of_object(cloth: Cloth, name: str, value: Any) -> Any:
    """A value of one object."""
    shape = np.shape(getattr(cloth, name))
    found = spread(numbers(value, name), shape)
    return found if shape else float(found.reshape(-1)[0]) if found.size == 1 else found


def numbers(value: Any, name: str) -> Array:
    """A number, or an array of them. Raises InvalidInput for anything else."""
    try:
        found = np.asarray(value)
    except ValueError:  # lists of different lengths
        found = np.array(None)
    if found.dtype.kind not in "iuf":
        raise InvalidInput(f"{name}: numbers are needed")
    return np.asarray(found, float)


def spread(value: Array, shape: tuple[int, ...]) -> Array:
    """A number for a whole shape; an array stays as it is, to be checked."""
    return value if value.ndim else np.full(shape, float(value))


def pinned(scene: Scene, value: Any, index: int | None) -> Scene:
    """The scene with other fixed vertices of an object: a list of their numbers. They stay where they are then, or
    begin to move.
    """
    if index is None and len(scene.cloths) > 1:
        raise InvalidInput("pins: say of which object")
    own = index or 0
    count = len(scene.cloths[own].mass)
    if not isinstance(value, (list, tuple, np.ndarray)) or not all(
        isinstance(i, (int, np.integer)) and not isinstance(i, bool) and 0 <= i < count for i in value
    ):
        raise InvalidInput(f"pins: a list of vertices is needed, whole numbers from 0 to {count - 1}")
    fixed = np.isin(np.arange(count), np.asarray(value, int))
    objects: list[dict[str, Any]] = [{} for _ in scene.cloths]
    objects[own] = {"vertIsFixed": fixed.tolist()}
    return edited(scene, objects, {})


def placed(scene: Scene, value: Any, index: int | None) -> Scene:
    """The scene with other places or sizes of obstacles, by their numbers in the file."""
    import json

    count = len(json.loads(scene.source.text).get("colliders", []))
    if not isinstance(value, Mapping) or not value:
        raise InvalidInput('colliders: as in {"0": {"pos": [0, 1, 0]}}')
    edits: dict[int, dict[str, Any]] = {}
    for number, fields in value.items():
        i = int(number) if str(number).isdecimal() else -1
        if not 0 <= i < count:
            raise InvalidInput(f"colliders: there is no {number!r}; the scene has {count}")
        if not isinstance(fields, Mapping) or not set(fields) <= set(PLACES):
            raise InvalidInput(f"colliders[{i}]: only {', '.join(PLACES)} can be set")
        vectors = {name: numbers(each, f"colliders[{i}].{name}") for name, each in fields.items()}
        for name, each in vectors.items():
            if each.shape != (3,) or not np.isfinite(each).all():
                raise InvalidInput(f"colliders[{i}].{name}: three numbers are needed")
        edits[i] = {name: dict(zip("xyz", each.tolist(), strict=True)) for name, each in vectors.items()}
    return edited(scene, [{} for _ in scene.cloths], {"colliders": edits})


def edited(scene: Scene, objects: Sequence[Mapping[str, Any]], whole: Mapping[str, Any]) -> Scene:
    """The scene that another text of it says."""
    text = splice(dumps(scene).removeprefix(scene.source.mark).decode(scene.source.encoding), objects, whole)
    try:
        made = load(io.StringIO(text), folder=scene.folder)
    except InvalidScene as error:
        raise InvalidScene(error.problems, scene.name) from None
    return replace(made, name=scene.name, forces=scene.forces, main=scene.main)


# ---- Factors on the masses and stiffnesses of a scene.

ALL = "all"
KINDS = ("mass", "stiffness")
LEAST, MOST = 1e-4, 1e4

Factors = dict[tuple[int, str, str], float]
"""By object, kind and group; what is not there is 1."""


def groups_of(scene: Scene, index: int, kind: str) -> Groups:
    """The groups of the masses or stiffnesses of an object."""
    cloth = scene.cloths[index]
    return vertex_groups(cloth) if kind == "mass" else spring_groups(cloth)


def with_changes(scene: Scene, factors: Factors, changed: Any, index: int | None) -> Factors:
    """Factors with others of one object or of all, as in {"stiffness": {"all": 2, "edges along": 0.5}}. Raises
    InvalidInput.
    """
    if not isinstance(changed, Mapping) or not set(changed) <= set(KINDS):
        raise InvalidInput(f"factors: an object with {' and '.join(KINDS)} is needed")
    made, objects = dict(factors), range(len(scene.cloths)) if index is None else [index]
    for kind, parts in changed.items():
        given = parts if isinstance(parts, Mapping) else {ALL: parts}
        for name, value in given.items():
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not LEAST <= value <= MOST:
                raise InvalidInput(f"factors.{kind}: a number from {LEAST:g} to {MOST:g} is needed")
            known = [i for i in objects if name == ALL or name in groups_of(scene, i, kind).names]
            if not known:
                raise InvalidInput(f"factors.{kind}: there is no group {str(name)[:60]!r}")
            made |= {(i, kind, name): float(value) for i in known}
    return made


def multiplied(base: Scene, factors: Factors, kind: str) -> list[Array]:
    """The masses or stiffnesses of each object of the base, times their factors."""
    made = []
    for i, cloth in enumerate(base.cloths):
        groups = groups_of(base, i, kind)
        own = [factors.get((i, kind, name), 1.0) if name != ALL else 1.0 for name in groups.names]
        made.append(getattr(cloth, kind) * factors.get((i, kind, ALL), 1.0) * np.asarray(own)[groups.of])
    return made


def listed(scene: Scene, factors: Factors) -> list[dict[str, dict[str, float]]]:
    """The factors of each object, by kind and group, as a page gets them."""
    found = []
    for i in range(len(scene.cloths)):
        names = {kind: [ALL, *(n for n in groups_of(scene, i, kind).names if n != ALL)] for kind in KINDS}
        found.append({kind: {n: factors.get((i, kind, n), 1.0) for n in own} for kind, own in names.items()})
    return found


# ---- What `undo` goes back to: the scenes before the last changes.

MOST_CHANGES = 100
"""Changes that can be undone, …"""

MOST_BYTES = 64 << 20
"""… fewer where scenes are large: bytes that they may take together, about."""


class UndoState(NamedTuple):
    """The scene that moves, the base of its factors, and these."""

    scene: Scene
    base: Scene
    factors: Factors


class History:
    """The moments before the last changes, the newest last."""

    def __init__(self) -> None:
        self._states: list[tuple[str | None, UndoState]] = []

    def __len__(self) -> int:
        return len(self._states)

    def save(self, gesture: object, state: UndoState) -> None:
        """Note what was before a change: of one gesture, such as the drag of a slider, what was before all of it."""
        name = str(gesture)[:100] if gesture is not None else None
        if name is None or not self._states or self._states[-1][0] != name:
            most = max(min(MOST_BYTES // size(state.scene), MOST_CHANGES), 1)
            self._states = [*self._states, (name, state)][-most:]

    def last(self) -> UndoState:
        """Take the newest moment."""
        return self._states.pop()[1]


def size(scene: Scene) -> int:
    """Bytes that a changed scene may keep: its text, and its masses, stiffnesses and lengths."""
    return len(scene.source.text) + sum(8 * len(each.mass) + 16 * len(each.stiffness) for each in scene.cloths)
