"""What the commands have in common: options, reading scenes and motions, default names, writing results."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from clothfit.base.errors import InvalidInput, InvalidScene
from clothfit.base.interrupts import REQUESTS, SAME_REQUEST, handle
from clothfit.base.limits import checked_tolerance
from clothfit.base.version import __version__
from clothfit.cli.common.console import Console
from clothfit.cli.common.help import ExamplesFirst, Sections
from clothfit.cli.common.usage import complete_files
from clothfit.scene.text import name_of

if TYPE_CHECKING:
    from clothfit.base.arrays import Array
    from clothfit.base.writing import Data
    from clothfit.motion.motion import Motion
    from clothfit.scene.scene import Scene

SCHEMA_VERSION = 1
STREAM = "-"
F = TypeVar("F", bound=Callable[..., object])


def loudness(function: F) -> F:
    """Add the options that say how much to say; they are understood before and after a command's name."""
    verbose = click.option("-v", "--verbose", is_flag=True, help="Say more: what is read, and when.")
    return click.option("-q", "--quiet", is_flag=True, help="Say nothing but errors.")(verbose(function))


def command(name: str, sections: Sections | None = None) -> Callable[[Callable[..., int]], click.Command]:
    """A command with the options that all of them have; its function is given a `console` for its messages. `sections`
    are those of its other options in the help.
    """

    def decorate(function: Callable[..., int]) -> click.Command:
        @wraps(function)
        def speaking(quiet: bool, verbose: bool, **arguments: Any) -> int:
            before: dict[str, bool] = click.get_current_context().obj or {}
            console = Console(quiet or before.get("quiet", False), verbose or before.get("verbose", False))
            return function(**arguments, console=console)

        made = loudness(click.version_option(__version__, prog_name="clothfit")(speaking))
        text = "Print the summary as one JSON object on standard output."
        made = click.option("--json", "as_json", is_flag=True, help=text)(made)
        settings = {"help_option_names": ["-h", "--help"]}
        return complete_files(click.command(name, ExamplesFirst, context_settings=settings, sections=sections)(made))

    return decorate


@dataclass(frozen=True)
class Output:
    """Where a result goes: a path, or standard output."""

    path: str
    in_place: bool = False  # it is the scene that was read

    @property
    def is_stream(self) -> bool:
        """Whether it is standard output."""
        return self.path == STREAM

    @property
    def name(self) -> str:
        """What to call it in a message."""
        return "standard output" if self.is_stream else self.path

    def write(self, data: Data) -> None:
        """Write the whole result; an interrupt that comes now waits."""
        with uninterrupted():
            self.put(data)

    def put(self, data: Data) -> None:
        """The same, where interrupts are held back or noted already."""
        from clothfit.base.writing import put, write_atomically

        if self.is_stream:
            put(data, sys.stdout.buffer)
            sys.stdout.buffer.flush()
        else:
            write_atomically(self.path, data)


def output(
    path: str | None,
    scene_path: str,
    suffix: str,
    inputs: tuple[str | None, ...],
    overwrite: bool = False,
    text: bool = False,
) -> Output:
    """Decide where the result goes and check that it can go there.

    The default name is the scene's with `suffix` in place of its own; `inputs` are the files, besides the scene, that
    must not be written over; `text` tells that the result may be shown on a terminal. Raises InvalidInput when the
    place cannot be written, or is one of the inputs and `overwrite` is not given.
    """
    from clothfit.base.writing import check_writable

    if path is None:
        path = STREAM if scene_path == STREAM else str(Path(scene_path).with_suffix(suffix))
    if path == STREAM:
        if not text and sys.stdout.isatty():
            raise InvalidInput("a motion is not text, so it is not written to a terminal; name a file with -o")
        return Output(path)
    if not overwrite and is_among(path, (scene_path, *inputs)):
        raise InvalidInput(f"cannot write {path}: it is an input, which is never written over; name another file")
    check_writable(path)
    return Output(path, overwrite)


