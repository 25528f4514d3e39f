"""Experiments: targets, each with the scene it was recorded in.

The scenes have the same objects, vertex by vertex and spring by spring; places, fixed vertices, wind and time step may
differ. A fit finds the same parameters for all of them: those that the main scene flags.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted
from clothfit.motion.motion import Motion, as_motion, checked_motion
from clothfit.scene.kinds import REST
from clothfit.scene.scene import Scene

Recorded: TypeAlias = Motion | Array | str | os.PathLike[str]
"""A motion, positions (frames, vertices, 3) with one frame per step, or the path of a motion file."""

Targets: TypeAlias = Recorded | tuple[Recorded, Scene] | Sequence[Recorded | tuple[Recorded, Scene]]
"""One target, alone or with the scene it was recorded in, or a list of such."""


class Experiment(NamedTuple):
    """A target and its scene."""

    motion: Motion  # checked
    scene: Scene  # the main one, or another with the flags of the main one


def experiments(scene: Scene, targets: Targets) -> list[Experiment]:
    """Each target with its scene, which is the main one, `scene`, unless it is given.

    Raises InvalidMotion when a motion does not fit its scene, InvalidInput when there is none or the objects of a scene
    are not those of the main one.
    """
    listed: Sequence[Any] = targets if isinstance(targets, (list, tuple)) and not is_pair(targets) else [targets]
    if not listed:
        raise InvalidInput("target: none is given; at least one motion is needed")
    return [
        item if isinstance(item, Experiment) and item.scene is scene  # it was made here before
        else experiment(scene, *(item if is_pair(item) else (item, scene)))
        for item in listed
    ]  # fmt: skip


def is_pair(item: object) -> bool:
    """Whether it is a target and its scene."""
    return isinstance(item, tuple) and len(item) == 2 and isinstance(item[1], Scene)


def experiment(main: Scene, motion: Recorded, scene: Scene) -> Experiment:
    """One target and its scene, checked."""
    scene = flagged_as(scene, main)
    return Experiment(motion_of(motion, scene), scene)


def motion_of(motion: Recorded, scene: Scene) -> Motion:
    """A motion of a scene, however it is given, checked; a shape alone is one at rest. Raises what `load_motion` does.
    """
    found = _motion_of(motion, scene)
    alone = scene.method == REST and len(found.times) == 1
    return replace(found, times=np.array([scene.delta])) if alone else found


def _motion_of(motion: Recorded, scene: Scene) -> Motion:
    if isinstance(motion, (str, os.PathLike)):
        from clothfit.motion.files import load_motion  # its formats are loaded for those who use them

        return load_motion(motion, scene)
    return checked_motion(motion, scene) if isinstance(motion, Motion) else as_motion(scene, motion)


def flagged_as(scene: Scene, main: Scene) -> Scene:
    """The scene with the flags of `main`, on whose values the factors are, so that one fit vector belongs to both.
    Raises InvalidInput.
    """
    if scene is main:
        return scene
    check_same_sizes(scene, main)
    pairs = zip(scene.cloths, main.cloths, strict=True)
    cloths = tuple(replace(own, settings=other.settings, fits=other.fits) for own, other in pairs)
    return replace(scene, cloths=cloths, fits=main.fits, main=main)


def check_same_sizes(scene: Scene, main: Scene) -> None:
    """Raise InvalidInput unless the objects of both scenes have the same numbers of vertices and springs, and the
    scenes as many of what is fitted of them. Scenes at rest may have objects of other meshes.
    """
    own, wanted = ([(len(c.mass), len(c.stiffness)) for c in one.cloths] for one in (scene, main))
    meshes = {scene.method, main.method} == {REST} and len(own) == len(wanted)  # shapes at rest of one fabric
    if own != wanted and not meshes:
        raise InvalidInput(f"{scene.name}: its objects have {in_words(own)}, those of {main.name} {in_words(wanted)}")
    for block in (each for each in main.blocks if each.cloth is None or each.kind.of == "key"):
        values = np.shape(getattr(scene if block.cloth is None else scene.cloths[block.cloth], block.name))
        if values != block.shape:
            counts = f"{values[0]} in this scene, {block.shape[0]} in {main.name}"
            raise InvalidInput(f"{scene.name}: {block.kind.title}: {counts}; a fit of both needs as many")


def in_words(sizes: Sequence[tuple[int, int]]) -> str:
    """Numbers of vertices and springs of objects, of the first eight."""
    return "; ".join(
        f"{counted(vertices, 'vertex', 'vertices')} and {counted(springs, 'spring', 'springs')}"
        for vertices, springs in sizes[:8]
    )
