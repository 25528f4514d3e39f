"""The options that all commands have, and the checks of numbers that several take."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.limits import checked_tolerance
from clothfit.base.limits import duration as duration
from clothfit.base.limits import is_number as is_number
from clothfit.base.version import __version__
from clothfit.cli.common.console import Console
from clothfit.cli.common.help import ExamplesFirst, Sections, complete_values
from clothfit.cli.common.output import Printed, streams
from clothfit.cli.common.places import check_places

F = TypeVar("F", bound=Callable[..., object])
Action = Callable[..., int | None]
"""What a command does; None is the exit code 0."""


def loudness(function: F) -> F:
    """Add --quiet and --verbose; they work before and after a command's name."""
    verbose = click.option("-v", "--verbose", is_flag=True, help="Print more: what is read, and when.")
    return click.option("-q", "--quiet", is_flag=True, help="Print errors only.")(verbose(function))


def as_object(function: F) -> F:
    """Add --json; it works before and after a command's name."""
    text = "Print the summary, or the error, as one JSON object on standard output."
    return click.option("--json", "as_json", is_flag=True, help=text)(function)


def standard_command(name: str, sections: Sections | None = None) -> Callable[[Action], click.Command]:
    """A command with the options that every command has; its function receives a `console` for its messages.

    `sections` groups its other options in the help.
    """

    def decorate(function: Action) -> click.Command:
        @wraps(function)
        def speaking(quiet: bool, verbose: bool, **arguments: Any) -> int | None:
            context = click.get_current_context()
            before: dict[str, bool] = context.obj or {}
            arguments["as_json"] = arguments["as_json"] or before.get("as_json", False)
            elsewhere = streams(arguments)
            Printed.begin(name, elsewhere, {each for one in context.command.params for each in one.opts})
            data = elsewhere or arguments["as_json"]
            check_places(name, arguments)
            console = Console(quiet or before.get("quiet", False), verbose or before.get("verbose", False), data)
            return function(**arguments, console=console)

        made = loudness(click.version_option(__version__, prog_name="clothfit")(speaking))
        made = as_object(made)
        settings = {"help_option_names": ["-h", "--help"]}
        return complete_values(click.command(name, ExamplesFirst, context_settings=settings, sections=sections)(made))

    return decorate


def check_numbers(steps: int | None = None, tolerance: float | None = None) -> None:
    """Check options before the libraries load, which takes longer. Raises InvalidInput for a value out of range."""
    check_least(1, steps=steps)
    if tolerance is not None:
        checked_tolerance(tolerance, tolerance)


def check_least(least: int, **options: int | None) -> None:
    """Raise InvalidInput for an option, by the name of its parameter, whose number is too small."""
    for name, value in options.items():
        if value is not None and value < least:
            raise InvalidInput(f"--{name.replace('_', '-')} must be at least {least}; {value} was given")