def write_scene(scene: Scene, out: Output) -> None:
    """Write a scene whole. Where it should replace the one it was read from, and somebody has changed that meanwhile,
    it goes beside it and InvalidInput says so. An interrupt is for the caller to hold back.
    """
    from clothfit.scene.scene import dumps

    if not out.in_place or unchanged(scene, out.path):
        out.put(dumps(scene))
        return
    beside = Path(out.path)
    other = Output(str(beside.with_suffix(f".fitted{beside.suffix}")))
    other.put(dumps(scene))
    raise InvalidInput(f"{out.path}: changed while the fit ran, so it is left as it is; the result is in {other.path}")


def unchanged(scene: Scene, path: str) -> bool:
    """Whether a file still holds the text that the scene was read from; so one that is gone does not."""
    source = scene.source
    try:
        return Path(path).read_bytes() == source.encode(source.text)
    except OSError:
        return False


def is_among(path: str, others: Iterable[str | None]) -> bool:
    """Whether a path leads to the same file as one of others; None and standard streams are none."""
    return any(other not in (None, STREAM) and same_file(path, str(other)) for other in others)


def same_file(a: str, b: str) -> bool:
    """Whether two paths lead to one file, or would."""
    try:
        return os.path.samefile(a, b)
    except OSError:
        return os.path.realpath(a) == os.path.realpath(b)
    except ValueError:  # no possible name
        return False


def read_scene(path: str, console: Console) -> Scene:
    """Load a scene from a path or standard input, and pass its warnings on."""
    check_there(path)
    import clothfit

    scene = clothfit.load(sys.stdin.buffer if path == STREAM else path)
    for warning in scene.warnings:
        console.warn(f"{scene.name}: {warning}")
    console.detail(f"{scene.name}: {len(scene.cloths)} objects, {sum(scene.vertex_counts)} vertices")
    return scene


def motion_data(motion: Motion, extra: Mapping[str, Array] | None = None) -> Data:
    """What writes a motion to its file, with other arrays beside it."""
    from clothfit.motion.motion import archive

    return archive(motion, extra)


def check_numbers(steps: int | None = None, tolerance: float | None = None) -> None:
    """Check options before the libraries load, which takes longer. Raises InvalidInput on what cannot be."""
    if steps is not None and steps < 1:
        raise InvalidInput(f"--steps must be at least 1; {steps} was given")
    if tolerance is not None:
        checked_tolerance(tolerance, tolerance)


def check_there(*paths: str) -> None:
    """Check that there are scenes at the paths, for the same reason. Raises InvalidScene."""
    for path in paths:
        try:
            with suppress(ValueError):  # no possible name; whoever reads it finds the words
                if path != STREAM:
                    os.stat(path)
        except OSError as error:
            raise InvalidScene(f"cannot be read: {error.strerror or error}", name_of(path)) from None


def frames_of(steps: int | None, scene: Scene) -> int:
    """Number of frames for --steps. Raises InvalidInput when it is not positive."""
    check_numbers(steps)
    return scene.frames if steps is None else steps + 1


def one_stream(*paths: str | None) -> None:
    """Raise InvalidInput when standard input should be read twice."""
    if sum(path == STREAM for path in paths) > 1:
        raise InvalidInput("standard input (-) can be only one of the inputs")


def told(command: str, summary: dict[str, Any]) -> dict[str, Any]:
    """The object that --json prints."""
    return {"schema_version": SCHEMA_VERSION, "command": command, **summary}


def print_json(command: str, summary: dict[str, Any], out: Output | None = None) -> None:
    """Print a summary as JSON on standard output, or on standard error when the result itself goes there."""
    text = json.dumps(plain(told(command, summary)), allow_nan=False)
    print(text, file=sys.stderr if out is not None and out.is_stream else sys.stdout, flush=True)


def plain(value: Any) -> Any:
    """The value with what JSON cannot hold, numbers that are not finite, replaced by None."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let interrupts wait: for the short time in which a result is written and told.

    Where that takes long, as nobody reads from a pipe, one that comes a moment after another ends it.
    """
    first: list[float] = []

    def wait(number: int, frame: object) -> None:
        first.append(time.monotonic())
        if first[-1] - first[0] > SAME_REQUEST:
            raise KeyboardInterrupt

    before = [(kind, signal.getsignal(kind)) for kind in REQUESTS]
    handle(wait)
    try:
        yield
    finally:
        for kind, handler in before:
            signal.signal(kind, handler)
