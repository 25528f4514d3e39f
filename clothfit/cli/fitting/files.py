"""The files that the options of `clothfit estimate` name: those it reads besides a scene, and those it writes.

In the names, {stem} stands for the scene's name without folder and suffix, {folder} for its folder, so that one option
can name the files of many scenes.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

from clothfit.base.errors import InvalidInput
from clothfit.cli.common.output import STREAM, Output, output_for
from clothfit.cli.common.scenes import one_stream
from clothfit.cli.fitting.target_options import is_number, motion_and_scene
from clothfit.formats.convention import Reading


@dataclass(frozen=True)
class Files:
    """The options that name files."""

    targets: tuple[str, ...]  # of a motion, or of a motion and a scene
    start: str | None  # a number, or of a scene
    path: str | None  # of the result
    in_place: bool
    checkpoint: str | None
    resume: bool
    reading: Reading = Reading()  # noqa: RUF009  what the targets' files do not say; it cannot be changed

    def of(self, scene_path: str) -> Files:
        """The same for one scene: without stems."""
        return replace(
            self,
            targets=tuple(filled(path, scene_path) for path in self.targets),
            start=self.start and filled(self.start, scene_path),
            path=self.path and filled(self.path, scene_path),
            checkpoint=self.checkpoint and filled(self.checkpoint, scene_path),
            reading=replace(self.reading, markers=self.markers and filled(self.markers, scene_path)),
        )

    @property
    def pairs(self) -> list[tuple[str, str | None]]:
        """Each target's motion and scene."""
        return [motion_and_scene(path) for path in self.targets]

    @property
    def markers(self) -> str | None:
        """The file that says which vertices markers are."""
        return None if self.reading.markers is None else os.fspath(self.reading.markers)

    @property
    def inputs(self) -> tuple[str | None, ...]:
        """What is read besides the scene."""
        start = None if self.start is None or is_number(self.start) else self.start
        return (*(path for pair in self.pairs for path in pair), start, self.markers)

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
        return output_for(self.path, scene_path, f".fitted{suffix}", self.inputs, text=True)


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
