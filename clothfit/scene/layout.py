"""What a scene file may say of how an object is woven and divided: the optional fields `families`, `regions`, `warp`.

    "families": {"names": ["yarn", "fold"], "springs": [0, 1, 1, ...]}     the family of each spring, from 0
    "regions": [{"name": "collar", "vertices": [0, 1, 2]}]                 parts; where they overlap the first counts
    "warp": {"x": 1, "y": 0, "z": 0}                                       the direction along the cloth at the start

No motion depends on them, only what a fit in mode R or M takes together. S springs, n vertices.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.base.messages import counted, shown
from clothfit.scene import array_checks as checks

ELSEWHERE = "elsewhere"
"""The name of what lies in no region."""


class Region(NamedTuple):
    """A named part of a cloth."""

    name: str
    vertices: Indices  # rising


@dataclass(frozen=True, eq=False)
class Layout:
    """What a file says of one object; empty where it says nothing. The arrays are read-only."""

    names: tuple[str, ...] = ()  # of the families that it gives
    family: Indices | None = None  # (S,), the family of each spring
    regions: tuple[Region, ...] = ()
    warp: Array | None = None  # (3,), not 0


NOTHING = Layout()


def layout_of(fields: dict[str, Any], place: str, problems: list[str]) -> Layout:
    """The layout of an object whose structure has been checked; what is wrong goes to `problems`."""
    n, springs = len(fields["vertPos"]), len(fields["springs"]) // 2
    names: tuple[str, ...] = ()
    family = warp = None
    if "families" in fields:
        names = tuple(fields["families"]["names"])
        family = _family(fields["families"], springs, f"{place}.families", problems)
    regions = _regions(fields.get("regions", []), n, f"{place}.regions", problems)
    if "warp" in fields:
        warp = np.array([fields["warp"][axis] for axis in "xyz"], float)
        if not warp.any():
            problems.append(f"{place}.warp: has no length, so no direction")
    for array in (family, warp, *(region.vertices for region in regions)):
        if array is not None:
            array.setflags(write=False)
    same = not names and not regions and warp is None
    return NOTHING if same else Layout(names, family, regions, warp)


def _family(given: dict[str, Any], springs: int, place: str, problems: list[str]) -> Indices | None:
    """The family (S,) of each spring."""
    names, values = given["names"], given["springs"]
    _check_names(names, [f"{place}.names[{i}]" for i in range(len(names))], problems)
    if len(values) != springs:
        has, owners = counted(len(values), "value", "values"), counted(springs, "spring", "springs")
        problems.append(f"{place}.springs: {has} for {owners}; one each is needed")
    if not checks.check_types(values, {int}, "an index (a whole number)", f"{place}.springs", problems):
        return None
    has = f"there are {counted(len(names), 'name', 'names')}"
    right = checks.check_indices(
        values, len(names), f"{place}.springs", lambda i: f"family {shown(values[i])} does not exist ({has})", problems
    )
    return None if right is None else right.astype(np.int32)


def _regions(given: list[Any], n: int, place: str, problems: list[str]) -> tuple[Region, ...]:
    """The regions."""
    _check_names([each["name"] for each in given], [f"{place}[{i}].name" for i in range(len(given))], problems)
    found = []
    for i, each in enumerate(given):
        at = f"{place}[{i}].name"
        if each["name"] == ELSEWHERE:
            problems.append(f"{at}: {shown(ELSEWHERE)} is what lies in no region; give it another name")
        vertices = checks.vertices(each["vertices"], n, 1, f"{place}[{i}].vertices", problems)
        if vertices is not None:
            found.append(Region(each["name"], np.unique(vertices)))
    return tuple(found)


def _check_names(names: list[str], places: list[str], problems: list[str]) -> None:
    """Check that names are not empty and differ."""
    uses = Counter(names)
    for i, name in enumerate(names):
        if not name.strip():
            problems.append(f"{places[i]}: is empty; give it a name")
        elif uses[name] > 1 and name in names[:i]:
            problems.append(f"{places[i]}: {shown(name)} is there already; names must differ")
