"""Motions in and out, in the format that the suffix of a file names: this program's `.npz`, or another program's.

`foreign` reads. Writing is here: which files, and whether they can be written. A sequence is many files, each of which
appears whole or not at all. Files of an earlier, longer sequence would be read as its end: `check_place` refuses that.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import IO, Any

import numpy as np

from clothfit.base.arrays import Indices
from clothfit.base.errors import InvalidInput
from clothfit.base.notebook import belongs
from clothfit.base.writing import Data, write_atomically
from clothfit.formats import obj
from clothfit.formats.animation import Animation
from clothfit.formats.axes import SCENE, Axes, Convention, Reading, facing, from_scene
from clothfit.formats.registry import FORMATS, Format, foreign, module_of
from clothfit.motion import motion as own
from clothfit.motion.foreign import load
from clothfit.motion.motion import Motion, arrays_of
from clothfit.scene.mesh_numbering import mesh_counts, picks, triangles_of, unwelded
from clothfit.scene.scene import Scene

SMALLEST, LARGEST = (float(size) for size in (np.finfo(np.float32).tiny, np.finfo(np.float32).max))


def load_motion(
    path_or_file: str | os.PathLike[str] | IO[bytes],
    scene: Scene,
    name: str | None = None,
    reading: Reading = Reading(),  # noqa: B008  it cannot be changed
) -> Motion:
    """Read a motion of `scene` from a file, whose suffix names the format, and check it.

    `reading` says what the file does not. `name` is for messages (default: the file's). An open file must be `.npz` or
    `.npy`. Raises InvalidMotion when the file cannot be read or does not fit the scene, InvalidInput when the library
    that reads it is missing.
    """
    loaded = load(path_or_file, scene, reading, name).motion
    belongs(loaded, scene)
    return loaded


def save_motion(
    motion: Motion,
    path_or_file: str | os.PathLike[str] | IO[bytes],
    scene: Scene | None = None,
    convention: Convention = Convention(),  # noqa: B008  it cannot be changed
) -> None:
    """Write a motion as `.npz`, or in the format that the suffix names; each file whole or not at all.

    `scene` gives the faces, for formats that have some. `convention` is the axes and unit to write in (default: the
    format's). An open file becomes `.npz`. Raises InvalidInput when a path cannot be written or the format cannot hold
    the motion.
    """
    own.check_loaded(motion)
    found = foreign(path_or_file)
    if found is None or not isinstance(path_or_file, (str, os.PathLike)):
        own.save_motion(motion, path_or_file)
        return
    check_place(path_or_file, len(motion.times))
    whole, faces = (motion, None) if scene is None else for_tools(motion, scene, found)
    made = animation(whole, found, convention.axes(found.axes), faces)
    write_all(files(path_or_file, found, made))


def animation(
    motion: Motion, kind: Format, axes: Axes, triangles: Indices | None = None, names: tuple[str, ...] | None = None
) -> Animation:
    """A motion as a file holds it, with faces `triangles` (T, 3) in the scene's axes and `names` of its markers.

    Raises InvalidInput where the format cannot hold gaps.
    """
    if motion.observed is not None:
        check_gaps(kind)
    positions = from_scene(motion.positions, axes) if axes != SCENE else motion.positions
    if motion.observed is not None:
        positions = np.where(motion.observed[:, :, None], positions, np.nan)
    faces = None if triangles is None else np.ascontiguousarray(facing(triangles, axes), np.int32)
    return Animation(positions, axes, motion.times, faces, motion.observed, names)


def check_gaps(kind: Format) -> None:
    """Raise InvalidInput unless a format can leave out positions."""
    if not kind.markers:
        others = ", ".join([".npz", *(each.suffixes[0] for each in FORMATS if each.markers)])
        raise InvalidInput(f"{kind.name} cannot leave out positions that were not observed; write one of {others}")


def files(path: str | os.PathLike[str], kind: Format, made: Animation) -> dict[str, Data]:
    """The files to write an animation to. Raises InvalidInput, also where the format rounds positions to infinity or 0.
    """
    if kind.single:
        largest = max((float(np.nanmax(np.abs(points), initial=0.0)) for points in made.positions), default=0.0)
        if largest > LARGEST or 0 < largest < SMALLEST:
            raise InvalidInput(
                f"{os.fspath(path)}: coordinates up to {largest:.3g} do not fit into {kind.name}, which has single "
                f"precision ({SMALLEST:.3g} to {LARGEST:.3g}); write in another unit, or .npz"
            )
    encoded: dict[str, Data] = module_of(kind).encoded(os.fspath(path), made)
    return encoded


def write_all(files: Mapping[str, Data]) -> None:
    """Write each file whole or not at all. When one cannot be written, remove the new ones again, as the beginning of a
    sequence looks like a sequence. Raises InvalidInput.
    """
    made = []
    try:
        for path, data in files.items():
            if not os.path.lexists(path):
                made.append(path)
            write_atomically(path, data)
    except BaseException:  # an interrupt as well
        for path in made:
            with suppress(OSError):
                os.unlink(path)
        raise


def for_tools(motion: Motion, scene: Scene, kind: Format) -> tuple[Motion, Indices]:
    """A motion of a scene and its faces (T, 3), with the vertices of the meshes that the scene was made from, as other
    programs know them: welding may have renumbered them. Markers keep the scene's numbers. Raises InvalidScene.
    """
    faces, chosen = triangles_of(scene), picks(scene)
    if chosen is None or kind.markers:
        return motion, faces
    arrays = {name: array for name, array in arrays_of(motion).items() if name != "times"}
    made: dict[str, Any] = {name: unwelded(scene, array) for name, array in arrays.items()}
    return replace(motion, vertex_counts=mesh_counts(scene), **made), chosen[faces]


def check_place(path: str | os.PathLike[str], frames: int | None = None) -> None:
    """Check, before long work, that a motion of so many frames (None: not known yet) can be written there.

    Raises InvalidInput when the library is missing, the format can only be read, the name cannot be that of a sequence,
    or files of another sequence are in its place.
    """
    found = foreign(path)
    if found is None:
        return
    text = os.fspath(path)
    module_of(found)
    if not found.writes:
        raise InvalidInput(f"cannot write {text}: {found.name} can only be read")
    if found.module != "obj" or frames is None:
        return
    obj.check_name(text, frames)
    own_files = {obj.numbered_name(text, frame) for frame in range(frames)}
    for _, there in sorted(obj.numbered(text)) if obj.ANY in text else []:
        if there not in own_files:
            raise InvalidInput(
                f"cannot write {text}: {there} exists and would be read as one of its frames; remove it, or choose "
                "another name"
            )


def sources(path: str) -> list[str]:
    """The files of a motion: of a sequence all."""
    return obj.frames_of(path) if foreign(path) is not None and obj.ANY in path else [path]
