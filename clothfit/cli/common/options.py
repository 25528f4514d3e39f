"""How a command is declared and explains itself: the options that all have, its help, checks of what several take."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator, Mapping
from functools import wraps
from inspect import cleandoc
from typing import Any, NamedTuple, TypeVar

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.limits import checked_tolerance
from clothfit.base.limits import duration as duration
from clothfit.base.limits import is_number as is_number
from clothfit.base.messages import meant
from clothfit.base.version import __version__
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import Printed, streams
from clothfit.cli.common.places import check_places
from clothfit.cli.common.values import SUFFIXES, VALUES, Known

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


def section(title: str) -> Callable[[Action], Action]:
    """Show the options below, down to those of the next section, under this title in the help."""

    def mark(function: Action) -> Action:
        for option in getattr(function, "__click_params__", ()):
            vars(option).setdefault("title", title)
        return function

    return mark


def gathered(name: str, kind: type[Any], *options: Callable[[Any], Any]) -> Callable[[Action], Action]:
    """Add options, which a command is given as one argument: a dataclass whose fields have their names."""
    fields = [each.name for each in dataclasses.fields(kind)]

    def decorate(function: Action) -> Action:
        @wraps(function)
        def run(**rest: Any) -> int | None:
            own = {field: rest.pop(field) for field in fields}
            return function(**rest, **{name: kind(**own)})

        for option in reversed(options):
            run = option(run)
        return run

    return decorate


def standard_command(name: str) -> Callable[[Action], click.Command]:
    """A command with the options that every command has; its function receives a `console` for its messages."""

    def decorate(function: Action) -> click.Command:
        @wraps(function)
        def speaking(quiet: bool, verbose: bool, as_json: bool, **arguments: Any) -> int | None:
            context = click.get_current_context()
            before: dict[str, bool] = context.obj or {}
            known = {each for one in context.command.params for each in one.opts}
            Printed.begin(name, streams(arguments), known, as_json or before.get("as_json", False))
            check_places(name, arguments)
            data = Printed.elsewhere or Printed.as_json
            console = Console(quiet or before.get("quiet", False), verbose or before.get("verbose", False), data)
            return function(**arguments, console=console)

        made = loudness(click.version_option(__version__, prog_name="clothfit")(speaking))
        made = as_object(made)
        settings = {"help_option_names": ["-h", "--help"]}
        return complete_values(click.command(name, ExamplesFirst, context_settings=settings)(made))

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


def refuse(given: Mapping[str, object], why: str) -> None:
    """Raise UsageError, with the name in the place of {} in it, at the first option that is given."""
    for name, value in given.items():
        if value is not None:
            raise click.UsageError(why.format(name), click.get_current_context())


# ---- What `--help` shows, and in which order: what the command does, examples to copy, then the rest.
#
# A command's docstring is its help text: paragraphs between empty lines, the first a plain sentence or two, one of them
# the examples, lines of a shell under a `\b`. Options stand in sections, those that all commands have at the end.
#
# Here too: what was probably meant by a word that no command or option has, and which arguments are files to complete.

COMMON = ("as_json", "quiet", "verbose", "version")
"""Parameters that every command has, besides the help itself."""

LAST = "Common options"
"""The title of their section, which is the last one."""

EXAMPLE_WIDTH = 78  # columns of an example: 80 and the indentation of two

FILE_NAMES = {"SCENE", "FITTED", "MOTION", "FILE", "FOLDER", "MESH", "IN", "OUT", "PATH"}
"""Words in the name of a value that make it the name of a file."""


class Text(NamedTuple):
    """A help text in parts."""

    summary: str  # what the command does
    examples: tuple[str, ...]  # lines of a shell
    rest: tuple[str, ...]  # further paragraphs, as click takes them


def parts(text: str | None) -> Text:
    """Split a help text."""
    paragraphs = cleandoc(text or "").split("\n\n")
    examples = next((p for p in paragraphs if p.startswith("\b") and re.search(r"^(\S+=\S+ )?clothfit ", p, re.M)), "")
    summary, *rest = (p for p in paragraphs if p != examples)
    return Text(summary, tuple(examples.split("\n")[1:]), tuple(rest))


def wrapped(example: str, width: int = EXAMPLE_WIDTH) -> Iterator[str]:
    """Break a long line of a shell so that a shell still takes it: before an option where possible."""
    while len(example) > width:
        breaks = [found.start() for found in re.finditer(r" (?=\S)", example) if 4 < found.start() <= width - 2]
        before_options = [at for at in breaks if example[at + 1] == "-"]
        if not breaks:
            break
        at = (before_options or breaks)[-1]
        yield f"{example[:at]} \\"
        example = f"    {example[at + 1 :]}"
    yield example


def sections(command: click.Command, context: click.Context) -> dict[str, list[click.Parameter]]:
    """Titles of sections to the options in them, in the order in which they are shown."""
    found: dict[str, list[click.Parameter]] = {}
    for option in command.get_params(context):
        if option.param_type_name == "option":
            common = option.name in COMMON or "--help" in option.opts
            found.setdefault(LAST if common else vars(option).get("title", "Options"), []).append(option)
    return dict(sorted(found.items(), key=lambda each: each[0] == LAST))


class ExamplesFirst(click.Command):
    """A command whose help shows its examples first, and its options in sections."""

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the text: summary, examples, rest."""
        text = parts(self.help)
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text(text.summary)
        if text.examples:
            with formatter.section("Examples"):
                for line in text.examples:
                    for piece in wrapped(line):
                        formatter.write(f"{'':{formatter.current_indent}}{piece}\n")
        if text.rest:
            formatter.write_paragraph()
            with formatter.indentation():
                formatter.write_text("\n\n".join(text.rest))

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, a section each."""
        for title, options in sections(self, ctx).items():
            records = [record for option in options if (record := option.get_help_record(ctx)) is not None]
            with formatter.section(title):
                formatter.write_dl(records)


def complete_values(command: click.Command) -> click.Command:
    """The command, with what its options know completed, and files where a value's name says that it is one."""
    for parameter in command.params:
        words = set(re.findall(r"[A-Z]+", parameter.metavar or ""))
        keys = [*parameter.opts, *sorted(words)]
        values = next((VALUES[key] for key in keys if key in VALUES), ())
        suffixes = next((SUFFIXES[key] for key in keys if key in SUFFIXES), None)
        if suffixes is None and FILE_NAMES & words and not values:
            suffixes = ()
        if parameter.type is click.STRING and (values or suffixes is not None):
            parameter.type = Known(values, suffixes)
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


# ---- Lengths with their units, as options have them.

def length(text: str | None, option: str) -> float | None:
    """A length in m from a text such as 5mm, 0.5cm, 0.005 or 0.005m. Raises InvalidInput."""
    if text is None:
        return None
    for unit, size in (("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("", 1.0)):
        if text.strip().endswith(unit):
            try:
                return float(text.strip().removesuffix(unit)) * size
            except ValueError:
                break
    raise InvalidInput(f"{option}: {text!r} is no length; write it as 5mm, 0.5cm or 0.005")
