"""Help: examples first, 80 columns, sections; slips of the pen are answered with what was meant."""

import shlex

import click
import pytest

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import meant
from clothfit.cli.common.options import parts, sections, wrapped
from clothfit.cli.program import COMMANDS, group, run
from clothfit.fit.options import check_method
from clothfit.objective.comparison import loss_named, objective_weights

pytestmark = pytest.mark.slow  # compiles a fit

PAGES = [[], *[[name] for name in COMMANDS]]


def shown(capsys, *arguments):
    """The help of a command."""
    assert run([*arguments, "--help"]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("command", PAGES)
def test_examples_come_before_everything_but_a_sentence(capsys, command):
    usage, what, examples, *rest = shown(capsys, *command).split("\n\n")
    assert usage.startswith("Usage: ")
    assert what.strip().endswith(".")
    assert examples.startswith("Examples:\n  ")
    assert "clothfit " in examples
    assert any(part.startswith(("Options:", "Common options:")) for part in rest)


@pytest.mark.parametrize("command", PAGES)
def test_help_fits_into_80_columns(capsys, command):
    assert max(map(len, shown(capsys, *command).splitlines())) <= 80


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_is_in_one_section_and_every_section_has_options(command):
    made = group.get_command(None, command)
    context = click.Context(made, info_name=command)
    titles = sections(made, context)
    placed = [option.name for options in titles.values() for option in options]
    wanted = [option.name for option in made.get_params(context) if option.param_type_name == "option"]
    assert sorted(placed) == sorted(wanted)
    assert list(titles)[-1] == "Common options"
    named = [name for names in made.sections.values() for name in names]
    assert set(named) <= {name for option in made.params for name in option.opts}
    assert len(set(named)) == len(named)


def test_the_parts_of_a_help_text():
    text = parts("Do it.\n\n  More,\n  and more.\n\n  \b\n  A=b clothfit x\n  clothfit y\n\n  \b\n  left right\n")
    assert text.summary == "Do it."
    assert text.examples == ("A=b clothfit x", "clothfit y")
    assert text.rest == ("More,\nand more.", "\b\nleft right")


@pytest.mark.parametrize("width", [20, 30, 60])
@pytest.mark.parametrize("line", ["clothfit estimate a.json --target b.npz --rmse 1e-6 -o c", "clothfit a" + " b" * 50])
def test_a_long_example_is_broken_where_a_shell_joins_it_again(line, width):
    pieces = list(wrapped(line, width))
    assert max(map(len, pieces)) <= width
    joined = "\n".join(pieces).replace("\\\n", "")
    assert shlex.split(joined) == shlex.split(line)


def test_what_cannot_be_broken_stays_as_it_is():
    assert list(wrapped("clothfit" + "x" * 90)) == ["clothfit" + "x" * 90]


# --- slips of the pen


@pytest.mark.parametrize(
    ("wrong", "names", "told"),
    [
        ("lbfgsb", ("auto", "l-bfgs-b"), "; did you mean l-bfgs-b?"),
        ("Huber", ("linear", "huber"), "; did you mean huber?"),
        ("edge", ("position", "edge-length"), "; did you mean edge-length?"),
        ("--rsme", ("--resume", "--rmse"), "; did you mean --rmse?"),
        ("magic", ("auto", "l-bfgs-b"), ""),
        ("", ("auto",), ""),
    ],
)
def test_what_was_meant(wrong, names, told):
    assert meant(wrong, names) == told


@pytest.mark.parametrize(
    ("check", "wrong", "told"),
    [
        (check_method, "gauss", "gauss-newton"),
        (loss_named, "hubr", "huber"),
        (objective_weights, "postion", "position"),
    ],
)
def test_a_mistyped_name_of_a_method_is_answered_too(check, wrong, told):
    with pytest.raises(InvalidInput, match=rf"; did you mean {told}\?$"):
        check(wrong)
