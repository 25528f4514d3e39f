"""What `clothfit estimate` means to do with each of many scenes, checked before anything is begun."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import is_number
from clothfit.cli.common.output import STREAM, Output, make_folder
from clothfit.cli.parts import checkpoints
from clothfit.cli.parts.estimate_files import Files, default_name
from clothfit.fit.options import FitOptions
from clothfit.many.job import File, Job, JobTarget, loaded, read
from clothfit.optimise.checkpoint import Checkpoint

if TYPE_CHECKING:
    from clothfit.motion.motion import Motion


class WrittenBefore(ClothfitError):
    """The scene is already the result of the fit that is resumed."""

    exit_code = 0


@dataclass
class Item:
    """One scene of many."""

    path: str  # as it was given
    files: Files  # its own
    out: Output | None  # None where there is no place for it, and `refusal` says why
    kept: list[Checkpoint | None]  # for each start
    refusal: ClothfitError | None = None
    stream: bytes | None = None  # standard input, where it is one of the files
    readings: list[dict[str, Any]] = field(default_factory=list)  # what was assumed of other programs' motions
    motions: dict[tuple[str, str | None], Motion] = field(default_factory=dict)  # other programs', for the next start
    console: Console = field(default_factory=Console)

    def job(self, number: int, seed: int, options: FitOptions) -> Job:
        """The fit from a start. Raises InvalidInput when a file cannot be read."""
        if self.refusal:
            raise self.refusal
        kept, start = self.kept[number], self.files.start
        first = None if start is None else float(start) if is_number(start) else self.file(start)
        resume = self.files.resume and kept is not None and os.path.isfile(kept.path)
        if resume and kept is not None and self.files.in_place and kept.has_result(self.file(self.path).data):
            raise WrittenBefore("its result was written before, and stays as it is")
        targets = self.targets()
        if number + 1 == len(self.kept):  # the last start: the motions of many scenes need not stay in memory
            self.motions.clear()
        return Job(self.file(self.path), targets, first, number, seed, options, kept, resume)

    def targets(self) -> tuple[JobTarget, ...]:
        """The targets, each with its scene."""
        pairs = self.files.pairs
        return tuple((self.motion(motion, own), None if own is None else self.file(own)) for motion, own in pairs)

    def motion(self, path: str, own: str | None) -> File | Motion:
        """The content of a motion's file; where only this process can read it, the motion."""
        from clothfit.formats.registry import foreign

        if foreign(path) is None and self.files.reading.plain:
            return self.file(path)
        if (path, own) not in self.motions:
            scene = loaded(self.file(self.path if own is None else own))
            self.motions[path, own] = motions.read(path, scene, self.files.reading, self.console, self.readings)
        return self.motions[path, own]

    def file(self, path: str) -> File:
        """The content of a file, or of standard input."""
        if path != STREAM:
            return read(path)
        if self.stream is None:
            from clothfit.base.npz import content

            self.stream = content(sys.stdin.buffer)
        return File(self.stream, "standard input")


def planned(paths: tuple[str, ...], files: Files, starts: int, local: bool, console: Console) -> list[Item]:
    """What to do with each scene. Raises UsageError or InvalidInput where the options cannot be for all of them.

    `local`: whether the fits are done on this machine, and can keep checkpoints.
    """
    if not local and (files.checkpoint is not None or files.resume):
        raise click.UsageError("--checkpoint and --resume are for fits on this machine, not on a --cluster")
    if len(paths) > 1:
        check_many(paths, files)
    own = [within(files.of(path), path) if len(paths) > 1 else files.of(path) for path in paths]
    if len(paths) > 1:
        check_apart(paths, own)
    return [item(path, one, starts, local, console, len(paths) == 1) for path, one in zip(paths, own, strict=True)]


def item(path: str, files: Files, starts: int, local: bool, console: Console, only: bool) -> Item:
    """What to do with a scene; that it cannot be done is raised for the `only` one, else told in its turn."""
    try:
        files.check(path)
        out = files.output(path)
        kept: list[Checkpoint | None] = [None] * starts
        if local:
            inputs = path, *files.inputs
            first = checkpoints.chosen(files.checkpoint, files.resume, out, inputs, console, Checkpoint)
            kept = [first and beside(first, number) for number in range(starts)]
        return Item(path, files, out, kept, console=console)
    except ClothfitError as error:
        if only:
            raise
        return Item(path, files, None, [None] * starts, error)


def beside(first: Checkpoint, number: int) -> Checkpoint:
    """The checkpoint of a start, beside that of the first."""
    if number == 0:
        return first
    root, suffix = os.path.splitext(os.fspath(first.path))
    return Checkpoint(f"{root}.{number + 1}{suffix}", first.after)


def check_many(paths: tuple[str, ...], files: Files) -> None:
    """Raise UsageError where options fit one scene only."""
    if STREAM in (*paths, files.path, files.start, *files.targets):
        raise click.UsageError(f"standard input and output (-) are for one scene, not for {len(paths)}")
    if files.checkpoint is not None and "{stem}" not in files.checkpoint:
        raise click.UsageError(f"--checkpoint: {len(paths)} scenes need one each: put {{stem}} into the name")
    if files.path is not None and "{stem}" not in files.path and not is_folder(files.path):
        raise click.UsageError(f"-o {files.path}: {len(paths)} scenes need a folder, or a name with {{stem}}")


def is_folder(path: str) -> bool:
    """Whether a name means a folder: there is one, or it looks like one that is to be made."""
    if os.path.exists(path):
        return os.path.isdir(path)
    return path.endswith(("/", os.sep)) or not Path(path).suffix


def within(files: Files, scene_path: str) -> Files:
    """The files of one of many scenes: the result goes into the folder that is named. Raises InvalidInput."""
    if files.path is None or not is_folder(files.path):
        return files
    make_folder(files.path)
    return replace(files, path=os.path.join(files.path, default_name(scene_path)))


def check_apart(paths: tuple[str, ...], files: list[Files]) -> None:
    """Raise InvalidInput where two results would go to one file, or one over an input of another fit."""
    written: dict[str, str] = {}
    read_from = {os.path.realpath(name) for path, one in zip(paths, files, strict=True) for name in (path, *one.inputs)
                 if name is not None}  # fmt: skip
    for path, one in zip(paths, files, strict=True):
        beside = os.path.join(os.path.dirname(path), default_name(path))
        name = path if one.in_place else one.path or beside
        place = os.path.realpath(name)
        if place in written:
            raise InvalidInput(f"{written[place]} and {path} would both be written to {name}; use {{folder}} in -o")
        if place in read_from and not one.in_place:
            raise InvalidInput(f"cannot write {name}: it is an input, which is never written over; leave it out, or "
                               "name a folder with -o")  # fmt: skip
        written[place] = path
