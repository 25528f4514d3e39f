"""Keyframes: where vertices of a scene are to be at some times, and a first path through them.

They come from JSON,

    {"keys": [{"time": 1.0, "positions": [[x, y, z], …]},
              {"time": 2.0, "object": 0, "vertices": [0, 7], "positions": [[…], […]], "velocities": [[…], […]],
               "weight": 2.0, "hard": true},
              {"time": 2.0, "vertices": [4, 5, 6], "average": [x, y, z]},
              {"time": 2.0, "centre": [x, y, z]}]}

or from a motion in any format, of which each frame after the start is a key. Without `vertices` all of the object
count; `average` asks for the mean of some vertices, `centre` for the centre of mass.

On the first path a displacement from the motion without control goes through the keys: by a cubic spline in time from
rest, and over the cloth so that vertices without a key lie between those with one (the discrete harmonic function).
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import FARTHEST
from clothfit.base.messages import unreadable
from clothfit.base.reading import MOST_TEXT
from clothfit.base.reading import whole as whole_file
from clothfit.engine.inputs.interpolation import splined
from clothfit.motion.motion import Motion
from clothfit.scene.scene import Scene

FIELDS = ("time", "object", "vertices", "positions", "velocities", "average", "centre", "weight", "hard")

MOST_KEYS = 10_000

ON_STEP = 1e-3
"""Share of a time step by which a key may be beside a step."""


@dataclass(frozen=True, eq=False)
class Key:
    """What is asked of one object after one step."""

    step: int  # from 1 on: the state after so many steps
    cloth: int  # of the scene, counted from 0
    vertices: Indices  # (m,)
    positions: Array  # (m, 3), m; (1, 3) of a mean
    velocities: Array | None = None  # (m, 3), m/s
    share: Array | None = None  # (m,), of each vertex in the mean; None: each by itself
    weight: float = 1.0  # how much it counts, where it cannot be met
    hard: bool = False  # whether it is to be met to 1 µm


def from_motion(motion: Motion, scene: Scene) -> list[Key]:
    """The frames of a motion after the start as keys. Raises InvalidInput."""
    found = []
    for frame, time in enumerate(motion.times):
        if time < 0.5 * scene.delta:
            continue
        step = step_of(float(time), scene, f"{motion.name}: frame {frame}")
        for cloth in range(len(scene.cloths)):
            vertices = np.flatnonzero(motion.seen(cloth)[frame]).astype(np.int32)
            if len(vertices):
                found.append(Key(step, cloth, vertices, motion.of(cloth)[frame, vertices]))
    if not found:
        raise InvalidInput(f"{motion.name}: has no frame after the start; at least one key is needed")
    return checked(found, motion.name)


def from_json(text: str, name: str, scene: Scene) -> list[Key]:
    """Keys from JSON. Raises InvalidInput with the place of what is wrong."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidInput(f"{name}: is not JSON: {error}") from None
    items = document.get("keys") if isinstance(document, dict) else None
    if not isinstance(items, list) or not items:
        raise InvalidInput(f"{name}: keys: a list with at least one key is needed")
    if len(items) > MOST_KEYS:
        raise InvalidInput(f"{name}: keys: has {len(items)} items; at most {MOST_KEYS} are possible")
    return checked([key(item, f"{name}: keys[{i}]", scene) for i, item in enumerate(items)], name)


def load_keys(path: str, scene: Scene) -> list[Key]:
    """Keys from a file of JSON. Raises InvalidInput."""
    name = os.path.basename(path)
    try:
        with open(path, "rb") as file:
            text = whole_file(file, MOST_TEXT).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInput(f"{name}: {unreadable(error)}") from None
    return from_json(text, name, scene)


def checked(keys: list[Key], name: str) -> list[Key]:
    """The keys in order of time. Raises InvalidInput where two ask for the same vertex at the same time."""
    asked: set[tuple[int, int, int]] = set()
    for each in keys:
        if each.share is not None:
            continue
        for vertex in each.vertices.tolist():
            place = (each.step, each.cloth, vertex)
            if place in asked:
                raise InvalidInput(f"{name}: keys: two ask for vertex {vertex} of objects[{each.cloth}] at one time")
            asked.add(place)
    return sorted(keys, key=lambda each: each.step)


def key(item: Any, place: str, scene: Scene) -> Key:
    """One key of a document."""
    if not isinstance(item, dict):
        raise InvalidInput(f"{place}: is not an object")
    for name in item:
        if name not in FIELDS:
            raise InvalidInput(f"{place}.{name}: there is no such field; there are {', '.join(FIELDS)}")
    step = step_of(number(item.get("time"), f"{place}.time"), scene, place)
    cloth = whole(item.get("object", 0), f"{place}.object", len(scene.cloths), "object")
    mass, weight = scene.cloths[cloth].mass, number(item.get("weight", 1.0), f"{place}.weight")
    if not 1e-6 <= weight <= 1e6:
        raise InvalidInput(f"{place}.weight: must be within 1e-06 … 1e+06; {weight:g} was given")
    hard = item.get("hard", False)
    if not isinstance(hard, bool):
        raise InvalidInput(f"{place}.hard: must be true or false")
    ways = [name for name in ("positions", "average", "centre") if name in item]
    if len(ways) != 1:
        have = " and ".join(ways) or "none"
        raise InvalidInput(f"{place}: needs one of positions, average and centre; it has {have}")
    vertices = listed(item.get("vertices"), f"{place}.vertices", len(mass))
    if ways[0] == "positions":
        positions = points(item["positions"], f"{place}.positions", len(vertices))
        given = item.get("velocities")
        velocities = None if given is None else points(given, f"{place}.velocities", len(vertices))
        return Key(step, cloth, vertices, positions, velocities, None, weight, hard)
    if "velocities" in item:
        raise InvalidInput(f"{place}.velocities: go with positions only")
    if ways[0] == "centre" and "vertices" in item:
        raise InvalidInput(f"{place}.vertices: the centre of mass is that of all; ask for the average of some")
    share = mass[vertices] if ways[0] == "centre" else np.ones(len(vertices))
    mean = points([item[ways[0]]], f"{place}.{ways[0]}", 1)
    return Key(step, cloth, vertices, mean, None, share / share.sum(), weight, hard)


