"""How a command is declared and explains itself: the options that all have, its help, what a shell completes, checks of
what several take, and which files do not belong where they are.
"""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial, wraps
from inspect import cleandoc
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.limits import checked_tolerance
from clothfit.base.messages import meant
from clothfit.base.version import __version__
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import Printed, streams
from clothfit.formats import registry

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

F = TypeVar("F", bound=Callable[..., object])
Action = Callable[..., int | None]
"""What a command does; None is the exit code 0."""


def option(form: str, text: str, kind: Any = None, *, name: str | None = None, **more: Any) -> Callable[[F], F]:
    """Add an option, written as the help has it: its names, then the name of its value, which is of some `kind`. It is
    a flag where it has neither. `name` is that of the parameter, where it is not the option's.
    """
    words = form.split()
    names = [word for word in words if word.startswith("-")]
    value = " ".join(words[len(names) :]) or None
    if value is None and kind is None:
        more["is_flag"] = True
    return click.option(*names, *filter(None, [name]), metavar=value, type=kind, help=text, **more)


class Setting(click.Option):
    """An option that tunes a command. It is given as `--set NAME=VALUE`, with the name that it has in Python, or as an
    option of that name; the help lists it apart.
    """

    def __init__(self, *given: Any, **more: Any) -> None:
        more["hidden"] = True  # from shells
        super().__init__(*given, **more)

    @property
    def key(self) -> str:
        """Its name."""
        return self.opts[0].lstrip("-").replace("-", "_")

    def words(self, value: str) -> list[str]:
        """The words of a command line that give it this value. Raises InvalidInput for a flag that is neither."""
        if not self.is_flag:
            return [f"{self.opts[0]}={value}"]
        if value.lower() not in YES_OR_NO:
            raise InvalidInput(f"--set {self.key} is yes or no; {value!r} was given")
        return self.opts[:1] if YES_OR_NO[value.lower()] else self.secondary_opts[:1]

    def assigned(self, value: object) -> str:
        """NAME=VALUE."""
        return f"{self.key}={('no', 'yes')[value] if isinstance(value, bool) else value}"

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """What the help says of it."""
        other = "no" if self.default is True else "yes"
        return f"{self.key}={other if self.is_flag else self.make_metavar(ctx)}", self.help or ""


YES_OR_NO = {**dict.fromkeys(("yes", "true", "on", "1"), True), **dict.fromkeys(("no", "false", "off", "0"), False)}
"""Values of settings that are flags."""

setting = partial(option, cls=Setting)
"""Adds a setting, written as an option is."""


def loudness(function: F) -> F:
    """Add --quiet and --verbose; they work before and after a command's name."""
    verbose = option("-v --verbose", "Print more: what is read, and when.")
    return option("-q --quiet", "Print errors only.")(verbose(function))


as_object = option("--json", "Print the summary as one JSON object on standard output.", name="as_json")
"""Adds --json; it works before and after a command's name."""


def section(title: str) -> Callable[[Action], Action]:
    """Show the options below, down to those of the next section, under this title in the help."""

    def mark(function: Action) -> Action:
        for option in getattr(function, "__click_params__", ()):
            vars(option).setdefault("title", title)
        return function

    return mark


def given(form: str, text: str, kind: Any = None, *, title: str = "", **more: Any) -> Any:
    """The field of a dataclass that holds the value of an option, as `option` declares it; with a `title`, it is the
    first one of a section.
    """
    return dataclasses.field(metadata={"option": partial(option, form, text, kind, **more), "title": title})


tuned = partial(given, cls=Setting)
"""The field that holds the value of a setting."""


def gathered(name: str, kind: type[Any], *options: Callable[[Any], Any]) -> Callable[[Action], Action]:
    """Give a command one argument in the place of several, whose names are those of the fields of a dataclass; add the
    options that the fields declare, and others.
    """
    fields = dataclasses.fields(kind)
    declared = [(each.metadata["option"](name=each.name), each.metadata["title"]) for each in fields if each.metadata]

    def decorate(function: Action) -> Action:
        @wraps(function)
        def run(**rest: Any) -> int | None:
            own = {each.name: rest.pop(each.name) for each in fields if each.name in rest}
            return function(**rest, **{name: kind(**own)})

        made: Action = run
        for add, title in reversed([*declared, *((each, "") for each in options)]):
            made = section(title)(add(made)) if title else add(made)
        return made

    return decorate


