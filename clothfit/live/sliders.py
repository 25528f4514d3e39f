"""What a page turns: factors on the masses and stiffnesses of a scene, for all and for each family and region.

A value is that of the base scene times the factor of all and the factor of its group, both 1 at first. A fit, or
another scene, makes a new base.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.scene.families import Groups, spring_groups, vertex_groups
from clothfit.scene.scene import Scene

ALL = "all"
KINDS = ("mass", "stiffness")
LEAST, MOST = 1e-4, 1e4

Factors = dict[tuple[int, str, str], float]
"""By object, kind and group; what is not there is 1."""


def groups_of(scene: Scene, index: int, kind: str) -> Groups:
    """The groups of the masses or stiffnesses of an object."""
    cloth = scene.cloths[index]
    return vertex_groups(cloth) if kind == "mass" else spring_groups(cloth)


def with_asked(scene: Scene, factors: Factors, asked: Any, index: int | None) -> Factors:
    """Factors with others of one object or of all, as in {"stiffness": {"all": 2, "edges along": 0.5}}. Raises
    InvalidInput.
    """
    if not isinstance(asked, Mapping) or not set(asked) <= set(KINDS):
        raise InvalidInput(f"factors: an object with {' and '.join(KINDS)} is needed")
    made, objects = dict(factors), range(len(scene.cloths)) if index is None else [index]
    for kind, parts in asked.items():
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


class Moment(NamedTuple):
    """The scene that moves, the base of its factors, and these."""

    scene: Scene
    base: Scene
    factors: Factors


class History:
    """The moments before the last changes, the newest last."""

    def __init__(self) -> None:
        self._moments: list[tuple[str | None, Moment]] = []

    def __len__(self) -> int:
        return len(self._moments)

    def note(self, gesture: object, moment: Moment) -> None:
        """Note what was before a change: of one gesture, such as the drag of a slider, what was before all of it."""
        name = str(gesture)[:100] if gesture is not None else None
        if name is None or not self._moments or self._moments[-1][0] != name:
            most = max(min(MOST_BYTES // size(moment.scene), MOST_CHANGES), 1)
            self._moments = [*self._moments, (name, moment)][-most:]

    def last(self) -> Moment:
        """Take the newest moment."""
        return self._moments.pop()[1]


def size(scene: Scene) -> int:
    """Bytes that a changed scene may keep: its text, and its masses, stiffnesses and lengths."""
    return len(scene.source.text) + sum(8 * len(each.mass) + 16 * len(each.stiffness) for each in scene.cloths)
