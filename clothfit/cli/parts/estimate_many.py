"""`clothfit estimate` of several scenes, from several starts, or on a cluster: fit all, write each, print a table."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clothfit.base import interrupts
from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.base.limits import is_number
from clothfit.base.messages import metres
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import warn_of_steps
from clothfit.cli.common.output import STREAM, Output, attributes, make_folder, print_json, uninterrupted, write_scene
from clothfit.cli.parts import checkpoints, estimate_results
from clothfit.cli.parts.estimate_files import Effort, Files, default_name
from clothfit.fit.options import Request
from clothfit.many.estimate_many import Result, chosen_pool, fit_all, limited
from clothfit.many.job import INTERRUPTED, NOT_STARTED, File, Job, JobTarget, Outcome, loaded, read_file
from clothfit.many.processes import Processes, is_cold
from clothfit.optimise.checkpoint import Checkpoint
from clothfit.scene.scene import dumps

if TYPE_CHECKING:
    from clothfit.fit.result import Fit
    from clothfit.motion.motion import Motion

SEVERITY = (1, 3, 4, 5, 0)
"""Exit codes of scenes, worst first: the command ends with the worst one, or as interrupted where one was."""

FIT_COLUMNS = ("scene", "start", "status", "RMSE", "frames", "evaluations", "seconds", "output")
START_COLUMN = FIT_COLUMNS.index("start")


class Failed(ClothfitError):
    """The only scene that was asked for could not be fitted."""

    def __init__(self, message: str, exit_code: int) -> None:
        self.exit_code = exit_code
        super().__init__(message)


def fit(paths: tuple[str, ...], files: Files, options: Request, effort: Effort, console: Console) -> int:
    """Fit all scenes; returns the exit code."""
    began = time.perf_counter()
    options.check()
    if effort.cluster is not None and effort.jobs is not None:
        raise click.UsageError("--jobs is for this machine; a --cluster has its own workers")
    items = planned(paths, files, effort.starts, effort.cluster is None, console)
    pool = chosen_pool(len(items) * effort.starts, effort.jobs, effort.cluster)
    if isinstance(pool, Processes) and is_cold():
        console.say("compiling for this machine: the first fits do so once, for 20 to 40 seconds …")
    each = limited(options, pool)
    makers: list[Callable[[int], Job]] = [partial(item.job, seed=effort.seed, options=each) for item in items]
    writer = Writer(items, console)
    with interrupts.deferred():
        interrupts.hold()  # results come from now on
        fit_all(makers, effort.starts, pool, writer.done, writer.died)
        with uninterrupted():
            if len(items) == 1:
                return finish_one(items[0], console)
            console.table(rows(items))
            print_json({"scenes": list(map(summary, items)), "seconds": time.perf_counter() - began})
    codes = [item.exit_code for item in items]
    return INTERRUPTED if INTERRUPTED in codes else next(code for code in SEVERITY if code in codes)


class Writer:
    """Writes each result as it comes, and says so."""

    def __init__(self, items: list[Item], console: Console) -> None:
        self.items, self.console = items, console
        self.ended = 0

    def done(self, index: int, result: Result) -> None:
        """A scene is fitted, or cannot be."""
        item = self.items[index]
        item.result = result
        for kept, outcome in zip(item.kept, result.outcomes, strict=True):
            if kept is not None:
                kept.written = outcome.checkpointed
        if len(self.items) == 1 or result.outcome == NOT_STARTED:
            return
        self.ended += 1
        place = f"{self.ended} of {len(self.items)}: {item.path}"
        if result.fit is not None and result.outcome.usable:
            self.write(item, result.fit, place)
        if error := item.fault or result.error:
            if result.outcome.status == "written":  # before, as the error says
                self.console.say(str(error), of=place)
            elif self.console.quiet:  # an error is printed all the same
                with suppress(OSError):
                    print(f"error: {item.path}: {item.own(error)}", file=sys.stderr, flush=True)
            else:
                self.console.say(f"error: {item.own(error)}", of=place)
        item.close(self.console)

    def write(self, item: Item, found: Fit, place: str) -> None:
        """Write a result."""
        assert item.out is not None
        self.console.warn(*found.scene.warnings, *found.warnings, of=item.path)
        warn_of_steps(found.scene, found.frames, self.console)
        if item.files.in_place:
            for kept in item.kept:
                if kept is not None and kept.written:
                    kept.note_result(dumps(found.scene))
        try:
            write_scene(found.scene, item.out)
        except ClothfitError as error:
            item.fault = error
            return
        reached = f"RMSE {metres(found.rmse)}" if found.cost < math.inf else "nothing fitted"
        self.console.say(f"{found.status}, {reached} in {found.seconds:.1f} s → {item.out.name}", of=place)

    def died(self, index: int) -> None:
        """A process has died."""
        self.console.warn(f"{self.items[index].path}: the process that fitted it died; it is tried again at the end")


def finish_one(item: Item, console: Console) -> int:
    """Write and tell the result of the only scene, as if it had been fitted in this process."""
    if len(item.kept) > 1:
        console.table(rows([item]))
    found, out = item.result.fit, item.out
    if found is None or out is None:
        raise Failed(item.result.error or "there is no result", item.exit_code)
    console.warn(*found.scene.warnings, of=found.scene.name)
    warn_of_steps(found.scene, found.frames, console)
    more = {key: each for key, each in summary(item).items() if key in ("start", "starts", "reading")}
    estimate_results.finish(found.scene, found, out, console, more)
    item.close(console)
    return item.exit_code


def rows(items: Sequence[Item]) -> list[list[str]]:
    """A row for each scene and start, in the order of the arguments, below a header."""
    found = [list(FIT_COLUMNS)]
    for item in items:
        for number, outcome in enumerate(item.result.outcomes):
            error = item.fault or outcome.error
            best = number == item.result.best and outcome.usable
            output = item.out.name if item.out and best else ""
            fault = error and outcome.status not in ("not started", "written")
            place = f"error: {error}" if fault else str(error) if outcome.status == "written" else output
            found.append([item.path if number == 0 else "", str(number + 1), *figures(outcome), place])
    if all(len(item.kept) == 1 for item in items):
        return [row[:START_COLUMN] + row[START_COLUMN + 1 :] for row in found]
    return found


def figures(outcome: Outcome) -> tuple[str, ...]:
    """The middle of a row: status, RMSE, frames, evaluations, seconds."""
    fit = outcome.fit
    if fit is None:
        return (outcome.status, "", "", "", "")
    error = metres(fit.rmse) if fit.cost < math.inf else ""
    return (fit.status, error, str(fit.frames), str(fit.evaluations), f"{fit.seconds:.1f}")


def summary(item: Item) -> dict[str, Any]:
    """What --json prints of a scene."""
    result, outcome = item.result, item.result.outcome
    before = outcome.status == "written"
    written = (outcome.usable or before) and item.fault is None
    own: dict[str, Any] = {"status": outcome.status}
    if result.fit is not None and item.out is not None:
        own = estimate_results.summary(result.fit.scene, result.fit, item.out)
    own |= {
        "scene": item.path,
        "output": item.out.path if written and item.out else None,
        "exit_code": item.exit_code,
        "error": str(item.fault or ("" if before else outcome.error) or "") or None,
    }
    own |= motions.readings_summary(item.readings)
    if len(result.outcomes) > 1:
        own |= {"start": result.best + 1, "starts": list(map(start_summary, result.outcomes))}
    return own


def start_summary(outcome: Outcome) -> dict[str, Any]:
    """What --json prints of one of several starts."""
    names = ("cost", "rmse", "evaluations", "seconds")
    numbers = dict.fromkeys(names) if outcome.fit is None else attributes(outcome.fit, *names)
    return attributes(outcome, "status", "exit_code", "error") | numbers


# ---- What is meant to be done with each scene, checked before anything is begun.

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
    result: Result = field(init=False)  # as soon as it is there
    fault: ClothfitError | None = None  # of writing it

    @property
    def exit_code(self) -> int:
        """That of the scene."""
        return self.fault.exit_code if self.fault else self.result.exit_code

    def own(self, error: object) -> str:
        """An error of the scene, without its name."""
        return str(error).removeprefix(f"{self.path}: ")

    def close(self, console: Console) -> None:
        """Remove checkpoints that are no longer useful."""
        for kept, outcome in zip(self.kept, self.result.outcomes, strict=True):
            checkpoints.of_fit(kept, self.files, outcome.status, console)

    def job(self, number: int, seed: int, options: Request) -> Job:
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
            self.motions[path, own] = motions.read_motion(path, scene, self.files.reading, self.console, self.readings)
        return self.motions[path, own]

    def file(self, path: str) -> File:
        """The content of a file, or of standard input."""
        if path != STREAM:
            return read_file(path)
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
        check_for_many(paths, files)
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
            kept = [first and checkpoint_of(first, number) for number in range(starts)]
        return Item(path, files, out, kept, console=console)
    except ClothfitError as error:
        if only:
            raise
        return Item(path, files, None, [None] * starts, error)


def checkpoint_of(first: Checkpoint, number: int) -> Checkpoint:
    """The checkpoint of a start, beside that of the first."""
    if number == 0:
        return first
    root, suffix = os.path.splitext(os.fspath(first.path))
    return Checkpoint(f"{root}.{number + 1}{suffix}", first.after)


def check_for_many(paths: tuple[str, ...], files: Files) -> None:
    """Raise UsageError where options fit one scene only."""
    if STREAM in (*paths, files.path, files.start, *files.target_paths):
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