def standard_command(name: str) -> Callable[[Action], click.Command]:
    """A command with the options that every command has; its function receives a `console` for its messages."""

    def decorate(function: Action) -> click.Command:
        if any(isinstance(each, Setting) for each in getattr(function, "__click_params__", ())):
            text = "Tune a setting; --help-all lists them." if name in EVERY_DAY else "Tune a setting."
            more = option("--set NAME=VALUE", f"{text} May be repeated.", name="settings", expose_value=False)
            function = section(SETTINGS)(more(function))

        @wraps(function)
        def speaking(quiet: bool, verbose: bool, as_json: bool, **arguments: Any) -> int | None:
            context = click.get_current_context()
            before: dict[str, bool] = context.obj or {}
            known = {each for one in context.command.get_params(context) for each in one.opts}
            Printed.begin(name, streams(arguments), known, as_json or before.get("as_json", False))
            check_places(name, arguments)
            data = Printed.elsewhere or Printed.as_json
            console = Console(quiet or before.get("quiet", False), verbose or before.get("verbose", False), data)
            return function(**arguments, console=console)

        made = loudness(click.version_option(__version__, prog_name="clothfit")(speaking))
        made = as_object(made)
        made = help_all(made) if name in EVERY_DAY else made
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

SETTINGS = "Settings, as --set NAME=VALUE"
LAST = "Common options"
"""Titles of the last sections."""

EVERY_DAY = {
    "estimate": (
        "--target", "--hold", "--bind", "--fps", "--frames", "--scale", "--up", "--fit", "--model", "--start",
        "--budget", "--holdout", "--output", "--in-place", "--cache", "--report", "--resume", "--set",
    ),
    "new": (
        "--cloth", "--collider", "--size", "--divisions", "--scale", "--up", "--weld", "--density", "--stiffness",
        "--fix-side", "--fix-vertices", "--pins-from", "--wind", "--sphere", "--layers", "--fit", "--fps", "--output",
        "--set",
    ),
}  # fmt: skip
"""Commands with many options, to those that `--help` shows; the others are in `--help-all`."""

ROOM = 52  # columns of an option's help of one line
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
            common = option.name in COMMON or option.opts[-1].startswith("--help")
            title = SETTINGS if isinstance(option, Setting) else vars(option).get("title", "Options")
            found.setdefault(LAST if common else title, []).append(option)
    return dict(sorted(found.items(), key=lambda each: {SETTINGS: 1, LAST: 2}.get(each[0], 0)))


def daily_only(command: click.Command, context: click.Context) -> bool:
    """Whether the help shows the options of every day only."""
    return command.name in EVERY_DAY and not context.meta.get(EVERY)


def brief(text: str) -> str:
    """The first sentence of an option's help, with its default where there is room."""
    main, gap, default = text.partition("  [")
    first = f"{main.partition('. ')[0].rstrip('.')}."
    whole = first + gap + default
    return whole if len(whole) <= ROOM else first


