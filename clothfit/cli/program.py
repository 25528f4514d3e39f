"""The command line as a whole: which commands there are, how they end, what signals do.

Exit codes: 0 done, 1 a fault of the program, 2 usage, 3 invalid input, 4 the simulation diverged, 5 the fit ended
without reaching its tolerance, 130 interrupted.
"""

from __future__ import annotations

import errno
import io
import json
import os
import re
import signal
import sys
import threading
import time
import warnings
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from itertools import groupby
from typing import Any, NoReturn

import click

from clothfit.base import interrupts
from clothfit.base.errors import ClothfitError, InvalidInput, InvalidScene
from clothfit.base.interrupts import REQUESTS, SAME_REQUEST
from clothfit.base.messages import harmless, spelled
from clothfit.base.version import __version__
from clothfit.cli.common.console import results_apart
from clothfit.cli.common.motions import split
from clothfit.cli.common.options import EVERY_DAY, ExamplesFirst, as_object, loudness, slip
from clothfit.cli.common.output import Printed, document, plain

_last_request = -SAME_REQUEST

CALLBACKS = {
    ("<frozen importlib._bootstrap>", "cb"), ("weakref.py", "remove"), ("_weakrefset.py", "_remove"),
    ("serialize.py", "_numba_unpickle"),
}  # fmt: skip
"""Files and functions of Python's own callbacks on references that end, and of numba's as a kernel returns arrays."""

ASKED = ("apart.py", "_address")
"""The same of what compiled code calls, but not of what that calls in turn, which may take long."""

LATER = 0.01
"""Seconds after which a request that arrived in one of them comes again."""

OBJ_SUFFIX = ".obj"
FEWEST = 3
"""Files of a sequence, in a row on the command line; two may be meant as two."""

SUMMARIES = {
    "new": "make a scene of a plane or a mesh",
    "fabrics": "list real fabrics, with what is known of them",
    "info": "print what a file holds: a scene, a motion, a mesh",
    "validate": "check scenes without simulating",
    "simulate": "simulate the cloths of a scene and write their motion",
    "target": "record a scene's motion, perfect or as a capture sees it",
    "estimate": "fit the parameters of a scene to a motion",
    "transfer": "give a fitted fabric to another mesh",
    "control": "find what takes a cloth through keyframes: forces, handles, wind",
    "subspace": "play large cloths many times faster, in a subspace",
    "evaluate": "measure how far a fit is from the truth or a target",
    "report": "make a page that plays a fit over its target in 3-D",
    "serve": "play, tune and fit a scene on a page in the browser",
    "check": "check the gradient that a fit would follow",
    "convert": "convert a motion from one format to another",
    "export": "write masses and stiffnesses for other cloth tools",
    "completion": "print the script for completion in a shell",
    "warmup": "compile everything for this machine ahead",
}
"""What `clothfit --help` says of each command, in the order of a working day: kept here, as asking all commands would
load all of their modules.
"""

COMMANDS = tuple(SUMMARIES)


class LazyGroup(click.Group, ExamplesFirst):
    """A group whose commands are modules of this package, in the order of a working day."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        command: click.Command = import_module(f"clothfit.cli.{name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(SUMMARIES.items()))


@click.command(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="clothfit")
@as_object
@loudness
@click.pass_context
def group(context: click.Context, as_json: bool, quiet: bool, verbose: bool) -> None:
    """Find the masses and stiffnesses of a cloth whose motion matches a target.

    \b
    clothfit estimate scene.json                       a trial, on its own motion
    clothfit estimate scene.json --target capture.npz  fit to a recorded motion
    clothfit evaluate scene.json scene.fitted.json     how good is it?

    SCENE is a scene in JSON, as clothfit new writes it, or - for standard input.
    """
    context.obj = {"as_json": as_json, "quiet": quiet, "verbose": verbose}


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit."""
    try:
        _open_streams()
        interrupts.handle(_interrupt)
        with results_apart():
            code = _ended(list(sys.argv[1:] if arguments is None else arguments))
    except OSError:  # there is no way to write anything
        code = 3
    except KeyboardInterrupt:  # before or after `run`
        code = failed("interrupted", 130, ())
    with suppress(OSError):
        sys.stderr.flush()
    for kind in REQUESTS:
        signal.signal(kind, signal.SIG_IGN)  # the exit code is decided
    sys.exit(code)


def _ended(arguments: list[str]) -> int:
    """Run the command line until all output is written; returns the exit code."""
    try:
        code = run(arguments)
        sys.stdout.flush()
    except OSError:  # whoever read our output has left, or `run` has said what is wrong with it
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 3
    return code


