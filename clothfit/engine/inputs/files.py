"""Keys that come from a file: a table of this kind of numbers, or points of a motion in any format that is read.

A table is a `.csv` with the columns time, x, y, z, in s and in the unit of what the keys change, or an `.npz` with
`times` (K,) and `values` (K, 3). All else is a motion: its points are turned into the scene's axes and metres.
"""

from __future__ import annotations

import csv
import os
import re
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from clothfit.base import npz
from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput, InvalidMotion, InvalidScene
from clothfit.base.reading import unchanged
from clothfit.formats.animation import ASSUMED_RATE, with_gaps
from clothfit.formats.axes import Reading, to_scene
from clothfit.formats.files import content, name_of, refused
from clothfit.formats.registry import format_of, read_format, suffix_of
from clothfit.scene.keys import Keys, times_problem

PATHS = re.compile(r"\.pins\[\d+\]\.posKeys$|\.(motion|mesh)$")
"""Places of keys that may be of several points; all others are one vector."""

MOST_TEXT = 1 << 28
"""Bytes of a table, at most."""


def loaded(keys: Keys) -> Keys:
    """Keys from a file, with its numbers. Raises InvalidScene, with their place, where they are not in it."""
    assert keys.file is not None
    try:
        said, stamp = tuple(sorted(keys.said.items())), stamp_of(keys.file)
        if keys.joint is None:
            times, values = numbers(keys.file, keys.points, said, stamp)
        else:
            times, places, angles = joint_of(keys.file, keys.joint, said, stamp)
            values = angles if keys.turns else places
        if values.ndim == 3 and keys.place and not PATHS.search(keys.place):
            values = the_one(values)
    except (InvalidMotion, InvalidInput) as error:
        raise InvalidScene(f"{keys.place}.file: {error}") from None
    return replace(keys, times=times, values=values)


def the_one(values: Array) -> Array:
    """The values (K, 3) of the only point of a motion (K, P, 3). Raises InvalidInput where there are several."""
    if values.shape[1] != 1:
        raise InvalidInput(f'has {values.shape[1]} points, and one vector is needed; choose one: "points": [0]')
    return values[:, 0]


def stamp_of(path: str) -> tuple[int, int, int] | None:
    """What changes when a file does; None where it cannot be looked at."""
    try:
        status = os.stat(path)
        return status.st_ino, status.st_size, status.st_mtime_ns
    except (OSError, ValueError):
        return None


@lru_cache(maxsize=32)
def numbers(path: str, points: tuple[int, ...], said: tuple[tuple[str, Any], ...], stamp: Any) -> tuple[Array, Array]:
    """The times (K,), s, and values (K, 3) or (K, P, 3) of a file that has this `stamp`, its size and age. Raises
    InvalidMotion, InvalidInput.
    """
    reading = Reading(**dict(said))
    suffix = os.path.splitext(path)[1].lower()
    table = csv_table(path) if suffix == ".csv" else npz_table(path) if suffix == ".npz" else None
    if table is not None:
        times, values = table
        if points:
            raise InvalidInput(f"{name_of(path)}: is a table of one signal; points belong to a motion")
    else:
        times, values = motion_of(path, reading)
        if points and max(points) >= values.shape[1]:
            raise InvalidInput(f"{name_of(path)}: there is no point {max(points)}; it has {values.shape[1]}, from 0")
        values = values[:, list(points)] if points else values
    wrong = times_problem(times, len(values))
    if wrong:
        raise InvalidMotion(f"{name_of(path)}: {wrong[0]}: {wrong[1]}")
    if not (np.isfinite(values).all() and np.isfinite(times).all()):
        raise InvalidMotion(f"{name_of(path)}: has gaps or numbers that are not finite; an input needs all of them")
    return times, values


