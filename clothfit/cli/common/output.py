"""Where the result of a command goes: a file that may be written, or standard output; and what --json prints of it."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clothfit.base.errors import InvalidInput
from clothfit.base.interrupts import REQUESTS, SAME_REQUEST, handle
from clothfit.formats.registry import FORMATS, NATIVE, suffix_of

if TYPE_CHECKING:
    from clothfit.base.writing import Data
    from clothfit.scene.scene import Scene

STREAM = "-"
SCENE, PAGE = ".json", ".html"
TEXTS = {SCENE: "a scene", PAGE: "a page"}
OF_OTHERS = (*NATIVE, *(suffix for each in FORMATS for suffix in each.suffixes), ".png", ".svg", ".pdf", ".gif")
"""Suffixes of motions, meshes and pictures."""

SCHEMA_VERSION = 1  # of what --json prints


class Printed:
    """What the present command prints, beside its messages."""

    command: str | None = None  # its name, as soon as that is known
    elsewhere = False  # whether standard output is for a motion, a scene or a page, and JSON goes to standard error
    as_json = False  # whether its summary is
    summary = False  # whether that was printed
    options: Collection[str] = ()  # that it has

    @classmethod
    def begin(
        cls, command: str | None = None, elsewhere: bool = False, options: Collection[str] = (), as_json: bool = False
    ) -> None:
        """Nothing is printed yet."""
        cls.command, cls.elsewhere, cls.options, cls.as_json, cls.summary = command, elsewhere, options, as_json, False


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold interrupts back for the short time in which a result is written and printed.

    If that takes long, because nobody reads from a pipe, a second interrupt a moment after the first ends it.
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


@dataclass
class Output:
    """Where a result goes: a path, or standard output."""

    path: str
    in_place: bool = False  # it is the scene that was read
    written: bytes | None = None  # the scene that was written there

    @property
    def is_stream(self) -> bool:
        """Whether it is standard output."""
        return self.path == STREAM

    @property
    def name(self) -> str:
        """What to call it in a message."""
        return "standard output" if self.is_stream else self.path

    @property
    def folder(self) -> str:
        """The folder of the file, else the current one."""
        return os.getcwd() if self.is_stream else os.path.dirname(os.path.abspath(self.path))

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


def output_for(
    path: str | None, scene_path: str, suffix: str, inputs: tuple[str | None, ...], overwrite: bool = False,
    text: str = "",
) -> Output:
    """Decide where the result goes and check that it can go there.

    The default name is the scene's with `suffix` in place of its own; `inputs` are the files, besides the scene, that
    must not be written over; `text` is the usual suffix of a result that a terminal may show, one of TEXTS. Raises
    InvalidInput when the place cannot be written, is named as something else, or is one of the inputs and `overwrite`
    is not given.
    """
    from clothfit.base.writing import check_writable

    named = path is not None
    if path is None:
        path = STREAM if scene_path == STREAM else str(Path(scene_path).with_suffix(suffix))
    if path == STREAM:
        if not text and sys.stdout.isatty():
            raise InvalidInput("a motion is not text, so it is not written to a terminal; name a file with -o")
        return Output(path)
    if not overwrite and is_among(path, (scene_path, *inputs)):
        raise InvalidInput(f"cannot write {path}: it is an input, which is never written over; name another file")
    if named and text and not overwrite and suffix_of(path) in {*TEXTS, *OF_OTHERS} - {text}:
        raise InvalidInput(f"cannot write {path}: {TEXTS[text]} is written; name it {Path(path).with_suffix(text)}")
    check_writable(path)
    return Output(path, overwrite)


def companion_file(
    option: str, path: str | None, used: Iterable[str | None], suffix: str = "", text: str = ""
) -> Output | None:
    """Where the file of an option goes that is written beside a result, where that is asked for: it has the suffix, and
    is none of the `used` files. Raises InvalidInput.
    """
    if path is None:
        return None
    if path == STREAM or not path.lower().endswith(suffix):
        raise InvalidInput(f"{option} must be a file {suffix or 'of its own'}, not {path}")
    check_unused(path, used)
    return output_for(path, "", "", (), text=text)


def check_unused(path: str, used: Iterable[str | None]) -> None:
    """Raise InvalidInput where a file is among those `used` otherwise."""
    if is_among(path, used):
        raise InvalidInput(f"cannot write {path}: it is an input or another output")


def make_folder(path: str) -> None:
    """Make a folder where there is none. Raises InvalidInput."""
    try:
        os.makedirs(path, exist_ok=True)
    except FileExistsError:
        raise InvalidInput(f"cannot make the folder {path}: it is a file; name a folder") from None
    except OSError as error:
        raise InvalidInput(f"cannot make the folder {path}: {error.strerror or error}") from None


def write_into(folder: str, made: Mapping[str, bytes], scene_path: str, inputs: tuple[str | None, ...] = ()) -> None:
    """Write files to a folder; none of them over what was read. Raises InvalidInput."""
    make_folder(folder)
    outputs = [output_for(os.path.join(folder, name), scene_path, "", inputs) for name in made]
    with uninterrupted():
        for out, data in zip(outputs, made.values(), strict=True):
            out.put(data)


def write_scene(scene: Scene, out: Output) -> None:
    """Write a scene whole, unless it was written there before; the caller holds interrupts back.

    If it should replace the file that it was read from, and that has changed meanwhile, the scene goes into a file
    beside it. Raises InvalidInput with the name of that file.
    """
    from clothfit.scene.scene import dumps, folder_of

    data = dumps(scene, None if out.is_stream else folder_of(out.path))
    if data == out.written:
        return
    if not out.in_place or unchanged(scene, out):
        out.put(data)
        out.written = data
        return
    beside = Path(out.path)
    other = Output(str(beside.with_suffix(f".fitted{beside.suffix}")))
    other.put(data)
    raise InvalidInput(f"{out.path}: changed while the fit ran, so it is left as it is; the result is in {other.path}")


def keep_scene(scene: Scene, out: Output) -> None:
    """Write a scene that may still be replaced by a better known one, where that is a file. A fault is no error yet:
    the last writing says it.
    """
    if not out.is_stream and (os.path.isfile(out.path) or not os.path.exists(out.path)):
        with suppress(InvalidInput), uninterrupted():
            write_scene(scene, out)


def unchanged(scene: Scene, out: Output) -> bool:
    """Whether a file is there and still holds the text that the scene was read from, or that was written there."""
    source = scene.source
    try:
        return Path(out.path).read_bytes() in (source.encode(source.text), out.written)
    except OSError:
        return False


def is_among(path: str, others: Iterable[str | None]) -> bool:
    """Whether a path leads to the same file as one of others; None and standard streams are none."""
    return any(other not in (None, STREAM) and same_file(path, str(other)) for other in others)


def same_file(a: str, b: str) -> bool:
    """Whether two paths lead to the same file, or would if it existed."""
    try:
        with suppress(OSError):
            return os.path.samefile(a, b)
        return os.path.realpath(a) == os.path.realpath(b)
    except ValueError:  # no possible name
        return False


def streams(arguments: Mapping[str, Any]) -> bool:
    """Whether the arguments of a command, by the names of its parameters, send its result to standard output."""
    path = arguments.get("path", arguments.get("out_path"))
    if path is not None or "path" not in arguments:
        return bool(path == STREAM)
    inputs = ("scene_paths", "fitted_paths", "fitted_path", "scene_path", "subspace_path")
    named = next((arguments[name] for name in inputs if name in arguments), None)
    return (named[0] if isinstance(named, tuple) else named) == STREAM


def document(command: str | None, summary: dict[str, Any]) -> dict[str, Any]:
    """The object that --json prints."""
    return {"schema_version": SCHEMA_VERSION, "command": command, **summary}


def print_json(summary: dict[str, Any]) -> bool:
    """Where --json asks for it, print a summary as JSON on standard output, or on standard error when the result itself
    goes there; returns whether it does.
    """
    if Printed.as_json:
        text = json.dumps(plain(document(Printed.command, summary)), allow_nan=False)
        Printed.summary = True
        print(text, file=sys.stderr if Printed.elsewhere else sys.stdout, flush=True)
    return Printed.as_json


def attributes(found: object, *names: str) -> dict[str, Any]:
    """Those attributes of an object, by their names."""
    return {name: getattr(found, name) for name in names}


def plain(value: Any) -> Any:
    """The value as JSON can hold it: a dataclass by its fields, an array as a list, and None where it is not finite."""
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
