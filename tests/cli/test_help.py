"""Help: examples first, 80 columns, sections."""

import re
import shlex
import subprocess
import sys

import click
import pytest
from helpers.scenes import environment, trial, write_scene

from clothfit import __version__
from clothfit.cli.common.options import EVERY_DAY, parts, sections, wrapped
from clothfit.cli.program import COMMANDS, group

pytestmark = pytest.mark.slow  # compiles a fit

PAGES = [[], *[[name] for name in COMMANDS]]


@pytest.mark.parametrize("command", PAGES)
def test_a_page_has_examples_before_all_but_a_sentence_in_80_columns(said, command):
    options = ("-h", "--help", "--version")
    (code, short, _), (_, shown, _), version = (said(" ".join(command), [option]) for option in options)
    usage, what, examples, *rest = shown.split("\n\n")
    assert (code, short) == (0, shown)
    assert usage.startswith(" ".join(["Usage: clothfit", *command]))
    assert what.strip().endswith(".")
    others = {"new": " plane", "convert": " scene.motion.npz", "subspace": " build"}
    bare = not command or command[0] in ("completion", "export", "fabrics", "warmup")
    assert examples.startswith("Examples:\n  ")  # to copy
    copied = "".join(each + others.get(each, "" if bare else " scene.json") for each in command)
    assert f"\n  clothfit {copied}" in shown
    assert any(part.startswith(("Options:", "Common options:")) for part in rest)
    for option in ("--json", "-q, --quiet", "-v, --verbose", "--version", "-h, --help"):
        assert option in shown
    assert max(map(len, shown.splitlines())) <= 80
    assert version == (0, f"clothfit, version {__version__}\n", "")


def test_the_group_lists_the_commands_in_the_order_of_a_working_day(said):
    shown = [line.split()[0] for line in said("")[1].split("\n\nCommands:")[1].splitlines() if line.strip()]
    day = (
        "new fabrics info validate simulate target estimate transfer control subspace evaluate report serve check "
        "convert export completion warmup"
    )
    assert shown == list(COMMANDS) == day.split()


@pytest.mark.parametrize(
    ("arguments", "unwanted"),
    [
        ("", "numba scipy numpy rich jsonschema"), ("estimate --help", "numba scipy numpy rich jsonschema joblib"),
        ("validate {}", "numba scipy.linalg scipy.sparse"), ("info {}", "numba scipy.linalg scipy.sparse"),
        ("estimate none.json", "joblib"), ("zsh_complete", "numba scipy numpy rich jsonschema"),
    ],
)  # fmt: skip
def test_a_command_is_quick_because_it_loads_no_library_that_it_does_not_need(tmp_path, arguments, unwanted):
    asked = arguments.format(write_scene(tmp_path, trial("nG", 5))).split()
    completes = {"_CLOTHFIT_COMPLETE": "zsh_complete", "COMP_WORDS": "clothfit estimate --re", "COMP_CWORD": "2"}
    changes, words = (completes, []) if asked == ["zsh_complete"] else ({}, asked)
    call = [sys.executable, "-X", "importtime", "-m", "clothfit", *words]
    done = subprocess.run(call, capture_output=True, text=True, env=environment(**changes), check=False)
    loaded = {line.rsplit("|", 1)[-1].strip() for line in done.stderr.splitlines()}
    assert "clothfit.cli" in loaded
    assert not loaded & set(unwanted.split())
    assert not changes or "plain\n--resume\n" in done.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_is_explained_and_in_one_section_and_every_section_has_options(command):
    made = group.get_command(None, command)
    context = click.Context(made, info_name=command, **made.context_settings)  # click keeps the first help option
    titles = sections(made, context)
    placed = [option.name for options in titles.values() for option in options]
    wanted = [option.name for option in made.get_params(context) if option.param_type_name == "option"]
    assert sorted(placed) == sorted(wanted)
    assert list(titles)[-1] == "Common options"
    assert all(option.help for option in made.params if option.param_type_name != "argument")


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
    assert list(wrapped("clothfit" + "x" * 90)) == ["clothfit" + "x" * 90]


@pytest.mark.parametrize("command", EVERY_DAY)
def test_help_shows_the_options_of_every_day_and_help_all_shows_all(said, command):
    short, whole = (said(f"{command} {each}")[1] for each in ("--help", "--help-all"))
    every = {name for each in group.get_command(None, command).params for name in each.opts if name[:2] == "--"}
    assert {*EVERY_DAY[command]} <= every
    listed = "".join(re.findall(r"^(?!Examples)[A-Z][^\n.]*:\n((?:  .*\n)+)", short, re.MULTILINE))
    shown = {name for name in every if re.search(rf"^  (-\w, )?{name}\b(?!-)", listed, re.MULTILINE)}
    assert shown - {"--help", "--help-all", "--json", "--quiet", "--verbose", "--version"} == {*EVERY_DAY[command]}
    assert all(name in whole for name in every)
