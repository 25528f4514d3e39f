"""The references that `make docs` builds: complete, with whole links and tables; the examples in one of them run."""

import doctest
import re
from functools import cache
from types import ModuleType

import pytest
from helpers.modules import script
from helpers.pages import broken_links, ragged_tables
from helpers.paths import DOCS

import clothfit
from clothfit.cli.program import COMMANDS

SCRIPTS = {name: script(DOCS / f"{name}.py") for name in ("commands", "python")}
PYTHON = SCRIPTS["python"]
EXAMPLES = PYTHON.examples()
NAMES = [name for names in PYTHON.GROUPS.values() for name in names]
OPTIONS = doctest.ELLIPSIS | doctest.FAIL_FAST


@cache
def text(name):
    """A reference as it is built."""
    return SCRIPTS[name].page()


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_reference_builds_with_whole_links_and_tables(name, tmp_path):
    page = tmp_path / SCRIPTS[name].PAGE.name
    page.write_text(text(name), "utf-8")
    assert list(broken_links(page)) == []
    assert ragged_tables(page) == []


def test_the_reference_of_the_commands_has_every_command_and_its_options():
    page = text("commands")
    assert re.findall(r"^## clothfit (\w+)$", page, re.MULTILINE) == list(COMMANDS)
    assert "| `--holdout FRACTION" in page
    assert page.count("| `-h, --help`") == 1  # what every command has is said once


def test_the_reference_has_every_public_name_once():
    modules = {name for name in NAMES if isinstance(getattr(clothfit, name), ModuleType)}
    assert modules == set(clothfit._MODULES) == set(PYTHON.MODULES)
    assert sorted(NAMES) == clothfit.__all__
    assert len(NAMES) == len(set(NAMES))


def test_every_name_has_an_example_and_a_docstring():
    listed = [name for name in NAMES if name not in PYTHON.MODULES]
    listed += [f"{module}.{name}" for module, names in PYTHON.MODULES.items() for name in names]
    assert set(EXAMPLES) == {PYTHON.START, *listed}
    functions = [name for name in listed if name.split(".")[-1].islower()]
    assert [name for name in functions if f"clothfit.{name}(" not in EXAMPLES[name]] == []
    titles = re.findall(r"^#+ clothfit\.([\w.]+)$", text("python"), re.MULTILINE)
    assert [name for name in listed if name not in titles] == []
    assert re.findall(r"^\| `\w+` .*\|\s*\|$", text("python"), re.MULTILINE) == []  # fields say what they are


def test_every_function_says_what_it_raises_or_returns():
    entries = re.split(r"^#+ (?=clothfit\.)", text("python"), flags=re.MULTILINE)[1:]
    calls = [entry for entry in entries if re.search(r"-> (?!None)", entry.split("```")[1])]
    raising = [entry.split("\n")[0] for entry in calls if "Raises" in entry]
    assert len(calls) > 25
    assert {entry.split("\n")[0] for entry in calls} - set(raising) <= {
        "clothfit.mesh.areas", "clothfit.mesh_problems.tiny", "clothfit.verify.dot_product_error"
    }  # fmt: skip


@pytest.mark.parametrize("name", [name for name in EXAMPLES if name != PYTHON.START])
@pytest.mark.slow  # some compile a fit
def test_an_example_runs_and_gives_what_the_page_shows(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    source = f"{EXAMPLES[PYTHON.START]}\n{EXAMPLES[name]}\n"
    test = doctest.DocTestParser().get_doctest(source, {}, name, str(PYTHON.EXAMPLES), 0)
    report = []
    runner = doctest.DocTestRunner(optionflags=OPTIONS, verbose=False)
    runner.run(test, out=report.append)
    assert not runner.failures, "".join(report)