class ExamplesFirst(click.Command):
    """A command whose help shows its examples first, and its options in sections; `params` has no settings."""

    def __init__(self, *given: Any, **more: Any) -> None:
        super().__init__(*given, **more)
        self.settings = {each.key: each for each in self.params if isinstance(each, Setting)}
        self.params = [each for each in self.params if not isinstance(each, Setting)]

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """All that may be given."""
        return [*super().get_params(ctx), *self.settings.values()]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse a command line, with each `--set NAME=VALUE` as the option of that name."""
        words, made = iter(args), list[str]()
        for word in words:
            option, equals, value = word.partition("=")
            if word == "--":
                made += [word, *words]
            elif option != "--set" or not self.settings:
                made.append(word)
            else:
                text = value if equals else next(words, None)
                made += [word] if text is None else self.set_words(text, ctx)
        return super().parse_args(ctx, made)

    def set_words(self, text: str, ctx: click.Context) -> list[str]:
        """The words that NAME=VALUE stands for. Raises UsageError where nothing has that name."""
        name, equals, value = text.partition("=")
        own = self.settings.get(name.replace("-", "_"))
        if own is not None and equals:
            return own.words(value)
        if ctx.resilient_parsing:
            return []
        if own is not None:
            raise click.UsageError(f"--set {name}: write its value too, as in {own.key}=…", ctx)
        if f"--{name}" in {option for each in self.params for option in each.opts}:
            raise click.UsageError(f"--set {name}: this is an option of its own, --{name}", ctx)
        raise click.UsageError(f"--set: there is no {name!r}{meant(name, tuple(self.settings))}", ctx)

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
        if text.rest and not daily_only(self, ctx):
            formatter.write_paragraph()
            with formatter.indentation():
                formatter.write_text("\n\n".join(text.rest))

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, a section each: all, or those of every day."""
        daily = EVERY_DAY[str(self.name)] if daily_only(self, ctx) else ()
        found = sections(self, ctx)
        if daily:
            known = {name: each for each in self.params for name in each.opts}
            found = {"Options": [known[name] for name in daily], LAST: found[LAST]}
        for title, options in found.items():
            records = [record for option in options if (record := option.get_help_record(ctx)) is not None]
            with formatter.section(title):
                formatter.write_dl([(names, brief(text)) for names, text in records] if daily else records)


EVERY = "clothfit.every option"
"""Where a context says that all options are to be shown."""


def help_all(function: F) -> F:
    """Add --help-all."""

    def show(context: click.Context, parameter: click.Parameter, value: bool) -> None:
        if value and not context.resilient_parsing:
            context.meta[EVERY] = True
            click.echo(context.get_help(), color=context.color)
            context.exit()

    text = "Show all options and settings."
    return option("--help-all", text, is_eager=True, expose_value=False, callback=show)(function)


def complete_values(command: click.Command) -> click.Command:
    """The command, with what its options know completed, and files where a value's name says that it is one."""
    settings = getattr(command, "settings", {})
    for parameter in (*command.params, *settings.values()):
        words = set(re.findall(r"[A-Z]+", parameter.metavar or ""))
        keys = [*parameter.opts, *sorted(words)]
        values = next((VALUES[key] for key in keys if key in VALUES), ())
        suffixes = next((SUFFIXES[key] for key in keys if key in SUFFIXES), None)
        if suffixes is None and FILE_NAMES & words and not values:
            suffixes = ()
        if parameter.type is click.STRING and (values or suffixes is not None):
            parameter.type = Known(values, suffixes)
        if parameter.name == "settings":
            parameter.type = Assignment(settings)
    return command


def slip(error: click.UsageError) -> str:
    """The error's sentence, without its full stop, on one line; with what was probably meant, where something was."""
    context, message = error.ctx, error.format_message()
    if context is not None and isinstance(error, click.NoSuchOption):
        options = [name for option in context.command.get_params(context) for name in option.opts]
        known = [name for name in options if name.startswith("-")]
        message = error.message.rstrip(".") + wanted(error.option_name, known)
    elif context is not None and isinstance(error, click.exceptions.NoSuchCommand):
        known = context.command.list_commands(context) if isinstance(context.command, click.Group) else []
        message = error.message.rstrip(".") + wanted(error.command_name, known)
    message = " ".join(message.split()).rstrip(".").replace("is not a valid float", "is not a number, such as 0.01")
    return f"{message[:1].lower()}{message[1:]}"


OTHER_WORDS = {
    **dict.fromkeys(("fit", "train", "optimise", "optimize", "calibrate"), "estimate"), "run": "simulate",
    **dict.fromkeys(("render", "plot", "view", "show", "play"), "report"),
    **dict.fromkeys(("import", "create", "make", "init", "load"), "new"),
    **dict.fromkeys(("--fix", "--hold", "--pin-side"), "--fix-side"),
    **dict.fromkeys(("--pin", "--pins", "--fixed", "--pinned"), "--fix-vertices"),
    **dict.fromkeys(("--time", "--timeout", "--time-limit"), "--budget"),
    **dict.fromkeys(("--frames", "--length"), "--steps"),
    **dict.fromkeys(("--unit", "--units"), "--scale"), **dict.fromkeys(("--axis", "--axes"), "--up"),
    "--mass": "--density", "--mesh": "--cloth", "--motion": "--target",
}  # fmt: skip
"""Commands and options by what other programs call them."""


