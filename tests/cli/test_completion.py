"""Completion: what the shells are given, in this process, through the environment, and in a real bash."""

import os
import shutil
import stat
import subprocess
import sys

import click
import pytest
from click.shell_completion import get_completion_class
from helpers.scenes import environment

from clothfit.cli.common import options as values
from clothfit.cli.program import COMMANDS, group

pytestmark = pytest.mark.slow  # starts processes

VARIABLE = "_CLOTHFIT_COMPLETE"


def completed(line):
    """What completes the last word of a command line: pairs of its type and value."""
    machinery = get_completion_class("bash")(group, {}, "clothfit", VARIABLE)
    *words, last = line.split(" ")
    return [(item.type, item.value) for item in machinery.get_completions(words[1:], last)]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_of_a_command_completes(command):
    made = group.get_command(None, command)
    long = {name for option in made.params for name in option.opts if name.startswith("--")}
    assert {value for _, value in completed(f"clothfit {command} --")} == {*long, "--help"}


def params(command):
    """All that a command takes."""
    made = group.get_command(None, command)
    return made.get_params(click.Context(made))


@pytest.fixture
def files(here):
    """Files of some kinds."""
    for name in ("cape.json", "cape.pc2", "cape.npz", "cape.obj", "cape.csv", "cape.txt", "cape note.md", ".cape.json"):
        (here / name).touch()
    (here / "capes").mkdir()
    (here / "capes" / "own.jsonl").touch()


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("simulate ca", ["cape.json", "cape.txt", "capes/"]),
        ("evaluate a.json ca", ["cape.json", "cape.txt", "capes/"]),
        ("estimate a.json --target ca", ["cape.csv", "cape.npz", "cape.obj", "cape.pc2", "capes/"]),
        ("convert ca", ["cape.csv", "cape.npz", "cape.obj", "cape.pc2", "capes/"]),
        ("estimate a.json --map ca", ["cape.csv", "capes/"]),
        ("new ca", ["cape.obj", "capes/"]),
        ("report a.json b.json --log capes/", ["capes/own.jsonl"]),
        ("estimate a.json --start cape.", ["cape.json", "cape.txt"]),
        ("simulate cape.pc", ["cape.pc2"]),  # nothing likely: all
        ("simulate .ca", [".cape.json"]),
        ("simulate absent/", []),
        ("info cape.", ["cape.csv", "cape.json", "cape.npz", "cape.obj", "cape.pc2", "cape.txt"]),
    ],
)
def test_files_complete_by_their_suffixes(line, found):
    assert completed(f"clothfit {line}") == [("path", name) for name in found]


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("estimate a.json --target b.npz --hold", ["--hold", "--holdout"]),
        ("estimate a.json --method g", ["gauss-newton"]),
        ("estimate a.json --objective ", ["position", "velocity", "edge-length", "spectrum", "outline", "coverage"]),
        ("estimate a.json --loss h", ["huber"]),
        ("estimate a.json --set lo", ["loss=", "loss_scale="]),
        ("estimate a.json --set loss=h", ["loss=huber"]),
        ("estimate a.json --model a", ["auto"]),
        ("estimate a.json --bounds st", ["stiffness="]),
        ("estimate a.json --up ", ["y", "z"]),
        ("new plane --fix-side b", ["bottom", "back"]),
        ("new plane --integrator s", ["symplectic"]),
        ("new plane --fit g", ["gravity"]),
        ("export a.json --to ob", ["obi"]),
        ("simulate a.json --steps ", []),  # no files
        ("estimate a.json --memory ", []),
        ("completion ", ["bash", "zsh", "fish"]),
        ("est", ["estimate"]),
        ("", list(COMMANDS)),
    ],
)
def test_values_complete(line, found):
    assert completed(f"clothfit {line}") == [("plain", value) for value in found]


def test_the_values_are_those_that_commands_take():
    from clothfit.fit.options import HOLDOUTS, MODELS, OWN_METHODS
    from clothfit.meshes.mesh import MESHES
    from clothfit.meshes.new_scene import SIDES
    from clothfit.objective.comparison import LOSSES, OBJECTIVES
    from clothfit.optimise.scipy_methods import METHODS
    from clothfit.scene.kinds import INTEGRATORS, KINDS

    own = values.VALUES
    assert (own["--method"], own["--objective"]) == ((*OWN_METHODS, *METHODS), tuple(OBJECTIVES))
    assert (own["--loss"], own["--integrator"], own["--holdout-of"]) == (LOSSES, INTEGRATORS, HOLDOUTS)
    assert (set(own["--model"]), set(values.SIDES), values.MESHES) == (set(MODELS), set(SIDES), MESHES)
    assert tuple(kind.name for kind in KINDS) == values.KINDS
    known = {name for command in COMMANDS for option in params(command) for name in option.opts}
    assert {name for name in (*values.VALUES, *values.SUFFIXES) if name.startswith("--")} <= known


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_a_shell_asks_the_program(said, shell):
    code, out, err = said(f"completion {shell}")
    assert (code, err, f"{VARIABLE}={shell}_complete" in out, "%(" in out) == (0, "", True, False)


@pytest.fixture
def path(tmp_path, files):
    """The variable PATH with the program in front."""
    folder = tmp_path / "capes"
    program = folder / "clothfit"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m clothfit "$@"\n', "utf-8")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return f"{folder}:{os.environ['PATH']}"


def there(shell):
    """A mark that skips a test where that shell is not installed."""
    return pytest.mark.skipif(shutil.which(shell) is None, reason=f"there is no {shell}")


WORDS = [
    ("estimate --in-", ["--in-place"]),
    ("estimate a.json --method gau", ["gauss-newton"]),
    ("new plane --fix-side b", ["bottom", "back"]),
    ("estimate a.json --target cape.p", ["cape.pc2"]),
    ("simulate ca", ["cape.json", "cape.txt", "capes/"]),
    ("estimate a.json --bounds st", ["stiffness="]),
    ("estimate a.json --set loss = h", ["huber"]),  # as bash takes it apart
]


@there("bash")
def test_a_bash_completes(path):
    script = 'eval "$(clothfit completion bash)"; complete -p clothfit\n'
    for line, _ in WORDS:
        script += f"""
            COMP_WORDS=(clothfit {line}) COMP_CWORD={len(line.split())} COMPREPLY=()
            _clothfit_completion clothfit
            printf '%s\\n' "${{COMPREPLY[@]}}"
        """
    call = ["bash", "--norc", "-c", script]
    done = subprocess.run(call, capture_output=True, text=True, env=environment(PATH=path), check=True)
    found = [word for _, words in WORDS for word in words]
    assert done.stdout.splitlines() == ["complete -o nosort -F _clothfit_completion clothfit", *found]
