"""The options of `clothfit estimate` for targets, objectives and the start."""

from __future__ import annotations

import glob
import os
from typing import TYPE_CHECKING, Any

from clothfit.base.errors import InvalidInput
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.scenes import read_scene

if TYPE_CHECKING:
    from clothfit.formats.convention import Reading
    from clothfit.motion.motion import Motion
    from clothfit.scene.scene import Scene


def motion_and_scene(path: str) -> tuple[str, str | None]:
    """The paths in a --target: of a motion, or of a motion and a scene, split at the last @."""
    if "@" not in path or os.path.exists(path) or (glob.has_magic(path) and glob.glob(path)):
        return path, None
    motion, _, scene = path.rpartition("@")
    return motion, scene


def read_target(
    paths: tuple[str, str | None], scene: Scene, reading: Reading, console: Console, readings: list[dict[str, Any]]
) -> Motion | tuple[Motion, Scene]:
    """What a --target names; of other programs' files, what was assumed is added to `readings`."""
    motion, own = paths
    if own is None:
        return motions.read(motion, scene, reading, console, readings)
    other = read_scene(own, console)
    return motions.read(motion, other, reading, console, readings), other


def weights(objectives: tuple[str, ...]) -> dict[str, float]:
    """The weight of each --objective, 1 where it has none."""
    found = {}
    for text in objectives or ("position",):
        name, equals, weight = text.partition("=")
        if name in found:
            raise InvalidInput(f"--objective: {name} is given twice")
        if equals and not is_number(weight):
            raise InvalidInput(f"--objective: {text}: the weight is not a number, as in {name}=0.01")
        found[name] = float(weight) if equals else 1.0
    return found


def read_start(start: str | None, console: Console) -> float | Scene | None:
    """What --start says: a value, or a scene's file."""
    if start is None:
        return None
    return float(start) if is_number(start) else read_scene(start, console)


def is_number(text: str) -> bool:
    """Whether a --start is a value, not a file."""
    try:
        float(text)
    except ValueError:
        return False
    return True
