"""Completion: what the shells are given, in this process, through the environment, and in a real bash."""

import shutil
import stat
import subprocess
import sys

import pytest
from click.shell_completion import get_completion_class
from helpers.scenes import environment

from clothfit.cli.program import COMMANDS, group, run

pytestmark = pytest.mark.slow  # starts processes

VARIABLE = "_CLOTHFIT_COMPLETE"


def completed(line):
    """What completes the last word of a command line: pairs of its type and value."""
    machinery = get_completion_class("bash")(group, {}, "clothfit", VARIABLE)
    *words, last = line.split(" ")
    return [(item.type, item.value) for item in machinery.get_completions(words[1:], last)]


def test_commands_complete_in_their_order():
    assert [value for _, value in completed("clothfit ")] == list(COMMANDS)
    assert completed("clothfit est") == [("plain", "estimate")]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_of_a_command_completes(command):
    made = group.get_command(None, command)
    long = {name for option in made.params for name in option.opts if name.startswith("--")}
    assert {value for _, value in completed(f"clothfit {command} --")} == {*long, "--help"}


def test_an_option_completes_after_others():
    assert completed("clothfit estimate a.json --target b.npz --hold") == [
        ("plain", "--holdout"), ("plain", "--holdout-of"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    "line",
    ["simulate sc", "evaluate a.json fi", "estimate a.json b", "estimate a.json --target ca", "simulate a.json -o mo"],
)
def test_names_of_files_are_left_to_the_shell(line):
    word = line.split()[-1]
    assert completed(f"clothfit {line}") == [("file", word)]


@pytest.mark.parametrize("line", ["simulate a.json --steps ", "estimate a.json --memory "])
def test_numbers_and_sizes_are_not_files(line):
    assert completed(f"clothfit {line}") == []


def test_the_names_of_the_shells_complete():
    assert completed("clothfit completion ") == [("plain", "bash"), ("plain", "zsh"), ("plain", "fish")]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_a_shell_asks_the_program(capsys, shell):
    assert run(["completion", shell]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert f"{VARIABLE}={shell}_complete" in out
    assert "%(" not in out


def test_completing_is_quick_because_it_loads_no_numerical_library():
    asked = environment(**{VARIABLE: "zsh_complete", "COMP_WORDS": "clothfit estimate --re", "COMP_CWORD": "2"})
    call = [sys.executable, "-X", "importtime", "-m", "clothfit"]
    done = subprocess.run(call, capture_output=True, text=True, env=asked, check=True)
    assert done.stdout.split("\n")[:2] == ["plain", "--resume"]
    loaded = {line.rsplit("|", 1)[-1].strip() for line in done.stderr.splitlines()}
    assert "clothfit.cli" in loaded
    assert not loaded & {"numba", "scipy", "numpy", "rich", "jsonschema"}


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_a_bash_completes(tmp_path):
    program = tmp_path / "clothfit"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m clothfit "$@"\n', "utf-8")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    script = f"""
        PATH="{tmp_path}:$PATH"
        eval "$(clothfit completion bash)"
        complete -p clothfit
        COMP_WORDS=(clothfit estimate --no) COMP_CWORD=2 COMPREPLY=()
        _clothfit_completion clothfit
        echo "${{COMPREPLY[*]}}"
    """
    call = ["bash", "--norc", "-c", script]
    done = subprocess.run(call, capture_output=True, text=True, env=environment(), check=True)
    assert done.stdout.splitlines() == ["complete -o nosort -F _clothfit_completion clothfit", "--no-intervals"]
