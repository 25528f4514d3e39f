"""Typing errors on the command line, with what was probably meant; and which arguments are files, for completion."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import click

from clothfit.base.messages import meant

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

FILE_NAMES = {"SCENE", "FITTED", "MOTION", "FILE", "FOLDER", "MESH", "IN", "OUT", "PATH"}
"""Words in the name of a value that make it the name of a file."""


class FileName(click.types.StringParamType):
    """A text that a shell completes as the name of a file; whoever reads the file finds out what it is."""

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Let the shell do it."""
        from click.shell_completion import CompletionItem

        return [CompletionItem(incomplete, type="file")]


def complete_files(command: click.Command) -> click.Command:
    """The command, with file names completed where the name of a value says that it is one."""
    for parameter in command.params:
        names = re.findall(r"[A-Z]+", parameter.metavar or "")
        if parameter.type is click.STRING and FILE_NAMES & set(names):
            parameter.type = FileName()
    return command


def slip(error: click.UsageError) -> str:
    """The error's sentence, without its full stop, on one line; with what was probably meant, where something was."""
    context, message = error.ctx, error.format_message()
    if context is not None and isinstance(error, click.NoSuchOption):
        options = [name for option in context.command.get_params(context) for name in option.opts]
        known = [name for name in options if name.startswith("-")]
        message = error.message.rstrip(".") + meant(error.option_name, known)
    elif context is not None and isinstance(error, click.exceptions.NoSuchCommand):
        known = context.command.list_commands(context) if isinstance(context.command, click.Group) else []
        message = error.message.rstrip(".") + meant(error.command_name, known)
    message = " ".join(message.split()).rstrip(".")
    return f"{message[:1].lower()}{message[1:]}"
