"""How a command says that it failed: a sentence on standard error and, with --json, an object on standard output.

The object has `schema_version`, `command`, `error` (the sentence), `where` (the file and the place in it, or the option
or argument; null where there is none) and `code` (the exit code). A command that has printed its summary, as one whose
simulation diverges, prints no second object. Where standard output is for a motion or a scene, the object goes to
standard error, as the summary does.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Sequence
from contextlib import suppress

import click

from clothfit.base.errors import InvalidInput, InvalidScene
from clothfit.base.messages import harmless, spelled
from clothfit.cli.common.options import slip
from clothfit.cli.common.output import Printed, document, plain

PLACE = re.compile(r"(top level|line \d+, column \d+|(?:[\w.\[\]]|\"[^\"]*\")+): (.*)", re.DOTALL)
"""Where something is wrong, before what is."""

OPTION = re.compile(r"--[a-z][a-z-]*")
ARGUMENT = re.compile(r"([a-z][a-z_ ]*?)(?=: | must be )")  # as messages name it for Python

OTHERWISE = {"markers": "--map", "seconds": "--budget", "rmse_tolerance": "--rmse"}
"""Arguments of Python whose options have other names."""


def split(sentence: str) -> dict[str, str | None]:
    """Place and message of a problem; no place where it is the file as a whole."""
    match = PLACE.fullmatch(sentence)
    return {"place": match[1], "message": match[2]} if match else {"place": None, "message": sentence}


def refused(error: click.UsageError, arguments: Sequence[str]) -> int:
    """Say why the arguments cannot be; returns the exit code."""
    value_is_wrong = isinstance(error, click.BadParameter) and not isinstance(error, click.MissingParameter)
    if error.ctx is not None and error.ctx.parent is not None:
        Printed.command = error.ctx.info_name
    hint = "" if value_is_wrong or error.ctx is None else f" (see {error.ctx.command_path} --help)"
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
