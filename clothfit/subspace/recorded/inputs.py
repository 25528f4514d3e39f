"""Inputs over time as a list of their own, outside of a scene: what plays a subspace, and what it was recorded with.

    [{"acts": "wind", "times": [0, 1], "values": [[0, 0, 0], [5, 0, 0]], "interpolation": "smooth"}, …]

`acts` is wind, gravity, pins, collider or frame. Wind and gravity have `values`, which are added to those of the
scene; pins `offsets`, or `pos` and `rot`, for `vertices` (default: all that are fixed) of an `object` (default: 0); a
collider `pos` and `rot` and its number `collider`; the frame `pos` and `rot`. Instead of times and numbers there may
be a `file`. They mean what the keys of a scene mean (docs/scene.md), and take the place of those for what they act
on.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import unreadable
from clothfit.base.reading import MOST_TEXT, unchanged, whole
from clothfit.scene.keys import INTERPOLATIONS, Frame, Keys, Pin, times_problem
from clothfit.scene.scene import Scene

NUMBERS = {"wind": ("values",), "gravity": ("values",), "pins": ("offsets", "pos", "rot"), "collider": ("pos", "rot"),
           "frame": ("pos", "rot")}  # fmt: skip
"""What each thing may be given."""

COMMON = {"acts", "times", "interpolation", "file"}
EXTRA = {"pins": {"object", "vertices"}, "collider": {"collider"}}


def load(path: str) -> list[dict[str, Any]]:
    """The list of a file. Raises InvalidInput."""
    try:
        with unchanged(path) as file:
            document = json.loads(whole(file, MOST_TEXT))
    except OSError as error:
        raise InvalidInput(f"{path}: {unreadable(error)}") from None
    except (ValueError, RecursionError):
        raise InvalidInput(f"{path}: it is not JSON with a list of inputs") from None
    items = document.get("inputs") if isinstance(document, dict) else document
    if not isinstance(items, list) or not all(isinstance(each, dict) for each in items):
        raise InvalidInput(f'{path}: it has no list "inputs"')
    return items


def applied(scene: Scene, items: Sequence[Mapping[str, Any]], folder: str = "", name: str = "inputs") -> Scene:
    """The scene with these inputs in place of its own for what they act on; paths are relative to `folder`. Raises
    InvalidInput, which names the item.
    """
    for i, item in enumerate(items):
        place = f"{name}: inputs[{i}]"
        acts = item.get("acts")
        if acts not in NUMBERS:
            raise InvalidInput(f"{place}.acts: {acts!r} is none of {', '.join(NUMBERS)}")
        unknown = sorted(set(item) - COMMON - set(NUMBERS[acts]) - EXTRA.get(acts, set()))
        if unknown:
            raise InvalidInput(f"{place}: {acts} has no {unknown[0]}")
        found = {part: keys_of(item, part, f"{place}", folder) for part in NUMBERS[acts]}
        if not any(found.values()):
            raise InvalidInput(f"{place}: needs {' or '.join(NUMBERS[acts])}, with times, or a file")
        scene = ACTIONS[acts](scene, item, found, place)
    return scene


def keys_of(item: Mapping[str, Any], part: str, place: str, folder: str) -> Keys | None:
    """The keys of one part of an item; None where it has none."""
    field = f"{place}.{'rotKeys' if part == 'rot' else part}"
    kind = item.get("interpolation", "linear")
    if kind not in INTERPOLATIONS:
        raise InvalidInput(f"{place}.interpolation: {kind!r} is none of {', '.join(INTERPOLATIONS)}")
    if "file" in item:
        first = next(iter(NUMBERS[item["acts"]]))
        if not isinstance(item["file"], str) or part != first:
            return None
        return Keys(np.zeros(0), np.zeros((0, 3)), kind, os.path.join(folder, item["file"]), place=field)
    if part not in item:
        return None
    times, values = numbers(item.get("times"), f"{place}.times", 1), numbers(item[part], f"{place}.{part}", 2)
    wrong = times_problem(times, len(values))
    if wrong:
        raise InvalidInput(f"{place}.{wrong[0]}: {wrong[1]}")
    return Keys(times, values, kind, place=field)


def numbers(value: Any, place: str, dimensions: int) -> Array:
    """Finite numbers (K,) or (K, 3). Raises InvalidInput."""
    try:
        rows = [[row[a] for a in "xyz"] if isinstance(row, dict) else row for row in value]
        found = np.array(rows, float)
    except (TypeError, ValueError, KeyError, OverflowError):
        raise InvalidInput(f"{place}: needs a list of {'numbers' if dimensions == 1 else 'vectors'}") from None
    if found.ndim != dimensions or (dimensions == 2 and found.shape[1] != 3) or not np.isfinite(found).all():
        raise InvalidInput(f"{place}: needs a list of finite {'numbers' if dimensions == 1 else 'vectors x, y, z'}")
    return found


def _wind(scene: Scene, item: Mapping[str, Any], found: dict[str, Keys | None], place: str) -> Scene:
    return replace(scene, wind_keys=found["values"])


def _gravity(scene: Scene, item: Mapping[str, Any], found: dict[str, Keys | None], place: str) -> Scene:
    return replace(scene, gravity_keys=found["values"])


def _pins(scene: Scene, item: Mapping[str, Any], found: dict[str, Keys | None], place: str) -> Scene:
    number = index(item.get("object", 0), len(scene.cloths), f"{place}.object")
    cloth = scene.cloths[number]
    asked = item.get("vertices")
    if asked is None:
        vertices = np.flatnonzero(cloth.fixed).astype(np.int32)
    else:
        listed = asked if isinstance(asked, list) else [asked]
        vertices = np.array([index(each, len(cloth.mass), f"{place}.vertices") for each in listed], np.int32)
    if not len(vertices) or not cloth.fixed[vertices].all() or len(np.unique(vertices)) < len(vertices):
        raise InvalidInput(f"{place}.vertices: only fixed vertices, each once, follow keys")
    if found["offsets"] and found["pos"]:
        raise InvalidInput(f"{place}: has both offsets and pos; give one of them")
    kept = [pin for pin in cloth.pins if not np.isin(pin.vertices, vertices).any()]
    pin = Pin(vertices, found["offsets"] or found["pos"], found["rot"], None)
    cloths = list(scene.cloths)
    cloths[number] = replace(cloth, pins=(*kept, pin))
    return replace(scene, cloths=tuple(cloths))


def _collider(scene: Scene, item: Mapping[str, Any], found: dict[str, Keys | None], place: str) -> Scene:
    places = {each.place: i for i, each in enumerate(scene.colliders)}
    number = item.get("collider", 0)
    if number in places:
        i = places[number]
        changed = replace(scene.colliders[i], position=found["pos"], rotation=found["rot"])
        return replace(scene, colliders=(*scene.colliders[:i], changed, *scene.colliders[i + 1 :]))
    plain = [i for i in range(len(scene.spheres) + len(scene.colliders)) if i not in places]
    if number not in plain or plain.index(number) >= len(scene.spheres):
        raise InvalidInput(f"{place}.collider: there is no collider {number!r}")
    i = plain.index(number)
    ball = replace(scene.spheres[i], position=found["pos"])
    return replace(scene, spheres=(*scene.spheres[:i], ball, *scene.spheres[i + 1 :]))


def _frame(scene: Scene, item: Mapping[str, Any], found: dict[str, Keys | None], place: str) -> Scene:
    return replace(scene, frame=Frame(found["pos"], found["rot"], None))


def index(value: Any, count: int, place: str) -> int:
    """A number below `count`. Raises InvalidInput."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        raise InvalidInput(f"{place}: {value!r} is none of the {count} there are, counted from 0")
    return value


ACTIONS = {"wind": _wind, "gravity": _gravity, "pins": _pins, "collider": _collider, "frame": _frame}