def wanted(word: str, known: Sequence[str]) -> str:
    """Asks about the name that was probably meant by a word that is none."""
    other = OTHER_WORDS.get(word.lower())
    return f"; did you mean {other}?" if other in known else meant(word, known)


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


# ---- What a shell may complete: the values that options know, and files by the suffixes of what they take.
#
# The values are written down here, as asking the modules that own them would load NumPy at every key; a test compares
# them. Where no file has a likely suffix, all files are named.

KINDS = (
    "mass", "stiffness", "damping", "drag", "velocity", "rest", "path", "shift", "wind", "gravity", "gusts", "friction",
    "contact", "offset",
)  # fmt: skip
NOT_OF_NEW = ("path", "shift", "gusts", "friction", "contact", "offset")  # of what a new scene does not have
SIDES = ("left", "right", "bottom", "top", "back", "front")
LETTERS = ("n", "F", "R", "M", "G", "L")

VALUES = {
    "--method": (
        "auto", "momentum", "gauss-newton", "l-bfgs-b", "tnc", "slsqp", "trust-constr", "bfgs", "cg", "nelder-mead",
        "powell", "cobyla",
    ),
    "--objective": ("position", "velocity", "edge-length", "spectrum", "outline", "coverage"),
    "--loss": ("linear", "soft_l1", "huber"),
    "--model": ("auto", "F", "G", "R", "M", "L"),
    "--holdout-of": ("frames", "vertices"),
    "--prior": ("auto", "none"),
    "--substeps": ("auto",),
    "--bounds": tuple(f"{kind}=" for kind in KINDS),
    "--fix-side": SIDES,
    "--integrator": ("explicit", "symplectic", "implicit", "bdf2", "rest"),
    "--drag": ("air",),
    "--fit": (
        *(f"n{letter}" for letter in LETTERS), *(f"{letter}n" for letter in LETTERS[1:]), "GG", "LL",
        *(kind for kind in KINDS[2:] if kind not in NOT_OF_NEW),
    ),
}
"""Options to the values that they know; others may take more."""

MOTIONS = (*registry.NATIVE, *(suffix for each in registry.FORMATS for suffix in each.suffixes))
MESHES = (".obj", ".glb", ".gltf", ".ply", ".stl", ".abc", ".usd", ".usda", ".usdc")
SCENES = (".json", ".txt")
SUFFIXES = {
    "SCENE": SCENES, "FITTED": SCENES, "MOTION": MOTIONS, "MESH": MESHES, "IN": MOTIONS, "OUT": MOTIONS,
    "--map": (".csv",), "--log": (".jsonl",), "--mesh": MESHES, "--plot": (".png", ".svg", ".pdf"), "--gif": (".gif",),
    "--dump": (".npz",), "--report": (".html",), "--checkpoint": (".checkpoint",),
}  # fmt: skip
"""Words in the name of a value, and options, to the suffixes of their files; others take any."""

MOST = 1000  # names that are given to a shell


class Assignment(click.types.StringParamType):
    """NAME=VALUE of a setting, for which a shell may offer the names, then the values."""

    def __init__(self, settings: Mapping[str, Setting]) -> None:
        self.settings = settings

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Whatever begins as the word that is not complete yet."""
        from click.shell_completion import CompletionItem

        name, equals, value = incomplete.partition("=")
        if not equals:
            return [CompletionItem(f"{each}=") for each in self.settings if each.startswith(name)]
        own = self.settings.get(name)
        items = own.type.shell_complete(ctx, own, value) if own else []
        return [CompletionItem(f"{name}={item.value}", item.type) for item in items]


class Known(click.types.StringParamType):
    """A text for which a shell may offer some values and files."""

    def __init__(self, values: Sequence[str] = (), suffixes: Sequence[str] | None = None) -> None:
        self.values, self.suffixes = values, suffixes  # None: no files; empty: all

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Whatever begins as the word that is not complete yet."""
        from click.shell_completion import CompletionItem

        found = [CompletionItem(value) for value in self.values if value.startswith(incomplete)]
        if self.suffixes is not None:
            found += [CompletionItem(path, type="path") for path in paths(incomplete, self.suffixes)]
        return found


