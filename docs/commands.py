"""Write `build/docs/commands.md`, the reference of all commands, from what the program says of itself.

`make docs` runs this.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from inspect import cleandoc
from pathlib import Path

import click

from clothfit.cli.common.options import parts, sections, wrapped
from clothfit.cli.program import COMMANDS, group

PAGE = Path(__file__).parents[1] / "build" / "docs" / "commands.md"
WIDTH = 96  # columns of an example
HEAD = """
# Commands

Written by `make docs` from what `clothfit COMMAND --help` says.
"""


def text(paragraph: str) -> str:
    """A paragraph of help as Markdown; one whose lines were kept as they are is a block of code."""
    if paragraph.startswith("\b"):
        return "```text\n{}\n```".format(paragraph.removeprefix("\b").strip("\n"))
    plain = " ".join(paragraph.split()).replace("<", "&lt;")
    return re.sub(r"(?<!\S)(--?[a-z][a-z-]*|\{[a-z]+\})(?=[\s,.;:]|$)", r"`\1`", plain)


def cell(value: str) -> str:
    """A text as the cell of a table."""
    return " ".join(value.replace("|", "\\|").split())


def row(option: click.Parameter, context: click.Context) -> str | None:
    """An option as a row of a table."""
    record = option.get_help_record(context)
    if record is None:
        return None
    names, meaning = record
    return f"| `{cell(names)}` | {cell(text(meaning))} |"


def table(title: str, options: list[click.Parameter], context: click.Context) -> str:
    """A section of options."""
    rows = [line for option in options if (line := row(option, context)) is not None]
    return "\n".join([f"| {title.lower() if title == 'Options' else title} | |", "|---|---|", *rows])


def chapter(name: str, top: click.Context) -> Iterator[str]:
    """The paragraphs on one command."""
    command = group.get_command(top, name)
    assert command is not None
    context = context_of(command, top)
    told = parts(command.help)
    yield f"## clothfit {name}"
    yield text(told.summary)
    yield f"`{command.get_usage(context).removeprefix('Usage: ')}`"
    if told.examples:
        yield "\n".join(["```sh", *(piece for line in told.examples for piece in wrapped(line, WIDTH)), "```"])
    yield from map(text, told.rest)
    for title, options in sections(command, context).items():
        if title != "Common options":
            yield table(title, options, context)


def context_of(command: click.Command, top: click.Context) -> click.Context:
    """The context in which a command tells of itself, whatever the terminal."""
    settings = command.context_settings
    return click.Context(command, parent=top, info_name=command.name, terminal_width=200, **settings)


def page() -> str:
    """The page."""
    top = click.Context(group, info_name="clothfit")
    names = [f"| [`clothfit {name}`](#clothfit-{name}) | {cell(text(summary(name, top)))} |" for name in COMMANDS]
    first = group.get_command(top, COMMANDS[0])
    assert first is not None
    context = context_of(first, top)
    common = table("every command has", sections(first, context)["Common options"], context)
    listed = "\n".join(["| command | does |", "|---|---|", *names])
    chapters = [paragraph for name in COMMANDS for paragraph in chapter(name, top)]
    return "\n\n".join([cleandoc(HEAD), listed, text(parts(group.help).rest[-1]), common, *chapters]) + "\n"


def summary(name: str, top: click.Context) -> str:
    """What a command does."""
    command = group.get_command(top, name)
    return "" if command is None else parts(command.help).summary


if __name__ == "__main__":
    PAGE.parent.mkdir(parents=True, exist_ok=True)
    PAGE.write_text(page(), encoding="utf-8")
