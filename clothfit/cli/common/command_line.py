"""The command that was given, as a line to copy."""

from __future__ import annotations

import shlex

import click

SILENT = ("quiet", "verbose", "as_json")
"""What changes no result."""


def command_line(context: click.Context, **others: str | None) -> str:
    """The command of a context, with the options that were given; `others` replace values of parameters."""
    options: list[str] = []
    arguments: list[str] = []
    for parameter in context.command.params:
        name = parameter.name or ""
        value = others.get(name, context.params.get(name))
        if name in SILENT or value is None or value is False or value == () or value == parameter.default:
            continue
        given = [str(each) for each in (value if isinstance(value, tuple) else (value,))]
        if isinstance(parameter, click.Option):
            option = parameter.opts[0]
            options += [option] if value is True else [part for each in given for part in (option, each)]
        else:
            arguments += given
    parts = [*arguments, *options]
    if any(each.startswith("-") and each != "-" for each in arguments):
        parts = [*options, "--", *arguments]
    return shlex.join(["clothfit", context.info_name or "", *parts])
