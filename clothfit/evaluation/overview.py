"""The contents of a scene in numbers, to get to know a scene or to check that it is the intended one: its objects, how
they are woven and divided.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.messages import counted, meant, named, owned, place
from clothfit.meshes.problems import components
from clothfit.scene import schema as structure
from clothfit.scene.cloth import Cloth, Layout
from clothfit.scene.directions import edges_of, keys, opposite, pairs_of
from clothfit.scene.families import Groups, spring_groups, vertex_groups
from clothfit.scene.kinds import EDITORS, INTEGRATORS, OF_THE_EDITOR
from clothfit.scene.mesh_numbering import FIELD, NAME
from clothfit.scene.scene import Scene

KEYED = ("windVelKeys", "gravityKeys", "posKeys", "rotKeys", "scaleKeys", "motion")
"""Fields that hold keys."""

ALIKE = 0.85
"""Share of letters in order that two names have in common which may be meant for each other."""

PLAIN = frozenset({"edges", "bending", "other"})
"""Families of a mesh without directions."""


@dataclass(frozen=True)
class Spread:
    """Statistics of some values; None where there are none."""

    least: float | None
    median: float | None
    most: float | None
    total: float


@dataclass(frozen=True)
class Flagged:
    """A kind of parameter that a fit determines."""

    object: int | None  # None: of the scene as a whole
    name: str
    mode: str  # F, R, M, G or L
    count: int  # parameters


@dataclass(frozen=True)
class Facts:
    """One object."""

    vertices: int
    fixed: int
    triangles: int
    springs: int
    along_edges: int  # springs along an edge of a triangle
    bending: int  # springs between the two vertices opposite an edge
    parts: tuple[int, ...]  # vertices of each part connected by springs, largest first
    loose: int  # vertices without springs
    mass: Spread  # kg
    stiffness: Spread  # N/m
    rest: Spread  # m
    low: tuple[float, ...]  # corner of the bounding box, m
    high: tuple[float, ...]
    drag: float
    drag_law: str
    damping: float
    moving: bool  # whether a velocity at the start is not 0
    strained: bool  # whether rest lengths differ from the lengths at the start


def beyond_editor(scene: Scene) -> str | None:
    """A sentence where the step, the colliders or the inputs of the scene are none of the editor's."""
    name = INTEGRATORS[scene.method]
    if name in OF_THE_EDITOR:
        if scene.self_contact:
            return "the front end in Unity does not know of selfCollision: there cloths pass through themselves"
        if scene.colliders:
            return "the front end in Unity has no colliders but plain spheres, and nothing that changes over time"
        if any(cloth.drag_law != EDITORS and cloth.feels_air for cloth in scene.cloths):
            return "the front end in Unity does not know of dragLaw: there the air pushes by the editor's law"
        return "the front end in Unity does not know of inputs over time: there they stay" if scene.moves else None
    return (
        f"the editor in Unity cannot play its step ({name}, integrationMethod {scene.method}); a scene for Unity is "
        "made with `new --integrator implicit`"
    )


def facts(cloth: Cloth) -> Facts:
    """Collect the facts of an object."""
    edge, bend = spring_kinds(cloth.springs, cloth.triangles)
    sizes, _ = components(cloth.springs, len(cloth.mass))
    return Facts(
        vertices=len(cloth.mass),
        fixed=int(cloth.fixed.sum()),
        triangles=len(cloth.triangles),
        springs=len(cloth.springs),
        along_edges=int(edge.sum()),
        bending=int(bend.sum()),
        parts=tuple(sizes.tolist()),
        loose=len(cloth.mass) - int(sizes.sum()),
        mass=spread(cloth.mass),
        stiffness=spread(cloth.stiffness),
        rest=spread(cloth.rest),
        low=tuple(cloth.positions.min(axis=0).tolist()),
        high=tuple(cloth.positions.max(axis=0).tolist()),
        drag=cloth.drag,
        drag_law=cloth.drag_law,
        damping=cloth.damping,
        moving=bool(cloth.velocity.any()),
        strained=not np.array_equal(cloth.rest, cloth.lengths),
    )


def spread(values: Array) -> Spread:
    """Smallest, median, largest value and sum."""
    if not len(values):
        return Spread(None, None, None, 0.0)
    with np.errstate(over="ignore"):  # of values at the ends of the range of doubles
        return Spread(float(values.min()), float(np.median(values)), float(values.max()), float(values.sum()))