def paths(incomplete: str, suffixes: Sequence[str]) -> list[str]:
    """The folders, with a slash, and the files with one of the suffixes (all, where there are none) that begin so."""
    folder, begin = os.path.split(incomplete)
    try:
        with os.scandir(os.path.expanduser(folder) or ".") as entries:
            found = sorted(
                (each.name, each.is_dir()) for each in entries
                if each.name.startswith(begin) and (begin or not each.name.startswith("."))
            )  # fmt: skip
    except OSError:
        return []
    likely = [(name, is_folder) for name, is_folder in found if is_folder or name.lower().endswith(tuple(suffixes))]
    shown = likely if any(not is_folder for _, is_folder in likely) else found
    return [os.path.join(folder, name) + "/" * is_folder for name, is_folder in shown][:MOST]


# ---- Files in the wrong place: what they are, and which option or command takes them.

MOVING = (registry.MOTION, registry.MESH, registry.EITHER)
PLACES = {
    "scene_path": (registry.SCENE,), "scene_paths": (registry.SCENE,),
    "fitted_path": (registry.SCENE, registry.SUBSPACE), "start": (registry.SCENE,),
    "target_path": MOVING, "target_paths": MOVING, "in_path": MOVING, "cloth_path": (registry.MESH, registry.EITHER),
    "log_paths": (registry.LOG,), "subspace_path": (registry.SCENE, registry.SUBSPACE, registry.RECORDED),
    "inputs_path": (registry.SCENE,), "mesh_path": MOVING,
}  # fmt: skip
"""Parameters of commands that are files to read, and the kinds that they take."""

WITH_FORCES = ("simulate", "target", "estimate", "evaluate", "report", "check")
WITH_TARGET = ("estimate", "evaluate", "report", "check")
ANY = ("info", "completion", "warmup")  # commands that take any file, or none


def check_places(command: str, arguments: Mapping[str, Any]) -> None:
    """Raise InvalidInput at the first file that is recognised as something else than its place takes."""
    if command in ANY:
        return
    for name, taken in PLACES.items():
        value = arguments.get(name)
        paths = value if isinstance(value, tuple) else (value,)
        if command == "validate" and len(paths) > 1:
            continue  # each gets a line of its own
        for path in paths:
            kind = None if path is None else registry.kind_of(str(path))
            if kind is not None and kind not in taken:
                article = "an" if kind[0] in "aeiou" else "a"
                raise InvalidInput(f"{path} is {article} {kind}; {advice(kind, command, taken)}")


def advice(kind: str, command: str, taken: tuple[str, ...]) -> str:
    """What to do with a file of that kind where others are taken."""
    if kind in (registry.MOTION, registry.EITHER) and registry.SCENE in taken and command in WITH_TARGET:
        return "did you mean --target?" if kind == registry.MOTION else "did you mean --target, or clothfit new?"
    if kind == registry.SCENE and registry.MESH in taken and registry.MOTION not in taken:
        return "did you mean clothfit info?"
    if kind == registry.SCENE and command == "convert":
        return "for its motion: clothfit simulate SCENE -o MOTION; for its faces: --scene SCENE"
    resumed = "--checkpoint, with" if command == "estimate" else "clothfit estimate"
    forced = "--forces" if command in WITH_FORCES else "clothfit info, or simulate --forces"
    converted = "did you mean clothfit info, or clothfit convert?"
    known = {
        registry.SCENE: "did you mean SCENE, or to record its motion with clothfit target?",
        registry.MOTION: converted if registry.SCENE in taken else "it has no faces; did you mean estimate --target?",
        registry.MESH: "did you mean clothfit new?",
        registry.EITHER: "did you mean clothfit new?",
        registry.CHECKPOINT: f"did you mean {resumed} --resume?",
        registry.LOG: "did you mean --log?" if command == "report" else "did you mean clothfit report --log?",
        registry.MAP: "did you mean --map?",
        registry.PAGE: "open it in a browser",
        registry.FORCES: f"did you mean {forced}?",
        registry.EXPORT: "name the scene that it was made of",
        registry.SUBSPACE: "did you mean clothfit subspace play, or clothfit evaluate SCENE MODEL?",
        registry.RECORDED: "did you mean clothfit subspace build?",
    }
    return known[kind]
