"""The reference of the public names: it is what the package says, complete, and its examples run."""

import doctest
import re
from importlib import util
from types import ModuleType

import numba
import pytest
from helpers.paths import ROOT

import clothfit

SPEC = util.spec_from_file_location("python_page", ROOT / "docs" / "python.py")
python = util.module_from_spec(SPEC)
SPEC.loader.exec_module(python)
EXAMPLES = python.examples()
NAMES = [name for names in python.GROUPS.values() for name in names]
OPTIONS = doctest.ELLIPSIS | doctest.FAIL_FAST


def test_the_page_is_what_the_docstrings_say():
    assert python.PAGE.read_text("utf-8") == python.page(), "python docs/python.py writes it again"


def test_the_page_has_every_public_name_once():
    modules = {name for name in NAMES if isinstance(getattr(clothfit, name), ModuleType)}
    assert modules == set(clothfit._MODULES) == set(python.MODULES)
    assert sorted(NAMES) == clothfit.__all__
    assert len(NAMES) == len(set(NAMES))


def test_every_name_has_an_example_and_a_docstring():
    listed = [name for name in NAMES if name not in python.MODULES]
    listed += [f"{module}.{name}" for module, names in python.MODULES.items() for name in names]
    assert set(EXAMPLES) == {python.START, *listed}
    functions = [name for name in listed if name.split(".")[-1].islower()]
    assert [name for name in functions if f"clothfit.{name}(" not in EXAMPLES[name]] == []
    page = python.PAGE.read_text("utf-8")
    assert [name for name in listed if not re.search(rf"^#+ clothfit\.{re.escape(name)}$", page, re.MULTILINE)] == []


def test_every_field_says_what_it_is():
    page = python.PAGE.read_text("utf-8")
    assert re.findall(r"^\| `\w+` .*\|\s*\|$", page, re.MULTILINE) == []


def test_every_function_says_what_it_raises_or_returns():
    page = python.PAGE.read_text("utf-8")
    entries = re.split(r"^#+ (?=clothfit\.)", page, flags=re.MULTILINE)[1:]
    calls = [entry for entry in entries if re.search(r"-> (?!None)", entry.split("```")[1])]
    raising = [entry.split("\n")[0] for entry in calls if "Raises" in entry]
    assert len(calls) > 25
    assert {entry.split("\n")[0] for entry in calls} - set(raising) <= {
        "clothfit.mesh.areas", "clothfit.mesh_problems.tiny", "clothfit.verify.dot_product_error"
    }  # fmt: skip


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="fits need compilation")
@pytest.mark.parametrize("name", [name for name in EXAMPLES if name != python.START])
@pytest.mark.slow  # some compile a fit
def test_an_example_runs_and_gives_what_the_page_shows(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    source = f"{EXAMPLES[python.START]}\n{EXAMPLES[name]}\n"
    test = doctest.DocTestParser().get_doctest(source, {}, name, str(python.EXAMPLES), 0)
    report = []
    runner = doctest.DocTestRunner(optionflags=OPTIONS, verbose=False)
    runner.run(test, out=report.append)
    assert not runner.failures, "".join(report)