def spring_kinds(springs: Indices, triangles: Indices) -> tuple[Flags, Flags]:
    """Which springs (S, 2) lie along an edge of the triangles (T, 3), and which bend over one: (S,) each.

    A bending spring joins the vertices opposite an edge. Of two springs between the same vertices that could be either
    the second counts as bending.
    """
    met = edges_of(triangles)
    key, bend = keys(springs), keys(opposite(triangles, pairs_of(met)))
    is_edge, is_bend = np.isin(key, met.key), np.isin(key, bend)
    _, first = np.unique(key, return_index=True)
    again = ~np.isin(np.arange(len(key)), first)
    bends = is_bend & (~is_edge | again)
    return is_edge & ~bends, bends


def flagged(scene: Scene) -> list[Flagged]:
    """The kinds of parameters that a fit determines, in the order of the fit vector."""
    return [Flagged(block.cloth, block.name, block.mode, block.count) for block in scene.blocks]


def beyond_bounds(scene: Scene) -> list[str]:
    """A sentence for each flagged kind whose values, where a fit starts, are not within the bounds."""
    found = []
    for block in scene.blocks:
        kind, (lower, upper), mean = block.kind, block.ends, block.mode == "G"
        if kind.name == "rest" and mean:  # a factor on the lengths
            continue
        values = np.ravel(getattr(scene if block.cloth is None else scene.cloths[block.cloth], kind.name))
        starts = np.array([values.mean()]) if mean and kind.components == 1 else values
        beyond = (starts < lower) | (starts > upper)
        if block.factors is not None:
            beyond &= starts > 0  # no factor moves a value of 0
        if beyond.any():
            which = "the mean is" if mean else f"{beyond.sum()} of {len(values)} values are"
            where = f"{owned(block.cloth, kind.title)}: {which} not within {lower:g} … {upper:g}{kind.suffix}"
            found.append(f"{where}, where a fit looks")
    return found


def misspelt_fields(scene: Scene) -> list[str]:
    """A sentence for each unknown field whose name is nearly that of one which the program knows and the scene lacks.
    """
    asked = [(where, question) for where, question in unknown_fields(scene).items() if question]
    return [f"{where}: the program knows no such field, and keeps it{question}" for where, question in asked]


def unknown_fields(scene: Scene) -> dict[str, str]:
    """The places of fields that neither the format nor this program knows, each field once, where it occurs first; with
    the question whether another name was meant, or nothing.
    """
    found: dict[tuple[str, str], tuple[str, str]] = {}
    for kind, path, item in owners(json.loads(scene.source.text)):
        known = structure.fields(kind) | ({FIELD, NAME} if kind == "object" else set())
        for name in sorted(item.keys() - known):
            found.setdefault((kind, name), (place((*path, named(name))), near(name, known - item.keys())))
    return dict(sorted(found.values()))


def near(wrong: str, names: Collection[str]) -> str:
    """Asks for the name that is the same but for case, or for a letter or two of many; nothing where none is."""
    best = [name for name in names if name.lower() == wrong.lower()]
    likely = get_close_matches(wrong.lower(), {name.lower() for name in names}, 1, ALIKE)
    return meant(wrong, best or [name for name in names if name.lower() in likely])


def owners(document: Any) -> Iterator[tuple[str, tuple[str | int, ...], Any]]:
    """The objects of a document whose fields the format lists: their names in the schema, and their places."""
    yield "scene", (), document
    own: list[tuple[str, tuple[str | int, ...], Any]] = []
    for i, item in enumerate(document["objects"]):
        own += [("object", ("objects", i), item)]
        own += [("pin", ("objects", i, "pins", j), pin) for j, pin in enumerate(item.get("pins", []))]
    own += [("collider", ("colliders", i), item) for i, item in enumerate(document.get("colliders", []))]
    own += [(name, (name,), document[name]) for name in ("selfCollision", "frame") if document.get(name)]
    yield from own
    for _, path, item in [("scene", (), document), *own]:
        yield from (("keys", (*path, name), item[name]) for name in KEYED if isinstance(item.get(name), dict))


def extent(size: Sequence[float]) -> str:
    """The sides of a bounding box, m, for people."""
    return f"{' × '.join(f'{side:.4g}' for side in size)} m"


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
