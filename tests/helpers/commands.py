"""The commands that the documents show: as they are typed, understood, and with the files that they read and write."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from clothfit.cli.common.options import PLACES
from clothfit.cli.program import group

BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
TYPED = re.compile(r"^(?:\$ )?(?:\w+=\S+ )?clothfit (.*)$", re.MULTILINE)
READS = (*PLACES, "keys_path", "bind_path", "pins_from", "map")
WRITES = (
    "path", "out_path", "cache", "report_path", "save_path", "table_path", "page_path", "coordinates", "dump_path",
    "log", "plot", "gif", "checkpoint",
)  # fmt: skip
"""Parameters of commands that are files."""

DEFAULTS = {
    "new": (".json",), "simulate": (".motion.npz",), "target": (".target.npz",), "estimate": (".fitted.json",),
    "control": (".forces.npz", ".controlled.npz"), "report": (".report.html",), "transfer": (".transferred.json",),
}  # fmt: skip
"""What a command writes without an option, behind the stem of its first file, or of the second one."""


def blocks(text: str, language: str) -> list[str]:
    """The code blocks of one language, with commands that are broken into lines in one."""
    return [block for name, block in BLOCK.findall(text.replace(" \\\n    ", " ")) if name == language]


def typed(text: str) -> list[str]:
    """All commands of a page in their order, without the program's name: lines of code blocks, and in the text."""
    text = text.replace(" \\\n    ", " ")
    prose = r"`clothfit\s([a-z]+\s[^`]*)`"
    found = [(match.start(), line) for match in BLOCK.finditer(text) for line in TYPED.findall(match[2])]
    hidden = BLOCK.sub(lambda match: " " * len(match[0]), text)
    found += [(match.start(), " ".join(match[1].split())) for match in re.finditer(prose, hidden)]
    return [line for _, line in sorted(found, key=lambda each: each[0])]


def understood(line: str) -> tuple[str, dict[str, Any]]:
    """The command of a line and the values of its parameters, as the program understands them. Raises click's
    UsageError where it does not, and where a setting is typed as an option; a text may leave out a file, or ask for
    help.
    """
    words = shlex.split(re.split(r" [|<>] ", line)[0], comments=True)
    name, *arguments = words
    command = group.get_command(click.Context(group), name)
    while isinstance(command, click.Group):
        name, *arguments = arguments
        command = command.get_command(click.Context(command), name)
    if command is None:
        raise click.UsageError(f"no such command {name}")
    settings = {option for each in getattr(command, "settings", {}).values() for option in each.opts}
    if typed_out := settings.intersection(word.partition("=")[0] for word in arguments):
        raise click.UsageError(f"{line}: documents give {', '.join(typed_out)} by --set")
    with suppress(click.MissingParameter, click.exceptions.Exit):
        return name, command.make_context(name, arguments).params
    return name, {}


def named(values: dict[str, Any], names: tuple[str, ...]) -> Iterator[str]:
    """The files among the values of these parameters; one that stands for any, such as SCENE, is none."""
    for name in names:
        value = values.get(name)
        for each in value if isinstance(value, (tuple, list)) else (value,):
            for part in re.split(r"(?<=\w)@|^outline=", str(each or "")):
                if re.search(r"\.[a-z]\w*$", part):
                    yield part


def written(command: str, values: dict[str, Any]) -> Iterator[str]:
    """The files that a command writes."""
    yield from named(values, WRITES)
    if command == "control":
        yield from named(values, ("forces_path",))
    if not values.get("path"):
        sources = [Path(file) for file in named(values, ("scene_path", "scene_paths", "fitted_path", "fitted_paths"))]
        stem = values.get("cloth_path") or ""
        sources += [Path(stem)] if command == "new" and stem else []
        for source in sources:
            for ending in DEFAULTS.get(command, ()):
                stem = source.name.removesuffix(source.suffix).rstrip("_*")
                yield stem + ending
                yield (source.parent / (stem + ending)).as_posix()