def run(arguments: list[str]) -> int:
    """Run the command line; returns the exit code, having reported what went wrong."""
    interrupts.clear()
    Printed.begin()
    try:
        with warnings.catch_warnings(), interrupts.heard():
            warnings.simplefilter("ignore", RuntimeWarning)  # of NumPy, on numbers that leave the finite ones
            code = group.main(gathered(arguments) or ["--help"], prog_name="clothfit", standalone_mode=False)
            sys.stdout.flush()
        return int(code or 0)
    except click.UsageError as error:
        return refused(error, arguments)
    except ClothfitError as error:
        return failed(str(error), error.exit_code, arguments, error)
    except (KeyboardInterrupt, click.Abort):
        return failed("interrupted", 130, arguments)
    except MemoryError:
        return failed("out of memory; try fewer frames (--steps, optimizationIterations)", 1, arguments)
    except BrokenPipeError:
        raise
    except SystemExit as error:  # click's own answer to a reader that left, before anybody can catch it
        if error.code == 1:
            raise BrokenPipeError from None
        raise
    except OSError as error:
        return failed(_lacking(error), 3, arguments)
    except Exception as error:
        if os.environ.get("CLOTHFIT_TRACEBACK"):
            raise
        kind = type(error).__name__
        why = f"a fault of the program: {kind}: {error} (set CLOTHFIT_TRACEBACK=1 to see where)"
        return failed(why, 1, arguments)


def _lacking(error: OSError) -> str:
    """What an error of the system means: where nothing names a file, and the system has enough of all, it is standard
    output that cannot be written.
    """
    reason = error.strerror or str(error)
    if error.filename:
        return f"{error.filename}: {reason}"
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return "too many open files; allow more (ulimit -n)"
    if error.errno == errno.ENOMEM:
        return "out of memory; allow more (ulimit -v), or try fewer frames (--steps, optimizationIterations)"
    if error.errno is None:  # llvmlite, for one, gives no number
        return f"a library cannot be loaded, for which memory may be too short (ulimit -v): {reason.splitlines()[0]}"
    return f"standard output: {reason}"


def gathered(arguments: Sequence[str]) -> list[str]:
    """Arguments, with one name for each OBJ sequence.

    In `--target frames/a_*.obj` without quotes, the shell puts the names of all files in the place of the one with a
    `*`. Where some in a row are exactly the files of one sequence, they become its name again.
    """
    made: list[str] = []
    for alike, group in groupby(arguments, lambda each: each.lower().endswith(OBJ_SUFFIX)):
        names = list(group)
        pattern = _pattern(names) if alike and len(names) >= FEWEST else None
        made += names if pattern is None else [pattern]
    return made


def _pattern(names: list[str]) -> str | None:
    """The name of the sequence that has just these files; None where there is none."""
    from clothfit.formats.obj import ANY, frames_of

    folder, name = os.path.split(names[0])
    for number in re.finditer("[0-9]+", name):
        pattern = os.path.join(folder, f"{name[: number.start()]}{ANY}{name[number.end() :]}")
        with suppress(InvalidInput):
            if sorted(frames_of(pattern)) == sorted(names):
                return pattern
    return None


def _interrupt(number: int, frame: Any) -> None:
    """End at the first request, Ctrl-C or a polite one; a fit then writes the best so far.

    Repetitions within a moment are one request: the second of a double Ctrl-C must not hit the writing. A request that
    arrives where its exception would be lost comes again a moment later.
    """
    global _last_request
    if _loses_exceptions(frame):
        threading.Timer(LATER, interrupts.ask, (number,)).start()
        return
    before, _last_request = _last_request, time.monotonic()
    if _last_request - before > SAME_REQUEST:
        interrupts.request()
        raise KeyboardInterrupt


def _loses_exceptions(frame: Any) -> bool:
    """Whether a frame runs within a callback from which Python lets no exception out, as while modules are imported, or
    is that in which compiled code asks for an address, which may not have come to its `try` (`kernels.apart`).
    """
    if frame is not None and (os.path.basename(frame.f_code.co_filename), frame.f_code.co_name) == ASKED:
        return True
    while frame is not None:
        name = frame.f_code.co_name
        if name == "__del__" or (os.path.basename(frame.f_code.co_filename), name) in CALLBACKS:
            return True
        frame = frame.f_back
    return False