def step_of(time: float, scene: Scene, place: str) -> int:
    """The step that ends at a time, s."""
    if not time / scene.delta < np.iinfo(np.int32).max:
        raise InvalidInput(f"{place}: {time:g} s is too many steps of {scene.delta:g} s after the start")
    step = round(time / scene.delta)
    if step < 1:
        raise InvalidInput(f"{place}: {time:g} s is not after the start; the first step ends at {scene.delta:g} s")
    if abs(time / scene.delta - step) > ON_STEP * max(1.0, 1e-3 * step):
        near = step * scene.delta
        between = f"{time:g} s is between two steps of {scene.delta:g} s"
        raise InvalidInput(f"{place}: {between}; the nearest ends at {near:g} s")
    return step


def number(value: Any, place: str) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < FARTHEST:
        raise InvalidInput(f"{place}: {'is missing' if value is None else f'is not a number below {FARTHEST:g}'}")
    return float(value)


def whole(value: Any, place: str, count: int, what: str) -> int:
    """A number of one of `count` things."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        raise InvalidInput(f"{place}: there is no such {what}; there are {count}, counted from 0")
    return value


def listed(value: Any, place: str, count: int) -> Indices:
    """Numbers of vertices, all where there are none."""
    if value is None:
        return np.arange(count, dtype=np.int32)
    if not isinstance(value, list) or not value:
        raise InvalidInput(f"{place}: must be a list of vertices")
    found = [whole(each, f"{place}[{i}]", count, "vertex") for i, each in enumerate(value)]
    if len(set(found)) < len(found):
        raise InvalidInput(f"{place}: names a vertex twice")
    return np.array(found, np.int32)


def points(value: Any, place: str, count: int) -> Array:
    """Vectors (count, 3)."""
    if not isinstance(value, list) or len(value) != count:
        have = f"{len(value)} items" if isinstance(value, list) else "no list"
        raise InvalidInput(f"{place}: has {have} for {count} vertices")
    for i, each in enumerate(value):
        if not isinstance(each, list) or len(each) != 3:
            raise InvalidInput(f"{place}[{i}]: must be three numbers")
        for c in each:
            if isinstance(c, bool) or not isinstance(c, (int, float)) or not abs(c) < FARTHEST:
                raise InvalidInput(f"{place}[{i}]: must be three finite numbers")
    return np.array(value, float).reshape(count, 3)


def last_step(keys: Sequence[Key]) -> int:
    """The step after which the last key is."""
    return max(each.step for each in keys)


def left_of(key: Key, x: Array) -> Array:
    """How far positions x (T + 1, n, 3) are from a key, (m, 3), m."""
    own = x[key.step, key.vertices]
    return np.asarray((own if key.share is None else (key.share @ own)[None]) - key.positions)


def without_fixed(key: Key, fixed: Flags) -> Key:
    """A key without the fixed vertices, whose place is given; a mean keeps them."""
    if key.share is not None:
        return key
    kept = ~fixed[key.vertices]
    velocities = None if key.velocities is None else key.velocities[kept]
    return replace(key, vertices=key.vertices[kept], positions=key.positions[kept], velocities=velocities)


def path(free: Array, keys: Sequence[Key], springs: Indices, fixed: Flags) -> Array:
    """A path (T + 1, n, 3), m, through the keys, T the last of them, from the motion `free` (T + 1, n, 3)."""
    wanted: dict[int, tuple[Array, Flags]] = {}
    for key in keys:
        away, known = wanted.setdefault(key.step, (np.zeros_like(free[0]), np.zeros(len(fixed), bool)))
        if key.share is None:
            away[key.vertices] = key.positions - free[key.step, key.vertices]
        else:
            more = key.positions[0] - key.share @ free[key.step, key.vertices]
            away[key.vertices] = np.where(known[key.vertices, None], away[key.vertices], more)
        known[key.vertices] = True
    steps = sorted(wanted)
    rows = [np.zeros_like(free[0])]
    for step in steps:
        away, known = wanted[step]
        away[fixed & ~known] = 0.0
        rows.append(harmonic(away, known | fixed, springs))
    times = np.array([0, *steps], float)
    found = splined(times, np.array(rows), "keys")(np.arange(len(free)))
    moved: Array = free + found
    moved[:, fixed] = free[:, fixed]
    return moved


def harmonic(values: Array, known: Flags, springs: Indices) -> Array:
    """Values (n, 3) where they are known, and means of their neighbours elsewhere."""
    from scipy.sparse import csr_array, diags_array
    from scipy.sparse.linalg import splu

    n = len(values)
    ends = np.concatenate([springs, springs[:, ::-1]])
    graph = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n))
    laplacian = csr_array(diags_array(graph.sum(axis=1) + 1e-9) - graph)  # vertices without springs get 0
    open_ = np.flatnonzero(~known)
    if not len(open_):
        return values
    right = graph[open_][:, np.flatnonzero(known)] @ values[known]
    found = values.copy()
    found[open_] = splu(laplacian[open_][:, open_].tocsc()).solve(np.asarray(right))
    return found
