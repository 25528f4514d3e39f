"""What the README and the pages of docs/ show is what happens: their commands, the output, the Python."""

import ast
import inspect
import io
import json
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout

import pytest
from helpers.commands import blocks, typed
from helpers.paths import ROOT

import clothfit
from clothfit.cli.program import run

CUT = "[…]"
BEST = "Pareto-best"
METRES = {"nm": 1e-9, "µm": 1e-6, "mm": 1e-3, "m": 1.0}
PAGES = {path.name: path.read_text("utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}
PAGES = {"first": (ROOT / "README.md").read_text("utf-8"), **PAGES}
SHOWN = re.compile(r"^\$ clothfit (.*)\n((?:(?!\$).*\n)*)", re.MULTILINE)  # a command and what it prints

pytestmark = pytest.mark.slow


def commands(page):
    """The commands that a page shows, without the program's name, and what it says that they print."""
    return [shown for block in blocks(PAGES[page], "console") for shown in SHOWN.findall(block)]


def shape(text):
    """A text without its numbers, its units of length, its column widths, and what depends on the machine: progress,
    what is compiled, and which settings are the Pareto-best (`undominated`).
    """
    lines = [line for line in text.splitlines() if not re.match(r" *[\d.]+ s  cost ", line) and line.strip()]
    lines = [re.sub(r"\d[\d.e+-]* (nm|µm|mm|m)\b", "# m", line) for line in lines if not line.startswith("compil")]
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
        shorten(scene, 20)  # of the numbers that are printed none counts
    for command, shown in commands(page):
        said = io.StringIO()  # both streams, as a terminal shows them
        with redirect_stdout(said), redirect_stderr(said):
            assert run(shlex.split(command)) == 0
        printed = shape(said.getvalue())
        assert BEST not in shown or (undominated(shown) and undominated(said.getvalue()))
        assert [line for line in shape(shown) if line != CUT and line not in printed] == []
        assert CUT in shown or printed == shape(shown)  # a page may leave out lines that depend on the machine


def test_the_commands_of_the_gallery_make_the_fit_of_the_first_picture(checkout):
    first = re.search(r"^!\[.*\]\(docs/(.*)\)$", PAGES["first"], re.MULTILINE)[1]
    (shown,) = [block for block in PAGES["gallery.md"].split("\n## ") if f"]({first})" in block]
    make, *lines = [line for line in blocks(shown, "sh")[0].splitlines() if "gif=guess" not in line]
    subprocess.run([sys.executable, *make.split()[1:]], check=True)
    for line in lines:
        arguments = shlex.split(line.removeprefix("clothfit ").partition(" --set gif=")[0])
        assert run(arguments) == 0
        shorten(checkout / arguments[-1], 15)  # of 100
    evaluation = clothfit.evaluate(clothfit.load("theirs.json"), clothfit.load("fitted.json"), horizon=15)
    assert evaluation.fitted.rmse < 1e-4  # the rmse of the command


def test_the_python_of_the_page_on_python_runs(checkout, capsys):
    first, _ = blocks(PAGES["from-python.md"], "python")  # the other one is a cost of one's own, which has its test
    exec(first, {})
    status, rmse = capsys.readouterr().out.split()
    assert status == "converged"
    assert float(rmse) <= 1e-6
    assert (checkout / "fitted.json").is_file()


def test_the_names_and_arguments_in_the_rest_of_its_python_are_there():
    for node in ast.walk(ast.parse("".join(blocks(PAGES["from-python.md"], "py")))):
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "clothfit":
            assert hasattr(clothfit, node.attr), node.attr
        if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("clothfit."):
            called = eval(ast.unparse(node.func))
            inspect.signature(called).bind(*node.args, **{word.arg: word.value for word in node.keywords})


def test_the_first_page_shows_all_of_a_day_and_its_two_commands_are_targets_of_the_makefile():
    assert {command.split()[0] for command, _ in commands("first")} >= {"new", "simulate", "estimate", "evaluate"}
    (first, *_) = blocks(PAGES["first"], "console")
    targets = re.findall(r"\$ make (\w+)", first)
    assert targets == ["demo", "test"]
    makefile = (ROOT / "Makefile").read_text("utf-8")
    assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in targets)
    (block,) = blocks(PAGES["first"], "sh")  # which a test of shots runs
    assert set(typed(f"```sh\n{block}```")) <= set(typed(PAGES["garment.md"]))
