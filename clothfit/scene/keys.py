"""Inputs over time: keys, as a scene's file has them, or the file that they come from.

Keys say how a value changes over time: they are added to the value that the scene has. Before the first key and after
the last the value stays. Where keys move something, what counts is the change since time 0, as the scene says where it
is then.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices

INTERPOLATIONS = ("linear", "smooth", "hold")
"""How values lie between two keys: on a line, on a cubic spline of two continuous derivatives, as at the key before."""

MOST_KEYS = 1_000_000

SAID = ("fps", "scale", "up", "handedness", "mesh")
"""What keys may say of their file."""

OF_FILES = ("windVelKeys", "gravityKeys", "posKeys", "rotKeys", "scaleKeys", "motion", "mesh")
"""Fields that may name a file."""

LISTS = ("objects", "pins", "colliders")
"""Lists of what may have such fields."""


@dataclass(frozen=True, eq=False)
class Keys:
    """Values at times: numbers in the scene, or the file that has them. Those of a joint are its places, m, or its
    Euler angles, degrees, where the keys are of a rotation.
    """

    times: Array  # (K,), s, increasing; empty where a file has them
    values: Array  # (K, 3), in the unit of what they move
    interpolation: str = "linear"
    file: str | None = None  # a path
    points: tuple[int, ...] = ()  # of a motion in the file: which of its points
    joint: str | None = None  # of an animation in the file: the one to follow
    said: dict[str, Any] = field(default_factory=dict)  # `SAID` of the file
    place: str = ""  # in the scene, for messages

    @property
    def datum(self) -> int:
        """The key at or before time 0, else the first: only the change since then counts where keys move something."""
        return max(int(np.searchsorted(self.times, 0.0, side="right")) - 1, 0)

    @property
    def turns(self) -> bool:
        """Whether they are those of a rotation."""
        return self.place.rpartition(".")[2] == "rotKeys"


@dataclass(frozen=True, eq=False)
class Pin:
    """Fixed vertices of an object that follow keys: all by the same displacement, all by one rotation, or each by the
    path of a point of a file.
    """

    vertices: Indices  # (P,)
    position: Keys | None  # displacement, m
    rotation: Keys | None  # Euler angles as those of colliders, degrees, about `pivot`
    pivot: Array | None  # (3,), m; None: where the joint starts, or the mean of the vertices at the start

    @property
    def own(self) -> Keys | None:
        """The keys of its positions, where the scene and no file has them: a fit may change these."""
        return None if self.position is None or self.position.file is not None else self.position


@dataclass(frozen=True, eq=False)
class Frame:
    """How the axes of a scene move in those of the world, with which they agree at time 0."""

    position: Keys | None  # displacement, m
    rotation: Keys | None  # Euler angles as those of colliders, degrees, about `pivot`
    pivot: Array | None  # (3,), m; None: where the joint starts, or the origin


def keys(item: Any, place: str, folder: str, problems: list[str]) -> Keys | None:
    """The keys in a field of the document at `place`, None where the field is absent or faulty; faults go to
    `problems`. Paths are relative to `folder`.
    """
    if item is None:
        return None
    own = [name for name in ("times", "values") if name in item]
    if "file" in item and own:
        return refuse(problems, place, f"has both a file and {' and '.join(own)}; give one of them")
    kind = item.get("interpolation", "linear")
    said = {name: item[name] for name in SAID if name in item}
    if "file" in item:
        path = os.path.join(folder, item["file"])
        points, joint = tuple(item.get("points", ())), item.get("joint")
        if points and joint is not None:
            return refuse(problems, place, "has both points and a joint; give one of them")
        return Keys(np.zeros(0), np.zeros((0, 3)), kind, path, points, joint, said, place)
    if len(own) < 2:
        return refuse(problems, place, "needs times and values, or a file")
    if said or "points" in item or "joint" in item:
        return refuse(
            problems, place, f"{', '.join(SAID)}, points and joint belong to a file, and there is none"
        )
    times = np.array(item["times"], float)
    values = np.array([[each["x"], each["y"], each["z"]] for each in item["values"]], float).reshape(-1, 3)
    wrong = times_problem(times, len(values))
    if wrong:
        return refuse(problems, f"{place}.{wrong[0]}", wrong[1])
    return Keys(times, values, kind, place=place)


def times_problem(times: Array, count: int) -> tuple[str, str] | None:
    """What is wrong with the times of `count` values, as the field and a sentence."""
    if not len(times):
        return "times", "is empty; at least one key is needed"
    if len(times) != count:
        return "values", f"has {count} items for {len(times)} times"
    if len(times) > MOST_KEYS:
        return "times", f"has {len(times)} items; at most {MOST_KEYS} are possible"
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        i = int(late[0]) + 1
        return f"times[{i}]", f"{times[i]:g} s is not later than {times[i - 1]:g} s before it; times must increase"
    return None


def scales(item: Any, place: str, folder: str, problems: list[str]) -> Keys | None:
    """The same of a scale, which is above 0 and has no joint to come from."""
    found = keys(item, place, folder, problems)
    if found is None:
        return None
    if found.joint is not None:
        return refuse(problems, place, "a joint has no scale; give times and values, or a table")
    for i, axis in np.argwhere(found.values <= 0.0)[:1]:
        value = found.values[i, axis]
        return refuse(problems, f"{place}.values[{i}].{'xyz'[axis]}", f"{value:g} is too small; it must be above 0")
    return found


def refuse(problems: list[str], place: str, sentence: str) -> Keys | None:
    """Note a problem with keys, of which there are then none."""
    problems.append(f"{place}: {sentence}")
    return None


def frame(item: Any, folder: str, problems: list[str]) -> Frame | None:
    """The field `frame` of a document, None where it is absent or faulty; faults go to `problems`."""
    if item is None:
        return None
    return Frame(*_moves(item, "frame", folder, problems))


def _moves(
    item: Mapping[str, Any], place: str, folder: str, problems: list[str]
) -> tuple[Keys | None, Keys | None, Array | None]:
    """The keys of displacements and of angles in what moves, and the point (3,), m, about which it turns."""
    position, rotation = (keys(item.get(name), f"{place}.{name}", folder, problems) for name in ("posKeys", "rotKeys"))
    if "posKeys" not in item and "rotKeys" not in item:
        refuse(problems, place, "needs posKeys, rotKeys or both")
    pivot = np.array([item["pivot"][axis] for axis in "xyz"], float) if "pivot" in item else None
    return position, rotation, pivot


def pins(items: Sequence[Any], fixed: Flags, place: str, folder: str, problems: list[str]) -> tuple[Pin, ...]:
    """The pins of an object whose vertices are `fixed` (n,); faults go to `problems`."""
    found: list[Pin] = []
    owner = np.full(len(fixed), -1)
    for i, item in enumerate(items):
        here, before = f"{place}.pins[{i}]", len(problems)
        vertices = [int(each) for each in np.asarray(item["vertices"], object).reshape(-1)]
        for j, vertex in enumerate(vertices):
            entry = f"{here}.vertices[{j}]"
            if not vertex < len(fixed):
                refuse(problems, entry, f"{vertex} is no vertex; the object has {len(fixed)}, counted from 0")
            elif not fixed[vertex]:
                refuse(problems, entry, f"vertex {vertex} is not fixed (vertIsFixed); only fixed vertices follow keys")
            elif owner[vertex] >= 0:
                where = "twice in this pin" if owner[vertex] == i else f"in pins[{owner[vertex]}] as well"
                refuse(problems, entry, f"vertex {vertex} is {where}")
            else:
                owner[vertex] = i
                continue
            break
        moves = _moves(item, here, folder, problems)
        if len(problems) == before:
            found.append(Pin(np.array(vertices, np.int32), *moves))
    return tuple(found)


def files_from(document: Mapping[str, Any], folder: str, to: str) -> dict[str, Any]:
    """Where paths of files in a document change when it moves from a folder `to` another one, nested as they are in it;
    items of lists by their places.
    """
    old, new = os.path.realpath(folder), os.path.realpath(to)

    def moved(path: str) -> str:
        """The path from the new folder."""
        if os.path.isabs(path) or old == new:
            return path
        place, name = os.path.split(os.path.join(old, path))
        try:
            way = os.path.relpath(os.path.realpath(place), new)
            return os.path.normpath(os.path.join(way, name)).replace(os.sep, "/")
        except ValueError:  # on another drive
            return os.path.join(place, name)

    return _changed_files(document, moved)


def _changed_files(item: Mapping[str, Any], moved: Callable[[str], str]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in item.items():
        if name in LISTS and isinstance(value, list):
            own = {i: _changed_files(each, moved) for i, each in enumerate(value)}
            found[name] = {i: each for i, each in own.items() if each}
        elif name == "frame" and isinstance(value, dict):
            found[name] = _changed_files(value, moved)
        elif name in OF_FILES and isinstance(value, dict) and isinstance(value.get("file"), str):
            found[name] = {"file": moved(value["file"])}
        elif name == "mesh" and isinstance(value, str):
            found[name] = moved(value)
    return {name: value for name, value in found.items() if value}
