"""What the program may move to take a cloth through keys: forces, handles, the wind, the velocity at the start.

Handles are fixed vertices on a path, the wind has keys: both are inputs of the scene that a fit knows as the kinds
`path` and `gusts`. So a scene to steer is the given one with such keys, and what was found is a scene again, which any
program that plays the scene can play.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.eigen import connected_components
from clothfit.base.errors import InvalidInput
from clothfit.control.keyframes import Key
from clothfit.engine.inputs import knots
from clothfit.engine.inputs.interpolation import resolved
from clothfit.meshes.new_scene import text
from clothfit.scene.keys import Keys, Pin
from clothfit.scene.scene import Scene, dumps, load


@dataclass(frozen=True, eq=False)
class Handle:
    """Vertices that move together, each from where it is at the start."""

    cloth: int  # of the scene, counted from 0
    vertices: Indices  # (m,)


@dataclass(frozen=True, eq=False)
class Controls:
    """What may move. Without forces, handles, wind and velocity: forces on all vertices that are not fixed."""

    forces: Sequence[Flags] | None = None  # of each object, the vertices (n,) that forces may act on
    handles: tuple[Handle, ...] = ()  # whose paths are found
    wind: bool = False  # over time
    velocity: bool = False  # at the start
    every: float | None = None  # s between two knots in time; None: forces of each step, and SPACING for the others
    modes: int | None = None  # forces in the first so many modes of vibration; None: by vertices

    @property
    def follows(self) -> bool:
        """Whether forces of every vertex and step alone are asked for, which a closed loop finds."""
        return not (self.handles or self.wind or self.velocity or self.every or self.modes)

    @property
    def pushes(self) -> bool:
        """Whether forces are asked for."""
        return self.forces is not None or not (self.handles or self.wind or self.velocity)

    def led(self, scene: Scene, cloth: int) -> Flags:
        """Which vertices (n,) of a cloth handles move."""
        found = np.zeros(scene.vertex_counts[cloth], bool)
        for handle in self.handles:
            if handle.cloth == cloth:
                found[handle.vertices] = True
        return found


def steered(scene: Scene, controls: Controls, end: float) -> Scene:
    """The scene with keys for its handles and its wind up to a time, s, that move as they did without control. Raises
    InvalidInput where a handle cannot be one.
    """
    if not controls.handles and not controls.wind:
        return scene
    document = json.loads(dumps(scene).decode(scene.source.encoding).lstrip("\ufeff"))
    at = knots.times(end, scene.delta, controls.every)
    if controls.wind:
        document["windVelKeys"] = knots.keyed(at, resolved(scene.wind_keys) if scene.wind_keys else None)
    for cloth in sorted({handle.cloth for handle in controls.handles}):
        own = [handle.vertices for handle in controls.handles if handle.cloth == cloth]
        lead(document["objects"][cloth], scene, cloth, own, at)
    made = load(io.StringIO(text(document)), folder=scene.folder)
    return replace(made, name=scene.name, title=scene.title, forces=scene.forces)


def lead(item: dict[str, Any], scene: Scene, cloth: int, handles: Sequence[Indices], at: Array) -> None:
    """Make handles pins of an object of a document, with a key at each knot (K,), s."""
    own, pins = scene.cloths[cloth], list(item.get("pins", []))
    fixed = list(item["vertIsFixed"])
    for vertices in handles:
        before = [i for i, pin in enumerate(own.pins) if np.isin(pin.vertices, vertices).any()]
        base = along(own.pins[before[0]], vertices, cloth) if before else None
        pin = {"vertices": vertices.tolist(), "posKeys": knots.keyed(at, base, 0.0)}
        if before:
            pins[before[0]] = pin
        else:
            pins.append(pin)
        for vertex in vertices.tolist():
            fixed[vertex] = True
    item["pins"], item["vertIsFixed"] = pins, fixed


def along(pin: Pin, vertices: Indices, cloth: int) -> Keys:
    """The path of a pin that becomes a handle. Raises InvalidInput where it cannot."""
    if not np.array_equal(np.sort(pin.vertices), np.sort(vertices)):
        raise InvalidInput(f"handles: a pin of objects[{cloth}] has some of these vertices and others; take it whole")
    if pin.rotation is not None or pin.position is None or pin.position.points:
        raise InvalidInput(f"handles: a pin of objects[{cloth}] turns, or follows a motion; it keeps its path")
    found = resolved(pin.position)
    if found.values.ndim != 2:
        raise InvalidInput(f"handles: a pin of objects[{cloth}] follows a motion; it keeps its path")
    return found


def flagged(scene: Scene, controls: Controls) -> Scene:
    """The steered scene with what is to be found as its only fitted kinds."""
    cloths = []
    for cloth in scene.cloths:
        own = {"path": bool(controls.handles) and any(pin.own for pin in cloth.pins), "velocity": controls.velocity}
        cloths.append(replace(cloth, settings="nn", fits={name: "L" for name, asked in own.items() if asked}))
    return replace(scene, cloths=tuple(cloths), fits={"gusts": "L"} if controls.wind else {})


def handle_keys(scene: Scene, controls: Controls, cloth: int) -> Flags:
    """Which of the keys (K,) of `Cloth.path` are those of handles, but for those at time 0."""
    own = scene.cloths[cloth]
    handles = [set(handle.vertices.tolist()) for handle in controls.handles if handle.cloth == cloth]
    mine = np.array([set(pin.vertices.tolist()) in handles for pin in own.pins], bool)
    owner = own.key_pins
    return np.asarray(mine[owner] & (np.arange(len(owner)) != own.datums)) if len(owner) else np.zeros(0, bool)


def immovable(scene: Scene, keys: Sequence[Key], controls: Controls) -> list[Flags]:
    """Of each key, which of its vertices (m,) no control can move: fixed ones that are no handles, and those that no
    springs join to a vertex that a control acts on.
    """
    reach = []
    for cloth, own in enumerate(scene.cloths):
        led = controls.led(scene, cloth)
        acts = led.copy()
        if controls.pushes:
            acts |= ~own.fixed & (True if controls.forces is None else controls.forces[cloth])
        if controls.velocity:
            acts |= ~own.fixed
        if controls.wind and own.drag > 0:
            acts[own.triangles] = True
        moves = ~own.fixed | led
        lot = connected_components(own.springs[moves[own.springs].all(axis=1)], len(own.mass))
        reach.append(moves & np.isin(lot, lot[acts & moves]))
    return [~reach[key.cloth][key.vertices] for key in keys]
