"""How long a command runs. `--watch`: again whenever its scene, or its target, is saved; `--end-with-input`: until its
standard input ends.

With --watch each run is a process of its own with the same options, so that a version that is overtaken can be ended at
once, and one that is broken costs a message.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import Any

import click

from clothfit.base import interrupts
from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.cli.common.options import Action, setting
from clothfit.cli.common.options import option as declared
from clothfit.cli.common.output import STREAM

Stamp = tuple[int, int, int] | None
"""What the system knows of a file: time, size and number; None where it is missing."""

OPTION = "--watch"
PATIENCE = 5.0
"""Seconds that a run has to end when it is overtaken."""

INVALID = 3
"""The exit code of invalid input."""


def option(again: str, start: bool = False) -> Callable[[Action], Action]:
    """Add --watch, which runs the command `again` when its files change; with `start` from the last result."""

    def decorate(function: Action) -> Action:
        @wraps(function)
        def run(watch: bool, **arguments: Any) -> int | None:
            if not watch:
                return function(**arguments)
            return watched(arguments, start)

        text = f"{again} whenever SCENE, or a target, is saved; Ctrl-C ends."
        return declared(OPTION, text)(run)

    return decorate


def watched(arguments: dict[str, Any], start: bool) -> int:
    """Run the command of this process again and again, until Ctrl-C."""
    scenes = arguments.get("scene_paths") or (arguments["scene_path"],)
    targets = [path.partition("@")[0] for path in arguments.get("target_paths", ())]
    check_watched(scenes, targets, arguments)
    console, files = arguments["console"], Watch([*scenes, *targets])
    result = result_of(scenes[0], arguments.get("path")) if start and not arguments.get("start") else None
    own, begun = [word for word in sys.argv[1:] if word != OPTION], False
    good: list[Stamp] = []  # of the targets of the last run that took them

    def run(more: Sequence[str]) -> int:
        """Run until it ends, or is overtaken; returns its exit code."""
        call = [sys.executable, "-m", "clothfit", *own, *more]
        process = subprocess.Popen(call, stdin=subprocess.DEVNULL)
        try:
            while process.poll() is None and not files.changed():
                interrupts.check()
                with_patience(process, OFTEN)
        finally:
            code = ended(process)
        return code

    with tempfile.TemporaryDirectory(prefix="clothfit-") as folder:
        while True:
            files.given()
            more = start_from(result, folder) if result and begun and is_scene(scenes[0]) else []
            stamps = [stamp(path) for path in targets]
            code = run(more)
            if code == INVALID and more and stamps == good and not files.changed():  # the values of another mesh
                code = run([])
            begun, good = begun or code != INVALID, good if code == INVALID else stamps
            if not files.changed():
                console.say(f"waiting for {os.path.basename(scenes[0])} to be saved; Ctrl-C ends")
                files.next(interrupts.check)


def is_scene(path: str) -> bool:
    """Whether a file is a scene: a run says why it is none, once."""
    from clothfit.scene.scene import load

    try:
        load(path)
    except ClothfitError:
        return False
    return True


def start_from(result: str, folder: str) -> list[str]:
    """The option to start from a copy of the last result, since no run writes over what it reads; none without one."""
    copy = os.path.join(folder, os.path.basename(result))
    try:
        shutil.copyfile(result, copy)
    except OSError:
        return []
    return ["--start", copy]


def check_watched(scenes: Sequence[str], targets: Sequence[str], arguments: dict[str, Any]) -> None:
    """Raise a UsageError, or InvalidInput, for what cannot be watched."""
    if len(scenes) != 1 or STREAM in (*scenes, *targets) or any("*" in path or "{" in path for path in targets):
        raise click.UsageError("--watch is for one scene and targets in files")
    if arguments.get("in_place") or arguments.get("path") == STREAM:
        raise click.UsageError("--watch goes neither with --in-place nor with -o -")
    for path in (*scenes, *targets):
        if not os.path.exists(path):
            raise InvalidInput(f"{path}: there is no such file")


def result_of(scene: str, path: str | None) -> str | None:
    """Where a fit of a scene goes."""
    if path is not None:
        return path if "{" not in path and not os.path.isdir(path) else None
    return str(Path(scene).with_suffix(f".fitted{Path(scene).suffix}"))


def with_patience(process: subprocess.Popen[bytes], seconds: float) -> None:
    """Wait so long for a process."""
    with suppress(subprocess.TimeoutExpired):
        process.wait(seconds)


def ended(process: subprocess.Popen[bytes]) -> int:
    """End a run that is under way, with its best so far; returns its exit code."""
    if process.poll() is None:
        process.terminate()
        with_patience(process, PATIENCE)
        if process.poll() is None:
            process.kill()
    return process.wait()


# ---- Doing something again when files are saved: the newest version counts, however many come at once.
#
# A version is what a file holds, not when it was written. An editor may write a file in several goes, or put another
# one in its place; so a change counts when the file has been still for a moment, or after a while where it never is.
# Files are looked at now and then, which works on all systems and shared folders.

OFTEN = 0.1
"""Seconds between two looks."""

QUIET_SECONDS, LONGEST = 0.3, 3.0
"""Seconds for which a file that changes must be still, and after which a change counts anyhow."""


def stamp(path: str) -> Stamp:
    """The stamp of a file."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