@lru_cache(maxsize=32)
def joint_of(path: str, name: str, said: tuple[tuple[str, Any], ...], stamp: Any) -> tuple[Array, Array, Array]:
    """The times (K,), s, places (K, 3), m, and Euler angles (K, 3), degrees, of a joint in a file that has this
    `stamp`, in the scene's axes. Raises InvalidMotion, InvalidInput.
    """
    from scipy.spatial.transform import Rotation

    from clothfit.formats import joints

    found, reading = joints.read(path, name), Reading(**dict(said))
    if reading.fps is not None:
        raise InvalidInput(f"{name_of(path)}: its keys have times; fps belongs to files that count frames")
    places, turns = found.moved(reading.axes(found.axes))
    if not (np.isfinite(places).all() and np.isfinite(turns).all()):
        raise InvalidMotion(f"{name_of(path)}: the joint has numbers that are not finite")
    angles = Rotation.from_matrix(turns).as_euler("YXZ", degrees=True)  # as `sampling.rotation` reads them
    return found.times, places, angles[:, [1, 0, 2]]


def csv_table(path: str) -> tuple[Array, Array] | None:
    """The times and values of a CSV with four columns, of which the first line may name them; None for any other."""
    text = content(path, MOST_TEXT).decode("utf-8-sig", errors="replace")
    rows = [row for row in csv.reader(text.splitlines()) if any(cell.strip() for cell in row)]
    if not rows or any(len(row) != 4 for row in rows[:2]):
        return None
    found = []
    for i, row in enumerate(rows):
        try:
            found.append([float(cell) for cell in row])
        except ValueError:
            if i > 0:
                reason = f"line {i + 1} is not four numbers: time, x, y, z"
                raise InvalidMotion(f"{name_of(path)}: {reason}") from None
        if found and len(row) != 4:
            raise InvalidMotion(f"{name_of(path)}: line {i + 1} has {len(row)} columns; time, x, y, z are needed")
    table = np.array(found, float).reshape(-1, 4)
    return np.ascontiguousarray(table[:, 0]), np.ascontiguousarray(table[:, 1:])


def arrays_of(path: str, needed: str) -> dict[str, Array]:
    """The array `needed` of an archive, and its `times` where it has them; none where that one is not there. Raises
    InvalidMotion.
    """
    try:
        with refused(path), unchanged(path) as file:
            found = npz.stored(file, ("times", needed), "positions")
            return {name: np.asarray(each.read(), float) for name, each in found.items()} if needed in found else {}
    except InvalidMotion:
        raise
    except npz.FAULTS as error:
        raise InvalidMotion(f"{name_of(path)}: is damaged: {error}") from None


def npz_table(path: str) -> tuple[Array, Array] | None:
    """The arrays `times` and `values` of an archive; None where it has no `values`."""
    arrays = arrays_of(path, "values")
    if not arrays:
        return None
    if "times" not in arrays:
        raise InvalidMotion(f"{name_of(path)}: has values but no times")
    times, values = arrays["times"], arrays["values"]
    if times.ndim != 1 or values.ndim != 2 or values.shape[1] != 3:
        shapes = f"times {times.shape} and values {values.shape}"
        raise InvalidMotion(f"{name_of(path)}: {shapes}; (K,) and (K, 3) are needed")
    return times, values


def motion_of(path: str, reading: Reading) -> tuple[Array, Array]:
    """The times (K,), s, and points (K, P, 3), m, of a motion; the first frame is at time 0."""
    found = format_of(path) if suffix_of(path) else None
    if found is None:
        return own_motion(path, reading)
    animation = read_format(found, path, reading.mesh or "")
    frames = np.arange(len(animation.positions), dtype=float) * animation.spacing
    if reading.fps is not None:
        times = frames / reading.fps
    elif animation.times is not None:
        times = animation.times - animation.times[0]
    else:
        times = frames / ASSUMED_RATE
    return times, to_scene(with_gaps(animation), reading.axes(animation.axes))


def own_motion(path: str, reading: Reading) -> tuple[Array, Array]:
    """The same of this program's own files, which are in the scene's axes. Raises InvalidMotion."""
    arrays = arrays_of(path, "positions")
    if not arrays:
        raise InvalidMotion(f"{name_of(path)}: has neither values nor positions")
    positions = arrays["positions"]
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise InvalidMotion(f"{name_of(path)}: positions {positions.shape}; (frames, points, 3) are needed")
    frames = np.arange(len(positions), dtype=float)
    times = frames / reading.fps if reading.fps else arrays.get("times", frames / ASSUMED_RATE)
    return times.reshape(-1), positions
