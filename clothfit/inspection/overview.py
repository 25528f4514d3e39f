"""The contents of a scene in numbers, to get to know a scene or to check that it is the intended one."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.messages import named, owned, place
from clothfit.meshes.mesh import keys
from clothfit.meshes.topology import across, components, edges
from clothfit.scene import schema as structure
from clothfit.scene.cloth import Cloth
from clothfit.scene.kinds import INTEGRATORS, OF_THE_EDITOR
from clothfit.scene.mesh_numbering import FIELD
from clothfit.scene.scene import Scene


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
        return "the front end in Unity does not know of inputs over time: there they stay" if scene.moves else None
    return (
        f"the editor in Unity cannot play its step ({name}, integrationMethod {scene.method}), `clothfit simulate` "
        "can; for a cloth that Unity is to play, `new --integrator implicit`, and fit with that"
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
    met = edges(triangles)
    key, edge, bend = (keys(pairs) for pairs in (springs, met.ends, across(met)))
    is_edge, is_bend = np.isin(key, edge), np.isin(key, bend)
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


def unknown_fields(scene: Scene) -> list[str]:
    """The places of fields that neither the format nor this program knows; each field once, where it occurs first."""
    document = json.loads(scene.source.text)
    known = {kind: structure.fields(kind) for kind in ("scene", "object", "collider", "selfCollision")}
    known["object"] |= {FIELD}
    owners: list[tuple[str, tuple[str | int, ...], Any]] = [("scene", (), document)]
    owners += [("object", ("objects", i), item) for i, item in enumerate(document["objects"])]
    owners += [("collider", ("colliders", i), item) for i, item in enumerate(document.get("colliders", []))]
    owners += [("selfCollision", ("selfCollision",), document.get("selfCollision") or {})]
    found: dict[tuple[str, str], str] = {}
    for kind, path, item in owners:
        for name in item.keys() - known[kind]:
            found.setdefault((kind, name), place((*path, named(name))))
    return sorted(found.values())
