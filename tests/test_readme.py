"""What the README shows is what happens: its commands, their output, its Python, its exit codes."""

import re
import shutil
from pathlib import Path

import numba
import pytest

from clothfit.cli import run

ROOT = Path(__file__).resolve().parent.parent
CUT = "[…]"
BEST = "Pareto-best"
METRES = {"nm": 1e-9, "µm": 1e-6, "mm": 1e-3, "m": 1.0}
TEXT = (ROOT / "README.md").read_text("utf-8")

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="fits of 144 vertices need compilation")


def blocks(language):
    """The code blocks of one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)


def shape(text):
    """A text without its numbers, its units of length, its column widths, and what depends on the speed of the machine:
    progress, and which settings are the Pareto-best (`undominated`).
    """
    lines = [line for line in text.splitlines() if not re.match(r" *[\d.]+ s  cost ", line) and line.strip()]
    lines = [re.sub(r"\d[\d.e+-]* (nm|µm|mm|m)\b", "# m", line) for line in lines if "compiling" not in line]
    lines = [re.sub(rf"{BEST}(, )?", "", line) for line in lines]
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


def test_its_commands_print_what_it_says(checkout, capsys):
    ran = 0
    for block in blocks("console"):
        for command, told in re.findall(r"^\$ clothfit (.*)\n((?:(?!\$).*\n)*)", block, re.MULTILINE):
            assert run(command.split()) == 0
            err = capsys.readouterr().err
            printed = shape(err)
            assert BEST not in told or (undominated(told) and undominated(err))
            if CUT in told:  # lines that depend on the machine are left out
                assert [line for line in shape(told) if line != CUT and line not in printed] == []
            else:
                assert printed == shape(told)
            ran += 1
    assert ran >= 6


def test_its_python_runs(checkout, capsys):
    (block,) = blocks("python")
    exec(block, {})
    status, rmse = capsys.readouterr().out.split()
    assert status == "converged"
    assert float(rmse) <= 1e-6
    assert (checkout / "fitted.json").is_file()


def test_the_files_it_names_exist():
    for link in re.findall(r"\]\(([^)#:]+)\)", TEXT):
        assert (ROOT / link).exists()


def test_its_two_commands_are_the_targets_of_the_makefile():
    (first, *_) = blocks("console")
    targets = re.findall(r"\$ make (\w+)", first)
    assert targets == ["demo", "test"]
    makefile = (ROOT / "Makefile").read_text("utf-8")
    assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in targets)
