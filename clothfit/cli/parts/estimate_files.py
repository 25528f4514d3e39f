"""The options of `clothfit estimate` for targets, objectives and the start, and the files it reads and writes.

In the names, {stem} stands for the scene's name without folder and suffix, {folder} for its folder, so that one option
can name the files of many scenes.
"""

from __future__ import annotations

import glob
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clothfit.base.errors import InvalidInput
from clothfit.base.limits import is_number
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import check_least
from clothfit.cli.common.output import STREAM, Output, check_scene_name, output_for
from clothfit.cli.common.scenes import one_stream, read_scene
from clothfit.formats.axes import Reading

if TYPE_CHECKING:
    from clothfit.motion.motion import Motion
    from clothfit.scene.scene import Scene


@dataclass(frozen=True)
class Files:
    """The options that name files."""

    target_paths: tuple[str, ...]  # of a motion, or of a motion and a scene
    start: str | None  # a number, or of a scene
    path: str | None  # of the result
    in_place: bool
    checkpoint: str | None
    resume: bool
    reading: Reading = Reading()  # noqa: RUF009  what the targets' files do not say; it cannot be changed
    forces_path: str | None = None  # on the cloths
    cache: str | None = None  # of the fitted motion

    def of(self, scene_path: str) -> Files:
        """The same for one scene: without stems."""
        return replace(
            self,
            target_paths=tuple(filled(path, scene_path) for path in self.target_paths),
            start=self.start and filled(self.start, scene_path),
            path=self.path and filled(self.path, scene_path),
            cache=self.cache and filled(self.cache, scene_path),
            checkpoint=self.checkpoint and filled(self.checkpoint, scene_path),
            reading=replace(self.reading, markers=self.markers and filled(self.markers, scene_path)),
        )

    @property
    def pairs(self) -> list[tuple[str, str | None]]:
        """Each target's motion and scene."""
        return [motion_and_scene(path) for path in self.target_paths]

    @property
    def markers(self) -> str | None:
        """The file that says which vertices markers are."""
        return None if self.reading.markers is None else os.fspath(self.reading.markers)

    @property
    def inputs(self) -> tuple[str | None, ...]:
        """What is read besides the scene."""
        start = None if self.start is None or is_number(self.start) else self.start
        return (*(path for pair in self.pairs for path in pair), start, self.markers, self.forces_path)

    def check(self, scene_path: str) -> None:
        """Raise InvalidInput where the options do not go together."""
        if self.in_place and (self.path is not None or scene_path == STREAM):
            raise InvalidInput("--in-place writes into the scene's file; it does not go with -o or standard input")
        one_stream(scene_path, *self.inputs)

    def output(self, scene_path: str) -> Output:
        """Where the fitted scene goes: by default beside the input, with the input's suffix. Raises InvalidInput."""
        if self.in_place:
            return output_for(scene_path, scene_path, "", (), overwrite=True)
        suffix = os.path.splitext(scene_path)[1]
        out = output_for(self.path, scene_path, f".fitted{suffix}", self.inputs, text=True)
        check_scene_name(self.path)
        return out


MOST_STARTS = 10_000
"""Of one scene; each is kept until the end."""


@dataclass(frozen=True)
class Effort:
    """How many fits, how many at a time, and where."""

    starts: int
    seed: int
    jobs: int | None
    cluster: str | None

    def check(self) -> None:
        """Raise InvalidInput on values that cannot be."""
        check_least(1, starts=self.starts, jobs=self.jobs)
        check_least(0, seed=self.seed)
        if self.starts > MOST_STARTS:
            raise InvalidInput(f"--starts must be at most {MOST_STARTS}; {self.starts} was given")


def filled(name: str, scene_path: str) -> str:
    """A name with what {stem} and {folder} stand for; as it is where there is such a file."""
    if os.path.exists(name):
        return name
    path = Path(scene_path)
    return name.replace("{stem}", path.stem).replace("{folder}", str(path.parent))


def default_name(scene_path: str) -> str:
    """The name, without a folder, of a fitted scene."""
    path = Path(scene_path)
    return path.with_suffix(f".fitted{path.suffix}").name


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


def bounds_of(texts: tuple[str, ...]) -> dict[str, tuple[float | None, float | None]] | None:
    """The bounds of each --bounds KIND=LOW:HIGH, either of which may be left out; None without any."""
    found: dict[str, tuple[float | None, float | None]] = {}
    for text in texts:
        name, equals, ends = text.partition("=")
        low, colon, high = ends.partition(":")
        numbers = [end.strip() for end in (low, high)]
        if not equals or not colon or not any(numbers) or not all(is_number(end) for end in numbers if end):
            raise InvalidInput(f"--bounds: {text!r} is not KIND=LOW:HIGH, as in stiffness=1:1e6 or mass=1e-6:")
        if name in found:
            raise InvalidInput(f"--bounds: {name} is given twice")
        found[name] = float(low) if numbers[0] else None, float(high) if numbers[1] else None
    return found or None


def read_start(start: str | None, console: Console) -> float | Scene | None:
    """What --start says: a value, or a scene's file."""
    if start is None:
        return None
    return float(start) if is_number(start) else read_scene(start, console)
