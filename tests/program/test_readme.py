"""What the README and the pages of docs/ show is what happens: their commands, the output, the README's Python."""

import io
import json
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout, suppress

import click
import pytest
from helpers.paths import ROOT

import clothfit
from clothfit.cli.program import group, run

CUT = "[…]"
BEST = "Pareto-best"
METRES = {"nm": 1e-9, "µm": 1e-6, "mm": 1e-3, "m": 1.0}
PAGES = {path.name: path.read_text("utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}
PAGES = {"first": (ROOT / "README.md").read_text("utf-8"), **PAGES}
SHOWN = re.compile(r"^\$ clothfit (.*)\n((?:(?!\$).*\n)*)", re.MULTILINE)  # a command and what it prints

pytestmark = pytest.mark.slow


def blocks(language, page="first"):
    """The code blocks of one language on a page, with commands that are broken into lines in one."""
    return re.findall(rf"^```{language}\n(.*?)^```", PAGES[page].replace(" \\\n    ", " "), re.DOTALL | re.MULTILINE)


def commands(page):
    """The commands that a page shows, without the program's name, and what it says that they print."""
    return [shown for block in blocks("console", page) for shown in SHOWN.findall(block)]


def shape(text):
    """A text without its numbers, its units of length, its column widths, and what depends on the speed of the machine:
    progress, and which settings are the Pareto-best (`undominated`).
    """
    lines = [line for line in text.splitlines() if not re.match(r" *[\d.]+ s  cost ", line) and line.strip()]
    lines = [re.sub(r"\d[\d.e+-]* (nm|µm|mm|m)\b", "# m", line) for line in lines if "compiling" not in line]
    lines = [re.sub(rf"{BEST}(, )?|(?<=^cheapest within # m: ).*", "", line) for line in lines]
    lines = [re.sub(r" +", " ", re.sub(r"\d[\d.e+-]*", "#", line)).strip() for line in lines]
    ended = [line for line in lines if line.startswith("# of #: ")]  # of scenes fitted at a time, in any order
    return [*sorted(ended), *(line for line in lines if line not in ended)]


def undominated(text):
    """Whether no setting of a table of speeds that is marked as the best is slower and less exact than another."""
    unit = f"({'|'.join(METRES)})"
    found = re.findall(rf"^\w.* ([\d.e-]+) +([\d.e-]+) {unit} +[\d.e-]+ {unit}(.*)$", text, re.MULTILINE)
    rows = [(float(cost), float(error) * METRES[unit], BEST in marks) for cost, error, unit, _, marks in found]
    best = [(cost, error) for cost, error, marked in rows if marked]
    return best != [] and not any(c < cost and e < error for cost, error in best for c, e, _ in rows)


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A folder with the examples, to work in."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def shorten(path, frames):
    """Let a scene end after fewer frames, if the file is one."""
    if path.suffix == ".json":
        path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | {"optimizationIterations": frames}), "utf-8")


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)])
def test_the_commands_of_a_page_print_what_it_says(checkout, page):
    for scene in (checkout / "examples").glob("*.json") if page == "first" else ():
        shorten(scene, 40)  # of the numbers that are printed none counts
    for command, shown in commands(page):
        said = io.StringIO()  # both streams, as a terminal shows them
        with redirect_stdout(said), redirect_stderr(said):
            assert run(shlex.split(command)) == 0
        printed = shape(said.getvalue())
        assert BEST not in shown or (undominated(shown) and undominated(said.getvalue()))
        assert [line for line in shape(shown) if line != CUT and line not in printed] == []
        assert CUT in shown or printed == shape(shown)  # a page may leave out lines that depend on the machine


def test_its_first_command_makes_the_fit_that_its_first_picture_shows(checkout):
    (first,) = blocks("sh")
    fit = first.strip().removeprefix("clothfit ").partition(" --report")[0]
    gallery = (ROOT / "docs" / "gallery.md").read_text("utf-8").replace(" \\\n    ", " ")
    (shown,) = re.findall(r"^```sh\n(python [^`]* shirt\.pc2[^`]*)^```", gallery, re.MULTILINE)
    steps = [line for line in shown.splitlines() if " --gif" not in line]
    assert any(line.startswith(f"clothfit {fit} ") for line in shown.splitlines())
    subprocess.run([sys.executable, *steps[0].split()[1:]], check=True)
    for line in [*steps[1:], first]:
        arguments = shlex.split(line.removeprefix("clothfit "))
        assert run(arguments) == 0
        shorten(checkout / arguments[-1], 25)  # of 100
    assert (checkout / "fit.html").stat().st_size > 200_000
    evaluation = clothfit.evaluate(clothfit.load("theirs.json"), clothfit.load("fitted.json"), horizon=25)
    assert evaluation.fitted.rmse < 1e-4  # the --rmse of the command


@pytest.mark.parametrize("page", PAGES)
def test_the_commands_that_a_page_only_names_are_understood(page):
    shown = [line for block in blocks("sh", page) for line in block.splitlines() if line.startswith("clothfit ")]
    text = re.sub(r"^```.*?^```", "", PAGES[page], flags=re.DOTALL | re.MULTILINE)
    for line in [*shown, *re.findall(r"`(clothfit [a-z]+ [^`]*)`", text)]:
        name, *arguments = shlex.split(line.removeprefix("clothfit "), comments=True)
        command = group.get_command(None, name)
        while isinstance(command, click.Group):
            name, *arguments = arguments
            command = command.get_command(None, name)
        with suppress(click.MissingParameter, click.exceptions.Exit):  # a text may leave out a file, or ask for help
            command.make_context(name, arguments)


def test_its_python_runs(checkout, capsys):
    (block,) = blocks("python")
    exec(block, {})
    status, rmse = capsys.readouterr().out.split()
    assert status == "converged"
    assert float(rmse) <= 1e-6
    assert (checkout / "fitted.json").is_file()


def test_it_shows_all_of_a_day_and_its_two_commands_are_the_targets_of_the_makefile():
    assert {command.split()[0] for command, _ in commands("first")} >= {"simulate", "target", "estimate", "evaluate"}
    (first, *_) = blocks("console")
    targets = re.findall(r"\$ make (\w+)", first)
    assert targets == ["demo", "test"]
    makefile = (ROOT / "Makefile").read_text("utf-8")
    assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in targets)
