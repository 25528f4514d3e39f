"""Inputs over time as a list of their own, outside of a scene: what plays a subspace, and what it was recorded with.

    [{"acts": "wind", "times": [0, 1], "values": [[0, 0, 0], [5, 0, 0]], "interpolation": "smooth"}, …]

`acts` is wind, gravity, pins, collider or frame. Wind and gravity have `values`, which are added to those of the
scene; pins `offsets`, or `pos` and `rot`, for `vertices` (default: all that are fixed) of an `object` (default: 0); a
collider `pos` and `rot` and its number `collider`; the frame `pos` and `rot`. Instead of times and numbers there may
be a `file`. They mean what the keys of a scene mean (docs/scene.md), and take the place of those for what they act
on.

Or at random, within ranges: what a subspace is to be able to follow is what its recorded motions show.

An episode has gusts, band-limited as splines through keys a `period` apart, each key uniform within ±`wind` along every
axis; steps of all pins together within ±`pins`; and a `pace`: what moves in the scene (pins, obstacles, its axes) does
so that much faster, all of it together, so that a figure stays whole. Every second episode ends with inputs at rest for
a third of its time, so that the motions show how the cloth comes to rest. The same seed gives the same inputs.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import unreadable
from clothfit.base.reading import MOST_TEXT, unchanged, whole
from clothfit.engine.inputs.interpolation import resolved
from clothfit.scene.cloth import wind_of
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
        if acts == "pins":
            scene = _pins(scene, item, found, place)
        elif acts == "collider":
            scene = _collider(scene, item, found, place)
        elif acts == "frame":
            scene = replace(scene, frame=Frame(found["pos"], found["rot"], None))
        else:
            keys: dict[str, Any] = {f"{acts}_keys": found["values"]}
            scene = replace(scene, **keys)
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


def index(value: Any, count: int, place: str) -> int:
    """A number below `count`. Raises InvalidInput."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        raise InvalidInput(f"{place}: {value!r} is none of the {count} there are, counted from 0")
    return value


GENTLE = 0.25
"""The push of the gusts on a cloth that faces them, relative to its weight, where nobody says how strong they are."""


@dataclass(frozen=True)
class Ranges:
    """How far the inputs of episodes go."""

    wind: float  # m/s, added to the scene's along each axis; 0: none
    pins: float = 0.0  # m, along each axis
    pace: float = 1.25  # at most, and at least its inverse
    period: float = 0.4  # s between two keys

    def check(self) -> None:
        """Raise InvalidInput where a number is impossible."""
        for name, value, least in (("wind", self.wind, 0.0), ("pins", self.pins, 0.0), ("pace", self.pace, 1.0)):
            if not (np.isfinite(value) and value >= least):
                raise InvalidInput(f"--{name} must be at least {least:g}; {value:g} was given")


@dataclass(frozen=True)
class Episode:
    """What the inputs of one motion are."""

    items: tuple[dict[str, Any], ...]  # as `inputs` has them
    pace: float = 1.0


def gentle_wind(scene: Scene) -> float:
    """The wind, m/s, that pushes the cloths of a scene with a part of their weight; 0 where they feel no air."""
    mass = sum(float(cloth.mass[~cloth.fixed].sum()) for cloth in scene.cloths)
    push = GENTLE * mass * float(np.linalg.norm(scene.gravity))
    return float(f"{wind_of(push, scene.cloths, [cloth.drag for cloth in scene.cloths]):.2g}")


def episodes(scene: Scene, ranges: Ranges, count: int, seconds: float, seed: int) -> list[Episode]:
    """So many episodes of a scene; the same ones for the same seed, however many follow."""
    ranges.check()
    return [episode(scene, ranges, seconds, np.random.default_rng([seed, i]), i % 2 == 1) for i in range(count)]


def episode(scene: Scene, ranges: Ranges, seconds: float, rng: np.random.Generator, rests: bool) -> Episode:
    """One of them; `rests` says whether its inputs come to rest."""
    times: Array = np.arange(0.0, seconds + 3.0 * ranges.period, ranges.period)
    kept = np.where(times < 2.0 / 3.0 * seconds, 1.0, 0.0) if rests else np.ones(len(times))
    gusts, steps = (rng.uniform(-1.0, 1.0, (len(times), 3)) * each for each in (ranges.wind, ranges.pins))
    steps[0] = 0.0
    blown, moved = ((each * kept[:, None]).tolist() for each in (gusts, steps))
    own, items = {"times": times.tolist(), "interpolation": "smooth"}, list[dict[str, Any]]()
    if ranges.wind > 0:
        items.append({"acts": "wind", **own, "values": blown})
    if ranges.pins > 0:
        held = [i for i, cloth in enumerate(scene.cloths) if cloth.fixed.any()]
        items += [{"acts": "pins", **own, "object": i, "offsets": moved} for i in held]
    pace = float(np.exp(rng.uniform(-1.0, 1.0) * np.log(ranges.pace)))
    return Episode(tuple(items), pace if scene.moves else 1.0)


def varied(scene: Scene, own: Episode) -> Scene:
    """The scene of an episode."""
    return applied(paced(scene, own.pace) if own.pace != 1.0 else scene, own.items)


def paced(scene: Scene, pace: float) -> Scene:
    """The scene, whose inputs over time run that much faster, but for its wind and gravity."""

    def faster(each: Any) -> Any:
        """What moves, with its keys so much faster."""
        found = {name: keys for name in ("position", "rotation") if (keys := getattr(each, name, None)) is not None}
        for name, keys in found.items():
            own = resolved(keys)
            found[name] = replace(own, times=own.times / pace, file=None, points=(), joint=None, said={})
        return replace(each, **found)

    cloths = tuple(replace(cloth, pins=tuple(map(faster, cloth.pins))) for cloth in scene.cloths)
    balls, others = tuple(map(faster, scene.spheres)), tuple(map(faster, scene.colliders))
    return replace(scene, cloths=cloths, spheres=balls, colliders=others, frame=scene.frame and faster(scene.frame))