def _open_streams() -> None:
    """Put the null device in the place of standard streams that are closed, before a file takes their number.

    Standard output gets it for reading only, so that data for it is an error and not lost.
    What standard output cannot spell (a Windows code page, ASCII) is escaped instead of ending the program. Where the
    user asks for the locale C, Python writes UTF-8 none the less; messages are then ASCII.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDONLY if name == "stdout" else os.O_RDWR)
            if null != number:
                os.dup2(null, number)
            setattr(sys, name, open(number, mode, encoding="utf-8"))  # noqa: SIM115 (for the life of the program)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    if _asks_for_ascii():
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(encoding="ascii", errors="backslashreplace")


def _asks_for_ascii() -> bool:
    """Whether the locale is C or POSIX because somebody said so, and Python has replaced its encoding."""
    environment = os.environ
    said = environment.get("LC_ALL") or environment.get("LANG")
    chosen = environment.get("PYTHONIOENCODING") or environment.get("PYTHONUTF8") == "1"
    return said in ("C", "POSIX") and bool(sys.flags.utf8_mode) and not chosen

# ---- How a command says that it failed: a sentence on standard error and, with --json, an object on standard output.
#
# The object has `schema_version`, `command`, `error` (the sentence), `where` (the file and the place in it, or the
# option or argument; null where there is none) and `code` (the exit code). A command that has printed its summary, as
# one whose simulation diverges, prints no second object. Where standard output is for a motion or a scene, the object
# goes to standard error, as the summary does.

OPTION = re.compile(r"--[a-z][a-z-]*")
ARGUMENT = re.compile(r"([a-z][a-z_ ]*?)(?=: | must be )")  # as messages name it for Python

OTHERWISE = {"markers": "--map", "seconds": "--budget", "time_limit": "--budget", "rmse_tolerance": "--rmse"}
"""Arguments of Python whose options have other names."""


def refused(error: click.UsageError, arguments: Sequence[str]) -> int:
    """Say why the arguments cannot be; returns the exit code."""
    value_is_wrong = isinstance(error, click.BadParameter) and not isinstance(error, click.MissingParameter)
    if error.ctx is not None and error.ctx.parent is not None:
        Printed.command = error.ctx.info_name
    known = "" if value_is_wrong or error.ctx is None else f"{error.ctx.command_path} --help"
    hint = known and f" (see {known}{'-all' if error.ctx and error.ctx.info_name in EVERY_DAY else ''})"
    return failed(f"{slip(error)}{hint}", 3 if value_is_wrong else 2, arguments, error)


def failed(message: str, code: int, arguments: Sequence[str], error: BaseException | None = None) -> int:
    """Say what is wrong; returns the exit code."""
    message = as_typed(message) if isinstance(error, InvalidInput) else message
    with suppress(OSError):
        print(spelled(harmless(f"error: {message}"), sys.stderr.encoding), file=sys.stderr, flush=True)
    words = list(arguments)  # which may not have been understood as a whole
    if "--json" in (words[: words.index("--")] if "--" in words else words) and not Printed.summary:
        found = {"error": message, "where": where(message, arguments, error), "code": code}
        with suppress(OSError):
            text = json.dumps(plain(document(Printed.command, found)))
            print(text, file=sys.stderr if Printed.elsewhere else sys.stdout, flush=True)
    return code


def as_typed(message: str) -> str:
    """The message with the option, as it is typed, in the place of the argument of Python that it is about."""
    found = ARGUMENT.match(message)
    if found is None:
        return message
    option = OTHERWISE.get(found[1], f"--{found[1].replace('_', '-').replace(' ', '-')}")
    return option + message[found.end() :] if option in Printed.options else message


def where(message: str, arguments: Sequence[str], error: BaseException | None) -> str | None:
    """The file and the place in it, or the option or argument, that a message is about."""
    if isinstance(error, click.NoSuchOption):
        return error.option_name
    if isinstance(error, click.BadParameter) and error.param is not None:
        return error.param.metavar if isinstance(error.param, click.Argument) else max(error.param.opts, key=len)
    if isinstance(error, InvalidScene):
        place = split(error.problems[0])["place"]
        parts = [error.name, place] if place else [error.name]
        return ": ".join(filter(None, parts)) or None
    if match := OPTION.match(message):
        return match[0]
    names = {name for each in arguments for name in (each, os.path.basename(each))} | {"standard input"}
    for name in sorted(filter(None, names), key=len, reverse=True):
        if message.startswith(f"{name} is a"):
            return name
        if message.startswith(f"{name}: "):
            place = split(message.removeprefix(f"{name}: "))["place"]
            return f"{name}: {place}" if place else name
    return None