class Watch:
    """Some files, and what they held when `next` gave them last."""

    def __init__(self, paths: Sequence[str]) -> None:
        self.paths = list(paths)
        self._known = b""
        self._looked: tuple[Stamp, ...] = ()
        self._since = self._first = 0.0  # when they changed last, and first since they were given

    def changed(self) -> bool:
        """Whether the files hold something else than what was given last, and are still; to be asked often."""
        now, stamp = time.monotonic(), self._stamp()
        if stamp != self._looked:
            self._first = self._first or now
            self._looked, self._since = stamp, now
        if not self._first or (now < self._since + QUIET_SECONDS and now < self._first + LONGEST):
            return False
        self._first = 0.0
        return self._content() != self._known

    def given(self) -> None:
        """Count what the files hold now as given."""
        self._looked, self._known, self._first = self._stamp(), self._content(), 0.0

    def next(self, poll: Callable[[], None] = lambda: None) -> None:
        """Wait until the files have changed; `poll` is called now and then, and may raise."""
        while not self.changed():
            poll()
            time.sleep(OFTEN)

    def _stamp(self) -> tuple[Stamp, ...]:
        return tuple(map(stamp, self.paths))

    def _content(self) -> bytes:
        """A digest of what the files hold; of one that cannot be read, of nothing."""
        digest = hashlib.sha256()
        for path in self.paths:
            try:
                digest.update(hashlib.sha256(Path(path).read_bytes()).digest())
            except OSError:
                digest.update(b"missing")
        return digest.digest()


# ---- `--end-with-input`: a command that ends when its standard input does.
#
# A program that starts this one has one way to end it that is the same on all systems: it keeps the input open and
# closes it. Windows has no Ctrl-C for a process without a window; and where the other program itself ends, so does this
# one.

END_OPTION = "--end-with-input"
INPUT = 0
"""The descriptor of standard input."""

SOME = 4096
"""Bytes that are read, and ignored, at a time."""


def ends_with_input(function: Action) -> Action:
    """Add --end-with-input to a command that keeps its best result when it is interrupted."""

    @wraps(function)
    def run(end_with_input: bool, **arguments: Any) -> int | None:
        if end_with_input:
            if STREAM in arguments["scene_paths"]:
                raise click.UsageError(f"{END_OPTION} watches standard input, which cannot be the scene as well")
            threading.Thread(target=wait, name=END_OPTION, daemon=True).start()
        return function(**arguments)

    text = "End as with Ctrl-C when standard input is closed: for programs that start this one."
    return setting(END_OPTION, text)(run)


def wait() -> None:
    """Read standard input to its end, then ask the main thread to end."""
    with suppress(OSError):
        while os.read(INPUT, SOME):
            pass
    interrupts.ask()
