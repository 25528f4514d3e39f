"""How an object is woven and divided, in numbers: the families of its springs, and its regions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clothfit.base.messages import counted
from clothfit.scene.cloth import Cloth
from clothfit.scene.families import Groups, spring_groups, vertex_groups
from clothfit.scene.layout import Layout

PLAIN = frozenset({"edges", "bending", "other"})
"""Families of a mesh without directions."""


@dataclass(frozen=True)
class Divisions:
    """Families and regions of an object, by their names; without regions there are none."""

    families: dict[str, int]  # springs of each
    regions: dict[str, dict[str, int]]  # "vertices" and "springs" of each

    @property
    def sentences(self) -> list[str]:
        """What is worth saying, for people."""
        said = []
        if not PLAIN.issuperset(self.families):
            said.append(f"families: {', '.join(f'{count} {name}' for name, count in self.families.items())}")
        parts = [
            f"{name} ({counted(own['vertices'], 'vertex', 'vertices')}, {counted(own['springs'], 'spring', 'springs')})"
            for name, own in self.regions.items()
        ]
        return [*said, f"regions: {', '.join(parts)}"] if parts else said


def divisions(cloth: Cloth) -> Divisions:
    """The families and regions of an object."""
    given = cloth.layout
    whole = spring_groups(replace(cloth, layout=replace(given, regions=())))
    if not given.regions:
        return Divisions(_counts(whole), {})
    parts = Layout(("all",), np.zeros(len(cloth.springs), np.int32), given.regions)
    springs = _counts(spring_groups(replace(cloth, layout=parts)))
    vertices = _counts(vertex_groups(cloth))
    regions = {
        name: {"vertices": vertices.get(name, 0), "springs": springs.get(f"all, {name}", 0)}
        for name in vertices | {name.partition(", ")[2]: 0 for name in springs}
    }
    return Divisions(_counts(whole), regions)


def _counts(groups: Groups) -> dict[str, int]:
    return dict(zip(groups.names, np.bincount(groups.of, minlength=len(groups.names)).tolist(), strict=True))
